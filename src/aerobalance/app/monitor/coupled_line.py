"""The live forces of components that ring together, for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from aerobalance.app.monitor.force_line import LEARNED_FROM, Schedule, Stream, attitude
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.live.coupled import LiveCoupledForce
from aerobalance.estimation.live.health import Health, Learning, LiveEstimate, Snapshot
from aerobalance.estimation.live.platform import LivePlatform, Mounted
from aerobalance.estimation.prior import SpectralPrior
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.motion.sensors import sensor_kind
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError


class CoupledStream(Stream):
    """All components of a coupled balance.

    Parameters
    ----------
    dynamics
        Inertia and damping; without a mass the motion of the ground end is not taken off.
    rate
        Sampling rate of the source [Hz].
    names
        Names of the columns, all components among them.
    channels
        Channels of the source, the first of the columns.
    delays
        Times by which the columns lag the clock [s].
    """

    def __init__(
        self,
        dynamics: CoupledDynamics,
        *,
        rate: float,
        names: Sequence[str],
        channels: Sequence[StoredChannel],
        delays: Sequence[float],
    ) -> None:
        self.dynamics = dynamics
        columns = {name: place for place, name in enumerate(names)}
        sensors = [one for one in channels if sensor_kind(one.name) is not None] if dynamics.mass else []
        self._platform = LivePlatform.of(
            [Mounted(one.name, one.axis, one.place, one.coupling == "dc") for one in sensors]
        )
        self._specific = np.array([one.coupling == "dc" for one in sensors], dtype=np.bool_)
        angles = [columns.get(name) if dynamics.mass else None for name in ("pitch", "roll")]
        self._pitch, self._roll = angles
        self._learned: dict[str, SpectralPrior] = {}
        self._noise: Array | None = None
        self._live: LiveCoupledForce | None = None
        loads = [columns[name] for name in dynamics.components]
        places = [columns[one.name] for one in sensors]
        turning = [place for place in angles if place is not None]
        frequency = max([mode.natural_frequency for mode in dynamics.modes], default=rate / 16)
        super().__init__(
            rate=rate,
            frequency=frequency,
            loads=loads,
            motion=[*places, *turning],
            watched=[columns[one.name] for one in sensors if one.coupling != "dc"],
            late=[*(delays[place] - delays[loads[0]] for place in (*loads, *places)), *(0.0 for _ in turning)],
        )
        self._sensors = slice(len(loads), len(loads) + len(places))
        self.lines = {name: CoupledLine(self, name) for name in dynamics.components}

    @property
    def live(self) -> LiveCoupledForce | None:
        """The live forces; None before there are any."""
        return self._live if self.running else None

    @property
    def moving(self) -> bool:
        """Whether the ground end moves."""
        return bool(self._specific.any() or self.moves.any())

    def _used(self, watched: Array) -> Array:
        """A value of every watched sensor put beside those that are not, which are always used; shape (m,)."""
        whole = np.ones(self._specific.size)
        whole[~self._specific] = watched
        return whole

    def _begin(self) -> None:
        noise = self._used(self.ground_noise) * ~self._specific
        self._live = LiveCoupledForce(
            self.dynamics,
            interval=self.interval,
            learned=self._learned,
            noise=self._noise,
            learn_after=None,
            span=LEARNED_FROM * self.interval,
            ground_noise=self._platform.covariance(noise),
        )

    def _forget(self) -> None:
        self._learned, self._noise = {}, None

    def _force(self, rows: Array) -> Mapping[str, LiveEstimate]:
        if self._live is None:
            return {}
        pitch, roll = (
            None if place is None else rows[:, self._wanted.index(place)] for place in (self._pitch, self._roll)
        )
        acceleration = turn_rate = None
        if self.moving:
            used = self._used(self.moves.astype(np.float64))
            platform = self._platform.seen(used > 0)
            readings = rows[:, self._sensors] * used
            acceleration = platform.acceleration(readings, pitch=pitch, roll=roll)
            turn_rate = platform.turn_rate(readings)
        found = self._live.push(
            rows[:, : self._loads], ground_acceleration=acceleration, turn_rate=turn_rate, pitch=pitch, roll=roll
        )
        self._noise, self._latency = self._live.noise, self._live.latency
        return found

    def learn(self, component: str, learning: Learning, *, generation: int) -> None:
        """Go on with what was learned of a component, unless it is of a stream that has ended."""
        self._learned[component] = learning.learned
        if self._live is not None and generation == self.generation:
            self._live.adopt(component, learning)

    def weight(self, means: Array) -> Array:
        """Weight along all six components at mean readings of all channels, shape (6,)."""
        pitch, roll = attitude(means, self._pitch, self._roll)
        if pitch is None or self.dynamics.mass is None:
            return np.zeros(len(COMPONENTS))
        return np.asarray(self.dynamics.mass.weight(pitch, roll)[0])


class CoupledLine:
    """One component of a coupled balance.

    Parameters
    ----------
    stream
        All of them.
    component
        Which.
    """

    def __init__(self, stream: CoupledStream, component: str) -> None:
        self._stream, self._component = stream, component
        self._schedule = Schedule()
        self.factor, self.interval = stream.factor, stream.interval

    @property
    def generation(self) -> int:
        """Which stream it is, counted."""
        return self._stream.generation

    @property
    def moving(self) -> bool:
        """Whether the ground end moves."""
        return self._stream.moving

    @property
    def health(self) -> Health | None:
        """State of health; None before there is a force."""
        live = self._stream.live
        return None if live is None else live.health.get(self._component)

    @property
    def lag(self) -> float:
        """Time by which the force lags the readings [s]."""
        return self._stream.lag

    def due(self) -> Snapshot | None:
        """Return the readings to learn from, where it is time to."""
        live, health = self._stream.live, self.health
        time = self._stream.pushed * self.interval
        if live is None or health is None or not self._schedule.due(health, time=time, generation=self.generation):
            return None
        try:
            return live.snapshot(self._component)
        except FitError:
            return None

    def adopt(self, learning: Learning, *, generation: int) -> None:
        """Go on with what was learned, unless it is of a stream that has ended."""
        self._stream.learn(self._component, learning, generation=generation)

    def weight(self, means: Array) -> float:
        """Weight along the component at mean readings of all channels, shape (c,): a zero must not take it off."""
        return float(self._stream.weight(means)[COMPONENTS.index(self._component)])
