"""Readings after a release as a function of the matrices and of what is the release's own, with all derivatives.

A record is held loads, an edge, and a free decay to the loads that stay. Coordinates that no channel shows are at rest
at zero before a release, or anywhere where that is not asked for. What is known of a record about the matrices is kept
as a triangular factor of its weighted least squares, from which its own parameters can be eliminated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.linalg import qr

from aerobalance.identification.coupled.free_response import Complex, ExponentialSums, FreeMotion
from aerobalance.identification.coupled.least_squares import compressed, weighted
from aerobalance.recording.channel import Array

Kind = Literal["release", "ramp", "free"]

NODES: Final = np.polynomial.legendre.leggauss(16)
"""Nodes and weights of the mean over the duration of a release."""


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """One record in the units of the fit.

    Attributes
    ----------
    name
        What it is called in messages.
    time
        Times of the rows, shape (m,), increasing.
    values
        Balance loads, shape (m, n).
    kind
        ``"release"``: held and let go at once. ``"ramp"``: let go over a duration, evenly. ``"free"``: decaying from
        any state, only from the end of `edge` on.
    edge
        First and last time between which rows are left out; empty (equal times) for a release.
    internal
        Number of coordinates that no channel shows, e.
    anywhere
        Whether these may be anywhere, and moving, at the instant of a release; otherwise they are at rest at zero.
    """

    name: str
    time: Array
    values: Array
    kind: Kind
    edge: tuple[float, float]
    internal: int = 0
    anywhere: bool = False

    @property
    def own(self) -> int:
        """Number of parameters of the record's own."""
        n = int(self.values.shape[1])
        if self.kind == "free":
            return 3 * n + 2 * self.internal
        return {"release": 2 * n + 1, "ramp": 2 * n + 2}[self.kind] + 2 * self.internal * self.anywhere


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """A record near one set of parameters.

    Attributes
    ----------
    squares
        Sum of the squared weighted residuals.
    rows
        Number of rows used.
    block
        Triangular factor of [own parameters, spring, brake, residual], shape (k, own + 2 N^2 + 1).
    held, ringing
        Residuals before and after the edge, not weighted, shapes (a, n) and (b, n).
    """

    squares: float
    rows: int
    block: Array
    held: Array
    ringing: Array


def linearise(
    segment: Segment, motion: FreeMotion, own: Array, *, whitener: Array, derivatives: bool = True
) -> Linear:
    """Residuals of a record, and their triangular factor.

    Parameters
    ----------
    segment
        The record.
    motion
        Free motion of the trial matrices.
    own
        The record's own parameters: loads that stay, then for a release the loads held, the instant, for a ramp the
        duration, and internal coordinates and their rates where they may be anywhere; for a free decay all of them,
        the loads less those that stay, and their rates at the end of the edge.
    whitener
        What turns the noise of one row into independent unit noise, shape (n, n).
    derivatives
        Whether the factor is wanted.
    """
    n = motion.components
    held, ringing, since = _parts(segment, own)
    on_columns, model = _slopes(segment, motion, own) if derivatives else (None, _model(segment, motion, own))
    columns = motion.columns(segment.time[ringing] - since)
    on = motion.on_columns(model)[:, :, 0]
    on[-1] += own[:n]
    after = segment.values[ringing] - columns @ on
    before = segment.values[held] - own[n : 2 * n]
    squares = float(np.sum((after @ whitener.T) ** 2) + np.sum((before @ whitener.T) ** 2))
    block: Array = np.zeros((0, 0))
    if on_columns is not None:
        factor, along = compressed(columns, after)
        slopes = np.tensordot(factor, on_columns, axes=1)
        table = np.concatenate([slopes, along[:, :, None]], axis=2)
        rows = [weighted(whitener, table)]
        if before.size:
            root = np.sqrt(before.shape[0])
            flat: Array = np.zeros((1, n, table.shape[2]))
            flat[0, :, n : 2 * n] = root * np.eye(n)
            flat[0, :, -1] = root * before.mean(axis=0)
            rows.append(weighted(whitener, flat))
        block = np.array(qr(np.vstack(rows), mode="r", check_finite=False)[0][: table.shape[2]], dtype=np.float64)
    return Linear(squares, before.shape[0] + after.shape[0], block, before, after)


@dataclass(frozen=True, slots=True, eq=False)
class ReadingSlopes:
    """How the readings after the edge of a record depend on all its parameters.

    Attributes
    ----------
    held, ringing
        Rows before and after the edge.
    columns
        Columns that span the readings after it, shape (m, p).
    slopes
        Derivatives of the readings by own parameters and matrices, on the columns, shape (p, n, own + 2 N^2); those
        held are the second n parameters of a record that has any.
    """

    held: slice
    ringing: slice
    columns: Array
    slopes: Array


def reading_slopes(segment: Segment, motion: FreeMotion, own: Array) -> ReadingSlopes:
    """Derivatives of the readings of a record, not weighted; the arguments are those of `linearise`."""
    held, ringing, since = _parts(segment, own)
    return ReadingSlopes(
        held, ringing, motion.columns(segment.time[ringing] - since), _slopes(segment, motion, own)[0]
    )


def _slopes(segment: Segment, motion: FreeMotion, own: Array) -> tuple[Array, ExponentialSums]:
    """Derivatives of the readings after the edge on the columns, and the motion."""
    functions, model = _functions(segment, motion, own)
    slopes, n = motion.on_columns(functions), motion.components
    slopes[-1, :, :n] += np.eye(n)  # the loads that stay
    return slopes, model


def _parts(segment: Segment, own: Array) -> tuple[slice, slice, float]:
    """Rows before and after the edge, and the instant from which the decay counts its time."""
    n = segment.values.shape[1]
    if segment.kind == "free":
        return slice(0, 0), slice(int(np.searchsorted(segment.time, segment.edge[1])), None), segment.edge[1]
    instant = float(own[2 * n])
    if segment.kind == "release":
        first = int(np.searchsorted(segment.time, instant))
        return slice(0, first), slice(first, None), instant
    first, last = np.searchsorted(segment.time, segment.edge)
    return slice(0, int(first)), slice(int(last), None), instant


def state_at_the_edge(segment: Segment, own: Array) -> tuple[Array, Array]:
    """Coordinates from rest and their rates where the motion begins, shape (N,) each."""
    n, e = segment.values.shape[1], segment.internal
    if segment.kind == "free":
        return own[n : 2 * n + e], own[2 * n + e :]
    unseen = own[-2 * e :] if e and segment.anywhere else np.zeros(2 * e)
    return np.concatenate([own[n : 2 * n] - own[:n], unseen[:e]]), np.concatenate([np.zeros(n), unseen[e:]])


def _started(segment: Segment, motion: FreeMotion, own: Array) -> tuple[ExponentialSums, Complex]:
    """The motion as if it had begun at once, and the sizes of its modes."""
    sizes = motion.sizes(*state_at_the_edge(segment, own))
    return motion.motion(sizes), sizes


def _means(motion: FreeMotion, duration: float) -> tuple[Complex, Complex, Complex]:
    """Means over a duration T, by pole: of exp(-p s), of -s exp(-p s), and of the first's derivative by T."""
    place, weight = (NODES[0] + 1) / 2, NODES[1] / 2
    falls = weight * np.exp(-motion.poles[:, None] * duration * place)
    return falls.sum(axis=1), -(falls * duration * place).sum(axis=1), -motion.poles * (falls * place).sum(axis=1)


def _model(segment: Segment, motion: FreeMotion, own: Array) -> ExponentialSums:
    """The motion after the edge, loads that stay left out."""
    whole, _ = _started(segment, motion, own)
    if segment.kind == "ramp":
        plain, late, _ = _means(motion, float(own[2 * motion.components + 1]))
        return whole.weighted(plain, late)
    return whole


def _functions(segment: Segment, motion: FreeMotion, own: Array) -> tuple[ExponentialSums, ExponentialSums]:
    """Derivatives by own parameters and matrices, and the motion; the constant of the loads that stay is left out."""
    n, size = motion.components, motion.size
    whole, sizes = _started(segment, motion, own)
    state, matrices = motion.by_state(), motion.by_matrices(sizes)
    if segment.kind == "free":
        nothing = np.zeros((2 * size, n, n), dtype=np.complex128)
        return ExponentialSums.joined([ExponentialSums(nothing, nothing, np.zeros((n, n))), state, matrices]), whole
    loads = state.picked(slice(n))
    away = ExponentialSums(-loads.plain, -loads.late, -loads.constant)
    parts = [away, loads, motion.by_time(whole)]
    if segment.anywhere:
        parts += [state.picked(slice(n, size)), state.picked(slice(size + n, 2 * size))]
    parts.append(matrices)
    if segment.kind == "release":
        return ExponentialSums.joined(parts), whole
    plain, late, steeper = _means(motion, float(own[2 * n + 1]))
    parts = [part.weighted(plain, late) for part in parts]
    parts.insert(3, whole.weighted(steeper, np.zeros_like(steeper)))
    return ExponentialSums.joined(parts), whole.weighted(plain, late)
