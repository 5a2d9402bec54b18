r"""What the start of a record and the gaps in it do to the Kalman filter, beside its steady state.

Long after the start the covariance is the steady one, P. Before that it is larger, and so it is after a gap: P + L L',
never smaller. So the state is one of covariance P, plus L c with some numbers c of variance 1 that the readings tell
[deJong1991]_. The gain stays the steady one, and what the few numbers c do dies away with the filter's memory.

References
----------
.. [deJong1991] P. de Jong, "The diffuse Kalman filter", Ann. Statist. 19 (1991) 1073.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.statespace.blocks import BLOCK
from aerobalance.estimation.statespace.steady_state import SteadyState, joined, root_of
from aerobalance.recording.channel import Array

FORGOTTEN: Final = 1e-7
"""Departure of a state, over its steady standard deviation, that makes no difference."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Samples with readings, after a gap (which may be empty).

    Attributes
    ----------
    gap, first, stop
        The first sample of the gap, the first one with a reading, and the one after the last.
    before
        Root of what the covariance at the first sample of the gap has beyond the steady one, shape (d, any).
    start
        L at the first reading, shape (d, r); its columns are seen as orthogonal ones.
    seen
        How much of each is in the readings of the stretch, over their noise, shape (r,).
    memory
        Samples after which c makes no difference any more: whole blocks, or all samples of the stretch.
    end
        Root of what the covariance after the last sample has beyond the steady one, shape (d, r or 0).
    """

    gap: int
    first: int
    stop: int
    before: Array
    start: Array
    seen: Array
    memory: int
    end: Array

    @property
    def gap_length(self) -> int:
        """Number of missing readings before the stretch."""
        return self.first - self.gap


@dataclass(slots=True, eq=False)
class Planner:
    """Finds the stretches of a record.

    Attributes
    ----------
    steady
        The steady filter.
    initial
        Covariance of the first state, shape (d, d), in the coordinates of that filter.
    """

    steady: SteadyState
    initial: Array
    _powers: list[Array] = field(init=False)
    _seen: list[Array] = field(init=False)

    def __post_init__(self) -> None:
        self._powers = [self.steady.closed_loop]
        self._seen = [self.steady.model.h[None] / np.sqrt(self.steady.variance)]

    def stretches(self, present: NDArray[np.bool_]) -> tuple[Stretch, ...]:
        """Return the stretches of a record in their order; the last one is empty if it ends with a gap."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], present, [False]]).astype(np.int8)))
        found = []
        gap, before = 0, self._without_faint(root_of(self.initial - self.steady.covariance))
        for first, stop in edges.reshape(-1, 2).tolist():
            one = self._stretch(gap, first, stop, before)
            gap, before = stop, one.end
            found.append(one)
        if gap < present.size or not found:
            found.append(self._stretch(gap, present.size, present.size, before))
        return tuple(found)

    def growth(self, samples: int) -> Array:
        """Root of what the covariance grows by over samples without readings, beyond the steady one, (d, any)."""
        A, fresh = self.steady.model.A, (np.sqrt(self.steady.variance) * self.steady.entry)[:, None]
        roots = np.zeros((A.shape[0], 0))
        while samples:
            if samples % 2:
                roots = joined(fresh, A @ roots)
            fresh, A, samples = joined(fresh, A @ fresh), A @ A, samples // 2
        return roots

    def seen_by(self, samples: int, columns: Array) -> Array:
        """Return R with R' R what so many readings show of columns (d, r), over their noise; shape (any, r)."""
        parts = []
        for place in range(samples.bit_length()):
            if samples >> place & 1:
                self._extend(place)
                parts.append(self._seen[place] @ columns)
                columns = self._powers[place] @ columns
        return np.vstack(parts) if parts else np.zeros((0, columns.shape[1]))

    def after(self, samples: int, columns: Array) -> Array:
        """Return what columns (d, r) have become after so many readings."""
        for place in range(samples.bit_length()):
            if samples >> place & 1:
                self._extend(place)
                columns = self._powers[place] @ columns
        return columns

    def told_by(self, samples: int, later: Array) -> Array:
        """Return R with R' R what so many readings tell of the state before them, and what later ones do (any, d)."""
        seen = self.seen_by(samples, np.eye(self.steady.model.h.size))
        for place in range(samples.bit_length()):
            if samples >> place & 1:
                later = later @ self._powers[place]
        return joined(np.vstack([seen, later]).T).T

    def roots_of_mean(self, rows: Array, places: int) -> list[Array]:
        """Return for 1, 2, 4, ... samples R with R' R the mean square that rows (any, d) make of the state."""
        roots = [rows]
        for place in range(places):
            self._extend(place)
            half = roots[-1] * np.sqrt(0.5)
            roots.append(joined(half.T, (half @ self._powers[place]).T).T)
        return roots

    def is_faint(self, columns: Array) -> bool:
        """Whether columns (d, r) make no difference."""
        return not np.max(np.abs(columns), initial=0.0) > FORGOTTEN

    def memory(self, samples: int, columns: Array) -> int:
        """Return after how many of these samples columns (d, r) make no difference: whole blocks, or all samples."""
        if self.is_faint(columns):
            return 0
        highest = samples.bit_length() - 1
        passed = 0
        for place in range(highest, -1, -1):
            if passed + (1 << place) <= samples:
                self._extend(place)
                later = self._powers[place] @ columns
                if not self.is_faint(later):
                    columns, passed = later, passed + (1 << place)
        return min(-(-(passed + 1) // BLOCK) * BLOCK, samples)

    def _stretch(self, gap: int, first: int, stop: int, before: Array) -> Stretch:
        missing, count = first - gap, stop - first
        start = before
        if missing:
            kept = np.linalg.matrix_power(self.steady.model.A, missing) @ before
            start = self._without_faint(joined(kept, self.growth(missing)))
        memory = self.memory(count, start)
        if not memory:
            none = np.zeros((start.shape[0], 0))
            return Stretch(gap, first, stop, before, none if count else start, np.zeros(0), 0, none)
        _, seen, turned = np.linalg.svd(self.seen_by(memory, start), full_matrices=True)
        start = start @ turned.T
        seen = np.concatenate([seen, np.zeros(start.shape[1] - seen.size)])
        end = self.after(memory, start)
        end = np.zeros((start.shape[0], 0)) if self.is_faint(end) else end / np.sqrt(1 + seen**2)
        return Stretch(gap, first, stop, before, start, seen, memory, end)

    def _without_faint(self, columns: Array) -> Array:
        """The same covariance by as few columns as make a difference."""
        left, size, _ = np.linalg.svd(columns, full_matrices=False)
        kept = size > FORGOTTEN
        return np.asarray(left[:, kept] * size[kept])

    def _extend(self, place: int) -> None:
        """Make the tables of powers 2^0, 2^1, ... reach to a place."""
        while len(self._powers) <= place:
            power, seen = self._powers[-1], self._seen[-1]
            power = np.where(np.abs(power) < 1e-150, 0.0, power)  # its square would be too small for quick arithmetic
            self._seen.append(joined(seen.T, (seen @ power).T).T)
            self._powers.append(power @ power)
