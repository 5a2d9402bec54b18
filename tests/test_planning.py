"""What a test can reach: closed forms, Wiener bounds worked out apart, a Monte Carlo, and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from aerobalance.app.cli import main
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.live.live_force import LiveForce
from aerobalance.estimation.live.settings import LiveSettings
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.channel import Array
from aerobalance.simulation.six_balance import random_balance
from aerobalance.uncertainty.planning import plan
from helpers.cable_cut import T128
from helpers.coupled_pair import NOISE, SIZE, pair

RATE = 1600.0
NAMES = ("NF", "PM")
READINGS = dict(zip(NAMES, NOISE.tolist(), strict=True))
FORCES = dict(zip(NAMES, (0.01 * SIZE).tolist(), strict=True))
INTEGRATION = 1e-7
"""What the rule of integration may leave, with some margin: it is measured at 4e-12 against four times its parts."""


def uncertain(dynamics: Dynamics, *relative: float) -> Dynamics:
    """The same with relative standard uncertainties of its parameters."""
    return replace(dynamics, covariance=np.diag((np.array(relative) * dynamics.values) ** 2))


def by_difference(dynamics: Dynamics, step: float, *, bandwidth: float) -> float:
    """Relative standard uncertainty of a force up to a bandwidth, by central differences of the response."""
    sizes = np.sqrt(np.diag(dynamics.covariance))

    def density(frequency: float) -> float:
        change = 0.0
        for place in np.flatnonzero(sizes):
            more, less = dynamics.values, dynamics.values
            more[place] *= 1 + step
            less[place] *= 1 - step
            moved = (
                dynamics.with_parameters(more).response(frequency),
                dynamics.with_parameters(less).response(frequency),
            )
            slope = (moved[0] - moved[1]) / (2 * step * dynamics.values[place])
            change += abs(slope / dynamics.response(frequency) * sizes[place]) ** 2
        return change

    narrow = [mode.natural_frequency for mode in dynamics.modes if mode.natural_frequency < bandwidth]
    return float(np.sqrt(quad(density, 0, bandwidth, points=narrow, limit=800, epsrel=1e-9)[0] / bandwidth))


# one component


@pytest.mark.parametrize(("bandwidth", "gain"), [(800, 64), (400, 11), (200, 1.7), (132, 0.5)])
def test_noise_gain_of_the_exact_inverse(bandwidth, gain):
    """Figures of the T-128 constants, each printed to two digits."""
    (found,) = plan(T128, bandwidths=[bandwidth], rate=RATE, noise=2.0)["AF"].table
    assert found.noise_gain == pytest.approx(gain, rel=0.05)
    assert found.readings["AF"] == pytest.approx(2 * found.noise_gain)
    assert found.total == pytest.approx(found.decoupled)
    assert found.acceleration == found.parameters == 0


@pytest.mark.soak(first=1)
@pytest.mark.parametrize(
    ("dynamics", "bandwidth"),
    [
        (uncertain(T128, 1e-3, 2e-3, 1e-2, 0), 12_500.0),  # the resonance is 0.7 Hz wide
        (uncertain(T128.with_modes(Mode(165.0, 0.012, 0.05)), 1e-3, 2e-3, 1e-2, 0, 1e-3, 2e-2, 3e-2), 120.0),
        (uncertain(T128.with_modes(Mode(165.0, 0.012, -0.05)), 1e-3, 2e-3, 1e-2, 0, 1e-3, 2e-2, 3e-2), 400.0),
    ],
)
def test_parameters_of_every_mode_count(dynamics, bandwidth):
    found = plan(dynamics, bandwidths=[bandwidth], rate=25_000, noise=2.0, force=200.0)["AF"].table[0]
    # differences of 1e-5 of a parameter either way are good to some 1e-6 at a resonance of quality 45
    assert found.parameters == pytest.approx(200 * by_difference(dynamics, 1e-5, bandwidth=bandwidth), rel=1e-5)


def test_weak_forces_have_the_wiener_bound():
    bandwidth, force, noise, shake = 120.0, 5.0, 2.0, 0.02
    w0, decay = T128.angular_frequency, T128.decay_rate

    def left(f: float) -> float:
        """Spectrum of the error: S R / (S |G|^2 + R) written with the noise as a force, N / (1 + N / S)."""
        w = 2 * np.pi * f
        inverse = ((w0**2 - w**2) ** 2 + (2 * decay * w) ** 2) / w0**4
        disturbed = (2 * noise**2 * inverse + 2 * (T128.mass * shake) ** 2) / RATE
        return disturbed / (1 + disturbed / (force**2 / bandwidth))

    expected = np.sqrt(quad(left, 0, bandwidth, limit=400, epsrel=1e-10)[0])
    found = plan(T128, bandwidths=[bandwidth], rate=RATE, noise=noise, acceleration_noise=shake, force=force)["AF"]
    assert found.table[0].total == pytest.approx(expected, rel=INTEGRATION)
    assert found.table[0].total < force


def test_white_noise_through_the_band_limited_inverse(rng, seed):
    count, bandwidth = 1 << 18, 100.0
    spectrum = np.fft.rfft(rng.normal(0, 2.0, count))
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    inside = frequency <= bandwidth
    spectrum[inside] /= T128.response(frequency[inside])
    spectrum[~inside] = 0
    error = np.fft.irfft(spectrum, count)
    expected = plan(T128, bandwidths=[bandwidth], rate=RATE, noise=2.0)["AF"].table[0].total
    # 2 B T = 33000 independent values, fewer where the inverse weights them: the scatter of an rms is below 1 %
    assert error.std() == pytest.approx(expected, rel=0.03), seed


def test_parameters_known_with_uncertainty(rng, seed):
    u = np.array([0.2, 3000.0, 8.0, 0.0])
    known = Dynamics("AF", 177.87, 3.093e7, 828.21, covariance=np.diag(u**2))
    bandwidth, force = 90.0, 300.0
    frequency = np.linspace(0, bandwidth, 4097)
    errors = []
    for _ in range(400):
        M, k, b, _ = np.array([177.87, 3.093e7, 828.21, 0]) + u * rng.normal(size=4)
        ratio = T128.response(frequency) / Dynamics("AF", M, k, b).response(frequency)
        errors.append(force**2 / bandwidth * np.trapezoid(np.abs(ratio - 1) ** 2, frequency))
    found = plan(known, bandwidths=[bandwidth], rate=RATE, noise=1e-6, force=force)["AF"].table[0]
    # at resonance the error is linear in k to u(k)/k over twice the damping ratio, 1 %; 400 draws of a mean square
    assert np.sqrt(np.mean(errors)) == pytest.approx(found.parameters, rel=0.2), seed
    assert found.limited_by == "parameters of the dynamics"


def test_the_sensor_that_limits_is_named():
    quiet, loud = plan(T128, bandwidths=[30, 700], rate=RATE, noise=2.0, acceleration_noise=0.5)["AF"].table
    assert quiet.limited_by == "acceleration of the ground end"
    assert loud.limited_by == "AF reading"


def test_faster_sampling_averages_the_noise():
    rows = plan(T128, rate=RATE, noise=2.0)["AF"].at_other_rates
    assert [row.rate / RATE for row in rows] == [1, 2, 4, 8]
    assert [rows[0].total / row.total for row in rows] == pytest.approx(np.sqrt([1, 2, 4, 8]))
    assert {row.bandwidth for row in rows} == {1.25 * T128.natural_frequency}


# several components


def test_components_that_are_not_coupled_are_planned_as_each_alone_is() -> None:
    parts = [Dynamics("NF", 40.0, 8e6, 600.0), Dynamics("PM", 3.0, 2e6, 90.0)]
    parts = [uncertain(part, 1e-3, 1e-3, 0.1, 0) for part in parts]
    # mass and stiffness of the single component become the elements of A and D with their covariance
    together = CoupledDynamics.of_components(parts)
    for force in (None, FORCES):
        coupled, several, named = (
            plan(dynamics, rate=4000, noise=READINGS, force=force, bandwidths=[120, 2000])
            for dynamics in (together, parts, {part.component: part for part in parts})
        )
        for part in parts:
            name = part.component
            alone = plan(part, rate=4000, noise=READINGS, force=force, bandwidths=[120, 2000])[name]
            assert several[name].table == named[name].table == alone.table
            assert several[name].live_lag == pytest.approx(coupled[name].live_lag)
            for row, single in zip(coupled[name].table, alone.table, strict=True):
                assert row.readings[name] == pytest.approx(single.readings[name], rel=INTEGRATION)
                assert row.total == pytest.approx(row.decoupled, rel=INTEGRATION)
                assert row.parameters == pytest.approx(single.parameters, rel=INTEGRATION)
                assert row.noise_gain == pytest.approx(single.noise_gain, rel=INTEGRATION)
                assert row.limited_by == single.limited_by


def bound(dynamics: CoupledDynamics, noise: Array, force: Array, *, bandwidth: float, rate: float) -> Array:
    """Rms error of the best estimate from all channels: (S^-1 + H* R^-1 H)^-1 over frequency."""
    frequency = np.linspace(0, bandwidth, 60_001)
    response = dynamics.response(frequency)
    known = np.einsum("mji,j,mjk->mik", response.conj(), rate / (2 * noise**2), response)
    n = noise.size
    known[:, range(n), range(n)] += bandwidth / force**2
    error = np.real(np.linalg.inv(known)[:, range(n), range(n)])
    return np.asarray(np.sqrt(np.trapezoid(error, frequency, axis=0)))


def test_the_wiener_bound_of_all_channels(rng: np.random.Generator, seed: int) -> None:
    balance = random_balance(rng)
    top = 1.5 * balance.dynamics.modes[-1].natural_frequency
    noise, force = 1e-4 * balance.half_range, 1e-3 * balance.half_range
    names = balance.dynamics.components
    noises, forces = (dict(zip(names, sizes.tolist(), strict=True)) for sizes in (noise, force))
    found = plan(balance.dynamics, noise=noises, bandwidths=[top], rate=25_000.0, force=forces)
    rows = [part.table[0] for part in found.components.values()]
    expected = bound(balance.dynamics, noise, force, bandwidth=top, rate=25_000.0)
    # trapezia over the resonances' shoulders: the narrowest is 0.4 Hz wide, the steps are 0.015 Hz
    assert [row.total for row in rows] == pytest.approx(expected, rel=0.01), seed
    for row in rows:
        assert row.total <= row.decoupled * (1 + 1e-9), (row, seed)


def test_noise_of_the_ground_end_acts_through_the_mass() -> None:
    mass = RigidMass(5.0, np.zeros(3), np.diag([0.01, 0.02, 0.03]))
    found = plan(
        replace(pair(), mass=mass),
        noise=READINGS,
        acceleration_noise=0.3,
        angular_acceleration_noise=20.0,
        bandwidths=[200],
        rate=4000,
    )
    normal, pitching = found["NF"].table[0], found["PM"].table[0]
    # white noise of variance 2 h B in the band, times the mass and the moment of inertia about the pitch axis
    share = np.sqrt(2 * 200 / 4000)
    assert normal.acceleration == pytest.approx(5.0 * 0.3 * share, rel=1e-9)
    assert pitching.angular_acceleration == pytest.approx(0.02 * 20.0 * share, rel=1e-9)
    assert normal.limited_by == "acceleration of the ground end"
    assert pitching.limited_by == "angular acceleration of the ground end"


def bent() -> CoupledDynamics:
    """NF and PM with one mode more than components."""
    w = 2 * np.pi * np.array([60.0, 150.0, 300.0])
    scaled = np.array([[1.0, 0.1, 0.2], [0.2, 1.0, 0.1], [0.1, 0.2, 1.0]])
    return CoupledDynamics(NAMES, scaled / np.outer(w, w), 0.04 * scaled / np.sqrt(np.outer(w, w)))


@pytest.mark.parametrize("kind", ["pair", "bent"])
def test_uncertain_matrices_by_changing_each_element(kind: str) -> None:
    dynamics = pair() if kind == "pair" else bent()
    size = len(dynamics.inertia)
    deviation = 1e-4 * np.concatenate([np.abs(part).ravel() for part in (dynamics.inertia, dynamics.damping)])
    deviation[size * size :] *= 100
    known = replace(dynamics, covariance=np.diag(deviation**2))
    frequency = np.linspace(0, 200, 20_001)[1:]
    force = np.array([FORCES[name] for name in NAMES])
    felt = dynamics.response(frequency) * force / np.sqrt(200)
    variance = np.zeros(2)
    for place, u in enumerate(deviation):
        change = np.zeros(2 * size * size)
        change[place] = 1e-3 * u
        inertia, damping = change.reshape(2, size, size)
        moved = replace(dynamics, inertia=dynamics.inertia + inertia, damping=dynamics.damping + damping)
        slope = (moved.inverse_response(frequency) - dynamics.inverse_response(frequency)) @ felt / 1e-3
        variance += np.trapezoid(np.sum(np.abs(slope) ** 2, axis=2), frequency, axis=0)
    found = plan(known, noise=READINGS, bandwidths=[200], rate=4000, force=FORCES)
    # steps of 0.01 Hz beside resonances of 2 Hz and more; the elements move by 1e-7
    assert [found[name].table[0].parameters for name in NAMES] == pytest.approx(np.sqrt(variance), rel=1e-4)


# what surrounds the table


def test_usual_bandwidths_go_from_below_the_modes_to_half_the_rate() -> None:
    for found in (plan(T128, rate=RATE, noise=1.0)["AF"], plan(pair(), rate=RATE, noise=READINGS)["PM"]):
        low, high = min(found.natural_frequencies), max(found.natural_frequencies)
        chosen = [row.bandwidth for row in found.table]
        assert chosen == sorted(set(chosen))
        assert chosen[0] == pytest.approx(low / 10)
        assert {low, high} <= set(chosen)
        assert chosen[-1] == RATE / 2


def test_the_live_force_lags_as_planned() -> None:
    rate, settings = 20_000.0, LiveSettings(samples_a_period=np.inf)  # decimation waits for some samples more
    live = LiveForce(T128, rate=rate, settings=settings)
    live.push(np.zeros(1))
    assert plan(T128, rate=rate, noise=1.0)["AF"].live_lag == pytest.approx(live.lag, abs=1 / rate)
    coupled = LiveForce(pair(), rate=rate, noise=np.diag(NOISE**2), settings=settings)
    coupled.push(np.zeros((1, 2)))
    longest = max(part.live_lag for part in plan(pair(), rate=rate, noise=READINGS).components.values())
    assert coupled.lag == pytest.approx(longest, abs=1 / rate)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"rate": 0.0}, "rate must be positive, not 0"),
        ({"bandwidths": [900.0]}, r"between 0 and half the sampling rate \(800 Hz\), not 900"),
        ({"bandwidths": [0.0]}, "between 0 and half"),
        ({"noise": 0.0}, "noise of AF must be positive"),
        ({"force": -1.0}, "force of AF must be positive"),
        ({"acceleration_noise": -1.0}, "acceleration_noise must be zero or more"),
        ({"angular_acceleration_noise": 1.0}, "angular_acceleration_noise needs coupled dynamics"),
        ({"noise": {"NF": 1.0}}, "noise of AF is missing; it is given for NF"),
        ({"dynamics": pair()}, "noise must be given by component, for NF, PM"),
        ({"dynamics": pair(), "noise": READINGS, "force": {"PM": 1.0}}, "force of NF is missing"),
        ({"dynamics": bent(), "noise": READINGS, "acceleration_noise": 1.0}, "which the dynamics do not hold"),
        ({"dynamics": []}, "dynamics must be .*, not empty"),
        ({"dynamics": "dynamics.json"}, "dynamics must be .*, not str"),
        ({"dynamics": [T128, T128]}, "given twice of AF"),
    ],
)
def test_wrong_arguments(wrong: dict[str, object], words: str) -> None:
    given = {"dynamics": T128, "rate": RATE, "noise": 2.0, **wrong}
    with pytest.raises(ValueError, match=words):
        plan(given.pop("dynamics"), **given)  # type: ignore[arg-type]


# the command


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "dynamics.json"
    values = {"mass": {"value": 177.87}, "stiffness": {"value": 3.093e7, "u": 600}, "damping": {"value": 828.21}}
    file.write_text(json.dumps({"components": {"AF": values}}))
    arguments = ["plan", "--dynamics", str(file), "--noise", "2", "--rate", "1600"]
    assert main([*arguments, "--force", "200", "--bandwidth", "120", "--json"]) == 0
    account = json.loads(capsys.readouterr().out)
    (row,) = account["attainable"]
    assert row["u"] == pytest.approx(np.sqrt(row["u_reading"] ** 2 + row["u_parameters"] ** 2))
    assert account["advice"].startswith("AF up to 82.96 Hz is limited by the AF reading: ")
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "limited by" in text
    assert "live, the force follows 75.3 ms behind" in text
    assert "Give --force" in text
    for more, words in (
        (["--bandwidth", "5000"], "half the sampling rate (800 Hz)"),
        (["--component", "NF"], "has no NF; it has AF"),
        (["--turn-noise", "1"], "needs coupled dynamics"),
        (["--rate", "-1"], "rate must be positive"),
    ):
        assert main([*arguments, *more]) == 2, more
        assert words in capsys.readouterr().err, more


def test_the_command_lists_every_mode_and_component(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "two.json"
    write_dynamics(file, {"AF": T128.with_modes(Mode(165.0, 0.012, 0.05)), "NF": Dynamics("NF", 180, 6e8, 900)})
    arguments = ["plan", "--dynamics", str(file), "--rate", "1600"]
    assert main([*arguments, "--noise", "AF=2", "--noise", "NF=20"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "AF: standard uncertainty of one sample, f0 = 66.368 Hz (further modes 165 Hz)" in text
    assert "NF: standard uncertainty of one sample, f0 = 290.58 Hz" in text
    assert "75.3 ms (AF), 17.2 ms (NF) behind" in text
    assert main([*arguments, "--noise", "2", "--component", "AF", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["component"] == "AF"


def test_the_command_on_coupled_components(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "dynamics.json"
    write_dynamics(file, pair())
    arguments = ["plan", "--dynamics", str(file), "--rate", "4000"]
    noise = ["--noise", "NF=0.1", "--noise", "PM=0.005"]
    assert main([*arguments, *noise, "--force", "NF=10", "--force", "PM=0.5", "--json"]) == 0
    account = json.loads(capsys.readouterr().out)
    assert list(account["components"]) == ["NF", "PM"]
    row = account["components"]["PM"]["attainable"][-1]
    parts = [row["u_reading"], *row["u_other_readings"].values(), row["u_parameters"]]
    assert row["u"] == pytest.approx(np.linalg.norm(parts))
    rates = [row["u"] for row in account["components"]["NF"]["at_other_rates"]]
    assert rates == sorted(rates, reverse=True)
    assert main([*arguments, *noise, "--component", "PM", "--acceleration-noise", "0.1", "--turn-noise", "1"]) == 0
    out = capsys.readouterr().out
    assert "PM up to" in out
    assert "NF up to" not in out
    for line, words in (
        (["--noise", "0.1"], "by component"),
        (["--noise", "NF=0.1"], "noise of PM is missing"),
        (["--noise", "XX=0.1"], "--noise must be positive"),
        ([*noise, "--component", "AF"], "has no AF; it has NF, PM"),
    ):
        assert main([*arguments, *line]) == 2, line
        assert words in capsys.readouterr().err, line


def test_components_that_do_not_oscillate_are_planned_up_to_half_the_rate():
    """Where no component has another beside it, N = 1 + s d + s^2 a: of |N|^2 the mean is a closed form."""
    w, ratio = 2 * np.pi * np.array([50.0, 80.0]), np.array([2.0, 3.0])
    a, d = 1 / w**2, 2 * ratio / w
    found = plan(CoupledDynamics(NAMES, np.diag(a), np.diag(d)), rate=RATE, noise=READINGS)
    top = np.pi * RATE
    expected = np.sqrt(1 + (d**2 - 2 * a) * top**2 / 3 + a**2 * top**4 / 5)
    for name, gain in zip(NAMES, expected, strict=True):
        (row,) = found[name].table
        assert row.bandwidth == RATE / 2
        assert row.noise_gain == pytest.approx(gain, rel=INTEGRATION)
