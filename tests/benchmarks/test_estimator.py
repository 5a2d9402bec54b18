"""The estimator against the attainable bound, against the paper's differences, and against the clock."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import czt, fftconvolve

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.result import ComponentForce
from aerobalance.identification.free_decay.fit import identify_decay
from aerobalance.identification.free_decay.log_decrement import extrema_fit
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut, Sensor, Simulation, band_noise

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
EDGES = {"0-30 Hz": 30.0, "0-120 Hz": 120.0, "0-300 Hz": 300.0}
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


def gaussian_process(readings: Array, *, edge: float, rms: float, noise: float) -> Array:
    """Force on the T-128 at 1600 Hz under a load of flat spectrum up to `edge` [Hz]: the exact finite-record answer.

    The true covariances, sums over 400,000 frequencies by the chirp transform, and Levinson's solution.
    """
    n, fine = readings.size, 400_000
    step = edge / fine
    gain = T128.response((np.arange(fine) + 0.5) * step)
    lag = np.arange(n) / 1600.0

    def covariance(transfer: Array) -> Array:
        turned = czt(transfer * rms**2 / fine, m=n, w=np.exp(2j * np.pi * step / 1600.0))
        return turned * np.exp(1j * np.pi * step * lag)

    of_load = covariance(np.abs(gain) ** 2).real
    of_load[0] += noise**2
    ahead, behind = covariance(np.conj(gain)).real, covariance(gain).real  # force later than the load, and earlier
    weights = solve_toeplitz(of_load, readings)
    return fftconvolve(np.concatenate([behind[:0:-1], ahead]), weights)[n - 1 : 2 * n - 1]


def inner(values: Array) -> Array:
    cut = values.size // 20
    return values[cut:-cut]


def rms_of(parts: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


@pytest.mark.parametrize("noise", [0.5, 2.0, 10.0])
@pytest.mark.parametrize("name", [*SHARP, *SOFT])
def test_smooth_load_at_the_bound(name: str, noise: float, record, rng) -> None:
    shape = (SHARP | SOFT)[name]
    errors, least = [], []
    for _ in range(RUNS):
        run, force = smooth_run(rng, shape, dynamics=T128, rate=1600.0, rms=500.0, noise=noise, seconds=10.0)
        estimate = estimate_force(run, T128).only
        assert not estimate.steps
        errors.append(estimate.values - force)
        if name in SHARP:
            exact = gaussian_process(run.channel("AF").values, edge=EDGES[name], rms=500.0, noise=noise)
            least.append(exact - force)
    bound = wiener_bound(shape, dynamics=T128, rate=1600.0, rms=500.0, noise=noise)
    ratio = bound / rms_of([inner(error) for error in errors])
    record(f"bound over error, T-128, {name}, noise {noise:g} N", ratio, round(1 / 1.1, 4))
    assert ratio >= 1 / 1.1
    whole = bound / rms_of(errors)
    record(f"the same, ends included, T-128, {name}, noise {noise:g} N", whole, round(1 / 1.4, 4))
    if name in SHARP:
        beside = rms_of(least) / rms_of(errors)
        record(f"error of the exact solution over error, ends included, {name}, {noise:g} N", beside, 0.9091)
        assert beside >= 1 / 1.1
    if name != "0-120 Hz" or noise > 2:
        # there the balance's own motion at the ends of a single record is not known better by any estimate, the exact
        # one with the true spectrum included, and six records scatter about 1.3 of the bound: docs/decisions/002
        assert whole >= 1 / 1.4


@pytest.mark.parametrize("noise", [0.05, 0.5, 2.0])
def test_rig_at_the_bound(noise: float, record, rng) -> None:
    setup = {"dynamics": RIG, "rate": 25_000.0, "rms": 100.0, "noise": noise}
    errors = []
    for _ in range(RUNS // 2):
        run, force = smooth_run(rng, WIDE["0-900 Hz"], seconds=4.0, **setup)
        errors.append(estimate_force(run, RIG).only.values - force)
    bound = wiener_bound(WIDE["0-900 Hz"], **setup)
    for what, parts, most in (("", [inner(error) for error in errors], 1.1), (", ends included", errors, 1.4)):
        ratio = bound / rms_of(parts)
        record(f"bound over error, rig at 25 kHz, 0-900 Hz, noise {noise:g} N{what}", ratio, round(1 / most, 4))
        assert ratio >= 1 / most


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


def shaken_run(mass: float, rng: np.random.Generator) -> Simulation:
    """T-128 under a load of 500 N rms to 120 Hz, on a ground end that shakes and pitches."""
    rig = CableCut(
        dynamics=Dynamics("AF", mass, T128.stiffness, T128.damping),
        cable_force=0.0,
        applied=band_noise(rng, low=0.0, high=120.0, rms=500.0, period=20.0),
        ground_acceleration=band_noise(rng, low=3.0, high=60.0, rms=1.0, period=20.0),
        pitch=lambda t: np.deg2rad(3.0) * np.sin(2 * np.pi * 0.3 * t),
        sensors={"AF": Sensor(noise=2.0), "ground_acceleration": Sensor(noise=0.05), "pitch": Sensor()},
    )
    return rig.run(10.0, rng)


@pytest.mark.parametrize("mass", [89.0, 178.0, 267.0])
def test_shaken_ground_at_the_bound(mass: float, record, rng) -> None:
    dynamics = Dynamics("AF", mass, T128.stiffness, T128.damping)
    run = shaken_run(mass, rng)
    error = inner(estimate_force(run.recording, dynamics).only.values - run.applied).std()
    frequency = np.linspace(0, 120, 100_001)
    gain = np.abs(dynamics.response(frequency)) ** 2
    load, noise = 500.0**2 / 120, (2.0**2 + gain * (mass * 0.05) ** 2) / 800
    bound = float(np.sqrt(np.trapezoid(load * noise / (gain * load + noise), frequency)))
    record(f"bound over error, 0-120 Hz load on a shaken ground, moving mass {mass:g} kg", bound / error, 0.9091)
    assert bound / error >= 1 / 1.1


def test_differences_of_the_paper_beside_the_smoother(record, rng) -> None:
    run = shaken_run(178.0, rng)
    dynamics = Dynamics("AF", 178.0, T128.stiffness, T128.damping)
    errors = {
        method: inner(estimate_force(run.recording, dynamics, method=method).only.values - run.applied).std()
        for method in ("smoother", "paper")
    }
    record("error of central differences over error of the smoother", errors["paper"] / errors["smoother"], 5.0)
    assert errors["paper"] > 5 * errors["smoother"]


def test_waveform_beside_the_extrema(record, rng) -> None:
    waveform, extrema = [], []
    for _ in range(12):
        rig = CableCut(sensors={"AF": Sensor(noise=10.0)})
        recording = rig.run(4.0, rng).recording
        fit = identify_decay(recording, mass=rig.dynamics.mass)
        waveform.append(fit.dynamics.damping / rig.dynamics.damping - 1)
        extrema.append(extrema_fit(recording, fit).damping / rig.dynamics.damping - 1)
    ratio = float(np.sqrt(np.mean(np.square(extrema)) / np.mean(np.square(waveform))))
    record("error of the damping, extrema (7) over waveform fit", ratio, 3.0)
    assert ratio > 3


@pytest.mark.parametrize("what", ["step", "broadband load"])
def test_a_hundred_thousand_samples_beside_the_clock(what: str, record, rng) -> None:
    if what == "step":
        rig = CableCut(dynamics=RIG, cable_force=-50.0, release=2.0, rate=25_000.0, sensors={"AF": Sensor(noise=0.05)})
        run = rig.run(4.0, rng).recording
    else:
        setup = {"dynamics": RIG, "rate": 25_000.0, "rms": 100.0, "noise": 0.5}
        run, _ = smooth_run(rng, WIDE["0-900 Hz"], seconds=4.0, **setup)
    estimate_force(run, RIG)  # compiles the kernels
    begin = time.process_time()
    estimate: ComponentForce = estimate_force(run, RIG).only
    spent = time.process_time() - begin
    record(f"5 s over the time for 100,000 samples at 25 kHz, {what}", 5 / spent, 1.0)
    assert spent < 5
    assert len(estimate.steps) == (what == "step")
