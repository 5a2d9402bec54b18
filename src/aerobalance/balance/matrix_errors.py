"""Errors of balance loads [N, N*m] that come from errors of the balance matrix.

The coefficients of the terms have errors that stay as they are from recording to recording, so that everything found
from loads of the same matrix is wrong together. To first order the errors of the loads are linear in those of the
coefficients: at every sample the terms times a sensitivity.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance import _term_kernels as kernels
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.terms import codes
from aerobalance.recording.channel import Array
from aerobalance.recording.linalg import symmetric_root

ROWS: Final = 2048
"""Samples worked on at a time."""

LACK_OF_FIT_LENGTH: Final = 0.5
"""Distance of two loads, over half of range, along which what the terms of a matrix cannot follow stays alike.

Twelve random balances with products and absolute values of loads were calibrated with the terms of second order alone.
With this length the rms of the error of a mass over its uncertainty was 0.9 in a pitch sweep (1.2 where it goes one
way), with 1 it was 1.5, with 2 it was 2.1, and with nothing but the errors of the coefficients 2.6.
"""


class CoefficientSlope(NamedTuple):
    """Slope of the loads [N, N*m] at some samples by the coefficients of the matrix.

    A change of the coefficients changes the loads by the sum over i and t of gain[:, :, i] terms[:, t] change[i, t].

    Attributes
    ----------
    rows
        Which of the samples asked for.
    gain
        Change of the loads with the polynomial of each column of the matrix, normalised, shape (m, n, c) [N, N*m].
    terms
        Values of the terms, shape (m, t).
    """

    rows: slice
    gain: Array
    terms: Array


@dataclass(frozen=True, slots=True, eq=False)
class MatrixErrors:
    """Loads [N, N*m] at which a balance matrix was used, for the sensitivity to its errors.

    Attributes
    ----------
    matrix
        The matrix, with c components and t terms.
    components
        Names of the loads of the result.
    transform
        Matrix from the balance's own components to these, shape (n, c).
    native
        Loads in the balance's own components, tares not removed, shape (samples, c) [N, N*m].
    """

    matrix: BalanceMatrix
    components: tuple[str, ...]
    transform: Array
    native: Array

    def parts(self, rows: NDArray[np.intp], names: tuple[str, ...]) -> Iterator[CoefficientSlope]:
        """Yield the slopes of these loads by the coefficients at samples of shape (m,), some at a time."""
        matrix = self.matrix
        turn = self.transform[[self.components.index(name) for name in names]] * matrix.load_scale
        for start in range(0, rows.size, ROWS):
            place = slice(start, min(start + ROWS, rows.size))
            loads = self.native[rows[place]]
            if matrix.way == "iterative":
                x = np.ascontiguousarray(loads / matrix.load_scale)
                # of the loads by the outputs, both normalised
                slope = matrix.sensitivity(loads) * matrix.output_scale / matrix.load_scale[:, None]
                gain = -turn @ slope  # an output that the matrix makes too large is taken for less load
            else:
                x = np.ascontiguousarray(matrix.outputs(loads) / matrix.output_scale)
                gain = np.broadcast_to(turn, (len(x), *turn.shape))
            yield CoefficientSlope(place, np.asarray(gain), kernels.design(*codes(matrix.terms), x))


def covariance_at_points(errors: MatrixErrors, names: tuple[str, ...], *, zero: Array) -> Array:
    """Covariance of the errors [N, N*m] that a matrix gives loads at n points, shape (n, c, n, c) for c names.

    The errors of the coefficients are the same at all points: they go with the load, and nothing of them is left at
    the load that the zero was read under, as loads count from there. So does what the terms cannot follow, which
    stays alike for `LACK_OF_FIT_LENGTH`. It is the scatter of the calibration's residuals beyond the noise of its
    readings, and is known where that noise is.

    Parameters
    ----------
    errors
        Where the matrix is used.
    names
        Loads that are wanted.
    zero
        Load that the zero was read under, in the balance's own components, shape (c,) [N, N*m].
    """
    matrix = errors.matrix
    own = np.concatenate([errors.native, zero[None, :]])
    parts = list(replace(errors, native=own).parts(np.arange(len(own)), names))
    gain, terms = np.concatenate([part.gain for part in parts])[:-1], np.concatenate([part.terms for part in parts])
    n, r, c = gain.shape
    changes = np.einsum("nri,nt->nrit", gain, terms[:-1] - terms[-1]).reshape(n * r, c * terms.shape[1])
    found = (changes @ coefficient_covariance(matrix) @ changes.T).reshape(n, r, n, r)
    normalised = own / matrix.load_scale
    distance = np.sum((normalised[:, None] - normalised) ** 2, axis=2)
    alike = np.exp(-0.5 * distance / LACK_OF_FIT_LENGTH**2)
    alike = alike[:-1, :-1] - alike[:-1, -1:] - alike[-1:, :-1] + alike[-1, -1]
    noise = matrix.noise_of_readings
    lack_of_fit = np.where(noise > 0, np.sqrt(np.maximum(matrix.residual_deviation**2 - noise**2, 0.0)), 0.0)
    between = matrix.residual_correlation * np.outer(lack_of_fit, lack_of_fit)
    return np.asarray(found + np.einsum("nri,ij,msj,nm->nrms", gain, between, gain, alike, optimize=True))


def coefficient_covariance(matrix: BalanceMatrix) -> Array:
    """Covariance of all coefficients, column by column of the matrix, shape (c t, c t), normalised.

    The columns are fitted to the same points, so their errors go together as the residuals of these do
    (`BalanceMatrix.load_covariance`). Where the terms of two columns are drawn to different sizes the covariances of
    both are not proportional to each other; their symmetric roots join what is alike in them.
    """
    roots = np.array([symmetric_root(part) for part in matrix.covariance])
    c, t = roots.shape[:2]
    whole = np.einsum("ij,isk,jtk->isjt", matrix.residual_correlation, roots, roots)
    return np.asarray(whole.reshape(c * t, c * t))
