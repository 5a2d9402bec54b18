"""Steps of the force: sudden changes that no stationary process explains, found one at a time.

A step is one more column of the record: the balance's response to a force that changes at an instant between samples,
at once or over a release duration. With the prior known, all candidate instants are compared in one correlation of the
innovations with the whitened response [deJong1998]_; the prior is then learned again without the step, because the
first one was polluted by it.

References
----------
.. [deJong1998] P. de Jong, J. Penzer, "Diagnosing shocks in time series", J. Amer. Statist. Assoc. 93 (1998) 796.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.signal import fftconvolve

from aerobalance.prior import Learned, Reading, generalised_least_squares, learn, log_likelihood
from aerobalance.recording import Array
from aerobalance.smoother import Filter

STEP_EVIDENCE: Final = 25.0
"""Gain in twice the log-likelihood that a step must bring in a record of `FEW_INSTANTS`."""

FEW_INSTANTS: Final = 3200
"""Samples of a record up to which that is enough; every further instant is one more chance to be misled."""

RAMP_EVIDENCE: Final = 10.0
"""Gain in twice the log-likelihood for which a step is given a duration."""

MOST_STEPS: Final = 20
"""Steps that are looked for in one record."""

MOST_INSTANTS: Final = 64
"""Instants that are tried at most where a step that was found before is placed again."""

REFINING_SAMPLES: Final = 1 << 14
"""Length of the part of a record, around a step, on which its instant is refined."""


@dataclass(frozen=True, slots=True)
class Step:
    """One sudden change of the applied force.

    Attributes
    ----------
    instant
        Time since the first sample at which the force begins to change [s].
    duration
        Time that the change takes [s]; 0 is at once.
    height
        Force after less force before [N].
    instant_uncertainty, height_uncertainty
        Standard uncertainties of instant [s] and height [N].
    evidence
        Twice the gain in log-likelihood that the step brings [1].
    """

    instant: float
    duration: float
    height: float = 0.0
    instant_uncertainty: float = 0.0
    height_uncertainty: float = 0.0
    evidence: float = 0.0


def response_to(step: Step, reading: Reading) -> Array:
    """Load felt after a step of 1 N, shape (n,) [1]."""
    time = np.arange(reading.values.size) * reading.interval - step.instant
    return reading.dynamics.step_response(time, duration=step.duration)


def shape_of(step: Step, reading: Reading) -> Array:
    """Force of a step of 1 N, shape (n,) [1]: 0 before, 1 after, the mean over a ramp that falls within a sample."""
    time = np.arange(reading.values.size) * reading.interval - step.instant
    if step.duration <= 0:
        return (time >= 0).astype(np.float64)
    return np.clip(time / step.duration, 0.0, 1.0)


def columns_of(steps: list[Step], reading: Reading) -> Array:
    """The constant and the response to every step, shape (n, 1 + steps)."""
    constant = np.ones(reading.values.size)
    return np.column_stack([constant, *(response_to(step, reading) for step in steps)])


def find_steps(reading: Reading) -> tuple[list[Step], Learned]:
    """Find the steps of a record, and the prior of what is left when they are taken out."""
    steps: list[Step] = []
    learned = learn(reading, columns=columns_of(steps, reading))
    while True:
        columns = columns_of(steps, reading)
        candidate, promise = _scan(reading, learned, columns)
        found = None
        if promise >= _evidence_needed(reading) and len(steps) < MOST_STEPS:
            found = _taken_up(reading, learned, steps, candidate)
        if found is None:
            return sorted(steps, key=lambda step: step.instant), learned
        steps, learned = found


def _evidence_needed(reading: Reading) -> float:
    """Gain in twice the log-likelihood for which a step is taken up: of n chances the largest grows as 2 log n."""
    return STEP_EVIDENCE + 2 * float(np.log(max(reading.values.size / FEW_INSTANTS, 1.0)))


def _taken_up(
    reading: Reading, learned: Learned, steps: list[Step], candidate: Step
) -> tuple[list[Step], Learned] | None:
    """The steps with one more, and the prior without it; None if it does not bring the evidence."""
    trial, relearned = _settle(reading, learned, [*steps, candidate])
    with_it, without = (
        log_likelihood(reading, prior, columns=columns_of(some, reading))
        for prior, some in ((relearned, trial), (learned, steps))
    )
    evidence = 2 * (with_it - without)
    if evidence < _evidence_needed(reading):
        return None
    return [*trial[:-1], replace(trial[-1], evidence=evidence)], relearned


def _settle(reading: Reading, learned: Learned, steps: list[Step]) -> tuple[list[Step], Learned]:
    """Place a new step with the prior at hand, learn the prior again without it, and so on until neither moves."""
    for turn in range(5):
        before = steps[-1]
        others = columns_of(steps[:-1], reading)
        near, _ = _scan(reading, learned, others)
        if abs(near.instant - before.instant) < 2 * reading.interval:
            near = before
        # the first prior still holds the step's own trace and would read a ramp into it
        steps = [*steps[:-1], _refine(reading, learned, others, near, ramps=turn > 0)]
        if turn > 0:
            steps = _refined(reading, learned, steps)
        learned = learn(reading, columns=columns_of(steps, reading))
        if turn > 0 and abs(steps[-1].instant - before.instant) < 0.01 * reading.interval:
            break
    return steps, learned


def _refined(reading: Reading, learned: Learned, steps: list[Step]) -> list[Step]:
    """Every step placed again beside the others: an early one was placed while later ones still bent the record."""
    steps = list(steps)
    for place, step in enumerate(steps):
        others = columns_of(steps[:place] + steps[place + 1 :], reading)
        steps[place] = replace(_refine(reading, learned, others, step, ramps=True), evidence=step.evidence)
    return steps


def _scan(reading: Reading, learned: Learned, columns: Array) -> tuple[Step, float]:
    """The most likely instant of one more step, to a sample, and the gain in twice the log-likelihood it promises."""
    filter_ = Filter.of(reading.system(learned), reading.present)
    series = filter_.whiten(np.column_stack([reading.filled, columns]))
    basis, _ = np.linalg.qr(series[:, 1:])
    left = series[:, 0] - basis @ (basis.T @ series[:, 0])
    # the settled filter does not change with time, so the whitened response to a later step is the first one, shifted
    count = reading.values.size
    late = reading.interval * (np.arange(count) + 1)
    response = filter_.settled.whiten(reading.dynamics.step_response(late)[:, None])[:, 0]
    score = fftconvolve(left, response[::-1])[count - 1 :]
    information = np.cumsum(response**2)[::-1]
    for vector in basis.T:
        information = information - fftconvolve(vector, response[::-1])[count - 1 :] ** 2
    gain = np.where(information > 1e-6 * information.max(), score**2 / np.maximum(information, 1e-300), 0.0)
    gain[0] = 0.0  # before the first interval a step is the constant
    place = int(np.argmax(gain))
    return Step(instant=(place - 1) * reading.interval, duration=0.0), float(gain[place])


def _refine(reading: Reading, learned: Learned, columns: Array, step: Step, *, ramps: bool) -> Step:
    """Instant, duration, height and their uncertainties of a step whose place is known to a sample."""
    count, interval = reading.values.size, reading.interval
    first = int(np.clip(step.instant / interval - REFINING_SAMPLES // 2, 0, max(count - REFINING_SAMPLES, 0)))
    part = slice(first, min(first + REFINING_SAMPLES, count))
    local = replace(reading, values=reading.values[part])
    filter_ = Filter.of(local.system(learned), local.present)
    fixed = columns[part]
    fixed = fixed[:, (np.ptp(fixed, axis=0) > 0) | (np.arange(fixed.shape[1]) == 0)]
    origin = first * interval

    white = filter_.whiten(np.column_stack([local.filled, fixed]))
    basis, _ = np.linalg.qr(white[:, 1:])
    left = white[:, 0] - basis @ (basis.T @ white[:, 0])

    def squares(instant: float, duration: float) -> float:
        column = filter_.whiten(response_to(Step(instant - origin, duration), local)[:, None])[:, 0]
        column -= basis @ (basis.T @ column)
        return float(left @ left - (left @ column) ** 2 / max(float(column @ column), 1e-300))

    begin, end = step.instant - 1.5 * interval, step.instant + step.duration + 1.5 * interval
    grid = np.arange(begin, end, max(0.25 * interval, (end - begin) / MOST_INSTANTS))
    coarse = float(grid[np.argmin([squares(instant, 0.0) for instant in grid])])
    sharp = minimize_scalar(
        squares,
        bounds=(coarse - 0.3 * interval, coarse + 0.3 * interval),
        args=(0.0,),
        options={"xatol": 1e-4 * interval},
    )
    instant, duration = float(sharp.x), 0.0
    simplex = np.array([[instant, 0.5 * interval], [instant - interval, 2 * interval], [instant - interval, 0.0]])
    ramp = minimize(
        lambda point: squares(point[0], abs(point[1])),
        simplex[0],  # type: ignore[call-overload]
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 1e-4 * interval, "fatol": 1e-3, "maxiter": 200},
    )
    if ramps and sharp.fun - ramp.fun > RAMP_EVIDENCE:
        instant, duration = float(ramp.x[0]), float(abs(ramp.x[1]))
    column = response_to(Step(instant - origin, duration), local)
    late = response_to(Step(instant - origin + 0.05 * interval, duration), local)
    early = response_to(Step(instant - origin - 0.05 * interval, duration), local)
    slope = (late - early) / (0.1 * interval)
    _, covariance, _ = generalised_least_squares(filter_, local.filled, np.column_stack([fixed, column, slope]))
    height = float(generalised_least_squares(filter_, local.filled, np.column_stack([fixed, column]))[0][-1])
    return Step(
        instant=instant,
        duration=duration,
        height=height,
        instant_uncertainty=float(np.sqrt(covariance[-1, -1])) / max(abs(height), 1e-300),
        height_uncertainty=float(np.sqrt(covariance[-2, -2])),
    )
