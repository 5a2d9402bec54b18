"""From a laboratory's own text files to the force: map, calibrate, loads and force, by the commands alone."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

from aerobalance.app.cli import main
from aerobalance.io import read
from aerobalance.io.schedule import write_balfit_schedule
from aerobalance.simulation.calibration_stand import CalibrationStand, random_balance
from helpers.text_exports import completed

SEED = 20240312
RATE, DURATION = 5000, 1.0
MASS, FREQUENCY, RATIO = 42.0, 58.0, 0.008
STEP_AT = 0.55
NOISE = 5e-6
"""Of a bridge's reading [mV/V]: 0.02 N of axial force."""


def applied(fine, generator):
    """Axial force: 180 N, a gust of 12 N rms up to 90 Hz, and a step of 120 N [N]."""
    frequencies = np.arange(1, 90 * DURATION) / DURATION
    phases = generator.uniform(0, 2 * np.pi, frequencies.size)
    gust = np.cos(2 * np.pi * fine[:, None] * frequencies + phases).sum(axis=1)
    return 180 + 12 * gust / gust.std() + 120 * (fine >= STEP_AT)


def felt(fine, force):
    """The load that the balance feels: its stiffness times how far it gives way [N]."""
    angular = 2 * np.pi * FREQUENCY
    system = ([angular**2], [1, 2 * RATIO * angular, angular**2])
    # Ringing from before: at rest under the mean force.
    return lsim(system, force - 180, fine)[1] + 180


def german(time, outputs, start):
    """A text file as a German LabVIEW writes it: preamble, stamps, decimal commas, units of Windows-1252."""
    head = [
        "Messprotokoll DNW",
        "Versuch;17",
        "Bearbeiter;Jürgen Größ",
        "Abtastrate;5000 Hz",
        "Messbereich;±2,5 mV/V",
        "",
    ]
    head.append(
        "Zeitstempel;X_Value (s);" + ";".join(f"Brücke {i} (µV/V)" for i in range(1, 7)) + ";Nickwinkel (°);Bemerkung"
    )
    rows = (
        f"12.03.2024 {start}:{second:07.4f};{moment:.6f};{';'.join(f'{1000 * x:.4f}' for x in row)};0.00;".replace(
            ".", ","
        )
        for second, moment, row in zip(5 + time, time, outputs, strict=True)
    )
    return ("\r\n".join([*head, *(row.replace(",", ".", 2) for row in rows)]) + "\r\n").encode("cp1252")


def files(folder, generator):
    """Write schedule, zero, run and dynamics; return the force that was applied."""
    balance = random_balance(SEED, model="27")
    stand = CalibrationStand(balance, noise=NOISE)
    write_balfit_schedule(folder / "schedule.csv", stand.run(SEED).schedule)
    fine = np.arange(int(RATE * DURATION) * 20) / (20 * RATE)
    force = applied(fine, generator)
    time = fine[::20]
    loads = np.zeros((time.size, 6))
    loads[:, 0:4] = [300.0, -200.0, 50.0, 80.0]
    loads[:, 5] = felt(fine, force)[::20]
    for name, carried in (("run_017.csv", loads), ("zero_001.csv", np.zeros((500, 6)))):
        outputs = balance.outputs(carried) + balance.natural_zero + generator.normal(0, NOISE, carried.shape)
        (folder / name).write_bytes(german(time[: len(carried)], outputs, "10:15"))
    angular = 2 * np.pi * FREQUENCY
    values = {"mass": MASS, "stiffness": MASS * angular**2, "damping": 2 * RATIO * angular * MASS}
    entry = {key: {"value": value, "u": 0.0} for key, value in values.items()}
    entry["natural_frequency"] = {"value": FREQUENCY, "u": 0.0}
    dynamics = {"kind": "dynamics", "components": {"AF": entry}}
    (folder / "dynamics.json").write_text(json.dumps(dynamics))
    return force[::20]


def test_a_laboratorys_files_give_the_force_with_nothing_filled_in_but_what_a_column_is(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    truth = files(tmp_path, np.random.default_rng(SEED))
    assert main(["map", "run_017.csv", "-o", "map.toml"]) == 0
    gauges = ("rN1", "rN2", "rS1", "rS2", "rRM", "rAF")
    text = completed(Path("map.toml").read_text(encoding="utf-8"), dict(enumerate(gauges, start=3)))
    Path("map.toml").write_text(text, encoding="utf-8")
    for command in (
        ["calibrate", "schedule.csv", "--model", "27", "-o", "balance.json"],
        [
            "loads",
            "run_017.csv",
            "--map",
            "map.toml",
            "--balance",
            "balance.json",
            "--zero",
            "zero_001.csv",
            "-o",
            "l.csv",
        ],
        ["force", "l.csv", "--dynamics", "dynamics.json", "-o", "force.csv"],
    ):
        assert main(command) == 0, capsys.readouterr().err
    found = read("force.csv")
    assert found.rate == pytest.approx(RATE, rel=1e-9)
    error = found.channel("AF").values - truth
    assert np.sqrt(np.mean(error**2)) < 0.15
