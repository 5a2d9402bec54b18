"""The report of the demo: the paper's Figures 3 to 6 remade, tables beside them, in one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aerobalance.app.reports.page import PLACE_HOLDERS, PRINT, STYLE, empty_figure, inline, legend, write_page
from aerobalance.dynamics.single import Dynamics
from aerobalance.io.safe_write import replacing
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True, eq=False)
class LineFigure:
    """Data of Figure 3: points and slope of the line of (15).

    Attributes
    ----------
    points
        Abscissa [1] and ordinate f^2 [Hz^2] of every dwell, shape (n, 2).
    natural_frequency
        f0 from the slope [Hz].
    absolute_points
        The points with the phase of the absolute motion, shape (n, 2).
    """

    points: Array
    natural_frequency: float
    absolute_points: Array


@dataclass(frozen=True, slots=True, eq=False)
class ResonanceFigure:
    """Data of Figure 4: amplitude of the load against frequency.

    Attributes
    ----------
    frequency, measured, calculated
        Frequency [Hz] and amplitudes [N] of every dwell, shape (n,).
    noisy_frequency, noisy_deviation, noisy_uncertainty
        Dwells of the noisy record: frequency [Hz], measured less calculated amplitude [N] and the standard
        deviation [N] that the accelerometer's noise gives it, shape (m,).
    paper
        Largest deviation of the paper [N].
    """

    frequency: Array
    measured: Array
    calculated: Array
    noisy_frequency: Array
    noisy_deviation: Array
    noisy_uncertainty: Array
    paper: float


@dataclass(frozen=True, slots=True, eq=False)
class StepFigure:
    """Data of Figures 5 and 6: a load released at once.

    Attributes
    ----------
    time
        Time from the release [s], shape (n,).
    load, truth
        Balance load and force applied [N], shape (n,).
    differences
        Force by central differences [N], shape (n,).
    smoother, uncertainty
        Force by the smoother and its standard uncertainty [N], shape (n,).
    dynamics
        The dynamics that were identified.
    """

    time: Array
    load: Array
    truth: Array
    differences: Array
    smoother: Array
    uncertainty: Array
    dynamics: Dynamics


def line_figure(data: LineFigure) -> str:
    """Figure 3 of [Gorbushin2020]_ remade: f^2 against the abscissa of (15), and the line, as inline SVG."""
    colours = PLACE_HOLDERS
    figure, (axes,) = empty_figure(colours, (7.6, 4.2), rows=1)
    reach = np.array([0.0, 1.05 * data.points[:, 0].max()])
    axes.plot(reach, 1e-3 * reach * data.natural_frequency**2, color=colours.third, label="line through the origin")
    axes.plot(
        data.absolute_points[:, 0], 1e-3 * data.absolute_points[:, 1], "x", color=colours.first, markersize=5,
        label="phase between the accelerometers",
    )  # fmt: skip
    axes.plot(
        data.points[:, 0], 1e-3 * data.points[:, 1], "o", color=colours.second, markersize=4,
        label="phase of the load against the ground",
    )  # fmt: skip
    axes.set(xlabel="1 − M A₁ cos φ / AF", ylabel="f² [10³ Hz²]", xlim=(0, reach[1]), ylim=(0, None))
    legend(axes, colours, "upper left")
    return inline(figure, "fig3", "Squared frequency against the abscissa of equation 15: the points lie on a line")


def resonance_figure(data: ResonanceFigure) -> str:
    """Figure 4 of [Gorbushin2020]_ remade: amplitude measured and by (12), deviations below, as inline SVG."""
    colours = PLACE_HOLDERS
    figure, (top, middle, bottom) = empty_figure(colours, (7.6, 6.8), rows=3, heights=(2.4, 1, 1.3), share=True)
    top.plot(data.frequency, data.calculated, "-", color=colours.third, label="by (12) from the ground acceleration")
    top.plot(data.frequency, data.measured, "o", color=colours.second, markersize=4, label="measured")
    top.set(ylabel="|AF| [N]", ylim=(0, None))
    legend(top, colours, "upper left")
    middle.axhline(0, color=colours.muted, linewidth=0.8)
    middle.plot(data.frequency, 1e3 * (data.measured - data.calculated), "o", color=colours.second, markersize=3.5)
    middle.set(ylabel="measured − (12)\n[mN]")
    middle.set_title("steady drive, accelerometers with 0.05 m/s²", color=colours.muted, loc="left", fontsize=9.5)
    bottom.axhline(0, color=colours.muted, linewidth=0.8)
    for sign in (-1, 1):
        bottom.axhline(sign * data.paper, color=colours.muted, linewidth=0.8, linestyle="--")
    bottom.errorbar(
        data.noisy_frequency, data.noisy_deviation, yerr=2 * data.noisy_uncertainty, fmt="o", color=colours.first,
        markersize=3.5, elinewidth=0.9,
    )  # fmt: skip
    bottom.set(ylabel="measured − (12)\n[N]", xlabel="frequency [Hz]", xlim=(0, 1020))
    bottom.set_title(
        f"drive that wanders, accelerometers with 5 m/s²; dashes: the paper’s {data.paper:g} N",
        color=colours.muted, loc="left", fontsize=9.5,
    )  # fmt: skip
    figure.align_ylabels()
    return inline(
        figure, "fig4", "Amplitude of the axial force against frequency, measured and calculated, and deviations"
    )


def ringing_figure(data: StepFigure) -> str:
    """Figure 5 of [Gorbushin2020]_ remade: the balance load after the cut, as inline SVG."""
    colours = PLACE_HOLDERS
    figure, (whole, part) = empty_figure(colours, (7.6, 5.2), rows=2)
    begin = data.time >= -0.3
    whole.plot(data.time[begin], data.load[begin], color=colours.first, linewidth=0.7)
    rate, height = data.dynamics.decay_rate, abs(float(data.truth[0]))
    after = np.linspace(0, data.time[-1], 200)
    for sign in (-1, 1):
        whole.plot(after, sign * height * np.exp(-rate * after), "--", color=colours.second, linewidth=1)
    whole.set(ylabel="AF [N]", xlim=(-0.3, data.time[-1]))
    near = (data.time >= -0.03) & (data.time <= 0.12)
    fine = np.linspace(-0.03, 0.12, 1200)
    part.plot(
        fine, -height * data.dynamics.free_decay(fine), color=colours.third, linewidth=1.1,
        label="free decay with k and b identified",
    )  # fmt: skip
    part.plot(data.time[near], data.load[near], "o", color=colours.second, markersize=2.4, label="readings")
    part.set(ylabel="AF [N]", xlabel="time from the release [s]", xlim=(-0.03, 0.12))
    legend(part, colours, "upper right", columns=2)
    part.set_ylim(-1150, 1500)
    figure.align_ylabels()
    return inline(
        figure, "fig5", "Axial force of the balance after the cut, over seconds and over a tenth of a second"
    )


def force_figure(data: StepFigure, *, name: str) -> str:
    """Figure 6 of [Gorbushin2020]_ remade: the force recovered by two methods, and the truth, as inline SVG."""
    colours = PLACE_HOLDERS
    figure, (top, bottom) = empty_figure(colours, (7.6, 5.4), rows=2, heights=(1.6, 1))
    near = (data.time >= -0.05) & (data.time <= 0.3)
    time = 1e3 * data.time[near]
    top.plot(time, data.differences[near], color=colours.first, linewidth=0.8, label="central differences")
    top.plot(time, data.truth[near], color=colours.ink, linewidth=2.6, alpha=0.35, label="truth")
    top.plot(time, data.smoother[near], color=colours.second, linewidth=1.3, label="smoother")
    top.set(ylabel="F [N]", xlim=(-50, 300))
    legend(top, colours, "lower right", columns=3)
    error, band = (data.smoother - data.truth)[near], 2 * data.uncertainty[near]
    before = time < -0.7  # samples within one interval of the jump belong to either side
    after = time > 0.7
    for side in (before, after):
        bottom.fill_between(time[side], -band[side], band[side], color=colours.second, alpha=0.18, linewidth=0)
        bottom.plot(time[side], error[side], color=colours.second, linewidth=1.3)
    bottom.axhline(0, color=colours.ink, linewidth=0.8)
    bottom.set(ylabel="smoother − truth [N]", xlabel="time from the release [ms]", xlim=(-50, 300))
    figure.align_ylabels()
    return inline(figure, name, "Applied force recovered by central differences and by the smoother, beside the truth")


def step_figure(path: Path | str, data: StepFigure) -> None:
    """Save a picture of a ringing step and the force recovered from it, 1400 by 700 pixels.

    Parameters
    ----------
    path
        The PNG file.
    data
        The step.
    """
    from matplotlib import rc_context  # noqa: PLC0415 - loading takes a second; only reports need it

    colours = PRINT
    figure, (axes,) = empty_figure(colours, (7.0, 3.5), rows=1)
    near = (data.time >= -0.05) & (data.time <= 0.4)
    time = data.time[near]
    axes.plot(time, data.load[near], color=colours.first, linewidth=0.9, label="what the balance reads")
    axes.plot(time, data.smoother[near], color=colours.second, linewidth=2.2, label="force recovered")
    axes.plot(time, data.truth[near], ":", color=colours.ink, linewidth=1.2, label="force applied")
    axes.set(xlabel="time from the release [s]", ylabel="axial force [N]", xlim=(-0.05, 0.4))
    axes.set_ylim(-1250, 1500)
    legend(axes, colours, "upper right", columns=3)
    with replacing(path) as beside, rc_context(STYLE):
        figure.savefig(beside, format="png", dpi=200, facecolor="white", metadata={"Software": None})


def write_report(path: Path | str, content: Mapping[str, Any]) -> None:
    """Fill the page with figures and tables and write it, whole or not at all.

    Parameters
    ----------
    path
        The HTML file.
    content
        What the template `report.html.j2` names.
    """
    write_page(path, "report.html.j2", content)
