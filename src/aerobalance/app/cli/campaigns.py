"""Commands that reduce all runs of a test: campaign when it is over, watch while it goes on."""

from __future__ import annotations

from typing import Annotated

import typer

from aerobalance.app.cli.options import Json, Verbose, bundled, example
from aerobalance.app.cli.result import Manner, show

app = typer.Typer()

Test = Annotated[str, typer.Argument(metavar="FOLDER|TEST.toml", help="A folder of recordings, or a test file.")]
OutFolder = Annotated[
    str, typer.Option("-o", "--out", help="Folder of the results; earlier ones in it are continued.")
]
Dynamics = Annotated[
    str | None, typer.Option("--dynamics", help="The dynamics.json of all runs; a test file may name it instead.")
]
FolderBalance = Annotated[
    str | None, typer.Option("--balance", help="balance.json of a folder whose recordings are of gauge outputs.")
]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", help="Address of a Dask scheduler; this machine if left out.")
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        help="Processes on this machine, 0 for the command itself; left out: 0 up to 8 runs, else one per processor.",
        min=0,
    ),
]


def _tell(text: str) -> None:
    """Write a message to standard error, as standard output is for the result."""
    typer.echo(text, err=True)


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
    """Reduce each run of a test that is new or changed to one row: loads, forces, coefficients with uncertainty."""
    from aerobalance.app.campaign.engine import Engine
    from aerobalance.app.commands import campaign as command

    if scheduler is not None and workers is not None:
        raise ValueError("--scheduler and --workers exclude each other: a scheduler has workers of its own")

    engine = Engine(scheduler=scheduler, workers=workers, told=_tell)
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
        int, typer.Option("--workers", help="Processes on this machine; 0 for the command itself.", min=0)
    ] = 0,
    every: Annotated[float, typer.Option("--every", help="Time between two looks for new files in s.", min=0.1)] = 2.0,
    seconds: Annotated[
        float | None, typer.Option("--seconds", help="How long to watch in s; else until Ctrl-C.", min=0)
    ] = None,
    as_json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Do what campaign does while a test goes on: runs join the results as their files come in."""
    from aerobalance.app.commands import campaign as command

    show(
        lambda: command.watch(
            test, out, dynamics=dynamics, balance=balance, workers=workers, every=every, seconds=seconds, say=_tell
        ),
        Manner(as_json, verbose, replace=True),
        doing="watching",
    )
