"""Puts the forces of the parts of a record together: what sums them up, and in memory their samples too."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.error_sources import Divided, Noise, Systematic
from aerobalance.estimation.force_parts import ForcePart
from aerobalance.estimation.result import ComponentForce, ForceSummary
from aerobalance.estimation.spectra.lines import Line
from aerobalance.estimation.steps import Step
from aerobalance.estimation.sums import ForceSums, Key, SpectrumSums, segment_length
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Assumption, Doubt, of_all_parts

SAME_LINE: Final = 2.0
"""Distance of two lines of hum in ordinates of a part's spectrum up to which they are the same line."""


@dataclass(slots=True, eq=False)
class SummaryOfParts:
    """What sums up the force along one component, part by part.

    Attributes
    ----------
    component
        Which component.
    samples
        Samples of the whole record, on the clock that it is worked out on.
    every
        Samples of the record for each of that clock.
    """

    component: str
    samples: int
    every: int = 1
    _sums: ForceSums | None = None
    _spectrum: SpectrumSums = field(init=False)
    _methods: list[str] = field(default_factory=list)
    _noise: float = 0.0
    _after: float = 0.0
    _bandwidth: float = 0.0
    _worked: int = 0
    _parts: int = 0
    _steps: list[Step] = field(default_factory=list)
    _hum: list[Line] = field(default_factory=list)
    _tones: list[Line] = field(default_factory=list)
    _assumptions: dict[str, None] = field(default_factory=dict)
    _doubts: list[tuple[Doubt, str]] = field(default_factory=list)
    _assumed: dict[str, Assumption] = field(default_factory=dict)
    # sums of load and weight, and number of readings of each
    _means: Array = field(default_factory=lambda: np.zeros((2, 2)))

    def __post_init__(self) -> None:
        self._spectrum = SpectrumSums(segment_length(self.samples), self.every)

    def add(self, given: ForcePart) -> None:
        """Add the next part."""
        self._parts = given.part.count
        self._steps += given.steps[self.component]
        self._doubts += [(doubt, given.where) for doubt in given.doubts if doubt.component == self.component]
        values, u = given.values[self.component], given.uncertainty[self.component]
        there = np.flatnonzero(np.isfinite(values))  # where it joins a part without readings, some samples have none
        if given.force is None:
            if there.size and self._sums is not None:  # what the part before still says, without its contributions
                self._sums.add(values[there], u[there], (), first=given.first + int(there[0]))
            return
        found, own = given.force[self.component], given.own
        self._add_means(given.force, own)
        kept = slice(int(there[0]), int(there[-1]) + 1)
        contributions = [one.within(kept) for one in given.contributions[self.component]]
        if self._sums is None:
            self._sums = ForceSums(found.learned is not None)
        sampled = given.sampled[self.component] if given.sampled else None
        self._sums.add(values[kept], u[kept], contributions, first=given.first + kept.start, sampled=sampled)
        if there.size >= self._spectrum.length:
            self._spectrum.add(values[kept], contributions)
        count = own.stop - own.start
        self._worked += count
        self._noise += count * self.every * found.noise**2  # of a reading of the record
        self._after += count * (found.noise_gain * found.noise) ** 2
        self._bandwidth = max(self._bandwidth, found.bandwidth)
        self._methods += [found.method] if found.method not in self._methods else []
        self._assumptions |= dict.fromkeys(found.assumptions)
        for one in found.assumed:  # of all parts the one where it would do most
            if one.kind not in self._assumed or one.effect > self._assumed[one.kind].effect:
                self._assumed[one.kind] = one
        resolved = SAME_LINE * given.force.recording.rate / given.force.recording.samples
        self._hum = _with_lines(self._hum, found.hum, resolved=resolved)
        self._tones = _with_lines(self._tones, found.tones, resolved=resolved)

    def _add_means(self, force: Force, own: slice) -> None:
        """Count the load of a part, and the weight that is taken off it."""
        recording = force.recording
        rows = [recording.channel(self.component).values[own]]
        if "pitch" in recording:
            pitch = recording.channel("pitch").values[own]
            roll = recording.channel("roll").values[own] if "roll" in recording else np.zeros_like(pitch)
            gravity = force.settings.gravity
            rows.append(force.dynamics.weight(self.component, pitch=pitch, roll=roll, gravity=gravity))
        for place, values in enumerate(rows):
            known = np.isfinite(values)
            self._means[place] += float(np.sum(values, where=known)), float(np.count_nonzero(known))

    @property
    def summary(self) -> ForceSummary:
        """What was found so far.

        Raises
        ------
        ValueError
            No part has a force.
        """
        if self._sums is None:
            raise ValueError(f"no part of the record has a force of {self.component}")
        noise, after = (float(np.sqrt(square / self._worked)) for square in (self._noise, self._after))
        method = self._methods[0]
        if self._parts > 1:
            method = f"in {self._parts} parts, of which the first is by the {method}"
        if self.every > 1:
            method = f"on a clock {self.every} times as slow as the record's, {method}"
        with np.errstate(invalid="ignore"):
            load, weight = self._means[:, 0] / self._means[:, 1]
        return ForceSummary(
            component=self.component,
            method=method,
            noise=noise,
            bandwidth=self._bandwidth,
            noise_gain=after / noise if noise > 0 else 0.0,
            steps=tuple(self._steps),
            hum=tuple(self._hum),
            tones=tuple(self._tones),
            assumptions=tuple(self._assumptions),
            sums=self._sums,
            spectrum=self._spectrum,
            doubts=of_all_parts(self._doubts, parts=self._parts),
            assumed=tuple(self._assumed.values()),
            mean_load=float(load),
            mean_weight=float(weight),
        )


def _with_lines(known: list[Line], found: Sequence[Line], *, resolved: float) -> list[Line]:
    """Lines of the parts before with those of one more, by frequency; of the same line of both the larger one."""
    lines = list(known)
    for line in found:
        same = [other for other in lines if abs(other.frequency - line.frequency) < resolved]
        if not same:
            lines.append(line)
        elif line.amplitude > same[0].amplitude:
            lines[lines.index(same[0])] = line
    return sorted(lines, key=lambda line: line.frequency)


@dataclass(slots=True, eq=False)
class ForceCollector:
    """Collects all samples of a record in memory.

    Attributes
    ----------
    samples
        Samples of the record.
    working
        Those of the clock that it is worked out on.
    every
        Samples of the record for each of them.
    """

    samples: int
    working: int
    every: int = 1

    def collected(self, parts: Iterable[ForcePart]) -> dict[str, ComponentForce]:
        """Return the forces of the whole record, by component."""
        values: dict[str, Array] = {}
        us: dict[str, Array] = {}
        pieces: dict[str, dict[Key, list[tuple[int, Systematic | Noise]]]] = {}
        summaries: dict[str, SummaryOfParts] = {}
        for one in parts:
            for name in one.values:
                if name not in summaries:
                    summaries[name] = SummaryOfParts(name, self.working, self.every)
                    values[name], us[name] = np.full((2, self.samples), np.nan)
                    pieces[name] = {}
                for own, value, u in one.pieces_of(name):
                    values[name][own], us[name][own] = value, u
                for source in one.contributions[name]:
                    pieces[name].setdefault((source.name, source.source), []).append((one.first, source))
                summaries[name].add(one)
        return {
            name: self._force(one.summary, values[name], us[name], pieces[name]) for name, one in summaries.items()
        }

    def _force(
        self,
        summary: ForceSummary,
        values: Array,
        uncertainty: Array,
        pieces: dict[Key, list[tuple[int, Systematic | Noise]]],
    ) -> ComponentForce:
        return ComponentForce(
            component=summary.component,
            values=values,
            uncertainty=uncertainty,
            method=summary.method,
            noise=summary.noise,
            bandwidth=summary.bandwidth,
            noise_gain=summary.noise_gain,
            steps=summary.steps,
            hum=summary.hum,
            tones=summary.tones,
            assumptions=summary.assumptions,
            budget=summary.budget,
            contributions=tuple(
                Divided(name, source, self.samples, tuple(found), self.every)
                for (name, source), found in pieces.items()
            ),
            summary=summary,
            doubts=summary.doubts,
            assumed=summary.assumed,
        )
