"""The filter of the smoother run forward for ever, with the force given out a fixed lag behind the readings.

With the gain steady, the force at a sample is the filter's prediction of it plus a weighted sum of the innovations
from that sample on. While the gain changes (at the start, around missing readings) every sample has weights of its
own. Known shapes (the constant, the responses to steps) run through the same filter and their sizes are found by
recursive generalised least squares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from aerobalance.estimation.live import _live_kernels as kernels
from aerobalance.estimation.statespace.kalman import FORCE, GAIN_TOLERANCE, StateSpace
from aerobalance.recording.channel import Array

HISTORY: Final = 16
"""Lags of readings that are kept."""

PIECE: Final = 2048
"""Samples beyond them that the buffers have room for."""

MOST_STEPS: Final = 8
"""Steps that are followed at once."""

MOST_SHAPES: Final = 1 + 3 * MOST_STEPS
"""Known shapes that there is room for: the constant, and up to three for a step."""

SCAN_LAGS: Final = 2
"""Lags back to which a step is looked for."""

YOUNGEST: Final = 3
"""Samples after which a step may be found."""

STRANGE_WINDOW: Final = 64
"""Samples over which the mean square of the residuals is watched."""

FALSE_ALARM: Final = 86_400.0
"""Time within which chance lets one step be found in a load that is as its process says [s]."""

RUNG_OUT: Final = 1e-7
"""Ringing left of a step, over its height, at which it is counted with the constant."""


@dataclass(frozen=True, slots=True)
class KnownShape:
    """A load and the force that makes it, over the time since the first sample, of a size that is to be found.

    Attributes
    ----------
    load, force
        What a size of 1 adds to load felt and force, at times [s].
    begins
        Time before which both are zero [s].
    remains
        What is left of both in the long run: 1 or 0.
    """

    load: Callable[[Array], Array]
    force: Callable[[Array], Array]
    begins: float
    remains: float


CONSTANT: Final = KnownShape(load=np.ones_like, force=np.ones_like, begins=-np.inf, remains=1.0)


def false_alarm_evidence(interval: float) -> float:
    """Gain in twice the log-likelihood that chance brings once in `FALSE_ALARM`.

    Every sample is a new instant for a step, and what speaks for an instant is renewed about four times while it is
    watched.
    """
    return float(chi2.isf(interval / (4 * FALSE_ALARM), 1))


class LiveFilter:
    """A state space with its known shapes, run over readings as they come.

    Samples are counted from the first of the whole stream.

    Parameters
    ----------
    system
        The state space; its force is the state `aerobalance.estimation.statespace.kalman.FORCE`.
    interval
        Time between samples [s].
    lag
        Samples after which the force at a sample is final.
    first
        Number of the first reading that will be fed.
    step
        Load felt 1, 2, ... samples after a force of 1 N sets in, at least `SCAN_LAGS` lags long.

    Attributes
    ----------
    jolt
        What may happen unseen while readings are missing: by how much the variances of the states grow, shape (d,).
    """

    def __init__(self, system: StateSpace, *, interval: float, lag: int, first: int, step: Array) -> None:
        self.system, self.interval, self.lag = system, interval, lag
        self.first = self.taken = self.filled = self.next_final = self._collected = first
        size = system.transition.shape[0]
        room = HISTORY * lag + PIECE
        self.shapes: list[KnownShape] = []
        self.threshold = false_alarm_evidence(interval)
        self.jolt = np.zeros(size)
        self._present = np.zeros(room, dtype=np.bool_)
        self._values, self._v, self._ahead = (np.zeros((MOST_SHAPES + 1, room)) for _ in range(3))
        self._forces = np.zeros((MOST_SHAPES, room))
        self._gain_K, self._gain_row = np.zeros((2, room, size))
        self._gain_S, self._residual, self._scores = np.zeros((3, room))
        self._out = np.zeros((room, 2))
        self._P = system.initial.copy()
        self._x = np.zeros((MOST_SHAPES + 1, size))
        self._steady_K, self._steady_S = np.zeros(size), np.zeros(1)
        self._weight, self._variance = np.zeros((2, lag + 1))
        self._information, self._root = np.zeros((2, MOST_SHAPES, MOST_SHAPES))
        self._target, self._sizes = np.zeros((2, MOST_SHAPES))
        self._counters = np.array([0, -1, -1, -1, 0, 0, 0, lag // 2], dtype=np.int64)
        self._step = np.ascontiguousarray(step[: SCAN_LAGS * lag])
        self._response, self._inverse = np.zeros((2, self._step.size))
        self._h, self._columns = system.observation, np.ascontiguousarray(system.transition.T)
        self.add(CONSTANT)

    @property
    def oldest(self) -> int:
        """Number of the oldest reading that is kept."""
        return self.first

    def room(self) -> int:
        """Readings that can be fed now."""
        used = self.filled - self.first
        keep = min(HISTORY * self.lag, self.taken - self.first)
        if used == self._present.size and self.taken - self.first > keep:
            self._forget(self.taken - keep)
        return self._present.size - (self.filled - self.first)

    def _forget(self, before: int) -> None:
        """Move what is kept to the front of the buffers."""
        shift = before - self.first
        kept = slice(shift, self.filled - self.first)
        front = slice(0, kept.stop - shift)
        for one in (
            self._present,
            self._gain_S,
            self._residual,
            self._scores,
            self._gain_K,
            self._gain_row,
            self._out,
        ):
            one[front] = one[kept].copy()
        for many in (self._values, self._v, self._ahead, self._forces):
            many[:, front] = many[:, kept].copy()
        places = [kernels.UNSTEADY, kernels.FAST, kernels.HELD, kernels.SCANNED]
        moved = self._counters[places]
        self._counters[places] = np.where(moved == kernels.FOREVER, moved, np.maximum(moved - shift, -1))
        self._counters[kernels.SCANNED] = max(int(self._counters[kernels.SCANNED]), 0)
        self.first = before

    def _time(self, first: int, stop: int) -> Array:
        return np.arange(first, stop, dtype=np.float64) * self.interval

    def feed(self, values: Array) -> None:
        """Put readings [N] into the buffers, NaN where missing; there must be `room`."""
        here = slice(self.filled - self.first, self.filled - self.first + values.size)
        self._present[here] = np.isfinite(values)
        self._values[0, here] = np.where(self._present[here], values, 0.0)
        time = self._time(self.filled, self.filled + values.size)
        for place, shape in enumerate(self.shapes):
            self._values[place + 1, here] = shape.load(time)
            self._forces[place, here] = shape.force(time)
        self.filled += values.size

    def readings(self, first: int, stop: int) -> Array:
        """Readings that were fed, NaN where missing [N]."""
        part = slice(first - self.first, stop - self.first)
        return np.where(self._present[part], self._values[0, part], np.nan)

    def run(self, stop: int, *, watch: bool = True, give: bool = True) -> int:
        """Take readings up to a number, or until something happens; say what, as in `_live_kernels`."""
        reached, happened = kernels.advance(
            self.taken - self.first,
            min(stop, self.filled) - self.first,
            self.lag,
            self.first % kernels.HOLD,
            FORCE,
            GAIN_TOLERANCE,
            len(self.shapes) + 1,
            self.system.transition,
            self._columns,
            self.system.process_noise,
            self._h,
            self.system.noise_variance,
            self._P,
            self._x,
            self._steady_K,
            self._steady_S,
            self._weight,
            self._variance,
            self._present,
            self._values,
            self._forces,
            self._v,
            self._ahead,
            self._gain_K,
            self._gain_S,
            self._gain_row,
            self._residual,
            self._information,
            self._target,
            self._sizes,
            self._root,
            self._counters,
            self._scores,
            self._step,
            self._response,
            self._inverse,
            YOUNGEST,
            self.threshold if watch else np.inf,
            STRANGE_WINDOW,
            strange_square(STRANGE_WINDOW) if watch else np.inf,
            self.lag // 4,
            self.jolt,
            self.next_final - self.first if give else int(kernels.FOREVER),
            self._out,
        )
        self.taken = reached + self.first
        if give and happened == kernels.NOTHING:
            self.next_final = max(self.next_final, self.taken - self.lag)
        elif give:
            self.next_final = max(self.next_final, self.taken - 1 - self.lag)
        return int(happened)

    def give(self, stop: int) -> None:
        """Make final what comes before a number, by the readings that were taken."""
        for k in range(self.next_final, stop):
            end = min(k + self.lag, self.taken - 1)
            self._out[k - self.first] = kernels.emit(
                k - self.first,
                end - self.first,
                self.first % kernels.HOLD,
                FORCE,
                len(self.shapes) + 1,
                self._columns,
                self._h,
                self._present,
                self._forces,
                self._v,
                self._ahead,
                self._gain_K,
                self._gain_S,
                self._gain_row,
                self._weight,
                self._variance,
                self._counters,
                self._sizes,
                self._root,
            )
        self.next_final = max(self.next_final, stop)

    def collect(self) -> tuple[int, Array, Array]:
        """Number of the first sample, force [N] and variance [N^2] of what became final since the last call."""
        begin, self._collected = self._collected, self.next_final
        part = self._out[begin - self.first : self.next_final - self.first].copy()
        return begin, part[:, 0], part[:, 1]

    def start_giving(self, at: int) -> None:
        """Let the next sample that becomes final be this one."""
        self.next_final = self._collected = at

    def add(self, shape: KnownShape) -> None:
        """Follow one more known shape, from before the readings that are kept or from an instant among them."""
        self.shapes.append(shape)
        self.replace(len(self.shapes) - 1, shape)

    def replace(self, place: int, shape: KnownShape) -> None:
        """Put a known shape in the place of another."""
        self.shapes[place] = shape
        time = self._time(self.first, self.filled)
        here = slice(0, self.filled - self.first)
        self._values[place + 1, here] = shape.load(time)
        self._forces[place, here] = shape.force(time)
        begins = max(shape.begins / self.interval, self.first)
        kernels.rebuild(
            min(int(begins), self.taken) - self.first,
            self.taken - self.first,
            len(self.shapes) + 1,
            place + 1,
            self._columns,
            self._h,
            self._x,
            FORCE,
            self._present,
            self._values,
            self._v,
            self._ahead,
            self._gain_K,
            self._gain_S,
            self._information,
            self._target,
        )
        self._solve()

    def _solve(self) -> None:
        kernels.solve(self._information, self._target, len(self.shapes), self._sizes, self._root)

    def remove(self, place: int) -> None:
        """Count a shape with the constant, or with nothing, as it has become the same in all that is not yet final."""
        count = len(self.shapes)
        turn = np.eye(count)
        turn[0, place] = -self.shapes[place].remains
        information = turn.T @ self._information[:count, :count] @ turn
        target = turn.T @ self._target[:count]
        rest = np.delete(np.arange(count), place)
        share = information[rest, place] / max(float(information[place, place]), 1e-300)
        self._information[np.ix_(rest, rest)] = information[np.ix_(rest, rest)] - np.outer(
            share, information[place, rest]
        )
        self._target[rest] = target[rest] - share * target[place]
        self.drop(place)

    def drop(self, place: int) -> None:
        """Follow a known shape no longer, as if it had never been."""
        count = len(self.shapes)
        rest = np.delete(np.arange(count), place)
        self._information[: count - 1, : count - 1] = self._information[np.ix_(rest, rest)]
        self._target[: count - 1] = self._target[rest]
        series = np.concatenate(([0], rest + 1))
        for many in (self._values, self._v, self._ahead, self._x):
            many[:count] = many[series]
        self._forces[: count - 1] = self._forces[rest]
        del self.shapes[place]
        self._solve()

    def rung_out(self, place: int) -> bool:
        """Whether a known shape has become its constant remainder in all that is not yet final."""
        shape = self.shapes[place]
        if shape.begins / self.interval >= self.next_final:
            return False
        waiting = slice(max(self.next_final - self.first, 0), self.taken - self.first)
        left = [many[place + 1, waiting] - shape.remains * many[1, waiting] for many in (self._values, self._ahead)]
        return all(float(np.max(np.abs(part), initial=0.0)) < RUNG_OUT for part in left)

    def likeliest_step(self) -> float:
        """Time at which a step is most likely to have set in [s], to a sample."""
        now = self.taken - 1 - self.first
        begin = max(int(self._counters[kernels.SCANNED]), now - self._step.size + 1)
        stop = max(now - YOUNGEST + 1, begin + 1)
        gain = self._scores[begin:stop] ** 2 * self._inverse[self._step.size - 1 - now + np.arange(begin, stop)]
        return float((begin + int(np.argmax(gain)) - 1 + self.first) * self.interval)

    def look_again(self, *, after: int) -> None:
        """Work out the residuals again with the sizes at hand, and look for steps only after a number."""
        begin = max(self.taken - self.first - max(self._step.size, STRANGE_WINDOW), 0)
        part = slice(begin, self.taken - self.first)
        count = len(self.shapes)
        left = self._v[0, part] - self._sizes[:count] @ self._v[1 : count + 1, part]
        self._residual[part] = left / np.sqrt(self._gain_S[part])
        self._counters[kernels.SCANNED] = max(after - self.first, int(self._counters[kernels.SCANNED]))
        self._counters[kernels.STRANGE_FOR] = 0

    def residuals(self, first: int, stop: int) -> tuple[Array, NDArray[np.bool_]]:
        """Normalised residuals of samples that were taken, and whether there was a reading."""
        part = slice(max(first - self.first, 0), stop - self.first)
        return self._residual[part], self._present[part]

    @property
    def innovation_variance(self) -> float:
        """Variance of the last innovation [N^2]."""
        return float(self._gain_S[max(self.taken - 1 - self.first, 0)])

    @property
    def sizes(self) -> Array:
        """Sizes of the known shapes, shape (p,)."""
        return self._sizes[: len(self.shapes)].copy()

    def size_uncertainty(self, place: int) -> float:
        """Standard uncertainty of the size of a known shape."""
        count = len(self.shapes)
        slope, work = np.eye(count)[place], np.empty(count)
        return float(np.sqrt(kernels.spread(self._root, slope, count, work)))

    def whitened(self, first: int, place: int) -> Array:
        """Readings (place -1) or a known shape, whitened, from a number to the last sample taken."""
        part = slice(first - self.first, self.taken - self.first)
        return np.asarray(self._v[place + 1, part] / np.sqrt(self._gain_S[part]))

    def whiten(self, first: int, begins: float, load: Callable[[Array], Array]) -> Array:
        """A load that is zero before a time [s], whitened, from a number to the last sample taken."""
        begin = int(np.clip(begins / self.interval, first, self.taken))
        values = load(self._time(begin, self.taken))
        white = np.zeros(self.taken - first)
        white[begin - first :] = kernels.innovate(
            begin - self.first,
            self.taken - self.first,
            self._columns,
            self._h,
            self._present,
            values,
            self._gain_K,
        )
        return white / np.sqrt(self._gain_S[first - self.first : self.taken - self.first])


def strange_square(count: int) -> float:
    """Sum of squares of residuals that chance does not reach: eight times its scatter over its mean."""
    return count * (1 + 8 * float(np.sqrt(2 / count)))
