"""Steps of the force: sudden changes that no stationary process explains.

A step is one more column of the record: the balance's response to a force that changes at an instant between samples,
at once or over a release duration. `aerobalance.estimation.step_search` finds them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import ndtr

from aerobalance.estimation.observation import Observation
from aerobalance.estimation.spectra.lines import columns_of_lines
from aerobalance.recording.channel import Array
from aerobalance.recording.decimation import SPAN, decimation_filter

NEVER: Final = 1e-12
"""Probability that is taken for none."""


@dataclass(frozen=True, slots=True)
class StepSettings:
    """Thresholds of the search for steps.

    Attributes
    ----------
    evidence
        Gain in twice the log-likelihood that a step must bring in a record of up to `instants` samples. Chance brings
        it at one of so many instants once in a million records: n times the tail of chi-square with one degree of
        freedom. At 25 it would be once in 550 records (measured: 4 in 3600).
    instants
        Samples of a record up to which that is enough; every further instant is one more chance to be misled.
    ramp_evidence
        Gain in twice the log-likelihood for which a step is given a duration. Chance brings it to one sudden step in a
        hundred thousand (chi-square with one degree of freedom); at 10 it was one in 600, which was then found half a
        sample early.
    ramps
        Durations that are tried first [samples].
    fewest_steps, most_steps
        Number of steps up to which they are searched in any record, and in a short one; a warning says where there
        are more.
    most_numbers
        Numbers in the responses to all of them together up to which more than the fewest are searched.
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
    fewest_steps: int = 20
    most_steps: int = 200
    most_numbers: int = 1 << 22
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


NOTHING: Final = 40.0
"""Decay times after which what is left is less than rounding."""

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
    """Return the balance load after a step of 1 N, shape (n,) [1]."""
    count, interval = reading.values.size, reading.interval
    first = int(np.clip(np.floor(step.instant / interval), 0, count))
    last = int(np.clip(np.ceil((step.instant + step.duration + _ended(reading)) / interval) + 1, first, count))
    time = np.arange(first, last) * interval - step.instant
    out = np.zeros(count)
    out[first:last] = reading.dynamics.step_response(time, duration=step.duration)
    if last < count:
        out[last:] = 1.0 if last == first else out[last - 1]
    if reading.decimated > 1:
        _filter_beside(step, reading, out)
    return out


def _filter_beside(step: Step, reading: Observation, response: Array) -> None:
    """Let a response of shape (n,) be what the filter of a slower clock makes of it, in place.

    Farther from the change than the filter reaches it is of frequencies at which the filter does nothing.
    """
    factor, interval = reading.decimated, reading.interval / reading.decimated
    taps = decimation_filter(factor)
    begin = int(np.floor(step.instant / reading.interval)) - SPAN
    end = int(np.ceil((step.instant + step.duration) / reading.interval)) + SPAN + 1
    begin, end = max(begin, 0), min(end, response.size)
    if end > begin:
        time = np.arange((begin - SPAN) * factor, (end - 1 + SPAN) * factor + 1) * interval - step.instant
        fast = reading.dynamics.step_response(time, duration=step.duration)
        response[begin:end] = sliding_window_view(fast, taps.size)[::factor] @ taps


def shape_of(step: Step, reading: Observation) -> Array:
    """Return the force of a step of 1 N, shape (n,) [1]: 0 before, 1 after, and a straight line between."""
    return shape_at(step, reading.interval * np.arange(reading.values.size, dtype=np.float64))


def shape_at(step: Step, time: Array) -> Array:
    """Return that force at times [s], shape (n,) [1]."""
    since = time - step.instant
    if step.duration <= 0:
        return (since >= 0).astype(np.float64)
    return np.clip(since / step.duration, 0.0, 1.0)


def side_variance(step: Step, time: Array, *, height: float, interval: float) -> Array:
    """Return the mean square error of the force, as a sample may lie on the other side of a step, shape (n,) [N^2].

    The force there is that before the step or that after it, whichever is likelier, and not the mean of both. Of a
    change within one interval at most one sample tells the course: it may be sudden as well, and on either side of
    it, so that a share p of the height has a variance of p (1 - p), the largest that a value from 0 to 1 can have.

    Parameters
    ----------
    step
        The step; one that takes longer than from one sample to the next has no sides.
    time
        Times of the samples, shape (n,) [s].
    height
        Its height [N].
    interval
        Time between samples [s].
    """
    if step.duration > interval:
        return np.zeros(time.size)
    if step.duration > 0:
        share = shape_at(step, time)
        return height**2 * share * (1 - share)
    other = ndtr(-np.abs(time - step.instant) / np.maximum(step.instant_uncertainty, 1e-12 * interval))
    return np.asarray(height**2 * np.where(other < NEVER, 0.0, other))


def columns_of(steps: Sequence[Step], reading: Observation) -> Array:
    """Return the constant, the response to every step, and sine and cosine of lines, shape (n, 1 + steps + 2 lines).

    Lines are those of hum, then tones of the load; of both it is the reading that has an amplitude of 1 N.
    """
    count = reading.values.size
    lines = columns_of_lines(reading.hum, count=count, interval=reading.interval)
    tones = columns_of_lines(
        reading.tones, count=count, interval=reading.interval, drift=reading.drift, response=reading.dynamics.response
    )
    return np.column_stack([np.ones(count), *(response_to(step, reading) for step in steps), lines, tones])


def _ended(reading: Observation) -> float:
    """Return the time after which the ringing is below rounding, `NOTHING` decay times of the slowest mode [s]."""
    return ringing_time(reading) * NOTHING / SETTINGS.decay_times


def ringing_time(reading: Observation) -> float:
    """Return the time after which the ringing counts as over, `decay_times` of the slowest mode [s]."""
    slowest = min(-max(pole.real for pole in mode.poles) for mode in reading.dynamics.modes)
    return SETTINGS.decay_times / max(slowest, 1e-300)


def without_model_errors(steps: list[Step], *, reach: float) -> list[Step]:
    """Return the steps without those that only correct a wrong model in the response to a larger one, if many do.

    Otherwise the search would go on for as long as the response lasts.
    """
    left = sorted(steps, key=lambda step: step.instant)
    for step in sorted(left, key=lambda step: -abs(step.height)):
        echoes = [
            other
            for other in left
            if 0 < other.instant - step.instant < reach and abs(other.height) < SETTINGS.echo * abs(step.height)
        ]
        if len(echoes) > SETTINGS.echoes:
            left = [other for other in left if other not in echoes]
    return left
