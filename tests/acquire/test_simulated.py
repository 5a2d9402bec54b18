"""The simulated rigs as a source, against the rigs that are integrated on a grid."""

import math
import time

import numpy as np
import pytest

from aerobalance.acquisition.simulated import RigSettings, SimulatedSource
from aerobalance.acquisition.six_rig import SHAKEN, six_dynamics
from aerobalance.acquisition.source import Chosen, SourceEndedError
from aerobalance.recording.errors import FitError
from aerobalance.simulation import CableCut, Sensor, VibrationRig
from aerobalance.simulation.published import CABLE_CUT


def samples_of(source, count):
    source.start()
    parts, ticks = [], 0
    while ticks < count:
        block = source.read(1.0)
        assert block.tick == ticks
        parts.append(block.samples)
        ticks = block.end
    return np.concatenate(parts)[:count]


def perfect(*names):
    return {name: Sensor() for name in names}


@pytest.mark.parametrize("block", [0.002, 0.013, 0.4])
def test_cable_cut_agrees_with_the_rig_on_a_grid(block) -> None:
    source = SimulatedSource(RigSettings(rig="cable_cut", noise=0.0, speed=math.inf, cut_at=0.5, block=block))
    found = samples_of(source, 1600)
    rig = CableCut(release=0.5, sensors=perfect("AF", "ground_acceleration", "live_acceleration", "pitch"))
    expected = rig.run(1.0, np.random.default_rng(0)).recording
    for column, name in enumerate(source.names):
        # both are closed forms here; rounding grows with the 1020 N and the some 1e3 blocks at most
        assert found[:, column] == pytest.approx(expected.channel(name).values, abs=1e-8), name


class Ramped:
    """The drive of the source: full amplitude within the first block."""

    duration = 1.0

    def signal(self, generator):
        del generator
        return lambda t: np.where(t < 0, 0.0, np.clip(t / 0.02, 0, 1) * 10 * np.sin(2 * np.pi * 700 * t))


def test_shaken_rig_agrees_with_the_rig_on_a_grid() -> None:
    source = SimulatedSource(RigSettings(noise=0.0, speed=math.inf, frequency=700.0, block=0.02))
    found = samples_of(source, 25_000)
    rig = VibrationRig(oversampling=16, sensors=perfect("AF", "ground_acceleration", "live_acceleration"))
    expected = rig.run(Ramped(), np.random.default_rng(0)).recording
    for column, name in enumerate(source.names[:3]):
        values = expected.channel(name).values
        # the grid has 570 points a period, its cubics err by (2 pi / 570)^4 / 384 = 4e-11 of the amplitude, times the
        # resonance gain of below 100; the kink of the ramp lies on its grid
        assert found[:, column] == pytest.approx(values, abs=1e-7 * np.abs(values).max()), name


def test_motion_does_not_depend_on_the_blocks_and_noise_neither() -> None:
    runs = [
        samples_of(SimulatedSource(RigSettings(rig="six", seed=5, speed=math.inf, block=block, cut_at=0.1)), 5000)
        for block in (0.001, 0.0173, 0.2)
    ]
    for other in runs[1:]:
        assert other == pytest.approx(runs[0], abs=1e-8)


def test_six_components_agree_with_loads_on_a_grid() -> None:
    source = SimulatedSource(RigSettings(rig="six", noise=0.0, speed=math.inf, cut_at=0.1, block=0.013))
    source.control("shake", 1.5)
    count = 5000
    found = samples_of(source, count)
    dynamics, fine, rate = six_dynamics(), 8, source.rate
    time_ = np.arange(count * fine) / (fine * rate)
    # a block long the shaking grows; from then on each motion is the sine that is said, its phase from the start
    growth = np.minimum(time_ / (round(0.013 * rate) / rate), 1.0)
    ground = 1.5 * np.column_stack([size * growth * np.sin(2 * np.pi * f * time_) for f, size in SHAKEN])
    np.testing.assert_allclose(found[:, 6:], ground[::fine], atol=1e-8)
    cable = np.where(np.arange(time_.size)[:, None] < 0.1 * rate * fine, -CABLE_CUT.excitation.value, 0.0)
    net = cable * np.ones(6) - ground @ dynamics.mass.matrix.T
    before = dynamics.balance_load(net, interval=1 / (fine * rate))[::fine]
    # straight lines on the grid put a jump half a step late, of a ringing that is twice the force at most
    late = 2 * CABLE_CUT.excitation.value * 2 * np.pi * 120 / (2 * fine * rate)
    assert np.abs(found[:, :6] - before).max() < 6 * late
    assert np.abs(found[:2400, :6] - before[:2400]).max() < 1e-3  # (w h)^2 / 12 of some 1000 N by the shaking


def test_the_shaking_has_limits() -> None:
    source = SimulatedSource(RigSettings(rig="six"))
    with pytest.raises(ValueError, match="shaken with 0 to 5"):
        source.control("shake", 6.0)
    with pytest.raises(ValueError, match="no control 'shake'"):
        SimulatedSource(RigSettings(rig="cable_cut")).control("shake", 1.0)


def test_frequency_and_amplitude_change_without_a_jump_of_phase() -> None:
    source = SimulatedSource(RigSettings(noise=0.0, speed=math.inf, block=0.02))
    source.start()
    parts = []
    for number in range(100):
        if number == 50:
            assert source.control("frequency", 250.0) == "drive frequency 250 Hz"
            assert source.control("amplitude", 20.0) == "drive amplitude 20 N"
        parts.append(source.read(1.0).samples)
    ground = np.concatenate(parts)[:, source.names.index("ground_acceleration")]
    t = np.arange(ground.size) / source.rate
    # once settled, one sine of the new frequency holds all of it: the fit leaves what the ringing of the resonance has
    # not lost, exp(-decay * 0.6 s) with decay = b / (2 m) = 372 / (2 * 0.51) = 363 1/s: nothing
    settled = t > 1.6
    basis = np.column_stack([np.sin(2 * np.pi * 250 * t), np.cos(2 * np.pi * 250 * t)])[settled]
    rest = ground[settled] - basis @ np.linalg.lstsq(basis, ground[settled], rcond=None)[0]
    assert np.abs(rest).max() < 1e-8 * np.abs(ground).max()
    # no jump where it changed: a sample moves by omega A / rate at most, the resonance of 752 Hz ringing as well
    largest = np.abs(ground).max() * 2 * np.pi * 752 / source.rate
    assert np.abs(np.diff(ground)).max() < largest


def test_cable_is_cut_on_call_once() -> None:
    source = SimulatedSource(RigSettings(rig="cable_cut", noise=0.0, speed=math.inf))
    source.start()
    before = source.read(1.0)
    assert before.samples[:, 0] == pytest.approx(-1020.0)
    source.control("cut", 1.0)
    after = source.read(1.0)
    source.control("cut", 1.0)
    assert after.samples[0, 0] == pytest.approx(-1020.0)
    assert after.samples[-1, 0] > -1019


@pytest.mark.parametrize(
    ("rig", "name", "value", "said"),
    [
        ("vibration", "cut", 1.0, "no control 'cut'; it has frequency, amplitude"),
        ("cable_cut", "frequency", 1.0, "no control 'frequency'; it has cut"),
        ("vibration", "frequency", 0.0, "above 0 and up to 11250 Hz"),
        ("vibration", "frequency", math.nan, "above 0"),
        ("vibration", "amplitude", 1e6, "from 0 to 500 N"),
    ],
)
def test_controls_that_are_refused(rig, name, value, said) -> None:
    with pytest.raises(ValueError, match=said):
        SimulatedSource(RigSettings(rig=rig)).control(name, value)


def test_real_time_keeps_to_the_clock() -> None:
    source = SimulatedSource(RigSettings(block=0.01))
    source.start()
    begin = time.monotonic()
    end = 0
    while time.monotonic() - begin < 0.5:
        block = source.read(0.05)
        if block is not None:
            end = block.end
            # never ahead of the clock
            assert end / source.rate <= time.monotonic() - begin + 1e-3
    # behind by a block and what a busy machine takes
    assert end / source.rate > 0.3


def test_chosen_channels_in_their_order_and_unknown_ones_refused() -> None:
    source = Chosen(SimulatedSource(RigSettings(noise=0.0, speed=math.inf)), ["pitch", "AF"])
    source.start()
    assert source.read(1.0).samples[0] == pytest.approx([np.pi / 2, 0.68 * 9.80665], rel=1e-6)
    source.stop()
    with pytest.raises(SourceEndedError):
        source.read(1.0)
    with pytest.raises(FitError, match="no channel 'RM'; it has AF"):
        Chosen(SimulatedSource(RigSettings()), ["RM"])


@pytest.mark.parametrize("block", [0.02, 0.3])
def test_a_new_cable_takes_up_its_force_in_a_second(block) -> None:
    source = SimulatedSource(RigSettings(rig="cable_cut", noise=0.0, speed=math.inf, cut_at=0.0, block=block))
    with pytest.raises(ValueError, match="hangs already"):
        source.control("hang", 1)
    source.start()
    parts = [source.read(1.0).samples[:, 0]]
    while sum(map(len, parts)) < 16_000:
        parts.append(source.read(1.0).samples[:, 0])
    begin = sum(map(len, parts))
    assert "within 1 s" in source.control("hang", 1)
    while sum(map(len, parts)) < begin + 12_000:
        parts.append(source.read(1.0).samples[:, 0])
    load = np.concatenate(parts)[begin : begin + 12_000]
    # the cut of 10 s before has rung down to 1020 N exp(-2.33 * 10) = 8e-8 N; the force of a ramp of a second is the
    # integral of the step response over it, and what it leaves ringing
    dynamics = CABLE_CUT.dynamics
    t = np.arange(12_000) / 1600
    ramp = dynamics.step_response(t, duration=1.0)
    assert load == pytest.approx(-CABLE_CUT.excitation.value * ramp, abs=1e-6)
    assert load[-1] == pytest.approx(-CABLE_CUT.excitation.value, abs=1e-3)
