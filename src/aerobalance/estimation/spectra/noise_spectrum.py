r"""Power spectral density of the noise of a reading: a white part, a 1/f part below a corner, humps or bands.

The two-sided density is R (1 + (f_c / f)^a) plus broad humps, or plus bands between edges. For the estimator, which
needs processes of few states, the 1/f part becomes a sum of relaxations (first-order Markov processes, one state each)
whose corners are a factor `CORNER_RATIO` apart [Keshner1982]_, a hump becomes an oscillator of two states, and all
bands become one shaping filter, which leaves the white part beside them as it is.

Readings are written in N; for a moment, read N*m.

References
----------
.. [Keshner1982] M. S. Keshner, "1/f noise", Proc. IEEE 70 (1982) 212.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import nnls

from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.recording.channel import Array

EXPONENTS: Final = (0.3, 2.0)
"""Least and largest exponent a of 1/f^a [1]; 2 is a random walk."""

CORNER_RATIO: Final = 3.0
"""Ratio of the corners of neighbouring relaxations [1]: their sum departs from a power of frequency by under 1 %."""

SLOWEST: Final = 1 / 3
"""Frequency below which the density of 1/f noise is taken as constant, over 1 / duration of the record [1]."""

NARROW: Final = 4.0
"""Width of a hump over that of what it is averaged over, up to which that changes it."""

ASIDE: Final = 1e-6
"""Distance from an edge, over its frequency, at which the density on either side of it is taken."""

MEAN_AT: Final = 4096
"""Frequencies at which the mean of a density is taken."""

CROSSING_AT: Final = 2001
"""Frequencies at which it is looked for where the 1/f part falls below the rest."""

BESIDE: Final = 0.3
"""Error of the root of the density that a filter makes beside the bands of a noise, over the root of the white one."""

CLOSE: Final = 0.03
"""The same within them, over the root of the mean density."""

NEGLIGIBLE: Final = 0.01
"""Density of the 1/f part over the white one [1]; at frequencies where it is lower it needs no relaxation."""


@dataclass(frozen=True, slots=True)
class Hump:
    """A broad peak of the noise: a two-sided density of level (w f f_h)^2 / ((f_h^2 - f^2)^2 + (w f f_h)^2).

    Attributes
    ----------
    frequency
        Centre frequency f_h [Hz].
    width
        Width at half of its height over its centre frequency, w [1].
    level
        Its two-sided density at the centre, added to that of the other parts [N^2/Hz].
    """

    frequency: float
    width: float
    level: float

    def density(self, frequency: Array) -> Array:
        """Two-sided density of the process in continuous time at frequencies [Hz], of their shape [N^2/Hz]."""
        across = self.width * frequency * self.frequency
        return np.asarray(self.level * across**2 / ((self.frequency**2 - frequency**2) ** 2 + across**2))

    def sampled(self, frequency: Array, interval: float) -> Array:
        """Two-sided density of its samples at frequencies [Hz], with the aliases from either side [N^2/Hz]."""
        return np.asarray(sum(self.density(frequency + shift / interval) for shift in (0, -1, 1)))

    def slopes(self, frequency: Array, interval: float) -> Array:
        """Derivatives of `sampled` with the logarithms of frequency, width and level [N^2/Hz], shape (3, n)."""
        whole = np.zeros((3, frequency.size))
        for shift in (0, -1, 1):
            f = frequency + shift / interval
            off = self.frequency**2 - f**2
            across, square = (self.width * f * self.frequency) ** 2, off**2
            density = self.level * across / (square + across)
            whole[0] += density * (2 - (2 * across + 4 * self.frequency**2 * off) / (square + across))
            whole[1] += 2 * density * square / (square + across)
            whole[2] += density
        return whole

    def mean(self, frequency: Array, width: float, interval: float) -> Array:
        """Mean of `sampled` over a width about frequencies [Hz], of their shape [N^2/Hz]."""
        across = self.width * self.frequency
        if across > NARROW * width:
            return self.sampled(frequency, interval)
        # near its centre a narrow peak is level / (1 + (2 d / across)^2) at a distance d
        edges = (2 * (frequency + side * width / 2 - self.frequency) / across for side in (1, -1))
        high, low = (np.arctan(edge) for edge in edges)
        return np.asarray(self.level * across / (2 * width) * (high - low))

    @property
    def shaping(self) -> ShapingFilter:
        """Shaping filter of two states: a damped oscillator, of which the noise is the velocity [N]."""
        w = 2 * np.pi * self.frequency
        drift = np.array([[-self.width * w, -w], [w, 0.0]])
        return ShapingFilter(drift, np.array([self.width * w * np.sqrt(self.level), 0.0]))


@dataclass(frozen=True, slots=True)
class Band:
    """A part of the noise between two edges: a two-sided density of level (f / f_2)^b, and none beyond them.

    Attributes
    ----------
    first, last
        Its edges [Hz], the upper one f_2.
    level
        Its two-sided density below the upper edge, added to that of the other parts [N^2/Hz].
    exponent
        Power b of frequency as which it rises [1]; 0 for a constant level.
    """

    first: float
    last: float
    level: float
    exponent: float = 0.0

    def density(self, frequency: Array) -> Array:
        """Two-sided density of the samples at frequencies [Hz], of their shape [N^2/Hz]."""
        inside = (frequency >= self.first) & (frequency <= self.last)
        if not self.exponent:
            return np.where(inside, self.level, 0.0)
        return np.where(
            inside, self.level * (np.where(inside, frequency, self.last) / self.last) ** self.exponent, 0.0
        )

    def told(self, white: float) -> str:
        """In words, beside a white density [N^2/Hz]."""
        size = f"{self.level / white:.3g} times its density between {self.first:.4g} and {self.last:.4g} Hz"
        if not self.exponent:
            return f"a band of {size}"
        return f"a band that {'rises' if self.exponent > 0 else 'falls'} as f^{self.exponent:.2g} to {size}"


@dataclass(frozen=True, slots=True, eq=False)
class ColoredNoise:
    """Coloured part of a noise as a state-space model: independent processes of one or two states each.

    Attributes
    ----------
    corners, variances
        Corner frequencies [Hz] and variances [N^2] of the relaxations, shape (r,) each.
    humps
        Its broad peaks.
    interval
        Time between samples [s].
    shaped
        What it has between edges, as one process; None for nothing.
    """

    corners: Array
    variances: Array
    humps: tuple[Hump, ...]
    interval: float
    shaped: ShapedNoise | None = None

    @property
    def shapings(self) -> tuple[ShapingFilter, ...]:
        """Shaping filters that make the processes out of white noise: relaxations, humps, what is between edges."""
        rates = 2 * np.pi * self.corners
        relaxations = (
            ShapingFilter(np.array([[-rate]]), np.array([np.sqrt(2 * rate * variance)]))
            for rate, variance in zip(rates, self.variances, strict=True)
        )
        between = () if self.shaped is None else self.shaped.shapings
        return (*relaxations, *(hump.shaping for hump in self.humps), *between)

    def scaled(self, ratio: float) -> ColoredNoise:
        """The same with a ratio of the power."""
        humps = tuple(replace(hump, level=ratio * hump.level) for hump in self.humps)
        shaped = None if self.shaped is None else self.shaped.scaled(ratio)
        return replace(self, variances=ratio * self.variances, humps=humps, shaped=shaped)

    def density(self, frequency: Array, *, width: float = 0.0) -> Array:
        """Two-sided density of the samples at frequencies [Hz], of their shape [N^2/Hz].

        With a `width` [Hz], it is the mean over that width around each frequency: relaxations and lines of hum may
        change much within an ordinate of a periodogram.
        """
        frequency = np.asarray(frequency, dtype=np.float64)
        whole = np.zeros(frequency.shape)
        for corner, variance in zip(self.corners, self.variances, strict=True):
            if width > 0:
                low, high = frequency - width / 2, frequency + width / 2
                whole += variance * (
                    _power_below(high, corner, self.interval) - _power_below(low, corner, self.interval)
                )
            else:
                whole += variance * _relaxation(frequency, corner, self.interval)
        whole /= width or 1.0
        for hump in self.humps:
            whole += (
                hump.mean(frequency, width, self.interval) if width > 0 else hump.sampled(frequency, self.interval)
            )
        return whole if self.shaped is None else whole + self.shaped.density(frequency)


@dataclass(frozen=True, slots=True, eq=False)
class ShapedNoise:
    """Coloured part of a noise as a state-space model: one process of any spectrum.

    Attributes
    ----------
    shaping
        Shaping filter that makes it out of white noise.
    interval
        Time between samples [s].
    """

    shaping: ShapingFilter
    interval: float

    @property
    def shapings(self) -> tuple[ShapingFilter, ...]:
        """Shaping filters that make the processes out of white noise: one."""
        return (self.shaping,)

    @classmethod
    def of_density(
        cls,
        density: Callable[[Array], Array],
        *,
        interval: float,
        centre: float,
        tolerance: float,
        goes_on: bool = True,
    ) -> ShapedNoise:
        """Approximate a density of samples by a process in continuous time.

        Parameters
        ----------
        density
            Two-sided density of the samples at frequencies from 0 to half the sampling rate [Hz], above 0 [N^2/Hz].
        interval
            Time between samples [s].
        centre, tolerance
            As for `ShapingFilter.of_spectrum`.
        goes_on
            Whether it goes on beyond half the sampling rate, which is folded back; else it has ended below.
        """
        highest = 0.5 / interval

        def whole(f: Array) -> Array:
            ratio = f / highest
            if not goes_on:
                return np.asarray(density(np.minimum(f, highest)) * np.maximum(ratio, 1.0) ** -8)
            # it is folded back as much as it has fallen there
            folded = 1 / (1 + ratio**8) + 1 / (1 + (2 - np.minimum(ratio, 2)) ** 8)
            known = density(np.where(f > highest, np.maximum(2 * highest - f, 0.0), f))
            return np.asarray(known / folded / (1 + ratio**8))

        return cls(ShapingFilter.of_spectrum(whole, centre=centre, tolerance=tolerance), interval)

    def scaled(self, ratio: float) -> ShapedNoise:
        """The same with a ratio of the power."""
        return replace(self, shaping=replace(self.shaping, drive=np.sqrt(ratio) * self.shaping.drive))

    def density(self, frequency: Array, *, width: float = 0.0) -> Array:
        """Two-sided density of the samples at frequencies [Hz], with the aliases from either side [N^2/Hz].

        The `width` over which a mean is asked for is not used: the density hardly changes within an ordinate.
        """
        frequency = np.asarray(frequency, dtype=np.float64)
        shifts = (0.0, -1 / self.interval, 1 / self.interval)
        return np.asarray(sum(self.shaping.spectrum(frequency + shift) for shift in shifts))


def _relaxation(frequency: Array, corner: float, interval: float) -> Array:
    """Two-sided density of the samples of a relaxation of variance 1 [1/Hz]: an AR(1) process."""
    correlation = np.exp(-2 * np.pi * corner * interval)
    sine_term = 4 * correlation * np.sin(np.pi * frequency * interval) ** 2
    return np.asarray(interval * (1 - correlation**2) / ((1 - correlation) ** 2 + sine_term))


def _power_below(frequency: Array, corner: float, interval: float) -> Array:
    """Integral of `_relaxation` from 0 to a frequency [1]: odd, and 1/2 from half the sampling rate on."""
    correlation = np.exp(-2 * np.pi * corner * interval)
    inside = np.clip(frequency * interval, -0.5, 0.5)
    angle = np.pi * inside
    return np.asarray(np.arctan2((1 + correlation) * np.sin(angle), (1 - correlation) * np.cos(angle)) / np.pi)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseSpectrum:
    """Two-sided power spectral density of the noise of a reading, R (1 + (f_c / f)^a) plus humps and bands.

    Attributes
    ----------
    white
        Density R of the white part [N^2/Hz].
    corner
        Frequency f_c at which the 1/f part is as strong as the white one [Hz]; 0 for no 1/f part.
    exponent
        Exponent a [1].
    humps
        Broad peaks that are added.
    interval
        Time between the samples of the readings [s].
    covariance
        Covariance of the estimates of the logarithm of the 1/f part at 1 Hz and of the exponent, shape (2, 2) [1].
    u_white
        Relative standard uncertainty of the white density [1].
    left_out
        Frequencies of lines of the record that are no noise, and that the density leaves out [Hz].
    hum
        Lines of the mains, each a peak as narrow as a line that keeps its phase for some seconds.
    bands
        Parts between edges that are added, as filters of a converter leave them.
    slow_end
        Frequency from which on such a filter leaves nothing of the 1/f part [Hz].
    """

    white: float
    corner: float
    exponent: float
    humps: tuple[Hump, ...]
    interval: float
    covariance: Array
    u_white: float = 0.0
    left_out: tuple[float, ...] = ()
    hum: tuple[Hump, ...] = ()
    bands: tuple[Band, ...] = ()
    slow_end: float = np.inf

    def __post_init__(self) -> None:
        if not (0 < self.white < np.inf and 0 < self.interval < np.inf):
            raise ValueError("the white density of a noise and its interval must be positive")
        if not 0 <= self.corner < np.inf or not (self.corner == 0 or 0 < self.exponent <= EXPONENTS[1]):
            raise ValueError(f"corner must be 0 or more, and exponent above 0 and at most {EXPONENTS[1]:g}")

    @property
    def deviation(self) -> float:
        """Standard deviation of the white part of one reading [N]."""
        return float(np.sqrt(self.white / self.interval))

    @property
    def colored(self) -> bool:
        """Whether there is a 1/f part, a hump, a band or hum."""
        return bool(self.corner > 0 or self.humps or self.hum or self.bands)

    def __str__(self) -> str:
        """The parts in words."""
        parts = ["white noise"]
        if self.corner:
            parts.append(f"1/f^{self.exponent:.2g} below {self._crossing:.3g} Hz")
        parts += [f"a hump at {hump.frequency:.3g} Hz" for hump in self.humps]
        parts += [band.told(self.white) for band in self.bands]
        parts += [f"hum at {line.frequency:.4g} Hz" for line in self.hum]
        return ", ".join(parts)

    def density(self, frequency: Array) -> Array:
        """Best estimate of the two-sided density at frequencies above 0 [Hz], of their shape [N^2/Hz]."""
        frequency = np.asarray(frequency, dtype=np.float64)
        return self.white + self._slow(frequency) + self._others(frequency)

    def _slow(self, frequency: Array) -> Array:
        """Density of the 1/f part at frequencies above 0 [Hz], of their shape [N^2/Hz]."""
        if not self.corner:
            return np.zeros(frequency.shape)
        return np.where(frequency <= self.slow_end, self.white * (self.corner / frequency) ** self.exponent, 0.0)

    def _others(self, frequency: Array) -> Array:
        """Density of humps, hum and bands at frequencies above 0 [Hz], of their shape [N^2/Hz]."""
        whole = self._between(frequency)
        for hump in (*self.humps, *self.hum):
            whole += hump.sampled(frequency, self.interval)
        return whole

    @property
    def _crossing(self) -> float:
        """Frequency at which the 1/f part falls below the white part and the bands [Hz]: its corner without bands."""
        if not self.bands:
            return self.corner
        frequency = np.geomspace(min(1e-6 / self.interval, self.corner), self.corner, CROSSING_AT)
        level = self.white + self._between(frequency)
        return float(frequency[np.argmax(self.white * (self.corner / frequency) ** self.exponent <= level)])

    def relative_uncertainty(self, frequency: Array) -> Array:
        """Relative standard uncertainty of the 1/f part at frequencies above 0 [Hz], of their shape [1]."""
        slopes = np.stack([np.ones(np.shape(frequency)), -np.log(frequency)])  # of the logarithm of the 1/f part
        return np.asarray(np.sqrt(np.einsum("i...,ij,j...->...", slopes, self.covariance, slopes)))

    def colored_part(self, duration: float) -> ColoredNoise | None:
        """State-space model of all but the white part, for a record of a duration [s]; None for white noise.

        The variances of the relaxations are fitted, none below zero, to the expected density: exp(u^2 / 2) times the
        best estimate where that has the relative uncertainty u, as the variance of an error of the force is linear in
        the density. Below `SLOWEST` / duration the density is constant: what is slower is the zero of the reading,
        of which neither the noise record nor this one tells anything.
        """
        if not self.colored:
            return None
        corners = variances = np.zeros(0)
        if self.corner:
            slowest = SLOWEST / duration
            fastest = min(max(self._crossing * NEGLIGIBLE ** (-1 / self.exponent), 4 * slowest), 0.5 / self.interval)
            count = int(np.ceil(np.log(fastest / slowest) / np.log(CORNER_RATIO))) + 1
            corners = np.geomspace(slowest, fastest, count)
            frequency = np.geomspace(slowest / 10, min(0.5 / self.interval, self.slow_end), 40 * count)
            flattened = np.sqrt(frequency**2 + slowest**2)
            target = self.white * (self.corner / flattened) ** self.exponent
            target *= np.exp(np.minimum(self.relative_uncertainty(flattened), 1.0) ** 2 / 2)
            densities = np.column_stack([_relaxation(frequency, corner, self.interval) for corner in corners])
            weight = 1 / (target + self.white + self._between(frequency))  # an error matters relative to the whole
            scale = np.linalg.norm(densities * weight[:, None], axis=0)
            sizes, _ = nnls(densities * weight[:, None] / scale, target * weight)
            kept = sizes > 0
            corners, variances = corners[kept], (sizes / scale)[kept]
        return ColoredNoise(corners, variances, (*self.humps, *self.hum), self.interval, self._shaped)

    @property
    def _shaped(self) -> ShapedNoise | None:
        """What is between edges as one process; None for nothing."""
        if not self.bands:
            return None
        highest = 0.5 / self.interval
        edges = np.unique([edge for band in self.bands for edge in (band.first, band.last) if 0 < edge < highest])
        if edges.size:
            sides = np.log(self.white + self._between(edges * np.array([[1 - ASIDE], [1 + ASIDE]])))
            centre = float(edges[np.argmax(np.abs(sides[1] - sides[0]))])
        else:
            centre = highest / 2
        mean = self.white + sum(self._between(np.linspace(0, highest, MEAN_AT))) / MEAN_AT
        tolerance = min(CLOSE * np.sqrt(mean), BESIDE * np.sqrt(self.white))

        def density(f: Array) -> Array:
            return self._between(f) + CLOSE**2 * self.white

        goes_on = bool(self._between(np.array(highest)) > 0)
        return ShapedNoise.of_density(
            density, interval=self.interval, centre=centre, tolerance=float(tolerance), goes_on=goes_on
        )

    def _between(self, frequency: Array) -> Array:
        """Density of the bands at frequencies [Hz], of their shape [N^2/Hz]."""
        return np.asarray(sum((band.density(frequency) for band in self.bands), np.zeros(np.shape(frequency))))
