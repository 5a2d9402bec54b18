"""Rows of a comparison of methods: how far each is from the truth, or from this estimator, and who is first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from aerobalance.app.commands.shared import Result
from aerobalance.validation.baselines import THIS, BaselineEstimate
from aerobalance.validation.scores import EDGE_TIME, END_SHARE, Truth

MEASURES: Final = ("rms", "plateau", "edge", "mean", "largest")
"""What a deviation is judged by."""

NAMES: Final = {"plateau": "rms on the plateaus", "edge": "rms at the edges"}
"""Words for measures whose names are short."""

TIED: Final = 1.01
"""Ratio of two deviations up to which they are tied."""


def standings(
    found: Sequence[BaselineEstimate], truth: Truth | None, *, half_range: float | None, unit: str = "N"
) -> Result:
    """Rows of the table and what they come to.

    Parameters
    ----------
    found
        The estimates of the baseline methods, the program's own among them.
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


def _plain(row: BaselineEstimate) -> Result:
    return {
        "name": row.name,
        "setting": "tuned on the truth" if row.oracle else "customary",
        "settings": row.settings,
        "note": row.note,
        "lacking": row.lacking or None,
        "tuning": {"value": row.tuning, "unit": "Hz"} if np.isfinite(row.tuning) else None,
    }


def _with_truth(row: BaselineEstimate, truth: Truth, *, half_range: float) -> Result:
    if not row.ran:
        return _plain(row)
    score = truth.score(row.values)
    deviations = {measure: float(getattr(score, measure)) for measure in MEASURES}
    return {
        **_plain(row),
        **deviations,
        "percent_of_half_range": {measure: 100 * value / half_range for measure, value in deviations.items()},
    }


def _without_truth(row: BaselineEstimate, found: Sequence[BaselineEstimate]) -> Result:
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


def verdict(rows: Sequence[Result], *, unit: str = "N") -> list[str]:
    """Return who is first by each measure, and so where this estimator is not."""
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


def _place(own: Result, others: Sequence[Result], measure: str, *, unit: str) -> str:
    """Return where this estimator stands: among what a user can run, and beside what only the truth could tune."""
    mine = abs(own[measure])
    texts = []
    for tuned in (False, True):
        field = [row for row in others if (row["setting"] != "customary") == tuned]
        if not field:
            continue
        best = min(field, key=lambda row: abs(row[measure]))
        theirs = abs(best[measure])
        best_other = f"{best['name']}, {theirs:.3g} {unit}"
        if tuned and mine > theirs * TIED:
            texts.append(f"NOT first beside methods tuned on the truth: {best_other}")
        elif tuned:
            continue
        elif mine <= theirs / TIED:
            texts.append(f"{THIS} is first, {mine:.3g} {unit}; next is {best_other}")
        elif mine <= theirs * TIED:
            texts.append(f"{THIS} is tied, {mine:.3g} {unit}, with {best_other}")
        else:
            texts.append(f"{THIS} is NOT first, {mine:.3g} {unit}; first is {best_other}")
    return "; ".join(texts)
