"""Benchmarks report ratios measured in one run; `make bench` writes them to build/benchmarks.json."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

Record = Callable[[str, float, float], None]


@pytest.fixture(scope="session")
def record() -> Iterator[Record]:
    """Note a ratio and the target that it must reach; all are written when the session ends."""
    rows: list[dict[str, object]] = []

    def note(name: str, ratio: float, target: float) -> None:
        rows.append({"name": name, "ratio": round(ratio, 4), "target": target})

    yield note
    out = Path(__file__).parents[2] / "build" / "benchmarks.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
