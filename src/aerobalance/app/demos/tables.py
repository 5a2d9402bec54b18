"""Tables 1 and 2 of [Gorbushin2020]_ made anew: every baseline method that can be run, on both experiments, simulated.

What others printed stands beside what is measured here. A simulated record has a known truth, so that each method is
judged by the force that was applied and not by another method.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.app.commands.shared import collected_warnings, seed_for
from aerobalance.app.commands.standings import verdict
from aerobalance.app.reports.page import write_page
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.base_excitation.rig import identify_rig
from aerobalance.identification.free_decay.fit import identify_decay
from aerobalance.recording.channel import Array
from aerobalance.recording.version import VERSION
from aerobalance.simulation import CableCut, Simulation, SteppedSine, Sweep, VibrationRig
from aerobalance.simulation.published import (
    CABLE_CUT,
    SECOND_FREQUENCY,
    TABLE_1,
    TABLE_2,
    VIBRATION_RIG,
    PublishedBalance,
)
from aerobalance.validation.baselines import BaselineEstimate, BaselineSettings, estimates
from aerobalance.validation.fir_inverse import MeasuredResponse, response_of_record
from aerobalance.validation.scores import Truth

Result = dict[str, Any]

SETTLED, SOON = 0.05, 0.005
"""Time after a release from which the mean counts, and from which momentary deviations do [s]."""

IMPULSE: Final = 0.01
"""Length of the impulse, half a sine [s]."""

PUSHED: Final = 1.0003
"""Instant at which the impulse begins [s]."""

BEFORE, AFTER = 0.05, 0.1
"""Time before and after the impulse within which its mean force counts [s]; beyond it there is only noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """One simulated record with its truth.

    Attributes
    ----------
    name
        Short name, at the head of a column.
    balance
        The balance it is made with.
    simulation
        Record and truth.
    excitation
        Height, peak or amplitude of what excites it [N].
    kind
        ``"step"``, ``"impulse"`` or ``"harmonic"``.
    """

    name: str
    balance: PublishedBalance
    simulation: Simulation
    excitation: float
    kind: str

    def deviations(self, estimate: Array, truth: Truth) -> dict[str, float | None]:
        """Mean and momentary deviation in percent: of the excitation, and of half range."""
        error = estimate - truth.values
        time = self.simulation.recording.time
        late = truth.scored
        soon = truth.scored
        if self.kind == "step":
            late = truth.scored & (time >= self.simulation.release + SETTLED)
            soon = truth.scored & ((time >= self.simulation.release + SOON) | (time < self.simulation.release - SOON))
        mean = None
        if self.kind == "step":
            mean = 100 * abs(float(np.mean(error[late]))) / self.excitation
        elif self.kind == "impulse":
            late = (time >= PUSHED - BEFORE) & (time <= PUSHED + IMPULSE + AFTER)
            mean = 100 * abs(float(np.sum(error[late])) / float(np.sum(truth.values)))
        largest = 100 * float(np.max(np.abs(error[soon])))
        return {
            "mean_percent": mean,
            "momentary_percent_of_excitation": largest / self.excitation,
            "momentary_percent_of_half_range": largest / self.balance.half_range.value,
        }


def run_tables(out: Path, *, seed: int | None = None) -> Result:
    """Run all experiments, judge every baseline method on each, and write `tables.html`.

    Parameters
    ----------
    out
        Folder for the page; made where it is missing.
    seed
        Seed of all simulated noise; a fresh one is drawn, and reported, when it is not given.

    Raises
    ------
    ValueError
        The folder cannot be made or written to.
    """
    seed = seed_for(out, seed)
    tunnel, rig = (np.random.default_rng(part) for part in np.random.SeedSequence(seed).spawn(2))
    experiments = []
    with collected_warnings() as collected:
        for balance, parts in ((CABLE_CUT, tunnel_experiments(tunnel)), (VIBRATION_RIG, rig_experiments(rig))):
            generator = tunnel if balance is CABLE_CUT else rig
            dynamics, response = _identified(balance, generator)
            experiments += [_judged(part, dynamics, response) for part in parts]
    result: Result = {
        "page": str(out / "tables.html"),
        "seed": seed,
        "table_1": {"printed": _printed(TABLE_1), "measured": _column_table(experiments, "mean_percent")},
        "table_2": {
            "printed": _printed(TABLE_2),
            "measured_of_half_range": _column_table(experiments, "momentary_percent_of_half_range"),
            "measured_of_excitation": _column_table(experiments, "momentary_percent_of_excitation"),
        },
        "experiments": experiments,
        "warnings": collected,
    }
    write_page(out / "tables.html", "tables.html.j2", {"found": result, "version": VERSION})
    return {**result, "summary": summary(result)}


def tunnel_experiments(generator: np.random.Generator) -> list[Experiment]:
    """Balance 6-EB-128-1 in the T-128 tunnel: a cable cut, an impulse, and sines near and at resonance."""
    step = CABLE_CUT.excitation.value
    f0 = CABLE_CUT.dynamics.natural_frequency

    def impulse(time: Array) -> Array:
        since = time - PUSHED
        return np.where((since > 0) & (since < IMPULSE), step * np.sin(np.pi * since / IMPULSE), 0.0)

    def pushed(name: str, signal: Callable[[Array], Array], excitation: float, kind: str) -> Experiment:
        simulation = CableCut(cable_force=0.0, applied=signal).run(3.0, generator)
        return Experiment(name, CABLE_CUT, simulation, excitation, kind)

    return [
        Experiment("T-128 step 1.02 kN", CABLE_CUT, CableCut().run(5.0, generator), step, "step"),
        pushed("T-128 impulse 10 ms", impulse, step, "impulse"),
        pushed("T-128 sine 60 Hz, 100 N", _sine(60.0, 100.0), 100.0, "harmonic"),
        pushed(f"T-128 sine {f0:.1f} Hz, 10 N", _sine(f0, 10.0), 10.0, "harmonic"),
    ]


def rig_experiments(generator: np.random.Generator) -> list[Experiment]:
    """Balance 6F-540: the ground end shaken at both natural frequencies, and sines on its live end."""
    drive = VIBRATION_RIG.excitation.value
    found = []
    for frequency in (VIBRATION_RIG.frequency.value, SECOND_FREQUENCY.value):
        simulation = VibrationRig().run(SteppedSine((frequency,), settle=0.1, hold=0.3), generator)
        found.append(Experiment(f"rig shaken {frequency:g} Hz", VIBRATION_RIG, simulation, drive, "harmonic"))
    still = CableCut(dynamics=VIBRATION_RIG.dynamics, cable_force=0.0, rate=VIBRATION_RIG.rate.value).sensors
    sensors = {**VibrationRig().sensors, "pitch": still["pitch"]}
    for frequency in (600.0, VIBRATION_RIG.frequency.value):
        rig = CableCut(
            dynamics=VIBRATION_RIG.dynamics, cable_force=0.0, rate=VIBRATION_RIG.rate.value, sensors=sensors,
            applied=_sine(frequency, drive),
        )  # fmt: skip
        name = f"rig sine {frequency:g} Hz, 10 N"
        found.append(Experiment(name, VIBRATION_RIG, rig.run(0.4, generator), drive, "harmonic"))
    return found


def _sine(frequency: float, amplitude: float) -> Callable[[Array], Array]:
    return lambda time: np.asarray(amplitude * np.sin(2 * np.pi * frequency * time))


def _identified(balance: PublishedBalance, generator: np.random.Generator) -> tuple[Dynamics, MeasuredResponse]:
    """Dynamics identified from a record of its own, with the paper's noise, and a measured step response."""
    f0, rate = balance.frequency.value, balance.rate.value
    if balance is CABLE_CUT:
        record = CableCut(release=0.5002).run(5.0, generator).recording
        dynamics = identify_decay(record, mass=balance.mass).dynamics
    else:
        shaken = VibrationRig().run(Sweep(20.0, 1000.0, 4.0), generator).recording
        dynamics = identify_rig(shaken, mass=balance.mass).dynamics
        sensors = {"AF": VibrationRig().sensors["AF"]}
        lever = CableCut(dynamics=balance.dynamics, cable_force=-50.0, release=0.05002, rate=rate, sensors=sensors)
        record = lever.run(0.3, generator).recording
    return dynamics, response_of_record(record, "AF", natural_frequency=f0, rate=rate)


def _judged(experiment: Experiment, dynamics: Dynamics, response: MeasuredResponse) -> Result:
    """All baseline methods on one experiment."""
    recording = experiment.simulation.recording
    truth = Truth.of(experiment.simulation.applied, rate=recording.rate, natural_frequency=dynamics.natural_frequency)
    found = estimates(recording, dynamics, settings=BaselineSettings(response=response), truth=truth)
    rows = [_row(row, experiment, truth) for row in found]
    return {"name": experiment.name, "kind": experiment.kind, "rivals": rows, "verdict": verdict(rows)}


def _row(row: BaselineEstimate, experiment: Experiment, truth: Truth) -> Result:
    facts = {
        "name": row.name,
        "setting": "tuned on the truth" if row.oracle else "customary",
        "settings": row.settings,
        "lacking": row.lacking or None,
    }
    if not row.ran:
        return facts
    score = truth.score(row.values)
    scores = {
        "rms": score.rms,
        "plateau": score.plateau,
        "edge": score.edge,
        "mean": score.mean,
        "largest": score.largest,
    }
    return {**facts, **scores, **experiment.deviations(row.values, truth)}


def _printed(table: Sequence[Any]) -> list[Result]:
    return [
        {"source": row.source, "method": row.method, "percent": row.deviation.value, "where": row.deviation.where}
        for row in table
    ]


def _column_table(experiments: Sequence[Result], key: str) -> list[Result]:
    """One row per method and setting, one entry per experiment that has such a deviation."""
    rows: dict[tuple[str, str], dict[str, float]] = {}
    for experiment in experiments:
        for row in experiment["rivals"]:
            if row.get(key) is not None:
                rows.setdefault((row["name"], row["setting"]), {})[experiment["name"]] = row[key]
    order = list(dict.fromkeys((row["name"], row["setting"]) for item in experiments for row in item["rivals"]))
    return [
        {"method": name, "setting": setting, "percent": rows[name, setting]}
        for name, setting in order
        if (name, setting) in rows
    ]


def summary(result: Result) -> str:
    """Lay both tables out for a terminal."""
    lines: list[str] = []
    parts = (
        ("Table 1. Mean axial force, relative deviation [%]", result["table_1"], "measured", "of step or impulse"),
        ("Table 2. Momentary axial force [%]", result["table_2"], "measured_of_half_range", "of half range"),
        ("", result["table_2"], "measured_of_excitation", "of step, peak or amplitude"),
    )
    for title, table, key, unit in parts:
        if title:
            lines += [title, "", "printed"]
            lines += [f"  {row['percent']:>6g}  {row['source']}: {row['method']}" for row in table["printed"]]
        names = list(dict.fromkeys(name for row in table[key] for name in row["percent"]))
        lines += ["", f"measured here, {unit} (*: tuned on the truth)"]
        lines += [f"  ({number}) {name}" for number, name in enumerate(names, 1)]
        lines += ["", " ".join([" " * 30, *(f"{f'({number})':>8}" for number in range(1, len(names) + 1))])]
        for row in table[key]:
            label = row["method"] + (" *" if row["setting"] != "customary" else "")
            cells = (f"{row['percent'][name]:.3g}" if name in row["percent"] else "-" for name in names)
            lines.append(" ".join([f"{label:<30}", *(f"{cell:>8}" for cell in cells)]))
        lines.append("")
    lines.append("Where this estimator is not first or tied")
    worse = [
        f"  {item['name']}: {text}"
        for item in result["experiments"]
        for text in item["verdict"]
        if "NOT first" in text
    ]
    lines += worse or ["  nowhere"]
    lines += ["", f"page: {result['page']}", f"seed: {result['seed']}"]
    return "\n".join(lines) + "\n"
