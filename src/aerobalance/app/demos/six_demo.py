"""A balance of six coupled components, from the calibration stand to the forces of a run.

A random balance with a rigid model is calibrated, weighed, identified from six releases, and then put through a run:
gusts on all components, a release and a sting that shakes. Everything is recorded as gauge outputs in mV/V, and every
step reads files and calls the functions behind the commands. The true forces are used only to judge the results; they
are written to `truth.csv`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.app.commands import calibration, force, weighing
from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.identify_coupled import identify_decays
from aerobalance.app.commands.shared import Result, collected_warnings, seed_for
from aerobalance.app.reports.page import write_page
from aerobalance.app.reports.six_figures import SixFigure, six_figure
from aerobalance.estimation.force import estimate_force
from aerobalance.io import read, write_recording
from aerobalance.io.artefacts import provenance
from aerobalance.io.balfit_file import write_balfit_schedule
from aerobalance.io.dynamics_file import read_coupled
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.errors import kept_warnings
from aerobalance.recording.recording import Recording
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.calibration_stand import CalibrationStand
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_components import Release, SixSimulation
from aerobalance.simulation.six_signals import Band, broadband, random_motion

REPEATS: Final = 3
"""Number of times that the calibration's loads are applied."""

ATTITUDES: Final = ((0, 0), (-15, 0), (15, 0), (0, 90), (0, -90), (10, 45), (-10, -45), (0, 180))
"""Pitch and roll of the weighing [deg]."""

PULLED: Final = 0.3
"""Load of the releases of the identification, over half range."""

BEARABLE: Final = 0.7
"""Largest balance load after a release in any component, over half range; the rest is left for the weight."""

FELT: Final = 0.15
"""Rms of the balance load under the gusts of the run, over half range, in the component where this is largest."""

RELEASE: Final = 1.0
"""Duration of the recording of a release [s]."""

DURATION: Final = 1.0
"""Duration of the run [s]."""

INSTANT: Final = 0.60013
"""Instant of the release in the run [s]; between two samples, as in a real run."""

COVERAGE_FACTOR: Final = 2
"""Factor from the standard uncertainty u to the expanded uncertainty U, which holds some 95 % of the errors."""

RELEASED: Final = 0.001
"""Time before and after the release [s] in which the error of its instant counts: by a whole step in a sample."""

BEFORE: Final = 0.01
AFTER: Final = 0.03
"""Time before and after the release that the second figure shows [s]."""

KEY: Final = (
    "diagonal: coupling neglected, to compare with; doubts of that run are not shown: its model is wrong on purpose",
    "no release: coupled, without 1 ms before and after the release, where the error of its instant counts in full",
    "U: expanded uncertainty of the coupled result, k = 2, from its standard uncertainty u = U / 2, rms of the run",
    "cover: samples with an error below 1.96 of their own u; 95 % are expected",
)
"""What the columns of the printed table are."""

ENDS: Final = 0.05
"""Share of the run at each end that is left out of the errors: the estimate is less certain near an end."""


@dataclass(frozen=True, slots=True)
class DemoFolder:
    """Folder of the demonstration's files, with the random generator of all that is simulated."""

    path: Path
    generator: np.random.Generator

    def record(self, name: str, rig: SixComponentRig, duration: float) -> tuple[Path, SixSimulation]:
        """Simulate a rig for a duration [s], and return the file of its recording with the simulation."""
        simulation = rig.run(duration, self.generator)
        file = self.path / f"{name}.h5"
        write_recording(file, simulation.recording)
        return file, simulation


def run_six(out: Path, *, seed: int | None = None) -> Result:
    """Return the errors of the forces of the whole chain [% of half range], and write them to `six.html`.

    The true forces of the run are written to `truth.csv`.

    Parameters
    ----------
    out
        Folder for the page and all files behind it; made where it is missing.
    seed
        Seed of the balance and of all simulated noise; drawn and reported where it is not given.

    Raises
    ------
    ValueError
        The folder cannot be made or written to.
    """
    seed = seed_for(out, seed)
    folder = DemoFolder(out, np.random.default_rng(seed))
    balance = random_balance(folder.generator)
    with collected_warnings() as collected:
        files = calibrated(folder, balance)
        mass = weighed(folder, balance, files)
        dynamics = identified(folder, balance, files, mass)
        run, simulation = _run(folder, balance)
        _write_truth(out / "truth.csv", simulation)
        found = force.force(run, out / "force.csv", dynamics=dynamics, files=files)
        diagonal = _diagonal(run, dynamics, files)
    forces = read(out / "force.csv")
    felt = files.loads(read(run))
    raw = {name: felt.values[:, place] for place, name in enumerate(felt.components)}
    rows = _rows(balance, simulation, forces, raw=raw, diagonal=diagonal)
    result: Result = {
        "page": str(out / "six.html"),
        "seed": seed,
        "modes": _modes(balance, dynamics),
        "components": rows,
        "steps": {name: found["components"][name]["steps"] for name in COMPONENTS},
        "warnings": collected,
    }
    figures = [
        six_figure(_figure(simulation, forces, raw, window=window), label)
        for window, label in (
            (slice(None), "the whole run"),
            (_around(simulation), "about the release"),
        )
    ]
    origin = provenance([run, files.balance, *files.zero, dynamics, out / "truth.csv"])
    write_page(out / "six.html", "six.html.j2", {"found": result, "figures": figures, "origin": origin})
    return {**result, "summary": summary(result)}


def calibrated(folder: DemoFolder, balance: CoupledBalance) -> BalanceFiles:
    """Return the files of the calibrated balance: its matrix, and its zero with the model on and level."""
    noise = 1e-4 * float(balance.matrix.output_scale.min())
    stand = CalibrationStand(balance.matrix, noise=noise, repeats=REPEATS)
    schedule = folder.path / "calibration.csv"
    write_balfit_schedule(schedule, stand.run(int(folder.generator.integers(1 << 31))).schedule)
    matrix = folder.path / "balance.json"
    calibration.calibrate(schedule, matrix, model="auto", reading_noise=noise)
    zero, _ = folder.record("zero", still(balance, 0.0, 0.0), 0.5)
    return BalanceFiles.of(matrix, zero=[zero])


def still(balance: CoupledBalance, pitch: float, roll: float) -> SixComponentRig:
    """Return a rig of the balance at rest at an attitude [deg]."""

    def constant(angle: float) -> Any:
        return lambda time: np.full(time.shape, np.deg2rad(angle))

    return SixComponentRig(balance, pitch=constant(pitch), roll=constant(roll))


def weighed(folder: DemoFolder, balance: CoupledBalance, files: BalanceFiles) -> Path:
    """Weigh the balance with its model at the attitudes, and return the path of mass.json."""
    paths = [
        folder.record(f"weighing_{number}", still(balance, pitch, roll), 0.1)[0]
        for number, (pitch, roll) in enumerate(ATTITUDES, 1)
    ]
    mass = folder.path / "mass.json"
    weighing.weigh(paths, mass, files=files)
    return mass


def identified(folder: DemoFolder, balance: CoupledBalance, files: BalanceFiles, mass: Path) -> Path:
    """Identify the dynamics from six releases, each along one component, and return the path of dynamics.json."""
    paths = []
    for place, name in enumerate(COMPONENTS):
        load = np.zeros(len(COMPONENTS))
        load[place] = PULLED * balance.half_range[place]
        rig = replace(still(balance, 0.0, 0.0), releases=(Release(bearable(balance, load), instant=0.1),))
        paths.append(folder.record(f"release_{name}", rig, RELEASE)[0])
    dynamics = folder.path / "dynamics.json"
    half_range = dict(zip(COMPONENTS, balance.half_range.tolist(), strict=True))
    identify_decays(paths, dynamics, mass=str(mass), half_range=half_range, files=files)
    return dynamics


def bearable(balance: CoupledBalance, load: Array) -> Array:
    """Return a load to be let go, reduced where the free decay would exceed `BEARABLE`, shape (6,) [N, N*m]."""
    poles, shapes, weights = balance.dynamics.modal_form
    # Some ten periods of the slowest mode (69 Hz in 20 draws), above ten points per period of the fastest (567 Hz).
    time = np.arange(0, 0.2, 1e-4)
    swing = shapes * (-(weights @ load) / poles)
    felt = np.real(np.exp(np.outer(time, poles)) @ swing.T)
    largest = float(np.max(np.abs(felt) / balance.half_range))
    return np.asarray(load * min(1.0, BEARABLE / largest))


def _run(folder: DemoFolder, balance: CoupledBalance) -> tuple[Path, SixSimulation]:
    """Return the recording and the simulation of the run: gusts through all resonances, a release, a shaking sting."""
    top = 1.2 * max(mode.natural_frequency for mode in balance.dynamics.modes)
    band = Band(0, top)
    gusts = FELT / largest_felt(balance, band) * balance.half_range
    size = balance.half_range * np.array([0.3, 0.25, 0.2, 0.25, 0.2, 0.3]) / 2
    rig = replace(
        still(balance, 0.0, 0.0),
        releases=(Release(bearable(balance, size), instant=INSTANT),),
        applied=broadband(folder.generator, band, rms=gusts, period=2 * DURATION),
        base=random_motion(folder.generator, Band(2, 40), rms=np.array([1, 1, 1, 1, 1, 1]), period=2 * DURATION),
    )
    return folder.record("run", rig, DURATION)


def _write_truth(path: Path, simulation: SixSimulation) -> None:
    """Write the loads that were really applied, over the time of the run."""
    truth = {name: Channel(name, simulation.applied[:, place], si_unit(name)) for place, name in enumerate(COMPONENTS)}
    write_recording(path, Recording.from_columns(simulation.recording.time, truth, name=path.stem))


def largest_felt(balance: CoupledBalance, band: Band) -> float:
    """Return the largest rms of a balance load over half range [1], for applied loads with the rms of half range."""
    frequency = np.linspace(0, band.highest, 4001)
    response = balance.dynamics.response(frequency) * balance.half_range / balance.half_range[:, None]
    power = np.sum(np.abs(response) ** 2, axis=2) * band.density(frequency)[:, None]
    return float(np.sqrt(np.max(np.trapezoid(power, frequency, axis=0))))


def _diagonal(run: Path, dynamics: Path, files: BalanceFiles) -> Mapping[str, Array]:
    """Return the forces if coupling is neglected: only the diagonals of the same matrices are used, (n,) [N, N*m].

    The band is limited to the modes to save time: the estimator would search long for causes of the model's errors.
    What is doubted of it is not said, as this model is wrong on purpose: it reads like doubts of the result.
    """
    known = read_coupled(dynamics)
    band = 1.2 * max(mode.natural_frequency for mode in known.modes)
    alone = replace(
        known,
        inertia=np.diag(np.diag(known.inertia)),
        damping=np.diag(np.abs(np.diag(known.damping))),
        covariance=np.zeros_like(known.covariance),
    )
    recording = replace(files.loads(read(run), model=alone).recording, from_outputs=False)
    with kept_warnings():
        return {name: found.values for name, found in estimate_force(recording, alone, bandwidth=band).items()}


def _rows(
    balance: CoupledBalance,
    simulation: SixSimulation,
    forces: Recording,
    *,
    raw: Mapping[str, Array],
    diagonal: Mapping[str, Array],
) -> list[Result]:
    """Return the rms errors of every component [% of half range], and the coverage of its 95 % interval [%]."""
    samples = simulation.recording.samples
    inner = slice(round(ENDS * samples), samples - round(ENDS * samples))
    calm = np.abs(simulation.recording.time[inner] - INSTANT) > RELEASED
    rows = []
    for place, name in enumerate(COMPONENTS):
        truth, half = simulation.applied[:, place], float(balance.half_range[place])
        error = (forces.channel(name).values - truth)[inner]
        u = forces.channel(f"u_{name}").values[inner]
        rows.append(
            {
                "component": name,
                "unit": si_unit(name),
                "half_range": half,
                "raw_percent": 100 * _rms((raw[name] - truth)[inner]) / half,
                "diagonal_percent": 100 * _rms((diagonal[name] - truth)[inner]) / half,
                "error_percent": 100 * _rms(error) / half,
                "calm_error_percent": 100 * _rms(error[calm]) / half,
                "uncertainty_percent": 100 * _rms(u) / half,
                "expanded_percent": 100 * COVERAGE_FACTOR * _rms(u) / half,
                "cover_percent": 100 * float(np.mean(np.abs(error) < 1.96 * u)),
            }
        )
    return rows


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _modes(balance: CoupledBalance, dynamics: Path) -> list[Result]:
    """Return natural frequencies [Hz] and damping ratios [1], true and identified."""
    pairs = zip(balance.dynamics.modes, read_coupled(dynamics).modes, strict=True)
    return [
        {
            "natural_frequency": true.natural_frequency,
            "identified_frequency": found.natural_frequency,
            "damping_ratio": true.damping_ratio,
            "identified_damping_ratio": found.damping_ratio,
        }
        for true, found in pairs
    ]


def _around(simulation: SixSimulation) -> slice:
    """Return the samples about the release that the second figure shows."""
    rate = simulation.recording.rate
    return slice(round((INSTANT - BEFORE) * rate), round((INSTANT + AFTER) * rate))


def _figure(simulation: SixSimulation, forces: Recording, raw: Mapping[str, Array], *, window: slice) -> SixFigure:
    return SixFigure(
        time=simulation.recording.time[window],
        felt={name: raw[name][window] for name in COMPONENTS},
        found={name: forces.channel(name).values[window] for name in COMPONENTS},
        truth={name: simulation.applied[window, place] for place, name in enumerate(COMPONENTS)},
    )


def summary(result: Result) -> str:
    """Return the result as text for a terminal."""
    lines = ["Natural frequencies [Hz] and damping ratios [1], true and identified"]
    lines += [
        f"  {mode['natural_frequency']:9.4f} {mode['identified_frequency']:9.4f}   "
        f"{mode['damping_ratio']:.5f} {mode['identified_damping_ratio']:.5f}"
        for mode in result["modes"]
    ]
    lines += ["", "Error of the run, rms in percent of half range"]
    lines += [f"  {'':4}{'raw':>9}{'diagonal':>10}{'coupled':>9}{'no release':>12}{'U (k = 2)':>11}{'':3}{'cover':>8}"]
    lines += [
        f"  {row['component']:4}{row['raw_percent']:9.3g}{row['diagonal_percent']:10.3g}{row['error_percent']:9.3g}"
        f"{row['calm_error_percent']:12.3g}{row['expanded_percent']:11.3g}{row['cover_percent']:10.1f}%"
        for row in result["components"]
    ]
    lines += ["", *KEY]
    beyond = [row["component"] for row in result["components"] if row["error_percent"] > row["expanded_percent"]]
    lines += [
        f"error of the coupled dynamics beyond U: {', '.join(beyond)}"
        if beyond
        else "error of the coupled dynamics: within U for every component"
    ]
    return "\n".join([*lines, "", f"page: {result['page']}; seed {result['seed']}"]) + "\n"
