"""Test set-ups: what is taken, what is refused and how it is said, and that writing one gives it back."""

import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aerobalance.acquisition.intake import AtLevel, AtOnce, AtTime, OnCall
from aerobalance.acquisition.planned import plan_of
from aerobalance.acquisition.setup import (
    Setup,
    load_setup,
    parse_setup,
    save_setup,
    setup_from,
    setup_text,
    stored_channels,
)
from aerobalance.acquisition.source import SourceChannel
from aerobalance.acquisition.sources import open_source
from aerobalance.recording.errors import FitError, ReadError
from seeds import trials

FULL = '''
name = "wing A, run 12"
notes = """after the new
fairing \\u007f"""

[files]
balance = "balance.json"
dynamics = "dynamics.json"
mass = "mass.json"

[source]
kind = "simulated"
rig = "vibration"
rate = 5000.0
seed = 3
speed = inf
frequency = 250.0

[record]
seconds = 30.0
block = 0.05
pre_trigger = 0.5
trigger = "level"
channel = "AF"
level = 20.0
edge = "falling"

[channels.AF]
unit = "lbf"
sign = -1
noise = 0.3
delay = 1e-4

[channels.ground_acceleration]
input = "live_acceleration"
unit = "g"
coupling = "ac"
corner = 0.5

[channels."tap 3"]
input = "pitch"
unit = "deg"

[limits.AF]
low = -500.0
high = 500.0
action = "stop"
'''

WRONG = {
    "no toml": ("a = ", ["is no TOML"]),
    "unknown table": ("[chanels.AF]\n", ["chanels", "is not known", "channels"]),
    "unknown key": ("[record]\nsecond = 3\n", ["record.second", "is not known", "seconds"]),
    "seconds below zero": ("[record]\nseconds = -3.0\n", ["record.seconds", "greater than 0", "-3.0"]),
    "seconds infinite": ("[record]\nseconds = inf\n", ["record.seconds", "inf"]),
    "text for number": ('[record]\nseconds = "long"\n', ["record.seconds", "'long'"]),
    "unknown source": ('[source]\nkind = "labview"\n', ["source.kind", "labview", "simulated, replay"]),
    "source without kind": ("[source]\nrate = 5.0\n", ["source.kind", "is missing"]),
    "source no table": ("source = 3\n", ["source", "must be a table"]),
    "source settings": ('[source]\nkind = "simulated"\nfile = "x"\n', ["source.file", "is not known", "rig"]),
    "replay without file": ('[source]\nkind = "replay"\n', ["source.file", "is missing"]),
    "rig": ('[source]\nkind = "simulated"\nrig = "kite"\n', ["source.rig", "vibration", "'kite'"]),
    "unit of another kind": ('[channels.AF]\nunit = "kg"\n', ["channels.AF.unit", "[kg]", "a force", "lbf"]),
    "unit unknown": ('[channels.AF]\nunit = "Newtonx"\n', ["channels.AF.unit", "Newtonx"]),
    "sign": ("[channels.AF]\nsign = 2\n", ["channels.AF.sign", "1 or -1"]),
    "scale zero": ("[channels.AF]\nscale = 0.0\n", ["channels.AF.scale", "must not be zero", "leave the channel out"]),
    "corner alone": ("[channels.ground_acceleration]\ncorner = 1.0\n", ["corner", 'coupling = "ac"']),
    "coupling of a force": ('[channels.AF]\ncoupling = "dc"\n', ["channels.AF", "coupling is for accelerations"]),
    "name of a channel": ('[channels."A[F]"]\n', ["'A[F]' is no name"]),
    "time as a channel": ("[channels.time]\n", ["'time' is no name"]),
    "level without channel": ('[record]\ntrigger = "level"\n', ["record", "needs channel and level"]),
    "level without trigger": ("[record]\nlevel = 3.0\n", ["record", 'go with trigger = "level"']),
    "time without delay": ('[record]\ntrigger = "time"\n', ["record", "delay"]),
    "trigger channel": (
        '[channels.AF]\n[record]\ntrigger = "level"\nchannel = "NF"\nlevel = 1.0\n',
        ["record.channel", "no NF", "AF"],
    ),
    "limit without end": ("[limits.AF]\n", ["limits.AF", "low or high"]),
    "limits crossed": ("[limits.AF]\nlow = 2.0\nhigh = 1.0\n", ["limits.AF", "low must be below high"]),
    "limit of no channel": ("[channels.NF]\n[limits.AF]\nlow = 2.0\n", ["limits.AF", "no AF", "NF"]),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_set_up_says_what_and_where(name, tmp_path) -> None:
    text, parts = WRONG[name]
    file = tmp_path / "test.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ReadError) as caught:
        load_setup(file)
    assert str(file) in str(caught.value)
    for part in parts:
        assert part in str(caught.value)


def test_files_that_are_no_set_up(tmp_path) -> None:
    with pytest.raises(ReadError, match="there is no such file"):
        load_setup(tmp_path / "none.toml")
    with pytest.raises(ReadError, match="is a folder; a file is needed"):
        load_setup(tmp_path)
    large = tmp_path / "large.toml"
    large.write_bytes(b"#" * 1_000_001)
    with pytest.raises(ReadError, match="larger than"):
        load_setup(large)
    large.write_bytes(b"\xff\xfe")
    with pytest.raises(ReadError, match="no TOML"):
        load_setup(large)


def test_set_up_comes_back_as_it_was_written(tmp_path) -> None:
    setup = parse_setup(FULL)
    assert parse_setup(setup_text(setup)) == setup
    save_setup(tmp_path / "copy.toml", setup)
    assert load_setup(tmp_path / "copy.toml") == setup
    assert parse_setup("") == Setup() == parse_setup(setup_text(Setup()))


def test_plan_and_channels_are_those_of_the_set_up() -> None:
    setup = parse_setup(FULL)
    source = open_source(setup, Path())
    assert [channel.name for channel in source.channels] == ["AF", "live_acceleration", "pitch"]
    # the units are told anew, as of a device that gives volts or nothing
    channels = stored_channels(setup, source.channels)
    assert [channel.name for channel in channels] == ["AF", "ground_acceleration", "tap 3"]
    assert (channels[0].unit, channels[0].sign, channels[0].noise, channels[0].delay) == ("lbf", -1, 0.3, 1e-4)
    assert (channels[1].input, channels[1].coupling, channels[1].corner) == ("live_acceleration", "ac", 0.5)
    plan = plan_of(setup, channels, source.rate)
    assert (plan.rows, plan.before, plan.length, plan.after_limit) == (250, 2500, 150_000, 500)
    assert isinstance(plan.trigger, AtLevel)
    assert (plan.trigger.column, plan.trigger.level, plan.trigger.rising) == (0, 20.0, False)
    assert (plan.limits[0].low, plan.limits[0].high, plan.limits[0].action) == (-500.0, 500.0, "stop")


@pytest.mark.parametrize(
    ("text", "kind"),
    [("", AtOnce), ('[record]\ntrigger = "time"\ndelay = 2.0', AtTime), ('[record]\ntrigger = "call"', OnCall)],
)
def test_triggers_of_the_set_up(text, kind) -> None:
    plan = plan_of(parse_setup(text), stored_channels(Setup(), [SourceChannel("AF", "N")]), 100.0)
    assert isinstance(plan.trigger, kind)
    assert kind is not AtTime or plan.trigger.samples == 200


def test_what_does_not_suit_the_source() -> None:
    given_channels = [SourceChannel("AF", "V")]
    with pytest.raises(FitError, match=r"channel AF: the source gives it in \[V\]"):
        stored_channels(Setup(), given_channels)
    with pytest.raises(FitError, match="no channel NF; it has AF"):
        plan_of(parse_setup("[limits.NF]\nlow = 1.0"), stored_channels(Setup(), [SourceChannel("AF", "N")]), 10.0)
    with pytest.raises(FitError, match="no channel 'NF'"):
        open_source(parse_setup("[channels.NF]"), Path())
    with pytest.raises(ValueError, match="up to 45 Hz"):
        open_source(parse_setup('[source]\nkind = "simulated"\nrate = 100.0\n'), Path())


keys = st.sampled_from(
    [
        "name",
        "notes",
        "files",
        "source",
        "record",
        "channels",
        "limits",
        "kind",
        "rate",
        "seconds",
        "AF",
        "unit",
        "low",
    ]
)
scalars = st.one_of(
    st.text(max_size=8),
    st.sampled_from(
        ["simulated", "replay", "level", "time", "N", "lbf", "AF", "stop", "../../etc/passwd", "\0", "ac"]
    ),
    st.integers(-(2**70), 2**70),
    st.floats(),
    st.booleans(),
    st.none(),
)
trees = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys | st.text(max_size=5), inner, max_size=5)
)


def check_any_data(given_data):
    try:
        setup = setup_from(given_data)
    except ReadError as problem:
        assert len(str(problem)) < 1000
        return
    assert parse_setup(setup_text(setup)) == setup


def check_any_damage(data):
    text = FULL
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        cut = data.draw(st.integers(0, 8))
        text = text[:at] + data.draw(st.text(max_size=4)) + text[at + cut :]
    try:
        setup = parse_setup(text)
    except ReadError:
        return
    back = parse_setup(setup_text(setup))
    assert back == setup or any(math.isnan(x) for x in (setup.source.model_dump().get("speed", 0),))


def tried(check, of, examples):
    """Run a check on so many examples, others every time."""
    how = settings(deadline=None, max_examples=examples, suppress_health_check=list(HealthCheck), database=None)
    how(given(of)(check))()


ANY_DATA = st.dictionaries(keys, trees, max_size=6)


def test_any_data_is_a_set_up_or_a_clear_error() -> None:
    tried(check_any_data, ANY_DATA, trials(40, 100))


def test_any_damage_to_a_set_up_is_a_clear_error_or_a_set_up() -> None:
    tried(check_any_damage, st.data(), 100)


@pytest.mark.long
def test_thousands_of_set_ups_in_data_and_text() -> None:
    tried(check_any_data, ANY_DATA, 5_000)
    tried(check_any_damage, st.data(), 5_000)
