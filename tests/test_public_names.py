"""The names that `import aerobalance` gives, used as their documentation shows, against simulated truths."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import aerobalance as ab
from aerobalance.app.demos.six_demo import largest_felt
from aerobalance.balance.calibration.fit import Calibration
from aerobalance.estimation.applied_force import Force
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording
from aerobalance.simulation.calibration_stand import CalibrationStand
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_components import Release, SixComponentRig
from aerobalance.simulation.six_signals import Band, broadband
from aerobalance.uncertainty.budget import scalars
from helpers.pages import ROOT, python

ATTITUDES = [(p, r) for p in (-10.0, 0.0, 10.0) for r in (-30.0, 0.0, 30.0)]


def as_arrays(recording: Recording, **units: str) -> Recording:
    """The recording through arrays, as a user has them; units are in mV/V and SI but for those named."""
    columns = {name: channel.values for name, channel in recording.channels.items()}
    columns |= {name: np.degrees(columns[name]) for name in units if name in columns}
    return ab.Recording.from_arrays(
        recording.time, columns, units={name: unit for name, unit in units.items() if name in columns}, name="arrays"
    )


def still(balance: CoupledBalance, pitch: float, roll: float, **more: object) -> SixComponentRig:
    angles = {"pitch": pitch, "roll": roll}
    held = {name: lambda t, angle=angle: np.full(t.shape, np.radians(angle)) for name, angle in angles.items()}
    return SixComponentRig(balance, rate=10_000.0, **held, **more)


def calibrated(balance: CoupledBalance, rng: np.random.Generator) -> Calibration:
    noise = 1e-4 * float(balance.matrix.output_scale.min())
    stand = CalibrationStand(balance.matrix, noise=noise, repeats=3)
    return ab.calibrate(stand.run(int(rng.integers(1 << 31))).schedule, reading_noise=noise)


def gusts(balance: CoupledBalance, rng: np.random.Generator) -> SixComponentRig:
    """A broad load that rings with 6 % of half range, on a steady one of 10 %; 6 degrees of pitch, 15 of roll."""
    band = Band(2, 200)
    load = broadband(rng, band, rms=0.06 / largest_felt(balance, band) * balance.half_range, period=1.0)
    rig = still(balance, 6.0, 15.0)
    return replace(rig, applied=lambda time: load(time) + 0.1 * balance.half_range)


def errors(force: Force, truth: Array, balance: CoupledBalance) -> dict[str, tuple[float, float, float]]:
    """Mean error over half range and over its uncertainty, and rms error over rms uncertainty, by component."""
    found = {}
    inner = slice(len(truth) // 20, -len(truth) // 20)
    for place, name in enumerate(COMPONENTS):
        off = (force[name].values - truth[:, place])[inner]
        u = force[name].uncertainty[inner]
        u_mean = next(item.u for item in scalars(force[name]) if item.name == "mean")
        mean = float(abs(off.mean()))
        found[name] = (
            mean / float(balance.half_range[place]),
            mean / u_mean,
            float(np.sqrt(np.mean(off**2) / np.mean(u**2))),
        )
    return found


def test_one_component_as_the_documentation_shows_it(rng):
    rate, count = 1600.0, 4000
    t = np.arange(count) / rate
    pitch = 2.0 + 0.5 * np.sin(2 * np.pi * 0.4 * t)
    spring = ab.Dynamics("AF", mass=177.87, stiffness=3.093e7, damping=828.21)
    truth = 200 * np.sin(2 * np.pi * 20 * t)
    weight = 177.87 * 9.80665 * np.sin(np.radians(pitch))
    # `balance_load` takes the force for straight between samples, which takes 0.1 N off such a sine
    swings = 200 * np.imag(spring.response(np.array([20.0])) * np.exp(2j * np.pi * 20 * t))
    load = swings + spring.balance_load(weight, interval=1 / rate) + rng.normal(0, 2.0, count)
    run = ab.Recording.from_arrays(t, {"AF": load, "pitch": pitch}, units={"pitch": "deg"})
    force = ab.estimate_force(run, spring)
    inner = slice(200, -200)
    off = (force["AF"].values - truth)[inner]
    u = force["AF"].uncertainty[inner]
    assert np.sqrt(np.mean(off**2)) < 2 * np.sqrt(np.mean(u**2))  # what is asked of a force beside its u
    assert np.sqrt(np.mean(u**2)) < 0.5  # a quarter of the noise: much of it is force that may be below detection
    frame = force.to_dataframe()
    assert list(frame.columns) == ["AF", "u_AF"]
    data = force.to_xarray()
    assert data["AF"].attrs["units"] == "N"
    np.testing.assert_array_equal(data["u_AF"].to_numpy(), force["AF"].uncertainty)
    assert "force applied" in repr(force)
    assert repr(run) == "recording: 4000 samples, 2.49938 s at 1600 Hz; AF [N], pitch [rad]"
    assert repr(spring).splitlines()[:2] == ["dynamics of AF", "  mass 177.87 kg"]
    assert "<table>" in force._repr_html_()
    for shown in (repr(force), force._repr_html_()):
        assert f"verdict: {force.verdict}" in shown
    assert len(force.plot().axes) == 1
    (rows,) = ab.budget(force).values()
    assert sum(row.share for row in rows) == pytest.approx(1)
    checked = ab.monte_carlo(force, draws=20)["AF"]
    planned = ab.plan(spring, rate=rate, noise=2.0, force=200.0)
    shown = {"u of a sample": force["AF"], "4000 readings": run.channel("AF"), "drawn": checked, " Hz: u = ": planned}
    for words, result in shown.items():
        assert words in repr(result)
        assert "array(" not in repr(result)
    assert checked.deviation.shape == (count,)
    again = ab.Recording.from_xarray(force.to_xarray()[["AF"]])
    np.testing.assert_allclose(again.channel("AF").values, force["AF"].values)
    same = ab.Recording.from_dataframe(run.to_dataframe())
    np.testing.assert_array_equal(same.channel("AF").values, load)


@pytest.mark.filterwarnings("ignore:.*from the natural zeros of the calibration:UserWarning")  # of some balances
def test_six_components_from_outputs_of_the_bridges(rng):
    balance = random_balance(rng)
    matrix = calibrated(balance, rng)
    dynamics = replace(balance.dynamics, mass=balance.mass)
    zero = as_arrays(still(balance, 0.0, 0.0).run(0.2, rng).recording, pitch="deg", roll="deg")
    simulation = gusts(balance, rng).run(0.4, rng)
    run = as_arrays(simulation.recording, pitch="deg", roll="deg")
    force = ab.estimate_force(run, dynamics, balance=matrix, zero=ab.Zero(zero, model_on=True), hum="keep")
    for name, (mean, score, beside_u) in errors(force, simulation.applied, balance).items():
        assert beside_u < 2, name  # what is asked of a force beside its uncertainty
        assert score < 4.5, name  # one mean of six in 25,000 by chance
        # 0.05 % of half range is what is asked of a level balance's NF and PM, where it was 9 to 13 %
        assert mean < 5e-4 or name not in ("NF", "PM"), name
    assert "balance matrix, zeros and tares" in force["NF"].budget
    with pytest.raises(ValueError, match="must say how it was read: model_on=True"):
        ab.Zero(zero)
    with pytest.raises(ValueError, match="lack the weight of the model"):
        ab.estimate_force(ab.reduce_outputs(run, matrix, zero=ab.Zero(zero, model_on=True)), dynamics)
    lighter = replace(dynamics, mass=replace(balance.mass, mass=0.9 * balance.mass.mass))
    with pytest.raises(ValueError, match="with the same dynamics as their model"):
        ab.estimate_force(ab.reduce_outputs(run, matrix, zero=ab.Zero(zero, model_on=True), model=lighter), dynamics)
    with pytest.raises(FitError, match="gauge outputs become loads"):
        ab.estimate_force(run, dynamics)
    with pytest.warns(UserWarning, match="the errors of the balance matrix"):
        ab.estimate_force(
            ab.reduce_outputs(run, matrix, zero=ab.Zero(zero, model_on=True), model=dynamics).recording,
            dynamics,
            bandwidth=200.0,
        )


@pytest.mark.filterwarnings("ignore:.*the releases leave a force error:UserWarning")  # of some balances that are drawn
def test_the_chain_of_a_test(rng, tmp_path):
    balance = random_balance(rng)
    matrix = calibrated(balance, rng)
    zero = ab.Zero(still(balance, 0.0, 0.0).run(0.2, rng).recording, model_on=True)
    points = [still(balance, *attitude).run(0.1, rng).recording for attitude in ATTITUDES]
    with pytest.warns(UserWarning, match="no zero was given; the natural zeros"):
        mass = ab.weigh(points, matrix)
    assert abs(mass.mass - balance.mass.mass) < 5 * mass.u_mass
    releases = []
    for place in range(6):
        load = np.zeros(6)
        load[place] = 0.1 * balance.half_range[place]
        releases.append(still(balance, 0.0, 0.0, releases=(Release(load, instant=0.05),)).run(0.4, rng).recording)
    dynamics = ab.identify(releases, mass=mass, balance=matrix, zero=zero)
    with pytest.raises(ValueError, match="without recordings beside them"):
        ab.identify([ab.reduce_outputs(releases[0], matrix, zero=zero, model=mass), *releases[1:]], mass=mass)
    for result, words in (
        (matrix, "% of capacity"),
        (mass, "mass "),
        (dynamics, " Hz (u = "),
        (points[0], " samples, "),
        (matrix.schedule, " points in "),
        (ab.LiveForce(dynamics, rate=10_000), " at 10000 Hz"),
    ):
        assert words in repr(result)
        assert len(repr(result)) < 2000  # for a person to read
        assert "array(" not in repr(result)
        assert " object at " not in repr(result)
    simulation = gusts(balance, rng).run(0.3, rng)
    force = ab.estimate_force(simulation.recording, dynamics, balance=matrix, zero=zero, hum="keep")
    for name, (_, score, beside_u) in errors(force, simulation.applied, balance).items():
        assert beside_u < 2, name
        assert score < 4.5, name
    kept = {
        "balance.json": matrix,
        "dynamics.json": dynamics,
        "run.h5": simulation.recording,
        "zero.h5": zero.recordings[0],
        "mass.json": mass,
    }
    for name, result in kept.items():
        ab.write(tmp_path / name, result)
    matrix, dynamics, run, still_run, weighed = (ab.read(tmp_path / name) for name in kept)
    assert weighed.mass == mass.mass
    again = ab.estimate_force(run, dynamics, balance=matrix, zero=ab.Zero(still_run, model_on=True), hum="keep")
    for name, part in force.items():
        # what JSON and HDF5 keep is exact; masses are written about the centre of gravity, which rounds
        np.testing.assert_allclose(again[name].values, part.values, atol=1e-6 * np.abs(part.values).max())
        np.testing.assert_allclose(again[name].uncertainty, part.uncertainty, rtol=1e-4)


def test_wrong_calls_say_what_is_allowed():
    t = np.arange(100) / 100
    with pytest.raises(ValueError, match="'lift' is no channel; known are NF, PM"):
        ab.Recording.from_arrays(t, {"lift": t})
    with pytest.raises(ValueError, match=r"column AF has shape \(99,\), time has \(100,\)"):
        ab.Recording.from_arrays(t, {"AF": t[1:]})
    with pytest.raises(ValueError, match="units has pitch, which is not among the columns: AF"):
        ab.Recording.from_arrays(t, {"AF": t}, units={"pitch": "deg"})
    with pytest.raises(ValueError, match="deg"):
        ab.Recording.from_arrays(t, {"AF": t}, units={"AF": "deg"})
    with pytest.raises(AttributeError, match="it has Recording, read"):
        ab.reconstruct  # noqa: B018 - reading it is the call
    with pytest.raises(ValueError, match="given twice of AF"):
        ab.estimate_force(ab.Recording.from_arrays(t, {"AF": t}), [ab.Dynamics("AF", 1, 1, 0)] * 2)


def test_a_file_or_a_table_where_what_it_holds_is_needed_is_told():
    t = np.arange(100) / 100
    table = ab.Recording.from_arrays(t, {"AF": t}).to_dataframe()
    spring = ab.Dynamics("AF", mass=1, stiffness=1e4, damping=1)
    recording = r"a recording is needed, not the name of a file: `read` reads one"
    for call in (
        lambda: ab.estimate_force("run.csv", spring),
        lambda: ab.compare("run.csv", spring),
        lambda: ab.identify("cut.csv", mass=1),
        lambda: ab.identify(["cut.csv"], mass=1),
        lambda: ab.weigh("points.csv"),
        lambda: ab.weigh([Path("points.csv")]),
        lambda: ab.Zero("zero.csv", model_on=True),
    ):
        with pytest.raises(ValueError, match=recording):
            call()
    with pytest.raises(ValueError, match=r"not a DataFrame: .*`Recording.from_dataframe`"):
        ab.estimate_force(table, spring)
    with pytest.raises(ValueError, match=r"not a DataFrame: .*`Recording.from_dataframe`"):
        ab.identify(table, mass=1)
    with pytest.raises(ValueError, match="a load schedule is needed, not the name of a file: `read_schedule` reads"):
        ab.calibrate("schedule.csv")
    with pytest.raises(ValueError, match=r"the forces of all components are needed, not a Recording"):
        ab.budget(ab.Recording.from_arrays(t, {"AF": t}))


def test_importing_compiles_and_loads_nothing():
    script = (
        "import sys, aerobalance; "
        "print([name for name in ('numba', 'scipy', 'pandas', 'matplotlib', 'h5py') if name in sys.modules]); "
        "print(sorted(set(dir(aerobalance)) ^ {*aerobalance.__all__, '__version__'}))"
    )
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert found.stdout.split("\n")[:2] == ["[]", "[]"]


def test_the_first_example_of_the_documentation_runs():
    page = (ROOT / "docs" / "start" / "quickstart.md").read_text(encoding="utf-8")
    names: dict[str, object] = {}
    exec(python(page)[0], names)
    force, true = names["force"], names["true"]
    off = (force["AF"].values - true)[200:-200]
    # the rms of an error within twice its uncertainty, as is promised of a force
    assert np.sqrt(np.mean(off**2)) < 2 * np.sqrt(np.mean(force["AF"].uncertainty[200:-200] ** 2))
