"""The command line: it parses, calls and prints; errors become exit codes.

0 done; 1 the data cannot carry the result; 2 wrong call or unreadable file.
"""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path
from typing import Annotated

import typer

from aerobalance import __version__
from aerobalance.cli import lab, recordings, runs
from aerobalance.cli.account import show
from aerobalance.cli.options import PROGRAM, Json, example
from aerobalance.problems import DoubtWarning, FitError, ReadError

app = typer.Typer(
    name=PROGRAM,
    help="The force that was really applied, from the readings of a wind-tunnel strain-gauge balance.",
    epilog=f"Example: {PROGRAM} force run.csv --dynamics dynamics.json -o force.csv",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def version(wanted: bool) -> None:
    """Print the version and stop."""
    if wanted:
        typer.echo(f"{PROGRAM} {__version__}")
        raise typer.Exit


@app.callback()
def options(
    _: Annotated[bool, typer.Option("--version", callback=version, is_eager=True, help="Print the version.")] = False,
) -> None:
    """Read what all commands share."""


@app.command(epilog=example("demo --out build/demo"))
def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for the report and all files behind it.")] = Path("demo"),
    seed: Annotated[
        int | None, typer.Option("--seed", help="Seed of the simulated noise; fresh when not given.")
    ] = None,
    tables: Annotated[
        bool, typer.Option("--tables", help="Make the paper's Tables 1 and 2 instead, with every rival (tables.html).")
    ] = False,
    six: Annotated[
        bool, typer.Option("--six", help="Six components that ring together instead, from mV/V to forces (six.html).")
    ] = False,
    as_json: Json = False,
) -> None:
    """Run both of the paper's experiments, simulated, end to end, and write report.html."""
    if tables and six:
        raise ValueError("--tables and --six are two demonstrations; give one of them")
    if six:
        from aerobalance.six_demo import run_six

        show(lambda: run_six(out, seed=seed), as_json, doing="running six components", plain="summary")
        return
    if tables:
        from aerobalance.tables import run_tables

        show(lambda: run_tables(out, seed=seed), as_json, doing="running every rival", plain="summary")
        return
    from aerobalance.demo import run_demo

    show(lambda: run_demo(out, seed=seed), as_json, doing="running both experiments")


for part in (recordings, lab, runs):
    app.add_typer(part.app)


def main(arguments: list[str] | None = None) -> int:
    """Run one command; return its exit code."""
    told: set[str] = set()

    def warn(message: Warning | str, *_: object, **__: object) -> None:
        text = " ".join(str(message).split())
        if text not in told:
            told.add(text)
            print(f"warning: {text}", file=sys.stderr)  # noqa: T201 - this is the edge

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", DoubtWarning)
        warnings.showwarning = warn
        try:
            result = app(arguments, prog_name=PROGRAM, standalone_mode=False)
        except FitError as problem:
            return _failed(str(problem), 1)
        except (ReadError, ValueError) as problem:
            return _failed(str(problem), 2)
        except typer.Abort:
            return _failed("stopped", 2)
        except Exception as problem:  # noqa: BLE001 - the last line of defence against a traceback
            return _from_parser(problem)
    return int(result or 0)


def _from_parser(problem: Exception) -> int:
    """Exit code for what the parser raises, or for a fault of the program itself."""
    describe = getattr(problem, "format_message", None)
    if not callable(describe):
        what = f"{type(problem).__name__}: {problem}"
        return _failed(f"a fault of the program, please report it with the input that brought it about ({what})", 1)
    context = getattr(problem, "ctx", None)
    if not describe():  # a command without anything to do: its help
        problem.show()  # type: ignore[attr-defined]
        return 2
    command = context.command_path if context is not None else PROGRAM
    text = describe().replace("Value error, ", "").rstrip(".")
    return _failed(f"{text}; see {command} --help", 2)


def _failed(text: str, code: int) -> int:
    print(f"error: {' '.join(text.split())}", file=sys.stderr)  # noqa: T201 - this is the edge
    return code


def run() -> None:
    """Entry point of the command `aerobalance`."""
    # The matrices here are small: threads of the linear algebra get in each other's way, by a factor of ten on two
    # cores that are shared. Whoever sets these himself is heard.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    sys.exit(main())
