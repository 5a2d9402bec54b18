"""The motion of the non-metric ("ground") end, block by block: from the readings of its sensors to six accelerations.

Accelerometers and angular accelerations are fitted sample by sample with equal weights; a rate of turn serves for what
keeps a mass turning, and is not differentiated. `aerobalance.motion.platform` does the same for a whole record, with
weights by frequency.
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
"""Length by which a turn is compared with an acceleration [m]."""


@dataclass(frozen=True, slots=True)
class LiveChannel(SensorSpec):
    """A column of the readings in SI units, and what is known of its sensor.

    Of that, delays are used, and of accelerometers noise, coupling (``"dc"`` or not), axis and place.

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
        """Whether it reads specific force."""
        return self.coupling == "dc"


@dataclass(frozen=True, slots=True, eq=False)
class LivePlatform:
    """How readings become motion.

    Attributes
    ----------
    gains
        Matrix from readings to motions, shape (6, m).
    gravity
        What every reading lacks of the pull of gravity, shape (m, 6).
    rates
        Columns of the rates of turn PM, YM and RM; None for those that are not read.
    """

    gains: Array
    gravity: Array
    rates: tuple[int | None, ...]

    @classmethod
    def of(cls, sensors: Sequence[LiveChannel]) -> LivePlatform:
        """Fit the motions that these sensors tell apart; sensors that have no axis are left out."""
        rows = np.array([_row(sensor) for sensor in sensors]).reshape(-1, 6)
        used = np.asarray(rows.any(axis=1))
        size = np.where([sensor_kind(sensor.name) == "turn" for sensor in sensors], 1 / UNIT_LEVER, 1.0)
        gains = np.zeros((6, len(sensors)))
        if used.any():
            gains = least_squares(rows, size, observable_motions(rows[used], size[used]), used)
        specific = np.array([sensor.specific for sensor in sensors], dtype=np.float64)
        names = [sensor.name for sensor in sensors]
        turns = [f"ground_turn_rate_{name}" for name in MOMENTS]
        rates = tuple(names.index(name) if name in names else None for name in turns)
        return cls(gains, rows * IS_FORCE * specific[:, None], rates)

    @classmethod
    def along(cls, component: str, sensor: LiveChannel) -> LivePlatform:
        """Take one accelerometer for the motion along the axis that drives a component."""
        gains = np.zeros((6, 1))
        gains[FORCE_ROWS[AXES.index(driving_axis(component))]] = 1.0
        return cls(gains, gains.T * float(sensor.specific), (None, None, None))

    def specific_force(self, readings: Array, *, pull: Array | None) -> Array:
        """Return acceleration of the balance's centre and turning, less gravity, shape (k, 6) [m/s^2, rad/s^2].

        Parameters
        ----------
        readings
            Shape (k, m).
        pull
            Pull of gravity along the components, shape (k, 6) [m/s^2]; without it, sensors of specific force are taken
            as they are and none is taken off.
        """
        if pull is None:
            return np.asarray(readings @ self.gains.T)
        return np.asarray((readings + pull @ self.gravity.T) @ self.gains.T - pull)

    def turn_rate(self, readings: Array) -> Array | None:
        """Rate of turn in the signs of PM, YM and RM, shape (k, 3) [rad/s]; None where none is read."""
        if all(place is None for place in self.rates):
            return None
        zero = np.zeros(readings.shape[0])
        return np.column_stack([zero if place is None else readings[:, place] for place in self.rates])

    def covariance(self, noise: Array) -> Array:
        """Covariance of the noise of the motion, shape (6, 6), from that of the readings, shape (m,)."""
        return np.asarray((self.gains * noise**2) @ self.gains.T)

    def seen(self, moving: NDArray[np.bool_]) -> LivePlatform:
        """The same with sensors that show nothing taken as zero."""
        return LivePlatform(self.gains * moving, self.gravity, self.rates)


def _row(sensor: LiveChannel) -> Array:
    """What a sensor reads of the six motions, shape (6,); zero for rates and for those without an axis."""
    kind = sensor_kind(sensor.name)
    axis = AXES_BY_NAME.get(sensor.name) if sensor.axis is None else sensor.axis
    if kind == "rate" or (kind == "acceleration" and axis is None):
        return np.zeros(6)
    vector = np.array(axis or (0.0, 0.0, 0.0))
    size = float(np.linalg.norm(vector)) or 1.0
    return row_of(sensor.name, vector / size, np.array(sensor.place or (0.0, 0.0, 0.0)))
