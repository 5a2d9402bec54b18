"""Means of records at rest, zeros and wind-off loads, and their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from aerobalance.recording.channel import Array

BATCHES: Final = 20
"""Parts of a record, at most, whose means tell the uncertainty of the mean of the whole."""

AT_REST: Final = 0.9
"""Probability, before the readings are looked at, that a record at rest does not drift."""

USUAL_DRIFT: Final = 10.0
"""Median of how far a drift is expected to lead from the mean of a record to its end, over the standard deviation of
that mean by noise. The distribution is half-Cauchy, which says little more than that."""

DRIFTS: Final = np.geomspace(0.1, 1000, 25)
"""Sizes of drift that are weighed, as the same ratio: a smaller one is nothing beside the noise, and the noise nothing
beside a larger one."""


def batch_means(table: Array) -> Array:
    """Means of up to 20 equal parts of columns, shape (parts, c)."""
    batches = max(min(BATCHES, table.shape[0] // 2), 1)
    length = table.shape[0] // batches
    return np.asarray(table[: batches * length].reshape(batches, length, -1).mean(axis=1))


def variance_of_mean(table: Array) -> Array:
    """Variance of column means by batch means, which holds for ringing and hum too, shape (c,)."""
    means = batch_means(table)
    if len(means) < 2:
        return np.asarray(table.var(axis=0, ddof=1) / table.shape[0])
    return np.asarray(means.var(axis=0, ddof=1) / len(means))


def variance_of_drift(table: Array) -> Array:
    """Variance of column means against the instant after a record, by what the columns drift, shape (c,).

    Parts of a record differ by noise, and by a drift if there is one: a random walk or a steady drift. It goes on up
    to the run, and averaging does not take it off. Twenty parts rarely tell which of them it is and how large, and
    hardly ever one that leads less far than three times the noise of the mean. So each kind and size is weighed by its
    probability, given the parts (Bayesian model averaging), and what is returned is the mean of the variance over all.
    A drift that chance hardly explains counts in full, and less the better chance explains it.
    """
    means = batch_means(table)
    if len(means) < BATCHES:
        return np.zeros(table.shape[1])
    by = _drifts()
    seen = by.contrasts @ means
    total = np.sum(seen**2, axis=0)
    still = total == 0
    size, freedom = DRIFTS[:, None] ** 2, len(seen)
    walk = 1 + size * by.walk
    steady, along = 1 + size * (by.steady @ by.steady), by.steady @ seen
    # by hypothesis (none, walks, steady drifts): the sum of squares of the contrasts, each over its variance but for
    # that of the noise, which is integrated out
    across = np.maximum(total - along**2 / (by.steady @ by.steady), 0.0)
    squares = np.concatenate([total[None], (1 / walk) @ seen**2, across + along**2 / (by.steady @ by.steady) / steady])
    squares[:, still] = 1.0
    spread = np.concatenate([[0.0], np.log(walk).sum(axis=1), np.log(steady[:, 0])])
    likely = by.log_prior[:, None] - (spread[:, None] + freedom * np.log(squares)) / 2
    weight = np.exp(likely - likely.max(axis=0))
    weight /= weight.sum(axis=0)
    of_walk, of_steady = np.split(squares[1:] / (freedom - 2), 2)  # the variance of the noise of a part
    variance = np.concatenate([size * of_walk, (size * along / steady) ** 2 + size / steady * of_steady])
    return np.where(still, 0.0, np.sum(weight[1:] * variance, axis=0) / len(means))


class _Drifts(NamedTuple):
    """What drifts make of a record's parts.

    Attributes
    ----------
    contrasts
        Rows that make independent contrasts of the parts' means, of a random walk too: a cosine transform, shape
        (parts - 1, parts).
    walk
        Variance of these by a random walk, over that of the mean against its end and times the number of parts.
    steady
        What they are of a steady drift, over its way from the mean to the end and the root of the number of parts.
    log_prior
        Logarithm of the probability beforehand: of none, of walks and of steady drifts of the sizes `DRIFTS`.
    """

    contrasts: Array
    walk: Array
    steady: Array
    log_prior: Array


@cache
def _drifts() -> _Drifts:
    order, middle = np.arange(1, BATCHES), (np.arange(BATCHES) + 0.5) / BATCHES
    contrasts = np.sqrt(2 / BATCHES) * np.cos(np.pi * np.outer(order, middle))
    # of a walk of 1 a part, whose mean over n parts is sqrt(n / 3) away from where it ends; the mean over a part takes
    # off the sixth
    walk = 1 / (2 * np.sin(np.pi * order / (2 * BATCHES))) ** 2 - 1 / 6
    prior = 1 / (DRIFTS / USUAL_DRIFT + USUAL_DRIFT / DRIFTS)  # half-Cauchy, on a scale of the logarithm
    of_each = (1 - AT_REST) / 2 * prior / prior.sum()
    return _Drifts(
        contrasts,
        walk * 3 / BATCHES**2,
        contrasts @ middle * 2 / np.sqrt(BATCHES),
        np.log(np.concatenate([[AT_REST], of_each, of_each])),
    )


def correlation_of_means(tables: Sequence[Array]) -> Array:
    """Correlation of the column means of records of the same load by their batch means, shape (c, c).

    It is that of all batch means about the mean of all: of what is random within records, and what they differ by.
    """
    batches = [batch_means(table) for table in tables]
    if sum(map(len, batches)) < 2 * len(batches):  # records of a few samples
        batches = list(tables)
    middle = np.mean([table.mean(axis=0) for table in batches], axis=0)
    apart = np.concatenate(batches) - middle
    size = np.sqrt(np.sum(apart**2, axis=0))
    size = np.where(size > 0, size, 1.0)
    found = (apart / size).T @ (apart / size)
    np.fill_diagonal(found, 1.0)
    return np.asarray(found)


class MeanOfRecords(NamedTuple):
    """Mean over records of the same load, each with the same weight.

    Attributes
    ----------
    values, variance
        Of the mean, shape (c,).
    between
        Variance of the mean by what the records differ by alone, shape (c,); 0 for one.
    """

    values: Array
    variance: Array
    between: Array


def mean_of_records(means: Sequence[Array] | Array, variances: Sequence[Array] | Array) -> MeanOfRecords:
    """Mean of the means of records, and its variance: that within them, or that between them where it is larger.

    So the variance is that of a random-effects model: what records differ by beyond their own uncertainty is an error
    of each of them.

    Parameters
    ----------
    means, variances
        Of each record, shape (c,).
    """
    count = len(means)
    within = np.sum(variances, axis=0) / count**2
    between = np.var(means, axis=0, ddof=1) / count if count > 1 else np.zeros_like(within)
    return MeanOfRecords(np.mean(means, axis=0), np.maximum(within, between), between)
