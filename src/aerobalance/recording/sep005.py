"""Time series as dictionaries, as SEP-005 of SDyPy has them: what they must hold, and their clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np

from aerobalance.recording.channel import Array

KEYS: Final = ("data", "name", "unit_str")
"""Keys that every series has."""

ALIKE: Final = 1e-12
"""Relative difference up to which two sampling rates are one."""


def clock_of_series(series: Sequence[Mapping[str, Any]]) -> tuple[Array, np.datetime64 | None]:
    """Time of every sample of series that have one clock, shape (n,) [s], and date and time (UTC) of time zero.

    Raises
    ------
    ValueError
        A key is missing or impossible, or the series have different clocks.
    """
    if not series:
        raise ValueError("there is no series in the list; at least one is needed")
    for number, one in enumerate(series, start=1):
        lacking = [key for key in KEYS if one.get(key) is None]
        if not lacking and one.get("fs") is None and one.get("time") is None:
            lacking = ["fs (or time)"]
        if lacking:
            raise ValueError(
                f"series {number} has no {lacking[0]}; SEP-005 asks for data, name, unit_str, and fs [Hz] or time [s]"
            )
        if np.ndim(one["data"]) != 1:
            raise ValueError(f"data of {one['name']} must have shape (n,), not {np.shape(one['data'])}")
        if not np.size(one["data"]):
            raise ValueError(f"data of {one['name']} has no sample")
    first = _stamps(series[0])
    for one in series[1:]:
        other = _stamps(one)
        if other.shape != first.shape or np.abs(other - first).max() > ALIKE * max(float(np.abs(first).max()), 1e-300):
            raise ValueError(
                f"{series[0]['name']} and {one['name']} have different clocks; make a recording of those of each "
                "clock, and join them (aerobalance.recording.joining.join)"
            )
    told = [one["start_timestamp"] for one in series if one.get("start_timestamp") is not None]
    dates = {str(one) for one in told}
    if len(dates) > 1:
        raise ValueError(f"the series begin at different times: {', '.join(sorted(dates))}")
    if not dates:
        return first, None
    return first, _date(told[0], dates.pop()) - np.timedelta64(round(1e9 * float(first[0])), "ns")


def _stamps(one: Mapping[str, Any]) -> Array:
    """Times of the samples of a series [s]."""
    count = np.shape(one["data"])[0]
    if one.get("time") is not None:
        stamps = np.asarray(one["time"], dtype=np.float64)
        if stamps.shape != (count,):
            raise ValueError(f"time of {one['name']} has shape {stamps.shape}, its data ({count},)")
        return stamps
    rate = float(one["fs"])
    if not 0 < rate < np.inf:
        raise ValueError(f"fs of {one['name']} must be above 0 Hz, not {one['fs']}")
    return np.arange(count) / rate


def _date(given: Any, text: str) -> np.datetime64:
    if isinstance(given, np.datetime64):
        exact: np.datetime64 = given.astype("datetime64[ns]")
        return exact
    if isinstance(given, datetime):
        return np.datetime64(given.astimezone(UTC).replace(tzinfo=None) if given.tzinfo else given, "ns")
    try:
        return np.datetime64(text.removesuffix("Z").removesuffix("+00:00"), "ns")
    except ValueError:
        raise ValueError(f"start_timestamp {text!r} is no date and time such as 2024-03-12T10:15:00.125") from None
