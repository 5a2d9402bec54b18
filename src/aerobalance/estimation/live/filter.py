"""Kalman filter on a stream, with a fixed-lag smoother: the force is final a fixed number of samples later.

While the gain is constant, the smoothed force at a sample is its prediction plus a weighted sum of the innovations
from that sample on. While the gain changes (at the start, around missing observations) each sample has its own
weights. Known shapes (the constant, the responses to steps) pass through the same filter, and their sizes are
estimated by recursive generalised least squares.

Here are the buffers, the known shapes and the scan for steps; `_live_kernels` computes, and `component_smoother` says
when. Loads and forces are in N, and in N*m for a moment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from aerobalance.estimation.live import _live_kernels as kernels
from aerobalance.estimation.statespace.kalman import FORCE, StateSpace
from aerobalance.recording.channel import Array

GAIN_TOLERANCE: Final = 1e-8
"""Relative change of the covariance in one sample below which the filter's gain is frozen."""

HISTORY: Final = 16
"""Observations that the buffers keep, in lags."""

PIECE: Final = 2048
"""Samples that the buffers have room for beyond those of `HISTORY`."""

MOST_STEPS: Final = 8
"""Largest number of steps that are estimated at the same time."""

MOST_SHAPES: Final = 1 + 3 * MOST_STEPS
"""Largest number of known shapes: the constant, and up to three for a step."""

SCAN_LAGS: Final = 2
"""Age up to which a step is looked for, in lags."""


@dataclass(frozen=True, slots=True)
class WatchSettings:
    """Thresholds for the detection of steps and of observations that the model does not explain.

    Attributes
    ----------
    false_alarm
        Mean time between false steps in a load that is as its spectral prior says [s].
    youngest
        Age from which a step may be found [samples].
    window
        Number of residuals whose sum of squares is tested.
    ended
        Part of the response to a step, over its height, below which it has settled and joins the constant [1].
    """

    false_alarm: float = 86_400.0
    youngest: int = 3
    window: int = 64
    ended: float = 1e-7


SETTINGS: Final = WatchSettings()
"""The thresholds in use."""


@dataclass(frozen=True, slots=True)
class KnownShape:
    """A balance load and the force that makes it, known functions of time but for their size, which is estimated.

    Attributes
    ----------
    load, force
        Balance load and force of a size of 1 [N], at times since the first sample of the stream [s].
    begins
        Time before which both are zero [s].
    remains
        What both tend to in the long run, 1 or 0 [N].
    """

    load: Callable[[Array], Array]
    force: Callable[[Array], Array]
    begins: float
    remains: float


CONSTANT: Final = KnownShape(load=np.ones_like, force=np.ones_like, begins=-np.inf, remains=1.0)
"""The mean of load and force; the spectral prior is of what departs from it."""


def false_alarm_evidence(interval: float) -> float:
    """Return the gain in twice the log-likelihood [1] that chance exceeds once in `WatchSettings.false_alarm`.

    Every sample, `interval` [s] after the last, is a new instant for a step, and its test statistic takes about four
    independent values while it is within the scan.
    """
    return float(chdtri(1, interval / (4 * SETTINGS.false_alarm)))


class LiveFilter:
    """A Kalman filter with its known shapes and its fixed-lag smoother, run over observations as they come.

    Samples are counted from the first of the whole stream; in the buffers they are counted from `first`.

    Parameters
    ----------
    system
        The state space; its force is the state `aerobalance.estimation.statespace.kalman.FORCE`.
    interval
        Time between samples [s].
    lag
        Samples after which the force at a sample is final.
    first
        Number of the first observation that will be fed.
    step
        Balance load 1, 2, ... samples after a force of 1 N sets in, at least `SCAN_LAGS` lags long [N].
    """

    def __init__(self, system: StateSpace, *, interval: float, lag: int, first: int, step: Array) -> None:
        self.system, self.interval, self.lag = system, interval, lag
        self.first = self.taken = self.filled = self.next_final = self._collected = first
        self.shapes: list[KnownShape] = []
        size, room = system.transition.shape[0], HISTORY * lag + PIECE
        series = MOST_SHAPES + 1  # series 0 is the observations, series 1 + p the known shape p
        self._model = system.model
        self._marks = np.zeros(1, dtype=kernels.MARKS).view(np.recarray)
        self._state = kernels.State(
            marks=self._marks,
            x=np.zeros((series, size)),
            P=system.initial.copy(),
            K=np.zeros(size),
            inflation=np.zeros(size),
            work=np.zeros((3, size, size)),
        )
        self._history = kernels.History(
            present=np.zeros(room, dtype=np.bool_),
            values=np.zeros((series, room)),
            forces=np.zeros((MOST_SHAPES, room)),
            v=np.zeros((series, room)),
            predicted=np.zeros((series, room)),
            K=np.zeros((room, size)),
            S=np.zeros(room),
            P=np.zeros((room, size)),
            residual=np.zeros(room),
            score=np.zeros(room),
        )
        self._fit = kernels.ShapeFit(
            information=np.zeros((MOST_SHAPES, MOST_SHAPES)),
            target=np.zeros(MOST_SHAPES),
            sizes=np.zeros(MOST_SHAPES),
            root=np.zeros((MOST_SHAPES, MOST_SHAPES)),
        )
        self._fixed = kernels.FixedLag(
            lag=lag,
            wanted=FORCE,
            tolerance=GAIN_TOLERANCE,
            weight=np.zeros(lag + 1),
            variance=np.zeros(lag + 1),
            out=np.zeros((room, 2)),
        )
        watched = np.ascontiguousarray(step[: SCAN_LAGS * lag])
        self._scan = kernels.LiveScan(
            step=watched,
            response=np.zeros(watched.size),
            inverse=np.zeros(watched.size),
            threshold=false_alarm_evidence(interval),
            youngest=SETTINGS.youngest,
            strange=strange_square(SETTINGS.window),
            window=SETTINGS.window,
            patience=lag // 4,
        )
        marks = self._marks[0]
        marks.unsteady = marks.fast = marks.held = -1  # not yet: before the first sample
        marks.expected, marks.phase = lag // 2, first % kernels.HOLD
        self.add(CONSTANT)

    @property
    def threshold(self) -> float:
        """Gain in twice the log-likelihood above which a step is likely [1]; it may be set."""
        return self._scan.threshold

    @threshold.setter
    def threshold(self, value: float) -> None:
        self._scan = self._scan._replace(threshold=value)

    @property
    def inflation(self) -> Array:
        """Covariance inflation: what the variances of the states grow by after a gap, shape (d,); set it in place."""
        return self._state.inflation

    @property
    def oldest(self) -> int:
        """Number of the oldest observation in the buffers."""
        return self.first

    def room(self) -> int:
        """Return how many observations can be fed now; full buffers drop what is older than `HISTORY`."""
        used = self.filled - self.first
        keep = min(HISTORY * self.lag, self.taken - self.first)
        if used == self._history.present.size and self.taken - self.first > keep:
            self._forget(self.taken - keep)
        return self._history.present.size - (self.filled - self.first)

    def _forget(self, before: int) -> None:
        """Drop the observations before a sample, and move what is kept to the front of the buffers."""
        shift = before - self.first
        room = self._history.present.size
        kept = slice(shift, self.filled - self.first)
        front = slice(0, kept.stop - shift)
        for array in (*self._history, self._fixed.out):
            by_sample = array if array.shape[0] == room else array.T  # some have the samples as their last axis
            by_sample[front] = by_sample[kept].copy()
        marks = self._marks[0]
        marks.unsteady, marks.fast = max(marks.unsteady - shift, -1), max(marks.fast - shift, -1)
        marks.held = marks.held if marks.held == kernels.FOREVER else max(marks.held - shift, -1)
        marks.scanned = max(marks.scanned - shift, 0)
        marks.phase = before % kernels.HOLD
        self.first = before

    def _time(self, first: int, stop: int) -> Array:
        """Times of samples since the first of the stream, shape (stop - first,) [s]."""
        return np.arange(first, stop, dtype=np.float64) * self.interval

    def feed(self, values: Array) -> None:
        """Put observations, shape (n,) [N], into the buffers, NaN where missing; there must be `room` for them."""
        here = slice(self.filled - self.first, self.filled - self.first + values.size)
        self._history.present[here] = np.isfinite(values)
        self._history.values[0, here] = np.where(self._history.present[here], values, 0.0)
        time = self._time(self.filled, self.filled + values.size)
        for place, shape in enumerate(self.shapes):
            self._history.values[place + 1, here] = shape.load(time)
            self._history.forces[place, here] = shape.force(time)
        self.filled += values.size

    def readings(self, first: int, stop: int) -> Array:
        """Return the observations from sample `first` to before `stop`, NaN where missing, shape (n,) [N]."""
        part = slice(first - self.first, stop - self.first)
        return np.where(self._history.present[part], self._history.values[0, part], np.nan)

    def run(self, stop: int, *, watch: bool = True, give: bool = True) -> int:
        """Filter observations up to a sample, or until an event; return the event: NOTHING, STEP or STRANGE.

        Parameters
        ----------
        stop
            Number of the first sample that is not taken.
        watch
            Whether to look for events.
        give
            Whether to make forces final on the way, those a lag behind.
        """
        reached, happened = kernels.advance(
            self.taken - self.first,
            min(stop, self.filled) - self.first,
            self.next_final - self.first if give else kernels.FOREVER,
            self._model,
            self._state,
            self._history,
            self._fit,
            self._fixed,
            self._scan if watch else self._scan._replace(threshold=np.inf, strange=np.inf),
        )
        self.taken = reached + self.first
        # at an event the force that would become final by its sample is left open, until the caller has answered it
        if give and happened == kernels.NOTHING:
            self.next_final = max(self.next_final, self.taken - self.lag)
        elif give:
            self.next_final = max(self.next_final, self.taken - 1 - self.lag)
        return int(happened)

    def give(self, stop: int) -> None:
        """Make the forces before sample `stop` final, with the observations taken so far, even if less than a lag."""
        for k in range(self.next_final, stop):
            end = min(k + self.lag, self.taken - 1)
            kernels.emit(
                k - self.first, end - self.first, self._model, self._state, self._history, self._fit, self._fixed
            )
        self.next_final = max(self.next_final, stop)

    def collect(self) -> tuple[int, Array, Array]:
        """Return number of the first sample, forces [N] and variances [N^2], (n,), final since the last call."""
        begin, self._collected = self._collected, self.next_final
        part = self._fixed.out[begin - self.first : self.next_final - self.first].copy()
        return begin, part[:, 0], part[:, 1]

    def start_giving(self, at: int) -> None:
        """Set the next sample whose force becomes final; those before it are never returned."""
        self.next_final = self._collected = at

    def add(self, shape: KnownShape) -> None:
        """Follow one more known shape; it may begin before the observations that are kept, or among them."""
        self.shapes.append(shape)
        self.replace(len(self.shapes) - 1, shape)

    def replace(self, place: int, shape: KnownShape) -> None:
        """Put a known shape in the place of another, as if it had been followed from its beginning."""
        self.shapes[place] = shape
        self._marks[0].series = len(self.shapes) + 1
        time = self._time(self.first, self.filled)
        here = slice(0, self.filled - self.first)
        self._history.values[place + 1, here] = shape.load(time)
        self._history.forces[place, here] = shape.force(time)
        begins = max(shape.begins / self.interval, self.first)
        kernels.rebuild(
            min(int(begins), self.taken) - self.first,
            self.taken - self.first,
            place + 1,
            self._model,
            self._state,
            self._history,
            self._fit,
            FORCE,
        )
        self._solve()

    def _solve(self) -> None:
        """Solve the normal equations for the sizes of the known shapes."""
        kernels.solve(self._fit, len(self.shapes))

    def remove(self, place: int) -> None:
        """Remove a known shape that is constant in all samples that are not yet final; the fit keeps its information.

        The constant becomes constant plus what the shape `remains`; then the shape's own size is eliminated from the
        normal equations, by their Schur complement, as it says nothing of the samples to come.
        """
        count = len(self.shapes)
        # sizes = change @ new sizes: the new constant is the old one plus what the shape leaves of itself
        change = np.eye(count)
        change[0, place] = -self.shapes[place].remains
        information = change.T @ self._fit.information[:count, :count] @ change
        target = change.T @ self._fit.target[:count]
        rest = np.delete(np.arange(count), place)
        factor = information[rest, place] / max(float(information[place, place]), 1e-300)
        self._fit.information[np.ix_(rest, rest)] = information[np.ix_(rest, rest)] - np.outer(
            factor, information[place, rest]
        )
        self._fit.target[rest] = target[rest] - factor * target[place]
        self.drop(place)

    def drop(self, place: int) -> None:
        """Remove a known shape as if it had never been estimated: its size is taken as zero."""
        count = len(self.shapes)
        rest = np.delete(np.arange(count), place)
        self._fit.information[: count - 1, : count - 1] = self._fit.information[np.ix_(rest, rest)]
        self._fit.target[: count - 1] = self._fit.target[rest]
        series = np.concatenate(([0], rest + 1))
        for array in (self._history.values, self._history.v, self._history.predicted, self._state.x):
            array[:count] = array[series]
        self._history.forces[: count - 1] = self._history.forces[rest]
        del self.shapes[place]
        self._marks[0].series = len(self.shapes) + 1
        self._solve()

    def rung_out(self, place: int) -> bool:
        """Return whether a known shape has settled: it is constant in all samples that are not yet final."""
        shape = self.shapes[place]
        if shape.begins / self.interval >= self.next_final:
            return False
        waiting = slice(max(self.next_final - self.first, 0), self.taken - self.first)
        # series 1 is the constant, of size 1
        transient = [
            array[place + 1, waiting] - shape.remains * array[1, waiting]
            for array in (self._history.values, self._history.predicted)
        ]
        return all(float(np.max(np.abs(part), initial=0.0)) < SETTINGS.ended for part in transient)

    def likeliest_step(self) -> float:
        """Return the instant of a sample at which a step is most likely [s]."""
        now = self.taken - 1 - self.first
        begin = max(int(self._marks[0].scanned), now - self._scan.step.size + 1)
        stop = max(now - SETTINGS.youngest + 1, begin + 1)
        gain = (
            self._history.score[begin:stop] ** 2
            * self._scan.inverse[self._scan.step.size - 1 - now + np.arange(begin, stop)]
        )
        # a score begins with the first sample that the step moves, one after its instant
        return float((begin + int(np.argmax(gain)) - 1 + self.first) * self.interval)

    def look_again(self, *, after: int) -> None:
        """Compute the latest residuals again with the present sizes, and look for steps from `after` on only."""
        begin = max(self.taken - self.first - max(self._scan.step.size, SETTINGS.window), 0)
        part = slice(begin, self.taken - self.first)
        count = len(self.shapes)
        innovations = self._history.v[0, part] - self._fit.sizes[:count] @ self._history.v[1 : count + 1, part]
        self._history.residual[part] = innovations / np.sqrt(self._history.S[part])
        marks = self._marks[0]
        marks.scanned, marks.strange = max(after - self.first, marks.scanned), 0

    def residuals(self, first: int, stop: int) -> tuple[Array, NDArray[np.bool_]]:
        """Return normalised residuals [1] from sample `first` to before `stop`, and where observations are."""
        part = slice(max(first - self.first, 0), stop - self.first)
        return self._history.residual[part], self._history.present[part]

    @property
    def innovation_variance(self) -> float:
        """Variance of the last innovation [N^2]."""
        return float(self._history.S[max(self.taken - 1 - self.first, 0)])

    @property
    def sizes(self) -> Array:
        """Estimated sizes of the known shapes, the constant first, shape (p,) [1]."""
        return self._fit.sizes[: len(self.shapes)].copy()

    def whitened(self, first: int, place: int) -> Array:
        """Return the whitened observations (place -1) or known shape, from `first` to the last sample taken [1]."""
        part = slice(first - self.first, self.taken - self.first)
        return np.asarray(self._history.v[place + 1, part] / np.sqrt(self._history.S[part]))

    def whiten(self, first: int, begins: float, load: Callable[[Array], Array]) -> Array:
        """Return a load that is zero before `begins` [s], whitened, from `first` to the last sample taken [1]."""
        begin = int(np.clip(begins / self.interval, first, self.taken))
        values = load(self._time(begin, self.taken))
        white = np.zeros(self.taken - first)
        white[begin - first :] = kernels.innovate(begin - self.first, values, self._model, self._history)
        return white / np.sqrt(self._history.S[first - self.first : self.taken - self.first])


def strange_square(count: int) -> float:
    """Return a sum of squares of `count` normalised residuals that chance does not reach [1].

    It is the mean and eight standard deviations.
    """
    return count * (1 + 8 * float(np.sqrt(2 / count)))
