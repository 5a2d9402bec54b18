"""What a test of components that ring together can reach: closed forms and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.dynamics.coupled import CoupledDynamics, RigidMass
from aerobalance.dynamics.single import Dynamics
from aerobalance.io.coupled_file import write_coupled
from aerobalance.recording.channel import Array
from aerobalance.simulation.six_balance import random_balance
from aerobalance.uncertainty.coupled_planning import Sensors, attainable_coupled, usual_bandwidths_of_coupled
from aerobalance.uncertainty.planning import attainable
from test_coupled_uncertainty import NOISE, RATE, SIZE, pair

NAMES = ("NF", "PM")
READINGS = dict(zip(NAMES, NOISE.tolist(), strict=True))
FORCES = dict(zip(NAMES, (0.01 * SIZE).tolist(), strict=True))


def test_components_each_for_itself_are_planned_as_one_is() -> None:
    parts = [Dynamics("NF", 40.0, 8e6, 600.0), Dynamics("PM", 3.0, 2e6, 90.0)]
    parts = [replace(part, covariance=np.diag((np.array([1e-3, 1e-3, 0.1, 0]) * part.values) ** 2)) for part in parts]
    together = CoupledDynamics.of_components(parts)
    # mass and stiffness of the single component become the elements of A and D with their covariance
    for force in (None, FORCES):
        found = attainable_coupled(together, Sensors(READINGS), bandwidth=120, rate=RATE, force=force)
        for row, part in zip(found, parts, strict=True):
            single = attainable(
                part,
                bandwidth=120,
                rate=RATE,
                noise=READINGS[row.component],
                force=None if force is None else force[row.component],
            )
            # both integrate the same functions, over 4097 and over some more frequencies
            assert row.sensors[f"{row.component} reading"] == pytest.approx(single.reading, rel=1e-4)
            assert row.total == pytest.approx(row.apart, rel=1e-4)
            assert row.parameters == pytest.approx(single.parameters, rel=1e-3)
            assert row.noise_gain == pytest.approx(single.noise_gain, rel=1e-4)
            assert row.limited_by == (f"{row.component} reading" if force is None else row.limited_by)


def bound(dynamics: CoupledDynamics, noise: Array, force: Array, *, bandwidth: float, rate: float) -> Array:
    """Rms error of the best estimate from all channels: (S^-1 + H* R^-1 H)^-1 over frequency."""
    frequency = np.linspace(0, bandwidth, 60_001)
    response = dynamics.response(frequency)
    known = np.einsum("mji,j,mjk->mik", response.conj(), rate / (2 * noise**2), response)
    n = noise.size
    known[:, range(n), range(n)] += bandwidth / force**2
    error = np.real(np.linalg.inv(known)[:, range(n), range(n)])
    return np.asarray(np.sqrt(np.trapezoid(error, frequency, axis=0)))


def test_the_wiener_bound_of_all_channels(rng) -> None:
    balance = random_balance(rng)
    top = 1.5 * balance.dynamics.modes[-1].natural_frequency
    noise, force = 1e-4 * balance.half_range, 1e-3 * balance.half_range
    names = balance.dynamics.components
    given = dict(zip(names, noise.tolist(), strict=True)), dict(zip(names, force.tolist(), strict=True))
    found = attainable_coupled(balance.dynamics, Sensors(given[0]), bandwidth=top, rate=25_000.0, force=given[1])
    expected = bound(balance.dynamics, noise, force, bandwidth=top, rate=25_000.0)
    # trapezia over the resonances' shoulders: the narrowest is 0.4 Hz wide, the steps are 0.015 and 0.2 Hz
    assert [row.total for row in found] == pytest.approx(expected, rel=0.01)
    for row in found:
        assert row.total <= row.apart * 1.01, row


def test_noise_of_the_ground_comes_through_the_mass() -> None:
    mass = RigidMass(5.0, np.zeros(3), np.diag([0.01, 0.02, 0.03]))
    dynamics = replace(pair(), mass=mass)
    sensors = Sensors(READINGS, acceleration=0.3, turning=20.0)
    normal, pitching = attainable_coupled(dynamics, sensors, bandwidth=200, rate=RATE)
    # white noise of variance 2 h B in the band, times the mass and the moment of inertia about the pitch axis
    share = np.sqrt(2 * 200 / RATE)
    assert normal.sensors["ground accelerometers"] == pytest.approx(5.0 * 0.3 * share, rel=1e-9)
    assert pitching.sensors["ground turning"] == pytest.approx(0.02 * 20.0 * share, rel=1e-9)
    assert normal.limited_by == "ground accelerometers"
    assert pitching.limited_by == "ground turning"


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
    uncertain = replace(dynamics, covariance=np.diag(deviation**2))
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
    found = attainable_coupled(uncertain, Sensors(READINGS), bandwidth=200, rate=RATE, force=FORCES)
    assert [row.parameters for row in found] == pytest.approx(np.sqrt(variance), rel=2e-3)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"bandwidth": 3000.0}, "half the sampling rate"),
        ({"sensors": Sensors({"NF": 1.0})}, "noise of PM is missing"),
        ({"force": {"PM": 1.0}}, "force of NF is missing"),
        ({"force": {"NF": -1.0, "PM": 1.0}}, "force must be positive"),
        ({"sensors": Sensors(READINGS, acceleration=0.1), "dynamics": bent()}, "which the dynamics do not hold"),
    ],
)
def test_wrong_arguments(wrong: dict[str, object], words: str) -> None:
    given = {"dynamics": pair(), "sensors": Sensors(READINGS), "bandwidth": 100.0, **wrong}
    dynamics, sensors = given.pop("dynamics"), given.pop("sensors")
    with pytest.raises(ValueError, match=words):
        attainable_coupled(dynamics, sensors, rate=RATE, **given)  # type: ignore[arg-type]


def test_noise_must_be_positive() -> None:
    with pytest.raises(ValueError, match="noise must be positive"):
        Sensors({"NF": 0.0})
    with pytest.raises(ValueError, match="zero or more"):
        Sensors({"NF": 1.0}, turning=-1.0)


def test_bandwidths_end_at_half_the_rate() -> None:
    chosen = usual_bandwidths_of_coupled(pair(), 300.0)
    assert chosen[-1] == 150.0
    assert list(chosen) == sorted(chosen)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "dynamics.json"
    write_coupled(file, pair())
    plan = ["plan", "--dynamics", str(file), "--rate", "4000"]
    noise = ["--noise", "NF=0.1", "--noise", "PM=0.005"]
    assert main([*plan, *noise, "--force", "NF=10", "--force", "PM=0.5", "--json"]) == 0
    account = json.loads(capsys.readouterr().out)
    assert list(account["components"]) == ["NF", "PM"]
    row = account["components"]["PM"]["attainable"][-1]
    assert row["u"] == pytest.approx(np.linalg.norm([*row["u_by_sensor"].values(), row["u_parameters"]]))
    rates = [row["u"] for row in account["components"]["NF"]["at_other_rates"]]
    assert rates == sorted(rates, reverse=True)
    assert main([*plan, *noise, "--component", "PM", "--acceleration-noise", "0.1", "--turn-noise", "1"]) == 0
    out = capsys.readouterr().out
    assert "PM up to" in out
    assert "NF up to" not in out
    for line, code, words in (
        (["--noise", "0.1"], 2, "by component"),
        (["--noise", "NF=0.1"], 2, "noise of PM is missing"),
        (["--noise", "XX=0.1"], 2, "--noise must be positive"),
        ([*noise, "--component", "AF"], 1, "have no AF"),
    ):
        assert main([*plan, *line]) == code, line
        assert words in capsys.readouterr().err, line
