"""Readings of a run that are not physical: outliers (wild samples), stuck and clipped ones.

In the loads, wild and stuck samples are made missing (NaN); clipped ones are told of here and left out where the load
is read. Where loads come from gauge outputs, all are missing where a bridge was stuck or on a limit: each needs it.
In the channels of the ground's motion, stuck and clipped samples are made missing, and wild ones are replaced by the
value of a polynomial fitted to their neighbours. Angles may rest on a reading, so none of them is stuck.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.loads import Loads
from aerobalance.estimation.checks.impossible_channels import is_of_ground
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError, argument
from aerobalance.recording.recording import Recording
from aerobalance.recording.stuck_samples import stuck_samples
from aerobalance.recording.wild_samples import wild_samples

Places = NDArray[np.intp]
"""Which samples, in their order, shape (m,)."""

DEAD: Final = 0.9
"""Share of stuck samples above which a channel is useless."""

BESIDE: Final = 8
"""Readings on either side of a wild sample of the ground's motion to which a polynomial is fitted."""

DEGREE: Final = 5
"""Degree of that polynomial."""

FEWEST_A_SIDE: Final = 3
"""Sound readings on either side for that degree. With fewer it is a straight line: beyond its readings a polynomial of
degree five enlarges their noise a hundred times and more."""


class _Of(NamedTuple):
    """Places of the readings of a channel that are not physical: wild, stuck and clipped ones."""

    wild: Places
    stuck: Places
    limited: Places


class _Bridge(NamedTuple):
    """Places where a bridge was stuck, or rested on a limit."""

    kind: str
    gauge: str
    places: Places


@dataclass(frozen=True, slots=True, eq=False)
class Outliers:
    """Readings of a run that are not physical, by their places in it.

    Attributes
    ----------
    samples
        Samples of the run.
    channels
        Those of its channels, of loads and of the motion of the ground.
    bridges
        Those of the bridges that its loads come from.
    of_bridges
        Whether its loads come from bridges: each load needs all, so that none is known where one is wild.
    """

    samples: int
    channels: Mapping[str, _Of] = field(default_factory=dict)
    bridges: tuple[_Bridge, ...] = ()
    of_bridges: bool = False

    def __bool__(self) -> bool:
        return bool(self.channels or self.bridges)

    def within(self, own: slice) -> Outliers:
        """Those of the samples of a slice alone, counted from its beginning."""

        def there(places: Places) -> Places:
            return np.asarray(places[(places >= own.start) & (places < own.stop)] - own.start)

        channels = {name: _Of(*map(there, one)) for name, one in self.channels.items()}
        bridges = (one._replace(places=there(one.places)) for one in self.bridges)
        return Outliers(
            own.stop - own.start,
            {name: one for name, one in channels.items() if any(places.size for places in one)},
            tuple(one for one in bridges if one.places.size),
            self.of_bridges,
        )

    @classmethod
    def joined(cls, pieces: Sequence[Outliers]) -> Outliers:
        """Those of consecutive pieces of a run, as those of all of them."""
        channels: dict[str, list[_Of]] = {}
        bridges: dict[tuple[str, str], list[Places]] = {}
        begin = 0
        for piece in pieces:
            for name, one in piece.channels.items():
                channels.setdefault(name, []).append(_Of(*(places + begin for places in one)))
            for kind, gauge, places in piece.bridges:
                bridges.setdefault((kind, gauge), []).append(places + begin)
            begin += piece.samples
        return cls(
            begin,
            {name: _Of(*map(np.concatenate, zip(*some, strict=True))) for name, some in channels.items()},
            tuple(_Bridge(*which, np.concatenate(some)) for which, some in sorted(bridges.items(), reverse=True)),
            pieces[0].of_bridges,
        )

    def doubts(self, recording: Recording, components: Sequence[str]) -> tuple[Doubt, ...]:
        """Doubts about them.

        Parameters
        ----------
        recording
            The clock of the run, and the units of its loads.
        components
            Components whose loads it has.
        """
        return (*self._of_bridges(recording, components), *self._of_channels(recording, components))

    def _of_bridges(self, recording: Recording, components: Sequence[str]) -> Iterator[Doubt]:
        """Doubts about readings of the bridges that loads come from, for every component: each load needs all."""
        for kind, gauge, places in self.bridges:
            what, advice = _TOLD_OF_BRIDGES[kind]
            text = (
                f"{_samples(places)} of r{gauge} {what} (from {_instants(recording, places)} on): all loads are taken "
                "for missing there"
            )
            for name in components:
                yield Doubt(kind, name, text, advice, 0.0, si_unit(name))

    def _of_channels(self, recording: Recording, components: Sequence[str]) -> Iterator[Doubt]:
        """Doubts about readings of loads, and for every component about those of the motion of the ground."""
        for name, found in self.channels.items():
            what = "neighbours are taken instead"
            if name in components:
                what = "all loads are taken for missing there" if self.of_bridges else "taken for missing"
            for component in [name] if name in components else components:
                yield from _doubts(recording, name, component, found, wild=what)


_TOLD_OF_BRIDGES: Final = {
    "stuck channel": ("repeat the one before", "look at the bridge, its cable and its amplifier"),
    "clipping": ("rest on a limit of the channel", "record with a larger range"),
}
"""What is said of readings of a bridge, and what to do."""


def without_wild_samples(
    given: Recording | Loads, components: Sequence[str], *, own: slice | None = None
) -> tuple[Recording | Loads, tuple[Doubt, ...]]:
    """Return a run without its wild and stuck samples, and the doubts about wild, stuck and clipped ones.

    Parameters
    ----------
    given
        The run.
    components
        Components whose loads are examined, beside the channels of the ground's motion.
    own
        Samples of the run that doubts are about; all where left out.

    Raises
    ------
    FitError
        More than the share `DEAD` of the samples of a load are stuck.
    """
    found = outliers_of(given, components)
    recording = given.recording if isinstance(given, Loads) else given
    present = [name for name in components if name in recording]
    clean = without_outliers(given, found, components)
    if own is not None:
        found, recording = found.within(own), recording.part(own.start, own.stop)
    return clean, found.doubts(recording, present)


def outliers_of(given: Recording | Loads, components: Sequence[str]) -> Outliers:
    """Return the wild, stuck and clipped readings of a run; parameters and errors as of `without_wild_samples`."""
    recording = given.recording if isinstance(given, Loads) else given
    present = [name for name in components if name in recording]
    bridges = _bridges(given) if isinstance(given, Loads) else ()
    lost = _lost_by_bridges(Outliers(recording.samples, bridges=bridges), ())
    channels: dict[str, _Of] = {}
    for name, channel in recording.channels.items():
        is_load = name in present
        if not (is_load or is_of_ground(name)):
            continue
        if is_load and lost is not None:
            channel = replace(channel, values=np.where(lost, np.nan, channel.values))  # noqa: PLW2901
        limited = channel.at_limit
        rests = channel.unit == "rad"
        stuck = np.zeros(limited.size, dtype=np.bool_) if rests else stuck_samples(channel.values) & ~limited
        if is_load and np.mean(stuck) > DEAD:
            raise FitError(
                f"{recording.name}: {_samples(np.flatnonzero(stuck))} of {stuck.size} of {name} repeat the one "
                "before: the channel was stuck or not connected, and there is no force to work out"
            )
        unsure = limited | stuck
        wild = wild_samples(np.where(unsure, np.nan, channel.values) if unsure.any() else channel.values)
        if unsure.any() or wild.any():  # as in few records
            places = _Of(*(np.flatnonzero(one) for one in (wild, stuck, limited & (not rests))))
            if any(one.size for one in places):
                channels[name] = places
    return Outliers(recording.samples, channels, bridges, isinstance(given, Loads))


def without_outliers(
    given: Recording | Loads, found: Outliers, components: Sequence[str], *, clipped: bool = False
) -> Recording | Loads:
    """Return a run without the readings that are not physical.

    Parameters
    ----------
    given
        The run.
    found
        What `outliers_of` finds in it.
    components
        As there.
    clipped
        Whether the loads are to lack the clipped samples too, which are left out where the load is read.
    """
    if not found:
        return given
    recording = given.recording if isinstance(given, Loads) else given
    channels = dict(recording.channels)
    lost = _lost_by_bridges(found, components)
    if lost is not None:
        for name in components:
            if name in recording:
                channels[name] = replace(channels[name], values=np.where(lost, np.nan, channels[name].values))
    for name, places in found.channels.items():
        is_load, values = name in components, channels[name].values.copy()
        values[places.stuck] = np.nan
        if clipped or not is_load:
            values[places.limited] = np.nan
        if is_load:
            values[places.wild] = np.nan
        elif places.wild.size:
            values = _filled(values, places.wild)
        channels[name] = replace(channels[name], values=values)
    clean = replace(recording, channels=channels)
    if not isinstance(given, Loads):
        return clean
    table = given.values.copy()
    for place, name in enumerate(given.components):
        if name in channels:
            table[np.isnan(channels[name].values), place] = np.nan
    return replace(given, recording=clean, values=table)


def _bridges(given: Loads) -> tuple[_Bridge, ...]:
    """Readings of the bridges that loads come from which are stuck, or rest on a limit."""
    kinds = zip(_TOLD_OF_BRIDGES, (given.stuck, given.clipped), strict=True)
    return tuple(
        _Bridge(kind, given.balance.gauges[place], np.flatnonzero(found[:, place]))
        for kind, found in kinds
        if found is not None
        for place in np.flatnonzero(found.any(axis=0))
    )


def _lost_by_bridges(found: Outliers, components: Sequence[str]) -> NDArray[np.bool_] | None:
    """Where a bridge has no reading, so that no load has one, shape (n,); None where all have.

    A wild reading of a bridge is seen in one of the loads at least.
    """
    places = [one.places for one in found.bridges]
    if found.of_bridges:
        places += [one.wild for name, one in found.channels.items() if name in components]
    if not places:
        return None
    lost = np.zeros(found.samples, dtype=np.bool_)
    lost[np.concatenate(places)] = True
    return lost


def _filled(values: Array, wild: Places) -> Array:
    """Readings with wild ones replaced by a polynomial fitted to their neighbours, shape (n,).

    A wild one without sound neighbours is missing.
    """
    filled = values.copy()
    filled[wild] = np.nan
    sound = np.isfinite(filled)
    for place in wild:
        first = max(int(place) - BESIDE, 0)
        near = np.asarray(np.flatnonzero(sound[first : int(place) + BESIDE + 1]) + first)
        if near.size > 1:
            sides = np.count_nonzero(near < place), np.count_nonzero(near > place)
            degree = DEGREE if min(sides) >= FEWEST_A_SIDE else 1
            away = (near - place) / BESIDE
            filled[place] = np.linalg.lstsq(np.vander(away, degree + 1), values[near])[0][-1]
    return filled


def _doubts(recording: Recording, name: str, component: str, found: _Of, *, wild: str) -> Iterator[Doubt]:
    """Doubts about the samples of a channel; `wild` says what is done about wild ones."""
    unit = si_unit(component)
    if found.wild.size:
        their = "its" if found.wild.size == 1 else "their"
        text = (
            f"{_samples(found.wild)} of {name} far from {their} neighbours (at {_instants(recording, found.wild)}), "
            f"as no balance moves: {wild}"
        )
        yield Doubt("wild samples", component, text, f"keep them with {argument('keep_outliers')}", 0.0, unit)
    if found.stuck.size:
        text = (
            f"{_samples(found.stuck)} of {name} repeat the one before (from {_instants(recording, found.stuck)} on): "
            "they are taken for missing"
        )
        yield Doubt("stuck channel", component, text, "look at the cable and the converter of the channel", 0.0, unit)
    if found.limited.size:
        text = f"{_samples(found.limited)} of {name} rest on a limit of the channel: they are taken for missing"
        yield Doubt("clipping", component, text, "record with a larger range", 0.0, unit)


def _samples(places: Places) -> str:
    return "1 sample" if places.size == 1 else f"{places.size} samples"


def _instants(recording: Recording, places: Places) -> str:
    """Instants at which the first three runs of samples begin, in words [s]."""
    begins = places[np.diff(places, prepend=-2) > 1]
    instants = [f"{recording.start + place / recording.rate:.6g}" for place in begins[:3]]
    return f"{', '.join(instants)}{', ...' if begins.size > len(instants) else ''} s"
