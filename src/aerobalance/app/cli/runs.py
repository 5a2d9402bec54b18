"""Commands of every run: loads, force, compare, and plan before it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerobalance.app.cli.options import (
    Balance,
    Gauges,
    Gravity,
    Json,
    LoadForm,
    Map,
    Method,
    ModelOnZero,
    NeededOut,
    OnZero,
    PageOut,
    Rec,
    Tare,
    Verbose,
    Zero,
    ZeroAfter,
    bundled,
    capital,
    example,
)
from aerobalance.app.cli.result import Manner, show
from aerobalance.recording.components import STANDARD_GRAVITY

app = typer.Typer()


@app.command(epilog=example("loads run.txt --map map.toml --balance balance.json --zero zero.txt -o loads.csv"))
@bundled
def loads(
    rec: Rec,
    balance: Balance,
    out: NeededOut,
    zero: Zero = None,
    model_on_zero: OnZero = ModelOnZero.AUTO,
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
    *,
    manner: Manner,
) -> None:
    """Turn gauge outputs into the loads that the balance feels, with their uncertainty."""
    from aerobalance.app.commands import loads as command
    from aerobalance.app.commands.balance_files import BalanceFiles

    files = BalanceFiles.of(
        balance, zero=zero, model_on_zero=model_on_zero.value, zero_after=zero_after, tare=tare, mass=mass
    )
    show(
        lambda: command.loads(
            rec, out, files=files, form=None if form is None else form.value, channel_map=channel_map
        ),
        manner,
        doing="solving for the loads",
    )


@app.command(epilog=example("force run.csv --dynamics dynamics.json -o force.csv"))
@bundled
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
    keep_outliers: Annotated[
        bool, typer.Option("--keep-outliers", help="Take single samples far from their neighbours as they are.")
    ] = False,
    align: Annotated[
        bool,
        typer.Option(
            "--align", help="Bring accelerometer and inclinometer to the delay and gain that the load shows."
        ),
    ] = False,
    noise_record: Annotated[
        Path | None,
        typer.Option("--noise-record", help="Record of noise alone (wind off, at rest), for noise that is not white."),
    ] = None,
    *,
    gauges: Gauges,
    channel_map: Map = None,
    monte_carlo: Annotated[
        int | None, typer.Option("--monte-carlo", help="Check the uncertainty by so many draws (JCGM 101).", min=10)
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed of these draws.", min=0)] = 1,
    report: Annotated[
        Path | None, typer.Option("--report", help="Page (HTML) with load, force, spectrum and budget.")
    ] = None,
    manner: Manner,
) -> None:
    """Work out the force that was applied, with the standard uncertainty of every sample, its budget and a check."""
    from aerobalance.app.commands import force as command
    from aerobalance.estimation.forces import ForceSettings

    files = gauges.files

    show(
        lambda: command.force(
            rec,
            out,
            dynamics=dynamics,
            settings=ForceSettings(
                method.value, bandwidth, gravity, u_gravity, command.hum_of(hum), keep_outliers, align
            ),
            noise_record=noise_record,
            files=files,
            channel_map=channel_map,
            check=None if monte_carlo is None else command.Check(monte_carlo, seed),
            report=report,
        ),
        manner,
        doing="estimating the force",
    )


@app.command(epilog=example("plan --dynamics dynamics.json --noise 2 --rate 1600 --force 200"))
def plan(
    dynamics: Annotated[Path, typer.Option("--dynamics", help="The dynamics.json that identify wrote.")],
    noise: Annotated[
        list[str],
        typer.Option("--noise", help="Standard uncertainty of one reading of the load: 2, or NF=2 (repeatable)."),
    ],
    rate: Annotated[float, typer.Option("--rate", help="Sampling rate in Hz.")],
    component: Annotated[
        str | None, typer.Option("--component", callback=capital, help="Which component, where there are more.")
    ] = None,
    acceleration_noise: Annotated[
        float, typer.Option("--acceleration-noise", help="The same of the ground accelerometer, in m/s^2.")
    ] = 0.0,
    turn_noise: Annotated[
        float, typer.Option("--turn-noise", help="The same of the ground's angular acceleration, in rad/s^2.")
    ] = 0.0,
    force: Annotated[
        list[str] | None,
        typer.Option("--force", help="Root mean square of the force expected: 200, or NF=200 (repeatable)."),
    ] = None,
    bandwidth: Annotated[
        list[float] | None, typer.Option("--bandwidth", help="Highest frequency of the force in Hz (repeatable).")
    ] = None,
    as_json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Before the test: attainable uncertainty against bandwidth, and which sensor limits it."""
    from aerobalance.app.commands import plan as command
    from aerobalance.app.commands.shared import amounts

    noises, forces = amounts(noise, "--noise"), amounts(force or (), "--force")
    if noises is None:
        raise ValueError("--noise is needed")
    show(
        lambda: command.plan(
            dynamics,
            noise=noises,
            rate=rate,
            component=component,
            acceleration_noise=acceleration_noise,
            turn_noise=turn_noise,
            force=forces,
            bandwidths=bandwidth or (),
        ),
        Manner(as_json, verbose),
        doing="planning",
    )


@app.command(epilog=example("compare run.csv --dynamics dynamics.json --truth truth.csv -o compare.html"))
@bundled
def compare(
    rec: Rec,
    dynamics: Annotated[Path, typer.Option("--dynamics", help="The dynamics.json that identify wrote.")],
    truth: Annotated[
        Path | None, typer.Option("--truth", help="Force really applied, on the record's clock: time [s],AF [N].")
    ] = None,
    component: Annotated[
        str | None,
        typer.Option(
            "--component", callback=capital, help="Which component; AF if left out, or all that are coupled."
        ),
    ] = None,
    step: Annotated[
        Path | None,
        typer.Option("--step", help="Record of one step or impulse, for the black-box inverse; else the model's own."),
    ] = None,
    half_range: Annotated[
        list[str] | None,
        typer.Option(
            "--half-range",
            help="What percentages refer to, 2000 or NF=2000 (repeatable); half of the truth's span if left out.",
        ),
    ] = None,
    out: PageOut = None,
    gravity: Gravity = STANDARD_GRAVITY,
    *,
    gauges: Gauges,
    channel_map: Map = None,
    manner: Manner,
) -> None:
    """Show the estimator and the baseline methods side by side on one record, with errors where the truth is given."""
    from aerobalance.app.commands import compare as command
    from aerobalance.app.commands.shared import amounts

    files = gauges.files

    ranges = amounts(half_range or (), "--half-range")
    show(
        lambda: command.compare(
            rec,
            dynamics=dynamics,
            truth=truth,
            component=component,
            step=step,
            half_range=ranges,
            gravity=gravity,
            files=files,
            channel_map=channel_map,
            out=out,
        ),
        manner,
        doing="running the baseline methods",
    )
