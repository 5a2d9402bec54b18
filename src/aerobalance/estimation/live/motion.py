"""Readings as they come in, less the load that the ground end's motion makes the balance feel.

That load is the same as that of `aerobalance.motion.single_axis.load_from_ground`, Eq. (8) of [Gorbushin2020]_ for a
motion that is interpolated band-limited (`aerobalance.dynamics.driven_modes`).
"""

from __future__ import annotations

import numpy as np

from aerobalance.dynamics.driven_modes import DrivenModes
from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.gravity import gravity_share
from aerobalance.recording.resampling import hold_over_gaps


class LiveGround:
    """Load from the ground's motion, chunk by chunk.

    Parameters
    ----------
    dynamics
        The balance; its delay is the lag of the load behind the acceleration.
    interval
        Time between samples [s].
    delay
        Further lag of the load channel behind the ground channel [s].
    """

    def __init__(self, dynamics: Dynamics, *, interval: float, delay: float = 0.0) -> None:
        self._modes = DrivenModes(dynamics.modes, interval=interval, delays=(dynamics.delay + delay,))
        self._shares = np.array([[mode.share, mode.rate_share] for mode in dynamics.modes]).T
        self._mass = dynamics.mass
        self._start: float | None = None

    @property
    def ahead(self) -> int:
        """Samples that a load waits for the motion after it."""
        return self._modes.ahead

    def push(self, specific_force: Array) -> Array:
        """Load [N] that has become known by more of the motion, x1'' less gravity [m/s^2], from sample to sample."""
        net = -self._mass * specific_force
        if not net.size:
            return np.zeros(0)
        self._start = float(net[0]) if self._start is None else self._start
        return self._whole(self._modes.push((net - self._start)[:, None, None] * self._shares))

    def finish(self) -> Array:
        """The loads that wait for what comes after: the motion goes on turned about its last sample."""
        return np.zeros(0) if self._start is None else self._whole(self._modes.finish())

    def _whole(self, parts: Array) -> Array:
        load = np.full(parts.shape[0], self._start)
        for part in parts.T:  # one by one, as a sum over modes could hang on how many samples come at once
            load += part
        return load


class LiveReadings:
    """The channels of one component as they come in.

    Parameters
    ----------
    dynamics
        The balance.
    interval
        Time between samples [s].
    limit
        Load at which the channel saturates [N].
    delay
        Time by which the load channel lags the ground channel beside the delay of the dynamics [s].
    gravity
        Local acceleration of gravity [m/s^2].

    Attributes
    ----------
    samples, missing, saturated
        Readings pushed, how many were missing, and how many were at the limit.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        *,
        interval: float,
        limit: float = np.inf,
        delay: float = 0.0,
        gravity: float = STANDARD_GRAVITY,
    ) -> None:
        self._dynamics, self._interval, self._limit = dynamics, interval, limit
        self._delay, self._gravity = delay, gravity
        self._ground: LiveGround | None = None
        self._last = np.zeros(1)
        self._passed = Passed(2, interval=interval)
        self._waiting = self._known = np.zeros(0)
        self.samples = self.missing = self.saturated = 0

    @property
    def ahead(self) -> int:
        """Samples that a reading waits for the ground's motion after it."""
        return 0 if self._ground is None else self._ground.ahead

    def push(self, readings: Array, *, acceleration: Array | None, pitch: Array | None, roll: Array | None) -> Array:
        """Take readings and channels of the ground; return the readings that are ready, NaN where missing [N].

        Raises
        ------
        ValueError
            The channels differ in length, or in kind from those before.
        """
        channels = [channel for channel in (acceleration, pitch, roll) if channel is not None]
        if any(np.shape(channel) != readings.shape for channel in (readings, *channels)) or readings.ndim != 1:
            raise ValueError("readings and channels of the ground must be rows of equally many samples")
        if self.samples and bool(channels) != (self._ground is not None):
            raise ValueError("ground_acceleration or pitch must be given with every push or with none")
        present = np.isfinite(readings)
        at_limit = present & (np.abs(np.where(present, readings, 0.0)) >= self._limit)
        self.samples += readings.size
        self.missing += int(np.count_nonzero(~present))
        self.saturated += int(np.count_nonzero(at_limit))
        motion = np.zeros(readings.size)
        if channels:
            if self._ground is None:
                self._ground = LiveGround(self._dynamics, interval=self._interval, delay=self._delay)
            motion = hold_over_gaps(
                self._specific_force(readings.size, acceleration, pitch, roll)[:, None], self._last
            )[:, 0]
            self._last = motion[-1:] if motion.size else self._last
            self._known = np.concatenate([self._known, self._ground.push(motion)])
        else:
            self._known = np.concatenate([self._known, motion])
        self._passed.push(np.column_stack([np.where(present, readings, np.nan), motion]))
        self._waiting = np.concatenate([self._waiting, np.where(present & ~at_limit, readings, np.nan)])
        return self._ready()

    def finish(self) -> Array:
        """The readings that wait for the ground's motion."""
        if self._ground is not None:
            self._known = np.concatenate([self._known, self._ground.finish()])
        return self._ready()

    def release(self, count: int) -> tuple[Array, Array, Array]:
        """Readings [N], the ground's specific force [m/s^2] and load rate [N/s] of the next samples that are final."""
        rows, rates = self._passed.release(count)
        return rows[:, 0], rows[:, 1], rates[:, 0]

    def _ready(self) -> Array:
        count = min(self._waiting.size, self._known.size)
        ready = self._waiting[:count] - self._known[:count]
        self._waiting, self._known = self._waiting[count:], self._known[count:]
        return np.asarray(ready)

    def _specific_force(
        self, count: int, acceleration: Array | None, pitch: Array | None, roll: Array | None
    ) -> Array:
        zero = np.zeros(count)
        force = zero if acceleration is None else np.asarray(acceleration, dtype=np.float64)
        if pitch is None and roll is None:
            return force
        angles = {"pitch": zero if pitch is None else pitch, "roll": zero if roll is None else roll}
        return np.asarray(force - self._gravity * gravity_share(self._dynamics.component, **angles))


class Passed:
    """Samples that wait until the force at them is final, to be given out with their rates.

    Parameters
    ----------
    columns
        Number of channels, c.
    interval
        Time between samples [s].
    """

    def __init__(self, columns: int, *, interval: float) -> None:
        self._interval = interval
        self._rows = np.zeros((0, columns))
        self._released = False

    def push(self, rows: Array) -> None:
        """Take samples, shape (m, c), NaN where missing."""
        self._rows = np.concatenate([self._rows, rows])

    def release(self, count: int) -> tuple[Array, Array]:
        """The next samples, as they came, and their rates by central differences, both of shape (count, c)."""
        start = 1 if self._released else 0
        seen = self._rows[: start + count + 1]
        filled = np.nan_to_num(hold_over_gaps(seen, np.zeros(seen.shape[1])))
        rates = np.zeros((count, seen.shape[1]))
        if seen.shape[0] > 1:
            rates = np.gradient(filled, self._interval, axis=0)[start : start + count]
        rows = self._rows[start : start + count]
        if count:
            self._rows, self._released = self._rows[start + count - 1 :], True
        return rows, rates


class RecentReadings:
    """The last readings, as many as are wanted at least.

    Parameters
    ----------
    most
        Readings that are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._values = np.empty(0)
        self._first = self._stop = 0

    @property
    def oldest(self) -> int:
        """Number of the oldest that is kept."""
        return self._first

    @property
    def stop(self) -> int:
        """Number after the newest."""
        return self._stop

    def append(self, values: Array) -> None:
        """Add readings."""
        used = self._stop - self._first
        if used + values.size > self._values.size:
            kept = min(used, self._most)
            room = np.empty(2 * (kept + values.size) + self._most)
            room[:kept] = self._values[used - kept : used]
            self._first, self._values = self._stop - kept, room
            used = kept
        self._values[used : used + values.size] = values
        self._stop += values.size

    def between(self, first: int, stop: int) -> Array:
        """Readings from a number up to another."""
        return self._values[first - self._first : stop - self._first].copy()
