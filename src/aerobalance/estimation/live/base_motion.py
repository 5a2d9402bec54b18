"""What the non-metric end does, sample by sample, as far as its sensors show that it moves."""

from __future__ import annotations

import numpy as np

from aerobalance.estimation.live.columns import Columns
from aerobalance.estimation.live.motion_test import MotionTest, MotionTestSettings
from aerobalance.recording.channel import Array
from aerobalance.recording.gravity import gravity_components
from aerobalance.recording.resampling import hold_over_gaps


class LiveBaseMotion:
    """Specific force and rate of turn of the non-metric end of a live force of n components.

    Accelerometers that show but their noise are left out (`MotionTest`); missing samples hold the last ones.

    Parameters
    ----------
    columns
        Where its sensors and angles are among the columns, c of them.
    interval
        Time between samples [s].
    settings
        When it is taken to move.
    gravity
        Local acceleration of gravity [m/s^2].
    """

    def __init__(self, columns: Columns, *, interval: float, settings: MotionTestSettings, gravity: float) -> None:
        self._columns, self._gravity = columns, gravity
        self._test = MotionTest(columns.noises, interval=interval, settings=settings)
        self._loads = columns.limits.size
        self._held = np.zeros(0)

    @property
    def watched(self) -> bool:
        """Whether there are sensors that have to show that they move."""
        return bool(self._columns.watched)

    @property
    def moving(self) -> bool:
        """Whether it is taken to move."""
        return bool(self._columns.specific.any() or self._test.moves.any())

    @property
    def follows(self) -> bool:
        """Whether there are loads of its motion or of its angles."""
        return self.moving or self._columns.pitch is not None

    def room(self, count: int) -> int:
        """Return how many of some samples can be watched before the next look at its motion."""
        return min(count, self._test.room()) if self.watched else count

    def watch(self, rows: Array) -> tuple[bool, bool]:
        """Watch samples of shape (m, c), m at most `room`; return whether it was looked at, and what moves changed."""
        if not self.watched:
            return False, False
        looked = rows.shape[0] == self._test.room()
        return looked, self._test.push(rows[:, self._columns.watched])

    def forget(self) -> None:
        """Hold no sample of the stream before."""
        self._held = np.zeros(0)

    def covariance(self) -> Array:
        """Return the covariance of the noise of the six motions of a sample, shape (6, 6) [(m/s^2)^2, (rad/s^2)^2]."""
        return self._columns.platform.covariance(self._columns.beside_specific(self._test.noise))

    def at(self, rows: Array) -> tuple[Array, Array | None]:
        """Return what it does at samples of shape (m, c).

        Returns
        -------
        specific_force
            Acceleration less gravity, shape (m, 6) [m/s^2, rad/s^2].
        turn_rate
            Rate of turn, shape (m, 3) [rad/s]; None where nothing moves or none is read.
        """
        columns, n = self._columns, self._loads
        if not self.follows:
            return np.zeros((rows.shape[0], 6)), None
        if not self._held.size:
            self._held = np.zeros(rows.shape[1] - n)
        known = hold_over_gaps(rows[:, n:], self._held)
        self._held = known[-1]
        pull = None
        if columns.pitch is not None:
            roll = 0.0 if columns.roll is None else known[:, columns.roll - n]
            pull = gravity_components(known[:, columns.pitch - n], roll, gravity=self._gravity)
        if not self.moving:
            return (np.zeros((rows.shape[0], 6)) if pull is None else -pull), None
        used = self._used()
        platform, seen = columns.platform.masked(used > 0), known[:, : used.size] * used
        return platform.specific_force(seen, pull=pull), columns.platform.turn_rate(seen)

    def _used(self) -> Array:
        """1 for each sensor that is used, 0 for one that shows but noise."""
        return self._columns.beside_specific(self._test.moves.astype(np.float64), others=1.0)
