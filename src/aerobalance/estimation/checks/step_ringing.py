"""What the ringing after steps says of the first mode: its frequency and damping ratio beside those known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.estimation.force_smoother import instant_columns
from aerobalance.estimation.prior import Observation, SpectralPrior, generalised_least_squares
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


def change_by_steps(reading: Observation, steps: Sequence[Step], learned: SpectralPrior) -> tuple[Array, Array]:
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

    Returns
    -------
    change, covariance
        Change of the logarithms of natural frequency and damping ratio, shape (2,), and its covariance, (2, 2) [1].
    """
    filter_ = KalmanFilter.of(reading.system(learned), reading.present)
    own, point, count = reading.dynamics, np.zeros(2), len(steps)
    heights = np.array([step.height for step in steps])

    def felt(moved: Array) -> Array:
        other = own.retuned(frequency=float(np.exp(moved[0])), damping=float(np.exp(moved[1])))
        at = replace(reading, dynamics=other)
        return np.column_stack([response_to(step, at) for step in steps])

    covariance, usual = np.zeros((2, 2)), np.diag([0.0, SETTINGS.usual**-2])
    for _ in range(SETTINGS.iterations):
        other = own.retuned(frequency=float(np.exp(point[0])), damping=float(np.exp(point[1])))
        # beyond a fraction of the width of the resonance the slopes say nothing any more
        most, small = np.array([0.5 * other.damping_ratio, 0.5]), np.array([0.05 * other.damping_ratio, 0.05])
        shapes = instant_columns(replace(reading, dynamics=other), steps, heights=heights)[0]
        slopes = [
            (felt(point + part) - felt(point - part)) @ heights / (2 * step)
            for part, step in zip(np.diag(small), small, strict=True)
        ]
        sizes, whole, _ = generalised_least_squares(filter_, reading.filled, np.column_stack([shapes, *slopes]))
        heights, covariance = sizes[1 : 1 + count], whole[-2:, -2:]
        weight = np.linalg.inv(covariance)
        covariance = np.linalg.inv(weight + usual)
        change = np.clip(covariance @ (weight @ sizes[-2:] - usual @ point), -most, most)
        point = point + change
        if (np.abs(change) < SETTINGS.settled * np.sqrt(np.diag(covariance))).all():
            break
    return point, covariance
