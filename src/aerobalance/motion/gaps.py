"""Missing readings of the ground's motion, predicted from those about them, and what is not known of them.

A channel is taken for a process with its own autocovariance: within a gap its expected values are the best linear
prediction from the readings on both sides, and the covariance of what that misses is known as well. It is given as
errors of independent sizes, which go where the channel goes: through filters, levers, and the estimator.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.resampling import AROUND, EXACT, gaps_in, interpolate_gaps_linearly

GAP: Final = "gap in "
"""How the name of what is not known within a gap begins, before the channel."""

STRETCH: Final = 512
"""Samples of a gap that are predicted together; what a longer one misses is taken as independent from one stretch to
the next."""

SHARE: Final = 1e-3
"""Variance of an error over the mean of those of a gap, up to which it is left out."""

FEWEST: Final = 8
"""Readings from which on the noise of a channel can be judged."""

FADED: Final = 0.1
"""Share of a record at either end that is faded out before its autocovariance is taken."""

MOST: Final = 64
"""Errors of a channel that are kept apart; where there are more they are mixed to as many, which keeps their size."""


class _Errors(NamedTuple):
    """Errors of independent size 1 within a stretch of a gap, from a sample on, shape (m, k)."""

    first: int
    shapes: Array


def filled(channel: Channel) -> tuple[Array, Array]:
    """Return what `predicted` does, and warn of the gaps."""
    missing = int(channel.missing.sum())
    if missing:
        warn_quality(
            f"{channel.name}: {missing} missing sample(s) are filled by what those about them predict; what that "
            "misses is in the uncertainty"
        )
    return predicted(channel)


def predicted(channel: Channel) -> tuple[Array, Array]:
    """Return the values of a channel with its gaps filled, (n,), and errors of independent size 1 within, (n, k).

    Both are in the unit of the channel; it has one reading at least.
    """
    missing, values = channel.missing, channel.values
    if not missing.any():
        return values, np.zeros((values.size, 0))
    mean = float(values[~missing].mean())
    swing = np.where(missing, 0.0, values - mean)
    covariance = _autocovariance(interpolate_gaps_linearly(values) - mean, variance=float(np.var(values[~missing])))
    own = covariance.copy()  # of the quantity, without the noise of its readings
    noise = channel_noise(channel) if np.count_nonzero(~missing) >= FEWEST else 0.0
    own[0] = max(own[0] - noise**2, 0.0)
    covariance[0] *= 1 + EXACT
    index, errors = np.arange(values.size), list[_Errors]()
    alone: dict[int, Array] = {}  # of stretches of a length that no reading is near
    for begin, end in gaps_in(missing):
        for first in range(begin, end, STRETCH):
            last = min(first + STRETCH, end)
            known = index[max(first - AROUND, 0) : last + AROUND]
            known = known[~missing[known]]
            told = known.size > 0 and covariance[0] > 0
            if not told and last - first in alone:
                errors.append(_Errors(first, alone[last - first]))
                continue
            missed = own[np.abs(index[first:last, None] - index[first:last])]
            if told:
                across = own[np.abs(known[:, None] - index[first:last])]
                weights = np.linalg.solve(covariance[np.abs(known[:, None] - known)], across)
                swing[first:last] = weights.T @ swing[known]
                # the noise of what it is predicted from apart: the rest is a small difference of large numbers
                of_noise = noise**2 * weights.T @ weights
                missed = _positive(missed - across.T @ weights - of_noise) + of_noise
            size, shapes = np.linalg.eigh(missed)
            kept = size > SHARE * max(float(size.sum()), 0.0) / size.size
            shapes = shapes[:, kept] * np.sqrt(size[kept])
            errors.append(_Errors(first, shapes))
            if not told:
                alone[last - first] = shapes
    return mean + swing, _few(errors, samples=values.size)


def _autocovariance(values: Array, *, variance: float) -> Array:
    """Autocovariance of a series without gaps at every lag, positive definite, shape (n,); its variance is known.

    Its ends are faded out: cut off, they would look like motion at all frequencies.
    """
    faded = values.copy()
    fade = round(FADED * values.size)
    window = 0.5 - 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / max(fade, 1))
    faded[:fade] *= window
    faded[values.size - fade :] *= window[::-1]
    found = np.fft.irfft(np.abs(np.fft.rfft(faded, 2 * values.size)) ** 2)[: values.size]
    return np.asarray(found * (variance / found[0] if found[0] > 0 else 0.0))


def _positive(matrix: Array) -> Array:
    """A symmetric matrix without its negative eigenvalues, shape (n, n)."""
    size, shapes = np.linalg.eigh(matrix)
    return np.asarray((shapes * np.maximum(size, 0.0)) @ shapes.T)


def _few(errors: Sequence[_Errors], *, samples: int) -> Array:
    """As many errors as are kept apart, shape (n, k), mixed at random where there are more."""
    counts = [one.shapes.shape[1] for one in errors]
    count = sum(counts)
    few = min(count, MOST)
    mixing = np.eye(count) if count <= MOST else _mixing(count)
    found = np.zeros((samples, few))
    for one, last, own in zip(errors, np.cumsum(counts), counts, strict=True):
        found[one.first : one.first + len(one.shapes)] = one.shapes @ mixing[last - own : last]
    return found


def _mixing(count: int) -> Array:
    """What mixes so many errors to as many as are kept apart, shape (count, k)."""
    basis, _ = np.linalg.qr(np.random.default_rng(count).normal(size=(count, MOST)))
    return np.asarray(np.sqrt(count / MOST) * basis)
