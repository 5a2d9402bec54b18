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
from scipy.signal import fftconvolve

from aerobalance.estimation.prior import Learned, Reading, confirmed, generalised_least_squares, learn, log_likelihood
from aerobalance.estimation.spectra.line_noise import columns_of_lines
from aerobalance.estimation.spectra.periodogram import Spectrum
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import warn_quality

STEP_EVIDENCE: Final = 40.0
"""Gain in twice the log-likelihood that a step must bring in a record of `FEW_INSTANTS`.

Chance brings it at one of so many instants once in a million records: n times the tail of chi-square with one degree
of freedom. At 25 it was once in 600 (measured: 4 in 3600 records).
"""

FEW_INSTANTS: Final = 3200
"""Samples of a record up to which that is enough; every further instant is one more chance to be misled."""

RAMP_EVIDENCE: Final = 20.0
"""Gain in twice the log-likelihood for which a step is given a duration.

Chance brings it to one sudden step in a hundred thousand (chi-square with one degree of freedom); at 10 it was one in
600, which was then found half a sample early.
"""

RAMPS: Final = np.array([0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 16.0])
"""Durations that are tried to begin with, in samples."""

MOST_STEPS: Final = 20
"""Steps that are looked for in one record."""

HIGHEST: Final = 10.0
"""Height of a step, over the swing of the readings, above which it is one of a pair that cannot be told apart."""

FAINT: Final = 0.05
"""Rms in the reading, over its swing, of a force that may be what is left over of two steps read as a ramp."""

FAINT_STEPS: Final = 2
"""Steps that such a force is taken for at most; more are the error of a wrong model."""

MOST_INSTANTS: Final = 64
"""Instants that are tried at most where a step that was found before is placed again."""

NEWTON_TURNS: Final = 5
"""Turns of the Gauss-Newton iteration on all steps at once."""

REFINING_SAMPLES: Final = (1 << 12, 1 << 14)
"""Shortest and longest part of a record, around a step, on which its instant is refined."""

DECAYED: Final = 4.0
"""Decay times after which a step rings no more: 2 % of it is left, with 0.03 % of what it says of the instant."""

BESIDE: Final = 4
"""Earlier steps at most that are placed again beside a new one: those next to it."""

ECHO: Final = 0.03
"""Height of a step over that of one before it, up to which it may be an error of the model in that one's ringing."""

ECHOES: Final = 2
"""Such steps within the ringing up to which they are taken for steps; more are the model's error."""

ECHO_PERIODS: Final = 30.0
"""Periods of the natural frequency over which they are looked for, if the balance's own ringing is shorter."""


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
    """The constant, the response to every step, and sine and cosine of hum, shape (n, 1 + steps + 2 lines)."""
    count = reading.values.size
    lines = columns_of_lines(reading.hum, count=count, interval=reading.interval)
    return np.column_stack([np.ones(count), *(response_to(step, reading) for step in steps), lines])


def find_steps(reading: Reading) -> tuple[list[Step], Learned]:
    """Find the steps of a record, and the prior of what is left when they are taken out."""
    steps: list[Step] = []
    columns = columns_of(steps, reading)
    learned = confirmed(reading, learn(reading, columns=columns), columns=columns)
    faint = 0
    while len(steps) < MOST_STEPS:
        found = _one_more(reading, learned, steps, prior=learned)
        if found is None and steps and faint < FAINT_STEPS and _faint(reading, learned, beside=FAINT * reading.swing):
            found = _one_more(reading, learned, steps, prior=_silenced(learned))
            faint += 1
        if found is None:
            break
        steps, learned = found
        sound = _without_echoes(steps, reading)
        if len(sound) < len(steps):
            warn_quality(
                f"{reading.dynamics.component} rings after a step as its dynamics do not: what they leave over is no "
                "steps and stays in the force, and smaller steps of the record are not looked for any more; identify "
                "the dynamics again"
            )
            return sound, learn(reading, columns=columns_of(sound, reading))
    return sorted(steps, key=lambda step: step.instant), learned


def _without_echoes(steps: list[Step], reading: Reading) -> list[Step]:
    """The steps less those that a wrong model of the balance has made of the ringing after another, where so many are.

    They would go on for as long as it rings, and explain nothing.
    """
    ordered = sorted(steps, key=lambda step: step.instant)
    d = reading.dynamics
    reach = max(_ringing_time(reading), ECHO_PERIODS / d.natural_frequency)
    for step in sorted(ordered, key=lambda step: -abs(step.height)):
        echoes = [
            other
            for other in ordered
            if 0 < other.instant - step.instant < reach and abs(other.height) < ECHO * abs(step.height)
        ]
        if len(echoes) > ECHOES:
            return [other for other in ordered if other not in echoes]
    return ordered


def _ringing_time(reading: Reading) -> float:
    """Time after which a step rings no more [s]."""
    slowest = min(mode.damping_ratio * mode.angular_frequency for mode in reading.dynamics.modes)
    return DECAYED / max(slowest, 1e-300)


def _one_more(
    reading: Reading, learned: Learned, steps: list[Step], *, prior: Learned
) -> tuple[list[Step], Learned] | None:
    """The steps with the likeliest further one under a prior, and the prior without it; None if there is none."""
    candidate, promise = _scan(reading, prior, columns_of(steps, reading))
    if promise < _evidence_needed(reading):
        return None
    return _taken_up(reading, learned, _settle(reading, prior, [*steps, candidate]))


def _silenced(learned: Learned) -> Learned:
    """The same noise with a force that does not fluctuate."""
    return replace(learned, spectrum=Spectrum(np.zeros(0), np.zeros(0)), shaping=ShapingFilter.silent())


def _faint(reading: Reading, learned: Learned, *, beside: float = 0.0) -> bool:
    """Whether a force was learned that makes less of the reading than the noise, or a size beside it [N], does.

    It may be what a step that was read wrongly has left over: a ramp for two steps, or a step for a ramp.
    """
    frequency = np.linspace(0, 0.5 / reading.interval, 4097)[1:]
    load = np.abs(reading.dynamics.response(frequency)) ** 2 * learned.spectrum.density(frequency)
    return bool(0 < float(np.mean(load)) < max(learned.noise, beside) ** 2 * reading.interval)


def _evidence_needed(reading: Reading) -> float:
    """Gain in twice the log-likelihood for which a step is taken up: of n chances the largest grows as 2 log n."""
    return STEP_EVIDENCE + 2 * float(np.log(max(reading.values.size / FEW_INSTANTS, 1.0)))


def _taken_up(
    reading: Reading, learned: Learned, settled: tuple[list[Step], Learned]
) -> tuple[list[Step], Learned] | None:
    """The steps with one more that has settled, last, and the prior; None if it does not bring the evidence."""
    trial, relearned = settled
    steps = trial[:-1]
    if max(abs(step.height) for step in trial) > HIGHEST * reading.swing:
        return None
    relearned = confirmed(reading, relearned, columns=columns_of(trial, reading))
    # each prior was learned from a periodogram, which hardly sees what happens near the ends of the record
    priors = (learned, relearned)
    (without, _), (with_it, better) = _likelier(reading, priors, steps, trial)
    evidence = 2 * (with_it - without)
    if evidence < _evidence_needed(reading):
        return None
    return [*trial[:-1], replace(trial[-1], evidence=evidence)], better


def _likelier(reading: Reading, priors: tuple[Learned, ...], *readings: list[Step]) -> list[tuple[float, Learned]]:
    """Log-likelihood of each set of steps and the prior under which it is largest."""
    filters = [KalmanFilter.of(reading.system(prior), reading.present) for prior in priors]
    found = []
    for steps in readings:
        columns = columns_of(steps, reading)
        likelihoods = [log_likelihood(reading, filter_, columns=columns) for filter_ in filters]
        best = int(np.argmax(likelihoods))
        found.append((likelihoods[best], priors[best]))
    return found


def _settle(reading: Reading, learned: Learned, steps: list[Step]) -> tuple[list[Step], Learned]:
    """Place a new step with the prior at hand, learn the prior again without it, and so on until neither moves."""
    for turn in range(5):
        last, placed = steps[-1], [step.instant for step in steps]
        others = columns_of(steps[:-1], reading)
        near, _ = _scan(reading, learned, others)
        if abs(near.instant - last.instant) < 2 * reading.interval:
            near = last
        # the first prior still holds the step's own trace and would read a ramp into it
        steps = [*steps[:-1], _refine(reading, learned, others, near, ramps=turn > 0)]
        if turn == 1:
            steps = _earlier_again(reading, learned, steps)
        if turn > 0:
            steps = _together(reading, learned, steps)
        # the first prior holds the step's own trace, and would leave some of it in the second
        before = learned if turn > 0 else None
        learned = learn(reading, columns=columns_of(steps, reading), before=before)
        moved = max(abs(step.instant - instant) for step, instant in zip(steps, placed, strict=True))
        if turn > 0 and moved < 0.01 * reading.interval:  # an earlier one may still be where this one had bent it to
            break
    return (steps, learned) if steps[-1].duration > 0 else _as_ramp(reading, learned, steps)


def _as_ramp(reading: Reading, learned: Learned, steps: list[Step]) -> tuple[list[Step], Learned]:
    """The same or, if that is more likely, with a duration for the last step.

    What is left over where a ramp was read as a sudden step is then taken for a fluctuating force, which gives no
    evidence for a ramp any more. So a ramp is tried as if there were none.
    """
    ramp = _refine(reading, _silenced(learned), columns_of(steps[:-1], reading), steps[-1], ramps=True)
    if ramp.duration == 0:
        return steps, learned
    trial = [*steps[:-1], ramp]
    relearned = learn(reading, columns=columns_of(trial, reading))
    trial = _together(reading, relearned, trial)
    relearned = learn(reading, columns=columns_of(trial, reading), before=relearned)
    priors = (learned, relearned)
    (sudden, _), (slow, better) = _likelier(reading, priors, steps, trial)
    if 2 * (slow - sudden) < RAMP_EVIDENCE:
        return steps, learned
    # of two steps close to each other a ramp explains much, but not all
    strict = _silenced(better) if _faint(reading, better) else better
    _, promise = _scan(reading, strict, columns_of(trial, reading))
    return (trial, better) if promise < _evidence_needed(reading) else (steps, learned)


def _earlier_again(reading: Reading, learned: Learned, steps: list[Step]) -> list[Step]:
    """The steps next to the last one placed again beside it: they were placed while it still bent the record."""
    steps = list(steps)
    nearest = np.argsort([abs(step.instant - steps[-1].instant) for step in steps[:-1]])
    for place in sorted(int(number) for number in nearest[:BESIDE]):
        step = steps[place]
        others = columns_of(steps[:place] + steps[place + 1 :], reading)
        steps[place] = replace(_refine(reading, learned, others, step, ramps=True), evidence=step.evidence)
    return steps


def _together(reading: Reading, learned: Learned, steps: list[Step]) -> list[Step]:
    """Instants and durations of all steps at once, by Gauss-Newton iteration from places that are nearly right."""
    filter_ = KalmanFilter.of(reading.system(learned), reading.present)
    small, most = 0.05 * reading.interval, 0.5 * reading.interval
    for _ in range(NEWTON_TURNS):
        slow = np.array([step.duration > 0 for step in steps])
        later = [_change(step, reading, later=small) for step in steps]
        longer = [_change(step, reading, longer=min(small, step.duration / 2)) for step in steps if step.duration > 0]
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


def _change(step: Step, reading: Reading, *, later: float = 0.0, longer: float = 0.0) -> Array:
    """Derivative of the response to a step by its instant or its duration, shape (n,) [1/s]."""
    high = Step(step.instant + later, step.duration + longer)
    low = Step(step.instant - later, step.duration - longer)
    return (response_to(high, reading) - response_to(low, reading)) / (2 * (later + longer))


def _scan(reading: Reading, learned: Learned, columns: Array) -> tuple[Step, float]:
    """The most likely instant of one more step, to a sample, and the gain in twice the log-likelihood it promises."""
    filter_ = KalmanFilter.of(reading.system(learned), reading.present)
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
    length = int(np.clip(2 * _ringing_time(reading) / interval, *REFINING_SAMPLES))
    first = int(np.clip(step.instant / interval - length // 2, 0, max(count - length, 0)))
    part = slice(first, min(first + length, count))
    local = replace(reading, values=reading.values[part])
    filter_ = KalmanFilter.of(local.system(learned), local.present)
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
    if ramps:
        instant, duration = _ramp(squares, instant, enough=sharp.fun - RAMP_EVIDENCE, interval=interval)
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


def _ramp(
    squares: Callable[[float, float], float], middle: float, *, enough: float, interval: float
) -> tuple[float, float]:
    """Instant and duration that leave the least sum of squares; a sudden step at the middle if that is not enough."""
    # the phase of what follows fixes the middle of a ramp, whatever its duration
    tried = interval * RAMPS
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
