"""Every kind of file that cannot be used: the right error, with the file, the place and what is allowed."""

import os
import warnings

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

from aerobalance.acquisition.replay import ReplaySource
from aerobalance.acquisition.setup import load_setup
from aerobalance.app.campaign.run_table import read_rows
from aerobalance.io import load_channel_map, read, read_table
from aerobalance.io.anything import read as read_anything
from aerobalance.io.artefacts import digest
from aerobalance.io.balance_file import read_matrix
from aerobalance.io.dynamics_file import dynamics_kind, read_any_dynamics, read_dynamics
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_layout import BlockWriter, Provenance, StoredChannel
from aerobalance.io.kinds import kind_of
from aerobalance.io.mass_file import read_weighing
from aerobalance.io.modal_uff import read_modes
from aerobalance.io.schedule import read_schedule
from aerobalance.recording.errors import DataQualityWarning, ReadError

GOOD = "time [s],AF [N]\n0,1\n0.1,2\n0.2,3\n"

BAD = {
    "empty": (b"", ["is empty", "header"]),
    "blank": (b" \r\n\n\t\n", ["is empty"]),
    "bom only": (b"\xef\xbb\xbf", ["is empty"]),
    "header only": (b"time [s],AF [N]\n", ["no rows of numbers"]),
    "header only without line end": (b"time [s],AF [N]", ["no rows of numbers"]),
    "one row": (b"time [s],AF [N]\n0,1\n", ["1 row(s)", "at least two"]),
    "short row": (b"time [s],AF [N]\n0,1\n0.1\n0.2,3\n", ["line 3", "1 cell(s)", "2"]),
    "long row": (b"time [s],AF [N]\n0,1\n0.1,2,7\n0.2,3\n", ["line 3", "3 cell(s)", "2"]),
    "short and long rows that even out": (b"time [s],AF [N]\n0,1\n0.1\n0.2,3,4\n", ["line 3", "1 cell(s)"]),
    "cut off last row": (b"time [s],AF [N],pitch [deg]\n0,1,0\n0.1,2,0\n0.2,", ["line 4", "2 cell(s)"]),
    "no unit": (b"time [s],AF\n0,1\n1,2\n", ["column 2 ('AF')", "unit is missing", "AF [N]", "lbf"]),
    "empty unit": (b"time [s],AF []\n0,1\n1,2\n", ["column 2", "unit is missing"]),
    "unknown unit": (b"time [s],AF [Newtonx]\n0,1\n1,2\n", ["column 2", "unknown unit [Newtonx]", "lbf"]),
    "force in kg": (b"time [s],AF [kg]\n0,1\n1,2\n", ["column 2", "[kg]", "a force", "N, kN, lbf, kgf"]),
    "pitch in m": (b"time [s],pitch [m]\n0,1\n1,2\n", ["column 2", "[m] is a length", "deg"]),
    "pitch in percent": (b"time [s],pitch [%]\n0,1\n1,2\n", ["[%] is a ratio", "an angle"]),
    "moment in N": (b"time [s],PM [N]\n0,1\n1,2\n", ["[N] is a force", "a moment", "in-lbf"]),
    "gauge output in N": (b"time [s],rAF [N]\n0,1\n1,2\n", ["a gauge output", "uV/V", "excitation [V]"]),
    "excitation in mV/V": (b"time [s],excitation [mV/V]\n0,1\n1,2\n", ["is a gauge output, but a voltage", "uV"]),
    "temperature in V": (b"time [s],temperature [V]\n0,1\n1,2\n", ["a temperature is expected", "degF"]),
    "time in m": (b"time [m],AF [N]\n0,1\n1,2\n", ["column 1", "[m] is a length", "ms, us"]),
    "column twice": (b"time [s],AF [N],AF [kN]\n0,1,1\n1,2,2\n", ["column 3", "column AF already", "column 2"]),
    "no time": (b"AF [N],pitch [deg]\n0,1\n1,2\n", ["no column time [s]", "AF, pitch"]),
    "time only": (b"time [s]\n0\n1\n2\n", ["time column only", "AF [N]"]),
    "no name": (b"time [s],[N]\n0,1\n1,2\n", ["column 2", "no name"]),
    "column without header": (b"time [s],AF [N],\n0,1,5\n1,2,6\n", ["column 3", "no name"]),
    "no header": (b"0,1\n1,2\n2,3\n", ["first line", "holds numbers", "name [unit]"]),
    "reversed time": (b"time [s],AF [N]\n2,1\n1,2\n0,3\n", ["line 3", "time must increase", "line 2"]),
    "time standing still": (b"time [s],AF [N]\n1,1\n1,2\n1,3\n", ["line 3", "time must increase"]),
    "time going back once": (b"time [ms],AF [N]\n0,1\n1,2\n2,3\n1.5,3\n3,1\n", ["line 5", "0.0015 s", "0.002 s"]),
    "time missing": (b"time [s],AF [N]\n0,1\n,2\n2,3\n", ["line 3", "time is missing"]),
    "text cell": (b"time [s],AF [N]\n0,1\n1,abc\n2,3\n", ["line 3, column 2 ('AF [N]')", "'abc' is no number"]),
    "date as time": (b"time [s],AF [N]\n2024-01-01,1\n2024-01-02,2\n", ["line 2, column 1", "'2024-01-01'"]),
    "text after a blank line": (b"time [s],AF [N]\n0,1\n\n1,2\n2,x\n", ["line 5, column 2", "'x'"]),
    "mixed decimal signs": (b"time [s];AF [N]\n0,5;1\n1.5;2\n2,5;3\n", ["line 3, column 1", "'1.5'"]),
    "overflow text": (b"time [s],AF [N]\n0,1\n1,1e5e5\n2,1\n", ["line 3, column 2", "1e5e5"]),
    "nothing in a channel": (b"time [s],AF [N]\n0,\n1,\n2,\n", ["AF", "no number in it"]),
    "no steady clock": (b"time [s],AF [N]\n0,1\n1,1\n1.1,1\n3.7,1\n3.9,1\n9,1\n", ["time column", "steady clock"]),
    "one stamp far off": (b"time [s],AF [N]\n0,1\n1,1\n2,1\n1e9,1\n", ["time column", "jumps", "cut the recording"]),
    "zero bytes": (b"time [s],AF [N]\n0,1\n1,\x00\x00\n2,3\n" + b"3,1\n" * 3, ["binary file"]),
    "binary": (bytes(range(256)) * 8, ["binary file of an unknown kind", "CSV text"]),
    "tdms": (b"TDSm\x0e\x00\x00\x00" + b"\x01" * 99, ["TDMS", "without channels"]),
    "index of tdms": (b"TDSh\x0e\x00\x00\x00" + b"\x01" * 99, ["index", ".tdms", "CSV text"]),
    "hdf5": (b"\x89HDF\r\n\x1a\n" + b"\x00" * 99, ["damaged HDF5 file"]),
    "spreadsheet": (b"PK\x03\x04" + b"\x14\x00" * 99, ["zip archive", "CSV text"]),
    "matlab": (b"MATLAB 5.0 MAT-file" + b"\x00\x01" * 99, ["MATLAB"]),
    "parquet": (b"PAR1\x15\x04\x15" + b"\x00" * 99, ["Parquet"]),
    "universal file": (b"    -1\n    58\n some text\n", ["universal file"]),
    "json": (b'{"kind": "dynamics"}', ["JSON", "CSV text"]),
    "prose": (b"Copyright 2014\n\nLicensed under\nthis\n", ["line 3", "is no number"]),
    "odd utf-16": (b"\xff\xfe" + GOOD.encode("utf-16-le") + b"\x31", ["cut off or damaged"]),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_file_is_refused_with_place_and_what_is_allowed(tmp_path, kind):
    content, said = BAD[kind]
    path = tmp_path / "bad.csv"
    path.write_bytes(content)
    with pytest.raises(ReadError) as caught:
        read(path)
    for words in ["bad.csv", *said]:
        assert words in str(caught.value)


@pytest.mark.parametrize("value", [1e200, -1.1e100, float("inf")])
@pytest.mark.parametrize("ending", ["csv", "h5", "tdms"])
def test_number_beyond_all_measure_is_missing_in_every_format(tmp_path, value, ending):
    path = tmp_path / f"run.{ending}"
    samples = np.array([1.0, 2.0, value, 4.0, 5.0])
    if ending == "csv":
        cells = "1e400" if np.isinf(value) else repr(value)
        path.write_text(f"time [s],AF [N]\n0,1\n1,2\n2,{cells}\n3,4\n4,5\n", encoding="utf-8")
    elif ending == "h5":
        channels = (StoredChannel("AF", "N"),)
        writer = BlockWriter(path, channels, rate=1.0, rows=5, provenance=Provenance("test"))
        writer.append(0, samples[:, None])
        writer.finish("done")
    else:
        settings = {"wf_increment": 1.0, "wf_xname": "Time", "wf_xunit_string": "s", "unit_string": "N"}
        with TdmsWriter(path) as file:
            file.write_segment([ChannelObject("run", "AF", samples, properties=settings)])
    places = {"csv": "line 4, column 2 ('AF [N]')", "h5": "AF at tick 2", "tdms": "channel 'run/AF', sample 3"}
    with pytest.warns(DataQualityWarning) as told:
        recording = read(path)
    texts = [str(one.message) for one in told]
    assert any("1 of 5 samples of AF are missing" in text for text in texts)
    if np.isfinite(value):  # an infinity says itself that it is no reading
        assert any("1 number(s) beyond 1e+100 either way" in text and places[ending] in text for text in texts)
    np.testing.assert_array_equal(recording.channel("AF").values, [1.0, 2.0, np.nan, 4.0, 5.0])


def test_zero_bytes_far_into_a_text_file_are_found(tmp_path):
    path = tmp_path / "bad.csv"
    rows = "".join(f"{i},1.0\n" for i in range(20000))
    path.write_bytes(b"time [s],AF [N]\n" + rows.encode() + b"\x00" * 4096)
    with pytest.raises(ReadError, match=r"line 20002.*zero bytes"):
        read(path)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(ReadError, match=r"none\.csv.*no such file"):
        read(tmp_path / "none.csv")
    with pytest.raises(ReadError, match="is a folder"):
        read(tmp_path)
    with pytest.raises(ReadError, match="no such file"):
        read_table(tmp_path / "none.csv")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes have no names there")
@pytest.mark.parametrize(
    "look",
    [
        read,
        read_anything,
        read_dynamics,
        read_any_dynamics,
        read_matrix,
        read_modes,
        read_schedule,
        read_weighing,
        load_channel_map,
        load_setup,
        contents,
        digest,
        ReplaySource,
        lambda path: read_rows(str(path)),
    ],
)
def test_a_pipe_in_the_place_of_a_file_is_refused_and_not_waited_for(tmp_path, look):
    pipe = tmp_path / "run.csv"
    os.mkfifo(pipe)
    with pytest.raises(ReadError, match=r"run\.csv: is a pipe.* ordinary file is needed"):
        look(pipe)
    assert (kind_of(pipe), dynamics_kind(pipe)) == ("", None)


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may read everything")
def test_unreadable_file(tmp_path):
    path = tmp_path / "closed.csv"
    path.write_text(GOOD)
    path.chmod(0)
    with pytest.raises(ReadError, match="cannot be read"):
        read(path)


@pytest.mark.parametrize("cell", ["", "NaN", "nan", "NA", "n/a", "inf", "-Inf", "Infinity", "+INF", "null", " "])
def test_missing_cells_are_kept_as_missing_with_a_warning(tmp_path, cell):
    path = tmp_path / "gappy.csv"
    path.write_text(f"time [s],AF [N],pitch [deg]\n0,1,0\n1,{cell},0\n2,3,0\n3,4,0\n")
    with pytest.warns(DataQualityWarning, match=r"gappy\.csv: 1 of 4 samples of AF are missing.*is larger"):
        recording = read(path)
    np.testing.assert_array_equal(recording.channel("AF").values, [1, np.nan, 3, 4])


def test_missing_rows_are_a_gap_with_a_warning(tmp_path):
    path = tmp_path / "gap.csv"
    path.write_text("time [s],AF [N]\n" + "".join(f"{i / 10},{i}\n" for i in range(50) if i not in (20, 21)))
    with pytest.warns(DataQualityWarning, match=r"2 sample\(s\) are missing"):
        recording = read(path)
    assert recording.samples == 50
    assert recording.gaps == [(1.9, pytest.approx(0.2))]
    assert np.flatnonzero(recording.channel("AF").missing).tolist() == [20, 21]


def test_saturation_is_warned_of(tmp_path):
    path = tmp_path / "clipped.csv"
    time = np.arange(1000) / 1000
    values = np.clip(np.sin(2 * np.pi * 10 * time), -2, 0.8)
    path.write_text("time [s],AF [N]\n" + "".join(f"{t},{v!r}\n" for t, v in zip(time, values.tolist(), strict=True)))
    with pytest.warns(DataQualityWarning, match=r"AF rests on its limit.*too small"):
        read(path)


def test_table_refuses_a_missing_cell_and_a_missing_column(tmp_path):
    path = tmp_path / "frf.csv"
    path.write_text("frequency [Hz],amplitude [1],phase [deg]\n10,1,-1\n20,,-2\n")
    with pytest.raises(ReadError, match=r"line 3, column 2 .*missing"):
        read_table(path)
    path.write_text("frequency [Hz],amplitude [1]\n10,1\n20,1\n")
    with pytest.raises(ReadError, match="no column phase; it has frequency, amplitude"):
        read_table(path, required=("frequency", "phase"))


@pytest.mark.parametrize("_again", range(3))
def test_damaged_files_never_end_in_anything_but_a_read_error(tmp_path, rng, _again):
    path = tmp_path / "damaged.csv"
    good = bytearray(b"time [s],AF [N],pitch [deg]\n" + b"".join(b"%d.5,%d,1e-3\n" % (i, i * i) for i in range(20)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for _ in range(60):
            content = bytearray(good)
            for _ in range(rng.integers(1, 6)):
                content[rng.integers(len(content))] = rng.integers(256)
            path.write_bytes(content[: rng.integers(1, len(content) + 1)])
            try:
                recording = read(path)
            except ReadError as error:
                assert "damaged.csv" in str(error)
            except Exception as error:
                raise AssertionError(f"{bytes(content)!r}") from error
            else:
                assert recording.samples >= 2
