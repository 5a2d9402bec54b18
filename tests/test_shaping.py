"""Shaping filters against the spectra that they are made for."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import hankel, svd

from aerobalance.estimation.statespace import shaping_filter
from aerobalance.estimation.statespace.shaping_filter import EDGE, ShapingFilter


def butterworth(order: int, corner: float):
    return lambda f: 1e3 / (1 + (f / corner) ** (2 * order))


@pytest.mark.parametrize("order", [1, 2, 4, 8])
def test_smooth_spectrum_is_followed(order):
    density = butterworth(order, 80.0)
    shaping = ShapingFilter.of_spectrum(density, centre=80.0)
    frequency = np.array([0.0, 20.0, 70.0, 80.0, 120.0, 160.0])
    # edges are moved outward by EDGE in angle, f = centre tan(angle / 2): a slope of 2 n dB/dB at f is met late by at
    # most df = EDGE (centre + f^2 / centre) / 2, the smoothing as much again
    late = EDGE * (80 + frequency**2 / 80)
    upper, lower = density(np.maximum(frequency - late, 0)), density(frequency)
    found = shaping.spectrum(frequency)
    assert (found <= 1.001 * upper + 1e-6).all()
    # a fall as f^-2 ends, on the circle, in a corner that is widened too: 2 EDGE of the amplitude is left out there
    assert (found >= (1 - 2 * EDGE if order == 1 else 0.999) * lower).all()


@pytest.mark.parametrize(("edge", "depth"), [(30.0, 1e-7), (120.0, 1e-5), (900.0, 1e-6)])
def test_sharp_edge_is_followed(edge, depth):
    shaping = ShapingFilter.of_spectrum(
        lambda f: np.where(f <= edge, 1.0, depth / (1 + (f / (10 * edge)) ** 4)), centre=edge
    )
    inside = np.linspace(0, (1 - EDGE) * edge, 200)
    outside = np.linspace((1 + 4 * EDGE) * edge, 5 * edge, 200)
    assert shaping.spectrum(inside) == pytest.approx(np.ones(200), rel=0.01)
    # an impulse response cut off after MEMORY samples leaves 1e-5 of the density close to the edge
    assert np.max(shaping.spectrum(outside)) < 2e-5 + 2 * depth


def test_variance_is_the_integral_of_the_spectrum():
    shaping = ShapingFilter.of_spectrum(butterworth(4, 80.0), centre=80.0)
    power, _ = quad(lambda f: 2 * float(shaping.spectrum(np.array(f))), 0, 2000, limit=400, epsrel=1e-9)
    # a spectrum as f^-8 has (80 / 2000)^7 of its power beyond 2000 Hz
    assert shaping.covariance[0, 0] == pytest.approx(power, rel=1e-6)


def test_tolerance_saves_states():
    density = butterworth(8, 80.0)
    few, many = (ShapingFilter.of_spectrum(density, centre=80.0, tolerance=t) for t in (1.0, 1e-3))
    assert few.order < many.order
    frequency = np.linspace(0, 400, 2000)
    # twice the sum of the singular values left out bounds the error of the amplitude [Glover1984]; what passes at once
    # on the bent clock is left out too and is as small
    for shaping, tolerance in ((few, 1.0), (many, 1e-3)):
        whole = ShapingFilter.of_spectrum(density, centre=80.0)
        error = np.abs(np.sqrt(shaping.spectrum(frequency)) - np.sqrt(whole.spectrum(frequency)))
        assert np.max(error) < 2 * tolerance


def test_filter_is_stable_and_the_silent_one_silent():
    shaping = ShapingFilter.of_spectrum(butterworth(2, 5.0), centre=20.0)
    assert np.linalg.eigvals(shaping.drift).real.max() < 0
    assert ShapingFilter.silent().spectrum(np.array([0.0, 10.0])) == pytest.approx([0.0, 0.0])
    assert ShapingFilter.silent().covariance == pytest.approx(np.zeros((1, 1)))


def realised(A: np.ndarray, B: np.ndarray, C: np.ndarray, count: int) -> np.ndarray:
    """Impulse response C A^k B of states, k from 0."""
    state, out = B, []
    for _ in range(count):
        out.append(C @ state)
        state = A @ state
    return np.array(out)


@pytest.mark.parametrize("states", [2, 4, 6])
def test_realisation_is_that_of_the_dense_hankel_matrix(states):
    """Kung's recipe to the letter: singular vectors of the whole matrix."""
    circle = np.linspace(0, np.pi, shaping_filter.CIRCLE // 2 + 1)
    level = np.log(1e-4 + np.exp(-8 * (1 - np.cos(circle))))
    response = shaping_filter._minimum_phase(np.concatenate([level, level[-2:0:-1]]))
    size = 200  # the response has fallen below rounding within as many samples
    left, singular, right = svd(hankel(response[1 : size + 1], response[size : 2 * size]))
    tolerance = 2.02 * float(np.sum(singular[states:]))
    A, B, C = shaping_filter._balanced(response, tolerance)
    assert B.size == states
    root = np.sqrt(singular[:states])
    left = left[:, :states]
    expected = realised((left[:-1].T @ left[1:]) / root[:, None] * root, root * right[:states, 0], left[0] * root, 200)
    # what the iteration leaves is under a hundredth of the tolerance, which bounds every sample of an error too
    assert np.max(np.abs(realised(A, B, C, 200) - expected)) < 0.02 * tolerance
    # and the bound itself, over all frequencies
    error = np.fft.rfft(realised(A, B, C, 4096) - response[1:4097])
    assert np.max(np.abs(error)) < tolerance


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 3e-4])
def test_error_of_a_sharp_edge_is_within_its_bound(tolerance):
    spectrum = np.where(shaping_filter._bent_frequencies(1.0) <= 1.0, 1.0, tolerance**2)
    response = shaping_filter._minimum_phase(shaping_filter._widened(np.log(spectrum)))
    A, B, C = shaping_filter._balanced(response, tolerance)
    assert B.size < shaping_filter.STATES
    poles, modes = np.linalg.eig(A)
    residues = (C @ modes) * np.linalg.solve(modes, B.astype(complex))
    turns = np.exp(2j * np.pi * np.arange(shaping_filter.CIRCLE) / shaping_filter.CIRCLE)
    found = np.sum(residues / (turns[:, None] - poles), axis=1)
    assert np.max(np.abs(found - (np.fft.fft(response) - response[0]))) < tolerance * (1 + shaping_filter.CUT)
