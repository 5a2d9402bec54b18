"""Forces that were worked out on a slower clock, back on the clock of their record.

Beside its steps such a force is band-limited, and its samples on the slower clock are all of it: the steps are taken
off, the rest is interpolated, and the steps are put back where they are between the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aerobalance.estimation.force_parts import ForcePart
from aerobalance.estimation.steps import Step, shape_at, side_variance
from aerobalance.estimation.sums import SampledForce
from aerobalance.estimation.working_clock import DecimatedRecord
from aerobalance.recording.channel import Array
from aerobalance.recording.decimation import BETWEEN


@dataclass(slots=True, eq=False)
class RecordClock:
    """Puts the parts of a force on the clock of their record, one after the other.

    Attributes
    ----------
    record
        The record on its slower clock.
    """

    record: DecimatedRecord
    _before: dict[str, tuple[Array, Array]] = field(default_factory=dict)

    def sampled(self, given: ForcePart) -> ForcePart:
        """Return a part with its force on the record's own clock too."""
        force = given.force
        if force is None:
            return given
        decimation = self.record.decimation
        own, first = given.own, given.first
        stop = first + own.stop - own.start
        found = {}
        for name, value in given.values.items():
            steps = [
                replace(one, instant=one.instant + given.part.begin / self.record.rate) for one in force[name].steps
            ]
            context = slice(own.stop, own.stop + BETWEEN)
            before = self._before.get(name, (np.zeros(0), np.zeros(0)))
            u, after = given.uncertainty[name], (force[name].values[context], force[name].uncertainty[context])
            values, uncertainty = (np.concatenate(parts) for parts in zip(before, (value, u), after, strict=True))
            begin = first - before[0].size
            found[name] = self._between(values, uncertainty, steps, first=first, stop=stop, begin=begin)
            self._before[name] = value[-BETWEEN:].copy(), u[-BETWEEN:].copy()
        span = decimation.span(first, stop)
        late = decimation.before / (self.record.rate * self.record.every)
        return replace(
            given,
            steps={
                name: tuple(replace(one, instant=one.instant + late) for one in all_)
                for name, all_ in given.steps.items()
            },
            sampled=found,
            clock=self.record.clock(span.start, span.stop),
        )

    def _between(
        self, values: Array, uncertainty: Array, steps: Sequence[Step], *, first: int, stop: int, begin: int
    ) -> SampledForce:
        """Force and uncertainty from a sample of the slower clock to another, of those from `begin` on."""
        record, decimation = self.record, self.record.decimation
        clock = (begin + np.arange(values.size)) / record.rate
        near = [one for one in steps if one.instant <= clock[-1] and one.instant + one.duration >= clock[0]]
        smooth, variance = values.copy(), uncertainty**2
        for one in near:
            smooth -= one.height * shape_at(one, clock)
            variance -= side_variance(one, clock, height=one.height, interval=1 / record.rate)
        force = decimation.interpolated(smooth, first, stop, first=begin)
        start = decimation.span(first, stop).start
        # on the slower clock, whose first sample is that many of the record later
        time = (start - decimation.before + np.arange(force.size)) / (record.rate * record.every)
        whole = _between(time, clock, np.sqrt(np.maximum(variance, 0.0))) ** 2
        for one in near:
            force += one.height * shape_at(one, time)
            whole += side_variance(one, time, height=one.height, interval=1 / (record.rate * record.every))
        return SampledForce(start, record.every, force, np.sqrt(whole))


def _between(time: Array, clock: Array, values: Array) -> Array:
    """Values at times by straight lines, which go on beyond the ends where they rise, shape (n,)."""
    found = np.interp(time, clock, values)
    for end, inner in ((0, 1), (-1, -2)):
        rise = (values[end] - values[inner]) / (clock[end] - clock[inner])
        beyond = time < clock[0] if end == 0 else time > clock[-1]
        found[beyond] += np.maximum(rise * (time[beyond] - clock[end]), 0.0)
    return found
