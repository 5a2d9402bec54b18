"""Commands of the calibration: calibrate and compare-calibrations."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.app.commands.answers import rounded, short
from aerobalance.app.commands.shared import Result, check_out, collected_warnings, table_text
from aerobalance.balance.calibration.comparison import compare_calibrations
from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.calibration.fit import calibrate as fit_matrix
from aerobalance.balance.calibration.fit_warnings import warn_of_weaknesses
from aerobalance.balance.calibration.outliers import MOST_NAMED, outlier_text
from aerobalance.balance.calibration.quality import Quality, assess
from aerobalance.balance.load_formats import Geometry
from aerobalance.balance.matrix import BalanceMatrix, Way
from aerobalance.balance.terms import Model
from aerobalance.io import load_channel_map
from aerobalance.io.artefacts import provenance, write_json
from aerobalance.io.balance_file import calibration_payload, read_matrix, write_balance
from aerobalance.io.balfit_matrix import is_balfit_matrix
from aerobalance.io.kinds import PAGE
from aerobalance.io.schedule import read_schedule
from aerobalance.io.sheet_cells import is_workbook
from aerobalance.io.text_table import read_text
from aerobalance.recording.channel import Array
from aerobalance.recording.units import conversion

SHOWN_INTERACTIONS: Final = 6
"""Number of changed interactions that the short answer lists."""


def calibrate(
    path: Path,
    out: Path | None,
    *,
    model: Model = "auto",
    way: Way = "iterative",
    keep_aside: float = 0.0,
    capacities: Sequence[str] = (),
    distances: str | None = None,
    reading_noise: float | Mapping[str, float] = 0.0,
    leave_out: Sequence[str] = (),
    channel_map: Path | None = None,
    report: Path | None = None,
) -> Result:
    """Balance matrix and quality of the calibration from a load schedule, written to `out` and `report` if given."""
    check_out(out, path, channel_map, kind="balance")
    check_out(report, path, channel_map, out, kind=PAGE)
    chosen = None if channel_map is None else load_channel_map(channel_map)
    with collected_warnings() as collected:
        schedule = read_schedule(path, capacities=capacities_from(capacities), channel_map=chosen)
        schedule = schedule.without(leave_out).keeping_aside(keep_aside)
        if distances is not None:
            schedule = replace(schedule, geometry=geometry_from(distances))
        calibration = fit_matrix(schedule, model=model, way=way, reading_noise=reading_noise)
        quality = assess(calibration)
        warn_of_weaknesses(calibration, quality)
    found = calibration_payload(calibration, quality)
    settings = {
        "model": model,
        "way": way,
        "keep_aside": keep_aside,
        "capacities": list(capacities),
        "distances": distances,
        "leave_out": list(leave_out),
        "reading_noise": {
            "value": dict(reading_noise) if isinstance(reading_noise, Mapping) else reading_noise,
            "unit": "mV/V",
        },
    }
    if out is not None:
        inputs = [path] if channel_map is None else [path, channel_map]
        write_balance(out, calibration.matrix, found=found, inputs=inputs, settings=settings, warnings=collected)
    if report is not None:
        from aerobalance.app.reports.calibration_report import write_calibration_report  # noqa: PLC0415 - plotting is slow

        write_calibration_report(
            report, calibration, quality, warnings=collected, source=path, channel_map=channel_map
        )
    return {**found, "warnings": collected, "summary": summary(calibration, quality)}


def capacities_from(texts: Sequence[str]) -> dict[str, tuple[float, str]] | None:
    """Capacities from the command line, ``N1=2500 lbf`` each: value and unit by component; None without any.

    Raises
    ------
    ValueError
        A text is not of that form, its number is not positive and finite, or a component comes twice.
    """
    capacities: dict[str, tuple[float, str]] = {}
    for text in texts:
        match = re.fullmatch(
            r"\s*([^=]+?)\s*=\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![.\deE])\s*(\S.*?)\s*", text
        )
        if match is None:
            raise ValueError(f"--capacity must be like 'N1=2500 lbf', not {text!r}")
        name, value = match[1], float(match[2])
        if not 0 < value < np.inf:
            raise ValueError(f"--capacity {text!r}: a capacity must be positive and finite")
        if name in capacities:
            raise ValueError(f"--capacity gives {name} twice")
        capacities[name] = (value, match[3])
    return capacities or None


def reading_noise_from(texts: Sequence[str]) -> float | dict[str, float]:
    """Noise of the readings from the command line [mV/V]: one number, or ``rNF=0.0001`` for each bridge.

    A unit may follow, as in ``rNF=0.1 uV/V``; without one it is mV/V.

    Raises
    ------
    ValueError
        A text is neither, a bridge comes twice, or there is more than one number without a bridge.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, _, amount = (part.strip() for part in text.rpartition("="))
        number, *unit = amount.split(maxsplit=1)[:2] or [""]
        try:
            value = float(number) * (conversion(unit[0].strip("[]"), expected="mV/V").factor if unit else 1.0)
        except ValueError as error:
            raise ValueError(
                "--reading-noise must be one number in mV/V, or by bridge such as rNF=0.0001 or 'rNF=0.1 uV/V', not "
                f"{text!r}: {error}"
            ) from None
        if not 0 <= value < np.inf:
            raise ValueError(f"reading_noise must be zero or positive, and finite, not {text}")
        if name in found:
            raise ValueError(f"--reading-noise is given twice{f' for {name}' if name else ''}")
        found[name] = value
    if "" in found and len(found) > 1:
        raise ValueError("--reading-noise is one number for all bridges, or rNAME=VALUE for each, not both")
    return found.get("", found or 0.0)


def geometry_from(text: str) -> Geometry:
    """Distances of the gauges from the command line [m]: four numbers and a unit, ``1.5 1.5 1.25 1.25 in``."""
    words = text.replace(",", " ").split()
    try:
        values = conversion(words[-1], expected="m").inside([float(word) for word in words[:-1]])
        return Geometry(*(float(value) for value in values))
    except (ValueError, IndexError, TypeError) as error:
        raise ValueError(
            "--distances must be four distances from the balance's centre and a unit (forward and aft gauge of the "
            f"pitch plane, then of the yaw plane), like '1.5 1.5 1.25 1.25 in', not {text!r}: {error}"
        ) from None


def summary(calibration: Calibration, quality: Quality) -> str:
    """Short answer in text: a table with one line for each component, and remarks."""
    schedule = calibration.schedule
    rows = [("", "", *["% cap."] * 5, "%", "")]
    for i, name in enumerate(schedule.components):
        fit, direction = calibration.regressions[i], quality.directions[i]
        marks = (
            f"{100 * direction.difference:+.2f}{'*' if direction.bidirectional else ' '}" if direction.known else "-"
        )
        shares = (quality.deviation[i], quality.largest[i], fit.press, quality.hysteresis[i], quality.repeatability[i])
        percent = ("-" if np.isnan(share) else f"{100 * share:.3f}" for share in shares)
        rows.append((name, str(int(fit.included.sum())), *percent, marks, f"{fit.r_squared:.7f}"))
    table = table_text(
        f"{schedule.name}: model {calibration.model}, {calibration.way}",
        ("load", "terms", "std", "largest", "PRESS", "hysteresis", "repeats", "+/- differ", "R2"),
        rows,
    )
    left_out = calibration.unidentified_labels
    lines = [table, *["  * bidirectional (AIAA R-091)"] * any(d.bidirectional for d in quality.directions)]
    if left_out:
        lines.append(f"terms that the schedule cannot identify, left out: {', '.join(left_out)}")
    if calibration.tares_by_iteration is not None:
        difference = np.nanmax(np.abs(calibration.tares - calibration.tares_by_iteration) / schedule.capacities)
        lines.append(
            f"tares of {len(schedule.series_names)} series; both ways of finding them agree to "
            f"{100 * difference:.2g} % of capacity"
        )
    if quality.confirmation is not None and quality.confirmation_covered is not None:
        errors = ", ".join(
            f"{name} {100 * value:.3f}" for name, value in zip(schedule.components, quality.confirmation, strict=True)
        )
        lines.append(
            f"confirmation points, std in % of capacity: {errors}; "
            f"{100 * quality.confirmation_covered.mean():.0f} % within two u"
        )
    if schedule.left_out:
        lines.append(f"left out as asked ({points_text(len(schedule.left_out))}): {', '.join(schedule.left_out)}")
    if quality.outliers:
        shown = quality.outliers[:MOST_NAMED]
        lines += [f"outlier: {outlier_text(schedule, item)}" for item in shown]
        if len(quality.outliers) > len(shown):
            lines.append(f"and {len(quality.outliers) - len(shown)} outliers more, which --report and --json name")
    lines += [f"assumed: {text}" for text in schedule.assumptions]
    return "\n".join(lines) + "\n"


def points_text(count: int) -> str:
    """Return a number of points in words, such as ``2 points``."""
    return f"{count} point{'' if count == 1 else 's'}"


def compare(before: Path, after: Path, out: Path | None, *, model: Model = "auto") -> Result:
    """Differences between two calibrations of one balance; schedules are calibrated first, with the same model."""
    check_out(out, before, after, kind="calibration comparison")
    with collected_warnings() as collected:
        first, second = (_matrix_of(path, model) for path in (before, after))
        drift = compare_calibrations(first, second)
    result: Result = {
        "before": before.name,
        "after": after.name,
        "components": {
            item.component: {
                "sensitivity_before": item.before,
                "sensitivity_after": item.after,
                "unit": f"mV/V/({'N*m' if first.moments[i] else 'N'})",
                "drift_percent": 100 * item.relative,
                "u_percent": 100 * item.u,
                "p": item.p,
                "significant": item.significant,
                "largest_load_difference_percent_of_capacity": 100 * float(drift.load_difference[i]),
                **({} if drift.zero_change is None else {"zero_change_mV_per_V": float(drift.zero_change[i])}),
            }
            for i, item in enumerate(drift.sensitivities)
        },
        "interactions_change_percent": _interactions(first, drift.interactions, drift.u_interactions),
        "warnings": collected,
    }
    if out is not None:
        write_json(out, {"kind": "calibration comparison", **result, "provenance": provenance([before, after])})
    return {**result, "summary": comparison_text(result)}


def comparison_text(result: Result) -> str:
    """Short answer in text: the change of each component's sensitivity, and whether it is significant."""
    rows = []
    for name, found in result["components"].items():
        drift, u = rounded(found["drift_percent"], found["u_percent"])
        rows.append(
            (
                name,
                short(found["sensitivity_before"]),
                short(found["sensitivity_after"]),
                found["unit"],
                drift,
                u,
                "yes" if found["significant"] else "no",
                short(found["largest_load_difference_percent_of_capacity"], 3),
            )
        )
    table = table_text(
        f"{result['before']} and {result['after']}: sensitivities; u is the standard uncertainty of the change",
        ("", "before", "after", "", "change [%]", "u", "more than chance", "largest load apart [% cap.]"),
        rows,
    )
    lines = []
    for item in result["interactions_change_percent"][:SHOWN_INTERACTIONS]:
        change, u = rounded(item["change_percent_of_output_at_capacity"], item["u"])
        lines.append(
            f"interaction of {item['load']} on {item['gauge']}: {change} % of the output at capacity (u = {u})"
        )
    more = len(result["interactions_change_percent"]) - SHOWN_INTERACTIONS
    return "\n".join([table, *lines, *([f"and {more} interactions more"] if more > 0 else [])]) + "\n"


def _interactions(matrix: BalanceMatrix, change: Array, u: Array) -> list[Result]:
    """Interactions that have changed by more than three standard uncertainties, the largest change first."""
    found: list[Result] = [
        {
            "gauge": matrix.gauges[i],
            "load": matrix.components[j],
            "change_percent_of_output_at_capacity": 100 * float(change[i, j]),
            "u": 100 * float(u[i, j]),
        }
        for i in range(len(matrix.gauges))
        for j in range(len(matrix.components))
        if i != j and abs(change[i, j]) > 3 * u[i, j]
    ]
    return sorted(found, key=lambda one: -abs(one["change_percent_of_output_at_capacity"]))


def _matrix_of(path: Path, model: Model) -> BalanceMatrix:
    """Balance matrix from its file, or from a schedule by calibration."""
    text = "" if is_workbook(path) else read_text(path)
    if text.lstrip().startswith("{") or is_balfit_matrix(text[:4096]):
        return read_matrix(path)
    return fit_matrix(read_schedule(path), model=model).matrix
