"""The force while the readings come in: Eq. (17) of [Gorbushin2020]_ by the smoother with a fixed lag, chunk by chunk.

No clock, no file, no thread: what is pushed in comes out a fixed number of samples later, the same for any chunking.
Learning takes longer than a sample may; `LiveForce.snapshot` and `LiveForce.adopt` let the caller do it elsewhere.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Final

import numpy as np

from aerobalance.dynamics.single import PARAMETERS, Dynamics
from aerobalance.estimation.live import _live_kernels as kernels
from aerobalance.estimation.live.filter import HISTORY, PIECE, SCAN_LAGS, LiveFilter, false_alarm_evidence
from aerobalance.estimation.live.health import (
    SHORTEST,
    STRETCH,
    Health,
    Learning,
    LiveEstimate,
    Process,
    Snapshot,
    Watch,
    wide_process,
)
from aerobalance.estimation.live.motion import LiveReadings, RecentReadings
from aerobalance.estimation.live.steps import STEP_LAGS, Followed, Following, place_step
from aerobalance.estimation.prior import Observation, SpectralPrior
from aerobalance.estimation.statespace.kalman import FORCE, LOAD, LOAD_RATE
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import FitError

LAG_PERIODS: Final = 5.0
"""Periods of the natural frequency that the force lags the readings, unless said otherwise."""

FEWEST: Final = 8
"""Readings that noise and strength of the load are judged from at least."""

WIDE_DOUBT: Final = 2.0
"""Evidence that a step needs while nothing is learned, over what it needs else: the noise is hardly known."""

FEW_STEPS: Final = 2
"""Steps within the time of `STEP_LAGS` that are taken for steps."""


class LiveForce:
    """The force of one component, live.

    Parameters
    ----------
    dynamics
        Mass, stiffness and damping, with their covariance.
    interval
        Time between samples [s].
    learned
        Process of the force and noise of a reading, from an earlier record, the noise white; None to begin with a wide
        band and learn from the readings.
    noise
        Standard uncertainty of a reading [N]; None when it is to be learned.
    lag
        Time after which the force at a sample is final [s]; `LAG_PERIODS` periods of the natural frequency if None.
    limit
        Load at which the channel saturates [N]; such readings count as missing.
    learn_after
        Time after which the process is learned within `push`, and again when twice, four times ... as many readings
        are there, up to `span` [s]. None leaves it to the caller.
    span
        Longest stretch of readings that is learned from [s].
    ground_noise
        Standard uncertainty of a sample of the ground's specific force, white [m/s^2].
    ground_delay
        Time by which the load channel lags the ground channel beside the delay of the dynamics [s].
    gravity
        Local acceleration of gravity [m/s^2].
    jolted
        Whether a free oscillation that nothing explains may have begun wherever readings are missing.
    highest
        Natural frequency up to which, and somewhat beyond, the force is taken to reach while nothing is learned [Hz];
        the balance's own if None.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        *,
        interval: float,
        learned: SpectralPrior | None = None,
        noise: float | None = None,
        lag: float | None = None,
        limit: float = np.inf,
        learn_after: float | None = 2.0,
        span: float = 10.0,
        ground_noise: float = 0.0,
        ground_delay: float = 0.0,
        gravity: float = STANDARD_GRAVITY,
        jolted: bool = False,
        highest: float | None = None,
    ) -> None:
        if not 0 < interval < np.inf:
            raise ValueError(f"interval must be positive and finite, not {interval}")
        if learned is not None and learned.color is not None:
            raise ValueError(
                "the live estimator takes the noise of a reading as white; learned must come from a record without "
                "colored noise"
            )
        self.dynamics, self.interval = dynamics, interval
        time = LAG_PERIODS / dynamics.natural_frequency if lag is None else lag
        self.latency = round(time / interval)
        if self.latency < SHORTEST:
            raise ValueError(f"a lag of {time:g} s is {self.latency} samples; at least {SHORTEST} are needed")
        self._noise, self._jolted = noise, jolted
        self._highest = dynamics.natural_frequency if highest is None else highest
        self._input_density = (dynamics.mass * ground_noise) ** 2 * interval
        self._readings = LiveReadings(dynamics, interval=interval, limit=limit, delay=ground_delay, gravity=gravity)
        self._learning: Learning | None = None if learned is None else Learning(learned, (), 0, 0)
        self._process: Process = "start-up" if learned is None else "learned"
        self._auto = None if learn_after is None else max(round(learn_after / interval), 64)
        self._learn_at = self._auto if learned is None else None
        self._span = round(span / interval)
        self._recent, self._learn_from = RecentReadings(self._span + PIECE), 0
        self._begin = np.zeros(0)
        self._filter: LiveFilter | None = None
        self._wide_again = self._placed_for = 0
        self._widen_at = 2 * self.latency
        self._steps = Following(dynamics, interval=interval)
        self._watch, self._ended = Watch(dynamics, interval=interval), False

    # ---- readings in, force out

    def push(
        self,
        readings: Array,
        *,
        ground_acceleration: Array | None = None,
        pitch: Array | None = None,
        roll: Array | None = None,
    ) -> LiveEstimate:
        """Take readings; return what has become final by them.

        Parameters
        ----------
        readings
            Load felt, shape (m,) [N], any number of samples; NaN where missing.
        ground_acceleration
            x1'' of the same samples [m/s^2], given with every push or with none. A dc-coupled sensor reads gravity
            too: then no pitch is given.
        pitch, roll
            Angles of the same samples [rad].

        Raises
        ------
        ValueError
            The channels differ in length, or the stream is finished.
        """
        if self._ended:
            raise ValueError("the stream is finished; make a new LiveForce")
        values = np.ascontiguousarray(readings, dtype=np.float64)
        ready = self._readings.push(values, acceleration=ground_acceleration, pitch=pitch, roll=roll)
        return self._take(ready)

    def finish(self) -> LiveEstimate:
        """End the stream; return the samples that were still waiting, by all readings."""
        self._ended = True
        return self._take(self._readings.finish(), last=True)

    @property
    def lag(self) -> int:
        """Samples after a sample that its force is made from: `latency` less what the ground's motion waits for."""
        return self.latency - self._readings.ahead

    def _take(self, values: Array, *, last: bool = False) -> LiveEstimate:
        """Run readings and hand out what is final."""
        if self.lag < SHORTEST:
            raise ValueError(
                f"a lag of {self.latency} samples is too short: the motion of the ground needs "
                f"{self.latency - self.lag} of them and the force {SHORTEST}"
            )
        self._recent.append(values)
        parts: list[tuple[Array, Array]] = []
        if self._filter is None:
            values = self._recent.between(0, self._recent.stop)
            enough = _reached(values, self.lag // 2) or (last and _reached(values, FEWEST) and values.size)
            if not enough:
                return self._final(parts)
            self._begin = values[:enough]
            self._filter = self._made(self._begin, first=0)
        self._feed(values, parts)
        if last:
            self._filter.give(self._filter.taken)
            self._collect(parts)
        return self._final(parts)

    def _final(self, parts: list[tuple[Array, Array]]) -> LiveEstimate:
        """What is handed out, with what mass, stiffness and damping add to its uncertainty."""
        force, variance = (np.concatenate([np.zeros(0), *(part[which] for part in parts)]) for which in (0, 1))
        load, motion, load_rate = self._readings.release(force.size)
        d = self.dynamics
        net = force - d.mass * motion
        pull = net - np.where(np.isfinite(load), load, net)  # b AF' + M AF'', Eq. (8)
        acceleration = pull / d.mass * d.stiffness - 2 * d.decay_rate * load_rate
        slopes = [acceleration / d.stiffness + motion, -pull / d.stiffness, load_rate / d.stiffness]
        J = np.column_stack([*slopes, np.zeros(force.size)])
        own = d.covariance[: len(PARAMETERS), : len(PARAMETERS)]
        variance = variance + np.maximum(np.sum((J @ own) * J, axis=1), 0.0)
        end = 0 if self._filter is None else self._filter.next_final
        return LiveEstimate(end - force.size, force, np.sqrt(variance), load)

    def _feed(self, values: Array, parts: list[tuple[Array, Array]]) -> None:
        while values.size and self._filter is not None:
            count = min(self._filter.room(), values.size)
            self._filter.feed(values[:count])
            values = values[count:]
            while self._filter.taken < self._filter.filled:
                self._run(self._filter, parts)

    def _run(self, live: LiveFilter, parts: list[tuple[Array, Array]]) -> None:
        """Take readings up to the next sample at which there is something to do, and do it.

        These samples are counted from the first reading, so that nothing hangs on how the readings are chunked.
        """
        marks = [live.filled, (live.taken // STRETCH + 1) * STRETCH, *(one.again for one in self._steps.ringing_on)]
        if self._learn_at is not None:
            marks.append(self._learn_at)
        if self._learning is None:
            marks.append(self._widen_at)
        # from the first readings the noise is not known well enough to tell what is strange
        watch = self._learning is not None or live.taken >= 2 * self.latency
        happened = live.run(min(mark for mark in marks if mark > live.taken), watch=watch)
        self._collect(parts)
        if happened == kernels.STEP:
            self._take_up_step(live)
        elif happened == kernels.STRANGE:
            self._answer_strangeness(live)
        if happened != kernels.NOTHING and self._filter is not None:
            self._filter.give(self._filter.taken - self.lag)
            self._collect(parts)
        for one in self._steps.ringing_on:
            if self._filter is live and live.taken == one.again:
                self._steps.place_again(live, one, lag=self.lag)
        if self._filter is live and live.taken % STRETCH == 0:
            self._draw_up(live)
        if self._filter is live and self._learning is None and live.taken == self._widen_at:
            self._widen_at *= 4
            self._change_process(live)
        if self._filter is not None and self._learn_at is not None and self._filter.taken >= self._learn_at:
            self._learn_alone(self._filter.taken)

    def _collect(self, parts: list[tuple[Array, Array]]) -> None:
        """Put by what became final, with the doubt on which side of a step the samples beside it lie."""
        if self._filter is None:
            return
        begin, force, variance = self._filter.collect()
        parts.append((force, variance + self._steps.doubt(begin, force.size)))

    # ---- steps

    @property
    def steps(self) -> tuple[Step, ...]:
        """Steps of the force that were found, instants since the first reading [s]."""
        return self._steps.all

    def _take_up_step(self, live: LiveFilter) -> None:
        young = self._steps.young(live.taken, lag=self.lag)
        if len(young) >= FEW_STEPS or self._steps.full:
            # so many so soon are a load that fluctuates, not steps
            self._fall_back(live, without=young)
            return
        guess = Step(live.likeliest_step(), 0.0)
        step, evidence = place_step(live, self.dynamics, guess, own=(), search=True, ramps=False)
        if evidence < live.threshold:
            live.look_again(after=live.taken)
            return
        self._steps.follow(live, replace(step, evidence=evidence))
        live.look_again(after=live.taken + self.lag // 4)

    # ---- what the force is taken for

    def _made(self, values: Array, *, first: int) -> LiveFilter:
        """The filter of the process at hand; the readings tell how far the balance may swing when it starts."""
        if np.count_nonzero(np.isfinite(values)) < FEWEST:
            values = self._begin  # a long gap
        reading = Observation(values, self.interval, self.dynamics, self._input_density, self._noise)
        learned = self._learning.learned if self._learning else wide_process(reading, frequency=self._highest)
        later = (np.arange(SCAN_LAGS * self.lag) + 1) * self.interval
        live = LiveFilter(
            reading.system(learned),
            interval=self.interval,
            lag=self.lag,
            first=first,
            step=self.dynamics.step_response(later),
        )
        if self._jolted:
            further = FORCE + learned.shaping.order
            live.jolt[[LOAD, LOAD_RATE]] = reading.swing**2
            live.jolt[further : further + 2 * len(self.dynamics.further_modes)] = reading.swing**2
        self._set_evidence(live)
        return live

    def _set_evidence(self, live: LiveFilter) -> None:
        """What has to speak for a step: the more, the less well the readings are explained without."""
        doubt = max(1.0, self._watch.mean_square) * (1.0 if self._learning else WIDE_DOUBT)
        live.threshold = doubt * false_alarm_evidence(self.interval)

    def _change_process(self, live: LiveFilter) -> None:
        """Run the last readings through the filter of the process at hand, and go on with it."""
        start = max(0, live.taken - HISTORY * self.lag)
        values = live.readings(start, live.filled)
        fresh = self._made(values[: live.taken - start], first=start)
        fresh.feed(values)
        fresh.run(live.taken, watch=False, give=False)
        fresh.start_giving(live.next_final)
        kept = self._steps.move(fresh, since=start + 2)
        # what was not explained before may have been a step
        fresh.look_again(after=fresh.taken if kept else fresh.taken - self.lag)
        self._filter = fresh

    def _answer_strangeness(self, live: LiveFilter) -> None:
        """Readings are not explained: place the steps again that still ring, or else fall back on a wide band."""
        young = self._steps.young(live.taken, lag=self.lag)
        if young and live.taken > self._placed_for + STEP_LAGS * self.lag:
            self._placed_for = live.taken
            for one in young:
                self._steps.place_again(live, one, lag=self.lag)
        else:
            self._fall_back(live)

    def _fall_back(self, live: LiveFilter, *, without: Collection[Followed] = ()) -> None:
        """Take the force for a wide band, of a strength judged anew, and some steps for a part of it."""
        if live.taken < self._wide_again:
            live.look_again(after=live.taken)
            return
        self._wide_again = self._widen_at = live.taken + 2 * self.lag
        self._steps.take_back(without)
        if self._learning is not None:
            self._learning, self._process = None, "fallback"
            self._learn_from = max(live.taken - self.lag, 0)
            self._learn_at = None if self._auto is None else live.taken + self._auto
        self._change_process(live)

    def snapshot(self) -> Snapshot:
        """The last readings; `Snapshot.learn` may run in another thread, its result goes to `adopt`.

        Raises
        ------
        FitError
            There are too few readings yet.
        """
        taken = 0 if self._filter is None else self._filter.taken
        first = max(self._learn_from, taken - self._span)
        values = self._recent.between(first, taken)
        if np.count_nonzero(np.isfinite(values)) < 2 * SHORTEST:
            raise FitError(
                f"{values.size} readings so far; learning the force's process needs at least {2 * SHORTEST}"
            )
        return Snapshot(Observation(values, self.interval, self.dynamics, self._input_density, self._noise), first)

    def adopt(self, learning: Learning) -> None:
        """Go on with a process that was learned; it holds for all samples that are not final yet.

        Call it where `push` is called, between two pushes.

        Raises
        ------
        ValueError
            No reading was pushed yet.
        """
        if self._filter is None:
            raise ValueError("too few readings were pushed; give the process when the LiveForce is made")
        self._learning, self._process = learning, "learned"
        self._change_process(self._filter)
        self._steps.add_new(self._filter, learning.steps)
        self._filter.look_again(after=self._filter.taken)

    def relearn(self) -> None:
        """Learn from the last readings and go on with that; takes as long as it takes."""
        self.adopt(self.snapshot().learn())

    def _learn_alone(self, taken: int) -> None:
        """Learn within the stream; next when there are twice as many readings, until there are `span`."""
        count = taken - self._learn_from
        self._learn_at = taken + count if self._auto is not None and count < self._span else None
        try:
            self.relearn()
        except FitError:
            self._learn_at = taken + (self._auto or STRETCH)

    # ---- health

    def _draw_up(self, live: LiveFilter) -> None:
        """State of health from the last stretch; a step that no longer rings is counted with the constant."""
        self._watch.look(*live.residuals(live.taken - STRETCH, live.taken), stop=live.taken)
        self._set_evidence(live)
        if self._jolted:
            values = live.readings(max(live.oldest, live.taken - STRETCH), live.taken)
            known = values[np.isfinite(values)]
            largest = float(np.ptp(known)) ** 2 if known.size else 0.0
            live.jolt[live.jolt > 0] = max(float(live.jolt.max()), largest)
        self._steps.let_go(live)

    @property
    def health(self) -> Health:
        """State of health at the last stretch that is complete."""
        live, learning = self._filter, self._learning
        noise = now = float("nan")
        if live is not None:
            noise = float(np.sqrt(live.system.noise_variance))
            now = float(np.sqrt(max(noise**2 + live.innovation_variance * (self._watch.mean_square - 1), 0.0)))
        return Health(
            process=self._process,
            learned_from=(learning.first, learning.stop) if learning and learning.stop else None,
            samples=self._readings.samples,
            missing=self._readings.missing,
            saturated=self._readings.saturated,
            mean_square=self._watch.mean_square,
            resonance=self._watch.resonance,
            noise=noise,
            noise_now=now,
        )


def _reached(values: Array, wanted: int) -> int:
    """Samples from the first until so many of them are present; 0 if there are not so many."""
    place = int(np.searchsorted(np.cumsum(np.isfinite(values)), wanted))
    return place + 1 if place < values.size else 0
