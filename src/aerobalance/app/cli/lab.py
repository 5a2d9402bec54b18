"""Commands of the lab: calibrate, weigh, identify."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerobalance.app.cli.options import (
    PROGRAM,
    Component,
    Gauges,
    Gravity,
    Map,
    Mass,
    MaybeBalance,
    ModelOnZero,
    Modes,
    OnZero,
    Out,
    TermModel,
    Way,
    Zero,
    bundled,
    capital,
    example,
    gauge_files,
)
from aerobalance.app.cli.result import Manner, show
from aerobalance.app.cli.streams import given, given_all
from aerobalance.recording.components import STANDARD_GRAVITY

HalfRange = Annotated[
    list[str] | None,
    typer.Option("--half-range", help="With all: half of range, 'NF=2000' in N or N*m (repeatable)."),
]

app = typer.Typer()
identify = typer.Typer(
    help="Stiffness and damping of a balance, from a release, taps, a shaken rig, a published table or a stiffness.",
    epilog=f"Example: {PROGRAM} identify decay cut.csv --component AF --mass 177.87 -o dynamics.json",
    no_args_is_help=True,
)
app.add_typer(identify, name="identify")


@app.command(epilog=example("calibrate schedule.csv --model auto -o balance.json --report calibration.html"))
@bundled
def calibrate(
    schedule: Annotated[
        Path,
        typer.Argument(
            metavar="SCHEDULE",
            callback=given,
            help="Loads and gauge outputs: BALFIT csv, .vol, a text table or .xlsx.",
        ),
    ],
    out: Out = None,
    model: Annotated[
        TermModel, typer.Option("--model", help="Terms offered: 96 of AIAA R-091, or fewer; auto chooses among them.")
    ] = TermModel.AUTO,
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
    reading_noise: Annotated[
        list[str] | None,
        typer.Option(
            "--reading-noise",
            metavar="MV/V",
            help="Standard deviation of one reading of the schedule, where known: no part of the balance's scatter. "
            "One number, or rNF=0.0001 for each bridge (repeatable).",
        ),
    ] = None,
    leave_out: Annotated[
        list[str] | None,
        typer.Option(
            "--leave-out", metavar="'SERIES POINT'", help="Leave a point, or a whole series, out (may be given again)."
        ),
    ] = None,
    channel_map: Annotated[
        Path | None,
        typer.Option("--map", help="Channel map (TOML) that says what the columns of a table or spreadsheet are."),
    ] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Write a page with figures and tables.")] = None,
    *,
    manner: Manner,
) -> None:
    """Make a balance matrix from a load schedule, with its statistics."""
    from aerobalance.app.commands import calibration

    show(
        lambda: calibration.calibrate(
            schedule,
            out,
            model=model.value,
            way=way.value,
            keep_aside=keep_aside,
            capacities=capacity or (),
            distances=distances,
            reading_noise=calibration.reading_noise_from(reading_noise or ()),
            leave_out=leave_out or (),
            channel_map=channel_map,
            report=report,
        ),
        manner,
        doing="fitting the matrix",
    )


@app.command("compare-calibrations", epilog=example("compare-calibrations schedule_2022.csv schedule.csv"))
@bundled
def compare_calibrations(
    before: Annotated[Path, typer.Argument(metavar="BEFORE", help="balance.json, or a load schedule.")],
    after: Annotated[Path, typer.Argument(metavar="AFTER", help="The later one of the same balance.")],
    out: Out = None,
    model: Annotated[
        TermModel, typer.Option("--model", help="Terms offered where a schedule is given.")
    ] = TermModel.AUTO,
    *,
    manner: Manner,
) -> None:
    """Show what has changed between two calibrations of one balance, and whether it is more than chance."""
    from aerobalance.app.commands import calibration

    show(
        lambda: calibration.compare(before, after, out, model=model.value),
        manner,
        doing="comparing",
    )


@app.command(epilog=example("weigh points.csv -o mass.json"))
@bundled
def weigh(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", callback=given_all, help="Static points, or recordings.")
    ],
    out: Out = None,
    component: Annotated[
        str | None,
        typer.Option(
            "--component", callback=capital, help="Weigh with this force alone: AF, SF or NF; all loads if left out."
        ),
    ] = None,
    gravity: Gravity = STANDARD_GRAVITY,
    balance: MaybeBalance = None,
    zero: Zero = None,
    model_on_zero: OnZero = ModelOnZero.AUTO,
    channel_map: Map = None,
    scales: Annotated[
        str | None,
        typer.Option("--scales", help="Mass of the model on scales, '42.1 kg', to hold the result against."),
    ] = None,
    *,
    manner: Manner,
) -> None:
    """Find mass and centre of gravity from readings at several pitch (and roll) angles."""
    from aerobalance.app.commands import weighing

    show(
        lambda: weighing.weigh(
            files,
            out,
            component=component,
            gravity=gravity,
            files=gauge_files(balance, zero, model_on_zero, None, None),
            channel_map=channel_map,
            scales=scales,
        ),
        manner,
        doing="weighing",
    )


@identify.command("decay", epilog=example("identify decay cut.csv --component AF --mass 177.87 -o dynamics.json"))
@bundled
def identify_decay(
    recs: Annotated[
        list[Path],
        typer.Argument(metavar="REC", callback=given_all, help="A recording; several releases with --component all."),
    ],
    mass: Annotated[
        str | None,
        typer.Option(
            "--mass", help="Moving mass in kg: a number (taken as exact) or a mass.json. Optional for --component all."
        ),
    ] = None,
    out: Out = None,
    component: Annotated[
        str,
        typer.Option(
            "--component",
            callback=capital,
            help="NF, PM, SF, YM, RM or AF; all for six coupled ones, from releases.",
        ),
    ] = "AF",
    modes: Annotated[
        str | None,
        typer.Option(
            "--modes",
            help="How many modes: a number, or auto for those the data show. If left out 1; auto for --component all.",
        ),
    ] = None,
    half_range: HalfRange = None,
    *,
    gauges: Gauges,
    channel_map: Map = None,
    manner: Manner,
) -> None:
    """Identify from a free decay: a load that is held and released.

    With --component all and --balance, what the calibration of the balance leaves in A and D is counted.
    """
    files = gauges.files
    if component == "all":
        from aerobalance.app.commands import identify_coupled

        ranges = identify_coupled.half_ranges(half_range or ())
        show(
            lambda: identify_coupled.identify_decays(
                recs,
                out,
                mass=mass,
                half_range=ranges,
                modes=modes or "auto",
                files=files,
                channel_map=channel_map,
            ),
            manner,
            doing="fitting the releases",
        )
        return
    from aerobalance.app.commands import identify

    rec = _only(recs, half_range)
    if mass is None:
        raise ValueError("Missing option '--mass': a release tells mass over stiffness only")
    show(
        lambda: identify.identify_decay(
            rec, out, component=component, mass=mass, modes=modes or "1", files=files, channel_map=channel_map
        ),
        manner,
        doing="fitting the decay",
    )


@identify.command("rig", epilog=example("identify rig sweep.csv --component AF --mass 0.68 -o dynamics_rig.json"))
@bundled
def identify_rig(
    recs: Annotated[
        list[Path],
        typer.Argument(metavar="REC", callback=given_all, help="A recording; several shakes with --component all."),
    ],
    mass: Annotated[
        str | None,
        typer.Option("--mass", help="Moving mass in kg: a number, or a mass.json; identified when not given."),
    ] = None,
    out: Out = None,
    component: Annotated[
        str,
        typer.Option("--component", callback=capital, help="NF, PM, SF, YM, RM or AF; all for six coupled ones."),
    ] = "AF",
    modes: Modes = "1",
    half_range: HalfRange = None,
    *,
    gauges: Gauges,
    channel_map: Map = None,
    manner: Manner,
) -> None:
    """Identify from a shaken ground end: stepped sine, sweep or random."""
    files = gauges.files
    if component == "all":
        from aerobalance.app.commands import identify_coupled, identify_shaking

        if files is not None:
            raise ValueError(
                "--balance is for one component here; aerobalance loads --balance writes recordings of the loads, "
                "which identify rig --component all takes"
            )
        if modes != "1":
            raise ValueError("--modes is for one component; with --component all there is a mode for each")
        ranges = identify_coupled.half_ranges(half_range or ())
        show(
            lambda: identify_shaking.identify_shaken(recs, out, mass=mass, half_range=ranges, channel_map=channel_map),
            manner,
            doing="fitting the shaken records",
        )
        return
    from aerobalance.app.commands import identify

    rec = _only(recs, half_range)
    show(
        lambda: identify.identify_rig(
            rec, out, component=component, mass=mass, modes=modes, files=files, channel_map=channel_map
        ),
        manner,
        doing="fitting the response",
    )


def _only(recs: list[Path], half_range: list[str] | None) -> Path:
    """The one recording that one component is identified from.

    Raises
    ------
    ValueError
        There are several, or half ranges, which are for all components.
    """
    if len(recs) > 1:
        raise ValueError(
            f"{len(recs)} recordings were given; one component is identified from one (or --component all)"
        )
    if half_range:
        raise ValueError("--half-range goes with --component all")
    return recs[0]


@identify.command("frf", epilog=example("identify frf response.csv --component AF --mass 0.68 -o dynamics_frf.json"))
@bundled
def identify_frf(
    table: Annotated[
        Path,
        typer.Argument(metavar="TABLE", callback=given, help="Frequency, amplitude and phase with uncertainties."),
    ],
    mass: Mass,
    out: Out = None,
    component: Component = "AF",
    *,
    manner: Manner,
) -> None:
    """Identify from a published sine calibration: the response AF/F at some frequencies."""
    from aerobalance.app.commands import identify

    show(
        lambda: identify.identify_frf(table, out, component=component, mass=mass),
        manner,
        doing="fitting the table",
    )


@identify.command(
    "stiffness",
    epilog=example("identify stiffness stiffness.csv --mass rigid_mass.toml --ratios 0.01 -o dynamics_six.json"),
)
@bundled
def identify_stiffness(
    table: Annotated[
        Path,
        typer.Argument(
            metavar="K", callback=given, help="Stiffness: csv table of load over displacement, or JSON with u."
        ),
    ],
    mass: Annotated[
        Path,
        typer.Option("--mass", help="Mass, centre of gravity and inertia with uncertainties: TOML or JSON."),
    ],
    ratios: Annotated[
        str | None,
        typer.Option("--ratios", help="Damping ratio, '0.01' or '0.01+-0.002'; one for each mode, by commas, or all."),
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option("--compare", help="dynamics.json of releases or shaking to compare with; gives missing ratios."),
    ] = None,
    out: Out = None,
    *,
    manner: Manner,
) -> None:
    """Work out six components from weighed mass, inertia and a stiffness, and compare with those identified."""
    from aerobalance.app.commands import identify_stiffness

    show(
        lambda: identify_stiffness.from_stiffness(table, out, mass=mass, ratios=ratios, compare=compare),
        manner,
        doing="working out the dynamics",
    )
