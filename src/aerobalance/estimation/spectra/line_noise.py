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
from numpy.typing import NDArray
from scipy.fft import rfft

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

NEAR: Final = 2048
"""Parts of a record in whose sums the neighbourhood of an ordinate is seen: five ordinates off, 1e-5 of it is lost."""

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
    reaches = {number: MAINS_TOLERANCE * number * mains + record.ordinate for number in numbers}
    places = np.array([record.strongest(number * mains, reach=reach) for number, reach in reaches.items()])
    for number, promising in zip(numbers, record.promising(places), strict=True):
        reach = reaches[number]
        if not promising:
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
        window = _hann(filled.size)
        windowed = filled * window / np.sqrt(np.sum(window**2))
        transform = rfft(windowed)
        power = transform.real**2 + transform.imag**2
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

    def strongest(self, middle: float, *, reach: float) -> int:
        """Number of the ordinate with the largest power within a reach of a frequency [Hz]."""
        first = max(int(np.ceil((middle - reach) / self.ordinate)), 1)
        last = min(int((middle + reach) / self.ordinate), self.power.size - 2)
        return first + int(np.argmax(self.power[first : last + 1]))

    def promising(self, places: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether lines may be found beside ordinates: these show at least half of a line's power, shape (k,)."""
        first, last = BESIDE
        inner = (places - last >= 0) & (places + last <= self.power.size)
        around = np.full(places.size, self.floor)
        for side in (np.arange(1 - last, 1 - first), np.arange(first, last)) if inner.any() else ():
            level = np.median(self.power[places[inner, None] + side], axis=1) / np.log(2)
            around[inner] = np.maximum(around[inner], level)
        around[~inner] = [self.surroundings(place * self.ordinate) for place in places[~inner]]
        return np.asarray(2 * 2 * 1.5 * self.power[places] > LINE_EVIDENCE * around)

    def line(self, middle: float, *, reach: float) -> Line:
        """The strongest line within a reach of a frequency [Hz]."""
        place = self.strongest(middle, reach=reach)
        near = _Near.of(self.windowed, place)
        tried = place + np.arange(-FINE, FINE + 1) / FINE
        power = near.power(tried)
        best = int(np.clip(np.argmax(power), 1, tried.size - 2))
        # the lobe's logarithm is a parabola to better than a hundredth of an ordinate
        low, here, high = np.log(power[best - 1 : best + 2] + 1e-300)
        bend = low - 2 * here + high
        shift = float(np.clip(0.5 * (low - high) / bend, -1, 1)) if bend < 0 else 0.0
        found = float(tried[best] + shift * (tried[1] - tried[0]))
        frequency = found * self.ordinate
        offsets = np.array([sign * place for place in NEXT for sign in (-1, 1)])
        level = max(self.surroundings(frequency), float(np.mean(near.power(found + offsets))))
        # of a sine's likelihood the Hann window sees two thirds
        evidence = 2 * 1.5 * float(near.power(np.array([found]))[0]) / max(level, 1e-300)
        u_frequency = self.ordinate * np.sqrt(6 / max(evidence, 1e-300)) / np.pi
        size = _line_of(self.values, np.ones(self.values.size), frequency * self.interval)
        return Line(frequency, -size.imag, size.real, float(u_frequency), evidence)

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
        sizes, spreads, begin = [], [], 0
        cycles = frequency * self.interval
        for part in np.array_split(self.values, QUARTERS):
            size = _line_of(part - np.mean(part), _hann(part.size) ** 2, cycles)
            # turned from the middle of the part to that of the record
            later = begin + (part.size - 1) / 2 - (self.values.size - 1) / 2
            sizes.append(size * np.exp(-2j * np.pi * cycles * later))
            spreads.append(1.5 * 4 * self.surroundings(frequency) / part.size)
            begin += part.size
        mean = np.mean(sizes)
        allowed = UNSTEADY * abs(mean) + 4 * np.sqrt(np.array(spreads))
        return bool(np.all(np.abs(np.array(sizes) - mean) < allowed))


@dataclass(frozen=True, slots=True, eq=False)
class _Near:
    """A record turned back by the frequency of an ordinate, and summed over many short parts.

    Attributes
    ----------
    ordinate
        The ordinate.
    middle
        Middles of the parts over the length of the record, shape (k,) [1].
    sums, moments
        Sum over each of them, and of the products with the distance from its middle, over that length, shape (k,).
    """

    ordinate: int
    middle: Array
    sums: NDArray[np.complex128]
    moments: NDArray[np.complex128]

    @classmethod
    def of(cls, values: Array, ordinate: int) -> _Near:
        """Sum a record about an ordinate."""
        length = max(values.size // NEAR, 1)
        along = (np.arange(length) - (length - 1) / 2) / values.size
        sums, moments = (
            _sums(values, ordinate / values.size, weights=weights) for weights in (np.ones(length), along)
        )
        middle = (length * np.arange(sums.size) + (length - 1) / 2) / values.size
        return cls(ordinate, middle, sums, moments)

    def power(self, places: Array) -> Array:
        """Power of the record at some places within a few ordinates, in ordinates, shape (p,)."""
        angle = 2j * np.pi * (places - self.ordinate)
        turns = np.exp(-np.outer(angle, self.middle))
        found = turns @ self.sums - angle * (turns @ self.moments)
        return np.asarray(found.real**2 + found.imag**2)


def _hann(count: int) -> Array:
    """Hann window of so many samples, none of them zero."""
    return np.hanning(count + 2)[1:-1]


def _sums(values: Array, cycles: float, *, weights: Array) -> NDArray[np.complex128]:
    """Sums of values times exp(-2 pi i cycles k), k from 0, and weights, over parts as long as these are."""
    length = weights.size
    turn = np.exp(-2j * np.pi * cycles * np.arange(length)) * weights
    whole = values.size // length
    parts = values[: whole * length].reshape(whole, length)
    rest = values[whole * length :]
    sums = parts @ turn.real + 1j * (parts @ turn.imag)
    if rest.size:
        sums = np.append(sums, rest @ turn[: rest.size])
    return np.asarray(sums * np.exp(-2j * np.pi * cycles * length * np.arange(sums.size)))


def _line_of(values: Array, weights: Array, cycles: float) -> complex:
    """Size a of the line Re(a exp(2 pi i cycles k)), k from the middle, by weighted least squares.

    The normal equations are c a + d a* = b and its conjugate, with the weights' sum c, their transform d at twice the
    frequency and twice that of the weighted values, b.
    """
    part = np.ones(max(int(np.sqrt(values.size)), 1))
    middle = np.exp(2j * np.pi * cycles * (values.size - 1) / 2)
    b = 2 * np.sum(_sums(weights * values, cycles, weights=part)) * middle
    d = np.sum(_sums(weights, 2 * cycles, weights=part)) * middle**2
    c = float(np.sum(weights))
    return complex((c * b - d * np.conj(b)) / max(c**2 - abs(d) ** 2, 1e-300))
