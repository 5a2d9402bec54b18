"""Wild samples of a run: taken for missing in the loads, and filled by their neighbours in the ground's motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from aerobalance.balance.loads import Loads
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import argument
from aerobalance.recording.recording import Recording
from aerobalance.recording.wild_samples import wild_samples

BESIDE = 8
"""Readings on either side by which a wild sample of the ground's motion is filled."""


def without_wild_samples(
    given: Recording | Loads, components: Sequence[str]
) -> tuple[Recording | Loads, tuple[Doubt, ...]]:
    """Return a run without its wild samples, and what is to be said of them.

    Parameters
    ----------
    given
        The run.
    components
        Components whose loads are looked at, beside the channels of the ground's motion.
    """
    recording = given.recording if isinstance(given, Loads) else given
    doubts: list[Doubt] = []
    channels = dict(recording.channels)
    present = [name for name in components if name in recording]
    for name, channel in recording.channels.items():
        is_load = name in present
        if not (is_load or name.startswith("ground_") or name in ("pitch", "roll")):
            continue
        wild = wild_samples(np.where(channel.at_limit, np.nan, channel.values))
        if not wild.any():
            continue
        if is_load:
            values = np.where(wild, np.nan, channel.values)
            what = "they are taken for missing"
        else:
            values = _filled(channel.values, wild)
            what = "their neighbours are taken in their place"
        channels[name] = replace(channel, values=values)
        doubts += [_doubt(recording, channel, wild, component, what) for component in ([name] if is_load else present)]
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


def _filled(values: Array, wild: NDArray[np.bool_]) -> Array:
    """Readings with the wild ones on the cubic spline through those about them, shape (n,)."""
    filled = values.copy()
    sound = np.isfinite(values) & ~wild
    for place in np.flatnonzero(wild):
        first = max(int(place) - BESIDE, 0)
        near = np.asarray(np.flatnonzero(sound[first : int(place) + BESIDE + 1]) + first)
        if near.size >= 4:
            filled[place] = CubicSpline(near.astype(np.float64), values[near])(float(place))
    return filled


def _doubt(recording: Recording, channel: Channel, wild: NDArray[np.bool_], component: str, what: str) -> Doubt:
    places = np.flatnonzero(wild)
    instants = [f"{recording.start + place / recording.rate:.6g}" for place in places[:3]]
    more = ", ..." if places.size > len(instants) else ""
    samples = "1 sample" if places.size == 1 else f"{places.size} samples"
    those = "its" if places.size == 1 else "their"
    where = f"{', '.join(instants)}{more} s"
    text = f"{samples} of {channel.name} far from {those} neighbours (at {where}), as no balance moves: {what}"
    advice = f"keep them with {argument('keep_outliers')}"
    return Doubt("wild samples", component, text, advice, 0.0, si_unit(component))
