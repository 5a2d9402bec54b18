r"""What few steps of a converter do to a force.

A reading that is rounded to steps of q errs by a function of itself. Where the noise is less than about half a step
that is no white noise of q^2 / 12: for a Gaussian signal of covariance C(t) the error has the covariance
sum over k of q^2 / (2 pi^2 k^2) exp(-(2 pi k / q)^2 (C(0) - C(t))) [Widrow2008]_, of which the part at t > 0 lies
where the force is.

References
----------
.. [Widrow2008] B. Widrow, I. Kollar, "Quantization Noise", Cambridge University Press (2008), ch. 6 and 18.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance.estimation.error_sources import Noise
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.recording.doubts import Doubt

MATTERS: Final = 1.2
"""Step over the noise of a reading from which on the error of rounding is correlated: exp(-2 pi^2 / 1.44) is 1e-6."""

TERMS: Final = 8
"""Terms of the sum over k."""

POINTS: Final = 1 << 14
"""Points of the covariance, and frequencies of the spectra."""

DOUBTED: Final = 0.25
"""Rms of the error over the rest of the uncertainty from which on it is told."""


def rounding_error(reading: Observation, learned: SpectralPrior, *, step: float) -> Noise | None:
    """What rounding to a step [N] does to the force beside white noise; None where the noise covers it.

    Parameters
    ----------
    reading
        The record.
    learned
        What was learned of it, its noise with what rounding adds to it as white noise.
    step
        Step of the readings [N].
    """
    true = float(np.sqrt(max(learned.noise**2 - step**2 / 12, 0.0)))
    if not step > MATTERS * true:
        return None
    frequency = np.linspace(0, 0.5 / reading.interval, POINTS + 1)
    gain = np.abs(reading.dynamics.response(frequency)) ** 2
    force = learned.spectrum.density(np.maximum(frequency, 1e-9))
    covariance = np.fft.irfft(gain * force) / reading.interval
    apart = np.maximum(covariance[0] - covariance, 0.0) + true**2
    numbers = np.arange(1, TERMS + 1)[:, None]
    error = np.sum(
        step**2 / (2 * np.pi**2 * numbers**2) * np.exp(-((2 * np.pi * numbers / step) ** 2) * apart), axis=0
    )
    density = np.maximum(np.fft.rfft(error).real, 0.0) * reading.interval
    noise = learned.noise**2 * reading.interval
    shrunk = gain * force / (gain * force + noise)
    seen = np.where(shrunk > 0, density * shrunk**2 / gain, 0.0)
    mean = float(np.mean(seen))
    if not mean > 0:
        return None
    deviation = np.sqrt(mean / reading.interval)
    return Noise(
        "resolution of the channel", reading.dynamics.component, np.full(reading.values.size, deviation), seen / mean
    )


def resolution_doubt(component: str, error: Noise, *, step: float, rest: float, unit: str) -> Doubt | None:
    """What few steps say against a force; None where what else is not known of it is larger.

    Parameters
    ----------
    component
        The component.
    error
        What they do to the force.
    step
        The step of its readings [N].
    rest
        Rms of the uncertainty but for that [N].
    unit
        Unit of the force.
    """
    size = float(np.sqrt(np.mean(error.deviation**2)))
    if size < DOUBTED * rest:
        return None
    return Doubt(
        "resolution",
        component,
        f"the readings of {component} have steps of {step:.3g} {unit}, and their noise is too small to blur them: "
        f"what that does to the force, about {size:.2g} {unit} rms, is added to its uncertainty",
        "set the amplifier to a larger gain, or use a converter with more bits",
        size,
        unit,
    )
