"""Forces that were estimated on a slower clock, put back on the clock of their record part by part."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from aerobalance.estimation.force_parts import ForcePart
from aerobalance.estimation.sampled_force import SampledForce
from aerobalance.estimation.working_record import DecimatedRecord, OwnClock
from aerobalance.recording.channel import Array
from aerobalance.recording.decimation import BETWEEN


@dataclass(slots=True, eq=False)
class RecordClock:
    """Puts the parts of a force on the clock of their record; they must be given in their order.

    Attributes
    ----------
    record
        The record on its slower clock.
    """

    record: DecimatedRecord
    # last values and uncertainties of the part before, by component: the interpolation needs them at the joint
    _before: dict[str, tuple[Array, Array]] = field(default_factory=dict)

    def sampled(self, given: ForcePart, clock: OwnClock) -> ForcePart:
        """Return a part with its force on the record's own clock as well [N, N*m]; parts in their order.

        Parameters
        ----------
        given
            The part.
        clock
            The record's own clock there.
        """
        force = given.force
        if force is None:
            return given
        decimation, rate = self.record.decimation, self.record.rate
        own, first = given.own, given.first
        stop = first + own.stop - own.start

        def sampled_one(name: str) -> SampledForce:
            value = given.values[name]
            steps = [replace(one, instant=one.instant + given.part.begin / rate) for one in force[name].steps]
            context = slice(own.stop, own.stop + BETWEEN)
            before = self._before.get(name, (np.zeros(0), np.zeros(0)))
            u, after = given.uncertainty[name], (force[name].values[context], force[name].uncertainty[context])
            values, uncertainty = (np.concatenate(parts) for parts in zip(before, (value, u), after, strict=True))
            self._before[name] = value[-BETWEEN:].copy(), u[-BETWEEN:].copy()
            return SampledForce.of(
                values,
                uncertainty,
                steps,
                decimation=decimation,
                rate=rate,
                first=first - before[0].size,
                begin=first,
                end=stop,
            )

        span = decimation.span(first, stop)
        late = decimation.before / (rate * self.record.every)
        return replace(
            given,
            steps={
                name: tuple(replace(one, instant=one.instant + late) for one in all_)
                for name, all_ in given.steps.items()
            },
            sampled={name: sampled_one(name) for name in given.values},
            clock=clock.within(span.start, span.stop),
        )
