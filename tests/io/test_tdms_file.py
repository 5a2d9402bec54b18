"""LabVIEW TDMS files, built byte by byte after the published description of the format."""

import json
import struct
import tracemalloc
import warnings
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from nptdms.reader import TdmsReader

from aerobalance.app.cli import main
from aerobalance.io import column_names, load_channel_map, read, template
from aerobalance.io.long_record import open_record
from aerobalance.io.series_record import SeriesRecord
from aerobalance.io.tdms_tasks import round_interval
from aerobalance.recording.errors import DataQualityWarning, ReadError
from aerobalance.recording.recording import Recording

REAL = Path(__file__).parents[3] / "shared" / "data" / "internal-balance"

META, NEW_LIST, RAW, INTERLEAVED = 2, 4, 8, 32
INT16, INT32, UINT32, SINGLE, DOUBLE, STRING, STAMP = 2, 3, 7, 9, 10, 0x20, 0x44
NUMPY = {"int16": INT16, "int32": INT32, "float32": SINGLE, "float64": DOUBLE, "complex64": 0x08000C}


class Stamp:
    """A TDMS time stamp: seconds since 1904 and fractions of 2^-64 s."""

    def __init__(self, microseconds, seconds=3_800_000_000):
        whole, rest = divmod(microseconds, 1_000_000)
        self.bytes = struct.pack("<Qq", rest * 2**64 // 1_000_000, seconds + whole)


def text(value):
    return struct.pack("<I", len(value.encode())) + value.encode()


def prop(name, value):
    if isinstance(value, str):
        body = struct.pack("<I", STRING) + text(value)
    elif isinstance(value, Stamp):
        body = struct.pack("<I", STAMP) + value.bytes
    elif isinstance(value, int):
        body = struct.pack("<II", UINT32, value)
    else:
        body = struct.pack("<Id", DOUBLE, value)
    return text(name) + body


def encoded(data):
    """Raw data and raw data index of one channel."""
    if data is None:
        return b"", struct.pack("<I", 0xFFFFFFFF)
    if isinstance(data, list) and data and isinstance(data[0], Stamp):
        return b"".join(stamp.bytes for stamp in data), struct.pack("<IIIQ", 20, STAMP, 1, len(data))
    if isinstance(data, list):
        words = [word.encode() for word in data]
        ends = np.cumsum([len(word) for word in words]).astype("<u4").tobytes()
        raw = ends + b"".join(words)
        return raw, struct.pack("<IIIQQ", 28, STRING, 1, len(data), len(raw))
    return data.tobytes(), struct.pack("<IIIQ", 20, NUMPY[data.dtype.name], 1, data.size)


def segment(channels, *, interleaved=False, to_the_end=False):
    """One segment: channels {"group/channel": (data, properties)}."""
    objects, raws = [], []
    for path, (data, properties) in channels.items():
        group, _, name = path.partition("/")
        raw, index = encoded(data)
        raws.append(raw)
        body = struct.pack("<I", len(properties)) + b"".join(prop(*item) for item in properties.items())
        objects.append(text(f"/'{group}'/'{name}'") + index + body)
    meta = struct.pack("<I", len(objects)) + b"".join(objects)
    raw = b"".join(raws)
    if interleaved:
        raw = np.rec.fromarrays([data for data, _ in channels.values()]).tobytes()
    toc = META | NEW_LIST | (RAW if raw else 0) | (INTERLEAVED if interleaved else 0)
    following = 2**64 - 1 if to_the_end else len(meta) + len(raw)
    return b"TDSm" + struct.pack("<IIQQ", toc, 4713, following, len(meta)) + meta + raw


def wave(data, unit="N", *, rate=1000.0, **properties):
    return data, {"wf_increment": 1 / rate, "wf_start_offset": 0.0, "unit_string": unit, **properties}


def written(folder, *segments, name="run.tdms"):
    path = folder / name
    path.write_bytes(b"".join(segments))
    return path


def mapped(path, toml):
    (path.parent / "map.toml").write_text(toml, encoding="utf-8")
    return read(path, channel_map=load_channel_map(path.parent / "map.toml"))


def channel(name, column, unit="N"):
    return f'[channels.{name}]\ncolumn = {json.dumps(column)}\nunit = "{unit}"\n'


FORCE = np.array([1.0, 2.0, 4.0, 8.0, 16.0])


def test_a_file_that_says_what_it_holds_needs_no_map(tmp_path):
    path = written(
        tmp_path,
        segment(
            {
                "run/AF": wave(FORCE, "kN", rate=500.0, wf_start_offset=0.25),
                "run/rN1": wave(FORCE, "uV/V", rate=500.0, wf_start_offset=0.25),
                "run/remarks": (["calm", "day"], {}),
                "run/never started": (None, {"wf_increment": 0.002}),
            }
        ),
        name="any.name",
    )
    recording = read(path)
    assert list(recording.channels) == ["AF", "rN1"]
    assert (recording.rate, recording.start, recording.samples) == (500.0, 0.25, 5)
    assert recording.channel("AF").values.tolist() == [1000, 2000, 4000, 8000, 16000]
    assert (recording.channel("AF").file_unit, recording.channel("rN1").unit) == ("kN", "mV/V")
    np.testing.assert_allclose(recording.channel("rN1").values, FORCE / 1000, rtol=1e-15)


@pytest.mark.parametrize(
    ("name", "properties"),
    [
        ("AF", {"NI_UnitDescription": "lbf"}),
        ("AF", {"unit_string": " []", "NI_UnitDescription": "lbf"}),
        ("AF", {"unit_string": "[lbf]"}),
        ("AF [lbf]", {}),
        ("AF (lbf)", {"unit_string": " []"}),
    ],
)
def test_where_the_unit_stands(tmp_path, name, properties):
    path = written(tmp_path, segment({f"run/{name}": (FORCE, {"wf_increment": 0.001, **properties})}))
    recording = read(path)
    np.testing.assert_allclose(recording.channel("AF").values, FORCE * 0.45359237 * 9.80665, rtol=1e-15)
    # The whole name of the channel will do as well.
    np.testing.assert_allclose(mapped(path, "[file]\n" + channel("AF", name)).channel("AF").values, FORCE)


@pytest.mark.parametrize(
    ("channels", "said"),
    [
        ({"run/N1": wave(FORCE, " []")}, ["'run/N1'", "no unit", "aerobalance map FILE"]),
        ({"run/N1": wave(FORCE, "furlong per moon")}, ["'run/N1'", "no unit", "aerobalance map FILE"]),
        (
            {"run/N1": wave(FORCE, "V")},
            ["none of its channels ('run/N1')", "a name that the program knows", "aerobalance map FILE"],
        ),
        ({"run/AF": wave(FORCE, "deg")}, ["column 1", "is an angle", "lbf"]),
        ({"a/AF": wave(FORCE), "b/AF": wave(FORCE)}, ["column 2", "a column AF already"]),
        (
            {"run/AF": (["a", "b"], {"unit_string": "N"})},
            ["none of its channels", "a name that the program knows", "map"],
        ),
        ({"run/AF": (FORCE, {"unit_string": "N"})}, ["no column time", "AF"]),
        ({"run/AF": wave(FORCE), "run/SF": (FORCE, {"unit_string": "N"})}, ["'run/SF'", "sampling rate", "map"]),
        ({"run/AF": wave(FORCE, wf_increment=0.0)}, ["'run/AF'", "wf_increment", "above zero"]),
        ({"run/AF": wave(FORCE, wf_increment=-1.0)}, ["'run/AF'", "wf_increment", "above zero"]),
        ({"run/AF": wave(FORCE, wf_increment=np.nan)}, ["'run/AF'", "wf_increment", "must be a number"]),
        ({"run/AF": wave(FORCE, wf_increment="fast")}, ["'run/AF'", "wf_increment", "'fast'"]),
        ({"run/AF": wave(FORCE, wf_xunit_string="Hz")}, ["wf_xunit_string", "a time is expected", "spectra"]),
        ({"run/AF": wave(FORCE[:1])}, ["no two samples"]),
        ({"run/AF": wave(np.array([np.nan, np.nan]))}, ["AF", "no number in it"]),
        ({}, ["without channels"]),
    ],
)
def test_files_that_cannot_be_read_as_they_are(tmp_path, channels, said):
    path = written(tmp_path, segment(channels))
    with pytest.raises(ReadError) as caught:
        read(path)
    for words in ["run.tdms", *said]:
        assert words in str(caught.value)


def test_a_start_that_no_sample_can_have_is_refused(tmp_path):
    """As in a damaged file: an OverflowError came of counting the samples from one start to the other."""
    path = written(tmp_path, segment({"run/AF": wave(FORCE), "run/NF": wave(FORCE, wf_start_offset=-3.88e304)}))
    with pytest.raises(ReadError, match=r"'run/NF'\): starts -3.88e\+304 s .* is no number of samples of 0.001 s"):
        read(path)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (["a", "b"], "text"),
        (None, "no samples"),
        (np.zeros(0), "no samples"),
        (np.ones(5, np.complex64), "complex"),
    ],
)
def test_a_channel_of_no_numbers_is_refused_where_it_is_wanted(tmp_path, data, said):
    path = written(tmp_path, segment({"run/AF": wave(FORCE), "run/odd": wave(data)}))
    assert mapped(path, "[file]\n" + channel("AF", "AF")).samples == 5
    assert list(read(path).channels) == ["AF"]
    with pytest.raises(ReadError, match=f"channel 'run/odd': it h.*{said}.*; a channel of numbers is needed"):
        mapped(path, "[file]\n" + channel("SF", "odd"))


def test_columns_by_label_name_and_number(tmp_path):
    path = written(tmp_path, segment({f"{group}/{name}": wave(FORCE + i) for i, (group, name) in enumerate(PLACES)}))
    found = mapped(path, "[file]\n" + channel("AF", "b/x") + channel("SF", "y") + channel("NF", 1))
    assert [found.channel(name).values[0] for name in ("AF", "SF", "NF")] == [3, 2, 1]
    with pytest.raises(ReadError, match="columns 1 and 3 are both called 'x'; give the number"):
        mapped(path, "[file]\n" + channel("AF", "x"))
    with pytest.raises(ReadError, match="no column 'z'; the file has 'a/x', 'a/y', 'b/x'"):
        mapped(path, "[file]\n" + channel("AF", "z"))
    with pytest.raises(ReadError, match="no column 9; the file has 3 columns"):
        mapped(path, "[file]\n" + channel("AF", 9))


PLACES = [("a", "x"), ("a", "y"), ("b", "x")]


@pytest.mark.parametrize("interleaved", [False, True])
def test_only_the_channels_wanted_are_read(tmp_path, monkeypatch, interleaved):
    names = [f"c{i}" for i in range(60)]
    channels = {f"run/{name}": wave(FORCE + i) for i, name in enumerate(names)}
    path = written(tmp_path, *[segment(channels, interleaved=interleaved)] * 3)
    asked = []
    one, every = TdmsReader.read_raw_data_for_channel, TdmsReader.read_raw_data

    def one_channel(self, channel_path, *args, **kwargs):
        asked.append(channel_path)
        return one(self, channel_path, *args, **kwargs)

    def all_channels(self):
        asked.append("all")
        return every(self)

    monkeypatch.setattr(TdmsReader, "read_raw_data_for_channel", one_channel)
    monkeypatch.setattr(TdmsReader, "read_raw_data", all_channels)
    found = mapped(path, "[file]\n" + channel("AF", "c41"))
    assert found.channel("AF").values.tolist() == (FORCE + 41).tolist() * 3
    assert asked == ["/'run'/'c41'"]
    asked.clear()
    assert "c59" in template(path)
    assert column_names(path)[59] == "run/c59"
    assert asked == []


@pytest.mark.parametrize("interleaved", [False, True])
@pytest.mark.parametrize("rows", [[100_000], [70_000, 30_000], [3_000] * 20 + [40_000]])
def test_parts_of_a_file_are_parts_of_what_is_read_whole(tmp_path, rng, interleaved, rows):
    scaled = {"NI_Number_Of_Scales": 1, "NI_Scale[0]_Scale_Type": "Linear", "NI_Scale[0]_Linear_Slope": 0.5}
    scaled |= {"NI_Scale[0]_Linear_Y_Intercept": 3.0, "NI_Scale[0]_Linear_Input_Source": 0xFFFFFFFF}
    segments = []
    for count in rows:
        counts = rng.integers(-1000, 1000, count).astype("<i2")
        parts = {"run/AF": wave(rng.normal(size=count), wf_start_offset=2.0)}
        parts |= {"run/NF": wave(counts, wf_start_offset=2.0, **scaled), "run/x": wave(counts, "V", rate=500.0)}
        segments.append(segment(parts, interleaved=interleaved))
    path = written(tmp_path, *segments)
    (tmp_path / "map.toml").write_text("[file]\n" + channel("AF", "AF") + channel("NF", "NF"), encoding="utf-8")
    chosen = load_channel_map(tmp_path / "map.toml")
    whole = read(path, channel_map=chosen)
    with open_record(path, channel_map=chosen) as record:
        assert isinstance(record, SeriesRecord)
        for begin, end in ((0, 10), (2_990, 6_010), (59_990, 99_990), (69_990, 70_010), (99_995, 100_000)):
            part, same = record.part(begin, end), whole.part(begin, end)
            assert (part.start, part.rate, part.channels.keys()) == (same.start, same.rate, same.channels.keys())
            for name, one in part.channels.items():
                np.testing.assert_array_equal(one.values, same.channel(name).values)


def test_a_long_chunk_is_not_read_for_a_short_part(tmp_path, rng):
    channels = {f"run/{name}": wave(rng.normal(size=500_000)) for name in ("AF", "NF", "SF")}
    path = written(tmp_path, segment(channels))
    with open_record(path) as record:
        record.part(0, 10)  # libraries are loaded
        tracemalloc.start()
        record.part(200_000, 210_000)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert most < 2_000_000  # a channel is 4 MB, the part 0.24 MB


def test_a_file_of_two_clocks_or_cut_off_is_read_whole(tmp_path, rng):
    values = rng.normal(size=100_000)
    two = segment({"run/AF": wave(values), "run/NF": wave(values[:50_000], rate=500.0)})
    for data in (two, segment({"run/AF": wave(values)})[:-1000]):
        said = nullcontext() if data is two else pytest.warns(DataQualityWarning, match="cut off")
        with said, open_record(written(tmp_path, data)) as record:
            assert isinstance(record, Recording)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.0010000000474974513, 0.001),  # what real files have
        (0.10000000149011612, 0.1),
        (float(np.float32(1 / 25000)), 1 / 25000),
        (float(np.float32(1 / 25600)), 1 / 25600),
        (float(np.float32(1 / 3000)), 1 / 3000),
        (0.5, 0.5),
        (0.001, 0.001),
        (1 / 3000, 1 / 3000),
        (0.00100000002, 0.00100000002),  # a measured interval in double precision
        (float(np.float32(0.00100012345)), float(np.float32(0.00100012345))),  # a measured one in single precision
        (-1.0, -1.0),
    ],
)
def test_intervals_that_went_through_single_precision(value, expected):
    assert round_interval(value) == expected


def test_single_precision_does_not_stretch_the_clock(tmp_path):
    samples = 50_000
    path = written(
        tmp_path, segment({"run/AF": wave(np.arange(samples) % 7.0, wf_increment=float(np.float32(1 / 25e3)))})
    )
    assert read(path).rate == 25e3


def test_slower_channels_are_interpolated_by_their_own_start(tmp_path):
    # Both channels are the time itself, which linear interpolation gives back exactly.
    fast = 0.1 + np.arange(1000) / 1000
    slow = 0.05 + np.arange(10) / 10
    path = written(
        tmp_path,
        segment(
            {
                "slow/pitch": wave(slow, "rad", rate=10.0, wf_start_time=Stamp(50_000)),
                "fast/AF": wave(fast, "N", wf_start_time=Stamp(100_000)),
            }
        ),
    )
    with pytest.warns(DataQualityWarning, match="49 of 1000 samples of pitch are missing"):
        recording = read(path)
    assert (recording.rate, recording.samples) == (1000.0, 1000)
    pitch = recording.channel("pitch").values
    known = slow[-1] >= fast
    # The last slow sample is at 0.95 s and held for its interval of 0.1 s; the clock goes on to 1.099 s.
    held = (fast > slow[-1] + 1e-9) & (fast <= slow[-1] + 0.1 + 1e-9)
    # The fractions of the stamps are floored to 2^-64 s; the rest is double precision.
    np.testing.assert_allclose(pitch[known], fast[known], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(pitch[held], slow[-1])
    assert np.isnan(pitch[~known & ~held]).all()
    assert np.count_nonzero(~known & ~held) == 49
    assert recording.channel("AF").delay == recording.channel("pitch").delay == 0.0


def test_a_slow_channel_is_held_before_it_starts_for_one_interval(tmp_path):
    path = written(
        tmp_path,
        segment(
            {
                "AF/AF": wave(np.arange(500.0), wf_start_time=Stamp(999_900)),
                "slow/pitch": wave(np.full(5, 0.3), "rad", rate=10.0, wf_start_time=Stamp(1_149_900)),
            }
        ),
    )
    with pytest.warns(DataQualityWarning, match="50 of 500 samples of pitch are missing"):
        pitch = read(path).channel("pitch").values
    assert np.isnan(pitch[:50]).all()
    np.testing.assert_array_equal(pitch[50:], 0.3)


@pytest.mark.parametrize("microseconds", [998, 1002, 3, -998, 400, -2499])
def test_fast_channels_with_another_start_keep_their_samples_and_get_a_delay(tmp_path, microseconds):
    base = 5_000_000
    index = np.arange(100.0)
    path = written(
        tmp_path,
        segment(
            {
                "run/AF": wave(1e-3 * index, wf_start_time=Stamp(base)),
                "other/SF": wave(1e-6 * microseconds + 1e-3 * index, wf_start_time=Stamp(base + microseconds)),
            }
        ),
    )
    shift = round(microseconds / 1000)
    if abs(shift) > 2:
        pytest.fail("the case is meant to lose at most two samples")
    recording = read(path)
    assert recording.samples == 100 - abs(shift)
    # Both channels read the time since the first of them started, so a reading is clock less delay.
    first = recording.channel("AF")
    second = recording.channel("SF")
    assert first.delay == 0.0
    assert second.delay == pytest.approx(1e-6 * (1000 * shift - microseconds), abs=1e-12)
    since = recording.time + (min(microseconds, 0) * 1e-6)
    np.testing.assert_allclose(first.values, since, rtol=0, atol=1e-12)
    np.testing.assert_allclose(second.values, since - second.delay, rtol=0, atol=1e-12)


@pytest.mark.parametrize("microseconds", [998, 1, 15_625, -998])
def test_channels_of_one_task_are_side_by_side_whatever_their_stamps(tmp_path, microseconds):
    base, index = 5_000_000, np.arange(100.0)
    late = {"run/SF", "run/PM"}
    path = written(
        tmp_path,
        segment(
            {
                label: wave(np.sin(index), unit, wf_start_time=Stamp(base + microseconds if label in late else base))
                for label, unit in (("run/AF", "N"), ("run/NF", "N"), ("run/SF", "N"), ("run/PM", "N*m"))
            }
        ),
    )
    behind = "SF, PM" if microseconds > 0 else "AF, NF"
    with pytest.warns(DataQualityWarning) as said:
        recording = read(path)
    assert len(said) == 1
    text = str(said[0].message)
    assert f"the start times of {behind} are up to {abs(microseconds) / 1000:.3g} ms after" in text
    assert recording.samples == 100
    assert recording.start == 0.0
    for found in recording:
        assert found.delay == 0.0
        np.testing.assert_array_equal(found.values, np.sin(index))


def test_a_task_of_which_one_half_is_read_starts_as_all_of_it(tmp_path):
    base, index = 5_000_000, np.arange(100.0)
    stamps = {"run/AF": base, "run/SF": base + 998, "run/PM": base + 998, "other/NF": base}
    waves = {
        label: wave(index, "N*m" if label == "run/PM" else "N", wf_start_time=Stamp(at))
        for label, at in stamps.items()
    }
    path = written(tmp_path, segment(waves))
    # nothing is said where all that is read has one stamp, and it stands beside the other group as it should
    recording = mapped(path, "[file]\n" + channel("SF", "run/SF") + channel("NF", "other/NF"))
    assert recording.samples == 100
    assert [found.delay for found in recording] == [0.0, 0.0]


@pytest.mark.parametrize(
    ("label", "settings"),
    [
        ("other/SF", {}),
        ("run/SF", {"rate": 999.9}),
        ("run/SF", {"n": 99}),
        ("run/SF", {"wf_start_offset": 0.001}),
        ("run/SF", {"late": 30_000}),
    ],
)
def test_channels_that_are_not_one_task_stand_where_their_stamps_put_them(tmp_path, label, settings):
    base, late = 5_000_000, settings.pop("late", 2_000)
    index = np.arange(float(settings.pop("n", 100)))
    waves = {
        "run/AF": wave(np.arange(100.0), wf_start_time=Stamp(base)),
        label: wave(index, wf_start_time=Stamp(base + late), **settings),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # samples at the ends are left out
        recording = read(written(tmp_path, segment(waves)))
    assert recording.channel("AF").values[0] >= late / 1000


def test_a_delay_of_the_map_comes_on_top(tmp_path):
    starts = {"run/AF": Stamp(0), "other/SF": Stamp(998)}
    path = written(tmp_path, segment({key: wave(np.arange(9.0), wf_start_time=at) for key, at in starts.items()}))
    found = mapped(path, "[file]\n" + channel("AF", "AF") + channel("SF", "SF") + "delay = 1e-4\n")
    assert found.channel("SF").delay == pytest.approx(1.02e-4, abs=1e-12)
    # With a rate in the map all channels are taken to be sampled together, whatever the file says.
    found = mapped(path, "[file]\nrate = 10.0\n" + channel("AF", "AF") + channel("SF", "SF"))
    assert (found.channel("SF").delay, found.samples) == (0.0, 9)
    assert found.rate == pytest.approx(10)


def test_fast_channels_of_other_lengths_are_doubted(tmp_path):
    path = written(tmp_path, segment({"run/AF": wave(np.arange(90.0)), "run/SF": wave(np.arange(100.0))}))
    with pytest.warns(DataQualityWarning, match="the 90 samples that they have in common, and up to 10 others"):
        assert read(path).samples == 90
    late = wave(np.arange(90.0), wf_start_offset=0.2)
    path = written(tmp_path, segment({"run/AF": late, "run/SF": wave(np.arange(100.0))}))
    with pytest.raises(ReadError, match="run/AF, run/SF have no two samples in common"):
        read(path)


def test_a_time_channel_is_the_clock_where_no_rate_is_stated(tmp_path):
    time = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    channels = {"run/Time": (time, {"unit_string": "ms"}), "run/F": (FORCE, {})}
    path = written(tmp_path, segment({**channels, "run/slow": (FORCE[:2], {})}))
    found = mapped(path, '[file]\ntime = "Time"\n' + channel("AF", "F"))
    assert found.rate == pytest.approx(2000)
    assert found.channel("AF").values.tolist() == FORCE.tolist()
    with pytest.raises(ReadError, match="'run/slow' has 2 samples and 'run/Time' has 5"):
        mapped(path, '[file]\ntime = "Time"\n' + channel("AF", "slow"))
    with pytest.raises(ReadError, match=r"map\.toml: file: needs either time .* or rate .*run\.tdms does not state"):
        mapped(path, "[file]\n" + channel("AF", "F"))
    plain = written(tmp_path, segment({"run/time": channels["run/Time"], "run/AF": (FORCE, {"unit_string": "N"})}))
    assert read(plain).rate == pytest.approx(2000)


def test_a_channel_of_time_stamps_is_a_time_channel(tmp_path):
    stamps = [Stamp(900_000 + 250_000 * i) for i in range(5)]
    path = written(tmp_path, segment({"run/when": (stamps, {}), "run/F": (FORCE, {})}))
    found = mapped(path, '[file]\ntime = "when"\n' + channel("AF", "F"))
    np.testing.assert_allclose(found.stamps, 0.25 * np.arange(5), rtol=0, atol=1e-12)


def test_scaled_integers_single_precision_and_interleaved_data(tmp_path):
    counts = np.array([-32768, -1, 0, 1, 32767], np.int16)
    scale = {
        "NI_Number_Of_Scales": 1,
        "NI_Scaling_Status": "unscaled",
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 0.25,
        "NI_Scale[0]_Linear_Y_Intercept": 3.0,
        "NI_Scale[0]_Linear_Input_Source": 2**32 - 1,  # the raw data
    }
    channels = {
        "run/AF": (counts, wave(counts)[1] | scale),
        "run/SF": wave(FORCE.astype(np.float32)),
        "run/NF": wave(np.arange(5, dtype=np.int32)),
    }
    for interleaved in (False, True):
        found = read(written(tmp_path, *[segment(channels, interleaved=interleaved)] * 2))
        np.testing.assert_array_equal(found.channel("AF").values, np.tile(0.25 * counts + 3.0, 2))
        np.testing.assert_array_equal(found.channel("SF").values, np.tile(FORCE, 2))
        np.testing.assert_array_equal(found.channel("NF").values, np.tile(np.arange(5.0), 2))


def test_infinite_samples_are_missing(tmp_path):
    data = np.array([1.0, np.inf, 3.0, -np.inf, 5.0, np.nan])
    with pytest.warns(DataQualityWarning, match="3 of 6 samples of AF are missing"):
        recording = read(written(tmp_path, segment({"run/AF": wave(data)})))
    assert np.flatnonzero(recording.channel("AF").missing).tolist() == [1, 3, 5]


def three_segments():
    channels = {"run/AF": wave(FORCE, wf_start_time=Stamp(0)), "run/SF": wave(FORCE.astype(np.float32))}
    return segment(channels) + segment(channels) + segment(channels)


def outcome(path, *, note=""):
    """Read a file that may be damaged: the number of samples, or None where it is refused."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = read(path).samples
        except ReadError as error:
            assert "\n" not in str(error), note
            found = None
    for item in caught:
        assert item.category is DataQualityWarning, (item.message, note)
    return found, [str(item.message) for item in caught]


def test_a_file_cut_off_anywhere_is_read_as_far_as_it_goes_or_refused(tmp_path, capfd):
    data = three_segments()
    one = len(data) // 3
    lengths = []
    for size in range(4, len(data)):
        found, said = outcome(written(tmp_path, data[:size]))
        lengths.append(found or 0)
        if found is not None and size not in (one, 2 * one):
            assert any("cut off" in words for words in said), size
    assert (lengths[one - 4], lengths[2 * one - 4]) == (5, 10)
    # Within the last segment the samples that both channels have are read: from none of the five to all but one.
    assert set(lengths[2 * one - 4 :]) == {10, 11, 12, 13, 14}
    assert capfd.readouterr().err == ""


def test_a_file_that_was_never_closed_is_read_and_doubted(tmp_path):
    channels = {"run/AF": wave(FORCE)}
    path = written(tmp_path, segment(channels), segment(channels, to_the_end=True))
    with pytest.warns(DataQualityWarning, match=r"run\.tdms: the file was cut off while it was written"):
        assert read(path).samples == 10


def test_damaged_bytes_end_in_a_recording_or_a_read_error(tmp_path, capfd, rng, seed):
    good = three_segments()
    refused = 0
    for trial in range(400):
        data = bytearray(good)
        for place in rng.integers(4, len(data), size=1 + trial % 3):
            data[place] = rng.integers(0, 256)
        found, _ = outcome(written(tmp_path, bytes(data)), note=f"seed {seed}")
        refused += found is None
    assert refused > 20
    assert capfd.readouterr().err == ""


def test_a_wrong_segment_is_refused(tmp_path):
    data = three_segments()
    one = len(data) // 3
    path = written(tmp_path, data[:one] + b"XXXX" + data[one + 4 :])
    with pytest.raises(ReadError, match=r"run\.tdms: its segments: is a damaged TDMS file"):
        read(path)


def test_an_index_file_beside_is_not_trusted(tmp_path):
    path = written(tmp_path, three_segments())
    (tmp_path / "run.tdms_index").write_bytes(b"TDSh" + b"\x00" * 40)
    assert read(path).samples == 15
    with pytest.raises(ReadError, match="index"):
        read(tmp_path / "run.tdms_index")


def foreign(folder):
    return written(
        folder,
        segment(
            {
                "Strain Book/N1": wave(np.linspace(0.001, 0.002, 400), " []"),
                "Strain Book/Excitation": wave(np.full(400, 10.0), " []"),
                "Arc/Alpha": wave(np.full(4, 30.0), " []", rate=10.0),
                "Arc/pitch": wave(np.full(4, 30.0), "deg", rate=10.0),
                "Arc/notes": (["a", "b"], {}),
            }
        ),
        name="foreign.tdms",
    )


def test_the_template_lists_group_channel_and_rate_and_completes_to_a_map(tmp_path):
    path = foreign(tmp_path)
    made = template(path)
    for words in ('"Strain Book/N1"', "# 1000 Hz, 400 samples", "# 10 Hz, 4 samples", "cannot be used: it holds text"):
        assert words in made
    assert "separator" not in made
    assert list(mapped(path, made).channels) == ["pitch"]
    for number, name in ((1, "rN1"), (2, "excitation")):
        made = made.replace(f"# [channels.column_{number}]", f"[channels.{name}]")
    made = made.replace('# column = "Strain', 'column = "Strain')
    made = made.replace('# unit = "?"', 'unit = "V"', 2)
    found = mapped(path, made)
    assert list(found.channels) == ["rN1", "excitation", "pitch"]
    assert (found.rate, found.samples) == (1000.0, 400)
    np.testing.assert_allclose(found.channel("pitch").values, np.pi / 6, rtol=1e-15)


def test_commands_read_tdms(tmp_path, capsys):
    path, toml, out = str(foreign(tmp_path)), str(tmp_path / "map.toml"), str(tmp_path / "plain.csv")
    assert main(["map", path, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["columns"][:2] == ["Strain Book/N1", "Strain Book/Excitation"]
    assert main(["info", path]) == 2
    assert "a channel map is needed, which `aerobalance map FILE` makes" in capsys.readouterr().err
    Path(toml).write_text("[file]\n" + channel("rN1", "N1", "V") + channel("excitation", "Excitation", "V"))
    assert main(["info", path, "--map", toml, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["rate"], told["samples"], list(told["channels"])) == (1000, 400, ["rN1", "excitation"])
    assert main(["convert", path, "--map", toml, "-o", out]) == 0
    again = read(out)
    assert again.channel("rN1").unit == "V"
    np.testing.assert_array_equal(again.channel("rN1").values, np.linspace(0.001, 0.002, 400))
    assert main(["convert", path, "--map", toml, "-o", str(tmp_path / "other.tdms")]) == 2


@pytest.mark.skipif(not REAL.is_dir(), reason="the real recordings are not here")
@pytest.mark.parametrize("wind", ["airOff", "airOn"])
@pytest.mark.parametrize("angle", ["-8.0", "0.0", "12.0"])
def test_real_recordings(tmp_path, wind, angle):
    toml = tmp_path / "map.toml"
    bridges = "".join(channel(f"r{name}", f"StrainBook_0/{name}", "V") for name in ("N1", "N2", "Y1", "Axial"))
    toml.write_text("[file]\n" + bridges + channel("pitch", "Alpha", "deg") + channel("excitation", "Excitation", "V"))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "airO.*start times of", DataQualityWarning)
        recording = read(REAL / f"{wind}_alpha_{angle}.tdms", channel_map=load_channel_map(toml))
    # Its description: bridges at 1 kHz for 5 s, angles at 10 Hz; start times differ by the clock's tick at most.
    assert recording.rate == 1000.0
    assert (recording.samples, recording.start) == (5000, 0.0)
    assert abs(np.degrees(recording.channel("pitch").values) - float(angle)).max() < 0.1
    assert 9 < recording.channel("excitation").values.mean() < 11
    assert all(abs(found.delay) < 5e-4 for found in recording)
