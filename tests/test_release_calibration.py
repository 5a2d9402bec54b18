"""What a calibration leaves in matrices found from releases: against refits, and against matrices drawn from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.matrix_errors import MatrixErrors, coefficient_covariance
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.coupled.internal_coordinates import slow_matrices
from aerobalance.identification.coupled.modes import ModeTable
from aerobalance.identification.coupled.units import Units
from aerobalance.identification.step_relaxation.calibration_errors import coefficient_slopes
from aerobalance.identification.step_relaxation.fit import ReleaseFit, settle
from aerobalance.identification.step_relaxation.record import ReleaseRecord, release_record
from aerobalance.identification.step_relaxation.stages import fit_releases
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.recording import Recording
from aerobalance.simulation.six_balance import random_balance
from helpers import bending_releases as bending
from helpers.releases import between, errors, felt, quietly, recording
from helpers.rigid_balance import HALF_RANGE, truth

NOISE = 1e-5
"""Noise of a reading over half of range: what the readings leave is small beside what the calibration leaves."""

SETTLED = 1e-9
"""Drop of the squares at which a fit has settled, so that two fits can be told apart by small changes."""


def calibrated(rng: np.random.Generator, *, size: float, way: str = "iterative") -> BalanceMatrix:
    """A matrix with interactions, and a covariance whose coefficients go together within and across bridges."""
    matrix = random_balance(rng).matrix
    count = len(matrix.terms)
    mixing = rng.normal(size=(count, count)) / np.sqrt(count) + np.eye(count)
    factor = rng.normal(size=(6, 12))
    correlation = factor @ factor.T
    unit = np.sqrt(np.diag(correlation))
    return replace(
        matrix,
        way=way,
        load_scale=HALF_RANGE,
        calibrated=np.array([-HALF_RANGE, HALF_RANGE]),
        # bridges of unequal quality, whose covariances are proportional to each other
        covariance=rng.uniform(0.3, 1.5, 6)[:, None, None] ** 2 * size**2 * (mixing @ mixing.T),
        residual_correlation=correlation / np.outer(unit, unit),
    )


def drawn(matrix: BalanceMatrix, rng: np.random.Generator) -> tuple[BalanceMatrix, Array]:
    """A matrix that the calibration cannot tell from this one, and the change of its coefficients, shape (c t,)."""
    values, vectors = np.linalg.eigh(coefficient_covariance(matrix))
    change = vectors @ (np.sqrt(np.maximum(values, 0)) * rng.normal(size=values.size))
    return replace(matrix, coefficients=matrix.coefficients + change.reshape(6, -1).T), change


def outputs_of_releases(matrix: BalanceMatrix, rng: np.random.Generator) -> list[Array]:
    """Gauge outputs of a release of half the half range along every component, by the true matrix [mV/V]."""
    tables = []
    for name in COMPONENTS:
        held = np.where(np.array(COMPONENTS) == name, 0.5, 0.0) * HALF_RANGE
        values = felt(truth(), held, instant=0.05 + rng.uniform(0, 0.01))
        tables.append(matrix.outputs(values + NOISE * HALF_RANGE * rng.normal(size=values.shape)))
    return tables


def loads_by(matrix: BalanceMatrix, tables: list[Array]) -> tuple[list[ReleaseRecord], list[MatrixErrors]]:
    loads = [matrix.loads(table).loads for table in tables]
    records = [
        release_record(recording(values, name), COMPONENTS) for values, name in zip(loads, COMPONENTS, strict=True)
    ]
    return records, [MatrixErrors(matrix, COMPONENTS, np.eye(6), values) for values in loads]


def inertia_and_damping(fit: ReleaseFit, units: Units) -> Array:
    """A and D row by row, shape (72,) [SI]."""
    spring, brake = units.bare(*fit.matrices.reshape(2, 6, 6))
    A = np.linalg.inv(spring)
    return np.concatenate([A.ravel(), (A @ brake).ravel()])


@pytest.mark.soak(first=0)
@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
def test_slopes_are_those_of_true_refits(way: str, rng) -> None:
    matrix = calibrated(rng, size=1e-5, way=way)
    tables = outputs_of_releases(matrix, rng)
    records, given = loads_by(matrix, tables)
    fit, units = fit_releases(records, sizes=HALF_RANGE)
    fit = settle(fit.segments, fit.matrices, fit.own, noise=fit.noise, enough=SETTLED)
    slopes = coefficient_slopes(fit, units, records, given, components=COMPONENTS)
    for _ in range(2):
        _, change = drawn(matrix, rng)
        moved = refitted(fit, units, matrix, tables, change) - refitted(fit, units, matrix, tables, -change)
        told = 2 * slopes @ change
        scale = np.linalg.norm(told.reshape(2, 36), axis=1).repeat(36)  # A and D have units of their own
        # the squares of errors of 1e-4 of the loads cancel, but where |F| turns; a gradient's step has no curvature
        assert np.max(np.abs((moved - told) / scale)) < 1e-2


def refitted(fit: ReleaseFit, units: Units, matrix: BalanceMatrix, tables: list[Array], change: Array) -> Array:
    """A and D with a change of the coefficients."""
    wrong = replace(matrix, coefficients=matrix.coefficients + change.reshape(6, -1).T)
    segments = [
        replace(segment, values=record.values / HALF_RANGE)
        for segment, record in zip(fit.segments, loads_by(wrong, tables)[0], strict=True)
    ]
    again = settle(segments, fit.matrices, fit.own, noise=fit.noise, enough=SETTLED)
    return inertia_and_damping(again, units)


def straightened(matrix: BalanceMatrix) -> BalanceMatrix:
    """A matrix with linear terms alone, that are known to be so: the errors of the loads are linear too."""
    straight = np.array([term.kind == 0 for term in matrix.terms])
    covariance = matrix.covariance * np.outer(straight, straight)
    return replace(matrix, coefficients=matrix.coefficients * straight[:, None], covariance=covariance)


def test_a_linear_error_turns_the_matrices_and_leaves_the_modes(rng) -> None:
    matrix = straightened(calibrated(rng, size=1e-4))
    tables = outputs_of_releases(matrix, rng)
    records, given = loads_by(matrix, tables)
    found = quietly(
        [recording(error.native, name) for error, name in zip(given, COMPONENTS, strict=True)], errors=given
    )
    dynamics = found.dynamics
    assert len(records) == len(given)

    expected = covariance_of_turning(matrix, dynamics.inertia, dynamics.damping, COMPONENTS)
    u = np.sqrt(np.diag(expected))
    # noise in the loads, 1e-5 of what rings and thousands of readings, is all that makes a difference
    np.testing.assert_allclose(
        dynamics.covariance_of_calibration / np.outer(u, u), expected / np.outer(u, u), atol=1e-2
    )
    sizes = HALF_RANGE
    alone = ModeTable.of(replace(dynamics, covariance=np.zeros((72, 72))), sizes=sizes)
    readings = ModeTable.of(replace(dynamics, covariance_of_calibration=np.zeros((72, 72))), sizes=sizes)
    assert (alone.u_natural_frequency < readings.u_natural_frequency).all()
    assert (alone.u_damping_ratio < readings.u_damping_ratio).all()


def covariance_of_turning(matrix: BalanceMatrix, A: Array, D: Array, names: tuple[str, ...]) -> Array:
    """Covariance of A and D of these components from the errors E of a linear matrix: E A - A E and E D - D E."""
    inverse, kept = np.linalg.inv(matrix.linear), [COMPONENTS.index(name) for name in names]
    slopes = np.zeros((2 * A.size, 6, len(matrix.terms)))
    for place, term in enumerate(matrix.terms):
        for row in range(6) if term.kind == 0 else ():
            E = -np.outer(inverse[:, row], np.eye(6)[term.first]) * HALF_RANGE[:, None] / HALF_RANGE
            own = E[np.ix_(kept, kept)]
            slopes[:, row, place] = np.concatenate([(own @ part - part @ own).ravel() for part in (A, D)])
    flat = slopes.reshape(len(slopes), -1)
    return np.asarray(flat @ coefficient_covariance(matrix) @ flat.T)


def test_ringing_without_its_release_is_turned_as_the_whole_is(rng) -> None:
    matrix = straightened(calibrated(rng, size=1e-4))
    places = [COMPONENTS.index(name) for name in bending.NAMES]
    M, C, K, _, _ = bending.structure()
    inverse = np.linalg.inv(K[:2, :2])
    two = CoupledDynamics(bending.NAMES, M[:2, :2] @ inverse, C[:2, :2] @ inverse)
    made, given = [], []
    for one in bending.recordings(two, rng, noise=NOISE):
        values = np.column_stack([one.channel(name).values for name in bending.NAMES])[200:]
        channels = {name: replace(one.channel(name), values=values[:, i]) for i, name in enumerate(bending.NAMES)}
        made.append(Recording.from_columns(one.time[200:], channels, name=one.name))
        native = np.zeros((len(values), 6))
        native[:, places] = values
        given.append(MatrixErrors(matrix, COMPONENTS, np.eye(6), native))
    found = bending.quietly(made, modes=2, errors=given).dynamics
    expected = covariance_of_turning(matrix, found.inertia, found.damping, bending.NAMES)
    u = np.sqrt(np.diag(expected))
    # noise in the loads, 1e-5 of half of range and 1e-4 of what still rings, is all that makes a difference
    np.testing.assert_allclose(found.covariance_of_calibration / np.outer(u, u), expected / np.outer(u, u), atol=2e-2)


def test_hidden_coordinates_are_turned_as_slow_motion_is(rng) -> None:
    matrix = straightened(calibrated(rng, size=1e-4))
    places = [COMPONENTS.index(name) for name in bending.NAMES]
    made = bending.recordings(bending.truth(), rng, noise=NOISE)
    given = []
    for one in made:
        native = np.zeros((one.samples, 6))
        native[:, places] = np.column_stack([one.channel(name).values for name in bending.NAMES])
        given.append(MatrixErrors(matrix, COMPONENTS, np.eye(6), native))
    found = bending.quietly(made, modes=3, errors=given).dynamics
    assert found.internal == 1
    alone = replace(found, covariance=np.zeros_like(found.covariance))
    A, D, covariance = slow_matrices(alone)
    expected = covariance_of_turning(matrix, A, D, bending.NAMES)
    u = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(covariance / np.outer(u, u), expected / np.outer(u, u), atol=2e-2)
    readings = ModeTable.of(
        replace(found, covariance_of_calibration=np.zeros_like(found.covariance)), sizes=bending.HALF_RANGE
    )
    modes = ModeTable.of(alone, sizes=bending.HALF_RANGE)
    assert (modes.u_natural_frequency < readings.u_natural_frequency).all()


@pytest.mark.soak(first=0)
def test_errors_have_the_covariance_of_readings_and_calibration(rng) -> None:
    matrix = calibrated(rng, size=3e-5)
    wrong, _ = drawn(matrix, rng)
    tables = outputs_of_releases(matrix, rng)
    _, given = loads_by(wrong, tables)
    found = quietly(
        [recording(error.native, name) for error, name in zip(given, COMPONENTS, strict=True)], errors=given, mass=20.0
    )
    true = truth()
    departure, before = (squares(found.dynamics, true, whole) for whole in (True, False))
    assert between(departure, 72)
    assert before > 10 * departure  # which the readings alone do not explain
    assert found.rigid is not None
    assert found.rigid.rigidity is not None
    assert found.rigid.reciprocity is not None
    assert found.rigid.rigidity.p_value > 1e-6
    assert found.rigid.reciprocity.p_value > 1e-6
    modes = ModeTable.of(found.dynamics, sizes=HALF_RANGE)
    np.testing.assert_array_equal(found.u_natural_frequency, modes.u_natural_frequency)


def squares(found: CoupledDynamics, true: CoupledDynamics, whole: bool) -> float:
    covariance = found.total_covariance if whole else found.covariance
    u = np.sqrt(np.diag(covariance))
    z = errors(found, true) / u
    return float(z @ np.linalg.solve(covariance / np.outer(u, u), z))


def test_errors_are_given_for_all_recordings_or_none(rng) -> None:
    matrix = calibrated(rng, size=1e-5)
    _, given = loads_by(matrix, outputs_of_releases(matrix, rng))
    recordings = [recording(error.native, name) for error, name in zip(given, COMPONENTS, strict=True)]
    with pytest.raises(ValueError, match="each of 6 recordings"):
        quietly(recordings, errors=given[:1])


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
def test_slopes_of_loads_are_their_differences(way: str, rng) -> None:
    matrix = calibrated(rng, size=1e-5, way=way)
    outputs = matrix.outputs(0.4 * rng.uniform(0.5, 1, (20, 6)) * HALF_RANGE)
    native = matrix.loads(outputs).loads
    rows, names = np.array([3, 7, 12]), ("PM", "AF")
    (part,) = MatrixErrors(matrix, COMPONENTS, np.eye(6), native).parts(rows, names)
    change = 1e-5 * rng.normal(size=matrix.coefficients.shape)
    more, less = (
        replace(matrix, coefficients=matrix.coefficients + sign * change).loads(outputs).loads for sign in (1, -1)
    )
    told = np.einsum("mnc,mt,tc->mn", part.gain, part.terms, change)
    places = [COMPONENTS.index(name) for name in names]
    # third differences: the square of 1e-5 times some hundred terms; rounding of the loads is 1e-12 of them
    np.testing.assert_allclose((more - less)[rows][:, places] / 2, told, rtol=1e-5, atol=1e-11 * HALF_RANGE.max())
