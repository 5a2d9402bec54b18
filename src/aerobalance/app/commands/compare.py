"""The command compare: the rivals side by side on one record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.loads import Source, loads_account
from aerobalance.app.commands.shared import Account, check_out, doubts, known_component
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import dynamics_of
from aerobalance.dynamics.single import Dynamics
from aerobalance.io import read
from aerobalance.io.dynamics_file import read_any_dynamics
from aerobalance.io.kinds import PAGE
from aerobalance.recording.components import STANDARD_GRAVITY, si_unit
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording
from aerobalance.validation.baselines import THIS, RivalEstimate, Settings, estimates
from aerobalance.validation.fir_inverse import MeasuredResponse, response_of_record
from aerobalance.validation.scores import EDGE_TIME, END_SHARE, Truth, truth_on_clock

MEASURES: Final = ("rms", "plateau", "edge", "mean", "largest")
"""What a deviation is judged by."""

NAMES: Final = {"plateau": "rms on the plateaus", "edge": "rms at the edges"}
"""Words for measures whose names are short."""

TIED: Final = 1.01
"""Ratio of two deviations up to which they are tied."""


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
) -> Account:
    """Every rival on one record: a table, a page, and errors where the truth is given.

    With `files` the record holds gauge outputs, and so does `step`. Where the components ring together all of them
    are compared unless one is named; else it is AF unless another is named.
    """
    if component is not None:
        known_component(component)
    known = dynamics_of(read_any_dynamics(dynamics))
    source = Source(known, files, gravity, channel_map)
    inputs = [path, dynamics, *source.paths, *(file for file in (truth, step) if file is not None)]
    check_out(out, *inputs, kind=PAGE)
    if isinstance(known, CoupledDynamics):
        from aerobalance.app.commands.compare_coupled import compare_coupled  # noqa: PLC0415 - it takes parts of this

        if step is not None:
            raise ValueError("--step is for components each for itself: a step of one rings in all that are coupled")
        return compare_coupled(
            path,
            known,
            source=source,
            inputs=inputs,
            truth=truth,
            component=component,
            half_range=_by_component(half_range),
            out=out,
        )
    component = component or "AF"
    if component not in known:
        raise FitError(f"{dynamics} has no {component}; it has {', '.join(known)}")
    return _compare_one(
        path,
        known[component],
        source=source,
        inputs=inputs,
        truth=truth,
        step=step,
        half_range=half_range.get(component) if isinstance(half_range, Mapping) else half_range,
        out=out,
    )


def _compare_one(
    path: Path,
    balance: Dynamics,
    *,
    source: Source,
    inputs: Sequence[Path],
    truth: Path | None,
    step: Path | None,
    half_range: float | None,
    out: Path | None,
) -> Account:
    """Every rival on one component that rings for itself."""
    component = balance.component
    with doubts() as collected:
        recording, reduced = source.with_loads(path)
        recording.channel(component)
        applied = None
        if truth is not None:
            values = truth_on_clock(recording, read(truth), component)
            applied = Truth.of(values, rate=recording.rate, natural_frequency=balance.natural_frequency)
        response = None if step is None else _response(source.with_loads(step)[0], recording, balance)
        settings = Settings(gravity=source.gravity, response=response)
        found = estimates(recording, balance, settings=settings, truth=applied)
    account: Account = {
        "file": path.name,
        "component": component,
        "unit": si_unit(component),
        "natural_frequency": {"value": balance.natural_frequency, "unit": "Hz"},
        "further_modes": [
            {"natural_frequency": mode.natural_frequency, "damping_ratio": mode.damping_ratio, "share": mode.share}
            for mode in balance.further_modes
        ],
        **standings(found, applied, half_range=half_range, unit=si_unit(component)),
        **({} if reduced is None else {"loads": loads_account(reduced)}),
        "warnings": collected,
    }
    if out is not None:
        from aerobalance.app.reports.compare_report import write_comparison  # noqa: PLC0415 - plotting is slow

        write_comparison(out, account, found, recording=recording, dynamics=balance, truth=applied, inputs=inputs)
        account["written"] = out.name
    return {**account, "summary": summary(account)}


def _by_component(half_range: float | Mapping[str, float] | None) -> Mapping[str, float]:
    if half_range is None or isinstance(half_range, Mapping):
        return half_range or {}
    raise ValueError("--half-range of components that ring together is given by component: NF=2000")


def _response(step: Recording, recording: Recording, balance: Dynamics) -> MeasuredResponse:
    return response_of_record(
        step, balance.component, natural_frequency=balance.natural_frequency, rate=recording.rate
    )


def standings(
    found: Sequence[RivalEstimate], truth: Truth | None, *, half_range: float | None, unit: str = "N"
) -> Account:
    """Rows of the table and what they come to.

    Parameters
    ----------
    found
        The rivals' estimates, the program's own among them.
    truth
        What was applied, where it is known.
    half_range
        What percentages refer to [unit]; half of the truth's span if None.
    unit
        Unit of the force.
    """
    if truth is None:
        return {"half_range": None, "rivals": [_without_truth(row, found) for row in found], "verdict": []}
    said = "given"
    if half_range is None:
        half_range, said = truth.half_span, "half of the truth's span"
    if not half_range:
        half_range, said = float("nan"), "not known: the truth does not change; give --half-range for percentages"
    rows = [_with_truth(row, truth, half_range=half_range) for row in found]
    return {
        "half_range": {"value": half_range, "unit": unit, "from": said},
        "scored": f"the record less {100 * END_SHARE:g} % at each end; edge: within {1e3 * EDGE_TIME:g} ms, or two"
        " natural periods if that is more, of a jump of the truth; plateau: the rest",
        "jumps": len(truth.jumps) > 0,
        "rivals": rows,
        "verdict": verdict(rows, unit=unit),
    }


def _plain(row: RivalEstimate) -> Account:
    return {
        "name": row.name,
        "setting": "tuned on the truth" if row.oracle else "customary",
        "settings": row.settings,
        "note": row.note,
        "lacking": row.lacking or None,
        "tuning": {"value": row.tuning, "unit": "Hz"} if np.isfinite(row.tuning) else None,
    }


def _with_truth(row: RivalEstimate, truth: Truth, *, half_range: float) -> Account:
    if not row.ran:
        return _plain(row)
    score = truth.score(row.values)
    deviations = {measure: float(getattr(score, measure)) for measure in MEASURES}
    return {
        **_plain(row),
        **deviations,
        "percent_of_half_range": {measure: 100 * value / half_range for measure, value in deviations.items()},
    }


def _without_truth(row: RivalEstimate, found: Sequence[RivalEstimate]) -> Account:
    if not row.ran:
        return _plain(row)
    own = next(item for item in found if item.name == THIS)
    ends = int(END_SHARE * row.values.size)
    inner = slice(ends, row.values.size - ends)
    apart = row.values[inner] - own.values[inner]
    return {
        **_plain(row),
        "force_mean": float(np.mean(row.values[inner])),
        "force_rms_about_mean": float(np.std(row.values[inner])),
        "apart_from_this_estimator_rms": float(np.sqrt(np.mean(apart**2))),
    }


def verdict(rows: Sequence[Account], *, unit: str = "N") -> list[str]:
    """Say who is first by each measure, and so where this estimator is not."""
    own = next(row for row in rows if row["name"] == THIS)
    if "rms" not in own:
        return [f"{THIS} could not be run: {own['lacking']}"]
    texts = []
    for measure in MEASURES:
        others = [row for row in rows if row["name"] != THIS and np.isfinite(row.get(measure, np.nan))]
        if not others or not np.isfinite(own[measure]):
            continue
        texts.append(f"{NAMES.get(measure, measure)}: {_place(own, others, measure, unit=unit)}")
    return texts


def _place(own: Account, others: Sequence[Account], measure: str, *, unit: str) -> str:
    """Say where this estimator stands: among what a user can run, and beside what only the truth could tune."""
    mine = abs(own[measure])
    texts = []
    for tuned in (False, True):
        field = [row for row in others if (row["setting"] != "customary") == tuned]
        if not field:
            continue
        best = min(field, key=lambda row: abs(row[measure]))
        theirs = abs(best[measure])
        rival = f"{best['name']}, {theirs:.3g} {unit}"
        if tuned and mine > theirs * TIED:
            texts.append(f"NOT first beside methods tuned on the truth: {rival}")
        elif tuned:
            continue
        elif mine <= theirs / TIED:
            texts.append(f"{THIS} is first, {mine:.3g} {unit}; next is {rival}")
        elif mine <= theirs * TIED:
            texts.append(f"{THIS} is tied, {mine:.3g} {unit}, with {rival}")
        else:
            texts.append(f"{THIS} is NOT first, {mine:.3g} {unit}; first is {rival}")
    return "; ".join(texts)


def summary(account: Account) -> str:
    """Lay the comparison out as a table for people."""
    judged = account["half_range"] is not None
    heads = ("rms", "%", "plateau", "edge", "mean", "largest", "%") if judged else ("mean", "rms about", "apart")
    keys = [f"{row['name']}{' *' if row['setting'] != 'customary' else ''}" for row in account["rivals"]]
    width = max(len(key) for key in keys)
    f0 = account["natural_frequency"]["value"]
    head = f"{account['file']}: {account['component']} [{account['unit']}], natural frequency {f0:.5g} Hz"
    further = [f"{mode['natural_frequency']:.5g} Hz (share {mode['share']:.3g})" for mode in account["further_modes"]]
    lines = [f"{head}, further {', '.join(further)}" if further else head]
    if judged:
        half = account["half_range"]
        lines += [f"deviation from the truth; {account['scored']}"]
        lines += [
            f"%: of half range, {half['value']:.5g} {half['unit']} ({half['from']})"
            if half["value"] > 0
            else f"%: {half['from']}"
        ]
        lines += ["*: its one tuning number chosen on the truth, which no user has"]
    else:
        lines += ["no truth given; apart: rms difference from this estimator"]
    lines += ["", " ".join([" " * width, *(f"{head:>9}" for head in heads)])]
    for key, row in zip(keys, account["rivals"], strict=True):
        cells = " ".join(f"{_cell(value):>9}" for value in _cells(row, judged))
        lines.append(f"{key:<{width}} {cells if row['lacking'] is None else '  not run: ' + row['lacking']}")
    marked = [row for row in account["rivals"] if "one mode only" in row["note"]]
    notes = [f"{row['name']}: {row['note'].split('; ')[-1]}" for row in marked]
    lines += ["", *dict.fromkeys(notes), *account["verdict"]]
    return "\n".join(lines).rstrip() + "\n"


def _cells(row: Account, judged: bool) -> list[float]:
    if row["lacking"] is not None:
        return []
    if not judged:
        return [row[key] for key in ("force_mean", "force_rms_about_mean", "apart_from_this_estimator_rms")]
    share = row["percent_of_half_range"]
    return [row["rms"], share["rms"], row["plateau"], row["edge"], row["mean"], row["largest"], share["largest"]]


def _cell(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "-"
