"""Standard uncertainty that a balance matrix gives to the loads of a whole record, sample by sample.

`BalanceMatrix.load_covariance` has the same for any few loads. Of the 96 terms of AIAA R-091 three of four differ from
others by signs of the variables alone: |a| b is a b, or less it. Where no variable changes its sign all of them are
33 monomials, so the quadratic forms of the terms are nine times smaller, and samples are worked on by their signs.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np

from aerobalance.balance._variance_kernels import FOUR, Quadratic, variances
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.terms import Term
from aerobalance.recording.channel import Array

STEADY: Final = 0.1
"""Pivot of the derivatives of a matrix, over those of its linear terms, below which rows have to change places."""

DEGREES: Final = (1, 1, 2, 2, 2, 2, 2, 2, 3, 3)
"""Degree of each kind of terms."""

SIGNED: Final = ((0, 0), (1, 0), (0, 0), (1, 0), (0, 0), (1, 1), (0, 1), (1, 0), (0, 0), (1, 0))
"""Whether the sign of its first and of its second variable is in a term of each kind beside its monomial."""

Monomial = tuple[int, ...]
"""Places of the variables that are multiplied, in rising order."""


def load_variances(matrix: BalanceMatrix, loads: Array, *, transform: Array) -> Array:
    """Variances of transformed loads from the calibration alone, shape (n, k) [N^2, (N*m)^2].

    Parameters
    ----------
    matrix
        The matrix that the loads were computed with.
    loads
        Shape (n, c) [N, N*m].
    transform
        What is made of the c loads, shape (k, c).
    """
    iterative = matrix.way == "iterative"
    variables = loads / matrix.load_scale if iterative else matrix.outputs(loads) / matrix.output_scale
    x = np.ascontiguousarray(variables)
    signs = (np.sign(x).astype(np.int64) + 1) @ (3 ** np.arange(x.shape[1]))
    order = np.argsort(signs, kind="stable")
    edges = np.flatnonzero(np.diff(signs[order], prepend=-1, append=-1))
    out = np.empty((loads.shape[0], transform.shape[0]))
    normalised = np.ascontiguousarray(transform * matrix.load_scale)
    for first, last in pairwise(edges.tolist()):
        variances(x, order[first:last], _of_signs(matrix, int(signs[order[first]])), normalised, STEADY, out)
    return out


@lru_cache(maxsize=128)  # all the signs of six variables, for the matrix of a record and of its noise
def _of_signs(matrix: BalanceMatrix, signs: int) -> Quadratic:
    """A matrix where its c variables have these signs: to base 3, 0 below zero, 1 at zero and 2 above."""
    c = len(matrix.components)
    sign = (signs // 3 ** np.arange(c) % 3 - 1).astype(np.float64)
    powers = [_monomial(term) for term in matrix.terms]
    monomials = tuple(sorted(set(powers), key=lambda one: (len(one), one)))
    place = np.array([monomials.index(one) for one in powers])
    turn = np.array([sign[t.first] ** SIGNED[t.kind][0] * sign[t.second] ** SIGNED[t.kind][1] for t in matrix.terms])
    fold = np.zeros((len(powers), len(monomials)))
    fold[np.arange(place.size), place] = turn
    whole = fold.T @ matrix.covariance @ fold
    forms = np.zeros((c, len(monomials), -(-len(monomials) // FOUR) * FOUR))
    forms[:, :, : len(monomials)] = np.tril(whole + whole.transpose(0, 2, 1), -1)
    forms[:, range(len(monomials)), range(len(monomials))] = np.diagonal(whole, axis1=1, axis2=2)
    bend: Array = np.zeros((c, c, 1 + 2 * c))
    back: Array = np.eye(c)
    if matrix.way == "iterative":
        for monomial, row in zip(monomials, fold.T @ matrix.coefficients, strict=True):
            for variable in set(monomial):
                rest = list(monomial)
                rest.remove(variable)
                column = 0 if not rest else 1 + rest[0] if len(rest) == 1 else 1 + c + rest[0]
                bend[:, variable, column] += monomial.count(variable) * row
        back = np.ascontiguousarray(np.linalg.inv(matrix.linear))
        bend = np.einsum("ij,jkl->ikl", back, bend)
        bend[:, :, 0] -= np.eye(c)
    return Quadratic(
        np.array([(*one, *[c] * (3 - len(one))) for one in monomials], dtype=np.int64),
        forms,
        np.maximum(matrix.residual_deviation**2 - matrix.noise_of_readings**2, 0.0) * np.ones(c),
        np.ascontiguousarray(bend),
        back,
        np.ascontiguousarray(matrix.residual_correlation, dtype=np.float64),
    )


def _monomial(term: Term) -> Monomial:
    """The variables of a term as often as they are multiplied."""
    degree = DEGREES[term.kind]
    return (term.first,) * degree if term.first == term.second else tuple(sorted((term.first, term.second)))
