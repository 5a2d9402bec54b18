"""The source that a test set-up asks for; what its kind needs is imported with it, as that takes up to seconds."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from aerobalance.acquisition.setup import Setup
from aerobalance.acquisition.source import Chosen, Source
from aerobalance.acquisition.source_settings import Nidaqmx, Opendaq, Replay, Simulated, SourceSettings


def open_source(setup: Setup, folder: Path) -> Source:
    """Make the source of a set-up, with the channels that the set-up lists.

    Parameters
    ----------
    setup
        The set-up.
    folder
        Where its files are looked for.

    Raises
    ------
    FitError
        The source lacks a channel.
    ReadError, ValueError
        The source cannot be made as set.
    """
    inputs = [channel.input or name for name, channel in setup.channels.items()]
    source = _opened(setup.source, folder, inputs=inputs)
    return Chosen(source, inputs) if inputs else source


def _opened(settings: SourceSettings, folder: Path, *, inputs: Sequence[str]) -> Source:
    match settings:
        case Simulated():
            return _simulated(settings, folder)
        case Replay():
            return _replay(settings, folder)
        case Opendaq():
            return _opendaq(settings, inputs)
        case Nidaqmx():
            return _nidaqmx(settings)
    raise ValueError(f"there is no source for settings of the kind {settings.kind!r}")


def _simulated(settings: Simulated, folder: Path) -> Source:
    from aerobalance.acquisition.simulated import RigSettings, SimulatedSource  # noqa: PLC0415
    from aerobalance.io.balance_file import read_matrix  # noqa: PLC0415

    matrix = None if settings.balance is None else read_matrix(folder / settings.balance)
    return SimulatedSource(RigSettings(**settings.model_dump(exclude={"kind", "balance"}), balance=matrix))


def _replay(settings: Replay, folder: Path) -> Source:
    from aerobalance.acquisition.replay import ReplaySource  # noqa: PLC0415

    return ReplaySource(
        folder / settings.file,
        channel_map=None if settings.map is None else folder / settings.map,
        speed=settings.speed,
        block=settings.block,
        loop=settings.loop,
    )


def _opendaq(settings: Opendaq, inputs: Sequence[str]) -> Source:
    from aerobalance.acquisition.library_process import LibraryProcess  # noqa: PLC0415
    from aerobalance.acquisition.opendaq import OpendaqSource  # noqa: PLC0415

    names = tuple(dict.fromkeys(inputs)) or None
    return LibraryProcess(partial(OpendaqSource, settings.address, names=names, block=settings.block))


def _nidaqmx(settings: Nidaqmx) -> Source:
    """Set the task up; all inputs are read, as the order in which a device takes them makes their delays."""
    from aerobalance.acquisition.nidaqmx import NidaqmxSource  # noqa: PLC0415

    return NidaqmxSource(**settings.model_dump(include={"rate", "server", "skew", "block"}), inputs=settings.inputs)
