"""Averaged ordinates of a record of noise alone, without lines and what shakes in the balance."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.spectra.line_noise import MAINS, MOST_HARMONICS, hum_lines
from aerobalance.estimation.spectra.lines import Line, columns_of_lines
from aerobalance.estimation.spectra.noise_spectrum import Hump
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.recording.fourier import tapered

FEWEST_SAMPLES: Final = 512
"""Shortest record that a spectrum of noise is learned from."""

TAPER: Final = 0.2
"""Share of the record over which the window rises and falls: enough for 1/f^2, and most of the record counts."""

FIRST: Final = 2
"""First ordinate that is used: the mean, which is taken away, is missing in those below."""

FINENESS: Final = 0.01
"""Width of an average of ordinates over its frequency."""

STRENGTHENED: Final = 4.0
"""Square of the response above which a frequency is left out: what shakes in the balance is strongest there."""

BESIDE_MODE: Final = 0.1
"""Relative distance from any mode up to which a frequency is left out."""

UNLIKELY: Final = 1e-4
"""Probability with which chance makes one ordinate of a record stand out so far that it is taken for a line."""

WANDERS: Final = 4e-3
"""Width of a line of the mains over its frequency: it keeps its phase for a second or two, as the mains drift by 0.1 %
from one minute to the next, and is narrower than what a run of some seconds resolves."""

DRIFTS: Final = 0.01
"""Relative distance from a frequency of the mains up to which a narrow band is a line of them that drifts."""

FEWEST_AVERAGED: Final = 4.0
"""Ordinates that are averaged at least where levels are looked for, but at the lowest frequencies."""

FIRST_LINE: Final = 8
"""Ordinates on either side of it from which its surroundings are told."""


@dataclass(frozen=True, slots=True, eq=False)
class Ordinates:
    """Averaged ordinates of a record of noise, those that shake or are lines left out.

    Attributes
    ----------
    frequency
        Middle of each average [Hz], shape (m,).
    density
        Two-sided density of the reading [N^2/Hz].
    weight
        Number of independent ordinates in each average [1].
    gain
        Square of the response load over force, averaged alike [1].
    fixed
        Density that comes with known inputs [N^2/Hz].
    interval
        Time between samples [s].
    lines
        Frequencies of lines that are left out [Hz].
    hum
        Lines of the mains, as narrow peaks.
    single
        Number, density and gain of each ordinate that is averaged, shape (3, n); None where only averages are known.
    share
        Independent ordinates over ordinates [1].
    step
        Distance of the ordinates [Hz].
    """

    frequency: Array
    density: Array
    weight: Array
    gain: Array
    fixed: Array
    interval: float
    lines: tuple[float, ...]
    hum: tuple[Hump, ...] = ()
    single: Array | None = None
    share: float = 1.0
    step: float = 0.0

    @classmethod
    def of(
        cls,
        values: Array,
        dynamics: ModalModel,
        *,
        interval: float,
        input_density: float = 0.0,
        name: str = "noise",
    ) -> Ordinates:
        """Take the periodogram of a record without gaps under a window that tapers over a share of it."""
        values = values - values.mean()
        found = hum_lines(values, interval)
        mains = [line.frequency for line in found]
        columns = columns_of_lines(mains, count=values.size, interval=interval)
        values = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
        window = tapered(values.size, TAPER)
        power = np.abs(np.fft.rfft(values * window)) ** 2 * (interval / np.sum(window**2))
        frequency = np.arange(power.size) / (values.size * interval)
        gain = np.abs(dynamics.response(frequency)) ** 2
        kept = gain < STRENGTHENED
        for mode in dynamics.modes:
            kept &= np.abs(frequency / mode.natural_frequency - 1) > BESIDE_MODE
        kept[:FIRST] = kept[-1] = False
        hum = [_as_hump(line) for line in found]
        for drifting, near in _drifting_mains(power, frequency):
            hum.append(drifting)
            kept &= ~near
        lines = _lines(power) & kept
        places = np.flatnonzero(lines)
        kept &= np.convolve(lines, np.ones(5), mode="same") < 0.5
        if np.count_nonzero(kept) < FEWEST_SAMPLES // 8:
            raise FitError(
                f"{name}: beside the modes of {dynamics.component} nothing is left to tell its noise from; "
                "a higher sampling rate or a longer record would help"
            )
        index = np.flatnonzero(kept)
        edges = _averages(index)
        count = np.diff(np.append(edges, index.size))
        kept_only = np.stack([frequency, power, gain])[:, index]
        step = float(frequency[1])
        frequency, power, gain = np.add.reduceat(kept_only, edges, axis=1) / count
        # the taper's ordinates are not independent: as many as sum(w^2)^2 / sum(w^4) readings give
        share = float(np.sum(window**2) ** 2 / np.sum(window**4) / values.size)
        separate = [float(f) for f in places[np.diff(places, prepend=-9) > 2] / (values.size * interval)]
        lines_left_out = tuple(sorted([*mains, *separate]))
        return cls(
            frequency,
            power,
            count * share,
            gain,
            gain * input_density,
            interval,
            lines_left_out,
            tuple(hum),
            np.stack([index, *kept_only[1:]]),
            share,
            step,
        )

    def averaged(self, *, fineness: float, apart: Sequence[tuple[float, float]] = ()) -> Ordinates:
        """The same with other averages.

        Parameters
        ----------
        fineness
            Width of an average over its frequency.
        apart
            Parts that are left out, from one frequency to another [Hz]; no average is over one of them.
        """
        assert self.single is not None  # it is of a record, not of averages
        index = self.single[0]
        kept, borders = np.ones(index.size, dtype=np.bool_), [index[0]]
        while borders[-1] < index[-1]:
            here = borders[-1]
            # of few ordinates a level is uncertain, but within a tenth of its frequency 1/f^2 does not bend
            borders.append(here + max(1.0, min(FEWEST_AVERAGED, here // 10), here * fineness // 1))
        for first, last in apart:
            low, high = np.ceil(first / self.step), np.floor(last / self.step)
            kept &= (index < low) | (index > high)
            borders += [low, high + 1]
        parts = self.single[:, kept]
        edges = np.unique(np.searchsorted(parts[0], np.sort(borders)))
        edges = edges[edges < parts.shape[1]]
        count = np.diff(np.append(edges, parts.shape[1]))
        index, density, gain = np.add.reduceat(parts, edges, axis=1) / count
        fixed = gain * (self.fixed[0] / self.gain[0])
        return replace(
            self, frequency=index * self.step, density=density, weight=count * self.share, gain=gain, fixed=fixed
        )

    @property
    def lowest_hump(self) -> float:
        """Lowest frequency at which a hump is looked for [Hz]: above the 1/f part, or from the first ordinate on."""
        first, last = float(self.frequency[0]), float(self.frequency[-1])
        return min(4 * first, max(first, 0.02 * last))


def _drifting_mains(power: Array, frequency: Array) -> Iterator[tuple[Hump, NDArray[np.bool_]]]:
    """Narrow bands at frequencies of the mains, as a line that drifts makes them, each with its ordinates, (m,)."""
    limit = 1.5 * float(np.log(power.size / UNLIKELY))
    taken = np.zeros(power.size, dtype=bool)
    for mains in MAINS:
        bands = []
        for number in range(1, MOST_HARMONICS + 1):
            off = frequency / (number * mains) - 1
            near = np.abs(off) < DRIFTS
            sides = [(side * off >= DRIFTS) & (side * off < 4 * DRIFTS) for side in (1, -1)]
            beside = sides[0] | sides[1]
            if number * mains * (1 + DRIFTS) > frequency[-1] or np.count_nonzero(beside) < 2 * FIRST_LINE:
                continue
            # a line stands out of both sides; at the edge of a band one of them is as high
            level = max(float(np.median(power[side])) for side in (beside, *sides) if side.any()) / np.log(2)
            if float(power[near].max()) < limit * level:
                continue
            excess = np.maximum(power[near] - level, 0.0)
            middle = float(np.average(frequency[near], weights=excess))
            spread = float(np.sqrt(np.average((frequency[near] - middle) ** 2, weights=excess)))
            across = max(WANDERS * middle, 2 * spread)
            variance = 2 * float(np.sum(excess)) * float(frequency[1])
            bands.append((number, Hump(middle, across / middle, variance / (np.pi * across)), near))
        if len(bands) > 1 or (bands and bands[0][0] == 1):
            for _, hump, near in bands:
                if not (near & taken).any():  # 300 Hz belongs to both
                    taken |= near
                    yield hump, near


def _lines(power: Array) -> NDArray[np.bool_]:
    """Ordinates that stand so far out of those around them that they are lines."""
    found = np.zeros(power.size, dtype=np.bool_)
    limit = np.log(power.size / UNLIKELY)
    first = 16
    while first < power.size - 8:
        part = slice(first, first + max(first // 8, 16))
        near = power[max(first - max(first // 4, 16), 8) : part.stop + max(first // 4, 16)]
        # of exponential ordinates the median is log 2 of the mean; a slope of 1/f^2 bends that by under a half
        level = float(np.median(near)) / np.log(2)
        found[part] = power[part] > 1.5 * limit * level
        first = part.stop
    return _standing_out_near(power, found, 1.5 * limit)


def _standing_out_near(power: Array, found: NDArray[np.bool_], ratio: float) -> NDArray[np.bool_]:
    """Those of the ordinates found that stand out of what is next to them too: else a band of noise is there."""
    borders = [0]
    while borders[-1] < power.size:
        borders.append(borders[-1] + max(2 * FIRST_LINE, int(FINENESS * borders[-1])))

    @cache
    def level(block: int) -> float:
        part = power[borders[block] : borders[block + 1]] if 0 <= block < len(borders) - 1 else power[:0]
        return float(np.median(part)) / np.log(2) if part.size >= FIRST_LINE else 0.0

    kept = found.copy()
    for place in np.flatnonzero(found):
        block = bisect_right(borders, place) - 1
        kept[place] = power[place] > ratio * max(level(near) for near in (block - 1, block, block + 1))
    return kept


def _averages(index: NDArray[np.intp]) -> NDArray[np.intp]:
    """First places of the averages of ordinates, never over a part that is left out."""
    edges, here = [], 0
    while here < index.size:
        edges.append(here)
        width = max(1, int(FINENESS * index[here]))
        last = int(np.searchsorted(index, index[here] + width))
        here = max(last, here + 1)
    return np.array(edges)


def _as_hump(line: Line) -> Hump:
    """A line of the mains as a peak of its power, whose phase in another record is not known."""
    across = WANDERS * line.frequency
    # a peak of level / (1 + (2 d / across)^2) on either side of zero has the variance pi across level
    return Hump(line.frequency, WANDERS, line.amplitude**2 / (2 * np.pi * across))
