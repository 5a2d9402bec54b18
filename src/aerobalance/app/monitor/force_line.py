"""The live force at a rate that suits the natural frequencies, through gaps and new starts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.live.alignment import Aligner
from aerobalance.estimation.live.decimation import Thinner
from aerobalance.estimation.live.health import Health, Learning, LiveEstimate, Snapshot
from aerobalance.estimation.live.live_force import LiveForce
from aerobalance.motion.single_axis import AT_REST
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import FitError
from aerobalance.recording.gravity import gravity_share
from aerobalance.recording.noise import white_noise

SAMPLES_A_PERIOD: Final = 16.0
"""Samples a period of the natural frequency that the force is worked out from at least; more are thinned out."""

SETTLING: Final = 0.25
"""Time that is looked at before it is said whether the ground end moves [s]."""

CALM: Final = 5.0
"""Time without motion after which the ground end counts as at rest again [s]."""

LOOKED_AT: Final = 4096
"""Samples that are looked at for it."""

FEW: Final = 8.0
"""Part of the variance by which it may look larger than it is, times the root of the number of samples."""

LOOK: Final = 1.0
"""Time between looks at that [s]."""

FIRST_LEARNING: Final = 2.0
"""Time after a start at which the process of the force is learned, and again at twice that time, and so on [s]."""

LAST_LEARNING: Final = 10.0
"""Time after which it is learned no more, unless the readings depart from it [s]."""

LEARNED_FROM: Final = 12_000
"""Samples that it is learned from at most: enough for a display, and soon done."""


class Columns(NamedTuple):
    """Where a component finds its channels, None if not there, and how far the ground's lags the load [s]."""

    load: int
    ground: int | None
    pitch: int | None
    roll: int | None
    coupling: str
    late: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Samples of the force that have become final.

    Attributes
    ----------
    tick, step
        Tick of the first of them, and ticks from one to the next.
    force, uncertainty, load
        Force, its standard uncertainty and the load felt, shape (m,).
    """

    tick: int
    step: int
    force: Array
    uncertainty: Array
    load: Array


class Line(Protocol):
    """What the page asks of the force of one component."""

    factor: int
    interval: float

    @property
    def generation(self) -> int:
        """Which stream it is, counted: what was learned of one that has ended is kept for the next start."""

    @property
    def moving(self) -> bool:
        """Whether the ground end moves."""

    @property
    def health(self) -> Health | None:
        """State of health; None before there is a force."""

    @property
    def lag(self) -> float:
        """Time by which the force lags the readings [s]."""

    def due(self) -> Snapshot | None:
        """Return the readings to learn from, where it is time to."""

    def adopt(self, learning: Learning, *, generation: int) -> None:
        """Go on with what was learned, unless it is of a stream that has ended."""

    def weight(self, means: Array) -> float:
        """Weight along the component at mean readings of all channels, shape (c,): a zero must not take it off."""


class Stream(ABC):
    """Readings on their way to a live force: thinned out, their gaps bridged, begun anew where nothing else helps.

    Parameters
    ----------
    rate
        Sampling rate of the source [Hz].
    frequency
        Highest natural frequency [Hz].
    loads, motion
        Columns of the loads and of the other channels that are wanted.
    watched
        Which of the latter are accelerations of the ground end, to be taken as zero while they show nothing.
    late
        Times by which the loads and the other channels, in this order, lag the first load [s].
    """

    def __init__(
        self,
        *,
        rate: float,
        frequency: float,
        loads: Sequence[int],
        motion: Sequence[int],
        watched: Sequence[int],
        late: Sequence[float],
    ) -> None:
        self.factor = max(1, int(rate / (SAMPLES_A_PERIOD * frequency)))
        self.interval = self.factor / rate
        self._late = [one * rate for one in late]
        self._loads, self._wanted = len(loads), [*loads, *motion]
        self._watched = [self._wanted.index(place) for place in watched]
        self.moves = np.zeros(len(watched), dtype=np.bool_)
        self.generation = 0
        self._last = np.zeros(len(self._wanted))
        self._waiting = np.empty((0, len(self._wanted)))
        self._expected: int | None = None
        self._latency = 0
        self._running = False
        self._reset(0)

    @abstractmethod
    def _begin(self) -> None:
        """Make the live force anew, with what was learned."""

    @abstractmethod
    def _forget(self) -> None:
        """Forget what was learned."""

    @abstractmethod
    def _force(self, rows: Array) -> Mapping[str, LiveEstimate]:
        """Push thinned readings of the wanted channels into the live force, and note its latency."""

    # ---- samples in, force out

    def push(self, tick: int, values: Array) -> dict[str, Piece]:
        """Take samples of all channels in SI units, shape (n, c), the first at `tick`; return what became final."""
        wanted = values[:, self._wanted]
        if self._expected is None or not 0 <= tick - self._expected <= self._bridged:
            self._reset(tick)
        elif tick > self._expected:
            hole = np.repeat(self._last[None], tick - self._expected, axis=0)
            hole[:, : self._loads] = np.nan
            wanted = np.concatenate((hole, wanted))
        self._expected = tick + values.shape[0]
        if not wanted.shape[0]:
            return {}
        self._last = wanted[-1]
        return self._take(self._thinner.push(self._aligner.push(wanted)))

    def _take(self, rows: Array) -> dict[str, Piece]:
        self._see_ground(rows)
        if not self._running:
            self._waiting = np.concatenate((self._waiting, rows))
            if self._waiting.shape[0] * self.interval < SETTLING:
                return {}
            rows, self._waiting = self._waiting, self._waiting[:0]
            self._start()
        try:
            found = self._force(rows)
        except (ArithmeticError, np.linalg.LinAlgError, FitError):
            # readings that no filter can follow: begin anew, without what was learned from them
            self._forget()
            self._restart()
            return {}
        self.pushed += rows.shape[0]
        return {name: self._piece(final) for name, final in found.items() if final.force.size}

    def _piece(self, final: LiveEstimate) -> Piece:
        tick = self._origin + self._thinner.first + (self._begun + final.first) * self.factor
        return Piece(tick, self.factor, final.force, final.uncertainty, final.load)

    # ---- beginning, and beginning anew

    def _reset(self, tick: int) -> None:
        """Begin with the sample at a tick."""
        self._aligner = Aligner(self._late)
        self._thinner = Thinner(len(self._wanted), self.factor)
        self._origin, self._begun, self.pushed = tick, 0, 0
        self._waiting = np.empty((0, len(self._wanted)))
        self._running = False
        self._recent = np.empty((0, len(self._watched)))
        self._last = np.zeros(len(self._wanted))
        self._looked = 0.0
        self._moved = np.zeros(len(self._watched))
        self.generation += 1

    def restart(self) -> None:
        """Begin anew, keeping what was learned: the readings are counted from another zero."""
        if self._expected is not None:
            self._reset(self._expected)

    def _restart(self) -> None:
        self._begun += self.pushed
        self.pushed = 0
        self.generation += 1
        self._start()

    def _start(self) -> None:
        self._running = True
        self._begin()

    @property
    def running(self) -> bool:
        """Whether there is a live force."""
        return self._running

    @property
    def lag(self) -> float:
        """Time by which the force lags the readings [s]."""
        waits = self._thinner.first + self._aligner.ahead
        return self._latency * self.interval + waits * self.interval / self.factor

    @property
    def _bridged(self) -> int:
        """Longest gap that is bridged, in ticks."""
        return self._latency * self.factor if self._running else 0

    # ---- does the ground end move?

    def _see_ground(self, rows: Array) -> None:
        """Take the accelerometers' noise for no motion, as it would only spoil the force."""
        if not self._watched:
            return
        self._recent = np.concatenate((self._recent, rows[:, self._watched]))[-LOOKED_AT:]
        time = (self._begun + self.pushed + self._waiting.shape[0] + rows.shape[0]) * self.interval
        if time < SETTLING or (self._running and time - self._looked < LOOK):
            return
        self._looked = time
        known = self._recent[np.isfinite(self._recent).all(axis=1)]
        if known.shape[0] < 64:
            return
        limit = AT_REST * (1 + FEW / np.sqrt(known.shape[0]))
        moves = np.array([np.var(column) >= limit * white_noise(column) ** 2 for column in known.T])
        self._moved[moves] = time
        moving = moves | (self.moves & (time - self._moved < CALM))
        if (moving != self.moves).any():
            self.moves = moving
            if self._running:
                self._restart()

    @property
    def ground_noise(self) -> Array:
        """Noise of the accelerations that are used, shape (their number,); 0 for those that show nothing."""
        found = np.zeros(len(self._watched))
        if self._recent.shape[0] >= 8:
            found[self.moves] = [white_noise(column) for column in self._recent.T[self.moves]]
        return found


class Schedule:
    """When the process of a force is learned."""

    def __init__(self) -> None:
        self._generation = -1
        self._next, self._fallen = FIRST_LEARNING, False

    def due(self, health: Health, *, time: float, generation: int) -> bool:
        """Whether it is time to, so long after a start [s]."""
        if generation != self._generation:
            self._generation, self._next, self._fallen = generation, FIRST_LEARNING, False
        fallen = health.process == "fallback"
        if fallen and not self._fallen:
            self._next = time + FIRST_LEARNING
        self._fallen = fallen
        if time < self._next or (self._next > LAST_LEARNING and not health.learning_due):
            return False
        self._next = max(2 * self._next, time + FIRST_LEARNING)
        return True


class ForceLine(Stream):
    """One component.

    Parameters
    ----------
    dynamics
        Its mass, stiffness and damping.
    rate
        Sampling rate of the source [Hz].
    columns
        Where its channels are.
    """

    def __init__(self, dynamics: Dynamics, *, rate: float, columns: Columns) -> None:
        self.dynamics, self._columns = dynamics, columns
        self._learning: Learning | None = None
        self._schedule = Schedule()
        self._live: LiveForce | None = None
        self._reads_gravity = columns.coupling == "dc" and columns.ground is not None
        watched = [] if self._reads_gravity or columns.ground is None else [columns.ground]
        motion = [place for place in columns[1:4] if place is not None]
        late = [columns.late if place == columns.ground else 0.0 for place in (columns.load, *motion)]
        frequency = dynamics.natural_frequency
        super().__init__(
            rate=rate, frequency=frequency, loads=[columns.load], motion=motion, watched=watched, late=late
        )

    @property
    def moving(self) -> bool:
        """Whether the ground end moves."""
        return self._reads_gravity or bool(self.moves.any())

    def _begin(self) -> None:
        self._live = LiveForce(
            self.dynamics,
            interval=self.interval,
            learned=self._learning.learned if self._learning else None,
            learn_after=None,
            span=LEARNED_FROM * self.interval,
            ground_noise=float(np.sum(self.ground_noise)),
        )
        self._latency = self._live.latency

    def _forget(self) -> None:
        self._learning = None

    def _force(self, rows: Array) -> dict[str, LiveEstimate]:
        if self._live is None:
            return {}
        ground, pitch, roll = (
            None if place is None else rows[:, self._wanted.index(place)] for place in self._columns[1:4]
        )
        if not self.moving:
            ground = None
        if self._reads_gravity:
            pitch = roll = None
        return {
            self.dynamics.component: self._live.push(rows[:, 0], ground_acceleration=ground, pitch=pitch, roll=roll)
        }

    # ---- learning

    def due(self) -> Snapshot | None:
        """Return the readings to learn from, where it is time to."""
        live = self._live if self.running else None
        time = self.pushed * self.interval
        if live is None or not self._schedule.due(live.health, time=time, generation=self.generation):
            return None
        try:
            return live.snapshot()
        except FitError:
            return None

    def adopt(self, learning: Learning, *, generation: int) -> None:
        """Go on with what was learned, unless it is of a stream that has ended."""
        self._learning = learning
        if self._live is not None and generation == self.generation:
            self._live.adopt(learning)

    # ---- what is said of it

    @property
    def health(self) -> Health | None:
        """State of health; None before there is a force."""
        return self._live.health if self._live is not None and self.running else None

    def weight(self, means: Array) -> float:
        """Weight along the component at mean readings of all channels, shape (c,): a zero must not take it off."""
        pitch, roll = attitude(means, self._columns.pitch, self._columns.roll)
        if pitch is None:
            return 0.0
        share = gravity_share(self.dynamics.component, pitch=pitch, roll=roll)
        return float(self.dynamics.mass * STANDARD_GRAVITY * share[0])


def attitude(means: Array, pitch: int | None, roll: int | None) -> tuple[Array | None, Array]:
    """Mean pitch and roll, shape (1,) each [rad]; no pitch where none is read, and a roll of zero."""
    return None if pitch is None else means[[pitch]], np.zeros(1) if roll is None else means[[roll]]
