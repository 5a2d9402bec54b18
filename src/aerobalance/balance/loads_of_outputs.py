"""Balance loads from gauge outputs, Eq. (2) of [Gorbushin2020]_, with zeros and tares removed.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.bridge_temperature import at_reference_temperature
from aerobalance.balance.load_checks import (
    MOST_LOST,
    check_iteration,
    check_range,
    check_rows,
    check_size,
    doubt_texts,
    doubts_of_bridges,
    doubts_of_limits,
    doubts_of_size,
    lost_texts,
    stuck_outputs,
)
from aerobalance.balance.load_formats import FORM_MOMENTS, FORMS, Form, between_forms
from aerobalance.balance.loads import Loads, Tare, with_loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.zero_checks import doubts_of_no_zero, doubts_of_zero
from aerobalance.balance.zeros import SAY_HOW_READ, GaugeZero, gauge_table
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.linalg import whole_rows
from aerobalance.recording.noise import channel_noise, noise_correlation
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps_linearly
from aerobalance.recording.spread_samples import spread_samples

SPREAD: Final = 1 << 12
"""Samples, spread over a record, from which its median load is found."""


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
    for text in lost_texts(recording.name, lost, samples=len(table)):
        warn_quality(text)
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
            *doubts_of_no_zero(zero, table, balance, components, T),
            *doubts_of_size(table, balance, components),
            *doubts_of_limits([one.values for one in read], stuck | clipped, balance, components),
            *doubts_of_bridges(outputs, native, balance, components, sensitivity=middle),
        ),
        stuck=_few(stuck),
        clipped=_few(clipped),
    )
    for text in doubt_texts(recording.name, loads.doubts):
        warn_quality(text)
    return replace(loads, recording=with_loads(recording, loads))


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
    return np.asarray(np.median(np.ascontiguousarray(native[spread_samples(len(native), SPREAD)].T), axis=1))
