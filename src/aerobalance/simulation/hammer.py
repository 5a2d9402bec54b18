"""Taps with an instrumented hammer on a balance with its model, of one component or several.

The balance load is integrated mode by mode for the force as it is between the samples, by quadrature over cells that
are far shorter than a blow.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.recording.channel import IMPACT_FORCE, Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.recording import Recording
from aerobalance.simulation.drives import Signal

CELLS = 4
"""Cells of the integration per sample."""


@dataclass(frozen=True, slots=True)
class Blow:
    """One blow: a force that rises and falls as a power of half a sine.

    Attributes
    ----------
    instant, duration
        When it begins and how long it lasts [s]: a soft tip lasts longer, and excites lower frequencies only.
    peak
        Largest force [N].
    power
        Power of the half sine: 1 begins and ends with a corner, 2 smoothly.
    """

    instant: float
    peak: float
    duration: float = 0.002
    power: float = 1.5

    def force(self, time: Array) -> Array:
        """Force at times [s], shape (n,) [N]."""
        progress = np.clip((time - self.instant) / self.duration, 0.0, 1.0)
        return np.asarray(self.peak * np.sin(np.pi * progress) ** self.power, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Hammer:
    """What the channel of the force reads.

    Attributes
    ----------
    noise
        Standard deviation of one reading [N].
    gain
        Reading over force [1].
    delay
        Time by which the readings lag the loads [s].
    corner
        Corner of the first-order high-pass of a piezoelectric sensor and its amplifier [Hz]; 0 for none.
    limit
        Largest reading [N].
    """

    noise: float = 0.05
    gain: float = 1.0
    delay: float = 0.0
    corner: float = 0.0
    limit: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class Tapping:
    """Taps on a balance at rest, and their recording.

    Attributes
    ----------
    dynamics
        What rings.
    loads
        Loads of 1 N of the hammer, shape (n,) [N, N*m].
    blows
        The blows, bounces of the hammer among them.
    hammer
        What the channel of the force reads.
    noise
        Standard deviation of one reading of each load, shape (n,) [N, N*m].
    rest
        Loads at rest, shape (n,) [N, N*m].
    rate
        Sampling rate [Hz].
    shaker
        Force of a shaker over time, from 0 on [N]; None for none.
    """

    dynamics: CoupledDynamics
    loads: Array
    blows: tuple[Blow, ...]
    hammer: Hammer = field(default_factory=Hammer)
    noise: Array = field(default_factory=lambda: np.zeros(1))
    rest: Array = field(default_factory=lambda: np.zeros(1))
    rate: float = 10_000.0
    shaker: Signal | None = None

    def force(self, time: Array) -> Array:
        """Force of all blows at times [s], shape (m,) [N]."""
        force = np.zeros(time.shape)
        for blow in self.blows:
            force += blow.force(time)
        return force if self.shaker is None else force + np.where(time >= 0, self.shaker(np.maximum(time, 0.0)), 0.0)

    def felt(self, samples: int) -> Array:
        """Balance loads at the samples, shape (samples, n) [N, N*m]."""
        poles, shapes, weights = self.dynamics.modal_form
        step = 1 / (self.rate * CELLS)
        begins = np.arange(samples * CELLS) * step
        nodes, parts = np.polynomial.legendre.leggauss(4)
        places = (nodes + 1) / 2 * step
        force = self.force((begins[:, None] + places).ravel()).reshape(begins.size, -1)
        felt = np.zeros((samples, self.loads.size))
        for pole, shape, weight in zip(poles, shapes.T, weights, strict=True):
            drive = (force * np.exp(pole * (step - places)) * parts * step / 2).sum(axis=1) * (weight @ self.loads)
            state = lfilter([0.0, 1.0], [1.0, -np.exp(pole * step)], drive)
            felt += np.real(state[::CELLS, None] * shape)
        return felt

    def record(self, duration: float, generator: np.random.Generator, *, name: str = "taps") -> Recording:
        """Record for `duration` [s] from time 0.

        Parameters
        ----------
        duration
            Length of the recording [s].
        generator
            Source of the noise.
        """
        samples = round(duration * self.rate)
        time = np.arange(samples) / self.rate
        felt = self.felt(samples) + self.rest + self.noise * generator.standard_normal((samples, self.loads.size))
        names = self.dynamics.components
        columns = {one: felt[:, place] for place, one in enumerate(names)}
        units = {one: si_unit(one) for one in names}
        return Recording.from_arrays(
            time,
            columns | {IMPACT_FORCE: self._reading(time, generator)},
            units=units | {IMPACT_FORCE: "N"},
            name=name,
        )

    def _reading(self, time: Array, generator: np.random.Generator) -> Array:
        """What the channel of the force reads, shape (m,) [N]."""
        hammer = self.hammer
        reading = hammer.gain * self.force(time - hammer.delay)
        if hammer.corner:
            fall = 2 * np.pi * hammer.corner / self.rate
            reading = lfilter([1 - fall / 2, fall / 2 - 1], [1.0, -np.exp(-fall)], reading)
        reading = reading + hammer.noise * generator.standard_normal(time.size)
        return np.asarray(np.clip(reading, -hammer.limit, hammer.limit), dtype=np.float64)
