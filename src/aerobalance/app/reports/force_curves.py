"""What the page of a force shows of load and force, kept while the parts of a record go by."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from aerobalance.estimation.force_parts import ForcePart
from aerobalance.estimation.result import ForceSummary
from aerobalance.estimation.sums import SpectrumSums, segment_length
from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import interpolate_gaps_linearly

PIECES: Final = 1200
"""Pieces of the record of which a curve shows the least and the largest value."""

CLOSE: Final = 400
"""Samples of the closer view."""

BEFORE: Final = 0.3
"""Share of the closer view that lies before the event."""


@dataclass(frozen=True, slots=True, eq=False)
class CloserView:
    """Some samples of load and force.

    Attributes
    ----------
    start
        Time of the first sample of the record [s].
    first
        Number of the first sample of the view.
    load, force, uncertainty
        Balance load, force applied and its standard uncertainty, shape (m,) each [N].
    size
        How large the event is that the view is about [N].
    every
        Samples of the record for each of these.
    """

    start: float
    first: int
    load: Array
    force: Array
    uncertainty: Array
    size: float
    every: int = 1

    def time(self, rate: float) -> Array:
        """Times of the samples, shape (m,) [s], the sampling rate of the record being `rate` [Hz]."""
        return np.asarray(self.start + (self.first + np.arange(self.force.size)) * self.every / rate)


@dataclass(slots=True, eq=False)
class ForceCurves:
    """Load and force along one component as a page shows them.

    Attributes
    ----------
    samples
        Samples of the clock that the record is worked out on.
    start
        Time of the first [s].
    every
        Samples of the record for each of that clock.
    """

    samples: int
    start: float
    every: int = 1
    _ends: dict[str, Array] = field(init=False)
    _spectrum: SpectrumSums = field(init=False)
    _views: dict[str, CloserView] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._spectrum = SpectrumSums(segment_length(self.samples))
        count = -(-self.samples // self.width)
        self._ends = {name: np.tile([np.inf, -np.inf], (count, 1)) for name in ("load", "force")}

    @property
    def width(self) -> int:
        """Samples of a piece of which the least and the largest value are kept; every sample where that is one."""
        width = self.samples // PIECES
        return width if width >= 3 else 1

    def add(self, given: ForcePart, component: str) -> None:
        """Add the next part of the record."""
        if given.force is None:
            return
        own, part = given.own, given.part
        load = given.force.recording.channel(component).values
        self._add_pieces("load", load[own], given.first)
        self._add_pieces("force", given.values[component], given.first)
        filled = interpolate_gaps_linearly(load)[own]
        if filled.size >= self._spectrum.length:
            self._spectrum.add(filled, ())
        force, u = given.force[component].values.copy(), given.force[component].uncertainty.copy()
        force[own], u[own] = given.values[component], given.uncertainty[component]
        change = np.abs(np.diff(force, append=force[-1]))
        for name, size in (("change", change), ("largest", force), ("least", -force)):
            sizes = np.full(force.size, -np.inf)
            sizes[own] = np.where(np.isfinite(size[own]), size[own], -np.inf)
            place = int(np.argmax(sizes))
            known = self._views.get(name)
            if known is None or sizes[place] > known.size:
                length = min(CLOSE, force.size)
                first = int(np.clip(place - BEFORE * length, 0, force.size - length))
                kept = slice(first, first + length)
                self._views[name] = CloserView(
                    self.start,
                    part.begin + first,
                    load[kept].copy(),
                    force[kept].copy(),
                    u[kept].copy(),
                    float(sizes[place]),
                    self.every,
                )

    def _add_pieces(self, name: str, values: Array, first: int) -> None:
        """Add samples from a number on to the pieces that they belong to; missing ones leave these as they are."""
        pieces = (first + np.arange(values.size)) // self.width
        edges = np.flatnonzero(np.diff(pieces, prepend=-1))
        place, ends = pieces[edges], self._ends[name]
        ends[place, 0] = np.fmin(ends[place, 0], np.fmin.reduceat(values, edges))
        ends[place, 1] = np.fmax(ends[place, 1], np.fmax.reduceat(values, edges))

    def times(self, rate: float) -> Array:
        """Times of the points of `load` and `force`, shape (m,) [s], the record's sampling rate being `rate` [Hz]."""
        interval = self.every / rate
        if self.width == 1:
            return np.asarray(self.start + np.arange(self.samples) * interval)
        middle = np.arange(self.samples // self.width) * self.width + self.width // 2
        return np.repeat(self.start + middle * interval, 2)

    @property
    def load(self) -> Array:
        """Balance load: least and largest value of every piece, which look like the curve, shape (m,) [N]."""
        return self._points("load")

    @property
    def force(self) -> Array:
        """The same of the force applied, shape (m,) [N]."""
        return self._points("force")

    def _points(self, name: str) -> Array:
        ends = self._ends[name]
        kept = ends[:, 0] if self.width == 1 else ends[: self.samples // self.width].ravel()
        return np.where(np.isfinite(kept), kept, np.nan)

    def load_spectrum(self, rate: float) -> tuple[Array, Array]:
        """Frequencies [Hz] and one-sided spectral density of the load [N^2/Hz], the rate of the record being given."""
        own = rate / self.every
        frequency = np.arange(self._spectrum.density.size) * (own / self._spectrum.length)
        return np.asarray(frequency, dtype=np.float64), np.asarray(
            self._spectrum.density / self._spectrum.segments / own
        )

    def closer(self, summary: ForceSummary) -> CloserView:
        """Samples around the largest step, or else around the value farthest from the mean."""
        if summary.steps:
            return self._views["change"]
        sums = summary.sums
        mean = sums.level + sums.total / sums.samples
        high, low = self._views["largest"], self._views["least"]
        return high if high.size - mean > low.size + mean else low
