"""Commands on recordings: look, convert, map, record."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from aerobalance.app.cli import loading
from aerobalance.app.cli.options import (
    Json,
    Map,
    MapOut,
    Maps,
    NeededOut,
    ToRead,
    Verbose,
    bundled,
    example,
)
from aerobalance.app.cli.result import Manner, show
from aerobalance.app.cli.streams import given_all

app = typer.Typer()


@app.command(epilog=example("info run.csv"))
def info(
    file: ToRead,
    channel_map: Map = None,
    as_json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Show channels, units, rate, duration, gaps and saturation of a recording."""
    from aerobalance.app.commands import recordings

    show(lambda: recordings.info(file, channel_map=channel_map), Manner(as_json, verbose), doing="reading")


class Align(StrEnum):
    """How the clocks of several files are compared."""

    AUTO = "auto"
    TICK = "tick"
    TRIGGER = "trigger"
    CORRELATION = "correlation"
    START = "start"


@app.command(epilog=example("convert run.txt --map map.toml -o run.h5"))
@bundled
def convert(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE", callback=given_all, help="A recording; several of one event are aligned and made one."
        ),
    ],
    out: NeededOut,
    channel_map: Maps = None,
    align: Annotated[
        Align | None,
        typer.Option(
            "--align",
            help="How the clocks of several files are compared: by a channel tick that counts one clock, by the edges "
            "of a channel trigger, by the correlation of a channel that all have, or by the files' dates (start). "
            "auto: the first of the three that they have a channel for.",
        ),
    ] = None,
    by: Annotated[
        str | None, typer.Option("--by", metavar="CHANNEL", help="The channel by which several files are aligned.")
    ] = None,
    *,
    manner: Manner,
) -> None:
    """Convert a recording to the format of the output's ending; make one of several files of one event."""
    from aerobalance.app.commands import recordings

    how = recordings.AlignmentRequest(None if align is None else align.value, by)
    show(
        lambda: recordings.convert(files, out, channel_maps=channel_map or (), how=how),
        manner,
        doing="converting",
    )


@app.command("map", epilog=example("map run.txt -o new_map.toml"))
@bundled
def channel_map(
    file: ToRead,
    out: MapOut = None,
    header_line: Annotated[
        int | None,
        typer.Option(
            "--header-line", help="Line of a text file's header, where it is not found; 0 if there is none.", min=0
        ),
    ] = None,
    *,
    manner: Manner,
) -> None:
    """Make a channel map, to be filled in, for a foreign file."""
    from aerobalance.app.commands import recordings

    show(
        lambda: recordings.channel_map_for(file, out, header_line=header_line),
        manner,
        doing="reading",
    )


@app.command(epilog=example("record --source simulated --seconds 10 -o recorded.h5"))
def record(
    out: NeededOut,
    source: Annotated[
        str | None,
        typer.Option("--source", help="What gives the samples: simulated, replay, opendaq or nidaqmx."),
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
    verbose: Verbose = False,
) -> None:
    """Record a source to an HDF5 file, each block safe on the disk before the next; Ctrl-C ends it cleanly."""
    from aerobalance.app.commands import record as command
    from aerobalance.io.safe_write import OUTPUTS

    loading.done()
    OUTPUTS.begin(replace=replace)
    options = command.RecordOptions(source=source, file=file, rig=rig, seconds=seconds, speed=speed, seed=seed)
    with Console(stderr=True).status("starting ...") as status:
        result = command.record(out, setup=setup, options=options, replace=replace, show=status.update)
    show(lambda: result, Manner(as_json, verbose), doing="recording")


@app.command(epilog=example("publish --rig six --port 7420"))
def publish(
    setup: Annotated[
        Path | None, typer.Option("--setup", help="Test set-up (TOML): its source and channels are published.")
    ] = None,
    rig: Annotated[
        str | None, typer.Option("--rig", help="The simulated rig: vibration, cable_cut or six (components).")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Seed of the simulated noise.")] = None,
    port: Annotated[int, typer.Option("--port", help="Port to listen on.", min=1, max=65535)] = 7420,
) -> None:
    """Publish a source as an openDAQ device, open to the whole network; Ctrl-C ends it."""
    from aerobalance.app.commands import publish as command
    from aerobalance.app.commands.record import RecordOptions

    loading.done()
    typer.echo(command.publish(setup=setup, options=RecordOptions(rig=rig, seed=seed), port=port, say=typer.echo))


@app.command(epilog=example("monitor --setup test.toml"))
def monitor(
    setup: Annotated[
        Path | None, typer.Option("--setup", help="Test set-up (TOML); the simulated cable cut when not given.")
    ] = None,
    port: Annotated[
        int, typer.Option("--port", help="Port of the page; 0 for any free one.", min=0, max=65535)
    ] = 8765,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Do not open the page in the browser.")] = False,
    host: Annotated[
        str, typer.Option("--host", help="Address to listen on; other than this computer's own it needs a token.")
    ] = "127.0.0.1",
    token: Annotated[
        str | None, typer.Option("--token", help="What viewers have to know; better in a file or AEROBALANCE_TOKEN.")
    ] = None,
    token_file: Annotated[Path | None, typer.Option("--token-file", help="File with the token.")] = None,
    certificate: Annotated[Path | None, typer.Option("--certificate", help="Certificate for TLS.")] = None,
    key: Annotated[Path | None, typer.Option("--key", help="Key of the certificate.")] = None,
    folder: Annotated[
        Path | None,
        typer.Option("--folder", help="Project folder; that of the set-up, or the present one, if not given."),
    ] = None,
) -> None:
    """Open the operator's page: live load and force, records and their reports; Ctrl-C ends it."""
    import os

    from aerobalance.app.monitor import command
    from aerobalance.app.monitor.logins import find_token

    def warn(text: str) -> None:
        typer.echo(f"warning: {text}", err=True)

    loading.done()
    found = find_token(token, token_file, os.environ, warn)
    command.monitor(
        setup,
        reach=command.Reach(host, port, found, certificate, key),
        folder=folder,
        browser=not no_browser,
        last=True,
        say=typer.echo,
        warn=warn,
    )
