"""Readings as they come in, less the load that the ground end's motion makes the balance feel.

That load is the same as that of `aerobalance.motion.load_from_ground`: the motion is interpolated
band-limited to a clock `FINE` times as fast, and Eq. (8) of [Gorbushin2020]_ is integrated exactly on it. An
interpolated value needs `REACH` samples after it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance import _live_kernels as kernels
from aerobalance.channel import Array
from aerobalance.components import STANDARD_GRAVITY
from aerobalance.dynamics import Dynamics
from aerobalance.motion import FINE, gravity_share
from aerobalance.shaping import ShapingFilter
from aerobalance.smoother import FORCE, StateSpace

REACH: Final = 10
"""Samples on either side that an interpolated value is made from."""

SHARPNESS: Final = 8.0
"""Parameter of the Kaiser window of the interpolation."""


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
        shift = (dynamics.delay + delay) / interval
        self._weights, offset = _interpolation(shift)
        # taps of a sample reach from `back` before it to `ahead` after it; times before the first have its value
        self.ahead = max(offset + self._weights.shape[1] - 1, 0)
        self._back = max(-offset, 0)
        self._skip = self._back + offset
        self._transition, self._hold, self._ramp = _exact(dynamics, interval / FINE)
        self._mass = dynamics.mass
        self._state, self._last = np.zeros(self._hold.size), np.zeros(1)
        self._start: float | None = None
        self._waiting = np.zeros(self._back)

    def push(self, specific_force: Array) -> Array:
        """Load [N] that has become known by more of the motion, x1'' less gravity [m/s^2], from sample to sample."""
        net = -self._mass * specific_force
        if not net.size:
            return np.zeros(0)
        start = self._start = float(net[0]) if self._start is None else self._start
        self._waiting = np.concatenate([self._waiting, net - start])
        return self._drive()

    def finish(self) -> Array:
        """The loads that wait for what comes after, the motion held where it ended."""
        if self._start is None:
            return np.zeros(0)
        last = self._waiting[-1] if self._waiting.size else 0.0
        self._waiting = np.concatenate([self._waiting, np.full(self.ahead, last)])
        return self._drive()

    def _drive(self) -> Array:
        count = self._waiting.size - self._back - self.ahead
        if count <= 0:
            return np.zeros(0)
        taps = np.lib.stride_tricks.sliding_window_view(self._waiting[self._skip :], self._weights.shape[1])[:count]
        # one product a tap, so that the sum does not hang on how many samples come at once
        fine = np.zeros((count, FINE))
        for tap in range(self._weights.shape[1]):
            fine += taps[:, tap, None] * self._weights[:, tap]
        load = kernels.driven(self._transition, self._hold, self._ramp, self._state, fine.ravel(), self._last)
        self._waiting = self._waiting[count:]
        return np.asarray(load[::FINE] + (self._start or 0.0))


def _interpolation(shift: float) -> tuple[Array, int]:
    """Weights (FINE, taps) of the samples in the values on the fine clock, and the first tap's distance in samples."""
    place = np.arange(FINE) / FINE - shift
    first = int(np.floor(place[0])) - REACH + 1
    last = int(np.floor(place[-1])) + REACH
    distance = np.arange(first, last + 1) - place[:, None]
    inside = np.abs(distance) < REACH
    window = np.i0(SHARPNESS * np.sqrt(np.where(inside, 1 - (distance / REACH) ** 2, 0.0))) * inside
    weights = np.sinc(distance) * window
    return np.ascontiguousarray(weights / weights.sum(axis=1, keepdims=True)), first


def _exact(dynamics: Dynamics, interval: float) -> tuple[Array, Array, Array]:
    """Transition of the balance's states and their response to a force held, and to one that rises by 1 N, exactly.

    They are taken out of the state space of a force with two states, one the force and one its rise.
    """
    # a decay too slow to matter, without which the state space would have no stationary covariance
    drift = np.array([[-1e-9, 1.0], [0.0, -1e-9]]) / interval
    rising = ShapingFilter(drift, np.zeros(2))
    whole = StateSpace.of_balance(dynamics, rising, interval=interval, noise=1.0).transition
    own = np.delete(np.arange(whole.shape[0]), [FORCE, FORCE + 1])
    return (
        np.ascontiguousarray(whole[np.ix_(own, own)]),
        np.ascontiguousarray(whole[own, FORCE]),
        np.ascontiguousarray(whole[own, FORCE + 1]),
    )


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
        self._last = 0.0
        self._raw = self._motion = self._waiting = self._known = np.zeros(0)
        self._released = False
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
        self._raw = np.concatenate([self._raw, np.where(present, readings, np.nan)])
        motion = np.zeros(readings.size)
        if channels:
            if self._ground is None:
                self._ground = LiveGround(self._dynamics, interval=self._interval, delay=self._delay)
            motion = self._bridged(self._specific_force(readings.size, acceleration, pitch, roll))
            self._known = np.concatenate([self._known, self._ground.push(motion)])
        else:
            self._known = np.concatenate([self._known, motion])
        self._motion = np.concatenate([self._motion, motion])
        self._waiting = np.concatenate([self._waiting, np.where(present & ~at_limit, readings, np.nan)])
        return self._ready()

    def finish(self) -> Array:
        """The readings that wait for the ground's motion."""
        if self._ground is not None:
            self._known = np.concatenate([self._known, self._ground.finish()])
        return self._ready()

    def release(self, count: int) -> tuple[Array, Array, Array]:
        """Readings [N], the ground's specific force [m/s^2] and load rate [N/s] of the next samples that are final."""
        start = 1 if self._released else 0
        filled = self._raw[: start + count + 1]
        place = np.maximum.accumulate(np.where(np.isfinite(filled), np.arange(filled.size), 0))
        filled = np.nan_to_num(filled[place])
        rate = np.gradient(filled, self._interval)[start : start + count] if filled.size > 1 else np.zeros(count)
        load, motion = self._raw[start : start + count], self._motion[start : start + count]
        if count:
            self._raw, self._motion = self._raw[start + count - 1 :], self._motion[start + count - 1 :]
            self._released = True
        return load, motion, rate

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

    def _bridged(self, motion: Array) -> Array:
        """Motion with missing samples held at the last one that was there."""
        whole = np.concatenate([[self._last], motion])
        place = np.maximum.accumulate(np.where(np.isfinite(whole), np.arange(whole.size), 0))
        filled: Array = whole[place]
        self._last = float(filled[-1])
        return filled[1:]


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
