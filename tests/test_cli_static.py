"""The static side from outside: calibrate, loads, weigh and force by files alone, as a laboratory would."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.io import read, write_recording
from aerobalance.io.balance_file import read_balance
from aerobalance.io.mass_file import read_weighing, write_weighing
from aerobalance.io.schedule import read_schedule, write_balfit_schedule
from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import DataQualityWarning, ReadError
from aerobalance.recording.gravity import Attitudes
from aerobalance.simulation.calibration_stand import CAPACITIES, CalibrationStand, random_balance
from seeds import new_seed

GRAVITY = 9.80665
MASS = 60.0
NOISE = 2e-4
STIFFNESS, DAMPING = 3.0e7, 800.0


@pytest.fixture(scope="module")
def truth() -> BalanceMatrix:
    return random_balance(new_seed())


@pytest.fixture(scope="module")
def stand(truth: BalanceMatrix, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a schedule, and of the balance that `calibrate` finds in it."""
    folder = tmp_path_factory.mktemp("stand")
    schedule = folder / "schedule.csv"
    write_balfit_schedule(schedule, CalibrationStand(truth, confirmation=0.05).run(new_seed()).schedule)
    places = ["--distances", "12 12 10 10 cm"]
    for name, options in (("balance.json", []), ("balance_of_places.json", places)):
        assert main(["calibrate", str(schedule), "--model", "96", "-o", str(folder / name), *options, "--json"]) == 0
    return folder


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stand: Path) -> Path:
    """A folder with the schedule alone."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(stand / "schedule.csv", "schedule.csv")
    return tmp_path


@pytest.fixture
def calibrated(here: Path, stand: Path) -> Path:
    """A folder with the schedule and its balance."""
    shutil.copy(stand / "balance.json", "balance.json")
    return here


def run(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> dict[str, object]:
    """Run one command; return its JSON where it gives one."""
    found = main([*arguments, "--json"])
    captured = capsys.readouterr()
    assert found == code, captured.err
    return json.loads(captured.out) if captured.out else {"error": captured.err}


def write(path: str, time: Array, columns: dict[str, Array]) -> None:
    header = ",".join(["time [s]", *columns])
    table = np.column_stack([time, *columns.values()])
    Path(path).write_text("\n".join([header, *(",".join(f"{x:.12g}" for x in row) for row in table)]) + "\n")


def native(direct: Array) -> Array:
    """N1 N2 S1 S2 RM AF of NF PM SF YM RM AF for gauges at 0.12 and 0.10 m, from NF = N1 + N2, PM = x (N1 - N2)."""
    nf, pm, sf, ym, rm, af = direct.T
    n, s = pm / 0.12, ym / 0.10
    return np.column_stack([(nf + n) / 2, (nf - n) / 2, (sf + s) / 2, (sf - s) / 2, rm, af])


def gauges(truth: BalanceMatrix, direct: Array, generator: np.random.Generator) -> dict[str, Array]:
    outputs = truth.outputs(native(direct)) + truth.natural_zero + generator.normal(0, NOISE, direct.shape)
    return {f"r{name} [mV/V]": outputs[:, i] for i, name in enumerate(truth.gauges)}


def weight(pitch: Array) -> Array:
    """Loads of the model, its centre of gravity at the balance's: level roll."""
    zero = np.zeros_like(pitch)
    share = MASS * GRAVITY
    return np.column_stack([-share * np.cos(pitch), zero, zero, zero, zero, share * np.sin(pitch)])


def test_calibrate_gives_matrix_statistics_and_warnings(here, capsys, truth):
    account = run(capsys, "calibrate", "schedule.csv", "--model", "96", "-o", "balance.json")
    assert list(account["components"]) == list(truth.components)
    for i, entry in enumerate(account["components"].values()):
        noise = 100 * 0.7e-3 / truth.output_scale[i]
        # some 200 degrees of freedom: a standard deviation scatters by 1 / sqrt(2 * 200), five times that
        assert 0.75 * noise < entry["residual_std_percent_of_capacity"] < 1.25 * noise
        assert {"term", "value", "u", "t", "p", "vif", "percent_contribution"} == set(entry["terms"][0])
    covered = [entry["confirmation_within_two_u_percent"] for entry in account["components"].values()]
    # 95.4 % of six times 17 points, by chance +- 2.1 %, and one calibration differs from the next by 2.3 %: five times
    assert np.mean(covered) > 80
    assert account["unidentified_terms"] == []
    assert account["tares"]["largest_difference_of_both_methods_percent_of_capacity"] < 0.05
    artefact = json.loads(Path("balance.json").read_text())
    assert artefact["kind"] == "balance"
    assert artefact["provenance"]["inputs"][0]["name"] == "schedule.csv"
    matrix = read_balance("balance.json")
    x = 0.5 * np.eye(6) * CAPACITIES
    # within six standard errors of 96 coefficients that all contribute
    assert np.allclose(matrix.outputs(x), truth.outputs(x), atol=6 * 0.7e-3), "matrix from the file"


def test_the_same_inputs_give_the_same_bytes(here, capsys):
    run(capsys, "calibrate", "schedule.csv", "--model", "27", "-o", "one.json")
    run(capsys, "calibrate", "schedule.csv", "--model", "27", "-o", "two.json")
    one, two = (json.loads(Path(name).read_text()) for name in ("one.json", "two.json"))
    one["provenance"].pop("created")
    two["provenance"].pop("created")
    assert one == two


def test_noise_of_the_readings_is_kept(here, capsys):
    run(capsys, "calibrate", "schedule.csv", "--model", "27", "--reading-noise", "2e-4", "-o", "balance.json")
    assert read_balance(Path("balance.json")).reading_noise == 2e-4
    assert main(["calibrate", "schedule.csv", "--model", "27", "--reading-noise", "-1", "-o", "no.json"]) == 2
    assert "reading_noise must be zero or positive" in capsys.readouterr().err
    assert not Path("no.json").exists()


def test_noise_of_the_readings_may_be_given_by_bridge(here, capsys):
    first, second = read_schedule(Path("schedule.csv")).gauges[:2]
    noises = ["--reading-noise", f"r{first}=2e-4", "--reading-noise", f"r{second}=0.1 uV/V"]
    run(capsys, "calibrate", "schedule.csv", "--model", "27", *noises, "-o", "balance.json")
    matrix = read_balance(Path("balance.json"))
    np.testing.assert_allclose(matrix.reading_noise, [2e-4, 1e-4, 0, 0, 0, 0], rtol=1e-12)
    assert len(matrix.noise_of_readings) == 6
    contents = json.loads(Path("balance.json").read_text())
    for wrong, said in (
        ([1e-4], "shape"),
        ([-1e-4] * 6, "reading_noise must be zero or positive"),
        ("much", "reading_noise"),
    ):
        contents["matrix"]["reading_noise"] = wrong
        Path("wrong.json").write_text(json.dumps(contents))
        with pytest.raises(ReadError, match=said):
            read_balance(Path("wrong.json"))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["rXX=1e-4"], "reading_noise is given for rXX, which is no bridge of the schedule; it has r"),
        (["1e-4", "rNF=1e-4"], "not both"),
        (["rNF=1e-4", "rNF=2e-4"], "twice for rNF"),
        (["1e-4", "2e-4"], "given twice"),
        (["rNF="], "must be one number in mV/V, or by bridge such as"),
        (["rNF=much"], "must be one number in mV/V, or by bridge such as"),
        (["rNF=1e-4 N"], "must be one number in mV/V, or by bridge such as"),
        (["rNF=-1"], "must be zero or positive"),
        (["rNF=inf"], "must be zero or positive"),
        ([""], "must be one number in mV/V, or by bridge such as"),
    ],
)
def test_wrong_noises_of_the_readings_are_refused(here, capsys, given, said):
    options = [word for text in given for word in ("--reading-noise", text)]
    assert main(["calibrate", "schedule.csv", "--model", "27", *options, "-o", "no.json"]) == 2
    message = capsys.readouterr().err
    assert said in " ".join(message.split())
    assert not Path("no.json").exists()


def test_summary_for_people(here, capsys):
    assert main(["calibrate", "schedule.csv", "--model", "linear", "--keep-aside", "0.1"]) == 0
    captured = capsys.readouterr()
    assert "N1" in captured.out and "% cap." in captured.out and "confirmation points" in captured.out
    assert captured.err.startswith("warning: ")


def test_loads_weigh_and_force_from_gauge_outputs(here, stand, capsys, truth, rng):
    shutil.copy(stand / "balance_of_places.json", "balance.json")
    count, rate = 800, 400.0
    time = np.arange(count) / rate
    names = []
    for k, angle in enumerate(np.radians([-12.0, -6, 0, 6, 12])):
        pitch = np.full(count, angle)
        names.append(f"off{k}.csv")
        write(names[-1], time, gauges(truth, weight(pitch), rng) | {"pitch [deg]": np.degrees(pitch)})
    weighed = run(capsys, "weigh", *names, "--balance", "balance.json", "-o", "mass.json")
    mass, u = (weighed["components"]["AF"]["mass"][key] for key in ("value", "u"))
    # the weighed mass carries the calibration's error of AF, about one reading's worth of the range, over the sweep
    assert abs(mass - MASS) < 5 * u + 0.01 * MASS

    aero = np.column_stack(
        [np.full(count, 800.0), np.full(count, 20.0), *[np.zeros(count)] * 3, np.full(count, 300.0)]
    )
    pitch = np.radians(6 * np.sin(2 * np.pi * 0.5 * time))
    on = gauges(truth, weight(pitch) + aero, rng) | {"pitch [deg]": np.degrees(pitch)}
    write("on.csv", time, on)
    account = run(capsys, "loads", "on.csv", "--balance", "balance.json", "--mass", "mass.json", "-o", "loads.csv")
    assert account["zero"]["from"] == "natural zeros of the calibration"
    for name, expected in zip(("NF", "PM", "SF", "YM", "RM", "AF"), aero[0], strict=True):
        entry = account["components"][name]
        assert abs(entry["mean"] - expected) < 4 * entry["u_calibration_rms"], name
    tare = [part for name in names for part in ("--tare", name)]
    account = run(capsys, "loads", "on.csv", "--balance", "balance.json", *tare, "-o", "tared.csv")
    for name, expected in zip(("NF", "PM", "SF", "YM", "RM", "AF"), aero[0], strict=True):
        entry = account["components"][name]
        assert abs(entry["mean"] - expected) < 4 * entry["u_calibration_rms"], name


def test_a_run_without_pitch_counts_from_the_attitude_of_its_zero(calibrated, capsys, truth, rng):
    time = np.arange(1200) / 1000.0
    up = np.full(time.size, np.radians(9.0))
    applied = 200 * np.sin(2 * np.pi * 3 * time)
    felt = weight(up)
    felt[:, 5] += applied
    write("run.csv", time, gauges(truth, felt, rng))
    write("zero.csv", time, gauges(truth, weight(up), rng) | {"pitch [deg]": np.degrees(up)})
    dynamics = {"mass": {"value": MASS}, "stiffness": {"value": STIFFNESS}, "damping": {"value": DAMPING}}
    Path("dynamics.json").write_text(json.dumps({"components": {"AF": dynamics}}))
    files = ["--dynamics", "dynamics.json", "--balance", "balance.json", "--zero", "zero.csv", "-o", "force.csv"]
    run(capsys, "force", "run.csv", *files)
    table = np.genfromtxt("force.csv", delimiter=",", names=True)
    # the weight left in would be M g sin(9 deg) = 92 N, some hundred times what the matrix leaves
    assert abs(np.mean(table["AF_N"] - applied)) < 4 * np.sqrt(np.mean(table["u_AF_N"] ** 2))
    assert np.sqrt(np.mean(table["u_AF_N"] ** 2)) < 0.1 * MASS * GRAVITY * np.sin(up[0])


def test_loads_of_a_force_balance_in_its_own_form(calibrated, capsys, truth, rng):
    """Without distances, and with wind-off loads taken off in that form."""
    time = np.arange(400) / 400.0
    level = np.zeros(time.size)
    off = gauges(truth, weight(level), rng)
    write("off.csv", time, off)
    applied = np.column_stack([np.full(time.size, 800.0), *[level] * 4, np.full(time.size, 300.0)])
    write("on.csv", time, gauges(truth, weight(level) + applied, rng))
    files = ["--balance", "balance.json", "--tare", "off.csv", "--form", "force", "-o", "loads.csv"]
    found = run(capsys, "loads", "on.csv", *files)["components"]
    assert list(found) == ["N1", "N2", "S1", "S2", "RM", "AF"]
    for name, expected in zip(found, native(applied)[0], strict=True):
        assert abs(found[name]["mean"] - expected) < 4 * found[name]["u_calibration_rms"], name
    assert main(["loads", "on.csv", *files[:2], "--mass", "mass.json", *files[4:]]) == 2
    assert "give wind-off recordings with --tare instead" in capsys.readouterr().err


@pytest.mark.parametrize("at_zero", [9.0, 4.0])
@pytest.mark.soak(first=1)
def test_a_wrong_mass_is_wrong_in_a_zero_read_with_the_model_on(calibrated, capsys, truth, at_zero, rng):
    time = np.arange(1200) / 1000.0
    pitch, up = np.full((2, time.size), np.radians([[4.0], [at_zero]]))
    felt = weight(pitch)
    felt[:, 5] += 200 * np.sin(2 * np.pi * 3 * time)
    write("run.csv", time, gauges(truth, felt, rng) | {"pitch [deg]": np.degrees(pitch)})
    write("zero.csv", time, gauges(truth, weight(up), rng) | {"pitch [deg]": np.degrees(up)})
    u = 0.02 * MASS
    dynamics = {"mass": {"value": MASS, "u": u}, "stiffness": {"value": STIFFNESS}, "damping": {"value": DAMPING}}
    Path("dynamics.json").write_text(json.dumps({"components": {"AF": dynamics}}))
    files = ["--dynamics", "dynamics.json", "--balance", "balance.json", "--zero", "zero.csv", "-o", "force.csv"]
    account = run(capsys, "force", "run.csv", *files, "--monte-carlo", "20")
    found = account["components"]["AF"]["uncertainty_budget_rms"]["mass, stiffness, damping, delay"]
    alone, expected = (GRAVITY * u * abs(np.sin(pitch[0]) - sine) for sine in (0.0, np.sin(up[0])))
    # the mass in M / k AF'' is (3 / 112)^2 of 2 % of 141 N, rms, and the smoother lets through as much of noise
    assert found == pytest.approx(expected, rel=0.01, abs=0.01), alone
    assert alone > 50 * 0.01
    assert not [text for text in account["warnings"] if "mass" in text and "Monte Carlo" in text]


def test_what_is_said_of_a_zero_needs_one(here, capsys):
    for line in ("force run.csv --dynamics d.json --balance b.json", "loads run.csv --balance b.json"):
        assert main([*line.split(), "--model-on-zero", "off", "-o", "out.csv"]) == 2
        assert "give its recordings with --zero" in capsys.readouterr().err
    assert main(["force", "run.csv", "--dynamics", "d.json", "--model-on-zero", "on", "-o", "out.csv"]) == 2
    assert "go with --balance" in capsys.readouterr().err


def test_weight_in_a_zero_adds_no_doubt_at_its_attitude(here, stand, capsys, truth, rng):
    shutil.copy(stand / "balance_of_places.json", "balance.json")
    time = np.arange(400) / 400.0
    names, angles = [], np.radians([-12.0, -6, 0, 6, 12])
    for k, angle in enumerate(angles):
        pitch = np.full(time.size, angle)
        names.append(f"off{k}.csv")
        write(names[-1], time, gauges(truth, weight(pitch), rng) | {"pitch [deg]": np.degrees(pitch)})
    run(capsys, "weigh", *names, "--balance", "balance.json", "-o", "mass.json")
    weighed = read_weighing(Path("mass.json"))
    weighing = replace(weighed, covariance=1e5 * weighed.covariance)  # as if weighed badly
    write_weighing(Path("mass.json"), weighing, inputs=[], settings={}, warnings=[])
    pitch = np.full(time.size, angles[3])
    write("zero.csv", time, gauges(truth, weight(pitch), rng) | {"pitch [deg]": np.degrees(pitch)})
    files = ["--balance", "balance.json", "--mass", "mass.json", "--zero", "zero.csv", "-o", "loads.csv"]
    column = weighing.components.index("AF")
    for name, angle in zip(names, angles, strict=True):
        u = run(capsys, "loads", name, *files)["components"]["AF"]["u_calibration_rms"]
        since = [Attitudes(np.radians([6.0]), np.zeros(1))]
        by_weight = weighing.uncertainty(pitch=angle, offsets=False, since=since)[0, column]
        alone = weighing.uncertainty(pitch=angle, offsets=False)[0, column]
        of_matrix = run(capsys, "loads", name, "--balance", "balance.json", "-o", "raw.csv")
        rest = of_matrix["components"]["AF"]["u_calibration_rms"]
        # the matrix counts at the weight, and a little for the noise of the zero
        assert by_weight <= u < np.hypot(by_weight, 2 * rest), (name, alone)
        assert rest < 0.1 * alone or angle == 0


@pytest.mark.parametrize("zero", ["natural", "with the model on, nose up", "with the model off", "off, as said"])
def test_force_counts_gravity_once(calibrated, capsys, truth, zero, rng):
    dynamics = {"mass": {"value": MASS}, "stiffness": {"value": STIFFNESS}, "damping": {"value": DAMPING}}
    Path("dynamics.json").write_text(json.dumps({"components": {"AF": dynamics}}))
    count, rate = 1200, 1000.0
    time = np.arange(count) / rate
    pitch = np.full(count, np.radians(4.0))
    applied = 200 * np.sin(2 * np.pi * 3 * time)
    felt = weight(pitch)
    felt[:, 5] += applied  # 3 Hz is far below the 112 Hz of the balance: felt by (3 / 112)^2 = 0.07 % too large
    write("run.csv", time, gauges(truth, felt, rng) | {"pitch [deg]": np.degrees(pitch)})
    options = []
    if zero != "natural":
        up = np.full(count, np.radians(9.0))
        hung = weight(up) if "model on" in zero else np.zeros((count, 6))
        write("zero.csv", time, gauges(truth, hung, rng) | {"pitch [deg]": np.degrees(up)})
        options = ["--zero", "zero.csv", *(["--model-on-zero", "off"] if "said" in zero else [])]
    files = ["--dynamics", "dynamics.json", "--balance", "balance.json", "-o", "force.csv"]
    account = run(capsys, "force", "run.csv", *files, *options)
    assert "balance matrix, zeros and tares" in account["components"]["AF"]["uncertainty_budget_rms"]
    assert any("taken as read with the model off" in text for text in account["warnings"]) == ("model off" in zero)
    table = np.genfromtxt("force.csv", delimiter=",", names=True)
    error, u = table["AF_N"] - applied, table["u_AF_N"]
    assert np.mean(np.abs(error) < 3 * u) > 0.9, zero
    assert np.sqrt(np.mean(error**2)) < 0.01 * CAPACITIES[5]  # the weight is 0.013 of it at 4 deg, 0.03 at 9 deg


@pytest.mark.parametrize("way", ["loads", "balance"])
def test_compare_takes_gauge_outputs(calibrated, capsys, truth, way, rng):
    dynamics = {"mass": {"value": MASS}, "stiffness": {"value": STIFFNESS}, "damping": {"value": DAMPING}}
    Path("dynamics.json").write_text(json.dumps({"components": {"AF": dynamics}}))
    count, rate = 1200, 1000.0
    time = np.arange(count) / rate
    applied = 200 * np.sin(2 * np.pi * 3 * time)
    write("truth.csv", time, {"AF [N]": applied})
    up = np.full(count, np.radians(9.0))
    write("zero.csv", time, gauges(truth, weight(up), rng) | {"pitch [deg]": np.degrees(up)})
    pitch = np.full(count, np.radians(4.0))
    felt = weight(pitch)
    felt[:, 5] += applied
    write("run.csv", time, gauges(truth, felt, rng) | {"pitch [deg]": np.degrees(pitch)})
    balance = ["--balance", "balance.json", "--zero", "zero.csv"]
    record = ["compare", "run.csv", "--dynamics", "dynamics.json", *(balance if way == "balance" else [])]
    if way == "loads":  # the record has gauge outputs alone, and a zero belongs to them
        assert "no channel AF" in run(capsys, *record, code=1)["error"]
        assert "--balance" in run(capsys, *record, "--zero", "zero.csv", code=2)["error"]
        return
    force = run(capsys, "force", "run.csv", "--dynamics", "dynamics.json", *balance, "-o", "force.csv")
    account = run(capsys, *record, "--truth", "truth.csv", "-o", "compare.html")
    assert account["loads"]["zero"]["from"] == force["loads"]["zero"]["from"]
    page = Path("compare.html").read_text()
    assert "balance.json" in page and "zero.csv" in page
    rows = {row["name"]: row for row in account["rivals"] if row["setting"] == "customary"}
    # the same way to the same loads: compare's deviation is that of the file that force writes
    table = np.genfromtxt("force.csv", delimiter=",", names=True)
    error = (table["AF_N"] - applied)[60:-60]
    assert rows["this estimator"]["rms"] == pytest.approx(
        np.sqrt(np.mean(error**2)),
        abs=5e-4 * table["u_AF_N"].min(),  # the file is rounded below that
    )
    assert rows["raw reading"]["rms"] < 0.01 * CAPACITIES[5]  # the weight of the zero put on again, and taken off


def test_a_matrix_goes_to_the_text_layout_and_back(calibrated, capsys, truth, seed):
    run(capsys, "convert", "balance.json", "-o", "matrix.txt")
    text = Path("matrix.txt").read_text()
    assert "DATA_REDUCTION_MATRIX_IN_AMES_FORMAT" in text and "D0[TRANSPOSE(C1INV)]" in text
    account = run(capsys, "convert", "matrix.txt", "-o", "back.json")
    assert "no uncertainties" in account["warnings"][0]
    before, after = read_balance("balance.json"), read_balance("back.json")
    loads = np.random.default_rng(seed).uniform(-1, 1, (200, 6)) * CAPACITIES
    assert np.allclose(before.outputs(loads), after.outputs(loads), atol=1e-12, rtol=0)  # 17 digits are printed


def test_two_calibrations_are_compared(calibrated, capsys, truth, seed):
    write_balfit_schedule(Path("later.csv"), CalibrationStand(truth).run(seed + 1).schedule)
    scale = truth.output_scale.copy()
    scale[5] *= 1.01
    moved = CalibrationStand(replace(truth, output_scale=scale)).run(seed + 2).schedule
    write_balfit_schedule(Path("moved.csv"), moved)
    same = run(capsys, "compare-calibrations", "schedule.csv", "later.csv", "--model", "96")
    assert all(abs(entry["drift_percent"]) < 5 * entry["u_percent"] for entry in same["components"].values())
    run(capsys, "calibrate", "moved.csv", "--model", "96", "-o", "moved.json")
    drift = run(capsys, "compare-calibrations", "balance.json", "moved.json", "-o", "drift.json")["components"]["AF"]
    assert abs(drift["drift_percent"] - 1) < 5 * drift["u_percent"]
    assert drift["significant"] or drift["u_percent"] > 0.3
    assert json.loads(Path("drift.json").read_text())["components"]["AF"] == drift


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["calibrate", "nowhere.csv"], 2, "no such file"),
        (["calibrate", "schedule.csv", "--model", "cubic"], 2, "--model"),
        (["calibrate", "schedule.csv", "--keep-aside", "0.9"], 2, "kept aside must lie between"),
        (["calibrate", "schedule.csv", "--distances", "1 2 3 in"], 2, "--distances must be four"),
        (["calibrate", "schedule.csv", "--capacity", "N1"], 2, "--capacity must be like"),
        (["calibrate", "schedule.csv", "--capacity", "N1=1e lbf"], 2, "--capacity must be like"),
        (["calibrate", "schedule.csv", "--capacity", "N1=-5 N"], 2, "positive"),
        (["calibrate", "schedule.csv", "--capacity", "N1=5 N", "--capacity", "N1=6 N"], 2, "N1 twice"),
        (["calibrate", "schedule.csv", "-o", "schedule.csv"], 2, "would be overwritten"),
        (["loads", "run.csv", "--balance", "schedule.csv", "-o", "out.csv"], 2, "balance.json"),
        (["loads", "run.csv", "--balance", "bad.json", "-o", "out.csv"], 2, "matrix"),
        (["weigh", "run.csv", "--zero", "run.csv"], 2, "--balance"),
        (["weigh", "run.csv", "--scales", "-3"], 2, "--scales must be a positive number, not -3"),
        (["weigh", "run.csv", "--scales", "run.csv"], 2, "--scales must be a mass like 42.1"),
        (["force", "run.csv", "--dynamics", "x.json", "--tare", "run.csv", "-o", "out.csv"], 2, "--balance"),
    ],
)
def test_wrong_calls_say_what_is_allowed(here, capsys, arguments, code, message):
    write("run.csv", np.arange(40) / 100, {"rAF [mV/V]": np.zeros(40)})
    Path("bad.json").write_text(json.dumps({"kind": "balance", "schema": 1}))
    assert main(arguments) == code
    error = capsys.readouterr().err
    assert error.startswith("error: ") and message in error
    assert not Path("out.csv").exists()


@pytest.mark.usefixtures("calibrated")
@pytest.mark.parametrize("low_pass", [None, AntiAlias("butterworth", 8, 10.0)])
def test_loads_of_a_long_record_do_not_depend_on_its_parts(
    truth: BalanceMatrix,
    rng,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    low_pass: AntiAlias | None,
) -> None:
    count = 12_000
    time = np.arange(count) / 1000
    direct = 0.3 * CAPACITIES * np.sin(2 * np.pi * time[:, None] * np.linspace(1, 3, 6))
    for name, drift in (("before", 0.0), ("after", 0.01)):
        outputs = gauges(truth, np.zeros((500, 6)), rng)
        shifted = {key: values + drift for key, values in outputs.items()}
        write(f"{name}.csv", np.arange(500) / 1000, shifted)
    outputs = gauges(truth, direct, rng)
    write("run.csv", time, {key: values + 0.01 * time / time[-1] for key, values in outputs.items()})
    record = read("run.csv")
    behind = {channel.name: replace(channel, filter=low_pass) for channel in record}
    write_recording("run.h5", replace(record, channels=behind))
    words = ["loads", "run.h5", "--balance", "balance.json", "--zero", "before.csv", "--zero-after", "after.csv"]
    words += ["--model-on-zero", "off"]
    whole = run(capsys, *words, "-o", "whole.h5")
    monkeypatch.setattr("aerobalance.app.commands.loads.PART", 3000)
    monkeypatch.setattr("aerobalance.app.commands.loads.MARGIN", 200)
    parts = run(capsys, *words, "-o", "parts.h5")
    one, other = read("whole.h5"), read("parts.h5")
    for channel in one:
        values, again = channel.values, other.channel(channel.name).values
        size = np.max(np.abs(values))
        # each part judges the noise of its readings by itself: 4 standard deviations of a deviation of 3000 samples
        tolerance = 4 / np.sqrt(2 * 3000) if channel.name.startswith("u_") else 1e-9
        if low_pass is not None and not channel.name.startswith("u_"):
            # a slow filter forgets with the square of time in the end, and nobody knows what was before the record
            values, again, tolerance = values[500:-500], again[500:-500], 1e-4
        np.testing.assert_allclose(again, values, rtol=0, atol=tolerance * size)
    for name, found in whole["components"].items():
        for key, value in found.items():
            close = 0.1 if key == "noise_of_reading" else 1e-2 if key == "u_calibration_rms" else 1e-6
            assert parts["components"][name][key] == (
                value
                if isinstance(value, str)
                else pytest.approx(value, rel=close, abs=1e-6 if low_pass is None else 1.0)
            ), (name, key)
    assert parts["beyond_calibrated_range"] == whole["beyond_calibrated_range"]
    assert parts["missing"] == whole["missing"] == 0


@pytest.mark.usefixtures("calibrated")
@pytest.mark.parametrize("begin", [0, 400])
def test_a_gap_as_long_as_a_part_is_missing_loads(truth, rng, capsys, monkeypatch, begin) -> None:
    count = 2000
    time = np.arange(count) / 1000
    outputs = gauges(truth, 0.3 * CAPACITIES * np.sin(2 * np.pi * time[:, None] * np.linspace(1, 3, 6)), rng)
    outputs["rN1 [mV/V]"][begin : begin + 700] = np.nan
    write("run.csv", time, outputs)
    words = ["loads", "run.csv", "--balance", "balance.json"]
    whole = run(capsys, *words, "-o", "whole.h5")
    monkeypatch.setattr("aerobalance.app.commands.loads.PART", 500)
    monkeypatch.setattr("aerobalance.app.commands.loads.MARGIN", 50)
    parts = run(capsys, *words, "-o", "parts.h5")
    assert parts["missing"] == whole["missing"] == 700
    with pytest.warns(DataQualityWarning, match="700 of 2000 samples"):
        one, other = read("whole.h5"), read("parts.h5")
    for name in whole["components"]:
        values = one.channel(name).values
        assert np.flatnonzero(np.isnan(values)).tolist() == list(range(begin, begin + 700))
        np.testing.assert_allclose(other.channel(name).values, values, rtol=0, atol=1e-9 * np.nanmax(np.abs(values)))
        for key in ("mean", "least", "largest", "rms_about_mean"):
            assert parts["components"][name][key] == pytest.approx(whole["components"][name][key], rel=1e-6)
        # the noise is judged by each part for itself, and by half of the spectrum: 650 degrees of freedom either way
        noises = [found["components"][name]["noise_of_reading"] for found in (parts, whole)]
        assert noises[0] == pytest.approx(noises[1], rel=4 * np.sqrt(2 / (2 * 650)))
    outputs["rN1 [mV/V]"][:1000] = outputs["rN2 [mV/V]"][1000:] = np.nan
    write("run.csv", time, outputs)
    assert "no sample gives loads" in run(capsys, *words, "-o", "none.h5", code=1)["error"]
    assert not Path("none.h5").exists()
