"""What the ringing after steps says of the first mode: its frequency and damping ratio beside those known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.force_smoother import instant_columns
from aerobalance.estimation.least_squares import generalised_least_squares, least_squares, whitened
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import fit_prior
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.step_window import free_motions
from aerobalance.estimation.steps import Step, response_to
from aerobalance.recording.channel import Array
from aerobalance.recording.linalg import sums_of_products


@dataclass(frozen=True, slots=True)
class StepRingingSettings:
    """How the change is found.

    Attributes
    ----------
    iterations, settled
        Iterations by which steps tell the dynamics, and change over its uncertainty at which they end.
    usual
        Standard deviation that the logarithm of the damping ratio has before: where steps say nothing of the damping,
        a resonance without any would tell its frequency far too well.
    band
        Frequencies over the natural one between which the readings are ringing.
    stands_out, fewest_periods
        Size of the ringing over the noise of a reading down to which noise does not turn the sign of its speed, and
        how long it must last, in periods.
    worth_a_look
        Standard uncertainties of a friction from which the force's spectrum is learned again without it.
    most_steps
        Steps up to which friction is looked for: of many, one rings on into the next.
    """

    iterations: int = 20
    settled: float = 0.1
    usual: float = 1.0
    band: tuple[float, float] = (0.6, 1.6)
    stands_out: float = 3.0
    fewest_periods: float = 5.0
    worth_a_look: float = 2.5
    most_steps: int = 6


SETTINGS: Final = StepRingingSettings()
"""Settings that are used."""


class ChangeBySteps(NamedTuple):
    """What the ringing after steps says of the first mode.

    Attributes
    ----------
    change, covariance
        Change of the logarithms of natural frequency and damping ratio, shape (2,), and its covariance, (2, 2) [1].
    gain
        Gain in twice the log-likelihood that it brings, what is known of the damping ratio before included.
    """

    change: Array
    covariance: Array
    gain: float


def change_by_steps(reading: Observation, steps: Sequence[Step], learned: SpectralPrior) -> ChangeBySteps:
    """Return what the ringing after steps says of the first mode.

    The responses to the steps are known shapes whose sizes are found by generalised least squares; natural frequency
    and damping ratio are two more numbers on which they depend, found by Gauss and Newton's method.

    Parameters
    ----------
    reading
        The record, without gaps.
    steps
        Its steps.
    learned
        Prior of the rest.
    """
    filter_ = KalmanFilter.of(reading.system(learned), reading.present)
    own, point, count = reading.dynamics, np.zeros(2), len(steps)
    heights = np.array([step.height for step in steps])

    def felt(moved: Array) -> Array:
        other = own.retuned(frequency=float(np.exp(moved[0])), damping=float(np.exp(moved[1])))
        at = replace(reading, dynamics=other)
        return np.column_stack([response_to(step, at) for step in steps])

    def shapes_at(other: ModalModel) -> Array:
        return instant_columns(replace(reading, dynamics=other), steps, heights=heights)[0]

    covariance: Array = np.zeros((2, 2))
    usual = np.diag([0.0, SETTINGS.usual**-2])
    as_known = np.inf
    for _ in range(SETTINGS.iterations):
        other = own.retuned(frequency=float(np.exp(point[0])), damping=float(np.exp(point[1])))
        # beyond a fraction of the width of the resonance the slopes say nothing any more
        most, small = np.array([0.5 * other.damping_ratio, 0.5]), np.array([0.05 * other.damping_ratio, 0.05])
        shapes = shapes_at(other)
        slopes = [
            (felt(point + part) - felt(point - part)) @ heights / (2 * step)
            for part, step in zip(np.diag(small), small, strict=True)
        ]
        white = whitened(filter_, reading.filled, np.column_stack([shapes, *slopes]))
        sizes, whole, _ = least_squares(white[:, 0], white[:, 1:])
        if as_known == np.inf:
            as_known = least_squares(white[:, 0], white[:, 1:-2])[2]
        known = np.diag(whole)[-2:]
        if not (known > 0).all() or known[0] > 1.0:  # the steps are so near the end that none has begun to ring
            return ChangeBySteps(np.zeros(2), np.diag([1.0, SETTINGS.usual**2]), 0.0)
        heights = sizes[1 : 1 + count]
        # what the slopes have apart from the shapes: the readings may tell one of them through the other alone
        apart = np.column_stack([one - white[:, 1:-2] @ least_squares(one, white[:, 1:-2])[0] for one in white.T[-2:]])
        covariance = np.asarray(np.linalg.inv(sums_of_products(apart, apart) + usual))
        change = np.clip(covariance @ (sums_of_products(apart, white[:, 0]) - usual @ point), -most, most)
        point = point + change
        if (np.abs(change) < SETTINGS.settled * np.sqrt(np.diag(covariance))).all():
            break
    # far from the point the likelihood is no parabola: a change of the damping ratio as well may make the frequency's
    # uncertainty small where the readings hardly speak for either
    there = own.retuned(frequency=float(np.exp(point[0])), damping=float(np.exp(point[1])))
    white = whitened(filter_, reading.filled, shapes_at(there))
    left = least_squares(white[:, 0], white[:, 1:])[2]
    return ChangeBySteps(point, covariance, float(as_known - left - point @ usual @ point))


def friction_by_steps(
    reading: Observation, steps: Sequence[Step], learned: SpectralPrior
) -> tuple[float, float] | None:
    """Return the friction that the ringing after steps shows and its standard uncertainty [N]; None where it cannot.

    Free oscillations die away exponentially by damping, and by friction in a straight line. The deflection x and the
    speed v of the ringing are read themselves, so that all three forces, against x, v and the sign of v, are known but
    for their sizes, which generalised least squares finds: those against x and v are another frequency and damping.

    Parameters
    ----------
    reading
        The record, without gaps.
    steps
        Its steps.
    learned
        Prior of the rest.
    """
    if not 0 < len(steps) <= SETTINGS.most_steps:
        return None
    x, v = _within(reading, reading.values[:, None])[:, 0], _within(reading, reading.values[:, None], rate=True)[:, 0]
    clear = _rings(x, reading, steps, least=SETTINGS.stands_out * learned.noise)
    if np.count_nonzero(clear) * reading.interval * reading.dynamics.natural_frequency < SETTINGS.fewest_periods:
        return None
    forces = np.where(clear[:, None], np.column_stack([x, v, np.sign(v)]), 0.0)
    felt = np.column_stack([reading.dynamics.balance_load(one, interval=reading.interval) for one in forces.T])
    known = instant_columns(reading, steps, heights=[step.height for step in steps])[0]
    columns = np.column_stack([known, *_free_after(reading, steps), felt])
    # what was learned may take the friction for a force: at first by what is near the natural frequency alone
    near = _within(reading, np.column_stack([columns[:, 1:], reading.values]))
    sizes, covariance, squares = least_squares(near[:, -1], near[:, :-1])
    told = 2 * reading.dynamics.natural_frequency * reading.interval * (SETTINGS.band[1] - SETTINGS.band[0]) * x.size
    if -sizes[-1] < SETTINGS.worth_a_look * np.sqrt(covariance[-1, -1] * squares / told):
        return None
    filter_ = KalmanFilter.of(reading.system(fit_prior(reading, columns=columns)), reading.present)
    sizes, covariance, _ = generalised_least_squares(filter_, reading.filled, columns)
    return -float(sizes[-1]), float(np.sqrt(covariance[-1, -1]))


def _free_after(reading: Observation, steps: Sequence[Step]) -> Iterator[Array]:
    """Free oscillations from each step on, shape (n,) each: what is no step at all may have excited them."""
    time = np.arange(reading.values.size, dtype=np.float64) * reading.interval
    for step in steps:
        since = time - step.instant - step.duration
        for motion in free_motions(reading.dynamics.modes[0], np.maximum(since, 0.0)):
            yield np.where(since >= 0, motion, 0.0)


def _rings(x: Array, reading: Observation, steps: Sequence[Step], *, least: float) -> NDArray[np.bool_]:
    """Where it rings by more than this after a step [N], shape (n,)."""
    from scipy.ndimage import maximum_filter1d  # noqa: PLC0415 - takes 30 ms, and few records need it

    period = max(round(1 / (reading.dynamics.natural_frequency * reading.interval)), 1)
    level = maximum_filter1d(np.abs(x), period, origin=-(period // 2))
    found = np.zeros(x.size, dtype=np.bool_)
    ends = [int(np.ceil((step.instant + step.duration) / reading.interval)) for step in steps]
    for first, last in pairwise(sorted([*ends, x.size])):
        weak = np.flatnonzero(level[first:last] < least)
        found[first : first + int(weak[0]) if weak.size else last] = True
    return found


def _within(reading: Observation, series: Array, *, rate: bool = False) -> Array:
    """What series (n, k) have about the natural frequency, or its rate over the angular one, of their shape."""
    count = len(series)
    line = series[0] + (series[-1] - series[0]) * np.linspace(0, 1, count)[:, None]
    closed = np.concatenate([series - line, (line - series)[::-1]])
    frequency = np.fft.rfftfreq(2 * count, reading.interval)
    ratio = frequency / reading.dynamics.natural_frequency
    kept = ((ratio > SETTINGS.band[0]) & (ratio < SETTINGS.band[1])) * (1j * ratio if rate else 1.0)
    return np.asarray(np.fft.irfft(np.fft.rfft(closed, axis=0) * kept[:, None], 2 * count, axis=0)[:count])
