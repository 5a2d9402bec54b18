"""What the ground's motion becomes where a channel reads something else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aerobalance.motion.least_squares import GroundFit
from aerobalance.motion.platform import MotionRecord, felt_of
from aerobalance.motion.sensors import on_clock
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.gravity import Gravity
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected


@dataclass(frozen=True, slots=True, eq=False)
class MotionChanges:
    """What the ground's motion becomes where one of its channels reads something else.

    Which sensors are used of each motion, and which motions are taken to be at rest, stays as the record has it.
    """

    _record: MotionRecord
    _fit: GroundFit
    _known: Array

    @classmethod
    def of(cls, recording: Recording, *, along: str | None = None) -> MotionChanges:
        """Take the motion from a recording, as `PlatformMotion.of` does."""
        record = MotionRecord.of(corrected(recording), along=along, gravity=STANDARD_GRAVITY)
        fit, known, *_ = record.at_rest()
        return cls(record, fit, known)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of sensors and angles that the motion is worked out with."""
        return (*(sensor.channel.name for sensor in self._record.first.sensors), *self._record.pull.angles)

    def specific_force(self, name: str, change: Array) -> Array:
        """Change of the specific force with that of a channel's readings, shapes (n, 6) and (n,) [m/s^2; rad/s^2].

        Parameters
        ----------
        name
            One of `channels`.
        change
            What it reads more, in its unit.
        """
        first, pull = self._record.first, self._record.pull
        if name in pull.angles:
            channel, delay = self._record.recording.channel(name), self._record.delay
            moved = on_clock(change, channel, rate=self._record.recording.rate, delay=delay)
            angles = {**pull.angles, name: pull.angles[name] + moved}
            other = Gravity.of(angles["pitch"], angles.get("roll", np.zeros(change.size)), gravity=pull.gravity)
            turned = other.acceleration - pull.acceleration
            return self._moved(felt_of(first, turned)) - turned
        delay = self._record.delay
        sensors = tuple(
            replace(
                one,
                values=on_clock(change, one.channel, rate=first.rate, delay=delay)
                if one.channel.name == name
                else np.zeros(change.size),
            )
            for one in first.sensors
        )
        return self._moved(replace(first, sensors=sensors).readings(change.size))

    def _moved(self, readings: Array) -> Array:
        """Motion of a change of all readings, shapes (n, 6) and (n, m); of one at rest, whose tones are taken, too."""
        tones = self._known.any(axis=0)
        if not tones.any():
            return self._fit.motion(readings)
        known = np.where(tones, self._record.first.motion(readings), 0.0)
        return self._fit.motion(readings - known @ self._record.first.rows.T) + known
