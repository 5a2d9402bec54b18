"""First guess of coupled dynamics from free decays: the eigensystem realisation algorithm [Juang1985]_.

References
----------
.. [Juang1985] J.-N. Juang, R. S. Pappa, "An eigensystem realization algorithm for modal parameter identification and
   model reduction", J. Guidance 8 (1985) 620.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from aerobalance.identification.coupled.free_response import Complex, FreeMotion
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True)
class RealisationSettings:
    """Sizes and thresholds of the first guess of coupled dynamics.

    Attributes
    ----------
    block_rows
        Rows of readings stacked in the Hankel matrix, tried in turn.
    most_columns
        Columns of the Hankel matrix, over all decays.
    quick
        Thinnings that a quick look tries in turn.
    good
        Squares over the noise variance and a reading with which a guess with internal coordinates is taken.
    largest_growth
        Logarithm of the growth over a decay, made by rounding where modes hardly differ, beyond which none is tried.
    judged
        Readings of every decay on which a guess is judged.
    """

    block_rows: tuple[int, int] = (24, 48)
    most_columns: int = 1500
    quick: tuple[int, ...] = (8, 4, 2, 1, 16)
    good: float = 1.5
    largest_growth: float = 100.0
    judged: int = 4000


SETTINGS: Final = RealisationSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class Guess:
    """A first guess of the matrices.

    Attributes
    ----------
    spring, brake
        A^-1 [1/s^2] and A^-1 D [1/s], shape (N, N).
    squares
        Sum of squared residuals of the decays.
    """

    spring: Array
    brake: Array
    squares: float


def first_guess(decays: Sequence[Array], *, rate: float, internal: int = 0) -> Guess | None:
    """Matrices that explain free decays, each of shape (m, n) with the loads over their noise; None if none does.

    With internal coordinates, these are those of single modes.
    """
    best: Guess | None = None
    thinnings = list(_thinnings(decays))
    if internal:  # what explains the decays to the noise is good enough: begin where it is most likely found
        thinnings.sort(key=lambda every: abs(np.log2(every / SETTINGS.quick[0])))
    for thinned in thinnings:
        for rows in SETTINGS.block_rows:
            guess = _guess(decays, rate=rate, every=thinned, rows=rows, internal=internal)
            if guess is not None and (best is None or guess.squares < best.squares):
                best = guess
            if internal and best is not None and best.squares < SETTINGS.good * sum(decay.size for decay in decays):
                return best
    return best


def quick_guess(decays: Sequence[Array], *, rate: float, internal: int) -> Guess | None:
    """The best of few guesses, or the first that explains the decays to the noise."""
    best: Guess | None = None
    for every in SETTINGS.quick:
        guess = _guess(decays, rate=rate, every=every, rows=SETTINGS.block_rows[0], internal=internal)
        if guess is not None and (best is None or guess.squares < best.squares):
            best = guess
        if best is not None and best.squares < SETTINGS.good * sum(decay.size for decay in decays):
            break
    return best


def _thinnings(decays: Sequence[Array]) -> Iterator[int]:
    """Powers of two by which the decays may be thinned and still fill a Hankel matrix."""
    n = decays[0].shape[1]
    longest = max(decay.shape[0] for decay in decays)
    every = 1
    while every == 1 or longest // every > SETTINGS.block_rows[0] + 4 * n:
        yield every
        every *= 2


def _guess(decays: Sequence[Array], *, rate: float, every: int, rows: int, internal: int) -> Guess | None:
    """Realise the increments of the thinned decays, then the decays less the loads that stay."""
    means = [_thinned(decay, every) for decay in decays]
    best: Guess | None = None
    series = [np.diff(mean, axis=0) for mean in means]
    for _ in range(2):
        matrices = _matrices(series, rate=rate, every=every, rows=rows, internal=internal)
        if matrices is None:
            return best
        motion = FreeMotion.of(*matrices, components=decays[0].shape[1])
        if float(motion.poles.real.max()) * max(decay.shape[0] for decay in decays) / rate > SETTINGS.largest_growth:
            return best
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


def _matrices(
    series: Sequence[Array], *, rate: float, every: int, rows: int, internal: int
) -> tuple[Array, Array] | None:
    """A^-1 and A^-1 D behind free decays; None where they show no motion of so many modes."""
    n = series[0].shape[1]
    order = 2 * (n + internal)
    columns = SETTINGS.most_columns // len(series)
    blocks = []
    for values in series:
        count = min(values.shape[0] - rows, columns)
        if count > 0:
            windows = np.lib.stride_tricks.sliding_window_view(values[: count + rows - 1], rows, axis=0)
            blocks.append(np.transpose(windows, (2, 1, 0)).reshape(rows * n, -1))
    if sum(block.shape[1] for block in blocks) < order or (rows - 1) * n < order:
        return None
    # its left singular vectors are those of a triangle whose columns are turned, and are found in half the time
    triangle = np.asarray(np.linalg.qr(np.hstack(blocks).T, mode="r")).T
    seen = np.linalg.svd(triangle, full_matrices=False)[0][:, :order]
    step = np.linalg.lstsq(seen[:-n], seen[n:], rcond=None)[0]
    growths, vectors = np.linalg.eig(step)
    growths = growths.astype(np.complex128)
    if (np.abs(growths) < 1e-12).any() or ((growths.imag == 0) & (growths.real < 0)).any():
        return None
    interval = 1 / rate
    poles = np.log(growths) / (every * interval)
    smoothing = np.array([np.mean(np.exp(pole * interval * np.arange(every))) for pole in poles])
    return from_modes(poles, seen[:n] @ vectors / smoothing)


def from_modes(poles: Complex, shapes: Complex) -> tuple[Array, Array] | None:
    """The matrices with these poles and shapes; motions that grow are made to decay."""
    floor = 1e-5 * np.abs(poles)
    poles = -np.maximum(np.abs(poles.real), floor) + 1j * poles.imag
    state = _state(poles, shapes)
    if state is None:
        return None
    size = len(state) // 2
    lower = np.real((state[:size] * poles**2) @ np.linalg.inv(state))
    return -lower[:, :size], -lower[:, size:]


def _state(poles: Complex, shapes: Complex) -> Complex | None:
    """Coordinates and rates in every mode, shape (2 N, 2 N); internal coordinates are those of modes of their own.

    Those modes are taken without which the loads and their rates tell the others best.
    """
    n, size = shapes.shape[0], poles.size // 2
    pairs = np.flatnonzero(poles.imag > 0)
    best, least = None, 1 / np.finfo(float).eps
    for chosen in combinations(pairs, size - n):
        extra = np.zeros((len(chosen), poles.size), dtype=np.complex128)
        for row, place in enumerate(chosen):
            other = int(np.argmin(np.abs(poles - poles[place].conj())))
            extra[row, [place, other]] = np.linalg.norm(shapes[:, place])
        whole = np.vstack([shapes, extra])
        state = np.vstack([whole, whole * poles])
        condition = np.linalg.cond(state / np.linalg.norm(state, axis=0))
        if condition < least:
            best, least = state, condition
    return best


def fit_state(motion: FreeMotion, time: Array, values: Array) -> tuple[Array, float]:
    """Loads that stay, coordinates and rates at time zero of a free decay.

    Returns
    -------
    own
        The three, shape (n + 2 N,).
    squares
        Sum of squared residuals.
    """
    n = motion.components
    columns = motion.columns(time)
    on = motion.on_columns(motion.by_state())
    rest = np.zeros((on.shape[0], n, n))
    rest[-1] = np.eye(n)
    table = np.concatenate([rest, on], axis=2)
    basis, factor = np.linalg.qr(columns)
    flat = np.tensordot(factor, table, axes=1).reshape(-1, table.shape[2])
    scale = np.linalg.norm(flat, axis=0)
    scale[scale == 0] = 1.0
    own = np.linalg.lstsq(flat / scale, (basis.T @ values).ravel(), rcond=None)[0] / scale
    left = values - columns @ np.tensordot(table, own, axes=1)
    return own, float(np.sum(left**2))


def _rest(motion: FreeMotion, values: Array, rate: float) -> tuple[Array, float]:
    """Loads that stay after a decay, and its sum of squared residuals."""
    every = max(values.shape[0] // SETTINGS.judged, 1)
    time = np.arange(values.shape[0])[::every] / rate
    own, squares = fit_state(motion, time, values[::every])
    return own[: motion.components], squares * every
