"""The live force of one component, at a rate that suits its natural frequency, through gaps and new starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from aerobalance.channel import Array
from aerobalance.components import STANDARD_GRAVITY
from aerobalance.dynamics import Dynamics
from aerobalance.live_state import Health, Learning, Snapshot
from aerobalance.motion import AT_REST, gravity_share
from aerobalance.noise import white_noise
from aerobalance.problems import FitError
from aerobalance.stream import LiveForce
from aerobalance.thinning import Thinner

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
    """Where a component finds its channels; None for those that are not there."""

    load: int
    ground: int | None
    pitch: int | None
    roll: int | None
    coupling: str


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


class ForceLine:
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
        self.factor = max(1, int(rate / (SAMPLES_A_PERIOD * dynamics.natural_frequency)))
        self.interval = self.factor / rate
        self._wanted = [columns.load, *(place for place in columns[1:4] if place is not None)]
        self.moving = columns.coupling == "dc"
        self._learning: Learning | None = None
        self.generation = 0
        self._expected: int | None = None
        self._live: LiveForce | None = None
        self._waiting = self._last = self._recent = np.empty(0)
        self._reset(0)

    # ---- samples in, force out

    def push(self, tick: int, values: Array) -> Piece | None:
        """Take samples of all channels in SI units, shape (n, c), the first at `tick`; return what became final."""
        wanted = values[:, self._wanted]
        if self._expected is None or not 0 <= tick - self._expected <= self._bridged:
            self._reset(tick)
        elif tick > self._expected:
            hole = np.repeat(self._last[None], tick - self._expected, axis=0)
            hole[:, 0] = np.nan
            wanted = np.concatenate((hole, wanted))
        self._expected = tick + values.shape[0]
        if not wanted.shape[0]:
            return None
        self._last = wanted[-1]
        return self._take(self._thinner.push(wanted))

    def _take(self, rows: Array) -> Piece | None:
        self._see_ground(rows)
        if self._live is None:
            self._waiting = np.concatenate((self._waiting, rows))
            if self._waiting.shape[0] * self.interval < SETTLING:
                return None
            rows, self._waiting = self._waiting, self._waiting[:0]
            self._live = self._made()
        live = self._live
        ground, pitch, roll = self._motion(rows)
        try:
            found = live.push(rows[:, 0], ground_acceleration=ground, pitch=pitch, roll=roll)
        except (ArithmeticError, np.linalg.LinAlgError, FitError):
            # readings that no filter can follow: begin anew, without what was learned from them
            self._learning = None
            self._restart()
            return None
        self._pushed += rows.shape[0]
        if not found.force.size:
            return None
        tick = self._origin + self._thinner.first + (self._begun + found.first) * self.factor
        return Piece(tick, self.factor, found.force, found.uncertainty, found.load)

    def _motion(self, rows: Array) -> tuple[Array | None, Array | None, Array | None]:
        places = {name: None if place is None else rows[:, self._wanted.index(place)] for name, place in self._ends}
        if not self.moving:
            places["ground"] = None
        if self._columns.coupling == "dc" and places["ground"] is not None:
            return places["ground"], None, None
        return places["ground"], places["pitch"], places["roll"]

    @property
    def _ends(self) -> tuple[tuple[str, int | None], ...]:
        return (("ground", self._columns.ground), ("pitch", self._columns.pitch), ("roll", self._columns.roll))

    # ---- beginning, and beginning anew

    def _reset(self, tick: int) -> None:
        """Begin with the sample at a tick."""
        self._thinner = Thinner(len(self._wanted), self.factor)
        self._origin, self._begun, self._pushed = tick, 0, 0
        self._waiting = np.empty((0, len(self._wanted)))
        self._live = None
        self._recent = np.empty(0)
        self._last = np.zeros(len(self._wanted))
        self._looked, self._moved = 0.0, 0.0
        self._learn_at, self._fallen = FIRST_LEARNING, False
        self.generation += 1

    def restart(self) -> None:
        """Begin anew, keeping what was learned: the readings are counted from another zero."""
        if self._expected is not None:
            self._reset(self._expected)

    def _restart(self) -> None:
        self._begun += self._pushed
        self._pushed, self._learn_at = 0, FIRST_LEARNING
        self.generation += 1
        self._live = self._made()

    def _made(self) -> LiveForce:
        noise = 0.0
        if self.moving and self._recent.size >= 8:
            noise = white_noise(self._recent)
        return LiveForce(
            self.dynamics,
            interval=self.interval,
            learned=self._learning.learned if self._learning else None,
            learn_after=None,
            span=LEARNED_FROM * self.interval,
            ground_noise=noise,
        )

    @property
    def _bridged(self) -> int:
        """Longest gap that is bridged, in ticks."""
        return 0 if self._live is None else self._live.latency * self.factor

    # ---- does the ground end move?

    def _see_ground(self, rows: Array) -> None:
        """Take the accelerometer's noise for no motion, as it would only spoil the force."""
        if self._columns.ground is None or self._columns.coupling == "dc":
            return
        values = rows[:, self._wanted.index(self._columns.ground)]
        self._recent = np.concatenate((self._recent, values))[-LOOKED_AT:]
        time = (self._begun + self._pushed + self._waiting.shape[0] + rows.shape[0]) * self.interval
        settled = self._live is not None
        if time < SETTLING or (settled and time - self._looked < LOOK):
            return
        self._looked = time
        known = self._recent[np.isfinite(self._recent)]
        if known.size < 64:
            return
        limit = AT_REST * (1 + FEW / np.sqrt(known.size))
        moves = bool(np.var(known) >= limit * white_noise(known) ** 2)
        self._moved = time if moves else self._moved
        moving = moves or (self.moving and time - self._moved < CALM)
        if moving != self.moving:
            self.moving = moving
            if self._live is not None:
                self._restart()

    # ---- learning

    def due(self) -> Snapshot | None:
        """Return the readings to learn from, where it is time to."""
        live = self._live
        if live is None:
            return None
        time = self._pushed * self.interval
        fallen = live.health.process == "fallback"
        if fallen and not self._fallen:
            self._learn_at = time + FIRST_LEARNING
        self._fallen = fallen
        if time < self._learn_at or (self._learn_at > LAST_LEARNING and not live.health.learning_due):
            return None
        self._learn_at = max(2 * self._learn_at, time + FIRST_LEARNING)
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
        return None if self._live is None else self._live.health

    @property
    def lag(self) -> float:
        """Time by which the force lags the readings [s]."""
        latency = 0 if self._live is None else self._live.latency
        return latency * self.interval + self._thinner.first * self.interval / self.factor

    def weight(self, means: Array) -> float:
        """Weight along the component at mean readings of all channels, shape (c,): a zero must not take it off."""
        pitch, roll = self._columns.pitch, self._columns.roll
        if pitch is None:
            return 0.0
        angles = np.array([means[pitch], 0.0 if roll is None else means[roll]])
        share = gravity_share(self.dynamics.component, pitch=angles[:1], roll=angles[1:])
        return float(self.dynamics.mass * STANDARD_GRAVITY * share[0])
