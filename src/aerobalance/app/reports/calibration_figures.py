"""Figures of a calibration: residuals against load, order and temperature, and sensitivities to + and - loads."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

from aerobalance.app.reports.page import PLACE_HOLDERS, empty_figure, inline
from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.calibration.quality import SETTINGS, Quality
from aerobalance.recording.channel import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Abscissa = Literal["load", "order", "temperature"]

COLOURS: Final = ("third", "second", "fourth", "first")
MARKERS: Final = ("o", "^", "s", "D")
SHAPES: Final = {
    "o": '<circle cx="6" cy="6" r="4"/>',
    "^": '<path d="M6 1.5L10.5 10H1.5z"/>',
    "s": '<path d="M2.5 2.5h7v7h-7z"/>',
    "D": '<path d="M6 1l5 5-5 5-5-5z"/>',
}
"""The markers as the page draws them beside the names of the series."""

MOST_STYLES: Final = len(COLOURS) * len(MARKERS)
"""Most series that colour and marker tell from each other."""

MOST_NAMES: Final = 20
"""Most series whose names find room under an axis."""

MOST_LABELS: Final = 6
"""Most outliers labelled in one panel, strongest first."""

UNLOADED: Final = 0.5
"""Load below which a point is drawn faint in the panel of a component [% of capacity]."""


class SeriesStyle(NamedTuple):
    """Colour (a field of the palette) and marker of a series."""

    colour: str
    marker: str


def series_style(number: int, count: int) -> SeriesStyle:
    """Give every series a colour and marker of its own, neighbours both different; one style where there are many."""
    if count > MOST_STYLES:
        return SeriesStyle(COLOURS[0], MARKERS[0])
    turn = number // len(COLOURS)
    return SeriesStyle(COLOURS[number % len(COLOURS)], MARKERS[(number + turn) % len(MARKERS)])


def series_key(calibration: Calibration) -> list[dict[str, str]]:
    """Name, colour and marker of every series, for the page; empty where there are too many to tell apart."""
    names = calibration.schedule.series_names
    if len(names) > MOST_STYLES:
        return []
    styles = [series_style(number, len(names)) for number in range(len(names))]
    return [
        {"name": name, "colour": style.colour, "shape": SHAPES[style.marker]}
        for name, style in zip(names, styles, strict=True)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Panel:
    """One component against one abscissa: n points."""

    calibration: Calibration
    quality: Quality
    index: int
    against: Abscissa

    @property
    def x(self) -> Array:
        schedule = self.calibration.schedule
        if self.against == "load":
            return np.asarray(100 * schedule.loads[:, self.index] / schedule.capacities[self.index])
        if self.against == "temperature" and schedule.temperature is not None:
            return schedule.temperature
        return np.arange(1.0, len(schedule.points) + 1)

    @property
    def y(self) -> Array:
        capacity = self.calibration.schedule.capacities[self.index]
        return np.asarray(100 * self.calibration.residuals[:, self.index] / capacity)

    @property
    def outliers(self) -> list[int]:
        return [item.point for item in self.quality.outliers if item.component == self.index]

    @property
    def label(self) -> str:
        schedule, y = self.calibration.schedule, self.y
        worst = int(np.argmax(np.where(schedule.fitted, np.abs(y), -1.0)))
        against = {"load": "its own load", "order": "the order of the points", "temperature": "temperature"}
        text = (
            f"Residuals of {schedule.components[self.index]} against {against[self.against]}: "
            f"standard deviation {100 * self.quality.deviation[self.index]:.3f} % of capacity, largest "
            f"{y[worst]:+.3f} % at point {schedule.points[worst]}"
        )
        count = len(self.outliers)
        return f"{text}, {count} outlier{'s' if count > 1 else ''}" if count else text


def residual_panels(calibration: Calibration, quality: Quality, against: Abscissa) -> tuple[str, ...]:
    """Residuals in percent of capacity, one inline SVG a component.

    Parameters
    ----------
    calibration, quality
        What is shown.
    against
        ``"load"``: the component's own applied load; ``"order"``: the points one after the other, with the bounds of
        the series; ``"temperature"``.

    Raises
    ------
    ValueError
        Temperature was not recorded.
    """
    if against == "temperature" and calibration.schedule.temperature is None:
        raise ValueError(f"{calibration.schedule.name} has no temperature")
    count = len(calibration.schedule.components)
    return tuple(_residual_panel(_Panel(calibration, quality, index, against)) for index in range(count))


def _residual_panel(panel: _Panel) -> str:
    colours, schedule = PLACE_HOLDERS, panel.calibration.schedule
    figure, (axes,) = empty_figure(colours, (4.1, 2.7), rows=1)
    axes.tick_params(labelsize=9)
    reach = 1.25 * max(float(np.max(np.abs(panel.y))), 2.2 * 100 * float(panel.quality.deviation[panel.index]), 1e-6)
    band = 200 * float(panel.quality.deviation[panel.index])
    axes.axhline(0, color=colours.muted, linewidth=0.8)
    for level in (-band, band):
        axes.axhline(level, color=colours.muted, linewidth=0.8, linestyle=(0, (4, 3)))
    _points(axes, panel)
    axes.set_ylim(-reach, reach)
    axes.set_title(schedule.components[panel.index], loc="left", color=colours.ink, fontsize=11, fontweight="bold")
    axes.set_ylabel("residual [% of capacity]", fontsize=9)
    if panel.against == "order":
        _series_bounds(axes, panel)
    else:
        name = "applied load [% of capacity]" if panel.against == "load" else "temperature [°C]"
        axes.set_xlabel(name, fontsize=9)
    _mark_outliers(axes, panel)
    return inline(figure, f"{panel.against}-{panel.index}", panel.label)


def _points(axes: Axes, panel: _Panel) -> None:
    """Fitted points in the style of their series, confirmation points as crosses over them."""
    colours, schedule = PLACE_HOLDERS, panel.calibration.schedule
    x, y = panel.x, panel.y
    count = len(schedule.series_names)
    unloaded = (np.abs(x) < UNLOADED) & (panel.against == "load")
    for number in range(count):
        style = series_style(number, count)
        inside = schedule.fitted & (schedule.series == number)
        for rows, alpha, size in ((inside & unloaded, 0.45, 3.0), (inside & ~unloaded, 0.9, 3.8)):
            axes.plot(
                x[rows], y[rows], style.marker, color=getattr(colours, style.colour), alpha=alpha, markersize=size,
                markeredgewidth=0,
            )  # fmt: skip
    held = schedule.confirmation
    axes.plot(x[held], y[held], "x", color=colours.ink, markersize=4.5, markeredgewidth=1.1)


def _stretches(panel: _Panel) -> list[tuple[int, int, str]]:
    """First point, end and name of every stretch of points of one series; ✕ for confirmation points read apart."""
    schedule = panel.calibration.schedule
    key = np.array(schedule.series)
    held = np.flatnonzero(schedule.confirmation)
    if held.size and np.ptp(held) + 1 == held.size:
        key[held] = -1
    bounds = [0, *(np.flatnonzero(np.diff(key)) + 1).tolist(), len(key)]
    return [
        (first, end, "✕" if key[first] < 0 else schedule.series_names[key[first]]) for first, end in pairwise(bounds)
    ]


def _series_bounds(axes: Axes, panel: _Panel) -> None:
    """Shade every other series and write the names under the axis, where there is room."""
    stretches = _stretches(panel)
    margin = 0.5 + 0.015 * len(panel.y)  # room for rings and crosses at the ends
    axes.set_xlim(1 - margin, len(panel.y) + margin)
    axes.grid(visible=False, axis="x")
    if len(stretches) <= 4 * MOST_NAMES:
        for first, end, _ in stretches[1::2]:
            axes.axvspan(first + 0.5, end + 0.5, color=PLACE_HOLDERS.muted, alpha=0.12, linewidth=0, zorder=0)
    if len(stretches) > MOST_NAMES:
        axes.set_xlabel("point, in the order of the file; shading: series", fontsize=9)
        return
    short = [name if len(name) <= 12 else f"{name[:11]}…" for _, _, name in stretches]
    turned = max(map(len, short)) > 2
    axes.set_xticks([(first + end + 1) / 2 for first, end, _ in stretches], short, rotation=90 if turned else 0)
    axes.tick_params(axis="x", length=0, labelsize=8)
    axes.set_xlabel("series, in the order of the points", fontsize=9)


def _mark_outliers(axes: Axes, panel: _Panel) -> None:
    """Ring the outliers; name the strongest where the name covers no other name."""
    colours, points = PLACE_HOLDERS, panel.outliers
    if not points:
        return
    x, y = panel.x, panel.y
    axes.plot(
        x[points], y[points], "o", markersize=8, markerfacecolor="none", markeredgecolor=colours.ink,
        markeredgewidth=1.1,
    )  # fmt: skip
    figure = axes.get_figure(root=True)
    if figure is None:
        return
    figure.draw_without_rendering()  # settles where the axes lie
    frame = axes.get_window_extent()
    pixel = figure.dpi / 72
    cloud = axes.transData.transform(np.column_stack([x, y]))
    taken: list[Box] = []
    for point in points[:MOST_LABELS]:
        name = panel.calibration.schedule.points[point]
        at = cloud[point]
        places = _places(at, 4.9 * len(name) * pixel, 9 * pixel, gap=6 * pixel)
        free = [
            box
            for box in places
            if box.inside(Box(frame.x0, frame.y0, frame.x1, frame.y1))
            and not any(box.covers(other) for other in taken)
        ]
        if not free:
            continue
        box = min(free, key=lambda place: place.count(cloud))  # the first of those that hide the fewest points
        taken.append(box)
        axes.annotate(
            name, (x[point], y[point]), xytext=((box.left - at[0]) / pixel, (box.bottom - at[1]) / pixel + 1.5),
            textcoords="offset points", fontsize=8, color=colours.ink, in_layout=False,
            arrowprops={"arrowstyle": "-", "color": colours.muted, "linewidth": 0.7, "shrinkA": 0, "shrinkB": 4.5},
        )  # fmt: skip


class Box(NamedTuple):
    """Where a label lies [pixels]."""

    left: float
    bottom: float
    right: float
    top: float

    def inside(self, frame: Box) -> bool:
        """Whether it lies in a frame."""
        return (
            self.left >= frame.left
            and self.bottom >= frame.bottom
            and self.right <= frame.right
            and self.top <= frame.top
        )

    def covers(self, other: Box) -> bool:
        """Whether it lies over another one."""
        across = self.left < other.right and other.left < self.right
        return across and self.bottom < other.top and other.bottom < self.top

    def count(self, points: Array) -> int:
        """Count the points that it hides."""
        x, y = points.T
        return int(np.count_nonzero((x > self.left) & (x < self.right) & (y > self.bottom) & (y < self.top)))


def _places(at: Array, width: float, height: float, *, gap: float) -> list[Box]:
    """List where the label of a point may lie: on either side of it, level with it first."""
    return [
        Box(left, float(at[1]) + shift * height, left + width, float(at[1]) + (shift + 1) * height)
        for shift in (-0.5, 0.3, -1.3, 1.2, -2.2)
        for left in (float(at[0]) + gap, float(at[0]) - gap - width)
    ]


def direction_figure(calibration: Calibration, quality: Quality) -> str:
    """Difference of the sensitivities to + and - loads of every bridge, with 95 % intervals, as inline SVG."""
    colours, names = PLACE_HOLDERS, calibration.matrix.gauges
    figure, (axes,) = empty_figure(colours, (4.6, 0.9 + 0.36 * len(names)), rows=1)
    limit = 100 * SETTINGS.bidirectional
    axes.axvspan(-limit, limit, color=colours.muted, alpha=0.14, linewidth=0, zorder=0)
    axes.axvline(0, color=colours.muted, linewidth=0.8)
    for place, direction in enumerate(quality.directions):
        if not direction.known:
            axes.text(0, place, "loaded one way only", ha="center", va="center", fontsize=9, color=colours.muted)
            continue
        colour, marker = (colours.second, "D") if direction.bidirectional else (colours.third, "o")
        interval = 0.0 if np.isnan(direction.interval) else 100 * direction.interval
        axes.errorbar(
            100 * direction.difference, place, xerr=interval, fmt=marker, color=colour, markersize=5.5, elinewidth=1.6,
            capsize=3,
        )  # fmt: skip
    axes.set_yticks(range(len(names)), names)
    axes.set(ylim=(len(names) - 0.5, -0.5), xlabel="sensitivity to + loads less that to − loads [%]")
    axes.set_xlim(min(axes.get_xlim()[0], -1.4 * limit), max(axes.get_xlim()[1], 1.4 * limit))
    axes.grid(visible=False, axis="y")
    two = [name for name, item in zip(names, quality.directions, strict=True) if item.bidirectional]
    label = f"bidirectional: {', '.join(two)}" if two else "no bridge is bidirectional"
    return inline(figure, "direction", f"Difference of the sensitivities to + and − loads; {label}")
