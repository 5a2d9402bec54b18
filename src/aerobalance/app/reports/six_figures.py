"""Figures of six components: one row each, what the balance felt beside what was applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from aerobalance.app.reports.page import PLACE_HOLDERS, empty_figure, inline, legend
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit


@dataclass(frozen=True, slots=True, eq=False)
class SixFigure:
    """What is drawn.

    Attributes
    ----------
    time
        Shape (n,) [s].
    felt, found, truth
        Balance loads, forces worked out and forces applied by component, shape (n,) each [N, N*m].
    """

    time: Array
    felt: Mapping[str, Array]
    found: Mapping[str, Array]
    truth: Mapping[str, Array]


def six_figure(data: SixFigure, label: str) -> str:
    """Draw one row per component, in SVG."""
    colours = PLACE_HOLDERS
    names = list(data.found)
    figure, axes = empty_figure(colours, (7.6, 1.55 * len(names)), rows=len(names), share=True)
    thin = max(data.time.size // 4000, 1)
    for ax, name in zip(axes, names, strict=True):
        for values, colour, width, what, dashes in (
            (data.felt[name], colours.first, 0.7, "balance load (raw)", "-"),
            (data.found[name], colours.second, 1.4, "force recovered", "-"),
            (data.truth[name], colours.ink, 0.8, "force applied (truth)", (0, (4, 3))),
        ):
            ax.plot(data.time[::thin], values[::thin], color=colour, linewidth=width, linestyle=dashes, label=what)
        ax.set(ylabel=f"{name} [{si_unit(name).replace('*', '·')}]", xlim=(data.time[0], data.time[-1]))
    axes[-1].set(xlabel="time [s]")
    legend(axes[0], colours, (0.28, 1.02), columns=3)
    text = f"Six components, {label}: balance load, force recovered, force applied"
    return inline(figure, f"six-{label.replace(' ', '-')}", text)
