"""Coupled components taken apart: closed forms and an independent inverse as oracles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.channel import Array
from aerobalance.coupled import CoupledDynamics
from aerobalance.decoupling import LoneComponent, finer
from aerobalance.rigs.six_balance import CoupledBalance, random_balance

RATE = 25_000.0


@pytest.fixture(scope="module")
def drawn() -> tuple[CoupledBalance, int]:
    entropy = int(np.random.SeedSequence().generate_state(1)[0])
    return random_balance(np.random.default_rng(entropy)), entropy


def _noise(balance: CoupledBalance) -> Array:
    """Covariance of the noise, with a correlation of 0.3 between neighbours."""
    size = balance.noise * balance.half_range
    return np.outer(size, size) * (np.eye(6) + 0.3 * np.eye(6, k=1) + 0.3 * np.eye(6, k=-1))


def test_the_lone_balance_has_the_noise_of_the_coupled_inverse(drawn: tuple[CoupledBalance, int]) -> None:
    balance, entropy = drawn
    dynamics, noise = balance.dynamics, _noise(balance)
    frequency = np.geomspace(1, RATE / 2, 200)
    inverse = dynamics.inverse_response(frequency)
    for place, name in enumerate(dynamics.components):
        lone = LoneComponent.of(dynamics, name, noise=noise)
        row = inverse[:, place]
        through_all = np.sqrt(np.real(np.einsum("mi,ij,mj->m", row, noise, row.conj())))
        alone = np.sqrt(noise[place, place]) / np.abs(lone.dynamics.response(frequency))
        # both are the root of a sum of six squares; the powers of frequency reach 1e4 here, so 1e-12 is rounding
        np.testing.assert_allclose(alone, through_all, rtol=1e-11, err_msg=f"{name}, seed {entropy}")


def test_a_component_by_itself_is_left_as_it_is() -> None:
    dynamics = CoupledDynamics(("NF", "AF"), np.diag([1e-6, 4e-6]), np.diag([1e-5, 2e-5]))
    loads = np.random.default_rng(1).normal(size=(100, 2))
    lone = LoneComponent.of(dynamics, "AF", noise=np.diag([9.0, 1.0]))
    assert lone.alone
    assert (lone.own_inertia, lone.own_damping) == (4e-6, 2e-5)
    assert (lone.reading(loads, interval=1e-4) == loads[:, 1]).all()


def test_the_lone_reading_knows_its_own_force_only(drawn: tuple[CoupledBalance, int]) -> None:
    """Loads at the frequencies of all modes on all components: what is left is the response to its own."""
    balance, entropy = drawn
    dynamics, half_range = balance.dynamics, balance.half_range
    count = 10_000  # 0.4 s, so a period of every 2.5 Hz line
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    generator = np.random.default_rng(entropy + 1)
    inside = (frequency > 0) & (frequency < 700)
    lines = generator.normal(size=(frequency.size, 6, 2)) @ np.array([1, 1j]) * half_range
    lines[~inside] = 0
    felt = np.fft.irfft(np.einsum("mij,mj->mi", dynamics.response(frequency), lines), count, axis=0)
    for place, name in enumerate(dynamics.components):
        lone = LoneComponent.of(dynamics, name, noise=_noise(balance))
        # the free oscillation of the start has to die away to exp(-17) = 4e-8, and then a period and the end follow
        periods = int(np.ceil(17 / lone.dynamics.decay_rate / (count / RATE))) + 2
        found = lone.reading(np.tile(felt, (periods, 1)), interval=1 / RATE)[-2 * count : -count]
        expected = np.fft.irfft(lone.dynamics.response(frequency) * lines[:, place], count)
        # straight lines on the finer clock leave (w h / 4)^4 / 240 = 5e-7 of a load at 700 Hz, the band-limited
        # interpolation up to 1e-4 of its rms where the loads of others are much larger than the component's own
        largest = np.abs(felt * (np.abs(lone.inertia) * (2 * np.pi * 700) ** 2 + 1)).max()
        assert np.abs(found - expected).max() < 2e-5 * largest, f"{name}, seed {entropy}"


def test_slopes_are_those_of_differences(drawn: tuple[CoupledBalance, int]) -> None:
    balance, entropy = drawn
    dynamics = balance.dynamics
    loads = np.cumsum(np.random.default_rng(entropy).normal(size=(400, 6)), axis=0) * balance.half_range
    lone = LoneComponent.of(dynamics, "YM", noise=_noise(balance))
    slopes = lone.parameter_slopes(loads, interval=1 / RATE)
    before = lone.reading(loads, interval=1 / RATE)
    for j in range(6):
        for kind, values in (("inertia", lone.inertia), ("damping", lone.damping)):
            small = 1e-3 * float(np.abs(values).max())
            changed = values + small * np.eye(6)[j]
            other = replace(lone, inertia=changed) if kind == "inertia" else replace(lone, damping=changed)
            change = (other.reading(loads, interval=1 / RATE) - before) / small  # the reading is linear in both
            own = slopes[:, j + (6 if kind == "damping" else 0)]
            np.testing.assert_allclose(own, change, atol=1e-6 * np.abs(own).max(), err_msg=f"{kind} {j}, {entropy}")


@pytest.mark.parametrize("frequency", [50.0, 600.0, 2000.0])
def test_straight_lines_do_a_sine_no_harm(frequency: float) -> None:
    """The transform of straight lines between samples is sinc^2: with what `finer` gives back it is 1 + O(x^4)."""
    time = np.arange(2000) / RATE
    fine = finer(np.sin(2 * np.pi * frequency * time)[:, None])[:, 0]
    x = np.pi * frequency / (4 * RATE)
    middle = slice(2000, 6000)
    clock = np.arange(fine.size) / (4 * RATE)
    size = 2 * np.mean(fine[middle] * np.sin(2 * np.pi * frequency * clock[middle]))
    whole = size * np.sinc(x / np.pi) ** 2  # amplitude of the sine in the lines between the points
    # 4 x^4 / 60 for the lines, 2e-4 for the ripple of the interpolation's window (Kaiser, beta 8: -80 dB)
    assert whole == pytest.approx(1, abs=4 * x**4 / 60 + 2e-4)


def test_the_ends_of_a_record_are_as_good_as_its_middle(drawn: tuple[CoupledBalance, int]) -> None:
    """Sines of 600 Hz cut off anywhere: what is left at the end is a small part of the noise."""
    balance, entropy = drawn
    dynamics = balance.dynamics
    generator = np.random.default_rng(entropy + 2)
    time = np.arange(20_000) / RATE
    size = generator.normal(size=6) * 0.1 * balance.half_range
    phase = generator.uniform(0, 2 * np.pi, 6)
    response = dynamics.response(np.array([600.0]))[0]
    turning = np.exp(2j * np.pi * 600 * time)[:, None]
    felt = np.real(turning * (response @ (size * np.exp(1j * phase))))
    for place, name in enumerate(dynamics.components):
        lone = LoneComponent.of(dynamics, name, noise=_noise(balance))
        own = lone.dynamics.response(np.array([600.0]))[0] * size[place] * np.exp(1j * phase[place])
        error = lone.reading(felt, interval=1 / RATE) - np.real(turning[:, 0] * own)
        if lone.dynamics.decay_rate * time[-1] < 17:
            continue  # the free oscillation of the start is still there
        # a spline errs by (w h)^4 / 384 = 1e-6 of the sine, at its ends by ten times that (de Boor), and its second
        # difference with it; the loads of the others come in with what A makes of them
        largest = float(np.max(np.abs(felt) @ (np.abs(lone.inertia) * (2 * np.pi * 600) ** 2 + 1)))
        assert np.abs(error[-30:]).max() < 1e-4 * largest, f"{name}, seed {entropy}"
