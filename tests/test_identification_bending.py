"""Modes of a model or sting that bends, from releases: the structure behind them, what is found, and what is told."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2, norm

from aerobalance.app.commands.identify_coupled import identify_decays
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.coupled.conclusions import rigid_of
from aerobalance.identification.coupled.era import quick_guess
from aerobalance.identification.coupled.free_response import FreeMotion
from aerobalance.identification.coupled.internal_coordinates import (
    held_states,
    invariances,
    quasi_static,
    renewed,
    static_contributions,
)
from aerobalance.identification.coupled.least_squares import compressed, whitener_of
from aerobalance.identification.coupled.modes import ModeTable
from aerobalance.identification.force_error import force_weights, true_force_error
from aerobalance.identification.step_relaxation import model_order as further_coupled
from aerobalance.identification.step_relaxation.model import Segment, linearise
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import read_coupled
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording
from aerobalance.simulation.six_balance import random_balance
from aerobalance.simulation.six_bending import Bending, bending_dynamics
from helpers.bending_releases import (
    HALF_RANGE,
    NAMES,
    RANGES,
    RATE,
    in_loads,
    quietly,
    recordings,
    structure,
    truth,
)
from helpers.rigid_balance import truth as balance_truth

NEVER = 1e-5
"""Probability with which a test of chance may fail for a fresh seed."""


def rigid() -> CoupledDynamics:
    M, C, K, _, _ = structure()
    inverse = np.linalg.inv(K[:2, :2])
    return CoupledDynamics(NAMES, M[:2, :2] @ inverse, C[:2, :2] @ inverse)


def test_loads_of_a_bending_structure(rng):
    balance = random_balance(rng)
    bending = Bending.random(balance, rng, frequency=rng.uniform(60, 900), part=0.3)
    dynamics = bending_dynamics(balance, bending)
    nothing = np.zeros((6, 1))
    M = np.block([[balance.mass.matrix, bending.coupling], [bending.coupling.T, bending.mass]])
    assert np.linalg.eigvalsh(M / np.sqrt(np.outer(np.diag(M), np.diag(M))))[0] > 0
    C = np.block([[balance.damping, nothing], [nothing.T, bending.damping]])
    K = np.block([[balance.stiffness, nothing], [nothing.T, bending.stiffness]])
    into = np.vstack([np.eye(6), bending.driven.T])
    for frequency in (0.0, 50.0, 300.0, 900.0):
        s = 2j * np.pi * frequency
        direct = K[:6] @ np.linalg.solve(M * s**2 + C * s + K, into)
        scale = np.outer(balance.half_range, 1 / balance.half_range)
        found = dynamics.response([frequency])[0]
        # rounding of 1e-16 through matrices of a condition of some 1e6
        assert found / scale == pytest.approx(direct / scale, abs=1e-8 * np.abs(direct / scale).max())


@pytest.mark.parametrize("internal", [1, 2])
def test_directions_that_change_nothing(internal, rng):
    n, size = 2, 2 + internal
    spring = np.eye(size) + 0.3 * rng.normal(size=(size, size))
    brake = 0.1 * np.eye(size) + 0.02 * rng.normal(size=(size, size))
    matrices = np.concatenate([spring.ravel(), brake.ravel()])

    def felt_over_applied(values: Array) -> Array:
        spring, brake = values.reshape(2, size, size)
        A = np.linalg.inv(spring)
        s = 1j * np.linspace(0.3, 3, 5)[:, None, None]
        return np.linalg.inv(np.eye(size) + s * (A @ brake) + s**2 * A)[:, :n, :n]

    rows = invariances(matrices, n, loads=np.eye(n))
    assert len(rows) == 2 * internal**2
    assert np.linalg.matrix_rank(rows, tol=1e-9 * np.linalg.norm(rows)) == 2 * internal**2
    for row in rows:
        step = 1e-5 * row / np.linalg.norm(row)
        change = felt_over_applied(matrices + step) - felt_over_applied(matrices - step)
        usual = felt_over_applied(matrices + 1e-5 * np.eye(row.size)[0]) - felt_over_applied(matrices)
        # what is left is of the third order in the step, and rounding
        assert np.abs(change).max() < 1e-4 * np.abs(usual).max()
    other, turn = renewed(matrices, n, let_go=held_states(rng.normal(size=(n, n)), size))
    assert turn[:n] == pytest.approx(np.eye(2 * size)[:n])
    response = felt_over_applied(matrices)
    assert felt_over_applied(other) == pytest.approx(response, abs=1e-8 * np.abs(response).max())


@pytest.mark.parametrize("kind", ["release", "ramp", "free"])
@pytest.mark.parametrize("anywhere", [False, True])
def test_derivatives_are_those_of_the_readings(kind, anywhere):
    rng = np.random.default_rng(3)
    n, size, time = 2, 3, np.linspace(-5, 20, 200)
    spring = np.array([[1.0, 0.1, 0.3], [0.2, 3.0, -0.2], [0.4, 0.1, 2.0]])
    matrices = np.concatenate([spring.ravel(), (0.05 * spring + 0.01).ravel()])
    edge = {"release": (0.0, 0.0), "ramp": (-0.3, 1.5), "free": (1.0, 1.0)}[kind]
    segment = Segment("", time, rng.normal(size=(200, n)), kind, edge, 1, anywhere)
    own = rng.normal(size=segment.own)
    if kind != "free":
        own[4] = 0.11
    if kind == "ramp":
        own[5] = 1.0
    whitener = whitener_of(np.array([[1.0, 0.3], [0.3, 2.0]]))

    def motion(vector: Array) -> FreeMotion:
        return FreeMotion.of(*vector[segment.own :].reshape(2, size, size), components=n)

    def residuals(vector: Array) -> Array:
        part = linearise(segment, motion(vector), vector[: segment.own], whitener=whitener, derivatives=False)
        return (np.vstack([part.held, part.ringing]) @ whitener.T).ravel()

    vector = np.concatenate([own, matrices])
    step = 1e-6
    J = np.stack([(residuals(vector - d) - residuals(vector + d)) / (2 * step) for d in step * np.eye(vector.size)], 1)
    block = linearise(segment, motion(vector), own, whitener=whitener).block
    # central differences are right to about (1e-16 / 1e-6) of the waveform and (1e-6)^2 of its third derivative
    assert block[:, :-1].T @ block[:, :-1] == pytest.approx(J.T @ J, rel=1e-6, abs=1e-7 * np.max(J.T @ J))
    assert block[:, :-1].T @ block[:, -1] == pytest.approx(J.T @ residuals(vector), abs=1e-7 * np.max(np.abs(J.T @ J)))


def test_slow_motion_and_shares():
    true = truth()
    slow = quasi_static(true)
    # F over X = 1 + D s + A s^2 + ..., so a second difference at small s gives A to the square of s over the modes
    step = 0.1
    up, here = true.inverse_response([step])[0], true.inverse_response([0.0])[0]
    s = 2 * np.pi * step
    assert here == pytest.approx(np.eye(2), abs=1e-12)
    assert -(up - here).real / s**2 == pytest.approx(slow.inertia, abs=1e-5 * np.abs(slow.inertia).max())
    assert up.imag / s == pytest.approx(slow.damping, abs=1e-5 * np.abs(slow.damping).max())
    shares = static_contributions(true.modal_form)
    assert shares.sum() == pytest.approx(2)
    assert static_contributions(rigid().modal_form) == pytest.approx([1, 1], abs=0.02)  # 1 but for the damping


def _with_a_mode_of_the_sting(inertia: Array) -> CoupledDynamics:
    """Six components with a seventh coordinate of its own at 900 Hz, known to 1e-4 and 1e-3."""
    A, D = np.zeros((2, 7, 7))
    A[:6, :6], D[:6, :6] = inertia, balance_truth().damping
    A[6, 6], D[6, 6] = (2 * np.pi * 900) ** -2.0, 0.01 / (2 * np.pi * 900)
    u = np.concatenate([(1e-4 * np.abs(A) + 1e-9 * A.max()).ravel(), (1e-3 * np.abs(D) + 1e-9).ravel()])
    return CoupledDynamics(COMPONENTS, A, D, np.diag(u**2))


def test_the_mass_below_a_mode_of_the_sting_is_that_of_the_rigid_part():
    true = balance_truth()
    rigid, notes = rigid_of(_with_a_mode_of_the_sting(true.inertia), 20.0)
    assert rigid.mass.values == pytest.approx(true.mass.values, rel=1e-6, abs=1e-7)
    assert rigid.reciprocity is None  # damping above slow motion is not looked at
    assert notes == []
    bent = true.inertia.copy()
    bent[0, 2] *= 1.5
    bent[2, 4] += 0.3 * bent[2, 2]
    (note,) = rigid_of(_with_a_mode_of_the_sting(bent), 20.0)[1]
    assert "taken from slow motion" in note
    assert "not that of a rigid mass" in note


def test_force_error_with_hidden_coordinates():
    true, sizes = truth(), 0.1 * HALF_RANGE
    weights = force_weights(true, sizes=sizes)
    for place in (0, 2, 6, 8, 11, 15):
        change = np.zeros(18)
        base = np.concatenate([true.inertia.ravel(), true.damping.ravel()])
        change[place] = 1e-6 * np.abs(base[:9] if place < 9 else base[9:]).max()
        A, D = (base + change).reshape(2, 3, 3)
        direct = true_force_error(CoupledDynamics(NAMES, A, D), true, sizes=sizes)
        predicted = np.sqrt(np.maximum(weights[:, place, place], 0)) * change[place]
        # the difference of two inverse responses carries the second order, 1e-6, and rounding
        assert direct == pytest.approx(predicted, rel=1e-3, abs=1e-6 * direct.max())


def test_a_bending_mode_is_found(rng):
    true = truth()
    fit = quietly(recordings(true, rng))
    assert fit.dynamics.internal == 1, fit.notes
    (place,) = fit.further
    assert fit.modes[place].natural_frequency == pytest.approx(true.modes[place].natural_frequency, rel=1e-3)
    table = ModeTable.of(fit.dynamics, sizes=HALF_RANGE)
    right = ModeTable.of(true, sizes=HALF_RANGE)
    error = np.array(
        [one.natural_frequency - two.natural_frequency for one, two in zip(table.modes, right.modes, strict=True)]
        + [one.damping_ratio - two.damping_ratio for one, two in zip(table.modes, right.modes, strict=True)]
    )
    u = np.sqrt(np.diag(table.covariance))
    square = float((error / u) @ np.linalg.solve(table.covariance / np.outer(u, u), error / u))
    assert chi2.ppf(NEVER / 2, 6) < square < chi2.isf(NEVER / 2, 6)
    relative = true_force_error(fit.dynamics, true, sizes=fit.applied) / fit.force_error
    assert relative.max() < norm.isf(NEVER / 4)  # at worst one deviate carries it all
    forced = quietly(recordings(true, rng), modes=2)
    assert forced.dynamics.internal == 0
    named = [re.search(r"near (\S+) Hz as the 2 modes found do not", note) for note in forced.notes]
    lacking = [float(match[1]) for match in named if match]
    # the two that ring most are found; four digits are printed of a first guess without noise to speak of
    assert lacking == [pytest.approx(true.modes[place].natural_frequency, rel=1e-3)], forced.notes


@pytest.mark.soak(first=0)
def test_a_first_guess_that_leads_nowhere_is_replaced(monkeypatch, rng):
    made = recordings(truth(), rng)
    expected = quietly(made, modes=3)
    guess_of, asked = further_coupled.guess_of, []

    def with_more(records, *, internal=0, **settings):
        asked.append(internal)
        if internal == 1:
            raise FitError("no 3 modes explain the decays")
        return guess_of(records, internal=internal, **settings)

    monkeypatch.setattr(further_coupled, "guess_of", with_more)
    fit = quietly(made, modes=3)
    assert asked == [1, 2]
    # both have come to the same best fit, to the accuracy at which a fit is settled
    for mode, other, u in zip(fit.modes, expected.modes, expected.u_natural_frequency, strict=True):
        assert mode.natural_frequency == pytest.approx(other.natural_frequency, abs=0.05 * u)
    assert fit.dynamics.internal == 1


def test_two_modes_of_the_balance_may_be_alike(rng):
    """Modes that are near each other and of one shape, both of the balance, hide no third of bending."""
    felt, rates = np.array([[1000.0, 1000.0], [50.0, -50.0]]), 2 * np.pi * np.array([100.0, 101.0])
    K = np.diag([1e8, 2.5e5, 1e6])
    size = rates * np.sqrt(np.sum(felt**2 / np.diag(K)[:2, None], axis=0))  # normal to each other over the stiffness
    M, own = (felt / size) @ (felt / size).T, 1e6 / (2 * np.pi * 200) ** 2
    shared = 0.2 * np.sqrt(own) * np.linalg.cholesky(M) @ np.ones((2, 1))
    M = np.block([[M, shared], [shared.T, np.array([[own]])]])
    true = in_loads(M, 6e-5 * K, K, np.eye(3)[:, :2], K[:2])
    fit = quietly(recordings(true, rng))
    assert fit.dynamics.internal == 1, fit.notes
    assert np.abs(fit.dynamics.poles) == pytest.approx(np.abs(true.poles), rel=1e-2)


@pytest.mark.soak(first=0)
def test_a_mode_that_is_not_linear_is_no_two(rng):
    dynamics = rigid()
    spring = np.linalg.inv(dynamics.inertia)
    brake = spring @ dynamics.damping

    def rates(_: float, state: Array) -> Array:
        stiffer = 1 + 0.05 * np.sum((state[:2] / HALF_RANGE) ** 2)
        return np.concatenate([state[2:], -stiffer * (spring @ state[:2]) - brake @ state[2:]])

    made = []
    for recording in recordings(dynamics, rng, noise=0.0):
        time, values = recording.time, np.column_stack([recording.channel(name).values for name in NAMES])
        first = np.flatnonzero(np.any(values != values[0], axis=1))[0] - 1
        held, span = np.concatenate([values[0], np.zeros(2)]), (time[first], time[-1])
        # a hundredth of the noise and less
        found = solve_ivp(rates, span, held, method="DOP853", t_eval=time[first:], rtol=1e-7, atol=1e-5)
        values[first:] = found.y[:2].T
        values += 1e-4 * HALF_RANGE * rng.normal(size=values.shape)
        channels = {name: Channel(name, values[:, i].copy(), si_unit(name)) for i, name in enumerate(NAMES)}
        made.append(Recording.from_columns(time, channels, name=recording.name))
    fit = quietly(made)
    assert fit.dynamics.internal == 0, fit.notes
    assert any("or damping is not linear" in note for note in fit.notes), fit.notes


def errors_over_u(found: CoupledDynamics, true: CoupledDynamics) -> float:
    """Sum of squares of the errors of A and D in their covariance."""
    u = np.sqrt(np.diag(found.total_covariance))
    error = np.concatenate([(found.inertia - true.inertia).ravel(), (found.damping - true.damping).ravel()])
    return float((error / u) @ np.linalg.solve(found.total_covariance / np.outer(u, u), error / u))


@pytest.mark.parametrize("noise", [0.2, 0.3])
@pytest.mark.soak(first=1)
def test_releases_that_the_noise_hides_are_refused(noise, rng):
    """Releases of half of half the range: a level that is let go in the noise was taken for a mode of 3.5 Hz."""
    with pytest.raises(FitError, match="above the noise"):
        quietly(recordings(rigid(), rng, noise=noise))


def test_ringing_without_its_release_tells_the_modes_with_true_uncertainties(rng):
    true, cut = rigid(), 200  # the releases are at 0.05 to 0.06 s, the records begin at 0.08 s
    made = [
        Recording.from_columns(
            one.time[cut:],
            {name: replace(one.channel(name), values=one.channel(name).values[cut:]) for name in NAMES},
            name=one.name,
        )
        for one in recordings(true, rng)
    ]
    found = quietly(made, modes=2)
    assert any("is not that of a clean" in note for note in found.notes)
    assert chi2.ppf(NEVER / 2, 8) < errors_over_u(found.dynamics, true) < chi2.isf(NEVER / 2, 8)


def cut_off(dynamics: CoupledDynamics, rng: np.random.Generator, readings: int) -> list[Recording]:
    """Releases that are recorded for so many readings from 0.06 s on, by which all are let go."""
    last = round(0.06 * RATE) + readings
    return [
        Recording.from_columns(
            one.time[:last],
            {name: replace(one.channel(name), values=one.channel(name).values[:last]) for name in NAMES},
            name=one.name,
        )
        for one in recordings(dynamics, rng)
    ]


def test_releases_of_a_few_periods_have_true_uncertainties(rng):
    found = quietly(cut_off(rigid(), rng, 100))  # 3.6 periods of the slower mode
    assert found.dynamics.internal == 0
    assert errors_over_u(found.dynamics, rigid()) < chi2.isf(NEVER, 8)


def test_releases_that_end_at_once_are_refused(rng):
    with pytest.raises(FitError, match="no 2 modes explain the decays"):
        quietly(cut_off(rigid(), rng, 5))


def test_more_modes_than_there_are_are_refused(rng):
    with pytest.raises(FitError, match=r"above the noise|does not settle|no 5 modes explain"):
        quietly(cut_off(rigid(), rng, 60), modes=5)


def test_what_grows_is_no_free_decay():
    """From 1 to e^150 within the record: a guess that grows by more than e^100 is made by rounding, and not taken."""
    time = np.arange(600) / RATE
    decays = [np.exp(150 * time / time[-1])[:, None] * np.cos(2 * np.pi * np.outer(time, [90.0, 140.0]))]
    guess = quick_guess(decays, rate=RATE, internal=0)
    assert guess is None or FreeMotion.of(guess.spring, guess.brake, components=2).poles.real.max() < 100 / time[-1]


@pytest.mark.parametrize("rows", [3, 40])
@pytest.mark.parametrize("nothing", [False, True], ids=["", "a column of nothing"])
def test_compressed_columns_have_the_products_of_the_whole(rows, nothing, rng):
    columns, left = rng.normal(size=(rows, 5)), rng.normal(size=(rows, 1))
    columns[:, 3] *= not nothing
    factor, part = compressed(columns, left)
    # rounding of sums of forty products
    np.testing.assert_allclose(factor.T @ factor, columns.T @ columns, atol=1e-13)
    np.testing.assert_allclose(factor.T @ part, columns.T @ left, atol=1e-13)


def test_a_rigid_model_has_no_bending_mode(rng):
    fit = quietly(recordings(rigid(), rng))
    assert fit.dynamics.internal == 0
    assert not any("bends" in note for note in fit.notes), fit.notes
    assert fit.further == ()


@pytest.mark.soak(first=0)
def test_hum_is_no_mode(rng):
    hummed = []
    for made in recordings(rigid(), rng):
        line = 3e-4 * np.sin(2 * np.pi * 50 * np.arange(made.samples) / RATE + rng.uniform(0, 6))
        channels = {
            name: replace(made.channel(name), values=made.channel(name).values + size * line)
            for name, size in RANGES.items()
        }
        hummed.append(replace(made, channels=channels))
    fit = quietly(hummed)
    assert fit.dynamics.internal == 0
    assert not any("bends" in note for note in fit.notes), fit.notes


def test_what_else_moves_near_the_modes_is_told_and_counted(rng):
    """A band of noise about the first mode, ten times the white noise there."""
    made = []
    for one in recordings(rigid(), rng):
        frequency = np.fft.rfftfreq(one.samples, 1 / RATE)
        near = np.abs(frequency / 90.0 - 1) < 0.12
        channels = {}
        for name, size in RANGES.items():
            band = np.fft.irfft(np.where(near, np.fft.rfft(rng.normal(size=one.samples)), 0), one.samples)
            values = one.channel(name).values + 10 * 1e-4 * size * band
            channels[name] = replace(one.channel(name), values=values)
        made.append(replace(one, channels=channels))
    found = quietly(made, modes=2)
    assert any("stronger than white noise in NF" in note for note in found.notes), found.notes
    # the power is known from some thirty ordinates a record, and it differs within them: half as much again
    assert errors_over_u(found.dynamics, rigid()) < 1.5 * chi2.isf(NEVER, 8)


def test_a_bending_mode_needs_all_releases(rng):
    made = recordings(truth(), rng, along=(0,))
    with pytest.raises(FitError, match=r"along every component, 2 .* there are 1"):
        quietly(made, modes=3)
    fit = quietly(made)
    assert fit.dynamics.internal == 0
    assert any("needs releases of a held load along every component" in note for note in fit.notes), fit.notes
    with pytest.raises(ValueError, match="modes must be auto or 2 to 5"):
        quietly(made, modes=1)


def test_the_command_tells_of_the_bending_mode(tmp_path, rng):
    true = truth()
    paths = []
    for made in recordings(true, rng):
        paths.append(tmp_path / f"{made.name[-2:]}.csv")
        write_recording(paths[-1], made)
    account = identify_decays(paths, tmp_path / "dynamics.json", components=NAMES, modes="auto")
    assert "mode of the model or sting" in account["summary"]
    assert [mode["of_model_or_sting"] for mode in account["fit"]["modes"]].count(True) == 1
    found = read_coupled(tmp_path / "dynamics.json")
    assert found.internal == 1
    assert found.poles.imag.max() == pytest.approx(true.poles.imag.max(), rel=1e-3)
    with pytest.raises(ValueError, match="--modes must be auto or a number"):
        identify_decays(paths, None, modes="many")
