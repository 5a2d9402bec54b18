"""A force that was worked out on a slower clock than its record's, and its samples on the record's own.

Without its steps such a force is band-limited, so that its samples on the slower clock determine it: the steps are
subtracted, the rest is interpolated, and the steps are added again at their instants, which may lie between samples.
A record has many times the samples of its slower clock, so they are made some at a time, where they are wanted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from aerobalance.estimation.steps import Step, shape_at, side_variance
from aerobalance.recording.channel import Array
from aerobalance.recording.decimation import Decimation

AT_ONCE: Final = 1 << 16
"""Samples of a record that are made together, about."""


class End(NamedTuple):
    """The largest or the least value of a force.

    Attributes
    ----------
    value, u
        Value and its standard uncertainty [N].
    sample
        Number of its sample in the record.
    """

    value: float
    u: float
    sample: int

    @classmethod
    def both(cls, values: Array, uncertainty: Array, *, first: int) -> tuple[End, End]:
        """Return the largest and the least of a force, shape (n,), whose first sample has this number."""
        places = int(np.argmax(values)), int(np.argmin(values))
        largest, least = (cls(float(values[place]), float(uncertainty[place]), first + place) for place in places)
        return largest, least


@dataclass(frozen=True, slots=True, eq=False)
class SampledForce:
    """A force on the clock of its record, from its samples on a slower one.

    Attributes
    ----------
    decimation
        The two clocks.
    rate
        Sampling rate of the slower one [Hz].
    smooth, spread
        On the slower clock the force less its steps, and the standard uncertainty less what comes from them, shape
        (n,) each [N]: those from `begin` to `end` and some more on either side.
    first
        Sample of the slower clock at which these begin.
    begin, end
        First sample of the slower clock that is wanted, and the one after the last.
    steps
        Steps that are seen there; their instants count from the first sample of the slower clock.
    """

    decimation: Decimation
    rate: float
    smooth: Array
    spread: Array
    first: int
    begin: int
    end: int
    steps: tuple[Step, ...]
    _ends: list[tuple[End, End]] = field(init=False, default_factory=list)

    @classmethod
    def of(
        cls,
        values: Array,
        uncertainty: Array,
        steps: Sequence[Step],
        *,
        decimation: Decimation,
        rate: float,
        first: int,
        begin: int,
        end: int,
    ) -> SampledForce:
        """Return the force with these values and uncertainties on the slower clock, shape (n,) each [N]."""
        clock = (first + np.arange(values.size)) / rate
        near = tuple(one for one in steps if one.instant <= clock[-1] and one.instant + one.duration >= clock[0])
        smooth, variance = values.copy(), uncertainty**2
        for one in near:
            smooth -= one.height * shape_at(one, clock)
            variance -= side_variance(one, clock, height=one.height, interval=1 / rate)
        spread = np.sqrt(np.maximum(variance, 0.0))
        return cls(decimation, rate, smooth, spread, first, begin, end, near)

    @property
    def every(self) -> int:
        """Samples of the record for each of the slower clock."""
        return self.decimation.factor

    @property
    def span(self) -> slice:
        """Which samples of the record it has."""
        return self.decimation.span(self.begin, self.end)

    def within(self, begin: int, end: int) -> tuple[Array, Array]:
        """Return force and standard uncertainty on the record's clock, shape (m,) each [N].

        Parameters
        ----------
        begin, end
            First sample of the slower clock, and the one after the last.
        """
        decimation, faster = self.decimation, self.rate * self.every
        force = decimation.interpolated(self.smooth, begin, end, first=self.first)
        start = decimation.span(begin, end).start
        # counted from the first sample of the slower clock, which is `before` samples of the record after its first
        time = (start - decimation.before + np.arange(force.size)) / faster
        clock = (self.first + np.arange(self.smooth.size)) / self.rate
        variance = _interpolated_linearly(time, clock, self.spread) ** 2
        for one in self.steps:
            force += one.height * shape_at(one, time)
            variance += side_variance(one, time, height=one.height, interval=1 / faster)
        return force, np.sqrt(variance)

    def pieces(self) -> Iterator[tuple[slice, Array, Array]]:
        """Which samples of the record, force and standard uncertainty there [N]; some of them at a time."""
        some, found = max(AT_ONCE // self.every, 1), list[tuple[End, End]]()
        for begin in range(self.begin, self.end, some):
            end = min(begin + some, self.end)
            own, (values, uncertainty) = self.decimation.span(begin, end), self.within(begin, end)
            found.append(End.both(values, uncertainty, first=own.start))
            yield own, values, uncertainty
        self._ends[:] = [(max((one for one, _ in found), key=_value), min((one for _, one in found), key=_value))]

    @property
    def ends(self) -> tuple[End, End]:
        """The largest and the least of it; known once all pieces have been made."""
        if not self._ends:
            for _ in self.pieces():
                pass
        return self._ends[0]


def _value(one: End) -> float:
    return one.value


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
