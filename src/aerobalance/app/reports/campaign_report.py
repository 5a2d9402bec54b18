"""The page of a campaign, which a test director reads in two minutes: what came out, and what to look at."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from aerobalance.app.campaign.campaign import Campaign
from aerobalance.app.campaign.quality import Flag, quantities
from aerobalance.app.options import as_options
from aerobalance.app.reports.campaign_figures import (
    named,
    polar_figure,
    repeat_figure,
    resonance_figure,
    zero_figure,
)
from aerobalance.app.reports.page import write_page
from aerobalance.io.artefacts import provenance
from aerobalance.recording.version import VERSION

HEADINGS: Final[Mapping[str, str]] = {
    "set aside": "Set aside",
    "not usable": "Not usable",
    "not measured": "Coefficients without their components",
    "zero drift": "Zeros that drifted",
    "set-up change": "Changes of the set-up",
    "outlier": "Outliers among repeats",
    "scatter": "Scatter of repeats",
    "stiffness": "Stiffness",
    "damping": "Damping",
}
"""Kinds of flags, the most serious first, as the page calls them."""

SERIOUS: Final = frozenset({"set aside", "not usable", "zero drift", "outlier", "scatter", "stiffness", "damping"})
"""Kinds that make the page's headline a doubt."""

_NUMBER: Final = re.compile(r"[-+−]?\d+(?:[.,]\d+)*(?:e[-+]?\d+)?")

MOST_RUNS: Final = 8
"""Runs that are named of a warning."""


def write_campaign_report(path: Path, found: Campaign, *, refresh: int = 0) -> None:
    """Write what the runs of a test are together as one HTML file, whole or not at all.

    Parameters
    ----------
    path
        The HTML file; reports of runs are beside it in ``reports``.
    found
        The results.
    refresh
        Time after which a browser loads the page again [s]; 0 for never.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    good = found.reduced
    names = quantities(good)
    quality = found.quality
    apart = {run for flag in quality.flags if flag.kind in ("outlier", "not usable") for run in flag.runs}
    together = quality.pooled.get("all")
    content = {
        "found": found,
        "refresh": refresh,
        "good": good,
        "counts": _counts(good),
        "groups": _groups(quality.flags),
        "serious": any(flag.kind in SERIOUS for flag in quality.flags),
        "together": together,
        "pooled": [
            {"name": named(name), "chi_square": one.chi_square, "freedom": one.freedom, "limits": one.limits}
            for name, one in quality.pooled.items()
            if name != "all"
        ],
        "polars": polar_figure(good, names, apart=sorted(apart)) if good and names else None,
        "repeats": repeat_figure(good, quality.repeats, names) if quality.repeats else None,
        "zeros": zero_figure(good),
        "resonances": resonance_figure(good),
        "columns": names,
        "heads": [named(name) for name in names],
        "apart": apart,
        "warned": _warned(found.rows),
        "origin": provenance([]),
        "program": f"aerobalance {VERSION}",
    }
    write_page(path, "campaign.html.j2", content)


def _counts(rows: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    words = [str(row["verdict"]) for row in rows]
    return {word: words.count(word) for word in ("fit for use", "doubtful", "not usable") if word in words}


def _groups(flags: Sequence[Flag]) -> list[tuple[str, list[str]]]:
    """Texts of the flags by kind, the most serious first."""
    return [
        (heading, [as_options(flag.text) for flag in flags if flag.kind == kind])
        for kind, heading in HEADINGS.items()
        if any(flag.kind == kind for flag in flags)
    ]


def _warned(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What was warned of, each once: the first words, of how many runs, and of which."""
    found: dict[str, dict[str, Any]] = {}
    for row in rows:
        for text in row.get("warnings") or ():
            own = as_options(text.replace(row["file"], "").replace(row["run_name"], ""))
            own = re.sub(r"^\S*\s*:\s*", "", own, count=1) if ": " in own[:40] else own
            one = found.setdefault(_NUMBER.sub("#", own), {"text": own, "runs": []})
            if row["run_name"] not in one["runs"]:
                one["runs"].append(row["run_name"])
    every = sorted(found.values(), key=lambda one: -len(one["runs"]))
    for one in every:
        one["count"], more = len(one["runs"]), len(one["runs"]) - MOST_RUNS
        one["named"] = ", ".join(one["runs"][:MOST_RUNS]) + (f" and {more} more" if more > 0 else "")
    return every
