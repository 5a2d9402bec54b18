"""The command publish: a source that other programs on the network can read as an openDAQ device."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

from aerobalance.acquisition.opendaq_server import PORT, PublishedDevice
from aerobalance.acquisition.source import SourceEndedError
from aerobalance.acquisition.sources import open_source
from aerobalance.app.commands.record import RecordOptions, chosen_setup

_TICK = 0.1


def publish(
    *,
    setup: Path | None = None,
    options: RecordOptions | None = None,
    port: int = PORT,
    say: Callable[[str], None] | None = None,
) -> str:
    """Give a source to the network until its end, Ctrl-C or SIGTERM; return why it ended.

    Parameters
    ----------
    setup
        Test set-up; its source and channels count.
    options
        What replaces it in the set-up.
    port
        Where to listen.
    say
        Takes a line once the device can be reached.

    Raises
    ------
    FitError
        openDAQ is not installed, the port is taken, or the source cannot be used.
    ReadError, ValueError
        The set-up or the call is wrong.
    """
    told: list[str] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda *_: told.append("stopped")) for number in numbers}
    try:
        folder = Path() if setup is None else setup.parent
        source = open_source(chosen_setup(setup, options or RecordOptions()), folder.resolve())
        device = PublishedDevice(source, port=port)
        source.start()
        if say is not None:
            say(f"{source.description}: an openDAQ device on port {port} of all addresses of this computer")
        while not told:
            block = source.read(_TICK)
            if block is not None:
                device.give(block)
    except SourceEndedError as end:
        return str(end)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    source.stop()
    return told[0]
