"""Steps of the force while they ring: where one set in, how long it took, and what it looks like to the live filter.

A step is two known shapes: its response, and the change of that with its instant, which takes up what the instant is
off by and carries its uncertainty. A third one does so for the duration of a release that takes time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Final

import numpy as np

from aerobalance.channel import Array
from aerobalance.dynamics import Dynamics
from aerobalance.live_filter import KnownShape, LiveFilter
from aerobalance.steps import RAMP_EVIDENCE, Step

SHIFT: Final = 0.05
"""Change of instant or duration over which slopes are taken, in sampling intervals."""

WINDOW: Final = 8
"""Lags of readings from which a step is placed."""

TURNS: Final = 8
"""Iterations of Gauss and Newton at most."""


def shapes_of(step: Step, dynamics: Dynamics, *, interval: float) -> list[KnownShape]:
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
    live: LiveFilter, dynamics: Dynamics, start: Step, *, own: Collection[int], search: bool, ramps: bool
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
        if longer[1] - best[1] > RAMP_EVIDENCE:
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
