"""Friction and damping that is not linear show above the band of the load; linear balances show neither."""

import numpy as np
import pytest

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.not_linear import all_along, friction_of, not_linear
from aerobalance.estimation.checks.step_ringing import friction_by_steps
from aerobalance.estimation.observation import Observation
from faults.cases import all_cases, dynamics
from faults.scene import Scene, band, step, together
from faults.trials import of_one, scores, trial, worked_out
from seeds import trials

MASS, FREQUENCY, RATIO, RATE, NOISE, COUNT = 177.87, 66.4, 0.006, 1600.0, 2.0, 4000
OMEGA = 2 * np.pi * FREQUENCY
T128 = Dynamics("AF", MASS, MASS * OMEGA**2, 2 * RATIO * MASS * OMEGA)


def banded(rng, *, rms, edge, count=COUNT):
    """A Gaussian load, flat up to an edge."""
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    spectrum = np.where(frequency < edge, np.fft.rfft(rng.standard_normal(count)), 0.0)
    load = np.fft.irfft(spectrum, count)
    return rms * load / load.std()


def read(load, rng):
    """What a linear balance reads of a load, cut out of a longer record."""
    response = T128.response(np.fft.rfftfreq(load.size, 1 / RATE))
    felt = np.fft.irfft(response * np.fft.rfft(load), load.size)
    return Observation(felt[load.size // 4 :][:COUNT] + NOISE * rng.standard_normal(COUNT), 1 / RATE, T128)


def is_found(shown):
    """Whether it is more than left open."""
    return shown is not None and shown.probability == 1


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("friction 5 N, 0-100 Hz", "friction"),
        ("damping +50 % at 1 kN, 0-100 Hz", "damping that grows with the deflection"),
    ],
)
def test_what_is_not_linear_is_named_and_counted(name, kind):
    (case,) = (one for one in all_cases() if one.name == name)
    record, dynamics = case.record(0), case.known(0)
    force, _ = worked_out(record, dynamics, case.settings)
    (doubt,) = (one for one in force.doubts if one.kind == "not linear")
    assert kind in doubt.text
    assert force.verdict == "doubtful"
    found = scores(*of_one(force), record.force)
    # without it the uncertainty is a sixth or less of the error; four deviations tell the size to a quarter
    assert 0.5 < doubt.effect / found["error"] < 1.5
    assert found["error"] < 1.5 * found["u"]
    assert found["cover"] > 0.85


# of the first record the evidence of a mode tells no share; of the second and third something else is not explained
@pytest.mark.parametrize(("share", "seed"), [(1, 7), (5, 6), (1, 6), (1, 0), (5, 0), (5, 19)])
@pytest.mark.soak(first=0)
def test_a_spring_that_hardens_is_no_further_mode(share, seed):
    (case,) = (one for one in all_cases() if one.name == f"hardening {share} % at 2 kN, 0-100 Hz")
    record, dynamics = case.record(seed), case.known(seed)
    force, _ = worked_out(record, dynamics, case.settings)
    (doubt,) = (one for one in force.doubts if one.kind == "not linear")
    assert "stiffness" in doubt.text
    assert not {one.kind for one in force.doubts} & {"missing mode", "natural frequency", "damping ratio"}
    found = scores(*of_one(force), record.force)
    # Most of the error is what the spring's third harmonic asks for, of which the smoother takes a part for noise: u,
    # which counts all of it, is more. Less than half would be another spring's.
    assert 0.5 < found["u"] / found["error"] < 2.0


def test_what_half_of_a_record_shows_is_not_all_along():
    """Where the spring is linear in the second half, two parts of four show nothing."""
    (case,) = (one for one in all_cases() if one.name == "hardening 5 % at 2 kN, 0-100 Hz")
    (linear,) = (one for one in all_cases() if one.name == "0-100 Hz, 200 N")
    dynamics, bent, sound = case.known(0), *(one.record(0).columns["AF"] for one in (case, linear))
    half = bent.size // 2
    reading = Observation(bent, 1 / RATE, dynamics)
    mixed = Observation(np.concatenate([bent[:half], sound[half:]]), 1 / RATE, dynamics)
    shown = [not_linear(one, dynamics) for one in (reading, mixed)]
    assert all(one is not None and one.of_spring for one in shown)
    assert all_along(reading, dynamics, shown[0])
    assert not all_along(mixed, dynamics, shown[1])


def test_friction_has_its_size():
    (case,) = (one for one in all_cases() if one.name == "friction 5 N, 0-100 Hz")
    load = case.record(0).columns["AF"]
    found = not_linear(Observation(load, 1 / RATE, case.known(0)), case.known(0))
    assert found is not None
    assert abs(found.size - 5.0) < 4 * found.u


@pytest.mark.parametrize(("size", "seed"), [(5.0, 4), (0.5, 1)])
@pytest.mark.soak(first=1)
def test_friction_is_told_by_how_the_ringing_after_a_step_dies_away(size, seed):
    (case,) = (one for one in all_cases() if one.name == f"friction {size:g} N, step")
    record, dynamics = case.record(seed), case.known(seed)
    force, _ = worked_out(record, dynamics, case.settings)
    assert {one.kind for one in force.doubts} == {"not linear"}
    told = friction_by_steps(
        Observation(record.columns["AF"], 1 / RATE, dynamics), force.only.steps, force.only.learned
    )
    assert told is not None
    # the sign of the speed is read as if the load did not move beside the ringing: its last tenth is not the law's
    assert told[0] == pytest.approx(size, abs=4 * told[1] + 0.1 * size)
    found = scores(*of_one(force), record.force)
    # it acts on the slow motion as well, so that the error is no less than a half of it, and u counts all of it
    assert found["cover"] > 0.95
    assert found["error"] < 1.2 * found["u"]


@pytest.mark.parametrize("name", ["damping 20 %, step, 2.5 s", "mode at 1.05 f0, 3 %, step, 2.5 s", "two steps"])
@pytest.mark.soak(first=1)
def test_ringing_that_dies_away_otherwise_shows_no_friction(name):
    (case,) = (one for one in all_cases() if one.name == name)
    force, _ = worked_out(case.record(0), case.known(0), case.settings)
    reading = Observation(case.record(0).columns["AF"], 1 / RATE, case.known(0))
    told = friction_by_steps(reading, force.only.steps, force.only.learned)
    assert told is None or told[0] < 4 * told[1]


def test_friction_that_is_nearly_chance_is_left_open():
    # a log-likelihood that is 8 higher is no chance, which four standard uncertainties are; from 4 on it is left open
    assert friction_of(4.01, 1.0, T128).probability == 1
    assert friction_of(3.0, 1.0, T128).probability == pytest.approx(1 / (1 + np.exp(0.8 * (8 - 2.5 - 4.5))))
    assert friction_of(2.8, 1.0, T128) is None
    assert friction_of(-9.0, 1.0, T128) is None


def test_a_linear_balance_shows_none(rng):
    # one in ten thousand by chance, so two of these thirty in one run of two hundred thousand
    edges = rng.uniform(20.0, 200.0, 30)
    loads = [banded(rng, rms=10 ** rng.uniform(0.5, 3.0), edge=edge, count=2 * COUNT) for edge in edges]
    assert sum(is_found(not_linear(read(load, rng), T128)) for load in loads) <= 1


@pytest.mark.parametrize("edge", [40.0, 90.0])
def test_noise_of_a_color_is_none(edge, rng):
    load = banded(rng, rms=200.0, edge=edge, count=2 * COUNT)
    reading = read(load, rng)
    hump = banded(rng, rms=3.0, edge=350.0) - banded(rng, rms=1.0, edge=250.0)
    reading = Observation(reading.values + hump, 1 / RATE, T128)
    assert not is_found(not_linear(reading, T128))


def test_harmonics_of_a_rotor_are_none(rng):
    base = banded(rng, rms=20.0, edge=30.0, count=2 * COUNT)
    time = np.arange(2 * COUNT) / RATE
    phase = rng.uniform(0, 2 * np.pi, 6)
    rotor = sum(100.0 / k**2 * np.cos(2 * np.pi * 23.7 * k * time + phase[k - 1]) for k in range(1, 7))
    assert not is_found(not_linear(read(base + rotor, rng), T128))


def test_too_short_a_record_tells_nothing(rng):
    values = read(banded(rng, rms=200.0, edge=90.0, count=2 * COUNT), rng).values[:200]
    assert not_linear(Observation(values, 1 / RATE, T128), T128) is None


@pytest.mark.parametrize("seed", [2, 9])
@pytest.mark.soak(first=0)
def test_friction_whose_best_lag_is_chance_counts(seed):
    """Its match is best a third of a period late, by 1.2 and 2.7 in log-likelihood: no lag refutes the other."""
    (case,) = [case for case in all_cases() if case.name == "friction 5 N, 0-100 Hz"]
    found = trial((case, seed))
    assert found["error"] < 3 * found["u"]  # it was 6 u, and fit for use


@pytest.mark.soak(first=0)
def test_ringing_after_a_step_read_with_little_noise_is_that_of_a_linear_spring():
    """Least squares takes some of a slow force for the height of a step: the ringing that is left is no spring."""
    scene = Scene(together(step(500.0), band(10.0, 0, 30)), noise=0.02)
    for seed in range(trials(1, 4)):  # that of the first was doubted
        record = scene.record(np.random.default_rng(seed))
        force, said = worked_out(record, dynamics(), {})
        assert not said
        assert not force.doubts
