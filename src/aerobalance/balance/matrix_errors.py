"""What a calibration leaves open in a balance matrix, as errors of the loads of one recording.

The coefficients of the terms have errors that stay as they are from recording to recording, so that everything found
from loads of the same matrix is wrong together. To first order the errors of the loads are linear in those of the
coefficients: at every sample the terms times a sensitivity.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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


class Part(NamedTuple):
    """Change of the loads at some samples: the sum over i and t of gain[:, :, i] terms[:, t] change[i, t].

    Attributes
    ----------
    rows
        Which of the samples asked for.
    gain
        Change of the loads with the polynomial of each column of the matrix, scaled, shape (m, n, c) [N, N*m].
    terms
        Values of the terms, shape (m, t).
    """

    rows: slice
    gain: Array
    terms: Array


@dataclass(frozen=True, slots=True, eq=False)
class MatrixErrors:
    """Where a balance matrix was used for the loads of a recording.

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

    def parts(self, rows: NDArray[np.intp], names: tuple[str, ...]) -> Iterator[Part]:
        """How the loads of these names change with the coefficients at samples of shape (m,), some at a time."""
        matrix = self.matrix
        turn = self.transform[[self.components.index(name) for name in names]] * matrix.load_scale
        for start in range(0, rows.size, ROWS):
            place = slice(start, min(start + ROWS, rows.size))
            loads = self.native[rows[place]]
            if matrix.way == "iterative":
                x = np.ascontiguousarray(loads / matrix.load_scale)
                # of the loads by the outputs, both scaled
                slope = matrix.sensitivity(loads) * matrix.output_scale / matrix.load_scale[:, None]
                gain = -turn @ slope  # an output that the matrix makes too large is taken for less load
            else:
                x = np.ascontiguousarray(matrix.outputs(loads) / matrix.output_scale)
                gain = np.broadcast_to(turn, (len(x), *turn.shape))
            yield Part(place, np.asarray(gain), kernels.design(*codes(matrix.terms), x))


def coefficient_covariance(matrix: BalanceMatrix) -> Array:
    """Covariance of all coefficients, column by column of the matrix, shape (c t, c t), scaled.

    The columns are fitted to the same points, so their errors go together as the residuals of these do
    (`BalanceMatrix.load_covariance`). Where the terms of two columns are drawn to different sizes the covariances of
    both are not proportional to each other; their symmetric roots join what is alike in them.
    """
    roots = np.array([symmetric_root(part) for part in matrix.covariance])
    c, t = roots.shape[:2]
    whole = np.einsum("ij,isk,jtk->isjt", matrix.residual_correlation, roots, roots)
    return np.asarray(whole.reshape(c * t, c * t))
