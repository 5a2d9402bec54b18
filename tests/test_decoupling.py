"""Coupled decoupled components: closed forms and an independent inverse as oracles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import matrix_balance

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.decoupling import Fractions
from aerobalance.dynamics.driven_modes import DrivenModes, responses, values_and_rates
from aerobalance.dynamics.modal import Mode
from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import EDGE, FINE, fractional_delay, upsample_compensated
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_bending import Bending, bending_dynamics
from aerobalance.simulation.six_signals import Band, broadband
from seeds import new_seed

RATE = 25_000.0

Drawn = tuple[CoupledBalance, CoupledDynamics]


@pytest.fixture(scope="module", params=["rigid", "bending"])
def drawn(request: pytest.FixtureRequest) -> Drawn:
    rng = np.random.default_rng(new_seed())
    balance = random_balance(rng)
    if request.param == "rigid":
        return balance, balance.dynamics
    highest = max(mode.natural_frequency for mode in balance.dynamics.modes)
    bending = Bending.random(balance, rng, frequency=rng.uniform(0.5, 1.5) * highest, part=0.3)
    return balance, bending_dynamics(balance, bending)


def _noise(balance: CoupledBalance) -> Array:
    """Covariance of the noise, with a correlation of 0.3 between neighbours."""
    size = balance.noise * balance.half_range
    return np.outer(size, size) * (np.eye(6) + 0.3 * np.eye(6, k=1) + 0.3 * np.eye(6, k=-1))


def test_the_decoupled_channel_has_the_noise_of_the_coupled_inverse(
    drawn: Drawn,
) -> None:
    balance, dynamics = drawn
    noise = _noise(balance)
    frequency = np.geomspace(1, RATE / 2, 200)
    inverse = dynamics.inverse_response(frequency)
    for place, name in enumerate(dynamics.components):
        decoupled = dynamics.decoupled(name, noise=noise)
        row = inverse[:, place]
        through_all = np.sqrt(np.real(np.einsum("mi,ij,mj->m", row, noise, row.conj())))
        alone = np.sqrt(noise[place, place]) / np.abs(decoupled.dynamics.response(frequency))
        # both are the root of a sum of six squares; the powers of frequency reach 1e4 here, so 1e-12 is rounding, of
        # the largest of them as well where they cancel
        rounding = 1e-14 * float(through_all.max())
        np.testing.assert_allclose(alone, through_all, rtol=1e-11, atol=rounding, err_msg=name)


def test_a_component_by_itself_is_left_as_it_is() -> None:
    dynamics = CoupledDynamics(("NF", "AF"), np.diag([1e-6, 4e-6]), np.diag([1e-5, 2e-5]))
    loads = np.random.default_rng(1).normal(size=(100, 2))
    decoupled = dynamics.decoupled("AF", noise=np.diag([9.0, 1.0]))
    assert decoupled.alone
    assert decoupled.dynamics.quadratic == pytest.approx((2e-5, 4e-6), rel=1e-13)
    assert (decoupled.reading(loads, interval=1e-4) == loads[:, 1]).all()


def test_the_decoupled_reading_knows_its_own_force_only(drawn: Drawn, rng) -> None:
    """Loads at the frequencies of all modes on all components: what is left is the response to its own."""
    balance, dynamics = drawn
    half_range = balance.half_range
    count = 10_000  # 0.4 s, so a period of every 2.5 Hz line
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    inside = (frequency > 0) & (frequency < 700)
    lines = rng.normal(size=(frequency.size, 6, 2)) @ np.array([1, 1j]) * half_range
    lines[~inside] = 0
    felt = np.fft.irfft(np.einsum("mij,mj->mi", dynamics.response(frequency), lines), count, axis=0)
    for place, name in enumerate(dynamics.components):
        decoupled = dynamics.decoupled(name, noise=_noise(balance))
        # the free oscillation of the start has to die away to exp(-17) = 4e-8, and then a period and the end follow
        periods = int(np.ceil(17 / decoupled.dynamics.decay_rate / (count / RATE))) + 2
        found = decoupled.reading(np.tile(felt, (periods, 1)), interval=1 / RATE)[-2 * count : -count]
        expected = np.fft.irfft(decoupled.dynamics.response(frequency) * lines[:, place], count)
        # straight lines on the finer clock leave (w h / 4)^4 / 240 = 5e-7 of a load at 700 Hz, the band-limited
        # interpolation up to 1e-4 of its rms where the loads of others are much larger than the component's own
        largest = np.abs(felt * (np.abs(dynamics.inertia[place, :6]) * (2 * np.pi * 700) ** 2 + 1)).max()
        assert np.abs(found - expected).max() < 2e-5 * largest, name


def test_a_force_is_read_as_the_coupled_balance_felt_it(drawn: Drawn, rng) -> None:
    """The response of the decoupled model alone is what the readings of all components give."""
    balance, dynamics = drawn
    net = broadband(rng, Band(2, 300), rms=balance.half_range, period=0.4)(np.arange(10_000) / RATE)
    net[:2500] *= np.sin(np.linspace(0, np.pi / 2, 2500))[:, None] ** 2  # at rest before, whatever that is taken for
    felt = dynamics.balance_load(upsample_compensated(net), interval=1 / RATE / FINE, every=FINE)
    for place, name in enumerate(dynamics.components):
        decoupled = dynamics.decoupled(name, noise=_noise(balance))
        expected = decoupled.reading(felt, interval=1 / RATE)
        found = decoupled.response_to(net, interval=1 / RATE)[:, place]
        largest = np.abs(felt * (np.abs(dynamics.inertia[place, :6]) * (2 * np.pi * 300) ** 2 + 1)).max()
        # as in the test before; beyond the end of the record the two go on in different ways
        assert np.abs(found - expected)[:-EDGE].max() < 2e-5 * largest, name


def test_slopes_are_those_of_differences(drawn: Drawn, rng) -> None:
    """Change of a row of the inverse response with each element, times its model's response, line by line."""
    balance, dynamics = drawn
    count = 2_500
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    inside = (frequency > 0) & (frequency < 700)
    lines = rng.normal(size=(frequency.size, 6, 2)) @ np.array([1, 1j]) * balance.half_range
    lines[~inside] = 0
    loads = np.fft.irfft(lines, count, axis=0)
    decoupled = dynamics.decoupled("YM", noise=_noise(balance))
    decays = [mode.damping_ratio * mode.angular_frequency for mode in (*decoupled.dynamics.modes, *decoupled.still)]
    periods = int(np.ceil(17 / min(decays) / (count / RATE))) + 2
    slopes = decoupled.parameter_slopes(np.tile(loads, (periods, 1)), interval=1 / RATE)[-2 * count : -count]
    # an internal coordinate has no unit of its own, and forces and moments differ in theirs: steps fit all only
    # in units that make the rows as large as the columns; without, some would make oscillations that grow
    unit = np.diag(matrix_balance(dynamics.inertia, permute=False)[1])
    for number, own in zip(decoupled.rows, slopes.T, strict=True):
        kind, i, j = np.unravel_index(number, (2, *dynamics.inertia.shape))
        name = ("inertia", "damping")[kind]
        own_size = float(np.sqrt(dynamics.inertia[i, i] * dynamics.inertia[j, j])) * unit[i] / unit[j]
        small = 1e-6 * own_size * (1, 2000)[kind]
        rows = []
        for sign in (1, -1):
            changed = getattr(dynamics, name).copy()
            changed[i, j] += sign * small
            rows.append(replace(dynamics, **{name: changed}).inverse_response(frequency)[:, decoupled.place])
        change = np.einsum("mj,mj->m", (rows[0] - rows[1]) / (2 * small), lines) * decoupled.dynamics.response(
            frequency
        )
        expected = np.fft.irfft(change, count)
        # what the interpolation's window leaves (3e-6) each of the two times that something is driven; rounding of a
        # difference over 1e-6, which powers of the frequency raise from 1e-10 to as much; five of these together
        assert np.abs(own - expected).max() < 3e-5 * np.abs(expected).max(), f"{name} {i}, {j}"


@pytest.mark.parametrize("frequency", [50.0, 600.0, 2000.0])
def test_straight_lines_do_a_sine_no_harm(frequency: float) -> None:
    """The transform of straight lines between samples is sinc^2: with what `finer` gives back it is 1 + O(x^4)."""
    time = np.arange(2000) / RATE
    fine = upsample_compensated(np.sin(2 * np.pi * frequency * time)[:, None])[:, 0]
    x = np.pi * frequency / (4 * RATE)
    middle = slice(2000, 6000)
    clock = np.arange(fine.size) / (4 * RATE)
    size = 2 * np.mean(fine[middle] * np.sin(2 * np.pi * frequency * clock[middle]))
    whole = size * np.sinc(x / np.pi) ** 2  # amplitude of the sine in the lines between the points
    # 4 x^4 / 60 for the lines, 3e-6 for what the interpolation's window leaves up to 0.3 of the rate
    assert whole == pytest.approx(1, abs=4 * x**4 / 60 + 3e-6)


def test_the_ends_of_a_record_are_as_good_as_its_middle(drawn: Drawn, rng) -> None:
    """Sines of 600 Hz cut off anywhere: what is left at the end is a small part of the noise."""
    balance, dynamics = drawn
    time = np.arange(20_000) / RATE
    size = rng.normal(size=6) * 0.1 * balance.half_range
    phase = rng.uniform(0, 2 * np.pi, 6)
    response = dynamics.response(np.array([600.0]))[0]
    turning = np.exp(2j * np.pi * 600 * time)[:, None]
    felt = np.real(turning * (response @ (size * np.exp(1j * phase))))
    for place, name in enumerate(dynamics.components):
        decoupled = dynamics.decoupled(name, noise=_noise(balance))
        own = decoupled.dynamics.response(np.array([600.0]))[0] * size[place] * np.exp(1j * phase[place])
        error = decoupled.reading(felt, interval=1 / RATE) - np.real(turning[:, 0] * own)
        if decoupled.dynamics.decay_rate * time[-1] < 17:
            continue  # the free oscillation of the start is still there
        # a spline errs by (w h)^4 / 384 = 1e-6 of the sine, at its ends by ten times that (de Boor), and its second
        # difference with it; the loads of the others come in with what A makes of them
        largest = float(np.max(np.abs(felt) @ (np.abs(dynamics.inertia[place, :6]) * (2 * np.pi * 600) ** 2 + 1)))
        assert np.abs(error[-30:]).max() < 1e-4 * largest, name


def test_readings_are_brought_to_other_instants_up_to_the_ends(rng) -> None:
    """Of a slow sine the spline at the ends is off by some (w h)^4, the window elsewhere by 3e-6 (`SHARPNESS`)."""
    interval, by = 1 / 25_000, rng.uniform(-1, 1) / 25_000
    w, phase = 2 * np.pi * rng.uniform(50, 200), rng.uniform(0, 2 * np.pi)
    time = np.arange(500) * interval
    moved = fractional_delay(np.sin(w * time + phase)[:, None], delay=-by, interval=interval)[:, 0]
    expected = np.sin(w * (time + by) + phase)
    np.testing.assert_allclose(moved, expected, rtol=0, atol=10 * (w * interval) ** 4 + 3e-6)


@pytest.mark.parametrize("together", [1, 2, 7])
def test_responses_do_not_depend_on_how_many_samples_come_at_once(together: int, rng) -> None:
    modes = (Mode(60.0, 0.01, 1.0), Mode(170.0, 0.03, 1.0))
    driving = rng.normal(size=(20, 2, 2)) * np.array([1.0, 1e-3])[:, None]
    whole = DrivenModes(modes, interval=1e-3, delays=(-4e-3,)).whole(driving)
    stream = DrivenModes(modes, interval=1e-3, delays=(-4e-3,))
    parts = [stream.push(driving[first : first + together]) for first in range(0, 20, together)]
    assert parts[0].shape == (0, 2)  # a response waits for samples after it
    # sums of products in blocks of other lengths: rounding of some dozen of them
    np.testing.assert_allclose(np.concatenate([*parts, stream.finish()]), whole, rtol=0, atol=1e-13 * np.ptp(whole))


def test_a_sum_of_a_response_and_its_rate_is_that_of_both(rng) -> None:
    mode, series = Mode(60.0, 0.01, 1.0), 3.0 + rng.normal(size=(500, 2))
    values, rates = values_and_rates(mode, series, interval=1e-3)
    found = responses(mode, series, by_value=0.7, by_rate=2e-3, interval=1e-3)
    expected = 0.7 * values + 2e-3 * rates
    # rounding of some dozen products a sample, each of which rings for 27 of them (1 / (w zeta h))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.ptp(expected))


def test_nothing_drives_no_response() -> None:
    assert DrivenModes((Mode(60.0, 0.01, 1.0),), interval=1e-3).finish().shape == (0, 1)


def test_fractions_without_modes_are_their_direct_part(rng) -> None:
    series, direct = rng.normal(size=(30, 3)), rng.normal(size=3)
    none = np.zeros((0, 3))
    found = Fractions(direct, (), none, none).through(series, interval=1e-3)
    np.testing.assert_array_equal(found, series @ direct)
