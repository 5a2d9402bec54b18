"""The ground end's motion in six degrees of freedom, against bodies moved in an inertial frame."""

import dataclasses
import warnings

import numpy as np
import pytest

from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.motion.at_rest import tones
from aerobalance.motion.changes import MotionChanges
from aerobalance.motion.least_squares import GroundFit
from aerobalance.motion.platform import PlatformMotion
from aerobalance.motion.sensors import ground_sensors
from aerobalance.motion.single_axis import GroundMotion
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import COMPONENTS, MOMENTS, STANDARD_GRAVITY, VECTORS
from aerobalance.recording.errors import DataQualityWarning, FitError, kept_warnings
from aerobalance.recording.gravity import gravity_components
from aerobalance.recording.recording import Recording

RATE = 1000.0
STEP = 1e-3
SECOND = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180
FIRST = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60
GRAVITY = np.array([0.0, 0.0, -STANDARD_GRAVITY])


def turned(axis, angle):
    """Rotations about an axis of the inertial frame, shape (n, 3, 3)."""
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle)[:, None, None] * -cross + (1 - np.cos(angle))[:, None, None] * (cross @ cross)


class Platform:
    """A rigid platform that swings, its path known at any time; derivatives by seven-point differences.

    Frequencies are 2 to 6 Hz in whole numbers: whole periods in a record of seconds.
    """

    def __init__(self, rng, *, samples=1000, swing=0.02, shift=2e-3, still=()):
        self.clock = np.arange(samples) / RATE
        beats = rng.integers(2, 7, (6, 2)).astype(float)
        self.angular, self.phase = 2 * np.pi * beats, rng.uniform(0, 2 * np.pi, (6, 2))
        self.size = rng.normal(size=(6, 2)) * np.array([[shift]] * 3 + [[swing]] * 3)
        self.size[[["aft", "right", "up", "x", "y", "z"].index(name) for name in still]] = 0
        self.mean = np.zeros(6)
        self.mean[3:] = rng.normal(size=3) * 0.1 * (swing > 0)

    def state(self, time):
        """Place of the balance's centre and turn of the platform."""
        angles = self.angular[:, :, None] * time + self.phase[:, :, None]
        path = self.mean[:, None] + np.sum(self.size[:, :, None] * np.sin(angles), axis=1)
        turn = turned((1, 0, 0), path[3]) @ turned((0, 1, 0), path[4]) @ turned((0, 0, 1), path[5])
        return path[:3].T, turn

    def acceleration(self, place):
        """Acceleration of a point of the platform, in its own axes, shape (n, 3)."""
        steps = []
        for number in range(-3, 4):
            centre, turn = self.state(self.clock + number * STEP)
            steps.append(centre + turn @ np.asarray(place))
        _, turn = self.state(self.clock)
        return np.einsum("nji,nj->ni", turn, np.tensordot(SECOND, steps, axes=1) / STEP**2)

    def pull(self):
        """Gravity in the platform's axes, shape (n, 3)."""
        return np.einsum("nji,j->ni", self.state(self.clock)[1], GRAVITY)

    def rate(self, late=0.0):
        """Rate of turn along aft, right, up, shape (n, 3)."""
        steps = [self.state(self.clock + late + number * STEP)[1] for number in range(-3, 4)]
        spin = np.einsum("nji,njk->nik", steps[3], np.tensordot(FIRST, steps, axes=1) / STEP)
        return np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)

    def turn(self):
        """Angular acceleration along aft, right, up, shape (n, 3)."""
        return np.tensordot(FIRST, [self.rate(number * STEP) for number in range(-3, 4)], axes=1) / STEP

    def motion(self):
        """The six accelerations in the order of the components, shape (n, 6)."""
        centre, turn = self.acceleration((0, 0, 0)), self.turn()
        return np.stack([(turn if name in MOMENTS else centre) @ VECTORS[name] for name in COMPONENTS], axis=1)

    def sensor(self, number, place, axis, **settings):
        name = f"ground_acceleration_{number}"
        axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        felt = self.acceleration(place) - (self.pull() if settings.get("coupling") == "dc" else 0)
        settings.setdefault("noise", 1e-6)
        return Channel(name, felt @ axis, "m/s^2", place=tuple(place), axis=tuple(axis), **settings)

    def angles(self):
        share = self.pull() / STANDARD_GRAVITY
        values = {"pitch": np.arcsin(share[:, 0]), "roll": np.arctan2(share[:, 1], -share[:, 2])}
        return [Channel(name, value, "rad", noise=1e-9) for name, value in values.items()]

    def recording(self, *channels):
        return recording(*channels, samples=self.clock.size)


def recording(*channels, samples=None, rate=RATE):
    samples = samples or channels[0].values.size
    stamps = np.arange(samples) / rate
    return Recording("test", stamps, np.arange(samples), 0.0, rate, {channel.name: channel for channel in channels})


def random_sensors(platform, rng, number, *, dc=0.5, **settings):
    """Accelerometers at random places and axes, some of which read gravity."""
    return [
        platform.sensor(
            index,
            rng.uniform(-0.5, 0.5, 3),
            rng.normal(size=3),
            coupling="dc" if rng.random() < dc else "kinematic",
            **settings,
        )
        for index in range(number)
    ]


def noisy(channel, rng, noise, **settings):
    return dataclasses.replace(
        channel, values=channel.values + noise * rng.normal(size=channel.values.size), noise=noise, **settings
    )


def rates_of(platform, noise, **settings):
    spin = platform.rate()
    return [
        Channel(f"ground_turn_rate_{name}", spin @ VECTORS[name], "rad/s", noise=noise, **settings) for name in MOMENTS
    ]


def rms(values):
    return np.sqrt(np.mean(np.square(values), axis=0))


INNER = slice(50, -50)
"""Without the ends, where a derivative has no neighbours on one side."""


def test_accelerometers_anywhere_give_all_six_motions(rng):
    platform = Platform(rng, samples=4000)
    rec = platform.recording(*random_sensors(platform, rng, 10, noise=0.02), *platform.angles())
    motion = PlatformMotion.of(rec)
    # what is left comes from w x (w x r), whose w is integrated less a line: 10 % of it is stated as its uncertainty,
    # and over eight periods and more the line is 1 % of w
    (unknown,) = (item for item in motion.unknowns if item.name.startswith("w x"))
    assert 0.1 <= unknown.uncertainty < 0.2
    assert (rms(motion.acceleration - platform.motion()) < 0.1 * rms(unknown.slope).max()).all()
    assert any("is taken off" in text for text in motion.assumptions)
    np.testing.assert_allclose(motion.acceleration - motion.specific_force, gravity_of(platform), atol=1e-9)


def gravity_of(platform):
    pull = platform.pull()
    return np.stack([np.zeros(len(pull)) if name in MOMENTS else pull @ VECTORS[name] for name in COMPONENTS], axis=1)


def test_rates_of_turn_make_it_exact(rng):
    platform = Platform(rng)
    rec = platform.recording(
        *random_sensors(platform, rng, 10, noise=0.02), *platform.angles(), *rates_of(platform, 1e-9)
    )
    motion, truth = PlatformMotion.of(rec), platform.motion()
    # derivatives of what is sampled 80 times a period, some 200 samples from the reflected ends in the middle half
    middle = slice(250, 750)
    assert (rms((motion.acceleration - truth)[middle]) < 1e-4 * np.max(rms(truth))).all(), rms(
        (motion.acceleration - truth)[middle]
    )
    np.testing.assert_allclose(
        motion.turn_rate, platform.rate() @ np.array([VECTORS[n] for n in MOMENTS]).T, atol=1e-9
    )


def test_force_is_that_of_every_mass_point(rng):
    platform = Platform(rng)
    places, masses = rng.normal(size=(5, 3)) * 0.3 + [0.2, 0.0, 0.1], rng.uniform(1, 5, 5)
    centre = masses @ places / masses.sum()
    arms = places - centre
    inertia = np.einsum("k,kij->ij", masses, [(r @ r) * np.eye(3) - np.outer(r, r) for r in arms])
    body = RigidMass(float(masses.sum()), centre, inertia)
    pulls = [m * (platform.pull() - platform.acceleration(r)) for m, r in zip(masses, places, strict=True)]
    force = np.sum(pulls, axis=0)
    moment = np.sum([np.cross(r, pull) for r, pull in zip(places, pulls, strict=True)], axis=0)
    truth = np.stack([(moment if n in MOMENTS else force) @ VECTORS[n] for n in COMPONENTS], axis=1)
    exact, pull = platform.motion(), gravity_of(platform)
    spin = platform.rate() @ np.array([VECTORS[n] for n in MOMENTS]).T
    motion = PlatformMotion(exact, np.eye(6), np.eye(6), exact - pull, spin, 0.0, ())
    # seven-point differences: (w h)^6 / 140 of it, under 1e-9, and rounding of 1e-16 / h^2 = 1e-10 m/s^2
    np.testing.assert_allclose(motion.force(body), truth, rtol=0, atol=1e-6 * np.abs(truth).max())


def test_noise_of_the_motion_is_that_of_many_records(rng):
    # swings so slow that w x (w x r) is far below the noise: places that tell turns badly leave it in one record, and
    # take it off in the next, which is told and is no part of the noise
    platform = Platform(rng, samples=4000, swing=2e-3)
    quiet = random_sensors(platform, rng, 8)
    angles = [dataclasses.replace(channel, noise=1e-3) for channel in platform.angles()]
    noises = rng.uniform(0.1, 0.4, 8)
    clean = platform.recording(*(dataclasses.replace(c, noise=n) for c, n in zip(quiet, noises, strict=True)), *angles)
    drawn = [noisy(c, rng, n) for c, n in zip(quiet, noises, strict=True)] + [noisy(c, rng, 1e-3) for c in angles]
    one, other = PlatformMotion.of(clean), PlatformMotion.of(platform.recording(*drawn))
    scatter = np.cov((other.specific_force - one.specific_force).T)
    size = np.sqrt(np.diag(one.covariance))
    # each element of a covariance of n samples scatters by at most sqrt(2 / n) of the two sizes; 6 of these, and the
    # noise of angles changes along the record by the angles themselves, which the mean takes out to second order
    np.testing.assert_allclose(
        scatter / np.outer(size, size), one.covariance / np.outer(size, size), atol=6 * np.sqrt(2 / 4000) + 0.02
    )


def test_rate_is_used_where_it_knows_better(rng):
    samples = 8000
    clock = np.arange(samples) / RATE
    # noise 2 rad/s^2 of the turn by accelerometers, and of the rate 2 / (2 pi 60): alike at 60 Hz
    slow, fast = 50 * np.sin(2 * np.pi * 5 * clock), 50 * np.sin(2 * np.pi * 200 * clock)
    turn = slow + fast
    rate_values = -(50 / (2 * np.pi * 5)) * np.cos(2 * np.pi * 5 * clock) - (50 / (2 * np.pi * 200)) * np.cos(
        2 * np.pi * 200 * clock
    )
    ends = [
        Channel(f"ground_acceleration_{i}", -x * turn, "m/s^2", place=(x, 0, 0), axis=(0.0, 0.0, 1.0))
        for i, x in enumerate((0.5, -0.5))
    ]
    rate = Channel("ground_turn_rate_PM", rate_values, "rad/s")
    channels = [noisy(c, rng, np.sqrt(2)) for c in ends] + [noisy(rate, rng, 2 / (2 * np.pi * 60))]
    motion = PlatformMotion.of(recording(*channels))
    error = motion.acceleration[:, 1] - turn
    inner = slice(400, -400)
    # the noise of the turn: accelerometers above 60 Hz, both below; the variance of n samples scatters by sqrt(2 / n),
    # more by the bandwidth's not being white: 6 of these for twice the variance
    size = np.sqrt(motion.covariance[1, 1])
    assert abs(rms(error[inner]) / size - 1) < 6 * np.sqrt(1 / samples) * 2
    spectrum = np.abs(np.fft.rfft(error[inner] * np.hanning(error[inner].size))) ** 2
    frequency = np.fft.rfftfreq(error[inner].size, 1 / RATE)
    low, high = (np.mean(spectrum[(frequency > a) & (frequency < b)]) for a, b in ((1, 20), (100, 400)))
    # below 20 Hz the rate's noise is under a third of the accelerometers' in size; both bands hold over 100 ordinates
    assert low < high / 3
    assert size < 2.0


@pytest.mark.parametrize("phase", [0.0, np.pi / 4, np.pi / 2])
def test_rate_of_turn_has_ends_like_its_middle(phase, seed):
    rng, noise, swing = np.random.default_rng(seed), 1e-3, 0.16
    time, w = np.arange(10_000) / 5000.0, 2 * np.pi * 0.6  # no whole number of swings
    values = swing * np.sin(w * time + phase) + noise * rng.normal(size=time.size)
    channel = Channel("ground_turn_rate_PM", values, "rad/s", noise=noise)
    found = PlatformMotion.of(Recording.from_columns(time, {channel.name: channel}))
    place = COMPONENTS.index("PM")
    error = found.acceleration[:, place] - swing * w * np.cos(w * time + phase)
    u = np.sqrt(found.covariance[place, place])
    # the noise counts twice where it is reflected, and the level of the end once more: some 4 u, eight times which is
    # never reached by chance; an end that hangs on one sample of the differentiated noise is off by thousands of u
    assert np.abs(error[[*range(100), *range(-100, 0)]]).max() < 32 * u < 0.5 * swing * w
    assert rms(error[1000:-1000]) < 2 * u


def test_a_rate_of_turn_that_rises_steadily_is_a_turn(rng):
    time = np.arange(10_000) / 5000.0
    channel = Channel(
        "ground_turn_rate_PM", 0.16 * (time - 1) + 1e-3 * rng.normal(size=time.size), "rad/s", noise=1e-3
    )
    found = PlatformMotion.of(Recording.from_columns(time, {channel.name: channel}))
    # beyond its ends the record bends to its mean within a quarter of its length, which reaches in by some per cent
    assert found.acceleration[:, COMPONENTS.index("PM")] == pytest.approx(0.16, abs=0.05)
    still = dataclasses.replace(channel, values=1e-3 * rng.normal(size=time.size))
    found = PlatformMotion.of(Recording.from_columns(time, {channel.name: still}))
    assert not found.acceleration.any()
    assert "shows nothing beyond its noise" in " ".join(found.assumptions)
    turning = dataclasses.replace(still, values=still.values + 2.0)
    found = PlatformMotion.of(Recording.from_columns(time, {channel.name: turning}))
    (said,) = [text for text in found.assumptions if channel.name in text]
    assert "no change beyond its noise and is not used; its mean of 2 rad/s is taken as its zero" in said
    assert "4 m/s^2 for each metre" in said  # w^2
    assert "take the mean of loads that count from a zero or a wind-off recording of the same turn" in said


def test_motion_that_no_sensor_sees_is_named():
    clock = np.arange(1000) / RATE
    tone = np.sin(2 * np.pi * 20 * clock)
    up = [
        Channel(f"ground_acceleration_{i}", tone, "m/s^2", noise=1e-3, place=(x, 0, 0), axis=(0.0, 0.0, 1.0))
        for i, x in enumerate((0.5, -0.5))
    ]
    motion = PlatformMotion.of(recording(*up))
    assert not motion.acceleration[:, [2, 3, 4, 5]].any()
    np.testing.assert_allclose(motion.acceleration[:, 0], tone, atol=1e-12)
    text = " ".join(motion.assumptions)
    for word in ("(AF)", "(SF)", "(YM)", "(RM)", "seen by no sensor"):
        assert word in text
    assert "(NF), " not in text


def test_turn_that_cannot_be_told_from_a_shift_is_named():
    tone = np.sin(2 * np.pi * 20 * np.arange(1000) / RATE)
    one = Channel("ground_acceleration_1", tone, "m/s^2", noise=1e-3, place=(0.5, 0, 0), axis=(0.0, 0.0, 1.0))
    motion = PlatformMotion.of(recording(one))
    np.testing.assert_allclose(motion.acceleration[:, 0], tone, atol=1e-12)
    assert any(
        "turn in pitch (PM) cannot be told from its acceleration up (NF)" in text for text in motion.assumptions
    )


def test_turn_sensor_tells_it(rng):
    clock = np.arange(1000) / RATE
    turn, shift = (rng.normal() * np.sin(2 * np.pi * f * clock) for f in (20, 30))
    reading = shift - 0.5 * turn  # nose up takes what is aft of the centre down
    one = Channel("ground_acceleration_1", reading, "m/s^2", noise=1e-6, place=(0.5, 0, 0), axis=(0.0, 0.0, 1.0))
    other = Channel("ground_turn_PM", turn, "rad/s^2", noise=1e-6)
    motion = PlatformMotion.of(recording(one, other))
    # w x (w x r) of 0.5 m is along the balance and not read
    np.testing.assert_allclose(motion.acceleration[:, :2], np.column_stack([shift, turn]), atol=1e-10)


def test_one_axis_gives_the_numbers_of_one_component(rng):
    clock = np.arange(2000) / RATE
    for name, component in (("", "AF"), ("_y", "SF"), ("_z", "NF")):
        channels = [
            Channel(f"ground_acceleration{name}", 30 * np.sin(300 * clock) + rng.normal(size=clock.size), "m/s^2"),
            Channel("pitch", 0.1 + 0.05 * np.sin(3 * clock) + 1e-4 * rng.normal(size=clock.size), "rad"),
            Channel("roll", 0.02 * np.cos(2 * clock), "rad", noise=0.0),
        ]
        six, one = PlatformMotion.of(recording(*channels)), GroundMotion.of(recording(*channels), component)
        index = COMPONENTS.index(component)
        read = channels[0].values[:, None] - gravity_components(
            channels[1].values, channels[2].values, gravity=STANDARD_GRAVITY
        )
        for motion in (six.specific_force[:, index], one.specific_force):
            np.testing.assert_allclose(motion, read[:, index], rtol=1e-12, atol=1e-12)
        assert one.noise == pytest.approx(np.sqrt(six.covariance[index, index]), rel=1e-12)


def test_at_rest_is_zero_but_for_tones(rng):
    clock = np.arange(4000) / RATE
    noise = rng.normal(size=(3, clock.size))
    hum = 0.5 * np.sin(2 * np.pi * 100 * clock)
    channels = [
        Channel("ground_acceleration", noise[0], "m/s^2", noise=1.0),
        Channel("ground_acceleration_y", noise[1] + hum, "m/s^2", noise=1.0),
        Channel("ground_acceleration_z", noise[2] + 3 * hum, "m/s^2", noise=1.0),
    ]
    motion = PlatformMotion.of(recording(*channels))
    assert not motion.acceleration[:, COMPONENTS.index("AF")].any()
    left = motion.acceleration[:, COMPONENTS.index("SF")]
    # the tone's size is known to 1 / sqrt(4000 / 8) = 4.5 %, and 6 of these; of 2001 ordinates 17 are kept, a tenth of
    # the noise
    assert abs((left @ hum) / (hum @ hum) - 1) < 0.27 and rms(left - hum) < 0.2
    np.testing.assert_array_equal(motion.acceleration[:, COMPONENTS.index("NF")], channels[2].values)
    assert sum("beyond its noise" in text for text in motion.assumptions) == 2


@pytest.mark.parametrize("samples", [64, 30, 8, 2])
def test_tones_of_short_records_are_found(samples):
    """All of 17 ordinates about a tone are kept: of a record of up to 16 samples everything but its mean."""
    tone = np.cos(2 * np.pi * (samples // 4) * np.arange(samples) / samples)
    found, share = tones(tone)
    np.testing.assert_allclose(found, tone - tone.mean() if samples > 2 else 0.0, atol=1e-12)
    kept = min(samples // 4 + 8, samples // 2) - max(samples // 4 - 8, 0) + 1 if samples > 2 else 0
    assert share == pytest.approx(np.sqrt(kept / (samples // 2 + 1)), rel=1e-12)


def test_tones_of_a_motion_at_rest_follow_the_channel_that_reads_them(rng):
    """Its motion is linear in the channel: a change of the tone, and an error of gain, come through whole."""
    clock = np.arange(4000) / RATE
    hum = 0.5 * np.sin(2 * np.pi * 100 * clock)
    noise = rng.normal(size=(2, clock.size))
    channels = [
        Channel("ground_acceleration", noise[0], "m/s^2", noise=1.0, relative_uncertainty=0.01),
        Channel("ground_acceleration_y", noise[1] + hum, "m/s^2", noise=1.0, relative_uncertainty=0.01),
    ]
    rec = recording(*channels)
    motion, changes = PlatformMotion.of(rec), MotionChanges.of(rec)
    (gain,) = [item for item in motion.unknowns if item.source == "ground_acceleration_y"]
    # the channel is all that reads its axis, so its gain is that of the motion
    np.testing.assert_allclose(gain.slope, motion.acceleration, rtol=0, atol=1e-12)
    assert not [item for item in motion.unknowns if item.source == "ground_acceleration"]  # at rest
    by = 1e-3 * hum
    for channel in channels:
        other = dataclasses.replace(channel, values=channel.values + by)
        again = PlatformMotion.of(dataclasses.replace(rec, channels={**rec.channels, channel.name: other}))
        change = again.specific_force - motion.specific_force
        # rounding of 0.5 m/s^2 in transforms
        np.testing.assert_allclose(changes.specific_force(channel.name, by), change, rtol=0, atol=1e-14)
        assert change.any() == (channel.name == "ground_acceleration_y")


def test_swings_as_large_as_their_platform_are_left_in_and_said(rng):
    """The rate of turn over the turn is the angle: of a radian and more, w x (w x r) is as much as what tells it."""
    platform = Platform(rng, swing=3.0)
    motion = PlatformMotion.of(platform.recording(*random_sensors(platform, rng, 10, dc=0)))
    assert any("is left in their readings" in text for text in motion.assumptions)
    left = next(item for item in motion.unknowns if item.source == "rate of turn")
    assert left.uncertainty == 1.0  # all of it is in doubt


def test_far_sensors_at_rest_do_not_spoil_the_others(rng):
    clock = np.arange(4000) / RATE
    shift = 5 * np.sin(2 * np.pi * 30 * clock)
    pair = [
        noisy(Channel(f"ground_acceleration_{i}", shift, "m/s^2", place=(x, 0, 0), axis=(0.0, 0.0, 1.0)), rng, 1.0)
        for i, x in enumerate((0.4, 0.5))
    ]
    motion = PlatformMotion.of(recording(*pair))
    # the turn, known to 1.4 / 0.1 rad/s^2, is taken as zero, and the acceleration is then the mean of both
    assert not motion.acceleration[:, COMPONENTS.index("PM")].any()
    assert abs(motion.covariance[0, 0] - 0.5) < 1e-9
    np.testing.assert_allclose(motion.acceleration[:, 0], np.mean([c.values for c in pair], axis=0), atol=1e-12)


def test_sensor_with_a_wrong_gain_is_named(rng):
    platform = Platform(rng, samples=2000)
    bad = int(rng.integers(10))
    channels = [noisy(c, rng, 0.1) for c in random_sensors(platform, rng, 10)]
    wrong = -1.0
    channels[bad] = dataclasses.replace(channels[bad], values=channels[bad].values * wrong)
    redundancy = GroundFit.of(ground_sensors(platform.recording(*channels)), rate=RATE)
    shown = 1 - (redundancy.rows @ redundancy.bands[0].gains).diagonal()
    if shown[bad] < 0.2 or rms(channels[bad].values) < 0.5:
        return  # a sensor that the others hardly check
    with pytest.warns(DataQualityWarning, match=f"ground_acceleration_{bad} "):
        PlatformMotion.of(platform.recording(*channels, *platform.angles()))


def test_good_sensors_are_not_doubted(rng):
    platform = Platform(rng, samples=2000)
    channels = [noisy(c, rng, 0.1) for c in random_sensors(platform, rng, 9)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PlatformMotion.of(platform.recording(*channels, *platform.angles()))


def test_stated_uncertainty_is_no_fault(rng):
    platform = Platform(rng, samples=2000, still=("x", "y", "z"), shift=0.02)
    gains = 1 + 0.05 * rng.normal(size=9)
    plain = random_sensors(platform, rng, 9)
    channels = [
        noisy(dataclasses.replace(c, values=c.values * g), rng, 0.02, relative_uncertainty=0.05)
        for c, g in zip(plain, gains, strict=True)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PlatformMotion.of(platform.recording(*channels, *platform.angles()))


def test_two_sensors_that_differ_are_both_named(rng):
    shift = 5 * np.sin(2 * np.pi * 30 * np.arange(4000) / RATE)
    pair = [
        noisy(Channel(f"ground_acceleration_{i}", shift * gain, "m/s^2", axis=(0.0, 0.0, 1.0)), rng, 0.1)
        for i, gain in enumerate((1.0, 1.2))
    ]
    with pytest.warns(DataQualityWarning, match=r"ground_acceleration_\d, ground_acceleration_\d do not agree"):
        PlatformMotion.of(recording(*pair))


def test_offset_is_told(rng):
    shift = 5 * np.sin(2 * np.pi * 30 * np.arange(4000) / RATE)
    trio = [
        noisy(Channel(f"ground_acceleration_{i}", shift + off, "m/s^2", axis=(0.0, 0.0, 1.0)), rng, 1.0)
        for i, off in enumerate((0.0, 0.5, 0.0))
    ]
    with pytest.warns(DataQualityWarning, match=r"ground_acceleration_1 reads 0\.[3-7]\d* m/s\^2 more than"):
        PlatformMotion.of(recording(*trio))
    # offset 0.5 rad/s^2, of a noise of 1 in the mean of 4000 samples and as little from the accelerometers
    turn = noisy(Channel("ground_turn_PM", np.full(4000, -0.5), "rad/s^2"), rng, 1.0)
    row = [
        noisy(Channel(f"ground_acceleration_{i}", shift, "m/s^2", axis=(0.0, 0.0, 1.0), place=(x, 0.0, 0.0)), rng, 1.0)
        for i, x in enumerate((-2.0, 0.0, 2.0))
    ]
    with pytest.warns(DataQualityWarning, match=r"ground_turn_PM reads 0\.[45]\d* rad/s\^2 less than"):
        PlatformMotion.of(recording(*row, turn))


def changed(rec, item, by):
    """The recording as it would be if one unknown were off by so much: readings that are taken for something else."""
    channels = dict(rec.channels)
    channel = channels[item.source]
    word = item.name.rpartition(" ")[2]
    if word == "gain":
        channels[item.source] = dataclasses.replace(channel, values=channel.values * (1 + by))
    elif word == "zero":
        channels[item.source] = dataclasses.replace(channel, values=channel.values + by)
    else:
        place = np.array(channel.place)
        place[["aft", "right", "up"].index(word)] -= by  # it is taken to sit there
        channels[item.source] = dataclasses.replace(channel, place=tuple(place))
    return dataclasses.replace(rec, channels=channels)


@pytest.mark.soak(first=0)
def test_slopes_are_those_of_changed_readings(rng):
    platform = Platform(rng, samples=2000, swing=0.002)
    settings = {"relative_uncertainty": 0.01, "zero_uncertainty": 0.1}
    sensors = random_sensors(platform, rng, 12, noise=1e-3, place_uncertainty=1e-3, **settings)
    angles = [dataclasses.replace(c, **settings) for c in platform.angles()]
    rec = platform.recording(*sensors, *angles)
    base = PlatformMotion.of(rec)
    assert len(base.unknowns) == 12 * 5 + 4 + 1
    several = [*rng.choice(60, 6, replace=False), 60, 61, 62, 63]  # of the sensors', and all of the angles'
    for number in several:
        item = base.unknowns[number]
        by = 1e-5
        other = PlatformMotion.of(changed(rec, item, by))
        change = np.zeros(len(base.unknowns))
        change[number] = by
        moved = base.moved(change).specific_force - base.specific_force
        # the slopes leave out that w x (w x r) changes with the motion, by 2 w times the change of w: for swings of
        # 0.002 rad at 6 Hz, w is under 0.1 rad/s, and the change of acceleration over 12 rad/s times that of w: under
        # 2 % for each of several levers
        error = rms(other.specific_force - base.specific_force - moved).max()
        assert error < 0.1 * rms(moved).max() + 1e-12, (item.name, error, rms(moved).max())


def test_sensors_of_different_delay_are_brought_together(rng):
    clock = np.arange(4000) / RATE
    late = float(rng.uniform(1e-3, 4e-3))

    def shift(t):
        return 5 * np.sin(2 * np.pi * 30 * t)

    pair = [
        Channel(f"ground_acceleration_{i}", shift(clock - d), "m/s^2", noise=0.1, delay=d, axis=(0.0, 0.0, 1.0))
        for i, d in enumerate((1e-3, 1e-3 + late))
    ]
    motion = PlatformMotion.of(recording(*pair))
    assert motion.delay == 1e-3
    # the ends are continued; within, a shift of a spectrum is exact for whole periods and good to 1e-3 for others
    np.testing.assert_allclose(motion.acceleration[INNER, 0], shift(clock - 1e-3)[INNER], atol=5e-3)


def test_missing_readings_are_bridged_and_said():
    values = np.sin(2 * np.pi * 5 * np.arange(1000) / RATE)
    values[300:303] = np.nan
    with pytest.warns(DataQualityWarning, match="3 missing"):
        motion = PlatformMotion.of(recording(Channel("ground_acceleration_z", values, "m/s^2", noise=1e-3)))
    assert np.isfinite(motion.specific_force).all()


def interleaved(rng, axes):
    """Accelerometers that a multiplexer reads in turn, each moved by 5 m/s^2 at 3 Hz."""
    clock = np.arange(1000) / RATE
    values = 5 * np.sin(2 * np.pi * 3 * clock) + 0.01 * rng.normal(size=(2, clock.size))
    values[0, ::2] = values[1, 1::2] = np.nan
    return recording(
        *(
            Channel(f"ground_acceleration_{i}", one, "m/s^2", noise=0.01, axis=axis)
            for i, (one, axis) in enumerate(zip(values, axes, strict=True))
        )
    )


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # of the missing readings
@pytest.mark.parametrize("other", ["NF", "AF"])
def test_sensors_that_are_read_in_turn_are_not_at_rest(other, rng):
    """Whether they read two axes, or one, so that no sample has a reading of both."""
    motion = PlatformMotion.of(interleaved(rng, [VECTORS["AF"], VECTORS[other]]))
    assert not [text for text in motion.assumptions if "at rest" in text and "AF" in text]
    moved = 5 * np.sin(2 * np.pi * 3 * np.arange(1000) / RATE)
    for name in {"AF", other}:
        # every second reading is predicted, by a step of up to 2 pi 3 Hz * 5 m/s^2 * 1 ms
        np.testing.assert_allclose(motion.acceleration[:, COMPONENTS.index(name)], moved, atol=0.1)


def test_nothing_recorded_is_rest_and_gravity():
    motion = PlatformMotion.of(recording(Channel("pitch", np.full(100, 0.3), "rad", noise=0.0)))
    assert not motion.acceleration.any() and any("at rest" in text for text in motion.assumptions)
    body = RigidMass(2.0, np.zeros(3), np.eye(3))
    np.testing.assert_allclose(motion.force(body), body.weight(np.full(100, 0.3)), atol=1e-12)


@pytest.mark.parametrize("along", [None, "SF", "AF"])
def test_a_roll_without_a_pitch_is_not_passed_over(along, rng):
    """At level pitch a roll from 0 to 180 deg swings the weight once up and down: AF feels nothing of it."""
    noise = 1e-4 * rng.normal(size=2000)
    roll = Channel("roll", np.linspace(0, np.pi, 2000) + noise, "rad", noise=1e-4)
    still = dataclasses.replace(roll, values=noise)
    expected = {None: 1 / np.sqrt(2), "SF": np.sqrt(1 / 2 - (2 / np.pi) ** 2)}  # rms of cos and of sin less its mean
    if along in expected:
        size = f"changes it by {expected[along] * STANDARD_GRAVITY:.2g} m/s"
        with pytest.warns(DataQualityWarning, match=size):
            motion = PlatformMotion.of(recording(roll), along=along)
    else:
        motion = PlatformMotion.of(recording(roll), along=along)
    assert any("taken as constant, and the roll with it" in text for text in motion.assumptions)
    PlatformMotion.of(recording(still), along=along)  # warns of nothing


def test_accelerometer_without_an_axis_is_refused():
    one = Channel("ground_acceleration_1", np.zeros(100), "m/s^2", place=(0.5, 0, 0))
    with pytest.raises(FitError, match="ground_acceleration_1 has no axis"):
        PlatformMotion.of(recording(one))


def test_accelerometer_without_a_place_is_said_to_be_at_the_centre(rng):
    platform = Platform(rng, samples=4000)
    channels = [noisy(c, rng, 0.05) for c in random_sensors(platform, rng, 8)]
    bare = Channel("ground_acceleration", platform.acceleration((0, 0, 0))[:, 0], "m/s^2", noise=0.05)
    motion = PlatformMotion.of(platform.recording(*channels, bare, *platform.angles()))
    assert any("ground_acceleration: no place is given" in text for text in motion.assumptions)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"axis": (1.0, 1.0, 0.0)}, "length 1"),
        ({"place": (np.nan, 0.0, 0.0)}, "three numbers"),
        ({"place_uncertainty": -1.0}, "zero or more"),
    ],
)
def test_impossible_mountings_are_refused(settings, words):
    with pytest.raises(ValueError, match=words):
        Channel("ground_acceleration_1", np.zeros(4), "m/s^2", **settings)


def test_only_accelerometers_have_a_mounting():
    with pytest.raises(ValueError, match="place and axis are for"):
        Channel("AF", np.zeros(4), "N", place=(0.0, 0.0, 0.0))


@pytest.mark.parametrize("along", [None, "AF"])
def test_changes_of_a_channel_are_those_of_the_motion(along, rng):
    """What the changed readings give, but for w x (w x r) at places r, which is of second order in the motion."""
    platform, frequency = Platform(rng), 5.0
    # by a change of the rate it changes by 2 w r, and the angular acceleration by 2 pi f
    allowed = 2 * float(np.max(np.abs(platform.rate()))) * np.sqrt(3) * 0.5 / (2 * np.pi * frequency)
    aft = dataclasses.replace(platform.sensor(9, (0, 0, 0), VECTORS["AF"]), name="ground_acceleration")
    sensors = [*random_sensors(platform, rng, 8, noise=0.02), aft, *rates_of(platform, 1e-9)]
    rec = platform.recording(*sensors, *platform.angles())
    changes, before = MotionChanges.of(rec, along=along), PlatformMotion.of(rec, along=along).specific_force
    assert len(changes.channels) == (3 if along else len(sensors) + 2)
    for name in changes.channels:
        channel = rec.channel(name)
        by = 1e-4 * np.std(channel.values) * np.sin(2 * np.pi * frequency * rec.time)
        other = dataclasses.replace(channel, values=channel.values + by)
        again = dataclasses.replace(rec, channels={**rec.channels, name: other})
        with kept_warnings():  # a sensor that differs from the others is told of
            change = (PlatformMotion.of(again, along=along).specific_force - before)[INNER]
        off = rms(changes.specific_force(name, by)[INNER] - change)
        assert (off < max(allowed, 1e-3) * np.max(rms(change))).all(), name
