r"""Before the test: the uncertainty that a balance, its noise and a sampling rate allow, against the bandwidth wanted.

A force that is known to stay below a bandwidth B, and to be strong against the noise there, can be had from Eq. (17)
of [Gorbushin2020]_ limited to B. White noise of the reading then gives the variance 2 h sigma^2 int_0^B 1/\|G\|^2 df
(h the sampling interval), white noise of the ground's accelerometer M^2 2 h sigma_a^2 B. Where the force is weak, the
Wiener bound int S_F R / (\|G\|^2 S_F + R) df is below that; it is what the smoother attains.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array

GRID: Final = 4097
"""Frequencies over which spectra are integrated."""

PERIODS_OF_LAG: Final = 5
"""Lag of the live estimate, in periods of the natural frequency."""

FRACTIONS: Final = (0.1, 0.2, 0.5, 0.8, 1.0, 1.25, 2.0, 4.0)
"""Bandwidths of the table, over the natural frequency."""


@dataclass(frozen=True, slots=True)
class Attainable:
    """Standard uncertainty of one sample of the force, limited to a bandwidth.

    Attributes
    ----------
    bandwidth
        Highest frequency of the force [Hz].
    reading
        From the noise of the reading [N].
    acceleration
        From the noise of the ground's accelerometer [N].
    parameters
        From mass, stiffness, damping and delay as they are known, for a force of the given size [N].
    noise_gain
        Noise of the force over noise of the reading, without regard to the force's size [1].
    """

    bandwidth: float
    reading: float
    acceleration: float
    parameters: float
    noise_gain: float

    @property
    def total(self) -> float:
        """All together [N]."""
        return float(np.sqrt(self.reading**2 + self.acceleration**2 + self.parameters**2))

    @property
    def limited_by(self) -> str:
        """The largest contribution."""
        parts = {
            "noise of the balance reading": self.reading,
            "noise of the ground accelerometer": self.acceleration,
            "mass, stiffness, damping, delay": self.parameters,
        }
        return max(parts, key=lambda name: parts[name])


def attainable(
    dynamics: Dynamics,
    *,
    bandwidth: float,
    rate: float,
    noise: float,
    acceleration_noise: float = 0.0,
    force: float | None = None,
) -> Attainable:
    """Work out the uncertainty that can be reached.

    Parameters
    ----------
    dynamics
        The balance with its model.
    bandwidth
        Highest frequency of the force [Hz]; above zero, at most half of `rate`.
    rate
        Sampling rate [Hz].
    noise
        Standard uncertainty of one reading of the load [N]; above zero.
    acceleration_noise
        Standard uncertainty of one reading of the ground's acceleration [m/s^2].
    force
        Root mean square of the force, taken as equally strong up to `bandwidth` [N]; strong against the noise, and
        without a share of the parameters, where left out.

    Raises
    ------
    ValueError
        An argument is out of range.
    """
    if not 0 < bandwidth <= rate / 2:
        raise ValueError(
            f"bandwidth must lie between 0 and half the sampling rate ({rate / 2:g} Hz), not {bandwidth:g}"
        )
    if not (0 < noise < np.inf and 0 <= acceleration_noise < np.inf):
        raise ValueError("noise must be positive, and acceleration_noise zero or more")
    if force is not None and not 0 < force < np.inf:
        raise ValueError(f"force must be positive, not {force:g}")
    frequency = np.linspace(0, bandwidth, GRID)
    response = dynamics.response(frequency)
    interval = 1 / rate
    of_reading = 2 * interval * noise**2 / np.abs(response) ** 2
    of_ground = np.full(GRID, 2 * interval * (dynamics.mass * acceleration_noise) ** 2)
    gain = float(np.sqrt(np.trapezoid(of_reading, frequency))) / noise
    shrink: Array = np.ones(GRID)
    if force is not None:
        spectrum = force**2 / bandwidth
        shrink = spectrum / (spectrum + of_reading + of_ground)
    wrong = np.zeros(GRID) if force is None else force**2 / bandwidth * _relative_variance(dynamics, frequency)
    reading, ground, parameters = (
        float(np.sqrt(np.trapezoid(part, frequency))) for part in (of_reading * shrink, of_ground * shrink, wrong)
    )
    return Attainable(bandwidth, reading, ground, parameters, gain)


def _relative_variance(dynamics: Dynamics, frequency: Array) -> Array:
    """Relative variance of the force from the parameters of the dynamics, shape (m,).

    With one mode it is that of Eq. (17) of [Gorbushin2020]_ from its coefficients.
    """
    first, *further = dynamics.modes
    response = dynamics.response(frequency)
    s = 2j * np.pi * frequency
    M, k, b = dynamics.mass, dynamics.stiffness, dynamics.damping
    # dG/dp; the first mode is 1 / (1 + s b/k + s^2 M/k), and the derivative of 1/D is -D' / D^2
    own = -first.share * first.response(frequency) ** 2
    slopes = {
        "mass": own * s**2 / k,
        "stiffness": -own * (s * b + s**2 * M) / k**2,
        "damping": own * s / k,
        # the delay is that of the load behind the ground's acceleration: it does not touch F/AF
        "delay": np.zeros_like(s),
    }
    for number, mode in enumerate(further, 2):
        f, zeta = mode.natural_frequency, mode.damping_ratio
        ratio = frequency / f
        curve = -mode.share * mode.response(frequency) ** 2
        slopes[f"natural_frequency_{number}"] = curve * 2 * (ratio**2 - 1j * zeta * ratio) / f
        slopes[f"damping_ratio_{number}"] = curve * 2j * ratio
        slopes[f"share_{number}"] = mode.response(frequency) - first.response(frequency)
    J = np.column_stack([slopes[name] for name in dynamics.parameters]) / response[:, None]
    return np.asarray(np.real(np.sum((J @ dynamics.covariance) * np.conj(J), axis=1)))


def usual_bandwidths(dynamics: Dynamics, rate: float) -> tuple[float, ...]:
    """Bandwidths around the natural frequency, up to half the sampling rate [Hz]."""
    f0 = dynamics.natural_frequency
    chosen = [fraction * f0 for fraction in FRACTIONS if fraction * f0 < rate / 2]
    return (*chosen, rate / 2)


def live_lag(dynamics: Dynamics) -> float:
    """Lag of the live estimate [s]: `PERIODS_OF_LAG` periods of the natural frequency."""
    return PERIODS_OF_LAG / dynamics.natural_frequency
