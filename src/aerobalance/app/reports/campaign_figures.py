"""Figures of a campaign's page: polars, the scatter of repeats, and what drifts along the test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from aerobalance.app.campaign.quality import SETTINGS, RepeatGroup, zeros_of
from aerobalance.app.campaign.rows import with_unit
from aerobalance.app.reports.page import PLACE_HOLDERS, empty_figure, inline, legend
from aerobalance.estimation.display import COVERAGE_FACTOR
from aerobalance.recording.components import COMPONENTS, si_unit

MOST_BARS: Final = 600
"""Runs up to which an error bar is drawn of each."""

MARKS: Final = ("o", "s", "^", "D", "v", "P")
"""Marks of the set-ups in turn."""

Row = Mapping[str, Any]


def named(label: str) -> str:
    """Name of a result with its unit, as a figure and a table show it."""
    if not label.startswith(("balance_", "body_", "wind_")):
        return label
    name, unit = label.split("_")[1:3]
    return f"{name} [{unit.replace('Nm', 'N·m')}]"


def polar_figure(rows: Sequence[Row], quantities: Sequence[str], *, apart: Sequence[str]) -> str:
    """Draw each result over the angle of attack, a set-up a mark, with bars of 95 %; runs apart stand out."""
    colours = PLACE_HOLDERS
    count = len(quantities)
    columns = 2 if count > 1 else 1
    deep = -(-count // columns)
    figure, axes = empty_figure(colours, (7.8, 0.5 + 2.5 * deep), rows=deep, columns=columns)
    setups = list(dict.fromkeys(row["setup"] for row in rows))
    over, label = _abscissa(rows)
    for ax, name in zip(axes, quantities, strict=False):
        for number, setup in enumerate(setups):
            for outside in (False, True):
                chosen = [
                    row
                    for row in rows
                    if row["setup"] == setup and row.get(name) is not None and (row["run_name"] in apart) == outside
                ]
                if not chosen:
                    continue
                bars = COVERAGE_FACTOR * np.array([row[f"u_{name}"] for row in chosen])
                colour = colours.second if outside else (colours.third, colours.fourth)[number % 2]
                what = f"set-up {setup + 1}" if len(setups) > 1 else "run"
                ax.errorbar(
                    [row[over] for row in chosen],
                    [row[name] for row in chosen],
                    yerr=bars if len(chosen) <= MOST_BARS or outside else None,
                    fmt=MARKS[number % len(MARKS)],
                    color=colour,
                    markersize=4,
                    markerfacecolor="none",
                    elinewidth=0.9,
                    capsize=2,
                    label=f"{what}, {'to be looked at' if outside else '95 %'}",
                )
        ax.set_title(named(name), fontsize=10, loc="left")
    for ax in axes[count:]:
        ax.set_visible(False)
    for ax in axes[max(count - columns, 0) : count]:
        ax.set_xlabel(label)
    figure.legend(
        *axes[0].get_legend_handles_labels(),
        loc="outside upper center",
        ncols=4,
        labelcolor=colours.ink,
        frameon=False,
        fontsize=9,
    )
    return inline(figure, "polars", "Results of all runs over the angle of attack")


def _abscissa(rows: Sequence[Row]) -> tuple[str, str]:
    """What polars are drawn over: the angle that changes, else the number of the run."""
    for key, label in (("alpha_deg", "angle of attack [deg]"), ("beta_deg", "sideslip [deg]")):
        values = [row[key] for row in rows if row[key] is not None]
        if len(values) == len(rows) and values and max(values) - min(values) > 1e-6:
            return key, label
    return "place", "number of the run in the test"


def repeat_figure(rows: Sequence[Row], repeats: Sequence[RepeatGroup], quantities: Sequence[str]) -> str:
    """Draw how far each run is from the mean of its repeats, over what is stated, in the order of the test."""
    colours = PLACE_HOLDERS
    by_name = {row["run_name"]: row for row in rows}
    figure, axes = empty_figure(colours, (7.8, 3.0), rows=1, columns=1)
    ax = axes[0]
    paints = (colours.first, colours.second, colours.third, colours.fourth)
    for number, name in enumerate(quantities):
        x: list[float] = []
        y: list[float] = []
        for group in (one for one in repeats if one.quantity == name and one.scatter.expected > 0):
            # what is left of a deviation when the mean of so few is taken off
            usual = group.scatter.expected * np.sqrt(1 - 1 / len(group.runs))
            x += [by_name[run]["place"] for run in group.runs]
            y += [(by_name[run][name] - group.scatter.mean) / usual for run in group.runs]
        if x:
            ax.plot(x, y, MARKS[number % len(MARKS)], color=paints[number % 4], markersize=3.5, label=named(name))
    for level in (-COVERAGE_FACTOR, COVERAGE_FACTOR):
        ax.axhline(level, color=colours.ink, linewidth=0.8, linestyle="--")
    low, high = ax.get_ylim()
    ax.set_ylim(min(low, -3), max(high, 3))
    ax.set(xlabel="number of the run in the test", ylabel="deviation / stated")
    ax.locator_params(axis="x", integer=True)
    legend(ax, colours, "best", columns=6)
    return inline(figure, "repeats", "Deviation of runs from the mean of their repeats over what is stated")


def zero_figure(rows: Sequence[Row]) -> str | None:
    """Draw the zeros as loads along the test, from the middle one of each balance; None where there are none."""
    by_balance = zeros_of(rows)
    every = [row for zeros in by_balance.values() for row in zeros]
    names = [name for name in COMPONENTS if any(row.get(f"zero_{with_unit(name)}") is not None for row in every)]
    if not names:
        return None
    colours = PLACE_HOLDERS
    columns = 3 if len(names) > 2 else len(names)
    deep = -(-len(names) // columns)
    figure, axes = empty_figure(colours, (7.8, 0.4 + 1.9 * deep), rows=deep, columns=columns)
    for ax, name in zip(axes, names, strict=False):
        label = with_unit(name)
        for number, known in enumerate(by_balance.values()):
            zeros = [row for row in known if row.get(f"zero_{label}") is not None]
            if not zeros:
                continue
            level = np.array([row[f"zero_{label}"] for row in zeros])
            middle, x = float(np.median(level)), np.array([row["place"] for row in zeros])
            colour = (colours.third, colours.fourth)[number % 2]
            bars = COVERAGE_FACTOR * np.array([row[f"u_zero_{label}"] for row in zeros])
            ax.errorbar(x, level - middle, yerr=bars, fmt="o", color=colour, markersize=3.5, elinewidth=0.9, capsize=2)
            drift = np.array([row[f"zero_drift_{label}"] for row in zeros])
            after = level - middle + drift
            ax.vlines(x, level - middle, after, color=colours.second, linewidth=1.2)
            ax.plot(x[drift != 0], after[drift != 0], "_", color=colours.second, markersize=6)
        ax.set_title(f"{name} [{si_unit(name).replace('*', '·')}]", fontsize=10, loc="left")
    for ax in axes[len(names) :]:
        ax.set_visible(False)
    for ax in axes[max(len(names) - columns, 0) : len(names)]:
        ax.set_xlabel("run")
    return inline(figure, "zeros", "Zeros along the test, as loads")


def resonance_figure(rows: Sequence[Row]) -> str | None:
    """Draw changes of stiffness and damping along the test in percent; None where no record tells them."""
    labels = [
        label
        for label in dict.fromkeys(key for row in rows for key in row if key.startswith(("k_change_", "b_change_")))
        if sum(row.get(label) is not None for row in rows) > max(1, SETTINGS.told * len(rows))
    ]
    if not labels:
        return None
    colours = PLACE_HOLDERS
    figure, axes = empty_figure(colours, (7.8, 3.0), rows=1, columns=2)
    paints = (colours.third, colours.second, colours.fourth, colours.first)
    for ax, kind, title in ((axes[0], "k", "stiffness, change [%]"), (axes[1], "b", "damping, change [%]")):
        shown = [label for label in labels if label.startswith(kind)]
        for number, label in enumerate(shown):
            told = [row for row in rows if row.get(label) is not None]
            bars = [100 * COVERAGE_FACTOR * row[f"u_{label}"] for row in told]
            ax.errorbar(
                [row["place"] for row in told],
                [100 * row[label] for row in told],
                yerr=bars if len(told) <= MOST_BARS else None,
                fmt=MARKS[number % len(MARKS)],
                color=paints[number % 4],
                markersize=3.5,
                markerfacecolor="none",
                elinewidth=0.7,
                label=label[len("k_change_") :].replace("_", " "),
            )
        ax.axhline(0, color=colours.ink, linewidth=0.8)
        ax.set_xlabel("number of the run in the test")
        ax.locator_params(axis="x", integer=True)
        ax.set_title(title, fontsize=10, loc="left")
        legend(ax, colours, "best", columns=2)
    return inline(figure, "resonances", "Changes of stiffness and damping along the test")
