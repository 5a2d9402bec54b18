"""Weighing from recordings of gauge outputs: balance loads at rest, the weight on their zero found along the way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from aerobalance.balance.calibration.fit import Calibration, matrix_of
from aerobalance.balance.loads import Loads
from aerobalance.balance.loads_of_outputs import loads_of_outputs
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.weighing import (
    LoadPoints,
    Weighing,
    against_scales,
    fit_weight,
    points_from_recordings,
    with_matrix_errors,
)
from aerobalance.balance.weight_on_zero import (
    FORCES,
    NotWeighed,
    attitudes_of,
    settled_zero,
    weight_on_zero,
    zero_or_mean,
)
from aerobalance.balance.zeros import CLEARLY, CarriedWeight, GaugeZero, Zero
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.errors import FitError, argument, kept_warnings, one_or_more, warn_quality
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected

SETTLED: Final = 1e-9
"""Change of a zero from round to round, over the outputs at full load, at which the weight in it is settled."""

MOST_ROUNDS: Final = 20
"""Rounds of weighing after which what is left is taken as it is: a round leaves some percent of the last change."""


@one_blas_thread()
def weigh(
    points: LoadPoints | Recording | Sequence[Recording],
    balance: BalanceMatrix | Calibration | None = None,
    *,
    zero: Zero | None = None,
    gravity: float = STANDARD_GRAVITY,
    components: Sequence[str] | None = None,
    scales: float | None = None,
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
    scales
        Mass of the same on scales [kg], which the result is held against: forces in another unit, or of another gain,
        show in nothing else.

    Raises
    ------
    FitError
        The points do not tell the mass, or the recordings are nowhere at rest.
    """
    found = _weighed(points, balance, zero=zero, gravity=gravity, components=components)
    return found if scales is None else against_scales(found, scales)


def _weighed(
    points: LoadPoints | Recording | Sequence[Recording],
    balance: BalanceMatrix | Calibration | None,
    *,
    zero: Zero | None,
    gravity: float,
    components: Sequence[str] | None,
) -> Weighing:
    """As `weigh`, held against nothing."""
    names = None if components is None else tuple(components)
    if isinstance(points, LoadPoints):
        return fit_weight(points, gravity=gravity)
    recordings: list[Recording] = one_or_more(points)
    if balance is not None:
        found = weighing_points(recordings, matrix_of(balance), zero=zero, gravity=gravity, names=names)
        return fit_weight(found, gravity=gravity)
    there = tuple(name for name in COMPONENTS if all(name in item for item in recordings)) if names is None else names
    if not there:
        raise FitError(f"{recordings[0].name} has no balance loads; with gauge outputs give the balance matrix too")
    return fit_weight(points_from_recordings([corrected(item) for item in recordings], there), gravity=gravity)


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
        carried = weight_on_zero(zero.recordings, known, gravity=gravity, pitched=True)
    return settled_zero(zero, balance, carried)


def _loads_at_rest(recordings: Sequence[Recording], balance: BalanceMatrix, zero: GaugeZero | None) -> list[Loads]:
    zero = zero_or_mean(zero, recordings, balance)
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
    with kept_warnings():  # what is doubtful is told of the last round
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
    attitudes = [attitudes_of(zero) for zero in zeros]
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
