"""Zeros of the gauges: what the bridges of the unloaded balance read, and how that drifts across a run."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.bridge_outputs import gauge_outputs
from aerobalance.balance.load_formats import role_of
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.steady_means import batch_means, mean_of_records, variance_of_drift, variance_of_mean
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, is_gauge
from aerobalance.recording.errors import FitError, argument
from aerobalance.recording.gravity import GravityOnZero
from aerobalance.recording.noise import white_noise
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import on_one_delay
from aerobalance.recording.sensors import corrected

FEWEST: Final = 8
"""Readings of a zero from which on their noise can be judged."""

CLEARLY: Final = 0.5
"""Distance of a zero from the natural zeros, over that from them under the weight, below which it was read without."""

MOVED: Final = 0.05
"""Distance of a zero from the natural zeros, over the calibrated span, up to which it may be drift since then."""

REPEATS: Final = 1e-3
"""The same over half of it, up to which zeros are as good as a balance repeats and nothing is said of it."""

MOVED_IN_NOISE: Final = 100.0
"""Change of a bridge within or between zeros over the noise of a reading, from which it may be no drift."""

MOVED_IN_RANGE: Final = (2e-3, 0.02)
"""The same over the full-range output while one zero is read, and between two: bridges drift by less."""


SAY_HOW_READ: Final = (
    "a zero must say how it was read: model_on=True with the model on the balance, whose weight is then put back, "
    'model_on=False with nothing on it, or model_on="auto" to tell it by the natural zeros of the calibration'
)
"""What is missing of a zero that does not say whether the model was on the balance."""


class FromNatural(NamedTuple):
    """How far a zero lies from the natural zeros of the calibration, beyond the weight it was read under.

    Attributes
    ----------
    load
        As a load of a component [N, N*m].
    of_range
        Its size over half the calibrated range [1].
    """

    load: float
    of_range: float


@dataclass(frozen=True, slots=True, eq=False)
class GaugeZero:
    """Gauge outputs of the unloaded balance.

    Attributes
    ----------
    values, u
        Shape (c,) [mV/V].
    source
        Where they are from.
    drift
        Change from the beginning to the end of the run, shape (c,) [mV/V]; zero where no closing zero was read.
    weight, pull
        Weight that was taken out and stays in the loads, shape (6,) along NF PM SF YM RM AF [N, N*m], and the pull of
        gravity that made it; zero where none was.
    operating_point
        Loads in the balance's own components that the zero was read under beyond `weight`, shape (c,) [N, N*m]: curved
        bridges are read from there, and the loads count from there. None where none are known.
    model_on
        Whether the model hung on the balance while they were read, in which case its weight has been taken out; None
        where that has not been said, and loads cannot count from them.
    moved
        Standard deviation of the outputs within a zero where they moved by more than bridges drift, shape (c,) [mV/V];
        0 elsewhere. It is in `u`.
    differ
        Standard uncertainty of their mean by what several zeros of one load differ by, where that is more than bridges
        drift, shape (c,) [mV/V]; 0 elsewhere. It is in `u`.
    drifted
        Whether a bridge moved by more than that from the beginning to the end of the run.
    from_natural
        How far it lies from the natural zeros of the calibration, by component of the loads; without those where the
        weight is not known, and empty without natural zeros.
    in_both
        Whether loads that count from it are taken off each other, so that nothing of it is left.
    """

    values: Array
    u: Array
    source: str
    drift: Array
    weight: Array = field(default_factory=lambda: np.zeros(len(COMPONENTS)))
    pull: GravityOnZero = field(default_factory=GravityOnZero)
    operating_point: Array | None = None
    model_on: bool | None = None
    moved: Array = field(default_factory=lambda: np.zeros(1))
    differ: Array = field(default_factory=lambda: np.zeros(1))
    drifted: bool = False
    from_natural: Mapping[str, FromNatural] = field(default_factory=dict)
    in_both: bool = False

    @classmethod
    def taken_off(cls, balance: BalanceMatrix) -> GaugeZero:
        """Zeros of outputs that are already less their zero: nothing."""
        nothing = np.zeros(len(balance.components))
        return cls(nothing, nothing, "none: outputs as they are", nothing, model_on=False)

    @property
    def is_nothing(self) -> bool:
        """Whether outputs are taken as they are, and what is in them without load as load."""
        return not self.values.any() and not self.in_both


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Zero:
    """Recordings without wind that the loads of a run count from.

    Loads that count from a zero read under the model lack its weight, and dynamics with a mass take the weight off
    once more. So a zero says how it was read, and the weight is put back.

    Attributes
    ----------
    recordings
        Before the run; none where the outputs of the run are already less their zero.
    model_on
        True where the model hung on the balance meanwhile, False where nothing did. ``"auto"`` takes it so unless the
        natural zeros of the calibration speak against it.
    after
        After the run, where zeros were read again: their change is taken as steady drift.
    """

    recordings: tuple[Recording, ...]
    model_on: bool | Literal["auto"]
    after: tuple[Recording, ...]

    def __init__(
        self,
        recordings: Recording | Sequence[Recording],
        *,
        model_on: bool | Literal["auto"] | None = None,
        after: Recording | Sequence[Recording] = (),
    ) -> None:
        """Take one recording or several.

        Raises
        ------
        ValueError
            `model_on` is not said, or there are zeros after the run and none before it.
        """
        if isinstance(model_on, np.bool_):
            model_on = bool(model_on)
        if not isinstance(model_on, bool) and model_on != "auto":  # 0 and 1 only equal False and True
            raise ValueError(f"{SAY_HOW_READ}; not {model_on!r}")
        before, later = (
            tuple(corrected(item) for item in ((one,) if isinstance(one, Recording) else one))
            for one in (recordings, after)
        )
        if later and not before:
            raise ValueError(
                f"{argument('Zero.after')} needs {argument('Zero.recordings')}: the drift is what changes between "
                "the two"
            )
        for name, value in (("recordings", before), ("model_on", model_on), ("after", later)):
            object.__setattr__(self, name, value)


class CarriedWeight(Protocol):
    """What hangs on a balance and has weight: dynamics with their mass, or a weighing."""

    @property
    def components(self) -> tuple[str, ...]:
        """Components that the weight is known along."""

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight along a component at attitudes of shape (n,) [rad], shape (n,) [N, N*m]."""


def gauge_table(recording: Recording, balance: BalanceMatrix) -> tuple[Array, tuple[Channel, ...]]:
    """Gauge outputs in the order of the balance's bridges: shape (n, c) [mV/V], and their channels.

    Bridges are found by name (``r`` and the bridge's name), or by another usual name of the same thing (rAx, rAxial).
    Where they were not read at once, they are brought to the instants in their middle, `delay_of_outputs`.

    Raises
    ------
    FitError
        A bridge was not recorded.
    """
    ready = gauge_outputs(recording)
    names = [channel.name for channel in ready if is_gauge(channel.name)]
    chosen = []
    for gauge, component in zip(balance.gauges, balance.components, strict=True):
        exact = [name for name in (f"r{gauge}", f"r{component}") if name in ready]
        role = role_of(gauge) or role_of(component)
        alike = [name for name in names if role is not None and role_of(name[1:]) == role]
        found = exact[:1] or (alike if len(alike) == 1 else [])
        if not found:
            raise FitError(
                f"{recording.name} has no channel r{gauge} for the bridge {gauge} of the balance; it has "
                f"{', '.join(names) or 'no gauge outputs (names beginning with r, such as rAF)'}"
            )
        chosen.append(ready.channel(found[0]))
    table, delay = np.column_stack([channel.values for channel in chosen]), delay_of_outputs(recording)
    return on_one_delay(table, chosen, delay=delay, interval=1 / recording.rate), tuple(chosen)


def delay_of_outputs(recording: Recording) -> float:
    """Mean of the times by which the gauge outputs of a recording lag the clock [s]; 0 where it has none."""
    delays = [channel.delay for channel in recording if is_gauge(channel.name)]
    return float(np.mean(delays)) if delays else 0.0


def gauge_zero(
    recordings: Sequence[Recording],
    balance: BalanceMatrix,
    *,
    after: Sequence[Recording] = (),
    model_on: bool | None = None,
    alike: bool = True,
) -> GaugeZero:
    """Mean gauge zeros [mV/V] of recordings without wind, and their drift to those after the run.

    Parameters
    ----------
    recordings
        Before the run.
    balance
        Whose bridges.
    after
        Closing zeros, where they were read.
    model_on
        False where nothing hung on the balance. Where the model did, `without_weight` takes its weight out.
    alike
        Whether all before the run were read under one load, and all after it: then what they differ by counts as an
        error of each. Otherwise it may be the weight at several attitudes.
    """
    first = _mean_outputs(tuple(recordings), balance, alike=alike)
    source = ", ".join(recording.name for recording in recordings)
    if not after:
        nothing = np.zeros_like(first.values)
        return GaugeZero(
            first.values, first.u, source, nothing, model_on=model_on, moved=first.moved, differ=first.differ
        )
    last = _mean_outputs(tuple(after), balance, alike=alike)
    drift, noise = last.values - first.values, np.maximum(first.noise, last.noise)
    return GaugeZero(
        first.values,
        np.hypot(first.u, last.u),
        source,
        drift,
        model_on=model_on,
        moved=np.maximum(first.moved, last.moved),
        differ=np.maximum(first.differ, last.differ),
        drifted=bool(is_moved(drift, noise, MOVED_IN_RANGE[1] * balance.output_scale).any()),
    )


@lru_cache(maxsize=4)  # the same for all parts of a record
def _mean_outputs(recordings: tuple[Recording, ...], balance: BalanceMatrix, *, alike: bool) -> _MeanOutputs:
    return _MeanOutputs.of(recordings, balance, alike=alike)


def is_moved(change: Array, noise: Array, least: Array) -> NDArray[np.bool_]:
    """Return which bridges changed by more than they drift, shape (c,); arguments of that shape [mV/V].

    Parameters
    ----------
    change
        Of the outputs.
    noise
        Of a reading.
    least
        What may be drift.
    """
    return np.asarray(np.abs(change) > np.maximum(MOVED_IN_NOISE * noise, least))


def without_weight(zero: GaugeZero, balance: BalanceMatrix) -> GaugeZero:
    """Zero less what the bridges read by its weight and operating point, at the sum of both."""
    under = in_own_components(zero.weight, balance)
    if zero.operating_point is not None:
        under = under + zero.operating_point
    if not under.any():
        return replace(zero, model_on=True)
    outputs = balance.outputs(under[None, :])[0]
    source = f"{zero.source}, less the weight" if zero.weight.any() else zero.source
    return replace(zero, values=zero.values - outputs, source=source, model_on=True)


def seen_on_zero(zero: GaugeZero, balance: BalanceMatrix) -> Array:
    """Loads that a zero was read under, by its distance from the calibration's natural zeros, shape (c,) [N, N*m].

    They are in the balance's own components, and as wrong as the bridges' zeros have moved since the calibration: good
    enough to tell where on their curves bridges are, not to weigh. Nothing without natural zeros, or where the
    distance is no more than bridges move in years.
    """
    nothing = np.zeros(len(balance.components))
    if balance.natural_zero is None:
        return nothing
    seen = balance.loads((zero.values - balance.natural_zero)[None, :]).loads[0]
    size = np.ptp(np.array(balance.calibrated), axis=0)
    clear = np.isfinite(seen).all() and np.max(np.abs(seen) / size) > MOVED
    return seen if clear else nothing


def from_natural_zeros(
    zero: GaugeZero, weight: Array, known: Collection[str], balance: BalanceMatrix
) -> dict[str, FromNatural]:
    """Tell how far a zero lies from the natural zeros, beyond its weight, by component; empty where there are none.

    Parameters
    ----------
    zero
        The mean outputs, with what they were read under still in them.
    weight
        What hung on the balance along NF PM SF YM RM AF, shape (6,) [N, N*m].
    known
        Components along which that is known.
    balance
        The balance matrix.
    """
    if balance.natural_zero is None:
        return {}
    seen = balance.loads((zero.values - balance.natural_zero)[None, :]).loads[0]
    half = np.ptp(np.array(balance.calibrated), axis=0) / 2
    if balance.direct is None:
        names, on_it = balance.components, in_own_components(weight, balance)
    else:
        names, on_it = COMPONENTS, weight
        seen, half = balance.direct @ seen, np.abs(balance.direct) @ half
    left = seen - on_it
    return {
        name: FromNatural(float(load), float(abs(load) / size))
        for name, load, size in zip(names, left, half, strict=True)
        if np.isfinite(load) and size > 0 and (name in known or name not in COMPONENTS)
    }


def beyond_weight(point: Array, weight: Array, known: Collection[str], balance: BalanceMatrix) -> Array:
    """Loads at an operating point along the components whose weight is not known, shape (c,) [N, N*m].

    Parameters
    ----------
    point
        Loads on the zero in the balance's own components, shape (c,) [N, N*m].
    weight
        What is known of them along NF PM SF YM RM AF, shape (6,) [N, N*m].
    known
        Components along which that is.
    balance
        The balance matrix.
    """
    if balance.direct is None:
        return np.where([name in known for name in balance.components], 0.0, point)
    others = np.where([name in known for name in COMPONENTS], weight, balance.direct @ point)
    return np.asarray(np.linalg.solve(balance.direct, others - weight))


def change_of_sensitivity(point: Array, balance: BalanceMatrix) -> float:
    """Largest change of the matrix from no load to an operating point, shape (c,), as part of full range."""
    at = balance.sensitivity(np.stack([np.zeros_like(point), point]))
    return float(np.max(np.abs((at[1] - at[0]) * balance.output_scale / balance.load_scale[:, None])))


def reads_no_weight(zero: GaugeZero, weight: Array, balance: BalanceMatrix) -> bool:
    """Whether a zero is clearly nearer to the calibration's natural zeros than to them under a weight, shape (6,).

    Distances are over the calibrated range; without natural zeros, or without a weight, nothing is clear.
    """
    if balance.natural_zero is None or not weight.any():
        return False
    size = np.ptp(np.array(balance.calibrated), axis=0)
    seen = balance.loads((zero.values - balance.natural_zero)[None, :]).loads[0]
    return bool(
        np.linalg.norm(seen / size) < CLEARLY * np.linalg.norm((seen - in_own_components(weight, balance)) / size)
    )


def in_own_components(weight: Array, balance: BalanceMatrix) -> Array:
    """Weight along NF PM SF YM RM AF in the balance's own components, shape (c,)."""
    if balance.direct is not None:
        return np.linalg.solve(balance.direct, weight).astype(np.float64)
    return np.array([weight[COMPONENTS.index(name)] if name in COMPONENTS else 0.0 for name in balance.components])


@dataclass(frozen=True, slots=True, eq=False)
class _MeanOutputs:
    """Mean of the gauge outputs over recordings, its standard uncertainty, noise and movement, shape (c,) [mV/V].

    `differ` is what the recordings leave of the mean where they differ by more than bridges drift, and 0 elsewhere.
    """

    values: Array
    u: Array
    noise: Array
    moved: Array
    differ: Array

    @classmethod
    def of(cls, recordings: Sequence[Recording], balance: BalanceMatrix, *, alike: bool) -> _MeanOutputs:
        means, variances, noises, moves = [], [], [], []
        for recording in recordings:
            table, _ = gauge_table(recording, balance)
            known = table[np.isfinite(table).all(axis=1)]
            if known.shape[0] < 2:
                raise FitError(f"{recording.name}: no samples with all gauge outputs to take a zero from")
            noise = np.array([white_noise(column) if column.size >= FEWEST else 0.0 for column in known.T])
            batches = batch_means(known)
            moved = is_moved(np.ptp(batches, axis=0), noise, MOVED_IN_RANGE[0] * balance.output_scale)
            means.append(known.mean(axis=0))
            noises.append(noise)
            moves.append(np.where(moved, batches.std(axis=0), 0.0))
            drift = np.where(moved, 0.0, variance_of_drift(known))
            variances.append(variance_of_mean(known) + moves[-1] ** 2 + drift)
        count, noise = len(means), np.max(noises, axis=0)
        found = mean_of_records(means, variances)
        differ = is_moved(np.ptp(means, axis=0), noise, MOVED_IN_RANGE[1] * balance.output_scale)
        return cls(
            found.values,
            np.sqrt(found.variance if alike else np.sum(variances, axis=0) / count**2),
            noise,
            np.sqrt(np.sum(np.square(moves), axis=0)) / count,
            np.where(differ & alike, np.sqrt(found.between), 0.0),
        )
