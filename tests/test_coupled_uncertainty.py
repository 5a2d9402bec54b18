"""Monte Carlo and records of noise for coupled components."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.force_record import force_record, noise_spectra
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.errors import FitError
from aerobalance.recording.gravity import Attitudes, GravityOnZero
from aerobalance.uncertainty.monte_carlo import monte_carlo
from aerobalance.uncertainty.sampling import UncertainDynamics, standard_normals
from helpers.coupled_pair import COUNT, NOISE, RATE, SIZE, band, colored, pair, recording_of, shaken


@pytest.mark.filterwarnings("ignore:.* shows turning")  # the pair is pitched for its weight alone
@pytest.mark.parametrize("options", [{}, {"bandwidth": 300.0}, {"method": "paper"}])
@pytest.mark.soak(first=1)
def test_monte_carlo_agrees_with_the_first_order(options: dict[str, object], rng, seed) -> None:
    dynamics = pair()
    _, felt, pitch = shaken(rng, dynamics)
    recording = recording_of(felt + NOISE * rng.normal(size=felt.shape), pitch=pitch)
    found = estimate_force(recording, dynamics, **options)
    checked = monte_carlo(found, draws=25, seed=seed)
    assert list(checked) == ["NF", "PM"]
    for name, result in checked.items():
        rows = {row.name: row for row in result.contributions}
        # the sets drawn have exactly their covariance, but for 24 of 25 in the mean square: what is left is curvature
        assert rows["inertia, damping and mass"].ratio == pytest.approx(np.sqrt(24 / 25), rel=0.03), name
        assert rows["inertia, damping and mass"].drawn > 0
        # ten per cent is what is promised; the scatter of 25 draws of noise is beside that
        whole = result.contributions[-1]
        assert abs(whole.ratio - 1) < 0.1 + 4 * whole.scatter, name


@pytest.mark.parametrize("at_zero", [0.1, -0.3])
@pytest.mark.soak(first=1)
def test_a_wrong_mass_is_wrong_in_the_zero_of_the_loads_too(at_zero: float, rng, seed) -> None:
    dynamics = pair()
    dynamics = replace(dynamics, covariance=np.zeros_like(dynamics.covariance))
    mass, pitch = dynamics.mass, 0.1
    assert mass is not None
    own = [COMPONENTS.index(name) for name in dynamics.components]
    force = 0.03 * SIZE * band(rng, 250, count=COUNT, rate=RATE, columns=2)
    felt = dynamics.balance_load(force, interval=1 / RATE) + mass.weight(np.array([pitch]))[:, own]
    recording = recording_of(felt + NOISE * rng.normal(size=felt.shape), pitch=np.full(COUNT, pitch))
    zero = [Attitudes(np.array([at_zero]), np.zeros(1))]
    recording = replace(recording, gravity_on_zero=GravityOnZero.of(zero, gravity=STANDARD_GRAVITY))
    found = estimate_force(recording, dynamics)
    checked = monte_carlo(found, draws=25, seed=seed)

    def weighs(values: Array) -> Array:
        """What the loads have too much of, in the run and in the zero."""
        run, zero = RigidMass.of_values(values).weight(np.array([pitch, at_zero]))[:, own]
        return run - zero

    # the weight is linear in mass times centre: what the centre and the mass do together is of second order
    size = np.sqrt(np.diag(mass.covariance))
    moved = [weighs(mass.values + row) - weighs(mass.values - row) for row in np.diag(size)]
    expected = np.sqrt(np.sum(np.square(moved), axis=0)) / 2
    for name, u in zip(dynamics.components, expected, strict=True):
        given = found[name].budget["inertia, damping and mass"]
        # the balance answers a weight that stands still as it is; 1e-4 of the weight's own is left by the inverse
        assert given == pytest.approx(u, rel=1e-3, abs=1e-4 * 2e-3 * mass.mass * STANDARD_GRAVITY), name
        drawn = [row.drawn for row in checked[name].contributions if row.name == "inertia, damping and mass"]
        # a row of nothing is left out
        least = 1e-4 * 2e-3 * mass.mass * STANDARD_GRAVITY
        assert sum(drawn) == pytest.approx(np.sqrt(24 / 25) * u, rel=0.03, abs=least), name


def test_gaps_are_filled_in_the_draws_as_in_the_force(rng, seed) -> None:
    dynamics = replace(pair(), mass=None)
    _, felt, _ = shaken(rng, pair(), pitching=False)
    loads = (felt + NOISE * rng.normal(size=felt.shape))[:1200]
    loads[500:520, 1] = np.nan
    recording = recording_of(loads)
    found = estimate_force(recording, dynamics)
    checked = monte_carlo(found, draws=12, seed=seed)
    for name, result in checked.items():
        row = next(row for row in result.contributions if row.name == "inertia, damping and mass")
        assert row.ratio == pytest.approx(np.sqrt(11 / 12), rel=0.03), name


def draws(dynamics: CoupledDynamics, rows: np.ndarray, number: int) -> list[CoupledDynamics]:
    unsure = UncertainDynamics.of(dynamics, rows)
    return [unsure.at(numbers) for numbers in standard_normals(np.random.default_rng(3), unsure.count, number)]


def test_drawn_matrices_have_exactly_the_covariance_of_the_row() -> None:
    dynamics = pair()
    root = np.random.default_rng(5).normal(size=(8, 8)) * np.sqrt(np.diag(dynamics.covariance))
    tied = replace(dynamics, covariance=root.T @ root / 8)
    rows = np.array([0, 1, 4, 5])  # NF of both matrices
    drawn = draws(tied, rows, 40)
    numbers = np.array([np.concatenate([item.inertia.ravel(), item.damping.ravel()]) for item in drawn])
    size = np.sqrt(np.diag(tied.covariance))
    scaled = (numbers - numbers.mean(axis=0)) / size
    expected = tied.covariance / np.outer(size, size)
    assert scaled[:, rows].T @ scaled / 39 == pytest.approx(expected[rows], abs=1e-6)
    masses = np.array([item.mass.values for item in drawn])  # type: ignore[union-attr]
    assert tied.mass is not None
    assert np.cov(masses.T) == pytest.approx(tied.mass.covariance, abs=1e-9)


def test_more_numbers_than_draws_are_drawn_all_the_same() -> None:
    dynamics = pair()
    drawn = draws(dynamics, np.arange(8), 10)
    assert len(drawn) == 10


def test_matrices_that_are_hardly_known_are_refused() -> None:
    dynamics = pair()
    wild = replace(dynamics, covariance=dynamics.covariance * 1e8)
    with pytest.raises(FitError, match="not physical"):
        draws(wild, np.array([0, 1, 4, 5]), 40)


def test_noise_of_a_component_taken_apart_is_what_its_balance_makes_of_all_channels(rng) -> None:
    dynamics, corners = pair(), (60.0, 0.0)
    run = recording_of(0.01 * SIZE * rng.normal(size=(COUNT, 2)))
    run = replace(
        run,
        channels={
            name: replace(run.channel(name), noise=float(u)) for name, u in zip(("NF", "PM"), NOISE, strict=True)
        },
    )
    found = noise_spectra(recording_of(colored(rng, corners, 40_000)), force_record(run, dynamics))
    frequency = np.array([8.0, 20.0, 400.0, 1000.0])
    decoupled = CoupledRecord.of(run, dynamics).decoupled
    for place, (name, spectrum) in enumerate(found.items()):
        density = (1 + np.array(corners) / frequency[:, None]) * NOISE**2 / RATE
        row = np.abs(dynamics.inverse_response(frequency)[:, place]) ** 2
        expected = np.sum(row * density, axis=1) * np.abs(decoupled[place].dynamics.response(frequency)) ** 2
        # 10 s of noise, its 1/f part from the ordinates below the mode: 30 % at 8 and 20 Hz, 5 % where it is white
        # (thousands of ordinates), the spectrum being no exact 1/f near the mode
        assert spectrum.density(frequency) == pytest.approx(expected, rel=0.5), name
        assert spectrum.density(frequency)[2:] == pytest.approx(expected[2:], rel=0.2), name


@pytest.mark.filterwarnings("ignore:.*lie where the mains do")  # once in some forty, by chance
def test_uncertainty_with_a_record_of_noise_is_that_of_the_errors(rng) -> None:
    dynamics = replace(pair(), covariance=np.zeros((8, 8)))
    force, felt, _ = shaken(rng, dynamics, pitching=False)
    corners = (40.0, 40.0)
    run = recording_of(felt + colored(rng, corners, COUNT))
    spectra = noise_spectra(recording_of(colored(rng, corners, 40_000)), force_record(run, dynamics))
    found = estimate_force(run, dynamics, noise=spectra)
    inner = slice(COUNT // 20, -COUNT // 20)
    for place, (name, estimate) in enumerate(found.items()):
        error = (estimate.values - force[:, place])[inner]
        ratio = float(np.sqrt(np.mean(error**2) / np.mean(estimate.uncertainty[inner] ** 2)))
        assert 0.6 < ratio < 1.6, name
        assert "record of noise" in estimate.method
