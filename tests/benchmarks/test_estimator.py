"""The estimator against the attainable bound, against the paper's differences, and against the clock."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from aerobalance.dynamics import Dynamics
from aerobalance.force import ForceEstimate, reconstruct
from aerobalance.identification.decay import identify_decay
from aerobalance.identification.extrema import extrema_fit
from aerobalance.recording import Array, Channel, Recording
from aerobalance.rigs import CableCut, Sensor, Simulation, band_noise

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


def generator() -> np.random.Generator:
    entropy = np.random.SeedSequence().entropy
    print(f"seed {entropy}")  # noqa: T201 - shown when a benchmark fails
    return np.random.default_rng(entropy)


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


@pytest.mark.parametrize("noise", [0.5, 2.0, 10.0])
@pytest.mark.parametrize("name", [*SHARP, *SOFT])
def test_smooth_load_at_the_bound(name: str, noise: float, record) -> None:
    rng = generator()
    shape = (SHARP | SOFT)[name]
    errors = []
    for _ in range(RUNS):
        run, force = smooth_run(rng, shape, dynamics=T128, rate=1600.0, rms=500.0, noise=noise, seconds=10.0)
        estimate = reconstruct(run, T128)
        assert not estimate.steps
        errors.append(estimate.values - force)
    bound = wiener_bound(shape, dynamics=T128, rate=1600.0, rms=500.0, noise=noise)
    ratio = bound / rms_of([inner(error) for error in errors])
    record(f"bound over error, T-128, {name}, noise {noise:g} N", ratio, round(1 / 1.1, 4))
    assert ratio >= 1 / 1.1
    if (name, noise) != ("0-120 Hz", 0.5):
        # there the balance's own motion at the ends is not known better by any estimate: docs/decisions/002
        whole = bound / rms_of(errors)
        record(f"the same, ends included, T-128, {name}, noise {noise:g} N", whole, round(1 / 1.4, 4))
        assert whole >= 1 / 1.4


@pytest.mark.parametrize("noise", [0.05, 0.5, 2.0])
def test_rig_at_the_bound(noise: float, record) -> None:
    rng = generator()
    setup = {"dynamics": RIG, "rate": 25_000.0, "rms": 100.0, "noise": noise}
    errors = []
    for _ in range(RUNS // 2):
        run, force = smooth_run(rng, WIDE["0-900 Hz"], seconds=4.0, **setup)
        errors.append(reconstruct(run, RIG).values - force)
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


@pytest.mark.parametrize("kind", ["sharp", "soft"])
def test_intervals_cover(kind: str, record) -> None:
    rng = generator()
    covered = []
    for shape in (SHARP if kind == "sharp" else SOFT).values():
        for noise in (0.5, 2.0, 10.0):
            for _ in range(12):
                run, force = smooth_run(rng, shape, dynamics=T128, rate=1600.0, rms=500.0, noise=noise, seconds=5.0)
                estimate = reconstruct(run, drawn(rng, noise=noise))
                covered.append(np.mean(np.abs(inner(estimate.values - force)) < 1.96 * inner(estimate.uncertainty)))
    average = float(np.mean(covered))
    record(f"least of cover over 93 % and 97 % over cover, {kind} spectra", min(average / 0.93, 0.97 / average), 1.0)
    assert 0.93 <= average <= 0.97


@pytest.mark.parametrize(("noise", "allowed"), [(2.0, 0.1), (10.0, 0.3)])
def test_plateaus_of_a_step(noise: float, allowed: float, record) -> None:
    rng = generator()
    errors, instants = [], []
    for _ in range(RUNS):
        rig = CableCut(release=1 + rng.uniform(0, 1) / 1600, sensors={"AF": Sensor(noise=noise)})
        run = rig.run(4.0, rng)
        estimate = reconstruct(run.recording, T128)
        assert len(estimate.steps) == 1
        error = estimate.values - run.applied
        errors.append(error[np.abs(run.recording.time - run.release) > 0.001])
        instants.append((estimate.steps[0].instant - run.release) * 1600)
    ratio = allowed / rms_of(errors)
    record(f"{allowed} N over the plateaus' error, step, noise {noise:g} N", ratio, 1.0)
    record(f"0.1 sample over the instant's error, step, noise {noise:g} N", 0.1 / float(np.std(instants)), 1.0)
    assert ratio >= 1
    assert np.max(np.abs(instants)) < 0.1


@pytest.mark.parametrize("noise", [2.0, 10.0])
def test_step_under_a_broadband_load(noise: float, record) -> None:
    rng = generator()
    setup = {"dynamics": T128, "rate": 1600.0, "rms": 60.0, "noise": noise}
    errors = []
    for _ in range(RUNS):
        run, force = smooth_run(rng, SHARP["0-120 Hz"], seconds=4.0, **setup)
        instant = 2 + rng.uniform(0, 1) / 1600
        load = run.channel("AF").values + 1020 * T128.step_response(run.time - instant)
        stepped = Recording.from_columns(run.time, {"AF": Channel("AF", load, "N")}, name="step and load")
        estimate = reconstruct(stepped, T128)
        assert len(estimate.steps) == 1
        error = estimate.values - force - 1020 * (run.time >= instant)
        errors.append(inner(error[np.abs(run.time - instant) > 0.001]))
    ratio = wiener_bound(SHARP["0-120 Hz"], **setup) / rms_of(errors)
    record(f"bound over error, step under 60 N rms of 0-120 Hz, noise {noise:g} N", ratio, round(1 / 1.1, 4))
    assert ratio >= 1 / 1.1


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
def test_shaken_ground_at_the_bound(mass: float, record) -> None:
    rng = generator()
    dynamics = Dynamics("AF", mass, T128.stiffness, T128.damping)
    run = shaken_run(mass, rng)
    error = inner(reconstruct(run.recording, dynamics).values - run.applied).std()
    frequency = np.linspace(0, 120, 100_001)
    gain = np.abs(dynamics.response(frequency)) ** 2
    load, noise = 500.0**2 / 120, (2.0**2 + gain * (mass * 0.05) ** 2) / 800
    bound = float(np.sqrt(np.trapezoid(load * noise / (gain * load + noise), frequency)))
    record(f"bound over error, 0-120 Hz load on a shaken ground, moving mass {mass:g} kg", bound / error, 0.9091)
    assert bound / error >= 1 / 1.1


def test_differences_of_the_paper_beside_the_smoother(record) -> None:
    rng = generator()
    run = shaken_run(178.0, rng)
    dynamics = Dynamics("AF", 178.0, T128.stiffness, T128.damping)
    errors = {
        method: inner(reconstruct(run.recording, dynamics, method=method).values - run.applied).std()
        for method in ("smoother", "paper")
    }
    record("error of central differences over error of the smoother", errors["paper"] / errors["smoother"], 5.0)
    assert errors["paper"] > 5 * errors["smoother"]


def test_waveform_beside_the_extrema(record) -> None:
    rng = generator()
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
def test_a_hundred_thousand_samples_beside_the_clock(what: str, record) -> None:
    rng = generator()
    if what == "step":
        rig = CableCut(dynamics=RIG, cable_force=-50.0, release=2.0, rate=25_000.0, sensors={"AF": Sensor(noise=0.05)})
        run = rig.run(4.0, rng).recording
    else:
        setup = {"dynamics": RIG, "rate": 25_000.0, "rms": 100.0, "noise": 0.5}
        run, _ = smooth_run(rng, WIDE["0-900 Hz"], seconds=4.0, **setup)
    reconstruct(run, RIG)  # compiles the kernels
    begin = time.process_time()
    estimate: ForceEstimate = reconstruct(run, RIG)
    spent = time.process_time() - begin
    record(f"5 s over the time for 100,000 samples at 25 kHz, {what}", 5 / spent, 1.0)
    assert spent < 5
    assert len(estimate.steps) == (what == "step")
