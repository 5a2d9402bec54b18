"""Columns that a recording is written as, in the units that its file had."""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.recording import Recording
from aerobalance.recording.units import Conversion, conversion, conversion_for, edge_unit

ALL: Final = slice(None)
"""All rows."""

DIGITS: Final = 15
"""Digits that a number keeps through a change of unit."""

_POWERS: Final = np.array([float(f"1e{power}") for power in range(23)])
"""Powers of ten that a float64 holds exactly."""


def with_fifteen_digits(values: Array) -> Array:
    """Return numbers rounded to fifteen digits, each the nearest float64 to them, of the same shape."""
    found = np.array(values, dtype=np.float64)
    size = np.abs(found)
    # below 1e-8 the power of ten is no float64, and beyond 1e15 there is nothing behind the decimal point
    plain = (size >= 1e-7) & (size < 1e14)
    power = DIGITS - 1 - np.floor(np.log10(size, where=plain, out=np.zeros_like(size))).astype(np.intp)
    scale = _POWERS[np.clip(power, 0, _POWERS.size - 1)]
    with np.errstate(over="ignore", invalid="ignore"):
        whole = np.rint(found * scale)
    # the logarithm may be off by its rounding, next to a power of ten
    plain &= (np.abs(whole) >= 10.0 ** (DIGITS - 1)) & (np.abs(whole) < 10.0**DIGITS)
    np.divide(whole, scale, out=found, where=plain)
    others = np.flatnonzero(~plain & (size > 0) & np.isfinite(size))
    found.flat[others] = [float(f"{value:.{DIGITS}g}") for value in found.flat[others].tolist()]
    return found


def as_it_went_in(values: Array, change: Conversion) -> Array:
    """Give numbers in the unit of their file: 0.625 for 0.6250000000000001, where inside both mean the same."""
    outside = change.outside(values)
    short = with_fifteen_digits(outside)
    return np.where(change.inside(short) == values, short, outside)


def time_column(recording: Recording, rows: slice = ALL) -> dict[str, Array]:
    """Time column of a recording as its file had it, or some rows of it."""
    unit = recording.time_unit
    stamps = conversion(unit, expected="s").outside(recording.stamps[rows])
    # what a number keeps through a change of unit, so 0.625 ms comes out as it went in
    return {f"time [{unit}]": stamps if unit == "s" else with_fifteen_digits(stamps)}


def channel_column(channel: Channel, recording: Recording, rows: slice = ALL) -> dict[str, Array]:
    """Return a channel as a column of the rows of its recording, in the unit it had in its file."""
    unit = channel.file_unit or edge_unit(channel.name, channel.unit)
    change = conversion_for(channel.name, unit) if unit != channel.unit else None
    there = recording.rows
    # where no row is missing, rows are samples, and need not be picked out
    values = channel.values[rows] if there.size == channel.values.size else channel.values[there[rows]]
    return {f"{channel.name} [{unit}]": values if change is None else as_it_went_in(values, change)}


def stored_channel(channel: Channel) -> StoredChannel:
    """Return what is known of a channel, in the unit it had in its file."""
    unit = channel.file_unit or edge_unit(channel.name, channel.unit)
    factor = conversion_for(channel.name, unit).factor if unit != channel.unit else 1.0
    return StoredChannel(name=channel.name, unit=unit, **channel.known(factor=1 / factor))
