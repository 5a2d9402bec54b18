"""Steps that are taken up several at a time: the scan, what it proposes, ramps among them, and a square wave."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from aerobalance.estimation.least_squares import generalised_least_squares, log_likelihood
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.prior import fit_prior
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.step_fit import gains_of_ramps
from aerobalance.estimation.step_scan import Scan
from aerobalance.estimation.step_search import StepSearch, find_steps
from aerobalance.estimation.steps import Step, columns_of, response_to
from helpers.accuracy import RIG
from helpers.cable_cut import T128

RATE = 1600.0


def reading_of(steps, rng, *, seconds=2.0, noise=2.0, rate=RATE, dynamics=T128):
    """Readings under steps (instant, height, duration)."""
    time = np.arange(round(seconds * rate)) / rate
    load = rng.normal(0, noise, time.size)
    for instant, height, duration in steps:
        load += height * dynamics.step_response(time - instant, duration=duration)
    return Observation(load, 1 / rate, dynamics)


def filter_of(reading, steps=()):
    learned = fit_prior(reading, columns=columns_of(steps, reading))
    return KalmanFilter.of(reading.system(learned), reading.present)


@pytest.mark.parametrize("known", [(), (Step(0.5003, 0.0), Step(1.4, 0.003))])
def test_the_scan_is_the_gain_in_likelihood_of_each_step(known, rng):
    reading = reading_of([(0.5003, 300.0, 0.0), (1.0, 50.0, 0.0), (1.4, -200.0, 0.003)], rng)
    filter_ = filter_of(reading, known)
    columns = columns_of(known, reading)
    scan = Scan.of(reading, filter_, columns)
    gains = scan.gain(scan.score)
    without = log_likelihood(reading, filter_, columns=columns)
    for place in (700, 1500, 1601, 2000):
        more = columns_of([*known, Step((place - 1) / RATE, 0.0)], reading)
        expected = 2 * (log_likelihood(reading, filter_, columns=more) - without)
        # by the settled filter, which the start of the record has become long before
        assert gains[place] == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_the_scan_tells_the_gain_of_each_change_of_slope(rng):
    reading = reading_of([(0.5003, 300.0, 0.0), (0.9, 2000.0, 0.5)], rng)
    known = [Step(0.5003, 0.0)]
    filter_, columns = filter_of(reading, known), columns_of(known, reading)
    scan = Scan.of(reading, filter_, columns)
    gains = scan.gain_of_bends(scan.score)
    without = log_likelihood(reading, filter_, columns=columns)
    for place in (700, 1441, 2000):
        # a slope is a small step at each sample from there on
        bend = np.sum(
            [response_to(Step((k - 1) / RATE, 0.0), reading) for k in range(place, reading.values.size)], axis=0
        )
        expected = 2 * (log_likelihood(reading, filter_, columns=np.column_stack([columns, bend])) - without)
        assert gains[place] == pytest.approx(expected, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("corners", [[0.3, 0.7, 1.5, 1.9], [0.2, 0.5]], ids=len)
def test_corners_of_ramps_are_no_steps(corners, rng):
    heights = [3000.0, -3000.0]
    ramps = [(a, height, b - a) for a, b, height in zip(corners[::2], corners[1::2], heights, strict=False)]
    search = StepSearch(reading_of(ramps, rng))
    assert search.run()[0] == []
    # to a sample, of the two beside the corner
    assert search.bends == pytest.approx(corners, abs=2 / RATE)


def test_a_step_beside_a_corner_is_found(rng):
    # slopes of 7500 N/s; the step stands out of 2 N of noise as it would alone
    steps, _ = find_steps(reading_of([(0.4, 3000.0, 0.4), (1.1003, 300.0, 0.0), (1.4, -3000.0, 0.4)], rng))
    assert [step.instant for step in steps] == pytest.approx([1.1003], abs=0.5 / RATE)
    assert steps[0].height == pytest.approx(300.0, abs=5 * steps[0].height_uncertainty)


def test_the_scan_without_a_step_is_that_of_the_other_shapes(rng):
    known = [Step(0.5003, 0.0), Step(1.4, 0.003)]
    reading = reading_of([(0.5003, 300.0, 0.0), (1.4, -200.0, 0.003)], rng)
    filter_ = filter_of(reading, known)
    whole = Scan.of(reading, filter_, columns_of(known, reading)).without(2)
    other = Scan.of(reading, filter_, columns_of(known[:1], reading))
    assert whole.score == pytest.approx(other.score, abs=1e-9 * np.max(np.abs(other.score)))
    assert whole.information == pytest.approx(other.information, abs=1e-9 * np.max(other.information))


def test_steps_that_cannot_be_taken_for_each_other_are_proposed_together(rng):
    # the second is a twentieth of the first, its gain a four-hundredth, and its response within that of the first
    reading = reading_of([(0.5002, 400.0, 0.0), (0.8, 20.0, 0.0), (1.2003, -400.0, 0.0)], rng)
    scan = Scan.of(reading, filter_of(reading), columns_of([], reading))
    found = sorted(step.instant for step in scan.likeliest(threshold=40.0, most=9, known=()))
    assert found == pytest.approx([0.5002, 1.2003], abs=1 / RATE)
    (one,) = scan.likeliest(threshold=40.0, most=1, known=())
    assert one.instant in found


def test_ramps_are_told_from_sudden_steps(rng):
    true = [(0.4, 300.0, 0.0), (0.8, -300.0, 0.004), (1.2003, 300.0, 0.0), (1.6, -300.0, 0.002)]
    reading = reading_of(true, rng)
    middles = [Step(instant + duration / 2, 0.0) for instant, _, duration in true]
    gains = gains_of_ramps(reading, filter_of(reading, [Step(t, d) for t, _, d in true]), middles)
    # chi-square with one degree of freedom where there is none: 16 is four standard deviations
    assert gains[0] < 16
    assert gains[2] < 16
    # 4 ms and 2 ms take 3 % and 0.7 % of an amplitude of 300 N in a noise of 2 N, for some 30 periods of 24 samples
    assert gains[1] > 1000
    assert gains[3] > 100


@pytest.mark.parametrize("dynamics", [T128, RIG], ids=["T-128", "rig"])
@pytest.mark.parametrize(("instant", "duration"), [(-0.01, 0.0), (0.123, 0.0), (0.0, 0.2), (5.0, 0.0), (0.3, 0.004)])
def test_the_response_is_the_same_where_it_has_ended(dynamics, instant, duration):
    reading = Observation(np.zeros(20_000), 1 / 25e3, dynamics)
    time = np.arange(20_000) / 25e3 - instant
    expected = dynamics.step_response(time, duration=duration)
    assert response_to(Step(instant, duration), reading) == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("noise", [2.0, 10.0])
@pytest.mark.soak(first=1)
def test_every_edge_of_a_square_wave_is_found(noise, rng):
    edges = [(0.1 * k + rng.uniform(0.05, 0.05 + 1 / RATE), 700.0 * (-1) ** k, 0.0) for k in range(13)]
    steps, learned = find_steps(reading_of(edges, rng, noise=noise, seconds=1.4))
    assert len(steps) == len(edges)
    # nothing fluctuates beside the noise any more
    assert np.max(learned.spectrum.levels, initial=0.0) < 0.1 * noise**2 / RATE
    found = np.array([(step.instant, step.height) for step in steps])
    true = np.array([edge[:2] for edge in edges])
    u = np.array([(step.instant_uncertainty, step.height_uncertainty) for step in steps])
    scores = (found - true) / u
    # 26 normal deviations: five is passed once in 60,000 runs, the mean square by five standard deviations of its own
    assert np.max(np.abs(scores)) < 5
    assert np.mean(scores**2) < 1 + 5 * np.sqrt(2 / scores.size)


@pytest.mark.parametrize("true", [[(0.61187, 400.0, 0.0)], [(0.6110, 200.0, 0.0), (0.6122, 200.0, 0.0)]], ids=len)
def test_two_steps_close_to_each_other_are_one_where_they_bring_no_more(true, rng):
    """Half a step before its instant and half after it leave some newtons; two true ones 1.9 samples apart stay."""
    reading = reading_of([*true, (1.2003, -400.0, 0.0)], rng)
    split = [Step(0.6110, 0.0, 200.0), Step(0.6122, 0.0, 200.0), Step(1.2003, 0.0, -400.0)]
    search = StepSearch(reading)
    steps, _ = search._joined(split, fit_prior(reading, columns=columns_of(split, reading)))
    assert len(steps) == len(true) + 1
    if len(true) == 1:
        found = steps[0]
        assert abs(found.instant - true[0][0]) < 5 * found.instant_uncertainty
        assert abs(found.height - true[0][1]) < 5 * found.height_uncertainty


def test_sizes_of_the_scan_are_those_of_least_squares(rng):
    known = [Step(0.5003, 0.0), Step(1.4, 0.003)]
    reading = reading_of([(0.5003, 300.0, 0.0), (1.4, -200.0, 0.003)], rng)
    filter_, columns = filter_of(reading, known), columns_of(known, reading)
    scan = Scan.of(reading, filter_, columns)
    sizes, covariance, _ = generalised_least_squares(filter_, reading.filled, columns)
    assert scan.sizes == pytest.approx(sizes, rel=1e-9)
    assert np.sum(scan.inverse**2, axis=1) == pytest.approx(np.diag(covariance), rel=1e-6)


def test_what_the_filter_has_forgotten_of_a_response_is_a_constant(rng, monkeypatch):
    """Of a smooth spectrum a part of the whitened response is all of it, and the scan is that of the whole."""
    reading = reading_of([], rng, seconds=2)
    force = 300 * signal.lfilter(*signal.butter(2, 40.0, fs=RATE), rng.normal(size=reading.values.size))
    reading = replace(reading, values=reading.values + T128.balance_load(force, interval=1 / RATE))
    smooth, columns = fit_prior(reading, columns=columns_of([], reading), smooth=True), columns_of([], reading)
    filter_ = KalmanFilter.of(reading.system(smooth), reading.present)
    whole = Scan.of(reading, filter_, columns)
    monkeypatch.setattr("aerobalance.estimation.step_scan.SHORTEST", 128)
    short = Scan.of(reading, filter_, columns)
    assert short.response.first.size < whole.response.first.size == reading.values.size
    # the part that is left out, over the root of the number of samples, and rounding
    np.testing.assert_allclose(short.score, whole.score, atol=1e-8 * np.abs(whole.score).max())
    np.testing.assert_allclose(short.information, whole.information, atol=1e-8 * np.abs(whole.information).max())


def test_products_of_responses_at_neighbouring_samples(rng):
    reading = reading_of([], rng, seconds=0.1)
    scan = Scan.of(reading, filter_of(reading), columns_of([], reading))
    count = scan.score.size
    response = scan.response.whole(count)
    whole = np.array([np.append(np.zeros(place), response[: count - place]) for place in range(count)])
    for place in (1, 2, 77, count - 2):
        expected = whole @ whole[place - 1 : place + 2].T
        assert scan._products(place) == pytest.approx(expected, abs=1e-12 * np.max(expected))
