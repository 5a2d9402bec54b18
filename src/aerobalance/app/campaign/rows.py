"""One row a run: numbers that sum up a run as plain data, in columns that any reader of tables takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from aerobalance.app.campaign.assignment import Run
from aerobalance.app.campaign.reduction import ReducedRun
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.uncertainty.mean_in_axes import MeanInAxes
from aerobalance.uncertainty.mean_loads import Errors

REDUCED: Final = "reduced"
ASIDE: Final = "set aside"

Row = dict[str, Any]
"""Numbers, texts, and lists of texts by column."""


def head_of(run: Run) -> Row:
    """Return the columns that every run has, also one that is set aside."""
    return {
        "run_name": run.name,
        "place": run.place,
        "file": run.file,
        "setup": run.setup,
        "zero_from": " ".join((*run.zeros, *run.zeros_after)),
        "tare_from": " ".join(run.tares),
        "balance_file": run.balance or "",
        "dynamics_file": run.dynamics or "",
    }


def set_aside(run: Run, reason: str, warnings: Sequence[str] = ()) -> Row:
    """Return the row of a run that could not be reduced."""
    reason = reason.removeprefix(f"{run.file}: ")  # as the row names it
    return {**head_of(run), **run.columns, "status": ASIDE, "reason": reason, "warnings": list(warnings)}


def row_of(run: Run, found: ReducedRun, warnings: Sequence[str]) -> Row:
    """Return the row of a run that was reduced."""
    force = found.force
    recording = force.recording
    row: Row = {
        **head_of(run),
        **run.columns,
        "status": REDUCED,
        "reason": "",
        "verdict": str(force.verdict),
        "doubts": [f"{one.component}, {one.kind}: {one}" for one in force.doubts],
        "doubt_kinds": sorted({one.kind for one in force.doubts}),
        "warnings": list(warnings),
        "duration_s": recording.duration,
        "rate_Hz": recording.rate,
        "samples": recording.samples,
        "alpha_deg": float(np.degrees(found.flow.alpha)) if found.flow.known else None,
        "beta_deg": float(np.degrees(found.flow.beta)) if found.flow.known else None,
        "pressure_Pa": found.flow.pressure,
    }
    mean = found.mean
    row |= _values([f"balance_{with_unit(name)}" for name in mean.components], mean.values, mean.errors)
    for name, part in force.items():
        label = with_unit(name)
        for key, what in (("rms_about_mean", "rms"), ("largest", "largest"), ("least", "least")):
            scalar = found.scalars[name][key]
            row[f"{what}_{label}"], row[f"u_{what}_{label}"] = scalar.value, scalar.u
        row[f"steps_{name}"] = len(part.steps)
        row[f"largest_step_{label}"] = max((step.height for step in part.steps), key=abs, default=None)
        for band in found.bands[name]:
            of_band = f"rms_{name}_{band.low:g}_{band.high:g}_Hz_{_plain(si_unit(name))}"
            row[of_band], row[f"u_{of_band}"] = band.rms, band.u
        row[f"u_sample_{label}"] = float(np.sqrt(np.nanmean(part.uncertainty**2)))
        row[f"resolved_to_{name}_Hz"] = part.bandwidth
    for axes, one in found.axes.items():
        row |= _in_axes(axes, one)
    lacking = [one.lacking for axes, one in found.axes.items() if axes.startswith("C_")]
    if any(lacking):
        row["lacking"] = [f"{name}: {', '.join(parts)}" for one in lacking for name, parts in one.items()]
    for mode in found.resonances:
        row |= _resonance(mode.name.replace(" ", "_"), mode.natural_frequency, mode.stiffness, mode.damping)
    for level in found.zero:
        label = with_unit(level.component)
        row[f"zero_{label}"], row[f"u_zero_{label}"] = level.value, level.u
        row[f"zero_drift_{label}"] = level.drift
    return row


def with_unit(component: str) -> str:
    """Return a component with its SI unit, as it stands in the names of columns: ``NF_N``, ``PM_Nm``."""
    return f"{component}_{_plain(si_unit(component))}"


def _plain(unit: str) -> str:
    return unit.replace("*", "")


def _values(labels: Sequence[str], values: Array, errors: Errors) -> Row:
    """Results with their uncertainty, and its parts that are drawn anew in each run, with each zero and each tare."""
    columns = {
        "": values,
        "u_": errors.uncertainty(),
        "u_run_": errors.of_run(),
        "u_zero_": errors.of_zero(),
        "u_tare_": errors.of_tare(),
    }
    return {
        f"{what}{label}": float(column[place]) if np.isfinite(values[place]) else None
        for place, label in enumerate(labels)
        for what, column in columns.items()
    }


def _in_axes(axes: str, one: MeanInAxes) -> Row:
    """Results in one set of axes, with the degrees of freedom of each."""
    pairs = zip(one.names, one.units, strict=True)
    labels = [name if axes.startswith("C_") else f"{axes}_{name}_{_plain(unit)}" for name, unit in pairs]
    row = _values(labels, one.values, one.errors)
    for label, freedom in zip(labels, one.freedom, strict=True):
        row[f"dof_{label}"] = None if row[label] is None else float(freedom)
    return row


def _resonance(
    name: str, frequency: float, stiffness: tuple[float, float] | None, damping: tuple[float, float] | None
) -> Row:
    """Relative changes of stiffness and damping against the dynamics."""
    row: Row = {f"natural_frequency_{name}_Hz": frequency}
    for label, found in (("k", stiffness), ("b", damping)):
        row[f"{label}_change_{name}"], row[f"u_{label}_change_{name}"] = found or (None, None)
    return row


def columns_of(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the columns of a table of rows, each where the first row has it."""
    names: dict[str, None] = {}
    for row in rows:
        names |= dict.fromkeys(row)
    return list(names)
