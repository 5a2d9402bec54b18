"""Simulated recordings of taps with an instrumented hammer (impact tests) on a balance with its model.

The force is known at any time, between the samples too. Each mode z' = pole z + weight @ load is integrated over cells
that are far shorter than a blow, z(t + h) = exp(pole h) z(t) + integral of exp(pole (t + h - s)) weight @ load(s) ds
from t to t + h, by Gauss-Legendre quadrature with four nodes; the balance loads are the sum of the modes.
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
"""Cells of the integration per sample: at 10 kHz a blow of 2 ms has 80, with four nodes each."""


@dataclass(frozen=True, slots=True)
class Blow:
    """One blow: a force in the shape of a half sine, raised to a power.

    Duration and power are assumed where they are not given.

    Attributes
    ----------
    instant, duration
        When it begins and how long it lasts [s]: with a soft tip longer, which excites lower frequencies only.
    peak
        Largest force [N].
    power
        Exponent of the half sine [1]: with 1 the force begins and ends with a corner, with 2 smoothly.
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
    """Force sensor of the hammer with its channel: how readings differ from the force. The noise is assumed.

    Attributes
    ----------
    noise
        Standard deviation of one reading [N].
    gain
        Reading over force [1].
    delay
        Time by which the readings lag the loads [s].
    corner
        Corner frequency of the first-order high-pass of a piezoelectric sensor and its amplifier [Hz]; 0 for none.
    limit
        Reading at which the channel is saturated, either way [N].
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
        Dynamics of the n components.
    loads
        Load on each component by 1 N of the hammer, shape (n,) [1, m]: the direction and the lever arms of the blow.
    blows
        The blows, bounces of the hammer among them.
    hammer
        Its force sensor.
    noise
        Standard deviation of one reading of each load, shape (n,) [N, N*m].
    rest
        Balance loads at rest, such as the weight, shape (n,) [N, N*m].
    rate
        Sampling rate [Hz].
    shaker
        Force [N] of a shaker at the same point as a function of time, from 0 on; None for none.
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
        """Force of all blows and of the shaker at times [s], shape (m,) [N]."""
        force = np.zeros(time.shape)
        for blow in self.blows:
            force += blow.force(time)
        return force if self.shaker is None else force + np.where(time >= 0, self.shaker(np.maximum(time, 0.0)), 0.0)

    def felt(self, samples: int) -> Array:
        """Balance loads at the samples without noise and loads at rest, shape (samples, n) [N, N*m]."""
        poles, shapes, weights = self.dynamics.modal_form
        step = 1 / (self.rate * CELLS)
        begins = np.arange(samples * CELLS) * step
        nodes, node_weights = np.polynomial.legendre.leggauss(4)
        places = (nodes + 1) / 2 * step
        force = self.force((begins[:, None] + places).ravel()).reshape(begins.size, -1)
        felt = np.zeros((samples, self.loads.size))
        for pole, shape, weight in zip(poles, shapes.T, weights, strict=True):
            drive = (force * np.exp(pole * (step - places)) * node_weights * step / 2).sum(axis=1) * (
                weight @ self.loads
            )
            state = lfilter([0.0, 1.0], [1.0, -np.exp(pole * step)], drive)
            felt += np.real(state[::CELLS, None] * shape)
        return felt

    def record(self, duration: float, generator: np.random.Generator, *, name: str = "taps") -> Recording:
        """Return the recording of taps: balance loads [N, N*m] and the channel of the force [N].

        Parameters
        ----------
        duration
            Length of the recording, from time 0 [s].
        generator
            Source of the noise.
        name
            What to call the recording.
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
        """Readings of the hammer's force sensor, shape (m,) [N]."""
        hammer = self.hammer
        reading = hammer.gain * self.force(time - hammer.delay)
        if hammer.corner:
            # s / (s + omega): zero at z = 1, pole at exp(-omega h), and gain 1 far above the corner to first order in
            # omega h
            omega_step = 2 * np.pi * hammer.corner / self.rate
            reading = lfilter([1 - omega_step / 2, omega_step / 2 - 1], [1.0, -np.exp(-omega_step)], reading)
        reading = reading + hammer.noise * generator.standard_normal(time.size)
        return np.asarray(np.clip(reading, -hammer.limit, hammer.limit), dtype=np.float64)
