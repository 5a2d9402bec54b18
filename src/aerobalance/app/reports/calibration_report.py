"""The report of a calibration: verdict, statistics, figures and tables in one self-contained page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.special import bdtr

from aerobalance.app.reports.calibration_figures import MOST_LABELS, direction_figure, residual_panels, series_key
from aerobalance.app.reports.page import decimals, fixed, significant, write_page
from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.calibration.outliers import SETTINGS as OUTLIERS
from aerobalance.balance.calibration.quality import SETTINGS, Quality
from aerobalance.balance.calibration.regression import HIGHEST_INFLATION, inflation_text
from aerobalance.io.artefacts import provenance
from aerobalance.io.balance_file import calibration_payload

USUAL_DEVIATION: Final = 0.003
"""Largest standard deviation, over half range, that balances usually have [Gorbushin2020]_."""

COVERED, COVERED_SIGNIFICANCE = 0.95, 0.01
"""Share of confirmation points within two standard uncertainties, and probability below which fewer are a doubt."""

INFLATION: Final = 5.0
"""Variance inflation factor from which a term is marked; twice from `HIGHEST_INFLATION` on."""

SIGNIFICANT: Final = 2.0
"""Student's statistic below which an interaction is written faint."""

DEEPEST: Final = 0.5
"""Opacity of the colour of the largest interaction."""


def write_calibration_report(
    path: Path,
    calibration: Calibration,
    quality: Quality,
    *,
    warnings: Sequence[str],
    source: Path,
    channel_map: Path | None = None,
) -> None:
    """Write what a calibration found as one HTML file that needs nothing else, whole or not at all.

    Parameters
    ----------
    path
        The HTML file.
    calibration, quality
        What is reported.
    warnings
        What was warned about on the way; they stand first.
    source, channel_map
        File of the load schedule and its map, where there is one, named with their SHA-256.

    Raises
    ------
    ValueError
        The file cannot be written.
    ReadError
        `source` cannot be read.
    """
    schedule = calibration.schedule
    found: Any = calibration_payload(calibration, quality)
    origin: Any = provenance([source] if channel_map is None else [source, channel_map])
    content = {
        "found": found,
        "components": schedule.components,
        "held": int(schedule.confirmation.sum()),
        "doubts": [*warnings, *_doubts(calibration, quality)],
        "best": int(np.argmin(quality.deviation)),
        "worst": int(np.argmax(quality.deviation)),
        "quality": quality,
        "statistics": _statistics(calibration, quality, found),
        "key": series_key(calibration),
        "load_panels": residual_panels(calibration, quality, "load"),
        "order_panels": residual_panels(calibration, quality, "order"),
        "temperature_panels": (
            () if schedule.temperature is None else residual_panels(calibration, quality, "temperature")
        ),
        "direction": direction_figure(calibration, quality),
        "temperature": _temperature(found),
        "heat": _interactions(calibration),
        "terms": {name: _terms(found["components"][name]["terms"]) for name in schedule.components},
        "tares": _tares(calibration),
        "tare_units": [entry["unit"].replace("*", "·") for entry in found["components"].values()],
        "unidentified": _unidentified(found),
        "origin": origin,
        "limits": {
            "bidirectional": 100 * SETTINGS.bidirectional, "outlier": 1e3 * OUTLIERS.residual,
            "usual": 100 * USUAL_DEVIATION, "labels": MOST_LABELS, "inflation": (INFLATION, HIGHEST_INFLATION),
        },
    }  # fmt: skip
    write_page(path, "calibration.html.j2", content)


def _doubts(calibration: Calibration, quality: Quality) -> list[str]:
    """Return what speaks against the matrix beyond what was warned about."""
    names = calibration.schedule.components
    wide = [
        f"{name} ({100 * value:.2f} %)"
        for name, value in zip(names, quality.of_half_range, strict=True)
        if value > USUAL_DEVIATION
    ]
    doubts = []
    if wide:
        doubts.append(
            f"the residuals of {', '.join(wide)} have a larger standard deviation than the "
            f"{100 * USUAL_DEVIATION:g} % of half range that balances usually stay within"
        )
    if quality.confirmation_covered is not None:
        held = int(calibration.schedule.confirmation.sum())
        inside = np.rint(quality.confirmation_covered * held)
        few = [
            f"{name} ({100 * share:.0f} %)"
            for name, share, count in zip(names, quality.confirmation_covered, inside, strict=True)
            if bdtr(count, held, COVERED) < COVERED_SIGNIFICANCE
        ]
        if few:
            doubts.append(
                f"fewer of the {held} confirmation points than the stated uncertainty promises lie within two of it: "
                f"{', '.join(few)}; about {100 * COVERED:g} % should"
            )
    return doubts


def _statistics(calibration: Calibration, quality: Quality, found: Any) -> list[dict[str, Any]]:
    """Rows of the table of statistics: what, its unit, and one text a component."""
    entries = list(found["components"].values())

    def row(what: str, unit: str, key: str, places: int) -> dict[str, Any]:
        return {"what": what, "unit": unit, "cells": [fixed(entry[key], places) for entry in entries]}

    percent = "% of capacity"
    counts = [sum(item.component == index for item in quality.outliers) for index in range(len(entries))]
    rows = [
        {
            "what": "Capacity",
            "unit": "",
            "cells": [
                f"{significant(entry['capacity']['value'], 4)} {entry['unit'].replace('*', '·')}" for entry in entries
            ],
        },
        {"what": "Terms in the model", "unit": "", "cells": [str(len(entry["terms"])) for entry in entries]},
        row("Residual, standard deviation", percent, "residual_std_percent_of_capacity", 3),
        row("Residual, standard deviation", "% of half range", "residual_std_percent_of_half_range", 3),
        row("Residual, largest", percent, "residual_largest_percent_of_capacity", 3),
        row("PRESS: each point predicted without itself", percent, "press_percent_of_capacity", 3),
        row("R²", "", "r_squared", 6),
        row("Hysteresis, largest", percent, "hysteresis_percent_of_capacity", 3),
        row("Repeatability, standard deviation", percent, "repeatability_percent_of_capacity", 3),
        {"what": "Sensitivity to + less to − loads", "unit": "%", "cells": _differences(quality)},
        {
            "what": "half of its 95 % interval",
            "unit": "%",
            "cells": [fixed(100 * d.interval if d.known else None, 2) for d in quality.directions],
        },
        {
            "what": "Bidirectional",
            "unit": "",
            "cells": [("yes" if d.bidirectional else "no") if d.known else "not known" for d in quality.directions],
        },
        {"what": "Outliers", "unit": "points", "cells": [str(count) for count in counts]},
    ]
    if quality.confirmation is not None:
        rows += [
            row("Confirmation points, rms error", percent, "confirmation_std_percent_of_capacity", 3),
            row("Confirmation points within two u", "%", "confirmation_within_two_u_percent", 0),
        ]
    return rows


def _differences(quality: Quality) -> list[str]:
    return [
        f"{'+' if d.difference > 0 else ''}{fixed(100 * d.difference, 2)}" if d.known else "–"
        for d in quality.directions
    ]


def _temperature(found: Any) -> list[dict[str, str]]:
    """Effects of temperature on every bridge, in uV/V/K and %/K."""
    rows = []
    for name, entry in found["components"].items():
        effect = entry.get("temperature")
        if effect is None:
            continue
        cells = {"name": name}
        for key, scale in (("zero", 1e3), ("sensitivity", 100.0)):
            value, u = scale * effect[key]["value"], scale * effect[key]["u"]
            places = decimals(u, most=6)
            cells |= {key: fixed(value, places), f"u_{key}": fixed(u, places)}
        rows.append(cells)
    return rows


def _interactions(calibration: Calibration) -> dict[str, Any]:
    """Linear terms in percent of the own one at capacity, with the depth of their colour."""
    matrix, c = calibration.matrix, len(calibration.matrix.components)
    values, used, t = np.zeros((c, c)), np.zeros((c, c), dtype=bool), np.zeros((c, c))
    for place, term in enumerate(matrix.terms):
        if term.kind == 0:
            values[:, term.first] = matrix.coefficients[place]
            used[:, term.first] = [fit.included[place] for fit in calibration.regressions]
            t[:, term.first] = [fit.t[place] for fit in calibration.regressions]
    values = 100 * values / np.abs(np.diag(values))[:, None]
    others = np.abs(np.where(np.eye(c, dtype=bool), 0.0, values))
    largest = float(others.max()) or 1.0
    rows = [
        [
            {
                "text": "–" if not used[i, j] else fixed(values[i, j], 0 if i == j else 2),
                "side": "own" if i == j else "plus" if values[i, j] > 0 else "minus",
                "depth": 0.0 if i == j else round(DEEPEST * float(others[i, j]) / largest, 3),
                "faint": bool(not used[i, j] or abs(t[i, j]) < SIGNIFICANT),
            }
            for j in range(c)
        ]
        for i in range(c)
    ]
    loads, outputs = matrix.components, tuple(f"r{name}" for name in matrix.gauges)
    given, gives = (loads, outputs) if matrix.way == "iterative" else (outputs, loads)
    return {
        "columns": given,
        "rows": list(zip(gives, rows, strict=True)),
        "largest": largest,
        "of": "the output" if matrix.way == "iterative" else "the load",
        "by": "load" if matrix.way == "iterative" else "output",
        "threshold": SIGNIFICANT,
    }


def _terms(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Table of the terms of one component, written out."""
    return [
        {
            "term": row["term"],
            "value": fixed(row["value"], decimals(row["u"])),
            "u": fixed(row["u"], decimals(row["u"])),
            "t": fixed(row["t"], 1),
            "p": "< 0.0001" if row["p"] < 1e-4 else fixed(row["p"], 4),
            "vif": inflation_text(row["vif"])
            if row["vif"] >= 1e4
            else fixed(row["vif"], 1 if row["vif"] < 100 else 0),
            "mark": 2 if row["vif"] >= HIGHEST_INFLATION else 1 if row["vif"] >= INFLATION else 0,
            "percent": fixed(row["percent_contribution"], 2),
        }
        for row in rows
    ]


def _tares(calibration: Calibration) -> dict[str, Any] | None:
    """Tares of every series by both ways; None where they are not known."""
    other = calibration.tares_by_iteration
    if other is None:
        return None
    rows = []
    for number, name in enumerate(calibration.schedule.series_names):
        cells = []
        for value, u, by_iteration in zip(
            calibration.tares[number], calibration.u_tares[number], other[number], strict=True
        ):
            places = decimals(u, most=4)
            known = bool(np.isfinite(value))
            cells.append(
                {
                    "value": fixed(value, places),
                    "u": fixed(u, places),
                    "iteration": fixed(by_iteration if known else None, places),
                }
            )
        rows.append((name, cells))
    scaled = np.abs(calibration.tares - other) / calibration.schedule.capacities
    return {"rows": rows, "largest": 100 * float(np.nanmax(scaled))}


def _unidentified(found: Any) -> list[tuple[str, list[str]]]:
    """Reasons, and the terms that share each."""
    reasons: dict[str, list[str]] = {}
    for term, reason in found["unidentified_because"].items():
        reasons.setdefault(reason, []).append(term)
    return list(reasons.items())
