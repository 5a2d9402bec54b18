"""The signs that docs/conventions.md and docs/axes.md state are those of the program."""

import re
from pathlib import Path

import numpy as np
import pytest

from aerobalance.motion.sensors import row_of
from aerobalance.recording.channel import AXES_BY_NAME
from aerobalance.recording.components import ANGLES, COMPONENTS, FORCE_AXES, MOMENTS, VECTORS
from aerobalance.recording.frames import Frame
from aerobalance.recording.gravity import weight_direction

DOCS = Path(__file__).parents[1] / "docs"
WORDS = {
    "aft": (1, 0, 0),
    "forward": (-1, 0, 0),
    "right": (0, 1, 0),
    "up": (0, 0, 1),
    "down": (0, 0, -1),
}
PARTS = {"nose": "forward", "right side": "right"}


def table(page):
    """Rows of the first table of components in a page: component, then its other cells."""
    text = (DOCS / page).read_text(encoding="utf-8")
    rows = re.findall(r"^ *\| (NF|PM|SF|YM|RM|AF) \| (.*) \|$", text, re.MULTILINE)
    return {name: cells.split(" | ") for name, cells in reversed(rows)}


MOMENT_ROWS, ALL_ROWS = table("conventions.md"), table("axes.md")


def test_the_pages_have_all_components():
    assert set(MOMENT_ROWS) == set(MOMENTS)
    assert set(ALL_ROWS) == set(COMPONENTS)


@pytest.mark.parametrize("name", COMPONENTS)
def test_directions_are_those_of_the_program(name):
    assert WORDS[ALL_ROWS[name][2]] == VECTORS[name]
    if name in MOMENTS:
        assert MOMENT_ROWS[name][1] == ALL_ROWS[name][2]
        assert MOMENT_ROWS[name][0] == ALL_ROWS[name][0]


def test_endings_of_accelerations_are_those_of_the_page():
    text = " ".join((DOCS / "conventions.md").read_text(encoding="utf-8").split())
    up_and_right = r"NF and `(\w+)` positive (\w+); SF and `(\w+)` positive to the (\w+)"
    found = re.search(r"along the balance axis are positive (\w+); " + up_and_right, text)
    assert found is not None
    aft, z, up, y, right = found.groups()
    endings = {f"ground_acceleration{ending}": WORDS[axis] for ending, axis in (("", aft), (z, up), (y, right))}
    assert endings == AXES_BY_NAME
    assert {"AF": aft, "NF": up, "SF": right} == FORCE_AXES


@pytest.mark.parametrize("name", MOMENTS)
def test_words_for_a_turn_are_its_right_handed_vector(name):
    part, _, way = MOMENT_ROWS[name][0].rpartition(" ")
    moved = np.cross(WORDS[MOMENT_ROWS[name][1]], WORDS[PARTS[part]])
    np.testing.assert_array_equal(moved, WORDS[way])


@pytest.mark.parametrize("name", MOMENTS)
def test_channels_and_angles_have_the_sign_of_their_moment(name):
    turns = re.findall(r"\w+", MOMENT_ROWS[name][2])
    assert [ANGLES[turn] for turn in turns if turn in ANGLES] == [name]
    for channel in (turn for turn in turns if turn.startswith("ground_turn")):
        np.testing.assert_array_equal(
            row_of(channel, np.zeros(3), np.zeros(3)), [one == name for one in COMPONENTS], err_msg=channel
        )
    for angle in (turn for turn in turns if turn in ANGLES):
        # a balance turned by an angle about v sees a fixed vector turned as much the other way; second order is 1e-12
        fixed = np.array([WORDS["forward"], WORDS["right"], WORDS["down"]])
        expected = fixed - 1e-6 * np.cross(VECTORS[name], fixed)
        np.testing.assert_allclose(fixed @ Frame(**{angle: 1e-6}).rotation.T, expected, atol=1e-11)
        if angle != "yaw":
            np.testing.assert_allclose(
                weight_direction(**{"pitch": 0.0, "roll": 0.0, angle: 1e-6}), expected[2], atol=1e-11
            )
    assert len(turns) == 3


def test_a_force_off_the_centre_makes_the_moments_that_the_page_names():
    text = (DOCS / "conventions.md").read_text(encoding="utf-8")
    assert "NF ahead of the centre makes PM positive, SF ahead of it YM, NF left of it RM" in text
    for force, place, moment in (("NF", "forward", "PM"), ("SF", "forward", "YM"), ("NF", "left", "RM")):
        where = -np.array(WORDS["right"]) if place == "left" else np.array(WORDS[place])
        turned = np.cross(where, VECTORS[force])
        np.testing.assert_array_equal(turned, VECTORS[moment])


def test_pitching_while_rolled_is_shared_by_the_moments_as_the_page_says():
    roll, pitch, step = 0.7, 0.3, 1e-4
    before, after = (Frame(pitch=angle, roll=roll).rotation for angle in (pitch - step, pitch + step))
    # a fixed vector seen from the balance moves by -w x: central differences are good to step^2 / 6
    swing = (before - after) @ Frame(pitch=pitch, roll=roll).rotation.T / (2 * step)
    rate = np.array([swing[2, 1], swing[0, 2], swing[1, 0]])
    seen = [float(np.dot(VECTORS[name], rate)) for name in MOMENTS]
    np.testing.assert_allclose(seen, [np.cos(roll), -np.sin(roll), 0.0], atol=1e-8)
