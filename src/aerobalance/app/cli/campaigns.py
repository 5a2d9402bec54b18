"""Commands on whole tests: campaign and watch."""

from __future__ import annotations

from typing import Annotated

import typer

from aerobalance.app.cli.options import Json, Verbose, bundled, example
from aerobalance.app.cli.result import Manner, show

app = typer.Typer()

Test = Annotated[str, typer.Argument(metavar="FOLDER|TEST.toml", help="A folder of recordings, or a test file.")]
OutFolder = Annotated[str, typer.Option("-o", "--out", help="Folder of the results; an earlier one is gone on with.")]
Dynamics = Annotated[
    str | None, typer.Option("--dynamics", help="The dynamics.json of all runs; a test file may name it instead.")
]
FolderBalance = Annotated[
    str | None, typer.Option("--balance", help="balance.json of a folder whose recordings are of gauge outputs.")
]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", help="Address of a Dask scheduler; this machine's processors if left out.")
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers", help="Processes of this machine; if left out one a processor, and none for up to 8 runs.", min=0
    ),
]


@app.command(epilog=example("campaign runs --dynamics dynamics.json -o results"))
@bundled
def campaign(
    test: Test,
    out: OutFolder,
    dynamics: Dynamics = None,
    balance: FolderBalance = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    *,
    manner: Manner,
) -> None:
    """Reduce many runs to one row each: loads, forces, coefficients with uncertainty; only what is not done yet."""
    from aerobalance.app.campaign.engine import Engine
    from aerobalance.app.commands import campaign as command

    if scheduler is not None and workers is not None:
        raise ValueError("--scheduler and --workers exclude each other: a scheduler has workers of its own")

    def say(text: str) -> None:
        typer.echo(text, err=True)

    engine = Engine(scheduler=scheduler, workers=workers, told=say)
    show(
        lambda: command.campaign(test, out, dynamics=dynamics, balance=balance, engine=engine, replace=manner.replace),
        manner,
        doing="reducing runs",
    )


@app.command(epilog=example("watch runs --dynamics dynamics.json --seconds 3 -o watched"))
def watch(
    test: Test,
    out: OutFolder,
    dynamics: Dynamics = None,
    balance: FolderBalance = None,
    workers: Annotated[
        int, typer.Option("--workers", help="Processes of this machine; 0 for the command itself.", min=0)
    ] = 0,
    every: Annotated[float, typer.Option("--every", help="Time between two looks in s.", min=0.1)] = 2.0,
    seconds: Annotated[
        float | None, typer.Option("--seconds", help="How long to watch in s; else until Ctrl-C.", min=0)
    ] = None,
    as_json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Do what campaign does while a test goes on: runs join the results as their files come in."""
    from aerobalance.app.commands import campaign as command

    def say(text: str) -> None:
        typer.echo(text, err=True)

    show(
        lambda: command.watch(
            test, out, dynamics=dynamics, balance=balance, workers=workers, every=every, seconds=seconds, say=say
        ),
        Manner(as_json, verbose, replace=True),
        doing="watching",
    )
