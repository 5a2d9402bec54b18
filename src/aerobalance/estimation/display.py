"""Forces as tables, as figures and as text for notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Final

import numpy as np

from aerobalance.estimation.result import ComponentForce
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import KINDS, Doubt, Verdict
from aerobalance.recording.recording import Recording

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

DOUBTS_SHOWN: Final = 3
"""Kinds of doubt that are named where a force is printed."""

COVERAGE_FACTOR: Final = 1.96
"""Standard uncertainties on either side that hold 95 % of the errors."""


def to_dataframe(parts: Mapping[str, ComponentForce], recording: Recording) -> pd.DataFrame:
    """Forces and their standard uncertainties [N, N*m] over the time [s], as a pandas data frame."""
    import pandas as pd  # noqa: PLC0415 - takes a third of a second

    columns = {}
    for name, part in parts.items():
        columns[name], columns[f"u_{name}"] = part.values, part.uncertainty
    return pd.DataFrame(columns, index=pd.Index(recording.time, name="time"))


def to_xarray(parts: Mapping[str, ComponentForce], recording: Recording) -> xr.Dataset:
    """Forces and their standard uncertainties along the time, as an xarray data set with units.

    Raises
    ------
    ImportError
        xarray is not installed.
    """
    try:
        import xarray as xr  # noqa: PLC0415 - an extra
    except ImportError:
        raise ImportError("to_xarray needs xarray: pip install 'aerobalance[xarray]'") from None
    data = {}
    for name, part in parts.items():
        attributes = {"units": si_unit(name), "method": part.method}
        data[name] = ("time", part.values, {**attributes, "long_name": f"force applied, {name}"})
        data[f"u_{name}"] = ("time", part.uncertainty, {**attributes, "long_name": f"standard uncertainty of {name}"})
    time = ("time", recording.time, {"units": "s"})
    return xr.Dataset(data, coords={"time": time}, attrs={"recording": recording.name})


def plot(parts: Mapping[str, ComponentForce], recording: Recording) -> Figure:
    """Figure of the forces with bands of 95 % and of the balance loads, one component below the other."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - takes half a second

    figure = Figure(figsize=(7.6, 1.0 + 2.2 * len(parts)), layout="constrained")
    rows = np.ravel(figure.subplots(len(parts), 1, sharex=True, squeeze=False))
    time = recording.time
    for axes, (name, part) in zip(rows, parts.items(), strict=True):
        band = COVERAGE_FACTOR * part.uncertainty
        axes.plot(time, recording.channel(name).values, color="0.6", linewidth=0.8, label="balance load")
        axes.plot(time, part.values, color="C0", linewidth=1.2, label="force applied")
        axes.fill_between(
            time, part.values - band, part.values + band, color="C0", alpha=0.3, linewidth=0, label="95 % band"
        )
        axes.set_ylabel(f"{name} [{si_unit(name)}]")
    rows[0].legend(loc="best", ncols=3, fontsize="small")
    rows[-1].set_xlabel("time [s]")
    return figure


def _rows(parts: Mapping[str, ComponentForce]) -> list[tuple[str, ...]]:
    """Mean, rms about it and standard uncertainty of a sample, by component."""
    return [
        (
            name,
            si_unit(name),
            f"{np.nanmean(part.values):.5g}",
            f"{np.nanstd(part.values):.5g}",
            f"{np.sqrt(np.nanmean(part.uncertainty**2)):.2g}",
            f"{part.bandwidth:.4g}",
        )
        for name, part in parts.items()
    ]


_HEADS: Final = ("component", "unit", "mean", "rms about mean", "u of a sample", "resolved to [Hz]")


def _judgement(parts: Mapping[str, ComponentForce], verdict: Verdict) -> list[str]:
    """The verdict, and what is doubted first, by kind."""
    kinds: dict[str, list[Doubt]] = {}
    for part in parts.values():
        for doubt in part.doubts:
            kinds.setdefault(doubt.kind, []).append(doubt)
    first = list(kinds.values())[:DOUBTS_SHOWN]
    lines = [f"verdict: {verdict}"]
    lines += [
        f"doubted, {', '.join(dict.fromkeys(one.component for one in group))}: {KINDS[group[0].kind]}"
        for group in first
    ]
    more = len(kinds) - len(first)
    return lines + ([f"doubted: {more} more, in doubts"] if more else [])


def summary(parts: Mapping[str, ComponentForce], recording: Recording, verdict: Verdict) -> str:
    """Forces in some lines of text, with their verdict and what is doubted first."""
    rows = [_HEADS, *_rows(parts)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_HEADS))]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(
        [
            f"force applied, {recording.name}: {recording.samples} samples, {recording.rate:g} Hz",
            *lines,
            *_judgement(parts, verdict),
        ]
    )


def html(parts: Mapping[str, ComponentForce], recording: Recording, verdict: Verdict) -> str:
    """Forces as a table for notebooks, with their verdict and what is doubted first."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in _HEADS)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in _rows(parts))
    caption = escape(f"force applied, {recording.name}: {recording.samples} samples, {recording.rate:g} Hz")
    table = f"<table><caption>{caption}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return table + "".join(f"<p>{escape(line)}</p>" for line in _judgement(parts, verdict))
