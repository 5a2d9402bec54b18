"""Standard uncertainty that a balance matrix gives to the loads of a whole record, sample by sample.

`BalanceMatrix.load_covariance` has the same for any few loads. Of the 96 terms of AIAA R-091 three of four differ from
others by signs of the variables alone: |a| b is a b, or less it. Where no variable changes its sign all of them are
33 monomials, so the quadratic forms of the terms are nine times smaller, and samples are worked on by their signs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np

from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.terms import Term
from aerobalance.recording.channel import Array

BLOCK: Final = 1536
"""Samples that are worked on together: what is known of them stays in the fast memory, and of most signs a part of a
record has fewer."""

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
    x = np.ascontiguousarray(variables.T)
    signs = (3 ** np.arange(x.shape[0])) @ (np.sign(x).astype(np.int64) + 1)
    order = np.argsort(signs, kind="stable")
    edges = np.flatnonzero(np.diff(signs[order], prepend=-1, append=-1))
    out = np.empty((loads.shape[0], transform.shape[0]))
    for first, last in pairwise(edges.tolist()):
        forms = _Forms.of(matrix, int(signs[order[first]]))
        for begin in range(first, last, BLOCK):
            rows = order[begin : min(begin + BLOCK, last)]
            out[rows] = forms.variances(x[:, rows], transform * matrix.load_scale).T
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Forms:
    """What a matrix is where the signs of its c variables are given, in m monomials of them.

    Attributes
    ----------
    matrix
        The matrix.
    monomials
        The m monomials, by degree.
    forms
        Quadratic forms of the variances of its results, shape (c m, m).
    bend
        What makes the derivatives of the results over those of the linear terms, less 1, of 1, the variables and
        their squares, shape (c c, 1 + 2 c).
    back
        Inverse of the derivatives of the linear terms, shape (c, c); 1 where the results are the loads.
    """

    matrix: BalanceMatrix
    monomials: tuple[Monomial, ...]
    forms: Array
    bend: Array
    back: Array

    @staticmethod
    @lru_cache(maxsize=128)  # all the signs of six variables, for the matrix of a record and of its noise
    def of(matrix: BalanceMatrix, signs: int) -> _Forms:
        """Take a matrix where variables have these signs: to base 3, 0 below zero, 1 at zero and 2 above."""
        c = len(matrix.components)
        sign = (signs // 3 ** np.arange(c) % 3 - 1).astype(np.float64)
        powers = [_monomial(term) for term in matrix.terms]
        monomials = tuple(sorted(set(powers), key=lambda one: (len(one), one)))
        place = np.array([monomials.index(one) for one in powers])
        turn = np.array(
            [sign[t.first] ** SIGNED[t.kind][0] * sign[t.second] ** SIGNED[t.kind][1] for t in matrix.terms]
        )
        fold = np.zeros((len(powers), len(monomials)))
        fold[np.arange(place.size), place] = turn
        forms = fold.T @ matrix.covariance @ fold
        bend: Array = np.zeros((c, c, 1 + 2 * c))
        back: Array = np.eye(c)
        if matrix.way == "iterative":
            for monomial, row in zip(monomials, fold.T @ matrix.coefficients, strict=True):
                for variable in set(monomial):
                    rest = list(monomial)
                    rest.remove(variable)
                    column = 0 if not rest else 1 + rest[0] if len(rest) == 1 else 1 + c + rest[0]
                    bend[:, variable, column] += monomial.count(variable) * row
            back = np.asarray(np.linalg.inv(matrix.linear))
            bend = np.einsum("ij,jkl->ikl", back, bend)
            bend[:, :, 0] -= np.eye(c)
        return _Forms(matrix, monomials, forms.reshape(-1, len(monomials)), bend.reshape(c * c, -1), back)

    def variances(self, x: Array, transform: Array) -> Array:
        """Variances of transformed, normalised loads at variables of these signs, (k, n) from (c, n)."""
        matrix, c = self.matrix, x.shape[0]
        scatter = np.maximum(matrix.residual_deviation**2 - matrix.noise_of_readings**2, 0.0)
        values = self._monomials(x)
        quadratic = (self.forms @ values).reshape(c, *values.shape)
        quadratic *= values
        deviation = np.sqrt(np.maximum(quadratic.sum(axis=1) + scatter[:, None], 0.0))
        onward = self._onward(x, transform)
        turned = np.tensordot(self.back.T, onward, axes=1) * deviation[:, None]
        return np.asarray(np.sum(turned * np.tensordot(matrix.residual_correlation, turned, axes=1), axis=0))

    def _monomials(self, x: Array) -> Array:
        """Values of the monomials, shape (m, n)."""
        values = np.empty((len(self.monomials), x.shape[1]))
        for place, monomial in enumerate(self.monomials):
            values[place] = x[monomial[0]]
            for variable in monomial[1:]:
                values[place] *= x[variable]
        return values

    def _onward(self, x: Array, transform: Array) -> Array:
        """What makes the transformed loads out of the results over the linear terms' derivatives, shape (c, k, n).

        By elimination without exchange of rows, as these derivatives are near 1 where a plain iteration converges;
        samples of which that is not so are solved one by one.
        """
        c, k = x.shape[0], transform.shape[0]
        whole = np.empty((c, c + k, x.shape[1]))
        whole[:, c:] = transform.T[:, :, None]
        if not self.bend.any():
            return whole[:, c:]
        of_one = np.concatenate([np.ones((1, x.shape[1])), x, x**2])
        slopes = (self.bend @ of_one).reshape(c, c, -1)
        slopes[np.arange(c), np.arange(c)] += 1.0
        whole[:, :c] = slopes.transpose(1, 0, 2)
        least = np.full(x.shape[1], np.inf)
        for place in range(c):
            pivot = whole[place, place].copy()
            np.minimum(least, np.abs(pivot), out=least)
            with np.errstate(divide="ignore", invalid="ignore"):
                whole[place, place + 1 :] /= pivot
                for other in range(c):
                    if other != place:
                        whole[other, place + 1 :] -= whole[other, place] * whole[place, place + 1 :]
        hard = np.flatnonzero(~(least > STEADY))
        if hard.size:
            solved = np.linalg.solve(slopes[:, :, hard].transpose(2, 1, 0), transform.T)
            whole[:, c:, hard] = solved.transpose(1, 2, 0)
        return whole[:, c:]


def _monomial(term: Term) -> Monomial:
    """The variables of a term as often as they are multiplied."""
    degree = DEGREES[term.kind]
    return (term.first,) * degree if term.first == term.second else tuple(sorted((term.first, term.second)))
