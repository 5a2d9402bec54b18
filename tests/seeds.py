"""The one place where tests get random numbers from: a plug-in of pytest with the fixtures `rng` and `seed`.

Each test has numbers of its own, which follow from one seed and the test's name: they stay the same whatever else
runs, in whatever order. The seed is fixed unless ``--seed`` or the environment variable AEROBALANCE_SEED sets it.
"""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import hypothesis
import numpy as np
import pytest

DEFAULT = 0
"""Seed of a run that is given none."""

VARIABLE = "AEROBALANCE_SEED"
SEED = pytest.StashKey[int]()

# Without a time limit for one example: a busy machine would fail it.
hypothesis.settings.register_profile("fixed", derandomize=True, database=None, deadline=None)
hypothesis.settings.register_profile("fresh", derandomize=False, database=None, deadline=None)


class _Source:
    """Seeds that follow from that of the run, the name of what runs, and how many it has drawn."""

    def __init__(self) -> None:
        self.seed = DEFAULT
        self.running: list[tuple[str, Iterator[int]]] = []

    def draw(self) -> int:
        if not self.running:
            raise RuntimeError("a seed was asked for while no test runs: ask inside a test or a fixture")
        name, numbers = self.running[-1]
        text = f"{self.seed} {name} {next(numbers)}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")


_source = _Source()


def set_seed(seed: int) -> None:
    """Set the seed that all others of this run follow from."""
    _source.seed = seed


@contextmanager
def running(name: str) -> Iterator[None]:
    """What is drawn here belongs to the test or the shared fixture of this name."""
    _source.running.append((name, iter(range(2**32))))
    try:
        yield
    finally:
        _source.running.pop()


def new_seed() -> int:
    """Return a seed of the running test, a new one at every call [below 2^32]."""
    return _source.draw()


def seed_from(rng: np.random.Generator) -> int:
    """Return a seed for what takes one, drawn from a generator."""
    return int(rng.integers(2**31))


def trials(fixed: int, soak: int) -> int:
    """Return how often a random experiment is repeated: more often where the seed is not the fixed one."""
    return fixed if _source.seed == DEFAULT else soak


@pytest.fixture
def seed() -> int:
    """Seed of this test, for what takes one; it follows from that of the run and from the test's name."""
    return new_seed()


@pytest.fixture
def rng(seed: int) -> np.random.Generator:
    """Random numbers of this test, the same at every run unless another seed is given."""
    return np.random.default_rng(seed)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--seed",
        default=os.environ.get(VARIABLE) or str(DEFAULT),
        help=f"seed of all random numbers, or 'fresh' to draw one (default: {VARIABLE}, or {DEFAULT})",
    )


@pytest.hookimpl(tryfirst=True)  # before Hypothesis reads its own option
def pytest_configure(config: pytest.Config) -> None:
    given = config.option.seed
    if given == "fresh":
        given = str(secrets.randbits(32))
    if not given.isdecimal():
        raise pytest.UsageError(f"--seed and {VARIABLE} take a whole number of at least 0, or fresh; got {given!r}")
    config.option.seed = given  # the workers of pytest-xdist are given the options as they are now
    seed = config.stash[SEED] = int(given)
    set_seed(seed)
    if seed == DEFAULT:
        hypothesis.settings.load_profile("fixed")
    else:
        hypothesis.settings.load_profile("fresh")
        config.option.hypothesis_seed = given


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of a test marked ``soak(first=n)`` take the first n parameters alone, unless a seed is given."""
    if config.stash[SEED] != DEFAULT:
        return
    taken: dict[str, int] = {}
    left = []
    for item in items:
        mark = item.get_closest_marker("soak")
        if mark is not None:
            name = item.nodeid.split("[")[0]
            taken[name] = taken.get(name, 0) + 1
            if taken[name] > mark.kwargs["first"]:
                left.append(item)
    if left:
        config.hook.pytest_deselected(items=left)
        dropped = set(left)
        items[:] = [item for item in items if item not in dropped]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    with running(item.nodeid):
        return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest) -> Iterator[None]:
    if fixturedef.scope == "function":
        return (yield)
    # what several tests share must not depend on which of them comes first
    with running(f"{fixturedef.baseid}::{fixturedef.argname}[{request.param_index}]"):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    report = yield
    if report.failed:
        report.sections.append(("Seed", f"bring it back with: {_again(item.config)} '{item.nodeid}'"))
    return report


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    failed = terminalreporter.stats.get("failed", []) + terminalreporter.stats.get("error", [])
    if failed:
        terminalreporter.write_line(f"seed {config.stash[SEED]}; bring a failure back with: {_again(config)} NAME")


def _again(config: pytest.Config) -> str:
    return f"python -m pytest --seed {config.stash[SEED]}"
