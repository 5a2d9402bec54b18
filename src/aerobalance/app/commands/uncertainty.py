"""What the command force says of the uncertainty: numbers that sum up the force, the budget, and Monte Carlo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.app.commands.answers import rounded, short
from aerobalance.app.commands.shared import Result, table_text
from aerobalance.estimation.result import ForceSummary
from aerobalance.recording.components import density_unit, si_unit
from aerobalance.recording.recording import Recording
from aerobalance.uncertainty.budget import BudgetLine, advice, beyond_its_extremes, component_budget, scalars, spectrum
from aerobalance.uncertainty.monte_carlo import Compared, MonteCarlo

SHOWN_STEPS: Final = 5
"""Steps that the short answer shows for a component."""

NOTHING: Final = 1e-12
"""Share of the largest contribution below which another is no more than what is lost in calculating."""

NAMES = {
    "mean": "mean",
    "rms_about_mean": "rms about the mean",
    "largest": "force where it is largest",
    "least": "force where it is least",
    "largest_in_record": "largest in the record",
    "least_in_record": "least in the record",
}


@dataclass(frozen=True, slots=True)
class Origins:
    """Where contributions come from: the files beside the recording.

    Attributes
    ----------
    recording
        The recording whose channels are meant.
    dynamics
        File of the dynamics.
    balance
        File of the balance matrix, where there is one.
    """

    recording: Recording
    dynamics: Path
    balance: Path | None = None

    def of(self, source: str, name: str = "") -> str:
        """Where a contribution comes from, for a reader."""
        if source == "dynamics":
            return self.dynamics.name
        if source == "balance" and self.balance is not None:
            return self.balance.name
        channels = [part for part in source.split(" and ") if part in self.recording]
        if not channels:
            return source
        known = [self.recording.channel(part).noise is not None for part in channels]
        how = "" if not name.startswith("noise") else ", as given" if all(known) else ", judged from the record"
        return f"{' and '.join(channels)}{how}"


def scalar_result(estimate: ForceSummary, recording: Recording) -> Result:
    """Mean, rms about it and extremes of a force, with their standard uncertainties."""
    found = {item.name: item for item in scalars(estimate)}
    result: Result = {}
    for name, item in found.items():
        result[name], result[f"u_{name}"] = item.value, item.u
    for name, end in (("largest", estimate.sums.largest), ("least", estimate.sums.least)):
        if end is not None:
            result[f"instant_of_{name}"] = float(recording.start + end.sample / recording.rate)
    return result


def significant(rows: Sequence[BudgetLine]) -> list[BudgetLine]:
    """Rows of a budget that are more than zero: in the force, or in one of the numbers that sum it up."""
    largest = {name: max(abs(row.scalars[name]) for row in rows) for name in (rows[0].scalars if rows else ())}
    rms = max((row.rms for row in rows), default=0.0)
    return [
        row
        for row in rows
        if row.rms > NOTHING * rms or any(abs(row.scalars[name]) > NOTHING * largest[name] for name in largest)
    ]


def budget_rms(estimate: ForceSummary) -> dict[str, float]:
    """Rms of every contribution, zero for what is only lost in calculating."""
    found = estimate.budget
    least = NOTHING * max(found.values(), default=0.0)
    return {name: rms if rms > least else 0.0 for name, rms in found.items()}


def budget_result(estimate: ForceSummary, origins: Origins) -> Result:
    """Uncertainty budget, what to improve first, and the spectrum with its uncertainty."""
    unit = si_unit(estimate.component)
    rows = [
        {
            "name": row.name,
            "from": origins.of(row.source, row.name),
            "rms": row.rms,
            "share": row.share,
            "rms_of_all_if_halved": row.if_halved,
            **{f"u_{name}": value for name, value in row.scalars.items()},
        }
        for row in significant(component_budget(estimate))
    ]
    found = spectrum(estimate, rate=origins.recording.rate)
    files = {source: origins.of(source) for _, source in estimate.sums.rows}
    sentence = advice(estimate, unit=unit, sources=files)
    return {
        "budget": rows,
        "improve_first": sentence,
        "spectrum": {
            "unit": density_unit(estimate.component),
            "frequency_unit": "Hz",
            "frequency": found.frequency.tolist(),
            "density": found.density.tolist(),
            "u_scatter": found.scatter.tolist(),
            "u_force": found.uncertainty.tolist(),
        },
    }


def monte_carlo_result(found: MonteCarlo) -> Result:
    """Plain data on a Monte Carlo check."""

    def row(item: Compared) -> Result:
        known = bool(np.isfinite(item.analytic))
        return {
            "monte_carlo": item.drawn,
            "first_order": item.analytic if known else None,
            "ratio": item.ratio if known and np.isfinite(item.ratio) else None,
            "u_ratio": item.scatter,
            **({"interval_95": list(item.interval)} if item.interval else {}),
        }

    return {
        "draws": found.draws,
        "seed": found.seed,
        "contributions": {item.name: row(item) for item in found.contributions},
        "scalars": {item.name: row(item) for item in found.scalars},
        "doubts": list(found.doubts),
    }


def force_text(result: Result) -> str:
    """Short answer for people: forces with their uncertainties, steps, Monte Carlo where it was run, and a verdict."""
    components = result["components"]
    rows, lines = [], []
    for name, found in components.items():
        numbers = (rounded(found[key], found[f"u_{key}"]) for key in ("mean", "rms_about_mean", "largest", "least"))
        sample = rounded(found["uncertainty_rms"], found["uncertainty_rms"])[1]
        rows.append((f"{name} [{found['unit']}]", *(text for pair in numbers for text in pair), sample))
        lines += _steps_text(name, found)
    texts = [
        table_text(
            f"{result['file']}: force applied; u is the standard uncertainty of the number before it",
            ("", "mean", "u", "rms about mean", "u", "largest", "u", "least", "u", "u of a sample"),
            rows,
        ),
        *lines,
    ]
    beyond = {name: beyond_its_extremes(found, found["unit"]) for name, found in components.items()}
    texts += [f"{name}: {text}" for name, text in beyond.items() if text]
    texts += [monte_carlo_text(name, found) for name, found in components.items() if "monte_carlo" in found]
    if len(components) == 1:
        texts += [found["improve_first"] for found in components.values() if found["improve_first"]]
    assumed = dict.fromkeys(text for found in components.values() for text in found["assumptions"])
    texts += [*(f"assumed: {text}" for text in assumed), *_assumed_texts(result)]
    lacking = result["components_without_dynamics"]
    texts += [f"no dynamics for {', '.join(lacking)}"] if lacking else []
    texts += [f"verdict: {result['verdict']}"] if result.get("verdict") else []
    return "\n".join(texts) + "\n"


def _assumed_texts(result: Result) -> list[str]:
    """What the record cannot show, once a kind: for the component where it would do most beside its uncertainty.

    What would do most is first, and last a line with what would do more than the uncertainty.
    """
    kinds: dict[str, list[tuple[float, Result]]] = {}
    for one in result.get("assumed", ()):
        u = result["components"][one["component"]]["uncertainty_rms"]
        kinds.setdefault(one["kind"], []).append((one["effect"] / (u or 1.0), one))
    told, larger = [], []
    for kind, group in kinds.items():
        ratio, most = max(group, key=lambda pair: pair[0])
        others = ", ".join(one["component"] for _, one in group if one is not most)
        told.append((ratio, f"assumed: {most['text']}{f' (alike for {others})' if others else ''}"))
        if ratio > 1:
            larger.append((ratio, f"{kind} of {most['component']}, {ratio:.2g} times"))
    texts = [text for _, text in sorted(told, key=lambda pair: -pair[0])]
    if larger:
        names = "; ".join(text for _, text in sorted(larger, key=lambda pair: -pair[0]))
        texts.append(f"not in u, and larger than it, is what is assumed of: {names}")
    return texts


def _steps_text(name: str, found: Result) -> list[str]:
    """The largest steps of the force with instant and height, as they came."""
    steps = sorted(found["steps"], key=lambda step: -abs(step["height"]))
    lines = []
    for step in sorted(steps[:SHOWN_STEPS], key=lambda step: step["instant"]):
        height, u_height = rounded(step["height"], step["u_height"])
        instant, u_instant = rounded(step["instant"], step["u_instant"])
        lines.append(f"step of {name}: {height} {found['unit']} (u = {u_height}) at {instant} s (u = {u_instant})")
    more = len(steps) - SHOWN_STEPS
    return [*lines, f"and {more} smaller steps of {name}"] if more > 0 else lines


def budget_text(components: Mapping[str, Result]) -> str:
    """Tables for people: the uncertainty budget of every component."""
    texts = []
    for name, result in components.items():
        title = f"uncertainty budget of {name} [{result['unit']}]"
        rows = [
            [row["name"], row["from"], f"{row['rms']:.3g}", f"{100 * row['share']:.1f}", f"{row['u_mean']:.3g}"]
            for row in result["budget"]
        ]
        texts.append(table_text(title, ["contribution", "from", "rms", "% of variance", "in the mean"], rows))
    return "\n\n".join(texts) + "\n"


def monte_carlo_text(name: str, result: Result) -> str:
    """Table for people: the uncertainty by Monte Carlo beside that to first order."""
    found = result["monte_carlo"]
    title = (
        f"Monte Carlo of {name}, {found['draws']} draws, seed {found['seed']}: standard uncertainty [{result['unit']}]"
    )
    lines = {**found["contributions"], **{NAMES[key]: row for key, row in found["scalars"].items()}}
    rows = [
        [key, *(short(row[which], 3) for which in ("monte_carlo", "first_order", "ratio", "u_ratio"))]
        for key, row in lines.items()
    ]
    return table_text(title, ["", "Monte Carlo", "first order", "ratio", "u(ratio)"], rows)
