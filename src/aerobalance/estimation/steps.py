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

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from aerobalance.estimation.prior import (
    Observation,
    SpectralPrior,
    fit_prior,
    generalised_least_squares,
    log_likelihood,
    refine_edges,
)
from aerobalance.estimation.spectra.line_noise import columns_of_lines
from aerobalance.estimation.spectra.periodogram import Spectrum
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.estimation.step_window import StepWindow
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.fourier import convolve


@dataclass(frozen=True, slots=True)
class StepSettings:
    """Thresholds of the search for steps.

    Attributes
    ----------
    evidence
        Gain in twice the log-likelihood that a step must bring in a record of up to `instants` samples. Chance brings
        it at one of so many instants once in a million records: n times the tail of chi-square with one degree of
        freedom. At 25 it was once in 600 (measured: 4 in 3600 records).
    instants
        Samples of a record up to which that is enough; every further instant is one more chance to be misled.
    ramp_evidence
        Gain in twice the log-likelihood for which a step is given a duration. Chance brings it to one sudden step in a
        hundred thousand (chi-square with one degree of freedom); at 10 it was one in 600, which was then found half a
        sample early.
    ramps
        Durations that are tried first [samples].
    most_steps
        Largest number of steps that are searched in one record; a warning says where there are more.
    highest
        Height of a step over the range of the observations, above which it is one of a pair that cannot be separated.
    faint
        Rms of a force in the observations over their range, below which it may be the remainder of two steps that were
        fitted as one ramp.
    faint_steps
        Largest number of steps that such a force is explained by; more are the error of a wrong model.
    grid
        Largest number of instants that are tried where a step is located again.
    iterations
        Largest number of Gauss-Newton iterations on all steps together.
    window
        Shortest and longest part of a record, around a step, on which its instant is refined [samples].
    decay_times
        Decay times after which the response to a step has ended: 2 % of it is left, with 0.03 % of the information on
        the instant.
    neighbours
        Largest number of earlier steps that are refined again beside a new one: the nearest ones.
    echo
        Height of a step over that of an earlier one, up to which it may be a model error in the response to that one.
    echoes
        Number of such steps within the response up to which they are accepted; more are the model error.
    echo_periods
        Periods of the natural frequency in which they are counted, if the response is shorter.
    """

    evidence: float = 40.0
    instants: int = 3200
    ramp_evidence: float = 20.0
    ramps: tuple[float, ...] = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 16.0)
    most_steps: int = 20
    highest: float = 10.0
    faint: float = 0.05
    faint_steps: int = 2
    grid: int = 64
    iterations: int = 5
    window: tuple[int, int] = (1 << 12, 1 << 14)
    decay_times: float = 4.0
    neighbours: int = 4
    echo: float = 0.03
    echoes: int = 2
    echo_periods: float = 30.0


SETTINGS: Final = StepSettings()
"""Thresholds that the search uses."""


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


def response_to(step: Step, reading: Observation) -> Array:
    """Return the load felt after a step of 1 N, shape (n,) [1]."""
    time = np.arange(reading.values.size) * reading.interval - step.instant
    return reading.dynamics.step_response(time, duration=step.duration)


def shape_of(step: Step, reading: Observation) -> Array:
    """Return the force of a step of 1 N, shape (n,) [1]: 0 before, 1 after, and a straight line between."""
    time = np.arange(reading.values.size) * reading.interval - step.instant
    if step.duration <= 0:
        return (time >= 0).astype(np.float64)
    return np.clip(time / step.duration, 0.0, 1.0)


def columns_of(steps: list[Step], reading: Observation) -> Array:
    """Return the constant, the response to every step, and sine and cosine of hum, shape (n, 1 + steps + 2 lines)."""
    count = reading.values.size
    lines = columns_of_lines(reading.hum, count=count, interval=reading.interval)
    return np.column_stack([np.ones(count), *(response_to(step, reading) for step in steps), lines])


def find_steps(reading: Observation) -> tuple[list[Step], SpectralPrior]:
    """Return the steps of a record in the order of time, and the spectral prior of the force without them.

    Steps are found one at a time: the likeliest instant is proposed by a matched filter, located between samples, and
    accepted if the likelihood grows enough.
    """
    steps: list[Step] = []
    columns = columns_of(steps, reading)
    learned = refine_edges(reading, fit_prior(reading, columns=columns), columns=columns)
    faint = 0
    while len(steps) < SETTINGS.most_steps:
        found = _propose_step(reading, learned, steps, prior=learned)
        if (
            found is None
            and steps
            and faint < SETTINGS.faint_steps
            and _is_faint(reading, learned, beside=SETTINGS.faint * reading.swing)
        ):
            found = _propose_step(reading, learned, steps, prior=_without_force(learned))
            faint += 1
        if found is None:
            break
        steps, learned = found
        sound = _without_model_errors(steps, reading)
        if len(sound) < len(steps):
            warn_quality(
                f"{reading.dynamics.component} rings after a step as its dynamics do not: what they leave over is no "
                "steps and stays in the force, and smaller steps of the record are not looked for any more; identify "
                "the dynamics again"
            )
            return sound, fit_prior(reading, columns=columns_of(sound, reading))
    if len(steps) >= SETTINGS.most_steps:
        _, promise = _matched_filter_scan(reading, learned, columns_of(steps, reading))
        if promise >= _evidence_threshold(reading):
            warn_quality(
                f"{reading.dynamics.component} has more than {SETTINGS.most_steps} steps: no more of them are looked "
                "for, and the others are taken for a force that fluctuates; divide the record"
            )
    return sorted(steps, key=lambda step: step.instant), learned


def _without_model_errors(steps: list[Step], reading: Observation) -> list[Step]:
    """Return the steps without those that only correct a wrong model in the response to a larger one, if many do.

    Otherwise the search would go on for as long as the response lasts.
    """
    ordered = sorted(steps, key=lambda step: step.instant)
    d = reading.dynamics
    reach = max(_ringing_time(reading), SETTINGS.echo_periods / d.natural_frequency)
    for step in sorted(ordered, key=lambda step: -abs(step.height)):
        echoes = [
            other
            for other in ordered
            if 0 < other.instant - step.instant < reach and abs(other.height) < SETTINGS.echo * abs(step.height)
        ]
        if len(echoes) > SETTINGS.echoes:
            return [other for other in ordered if other not in echoes]
    return ordered


def _ringing_time(reading: Observation) -> float:
    """Return the time after which the response to a step has ended [s]."""
    slowest = min(mode.damping_ratio * mode.angular_frequency for mode in reading.dynamics.modes)
    return SETTINGS.decay_times / max(slowest, 1e-300)


def _propose_step(
    reading: Observation, learned: SpectralPrior, steps: list[Step], *, prior: SpectralPrior
) -> tuple[list[Step], SpectralPrior] | None:
    """Return the steps with the likeliest further one under a prior, and the new prior; None if there is no other."""
    candidate, promise = _matched_filter_scan(reading, prior, columns_of(steps, reading))
    if promise < _evidence_threshold(reading):
        return None
    return _accept_step(reading, learned, _relocate(reading, prior, [*steps, candidate]))


def _without_force(learned: SpectralPrior) -> SpectralPrior:
    """Return a prior with the same noise and a force that does not fluctuate."""
    return replace(learned, spectrum=Spectrum(np.zeros(0), np.zeros(0)), shaping=ShapingFilter.silent())


def _is_faint(reading: Observation, learned: SpectralPrior, *, beside: float = 0.0) -> bool:
    """Return whether the force of a prior has a smaller rms in the observations than their noise, or than a size [N].

    It may be the remainder of a step that was fitted wrongly: a ramp for two steps, or a step for a ramp.
    """
    frequency = np.linspace(0, 0.5 / reading.interval, 4097)[1:]
    load = np.abs(reading.dynamics.response(frequency)) ** 2 * learned.spectrum.density(frequency)
    return bool(0 < float(np.mean(load)) < max(learned.noise, beside) ** 2 * reading.interval)


def _evidence_threshold(reading: Observation) -> float:
    """Return the gain in twice the log-likelihood for which a step is accepted: the largest of n grows as 2 log n."""
    return SETTINGS.evidence + 2 * float(np.log(max(reading.values.size / SETTINGS.instants, 1.0)))


def _accept_step(
    reading: Observation, learned: SpectralPrior, settled: tuple[list[Step], SpectralPrior]
) -> tuple[list[Step], SpectralPrior] | None:
    """Return the steps with the one located last, and the prior; None if it does not bring the evidence."""
    trial, relearned = settled
    steps = trial[:-1]
    if max(abs(step.height) for step in trial) > SETTINGS.highest * reading.swing:
        return None
    relearned = refine_edges(reading, relearned, columns=columns_of(trial, reading))
    # each prior was learned from a periodogram, which hardly sees what happens near the ends of the record
    priors = (learned, relearned)
    (without, _), (with_it, better) = _most_likely_priors(reading, priors, steps, trial)
    evidence = 2 * (with_it - without)
    if evidence < _evidence_threshold(reading):
        return None
    return [*trial[:-1], replace(trial[-1], evidence=evidence)], better


def _most_likely_priors(
    reading: Observation, priors: tuple[SpectralPrior, ...], *readings: list[Step]
) -> list[tuple[float, SpectralPrior]]:
    """Return the largest log-likelihood of each set of steps, and the prior under which it is reached."""
    filters = [KalmanFilter.of(reading.system(prior), reading.present) for prior in priors]
    found = []
    for steps in readings:
        columns = columns_of(steps, reading)
        likelihoods = [log_likelihood(reading, filter_, columns=columns) for filter_ in filters]
        best = int(np.argmax(likelihoods))
        found.append((likelihoods[best], priors[best]))
    return found


def _relocate(reading: Observation, learned: SpectralPrior, steps: list[Step]) -> tuple[list[Step], SpectralPrior]:
    """Locate the last step with the prior, fit the prior again without that step, and so on until neither changes."""
    for turn in range(5):
        last, placed = steps[-1], [step.instant for step in steps]
        others = columns_of(steps[:-1], reading)
        near, _ = _matched_filter_scan(reading, learned, others)
        if abs(near.instant - last.instant) < 2 * reading.interval:
            near = last
        # the first prior was fitted with this step in the record, and would show a ramp where there is none
        steps = [*steps[:-1], _refine_step(reading, learned, others, near, ramps=turn > 0)]
        if turn == 1:
            steps = _refine_neighbours(reading, learned, steps)
        if turn > 0:
            steps = _joint_gauss_newton(reading, learned, steps)
        # the same prior would leave a part of the step in the next one
        before = learned if turn > 0 else None
        learned = fit_prior(reading, columns=columns_of(steps, reading), before=before)
        moved = max(abs(step.instant - instant) for step, instant in zip(steps, placed, strict=True))
        if turn > 0 and moved < 0.01 * reading.interval:  # an earlier one may still be displaced by this one
            break
    return (steps, learned) if steps[-1].duration > 0 else _test_ramp(reading, learned, steps)


def _test_ramp(reading: Observation, learned: SpectralPrior, steps: list[Step]) -> tuple[list[Step], SpectralPrior]:
    """Return the same or, if that is more likely, steps and prior with a duration for the last step.

    If a ramp was fitted as a sudden step, the prior explains the remainder as a fluctuating force, and nothing is left
    that shows a ramp. So the ramp is tested with a prior without such a force.
    """
    ramp = _refine_step(reading, _without_force(learned), columns_of(steps[:-1], reading), steps[-1], ramps=True)
    if ramp.duration == 0:
        return steps, learned
    trial = [*steps[:-1], ramp]
    relearned = fit_prior(reading, columns=columns_of(trial, reading))
    trial = _joint_gauss_newton(reading, relearned, trial)
    relearned = fit_prior(reading, columns=columns_of(trial, reading), before=relearned)
    priors = (learned, relearned)
    (sudden, _), (slow, better) = _most_likely_priors(reading, priors, steps, trial)
    if 2 * (slow - sudden) < SETTINGS.ramp_evidence:
        return steps, learned
    # of two steps close to each other a ramp explains much, but not all
    strict = _without_force(better) if _is_faint(reading, better) else better
    _, promise = _matched_filter_scan(reading, strict, columns_of(trial, reading))
    return (trial, better) if promise < _evidence_threshold(reading) else (steps, learned)


def _refine_neighbours(reading: Observation, learned: SpectralPrior, steps: list[Step]) -> list[Step]:
    """Return the steps with the neighbours of the last one refined: they were located while it was not yet known."""
    steps = list(steps)
    nearest = np.argsort([abs(step.instant - steps[-1].instant) for step in steps[:-1]])
    for place in sorted(int(number) for number in nearest[: SETTINGS.neighbours]):
        step = steps[place]
        others = columns_of(steps[:place] + steps[place + 1 :], reading)
        steps[place] = replace(_refine_step(reading, learned, others, step, ramps=True), evidence=step.evidence)
    return steps


def _joint_gauss_newton(reading: Observation, learned: SpectralPrior, steps: list[Step]) -> list[Step]:
    """Return the steps, all instants and durations fitted together by Gauss-Newton iteration, with uncertainties."""
    filter_ = KalmanFilter.of(reading.system(learned), reading.present)
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
        if np.max(np.abs(moves)) < 1e-3 * reading.interval:
            break
    return steps


def _derivative(step: Step, reading: Observation, *, later: float = 0.0, longer: float = 0.0) -> Array:
    """Return the derivative of the response to a step with respect to instant or duration, shape (n,) [1/s]."""
    high = Step(step.instant + later, step.duration + longer)
    low = Step(step.instant - later, step.duration - longer)
    return (response_to(high, reading) - response_to(low, reading)) / (2 * (later + longer))


def _matched_filter_scan(reading: Observation, learned: SpectralPrior, columns: Array) -> tuple[Step, float]:
    """Return the likeliest further step, to a sample, and its gain in twice the log-likelihood [deJong1998]_."""
    filter_ = KalmanFilter.of(reading.system(learned), reading.present)
    series = filter_.whiten(np.column_stack([reading.filled, columns]))
    basis, _ = np.linalg.qr(series[:, 1:])
    left = series[:, 0] - basis @ (basis.T @ series[:, 0])
    # the settled filter does not change with time, so the whitened response to a later step is the first one, shifted
    count = reading.values.size
    late = reading.interval * (np.arange(count) + 1)
    response = filter_.settled.whiten(reading.dynamics.step_response(late)[:, None])[:, 0]
    score, *across = convolve(np.column_stack([left, basis]), response[::-1, None])[count - 1 :].T
    information = np.cumsum(response**2)[::-1]
    for other in across:
        information = information - other**2
    gain = np.where(information > 1e-6 * information.max(), score**2 / np.maximum(information, 1e-300), 0.0)
    gain[0] = 0.0  # before the first interval a step is the constant
    place = int(np.argmax(gain))
    return Step(instant=(place - 1) * reading.interval, duration=0.0), float(gain[place])


def _refine_step(reading: Observation, learned: SpectralPrior, columns: Array, step: Step, *, ramps: bool) -> Step:
    """Return a step, located to a sample before, with instant, duration, height and their uncertainties."""
    count, interval = reading.values.size, reading.interval
    length = int(np.clip(2 * _ringing_time(reading) / interval, *SETTINGS.window))
    first = int(np.clip(step.instant / interval - length // 2, 0, max(count - length, 0)))
    part = slice(first, min(first + length, count))
    local = replace(reading, values=reading.values[part])
    filter_ = KalmanFilter.of(local.system(learned), local.present)
    fixed = columns[part]
    fixed = fixed[:, (np.ptp(fixed, axis=0) > 0) | (np.arange(fixed.shape[1]) == 0)]
    origin = first * interval

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
