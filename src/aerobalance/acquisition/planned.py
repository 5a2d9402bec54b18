"""From a test set-up to what is watched and recorded: ranges, limits, the load envelope, and the plan of a record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from aerobalance.acquisition.guards import (
    ContactCircuit,
    Guard,
    Limit,
    capacity_stations,
    envelope_limit,
    load_columns,
    loads_of,
)
from aerobalance.acquisition.intake import AtLevel, AtOnce, AtTime, OnCall, RecordPlan, Trigger, channel_columns
from aerobalance.acquisition.setup import Setup
from aerobalance.acquisition.source_settings import HALF_RANGES, Simulated
from aerobalance.balance.load_envelope import LoadEnvelope
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.errors import FitError
from aerobalance.recording.units import conversion_for

if TYPE_CHECKING:
    from aerobalance.balance.matrix import BalanceMatrix


@dataclass(frozen=True, slots=True)
class Ranges:
    """What channels and loads may read, SI.

    Attributes
    ----------
    half
        Half of the range, by name.
    limits
        Least and largest value of what has a limit, by name; infinite on the side that has none.
    envelope
        The loads that may act together; None where none is set up.
    """

    half: Mapping[str, float]
    limits: Mapping[str, tuple[float, float]]
    envelope: LoadEnvelope | None


def ranges_of(setup: Setup, channels: Sequence[StoredChannel], balance: BalanceMatrix | None) -> Ranges:
    """Find the ranges that a set-up gives: its own, or else the capacities of the balance or of the simulated rig.

    Parameters
    ----------
    setup
        The test set-up.
    channels
        The columns of the recording.
    balance
        The matrix that makes loads of them; None where they are loads.

    Raises
    ------
    FitError
        The load envelope cannot be made of them, or needs a load that is not measured.
    """
    half: dict[str, float] = {}
    if isinstance(setup.source, Simulated):
        half |= HALF_RANGES[setup.source.rig]
    units = {channel.name: channel.unit for channel in channels}
    if balance is not None:
        units |= {name: si_unit(name) for name in loads_of(balance)}
        half |= dict(zip(balance.components, map(float, balance.load_scale), strict=True))
    limits = {}
    for name, unit in units.items():
        inside = conversion_for(name, unit).inside
        channel, limit = setup.channels.get(name), setup.limits.get(name)
        if channel is not None and channel.half_range is not None:
            half[name] = float(inside(channel.half_range))
        if limit is not None:
            low = -math.inf if limit.low is None else float(inside(limit.low))
            limits[name] = (low, math.inf if limit.high is None else float(inside(limit.high)))
    half = {name: value for name, value in half.items() if name in units}
    envelope = _envelope(setup, half, limits, balance)
    lacking = [] if envelope is None else [name for name in envelope.components if name not in units]
    if lacking:
        raise FitError(f"the load envelope needs {', '.join(lacking)}; the source has {', '.join(units)}")
    return Ranges(half, limits, envelope)


def _envelope(
    setup: Setup,
    half: Mapping[str, float],
    limits: Mapping[str, tuple[float, float]],
    balance: BalanceMatrix | None,
) -> LoadEnvelope | None:
    shape = setup.envelope.shape
    if shape is None:
        return None
    stations = tuple(item.station(name) for name, item in setup.stations.items())
    if shape == "stations" or shape == "balance":  # noqa: PLR1714 - so that types are told apart
        return LoadEnvelope("box", {}, stations + (() if balance is None else capacity_stations(balance)))
    alone: dict[str, tuple[float, float]] = {
        name: limits.get(name) or (-half[name], half[name]) for name in COMPONENTS if name in {*half, *limits}
    }
    try:
        return LoadEnvelope(shape, alone, stations)
    except ValueError as problem:
        raise FitError(f"load envelope: {problem}; set limits or half ranges of the components") from None


def plan_of(
    setup: Setup, channels: tuple[StoredChannel, ...], rate: float, *, balance: BalanceMatrix | None = None
) -> RecordPlan:
    """Make the plan of a record.

    Parameters
    ----------
    setup
        The test set-up.
    channels
        The columns of the recording.
    rate
        Sampling rate [Hz].
    balance
        The matrix that makes loads of them; None where they are loads.

    Raises
    ------
    FitError
        The trigger, a limit or the contact circuit is on a channel that is not there, or a gauge output is missing.
    """
    record = setup.record
    columns = dict(channel_columns(channels))
    units = {channel.name: channel.unit for channel in channels}
    loads = None
    if balance is not None:
        wanted = {*setup.limits, record.channel} - {*columns}
        if setup.envelope.shape is not None or wanted & {*loads_of(balance)}:
            loads = load_columns(balance, channels)
            columns |= {name: len(channels) + place for place, name in enumerate(loads.names)}
            units |= {name: si_unit(name) for name in loads.names}
    guards: list[Guard] = [
        Limit(
            _column(columns, name, "limits"),
            -math.inf if limit.low is None else limit.low,
            math.inf if limit.high is None else limit.high,
            limit.action,
            name,
            units[name],
        )
        for name, limit in setup.limits.items()
    ]
    envelope = ranges_of(setup, channels, balance).envelope
    if envelope is not None:
        guards.append(envelope_limit(envelope, columns, units=units, action=setup.envelope.action))
    return RecordPlan(
        channels=channels,
        rate=rate,
        rows=max(1, round(record.block * rate)),
        trigger=_trigger(setup, columns, rate),
        before=round(record.pre_trigger * rate),
        length=None if record.seconds is None else max(1, round(record.seconds * rate)),
        limits=tuple(guards),
        after_limit=round(record.after_limit * rate),
        circuit=contact_circuit(setup, columns, units, rate),
        loads=loads,
    )


def _trigger(setup: Setup, columns: Mapping[str, int], rate: float) -> Trigger:
    record = setup.record
    if record.trigger == "time":
        return AtTime(round(record.delay * rate))
    if record.trigger == "call":
        return OnCall()
    if record.trigger == "level" and record.channel is not None and record.level is not None:
        column = _column(columns, record.channel, "record.channel")
        return AtLevel(column, record.level, record.edge == "rising", record.channel)
    return AtOnce()


def contact_circuit(
    setup: Setup, columns: Mapping[str, int], units: Mapping[str, str], rate: float
) -> ContactCircuit | None:
    """Return the contact circuit of a set-up; None where it has none.

    Raises
    ------
    FitError
        Its channel is not there.
    """
    fouling = setup.fouling
    if fouling.channel is None or fouling.level is None:
        return None
    column = _column(columns, fouling.channel, "fouling.channel")
    hold = max(1, round(fouling.hold * rate))
    above = fouling.closed == "above"
    return ContactCircuit(column, fouling.channel, units[fouling.channel], fouling.level, above, hold, fouling.action)


def _column(columns: Mapping[str, int], name: str, where: str) -> int:
    if name not in columns:
        raise FitError(f"{where}: the source has no channel {name}; it has {', '.join(columns)}")
    return columns[name]
