"""Least squares over the matrices of all releases together and what is each release's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.identification.coupled.free_response import FreeMotion
from aerobalance.identification.coupled.internal_coordinates import coordinates_of, invariances, pinned
from aerobalance.identification.coupled.least_squares import (
    FIRM,
    LARGEST_GROWTH,
    damped,
    motion_of,
    of_matrices,
    whitener_of,
)
from aerobalance.identification.levenberg_marquardt import DampedStep, Settings, levenberg_marquardt
from aerobalance.identification.step_relaxation.model import Linear, Segment, linearise
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

MOST_STEPS: Final = 60
"""Gauss-Newton steps after which the fit is given up."""

ENOUGH: Final = 1e-3
"""Promised drop of the squares, in variances, at which a fit has settled."""

VALLEY: Final = 20
"""Steps over which a fit that gains less than one variance has settled, finally less than one of the lack of fit."""

SETTINGS: Final = Settings(
    MOST_STEPS,
    ENOUGH,
    enough_of_cost=1e-12,
    barely_of_cost=1e-9,  # rounding is all that is left
    raised=1e-3,
    valley=VALLEY,
)
"""How the fit is damped, and when it has settled."""


@dataclass(frozen=True, slots=True, eq=False)
class ReleaseFit:
    """Matrices and own parameters that explain all segments best.

    Attributes
    ----------
    segments
        The records.
    matrices
        A^-1 and A^-1 D row by row, shape (2 N^2,), in the units of the segments.
    own
        Own parameters of every segment.
    noise
        Covariance of the noise of a row, shape (n, n).
    linears
        Every record near the solution.
    """

    segments: tuple[Segment, ...]
    matrices: Array
    own: tuple[Array, ...]
    noise: Array
    linears: tuple[Linear, ...]

    @property
    def size(self) -> int:
        """Number of components n."""
        return int(self.segments[0].values.shape[1])

    @property
    def motion(self) -> FreeMotion:
        """Free motion of the matrices found."""
        return motion_of(self.matrices, self.size)

    @property
    def parameters(self) -> int:
        """Number of parameters that change readings, those of the records included."""
        return self.matrices.size - 2 * self.internal**2 + sum(segment.own for segment in self.segments)

    @property
    def internal(self) -> int:
        """Number of internal coordinates e."""
        return coordinates_of(self.matrices) - self.size

    @property
    def residuals(self) -> Array:
        """Readings less fit, before and after the edges, record after record, shape (m, n)."""
        return np.vstack([part for linear in self.linears for part in (linear.held, linear.ringing)])

    @property
    def degrees_of_freedom(self) -> int:
        """Readings used less parameters."""
        return self.size * sum(linear.rows for linear in self.linears) - self.parameters

    @property
    def information(self) -> Array:
        """Rows whose squares are the information on the matrices, shape (k, 2 N^2).

        The 2 e^2 directions that change neither readings nor forces are held where they are.
        """
        rows = self._rows
        table = np.vstack(rows)
        scale = np.linalg.norm(table, axis=0)
        unseen = invariances(self.matrices, self.size, loads=np.eye(self.size))
        rows.append(FIRM * pinned(unseen, scale) * scale)
        return np.asarray(np.linalg.qr(np.vstack(rows), mode="r"))

    @property
    def _rows(self) -> list[Array]:
        return [
            of_matrices(linear.block, segment.own)[:, :-1]
            for linear, segment in zip(self.linears, self.segments, strict=True)
        ]


def loads_let_go(segments: Sequence[Segment], own: Sequence[Array]) -> Array:
    """Loads let go from rest, one a column, shape (n, r)."""
    n = segments[0].values.shape[1]
    found = [
        mine[n : 2 * n] - mine[:n]
        for segment, mine in zip(segments, own, strict=True)
        if segment.kind != "free" and not segment.anywhere
    ]
    return np.array(found).reshape(-1, n).T


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known of the matrices beside the segments: squares of (target - rows (matrices - about)), unit noise."""

    rows: Array
    target: Array
    about: Array

    def left(self, matrices: Array) -> Array:
        """Residuals of this knowledge, shape (k,)."""
        return self.target - self.rows @ (matrices - self.about)


def others_than(fit: ReleaseFit, number: int) -> Known:
    """What all segments but one tell about the matrices, near the solution."""
    blocks = [
        of_matrices(linear.block, segment.own)
        for place, (linear, segment) in enumerate(zip(fit.linears, fit.segments, strict=True))
        if place != number
    ]
    n = fit.matrices.size
    rows = np.vstack([np.zeros((1, n + 1)), *blocks])
    return Known(rows[:, :-1], rows[:, -1], fit.matrices)


def settle(
    segments: Sequence[Segment],
    matrices: Array,
    own: Sequence[Array],
    *,
    noise: Array,
    known: Known | None = None,
    steps: int = MOST_STEPS,
    enough: float = ENOUGH,
    flat: float = 1.0,
) -> ReleaseFit:
    """Return the most likely matrices and own parameters, by the Levenberg-Marquardt method.

    The fit has settled too when `VALLEY` steps gain less than `flat` variances.

    Raises
    ------
    FitError
        The fit does not settle.
    """
    segments, own = tuple(segments), tuple(own)
    n, whitener = segments[0].values.shape[1], whitener_of(noise)
    known = known or Known(np.zeros((0, matrices.size)), np.zeros(0), matrices)
    start = ReleaseFit(segments, matrices, own, noise, _linears(segments, matrices, own, whitener))

    def step(here: ReleaseFit, damping: float) -> DampedStep[ReleaseFit]:
        unseen = invariances(here.matrices, n, loads=loads_let_go(segments, here.own))
        move, moves, promised = _step(here, damping, known=known, unseen=unseen)

        def take() -> tuple[ReleaseFit, float]:
            squares = total_squares(here.linears, known, here.matrices)
            trial = here.matrices + move
            tried = tuple(old + change for old, change in zip(here.own, moves, strict=True))
            found, tried = _tried(segments, trial, tried, whitener=whitener, known=known, enough=squares)
            linears = _linears(segments, trial, tried, whitener) if found < squares else here.linears
            return replace(here, matrices=trial, own=tried, linears=linears), found

        return DampedStep(promised, take)

    most = steps * (1 + coordinates_of(matrices) - n)  # valleys bend more with internal coordinates
    settings = replace(SETTINGS, most_steps=most, enough=enough, flat=flat)
    fit, costs, settled = levenberg_marquardt(start, total_squares(start.linears, known, matrices), step, settings)
    if settled or costs[-1 - VALLEY] - costs[-1] < _worth(fit.linears, whitener):
        return fit
    raise FitError(
        f"{', '.join(segment.name for segment in segments)}: the fit of the decays does not settle; are these "
        "releases of one and the same balance and model, with nothing touching it?"
    )


def reweighed(fit: ReleaseFit, noise: Array) -> ReleaseFit:
    """A settled fit under noise of another covariance; where it no longer settles, it stands where it is."""
    try:
        return settle(fit.segments, fit.matrices, fit.own, noise=noise)
    except FitError:  # the valley of a mode that is left out
        linears = _linears(fit.segments, fit.matrices, fit.own, whitener_of(noise))
        return replace(fit, noise=noise, linears=linears)


def _worth(linears: Sequence[Linear], whitener: Array) -> float:
    """Drop of the squares that is worth one variance: 1 for noise, and more for a lack of fit in few frequencies.

    A mode that the motion lacks leaves a lack of fit that no step takes away, and makes the valley long and flat.
    """
    power = np.concatenate(
        [
            np.abs(np.fft.rfft(linear.ringing @ whitener.T, axis=0)[1:]).ravel() ** 2 / len(linear.ringing)
            for linear in linears
        ]
    )
    return float(np.sum(power**2) / (2 * np.sum(power)))  # the squares of noise, of exponential distribution, are 2


def _tried(
    segments: tuple[Segment, ...],
    trial: Array,
    own: tuple[Array, ...],
    *,
    whitener: Array,
    known: Known,
    enough: float,
) -> tuple[float, tuple[Array, ...]]:
    """Squares with trial matrices; where internal coordinates bend the valley, own parameters follow these."""
    n = whitener.shape[0]
    rounds = 2 if coordinates_of(trial) > n else 1
    found = np.inf
    for number in range(rounds):
        if not _bounded(segments, motion_of(trial, n), own):
            return np.inf, own
        linears = _linears(segments, trial, own, whitener, derivatives=number + 1 < rounds)
        found = total_squares(linears, known, trial)
        if found < enough:
            break
        if number + 1 < rounds:
            blocks = [linear.block[: segment.own] for linear, segment in zip(linears, segments, strict=True)]
            own = tuple(
                mine + np.linalg.lstsq(block[:, : mine.size], block[:, -1], rcond=1e-14)[0]
                for mine, block in zip(own, blocks, strict=True)
            )
    return found, own


def total_squares(linears: Sequence[Linear], known: Known, matrices: Array) -> float:
    """Sum of squared weighted residuals of segments and of what is known."""
    return sum(linear.squares for linear in linears) + float(np.sum(known.left(matrices) ** 2))


def _linears(
    segments: tuple[Segment, ...],
    matrices: Array,
    own: tuple[Array, ...],
    whitener: Array,
    *,
    derivatives: bool = True,
) -> tuple[Linear, ...]:
    motion = motion_of(matrices, whitener.shape[0])
    return tuple(
        linearise(segment, motion, mine, whitener=whitener, derivatives=derivatives)
        for segment, mine in zip(segments, own, strict=True)
    )


def _step(here: ReleaseFit, damping: float, *, known: Known, unseen: Array) -> tuple[Array, list[Array], float]:
    """DampedStep of the matrices and of each record's own parameters, and the drop of squares that it promises.

    Nothing moves along the directions (rows of `unseen`) that change no reading.
    """
    segments = here.segments
    blocks = [
        damped(linear.block, segment.own, damping) for linear, segment in zip(here.linears, segments, strict=True)
    ]
    common = np.vstack([of_matrices(block, segment.own) for block, segment in zip(blocks, segments, strict=True)])
    table = np.vstack([common[:, :-1], known.rows])
    target = np.concatenate([common[:, -1], known.left(here.matrices)])
    scale = np.linalg.norm(table, axis=0)
    scale[scale == 0] = 1.0
    hold = pinned(unseen, scale)
    full = np.vstack([table / scale, hold, damping * np.eye(scale.size)])
    aim = np.concatenate([target, np.zeros(len(hold) + scale.size)])
    move = np.linalg.lstsq(full, aim, rcond=1e-14)[0] / scale
    moves = []
    promised = float(target @ target - np.sum((target - table @ move) ** 2))
    for block, segment in zip(blocks, segments, strict=True):
        k = segment.own
        aim = block[:k, -1] - block[:k, k:-1] @ move
        moves.append(np.linalg.lstsq(block[:k, :k], aim, rcond=1e-14)[0])
        promised += float(block[:k, -1] @ block[:k, -1])
    return move, moves, promised


def _bounded(segments: tuple[Segment, ...], motion: FreeMotion, own: tuple[Array, ...]) -> bool:
    """Whether a trial motion stays finite over the records and its edges lie in them."""
    longest = max(float(segment.time[-1] - segment.time[0]) for segment in segments)
    inside = True
    n = motion.components
    for segment, mine in zip(segments, own, strict=True):
        if segment.kind != "free":
            instant = float(mine[2 * n])
            inside &= segment.time[0] < instant < segment.time[-1 - 3 * n]
        if segment.kind == "ramp":
            duration = float(mine[2 * n + 1])
            inside &= duration >= 0 and segment.edge[0] <= instant and instant + duration <= segment.edge[1]
    return bool(inside and float(motion.poles.real.max()) * longest < LARGEST_GROWTH)


def replaced(fit: ReleaseFit, number: int, *, segment: Segment, own: Array) -> ReleaseFit:
    """The fit with one record taken otherwise, not settled."""
    segments = (*fit.segments[:number], segment, *fit.segments[number + 1 :])
    mine = (*fit.own[:number], own, *fit.own[number + 1 :])
    return replace(fit, segments=segments, own=mine)
