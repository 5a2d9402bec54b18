"""What the runs of a test say together: whether repeats scatter as stated, and what drifts, changes or lies apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any, Final

import numpy as np

from aerobalance.app.campaign.definition import Repeats
from aerobalance.app.campaign.rows import ASIDE, REDUCED
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS

COEFFICIENTS: Final = ("CL", "CD", "CPM", "CY", "CYM", "CRM")
"""Coefficients that are looked at, where there are any."""


@dataclass(frozen=True, slots=True)
class QualitySettings:
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
        The same over the standard uncertainty by one run: what its likelihood may be wrong by does not average out.
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
    of_one: float = 0.4
    told: float = 0.5
    scatter: float = 1e-3
    fewest: int = 5


SETTINGS: Final = QualitySettings()
"""Settings that are used."""


@dataclass(frozen=True, slots=True)
class Flag:
    """One thing that a test director has to know.

    Attributes
    ----------
    kind
        ``"set aside"``, ``"zero drift"``, ``"set-up change"``, ``"outlier"``, ``"scatter"``, ``"stiffness"``,
        ``"damping"`` or ``"not usable"``.
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
    mean
        Their mean.
    deviation
        Standard deviation about it.
    expected
        What their stated uncertainties make of it: by what is drawn anew in each, or with each zero or set-up.
    """

    quantity: str
    condition: Mapping[str, Any]
    runs: tuple[str, ...]
    mean: float
    deviation: float
    expected: float

    @property
    def chi_square(self) -> float:
        """Variance over that expected, which is chi-square per degree of freedom [1]."""
        return (self.deviation / self.expected) ** 2 if self.expected > 0 else float("nan")

    @property
    def freedom(self) -> int:
        """Degrees of freedom."""
        return len(self.runs) - 1


@dataclass(frozen=True, slots=True)
class Pooled:
    """Scatter of all repeats of one result over what is stated.

    Attributes
    ----------
    chi_square
        Per degree of freedom [1].
    freedom
        Degrees of freedom.
    """

    chi_square: float
    freedom: int


@dataclass(frozen=True, slots=True)
class Quality:
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


def quality_of(rows: Sequence[Mapping[str, Any]], rules: Repeats) -> Quality:
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
        *_set_up_changes(rows),
        *_zeros(good),
        *(flag for name in names for _, group in groups for flag in _outliers(name, group)),
        *_resonances(good),
    ]
    pooled = {name: found for name in names if (found := _pooled([one for one in repeats if one.quantity == name]))}
    if pooled:
        freedom = sum(one.freedom for one in pooled.values())
        whole = sum(one.freedom * one.chi_square for one in pooled.values()) / freedom
        flags += _scatter(pooled)
        pooled["all"] = Pooled(whole, freedom)
    return Quality(tuple(repeats), pooled, tuple(_joined(flags)))


def quantities(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the results that are looked at: coefficients where there are any, else mean loads."""
    found = [name for name in COEFFICIENTS if any(row.get(name) is not None for row in rows)]
    if found:
        return found
    labels = [f"balance_{name}_{unit}" for name in COMPONENTS for unit in ("N", "Nm")]
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
    values = np.array([row[name] for row in there])
    return RepeatGroup(
        name,
        key,
        tuple(row["run_name"] for row in there),
        float(values.mean()),
        float(values.std(ddof=1)),
        float(np.sqrt(np.mean([_difference(name, one, other) for one, other in combinations(there, 2)]) / 2)),
    )


def _difference(name: str, one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """Variance of the difference of one result of two runs: what both share is not in it."""
    total = one[f"u_run_{name}"] ** 2 + other[f"u_run_{name}"] ** 2
    if one.get("zero_from") != other.get("zero_from"):
        total += one[f"u_zero_{name}"] ** 2 + other[f"u_zero_{name}"] ** 2
    if any(one.get(key) != other.get(key) for key in ("balance_file", "dynamics_file", "setup")):
        total += sum(
            row[f"u_{name}"] ** 2 - row[f"u_run_{name}"] ** 2 - row[f"u_zero_{name}"] ** 2 for row in (one, other)
        )
    return float(max(total, 0.0))


def _pooled(repeats: Sequence[RepeatGroup]) -> Pooled | None:
    """Sum of the squares over that expected: stated uncertainties are estimates, whose inverses would be biased."""
    freedom = sum(one.freedom for one in repeats)
    expected = sum(one.freedom * one.expected**2 for one in repeats)
    if not freedom or not expected:
        return None
    return Pooled(sum(one.freedom * one.deviation**2 for one in repeats) / expected, freedom)


def _scatter(pooled: Mapping[str, Pooled]) -> list[Flag]:
    from scipy.special import chdtrc, chdtri  # noqa: PLC0415 - few commands need it

    flags = []
    for name, one in pooled.items():
        chance = float(chdtrc(one.freedom, one.chi_square * one.freedom))
        low = float(chdtri(one.freedom, 1 - SETTINGS.scatter)) / one.freedom
        if chance < SETTINGS.scatter:
            text = f"repeats of {name} scatter {np.sqrt(one.chi_square):.2g} times as much as stated"
            flags.append(Flag("scatter", f"{text}: something changes from run to run that is not in the uncertainty"))
        elif one.chi_square < low:
            text = f"repeats of {name} scatter {np.sqrt(one.chi_square):.2g} times as much as stated"
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


def _zeros(rows: Sequence[Mapping[str, Any]]) -> list[Flag]:
    """Zeros that lie apart from the others of their balance, and bridges that moved between two zeros of a run."""
    flags: list[Flag] = []
    for balance in dict.fromkeys(row["balance_file"] for row in rows):
        own = [row for row in rows if row["balance_file"] == balance and row.get("zero_from")]
        first = {row["zero_from"]: row for row in reversed(own)}
        zeros = [first[name] for name in dict.fromkeys(row["zero_from"] for row in own)]
        if not zeros:
            continue
        moved: dict[str, dict[str, list[str]]] = {}
        for name in COMPONENTS:
            for unit in ("N", "Nm"):
                label = f"{name}_{unit}"
                if any(row.get(f"zero_{label}") is None for row in zeros):
                    continue
                u = np.array([row[f"u_zero_{label}"] for row in zeros])
                level = np.array([row[f"zero_{label}"] for row in zeros])
                drift = np.array([row[f"zero_drift_{label}"] for row in zeros])
                for place in _apart(level, u):
                    text = f"{name} {level[place] - np.median(level):+.3g} {_told(unit)}"
                    moved.setdefault(zeros[place]["zero_from"], {}).setdefault("apart from the others", []).append(
                        text
                    )
                for place in _apart(drift, np.sqrt(2) * u, about=0.0):
                    text = f"{name} {drift[place]:+.3g} {_told(unit)}"
                    moved.setdefault(zeros[place]["zero_from"], {}).setdefault("from first to last", []).append(text)
        for zero, found in moved.items():
            runs = tuple(row["run_name"] for row in own if row["zero_from"] == zero)
            names = ", ".join(_short(part) for part in zero.split(" "))
            said = "; ".join(f"{how}: {', '.join(texts)}" for how, texts in found.items())
            flags.append(Flag("zero drift", f"{names} ({len(runs)} runs) {said}", runs))
    return flags


def _told(unit: str) -> str:
    return "N*m" if unit == "Nm" else unit


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


def _outliers(name: str, group: Sequence[Mapping[str, Any]]) -> list[Flag]:
    """Runs that lie apart from their repeats."""
    there = [row for row in group if row.get(name) is not None]
    if len(there) < 3:
        return []
    flags = []
    middle = float(np.median([row[name] for row in there]))
    for row in there:
        others = [one for one in there if one is not row]
        # as far as two runs differ by what is stated, and the median of the others
        usual = float(np.median([_difference(name, row, other) for other in others]))
        off = abs(row[name] - middle) / np.sqrt(usual) if usual > 0 else 0.0
        if off > SETTINGS.outlier:
            text = f"{row['run_name']}: {name} is {row[name]:.4g}, its repeats {middle:.4g}"
            flags.append(Flag("outlier", text, (row["run_name"],)))
    return flags


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


@dataclass(frozen=True, slots=True)
class Trend:
    """How a quantity goes along a test.

    Attributes
    ----------
    mean, u_mean
        Weighted mean and its standard uncertainty, not less than the values scatter.
    change, u_change
        Change from the first to the last by a straight line, and the same of it.
    """

    mean: float
    u_mean: float
    change: float
    u_change: float


def trend(place: Sequence[float], values: Sequence[float], u: Sequence[float]) -> Trend:
    """Return the weighted mean of values and the straight line through them."""
    x, y, weight = np.asarray(place, dtype=float), np.asarray(values), 1 / np.asarray(u) ** 2
    mean = float(np.average(y, weights=weight))
    centre, length = float(np.average(x, weights=weight)), float(np.ptp(x)) or 1.0
    position = (x - centre) / length
    spread = float(np.sum(weight * position**2))
    change = float(np.sum(weight * position * (y - mean)) / spread) if spread > 0 else 0.0
    square = float(np.sum(weight * (y - mean - change * position) ** 2)) / max(y.size - 2, 1)
    scale = float(np.sqrt(max(square, 1.0)))
    u_change = scale / np.sqrt(spread) if spread > 0 else np.inf
    return Trend(mean, scale / float(np.sqrt(weight.sum())), change, float(u_change))


def _joined(flags: Sequence[Flag]) -> list[Flag]:
    """Flags of one kind about the same runs as one."""
    found: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for flag in flags:
        key = (flag.kind, flag.runs) if flag.kind == "outlier" else (flag.kind, (*flag.runs, flag.text))
        found.setdefault(key, []).append(flag.text)
    joined = []
    for (kind, runs), texts in found.items():
        if kind == "outlier":
            first, *rest = texts
            joined.append(Flag(kind, "; ".join([first, *(text.partition(": ")[2] for text in rest)]), runs))
        else:
            joined.append(Flag(kind, texts[0], runs[:-1]))
    return joined
