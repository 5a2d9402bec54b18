"""The clock of a text table: a column of times, date-time stamps, or a rate that its preamble states."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.text_cells import MONTHS, number_in, stamp_format, stamp_pattern
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError
from aerobalance.recording.units import conversion

ALIKE: Final = 0.02
"""Relative difference up to which two statements of one sampling rate agree."""

UNITS_OF_TIME: Final = ("s", "ms", "us", "min")
"""Units that a column of times may be in where the file does not say it."""

_TIMES: Final = re.compile(
    r"(?:(?:abs|rel|absolute?s?|relative?|elapsed|mess|mes)[ ._]*)?"
    r"(?:time|zeit|temps|tiempo|tempo|tijd|tid|aika|czas|t|x[ _-]?values?|uhrzeit|messzeit|zeitkanal|zeitachse"
    r"|zeitstempel|timestamp|horodatage|datum/uhrzeit|date/time|datetime|date_time)(?![^\W\d_]).*",
    re.IGNORECASE,
)
_INDICES: Final = re.compile(
    r"(?:index|nr|no|num|sample|samples|row|zeile|messwert|n|i|#|punkt|point)\b.*", re.IGNORECASE
)

_RATE_NAMES: Final = (
    r"abtastrate|abtastfrequenz|messrate|messfrequenz|samplingrate|samplerate|(?:sampling|sample|scan|acquisition|data)"
    r"[ _]*(?:rate|frequency|freq)|fr[eé]quence d.[eé]chantillonnage|frecuencia de muestreo|"
    r"frequenza di campionamento|f_?s"
)
_OF_LABVIEW: Final = r"delta[ _]?[xt]"
_INTERVAL_NAMES: Final = (
    rf"{_OF_LABVIEW}|d_?t|Δt|abtastintervall|abtastzeit|abtastperiode|(?:sampling|sample|scan)[ _]*"
    r"(?:interval|period|time)|time[ _]*(?:step|increment)|schrittweite|zeitschritt|zeitinkrement|increment"
    r"|pas de temps|p[eé]riode d.[eé]chantillonnage"
)
_STATED: Final = re.compile(
    rf"[\s#%*/\"';]*(?:(?P<rate>{_RATE_NAMES})|(?P<interval>{_INTERVAL_NAMES}))\s*"
    r"(?:[\[(](?P<before>[^\])]{1,12})[\])])?[\s:=;,\"]+(?P<number>[+-]?\d[\d.,]*(?:[eE][+-]?\d+)?)[\s;\"]*(?:,\s*)?"
    r"[\[(]?(?P<after>[A-Za-zµμ/%][A-Za-z0-9µμ/^]{0,8})?",
    re.IGNORECASE,
)
_THOUSANDS: Final = re.compile(r"\d{1,3}(?P<sign>[.,])\d{3}(?:(?P=sign)\d{3})*(?:[.,]\d+)?")


@dataclass(frozen=True, slots=True)
class StatedRate:
    """A sampling rate that the text before the header states.

    Attributes
    ----------
    rate
        The rate [Hz].
    line
        The line that states it, counted from 1.
    text
        That line.
    """

    rate: float
    line: int
    text: str


@dataclass(frozen=True, slots=True)
class FoundClock:
    """The column of times of a text table.

    Attributes
    ----------
    column
        Its position, counted from 0.
    unit
        Its unit; an empty string where the file does not say it.
    interval
        Usual step from row to row at the head of the table [`unit`].
    stamps
        Whether it holds date-time stamps; the unit is s then.
    named
        Whether its name or its unit says that it is a time.
    second_time
        Position of a second column of times that steps otherwise; None where there is none.
    spread
        Difference of the longest and the shortest step, over the time that the head of the table spans [1].
    """

    column: int
    unit: str
    interval: float
    stamps: bool = False
    named: bool = True
    second_time: int | None = None
    spread: float = 0.0

    @property
    def rate(self) -> float | None:
        """Rows per second at the head of the table [Hz]; None where no unit or no step is known."""
        if not self.unit or not self.interval > 0:
            return None
        return 1 / float(conversion(self.unit, expected="s").inside(self.interval))

    def agrees(self, rate: float) -> bool:
        """Return whether the steps are those of a sampling rate [Hz]; in any unit of time where none is stated."""
        units = (self.unit,) if self.unit else UNITS_OF_TIME
        rates = [replace(self, unit=unit).rate for unit in units]
        near = ALIKE + self.spread
        return not any(rates) or any(own is not None and abs(own / rate - 1) <= near for own in rates)


def is_time_name(name: str) -> bool:
    """Return whether a column's name is one of the usual names of a time, in several languages."""
    return _TIMES.fullmatch(name.strip()) is not None


def is_time_unit(unit: str) -> bool:
    """Return whether a unit is one of time."""
    try:
        conversion(unit, expected="s")
    except ValueError:
        return False
    return True


def find_clock(
    names: Sequence[str], units: Sequence[str], kinds: Sequence[str], rows: Sequence[Sequence[str]]
) -> FoundClock | None:
    """Find the column of times by name, unit and steps; None where no column is one.

    Parameters
    ----------
    names, units, kinds
        Of each column.
    rows
        Cells of the first rows of the table.
    """
    found, stamped, bare = [], [], []
    for i, kind in enumerate(kinds):
        cells = [row[i] for row in rows if i < len(row)]
        if kind == "stamp" and not is_time_unit(units[i]):
            stamped.append(i)
            continue
        steps = _steps(cells) if kind == "number" else None
        if steps is None:
            continue
        usual, spread = _usual(steps)
        clock = FoundClock(i, units[i], usual, spread=spread)
        if units[i] and is_time_unit(units[i]):
            found.append(clock)
        elif not units[i] and is_time_name(names[i]):
            bare.append(clock)
        elif not units[i] and not bare and not found and _even(names[i], steps) and "number" not in kinds[:i]:
            bare.append(FoundClock(i, "", usual, named=False))
    if found:
        best = next((clock for clock in found if is_time_name(names[clock.column])), found[0])
        return _with_second_time(best, [clock for clock in found if is_time_name(names[clock.column])])
    named = [clock for clock in bare if clock.named]
    if named or (bare and not stamped):
        return (named or bare)[0]
    return _of_stamps(stamped, names, rows)


def _with_second_time(best: FoundClock, named: list[FoundClock]) -> FoundClock:
    """Add a second column of times that runs at another rate."""
    if best.rate is None:
        return best
    for other in named:
        if other.rate is not None and abs(other.rate / best.rate - 1) > ALIKE:
            return replace(best, second_time=other.column)
    return best


def _usual(steps: Array) -> tuple[float, float]:
    """Usual step, and how far steps spread over their sum."""
    if not steps.size:
        return 0.0, 0.0
    median, total = float(np.median(steps)), float(steps.sum())
    # Rounded times step unevenly: their mean is better, but for a gap among them.
    usual = float(steps.mean()) if median == 0.0 or steps.max() < 2.5 * median else median
    return usual, float(np.ptp(steps)) / total if total > 0 else 0.0


def _steps(cells: Sequence[str]) -> Array | None:
    """Steps from cell to cell; None where a cell is no number or lies before the one above it."""
    values = []
    for cell in cells:
        value = number_in(cell)
        value = number_in(cell, decimal=",") if value is None else value
        if value is not None:
            values.append(value)
    steps = np.diff(np.array(values, dtype=np.float64))
    if steps.size and ((steps < 0).any() or not (steps > 0).any()):
        return None
    return steps


def _even(name: str, steps: Array) -> bool:
    """Whether a column without name and unit of a time steps as one: evenly, and not as an index counts."""
    if steps.size < 3 or _INDICES.fullmatch(name.strip()):
        return False
    usual = float(np.median(steps))
    return usual > 0 and usual != 1.0 and bool((np.abs(steps - usual) < 0.02 * usual).all())


def _of_stamps(columns: Sequence[int], names: Sequence[str], rows: Sequence[Sequence[str]]) -> FoundClock | None:
    """The clock of the first column of date-time stamps; one with a date comes before the time of day."""
    best: FoundClock | None = None
    for i in sorted(columns, key=lambda i: not is_time_name(names[i])):
        cells = [row[i] for row in rows if i < len(row)]
        form = next((form for form in map(stamp_format, cells) if form), None)
        if form is None:
            continue
        values = stamp_seconds(cells, form)
        steps = np.diff(values[np.isfinite(values)])
        if (steps >= 0).all() and best is None:
            usual, spread = _usual(steps)
            best = FoundClock(i, "s", usual, stamps=True, spread=spread)
    return best


def stated_rate(lines: Sequence[str], decimal: str | None) -> StatedRate | None:
    """Find the sampling rate that the text before the header states; None where there is none or several differ.

    Parameters
    ----------
    lines
        The text, line by line from the first of the file.
    decimal
        Decimal sign of the table, where known: it tells 5.000 Hz from 5 kHz.
    """
    found: list[StatedRate] = []
    for number, line in enumerate(lines, start=1):
        match = _STATED.match(line[:200])
        rate = None if match is None else _rate_of(match, decimal)
        if rate is not None:
            found.append(StatedRate(rate, number, line.strip()))
    if not found or any(abs(other.rate / found[0].rate - 1) > ALIKE for other in found):
        return None
    return found[0]


def _rate_of(match: re.Match[str], decimal: str | None) -> float | None:
    """The rate that a line states [Hz]; None where number or unit are in doubt."""
    text, unit = match["number"].rstrip(".,"), match["before"] or match["after"] or ""
    grouped = _THOUSANDS.fullmatch(text)
    if grouped and decimal is None:
        return None
    if grouped and grouped["sign"] != decimal:
        text = text.replace(grouped["sign"], "")
    value = number_in(text.replace(",", "."))
    if value is None or not value > 0:
        return None
    if match["rate"]:
        unit = re.sub(r"^(k|M)?(?:S|Sa|Samples|1|Werte)/s(?:ec)?$", r"\1Hz", unit or "Hz", flags=re.IGNORECASE)
        kind = "Hz"
    else:
        unit = unit or ("s" if re.fullmatch(_OF_LABVIEW, match["interval"], re.IGNORECASE) else "")
        kind = "s"
    try:
        inside = float(conversion(unit, expected=kind).inside(value))
    except ValueError:
        return None
    return (inside if kind == "Hz" else 1 / inside) if inside > 0 else None


def seconds_of(
    path: Path, cells: Sequence[str], *, lines: Sequence[int] | NDArray[np.intp], place: str
) -> tuple[Array, np.datetime64 | None]:
    """Turn date-time stamps into seconds since the first, and say when that was.

    Parameters
    ----------
    path
        The file, for messages.
    cells
        The stamps, all in one of the ways of `aerobalance.io.text_cells.STAMPS`.
    lines
        Line of every cell.
    place
        The column, for messages.

    Returns
    -------
    seconds
        Shape (n,) [s]; NaN where a cell is empty.
    first
        Date and time of the first stamp (UTC where the stamps state a zone); None where they have no date.

    Raises
    ------
    ReadError
        A cell is no stamp; the message says where and what is allowed.
    """
    form = next((form for form in map(stamp_format, cells[:100]) if form), "iso")
    values, midnight = _since_midnight(cells, form)
    bad = [i for i in np.flatnonzero(~np.isfinite(values)) if cells[int(i)].strip()]
    if bad:
        raise ReadError(
            path,
            f"line {lines[int(bad[0])]}, {place}",
            f"{cells[int(bad[0])].strip()[:40]!r} is no date and time like the cells above it; allowed in one column: "
            "one way to write them, such as 2024-03-12 10:15:00.125",
        )
    known = values[np.isfinite(values)]
    # Stamps count from a day long ago: below a nanosecond there is nothing in their differences.
    begin = float(known[0]) if known.size else 0.0
    seconds: Array = np.round(values - begin, 9)
    return seconds, None if midnight is None else midnight + np.timedelta64(round(1e9 * begin), "ns")


def stamp_seconds(cells: Sequence[str], form: str) -> Array:
    """Seconds of each stamp since midnight of the first day, shape (n,) [s]; NaN where a cell is none.

    Parameters
    ----------
    cells
        The stamps.
    form
        How they are written, a key of `aerobalance.io.text_cells.STAMPS`.
    """
    return _since_midnight(cells, form)[0]


def _since_midnight(cells: Sequence[str], form: str) -> tuple[Array, np.datetime64 | None]:
    """Seconds of each stamp since midnight of the first day, shape (n,), and that midnight; None without a date."""
    import pandas as pd  # noqa: PLC0415 - half a second, and only reading text needs it

    parts = pd.Series(cells, dtype=object).astype(str).str.strip().str.extract("^" + stamp_pattern(form).pattern + "$")

    def numbers(name: str) -> Array:
        if name not in parts:
            return np.full(len(parts), np.nan)
        return pd.to_numeric(parts[name].str.replace(",", ".", regex=False), errors="coerce").to_numpy(np.float64)

    hour, half = numbers("hour"), parts["half"].fillna("").str.lower().to_numpy()
    noon = np.array([str(mark)[:1] for mark in half])
    hour = np.where(noon == "", hour, hour % 12 + 12 * (noon == "p"))
    clock: Array = 3600 * hour + 60 * numbers("minute") + numbers("second")
    if form == "time of day":
        fell = np.diff(clock, prepend=clock[:1]) < -43200
        return clock + 86400.0 * np.cumsum(fell), None
    if "zone" in parts:
        zone = parts["zone"].fillna("")
        clock = clock - zone.map({text: _offset(text) for text in zone.unique()}).to_numpy(np.float64)
    year, month, day = numbers("year"), numbers("month"), numbers("day")
    year = np.where(year < 100, year + 2000, year)
    dated = form != "day of year" or bool(np.isfinite(year).all())
    if form == "day of year":
        days = _days(np.where(np.isfinite(year), year, 1970), np.ones_like(day), np.ones_like(day)) + day - 1
    elif form == "month by name":
        month = np.asarray(parts["month"].str.lower().str[:3].map(MONTHS), dtype=np.float64)
        days = _days(year, month, day)
    elif form == "with slashes":
        turned = _days(year, day, month)
        straight = _days(year, month, day)
        swapped = not np.isfinite(straight).any() or np.nanmax(month) > 12 or np.ptp(turned) < np.ptp(straight)
        days = turned if swapped else straight
    else:
        days = _days(year, month, day)
    first = days[np.isfinite(days)][:1]
    begin = float(first[0]) if first.size else 0.0
    midnight = np.datetime64(int(begin), "D").astype("datetime64[ns]") if first.size and dated else None
    return clock + 86400.0 * (days - begin), midnight


def _offset(zone: str) -> float:
    """Seconds by which the clocks of a zone are ahead of UTC."""
    if not zone or zone in ("Z", "UTC"):
        return 0.0
    return (-1.0 if zone[0] == "-" else 1.0) * (3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:]))


def _days(year: Array, month: Array, day: Array) -> Array:
    """Days since 1970 of each date, shape (n,); NaN where it is none."""
    known = np.isfinite(year) & (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31)
    days = np.full(year.shape, np.nan)
    months = ((year[known] - 1970) * 12 + month[known] - 1).astype(np.int64).astype("datetime64[M]")
    days[known] = months.astype("datetime64[D]").astype(np.int64) + day[known] - 1
    return days
