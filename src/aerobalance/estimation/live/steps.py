"""Steps of the force while they ring: where one set in, how long it took, and what it looks like to the live filter.

A step is two known shapes: its response, and the change of that with its instant, which takes up what the instant is
off by and carries its uncertainty. A third one does so for the duration of a release that takes time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.live import _live_kernels as kernels
from aerobalance.estimation.live.filter import MOST_STEPS, KnownShape, LiveFilter
from aerobalance.estimation.steps import SETTINGS as SEARCH
from aerobalance.estimation.steps import Step, side_variance
from aerobalance.recording.channel import Array

SHIFT: Final = 0.05
"""Change of instant or duration over which slopes are taken, in sampling intervals."""

WINDOW: Final = 8
"""Lags of readings from which a step is placed."""

TURNS: Final = 8
"""Iterations of Gauss and Newton at most."""

STEP_LAGS: Final = 4
"""Lags after which a step is no longer placed again."""


@dataclass(slots=True, eq=False)
class Followed:
    """A step that still rings, its shapes in the filter, and the sample at which it is placed again."""

    step: Step
    shapes: list[KnownShape]
    again: int

    def places(self, live: LiveFilter) -> list[int]:
        """Where its shapes are in the filter."""
        return [place for place, shape in enumerate(live.shapes) if any(shape is mine for mine in self.shapes)]


class Following:
    """The steps of one stream: those that ring on are known shapes of its filter, of the others there is a list.

    Parameters
    ----------
    dynamics
        The balance.
    interval
        Time between samples [s].
    """

    def __init__(self, dynamics: ModalModel, *, interval: float) -> None:
        self._dynamics, self._interval = dynamics, interval
        self._followed: list[Followed] = []
        self._past: list[Step] = []

    @property
    def all(self) -> tuple[Step, ...]:
        """Every step, instants since the first reading [s]."""
        return (*self._past, *(one.step for one in self._followed))

    @property
    def ringing_on(self) -> tuple[Followed, ...]:
        """Those that the filter follows."""
        return tuple(self._followed)

    @property
    def full(self) -> bool:
        """Whether the filter has no room for another."""
        return len(self._followed) == MOST_STEPS

    def young(self, taken: int, *, lag: int) -> list[Followed]:
        """Steps so young, by the samples taken, that they are still placed."""
        oldest = (taken - STEP_LAGS * lag) * self._interval
        return [one for one in self._followed if one.step.instant > oldest]

    def doubt(self, first: int, count: int) -> Array:
        """Mean square error of the force at samples that may lie on the other side of a step, (count,) [N^2]."""
        time: Array = (first + np.arange(count, dtype=np.float64)) * self._interval
        variance = np.zeros(count)
        for step in (one.step for one in self._followed):
            variance += side_variance(step, time, height=step.height, interval=self._interval)
        return variance

    def follow(self, live: LiveFilter, step: Step) -> None:
        """Put a step into the filter."""
        shapes = shapes_of(step, self._dynamics, interval=self._interval)
        for shape in shapes:
            live.add(shape)
        self._followed.append(Followed(step, shapes, again=live.taken + 4))

    def place_again(self, live: LiveFilter, one: Followed, *, lag: int) -> None:
        """Place a step again, now that more readings tell of it; the next time when there are twice as many."""
        age = live.taken - one.step.instant / self._interval
        own = one.places(live)
        step, evidence = place_step(live, self._dynamics, one.step, own=own, search=age < lag / 2, ramps=True)
        one.step = replace(step, evidence=evidence)
        shapes = shapes_of(one.step, self._dynamics, interval=self._interval)
        if len(shapes) == len(own):
            for place, shape in zip(own, shapes, strict=True):
                live.replace(place, shape)
        else:
            for place in reversed(own):
                live.drop(place)
            for shape in shapes:
                live.add(shape)
        one.shapes = shapes
        one.again = live.taken + max(round(age), 4) if age < STEP_LAGS * lag else kernels.FOREVER
        live.look_again(after=0)

    def move(self, fresh: LiveFilter, *, since: int) -> bool:
        """Go on in another filter with the steps after a sample; whether there are any."""
        kept = [one for one in self._followed if one.step.instant > since * self._interval]
        self._past += [one.step for one in self._followed if one not in kept]
        self._followed = kept
        for one in kept:
            for shape in one.shapes:
                fresh.add(shape)
        return bool(kept)

    def take_back(self, steps: Collection[Followed]) -> None:
        """Forget steps as if they had never been, before the filter is changed."""
        self._followed = [one for one in self._followed if one not in steps]

    def add_new(self, live: LiveFilter, steps: Collection[Step]) -> None:
        """Follow those of some steps that are not known yet and lie within the readings kept."""
        near = 1 / self._dynamics.natural_frequency
        for step in steps:
            known = any(abs(step.instant - other.step.instant) < near for other in self._followed)
            if step.instant > (live.oldest + 2) * self._interval and not known and not self.full:
                # it may have been let go while the readings that show it are still kept
                self._past = [other for other in self._past if abs(step.instant - other.instant) >= near]
                self.follow(live, step)

    def let_go(self, live: LiveFilter) -> None:
        """Count steps that no longer ring with the constant."""
        for one in self.ringing_on:
            places = one.places(live)
            if all(live.rung_out(place) for place in places):
                for place in reversed(places):
                    live.remove(place)
                self._past.append(one.step)
                self._followed.remove(one)


def shapes_of(step: Step, dynamics: ModalModel, *, interval: float) -> list[KnownShape]:
    """What the live filter follows of a step: 1 N of it, and its changes by a sampling interval of time."""
    small = SHIFT * interval

    def load(early: float, longer: float) -> Callable[[Array], Array]:
        instant, duration = step.instant + early, step.duration + longer
        return lambda time: dynamics.step_response(time - instant, duration=duration)

    def force(early: float, longer: float) -> Callable[[Array], Array]:
        instant, duration = step.instant + early, step.duration + longer
        if step.duration <= 0:
            # a pure step has no slope: the samples beside it are settled by the sign of the time alone
            return lambda time: (time >= step.instant).astype(np.float64)
        return lambda time: np.clip((time - instant) / duration, 0.0, 1.0)

    def slope(kind: Callable[[float, float], Callable[[Array], Array]], *by: float) -> Callable[[Array], Array]:
        more, less = kind(*by), kind(*(-one for one in by))
        return lambda time: (more(time) - less(time)) / (2 * SHIFT)

    shapes = [KnownShape(load(0, 0), force(0, 0), step.instant, 1.0)]
    ways = [(small, 0.0), (0.0, small)] if step.duration > 0 else [(small, 0.0)]
    return shapes + [KnownShape(slope(load, *way), slope(force, *way), step.instant - small, 0.0) for way in ways]


def place_step(
    live: LiveFilter, dynamics: ModalModel, start: Step, *, own: Collection[int], search: bool, ramps: bool
) -> tuple[Step, float]:
    """Instant, duration and height of a step from the readings that the filter has taken, and twice its likelihood.

    Parameters
    ----------
    live
        The filter.
    dynamics
        The balance.
    start
        Instant and duration to begin with.
    own
        Places of the step's own shapes in the filter.
    search
        Whether the instant is known to a few samples only.
    ramps
        Whether a release that takes time is tried.
    """
    interval = live.interval
    first = max(live.oldest, live.taken - WINDOW * live.lag)
    others = [live.whitened(first, place) for place in range(len(live.shapes)) if place not in own]
    basis, _ = np.linalg.qr(np.column_stack(others))
    wanted = live.whitened(first, -1)
    wanted = wanted - basis @ (basis.T @ wanted)

    def column(instant: float, duration: float) -> Array:
        white = live.whiten(first, instant, lambda time: dynamics.step_response(time - instant, duration=duration))
        return np.asarray(white - basis @ (basis.T @ white))

    def gain(instant: float, duration: float) -> float:
        white = column(instant, duration)
        return float((wanted @ white) ** 2 / max(float(white @ white), 1e-300))

    instant = start.instant
    if search:
        grid = start.instant + interval * np.arange(-4.0, 2.25, 0.25)
        instant = float(grid[np.argmax([gain(one, 0.0) for one in grid])])
    best = _settled(column, wanted, instant, 0.0, interval=interval)
    if ramps:
        known = [start.duration] if start.duration > 0 else [2 * interval, 8 * interval]
        middle = best[0].instant
        trials = [
            _settled(column, wanted, middle - duration / 2, duration, interval=interval)
            for duration in known
            if middle - duration / 2 > first * interval
        ]
        longer = max(trials, key=lambda trial: trial[1], default=best)
        if longer[1] - best[1] > SEARCH.ramp_evidence:
            best = longer
    return best


def _settled(
    column: Callable[[float, float], Array], wanted: Array, instant: float, duration: float, *, interval: float
) -> tuple[Step, float]:
    """The most likely step near an instant and a duration, by Gauss and Newton; a duration of zero is kept."""
    small = SHIFT * interval
    ramp = duration > 0
    for _ in range(TURNS):
        white = column(instant, duration)
        slopes = [(column(instant + small, duration) - column(instant - small, duration)) / (2 * small)]
        if ramp:
            slopes.append((column(instant, duration + small) - column(instant, duration - small)) / (2 * small))
        J = np.column_stack([white, *slopes])
        scale = np.sqrt(np.sum(J**2, axis=0)) + 1e-300
        sizes, *_ = np.linalg.lstsq(J / scale, wanted, rcond=1e-6)
        sizes = sizes / scale
        height = float(sizes[0]) or 1e-300
        moves = np.clip(sizes[1:] / height, -interval, interval)
        instant += float(moves[0])
        if ramp:
            duration = max(duration + float(moves[1]), 2 * small)
        if np.abs(moves).max() < 1e-4 * interval:
            break
    white = column(instant, duration)
    square = max(float(white @ white), 1e-300)
    height = float(wanted @ white) / square
    slope = (column(instant + small, duration) - column(instant - small, duration)) / (2 * small)
    across = float(slope @ slope) - float(slope @ white) ** 2 / square
    alone = square - float(slope @ white) ** 2 / max(float(slope @ slope), 1e-300)
    step = Step(
        instant=instant,
        duration=duration,
        height=height,
        instant_uncertainty=1 / max(float(np.sqrt(max(across, 0.0))) * abs(height), 1e-300),
        height_uncertainty=1 / float(np.sqrt(max(alone, 1e-300))),
    )
    return step, height**2 * square
