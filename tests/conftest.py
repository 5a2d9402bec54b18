"""Seeds of all tests: fixed by default, set from outside, and told where a test fails."""

from __future__ import annotations

import multiprocessing
import os
import secrets
from collections.abc import Iterator
from typing import Any

import hypothesis
import numpy as np
import pytest

import seeds

VARIABLE = "AEROBALANCE_SEED"
SEED = pytest.StashKey[int]()

STARTERS = ("aerobalance.acquisition.session", "aerobalance.app.monitor.workers")
LOADED = [
    "aerobalance.acquisition.simulated",
    "aerobalance.acquisition.recorder",
    "aerobalance.app.monitor.engine",
    "aerobalance.app.monitor.learner",
    "aerobalance.app.monitor.jobs",
]

# Without a time limit for one example: a busy machine would fail it.
hypothesis.settings.register_profile("fixed", derandomize=True, database=None, deadline=None)
hypothesis.settings.register_profile("fresh", derandomize=False, database=None, deadline=None)


@pytest.fixture
def seed() -> int:
    """Seed of this test, for what takes one; it follows from that of the run and from the test's name."""
    return seeds.new_seed()


@pytest.fixture
def rng(seed: int) -> np.random.Generator:
    """Random numbers of this test, the same at every run unless another seed is given."""
    return np.random.default_rng(seed)


@pytest.fixture(scope="session", autouse=True)
def quick_starts() -> Iterator[None]:
    """Let sources, recorders and engines begin from a process that has their libraries loaded, where there is fork.

    Each is a process of its own as it is in use, and may be killed; but some two hundred of them do not each take
    seconds to load the same. Programs that a test runs start theirs as in use.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        yield
        return
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(LOADED)
    with pytest.MonkeyPatch.context() as patch:
        for starter in STARTERS:
            patch.setattr(f"{starter}._SPAWN", context)
        yield


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--seed",
        default=os.environ.get(VARIABLE) or str(seeds.DEFAULT),
        help=f"seed of all random numbers, or 'fresh' to draw one (default: {VARIABLE}, or {seeds.DEFAULT})",
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
    seeds.set_seed(seed)
    if seed == seeds.DEFAULT:
        hypothesis.settings.load_profile("fixed")
    else:
        hypothesis.settings.load_profile("fresh")
        config.option.hypothesis_seed = given


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    with seeds.running(item.nodeid):
        return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest) -> Iterator[None]:
    if fixturedef.scope == "function":
        return (yield)
    # what several tests share must not depend on which of them comes first
    with seeds.running(f"{fixturedef.baseid}::{fixturedef.argname}[{request.param_index}]"):
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
