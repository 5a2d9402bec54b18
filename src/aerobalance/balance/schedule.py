"""Load schedule: loads applied to the balance [N, N*m] and gauge outputs [mV/V], point by point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.load_formats import BalanceType, Geometry
from aerobalance.recording.channel import Array

UNLOADED: Final = 1e-3
"""Load, over capacity, below which a point counts as a zero reading."""

MOST_KEPT_ASIDE: Final = 0.5
"""Largest share of the points that may be kept for confirmation."""


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """Static loads and gauge outputs of one calibration: n points, c components with one gauge bridge each.

    Attributes
    ----------
    name
        What the calibration is called in messages (its file).
    components
        Names of the c loads as the file has them, for example N1 N2 S1 S2 RM AF.
    gauges
        Names of the c bridges, in the same order: bridge i answers mainly to load i.
    loads
        Loads applied, without fixtures (tares), shape (n, c) [N, N*m].
    outputs
        Gauge outputs over excitation, zeros not removed, shape (n, c) [mV/V].
    series
        Load series of every point, shape (n,): 0, 1, ...; fixtures stay the same within a series.
    series_names
        What the file calls each series.
    points
        What the file calls each point.
    capacities
        Largest allowed loads, shape (c,), positive [N, N*m].
    moments
        True for the components that are moments, shape (c,).
    load_units
        Unit of each load in the file.
    natural_zeros
        Outputs of the bare balance at several roll angles, shape (k, c) [mV/V]; k = 0 where none were read.
    confirmation
        True for points that are kept out of the fit, to test it, shape (n,).
    temperature
        Temperature of the balance at every point, shape (n,) [degC]; None where not recorded.
    balance_type
        Which loads the gauges measure.
    geometry
        Distances of the gauges from the balance's centre; None where unknown.
    assumptions
        What the reader had to take for granted.
    left_out
        Labels of the points that were left out (`without`).
    """

    name: str
    components: tuple[str, ...]
    gauges: tuple[str, ...]
    loads: Array
    outputs: Array
    series: NDArray[np.intp]
    series_names: tuple[str, ...]
    points: tuple[str, ...]
    capacities: Array
    moments: NDArray[np.bool_]
    load_units: tuple[str, ...]
    natural_zeros: Array
    confirmation: NDArray[np.bool_]
    temperature: Array | None = None
    balance_type: BalanceType = "unknown"
    geometry: Geometry | None = None
    assumptions: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def __repr__(self) -> str:
        what = f"{self.name}: {len(self.points)} points in {len(self.series_names)} series"
        units = ("N*m" if moment else "N" for moment in self.moments)
        loads = (
            f"{name} to {capacity:.6g} {unit}"
            for name, capacity, unit in zip(self.components, self.capacities, units, strict=True)
        )
        aside = int(np.count_nonzero(self.confirmation))
        more = [f"{aside} for confirmation"] if aside else []
        more += [f"{len(self.left_out)} left out"] if self.left_out else []
        return "; ".join([what, *more, ", ".join(loads)])

    def __post_init__(self) -> None:
        n, c = self.outputs.shape if self.outputs.ndim == 2 else (0, 0)
        shapes = {
            "loads": (n, c),
            "series": (n,),
            "confirmation": (n,),
            "capacities": (c,),
            "moments": (c,),
            "natural_zeros": (self.natural_zeros.shape[0], c),
        }
        for field, shape in shapes.items():
            if getattr(self, field).shape != shape:
                raise ValueError(f"{field} must have shape {shape}, not {getattr(self, field).shape}")
        for field in ("components", "gauges", "load_units"):
            if len(getattr(self, field)) != c or (field != "load_units" and len(set(getattr(self, field))) != c):
                raise ValueError(f"{field} must be {c} different names, not {getattr(self, field)}")
        if self.temperature is not None and self.temperature.shape != (n,):
            raise ValueError(f"temperature must have shape {(n,)}, not {self.temperature.shape}")
        if len(self.points) != n:
            raise ValueError(f"points must be {n} names, not {len(self.points)}")
        if n and not (self.series.min() >= 0 and self.series.max() < len(self.series_names)):
            raise ValueError("series must number series_names from 0")
        if not ((self.capacities > 0) & np.isfinite(self.capacities)).all():
            raise ValueError("capacities must be positive and finite")
        for field in ("loads", "outputs", "natural_zeros"):
            if not np.isfinite(getattr(self, field)).all():
                raise ValueError(f"{field} must be finite")
        if self.temperature is not None and not np.isfinite(self.temperature).all():
            where = self.label(int(np.flatnonzero(~np.isfinite(self.temperature))[0]))
            raise ValueError(
                f"temperature must be finite, which that of {where} is not; leave out the points that lack it, or "
                "give no temperature at all (None)"
            )

    @property
    def fitted(self) -> NDArray[np.bool_]:
        """True for the points that take part in the fit, shape (n,)."""
        return ~self.confirmation

    @property
    def unloaded(self) -> NDArray[np.bool_]:
        """True for the points without load, shape (n,): zero readings."""
        return np.asarray((np.abs(self.loads) < UNLOADED * self.capacities).all(axis=1))

    def label(self, number: int) -> str:
        """Return the words that name a point, by its position from 0: its series and its own name.

        The series is not said where there is only one, or where the point's own name begins with it.
        """
        series, point = self.series_names[self.series[number]], self.points[number]
        alone = len(self.series_names) == 1 or _key(point).startswith(f"{_key(series)} ")
        return point if alone else f"{series} {point}"

    def without(self, names: Sequence[str]) -> Schedule:
        """Return the schedule without some points: ``SERIES POINT`` each, or a series' name for all of its points.

        Capital letters and the number of spaces do not count.

        Raises
        ------
        ValueError
            A name is that of no point and no series, or of both; the message lists names that are near. No point is
            left.
        """
        if not names:
            return self
        out = np.zeros(len(self.points), dtype=np.bool_)
        for name in names:
            out |= self._named(name)
        if out.all():
            raise ValueError(f"{self.name}: no point is left when {', '.join(names)} are left out")
        kept = np.unique(self.series[~out])
        return replace(
            self,
            loads=self.loads[~out],
            outputs=self.outputs[~out],
            series=np.searchsorted(kept, self.series[~out]).astype(np.intp),
            series_names=tuple(self.series_names[number] for number in kept),
            points=tuple(self.points[number] for number in np.flatnonzero(~out)),
            confirmation=self.confirmation[~out],
            temperature=None if self.temperature is None else self.temperature[~out],
            left_out=(*self.left_out, *(self.label(int(number)) for number in np.flatnonzero(out))),
        )

    def _named(self, name: str) -> NDArray[np.bool_]:
        """True for the points that a name stands for, shape (n,)."""
        wanted = _key(name)
        of_series = np.array([_key(self.series_names[number]) == wanted for number in self.series])
        long = [f"{self.series_names[of]} {point}" for of, point in zip(self.series, self.points, strict=True)]
        labels = [self.label(number) for number in range(len(self.points))]
        of_point = np.array([wanted in (_key(a), _key(b)) for a, b in zip(long, labels, strict=True)])
        if of_series.any() and of_point.any() and (of_series != of_point).any():
            raise ValueError(
                f"{self.name}: {name!r} is the name of a series and of a point; name the point by "
                f"{long[int(np.argmax(of_point))]!r}, or the points of the series one by one"
            )
        found = np.asarray(of_series | of_point)
        if not found.any():
            known = {_key(text): text for text in (*self.series_names, *labels)}
            near = [known[key] for key in get_close_matches(wanted, list(known), n=5, cutoff=0.5)]
            near = near or list(known.values())[:5]
            raise ValueError(
                f"{self.name}: has no point and no series {name!r}; near are {', '.join(map(repr, near))}. A point is "
                "named by its series and its own name"
            )
        return found

    def keeping_aside(self, share: float) -> Schedule:
        """Return the schedule with a share of its loaded points, evenly over the series, marked for confirmation.

        Raises
        ------
        ValueError
            The share is negative, or above `MOST_KEPT_ASIDE`.
        """
        if not 0 <= share <= MOST_KEPT_ASIDE:
            raise ValueError(f"the share kept aside must lie between 0 and {MOST_KEPT_ASIDE}, not {share}")
        if not share:
            return self
        loaded = np.flatnonzero(~self.unloaded & self.fitted)
        places = np.floor(np.arange(0.5, loaded.size, 1 / share)).astype(int)
        confirmation = self.confirmation.copy()
        confirmation[loaded[places]] = True
        return replace(self, confirmation=confirmation)


def _key(name: str) -> str:
    """Return what spellings of one name have in common."""
    return " ".join(name.split()).casefold()
