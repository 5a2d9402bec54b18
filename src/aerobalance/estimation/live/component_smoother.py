"""The force of one decoupled channel, by the smoother with a fixed lag: block by block, the same for every chunking.

The flow of a block of readings::

    readings -> RecentReadings (to learn from)
             -> LiveFilter.feed -> LiveFilter.run up to the next mark -> final samples
                                       |  a mark is a sample at which something is to be done:
                                       |  a step is placed again, the state of health is drawn up,
                                       |  the wide band is set anew, the spectral prior is learned;
                                       |  or the filter stops by itself at a step, or at strange residuals
                                       v
                                  answer, and go on

What the force is taken for (`StreamState.process`): ``"start-up"`` -> learned -> ``"learned"`` -> residuals that are
not explained -> ``"fallback"`` -> learned again. Marks are counted from the first reading, so that nothing hangs on
how the readings come cut. There is no clock, no file and no thread.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.live import _live_kernels as kernels
from aerobalance.estimation.live.filter import HISTORY, PIECE, SCAN_LAGS, LiveFilter, false_alarm_evidence
from aerobalance.estimation.live.health import (
    SHORTEST,
    STRETCH,
    Health,
    Learning,
    Process,
    Snapshot,
    Watch,
    wide_process,
)
from aerobalance.estimation.live.recent_readings import RecentReadings
from aerobalance.estimation.live.settings import SmootherSettings
from aerobalance.estimation.live.steps import STEP_LAGS, Followed, Following, place_step
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.statespace.kalman import FORCE, LOAD, LOAD_RATE
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

FEWEST: Final = 8
"""Readings that noise and strength of the load are judged from at least."""

WIDE_DOUBT: Final = 2.0
"""Evidence that a step needs while nothing is learned, over what it needs else: the noise is hardly known."""

FEW_STEPS: Final = 2
"""Steps within the time of `STEP_LAGS` that are taken for steps."""


class FinalSamples(NamedTuple):
    """Samples that have become final: number of the first, force [N] and its variance [N^2], shape (m,)."""

    first: int
    force: Array
    variance: Array


@dataclass(slots=True, eq=False)
class StreamState:
    """Where a stream stands; numbers of samples count from its first reading.

    Attributes
    ----------
    process
        What the force is taken for.
    learning
        What was learned, where it is `process`.
    filter
        The filter; None before there are readings enough to begin.
    start, begin
        Number of the first reading that it began with, before which there is no force, and these readings.
    learn_from, learn_at
        First reading to learn from, and sample at which to; None for no more.
    due
        Whether it is time to learn, which is done elsewhere.
    wide_from, wide_since, widen_at
        Sample before which the wide band is not fallen back on again, since which the force is taken for one, and at
        which its strength is judged anew.
    placed_at
        Sample at which strange residuals last had the steps placed again.
    """

    process: Process
    learning: Learning | None
    learn_at: int | None
    widen_at: int
    filter: LiveFilter | None = None
    start: int = 0
    begin: Array = field(default_factory=lambda: np.zeros(0))
    learn_from: int = 0
    due: bool = False
    wide_from: int = 0
    wide_since: int = 0
    placed_at: int = 0


class ComponentSmoother:
    """The force of one decoupled channel, live.

    Parameters
    ----------
    dynamics
        The balance whose readings these are.
    settings
        How they are smoothed.

    Attributes
    ----------
    state
        Where the stream stands.
    """

    def __init__(self, dynamics: ModalModel, settings: SmootherSettings) -> None:
        self.dynamics, self.settings = dynamics, settings
        learned = settings.learned
        if learned is not None and learned.color is not None:
            raise ValueError(
                "the live estimator takes the noise of a reading as white; learned must come from a record without "
                "colored noise"
            )
        if settings.lag < SHORTEST:
            raise ValueError(
                f"the force would be made from {settings.lag} samples after each; at least {SHORTEST} are needed: "
                "make the lag longer"
            )
        self.state = StreamState(
            process="start-up" if learned is None else "learned",
            learning=None if learned is None else Learning(learned, (), 0, 0),
            learn_at=settings.first_learning if learned is None else None,
            widen_at=settings.settling,
        )
        self._recent = RecentReadings(settings.learned_from + PIECE)
        self._steps = Following(dynamics, interval=settings.interval)
        self._watch = Watch(dynamics, interval=settings.interval)

    # ---- readings in, force out

    def push(self, readings: Array, *, last: bool = False) -> FinalSamples:
        """Return the samples that have become final by more readings.

        Parameters
        ----------
        readings
            Readings of the channel, shape (m,), any number of them [N, N*m]; NaN where missing.
        last
            Whether these are the last: then all samples become final, without a force where there were never readings
            enough to begin.
        """
        state = self.state
        self._recent.append(readings)
        parts: list[tuple[Array, Array]] = []
        if state.filter is None:
            readings = self._recent.between(state.start, self._recent.stop)
            most, wanted = self.settings.learned_from, self.settings.lag // 2
            enough = _reached(readings, wanted, most=most)
            if not enough and last and _reached(readings, FEWEST, most=readings.size):
                enough = readings.size
            # what is older than the readings that it begins with has no force, and nothing if it never begins
            skipped = readings.size if last and not enough else max((enough or readings.size) - most, 0)
            nothing = np.full(skipped, np.nan)
            parts.append((nothing, nothing))
            if skipped:
                self._start_at(state.start + skipped)
            if not enough:
                return self._final(parts)
            readings = readings[skipped:]
            state.begin = readings[: enough - skipped]
            state.filter = self._made(state.begin, first=state.start)
        while readings.size and state.filter is not None:
            count = min(state.filter.room(), readings.size)
            state.filter.feed(readings[:count])
            readings = readings[count:]
            while state.filter.taken < state.filter.filled:
                self._advance(state.filter, parts)
        if last:
            state.filter.give(state.filter.taken)
            self._collect(state.filter, parts)
        return self._final(parts)

    def _start_at(self, start: int) -> None:
        """Begin with a later reading, from which all marks are counted then."""
        state, settings = self.state, self.settings
        state.start = state.learn_from = state.wide_since = start
        state.widen_at = start + settings.settling
        state.learn_at = start + settings.first_learning if state.learning is None else None

    def _final(self, parts: list[tuple[Array, Array]]) -> FinalSamples:
        force, variance = (np.concatenate([np.zeros(0), *(part[which] for part in parts)]) for which in (0, 1))
        end = self.state.start if self.state.filter is None else self.state.filter.next_final
        return FinalSamples(end - force.size, force, variance)

    def _advance(self, live: LiveFilter, parts: list[tuple[Array, Array]]) -> None:
        """Take readings up to the next mark, and do what there is to do."""
        state, lag = self.state, self.settings.lag
        # from the first readings the noise is not known well enough to tell what is strange
        watch = state.learning is not None or live.taken >= state.start + self.settings.settling
        happened = live.run(self._next_mark(live), watch=watch)
        self._collect(live, parts)
        if happened == kernels.STEP:
            self._take_up_step(live)
        elif happened == kernels.STRANGE:
            self._answer_strangeness(live)
        if happened != kernels.NOTHING and state.filter is not None:
            state.filter.give(state.filter.taken - lag)
            self._collect(state.filter, parts)
        for one in self._steps.ringing_on:
            if state.filter is live and live.taken == one.again:
                self._steps.place_again(live, one, lag=lag)
        if state.filter is live and live.taken % STRETCH == 0:
            self._draw_up(live)
        if state.filter is live and state.learning is None and live.taken == state.widen_at:
            state.widen_at = state.wide_since + 4 * (state.widen_at - state.wide_since)
            self._change_process(live)
        if state.filter is not None and state.learn_at is not None and state.filter.taken >= state.learn_at:
            self._time_to_learn(state.filter.taken)

    def _next_mark(self, live: LiveFilter) -> int:
        """The next sample at which there is something to do."""
        state = self.state
        marks = [live.filled, (live.taken // STRETCH + 1) * STRETCH, *(one.again for one in self._steps.ringing_on)]
        if state.learn_at is not None:
            marks.append(state.learn_at)
        if state.learning is None:
            marks.append(state.widen_at)
        return min(mark for mark in marks if mark > live.taken)

    def _collect(self, live: LiveFilter, parts: list[tuple[Array, Array]]) -> None:
        """Put by what became final, with the doubt on which side of a step the samples beside it lie."""
        begin, force, variance = live.collect()
        parts.append((force, variance + self._steps.doubt(begin, force.size)))

    # ---- steps

    @property
    def steps(self) -> tuple[Step, ...]:
        """Steps of the force that were found, instants since the first reading [s]."""
        return self._steps.all

    def _take_up_step(self, live: LiveFilter) -> None:
        lag = self.settings.lag
        young = self._steps.young(live.taken, lag=lag)
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
        live.look_again(after=live.taken + lag // 4)

    # ---- what the force is taken for

    def _made(self, values: Array, *, first: int) -> LiveFilter:
        """The filter of the process at hand; the readings tell how far the balance may swing when it starts."""
        if np.count_nonzero(np.isfinite(values)) < FEWEST:
            values = self.state.begin  # a long gap
        reading = self._reading(values)
        learning = self.state.learning
        learned = learning.learned if learning else wide_process(reading, frequency=self.settings.highest)
        later = (np.arange(SCAN_LAGS * self.settings.lag) + 1) * self.settings.interval
        live = LiveFilter(
            reading.system(learned),
            interval=self.settings.interval,
            lag=self.settings.lag,
            first=first,
            step=self.dynamics.step_response(later),
        )
        if self.settings.free_after_gap:
            further = FORCE + learned.shaping.order
            live.inflation[[LOAD, LOAD_RATE]] = reading.swing**2
            live.inflation[further : further + 2 * len(self.dynamics.further_modes)] = reading.swing**2
        self._set_evidence(live)
        return live

    def _set_evidence(self, live: LiveFilter) -> None:
        """What has to speak for a step: the more, the less well the readings are explained without."""
        doubt = max(1.0, self._watch.mean_square) * (1.0 if self.state.learning else WIDE_DOUBT)
        live.threshold = doubt * false_alarm_evidence(self.settings.interval)

    def _change_process(self, live: LiveFilter) -> None:
        """Run the last readings through the filter of the process at hand, and go on with it."""
        start = max(live.oldest, live.taken - HISTORY * self.settings.lag)
        values = live.readings(start, live.filled)
        fresh = self._made(values[: live.taken - start], first=start)
        fresh.feed(values)
        fresh.run(live.taken, watch=False, give=False)
        fresh.start_giving(live.next_final)
        kept = self._steps.move(fresh, since=start + 2)
        # what was not explained before may have been a step
        fresh.look_again(after=fresh.taken if kept else fresh.taken - self.settings.lag)
        self.state.filter = fresh

    def _answer_strangeness(self, live: LiveFilter) -> None:
        """Readings are not explained: place the steps again that still ring, or else fall back on a wide band."""
        state, lag = self.state, self.settings.lag
        young = self._steps.young(live.taken, lag=lag)
        if young and live.taken > state.placed_at + STEP_LAGS * lag:
            state.placed_at = live.taken
            for one in young:
                self._steps.place_again(live, one, lag=lag)
        else:
            self._fall_back(live)

    def _fall_back(self, live: LiveFilter, *, without: Collection[Followed] = ()) -> None:
        """Take the force for a wide band, of a strength judged anew, and some steps for a part of it."""
        state, lag = self.state, self.settings.lag
        if live.taken < state.wide_from:
            live.look_again(after=live.taken)
            return
        state.wide_since = live.taken
        state.wide_from = state.widen_at = live.taken + 2 * lag
        self._steps.take_back(without)
        if state.learning is not None:
            state.learning, state.process, state.due = None, "fallback", False
            state.learn_from = max(live.taken - lag, state.start)
            state.learn_at = live.taken + self.settings.first_learning
        self._change_process(live)

    # ---- learning

    def _reading(self, values: Array) -> Observation:
        return Observation(values, self.settings.interval, self.dynamics, self.settings.input_noise)

    def snapshot(self) -> Snapshot:
        """Return the last readings; `Snapshot.learn` may run elsewhere, its result goes to `adopt`.

        Raises
        ------
        FitError
            There are too few readings yet.
        """
        taken = 0 if self.state.filter is None else self.state.filter.taken
        first = max(self.state.learn_from, taken - self.settings.learned_from)
        values = self._recent.between(first, taken)
        if np.count_nonzero(np.isfinite(values)) < 2 * SHORTEST:
            raise FitError(
                f"{values.size} readings so far; learning the force's process needs at least {2 * SHORTEST}"
            )
        return Snapshot(self._reading(values), first)

    def adopt(self, learning: Learning) -> None:
        """Go on with what was learned; it holds for all samples that are not final yet.

        Call it where `push` is called, between two pushes.

        Raises
        ------
        ValueError
            No reading was pushed yet.
        """
        state = self.state
        if state.filter is None:
            raise ValueError("too few readings were pushed; give the process when the LiveForce is made")
        state.learning, state.process = learning, "learned"
        self._change_process(state.filter)
        self._steps.add_new(state.filter, learning.steps)
        state.filter.look_again(after=state.filter.taken)

    def _time_to_learn(self, taken: int) -> None:
        """Learn, or say that it is time to; next when there are twice as many readings, until there are enough."""
        state = self.state
        count = taken - state.learn_from
        state.learn_at = taken + count if count < self.settings.last_learning else None
        if not self.settings.learn_inside:
            state.due = True
            return
        try:
            self.adopt(self.snapshot().learn())
        except FitError:
            state.learn_at = taken + self.settings.first_learning

    def due(self) -> Snapshot | None:
        """Return the readings to learn from where it is time to, once; None else."""
        if not self.state.due:
            return None
        self.state.due = False
        try:
            return self.snapshot()
        except FitError:
            taken = 0 if self.state.filter is None else self.state.filter.taken
            self.state.learn_at = taken + self.settings.first_learning
            return None

    # ---- health

    def _draw_up(self, live: LiveFilter) -> None:
        """State of health from the last stretch; a step that no longer rings is counted with the constant."""
        self._watch.look(*live.residuals(live.taken - STRETCH, live.taken), stop=live.taken)
        self._set_evidence(live)
        if self.settings.free_after_gap:
            values = live.readings(max(live.oldest, live.taken - STRETCH), live.taken)
            known = values[np.isfinite(values)]
            largest = float(np.ptp(known)) ** 2 if known.size else 0.0
            live.inflation[live.inflation > 0] = max(float(live.inflation.max()), largest)
        self._steps.let_go(live)

    def health(self, *, samples: int, missing: int, saturated: int) -> Health:
        """Return the state of health at the last stretch that is complete, with what is counted of the readings."""
        live, learning = self.state.filter, self.state.learning
        noise = now = float("nan")
        if live is not None:
            noise = float(np.sqrt(live.system.noise_variance))
            now = float(np.sqrt(max(noise**2 + live.innovation_variance * (self._watch.mean_square - 1), 0.0)))
        return Health(
            process=self.state.process,
            learned_from=(learning.first, learning.stop) if learning and learning.stop else None,
            samples=samples,
            missing=missing,
            saturated=saturated,
            mean_square=self._watch.mean_square,
            resonance=self._watch.resonance,
            noise=noise,
            noise_now=now,
        )


def _reached(values: Array, wanted: int, *, most: int) -> int:
    """Samples from the first until so many of the last `most` are present; 0 if they never are."""
    present = np.cumsum(np.isfinite(values))
    before = np.concatenate([np.zeros(min(most, values.size), dtype=present.dtype), present])[: values.size]
    reached = np.flatnonzero(present - before >= wanted)
    return int(reached[0]) + 1 if reached.size else 0
