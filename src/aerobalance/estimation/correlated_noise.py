r"""Noise that decoupled components have in common, taken off the one by what the others show of it.

The readings of all channels have a part in every component that has been decoupled, z_i = G_i F_i + e_i, and so has
their noise. Above the band of its own force component j shows little but noise, some of which is in z_i as well. With
E the spectra of e, and Phi = G S G* those of the forces in the readings, a diagonal, the best linear estimate of F_i
from all readings is that from

    z_i' = z_i - B z_o,    B = E_io (E_oo + Phi_o)^-1,

alone, where o are the other components: the inverse of a matrix in blocks. What is left in z_i' is F_i as before, with
noise of the spectrum E_ii - B E_oi. So what one estimator does with one component becomes the best that can be done
with six. In z_o the force is first taken for what it was found to be by the component alone: what is left over of the
reading is E_jj / (E_jj + Phi_j) of z_j where nothing but Phi is in it, and holds no step, no constant, and no free
oscillation that was under way when the record began.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import BESIDE_A_GAP
from aerobalance.estimation.spectra.noise_spectrum import ShapedNoise
from aerobalance.estimation.spectra.periodogram import Periodogram
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import convolve
from aerobalance.recording.resampling import EDGE, interpolate_gaps_linearly

WORTHWHILE: Final = 0.02
"""Decrease of the expected error, as a share of it, from which on noise is taken off."""

NOTICEABLE: Final = 0.05
"""Noise by which another component changes the reading at most, over that of the reading, below which it is let be."""

EXCESS: Final = 0.15
"""Power beyond what is expected of the noise that is left, over it, in a sixteenth of the frequencies above the force:
more would be taken for a force there, and what is off by a seventh of that costs nothing."""

PARTS: Final = 16
"""Parts in which it is looked for."""

FREQUENCIES: Final = 1 << 13
"""Steps from zero to half the sampling rate in which the filters are given; half as many samples either side is
their reach, a few times as long as any mode within the noise rings."""

UNSEEN: Final = 0.03
"""Force of another component in its reading, over the noise there, that may have been missed at any frequency: a
spectrum over a thousand ordinates shows no less."""

CLOSE: Final = 0.02
"""Error of the square root of the density of what is left, over that of the noise before, that saves states."""


@dataclass(frozen=True, slots=True, eq=False)
class SharedNoise:
    """Noise of one component, as far as the other components' readings predict it.

    Attributes
    ----------
    others
        Places of those others, c of them.
    models
        Their models: with other dynamics of the components it is these that the others go on to be read with.
    found
        The noise to be taken off its reading, shape (samples,) [N].
    readings
        The others' readings that it was found in, shape (samples, c).
    weights
        Impulse response of B, shape (2 m + 1, c); the middle one is at no delay.
    before
        Standard deviation of the noise of its reading as it was [N].
    white
        Standard deviation of the white part of what is left [N].
    color
        What is left beyond that.
    error
        Expected error of its force over what it was [1].
    level
        Variance of its force over what is expected from the noise that is left, shape (samples,): beside an end of the
        record and beside missing readings, which the others' readings are wanted for, it is what it was before [1].
    """

    others: tuple[int, ...]
    models: tuple[ModalModel, ...]
    found: Array
    readings: Array
    weights: Array
    before: float
    white: float
    color: ShapedNoise
    error: float
    level: Array

    def of(self, readings: Array) -> Array:
        """Noise to take off when the others read this, shape (samples, c) [N]; with other dynamics, say."""
        change = readings - self.readings
        return self.found + filtered(self.weights, change) if change.any() else self.found

    def slopes(self, series: Array, other: int) -> Array:
        """Change of the noise taken off with series that one of the others reads, both of shape (samples, k)."""
        if not series.shape[1]:
            return np.zeros_like(series)
        weights = self.weights[:, [self.others.index(other)]]
        return np.column_stack([filtered(weights, column[:, None]) for column in series.T])


def filtered(weights: Array, series: Array) -> Array:
    """Sum of series (samples, c) through filters (2 m + 1, c), zero beyond their ends; shape (samples,)."""
    middle = weights.shape[0] // 2
    whole = convolve(series, weights).sum(axis=1)
    return np.asarray(whole[middle : middle + series.shape[0]])


@dataclass(frozen=True, slots=True, eq=False)
class NoiseMatrix:
    """Spectra of the noise of all decoupled components, and of their forces in the readings.

    Attributes
    ----------
    models
        The components' equivalent models, n of them.
    frequency
        Frequencies [Hz], shape (m,).
    whole
        Two-sided cross-spectral densities of the noise, shape (n, n, m).
    own
        Those of the readings' noise alone, without that of the ground's motion.
    force
        Spectral densities of the forces, shape (m, n).
    gain
        Squares of their responses, shape (m, n).
    """

    models: tuple[ModalModel, ...]
    frequency: Array
    whole: NDArray[np.complex128]
    own: NDArray[np.complex128]
    force: Array
    gain: Array

    @classmethod
    def of(
        cls,
        decoupled: Sequence[DecoupledChannel],
        learned: Sequence[SpectralPrior],
        *,
        interval: float,
        noise: Array,
        ground: Array,
        steps: int = FREQUENCIES,
    ) -> NoiseMatrix:
        """Return the spectra from how the components are decoupled and what was learned of them.

        Parameters
        ----------
        decoupled, learned
            How the components are decoupled, and what was learned of their forces and noise.
        interval
            Time between samples [s].
        noise
            Covariance of the noise of a reading, shape (n, n); its ratios are what matters.
        ground
            Covariance of the force that the noise of the ground's motion is taken for, shape (n, n) [N^2].
        steps
            Steps of frequency from zero to half the sampling rate.
        """
        frequency: Array = np.linspace(0, 0.5 / interval, steps + 1)
        rows = np.stack([one.noise_response(frequency) for one in decoupled], axis=1)
        answers = np.stack([one.dynamics.response(frequency) for one in decoupled], axis=1)
        size = np.array([one.noise for one in learned]) / np.sqrt(np.diag(noise))
        own = interval * (rows * size[:, None]) @ noise @ (rows * size[:, None]).conj().transpose(0, 2, 1)
        shaken = interval * answers[:, :, None] * ground * answers.conj()[:, None, :]
        force = np.stack([one.shaping.spectrum(frequency) for one in learned], axis=1)
        whole, own = (np.ascontiguousarray(one.transpose(1, 2, 0)) for one in (own + shaken, own))
        return cls(tuple(one.dynamics for one in decoupled), frequency, whole, own, force, np.abs(answers) ** 2)

    @property
    def felt(self) -> Array:
        """Spectral densities of the forces in the readings, what may have been missed included, shape (m, n)."""
        noise = np.real(np.einsum("jjm->mj", self.whole))
        return np.asarray(np.maximum(self.gain * self.force, UNSEEN * noise))

    def weights_of(self, place: int, others: Sequence[int]) -> NDArray[np.complex128]:
        """Weights with which the others' readings tell the noise of one component best, shape (c, m) [1]."""
        shown = self.whole[np.ix_(others, others)]
        shown[np.arange(len(others)), np.arange(len(others))] += self.felt[:, others].T
        return _weights(shown, self.whole[others, place])

    def is_worthwhile(self, place: int, share: float) -> bool:
        """Whether its error falls by this share of it, or by more, where all the others tell its noise."""
        others = [other for other in range(len(self.models)) if other != place]
        if not others:
            return False
        before = np.real(self.whole[place, place])
        left = self._left(self.whole, place, self.weights_of(place, others), others)
        return self.error_of(place, left) < (1 - share) ** 2 * self.error_of(place, before)

    def left_of(self, place: int, others: Sequence[int]) -> tuple[NDArray[np.complex128], Array, Array]:
        """Weights of the others (m, c), density of the noise that is left (m,), and the least it could be [N^2/Hz]."""
        weights = self.weights_of(place, others)
        least = _weights(self.own[np.ix_(others, others)], self.own[others, place])
        left, least_left = self._left(self.whole, place, weights, others), self._left(self.own, place, least, others)
        return weights.T, left, least_left

    @staticmethod
    def _left(
        spectra: NDArray[np.complex128], place: int, weights: NDArray[np.complex128], others: Sequence[int]
    ) -> Array:
        taken = np.sum(weights * spectra[others, place], axis=0)
        return np.asarray(np.real(spectra[place, place] - taken))

    def error_of(self, place: int, noise: Array) -> float:
        """Variance of the error that a noise of this density leaves [N^2]."""
        force, gain = self.force[:, place], self.gain[:, place]
        step = float(self.frequency[1] - self.frequency[0])
        return 2 * step * float(np.sum(force * noise / np.maximum(gain * force + noise, 1e-300)))


def _weights(shown: NDArray[np.complex128], common: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Conjugate solutions of Hermitian equations at all frequencies at once, (c, m) from (c, c, m) and (c, m).

    Elimination needs no exchange of rows, as all spectra are positive: a fifth of the time of one LU after the other.
    """
    whole = np.concatenate([shown, common[:, None]], axis=1)
    count = whole.shape[0]
    for place in range(count):
        whole[place, place + 1 :] /= whole[place, place].real
        for other in range(place + 1, count):
            whole[other, place + 1 :] -= whole[other, place] * whole[place, place + 1 :]
    for place in reversed(range(count)):
        for other in range(place):
            whole[other, count] -= whole[other, place] * whole[place, count]
    return np.asarray(whole[:, count].conj())


def shared_noise(
    spectra: NoiseMatrix,
    place: int,
    *,
    residuals: Array,
    present: NDArray[np.bool_],
    readings: Callable[[int], Array],
) -> SharedNoise | None:
    """Return the noise of one component that the others predict; None where its force would not be better for it.

    Parameters
    ----------
    spectra
        Spectra of noise and forces.
    place
        Which component.
    residuals
        What each component's force leaves of its reading, on the clock of this one, shape (samples, n).
    present
        False where a component has no reading, shape (samples, n).
    readings
        Gives the reading of another component by its place, on the same clock, shape (samples,).
    """
    others = [other for other in range(spectra.force.shape[1]) if other != place]
    if not others:
        return None
    size = np.sqrt(np.real(np.einsum("jjm->mj", spectra.whole)))
    changes = np.abs(spectra.weights_of(place, others).T) * size[:, others] / size[:, [place]]
    others = [other for other, change in zip(others, changes.max(axis=0), strict=True) if change > NOTICEABLE]
    if not others:
        return None
    weights, left, least = spectra.left_of(place, others)
    before, after = (spectra.error_of(place, noise) for noise in (size[:, place] ** 2, left))
    if not after < (1 - WORTHWHILE) ** 2 * before:
        return None
    shown = 1 + spectra.felt[:, others] / size[:, others] ** 2
    # the white noise of the ground's motion is told to the estimator apart
    shaken = size[:, place] ** 2 - np.real(spectra.own[place, place])
    interval = 0.5 / float(spectra.frequency[-1])
    own = float(np.mean(np.real(spectra.own[place, place])))
    rest = np.maximum(left - shaken, least)
    white, color = _colored(spectra.frequency, rest, before=own, interval=interval)
    from scipy.ndimage import minimum_filter1d  # noqa: PLC0415 - takes 30 ms, and few records need it

    inside = minimum_filter1d(present[:, [place, *others]].all(axis=1), 2 * EDGE + 1, mode="constant", cval=False)
    error = float(np.sqrt(after / before))
    return SharedNoise(
        others=tuple(others),
        models=tuple(spectra.models[other] for other in others),
        found=filtered(_impulses(weights * shown), residuals[:, others]),
        readings=np.column_stack([readings(other) for other in others]),
        weights=_impulses(weights),
        before=float(np.sqrt(own / interval)),
        white=float(np.sqrt(white / interval)),
        color=color,
        error=error,
        level=np.where(inside, 1.0, error**-2),
    )


def as_expected(reading: Observation, before: SpectralPrior) -> bool:
    """Whether a reading with noise taken off has no more of it than is said, where its force shows nothing.

    It has where readings were shifted by parts of a sample, which weakens noise near half the sampling rate, or where
    the noise of the channels is not white.

    Parameters
    ----------
    reading
        The component's record with what is left of the noise.
    before
        What was learned of its force before.
    """
    if reading.noise is None:
        raise AssertionError
    values, color = reading.values - np.nanmean(reading.values), reading.color
    seen = Periodogram.of(
        interpolate_gaps_linearly(np.where(reading.present, values, np.nan), beside=BESIDE_A_GAP),
        reading.dynamics,
        interval=reading.interval,
        input_density=reading.input_density,
        color=None if color is None else lambda f, width: color.density(f, width=width),
    )
    noise = seen.background(reading.noise**2 * reading.interval)
    force = seen.gain * before.shaping.spectrum(seen.frequency)
    silent = np.flatnonzero((force < noise / 10) & (seen.frequency > reading.dynamics.natural_frequency))
    ratios, weight = (seen.density / (noise + force))[silent], seen.weight[silent]
    share = np.cumsum(weight) / max(float(weight.sum()), 1e-300)
    parts = np.array_split(np.arange(silent.size), np.searchsorted(share, np.arange(1, PARTS) / PARTS))
    if not all(part.size for part in parts):
        return False
    chance = 5 * float(np.sqrt(PARTS / weight.sum()))
    return max(float(np.average(ratios[part], weights=weight[part])) for part in parts) < 1 + EXCESS + chance


def _impulses(weights: NDArray[np.complex128]) -> Array:
    """Impulse responses of filters given at frequencies, tapered towards the ends of their reach."""
    taps = np.fft.irfft(weights, axis=0)
    middle = taps.shape[0] // 2
    taps = np.roll(taps, middle, axis=0)[middle - middle // 2 : middle + middle // 2 + 1]
    return np.asarray(taps * np.hanning(taps.shape[0] + 2)[1:-1, None])


def _colored(frequency: Array, density: Array, *, before: float, interval: float) -> tuple[float, ShapedNoise]:
    """A noise as a white part, the level at half the sampling rate, and what is above it.

    Where it falls below that level, above the band of the force, it is taken for more than it is.
    """
    white = float(density[-1])
    above = np.maximum(density - white, 0.0)
    highest = float(frequency[-1])
    low = np.flatnonzero(above >= above.max() / 2)
    centre = float(frequency[min(low[-1] + 1, frequency.size - 2)])

    def whole(f: Array) -> Array:
        known = np.interp(f, frequency, above, right=0.0) + CLOSE**2 * before
        return np.asarray(known / (1 + (f / highest) ** 8))

    shaping = ShapingFilter.of_spectrum(whole, centre=centre, tolerance=CLOSE * float(np.sqrt(before)))
    return white, ShapedNoise(shaping, interval)
