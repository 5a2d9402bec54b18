"""Combined load envelope of a balance, and the part of it that a set of loads uses [1].

Every envelope here is a closed region round zero load, and its utilisation is the factor by which the envelope would
have to grow to touch the loads: 0 without load, 1 on its surface, twice as much for twice the loads. Makers state

- ``box``: each component may reach its limit whatever the others do,
- ``rhombus``: the shares of the limits add up, sum |X_i| / L_i <= 1 (the cautious one),
- ``ellipsoid``: their squares do, sum (X_i / L_i)^2 <= 1,

and, for balances whose stress comes from two components at one place, limits on the load at that place: the forward
gauge of a balance with gauges 2 d apart bears N1 = NF / 2 + PM / (2 d), whose limits make a rhombus of NF and PM. That
is the combined load diagram of [Ulbrich2025]_; a `Station` is one such load, and several of them with or without one
of the shapes above make any convex polytope that is symmetric about zero load. The balance's spring feels the
load, ringing included, so balance loads go in here and not the force applied.

.. [Ulbrich2025] N. Ulbrich, Evaluation, Analysis, and Application of Internal Strain-Gage Balance Data, 3rd edition,
   NASA Ames Research Center, 2025, https://ntrs.nasa.gov/citations/20250002267, appendix on the combined load diagram
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from aerobalance.recording.channel import Array

Shape = Literal["box", "rhombus", "ellipsoid"]

MOST_OF_IT: Final = 0.8
"""Part of the utilisation that the components named as the nearest make up together."""


@dataclass(frozen=True, slots=True)
class Station:
    """Load at one place of the balance as a sum of components, with its limit [N, N*m].

    Attributes
    ----------
    name
        What to call it, such as N1.
    limit
        Largest size of it, in the unit that `shares` give it.
    shares
        What a unit of each component adds to it.
    """

    name: str
    limit: float
    shares: Mapping[str, float]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.limit) and self.limit > 0):
            raise ValueError(f"limit of {self.name} must be above zero, not {self.limit:g}")
        if not any(self.shares.values()) or not all(map(math.isfinite, self.shares.values())):
            raise ValueError(f"{self.name} needs the share of one component at least, as finite numbers")


class Utilisation(NamedTuple):
    """Part of an envelope that a set of loads uses [1].

    Attributes
    ----------
    share
        1 on the surface of the envelope, less inside.
    nearest
        What takes it up: the components that make up most of it, the largest first, or the station that is nearest.
    parts
        Part of `share` of each component; they add up to it. Below zero at a station that it relieves.
    """

    share: float
    nearest: str
    parts: dict[str, float]


@dataclass(frozen=True, slots=True)
class LoadEnvelope:
    """Largest loads of a balance that may act together [N, N*m].

    Attributes
    ----------
    shape
        How components combine; see above.
    limits
        Least and largest load of each component alone, SI: the first below zero, the other above, either infinite
        where there is none. Ignored for stations.
    stations
        Loads at places of the balance that must stay within limits of their own.
    """

    shape: Shape
    limits: Mapping[str, tuple[float, float]]
    stations: tuple[Station, ...] = ()

    def __post_init__(self) -> None:
        if self.shape not in ("box", "rhombus", "ellipsoid"):
            raise ValueError(f"shape must be box, rhombus or ellipsoid, not {self.shape!r}")
        for name, (low, high) in self.limits.items():
            if not low < 0 < high:
                raise ValueError(f"an envelope lies round zero load: {name} is allowed from {low:g} to {high:g}")
        if not self.components:
            raise ValueError("an envelope needs the limits of one component, or a station, at least")

    @property
    def components(self) -> tuple[str, ...]:
        """The components that count, those with limits first."""
        found = [name for name, pair in self.limits.items() if any(map(math.isfinite, pair))]
        found += [name for station in self.stations for name, share in station.shares.items() if share]
        return tuple(dict.fromkeys(found))

    def utilisation(self, loads: Array, names: Sequence[str]) -> Array:
        """Return the part of the envelope that loads use [1].

        Parameters
        ----------
        loads
            Balance loads, shape (n, c), SI.
        names
            The c components of their columns.

        Returns
        -------
        share
            Shape (n,), NaN where a component that counts is missing.

        Raises
        ------
        ValueError
            A component that counts is not among them.
        """
        return np.asarray(np.max(np.abs(self._parts(loads, names).sum(axis=2)), axis=1))

    def at_worst(self, loads: Array, names: Sequence[str]) -> Utilisation | None:
        """Return the largest utilisation of a set of loads [1]; None where no set of them is known whole.

        Parameters
        ----------
        loads, names
            As for `utilisation`.
        """
        shares = self.utilisation(loads, names)
        if not np.isfinite(shares).any():
            return None
        worst = int(np.nanargmax(shares))
        parts = self._parts(loads[worst : worst + 1], names)[0]
        face = int(np.argmax(np.abs(parts.sum(axis=1))))
        return self._told(parts[face] * np.sign(parts[face].sum()), self._faces[face])

    def _told(self, parts: Array, face: str) -> Utilisation:
        found = dict(zip(self.components, map(float, parts), strict=True))
        share, most, nearest = sum(found.values()), 0.0, []
        for name in sorted(found, key=lambda name: -found[name]):
            if most >= MOST_OF_IT * share:
                break
            most += found[name]
            nearest.append(name)
        text = " + ".join(nearest)
        return Utilisation(share, f"{face}: {text}" if face else text, found)

    @property
    def _faces(self) -> list[str]:
        """What the f conditions are called that the loads must meet: a station's by its name, the shape's by none."""
        own = len(self.limits) if self.shape == "box" else min(1, len(self.limits))
        return [*[""] * own, *(station.name for station in self.stations)]

    def _parts(self, loads: Array, names: Sequence[str]) -> Array:
        """What every component adds to every condition, shape (n, f, c): the conditions are sums from -1 to 1."""
        lacking = [name for name in self.components if name not in names]
        if lacking:
            raise ValueError(f"the load envelope needs {', '.join(lacking)}, which is not measured")
        places = {name: place for place, name in enumerate(self.components)}
        given = np.asarray(loads, dtype=np.float64)[:, [list(names).index(name) for name in places]]
        found = np.zeros((len(given), len(self._faces), len(places)))
        alone = np.zeros_like(given)
        for row, name in enumerate(self.limits):
            if name in places:
                read, (low, high) = given[:, places[name]], self.limits[name]
                alone[:, places[name]] = np.where(read < 0, read / low, read / high)
                if self.shape == "box":
                    found[:, row, places[name]] = alone[:, places[name]]
        if self.limits and self.shape != "box":
            found[:, 0] = alone if self.shape == "rhombus" else _root_parts(alone)
        for row, station in enumerate(self.stations, start=len(self._faces) - len(self.stations)):
            for name, share in station.shares.items():
                if share:
                    found[:, row, places[name]] = given[:, places[name]] * share / station.limit
        return found


def _root_parts(alone: Array) -> Array:
    """Parts of the root of a sum of squares, each as large as its square; they add up to the root."""
    root = np.sqrt((alone**2).sum(axis=1, keepdims=True))
    return np.asarray(alone**2 / np.maximum(root, np.finfo(np.float64).tiny))
