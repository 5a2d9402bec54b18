"""Linear algebra of covariances, and of long tables with few columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array


def covariance_root(covariance: Array, *, reduced: bool = True) -> Array:
    """Return B with B B^T = covariance, shape (p, rank) [unit of the parameters].

    It is worked out from the correlations, as the units of the parameters lie decades apart.

    Parameters
    ----------
    covariance
        Shape (p, p).
    reduced
        Whether the columns that are zero but for rounding are left out; otherwise the shape is (p, p).
    """
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(deviation > 0, deviation, 1.0)
    level, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    kept = level > 1e-14 * max(float(level.max(initial=0.0)), 0.0)
    columns = kept if reduced else slice(None)
    size = np.sqrt(np.where(kept, level, 0.0))
    return np.ascontiguousarray(unit[:, None] * vectors[:, columns] * size[columns])


def root_by_first(covariance: Array) -> Array:
    """Return B with B B^T = covariance, shape (p, 1 + p), of which the first number alone makes the first parameter.

    So the numbers of two covariances can be told to be the same in their first parameter and in nothing else.
    """
    deviation = float(np.sqrt(max(float(covariance[0, 0]), 0.0)))
    first = covariance[:, 0] / deviation if deviation > 0 else np.zeros(len(covariance))
    rest = covariance - np.outer(first, first)
    rest[0], rest[:, 0] = 0.0, 0.0  # but for rounding they are
    return np.column_stack([first, covariance_root(rest, reduced=False)])


def symmetric_root(covariance: Array) -> Array:
    """Return the symmetric B with B B = covariance, shape (p, p), for parameters of one unit.

    Roots of two covariances can be multiplied only if they do not depend on the choice of eigenvectors; this one is
    unique.
    """
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def sums_of_products(ones: Array, others: Array) -> Array:
    """Return ``ones.T @ others`` for series of shapes (n, ...) and (n, ...).

    ``@`` keeps Python's interpreter from all other threads where its result is small, however long the series are; for
    44 000 samples of 18 series that is most of a millisecond. ``dot`` lets go of it.
    """
    return np.asarray(np.dot(ones.T, others))


def whole_rows(table: Array) -> NDArray[np.bool_]:
    """Return which rows of a table, shape (n, c), have no missing value, shape (n,).

    Of most tables all have, which takes a fifth of the time: NumPy is slow to go along short rows.
    """
    finite = np.isfinite(table)
    return np.asarray(np.ones(len(table), dtype=np.bool_) if finite.all() else finite.all(axis=1))


def table_covariance(table: Array) -> Array:
    """Return the covariance of the columns of a table without gaps, shape (n, c), n > 1; shape (c, c).

    As ``numpy.cov`` but for rounding, by products of matrices: those do not go along short rows.
    """
    change = table - sums_of_products(np.full(len(table), 1 / len(table)), table)
    return sums_of_products(change, change) / (len(table) - 1)


def conditional_weights(inverse: Array, unknown: NDArray[np.bool_], known: NDArray[np.bool_]) -> Array:
    """Weights of known numbers in the expectation of unknown ones, -Q_uu^-1 Q_uk, shape (u, k) [1].

    With the inverse covariance of all of them found once, each choice of few unknown ones takes few equations.

    Parameters
    ----------
    inverse
        Inverse Q of the covariance of all n numbers, Gaussian and of mean zero, shape (n, n).
    unknown, known
        Which are unknown and which known; together they are all, shape (n,).
    """
    return np.asarray(-np.linalg.solve(inverse[np.ix_(unknown, unknown)], inverse[np.ix_(unknown, known)]))
