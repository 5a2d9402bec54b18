"""Means of records at rest, zeros and wind-off loads, and their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from aerobalance.recording.channel import Array

BATCHES: Final = 20
"""Parts of a record, at most, whose means tell the uncertainty of the mean of the whole."""

DRIFTS: Final = 0.5
"""Half the mean square of the differences of neighbours (von Neumann) over the variance of 20 means, below which what
these differ by is all taken for drift. It is 1 for white noise, with a standard deviation of 0.21, and below this by
chance once in 140 records."""


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

    Where parts that follow each other differ by less than all do, what changes between them is no noise: it goes on up
    to the run, and averaging does not take it off. Of a random walk of w a part, n parts scatter by w^2 (n + 1) / 6
    about their mean, which is w^2 n / 3 away from where the walk ends, twice as much; of a steady drift three times.
    It counts in full where chance hardly explains it, and less the better it does.
    """
    means = batch_means(table)
    if len(means) < BATCHES:
        return np.zeros(table.shape[1])
    scatter = means.var(axis=0, ddof=1)
    apart = np.mean(np.diff(means, axis=0) ** 2, axis=0) / 2
    smoother = np.maximum(1 - apart / np.where(scatter > 0, scatter, 1.0), 0.0) * (scatter > 0)
    share = np.minimum(smoother / (1 - DRIFTS), 1.0) ** 2
    return np.asarray(2 * share * smoother * scatter)


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
