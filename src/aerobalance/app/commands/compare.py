"""The command compare: the estimator and the baseline methods side by side on one record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.loads import LoadSource, loads_result
from aerobalance.app.commands.shared import Result, check_out, collected_warnings, known_component
from aerobalance.app.commands.standings import standings
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.io import read
from aerobalance.io.coupled_part import modes_payload
from aerobalance.io.dynamics_file import read_any_dynamics
from aerobalance.io.kinds import PAGE
from aerobalance.recording.components import STANDARD_GRAVITY, si_unit
from aerobalance.recording.errors import FitError
from aerobalance.validation.baselines import THIS
from aerobalance.validation.compare import Comparison
from aerobalance.validation.compare import compare as compare_methods
from aerobalance.validation.scores import END_SHARE


def compare(
    path: Path,
    *,
    dynamics: Path,
    truth: Path | None = None,
    component: str | None = None,
    step: Path | None = None,
    half_range: float | Mapping[str, float] | None = None,
    gravity: float = STANDARD_GRAVITY,
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
    out: Path | None = None,
) -> Result:
    """Every method on one record: a table, a page, and errors where the truth is given.

    With `files` the record holds gauge outputs, and so does `step`. All components that are coupled are compared
    unless one is named; else it is AF unless another is named.
    """
    if component is not None:
        known_component(component)
    known = read_any_dynamics(dynamics)
    source = LoadSource(known, files, gravity, channel_map)
    inputs = [path, dynamics, *source.paths, *(file for file in (truth, step) if file is not None)]
    check_out(out, *inputs, kind=PAGE)
    coupled = known if isinstance(known, CoupledDynamics) else None
    names = (component or "AF",) if coupled is None or component is not None else known.components
    if names[0] not in known.components:
        raise FitError(f"{dynamics} has no {names[0]}; it has {', '.join(known.components)}")
    ranges = _half_ranges(half_range, names, coupled=coupled is not None)
    with collected_warnings() as collected:
        found = compare_methods(
            source.read(path),
            known,
            truth=None if truth is None else read(truth),
            components=names,
            step=None if step is None else source.read(step),
            gravity=gravity,
        )
    result = _separate_result(found, ranges) if coupled is None else _coupled_result(found, coupled, ranges)
    result = {"file": path.name, **result}
    if found.loads is not None:
        result["loads"] = loads_result(found.loads)
    result["warnings"] = collected
    if out is not None:
        from aerobalance.app.reports.compare_report import write_comparison  # noqa: PLC0415 - plotting is slow

        write_comparison(out, result, found, inputs=inputs)
        result["written"] = out.name
    return {**result, "summary": coupled_summary(result) if "components" in result else summary(result)}


def _separate_result(found: Comparison, half_ranges: Mapping[str, float]) -> Result:
    """Plain data on one component that rings for itself."""
    (component,) = found
    balance = found.responses[component]
    return {
        "component": component,
        "unit": si_unit(component),
        "natural_frequency": {"value": balance.natural_frequency, "unit": "Hz"},
        "further_modes": [
            {"natural_frequency": mode.natural_frequency, "damping_ratio": mode.damping_ratio, "share": mode.share}
            for mode in balance.further_modes
        ],
        **standings(
            found[component],
            found.truths.get(component),
            half_range=half_ranges.get(component),
            unit=si_unit(component),
        ),
    }


def _coupled_result(found: Comparison, dynamics: CoupledDynamics, half_ranges: Mapping[str, float]) -> Result:
    """Plain data on coupled components."""
    result: Result = {
        "modes": modes_payload(dynamics),
        "components": {
            name: {
                "unit": si_unit(name),
                **standings(rows, found.truths.get(name), half_range=half_ranges.get(name), unit=si_unit(name)),
            }
            for name, rows in found.items()
        },
    }
    return {**result, "table": table_of(result), "table_holds": words_for_table(result)}


def _half_ranges(
    given: float | Mapping[str, float] | None, names: Sequence[str], *, coupled: bool
) -> Mapping[str, float]:
    if given is None or isinstance(given, Mapping):
        return given or {}
    if coupled:
        raise ValueError("--half-range of coupled components is given by component: NF=2000")
    return dict.fromkeys(names, given)


def summary(result: Result) -> str:
    """Lay the comparison out as a table for people."""
    judged = result["half_range"] is not None
    heads = ("rms", "%", "plateau", "edge", "mean", "largest", "%") if judged else ("mean", "rms about", "apart")
    keys = [f"{row['name']}{' *' if row['setting'] != 'customary' else ''}" for row in result["rivals"]]
    width = max(len(key) for key in keys)
    f0 = result["natural_frequency"]["value"]
    head = f"{result['file']}: {result['component']} [{result['unit']}], natural frequency {f0:.5g} Hz"
    further = [f"{mode['natural_frequency']:.5g} Hz (share {mode['share']:.3g})" for mode in result["further_modes"]]
    lines = [f"{head}, further {', '.join(further)}" if further else head]
    if judged:
        half = result["half_range"]
        lines += [f"deviation from the truth; {result['scored']}"]
        lines += [
            f"%: of half range, {half['value']:.5g} {half['unit']} ({half['from']})"
            if half["value"] > 0
            else f"%: {half['from']}"
        ]
        lines += ["*: its one tuning number chosen on the truth, which no user has"]
    else:
        lines += ["no truth given; apart: rms difference from this estimator"]
    lines += ["", " ".join([" " * width, *(f"{head:>9}" for head in heads)])]
    for key, row in zip(keys, result["rivals"], strict=True):
        cells = " ".join(f"{_cell(value):>9}" for value in _cells(row, judged))
        lines.append(f"{key:<{width}} {cells if row['lacking'] is None else '  not run: ' + row['lacking']}")
    marked = [row for row in result["rivals"] if "one mode only" in row["note"]]
    notes = [f"{row['name']}: {row['note'].split('; ')[-1]}" for row in marked]
    lines += ["", *dict.fromkeys(notes), *result["verdict"]]
    return "\n".join(lines).rstrip() + "\n"


def _cells(row: Result, judged: bool) -> list[float]:
    if row["lacking"] is not None:
        return []
    if not judged:
        return [row[key] for key in ("force_mean", "force_rms_about_mean", "apart_from_this_estimator_rms")]
    share = row["percent_of_half_range"]
    return [row["rms"], share["rms"], row["plateau"], row["edge"], row["mean"], row["largest"], share["largest"]]


def _cell(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "-"


def table_of(result: Result) -> list[Result]:
    """One row per method and setting, one number per component; what could not be run has a reason instead."""
    parts: Mapping[str, Result] = result["components"]
    percent = _in_percent(parts.values())
    order = dict.fromkeys((row["name"], row["setting"]) for part in parts.values() for row in part["rivals"])
    table = []
    for name, setting in order:
        numbers: dict[str, float] = {}
        reasons: dict[str, list[str]] = {}
        for component, part in parts.items():
            for row in part["rivals"]:
                if (row["name"], row["setting"]) != (name, setting):
                    continue
                if row["lacking"] is None:
                    numbers[component] = _judged_by(row, percent=percent)
                else:
                    reasons.setdefault(row["lacking"], []).append(component)
        table.append({"name": name, "setting": setting, "numbers": numbers, "not_run": reasons})
    return table


def _in_percent(parts: Iterable[Result]) -> bool:
    """Whether the table of all components is in percent of half range: only where each has one."""
    return all(part["half_range"] is not None and part["half_range"]["value"] > 0 for part in parts)


def _judged_by(row: Result, *, percent: bool) -> float:
    """What a row of one component puts into the table of all."""
    if "rms" not in row:
        return float(row["apart_from_this_estimator_rms"])
    return float(row["percent_of_half_range"]["rms"] if percent else row["rms"])


def words_for_table(result: Result) -> str:
    """What the numbers of the table are."""
    parts = list(result["components"].values())
    if parts[0]["half_range"] is None:
        return f"no truth given; rms difference from {THIS}, each in its own unit"
    if _in_percent(parts):
        said = ", ".join(dict.fromkeys(part["half_range"]["from"] for part in parts))
        return f"rms deviation from the truth in percent of half range ({said}), {100 * END_SHARE:g} % at each end out"
    return f"rms deviation from the truth, each in its own unit, {100 * END_SHARE:g} % at each end out"


def coupled_summary(result: Result) -> str:
    """Lay the comparison of coupled components out as a table for people."""
    names = list(result["components"])
    rows = result["table"]
    keys = [f"{row['name']}{' *' if row['setting'] != 'customary' else ''}" for row in rows]
    width = max(len(key) for key in keys)
    modes = ", ".join(f"{mode['natural_frequency']:.4g}" for mode in result["modes"])
    lines = [f"{result['file']}: coupled components, modes at {modes} Hz", result["table_holds"]]
    lines += ["*: its one tuning number chosen on the truth, which no user has", ""]
    lines += [" ".join([" " * width, *(f"{name:>9}" for name in names)])]
    for key, row in zip(keys, rows, strict=True):
        cells = (f"{row['numbers'][name]:.3g}" if name in row["numbers"] else "-" for name in names)
        lines.append(" ".join([f"{key:<{width}}", *(f"{cell:>9}" for cell in cells)]))
    lines += [""]
    for row in rows:
        lines += [f"{row['name']}, not run on {', '.join(some)}: {why}" for why, some in row["not_run"].items()]
    lines += [f"{name}, {text}" for name, part in result["components"].items() for text in part["verdict"][:1]]
    return "\n".join(lines).rstrip() + "\n"
