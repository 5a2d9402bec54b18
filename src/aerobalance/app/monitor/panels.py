"""What of a test set-up the page watches: channels, dynamics, ranges, limits and contact circuit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from aerobalance.acquisition.feed import SourceInfo
from aerobalance.acquisition.intake import channel_columns
from aerobalance.acquisition.planned import contact_circuit, ranges_of
from aerobalance.acquisition.setup import Setup, stored_channels
from aerobalance.acquisition.simulated import rig_dynamics
from aerobalance.acquisition.source_settings import Simulated
from aerobalance.app.monitor.view import Panel
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.independent import NO_DYNAMICS
from aerobalance.io.balance_file import read_matrix
from aerobalance.io.dynamics_file import read_any_dynamics
from aerobalance.recording.errors import FitError


def panel_of(setup: Setup, info: SourceInfo, folder: Path, zeros: Mapping[str, float]) -> Panel:
    """Return what is watched.

    Parameters
    ----------
    setup
        The test set-up.
    info
        What the source says of itself.
    folder
        Where the set-up's files are.
    zeros
        What is taken off the loads, SI.

    Raises
    ------
    FitError, ReadError
        A channel has no such unit, the load envelope lacks something, or a file cannot be read.
    """
    channels = stored_channels(setup, info.channels)
    dynamics = watched_dynamics(setup, folder)
    balance = None if setup.files.balance is None else read_matrix(folder / setup.files.balance)
    ranges = ranges_of(setup, channels, balance)
    units = {channel.name: channel.unit for channel in channels}
    panel = Panel(
        channels=channels,
        rate=info.rate,
        clocked=info.clocked,
        dynamics=dynamics,
        half_ranges=ranges.half,
        limits=ranges.limits,
        zeros=dict(zeros),
        balance=balance,
        envelope=ranges.envelope,
        gravity=setup.gravity,
        circuit=contact_circuit(setup, channel_columns(channels), units, info.rate),
    )
    for block in dynamics.blocks:
        lacking = [name for name in block.components if name not in panel.names]
        if lacking and len(block.components) > 1:
            raise FitError(
                "the components of the dynamics are coupled, so the force of each needs the readings of all: there is "
                f"no {', '.join(lacking)} among {', '.join(panel.names)}"
            )
    return panel


def watched_dynamics(setup: Setup, folder: Path) -> BalanceDynamics:
    """Dynamics that the set-up names; of a simulated rig, where it names none, those that it is simulated with.

    Raises
    ------
    ReadError
        The file cannot be used.
    """
    if setup.files.dynamics is not None:
        return read_any_dynamics(folder / setup.files.dynamics)
    if isinstance(setup.source, Simulated):
        return rig_dynamics(setup.source.rig)
    return NO_DYNAMICS
