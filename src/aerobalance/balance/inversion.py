"""The variables of a balance matrix's polynomials from their values: loads from outputs in the iterative way.

Where the terms that are not linear are small beside the linear ones, as in a balance, the plain iteration of [R091]_
finds the variables in a few steps, many samples at a time. Newton's method takes what is far from linear.

References
----------
.. [R091] AIAA R-091, "Calibration and use of internal strain-gage balances with application to wind tunnel testing".
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance import _term_kernels as kernels
from aerobalance.recording.channel import Array

Codes = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]

TOLERANCE: Final = 3e-11
"""Error that the iteration is to leave, over the scale of a variable, as judged by its last steps: below 1e-10, as of
samples far from linear, whose errors shrink by turns, one in a million is off by twice what these say."""

LAST_STEP: Final = 1e-12
"""Last step of Newton's method, over the scale of a variable."""

NEWTON_STEPS: Final = 30
"""Steps of Newton's method after which it is given up: absolute values can make it jump to and fro."""

PLAIN_STEPS: Final = 200
"""Steps of the plain iteration of [R091]_ that then follow."""

PART: Final = 1 << 15
"""Samples after which those are found that need more steps, as long as all is still in a processor's memory."""

PAGE: Final = 4096
"""Bytes of a page of memory."""

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


def _polynomials(terms: Codes, coefficients: Array, inverse: Array, unit: Array, scale: Array) -> kernels.Polynomials:
    """Terms that are not linear and their coefficients (t, c) as the kernels take them."""
    c, d = len(scale), _filled(len(scale), kernels.SIX)
    kinds, first, second = terms
    factors = FACTORS[kinds]
    left = 1 + factors[:, 0] * d + first
    right = np.where(factors[:, 1] == ONE, 0, 1 + factors[:, 1] * d + second)
    none = np.zeros(_filled(left.size, kernels.THREE) - left.size, dtype=np.int64)
    shares = _packed(inverse @ coefficients.T)
    return kernels.Polynomials(
        np.concatenate([left, none]),
        np.concatenate([right, none]),
        shares,
        shares.astype(np.float32),
        _packed(-inverse / unit),
        np.concatenate([scale, np.zeros(d - c)]),
    )


def _packed(shares: Array) -> Array:
    """Shares of terms, (c, t), six results and three terms together, filled with zeros: (s, g, 18)."""
    (c, t), six, three = shares.shape, kernels.SIX, kernels.THREE
    filled = np.zeros((_filled(c, six), _filled(t, three)))
    filled[:c, :t] = shares
    s, g = filled.shape[0] // six, filled.shape[1] // three
    return np.ascontiguousarray(filled.reshape(s, six, g, three).transpose(0, 2, 1, 3)).reshape(s, g, six * three)


def _filled(count: int, by: int) -> int:
    """Return the least multiple that is not less than a count."""
    return -(-count // by) * by


def _memory(rows: int, d: int) -> kernels.Work:
    """Memory for a block with that many factors of terms, and d variables."""
    m = kernels.BLOCK
    z, start, rest = _pages(rows * m), _pages(d * m), _pages(d * m)
    z1, z2, factors = _pages(rows * m, single=True), _pages(rows * m, single=True), _pages(2 * rows * m, single=True)
    z[:m] = z1[:m] = z2[:m] = factors[:m] = 1.0
    places, ones, x = np.arange(1, 1 + d), np.zeros(d, dtype=np.int64), slice(m, (1 + d) * m)
    return kernels.Work(
        places,
        ones,
        z.reshape(rows, m),
        z1.reshape(rows, m),
        z2.reshape(rows, m),
        factors.reshape(rows, 2 * m),
        z[x],
        z1[x],
        z2[x],
        start,
        rest,
        _pages(d * m, single=True),
        _pages(d * m, single=True),
        _pages(4 * m, single=True).reshape(4, m),
    )


def _pages(size: int, *, single: bool = False) -> NDArray[Any]:
    """Zeros that begin at a page: what is read and written at once then keeps its distance within pages."""
    kind = np.dtype(np.float32 if single else np.float64)
    memory = np.zeros(size * kind.itemsize + PAGE, dtype=np.uint8)
    begin = -memory.ctypes.data % PAGE
    return memory[begin : begin + size * kind.itemsize].view(kind)


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
    given = _polynomials((terms[0][bent], terms[1][bent], terms[2][bent]), coefficients[bent], inverse, unit, scale)
    n, c, d, six = len(y), linear.shape[0], given.scale.size, kernels.SIX
    filled = np.pad(y, ((0, 0), (0, d - c))) if c < d else y
    found, steps = _by_blocks(given, np.ascontiguousarray(filled.reshape(n, d // six, six).transpose(1, 0, 2)))
    x = found.transpose(1, 0, 2).reshape(n, d)[:, :c]
    left = np.flatnonzero(steps == 0)
    left = left[np.isfinite(y[left]).all(axis=1)]
    for start in range(0, left.size, CHUNK):
        part = left[start : start + CHUNK]
        found, steps[part] = _by_newton(terms, np.ascontiguousarray(coefficients), inverse, y[part] / unit)
        x[part] = found * scale
    return x, steps


def _by_blocks(given: kernels.Polynomials, y: Array) -> tuple[Array, NDArray[np.int64]]:
    """Variables at which polynomials are y (s, n, 6), and steps (n,), where the plain iteration finds them soon."""
    s, n, _ = y.shape
    d = given.scale.size
    x, steps = np.empty(y.shape), np.empty(n, dtype=np.int64)
    memory = _memory(1 + 3 * d if max(given.left.max(), given.right.max()) > d else 1 + d, d)
    size = PART if s == 1 else max(n, 1)  # what is not in one piece would have to be copied
    for start in range(0, n, size):
        part = slice(start, start + size)
        wanted, found, taken = y[:, part].reshape(s, -1), x[:, part].reshape(s, -1), steps[part]
        kernels.invert(given, wanted, TOLERANCE, kernels.LATE if n > kernels.BLOCK else 0, memory, found, taken)
        late = start + np.flatnonzero(taken == 0)
        if n > kernels.BLOCK and late.size:
            wanted, taken = np.ascontiguousarray(y[:, late]).reshape(s, -1), np.empty(late.size, dtype=np.int64)
            found = np.empty(wanted.shape)
            kernels.invert(given, wanted, TOLERANCE, 0, memory, found, taken)
            x[:, late], steps[late] = found.reshape(s, -1, kernels.SIX), taken
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
