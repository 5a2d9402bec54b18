"""The simulated rigs: what they must show by themselves, and that they are integrated exactly."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.simulation import (
    CableCut,
    RandomDrive,
    Sensor,
    SteppedSine,
    Sweep,
    Unsteadiness,
    VibrationRig,
    band_noise,
)
from aerobalance.simulation.published import CABLE_CUT, VIBRATION_RIG

QUIET = {name: Sensor() for name in ("AF", "ground_acceleration", "live_acceleration")}
FREE_FREE_POLE = 752.0


def amplitude(values: np.ndarray, frequency: float, rate: float) -> float:
    """Amplitude of one sine by a Hann-windowed transform; other sines 40 Hz off leak less than 1e-4 in 0.4 s."""
    window = np.hanning(values.size)
    turn = np.exp(-2j * np.pi * frequency * np.arange(values.size) / rate)
    return float(2 * abs(np.sum(window * (values - values.mean()) * turn)) / window.sum())


def shaken(rng: np.random.Generator, frequency: float, damping: float) -> tuple[float, float]:
    """Amplitudes of load and ground acceleration, read off a record of the rig at one frequency."""
    rig = VibrationRig(dynamics=replace(VIBRATION_RIG.dynamics, damping=damping), sensors=QUIET)
    recording = rig.run(SteppedSine((frequency,), settle=0.1, hold=0.4), rng).recording
    steady = slice(2500, None)  # 0.1 s: transients of the damped rig have died down to exp(-27)
    return tuple(
        amplitude(recording.channel(name).values[steady], frequency, rig.rate)
        for name in ("AF", "ground_acceleration")
    )


def curve(rng: np.random.Generator, frequencies: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
    load, ground = zip(*(shaken(rng, f, damping) for f in frequencies), strict=True)
    return np.array(load), np.array(ground)


def test_ground_moves_least_at_636_hz_and_most_at_780_hz(rng):
    # METHOD: with the printed b and 10 N the least is 1.62 m/s^2 at 636 Hz and the largest 9.4 m/s^2 at 780 Hz.
    near = np.arange(632.0, 641.0)
    _, ground = curve(rng, near, VIBRATION_RIG.damping.value)
    assert abs(near[ground.argmin()] - 636) <= 2
    assert 0 < ground.argmin() < near.size - 1
    assert ground.min() == pytest.approx(1.62, abs=0.005)
    near = np.arange(776.0, 785.0)
    _, ground = curve(rng, near, VIBRATION_RIG.damping.value)
    assert abs(near[ground.argmax()] - 780) <= 2
    assert ground.max() == pytest.approx(9.4, abs=0.05)


def test_load_is_largest_at_748_hz(rng):
    near = np.arange(744.0, 753.0)
    load, _ = curve(rng, near, VIBRATION_RIG.damping.value)
    assert abs(near[load.argmax()] - 748) <= 2
    assert 0 < load.argmax() < near.size - 1
    assert load.max() == pytest.approx(16.1, abs=0.05)


def test_load_at_the_natural_frequency(rng):
    load, ground = shaken(rng, 652.5, VIBRATION_RIG.damping.value)
    assert load == pytest.approx(8.8, abs=0.05)
    # Eq. (12) at w0: |AF| / A1 = M k / (b w0), 5.10 kg.
    printed = VIBRATION_RIG.dynamics
    expected = printed.mass * printed.stiffness / (printed.damping * 2 * np.pi * 652.5)
    assert load / ground == pytest.approx(expected, rel=1e-3)


def test_undamped_ground_stands_still_at_the_natural_frequency(rng):
    near = np.arange(648.5, 657.0)
    _, ground = curve(rng, near, 0.0)
    assert abs(near[ground.argmin()] - 652.5) <= 2


def test_undamped_rig_rings_at_the_free_free_pole(rng):
    rig = VibrationRig(dynamics=replace(VIBRATION_RIG.dynamics, damping=0.0), sensors=QUIET)
    load = rig.run(SteppedSine((300.0,), settle=0.0, hold=1.0), rng).recording.channel("AF").values
    spectrum = np.abs(np.fft.rfft((load - load.mean()) * np.hanning(load.size)))
    frequency = np.fft.rfftfreq(load.size, 1 / rig.rate)
    spectrum[frequency < 400] = 0  # the drive itself
    assert abs(frequency[spectrum.argmax()] - FREE_FREE_POLE) <= 2


def test_balance_upright_carries_its_weight(rng):
    rig = VibrationRig(sensors=QUIET)
    simulation = rig.run(SteppedSine((500.0,), settle=0.0, hold=0.2), rng)
    # The cubic that joins rest and drive begins to rise within the 10 us before time 0.
    assert simulation.recording.channel("AF").values[0] == pytest.approx(0.68 * STANDARD_GRAVITY, rel=1e-6)
    assert np.all(simulation.recording.channel("pitch").values == np.pi / 2)


def test_momentum_follows_the_drive(rng):
    # Newton for the whole chain: m1 x1'' + M x2'' is the drive, whatever the spring does.
    rig = VibrationRig(sensors=QUIET)
    simulation = rig.run(RandomDrive(10.0, 1000.0, 0.5), rng)
    recording = simulation.recording
    total = rig.armature_mass * recording.channel("ground_acceleration").values
    total = total + rig.dynamics.mass * recording.channel("live_acceleration").values
    assert np.allclose(total, simulation.drive, atol=1e-9)


def integrated(cut: CableCut, duration: float) -> np.ndarray:
    """Load by a general-purpose integrator, stopped and started at the kinks of the cable force."""
    M, k, b = cut.dynamics.mass, cut.dynamics.stiffness, cut.dynamics.damping

    def slope(t: float, state: np.ndarray) -> list[float]:
        time = np.array([t])
        push = float(cut.cable(time)[0] + cut.applied(time)[0]) / M
        push += STANDARD_GRAVITY * np.sin(float(cut.pitch(time)[0])) - float(cut.ground_acceleration(time)[0])
        return [state[1], push - (k * state[0] + b * state[1]) / M]

    clock = np.arange(round(duration * cut.rate)) / cut.rate
    start = -10.0
    push = float(cut.applied(np.array([start]))[0] + cut.cable_force) / M
    push += STANDARD_GRAVITY * np.sin(float(cut.pitch(np.array([start]))[0]))
    push -= float(cut.ground_acceleration(np.array([start]))[0])
    state, result = np.array([push * M / k, 0.0]), np.empty(clock.size)
    edges = [-3.5, cut.release, cut.release + cut.release_duration, clock[-1] + 1e-9]
    # Before -3.5 s the transient of the start dies down to exp(-8) of a few newtons in both.
    for first, last in itertools.pairwise(edges):
        if last <= first:
            continue
        inside = (clock >= first) & (clock < last)
        solution = solve_ivp(
            slope, (first, last), state, method="DOP853", rtol=1e-9, atol=1e-14, dense_output=True, max_step=2e-3
        )
        result[inside] = k * solution.sol(clock[inside])[0]
        state = solution.y[:, -1]
    return result


@pytest.mark.parametrize("release_duration", [0.003, 0.0])
@pytest.mark.soak(first=1)
def test_cable_cut_agrees_with_a_general_integrator(release_duration: float, rng):
    cut = CableCut(
        release=0.0503,
        release_duration=release_duration,
        applied=lambda t: 60 * np.sin(2 * np.pi * 61 * t),
        ground_acceleration=lambda t: 0.3 * np.cos(2 * np.pi * 17 * t),
        pitch=lambda t: 0.05 + 0.01 * np.sin(2 * np.pi * 2 * t),
        sensors={"AF": Sensor()},
    )
    load = cut.run(0.2, rng).recording.channel("AF").values
    # The starts differ, and what is left of that is exp(-8) of at most about 700 N in either.
    assert np.max(np.abs(load - integrated(cut, 0.2))) < 0.5
    assert np.ptp(load) > 1000


def test_release_rings_as_the_closed_form(rng):
    cut = CableCut(release=0.10017, sensors={"AF": Sensor()})
    simulation = cut.run(1.0, rng)
    exact = cut.cable_force * cut.dynamics.free_decay(simulation.recording.time - cut.release)
    assert np.max(np.abs(simulation.load - exact)) < 1e-8 * abs(cut.cable_force)
    assert simulation.release == 0.10017


def test_slow_release_does_not_ring(rng):
    # A ramp of one period of the mode excites it (almost) not: |sinc| = 0 but for the damping, about pi zeta of it.
    period = 1 / CABLE_CUT.dynamics.natural_frequency
    cut = CableCut(release=0.1, release_duration=period, sensors={"AF": Sensor()})
    load = cut.run(0.5, rng).load
    after = load[int((0.1 + 1.5 * period) * cut.rate) :]
    assert np.max(np.abs(after)) < 2 * np.pi * CABLE_CUT.dynamics.damping_ratio * abs(cut.cable_force)


@pytest.mark.parametrize("delay", [7.3e-4, -2.1e-4])
def test_delay_is_exact(delay: float, rng):
    cut = CableCut(release=0.1002, sensors={"AF": Sensor(delay=delay)})
    recording = cut.run(0.5, rng).recording
    exact = cut.cable_force * cut.dynamics.free_decay(recording.time - delay - cut.release)
    assert np.max(np.abs(recording.channel("AF").values - exact)) < 1e-8 * abs(cut.cable_force)


def test_truth_of_the_applied_force(rng):
    cut = CableCut(release=0.1, release_duration=0.0, applied=lambda t: np.full(t.shape, 5.0))
    simulation = cut.run(0.2, rng)
    assert simulation.applied[0] == pytest.approx(-1015.0)
    assert simulation.applied[-1] == pytest.approx(5.0)


def test_sensor_adds_noise_steps_and_limits(rng):
    sensors = {"AF": Sensor(noise=0.32), "ground_acceleration": Sensor(resolution=0.25, limit=2.0)}
    simulation = VibrationRig(sensors=sensors).run(Sweep(500.0, 900.0, 1.0), rng)
    noise = simulation.recording.channel("AF").values - simulation.load
    # The standard deviation of n readings scatters by 1 / sqrt(2 n): 4.5 sigma.
    assert noise.std() == pytest.approx(0.32, rel=4.5 / np.sqrt(2 * noise.size))
    ground = simulation.recording.channel("ground_acceleration")
    assert np.allclose(ground.values / 0.25, np.rint(ground.values / 0.25))
    assert np.max(np.abs(ground.values)) == 2.0
    assert ground.saturated.any()
    assert "live_acceleration" not in simulation.recording


def test_anti_alias_filter_takes_3_db_at_its_corner(rng):
    sensors = {"AF": Sensor(corner=700.0), "ground_acceleration": Sensor()}
    simulation = VibrationRig(sensors=sensors).run(SteppedSine((700.0,), settle=0.1, hold=0.3), rng)
    filtered = amplitude(simulation.recording.channel("AF").values[2500:], 700.0, 25e3)
    assert filtered / amplitude(simulation.load[2500:], 700.0, 25e3) == pytest.approx(np.sqrt(0.5), rel=1e-4)


def test_same_generator_same_record(seed):
    drive = SteppedSine((640.0, 650.0, 660.0), unsteadiness=Unsteadiness())
    first, second = (VibrationRig().run(drive, np.random.default_rng(seed)).recording for _ in range(2))
    other = VibrationRig().run(drive, np.random.default_rng(seed + 1)).recording
    assert np.array_equal(first.channel("AF").values, second.channel("AF").values)
    assert not np.array_equal(first.channel("AF").values, other.channel("AF").values)


def test_unsteady_drive_wanders_only_near_its_frequencies(rng):
    drive = SteppedSine((400.0, 652.5), settle=0.0, hold=0.5, unsteadiness=Unsteadiness())
    force = VibrationRig(sensors=QUIET).run(drive, rng).drive
    peaks = np.abs(force).reshape(2, -1, 125).max(axis=2)  # each 5 ms has two periods or more
    assert np.ptp(peaks[0]) < 0.05 * 10
    assert np.ptp(peaks[1]) > 0.2 * 10


def test_band_noise_keeps_its_band_and_level(rng):
    noise = band_noise(rng, low=5.0, high=120.0, rms=60.0, period=20.0)
    values = noise(np.arange(20 * 1600) / 1600)
    spectrum = np.abs(np.fft.rfft(values)) ** 2
    frequency = np.fft.rfftfreq(values.size, 1 / 1600)
    outside = (frequency < 4.9) | (frequency > 120.1)
    # The cubic through 16 points a period leaves images of about 1e-4 in amplitude.
    assert spectrum[outside].sum() < 1e-6 * spectrum.sum()
    # 2300 lines of two degrees of freedom each: relative standard deviation of the rms 1 / sqrt(4 * 2300).
    assert values.std() == pytest.approx(60.0, rel=5 / np.sqrt(4 * 2300))


def test_wrong_settings_are_named(rng):
    with pytest.raises(ValueError, match="no roll; it has AF"):
        VibrationRig(sensors={"roll": Sensor()}).run(SteppedSine((500.0,)), rng)
    with pytest.raises(ValueError, match="damping ratio below 1"):
        CableCut(dynamics=replace(CABLE_CUT.dynamics, damping=1e7)).run(0.1, rng)
    with pytest.raises(ValueError, match="noise of a sensor"):
        Sensor(noise=-1.0)
    with pytest.raises(ValueError, match="a band needs"):
        band_noise(rng, low=10.0, high=5.0, rms=1.0, period=1.0)
