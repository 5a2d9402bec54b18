"""Plain CSV: every layout reads the same; what is written reads back."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerobalance.io import check_output, column_names, read, read_table, text_rows, write_recording
from aerobalance.io.results_file import force_columns, writing
from aerobalance.io.text_table import read_text_columns
from aerobalance.recording.channel import Channel
from aerobalance.recording.errors import DataQualityWarning, ReadError
from aerobalance.recording.recording import Recording

ROWS = [(0.0, -1.5, 0.25), (0.625, 2.0, -3.5e-3), (1.25, 1234.5678, 1.0), (1.875, -0.125, 2.0)]


def text(separator, decimal, end):
    header = separator.join(["time [ms]", "AF [lbf]", "pitch [°]"])
    rows = [separator.join(repr(cell).replace(".", decimal) for cell in row) for row in ROWS]
    if end == "none at the end":
        return "\n".join([header, *rows])
    return end.join([header, *rows]) + end


def check(path):
    recording = read(path)
    rows = np.array(ROWS)
    np.testing.assert_array_equal(recording.stamps, rows[:, 0] / 1000)
    # One pound-force is 4.4482216152605 N exactly (its definition); two roundings of half an ulp each.
    np.testing.assert_allclose(recording.channel("AF").values, rows[:, 1] * 4.4482216152605, rtol=4e-16)
    np.testing.assert_allclose(recording.channel("pitch").values, np.radians(rows[:, 2]), rtol=4e-16)
    assert recording.rate == pytest.approx(1600)
    assert recording.channel("AF").file_unit == "lbf"
    assert recording.time_unit == "ms"


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "none at the end"])
@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-le", "utf-16-be", "be with bom", "utf-32"]
)
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", "."), ("\t", "."), (";", ","), ("\t", ",")])
def test_every_layout_reads_the_same(tmp_path, separator, decimal, encoding, end):
    path = tmp_path / "any.csv"
    given = text(separator, decimal, end)
    if encoding == "be with bom":
        path.write_bytes(b"\xfe\xff" + given.encode("utf-16-be"))
    else:
        path.write_bytes(given.encode(encoding))
    check(path)


def test_quoted_cells_blank_lines_and_trailing_separators(tmp_path):
    path = tmp_path / "odd.csv"
    path.write_text("\n\n" + text(",", ".", ",\n") + "\n\n", encoding="utf-8")
    check(path)
    quoted = "\n".join(
        [
            '"time [ms]","AF [lbf]","pitch [°]"',
            *(",".join('"' + repr(cell).replace(".", ",") + '"' for cell in row) for row in ROWS),
        ]
    )
    path.write_text(quoted, encoding="utf-8")
    check(path)


def test_spaces_around_cells_are_no_matter(tmp_path):
    path = tmp_path / "spaces.csv"
    path.write_text(text(" , ", ".", " \n"), encoding="utf-8")
    check(path)


def test_micro_sign_in_cp1252(tmp_path):
    path = tmp_path / "micro.csv"
    path.write_bytes("time [µs];rAF [µV/V]\n0;1,5\n40;2\n80;3\n".encode("cp1252"))
    recording = read(path)
    np.testing.assert_allclose(recording.channel("rAF").values, [1.5e-3, 2e-3, 3e-3], rtol=4e-16)
    assert recording.rate == pytest.approx(25000)


def test_other_columns_are_passed_on_untouched(tmp_path):
    path = tmp_path / "more.csv"
    path.write_text("time [s],AF [N],temperature [degC],fan [rpm]\n0,1,20,300\n1,2,21,301\n")
    recording = read(path)
    assert recording.channel("temperature").unit == "degC"
    assert recording.channel("fan").values.tolist() == [300, 301]


def test_decimal_comma_that_comes_late(tmp_path):
    path = tmp_path / "late.csv"
    path.write_text("time [s];AF [N]\n" + "".join(f"{i};{i}\n" for i in range(500)) + "500;0,5\n")
    assert read(path).channel("AF").values[-1] == 0.5


def test_frf_table(tmp_path):
    path = tmp_path / "frf.csv"
    path.write_text("frequency [Hz],amplitude [1],u_amplitude [1],phase [deg],u_phase [deg]\n10,1.5,0.5,-90,1\n")
    table = read_table(path, required=("frequency", "amplitude", "phase"))
    assert table.values("phase")[0] == pytest.approx(-np.pi / 2, rel=1e-15)
    assert table.values("u_phase")[0] == pytest.approx(np.pi / 180, rel=1e-15)
    assert table.column("amplitude").unit == "1"
    assert column_names(path) == ("frequency", "amplitude", "u_amplitude", "phase", "u_phase")


numbers = st.floats(-1e12, 1e12, allow_subnormal=False)


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(numbers, min_size=2, max_size=30),
    clock=st.tuples(st.floats(-1e3, 1e3), st.sampled_from([1 / 1600, 1 / 25000, 0.1, 1 / 3])),
    unit=st.sampled_from([("s", "N", ""), ("ms", "lbf", "deg"), ("us", "kN", "rad")]),
    suffix=st.sampled_from([".csv", ".txt", ".tsv"]),
)
def test_round_trip(tmp_path_factory, values, clock, unit, suffix):
    path = tmp_path_factory.mktemp("round") / f"trip{suffix}"
    stamps = clock[0] + np.arange(len(values)) * clock[1]
    load, angle = np.array(values), np.array(values) / 1e12
    channels = {
        "AF": Channel("AF", load, "N", file_unit=unit[1]),
        "pitch": Channel("pitch", angle, "rad", file_unit=unit[2]),
    }
    recording = Recording.from_columns(stamps, channels, time_unit=unit[0])
    write_recording(path, recording)
    again = read(path)
    if unit[0] == "s":
        np.testing.assert_array_equal(again.stamps, stamps)
    else:  # fifteen digits
        np.testing.assert_allclose(again.stamps, stamps, rtol=1e-14, atol=0)
    exact = {"N": 0.0}.get(unit[1], 4.5e-16)  # a change of unit there and back rounds twice
    tiny = 1e-300  # a change of unit may go below the normal floats, where relative rounding is coarser
    np.testing.assert_allclose(again.channel("AF").values, load, rtol=exact, atol=tiny)
    np.testing.assert_allclose(again.channel("pitch").values, angle, rtol=4.5e-16, atol=tiny)
    assert again.time_unit == unit[0]
    # Written again, the file is the same to the byte: text values survive.
    second = path.with_name(f"second{suffix}")
    write_recording(second, again)
    assert second.read_text().split("\n")[0] == path.read_text().split("\n")[0]
    first_cells = [line.replace("\t", ",").split(",")[0] for line in path.read_text().splitlines()]
    assert [line.replace("\t", ",").split(",")[0] for line in second.read_text().splitlines()] == first_cells


def test_force_keeps_time_text_name_and_unit(tmp_path):
    source, target = tmp_path / "in.csv", tmp_path / "out.csv"
    stamps = [f"{i * 0.625:.3f}" for i in range(40)]
    rows = [f"{stamp},{i},{-i}" for i, stamp in enumerate(stamps) if i != 7]
    source.write_text("time [ms],AF [lbf],PM [in-lbf]\n" + "\n".join(rows) + "\n")
    with pytest.warns(UserWarning, match="missing from the time column"):
        recording = read(source)
    values = np.column_stack([recording.channel(name).values for name in ("AF", "PM")])
    force = dict(zip(("AF", "PM"), values.T, strict=True))
    with writing(target, samples=40) as append:
        for part in (slice(0, 6), slice(6, 8), slice(8, 40)):
            values_of_part = {name: column[part] for name, column in force.items()}
            ones = dict.fromkeys(force, np.ones(part.stop - part.start))
            append(force_columns(target, recording, part, values_of_part, ones))
    lines = target.read_text().splitlines()
    assert lines[0] == "time [ms],AF [lbf],u_AF [lbf],PM [in-lbf],u_PM [in-lbf]"
    assert [float(line.split(",")[0]) for line in lines[1:]] == [float(s) for i, s in enumerate(stamps) if i != 7]
    table = read_table(target)
    np.testing.assert_allclose(
        table.values("AF"), values[recording.rows, 0], rtol=0, atol=1e-3
    )  # of an uncertainty of 1
    np.testing.assert_allclose(table.values("u_PM"), 1.0, rtol=1e-3)


def test_force_on_another_clock_is_refused(tmp_path):
    recording = Recording.from_columns(np.arange(4.0), {"AF": Channel("AF", np.arange(4.0), "N")})
    force = {"AF": np.zeros(3)}
    with pytest.raises(ValueError, match="3 samples, the recording 4"):
        force_columns(tmp_path / "out.csv", recording, slice(0, 4), force, force)


def test_unknown_ending_and_missing_folder_are_refused_before_writing(tmp_path):
    with pytest.raises(ValueError, match=r"'\.docx'.*allowed: .*\.csv, \.txt, \.tsv"):
        check_output(tmp_path / "out.docx")
    with pytest.raises(ValueError, match="no folder"):
        check_output(tmp_path / "none" / "out.csv")
    with pytest.raises(ValueError, match="is a folder"):
        (tmp_path / "dir.csv").mkdir()
        check_output(tmp_path / "dir.csv")


def test_angles_without_a_file_are_written_in_degrees(tmp_path):
    recording = Recording.from_columns(np.arange(3.0), {"pitch": Channel("pitch", np.full(3, np.pi / 2), "rad")})
    write_recording(tmp_path / "p.csv", recording)
    assert (tmp_path / "p.csv").read_text().splitlines()[:2] == ["time [s],pitch [deg]", "0.0,90.0"]


def test_lines_are_counted_over_blank_lines(tmp_path):
    path = tmp_path / "blank.csv"
    path.write_text("\na [N]\n1\n\n2\n\n\n3\n")
    assert list(read_text_columns(path).lines) == [3, 5, 8]
    path.write_text("a [N],b [N]\n1,2\n")
    with pytest.raises(ReadError, match="no column 'c'"):
        read_text_columns(path, wanted=["c"])


PLAIN = {
    "numbers": ("time [s],AF [N]\n0,1e-3\n0.5,-2.25E2\n1,+.5\n", True),
    "decimal comma": ("time [s];AF [N]\n0,0;1,5\n0,5;-2,25\n1,0;3,125", True),
    "an empty cell": ("time [s],AF [N]\n0,1\n0.5,\n1,3\n", False),
    "a blank line": ("time [s],AF [N]\n0,1\n\n0.5,2\n1,3\n", False),
    "words": ("time [s],AF [N]\n0,1\n0.5,NaN\n1,-inf\n", False),
    "spaces": ("time [s], AF [N]\n0, 1\n0.5, 2\n1, 3\n", False),
    "a number beyond all measure": ("time [s],AF [N]\n0,1\n0.5,1e200\n1,1e999\n", True),
}


@pytest.mark.parametrize("what", PLAIN)
def test_plain_numbers_are_read_as_any_others_are(tmp_path, monkeypatch, what):
    text, is_plain = PLAIN[what]
    path, asked = tmp_path / "a.csv", []
    path.write_text(text)
    careful = text_rows._careful
    monkeypatch.setattr(text_rows, "_careful", lambda *given: asked.append(1) or careful(*given))
    with warnings.catch_warnings(record=True) as first:
        warnings.simplefilter("always")
        found = read(path)
    assert asked == ([] if is_plain else [1])
    monkeypatch.setattr(text_rows, "_plain", lambda *_, **__: None)
    with warnings.catch_warnings(record=True) as second:
        warnings.simplefilter("always")
        again = read(path)
    np.testing.assert_array_equal(found.stamps, again.stamps)
    np.testing.assert_array_equal(found.channel("AF").values, again.channel("AF").values)
    assert [str(one.message) for one in first] == [str(one.message) for one in second]


@pytest.mark.parametrize("row", ["1", "1,2,3", "1,1-2", "1,e", "1,1.2.3"])
def test_plain_rows_that_are_wrong_are_named(tmp_path, row):
    path = tmp_path / "a.csv"
    path.write_text(f"time [s],AF [N]\n0,1\n0.5,1\n{row}\n")
    with pytest.raises(ReadError, match="line 4"):
        read(path)


@pytest.fixture
def short_texts_are_long(monkeypatch):
    monkeypatch.setattr(text_rows, "LONG", 1000)


WAYS = (".7f", ".6e", ".3g", "+.4E", ".12g", ".0f", ".17g", ".25f")
"""How numbers are written: the last two with more digits than a float has."""


@pytest.mark.parametrize("ways", [WAYS[:6], WAYS], ids=["plain", "long"])
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", ".")])
@pytest.mark.usefixtures("short_texts_are_long")
@pytest.mark.soak(first=4)
def test_numbers_of_a_long_text_are_right_to_the_last_digit(tmp_path, rng, ways, separator, decimal):
    numbers = rng.normal(size=(30_000, 3)) * 10.0 ** rng.integers(-9, 9, (30_000, 3))
    way = rng.integers(len(ways), size=numbers.shape)
    cells = [[format(x, ways[i]) for x, i in zip(*row, strict=True)] for row in zip(numbers, way, strict=True)]
    rows = [separator.join([f"{i}e-3", *row]).replace(".", decimal) for i, row in enumerate(cells)]
    head = separator.join(["time [s]", "AF [N]", "NF [N]", "SF [N]"])
    (tmp_path / "run.csv").write_text("\n".join([head, *rows, ""]))
    found = read(tmp_path / "run.csv")
    for place, name in enumerate(("AF", "NF", "SF")):
        assert found.channel(name).values.tolist() == [float(row[place]) for row in cells]


@pytest.mark.parametrize("cell", ["", "nan", "1,5", "1-2", "1e", ".", "+", "1.2.3", "0x1"])
@pytest.mark.usefixtures("short_texts_are_long")
def test_a_cell_that_is_no_number_is_found_far_down_in_a_long_text(tmp_path, cell):
    rows = [f"{i}e-3,{i % 7}.25" for i in range(40_000)]
    rows[39_000] = f"39000e-3,{cell}"
    (tmp_path / "run.csv").write_text("\n".join(["time [s],AF [N]", *rows]))
    if cell in ("", "nan"):
        with pytest.warns(DataQualityWarning, match="1 of 40000 samples of AF are missing"):
            assert np.flatnonzero(read(tmp_path / "run.csv").channel("AF").missing).tolist() == [39_000]
        return
    with pytest.raises(ReadError, match="line 39002"):
        read(tmp_path / "run.csv")
