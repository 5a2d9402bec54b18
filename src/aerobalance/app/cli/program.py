"""All commands, and how their errors become exit codes."""

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
    told: set[str] = set()

    def warn(message: Warning | str, *_: object, **__: object) -> None:
        text = streams.plain(as_options(" ".join(str(message).split())))
        if text not in told:
            told.add(text)
            print(f"warning: {text}", file=sys.stderr)  # noqa: T201 - this is the edge

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", DataQualityWarning)
        warnings.showwarning = warn  # at once, as `record` runs for hours
        try:
            return _run(_typed() if arguments is None else arguments)
        except BrokenPipeError:  # whoever reads the answer has seen enough of it
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        finally:
            streams.clean_up()


def _typed() -> list[str]:
    """Words after the program's name; shells of Windows leave patterns of files to the program."""
    return sys.argv[1:] if os.name != "nt" else with_files(sys.argv[1:])


def with_files(words: Sequence[str]) -> list[str]:
    """Return words with the files in the place of each pattern that some match, such as pitch_*.txt."""
    given: list[str] = []
    for word in words:
        pattern = Path(word)
        files = sorted(str(path) for path in pattern.parent.glob(pattern.name)) if {"*", "?"} & set(word) else []
        given += files or [word]
    return given


def _run(words: Sequence[str]) -> int:
    """Run one command; give the exit code of what goes wrong, and say it."""
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
    """Make the commands, with flags shown as such, no value follows them, and types in everyday words."""
    command = typer.main.get_command(app)
    waiting = [command]
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
"""What `--help` calls the kind of a value, by the name that it has in Python."""


def _in_words(shown: Callable[[typer.Context], str | None], context: typer.Context) -> str | None:
    """Return the type that the parser would show, without the words of a programmer."""
    kind = shown(context)
    if kind is None:
        return None
    plain = kind.removeprefix("<").removesuffix(">")
    one = plain.removeprefix("list[").removesuffix("]") if plain.startswith("list[") else plain
    return f"<{TYPES.get(one, one)}>" if kind.startswith("<") else kind


def _from_parser(problem: Exception, words: Sequence[str]) -> int:
    """Exit code for what the parser raises, or for a fault of the program itself."""
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
    return _end(f"error: {_of_flags(text, words, context)}; see {command} --help", 2)


def _of_flags(text: str, words: Sequence[str], context: Any) -> str:
    """Say it where an extra word stands behind a flag, as if it were its value."""
    if "unexpected extra argument" not in text or context is None:
        return text
    flags = {name for option in context.command.params if getattr(option, "is_flag", False) for name in option.opts}
    for flag, word in pairwise(words):
        if flag in flags and f"({word}" in text:
            return f"{flag} is a flag and takes no value; leave out {word!r}"
    return text


def _failed(problem: Exception, code: int) -> int:
    """Return what went wrong, and what was written before."""
    return _end(
        f"error: {'; '.join([as_options(str(problem)).rstrip('.'), *getattr(problem, '__notes__', ())])}", code
    )


def _end(text: str, code: int) -> int:
    print(streams.plain(" ".join(text.split())), file=sys.stderr)  # noqa: T201 - this is the edge
    return code
