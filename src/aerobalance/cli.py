"""The command line: it parses, calls and prints; errors become exit codes.

0 done; 1 the data cannot carry the result; 2 wrong call or unreadable file.
"""

from __future__ import annotations

import os
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
Modes = Annotated[str, typer.Option("--modes", help="How many modes: a number, or auto for those the data show.")]
Component = Annotated[str, typer.Option("--component", help="Which component: NF, PM, SF, YM, RM or AF.")]
Gravity = Annotated[float, typer.Option("--gravity", help="Local acceleration of gravity in m/s^2.", min=9.7, max=9.9)]
Map = Annotated[
    Path | None, typer.Option("--map", help="Channel map (TOML) that says what a foreign file's columns are.")
]
Mass = Annotated[str, typer.Option("--mass", help="Moving mass in kg: a number (taken as exact) or a mass.json.")]
Rec = Annotated[Path, typer.Argument(metavar="REC", help="A recording.")]


Balance = Annotated[
    Path, typer.Option("--balance", help="balance.json from calibrate, or a matrix in BALFIT's text layout.")
]
MaybeBalance = Annotated[
    Path | None,
    typer.Option("--balance", help="balance.json, for recordings of gauge outputs (rAF ...) instead of loads."),
]
Zero = Annotated[
    list[Path] | None,
    typer.Option("--zero", help="Recording of the unloaded balance before the run (may be given again), or 'none'."),
]
ZeroAfter = Annotated[
    list[Path] | None, typer.Option("--zero-after", help="The same after the run: the drift is taken off.")
]
Tare = Annotated[
    list[Path] | None,
    typer.Option("--tare", help="Wind-off recording, its loads taken off at the same pitch (may be given again)."),
]


class Model(StrEnum):
    """Which terms a balance matrix may have."""

    LINEAR = "linear"
    QUADRATIC = "quadratic"
    ABS = "abs"
    SIX_BY_27 = "27"
    SIX_BY_96 = "96"
    AUTO = "auto"


class LoadForm(StrEnum):
    """Which six loads are given."""

    DIRECT = "direct"
    FORCE = "force"
    MOMENT = "moment"


class Way(StrEnum):
    """Which way a balance matrix goes."""

    ITERATIVE = "iterative"
    NON_ITERATIVE = "non-iterative"


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
    tables: Annotated[
        bool, typer.Option("--tables", help="Make the paper's Tables 1 and 2 instead, with every rival (tables.html).")
    ] = False,
    as_json: Json = False,
) -> None:
    """Run both of the paper's experiments, simulated, end to end, and write report.html."""
    if tables:
        from aerobalance.tables import run_tables

        show(lambda: run_tables(out, seed=seed), as_json, doing="running every rival", plain="summary")
        return
    from aerobalance.demo import run_demo

    show(lambda: run_demo(out, seed=seed), as_json, doing="running both experiments")


@app.command(epilog=example("info run.csv"))
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE")], channel_map: Map = None, as_json: Json = False
) -> None:
    """Show channels, units, rate, duration, gaps and saturation of a recording."""
    from aerobalance.commands import recordings

    show(lambda: recordings.info(file, channel_map=channel_map), as_json, doing="reading")


@app.command(epilog=example("convert run.txt --map map.toml -o run.csv"))
def convert(
    file: Annotated[Path, typer.Argument(metavar="IN")], out: NeededOut, channel_map: Map = None, as_json: Json = False
) -> None:
    """Convert a recording to the format of the output's ending."""
    from aerobalance.commands import recordings

    show(lambda: recordings.convert(file, out, channel_map=channel_map), as_json, doing="converting")


@app.command("map", epilog=example("map run.txt -o map.toml"))
def channel_map(
    file: Annotated[Path, typer.Argument(metavar="FILE")],
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Make a channel map, to be filled in, for a foreign file."""
    from aerobalance.commands import recordings

    show(lambda: recordings.channel_map_for(file, out), as_json, doing="reading", plain="map")


@app.command(epilog=example("calibrate schedule.csv --model auto -o balance.json --report calibration.html"))
def calibrate(
    schedule: Annotated[
        Path, typer.Argument(metavar="SCHEDULE", help="Loads and gauge outputs: BALFIT csv, .vol or plain csv.")
    ],
    out: Out = None,
    model: Annotated[
        Model, typer.Option("--model", help="Terms offered: 96 of AIAA R-091, or fewer; auto chooses among them.")
    ] = Model.AUTO,
    way: Annotated[
        Way, typer.Option("--way", help="Fit outputs on loads (iterative) or loads on outputs (non-iterative).")
    ] = Way.ITERATIVE,
    keep_aside: Annotated[
        float, typer.Option("--keep-aside", help="Share of the points kept out of the fit to confirm it.")
    ] = 0.0,
    capacity: Annotated[
        list[str] | None,
        typer.Option("--capacity", help="Capacity of a load, 'N1=2500 lbf', where the file lacks it (repeatable)."),
    ] = None,
    distances: Annotated[
        str | None,
        typer.Option("--distances", help="Gauges from the centre, '1.5 1.5 1.25 1.25 in': N1 N2 S1 S2 (or PM, YM)."),
    ] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Write a page with figures and tables.")] = None,
    as_json: Json = False,
) -> None:
    """Make a balance matrix from a load schedule, with its statistics."""
    from aerobalance.commands import calibration

    show(
        lambda: calibration.calibrate(
            schedule,
            out,
            model=model.value,
            way=way.value,
            keep_aside=keep_aside,
            capacities=capacity or (),
            distances=distances,
            report=report,
        ),
        as_json,
        doing="fitting the matrix",
        plain="summary",
    )


@app.command("compare-calibrations", epilog=example("compare-calibrations 2022.json 2025.json"))
def compare_calibrations(
    before: Annotated[Path, typer.Argument(metavar="BEFORE", help="balance.json, or a load schedule.")],
    after: Annotated[Path, typer.Argument(metavar="AFTER", help="The later one of the same balance.")],
    out: Out = None,
    model: Annotated[Model, typer.Option("--model", help="Terms offered where a schedule is given.")] = Model.AUTO,
    as_json: Json = False,
) -> None:
    """Show what has changed between two calibrations of one balance, and whether it is more than chance."""
    from aerobalance.commands import calibration

    show(lambda: calibration.compare(before, after, out, model=model.value), as_json, doing="comparing")


@app.command(epilog=example("loads run.csv --balance balance.json --zero windoff.csv -o loads.csv"))
def loads(
    rec: Rec,
    balance: Balance,
    out: NeededOut,
    zero: Zero = None,
    zero_after: ZeroAfter = None,
    tare: Tare = None,
    mass: Annotated[
        Path | None, typer.Option("--mass", help="mass.json of a weighing, whose weight is taken off.")
    ] = None,
    form: Annotated[
        LoadForm | None,
        typer.Option("--form", help="direct: NF PM SF YM RM AF; force: N1 N2 ...; moment: PM1 PM2 ..."),
    ] = None,
    channel_map: Map = None,
    as_json: Json = False,
) -> None:
    """Turn gauge outputs into the loads that the balance feels, with their uncertainty."""
    from aerobalance.commands import loads as command

    files = command.BalanceFiles.of(balance, zero=zero, zero_after=zero_after, tare=tare, mass=mass)
    show(
        lambda: command.loads(
            rec, out, files=files, form=None if form is None else form.value, channel_map=channel_map
        ),
        as_json,
        doing="solving for the loads",
    )


@app.command(epilog=example("weigh points.csv -o mass.json"))
def weigh(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Static points, or recordings.")],
    out: Out = None,
    component: Annotated[
        str | None,
        typer.Option("--component", help="Weigh with this force alone: AF, SF or NF; all loads if left out."),
    ] = None,
    gravity: Gravity = STANDARD_GRAVITY,
    balance: MaybeBalance = None,
    zero: Zero = None,
    channel_map: Map = None,
    as_json: Json = False,
) -> None:
    """Find mass and centre of gravity from readings at several pitch (and roll) angles."""
    from aerobalance.commands import weighing
    from aerobalance.commands.loads import BalanceFiles

    if balance is None and zero:
        raise ValueError("--zero goes with --balance: it is a zero of gauge outputs")

    show(
        lambda: weighing.weigh(
            files,
            out,
            component=component,
            gravity=gravity,
            files=None if balance is None else BalanceFiles.of(balance, zero=zero),
            channel_map=channel_map,
        ),
        as_json,
        doing="weighing",
    )


@identify.command("decay", epilog=example("identify decay cut.csv --component AF --mass 177.87 -o dynamics.json"))
def identify_decay(
    rec: Rec,
    mass: Mass,
    out: Out = None,
    component: Component = "AF",
    modes: Modes = "1",
    channel_map: Map = None,
    as_json: Json = False,
) -> None:
    """Identify from a free decay: a load that is held and released."""
    from aerobalance.commands import identify

    show(
        lambda: identify.identify_decay(
            rec, out, component=component, mass=mass, modes=modes, channel_map=channel_map
        ),
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
    modes: Modes = "1",
    channel_map: Map = None,
    as_json: Json = False,
) -> None:
    """Identify from a shaken ground end: stepped sine, sweep or random."""
    from aerobalance.commands import identify

    show(
        lambda: identify.identify_rig(rec, out, component=component, mass=mass, modes=modes, channel_map=channel_map),
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
    from aerobalance.commands import identify

    show(lambda: identify.identify_frf(table, out, component=component, mass=mass), as_json, doing="fitting the table")


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
    u_gravity: Annotated[float, typer.Option("--u-gravity", help="Its standard uncertainty.", min=0)] = 0.0,
    hum: Annotated[
        str,
        typer.Option(
            "--hum", metavar="mains|keep|HZ,HZ", help="Lines that are no force: mains hum if found, none, or near HZ."
        ),
    ] = "mains",
    balance: MaybeBalance = None,
    zero: Zero = None,
    zero_after: ZeroAfter = None,
    tare: Tare = None,
    channel_map: Map = None,
    monte_carlo: Annotated[
        int | None, typer.Option("--monte-carlo", help="Check the uncertainty by so many draws (JCGM 101).", min=10)
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed of these draws.", min=0)] = 1,
    report: Annotated[
        Path | None, typer.Option("--report", help="Page (HTML) with load, force, spectrum and budget.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Work out the force that was applied, with the standard uncertainty of every sample, its budget and a check."""
    from aerobalance.commands import force as command
    from aerobalance.commands.loads import BalanceFiles

    if balance is None and (zero or zero_after or tare):
        raise ValueError("--zero, --zero-after and --tare go with --balance: they are of gauge outputs")

    show(
        lambda: command.force(
            rec,
            out,
            dynamics=dynamics,
            method=method.value,
            bandwidth=bandwidth,
            gravity=gravity,
            gravity_uncertainty=u_gravity,
            hum=command.hum_of(hum),
            files=None if balance is None else BalanceFiles.of(balance, zero=zero, zero_after=zero_after, tare=tare),
            channel_map=channel_map,
            check=None if monte_carlo is None else command.Check(monte_carlo, seed),
            report=report,
        ),
        as_json,
        doing="estimating the force",
    )


@app.command(epilog=example("plan --dynamics dynamics.json --noise 2 --rate 1600 --force 200"))
def plan(
    dynamics: Annotated[Path, typer.Option("--dynamics", help="The dynamics.json that identify wrote.")],
    noise: Annotated[float, typer.Option("--noise", help="Standard uncertainty of one reading of the load, in N.")],
    rate: Annotated[float, typer.Option("--rate", help="Sampling rate in Hz.")],
    component: Annotated[
        str | None, typer.Option("--component", help="Which component, where there are more.")
    ] = None,
    acceleration_noise: Annotated[
        float, typer.Option("--acceleration-noise", help="The same of the ground accelerometer, in m/s^2.")
    ] = 0.0,
    force: Annotated[
        float | None, typer.Option("--force", help="Root mean square of the force expected, in N.")
    ] = None,
    bandwidth: Annotated[
        list[float] | None, typer.Option("--bandwidth", help="Highest frequency of the force in Hz (repeatable).")
    ] = None,
    as_json: Json = False,
) -> None:
    """Before the test: attainable uncertainty against bandwidth, and which sensor limits it."""
    from aerobalance.commands import plan as command

    show(
        lambda: command.plan(
            dynamics,
            noise=noise,
            rate=rate,
            component=component,
            acceleration_noise=acceleration_noise,
            force=force,
            bandwidths=bandwidth or (),
        ),
        as_json,
        doing="planning",
        plain="summary",
    )


@app.command(epilog=example("compare run.csv --dynamics dynamics.json --truth truth.csv -o compare.html"))
def compare(
    rec: Rec,
    dynamics: Annotated[Path, typer.Option("--dynamics", help="The dynamics.json that identify wrote.")],
    truth: Annotated[
        Path | None, typer.Option("--truth", help="Force really applied, on the record's clock: time [s],AF [N].")
    ] = None,
    component: Component = "AF",
    step: Annotated[
        Path | None,
        typer.Option("--step", help="Record of one step or impulse, for the black-box inverse; else the model's own."),
    ] = None,
    half_range: Annotated[
        float | None,
        typer.Option("--half-range", help="What percentages refer to; half of the truth's span if left out."),
    ] = None,
    out: Out = None,
    gravity: Gravity = STANDARD_GRAVITY,
    balance: MaybeBalance = None,
    zero: Zero = None,
    zero_after: ZeroAfter = None,
    tare: Tare = None,
    channel_map: Map = None,
    as_json: Json = False,
) -> None:
    """Show this estimator and its rivals side by side on one record, with their errors where the truth is given."""
    from aerobalance.commands import compare as command
    from aerobalance.commands.loads import BalanceFiles

    if balance is None and (zero or zero_after or tare):
        raise ValueError("--zero, --zero-after and --tare go with --balance: they are of gauge outputs")

    show(
        lambda: command.compare(
            rec,
            dynamics=dynamics,
            truth=truth,
            component=component,
            step=step,
            half_range=half_range,
            gravity=gravity,
            files=None if balance is None else BalanceFiles.of(balance, zero=zero, zero_after=zero_after, tare=tare),
            channel_map=channel_map,
            out=out,
        ),
        as_json,
        doing="running the rivals",
        plain="summary",
    )


@app.command(epilog=example("record --source simulated --seconds 10 -o run.h5"))
def record(
    out: NeededOut,
    source: Annotated[
        str | None, typer.Option("--source", help="What gives the samples: simulated (the default) or replay.")
    ] = None,
    setup: Annotated[
        Path | None, typer.Option("--setup", help="Test set-up (TOML): channels, trigger, limits, source.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option("--seconds", help="Length of the record in s; else until Ctrl-C.")
    ] = None,
    file: Annotated[Path | None, typer.Option("--file", help="The recording that is replayed.")] = None,
    rig: Annotated[
        str | None, typer.Option("--rig", help="The simulated rig: vibration, cable_cut or six (components).")
    ] = None,
    speed: Annotated[
        float | None, typer.Option("--speed", help="Times real time; inf for as fast as possible.")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Seed of the simulated noise.")] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Delete an old recording of the same name.")] = False,
    as_json: Json = False,
) -> None:
    """Record a source to an HDF5 file, each block safe on the disk before the next; Ctrl-C ends it cleanly."""
    from aerobalance.commands import record as command

    wishes = command.Wishes(source=source, file=file, rig=rig, seconds=seconds, speed=speed, seed=seed)
    with Console(stderr=True).status("starting ...") as status:
        account = command.record(out, setup=setup, wishes=wishes, replace=replace, show=status.update)
    show(lambda: account, as_json, doing="recording")


def show(work: Callable[[], dict[str, Any]], as_json: bool, *, doing: str, plain: str | None = None) -> None:
    """Do the work with a sign of life, and print its account."""
    with Console(stderr=True).status(f"{doing} ..."):
        account = work()
    if as_json:
        from aerobalance.io.artefacts import json_text

        account.pop("summary", None)  # a table for people
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
            if key not in {"covariance", "warnings", "residuals", "model", "budget", "spectrum", "monte_carlo"}:
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
    # The matrices here are small: threads of the linear algebra get in each other's way, by a factor of ten on two
    # cores that are shared. Whoever sets these himself is heard.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    sys.exit(main())


if __name__ == "__main__":
    run()
