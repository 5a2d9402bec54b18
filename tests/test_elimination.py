"""Internal coordinates taken out, and partial fractions: closed forms and matrices inverted frequency by frequency."""

from __future__ import annotations

import numpy as np
import pytest

from aerobalance.dynamics.condensation import modes_of, partial_fractions, spectral_factor
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.recording.channel import Array
from aerobalance.simulation.six_balance import random_balance
from aerobalance.simulation.six_bending import Bending, bending_dynamics


def values(polynomials: Array, s: Array) -> Array:
    """Polynomials at s, along the first axis."""
    powers = s[:, None] ** np.arange(polynomials.shape[-1])
    return np.moveaxis(np.tensordot(polynomials, powers.T, axes=1), -1, 0)


def bent(rng: np.random.Generator) -> CoupledDynamics:
    balance = random_balance(rng)
    highest = max(mode.natural_frequency for mode in balance.dynamics.modes)
    bending = Bending.random(balance, rng, frequency=rng.uniform(0.5, 1.5) * highest, part=0.3)
    return bending_dynamics(balance, bending)


def test_no_hidden_coordinate_leaves_the_equations_as_they_are() -> None:
    A, D = np.array([[3e-6, 1e-6], [0.0, 2e-6]]), np.array([[4e-5, 0.0], [1e-5, 5e-5]])
    dynamics = CoupledDynamics(("NF", "AF"), A, D)
    free = dynamics.condensed
    expected = np.stack([np.eye(2), D, A], axis=-1)
    # three values on a circle of radius w hold each power to some roundings of what it is there, of about 1
    rate = float(np.exp(np.mean(np.log(np.abs(dynamics.poles)))))
    assert (np.abs(free.forces - expected) * rate ** np.arange(3.0) < 1e-14).all()
    row = CoupledDynamics(("NF", "AF"), np.diag([3e-6, 2e-6]), np.diag([4e-5, 5e-5]))
    assert not row.condensed.forces[[0, 1], [1, 0]].any()  # nothing at all where there is no coupling
    assert free.common == pytest.approx([1.0])
    assert free.internal.shape == (0, 2, 1)


def test_equations_without_the_hidden_coordinate_are_the_inverse_of_the_response(rng) -> None:
    dynamics = bent(rng)
    frequency = np.geomspace(1, 2000, 100)
    s = 2j * np.pi * frequency
    free = dynamics.condensed
    common = values(free.common, s)[:, None, None]
    whole = np.linalg.inv(dynamics.equation(s))
    expected = np.linalg.inv(whole[:, :6, :6])
    np.testing.assert_allclose(dynamics.inverse_response(frequency), expected, rtol=1e-7)
    found = values(free.forces, s) / common
    size = np.abs(expected).max(axis=0)
    # five values on a circle, powers up to the fourth at five times its radius and more: 1e-16 of 5^4 and its terms
    assert (np.abs(found - expected) < 1e-9 * size).all()
    # the load in the internal spring when the components have unit loads, from the inverse as well
    inside = np.linalg.solve(whole[:, :6, :6].transpose(0, 2, 1), whole[:, 6:, :6].transpose(0, 2, 1))
    internal = values(free.internal, s) / common
    assert (np.abs(internal - inside.transpose(0, 2, 1)) < 1e-8 * np.abs(internal).max(axis=0)).all()


def test_one_hidden_coordinate_by_hand() -> None:
    """AF with one spring behind: q F = (p11 q - p12 p21) X with q = p22."""
    dynamics = CoupledDynamics(("AF",), np.array([[4e-6, 1e-6], [2e-6, 3e-6]]), np.array([[2e-5, 0.0], [0.0, 1e-5]]))
    free = dynamics.condensed
    one, two = np.array([1, 2e-5, 4e-6]), np.array([1, 1e-5, 3e-6])
    across = np.convolve([0, 0, 1e-6], [0, 0, 2e-6])
    np.testing.assert_allclose(free.forces[0, 0], np.convolve(one, two) - across, rtol=1e-12)
    np.testing.assert_allclose(free.common, two, rtol=1e-12)
    np.testing.assert_allclose(free.internal[0, 0], [0, 0, -2e-6], rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(free.carried[0, 0], [0, 0, 1e-6], rtol=1e-12, atol=1e-16)
    assert dynamics.coordinates == ("AF", "hidden 1")
    assert dynamics.parameters[2] == "inertia hidden 1/AF"


def test_spectral_factor_gives_the_modes_back() -> None:
    given = (Mode(40.0, 0.01), Mode(90.0, 0.7), Mode(300.0, 1.4))
    whole = np.ones(1)
    for mode in given:
        whole = np.convolve(whole, [1, 2 * mode.damping_ratio / mode.angular_frequency, mode.angular_frequency**-2])
    spectrum = np.convolve(whole, whole * (-1.0) ** np.arange(7))[::2]
    found = spectral_factor(spectrum)
    for mode, expected in zip(found[:2], given[:2], strict=True):
        # the roots of a polynomial of third degree, apart by a factor of four at least: some ten roundings
        assert (mode.natural_frequency, mode.damping_ratio) == pytest.approx(
            (expected.natural_frequency, expected.damping_ratio), rel=1e-10
        )
    assert found[2].damping_ratio == pytest.approx(1.4, rel=1e-10)


def test_partial_fractions_add_to_the_whole(rng) -> None:
    modes = [Mode(50 * 3**k * rng.uniform(1, 2), rng.uniform(0.01, 1.5)) for k in range(3)]
    given = rng.normal(size=(2, 7)) * 2000.0 ** -np.arange(7.0)
    direct, shares, rates = partial_fractions(given, modes)
    s = 2j * np.pi * np.geomspace(1, 3000, 50)
    product = np.prod([1 / mode.response(s.imag / 2 / np.pi) for mode in modes], axis=0)
    for row in range(2):
        found = direct[row] + sum(
            (share + rate * s) * mode.response(s.imag / 2 / np.pi)
            for mode, share, rate in zip(modes, shares[row], rates[row], strict=True)
        )
        expected = values(given[row], s) / product
        # 1e-16 of the largest fraction, which may outweigh the sum a thousand times
        assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max() + 1e-12


def test_roots_that_are_no_decay_are_refused() -> None:
    with pytest.raises(ValueError, match="does not decay"):
        modes_of(np.array([1j, -1j]))
    with pytest.raises(ValueError, match="pairs"):
        modes_of(np.array([-1 + 0j]))
