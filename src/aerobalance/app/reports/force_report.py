"""The page of a force: raw load beside it with its band, both spectra, and the uncertainty budget."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.app.reports.page import PLACE_HOLDERS, empty_figure, inline, legend, write_page
from aerobalance.estimation.force import Force
from aerobalance.estimation.result import ComponentForce
from aerobalance.io.artefacts import provenance
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.fourier import averaged_spectrum
from aerobalance.recording.resampling import interpolate_gaps_linearly
from aerobalance.uncertainty.budget import component_budget, segment_length, spectrum

COVERAGE_FACTOR: Final = 1.96
"""Standard uncertainties on either side that hold 95 % of the errors."""

PIECES: Final = 1200
"""Pieces of the record of which a curve shows the least and the largest value."""

CLOSE: Final = 400
"""Samples of the closer view."""

BEFORE: Final = 0.3
"""Share of the closer view that lies before the event."""


def write_force_report(
    path: Path,
    result: Mapping[str, Any],
    force: Force,
    *,
    inputs: Sequence[Path],
) -> None:
    """Write what was found of the force as one HTML file that needs nothing else, whole or not at all.

    Parameters
    ----------
    path
        The HTML file.
    result
        What `aerobalance.app.commands.force` found.
    force
        The forces, with the loads that they were worked out from.
    inputs
        Files named with their SHA-256.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    figures, recording = {}, force.recording
    for name, estimate in force.items():
        load = recording.channel(name).values
        window = closer_view(estimate)
        figures[name] = {
            "force": force_figure(estimate, load, time=recording.time, window=window),
            "window": [float(recording.time[window.start]), float(recording.time[window.stop - 1])],
            "spectrum": spectrum_figure(estimate, load, rate=recording.rate),
            "budget": budget_figure(estimate),
        }
    content = {
        "found": result,
        "file": recording.name,
        "figures": figures,
        "units": {name: si_unit(name).replace("*", "·") for name in force},
        "origin": provenance(inputs),
    }
    write_page(path, "force.html.j2", content)


def closer_view(estimate: ComponentForce) -> slice:
    """Samples around the first step, or else around the largest value."""
    values = estimate.values
    if estimate.steps:
        change = np.abs(np.diff(values))
        place = int(np.argmax(change))
    else:
        place = int(np.argmax(np.abs(values - values.mean())))
    length = min(CLOSE, values.size)
    first = int(np.clip(place - BEFORE * length, 0, values.size - length))
    return slice(first, first + length)


def force_figure(estimate: ComponentForce, load: Array, *, time: Array, window: slice) -> str:
    """Draw the raw load and the force with its 95 % band: the whole record above, closer below."""
    colours, unit = PLACE_HOLDERS, si_unit(estimate.component).replace("*", "·")
    figure, axes = empty_figure(colours, (7.6, 6.2), rows=2, heights=(1, 1.3))
    band = COVERAGE_FACTOR * estimate.uncertainty
    for number, (ax, part) in enumerate(zip(axes, (slice(None), window), strict=True)):
        for values, colour, width, label in (
            (load, colours.first, 0.8, "balance load"),
            (estimate.values, colours.second, 1.4, "force applied"),
        ):
            ax.plot(*envelope(time[part], values[part]), color=colour, linewidth=width, label=label)
        low, high = (estimate.values + sign * band for sign in (-1, 1))
        if number:
            ax.fill_between(
                time[part], low[part], high[part], color=colours.second, alpha=0.3, linewidth=0, label="95 % band"
            )
        ax.set(ylabel=f"{estimate.component} [{unit}]", xlim=(time[part][0], time[part][-1]))
    axes[0].axvspan(time[window.start], time[window.stop - 1], color=colours.third, alpha=0.12, linewidth=0)
    axes[1].set(xlabel="time [s]")
    legend(axes[1], colours, "best", columns=3)
    figure.align_ylabels()
    name = estimate.component
    return inline(figure, f"force-{name}", f"Balance load and force applied of {name}, whole and closer")


def envelope(time: Array, values: Array) -> tuple[Array, Array]:
    """Least and largest value of every piece of a curve, which looks like the curve and has few points."""
    width = time.size // PIECES
    if width < 3:
        return time, values
    count = time.size // width * width
    pieces = values[:count].reshape(-1, width)
    middle = time[:count].reshape(-1, width)[:, width // 2]
    return np.repeat(middle, 2), np.column_stack([pieces.min(axis=1), pieces.max(axis=1)]).ravel()


def spectrum_figure(estimate: ComponentForce, load: Array, *, rate: float) -> str:
    """Draw the spectra of load and force, the latter with its two bands."""
    colours, unit = PLACE_HOLDERS, si_unit(estimate.component).replace("*", "·")
    figure, (ax,) = empty_figure(colours, (7.6, 3.8), rows=1)
    found = spectrum(estimate, rate=rate)
    inner = slice(1, None)
    filled, length = interpolate_gaps_linearly(load), segment_length(load.size)
    frequency, power = averaged_spectrum(filled, rate=rate, length=length)
    density = np.real(power)
    shown = found.density[inner]
    highest = max(float(shown.max(initial=0.0)), float(density[inner].max(initial=0.0)), 1e-30)
    least = 1e-9 * highest
    ax.loglog(
        frequency[inner], np.maximum(density[inner], least), color=colours.first, linewidth=0.9, label="balance load"
    )
    for u, colour, label in (
        (found.scatter, colours.third, "95 % band as an estimate of a stationary spectrum"),
        (found.uncertainty, colours.second, "95 % band of the force"),
    ):
        low, high = (shown + sign * COVERAGE_FACTOR * u[inner] for sign in (-1, 1))
        ax.fill_between(
            found.frequency[inner],
            np.maximum(low, least),
            np.maximum(high, least),
            color=colour,
            alpha=0.25,
            linewidth=0,
            label=label,
        )
    drawn = np.maximum(shown, least)
    ax.plot(found.frequency[inner], drawn, color=colours.second, linewidth=1.4, label="force applied")
    ax.axvline(max(estimate.bandwidth, float(frequency[1])), color=colours.muted, linewidth=0.8, linestyle=":")
    squared = f"({unit})²" if "*" in unit else f"{unit}²"
    ax.set(xlabel="frequency [Hz]", ylabel=f"density [{squared}/Hz]", ylim=(least * 0.8, 3 * highest))
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")  # powers would need mathematical type
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    legend(ax, colours, "lower left")
    name = estimate.component
    return inline(figure, f"spectrum-{name}", f"Spectra of balance load and force applied of {name}")


def budget_figure(estimate: ComponentForce) -> str:
    """Draw the budget: what each contribution has, and what would be left of the whole if its cause were halved."""
    colours, unit = PLACE_HOLDERS, si_unit(estimate.component).replace("*", "·")
    rows = [row for row in component_budget(estimate) if row.rms > 0]
    whole = float(np.linalg.norm([row.rms for row in rows]))
    figure, (ax,) = empty_figure(colours, (7.6, 1.3 + 0.36 * max(len(rows), 1)), rows=1)
    places = np.arange(len(rows))
    ax.barh(places, [row.rms for row in rows], height=0.55, color=colours.second, label="contribution")
    ax.plot([row.if_halved for row in rows], places, "o", color=colours.third, label="all together, if it were halved")
    ax.axvline(whole, color=colours.ink, linewidth=1.0, label="all together")
    ax.set_yticks(places, [row.name for row in rows])
    ax.tick_params(axis="y", length=0)
    ax.set(xlabel=f"standard uncertainty, rms over the record [{unit}]", xlim=(0, 1.08 * whole or 1.0))
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    legend(ax, colours, "lower center", columns=3)
    ax.get_legend().set_bbox_to_anchor((0.5, 1.0))  # type: ignore[union-attr]
    name = estimate.component
    return inline(figure, f"budget-{name}", f"Uncertainty budget of {name}")
