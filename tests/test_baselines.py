"""Every baseline method against closed forms and on its home ground; scores and the truth's clock."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut, Sensor, band_noise
from aerobalance.validation.baselines import (
    BASELINES,
    LOW_PASS_ORDER,
    NOTCH_QUALITY,
    THIS,
    TUNED,
    BaselineSettings,
    accelerometer_correction,
    band_limited,
    central_differences,
    correction_factor,
    dominant_frequency,
    estimates,
    factor_and_phase,
    fir_deconvolution,
    low_pass,
    notch,
    raw_reading,
)
from aerobalance.validation.fir_inverse import (
    ORDER,
    MeasuredResponse,
    fir_inverse,
    fit_frequencies,
    response_of_record,
    undo,
)
from aerobalance.validation.scores import Truth, find_jumps, truth_on_clock
from helpers.cable_cut import T128

RATE = 1600.0


def recording(load, rate=RATE, **channels):
    time = np.arange(load.size) / rate
    units = {"pitch": "rad"}
    columns = {"AF": Channel("AF", load, "N")}
    columns |= {name: Channel(name, values, units.get(name, "m/s^2")) for name, values in channels.items()}
    return Recording.from_columns(time, columns, name="record")


def steady(frequency, amplitude=100.0, mean=30.0, seconds=4.0):
    """Balance load under a steady sine, in closed form, and the force that it comes from."""
    time = np.arange(round(seconds * RATE)) / RATE
    gain = T128.response(frequency)
    load = mean + amplitude * np.imag(gain * np.exp(2j * np.pi * frequency * time))
    return load, mean + amplitude * np.sin(2 * np.pi * frequency * time)


def inner(values):
    cut = values.size // 10
    return values[cut:-cut]


def amplitude_of(values, frequency):
    time = np.arange(values.size) / RATE
    basis = np.column_stack(
        [np.cos(2 * np.pi * frequency * time), np.sin(2 * np.pi * frequency * time), np.ones(time.size)]
    )
    return np.hypot(*np.linalg.lstsq(basis, values, rcond=None)[0][:2])


def test_raw_reading_is_the_reading_less_the_weight(rng):
    load, pitch = rng.normal(size=200), rng.normal(size=200) * 0.1
    got = raw_reading(recording(load, pitch=pitch), T128, BaselineSettings()).values
    assert got == pytest.approx(load - T128.mass * STANDARD_GRAVITY * np.sin(pitch), abs=1e-9)
    assert (raw_reading(recording(load), T128, BaselineSettings()).values == load).all()


@pytest.mark.parametrize("ratio", [0.3, 0.8, 1.0, 1.5])
def test_low_pass_attenuates_as_the_square_of_a_butterworth(ratio):
    corner = 40.0
    frequency = ratio * corner
    load, _ = steady(frequency)
    got = low_pass(recording(load), T128, BaselineSettings(tuning=corner)).values
    # forward and backward; the bilinear transform warps frequencies as the tangent
    warped = np.tan(np.pi * frequency / RATE) / np.tan(np.pi * corner / RATE)
    gain = 1 / (1 + warped ** (2 * LOW_PASS_ORDER))
    # the ends' transient is gone after a tenth of the record: exp(-2 pi 40 sin(22.5 deg) 0.4) = 2e-17
    assert amplitude_of(inner(got), frequency) == pytest.approx(gain * amplitude_of(load, frequency), rel=1e-9)


def test_low_pass_is_customarily_at_a_third_of_the_natural_frequency():
    load, _ = steady(5.0)
    assert low_pass(recording(load), T128, BaselineSettings()).tuning == pytest.approx(T128.natural_frequency / 3)


def test_notch_takes_the_natural_frequency_out_and_leaves_slow_loads():
    f0 = T128.natural_frequency
    at, slow = (notch(recording(steady(f)[0]), T128, BaselineSettings()) for f in (f0, f0 / 50))
    # a notch's transient decays at its half width, pi f0 / Q = 104 /s; forward and backward, after 0.4 s: 1e-18
    assert amplitude_of(inner(at.values), f0) < 1e-9 * amplitude_of(steady(f0)[0], f0)
    off = (1 / 50) / (1 - 1 / 50**2) / NOTCH_QUALITY  # |H|^2 of a notch: 1 / (1 + off^2), to first order in f0 / rate
    assert amplitude_of(inner(slow.values), f0 / 50) == pytest.approx(100 / (1 + off**2), rel=1e-3)


@pytest.mark.parametrize("frequency", [11.3, 60.0, T128.natural_frequency, 90.0])
def test_correction_factor_is_exact_for_a_steady_sine(frequency):
    load, force = steady(frequency)
    factor = correction_factor(recording(load), T128, BaselineSettings(tuning=frequency)).values
    shifted = factor_and_phase(recording(load), T128, BaselineSettings(tuning=frequency)).values
    # the record's mean is over no whole number of periods: (1/|G| - 1) times that is an offset, at most
    rest = abs(np.mean(load) - 30) * abs(1 / abs(T128.response(frequency)) - 1)
    assert amplitude_of(factor, frequency) == pytest.approx(100.0, rel=1e-9)
    # the window of the interpolation leaves 3e-6, a cubic spline on the finer clock (5/384) (2 pi f / (4 rate))^4
    moved = (3e-6 + 5 / 384 * (2 * np.pi * frequency / (4 * RATE)) ** 4) * 100
    assert np.abs(inner(shifted - force)).max() <= rest + moved


def test_dominant_frequency_lies_between_the_lines(rng):
    frequency, phase = rng.uniform(20, 300), rng.uniform(0, 2 * np.pi)
    time = np.arange(4000) / RATE
    found = dominant_frequency(7 + np.sin(2 * np.pi * frequency * time + phase), RATE)
    # the image at the negative frequency, more than 100 lines away, moves a Hann peak by less than 1e-4 of a line
    assert found == pytest.approx(frequency, abs=1e-4 * RATE / 4000)
    with pytest.raises(FitError, match="10 periods"):
        dominant_frequency(np.ones(100), RATE)


@pytest.mark.parametrize("coupling", ["kinematic", "dc"])
def test_accelerometer_correction_is_exact_for_kinematic_signals(coupling, rng):
    undamped = Dynamics("AF", 177.87, 3.093e7, 0.0)
    load, acceleration, pitch = rng.normal(size=(3, 300))
    force = load + undamped.mass * (acceleration - STANDARD_GRAVITY * np.sin(pitch))  # Newton's law, no damper
    reading = acceleration - STANDARD_GRAVITY * np.sin(pitch) if coupling == "dc" else acceleration
    record = recording(load, pitch=pitch)
    channels = {
        **record.channels,
        "live_acceleration": Channel("live_acceleration", reading, "m/s^2", coupling=coupling),
    }
    record = Recording.from_columns(record.time, channels)
    got = accelerometer_correction(record, undamped, BaselineSettings()).values
    assert got == pytest.approx(force, abs=1e-9 * np.abs(force).max())


def test_accelerometer_correction_lacks_only_the_damper_on_the_rig(rng):
    rig = CableCut(
        cable_force=0.0,
        applied=band_noise(rng, low=1, high=100, rms=300.0, period=4.0),
        sensors={name: Sensor() for name in ("AF", "live_acceleration", "pitch")},
    )
    run = rig.run(4.0, rng)
    got = accelerometer_correction(run.recording, rig.dynamics, BaselineSettings()).values
    damper = rig.dynamics.damping / rig.dynamics.stiffness * np.gradient(run.load, 1 / RATE)
    assert np.std(got - run.applied) > 0.5 * np.std(damper)
    # what differences of the load over two samples miss at f0: 1 - sinc(2 f0 / rate) = 1.1 % of the damper's force
    assert np.std(inner(got + damper - run.applied)) < 0.02 * np.std(damper)


def test_fir_inverse_of_a_delay_free_balance_is_a_delay():
    frequency = fit_frequencies(RATE)
    flat = MeasuredResponse(frequency, np.ones(frequency.size, dtype=complex), "flat")
    wanted = np.zeros(ORDER + 1)
    wanted[ORDER // 2] = 1.0
    # unknowns that the band of 0.4 of the rate hardly tells are set by rounding times the condition, some 1e6
    assert fir_inverse(flat, rate=RATE) == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("weighted", [False, True])
def test_fir_inverse_makes_its_normal_equations_hold(weighted, rng):
    frequency = fit_frequencies(RATE)
    weight = rng.uniform(0.5, 2, frequency.size) if weighted else None
    response = MeasuredResponse(frequency, T128.response(frequency), "model", weight)
    found = fir_inverse(response, rate=RATE, order=8, delay=4)
    basis = np.exp(-2j * np.pi / RATE * np.outer(frequency, np.arange(9)))
    miss = basis @ found - np.exp(-8j * np.pi * frequency / RATE) / response.values
    square = np.ones(frequency.size) if weight is None else weight**2
    slope = np.real(basis.conj().T @ (square * miss))
    assert np.abs(slope).max() < 1e-10 * np.abs(basis.T @ (square / response.values)).max()


def test_fir_inverse_gives_a_steady_sine_back():
    frequency = fit_frequencies(RATE)
    response = MeasuredResponse(frequency, T128.response(frequency), "model")
    coefficients = fir_inverse(response, rate=RATE)
    for f in (3.0, 60.0, T128.natural_frequency, 200.0):
        load, force = steady(f)
        angle = 2 * np.pi * f / RATE
        gain = coefficients @ np.exp(-1j * angle * (np.arange(ORDER + 1) - ORDER // 2))
        # what the fit misses at this frequency is what the force misses
        miss = abs(gain * T128.response(f) - 1) * 100 + abs(coefficients.sum() - 1) * 30
        assert np.abs(inner(undo(load, coefficients) - force)).max() < miss + 1e-6
        assert miss < 0.001 * 130  # 31 coefficients do it to a tenth of a percent of the force


@pytest.mark.parametrize("height", [1020.0, -500.0])
def test_response_of_a_noise_free_step(height):
    rig = CableCut(cable_force=-height, release=0.5003, sensors={"AF": Sensor()})
    response = response_of_record(
        rig.run(5.0, np.random.default_rng(0)).recording, "AF", natural_frequency=66.4, rate=RATE
    )
    assert "step response" in response.source
    low = response.frequency < 200
    apart = np.abs(response.values / rig.dynamics.response(response.frequency) - 1)
    # the slow response's own lag, b/k = 2 zeta / w0, counts as the event's instant: 2 zeta (f / f0) of phase; the ring
    # that is cut off has 1e-4 of its height; lines above half the rate fold back, (f / (rate - f))^2 = 2 % at 200 Hz
    phase = 2 * rig.dynamics.damping_ratio * response.frequency / rig.dynamics.natural_frequency
    folded = (response.frequency / (RATE - response.frequency)) ** 2
    assert (apart < phase + 2 * folded + 0.005)[low].all()


def test_response_of_a_noise_free_impulse():
    time = np.arange(8000) / RATE
    since = time - 0.50031
    load = (
        np.where(since > 0, np.exp(-T128.decay_rate * since) * np.sin(T128.damped_angular_frequency * since), 0) * 400
    )
    response = response_of_record(recording(load), "AF", natural_frequency=66.4, rate=RATE)
    assert "impulse response" in response.source
    low = response.frequency < 130
    # folding back of a response that falls as (f0/f)^2: (66/1470)^2 and its neighbours
    assert np.abs(response.values / T128.response(response.frequency) - 1)[low].max() < 0.05


def test_response_needs_an_event(rng):
    with pytest.raises(FitError, match="no step or impulse stands out"):
        response_of_record(recording(rng.normal(size=4000)), "AF", natural_frequency=66.4, rate=RATE)
    with pytest.raises(FitError, match="twice that"):
        response_of_record(recording(rng.normal(size=4000)), "AF", natural_frequency=66.4, rate=4 * RATE)


def smooth(generator, sensors=None, **more):
    return CableCut(
        cable_force=0.0,
        applied=band_noise(generator, low=0, high=100, rms=300.0, period=4.0),
        sensors=sensors or {"AF": Sensor(noise=2.0)},
        **more,
    ).run(4.0, generator)


def test_inverses_are_at_home_under_a_broadband_load(rng):
    run = smooth(rng)
    errors = {
        method.__name__: np.std(inner(method(run.recording, T128, BaselineSettings()).values - run.applied))
        for method in (raw_reading, low_pass, fir_deconvolution, band_limited, central_differences)
    }
    # noise gain of the inverse to twice f0 is 0.5, of central differences 35 (METHOD of the paper's section 5)
    assert errors["band_limited"] < 5.0, errors
    assert errors["fir_deconvolution"] < errors["low_pass"] / 4, errors
    assert errors["central_differences"] == pytest.approx(70.5, rel=0.15), errors
    assert errors["raw_reading"] > errors["low_pass"], errors


def test_low_pass_is_at_home_under_a_slow_load(rng):
    slow = CableCut(
        cable_force=0.0,
        applied=band_noise(rng, low=0, high=4, rms=300.0, period=4.0),
        sensors={"AF": Sensor(noise=10.0)},
    ).run(4.0, rng)
    found = {row.name: row for row in estimates(slow.recording, T128) if row.ran}
    rms = {name: np.std(inner(row.values - slow.applied)) for name, row in found.items()}
    assert rms["low-pass"] < 0.5 * rms["raw reading"], rms
    # white noise through a low-pass at 22 Hz of 800 keeps sqrt(22 / 800) of 10 N
    assert rms["low-pass"] == pytest.approx(10 * np.sqrt(22.1 / 800), rel=0.5), rms
    assert rms[THIS] < 1.2 * rms["low-pass"], rms


def test_gravity_and_ground_motion_are_taken_off(rng):
    run = smooth(
        rng,
        sensors={name: Sensor() for name in ("AF", "ground_acceleration", "live_acceleration", "pitch")},
        ground_acceleration=band_noise(rng, low=3, high=40, rms=1.0, period=4.0),
        pitch=lambda t: 0.1 * np.sin(2 * np.pi * 0.3 * t),
    )
    for method in (fir_deconvolution, central_differences, band_limited):
        error = inner(method(run.recording, T128, BaselineSettings()).values - run.applied)
        assert np.std(error) < 0.3 * 177.87, method.__name__  # the ground's motion alone is 178 N rms


def test_missing_channels_are_named():
    load, _ = steady(10.0, seconds=1.0)
    found = {
        row.name: row for row in estimates(recording(load + np.random.default_rng(1).normal(size=load.size)), T128)
    }
    assert "live_acceleration" in found["accelerometer correction"].lacking
    assert np.isnan(found["accelerometer correction"].values).all()
    assert [name for name, row in found.items() if not row.ran] == ["accelerometer correction"]
    assert list(found) == list(BASELINES)


def test_gaps_are_bridged(rng):
    load = steady(3.0, seconds=2.0)[0] + rng.normal(size=3200)
    load[1000:1003] = np.nan
    for row in estimates(recording(load), T128):
        if row.ran:
            assert np.isfinite(row.values).all(), row.name


def test_with_a_truth_the_tuned_are_shown_at_their_best_too(rng):
    run = smooth(rng)
    truth = Truth.of(run.applied, rate=RATE, natural_frequency=T128.natural_frequency)
    found = estimates(run.recording, T128, truth=truth)
    for name in TUNED:
        pair = [row for row in found if row.name == name and row.ran]
        if pair:
            customary, best = pair
            assert (customary.oracle, best.oracle) == (False, True)
            # the search ends within a step of its grid; the customary setting may lie on the optimum itself
            assert truth.score(best.values).rms <= 1.02 * truth.score(customary.values).rms, name


def test_scores_of_a_known_error():
    values = np.zeros(1000)
    values[500:] = 100.0
    truth = Truth.of(values, rate=1000.0, natural_frequency=100.0)
    assert truth.jumps == (500,)
    error = np.where(np.abs(np.arange(1000) - 500) <= 20, 3.0, 1.0)  # 20 ms, as two periods are no longer
    error[:50] = error[950:] = 1e6  # five percent at each end
    score = truth.score(values + error)
    assert (score.plateau, score.edge, score.largest) == (1.0, 3.0, 3.0)
    assert score.rms == pytest.approx(np.sqrt((859 + 41 * 9) / 900))
    assert score.mean == pytest.approx((859 + 41 * 3) / 900)
    assert truth.half_span == 50.0


@pytest.mark.parametrize("frequency", [1.0, 66.0, 200.0])
def test_smooth_loads_have_no_jumps(frequency, rng):
    time = np.arange(8000) / RATE
    assert find_jumps(np.sin(2 * np.pi * frequency * time), width=2) == ()
    assert find_jumps(band_noise(rng, low=0, high=frequency, rms=1.0, period=20.0)(time), width=2) == ()
    assert np.isnan(Truth.of(time, rate=RATE, natural_frequency=66.0).score(time).plateau)


def test_truth_on_its_clock():
    load, force = steady(5.0, seconds=1.0)
    record = recording(load)
    longer = Recording.from_columns(
        np.arange(-10, 1700) / RATE, {"AF": Channel("AF", np.arange(1710.0), "N")}, name="truth"
    )
    assert truth_on_clock(record, longer, "AF") == pytest.approx(np.arange(10, 1610.0), abs=1e-6)

    late = replace(record, channels={"AF": replace(record.channel("AF"), delay=3 / RATE)})
    # the force of three samples before; the truth of before its first sample is not known
    assert truth_on_clock(late, longer, "AF")[3:] == pytest.approx(np.arange(10, 1607.0), abs=1600 * 1e-6)

    def other(time, name="AF"):
        return Recording.from_columns(time, {name: Channel(name, np.resize(force, time.size), "N")}, name="truth")

    clock = record.time
    with pytest.raises(FitError, match=r"0\.3 of a sample apart"):
        truth_on_clock(record, other(clock + 0.3 / RATE), "AF")
    with pytest.raises(FitError, match="sampled at 800 Hz and record at 1600 Hz"):
        truth_on_clock(record, other(np.arange(900) / 800), "AF")
    with pytest.raises(FitError, match="not all of record"):
        truth_on_clock(record, other(clock[5:]), "AF")
    with pytest.raises(FitError, match="has no channel AF; it has SF"):
        truth_on_clock(record, other(clock, "SF"), "AF")


def test_fir_inverse_equals_that_of_pydynamic():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it says on import that it is archived
        module = pytest.importorskip("PyDynamic.model_estimation.fit_filter", reason="PyDynamic is not installed")
    frequency = fit_frequencies(RATE)
    response = T128.response(frequency)
    theirs, _ = module.LSFIR(
        H=np.concatenate([response.real, response.imag]),
        N=ORDER,
        f=frequency,
        Fs=RATE,
        tau=ORDER // 2,
        inv=True,
        verbose=False,
    )
    ours = fir_inverse(MeasuredResponse(frequency, response, "model"), rate=RATE)
    angle = 2 * np.pi * frequency / RATE
    basis = np.exp(-1j * np.outer(angle, np.arange(ORDER + 1)))
    condition = np.linalg.cond(np.vstack([basis.real, basis.imag]))
    size = np.abs(1 / response).max()
    # two solutions of one least-squares problem differ by rounding times the condition and the size of its right side
    assert np.abs(ours - theirs).max() < 100 * np.finfo(float).eps * condition * size
    # and within the band what they do agrees as well as the right side is known
    assert np.abs(basis @ (ours - theirs)).max() < 1e4 * np.finfo(float).eps * size
