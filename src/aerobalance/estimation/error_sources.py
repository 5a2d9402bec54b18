"""Contributions to the uncertainty of a force, each with what it needs to be carried to a mean, an rms or a peak.

An error that holds along the whole record is a few unknown numbers times known slopes; an error that is drawn anew all
the time is a noise of some spectrum. The first does not average out, the second does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.fft import next_fast_len, rfft

from aerobalance.recording.channel import Array
from aerobalance.recording.linalg import covariance_root, sums_of_products

UNSEEN: Final = 1e-3
"""Rms of what a quantity does to the force, over that of all quantities of a contribution, below which it is left out
where a record is summed up: of seventy elements of matrices, ten or twenty combinations show."""


@dataclass(frozen=True, slots=True, eq=False)
class Systematic:
    """An error that is fully correlated along the record: slopes times a few quantities that are not well known.

    Attributes
    ----------
    name
        What it is.
    source
        Channel or file that it comes from.
    quantities
        Names of the p quantities.
    slopes
        Derivative of the force with respect to each, shape (n, p) [N per unit of the quantity].
    covariance
        Covariance of the quantities, shape (p, p).
    root
        Which independent numbers of variance 1, common to all parts of a record, the quantities are made of, shape
        (p, r), root root^T being the covariance; the root of the covariance where left out, as it is the same for all.
    local
        Whether the quantities belong to this part of a record alone, as the size of a step does.
    """

    name: str
    source: str
    quantities: tuple[str, ...]
    slopes: Array
    covariance: Array
    root: Array = field(default_factory=lambda: np.zeros((0, 0)))
    local: bool = False
    _deviation: list[Array] = field(init=False, default_factory=list, repr=False)

    @property
    def deviation(self) -> Array:
        """Standard uncertainty of every sample, shape (n,) [N]."""
        if not self._deviation:  # it is asked for by all that looks at the errors of a force
            own = self.slopes.T
            turned = own if np.array_equal(self.covariance, np.eye(len(own))) else self.covariance @ own
            self._deviation.append(np.sqrt(np.maximum(np.einsum("pn,pn->n", turned, own), 0.0)))
        return self._deviation[0]

    @property
    def halved(self) -> float:
        """What is left of the contribution when its cause is halved, relative [1]."""
        return 0.5

    @property
    def numbers(self) -> Array:
        """What the quantities are of independent numbers of variance 1, shape (p, r)."""
        return self.root if self.root.size else covariance_root(self.covariance, reduced=False)

    @property
    def few(self) -> Systematic:
        """The same by as few independent quantities of variance 1 as show in the force, in single precision."""
        root = self.numbers
        if not root.size or not self.slopes.size:
            none = np.zeros((self.slopes.shape[0], 0))
            return replace(self, quantities=(), slopes=none, covariance=np.zeros((0, 0)), root=root[:0])
        power, turned = np.linalg.eigh(root.T @ sums_of_products(self.slopes, self.slopes) @ root)
        kept = turned[:, power > UNSEEN**2 * power.sum()]
        names = tuple(f"combination {number}" for number in range(1, kept.shape[1] + 1))
        covariance = np.eye(kept.shape[1])
        # seven digits of an uncertainty: of all that is kept of a part of a long record this is the most
        slopes = (self.slopes @ (root @ kept)).astype(np.float32)
        return replace(self, quantities=names, slopes=slopes, covariance=covariance, root=kept.T.copy())

    def within(self, samples: slice) -> Systematic:
        """The same for some of the samples."""
        some = replace(self, slopes=self.slopes[samples])
        some._deviation.extend(known[samples] for known in self._deviation)
        return some

    def covariance_of(self, weights: Array) -> Array:
        """Covariance of weighted sums of the samples, shape (k, k) [N^2]; weights of shape (k, n) [1]."""
        gradient = sums_of_products(weights.T, self.slopes)
        return np.asarray(gradient @ self.covariance @ gradient.T)

    def variance_of(self, weights: Array) -> float:
        """Variance of a weighted sum of the samples [N^2]; weights of shape (n,) [1]."""
        gradient = sums_of_products(weights.T, self.slopes)
        return max(float(gradient @ self.covariance @ gradient), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """An error that is noise: a standard deviation for every sample and the shape of its spectrum.

    Attributes
    ----------
    name
        What it is.
    source
        Channel that it comes from.
    deviation
        Standard uncertainty of every sample, shape (n,) [N].
    spectrum
        Power spectral density at frequencies from 0 to half the sampling rate, evenly spaced, its mean 1, shape (m,);
        one value stands for white noise.
    halved
        What is left of the contribution when its cause is halved, relative [1].
    """

    name: str
    source: str
    deviation: Array
    spectrum: Array
    halved: float = 0.5

    def within(self, samples: slice) -> Noise:
        """The same for some of the samples."""
        return replace(self, deviation=self.deviation[samples])

    def covariance_of(self, weights: Array) -> Array:
        """Covariance of weighted sums of the samples, shape (k, k) [N^2]; weights of shape (k, n) [1]."""
        if self.spectrum.size == 1:  # white
            own = weights * self.deviation
            return np.asarray(self.spectrum[0] * sums_of_products(own.T, own.T))
        # twice the record, so that its end does not touch its beginning
        count = 2 * next_fast_len(weights.shape[1], real=True)
        lines = np.asarray(rfft(weights * self.deviation, count), dtype=np.complex128)
        power = self.relative_density(count // 2 + 1) / count
        power[1:-1] *= 2
        return np.asarray(np.real((lines * power) @ lines.conj().T))

    def variance_of(self, weights: Array) -> float:
        """Variance of a weighted sum of the samples [N^2]; weights of shape (n,) [1]."""
        return float(self.covariance_of(weights[None])[0, 0])

    def relative_density(self, count: int) -> Array:
        """Spectrum at so many frequencies from 0 to half the sampling rate, shape (count,) [1].

        At fewer frequencies than it is known at, its mean about each: a line may lie between two of them.
        """
        places, own = np.linspace(0, 1, count), np.linspace(0, 1, self.spectrum.size)
        if not 1 < count < self.spectrum.size:
            return np.interp(places, own, self.spectrum)
        summed = np.append(0.0, np.cumsum((self.spectrum[1:] + self.spectrum[:-1]) / 2 * np.diff(own)))
        edges = np.clip((np.arange(count + 1) - 0.5) / (count - 1), 0.0, 1.0)
        return np.asarray(np.diff(np.interp(edges, own, summed)) / np.diff(edges))

    def draw(self, generator: np.random.Generator) -> Array:
        """One error of this kind, shape (n,) [N]."""
        size = self.deviation.size
        white = np.fft.rfft(generator.normal(size=2 * size))
        return self.deviation * np.fft.irfft(white * np.sqrt(self.relative_density(white.size)), 2 * size)[:size]


@dataclass(frozen=True, slots=True, eq=False)
class Divided:
    """A contribution to a force that was worked out in parts.

    Attributes
    ----------
    name, source
        What it is, and the channel or file that it comes from.
    samples
        Samples of the record.
    pieces
        The first sample of each part that has the contribution, and what it is there.
    every
        Samples of the record for each of the pieces, which may be on a slower clock.
    """

    name: str
    source: str
    samples: int
    pieces: tuple[tuple[int, Systematic | Noise], ...]
    every: int = 1

    @property
    def deviation(self) -> Array:
        """Standard uncertainty of every sample, shape (n,) [N]."""
        whole = np.zeros(-(-self.samples // self.every))
        for first, piece in self.pieces:
            own = piece.deviation
            whole[first : first + own.size] = own
        if self.every == 1:
            return whole
        return np.asarray(np.interp(np.arange(self.samples) / self.every, np.arange(whole.size), whole))

    def on_its_clock(self, weights: Array) -> Array:
        """Weights of the samples of the record (k, n) as weights of those of the pieces' clock, (k, m) [1].

        Between the samples of a slower clock the slopes are straight lines, and after its last one they are held.
        """
        every = self.every
        if every == 1:
            return weights
        count = -(-weights.shape[1] // every)
        whole = np.zeros((weights.shape[0], count, every))
        whole.reshape(weights.shape[0], -1)[:, : weights.shape[1]] = weights
        later = whole @ (np.arange(every) / every)
        own: Array = whole.sum(axis=2)
        own[:, :-1] -= later[:, :-1]
        own[:, 1:] += later[:, :-1]
        return own

    def covariance_of(self, weights: Array) -> Array:
        """Covariance of weighted sums of the samples, shape (k, k) [N^2]; weights of shape (k, n) [1]."""
        weights = self.on_its_clock(weights)
        whole = np.zeros((weights.shape[0], weights.shape[0]))
        common = np.zeros((weights.shape[0], 0))
        for first, piece in self.pieces:
            part = weights[:, first : first + piece.deviation.size]
            if isinstance(piece, Noise) or piece.local:
                whole += piece.covariance_of(part)
            else:  # the same numbers are wrong in all parts
                common = added(common, sums_of_products(part.T, piece.slopes) @ piece.numbers)
        return np.asarray(whole + common @ common.T)


def added(one: Array, other: Array) -> Array:
    """Sum of two matrices of k rows, of which one may lack columns at its end."""
    if one.shape[1] < other.shape[1]:
        one, other = other, one
    whole = one.copy()
    whole[:, : other.shape[1]] += other
    return whole


Contribution = Systematic | Noise | Divided


def undivided(contributions: Sequence[Contribution]) -> list[Systematic | Noise]:
    """The contributions to a force that was worked out in one piece.

    Raises
    ------
    ValueError
        It was worked out in parts, and has a summary.
    """
    if any(isinstance(part, Divided) for part in contributions):
        raise ValueError("the contributions of a force worked out in parts cannot be summed up again")
    return [part for part in contributions if not isinstance(part, Divided)]
