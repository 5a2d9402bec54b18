"""Shaping filters against the spectra that they are made for."""

import numpy as np
import pytest
from scipy.integrate import quad

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
