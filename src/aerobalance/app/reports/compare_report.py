"""The page of a comparison: one table and one figure, in one self-contained file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from aerobalance.app.reports.page import (
    PLACE_HOLDERS,
    empty_figure,
    inline,
    legend,
    legend_above,
    write_page,
)
from aerobalance.dynamics.modal import ModalModel
from aerobalance.io.artefacts import provenance
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.recording import Recording
from aerobalance.validation.baselines import THIS, BaselineEstimate
from aerobalance.validation.compare import Comparison
from aerobalance.validation.scores import END_SHARE, Truth

WINDOW: Final = 1.0
"""Longest stretch of the record that the figure shows [s]."""

PERIODS: Final = 40
"""Natural periods that the figure shows, where that is less."""

SHOWN: Final = 2
"""Baseline methods in the figure beside the raw reading and this estimator."""


def write_comparison(path: Path, result: dict[str, Any], found: Comparison, *, inputs: Sequence[Path]) -> None:
    """Write the comparison as one HTML file that needs nothing else, whole or not at all.

    Parameters
    ----------
    path
        The HTML file.
    result
        What `aerobalance.app.commands.compare` found.
    found
        The estimates of all methods, with what they were worked out from.
    inputs
        Files named with their SHA-256.
    """
    name = next(iter(found))
    recording, response, truth = found.recording, found.responses[name], found.truths.get(name)
    window = shown_part(recording, response, found[name], truth)
    content = {
        "found": result,
        "this": THIS,
        "judged": bool(found.truths),
        "window": [float(recording.time[window.start]), float(recording.time[window.stop - 1])],
        "origin": provenance(inputs),
    }
    if "components" in result:
        content["figure"] = components_figure(found, recording=recording, truths=found.truths, window=window)
        write_page(path, "compare_coupled.html.j2", content)
        return
    content["figure"] = comparison_figure(
        found[name], recording=recording, dynamics=response, truth=truth, window=window
    )
    content["drawn"] = [row.name for row in best(found[name], truth)]
    write_page(path, "compare.html.j2", content)


def components_figure(
    found: Mapping[str, Sequence[BaselineEstimate]],
    *,
    recording: Recording,
    truths: Mapping[str, Truth],
    window: slice,
) -> str:
    """Draw one row per component: truth, raw reading, the best way of one component and this estimator."""
    colours, names = PLACE_HOLDERS, list(found)
    figure, axes = empty_figure(colours, (7.6, 0.8 + 1.5 * len(names)), rows=len(names), share=True)
    time = recording.time[window]
    for ax, name in zip(axes, names, strict=True):
        rows, truth = found[name], truths.get(name)
        if truth is not None:
            ax.plot(time, truth.values[window], color=colours.ink, linewidth=3.2, alpha=0.3, label="truth")
        lines = [(row, colours.first, 0.8, "raw reading") for row in rows if row.name == "raw reading"]
        one = [row for row in rows if not row.name.endswith("coupled")]
        lines += [(row, colours.third, 1.0, "best of one component") for row in best(one, truth)[:1]]
        lines += [(row, colours.second, 1.4, THIS) for row in rows if row.name == THIS]
        for row, colour, wide, label in lines:
            ax.plot(time, row.values[window], color=colour, linewidth=wide, label=label)
        reference = truth.values if truth is not None else lines[-1][0].values
        ends = _limits(reference[window], [row.values[window] for row, *_ in lines])
        ax.set(ylabel=f"{name} [{si_unit(name).replace('*', '·')}]", ylim=ends, xlim=(time[0], time[-1]))
    axes[-1].set(xlabel="time [s]")
    legend(axes[0], colours, "lower center", columns=4)
    axes[0].get_legend().set_bbox_to_anchor((0.5, 1.0))  # type: ignore[union-attr]
    figure.align_ylabels()
    return inline(figure, "baselines", "The forces and moments by baseline methods and by this estimator")


def best(found: Sequence[BaselineEstimate], truth: Truth | None) -> list[BaselineEstimate]:
    """Choose the methods to draw: the nearest to the truth, or without one the low-pass and central differences."""
    others = [row for row in found if row.ran and row.name not in (THIS, "raw reading")]
    if truth is None:
        order = ["band-limited inverse", "low-pass"]
        return [row for name in order for row in others if row.name == name][:SHOWN]
    chosen: list[BaselineEstimate] = []
    for row in sorted(others, key=lambda item: truth.score(item.values).rms):
        if row.name not in [item.name for item in chosen]:
            chosen.append(row)
    return chosen[:SHOWN]


def shown_part(
    recording: Recording, dynamics: ModalModel, found: Sequence[BaselineEstimate], truth: Truth | None
) -> slice:
    """Samples around the largest change of the force within a tenth of a natural period."""
    own = next(row for row in found if row.name == THIS)
    force = truth.values if truth is not None else own.values
    count, ends = recording.samples, int(END_SHARE * recording.samples)
    width = max(1, round(0.1 * recording.rate / dynamics.natural_frequency))
    change = np.abs(np.nan_to_num(force[ends + width : count - ends] - force[ends : count - ends - width]))
    centre = ends + int(np.argmax(change)) if change.any() else count // 2
    length = min(WINDOW, PERIODS / dynamics.natural_frequency) * recording.rate
    # more after the event than before it: what follows is what the methods differ in
    first = int(np.clip(centre - 0.3 * length, ends, max(ends, count - ends - length)))
    return slice(first, int(min(first + length, count - ends)))


def comparison_figure(
    found: Sequence[BaselineEstimate],
    *,
    recording: Recording,
    dynamics: ModalModel,
    truth: Truth | None,
    window: slice,
) -> str:
    """Draw truth, raw reading, the best other methods and this estimator, and their errors on a logarithmic axis."""
    colours, unit = PLACE_HOLDERS, si_unit(dynamics.component).replace("*", "·")
    figure, (top, bottom) = empty_figure(colours, (7.6, 6.0), rows=2, heights=(1.4, 1), share=True)
    time = recording.time[window]
    paints = iter((colours.third, colours.fourth))
    lines: list[tuple[BaselineEstimate, str, float]] = []
    lines += [(row, colours.first, 0.8) for row in found if row.name == "raw reading" and row.ran]
    lines += [(row, next(paints), 1.0) for row in best(found, truth)]
    lines += [(row, colours.second, 1.6) for row in found if row.name == THIS and row.ran]
    if truth is not None:
        top.plot(time, truth.values[window], color=colours.ink, linewidth=3.2, alpha=0.3, label="truth")
    reference = truth.values if truth is not None else lines[-1][0].values
    period = max(1, round(recording.rate / dynamics.natural_frequency))
    for row, colour, wide in lines:
        label = f"{row.name}{' *' if row.oracle else ''}"
        top.plot(time, row.values[window], color=colour, linewidth=wide, label=label)
        error = _running_rms(row.values - reference, period)[window]
        if np.any(error > 0):
            bottom.semilogy(time, error, color=colour, linewidth=wide)
    ends = _limits(reference[window], [row.values[window] for row, _, _ in lines])
    top.set(ylabel=f"{dynamics.component} [{unit}]", ylim=ends)
    legend_above(figure, top, colours, columns=3)
    words = "error" if truth is not None else f"apart from\n{THIS}"
    bottom.set(ylabel=f"{words},\nrms over a period [{unit}]", xlabel="time [s]", xlim=(time[0], time[-1]))
    bottom.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    figure.align_ylabels()
    return inline(figure, "baselines", "The force by baseline methods and by this estimator, and their errors below")


def _running_rms(error: Array, period: int) -> Array:
    """Return the rms over a period about each sample that is known, shape (n,); NaN at those that are missing."""
    known = np.isfinite(error)
    power = uniform_filter1d(np.where(known, error, 0.0) ** 2, period, mode="nearest")
    share = np.maximum(uniform_filter1d(known.astype(np.float64), period, mode="nearest"), 1 / period)
    return np.where(known, np.sqrt(np.maximum(power, 0.0) / share), np.nan)


def _limits(reference: Array, curves: Sequence[Array]) -> tuple[float, float]:
    """Range of the axis: all curves, but what is beyond the force by more than its own span is cut."""
    force, *others = (curve[np.isfinite(curve)] for curve in (reference, *curves))
    some = [curve for curve in (force, *others) if curve.size]
    if not some:
        return -1.0, 1.0
    least, most = min(float(curve.min()) for curve in some), max(float(curve.max()) for curve in some)
    span = float(np.ptp(force)) if force.size else 0.0
    if span > 0:
        least, most = max(least, float(force.min()) - span), min(most, float(force.max()) + span)
    margin = 0.05 * (most - least) or 1.0
    return least - margin, most + margin
