"""Points that are left out of a calibration, and what is said of points that do not fit."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.balance.calibration.fit import calibrate
from aerobalance.balance.calibration.fit_warnings import warn_of_weaknesses
from aerobalance.balance.calibration.quality import assess
from aerobalance.balance.calibration.regression import regress
from aerobalance.balance.schedule import Schedule
from aerobalance.recording.errors import DataQualityWarning

SENSITIVITY = np.array([[0.01, 0.002], [-0.001, 0.05]])
"""Outputs over loads [mV/V/N, mV/V/(N*m)]."""

NOISE = 1e-4
WRONG = 0.05
"""Noise of a reading, and what one reading is wrong by [mV/V]."""


def rows(*, noise: float, wrong: float) -> list[list[str]]:
    """Two series of single loads, up and down on both sides; the reading of rN1 at "RM series 3" is wrong."""
    generator = np.random.default_rng(20260101)
    table = []
    for series, column in (("N1 series", 0), ("RM series", 1)):
        for i, share in enumerate((0, 0.5, 1, 0.5, 0, -0.5, -1, -0.5, 0)):
            load = np.zeros(2)
            load[column] = share * (100, 20)[column]
            output = SENSITIVITY @ load + generator.normal(0, noise, 2)
            if (series, i) == ("RM series", 2):
                output[0] += wrong
            table.append([series, str(i + 1), *(f"{value:.17g}" for value in (*load, *output))])
    return table


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    header = "series,point,N1 [N],RM [N*m],rN1 [mV/V],rRM [mV/V]"
    lines = [header, *(",".join(row) for row in rows(noise=NOISE, wrong=WRONG))]
    Path("schedule.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def run(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> tuple[dict[str, object], str]:
    found = main([*arguments, "--json"])
    captured = capsys.readouterr()
    assert found == code, captured.err
    return json.loads(captured.out) if captured.out else {}, captured.err


def deviation(account: dict[str, object]) -> float:
    return account["components"]["N1"]["residual_std_percent_of_capacity"]


def test_the_warning_gives_the_words_that_leave_a_point_out(here, capsys):
    account, said = run(capsys, "calibrate", "schedule.csv", "--model", "linear")
    assert 'left out with --leave-out "RM series 3"' in said
    assert account["outliers"][0]["label"] == "RM series 3"
    assert account["left_out"] == []
    better, said = run(
        capsys,
        *("calibrate", "schedule.csv", "--model", "linear", "--leave-out", "RM series 3"),
        *("-o", "balance.json", "--report", "report.html"),
    )
    assert "--leave-out" not in said
    assert better["left_out"] == ["RM series 3"]
    assert better["points"] == account["points"] - 1
    assert better["outliers"] == []
    # the noise over the output at capacity, 1 mV/V; 18 points leave their deviation a sixth of itself uncertain
    assert deviation(better) == pytest.approx(100 * NOISE / (SENSITIVITY[0, 0] * 100), rel=0.6)
    assert deviation(account) > 10 * deviation(better)
    artefact = json.loads(Path("balance.json").read_text())
    assert artefact["left_out"] == ["RM series 3"]
    assert artefact["provenance"]["settings"]["leave_out"] == ["RM series 3"]
    page = Path("report.html").read_text()
    assert "left out as asked" in page
    assert "as asked: RM series 3." in page


def test_what_was_left_out_is_said_to_people(here, capsys):
    assert main(["calibrate", "schedule.csv", "--model", "linear", "--leave-out", " rm  SERIES 3"]) == 0
    assert "left out as asked (1 point): RM series 3" in capsys.readouterr().out


def test_names_that_are_none_list_those_that_are_near(here, capsys):
    for given, near in (("RM serie 3", "'RM series 3'"), ("rm series", None), ("quite other", "'N1 series'")):
        code = main(["calibrate", "schedule.csv", "--leave-out", given, "--model", "linear"])
        said = capsys.readouterr().err
        if near is None:
            assert code == 1  # a whole series: RM is never loaded then
            assert "RM is never loaded" in said
        else:
            assert code == 2
            assert f"no point and no series {given!r}" in said
            assert near in said
    assert main(["calibrate", "schedule.csv", "--leave-out", "N1 series", "--leave-out", "RM series"]) == 2
    assert "no point is left" in capsys.readouterr().err


def schedule(*, noise: float = NOISE, wrong: float = WRONG) -> Schedule:
    table = rows(noise=noise, wrong=wrong)
    numbers = np.array([[float(cell) for cell in row[2:]] for row in table])
    return Schedule(
        name="stand",
        components=("N1", "RM"),
        gauges=("N1", "RM"),
        loads=numbers[:, :2],
        outputs=numbers[:, 2:],
        series=np.repeat([0, 1], 9),
        series_names=("N1 series", "RM series"),
        points=tuple(row[1] for row in table),
        capacities=np.array([100.0, 20.0]),
        moments=np.array([False, True]),
        load_units=("N", "N*m"),
        natural_zeros=np.zeros((0, 2)),
        confirmation=np.zeros(18, dtype=bool),
        temperature=np.linspace(20, 21, 18),
    )


def test_a_schedule_without_some_points_keeps_the_others_as_they_are():
    whole = schedule()
    less = whole.without(["N1 series", "RM series 9"])
    assert less.series_names == ("RM series",)
    assert less.series.tolist() == [0] * 8
    assert less.points == tuple("12345678")
    np.testing.assert_array_equal(less.outputs, whole.outputs[9:17])
    np.testing.assert_array_equal(less.temperature, whole.temperature[9:17])
    assert less.left_out == (*(f"N1 series {i}" for i in range(1, 10)), "RM series 9")
    assert whole.without([]) is whole


def test_a_name_of_a_series_and_of_a_point_is_refused():
    points = [*"12345678", "X 9", *"123456789"]
    named = replace(schedule(), series_names=("X", "X 9"), points=tuple(points))
    with pytest.raises(ValueError, match="name of a series and of a point"):
        named.without(["X 9"])
    assert named.without(["X 9 9"]).left_out == ("X 9 9",)
    assert named.without(["X X 9"]).left_out == ("X 9",)


def test_a_point_that_fits_to_the_last_digit_without_one_reading_is_said_without_infinity():
    """Without noise the others leave nothing: the deviation is a rounding error, and its multiples mean nothing."""
    calibration = calibrate(schedule(noise=0.0, wrong=0.01), model="linear")
    quality = assess(calibration)
    assert quality.outliers[0].label == "RM series 3"
    assert quality.outliers[0].deviations is None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        warn_of_weaknesses(calibration, quality)
    said = " ".join(str(item.message) for item in caught)
    assert "more than 100 standard deviations" in said
    assert "inf" not in said.replace("inflation", "")
    assert "e+" not in said


def test_residuals_without_a_point_count_what_draws_a_coefficient_to_zero():
    """A term that one reading alone brings out, drawn to zero by as much as a reading weighs: closed form.

    Without the point its coefficient is expected at zero with the variance of a reading, so the reading departs from
    what the others foretell by itself, with twice the variance of a reading.
    """
    generator = np.random.default_rng(7)
    x = np.array([1.0, -1, 2, 0, -2, 1, -1, 0.5])
    z = (np.arange(8) == 3).astype(float)
    others = generator.normal(0, 0.01, 8)
    y = np.where(z == 1, 1.0, x + others)
    fit = regress(
        y, np.column_stack([x, z]), np.zeros((8, 0)), included=np.ones(2, dtype=bool), penalty=np.array([0.0, 1.0])
    )
    kept = z == 0
    slope = x[kept] @ y[kept] / (x[kept] @ x[kept])
    scatter = np.sqrt(np.sum((y[kept] - slope * x[kept]) ** 2) / (7 - 1))
    assert fit.studentised[3] == pytest.approx(1 / (np.sqrt(2) * scatter), rel=1e-9)
    assert np.isfinite(fit.press)


def test_standard_deviations_count_the_degrees_of_freedom():
    """Many terms for few points: the root mean square of what is left is no standard deviation."""
    generator = np.random.default_rng(11)
    found = []
    for _ in range(60):
        clean = schedule(noise=0.0, wrong=0.0)
        noisy = replace(clean, outputs=clean.outputs + generator.normal(0, NOISE, clean.outputs.shape))
        found.append(assess(calibrate(noisy, model="quadratic")).deviation[0] ** 2)
    # 18 points less 4 terms that single loads tell and 2 series: 12 degrees of freedom; 60 draws make the mean 5 %
    # uncertain, and without them it would be a third too small
    assert np.mean(found) == pytest.approx((NOISE / 1.0) ** 2, rel=0.2)


def test_workbooks_are_calibrated_and_compared(here, capsys):
    openpyxl = pytest.importorskip("openpyxl", reason="the extra excel is not installed")
    for name in ("2024.xlsx", "2025.xlsx"):
        book = openpyxl.Workbook()
        for row in (
            ["Kalibrierung"],
            ["Serie", "Punkt", "N1", "RM", "rN1", "rRM"],
            ["", "", "N", "Nm", "mV/V", "mV/V"],
        ):
            book.active.append(row)
        for row in rows(noise=NOISE, wrong=0.0):
            book.active.append([*row[:2], *map(float, row[2:])])
        book.save(name)
    account, _ = run(capsys, "calibrate", "2024.xlsx", "--model", "linear")
    assert account["components"]["N1"]["sensitivity"]["value"] == pytest.approx(SENSITIVITY[0, 0], rel=1e-3)
    drift, _ = run(capsys, "compare-calibrations", "2024.xlsx", "2025.xlsx", "--model", "linear")
    assert drift["components"]["N1"]["drift_percent"] == 0
