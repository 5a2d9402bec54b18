"""The estimator against the attainable bound, against the paper's differences, and against the clock."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import czt, fftconvolve

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.result import ComponentForce
from aerobalance.identification.free_decay.fit import identify_decay
from aerobalance.identification.free_decay.log_decrement import extrema_fit
from aerobalance.recording.channel import Array
from aerobalance.simulation import CableCut, Sensor, Simulation, band_noise
from helpers.accuracy import (
    RIG,
    RUNS,
    SHARP,
    SOFT,
    T128,
    WIDE,
    inner,
    rms_of,
    smooth_run,
    wiener_bound,
)

EDGES = {"0-30 Hz": 30.0, "0-120 Hz": 120.0, "0-300 Hz": 300.0}


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
    # the balance's own motion at the ends of a single record is not known better by any estimate, the exact one with
    # the true spectrum included, and six records scatter about 1.3 of the bound: docs/decisions/002
    best = bound / rms_of(least) / 1.1 if least else 1.0
    record(f"the same, ends included, T-128, {name}, noise {noise:g} N", whole, round(min(1 / 1.4, best), 4))
    assert whole >= min(1 / 1.4, best)
    if name in SHARP:
        beside = rms_of(least) / rms_of(errors)
        record(f"error of the exact solution over error, ends included, {name}, {noise:g} N", beside, 0.9091)
        assert beside >= 1 / 1.1


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


@pytest.mark.alone
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
