"""Both experiments of [Gorbushin2020]_, simulated, end to end: files in, public commands, a report out.

Each rig writes what a real one would record; everything after that reads files and calls the functions behind the
commands. The truth that only a simulation knows is used to judge the results, never to find them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.app.commands import answers, force, identify, weighing
from aerobalance.app.commands.shared import seed_for, table_text
from aerobalance.app.demos.comparison import (
    COVERAGE,
    agreements_of,
    cut_methods,
    rig_methods,
    split_deviation,
    step_deviations,
    worst_deviation,
)
from aerobalance.app.demos.example_files import write_examples
from aerobalance.app.reports.demo_report import (
    LineFigure,
    ResonanceFigure,
    StepFigure,
    force_figure,
    line_figure,
    resonance_figure,
    ringing_figure,
    write_report,
)
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.component_force import Method
from aerobalance.estimation.forces import ForceSettings
from aerobalance.identification.base_excitation.paper_procedure import reference_fit
from aerobalance.identification.base_excitation.sine_dwell import find_dwells
from aerobalance.io import read, read_table, write_recording
from aerobalance.io.artefacts import provenance
from aerobalance.io.dynamics_file import read_dynamics
from aerobalance.io.safe_write import replacing
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording
from aerobalance.recording.version import VERSION
from aerobalance.simulation import ARMATURE_MASS, CableCut, Sensor, SteppedSine, Unsteadiness, VibrationRig
from aerobalance.simulation.published import CABLE_CUT, SECOND_FREQUENCY, VIBRATION_RIG, PublishedBalance

Result = dict[str, Any]

STEPS: Final = (30.0, 60.0, *np.arange(100.0, 600.0, 100.0).tolist(), 550.0, 600.0, 620.0, 635.0, 652.5, 665.0,
                *np.arange(680.0, 750.0, 15.0).tolist(), 752.0, *np.arange(765.0, 830.0, 15.0).tolist(),
                *np.arange(850.0, 1001.0, 50.0).tolist())  # fmt: skip
"""Frequencies at which the vibration rig dwells [Hz]."""

RESONANCES: Final = (VIBRATION_RIG.frequency.value, SECOND_FREQUENCY.value)
"""Frequencies at which the paper's dwells were not steady [Hz]."""

CUT_NOISES: Final = (10.0, 2.0)
"""Noise of the balance in the cable cut [N]: as the paper states it, and that of the static calibration."""

CUT_DURATION: Final = 5.0
"""Length of a recording of the cable cut [s]."""

BAND: Final = 200.0
"""Band of the band-limited inverse shown beside the other methods [Hz]."""

SUMMARY: Final = ("mean_percent_of_step", "rms_percent_of_half_range", "largest_percent_of_half_range")
"""What the result repeats of the deviations after the cut."""


@dataclass(frozen=True, slots=True)
class _Run:
    """Folder of the demo and what has been warned about and taken for granted so far."""

    folder: Path
    warnings: list[Result]
    assumptions: list[str]

    def path(self, name: str) -> Path:
        return self.folder / name

    def note(self, step: str, result: Result) -> Result:
        """Keep the warnings of a step and hand its result on."""
        self.warnings.extend({"step": step, "text": text} for text in result["warnings"])
        return result


def run_demo(out: Path, *, seed: int | None = None) -> Result:
    """Run both experiments and write `report.html`, every file behind it, and the files that the examples name.

    Parameters
    ----------
    out
        Folder for the files; made where it is missing, files of the same names are replaced.
    seed
        Seed of all simulated noise; a fresh one is drawn, and reported, when it is not given.

    Returns
    -------
    dict
        ``report``, ``seed``, ``agreements`` (name, printed, computed, agrees), ``deviations`` and ``warnings``.

    Raises
    ------
    ValueError
        The folder cannot be made or written to.
    """
    seed = seed_for(out, seed)
    root = np.random.SeedSequence(seed)
    weighing, shaking, wandering, *cutting, examples = (np.random.default_rng(part) for part in root.spawn(6))
    run = _Run(out, [], [])
    write_examples(out, examples)
    masses = {
        "rig": _weigh(run, "rig", VIBRATION_RIG, pitch=np.arange(-90.0, 91.0, 15.0), generator=weighing),
        "cut": _weigh(run, "cut", CABLE_CUT, pitch=np.arange(-12.0, 13.0, 2.0), generator=weighing),
    }
    with PROGRESS.stage(0.1, 0.3, "rig, steady"):
        steady = _shake(run, "steady", noise=(0.05, 0.05), unsteadiness=None, generator=shaking)
    noise = (VIBRATION_RIG.dynamic_deviation.value, VIBRATION_RIG.acceleration_deviation.value)
    wander = Unsteadiness(width=4.0, correlation_time=0.005, near=RESONANCES)
    with PROGRESS.stage(0.3, 0.5, "rig, unsteady"):
        unsteady = _shake(run, "unsteady", noise=noise, unsteadiness=wander, generator=wandering)
    with PROGRESS.stage(0.5, 0.9, "cable cut"):
        given = list(zip(CUT_NOISES, cutting, strict=True))
        cuts = [_cut(run, level, generator) for level, generator in PROGRESS.each(given, "cut")]
    splits = [split_deviation(unsteady, frequency) for frequency in RESONANCES]
    agreements = agreements_of(masses, steady, cuts, splits)
    deviations = {
        "harmonic, steady": {"largest": worst_deviation(steady), "unit": "N"},
        "harmonic, unsteady": {
            f"{frequency:g} Hz": {"largest": split["deviation"], "unit": "N"}
            for frequency, split in zip(RESONANCES, splits, strict=True)
        },
        **{
            f"step, {cut['noise']:g} N noise, {row['method']}": {key: row[key] for key in SUMMARY}
            for cut in cuts
            for row in cut["deviations"]
        },
    }
    report = run.path("report.html")
    write_report(
        report,
        {
            "agreements": agreements,
            "figures": _figures(run, steady, unsteady, cuts),
            "rig_methods": [*rig_methods("steady, 0.05 m/s²", steady), *rig_methods("unsteady, 5 m/s²", unsteady)],
            "cut_methods": [row for cut in cuts for row in cut_methods(cut)],
            "cuts": cuts,
            "splits": splits,
            "unsteady_dwells": [dwell["frequency"] for dwell in unsteady["fit"]["dwells"] if not dwell["steady"]],
            "worst": worst_deviation(steady),
            "warnings": run.warnings,
            "assumptions": run.assumptions,
            "inputs": _inputs(run),
            "version": VERSION,
            "seed": seed,
            "coverage": COVERAGE,
            "band": BAND,
            "armature": ARMATURE_MASS,
        },
    )
    result: Result = {
        "report": str(report),
        "seed": seed,
        "agreements": [{key: row[key] for key in ("name", "printed", "computed", "agrees")} for row in agreements],
        "deviations": deviations,
        "warnings": [f"{item['step']}: {item['text']}" for item in run.warnings],
    }
    return {**result, "summary": summary(result)}


def summary(result: Result) -> str:
    """Short answer for people: the numbers that the paper prints, beside those found here."""
    rows = [
        (
            row["name"],
            *(
                answers.short(value) if isinstance(value, float) else str(value)
                for value in (row["printed"], row["computed"])
            ),
            "yes" if row["agrees"] else "NO",
        )
        for row in result["agreements"]
    ]
    agree = sum(row["agrees"] for row in result["agreements"])
    table = table_text("Both experiments of the paper, simulated", ("", "printed", "computed", "agrees"), rows)
    lines = [f"{agree} of {len(rows)} printed numbers agree", f"report: {result['report']}; seed {result['seed']}"]
    return "\n".join([table, *lines]) + "\n"


def _weigh(run: _Run, name: str, balance: PublishedBalance, *, pitch: Array, generator: np.random.Generator) -> Result:
    """Weigh with means of 1000 readings at each pitch [deg]; the balance has an offset of 0.2 % of half range."""
    deviation = balance.dynamic_deviation.value / np.sqrt(1000)
    offset = 0.002 * balance.half_range.value
    load = balance.mass * STANDARD_GRAVITY * np.sin(np.deg2rad(pitch)) + offset
    load = load + deviation * generator.standard_normal(pitch.size)
    path = run.path(f"weighing_{name}.csv")
    lines = ["pitch [deg],AF [N],u_AF [N]"]
    lines += [f"{angle:g},{force:.5f},{deviation:.5f}" for angle, force in zip(pitch, load, strict=True)]
    with replacing(path) as beside:
        beside.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return run.note(f"weigh {path.name}", weighing.weigh([path], run.path(f"mass_{name}.json")))


def _shake(
    run: _Run,
    name: str,
    *,
    noise: tuple[float, float],
    unsteadiness: Unsteadiness | None,
    generator: np.random.Generator,
) -> Result:
    """Record a stepped sine on the vibration rig, with noise of balance [N] and accelerometers [m/s^2]; identify."""
    accelerometer = Sensor(noise=noise[1])
    sensors = {
        "AF": Sensor(noise=noise[0]),
        "ground_acceleration": accelerometer,
        "live_acceleration": accelerometer,
    }
    drive = SteppedSine(STEPS, settle=0.05, hold=0.3, unsteadiness=unsteadiness)
    path = run.path(f"rig_{name}.csv")
    write_recording(path, VibrationRig(sensors=sensors).run(drive, generator).recording)
    result = run.note(
        f"identify rig {path.name}",
        identify.identify_rig(path, run.path(f"dynamics_rig_{name}.json"), mass=str(run.path("mass_rig.json"))),
    )
    found: Result = result["components"]["AF"]
    return found


def _cut(run: _Run, noise: float, generator: np.random.Generator) -> Result:
    """Record a cable cut with the given noise [N], identify, recover the force three ways, and judge it."""
    simulation = CableCut(sensors={"AF": Sensor(noise=noise)}).run(CUT_DURATION, generator)
    tag = f"{noise:g}N"
    path, dynamics = run.path(f"cut_{tag}.csv"), run.path(f"dynamics_cut_{tag}.json")
    write_recording(path, simulation.recording)
    truth = {"AF": Channel("AF", simulation.applied, "N")}
    write_recording(
        run.path(f"truth_{tag}.csv"), Recording.from_columns(simulation.recording.time, truth, name="truth")
    )
    result = run.note(
        f"identify decay {path.name}",
        identify.identify_decay(path, dynamics, mass=str(run.path("mass_cut.json"))),
    )
    methods: tuple[tuple[str, str, Method, float | None], ...] = (
        ("central differences", "paper", "paper", None),
        (f"inverse to {BAND:g} Hz", "band", "paper", BAND),
        ("smoother", "smoother", "smoother", None),
    )
    deviations = []
    for words, short, method, bandwidth in methods:
        out = run.path(f"force_{short}_{tag}.csv")
        estimated = run.note(
            f"force {path.name}, {words}",
            force.force(path, out, dynamics=dynamics, settings=ForceSettings(method, bandwidth)),
        )
        for text in estimated["components"]["AF"]["assumptions"]:
            if text not in run.assumptions:
                run.assumptions.append(text)
        judged = step_deviations(out, run.path(f"truth_{tag}.csv"), release=simulation.release)
        deviations.append({"method": words, **judged, "u": estimated["components"]["AF"]["uncertainty_rms"]})
    found: Result = result["components"]["AF"]
    return {**found, "noise": noise, "tag": tag, "release": simulation.release, "deviations": deviations}


def _figures(run: _Run, steady: Result, unsteady: Result, cuts: Sequence[Result]) -> dict[str, str]:
    dwells = find_dwells(read(run.path("rig_steady.csv")))
    relative, absolute = (
        reference_fit(dwells, mass=steady["mass"]["value"], phase=phase) for phase in identify.PHASES
    )
    rows, noisy = steady["fit"]["dwells"], unsteady["fit"]["dwells"]
    resonance = ResonanceFigure(
        frequency=_column(rows, "frequency"),
        measured=_column(rows, "measured"),
        calculated=_column(rows, "calculated"),
        noisy_frequency=_column(noisy, "frequency"),
        noisy_deviation=_column(noisy, "measured") - _column(noisy, "calculated"),
        noisy_uncertainty=_column(noisy, "accelerometer_noise"),
        paper=VIBRATION_RIG.deviations["harmonic at the natural frequencies"].value,
    )
    steps = [step_data(run.folder, cut["tag"], release=cut["release"]) for cut in cuts]
    line = LineFigure(relative.line_15, relative.natural_frequency, absolute.line_15)
    return {
        "line": line_figure(line),
        "resonance": resonance_figure(resonance),
        "ringing": ringing_figure(steps[0]),
        **{
            f"force_{cut['tag']}": force_figure(step, name=f"fig6-{cut['tag']}")
            for cut, step in zip(cuts, steps, strict=True)
        },
    }


def step_data(folder: Path, tag: str, *, release: float) -> StepFigure:
    """Read what Figures 5 and 6 show from the files of one cable cut.

    Parameters
    ----------
    folder
        Folder of the demo.
    tag
        Ending that its files share, such as ``"10N"``.
    release
        Instant of the release [s].
    """
    recording = read(folder / f"cut_{tag}.csv")
    force = read_table(folder / f"force_smoother_{tag}.csv", required=("time", "AF", "u_AF"))
    differences = read_table(folder / f"force_paper_{tag}.csv", required=("time", "AF", "u_AF"))
    dynamics: Dynamics = read_dynamics(folder / f"dynamics_cut_{tag}.json")["AF"]
    return StepFigure(
        time=recording.time - release,
        load=recording.channel("AF").values,
        truth=read(folder / f"truth_{tag}.csv").channel("AF").values,
        differences=differences.values("AF"),
        smoother=force.values("AF"),
        uncertainty=force.values("u_AF"),
        dynamics=dynamics,
    )


def _column(rows: Sequence[Result], key: str) -> Array:
    return np.array([row[key] for row in rows], dtype=np.float64)


def _inputs(run: _Run) -> list[dict[str, str]]:
    """Names and SHA-256 of the files that the commands read."""
    names = ["weighing_rig.csv", "weighing_cut.csv", "rig_steady.csv", "rig_unsteady.csv"]
    names += [f"cut_{level:g}N.csv" for level in CUT_NOISES]
    listed: Any = provenance([run.path(name) for name in names])["inputs"]
    return list(listed)
