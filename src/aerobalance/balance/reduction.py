"""From the gauge outputs of a run to balance loads that are ready for the dynamics: zeros, weight and tares.

A curved bridge reads a load by what else hangs on the balance, and loads count from a zero that was read with the
model on or off. Both are settled here once, from what is known of the weight: by a weighing, by the mass in the
dynamics, or by the natural zeros of the calibration.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.load_formats import Form
from aerobalance.balance.loads import Loads, loads_of_outputs, wind_off_loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.weighing import LoadPoints, Weighing, points_from_recordings, with_matrix_errors
from aerobalance.balance.weighing import weigh as fit_weight
from aerobalance.balance.zeros import (
    CLEARLY,
    CarriedWeight,
    GaugeZero,
    Zero,
    beyond_weight,
    change_of_sensitivity,
    gauge_zero,
    in_own_components,
    reads_no_weight,
    seen_on_zero,
    without_weight,
)
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY, si_unit
from aerobalance.recording.errors import DataQualityWarning, FitError, argument, warn_quality
from aerobalance.recording.gravity import Attitudes, GravityOnZero, gravity_share
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected

FORCES: Final = tuple(name for name in COMPONENTS if si_unit(name) == "N")

CURVED: Final = 0.001
"""Change of sensitivities, as part of range, from which it is told that a weight on the zero is not known."""

USUAL_WEIGHT: Final = 0.3
"""Weight over range that a model may well have."""

SETTLED: Final = 1e-9
"""Change of a zero from round to round, over the outputs at full load, at which the weight in it is settled."""

MOST_ROUNDS: Final = 20
"""Rounds of weighing after which what is left is taken as it is: a round leaves some percent of the last change."""

_NOTHING: Final = np.zeros(len(COMPONENTS))


@dataclass(frozen=True, slots=True)
class NotWeighed:
    """What hangs on a balance where no weight of it is known."""

    components: tuple[str, ...] = ()

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """No weight is known along any component."""
        raise ValueError(f"the weight along {name} is not known")


def reduce_outputs(
    recording: Recording,
    balance: BalanceMatrix | Calibration,
    *,
    zero: Zero | None = None,
    model: CarriedWeight | None = None,
    tare: Sequence[Recording] | Weighing = (),
    gravity: float = STANDARD_GRAVITY,
    form: Form | None = None,
) -> Loads:
    """Balance loads [N, N*m] of a run, Eq. (2) of [Gorbushin2020]_, with zeros, weight and tares in their place.

    Parameters
    ----------
    recording
        Gauge outputs of all bridges [mV/V, or V with the excitation], and what else was recorded.
    balance
        The balance matrix, or its calibration.
    zero
        What the loads count from; the natural zeros of the calibration where left out.
    model
        What hangs on the balance and whose weight is to stay in the loads, as the force takes it off with its
        dynamics: `Dynamics`, `CoupledDynamics`, or a `Weighing`. None where the loads themselves are wanted.
    tare
        Wind-off recordings whose loads are taken off, or a weighing whose weight is; without `model` only the latter.
    gravity
        Local acceleration of gravity [m/s^2].
    form
        Load format of the result; direct-read, where that is possible, if left out.

    Raises
    ------
    ValueError
        The weight would be taken off twice, or does not go with the format.
    FitError
        The recordings do not go together.
    """
    recording, balance = corrected(recording), matrix_of(balance)
    if isinstance(tare, Weighing) and model is not None:
        raise ValueError(
            f"the weight comes from the mass in the dynamics; a weighing as {argument('tare')} would take it off twice"
        )
    if balance.direct is None and not set(balance.components) <= set(COMPONENTS):
        warn_quality(
            f"the balance matrix lacks the distances of the gauges: the loads stay {', '.join(balance.components)}. "
            f"Calibrate with {argument('Schedule.geometry')} to have NF PM SF YM RM AF"
        )
    if isinstance(tare, Weighing):
        return _weight_off(recording, balance, tare, zero=zero, form=form)
    carried = None
    if model is not None and not tare and zero is not None:
        carried = _carried_on_zero(zero.recordings, model, gravity=gravity, pitched="pitch" in recording)
    counted = settled_zero(zero, balance, carried)
    if tare:
        counted = _stand_in(counted, tare, balance)
        off = wind_off_loads(recording, tare, balance, zero=counted, form=form)
        loads = loads_of_outputs(recording, balance, zero=counted, tare=off, form=form)
        return loads if model is None else replace(loads.without_gravity, ready=True)
    loads = loads_of_outputs(recording, balance, zero=counted, form=form)
    attitude = "pitch" in recording or any(channel.coupling == "dc" for channel in recording)
    if model is None:
        return loads
    return replace(loads if attitude else loads.without_weight_of_zero, ready=True)


class Carried(NamedTuple):
    """What hung on the balance while its zero was read, along the components.

    Attributes
    ----------
    weight
        Shape (6,) [N, N*m].
    pull
        Gravity on it.
    doubt
        What is doubtful about it, or nothing.
    known
        Components along which the weight is known.
    guess
        What it would be along the other forces if it were one mass at the balance's centre, shape (6,) [N, N*m].
    """

    weight: Array
    pull: GravityOnZero
    doubt: str = ""
    known: tuple[str, ...] = COMPONENTS
    guess: Array = _NOTHING


def settled_zero(zero: Zero | None, balance: BalanceMatrix, carried: Carried | None) -> GaugeZero | None:
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
    read = gauge_zero(zero.recordings, balance, after=zero.after, model_on=False)
    if zero.model_on is False:
        return read
    if carried is None:
        carried = Carried(_NOTHING, GravityOnZero(), known=())
    if zero.model_on == "auto" and reads_no_weight(read, carried.weight, balance):
        warn_quality(
            f"{read.source} reads as the natural zeros of the calibration do, without the weight: it is taken as read "
            f"with the model off; {argument('model_on')} says which"
        )
        return read
    if carried.doubt:
        warn_quality(carried.doubt)
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


def _under(zero: GaugeZero, carried: Carried, balance: BalanceMatrix) -> GaugeZero:
    """Zero with the loads it was read under: the weight that is known, and where curved bridges were beyond it."""
    point = beyond_weight(seen_on_zero(zero, balance), carried.weight, carried.known, balance)
    if balance.natural_zero is None and not set(carried.known) >= set(FORCES):
        guessed = np.where([name in carried.known for name in COMPONENTS], carried.weight, carried.guess)
        point = beyond_weight(in_own_components(guessed, balance), carried.weight, carried.known, balance)
        _say_what_is_guessed(zero, point, carried, balance)
    return replace(zero, weight=carried.weight, pull=carried.pull, operating_point=point if point.any() else None)


def _say_what_is_guessed(zero: GaugeZero, point: Array, carried: Carried, balance: BalanceMatrix) -> None:
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


def _stand_in(zero: GaugeZero | None, recordings: Sequence[Recording], balance: BalanceMatrix) -> GaugeZero | None:
    """Take the mean of recordings at rest for a zero, where neither the run nor the calibration has one."""
    if zero is not None or balance.natural_zero is not None:
        return zero
    warn_quality(
        "no zero was given and the calibration has none; the mean of the recordings at rest is taken for it. Offsets "
        "count from there, and curved or bidirectional bridges are read from there"
    )
    return gauge_zero(recordings, balance, model_on=False)


def _carried_on_zero(zeros: Sequence[Recording], model: CarriedWeight, *, gravity: float, pitched: bool) -> Carried:
    """Weight of what hung on the balance while its zero was read; level where its pitch was not recorded."""
    lacking = [zero.name for zero in zeros if "pitch" not in zero] if pitched else []
    doubt = f"{lacking[0]} has no channel pitch; the zero is taken as read level, with the model on" if lacking else ""
    attitudes = [_attitudes_of(zero) for zero in zeros]
    weights = np.zeros((len(zeros), len(COMPONENTS)))
    for row, (pitch, roll) in zip(weights, attitudes, strict=True):
        for name in model.components:
            row[COMPONENTS.index(name)] = np.nanmean(model.weight(name, pitch=pitch, roll=roll, gravity=gravity))
    pull = GravityOnZero.of(attitudes, gravity=gravity)
    guess = _mass_of(model, gravity) * pull.acceleration
    weight = weights.mean(axis=0) if zeros else _NOTHING
    return Carried(weight, pull, doubt, model.components, guess)


def _mass_of(model: CarriedWeight, gravity: float) -> float:
    """Mass by the first force that it is known along [kg], zero where it is by none."""
    oblique = np.array([np.pi / 4])  # all forces feel the weight there
    for name in FORCES:
        if name in model.components:
            share = gravity_share(name, pitch=oblique, roll=oblique)
            return float(model.weight(name, pitch=oblique, roll=oblique, gravity=gravity)[0] / (gravity * share[0]))
    return 0.0


def _weight_off(
    recording: Recording, balance: BalanceMatrix, weighing: Weighing, *, zero: Zero | None, form: Form | None
) -> Loads:
    """Balance loads less the weight of a weighing, as the zero and the run have it at their attitudes."""
    if form not in (None, "direct"):
        raise ValueError(
            f"{argument('form', form)} cannot go with a weighing as {argument('tare')}, whose weight is known in "
            f"direct-read form; give wind-off recordings with {argument('tare')} instead, or leave "
            f"{argument('form')} out"
        )
    carried = None
    if zero is not None and zero.recordings and zero.model_on is not False:
        carried = _weighed_on_zero(zero.recordings, weighing)
    counted = settled_zero(zero, balance, carried)
    since = zero.recordings if zero is not None and counted is not None and counted.weight.any() else ()
    tare = _weight(recording, weighing, balance, since=since)
    return loads_of_outputs(recording, balance, zero=counted, tare=tare, form=form)


def _weighed_on_zero(zeros: Sequence[Recording], weighing: Weighing) -> Carried:
    """Weight of a weighing at the attitudes of its zeros, their mean."""
    lacking = [recording.name for recording in zeros if "pitch" not in recording]
    if lacking:
        raise FitError(
            f"{lacking[0]} has no channel pitch, so the weight in its zero is not known; record pitch with the zero, "
            f"say {argument('model_on', False)} if it was read without the model, or take wind-off recordings as "
            f"{argument('tare')}"
        )
    attitudes = [_attitudes_of(recording) for recording in zeros]
    loads = [weighing.loads(pitch=pitch, roll=roll, offsets=False) for pitch, roll in attitudes]
    weight = np.zeros(len(COMPONENTS))
    weight[[COMPONENTS.index(name) for name in weighing.components]] = np.mean(
        [np.nanmean(table, axis=0) for table in loads], axis=0
    )
    return Carried(weight, GravityOnZero.of(attitudes, gravity=weighing.gravity), known=weighing.components)


def _weight(
    recording: Recording, weighing: Weighing, balance: BalanceMatrix, *, since: Sequence[Recording]
) -> tuple[Array, Array]:
    """Weight as the balance feels it at the attitude of a recording, and its standard uncertainty, shape (n, c).

    `since` are the zeros of the run, read with the weight on: it counts from there.
    """
    names = balance.components if balance.direct is None else COMPONENTS
    recording.channel("pitch")  # without which the weight is not known
    pitch, roll = _attitudes_of(recording)
    loads = weighing.loads(pitch=pitch, roll=roll, offsets=False)
    u = weighing.uncertainty(pitch=pitch, roll=roll, offsets=False, since=[_attitudes_of(zero) for zero in since])
    columns = [weighing.components.index(name) if name in weighing.components else None for name in names]
    if all(column is None for column in columns):
        raise FitError(
            f"the weighing has {', '.join(weighing.components)}, and the balance none of them but {', '.join(names)}"
        )
    left = [name for name in names if name in COMPONENTS and name not in weighing.components]
    if left:
        warn_quality(
            f"{recording.name}: the weighing knows the weight along {', '.join(weighing.components)} only; that along "
            f"{', '.join(left)} stays in the loads"
        )
    nothing = np.zeros_like(pitch)
    return (
        np.column_stack([nothing if k is None else loads[:, k] for k in columns]),
        np.column_stack([nothing if k is None else u[:, k] for k in columns]),
    )


def _attitudes_of(recording: Recording) -> Attitudes:
    """Pitch and roll of a recording, zero where it has none, shape (n,) each."""
    nothing = np.zeros(recording.samples)
    pitch, roll = (recording.channel(name).values if name in recording else nothing for name in ("pitch", "roll"))
    return Attitudes(pitch, roll)


def weigh(
    points: LoadPoints | Recording | Sequence[Recording],
    balance: BalanceMatrix | Calibration | None = None,
    *,
    zero: Zero | None = None,
    gravity: float = STANDARD_GRAVITY,
    components: Sequence[str] | None = None,
) -> Weighing:
    """Mass [kg], centre of gravity [m], offsets and tilts of what hangs on a balance, Eq. (1) of [Gorbushin2020]_.

    Parameters
    ----------
    points
        Static readings over pitch, and roll where it was recorded: recordings at rest of balance loads, or with
        `balance` of gauge outputs; or points made of them.
    balance
        The balance matrix, or its calibration, where gauge outputs are given.
    zero
        What the gauge outputs count from.
    gravity
        Local acceleration of gravity [m/s^2].
    components
        Components that are wanted; all that are there where left out.

    Raises
    ------
    FitError
        The points do not tell the mass, or the recordings are nowhere at rest.
    """
    names = None if components is None else tuple(components)
    if isinstance(points, LoadPoints):
        return fit_weight(points, gravity=gravity)
    recordings = [points] if isinstance(points, Recording) else list(points)
    if balance is not None:
        found = weighing_points(recordings, matrix_of(balance), zero=zero, gravity=gravity, names=names)
        return fit_weight(found, gravity=gravity)
    there = tuple(name for name in COMPONENTS if all(name in item for item in recordings)) if names is None else names
    if not there:
        raise FitError(f"{recordings[0].name} has no balance loads; with gauge outputs give the balance matrix too")
    return fit_weight(points_from_recordings([corrected(item) for item in recordings], there), gravity=gravity)


def matrix_of(balance: BalanceMatrix | Calibration) -> BalanceMatrix:
    """The balance matrix itself, of a calibration or as it is."""
    return balance.matrix if isinstance(balance, Calibration) else balance


def weighing_points(
    recordings: Sequence[Recording],
    balance: BalanceMatrix,
    *,
    zero: Zero | None = None,
    gravity: float = STANDARD_GRAVITY,
    names: Sequence[str] | None = None,
) -> LoadPoints:
    """Static points of the balance loads [N, N*m] of recordings at rest, for weighing.

    Curved bridges read a load by what else hangs on them, so the weight that was on the balance while its zero was
    read is put back: that of a first weighing, then that of the next, until it changes no more.

    The errors of the matrix are no noise but go with the load; the points say what they share. Where neither the run
    nor the calibration has zeros, the mean of all recordings stands for them: weighing finds the offsets anyway, and
    only curved or bidirectional bridges care where their zero is.

    Parameters
    ----------
    recordings
        Gauge outputs at several angles of pitch, and roll where it was recorded.
    balance
        The balance matrix.
    zero
        What the gauge outputs count from.
    gravity
        Local acceleration of gravity [m/s^2].
    names
        Components that are wanted; all that the balance has where left out.

    Raises
    ------
    FitError
        The balance lacks such components, or the recordings are nowhere at rest.
    """
    recordings = [corrected(recording) for recording in recordings]
    known: CarriedWeight = NotWeighed()
    if zero is not None and zero.recordings and zero.model_on is not False:
        found = _settled(recordings, zero, balance, gravity=gravity)
        if found is None:
            warn_quality(
                f"{zero.recordings[0].name} was read without what is weighed, as the offsets say: it is taken as read "
                f"with the model off; {argument('model_on')} says which"
            )
            zero = Zero(zero.recordings, model_on=False, after=zero.after)
        else:
            known = found
    felt = _loads_at_rest(recordings, balance, _zero_under(zero, balance, known, gravity=gravity))
    components = tuple(name for name in felt[0].components if name in COMPONENTS and (names is None or name in names))
    if not components:
        raise FitError(
            f"the balance has {', '.join(felt[0].components)}; weighing needs "
            f"{', '.join(names or COMPONENTS)}, for which the calibration lacks the gauges' distances"
        )
    points = points_from_recordings([item.recording for item in felt], components)
    return with_matrix_errors(points, felt)


def _zero_under(
    zero: Zero | None, balance: BalanceMatrix, known: CarriedWeight, *, gravity: float
) -> GaugeZero | None:
    carried = None
    if zero is not None and zero.recordings and zero.model_on is not False:
        carried = _carried_on_zero(zero.recordings, known, gravity=gravity, pitched=True)
    return settled_zero(zero, balance, carried)


def _loads_at_rest(recordings: Sequence[Recording], balance: BalanceMatrix, zero: GaugeZero | None) -> list[Loads]:
    zero = _stand_in(zero, recordings, balance)
    return [loads_of_outputs(recording, balance, zero=zero) for recording in recordings]


def _settled(
    recordings: Sequence[Recording], zero: Zero, balance: BalanceMatrix, *, gravity: float
) -> CarriedWeight | None:
    """What hangs on the balance, by weighing with the weight of the weighing before in the zero; nothing if it fails.

    The weight changes sensitivities by some percent of themselves, so each round leaves some percent of the error of
    the one before. None where the first weighing says that nothing hung there while the zero was read.
    """
    known: CarriedWeight = NotWeighed()
    last = np.full(len(balance.components), np.inf)
    scale = balance.output_scale
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # what is doubtful is told of the last round
        for _ in range(MOST_ROUNDS):
            counted = _zero_under(zero, balance, known, gravity=gravity)
            if counted is None or np.max(np.abs(counted.values - last) / scale) < SETTLED:
                break
            felt = _loads_at_rest(recordings, balance, counted)
            components = tuple(name for name in felt[0].components if name in COMPONENTS)
            try:
                weighing = fit_weight(
                    points_from_recordings([item.recording for item in felt], components), gravity=gravity
                )
            except (FitError, ValueError):
                return NotWeighed()
            if not np.isfinite(last).all() and zero.model_on == "auto" and _bare(weighing, zero.recordings, balance):
                return None
            known, last = weighing, counted.values
    return known


def _bare(weighing: Weighing, zeros: Sequence[Recording], balance: BalanceMatrix) -> bool:
    """Whether offsets that were found with the zero as it was read are clearly those of a zero without the weight.

    Read under the weight, a zero leaves no load at its own attitude; without it, the weight. Natural zeros tell it
    better, where there are any.
    """
    if balance.natural_zero is not None:
        return False
    attitudes = [_attitudes_of(zero) for zero in zeros]
    weight, left, u = (
        np.mean([np.nanmean(table, axis=0) for table in tables], axis=0)
        for tables in (
            [weighing.loads(pitch=pitch, roll=roll, offsets=False) for pitch, roll in attitudes],
            [weighing.loads(pitch=pitch, roll=roll) for pitch, roll in attitudes],
            [weighing.uncertainty(pitch=pitch, roll=roll) for pitch, roll in attitudes],
        )
    )
    largest = int(np.argmax(np.abs(weight) * [name in FORCES for name in weighing.components]))
    return bool(left[largest] / weight[largest] > CLEARLY and u[largest] < CLEARLY / 2 * abs(weight[largest]))
