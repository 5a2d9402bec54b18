"""What files say of their series in attributes: units, clocks, packing, dates; the usual keys of many programs."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np

from aerobalance.io.columns import Clock
from aerobalance.io.sensor_text import KEY, sensor_of
from aerobalance.recording.channel import Array, SensorSpec

RATE_KEYS: Final = (
    *("fs", "rate", "samplerate", "samplingrate", "samplefrequency", "samplingfrequency", "sr"),
    *("samplespersecond", "scanrate", "abtastrate"),
)
"""Keys of a sampling rate [Hz], in small letters without spaces and signs."""

INTERVAL_KEYS: Final = (
    *("dt", "ts", "wfincrement", "interval", "xincrement", "deltat", "deltax", "sampleinterval", "samplinginterval"),
    *("samplingperiod", "timestep", "timeincrement"),
)
"""Keys of a sampling interval [s]."""

START_KEYS: Final = ("t0", "x0", "wfstartoffset", "starttime", "timestart", "tstart")
"""Keys of the time of the first sample [s]."""

UNIT_KEYS: Final = ("unit", "units", "unitstring", "unitstr", "niunitdescription", "eu", "yunit", "yunits", "einheit")
"""Keys of a unit."""

EPOCH_KEYS: Final = ("epoch", "wfstarttime", "starttimestamp", "startdatetime", "starttimeutc")
"""Keys of the date and time of time zero."""

_SINCE: Final = re.compile(r"\s*(?P<unit>[A-Za-zµ]+)\s+since\s+(?P<date>.{4,40})", re.IGNORECASE)
_UNITS_OF_TIME: Final = {
    **dict.fromkeys(("seconds", "second", "secs", "sec"), "s"),
    **dict.fromkeys(("milliseconds", "millisecond", "msecs", "msec", "millis"), "ms"),
    **dict.fromkeys(("microseconds", "microsecond", "micros"), "us"),
    **dict.fromkeys(("nanoseconds", "nanosecond", "nanos"), "ns"),
    **dict.fromkeys(("minutes", "minute"), "min"),
    **dict.fromkeys(("hours", "hour"), "h"),
    **dict.fromkeys(("days", "day"), "day"),
}
_SHORTEST: Final = 1e-12
_LONGEST: Final = 1e6


def plain_keys(given: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes by their keys in small letters without spaces and signs; the first of those that are alike."""
    found: dict[str, Any] = {}
    for key, value in given.items():
        found.setdefault(re.sub(r"[^a-z0-9]", "", str(key).casefold()), value)
    return found


def text_of(value: Any, *, longest: int = 200) -> str:
    """Text of an attribute, which may be bytes or an array of one; an empty string where it is none."""
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else ""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    return "".join(sign for sign in value if sign.isprintable()).strip()[:longest] if isinstance(value, str) else ""


def number_of(value: Any) -> float | None:
    """Number of an attribute; None where it is none, or not finite."""
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else None
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.number):
        return None
    if isinstance(value, np.complexfloating):
        return None
    number = float(value)
    return number if np.isfinite(number) else None


def unit_of(plain: Mapping[str, Any]) -> str:
    """Unit that attributes state, by their `plain_keys`; an empty string where they state none."""
    text = next((text for key in UNIT_KEYS if (text := text_of(plain.get(key)))), "")
    return "" if text.casefold() in ("none", "unknown", "n/a", "-") else text


def sensor_said(plain: Mapping[str, Any]) -> SensorSpec:
    """What attributes state of the sensor, as this program writes it, by their `plain_keys`."""
    return sensor_of(text_of(plain.get(KEY), longest=4096))


def clock_of(plain: Mapping[str, Any]) -> Clock | None:
    """Clock that attributes state, by their `plain_keys`; None where they state none."""
    rates = (number_of(plain[key]) for key in RATE_KEYS if key in plain)
    intervals = (number_of(plain[key]) for key in INTERVAL_KEYS if key in plain)
    interval = next((given for given in intervals if given is not None), None)
    if interval is None:
        rate = next((given for given in rates if given is not None), None)
        interval = 1 / rate if rate else None
    if interval is None or not _SHORTEST <= interval <= _LONGEST:
        return None
    starts = (number_of(plain[key]) for key in START_KEYS if key in plain)
    start = next((given for given in starts if given is not None), 0.0)
    return Clock(start, interval)


def epoch_of(plain: Mapping[str, Any]) -> np.datetime64 | None:
    """Date and time of time zero that attributes state; None where they state none."""
    return next((date for key in EPOCH_KEYS if (date := date_of(plain.get(key))) is not None), None)


def date_of(given: Any) -> np.datetime64 | None:
    """Date and time (UTC where a zone is stated) of text in ISO 8601, or of a date; None where it is none."""
    if isinstance(given, np.datetime64):
        return None if np.isnat(given) else given.astype("datetime64[ns]")
    if isinstance(given, datetime):
        bare = given.astimezone(UTC).replace(tzinfo=None) if given.tzinfo else given
        return np.datetime64(bare, "ns") if 1700 < bare.year < 2200 else None
    text = text_of(given)
    if not text:
        return None
    digits = re.search(r"\.(\d{7,9})", text)  # nanoseconds, which dates of Python do not have
    try:
        found = date_of(
            datetime.fromisoformat(text.removesuffix(" UTC") + ("+00:00" if text.endswith(" UTC") else ""))
        )
    except (ValueError, OverflowError):
        return None
    return found if digits is None or found is None else found + np.timedelta64(int(digits[1].ljust(9, "0")[6:]), "ns")


def since(unit: str) -> tuple[str, np.datetime64 | None]:
    """Unit of time and date of ``seconds since 2024-03-12``, as CF has it; other units come back as they are."""
    match = _SINCE.fullmatch(unit)
    word = (match["unit"] if match else unit).strip()
    short = _UNITS_OF_TIME.get(word.casefold(), word)
    return (short, date_of(match["date"].strip())) if match else (short, None)


def unpacked(read: Callable[[int, int], Any], plain: Mapping[str, Any]) -> Callable[[int, int], Any]:
    """Undo what CF calls packed data: missing where it is ``_FillValue``, then ``scale_factor`` and ``add_offset``."""
    scale = number_of(plain.get("scalefactor"))
    offset = number_of(plain.get("addoffset"))
    fills = [one for key in ("fillvalue", "missingvalue") if (one := number_of(plain.get(key))) is not None]
    if scale is None and offset is None and not fills:
        return read

    def change(begin: int, end: int) -> Array:
        given = np.asarray(read(begin, end))
        values = given.astype(np.float64)
        for fill in fills:
            values[given == fill] = np.nan
        if (scale, offset) != (None, None):
            values = values * (1.0 if scale is None else scale) + (offset or 0.0)
        return values

    return change
