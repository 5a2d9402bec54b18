"""What one record tells about the matrices of all, as rows of weighted least squares."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.linalg import cho_factor, lapack, qr, solve_triangular

from aerobalance.identification.coupled.free_response import FreeMotion
from aerobalance.identification.coupled.internal_coordinates import coordinates_of
from aerobalance.recording.channel import Array

WELL_CONDITIONED: Final = 1e-4
"""Least part of a column, over its size, that the others leave, above which products of the columns serve for them."""


def compressed(columns: Array, left: Array) -> tuple[Array, Array]:
    """Return the triangular factor R of the columns Q R, and Q' times the residuals."""
    size = np.linalg.norm(columns, axis=0)
    if size.all() and columns.shape[0] > columns.shape[1]:
        scaled = (columns.T @ columns) / np.outer(size, size)
        lower, failed = lapack.dpotrf(scaled, lower=1, clean=1)
        if not failed and np.diag(lower).min() > WELL_CONDITIONED:
            return lower.T * size, solve_triangular(lower, (columns.T @ left) / size[:, None], lower=True)
    basis, factor = qr(columns, mode="economic", check_finite=False)
    return np.asarray(factor), np.asarray(basis.T @ left)


def weighted(whitener: Array, table: Array) -> Array:
    """Weigh a table of shape (rows, n, k) and lay it out as (rows n, k)."""
    return np.asarray(np.einsum("dc,bck->bdk", whitener, table).reshape(-1, table.shape[2]))


def of_matrices(block: Array, own: int) -> Array:
    """What a record tells about the matrices alone: rows of [spring, brake, residual], its own eliminated."""
    return block[own:, own:]


def damped(block: Array, own: int, damping: float) -> Array:
    """The factor with its own parameters held back by a part of their information."""
    if damping == 0:
        return block
    hold = np.zeros((own, block.shape[1]))
    hold[:, :own] = damping * np.diag(np.linalg.norm(block[:, :own], axis=0))
    return np.asarray(qr(np.vstack([block, hold]), mode="r", check_finite=False)[0][: block.shape[1]])


LARGEST_GROWTH: Final = 20.0
"""Logarithm of the growth of a trial motion over a record beyond which it is not tried."""


FIRM: Final = 1e4
"""Weight with which directions that change nothing are held in the information, over that of a single parameter."""


LEAST_INDEPENDENCE: Final = 1e-3
"""Least eigenvalue of the correlation matrix of the noise that is believed."""


def noise_of_residuals(residuals: Array, *, degrees_of_freedom: int, least: Array) -> Array:
    """Covariance of the noise of a row, from what a fit leaves, shape (n, n).

    Parameters
    ----------
    residuals
        Shape (m, n).
    degrees_of_freedom
        Readings used less parameters.
    least
        Standard deviation below which none is taken to be, shape (n,).
    """
    n = residuals.shape[1]
    covariance = residuals.T @ residuals * (n / max(degrees_of_freedom, 1))
    deviation = np.maximum(np.sqrt(np.diag(covariance)), least)
    correlation = covariance / np.outer(deviation, deviation)
    np.fill_diagonal(correlation, 1.0)
    if (deviation <= least).any() or np.linalg.eigvalsh(correlation)[0] < LEAST_INDEPENDENCE:
        correlation = np.eye(n)  # not noise but rounding, or a lack of fit that all components share
    return np.asarray(correlation * np.outer(deviation, deviation))


def motion_of(matrices: Array, n: int) -> FreeMotion:
    """Free motion of A^-1 and A^-1 D given row by row, of n balance loads and internal coordinates behind them."""
    size = coordinates_of(matrices)
    return FreeMotion.of(*matrices.reshape(2, size, size), components=n)


def whitener_of(noise: Array) -> Array:
    """What turns noise of this covariance into independent unit noise."""
    factor = cho_factor(noise, lower=True)[0]
    return solve_triangular(np.tril(factor), np.eye(noise.shape[0]), lower=True)
