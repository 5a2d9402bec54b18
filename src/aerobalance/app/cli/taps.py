"""Commands of the lab that modal laboratories have a part in: taps of measured force, modes of another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerobalance.app.cli.lab import HalfRange, app, identify
from aerobalance.app.cli.options import (
    Gauges,
    Map,
    Out,
    bundled,
    capital,
    example,
)
from aerobalance.app.cli.result import Manner, show
from aerobalance.app.cli.streams import given, given_all

__all__ = ["app"]

SixOrOne = Annotated[
    str,
    typer.Option("--component", callback=capital, help="NF, PM, SF, YM, RM or AF; all for six coupled ones."),
]
MaybeMass = Annotated[
    str | None,
    typer.Option("--mass", help="Moving mass in kg: a number, or a mass.json. Optional for --component all."),
]


@identify.command("impact", epilog=example("identify impact taps.csv --component AF --mass 177.87 -o dynamics.json"))
@bundled
def identify_impact(
    recs: Annotated[
        list[Path],
        typer.Argument(
            metavar="REC",
            callback=given_all,
            help="Recordings with impact_force [N] beside the loads, each with taps at one point, or one of a shaker.",
        ),
    ],
    mass: MaybeMass = None,
    out: Out = None,
    component: SixOrOne = "AF",
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="X,Y,Z",
            help="Point of the taps in m: aft, right, up from the balance's centre. Once, or for each recording.",
        ),
    ] = None,
    direction: Annotated[
        list[str] | None,
        typer.Option(
            "--direction",
            metavar="DX,DY,DZ",
            help="Which way the hammer pushes: aft, forward, right, left, up, down, or three numbers; likewise.",
        ),
    ] = None,
    u_at: Annotated[
        float | None, typer.Option("--u-at", help="Standard uncertainty of a point in m (0.001).", min=0.0, max=0.5)
    ] = None,
    u_direction: Annotated[
        float | None,
        typer.Option("--u-direction", help="Standard uncertainty of a direction in degrees (1).", min=0.0, max=30.0),
    ] = None,
    modes: Annotated[
        str | None,
        typer.Option(
            "--modes",
            help="How many modes: a number, or auto for those the data show. If left out 1; auto for --component all.",
        ),
    ] = None,
    half_range: HalfRange = None,
    responses: Annotated[
        Path | None,
        typer.Option("--responses", help="Write the response functions for modal programs (.uff, datasets 58)."),
    ] = None,
    *,
    gauges: Gauges,
    channel_map: Map = None,
    manner: Manner,
) -> None:
    """Identify from taps with an instrumented hammer, or a shaker: a measured force at known points and directions."""
    from aerobalance.app.commands import identify_coupled, identify_impact

    if half_range and component != "all":
        raise ValueError("--half-range goes with --component all")
    files = gauges.files
    points = identify_impact.tap_points(at or (), direction or (), count=len(recs), u_at=u_at, u_direction=u_direction)
    ranges = identify_coupled.half_ranges(half_range or ())
    show(
        lambda: identify_impact.identify_impact(
            recs,
            out,
            component=component,
            mass=mass,
            points=points,
            half_range=ranges,
            modes=modes,
            files=files,
            channel_map=channel_map,
            responses=responses,
        ),
        manner,
        doing="fitting the taps",
    )


@identify.command("modes", epilog=example("identify modes modes.uff --component AF --mass 177.87 -o dynamics.json"))
@bundled
def identify_modes(
    modes: Annotated[
        Path,
        typer.Argument(
            metavar="MODES", callback=given, help="Universal file of a modal program, with its modes (datasets 55)."
        ),
    ],
    mass: MaybeMass = None,
    out: Out = None,
    component: SixOrOne = "AF",
    take: Annotated[
        list[int] | None,
        typer.Option("--mode", help="Take these modes only, by number; the slowest is 1 (may be given again)."),
    ] = None,
    *,
    manner: Manner,
) -> None:
    """Take poles and shapes that a modal program has found of the response functions of taps."""
    from aerobalance.app.commands import identify_modes as command

    show(
        lambda: command.identify_modes(modes, out, component=component, mass=mass, take=take or ()),
        manner,
        doing="taking the modes",
    )
