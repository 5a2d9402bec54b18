"""Benchmarks note ratios measured in one run; `make bench` gathers them in build/benchmarks.json, and in the docs.

Each row is {"name", "ratio", "target", "subject"}: the ratio is at least the target where it holds, and the subject is
what the first line of the benchmark's module says. A run of some benchmarks replaces their rows and keeps the others.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

Record = Callable[[str, float, float], None]

ROWS = Path(__file__).parents[2] / "build" / "benchmarks.json"


@pytest.fixture
def record(request: pytest.FixtureRequest) -> Record:
    """Note a ratio and the target that it must reach."""
    subject = (request.module.__doc__ or request.module.__name__).splitlines()[0]

    def note(name: str, ratio: float, target: float) -> None:
        # properties of a test reach the process that reports, wherever the test runs
        request.node.user_properties.append(
            ("benchmark", {"name": name, "ratio": float(f"{ratio:.4g}"), "target": target, "subject": subject})
        )

    return note


class Rows:
    """Rows of all tests of a run, in the order in which they end."""

    def __init__(self) -> None:
        self.found: list[dict[str, object]] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            self.found += [row for name, row in report.user_properties if name == "benchmark"]

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self.found:
            ROWS.parent.mkdir(exist_ok=True)
            before = json.loads(ROWS.read_text(encoding="utf-8")) if ROWS.exists() else []
            rows = {row["name"]: row for row in [*before, *self.found]}
            ROWS.write_text(json.dumps(list(rows.values()), indent=2) + "\n", encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # a process of its own only runs tests
        config.pluginmanager.register(Rows())
