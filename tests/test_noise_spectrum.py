"""Noise with a color: its spectrum as states, learned from a record of noise alone, and what it does to a force."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal

from aerobalance.estimation.spectra import banded_noise, noise_ordinates, noise_record
from aerobalance.estimation.spectra.noise_record import noise_spectrum_of
from aerobalance.estimation.spectra.noise_spectrum import EXPONENTS, Band, ColoredNoise, Hump, NoiseSpectrum
from aerobalance.estimation.statespace.kalman import KalmanFilter, StateSpace
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.recording.errors import DataQualityWarning, FitError
from helpers.cable_cut import T128
from helpers.coloured_noise import RATE, WHITE, noise_of
from seeds import trials


def known(corner: float = 10.0, exponent: float = 1.0, *, humps: tuple[Hump, ...] = ()) -> NoiseSpectrum:
    return NoiseSpectrum(WHITE, corner, exponent, humps, 1 / RATE, np.zeros((2, 2)))


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.5, 2.0])
def test_states_have_the_spectrum(exponent):
    states = known(10.0, exponent).colored_part(5.0)
    frequency = np.geomspace(1.0, 700.0, 200)
    truth = known(10.0, exponent).density(frequency)
    # relaxations a factor 3 apart ripple by 1 %; from 1 Hz on the level part below 1/15 Hz bends it by
    # (1 / 15)^2 = 0.4 % at most; above the last corner the 1/f part itself is 1 % of the white
    assert WHITE + states.density(frequency) == pytest.approx(truth, rel=0.02)


def test_below_the_slowest_it_is_level():
    states = known(10.0, 1.0).colored_part(5.0)
    # (10 Hz / f) at 1 / (3 * 5 s), where 1 / sqrt(f^2 + f^2) bends it
    assert states.density(np.array([1e-4]))[0] == pytest.approx(WHITE * 150, rel=0.03)


def test_mean_density_is_the_integral():
    colored = ColoredNoise(np.array([0.1, 3.0, 500.0]), np.array([0.3, 0.2, 1.0]), (), 1 / RATE)
    for middle, width in ((0.0, 0.4), (0.2, 0.3), (40.0, 10.0)):
        area, _ = quad(lambda f: float(colored.density(np.array(f))), middle - width / 2, middle + width / 2)
        assert float(colored.density(np.array(middle), width=width)) == pytest.approx(area / width, rel=1e-6)
    # all of it is the variance
    assert float(colored.density(np.array(0.0), width=RATE)) * RATE == pytest.approx(1.5, rel=1e-9)


def test_hump_is_its_oscillator():
    hump = Hump(300.0, 0.4, 7.0)
    frequency = np.array([3.0, 250.0, 300.0, 420.0, 900.0])
    assert hump.shaping.spectrum(frequency) == pytest.approx(hump.density(frequency), rel=1e-9)
    assert hump.density(np.array([300.0]))[0] == pytest.approx(7.0)


def test_likelihood_is_that_of_the_covariance(rng):
    """The filter with states of colored noise against the Gaussian density with the covariance written out."""
    colored = ColoredNoise(np.array([2.0, 30.0]), np.array([1.5, 0.4]), (), 1 / RATE)
    system = StateSpace.of_balance(T128, ShapingFilter.silent(), interval=1 / RATE, noise=2.0, colors=colored.shapings)
    n = 60
    readings = rng.normal(0, 2, n)
    lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) / RATE
    covariance = 4 * np.eye(n)
    for corner, variance in zip(colored.corners, colored.variances, strict=True):
        covariance += variance * np.exp(-2 * np.pi * corner * lag)
    filter_ = KalmanFilter.of(system, np.ones(n, dtype=bool))
    white = filter_.whiten(readings[:, None])[:, 0]
    found = -0.5 * (white @ white + filter_.log_determinant + n * np.log(2 * np.pi))
    assert found == pytest.approx(multivariate_normal(np.zeros(n), covariance).logpdf(readings), rel=1e-8)


def test_slopes_of_the_density_are_its_differences(rng):
    seen = noise_ordinates.Ordinates.of(rng.normal(0, 2, 4000), T128, interval=1 / RATE)
    point = np.concatenate([np.log([WHITE, 10 * WHITE]), [1.3], np.log([300.0, 0.4, 2 * WHITE, 500.0, 1.5, WHITE])])
    slopes, small = noise_record.slopes_of(point, seen), 1e-5
    for place, slope in enumerate(slopes):
        late, early = (
            noise_record.model_of(point + sign * small * np.eye(point.size)[place], seen) for sign in (1, -1)
        )
        # third differences times the square of the step, 1e-10 times some hundreds of a hump's flank; rounding is less
        assert slope == pytest.approx((late - early) / (2 * small), abs=1e-7 * WHITE)


def test_white_noise_is_found_white(monkeypatch, rng):
    # chance brings an evidence of 15 once in exp(15) records
    monkeypatch.setattr(noise_record, "COLOR_EVIDENCE", 15.0)
    found = noise_spectrum_of(rng.normal(0, 2, 16_000), T128, interval=1 / RATE)
    assert not found.colored
    assert found.colored_part(5.0) is None
    assert str(found) == "white noise"
    # 16,000 readings: 0.56 % of the standard deviation; 5 of these and what the modes' bands take
    assert found.deviation == pytest.approx(2, rel=0.035)
    assert found.u_white == pytest.approx(np.sqrt(2 / 16_000), rel=0.2)


@pytest.mark.parametrize("exponent", [0.7, 1.0, 1.5])
def test_corner_is_found(exponent, rng):
    values = noise_of(rng, lambda f: WHITE * (1 + (10 / f) ** exponent))
    found = noise_spectrum_of(values, T128, interval=1 / RATE)
    assert found.corner > 0
    level = np.log(found.white) + found.exponent * np.log(found.corner)
    truth = np.log(WHITE) + exponent * np.log(10)
    # Whittle's likelihood is normal for that many ordinates; six of its standard deviations
    assert abs(level - truth) < 6 * np.sqrt(found.covariance[0, 0])
    assert abs(found.exponent - exponent) < 6 * np.sqrt(found.covariance[1, 1])
    assert abs(np.log(found.white / WHITE)) < 6 * found.u_white
    assert f"below {found.corner:.3g} Hz" in str(found)


def test_random_walk_is_the_steepest(rng):
    values = noise_of(rng, lambda f: WHITE * (1 + (3 / f) ** 2))
    found = noise_spectrum_of(values, T128, interval=1 / RATE)
    assert 1.2 < found.exponent <= EXPONENTS[1]


def test_hump_is_found_beside_a_corner(rng):
    hump = Hump(300.0, 0.4, 2 * WHITE)
    values = noise_of(rng, lambda f: WHITE * (1 + 10 / f) + hump.density(f))
    found = noise_spectrum_of(values, T128, interval=1 / RATE)
    assert found.humps
    frequency = np.array([2.0, 20.0, 150.0, 250.0, 300.0, 400.0, 700.0])
    truth = WHITE * (1 + 10 / frequency) + hump.density(frequency)
    # at 2 Hz the 40 ordinates to 4 Hz tell it to 0.16, above there are hundreds; five of these
    bounds = np.array([0.8, 0.4, 0.25, 0.25, 0.25, 0.25, 0.25])
    assert np.all(np.abs(np.log(found.density(frequency) / truth)) < bounds)


def test_no_corner_is_found_beside_a_hump_alone():
    """Chance brings its evidence in one of 400 records."""
    hump = Hump(300.0, 0.4, 2 * WHITE)
    for seed in range(4):
        values = noise_of(np.random.default_rng(seed), lambda f: WHITE + hump.density(f), longer=2)
        found = noise_spectrum_of(values, T128, interval=1 / RATE)
        assert len(found.humps) == 1
        assert not found.corner


def test_swinging_and_mains_are_no_noise(rng):
    t = np.arange(16_000) / RATE
    values = rng.normal(0, 2, t.size) + 3 * np.sin(2 * np.pi * 50 * t) + np.sin(2 * np.pi * 410 * t)
    values += 20 * np.exp(-t) * np.cos(2 * np.pi * T128.natural_frequency * t)
    found = noise_spectrum_of(values, T128, interval=1 / RATE)
    assert found.deviation == pytest.approx(2, rel=0.035)
    assert found.left_out == pytest.approx((50.0, 410.0), abs=0.2)
    assert not found.humps
    # the mains go on in a run, at a phase that is not known: as a line of their power
    (line,) = found.hum
    assert line.frequency == pytest.approx(50, abs=0.01)
    frequency = np.linspace(30, 70, 40_001)
    power = 2 * np.trapezoid(line.density(frequency), frequency)
    # beyond 20 Hz there is 1 % of it; noise of 2 in 16,000 readings makes an amplitude of 3 uncertain by 0.022 and so
    # its power by 1.5 %: five of these
    assert power == pytest.approx(3**2 / 2, rel=0.085)
    # averaged over the width of an ordinate it has the same
    wide = found.colored_part(5.0).density(np.arange(30.0, 70.0, 0.4), width=0.4)
    assert 2 * 0.4 * wide.sum() == pytest.approx(power, rel=0.02)


def test_mains_that_drift_are_told_by_their_power(rng):
    t = np.arange(16_000) / RATE
    values = rng.normal(0, 2, t.size) + 3 * np.sin(2 * np.pi * 60 * t + np.sin(2 * np.pi * 0.3 * t))
    (line,) = noise_spectrum_of(values, T128, interval=1 / RATE).hum
    assert line.frequency == pytest.approx(60, abs=0.15)  # by up to 0.3 Hz, for three swings
    frequency = np.linspace(20, 100, 40_001)
    # as above; the line and what it swings to are 25,000 times the white noise
    assert 2 * np.trapezoid(line.density(frequency), frequency) == pytest.approx(3**2 / 2, rel=0.085)
    assert noise_spectrum_of(rng.normal(0, 2, t.size), T128, interval=1 / RATE).hum == ()


def test_a_harmonic_of_both_mains_is_told_once(rng):
    """Of 50 Hz and of 60 Hz: 300 and 600 Hz, which a six-pulse rectifier makes, as the mains drift."""
    rate = 2000.0
    t = np.arange(60_000) / rate
    phase = 2 * np.pi * 50 * t + 0.0035 * np.cumsum(rng.normal(size=t.size))
    values = rng.normal(size=t.size) + 0.5 * np.sin(6 * phase) + 0.3 * np.sin(12 * phase)
    found = noise_spectrum_of(values, T128, interval=1 / rate)
    assert sorted(round(line.frequency / 10) for line in found.hum) == [30, 60]
    frequency = np.linspace(250, 350, 40_001)
    # the phase walks by 0.5 rad in a fifth of a second, 150 times in the record: power by 1 / 150^(1/2) = 8 %
    power = 2 * np.trapezoid(found.density(frequency) - found.white, frequency)
    assert power == pytest.approx(0.5**2 / 2, rel=3 * 0.08)


def test_an_edge_of_a_band_is_no_line(rng):
    """At multiples of the frequencies of the mains, and as high as the noise beside it is low."""
    values = noise_of(rng, lambda f: WHITE * np.where((f >= 250) & (f <= 350), 51.0, 1.0))
    seen = noise_ordinates.Ordinates.of(values, T128, interval=1 / RATE)
    assert seen.hum == ()
    assert seen.lines == ()
    inside = (seen.frequency > 252) & (seen.frequency < 348)
    # a thousand ordinates, nine tenths of them as good as independent: six standard deviations
    assert np.average(seen.density[inside], weights=seen.weight[inside]) == pytest.approx(51 * WHITE, rel=0.2)


def test_longest_stretch_is_taken(rng):
    values = rng.normal(0, 50, 4000)
    values[1000:] = rng.normal(0, 2, 3000)
    values[999] = np.nan
    # 3,000 readings: 1.3 % of the standard deviation
    assert noise_spectrum_of(values, T128, interval=1 / RATE).deviation == pytest.approx(2, rel=0.08)


def test_noise_that_nothing_follows_is_told(rng):
    """As 1 / f^4 below 5 Hz: no 1/f part is as steep, and 16 ordinates there are no band."""
    values = noise_of(rng, lambda f: WHITE * (1 + (5 / f) ** 4))
    with pytest.warns(DataQualityWarning, match="no white noise with 1/f, broad humps and bands"):
        noise_spectrum_of(values, T128, interval=1 / RATE)


def between(first: float, last: float, level: float):
    return lambda f: np.where((f >= first) & (f <= last), level * WHITE, 0.0)


def learned(rng, density, *, n: int = 16_000) -> NoiseSpectrum:
    """What is found, with no word on a lack of fit."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataQualityWarning)
        return noise_spectrum_of(noise_of(rng, density, n=n), T128, interval=1 / RATE)


@pytest.mark.parametrize("n", [8_000, 16_000, 96_000])
@pytest.mark.parametrize(("corner", "level"), [(0.0, 2.0), (0.0, 50.0), (20.0, 50.0)])
@pytest.mark.soak(first=3)
def test_band_is_found_with_its_edges(rng, n, corner, level):
    """Its edges at multiples of 50 Hz, where a step of the density is no line of the mains."""
    found = learned(rng, lambda f: WHITE * (1 + corner / f) + between(250, 350, level)(f), n=n)
    (band,) = found.bands
    assert not found.humps
    assert not found.hum
    assert found.left_out == ()
    assert bool(found.corner) == bool(corner)
    # an edge is missed by so many ordinates that the log-likelihood says it: of each log r - 1 + 1 / r on average (3
    # at 51 to 1, 0.43 at 3 to 1) against chance, by 13 at worst for 6 standard deviations; and the window smears two
    ratio = 1 + level
    ordinate = RATE / n
    missed = (18 / (np.log(ratio) - 1 + 1 / ratio) + 2) * ordinate
    assert band.first == pytest.approx(250, abs=missed)
    assert band.last == pytest.approx(350, abs=missed)
    # n / 8 ordinates are in it, of which nine tenths are as good as independent; their mean to six of its deviations
    spread = 6 / np.sqrt(0.9 * n / 16)
    assert band.level + found.white == pytest.approx(ratio * WHITE, rel=spread)
    assert found.white == pytest.approx(WHITE, rel=6 / np.sqrt(0.3 * n))
    assert f"{band.level / found.white:.3g} times its density between" in str(found)


@pytest.mark.parametrize("fallen", [0.02, 1e-3, 1e-6])
@pytest.mark.parametrize("corner", [0.0, 20.0])
def test_cut_of_a_digital_filter_ends_the_slow_part_as_well(rng, corner, fallen):
    found = learned(rng, lambda f: WHITE * (1 + corner / f) * np.where(f > 760, fallen, 1.0))
    assert not found.humps
    frequency = np.array([3.0, 30.0, 200.0, 500.0, 750.0, 775.0, 795.0])
    truth = WHITE * (1 + corner / frequency) * np.where(frequency > 760, fallen, 1.0)
    # 400 ordinates beyond the cut, and 30 to 3 Hz: six of their standard deviations
    bounds = 6 / np.sqrt([30, 150, 2000, 2000, 2000, 350, 350])
    assert np.all(np.abs(np.log(found.density(frequency) / truth)) < bounds)
    assert (f"1/f^{found.exponent:.2g} below" in str(found)) == bool(corner)
    if corner:
        # what is told is where the slow part falls below the rest, not below what the filter leaves
        told = float(str(found).split("below ")[1].split(" Hz")[0])
        assert np.log(told / corner) == pytest.approx(0, abs=0.6)


@pytest.mark.parametrize("fallen", [1.0, 0.01])
def test_noise_of_a_converter_that_rises_as_a_power_is_one_band(rng, fallen):
    """Shaped noise of the second order: as f^4 up to 0.98 of half the rate."""
    top = 784.0
    found = learned(rng, lambda f: WHITE * np.where(f < top, 1 + 100 * (f / top) ** 4, fallen))
    (band,) = (one for one in found.bands if one.exponent)
    assert not found.humps
    assert band.last == pytest.approx(top, abs=1.0)
    # a straight line through the logarithms of some 5,000 ordinates from 400 Hz on, where it is more than half of the
    # noise: their logarithm of frequency has a deviation of 0.2, so 0.07 of the exponent; six of these
    assert band.exponent == pytest.approx(4, abs=0.42)
    frequency = np.array([100.0, 300.0, 500.0, 700.0, 780.0])
    truth = WHITE * (1 + 100 * (frequency / top) ** 4)
    assert np.all(np.abs(np.log(found.density(frequency) / truth)) < 0.15)


@pytest.mark.soak(first=0)
def test_smooth_noise_has_no_edges():
    """A hump of any height, a corner, both, and white noise: chance makes no bands of them."""
    hump, high = Hump(300.0, 0.4, 2 * WHITE), Hump(300.0, 0.2, 50 * WHITE)
    shapes = (
        lambda f: WHITE + 0 * f,
        lambda f: WHITE * (1 + 10 / f),
        lambda f: WHITE + hump.density(f),
        lambda f: WHITE + high.density(f),
        lambda f: WHITE * (1 + 10 / f) + hump.density(f),
    )
    for seed in range(trials(4, 10)):
        for number, shape in enumerate(shapes):
            values = noise_of(np.random.default_rng(seed), shape, longer=2)
            found = noise_spectrum_of(values, T128, interval=1 / RATE)
            assert found.bands == ()
            assert bool(found.humps) == (number >= 2)
            assert bool(found.corner) == (number in (1, 4))


def test_slopes_of_bands_are_differences(rng):
    seen = noise_ordinates.Ordinates.of(rng.normal(0, 2, 4000), T128, interval=1 / RATE)
    numbers = np.concatenate([np.log([WHITE, 10 * WHITE]), [1.3, np.log(3 * WHITE), 0.0, np.log(20 * WHITE), 3.0]])
    edges = np.array([[0.0, 500.0], [300.0, 700.0]])
    noise = banded_noise.BandedNoise(numbers, edges, np.array([False, True]), 600.0)
    slopes, small = noise.slopes(seen, noise.parts(seen)), 1e-5
    for place in np.flatnonzero(noise.free):
        late, early = (
            replace(noise, numbers=numbers + sign * small * np.eye(numbers.size)[place]).model(seen)
            for sign in (1, -1)
        )
        # as of humps, above
        assert slopes[place] == pytest.approx((late - early) / (2 * small), abs=1e-7 * WHITE)


@pytest.mark.parametrize("over", [50.0, 1e3, 1e5])
@pytest.mark.parametrize(
    ("first", "last", "exponent"), [(250.0, 350.0, 0.0), (0.0, 760.0, 0.0), (400.0, 784.0, 4.0), (500.0, 800.0, 0.0)]
)
def test_states_follow_bands(first, last, exponent, over):
    """Within the band to 5 %; beside it the process leaves the white part to a fifth, however strong the band is."""
    noise = replace(known(0.0), bands=(Band(first, last, over * WHITE, exponent),))
    color = noise.colored_part(5.0)
    frequency = np.linspace(1.0, RATE / 2 - 1, 4000)
    found, truth = WHITE + color.density(frequency), noise.density(frequency)
    # the edges are moved outward by 0.014 of the circle that frequency is bent on to, f = f_w tan(theta / 2),
    # with f_w at the strongest edge; a band that goes on beyond half the rate ends there too, and that is folded back
    centre = last if exponent or not first else first
    near = np.zeros(frequency.size, dtype=bool)
    for edge, place in ((first, first), (last, last), (RATE - first, first)):
        reach = 0.014 * centre / 2 * (1 + (edge / centre) ** 2)
        counts = 0 < place < RATE / 2 and (edge == place or last == RATE / 2)
        near |= counts & (np.abs(frequency - place) < reach)
    inside = (frequency >= first) & (frequency <= last)
    rising = truth > 2 * WHITE
    assert np.all(np.abs(np.log(found / truth))[inside & rising & ~near] < 0.05)
    assert np.all(np.abs(np.log(found / truth))[~inside & ~near] < 0.2)
    assert sum(shaping.order for shaping in color.shapings) <= 32
    # all of it by one ratio
    np.testing.assert_allclose(color.scaled(2.5).density(frequency), 2.5 * color.density(frequency), rtol=1e-9)


def test_all_of_a_color_is_scaled():
    hump = Hump(300.0, 0.4, 2 * WHITE)
    noise = replace(known(10.0, humps=(hump,)), bands=(Band(500.0, 700.0, 5 * WHITE),))
    color, frequency = noise.colored_part(5.0), np.array([0.5, 5.0, 300.0, 600.0])
    np.testing.assert_allclose(color.scaled(0.4).density(frequency), 0.4 * color.density(frequency), rtol=1e-9)


def test_what_is_no_record_of_noise_is_refused(monkeypatch, rng):
    with pytest.raises(FitError, match="400 readings of AF without a gap"):
        noise_spectrum_of(rng.normal(size=400), T128, interval=1 / RATE)
    with pytest.raises(FitError, match="does not change"):
        noise_spectrum_of(np.full(4000, 3.0), T128, interval=1 / RATE)
    monkeypatch.setattr(noise_ordinates, "STRENGTHENED", 0.5)
    with pytest.raises(FitError, match="nothing is left"):
        # up to 45 Hz the T-128 weakens no force
        noise_spectrum_of(rng.normal(size=1000), T128, interval=1 / 90.0)
    with pytest.raises(ValueError, match="must be positive"):
        NoiseSpectrum(0.0, 0.0, 1.0, (), 1 / RATE, np.zeros((2, 2)))
    with pytest.raises(ValueError, match="at most 2"):
        NoiseSpectrum(1.0, 3.0, 4.0, (), 1 / RATE, np.zeros((2, 2)))


def test_noise_without_a_slow_part_is_white_and_its_humps():
    hump = Hump(300.0, 0.4, 7.0)
    frequency = np.array([1.0, 250.0, 300.0, 700.0])
    alone = NoiseSpectrum(WHITE, 0.0, 1.0, (), 1 / RATE, np.zeros((2, 2)))
    np.testing.assert_array_equal(alone.density(frequency), np.full(4, WHITE))
    both = NoiseSpectrum(WHITE, 0.0, 1.0, (hump,), 1 / RATE, np.zeros((2, 2)))
    np.testing.assert_allclose(both.density(frequency) - WHITE, hump.sampled(frequency, 1 / RATE), rtol=1e-12)


def test_a_record_that_was_never_read_tells_no_noise():
    with pytest.raises(FitError, match="0 readings of AF without a gap"):
        noise_spectrum_of(np.full(10_000, np.nan), T128, interval=1 / RATE)
