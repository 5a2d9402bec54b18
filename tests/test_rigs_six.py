"""The simulated rig of six components: exact motion, true readings, sensible sizes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.linalg import eigh

from aerobalance.balance.loads_of_outputs import loads_of_outputs
from aerobalance.balance.zeros import gauge_zero
from aerobalance.dynamics.modal import Mode
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.simulation import (
    Band,
    BaseMotion,
    Release,
    Sensor,
    SixComponentRig,
    broadband,
    driven_motion,
    oscillation,
    random_balance,
    random_motion,
    sampled,
    tap,
    together,
)
from aerobalance.simulation.calibration_stand import CalibrationStand
from aerobalance.simulation.six_components import GROUND_CHANNELS

PLACE = {name: index for index, name in enumerate(COMPONENTS)}


def quiet(generator):
    return random_balance(generator).without_noise()


def loads_of(recording):
    return np.column_stack([recording.channel(name).values for name in COMPONENTS])


@pytest.mark.parametrize("duration", [0.0, 0.0037])
def test_a_release_decays_mode_by_mode_in_closed_form(duration, rng):
    """With damping in proportion to stiffness, shapes' X are single modes at the roots of K against M."""
    balance = quiet(rng)
    balance = replace(balance, damping=2e-5 * balance.stiffness)
    held = rng.normal(0, 0.3, 6) * balance.half_range
    release = Release(held, instant=0.0123456, duration=duration)
    simulation = SixComponentRig(balance, (release,), output="loads").run(0.2, rng)
    found = loads_of(simulation.recording) - balance.mass.weight(0.0)
    squares, shapes = eigh(balance.stiffness, balance.mass.matrix)
    time = simulation.recording.time - release.instant
    for square, shape in zip(squares, shapes.T, strict=True):
        w = np.sqrt(square)
        mode = Mode(w / (2 * np.pi), 1e-5 * w)
        if duration:
            fallen = (mode.integrated_step(time) - mode.integrated_step(time - duration)) / duration
            expected = 1 - fallen
        else:
            expected = mode.free_decay(time)
        scale = np.linalg.norm(shape * balance.half_range)
        # eigenvectors of a matrix of condition 1e3 or so: 1e-13, times the phase at the end, 700 rad
        assert np.abs(found @ shape - expected * (held @ shape)).max() < 1e-10 * scale


def test_before_a_release_everything_rests(rng):
    balance = quiet(rng)
    held = rng.normal(0, 0.3, 6) * balance.half_range
    rig = SixComponentRig(balance, (Release(held, 0.02001),), pitch=lambda t: np.full(t.size, 0.2), output="loads")
    simulation = rig.run(1.5, rng)
    rest = balance.mass.weight(0.2)
    before = simulation.recording.time < 0.02001
    off = (loads_of(simulation.recording) - rest) / balance.half_range
    np.testing.assert_allclose(off[before], np.tile(held / balance.half_range, (before.sum(), 1)), atol=1e-10)
    np.testing.assert_array_equal(simulation.applied[before], np.tile(held, (before.sum(), 1)))
    np.testing.assert_array_equal(simulation.applied[~before], 0)
    # the slowest mode decays by exp(-0.003 x 377 x 1.48) = 0.19 at worst
    assert np.abs(off[-200:]).max() < 0.5 * np.abs(off).max()


def eased(signal):
    """The signal grown smoothly from zero, so that what was held before the first point leaves no kink."""

    def grown(time):
        progress = np.clip((time + 0.01) / 0.005, 0, 1)
        return signal(time) * (progress**3 * (10 - 15 * progress + 6 * progress**2))[:, None]

    return grown


def test_the_motion_is_that_of_newton(rng):
    """Loads, moving sting, weight and turning at once, against an integration of the displacements."""
    balance = quiet(rng)
    blow = tap(0.2 * balance.half_range, instant=0.002, duration=0.007)
    applied = together(eased(broadband(rng, Band(0, 150), rms=0.05 * balance.half_range, period=0.5)), blow)
    shaking = random_motion(rng, Band(20, 150), rms=[3, 20, 3, 20, 20, 3], period=0.5)
    motion = shaking.with_motion(oscillation("PM", amplitude=0.05, frequency=12.0, lever=0.8))
    base = BaseMotion(eased(motion.acceleration), eased(motion.rate), eased(motion.angle))
    rig = SixComponentRig(
        balance, applied=applied, base=base, pitch=lambda t: np.full(t.size, 0.3), before=0.01, output="loads"
    )
    simulation = rig.run(0.02, rng)
    M, C, K, mass = balance.mass.matrix, balance.damping, balance.stiffness, balance.mass
    nose_up, side_down = MOMENTS.index("PM"), MOMENTS.index("RM")

    def net(t):
        time = np.array([t])
        angle = base.angle(time)[0]
        weight = mass.weight(0.3 + angle[nose_up], angle[side_down])[0]
        return applied(time)[0] + weight - M @ base.acceleration(time)[0] - mass.turning_load(base.rate(time))[0]

    first, clock = -0.011, simulation.recording.time
    start = np.concatenate([np.linalg.solve(K, net(first)), np.zeros(6)])
    state = np.block([[np.zeros((6, 6)), np.eye(6)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    drive = np.vstack([np.zeros((6, 6)), np.linalg.inv(M)])
    solved = solve_ivp(
        lambda t, y: state @ y + drive @ net(t),
        (first, clock[-1]),
        start,
        method="DOP853",
        rtol=1e-9,
        atol=1e-15,
        max_step=2e-4,
        t_eval=clock,
    )
    off = (loads_of(simulation.recording) - solved.y[:6].T @ K) / balance.half_range
    # cubics at 100 kHz through 150 Hz: (w h)^4 / 384 = 2e-11; the solver: 1e-9 in each of some 200 steps, of parts ten
    # times their sum
    assert np.abs(off).max() < 2e-6
    np.testing.assert_array_equal(simulation.load, loads_of(simulation.recording))
    # the recording's clock differs from the rig's by rounding
    np.testing.assert_allclose(
        simulation.applied / balance.half_range, applied(clock) / balance.half_range, atol=1e-11
    )


def test_the_force_equation_gives_back_what_was_applied(rng):
    """F = X + D X' + A X'' - W + M a + w x (...) from perfect readings alone: the contract with the estimator."""
    balance = quiet(rng)
    applied = broadband(rng, Band(0, 150), rms=0.05 * balance.half_range, period=1.0)
    base = random_motion(rng, Band(20, 150), rms=[3, 20, 3, 20, 20, 3], period=1.0).with_motion(
        oscillation("PM", amplitude=0.05, frequency=12.0, lever=0.8)
    )
    rig = SixComponentRig(balance, applied=applied, base=base, output="loads", rate=100_000.0, oversampling=1)
    recording = rig.run(0.03, rng).recording
    time, dynamics, mass = recording.time, balance.dynamics, balance.mass
    load = make_interp_spline(time, loads_of(recording), k=5)
    ground = np.column_stack([recording.channel(name).values for name in GROUND_CHANNELS])
    force = load(time) + load.derivative()(time) @ dynamics.damping.T + load.derivative(2)(time) @ dynamics.inertia.T
    force -= mass.weight(recording.channel("pitch").values, recording.channel("roll").values)
    force += ground @ mass.matrix.T + mass.turning_load(base.rate(time))
    inner = slice(50, -50)  # away from the ends of the spline
    off = (force - applied(time))[inner] / balance.half_range
    # second derivative of fifth-order splines at 100 kHz: (w h)^4 / 720 of 600 Hz is 3e-9, of some half range
    assert np.abs(off).max() < 1e-6


def test_displacements_are_reciprocal(rng):
    """What a blow in one component moves in another, the same blow there moves here (Maxwell, Betti)."""
    balance = quiet(rng)
    first, second = rng.choice(6, 2, replace=False)

    def displacement(component):
        blow = tap(np.eye(6)[component] * 10.0, instant=0.001, duration=0.002)
        load = SixComponentRig(balance, applied=blow, output="loads").run(0.03, rng).load
        return np.linalg.solve(balance.stiffness, (load - balance.mass.weight(0.0)).T).T

    there, here = displacement(first)[:, second], displacement(second)[:, first]
    # the weight taken off is some 1e3 times the blow's load, and that 1e3 times what a weak coupling passes on: 1e-10
    assert np.abs(there - here).max() < 1e-7 * np.abs(there).max()


def test_energy_goes_into_the_dampers(rng):
    balance = quiet(rng)
    held = rng.normal(0, 0.3, 6) * balance.half_range
    rig = SixComponentRig(balance, (Release(held, 0.0),), output="loads", rate=200_000.0, before=0.0, oversampling=1)
    simulation = rig.run(0.03, rng)
    load = simulation.load - balance.mass.weight(0.0)
    spline = make_interp_spline(simulation.recording.time, np.linalg.solve(balance.stiffness, load.T).T, k=5)
    time = simulation.recording.time[50:-50]  # away from the ends of the spline
    q, rate = spline(time), spline.derivative()(time)
    energy = 0.5 * np.einsum("ni,ij,nj->n", q, balance.stiffness, q)
    energy += 0.5 * np.einsum("ni,ij,nj->n", rate, balance.mass.matrix, rate)
    power = np.einsum("ni,ij,nj->n", rate, balance.damping, rate)
    lost = make_interp_spline(time, power, k=5).antiderivative()(time)
    # fifth-order splines at 200 kHz through 600 Hz: (w h)^5 = 2e-9 in the rate
    assert np.abs(energy + lost - energy[0]).max() < 1e-7 * energy[0]
    assert (power >= 0).all()


def test_a_delay_shifts_the_readings_and_not_the_truth(rng):
    balance = quiet(rng)
    held = 0.2 * balance.half_range
    delay = 1.37 / 25_000
    late = SixComponentRig(
        balance, (Release(held, 0.01),), output="loads", load_sensor=Sensor(delay=delay), before=0.0
    ).run(0.1, rng)
    shifted = SixComponentRig(balance, (Release(held, 0.01 + delay),), output="loads").run(0.1, rng)
    found, expected = loads_of(late.recording), loads_of(shifted.recording)
    np.testing.assert_allclose(found / balance.half_range, expected / balance.half_range, atol=1e-9)
    assert np.abs(late.load - found).max() > 1e-3 * np.abs(found).max()


def test_static_loads_come_back_through_the_matrix(rng):
    balance = quiet(rng)
    attitudes = rng.uniform(-0.5, 0.5, (2, 4))
    for pitch, roll in attitudes.T:
        rig = SixComponentRig(
            balance,
            (Release(0.2 * balance.half_range, 99.0),),
            pitch=lambda t, angle=pitch: np.full(t.size, angle),
            roll=lambda t, angle=roll: np.full(t.size, angle),
            before=0.0,
        )
        zero = gauge_zero([rig.zero(0.01, rng)], balance.matrix, model_on=False)
        felt = loads_of_outputs(rig.run(0.002, rng).recording, balance.matrix, zero=zero)
        expected = balance.mass.weight(pitch, roll)[0] + 0.2 * balance.half_range
        assert felt.components == COMPONENTS
        # the iteration of the matrix ends at 1e-12 of capacity
        off = (felt.values - expected) / balance.half_range
        assert np.abs(off).max() < 1e-10


def test_noise_is_what_was_asked_for(rng):
    balance = random_balance(rng)
    base = random_motion(rng, Band(20, 100), rms=np.ones(6), period=1.0)
    rig = SixComponentRig(balance, base=base)
    simulation = rig.run(0.4, rng)
    deviation = {
        f"r{name}": balance.noise * scale for name, scale in zip(COMPONENTS, balance.matrix.output_scale, strict=True)
    }
    truth = dict(zip(deviation, balance.outputs(simulation.load).T, strict=True))
    for place, name in enumerate(GROUND_CHANNELS):
        truth[name] = simulation.ground[:, place]
        deviation[name] = balance.turn_noise if "turn" in name else balance.acceleration_noise
    assert balance.noise == 1e-4
    for name, expected in deviation.items():
        off = simulation.recording.channel(name).values - truth[name]
        # 10,000 samples: the deviation is known to 1/sqrt(2 n) = 0.7 %, six of these; the mean to 1 %
        assert abs(off.std() / expected - 1) < 0.042, name
        assert abs(off.mean() / expected) < 0.06, name
    assert simulation.recording.channel("ground_turn_PM").unit == "rad/s^2"
    loads = SixComponentRig(balance, output="loads").run(0.4, rng)
    off = (loads_of(loads.recording) - loads.load).std(axis=0) / balance.half_range
    assert np.abs(off / 1e-4 - 1).max() < 0.042


def test_channels_are_those_of_the_units_and_signs_promised(rng):
    balance = quiet(rng)
    nodding = SixComponentRig(balance, base=oscillation("PM", amplitude=0.01, frequency=5.0, lever=1.0)).run(0.2, rng)
    assert set(nodding.recording.channels) == {*(f"r{name}" for name in COMPONENTS), *GROUND_CHANNELS, "pitch", "roll"}
    time, w = nodding.recording.time, 2 * np.pi * 5.0
    angle = 0.01 * np.sin(w * time)
    read = {name: channel.values for name, channel in nodding.recording.channels.items()}
    np.testing.assert_allclose(read["pitch"], angle, atol=1e-14)
    np.testing.assert_allclose(read["ground_turn_PM"], -(w**2) * angle, atol=1e-10)
    # a centre ahead of the axis rises when the nose does
    np.testing.assert_allclose(read["ground_acceleration_z"], -(w**2) * angle, atol=1e-10)
    gyros = SixComponentRig(balance, base=oscillation("YM", amplitude=0.01, frequency=5.0), turning="rate")
    recording = gyros.run(0.2, rng).recording
    rates = [name for name in recording.channels if "turn" in name]
    assert rates == ["ground_turn_rate_PM", "ground_turn_rate_YM", "ground_turn_rate_RM"]
    nose_right = recording.channel("ground_turn_rate_YM")
    assert nose_right.unit == "rad/s"
    np.testing.assert_allclose(nose_right.values, 0.01 * w * np.cos(w * time), atol=1e-12)
    still = SixComponentRig(balance, output="loads").run(0.01, rng)
    assert set(still.recording.channels) == {*COMPONENTS, "pitch", "roll"}


@pytest.mark.parametrize("component", ["PM", "YM"])
def test_an_oscillation_is_a_motion_on_a_circle(component, rng):
    lever, amplitude, frequency = rng.uniform(0.2, 2), rng.uniform(0.02, 0.3), rng.uniform(2, 20)
    motion = oscillation(component, amplitude=amplitude, frequency=frequency, lever=lever, phase=0.4)
    time = np.linspace(0, 1 / frequency, 400)
    angle = motion.angle(time)[:, MOMENTS.index(component)]
    across = PLACE["NF" if component == "PM" else "SF"]
    # the centre is ahead of the axis, along (aft, across), in axes that stand still
    path = make_interp_spline(time, lever * np.column_stack([-np.cos(angle), np.sin(angle)]), k=7)
    fixed = path.derivative(2)(time)
    aft = fixed[:, 0] * np.cos(angle) - fixed[:, 1] * np.sin(angle)
    sideways = fixed[:, 0] * np.sin(angle) + fixed[:, 1] * np.cos(angle)
    found, size = motion.acceleration(time), lever * amplitude * (2 * np.pi * frequency) ** 2
    inner = slice(20, -20)  # away from the ends of the spline
    # splines of order 7 at 400 points a period: (2 pi / 400)^6 = 1.5e-11, and rounding 1e-16 x 400^2 x lever
    assert np.abs(found[inner, PLACE["AF"]] - aft[inner]).max() < 1e-7 * size / amplitude
    assert np.abs(found[inner, across] - sideways[inner]).max() < 1e-7 * size / amplitude
    turned = make_interp_spline(time, angle, k=7)
    rate = motion.rate(time)[:, MOMENTS.index(component)]
    np.testing.assert_allclose(rate[inner], turned.derivative()(time)[inner], atol=1e-7 * np.abs(rate).max())
    again = found[:, PLACE[component]]
    np.testing.assert_allclose(again[inner], turned.derivative(2)(time)[inner], atol=1e-6 * np.abs(again).max())


def test_random_motion_is_consistent(rng):
    motion = random_motion(rng, Band(10, 60), rms=[1, 2, 3, 4, 5, 6], period=1.0)
    time = np.linspace(0.1, 0.5, 4001)
    turns = motion.acceleration(time)[:, [PLACE[name] for name in MOMENTS]]
    rate = make_interp_spline(time, motion.rate(time), k=5)
    angle = make_interp_spline(time, motion.angle(time), k=5)
    inner = slice(50, -50)
    # the motion itself is a cubic spline with 16 points in the shortest period: (2 pi / 16)^3 / 24 = 0.25 % in a slope
    for found, expected in ((rate.derivative()(time), turns), (angle.derivative()(time), motion.rate(time))):
        assert np.abs(found - expected)[inner].max() < 0.005 * np.abs(expected).max()


@pytest.mark.parametrize("band", [Band(0, 300), Band(40, 300), Band(0, 60, order=4), Band(5, 60, order=2)])
def test_broadband_loads_have_the_spectrum_asked_for(band, rng):
    period, rate, rms = 4.0, 8192, np.array([1.0, 2, 3, 4, 5, 6])
    time = np.arange(round(period * rate)) / rate
    values = broadband(rng, band, rms=rms, period=period)(time) / rms
    frequency = np.fft.rfftfreq(time.size, 1 / rate)
    power = 2 * np.abs(np.fft.rfft(values, axis=0) / time.size) ** 2
    outside = (frequency > band.highest + 1) | (frequency < band.low - 1)
    assert power[outside].sum() < 1e-6 * power.sum()  # the spline between its points
    edges = np.linspace(band.low, min(3 * band.high, band.highest), 5)
    for low, high in pairwise(edges):
        inside = (frequency > low) & (frequency <= high)
        expected = np.sum(band.density(frequency[inside])) / period
        # every line of six signals is a chi-squared variable of two degrees: relative deviation 1/sqrt(lines)
        weight = band.density(frequency[inside])
        spread = np.sqrt(np.sum(weight**2) / 6) / np.sum(weight)
        assert abs(power[inside].mean(axis=1).sum() / expected - 1) < 6 * spread + 0.01, low
    fine = np.linspace(0, band.highest, 1_000_001)
    assert np.trapezoid(band.density(fine), fine) == pytest.approx(1, abs=1e-4)


def test_sampled_loads_go_through_their_samples():
    values = np.random.default_rng(5).normal(0, 1, (40, 6))
    signal = sampled(values, rate=100.0, start=0.5)
    np.testing.assert_allclose(signal(0.5 + np.arange(40) / 100), values, atol=1e-12)
    np.testing.assert_allclose(signal(np.array([-1.0, 9.0])), values[[0, -1]], atol=1e-12)


def test_random_balances_are_of_a_sensible_size(rng):
    coupled = []
    for _ in range(30):
        balance = random_balance(rng)
        modes = balance.dynamics.modes
        assert len(modes) == 6
        assert all(60 <= mode.natural_frequency <= 600 for mode in modes)
        assert all(0.003 <= mode.damping_ratio <= 0.07 for mode in modes)
        forces = np.array([name not in MOMENTS for name in COMPONENTS])
        assert (balance.half_range[forces] >= 500).all() and (balance.half_range[forces] <= 5000).all()
        assert (balance.half_range[~forces] >= 20).all() and (balance.half_range[~forces] <= 300).all()
        assert (np.abs(balance.mass.weight(0.0, 0.0)[0]) < 0.6 * balance.half_range).all()
        principal = np.linalg.eigvalsh(balance.mass.inertia)
        assert principal[0] > 0 and principal[2] <= principal[0] + principal[1]  # of a body with thickness
        A = balance.dynamics.inertia * balance.half_range / balance.half_range[:, None]
        coupled.append(np.abs(A - np.diag(np.diag(A))).max() / np.diag(A).min())
        kinds = {
            term.kind for term, row in zip(balance.matrix.terms, balance.matrix.coefficients, strict=True) if row.any()
        }
        assert kinds == {0, 1, 2, 4}
    assert np.median(coupled) > 0.1


def test_a_random_balance_can_be_calibrated(rng):
    balance = random_balance(rng)
    schedule = CalibrationStand(balance.matrix, noise=0.0, tare_size=0.0).run(1).schedule
    assert schedule.components == COMPONENTS
    zero = balance.matrix.natural_zero
    solved = balance.matrix.loads(schedule.outputs - zero).loads
    np.testing.assert_allclose(solved / balance.half_range, schedule.loads / balance.half_range, atol=1e-10)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"half_range": np.zeros(6)}, "six positive loads"),
        ({"stiffness": np.eye(5)}, "stiffness must have shape"),
        ({"stiffness": np.triu(np.ones((6, 6)))}, "be symmetric"),
        ({"damping": -np.eye(6)}, "damping must be positive definite"),
    ],
)
def test_what_is_no_balance_is_refused(changes, said):
    balance = random_balance(np.random.default_rng(1))
    with pytest.raises(ValueError, match=said):
        replace(balance, **changes)


def test_what_is_no_band_is_refused():
    with pytest.raises(ValueError, match="0 <= low < high"):
        Band(10, 5)
    with pytest.raises(ValueError, match="repeats itself"):
        broadband(np.random.default_rng(1), Band(10.1, 10.5), rms=np.ones(6), period=0.3)


def test_a_driven_turn_is_the_integral_of_its_acceleration():
    """Rate and angle of a sweep against differences of each other; neither has a mean, so the ground end stays."""
    along = np.array([1.0, 2.0, 0.0, 0.0, -1.0, 0.5])
    duration, step = 0.5, 1e-6

    def drive(time):
        return np.where((time >= 0) & (time <= duration), np.sin(2 * np.pi * (50 + 100 * time) * time), 0.0)

    base = driven_motion(drive, along=along, duration=duration)
    time = np.linspace(0.01, 0.49, 97)
    turns = [PLACE[name] for name in MOMENTS]
    np.testing.assert_allclose(base.acceleration(time), drive(time)[:, None] * along, atol=1e-15)
    for function, expected in ((base.rate, base.acceleration(time)[:, turns]), (base.angle, base.rate(time))):
        slope = (function(time + step) - function(time - step)) / (2 * step)
        # rounding of the difference, 1e-16 / 1e-6, and the cubic between points of 50 us at up to 250 Hz: 1e-6
        np.testing.assert_allclose(slope, expected, atol=1e-5)
    whole = np.linspace(0, duration, 50_001)
    assert np.abs(np.mean(base.rate(whole), axis=0)).max() < 1e-5
    assert np.abs(np.mean(base.angle(whole), axis=0)).max() < 1e-6
