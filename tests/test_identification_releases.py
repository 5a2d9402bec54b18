"""Coupled dynamics from releases: exact without noise, at the bound with it, honest where they fall short."""

import re

import numpy as np
import pytest
from scipy.stats import chi2, norm

from aerobalance.app.commands.identify_coupled import identify_decays
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.coupled.free_response import FreeMotion
from aerobalance.identification.coupled.least_squares import whitener_of
from aerobalance.identification.force_error import error_of, force_weights, true_force_error
from aerobalance.identification.free_decay.fit import identify_decay
from aerobalance.identification.from_stiffness import compare_coupled, coupled_from_stiffness
from aerobalance.identification.rigid_body import centre_agreement, rigid_mass_of
from aerobalance.identification.step_relaxation.identify import identify_releases
from aerobalance.identification.step_relaxation.model import Segment, linearise
from aerobalance.identification.step_relaxation.record import ROUNDING, release_record
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import read_coupled
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording
from helpers.releases import NEVER, RATE, SECONDS, between, errors, felt, quietly, recording
from helpers.rigid_balance import HALF_RANGE, RANGES, balance, truth
from seeds import new_seed


def releases(
    dynamics: CoupledDynamics,
    rng: np.random.Generator,
    *,
    along: tuple[str, ...] = COMPONENTS,
    noise: float = 1e-4,
    duration: float = 0.0,
) -> list[Recording]:
    """Releases of half the half range along some components."""
    made = []
    for name in along:
        held = np.where(np.array(COMPONENTS) == name, 0.5, 0.0) * HALF_RANGE
        values = felt(dynamics, held, instant=0.05 + rng.uniform(0, 0.01), duration=duration)
        values += noise * HALF_RANGE * rng.normal(size=values.shape)
        made.append(recording(values, f"release {name}"))
    return made


def departure(found: CoupledDynamics, true: CoupledDynamics) -> float:
    """Squares of the error of A and D in their covariance."""
    error = errors(found, true)
    u = np.sqrt(np.diag(found.covariance))
    return float((error / u) @ np.linalg.solve(found.covariance / np.outer(u, u), error / u))


@pytest.mark.parametrize("kind", ["release", "ramp", "free"])
def test_derivatives_are_those_of_the_readings(kind):
    rng = np.random.default_rng(3)
    n, time = 2, np.linspace(-5, 20, 200)
    matrices = np.concatenate([[1.0, 0.1, 0.2, 3.0], [0.05, 0.01, 0.0, 0.06]])
    edge = {"release": (0.0, 0.0), "ramp": (-0.3, 1.5), "free": (1.0, 1.0)}[kind]
    segment = Segment("", time, rng.normal(size=(200, n)), kind, edge)
    own = rng.normal(size=segment.own)
    if kind != "free":
        own[2 * n :] = [0.11, 1.0][: segment.own - 2 * n]
    whitener = whitener_of(np.array([[1.0, 0.3], [0.3, 2.0]]))

    def residuals(vector: Array) -> Array:
        motion = FreeMotion.of(*vector[segment.own :].reshape(2, n, n))
        part = linearise(segment, motion, vector[: segment.own], whitener=whitener, derivatives=False)
        return (np.vstack([part.held, part.ringing]) @ whitener.T).ravel()

    vector = np.concatenate([own, matrices])
    step = 1e-6
    J = np.stack([(residuals(vector - d) - residuals(vector + d)) / (2 * step) for d in step * np.eye(vector.size)], 1)
    block = linearise(segment, FreeMotion.of(*matrices.reshape(2, n, n)), own, whitener=whitener).block
    # central differences are right to about (1e-16 / 1e-6) of the waveform and (1e-6)^2 of its third derivative
    assert block[:, :-1].T @ block[:, :-1] == pytest.approx(J.T @ J, rel=1e-6, abs=1e-7 * np.max(J.T @ J))
    assert block[:, :-1].T @ block[:, -1] == pytest.approx(J.T @ residuals(vector), abs=1e-7 * np.max(np.abs(J.T @ J)))


def test_exact_without_noise(rng):
    true = truth()
    fit = quietly(releases(true, rng, along=("NF", "RM", "AF"), noise=0.0))
    error = errors(fit.dynamics, true)
    # Every step of the oracle rounds once more, which may add up over the record. An error e of all m readings,
    # however arranged, moves an element by at most e sqrt(m) u / sigma, u its uncertainty under white noise sigma.
    rounding = round(SECONDS * RATE) * np.finfo(float).eps
    allowed = np.sqrt(np.diag(fit.dynamics.covariance)) / ROUNDING * rounding * np.sqrt(fit.degrees_of_freedom)
    assert (np.abs(error) < allowed).all()
    assert allowed[:36].max() < 1e-6 * np.abs(true.inertia).max()
    assert [release.kind for release in fit.releases] == ["release"] * 3


@pytest.fixture(scope="module")
def six():
    """What six releases say, one along each component."""
    return quietly(releases(truth(), np.random.default_rng(new_seed())))


def test_error_is_that_of_the_covariance(six):
    true, fit = truth(), six
    assert between(departure(fit.dynamics, true), 72)
    # the variance of a residual that has m degrees of freedom is known to sqrt(2 / m)
    spread = norm.isf(NEVER) * np.sqrt(2 / (fit.degrees_of_freedom / 6))
    assert fit.residual_deviation / (1e-4 * HALF_RANGE) == pytest.approx(np.ones(6), abs=spread)
    square = (true_force_error(fit.dynamics, true, sizes=fit.applied) / fit.force_error) ** 2
    # at worst one direction in twelve carries it all: the square of one normal deviate
    assert square.max() < chi2.isf(NEVER / 6, 1)


@pytest.mark.soak(first=0)
def test_a_release_that_takes_time(rng):
    true = truth()
    fit = quietly(releases(true, rng, along=("NF", "RM", "AF"), duration=0.003))
    assert between(departure(fit.dynamics, true), 72)
    for release in fit.releases:
        if release.kind == "ramp":
            assert release.duration == pytest.approx(0.003, abs=2e-4)
    assert any(release.kind == "ramp" for release in fit.releases)


def test_a_release_soon_after_the_record_begins_is_found(rng):
    """Where some thirty readings are held at most, they are too few to sharpen the instant by."""
    (whole,) = releases(truth(), rng, along=("NF",))
    instant = release_record(whole, COMPONENTS).onset
    for cut in (instant - 32, instant - 24):
        found = release_record(whole.part(cut, whole.samples), COMPONENTS)
        assert abs(found.onset - (instant - cut)) <= 4  # the readings that a free decay begins after an onset


@pytest.mark.soak(first=0)
def test_a_blow_is_used_from_where_it_decays_freely(rng):
    true = truth()
    time = np.arange(round(SECONDS * RATE)) / RATE
    made = []
    for place, name in ((0, "NF"), (3, "YM"), (5, "AF")):
        net = np.zeros((time.size, 6))
        net[:, place] = np.where((time >= 0.05) & (time < 0.052), 2.0, 0.0) * HALF_RANGE[place]
        values = true.balance_load(net, interval=1 / RATE) + 1e-4 * HALF_RANGE * rng.normal(size=net.shape)
        made.append(recording(values, name))
    fit = quietly(made)
    assert any("not that of a clean release" in note for note in fit.notes), fit.notes
    assert [release.kind for release in fit.releases] == ["free"] * 3
    assert all(release.instant > 0.052 - 1 / RATE for release in fit.releases)
    assert between(departure(fit.dynamics, true), 72)


def test_one_component_is_the_fit_of_a_decay(rng):
    one = Dynamics("AF", 20.0, 20.0 * (2 * np.pi * 90) ** 2, 2 * 0.02 * 20.0 * 2 * np.pi * 90)
    values = felt(CoupledDynamics.of_components([one]), np.array([250.0]), instant=0.0523)
    values += 0.05 * rng.normal(size=values.shape)
    record = recording(values, "one", ("AF",))
    many = identify_releases([record], components=("AF",))
    single = identify_decay(record, mass=20.0).dynamics
    u = np.sqrt(np.diag(many.dynamics.covariance))
    # two fits of one model to the same readings, which alone differ by the drift that the decay's fit has beside it
    assert many.dynamics.inertia[0, 0] == pytest.approx(single.mass / single.stiffness, abs=u[0])
    assert many.dynamics.damping[0, 0] == pytest.approx(single.damping / single.stiffness, abs=u[1])


def test_a_release_that_leaves_components_at_rest_is_refused(rng):
    parts = [
        Dynamics(name, 20.0, 20.0 * (2 * np.pi * f) ** 2, 0.02 * 20.0 * 2 * np.pi * f)
        for name, f in (("NF", 80.0), ("SF", 120.0), ("AF", 210.0))
    ]
    apart = CoupledDynamics.of_components(parts)
    held = np.array([1000.0, 0.0, 0.0])
    values = felt(apart, held, instant=0.0512) + rng.normal(0, 0.1, (round(SECONDS * RATE), 3))
    with pytest.raises(FitError, match=r"no release moves (SF nor AF|AF nor SF).*add a release along (SF|AF)"):
        identify_releases([recording(values, "NF", ("NF", "SF", "AF"))], components=("NF", "SF", "AF"))


def test_the_mode_that_is_not_excited_is_named(rng):
    true = truth()
    vectors = np.linalg.eig(true.inertia)[1] / HALF_RANGE[:, None]  # undamped modes in loads over half of range
    others = np.delete(vectors, int(np.argmax(np.abs(vectors[2]))), axis=1)
    missing = np.linalg.svd(others)[0][:, -1]  # what sets off the mode that is largest in SF, and no other
    assert COMPONENTS[int(np.argmax(np.abs(missing)))] == "SF"
    made = []
    for _ in range(2):
        held = rng.normal(size=6)
        held -= missing * (missing @ held)
        values = felt(true, 0.4 * HALF_RANGE * held / np.abs(held).max(), instant=0.0513)
        made.append(recording(values + 1e-4 * HALF_RANGE * rng.normal(size=values.shape), "odd"))
    with pytest.raises(FitError, match=r"SF.*add a release along SF"):
        quietly(made)
    # with a little of it in one release, the result says what is weak and what to add
    values = felt(true, 0.4 * HALF_RANGE * (held / np.abs(held).max() + 0.001 * missing), instant=0.0513)
    made[1] = recording(values + 1e-4 * HALF_RANGE * rng.normal(size=values.shape), "odd")
    with pytest.warns(DataQualityWarning) as caught:
        fit = identify_releases(made, half_range=RANGES)
    told = [str(warning.message).partition(": ")[2] for warning in caught]
    assert told == list(fit.notes)
    best = fit.advice.best
    assert any(re.search(rf"least excited.*by SF.*a release along {best} of", text) for text in told), told
    better = quietly([*made, *releases(true, rng, along=(best,))])
    # the same information but for the instant and the noise drawn, and for errors of a weak mode of some 5 %
    assert better.force_error == pytest.approx(fit.advice.errors[COMPONENTS.index(best)], rel=0.3)


def test_rigid_mass_from_the_inertia_matrix(rng):
    true = truth()
    fit = quietly(releases(true, rng, along=("NF", "SF", "RM", "AF")), mass=(20.02, 0.02))
    assert fit.rigid is not None
    assert fit.dynamics.mass is fit.rigid.mass
    found, right = fit.rigid.mass, true.mass
    error = np.concatenate([[20.02 - 20.0], found.centre - right.centre, (found.values - right.values)[4:]])
    # the nine that are identified; the mass itself is given and its error is known
    u = np.sqrt(np.diag(found.covariance))
    error -= found.covariance[:, 0] / found.covariance[0, 0] * 0.02
    rest = found.covariance - np.outer(found.covariance[0], found.covariance[0]) / found.covariance[0, 0]
    scaled = (rest / np.outer(u, u))[1:, 1:]
    assert between(float((error / u)[1:] @ np.linalg.solve(scaled, (error / u)[1:])), 9)
    assert fit.rigid.rigidity.p_value > NEVER
    assert fit.rigid.reciprocity.p_value > NEVER
    agreement = centre_agreement(found, right.centre, covariance=np.zeros((3, 3)))
    assert agreement.p_value > NEVER
    off = centre_agreement(found, right.centre + 0.01, covariance=np.diag([1e-4] * 3) ** 2)
    assert not off.chance
    # what is constrained is symmetric, and no less certain
    K = np.linalg.solve(fit.rigid.constrained.inertia, fit.rigid.constrained.mass.matrix)
    assert pytest.approx(K.T, rel=1e-6, abs=1e-9 * np.abs(K).max()) == K
    less = np.diag(fit.rigid.constrained.covariance) / np.diag(fit.dynamics.covariance)
    assert (less < 1 + 1e-6).all()
    assert less.min() < 0.9


def test_what_is_not_rigid_or_not_reciprocal_is_told(rng):
    true = truth()
    bent = true.inertia.copy()
    bent[0] *= 1.01  # NF moves a live end 1 % heavier: no rigid mass
    along = ("NF", "RM", "AF")
    fit = quietly(releases(CoupledDynamics(COMPONENTS, bent, true.damping), rng, along=along), mass=20.0)
    assert not fit.rigid.rigidity.chance
    gyroscopic = true.damping.copy()
    gyroscopic[0, 1] += 0.5 * true.damping[0, 0] * HALF_RANGE[0] / HALF_RANGE[1]
    fit = quietly(releases(CoupledDynamics(COMPONENTS, true.inertia, gyroscopic), rng, along=along), mass=20.0)
    assert not fit.rigid.reciprocity.chance
    assert any("the damping is not symmetric" in note for note in fit.notes), fit.notes


def test_exact_dynamics_give_the_exact_mass():
    true = truth()
    fit = rigid_mass_of(true, 20.0, u_mass=0.2)
    # rounding of 1e-16 through the condition of the equations, some 1e5
    assert fit.mass.values == pytest.approx(true.mass.values, rel=1e-9, abs=1e-10)
    assert fit.mass.covariance[0, 0] == pytest.approx(0.04)
    assert fit.mass.covariance[4, 0] == pytest.approx(0.2 * 0.2 * true.mass.inertia[0, 0] / 20.0, rel=1e-6)
    assert fit.rigidity is None


def test_dynamics_from_stiffness_agree_with_those_from_releases(six):
    mass, stiffness, _ = balance()
    ratios = [0.004, 0.01, 0.02, 0.006, 0.03, 0.015]
    known = coupled_from_stiffness(stiffness, mass, damping_ratios=ratios, u_stiffness=1e-4 * np.abs(stiffness))
    true = truth()
    assert known.inertia == pytest.approx(true.inertia, rel=1e-9)
    assert known.damping == pytest.approx(true.damping, rel=1e-6, abs=1e-9 * np.abs(true.damping).max())
    # d(M K^-1) = -M K^-1 dK K^-1, with one element of K moved by its uncertainty at a time
    square = np.zeros((6, 6))
    inverse = np.linalg.inv(stiffness)
    for i in range(6):
        for j in range(i + 1):
            change = np.zeros((6, 6))
            change[i, j] = change[j, i] = 1e-4 * abs(stiffness[i, j])
            square += (true.inertia @ change @ inverse) ** 2
    assert np.sqrt(np.diag(known.covariance))[:36] == pytest.approx(np.sqrt(square).ravel(), rel=1e-4)
    rows = compare_coupled(six.dynamics, known)
    assert len(rows) == 72
    assert max(abs(row.ratio) for row in rows) < norm.isf(NEVER / 144)
    with pytest.raises(ValueError, match="symmetric"):
        coupled_from_stiffness(np.triu(stiffness), mass, damping_ratios=0.01)


def test_force_error_is_the_mean_over_the_covariance():
    true = truth()
    u = 1e-5 * np.concatenate([np.abs(true.inertia).ravel(), np.abs(true.damping).ravel()])
    doubtful = CoupledDynamics(COMPONENTS, true.inertia, true.damping, np.diag(u**2))
    sizes = 0.1 * HALF_RANGE
    predicted = error_of(doubtful.covariance, force_weights(doubtful, sizes=sizes, band=(10.0, 300.0)))
    frequency = np.linspace(10, 300, 60_001)
    s = 2j * np.pi * frequency
    response = true.response(frequency) * sizes
    first = np.mean(np.abs(s[:, None, None] * response) ** 2, axis=0).sum(axis=1)
    second = np.mean(np.abs(s[:, None, None] ** 2 * response) ** 2, axis=0).sum(axis=1)
    direct = np.sqrt((u[:36] ** 2).reshape(6, 6) @ second + (u[36:] ** 2).reshape(6, 6) @ first)
    assert predicted == pytest.approx(direct, rel=1e-3)  # a sum in 60ths of the narrowest half width
    with pytest.raises(ValueError, match="band"):
        force_weights(true, sizes=sizes, band=(5.0, 5.0))
    with pytest.raises(ValueError, match="sizes"):
        force_weights(true, sizes=[1.0])


def test_the_command_writes_what_it_found(tmp_path, rng):
    parts = [
        Dynamics(name, 20.0, 20.0 * (2 * np.pi * f) ** 2, 0.02 * 20.0 * 2 * np.pi * f)
        for name, f in (("NF", 80.0), ("AF", 210.0))
    ]
    true = CoupledDynamics.of_components(parts)
    paths = []
    for place, name in enumerate(("NF", "AF")):
        held = np.where(np.arange(2) == place, 300.0, 0.0)
        values = felt(true, held, instant=0.0512) + rng.normal(0, 0.05, (round(SECONDS * RATE), 2))
        paths.append(tmp_path / f"{name}.csv")
        write_recording(paths[-1], recording(values, name, ("NF", "AF")))
    account = identify_decays(paths, tmp_path / "dynamics.json", components=("NF", "AF"))
    found = read_coupled(tmp_path / "dynamics.json")
    assert between(departure(found, true), 8)
    assert account["components"] == ["NF", "AF"]
    assert account["fit"]["degrees_of_freedom"] > 1000
    for mode, fitted in zip(account["modes"], account["fit"]["modes"], strict=True):
        for name in ("natural_frequency", "damping_ratio"):
            assert mode[name] == fitted[name]["value"]
            assert mode[f"u_{name}"] == pytest.approx(fitted[name]["u"], rel=1e-12)
    text = account["summary"]
    for part in ("Modes", "A (inertia)", "D (damping)", "Releases", "Force error", "NF.csv", "would help most along"):
        assert part in text, (part, text)
    with pytest.raises(ValueError, match="positive number"):
        identify_decays(paths, None, mass="-1")


def test_noise_alone_and_too_few_readings_are_refused(rng):
    nothing = recording(rng.normal(size=(1000, 6)), "calm")
    with pytest.raises(FitError, match="nothing rings"):
        identify_releases([nothing])
    with pytest.raises(FitError, match="needs many more"):
        identify_releases([recording(rng.normal(size=(20, 6)), "short")])
    with pytest.raises(FitError, match="no channel AF"):
        identify_releases([recording(rng.normal(size=(1000, 1)), "one", ("NF",))], components=("NF", "AF"))
    still = rng.normal(size=(1000, 2))
    still[:, 1] = 3.0
    with pytest.raises(FitError, match="readings of AF never change"):
        identify_releases([recording(still, "still", ("NF", "AF"))], components=("NF", "AF"))


def test_wrong_calls(rng):
    record = recording(rng.normal(size=(1000, 6)), "calm")
    with pytest.raises(ValueError, match="at least one"):
        identify_releases([])
    with pytest.raises(ValueError, match="components"):
        identify_releases([record], components=("NF", "XX"))
    with pytest.raises(ValueError, match="mass matrix"):
        identify_releases([record], components=("NF",), mass=1.0)
    with pytest.raises(ValueError, match="half_range"):
        identify_releases([record], half_range={"NF": 1.0})
    with pytest.raises(ValueError, match="release_share"):
        identify_releases([record], release_share=0.0)
    with pytest.raises(ValueError, match="all of NF"):
        rigid_mass_of(CoupledDynamics(("NF",), np.eye(1), 0.1 * np.eye(1)), 1.0)
