"""Gravity along the balance, from the angles that a recording has."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from aerobalance.motion.at_rest import AT_REST
from aerobalance.motion.sensors import on_clock_with_gaps
from aerobalance.recording.channel import Array
from aerobalance.recording.gravity import Gravity
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording


@dataclass(frozen=True, slots=True, eq=False)
class Attitude:
    """Gravity at the angles that were recorded.

    Attributes
    ----------
    acceleration
        Gravity in the order of the components, shape (n, 6) [m/s^2].
    gravity
        Its size [m/s^2].
    angles
        Pitch and roll as far as they were recorded, gaps filled, shape (n,) each [rad].
    slopes
        Derivatives of `acceleration` by them, shape (n, 6) each [m/s^2 per rad].
    noise
        Standard uncertainty of one reading of each [rad].
    assumptions
        What had to be taken as constant.
    gaps
        Errors within the gaps of each, shape (n, k) [rad].
    delays
        Times by which the angles that move lag the clock [s].
    """

    acceleration: Array
    gravity: float
    angles: dict[str, Array]
    slopes: dict[str, Array]
    noise: dict[str, float]
    assumptions: tuple[str, ...]
    gaps: dict[str, Array] = field(default_factory=dict)
    delays: tuple[float, ...] = ()

    @classmethod
    def of(cls, recording: Recording, gravity: float, *, delay: float) -> Attitude:
        """Take the angles as if they had a delay [s], that of the sensors."""
        nothing = np.zeros(recording.samples)
        if "pitch" not in recording:
            rolled = ", and the roll with it" if "roll" in recording else ""
            said = f"pitch is not recorded and taken as constant{rolled}; a constant weight is left out"
            return cls(np.broadcast_to(0.0, (recording.samples, 6)), gravity, {}, {}, {}, (said,))
        names = [name for name in ("pitch", "roll") if name in recording]
        both = {name: on_clock_with_gaps(recording, recording.channel(name), delay) for name in names}
        angles = {name: values for name, (values, _) in both.items()}
        pull = Gravity.of(angles["pitch"], angles.get("roll", nothing), gravity=gravity)
        noise = {name: channel_noise(recording.channel(name)) for name in names}
        moving = [name for name in names if np.var(angles[name]) > AT_REST * noise[name] ** 2]
        return cls(
            pull.acceleration,
            gravity,
            angles,
            {name: pull.slopes[name] for name in names},
            noise,
            (),
            {name: gaps for name, (_, gaps) in both.items()},
            tuple(recording.channel(name).delay for name in moving),
        )
