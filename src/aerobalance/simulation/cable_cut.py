"""The cable cut: a pulled model let go, sections 2.3 and 5 of [Gorbushin2020]_."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.recording import Recording
from aerobalance.simulation.drives import Signal
from aerobalance.simulation.oscillator import Input, Oscillator
from aerobalance.simulation.published import CABLE_CUT
from aerobalance.simulation.sensors import Sensor, Simulation, accelerometer, integration_grid, read_channels


def _cable_sensors() -> dict[str, Sensor]:
    deviation = CABLE_CUT.acceleration_deviation.value
    return {
        "AF": Sensor(noise=CABLE_CUT.dynamic_deviation.value),
        "ground_acceleration": accelerometer(deviation),
        "live_acceleration": accelerometer(deviation),
        "pitch": Sensor(),
    }


@dataclass(frozen=True, slots=True)
class CableCut:
    """Balance 6-EB-128-1 with a model, pulled by a cable that is burnt through, in or out of other loads and motion.

    Attributes
    ----------
    dynamics
        Moving mass, stiffness and damping, and further modes, whose shares hold for all loads; its delay is not used
        (sensors have delays of their own).
    cable_force
        Force of the cable on the model before the release [N], aft positive.
    release
        Instant at which the cable begins to let go [s]; any instant, not only one of a sample.
    release_duration
        Time within which the cable force falls to zero on a straight line [s].
    applied
        Further force on the model over time [N], or None. Signals are asked for times before 0 too.
    ground_acceleration
        Axial acceleration of the ground end over time [m/s^2], or None for a ground end at rest.
    pitch
        Pitch angle over time [rad], or None for a level balance.
    rate
        Sampling rate [Hz].
    sensors
        Sensors by channel: AF, ground_acceleration, live_acceleration, pitch. A channel without one is not recorded.
    oversampling
        Points of the integration grid per sample.
    """

    dynamics: Dynamics = field(default_factory=lambda: CABLE_CUT.dynamics)
    cable_force: float = -CABLE_CUT.excitation.value
    release: float = 1.0003
    release_duration: float = 0.0
    applied: Signal | None = None
    ground_acceleration: Signal | None = None
    pitch: Signal | None = None
    rate: float = CABLE_CUT.rate.value
    sensors: Mapping[str, Sensor] = field(default_factory=_cable_sensors)
    oversampling: int = 8

    def cable(self, time: Array) -> Array:
        """Force of the cable over time [N]."""
        since = time - self.release
        if self.release_duration:
            return self.cable_force * np.clip(1 - since / self.release_duration, 0.0, 1.0)
        return np.where(since < 0, self.cable_force, 0.0)

    def run(self, duration: float, generator: np.random.Generator) -> Simulation:
        """Record for `duration` [s] from time 0; loads and motion have been going on before.

        Parameters
        ----------
        duration
            Length of the recording [s].
        generator
            Source of the randomness of the sensors.
        """
        M = self.dynamics.mass
        modes = self.dynamics.modes
        springs = [Oscillator.of(mode) for mode in modes]
        clock = np.arange(round(duration * self.rate)) / self.rate
        slowest = min(-spring.pole.real for spring in springs)
        before = min(10.0, 8 / slowest) if slowest else 0.0
        grid = integration_grid(clock, self.rate * self.oversampling, self.sensors, before=before)
        other = self.applied or _nothing
        shaking = self.ground_acceleration or _nothing
        pitch = self.pitch or _nothing
        push = Input.through(other(grid) / M + STANDARD_GRAVITY * np.sin(pitch(grid)) - shaking(grid), grid)
        states = [spring.state(push) for spring in springs]

        def motions(time: Array) -> list[tuple[Array, Array]]:
            found = []
            for spring, state in zip(springs, states, strict=True):
                fall = spring.fall(time, instant=self.release, duration=self.release_duration)
                rest = spring.between(state, push, time=time)
                found.append(spring.motion(rest + self.cable_force / M * fall))
            return found

        def load(time: Array) -> Array:
            parts = zip(modes, springs, motions(time), strict=True)
            return np.asarray(M * sum(mode.share * spring.stiffness * y for mode, spring, (y, _) in parts))

        def live(time: Array) -> Array:
            net = self.cable(time) / M + push.at(time)
            moved = np.zeros(time.shape)
            for mode, spring, (y, velocity) in zip(modes, springs, motions(time), strict=True):
                size = mode.share * spring.stiffness / springs[0].stiffness
                moved += size * (net - spring.stiffness * y - spring.damping * velocity)
            return moved + shaking(time)

        signals: dict[str, Signal] = {"AF": load, "ground_acceleration": shaking, "live_acceleration": live}
        channels = read_channels(signals | {"pitch": pitch}, self.sensors, clock=clock, grid=grid, generator=generator)
        return Simulation(
            recording=Recording.from_columns(clock, channels, name="cable cut"),
            applied=self.cable(clock) + other(clock),
            load=load(clock),
            ground_acceleration=shaking(clock),
            pitch=pitch(clock),
            drive=np.zeros(clock.size),
            release=self.release,
        )


def _nothing(time: Array) -> Array:
    return np.zeros(time.shape)
