"""From the gauge outputs of a run to balance loads that are ready for the dynamics: zeros, weight and tares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property

import numpy as np

from aerobalance.balance.calibration.fit import Calibration, matrix_of
from aerobalance.balance.load_formats import Form
from aerobalance.balance.loads import Loads, Tare
from aerobalance.balance.loads_of_outputs import loads_of_outputs
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.weighing import Weighing
from aerobalance.balance.weight_on_zero import WeightOnZero, attitudes_of, settled_zero, weight_on_zero, zero_or_mean
from aerobalance.balance.wind_off import wind_off_loads
from aerobalance.balance.zeros import CarriedWeight, GaugeZero, Zero, gauge_table
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.errors import FitError, argument, kept_warnings, warn_quality
from aerobalance.recording.gravity import GravityOnZero
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected


@one_blas_thread()
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
        The recordings do not go together; or the run is its own zero or only tare.
    """
    return OutputReduction(balance, zero=zero, model=model, tare=tare, gravity=gravity, form=form).loads(recording)


def reduction_of(
    balance: BalanceMatrix | Calibration | None,
    *,
    zero: Zero | None = None,
    model: CarriedWeight | None = None,
    tare: Sequence[Recording] | Weighing = (),
    gravity: float = STANDARD_GRAVITY,
) -> Callable[[Recording | Loads], Recording | Loads]:
    """What makes balance loads [N, N*m] of gauge outputs as `reduce_outputs`, and leaves loads as they are.

    Without a balance matrix recordings are left as they are as well.
    """
    if balance is None:
        return lambda given: given
    reduction = OutputReduction(balance, zero=zero, model=model, tare=tare, gravity=gravity)
    return lambda given: given if isinstance(given, Loads) else reduction.loads(given)


@dataclass(frozen=True, eq=False)
class OutputReduction:
    """How gauge outputs of one run, or of its parts one after the other, become balance loads: as `reduce_outputs`.

    What hangs on the zero and the balance alone is worked out once for all parts.
    """

    balance: BalanceMatrix | Calibration
    _: KW_ONLY
    zero: Zero | None = None
    model: CarriedWeight | None = None
    tare: Sequence[Recording] | Weighing = ()
    gravity: float = STANDARD_GRAVITY
    form: Form | None = None
    # zeros of runs without and with a pitch, and what is warned of with them
    _settled: dict[bool, tuple[GaugeZero | None, list[str]]] = field(init=False, default_factory=dict)

    @cached_property
    def matrix(self) -> BalanceMatrix:
        """The balance matrix."""
        return matrix_of(self.balance)

    @one_blas_thread()
    def loads(self, recording: Recording) -> Loads:
        """Balance loads [N, N*m] of gauge outputs; exceptions as `reduce_outputs`."""
        recording, balance, tare, model = corrected(recording), self.matrix, self.tare, self.model
        _check_at_rest(recording, self.zero, tare, balance)
        if isinstance(tare, Weighing) and model is not None:
            raise ValueError(
                f"the weight comes from the mass in the dynamics; a weighing as {argument('tare')} would take it off "
                "twice"
            )
        if balance.direct is None and not set(balance.components) <= set(COMPONENTS):
            warn_quality(
                "the balance matrix lacks the distances of the gauges: the loads stay "
                f"{', '.join(balance.components)}. Calibrate with {argument('Schedule.geometry')} to have NF PM SF YM "
                "RM AF"
            )
        if isinstance(tare, Weighing):
            return _weight_off(recording, balance, tare, zero=self.zero, form=self.form)
        counted = self._zero(pitched="pitch" in recording)
        if tare:  # an error of the zero is in them as well, and in their difference none
            counted = zero_or_mean(counted, tare, balance)
            counted = None if counted is None else replace(counted, from_natural={}, in_both=True)
            off = wind_off_loads(recording, tare, balance, zero=counted, form=self.form)
            loads = loads_of_outputs(recording, balance, zero=counted, tare=off, form=self.form)
            return loads if model is None else replace(loads.without_gravity, ready=True)
        loads = loads_of_outputs(recording, balance, zero=counted, form=self.form)
        attitude = "pitch" in recording or any(channel.coupling == "dc" for channel in recording)
        if model is None:
            return loads
        return replace(loads if attitude else loads.without_weight_of_zero, ready=True)

    def _zero(self, *, pitched: bool) -> GaugeZero | None:
        """Zero of a run whose pitch was recorded or not; what there is to say of it is said of every part."""
        if pitched not in self._settled:
            with kept_warnings() as said:
                carried = None
                if self.model is not None and not self.tare and self.zero is not None:
                    carried = weight_on_zero(self.zero.recordings, self.model, gravity=self.gravity, pitched=pitched)
                self._settled[pitched] = settled_zero(self.zero, self.matrix, carried), said
        zero, said = self._settled[pitched]
        for text in said:
            warn_quality(text)
        return zero


def _check_at_rest(
    recording: Recording, zero: Zero | None, tare: Sequence[Recording] | Weighing, balance: BalanceMatrix
) -> None:
    """Refuse a run as its own zero or only tare, by whatever name; as one of several tares it is told."""
    zeros = {} if zero is None else {"zero": zero.recordings, "zero after the run": zero.after}
    given = {**zeros, "tare": () if isinstance(tare, Weighing) else tare}
    for what, others in given.items():
        for other in others:
            if not _is_part_of(recording, other, balance):
                continue
            if what == "tare" and len(others) > 1:
                warn_quality(
                    f"{other.name} has the readings of the run {recording.name} itself and is one of its tares: what "
                    "is left tells how the tares go together, and is no load of a run with wind"
                )
            else:
                raise FitError(
                    f"{other.name} has the readings of the run {recording.name} itself: it is no {what}, and would "
                    "take all steady load away; give a record of the balance without wind"
                )


def _is_part_of(recording: Recording, other: Recording, balance: BalanceMatrix) -> bool:
    """Whether the gauge outputs of a run, or of a part of one, are those of another recording at their place."""
    own, _ = gauge_table(recording, balance)
    theirs, _ = gauge_table(other, balance)
    first = round(recording.extent.begin * (len(theirs) - 1))
    there = theirs[first : first + len(own)]
    if own.shape != there.shape or not np.array_equal(own, there, equal_nan=True):
        return False
    present = own[np.isfinite(own).all(axis=1)]
    return present.size > 0 and float(np.ptp(present, axis=0).max()) > 0  # what never changes is like all of its kind


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


def _weighed_on_zero(zeros: Sequence[Recording], weighing: Weighing) -> WeightOnZero:
    """Weight of a weighing at the attitudes of its zeros, their mean."""
    lacking = [recording.name for recording in zeros if "pitch" not in recording]
    if lacking:
        raise FitError(
            f"{lacking[0]} has no channel pitch, so the weight in its zero is not known; record pitch with the zero, "
            f"say {argument('model_on', False)} if it was read without the model, or take wind-off recordings as "
            f"{argument('tare')}"
        )
    attitudes = [attitudes_of(recording) for recording in zeros]
    loads = [weighing.loads(pitch=pitch, roll=roll, offsets=False) for pitch, roll in attitudes]
    weight = np.zeros(len(COMPONENTS))
    weight[[COMPONENTS.index(name) for name in weighing.components]] = np.mean(
        [np.nanmean(table, axis=0) for table in loads], axis=0
    )
    return WeightOnZero(weight, GravityOnZero.of(attitudes, gravity=weighing.gravity), known=weighing.components)


def _weight(recording: Recording, weighing: Weighing, balance: BalanceMatrix, *, since: Sequence[Recording]) -> Tare:
    """Weight as the balance feels it at the attitude of a recording, shape (n, c).

    `since` are the zeros of the run, read with the weight on: it counts from there.
    """
    names = balance.components if balance.direct is None else COMPONENTS
    recording.channel("pitch")  # without which the weight is not known
    pitch, roll = attitudes_of(recording)
    loads = weighing.loads(pitch=pitch, roll=roll, offsets=False)
    zeros = [attitudes_of(zero) for zero in since]
    u = weighing.uncertainty(pitch=pitch, roll=roll, offsets=False, since=zeros)
    between = weighing.correlation(pitch=pitch, roll=roll, offsets=False, since=zeros)
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
    nothing, correlation = np.zeros_like(pitch), np.eye(len(columns))
    weighed = [(place, k) for place, k in enumerate(columns) if k is not None]
    for row, one in weighed:
        for column, other in weighed:
            correlation[row, column] = between[one, other]
    return Tare(
        np.column_stack([nothing if k is None else loads[:, k] for k in columns]),
        np.column_stack([nothing if k is None else u[:, k] for k in columns]),
        correlation,
    )
