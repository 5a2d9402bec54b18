"""Mains hum: found where it is, nothing taken where it is not, and out of the force."""

import warnings

import numpy as np
import pytest

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.checks.mains_hum import hidden_harmonics
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.spectra.line_noise import _line_of, _Near, hum_lines, load_harmonics
from aerobalance.estimation.spectra.lines import Line, columns_of_lines, reading_of_lines
from aerobalance.estimation.spectra.periodogram import Spectrum
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.recording.channel import Channel
from aerobalance.recording.doubts import Verdict
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from faults.cases import all_cases
from faults.cases import dynamics as known_dynamics
from faults.scene import FREQUENCY, Record
from helpers.cable_cut import T128
from seeds import trials

DYNAMICS = known_dynamics()
CASES = {case.name: case for case in all_cases()}
RATE = 1600.0
NOISE = 2.0


def clock(seconds: float) -> np.ndarray:
    return np.arange(round(seconds * RATE)) / RATE


def hum(
    generator: np.random.Generator, time: np.ndarray, frequency: float, amplitudes: dict[int, float]
) -> np.ndarray:
    """Harmonics of a frequency with random phases."""
    phases = generator.uniform(0, 2 * np.pi, len(amplitudes))
    return sum(
        size * np.sin(2 * np.pi * frequency * number * time + phase)
        for (number, size), phase in zip(amplitudes.items(), phases, strict=True)
    )


def record_of(load: np.ndarray) -> Recording:
    return Recording.from_columns(clock(load.size / RATE), {"AF": Channel("AF", load, "N")}, name="run")


@pytest.mark.parametrize("mains", [49.97, 50.02, 60.03])
def test_frequency_and_size_of_hum(mains, rng):
    time = clock(6)
    values = hum(rng, time, mains, {1: 12.0, 3: 6.0}) + rng.normal(0, NOISE, time.size)
    lines = hum_lines(values, 1 / RATE)
    assert len(lines) == 2, lines
    for line, (number, size) in zip(lines, ((1, 12.0), (3, 6.0)), strict=True):
        # Cramer-Rao: sqrt(6 / n) noise / (pi amplitude T) for the frequency, noise sqrt(2 / n) for the amplitude;
        # the Hann window sees half as much again and more of the frequency's: 10 of these
        bound = np.sqrt(6 / time.size) * NOISE / (np.pi * size * 6)
        assert abs(line.frequency - number * mains) < 10 * bound, line
        assert abs(line.amplitude - size) < 6 * NOISE * np.sqrt(2 / time.size), line


@pytest.mark.parametrize("count", [1000, 20_001])
def test_power_between_ordinates_is_the_sum_over_all_samples(count, rng):
    values = rng.normal(size=count) * np.hanning(count)
    places = 321 + np.array([-5.0, -1.0, -0.3, 0.0, 0.125, 2.0, 4.9])
    turns = np.exp(-2j * np.pi * np.outer(places, np.arange(count)) / count)
    # over half a part of 9 of 20,001 samples the phase of a place 5 ordinates off turns by 7e-3, whose square is lost
    exact = np.abs(turns @ values)
    assert np.max(np.abs(np.sqrt(_Near.of(values, 321).power(places)) - exact)) < 5e-5 * np.max(exact)


@pytest.mark.parametrize("cycles", [0.003, 0.03125, 0.31])
def test_line_is_that_of_least_squares(cycles, rng):
    values, weights = rng.normal(size=1001), np.hanning(1003)[1:-1] ** 2
    shapes = columns_of_lines([cycles], count=values.size, interval=1.0)
    root = np.sqrt(weights)[:, None]
    sine, cosine = np.linalg.lstsq(root * shapes, root[:, 0] * values, rcond=None)[0]
    assert _line_of(values, weights, cycles) == pytest.approx(cosine - 1j * sine, rel=1e-9)


def test_nothing_is_taken_from_noise(rng):
    # the evidence of an ordinate is 3 times its power over the noise, an exponential distribution: 40 is exp(-40 / 3),
    # and one of the fundamentals, or two harmonics, must be there
    for seconds in (1.0, 2.5, 7.0):
        assert hum_lines(rng.normal(0, NOISE, clock(seconds).size), 1 / RATE) == ()


@pytest.mark.parametrize("frequency", [48.0, 50.5, 66.4, 100.0])
def test_a_tone_elsewhere_is_not_hum(frequency, rng):
    # a harmonic alone is no hum either
    time = clock(6)
    values = hum(rng, time, frequency, {1: 30.0}) + rng.normal(0, NOISE, time.size)
    assert hum_lines(values, 1 / RATE) == ()


def triangle(time: np.ndarray, frequency: float, size: float) -> np.ndarray:
    return size * (4 * np.abs((frequency * time) % 1 - 0.5) - 1)


def read(force: np.ndarray, over: int) -> np.ndarray:
    """What the T-128 reads of a force that starts from rest, given over times as often."""
    return T128.balance_load(force - force[0], interval=1 / (over * RATE))[::over] + force[0]


def test_a_harmonic_of_a_load_that_repeats_is_not_hum(rng):
    # the 15th of 4 Hz is at 60 Hz: 8 * 200 / (15 pi)^2 = 0.72 N, which the balance makes 4.2 N
    over = 16
    force = triangle(np.arange(round(2.5 * RATE * over)) / (over * RATE), 4.0, 200.0)
    load = read(force, over) + rng.normal(0, NOISE, round(2.5 * RATE))
    found = estimate_force(record_of(load), T128)["AF"]  # a line that is taken for hum would be warned of
    assert found.hum == ()
    assert "hum" not in [doubt.kind for doubt in found.doubts]
    left = found.values - force[::over]
    size = abs(np.exp(-2j * np.pi * 60 * clock(2.5)) @ left) * 2 / left.size
    # by the noise of the readings: the deviation of an amplitude is noise sqrt(2 / n), over the response; 6 of these
    gain = abs(complex(T128.response(60.0)))
    assert size < 6 * NOISE * np.sqrt(2 / left.size) / gain


@pytest.mark.parametrize(
    "case", ["no load that repeats", "a load of another frequency", "hum that is stronger than the load's lines"]
)
def test_hum_is_no_harmonic_of_a_load(case, rng):
    # multiples of the mains lie in the middle of others too; 60 Hz is no multiple of 7.3 Hz; and 20 N at 60 Hz would
    # be a force of 3.5 N, between those at 52 and 68 Hz of 0.96 and 0.56 N
    time = clock(4)
    force = {"n": 0 * time, "a": triangle(time, 7.3, 200.0), "h": triangle(time, 4.0, 200.0)}[case[0]]
    values = read(force, 1) + hum(rng, time, 60.0, {1: 20.0, 2: 10.0, 3: 6.0}) + rng.normal(0, NOISE, time.size)
    lines = hum_lines(values, 1 / RATE)
    assert [round(line.frequency) for line in lines] == [60, 120, 180]
    assert load_harmonics(values, 1 / RATE, lines, T128.response) == ()


def test_a_line_that_comes_or_fades_is_not_hum(rng):
    time = clock(6)
    noise, line = rng.normal(0, NOISE, time.size), hum(rng, time, 50.0, {1: 30.0})
    assert hum_lines(line * (time > 3) + noise, 1 / RATE) == ()
    assert hum_lines(line * np.exp(-time) + noise, 1 / RATE) == ()


def test_a_load_that_is_stronger_is_not_hum(rng):
    time = clock(6)
    spectrum = np.where(np.fft.rfftfreq(2 * time.size, 1 / RATE) < 120, 1.0, 0.0)
    phasors = rng.normal(size=(2, spectrum.size)) * spectrum
    load = np.fft.irfft(phasors[0] + 1j * phasors[1], 2 * time.size)[: time.size]
    load *= 500 / load.std()  # 2100 N^2/Hz of 6 s: a line of 12 N is a twelfth of one ordinate's 37 N, squared
    values = load + hum(rng, time, 50.0, {1: 12.0}) + rng.normal(0, NOISE, time.size)
    assert hum_lines(values, 1 / RATE) == ()


def test_given_lines_are_taken_and_none_when_all_are_kept(rng):
    time = clock(4)
    values = hum(rng, time, 83.3, {1: 20.0}) + hum(rng, time, 50.0, {1: 5.0})
    values += rng.normal(0, NOISE, time.size)
    (line,) = hum_lines(values, 1 / RATE, hum=(83.3,))
    assert line.frequency == pytest.approx(83.3, abs=0.01)
    assert hum_lines(values, 1 / RATE, hum="keep") == ()


def test_lines_that_cannot_be_told_apart_are_refused():
    values = np.random.default_rng(0).normal(size=3200)
    with pytest.raises(ValueError, match="closer"):
        hum_lines(values, 1 / RATE, hum=(50.0, 50.5))
    with pytest.raises(ValueError, match="inside 0 to 800"):
        hum_lines(values, 1 / RATE, hum=(900.0,))
    with pytest.raises(ValueError, match="mains, keep or frequencies"):
        hum_lines(values, 1 / RATE, hum="50")  # type: ignore[arg-type]


def test_lines_and_their_columns_agree():
    time = clock(2)
    values = 3 * np.sin(2 * np.pi * 50 * (time - time.mean())) + 4 * np.cos(2 * np.pi * 50 * (time - time.mean()))
    lines = hum_lines(values + 1e-9 * np.random.default_rng(0).normal(size=time.size), 1 / RATE)
    assert (lines[0].sine, lines[0].cosine, lines[0].amplitude) == pytest.approx((3, 4, 5), abs=1e-4)
    columns = columns_of_lines([50.0], count=time.size, interval=1 / RATE)
    assert columns @ [3, 4] == pytest.approx(values, abs=1e-9)
    assert reading_of_lines(lines, count=time.size, interval=1 / RATE) == pytest.approx(values, abs=1e-3)


@pytest.mark.parametrize("stepped", [False, pytest.param(True, marks=pytest.mark.long)])
def test_force_is_what_it_is_without_hum(stepped, rng):
    time = clock(3)
    force = 300 * (time > 1.2003) if stepped else 200 * np.sin(2 * np.pi * 7.3 * time)
    load = 300 * T128.step_response(time - 1.2003) if stepped else T128.balance_load(force, interval=1 / RATE)
    load = load + rng.normal(0, NOISE, time.size)
    lines = hum(rng, time, 50.02, {1: 12.0, 3: 6.0, 5: 3.0})
    clean = estimate_force(record_of(load), T128).only
    with pytest.warns(DataQualityWarning, match=r"50\.0.* Hz .* taken for mains hum and not for force"):
        found = estimate_force(record_of(load + lines), T128).only
    assert clean.hum == ()
    assert len(found.hum) == 3, found.hum
    assert len(found.steps) == len(clean.steps)
    inner = slice(time.size // 20, -time.size // 20)
    difference = np.abs(found.values - clean.values)[inner]
    # two parts of three lines are worked out from what the noise leaves: the difference is a part of the uncertainty
    # of either, in which the constant, two edges of a spectrum and the lines have a few of 4800 samples each
    assert np.sqrt(np.mean(difference**2)) < np.sqrt(np.mean(found.uncertainty[inner] ** 2))
    quiet = load + lines - reading_of_lines(found.hum, count=load.size, interval=1 / RATE)
    assert np.std(quiet - load) < 6 * NOISE * np.sqrt(9 / time.size)


def test_keeping_hum_leaves_it_in_the_force(rng):
    time = clock(3)
    values = hum(rng, time, 50.0, {1: 20.0}) + rng.normal(0, NOISE, time.size)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataQualityWarning)
        kept = estimate_force(record_of(values), T128, hum="keep").only.values
        taken = estimate_force(record_of(values), T128, hum=(50.0,)).only.values
    # the balance enlarges 50 Hz by 1 / (1 - (50 / 66.4)^2) = 2.3
    gain = float(np.abs(T128.response(np.array([50.0])))[0])
    inner = slice(480, -480)
    assert np.std(kept[inner]) == pytest.approx(20 / gain / np.sqrt(2), rel=0.1)
    assert np.std(taken[inner]) < 0.5
    with pytest.raises(ValueError, match="only the smoother"):
        estimate_force(record_of(values), T128, hum=(50.0,), bandwidth=100.0)


def test_a_drive_at_a_frequency_of_the_mains_stays_a_force(rng):
    time = clock(4)
    wave = 300 * np.exp(2j * np.pi * 60.0 * time + 1j * rng.uniform(0, 2 * np.pi))
    load = (wave * T128.response(60.0)).real + rng.normal(0, NOISE, time.size)
    with pytest.warns(DataQualityWarning, match=r"Hz .* lie where the mains do, .* taken for force"):
        found = estimate_force(record_of(load), T128).only
    assert found.hum == ()
    inner = slice(640, -640)
    amplitude = 2 * np.mean(found.values[inner] * np.exp(-2j * np.pi * 60.0 * time[inner]))
    assert abs(abs(amplitude) - 300) < 2.0  # 0.1 % of half range, as for any other tone


def beside(record: Record, rng: np.random.Generator, amplitudes: dict[int, float]) -> Force:
    """Return the force of a record with hum of 50.01 Hz added to its reading."""
    load = record.columns["AF"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # the lines that are seen are told
        return estimate_force(record_of(load + hum(rng, clock(load.size / RATE), 50.01, amplitudes)), DYNAMICS)


@pytest.mark.soak(first=0)
def test_hum_that_the_load_hides_is_counted_where_its_harmonics_are_seen():
    """The fundamental of 30 N is in the load's band, and 15 and 6 N at 150 and 250 Hz are not."""
    # as a force it has 30 N over the gain, and over the root of two
    error = 30 * (1 - (50 / FREQUENCY) ** 2) / 2**0.5
    case, squares = CASES["0-60 Hz, 60 N"], []
    for seed in range(trials(4, 20)):
        found = beside(case.record(seed), np.random.default_rng(seed), {1: 30.0, 3: 15.0, 5: 6.0})
        assert [doubt.kind for doubt in found["AF"].doubts] == ["hum"]
        assert found.verdict is not Verdict.FIT
        squares.append(np.mean(found["AF"].uncertainty ** 2))
    # what the load has there beside it, 60 N in 60 Hz over 2.5 s with a Hann window, adds in quadrature what it does
    # to the amplitude and its own variance, and scatters a single one by as much
    load = 60**2 / 60 / 2.5 * 1.5
    assert 0.6 * error < np.sqrt(np.mean(squares)) < 1.4 * np.sqrt(error**2 + 2 * load)


def test_harmonics_that_nothing_hides_add_nothing_to_the_uncertainty():
    """Lines that are seen tell the rest by what is read: a slow load has no power at 50 Hz."""
    case = CASES["0-20 Hz, 60 N"]
    record = case.record(0)
    calm = beside(record, np.random.default_rng(0), {})["AF"]
    found = beside(record, np.random.default_rng(0), {1: 3.0, 3: 2.0})["AF"]
    assert len(found.hum) == 2
    assert not found.doubts
    assert np.mean(found.uncertainty**2) < 1.05 * np.mean(calm.uncertainty**2)


def test_what_a_force_may_hide_is_bounded_by_what_is_read_and_by_the_lines_that_are_seen():
    """Under a force of density S an amplitude has 4 S / dt over n, half as much again by the window."""
    count, line = 4000, Line(150.0, 0.0, 2.0, 0.001, 1e4)
    density = 0.5
    stiff = Dynamics("AF", 1.0, (2 * np.pi * 1e5) ** 2, 1e3)  # reads what acts
    spectrum = Spectrum(np.array([120.0]), np.array([density]))
    learned = SpectralPrior(spectrum, ShapingFilter.silent(), 1e-3)
    reading = Observation(np.zeros(count), 1 / RATE, stiff)
    other = 1.5 * 4 * density * RATE / count
    for read in (0.0, 4.0):
        left = read * np.cos(2 * np.pi * 50 * (np.arange(count) - (count - 1) / 2) / RATE)
        (first, second, *more) = hidden_harmonics(reading, learned, left, lines=[line])
        for found, number, shown in ((first, 1, read**2), (second, 2, 0.0)):
            before = (2.0 * 3 / number) ** 2  # the third has 2 N, and harmonics fall as one over their number
            square = (before / (before + other)) ** 2 * shown + before * other / (before + other)
            assert found == pytest.approx((50.0 * number, np.sqrt(square / 2)), rel=1e-3)
        # 200 Hz and on are above the force
        assert [round(frequency) for frequency, _ in more] == [*range(200, 800, 50)]
        assert max(size for _, size in more) == 0


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_a_steady_tone_of_the_load_at_the_mains_is_in_the_uncertainty(seed):
    """Within the load's band a line of hum has the size of a tone of the force: each is as likely."""
    rng = np.random.default_rng(seed)
    count, interval, n = 4000, 1 / RATE, 16000
    frequency = np.fft.rfftfreq(n, interval)
    lines = (rng.normal(size=frequency.size) + 1j * rng.normal(size=frequency.size)) * (frequency < 80)
    lines *= 60 / np.std(np.fft.irfft(lines, n))
    # 35 N at 50 Hz, a line of the period of the long record, at a phase of its own
    lines[round(50 * n * interval)] = 35 * n / 2 * np.exp(1j * rng.uniform(0, 6))
    force, load = (np.fft.irfft(part, n)[:count] for part in (lines, lines * T128.response(frequency)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        found = estimate_force(record_of(load + rng.normal(0, 1.0, count)), T128)
    error = np.sqrt(np.mean((found.only.values - force) ** 2))
    # taken for hum, 35 N / 2^1/2 are missing and half of their square is counted, besides what else is not known
    assert error < 1.5 * np.sqrt(np.mean(found.only.uncertainty**2))
    if found.only.hum:
        assert [doubt.kind for doubt in found.doubts] == ["hum"]
        assert found.verdict is not Verdict.FIT
