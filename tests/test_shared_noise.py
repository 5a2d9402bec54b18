"""Noise that decoupled components have in common: the algebra, what is left, and the forces that are the better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.modal import EquivalentModel, Mode
from aerobalance.estimation.component_force import Fitted
from aerobalance.estimation.correlated_noise import UNSEEN, NoiseMatrix, SharedNoise, filtered, shared_noise
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.forces import predicted_noise
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import si_unit
from aerobalance.recording.recording import Recording
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.sensors import Sensor
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_components import SixSimulation
from aerobalance.simulation.six_signals import Band, broadband
from aerobalance.uncertainty.monte_carlo import monte_carlo

DURATION = 0.5
SOFT = Band(0, 200, order=2)
WORTH = 0.8
"""Expected error over that of the component by itself in some component of the balances that are tried."""


def _density(balance: CoupledBalance, frequency: Array) -> Array:
    """Two-sided densities of the soft loads, shape (m, 6)."""
    return np.maximum(SOFT.density(frequency)[:, None] / 2, 1e-15) * (0.1 * balance.half_range) ** 2


def _bounds(balance: CoupledBalance, rate: float) -> tuple[Array, Array]:
    """Rms error of the best estimate from each component's row of the inverse, and from all channels, (6,) each."""
    frequency = np.linspace(0, rate / 2, 4001)
    inverse = balance.dynamics.inverse_response(frequency)
    white = np.diag((balance.noise * balance.half_range) ** 2 / rate)
    noise = inverse @ white @ inverse.conj().transpose(0, 2, 1)
    force = _density(balance, frequency)
    own = np.real(np.einsum("mii->mi", noise))
    whole = noise + force[:, :, None] * np.eye(6)
    joint = force - force**2 * np.real(np.einsum("mii->mi", np.linalg.inv(whole)))
    step = 2 * float(frequency[1])
    return np.sqrt(step * np.sum(force * own / (force + own), axis=0)), np.sqrt(step * np.sum(joint, axis=0))


def _soft_loads(rng: np.random.Generator) -> tuple[CoupledBalance, SixSimulation]:
    """A balance on which sharing is worth while, under loads that fall off softly."""
    while True:
        balance = random_balance(rng)
        row, joint = _bounds(balance, 25_000.0)
        if (joint / row).min() < WORTH:
            break
    load = broadband(rng, SOFT, rms=0.1 * balance.half_range, period=2 * DURATION)
    return balance, SixComponentRig(balance, applied=load, output="loads").run(DURATION, rng)


def _record(balance: CoupledBalance, simulation: SixSimulation) -> tuple[CoupledRecord, dict[str, SharedNoise]]:
    record = CoupledRecord.of(simulation.recording, balance.dynamics)
    fits = {name: Fitted.of(one, hum="keep") for name, one in record.component_records(record.loads).items()}
    return record, predicted_noise(fits, record, filled=record.loads)


def _random_matrix(rng: np.random.Generator) -> NoiseMatrix:
    """Spectra of three components whose forces are all seen."""
    mixed = rng.normal(size=(5, 3, 3)) + 1j * rng.normal(size=(5, 3, 3))
    whole = (mixed @ mixed.conj().transpose(0, 2, 1) + 0.1 * np.eye(3)).transpose(1, 2, 0)
    return NoiseMatrix(
        models=tuple(EquivalentModel(name, Mode(16.0, 0.005)) for name in ("NF", "PM", "AF")),
        frequency=np.linspace(0, 1, 5),
        whole=whole,
        own=whole,
        force=rng.uniform(1, 100, (5, 3)) * np.real(np.einsum("jjm->mj", whole)),
        gain=np.ones((5, 3)),
    )


def test_what_is_left_is_the_best_of_all_channels(rng) -> None:
    spectra = _random_matrix(rng)
    inverse = np.linalg.inv(spectra.whole.transpose(2, 0, 1) + spectra.force[:, :, None] * np.eye(3))
    for place in range(3):
        others = [other for other in range(3) if other != place]
        weights, left, least = spectra.left_of(place, others)
        # S (S + E)^-1 z, row by row, is S / (S + left) of z_i - B z_o: the inverse of a matrix in blocks
        diagonal = np.real(inverse[:, place, place])
        np.testing.assert_allclose(left, 1 / diagonal - spectra.force[:, place], rtol=1e-9)
        expected = -inverse[:, place, others] / diagonal[:, None]
        np.testing.assert_allclose(weights, expected, rtol=1e-9, atol=1e-12)
        unseen = np.linalg.inv(spectra.own.transpose(2, 0, 1))
        np.testing.assert_allclose(least, 1 / np.real(unseen[:, place, place]), rtol=1e-9)
        assert (least <= left).all()


def test_a_force_that_is_not_seen_may_still_be_there(rng) -> None:
    spectra = _random_matrix(rng)
    silent = replace(spectra, force=np.zeros_like(spectra.force))
    np.testing.assert_allclose(silent.felt, UNSEEN * np.real(np.einsum("jjm->mj", spectra.whole)))


def test_filters_are_centred_sums(rng) -> None:
    weights, series = rng.normal(size=(7, 2)), rng.normal(size=(40, 2))
    expected = sum(np.convolve(series[:, k], weights[:, k])[3:-3] for k in range(2))
    np.testing.assert_allclose(filtered(weights, series), expected, atol=1e-12)


def test_noise_response_is_that_of_the_filters(rng) -> None:
    balance = random_balance(rng)
    simulation = SixComponentRig(balance, output="loads").run(0.02, rng)
    record = CoupledRecord.of(simulation.recording, balance.dynamics)
    rate, count = 25_000.0, 400_000
    frequency = rate / (count // 10) * round(rng.uniform(40, 900) * (count // 10) / rate)
    time = np.arange(count) / rate
    for decoupled in record.decoupled:
        sines = np.zeros((count, 6))
        channel = int(rng.integers(6))
        sines[:, channel] = balance.half_range[channel] * np.sin(2 * np.pi * frequency * time)
        expected = balance.half_range[channel] * decoupled.noise_response(np.array([frequency]))[0, channel]
        # at the end, when free motion has died away
        late = slice(-count // 10, None)
        read = decoupled.reading(sines, interval=1 / rate)[late]
        found = 2j * np.mean(read * np.exp(-2j * np.pi * frequency * time[late]))
        size = abs(expected) + 1e-6 * balance.half_range[decoupled.place]
        assert abs(found - expected) < 1e-3 * size


@pytest.mark.soak(first=0)
def test_soft_loads_come_back_as_from_all_channels(rng) -> None:
    balance, simulation = _soft_loads(rng)
    row, joint = _bounds(balance, simulation.recording.rate)
    _, shared = _record(balance, simulation)
    found = estimate_force(simulation.recording, balance.dynamics, hum="keep")
    inner = slice(simulation.recording.samples // 20, -(simulation.recording.samples // 20))
    for place, (name, estimate) in enumerate(found.items()):
        if joint[place] > WORTH * row[place]:
            continue
        error = (estimate.values - simulation.applied[:, place])[inner]
        # the bound of one record scatters by 1 / sqrt(4 T B) with a band B of some 1000 Hz, 2 %; the spectrum has
        # to be learned as well, which costs up to 10 %
        assert np.sqrt(np.mean(error**2)) < 1.25 * joint[place], f"{name}"
        # what is expected of it may have been missed by what might be there unseen
        assert 0.97 * joint[place] < shared[name].error * row[place] < 1.25 * joint[place], f"{name}"
        covered = float(np.mean(np.abs(error) < 1.96 * estimate.uncertainty[inner]))
        assert 0.88 < covered < 0.995, f"{name}"
        assert "other components show" in estimate.method
        assert estimate.shared is not None
        # it is judged from the upper half of the spectrum: n / 4 powers, each as uncertain as it is large, so five
        # standard deviations are 5 / sqrt(n); a soft load still puts up to a percent there
        off = 5 / np.sqrt(simulation.recording.samples) + 0.01
        assert estimate.noise == pytest.approx(balance.noise * balance.half_range[place], rel=off)


def test_what_is_left_is_as_noisy_as_said(rng) -> None:
    """Taken off a record of noise alone, whatever the forces of the record that the filters are for."""
    balance, simulation = _soft_loads(rng)
    record, shared = _record(balance, simulation)
    calm = SixComponentRig(balance, applied=lambda time: np.zeros((time.size, 6)), output="loads")
    noise = calm.run(DURATION, rng).recording
    readings = np.column_stack([noise.channel(name).values for name in balance.dynamics.components])
    readings = readings - readings.mean(axis=0)
    for name, one in shared.items():
        place = balance.dynamics.components.index(name)
        z = {other: record.decoupled[other].reading(readings, interval=1 / 25_000) for other in (place, *one.others)}
        left = z[place] - filtered(one.weights, np.column_stack([z[other] for other in one.others]))
        power = np.abs(np.fft.rfft(left * np.hanning(left.size))) ** 2 / (25_000 * np.sum(np.hanning(left.size) ** 2))
        frequency = np.fft.rfftfreq(left.size, 1 / 25_000)
        said = one.white**2 / 25_000 + one.color.density(frequency)
        # white noise n of the channels is (r_i - B r_o) n in what is left: r the rows of the inverse, B the filters
        shift = np.exp(2j * np.pi * frequency * (len(one.weights) // 2) / 25_000)[:, None]
        taken = shift * np.fft.rfft(one.weights, left.size, axis=0)
        rows = {other: record.decoupled[other].noise_response(frequency) for other in z}
        rest = rows[place] - sum(by[:, None] * rows[other] for by, other in zip(taken.T, one.others, strict=True))
        expected = np.abs(rest) ** 2 @ (balance.noise * balance.half_range) ** 2 / 25_000
        for low, high in ((300, 1000), (1000, 2000), (2000, 5000)):
            band = (frequency > low) & (frequency < high)
            ratio = float(np.mean(power[band]) / np.mean(said[band]))
            # at most what is said, as what may be there unseen is not; beside the scatter of some 350 ordinates
            assert ratio < 1.3, f"{name}, {low}-{high} Hz"
            # a power scatters by itself, and a Hann window makes neighbours share: 1 + 2 (4/9 + 1/36) in the variance
            share = expected[band] / np.sum(expected[band])
            scatter = np.sqrt((1 + 2 * (4 / 9 + 1 / 36)) * np.sum(share**2))
            assert np.sum(power[band]) / np.sum(expected[band]) == pytest.approx(1, abs=5 * scatter), name


@pytest.fixture
def two_with_shared_noise(rng) -> tuple[Recording, CoupledDynamics]:
    """Two coupled components whose noise is shared, and dynamics that are known to 0.02 % and 2 %."""
    w, unit = 2 * np.pi * np.array([300.0, 80.0]), np.outer([1000.0, 50.0], [1 / 1000, 1 / 50])
    # where the second row has nothing of the first component, it has no noise that the first one's predicts
    second = rng.choice([-1, 1]) * rng.uniform(0.1, 0.2)
    inertia = np.array([[1.0, rng.uniform(1, 2)], [second, 1.0]]) / np.outer(w, w) * unit
    damping = np.array([[0.03, 0.01], [0.01, 0.05]]) / np.sqrt(np.outer(w, w)) * unit
    deviation = np.concatenate([2e-4 * np.abs(inertia).ravel(), 2e-2 * np.abs(damping).ravel()])
    known = CoupledDynamics(("NF", "PM"), inertia, damping, np.diag(deviation**2))
    time = np.arange(20_000) / 40_000
    force = broadband(rng, Band(0, 150, order=2), rms=np.tile([100.0, 5.0], 3), period=1.0)(time)[:, :2]
    felt = known.balance_load(force, interval=1 / 40_000)[::4]
    noise = np.array([0.1, 0.005]) * rng.normal(size=felt.shape)
    channels = {
        name: Channel(name, column, si_unit(name)) for name, column in zip(("NF", "PM"), (felt + noise).T, strict=True)
    }
    return Recording.from_columns(time[::4], channels), known


def test_wrong_matrices_are_counted_in_all_rows_that_have_a_part(two_with_shared_noise, seed) -> None:
    found = estimate_force(*two_with_shared_noise, hum="keep")
    assert found["NF"].shared is not None
    part = next(part for part in found["NF"].contributions if part.source == "dynamics")
    # every draw decouples the record anew; the eight numbers drawn have their covariance but for 24 of 25
    checked = monte_carlo(found, draws=25, seed=int(seed % 2**32))["NF"]
    drawn = next(row for row in checked.contributions if row.name == part.name)
    assert drawn.ratio == pytest.approx(np.sqrt(24 / 25), rel=0.03)


def test_one_row_may_be_known_exactly(two_with_shared_noise) -> None:
    recording, known = two_with_shared_noise
    own_row = np.tile([1.0, 1.0, 0.0, 0.0], 2)
    known = replace(known, covariance=known.covariance * np.outer(own_row, own_row))
    found = estimate_force(recording, known, hum="keep")
    assert found["NF"].shared is not None
    part = "inertia, damping and mass"
    assert found["NF"].budget[part] > 0
    assert found["PM"].shared is not None
    assert found["PM"].budget[part] > 0  # by the noise that the row of NF predicts


def test_nothing_is_improved_beside_gaps_and_ends(rng) -> None:
    spectra = _random_matrix(rng)
    spectra = replace(spectra, frequency=np.linspace(0, 500, 5), force=spectra.force * 0.02)
    present = np.ones((400, 3), dtype=bool)
    present[200, 2] = False
    one = shared_noise(
        spectra, 0, residuals=rng.normal(size=(400, 3)), present=present, readings=lambda place: np.zeros(400)
    )
    assert one is not None
    assert 2 in one.others
    raised = one.error**-2
    expected = np.ones(400)
    expected[:12] = expected[-12:] = expected[188:213] = raised
    np.testing.assert_allclose(one.level, expected)


@pytest.mark.soak(first=0)
def test_channels_that_are_read_later_share_their_noise_as_late(rng) -> None:
    balance, simulation = _soft_loads(rng)
    late = rng.uniform(0, 0.3, 6) / simulation.recording.rate
    load = broadband(rng, SOFT, rms=0.1 * balance.half_range, period=2 * DURATION)
    channels = dict(simulation.recording.channels)
    for place, name in enumerate(balance.dynamics.components):
        sensor = Sensor(delay=float(late[place]))
        rig = SixComponentRig(balance.without_noise(), applied=load, output="loads", load_sensor=sensor)
        values = rig.run(DURATION, rng).recording.channel(name).values
        noise = balance.noise * balance.half_range[place] * rng.normal(size=values.size)
        channels[name] = replace(channels[name], values=values + noise, delay=float(late[place]))
    found = estimate_force(replace(simulation.recording, channels=channels), balance.dynamics, hum="keep")
    row, joint = _bounds(balance, simulation.recording.rate)
    inner = slice(1000, -1000)
    for place, (name, estimate) in enumerate(found.items()):
        if joint[place] > WORTH * row[place]:
            continue
        # a force is that of the instants at which its own channel was read
        clock = np.arange(simulation.recording.samples) / simulation.recording.rate
        error = (estimate.values - load(clock - late[place])[:, place])[inner]
        # noise near half the sampling rate is weakened where a channel is read later by half a sample
        most = row[place] if estimate.shared is None else joint[place]
        assert np.sqrt(np.mean(error**2)) < 1.25 * most, f"{name}"


@pytest.mark.soak(first=0)
def test_sharp_bands_alike_have_nothing_to_share(rng) -> None:
    """Within the band every force is far above the noise, and beyond it there is none to be made better."""
    balance = random_balance(rng)
    load = broadband(rng, Band(0, 300), rms=0.1 * balance.half_range, period=2 * DURATION)
    simulation = SixComponentRig(balance, applied=load, output="loads").run(DURATION, rng)
    assert not _record(balance, simulation)[1]


def test_noise_that_no_other_component_shares_is_left_as_it_is(rng) -> None:
    spectra = _random_matrix(rng)
    apart = spectra.whole * np.eye(3)[:, :, None]
    given = {"residuals": rng.normal(size=(50, 3)), "present": np.ones((50, 3), dtype=bool)}

    def readings(other: int) -> Array:
        return np.asarray(given["residuals"][:, other])

    assert shared_noise(replace(spectra, whole=apart, own=apart), 0, readings=readings, **given) is None
    one = slice(0, 1)
    alone = NoiseMatrix(
        models=spectra.models[:1],
        frequency=spectra.frequency,
        whole=spectra.whole[one, one],
        own=spectra.own[one, one],
        force=spectra.force[:, one],
        gain=spectra.gain[:, one],
    )
    given = {name: table[:, one] for name, table in given.items()}
    assert shared_noise(alone, 0, readings=readings, **given) is None
