"""The test file: what is allowed in it, and what belongs to each run by table, pattern, number and date."""

from __future__ import annotations

import re
from pathlib import Path

import fsspec
import pytest

from aerobalance.app.campaign.assignment import assigned, definition_of_folder
from aerobalance.app.campaign.definition import definition_from, load_definition
from aerobalance.app.campaign.run_table import cell, read_rows
from aerobalance.recording.errors import ReadError

SETUP = [{"dynamics": "dynamics.json"}]


def touched(folder: Path, *names: str) -> Path:
    for name in names:
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text("time [s],AF [N]\n")
    return folder


def runs_of(folder: Path, **contents: object):
    return assigned(definition_from({"setups": SETUP, **contents}), str(folder))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[runs]\nfile = 'a'\n[[setups]]\n", "runs.file: is not known; did you mean files?"),
        ("[[setups]]\n", "runs: is missing"),
        ("[runs]\nfiles = '*.h5'\n", "setups: is missing"),
        ("[runs]\n[[setups]]\n", "needs files"),
        ("[runs]\nfiles = '*.h5'\npattern = 'run_(\\d+)'\n[[setups]]\n", "must have named groups"),
        ("[runs]\nfiles = '*.h5'\npattern = '(?P<a'\n[[setups]]\n", "must be a regular expression"),
        ("[runs]\nfiles = '*.h5'\n[[setups]]\n[reference]\narea = 1.0\nchord = 1.0\n", "reference.span: is missing"),
        (
            "[runs]\nfiles = '*.h5'\n[[setups]]\n[reference]\narea = 1.0\nchord = 1.0\nspan = 1.0\n",
            r"coefficients need \[pressure\]",
        ),
        ("[runs]\nfiles = '*.h5'\n[[setups]]\n[pressure]\nvalue = 1.0\ncolumn = 'q'\n", "needs one of value"),
        ("[runs]\nfiles = '*.h5'\n[[setups]]\n[zeros]\nuse = 'first'\n", "zeros.use: must be 'before', 'around' or"),
        ("[runs]\nfiles = '*.h5'\n[[setups]]\n[spectrum]\nbands = [[10, 1]]\n", "must be pairs of frequencies in Hz"),
        ("[runs]\nfiles = '*.h5'\n[[setups]]\n[axes]\nmoment_centre = [0, 1]\n", "must be three numbers"),
        (
            "[runs]\nfiles = '*.h5'\n[[setups]]\n[repeats]\nby = ['alpha']\ntolerance = {alfa = 0.05}\n",
            r"repeats: tolerance is given for alfa, .* for one of by \(alpha\), or add alfa to by",
        ),
        ("[runs]\nfiles = '*.h5'\n[[setups]]\n[repeats]\ntolerance = {mach = 0.01}\n", r"by \(alpha, beta\)"),
        ("[runs]\nfiles = '*.h5'\n[[setups]]\nfrom = '201'\n", "must be a date such as .* without quotes"),
        ("[runs\n", "is no TOML"),
    ],
)
def test_a_wrong_key_is_named_with_what_is_allowed(tmp_path, text, said):
    file = tmp_path / "test.toml"
    file.write_text(text)
    with pytest.raises(ReadError, match=said):
        load_definition(file)


def test_names_of_files_give_columns_and_the_order(tmp_path):
    touched(tmp_path, "r/run_10_a-2.5.h5", "r/run_9_a4.h5", "r/note.txt")
    runs = runs_of(tmp_path, runs={"files": "r/*.h5", "pattern": r"run_(?P<run>\d+)_a(?P<alpha>[-.\d]+)\.h5"})
    assert [(one.name, one.columns) for one in runs] == [
        ("run_9_a4", {"run": 9, "alpha": 4}),
        ("run_10_a-2.5", {"run": 10, "alpha": -2.5}),
    ]
    assert {one.dynamics for one in runs} == {str(tmp_path / "dynamics.json")}


def test_a_table_gives_columns_units_and_files_of_its_own(tmp_path):
    touched(tmp_path, "r/one.h5", "r/two.h5", "z.h5", "z2.h5")
    (tmp_path / "runs.csv").write_text(
        "file;alpha [rad];q [kPa];zero;model\nr/one.h5;0,5;1,25;z.h5|z2.h5;big wing\nr/two.h5;0;2;;\n"
    )
    one, two = runs_of(tmp_path, runs={"table": "runs.csv"}, zeros={})
    assert one.columns["alpha"] == pytest.approx(28.64788975654116)  # 0.5 rad
    assert (one.columns["q"], one.columns["model"]) == (1250.0, "big wing")
    assert one.zeros == (str(tmp_path / "z.h5"), str(tmp_path / "z2.h5"))
    assert (two.columns["q"], two.zeros) == (2000.0, ())


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("alpha,q\n1,2\n", "line 1: has no column file"),
        ("file,q\na.h5,1,2\n", "line 2: has 3 cells; the header has 2"),
        ("file,q [furlong]\na.h5,1\n", r"q has unit \[furlong\]; allowed: Pa"),
        ("file,q\n,1\n", "line 2: names no file"),
        ("file,file\n", "two columns of one name"),
        ("file,alpha\na.h5,2\nb.h5,1e999\n", r"line 3: column alpha has 1e999, which is no number up to 1e\+100"),
        ("file;q [kPa]\na.h5;-2,5\nb.h5;1e99\n", "line 3: column q has 1e99, which is no number"),  # in Pa
        ("file,polar\na.h5,-1e400\n", "line 2: column polar has -1e400, which is no number"),
        ("", "is empty"),
    ],
)
def test_a_table_that_cannot_be_read_says_the_line(tmp_path, table, said):
    file = tmp_path / "runs.csv"
    file.write_text(table)
    with pytest.raises(ReadError, match=said):
        read_rows(str(file))


@pytest.mark.parametrize("value", [float("inf"), float("nan"), -1e200])
def test_a_number_without_end_is_refused_where_it_stands(tmp_path, value):
    touched(tmp_path, "a.h5", "b_1e999.h5")
    rows = [{"file": "a.h5", "alpha": 1e100}, {"file": "b_1e999.h5", "alpha": value}]
    with pytest.raises(
        ReadError,
        match=rf"runs\.rows\[1\]: column alpha has {re.escape(str(value))}, which is no number up to 1e\+100",
    ):
        runs_of(tmp_path, runs={"rows": rows})
    runs = {"files": "*.h5", "pattern": r"_(?P<alpha>[e\d]+)\.h5"}
    with pytest.raises(ReadError, match=r"b_1e999\.h5: its name: column alpha has 1e999, which is no number"):
        runs_of(tmp_path, runs=runs)


def test_set_ups_hold_from_a_run_a_date_or_for_a_column(tmp_path):
    touched(tmp_path, "a.h5", "b.h5", "c.h5")
    rows = [
        {"file": "a.h5", "run": 1, "date": "2026-03-01", "config": "clean"},
        {"file": "b.h5", "run": 2, "date": "2026-03-12T10:15", "config": "flaps"},
        {"file": "c.h5", "run": 3, "date": "2026-04-01", "config": "clean"},
    ]
    setups = [
        {"dynamics": "d.json", "balance": "first.json"},
        {"from": 3, "balance": "third.json"},
        {"from": "2026-03-12", "map": "march.toml"},
        {"where": {"config": "flaps"}, "dynamics": "flaps.json", "axes": {"moment_centre": [1, 2, 3]}},
    ]
    found = runs_of(tmp_path, runs={"rows": rows}, setups=setups)
    short = [tuple(Path(str(place)).name for place in (one.dynamics, one.balance, one.channel_map)) for one in found]
    assert short == [
        ("d.json", "first.json", "None"),
        ("flaps.json", "first.json", "march.toml"),
        ("d.json", "third.json", "march.toml"),
    ]
    assert [one.setup for one in found] == [0, 3, 2]
    assert found[1].axes.moment_centre == (1, 2, 3)


@pytest.mark.parametrize(
    ("since", "row", "holds"),
    [
        (2, {"run": 2}, True),
        (2, {"Run": 2}, "from run 2 on, and this run has no number"),
        (2, {"run": "2b"}, "from run 2 on, and this run has no number"),
        # 10:30 in Berlin is half an hour before 09:00 UTC, 12:30 there an hour and a half after it
        ("2026-03-12T09:00Z", {"date": "2026-03-12T10:30+02:00"}, False),
        ("2026-03-12T09:00Z", {"date": "2026-03-12T12:30+02:00"}, True),
        ("2026-03-12T09:00", {"date": "2026-03-13"}, True),
        ("2026-03-12T09:00", {"date": "2026-03-12"}, "give the time too"),
        ("2026-03-12T09:00", {"date": "2026-03-12T10:00Z"}, "both with a time zone, or none"),
        ("2026-03-12", {"date": "2026-03-12T00:05"}, True),
        ("2026-03-12", {"date": "12.03.2026"}, "must be a date such as"),
        ("2026-03-12", {"date": 20260312}, "this run has no date"),
        ("2026-03-12", {}, "this run has no date"),
    ],
)
def test_a_set_up_holds_from_then_on_or_the_run_says_why_that_cannot_be_told(tmp_path, since, row, holds):
    touched(tmp_path, "a.h5")
    setups = [{"dynamics": "first.json"}, {"from": since, "dynamics": "second.json"}]
    (found,) = runs_of(tmp_path, runs={"rows": [{"file": "a.h5", **row}]}, setups=setups)
    if isinstance(holds, str):
        assert holds in found.fault
    else:
        assert (found.fault, Path(found.dynamics).stem) == ("", "second" if holds else "first")


def test_a_set_up_for_a_column_that_no_run_has_is_refused(tmp_path):
    touched(tmp_path, "a.h5")
    setups = [{"dynamics": "d.json"}, {"where": {"confg": "flaps"}, "dynamics": "flaps.json"}]
    with pytest.raises(ReadError, match=r"setups\[1\].where: names confg, .* there are: config"):
        runs_of(tmp_path, runs={"rows": [{"file": "a.h5", "config": "flaps"}]}, setups=setups)


def test_repeats_by_a_column_that_no_run_has_are_refused(tmp_path):
    touched(tmp_path, "a.h5")
    rows = [{"file": "a.h5", "mach": 0.3}]
    with pytest.raises(ReadError, match=r"repeats\.by: names Mach, which no run has as a column; there are: mach"):
        runs_of(tmp_path, runs={"rows": rows}, repeats={"by": ["alpha", "Mach"]})
    # angles may be those of the recording, and a result is a column of each run
    assert runs_of(tmp_path, runs={"rows": rows}, repeats={"by": ["alpha", "beta", "mach", "pressure_Pa"]})


def test_zeros_are_the_last_before_a_run_those_around_it_or_those_that_agree(tmp_path):
    touched(tmp_path, *(f"run_{n}.h5" for n in (2, 5, 9)), *(f"zero_{n}.h5" for n in (1, 4, 8)))
    runs = {"files": "run_*.h5", "pattern": r"run_(?P<run>\d+)"}
    zeros = {"files": "zero_*.h5", "pattern": r"zero_(?P<run>\d+)"}

    def found(**more: object) -> list[tuple[list[str], list[str]]]:
        every = runs_of(tmp_path, runs=runs, zeros={**zeros, **more})
        return [([Path(z).stem for z in one.zeros], [Path(z).stem for z in one.zeros_after]) for one in every]

    assert found() == [(["zero_1"], []), (["zero_4"], []), (["zero_8"], [])]
    assert found(use="around") == [(["zero_1"], ["zero_4"]), (["zero_4"], ["zero_8"]), (["zero_8"], [])]
    assert found(use="all")[0] == (["zero_1", "zero_4", "zero_8"], [])
    assert [one[0] for one in found(match=["run"])] == [[], [], []]


def test_a_run_without_its_zero_has_the_reason_and_the_others_go_on(tmp_path):
    touched(tmp_path, "run_1.h5", "run_3.h5", "zero_2.h5", "zero_9.h5")
    runs = {"files": "run_*.h5", "pattern": r"run_(?P<run>\d+)"}
    first, third = runs_of(tmp_path, runs=runs, zeros={"files": "zero_*.h5", "pattern": r"zero_(?P<run>\d+)"})
    assert first.fault == "there is no zero before run 1"
    assert not third.fault
    (one, _) = runs_of(tmp_path, runs={"files": "run_*.h5"}, zeros={"files": "zero_*.h5"})
    assert one.fault.startswith("2 zeros could be meant: say which")
    (one, _) = runs_of(tmp_path, runs={"files": "run_*.h5"}, setups=[{"balance": "b.json"}])
    assert one.fault.startswith("no dynamics are given")


def test_what_names_nothing_is_refused(tmp_path):
    touched(tmp_path, "a.h5", "b/a.h5", "c/a.h5", "x/b/a.h5", "y/b/a.h5")
    with pytest.raises(ReadError, match=r"no file is named by \*\.tdms"):
        runs_of(tmp_path, runs={"files": "*.tdms"})
    with pytest.raises(ReadError, match="no file is a run"):
        runs_of(tmp_path, runs={"files": "a.h5", "exclude": "a.h5"})
    for name in ("status", "setup", "CL", "u_run_CPM_wind", "balance_NF_N"):
        with pytest.raises(ReadError, match=f"a column cannot be called {name}: results have one"):
            runs_of(tmp_path, runs={"rows": [{"file": "a.h5", name: 1}]})
    (one,) = runs_of(tmp_path, runs={"rows": [{"file": "a.h5", "alpha_deg": 1}]}, angles={"alpha": "alpha_deg"})
    assert one.columns["alpha_deg"] == 1  # the result's own is the same then
    assert [one.name for one in runs_of(tmp_path, runs={"files": ["b/a.h5", "c/a.h5"]})] == ["b_a.h5", "c_a.h5"]
    with pytest.raises(ReadError, match="would both be called"):
        runs_of(tmp_path, runs={"files": ["x/b/a.h5", "y/b/a.h5"]})


def test_a_folder_is_all_of_its_recordings(tmp_path):
    touched(tmp_path, "b.csv", "a.h5", "notes.md", "dynamics.json", ".hidden")
    definition = definition_of_folder(str(tmp_path), "dynamics.json")
    assert [one.name for one in assigned(definition, str(tmp_path))] == ["a", "b"]
    with pytest.raises(ReadError, match="holds no recordings"):
        definition_of_folder(str(touched(tmp_path / "empty", "notes.md")), "dynamics.json")


def test_brackets_in_names_are_no_patterns_where_such_files_are(tmp_path):
    folder = touched(tmp_path / "polar [1]", "run[2].h5", "run2.h5", "run3.h5")
    definition = definition_of_folder(str(folder), "d.json")
    found = [Path(one.file).name for one in assigned(definition, str(folder))]
    assert sorted(found) == ["run2.h5", "run3.h5", "run[2].h5"]
    chosen = runs_of(folder, runs={"files": "run[23].h5"})
    assert [Path(one.file).name for one in chosen] == ["run2.h5", "run3.h5"]
    store = fsspec.filesystem("memory")
    for path in folder.iterdir():
        store.pipe_file(f"/polar [1]/{path.name}", b"")
    definition = definition_of_folder("memory://polar [1]", "d.json")
    assert len(assigned(definition, "memory://polar [1]")) == 3
    for path in folder.iterdir():
        store.rm_file(f"/polar [1]/{path.name}")


def test_runs_whose_names_become_alike_are_told_apart_or_refused(tmp_path):
    for name in ("a/run 1.csv", "b/run_1.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    files = ["a/run 1.csv", "b/run_1.csv"]
    assert [one.name for one in runs_of(tmp_path, runs={"files": files})] == ["a_run_1.csv", "b_run_1.csv"]
    (tmp_path / "a/run_1.csv").touch()
    with pytest.raises(ReadError, match=r"would both be called a_run_1\.csv"):
        runs_of(tmp_path, runs={"files": [*files, "a/run_1.csv"]})


@pytest.mark.parametrize(
    ("text", "value"), [("12_3", "12_3"), ("nan", "nan"), ("-1.5e3", -1500.0), ("007", 7), (".5", 0.5)]
)
def test_a_number_in_a_table_is_what_an_engineer_writes(text, value):
    assert cell(text) == value


def test_the_name_of_a_file_is_no_number(tmp_path):
    table = tmp_path / "runs.csv"
    table.write_text("file,config\n0012,0012\n")
    ((_, cells),) = read_rows(str(table))
    assert cells == {"file": "0012", "config": 12}


def test_a_unit_that_is_not_known_stays_in_the_name_of_its_column(tmp_path):
    table = tmp_path / "runs.csv"
    table.write_text("file,pdyn [kN/m^2],p [kPa]\na.csv,2.0,3.0\n")
    ((_, cells),) = read_rows(str(table))
    assert cells == {"file": "a.csv", "pdyn [kN/m^2]": 2.0, "p": 3000.0}
