"""One row a run: numbers that sum up a run as plain data, in columns that any reader of tables takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from aerobalance.app.campaign.assignment import Run
from aerobalance.app.campaign.reduction import ReducedRun
from aerobalance.app.campaign.resolved import Resolved
from aerobalance.recording.components import si_unit

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
    row |= _means(found)
    for name, part in force.items():
        unit = _unit(si_unit(name))
        for key, label in (("rms_about_mean", "rms"), ("largest", "largest"), ("least", "least")):
            scalar = found.scalars[name][key]
            row[f"{label}_{name}_{unit}"], row[f"u_{label}_{name}_{unit}"] = scalar.value, scalar.u
        row[f"steps_{name}"] = len(part.steps)
        heights = sorted((step.height for step in part.steps), key=abs)
        row[f"largest_step_{name}_{unit}"] = heights[-1] if heights else None
        for band in found.bands[name]:
            label = f"rms_{name}_{band.low:g}_{band.high:g}_Hz_{unit}"
            row[label], row[f"u_{label}"] = band.rms, band.u
        row[f"u_sample_{name}_{unit}"] = float(np.sqrt(np.nanmean(part.uncertainty**2)))
        row[f"resolved_to_{name}_Hz"] = part.bandwidth
    for axes, one in found.axes.items():
        row |= _resolved(axes, one)
    for mode in found.resonances:
        row |= _resonance(mode.name.replace(" ", "_"), mode.natural_frequency, mode.stiffness, mode.damping)
    for level in found.zero:
        label = f"{level.component}_{_unit(si_unit(level.component))}"
        row[f"zero_{label}"], row[f"u_zero_{label}"] = level.value, level.u
        row[f"zero_drift_{label}"] = level.drift
    return row


def _unit(unit: str) -> str:
    return unit.replace("*", "")


def _means(found: ReducedRun) -> Row:
    mean, row = found.mean, {}
    whole, own, zero = mean.errors.uncertainty(), mean.errors.of_run(), mean.errors.of_zero()
    for place, name in enumerate(mean.components):
        label = f"balance_{name}_{_unit(si_unit(name))}"
        row[label], row[f"u_{label}"] = float(mean.values[place]), float(whole[place])
        row[f"u_run_{label}"], row[f"u_zero_{label}"] = float(own[place]), float(zero[place])
    return row


def _resolved(axes: str, one: Resolved) -> Row:
    row: Row = {}
    whole, own, zero = one.errors.uncertainty(), one.errors.of_run(), one.errors.of_zero()
    for place, (name, unit) in enumerate(zip(one.names, one.units, strict=True)):
        label = name if axes.startswith("C_") else f"{axes}_{name}_{_unit(unit)}"
        if not np.isfinite(one.values[place]):
            row |= dict.fromkeys([label, f"u_{label}", f"u_run_{label}", f"u_zero_{label}", f"dof_{label}"])
            continue
        row[label], row[f"u_{label}"] = float(one.values[place]), float(whole[place])
        row[f"u_run_{label}"], row[f"u_zero_{label}"] = float(own[place]), float(zero[place])
        row[f"dof_{label}"] = float(one.freedom[place])
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
