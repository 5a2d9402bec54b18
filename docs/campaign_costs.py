"""Writes the table of docs/campaign.md on what a run of a campaign costs, measured on this machine.

    python docs/campaign_costs.py [--runs 12]

Runs of six components from gauge outputs, 1 s at 1 kHz with buffeting, are simulated and reduced one after the other
in this process, each step by its processor time: the medians, as the first run of a process loads libraries.
"""

from __future__ import annotations

import argparse
import os
import pickle
import re
import resource
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import numpy as np  # noqa: E402 - after the number of its threads

from aerobalance.app.campaign import work as works  # noqa: E402
from aerobalance.app.campaign.campaign import planned, prepared  # noqa: E402
from aerobalance.app.campaign.places import fingerprint  # noqa: E402
from aerobalance.app.campaign.results import Results  # noqa: E402
from aerobalance.app.commands.campaign import write_run_report  # noqa: E402
from helpers.whole_test import simulated_test  # noqa: E402

BEGIN, END = "| step | processor time | data |", "| memory of a worker |"


def measured(runs: int, folder: Path) -> dict[str, Any]:
    """Return what each step of a run takes [s], and how much it reads, writes and sends [bytes]."""
    spent: dict[str, list[float]] = defaultdict(list)

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any, **more: Any) -> Any:
            begin = time.process_time()
            try:
                return function(*given, **more)
            finally:
                spent[name].append(time.process_time() - begin)

        return call

    polars = max(2, runs // 6)
    test = simulated_test(folder / "test", np.random.default_rng(1), angles=np.arange(6.0) * 2, polars=polars)
    begin = time.process_time()
    found = prepared(test.file)
    results = Results(str(folder / "out"))
    with results.held():
        tasks, _ = planned(found, results.out, with_reports=True)
        sizes: dict[str, Any] = {"plan": (time.process_time() - begin) / len(tasks)}
        big = folder / "big"
        big.write_bytes(bytes(1 << 28))
        begin = time.process_time()
        fingerprint(str(big))
        sizes["digest of a GB"] = (time.process_time() - begin) * 1e9 / (1 << 28)
        works.recording_at = timed("read", works.recording_at)
        works.reduce_run = timed("reduce", works.reduce_run)
        for name in ("write_history", "record"):
            setattr(Results, name, timed(name, getattr(Results, name)))
        rows = [works.work_on(task) for task in tasks]
        sizes["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        first = tasks[0]
        report = timed("page", write_run_report)
        for task in tasks[:3]:
            report(folder / "page.html", task, works._reduced(task), [])
    history = [path for path in Path(results.place("histories.zarr", first.run.name)).rglob("*") if path.is_file()]
    return sizes | {
        **{name: float(np.median(times)) for name, times in spent.items()},
        "sent": len(pickle.dumps((works.work_on, first))),
        "back": len(pickle.dumps(rows[0])),
        "input": Path(first.run.file).stat().st_size,
        "objects": len(history),
        "history": sum(path.stat().st_size for path in history),
        "row": Path(results.place("runs", f"{first.run.name}.json")).stat().st_size,
        "page size": (folder / "page.html").stat().st_size,
    }


def size(count: float) -> str:
    """A size in kB or MB, in two digits."""
    unit, scale = ("MB", 1e6) if count >= 1e5 else ("kB", 1e3)
    return f"{float(f'{count / scale:.2g}'):g} {unit}"


def duration(seconds: float) -> str:
    """A time in s or ms, in two digits."""
    return f"{float(f'{seconds:.2g}'):g} s" if seconds >= 0.1 else f"{float(f'{1e3 * seconds:.2g}'):g} ms"


def table(found: dict[str, Any]) -> str:
    """The table as Markdown."""
    rows = [
        ("step", "processor time", "data"),
        ("---", "---", "---"),
        (
            "planning: table, names, digests",
            f"{duration(found['plan'])}, and {duration(found['digest of a GB'])} per GB of local inputs",
            "",
        ),
        ("task", "", f"{size(found['sent'])} to the worker, {size(found['back'])} back"),
        ("reading the run", duration(found["read"]), size(found["input"])),
        ("reduction with checks, stiffness and damping", duration(found["reduce"]), ""),
        (
            "time histories",
            duration(found["write_history"]),
            f"{size(found['history'])} in {found['objects']} objects",
        ),
        ("record of the run", duration(found["record"]), size(found["row"])),
        ("page of the run, if wanted", duration(found["page"]), size(found["page size"])),
        ("memory of a worker", "", f"{found['memory'] / 1e9:.1f} GB"),
    ]
    return "\n".join(f"| {' | '.join(row)} |".replace("|  |", "| |").replace("|  |", "| |") for row in rows)


def main() -> None:
    """Measure, and write the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=12)
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        text = table(measured(parser.parse_args().runs, Path(folder)))
    page = HERE / "campaign.md"
    content = page.read_text(encoding="utf-8")
    pattern = re.compile(re.escape(BEGIN) + r".*?" + re.escape(END) + r"[^\n]*", re.DOTALL)
    page.write_text(pattern.sub(lambda _: text, content, count=1), encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
