"""The motion of the ground end in six degrees of freedom while its sensors' readings come in.

Accelerometers and angular accelerations are fitted sample by sample with equal weights; a rate of turn serves for what
keeps a mass turning, and is not differentiated. `aerobalance.motion.platform` does the same for a whole record, with
weights by frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.motion.sensors import least_squares, observable_motions, row_of, sensor_kind
from aerobalance.recording.channel import AXES_BY_NAME, Array
from aerobalance.recording.components import IS_FORCE, MOMENTS, STANDARD_GRAVITY
from aerobalance.recording.gravity import gravity_components

UNIT_LEVER: Final = 0.1
"""Length by which a turn is compared with an acceleration [m]."""


class Mounted(NamedTuple):
    """A sensor on the ground end.

    Attributes
    ----------
    name
        Its channel: ``ground_acceleration`` with any ending, ``ground_turn_PM`` or ``ground_turn_rate_PM`` and their
        like.
    axis, place
        Direction and place of an accelerometer along aft, right, up [1, m]; None for those of its name and for the
        balance's centre.
    specific
        Whether it reads specific force.
    """

    name: str
    axis: tuple[float, float, float] | None = None
    place: tuple[float, float, float] | None = None
    specific: bool = False


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
    def of(cls, sensors: Sequence[Mounted]) -> LivePlatform:
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

    def acceleration(self, readings: Array, *, pitch: Array | None = None, roll: Array | None = None) -> Array:
        """Acceleration of the balance's centre and turning, shape (k, 6), from readings of shape (k, m).

        Without a pitch, what sensors of specific force read of gravity stays in it: then none must be taken off again.
        """
        if pitch is not None and self.gravity.any():
            pull = gravity_components(pitch, 0.0 if roll is None else roll, gravity=STANDARD_GRAVITY)
            readings = readings + pull @ self.gravity.T
        return np.asarray(readings @ self.gains.T)

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


def _row(sensor: Mounted) -> Array:
    """What a sensor reads of the six motions, shape (6,); zero for rates and for those without an axis."""
    kind = sensor_kind(sensor.name)
    axis = AXES_BY_NAME.get(sensor.name) if sensor.axis is None else sensor.axis
    if kind == "rate" or (kind == "acceleration" and axis is None):
        return np.zeros(6)
    vector = np.array(axis or (0.0, 0.0, 0.0))
    size = float(np.linalg.norm(vector)) or 1.0
    return row_of(sensor.name, vector / size, np.array(sensor.place or (0.0, 0.0, 0.0)))
