"""What the live accelerometer says about a fit of the shaken balance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aerobalance.identification.base_excitation.frf_model import Problem, mode_responses, shape
from aerobalance.identification.base_excitation.maximum_likelihood import Estimate


@dataclass(frozen=True, slots=True)
class LiveCheck:
    """What the live accelerometer says about the fit: its reading over the live acceleration predicted from it.

    Attributes
    ----------
    gain, u_gain
        Gain and its standard uncertainty [1]; 1 where accelerometer, balance matrix and mass agree.
    delay, u_delay
        Time by which the live accelerometer lags the ground accelerometer, and its standard uncertainty [s].
    """

    gain: float
    u_gain: float
    delay: float
    u_delay: float


def live_check(estimate: Estimate, problem: Problem) -> LiveCheck | None:
    """Compare the live accelerometer with x2'' = x1'' + x'', AF = k x, from the ground motion and load as fitted.

    With one mode this is M x2'' = -k x - b x'.
    """
    spectra = problem.spectra
    if spectra.live is None:
        return None
    w = 2 * np.pi * spectra.frequency
    lead = np.exp(1j * w * estimate.delay)
    answer = shape(estimate.parameters, mode_responses(estimate.parameters, w))
    per_load = -(1 / answer + (w / estimate.angular_frequency) ** 2) / estimate.mass
    predicted = per_load * lead * estimate.load
    power = np.abs(predicted) ** 2
    ratio = complex(np.sum(np.conj(predicted) * spectra.live) / np.sum(power))
    delay = -float(np.sum(power * w * np.imag(np.conj(predicted) * spectra.live / np.maximum(power, 1e-300))))
    delay /= float(np.sum(power * w**2)) * ratio.real
    # One step from the phase of the ratio: a delay d turns every frequency by -w d.
    turned = predicted * np.exp(-1j * w * delay)
    gain = float(np.sum(np.real(np.conj(turned) * spectra.live)) / np.sum(power))
    noise = float(np.mean(np.abs(spectra.live - gain * turned) ** 2)) / 2
    return LiveCheck(
        gain=gain,
        u_gain=float(np.sqrt(noise / np.sum(power))),
        delay=delay,
        u_delay=float(np.sqrt(noise / np.sum(power * w**2))) / abs(gain),
    )
