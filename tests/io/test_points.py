"""Static points from tables and recordings."""

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.balance.weighing import fit_weight
from aerobalance.io.points import read_points
from aerobalance.recording.errors import FitError, ReadError


def table(folder, text, name="points.csv"):
    path = folder / name
    path.write_text(text)
    return path


def test_a_table_of_points(tmp_path):
    pitch = np.array([-10.0, 0, 10, 20])
    rows = "".join(f"{p},{float(2 * 9.80665 * np.sin(np.radians(p)) + 1)!r}\n" for p in pitch.tolist())
    points = read_points([table(tmp_path, "pitch [deg],AF [N]\n" + rows)], ("AF",))
    assert points.roll is None
    assert not points.noise.any()
    found = fit_weight(replace(points, noise=np.full(points.loads.shape, 0.1)))
    assert found.mass == pytest.approx(2, rel=1e-12)


def test_roll_and_uncertainty_of_a_table(tmp_path):
    path = table(tmp_path, "pitch [deg];AF [kN];roll [deg];u_AF [N]\n0;1;90;0,5\n10;2;180;0,25\n")
    points = read_points([path, path], ("AF",))
    np.testing.assert_allclose(points.roll, np.radians([90, 180, 90, 180]))
    assert points.loads[:, 0].tolist() == [1000, 2000, 1000, 2000]
    assert points.noise[:, 0].tolist() == [0.5, 0.25, 0.5, 0.25]


def test_recordings_and_tables_go_together(tmp_path):
    rows = "".join(f"{i / 100},{5 + (-1) ** i},30\n" for i in range(400))
    recording = table(tmp_path, "time [s],AF [N],pitch [deg]\n" + rows, "run.csv")
    points = read_points([recording, table(tmp_path, "pitch [deg],AF [N]\n0,1\n")], ("AF",))
    np.testing.assert_allclose(points.pitch, np.radians([30, 0]))
    np.testing.assert_allclose(points.loads[:, 0], [5, 1])


@pytest.mark.parametrize(
    ("text", "problem", "said"),
    [
        ("pitch [deg],NF [N]\n0,1\n", ReadError, "no column AF; it has pitch, NF"),
        ("AF [N]\n1\n", ReadError, "no column pitch; it has AF"),
        ("pitch [deg],AF [N]\n0,\n", ReadError, r"line 2, column 2 .*missing"),
        ("pitch [deg],AF [N],u_AF [N]\n0,1,-1\n", ReadError, r"line 2, column 3 .*negative"),
        ("pitch [deg],AF [N]\n", ReadError, "no rows of numbers"),
        ("", ReadError, "is empty"),
        ("time [s],AF [N]\n0,1\n1,2\n", FitError, "no channel pitch"),
    ],
)
def test_files_without_points(tmp_path, text, problem, said):
    with pytest.raises(problem, match=said):
        read_points([table(tmp_path, text)], ("AF",))


def test_roll_in_some_files_only(tmp_path):
    first = table(tmp_path, "pitch [deg],AF [N],roll [deg]\n0,1,0\n", "a.csv")
    second = table(tmp_path, "pitch [deg],AF [N]\n0,1\n", "b.csv")
    with pytest.raises(ReadError, match=r"b\.csv: has no roll, but a\.csv has"):
        read_points([first, second], ("AF",))
    with pytest.raises(ValueError, match="no files"):
        read_points([], ("AF",))


SIX = "pitch [deg],roll [deg],NF [N],PM [N*m],SF [N],YM [N*m],RM [N*m],AF [N],u_PM [N*m]\n"


def test_all_loads_of_a_table(tmp_path):
    path = table(tmp_path, SIX + "0,90,1,2,3,4,5,6,0.5\n10,180,7,8,9,10,11,12,0.25\n")
    points = read_points([path])
    assert points.components == ("NF", "PM", "SF", "YM", "RM", "AF")
    np.testing.assert_allclose(points.roll, np.radians([90, 180]))
    assert points.loads.tolist() == [[1, 2, 3, 4, 5, 6], [7, 8, 9, 10, 11, 12]]
    assert points.noise[:, 1].tolist() == [0.5, 0.25]
    assert not points.noise[:, [0, 2, 3, 4, 5]].any()
    some = read_points([path, path], ("AF", "PM"))
    assert some.components == ("AF", "PM")
    assert some.loads.tolist() == [[6, 2], [12, 8]] * 2
    np.testing.assert_array_equal(read_points([path], ("PM",)).noise[:, 0], [0.5, 0.25])


def test_all_loads_of_a_recording_and_a_table(tmp_path):
    rows = "".join(f"{i / 100},{5 + (-1) ** i},{-2 + (-1) ** i},30\n" for i in range(400))
    recording = table(tmp_path, "time [s],AF [N],NF [N],pitch [deg]\n" + rows, "run.csv")
    points = read_points([recording, table(tmp_path, "pitch [deg],AF [N],NF [kN]\n0,1,2\n")])
    assert points.components == ("NF", "AF")
    assert points.roll is None
    np.testing.assert_allclose(points.loads, [[-2, 5], [2000, 1]])


@pytest.mark.parametrize(
    ("text", "problem", "said"),
    [
        (
            "pitch [deg],pressure [Pa]\n0,1\n",
            FitError,
            "points.csv: has none of the loads NF, PM.*it has pitch, press",
        ),
        ("pitch [deg],rAF [mV/V]\n0,1\n", FitError, "gauge outputs become loads by a balance matrix"),
        ("time [s],rAF [mV/V]\n0,1\n1,2\n", FitError, "gauge outputs become loads by a balance matrix"),
        ("AF [N],NF [N]\n1,2\n", ReadError, "no column pitch"),
        ("time [s],AF [N],NF [N]\n0,1,2\n1,2,3\n", FitError, "no channel pitch"),
    ],
)
def test_files_without_loads(tmp_path, text, problem, said):
    with pytest.raises(problem, match=said):
        read_points([table(tmp_path, text)])


def test_a_load_in_some_files_only(tmp_path):
    first = table(tmp_path, "pitch [deg],AF [N],NF [N]\n0,1,0\n", "a.csv")
    second = table(tmp_path, "pitch [deg],AF [N]\n0,1\n", "b.csv")
    with pytest.raises(ReadError, match=r"b\.csv: has no NF, but a\.csv has; .*name the one component"):
        read_points([first, second])
    assert read_points([first, second], ("AF",)).loads[:, 0].tolist() == [1, 1]
