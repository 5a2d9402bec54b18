"""The page of a force: raw load beside it with its band, both spectra, and the uncertainty budget."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aerobalance.app.reports.force_curves import ForceCurves
from aerobalance.app.reports.page import (
    PLACE_HOLDERS,
    empty_figure,
    inline,
    legend,
    legend_above,
    power_of_ten,
    write_page,
)
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.independent import IndependentDynamics
from aerobalance.estimation.display import COVERAGE_FACTOR
from aerobalance.estimation.result import ForceSummary
from aerobalance.io.artefacts import provenance
from aerobalance.recording.components import density_unit, dynamics_units, si_unit
from aerobalance.recording.recording import Recording
from aerobalance.uncertainty.budget import beyond_its_extremes, component_budget, spectrum


def write_force_report(
    path: Path,
    result: Mapping[str, Any],
    summaries: Mapping[str, ForceSummary],
    curves: Mapping[str, ForceCurves],
    *,
    recording: Recording,
    dynamics: BalanceDynamics,
    inputs: Sequence[Path],
) -> None:
    """Write what was found of the force as one HTML file that needs nothing else, whole or not at all.

    Parameters
    ----------
    path
        The HTML file.
    result
        What `aerobalance.app.commands.force` found.
    summaries
        What sums up the forces, by component.
    curves
        What their figures show.
    recording
        The recording; its samples are not looked at.
    dynamics
        The dynamics that were used.
    inputs
        Files named with their SHA-256.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    figures = {}
    for name, summary in summaries.items():
        shown = curves[name]
        figures[name] = {
            "force": force_figure(summary, shown, rate=recording.rate),
            "window": [float(edge) for edge in shown.closer(summary).time(recording.rate)[[0, -1]]],
            "spectrum": spectrum_figure(summary, shown, rate=recording.rate),
            "budget": budget_figure(summary),
        }
    content = {
        "found": {**result, "warnings_beside": _beside(result)},
        "file": recording.name,
        "figures": figures,
        "beyond": {name: beyond_its_extremes(result["components"][name], si_unit(name)) for name in summaries},
        "used": used(recording, dynamics, summaries, samples=max(one.samples * one.every for one in curves.values())),
        "units": {name: si_unit(name).replace("*", "·") for name in summaries},
        "origin": provenance(inputs),
    }
    write_page(path, "force.html.j2", content)


def used(
    recording: Recording, dynamics: BalanceDynamics, summaries: Mapping[str, ForceSummary], *, samples: int
) -> list[tuple[str, str, Sequence[float | None] | str, str]]:
    """Rows of what was used: of what (record, or a component), its name, value with uncertainty or words, and unit."""
    rows: list[tuple[str, str, Sequence[float | None] | str, str]] = []
    if recording.epoch is not None:
        began = recording.epoch + np.timedelta64(round(1e6 * recording.start), "us")
        rows.append(("record", "first sample", str(began.astype("datetime64[ms]")).replace("T", " "), ""))
    rows.append(("record", "duration", (samples / recording.rate, None), "s"))
    rows.append(("record", "sampling rate", (recording.rate, None), "Hz"))
    for name in summaries:
        if isinstance(dynamics, IndependentDynamics):
            own = dynamics[name]
            units = dynamics_units(name) | {"damping_ratio": ""}
            rows += [
                (name, key.replace("_", " "), (float(getattr(own, key)), own.uncertainty(key)), unit.replace("*", "·"))
                for key, unit in units.items()
                if key != "delay" or own.delay
            ]
            rows += [(name, f"mode {i}", one.told(), "") for i, one in enumerate(own.further_modes, start=2)]
    if not isinstance(dynamics, IndependentDynamics):
        modes = zip(dynamics.modes, dynamics.modes.uncertainties, strict=True)
        coupled = ", ".join(dynamics.components)
        rows += [(coupled, f"mode {i}", one.told(*u), "") for i, (one, u) in enumerate(modes, start=1)]
    return rows


def _beside(result: Mapping[str, Any]) -> list[str]:
    """Warnings that no doubt says already."""
    return [text for text in result["warnings"] if not any(doubt["text"] in text for doubt in result["doubts"])]


def force_figure(summary: ForceSummary, shown: ForceCurves, *, rate: float) -> str:
    """Draw the raw load and the force with its 95 % band: the whole record above, closer below."""
    colours, unit = PLACE_HOLDERS, si_unit(summary.component).replace("*", "·")
    figure, axes = empty_figure(colours, (7.6, 6.2), rows=2, heights=(1, 1.3))
    closer, whole = shown.closer(summary), shown.times(rate)
    near = closer.time(rate)
    looks = ((colours.first, 0.8, "balance load"), (colours.second, 1.4, "force applied"))
    for ax, time, curves in (
        (axes[0], whole, (shown.load, shown.force)),
        (axes[1], near, (closer.load, closer.force)),
    ):
        for values, (colour, width, label) in zip(curves, looks, strict=True):
            ax.plot(time, values, color=colour, linewidth=width, label=label)
        ax.set_ylabel(f"{summary.component} [{unit}]")
    band = COVERAGE_FACTOR * closer.uncertainty
    low, high = closer.force - band, closer.force + band
    axes[1].fill_between(near, low, high, color=colours.second, alpha=0.3, linewidth=0, label="95 % band")
    axes[0].set_xlim(shown.start, shown.start + (shown.samples - 1) * shown.every / rate)
    axes[1].set_xlim(near[0], near[-1])
    axes[0].axvspan(near[0], near[-1], color=colours.third, alpha=0.12, linewidth=0)
    axes[1].set(xlabel="time [s]")
    legend(axes[1], colours, "best", columns=3)
    figure.align_ylabels()
    name = summary.component
    return inline(figure, f"force-{name}", f"Balance load and force applied of {name}, whole and closer")


def spectrum_figure(summary: ForceSummary, shown: ForceCurves, *, rate: float) -> str:
    """Draw the spectra of load and force, the latter with its two bands."""
    colours, unit = PLACE_HOLDERS, density_unit(summary.component).replace("*", "·").replace("^2", "²")
    figure, (ax,) = empty_figure(colours, (7.6, 3.8), rows=1)
    found = spectrum(summary, rate=rate)
    inner = slice(1, None)
    frequency, (of_load, density) = found.frequency, shown.load_spectrum(rate)
    force = found.density[inner]
    highest = max(float(force.max(initial=0.0)), float(density[inner].max(initial=0.0)), 1e-30)
    least = 1e-9 * highest
    ax.loglog(
        of_load[inner], np.maximum(density[inner], least), color=colours.first, linewidth=0.9, label="balance load"
    )
    for u, colour, label in (
        (found.scatter, colours.third, "95 % band as an estimate of a stationary spectrum"),
        (found.uncertainty, colours.second, "95 % band of the force"),
    ):
        low, high = (force + sign * COVERAGE_FACTOR * u[inner] for sign in (-1, 1))
        ax.fill_between(
            frequency[inner],
            np.maximum(low, least),
            np.maximum(high, least),
            color=colour,
            alpha=0.25,
            linewidth=0,
            label=label,
        )
    resolved = max(summary.bandwidth, float(frequency[1]))
    known = np.where(frequency[inner] <= resolved, np.maximum(force, least), np.nan)
    ax.plot(frequency[inner], np.maximum(force, least), color=colours.second, linewidth=0.7, linestyle="--")
    ax.plot(frequency[inner], known, color=colours.second, linewidth=1.4, label="force applied")
    ax.axvline(resolved, color=colours.muted, linewidth=0.8, linestyle=":")
    ax.set(xlabel="frequency [Hz]", ylabel=f"density [{unit}]", ylim=(least * 0.8, 3 * highest))
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.yaxis.set_major_formatter(power_of_ten)
    legend(ax, colours, "lower left")
    name = summary.component
    return inline(figure, f"spectrum-{name}", f"Spectra of balance load and force applied of {name}")


def budget_figure(summary: ForceSummary) -> str:
    """Draw the budget: what each contribution has, and what would be left of the whole if its cause were halved."""
    colours, unit = PLACE_HOLDERS, si_unit(summary.component).replace("*", "·")
    rows = [row for row in component_budget(summary) if row.rms > 0]
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
    legend_above(figure, ax, colours, columns=3)
    name = summary.component
    return inline(figure, f"budget-{name}", f"Uncertainty budget of {name}")
