"""Forces and moments of coupled components, on the simulated balance of six components."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.error_sources import Systematic
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.force_record import force_record
from aerobalance.estimation.forces import ForceSettings, forces_of
from aerobalance.estimation.spectra import whittle
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.linalg import covariance_root
from aerobalance.recording.recording import Recording
from aerobalance.recording.side_by_side import one_after_the_other
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_components import Release, SixSimulation
from aerobalance.simulation.six_signals import Band, broadband, random_motion
from helpers.coupled_pair import NOISE, RATE, SIZE, band, pair, recording_of, shaken

DURATION = 0.25


def _drawn(rng: np.random.Generator) -> tuple[CoupledBalance, CoupledDynamics]:
    balance = random_balance(rng)
    return balance, replace(balance.dynamics, mass=balance.mass)


def _inverse_noise(balance: CoupledBalance, rate: float) -> tuple[Array, Array]:
    """Density of the noise of the exact inverse, (m, 6), at frequencies (m,): an upper bound of the error's."""
    frequency = np.linspace(0, rate / 2, 4001)
    inverse = balance.dynamics.inverse_response(frequency)
    density = (balance.noise * balance.half_range) ** 2 / rate
    return frequency, np.real(np.einsum("mij,j,mij->mi", inverse, density, inverse.conj()))


def _broadband(
    balance: CoupledBalance, rng: np.random.Generator, duration: float = DURATION, rate: float = 25_000.0
) -> tuple[SixSimulation, float]:
    top = 1.2 * max(mode.natural_frequency for mode in balance.dynamics.modes)
    load = broadband(rng, Band(0, top), rms=0.1 * balance.half_range, period=2 * duration)
    rig = SixComponentRig(balance, applied=load, output="loads", rate=rate)
    return rig.run(duration, rng), top


def _inner(samples: int) -> slice:
    return slice(samples // 20, -(samples // 20))


def test_broadband_loads_through_all_resonances_come_back(rng) -> None:
    balance, dynamics = _drawn(rng)
    simulation, top = _broadband(balance, rng)
    found = estimate_force(simulation.recording, dynamics)
    frequency, noise = _inverse_noise(balance, simulation.recording.rate)
    inside = frequency < top
    bound = np.sqrt(2 * np.trapezoid(noise[inside], frequency[inside], axis=0))
    inner = _inner(simulation.recording.samples)
    for place, (name, estimate) in enumerate(found.items()):
        error = float(np.sqrt(np.mean((estimate.values - simulation.applied[:, place])[inner] ** 2)))
        # 1.4 is what is promised of six components; 0.225 s of a band hold 0.45 s times its width of independent
        # values, and their rms scatters by 1 / sqrt(2 * 0.45 top): four of these
        assert error < 1.4 * bound[place] * (1 + 4 / np.sqrt(0.9 * top)), name
        assert error > 0, name


@pytest.mark.threads
def test_two_threads_find_what_one_finds(rng, monkeypatch) -> None:
    """Number for number, and in the same words: no answer hangs on which component is done first."""
    monkeypatch.setattr(
        "aerobalance.estimation.force.FEWEST_FOR_THREADS", 0
    )  # of so short a record one thread would work on all
    balance, dynamics = _drawn(rng)
    run = _broadband(balance, rng)[0].recording
    together = estimate_force(run, dynamics)
    whittle._kept.clear()  # what one thread finds is not to be what two have found
    with one_after_the_other():
        alone = estimate_force(run, dynamics)
    for name, one in alone.items():
        np.testing.assert_array_equal(one.values, together[name].values)
        np.testing.assert_array_equal(one.uncertainty, together[name].uncertainty)
        assert one.budget == together[name].budget
    assert alone.doubts == together.doubts
    assert alone.assumed == together.assumed


def test_a_release_is_a_step_of_the_components_that_it_pulls(rng) -> None:
    balance, dynamics = _drawn(rng)
    pull = balance.half_range * np.array([0.3, 0.2, 0.0, 0.0, 0.1, 0.4])
    instant = 0.1 + 0.05 * rng.random()
    rig = SixComponentRig(balance, releases=(Release(load=pull, instant=instant),), output="loads")
    simulation = rig.run(DURATION, rng)
    found = estimate_force(simulation.recording, dynamics)
    for place, (name, estimate) in enumerate(found.items()):
        size, steps = pull[place], estimate.steps
        if size == 0:
            assert not steps, name
            continue
        assert len(steps) == 1, name
        # a pure step: its instant is known to a small part of a sample (0.1 is what is promised), and the plateaus
        # to 0.05 % of half range
        assert abs(steps[0].instant - instant) * simulation.recording.rate < 0.1, name
        error = estimate.values - simulation.applied[:, place]
        error[np.abs(np.arange(error.size) / simulation.recording.rate - instant) < 2 / simulation.recording.rate] = 0
        assert np.abs(error).max() < 5e-4 * balance.half_range[place], name


@pytest.mark.filterwarnings(
    "ignore:.*noise alone"
)  # what the accelerometers' noise leaves is weaker than the readings'
def test_motion_and_gravity_are_taken_off_all_components(rng) -> None:
    """No load at all on a balance whose ground end shakes and that pitches and rolls."""
    balance, dynamics = _drawn(rng)
    shaking = random_motion(rng, Band(5, 60), rms=np.array([1, 0.5, 1, 0.5, 0.5, 1]), period=2 * DURATION)
    rig = SixComponentRig(
        balance,
        base=shaking,
        pitch=lambda time: 0.1 + 0.02 * np.sin(2 * np.pi * 3 * time),
        roll=lambda time: np.full(time.shape, -0.2),
        output="loads",
    )
    simulation = rig.run(DURATION, rng)
    found = estimate_force(simulation.recording, dynamics)
    inner = _inner(simulation.recording.samples)
    felt = simulation.recording
    for name, estimate in found.items():
        left = estimate.values[inner] / estimate.uncertainty[inner]
        # the errors of neighbours go together, so only what no chance of many such records gives is refused
        assert np.abs(left).max() < 6, name
        size = float(np.std(felt.channel(name).values))
        assert float(np.std(estimate.values[inner])) < 0.2 * size, name


def test_one_component_is_the_axial_way(rng) -> None:
    """Diagonal matrices: the same forces to rounding, with steps, noise and gaps."""
    parts = [Dynamics("NF", 100.0, 1e8, 500.0), Dynamics("AF", 177.87, 3.093e7, 828.21)]
    rate, samples = 1600.0, 2400
    time = np.arange(samples) / rate
    channels = {}
    for part in parts:
        values = -900 * (1 - part.step_response(time - 0.5003)) + rng.normal(size=samples) * 2
        values[1000:1010] = np.nan
        channels[part.component] = Channel(name=part.component, values=values, unit="N")
    recording = Recording.from_columns(time, channels)
    together = estimate_force(recording, CoupledDynamics.of_components(parts))
    for part in parts:
        alone = estimate_force(recording, part).only
        other = together[part.component]
        # 1/k and M/k round once more each, 2e-16; the smoother's condition number magnifies that by up to 1e6; and
        # what is learned may fall to the other of two answers that are as likely, once in a hundred
        same = other.learned.noise == pytest.approx(alone.learned.noise, rel=1e-9)  # type: ignore[union-attr]
        limit = 1e-9 * 900 if same else 0.05 * float(alone.uncertainty.max())
        np.testing.assert_allclose(other.values, alone.values, atol=limit)
        assert [step.instant for step in other.steps] == pytest.approx([step.instant for step in alone.steps])


@pytest.mark.soak(first=0)
def test_parameters_are_felt_as_they_are_wrong(rng) -> None:
    """Matrices that are off by a draw from their covariance: the force is off by what the slopes say."""
    balance, dynamics = _drawn(rng)
    simulation, _ = _broadband(balance, rng, duration=0.1, rate=12_500.0)
    size = 1e-4 * np.sqrt(np.outer(np.diag(dynamics.inertia), np.diag(dynamics.inertia)))
    unit = np.outer(balance.half_range, 1 / balance.half_range)
    sizes = np.concatenate([(size * unit).ravel(), np.zeros(36)])
    uncertain = replace(dynamics, covariance=np.diag(sizes**2))
    found = estimate_force(simulation.recording, uncertain)
    numbers = rng.normal(size=72)
    draw = (covariance_root(uncertain.covariance, reduced=False) @ numbers)[:36]
    moved = estimate_force(
        simulation.recording, replace(uncertain, inertia=dynamics.inertia + draw.reshape(6, 6)), hum="keep"
    )
    for name, estimate in found.items():
        part = next(part for part in estimate.contributions if part.source == "dynamics")
        change = moved[name].values - estimate.values
        assert isinstance(part, Systematic)
        predicted = part.slopes @ (part.numbers @ numbers)
        rest = float(np.sqrt(np.mean((change - predicted) ** 2)))
        # with noise in common, as a short record may show it by chance, what others show of it is judged anew
        shared = (
            float(np.sqrt(np.mean(estimate.uncertainty**2))) if "other components show" in estimate.method else 0.0
        )
        # second order in 1e-4 and the noise that other matrices let through
        assert rest < 0.05 * float(np.sqrt(np.mean(predicted**2))) + estimate.noise + shared, name


@pytest.mark.soak(first=0)
def test_few_directions_of_the_parameters_are_as_uncertain_as_all(rng) -> None:
    balance, dynamics = _drawn(rng)
    band = Band(2, 1.2 * max(mode.natural_frequency for mode in dynamics.modes))
    rig = SixComponentRig(
        balance,
        applied=broadband(rng, band, rms=0.1 * balance.half_range, period=1.0),
        base=random_motion(rng, Band(2, 40), rms=np.ones(6), period=1.0),
        output="loads",
        rate=12_500.0,
    )
    size = 1e-3 * np.sqrt(np.outer(np.diag(dynamics.inertia), np.diag(dynamics.inertia)))
    unit = np.outer(balance.half_range, 1 / balance.half_range)
    sizes = np.concatenate([(size * unit).ravel(), np.zeros(36)])
    spread = np.diag((1e-3 * np.maximum(np.abs(balance.mass.values), 1e-2)) ** 2)
    uncertain = replace(dynamics, covariance=np.diag(sizes**2), mass=replace(balance.mass, covariance=spread))
    record = force_record(rig.run(DURATION, rng).recording, uncertain)
    whole, few = (forces_of(record, ForceSettings(hum="keep"), noises={}, few=one) for one in (False, True))
    for name, estimate in whole.items():
        all_of_it, part = (
            next(item for item in found[name].contributions if item.source == "dynamics") for found in (whole, few)
        )
        assert isinstance(all_of_it, Systematic)
        assert isinstance(part, Systematic)
        assert part.slopes.shape[1] < all_of_it.slopes.shape[1]
        # what is left out is a thousandth of the rms at most, in the force and before in the reading
        rms = float(np.sqrt(np.mean(all_of_it.deviation**2)))
        assert np.sqrt(np.mean((part.deviation - all_of_it.deviation) ** 2)) < 2e-3 * rms, name
        # the independent numbers are the same ones
        shared = part.slopes @ part.numbers - all_of_it.slopes @ all_of_it.numbers
        assert np.sqrt(np.mean(np.sum(shared**2, axis=1))) < 5e-3 * rms, name
        np.testing.assert_array_equal(few[name].values, estimate.values)


@pytest.mark.soak(first=0)
def test_a_gap_in_one_channel_is_bridged_by_the_dynamics(rng) -> None:
    balance, dynamics = _drawn(rng)
    simulation, _ = _broadband(balance, rng, duration=0.1)
    whole = simulation.recording
    channel = whole.channel("PM")
    values = channel.values.copy()
    values[1200:1210] = np.nan  # 0.4 ms
    broken = replace(whole, channels={**whole.channels, "PM": replace(channel, values=values)})
    found = estimate_force(broken, dynamics)
    inner = _inner(whole.samples)
    for place, (name, estimate) in enumerate(found.items()):
        error = np.abs(estimate.values - simulation.applied[:, place]) / estimate.uncertainty
        assert error[inner].max() < 6, name


def test_a_component_that_is_not_recorded_is_named(rng) -> None:
    _, dynamics = _drawn(rng)
    time = np.arange(100) / 1e3
    recording = Recording.from_columns(time, {"AF": Channel(name="AF", values=np.ones(100), unit="N")})
    with pytest.raises(FitError, match="no NF, PM, SF, YM, RM"):
        estimate_force(recording, dynamics)


def test_motion_without_a_mass_is_refused(rng) -> None:
    balance, dynamics = _drawn(rng)
    rig = SixComponentRig(balance, pitch=lambda time: 0.1 + 0.01 * time, output="loads")
    recording = rig.run(0.1, rng).recording
    with pytest.raises(FitError, match="hold no mass; their warnings say why"):
        estimate_force(recording, replace(dynamics, mass=None))


def test_a_weight_that_is_not_known_stays_in_the_forces(rng) -> None:
    balance, dynamics = _drawn(rng)
    rig = SixComponentRig(balance, pitch=lambda time: np.full(time.shape, 0.1), output="loads")
    recording = rig.run(0.1, rng).recording
    with pytest.warns(DataQualityWarning, match="weight at the steady attitude"):
        found = estimate_force(recording, replace(dynamics, mass=None))
    weight = balance.mass.weight(0.1)[0]
    for place, estimate in enumerate(found.values()):
        # the mean of 2500 readings of noise 1e-4 of half range, five times its scatter
        limit = 5 * balance.noise * balance.half_range[place] / 50
        assert abs(estimate.values.mean() - weight[place]) < limit


def test_errors_of_gain_and_zero_are_what_they_do_to_a_direct_inverse(rng):
    """A direct inverse is linear in the readings: a change of a channel changes the force in proportion."""
    dynamics = replace(pair(), mass=None)
    _, felt, _ = shaken(rng, pair(), pitching=False)
    loads = (felt + NOISE * rng.normal(size=felt.shape))[:600]

    def forces(values: Array) -> Force:
        record = recording_of(values)
        known = {"NF": (0.01, 2.0, NOISE[0]), "PM": (0.02, 0.0, NOISE[1])}
        channels = {
            name: replace(one, relative_uncertainty=gain, zero_uncertainty=zero, noise=noise)
            for (name, one), (gain, zero, noise) in zip(record.channels.items(), known.values(), strict=True)
        }
        return estimate_force(replace(record, channels=channels), dynamics, method="paper")

    plain = forces(loads)
    for place, name, deviation, change in (
        (0, "gain of NF", 0.01, [0.01, 0.0]),
        (1, "gain of PM", 0.02, [0.0, 0.02]),
    ):
        other = forces(loads * (1 + np.array(change)))
        for component in ("NF", "PM"):
            part = next(one for one in plain[component].contributions if one.name == name)
            assert np.sqrt(part.covariance[0, 0]) == pytest.approx(deviation)
            moved = other[component].values - plain[component].values
            assert part.slopes[:, 0] * deviation == pytest.approx(moved, abs=1e-9 * SIZE[place] * np.abs(moved).max())
    shifted = forces(loads + np.array([2.0, 0.0]))
    (zero,) = [one for one in plain["NF"].contributions if one.name == "zero of NF"]
    assert zero.deviation == pytest.approx(np.full(600, 2.0))
    assert shifted["NF"].values - plain["NF"].values == pytest.approx(zero.slopes[:, 0] * 2.0, rel=1e-6)


def test_a_long_gap_of_one_component_is_bridged_in_both(rng):
    dynamics = replace(pair(), mass=None)
    force, felt, _ = shaken(rng, pair(), pitching=False)
    loads = (felt + NOISE * rng.normal(size=felt.shape))[:1200]
    loads[500:760, 0] = np.nan  # so many that they are not found one by one
    found = estimate_force(recording_of(loads), dynamics)
    outside = np.r_[60:480, 780:1140]
    for place, name in enumerate(("NF", "PM")):
        score = (found[name].values - force[:1200, place]) / found[name].uncertainty
        # the mean square of some 100 independent numbers, by chance beyond this once in 1e5
        assert np.mean(score[outside] ** 2) < 1.9


@pytest.mark.parametrize("which", ["loads", "one sensor"])
@pytest.mark.soak(first=1)
def test_loads_read_while_the_moving_ground_was_not_count_as_missing(which, rng):
    """Of 12 samples the ground's motion was not recorded: the forces of them are as uncertain as they are wrong."""
    late, count, fine = 12, 2000, 8
    mass = pair().mass
    assert mass is not None
    dynamics = replace(pair(), covariance=np.zeros((8, 8)), mass=replace(mass, covariance=np.zeros((10, 10))))
    force = 0.03 * SIZE * band(rng, 250, count=fine * (count + late), rate=fine * RATE, columns=2)
    loads = dynamics.balance_load(force, interval=1 / (fine * RATE))[::fine]
    loads += NOISE * rng.normal(size=loads.shape)
    aft, up = 5 * band(rng, 250, count=count + late, rate=RATE, columns=2).T

    def recording(loads: Array, aft: Array, up: Array, of_loads: float = 0.0, of_up: float = 0.0) -> Recording:
        still = recording_of(loads, delay=of_loads)
        moving = [
            Channel("ground_acceleration", aft, "m/s^2", noise=1e-3),
            Channel("ground_acceleration_z", up, "m/s^2", noise=1e-3, delay=of_up),
        ]
        return replace(still, channels={**still.channels, **{one.name: one for one in moving}})

    loads += CoupledRecord.of(recording(loads, aft, up), dynamics).from_ground
    truth = force[::fine]
    if which == "loads":  # their first readings are of instants before the first of the sensors
        given, truth = recording(loads[:-late], aft[late:], up[late:], of_loads=late / RATE), truth[:-late]
        ends = slice(None, 100)
    else:  # what it read of the last instants has not come
        given, truth = recording(loads[late:], aft[late:], up[:-late], of_up=late / RATE), truth[late:]
        ends = slice(-100, None)
    for place, part in enumerate(estimate_force(given, dynamics).values()):
        assert np.max(np.abs((part.values - truth[:, place]) / part.uncertainty)[ends]) < 6
