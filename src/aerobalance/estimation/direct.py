"""The force by direct inverses of Eq. (17) of [Gorbushin2020]_: central differences, and limited to a band."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.error_sources import Noise
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.result import ComponentForce
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError, argument
from aerobalance.recording.noise import white_noise

DIFFERENCE_BANDWIDTH: Final = 0.3183
"""Frequency, over the sampling rate, at which the three-point second difference is 3 dB low."""

DENSE: Final = 8193
"""Frequencies from zero to half the sampling rate at which a response is taken."""

BAND_ORDER: Final = 8
"""Order of the zero-phase Butterworth roll-off of the band-limited inverse."""


def _without_gaps(record: ComponentRecord, what: str) -> Array:
    load, name = record.load, record.dynamics.component
    missing = int(np.count_nonzero(~np.isfinite(load)))  # wild and stuck ones too
    limited = int(np.count_nonzero(record.recording.channel(name).at_limit))
    if missing or limited:
        raise FitError(
            f"{record.recording.name}: {missing} reading(s) of {name} are missing or taken for it (wild or stuck), "
            f"{limited} rest on a limit of the channel, and {what} cannot bridge them; use the smoother without a "
            f"bandwidth, or {argument('keep_outliers', True)} where none is missing"
        )
    return load


def central_differences(record: ComponentRecord) -> ComponentForce:
    """Eq. (17) of [Gorbushin2020]_ as it stands: AF' and AF'' by three-point central differences.

    The first and last sample have one neighbour only. The load is continued there by odd reflection, which makes AF''
    zero; repeating the neighbour's AF'' instead would give two samples the same amplified noise, which no later
    low-pass takes out. What this may miss is in the uncertainty of these two samples.
    """
    d, h = record.dynamics, record.interval
    load = _without_gaps(record, "central differences")
    values = _differences(load, d, interval=h) - record.motion_force
    ends = np.zeros(load.size)
    damping, inertia = d.quadratic
    ends[[0, -1]] = inertia * np.abs(np.diff(load, 2)[[0, -1]]) / h**2
    noise = record.recording.channel(d.component).noise
    noise = white_noise(load) if noise is None else noise
    slope, curve = damping / (2 * h), inertia / h**2
    gain = float(np.sqrt((1 - 2 * curve) ** 2 + (curve + slope) ** 2 + (curve - slope) ** 2))
    frequency = np.linspace(0, np.pi, DENSE)
    density = (1 - 2 * curve + 2 * curve * np.cos(frequency)) ** 2 + (2 * slope * np.sin(frequency)) ** 2

    def through(series: Array) -> Array:
        return np.column_stack([_differences(column, d, interval=h) for column in series.T])

    parts = [
        Noise("noise of the readings", d.component, np.full(load.size, gain * noise), density / gain**2),
        Noise("noise of the ground motion", record.motion_source, np.full(load.size, record.input_noise), np.ones(1)),
        Noise("ends of the record", d.component, ends, np.ones(1)),
        record.parameter_errors(lambda: values, lambda other: central_differences(other).values, through),
        *record.motion_errors(lambda items: np.column_stack([record.as_force(item) for item in items])),
        *record.reading_errors(values, through),
    ]
    bandwidth = DIFFERENCE_BANDWIDTH / h
    further = ", ".join(f"{mode.natural_frequency:.4g}" for mode in d.further_modes)
    left = f"; one mode only, {further} Hz left out" if further else ""
    return record.finish(
        values,
        parts,
        method=f"paper: Eq. (17), three-point central differences, 3 dB low at {bandwidth:.4g} Hz{left}",
        noise=noise,
        bandwidth=bandwidth,
        noise_gain=gain,
    )


def _differences(load: Array, dynamics: ModalModel, *, interval: float) -> Array:
    """Eq. (18) of [Gorbushin2020]_: (17) on a ground end at rest, with AF'' taken as zero at both ends, shape (n,)."""
    load_rate = np.gradient(load, interval)
    load_acceleration = np.concatenate(([0.0], np.diff(load, 2) / interval**2, [0.0]))
    damping, inertia = dynamics.quadratic
    return np.asarray(load + damping * load_rate + inertia * load_acceleration)


def missed(record: ComponentRecord, values: Array, force: Array, bandwidth: float | None) -> tuple[Array, float]:
    """Return what a direct inverse makes of a force beyond the force itself [N], and how long it takes [s].

    Parameters
    ----------
    record
        The component with its record.
    values
        What the inverse gave, shape (n,) [N].
    force
        The force that acts, shape (n,) [N].
    bandwidth
        That of the band-limited inverse [Hz]; None for central differences.
    """
    d, h = record.dynamics, record.interval
    if bandwidth is not None:
        error = _changed(force, h, lambda f: _band(f, bandwidth) - 1)
        # so far the roll-off reaches beyond an end, where it takes what is not known for known
        reach = min(round(2 * BAND_ORDER / (bandwidth * h)), error.size // 2)
        for end in (slice(reach), slice(-reach, None)) if reach else ():
            error[end] = values[end] - force[end]
        return error, 1 / bandwidth
    damping, inertia = d.quadratic

    def beside_one(f: Array) -> NDArray[np.complex128]:
        angle = 2 * np.pi * f * h
        inverse = 1 + 1j * damping * np.sin(angle) / h + inertia * (2 * np.cos(angle) - 2) / h**2
        return np.asarray(inverse * d.response(f) - 1)

    return _changed(force + record.motion_force, h, beside_one), 1 / d.natural_frequency


def _changed(values: Array, interval: float, transfer: Callable[[Array], NDArray[np.inexact]]) -> Array:
    """Apply a transfer function to a record that goes on as it ends, shape (n,)."""
    count = values.size
    closed = np.concatenate([values, values[::-1]])
    frequency = np.asarray(np.fft.rfftfreq(closed.size, interval), dtype=np.float64)
    return np.asarray(np.fft.irfft(np.fft.rfft(closed) * transfer(frequency), closed.size)[:count])


def _band(f: Array, bandwidth: float) -> Array:
    return np.asarray(1 / (1 + (f / bandwidth) ** (2 * BAND_ORDER)))


def band_limited(record: ComponentRecord, bandwidth: float) -> ComponentForce:
    """Eq. (17) of [Gorbushin2020]_ in the frequency domain, times a zero-phase Butterworth roll-off."""
    d, h = record.dynamics, record.interval
    if not 0 < bandwidth <= 0.5 / h:
        raise ValueError(
            f"bandwidth must lie between 0 and half the sampling rate ({0.5 / h:g} Hz), not {bandwidth:g}"
        )
    load = _without_gaps(record, "the band-limited inverse")

    def band(f: Array) -> Array:
        return _band(f, bandwidth)

    def inverse(f: Array) -> NDArray[np.complex128]:
        return np.asarray(band(f) / d.response(f))

    from_load, ends = _filtered(load, h, inverse)
    known = record.motion_force
    from_ground, ground_ends = _filtered(known, h, band) if known.any() else (known, np.zeros(known.size))
    values = from_load - from_ground
    noise = record.recording.channel(d.component).noise
    noise = white_noise(load) if noise is None else noise
    frequency = np.linspace(0, 0.5 / h, DENSE)
    gain = float(np.sqrt(np.mean(np.abs(inverse(frequency)) ** 2)))
    density, passed = np.abs(inverse(frequency)) ** 2, band(frequency) ** 2

    def through(series: Array) -> Array:
        return np.column_stack([_filtered(column, h, inverse)[0] for column in series.T])

    of_ground = np.full(load.size, record.input_noise * np.sqrt(np.mean(passed)))
    parts = [
        Noise("noise of the readings", d.component, np.full(load.size, gain * noise), density / gain**2),
        Noise("noise of the ground motion", record.motion_source, of_ground, passed / np.mean(passed)),
        Noise("ends of the record", d.component, np.hypot(ends, ground_ends), np.ones(1)),
        record.parameter_errors(lambda: values, lambda other: band_limited(other, bandwidth).values, through),
        *record.motion_errors(lambda items: np.column_stack([record.as_force(item) for item in items])),
        *record.reading_errors(values, through),
    ]
    return record.finish(
        values,
        parts,
        method=f"band-limited inverse to {bandwidth:g} Hz, zero phase, Butterworth roll-off of order {2 * BAND_ORDER}",
        noise=noise,
        bandwidth=bandwidth,
        noise_gain=gain,
    )


def _filtered(values: Array, interval: float, transfer: Callable[[Array], NDArray[np.inexact]]) -> tuple[Array, Array]:
    """Apply a transfer function to a record; also the size of what the record's unknown continuation may do to it.

    The record is continued once by odd reflection and once by holding its end; the difference between the two answers
    is the uncertainty of the ends.
    """
    reach = min(values.size - 1, max(256, values.size // 4))
    answers = []
    for mode, options in (("reflect", {"reflect_type": "odd"}), ("edge", {})):
        padded = np.pad(values, reach, mode=mode, **options)  # type: ignore[call-overload]
        size = padded.size
        frequency = np.asarray(np.fft.rfftfreq(size, interval), dtype=np.float64)
        spectrum = np.fft.rfft(padded) * transfer(frequency)
        answers.append(np.fft.irfft(spectrum, size)[reach : reach + values.size])
    first, second = answers
    return first, np.abs(first - second)
