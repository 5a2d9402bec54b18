"""Six coupled components on a ground end that shakes, one of its channels wrong where that is asked for."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.force import estimate_force
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import fractional_delay
from aerobalance.simulation import BaseMotion, SixComponentRig, broadband, random_motion
from aerobalance.simulation.six_balance import random_balance
from aerobalance.simulation.six_signals import Band

RATE = 5000.0
CUT = 250
"""Samples at either end that are recorded and not used: a channel that is late has no first readings."""


@dataclass(frozen=True)
class Shaken:
    """A record with the dynamics it is read with and the truth, shape (samples, 6)."""

    recording: Recording
    dynamics: CoupledDynamics
    applied: Array

    def with_late(self, name: str, seconds: float) -> Shaken:
        """One channel is late."""
        values = self.recording.channel(name).values
        return self._with(name, fractional_delay(values, delay=seconds, interval=1 / RATE))

    def with_gain(self, name: str, gain: float) -> Shaken:
        """One channel has another gain."""
        return self._with(name, gain * self.recording.channel(name).values)

    def declared(self, delay: float) -> Shaken:
        """The delay of all channels of the ground's motion is declared [s]."""
        channels = {
            name: replace(one, delay=delay if name.startswith("ground") else one.delay)
            for name, one in self.recording.channels.items()
        }
        return replace(self, recording=replace(self.recording, channels=channels))

    @property
    def force(self) -> Force:
        """The forces; what is warned of is in their doubts."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            return estimate_force(self.recording, self.dynamics)

    @property
    def used(self) -> Shaken:
        """Without its ends."""
        inside = slice(CUT, self.recording.samples - CUT)
        return replace(self, recording=self.recording.part(inside.start, inside.stop), applied=self.applied[inside])

    def ratios(self, force: Force) -> dict[str, float]:
        """Rms of the error over that of its uncertainty, by component, a twentieth at either end left out."""
        found = {}
        inner = slice(len(self.applied) // 20, -len(self.applied) // 20)
        for place, name in enumerate(COMPONENTS):
            off, u = (force[name].values - self.applied[:, place])[inner], force[name].uncertainty[inner]
            found[name] = float(np.sqrt(np.mean(off**2) / np.mean(u**2)))
        return found

    def _with(self, name: str, values: Array) -> Shaken:
        channel = replace(self.recording.channel(name), values=values)
        return replace(self, recording=replace(self.recording, channels={**self.recording.channels, name: channel}))


def shaken(
    rng: np.random.Generator,
    *,
    motion: float = 3.0,
    load: float = 0.01,
    highest: float = 40.0,
    together: bool = False,
    **rig: Any,
) -> Shaken:
    """Draw a balance under gusts on a ground end that shakes.

    Parameters
    ----------
    rng
        Source of randomness.
    motion
        Rms of each of its accelerations [m/s^2, rad/s^2].
    load
        Rms of each load over half range.
    highest
        Highest frequency of the motion [Hz].
    together
        Whether all six motions follow one, as where it turns about one axis.
    rig
        Further settings of the rig.
    """
    duration, balance = 2.0, random_balance(rng)
    base = random_motion(rng, Band(2, highest), rms=motion * np.ones(6), period=2 * duration)
    if together:
        base = of_one(base, rng.uniform(0.3, 1.0, 6) * rng.choice([-1.0, 1.0], 6))
    gusts = broadband(rng, Band(0, 100), rms=load * balance.half_range, period=2 * duration)
    made = SixComponentRig(balance, applied=gusts, base=base, output="loads", rate=RATE, **rig).run(duration, rng)
    return Shaken(made.recording, replace(balance.dynamics, mass=balance.mass), made.applied)


def of_one(base: BaseMotion, shares: Array) -> BaseMotion:
    """A motion of which all six accelerations are shares of that in pitch."""
    turns = shares[[COMPONENTS.index(name) for name in MOMENTS]]
    pitch, first = COMPONENTS.index("PM"), MOMENTS.index("PM")
    return BaseMotion(
        lambda time: base.acceleration(time)[:, [pitch]] * shares,
        lambda time: base.rate(time)[:, [first]] * turns,
        lambda time: base.angle(time)[:, [first]] * turns,
    )
