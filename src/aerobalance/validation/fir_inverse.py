"""Black-box inverse of a balance: a finite impulse response fitted to the reciprocal of its measured response.

This is the route of PyDynamic's ``LSFIR``: the response at some frequencies is all that is known of the balance, and
the filter that undoes it, up to a delay, follows by linear least squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import convolve

from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.recording.noise import white_noise
from aerobalance.recording.recording import Recording

ORDER: Final = 30
"""Order of the filter: 31 coefficients, half of them before the sample that is corrected."""


@dataclass(frozen=True, slots=True)
class FirSettings:
    """Sizes and thresholds of the inverse filter.

    Attributes
    ----------
    fitted_share
        Highest frequency of the fit over the sampling rate.
    lines
        Frequencies at which a response is fitted.
    returned
        Lasting change over the largest departure, below which a record is that of an impulse and not of a step.
    trusted
        Response over its own noise, from which on a line of a measured response is used.
    """

    fitted_share: float = 0.4
    lines: int = 400
    returned: float = 0.1
    trusted: float = 3.0


SETTINGS: Final = FirSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredResponse:
    """Response of a balance at some frequencies.

    Attributes
    ----------
    frequency
        Frequencies, increasing from near zero, shape (m,) [Hz].
    values
        Balance load over force applied, shape (m,) [1].
    source
        Where it comes from, in words.
    weight
        How much each line counts in a fit of the reciprocal, shape (m,) [1]; None where all count alike.
    """

    frequency: Array
    values: NDArray[np.complex128]
    source: str
    weight: Array | None = None


def fir_inverse(response: MeasuredResponse, *, rate: float, order: int = ORDER, delay: int = ORDER // 2) -> Array:
    """Fit a filter to the reciprocal of a response, late by whole samples, by least squares.

    Parameters
    ----------
    response
        Response of the balance.
    rate
        Sampling rate [Hz].
    order
        Order of the filter.
    delay
        Samples by which its output may be late.

    Returns
    -------
    Array
        Coefficients, shape (order + 1,).
    """
    angle = 2 * np.pi * response.frequency / rate
    weight = np.ones(angle.size) if response.weight is None else response.weight
    wanted = weight * np.exp(-1j * angle * delay) / response.values
    basis = weight[:, None] * np.exp(-1j * np.outer(angle, np.arange(order + 1)))
    stacked = np.vstack([basis.real, basis.imag])
    return np.asarray(np.linalg.lstsq(stacked, np.concatenate([wanted.real, wanted.imag]), rcond=None)[0])


def undo(values: Array, coefficients: Array, *, delay: int = ORDER // 2) -> Array:
    """Apply the inverse and take its delay out; the record is continued by odd reflection.

    Parameters
    ----------
    values
        Readings, shape (n,), longer than the filter.
    coefficients
        The filter, shape (order + 1,).
    delay
        Samples by which its output is late.
    """
    order = coefficients.size - 1
    padded = np.pad(values, (order - delay, delay), mode="reflect", reflect_type="odd")
    return convolve(padded, coefficients, mode="valid")


def fit_frequencies(rate: float) -> Array:
    """Return the frequencies of the fit, shape (SETTINGS.lines,) [Hz]."""
    return SETTINGS.fitted_share * rate * np.arange(1, SETTINGS.lines + 1) / SETTINGS.lines


def response_of_record(
    recording: Recording, component: str, *, natural_frequency: float, rate: float
) -> MeasuredResponse:
    """Response of the balance from a record of one step or one impulse, scaled so that it is 1 at rest.

    The instant of the event is not recorded: it is where the response up to a fifth of the natural frequency has no
    phase. Lines count by what the record's noise leaves of their reciprocal. Beyond the last frequency at which the
    record stands out of its noise the response is taken to fall as 1/f^2.

    Parameters
    ----------
    recording
        Balance load before, during and after one sudden change, until the ringing has died out.
    component
        Which component.
    natural_frequency
        About where the balance resonates [Hz].
    rate
        Sampling rate of the record to be corrected [Hz].

    Raises
    ------
    FitError
        The record shows no step or impulse, has gaps, or is sampled too slowly.
    """
    load = recording.channel(component).values
    if not np.isfinite(load).all():
        raise FitError(f"{recording.name}: readings of {component} are missing; a response needs a whole record")
    frequency = fit_frequencies(rate)
    if frequency[-1] > recording.rate / 2:
        raise FitError(
            f"{recording.name} is sampled at {recording.rate:g} Hz; a response up to {frequency[-1]:g} Hz needs twice "
            "that"
        )
    pulse, noise, kind = _impulse(recording.name, load)
    angle = 2 * np.pi * frequency / recording.rate
    spectrum = np.exp(-1j * np.outer(angle, np.arange(pulse.size))) @ pulse
    floor = np.full(frequency.size, noise)
    if kind == "step":  # the difference over one sample is a mean of the impulse response over that sample
        spectrum = spectrum / np.sinc(frequency / recording.rate)
        floor = noise * 2 * np.sin(angle / 2)
    spectrum = _without_delay(spectrum, frequency, reach=natural_frequency / 5)
    hidden = np.flatnonzero((np.abs(spectrum) < SETTINGS.trusted * floor) & (frequency > 1.5 * natural_frequency))
    last = int(hidden[0]) - 1 if hidden.size else frequency.size - 1
    tail = spectrum[last] * (frequency[last] / frequency[last:]) ** 2
    values = np.concatenate([[1.0], spectrum[:last], tail])  # at rest the balance is calibrated
    weight = np.minimum(np.abs(values[1:]) ** 2 / np.maximum(floor, 1e-6), 1e6)
    return MeasuredResponse(
        np.concatenate([[0.0], frequency]),
        values,
        f"{kind} response in {recording.name}, to {frequency[last]:.4g} Hz",
        np.concatenate([[10 * weight.max()], weight]),
    )


def _impulse(name: str, load: Array) -> tuple[Array, float, str]:
    """Impulse response with unit sum, noise of its spectrum per root of white readings, and kind of the event."""
    count = max(load.size // 20, 4)
    before, after = float(np.mean(load[:count])), float(np.mean(load[-count:]))
    departure = load - before
    largest, sigma = float(np.max(np.abs(departure))), white_noise(load)
    if largest < 10 * sigma or largest == 0:
        raise FitError(
            f"{name}: no step or impulse stands out (largest departure {largest:.3g}, noise {sigma:.3g}); "
            "the record must begin at rest, before the event"
        )
    kind = "step" if abs(after - before) > SETTINGS.returned * largest else "impulse"
    first, last = _event(departure if kind == "impulse" else load - after, load - before, sigma)
    part = departure[first:last]
    if kind == "step":
        part = np.concatenate([part, [after - before]])
        return np.diff(part) / (after - before), sigma * float(np.sqrt(part.size)) / abs(after - before), kind
    area = float(np.sum(part))
    return part / area, sigma * float(np.sqrt(part.size)) / abs(area), kind


def _event(ringing: Array, departure: Array, sigma: float) -> tuple[int, int]:
    """Samples between which the record departs from rest: noise before and after would only spoil the spectrum."""
    begin = int(np.flatnonzero(np.abs(departure) > max(5 * sigma, 0.02 * np.max(np.abs(departure))))[0])
    end = int(np.flatnonzero(np.abs(ringing) > max(4 * sigma, 1e-4 * np.max(np.abs(ringing))))[-1])
    return max(begin - 8, 0), min(end + 8, ringing.size)


def _without_delay(spectrum: NDArray[np.complex128], frequency: Array, *, reach: float) -> NDArray[np.complex128]:
    """Take out the delay that the slow part of a response shows."""
    slow = frequency <= max(reach, frequency[min(7, frequency.size - 1)])
    coarse = np.angle(np.sum(spectrum[slow][1:] * np.conj(spectrum[slow][:-1])))
    lag = -coarse / (2 * np.pi * (frequency[1] - frequency[0]))
    for _ in range(3):  # what is left after the coarse step is a small phase, so no unwrapping is needed
        rest = np.angle(spectrum[slow] * np.exp(2j * np.pi * frequency[slow] * lag))
        lag -= float(frequency[slow] @ rest) / (2 * np.pi * float(frequency[slow] @ frequency[slow]))
    return np.asarray(spectrum * np.exp(2j * np.pi * frequency * lag))
