"""LabVIEW measurement files, built from bytes after the published description of the format."""

import json
import warnings

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.io import column_names, load_channel_map, read, template
from aerobalance.recording.errors import DataQualityWarning, ReadError

FILE = {
    "Writer_Version": "2", "Reader_Version": "2", "Separator": "Tab", "Decimal_Separator": ".",
    "Multi_Headings": "Yes", "X_Columns": "No",
    "Time_Pref": "Relative", "Operator": "lab", "Date": "2024/03/12", "Time": "10:15:00.5",
}  # fmt: skip


def lines(tags):
    return "".join(f"{tag}\t{value}\r\n" for tag, value in tags.items())


def file_head(**tags):
    return "LabVIEW Measurement\t\r\n" + lines(FILE | tags) + "***End_of_Header***\t\r\n\t\r\n"


def segment(columns, *, time="10:15:00.5", names=("AF", "pitch"), units=("N", "deg"), **tags):
    """A segment of channels without times; what its tags say of every channel is the same."""
    count = len(columns)
    said = {"Samples": len(columns[0]), "Date": "2024/03/12", "Time": time, "X_Dimension": "Time", "X0": "0.0E+0"}
    said |= {"Delta_X": "0.001000"} | tags
    head = {"Channels": str(count), "Y_Unit_Label": "\t".join(units)}
    head |= {tag: "\t".join([str(value)] * count) for tag, value in said.items()}
    rows = "".join("\t" + "\t".join(f"{cell:.6f}" for cell in row) + "\r\n" for row in zip(*columns, strict=True))
    return (
        lines(head) + "***End_of_Header***\t\t\r\nX_Value\t" + "\t".join([*names, "Comment"]) + "\r\n" + rows + "\r\n"
    )


def written(folder, text):
    path = folder / "run.lvm"
    path.write_bytes(text.encode("cp1252"))
    return path


AF = np.round(np.sin(np.arange(20)), 6)
TWO = np.full(20, 2.0)


def test_one_segment_on_the_clock_of_its_header(tmp_path):
    found = read(written(tmp_path, file_head() + segment([AF, TWO], X0="0.25")))
    assert (found.rate, found.start, found.samples) == (1000.0, 0.25, 20)
    assert found.channel("AF").values.tolist() == AF.tolist()
    np.testing.assert_allclose(found.channel("pitch").values, np.radians(2))
    assert found.gaps == []


def test_segments_follow_each_other_and_a_late_one_leaves_a_gap(tmp_path):
    parts = [segment([AF, TWO], time=f"10:15:00.{520 + 20 * i + 15 * (i == 2):03d}") for i in range(3)]
    path = written(tmp_path, file_head() + "".join(parts))
    with pytest.warns(DataQualityWarning, match=r"15 sample\(s\) are missing in 1 gap"):
        found = read(path)
    assert found.samples == 75
    missing = np.isnan(found.channel("AF").values)
    assert np.flatnonzero(missing).tolist() == list(range(40, 55))
    assert found.channel("AF").values[~missing].tolist() == [*AF, *AF, *AF]


def test_segments_whose_clocks_overlap_follow_each_other_with_a_warning(tmp_path):
    parts = [segment([AF, TWO], time=time) for time in ("10:15:00.5", "10:15:00.505", "10:15:00.510")]
    with pytest.warns(DataQualityWarning, match="2 of 3 segments begin, by their date and time, before"):
        assert read(written(tmp_path, file_head() + "".join(parts))).samples == 60


def test_segments_without_times_of_their_own_follow_each_other(tmp_path):
    assert read(written(tmp_path, file_head() + segment([AF, TWO]) * 3)).samples == 60


def test_many_segments_of_one_row(tmp_path):
    text = file_head() + segment([AF[:1], TWO[:1]]) * 500
    assert read(written(tmp_path, text)).samples == 500


@pytest.mark.parametrize("separator", ["Tab", "Comma"])
@pytest.mark.parametrize("x_columns", ["No", "One", "Multi"])
def test_times_beside_the_readings(tmp_path, separator, x_columns):
    names = ["X_Value", "AF", *(["X_Value"] if x_columns == "Multi" else []), "pitch", "Comment"]
    gap = "\t" if x_columns == "Multi" else ""
    tags = {
        "Channels": "2",
        "Samples": f"20{gap}\t20",
        "X_Dimension": f"Time{gap}\tTime",
        "Y_Unit_Label": f"N{gap}\tdeg",
    }
    tags |= {"X0": f"0.0{gap}\t0.0", "Delta_X": f"0.001{gap}\t0.001"}
    rows = ""
    for i in range(20):
        x = "" if x_columns == "No" else f"{i / 1000:.6f}"
        rows += "\t".join([x, f"{AF[i]:.6f}", *([x] if x_columns == "Multi" else []), "2.0"]) + "\r\n"
    text = file_head(X_Columns=x_columns, Separator=separator) + lines(tags) + "***End_of_Header***\r\n"
    text += "\t".join(names) + "\r\n" + rows
    found = read(written(tmp_path, text.replace("\t", "," if separator == "Comma" else "\t")))
    assert list(found.channels) == ["AF", "pitch"]
    assert found.channel("AF").values.tolist() == AF.tolist()
    assert found.rate == 1000


def test_channels_of_different_rates(tmp_path):
    tags = {"Channels": "2", "Samples": "20\t\t5", "X_Dimension": "Time\t\tTime", "Y_Unit_Label": "N\t\tdeg"}
    tags |= {"X0": "0.0\t\t0.0", "Delta_X": "0.001\t\t0.004"}
    rows = "".join(
        f"{i / 1000:.6f}\t{AF[i]:.6f}\t" + (f"{i * 0.004:.6f}\t{i}.0" if i < 5 else "\t") + "\r\n" for i in range(20)
    )
    head = file_head(X_Columns="Multi") + lines(tags)
    found = read(written(tmp_path, f"{head}***End_of_Header***\r\nX_Value\tAF\tX_Value\tpitch\tComment\r\n{rows}"))
    assert found.rate == 1000
    np.testing.assert_allclose(np.degrees(found.channel("pitch").values[:17]), np.arange(17) / 4, atol=1e-12)


def test_decimal_comma_special_blocks_and_comments(tmp_path):
    text = file_head(Decimal_Separator=",") + "***Start_Special***\r\nScope\t1\r\nX_Value\tno\r\n***End_Special***\r\n"
    text += segment([AF, TWO], Delta_X="0,000200").replace("0.5", "0,5")
    head, names, rows = text.partition("X_Value\tAF\tpitch\tComment\r\n")
    rows = rows.replace(".", ",").replace("\r\n", "\twind on\r\n", 1)
    found = read(written(tmp_path, head + names + rows))
    assert found.rate == 5000
    assert found.channel("AF").values.tolist() == AF.tolist()


def test_the_map_of_an_lvm(tmp_path, capsys):
    path = written(tmp_path, file_head() + segment([AF, TWO], names=("Brücke 1", "pitch"), units=("mV/V", "deg")))
    assert column_names(path) == ("Brücke 1", "pitch")
    text = template(path)
    assert "1000 Hz" in text
    assert "rate = 1000" not in text
    for old in ("# [channels.column_2]", '# column = "Br', '# unit = "mV/V"'):
        assert old in text
    text = text.replace("# [channels.column_2]", "[channels.rAF]").replace('# column = "Br', 'column = "Br')
    (tmp_path / "map.toml").write_text(text.replace('# unit = "mV/V"', 'unit = "mV/V"'), encoding="utf-8")
    assert main(["info", str(path), "--map", str(tmp_path / "map.toml"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["rate"], told["samples"], list(told["channels"])) == (1000.0, 20, ["rAF", "pitch"])


def test_a_map_may_read_the_plain_text_behind_the_headers(tmp_path):
    path = written(tmp_path, file_head(X_Columns="One") + segment([AF, TWO]))
    content = path.read_bytes()
    header = content[: content.index(b"X_Value")].count(b"\n") + 1
    text = f'[file]\nheader_line = {header}\nrate = 2000.0\n[channels.AF]\ncolumn = "AF"\nunit = "N"\n'
    (tmp_path / "map.toml").write_text(text)
    with pytest.warns(DataQualityWarning, match="the channel map says 2000 Hz, but line 21 says 1000 Hz"):
        found = read(path, channel_map=load_channel_map(tmp_path / "map.toml"))
    assert found.rate == pytest.approx(2000)


def test_times_that_contradict_the_header_are_taken_with_a_warning(tmp_path):
    text = file_head(X_Columns="One") + segment([AF, TWO], Delta_X="1.000000")
    for i in range(20):
        text = text.replace(f"\r\n\t{AF[i]:.6f}\t2", f"\r\n{i / 1000:.6f}\t{AF[i]:.6f}\t2", 1)
    with pytest.warns(DataQualityWarning, match=r"Delta_X of channel 1 says 1 Hz, but .* 1000 Hz; the times are"):
        assert read(written(tmp_path, text)).rate == pytest.approx(1000)


def test_an_interval_that_labview_writes_for_none_is_doubted(tmp_path):
    with pytest.warns(DataQualityWarning, match="Delta_X is 1 s, which LabVIEW also writes where signals have no"):
        assert read(written(tmp_path, file_head() + segment([AF, TWO], Delta_X="1.000000"))).rate == 1


BAD = {
    "no segment header": (file_head(), ["without a segment header", "aerobalance map FILE"]),
    "no names": (file_head() + "Channels\t1\r\n***End_of_Header***\t\r\n", ["segment 1", "no line of column names"]),
    "other channels": (
        file_head() + segment([AF, TWO]) + segment([AF, TWO], names=("NF", "pitch")),
        ["segment 2", "NF, pitch", "AF, pitch"],
    ),
    "a spectrum": (file_head() + segment([AF, TWO], X_Dimension="Frequency"), ["is over Frequency", "Time"]),
    "no rows": (file_head() + segment([AF[:0], TWO[:0]]), ["no rows of numbers"]),
    "no interval": (file_head() + segment([AF, TWO], Delta_X=""), ["states no Delta_X above 0 for channel 1"]),
    "text cell": (file_head() + segment([AF, TWO]).replace("2.000000", "two", 1), ["line 24", "'two' is no number"]),
    "short row": (file_head() + segment([AF, TWO]).replace("\t2.000000", "", 1), ["line 24", "cell(s)"]),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_files_are_refused_with_place_and_what_is_allowed(tmp_path, kind):
    text, said = BAD[kind]
    with pytest.raises(ReadError) as caught:
        read(written(tmp_path, text))
    for words in ["run.lvm", *said]:
        assert words in str(caught.value)


def test_damaged_files_end_in_a_recording_or_a_read_error(tmp_path):
    rng = np.random.default_rng(20240312)
    good = (file_head() + segment([AF, TWO]) + segment([AF, TWO], time="10:15:00.520")).encode()
    path = tmp_path / "damaged.lvm"
    ends = set()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for _ in range(300):
            content = bytearray(good)
            for _ in range(rng.integers(1, 5)):
                at, size = rng.integers(len(content)), rng.integers(0, 30)
                content[at : at + size] = rng.bytes(int(rng.integers(0, 3))) if rng.random() < 0.5 else content[:size]
            path.write_bytes(content)
            try:
                read(path)
            except ReadError as error:
                assert "damaged.lvm" in str(error)
                ends.add("refused")
            else:
                ends.add("read")
    assert ends == {"refused", "read"}
