r"""Mains hum: steady lines at 50 or 60 Hz and their harmonics that the wiring adds to a reading.

Nothing in a reading but its frequency tells such a line from a force. A line is taken for hum if it lies where the
mains do, stands out of the periodogram around it far beyond chance, is as narrow as the record's length allows, and
keeps amplitude and phase from the beginning of the record to its end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import interpolate_gaps_linearly

Hum = Literal["mains", "keep"] | tuple[float, ...]
"""Lines to take for hum: those of the mains that are found, none, or those near given frequencies [Hz]."""

MAINS: Final = (50.0, 60.0)
"""Frequencies of the mains [Hz]."""

MAINS_TOLERANCE: Final = 1e-3
"""Relative departure of the mains from that: 0.05 Hz is the limit in which large grids are kept."""

MOST_HARMONICS: Final = 20
"""Highest harmonic that is looked for."""

LINE_EVIDENCE: Final = 40.0
"""Gain in twice the log-likelihood over the surroundings that a line must bring."""

BESIDE: Final = (3, 27)
"""Ordinates on each side of a line in which its surroundings are looked at."""

NEXT: Final = (2.0, 3.0, 4.0)
"""Ordinates from a line at which the Hann window shows nothing of it."""

FINE: Final = 8
"""Places an ordinate at which a line is sought."""

QUARTERS: Final = 4
"""Parts of the record in which a line has to be the same."""

UNSTEADY: Final = 0.2
"""Relative departure of a part's amplitude and phase that is allowed beside chance."""


@dataclass(frozen=True, slots=True)
class Line:
    """One steady line of a reading.

    Attributes
    ----------
    frequency
        Its frequency [Hz].
    sine, cosine
        Its parts in the reading, from the middle of the record [N].
    u_frequency
        Standard uncertainty of the frequency [Hz].
    evidence
        Twice the gain in log-likelihood over its surroundings [1].
    """

    frequency: float
    sine: float
    cosine: float
    u_frequency: float
    evidence: float

    @property
    def amplitude(self) -> float:
        """Its amplitude in the reading [N]."""
        return float(np.hypot(self.sine, self.cosine))


def columns_of_lines(frequencies: Sequence[float], *, count: int, interval: float) -> Array:
    """Sine and cosine of each line from the middle of the record, shape (n, 2 lines) [1]."""
    turns = 2 * np.pi * (np.arange(count) - (count - 1) / 2) * interval
    return np.column_stack(
        [np.zeros((count, 0)), *(np.column_stack([np.sin(f * turns), np.cos(f * turns)]) for f in frequencies)]
    )


def reading_of_lines(lines: Sequence[Line], *, count: int, interval: float) -> Array:
    """What lines make of a reading, shape (n,) [N]."""
    columns = columns_of_lines([line.frequency for line in lines], count=count, interval=interval)
    return np.asarray(columns @ np.array([size for line in lines for size in (line.sine, line.cosine)]))


def hum_lines(values: Array, interval: float, *, hum: Hum = "mains") -> tuple[Line, ...]:
    """Find the lines of a record that are to be taken for hum.

    Parameters
    ----------
    values
        Readings, known shapes taken out, shape (n,) [N]; NaN where missing.
    interval
        Time between samples [s].
    hum
        ``"mains"``: lines at 50 or 60 Hz and harmonics, where they are found. ``"keep"``: none. Frequencies [Hz]: the
        strongest line within 0.1 % or one ordinate of each, whatever the evidence for it.

    Raises
    ------
    ValueError
        A given frequency does not lie between zero and half the sampling rate, or two lie too close together.
    """
    if isinstance(hum, str) and hum not in ("mains", "keep"):
        raise ValueError(f"hum must be mains, keep or frequencies in Hz, not {hum!r}")
    if isinstance(hum, str) and hum == "keep":
        return ()
    record = _Record.of(values, interval)
    if isinstance(hum, str):
        return max((tuple(_comb(record, mains)) for mains in MAINS), key=_strength)
    for frequency in hum:
        if not 2 * record.ordinate < frequency < 0.5 / interval - 2 * record.ordinate:
            raise ValueError(
                f"hum: {frequency:g} Hz must lie two ordinates ({2 * record.ordinate:.3g} Hz) inside 0 to "
                f"{0.5 / interval:g} Hz"
            )
    if np.any(np.diff(np.sort(hum)) < 3 * record.ordinate):
        raise ValueError(f"hum: {hum} Hz hold two lines closer than a record of {record.duration:.3g} s tells apart")
    return tuple(record.line(frequency, reach=MAINS_TOLERANCE * frequency + record.ordinate) for frequency in hum)


def _strength(lines: tuple[Line, ...]) -> float:
    return sum(line.evidence for line in lines)


def _comb(record: _Record, mains: float) -> Iterator[Line]:
    """Lines at a mains frequency and its harmonics: the first, or at least two others, has to be there."""
    highest = 0.5 / record.interval - BESIDE[1] * record.ordinate
    numbers = range(1, min(MOST_HARMONICS, int(highest / mains)) + 1)
    if not numbers or mains < (BESIDE[1] + 1) * record.ordinate:
        return
    found: dict[int, Line] = {}
    for number in numbers:
        reach = MAINS_TOLERANCE * number * mains + record.ordinate
        if not record.promising(number * mains, reach=reach):
            continue
        line = record.line(number * mains, reach=reach)
        near = abs(line.frequency - number * mains) <= MAINS_TOLERANCE * number * mains + 4 * line.u_frequency
        if near and line.evidence > LINE_EVIDENCE and record.steady(line.frequency):
            found[number] = line
    if not found:
        return
    # the strongest line tells the frequency of the mains, and the others have to be multiples of it
    leader = max(found, key=lambda number: found[number].evidence)
    true = found[leader].frequency / leader
    agreeing = {
        number: line
        for number, line in found.items()
        if abs(line.frequency - number * true)
        <= 4 * np.hypot(line.u_frequency, number / leader * found[leader].u_frequency) + 0.1 * record.ordinate
    }
    if 1 in agreeing or len(agreeing) > 1:
        yield from agreeing.values()


@dataclass(frozen=True, slots=True, eq=False)
class _Record:
    """A record without gaps, less its mean, and under a Hann window."""

    values: Array
    interval: float
    windowed: Array
    power: Array
    floor: float

    @classmethod
    def of(cls, values: Array, interval: float) -> _Record:
        filled = interpolate_gaps_linearly(values)
        filled = filled - np.mean(filled)
        window = np.hanning(filled.size + 2)[1:-1]
        windowed = filled * window / np.sqrt(np.sum(window**2))
        power = np.abs(np.fft.rfft(windowed)) ** 2
        # the power of noise is exponential; three quarters of all ordinates may hold something else
        floor = float(np.quantile(power, 0.25)) / np.log(4 / 3)
        return cls(filled, interval, windowed, power, floor)

    @property
    def duration(self) -> float:
        return self.values.size * self.interval

    @property
    def ordinate(self) -> float:
        """Frequency that the record resolves [Hz]."""
        return 1 / self.duration

    def at(self, frequency: Array) -> Array:
        """Power of the windowed record at any frequencies [N^2]."""
        turns = -2j * np.pi * self.interval * np.arange(self.values.size)
        return np.array([abs(np.exp(turns * f) @ self.windowed) ** 2 for f in frequency])

    def strongest(self, middle: float, *, reach: float) -> int:
        """Number of the ordinate with the largest power within a reach of a frequency [Hz]."""
        first = max(int(np.ceil((middle - reach) / self.ordinate)), 1)
        last = min(int((middle + reach) / self.ordinate), self.power.size - 2)
        return first + int(np.argmax(self.power[first : last + 1]))

    def promising(self, middle: float, *, reach: float) -> bool:
        """Whether a line may be found within a reach of a frequency: an ordinate shows at least half of its power."""
        place = self.strongest(middle, reach=reach)
        return bool(2 * 2 * 1.5 * self.power[place] > LINE_EVIDENCE * self.surroundings(place * self.ordinate))

    def line(self, middle: float, *, reach: float) -> Line:
        """The strongest line within a reach of a frequency [Hz]."""
        tried = self.ordinate * (self.strongest(middle, reach=reach) + np.arange(-FINE, FINE + 1) / FINE)
        power = self.at(tried)
        best = int(np.clip(np.argmax(power), 1, tried.size - 2))
        # the lobe's logarithm is a parabola to better than a hundredth of an ordinate
        low, here, high = np.log(power[best - 1 : best + 2] + 1e-300)
        bend = low - 2 * here + high
        shift = float(np.clip(0.5 * (low - high) / bend, -1, 1)) if bend < 0 else 0.0
        frequency = float(tried[best] + shift * (tried[1] - tried[0]))
        offsets = self.ordinate * np.array([sign * place for place in NEXT for sign in (-1, 1)])
        level = max(self.surroundings(frequency), float(np.mean(self.at(frequency + offsets))))
        # of a sine's likelihood the Hann window sees two thirds
        evidence = 2 * 1.5 * float(self.at(np.array([frequency]))[0]) / max(level, 1e-300)
        u_frequency = self.ordinate * np.sqrt(6 / max(evidence, 1e-300)) / np.pi
        fitted = columns_of_lines([frequency], count=self.values.size, interval=self.interval)
        sine, cosine = (float(size) for size in np.linalg.lstsq(fitted, self.values, rcond=None)[0])
        return Line(frequency, sine, cosine, float(u_frequency), evidence)

    def surroundings(self, frequency: float) -> float:
        """Power that stands around a frequency: the largest of what is to the left, to the right, and everywhere.

        The few ordinates on either side are all low by chance once in some ten thousand.
        """
        middle = round(frequency / self.ordinate)
        first, last = BESIDE
        left = self.power[max(middle - last + 1, 1) : max(middle - first + 1, 2)]
        right = self.power[middle + first : middle + last]
        # medians, as other lines may stand there; the power of noise is exponential, whose median is log 2
        sides = [float(np.median(side)) / np.log(2) for side in (left, right) if side.size]
        return float(max(*sides, self.floor))

    def steady(self, frequency: float) -> bool:
        """Whether amplitude and phase of a line are the same in all parts of the record."""
        fitted = columns_of_lines([frequency], count=self.values.size, interval=self.interval)
        sizes, spreads = [], []
        for shapes, values in zip(
            np.array_split(fitted, QUARTERS), np.array_split(self.values, QUARTERS), strict=True
        ):
            window = np.hanning(values.size + 2)[1:-1][:, None]
            size = np.linalg.lstsq(window * shapes, window[:, 0] * (values - np.mean(values)), rcond=None)[0]
            sizes.append(size[0] + 1j * size[1])
            spreads.append(1.5 * 4 * self.surroundings(frequency) / values.size)
        mean = np.mean(sizes)
        allowed = UNSTEADY * abs(mean) + 4 * np.sqrt(np.array(spreads))
        return bool(np.all(np.abs(np.array(sizes) - mean) < allowed))
