"""What a record says against the dynamics that it is read with, and what that does to the force.

What it says of one component is found in `aerobalance.estimation.checks.other_dynamics`, of coupled ones in
`aerobalance.estimation.checks.mode_shapes`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any, Final

import numpy as np

from aerobalance.dynamics.modal import ModalModel
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.checks.asked_readings import unbroken, without_steps
from aerobalance.estimation.checks.driven_dynamics import driven_dynamics, without_contradicted
from aerobalance.estimation.checks.ground_doubts import without_ground_doubts
from aerobalance.estimation.checks.mode_shapes import shape_doubts
from aerobalance.estimation.checks.model_error import LEFT_OPEN, TOLD, as_noise, error_under
from aerobalance.estimation.checks.not_linear import NotLinear, all_along, friction_of, not_linear
from aerobalance.estimation.checks.other_dynamics import (
    ModelDoubt,
    as_said,
    other_dynamics_in,
    peaks_of,
)
from aerobalance.estimation.checks.peaks import peak_doubts
from aerobalance.estimation.checks.spoken import Spoken
from aerobalance.estimation.checks.step_ringing import friction_by_steps
from aerobalance.estimation.checks.unmeasured_rotation import turning_by_angles
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.independent_record import SingleRecord
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.result import ComponentForce, with_doubt, with_errors
from aerobalance.estimation.spectra.lines import Line
from aerobalance.estimation.steps import Step, columns_of
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import DOUBTED
from aerobalance.recording.side_by_side import side_by_side

DYNAMICS: Final = ("natural frequency", "damping ratio", "missing mode")
"""Kinds of doubt about the dynamics."""

MATTERS: Final = 0.3
"""Error by what is not linear over the uncertainty, or over what other dynamics do, from which it is worth a word."""

MATTERS_WITH_STEPS: Final = 1.0
"""The same beside steps, of which a little is left that goes with the ringing."""

NEAR: Final = 1 / 3
"""Distance from the natural frequency, over it, within which it is looked how much ringing is left beside steps."""

MOVED: Final = 0.1
"""Relative change of the natural frequency from which on it is another balance, and no spring that is not linear."""


def checked(force: Force) -> Force:
    """Return forces with what the record says against the dynamics, and their uncertainty raised by what that does.

    Parameters
    ----------
    force
        The forces, which hold the record.
    """

    def known(one: ComponentRecord) -> dict[str, Any]:
        part = force[one.dynamics.component]
        return {"noise": part.noise, "steps": part.steps, "lines": (*part.hum, *_tones_read(part, one))}

    def known_of_one(one: ComponentRecord) -> dict[str, Any]:
        # what a ground channel leaves in the readings swings as well, and is no other damping
        part = force[one.dynamics.component]
        explained = any(doubt.kind.startswith(("ground", "attitude")) for doubt in part.doubts)
        return {**known(one), "learned": None if explained else part.learned, "bends": part.bends}

    record, parts = force.record, dict(force.parts)
    if isinstance(record, CoupledRecord):
        filled = force.filled
        # with a dead channel nothing rings as the dynamics do, and that is said of it
        dead = any(doubt.kind in ("stuck channel", "clipping") and doubt.effect is None for doubt in force.doubts)
        otherwise = shape_doubts(record, filled, parts) if np.ptp(filled, axis=0).all() and not dead else {}
        sure = dead or any(part.doubts != parts[name].doubts for name, part in otherwise.items())
        parts |= {name: _named_only(part) if sure else part for name, part in otherwise.items()}
        # what rings otherwise leaves peaks everywhere
        decoupled = {} if sure else record.component_records(filled)
        peaks = list(chain(*side_by_side(lambda one: peaks_of(one, **known(one)), decoupled.values())))
        turning = turning_by_angles(force.recording, record.dynamics, force)
        for doubt in [*peak_doubts(peaks, record.dynamics.modes), *turning]:
            part = parts[doubt.component]
            parts[doubt.component] = replace(part, doubts=(*part.doubts, doubt))
    else:
        for name in force:
            asked, found_motion = record.component_record(name), force[name].found_motion
            own = asked.dynamics
            one = asked if found_motion is None else asked.with_motion(found_motion)
            if not force.settings.align:
                asked = (
                    one  # motion that a gap hid is motion; only a channel that was brought to the load may be right
                )
            kinds = {doubt.kind for doubt in force[name].doubts}
            if kinds & {"resolution", "too many steps"}:
                continue  # what rounding makes of a load swings at multiples of it, and so does a square wave
            facts = known_of_one(one)
            known_of_motion = {"used": one, "steps": facts["steps"], "lines": facts["lines"]}
            shown = driven_dynamics(asked, **known_of_motion)
            if shown is not None:  # what it leaves of the motion looks like another gain or a delay of its channel
                parts[name] = without_ground_doubts(parts[name])
                kinds = {doubt.kind for doubt in parts[name].doubts}
            else:
                shown = without_contradicted(other_dynamics_in(one, **facts), asked, **known_of_motion)
            net, lacking = one.motion_force, one.motion_force - asked.motion_force
            found, interval = shown.doubts(own), one.interval
            bent, error = _not_linear(one, force[name]) or (None, np.zeros(0))
            moved = shown.frequency is not None and abs(shown.frequency[0]) > MOVED
            if bent is not None and bent.of_spring and bent.probability == 1 and not moved:
                found = _of_a_spring(found, bent, error, force=force[name].values + net, own=own, interval=interval)
            elif bent is not None and not bent.of_spring and bent.probability == 1:
                found = [one for one in found if one.doubt.kind != "damping ratio"]  # it damps what rings as well
            under = partial(_error_under, force[name].values + net, lacking, own=own, interval=interval)
            parts[name] = _raised(parts[name], found, own, under, interval=interval)
            if shown.possible is not None:
                parts[name] = _left_open(
                    parts[name], shown.possible, own, under, interval=interval, within=shown.within
                )
            # damping that is not linear may look like noise of a color
            colored = "colored noise" in kinds and bent is not None and not bent.of_spring and bent.probability < 1
            if bent is not None and not found and not colored and _stands(bent, one, force[name]):
                parts[name] = _bent(parts[name], one, bent, error)
    return replace(force, parts={name: _without_vague(part) for name, part in parts.items()})


def _tones_read(force: ComponentForce, record: ComponentRecord) -> tuple[Line, ...]:
    """Steady tones of a force as lines of its readings."""
    return tuple(tone.read_by(record.dynamics.response) for tone in force.tones)


def _besides_motion(force: ComponentForce, record: ComponentRecord) -> tuple[Line, ...]:
    """Lines of the readings without which they tell whether the motion is linear.

    That are hum and tones that drift: all harmonics of a rotation drift alike, and so go with the powers of the motion
    at as many frequencies as it passes.
    """
    drifting = tuple(tone for tone in _tones_read(force, record) if tone.drift)
    return (*force.hum, *drifting)


def _error_under(net: Array, lacking: Array, other: ModalModel, *, own: ModalModel, interval: float) -> Array:
    """Error of a force if the balance is another, shape (n,) [N].

    The balance is under that of the ground's motion as well. Where a channel of it was brought to what the load shows
    with the expected dynamics, it was not the channel.

    Parameters
    ----------
    net
        The force and that of the motion together, shape (n,) [N].
    lacking
        What the motion was changed by, as a force, shape (n,) [N].
    other, own, interval
        As in `error_under`.
    """
    return error_under(net, own=own, other=other, interval=interval) - lacking


def _raised(
    force: ComponentForce,
    found: list[ModelDoubt],
    own: ModalModel,
    under: Callable[[ModalModel], Array],
    *,
    interval: float,
) -> ComponentForce:
    """A force with doubts of its dynamics, each with its effect, which is added to the uncertainty."""
    for one in found:
        if one.other is None:
            force = with_doubt(force, one.doubt)
            continue
        error = _within(under(one.other), one.within)
        doubt = replace(one.doubt, effect=float(np.sqrt(np.mean(error**2))))
        period = 1 / own.natural_frequency
        noise = as_noise(error, name=f"{DOUBTED}{doubt.kind}", period=period, interval=interval)
        force = with_doubt(force, doubt, noise)
    return force


def _within(error: Array, where: slice | None) -> Array:
    """An error, zero but for some samples; None for all."""
    if where is None:
        return error
    inside = np.zeros_like(error)
    inside[where] = error[where]
    return inside


def _left_open(
    force: ComponentForce,
    possible: Spoken,
    own: Dynamics,
    under: Callable[[ModalModel], Array],
    *,
    interval: float,
    within: slice | None,
) -> ComponentForce:
    """A force whose uncertainty counts other dynamics by their probability.

    They are doubted as well where that is much of the force: nobody looks for it in a budget.
    """
    error = _within(under(possible.dynamics), within)
    weighted = np.sqrt(possible.probability) * error
    noise = as_noise(weighted, name=LEFT_OPEN, period=1 / own.natural_frequency, interval=interval)
    effect, values = _rms(weighted), force.values
    if effect <= TOLD * max(float(np.std(values)), abs(float(np.mean(values)))):
        return with_errors(force, noise)
    (told,) = replace(as_said(possible, own), within=within).doubts(own)
    return with_doubt(force, replace(told.doubt, effect=effect), noise)


def _not_linear(record: SingleRecord, force: ComponentForce) -> tuple[NotLinear, Array] | None:
    """What a record shows that is not linear, and the error of the force by it, (n,) [N]; None where it is small.

    A step looks like a spring that is not linear, so a force for which no steps were looked for tells none.
    """
    if force.learned is None:
        return None
    seen = unbroken(record, force.steps, _besides_motion(force, record))
    if seen is None:
        return None
    reading, within = seen
    rubs = friction_by_steps(reading, within, force.learned)
    friction = None if rubs is None else friction_of(*rubs, record.dynamics)
    if friction is not None and friction.probability == 1:
        bent: NotLinear | None = friction
    else:
        bent = not_linear(reading, record.dynamics, left=_less_steps(reading, within) if within else None) or friction
    if bent is None:
        return None
    error = bent.force(force.values, record.dynamics, interval=record.interval)
    least = MATTERS_WITH_STEPS if within and bent.of_spring else MATTERS
    return (bent, error) if _rms(error) > least * _rms(force.uncertainty) else None


def _stands(bent: NotLinear, record: SingleRecord, force: ComponentForce) -> bool:
    """Whether what is not linear is believed although something in the record is not explained.

    A shock goes with the motion as all of it does, but not in every part of the record.
    """
    if all(doubt.kind != "unexplained" for doubt in force.doubts):
        return True
    if bent.probability < 1:
        return False
    if not bent.of_spring:
        return bool(force.steps)
    seen = unbroken(record, force.steps, _besides_motion(force, record))
    if seen is None:
        return False
    reading, within = seen
    return all_along(reading, record.dynamics, bent, left=_less_steps(reading, within) if within else None)


def _less_steps(reading: Observation, steps: Sequence[Step]) -> Array:
    """A reading less its steps, of the heights that were found beside the rest of the force, shape (n,) [N].

    Plain least squares takes some of a slow force for heights: what is left of the ringing after a large step goes
    with the motion, and looks like a spring that is not linear.
    """
    heights = np.array([step.height for step in steps])
    found = reading.values - columns_of(list(steps), reading)[:, 1 : 1 + heights.size] @ heights
    plain = without_steps(reading, steps)  # which knows of a ringing at the begin
    near = reading.dynamics.natural_frequency * reading.interval
    return min(found - found.mean(), plain, key=lambda one: _power_near(one, near))


def _power_near(values: Array, frequency: float) -> float:
    """Power of a series, tapered, within a third of a frequency over the sampling rate [N^2]."""
    ordinate = np.arange(values.size // 2 + 1) / (values.size * frequency)
    spectrum = np.fft.rfft(values * np.hanning(values.size))
    return float(np.sum(np.abs(spectrum[np.abs(ordinate - 1) < NEAR]) ** 2))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _of_a_spring(
    found: list[ModelDoubt], bent: NotLinear, error: Array, *, force: Array, own: ModalModel, interval: float
) -> list[ModelDoubt]:
    """The doubts of the dynamics, named by a spring that is not linear where that explains them: it looks like modes.

    One of them is left, with what the dynamics that the record speaks for do to the force.
    """
    others = [(one, one.other) for one in found if one.other is not None]
    sizes = [_rms(error_under(force, own=own, other=other, interval=interval)) for _, other in others]
    if not others:
        return []  # a mode of which the record tells no size is the spring's, and its effect is known
    if _rms(error) < MATTERS * max(sizes):
        return found
    doubt = bent.doubt(own.component, effect=0.0, unit=si_unit(own.component))
    return [replace(others[int(np.argmax(sizes))][0], doubt=doubt)]


def _bent(force: ComponentForce, record: SingleRecord, bent: NotLinear, error: Array) -> ComponentForce:
    """A force whose uncertainty counts what is not linear, by its probability where the record leaves it open."""
    unit, period = si_unit(record.dynamics.component), 1 / record.dynamics.natural_frequency
    if bent.probability < 1:
        weighted = np.sqrt(bent.probability) * error
        return with_errors(force, as_noise(weighted, name=LEFT_OPEN, period=period, interval=record.interval))
    doubt = bent.doubt(record.dynamics.component, effect=_rms(error), unit=unit)
    noise = as_noise(error, name=f"{DOUBTED}{doubt.kind}", period=period, interval=record.interval)
    return with_doubt(force, doubt, noise)


def _named_only(force: ComponentForce) -> ComponentForce:
    """The same without doubts that name no fault, or a color or lines of what rings as the dynamics do not."""
    vague = ("unexplained", "colored noise", "interference")
    return replace(force, doubts=tuple(doubt for doubt in force.doubts if doubt.kind not in vague))


def _without_vague(force: ComponentForce) -> ComponentForce:
    """The same without a doubt that names no fault where another explains the same.

    Of dynamics that are not the balance's own the force shows as a noise of some color as well, and as lines that are
    no larger than what is wrong with it.
    """
    named = [doubt for doubt in force.doubts if doubt.kind != "unexplained"]
    wrong = [doubt for doubt in named if doubt.kind in (*DYNAMICS, "not linear")]
    if wrong:
        most = max(np.inf if doubt.effect is None else doubt.effect for doubt in wrong)
        named = [
            doubt
            for doubt in named
            if doubt.kind != "colored noise" and (doubt.kind != "interference" or (doubt.effect or 0.0) > most)
        ]
    serious = any(doubt.effect is None or doubt.effect > 0 for doubt in named)
    return replace(force, doubts=tuple(named)) if serious else force
