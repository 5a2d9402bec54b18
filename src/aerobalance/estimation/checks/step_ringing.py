"""What the ringing after steps says of the first mode: its frequency and damping ratio beside those known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.force_smoother import instant_columns
from aerobalance.estimation.prior import Observation, SpectralPrior, least_squares, whitened
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.steps import Step, response_to
from aerobalance.recording.channel import Array


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
    """

    iterations: int = 20
    settled: float = 0.1
    usual: float = 1.0


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

    covariance, usual = np.zeros((2, 2)), np.diag([0.0, SETTINGS.usual**-2])
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
        heights, covariance = sizes[1 : 1 + count], whole[-2:, -2:]
        weight = np.linalg.inv(covariance)
        covariance = np.linalg.inv(weight + usual)
        change = np.clip(covariance @ (weight @ sizes[-2:] - usual @ point), -most, most)
        point = point + change
        if (np.abs(change) < SETTINGS.settled * np.sqrt(np.diag(covariance))).all():
            break
    # far from the point the likelihood is no parabola: a change of the damping ratio as well may make the frequency's
    # uncertainty small where the readings hardly speak for either
    there = own.retuned(frequency=float(np.exp(point[0])), damping=float(np.exp(point[1])))
    white = whitened(filter_, reading.filled, shapes_at(there))
    left = least_squares(white[:, 0], white[:, 1:])[2]
    return ChangeBySteps(point, covariance, float(as_known - left - point @ usual @ point))
