"""Advice in messages names what there is, and numbers in them are numbers that can be."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import typer.main

import aerobalance
from aerobalance.app.cli.program import app
from aerobalance.app.options import OPTIONS, as_options
from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.other_dynamics import OtherDynamics, other_dynamics_in
from aerobalance.estimation.force_record import force_record
from aerobalance.identification.free_decay.decay_doubts import _way_to_take_it_up
from aerobalance.identification.free_decay.event import first_look
from aerobalance.identification.free_decay.fit import _kept_modes, identify_decay
from aerobalance.identification.free_decay.ring_fit import fit_ring
from aerobalance.identification.free_decay.waveform import DecayLine
from aerobalance.recording.channel import Channel
from aerobalance.recording.errors import DataQualityWarning, FitError, argument
from aerobalance.recording.recording import Recording
from aerobalance.recording.wording import damping_text, frequency_text, percent_text, share_text

SOURCE = Path(aerobalance.__file__).parent
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*[a-z]")


def naming(what: re.Pattern[str]) -> list[Path]:
    """Modules with a text in them: all others need not be taken apart."""
    return [path for path in SOURCE.rglob("*.py") if what.search(path.read_text())]


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Every node of a module."""
    return list(ast.walk(ast.parse(path.read_text())))


def texts(path: Path) -> list[str]:
    """Every string of a module but its docstrings, the parts of formatted ones joined."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    said = {id(node.body[0].value) for node in nodes(path) if isinstance(node, documented) and _begins_with_text(node)}
    return [
        node.value
        for node in nodes(path)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in said
    ]


def _begins_with_text(node: ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return bool(node.body) and isinstance(node.body[0], ast.Expr) and isinstance(node.body[0].value, ast.Constant)


def options() -> set[str]:
    """Every option of every command."""
    found: set[str] = set()
    waiting = [typer.main.get_command(app)]
    while waiting:
        command = waiting.pop()
        for parameter in command.params:
            found |= {*parameter.opts, *parameter.secondary_opts}
        waiting += getattr(command, "commands", {}).values()
    return found | {"--help"}


def test_every_option_that_a_message_names_is_there():
    known = options()
    assert "--leave-out" in known  # so that the commands were found
    named = {option: path.name for path in naming(OPTION) for text in texts(path) for option in OPTION.findall(text)}
    assert len(named) > 20
    assert {option: module for option, module in named.items() if option not in known} == {}


def test_the_library_names_no_options():
    library = [path for path in naming(OPTION) if not path.is_relative_to(SOURCE / "app")]
    whole = re.compile(r"`aerobalance [^`]*`")  # a command to be typed as it stands
    named = {(path.name, text): OPTION.findall(whole.sub("", text)) for path in library for text in texts(path)}
    assert {text: options for text, options in named.items() if options} == {}


def test_every_argument_that_a_message_names_has_an_option():
    calls = [node for path in naming(re.compile(r"\bargument\(")) for node in nodes(path)]
    named = {
        ast.literal_eval(node.args[0])
        for node in calls
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "argument"
    }
    assert named == set(OPTIONS)
    assert set(OPTIONS.values()) <= options()


@pytest.mark.parametrize(
    ("said", "read"),
    [
        (argument("hum"), "--hum"),
        (argument("modes", "auto"), "--modes auto"),
        (argument("replace", True), "--replace"),
        (argument("model_on", False), "--model-on-zero off"),
        (f"a weighing as {argument('tare')}", "--mass"),
        (argument("Schedule.without", ["RM series 3"]), '--leave-out "RM series 3"'),
        (argument("reading_noise", {"rNAME": ...}), "--reading-noise rNAME=VALUE"),
        ("`aerobalance map FILE` and `text`", "`aerobalance map FILE` and `text`"),
    ],
)
def test_the_command_line_puts_options_in_place_of_arguments(said, read):
    assert as_options(f"give {said}; see {said}") == f"give {read}; see {read}"


# ------------------------------------------------------------------------------------------------ numbers that can be


def test_shares_that_cannot_be_are_not_said():
    assert share_text(0.031, 0.004) == "3.1 % of a steady load"
    assert share_text(-0.2, 0.01) == "-20 % of a steady load"
    for share, u in ((-55.0, 1.0), (-1.7e12, 0.0), (0.1, 0.06), (0.1, np.inf), (np.nan, 0.1), (np.inf, 0.0)):
        assert share_text(share, u) == "whose share of a steady load cannot be told from this record"


def test_dampings_that_cannot_be_are_not_said():
    assert damping_text(30.0, 4.0, critical=1000.0) == "30 give or take 4"
    assert damping_text(0.0, 23.0, critical=1000.0) == (
        "it cannot be told from this record but for being less than 0.046 of critical damping"
    )
    assert damping_text(0.0, 1e9, critical=1000.0) == "it cannot be told from this record"
    assert damping_text(1.0, np.nan, critical=1000.0) == "it cannot be told from this record"


def test_frequencies_and_percentages_that_mean_nothing_are_not_said():
    assert frequency_text(165.2, 0.25) == "165.2 Hz (u = 0.25 Hz)"
    assert frequency_text(165.2, 1e9) == "about 1.7e+02 Hz"
    assert percent_text(0.012, most=10) == "1.2 %"
    assert percent_text(1e9, most=10) == "more than 1000 %"


DYNAMICS = Dynamics("AF", 20.0, 20.0 * (2 * np.pi * 60) ** 2, 2 * 0.01 * 20 * 2 * np.pi * 60)


def test_a_missing_mode_that_is_hardly_told_is_named_without_numbers():
    """As it was met in a real record: -55 times a steady load, and more ringing than the load had."""
    missing = Mode(15.14, 0.01, -55.0)
    sentence = (
        OtherDynamics("AF", missing=missing, u_frequency=0.1, u_share=100.0, size=None).doubts(DYNAMICS)[0].doubt.text
    )
    assert "15.14 Hz (u = 0.1 Hz), whose share of a steady load cannot be told from this record" in sentence
    assert "it swings;" in sentence
    assert "e+" not in sentence


def test_a_line_of_hum_is_no_damping_ratio():
    """As met in a real record: 60 Hz near the natural frequency, taken for a damping ratio of 5e-6."""
    sentence = OtherDynamics("AF", frequency=(0.01, 1e-4), damping=(-0.99952, 0.01)).doubts(DYNAMICS)[0].doubt.text
    assert "another natural frequency, 60.6 Hz and not 60 Hz" in sentence
    assert "another damping ratio, less than 0.0005 and not 0.01" in sentence
    sentence = OtherDynamics("AF", damping=(0.5, 0.01)).doubts(DYNAMICS)[0].doubt.text
    assert "another damping ratio, 0.015 and not 0.01" in sentence


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.soak(first=1)
def test_no_ringing_is_said_to_be_more_than_the_load_has(seed):
    """A shaken ground end whose load is far more than what is felt: a mode is looked for in what is not the load."""
    generator = np.random.default_rng(seed)
    rate, count = 1000.0, 8192
    time = np.arange(count) / rate
    load = generator.normal(0, 1.0, count)
    tone = np.cumsum(generator.normal(0, 1, count))
    ground = 30 * np.cos(2 * np.pi * 15 * time + 0.02 * tone)
    channels = {
        "AF": Channel("AF", load, "N", noise=1.0),
        "ground_acceleration": Channel("ground_acceleration", ground, "m/s^2", noise=0.01),
    }
    recording = Recording.from_columns(time, channels, name="run")
    found = other_dynamics_in(force_record(recording, DYNAMICS).component_record("AF"), noise=1.0)
    assert found.size is None or found.size <= 1.1
    for one in found.doubts(DYNAMICS):
        for percent in re.findall(r"(-?[\d.e+]+) % of a steady load", one.doubt.text):
            assert abs(float(percent)) <= 100


def ringing(shares: tuple[float, ...], frequencies: tuple[float, ...], *, noise: float, seed: int) -> Recording:
    """A load of 100 N that is released after 0.3 s from a place where each mode carries a share of it."""
    generator = np.random.default_rng(seed)
    time = np.arange(4000) / 2000.0
    since = np.maximum(time - 0.3, 0)
    load = np.zeros(time.size)
    for share, frequency in zip(shares, frequencies, strict=True):
        w, ratio = 2 * np.pi * frequency, 0.01
        turn = w * np.sqrt(1 - ratio**2)
        load += (
            100 * share * np.exp(-ratio * w * since) * (np.cos(turn * since) + ratio / 0.99995 * np.sin(turn * since))
        )
    values = load + generator.normal(0, noise, time.size)
    return Recording.from_columns(time, {"AF": Channel("AF", values, "N")}, name="cut")


def test_modes_whose_share_would_be_more_than_the_load_are_not_taken_up():
    """Two modes that ring against each other and carry little of the load together: shares of 3 and -2."""
    values = ringing((0.9, 0.1), (60.0, 143.0), noise=0.1, seed=4).channel("AF").values
    time = np.arange(values.size) / 2000.0
    look = first_look(values, rate=2000.0, name="cut")
    ring = fit_ring(time, values, look, lines=(DecayLine(143.0, 0.01 * 2 * np.pi * 143.0),))
    assert _kept_modes(ring, "auto", "cut") == [0]
    sizes = ring.sizes.copy()
    sizes[-1] *= -6  # the height of the further mode: 10 N become -60 N
    ring = replace(ring, sizes=sizes)
    heights = ring.modes()[0][:, 2]
    np.testing.assert_allclose(heights / heights.sum(), (3, -2), rtol=0.05)
    assert _kept_modes(ring, "auto", "cut") == []
    with pytest.raises(FitError, match="more than the whole load"):
        _kept_modes(ring, 2, "cut")
    assert "cannot be told from this record" in _way_to_take_it_up(ring, 0)


def test_the_advice_on_a_further_mode_is_taken():
    """After a release from rest --modes auto does take a further mode up, as the warning says."""
    recording = ringing((0.9, 0.1), (60.0, 143.0), noise=0.1, seed=5)
    with pytest.warns(DataQualityWarning, match=r"143 Hz, .* of the first, .*`modes='auto'` takes it up"):
        identify_decay(recording, mass=20.0)
    (mode,) = identify_decay(recording, mass=20.0, modes="auto").dynamics.further_modes
    assert mode.share == pytest.approx(0.1, abs=0.01)


def test_where_no_option_helps_the_advice_is_another_record():
    """Cut off in the middle of its ringing, a record tells no share of a load: --modes auto refuses it."""
    whole = ringing((0.9, 0.1), (60.0, 143.0), noise=0.1, seed=6)
    values = whole.channel("AF").values[700:]
    recording = Recording.from_columns(
        np.arange(values.size) / 2000.0, {"AF": Channel("AF", values, "N")}, name="late"
    )
    with pytest.warns(DataQualityWarning) as caught:
        identify_decay(recording, mass=20.0)
    said = [str(item.message) for item in caught if "a further mode" in str(item.message)]
    assert said and all("a record of a clean release from rest" in text for text in said)
    with pytest.raises(FitError, match="clean release from rest"):
        identify_decay(recording, mass=20.0, modes="auto")
