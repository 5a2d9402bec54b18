"""What of a test set-up the page watches: channels, dynamics, ranges and limits."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from aerobalance.acquire.feed import Hello
from aerobalance.acquire.setup import Setup, Simulated, stored_channels
from aerobalance.acquire.simulated import SIX_FREQUENCIES, rig_dynamics
from aerobalance.commands.loads import read_matrix
from aerobalance.dynamics import Dynamics
from aerobalance.io.dynamics_file import read_dynamics
from aerobalance.io.units import conversion_for
from aerobalance.monitor.view import Panel
from aerobalance.published import CABLE_CUT, VIBRATION_RIG

SIX_HALF_RANGES: Final = {"AF": 2000.0, **dict.fromkeys(SIX_FREQUENCIES, 2000.0)}
"""Half of the range of each component of the rig with six; those that are not printed are assumed [N, N*m]."""


def panel_of(setup: Setup, hello: Hello, folder: Path, zeros: Mapping[str, float]) -> Panel:
    """Say what is watched.

    Parameters
    ----------
    setup
        The test set-up.
    hello
        What the source says of itself.
    folder
        Where the set-up's files are.
    zeros
        What is taken off the loads, SI.

    Raises
    ------
    FitError, ReadError
        A channel has no such unit, or the dynamics cannot be read.
    """
    channels = stored_channels(setup, hello.channels)
    half_ranges = dict(_simulated_half_ranges(setup))
    limits = {}
    for channel in channels:
        inside = conversion_for(channel.name, channel.unit).inside
        given = setup.channels.get(channel.name)
        if given is not None and given.half_range is not None:
            half_ranges[channel.name] = float(inside(given.half_range))
        limit = setup.limits.get(channel.name)
        if limit is not None:
            low = -float("inf") if limit.low is None else float(inside(limit.low))
            high = float("inf") if limit.high is None else float(inside(limit.high))
            limits[channel.name] = (low, high)
    return Panel(
        channels=channels,
        rate=hello.rate,
        clocked=hello.clocked,
        dynamics=dynamics_of(setup, folder),
        half_ranges=half_ranges,
        limits=limits,
        zeros=dict(zeros),
        balance=None if setup.files.balance is None else read_matrix(folder / setup.files.balance),
    )


def dynamics_of(setup: Setup, folder: Path) -> dict[str, Dynamics]:
    """Dynamics that the set-up names; of a simulated rig, where it names none, those that it is simulated with.

    Raises
    ------
    ReadError
        The file cannot be used.
    """
    if setup.files.dynamics is not None:
        return dict(read_dynamics(folder / setup.files.dynamics))
    if isinstance(setup.source, Simulated):
        return {dynamics.component: dynamics for dynamics in rig_dynamics(setup.source.rig)}
    return {}


def _simulated_half_ranges(setup: Setup) -> Mapping[str, float]:
    if not isinstance(setup.source, Simulated):
        return {}
    if setup.source.rig == "vibration":
        return {"AF": VIBRATION_RIG.half_range.value}
    return {"AF": CABLE_CUT.half_range.value} if setup.source.rig == "cable_cut" else SIX_HALF_RANGES
