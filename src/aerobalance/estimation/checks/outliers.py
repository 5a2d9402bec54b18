"""Readings of a run that are not physical: outliers (wild samples), stuck samples, dead channels, impossible sizes.

In the loads, wild and stuck samples are made missing (NaN). In the channels of the ground's motion, stuck samples are
made missing, and wild ones are replaced by the value of a polynomial fitted to their neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.loads import Loads
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.independent import IndependentDynamics
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import STANDARD_GRAVITY, si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError, argument
from aerobalance.recording.recording import Recording
from aerobalance.recording.stuck_samples import is_dead, stuck_samples
from aerobalance.recording.wild_samples import wild_samples

DEAD: Final = 0.9
"""Share of stuck samples above which a channel is useless."""

LARGEST: Final = {"pitch": 90.0, "roll": 180.0}
"""Largest magnitude that pitch and roll can have by their definition [deg]."""

BESIDE: Final = 8
"""Readings on either side of a wild sample of the ground's motion to which a polynomial is fitted."""

DEGREE: Final = 5
"""Degree of that polynomial."""

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


def without_wild_samples(
    given: Recording | Loads, components: Sequence[str]
) -> tuple[Recording | Loads, tuple[Doubt, ...]]:
    """Return a run without its wild and stuck samples, and the doubts about wild, stuck and clipped ones.

    Parameters
    ----------
    given
        The run.
    components
        Components whose loads are examined, beside the channels of the ground's motion.

    Raises
    ------
    FitError
        More than the share `DEAD` of the samples of a load are stuck.
    """
    recording = given.recording if isinstance(given, Loads) else given
    doubts: list[Doubt] = []
    channels = dict(recording.channels)
    present = [name for name in components if name in recording]
    for name, channel in recording.channels.items():
        is_load = name in present
        if not (is_load or _of_ground(name)):
            continue
        limited = channel.at_limit
        stuck = stuck_samples(channel.values) & ~limited
        if is_load and np.mean(stuck) > DEAD:
            raise FitError(
                f"{recording.name}: {_samples(stuck)} of {stuck.size} of {name} repeat the one before: the channel "
                "was stuck or not connected, and there is no force to work out"
            )
        wild = wild_samples(np.where(limited | stuck, np.nan, channel.values))
        for component in [name] if is_load else present:
            doubts += _doubts(recording, channel, component, wild=wild, stuck=stuck, limited=limited & is_load)
        if wild.any() or stuck.any():
            values = channel.values if is_load else _filled(channel.values, wild)
            channels[name] = replace(channel, values=np.where(stuck | (wild & is_load), np.nan, values))
    if not doubts:
        return given, ()
    clean = replace(recording, channels=channels)
    if not isinstance(given, Loads):
        return clean, tuple(doubts)
    table = given.values.copy()
    for place, name in enumerate(given.components):
        if name in channels:
            table[np.isnan(channels[name].values), place] = np.nan
    return replace(given, recording=clean, values=table), tuple(doubts)


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
    return (*_doubts_of_channels(recording, dynamics, present), *sizes)


def _doubts_of_channels(recording: Recording, dynamics: BalanceDynamics, present: Sequence[str]) -> Iterator[Doubt]:
    """Doubts about channels as a whole."""
    return (
        doubt
        for name, channel in recording.channels.items()
        if name in present or _of_ground(name)
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
    usual = float(np.sqrt(np.nanmean(weight**2)))
    if usual > TOO_HEAVY * largest:
        text = (
            f"the weight of {own.mass:.6g} kg along {name} is {usual:.4g} {unit}, {usual / largest:.3g} times the "
            f"largest load that was read ({largest:.4g} {unit})"
        )
        yield Doubt("units", name, text, WEIGHT_ADVICE, None, unit)


def _of_ground(name: str) -> bool:
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


def _filled(values: Array, wild: NDArray[np.bool_]) -> Array:
    """Readings with wild ones replaced by a polynomial fitted to their neighbours, shape (n,).

    A wild one with too few sound neighbours for the fit stays as it is.
    """
    filled = values.copy()
    sound = np.isfinite(values) & ~wild
    for place in np.flatnonzero(wild):
        first = max(int(place) - BESIDE, 0)
        near = np.asarray(np.flatnonzero(sound[first : int(place) + BESIDE + 1]) + first)
        if near.size > DEGREE:
            away = (near - place) / BESIDE
            filled[place] = np.linalg.lstsq(np.vander(away, DEGREE + 1), values[near])[0][-1]
    return filled


def _doubts(
    recording: Recording,
    channel: Channel,
    component: str,
    *,
    wild: NDArray[np.bool_],
    stuck: NDArray[np.bool_],
    limited: NDArray[np.bool_],
) -> Iterator[Doubt]:
    """Doubts about the samples of a channel."""
    name, unit = channel.name, si_unit(component)
    if wild.any():
        what = "taken for missing" if name == component else "neighbours are taken instead"
        their = "its" if np.count_nonzero(wild) == 1 else "their"
        text = (
            f"{_samples(wild)} of {name} far from {their} neighbours (at {_instants(recording, wild)}), as no balance "
            f"moves: {what}"
        )
        yield Doubt("wild samples", component, text, f"keep them with {argument('keep_outliers')}", 0.0, unit)
    if stuck.any():
        text = (
            f"{_samples(stuck)} of {name} repeat the one before (from {_instants(recording, stuck)} on): they are "
            "taken for missing"
        )
        yield Doubt("stuck channel", component, text, "look at the cable and the converter of the channel", 0.0, unit)
    if limited.any():
        text = f"{_samples(limited)} of {name} rest on a limit of the channel: they are taken for missing"
        yield Doubt("clipping", component, text, "record with a larger range", 0.0, unit)


def _samples(chosen: NDArray[np.bool_]) -> str:
    count = int(np.count_nonzero(chosen))
    return "1 sample" if count == 1 else f"{count} samples"


def _instants(recording: Recording, chosen: NDArray[np.bool_]) -> str:
    """Instants at which the first three runs of chosen samples begin, in words [s]."""
    places = np.flatnonzero(chosen)
    begins = places[np.diff(places, prepend=-2) > 1]
    instants = [f"{recording.start + place / recording.rate:.6g}" for place in begins[:3]]
    return f"{', '.join(instants)}{', ...' if begins.size > len(instants) else ''} s"
