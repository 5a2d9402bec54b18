r"""Mains hum: steady lines at 50 or 60 Hz and their harmonics that the wiring adds to a reading.

Nothing in a reading but its frequency tells such a line from a force. A line is taken for hum if it lies at a multiple
of the mains frequency, stands out of the Hann periodogram around it far beyond chance, is as narrow as the record's
length allows, and keeps amplitude and phase from the beginning of the record to its end. It may still be one of
the harmonics of a load that repeats: then others lie at the same distance on either side of it.

An ordinate is a frequency of the periodogram, a whole multiple of 1 / T with T the length of the record; as a unit,
"two ordinates" are 2 / T. Powers of ordinates are scaled so that white noise of variance sigma^2 has the mean sigma^2.
A line of amplitude A in n samples then has the power A^2 n / 6 under the Hann window, two thirds of the A^2 n / 4
without one, and raises twice the log-likelihood by A^2 n / (2 sigma^2), which is called its evidence.

References
----------
.. [Rife1974] D. C. Rife, R. R. Boorstyn, "Single-tone parameter estimation from discrete-time observations", IEEE
   Trans. Inform. Theory 20 (1974) 591.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from aerobalance.estimation.spectra.lines import Line
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann
from aerobalance.recording.resampling import interpolate_gaps_linearly

Hum = Literal["mains", "keep"] | tuple[float, ...]
"""Lines to take for hum: those of the mains that are found, none, or those near given frequencies [Hz]."""

MAINS: Final = (50.0, 60.0)
"""Frequencies of the mains [Hz]."""

MAINS_TOLERANCE: Final = 1e-3
"""Largest departure of the mains from its frequency, relative [1]: 0.05 Hz of 50 Hz, the standard frequency range of
continental Europe, Regulation (EU) 2017/1485, Annex III."""

MOST_HARMONICS: Final = 20
"""Highest harmonic that is looked for."""

LINE_EVIDENCE: Final = 40.0
"""Least evidence of a line [1]. White noise alone exceeds 40 at an ordinate with the probability exp(-40 / 3) = 2e-6,
as its power has an exponential distribution and evidence is 3 times power over noise."""

BESIDE: Final = (3, 27)
"""From how many ordinates off a line to how many its surroundings are looked at on each side, the last not included:
the Hann window spreads a line over two."""

HANN_ZEROS: Final = (2.0, 3.0, 4.0)
"""Distances from a line [ordinates] at which the transform of the Hann window is zero."""

PER_ORDINATE: Final = 8
"""Frequencies for each ordinate at which a line is sought."""

SHORT_PARTS: Final = 2048
"""Parts of a record whose sums and first moments stand for it near an ordinate. Five ordinates off, the phase turns by
2 pi 5 / 2048 / 2 = 0.008 rad to the edge of a part; half its square, over a part a third of that, is lost: 1e-5."""

QUARTERS: Final = 4
"""Parts of the record in which a line has to be the same."""

UNSTEADY: Final = 0.2
"""Departure of the complex amplitude in a part from the mean, relative, that is allowed beside chance [1]."""


MOST_BESIDE: Final = 64
"""Highest number of half distances of two neighbouring harmonics of a load in a frequency of the mains."""

NO_STRONGER: Final = 2.0
"""Force at a harmonic over the stronger of its neighbours up to which all three are of one load: of n to the power p
the amplitudes of harmonics differ by (1 - 1/n)^-p, 1.8 for the second power and n from 4 on."""


def hum_lines(values: Array, interval: float, *, hum: Hum = "mains") -> tuple[Line, ...]:
    """Return the lines of a record that are to be taken for hum, with frequency [Hz] and amplitudes [N].

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
        return max((tuple(_harmonics(record, mains)) for mains in MAINS), key=_total_evidence)
    for frequency in hum:
        if not 2 * record.ordinate < frequency < 0.5 / interval - 2 * record.ordinate:
            raise ValueError(
                f"hum: {frequency:g} Hz must lie two ordinates ({2 * record.ordinate:.3g} Hz) inside 0 to "
                f"{0.5 / interval:g} Hz"
            )
    if np.any(np.diff(np.sort(hum)) < 3 * record.ordinate):
        raise ValueError(f"hum: {hum} Hz hold two lines closer than a record of {record.duration:.3g} s tells apart")
    return tuple(record.line(frequency, reach=MAINS_TOLERANCE * frequency + record.ordinate) for frequency in hum)


def load_harmonics(
    values: Array, interval: float, lines: Sequence[Line], response: Callable[[Array], NDArray[np.complex128]]
) -> tuple[Line, ...]:
    """Return those of a record's lines of the mains that are harmonics of a load that repeats.

    A load of 4 Hz has one at 60 Hz. It then has others at the same distance on either side of it, of which none is one
    of the mains, and which are about as strong as forces.

    Parameters
    ----------
    values
        Readings, known shapes taken out, shape (n,) [N]; NaN where missing.
    interval
        Time between samples [s].
    lines
        What `hum_lines` found in it.
    response
        The balance's response, reading over force, at frequencies [Hz].
    """
    if not lines:
        return ()
    record = _Record.of(values, interval)
    return tuple(line for line in lines if _of_load(record, line, lines, response))


def strongest_line(values: Array, interval: float, *, low: float, high: float) -> Line | None:
    """Return the strongest line of a band, with frequency [Hz] and amplitudes [N]; None where none is steady.

    Parameters
    ----------
    values
        Readings, known shapes taken out, shape (n,) [N]; NaN where missing.
    interval
        Time between samples [s].
    low, high
        Edges of the band [Hz].
    """
    record = _Record.of(values, interval)
    line = record.line((low + high) / 2, reach=(high - low) / 2 + record.ordinate)
    return line if line.evidence > LINE_EVIDENCE and record.steady(line.frequency) else None


def _total_evidence(lines: tuple[Line, ...]) -> float:
    """Sum of the evidence of all lines [1]: it decides between 50 and 60 Hz."""
    return sum(line.evidence for line in lines)


def _harmonics(record: _Record, mains: float) -> Iterator[Line]:
    """Lines at a mains frequency [Hz] and its harmonics, if the fundamental is there or at least two others are."""
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
    # (4 sigma and a tenth of an ordinate, by which the leakage of neighbours may shift a line)
    true = found[leader].frequency / leader
    agreeing = {
        number: line
        for number, line in found.items()
        if abs(line.frequency - number * true)
        <= 4 * np.hypot(line.u_frequency, number / leader * found[leader].u_frequency) + 0.1 * record.ordinate
    }
    if 1 in agreeing or len(agreeing) > 1:
        yield from agreeing.values()


def _of_load(
    record: _Record, line: Line, hum: Sequence[Line], response: Callable[[Array], NDArray[np.complex128]]
) -> bool:
    """Whether a line is a harmonic of a load that repeats: in the middle of two others, and no stronger than they."""
    # the distance of neighbours is the load's fundamental, or twice that where it has odd harmonics only
    distances = 2 * line.frequency / np.arange(3, MOST_BESIDE + 1)
    distances = distances[distances > BESIDE[0] * record.ordinate]
    sides = line.frequency + np.multiply.outer([-1.0, 1.0], distances)
    inside = (sides[0] > 2 * record.ordinate) & (sides[1] < 0.5 / record.interval - 2 * record.ordinate)
    distances, sides = distances[inside], sides[:, inside]
    if not distances.size:
        return False
    places = np.rint(sides / record.ordinate).astype(np.int64)
    tried = record.promising(places.ravel()).reshape(places.shape).all(axis=0)
    # the nearest on either side tell how strong it may be: of 60 Hz those of 52 and 68 Hz, and not of 20 and 100 Hz
    for distance in np.sort(distances[tried]):
        beside = [record.line(line.frequency + side * distance, reach=record.ordinate) for side in (-1, 1)]
        # two lines of the mains have others of the mains in their middle
        if any(abs(one.frequency - other.frequency) < record.ordinate for one in beside for other in hum):
            continue
        sharp = all(one.evidence > LINE_EVIDENCE and record.steady(one.frequency) for one in beside)
        if not sharp or not all(
            abs(one.frequency - line.frequency - side * distance)
            <= 4 * np.hypot(one.u_frequency, line.u_frequency) + 0.1 * record.ordinate
            for side, one in zip((-1, 1), beside, strict=True)
        ):
            continue
        forces = [one.amplitude / abs(response(np.array([one.frequency]))[0]) for one in (line, *beside)]
        return bool(forces[0] <= NO_STRONGER * max(forces[1:]))
    return False


@dataclass(frozen=True, slots=True, eq=False)
class _Record:
    """A record without gaps, less its mean, and its Hann periodogram.

    Attributes
    ----------
    values
        Readings less their mean, gaps bridged by straight lines, shape (n,) [N].
    interval
        Time between samples [s].
    windowed
        The same times a Hann window whose squares add to 1, shape (n,) [N].
    power
        Power of each ordinate, shape (n // 2 + 1,) [N^2].
    floor
        Variance of the white noise whose power has the lower quartile that is found [N^2].
    """

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
        # the power of noise has an exponential distribution, and log(4 / 3) of its mean is its lower quartile; so up
        # to three quarters of all ordinates may hold more than noise
        floor = float(np.quantile(power, 0.25)) / np.log(4 / 3)
        return cls(filled, interval, windowed, power, floor)

    @property
    def duration(self) -> float:
        return self.values.size * self.interval

    @property
    def ordinate(self) -> float:
        """Distance between ordinates [Hz]: what the record resolves."""
        return 1 / self.duration

    def strongest(self, middle: float, *, reach: float) -> int:
        """Index of the ordinate with the largest power within a reach [Hz] of a frequency [Hz]."""
        first = max(int(np.ceil((middle - reach) / self.ordinate)), 1)
        last = min(int((middle + reach) / self.ordinate), self.power.size - 2)
        return first + int(np.argmax(self.power[first : last + 1]))

    def promising(self, places: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether lines worth a closer look may lie near ordinates of these indices, shape (k,).

        A line between two ordinates shows 0.72 of its power at the nearer one; with a margin, half is reckoned with.
        """
        first, last = BESIDE
        inner = (places - last >= 0) & (places + last <= self.power.size)
        around = np.full(places.size, self.floor)
        for side in (np.arange(1 - last, 1 - first), np.arange(first, last)) if inner.any() else ():
            level = np.median(self.power[places[inner, None] + side], axis=1) / np.log(2)
            around[inner] = np.maximum(around[inner], level)
        around[~inner] = [self.surroundings(place * self.ordinate) for place in places[~inner]]
        evidence = 2 * 1.5 * self.power[places]  # as in `line`, times the noise
        return np.asarray(2 * evidence > LINE_EVIDENCE * around)

    def line(self, middle: float, *, reach: float) -> Line:
        """The strongest line within a reach [Hz] of a frequency [Hz]."""
        place = self.strongest(middle, reach=reach)
        near = _Near.of(self.windowed, place)
        tried = place + np.arange(-PER_ORDINATE, PER_ORDINATE + 1) / PER_ORDINATE
        power = near.power(tried)
        best = int(np.clip(np.argmax(power), 1, tried.size - 2))
        # a parabola through the logarithm of the main lobe has its peak right to a hundredth of an ordinate
        low, here, high = np.log(power[best - 1 : best + 2] + 1e-300)
        bend = low - 2 * here + high
        shift = float(np.clip(0.5 * (low - high) / bend, -1, 1)) if bend < 0 else 0.0
        found = float(tried[best] + shift * (tried[1] - tried[0]))
        frequency = found * self.ordinate
        offsets = np.array([sign * place for place in HANN_ZEROS for sign in (-1, 1)])
        level = max(self.surroundings(frequency), float(np.mean(near.power(found + offsets))))
        # the Hann window shows two thirds of a line's power: 1.5 makes up for it
        evidence = 2 * 1.5 * float(near.power(np.array([found]))[0]) / max(level, 1e-300)
        # twice the Cramer-Rao variance of 3 / (pi^2 evidence) squared ordinates [Rife1974]_: the peak under a Hann
        # window has 2.34 times, but the level, the largest of several, is too high: errors of 1500 simulated lines
        # were 0.9 of it
        u_frequency = self.ordinate * np.sqrt(6 / max(evidence, 1e-300)) / np.pi
        size = _line_of(self.values, np.ones(self.values.size), frequency * self.interval)
        return Line(frequency, -size.imag, size.real, float(u_frequency), evidence)

    def surroundings(self, frequency: float) -> float:
        """Power of the noise about a frequency [Hz]: the largest of that below it, above it, and in all [N^2].

        One side alone is not enough: its few ordinates are all low by chance once in some ten thousand.
        """
        middle = round(frequency / self.ordinate)
        first, last = BESIDE
        left = self.power[max(middle - last + 1, 1) : max(middle - first + 1, 2)]
        right = self.power[middle + first : middle + last]
        # medians, as other lines may stand there; that of an exponential distribution is log 2 of its mean
        sides = [float(np.median(side)) / np.log(2) for side in (left, right) if side.size]
        return float(max(*sides, self.floor))

    def steady(self, frequency: float) -> bool:
        """Whether amplitude and phase of a line at a frequency [Hz] are the same in all quarters of the record."""
        sizes, spreads, begin = [], [], 0
        cycles = frequency * self.interval
        for part in np.array_split(self.values, QUARTERS):
            size = _line_of(part - np.mean(part), _hann(part.size) ** 2, cycles)
            # turned from the middle of the part to that of the record
            later = begin + (part.size - 1) / 2 - (self.values.size - 1) / 2
            sizes.append(size * np.exp(-2j * np.pi * cycles * later))
            # least squares with squares w of a Hann window as weights: 4 sigma^2 sum w^2 / (sum w)^2 = 35/18 * 4
            # sigma^2 / n, of which 3/4 is left about the mean of four parts: 1.46
            spreads.append(1.5 * 4 * self.surroundings(frequency) / part.size)
            begin += part.size
        mean = np.mean(sizes)
        allowed = UNSTEADY * abs(mean) + 4 * np.sqrt(np.array(spreads))
        return bool(np.all(np.abs(np.array(sizes) - mean) < allowed))


@dataclass(frozen=True, slots=True, eq=False)
class _Near:
    """Transform of a record at any frequency near an ordinate, from sums over many short parts.

    The record is multiplied by exp(-2 pi i ordinate t / T), after which frequencies near the ordinate vary little
    within a part: its sum and its first moment are enough.

    Attributes
    ----------
    ordinate
        Index of the ordinate.
    middle
        Middle of each part, as a share of the record's length, shape (k,) [1].
    sums, moments
        Sum over each part, and first moment about its middle with distances as shares of that length, shape (k,) [N].
    """

    ordinate: int
    middle: Array
    sums: NDArray[np.complex128]
    moments: NDArray[np.complex128]

    @classmethod
    def of(cls, values: Array, ordinate: int) -> _Near:
        """Return the sums of a record (n,) [N] about the ordinate of an index."""
        length = max(values.size // SHORT_PARTS, 1)
        along = (np.arange(length) - (length - 1) / 2) / values.size
        sums, moments = (
            _sums(values, ordinate / values.size, weights=weights) for weights in (np.ones(length), along)
        )
        middle = (length * np.arange(sums.size) + (length - 1) / 2) / values.size
        return cls(ordinate, middle, sums, moments)

    def power(self, places: Array) -> Array:
        """Power at frequencies within a few ordinates of it, given in ordinates, shape (p,) [N^2]."""
        angle = 2j * np.pi * (places - self.ordinate)
        turns = np.exp(-np.outer(angle, self.middle))
        found = turns @ self.sums - angle * (turns @ self.moments)
        return np.asarray(found.real**2 + found.imag**2)


def _hann(count: int) -> Array:
    """Hann window of so many samples without the zeros at its ends, shape (count,) [1]."""
    return hann(count + 1)[1:]


def _sums(values: Array, cycles: float, *, weights: Array) -> NDArray[np.complex128]:
    """Sums over parts of values[k] exp(-2 pi i cycles k) w, with weights w that begin anew in each part.

    Parameters
    ----------
    values
        Samples, shape (n,).
    cycles
        Frequency in cycles per sample [1].
    weights
        Shape (m,): their number is the length of a part.
    """
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
    """Complex amplitude a of the line Re(a exp(2 pi i cycles k)), k from the middle, by weighted least squares.

    The normal equations are c a + d a* = b and its conjugate, with c the sum of the weights, d their transform at
    twice the frequency, and b twice the transform of the weighted values.
    """
    part = np.ones(max(int(np.sqrt(values.size)), 1))
    middle = np.exp(2j * np.pi * cycles * (values.size - 1) / 2)
    b = 2 * np.sum(_sums(weights * values, cycles, weights=part)) * middle
    d = np.sum(_sums(weights, 2 * cycles, weights=part)) * middle**2
    c = float(np.sum(weights))
    return complex((c * b - d * np.conj(b)) / max(c**2 - abs(d) ** 2, 1e-300))
