"""Runs by which the estimator is judged, and the bound that none can be below."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut

T128 = CableCut().dynamics
RIG = Dynamics("AF", 0.68, 11.43e6, 371.98)
FINE = 8
RUNS = 6
Shape = Callable[[Array], Array]
SHARP: dict[str, Shape] = {
    "0-30 Hz": lambda f: np.where(f <= 30, 1.0, 0.0),
    "0-120 Hz": lambda f: np.where(f <= 120, 1.0, 0.0),
    "0-300 Hz": lambda f: np.where(f <= 300, 1.0, 0.0),
}
SOFT: dict[str, Shape] = {
    "Dryden, 10 Hz": lambda f: 1 / (1 + (f / 10) ** 2),
    "4th-order roll-off, 60 Hz": lambda f: 1 / (1 + (f / 60) ** 4),
    "Gauss, 40 Hz": lambda f: np.exp(-0.5 * (f / 40) ** 2),
}
WIDE: dict[str, Shape] = {"0-900 Hz": lambda f: np.where(f <= 900, 1.0, 0.0)}


def density(shape: Shape, frequency: Array, *, rate: float, rms: float) -> Array:
    """Two-sided density [N^2/Hz] of a load with this standard deviation [N] below FINE / 2 sampling rates."""
    whole = np.linspace(0, FINE * rate / 2, 400_001)
    power = 2 * np.trapezoid(shape(whole), whole)
    return np.where(np.abs(frequency) <= FINE * rate / 2, shape(np.abs(frequency)), 0.0) * rms**2 / power


def smooth_run(
    rng: np.random.Generator,
    shape: Shape,
    *,
    dynamics: Dynamics,
    rate: float,
    rms: float,
    noise: float,
    seconds: float,
) -> tuple[Recording, Array]:
    """Record under a stationary load, cut from one twice as long on a clock FINE times as fast; and the load."""
    n = round(seconds * rate)
    size = 2 * n * FINE
    frequency = np.fft.rfftfreq(size, 1 / (FINE * rate))
    scale = np.sqrt(density(shape, frequency, rate=rate, rms=rms) * size * FINE * rate / 2)
    phasors = scale * (rng.normal(size=scale.size) + 1j * rng.normal(size=scale.size))
    phasors[0] = 0
    force = np.fft.irfft(phasors, size)[::FINE][:n]
    load = np.fft.irfft(phasors * dynamics.response(frequency), size)[::FINE][:n]
    channel = Channel("AF", load + rng.normal(0, noise, n), "N")
    return Recording.from_columns(np.arange(n) / rate, {"AF": channel}, name="smooth load"), force


def wiener_bound(shape: Shape, *, dynamics: Dynamics, rate: float, rms: float, noise: float) -> float:
    """Least rms error of any linear estimate from samples without end, with the true spectra, folded ones included."""
    frequency = np.linspace(0, rate / 2, 100_001)
    force, across, load = np.zeros((3, frequency.size), dtype=np.complex128)
    for fold in range(-FINE // 2, FINE // 2 + 1):
        here = frequency + fold * rate
        gain = np.where(here < 0, np.conj(dynamics.response(np.abs(here))), dynamics.response(np.abs(here)))
        level = density(shape, here, rate=rate, rms=rms)
        force += level
        across += np.conj(gain) * level
        load += np.abs(gain) ** 2 * level
    left = np.real(force - np.abs(across) ** 2 / (load + noise**2 / rate))
    return float(np.sqrt(2 * np.trapezoid(left, frequency)))


def inner(values: Array) -> Array:
    cut = values.size // 20
    return values[cut:-cut]


def rms_of(parts: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def drawn(rng: np.random.Generator, *, noise: float) -> Dynamics:
    """The T-128 as identified from one release of 4 s (frequency, damping) and a weighing to 0.02 %."""
    relative = np.array([2e-4, 1.7e-6 * noise / 2, 2.2e-4 * noise / 2])  # mass, natural frequency, damping ratio
    # k = M w0^2, b = 2 zeta M w0
    slopes = np.array([[1.0, 0.0, 0.0], [1.0, 2.0, 0.0], [1.0, 1.0, 1.0]]) * relative
    true = np.array([T128.mass, T128.stiffness, T128.damping])
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = slopes @ slopes.T * np.outer(true, true)
    mass, stiffness, damping = true * (1 + slopes @ rng.normal(size=3))
    return Dynamics("AF", mass, stiffness, damping, covariance=covariance)
