"""Motion of a shaken ground end in the frequency domain, with the noise that its sensors leave in it.

At every frequency the six motions are the least-squares solution of all sensors, each weighted with its noise there:
that of a rate of turn, differentiated, grows with frequency, and the fit takes noise of any size into account. So no
sensor is left out where its noise is large, as it has to be where motion is taken off the readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.identification.base_excitation.shaking_window import Window
from aerobalance.identification.coupled.free_response import Complex
from aerobalance.motion.least_squares import GroundFit
from aerobalance.motion.platform import PlatformMotion
from aerobalance.motion.rotation import centripetal
from aerobalance.motion.sensors import ground_sensors, observable_motions
from aerobalance.recording.channel import Array
from aerobalance.recording.components import IS_FORCE
from aerobalance.recording.noise import white_noise
from aerobalance.recording.recording import Recording

EXACT: Final = 1e-9
"""Noise over the rms of a sensor below which its readings are taken to be exact to rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundReadings:
    """What the sensors of the ground end read, and how it becomes motion.

    Attributes
    ----------
    readings
        Kinematic readings, w x (w x r) taken off, shape (n, k) [m/s^2, rad/s^2, rad/s].
    rows
        What each reads of the six motions, shape (k, 6); zero for motions that are taken as none.
    deviation
        Standard deviation of their noise, shape (k,).
    rates
        Which of them are rates of turn, shape (k,).
    columns
        Motions that they tell apart.
    pull
        Gravity in the straight motions, shape (n, 6) [m/s^2].
    pull_noise
        Standard deviation of its noise, shape (6,), and the part of every sensor that reads it, shape (k, 6).
    """

    readings: Array
    rows: Array
    deviation: Array
    rates: Array
    columns: tuple[int, ...]
    pull: Array
    pull_noise: tuple[Array, Array]

    @classmethod
    def of(cls, recording: Recording, platform: PlatformMotion) -> GroundReadings:
        """Take the sensors of a recording.

        Parameters
        ----------
        recording
            Readings with filters and cross-axis sensitivities undone.
        platform
            The motion that they show: which motions there are, the rate of turn, and gravity.
        """
        sensors = ground_sensors(recording)
        size = np.sqrt(np.mean(platform.acceleration**2, axis=0))
        moving = size > EXACT * size.max()
        whole = np.array([sensor.row for sensor in sensors])
        pull = platform.acceleration - platform.specific_force
        gravity = whole * IS_FORCE * np.array([[sensor.reads_gravity] for sensor in sensors])
        values = np.column_stack([sensor.values for sensor in sensors]) + pull @ gravity.T
        straight = np.array([sensor.kind != "rate" for sensor in sensors])
        values -= centripetal(GroundFit.of(sensors, rate=recording.rate), platform.turn_rate) * straight
        sizes = np.sqrt(np.mean(values**2, axis=0))
        deviation = np.array([max(s.noise, EXACT * (size or 1.0)) for s, size in zip(sensors, sizes, strict=True)])
        rows = whole * moving
        angles = np.array([white_noise(column) if np.ptp(column) > 0 else 0.0 for column in pull.T])
        columns = observable_motions(rows, deviation)
        return cls(values, rows, deviation, ~straight, columns, pull, (angles, gravity))

    def specific_force(self, window: Window) -> tuple[Complex, Array]:
        """Transform of acceleration less gravity under a window, shape (m, 6), and the covariance of its noise."""
        flat = self.readings - self.readings.mean(axis=0)
        plain, steep, _ = window.derivatives(flat)
        read = np.where(self.rates, steep, plain)
        grown = np.where(self.rates, np.abs(window.rates) ** 2, 1.0)
        rows = self.rows[:, list(self.columns)]
        weight = 1 / (self.deviation**2 * grown)
        spread = np.linalg.inv((rows.T * weight[:, None]) @ rows)
        gains = np.zeros((read.shape[0], 6, rows.shape[0]))
        gains[:, list(self.columns)] = (spread @ rows.T) * weight[:, None]
        noise = np.zeros((read.shape[0], 6, 6))
        places = np.array(self.columns)
        noise[:, places[:, None], places] = spread
        angles, gravity = self.pull_noise
        through = (gains @ gravity - np.eye(6)) * angles
        motion = np.einsum("mik,mk->mi", gains, read) - window.transform(self.pull - self.pull.mean(axis=0))
        size = np.linalg.norm(motion, axis=0)
        motion = np.where(size > EXACT * size.max(), motion, 0.0)  # rounding is no motion
        return motion, noise + through @ np.swapaxes(through, 1, 2)
