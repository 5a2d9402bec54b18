"""From gauge outputs to the loads that the balance feels, Eq. (2) of [Gorbushin2020]_, with zeros and tares removed.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.bridge_temperature import at_reference_temperature
from aerobalance.balance.load_checks import (
    MOST_LOST,
    check_iteration,
    check_range,
    check_rows,
    check_size,
    doubts_of_bridges,
    doubts_of_limits,
    doubts_of_size,
    doubts_of_zero,
    stuck_outputs,
)
from aerobalance.balance.load_formats import FORM_MOMENTS, FORMS, Form, between_forms
from aerobalance.balance.load_variance import load_variances
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.matrix_errors import MatrixErrors
from aerobalance.balance.zeros import REPEATS, SAY_HOW_READ, GaugeZero, delay_of_outputs, gauge_table
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, is_gauge
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError, argument, warn_quality
from aerobalance.recording.gravity import GravityOnZero
from aerobalance.recording.linalg import whole_rows
from aerobalance.recording.noise import channel_noise, noise_correlation
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps_linearly

SPREAD: Final = 1 << 16
"""Samples, spread over a record, from which its median load is found."""


class Tare(NamedTuple):
    """Loads to take off: weight by a weighing, or those without wind.

    Attributes
    ----------
    values, u
        In the components of the loads that they are taken off, and their standard uncertainty, shape (n, c) or, where
        they are constant, (1, c) [N, N*m].
    correlation
        Of the errors of components, the mean over the samples, shape (c, c); of the same readings all have theirs.
    from_zero
        Whether they count from the zero that the loads do, so that its error is in neither.
    """

    values: Array
    u: Array
    correlation: Array
    from_zero: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Loads:
    """Balance loads, with all that is known of their errors: n samples, c components.

    Attributes
    ----------
    components
        Names: NF PM SF YM RM AF where the gauges' places are known, else those of the balance.
    units
        ``"N"`` or ``"N*m"`` of each.
    values
        Shape (n, c) [N, N*m]; NaN where an output is missing.
    noise_covariance
        Covariance of one reading from the noise of the gauges, shape (c, c) [N^2, N^2*m, N^2*m^2].
    apart
        Variance of every sample from zeros, tares, gains of the bridges and what temperature does to them
        [N^2, N^2*m^2], shape (n, c) or, the same for all, (1, c).
    of_tare
        Covariance of the components by tares, the mean over the samples, shape (c, c) [N^2, N^2*m, N^2*m^2]; runs with
        other tares do not share it.
    of_zero
        Variance of the outputs by their zeros, shape (c,) [(mV/V)^2]; where a tare counts from the same zero, only by
        how that moved meanwhile.
    native
        Loads in the balance's own components, tares not removed, shape (n, c) [N, N*m].
    beyond
        Samples outside the calibrated range, by the balance's own components.
    contraction
        Largest contraction factor of the iteration ([R091]_ converges below 1) [1].
    zero
        The gauge zeros that were taken.
    transform
        Matrix from the balance's own components to those of the result, shape (c, c) [1; m or 1/m between forces and
        moments].
    balance
        The matrix that they were worked out with.
    recording
        The run, these loads in the place of its gauge outputs: the clock, motion and attitude that go with them.
    ready
        Whether gravity is in the loads and in the recording alike, as the force needs it.
    doubts
        What their zeros say against them.
    stuck, clipped
        Readings of the bridges that repeat the one before, or rest on a limit of the channel, in the order of the
        balance's bridges, shape (n, c); None where there are none.
    """

    components: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    noise_covariance: Array
    apart: Array
    of_tare: Array
    of_zero: Array
    native: Array
    beyond: Mapping[str, int]
    contraction: float
    zero: GaugeZero
    transform: Array
    balance: BalanceMatrix
    recording: Recording
    ready: bool
    doubts: tuple[Doubt, ...] = ()
    stuck: NDArray[np.bool_] | None = None
    clipped: NDArray[np.bool_] | None = None

    def __repr__(self) -> str:
        means = zip(self.components, np.nanmean(self.values, axis=0), self.units, strict=True)
        told = ", ".join(f"{name} {mean:.6g} {unit}" for name, mean, unit in means)
        return f"balance loads of {self.name}, {self.samples} samples; means {told}"

    @property
    def noise(self) -> Array:
        """Standard uncertainty of one reading from the noise of the gauges, shape (c,) [N, N*m]."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.noise_covariance), 0.0)))

    @property
    def calibration(self) -> Array:
        """Standard uncertainty from the matrix and all that `apart` has, shape (n, c) [N, N*m]; worked out anew."""
        return np.asarray(np.sqrt(np.maximum(_from_matrix(self, self.native) + self.apart, 0.0)))

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainty of every sample, noise and calibration together, shape (n, c) [N, N*m]."""
        return np.asarray(np.hypot(self.calibration, self.noise))

    @property
    def matrix_errors(self) -> MatrixErrors:
        """Where the matrix was used: how errors of its coefficients change these loads."""
        return MatrixErrors(self.balance, self.components, self.transform, self.native)

    @property
    def name(self) -> str:
        """What the run is called in messages."""
        return self.recording.name

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.values)

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return self.recording.rate

    @property
    def start(self) -> float:
        """Time of the first sample [s]."""
        return self.recording.start

    @property
    def epoch(self) -> np.datetime64 | None:
        """Date and time at which the time is zero; None where that is not known."""
        return self.recording.epoch

    def part(self, begin: int, end: int) -> Loads:
        """The loads of the samples from one to another (not included)."""
        own = slice(begin, end)
        return replace(
            self,
            values=self.values[own],
            apart=self.apart if len(self.apart) == 1 else self.apart[own],
            native=self.native[own],
            recording=self.recording.part(begin, end),
            stuck=None if self.stuck is None else self.stuck[own],
            clipped=None if self.clipped is None else self.clipped[own],
        )

    def sparse(self, every: int) -> Loads:
        """Every so many of the samples, without their recording."""
        return replace(
            self,
            values=self.values[::every],
            apart=self.apart if len(self.apart) == 1 else self.apart[::every],
            native=self.native[::every],
            stuck=None if self.stuck is None else self.stuck[::every],
            clipped=None if self.clipped is None else self.clipped[::every],
        )

    @property
    def without_weight_of_zero(self) -> Loads:
        """The same less the weight in their zero, as a run of no known attitude is taken to have that of its zero."""
        zero = self.zero
        own = [zero.weight[COMPONENTS.index(name)] if name in COMPONENTS else 0.0 for name in self.components]
        counted = replace(zero, pull=GravityOnZero())
        return self._with(self.values - np.array(own), counted)

    @property
    def without_gravity(self) -> Loads:
        """The same with no angles in the recording: the wind-off loads that were taken off have the weight in them.

        Raises
        ------
        FitError
            A channel of the recording reads gravity as well.
        """
        for channel in self.recording:
            if channel.coupling == "dc":
                raise FitError(
                    f"{self.recording.name}: {channel.name} is dc-coupled and reads gravity, which "
                    f"{argument('tare')} has taken off too; give the zero with {argument('zero')} and leave the "
                    "weight to the dynamics"
                )
        channels = {name: one for name, one in self.recording.channels.items() if name not in ("pitch", "roll")}
        return replace(self, recording=replace(self.recording, channels=channels))

    def check_ready(self) -> None:
        """Make sure that a force can be worked out from the loads.

        Raises
        ------
        ValueError
            They lack the weight of the model, which the dynamics would take off once more.
        """
        if not self.ready:
            raise ValueError(
                f"{self.recording.name}: these loads lack the weight of the model, as it hung on the balance while "
                "their zero was read, or was taken off; the dynamics would take it off once more. Work the loads out "
                "with the dynamics as their model (model=dynamics), or give estimate_force the gauge outputs with "
                "balance and zero"
            )

    def _with(self, values: Array, zero: GaugeZero) -> Loads:
        changed = replace(self, values=values, zero=zero)
        return replace(changed, recording=_with_loads(self.recording, changed))


def loads_of_outputs(
    recording: Recording,
    balance: BalanceMatrix,
    *,
    zero: GaugeZero | None = None,
    tare: Tare | None = None,
    form: Form | None = None,
) -> Loads:
    """Balance loads [N, N*m] from gauge outputs, Eq. (2) of [Gorbushin2020]_.

    Parameters
    ----------
    recording
        With all bridges of the balance (``rAF`` ...), in mV/V, or in V with the excitation.
    balance
        The matrix.
    zero
        Gauge zeros, which say whether the model hung on the balance meanwhile; those of the calibration where left
        out.
    tare
        Loads to take off, in the components of the result: weight by `weighing`, or wind-off loads.
    form
        Form of the result; direct-read, where that is possible, if left out.

    Raises
    ------
    FitError
        A bridge was not recorded, or reads what none can; or no sample of a whole record has a load: those of a part
        of one may lie in a gap.
    ValueError
        The zero does not say whether the model hung on the balance while it was read.

    Warns
    -----
    DataQualityWarning
        Loads leave the calibrated range; the iteration nearly diverges, or found no load for some samples; zeros are
        not those of this run.
    """
    table, channels = gauge_table(recording, balance)
    read = [recording.channel(channel.name) for channel in channels]  # before they were divided by the excitation
    since_calibration = zero is None and balance.natural_zero is not None
    zero = _calibration_zero(recording, balance) if zero is None else zero
    if zero.model_on is None:
        raise ValueError(f"{zero.source}: {SAY_HOW_READ}")
    outputs, of_temperature = at_reference_temperature(
        _since_zero(table, recording, zero), recording, balance, since_calibration=since_calibration
    )
    check_size(recording, balance, outputs)
    solution = balance.loads(outputs)
    known = whole_rows(solution.loads)
    whole = bool(known.all())
    lost = 0 if whole else int(np.count_nonzero(np.isfinite(outputs).all(axis=1) & ~known))
    if not known.any() and recording.extent.is_whole:
        raise FitError(
            f"{recording.name}: no sample gives loads; {lost} of {table.shape[0]} have no solution, the rest lack a "
            "gauge output. Check units, zeros and the order of the bridges"
        )
    if lost:
        warn_quality(
            f"{recording.name}: {lost} of {table.shape[0]} samples have no loads that give their gauge outputs; they "
            "are missing in the result. The outputs lie far outside the calibration"
        )
    native = solution.loads
    found = native if whole else native[known]
    beyond = check_range(recording, balance, found)
    if not len(found):
        found = np.zeros((1, native.shape[1]))  # what there is to say of a part without loads is that of no load
    contraction = check_iteration(recording, balance, found)
    noise = np.array([_noise(channel) for channel in channels])
    check_rows(recording, balance, channels, noise)
    middle = balance.sensitivity(_median(found)[None, :])[0]
    components, moments, T = _form_of(balance, form)
    slope = T @ middle
    scatter = np.sqrt(np.maximum(np.diag(slope @ np.diag(noise**2) @ slope.T), 0.0))
    values = native @ T.T if zero.operating_point is None else (native - zero.operating_point) @ T.T
    # an error of the zero is as large in a tare that counts from it, but for how the matrix changes with the load
    of_zero = zero.drift**2 / 12 + (0.0 if tare is not None and tare.from_zero else zero.u**2)
    apart = _apart(native, of_zero, channels, slope=slope, transform=T)
    if of_temperature is not None:
        apart = apart + of_temperature @ (slope**2).T
    of_tare = np.zeros((len(components), len(components)))
    if tare is not None:
        values = values - tare.values
        apart = apart + tare.u**2
        known_u = tare.u[np.isfinite(tare.u).all(axis=1)]
        of_tare = tare.correlation * (known_u.T @ known_u) / max(len(known_u), 1)
    correlation = np.eye(len(scatter))
    if known.any():
        correlation = noise_correlation(_without_gaps(values))
    clipped = np.column_stack([one.at_limit for one in read])
    stuck = stuck_outputs(read, balance) & ~clipped
    loads = Loads(
        components=components,
        units=tuple("N*m" if moment else "N" for moment in moments),
        values=values,
        noise_covariance=np.outer(scatter, scatter) * correlation,
        apart=apart,
        of_tare=of_tare,
        of_zero=of_zero,
        native=native,
        beyond=beyond,
        contraction=contraction,
        zero=zero,
        transform=T,
        balance=balance,
        recording=recording,
        ready=tare is None and (zero.model_on is False or bool(zero.weight.any())),
        doubts=(
            *doubts_of_zero(zero, components, slope),
            *doubts_of_size(table, balance, components),
            *doubts_of_limits([one.values for one in read], stuck | clipped, balance, components),
            *doubts_of_bridges(outputs, native, balance, components, sensitivity=middle),
        ),
        stuck=_few(stuck),
        clipped=_few(clipped),
    )
    for text in dict.fromkeys(str(doubt) for doubt in loads.doubts):  # one sentence for all components
        warn_quality(f"{recording.name}: {text}")
    return replace(loads, recording=_with_loads(recording, loads))


def _since_zero(table: Array, recording: Recording, zero: GaugeZero) -> Array:
    """Gauge outputs less their zero, which may drift across the run, shape (n, c) [mV/V]."""
    counted = table - zero.values
    if zero.drift.any():
        counted -= zero.drift * np.linspace(recording.extent.begin, recording.extent.end, table.shape[0])[:, None]
    return np.asarray(counted)


def _without_gaps(values: Array) -> Array:
    """Columns with straight lines across their gaps, shape (n, c)."""
    if np.isfinite(values).all():
        return values
    return np.column_stack([interpolate_gaps_linearly(one) for one in values.T])


def _few(found: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Readings of the bridges that are none, shape (n, c), of bridges with few of them; None where there are none."""
    if not found.any():
        return None
    few = found & (found.mean(axis=0) <= MOST_LOST)
    return few if few.any() else None


def _form_of(balance: BalanceMatrix, form: Form | None) -> tuple[tuple[str, ...], Sequence[bool], Array]:
    """Names of the components of a form, which of them are moments, and the matrix from the balance's own."""
    if form is None and balance.direct is None:
        return balance.components, balance.moments.tolist(), np.eye(len(balance.components))
    chosen: Form = form or "direct"
    return FORMS[chosen], FORM_MOMENTS[chosen], between_forms(balance.components, chosen, balance.geometry)


def _calibration_zero(recording: Recording, balance: BalanceMatrix) -> GaugeZero:
    """Zeros of the calibration, for want of those of the run; or none."""
    c = len(balance.components)
    if balance.natural_zero is not None:
        known = (
            ", but for what temperature does to them," if balance.temperature and "temperature" in recording else ""
        )
        warn_quality(
            f"{recording.name}: no zero was given; the natural zeros of the calibration are taken. What the bridges' "
            f"zeros have moved since{known} goes into the loads in full"
        )
        return GaugeZero(
            balance.natural_zero, np.zeros(c), "natural zeros of the calibration", np.zeros(c), model_on=False
        )
    warn_quality(
        f"{recording.name}: no zero was given and the calibration has none; the gauge outputs are taken as they are. "
        "Whatever they read without load goes into the loads in full; give a recording of the unloaded balance as zero"
    )
    return GaugeZero.taken_off(balance)


def _noise(channel: Channel) -> float:
    """Standard uncertainty of one reading of a bridge [mV/V]."""
    if channel.noise is not None:
        return channel.noise
    known = channel.values[~channel.missing]
    return channel_noise(channel) if known.size >= 8 and float(np.ptp(known)) > 0 else 0.0


def _apart(native: Array, of_zero: Array, channels: Sequence[Channel], *, slope: Array, transform: Array) -> Array:
    """Variance of the loads from zeros and the bridges' gains, shape (n, c), or (1, c) where no gain is uncertain.

    `of_zero` is the variance of the outputs by their zeros, shape (c,) [(mV/V)^2], and `slope` how much the loads
    change with the outputs, shape (c, c) [N, N*m over mV/V].
    """
    of_zero = slope**2 @ of_zero
    gains = np.array([channel.relative_uncertainty for channel in channels])
    if not gains.any():
        return np.asarray(of_zero[None])
    return np.asarray(of_zero + (np.nan_to_num(native) * gains) ** 2 @ transform.T**2)


def _median(native: Array) -> Array:
    """Median load, shape (c,); of a long record that of samples spread over it, where the matrix is the same."""
    return np.asarray(np.median(np.ascontiguousarray(native[:: max(len(native) // SPREAD, 1)].T), axis=1))


def _from_matrix(felt: Loads, native: Array) -> Array:
    """Variance that the matrix gives to loads in the balance's own components, shape (n, c); NaN where one is."""
    found = load_variances(felt.balance, np.nan_to_num(native), transform=felt.transform)
    found[~whole_rows(felt.native)] = np.nan
    return found


def static_uncertainty(felt: Loads, *, forces: Mapping[str, Array]) -> dict[str, Array]:
    """Standard uncertainty that the calibration gives to static loads of the size of forces, by component.

    Parameters
    ----------
    felt
        Balance loads; they stand for the components that `forces` lacks.
    forces
        Forces applied, shape (n,) each [N, N*m].
    """
    columns = [forces.get(name, felt.values[:, i]) for i, name in enumerate(felt.components)]
    # what zeros and tares add does not depend on the load
    T = felt.transform
    offset = felt.native @ T.T - felt.values
    native = np.asarray(np.linalg.solve(T, (np.column_stack(columns) + np.nan_to_num(offset)).T).T)

    u = np.sqrt(np.maximum(felt.apart, 0.0) + _from_matrix(felt, native))
    return {name: u[:, i] for i, name in enumerate(felt.components)}


def _with_loads(recording: Recording, felt: Loads) -> Recording:
    """The recording, balance loads in the place of its gauge outputs."""
    gauges = {name for name in recording.channels if is_gauge(name)}
    supply = {"excitation"} & set(recording.channels)
    channels = {name: channel for name, channel in recording.channels.items() if name not in gauges | supply}
    # loads whose zero has changed are in the recording already
    delay = delay_of_outputs(recording) if gauges else recording.channel(felt.components[0]).delay
    for index, (name, unit) in enumerate(zip(felt.components, felt.units, strict=True)):
        noise = float(felt.noise[index])
        channels[name] = Channel(name, felt.values[:, index], unit, noise=noise or None, delay=delay, file_unit=unit)
    declared = recording.declared | (set(felt.components) if gauges and gauges <= recording.declared else set())
    # every bridge has a part in every load: the lowest filter of theirs is what limits it
    own = [recording.low_passed[name] for name in gauges if name in recording.low_passed]
    lowest = min(own, key=lambda one: one.corner, default=None)
    low_passed = dict.fromkeys(felt.components, lowest) if lowest is not None else recording.low_passed
    half = np.abs(felt.transform) @ (np.ptp(np.array(felt.balance.calibrated), axis=0) / 2)
    stated = any(recording.channels[name].relative_uncertainty > 0 for name in (*gauges, *supply))
    once = not felt.zero.drift.any()  # no zero was read after the run
    repeats = dict(zip(felt.components, (REPEATS * half).tolist(), strict=True)) if once else {}
    return replace(
        recording,
        channels=channels,
        low_passed=low_passed,
        gravity_on_zero=felt.zero.pull,
        from_outputs=True,
        gains_stated=recording.gains_stated or stated,
        declared=declared,
        zero_from_natural={name: one.load for name, one in felt.zero.from_natural.items() if one.of_range > REPEATS},
        zero_repeats=repeats,
    )
