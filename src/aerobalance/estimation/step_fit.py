"""Instant, duration and height of steps that are known to a sample: one in a part of a record, or all together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from aerobalance.estimation.prior import Observation, generalised_least_squares
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.step_window import StepWindow
from aerobalance.estimation.steps import SETTINGS, Step, columns_of, response_to, ringing_time
from aerobalance.recording.channel import Array

STILL: Final = (1e-3, 1e-2)
"""Move in sampling intervals after which an instant stands still at least and at most: a tenth of its uncertainty."""


def refine_step(
    reading: Observation, filter_: KalmanFilter, others: Sequence[Step], step: Step, *, ramps: bool
) -> Step:
    """Return a step, located to a sample before, with instant, duration, height and their uncertainties.

    Parameters
    ----------
    reading
        The record.
    filter_
        Its filter under some prior.
    others
        The other steps; they keep their instants.
    step
        The step.
    ramps
        Whether it may have a duration.
    """
    count, interval = reading.values.size, reading.interval
    length = int(np.clip(2 * ringing_time(reading) / interval, *SETTINGS.window))
    first = int(np.clip(step.instant / interval - length // 2, 0, max(count - length, 0)))
    local = replace(reading, values=reading.values[first : first + length])
    filter_ = filter_.over(local.present)
    origin = first * interval
    fixed = _columns_within(local, others, origin=origin)
    window = StepWindow.of(local, filter_, fixed)

    def squares(instant: float, duration: float) -> float:
        return window.squares(instant - origin, duration)

    begin, end = step.instant - 1.5 * interval, step.instant + step.duration + 1.5 * interval
    grid = np.arange(begin, end, max(0.25 * interval, (end - begin) / SETTINGS.grid))
    coarse = float(grid[np.argmin([squares(instant, 0.0) for instant in grid])])
    sharp = minimize_scalar(
        squares,
        bounds=(coarse - 0.3 * interval, coarse + 0.3 * interval),
        args=(0.0,),
        options={"xatol": 1e-4 * interval},
    )
    instant, duration = float(sharp.x), 0.0
    if ramps:
        instant, duration = _fit_ramp(squares, instant, enough=sharp.fun - SETTINGS.ramp_evidence, interval=interval)
    found = Step(instant - origin, duration)
    columns = np.column_stack([fixed, response_to(found, local), _derivative(found, local, later=0.05 * interval)])
    _, covariance, _ = generalised_least_squares(filter_, local.filled, columns)
    height = float(generalised_least_squares(filter_, local.filled, columns[:, :-1])[0][-1])
    return Step(
        instant=instant,
        duration=duration,
        height=height,
        instant_uncertainty=float(np.sqrt(covariance[-1, -1])) / max(abs(height), 1e-300),
        height_uncertainty=float(np.sqrt(covariance[-2, -2])),
    )


def _columns_within(local: Observation, steps: Sequence[Step], *, origin: float) -> Array:
    """Return the known shapes of a part of a record, those of steps that are no constant there, shape (m, p)."""
    end = local.values.size * local.interval
    shifted = [replace(step, instant=step.instant - origin) for step in steps]
    columns = columns_of([step for step in shifted if step.instant < end], local)
    return columns[:, (np.ptp(columns, axis=0) > 0) | (np.arange(columns.shape[1]) == 0)]


def _fit_ramp(
    squares: Callable[[float, float], float], middle: float, *, enough: float, interval: float
) -> tuple[float, float]:
    """Return instant and duration [s] of the least sum of squares; a sudden step if that is not small enough."""
    # the phase of what follows fixes the middle of a ramp, whatever its duration
    tried = interval * np.array(SETTINGS.ramps)
    longest = float(tried[np.argmin([squares(middle - length / 2, length) for length in tried])])
    simplex = np.array([[middle, longest], [middle, 1.3 * longest], [middle + 0.1 * interval, longest]])
    found = minimize(
        lambda point: squares(point[0] - abs(point[1]) / 2, abs(point[1])),
        simplex[0],  # type: ignore[call-overload]
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 1e-4 * interval, "fatol": 1e-3, "maxiter": 200},
    )
    if found.fun > enough:
        return middle, 0.0
    duration = float(abs(found.x[1]))
    return float(found.x[0]) - duration / 2, duration


def fit_together(reading: Observation, filter_: KalmanFilter, steps: Sequence[Step]) -> list[Step]:
    """Return the steps, all instants and durations fitted together by Gauss-Newton iteration, with uncertainties."""
    steps = list(steps)
    small, most = 0.05 * reading.interval, 0.5 * reading.interval
    for _ in range(SETTINGS.iterations):
        slow = np.array([step.duration > 0 for step in steps])
        later = [_derivative(step, reading, later=small) for step in steps]
        longer = [
            _derivative(step, reading, longer=min(small, step.duration / 2)) for step in steps if step.duration > 0
        ]
        known = columns_of(steps, reading)
        columns = np.column_stack([known, *later, *longer])
        sizes, covariance, _ = generalised_least_squares(filter_, reading.filled, columns)
        spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        heights = sizes[1 : 1 + slow.size]
        of_instants, of_durations = np.split(sizes[known.shape[1] :], [slow.size])
        moves = np.zeros((slow.size, 2))
        moves[:, 0] = of_instants / heights
        moves[slow, 1] = of_durations / heights[slow]
        moves = np.clip(moves, -most, most)
        steps = [
            replace(
                step,
                instant=float(step.instant + moves[k, 0]),
                duration=float(max(step.duration + moves[k, 1], 0.5 * step.duration)),
                height=float(heights[k]),
                height_uncertainty=float(spread[1 + k]),
                instant_uncertainty=float(spread[known.shape[1] + k] / max(abs(heights[k]), 1e-300)),
            )
            for k, step in enumerate(steps)
        ]
        least, largest = (size * reading.interval for size in STILL)
        still = np.clip([0.1 * step.instant_uncertainty for step in steps], least, largest)
        if np.all(np.abs(moves) < still[:, None]):
            break
    return steps


def gains_of_ramps(reading: Observation, filter_: KalmanFilter, steps: Sequence[Step]) -> Array:
    """Return about what a duration of each sudden step would bring in twice the log-likelihood, shape (k,) [1].

    A ramp of duration T is a sudden step in its middle, more T^2 / 24 times the second derivative of the response.
    """
    sudden = np.array([step.duration == 0 for step in steps])
    known, small = columns_of(steps, reading), 0.5 * reading.interval
    bends = []
    for column, step in zip(known[:, 1:].T, steps, strict=False):
        if step.duration == 0:
            beside = (response_to(replace(step, instant=step.instant + shift), reading) for shift in (small, -small))
            bends.append((sum(beside) - 2 * column) / small**2)
    later = [_derivative(step, reading, later=0.1 * small) for step in steps]
    sizes, covariance, _ = generalised_least_squares(filter_, reading.filled, np.column_stack([known, *later, *bends]))
    gains, places = np.zeros(len(steps)), np.arange(sizes.size - len(bends), sizes.size)
    heights = sizes[1 : 1 + len(steps)][sudden]
    gain = sizes[places] ** 2 / np.maximum(np.diag(covariance)[places], 1e-300)
    gains[sudden] = np.where(sizes[places] * heights > 0, gain, 0.0)
    return gains


def _derivative(step: Step, reading: Observation, *, later: float = 0.0, longer: float = 0.0) -> Array:
    """Return the derivative of the response to a step with respect to instant or duration, shape (n,) [1/s]."""
    high = Step(step.instant + later, step.duration + longer)
    low = Step(step.instant - later, step.duration - longer)
    return (response_to(high, reading) - response_to(low, reading)) / (2 * (later + longer))
