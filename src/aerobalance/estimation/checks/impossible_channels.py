"""Channels of a run that cannot be what they are said to be: dead ones, impossible angles, loads of another size."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from aerobalance.balance.loads import Loads
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import IndependentDynamics
from aerobalance.dynamics.rigid_body import FARTHEST, TOO_FAR
from aerobalance.dynamics.rigid_body import UNITS_ADVICE as MASS_ADVICE
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import MOMENTS, STANDARD_GRAVITY, si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.recording import Recording
from aerobalance.recording.stuck_samples import is_dead

LARGEST: Final = {"pitch": 90.0, "roll": 180.0}
"""Largest magnitude that pitch and roll can have by their definition [deg]."""

TOO_LARGE: Final = 300.0
"""Load over the largest one that the dynamics were identified with, from which its unit is asked about."""

TOO_HEAVY: Final = 10.0
"""Weight over the largest load read, from which mass and unit are asked about: the load contains the weight."""

UNIT_ADVICE: Final = (
    "check the unit of the channel, such as N for kN; if it is right, look whether dynamics that were found at so "
    "small a load hold there"
)
"""What to do about a load that is far larger than those that the dynamics were identified with."""

WEIGHT_ADVICE: Final = (
    "check the mass, the angle, the unit of the load, and whether the load was zeroed under the weight, which is then "
    "taken off it once more"
)
"""What to do about a weight that is far larger than the load."""


def impossible_channels(given: Recording | Loads, dynamics: BalanceDynamics) -> tuple[Doubt, ...]:
    """Return the doubts about channels as a whole: dead ones, impossible angles, and loads of an impossible size.

    Parameters
    ----------
    given
        The run.
    dynamics
        Dynamics of the components whose loads are examined, beside the channels of the ground's motion: a doubt about
        a load is returned for each component whose force depends on that load.
    """
    recording = given.recording if isinstance(given, Loads) else given
    present = [name for name in dynamics.components if name in recording]
    sizes = (doubt for name in present for doubt in _doubts_of_size(recording, dynamics.block_of(name), name))
    return (*_doubts_of_channels(recording, dynamics, present), *sizes, *_doubts_of_mass(dynamics, present))


def _doubts_of_mass(dynamics: BalanceDynamics, present: Sequence[str]) -> Iterator[Doubt]:
    """Doubts about units, where forces and moments together make a mass of no model's size."""
    mass = dynamics.mass if isinstance(dynamics, CoupledDynamics) else None
    if mass is not None and mass.reach > FARTHEST:
        text = f"the mass of the dynamics reaches {mass.reach:.3g} m from the centre of the balance; {TOO_FAR}"
        for name in present:
            if name in MOMENTS:
                yield Doubt("units", name, text, MASS_ADVICE, None, si_unit(name))


def _doubts_of_channels(recording: Recording, dynamics: BalanceDynamics, present: Sequence[str]) -> Iterator[Doubt]:
    """Doubts about channels as a whole."""
    return (
        doubt
        for name, channel in recording.channels.items()
        if name in present or is_of_ground(name)
        for component in (dynamics.block_of(name).components if name in present else present)
        if component in present
        for doubt in _doubts_of_channel(recording, channel, component)
    )


def _doubts_of_size(recording: Recording, dynamics: BalanceDynamics, name: str) -> Iterator[Doubt]:
    """Doubts about the unit of a load, or the mass, by what the dynamics say of their sizes."""
    own = dynamics.get(name) if isinstance(dynamics, IndependentDynamics) else None
    if own is None:
        return
    unit, load = si_unit(name), np.abs(recording.channel(name).values)
    largest = float(np.nanmax(load, initial=0.0))
    if own.identified_load > 0 and largest > TOO_LARGE * own.identified_load:
        text = (
            f"{name} reads up to {largest:.4g} {unit}, {largest / own.identified_load:.3g} times the largest load "
            f"that its dynamics were identified with ({own.identified_load:.4g} {unit})"
        )
        yield Doubt("units", name, text, UNIT_ADVICE, None, unit)
    if "pitch" not in recording or not largest:
        return
    roll = recording.channel("roll").values if "roll" in recording else np.zeros(recording.samples)
    weight = own.weight(name, pitch=recording.channel("pitch").values, roll=roll, gravity=STANDARD_GRAVITY)
    weight = weight[np.isfinite(weight)]
    usual = float(np.sqrt(np.mean(weight**2))) if weight.size else 0.0
    if usual > TOO_HEAVY * largest:
        text = (
            f"the weight of {own.mass:.6g} kg along {name} is {usual:.4g} {unit}, {usual / largest:.3g} times the "
            f"largest load that was read ({largest:.4g} {unit})"
        )
        yield Doubt("units", name, text, WEIGHT_ADVICE, None, unit)


def is_of_ground(name: str) -> bool:
    """Return whether a channel tells the motion or the attitude of the ground."""
    return name.startswith("ground_") or name in LARGEST


def _doubts_of_channel(recording: Recording, channel: Channel, component: str) -> Iterator[Doubt]:
    """Doubts about a channel as a whole."""
    name, unit = channel.name, si_unit(component)
    angle = name in LARGEST
    # a channel without noise, as of a simulation, may be constant
    if not angle and channel.noise != 0 and is_dead(channel.values):
        reading = float(channel.values[np.isfinite(channel.values)][0])
        text = f"{name} reads {reading:.6g} {channel.unit} in all {recording.samples} samples: the channel is dead"
        size = abs(reading) if name == component and reading else None  # all of the load may be wrong
        yield Doubt("stuck channel", component, text, "look at the cable and the converter of the channel", size, unit)
    largest = float(np.degrees(np.nanmax(np.abs(channel.values), initial=0.0))) if angle else 0.0
    if largest > LARGEST.get(name, np.inf) * (1 + 1e-9):
        text = (
            f"{name} is up to {largest:.4g} deg, more than the {LARGEST[name]:g} deg that it can be: degrees that are "
            f"called radians, or the angle of something else; the weight along {component} is wrong by it"
        )
        yield Doubt("attitude range", component, text, f"check the unit of {name}", None, unit)
