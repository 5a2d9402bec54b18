"""The command line: all commands in one program, and the message and exit code of each error.

Exit codes are 0 for a result; 1 where the data allow none (`FitError`), and for a fault of the program itself; 2 for a
wrong call or an unreadable file; 130 after Ctrl-C. An error is one line on standard error and never a traceback.
"""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from aerobalance.app.cli import campaigns, recordings, runs, streams, taps
from aerobalance.app.cli.options import PROGRAM, bundled, example
from aerobalance.app.cli.result import Manner, show
from aerobalance.app.options import as_options
from aerobalance.recording.errors import DataQualityWarning, FitError, ReadError
from aerobalance.recording.version import VERSION

HELP = ["-h", "--help"]

app = typer.Typer(
    name=PROGRAM,
    help="The force that was really applied, from the readings of a wind-tunnel strain-gauge balance.",
    epilog=f"Example: {PROGRAM} force run.csv --dynamics dynamics.json -o force.csv",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": HELP},
)


def version(wanted: bool) -> None:
    """Print the version and stop."""
    if wanted:
        typer.echo(f"{PROGRAM} {VERSION}")
        raise typer.Exit


@app.callback()
def options(
    _: Annotated[
        bool, typer.Option("--version", "-V", callback=version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Read what all commands share."""


@app.command(epilog=example("demo --out build/demo"))
@bundled
def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for the report and all files behind it.")] = Path("demo"),
    seed: Annotated[
        int | None, typer.Option("--seed", help="Seed of the simulated noise; fresh when not given.")
    ] = None,
    tables: Annotated[
        bool,
        typer.Option(
            "--tables", help="Make the paper's Tables 1 and 2 instead, by every baseline method (tables.html)."
        ),
    ] = False,
    six: Annotated[
        bool, typer.Option("--six", help="Six coupled components instead, from mV/V to forces (six.html).")
    ] = False,
    *,
    manner: Manner,
) -> None:
    """Run both of the paper's experiments, simulated, end to end, and write report.html."""
    if tables and six:
        raise ValueError("--tables and --six are two demonstrations; give one of them")
    if six:
        from aerobalance.app.demos.six_demo import run_six

        show(lambda: run_six(out, seed=seed), manner, doing="running six components")
        return
    if tables:
        from aerobalance.app.demos.tables import run_tables

        show(lambda: run_tables(out, seed=seed), manner, doing="running every baseline method")
        return
    from aerobalance.app.demos.demo import run_demo

    show(lambda: run_demo(out, seed=seed), manner, doing="running both experiments")


for part in (recordings, taps, runs, campaigns):
    app.add_typer(part.app)


def main(arguments: list[str] | None = None) -> int:
    """Run one command; return its exit code."""
    shown: set[str] = set()  # the same warning is shown once

    def warn(message: Warning | str, *_: object, **__: object) -> None:
        text = streams.plain(as_options(" ".join(str(message).split())))
        if text not in shown:
            shown.add(text)
            print(f"warning: {text}", file=sys.stderr)  # noqa: T201 - the command line speaks to people

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", DataQualityWarning)
        warnings.showwarning = warn  # shown at once and not at the end, as `record` runs for hours
        try:
            return _run(_arguments() if arguments is None else arguments)
        except (BrokenPipeError, SystemExit) as problem:
            # the reader of a pipe, such as head, has closed it: no error, though parser and help end as by one
            if isinstance(problem, SystemExit) and not isinstance(problem.__context__, BrokenPipeError):
                raise
            # else Python would fail once more when it flushes standard output at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        finally:
            streams.clean_up()


def _arguments() -> list[str]:
    """Arguments as typed; on Windows with patterns such as *.txt replaced by files, which shells do elsewhere."""
    return sys.argv[1:] if os.name != "nt" else with_files(sys.argv[1:])


def with_files(words: Sequence[str]) -> list[str]:
    """Return arguments with each pattern, such as pitch_*.txt, replaced by the files that match it, if any do."""
    given: list[str] = []
    for word in words:
        pattern = Path(word)
        files = sorted(str(path) for path in pattern.parent.glob(pattern.name)) if {"*", "?"} & set(word) else []
        given += files or [word]
    return given


def _run(words: Sequence[str]) -> int:
    """Run one command; show the error, if there is one, and return the exit code."""
    try:
        result = _command()(words, prog_name=PROGRAM, standalone_mode=False)
    except FitError as problem:
        return _failed(problem, 1)
    except (ReadError, ValueError) as problem:
        return _failed(problem, 2)
    except typer.Abort:
        return _end("interrupted; nothing was written", 130)
    except BrokenPipeError:
        raise
    except Exception as problem:  # noqa: BLE001 - the last line of defence against a traceback
        if isinstance(problem, OSError) and problem.errno == errno.ENAMETOOLONG:
            name = str(problem.filename)
            return _end(f"error: {name[:60]}...: the name is too long ({len(name)} characters)", 2)
        return _from_parser(problem, words)
    return int(result or 0)


@cache
def _command() -> Any:
    """Return the program with a help that shows no value behind flags, and types of values in everyday words."""
    command = typer.main.get_command(app)
    waiting = [command]  # commands and groups of commands whose help is not changed yet
    while waiting:
        present = waiting.pop()
        waiting += getattr(present, "commands", {}).values()
        for option in [*present.params, present.get_help_option(typer.Context(present, help_option_names=HELP))]:
            if getattr(option, "is_flag", False):
                option.metavar = ""  # type: ignore[union-attr]
            elif (shown := getattr(option, "display_type", None)) is not None:
                option.display_type = partial(_in_words, shown)  # type: ignore[union-attr]
    return command


TYPES: Final = {
    "str": "text",
    "int": "whole number",
    "int range": "whole number",
    "float": "number",
    "float range": "number",
    "Path": "path",
}
"""Name of the type of a value in `--help`, by its name in Python."""


def _in_words(shown: Callable[[typer.Context], str | None], context: typer.Context) -> str | None:
    """Return the type of a value in everyday words; `shown` is what the parser would show for it."""
    kind = shown(context)
    if kind is None:
        return None
    plain = kind.removeprefix("<").removesuffix(">")
    one = plain.removeprefix("list[").removesuffix("]") if plain.startswith("list[") else plain
    return f"<{TYPES.get(one, one)}>" if kind.startswith("<") else kind


def _from_parser(problem: Exception, words: Sequence[str]) -> int:
    """Show what is wrong with the arguments, or that the program itself failed; return the exit code."""
    # errors of the parser are known by this method: by the version of typer their classes are click's or a copy
    describe = getattr(problem, "format_message", None)
    if not callable(describe):
        what = f"{type(problem).__name__}: {problem}"
        return _end(
            f"error: a fault of the program, please report it with the input that brought it about ({what})", 1
        )
    context = getattr(problem, "ctx", None)
    if not describe():  # a command without anything to do: its help
        problem.show()  # type: ignore[attr-defined]
        return 2
    command = context.command_path if context is not None else PROGRAM
    text = describe().replace("Value error, ", "").rstrip(".")
    return _end(f"error: {_or_value_of_flag(text, words, context)}; see {command} --help", 2)


def _or_value_of_flag(text: str, words: Sequence[str], context: Any) -> str:
    """Return a message of the parser, or a plainer one where an argument too many was meant as value of a flag."""
    if "unexpected extra argument" not in text or context is None:
        return text
    flags = {name for option in context.command.params if getattr(option, "is_flag", False) for name in option.opts}
    for flag, word in pairwise(words):
        if flag in flags and f"({word}" in text:
            return f"{flag} is a flag and takes no value; leave out {word!r}"
    return text


def _failed(problem: Exception, code: int) -> int:
    """Show an error with its notes, such as which files were written before it; return the exit code."""
    return _end(
        f"error: {'; '.join([as_options(str(problem)).rstrip('.'), *getattr(problem, '__notes__', ())])}", code
    )


def _end(text: str, code: int) -> int:
    """Show a message as one line on standard error; return the exit code."""
    print(streams.plain(" ".join(text.split())), file=sys.stderr)  # noqa: T201 - the command line speaks to people
    return code
