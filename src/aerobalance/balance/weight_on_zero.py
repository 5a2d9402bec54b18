"""Zeros of gauge outputs with the weight that they were read under taken out.

A curved bridge reads a load by what else hangs on the balance, so a zero that was read with the model on is brought to
that without it, from what is known of the weight: by a weighing, by the mass in the dynamics, or by the natural zeros
of the calibration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.zeros import (
    CarriedWeight,
    GaugeZero,
    Zero,
    beyond_weight,
    change_of_sensitivity,
    from_natural_zeros,
    gauge_zero,
    in_own_components,
    reads_no_weight,
    seen_on_zero,
    without_weight,
)
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.errors import argument, warn_quality
from aerobalance.recording.gravity import Attitudes, GravityOnZero, gravity_share, weight_direction
from aerobalance.recording.recording import Recording

FORCES: Final = tuple(name for name in COMPONENTS if si_unit(name) == "N")

CURVED: Final = 0.001
"""Change of sensitivities, as part of range, from which it is told that a weight on the zero is not known."""

USUAL_WEIGHT: Final = 0.3
"""Weight over range that a model may well have."""

SHARED_PITCH: Final = np.radians(0.2)
"""Difference of the mean attitude up to which two recordings are at the same one [rad]."""

_NOTHING: Final = np.zeros(len(COMPONENTS))


@dataclass(frozen=True, slots=True)
class NotWeighed:
    """What hangs on a balance where no weight of it is known."""

    components: tuple[str, ...] = ()

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """No weight is known along any component."""
        raise ValueError(f"the weight along {name} is not known")


class WeightOnZero(NamedTuple):
    """What hung on the balance while its zero was read, along the components.

    Attributes
    ----------
    weight
        Shape (6,) [N, N*m].
    pull
        Gravity on it.
    warning
        What is doubtful about it, or nothing.
    known
        Components along which the weight is known.
    guess
        What it would be along the other forces if it were one mass at the balance's centre, shape (6,) [N, N*m].
    """

    weight: Array
    pull: GravityOnZero
    warning: str = ""
    known: tuple[str, ...] = COMPONENTS
    guess: Array = _NOTHING


def weight_on_zero(zeros: Sequence[Recording], model: CarriedWeight, *, gravity: float, pitched: bool) -> WeightOnZero:
    """Weight of what hung on the balance while its zero was read; level where its pitch was not recorded."""
    lacking = [zero.name for zero in zeros if "pitch" not in zero] if pitched else []
    warning = (
        f"{lacking[0]} has no channel pitch; the zero is taken as read level, with the model on" if lacking else ""
    )
    attitudes = [attitudes_of(zero) for zero in zeros]
    weights = np.zeros((len(zeros), len(COMPONENTS)))
    for row, own in zip(weights, attitudes, strict=True):
        still = not np.ptp(own.pitch) and not np.ptp(own.roll)
        at = Attitudes(own.pitch[:1], own.roll[:1]) if still else own  # at one attitude all samples weigh the same
        for name in model.components:
            row[COMPONENTS.index(name)] = np.nanmean(model.weight(name, pitch=at.pitch, roll=at.roll, gravity=gravity))
    pull = GravityOnZero.of(attitudes, gravity=gravity)
    guess = _mass_of(model, gravity) * pull.acceleration
    weight = weights.mean(axis=0) if zeros else _NOTHING
    return WeightOnZero(weight, pull, warning, model.components, guess)


def settled_zero(zero: Zero | None, balance: BalanceMatrix, carried: WeightOnZero | None) -> GaugeZero | None:
    """Gauge zeros [mV/V] of a run, the weight that they were read under taken out; None where there is no zero.

    Parameters
    ----------
    zero
        Recordings without wind, and how they were read.
    balance
        The balance matrix.
    carried
        What hung on the balance meanwhile; None where nothing is known of it.
    """
    if zero is None:
        return None
    if not zero.recordings:
        return GaugeZero.taken_off(balance)
    alike = zero.model_on is False or (_at_one_attitude(zero.recordings) and _at_one_attitude(zero.after))
    read = gauge_zero(zero.recordings, balance, after=zero.after, model_on=False, alike=alike)
    nothing_on = replace(read, from_natural=from_natural_zeros(read, _NOTHING, COMPONENTS, balance))
    if zero.model_on is False:
        return nothing_on
    if carried is None:
        carried = WeightOnZero(_NOTHING, GravityOnZero(), known=())
    if zero.model_on == "auto" and reads_no_weight(read, carried.weight, balance):
        warn_quality(
            f"{read.source} reads as the natural zeros of the calibration do, without the weight: it is taken as read "
            f"with the model off; {argument('model_on')} says which"
        )
        return nothing_on
    if carried.warning:
        warn_quality(carried.warning)
    read = replace(read, from_natural=from_natural_zeros(read, carried.weight, carried.known, balance))
    return without_weight(_under(read, carried, balance), balance)


def gauge_zero_of_readings(
    readings: Mapping[str, float], balance: BalanceMatrix, *, weight: Mapping[str, float], source: str
) -> tuple[GaugeZero, Array]:
    """Gauge zeros [mV/V] of mean readings under the model, and the loads beyond its known weight, shape (c,) [N, N*m].

    Parameters
    ----------
    readings
        Mean output of every bridge of the balance, by its channel (``rAF``) [mV/V].
    balance
        The balance matrix.
    weight
        Weight of the model along the components where it is known [N, N*m].
    source
        What to call the readings.
    """
    nothing = np.zeros(len(balance.gauges))
    read = GaugeZero(np.array([readings[f"r{gauge}"] for gauge in balance.gauges]), nothing, source, nothing)
    known = np.array([weight.get(name, 0.0) for name in COMPONENTS])
    point = beyond_weight(seen_on_zero(read, balance), known, weight, balance)
    under = without_weight(replace(read, weight=known, operating_point=point), balance)
    return under, np.asarray(point if balance.direct is None else balance.direct @ point)


def zero_or_mean(zero: GaugeZero | None, recordings: Sequence[Recording], balance: BalanceMatrix) -> GaugeZero | None:
    """Take the mean of recordings at rest for a zero, where neither the run nor the calibration has one."""
    if zero is not None or balance.natural_zero is not None:
        return zero
    warn_quality(
        "no zero was given and the calibration has none; the mean of the recordings at rest is taken for it. Offsets "
        "count from there, and curved or bidirectional bridges are read from there"
    )
    return gauge_zero(recordings, balance, model_on=False, alike=False)


def attitudes_of(recording: Recording) -> Attitudes:
    """Pitch and roll of a recording, zero where it has none, shape (n,) each."""
    nothing = np.zeros(recording.samples)
    pitch, roll = (recording.channel(name).values if name in recording else nothing for name in ("pitch", "roll"))
    return Attitudes(pitch, roll)


def _at_one_attitude(recordings: Sequence[Recording]) -> bool:
    """Whether the weight of what hung on the balance was the same in all recordings."""
    pulls = [np.nanmean(weight_direction(*attitudes_of(recording)), axis=0) for recording in recordings]
    return all(bool(np.linalg.norm(pull - pulls[0]) <= SHARED_PITCH) for pull in pulls[1:])


def _under(zero: GaugeZero, carried: WeightOnZero, balance: BalanceMatrix) -> GaugeZero:
    """Zero with the loads it was read under: the weight that is known, and where curved bridges were beyond it."""
    point = beyond_weight(seen_on_zero(zero, balance), carried.weight, carried.known, balance)
    if balance.natural_zero is None and not set(carried.known) >= set(FORCES):
        guessed = np.where([name in carried.known for name in COMPONENTS], carried.weight, carried.guess)
        point = beyond_weight(in_own_components(guessed, balance), carried.weight, carried.known, balance)
        _say_what_is_guessed(zero, point, carried, balance)
    return replace(zero, weight=carried.weight, pull=carried.pull, operating_point=point if point.any() else None)


def _say_what_is_guessed(zero: GaugeZero, point: Array, carried: WeightOnZero, balance: BalanceMatrix) -> None:
    """Warn where the weight on a zero is not known and bridges are so curved that it matters."""
    usual = np.diag(USUAL_WEIGHT * balance.load_scale)
    change = max(change_of_sensitivity(share, balance) for share in ([point] if point.any() else usual))
    if change < CURVED:
        return
    if point.any():
        others = ", ".join(name for name in FORCES if name not in carried.known)
        text = (
            f"{zero.source}: the weight along {others} while this zero was read is not known; that of the same mass "
            f"at the centre of the balance is taken. It changes sensitivities by up to {100 * change:.2g} % of range. "
            "Natural zeros in the calibration would tell it"
        )
    else:
        text = (
            f"{zero.source}: the weight that hung on the balance while this zero was read is not known, and the "
            f"bridges are curved: {100 * USUAL_WEIGHT:g} % of the range would change sensitivities by up to "
            f"{100 * change:.2g} % of range. Give a weighing of all loads as {argument('tare')}, or say "
            f"{argument('model_on', False)} if there was none; natural zeros in the calibration tell it too"
        )
    warn_quality(text)


def _mass_of(model: CarriedWeight, gravity: float) -> float:
    """Mass by the first force that it is known along [kg], zero where it is by none."""
    oblique = np.array([np.pi / 4])  # all forces feel the weight there
    for name in FORCES:
        if name in model.components:
            share = gravity_share(name, pitch=oblique, roll=oblique)
            return float(model.weight(name, pitch=oblique, roll=oblique, gravity=gravity)[0] / (gravity * share[0]))
    return 0.0
