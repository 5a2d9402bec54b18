"""Whether the channels of the ground's motion are late, early, or read too much, by what the loads show of the motion.

The ground's motion and the weight at a changing attitude are taken off the readings of the loads. Where a channel was
late or had another gain, a part of it is left: the balance load under its rate of change, or under itself. Both are
known shapes, and the force is a process that was learned; generalised least squares finds how much of each is in the
readings, and whether the delay grows along the record, as it does where two clocks are not one. A force that goes with
the motion, as that of the flow on a model that swings does, looks the same, which is said.

Of coupled components one channel shows in the loads of several, and several channels in one: the readings of all are
asked together, what their noise has in common left out, and of the channels the one is named that explains most, and
then what the others explain beside it. What the components show of a channel in other proportions than those of the
mass is a force.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from scipy.fft import irfft
from scipy.special import chdtri, expit

from aerobalance.estimation.checks.assumptions import SETTINGS as ASSUMED
from aerobalance.estimation.checks.ground_witnesses import SETTINGS, ChannelShapes, Witness, Witnesses, length_of
from aerobalance.estimation.checks.white_readings import Lines, Solved, White
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Assumption
from aerobalance.recording.resampling import fractional_delay
from aerobalance.recording.side_by_side import side_by_side

GAIN_ALONE: Final = np.array([1e-6, 1.0, 1e-6])
"""Part of what is expected of a channel's shapes where it may have another gain and no delay."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundFault:
    """What the loads say of a channel, and what that leaves in the readings of one component.

    Attributes
    ----------
    channel
        The channel.
    shown_by
        Components whose loads show it.
    delay, u_delay
        Time by which it is late and its standard uncertainty [s].
    gain, u_gain
        What its gain has to be changed by, relative, and its standard uncertainty [1].
    drift, u_drift
        Change of the delay along the record and its standard uncertainty [s].
    left
        What is left in the readings by the delay, by the gain, and by the delay with its drift, shape (n, 3) [N].
    sure
        Standard uncertainties from which one of these is no chance.
    """

    channel: str
    shown_by: tuple[str, ...]
    delay: float
    u_delay: float
    gain: float
    u_gain: float
    drift: float
    u_drift: float
    left: Array
    sure: float

    def probability(self, size: float, u: float) -> float:
        """How probable it is that a delay, gain or drift of this size is none by chance, as far as that is known [1].

        Parameters
        ----------
        size, u
            The number and its standard uncertainty.
        """
        gain = 0.5 * ((size / u) ** 2 - self.sure**2) if u > 0 else 0.0
        if gain > 0:
            return 1.0
        return float(expit(SETTINGS.steepness * gain)) if gain > -SETTINGS.open else 0.0


class GroundFindings(NamedTuple):
    """What the loads say of the channels of the ground's motion, as it is left in one component.

    Attributes
    ----------
    faults
        Channels that are late, early, or read too much.
    assumed
        That the others are not, where the loads do not tell.
    """

    faults: Sequence[GroundFault] = ()
    assumed: tuple[Assumption, ...] = ()


NO_FINDINGS: Final = GroundFindings()
"""Where nothing was asked."""


class _Look(NamedTuple):
    """What a first look at a channel says.

    Attributes
    ----------
    shapes
        Its shapes; None where it shows nothing.
    far
        A delay that is larger than slopes tell, and its shapes.
    untold
        What a usual delay and a usual gain that the loads do not tell make of each force, shape (2, c) [N, N*m].
    """

    shapes: ChannelShapes | None = None
    far: tuple[Far, ChannelShapes] | None = None
    untold: Array | None = None


def ground_findings(asked: Witnesses) -> dict[str, GroundFindings]:
    """Return what the loads say of the channels of the ground's motion, by the component that it leaves something in.

    Parameters
    ----------
    asked
        Components whose loads are asked together.
    """
    white = White.of(asked, [one.fit.filter for one in asked.all])

    def looked_at(name: str) -> _Look:
        """Shapes of a channel that shows, and a delay of it that may be larger than slopes tell."""
        shapes = asked.shapes_of(name)
        if shapes is None:
            return _Look()
        columns = white.with_drift(shapes.felt, moves=shapes.moves)
        found = white.solved(columns, expected=asked.expected)
        hint = Far.of(white, columns[..., 1], samples=asked.recording.samples, pace=shapes.pace)
        late = hint is not None and hint.gained >= asked.promising(shapes.pace)
        usual = np.array(
            [ASSUMED.late, 0.0 if asked.recording.channel(name).relative_uncertainty > 0 else ASSUMED.gain]
        )
        usual[found.u[:2] < ASSUMED.told * usual] = 0.0
        untold = np.zeros((2, len(asked.all)))
        for number in np.flatnonzero(usual):
            effects = [one.force_under(felt[:, number]) for one, felt in zip(asked.all, shapes.felt, strict=True)]
            untold[number] = usual[number] * np.array(effects)
        return _Look(
            asked.with_drift(shapes) if found.explained > asked.worth_a_look else None,
            (hint, shapes) if hint is not None and late else None,
            untold,
        )

    looks = dict(zip(asked.changes.channels, side_by_side(looked_at, asked.changes.channels), strict=True))
    faults = _faults(asked, white, list(looks.values()))
    named = {fault.channel for found in faults.values() for fault in found}
    untold = {name: look.untold for name, look in looks.items() if look.untold is not None and name not in named}
    return {
        name: GroundFindings(faults.get(name, ()), tuple(_assumed(one, place, untold)))
        for place, (name, one) in enumerate(zip(asked.components, asked.all, strict=True))
    }


def _faults(asked: Witnesses, white: White, looks: Sequence[_Look]) -> Mapping[str, list[GroundFault]]:
    """What the loads say of the channels, by component."""
    lateness = [look.far for look in looks if look.far is not None]
    near = _together(asked, white, [look.shapes for look in looks if look.shapes is not None])
    if lateness:
        hint, shapes = max(lateness, key=lambda one: one[0].gained)
        # of motions that all take the same course a delay of one may stand for the sign of another
        far = _far(asked, white, shapes, samples=hint.samples)
        return far.faults if far.explained > near.explained else near.faults
    return near.faults


def _assumed(witness: Witness, place: int, untold: Mapping[str, Array]) -> Iterator[Assumption]:
    """What is assumed of channels that may be late or read too much; what makes little of the force is left out."""
    least = ASSUMED.matters * float(np.sqrt(np.mean(witness.fit.variance)))
    component = witness.record.dynamics.component
    unit = si_unit(component)
    late, gain = f"{1e3 * ASSUMED.late:g} ms late or early", f"{100 * ASSUMED.gain:g} % more or less"
    read = "read at the instants of the loads"
    kinds = (
        ("ground delay", (f"is {read}", f"are {read}"), late),
        ("ground gain", ("has an exact gain", "have exact gains"), gain),
    )
    for number, (kind, words, otherwise) in enumerate(kinds):
        effects = {name: float(force[number, place]) for name, force in untold.items()}
        names = [name for name, effect in effects.items() if effect > least]
        if names:
            effect = float(np.hypot.reduce([effects[name] for name in names]))
            text = (
                f"{' and '.join(names)} {words[len(names) > 1]}, which this record does not tell: {otherwise} would "
                f"change the force by {effect:.2g} {unit} rms"
            )
            yield Assumption(kind, component, text, effect, unit)


class _Faults(NamedTuple):
    """What the loads say of channels, by component, and the squares of the white readings that it explains [1]."""

    explained: float = 0.0
    faults: Mapping[str, list[GroundFault]] = MappingProxyType({})


def _together(asked: Witnesses, white: White, suspects: list[ChannelShapes]) -> _Faults:
    """What the loads say of several channels: first the one that explains most of them, then the others beside it."""
    chosen: list[int] = []
    if not suspects:
        return _Faults()
    white = _without(asked, white, suspects)
    columns = [white.columns(one.felt, moves=one.moves) for one in suspects]

    expected, by_gain = [asked.expected for _ in suspects], list[int]()

    def solved(places: list[int]) -> Solved:
        together = np.concatenate([columns[place] for place in places], axis=-1)
        return white.solved(together, expected=np.concatenate([expected[place] for place in places]))

    def less(found: Solved, places: list[int]) -> White:
        """The readings less what channels explain of them."""
        explained = [columns[one] @ found.of_channel(number).sizes for number, one in enumerate(places)]
        return replace(white, shown=white.shown - sum(explained)) if explained else white

    best, rest = Solved(np.zeros(0), np.zeros((0, 0)), 0.0), list(range(len(suspects)))
    while rest:
        found, place = max(((solved([*chosen, one]), one) for one in rest), key=lambda pair: pair[0].explained)
        own = found.of_channel(len(chosen))
        if not own.clear(asked.least):
            break
        if place not in by_gain and (np.abs(own.sizes) > asked.most).any():
            by_gain.append(place)
            expected[place] = asked.expected * GAIN_ALONE
            continue
        rest.remove(place)
        if not _agree(less(found, chosen), columns[place], expected[place], gained=found.explained - best.explained):
            continue
        best, chosen = found, [*chosen, place]
        if not own.clear(asked.sure):
            break  # what the record leaves open explains nothing beside it
    found_in = {
        one.record.dynamics.component: [
            _fault(asked, suspects[place], best.of_channel(number), suspects[place].felt[row])
            for number, place in enumerate(chosen)
        ]
        for row, one in enumerate(asked.all)
    }
    return _Faults(best.explained, found_in)


def _agree(white: White, own: Lines, expected: Array, *, gained: float) -> bool:
    """Whether the loads of the components show the same of a channel.

    A wrong channel is in all of them in the proportions of the mass. The lift of a model that is pitched goes with the
    angle as well, in proportions of its own: taken for the channel's it would be an error of all the other forces.

    Parameters
    ----------
    white
        The readings, less what other channels explain of them.
    own, expected
        Shapes of the channel, and the standard deviations of their sizes before the readings are looked at.
    gained
        What they explain, of the same sizes in all components.
    """
    count = own.shape[1]
    apart = [np.where(np.arange(count)[:, None] == place, own, 0) for place in range(count)]
    each = white.solved(np.concatenate(apart, axis=-1), expected=np.tile(expected, count)).explained
    by_chance = float(chdtri(own.shape[-1] * (count - 1), SETTINGS.disagree)) if count > 1 else np.inf
    return each - gained < max(by_chance, SETTINGS.inexact * gained)


def _without(asked: Witnesses, white: White, channels: Sequence[ChannelShapes]) -> White:
    """White readings by priors that are learned anew, what may be left of the motion by some channels taken out."""
    columns = np.concatenate([white.columns(one.felt, moves=one.moves) for one in channels], axis=-1)
    sizes = white.each(columns)
    filters = [
        one.without(np.column_stack([channel.felt[place] for channel in channels]) @ sizes[place])
        for place, one in enumerate(asked.all)
    ]
    return White.of(asked, filters, without=channels)


def _fault(asked: Witnesses, shapes: ChannelShapes, found: Solved, felt: Array) -> GroundFault:
    parts, u = felt * found.sizes, found.u
    left = np.column_stack([parts[:, 0], parts[:, 1], parts[:, 0] + parts[:, 2]])
    delay, gain, drift = (np.array([-1.0, 1.0, -1.0]) * found.sizes).tolist()
    return GroundFault(
        shapes.name, asked.components, delay, float(u[0]), gain, float(u[1]), drift, float(u[2]), left, asked.sure
    )


def measured(asked: Witnesses, name: str) -> tuple[ChannelShapes, Solved] | None:
    """Return shapes of one channel and how much of each the loads show; None where it does not show the motion.

    Parameters
    ----------
    asked
        Components whose loads are asked together.
    name
        The channel.
    """
    shapes = asked.shapes_of(name)
    if shapes is None:
        return None
    shapes = asked.with_drift(shapes)
    white = White.of(asked, [one.fit.filter for one in asked.all])
    found = white.solved(white.columns(shapes.felt, moves=shapes.moves), expected=asked.expected)
    if found.explained > asked.worth_a_look:
        white = _without(asked, white, [shapes])
        found = white.solved(white.columns(shapes.felt, moves=shapes.moves), expected=asked.expected)
    return shapes, found


class Far(NamedTuple):
    """A delay that is larger than slopes tell.

    Attributes
    ----------
    samples
        The delay [samples].
    gained
        Gain in log-likelihood over none.
    """

    samples: int
    gained: float

    @classmethod
    def of(cls, white: White, motion: Lines, *, samples: int, pace: float) -> Far | None:
        """Return the delay by which what a channel reads is likeliest in the readings; None where it is none.

        Parameters
        ----------
        white
            The readings.
        motion
            Load under what the channel reads, in the white readings, shape (m, c).
        samples
            Samples of the record.
        pace
            Frequency of its motion [Hz times the interval].
        """
        if not motion.any():
            return None
        gains = _gains_of_delays(white, motion, white.shown + motion, samples=samples)
        most = gains.size // 2
        best, gained = int(np.argmax(gains)) - most, float(np.max(gains) - gains[most])
        return None if abs(best) * pace <= SETTINGS.beyond_slopes * SETTINGS.apart else cls(best, gained)


def _gains_of_delays(white: White, motion: Lines, whole: Lines, *, samples: int) -> Array:
    """Gain in log-likelihood by a motion that is moved in time, by each delay from -k to k samples, shape (2 k + 1,).

    Parameters
    ----------
    white
        The readings.
    motion
        Load under what a channel reads, in the white readings, shape (m, c).
    whole
        The white readings with all of the motion in them, shape (m, c).
    samples
        Samples of the record.
    """
    # what is white stays so when it is moved: one pass of the filter tells all delays
    most = int(SETTINGS.reach * samples)
    lines = np.einsum("mc,mc->m", motion, np.conj(white.weighted(whole, motion)))
    lines[[0, -1]] *= 2.0
    both = irfft(lines, length_of(samples)) * length_of(samples) / 2
    return np.asarray(np.concatenate([both[-most:], both[: most + 1]]) ** 2 / white.squares(motion) / 2)


def _peak_of(gains: Array) -> tuple[float, float]:
    """Place of the maximum of a log-likelihood, and by its curvature its standard uncertainty."""
    top = int(np.clip(np.argmax(gains), 1, gains.size - 2))
    below = np.flatnonzero(gains < gains[top] - SETTINGS.about_peak)
    first = min(int(below[below < top].max(initial=-1)) + 1, top - 1)
    last = max(int(below[below > top].min(initial=gains.size)), top + 2)
    away = np.arange(first, last) - top
    bend, slope, _ = np.polyfit(away, gains[first:last], 2)
    u = 1 / float(np.sqrt(max(-2 * bend, 1e-12)))
    return top + float(np.clip(slope * u**2, away[0], away[-1])), u


def _far(asked: Witnesses, white: White, shapes: ChannelShapes, *, samples: int) -> _Faults:
    """What the loads say of a channel that is later than slopes tell; nothing where it is not.

    What the channel should have read is what it read, moved in time and of another size: of many delays that one is
    taken which leaves least of the reading.
    """
    h = 1 / asked.recording.rate

    def felt(delay: float) -> list[Array]:
        moved = fractional_delay(shapes.slopes[1], delay=-delay, interval=h)
        return [one.felt(moved) for one in asked.all]

    size = SETTINGS.probe * h
    here, there, early, late = (felt(delay) for delay in (0.0, samples * h, samples * h - size, samples * h + size))
    rates = [(b - a) / (2 * size) for a, b in zip(early, late, strict=True)]
    moved = [np.column_stack(own) for own in zip(there, rates, here, strict=True)]
    sizes = white.each(white.columns(moved, moves=shapes.moves))
    filters = [one.without(own @ of_one) for one, own, of_one in zip(asked.all, moved, sizes, strict=True)]
    white = White.of(asked, filters)
    motion = white.columns([own[:, None] for own in here], moves=shapes.moves)[..., 0]
    whole = white.shown + motion
    # by the likelihood and not by the slope of what is read: that has the slope of the sensor's noise in it
    gains = _gains_of_delays(white, motion, whole, samples=asked.recording.samples)
    # within a quarter of a period, beyond which the motion has the other sign
    middle, quarter = gains.size // 2 + samples, max(int(0.25 / shapes.pace), 2)
    first = max(middle - quarter, 0)
    away, u_away = _peak_of(gains[first : middle + quarter + 1])
    delay, u_delay = h * (first - gains.size // 2 + away), h * u_away
    there = felt(delay)
    found = white.solved(white.columns([own[:, None] for own in there], moves=shapes.moves), whole)
    (gain,), (u_gain,) = found.sizes, found.u
    gained = white.squares(white.shown) - white.squares(whole) + found.explained
    if gain <= 0 or gained < 2 * SETTINGS.decisive:
        return _Faults()  # of the other sign, slopes tell it
    answer = {}
    for one, own, moved_there in zip(asked.all, here, there, strict=True):
        parts = -np.column_stack([moved_there - own, (gain - 1) * moved_there])
        answer[one.record.dynamics.component] = [
            GroundFault(
                shapes.name, asked.components, delay, u_delay, float(gain - 1), float(u_gain), 0.0, 1.0,
                np.column_stack([parts, parts[:, 0]]), asked.sure,
            )
        ]  # fmt: skip
    return _Faults(gained, answer)
