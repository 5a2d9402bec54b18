"""The page of an identification: mass, stiffness and damping with their uncertainty, and the data behind them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.app.commands.shared import recording_of
from aerobalance.app.monitor.minmax_strips import Extremes
from aerobalance.app.reports.demo_report import LineFigure, line_figure
from aerobalance.app.reports.page import PLACE_HOLDERS, empty_figure, inline, legend, write_page
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.base_excitation.paper_procedure import reference_fit
from aerobalance.identification.base_excitation.sine_dwell import find_dwells
from aerobalance.io.artefacts import provenance
from aerobalance.recording.components import dynamics_units, si_unit
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording

PIECES: Final = 1200
"""Pieces of the record of which the figure shows the least and the largest value."""

CLOSE: Final = 12.0
"""Periods of the natural frequency that the closer view of a release shows."""


def write_identified(path: Path, account: Mapping[str, Any], recording: Path, *, component: str, kind: str) -> None:
    """Write what was identified as one HTML file that needs nothing else, whole or not at all.

    Parameters
    ----------
    path
        The HTML file.
    account
        What `aerobalance.app.commands.identify` found.
    recording
        What it was found from.
    component
        The component.
    kind
        ``decay`` or ``rig``.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    record = recording_of(recording)
    found = account["components"][component]
    figures = [
        ("record", _record_figure(record, component), "The whole record: balance load, its least and largest values.")
    ]
    if kind == "decay":
        figures += _release(record, found, component)
    else:
        figures += _response(record, found, component)
    units = {name: unit.replace("*", "·") for name, unit in dynamics_units(component).items() if unit != "1"}
    units["delay"] = "µs"
    content = {
        "file": recording.name,
        "component": component,
        "kind": kind,
        "rows": [
            (name.replace("_", " "), [found[name]["value"] * scale, found[name]["u"] * scale], unit)
            for name, unit in units.items()
            if isinstance(found.get(name), Mapping)
            for scale in (1e6 if name == "delay" else 1.0,)
        ],
        "fit": found.get("fit", {}),
        "modes": found.get("modes", []),
        "warnings": account["warnings"],
        "figures": figures,
        "origin": provenance([recording]),
    }
    write_page(path, "identified.html.j2", content)


def _record_figure(record: Recording, component: str) -> str:
    values = record.channel(component).values
    width = max(1, values.size // PIECES)
    bins = Extremes(1, width, longest=2 * PIECES).push(0, values[:, None])
    time = record.start + (bins.first + np.arange(len(bins.least)) + 0.5) * width / record.rate
    figure, (axes,) = empty_figure(PLACE_HOLDERS, (7.6, 2.8), rows=1)
    axes.fill_between(time, bins.least[:, 0], bins.largest[:, 0], color=PLACE_HOLDERS.first, linewidth=0.8)
    axes.set(xlabel="time [s]", ylabel=f"{component} [{si_unit(component).replace('*', '·')}]")
    return inline(figure, "record", f"{component} over the whole record")


def _release(record: Recording, found: Mapping[str, Any], component: str) -> list[tuple[str, str, str]]:
    """The readings about the release, with the free decay of the dynamics that were identified."""
    fit = found.get("fit", {})
    if not fit.get("release"):
        return []
    dynamics = Dynamics(component, *(found[name]["value"] for name in ("mass", "stiffness", "damping")))
    begin = fit["release"]["value"]
    span = CLOSE / dynamics.natural_frequency
    time = record.time
    near = (time > begin - span / 5) & (time < begin + span)
    values = record.channel(component).values
    rest = float(np.nanmean(values[time > fit["window"]["value"][1] - 0.2 * (fit["window"]["value"][1] - begin)]))
    before = values[(time < begin - 0.002) & (time > begin - span)]
    height = (float(np.nanmean(before)) if before.size else rest + fit["height"]["value"]) - rest
    fine = np.linspace(0, span, 1500)
    figure, (axes,) = empty_figure(PLACE_HOLDERS, (7.6, 3.4), rows=1)
    axes.plot(
        fine, rest + height * dynamics.free_decay(fine), color=PLACE_HOLDERS.third, linewidth=1.2,
        label="free decay with the dynamics identified",
    )  # fmt: skip
    axes.plot(time[near] - begin, values[near], ".", color=PLACE_HOLDERS.second, markersize=4, label="readings")
    axes.set(xlabel="time from the release [s]", ylabel=f"{component} [{si_unit(component).replace('*', '·')}]")
    legend(axes, PLACE_HOLDERS, "upper right", columns=2)
    text = "The release: readings, and the free decay that stiffness and damping give."
    return [("release", inline(figure, "release", "Readings about the release and the free decay"), text)]


def _response(record: Recording, found: Mapping[str, Any], component: str) -> list[tuple[str, str, str]]:
    """Amplitudes of the dwells, and the line of (15) as in Figure 3 of [Gorbushin2020]_."""
    rows = found.get("fit", {}).get("dwells", [])
    if not rows:
        return []
    frequency, measured, calculated = (
        np.array([row[key] for row in rows]) for key in ("frequency", "measured", "calculated")
    )
    order = np.argsort(frequency)
    figure, (axes,) = empty_figure(PLACE_HOLDERS, (7.6, 3.2), rows=1)
    axes.plot(
        frequency[order], calculated[order], color=PLACE_HOLDERS.third, label="by (12) from the ground acceleration"
    )
    axes.plot(frequency, measured, "o", color=PLACE_HOLDERS.second, markersize=4, label="measured")
    axes.set(xlabel="frequency [Hz]", ylabel=f"|{component}| [{si_unit(component).replace('*', '·')}]", ylim=(0, None))
    legend(axes, PLACE_HOLDERS, "upper left")
    made = [
        (
            "response",
            inline(figure, "response", "Amplitude of the load against frequency"),
            "Amplitude of the load at each dwell.",
        )
    ]
    try:
        dwells = find_dwells(record, component=component)
        fits = {
            phase: reference_fit(dwells, mass=found["mass"]["value"], phase=phase)
            for phase in ("relative", "absolute")
        }
    except (FitError, KeyError):
        return made
    line = LineFigure(fits["relative"].line_15, fits["relative"].natural_frequency, fits["absolute"].line_15)
    text = "Figure 3: the line of (15) through the origin; its slope is the square of the natural frequency."
    return [*made, ("line", line_figure(line), text)]
