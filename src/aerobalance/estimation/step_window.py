"""The likelihood of a step at any instant of a part of a record, for the price of a few whitened columns.

After the force has changed, the balance swings freely: a constant and its modes, whatever the instant was; while it
changes evenly, a straight line is added. So every response is a sum of these few shapes from the samples on at which
the change begins and ends. The steady filter does not change with time: the shapes are whitened once, and shifted, and
what the start of the record has of them is taken off. Beside gaps a response is a sum of single samples, as long as
the force may be changing, and of the shapes from then on, which are whitened together; each instant and duration that
is tried then takes a sum of squares of some thirty numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from aerobalance.dynamics.modal import Mode
from aerobalance.estimation.prior import Observation
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.steps import Step, response_to
from aerobalance.recording.channel import Array

MARGIN: Final = 28
"""Samples after the last instant expected in which the force may still change: the longest ramp tried and more."""

MOST_SAMPLES: Final = 512
"""Samples in which the force may be changing, up to which they are taken one by one."""

TOGETHER: Final = 64
"""Columns that are whitened together: the filter needs several times their room beside them."""

POINTS: Final = 16
"""Samples, over the number of shapes, at which the shapes of a free motion are fitted to it."""

SAME_POLE: Final = 1e-4
"""Angle by which two poles of a mode part within the window, below which they are one [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class ShiftedShapes:
    """A constant, a straight line and free motions that begin at a sample, whitened by a filter without gaps.

    Attributes
    ----------
    reading
        The part of a record that is looked at.
    whitened
        The shapes from the first sample on by the steady filter, shape (s, n); those that begin later are the same.
    times
        Instants at which a sum of shapes is fitted to a response, from its first sample on, shape (p,) [s].
    fit
        Makes the sizes of the shapes from the response there, shape (s, p).
    start
        What the initial state that is not known shows in the whitened readings, orthogonal and of length 1, (r, m).
    lost
        Share of each that the readings do not tell, as the initial state may have made it, shape (r,).
    """

    reading: Observation
    whitened: Array
    times: Array
    fit: Array
    start: Array
    lost: Array

    @classmethod
    def of(cls, reading: Observation, filter_: KalmanFilter) -> ShiftedShapes:
        """Return the shapes of a reading and a filter of it."""
        count = reading.values.size
        time = reading.interval * np.arange(count, dtype=np.float64)
        motions = [part for mode in reading.dynamics.modes for part in _free_motions(mode, time)]
        shapes = np.column_stack([np.ones(count), time / time[-1], *motions])
        points = np.unique(np.linspace(0, count - 1, min(POINTS * shapes.shape[1], count)).astype(int))
        whitened = np.ascontiguousarray(filter_.settled.whiten(shapes).T)
        start, seen = filter_.start_shown
        return cls(reading, whitened, time[points], np.linalg.pinv(shapes[points]), start, 1 - (1 + seen**2) ** -0.5)

    def response(self, instant: float, duration: float) -> Array:
        """Return the whitened response to a step of 1 N, shape (n,) [1/N]."""
        whole = self.whitened.shape[1] * self.reading.interval
        column = np.zeros(self.whitened.shape[1])
        if duration <= 0:
            self._add(column, instant, 0.0, size=1.0)
        else:  # one force that rises for longer than the window, less another
            self._add(column, instant, 2 * whole, size=2 * whole / duration)
            self._add(column, instant + duration, 2 * whole, size=-2 * whole / duration)
        early = column[: self.start.shape[1]]
        early -= (self.lost * (self.start @ early)) @ self.start
        return column

    def _add(self, column: Array, instant: float, duration: float, *, size: float) -> None:
        """Add the response to a step of a size that is not over before the window ends [N]."""
        first = int(np.ceil(instant / self.reading.interval))
        if first >= column.size:
            return
        since = self.times + (first * self.reading.interval - instant)
        sizes = size * (self.fit @ self.reading.dynamics.step_response(since, duration=duration))
        column[first:] += sizes @ self.whitened[:, : column.size - first]


@dataclass(slots=True, eq=False)
class StepWindow:
    """Part of a record in which one step is sought beside known shapes.

    Attributes
    ----------
    reading
        The part.
    filter
        Its filter.
    basis
        The known shapes whitened, orthogonal and of length 1, shape (n, q).
    left
        What they leave of the whitened readings, shape (n,).
    before
        Samples before the first instant that is tried at which others are expected.
    """

    reading: Observation
    filter: KalmanFilter
    basis: Array
    left: Array
    before: int = 0
    _first: int = field(init=False, default=0)
    _edge: int = field(init=False, default=0)
    _fit: Array = field(init=False, default_factory=lambda: np.zeros((0, 0)))
    _time: Array = field(init=False, default_factory=lambda: np.zeros(0))
    _gram: Array = field(init=False, default_factory=lambda: np.zeros((0, 0)))
    _told: Array = field(init=False, default_factory=lambda: np.zeros(0))
    _shapes: ShiftedShapes | None = field(init=False, default=None)

    @classmethod
    def of(cls, reading: Observation, filter_: KalmanFilter, columns: Array, *, before: int = 0) -> StepWindow:
        """Return the window of a reading in which the sizes of known shapes (n, q) are free."""
        white = filter_.whiten(np.column_stack([reading.filled, columns]))
        basis, _ = np.linalg.qr(white[:, 1:])
        return cls(reading, filter_, basis, white[:, 0] - basis @ (basis.T @ white[:, 0]), before)

    def squares(self, instant: float, duration: float) -> float:
        """Return the sum of squares [1] that a step of the best height leaves.

        Parameters
        ----------
        instant, duration
            When the force begins to change, and for how long [s].
        """
        if self.reading.decimated > 1:  # what the filter of the slower clock does beside a change is no free motion
            column = self._left_of(response_to(Step(instant, duration), self.reading)[:, None])[:, 0]
            return float(self.left @ self.left - float(self.left @ column) ** 2 / max(float(column @ column), 1e-300))
        begin, end = instant / self.reading.interval, (instant + duration) / self.reading.interval
        if self.filter.has_no_gaps and begin >= 0:
            if self._shapes is None:
                self._shapes = ShiftedShapes.of(self.reading, self.filter)
            column = self._shapes.response(instant, duration)
            column -= self.basis @ (column @ self.basis)
            power = float(column @ column)
            return float(self.left @ self.left - float(self.left @ column) ** 2 / max(power, 1e-300))
        if not self._covers(begin, end):
            self._prepare(int(np.floor(begin)) - 2 - self.before, int(np.ceil(end)) + MARGIN + int(end - begin))
        if self._told.size:
            values = self.reading.dynamics.step_response(self._time - instant, duration=duration)
            alone = self._edge - self._first
            sizes = np.concatenate([values[:alone], self._fit @ values[alone:]])
            told, power = float(sizes @ self._told), float(sizes @ self._gram @ sizes)
        else:
            time = np.arange(self.left.size) * self.reading.interval - instant
            column = self._left_of(self.reading.dynamics.step_response(time, duration=duration)[:, None])[:, 0]
            told, power = float(self.left @ column), float(column @ column)
        return float(self.left @ self.left - told**2 / max(power, 1e-300))

    def _covers(self, begin: float, end: float) -> bool:
        starts = self._first <= begin or (self._first == 0 and self._edge > 0)
        return starts and (end <= self._edge or self._edge == self.left.size)

    def _left_of(self, columns: Array) -> Array:
        """What the known shapes leave of whitened columns (n, c)."""
        white = np.empty_like(columns)
        for first in range(0, columns.shape[1], TOGETHER):
            part = slice(first, first + TOGETHER)
            white[:, part] = self.filter.whiten(columns[:, part])
            white[:, part] -= self.basis @ (self.basis.T @ white[:, part])
        return white

    def _prepare(self, first: int, edge: int) -> None:
        """Whiten single samples from a first one to an edge, and the shapes of a free motion after it."""
        count, interval = self.left.size, self.reading.interval
        number = 1 + 2 * len(self.reading.dynamics.modes)
        first, edge = (int(np.clip(place, 0, count)) for place in (first, edge))
        edge = edge if count - edge > number else count
        self._first, self._edge = first, edge
        if edge - first > MOST_SAMPLES:
            self._told = np.zeros(0)
            return
        after = interval * np.arange(count - edge, dtype=np.float64)
        motions = [part for mode in self.reading.dynamics.modes for part in _free_motions(mode, after)]
        shapes = np.column_stack([np.ones(after.size), *motions])
        points = np.unique(np.linspace(0, after.size - 1, min(POINTS * number, after.size)).astype(int))
        alone = edge - first
        columns = np.zeros((count, alone + shapes.shape[1]))
        columns[np.arange(first, edge), np.arange(alone)] = 1.0
        columns[edge:, alone:] = shapes
        white = self._left_of(columns)
        self._fit = np.linalg.pinv(shapes[points])
        self._time = interval * np.concatenate([np.arange(first, edge), edge + points])
        self._gram, self._told = white.T @ white, white.T @ self.left


def _free_motions(mode: Mode, time: Array) -> tuple[Array, Array]:
    """Two motions of which every free motion of a mode is a sum, shape (n,) each [1; s]."""
    p, q = mode.poles
    one, other = np.exp(p * time), np.exp(q * time)
    if abs(p - q) * time[-1:].sum() < SAME_POLE:
        return one.real, (time * np.exp((p + q) / 2 * time)).real
    return (one + other).real / 2, ((one - other) / (p - q)).real
