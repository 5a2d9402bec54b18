"""One point that does not go with the others, and hysteresis, in a weighing; sound points are not doubted."""

import warnings

import numpy as np
import pytest
from scipy.stats import binom

import aerobalance as ab
from aerobalance.app.commands.weighing import weigh
from aerobalance.balance.weighing import LoadPoints, Weighing, fit_weight
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.doubts import Verdict
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.gravity import weight_direction
from seeds import trials

MASS = 40.0
UP = np.radians(np.arange(-15, 16, 5.0))
PITCH = np.concatenate([UP, UP[::-1]])
ROLLED = np.repeat(np.radians([0.0, 90.0, 180.0]), PITCH.size)
NAMES = ("AF", "SF", "NF")
SIGNS = np.array([1.0, 1.0, -1.0])


def loads(rng: np.random.Generator, *, noise: float = 0.3) -> np.ndarray:
    """AF, SF and NF of the weight at all attitudes, shape (42, 3) [N]."""
    directions = weight_direction(np.tile(PITCH, 3), ROLLED)
    share = np.column_stack([directions[:, 0], directions[:, 1], -directions[:, 2]])
    signs = np.sign([share[:, k] @ expected(k) for k in range(3)])
    return MASS * STANDARD_GRAVITY * share * signs + [3.0, -2.0, 1.0] + rng.normal(0, noise, share.shape)


def expected(k: int) -> np.ndarray:
    """Shares by the formulas of the weighing: sin(pitch), cos(pitch) sin(roll), -cos(pitch) cos(roll)."""
    pitch = np.tile(PITCH, 3)
    return (np.sin(pitch), np.cos(pitch) * np.sin(ROLLED), -np.cos(pitch) * np.cos(ROLLED))[k]


def weighed(values: np.ndarray, kept: slice | np.ndarray = slice(None)) -> Weighing:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return fit_weight(LoadPoints(NAMES, np.tile(PITCH, 3)[kept], values, ROLLED[kept]))


def test_sound_points_are_not_doubted(rng):
    draws = trials(40, 1000)
    doubted = 0
    for _ in range(draws):
        found = weighed(loads(rng))
        doubted += bool(found.doubts)
        assert found.doubts or found.verdict is Verdict.FIT
    # 1e-3 for all outlying points and 1e-3 for all lags: more of them once in 1e5
    assert doubted <= binom.isf(1e-5, draws, 2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_an_outlying_point_is_named(name, rng):
    values = loads(rng)
    number = int(rng.integers(PITCH.size))
    values[number, NAMES.index(name)] += 6.0
    found = weighed(values)
    (doubt,) = found.doubts
    assert (doubt.kind, doubt.component) == ("outlying point", name)
    assert f"point {number + 1} " in doubt.text
    others = np.arange(values.shape[0]) != number
    without = weighed(values[others], others)
    assert abs(found.mass - without.mass) == pytest.approx(doubt.effect, rel=1e-3, abs=1e-6)
    assert without.doubts == ()


def test_the_effect_of_a_point_is_that_on_the_mass_of_its_force(rng):
    """Where a live end gives SF a mass of its own, a point of AF moves the mass of AF."""
    values = loads(rng)
    values[:, 1] += 0.05 * (values[:, 1] + 2.0)
    values[6, 0] += 6.0  # at the end of the sweep, where it moves the mass most
    found = weighed(values)
    assert found.model.own_masses
    (doubt,) = found.doubts
    assert (doubt.kind, doubt.component) == ("outlying point", "AF")
    others = np.arange(values.shape[0]) != 6
    without = weighed(values[others], others)
    moved = found.masses["AF"].mass - without.masses["AF"].mass
    # masses of all forces are fitted together, with the weights of the deviations that they leave
    assert doubt.effect == pytest.approx(abs(moved), rel=0.02)
    assert "it moves the mass of AF by +" in doubt.text
    assert doubt.effect > 0.5 * found.masses["AF"].u
    assert found.verdict is Verdict.DOUBTFUL


def test_hysteresis_is_named(rng):
    values = loads(rng)
    # each sweep begins where the last has come down to, and the turn at the top is reached from below
    values[:, 0] += np.tile(np.repeat([1.5, -1.5, 1.5], [1, UP.size, UP.size - 1]), 3)
    found = weighed(values)
    (doubt,) = found.doubts
    assert (doubt.kind, doubt.component) == ("hysteresis", "AF")
    size = float(doubt.text.split("reached: ")[1].split(" ")[0])
    # the mean of 21 each way of 0.3 N, 5 standard deviations, and the first point, whose way is not known
    assert size == pytest.approx(3.0, abs=5 * 0.3 * np.sqrt(2 / 21) + 3 / 42)
    assert found.mass == pytest.approx(MASS, abs=5 * found.u_mass)


def test_one_component_by_one_sweep(rng):
    for fault in ("none", "point", "hysteresis"):
        load = MASS * STANDARD_GRAVITY * np.sin(PITCH) + 3 + rng.normal(0, 0.3, PITCH.size)
        if fault == "point":
            load[4] += 6.0
        if fault == "hysteresis":
            load += np.repeat([1.5, -1.5], UP.size)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            found = fit_weight(LoadPoints(("AF",), PITCH, load[:, None]))
        kinds = [doubt.kind for doubt in found.doubts]
        assert kinds == {"none": [], "point": ["outlying point"], "hysteresis": ["hysteresis"]}[fault], fault


def test_the_command_tells_it(tmp_path, rng):
    load = MASS * STANDARD_GRAVITY * np.sin(PITCH) + 3 + rng.normal(0, 0.3, PITCH.size)
    load[4] += 6.0
    rows = "\n".join(f"{pitch:.9f},{value:.9f}" for pitch, value in zip(PITCH, load, strict=True))
    path = tmp_path / "points.csv"
    path.write_text(f"pitch [rad],AF [N]\n{rows}\n", encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        found = weigh([path], None, component="AF")
    (doubt,) = found["doubts"]
    assert doubt["kind"] == "outlying point"
    assert doubt["unit"] == "kg"
    assert found["summary"].startswith(found["verdict"])
    assert any(doubt["text"] in text for text in found["warnings"])


@pytest.mark.parametrize(
    ("factor", "words"),
    [(1 / 4.4482216, "between lbf and N"), (1 / 9.80665, "between kgf and N"), (1.3, None), (1.02, ""), (1.0, "")],
)
def test_a_mass_on_scales_shows_forces_in_another_unit(factor, words, rng):
    """Loads and their noise are wrong by one factor, so is the mass; a live end of 2 % is none."""
    points = LoadPoints(NAMES, np.tile(PITCH, 3), factor * loads(rng), ROLLED)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        plain, found = ab.weigh(points), ab.weigh(points, scales=MASS)
    assert not [doubt for doubt in plain.doubts if doubt.kind == "mass"]
    told = {doubt.component: doubt for doubt in found.doubts if doubt.kind == "mass"}
    if words == "":
        assert not told
        return
    assert set(told) == set(NAMES)
    assert (words or "on scales: all loads") in told["AF"].text
    assert told["AF"].effect == pytest.approx(abs(factor - 1) * MASS, rel=0.01)  # u of the mass is 0.1 %
    assert found.verdict is not Verdict.FIT


@pytest.mark.parametrize("scales", [0.0, -1.0, np.inf, np.nan])
def test_scales_read_a_mass(scales, rng):
    points = LoadPoints(NAMES, np.tile(PITCH, 3), loads(rng), ROLLED)
    with pytest.raises(ValueError, match="must be a positive and finite mass"):
        ab.weigh(points, scales=scales)
