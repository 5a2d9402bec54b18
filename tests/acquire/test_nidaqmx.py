"""NI-DAQmx: the real client against a server without a device, over the loopback."""

import time
from threading import Timer

import numpy as np
import pytest

pytest.importorskip("nidaqmx", reason="the extra nidaqmx is not installed")
pytest.importorskip("grpc", reason="the extra nidaqmx is not installed")

from nidaqmx.constants import AccelUnits, BridgeConfiguration, BridgeUnits, ExcitationSource

from aerobalance.acquisition import nidaqmx
from aerobalance.acquisition.continuity import Continuity
from aerobalance.acquisition.nidaqmx import NidaqmxSource, skews
from aerobalance.acquisition.session import Session
from aerobalance.acquisition.setup import parse_setup
from aerobalance.acquisition.source import SourceEndedError
from aerobalance.acquisition.source_settings import NiInput
from aerobalance.io.hdf5_file import read_blocks
from aerobalance.recording.errors import FitError
from helpers.at_work import end_by_sigterm, follow, lost_by_a_kill
from helpers.ni_server import FakeServer

BRIDGE = {"measures": "bridge", "low": -2.0, "high": 2.0, "excitation": 10.0, "bridge": "half", "resistance": 1000.0}
ACCELERATION = {"measures": "acceleration", "low": -50.0, "high": 50.0, "sensitivity": 100.0, "current": 0.002}
VOLTAGE = {"measures": "voltage", "low": -10.0, "high": 10.0}


def inputs_of(*wired):
    return {f"c{i}": NiInput(physical=f"PXI1Slot2/ai{i}", **given) for i, given in enumerate(wired)}


def source_of(server, *wired, **settings):
    return NidaqmxSource(
        inputs_of(*(wired or (VOLTAGE, VOLTAGE))),
        **{"rate": 25_000.0, "server": f"127.0.0.1:{server.port}"} | settings,
    )


def watched(source, seconds, limit=120.0):
    """Read on until the record is so long, gaps included; return blocks in their places, and gaps."""
    continuity, blocks, gaps = Continuity(source.rate), [], []
    stop = time.monotonic() + limit
    while not blocks or blocks[-1].end < seconds * source.rate:
        assert time.monotonic() < stop
        block = source.read(0.1)
        if block is not None:
            found = continuity.follow(block)
            blocks += [found.block] if found.block is not None else []
            gaps += [found.gap] if found.gap is not None else []
    return blocks, gaps


def setup_of(server, count):
    inputs = "".join(
        f'[source.inputs.c{i}]\nphysical = "Dev1/ai{i}"\nmeasures = "voltage"\nlow = -10.0\nhigh = 10.0\n'
        for i in range(count)
    )
    return (
        f'[source]\nkind = "nidaqmx"\nrate = 25000.0\nserver = "127.0.0.1:{server.port}"\n{inputs}'
        "[record]\nkeep_free = 0.0\nblock = 0.05\n"
    )


def test_inputs_are_wired_as_the_set_up_says() -> None:
    with FakeServer() as server:
        source = source_of(server, BRIDGE, ACCELERATION, VOLTAGE)
        (task,) = server.tasks.values()
        bridge, acceleration, voltage = task.channels.values()
        source.stop()
        assert not server.tasks
    assert [(item.name, item.unit) for item in source.channels] == [("c0", "mV/V"), ("c1", "m/s^2"), ("c2", "V")]
    assert (bridge.physical_channel, bridge.min_val, bridge.max_val) == ("PXI1Slot2/ai0", -2.0, 2.0)
    assert bridge.units_raw == BridgeUnits.MILLIVOLTS_PER_VOLT.value
    assert bridge.bridge_config_raw == BridgeConfiguration.HALF_BRIDGE.value
    assert (bridge.voltage_excit_val, bridge.nominal_bridge_resistance) == (10.0, 1000.0)
    assert bridge.voltage_excit_source_raw == ExcitationSource.INTERNAL.value
    assert acceleration.units_raw == AccelUnits.METERS_PER_SECOND_SQUARED.value
    assert (acceleration.sensitivity, acceleration.current_excit_val) == (100.0, 0.002)
    assert voltage.max_val == 10.0
    with pytest.raises(SourceEndedError):
        source.read(0.1)


def test_channels_of_one_converter_are_taken_one_after_the_other() -> None:
    assert skews(["A/ai0", "A/ai1", "B/ai0", "A/ai2"], 1.3e-6) == (0.0, -1.3e-6, 0.0, -2.6e-6)
    with FakeServer() as server:
        source = source_of(server, VOLTAGE, VOLTAGE, skew=1.3e-6)
        source.stop()
    assert [channel.delay for channel in source.channels] == [0.0, -1.3e-6]


def test_rate_is_the_one_that_the_device_has() -> None:
    with FakeServer() as server:
        server.largest = 20_000.0
        source = source_of(server)
        source.stop()
    assert source.rate == 20_000.0
    assert "20000 Hz (25000 Hz asked for)" in source.description


def test_what_the_driver_refuses_is_said_in_its_words() -> None:
    with FakeServer() as server, pytest.raises(FitError, match="Physical channel specified does not exist"):
        NidaqmxSource({"c": NiInput(physical="Dev1/ai99", **VOLTAGE)}, rate=1000.0, server=f"127.0.0.1:{server.port}")
    with pytest.raises(FitError, match=r"NI-DAQmx at 127\.0\.0\.1:1: .*Failed to connect"):
        NidaqmxSource(inputs_of(VOLTAGE), rate=1000.0, server="127.0.0.1:1")
    with pytest.raises(FitError, match="NI-DAQmx at this computer"):
        NidaqmxSource({"c": NiInput(physical="NoSuchDevice/ai0", **VOLTAGE)}, rate=1000.0)


def test_overrun_leaves_a_gap_of_its_exact_length() -> None:
    with FakeServer() as server:
        server.shortest = 10_000
        source = source_of(server)
        source.start()
        before, _ = watched(source, 0.2)
        server.held.set()
        late = Timer(1.0, server.held.clear)
        late.start()
        continuity = Continuity(source.rate)
        continuity.expected = before[-1].end
        blocks, gaps = [], []
        while len(blocks) < 20:
            block = source.read(0.1)
            if block is not None:
                found = continuity.follow(block)
                blocks.append(found.block)
                gaps += [found.gap] if found.gap is not None else []
        source.stop()
    assert {gap.kind for gap in gaps} == {"remark"}
    assert all("overrun" in gap.text for gap in gaps)
    # every sample counts itself, so that a gap of another length would put it in a wrong place
    assert all(np.array_equal(block.samples[:, 0], np.arange(block.tick, block.end)) for block in (*before, *blocks))
    # held for 1 s with a buffer of 0.4 s, and read on from the newest samples, a block of 20 ms
    assert 0.9 < gaps[0].samples / source.rate < 10


def test_one_input_alone_is_read() -> None:
    with FakeServer() as server:
        source = source_of(server, VOLTAGE)
        source.start()
        blocks, gaps = watched(source, 0.05)
        source.stop()
    assert gaps == []
    assert np.array_equal(np.concatenate([block.samples for block in blocks])[:1000, 0], np.arange(1000))


def test_samples_of_a_reading_that_was_cut_short_are_a_gap() -> None:
    with FakeServer() as server:
        source = source_of(server)
        source.start()
        before, _ = watched(source, 0.1)
        server.silent, server.cut = True, 123
        assert source.read(0.1) is None
        server.silent = False
        block = source.read(0.1)
        source.stop()
    assert block.tick == before[-1].end + 123
    assert block.samples[0, 0] == block.tick
    assert "cut short" in block.remark


def test_device_that_is_gone_for_a_while_is_recorded_on() -> None:
    with FakeServer() as server:
        source = source_of(server)
        source.start()
        before, _ = watched(source, 0.2)
        server.broken, server.absent = -201003, True
        gone = time.monotonic()
        assert source.read(0.1) is None
        assert source.read(0.1) is None
        server.broken, server.absent = 0, False
        continuity = Continuity(source.rate)
        continuity.follow(before[-1])
        block = None
        while block is None:
            assert time.monotonic() < gone + 20
            block = source.read(0.1)
        away = block.received - before[-1].received
        found = continuity.follow(block)
        after = source.read(0.2)
        source.stop()
    # the new task counts from zero; only the computer's clock knows how long it was away
    assert block.anew
    assert block.samples[0, 0] == 0.0
    assert found.gap.kind == "restart"
    assert "Device cannot be accessed" in found.gap.text or "The device is gone" in found.gap.text
    assert "computer's clock" in found.gap.text
    assert found.gap.samples == round(away * source.rate) - len(block.samples)
    assert after.tick == block.end
    assert not after.anew


def test_server_that_is_started_again_is_found_again() -> None:
    server = FakeServer()
    source = source_of(server)
    source.start()
    watched(source, 0.1)
    server.close()
    limit = time.monotonic() + 60
    assert source.read(0.1) is None
    with FakeServer(server.port):
        block = None
        while block is None:
            assert time.monotonic() < limit
            block = source.read(0.1)
        source.stop()
    assert block.anew
    assert "the task was made anew" in block.remark


def test_task_that_falls_silent_is_made_anew(monkeypatch) -> None:
    monkeypatch.setattr(nidaqmx, "QUIET", 0.3)
    with FakeServer() as server:
        source = source_of(server)
        source.start()
        watched(source, 0.1)
        server.silent = True
        begin = time.monotonic()
        while server.made == 1:
            assert source.read(0.1) is None
            assert time.monotonic() < begin + 20
        server.silent = False
        block = None
        while block is None:
            assert time.monotonic() < begin + 20
            block = source.read(0.1)
        source.stop()
    assert "no samples for 0.3 s" in block.remark


def test_twelve_channels_at_25_khz_arrive_without_loss(tmp_path) -> None:
    with FakeServer() as server, Session(parse_setup(setup_of(server, 12)), tmp_path) as session:
        recorder = session.record(tmp_path / "run.h5")
        recorder.ready()
        session.start()
        follow(recorder, lambda progress: progress.seconds > 2.0)
        progress = recorder.stop("enough")
    assert (progress.gaps, progress.reason) == (0, "enough")
    found = np.concatenate([samples for _, samples in read_blocks(tmp_path / "run.h5")])
    assert np.array_equal(found, np.arange(len(found))[:, np.newaxis] + 1e9 * np.arange(12))


@pytest.mark.parametrize("victim", ["recorder", "source"])
def test_kill_loses_nothing_acknowledged(victim, tmp_path) -> None:
    with FakeServer() as server, Session(parse_setup(setup_of(server, 2)), tmp_path) as session:
        recorder = session.record(tmp_path / "run.h5")
        recorder.ready()
        session.start()
        follow(recorder, lambda progress: progress.blocks > 5)
        progress = lost_by_a_kill(session, recorder, victim)
    stored = np.concatenate([samples for _, samples in read_blocks(tmp_path / "run.h5")])
    assert len(stored) >= progress.samples
    assert np.array_equal(stored[:, 0], np.arange(len(stored)) + stored[0, 0])


def test_sigterm_ends_the_record_and_frees_the_device(tmp_path) -> None:
    with FakeServer() as server:
        end_by_sigterm(tmp_path, setup_of(server, 2))
        assert not server.tasks
