r"""Forces of a record that is too long to be worked on at once: part by part, joined where the parts meet.

Each part is a record of its own: its prior, its steps and its hum are learned from it alone, so that a part can be
worked out without the others and a fault in one stays there. Neighbours have samples in common, a margin on either
side of the joint. A free oscillation that is under way at the beginning of a part is unknown there, and known as fast
as the closed loop of the smoother decays; after so many of its decay times as the response to a step is taken to last,
nothing of it is left (`Division`). A mode that decays at a rate a, whose readings have the spectral density S at its
natural frequency and R by their noise alone, is followed at the rate a sqrt(1 + S / R): the Kalman-Bucy filter of its
complex amplitude, x' = -a x + w. In the middle of the overlap the one force passes into
the other. Both are estimates from nearly the same readings, so their errors are nearly the same, and uncertainties are
passed over like the forces; what the two differ by is an error of at least one of them and comes on top, as the
standard deviation of a mixture, w (1 - w) times the square of the difference.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Any, Final

import numpy as np
from scipy.fft import next_fast_len

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.error_sources import Noise, Systematic, undivided
from aerobalance.estimation.sampled_force import AT_ONCE, SampledForce
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import DOUBTED, Doubt
from aerobalance.recording.part_warnings import PartWarnings
from aerobalance.recording.parts import LongRecord, Part, parts_of
from aerobalance.recording.recording import Recording

JOINTS: Final = "joints of the parts"
"""Name of what the forces of two parts differ by where they meet."""

COMMON: Final = tuple(
    f"{DOUBTED}{kind}"
    for kind in ("natural frequency", "damping ratio", "missing mode", "not linear", "ground", "attitude")
)
"""How the names of errors begin whose cause is in all parts of a record, though some may not show it."""


@dataclass(frozen=True, slots=True)
class Division:
    """How a long record is divided.

    Attributes
    ----------
    readings
        Readings of all components together that are worked on at once, at most: a part has no more than the largest
        multiple of `round_to` samples that keeps to it, and all parts of a record are about as long.
    decimated
        Readings of a slower clock over these, at most, where the forces are worked out on one, and readings of the
        record that they are made of: both are in memory, one after the other.
    round_to
        Samples.
    decay_times
        Decay times of the smoother's slowest mode that make the margin; the response to a step is taken to last as
        long.
    margin
        Least margin [samples], and the largest [share of a part].
    same_step
        Distance of two instants up to which both parts mean the same step, in their uncertainties, and the least such
        distance [samples].
    """

    readings: int = 6 * 57344
    decimated: tuple[float, float] = (11 / 14, 7.1)
    round_to: int = 1 << 12
    decay_times: float = 4.0
    margin: tuple[int, float] = (1 << 12, 1 / 8)
    same_step: tuple[float, float] = (5.0, 2.0)

    def length(self, dynamics: BalanceDynamics, *, every: int = 1) -> int:
        """Return the most samples of a part, on a clock with one for so many of the record."""
        slower, most = self.decimated
        readings = self.readings if every == 1 else int(self.readings * min(slower, most / every))
        return max(readings // len(dynamics.components) // self.round_to, 1) * self.round_to

    def parts(
        self, record: LongRecord[Any], dynamics: BalanceDynamics, *, every: int = 1, shown: Sequence[float] = ()
    ) -> tuple[Part, ...]:
        """Return the parts of a record.

        Parameters
        ----------
        record
            The record.
        dynamics
            Dynamics of the balance.
        every
            Samples of the record's own clock for each of its samples.
        shown
            Power of the loads at each natural frequency over that of the noise there, at least, all along the record;
            nothing where that is not known.
        """
        length = self.length(dynamics, every=every)
        if record.samples <= length:
            return parts_of(record.samples, length=length, margin=0)
        ratios = shown or [0.0] * len(dynamics.modes)
        slowest = min(_decay(mode) * sqrt(1 + ratio) for mode, ratio in zip(dynamics.modes, ratios, strict=True))
        least, most = self.margin
        wanted = self.decay_times / max(slowest, 1e-300) * record.rate
        margin = int(min(max(wanted, least / every), most * length))
        # parts of the same length overlap by no more than their margins, and none is too short to learn from
        count = 1 + -(-(record.samples - length) // (length - 2 * margin))
        even = -(-(record.samples + 2 * margin * (count - 1)) // count)
        return parts_of(record.samples, length=min(length, next_fast_len(even, real=True)), margin=margin)


DIVISION: Final = Division()
"""The division that is used."""


def _decay(mode: Mode) -> float:
    """Rate at which the free motion of a mode decays [1/s]."""
    ratio = mode.damping_ratio
    return mode.angular_frequency * (ratio if ratio <= 1 else 1 / (ratio + float(np.sqrt(ratio**2 - 1))))


@dataclass(frozen=True, slots=True, eq=False)
class ForcePart:
    """The forces of those samples of a record that one part answers for, joined to the part before.

    Attributes
    ----------
    part
        The part.
    first
        Number of the first sample: in the middle of the overlap with the part before.
    values, uncertainty
        Force and its standard uncertainty by component, shape (m,) each [N, N*m]; NaN where a part has no readings.
    contributions
        What the uncertainty consists of, at these samples.
    steps
        Steps of the record that are certain now; their instants count from its first sample.
    force
        What was worked out of the part's own samples, those of the overlaps included; None where it has no readings.
    where
        Which part of the record it is, in words.
    doubts
        What the part says against its forces, and where it is joined against that of the part before.
    sampled
        The force on the record's own clock by component, where that is faster; nothing where it is not.
    clock
        That clock: a recording of the channels without their samples, and which of its samples they are; None where
        the part's own recording is it.
    """

    part: Part
    first: int
    values: Mapping[str, Array]
    uncertainty: Mapping[str, Array]
    contributions: Mapping[str, tuple[Systematic | Noise, ...]]
    steps: Mapping[str, tuple[Step, ...]]
    force: Force | None
    where: str = ""
    doubts: tuple[Doubt, ...] = ()
    sampled: Mapping[str, SampledForce] = field(default_factory=dict)
    clock: tuple[Recording, slice] | None = None

    def pieces_of(self, component: str) -> Iterator[tuple[slice, Array, Array]]:
        """Which samples of the record, force and uncertainty of a component there [N, N*m]; some of them at a time."""
        if component in self.sampled:
            yield from self.sampled[component].pieces()
            return
        values, uncertainty = self.values[component], self.uncertainty[component]
        for begin in range(0, values.size, AT_ONCE):
            some = slice(begin, min(begin + AT_ONCE, values.size))
            yield slice(self.first + some.start, self.first + some.stop), values[some], uncertainty[some]

    def samples_of_record(self) -> Iterator[tuple[Recording, slice, dict[str, Array], dict[str, Array]]]:
        """The record's clock, which of its samples, force and uncertainty there; none where there is no force.

        Some samples at a time: of all at once those of all components would be the largest thing in memory.
        """
        if self.force is None:
            return
        recording, own = self.clock or (self.force.recording, self.own)
        begin: int | None = None
        for pieces in zip(*(self.pieces_of(name) for name in self.values), strict=True):
            there = pieces[0][0]
            begin = there.start if begin is None else begin
            place = own.start - begin
            values = {name: value for name, (_, value, _) in zip(self.values, pieces, strict=True)}
            uncertainty = {name: u for name, (_, _, u) in zip(self.values, pieces, strict=True)}
            yield recording, slice(place + there.start, place + there.stop), values, uncertainty

    @property
    def own(self) -> slice:
        """These samples among those of `force`."""
        begin = self.first - self.part.begin
        return slice(begin, begin + next(iter(self.values.values())).size)


@dataclass(slots=True, eq=False)
class WorstPart:
    """The part of a record whose uncertainty is the largest beside the noise of its readings.

    Attributes
    ----------
    part
        The part; None before one with a force was added.
    """

    part: Part | None = None
    _most: float = 0.0

    def add(self, given: ForcePart) -> None:
        """Take one more part."""
        force = given.force
        if force is None:
            return
        u = max(float(np.nanmean((given.uncertainty[name] / force[name].noise) ** 2)) for name in force)
        if self.part is None or u > self._most:
            self.part, self._most = given.part, u

    def told(self, record: LongRecord[Any]) -> str:
        """Say of which part of a record a Monte Carlo check is."""
        where = "" if self.part is None else self.part.told(record).removeprefix("in ")
        return f"{record.name}: Monte Carlo is of the part with the largest uncertainty, {where}"


@dataclass(frozen=True, slots=True, eq=False)
class _Ending:
    """What a part says of the samples about its joint with the next.

    Attributes
    ----------
    values, uncertainty
        Force and its standard uncertainty from half a margin before the joint to half a margin after it, by component.
    steps
        Steps from a margin before the joint on, on the clock of the record.
    """

    values: Mapping[str, Array]
    uncertainty: Mapping[str, Array]
    steps: Mapping[str, tuple[Step, ...]]


def _going_with(force: Force, component: str, source: str) -> float:
    """Standard deviation of the channel that an error is from, or else of the force [of its unit, N, N*m]."""
    channel = force.recording.channels.get(source)
    return float(np.nanstd(force[component].values if channel is None else channel.values))


@dataclass(slots=True, eq=False)
class Joiner:
    """Joins the parts of a record, given one after the other.

    Attributes
    ----------
    record
        The record.
    components
        Names of the components.
    division
        How it is divided.
    warnings
        Takes what is to be said of a part.
    """

    record: LongRecord[Any]
    components: tuple[str, ...]
    division: Division
    warnings: PartWarnings
    _before: _Ending | None = None
    # of each component the errors whose cause is common: their size over that of what they go with, and their spectra
    _shown: dict[tuple[str, str, str], tuple[float, Array]] = field(default_factory=dict)

    def joined(self, part: Part, force: Force | None) -> ForcePart:
        """Return the samples that are certain with one more part; None for one without readings."""
        half = part.margin // 2
        first = part.first - half if self._before else 0
        last = part.stop - half if part.number < part.count else part.stop
        own = slice(first - part.begin, last - part.begin)
        after = slice(own.stop, own.stop + 2 * half)
        values, us, contributions, tails, spread = {}, {}, {}, {}, {}
        doubts = [] if force is None else list(force.doubts)
        for name in self.components:
            if force is None:
                value, u = np.full((2, part.end - part.begin), np.nan)
                sources: list[Systematic | Noise] = []
            else:
                value, u = force[name].values, force[name].uncertainty
                sources = undivided(force[name].contributions)
                common = self._shown_before(force, name, sources)
                if common:
                    u = np.sqrt(u**2 + sum(one.deviation**2 for one in common))
                    sources += common
            tails[name], spread[name] = value[after].copy(), u[after].copy()
            values[name], us[name] = value[own].copy(), u[own].copy()
            parts = [one.within(own) for one in sources]
            if self._before is not None:
                joint, doubt = self._pass_over(self._before, name, values[name][: 2 * half], us[name][: 2 * half])
                if doubt is not None:
                    self.warnings.add(part, f"{self.record.name}: {doubt}")
                    doubts.append(doubt)
                if joint.any():
                    deviation = np.zeros(values[name].size)
                    deviation[: 2 * half] = joint
                    parts.append(Noise(JOINTS, name, deviation, np.ones(1)))
            contributions[name] = tuple(parts)
        certain, later = self._divided_steps(part, force)
        self._before = _Ending(tails, spread, later)
        where = part.told(self.record)
        return ForcePart(part, first, values, us, contributions, certain, force, where, tuple(doubts))

    def _shown_before(self, force: Force, name: str, sources: Sequence[Systematic | Noise]) -> list[Noise]:
        """Errors of a component that this part does not show, and one before it did: the cause is common to both.

        They are taken for as large over what they go with as they were there at most: the ground's channel, or the
        fluctuation of the force where dynamics are the cause.
        """
        sizes: dict[tuple[str, str, str], float] = {}
        for one in sources:
            if one.name.startswith(COMMON):
                size = float(np.sqrt(np.mean(one.deviation**2))) / max(_going_with(force, name, one.source), 1e-300)
                key = (name, one.name, one.source)
                sizes[key] = size
                spectrum = one.spectrum if isinstance(one, Noise) else np.ones(1)
                if key not in self._shown or size > self._shown[key][0]:
                    self._shown[key] = size, spectrum
        count = force.recording.samples
        return [
            Noise(what, source, np.full(count, share * _going_with(force, name, source)), spectrum)
            for (component, what, source), (share, spectrum) in self._shown.items()
            if component == name and (component, what, source) not in sizes
        ]

    def _pass_over(self, before: _Ending, name: str, values: Array, u: Array) -> tuple[Array, Doubt | None]:
        """Let the force of the part before pass into this one's, in place; return what they leave open, (2 h,) [N]."""
        doubt = None
        old, old_u = before.values[name], before.uncertainty[name]
        share = np.sin(0.5 * np.pi * (np.arange(values.size) + 0.5) / values.size) ** 2
        share = np.where(np.isnan(old), 1.0, np.where(np.isnan(values), 0.0, share))
        both = np.isfinite(old) & np.isfinite(values)
        apart = np.where(both, values - old, 0.0)
        stated = np.where(both, (1 - share) * old_u + share * u, 0.0)
        joint = np.sqrt(share * (1 - share)) * np.abs(apart)
        if float(np.mean(apart**2)) > float(np.mean(stated**2)):
            unit = si_unit(name)
            text = (
                f"the forces of {name} by this part and the one before differ by "
                f"{np.sqrt(np.mean(apart**2)):.2g} {unit} rms where they meet, and their uncertainty is "
                f"{np.sqrt(np.mean(stated**2)):.2g} {unit}; the difference is in the uncertainty there"
            )
            doubt = Doubt("joint", name, text, effect=0.0, unit=unit)
        values[:] = np.where(share == 0, old, np.where(share == 1, values, values - (1 - share) * apart))
        u[:] = np.where(both, np.hypot(stated, joint), np.where(np.isnan(old), u, old_u))
        return np.asarray(joint), doubt

    def _divided_steps(
        self, part: Part, force: Force | None
    ) -> tuple[dict[str, tuple[Step, ...]], dict[str, tuple[Step, ...]]]:
        """Steps that are certain now and steps about the joint with the next part, on the clock of the record."""
        rate, first = self.record.rate, self._before is None
        joint = part.first / rate
        near = (part.first + part.margin) / rate
        late = np.inf if part.number == part.count else (part.stop - part.margin) / rate
        certain, later = {}, {}
        for name in self.components:
            own = () if force is None else force[name].steps
            found = [replace(one, instant=one.instant + part.begin / rate) for one in own]
            old = () if self._before is None else self._before.steps[name]
            new = [] if first else [one for one in found if one.instant < near]
            kept = self._owned(list(old), new, joint=joint)
            kept += [one for one in found if (first or one.instant >= near) and one.instant < late]
            certain[name] = tuple(sorted(kept, key=lambda one: one.instant))
            later[name] = tuple(one for one in found if one.instant >= late)
        return certain, later

    def _owned(self, old: list[Step], new: list[Step], *, joint: float) -> list[Step]:
        """Steps about a joint: of one that both parts have found, what the part says to which its sample belongs."""
        sure, least = self.division.same_step
        kept = []
        for one in old:
            other = min(new, key=lambda step: abs(step.instant - one.instant), default=None)
            if other is not None:
                known = sure * float(np.hypot(one.instant_uncertainty, other.instant_uncertainty))
                if abs(other.instant - one.instant) <= max(known, least / self.record.rate):
                    new.remove(other)
                    kept.append(one if one.instant + other.instant < 2 * joint else other)
                    continue
            if one.instant < joint:
                kept.append(one)
        return kept + [one for one in new if one.instant >= joint]
