"""The variables of a balance matrix's polynomials from their values: loads from outputs in the iterative way.

Where the terms that are not linear are small beside the linear ones, as in a balance, the plain iteration of [R091]_
finds the variables in a few steps, many samples at a time. Newton's method takes what is far from linear.

References
----------
.. [R091] AIAA R-091, "Calibration and use of internal strain-gage balances with application to wind tunnel testing".
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance import _term_kernels as kernels
from aerobalance.recording.channel import Array

Codes = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]

TOLERANCE: Final = 1e-11
"""Error that the iteration may leave, over the scale of a variable."""

LAST_STEP: Final = 1e-12
"""Last step of Newton's method, over the scale of a variable."""

NEWTON_STEPS: Final = 30
"""Steps of Newton's method after which it is given up: absolute values can make it jump to and fro."""

PLAIN_STEPS: Final = 200
"""Steps of the plain iteration of [R091]_ that then follow."""

CHUNK: Final = 1 << 12
"""Samples that Newton's method takes at a time."""

X, SIZE, SQUARE, ONE = range(4)
"""Factors that terms are made of: a variable, its absolute value, its square, and 1."""

FACTORS: Final = np.array(
    [
        (X, ONE),
        (SIZE, ONE),
        (X, X),
        (X, SIZE),
        (X, X),
        (SIZE, SIZE),
        (X, SIZE),
        (SIZE, X),
        (X, SQUARE),
        (SIZE, SQUARE),
    ]
)
"""The two factors of each kind of term, in the order of `aerobalance.balance.terms.KINDS`."""


def _products(terms: Codes, c: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of z = (1, x, abs(x), x^2) that are the factors of each term of c variables, shape (t,) each."""
    kinds, first, second = terms
    factors = FACTORS[kinds]
    left = 1 + factors[:, 0] * c + first
    right = np.where(factors[:, 1] == ONE, 0, 1 + factors[:, 1] * c + second)
    return left, right


def inverted(
    terms: Codes,
    coefficients: Array,
    linear: Array,
    y: Array,
    *,
    unit: Array | None = None,
    scale: Array | None = None,
) -> tuple[Array, NDArray[np.int64]]:
    """Return the variables x at which polynomials have the values y, shape (n, c), and the steps taken, (n,).

    Parameters
    ----------
    terms
        Kinds and variables of the terms, as `aerobalance.balance.terms.codes` gives them.
    coefficients
        Shape (t, c).
    linear
        Coefficients of the linear terms, results in rows, variables in columns, shape (c, c).
    y
        Shape (n, c); NaN gives NaN and no step, and so do values that no variables have.
    unit, scale
        Sizes of the results and of the variables over those of the polynomials, shape (c,); ones where not given.
    """
    ones = np.ones(linear.shape[0])
    unit, scale = ones if unit is None else unit, ones if scale is None else scale
    inverse = np.linalg.inv(linear).astype(np.float64)
    bent = terms[0] > 0
    x: Array
    steps: NDArray[np.int64]
    if not bent.any():
        x = y @ (inverse.T * scale / unit[:, None])
        return x, np.array(np.isfinite(x).all(axis=1), dtype=np.int64)
    shares = np.ascontiguousarray(inverse @ coefficients[bent].T)
    x, steps = kernels.invert(
        *_products((terms[0][bent], terms[1][bent], terms[2][bent]), len(scale)),
        shares,
        shares.astype(np.float32),
        inverse / unit,
        scale,
        np.ascontiguousarray(y),
        TOLERANCE,
    )
    left = np.flatnonzero(steps == 0)
    left = left[np.isfinite(y[left]).all(axis=1)]
    for start in range(0, left.size, CHUNK):
        part = left[start : start + CHUNK]
        found, steps[part] = _by_newton(terms, np.ascontiguousarray(coefficients), inverse, y[part] / unit)
        x[part] = found * scale
    return x, steps


@np.errstate(over="ignore", invalid="ignore")
def _by_newton(terms: Codes, C: Array, inverse: Array, y: Array) -> tuple[Array, NDArray[np.int64]]:
    """Variables at which polynomials are y (n, c), however bent, and steps: Newton's method, then the plain one."""
    x, steps = np.full(y.shape, np.nan), np.zeros(len(y), dtype=np.int64)
    start = y @ inverse.T
    now, going = start.copy(), np.arange(len(y))
    for step in range(NEWTON_STEPS + PLAIN_STEPS):
        if step == NEWTON_STEPS:
            now = start[going]
        short = y[going] - kernels.design(*terms, now) @ C
        change = short @ inverse.T
        if step < NEWTON_STEPS:
            J = kernels.jacobians(*terms, C, now)
            sound = np.abs(np.linalg.det(J)) > 0
            change[sound] = np.linalg.solve(J[sound], short[sound][:, :, None])[:, :, 0]
        now += change
        size = np.max(np.abs(change), axis=1)
        far = ~(size < kernels.FARTHEST)
        found = ~far & (size <= LAST_STEP * np.maximum(1.0, np.max(np.abs(now), axis=1)))
        x[going[found]], steps[going[found]] = now[found], step + 1
        if step < NEWTON_STEPS:
            now[far] = start[going[far]]
            far[:] = False
        kept = ~(found | far)
        now, going = now[kept], going[kept]
        if not going.size:
            break
    return x, steps
