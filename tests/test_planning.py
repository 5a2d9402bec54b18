"""What a test can reach: closed forms, a Monte Carlo of the band-limited inverse, and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from aerobalance.app.cli import main
from aerobalance.dynamics.single import Dynamics, Mode
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.uncertainty.planning import attainable, live_lag, usual_bandwidths

T128 = Dynamics("AF", 177.87, 3.093e7, 828.21)
RATE = 1600.0


@pytest.mark.parametrize(("bandwidth", "gain"), [(800, 64), (400, 11), (200, 1.7), (132, 0.5)])
def test_noise_gain_of_the_exact_inverse(bandwidth, gain):
    """Figures of the T-128 constants, each printed to two digits."""
    found = attainable(T128, bandwidth=bandwidth, rate=RATE, noise=2.0)
    assert found.noise_gain == pytest.approx(gain, rel=0.05)
    assert found.reading == pytest.approx(2 * found.noise_gain)
    assert found.acceleration == found.parameters == 0


@pytest.mark.parametrize("share", [0.05, -0.05])
def test_parameters_of_every_mode_count(share):
    """Slopes of G by central differences are the oracle: 1e-5 of a parameter either way, so good to about 1e-8."""
    two = T128.with_modes(Mode(165.0, 0.012, share))
    relative = np.array([1e-3, 2e-3, 1e-2, 0.0, 1e-3, 2e-2, 3e-2])
    known = replace(two, covariance=np.diag((relative * two.values) ** 2))
    frequency = np.linspace(0, 120.0, 4097)
    variance = np.zeros(frequency.size)
    for place in np.flatnonzero(relative):
        more, less = two.values, two.values
        more[place] *= 1 + 1e-5
        less[place] *= 1 - 1e-5
        change = (two.with_parameters(more).response(frequency) - two.with_parameters(less).response(frequency)) / 2e-5
        variance += np.abs(relative[place] * change / two.response(frequency)) ** 2
    found = attainable(known, bandwidth=120.0, rate=RATE, noise=2.0, force=200.0)
    assert found.parameters == pytest.approx(200 * np.sqrt(np.trapezoid(variance, frequency) / 120), rel=1e-6)


def test_plan_names_every_mode(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    two = T128.with_modes(Mode(165.0, 0.012, 0.05))
    relative = np.array([1e-3, 2e-3, 1e-2, 0.0, 1e-3, 2e-2, 3e-2])
    write_dynamics("two.json", {"AF": replace(two, covariance=np.diag((relative * two.values) ** 2))})
    assert main(["plan", "--dynamics", "two.json", "--noise", "2", "--rate", "1600", "--force", "200"]) == 0
    assert "f0 = 66.368 Hz (further modes 165 Hz)" in " ".join(capsys.readouterr().out.split())


def test_weak_forces_have_the_wiener_bound():
    bandwidth, force, noise, shake = 120.0, 5.0, 2.0, 0.02
    w0, decay = T128.angular_frequency, T128.decay_rate

    def left(f: float) -> float:
        """Spectrum of the error: S R / (S |G|^2 + R) written with the noise as a force, N / (1 + N / S)."""
        w = 2 * np.pi * f
        inverse = ((w0**2 - w**2) ** 2 + (2 * decay * w) ** 2) / w0**4
        disturbed = (2 * noise**2 * inverse + 2 * (T128.mass * shake) ** 2) / RATE
        return disturbed / (1 + disturbed / (force**2 / bandwidth))

    expected = np.sqrt(quad(left, 0, bandwidth, limit=400)[0])
    found = attainable(T128, bandwidth=bandwidth, rate=RATE, noise=noise, acceleration_noise=shake, force=force)
    assert found.total == pytest.approx(expected, rel=1e-4)  # the trapezoidal rule on 4097 points
    assert found.total < force


def test_white_noise_through_the_band_limited_inverse(seed):
    count, bandwidth = 1 << 18, 100.0
    spectrum = np.fft.rfft(np.random.default_rng(seed).normal(0, 2.0, count))
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    inside = frequency <= bandwidth
    spectrum[inside] /= T128.response(frequency[inside])
    spectrum[~inside] = 0
    error = np.fft.irfft(spectrum, count)
    expected = attainable(T128, bandwidth=bandwidth, rate=RATE, noise=2.0).total
    # 2 B T = 33000 independent values, fewer where the inverse weights them: the scatter of an rms is below 1 %
    assert error.std() == pytest.approx(expected, rel=0.03)


def test_parameters_known_with_uncertainty(rng):
    u = np.array([0.2, 3000.0, 8.0, 0.0])
    known = Dynamics("AF", 177.87, 3.093e7, 828.21, covariance=np.diag(u**2))
    bandwidth, force = 90.0, 300.0
    frequency = np.linspace(0, bandwidth, 4097)
    errors = []
    for _ in range(400):
        M, k, b, _ = np.array([177.87, 3.093e7, 828.21, 0]) + u * rng.normal(size=4)
        ratio = T128.response(frequency) / Dynamics("AF", M, k, b).response(frequency)
        errors.append(force**2 / bandwidth * np.trapezoid(np.abs(ratio - 1) ** 2, frequency))
    expected = attainable(known, bandwidth=bandwidth, rate=RATE, noise=1e-6, force=force)
    # at resonance the error is linear in k to u(k)/k over twice the damping ratio, 1 %; 400 draws of a mean square
    assert np.sqrt(np.mean(errors)) == pytest.approx(expected.parameters, rel=0.2)
    assert expected.limited_by == "mass, stiffness, damping, delay"


def test_the_sensor_that_limits_is_named():
    shaken = attainable(T128, bandwidth=30, rate=RATE, noise=2.0, acceleration_noise=0.5)
    assert shaken.limited_by == "noise of the ground accelerometer"
    assert attainable(T128, bandwidth=700, rate=RATE, noise=2.0).limited_by == "noise of the balance reading"


def test_faster_sampling_averages_the_noise():
    slow, fast = (attainable(T128, bandwidth=100, rate=rate, noise=2.0).total for rate in (RATE, 4 * RATE))
    assert slow / fast == pytest.approx(2.0)


def test_bandwidths_and_lag():
    chosen = usual_bandwidths(T128, RATE)
    assert chosen[-1] == 800 and list(chosen) == sorted(chosen)
    assert live_lag(T128) == pytest.approx(5 / 66.368, rel=1e-4)


@pytest.mark.parametrize(
    "wrong",
    [{"bandwidth": 900.0}, {"bandwidth": 0.0}, {"noise": 0.0}, {"force": -1.0}, {"acceleration_noise": -1.0}],
)
def test_wrong_arguments(wrong):
    with pytest.raises(ValueError, match="must"):
        attainable(T128, **({"bandwidth": 100.0, "rate": RATE, "noise": 2.0} | wrong))


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "dynamics.json"
    values = {"mass": {"value": 177.87}, "stiffness": {"value": 3.093e7, "u": 600}, "damping": {"value": 828.21}}
    file.write_text(json.dumps({"components": {"AF": values}}))
    arguments = ["plan", "--dynamics", str(file), "--noise", "2", "--rate", "1600"]
    assert main([*arguments, "--force", "200", "--bandwidth", "120", "--json"]) == 0
    account = json.loads(capsys.readouterr().out)
    (row,) = account["attainable"]
    assert row["u"] == pytest.approx(np.sqrt(row["u_reading"] ** 2 + row["u_parameters"] ** 2))
    assert "improve" not in account and account["advice"].startswith("up to 82.96 Hz the limit is")
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "limited by" in text and "live, the force follows 75.3 ms behind" in text
    assert main([*arguments, "--bandwidth", "5000"]) == 2
    assert "half the sampling rate (800 Hz)" in capsys.readouterr().err
    assert main([*arguments, "--component", "NF"]) == 2
    assert "has no NF" in capsys.readouterr().err
