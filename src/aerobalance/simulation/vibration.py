"""Simulated base excitation: a balance upright on a shaker, sections 2.1 and 4 of [Gorbushin2020]_."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.recording import Recording
from aerobalance.simulation.drives import Drive, Signal
from aerobalance.simulation.oscillator import Input, Oscillator
from aerobalance.simulation.published import VIBRATION_RIG
from aerobalance.simulation.sensors import Sensor, Simulation, accelerometer, integration_grid, read_channels

ARMATURE_MASS: Final = 2.07
"""Mass of the shaker's armature with the ground end of 6F-540 [kg]; assumed, see `VibrationRig`."""


def _vibration_sensors() -> dict[str, Sensor]:
    """Return the sensors of the paper's rig, with the noise that is printed."""
    deviation = VIBRATION_RIG.acceleration_deviation.value
    return {
        "AF": Sensor(noise=VIBRATION_RIG.dynamic_deviation.value),
        "ground_acceleration": accelerometer(deviation),
        "live_acceleration": accelerometer(deviation),
    }


@dataclass(frozen=True, slots=True)
class VibrationRig:
    """Balance 6F-540 upright on a shaker: two free masses, armature and live end, joined by a spring with a damper.

    The shaker drives the armature, to which the ground end is fixed; its soft suspension carries the weight and
    nothing else. The armature's mass is not printed: 2.07 kg gives the printed free-free natural frequency of 752 Hz.

    Attributes
    ----------
    dynamics
        Moving mass, stiffness and damping; its delay is not used (sensors have delays of their own).
    armature_mass
        Mass of armature and ground end [kg].
    rate
        Sampling rate [Hz].
    sensors
        Sensors by channel: AF, ground_acceleration, live_acceleration. A channel without a sensor is not recorded.
    oversampling
        Points of the integration grid per sample.
    """

    dynamics: Dynamics = field(default_factory=lambda: VIBRATION_RIG.dynamics)
    armature_mass: float = ARMATURE_MASS
    rate: float = VIBRATION_RIG.rate.value
    sensors: Mapping[str, Sensor] = field(default_factory=_vibration_sensors)
    oversampling: int = 4

    def __post_init__(self) -> None:
        if self.dynamics.further_modes:
            raise ValueError("the vibration rig has one mode; shake a cable cut's ground end for more")

    def run(self, drive: Drive, generator: np.random.Generator) -> Simulation:
        """Return the recording of the balance shaken from rest, with the true load and motion.

        Parameters
        ----------
        drive
            Force of the shaker.
        generator
            Source of all randomness of drive and sensors.
        """
        clock = np.arange(round(drive.duration * self.rate)) / self.rate
        grid = integration_grid(clock, self.rate * self.oversampling, self.sensors, before=0.0)
        force = Input.through(drive.signal(generator)(grid), grid)
        # y, the travel of the live end relative to the ground end, obeys one oscillator of the reduced mass:
        # y'' = -(k y + b y') (1 / M + 1 / armature) - force / armature.
        M, k, b = self.dynamics.mass, self.dynamics.stiffness, self.dynamics.damping
        mode = Oscillator(mass=M * self.armature_mass / (M + self.armature_mass), stiffness=k, damping=b)
        push = Input.through(-force.values / self.armature_mass, grid)
        state = mode.state(push)

        def motion(time: Array) -> tuple[Array, Array]:
            return mode.motion(mode.between(state, push, time=time))

        def load(time: Array) -> Array:
            return k * motion(time)[0] + M * STANDARD_GRAVITY

        def ground(time: Array) -> Array:
            y, velocity = motion(time)
            return (force.at(time) + k * y + b * velocity) / self.armature_mass

        def live(time: Array) -> Array:
            y, velocity = motion(time)
            return -(k * y + b * velocity) / M

        signals: dict[str, Signal] = {"AF": load, "ground_acceleration": ground, "live_acceleration": live}
        channels = read_channels(signals, self.sensors, clock=clock, grid=grid, generator=generator)
        upright = np.full(clock.size, np.pi / 2)
        channels["pitch"] = Channel("pitch", upright.copy(), "rad")
        return Simulation(
            recording=Recording.from_columns(clock, channels, name="vibration rig"),
            applied=np.zeros(clock.size),
            load=load(clock),
            ground_acceleration=ground(clock),
            pitch=upright,
            drive=force.at(clock),
            release=float("nan"),
        )
