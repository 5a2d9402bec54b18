"""Whether coupled components ring together as the modes of their dynamics do, in sign, order and frequency.

A mode moves all components in proportions of its own. Rows of D and A that go with these proportions take the ringing
out of every component's force; where a channel has another sign, or two are exchanged, they leave it there, many times
as large as the force. So the dynamics as they are, exchanged channels and moved modes are compared by the likelihood
of the forces (`aerobalance.estimation.checks.ringing`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.assumptions import SETTINGS as ASSUMED
from aerobalance.estimation.checks.channel_rows import Rows, powers_of
from aerobalance.estimation.checks.driven_shapes import beats_channels, moved_by_motion
from aerobalance.estimation.checks.ground_doubts import without_ground_doubts
from aerobalance.estimation.checks.model_error import BY_PROBABILITY, LEFT_OPEN, TOLD, as_noise
from aerobalance.estimation.checks.moved_dynamics import Moved
from aerobalance.estimation.checks.moved_modes import SETTINGS as MOVED
from aerobalance.estimation.checks.moved_modes import (
    OtherShapes,
    contradicted,
    gain_of,
    moved_alone,
    moved_together,
    one_moved,
)
from aerobalance.estimation.checks.resonance import gain_in_white_noise
from aerobalance.estimation.checks.ringing import RingingSpectra, most_samples
from aerobalance.estimation.checks.split_loads import SplitLoads
from aerobalance.estimation.coupled_record import CoupledRecord, net_load
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.result import ComponentForce, with_errors
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import DOUBTED, Assumption, Doubt
from aerobalance.recording.side_by_side import side_by_side

ADVICE: Final = "identify the dynamics again"
"""What to do where the modes are others."""

AT_ONCE: Final = 1 << 12
"""Frequencies whose matrices are in memory at once."""


@dataclass(frozen=True, slots=True)
class ModeShapeSettings:
    """What is asked of a record, and from which evidence on it is believed.

    Attributes
    ----------
    decisive
        Gain in log-likelihood, beside the band that brings most, that other signs or another order must bring: chance
        and narrow bands of the load brought 9.
    second
        What of it a second channel with another sign must bring over one alone: that both are wrong is at most one in
        20 of such faults, and of a mode that the load hardly excites the record does not tell the sign.
    tones_above
        Frequency above which tones are taken out, over the lowest natural frequency.
    tells
        Mean loss in log-likelihood with all natural frequencies higher and lower, by as much as they may usually be
        off, from which on a record tells them to half of that.
    end
        Share of a whole record that may be left behind its last part: on a slower clock the last sample is some before
        the record's.
    """

    decisive: float = 20.0
    second: float = 3.0
    tones_above: float = 0.5
    tells: float = 2.0
    end: float = 1e-3


EXCHANGED: Final = ("swapped sign", "swapped channels")
"""Kinds of doubt about how the channels are wired."""

SETTINGS: Final = ModeShapeSettings()
"""Settings that are used."""


def other_shapes(ringing: RingingSpectra, dynamics: CoupledDynamics, *, far: bool = False) -> OtherShapes | None:
    """Return the signs, the order or the modes that a record speaks for; None where it does not speak against its own.

    Parameters
    ----------
    ringing
        The spectra of the record.
    dynamics
        The dynamics that it was read with.
    far
        Whether modes are looked for far from those of the dynamics.
    """
    own, count = ringing.own, len(dynamics.components)
    volume = ringing.determinant(own)
    apart = ringing.evidence_apart(own, determinant=volume)
    exchanged: list[tuple[str, tuple[int, ...], Rows]] = []
    for number in (1, 2):
        for places in combinations(range(count), number):
            signs = np.ones(count)
            signs[list(places)] = -1
            exchanged.append(("swapped sign", places, own.with_signs(signs)))
    for places in combinations(range(count), 2):
        order = np.arange(count)
        order[list(places)] = places[::-1]
        exchanged.append(("swapped channels", places, own.reordered(order)))
    # what is exchanged is so wherever the balance rings. Where its modes are it is looked at first: that what is right
    # is less likely there than what is known, by a factor e^-a, happens at most that often (Markov's inequality)
    rings = ringing.about([mode.natural_frequency for mode in dynamics.modes])
    there = rings[ringing.bands]
    price = [SETTINGS.second * (kind == "swapped sign" and len(places) == 2) for kind, places, _ in exchanged]

    def gain_with(rows: Rows) -> float:
        found = ringing.evidence_apart(rows, determinant=volume, told=ringing.shown & rings)
        if float(np.sum((found - apart)[there])) < -SETTINGS.decisive:
            return -np.inf
        found += ringing.evidence_apart(rows, determinant=volume, told=ringing.shown & ~rings)
        return -np.inf if contradicted(found, apart) else gain_of(found, apart)

    gains = side_by_side(gain_with, [rows for _, _, rows in exchanged])
    known = ringing.evidence(own, determinant=volume)
    if max(gains) > SETTINGS.decisive:  # or what they explain is noise that is not white, or forces of one load
        known = np.maximum(known, ringing.evidence_with_color(own, determinant=volume))
        colored = [ringing.evidence_with_color(rows, determinant=volume) for _, _, rows in exchanged]
        gains = [-np.inf if contradicted(one, known) else gain_of(one, known) for one in colored]
        likeliest = int(np.argmax(np.subtract(gains, price)))
        found = ringing.evidence(exchanged[likeliest][2], determinant=volume)
        gains[likeliest] = gain_of(np.maximum(found, colored[likeliest]), known)
    gains = list(np.subtract(gains, price))
    best = int(np.argmax(gains))
    gain, (kind, places, rows) = gains[best], exchanged[best]
    moved = moved_together(ringing, dynamics, known, least=max(gain, MOVED.moved), far=far)
    if gain > SETTINGS.decisive and (moved is None or moved.gain < gain):
        return OtherShapes(kind, places, rows, gain)
    return moved


def force_errors(record: CoupledRecord, loads: SplitLoads, rows: Rows, bandwidth: Array) -> Array:
    """Return how far forces are off if other rows are right, up to a frequency each, shape (samples, n) [N, N*m].

    Parameters
    ----------
    record
        The record.
    loads
        The loads: with other rows the ground's motion puts another load on them, of the same force.
    rows
        The rows that are right.
    bandwidth
        Frequencies up to which the forces are resolved [Hz], shape (n,).
    """
    count = loads.left.shape[0]
    back = 0.5 + 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    frequency = np.fft.rfftfreq(2 * count, record.interval)
    errors, whole = [], loads.left + loads.felt
    own = np.stack([one.row for one in record.decoupled])
    motion = own - np.einsum("ij,jkp->ikp", rows.order, own)  # its force is counted in other components
    for one, other, moved, highest in zip(record.decoupled, rows.forces, motion, bandwidth, strict=True):
        powers = powers_of(one, whole, interval=record.interval)
        change = np.einsum("pjn,jp->n", powers, one.row - other, optimize=True)
        if moved.any() and loads.shaken:
            powers = powers_of(one, loads.felt, interval=record.interval)
            change -= np.einsum("pjn,jp->n", powers, moved, optimize=True)
        closed = np.concatenate([change, change[0] + (change[-1] - change[0]) * back])  # its ends meet
        lines = np.fft.rfft(closed) / one.dynamics.response(frequency) * (frequency <= highest)
        errors.append(np.fft.irfft(lines, 2 * count)[:count])
    return np.stack(errors, axis=1)


def shape_doubts(
    record: CoupledRecord, filled: Array, parts: Mapping[str, ComponentForce]
) -> dict[str, ComponentForce]:
    """Return the forces that a record speaks against, with the errors counted, or that hang on what it does not tell.

    They have doubts, but where the record leaves open whether other dynamics are right, or does not tell the natural
    frequencies, which are then among what is assumed.

    Parameters
    ----------
    record
        The record.
    filled
        Its readings with their gaps filled, shape (samples, n).
    parts
        The forces of all components.
    """
    if not record.is_coupled:
        return {}
    readings = {name: one.reading() for name, one in record.component_records(filled).items()}
    found = _by_shapes(record, filled, parts, readings)
    # the forces of a channel that has another sign or is another's have a color of their own
    exchanged = any(doubt.kind in EXCHANGED for part in found.values() for doubt in part.doubts)
    gains = {} if exchanged else _in_white_noise(readings, parts)
    return _of_another_balance(record, filled, {**parts, **found}, gains) if gains else found


def _of_another_balance(
    record: CoupledRecord, filled: Array, parts: Mapping[str, ComponentForce], gains: Mapping[str, float]
) -> dict[str, ComponentForce]:
    """Forces of a record that rings in other modes, by what these gain in components: as far off as they are from it.

    What the forces are with the dynamics of the balance nobody knows; that they are not what is read is as likely.
    """
    loads = record.without_ground(filled, on_clock_of=0)
    names, found = record.dynamics.components, {}
    errors = loads - np.column_stack([parts[name].values for name in names])
    errors -= errors.mean(axis=0)
    size = np.sqrt(np.mean(errors**2, axis=0))
    over = {
        name: one / float(np.sqrt(np.mean(parts[name].uncertainty ** 2)))
        for name, one in zip(names, size, strict=True)
    }
    told = max(gains, key=lambda name: over[name])
    for place, (name, one) in enumerate(zip(names, record.decoupled, strict=True)):
        part, error = parts[name], errors[:, place]
        period = 1 / one.dynamics.natural_frequency
        noise = as_noise(error, name=f"{DOUBTED}natural frequency", period=period, interval=record.interval)
        doubts = tuple(doubt for doubt in part.doubts if name not in gains or doubt.kind != "colored noise")
        if name == told:
            text = (
                f"{' and '.join(gains)} read{'s' if len(gains) == 1 else ''} what with these dynamics would be noise "
                "of a color, and is what other modes make of a force: the dynamics are those of another balance, or "
                "its channels are in another order"
            )
            doubts += (Doubt("natural frequency", name, text, ADVICE, float(size[place]), si_unit(name)),)
        found[name] = replace(with_errors(part, noise), doubts=doubts)
    return found


def _in_white_noise(readings: Mapping[str, Observation], parts: Mapping[str, ComponentForce]) -> dict[str, float]:
    """Gains of other modes in white noise over a component's own, where these leave noise of a color.

    A reading of one mode alone is asked as that of a single component is; its mass does not matter.
    """
    gains = {}
    for name, reading in readings.items():
        learned, (mode, *further) = parts[name].learned, reading.dynamics.modes
        if further or learned is None or learned.color is None or not reading.present.all():
            continue
        w = mode.angular_frequency
        alone = Dynamics(name, 1.0, w**2, 2 * mode.damping_ratio * w)
        gain = gain_in_white_noise(reading.values, alone, interval=reading.interval, least_noise=reading.least_noise)
        if gain > 0:
            gains[name] = gain
    return gains


def _by_shapes(
    record: CoupledRecord,
    filled: Array,
    parts: Mapping[str, ComponentForce],
    readings: Mapping[str, Observation],
) -> dict[str, ComponentForce]:
    """Those that the modes of the record speak against, or that hang on what these do not tell."""
    dynamics, interval = record.dynamics, record.interval
    loads, names = SplitLoads.of(record, filled), dynamics.components
    within, most = _between_gaps(record), most_samples(record)
    asked = ringing = RingingSpectra.of(record, loads.part(within), parts)
    other, first = _spoken(ringing, record, loads, parts, readings, within=within), 0
    # the balance may have changed on the way; of a part before others the next one's beginning tells
    if other is None and within.stop - within.start > most and record.recording.extent.end > 1 - SETTINGS.end:
        end = slice(within.stop - most, within.stop)
        asked = RingingSpectra.of(record, loads.part(end), parts)
        other = _spoken(asked, record, loads, parts, readings, within=end)
        first = min(within.start + most, within.stop - most)
    if other is None or asked is None:
        return _frequencies_assumed(ringing, record, parts)
    shown = other.moved is not None and other.probability == 1 and not first and asked.shows_motion(asked.own)
    if shown and not asked.shows_motion(other.rows) and beats_channels(asked, record, other, within=within):
        # what other modes leave of the motion looks like another gain or a delay of its channels
        parts = {name: without_ground_doubts(part) for name, part in parts.items()}
    bandwidth = np.array([parts[name].bandwidth for name in names])
    errors = np.sqrt(other.probability) * force_errors(record, loads, other.rows, bandwidth)
    errors[:first] = 0.0
    name_of_error = f"{DOUBTED}{other.kind}" if other.probability == 1 else LEFT_OPEN
    size = np.sqrt(np.mean(errors**2, axis=0))
    # of a component in which no force was found its uncertainty is what there is
    known = [np.mean(parts[name].values ** 2) + np.mean(parts[name].uncertainty ** 2) for name in names]
    relative = size / np.sqrt(np.maximum(known, 1e-300))
    told = other.places or (int(np.argmax(relative)),)
    found = {}
    for place, name in enumerate(names):
        part = parts[name]
        period = 1 / record.decoupled[place].dynamics.natural_frequency
        error = as_noise(errors[:, place], name=name_of_error, period=period, interval=interval)
        part = with_errors(part, error)
        if place in told and (other.probability == 1 or relative[place] > TOLD):
            text, advice = _words(other, dynamics)
            since = f" (at the end of the record, not up to {record.recording.start + first * interval:.4g} s)"
            text = f"{text}{since if first else ''}"
            unit = si_unit(name)
            doubt = Doubt(other.kind, name, text, advice, float(size[place]), unit, other.probability)
            part = replace(part, doubts=(*part.doubts, doubt))
        found[name] = part
    return found


def _by_others(forces: Array, own: CoupledDynamics, other: CoupledDynamics, *, interval: float) -> Array:
    """Rms of what the forces by the own dynamics are off by where others are right, shape (n,) [N, N*m].

    Parameters
    ----------
    forces
        The forces, shape (samples, n); their ends do not matter to their rms.
    own, other
        The dynamics, without internal coordinates.
    interval
        Time between samples [s].
    """
    count = 2 * len(forces)
    lines = np.fft.rfft(np.concatenate([forces, forces[::-1]]), axis=0)
    frequency, power = np.fft.rfftfreq(count, interval), np.zeros(forces.shape[1])
    poles, shapes, weights = other.modal_form
    damping, inertia = own.quadratic
    for first in range(0, frequency.size, AT_ONCE):
        some = slice(first, first + AT_ONCE)
        s = 2j * np.pi * frequency[some, None]
        # mode by mode: a matrix inverted at every frequency takes three times as long
        felt = ((lines[some] @ weights.T) / (s - poles)) @ shapes.T
        change = felt + s * (felt @ damping.T) + s**2 * (felt @ inertia.T) - lines[some]
        power += 2 * np.sum(change.real**2 + change.imag**2, axis=0)
    return np.asarray(np.sqrt(power) / count)


def _frequencies_assumed(
    ringing: RingingSpectra | None, record: CoupledRecord, parts: Mapping[str, ComponentForce]
) -> dict[str, ComponentForce]:
    """The forces that other natural frequencies would change, with that assumed; none where the record tells them.

    Parameters
    ----------
    ringing
        The spectra of the samples that are asked; None where they are too few.
    record, parts
        As of `shape_doubts`.
    """
    dynamics, own = record.dynamics, Moved.none(record.dynamics)
    if not dynamics.has_one_mode_each:
        return {}
    others = [own.by(slice(None), np.array([sign * ASSUMED.frequency, 0.0])) for sign in (1, -1)]
    forces = np.column_stack([parts[name].values for name in dynamics.components])
    if dynamics.mass is not None:  # the balance reads the motion's force as it reads the others
        motion = net_load(record.platform, dynamics)
        forces = forces + motion - motion.mean(axis=0)
    size = _by_others(forces, dynamics, others[0].moved, interval=record.interval)
    least = [ASSUMED.matters * float(np.sqrt(np.mean(parts[name].uncertainty ** 2))) for name in dynamics.components]
    if not (size > least).any():
        return {}
    if ringing is not None:
        # by the curvature: which side is the likelier is chance where the record tells little
        lost = ringing.joint_evidence(ringing.own) - 0.5 * sum(ringing.joint_evidence(one.rows) for one in others)
        if lost > SETTINGS.tells:
            return {}
    found = {}
    for name, effect, enough in zip(dynamics.components, size.tolist(), (size > least).tolist(), strict=True):
        if enough:
            unit = si_unit(name)
            text = (
                f"the natural frequencies of the modes are exact, which this record does not tell: "
                f"{100 * ASSUMED.frequency:g} % more or less of all would change the force by {effect:.2g} {unit} rms"
            )
            one = Assumption("natural frequency", name, text, effect, unit)
            found[name] = replace(parts[name], assumed=(*parts[name].assumed, one))
    return found


def _between_gaps(record: CoupledRecord) -> slice:
    """The longest stretch of a record without a gap of more than a period of the lowest mode.

    Such a gap is filled by what the forces about it predict, which die away there, and with them all that rings: what
    is filled rings in no mode.
    """
    there = np.asarray(np.isfinite(record.loads).all(axis=1))
    edges = np.flatnonzero(np.diff(there)) + 1
    runs = np.split(np.arange(there.size), edges)
    long = 1 / (record.dynamics.modes[0].natural_frequency * record.interval)
    gaps = [run for run in runs if not there[run[0]] and run.size > long]
    begins = [0, *(int(gap[-1]) + 1 for gap in gaps)]
    ends = [*(int(gap[0]) for gap in gaps), there.size]
    begin, end = max(zip(begins, ends, strict=True), key=lambda pair: pair[1] - pair[0])
    return slice(begin, end)


def _spoken(
    ringing: RingingSpectra | None,
    record: CoupledRecord,
    loads: SplitLoads,
    parts: Mapping[str, ComponentForce],
    readings: Mapping[str, Observation],
    *,
    within: slice,
) -> OtherShapes | None:
    """What the ringing of some samples of the loads speaks for, where they are enough to say so.

    `ringing` are the spectra of those samples, `readings` those of the decoupled components.
    """
    if ringing is None:
        return None
    far = any(
        (part.learned is not None and part.learned.color is not None)
        or any(doubt.kind == "unexplained" for doubt in part.doubts)
        for part in parts.values()
    )
    other = other_shapes(ringing, record.dynamics, far=far)
    if other is None:
        first = int(within.start)
        shown = moved_by_motion(ringing, record.dynamics)
        if shown is not None and beats_channels(ringing, record, shown, within=within):
            return shown
        alone = moved_alone(ringing, record.dynamics)
        return alone or one_moved(ringing, record, parts, readings, first=first)
    # a tone is narrower than any resonance, and looks like one that is elsewhere
    above = SETTINGS.tones_above * record.dynamics.modes[0].natural_frequency * record.interval
    ringing = RingingSpectra.of(record, loads.part(within).without_tones(above=above), parts)
    return None if ringing is None else other_shapes(ringing, record.dynamics, far=far)


def _words(other: OtherShapes, dynamics: CoupledDynamics) -> tuple[str, str]:
    """What was seen and what it does, and what to do next."""
    names = " and ".join(dynamics.components[place] for place in other.places)
    several = len(other.places) > 1
    if other.kind == "swapped sign":
        text = (
            f"the components ring together as in the modes of the dynamics if {names} {'have' if several else 'has'} "
            "the other sign: the forces of all components that ring with it are wrong"
        )
        return text, f"check the sign of {names} in this record and in the releases of the identification"
    if other.kind == "swapped channels":
        text = (
            f"the components ring together as in the modes of the dynamics if {names} are exchanged: the forces of "
            "all components that ring with them are wrong"
        )
        return text, f"check the channels of {names} in this record and in the releases of the identification"
    changed = []
    moved = other.moved or Moved.none(dynamics)
    for mode, (shift, ratio) in zip(dynamics.modes, moved.changes, strict=True):
        if abs(shift) > MOVED.told or abs(ratio) > MOVED.told_damping:
            now, before = mode.natural_frequency * np.exp(shift), mode.natural_frequency
            what = f"at {now:.4g} Hz and not {before:.4g} Hz"
            if abs(ratio) > MOVED.told_damping:
                now, before = mode.damping_ratio * np.exp(ratio), mode.damping_ratio
                what += f" (damping ratio {now:.2g} and not {before:.2g})"
            changed.append(what)
    sure = other.probability == 1
    likely = "" if sure else f" (probability {min(other.probability, 0.99):.2g})"
    text = (
        f"the components {'ring' if sure else 'may ring'} together {', '.join(changed)}{likely}: "
        "stiffness, mass or damping have changed since "
        "they were identified, or the dynamics are those of another balance; forces near these frequencies "
        f"{'are wrong' if sure else BY_PROBABILITY}"
    )
    return text, ADVICE
