"""The command line: it parses, calls and prints; errors become exit codes.

0 done; 1 the data cannot carry the result; 2 wrong call or unreadable file.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from aerobalance import __version__
from aerobalance.components import STANDARD_GRAVITY
from aerobalance.problems import DoubtWarning, FitError, ReadError

PROGRAM = "aerobalance"

app = typer.Typer(
    name=PROGRAM,
    help="The force that was really applied, from the readings of a wind-tunnel strain-gauge balance.",
    epilog=f"Example: {PROGRAM} force run.csv --dynamics dynamics.json -o force.csv",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
identify = typer.Typer(
    help="Stiffness and damping of a balance, from a release, a shaken rig or a published table.",
    epilog=f"Example: {PROGRAM} identify decay cut.csv --component AF --mass 177.87 -o dynamics.json",
    no_args_is_help=True,
)
app.add_typer(identify, name="identify")

Json = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")]
Out = Annotated[Path | None, typer.Option("-o", "--out", help="Where to write the result.")]
NeededOut = Annotated[
    Path, typer.Option("-o", "--out", help="Where to write the result; the ending chooses the format.")
]
Component = Annotated[str, typer.Option("--component", help="Which component: NF, PM, SF, YM, RM or AF.")]
Gravity = Annotated[float, typer.Option("--gravity", help="Local acceleration of gravity in m/s^2.", min=9.7, max=9.9)]
Map = Annotated[
    Path | None, typer.Option("--map", help="Channel map (TOML) that says what a foreign file's columns are.")
]
Mass = Annotated[str, typer.Option("--mass", help="Moving mass in kg: a number (taken as exact) or a mass.json.")]
Rec = Annotated[Path, typer.Argument(metavar="REC", help="A recording.")]


class Method(StrEnum):
    """How the force is worked out."""

    SMOOTHER = "smoother"
    PAPER = "paper"


def example(text: str) -> str:
    """Epilogue of a command's help."""
    return f"Example: {PROGRAM} {text}"


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
    as_json: Json = False,
) -> None:
    """Run both of the paper's experiments, simulated, end to end, and write report.html."""
    from aerobalance.demo import run_demo

    show(lambda: run_demo(out, seed=seed), as_json, doing="running both experiments")


@app.command(epilog=example("info run.csv"))
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE")], channel_map: Map = None, as_json: Json = False
) -> None:
    """Show channels, units, rate, duration, gaps and saturation of a recording."""
    from aerobalance import commands

    show(lambda: commands.info(file, channel_map=channel_map), as_json, doing="reading")


@app.command(epilog=example("convert run.txt --map map.toml -o run.csv"))
def convert(
    file: Annotated[Path, typer.Argument(metavar="IN")], out: NeededOut, channel_map: Map = None, as_json: Json = False
) -> None:
    """Convert a recording to the format of the output's ending."""
    from aerobalance import commands

    show(lambda: commands.convert(file, out, channel_map=channel_map), as_json, doing="converting")


@app.command("map", epilog=example("map run.txt -o map.toml"))
def channel_map(
    file: Annotated[Path, typer.Argument(metavar="FILE")],
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Make a channel map, to be filled in, for a foreign file."""
    from aerobalance import commands

    show(lambda: commands.channel_map_for(file, out), as_json, doing="reading", plain="map")


@app.command(epilog=example("weigh points.csv -o mass.json"))
def weigh(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Static points, or recordings.")],
    out: Out = None,
    component: Component = "AF",
    gravity: Gravity = STANDARD_GRAVITY,
    channel_map: Map = None,
    as_json: Json = False,
) -> None:
    """Find the moving mass from readings at several pitch (and roll) angles."""
    from aerobalance import commands

    show(
        lambda: commands.weigh(files, out, component=component, gravity=gravity, channel_map=channel_map),
        as_json,
        doing="weighing",
    )


@identify.command("decay", epilog=example("identify decay cut.csv --component AF --mass 177.87 -o dynamics.json"))
def identify_decay(
    rec: Rec, mass: Mass, out: Out = None, component: Component = "AF", channel_map: Map = None, as_json: Json = False
) -> None:
    """Identify from a free decay: a load that is held and released."""
    from aerobalance import commands

    show(
        lambda: commands.identify_decay(rec, out, component=component, mass=mass, channel_map=channel_map),
        as_json,
        doing="fitting the decay",
    )


@identify.command("rig", epilog=example("identify rig sweep.csv --component AF --mass 0.68 -o dynamics.json"))
def identify_rig(
    rec: Rec,
    mass: Annotated[
        str | None,
        typer.Option("--mass", help="Moving mass in kg: a number, or a mass.json; identified when not given."),
    ] = None,
    out: Out = None,
    component: Component = "AF",
    channel_map: Map = None,
    as_json: Json = False,
) -> None:
    """Identify from a shaken ground end: stepped sine, sweep or random."""
    from aerobalance import commands

    show(
        lambda: commands.identify_rig(rec, out, component=component, mass=mass, channel_map=channel_map),
        as_json,
        doing="fitting the response",
    )


@identify.command("frf", epilog=example("identify frf table.csv --component AF --mass 0.68 -o dynamics.json"))
def identify_frf(
    table: Annotated[Path, typer.Argument(metavar="TABLE", help="Frequency, amplitude and phase with uncertainties.")],
    mass: Mass,
    out: Out = None,
    component: Component = "AF",
    as_json: Json = False,
) -> None:
    """Identify from a published sine calibration: the response AF/F at some frequencies."""
    from aerobalance import commands

    show(lambda: commands.identify_frf(table, out, component=component, mass=mass), as_json, doing="fitting the table")


@app.command(epilog=example("force run.csv --dynamics dynamics.json -o force.csv"))
def force(
    rec: Rec,
    dynamics: Annotated[Path, typer.Option("--dynamics", help="The dynamics.json that identify wrote.")],
    out: NeededOut,
    method: Annotated[
        Method, typer.Option("--method", help="smoother: optimal estimator; paper: Eq. (17) by central differences.")
    ] = Method.SMOOTHER,
    bandwidth: Annotated[
        float | None, typer.Option("--bandwidth", help="Give the inverse limited to this band in Hz instead.")
    ] = None,
    gravity: Gravity = STANDARD_GRAVITY,
    channel_map: Map = None,
    as_json: Json = False,
) -> None:
    """Work out the force that was applied, with the standard uncertainty of every sample."""
    from aerobalance import commands

    show(
        lambda: commands.force(
            rec,
            out,
            dynamics=dynamics,
            method=method.value,
            bandwidth=bandwidth,
            gravity=gravity,
            channel_map=channel_map,
        ),
        as_json,
        doing="estimating the force",
    )


def show(work: Callable[[], dict[str, Any]], as_json: bool, *, doing: str, plain: str | None = None) -> None:
    """Do the work with a sign of life, and print its account."""
    with Console(stderr=True).status(f"{doing} ..."):
        account = work()
    if as_json:
        from aerobalance.io.artefacts import json_text

        typer.echo(json_text(account), nl=False)
    elif plain is not None:
        typer.echo(account[plain], nl=False)
    else:
        typer.echo(text_of(account))


def text_of(account: dict[str, Any]) -> str:
    """Lay an account out in two columns, nested keys joined by dots, one line each."""
    lines = _lines(account)
    width = max((len(key) for key, _ in lines), default=0)
    return "\n".join(f"{key:<{width}}  {text}" for key, text in lines)


def _lines(item: Any, prefix: str = "") -> list[tuple[str, str]]:
    if isinstance(item, dict):
        if "value" in item:
            return [(prefix, _quantity(item))]
        lines = []
        for key, value in item.items():
            if key not in {"covariance", "warnings", "residuals"}:
                lines += _lines(value, f"{prefix}.{key}" if prefix else str(key))
        return lines
    if isinstance(item, list) and item and isinstance(item[0], dict):
        return [line for number, part in enumerate(item, 1) for line in _lines(part, f"{prefix}.{number}")]
    if isinstance(item, list):
        return [(prefix, ", ".join(_text(part) for part in item) or "none")]
    return [(prefix, _text(item))]


def _quantity(item: dict[str, Any]) -> str:
    value = item["value"]
    text = " to ".join(_text(part) for part in value) if isinstance(value, list) else _text(value)
    doubt = f" (u = {item['u']:.2g})" if "u" in item else ""
    unit = item.get("unit", "")
    return f"{text}{doubt}{'' if unit in {'', '1'} else f' {unit}'}"


def _text(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:.7g}"
    return str(value)


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
    sys.exit(main())


if __name__ == "__main__":
    run()
