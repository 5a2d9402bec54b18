"""What the demo found beside what was printed and what was true: rows of the report's tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.io import read, read_table
from aerobalance.simulation import ARMATURE_MASS
from aerobalance.simulation.published import (
    CABLE_CUT,
    SECOND_FREQUENCY,
    TABLE_1,
    VIBRATION_RIG,
    Printed,
    PublishedBalance,
)

Result = dict[str, Any]

COVERAGE: Final = 3.0
"""Standard uncertainties that a computed number is given either way before it is said to disagree."""


def step_deviations(force: Path, truth: Path, *, release: float) -> Result:
    """Force recovered less force applied after the release: mean, rms (from 50 ms on) and largest (from 5 ms on)."""
    recovered = read_table(force, required=("time", "AF", "u_AF"))
    time = recovered.values("time")
    error = recovered.values("AF") - read(truth).channel("AF").values
    late, early = error[time >= release + 0.05], error[time >= release + 0.005]
    half_range, step = CABLE_CUT.half_range.value, CABLE_CUT.excitation.value
    mean, rms, largest = float(late.mean()), float(np.sqrt(np.mean(late**2))), float(np.abs(early).max())
    return {
        "mean": mean,
        "mean_percent_of_step": 100 * abs(mean) / step,
        "rms": rms,
        "rms_percent_of_half_range": 100 * rms / half_range,
        "largest": largest,
        "largest_percent_of_half_range": 100 * largest / half_range,
        "unit": "N",
    }


def worst_deviation(rig: Result) -> float:
    """Largest difference between the amplitude measured and by (12) over all dwells [N]."""
    return max(abs(float(dwell["measured"] - dwell["calculated"])) for dwell in rig["fit"]["dwells"])


def split_deviation(rig: Result, frequency: float) -> Result:
    """Split the largest deviation near a frequency into non-steadiness, accelerometer noise and model.

    What non-steadiness does not explain is noise and model together. The model is charged with what exceeds two
    standard deviations of the noise.
    """
    dwells = rig["fit"]["dwells"]
    nearest = min(abs(dwell["frequency"] - frequency) for dwell in dwells)
    near = [dwell for dwell in dwells if abs(dwell["frequency"] - frequency) <= max(2.0, nearest)]
    dwell = max(near, key=lambda item: abs(item["measured"] - item["calculated"]))
    allowed = 2 * dwell["accelerometer_noise"]
    rest = dwell["model"]
    noise = float(np.clip(rest, -allowed, allowed))
    return {
        "nominal": frequency,
        **{key: dwell[key] for key in ("frequency", "measured", "calculated", "steady", "unsteadiness")},
        "deviation": dwell["measured"] - dwell["calculated"],
        "noise_u": dwell["accelerometer_noise"],
        "noise": noise,
        "model": rest - noise,
    }


def agreements_of(masses: Result, steady: Result, cuts: Sequence[Result], splits: Sequence[Result]) -> list[Result]:
    """Every printed number beside the computed one."""
    rig, cut, paper_cut = VIBRATION_RIG, CABLE_CUT, cuts[0]
    f0, M = steady["natural_frequency"], masses["rig"]["mass"]
    rows = [
        _meets("6F-540: moving mass M", _sum(rig), M),
        _meets("6F-540: natural frequency f₀", rig.frequency, f0),
        _meets("6F-540: stiffness k", rig.stiffness, steady["stiffness"], scale=1e6),
        _meets("6F-540: damping b", rig.damping, steady["damping"]),
        _meets("6F-540: damping ratio ζ", _ratio(rig), steady["damping_ratio"]),
        _meets("6F-540: frequency of the whole rig", SECOND_FREQUENCY, _free_free(f0, M)),
        _below("6F-540: harmonic deviation, steady", rig.deviations["harmonic"], worst_deviation(steady)),
    ]
    natural = rig.deviations["harmonic at the natural frequencies"]
    rows += [
        _below(f"6F-540: harmonic deviation at {split['nominal']:g} Hz", natural, abs(split["deviation"]))
        for split in splits
    ]
    smoother = paper_cut["deviations"][-1]
    rows += [
        _meets("6-EB-128-1: moving mass M", _sum(cut), masses["cut"]["mass"]),
        _meets("6-EB-128-1: frequency f", cut.frequency, paper_cut["fit"]["damped_frequency"]),
        _meets("6-EB-128-1: stiffness k", cut.stiffness, paper_cut["stiffness"], scale=1e6),
        _meets("6-EB-128-1: damping b", cut.damping, paper_cut["damping"]),
        _meets("6-EB-128-1: damping ratio ζ", _ratio(cut), paper_cut["damping_ratio"]),
        _below("6-EB-128-1: mean deviation", cut.deviations["mean"], abs(smoother["mean"])),
        _below(
            "6-EB-128-1: mean deviation, of the step",
            next(row.deviation for row in TABLE_1 if row.source == "paper"),
            smoother["mean_percent_of_step"],
        ),
        _below(
            "6-EB-128-1: momentary deviation, of half range",
            cut.deviations["momentary, of half range"],
            smoother["largest_percent_of_half_range"],
        ),
    ]
    return rows


def _sum(balance: PublishedBalance) -> Printed:
    """Moving mass as the sum of two printed masses."""
    parts = balance.live_end_mass, balance.load_mass
    return Printed(balance.mass, sum(part.half_digit for part in parts), "kg", f"{parts[0].where}, sum of two")


def _ratio(balance: PublishedBalance) -> Printed:
    """Damping ratio that the printed b, k and M give."""
    return Printed(round(balance.dynamics.damping_ratio, 4), 0.00005, "1", "from the printed b, k and M")


def _free_free(frequency: Result, mass: Result) -> Result:
    """Frequency of live end against armature f0 sqrt(1 + M/m), the armature's mass m assumed [Hz]."""
    f0, M = frequency["value"], mass["value"]
    value = f0 * np.sqrt(1 + M / ARMATURE_MASS)
    u = np.hypot(value / f0 * frequency["u"], f0**2 / (2 * value * ARMATURE_MASS) * mass["u"])
    return {"value": float(value), "u": float(u)}


def _meets(name: str, printed: Printed, quantity: Result, *, scale: float = 1.0) -> Result:
    value, u = quantity["value"], quantity["u"]
    agrees = printed.overlaps(value - COVERAGE * u, value + COVERAGE * u)
    return _row(name, printed) | {"computed": value, "u": u, "scale": scale, "limit": False, "agrees": bool(agrees)}


def _below(name: str, printed: Printed, value: float) -> Result:
    agrees = value <= printed.high
    return _row(name, printed) | {"computed": value, "u": 0.0, "scale": 1.0, "limit": True, "agrees": bool(agrees)}


def _row(name: str, printed: Printed) -> Result:
    """The printed half of a row."""
    return {
        "name": name,
        "printed": printed.value,
        "half_digit": printed.half_digit,
        "unit": printed.unit,
        "where": printed.where,
    }


def rig_methods(record: str, rig: Result) -> list[Result]:
    """Results of every method on a record of the vibration rig, values with standard uncertainties."""
    rows = [
        {
            "record": record,
            "method": "complex response, maximum likelihood",
            "frequency": _pair(rig["natural_frequency"]),
            "stiffness": _pair(rig["stiffness"]),
            "damping": _pair(rig["damping"]),
        }
    ]
    for fit in rig["fit"]["reference"].values():
        if isinstance(fit, dict):
            frequency, stiffness = fit["natural_frequency"], fit["stiffness"]
            u_stiffness = 2 * stiffness["value"] * frequency["u"] / frequency["value"]
            rows.append(
                {
                    "record": record,
                    "method": fit["method"],
                    "frequency": _pair(frequency),
                    "stiffness": (stiffness["value"], u_stiffness),
                    "damping": _pair(fit["damping"]),
                }
            )
    return rows


def cut_methods(cut: Result) -> list[Result]:
    """Results of every method on a record of the cable cut, values with standard uncertainties where there are any."""
    record = f"noise {cut['noise']:g} N"
    rows = [
        {
            "record": record,
            "method": "waveform, least squares",
            "frequency": _pair(cut["fit"]["damped_frequency"]),
            "stiffness": _pair(cut["stiffness"]),
            "damping": _pair(cut["damping"]),
        }
    ]
    reference = cut["fit"]["reference"]
    if "failed" not in reference:
        quantities = {name: (reference[name]["value"], None) for name in ("frequency", "stiffness", "damping")}
        rows.append({"record": record, "method": "extrema (7), stiffness by (20)", **quantities})
    return rows


def _pair(quantity: Result) -> tuple[float, float | None]:
    return quantity["value"], quantity.get("u")
