"""Readers of calibration load schedules: files built here, every number known by construction."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aerobalance.app.cli import main
from aerobalance.io import read
from aerobalance.io.load_columns import balance_type_of, load_key
from aerobalance.io.schedule import read_schedule, write_balfit_schedule
from aerobalance.recording.errors import DataQualityWarning, FitError, ReadError
from aerobalance.recording.units import conversion
from seeds import trials

POUND = 0.45359237 * 9.80665  # international pound (1959) and standard gravity (1901), both exact
INCH = 0.0254
INCH_POUND = INCH * POUND
RTOL = 1e-14  # a handful of multiplications and divisions, each rounded to 1.1e-16
REAL = Path(__file__).parents[3] / "shared" / "data" / "internal-balance"

BRIDGES = ("N1", "N2", "Y1", "Y2", "Ax", "Roll")
TITLES = ("N1", "N2", "Y1", "Y2", "Ax", "Mx")
LOADS = (0.0, 10.0, 20.0, 5.0, 0.0)
MAXIMA = "N1--> 100 lb\nN2--> 100 lb\nY1--> 50 lb\nY2--> 50 lb\nAx--> 25 lb\nMx--> 50 in-lb\n"
DISTANCES = "".join(
    f"Distance from {name} to center of Balance {symbol} in inches--> {value}\n"
    for name, symbol, value in (("N1", "x1", 1.5), ("N2", "x2", 1.75), ("Y1", "y1", 1.25), ("Y2", "y2", 1.125))
)
FORWARD = (1.5, 1.75, 1.25, 1.125)


def outputs_of(block, row):
    """Outputs [mV/V] that stand in a row of a block: different everywhere."""
    return np.array([(block + 1) * 0.01 + row * 0.003 + bridge * 0.1 for bridge in range(6)])


def excitation_of(row):
    return 9.75 + 0.0625 * row


def block_rows(block, *, sign=1, loads=LOADS, volts=True, excitation=True):
    rows = []
    for row, load in enumerate(loads):
        supply = excitation_of(row)
        cells = outputs_of(block, row) * (supply / 1000 if volts else 1)
        rows.append([sign * load, *cells, *([supply] if excitation else [])])
    return rows


def header_cells(names=BRIDGES, *, unit="lb", output="Volt", excitation="Exct.[Volt]"):
    return [f"Load[{unit}]", *[f"{name}[{output}]" for name in names], *([excitation] if excitation else [])]


def vol(
    *,
    titles=TITLES,
    names=BRIDGES,
    separator=", ",
    maxima=MAXIMA,
    distances=DISTANCES,
    kind="5 Force/1 Moment",
    count="Number of Loads--> {n}",
    end="",
    units=None,
    header=None,
    sign=None,
    loads=LOADS,
    signs=(("pos", 1), ("neg", -1)),
    **rows,
):
    """Text of a whole file; `sign` overrides the signs of the loads."""
    text = "Voltage Calibration File 3.1\nDate--> 31. Dezember\n\n[Balance Description]\n"
    text += f"Balance Type--> {kind}\nBalance Serial Number--> 7\n\n[Maximal Balance Loads]\n{maxima}\n"
    text += f"[Distances]\n{distances}\n\n"
    number = 0
    for title in titles:
        unit = (units or {}).get(title, "in-lb" if title in ("Mx", "Roll") else "lb")
        for word, factor in signs:
            used = factor if sign is None else sign
            text += f"[{title} {word}]{end}\n" + count.format(n=len(loads)) + f"{end}\n"
            cells = header(unit) if header else header_cells(names, unit=unit)
            text += separator.join(cells) + end + "\n"
            for row in block_rows(number, sign=used, loads=loads, **rows):
                text += separator.join(repr(float(cell)) for cell in row) + end + "\n"
            number += 1
    return text


def put(tmp_path, content, *, encoding="utf-8", name="schedule.vol"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
    return path


def expected_outputs():
    return np.array([outputs_of(block, row) for block in range(12) for row in range(len(LOADS))])


def check_whole(schedule, *, components=BRIDGES):
    assert schedule.components == components
    assert schedule.gauges == components
    assert schedule.series_names == tuple(f"{title} {word}" for title in TITLES for word in ("pos", "neg"))
    np.testing.assert_array_equal(schedule.series, np.repeat(np.arange(12), len(LOADS)))
    factors = np.array([POUND] * 5 + [INCH_POUND])
    loads = np.zeros((12 * len(LOADS), 6))
    for block in range(12):
        here = slice(block * len(LOADS), (block + 1) * len(LOADS))
        loads[here, block // 2] = np.array(LOADS) * (1, -1)[block % 2] * factors[block // 2]
    np.testing.assert_allclose(schedule.loads, loads, rtol=RTOL)
    np.testing.assert_allclose(schedule.outputs, expected_outputs(), rtol=RTOL)
    np.testing.assert_allclose(schedule.capacities, np.array([100, 100, 50, 50, 25, 50]) * factors, rtol=RTOL)
    np.testing.assert_array_equal(schedule.moments, [False] * 5 + [True])
    assert schedule.natural_zeros.shape == (0, 6)
    assert not schedule.confirmation.any()


def test_vol_gives_what_it_holds(tmp_path):
    schedule = read_schedule(put(tmp_path, vol()))
    check_whole(schedule)
    assert schedule.name == "schedule.vol"
    assert schedule.load_units == ("lb",) * 5 + ("in-lb",)
    assert schedule.balance_type == "force"
    geometry = schedule.geometry
    found = [geometry.forward_normal, geometry.aft_normal, geometry.forward_side, geometry.aft_side]
    np.testing.assert_allclose(found, np.array(FORWARD) * INCH, rtol=RTOL)
    assert schedule.assumptions == ()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("separator", [", ", ",", ";", "\t"])
@pytest.mark.parametrize("end", ["", "\r", ",,", "\t"])
def test_vol_in_any_encoding_and_separator(tmp_path, encoding, separator, end):
    if separator != "\t" and end == "\t":
        end = separator.strip() * 3
    text = vol(separator=separator, end=end if end == "\r" or not end else separator.strip(" ") * 2)
    check_whole(read_schedule(put(tmp_path, text.replace("31. Dezember", "März"), encoding=encoding)))


@pytest.mark.parametrize("separator", [";", "\t"])
def test_vol_with_decimal_commas(tmp_path, separator):
    head, blocks = vol(separator=separator).split("\n[N1 pos]", 1)
    check_whole(read_schedule(put(tmp_path, head + "\n[N1 pos]" + blocks.replace("Exct.", "Exct").replace(".", ","))))


@pytest.mark.parametrize("count", ["Number of Loads -->{n}", "number of loads-->   {n}", "Number of Loads-->{n}", ""])
def test_vol_count_may_be_written_in_many_ways(tmp_path, count):
    check_whole(read_schedule(put(tmp_path, vol(count=count))))


def test_vol_with_a_wrong_count_uses_the_rows(tmp_path):
    text = vol().replace("Number of Loads--> 5", "Number of Loads--> 7", 1)
    with pytest.warns(DataQualityWarning, match=r"\[N1 pos\].*says '7' loads and has 5 row"):
        check_whole(read_schedule(put(tmp_path, text)))


def test_vol_columns_without_names_go_by_position(tmp_path):
    text = vol(header=lambda unit: [f"Load[{unit}]", *[f"ch{i}[Volt]" for i in range(7)]])
    schedule = read_schedule(put(tmp_path, text))
    check_whole(schedule, components=TITLES)
    assert any("order in which the blocks first appear" in note for note in schedule.assumptions)


def test_vol_columns_without_names_in_doubtful_order(tmp_path):
    titles = ("N2", "N1", "Y1", "Y2", "Ax", "Mx")
    text = vol(titles=titles, header=lambda unit: [f"Load[{unit}]", *[f"ch{i}[Volt]" for i in range(7)]])
    with pytest.warns(DataQualityWarning, match="another order"):
        schedule = read_schedule(put(tmp_path, text))
    assert schedule.components == titles


def test_vol_columns_without_names_and_a_missing_block_go_by_the_maximal_loads(tmp_path):
    titles = ("N1", "N2", "Y2", "Ax", "Mx")
    text = vol(titles=titles, header=lambda unit: [f"Load[{unit}]", *[f"ch{i}[Volt]" for i in range(7)]])
    schedule = read_schedule(put(tmp_path, text))
    assert schedule.components == TITLES
    assert (schedule.loads[:, 2] == 0).all()
    assert (schedule.loads[:, 3] != 0).any()
    assert any("no block loads Y1" in note for note in schedule.assumptions)


@pytest.mark.parametrize(
    ("titles", "maxima"),
    [
        (("n1", "n2", "y1", "y2", "AX", "MX"), MAXIMA),
        (("N_1", "N-2", "S1", "S2", "Axial", "Roll"), MAXIMA),
        (("N1", "N2", "Y1", "Y2", "AxialForce", "RM"), MAXIMA.replace("Mx", "Roll").replace("Ax", "Axial Force")),
        (("N1", "N2", "Y1", "Y2", "AF", "l"), MAXIMA.replace("N1", "N_1").replace("Y1", "Y_1")),
        (TITLES, "".join(f"load {i}--> {line.split('-->')[1]}\n" for i, line in enumerate(MAXIMA.splitlines()))),
    ],
)
def test_vol_names_are_matched_by_what_they_mean(tmp_path, titles, maxima):
    units = {titles[5]: "in-lb"}
    schedule = read_schedule(put(tmp_path, vol(titles=titles, maxima=maxima, units=units)))
    assert schedule.components == BRIDGES
    assert [np.flatnonzero(schedule.loads[i * 10 + 1])[0] for i in range(6)] == list(range(6))
    np.testing.assert_allclose(schedule.capacities[[2, 4, 5]], [50 * POUND, 25 * POUND, 50 * INCH_POUND], rtol=RTOL)


def test_vol_blocks_of_unknown_names_go_by_order(tmp_path):
    titles = ("N1", "N2", "Y1", "Y2", "Alpha", "Beta")
    schedule = read_schedule(put(tmp_path, vol(titles=titles, units={"Beta": "in-lb"})))
    assert schedule.components == BRIDGES
    assert schedule.moments.tolist() == [False] * 5 + [True]
    assert any("[Alpha] to Ax" in note for note in schedule.assumptions)


def test_vol_blocks_in_any_order_find_their_column(tmp_path):
    schedule = read_schedule(put(tmp_path, vol(titles=tuple(reversed(TITLES)))))
    assert schedule.components == BRIDGES
    assert [np.flatnonzero(schedule.loads[i * 10 + 1])[0] for i in range(6)] == [5, 4, 3, 2, 1, 0]


def test_vol_columns_in_another_order_in_one_block(tmp_path):
    text = vol()
    rows = text.split("\n")
    start = rows.index("[N2 pos]")
    for i in range(start + 2, start + 3 + len(LOADS)):
        cells = rows[i].split(", ")
        rows[i] = ", ".join([cells[0], *reversed(cells[1:7]), cells[7]])
    check_whole(read_schedule(put(tmp_path, "\n".join(rows))))


def test_vol_moment_balance(tmp_path):
    names = ("Aft_Pitch", "Aft_Yaw", "Fwd_Pitch", "Fwd_Yaw", "Ax", "Roll")
    titles = ("Aft Pitch", "aft yaw", "FWD Pitch", "Fwd_Yaw", "Axial", "Mx")
    units = dict.fromkeys(titles, "in-lb") | {"Axial": "lb"}
    maxima = "".join(f"{name}--> {10 + i} {'lb' if name == 'Ax' else 'in-lb'}\n" for i, name in enumerate(names))
    distances = "".join(
        f"Distance from {name} to center of Balance x1 in mm--> {value}\n"
        for name, value in zip(names[:4], (31, 32, 33, 34), strict=True)
    )
    text = vol(titles=titles, names=names, units=units, maxima=maxima, distances=distances, kind="1 Force/5 Moment")
    schedule = read_schedule(put(tmp_path, text))
    assert schedule.components == names
    assert schedule.balance_type == "moment"
    assert schedule.moments.tolist() == [True] * 4 + [False, True]
    geometry = schedule.geometry
    found = [geometry.aft_normal, geometry.aft_side, geometry.forward_normal, geometry.forward_side]
    np.testing.assert_allclose(found, [0.031, 0.032, 0.033, 0.034], rtol=RTOL)
    np.testing.assert_allclose(schedule.capacities[0], 10 * INCH_POUND, rtol=RTOL)
    np.testing.assert_allclose(schedule.capacities[4], 14 * POUND, rtol=RTOL)


def test_vol_balance_type_against_the_units(tmp_path):
    with pytest.warns(DataQualityWarning, match="1 of the 6 loads are moments"):
        schedule = read_schedule(put(tmp_path, vol(kind="1 Force/5 Moment")))
    assert schedule.balance_type == "force"


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("in", INCH), ("inches", INCH), ("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("inch", INCH)],
)
def test_vol_distances_in_the_unit_that_the_text_says(tmp_path, unit, factor):
    schedule = read_schedule(put(tmp_path, vol(distances=DISTANCES.replace("inches", unit))))
    assert schedule.geometry.aft_normal == pytest.approx(1.75 * factor, rel=RTOL)


def test_vol_without_distances_says_so(tmp_path):
    schedule = read_schedule(put(tmp_path, vol(distances="")))
    assert schedule.geometry is None
    assert any("distances of the gauges" in note for note in schedule.assumptions)


def test_vol_load_unit_against_name_and_maximal_load(tmp_path):
    text = vol().replace("Load[in-lb]", "Load[lb]", 1)
    with pytest.warns(DataQualityWarning, match=r"\[Mx pos\] has its loads in \[lb\], but Roll is a moment"):
        check_whole(read_schedule(put(tmp_path, text)))


def test_vol_blocks_without_header_take_that_of_the_block_before(tmp_path):
    first, rest = vol().split("[N1 neg]")
    text = first + "[N1 neg]" + "\n".join(line for line in rest.split("\n") if not line.startswith("Load"))
    with pytest.warns(DataQualityWarning, match="has no header"):
        check_whole(read_schedule(put(tmp_path, text)))
    with pytest.raises(ReadError, match=r"\[N1 pos\] has no header"):
        read_schedule(put(tmp_path, "\n".join(line for line in vol().split("\n") if not line.startswith("Load"))))


def test_vol_columns_of_which_some_have_names(tmp_path):
    text = vol(header=lambda unit: header_cells(("N1", "N2", "Y1", "ch3", "Ax", "Roll"), unit=unit))
    schedule = read_schedule(put(tmp_path, text))
    check_whole(schedule)
    assert any("[Y2] to ch3" in note for note in schedule.assumptions)


def test_vol_with_tabs_that_only_align(tmp_path):
    check_whole(read_schedule(put(tmp_path, vol(separator=",\t"))))


@pytest.mark.parametrize("unit", ["in-lb", "in-lbs", "in.lb", "in. lbs", "lb-in", "IN-LB", "inlb", "in lb", "lbs-in"])
def test_spellings_of_inch_pounds(unit):
    assert conversion(unit, expected="N*m").factor == pytest.approx(INCH_POUND, rel=RTOL)


@pytest.mark.parametrize("unit", ["lb", "lbs", "lbf", "LB", "Lbs", "lb.", "pounds"])
def test_spellings_of_pounds(unit):
    assert conversion(unit, expected="N").factor == pytest.approx(POUND, rel=RTOL)


@pytest.mark.parametrize(
    ("line", "capacity", "note"),
    [
        ("Mx--> 50 in-lb", 50, None),
        ("Mx--> 50 in-lbs,", 50, None),
        ("Mx--> 1,250 lb-in", 1250, None),
        ("Mx--> 50", 50, "without a unit"),
        ("Mx--> 50 lb", 50, "unit of its loads"),
        ("Mx--> 50 parrots", 50, "unit of its loads"),
        ("Mx--> ", 20, "its largest load"),
        ("Mx--> in-lb", 20, "its largest load"),
        ("Mx--> 0 in-lb", 20, "its largest load"),
        ("", 20, "its largest load"),
    ],
)
def test_vol_capacities_that_are_odd_or_missing(tmp_path, line, capacity, note):
    schedule = read_schedule(put(tmp_path, vol(maxima=MAXIMA.replace("Mx--> 50 in-lb", line))))
    assert schedule.capacities[5] == pytest.approx(capacity * INCH_POUND, rel=RTOL)
    assert [note in said for said in schedule.assumptions] == ([] if note is None else [True])


def test_capacities_of_the_caller_go_first(tmp_path):
    path = put(tmp_path, vol())
    schedule = read_schedule(path, capacities={"Roll": (60.0, "in-lb"), "axial": (100.0, "N")})
    np.testing.assert_allclose(schedule.capacities[4:], [100, 60 * INCH_POUND], rtol=RTOL)
    for wrong, said in (({"Q": (1.0, "N")}, "'Q'"), ({"N1": (1.0, "N*m")}, "N1"), ({"N1": (0.0, "N")}, "positive")):
        with pytest.raises(ValueError, match=said):
            read_schedule(path, capacities=wrong)


def test_vol_magnitudes_in_neg_blocks_are_negative(tmp_path):
    schedule = read_schedule(put(tmp_path, vol(sign=1)))
    check_whole(schedule)
    assert sum("lists magnitudes" in note for note in schedule.assumptions) == 6


def test_vol_signs_that_contradict_the_title_are_doubted(tmp_path):
    text = vol()
    start = text.split("\n").index("[Y1 pos]")
    rows = text.split("\n")
    rows[start + 4] = "-" + rows[start + 4]
    with pytest.warns(DataQualityWarning, match=rf"\[Y1 pos\] mixes signs \(line\(s\) {start + 5}\)"):
        check_whole(read_schedule(put(tmp_path, "\n".join(rows))))
    rows = text.split("\n")
    start = rows.index("[Y1 neg]")
    rows[start + 4] = rows[start + 4].removeprefix("-")
    with pytest.warns(DataQualityWarning, match=rf"\[Y1 neg\] mixes signs \(line\(s\) {start + 5}\)"):
        check_whole(read_schedule(put(tmp_path, "\n".join(rows))))
    with pytest.warns(DataQualityWarning, match=r"\[\w+ pos\] lists negative loads"):
        check_whole(read_schedule(put(tmp_path, vol(signs=(("pos", -1), ("neg", -1))))))


def test_vol_blocks_of_the_same_name_are_series_of_their_own(tmp_path):
    schedule = read_schedule(put(tmp_path, vol(signs=(("pos", 1), ("pos", 1), ("neg", -1)))))
    assert schedule.series_names[:3] == ("N1 pos", "N1 pos", "N1 neg")
    assert schedule.series.max() == 17


def test_vol_outputs_that_are_ratios_already(tmp_path):
    text = vol(
        header=lambda unit: header_cells(unit=unit, output="mV/V", excitation=None), volts=False, excitation=False
    )
    check_whole(read_schedule(put(tmp_path, text)))


BAD_VOL = {
    "no excitation": (
        vol(header=lambda unit: header_cells(unit=unit, excitation=None), excitation=False),
        ["line 25", "no column of the excitation", "mV/V"],
    ),
    "zero excitation": (
        vol().replace(repr(excitation_of(2)), "0.0"),
        ["line 28", "excitation is 0 V", "1 row(s)"],
    ),
    "text in a row": (vol().replace(repr(excitation_of(2)), "n/a"), ["line 28, column 8", "'n/a'", "numbers such as"]),
    "text for a load": (
        vol().replace("\n10.0, ", "\nten, "),
        ["line 27, column 1 ('Load[lb]')", "'ten' is no number", "[N1 pos]"],
    ),
    "short row": (vol().replace(f", {excitation_of(1)!r}", "", 1), ["line 27", "7 cell(s)", "8"]),
    "long row": (vol().replace(f", {excitation_of(1)!r}", ", 1, 2", 1), ["line 27", "9 cell(s)", "8"]),
    "no blocks": (vol().split("[N1 pos]", maxsplit=1)[0], ["no block of loads", "[N1 pos]"]),
    "load in volts": (vol(units={"N1": "Volt"}), ["line 25, column 1", "[Volt]", "neither a force nor a moment"]),
    "bridge in pounds": (
        vol(header=lambda unit: header_cells(unit=unit, output="lb")),
        ["line 25, column 2 ('N1[lb]')", "a voltage"],
    ),
    "force and moment": (
        vol(maxima=MAXIMA.replace("N1--> 100 lb", "N1--> 100")).replace("Load[lb]", "Load[in-lb]", 1),
        ["line 33", "[lb]", "other blocks of N1", "[in-lb]"],
    ),
    "too many components": (vol(titles=(*TITLES, "Q")), ["7 components", "6 bridges"]),
}


@pytest.mark.parametrize("kind", BAD_VOL)
def test_vol_that_cannot_be_read_says_where_and_what(tmp_path, kind):
    text, said = BAD_VOL[kind]
    with pytest.raises(ReadError) as caught:
        read_schedule(put(tmp_path, text))
    for words in ("schedule.vol", *said):
        assert words in str(caught.value)


def test_vol_cut_off_uses_what_is_complete(tmp_path):
    whole = vol()
    rows = whole.rstrip("\n").split("\n")
    for keep in (len(rows[-1]) // 2, len(rows[-1]) - len(repr(excitation_of(4))) + 1):
        text = "\n".join([*rows[:-1], rows[-1][:keep]])
        with pytest.warns(DataQualityWarning, match=r"\[Mx neg\].*cut off"):
            schedule = read_schedule(put(tmp_path, text))
        np.testing.assert_allclose(schedule.outputs, expected_outputs()[:-1], rtol=RTOL)
    with pytest.warns(DataQualityWarning, match="has no rows of numbers"):
        schedule = read_schedule(put(tmp_path, "\n".join(rows[:-5])))
    assert schedule.series_names[-1] == "Mx pos"


def test_vol_without_a_final_line_end_is_whole(tmp_path):
    check_whole(read_schedule(put(tmp_path, vol().rstrip("\n"))))


def test_vol_component_without_a_block(tmp_path):
    schedule = read_schedule(put(tmp_path, vol(titles=("N1", "N2", "Y1", "Ax", "Mx"))))
    assert schedule.components == BRIDGES
    assert (schedule.loads[:, 3] == 0).all()
    assert any("no block loads Y2" in note for note in schedule.assumptions)


# ------------------------------------------------------------------------------------------------ BALFIT

SYMBOLS = ("N1", "N2", "S1", "S2", "RM", "AF")
UNITS = ("lbs", "lbs", "lbs", "lbs", "in-lbs", "lbs")
FACTORS = np.array([POUND] * 4 + [INCH_POUND, POUND])
CAPACITIES = (2500, 2500, 1250, 1250, 5000, 700)


def balfit_numbers(points=4, c=6):
    loads = np.array([[(i + 1) * 10.5 - 3.25 * j for j in range(c)] for i in range(points)])
    outputs = np.array([[(i + 1) * 7.125 + 100 * j for j in range(c)] for i in range(points)])
    return loads, outputs


def balfit(
    *,
    symbols=SYMBOLS,
    units=UNITS,
    capacities=CAPACITIES,
    names=("P-0001", "P-0002", "CP-0001", "C-0002"),
    series=("1", "1", "7", "3"),
    zero_of=("A", "A", "A", "A"),
    zeros=(("A", "0", 1.0), ("A", "90", 3.0)),
    temperature=None,
    lead=("",),
    title="MC60-E (5F1M)",
):
    c = len(symbols)
    loads, outputs = balfit_numbers(len(names), c)
    before = [*lead, "", "", ""]
    at = None if temperature is None else temperature[0]

    def row(prefix, first, second, heat=""):
        cells = [*first, *second]
        if at is not None:
            cells.insert(at, heat)
        return ",".join([*prefix, *[str(cell) for cell in cells]])

    lines = [
        ";; comment,,,,",
        "FILE_TYPE,DATA_FOR_ITERATIVE_REGRESSION_ANALYSIS,,,",
        f'BALANCE_NAME,"{title}"',
        "DESCRIPTION,text, with commas",
        ",,,,,",
        '"; load and output symbols"',
        row(before, symbols, [f"r{name}" for name in symbols], "T") + ",,",
        "; units",
        row(before, units, ["microV/V"] * c, temperature[1] if temperature else ""),
        "",
        row(before, capacities, [""] * c),
    ]
    for group, roll, value in zeros:
        lines.append(row([*lead, "NZ-01", group, roll], [""] * c, [value + j for j in range(c)]))
    lines.append(";,Point ID,Series1,Series2,N1")
    for i, name in enumerate(names):
        heat = temperature[2][i] if temperature else ""
        lines.append(row([*lead, name, series[i], zero_of[i]], loads[i], outputs[i], heat))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("lead", [("",), ()])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_balfit_gives_what_it_holds(tmp_path, lead, encoding):
    schedule = read_schedule(put(tmp_path, balfit(lead=lead), encoding=encoding, name="b.csv"))
    loads, outputs = balfit_numbers()
    assert schedule.components == schedule.gauges == SYMBOLS
    np.testing.assert_allclose(schedule.loads, loads * FACTORS, rtol=RTOL)
    np.testing.assert_allclose(schedule.outputs, outputs * 1e-3, rtol=RTOL)
    np.testing.assert_allclose(schedule.capacities, np.array(CAPACITIES) * FACTORS, rtol=RTOL)
    zeros = np.array([[1.0 + j for j in range(6)], [3.0 + j for j in range(6)]])
    np.testing.assert_allclose(schedule.natural_zeros, zeros * 1e-3, rtol=RTOL)
    assert schedule.series.tolist() == [0, 0, 1, 2]
    assert schedule.series_names == ("1", "7", "3")
    assert schedule.points == ("P-0001", "P-0002", "CP-0001", "C-0002")
    assert schedule.confirmation.tolist() == [False, False, True, True]
    assert schedule.moments.tolist() == [False] * 4 + [True, False]
    assert schedule.load_units == UNITS
    assert schedule.balance_type == "force"
    assert schedule.temperature is None
    assert schedule.assumptions == ()


@pytest.mark.parametrize(
    ("symbols", "units", "kind"),
    [
        (("PM1", "PM2", "YM1", "YM2", "RM", "AF"), (*["in-lbs"] * 5, "lbs"), "moment"),
        (("NF", "PM", "SF", "YM", "RM", "AF"), ("N", "N*m", "N", "N*m", "N*m", "N"), "direct"),
        (("NF", "PM", "AF"), ("N", "N*m", "N"), "direct"),
        (("AF",), ("N",), "unknown"),
    ],
)
def test_balfit_sets_of_any_size_and_kind(tmp_path, symbols, units, kind):
    text = balfit(symbols=symbols, units=units, capacities=[100] * len(symbols), title="a balance")
    schedule = read_schedule(put(tmp_path, text))
    assert schedule.components == symbols
    assert schedule.balance_type == kind
    assert schedule.moments.tolist() == ["*m" in unit or unit == "in-lbs" for unit in units]


def test_balfit_name_is_only_a_hint(tmp_path):
    hinted = read_schedule(put(tmp_path, balfit(symbols=("RM", "AF"), units=("N*m", "N"), capacities=(1, 1))))
    assert hinted.balance_type == "force"
    against = read_schedule(put(tmp_path, balfit(title="3F3M")))
    assert against.balance_type == "force"
    assert any("hints at a direct balance" in note for note in against.assumptions)


@pytest.mark.parametrize("at", [0, 6, 12])
@pytest.mark.parametrize(
    ("unit", "values"), [("degC", "20 21.5 0 30"), ("degF", "68 70.7 32 86"), ("K", "293.15 294.65 273.15 303.15")]
)
def test_balfit_temperature_anywhere_in_any_unit(tmp_path, at, unit, values):
    schedule = read_schedule(put(tmp_path, balfit(temperature=(at, unit, values.split()))))
    # differences of numbers of some hundred, rounded to 6e-14
    np.testing.assert_allclose(schedule.temperature, [20, 21.5, 0, 30], atol=2e-13)
    np.testing.assert_allclose(schedule.outputs, balfit_numbers()[1] * 1e-3, rtol=RTOL)
    np.testing.assert_allclose(schedule.loads, balfit_numbers()[0] * FACTORS, rtol=RTOL)


def test_balfit_points_of_two_natural_zeros_share_the_first(tmp_path):
    zeros = (("A", "0", 1.0), ("A", "90", 3.0), ("A", "180", 77.0), ("B", "90", 13.5), ("B", "0", 11.0))
    schedule = read_schedule(put(tmp_path, balfit(zeros=zeros, zero_of=("A", "B", "A", "B"))))
    # over the roll angles 0 and 90 that both have, A averages 2 and B 12.25
    moved = balfit_numbers()[1] + np.array([0, 2 - 12.25, 0, 2 - 12.25])[:, None]
    np.testing.assert_allclose(schedule.outputs, moved * 1e-3, rtol=RTOL)
    assert schedule.natural_zeros.shape == (3, 6)
    assert any("'B' are moved onto those of 'A'" in note for note in schedule.assumptions)


@pytest.mark.parametrize(
    ("zeros", "said"),
    [((("A", "0", 1.0), ("B", "90", 9.0)), "no roll angle in common"), ((("A", "0", 1.0),), "not in the file")],
)
def test_balfit_natural_zeros_that_do_not_compare_are_doubted(tmp_path, zeros, said):
    with pytest.warns(DataQualityWarning, match=said):
        schedule = read_schedule(put(tmp_path, balfit(zeros=zeros, zero_of=("A", "B", "A", "A"))))
    np.testing.assert_allclose(schedule.outputs, balfit_numbers()[1] * 1e-3, rtol=RTOL)


def test_balfit_without_capacities_takes_the_largest_load(tmp_path):
    rows = balfit().split("\n")
    text = "\n".join(row for row in rows if not row.startswith(",,,,2500"))
    schedule = read_schedule(put(tmp_path, text))
    np.testing.assert_allclose(schedule.capacities, np.abs(balfit_numbers()[0] * FACTORS).max(axis=0), rtol=RTOL)
    assert sum("largest load" in note for note in schedule.assumptions) == 6
    assert "lbf called N make all forces of a run 4.4 times too small" in schedule.assumptions[-1]


def test_balfit_cut_off_uses_what_is_complete(tmp_path):
    text = balfit()
    with pytest.warns(DataQualityWarning, match="cut off"):
        schedule = read_schedule(put(tmp_path, text[:-30]))
    np.testing.assert_allclose(schedule.outputs, balfit_numbers()[1][:-1] * 1e-3, rtol=RTOL)


BAD_BALFIT = {
    "no symbols": ("FILE_TYPE,X\nBALANCE_NAME,Y\n", ["no row of symbols", "N1,N2"]),
    "symbols only": ("FILE_TYPE,X\n,,,,N1,rN1\n", ["after the row of symbols", "units"]),
    "load without output": (balfit().replace("rS2", "rQ"), ["line 7", "S2", "rQ", "without their other half"]),
    "symbol twice": (balfit().replace("S2,RM", "S1,RM"), ["line 7", "'S1'", "columns 7 and 8"]),
    "unknown unit": (balfit().replace("in-lbs", "furlong"), ["line 9 (units), column 9", "[furlong]"]),
    "unit missing": (balfit().replace("in-lbs", ""), ["line 9 (units), column 9", "neither a force nor a moment"]),
    "output in volts": (balfit().replace("microV/V", "V", 1), ["line 9 (units), column 11", "a gauge output"]),
    "negative capacity": (balfit().replace("5000", "-5000"), ["line 11 (capacities), column 9 (RM)", "positive"]),
    "text in a point": (balfit().replace("10.5", "x1", 1), ["column 5 (N1)", "'x1' is no number"]),
    "hole in a point": (balfit().replace("10.5", "", 1), ["column 5 (N1)", "'' is no number"]),
    "point without name": (balfit().replace("P-0002", ""), ["line 16, column 2", "has no name"]),
    "no points": (balfit().split(",P-0001", maxsplit=1)[0], ["no points", "P-0001"]),
}


@pytest.mark.parametrize("kind", BAD_BALFIT)
def test_balfit_that_cannot_be_read_says_where_and_what(tmp_path, kind):
    text, said = BAD_BALFIT[kind]
    with pytest.raises(ReadError) as caught:
        read_schedule(put(tmp_path, text, name="b.csv"))
    for words in ("b.csv", *said):
        assert words in str(caught.value)


def test_balfit_written_and_read_again_is_the_same(tmp_path, rng):
    text = balfit(temperature=(12, "degC", ["20.5", "21", "22", "19"]))
    for number in np.unique(balfit_numbers()[0]):
        text = text.replace(f",{number},", f",{rng.normal() * 10.0 ** rng.integers(-6, 6):.15g},")
    first = read_schedule(put(tmp_path, text))
    write_balfit_schedule(tmp_path / "one.csv", first)
    second = read_schedule(tmp_path / "one.csv")
    write_balfit_schedule(tmp_path / "two.csv", second)
    # 15 digits survive the change of unit and back: three roundings of 1.1e-16 are less than half of 1e-15
    bodies = [(tmp_path / name).read_text().split("\n", 2)[2] for name in ("one.csv", "two.csv")]
    assert bodies[0] == bodies[1]
    # a rounding to 15 digits, at most 5e-15 relative, and that of the units
    for field in ("loads", "outputs", "natural_zeros", "capacities", "temperature"):
        np.testing.assert_allclose(getattr(second, field), getattr(first, field), rtol=6e-15)
    for field in ("components", "gauges", "series_names", "points", "load_units", "balance_type"):
        assert getattr(second, field) == getattr(first, field)
    for field in ("series", "confirmation", "moments"):
        np.testing.assert_array_equal(getattr(second, field), getattr(first, field))


def test_vol_written_as_balfit_keeps_its_numbers(tmp_path):
    first = read_schedule(put(tmp_path, vol()))
    write_balfit_schedule(tmp_path / "one.csv", first)
    second = read_schedule(tmp_path / "one.csv")
    for field in ("loads", "outputs", "capacities"):
        np.testing.assert_allclose(getattr(second, field), getattr(first, field), rtol=6e-15)
    np.testing.assert_array_equal(second.series, first.series)
    assert second.components == first.components
    assert "; series 2 is N1 neg" in (tmp_path / "one.csv").read_text()


# ------------------------------------------------------------------------------------------------ plain tables


def test_table_gives_what_it_holds(tmp_path):
    text = (
        "point [1],series [1],N1 [lbf],RM [in-lb],rN1 [uV/V],rRM [mV/V],natural_zero,confirmation,temperature [degF]\n"
        ",,,,10,0.25,1,,\n"
        "11,5,100,-2,125,0.5,0,0,68\n"
        "12,5,50,4,250,0.75,0,1,32\n"
        "13,2,-200,1,500,1.5,0,0,86\n"
    )
    schedule = read_schedule(put(tmp_path, text, name="t.csv"))
    assert schedule.components == schedule.gauges == ("N1", "RM")
    np.testing.assert_allclose(
        schedule.loads,
        [[100 * POUND, -2 * INCH_POUND], [50 * POUND, 4 * INCH_POUND], [-200 * POUND, INCH_POUND]],
        rtol=RTOL,
    )
    np.testing.assert_allclose(schedule.outputs, [[0.125, 0.5], [0.25, 0.75], [0.5, 1.5]], rtol=RTOL)
    np.testing.assert_allclose(schedule.natural_zeros, [[0.01, 0.25]], rtol=RTOL)
    np.testing.assert_allclose(schedule.temperature, [20, 0, 30], atol=1e-13)
    np.testing.assert_allclose(schedule.capacities, [200 * POUND, 4 * INCH_POUND], rtol=RTOL)
    assert schedule.series.tolist() == [0, 0, 1]
    assert schedule.series_names == ("5", "2")
    assert schedule.points == ("11", "12", "13")
    assert schedule.confirmation.tolist() == [False, True, False]
    assert schedule.moments.tolist() == [False, True]
    assert schedule.balance_type == "force"
    given = read_schedule(tmp_path / "t.csv", capacities={"N1": (300.0, "lbf")})
    np.testing.assert_allclose(given.capacities, [300 * POUND, 4 * INCH_POUND], rtol=RTOL)


def test_table_in_volts_needs_the_excitation(tmp_path):
    text = "NF [N];rNF [mV];excitation [V]\n1,5;20;10\n3;40;8\n"
    schedule = read_schedule(put(tmp_path, text))
    np.testing.assert_allclose(schedule.outputs, [[2], [5]], rtol=RTOL)
    np.testing.assert_allclose(schedule.loads, [[1.5], [3]], rtol=RTOL)
    assert schedule.balance_type == "direct"
    assert schedule.series_names == ("1",)
    assert any("one series" in note for note in schedule.assumptions)


BAD_TABLE = {
    "no pairs": (
        "time [s],AF [N]\n0,1\n",
        ["header", "line 1 has 'time [s]; AF [N]'", "rNAME", "channel_map", ".vol"],
    ),
    "output in volts": ("AF [N],rAF [mV]\n1,2\n", ["column 2", "a gauge output", "excitation [V]"]),
    "zero excitation": ("AF [N],rAF [mV],excitation [V]\n1,2,5\n1,2,0\n", ["line 3", "excitation is 0 V"]),
    "load missing": ("AF [N],rAF [mV/V]\n1,2\n,2\n", ["line 3, column 1", "missing"]),
    "output missing": ("AF [N],rAF [mV/V]\n1,2\n3,\n", ["line 3, column 2", "missing"]),
    "load in volts": ("AF [V],rAF [mV/V]\n1,2\n", ["column 1", "neither a force nor a moment"]),
    "flag of two": ("AF [N],rAF [mV/V],confirmation\n1,2,2\n", ["line 2, column 3", "0 and 1"]),
    "zeros only": ("AF [N],rAF [mV/V],natural_zero\n,2,1\n", ["natural zeros only"]),
    "column twice": ("AF [N],AF [lbf],rAF [mV/V]\n1,2,3\n", ["column 2", "already"]),
    "prose": ("Dear reader\n\nnothing here\n", ["header", "line 1 has 'Dear reader'", "rN1", ".vol"]),
    "empty": ("", ["is empty"]),
    "temperature in m": ("AF [N],rAF [mV/V],temperature [m]\n1,2,2\n", ["column 3", "a temperature"]),
}


@pytest.mark.parametrize("kind", BAD_TABLE)
def test_table_that_cannot_be_read_says_where_and_what(tmp_path, kind):
    text, said = BAD_TABLE[kind]
    with pytest.raises(ReadError) as caught:
        read_schedule(put(tmp_path, text, name="t.csv"))
    for words in ("t.csv", *said):
        assert words in str(caught.value)


def test_files_that_are_none(tmp_path):
    for path in (tmp_path / "none.vol", tmp_path, put(tmp_path, bytes(range(256)) * 4)):
        with pytest.raises(ReadError):
            read_schedule(path)


def test_names_of_the_same_load():
    same = [
        ("AF", "Ax", "axial", "AxialForce", "Axial Force", "A"),
        ("RM", "Mx", "Roll", "rolling_moment", "l"),
        ("Y1", "S1", "s_1"),
        ("Aft_Pitch", "Aft Pitch", "aftpitch", "PM2", "rear pitch"),
        ("Fwd_Yaw", "Forward yaw moment", "YM1", "FWD-YAW"),
        ("NF", "Normal Force", "n"),
    ]
    keys = [{load_key(name) for name in names} for names in same]
    assert [len(key) for key in keys] == [1] * len(same)
    assert len(set.union(*keys)) == len(same)
    assert balance_type_of(("N1", "N2", "Y1", "Y2", "Ax", "Mx")) == "force"
    assert balance_type_of(("N1", "PM2")) == "unknown"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "cp1252"])
@pytest.mark.parametrize("content", [vol(), balfit()], ids=["vol", "balfit"])
def test_a_schedule_that_is_read_as_a_recording_is_named(tmp_path, content, encoding, capsys):
    path = put(tmp_path, content, encoding=encoding, name="schedule.csv")
    with pytest.raises(ReadError, match="is a load schedule and no recording; aerobalance calibrate"):
        read(path)
    assert main(["info", str(path)]) == 2
    assert "aerobalance calibrate" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------ damage

TABLE = "series,N1 [lbf],rN1 [uV/V],excitation [V],confirmation\n1,10,125,10,0\n1,20,250,10,1\n2,-5,-60,10,0\n"
DAMAGED = {
    "vol": vol().encode(),
    "vol16": vol().encode("utf-16"),
    "balfit": balfit().encode(),
    "table": TABLE.encode(),
}


@pytest.mark.parametrize("kind", DAMAGED)
@settings(max_examples=trials(50, 150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_ends_in_an_error_or_a_schedule(tmp_path, kind, data):
    content = DAMAGED[kind]
    how = data.draw(st.sampled_from(["cut", "flip", "lines", "cells"]))
    if how == "cut":
        content = content[: data.draw(st.integers(0, len(content)))]
    elif how == "flip":
        changed = bytearray(content)
        for _ in range(data.draw(st.integers(1, 4))):
            changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
        content = bytes(changed)
    elif how == "lines":
        lines = content.split(b"\n")
        gone = data.draw(st.sets(st.integers(0, len(lines) - 1), min_size=1, max_size=30))
        content = b"\n".join(line for i, line in enumerate(lines) if i not in gone)
    else:
        pieces = content.split(b",")
        at = data.draw(st.integers(0, len(pieces) - 1))
        pieces[at] = data.draw(st.sampled_from([b"", b"1e400", b"-1e99", b"1e-320", b'"', b"nan", b"[", b"->", b";"]))
        content = b",".join(pieces)
    path = put(tmp_path, content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", DataQualityWarning)
        try:
            schedule = read_schedule(path)
        except (ReadError, FitError):
            return
    assert schedule.outputs.shape == schedule.loads.shape
    assert len(schedule.points) > 0


# ------------------------------------------------------------------------------------------------ a real file


@pytest.mark.skipif(
    not (REAL / "100lb_2025-06.vol").exists(), reason="the real calibration is not beside the checkout"
)
def test_real_file_has_the_structure_that_one_sees():
    schedule = read_schedule(REAL / "100lb_2025-06.vol")
    assert schedule.components == BRIDGES
    assert schedule.series_names == tuple(f"{title} {word}" for title in TITLES for word in ("pos", "neg"))
    np.testing.assert_allclose(
        schedule.capacities, np.array([100, 100, 50, 50, 25, 50]) * ([POUND] * 5 + [INCH_POUND]), rtol=RTOL
    )
    assert schedule.moments.tolist() == [False] * 5 + [True]
    assert schedule.balance_type == "force"
    assert schedule.geometry.forward_normal == pytest.approx(1.5 * INCH, rel=RTOL)
