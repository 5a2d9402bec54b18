"""The forces of components that ring together while the readings come in.

Eq. (17) of [Gorbushin2020]_ with matrices, F = X + D X' + A X'' - W + M x1'', chunk by chunk. Every component is taken
apart from the others (`aerobalance.estimation.live.decoupling`) and is then one that
`estimation.live.live_force.LiveForce` works out: same filter, same steps, same learning, same state of health. No
clock, no file, no thread.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.decoupling import LoneComponent
from aerobalance.estimation.coupled_record import noise_covariance
from aerobalance.estimation.decoupled_record import mass_slopes
from aerobalance.estimation.live.decoupling import LiveApart
from aerobalance.estimation.live.health import SHORTEST, Health, Learning, LiveEstimate, Snapshot
from aerobalance.estimation.live.live_force import LAG_PERIODS, LiveForce
from aerobalance.estimation.live.motion import Passed
from aerobalance.estimation.prior import SpectralPrior
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY, si_unit
from aerobalance.recording.gravity import gravity_components
from aerobalance.recording.resampling import hold_over_gaps

JUDGED: Final = 256
"""Readings that the covariance of their noise is judged from where it is not given."""

SLOWEST: Final = 0.5
"""Natural frequency of a lone balance that its lag is taken from at least, over that of the slowest mode."""

QUIET: Final = 0.01
"""Noise that a channel has at least, over the median of all."""

STILL: Final = 1e-8
"""Noise over the largest reading, below which a channel does not move at all."""


class LiveCoupledForce:
    """The forces and moments of several components, live.

    Parameters
    ----------
    dynamics
        Inertia and damping of the n components with their covariance, and the moving mass, which gravity and the
        ground's motion need.
    interval
        Time between samples [s].
    learned
        Process of the force and noise of a lone reading by component, from an earlier record, the noise white; those
        that are not given begin with a wide band and learn from the readings.
    noise
        Covariance of the noise of a reading, shape (n, n) [N^2, N^2*m, N^2*m^2]; None to judge it from the first
        `JUDGED` readings. It decides how much a component leans on the readings of the others.
    lag
        Time after which the forces at a sample are final [s]; if None, `LAG_PERIODS` periods of the slowest lone
        balance.
    limits
        Loads at which the channels saturate, by component [N, N*m]; such readings count as missing.
    learn_after, span
        As for `aerobalance.estimation.live.live_force.LiveForce`.
    ground_noise
        Covariance of the noise of a sample of the ground's specific force, shape (6, 6) [m^2/s^4, rad^2/s^4].
    ground_delay
        Time by which the load channels lag those of the ground [s].
    gravity
        Local acceleration of gravity [m/s^2].
    """

    def __init__(
        self,
        dynamics: CoupledDynamics,
        *,
        interval: float,
        learned: Mapping[str, SpectralPrior] | None = None,
        noise: Array | None = None,
        lag: float | None = None,
        limits: Mapping[str, float] | None = None,
        learn_after: float | None = 2.0,
        span: float = 10.0,
        ground_noise: Array | None = None,
        ground_delay: float = 0.0,
        gravity: float = STANDARD_GRAVITY,
    ) -> None:
        if not 0 < interval < np.inf:
            raise ValueError(f"interval must be positive and finite, not {interval}")
        self.dynamics, self.interval = dynamics, interval
        self._learned, self._lag = dict(learned or {}), lag
        self._learn_after, self._span = learn_after, span
        given = limits or {}
        self._limits = np.array([given.get(name, np.inf) for name in dynamics.components])
        self._ground_noise = np.zeros((6, 6)) if ground_noise is None else ground_noise
        self._ground_delay, self._gravity = ground_delay, gravity
        self._rows = np.array([COMPONENTS.index(name) for name in dynamics.components])
        self._parts: dict[str, LiveForce] = {}
        self._apart: LiveApart | None = None
        self._begin: list[tuple[Array, Array | None]] = []
        self._record = _Waiting(dynamics, interval=interval)
        self._moves: bool | None = None
        self._last = np.zeros(8)
        self._missing = np.zeros(len(self.components), dtype=np.int64)
        self._saturated = np.zeros(len(self.components), dtype=np.int64)
        self._samples, self._ended = 0, False
        self._noise: Array | None = None
        if noise is not None:
            self._make(noise)

    @property
    def components(self) -> tuple[str, ...]:
        """Which components, in the order of the readings' columns."""
        return self.dynamics.components

    @property
    def noise(self) -> Array | None:
        """Covariance of the noise of a reading, shape (n, n), as given or judged; None while it is not known."""
        return self._noise

    @property
    def latency(self) -> int:
        """Samples after which the forces at a sample are final; 0 while it is not known."""
        if self._apart is None:
            return 0
        return int(self._apart.ahead) + max(part.latency for part in self._parts.values())

    @property
    def steps(self) -> dict[str, tuple[Step, ...]]:
        """Steps of the forces that were found, instants since the first reading [s]."""
        return {name: part.steps for name, part in self._parts.items()}

    @property
    def health(self) -> dict[str, Health]:
        """State of health of the components; none before the noise is known."""
        return {
            name: replace(
                part.health,
                samples=self._samples,
                missing=int(self._missing[place]),
                saturated=int(self._saturated[place]),
            )
            for place, (name, part) in enumerate(self._parts.items())
        }

    # ---- readings in, forces out

    def push(
        self,
        readings: Array,
        *,
        ground_acceleration: Array | None = None,
        turn_rate: Array | None = None,
        pitch: Array | None = None,
        roll: Array | None = None,
    ) -> dict[str, LiveEstimate]:
        """Take readings; return what has become final by them, the same samples of all components.

        Parameters
        ----------
        readings
            Loads felt, shape (m, n), any number of samples; NaN where missing.
        ground_acceleration
            Acceleration of the balance's centre on the ground end and its turning, shape (m, 6), in the order and
            signs of `COMPONENTS` [m/s^2, rad/s^2]; given with every push or with none, as are the others.
        turn_rate
            Its rate of turn in the signs of PM, YM and RM, shape (m, 3) [rad/s].
        pitch, roll
            Angles, shape (m,) [rad].

        Raises
        ------
        ValueError
            The channels differ in length or kind, the ground moves and the dynamics hold no mass, or the stream is
            finished.
        """
        if self._ended:
            raise ValueError("the stream is finished; make a new LiveCoupledForce")
        values = np.asarray(readings, dtype=np.float64)
        if values.ndim != 2 or values.shape[1] != len(self.components):
            raise ValueError(f"readings must have a column for each of {', '.join(self.components)}")
        force = self._specific_force(values.shape[0], ground_acceleration, pitch, roll)
        net = self._net(force, turn_rate)
        present = np.isfinite(values)
        at_limit = present & (np.abs(np.where(present, values, 0.0)) >= self._limits)
        self._samples += values.shape[0]
        self._missing += np.count_nonzero(~present, axis=0)
        self._saturated += np.count_nonzero(at_limit, axis=0)
        self._record.push(values, net, force)
        return self._take(np.where(at_limit, np.nan, values), net)

    def finish(self) -> dict[str, LiveEstimate]:
        """End the stream; return the samples that were still waiting, by all readings."""
        self._ended = True
        if self._apart is None and self._samples:
            self._start()
        if self._apart is None:
            return self._final()
        self._hand_on(self._apart.finish())
        for name, part in self._parts.items():
            self._record.take(name, part.finish())
        return self._final()

    def _take(self, readings: Array, net: Array | None) -> dict[str, LiveEstimate]:
        if self._apart is None:
            self._begin.append((readings, net))
            if self._samples < JUDGED:
                return self._final()
            self._start()
        else:
            self._hand_on(self._apart.push(readings, net))
        return self._final()

    def _start(self) -> None:
        """Judge the noise from the first readings, and go on with all that are there."""
        readings = np.concatenate([values for values, _ in self._begin])
        nets = [net for _, net in self._begin]
        net = np.concatenate([one for one in nets if one is not None]) if nets[0] is not None else None
        self._begin = []
        self._make(_judged(self.components, readings[:JUDGED]))
        if self._apart is not None:
            self._hand_on(self._apart.push(readings, net))

    def _hand_on(self, lone: Array) -> None:
        for place, (name, part) in enumerate(self._parts.items()):
            self._record.take(name, part.push(lone[:, place]))

    def _final(self) -> dict[str, LiveEstimate]:
        return self._record.release(self.components)

    def _make(self, noise: Array) -> None:
        """The lone balances and their streams, now that the noise is known."""
        self._noise = noise
        lones = [LoneComponent.of(self.dynamics, name, noise=noise) for name in self.components]
        self._apart = LiveApart(lones, interval=self.interval, delay=self._ground_delay)
        matrix = self._mass_rows
        modes = [mode.natural_frequency for mode in self.dynamics.modes] or [lones[0].dynamics.natural_frequency]
        for lone in lones:
            dynamics, row = lone.dynamics, matrix[lone.place]
            slowest = max(dynamics.natural_frequency, SLOWEST * min(modes))
            time = LAG_PERIODS / slowest if self._lag is None else self._lag
            samples = round(time / self.interval) - self._apart.ahead
            if self._lag is None:
                samples = max(samples, SHORTEST)
            self._parts[lone.component] = LiveForce(
                dynamics,
                interval=self.interval,
                learned=self._learned.get(lone.component),
                lag=samples * self.interval,
                learn_after=self._learn_after,
                span=self._span,
                ground_noise=float(np.sqrt(max(row @ self._ground_noise @ row, 0.0))) / dynamics.mass,
                jolted=True,
                highest=max(modes),
            )

    # ---- what the ground does

    @property
    def _mass_rows(self) -> Array:
        mass = self.dynamics.mass
        return np.zeros((len(self._rows), 6)) if mass is None else mass.matrix[self._rows]

    def _specific_force(
        self, count: int, acceleration: Array | None, pitch: Array | None, roll: Array | None
    ) -> Array | None:
        """Acceleration of the ground less gravity, shape (count, 6); None where neither is given."""
        given = [np.shape(channel) for channel in (pitch, roll) if channel is not None]
        given_six = acceleration is None or np.shape(acceleration) == (count, 6)
        if any(shape != (count,) for shape in given) or not given_six:
            raise ValueError("readings and channels of the ground must have equally many samples")
        moves = bool(given) or acceleration is not None
        if self._moves is None:
            self._moves = moves
        if moves != self._moves:
            raise ValueError("ground_acceleration or pitch must be given with every push or with none")
        if not moves:
            return None
        if self.dynamics.mass is None:
            raise ValueError(
                "the ground end moves or pitches, but the dynamics hold no mass: give mass, centre of gravity and "
                "inertia when they are identified"
            )
        zero = np.zeros(count)
        table = np.zeros((count, 6)) if acceleration is None else np.asarray(acceleration, dtype=np.float64)
        angles = [zero if angle is None else np.asarray(angle, dtype=np.float64) for angle in (pitch, roll)]
        known = hold_over_gaps(np.column_stack([table, *angles]), self._last)
        self._last = known[-1] if count else self._last
        pulled = known[:, :6].copy()
        if pitch is not None:
            pulled -= gravity_components(known[:, 6], known[:, 7], gravity=self._gravity)
        return pulled

    def _net(self, force: Array | None, turn_rate: Array | None) -> Array | None:
        """Loads on the moving mass by gravity and the ground's motion, shape (m, n)."""
        if force is None:
            return None
        net = -force @ self._mass_rows.T
        if turn_rate is not None and self.dynamics.mass is not None:
            net = net - self.dynamics.mass.turning_load(np.nan_to_num(turn_rate))[:, self._rows]
        return np.asarray(net)

    # ---- learning

    def snapshot(self, component: str) -> Snapshot:
        """The last lone readings of a component, to learn from elsewhere.

        Raises
        ------
        FitError
            There are too few readings yet.
        """
        return self._part(component).snapshot()

    def adopt(self, component: str, learning: Learning) -> None:
        """Go on with a process that was learned; it holds for all samples that are not final yet."""
        self._part(component).adopt(learning)

    def _part(self, component: str) -> LiveForce:
        if component not in self._parts:
            raise ValueError(f"there is no stream of {component} yet; components: {', '.join(self.components)}")
        return self._parts[component]


def _judged(components: tuple[str, ...], readings: Array) -> Array:
    """Covariance of the noise of readings, shape (n, n)."""
    known = np.array([column[np.isfinite(column)][:1].sum() for column in readings.T])
    filled = hold_over_gaps(readings, known)
    channels = [Channel(name, column, si_unit(name)) for name, column in zip(components, filled.T, strict=True)]
    found = noise_covariance(channels, filled)
    deviation = np.sqrt(np.diag(found))
    # a channel that stands still must not seem to be known beyond all others
    alive = deviation[deviation > STILL * np.max(np.abs(filled), axis=0)]
    least = QUIET * float(np.median(alive)) if alive.size else 1.0
    return np.asarray(found + np.diag(np.where(deviation < least, least**2, 0.0)))


class _Waiting:
    """What is known of samples until the forces of all components are final.

    Parameters
    ----------
    dynamics
        The coupled components.
    interval
        Time between samples [s].
    """

    def __init__(self, dynamics: CoupledDynamics, *, interval: float) -> None:
        self._dynamics = dynamics
        n = len(dynamics.components)
        self._rows = np.array([COMPONENTS.index(name) for name in dynamics.components])
        self._passed = Passed(2 * n + 6, interval=interval)
        self._found = {name: np.zeros((0, 2)) for name in dynamics.components}
        self._first = 0
        covariance = dynamics.covariance
        size = len(dynamics.inertia)
        element = np.arange(2 * size * size).reshape(2, size, size)
        parts = [element[:, row, :n].ravel() for row in range(n)]
        self._own = np.array([covariance[np.ix_(part, part)] for part in parts])
        mass = dynamics.mass
        self._mass = np.zeros((0, n, 6)), np.zeros((0, 0))
        if mass is not None and mass.covariance.any():
            self._mass = np.array([slope[self._rows] for slope in mass_slopes(mass)]), mass.covariance

    def push(self, loads: Array, net: Array | None, force: Array | None) -> None:
        """Take loads felt, loads on the moving mass (both (m, n)) and the ground's specific force, (m, 6)."""
        count, n = loads.shape
        net = np.zeros((count, n)) if net is None else net
        force = np.zeros((count, 6)) if force is None else force
        self._passed.push(np.hstack([np.where(np.isfinite(loads), loads, np.nan), net, force]))

    def take(self, component: str, final: LiveEstimate) -> None:
        """Take samples of one component that are final."""
        new = np.column_stack([final.force, final.uncertainty**2])
        self._found[component] = np.concatenate([self._found[component], new])

    def release(self, components: tuple[str, ...]) -> dict[str, LiveEstimate]:
        """The samples whose forces are all final, with what inertia, damping and mass add to their uncertainty."""
        count = min(found.shape[0] for found in self._found.values())
        rows, rates = self._passed.release(count)
        n = len(components)
        force, variance = (
            np.column_stack([self._found[name][:count, which] for name in components]) for which in (0, 1)
        )
        loads = rows[:, :n]
        if self._own.any() or self._mass[1].any():
            variance = variance + self._spread(force, loads, rates[:, :n], rows[:, n : 2 * n], rows[:, 2 * n :])
        self._found = {name: found[count:] for name, found in self._found.items()}
        first, self._first = self._first, self._first + count
        return {
            name: LiveEstimate(first, force[:, place], np.sqrt(variance[:, place]), loads[:, place])
            for place, name in enumerate(components)
        }

    def _spread(self, force: Array, loads: Array, rate: Array, net: Array, ground: Array) -> Array:
        """Variance of the forces by inertia, damping and mass, shape (m, n): A X'' is what is left of the forces."""
        n = loads.shape[1]
        damping, inertia = self._dynamics.damping[:n, :n], self._dynamics.inertia[:n, :n]
        left = force + net - loads - rate @ damping.T
        bend = np.linalg.solve(inertia, np.nan_to_num(left).T).T
        J = np.hstack([bend, rate])
        variance = np.einsum("mi,nij,mj->mn", J, self._own, J, optimize=True)
        slopes, covariance = self._mass
        if covariance.size:
            by_mass = np.einsum("pnk,mk->mnp", slopes, ground)
            variance += np.einsum("mnp,pq,mnq->mn", by_mass, covariance, by_mass, optimize=True)
        return np.asarray(np.maximum(variance, 0.0))
