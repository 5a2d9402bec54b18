"""Forces that were estimated on a slower clock, interpolated to the clock of their record.

Without its steps such a force is band-limited, so that its samples on the slower clock determine it: the steps are
subtracted, the rest is interpolated, and the steps are added again at their instants, which may lie between samples.
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
from aerobalance.recording.side_by_side import side_by_side


@dataclass(slots=True, eq=False)
class RecordClock:
    """Interpolates the parts of a force to the clock of their record; they must be given in their order.

    Attributes
    ----------
    record
        The record on its slower clock.
    """

    record: DecimatedRecord
    # last values and uncertainties of the part before, by component: the interpolation needs them at the joint
    _before: dict[str, tuple[Array, Array]] = field(default_factory=dict)

    def sampled(self, given: ForcePart) -> ForcePart:
        """Return a part with its force on the record's own clock as well [N, N*m]; parts in their order."""
        force = given.force
        if force is None:
            return given
        decimation = self.record.decimation
        own, first = given.own, given.first
        stop = first + own.stop - own.start

        def sampled_one(name: str) -> SampledForce:
            value = given.values[name]
            steps = [
                replace(one, instant=one.instant + given.part.begin / self.record.rate) for one in force[name].steps
            ]
            context = slice(own.stop, own.stop + BETWEEN)
            before = self._before.get(name, (np.zeros(0), np.zeros(0)))
            u, after = given.uncertainty[name], (force[name].values[context], force[name].uncertainty[context])
            values, uncertainty = (np.concatenate(parts) for parts in zip(before, (value, u), after, strict=True))
            begin = first - before[0].size
            self._before[name] = value[-BETWEEN:].copy(), u[-BETWEEN:].copy()
            return self._on_record_clock(values, uncertainty, steps, first=first, stop=stop, begin=begin)

        found = dict(zip(given.values, side_by_side(sampled_one, given.values), strict=True))
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

    def _on_record_clock(
        self, values: Array, uncertainty: Array, steps: Sequence[Step], *, first: int, stop: int, begin: int
    ) -> SampledForce:
        """Force and standard uncertainty for samples `first` to `stop` (excluded) of the slower clock [N, N*m].

        `values` and `uncertainty` begin at its sample `begin`; instants of `steps` are in its time, from zero on [s].
        """
        record, decimation = self.record, self.record.decimation
        clock = (begin + np.arange(values.size)) / record.rate
        near = [one for one in steps if one.instant <= clock[-1] and one.instant + one.duration >= clock[0]]
        smooth, variance = values.copy(), uncertainty**2
        for one in near:
            smooth -= one.height * shape_at(one, clock)
            variance -= side_variance(one, clock, height=one.height, interval=1 / record.rate)
        force = decimation.interpolated(smooth, first, stop, first=begin)
        start = decimation.span(first, stop).start
        # counted from the first sample of the slower clock, which is `before` samples of the record after its first
        time = (start - decimation.before + np.arange(force.size)) / (record.rate * record.every)
        whole = _interpolated_linearly(time, clock, np.sqrt(np.maximum(variance, 0.0))) ** 2
        for one in near:
            force += one.height * shape_at(one, time)
            whole += side_variance(one, time, height=one.height, interval=1 / (record.rate * record.every))
        return SampledForce(start, record.every, force, np.sqrt(whole))


def _interpolated_linearly(time: Array, clock: Array, values: Array) -> Array:
    """Values at given times by linear interpolation, shape (n,).

    Beyond an end, values that rise towards it are extrapolated; others stay constant, as an uncertainty does not
    become smaller where the samples end.
    """
    found = np.interp(time, clock, values)
    for end, inner in ((0, 1), (-1, -2)):
        rise = (values[end] - values[inner]) / (clock[end] - clock[inner])
        beyond = time < clock[0] if end == 0 else time > clock[-1]
        found[beyond] += np.maximum(rise * (time[beyond] - clock[end]), 0.0)
    return found
