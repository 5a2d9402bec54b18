"""The report of the demo: the paper's Figures 3 to 6 remade, tables beside them, in one self-contained page.

Figures are drawn once, in place-holder colours that the page turns into the reader's light or dark ones.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from aerobalance.dynamics import Dynamics
from aerobalance.io.safe_write import replacing
from aerobalance.recording import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Palette:
    """Colours of a figure: lettering, secondary lettering, grid, and three for data, as hexadecimal codes."""

    ink: str
    muted: str
    grid: str
    first: str
    second: str
    third: str


PLACE_HOLDERS: Final = Palette("#010101", "#020202", "#030303", "#040404", "#050505", "#060606")
"""Colours that the page replaces by its own, light or dark."""

PRINT: Final = Palette("#1c1c1c", "#5f6368", "#dddddd", "#8a94a0", "#c2410c", "#1d4ed8")
"""Colours of a picture on white."""

STYLE: Final[Any] = {
    "font.size": 10.0,
    "font.family": ["DejaVu Sans"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}


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
        Load felt and force applied [N], shape (n,).
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
    figure, (axes,) = _figure(colours, (7.6, 4.2), rows=1)
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
    _legend(axes, colours, "upper left")
    return _svg(figure, "fig3", "Squared frequency against the abscissa of equation 15: the points lie on a line")


def resonance_figure(data: ResonanceFigure) -> str:
    """Figure 4 of [Gorbushin2020]_ remade: amplitude measured and by (12), deviations below, as inline SVG."""
    colours = PLACE_HOLDERS
    figure, (top, middle, bottom) = _figure(colours, (7.6, 6.8), rows=3, heights=(2.4, 1, 1.3), share=True)
    top.plot(data.frequency, data.calculated, "-", color=colours.third, label="by (12) from the ground acceleration")
    top.plot(data.frequency, data.measured, "o", color=colours.second, markersize=4, label="measured")
    top.set(ylabel="|AF| [N]", ylim=(0, None))
    _legend(top, colours, "upper left")
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
    return _svg(
        figure, "fig4", "Amplitude of the axial force against frequency, measured and calculated, and deviations"
    )


def ringing_figure(data: StepFigure) -> str:
    """Figure 5 of [Gorbushin2020]_ remade: the load felt after the cut, as inline SVG."""
    colours = PLACE_HOLDERS
    figure, (whole, part) = _figure(colours, (7.6, 5.2), rows=2)
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
    _legend(part, colours, "upper right", columns=2)
    part.set_ylim(-1150, 1500)
    figure.align_ylabels()
    return _svg(figure, "fig5", "Axial force of the balance after the cut, over seconds and over a tenth of a second")


def force_figure(data: StepFigure, *, name: str) -> str:
    """Figure 6 of [Gorbushin2020]_ remade: the force recovered by two methods, and the truth, as inline SVG."""
    colours = PLACE_HOLDERS
    figure, (top, bottom) = _figure(colours, (7.6, 5.4), rows=2, heights=(1.6, 1))
    near = (data.time >= -0.05) & (data.time <= 0.3)
    time = 1e3 * data.time[near]
    top.plot(time, data.differences[near], color=colours.first, linewidth=0.8, label="central differences")
    top.plot(time, data.truth[near], color=colours.ink, linewidth=2.6, alpha=0.35, label="truth")
    top.plot(time, data.smoother[near], color=colours.second, linewidth=1.3, label="smoother")
    top.set(ylabel="F [N]", xlim=(-50, 300))
    _legend(top, colours, "lower right", columns=3)
    error, band = (data.smoother - data.truth)[near], 2 * data.uncertainty[near]
    before = time < -0.7  # samples within one interval of the jump belong to either side
    after = time > 0.7
    for side in (before, after):
        bottom.fill_between(time[side], -band[side], band[side], color=colours.second, alpha=0.18, linewidth=0)
        bottom.plot(time[side], error[side], color=colours.second, linewidth=1.3)
    bottom.axhline(0, color=colours.ink, linewidth=0.8)
    bottom.set(ylabel="smoother − truth [N]", xlabel="time from the release [ms]", xlim=(-50, 300))
    figure.align_ylabels()
    return _svg(figure, name, "Applied force recovered by central differences and by the smoother, beside the truth")


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
    figure, (axes,) = _figure(colours, (7.0, 3.5), rows=1)
    near = (data.time >= -0.05) & (data.time <= 0.4)
    time = data.time[near]
    axes.plot(time, data.load[near], color=colours.first, linewidth=0.9, label="what the balance reads")
    axes.plot(time, data.smoother[near], color=colours.second, linewidth=2.2, label="force recovered")
    axes.plot(time, data.truth[near], ":", color=colours.ink, linewidth=1.2, label="force applied")
    axes.set(xlabel="time from the release [s]", ylabel="axial force [N]", xlim=(-0.05, 0.4))
    axes.set_ylim(-1250, 1500)
    _legend(axes, colours, "upper right", columns=3)
    with replacing(path) as beside, rc_context(STYLE):
        figure.savefig(beside, format="png", dpi=200, facecolor="white", metadata={"Software": None})


def _figure(
    colours: Palette,
    size: tuple[float, float],
    *,
    rows: int,
    heights: Sequence[float] | None = None,
    share: bool = False,
) -> tuple[Figure, list[Axes]]:
    """Empty figure with a column of axes in the report's style."""
    from matplotlib import rc_context  # noqa: PLC0415 - loading takes a second; only reports need it
    from matplotlib.figure import Figure  # noqa: PLC0415

    paint: Any = {
        "text.color": colours.ink,
        "axes.labelcolor": colours.ink,
        "axes.edgecolor": colours.muted,
        "xtick.color": colours.muted,
        "ytick.color": colours.muted,
        "grid.color": colours.grid,
        "axes.facecolor": "none",
        "figure.facecolor": "none",
    }
    with rc_context({**STYLE, **paint}):
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(rows, 1, squeeze=False, sharex=share, height_ratios=heights)
    return figure, list(grid[:, 0])


def _legend(axes: Axes, colours: Palette, place: Any, *, columns: int = 1) -> None:
    axes.legend(loc=place, ncols=columns, labelcolor=colours.ink, frameon=False, fontsize=9)


def _svg(figure: Figure, name: str, label: str) -> str:
    """Inline SVG of a figure: no addresses, ids of its own, place-holder colours turned into the page's variables."""
    from matplotlib import rc_context  # noqa: PLC0415 - loading takes a second; only reports need it

    buffer = io.StringIO()
    with rc_context({**STYLE, "svg.hashsalt": name, "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = text.replace("url(#", f"url(#{name}-")
    text = re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"|(<svg[^>]*?) height="[^"]*"', r"\1\2", text, count=1)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    for colour, variable in zip(
        ("ink", "muted", "grid", "first", "second", "third"),
        ("--ink", "--muted", "--grid", "--first", "--second", "--third"),
        strict=True,
    ):
        text = text.replace(getattr(PLACE_HOLDERS, colour), f"var({variable})")
    return text.replace("<svg", f'<svg role="img" aria-label="{label}"', 1)


def number(value: float | None, digits: int = 5) -> str:
    """Write a number for a table: significant digits, a true minus sign, powers of ten raised."""
    if value is None or not np.isfinite(value):
        return "–"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, power = text.split("e")
        text = f"{mantissa}·10<sup>{int(power)}</sup>"
    return text.replace("-", "−")


def significant(value: float, digits: int) -> str:
    """Write a number rounded to significant digits, zeros at the end kept, without powers of ten."""
    if not value:
        return "0"
    places = digits - 1 - int(f"{value:.{digits - 1}e}".split("e")[1])  # the exponent after rounding
    return f"{round(value, places):.{max(0, places)}f}".replace("-", "−")


def with_uncertainty(value: float, u: float | None, scale: float = 1.0) -> str:
    """Write a value and its standard uncertainty, rounded to two digits of the uncertainty."""
    value = value / scale
    if not u:
        return number(value, 5)
    u = u / scale
    places = max(0, 1 - int(np.floor(np.log10(u))))
    return f"{value:.{places}f} <span class=u>± {u:.{places}f}</span>".replace("-", "−")


def write_report(path: Path | str, content: Mapping[str, Any]) -> None:
    """Fill the page with figures and tables and write it, whole or not at all.

    Parameters
    ----------
    path
        The HTML file.
    content
        What the template `report.html.j2` names.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - only reports need it
    from markupsafe import Markup  # noqa: PLC0415

    environment = Environment(
        loader=PackageLoader("aerobalance"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["number"] = lambda value, digits=5: Markup(number(value, digits))
    environment.filters["digits"] = significant
    environment.filters["fixed"] = lambda value, places: f"{value:.{places}f}".replace("-", "−")
    environment.filters["with_u"] = lambda pair, scale=1.0: Markup(with_uncertainty(pair[0], pair[1], scale))
    page = environment.get_template("report.html.j2").render(content)
    with replacing(path) as beside:
        beside.write_text(page, encoding="utf-8")
