"""Readings of a run that are not physical: outliers (wild samples), stuck and clipped ones.

In the loads, wild and stuck samples are made missing (NaN); clipped ones are told of here and left out where the load
is read. Where loads come from gauge outputs, all are missing where a bridge was stuck or on a limit: each needs it.
In the channels of the ground's motion, stuck and clipped samples are made missing, and wild ones are replaced by the
value of a polynomial fitted to their neighbours. Angles may rest on a reading, so none of them is stuck.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.loads import Loads
from aerobalance.estimation.checks.impossible_channels import is_of_ground
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError, argument
from aerobalance.recording.recording import Recording
from aerobalance.recording.stuck_samples import stuck_samples
from aerobalance.recording.wild_samples import wild_samples

DEAD: Final = 0.9
"""Share of stuck samples above which a channel is useless."""

BESIDE: Final = 8
"""Readings on either side of a wild sample of the ground's motion to which a polynomial is fitted."""

DEGREE: Final = 5
"""Degree of that polynomial."""

FEWEST_A_SIDE: Final = 3
"""Sound readings on either side for that degree. With fewer it is a straight line: beyond its readings a polynomial of
degree five enlarges their noise a hundred times and more."""


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
    if isinstance(given, Loads):
        doubts += _of_bridges(given, present)
        channels |= _without_bridges(given, present)
    for name, channel in list(channels.items()):
        is_load = name in present
        if not (is_load or is_of_ground(name)):
            continue
        limited = channel.at_limit
        rests = channel.unit == "rad"
        stuck = np.zeros(limited.size, dtype=np.bool_) if rests else stuck_samples(channel.values) & ~limited
        unread = stuck | (limited & (not is_load and not rests))
        if is_load and np.mean(stuck) > DEAD:
            raise FitError(
                f"{recording.name}: {_samples(stuck)} of {stuck.size} of {name} repeat the one before: the channel "
                "was stuck or not connected, and there is no force to work out"
            )
        unsure = limited | stuck
        wild = wild_samples(np.where(unsure, np.nan, channel.values) if unsure.any() else channel.values)
        if not (wild.any() or unsure.any()):  # as in most records
            continue
        for component in [name] if is_load else present:
            doubts += _doubts(recording, channel, component, wild=wild, stuck=stuck, limited=limited & (not rests))
        if wild.any() or unread.any():
            values = np.where(unread, np.nan, channel.values)
            channels[name] = replace(
                channel, values=np.where(wild, np.nan if is_load else _filled(values, wild), values)
            )
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


def _without_bridges(given: Loads, components: Sequence[str]) -> dict[str, Channel]:
    """The loads without those of instants at which a bridge has no reading; none where all have."""
    bad = [some.any(axis=1) for some in (given.stuck, given.clipped) if some is not None]
    if not bad:
        return {}
    lost, found = np.any(bad, axis=0), {name: given.recording.channel(name) for name in components}
    return {name: replace(one, values=np.where(lost, np.nan, one.values)) for name, one in found.items()}


def _of_bridges(given: Loads, components: Sequence[str]) -> Iterator[Doubt]:
    """Doubts about readings of the bridges that loads come from, for every component: each load needs all of them."""
    told = (
        ("stuck channel", given.stuck, "repeat the one before", "look at the bridge, its cable and its amplifier"),
        ("clipping", given.clipped, "rest on a limit of the channel", "record with a larger range"),
    )
    for kind, found, what, advice in told:
        if found is None:
            continue
        for place in np.flatnonzero(found.any(axis=0)):
            some = found[:, place]
            text = (
                f"{_samples(some)} of r{given.balance.gauges[place]} {what} (from {_instants(given.recording, some)} "
                "on): all loads are taken for missing there"
            )
            for name in components:
                yield Doubt(kind, name, text, advice, 0.0, si_unit(name))


def _filled(values: Array, wild: NDArray[np.bool_]) -> Array:
    """Readings with wild ones replaced by a polynomial fitted to their neighbours, shape (n,).

    A wild one without sound neighbours is missing.
    """
    filled = np.where(wild, np.nan, values)
    sound = np.isfinite(filled)
    for place in np.flatnonzero(wild):
        first = max(int(place) - BESIDE, 0)
        near = np.asarray(np.flatnonzero(sound[first : int(place) + BESIDE + 1]) + first)
        if near.size > 1:
            sides = np.count_nonzero(near < place), np.count_nonzero(near > place)
            degree = DEGREE if min(sides) >= FEWEST_A_SIDE else 1
            away = (near - place) / BESIDE
            filled[place] = np.linalg.lstsq(np.vander(away, degree + 1), values[near])[0][-1]
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
