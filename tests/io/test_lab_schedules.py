"""Load schedules as laboratories write them: titles, units lines, words, decimal commas, workbooks, channel maps."""

from __future__ import annotations

import builtins
import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from aerobalance.io import load_channel_map, template
from aerobalance.io.schedule import read_schedule
from aerobalance.recording.errors import ReadError

LOADS = np.array([[100.5, 0.0], [-200.25, 0.0], [0.0, 12.5], [0.0, -25.125]])
OUTPUTS = np.array([[0.51, 0.002], [-1.01, 0.001], [0.003, 0.25], [0.004, -0.51]])
SERIES = ("S1", "S1", "Mx pos", "Mx pos")
POINTS = ("P1", "P2", "1", "2")


def cells(*, comma: bool = False, series: bool = True, extra: tuple[str, ...] = ()) -> list[list[str]]:
    """Rows of numbers as text."""
    rows = []
    for load, output, of, point in zip(LOADS, OUTPUTS, SERIES, POINTS, strict=True):
        numbers = [f"{value:.6g}" for value in (*load, *output)]
        numbers = [number.replace(".", ",") for number in numbers] if comma else numbers
        rows.append([*([of, point] if series else []), *numbers, *extra])
    return rows


def text(rows: list[list[str]], separator: str, end: str = "\r\n") -> str:
    return "".join(separator.join(row) + end for row in rows)


def check(schedule, *, components=("N1", "RM"), named: bool = True) -> None:
    """Loads in N and N*m, outputs in mV/V, all as they were written."""
    assert schedule.components == components
    np.testing.assert_allclose(schedule.loads, LOADS, rtol=1e-12)
    np.testing.assert_allclose(schedule.outputs, OUTPUTS, rtol=1e-12)
    assert schedule.moments.tolist() == [False, True]
    if named:
        assert schedule.series_names == ("S1", "Mx pos")
        assert schedule.series.tolist() == [0, 0, 1, 1]
        assert schedule.points == POINTS


def put(tmp_path: Path, content: bytes | str, name: str = "schedule.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


GERMAN = [
    ["Kalibrierung Waage Süd, Prüfer Müller", "", "", "", "", "", ""],
    ["Datum", "12.03.2025", "", "", "", "", ""],
    ["Serie", "Punkt", "N1", "RM", "rN1", "rRM", "Bemerkung"],
    ["", "", "N", "Nm", "mV/V", "mV/V", ""],
    *cells(comma=True, extra=("gut",)),
    ["Ende der Kalibrierung", "", "", "", "", "", ""],
]
FRENCH = [
    ["Étalonnage de la balance"],
    ["Série", "Point de mesure", "N1 (N)", "RM (N·m)", "Pont N1 (mV/V)", "Pont RM (mV/V)", "Remarques"],
    *cells(comma=True, extra=("très bien",)),
]
ENGLISH = [
    ["Load Series", "Point No.", "N1 [N]", "RM [N*m]", "N1 bridge [mV/V]", "Bridge RM [mV/V]", "Operator"],
    *cells(extra=("A. Smith",)),
]
TWICE = [["Lastreihe", "Lfd. Nr.", "N1", "RM", "N1", "RM"], ["", "", "[N]", "[Nm]", "[mV/V]", "[mV/V]"]]
DIALECTS = {
    "German Excel": text(GERMAN, ";").encode("cp1252"),
    "German Excel, numbers with points": text([*GERMAN[:4], *cells(extra=("ja",))], ";").encode("cp1252"),
    "French Excel": text(FRENCH, ";").encode("cp1252"),
    "English Excel": text(ENGLISH, ",").encode("utf-8-sig"),
    "separator named": ("sep=;\r\n" + text(GERMAN, ";")).encode("utf-8-sig"),
    "Unicode text": text(FRENCH, "\t").encode("utf-16"),
    "the same names over loads and outputs": text([*TWICE, *cells(comma=True)], ";").encode(),
    "a line of words under the header": text(
        [GERMAN[2], GERMAN[3], ["", "", "Normalkraft", "Rollmoment", "", "", ""], *cells(comma=True, extra=("",))], ";"
    ).encode("cp1252"),
    "header of two lines a cell": (
        'Series,Point,"N1\n[N]","RM\n[N*m]","rN1\n[mV/V]","rRM\n[mV/V]"\n' + text(cells(), ",", "\n")
    ).encode(),
    "commas in quotes": (
        "Serie,Punkt,N1 [N],RM [Nm],rN1 [mV/V],rRM [mV/V]\n"
        + text([[f'"{cell}"' for cell in row] for row in cells(comma=True)], ",", "\n")
    ).encode(),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_what_laboratories_write_comes_in(tmp_path, dialect):
    check(read_schedule(put(tmp_path, DIALECTS[dialect])))


def test_what_is_passed_over_is_said(tmp_path):
    notes = "; ".join(read_schedule(put(tmp_path, DIALECTS["German Excel"])).assumptions)
    assert "columns that are not used: 'Bemerkung'" in notes
    assert "lines without readings are passed over: 9 ('Ende der Kalibrierung')" in notes
    notes = "; ".join(read_schedule(put(tmp_path, DIALECTS["a line of words under the header"])).assumptions)
    assert "line 3 below the header holds no number and is passed over: 'Normalkraft; Rollmoment'" in notes


def test_a_series_named_once_holds_for_the_rows_below(tmp_path):
    rows = [[of if i % 2 == 0 else "", *row[1:]] for i, (of, row) in enumerate(zip(SERIES, cells(), strict=True))]
    schedule = read_schedule(put(tmp_path, text([ENGLISH[0][:6], *rows], ",")))
    check(schedule)
    assert any("2 rows do not name their series" in note for note in schedule.assumptions)


def test_points_that_come_twice_in_a_series_get_their_line(tmp_path):
    rows = [["S1", "1", *row[2:]] for row in cells()]
    schedule = read_schedule(put(tmp_path, text([ENGLISH[0][:6], *rows], ",")))
    assert schedule.points == ("1 (line 2)", "1 (line 3)", "1 (line 4)", "1 (line 5)")


def test_rows_are_marked_by_words(tmp_path):
    rows = [[*row, mark] for row, mark in zip(cells(comma=True), ("", "ja", "nein", "x"), strict=True)]
    header = [*GERMAN[2][:6], "Bestätigungspunkt"]
    schedule = read_schedule(put(tmp_path, text([header, [*GERMAN[3][:6], ""], *rows], ";").encode("cp1252")))
    assert schedule.confirmation.tolist() == [False, True, False, True]


WRONG = {
    "series blank": (
        text([ENGLISH[0][:6], ["", *cells()[0][1:]]], ","),
        ["line 2, column 1 ('Load Series')", "a word or a number"],
    ),
    "no unit": (
        text([["Serie", "Punkt", "N1", "rN1"], ["a", "1", "2", "3"]], ";"),
        ["column 3 ('N1')", "has no unit", "row of units", "channel map"],
    ),
    "two units": (
        text([["N1 [N]", "rN1 [mV/V]"], ["kN", "mV/V"], ["2", "3"]], ";"),
        ["line 1, column 1", "'kN'", "one unit a column"],
    ),
    "word for a number": (
        text([ENGLISH[0][:6], [*cells()[0][:2], "about 5", *cells()[0][3:]]], ","),
        ["line 2, column 3 ('N1 [N]')", "'about 5' is no number"],
    ),
    "points and commas": (
        text([GERMAN[2], GERMAN[3], *cells(comma=True, extra=("",)), ["S1", "9", "1.234,5", "0", "1", "1", ""]], ";"),
        ["line 7, column 3", "'1.234,5' is no number", "thousands"],
    ),
    "load without its output": (
        text([["N1 [N]", "rN1 [mV/V]", "N2 [N]"], ["1", "2", "3"], ["1", "2", "3"]], ";"),
        ["column 3 ('N2 [N]')", "neither a load with an output rN2"],
    ),
    "mark that is none": (
        text([["N1 [N]", "rN1 [mV/V]", "Bestätigung"], ["1", "2", "vielleicht"]], ";"),
        ["line 2, column 3", "'vielleicht'", "0 and 1"],
    ),
}


@pytest.mark.parametrize("kind", WRONG)
def test_what_cannot_be_taken_says_where_and_what(tmp_path, kind):
    content, said = WRONG[kind]
    with pytest.raises(ReadError) as caught:
        read_schedule(put(tmp_path, content))
    for words in ("schedule.csv", *said):
        assert words in str(caught.value)


def test_the_example_of_the_documentation_reads(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "files.md").read_text()
    example = page[page.index("Kalibrierung Waage") :].partition("```")[0]
    schedule = read_schedule(put(tmp_path, example.encode("cp1252")))
    assert schedule.series_names == ("S1", "Mx pos")
    np.testing.assert_allclose(schedule.loads, [[100.5, 0], [0, 12.5]])
    np.testing.assert_allclose(schedule.outputs, [[0.51, 0.002], [0.003, 0.25]])


# ------------------------------------------------------------------------------------------------ channel map

MAP = """
[file]
header_line = 2

[channels.series]
column = "Bezeichnung"

[channels.point]
column = 2

[channels.N1]
column = "Kanal A"
unit = "kN"
scale = 0.001

[channels.RM]
column = "Kanal B"
unit = "N*m"
sign = -1

[channels.rN1]
column = "Kanal C"
unit = "mV"
excitation = 10.0

[channels.rRM]
column = "Kanal D"
unit = "mV/V"
shunt_expected = 1.0
shunt_measured = 2.0
"""


def mapped_rows() -> list[list[str]]:
    """Loads in N, with RM turned; outputs in mV at 10 V, and as a bridge reads that a shunt shows to read double."""
    rows = [["Kalibrierung"], ["Bezeichnung", "lfd", "Kanal A", "Kanal B", "Kanal C", "Kanal D"]]
    for row, load, output in zip(cells(), LOADS, OUTPUTS, strict=True):
        rows.append([*row[:2], *(f"{x:.8g}" for x in (load[0], -load[1], output[0] * 10, output[1] * 2))])
    return rows


def test_a_channel_map_says_which_column_is_what(tmp_path):
    from aerobalance.io.channel_map import SHUNT_REFUSED

    assert SHUNT_REFUSED < 0.5  # so the map below is made milder: a shunt that reads 10 % more
    rows = mapped_rows()
    for row in rows[2:]:
        row[5] = f"{float(row[5]) / 2 * 1.1:.8g}"
    path = put(tmp_path, text(rows, ";").replace(".", ","))
    chosen = load_channel_map(put(tmp_path, MAP.replace("measured = 2.0", "measured = 1.1"), "map.toml"))
    check(read_schedule(path, channel_map=chosen))


def test_a_map_finds_its_header_by_its_columns(tmp_path):
    """Without header_line, the header is the first line that has all columns of the map."""
    rows = mapped_rows()
    chosen = MAP.replace("header_line = 2", "").replace("shunt_expected = 1.0", "scale = 0.5")
    path = put(tmp_path, text([["Kanal A"], ["2025"], *rows], ";"))
    map_path = put(tmp_path, chosen.replace("shunt_measured = 2.0", ""), "map.toml")
    check(read_schedule(path, channel_map=load_channel_map(map_path)))


WRONG_MAPS = {
    "column not there": (MAP.replace("Kanal C", "Kanal X"), ["there is no column 'Kanal X'", "'Kanal C'"]),
    "load without output": (MAP.replace("channels.rRM", "channels.rYM"), ["channels.RM", "an output rRM"]),
    "setting of a recording": (MAP.replace("sign = -1", "delay = 0.1"), ["channels.RM.delay", "is for recordings"]),
    "no pairs": ('[channels.series]\ncolumn = "Bezeichnung"\n', ["no load and its output"]),
}


@pytest.mark.parametrize("kind", WRONG_MAPS)
def test_a_map_that_does_not_fit_says_what_is_wrong(tmp_path, kind):
    content, said = WRONG_MAPS[kind]
    content = content.replace("measured = 2.0", "measured = 1.1")
    path = put(tmp_path, text(mapped_rows(), ";"))
    with pytest.raises(ReadError) as caught:
        read_schedule(path, channel_map=load_channel_map(put(tmp_path, content, "map.toml")))
    for words in said:
        assert words in str(caught.value)


# ------------------------------------------------------------------------------------------------ workbooks


def workbook(path: Path, *, sheets: tuple[str, ...] = ("Kalibrierung",)) -> Path:
    """Write what a laboratory keeps in Excel: a title, the series in merged cells, units below the header."""
    openpyxl = pytest.importorskip("openpyxl", reason="the extra excel is not installed")
    book = openpyxl.Workbook()
    book.active.title = "Deckblatt"
    book.active.append(["Kalibrierung der Waage", None, 2025])
    for name in sheets:
        sheet = book.create_sheet(name)
        sheet.append(["Kalibrierung der Waage"])
        sheet.append([])
        sheet.append(["Serie", "Punkt", "N1", "RM", "rN1", "rRM", "Bemerkung"])
        sheet.append([None, None, "N", "Nm", "mV/V", "mV/V"])
        for i, (load, output) in enumerate(zip(LOADS, OUTPUTS, strict=True)):
            first = SERIES[i] if i in (0, 2) else None
            point = int(POINTS[i]) if POINTS[i].isdecimal() else POINTS[i]
            sheet.append([first, point, *load.tolist(), *output.tolist()])
        sheet.merge_cells("A5:A6")
        sheet.merge_cells("A7:A8")
    book.save(path)
    return path


def test_a_workbook_comes_in_with_all_digits(tmp_path):
    schedule = read_schedule(workbook(tmp_path / "schedule.xlsx"))
    check(schedule)
    np.testing.assert_array_equal(schedule.outputs, OUTPUTS)


def test_a_map_names_the_sheet(tmp_path):
    path = workbook(tmp_path / "schedule.xlsx", sheets=("2024", "2025"))
    with pytest.raises(ReadError, match=r"sheets '2024' and '2025'.*sheet = "):
        read_schedule(path)
    columns = "\n".join(
        f'[channels.{name}]\ncolumn = "{column}"'
        for name, column in {"series": "Serie", "point": "Punkt", **{n: n for n in ("N1", "RM", "rN1", "rRM")}}.items()
    )
    chosen = load_channel_map(put(tmp_path, f'[file]\nsheet = "2025"\n{columns}\n', "map.toml"))
    check(read_schedule(path, channel_map=chosen))
    wrong = load_channel_map(put(tmp_path, f'[file]\nsheet = "2023"\n{columns}\n', "map.toml"))
    with pytest.raises(ReadError, match=r"sheet '2023': is not there; the file has 'Deckblatt', '2024', '2025'"):
        read_schedule(path, channel_map=wrong)


def test_a_missing_library_is_named_with_the_command(tmp_path, monkeypatch):
    path = workbook(tmp_path / "schedule.xlsx")
    real = builtins.__import__

    def without(name, *arguments, **settings):
        if name.partition(".")[0] == "openpyxl":
            raise ImportError(name)
        return real(name, *arguments, **settings)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ReadError, match=r"pip install 'aerobalance\[excel\]'"):
        read_schedule(path)


def test_archives_that_are_no_workbook_are_refused(tmp_path):
    pytest.importorskip("openpyxl", reason="the extra excel is not installed")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("readme.txt", "nothing")
    whole = workbook(tmp_path / "whole.xlsx").read_bytes()
    for content in (packed.getvalue(), whole[: len(whole) // 2], b"PK\x03\x04 and nothing more"):
        with pytest.raises(ReadError, match="no Excel workbook that can be read"):
            read_schedule(put(tmp_path, content, "damaged.xlsx"))
    with pytest.raises(ReadError, match=r"save it as \.xlsx or as CSV"):
        read_schedule(put(tmp_path, b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(100), "old.xls"))


def test_a_workbook_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    pytest.importorskip("openpyxl", reason="the extra excel is not installed")
    path = workbook(tmp_path / "schedule.xlsx")
    monkeypatch.setattr("aerobalance.io.sheet_cells.MOST_BYTES", 1000)
    with pytest.raises(ReadError, match="unpacks to"):
        read_schedule(path)


def test_a_map_that_is_proposed_for_a_schedule_keeps_its_series_and_points(tmp_path):
    rows = [["Waage Süd"], ["Serie", "Punkt", "F1 [N]", "Mx [Nm]", "DMS 1 [mV/V]", "DMS 2 [mV/V]"]]
    path = put(tmp_path, text([*rows, *cells(comma=True)], ";").encode("cp1252"))
    proposed = template(path)
    assert "A load schedule needs none" in proposed
    # what a person does: the names of loads and outputs, and the signs before their lines
    waiting = ["series", "point", "column_3", "column_4", "column_5", "column_6"]
    for waits, name in zip(waiting, ("series", "point", "N1", "RM", "rN1", "rRM"), strict=True):
        head, found, rest = proposed.partition(f"# [channels.{waits}]")
        assert found, waits
        proposed = f"{head}[channels.{name}]{rest.replace('# column', 'column', 1).replace('# unit', 'unit', 1)}"
    put(tmp_path, proposed, "map.toml")
    check(read_schedule(path, channel_map=load_channel_map(tmp_path / "map.toml")))
    # its file, as `read` takes it
    check(read_schedule(path, channel_map=tmp_path / "map.toml"))
    check(read_schedule(str(path), channel_map=str(tmp_path / "map.toml")))
