"""What the runs of a test say together: whether repeats scatter as stated, and what drifts, changes or lies apart."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from typing import Any, Final

import numpy as np

from aerobalance.app.campaign.definition import Repeats
from aerobalance.app.campaign.rows import ASIDE, REDUCED, with_unit
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.uncertainty.repeats import (
    Pooled,
    Scatter,
    correlation_of_repeats,
    pooled,
    pooled_results,
    trend,
)

COEFFICIENTS: Final = ("CL", "CD", "CPM", "CY", "CYM", "CRM")
"""Coefficients that are looked at, where there are any."""


@dataclass(frozen=True, slots=True)
class CampaignQualitySettings:
    """From which on what is said of a test.

    Attributes
    ----------
    zero
        Distance of a zero from the others, over the scatter of these or its uncertainty, from which it has drifted.
    outlier
        Distance of a run from its repeats, over the standard uncertainty of the difference.
    resonance
        Standard uncertainties that stiffness or damping of all runs, or its change along them, is off.
    of_one
        The same over the standard uncertainty by one run: an error that all runs share does not average out. That
        uncertainty is true if its intervals of 95 % hold 93 % to 97 % of the truths; a common error of b of it makes
        them hold Phi(1.96 - b) - Phi(-1.96 - b), 93 % with b = 0.42. More than that is no error of a true
        uncertainty. Of 397 runs under a load that ends among the modes it was 0.3 at most.
    told
        Share of the runs that have to tell it: of few, those tell that chance has moved.
    scatter
        Chi-square per degree of freedom, of few repeats with the chance of a thousandth, beyond which it is said.
    fewest
        Runs or zeros from which a change along them is looked for.
    """

    zero: float = 6.0
    outlier: float = 4.5
    resonance: float = 5.0
    of_one: float = 0.42
    told: float = 0.5
    scatter: float = 1e-3
    fewest: int = 5


SETTINGS: Final = CampaignQualitySettings()
"""Settings that are used."""


@dataclass(frozen=True, slots=True)
class Flag:
    """One thing that a test director has to know.

    Attributes
    ----------
    kind
        ``"set aside"``, ``"not measured"``, ``"zero drift"``, ``"set-up change"``, ``"outlier"``, ``"scatter"``,
        ``"stiffness"``, ``"damping"`` or ``"not usable"``.
    text
        What it is.
    runs
        The runs that it is about.
    """

    kind: str
    text: str
    runs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RepeatGroup:
    """Runs at the same condition, and how one result of them scatters.

    Attributes
    ----------
    quantity
        Which result.
    condition
        The columns that they agree in.
    runs
        Their names.
    scatter
        Its scatter over what is drawn anew in each run by what is stated, or with each zero or set-up.
    """

    quantity: str
    condition: Mapping[str, Any]
    runs: tuple[str, ...]
    scatter: Scatter


@dataclass(frozen=True, slots=True)
class CampaignQuality:
    """What the runs say together.

    Attributes
    ----------
    repeats
        All groups of repeats.
    pooled
        Their scatter by result; under ``"all"`` that of all results together.
    flags
        What a test director has to know.
    """

    repeats: tuple[RepeatGroup, ...]
    pooled: Mapping[str, Pooled]
    flags: tuple[Flag, ...]


def quality_of(rows: Sequence[Mapping[str, Any]], rules: Repeats) -> CampaignQuality:
    """Return what the rows of a test, in its order, say together.

    Parameters
    ----------
    rows
        One a run.
    rules
        Which runs are repeats.
    """
    good = [row for row in rows if row["status"] == REDUCED and row["verdict"] != "not usable"]
    names = quantities(good)
    groups = conditions(good, rules)
    repeats = [
        one for name in names for key, group in groups for one in [_repeat(name, key, group)] if one is not None
    ]
    flags = [
        *_not_reduced(rows),
        *_not_measured(rows),
        *_set_up_changes(rows),
        *_zeros(good),
        *_outliers(names, [group for _, group in groups]),
        *_resonances(good),
    ]
    by_name = {name: [one.scatter for one in repeats if one.quantity == name] for name in names}
    together = {name: found for name, groups in by_name.items() if (found := pooled(groups))}
    if together:
        flags += _scatter(together)
        correlation = correlation_of_repeats([_values(list(together), group) for _, group in groups])
        together["all"] = pooled_results(list(together.values()), correlation)
    return CampaignQuality(tuple(repeats), together, tuple(flags))


def quantities(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the results that are looked at: coefficients where there are any, else mean loads."""
    found = [name for name in COEFFICIENTS if any(row.get(name) is not None for row in rows)]
    if found:
        return found
    labels = [f"balance_{with_unit(name)}" for name in COMPONENTS]
    return [label for label in labels if any(row.get(label) is not None for row in rows)]


def conditions(
    rows: Sequence[Mapping[str, Any]], rules: Repeats
) -> list[tuple[dict[str, Any], list[Mapping[str, Any]]]]:
    """Return the groups of runs at one condition, each with its columns; runs of which none is known are alone."""
    groups: list[tuple[dict[str, Any], list[Mapping[str, Any]]]] = []
    for row in rows:
        own = {name: _condition(row, name) for name in rules.by}
        for key, members in groups:
            if any(value is not None for value in own.values()) and all(
                _near(key[name], own[name], rules.tolerance.get(name, 1e-9)) for name in rules.by
            ):
                members.append(row)
                break
        else:
            groups.append((own, [row]))
    return groups


def _condition(row: Mapping[str, Any], name: str) -> Any:
    """A column of a run; angles that no table gives are those of the recording."""
    found = row.get(name)
    return row.get(f"{name}_deg") if found is None else found


def _near(one: Any, other: Any, tolerance: float) -> bool:
    if isinstance(one, int | float) and isinstance(other, int | float):
        return abs(one - other) <= tolerance
    return bool(one == other)


def _repeat(name: str, key: dict[str, Any], group: Sequence[Mapping[str, Any]]) -> RepeatGroup | None:
    there = [row for row in group if row.get(name) is not None]
    if len(there) < 2:
        return None
    differences = [_difference(name, one, other) for one, other in combinations(there, 2)]
    scatter = Scatter.of([row[name] for row in there], differences)
    return RepeatGroup(name, key, tuple(row["run_name"] for row in there), scatter)


def _difference(name: str, one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """Variance of the difference of one result of two runs: what both share is not in it."""
    total = one[f"u_run_{name}"] ** 2 + other[f"u_run_{name}"] ** 2
    for what in ("zero", "tare"):
        if one.get(f"{what}_from") != other.get(f"{what}_from"):
            total += one[f"u_{what}_{name}"] ** 2 + other[f"u_{what}_{name}"] ** 2
    if any(one.get(key) != other.get(key) for key in ("balance_file", "dynamics_file", "setup")):
        total += sum(
            row[f"u_{name}"] ** 2 - sum(row[f"u_{what}_{name}"] ** 2 for what in ("run", "zero", "tare"))
            for row in (one, other)
        )
    return float(max(total, 0.0))


def _values(names: Sequence[str], group: Iterable[Mapping[str, Any]]) -> Array:
    """Results of repeats, NaN where a run has none, shape (runs, results)."""
    return np.array([[np.nan if row.get(name) is None else row[name] for name in names] for row in group], float)


def _scatter(found: Mapping[str, Pooled]) -> list[Flag]:
    flags = []
    for name, one in found.items():
        text = f"repeats of {name} scatter {np.sqrt(one.chi_square):.2g} times as much as stated"
        if one.above(SETTINGS.scatter):
            flags.append(Flag("scatter", f"{text}: something changes from run to run that is not in the uncertainty"))
        elif one.below(SETTINGS.scatter):
            flags.append(Flag("scatter", f"{text}: the uncertainty is larger than it need be"))
    return flags


def _not_reduced(rows: Sequence[Mapping[str, Any]]) -> list[Flag]:
    flags = [
        Flag("set aside", f"{row['run_name']}: {row['reason']}", (row["run_name"],))
        for row in rows
        if row["status"] == ASIDE
    ]
    spoiled = [row for row in rows if row["status"] == REDUCED and row["verdict"] == "not usable"]
    return flags + [
        Flag("not usable", f"{row['run_name']}: {'; '.join(row['doubts'][:1])}", (row["run_name"],)) for row in spoiled
    ]


def _not_measured(rows: Sequence[Mapping[str, Any]]) -> list[Flag]:
    """Coefficients that are empty, and the components that they would take."""
    found: dict[tuple[str, ...], list[str]] = {}
    for row in rows:
        if row.get("lacking"):
            found.setdefault(tuple(row["lacking"]), []).append(row["run_name"])
    flags = []
    for texts, runs in found.items():
        names: dict[str, list[str]] = {}
        for text in texts:
            name, _, components = text.partition(": ")
            names.setdefault(components, []).append(name)
        said = "; ".join(f"{' '.join(these)} need{'s'[: len(these) == 1]} {which}" for which, these in names.items())
        of = "all runs" if len(runs) == len(rows) else f"{len(runs)} of {len(rows)} runs"
        text = f"coefficients of {of} are empty for want of components: {said}"
        flags.append(Flag("not measured", text, tuple(runs)))
    return flags


def _set_up_changes(rows: Sequence[Mapping[str, Any]]) -> list[Flag]:
    flags = []
    for before, after in pairwise(rows):
        changed = [
            f"{what} {_short(before[key])} to {_short(after[key])}"
            for key, what in (("balance_file", "balance"), ("dynamics_file", "dynamics"))
            if before[key] != after[key]
        ]
        if changed or before["setup"] != after["setup"]:
            said = ", ".join(changed) or "another set-up"
            flags.append(Flag("set-up change", f"from {after['run_name']} on: {said}", (after["run_name"],)))
    return flags


def _short(name: str) -> str:
    return name.replace("\\", "/").rpartition("/")[2] or "none"


def zeros_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Return by balance the first row that counts from each zero, in the order of the test."""
    found: dict[str, dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        if row.get("zero_from") and any(key.startswith("zero_drift_") for key in row):
            found.setdefault(row["balance_file"], {}).setdefault(row["zero_from"], row)
    return {balance: list(first.values()) for balance, first in found.items()}


def _zeros(rows: Sequence[Mapping[str, Any]]) -> list[Flag]:
    """Zeros that lie apart from the others of their balance, and bridges that moved between two zeros of a run."""
    moved: dict[tuple[str, str], dict[str, list[str]]] = {}
    for balance, zeros in zeros_of(rows).items():
        for name in COMPONENTS:
            label, unit = with_unit(name), si_unit(name)
            if any(row.get(f"zero_{label}") is None for row in zeros):
                continue
            u, level, drift = (
                np.array([row[f"{what}_{label}"] for row in zeros]) for what in ("u_zero", "zero", "zero_drift")
            )
            for how, off, places in (
                ("apart from the others", level - np.median(level), _apart(level, u)),
                ("from first to last", drift, _apart(drift, np.sqrt(2) * u, about=0.0)),
            ):
                for place in places:
                    said = moved.setdefault((balance, zeros[place]["zero_from"]), {}).setdefault(how, [])
                    said.append(f"{name} {off[place]:+.3g} {unit}")
    flags = []
    for (balance, zero), found in moved.items():
        runs = tuple(row["run_name"] for row in rows if (row["balance_file"], row["zero_from"]) == (balance, zero))
        names = ", ".join(_short(part) for part in zero.split(" "))
        drifts = "; ".join(f"{how}: {', '.join(texts)}" for how, texts in found.items())
        flags.append(Flag("zero drift", f"{names} ({len(runs)} runs) {drifts}", runs))
    return flags


def _apart(values: Array, u: Array, *, about: float | None = None) -> list[int]:
    """Places of values that lie apart from the others, by their scatter or uncertainty, whichever is larger."""
    if values.size < 3 and about is None:
        return []
    middle = float(np.median(values)) if about is None else about
    spread = 1.4826 * float(np.median(np.abs(values - middle))) if values.size >= SETTINGS.fewest else 0.0
    scale = np.maximum(spread, u)
    return [
        int(place) for place in np.flatnonzero(np.abs(values - middle) > SETTINGS.zero * scale) if scale[place] > 0
    ]


def _outliers(names: Sequence[str], groups: Iterable[Sequence[Mapping[str, Any]]]) -> list[Flag]:
    """Runs that lie apart from their repeats, each with all results in which they do."""
    found: dict[str, list[str]] = {}
    for name, group in product(names, groups):
        there = [row for row in group if row.get(name) is not None]
        if len(there) < 3:
            continue
        middle = float(np.median([row[name] for row in there]))
        for row in there:
            # as far as two runs differ by what is stated, and the median of the others
            usual = float(np.median([_difference(name, row, other) for other in there if other is not row]))
            if usual > 0 and abs(row[name] - middle) > SETTINGS.outlier * np.sqrt(usual):
                text = f"{name} is {row[name]:.4g}, its repeats {middle:.4g}"
                found.setdefault(row["run_name"], []).append(text)
    return [Flag("outlier", f"{run}: {'; '.join(texts)}", (run,)) for run, texts in found.items()]


def _resonances(rows: Sequence[Mapping[str, Any]]) -> list[Flag]:
    """Stiffness and damping that are not those of the dynamics, or change along the test."""
    flags = []
    for dynamics in dict.fromkeys(row["dynamics_file"] for row in rows):
        own = [row for row in rows if row["dynamics_file"] == dynamics]
        labels = dict.fromkeys(key for row in own for key in row if key.startswith(("k_change_", "b_change_")))
        for label in labels:
            told = [row for row in own if row.get(label) is not None and row.get(f"u_{label}")]
            if len(told) < max(SETTINGS.fewest, SETTINGS.told * len(own)):
                continue
            least = SETTINGS.of_one * float(np.median([row[f"u_{label}"] for row in told]))
            found = trend(
                [row["place"] for row in told], [row[label] for row in told], [row[f"u_{label}"] for row in told]
            )
            kind = "stiffness" if label[0] == "k" else "damping"
            which = label[9:].replace("_", " ")
            runs = told[0]["run_name"], told[-1]["run_name"]
            if abs(found.change) > max(SETTINGS.resonance * found.u_change, least):
                text = f"{kind} of {which} changes by {100 * found.change:.2g} % ± {100 * found.u_change:.1g} %"
                flags.append(Flag(kind, f"{text} from {runs[0]} to {runs[1]}", runs))
            elif abs(found.mean) > max(SETTINGS.resonance * found.u_mean, least):
                text = f"{kind} of {which} is {100 * found.mean:+.2g} % ± {100 * found.u_mean:.1g} %"
                flags.append(
                    Flag(kind, f"{text} off that of {_short(dynamics)} in the mean of {len(told)} runs", runs)
                )
    return flags
