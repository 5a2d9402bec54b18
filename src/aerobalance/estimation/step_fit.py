"""Instant, duration and height of steps that are known to a sample: one in a part of a record, or all together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from aerobalance.estimation.least_squares import generalised_least_squares
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.step_window import StepWindow
from aerobalance.estimation.steps import SETTINGS, Step, columns_of, response_to, ringing_time
from aerobalance.recording.channel import Array

LONG: Final = 4
"""Length of a record, over that which tells of an instant, from which steps are fitted in parts."""

STILL: Final = (1e-3, 1e-2)
"""Move in sampling intervals after which an instant stands still at least and at most: a tenth of its uncertainty."""


CLOSE: Final = 3.0
"""Distance in sampling intervals below which two steps may be one that was located wrongly."""


@dataclass(frozen=True, slots=True, eq=False)
class _StepPart:
    """A part of a record about some of its steps.

    Attributes
    ----------
    reading, filter
        The part, and its filter.
    origin
        Its first instant in the record [s].
    own
        Places of the steps that are looked at.
    fixed
        The other known shapes that change within it, and the constant, shape (m, q).
    """

    reading: Observation
    filter: KalmanFilter
    origin: float
    own: list[int]
    fixed: Array

    @classmethod
    def of(
        cls, reading: Observation, filter_: KalmanFilter, steps: Sequence[Step], *, own: list[int], part: slice
    ) -> _StepPart:
        """Cut a part out of a record."""
        local = replace(reading, values=reading.values[part])
        origin, end = part.start * reading.interval, part.stop * reading.interval
        others = [step for place, step in enumerate(steps) if place not in own and step.instant < end]
        fixed = columns_of(_later(others, -origin), local)
        fixed = fixed[:, (np.ptp(fixed, axis=0) > 0) | (np.arange(fixed.shape[1]) == 0)]
        return cls(local, filter_.over(local.present), origin, own, fixed)

    def columns(self, *columns: Sequence[Array]) -> Array:
        """Return its fixed shapes and others, side by side."""
        return np.column_stack([self.fixed, *(column for some in columns for column in some)])


def _parts(reading: Observation, filter_: KalmanFilter, steps: Sequence[Step]) -> Iterator[_StepPart]:
    """Yield the record as a whole or, where it is long beside the ringing, parts about steps that are near each other.

    The steps are looked up when a part is asked for: they may have changed by then.
    """
    count, length = reading.values.size, _window_length(reading)
    if count <= LONG * length:
        yield _StepPart.of(reading, filter_, steps, own=list(range(len(steps))), part=slice(0, count))
        return
    places = [int(place) for place in np.argsort([step.instant for step in steps])]
    middle = [step.instant / reading.interval for step in steps]
    while places:
        own = [place for place in places if middle[place] < middle[places[0]] + length // 2]
        places = places[len(own) :]
        begin = int(np.clip(middle[own[0]] - length // 2, 0, count - length))
        end = int(np.clip(middle[own[-1]] + length // 2, begin + length, count))
        yield _StepPart.of(reading, filter_, steps, own=own, part=slice(begin, end))


def _window_length(reading: Observation) -> int:
    """Return the number of samples about a step that tell of its instant."""
    return int(np.clip(2 * ringing_time(reading) / reading.interval, *SETTINGS.window))


def _later(steps: Iterable[Step], shift: float) -> list[Step]:
    """Return the steps so much later [s]."""
    return [replace(step, instant=step.instant + shift) for step in steps]


def refine_step(
    reading: Observation, filter_: KalmanFilter, steps: Sequence[Step], place: int, *, ramps: bool
) -> Step:
    """Return a step, located to a sample before, with instant, duration, height and their uncertainties.

    Parameters
    ----------
    reading
        The record.
    filter_
        Its filter under some prior.
    steps
        All its steps; the others keep their instants.
    place
        Which of them.
    ramps
        Whether it may have a duration.
    """
    count, interval, step, length = reading.values.size, reading.interval, steps[place], _window_length(reading)
    first = int(np.clip(step.instant / interval - length // 2, 0, max(count - length, 0)))
    part = _StepPart.of(reading, filter_, steps, own=[place], part=slice(first, min(first + length, count)))
    window = StepWindow.of(part.reading, part.filter, part.fixed, before=int(max(SETTINGS.ramps)) // 2 if ramps else 0)
    (step,) = _later([step], -part.origin)
    begin, end = step.instant - 1.5 * interval, step.instant + step.duration + 1.5 * interval
    grid = np.arange(begin, end, max(0.25 * interval, (end - begin) / SETTINGS.grid))
    coarse = float(grid[np.argmin([window.squares(instant, 0.0) for instant in grid])])
    sharp = minimize_scalar(
        window.squares,
        bounds=(coarse - 0.3 * interval, coarse + 0.3 * interval),
        args=(0.0,),
        options={"xatol": 1e-4 * interval},
    )
    found = Step(float(sharp.x), 0.0)
    if ramps:
        enough = sharp.fun - SETTINGS.ramp_evidence
        found = Step(*_fit_ramp(window.squares, found.instant, enough=enough, interval=interval))
    response, slope = response_to(found, part.reading), _derivative(found, part.reading, later=0.05 * interval)
    _, covariance, _ = generalised_least_squares(part.filter, part.reading.filled, part.columns([response, slope]))
    height = float(generalised_least_squares(part.filter, part.reading.filled, part.columns([response]))[0][-1])
    return replace(
        step,
        instant=found.instant + part.origin,
        duration=found.duration,
        height=height,
        instant_uncertainty=float(np.sqrt(covariance[-1, -1])) / max(abs(height), 1e-300),
        height_uncertainty=float(np.sqrt(covariance[-2, -2])),
    )


def as_one(reading: Observation, filter_: KalmanFilter, steps: Sequence[Step], place: int) -> list[Step] | None:
    """Return the steps with one for that of a place and the one before it; None where they are not close and alike.

    Of many steps that were located together one may have been taken for two with a part of its height each.
    """
    one, other = steps[place - 1 : place + 1]
    apart, height = other.instant - one.instant - one.duration, one.height + other.height
    if one.height * other.height <= 0 or apart > CLOSE * reading.interval:
        return None
    middle = (one.height * (one.instant + one.duration / 2) + other.height * other.instant) / height
    evidence = max(one.evidence, other.evidence)
    joined = replace(one, instant=middle, duration=0.0, height=height, evidence=evidence)
    found = [*steps[: place - 1], joined, *steps[place + 1 :]]
    found[place - 1] = refine_step(reading, filter_, found, place - 1, ramps=False)
    return found


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
    """Return the steps, instants and durations fitted together by Gauss-Newton iteration, with uncertainties."""
    found, parts = list(steps), 0
    for part in _parts(reading, filter_, found):
        fitted = _fitted(part, _later([found[place] for place in part.own], -part.origin))
        for place, step in zip(part.own, _later(fitted, part.origin), strict=True):
            found[place] = step
        parts += 1
    if parts == 1:
        return found
    # the level beside a step is that of the whole record
    sizes, covariance, _ = generalised_least_squares(filter_, reading.filled, columns_of(found, reading))
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return [
        replace(step, height=float(sizes[number]), height_uncertainty=float(spread[number]))
        for number, step in enumerate(found, start=1)
    ]


def _fitted(part: _StepPart, steps: list[Step]) -> list[Step]:
    """Return steps of a part, fitted together."""
    reading, first = part.reading, part.fixed.shape[1]
    small, most = 0.05 * reading.interval, 0.5 * reading.interval
    for _ in range(SETTINGS.iterations):
        slow = np.array([step.duration > 0 for step in steps], dtype=bool)
        columns = part.columns(
            [response_to(step, reading) for step in steps],
            [_derivative(step, reading, later=small) for step in steps],
            [_derivative(step, reading, longer=min(small, step.duration / 2)) for step in steps if step.duration > 0],
        )
        sizes, covariance, _ = generalised_least_squares(part.filter, reading.filled, columns)
        spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        heights, of_instants, of_durations = np.split(sizes[first:], [slow.size, 2 * slow.size])
        u_heights, u_instants, _ = np.split(spread[first:], [slow.size, 2 * slow.size])
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
                height_uncertainty=float(u_heights[k]),
                instant_uncertainty=float(u_instants[k] / max(abs(heights[k]), 1e-300)),
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
    gains = np.zeros(len(steps))
    for part in _parts(reading, filter_, steps):
        sudden = [place for place in part.own if steps[place].duration == 0]
        own = _later([steps[place] for place in part.own], -part.origin)
        known = [response_to(step, part.reading) for step in own]
        later = [_derivative(step, part.reading, later=0.05 * reading.interval) for step in own]
        bends = [
            _bend(step, part.reading, response) for step, response in zip(own, known, strict=True) if not step.duration
        ]
        columns = part.columns(known, later, bends)
        sizes, covariance, _ = generalised_least_squares(part.filter, part.reading.filled, columns)
        places = np.arange(sizes.size - len(bends), sizes.size)
        heights = sizes[part.fixed.shape[1] :][: len(own)][[part.own.index(place) for place in sudden]]
        gain = sizes[places] ** 2 / np.maximum(np.diag(covariance)[places], 1e-300)
        gains[sudden] = np.where(sizes[places] * heights > 0, gain, 0.0)
    return gains


def gain_of_another_model(reading: Observation, filter_: KalmanFilter, steps: Sequence[Step], place: int) -> float:
    """Return what other frequencies and dampings after one of the steps would bring in twice the log-likelihood [1].

    To first order: a response r(t) that runs faster by a part changes as t r', one that is damped more as t (r - 1).
    """
    step, columns = steps[place], columns_of(steps, reading)
    late = np.maximum(np.arange(reading.values.size) * reading.interval - step.instant, 0.0)
    faster = -late * _derivative(step, reading, later=0.05 * reading.interval)
    damped = late * (columns[:, 1 + place] - 1)
    (*_, left), (*_, less) = (
        generalised_least_squares(filter_, reading.filled, shapes)
        for shapes in (columns, np.column_stack([columns, faster, damped]))
    )
    return left - less


def _bend(step: Step, reading: Observation, response: Array) -> Array:
    """Return the second derivative of the response to a step with respect to its instant, shape (n,) [1/s^2]."""
    small = 0.5 * reading.interval
    late, early = (response_to(replace(step, instant=step.instant + shift), reading) for shift in (small, -small))
    return (late + early - 2 * response) / small**2


def _derivative(step: Step, reading: Observation, *, later: float = 0.0, longer: float = 0.0) -> Array:
    """Return the derivative of the response to a step with respect to instant or duration, shape (n,) [1/s]."""
    high = Step(step.instant + later, step.duration + longer)
    low = Step(step.instant - later, step.duration - longer)
    return (response_to(high, reading) - response_to(low, reading)) / (2 * (later + longer))
