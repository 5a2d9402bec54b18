"""The likelihood of a step at any instant of a part of a record, from a few whitened columns.

After a step of the force, the response of the balance is a constant and free motions of its modes, whatever the
instant was; during a ramp, a straight line is added. So every response is a linear combination of these few shapes,
beginning at the samples at which the change begins and ends. The steady-state filter is time-invariant: the shapes are
whitened once and shifted, and the transient of the initial state is subtracted. Beside gaps a response is a linear
combination of unit impulses, for as long as the force may be changing, and of the shapes from then on, all whitened
together; each instant and duration tried then takes a quadratic form of some thirty numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from aerobalance.dynamics.modal import Mode, exponentials
from aerobalance.estimation.least_squares import take_out
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.steps import Step, response_to
from aerobalance.recording.channel import Array
from aerobalance.recording.linalg import sums_of_products

MARGIN: Final = 28
"""Samples after the last instant expected in which the force may still change: the longest ramp tried and more."""

MOST_SAMPLES: Final = 512
"""Largest number of samples in which the force may be changing for which unit impulses are whitened; beyond it each
response is whitened by itself."""

POINTS: Final = 16
"""Number of samples at which the shapes are fitted to a response, over the number of shapes."""

SAME_POLE: Final = 1e-4
"""Difference of the two poles of a mode times the length of the window, below which they are a double pole [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class ShiftedShapes:
    """A constant, a straight line and free motions that begin at a sample, whitened by a filter without gaps.

    Attributes
    ----------
    reading
        The part of a record in which a step is sought.
    whitened
        The shapes that begin at the first sample, whitened by the steady-state filter, shape (s, n); those that begin
        later are these, shifted.
    times
        Instants at which the shapes are fitted to a response, from its first sample on, shape (p,) [s].
    fit
        Matrix that gives the coefficients of the shapes from the response at `times`, shape (s, p).
    start
        Orthonormal directions of the unknown initial state in the first m whitened readings, shape (r, m).
    lost
        Share of each direction that is lost, as the initial state explains it as well, shape (r,) [1].
    """

    reading: Observation
    whitened: Array
    times: Array
    fit: Array
    start: Array
    lost: Array

    @classmethod
    def of(cls, reading: Observation, filter_: KalmanFilter) -> ShiftedShapes:
        """Return the shapes for a reading and its filter."""
        count = reading.values.size
        time = reading.interval * np.arange(count, dtype=np.float64)
        motions = [part for mode in reading.dynamics.modes for part in free_motions(mode, time)]
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
        else:  # a ramp is the difference of two that do not end within the window
            self._add(column, instant, 2 * whole, size=2 * whole / duration)
            self._add(column, instant + duration, 2 * whole, size=-2 * whole / duration)
        early = column[: self.start.shape[1]]
        early -= (self.lost * (self.start @ early)) @ self.start
        return column

    def _add(self, column: Array, instant: float, duration: float, *, size: float) -> None:
        """Add the response to a step, or to a ramp that does not end within the window, of a size [N]."""
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
        Its Kalman filter.
    basis
        Orthonormal basis of the whitened known shapes, shape (n, q).
    left
        Residuals of the whitened readings without the known shapes, shape (n,).
    before
        Samples before the first instant tried in which further instants may be tried.
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
        """Return the window of a reading, with free coefficients of the known shapes in `columns`, shape (n, q)."""
        white = filter_.whiten(np.column_stack([reading.filled, columns]))
        basis, _ = np.linalg.qr(white[:, 1:])
        return cls(reading, filter_, basis, white[:, 0] - basis @ sums_of_products(basis, white[:, 0]), before)

    def squares(self, instant: float, duration: float) -> float:
        """Return the sum of squared whitened residuals with a step of the best height [1].

        Parameters
        ----------
        instant, duration
            When the force begins to change, and for how long [s].
        """
        if self.reading.decimated > 1:  # beside a change, the response of the decimation filter is not a free motion
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
        """Residuals of columns, whitened and without the known shapes, shape (n, c)."""
        white = self.filter.whiten(columns)
        take_out(self.basis, white)
        return white

    def _prepare(self, first: int, edge: int) -> None:
        """Whiten unit impulses at samples `first` to `edge` (excluded), and the shapes that begin at `edge`."""
        count, interval = self.left.size, self.reading.interval
        number = 1 + 2 * len(self.reading.dynamics.modes)
        first, edge = (int(np.clip(place, 0, count)) for place in (first, edge))
        edge = edge if count - edge > number else count
        self._first, self._edge = first, edge
        if edge - first > MOST_SAMPLES:
            self._told = np.zeros(0)
            return
        after = interval * np.arange(count - edge, dtype=np.float64)
        motions = [part for mode in self.reading.dynamics.modes for part in free_motions(mode, after)]
        shapes = np.column_stack([np.ones(after.size), *motions])
        points = np.unique(np.linspace(0, after.size - 1, min(POINTS * number, after.size)).astype(int))
        alone = edge - first
        columns = np.zeros((count, alone + shapes.shape[1]))
        columns[np.arange(first, edge), np.arange(alone)] = 1.0
        columns[edge:, alone:] = shapes
        white = self._left_of(columns)
        self._fit = np.linalg.pinv(shapes[points])
        self._time = interval * np.concatenate([np.arange(first, edge), edge + points])
        self._gram, self._told = sums_of_products(white, white), sums_of_products(white, self.left)


def free_motions(mode: Mode, time: Array) -> tuple[Array, Array]:
    """Two motions whose linear combinations are all free motions of a mode, shape (n,) each [1; s]."""
    p, q = mode.poles
    one = exponentials(p, time)
    if abs(p - q) * time[-1:].sum() < SAME_POLE:
        return one.real, (time * np.exp((p + q) / 2 * time)).real
    if q == p.conjugate():
        return one.real, one.imag / p.imag
    other = np.exp(q * time)
    return (one + other).real / 2, ((one - other) / (p - q)).real
