"""Writes docs/benchmarks.md from the rows that `make bench` leaves in build/benchmarks.json.

    python docs/benchmarks.py [--rows build/benchmarks.json] [--before earlier.json] [--page docs/benchmarks.md]

What ratios of a file of earlier rows were stands beside those of the same name, in the subjects that have some.
"""

from __future__ import annotations

import argparse
import json
from itertools import groupby
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent

HEAD = """# Benchmarks

What `make bench` measures on simulated records whose truth is known. Every row is a ratio of two numbers of one run.
Times are processor times, mostly over that of a yardstick on the same arrays, such as `scipy.fft.rfft` and `irfft`
there and back, so that they are nearly the same on every machine. Rows that name seconds, cores or the length of a
record are not: how fast the machine was stands under its own heading, and one that others use too is half as fast in
some minutes as in others. A ratio holds where it is at least its target; a target of 0 is no more than a row to be
read. This page is written by `python docs/benchmarks.py`.
"""

BEFORE = """
The column of {date} is what the same benchmarks measured then, at commit {commit}, when records were still smoothed
sample by sample: accuracy before and after.
"""


def table(rows: list[dict[str, object]], before: dict[str, float], head: str) -> str:
    """Return the rows of one subject as a table in Markdown."""
    before = before if any(row["name"] in before for row in rows) else {}
    heads = ["what", *([head] if before else []), "ratio", "target", "holds"]
    lines = [heads, ["---"] * len(heads)]
    for row in rows:
        ratio, target = float(str(row["ratio"])), float(str(row["target"]))
        earlier = [number(before.get(str(row["name"])))] if before else []
        holds = ("yes" if ratio >= target else "**no**") if target > 0 else ""
        lines.append([str(row["name"]).replace("|", "\\|"), *earlier, number(ratio), number(target), holds])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def number(value: float | None) -> str:
    """Return a ratio with three digits; nothing for none."""
    return "" if value is None else f"{value:.3g}"


def page(rows: list[dict[str, object]], earlier: dict[str, Any]) -> str:
    """Return the page: a table for each subject, in the order of their names."""
    ordered = sorted(rows, key=lambda row: str(row.get("subject", "")))  # rows of a subject stay in their order
    before, head = {row["name"]: row["ratio"] for row in earlier["rows"]}, f"on {earlier['date']}"
    parts = [HEAD + (BEFORE.format(**earlier) if any(row["name"] in before for row in rows) else "")]
    for subject, group in groupby(ordered, key=lambda row: str(row.get("subject", ""))):
        parts += [f"## {subject.rstrip('.')}\n", table(list(group), before, head) + "\n"]
    return "\n".join(parts)


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description="Write the page of benchmarks.")
    parser.add_argument("--rows", type=Path, default=HERE.parent / "build" / "benchmarks.json")
    parser.add_argument("--before", type=Path, default=HERE / "benchmarks_before.json")
    parser.add_argument("--page", type=Path, default=HERE / "benchmarks.md")
    given = parser.parse_args()
    earlier = json.loads(given.before.read_text(encoding="utf-8"))
    rows = json.loads(given.rows.read_text(encoding="utf-8"))
    given.page.write_text(page(rows, earlier), encoding="utf-8")


if __name__ == "__main__":
    main()
