"""Files of which no more is read than is worked on: the same numbers as from the whole file, written as they come."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

from aerobalance.app.cli import main
from aerobalance.app.commands.recordings import info
from aerobalance.dynamics.independent import dynamics_of
from aerobalance.estimation.force import ForceWork, estimate_force
from aerobalance.estimation.force_parts import DIVISION, Division
from aerobalance.io import load_channel_map, read, write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.io.format_library import library_faults
from aerobalance.io.hdf5_layout import BlockWriter, Provenance, StoredChannel
from aerobalance.io.hdf5_parts import opened_record
from aerobalance.io.long_record import SHORT, open_record
from aerobalance.io.results_file import writing
from aerobalance.recording.channel import Channel
from aerobalance.recording.errors import DataQualityWarning, FitError, ReadError
from aerobalance.recording.recording import Recording
from aerobalance.recording.side_by_side import side_by_side
from helpers.cable_cut import T128

RATE = 1600.0
"""Sampling rate, too slow for the forces to be worked out on a slower clock [Hz]."""
SAMPLES, PART = 72_000, 32_768
OF_FORCE, PART_OF_FORCE = 36_000, 16_384
"""Of what forces are worked out from: three parts of a whole number of blocks."""
"""Samples of a record, and of its parts in most of these tests."""


BEGAN = np.datetime64("2024-03-12T10:15:00.125", "ns")
"""Date and time of time zero of one record."""


def load(seed: int, count: int = SAMPLES) -> np.ndarray:
    """Balance load of a soft force with a step after two seconds, and its noise."""
    generator = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    force = np.fft.irfft(np.fft.rfft(generator.normal(size=count)) / np.sqrt(1 + (frequency / 20) ** 4))
    values = np.fft.irfft(np.fft.rfft(20 * force / force.std()) * T128.response(frequency)) + 50.0
    values += 30.0 * T128.step_response(np.arange(count) / RATE - 2.0, duration=0.0)
    return values + 2.0 * generator.normal(size=count)


def ticking(path: Path, values: np.ndarray, *, rows: int, lost: tuple[int, int] = (0, 0)) -> Path:
    """A recording as the recorder writes it, in blocks of so many rows; samples from one to another are lost."""
    channels = (StoredChannel("AF", "N", zero_uncertainty=0.3), StoredChannel("pitch", "deg"))
    writer = BlockWriter(path, channels, rate=RATE, rows=rows, provenance=Provenance("test"))
    for begin, end in ((0, lost[0]), (lost[1], values.size)) if lost[1] else ((0, values.size),):
        for first in range(begin, end, rows):
            part = values[first : min(first + rows, end)]
            writer.append(first + 1000, np.column_stack([part, np.zeros(part.size)]))
    writer.finish("done")
    return path


def recording_of(values: np.ndarray) -> Recording:
    return Recording.from_columns(np.arange(values.size) / RATE, {"AF": Channel("AF", values, "N")})


def quiet(work):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return work()


def same(one: Recording, other: Recording) -> None:
    assert one.channels.keys() == other.channels.keys()
    for name, channel in one.channels.items():
        np.testing.assert_array_equal(channel.values, other.channel(name).values)
        assert channel.known() == other.channel(name).known()
        assert channel.file_unit == other.channel(name).file_unit
    np.testing.assert_array_equal(one.rows, other.rows)
    np.testing.assert_allclose(one.stamps, other.stamps, rtol=1e-15)
    assert one.start == pytest.approx(other.start, rel=1e-15)
    assert one.extent.begin == pytest.approx(other.extent.begin)


@pytest.mark.parametrize("rows", [1000, 8192])
@pytest.mark.parametrize("lost", [(0, 0), (50_000, 50_500)])
def test_parts_of_a_file_are_parts_of_what_is_read_whole(tmp_path, seed, rows, lost):
    path = ticking(tmp_path / "run.h5", load(seed), rows=rows, lost=lost)
    whole = quiet(lambda: read(path))
    with open_record(path) as record:
        assert not isinstance(record, Recording)
        assert (record.samples, record.rate) == (whole.samples, whole.rate)
        for begin, end in ((0, 1500), (49_000, 51_000), (50_100, 51_000), (whole.samples - 7, whole.samples)):
            same(quiet(lambda b=begin, e=end: record.part(b, e)), whole.part(begin, end))


def test_a_file_with_a_steady_time_column_is_read_in_parts(tmp_path, seed):
    values = load(seed)
    made = Recording.from_columns(3.0 + np.arange(values.size) / RATE, {"AF": Channel("AF", values, "N")})
    write_recording(tmp_path / "run.h5", replace(made, time_unit="ms"))
    whole = read(tmp_path / "run.h5")
    with open_record(tmp_path / "run.h5") as record:
        assert not isinstance(record, Recording)
        assert record.rate == pytest.approx(whole.rate, rel=1e-13)
        same(record.part(65_000, 70_000), whole.part(65_000, 70_000))


@pytest.mark.parametrize("fault", ["gap", "jitter"])
def test_a_file_with_another_time_column_is_read_whole(tmp_path, seed, fault):
    values = load(seed)
    stamps = np.arange(values.size) / RATE
    stamps[50_000:] += {"gap": 10 / RATE, "jitter": 0.0}[fault]
    stamps[5] += {"gap": 0.0, "jitter": 0.3 / RATE}[fault]
    made = quiet(lambda: Recording.from_columns(stamps, {"AF": Channel("AF", values, "N")}))
    write_recording(tmp_path / "run.h5", made)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        with open_record(tmp_path / "run.h5") as record:
            assert isinstance(record, Recording)
            same(record, read(tmp_path / "run.h5"))


@pytest.fixture
def short_texts_are_long(monkeypatch):
    monkeypatch.setattr("aerobalance.io.text_parts.LONG", 1000)
    monkeypatch.setattr("aerobalance.io.text_parts.AT_ONCE", 50_000)


def long_rows(seed: int, *, separator: str = ",", count: int = 70_000) -> list[str]:
    """Rows of a text: the sample, the time in ms, two channels."""
    values = np.random.default_rng(seed).normal(size=(count, 2))
    return [separator.join([str(i), f"{i / 2:g}", f"{x:.5f}", f"{y:.3e}"]) for i, (x, y) in enumerate(values.tolist())]


def in_tdms(path: Path, table: np.ndarray, rate: float) -> None:
    with TdmsWriter(path) as file:
        for rows in np.array_split(table, 30):
            file.write_segment(
                [
                    ChannelObject("run", name, values, {"unit_string": "N", "wf_increment": 1 / rate})
                    for name, values in zip(("AF", "NF", "SF"), rows.T, strict=True)
                ]
            )


def in_text(path: Path, table: np.ndarray, rate: float) -> None:
    stamps = np.arange(len(table)) / rate
    np.savetxt(
        path, np.column_stack([stamps, table]), "%.9g", ",", header="time [s],AF [N],NF [N],SF [N]", comments=""
    )


def in_own_hdf5(path: Path, table: np.ndarray, rate: float) -> None:
    channels = {name: Channel(name, values, "N") for name, values in zip(("AF", "NF", "SF"), table.T, strict=True)}
    write_recording(path, Recording.from_columns(np.arange(len(table)) / rate, channels))


@pytest.mark.parametrize("ending, write", [("tdms", in_tdms), ("csv", in_text), ("h5", in_own_hdf5)])
def test_parts_that_two_threads_read_are_those_that_one_reads(tmp_path, seed, short_texts_are_long, ending, write):
    path, ends = tmp_path / f"run.{ending}", list(pairwise(range(0, 300_001, 1000)))
    write(path, np.random.default_rng(seed).normal(size=(300_000, 3)), 25_000.0)
    before = sys.getswitchinterval()
    with open_record(path) as record:
        assert not isinstance(record, Recording)
        alone = [record.part(*one) for one in ends]
    with open_record(path) as record:
        sys.setswitchinterval(1e-6)  # as on a machine on which all happens in the end
        try:
            found = side_by_side(lambda one: record.part(*one), 4 * ends)
        finally:
            sys.setswitchinterval(before)
        for one, other in zip(found, 4 * alone, strict=True):
            same(one, other)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_long_text_is_read_in_parts(tmp_path, seed, short_texts_are_long, end):
    rows = long_rows(seed)
    rows[60_000] = "60000,30000,,2.5"
    (tmp_path / "run.csv").write_text(
        end.join(["time [ms],AF [N],NF [N]", *(row.split(",", 1)[1] for row in rows)]), newline=""
    )
    whole = quiet(lambda: read(tmp_path / "run.csv"))
    with open_record(tmp_path / "run.csv") as record:
        assert not isinstance(record, Recording)
        assert (record.samples, record.rate) == (whole.samples, pytest.approx(whole.rate, rel=1e-13))
        assert record.part(0, 10).time_unit == "ms"
        for begin, end_of in ((0, 1500), (59_000, 61_000), (69_990, 70_000)):
            same(quiet(lambda b=begin, e=end_of: record.part(b, e)), whole.part(begin, end_of))


def test_a_long_text_with_a_channel_map_is_read_in_parts(tmp_path, seed, short_texts_are_long):
    head = "Satz;Zeit [ms];Kraft ö [lbf];Auftrieb"
    rows = [row.replace(".", ",") for row in long_rows(seed, separator=";")]
    (tmp_path / "run.csv").write_text("\n".join(["\ufeffMessung 7", "", head, *rows, ";;;"]), encoding="utf-8")
    channels = '[channels.AF]\ncolumn = "Kraft ö"\nsign = -1\n[channels.NF]\ncolumn = 4\nunit = "N"\n'
    for number, file in enumerate(("", "[file]\nrate = 2010\n")):
        (tmp_path / f"{number}.toml").write_text(file + channels, encoding="utf-8")
        chosen = load_channel_map(tmp_path / f"{number}.toml")
        whole = read(tmp_path / "run.csv", channel_map=chosen)
        with open_record(tmp_path / "run.csv", channel_map=chosen) as record:
            assert not isinstance(record, Recording)
            assert whole.rate == pytest.approx((2000, 2010)[number])
            same(record.part(65_000, 70_000), whole.part(65_000, 70_000))


@pytest.mark.parametrize("fault", ["dates", "gap", "carriage returns", "other letters"])
def test_a_text_out_of_the_common_is_read_whole(tmp_path, seed, short_texts_are_long, fault):
    rows = [row.split(",", 1)[1] for row in long_rows(seed)]
    head, end, encoding = "time [ms],AF [N],NF [N]", "\n", "utf-8"
    if fault == "dates":
        head, rows = "date," + head, [f"2024-03-12 10:15:{i / 2000 % 60:09.6f},{row}" for i, row in enumerate(rows)]
    elif fault == "gap":
        del rows[65_000:65_010]
    elif fault == "carriage returns":
        end = "\r"
    else:
        head, encoding = head + ",ö [N]", "cp1252"
        rows = [row + ",1" for row in rows]
    (tmp_path / "run.csv").write_text(end.join([head, *rows]), encoding=encoding, newline="")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        with open_record(tmp_path / "run.csv") as record:
            assert isinstance(record, Recording)
            same(record, read(tmp_path / "run.csv"))


@pytest.mark.parametrize("cell", ["1.5.2", "1.5,7"])
def test_a_fault_far_down_in_a_long_text_is_named_by_its_line(tmp_path, seed, short_texts_are_long, cell):
    rows = [row.split(",", 1)[1] for row in long_rows(seed)]
    rows[66_666] = rows[66_666].rsplit(",", 1)[0] + "," + cell
    (tmp_path / "run.csv").write_text("\n".join(["time [ms],AF [N],NF [N]", *rows]))
    with pytest.raises(ReadError, match="line 66668"), open_record(tmp_path / "run.csv"):
        pass


def test_short_and_foreign_files_are_read_whole(tmp_path, seed):
    values = load(seed)[:SHORT]
    with open_record(ticking(tmp_path / "run.h5", values, rows=4096)) as record:
        assert isinstance(record, Recording)
    (tmp_path / "run.csv").write_text("time [s],AF [N]\n0,1\n1,2\n2,3\n")
    with open_record(tmp_path / "run.csv") as record:
        assert isinstance(record, Recording)


def test_a_damaged_block_is_missing_in_its_part_only(tmp_path, seed):
    path = ticking(tmp_path / "run.h5", load(seed), rows=1000)
    with h5py.File(path, "r+") as file:
        file["samples"][55_500, 0] += 1.0
    with open_record(path) as record:
        assert np.isfinite(record.part(40_000, 55_000).channel("AF").values).all()
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            part = record.part(54_000, 57_000)
    assert "block 56 of 72 (1000 samples) does not agree with its checksum" in str(said[0].message)
    assert "1000 sample(s) are missing in 1 gap" in str(said[1].message)
    assert np.array_equal(np.flatnonzero(~np.isfinite(part.channel("AF").values)), np.arange(1000, 2000))


def test_filters_of_warnings_are_those_of_before_whichever_thread_is_done_first():
    """A library is quiet in the thread that works with it; what others say meanwhile and afterwards is heard."""
    inside, second_inside, first_done = threading.Event(), threading.Event(), threading.Event()

    def first() -> None:
        with library_faults(Path("one.tdms"), "TDMS"):
            inside.set()
            assert second_inside.wait(10)

    def second() -> None:
        assert inside.wait(10)
        with library_faults(Path("other.tdms"), "TDMS"):
            second_inside.set()
            assert first_done.wait(10)
            warnings.warn("of the library", UserWarning, stacklevel=1)

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with ThreadPoolExecutor(2) as pool:
            other = pool.submit(second)
            pool.submit(first).result()
            warnings.warn("meanwhile", UserWarning, stacklevel=1)
            first_done.set()
            other.result()
        warnings.warn("afterwards", UserWarning, stacklevel=1)
        count = len(warnings.filters)
        for _ in range(3):  # no more of them however often others come before
            warnings.simplefilter("always")
            with library_faults(Path("one.tdms"), "TDMS"):
                pass
        assert len(warnings.filters) == count
    assert [str(one.message) for one in caught] == ["meanwhile", "afterwards"]


def test_what_goes_wrong_with_a_part_is_no_fault_of_the_file(tmp_path, seed):
    path = ticking(tmp_path / "run.h5", load(seed), rows=8192)
    with pytest.raises(FitError, match="of my own"), open_record(path):
        raise FitError("of my own")
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(ReadError), open_record(path):
        pass


@pytest.mark.parametrize("ending", ["h5", "mat", "nc", "uff"])
def test_missing_readings_of_a_part_are_told_in_every_format(tmp_path, seed, monkeypatch, ending):
    """Nothing that is said while a file is open is taken for what its library says."""
    monkeypatch.setattr("aerobalance.io.long_record.SHORT", 100)
    values, path = load(seed, 2000), tmp_path / f"run.{ending}"
    values[300:310] = np.nan
    quiet(lambda: write_recording(path, recording_of(values)))
    with (
        pytest.warns(DataQualityWarning, match="10 of 1000 samples of AF are missing"),
        open_record(path) as record,
    ):
        assert not isinstance(record, Recording)
        record.part(0, 1000)
    with pytest.raises(FitError, match="of my own"), open_record(path):
        raise FitError("of my own")


def test_temperature_is_less_its_mean_over_the_whole_record(tmp_path):
    values = np.linspace(20.0, 30.0, 100_000)
    channel = Channel("temperature", values, "degC")
    made = Recording.from_columns(np.arange(values.size) / RATE, {"temperature": channel})
    write_recording(tmp_path / "run.h5", made)
    with opened_record(tmp_path / "run.h5") as record:
        found = record.part(10, 20).extent.means["temperature"]
    assert found == pytest.approx(25.0, rel=1e-12)
    assert made.part(10, 20).extent.means["temperature"] == pytest.approx(25.0, rel=1e-12)


@pytest.mark.parametrize("lost", [(50_000, 50_500), (59_800, 60_100), (60_000, 60_300)])
def test_info_of_a_long_record_is_that_of_its_parts(tmp_path, seed, monkeypatch, lost):
    path = ticking(tmp_path / "run.h5", load(seed), rows=8192, lost=lost)
    whole = quiet(lambda: info(path))
    monkeypatch.setattr("aerobalance.app.commands.recordings.LOOKED_AT_ONCE", 30_000)
    parts = quiet(lambda: info(path))
    one, other = whole["channels"].pop("AF"), parts["channels"].pop("AF")
    assert [gap["length"] for gap in parts["gaps"]] == [pytest.approx((lost[1] - lost[0]) / RATE)]
    for key in ("file", "duration", "rate", "samples", "start", "epoch", "channels"):
        assert parts[key] == whole[key]
    assert [gap["start"] for gap in parts["gaps"]] == pytest.approx([gap["start"] for gap in whole["gaps"]])
    assert (other["least"], other["largest"], other["missing"]) == (one["least"], one["largest"], one["missing"])
    assert other["mean"] == pytest.approx(one["mean"], rel=1e-12)
    assert other["noise"] == pytest.approx(one["noise"], rel=0.05)  # some 30 000 readings tell a noise to 1 %


# --- forces


@pytest.fixture
def in_parts(monkeypatch):
    """Let parts be short, so that a short record has several."""
    monkeypatch.setattr("aerobalance.estimation.force.DIVISION", Division(readings=PART_OF_FORCE))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("long")
    values = load(7, OF_FORCE)
    ticking(path / "run.h5", values, rows=8192)
    with h5py.File(path / "run.h5", "r+") as file:
        file["status"].attrs["epoch"] = str(BEGAN)
    ticking(path / "other_blocks.h5", values, rows=3000)
    write_dynamics(path / "dynamics.json", {"AF": T128}, found={}, inputs=[], warnings=[])
    return path


@pytest.fixture(scope="module")
def in_memory(folder):
    """Force of the record that is read whole, worked out in parts."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("aerobalance.estimation.force.DIVISION", Division(readings=PART_OF_FORCE))
        whole = read(folder / "run.h5")
        return quiet(lambda: estimate_force(whole, T128).only)


def test_forces_do_not_depend_on_how_the_file_is_read(folder, in_parts, in_memory):
    with open_record(folder / "other_blocks.h5") as record:  # the other file is that of the command
        found = quiet(lambda: ForceWork(record, dynamics_of(T128)).force().only)
    assert found.method == in_memory.method
    assert found.method.startswith("in 3 parts")
    np.testing.assert_array_equal(found.values, in_memory.values)
    np.testing.assert_array_equal(found.uncertainty, in_memory.uncertainty)


@pytest.mark.parametrize("ending", ["h5", "csv"])
@pytest.mark.usefixtures("in_parts")
def test_the_command_writes_what_the_call_gives(folder, in_memory, tmp_path, capsys, ending):
    out, page = tmp_path / f"force.{ending}", tmp_path / "force.html"
    words = ["force", str(folder / "run.h5"), "--dynamics", str(folder / "dynamics.json"), "-o", str(out), "--json"]
    assert main([*words, *(["--report", str(page)] if ending == "h5" else [])]) == 0
    captured = capsys.readouterr()
    account = json.loads(captured.out)["components"]["AF"]
    force = in_memory
    written = read(out)
    tolerance = 0.0 if ending == "h5" else 1e-3 * force.uncertainty.min()
    np.testing.assert_allclose(written.channel("AF").values, force.values, rtol=0, atol=tolerance)
    np.testing.assert_allclose(written.channel("u_AF").values, force.uncertainty, rtol=0, atol=tolerance)
    assert written.epoch == (BEGAN if ending == "h5" else None)
    assert account["mean"] == pytest.approx(force.values.mean(), rel=1e-9)
    assert account["largest"] == force.values.max()
    assert account["instant_of_largest"] == pytest.approx(1000 / RATE + np.argmax(force.values) / RATE)
    assert account["uncertainty_rms"] == pytest.approx(np.sqrt(np.mean(force.uncertainty**2)), rel=1e-9)
    assert [step["instant"] for step in account["steps"]] == pytest.approx([1000 / RATE + 2.0], abs=1e-3)
    assert account["method"].startswith("in 3 parts, of which the first is by the smoother")
    if ending == "h5":
        assert page.read_text().count("<svg") == 3


def test_monte_carlo_of_a_long_record_is_of_one_part(folder, in_parts, tmp_path, capsys):
    words = [
        "force",
        str(folder / "run.h5"),
        "--dynamics",
        str(folder / "dynamics.json"),
        "-o",
        str(tmp_path / "f.h5"),
    ]
    assert main([*words, "--monte-carlo", "10", "--json"]) == 0
    captured = capsys.readouterr()
    assert "Monte Carlo is of the part with the largest uncertainty, part" in captured.err
    assert json.loads(captured.out)["components"]["AF"]["monte_carlo"]["draws"] == 10


def test_a_part_is_large_enough_for_one_component():
    record = Recording.from_columns(np.arange(360_000) / RATE, {"AF": Channel("AF", np.zeros(360_000), "N")})
    parts = DIVISION.parts(record, dynamics_of(T128))
    assert DIVISION.length(dynamics_of(T128)) == 344_064
    assert len(parts) == 2
    assert parts[0].end == 184_320  # (360 000 + 2 * 4096) / 2, and the next number without large factors


@pytest.mark.parametrize(
    ("ending", "why"),
    [("h5", "only where its time is that of a steady clock"), ("csv", "`aerobalance convert` it to")],
)
def test_a_large_file_that_is_read_whole_says_what_can_be_done(tmp_path, monkeypatch, ending, why):
    file = tmp_path / f"run.{ending}"
    with writing(file, samples=100) as append:
        append({"time [s]": np.arange(100) / RATE, "AF [N]": np.arange(100.0)})
    monkeypatch.setattr("aerobalance.io.long_record.LARGE", 0)
    with pytest.warns(DataQualityWarning, match=why), open_record(file) as record:
        assert record.samples == 100


# --- writing, progress, Ctrl-C


@pytest.mark.parametrize("ending", ["h5", "csv", "txt"])
def test_rows_written_bit_by_bit_make_the_same_file(tmp_path, ending, rng):
    columns = {"time [s]": np.arange(20_000) / RATE, "AF [N]": rng.normal(size=20_000)}
    columns["AF [N]"][[5, 9000]] = np.nan
    files = []
    for name, edges in (("one", [0, 20_000]), ("many", [0, 3, 8192, 8200, 19_999, 20_000])):
        file = tmp_path / f"{name}.{ending}"
        with writing(file, samples=20_000) as append:
            for begin, end in pairwise(edges):
                append({label: values[begin:end] for label, values in columns.items()})
        files.append(file)
    if ending == "h5":
        same(*(quiet(lambda file=file: read(file)) for file in files))
    else:
        assert files[0].read_bytes() == files[1].read_bytes()


def test_nothing_is_left_of_a_file_whose_writing_fails(tmp_path):
    for ending in ("h5", "csv"):
        with pytest.raises(FitError), writing(tmp_path / f"out.{ending}", samples=10) as append:
            append({"time [s]": np.arange(5.0), "AF [N]": np.ones(5)})
            raise FitError("broken off")
    assert list(tmp_path.iterdir()) == []


IN_SHORT_PARTS = f"""
from aerobalance.estimation import force, force_parts
force.DIVISION = force_parts.Division(readings={PART_OF_FORCE})
from aerobalance.app.cli import run
run()
"""


@pytest.mark.skipif(os.name == "nt", reason="signals are those of POSIX")
def test_ctrl_c_between_two_parts_leaves_no_half_file(folder, tmp_path):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    words = [
        "force",
        str(folder / "run.h5"),
        "--dynamics",
        str(folder / "dynamics.json"),
        "-o",
        str(tmp_path / "f.h5"),
    ]
    try:
        command = [sys.executable, "-c", IN_SHORT_PARTS, *words]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        with subprocess.Popen(command, cwd=folder, **pipes) as running:
            until = time.monotonic() + 60
            while not list(tmp_path.glob(".*.part")):  # it begins with the first rows that are certain
                assert time.monotonic() < until
                assert running.poll() is None
                time.sleep(0.01)
            running.send_signal(signal.SIGINT)
            _, said = running.communicate(timeout=60)
    finally:
        signal.signal(signal.SIGINT, before)
    assert running.returncode == 130
    assert said.strip().endswith("interrupted; nothing was written")
    assert list(tmp_path.iterdir()) == []
