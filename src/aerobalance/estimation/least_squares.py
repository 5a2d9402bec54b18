"""Sizes of known shapes in readings by least squares, plain or generalised, and the likelihood of what they leave."""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance.estimation.observation import Observation
from aerobalance.estimation.statespace.kalman import AT_ONCE, KalmanFilter
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.recording.linalg import sums_of_products

DEPENDENT: Final = 1e-7
"""Singular value of scaled shapes over the largest below which they depend on each other."""


def generalised_least_squares(filter_: KalmanFilter, readings: Array, columns: Array) -> tuple[Array, Array, float]:
    """Sizes of known shapes in a record: values (p,), covariance (p, p) and the sum of squares left over [1].

    Raises
    ------
    FitError
        The readings cannot be whitened.
    """
    series = whitened(filter_, readings, columns)
    return least_squares(series[:, 0], series[:, 1:])


def whitened(filter_: KalmanFilter, readings: Array, columns: Array) -> Array:
    """Readings (n,) and known shapes (n, p) as columns that a filter has made white, shape (n, 1 + p) [1].

    Raises
    ------
    FitError
        The readings cannot be whitened.
    """
    series = filter_.whiten(np.column_stack([readings, columns]))
    if not np.isfinite(series).all():
        raise FitError("the readings cannot be told from their model: they do not change, or their scale is absurd")
    return series


def take_out(basis: Array, series: Array) -> None:
    """Take orthonormal shapes (n, q) out of several series (n, c), in place and some at a time."""
    some = max(AT_ONCE // max(series.shape[0], 1), 1)
    for first in range(0, series.shape[1], some):
        part = series[:, first : first + some]
        part -= basis @ sums_of_products(basis, part)


def least_squares(values: Array, shapes: Array) -> tuple[Array, Array, float]:
    """Sizes (p,) of shapes (n, p) in values (n,), their covariance where values have variance 1, and the squares left.

    Normal equations, solved again for what they leave: that is as exact as a decomposition of the shapes themselves,
    and takes a tenth of its time. Of shapes that depend on each other only what they tell together has a size.
    """
    spread = root_of_covariance(sums_of_products(shapes, shapes))
    sizes, left = np.zeros(shapes.shape[1]), values
    for _ in range(2):
        sizes = sizes + spread @ (spread.T @ sums_of_products(shapes, left))
        left = values - shapes @ sizes
    return sizes, spread @ spread.T, float(left @ left)


def root_of_covariance(products: Array) -> Array:
    """Root (p, q) of the covariance of the sizes of shapes whose products are given, (p, p), in noise of variance 1.

    Of shapes that depend on each other only what they tell together has one.
    """
    scale = np.sqrt(np.diag(products))
    scale[scale == 0] = 1.0  # a shape that no reading shows: its size stays zero
    information, vectors = np.linalg.eigh(products / np.outer(scale, scale))
    kept = information > DEPENDENT**2 * information[-1]
    return np.asarray(vectors[:, kept] / np.sqrt(information[kept]) / scale[:, None])


def log_likelihood(reading: Observation, filter_: KalmanFilter, *, columns: Array) -> float:
    """Logarithm of the likelihood of a filter's innovations, the sizes of the columns at their best."""
    *_, squares = generalised_least_squares(filter_, reading.filled, columns)
    return -0.5 * (filter_.log_determinant + squares)
