"""First guess of coupled dynamics from free decays: the eigensystem realisation algorithm [Juang1985]_.

References
----------
.. [Juang1985] J.-N. Juang, R. S. Pappa, "An eigensystem realization algorithm for modal parameter identification and
   model reduction", J. Guidance 8 (1985) 620.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.channel import Array
from aerobalance.identification.free_motion import Complex, FreeMotion

BLOCK_ROWS: Final = (24, 48)
"""Rows of readings stacked in the Hankel matrix, tried in turn."""

MOST_COLUMNS: Final = 1500
"""Columns of the Hankel matrix, over all decays."""

JUDGED: Final = 4000
"""Readings of every decay on which a guess is judged."""


@dataclass(frozen=True, slots=True, eq=False)
class Guess:
    """A first guess of the matrices.

    Attributes
    ----------
    spring, brake
        A^-1 [1/s^2] and A^-1 D [1/s], shape (n, n).
    squares
        Sum of squared residuals of the decays.
    """

    spring: Array
    brake: Array
    squares: float


def first_guess(decays: Sequence[Array], *, rate: float) -> Guess | None:
    """Matrices that explain free decays, each of shape (m, n) with the loads over their noise; None if none does."""
    best: Guess | None = None
    for thinned in _thinnings(decays):
        for rows in BLOCK_ROWS:
            guess = _guess(decays, rate=rate, every=thinned, rows=rows)
            if guess is not None and (best is None or guess.squares < best.squares):
                best = guess
    return best


def _thinnings(decays: Sequence[Array]) -> Iterator[int]:
    """Powers of two by which the decays may be thinned and still fill a Hankel matrix."""
    n = decays[0].shape[1]
    longest = max(decay.shape[0] for decay in decays)
    every = 1
    while every == 1 or longest // every > BLOCK_ROWS[0] + 4 * n:
        yield every
        every *= 2


def _guess(decays: Sequence[Array], *, rate: float, every: int, rows: int) -> Guess | None:
    """Realise the increments of the thinned decays, then the decays less the loads that stay."""
    means = [_thinned(decay, every) for decay in decays]
    best: Guess | None = None
    series = [np.diff(mean, axis=0) for mean in means]
    for _ in range(2):
        matrices = _matrices(series, rate=rate, every=every, rows=rows)
        if matrices is None:
            return best
        motion = FreeMotion.of(*matrices)
        rests, squares = zip(*(_rest(motion, decay, rate) for decay in decays), strict=True)
        total = float(sum(squares))
        if best is None or total < best.squares:
            best = Guess(*matrices, total)
        series = [mean - rest for mean, rest in zip(means, rests, strict=True)]
    return best


def _thinned(values: Array, every: int) -> Array:
    """Means over blocks of readings, which leave a free decay one of the same poles."""
    count = values.shape[0] // every
    return np.asarray(values[: count * every].reshape(count, every, -1).mean(axis=1))


def _matrices(series: Sequence[Array], *, rate: float, every: int, rows: int) -> tuple[Array, Array] | None:
    """A^-1 and A^-1 D behind free decays; None where they show no motion of so many modes."""
    n = series[0].shape[1]
    columns = MOST_COLUMNS // len(series)
    blocks = []
    for values in series:
        count = min(values.shape[0] - rows, columns)
        if count > 0:
            windows = np.lib.stride_tricks.sliding_window_view(values[: count + rows - 1], rows, axis=0)
            blocks.append(np.transpose(windows, (2, 1, 0)).reshape(rows * n, -1))
    if sum(block.shape[1] for block in blocks) < 2 * n or (rows - 1) * n < 2 * n:
        return None
    seen = np.linalg.svd(np.hstack(blocks), full_matrices=False)[0][:, : 2 * n]
    step = np.linalg.lstsq(seen[:-n], seen[n:], rcond=None)[0]
    growths, vectors = np.linalg.eig(step)
    growths = growths.astype(np.complex128)
    if (np.abs(growths) < 1e-12).any() or ((growths.imag == 0) & (growths.real < 0)).any():
        return None
    interval = 1 / rate
    poles = np.log(growths) / (every * interval)
    smoothing = np.array([np.mean(np.exp(pole * interval * np.arange(every))) for pole in poles])
    return _from_modes(poles, seen[:n] @ vectors / smoothing)


def _from_modes(poles: Complex, shapes: Complex) -> tuple[Array, Array] | None:
    """The matrices with these poles and shapes; motions that grow are made to decay."""
    n = shapes.shape[0]
    floor = 1e-5 * np.abs(poles)
    poles = -np.maximum(np.abs(poles.real), floor) + 1j * poles.imag
    state = np.vstack([shapes, shapes * poles])
    if not np.linalg.cond(state / np.linalg.norm(state, axis=0)) < 1 / np.finfo(float).eps:
        return None
    lower = np.real((shapes * poles**2) @ np.linalg.inv(state))
    return -lower[:, :n], -lower[:, n:]


def fit_state(motion: FreeMotion, time: Array, values: Array) -> tuple[Array, float]:
    """Loads that stay, loads and rates at time zero of a free decay.

    Returns
    -------
    own
        The three, shape (3 n,).
    squares
        Sum of squared residuals.
    """
    n = motion.size
    columns = motion.columns(time)
    on = motion.on_columns(motion.by_state())
    rest = np.zeros((on.shape[0], n, n))
    rest[-1] = np.eye(n)
    table = np.concatenate([rest, on], axis=2)
    basis, factor = np.linalg.qr(columns)
    flat = np.tensordot(factor, table, axes=1).reshape(-1, 3 * n)
    scale = np.linalg.norm(flat, axis=0)
    scale[scale == 0] = 1.0
    own = np.linalg.lstsq(flat / scale, (basis.T @ values).ravel(), rcond=None)[0] / scale
    left = values - columns @ np.tensordot(table, own, axes=1)
    return own, float(np.sum(left**2))


def _rest(motion: FreeMotion, values: Array, rate: float) -> tuple[Array, float]:
    """Loads that stay after a decay, and its sum of squared residuals."""
    every = max(values.shape[0] // JUDGED, 1)
    time = np.arange(values.shape[0])[::every] / rate
    own, squares = fit_state(motion, time, values[::every])
    return own[: motion.size], squares * every
