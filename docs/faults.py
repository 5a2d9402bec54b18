"""Writes docs/faults.md from the rows that `make faults` leaves in build/faults.json.

python docs/faults.py [--rows build/faults.json] [--page docs/faults.md]
"""

from __future__ import annotations

import argparse
import json
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any

HERE = Path(__file__).parent

LARGE = 3.0
"""Error over the stated uncertainty (both rms) from which a force must not be called fit for use."""

FIT = "fit for use"

HEAD = """# Faults

Records of a known force that are wrong in one thing each, and sound ones, simulated apart from the package
(`tests/faults`); axial component of the paper's balance, mostly 2.5 s at 1600 Hz and 2 N of noise; {seeds} a kind, of
sound ones {sound}.
Error and u are medians of the rms over a record, in N (of six components in percent of half range); cover is the share
of samples within 95 % intervals. A row is marked where an error of more than 3 u is called fit for use. What a record
cannot show is marked "assumed": filters and gains of its only channel; and dynamics where the log-likelihood of the
readings is less than 10 higher with the balance's own, the spectrum of the force learned anew with either (of sound
records one in a thousand gains as much by some other dynamics); and likewise noise with a color, by its own density,
and channels of the ground's motion, by what they should have read.
This page is written by `make faults`.
"""

SUBJECTS = {
    "sound": "Sound records",
    "dynamics": "Dynamics of another balance",
    "missing mode": "Modes that the dynamics lack",
    "spring": "Balances that are not linear",
    "ground": "Channels of the ground's motion",
    "samples": "Wild samples",
    "limits": "Stuck, clipped and coarse channels",
    "faint": "Forces that the noise hides",
    "noise": "Noise that is not white, and hum",
    "load": "Forces that change their kind",
    "oversampled": "Records sampled far above the natural frequency",
    "filter": "Filters that are not declared",
    "clock": "Sampling rates that are wrong",
    "direct": "The other methods",
    "six": "Six coupled components, in percent of half range",
}


def page(rows: list[dict[str, Any]]) -> str:
    """Return the page: what came of all, and a table for each subject."""
    count = {group: 1 + max(row["seed"] for row in rows if row["group"] == group) for group in {*map(group_of, rows)}}
    sound = count.pop("sound", 0)
    most, least = max(count.values(), default=0), min(count.values(), default=0)
    seeds = f"{most}" if most == least else f"{least} to {most}"
    parts = [HEAD.format(seeds=seeds, sound=sound), *summary(rows)]
    for group, title in SUBJECTS.items():
        own = [row for row in rows if row["group"] == group]
        if own:
            parts += [f"## {title}\n", table(own) + "\n"]
    return "\n".join(parts)


def group_of(row: dict[str, Any]) -> str:
    """Return the subject of a record."""
    return str(row["group"])


def is_large(row: dict[str, Any]) -> bool:
    """Return whether the error is more than the stated uncertainty can be for."""
    return not row["refused"] and row["error"] > LARGE * row["u"]


def summary(rows: list[dict[str, Any]]) -> list[str]:
    """Return what came of all records, in sentences."""
    sound = [row for row in rows if row["group"] == "sound"]
    wrong = [row for row in rows if row["group"] != "sound" and row["shown"]]
    large = [row for row in wrong if is_large(row)]
    told = sum(row["verdict"] != FIT for row in large)
    named = sum(bool(set(row["kinds"]) & set(row["expected"])) for row in large)
    unfit = sum(row["refused"] or row["verdict"] != FIT for row in wrong)
    doubted = sum(row["refused"] or row["verdict"] != FIT for row in sound)
    missed = len(large) - told
    told_of = [row for row in wrong if not row["refused"] and row["verdict"] != FIT]
    right = sum(bool(set(row["kinds"]) & set(row["expected"])) for row in told_of)
    seen = len(told_of)
    square = sum((row["error"] / row["u"]) ** 2 for row in sound if not row["refused"] and row["u"]) / len(sound)
    share = 100 * unfit / (unfit + missed)
    return [
        f"- {doubted} of {len(sound)} sound records are doubted.",
        f"- {len(wrong)} records have a fault that they can show; {unfit} of these are doubted or refused.",
        "- What a doubt does to the force is in u, so the error of most of these is no more than 3 u.",
        f"- The error of {len(large)} is more than 3 u.",
        f"- {told} of these {len(large)} are not called fit for use; of {named} the fault is named rightly.",
        f"- Of the {unfit + missed} that are doubted or refused, or should be, {share:.2f} % are.",
        f"- {seen} have a force with a doubt; of {right} of these, {100 * right / seen:.1f} %, it names the fault.",
        f"- Of the sound records error over u is {square**0.5:.3f}, rms.\n",
    ]


def table(rows: list[dict[str, Any]]) -> str:
    """Return the rows of one subject as a table in Markdown."""
    heads = ["record", "error", "u", "error / u", "cover", "not fit for use", "what was said"]
    lines = [heads, ["---"] * len(heads)]
    for name, group in groupby(rows, key=lambda row: str(row["name"])):
        own = list(group)
        seen = [row for row in own if not row["refused"]]
        hidden = sum(not row["shown"] for row in own)
        title = f"{name} (assumed{'' if hidden == len(own) else f' in {hidden}'})" if hidden else name
        if not seen:
            lines.append([title, "", "", "", "", f"{len(own)} of {len(own)}", "refused"])
            continue
        error, u, ratio, cover = (
            median(values)
            for values in (
                [row["error"] for row in seen],
                [row["u"] for row in seen],
                [row["error"] / max(row["u"], 1e-300) for row in seen],
                [row["cover"] for row in seen],
            )
        )
        unfit = len(own) - len(seen) + sum(row["verdict"] != FIT for row in seen)
        missed = any(row["shown"] and is_large(row) and row["verdict"] == FIT for row in seen)
        counts = {kind: sum(kind in row["kinds"] for row in seen) for row in seen for kind in row["kinds"]}
        said = ", ".join(f"{kind} {count}" for kind, count in sorted(counts.items(), key=lambda item: -item[1]))
        mark = "**" if missed else ""
        shown = f"{mark}{unfit} of {len(own)}{mark}"
        lines.append([title, f"{error:.3g}", f"{u:.3g}", f"{ratio:.2g}", f"{cover:.2f}", shown, said])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description="Write the page of faults.")
    parser.add_argument("--rows", type=Path, default=HERE.parent / "build" / "faults.json")
    parser.add_argument("--page", type=Path, default=HERE / "faults.md")
    given = parser.parse_args()
    given.page.write_text(page(json.loads(given.rows.read_text(encoding="utf-8"))), encoding="utf-8")


if __name__ == "__main__":
    main()
