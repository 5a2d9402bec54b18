"""Gravity: its slopes, and what is not known of it where run and zero hang in the same field."""

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.motion.platform import PlatformMotion
from aerobalance.motion.single_axis import GroundMotion
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import COMPONENTS, MOMENTS, STANDARD_GRAVITY
from aerobalance.recording.gravity import (
    Attitudes,
    Gravity,
    GravityOnZero,
    gravity_components,
    gravity_share,
    weight_direction,
)
from aerobalance.recording.recording import Recording

U_ZERO, U_GAIN, U_GRAVITY = np.radians(0.05), 0.002, 0.01
AFT, RIGHT, UP = (COMPONENTS.index(name) for name in ("AF", "SF", "NF"))


def test_slopes_are_those_of_the_pull(rng):
    pitch, roll = rng.uniform(-3, 3, (2, 50))
    found, step = Gravity.of(pitch, roll, gravity=STANDARD_GRAVITY), 1e-4
    moved = {"pitch": (step, 0.0), "roll": (0.0, step)}
    for name, (up, over) in moved.items():
        more, less = (
            gravity_components(pitch + sign * up, roll + sign * over, gravity=STANDARD_GRAVITY) for sign in (1, -1)
        )
        # g h^2 / 6 of the third derivative, and rounding of g over h
        np.testing.assert_allclose(found.slopes[name], (more - less) / (2 * step), atol=2e-8 + 1e-10)
    assert not found.acceleration[:, [COMPONENTS.index(name) for name in MOMENTS]].any()
    np.testing.assert_allclose(np.linalg.norm(found.acceleration, axis=1), STANDARD_GRAVITY, rtol=1e-14)


def test_signs_of_the_pull():
    # nose up pulls aft, right side down pulls right, level pulls down
    assert weight_direction(np.pi / 2, 0.0) == pytest.approx([1, 0, 0])
    assert weight_direction(0.0, np.pi / 2) == pytest.approx([0, 1, 0])
    assert weight_direction(0.0, 0.0) == pytest.approx([0, 0, -1])
    for name, share in zip(("AF", "SF", "NF"), weight_direction(0.3, -0.7), strict=True):
        assert gravity_share(name, pitch=np.array(0.3), roll=np.array(-0.7)) == share
    assert gravity_share("PM", pitch=np.array(0.3), roll=np.array(-0.7)) == np.sin(0.3)


def test_zeros_count_alike_however_long_they_are():
    one = Attitudes(np.array([0.1, np.nan, 0.1]), np.zeros(3))
    other = Attitudes(np.full(1000, 0.3), np.full(1000, 0.2))
    found = GravityOnZero.of([one, other], gravity=9.8)
    assert found.acceleration[AFT] == pytest.approx(9.8 * (np.sin(0.1) + np.sin(0.3)) / 2)
    assert found.slope("pitch gain")[AFT] == pytest.approx(9.8 * (0.1 * np.cos(0.1) + 0.3 * np.cos(0.3)) / 2)
    assert found.slope("roll zero")[RIGHT] == pytest.approx(9.8 * (np.cos(0.1) + np.cos(0.3) * np.cos(0.2)) / 2)
    nothing = GravityOnZero.of([], gravity=9.8)
    assert not nothing.acceleration.any() and not nothing.slope("pitch zero").any()


def pitched(pitch, roll, zero, coupling=None):
    channels = {
        name: Channel(
            name, np.full(400, angle), "rad", noise=0.0, zero_uncertainty=U_ZERO, relative_uncertainty=U_GAIN
        )
        for name, angle in (("pitch", pitch), ("roll", roll))
    }
    if coupling:
        values = np.full(400, -STANDARD_GRAVITY * np.sin(pitch))
        channels["ground_acceleration"] = Channel(
            "ground_acceleration", values, "m/s^2", noise=0.01, coupling=coupling
        )
    on_zero = GravityOnZero.of(
        [(np.array([angle]), np.array([side])) for angle, side in zero], gravity=STANDARD_GRAVITY
    )
    return replace(Recording.from_columns(np.arange(400) / 1000, channels), gravity_on_zero=on_zero)


@pytest.mark.parametrize("zero", [[], [(0.2, -0.1)], [(-0.3, 0.4), (0.1, 0.0)]])
def test_what_is_not_known_of_gravity_counts_from_the_zero(zero):
    run = (0.2, -0.1)
    recording = pitched(*run, zero)

    def counted(pitch_off=0.0, pitch_gain=0.0, roll_off=0.0, roll_gain=0.0, gravity=STANDARD_GRAVITY):
        """Pull of the run less the mean of the zeros, with angles that are wrong alike in both."""
        pulls = [
            gravity_components(p * (1 + pitch_gain) + pitch_off, r * (1 + roll_gain) + roll_off, gravity=gravity)[0]
            for p, r in (run, *zero)
        ]
        return pulls[0] - (np.mean(pulls[1:], axis=0) if zero else 0.0)

    step = 1e-5
    names = {
        "pitch zero": "pitch_off", "pitch gain": "pitch_gain", "roll zero": "roll_off", "roll gain": "roll_gain",
    }  # fmt: skip
    expected = {
        name: (counted(**{argument: step}) - counted(**{argument: -step})) / (2 * step)
        for name, argument in names.items()
    }
    expected["gravity"] = counted() / STANDARD_GRAVITY
    whole = PlatformMotion.of(recording, gravity_uncertainty=U_GRAVITY)
    found = {item.name: item for item in whole.unknowns}
    for name, slope in expected.items():
        given = found[name].slope[0] if name in found else np.zeros(6)
        # a wrong angle makes the specific force too small by what it makes of the pull
        np.testing.assert_allclose(given, -slope, atol=1e-8, err_msg=name)
        for component in ("NF", "SF", "AF"):
            motion = GroundMotion.of(recording, component, gravity_uncertainty=U_GRAVITY)
            alone = {item.name: item.slope[0] for item in motion.unknowns}
            assert alone.get(name, 0.0) == pytest.approx(-slope[COMPONENTS.index(component)], abs=1e-8), name


def test_a_sensor_of_specific_force_leaves_the_angles_of_the_zero_alone():
    motion = GroundMotion.of(pitched(0.2, 0.0, [(0.1, 0.0)], coupling="dc"), "AF", gravity_uncertainty=U_GRAVITY)
    found = {item.name: item.slope[0] for item in motion.unknowns}
    # it reads gravity in the run itself; the weight in the zero was worked out from the pitch
    assert found["pitch zero"] == pytest.approx(STANDARD_GRAVITY * np.cos(0.1))
    assert found["gravity"] == pytest.approx(np.sin(0.1))
