"""Least squares over what all taps share (matrices, gain and delay of the force) and what is each one's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.linalg import qr

from aerobalance.identification.coupled.free_response import FreeMotion
from aerobalance.identification.coupled.internal_coordinates import coordinates_of, invariances, pinned
from aerobalance.identification.coupled.least_squares import (
    FIRM,
    LARGEST_GROWTH,
    damped,
    motion_of,
    whitener_of,
)
from aerobalance.identification.impact.tap_model import COMMON, Common, Point, Tap, TapLinear, linearise_tap
from aerobalance.identification.levenberg_marquardt import DampedStep, Settings, levenberg_marquardt
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

SETTINGS: Final = Settings(60, 1e-3, enough_of_cost=1e-12, barely_of_cost=1e-9, raised=1e-3, valley=20)
"""How the fit is damped, and when it has settled."""


@dataclass(frozen=True, slots=True, eq=False)
class TapFit:
    """Matrices, and what is each tap's and each point's own, that explain all taps best.

    Attributes
    ----------
    taps, points
        The taps, and where they were given.
    common
        What all share.
    own
        Own unknowns of every tap.
    off
        How far off each point is, in units of its root.
    noise
        Covariance of the noise of a row, shape (n, n).
    linears
        Every tap near the solution.
    """

    taps: tuple[Tap, ...]
    points: tuple[Point, ...]
    common: Common
    own: tuple[Array, ...]
    off: tuple[Array, ...]
    noise: Array
    linears: tuple[TapLinear, ...]

    @property
    def size(self) -> int:
        """Number of components n."""
        return int(self.noise.shape[0])

    @property
    def internal(self) -> int:
        """Number of coordinates that no channel shows."""
        return coordinates_of(self.common.matrices) - self.size

    @property
    def motion(self) -> FreeMotion:
        """Free motion of the matrices found."""
        return motion_of(self.common.matrices, self.size)

    @property
    def squares(self) -> float:
        """Sum of the squares, of all that is known."""
        return _squares(self.linears, self.off, self.common)

    @property
    def residuals(self) -> Array:
        """Readings less fit, before and after the contacts, tap after tap, shape (m, n)."""
        return np.vstack([part for linear in self.linears for part in (linear.before, linear.after)])

    @property
    def degrees_of_freedom(self) -> int:
        """Readings of loads used less unknowns; those of force, point, gain and delay bring readings of their own."""
        free = sum(3 * self.size + 2 * self.internal for _ in self.taps)
        matrices = self.common.matrices.size - 2 * self.internal**2
        return self.size * sum(linear.rows for linear in self.linears) - free - matrices

    @property
    def shared(self) -> Array:
        """Rows whose squares are the information on gain, delay and matrices, shape (k, 2 + 2 N^2)."""
        rows = of_common(self.blocks(0.0), self.taps, self.points, self.off, self.common)[0]
        table = rows[:, :-1]
        scale = np.linalg.norm(table[:, COMMON:], axis=0)
        unseen = unseen_by(self.taps, self.points, self.common.matrices)
        hold = FIRM * pinned(unseen, scale) * scale
        held = np.hstack([np.zeros((len(hold), COMMON)), hold])
        return np.asarray(np.linalg.qr(np.vstack([table, held]), mode="r"))

    @property
    def information(self) -> Array:
        """Rows whose squares are the information on the matrices alone, shape (2 N^2, 2 N^2)."""
        return self.shared[COMMON:, COMMON:]

    def blocks(self, damping: float) -> list[Array]:
        """Triangular factor of every tap, its own unknowns held back by a part of their information."""
        return [damped(linear.block, tap.own, damping) for tap, linear in zip(self.taps, self.linears, strict=True)]


def unseen_by(taps: Sequence[Tap], points: Sequence[Point], matrices: Array) -> Array:
    """Directions of the matrices that change no reading, rows."""
    n = points[0].loads.size
    used = sorted({tap.point for tap in taps if tap.linked})
    loads = np.array([points[place].loads for place in used]).reshape(-1, n).T
    return invariances(matrices, n, loads=loads)


def _squares(linears: Sequence[TapLinear], off: Sequence[Array], common: Common) -> float:
    known = sum(float(one @ one) for one in off) + common.gain**2 + common.delay**2
    return sum(linear.squares for linear in linears) + known


def of_common(
    blocks: Sequence[Array], taps: Sequence[Tap], points: Sequence[Point], off: Sequence[Array], common: Common
) -> tuple[Array, list[Array]]:
    """Return what all taps say of gain, delay and matrices, rows of [them, residual], and every point's factor."""
    kept, rows = list[Array](), list[Array]()
    for place, (point, mine) in enumerate(zip(points, off, strict=True)):
        r = point.root.shape[1]
        parts = [block[tap.own :, tap.own :] for block, tap in zip(blocks, taps, strict=True) if tap.point == place]
        if not parts:
            kept.append(np.zeros((0, 0)))
            continue
        known = np.zeros((r, parts[0].shape[1]))
        known[:, :r], known[:, -1] = np.eye(r), -mine
        factor = np.asarray(qr(np.vstack([known, *parts]), mode="r", check_finite=False)[0], dtype=np.float64)
        factor = factor[: factor.shape[1]]
        kept.append(factor)
        rows.append(np.asarray(factor[r:, r:], dtype=np.float64))
    known = np.zeros((COMMON, rows[0].shape[1]))
    known[:, :COMMON], known[:, -1] = np.eye(COMMON), (-common.gain, -common.delay)
    return np.vstack([known, *rows]), kept


def linears_of(
    taps: Sequence[Tap],
    points: Sequence[Point],
    common: Common,
    own: Sequence[Array],
    off: Sequence[Array],
    *,
    whitener: Array,
) -> tuple[TapLinear, ...]:
    """Every tap near these parameters."""
    motion = motion_of(common.matrices, whitener.shape[0])
    return tuple(
        linearise_tap(
            tap,
            motion,
            common,
            own=mine,
            point=points[tap.point],
            off=off[tap.point],
            whitener=whitener,
        )
        for tap, mine in zip(taps, own, strict=True)
    )


def settle_taps(
    taps: Sequence[Tap],
    points: Sequence[Point],
    common: Common,
    own: Sequence[Array],
    *,
    noise: Array,
    off: Sequence[Array] | None = None,
) -> TapFit:
    """Return the most likely matrices and all else that is not known, by the Levenberg-Marquardt method.

    Raises
    ------
    FitError
        The fit does not settle.
    """
    taps, points, own = tuple(taps), tuple(points), tuple(own)
    off = tuple(np.zeros(point.root.shape[1]) for point in points) if off is None else tuple(off)
    whitener = whitener_of(noise)
    longest = max(float(tap.time[-1] - tap.time[0]) for tap in taps)
    start = TapFit(
        taps, points, common, own, off, noise, linears_of(taps, points, common, own, off, whitener=whitener)
    )

    def step(here: TapFit, damping: float) -> DampedStep[TapFit]:
        unseen = unseen_by(taps, points, here.common.matrices)
        move, offs, moves, promised = _step(here, damping, unseen=unseen)

        def take() -> tuple[TapFit, float]:
            tried = here.common.moved(move)
            mine = tuple(old + change for old, change in zip(here.own, moves, strict=True))
            beside = tuple(old + change for old, change in zip(here.off, offs, strict=True))
            motion = motion_of(tried.matrices, whitener.shape[0])
            if not np.isfinite(tried.matrices).all() or motion.poles.real.max() * longest > LARGEST_GROWTH:
                return here, np.inf
            linears = linears_of(taps, points, tried, mine, beside, whitener=whitener)
            found = _squares(linears, beside, tried)
            return replace(here, common=tried, own=mine, off=beside, linears=linears), found

        return DampedStep(promised, take)

    most = SETTINGS.most_steps * (1 + start.internal)
    fit, costs, settled = levenberg_marquardt(start, start.squares, step, replace(SETTINGS, most_steps=most))
    if settled or costs[-2] - costs[-1] < 1e-3 * costs[-1]:
        return fit
    raise FitError(
        f"{taps[0].name} and {len(taps) - 1} more: the fit of the taps does not settle; are they on one and the same "
        "balance and model, with nothing else touching it?"
    )


def _step(here: TapFit, damping: float, *, unseen: Array) -> tuple[Array, list[Array], list[Array], float]:
    """Step of what all share, of each point's and of each tap's own, and the drop of squares that it promises."""
    blocks = here.blocks(damping)
    rows, kept = of_common(blocks, here.taps, here.points, here.off, here.common)
    table, target = rows[:, :-1], rows[:, -1]
    scale = np.linalg.norm(table, axis=0)
    scale[scale == 0] = 1.0
    hold = pinned(unseen, scale[COMMON:])
    held = np.hstack([np.zeros((len(hold), COMMON)), hold])
    full = np.vstack([table / scale, held, damping * np.eye(scale.size)])
    aim = np.concatenate([target, np.zeros(len(held) + scale.size)])
    move = np.linalg.lstsq(full, aim, rcond=1e-14)[0] / scale
    promised = float(target @ target - np.sum((target - table @ move) ** 2))
    offs: list[Array] = []
    for point, factor in zip(here.points, kept, strict=True):
        r = point.root.shape[1]
        if not factor.size or not r:
            offs.append(np.zeros(r))
            continue
        wanted = factor[:r, -1] - factor[:r, r:-1] @ move
        offs.append(np.linalg.lstsq(factor[:r, :r], wanted, rcond=1e-14)[0])
        promised += float(factor[:r, -1] @ factor[:r, -1])
    moves = []
    for block, tap in zip(blocks, here.taps, strict=True):
        k = tap.own
        rest = np.concatenate([offs[tap.point], move])
        wanted = block[:k, -1] - block[:k, k:-1] @ rest
        moves.append(np.linalg.lstsq(block[:k, :k], wanted, rcond=1e-14)[0])
        promised += float(block[:k, -1] @ block[:k, -1])
    return move, offs, moves, promised
