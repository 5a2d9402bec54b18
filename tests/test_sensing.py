"""Filters, corners and cross-axis sensitivities are undone: sines in closed form, and what their uncertainty adds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.estimation.force import estimate_force
from aerobalance.motion.single_axis import GroundMotion
from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import QUANTITIES, Channel, CrossAxis
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import LEAST_GAIN, corrected, late_samples, undone_with
from helpers.cable_cut import T128

RATE = 1600.0
FREQUENCY = 40.0  # no mains hum
TIME = np.arange(4001) / RATE  # 100 whole periods, so that the record goes on as a sine at both ends
INNER = slice(400, -400)
# The magnitude that is made up for has two kinks in frequency, at most 0.5 per Hz in slope (order 8, 45 Hz), so a
# disturbance dies away as 2 * 0.5 / (2 pi t)^2 / 1600: 5e-5 at t = 0.56 s, from the inner part to where the record
# fades.
CLOSE = 1e-4


def record(**channels) -> Recording:
    """A recording at 1600 Hz; a channel is an array, or an array and its settings."""
    built = {}
    for name, content in channels.items():
        values, settings = content if isinstance(content, tuple) else (content, {})
        built[name] = Channel(name, values, QUANTITIES[name], **settings)
    return Recording.from_columns(np.arange(next(iter(built.values())).values.size) / RATE, built, name="test record")


def sine(response: complex, amplitude: float = 1.0, phase: float = 0.0) -> np.ndarray:
    """Steady response to a sine, in closed form."""
    swing = amplitude * response * np.exp(1j * (2 * np.pi * FREQUENCY * TIME + phase))
    return np.imag(swing)


@pytest.mark.parametrize("order", [1, 4, 8, 24])
def test_butterworth_is_the_product_of_its_poles(order):
    ratio = np.array([0.0, 0.1, 0.7, 1.0, 1.6, 3.0])
    angles = np.pi * (2 * np.arange(order) + order + 1) / (2 * order)
    expected = np.prod([-pole / (1j * ratio - pole) for pole in np.exp(1j * angles)], axis=0)
    found = AntiAlias("butterworth", order, 500.0).response(500.0 * ratio)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    np.testing.assert_allclose(np.abs(found) ** 2, 1 / (1 + ratio ** (2 * order)), rtol=1e-9)


def test_bessel_of_order_two():
    """3 / (s^2 + 3 s + 3) is 3 dB low at w^2 = (sqrt(45) - 3) / 2."""
    w = np.sqrt((np.sqrt(45.0) - 3) / 2)
    ratio = np.array([0.0, 0.2, 1.0, 2.5])
    s = 1j * w * ratio
    np.testing.assert_allclose(AntiAlias("bessel", 2, 80.0).response(80.0 * ratio), 3 / (s**2 + 3 * s + 3), rtol=1e-9)


@pytest.mark.parametrize("kind", ["butterworth", "bessel"])
@pytest.mark.parametrize("corner", [45.0, 100.0, 500.0])
def test_a_sine_through_the_filter_comes_back(kind, corner):
    low_pass = AntiAlias(kind, 8, corner)
    response = complex(low_pass.response(FREQUENCY))
    read = sine(response, phase=-np.angle(response))
    found = corrected(record(ground_acceleration=(read, {"filter": low_pass}))).channel("ground_acceleration")
    assert abs(response) >= LEAST_GAIN
    np.testing.assert_allclose(found.values[INNER], sine(1.0, phase=-np.angle(response))[INNER], atol=CLOSE)
    assert found.filter is None


@pytest.mark.parametrize("order", [1, 2, 8])
def test_samples_that_a_filter_is_undone_with(order):
    """Poles of a Butterworth low-pass lie on a circle, the slowest at sin(pi / 2n) of it from the imaginary axis."""
    slow, fast = AntiAlias("butterworth", order, 5.0), AntiAlias("bessel", 4, 200.0)
    decay = 2 * np.pi * 5.0 * np.sin(np.pi / (2 * order))
    assert slow.decay == pytest.approx(decay, rel=1e-9)
    both = record(ground_acceleration=(np.zeros(100), {"filter": slow}), pitch=(np.zeros(100), {"filter": fast}))
    assert undone_with(both) == pytest.approx(36.04 / decay * both.rate, abs=2, rel=1e-3)
    assert undone_with(record(ground_acceleration=(np.zeros(100), {}))) == 0


def test_where_a_filter_leaves_little_only_its_phase_is_undone():
    low_pass = AntiAlias("butterworth", 8, 30.0)
    response = complex(low_pass.response(FREQUENCY))
    assert abs(response) < LEAST_GAIN**2
    read = sine(response, phase=-np.angle(response))
    found = corrected(record(ground_acceleration=(read, {"filter": low_pass}))).channel("ground_acceleration").values
    expected = sine(abs(response), phase=-np.angle(response))
    np.testing.assert_allclose(found[INNER], expected[INNER], atol=CLOSE)


def test_of_a_load_a_tenth_of_the_magnitude_is_made_up_for():
    for corner, undone in ((60.0, True), (30.0, False)):
        low_pass = AntiAlias("butterworth", 8, corner)
        response = complex(low_pass.response(FREQUENCY))
        assert (abs(response) > 0.9) == undone and (abs(response) < 0.9**2) != undone
        read = sine(response, phase=-np.angle(response))
        found = corrected(record(AF=(read, {"filter": low_pass}))).channel("AF").values
        expected = sine(1.0 if undone else abs(response), phase=-np.angle(response))
        np.testing.assert_allclose(found[INNER], expected[INNER], atol=CLOSE)


def test_force_of_a_sine_on_a_shaken_balance_with_two_filters(rng):
    """F = 300 N and x1'' = 2 m/s^2 at 40 Hz, each with its phase; AF = G (F - M x1'') by Eq. (8)."""
    of_load, of_ground = AntiAlias("butterworth", 8, 250.0), AntiAlias("bessel", 4, 150.0)
    force, ground = 300 * np.exp(0.4j), 2 * np.exp(-1.1j)
    felt = complex(T128.response(FREQUENCY)) * (force - T128.mass * ground)
    noise = 0.5
    channels = {
        "AF": (
            sine(felt * complex(of_load.response(FREQUENCY))) + rng.normal(0, noise, TIME.size),
            {"noise": noise, "filter": of_load},
        ),
        "ground_acceleration": (
            sine(ground * complex(of_ground.response(FREQUENCY))),
            {"noise": 1e-6, "filter": of_ground},
        ),
        "pitch": np.zeros(TIME.size),
    }
    estimate = estimate_force(record(**channels), T128, bandwidth=80.0).only
    wave = np.exp(-2j * np.pi * FREQUENCY * TIME[INNER])

    def amplitude(values: np.ndarray) -> complex:
        """Complex amplitude over whole periods; 3201 samples are 80 of them and one sample."""
        return complex(2j * np.mean((values[INNER] * wave)[:-1]))

    # 1/|G| = 0.64 there: noise of 0.5 N over 3200 samples leaves 0.64 * 0.5 * sqrt(2 / 3200) = 0.008 N each way, six
    # times that is 0.05; the roll-off of order 16 at 80 Hz takes 300 / 2^16 = 0.005 N
    assert abs(amplitude(estimate.values) - force) < 0.06
    plain = {name: (part[0], {"noise": part[1]["noise"]}) if isinstance(part, tuple) else part
             for name, part in channels.items()}  # fmt: skip
    assert abs(amplitude(estimate_force(record(**plain), T128, bandwidth=80.0).only.values) - force) > 30


def test_missing_samples_stay_missing_with_their_neighbours():
    low_pass = AntiAlias("butterworth", 4, 400.0)
    values = sine(1.0)
    values[2000] = np.nan
    found = corrected(record(AF=(values, {"filter": low_pass}))).channel("AF")
    assert np.flatnonzero(found.missing).tolist() == list(range(1996, 2005))  # one period of the corner either side


def test_nothing_to_undo_gives_the_same_recording():
    given = record(AF=sine(1.0), ground_acceleration=sine(0.1))
    assert corrected(given) is given


@pytest.mark.filterwarnings(
    "ignore:.* (times .* what ground_acceleration reads|that the dynamics lack)"
)  # a made-up load
def test_cross_axis_sensitivity_is_taken_off_and_its_uncertainty_flows_on(rng):
    along, up = sine(2.0), rng.normal(0, 5.0, TIME.size)
    part = CrossAxis("ground_acceleration_z", 0.02, 0.005)
    given = record(
        AF=(sine(100.0), {"noise": 1.0}),
        ground_acceleration=(along + 0.02 * up, {"noise": 1e-3, "cross_axis": (part,)}),
        ground_acceleration_z=(up, {"noise": 1e-3}),
        pitch=np.zeros(TIME.size),
    )
    motion = GroundMotion.of(given, "AF")
    np.testing.assert_allclose(motion.specific_force, along, atol=1e-12)
    estimate = estimate_force(given, T128, method="paper").only
    found = {item.name: item for item in estimate.contributions}["cross-axis sensitivity to ground_acceleration_z"]
    assert found.source == "ground_acceleration"
    # Eq. (17) has M x1'': M u a_z in every sample, of one sign of u
    np.testing.assert_allclose(np.abs(found.slopes[:, 0]), T128.mass * np.abs(up))
    np.testing.assert_allclose(found.deviation, T128.mass * 0.005 * np.abs(up))
    smooth = estimate_force(given, T128).only
    assert "cross-axis sensitivity to ground_acceleration_z" in smooth.budget
    without = {name: channel for name, channel in given.channels.items() if name != "ground_acceleration_z"}
    with pytest.raises(FitError, match="ground_acceleration is sensitive to ground_acceleration_z, which is not"):
        estimate_force(replace(given, channels=without), T128)


def test_cross_axis_follows_the_other_channels_delay():
    up = np.sin(2 * np.pi * 5 * TIME)
    late = np.sin(2 * np.pi * 5 * (TIME - 0.002))
    given = record(
        ground_acceleration=(0.1 * late, {"delay": 0.002, "cross_axis": (CrossAxis("ground_acceleration_y", 0.1),)}),
        ground_acceleration_y=up,
    )
    found = corrected(given).channel("ground_acceleration").values
    # straight lines between samples of a 5 Hz sine: (2 pi 5 / 1600)^2 / 8 of 0.1
    assert np.max(np.abs(found[10:-10])) < 0.1 * (2 * np.pi * 5 / RATE) ** 2 / 8 * 1.01


def test_the_corner_of_an_ac_sensor_is_undone():
    corner = 20.0
    response = 1j * FREQUENCY / (1j * FREQUENCY + corner)
    read = sine(response, 3.0, phase=-np.angle(response))
    given = record(ground_acceleration=(read, {"coupling": "ac", "corner": corner}), pitch=np.zeros(TIME.size))
    with pytest.warns(DataQualityWarning, match="ac-coupled: ground motion below its corner of 20 Hz"):
        motion = GroundMotion.of(given, "AF")
    expected = sine(1.0, 3.0, phase=-np.angle(response))
    np.testing.assert_allclose(motion.specific_force[INNER], expected[INNER], atol=3 * CLOSE)


@pytest.mark.filterwarnings("ignore:.* the channel is dead")  # a reading without noise
@pytest.mark.parametrize("method", ["paper", "smoother"])
def test_gain_and_zero_of_the_load_channel_count(method):
    pitch = np.full(TIME.size, 0.1)
    settings = {"noise": 1.0, "relative_uncertainty": 0.01, "zero_uncertainty": 0.7}
    given = record(AF=(np.full(TIME.size, 500.0), settings), pitch=(pitch, {"noise": 1e-9}))
    estimate = estimate_force(given, T128, method=method).only
    # at rest the gain is wrong by 1 % of the 500 N read, weight and force together, and the zero by itself
    assert estimate.budget["gain of the readings"] == pytest.approx(5.0, rel=1e-3)
    assert estimate.budget["zero of the readings"] == pytest.approx(0.7)
    weight = T128.mass * STANDARD_GRAVITY * np.sin(0.1)
    assert np.mean(estimate.values[INNER]) == pytest.approx(500 - weight, abs=0.1)
    assert estimate.uncertainty[2000] > np.hypot(5.0, 0.7) * 0.999


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: AntiAlias("chebyshev", 4, 1.0), "butterworth or bessel"),
        (lambda: AntiAlias("bessel", 0, 1.0), "order"),
        (lambda: AntiAlias("bessel", 4, 0.0), "corner"),
        (lambda: CrossAxis("ground_acceleration_z", 1.5), "between -1 and 1"),
    ],
)
def test_impossible_settings_are_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def behind(low_pass: AntiAlias, generator: np.random.Generator) -> tuple[Recording, np.ndarray]:
    """Balance load under a flat force of 0-100 Hz and 60 N, read behind a filter that is stated, and the force.

    A part of a period of twice its length, so that nothing is known of what comes after it.
    """
    count, length = 2 * TIME.size, TIME.size
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    inside = (frequency > 0) & (frequency <= 100)
    phasors = np.where(inside, generator.normal(size=inside.size) + 1j * generator.normal(size=inside.size), 0)
    phasors *= 60 * count / (2 * np.sqrt(inside.sum()))
    force = np.fft.irfft(phasors, count)[:length]
    load = np.fft.irfft(phasors * T128.response(frequency) * low_pass.response(frequency), count)[:length]
    return record(AF=(load + generator.normal(0, 2, length), {"filter": low_pass})), force


@pytest.mark.filterwarnings("ignore:.* was read behind a bessel low-pass of order 4 at 100 Hz")
def test_what_a_filter_takes_off_a_force_is_counted(rng):
    """At 100 Hz a filter with that corner leaves 0.71, of which no more than a tenth is made up for."""
    run, force = behind(AntiAlias("bessel", 4, 100.0), rng)
    found = estimate_force(run, T128)
    off = np.sqrt(np.mean((found.only.values - force) ** 2))
    assert off > 5  # without the filter it is 0.7 N
    (doubt,) = found.doubts
    assert (doubt.kind, found.verdict) == ("filter gain", "doubtful")
    assert doubt.effect == pytest.approx(off, rel=0.3)
    assert 0.7 < off / np.sqrt(np.mean(found.only.uncertainty**2)) < 1.4


@pytest.mark.parametrize("kind", ["bessel", "butterworth"])
@pytest.mark.soak(first=1)
def test_the_end_behind_a_filter_is_no_step(rng, kind):
    """A filter is late: what its inverse asks for at the end has not been read, and is no sudden force there."""
    for _ in range(4):
        run, force = behind(AntiAlias(kind, 4, 400.0), rng)
        found = estimate_force(run, T128).only
        assert not found.steps
        assert not [doubt for doubt in found.doubts if doubt.kind == "filter gain"]
        assert np.max(np.abs(found.values - force)[-40:] / found.uncertainty[-40:]) < 5


def test_only_the_last_readings_are_late():
    """Bessel of order 2 and corner c: 3 / (s^2 + 3 s + 3) is late by 1, in units of (sqrt(45) - 3)^0.5 / 2^0.5 / w.

    Its response lies about that delay, and has come after twice that.
    """
    late = np.sqrt((np.sqrt(45.0) - 3) / 2) / (2 * np.pi * 100.0)
    assert late_samples(AntiAlias("bessel", 2, 100.0), 1e6) == np.ceil(2 * late * 1e6)
