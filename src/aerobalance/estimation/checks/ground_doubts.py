"""Doubts of the channels of the ground's motion, each with the error that it gives the force."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from aerobalance.estimation.checks.ground_channels import GroundFault
from aerobalance.estimation.checks.ground_witnesses import SETTINGS
from aerobalance.estimation.error_sources import Contribution, Systematic
from aerobalance.estimation.record import Through
from aerobalance.estimation.result import ComponentForce, budget_of
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import DOUBTED, Doubt
from aerobalance.recording.errors import argument

LEFT_OPEN: Final = "ground channel that the record leaves open"
"""Name of what a delay or a gain may do to a force that the record neither shows nor rules out."""

ANGLES: Final = ("pitch", "roll")
"""Channels of the attitude."""


def ground_doubts(
    component: str, faults: Sequence[GroundFault], through: Through, *, errors: Sequence[Contribution]
) -> Iterator[tuple[Doubt | None, Systematic]]:
    """Yield doubts of the channels of the ground's motion, each with the error that the force has from it.

    What the record leaves open of a channel is no doubt: its error counts by its probability.

    Parameters
    ----------
    component
        Which force.
    faults
        What the loads say of the channels.
    through
        What the smoother makes of readings.
    errors
        What its uncertainty consists of so far.
    """
    uncertainty = float(np.sqrt(np.sum([np.mean(error.deviation**2) for error in errors])))
    for fault in faults:
        errors_of_it = through(fault.left)
        yield from _doubts(component, fault, errors_of_it, uncertainty=uncertainty)
        for error in _left_open(fault, errors_of_it):
            yield None, error


def without_ground_doubts(force: ComponentForce) -> ComponentForce:
    """Return the same without doubts of the channels of the ground's motion and what these added to its uncertainty.

    What was done to a channel on request stays said.
    """
    of_ground = (f"{DOUBTED}ground", f"{DOUBTED}attitude", LEFT_OPEN)
    kept = tuple(one for one in force.contributions if not one.name.startswith(of_ground))
    doubts = tuple(one for one in force.doubts if not one.kind.startswith(("ground", "attitude")) or one.effect == 0)
    if len(kept) == len(force.contributions):
        return replace(force, doubts=doubts)
    whole = np.sqrt(np.sum([one.deviation**2 for one in kept], axis=0))
    return replace(force, doubts=doubts, contributions=kept, uncertainty=whole, budget=budget_of(kept))


def _left_open(fault: GroundFault, errors: Array) -> Iterator[Systematic]:
    """What a delay or a gain that is left open may do to the force, by its probability."""
    for place, (size, u) in enumerate(((fault.delay, fault.u_delay), (fault.gain, fault.u_gain))):
        likely = fault.probability(size, u)
        if 0 < likely < 1:
            may_be = float(np.sqrt(likely * (1 + (u / size) ** 2)))
            slope = may_be * errors[:, place]
            yield Systematic(LEFT_OPEN, fault.channel, (LEFT_OPEN,), slope[:, None], np.eye(1), local=True)


def _doubts(
    component: str, fault: GroundFault, errors: Array, *, uncertainty: float
) -> Iterator[tuple[Doubt, Systematic]]:
    """Doubts of one channel; the errors are those by delay, by gain, and by delay with its drift, (n, 3)."""
    unit, name = si_unit(component), fault.channel
    kind = "attitude" if name in ANGLES else "ground"
    cause = f"or a force that goes with {name}, as that of the flow may"
    single = len(fault.shown_by) == 1
    shown = f"{component} shows" if single else "the loads show"
    effects = np.sqrt(np.mean(errors**2, axis=0))
    late = abs(fault.delay) > fault.sure * fault.u_delay
    drifts = abs(fault.drift) > max(fault.sure * fault.u_drift, SETTINGS.clock * abs(fault.delay))
    by_delay = float(effects[2 if drifts else 0]) if late or drifts else 0.0
    by_gain = float(effects[1]) if abs(fault.gain) > fault.sure * fault.u_gain else 0.0
    own = errors[:, [2 if drifts else 0]]
    if by_gain > 0 and _of_the_delay(fault.gain, by_delay=by_delay, by_gain=by_gain):
        own = np.column_stack([own, errors[:, 1]])  # not their sum: both are known to first order alone
        by_delay, by_gain = float(np.hypot(by_delay, by_gain)), 0.0
    least = max(SETTINGS.matters * uncertainty, SETTINGS.beside * max(by_delay, by_gain))
    if by_delay > least:
        word = "late" if fault.delay > 0 else "early"
        text = (
            f"{name} is {1e3 * abs(fault.delay):.3g} ms {word} (u = {1e3 * fault.u_delay:.2g} ms) against what "
            f"{shown} of it: a filter or a delay that is not declared, {cause}"
        )
        taken_off = f"; {argument('align')} takes off what the load shows" if single else ""
        advice = f"declare the delay or the filter of {name} in the channel map{taken_off}"
        if drifts:
            text = (
                f"the delay of {name} against what {shown} of it changes by {1e3 * fault.drift:.3g} ms "
                f"along the record (u = {1e3 * fault.u_drift:.2g} ms): their clocks are not one, {cause}"
            )
            advice = f"record {name} by the clock of the balance"
        what = "clock" if drifts and kind == "ground" else "delay"
        doubt = Doubt(f"{kind} {what}", component, text, advice, by_delay, unit)
        yield doubt, _as_error(doubt, fault, own)
    if by_gain > least:
        either = f"{name} or of {component}" if single else name  # of several, a wrong one of them shows by itself
        text = (
            f"{shown} {1 + fault.gain:.4g} times (u = {fault.u_gain:.2g}) what {name} reads: another gain, "
            f"unit or sign of {either}, or another mass than that of the dynamics, {cause}"
        )
        advice = f"check sensitivity, unit and sign of {either}, and the mass"
        doubt = Doubt(f"{kind} gain", component, text, advice, float(effects[1]), unit)
        yield doubt, _as_error(doubt, fault, errors[:, [1]])


def _of_the_delay(gain: float, *, by_delay: float, by_gain: float) -> bool:
    """Whether a loss of gain is what the delay itself makes to second order.

    A motion of angular frequency w that is late by t has cos(wt) of the motion in it, a loss of 1 - cos(wt), and
    sin(wt) of the motion a quarter of a period earlier.

    Parameters
    ----------
    gain
        By how much it has to be changed [1].
    by_delay, by_gain
        Errors of the force from both (rms): the latter over the gain is what the channel makes in all.
    """
    sine = min(by_delay * abs(gain) / by_gain, 1.0)
    return 0 < -gain < SETTINGS.second_order * (1 - float(np.sqrt(1 - sine**2)))


def _as_error(doubt: Doubt, fault: GroundFault, errors: Array) -> Systematic:
    """The errors of a doubt, shape (n, p); of one component alone there is one sensor of each kind."""
    name = f"{DOUBTED}{doubt.kind}" + (f" of {fault.channel}" if len(fault.shown_by) > 1 else "")
    count = errors.shape[1]
    return Systematic(name, fault.channel, (name,) * count, errors, np.eye(count), local=True)
