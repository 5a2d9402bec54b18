"""The motion of the non-metric ("ground") end, block by block: from the readings of its sensors to six accelerations.

Accelerometers and angular accelerations are fitted by least squares, sample by sample, with equal weights. A rate of
turn serves for the centripetal and gyroscopic loads only, and is not differentiated. `aerobalance.motion.platform`
does the same for a whole record, with weights by noise and frequency.

Six motions are in the order and signs of the components NF PM SF YM RM AF: acceleration of the balance's centre for a
force, angular acceleration for a moment [m/s^2, rad/s^2].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.motion.sensors import least_squares, observable_motions, row_of, sensor_kind
from aerobalance.recording.channel import AXES_BY_NAME, Array, SensorSpec
from aerobalance.recording.components import AXES, FORCE_ROWS, IS_FORCE, MOMENTS, driving_axis

UNIT_LEVER: Final = 0.1
"""Lever at which an angular acceleration weighs as much as an acceleration in the fit [m]."""


@dataclass(frozen=True, slots=True)
class LiveChannel(SensorSpec):
    """A column of the readings in SI units, and what is known of its sensor.

    Not all of that is used: of all channels the delay, and of an accelerometer also noise, coupling (``"dc"`` or not),
    axis and place.

    Attributes
    ----------
    name
        A component; ``pitch`` or ``roll``; or a sensor on the non-metric end: ``ground_acceleration`` with any ending,
        ``ground_turn_PM`` (angular acceleration) or ``ground_turn_rate_PM`` and their like. Others are not used.
    limit
        Load at which a component's channel saturates [N, N*m]; such readings count as missing.
    """

    name: str
    limit: float = field(default=np.inf, kw_only=True)

    @property
    def specific(self) -> bool:
        """Whether it reads specific force, acceleration less gravity: a dc-coupled accelerometer does."""
        return self.coupling == "dc"


@dataclass(frozen=True, slots=True, eq=False)
class LivePlatform:
    """The linear map from the readings of m sensors to the six motions.

    Attributes
    ----------
    gains
        Least-squares matrix from readings to motions, shape (6, m).
    gravity
        Share of gravity along the six components that must be added to each reading to make it an acceleration, shape
        (m, 6) [1]; zero for sensors that do not read specific force.
    rates
        Columns of the readings that are rates of turn PM, YM and RM; None for one that is not read.
    """

    gains: Array
    gravity: Array
    rates: tuple[int | None, ...]

    @classmethod
    def of(cls, sensors: Sequence[LiveChannel]) -> LivePlatform:
        """Return the map for sensors anywhere on the non-metric end; one without an axis is left out.

        Motions that they do not tell apart are zero, as `observable_motions` chooses.
        """
        rows = np.array([_row(sensor) for sensor in sensors]).reshape(-1, 6)
        used = np.asarray(rows.any(axis=1))
        noise = np.where([sensor_kind(sensor.name) == "turn" for sensor in sensors], 1 / UNIT_LEVER, 1.0)
        gains = np.zeros((6, len(sensors)))
        if used.any():
            gains = least_squares(rows, noise, observable_motions(rows[used], noise[used]), used)
        specific = np.array([sensor.specific for sensor in sensors], dtype=np.float64)
        names = [sensor.name for sensor in sensors]
        rate_names = [f"ground_turn_rate_{name}" for name in MOMENTS]
        rates = tuple(names.index(name) if name in names else None for name in rate_names)
        return cls(gains, rows * IS_FORCE * specific[:, None], rates)

    @classmethod
    def along(cls, component: str, sensor: LiveChannel) -> LivePlatform:
        """Return the map of a single accelerometer: it reads the motion along the axis that drives a component."""
        gains = np.zeros((6, 1))
        gains[FORCE_ROWS[AXES.index(driving_axis(component))]] = 1.0
        return cls(gains, gains.T * float(sensor.specific), (None, None, None))

    def specific_force(self, readings: Array, *, pull: Array | None) -> Array:
        """Return specific force at the balance's centre and angular acceleration, shape (k, 6) [m/s^2, rad/s^2].

        Parameters
        ----------
        readings
            Readings of the m sensors, shape (k, m) [m/s^2, rad/s^2].
        pull
            Gravity along the components, shape (k, 6) [m/s^2]. None leaves gravity out: sensors of specific force are
            taken as they read, and nothing is taken off.
        """
        if pull is None:
            return np.asarray(readings @ self.gains.T)
        # gravity is added to readings of specific force, which gives accelerations, and taken off the fitted motion
        return np.asarray((readings + pull @ self.gravity.T) @ self.gains.T - pull)

    def turn_rate(self, readings: Array) -> Array | None:
        """Return rates of turn PM, YM and RM, shape (k, 3) [rad/s], zero for one not read; None where none is read."""
        if all(place is None for place in self.rates):
            return None
        zero = np.zeros(readings.shape[0])
        return np.column_stack([zero if place is None else readings[:, place] for place in self.rates])

    def covariance(self, noise: Array) -> Array:
        """Return the noise covariance of the six motions, shape (6, 6), from the noise of the readings, shape (m,)."""
        return np.asarray((self.gains * noise**2) @ self.gains.T)

    def masked(self, moving: NDArray[np.bool_]) -> LivePlatform:
        """The same map with the readings of sensors that do not show motion taken as zero; `moving` has shape (m,)."""
        return LivePlatform(self.gains * moving, self.gravity, self.rates)


def _row(sensor: LiveChannel) -> Array:
    """What a sensor reads of a unit of each of the six motions, shape (6,); zero for rates and without an axis."""
    kind = sensor_kind(sensor.name)
    axis = AXES_BY_NAME.get(sensor.name) if sensor.axis is None else sensor.axis
    if kind == "rate" or (kind == "acceleration" and axis is None):
        return np.zeros(6)
    vector = np.array(axis or (0.0, 0.0, 0.0))
    size = float(np.linalg.norm(vector)) or 1.0
    return row_of(sensor.name, vector / size, np.array(sensor.place or (0.0, 0.0, 0.0)))
