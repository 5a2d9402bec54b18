"""A whole test of six components, simulated: polars with repeats, zeros, a change of balance, and what goes wrong."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tomli_w

from aerobalance.balance.calibration.fit import calibrate
from aerobalance.io import write_recording
from aerobalance.io.balance_file import write_balance
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.recording.frames import Frame, ResolvedLoads, wind_loads
from aerobalance.recording.recording import Recording
from aerobalance.simulation.calibration_stand import CalibrationStand
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_components import SixComponentRig
from aerobalance.simulation.six_signals import Band, broadband
from aerobalance.uncertainty.mean_in_axes import WIND_COEFFICIENTS

PRESSURE, U_PRESSURE = 1500.0, 3.0
CENTRE = (0.02, 0.0, -0.01)
RATE, SECONDS = 1000.0, 1.0
BUFFET = Band(0, 100)
BUFFETING = 0.01
"""Fluctuation of each load, over half of its range."""


@dataclass(slots=True)
class WholeTest:
    """A test on the disk, and the truth behind it.

    Attributes
    ----------
    folder
        Where its files are; ``test.toml`` is the test file.
    truth
        Coefficients in wind axes of every good run, by name, shape (6,).
    broken
        Runs that cannot be reduced.
    drifted
        Runs of the polar whose zero drifted.
    changed
        The first run with the second balance.
    """

    folder: Path
    truth: dict[str, Array] = field(default_factory=dict)
    broken: list[str] = field(default_factory=list)
    drifted: list[str] = field(default_factory=list)
    changed: str = ""

    @property
    def file(self) -> Path:
        return self.folder / "test.toml"


def coefficients_at(alpha: float, reference: dict[str, float]) -> Array:
    """True coefficients in wind axes in the order of the components (L, PM, Y, YM, RM, D) at an angle [deg]."""
    lift = 0.1 + 0.08 * alpha
    return reference["size"] * np.array([lift, 0.05 - 0.01 * alpha, 0.02, 0.004, 0.003, 0.05 + 0.06 * lift**2])


def balance_loads(coefficients: Array, alpha: float, pressure: float, reference: dict[str, float]) -> Array:
    """Loads at the balance's centre that coefficients in wind axes about the moment centre are of, shape (6,)."""
    length = np.array([reference["chord"] if name == "PM" else reference["span"] for name in COMPONENTS])
    scale = np.where([name in MOMENTS for name in COMPONENTS], length, 1.0) * pressure * reference["area"]

    def there(loads: Array) -> Array:
        moved = Frame(np.array(CENTRE)).loads(ResolvedLoads.of(loads[None]))
        return wind_loads(moved, angle_of_attack=np.radians(alpha)).values[0]

    matrix = np.column_stack([there(one) for one in np.eye(6)])
    return np.asarray(np.linalg.solve(matrix, coefficients * scale))


def reference_for(balance: CoupledBalance, angles: Sequence[float]) -> dict[str, float]:
    """Area and lengths, and a size of the coefficients, that load no component with more than a third of its range."""
    reference = {"area": 0.2, "chord": 0.15, "span": 0.8, "size": 1.0}
    most = max(
        float(
            np.max(np.abs(balance_loads(coefficients_at(a, reference), a, PRESSURE, reference)) / balance.half_range)
        )
        for a in angles
    )
    return reference | {"size": 0.33 / most}


def simulated_test(
    folder: Path,
    rng: np.random.Generator,
    *,
    angles: Sequence[float],
    polars: int,
    broken: int = 0,
    drifted: int | None = None,
    change_at: int | None = None,
    drift: float = 0.004,
    calibration: bool = True,
) -> WholeTest:
    """Simulate a test and write its files.

    Parameters
    ----------
    folder
        Where to.
    rng
        Source of all randomness.
    angles
        Angles of attack of each polar [deg]; polars are repeats of each other.
    polars
        How many.
    broken
        Runs that are spoiled: a file that is cut off, one without a bridge, an empty one, and so on.
    drifted
        The polar during which the bridges drift, from its zero to its closing zero, counted from 0.
    change_at
        The polar from which another balance (of the same dynamics) is used.
    drift
        How far they drift, over the output at half of range.
    calibration
        Whether the matrices are found on a stand, or exact.
    """
    folder.mkdir(parents=True, exist_ok=True)
    first = random_balance(rng)
    reference = reference_for(first, angles)
    balances = [first]
    if change_at is not None:
        other = random_balance(rng).matrix
        gauges = CoupledBalance(first.half_range, first.stiffness, first.damping, first.mass, other)
        # another set of bridges on the same spring
        matrix = type(other)(
            **{**_fields(other), "load_scale": first.half_range, "calibrated": first.matrix.calibrated}
        )
        balances.append(CoupledBalance(**{**_fields(gauges), "matrix": matrix}))
    for number, balance in enumerate(balances, 1):
        noise = 1e-4 * float(balance.matrix.output_scale.min())
        stand = CalibrationStand(balance.matrix, noise=noise, repeats=3)
        matrix = balance.matrix
        if calibration:
            matrix = calibrate(stand.run(int(rng.integers(1 << 31))).schedule, reading_noise=noise).matrix
        write_balance(folder / f"balance_{number}.json", matrix, found={})
    write_dynamics(folder / "dynamics.json", first.dynamics)
    test, rows, number = WholeTest(folder), [], 0
    for polar in range(polars):
        balance = balances[-1 if change_at is not None and polar >= change_at else 0]
        offset = rng.normal(0, 1e-5, 6) * balance.matrix.output_scale
        moving = drift * balance.matrix.output_scale * rng.choice([-1, 1], 6) if polar == drifted else np.zeros(6)
        for name, share in (("zero", 0.0), ("closing", 1.0)):
            record = _recorded(balance, 0.0, np.zeros(6), rng, buffeting=0.0, seconds=0.5)
            write_recording(folder / f"{name}_{polar}.h5", _moved(record, balance, offset + share * moving))
        for place, alpha in enumerate(angles):
            number += 1
            name = f"run_{number:04d}"
            coefficients = coefficients_at(alpha, reference)
            pressure = PRESSURE * (1 + 0.01 * rng.normal())
            loads = balance_loads(coefficients, alpha, pressure, reference)
            record = _recorded(balance, alpha, loads, rng, buffeting=BUFFETING, seconds=SECONDS)
            # the drift goes on while the polar is measured, this run somewhere between the two zeros
            share = (place + 0.5) / len(angles)
            write_recording(folder / f"{name}.h5", _moved(record, balance, offset + share * moving))
            said = pressure + rng.normal(0, U_PRESSURE)
            rows.append([f"{name}.h5", number, polar, alpha, said, f"zero_{polar}.h5", f"closing_{polar}.h5"])
            test.truth[name] = coefficients
            if polar == drifted:
                test.drifted.append(name)
        if change_at is not None and polar == change_at:
            test.changed = f"run_{number - len(angles) + 1:04d}"
    for way, place in enumerate(rng.choice(len(rows), broken, replace=False)):
        name = Path(rows[place][0]).stem
        _spoil(folder / rows[place][0], way % 3)
        test.broken.append(name)
        del test.truth[name]
    with (folder / "runs.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([["file", "run", "polar", "alpha", "q [Pa]", "zero", "zero_after"], *rows])
    setups = [{"balance": "balance_1.json", "dynamics": "dynamics.json"}]
    if change_at is not None:
        setups.append({"from": change_at * len(angles) + 1, "balance": "balance_2.json"})
    definition = {
        "name": "simulated wing",
        "runs": {"table": "runs.csv"},
        "setups": setups,
        "zeros": {"model_on": True},
        "reference": {key: reference[key] for key in ("area", "chord", "span")},
        "pressure": {"column": "q", "u_run": U_PRESSURE},
        "axes": {"moment_centre": list(CENTRE)},
        "force": {"hum": "keep"},
        "repeats": {"by": ["alpha"]},
        "output": {"reports": "none"},
    }
    test.file.write_text(tomli_w.dumps(definition), encoding="utf-8")
    return test


def _fields(one: object) -> dict[str, object]:
    return {name: getattr(one, name) for name in one.__dataclass_fields__}  # type: ignore[attr-defined]


def _recorded(
    balance: CoupledBalance, alpha: float, loads: Array, rng: np.random.Generator, *, buffeting: float, seconds: float
) -> Recording:
    """A record of the gauges at an angle, under steady and buffeting loads."""
    gusts = broadband(rng, BUFFET, rms=buffeting * balance.half_range, period=20.0)
    rig = SixComponentRig(
        balance,
        rate=RATE,
        pitch=lambda time: np.full(time.shape, np.radians(alpha)),
        applied=lambda time: gusts(time) + loads,
    )
    return rig.run(seconds, rng).recording


def _moved(record: Recording, balance: CoupledBalance, offset: Array) -> Recording:
    """The same with bridges that have moved [mV/V]."""
    channels = dict(record.channels)
    for name, value in zip(balance.matrix.gauges, offset, strict=True):
        one = channels[f"r{name}"]
        channels[one.name] = type(one)(**{**_fields(one), "values": one.values + value})
    return Recording(
        **{**{key: value for key, value in _fields(record).items() if key != "_means"}, "channels": channels}
    )


def _spoil(path: Path, way: int) -> None:
    """Spoil a file: cut it off, empty it, or leave a bridge out."""
    if way == 0:
        path.write_bytes(path.read_bytes()[:3000])
    elif way == 1:
        path.write_bytes(b"")
    else:
        from aerobalance.io import read

        record = read(path)
        channels = {name: one for name, one in record.channels.items() if name != "rNF"}
        fields = {key: value for key, value in _fields(record).items() if key != "_means"}
        write_recording(path, Recording(**{**fields, "channels": channels}))


def coverage(rows: Sequence[dict[str, object]], truth: dict[str, Array], *, without: Sequence[str] = ()) -> list[bool]:
    """Whether each true coefficient lies within its interval of 95 %."""
    from scipy.special import stdtrit

    inside = []
    for row in rows:
        name = str(row["run_name"])
        if row["status"] != "reduced" or name in without:
            continue
        for label, true in zip(WIND_COEFFICIENTS, truth[name], strict=True):
            factor = stdtrit(float(row[f"dof_{label}"]), 0.975)
            inside.append(bool(abs(float(row[label]) - true) < factor * float(row[f"u_{label}"])))
    return inside
