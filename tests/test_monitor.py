"""What the page shows, against the core; who may use it; and that nothing sent to it does harm."""

from __future__ import annotations

import json
import math
import struct
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from starlette.websockets import WebSocketDisconnect

from aerobalance.acquisition.feed import SourceInfo
from aerobalance.acquisition.setup import setup_from, stored_channels
from aerobalance.acquisition.simulated import rig_dynamics
from aerobalance.acquisition.source import Block, SourceChannel
from aerobalance.app.monitor.access import AccessPolicy, is_loopback
from aerobalance.app.monitor.command import Reach, monitor
from aerobalance.app.monitor.display import DisplayState, plain
from aerobalance.app.monitor.folder import Folder
from aerobalance.app.monitor.form import LABELS, form_of
from aerobalance.app.monitor.jobs import Task, outcome_of
from aerobalance.app.monitor.log import Log
from aerobalance.app.monitor.messages import News, Watching
from aerobalance.app.monitor.panels import panel_of
from aerobalance.app.monitor.server import STATIC, Page
from aerobalance.app.monitor.session import Beginning
from aerobalance.app.monitor.setups import rig_setup, setup_of_record
from aerobalance.app.monitor.tasks import Tasks
from aerobalance.app.monitor.view import Panel, View, _weights
from aerobalance.app.monitor.viewer import UNSHOWN
from aerobalance.dynamics.independent import NO_DYNAMICS, dynamics_of
from aerobalance.estimation.live.live_force import LiveForce
from aerobalance.estimation.live.settings import LiveSettings
from aerobalance.io.dynamics_file import read_any_dynamics, write_dynamics
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.recording.channel import QUANTITIES
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY, si_unit
from aerobalance.recording.errors import FitError
from aerobalance.simulation.calibration_stand import random_balance
from aerobalance.simulation.published import CABLE_CUT, VIBRATION_RIG
from aerobalance.simulation.six_balance import random_balance as six_balance
from helpers.running_page import BASE, LIVE, Running, source_of


def view_of(source, **more):
    channels = stored_channels(setup_from({}), source.channels)
    dynamics = rig_dynamics(source.settings.rig)
    return View(Panel(channels, source.rate, True, dynamics, more.pop("half", {}), more.pop("limits", {}), **more))


# ---- what is shown


def test_the_force_shown_is_the_live_force() -> None:
    source = source_of("cable_cut", seed=5, cut_at=1.0)
    view = view_of(source)
    live = LiveForce(CABLE_CUT.dynamics, rate=1600, settings=LiveSettings(learn_inside=False))
    blocks = [source.read(1.0) for _ in range(100)]
    first, shown = None, []
    for block in blocks:
        view.feed(block)
        for bins in view.take().forces.get("AF", ()):
            first = bins.first if first is None else first
            shown.append(bins.least)
    shown = np.concatenate(shown)
    samples = np.concatenate([block.samples for block in blocks])
    expected = live.push({"AF": samples[:, 0], "pitch": samples[:, 3]})["AF"]
    assert view.lines["AF"].factor == view.width == 1
    assert first == expected.first == 0
    # one sample a bin, and what is final does not depend on the chunks
    np.testing.assert_allclose(shown[:, 0], expected.force[: len(shown)], atol=1e-6)
    np.testing.assert_allclose(shown[:, 1], expected.uncertainty[: len(shown)], atol=1e-6)
    assert len(shown) > 3000
    assert abs(float(np.mean(shown[-500:, 0]))) < 5


def test_thinned_force_keeps_its_time(seed) -> None:
    source = source_of("cable_cut", seed=seed, cut_at=1.0, rate=25_000.0)
    view = view_of(source)
    pieces = []
    while source._tick < 2 * source.rate:
        view.feed(source.read(1.0))
        update = view.take()
        pieces += [(bins.first, bins.least[:, 0]) for bins in update.forces.get("AF", ())]
    force = np.concatenate([part for _, part in pieces])
    time_ = (pieces[0][0] + np.arange(force.size)) * view.width / source.rate
    line = view.lines["AF"]
    assert line.factor == int(25_000 / (16 * CABLE_CUT.dynamics.natural_frequency)) == 23
    cut = time_[np.nanargmax(np.abs(np.diff(force)))]
    # the jump lies within a sample of the thinned force and a bin, 1 ms each, of the cut
    assert abs(cut - 1.0) < 3e-3
    known = np.isfinite(force)
    assert np.mean(force[known & (time_ > 0.5) & (time_ < 0.97)]) == pytest.approx(-1020, abs=5)


def test_six_coupled_forces_are_shown_while_the_ground_shakes(seed) -> None:
    source = source_of("six", seed=seed, noise=0.1, rate=6000.0)
    view = view_of(source)
    shown = {name: [] for name in COMPONENTS}

    def follow(seconds: float) -> dict[str, np.ndarray]:
        stop = source._tick + seconds * source.rate
        while source._tick < stop:
            view.feed(source.read(1.0))
            for name, parts in view.take().forces.items():
                shown[name] += [(bins.first * view.width / source.rate, bins.least) for bins in parts]
        return {name: np.concatenate([part for _, part in parts]) for name, parts in shown.items()}

    forces = follow(1.2)
    assert set(view.lines) == set(COMPONENTS)
    assert not view.lines["AF"].moving
    for name, force in forces.items():
        assert force[-200:, 0].mean() == pytest.approx(-1020, abs=5 * np.nanmean(force[-200:, 1])), name
    source.control("shake", 2.0)
    source.control("cut", 1.0)
    forces = follow(2.5)
    assert all(line.moving for line in view.lines.values())
    for name, force in forces.items():
        error = force[-500:, 0]
        # a wide band while nothing is learned: within what is said, and of its order
        assert np.sqrt(np.mean(error**2)) < 2 * np.mean(force[-500:, 1]), name


def test_forces_come_from_the_gauges_of_the_six_components_rig(seed) -> None:
    matrix = six_balance(np.random.default_rng(seed)).matrix
    source = source_of("six", seed=seed, noise=0.01, rate=3000.0, cable_force=-10.0, balance=matrix)
    assert source.names[:6] == tuple(f"r{name}" for name in COMPONENTS)
    assert {channel.unit for channel in source.channels[:6]} == {"mV/V"}
    view = view_of(source, balance=matrix)
    shown = {name: [] for name in COMPONENTS}
    while source._tick < source.rate:
        view.feed(source.read(1.0))
        for name, parts in view.take().forces.items():
            shown[name] += [bins.least for bins in parts]
    for name in COMPONENTS:
        force = np.concatenate(shown[name])
        assert force[-50:, 0].mean() == pytest.approx(-10, abs=5 * force[-50:, 1].mean()), name
        # noise of 0.1 N by gauge, mixed by the matrix and raised by the inverse to 168 Hz, over a balance of 56 Hz and
        # more by up to (168 / 56)^2: a few newtons at most
        assert force[-50:, 1].mean() < 5, name


def test_coupled_dynamics_need_all_their_components(tmp_path) -> None:
    channels = [(name, QUANTITIES[name]) for name in COMPONENTS[1:]]
    with pytest.raises(FitError, match="there is no NF among PM"):
        panel_of(setup_from({"source": {"kind": "simulated", "rig": "six"}}), hello_of(*channels), tmp_path, {})


def test_a_set_up_may_name_coupled_dynamics(tmp_path) -> None:
    write_dynamics(tmp_path / "six.json", rig_dynamics("six"), inputs=[])
    setup = setup_from({"source": {"kind": "replay", "file": "run.csv"}, "files": {"dynamics": "six.json"}})
    channels = [(name, QUANTITIES[name]) for name in ("pitch", *COMPONENTS)]
    panel = panel_of(setup, hello_of(*channels), tmp_path, {})
    assert panel.components == COMPONENTS
    # the weight that a zero must leave in: at 30 degrees half of it along the balance, and the rest across
    mass = rig_dynamics("six").mass.mass
    means = np.array([np.pi / 6, *np.zeros(6)])
    assert _weights(panel, means)["AF"] == pytest.approx(mass * STANDARD_GRAVITY / 2)
    assert _weights(panel, means)["NF"] == pytest.approx(-mass * STANDARD_GRAVITY * math.sqrt(3) / 2)


def test_releases_are_identified_together(tmp_path) -> None:
    source = source_of("six", seed=4, cut_at=0.3, rate=2000.0, noise=0.1)
    loads = np.concatenate([source.read(1.0).samples[:, :6] for _ in range(75)])
    time_ = np.arange(len(loads)) / 2000
    head = ",".join(["time [s]", *(f"{name} [{si_unit(name)}]" for name in COMPONENTS)])
    np.savetxt(tmp_path / "cut.csv", np.column_stack([time_, loads]), delimiter=",", header=head, comments="")
    found = outcome_of(Task(1, "together", (str(tmp_path / "cut.csv"),), {}))
    assert found.done, found.text
    assert found.files == ("cut-dynamics.json",)
    dynamics = read_any_dynamics(tmp_path / "cut-dynamics.json")
    expected = [mode.natural_frequency for mode in rig_dynamics("six").modes]
    # 1.2 s of decays with a noise of 0.1 % of the release: the worst is known to 0.004 Hz by its own account
    assert [mode.natural_frequency for mode in dynamics.modes] == pytest.approx(expected, abs=0.05)


def test_a_gap_is_told_with_its_length_and_the_force_goes_on() -> None:
    source = source_of("cable_cut", seed=6)
    view = view_of(source)
    blocks = [source.read(1.0) for _ in range(200)]
    for number, block in enumerate(blocks):
        if number not in (80, 81, *range(120, 150)):
            view.feed(block)
    update = view.take()
    gaps = [(tick, text) for tick, kind, text in update.remarks if kind == "gap"]
    assert [tick for tick, _ in gaps] == [80 * 32, 120 * 32]
    assert gaps[0][1].startswith("64 samples") and gaps[1][1].startswith(f"{30 * 32} samples")
    assert update.lost == 32 * 32
    # two blocks (40 ms) are bridged, as the force lags by 76 ms; after thirty it begins anew
    ends = [bins.first + len(bins.least) for bins in update.forces["AF"]]
    assert ends[-1] > 200 * 32 - 200
    assert view.lines["AF"].health["AF"].missing == 0  # counted from the new beginning
    raw = [(bins.first, bins.least) for bins in update.raw]
    assert np.isnan(raw[80][1][:64, 0]).all() and np.isfinite(raw[80][1][64:, 0]).all()


def test_the_verdict_on_the_live_force_is_shown_with_its_reasons() -> None:
    source = source_of("cable_cut", seed=9)
    sound, dead = view_of(source), view_of(source)
    own = sound.panel.dynamics["AF"]
    other = View(replace(sound.panel, dynamics=dynamics_of(replace(own, stiffness=1.3 * own.stiffness))))
    verdicts, reasons = [], []
    for number in range(700):
        if number == 600:
            source.control("cut", 1)
        block = source.read(1.0)
        for view in (sound, other):
            view.feed(block)
            snapshot = view.lines["AF"].due()
            if snapshot is not None:
                view.lines["AF"].adopt(snapshot.learn())
        samples = block.samples.copy()
        samples[:, 0] = 500.0 if number > 300 else samples[:, 0]
        dead.feed(replace(block, samples=samples))
        verdicts += [health.get("verdict") for health in sound.take().health.values() if number < 600]
        reasons += [doubt["kind"] for health in other.take().health.values() for doubt in health.get("doubts", ())]
    verdicts = [one for one in verdicts if one]  # none before there is a force
    assert verdicts.count("fit for use") >= 0.95 * len(verdicts) > 0
    assert "unexplained" in reasons or "natural frequency" in reasons  # it rings after the cut, and elsewhere
    assert "stuck channel" in [doubt["kind"] for doubt in dead.take().health["AF"]["doubts"]]


def test_what_was_departed_from_is_learned_anew() -> None:
    source = source_of("cable_cut", seed=9)
    view = view_of(source)
    line = view.lines["AF"]
    processes = []
    for number in range(1300):
        if number == 600:
            source.control("cut", 1)
        if number == 700:
            source.control("hang", 1)  # a ramp of a second: no step, and nothing like what was learned
        view.feed(source.read(1.0))
        snapshot = line.due()
        if snapshot is not None:
            line.adopt(snapshot.learn())
        processes.append(line.health["AF"].process if line.health else "waiting")
    assert processes[590] == "learned"
    assert "fallback" in processes[700:1000]
    assert processes[-1] == "learned"


def test_zero_leaves_the_weight() -> None:
    source = source_of("vibration", seed=7, noise=0.0, amplitude=0.0)
    view = view_of(source)
    with pytest.raises(ValueError, match="no readings yet"):
        view.zeros()
    for _ in range(20):
        view.feed(source.read(1.0))
    weight = VIBRATION_RIG.mass * STANDARD_GRAVITY
    assert view.take().readings["AF"].mean == pytest.approx(weight)
    assert view.zeros()["AF"] == pytest.approx(0.0, abs=1e-9)
    view.set_zeros({"AF": 2.5})
    for _ in range(20):
        view.feed(source.read(1.0))
    assert view.take().readings["AF"].mean == pytest.approx(weight - 2.5)
    assert view.zeros()["AF"] == pytest.approx(0.0, abs=1e-9)


def view_of_channels(*names: str, **more) -> View:
    """A view of channels in SI at 1000 Hz, without dynamics unless some are given."""
    channels = tuple(StoredChannel(name=name, unit=QUANTITIES.get(name, "mV/V")) for name in names)
    return View(Panel(channels, 1000.0, True, more.pop("dynamics", NO_DYNAMICS), {}, more.pop("limits", {}), **more))


def feed_constant(view: View, values, ticks: int, first: int) -> None:
    view.feed(Block(first, np.tile(np.asarray(values, float), (ticks, 1)), (first + ticks) / 1000))


def test_samples_less_the_zero_before_are_in_no_later_mean() -> None:
    view = view_of_channels("AF")
    feed_constant(view, [100.0], 100, 0)  # held for the numbers to come
    view.set_zeros({"AF": 100.0})
    feed_constant(view, [100.0], 100, 100)
    feed_constant(view, [100.0], 100, 200)
    assert view.take().readings["AF"].mean == 0.0
    assert view.zeros() == {"AF": 100.0}


@pytest.mark.parametrize("ticks", [20, 100, 200])
def test_means_since_does_not_depend_on_the_blocks(ticks) -> None:
    view = view_of_channels("AF")
    for first in range(0, 600, ticks):
        feed_constant(view, [1.0], ticks, first)
    # a sample a millisecond, the first at 1 ms
    assert view.means_since == pytest.approx(0.001, abs=1e-9)
    assert len(view.means) == 3
    for first in range(600, 1400, ticks):
        feed_constant(view, [1.0], ticks, first)
    assert view.means_since == pytest.approx(0.401, abs=1e-9)  # five spans of 0.2 s end at 1.4 s


def test_a_zero_is_taken_of_what_was_read_of_the_last_second() -> None:
    view = view_of_channels("AF", "pitch", dynamics=dynamics_of(CABLE_CUT.dynamics))
    for part in range(5):
        feed_constant(view, [100.0, math.nan if part == 2 else 0.1], 200, 200 * part)
    expected = 100.0 - CABLE_CUT.dynamics.mass * STANDARD_GRAVITY * math.sin(0.1)
    assert view.zeros() == {"AF": pytest.approx(expected, rel=1e-12)}
    for part in range(5, 10):
        feed_constant(view, [100.0, math.nan], 200, 200 * part)
    with pytest.raises(ValueError, match="no readings of pitch in the last second, without which the weight cannot"):
        view.zeros()


def test_a_load_that_was_not_read_keeps_its_zero() -> None:
    view = view_of_channels("AF", "NF", "SF", zeros={"AF": 90.0, "NF": 50.0})
    for part in range(5):
        feed_constant(view, [100.0, math.nan if part == 2 else 80.0, math.nan], 200, 200 * part)
    assert view.zeros() == {"AF": 100.0, "NF": 80.0}
    for part in range(5, 10):
        feed_constant(view, [100.0, math.nan, math.nan], 200, 200 * part)
    assert view.zeros() == {"AF": 100.0, "NF": 50.0}
    for part in range(10, 15):
        feed_constant(view, [math.nan] * 3, 200, 200 * part)
    with pytest.raises(ValueError, match="no readings"):
        view.zeros()


def test_no_zero_of_a_balance_one_bridge_of_which_is_not_read(seed) -> None:
    balance = random_balance(seed)
    view = view_of_channels(*(f"r{name}" for name in balance.gauges), balance=balance)
    feed_constant(view, [0.1, math.nan, *[0.1] * 4], 200, 0)
    with pytest.raises(ValueError, match=f"no readings of r{balance.gauges[1]} in .* which the loads cannot"):
        view.zeros()


@pytest.mark.parametrize("zeroed", [False, True], ids=["natural zeros", "zeros of the day in the set-up"])
def test_zero_under_a_weight_reads_curved_bridges_from_where_they_are(rng, seed, zeroed) -> None:
    balance = replace(random_balance(seed), natural_zero=rng.uniform(-0.05, 0.05, 6))
    empty = balance.natural_zero + (0.1 if zeroed else 0.0)
    offsets = -1e3 * empty if zeroed else np.zeros(6)
    hung = rng.uniform(0.2, 0.5, 6) * balance.load_scale
    added = rng.uniform(-0.3, 0.3, 6) * balance.load_scale
    given = zip(balance.gauges, offsets.tolist(), strict=True)
    channels = tuple(StoredChannel(name=f"r{name}", unit="uV/V", offset=offset) for name, offset in given)
    view = View(Panel(channels, 1000.0, True, NO_DYNAMICS, {}, {}, balance=balance))

    def shown(native: np.ndarray) -> dict:
        outputs = balance.outputs(np.tile(native, (400, 1))) + empty
        view.feed(Block(400 * shown.blocks, 1e3 * outputs, 0.0))
        shown.blocks += 1
        return view.take().readings

    shown.blocks = 0
    for _ in range(3):
        readings = shown(hung)
    for name, expected in zip(COMPONENTS, balance.direct @ hung, strict=True):
        # the iteration ends at 1e-9 of capacity or below
        assert readings[name].mean == pytest.approx(expected, rel=1e-6, abs=1e-4)
    view.set_zeros(view.zeros())
    for _ in range(3):
        readings = shown(hung + added)
    for name, expected in zip(COMPONENTS, balance.direct @ added, strict=True):
        assert readings[name].mean == pytest.approx(expected, rel=1e-6, abs=1e-4)


def test_loads_from_gauge_outputs(rng, seed) -> None:
    balance = random_balance(seed)
    native = rng.uniform(-0.3, 0.3, (400, 6)) * balance.load_scale
    zero = rng.uniform(-0.05, 0.05, 6)
    outputs = balance.outputs(native) + zero
    channels = tuple(StoredChannel(name=f"r{name}", unit="uV/V") for name in balance.gauges)
    zeros = {f"r{name}": float(value) for name, value in zip(balance.gauges, zero, strict=True)}
    view = View(Panel(channels, 1000.0, True, NO_DYNAMICS, {}, {}, zeros=zeros, balance=balance))
    view.feed(Block(0, 1e3 * outputs, 0.0))
    readings = view.take().readings
    expected = native @ balance.direct.T
    for place, name in enumerate(COMPONENTS):
        # the iteration ends at 1e-9 of capacity or below
        assert readings[name].mean == pytest.approx(expected[:, place].mean(), rel=1e-6, abs=1e-4)
    with pytest.raises(FitError, match="the balance needs"):
        View(Panel(channels[1:], 1000.0, True, NO_DYNAMICS, {}, {}, balance=balance))


@pytest.mark.parametrize(
    ("limit", "state"), [((-3000.0, 3000.0), "ok"), ((-1200.0, 50.0), "high"), ((-1000.0, math.inf), "over")]
)
def test_alarms_use_the_balance_load(limit, state) -> None:
    source = source_of("cable_cut", seed=8, noise=0.0)
    view = view_of(source, half={"AF": 2000.0}, limits={"AF": limit})
    for _ in range(12):
        view.feed(source.read(1.0))
    reading = view.take().readings["AF"]
    assert reading.state == state
    assert reading.percent == pytest.approx(100 * 1020 / 2000)
    assert reading.limit == pytest.approx(1020 / -limit[0])


@pytest.mark.parametrize(
    ("limits", "value", "share", "state"),
    [
        ((-math.inf, 500.0), 490.0, 0.98, "high"),
        ((-math.inf, 500.0), -490.0, 0.0, "ok"),
        ((0.0, math.inf), -1.0, math.inf, "over"),
        (None, 1960.0, 0.98, "high"),
    ],
)
def test_share_of_limits_one_of_which_may_be_open(limits, value, share, state) -> None:
    panel = Panel((StoredChannel(name="AF", unit="N"),), 1000.0, True, NO_DYNAMICS, {"AF": 2000.0}, {})
    view = View(panel if limits is None else replace(panel, limits={"AF": limits}))
    feed_constant(view, [value], 200, 0)
    reading = view.take().readings["AF"]
    assert (reading.state, reading.limit) == (state, pytest.approx(share))
    assert reading.percent == pytest.approx(100 * abs(value) / 2000)


def parsed(frame):
    kind, level, groups, _, sequence, panel, _, newest, oldest, tick = struct.unpack_from("<BBBBIIIddd", frame)
    at, found = 40, {}
    for _ in range(groups):
        place, columns, _, count, first = struct.unpack_from("<BBHId", frame, at)
        values = np.frombuffer(frame, "<f4", count * columns * 2, at + 16).reshape(count, columns, 2)
        found[place] = (int(first), values)
        at += 16 + values.nbytes
    assert at == len(frame)
    return (kind, level, sequence, panel, tick), (newest, oldest), found


def test_a_slow_viewer_loses_no_peak(seed) -> None:
    source = source_of("vibration", seed=seed)
    view, board = view_of(source), DisplayState()
    names = view.panel.names
    board.begin(Watching(1, names, ("",) * 4, source.rate, view.width, ("AF",), {}, {}, {}, {}))
    quick, slow, taken = [0, 0], [0, 0], []
    samples = []
    for number in range(60):
        block = source.read(1.0)
        samples.append(block.samples)
        view.feed(block)
        board.take(News(1, view.take(), {}))
        frame = board.data_frame(number + 1, 0, quick)
        if frame is not None:
            taken.append(parsed(frame)[2][0])
    head, times, late = parsed(board.data_frame(99, 0, slow))
    assert head == (1, 0, 99, 1, 60 * 500.0)
    assert times[0] - times[1] == pytest.approx(1e3 * 60 * 0.02)
    assert slow == quick
    np.testing.assert_array_equal(late[0][1], np.concatenate([values for _, values in taken]))
    whole = np.concatenate(samples).astype(np.float32).reshape(-1, view.width, 4)
    np.testing.assert_array_equal(late[0][1][:, :, 0], whole.min(axis=1))
    np.testing.assert_array_equal(late[0][1][:, :, 1], whole.max(axis=1))
    assert board.data_frame(100, 0, slow) is None


@pytest.mark.parametrize("wild", [math.inf, 1e308, 1e160])
@pytest.mark.soak(first=1)
def test_samples_beyond_all_measure_count_as_missing(wild) -> None:
    source = source_of("six", seed=6)
    hello = SourceInfo(tuple(source.channels), source.rate, True, "a source", ())
    setup = setup_from({"source": {"kind": "simulated", "rig": "six"}})
    view = View(panel_of(setup, hello, Path(), {}))
    plain = View(panel_of(setup, hello, Path(), {}))
    for number in range(60):
        block = source.read(1.0)
        spoiled, missing = block.samples.copy(), block.samples.copy()
        if number == 30:
            spoiled[5:8, 0], spoiled[9, 1] = wild, -wild
            missing[5:8, 0] = missing[9, 1] = math.nan
        view.feed(replace(block, samples=spoiled))
        plain.feed(replace(block, samples=missing))
    given, expected = view.take(), plain.take()
    assert given.estimates == expected.estimates
    assert [text for _, kind, text in given.remarks if kind == "too large"] == [
        "beyond 1e+100 either way, which no reading is; they count as missing: 3 of NF, 1 of PM"
    ]
    assert not expected.remarks


def test_plain_data_has_no_nan() -> None:
    given = {"a": float("nan"), "b": (np.float64(1.5), np.bool_(True), -math.inf), 3: [np.int64(4)]}
    assert plain(given) == {"a": None, "b": [1.5, True, None], "3": [4]}


def hello_of(*channels):
    return SourceInfo(tuple(SourceChannel(*channel) for channel in channels), 1000.0, True, "a source", ())


def test_ranges_limits_and_zeros_are_in_the_units_of_the_channels(tmp_path) -> None:
    setup = setup_from(
        {
            "source": {"kind": "replay", "file": "run.csv"},
            "channels": {"AF": {"input": "ch1", "unit": "lbf", "sign": -1, "half_range": 100.0, "offset": 1.0}},
            "limits": {"AF": {"low": -50.0}},
        }
    )
    hello = hello_of(("ch1", "V"))
    pound = 4.4482216152605  # N, exact by the definition of the pound (0.45359237 kg) and standard gravity
    panel = panel_of(setup, hello, tmp_path, {})
    assert panel.half_ranges["AF"] == pytest.approx(100 * pound)
    assert panel.limits["AF"] == (pytest.approx(-50 * pound), math.inf)
    assert (panel.dynamics.components, panel.components, panel.units) == ((), (), ("N",))
    zeroed = setup_of_record(setup, hello.channels, zeros={"AF": 10 * pound}, notes="cold", seconds=3.0)
    # value = sign (scale reading + offset): an offset of 1 + 10 takes 10 lbf off
    assert zeroed.channels["AF"].offset == pytest.approx(11.0)
    assert (zeroed.notes, zeroed.record.seconds) == ("cold", 3.0)
    before, after = (stored_channels(item, hello.channels)[0].values(np.array([5.0])) for item in (setup, zeroed))
    assert before - after == pytest.approx(10.0)


# ---- who may use it


@pytest.mark.parametrize(
    "name", ["../x.h5", "a/b.h5", "..", "", " x", "x\0.h5", "-rf", ".hidden", "a" * 101, "x\n.h5", "C:\\x", "%2e%2e"]
)
def test_names_that_lead_out_of_the_folder(tmp_path, name) -> None:
    folder = Folder(tmp_path)
    with pytest.raises(ValueError, match="no name for a file"):
        folder.file(name)


def test_links_out_of_the_folder(tmp_path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.h5").write_bytes(b"x")
    (tmp_path / "in" / "link.h5").symlink_to(tmp_path / "secret.h5")
    folder = Folder(tmp_path / "in")
    with pytest.raises(ValueError, match="not below the project folder"):
        folder.recording("link.h5")
    assert folder.recordings() == []
    assert folder.new_recording(" run (2) ").name == "run (2).h5"


def test_dynamics_by_a_link_out_of_the_folder(tmp_path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "run.h5").write_bytes(b"x")
    (tmp_path / "outside.json").write_text("{}")
    (tmp_path / "in" / "run-dynamics.json").symlink_to(tmp_path / "outside.json")
    folder = Folder(tmp_path / "in")
    source, records = SimpleNamespace(setup=rig_setup("cable_cut")), SimpleNamespace(under_way=False)
    tasks = Tasks(folder, source, records, Log(lambda: None, lambda *_: None))
    try:
        with pytest.raises(ValueError, match=r"run-dynamics\.json is not below the project folder"):
            tasks.run("force", ["run.h5"], {})
    finally:
        tasks.close()
    assert folder.with_results()[0]["identified"] is False


def test_other_addresses_need_a_token() -> None:
    assert all(is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "127.3.2.1"))
    assert not any(is_loopback(host) for host in ("0.0.0.0", "10.1.2.3", "example.org", "::"))
    with pytest.raises(ValueError, match="--token"):
        AccessPolicy("0.0.0.0", 80)
    with pytest.raises(ValueError, match="at least 16"):
        AccessPolicy("0.0.0.0", 80, token="short")


@pytest.mark.parametrize(
    ("host", "allowed"),
    [
        ("127.0.0.1:8765", True), ("localhost:8765", True), ("[::1]:8765", True), ("evil.example:8765", False),
        ("", False), ("127.0.0.1:9999", False), ("127.0.0.1.evil.example:8765", False), ("127.0.0.1:8765x", False),
        ("10.0.0.1:8765", False),
    ],
)  # fmt: skip
def test_hosts(host, allowed) -> None:
    assert AccessPolicy("127.0.0.1", 8765).host_allowed(host) is allowed


def test_wrong_calls(tmp_path) -> None:
    with pytest.raises(ValueError, match="--token"):
        monitor(folder=tmp_path, reach=Reach(host="0.0.0.0"), browser=False)
    with pytest.raises(ValueError, match="go together"):
        monitor(folder=tmp_path, reach=Reach(certificate=tmp_path / "c.pem"), browser=False)
    with pytest.raises(ValueError, match="project folder"):
        monitor(folder=tmp_path / "none", browser=False)


# ---- the server


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    with Running(tmp_path_factory.mktemp("project")) as page:
        page.wait(lambda state: state["numbers"].get("estimates"))
        yield page


def test_the_page_comes_from_this_server_alone(running) -> None:
    for path in ("/", *(f"/static/{file.name}" for file in STATIC.iterdir())):
        answer = running.client.get(path)
        assert answer.status_code == 200
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy and "unsafe" not in policy and "http" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
    for file in STATIC.iterdir():
        text = file.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text and "https://" not in text.replace('"https:" ? "wss"', ""), file
        assert " style=" not in text and "eval(" not in text, file


@pytest.mark.parametrize(
    "origin", [None, "http://evil.example", "null", "https://127.0.0.1:8765", "http://127.0.0.1:8766"]
)
def test_requests_of_other_pages(running, origin) -> None:
    headers = {} if origin is None else {"origin": origin}
    running.client.headers.pop("origin")
    try:
        assert running.client.post("/api/mark", json={}, headers=headers).status_code == 403
        with pytest.raises(WebSocketDisconnect) as refused, running.client.websocket_connect(LIVE, headers=headers):
            pass
        assert (refused.value.code, refused.value.reason) == (1008, "this is not asked by the page of this server")
    finally:
        running.client.headers["origin"] = BASE


def test_other_hosts_and_methods(running) -> None:
    assert running.client.get("/", headers={"host": "evil.example"}).status_code == 400
    assert running.client.get("/api/state", headers={"sec-fetch-site": "cross-site"}).status_code == 403
    assert running.client.delete("/api/mark").status_code == 405
    assert running.post("nothing").status_code == 404


@pytest.mark.parametrize(
    "path",
    [
        "/report/..%2f..%2fetc%2fpasswd",
        "/report/%2e%2e",
        "/static/../server.py",
        "/static/%2e%2e/server.py",
        "/file/..%5cx.h5",
        "/file/none.h5",
        "/file/x.py",
    ],
)
def test_files_outside(running, path) -> None:
    assert running.client.get(path).status_code == 404


def test_token() -> None:
    from starlette.testclient import TestClient

    policy = AccessPolicy("127.0.0.1", 8765, token="a-secret-of-some-length")
    page = Page(Beginning(rig_setup("cable_cut"), Folder(STATIC), None), policy=policy)
    client = TestClient(page.app, base_url=BASE, headers={"origin": BASE}, follow_redirects=False)
    assert client.get("/").status_code == 401
    assert client.get("/?token=wrong").status_code == 401
    assert client.post("/api/mark?token=a-secret-of-some-length", json={}).status_code == 401
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE):
        pass
    answer = client.get("/?token=a-secret-of-some-length")
    assert answer.status_code == 303
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(answer.headers["set-cookie"].split("; "))
    assert client.get("/").status_code == 200  # the client keeps the cookie
    client.cookies.clear()
    client.cookies.set("aerobalance_8765", "a-secret-of-some-length")  # the token itself is none
    assert client.get("/").status_code == 401


@pytest.mark.parametrize(
    ("given", "where", "text"),
    [
        ({"record": {"seconds": -1}}, "record.seconds", "greater than 0"),
        ({"record": {"trigger": "level"}}, "record", "needs channel and level"),
        ({"source": {"kind": "nothing"}}, "source.kind", "known"),
        ({"source": {"kind": "replay"}}, "source.file", "missing"),
        ({"source": {"kind": "replay", "file": "/etc/passwd"}}, "source.file", "not below the project folder"),
        ({"files": {"dynamics": "../other.json"}}, "files.dynamics", "not below the project folder"),
        ({"limits": {"AF": {"low": 2, "high": 1}}}, "limits.AF", "low must be below high"),
        ({"channels": {"AF": {"unit": "furlong"}}}, "", "channels.AF.unit"),
        ({"colour": "red"}, "colour", ""),
    ],
)
def test_faults_of_a_set_up_are_told_with_their_field(running, given, where, text) -> None:
    before = running.client.get("/api/state").json()["source"]["number"]
    answer = running.post("setup", setup=given)
    assert answer.status_code == 422
    assert answer.json()["where"] == where
    assert text in answer.json()["error"]
    assert running.client.get("/api/state").json()["source"]["number"] == before


def test_a_set_up_replaces_no_other_file(running) -> None:
    (running.folder / "other.toml").write_text("[project]\nname = 1\n", encoding="utf-8")
    answer = running.post("setup", setup={"source": {"kind": "simulated"}}, name="other")
    assert answer.status_code == 409
    assert "is no test set-up" in answer.json()["error"]
    assert "project" in (running.folder / "other.toml").read_text(encoding="utf-8")


def test_form_lists_every_field() -> None:
    form = form_of(rig_setup("vibration"), None)
    fields = [field for key in ("files", "record", "envelope", "fouling") for field in form[key]]
    fields += [field for kind in (*form["sources"].values(), *form["tables"].values()) for field in kind]
    fields += [inner for field in fields for inner in field.get("fields", ())]
    assert {"source.inputs.physical", "source.skew", "channels.axis"} <= {field["path"] for field in fields}
    assert [field["path"] for field in fields if field["path"] not in LABELS] == []
    assert setup_from(
        {key: value for key, value in form["values"].items() if key != "kind"}
        | {"source": {**form["values"]["source"], "kind": form["values"]["kind"]}}
    ) == rig_setup("vibration")


def test_record_with_zero_mark_and_set_up(running) -> None:
    assert running.post("zero").status_code == 200
    running.wait(lambda state: state["zeros"].get("AF"))
    zero = running.client.get("/api/state").json()["zeros"]["AF"]
    assert zero == pytest.approx(-1020, abs=5)  # 10 N of noise over 1 s is 0.3 N
    assert running.post("record", name="../x").status_code == 409
    assert running.post("record", name="one", notes="the first").status_code == 200
    assert running.post("record", name="two").status_code == 409
    assert running.post("zero").status_code == 409
    running.wait(lambda state: state["record"].get("blocks", 0) >= 3)
    assert running.post("mark", text="a mark").status_code == 200
    assert running.post("stop").status_code == 200
    assert running.post("record", name="one").status_code == 409  # never written over
    kept = contents(running.folder / "one.h5")
    assert kept.state == "ended"
    with h5py.File(running.folder / "one.h5") as file:
        written = file["setup"][...].tobytes().decode()
    assert "the first" in written and "offset" in written
    assert kept.channels[0].offset == pytest.approx(-zero)
    assert running.post("job", verb="info", recording="one.h5").status_code == 200
    state = running.wait(lambda state: state["tasks"] and state["tasks"][-1]["state"] in ("done", "failed"))
    task = running.client.get(f"/api/task/{state['tasks'][-1]['number']}").json()
    assert task["state"] == "done", task
    assert abs(task["account"]["channels"]["AF"]["mean"]) < 5
    assert [item["name"] for item in running.client.get("/api/recordings").json()] == ["one.h5"]
    assert running.post("clear_zero").status_code == 200


def test_two_viewers_one_of_them_asleep(running) -> None:
    with running.client.websocket_connect(LIVE) as asleep, running.client.websocket_connect(LIVE) as awake:
        got, numbers = 0, 0
        limit = time.monotonic() + 120
        while (got < 30 or not numbers) and time.monotonic() < limit:  # a busy machine sends numbers late
            message = awake.receive()
            if message.get("bytes"):
                got += 1
                awake.send_json({"shown": struct.unpack_from("<I", message["bytes"], 4)[0]})
            else:
                numbers += json.loads(message["text"])["type"] == "numbers"
        assert got >= 30 and numbers > 0
        frames = 0
        asleep.send_json({"ping": 1})
        while True:
            message = asleep.receive()
            if message.get("bytes"):
                frames += 1
            elif json.loads(message["text"])["type"] == "pong":
                break
        assert 0 < frames <= UNSHOWN
        asleep.send_json({"shown": UNSHOWN, "level": 0})
        while not (message := asleep.receive()).get("bytes") or message["bytes"][0] != 1:
            pass
        # all that it has missed, in one frame
        _, _, found = parsed(message["bytes"])
        assert len(found[0][1]) > 100


def test_fuzzed_requests_and_frames(running, rng) -> None:
    before = {path.name for path in running.folder.parent.iterdir()}
    pieces = [
        b"{",
        b"}",
        b'"name"',
        b":",
        b"[",
        b"1e999",
        b"null",
        b"\xff\xfe",
        b"../",
        b'"setup"',
        b",",
        b"\0",
        b"[" * 300,
        b'"AF"',
        b"-1",
        b"NaN",
    ]

    def rubbish():
        return b"".join(pieces[k] for k in rng.integers(0, len(pieces), rng.integers(1, 12)))

    actions = [
        "record",
        "mark",
        "control",
        "job",
        "setup",
        "check",
        "rig",
        "trigger",
        "restart" * 9,
        "%00",
        "zero" + "/" * 5,
    ]
    for _ in range(150):
        action = actions[rng.integers(0, len(actions))]
        answer = running.client.post(f"/api/{action}", content=rubbish())
        assert answer.status_code in (400, 404, 405, 409, 413, 422), (action, answer.text)
    assert running.client.post("/api/mark", content=b"x" * 1_100_000).status_code == 413
    with running.client.websocket_connect(LIVE) as socket:
        for _ in range(100):
            data = rubbish()
            socket.send_bytes(data) if rng.random() < 0.5 else socket.send_text(data.decode("latin-1"))
        for odd in (
            {"shown": 10**9},
            {"shown": -1},
            {"level": 99},
            {"level": True},
            {"component": "x" * 3000},
            {"ping": "a"},
            [],
        ):
            socket.send_json(odd)
        socket.send_json({"ping": 7})
        while True:
            message = socket.receive()
            if (
                message.get("text")
                and json.loads(message["text"])["type"] == "pong"
                and json.loads(message["text"])["ping"] == 7
            ):
                break
    assert running.client.get("/api/state").json()["source"]["state"] == "running"
    assert {path.name for path in running.folder.parent.iterdir()} == before


def test_what_is_killed_is_told(running) -> None:
    session = running.page.session
    learner = running.wait(lambda state: state["processes"].get("learner"))["processes"]["learner"]
    session.source.engine.learner.kill()
    running.wait(lambda state: state["processes"].get("learner", learner) != learner)
    running.wait(lambda state: any("process that learns" in item["text"] for item in state["messages"]))
    session.source.engine.process.kill()
    running.wait(lambda state: any("started again" in item["text"] for item in state["messages"]))
    running.wait(lambda state: state["source"]["state"] == "running")
    # the charts go on in a new process
    begun = running.page.display.data_version
    running.wait(lambda _: running.page.display.data_version > begun + 5)
    assert running.post("record", name="killed").status_code == 200
    running.wait(lambda state: state["record"].get("blocks", 0) >= 2)
    session.records.recorder.process.kill()
    state = running.wait(lambda state: state["record"]["state"] == "ended")
    assert "without a word" in state["record"]["reason"]
    assert any(item["kind"] == "error" and "killed" in item["text"] for item in state["messages"])
    assert contents(running.folder / "killed.h5").blocks.size >= 2
    assert "recorder" not in running.client.get("/api/state").json()["processes"]
    session.source.session.process.kill()
    state = running.wait(lambda state: state["source"]["state"] == "ended")
    assert "without a word" in state["source"]["text"]
    assert running.post("control", name="cut").status_code == 409
    assert running.post("restart").status_code == 200
    running.wait(lambda state: state["source"]["state"] == "running")
    assert running.post("control", name="hang").status_code == 200  # refused by the rig: the cable hangs
    running.wait(lambda state: any("hangs already" in item["text"] for item in state["messages"]))
    assert threading.active_count() < 40
