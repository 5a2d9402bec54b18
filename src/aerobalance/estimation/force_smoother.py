"""The force by the smoother once its prior and the steps are known, and the errors that it then has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from aerobalance.estimation.error_sources import Contribution, Noise, Systematic
from aerobalance.estimation.least_squares import generalised_least_squares, least_squares, whitened
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.spectra.lines import Line, columns_of_lines
from aerobalance.estimation.statespace.kalman import FORCE, LOAD, KalmanFilter, StateSpace
from aerobalance.estimation.statespace.steady_run import Weighed
from aerobalance.estimation.steps import Step, columns_of, response_to, shape_of, side_variance
from aerobalance.recording.channel import Array

FREQUENCIES: Final = 1 << 14
"""Steps from zero to half the sampling rate in the spectrum of the error: finer than the resonance is wide."""

AT_ONCE: Final = 4
"""Series that are smoothed together."""

SHIFT: Final = 0.05
"""Change of a step's instant over which its slopes are taken, in sampling intervals."""


SIZES_OF_STEPS: Final = "size and instant of steps"
"""Contribution of what is not known of constant and steps, and of lines beside them."""

SIZES_OF_TONES: Final = "size and frequency of steady tones"
"""The same of a record with steady tones and no steps."""

LOST: Final = "narrow bands of the force beyond what its filter can follow"
"""Contribution of what the shaping filter of a spectrum leaves out."""

NEGLIGIBLE: Final = 0.01
"""Part of the power of the error from which on that is one."""

FINE: Final = 8192
"""Frequencies at which that is looked for."""

HIDDEN: Final = "force in gaps of the readings"
"""Contribution of what a gap hides of the force."""


@dataclass(frozen=True, slots=True, eq=False)
class SmootherResult:
    """What the smoother makes of a reading with a given prior and given steps.

    Attributes
    ----------
    reading
        The record.
    learned
        The prior of the force, and the noise.
    steps
        The steps.
    filter
        The filter that goes with them.
    columns
        Reading under the constant, each step of 1 N, and sine and cosine of each line of hum, shape (n, p).
    shapes
        The force itself of each of these, shape (n, p).
    sizes
        Their sizes [N], shape (p,).
    states
        Load, load rate and force that are left when they are taken out, shape (n, 3) [N].
    variance
        Variance of that force, the sizes taken as known, shape (n,) [N^2].
    innovations
        Innovations over their expected standard deviation, shape (n,); 0 where a reading is missing.
    """

    reading: Observation
    learned: SpectralPrior
    steps: tuple[Step, ...]
    filter: KalmanFilter
    columns: Array
    shapes: Array
    sizes: Array
    states: Array
    variance: Array
    innovations: Array

    @classmethod
    def of(cls, reading: Observation, *, learned: SpectralPrior, steps: Sequence[Step]) -> SmootherResult:
        """Smooth a reading."""
        filter_ = KalmanFilter.of(reading.system(learned), reading.present)
        columns = columns_of(list(steps), reading)
        shapes = np.zeros_like(columns)  # hum is no force
        shapes[:, 0] = 1.0
        for place, step in enumerate(steps, start=1):
            shapes[:, place] = shape_of(step, reading)
        if reading.tones:
            shapes[:, -2 * len(reading.tones) :] = forces_of_tones(reading)
        white = whitened(filter_, reading.filled, columns)
        sizes, _, _ = least_squares(white[:, 0], white[:, 1:])
        states = filter_.smooth((reading.filled - columns @ sizes)[:, None])[:, 0]
        variance = filter_.smoothed_variance
        innovations = white[:, 0] - white[:, 1:] @ sizes
        return cls(reading, learned, tuple(steps), filter_, columns, shapes, sizes, states, variance, innovations)

    @property
    def force(self) -> Array:
        """The force, shape (n,) [N]."""
        return np.asarray(self.states[:, FORCE] + self.shapes @ self.sizes)

    @property
    def residuals(self) -> Array:
        """What force, hum and steps leave of the readings, 0 where one is missing, shape (n,) [N]."""
        left = self.reading.filled - self.columns @ self.sizes - self.states[:, LOAD]
        return np.where(self.reading.present, left, 0.0)

    @property
    def tones(self) -> tuple[Line, ...]:
        """The steady tones of the force, with their sizes in the force [N]."""
        frequencies = np.array(self.reading.tones)
        sizes = self.sizes[self.sizes.size - 2 * frequencies.size :].reshape(-1, 2)
        phasors = (sizes[:, 1] - 1j * sizes[:, 0]) / self.reading.dynamics.response(frequencies)
        return tuple(
            Line(float(frequency), -float(phasor.imag), float(phasor.real), 0.0, np.inf, self.reading.drift)
            for frequency, phasor in zip(frequencies, phasors, strict=True)
        )

    def sized(self, lines: Sequence[Line]) -> tuple[Line, ...]:
        """The lines of hum with the sizes that were found together with everything else."""
        first = 1 + len(self.steps)
        sizes = self.sizes[first : first + 2 * len(self.reading.hum)].reshape(-1, 2)
        return tuple(
            replace(line, sine=float(sine), cosine=float(cosine))
            for line, (sine, cosine) in zip(lines, sizes, strict=True)
        )

    @property
    def estimator(self) -> LinearSmoother:
        """The estimator that gave it."""
        heights = [step.height for step in self.steps]
        return LinearSmoother(
            self.filter.system, self.filter, *instant_columns(self.reading, self.steps, heights=heights)
        )

    def noise_errors(self, level: Array, *, sources: tuple[str, str]) -> list[Contribution]:
        """Errors from noise: of the readings, of the ground's motion, and what the model does not explain.

        Parameters
        ----------
        level
            Variance of the innovations over what is expected, where that is more than chance, else 1; shape (n,).
        sources
            Channels of the load and of the ground's motion.
        """
        force, noises = _densities(self.reading, self.learned)
        load, ground = _error_spectra(force, *noises)
        halved = [_error_spectra(force, *(0.25 * one if one is half else one for one in noises)) for half in noises]
        both = float(np.mean(load + ground))
        if not both > 0:
            return [Noise("noise of the readings", sources[0], np.sqrt(self.variance), np.ones(1))]
        variance, hidden = self._by_gaps()
        parts: list[Contribution] = []
        names = ("noise of the readings", "noise of the ground motion")
        for name, source, density, after in zip(names, sources, (load, ground), halved, strict=True):
            own = float(np.mean(density))
            if own > 0:
                left = max(1 - (both - float(np.mean(after[0] + after[1]))) / own, 0.0)
                deviation = np.sqrt(variance * own / both)
                parts.append(Noise(name, source, deviation, density / own, float(np.sqrt(left))))
        beyond = np.sqrt(self.variance * np.maximum(level - 1, 0.0))
        parts.append(Noise("what the model does not explain", sources[0], beyond, (load + ground) / both))
        if hidden.any():
            parts.append(Noise(HIDDEN, sources[0], np.sqrt(hidden), force / float(np.mean(force))))
        lost = self._lost()
        power = float(np.mean(lost))
        if power > NEGLIGIBLE * both:
            size = np.full(self.variance.size, np.sqrt(power / self.reading.interval))
            parts.append(Noise(LOST, sources[0], size, lost / power))
        return parts

    def _lost(self) -> Array:
        """Density of the force that the filter of its spectrum has too few states for, at even frequencies [N^2/Hz].

        Of many narrow bands it keeps the strongest, and the smoother takes the others for noise.
        """
        spectrum = self.learned.spectrum
        if np.count_nonzero(spectrum.levels) < 2:
            return np.zeros(1)
        frequency = np.linspace(0, 0.5 / self.reading.interval, FINE + 1)
        expected = spectrum.density(frequency)
        bands = expected > 0
        kept = np.zeros(frequency.size)
        kept[bands] = self.learned.shaping.spectrum(frequency[bands])
        gain = np.abs(self.reading.dynamics.response(frequency[bands])) ** 2
        noise = self.learned.noise_density(frequency, interval=self.reading.interval)[bands] / gain
        noise += self.reading.input_density
        lost = np.zeros(frequency.size)
        lost[bands] = np.maximum(expected - kept, 0.0)[bands] * (noise / (kept[bands] + noise)) ** 2
        return lost

    def _by_gaps(self) -> tuple[Array, Array]:
        """Variance of the force as elsewhere in the record, and what gaps make it more, shape (n,) each [N^2].

        What noise leaves is the force's error at the frequencies at which the balance tells it badly; what a gap hides
        is the force itself, of its own spectrum, slow where that is.
        """
        present = self.reading.present
        if present.all():
            return self.variance, np.zeros_like(self.variance)
        usual = float(np.median(self.variance[present]))
        return np.minimum(self.variance, usual), np.maximum(self.variance - usual, 0.0)

    def step_errors(self, estimator: LinearSmoother) -> list[Contribution]:
        """Errors from the sizes of constant and steps and from the steps' instants, with its `estimator`."""
        reading, filter_ = self.reading, self.filter
        heights = self.sizes[1 : 1 + len(self.steps)]
        time = reading.interval * np.arange(reading.values.size, dtype=np.float64)
        edge = np.zeros(time.size)
        for step, height in zip(self.steps, heights, strict=True):
            edge += side_variance(step, time, height=float(height), interval=reading.interval)
        numbers = range(1, 1 + heights.size)
        names = ["constant", *(f"step {i}" for i in numbers), *(f"instant of step {i}" for i in numbers)]
        lines = [*(f"hum at {line:.4g} Hz" for line in reading.hum), *(f"{line:.4g} Hz" for line in reading.tones)]
        for line in lines:
            names += [f"{part} of {line}" for part in ("sine", "cosine", "growing sine", "growing cosine")]
        covariance = generalised_least_squares(filter_, reading.filled, estimator.columns)[1]
        slopes = -estimator.size_errors
        source = self.reading.dynamics.component
        return [
            Systematic(name_of_sizes(reading, self.steps), source, tuple(names), slopes, covariance, local=True),
            Noise("which side of a step a sample is on", source, np.sqrt(edge), np.ones(1)),
        ]


@dataclass(frozen=True, eq=False)
class LinearSmoother:
    """The smoother with prior and steps given, run on several series at once.

    Attributes
    ----------
    system, filter
        The state space, and its filter.
    columns, forms
        Load and force of the constant, of every step and of a later instant of it, as `instant_columns` gives them.
    """

    system: StateSpace
    filter: KalmanFilter
    columns: Array
    forms: Array

    @classmethod
    def of(cls, reading: Observation, *, learned: SpectralPrior, steps: Sequence[Step]) -> LinearSmoother:
        """Make the estimator for a reading; the heights of the steps are those found before."""
        system = reading.system(learned)
        columns, forms = instant_columns(reading, steps, heights=[step.height for step in steps])
        return cls(system, KalmanFilter.of(system, reading.present), columns, forms)

    @cached_property
    def _shapes(self) -> tuple[Array, Array]:
        """`size_errors`, and what turns what the smoother shows of a series into sizes, (p, any)."""
        shown = np.empty((self.columns.shape[1], self.filter.shown))
        smooth = self.filter.smooth(self.columns, [FORCE], shown=shown)[:, :, 0]
        scale = np.sqrt(np.sum(shown**2, axis=1, keepdims=True))
        scale[scale == 0] = 1.0
        return smooth - self.forms, np.linalg.pinv((shown / scale).T, rcond=1e-10) / scale

    @cached_property
    def _weights(self) -> tuple[Weighed, ...]:
        """What makes sizes of the known shapes of a series that the filter runs along."""
        return self.filter.weighed(self._shapes[1])

    @property
    def size_errors(self) -> Array:
        """Error of the force where the size of a known shape is wrong by 1, less the shape itself, shape (n, p)."""
        return self._shapes[0]

    @property
    def size_covariance(self) -> Array:
        """Covariance of the sizes of the known shapes, shape (p, p)."""
        return self._shapes[1] @ self._shapes[1].T

    def run(self, series: Array) -> Array:
        """The force that several series lead to, shape (n, c) [N]; a few at a time, as each takes room."""
        out = np.empty(series.shape[::-1])
        for first in range(0, series.shape[1], AT_ONCE):
            force, sizes = self.apart(series[:, first : first + AT_ONCE])
            out[first : first + AT_ONCE] = (force - self.size_errors @ sizes).T
        return out.T

    def apart(self, series: Array) -> tuple[Array, Array]:
        """The force of several series (n, c) if they have no known shapes, (n, c) [N], and sizes of these, (p, c)."""
        force, sizes = self.filter.smooth_and_sum(series, [FORCE], self._weights)
        return force[:, :, 0], sizes


def name_of_sizes(reading: Observation, steps: Sequence[Step]) -> str:
    """Return the name of the contribution of what is not known of constant, steps and lines."""
    return SIZES_OF_TONES if reading.tones and not steps else SIZES_OF_STEPS


def instant_columns(
    reading: Observation, steps: Sequence[Step], *, heights: Sequence[float] | Array
) -> tuple[Array, Array]:
    """Balance load under the constant, under every step of 1 N and under its later instant, and the forces of these.

    Lines of hum and tones of the load come last, each with its sine and cosine and the same growing along the record:
    that is what an error of its frequency does, and a slow change of its amplitude.

    Returns
    -------
    columns, forms
        Reading [1; N/s] and force, shape (n, 1 + 2 steps + 4 lines). The force of a pure step has no slope with its
        instant.
    """
    count, small = reading.values.size, SHIFT * reading.interval
    steady = replace(reading, hum=(), tones=())
    columns, forms = [columns_of(list(steps), steady)], [np.ones(count)]
    forms += [shape_of(step, reading) for step in steps]
    for step, height in zip(steps, heights, strict=True):
        late, early = (Step(step.instant + shift, step.duration) for shift in (small, -small))
        columns.append(height * (response_to(late, reading) - response_to(early, reading)) / (2 * small))
        slope = height * (shape_of(late, reading) - shape_of(early, reading)) / (2 * small)
        forms.append(slope if step.duration > 0 else np.zeros_like(slope))
    growing = np.linspace(-1, 1, count)[:, None]
    for line in reading.hum:
        both = columns_of_lines([line], count=count, interval=reading.interval)
        columns += [both, growing * both]
        forms += [np.zeros((count, 4))]
    for tone in reading.tones:
        one = replace(steady, tones=(tone,))
        both = columns_of([], one)[:, 1:]
        columns += [both, growing * both]
        force = forces_of_tones(one)
        forms += [force, growing * force]
    return np.column_stack(columns), np.column_stack(forms)


def forces_of_tones(reading: Observation) -> Array:
    """Return the forces that make sine and cosine of each tone of 1 N in the reading, shape (n, 2 tones) [1]."""
    shown = columns_of_lines(reading.tones, count=reading.values.size, interval=reading.interval, drift=reading.drift)
    inverse = 1 / reading.dynamics.response(np.array(reading.tones))
    found = np.empty_like(shown)
    for place, turned in enumerate(inverse):
        sine, cosine = shown[:, 2 * place], shown[:, 2 * place + 1]
        found[:, 2 * place] = turned.real * sine + turned.imag * cosine
        found[:, 2 * place + 1] = turned.real * cosine - turned.imag * sine
    return found


def _densities(reading: Observation, learned: SpectralPrior) -> tuple[Array, tuple[Array, Array]]:
    """Density of the force, and of its noises: that of the reading seen through the balance, and the ground's."""
    frequency = np.linspace(0, 0.5 / reading.interval, FREQUENCIES + 1)
    gain = np.abs(reading.dynamics.response(frequency)) ** 2
    seen = learned.noise_density(frequency, interval=reading.interval) / gain
    return learned.shaping.spectrum(frequency), (seen, np.full(frequency.size, reading.input_density))


def _error_spectra(force: Array, seen: Array, ground: Array) -> tuple[Array, Array]:
    """Spectrum of the force's error, S_F N / (S_F + N), shared out over the two noises in N = R / |G|^2 + U."""
    whole = np.maximum(force + seen + ground, 1e-300)
    return force * seen / whole, force * ground / whole
