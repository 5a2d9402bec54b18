"""The one place where tests get random numbers from.

Each test has numbers of its own, which follow from one seed and the test's name: they stay the same whatever else
runs, in whatever order. The seed is fixed unless ``--seed`` or the environment variable AEROBALANCE_SEED sets it.
"""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

DEFAULT = 0
"""Seed of a run that is given none."""


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


def fresh() -> tuple[np.random.Generator, int]:
    """Return a generator of the running test, and its seed for the message of an assertion."""
    seed = new_seed()
    return np.random.default_rng(seed), seed


def generator() -> np.random.Generator:
    """Return a generator of the running test."""
    return fresh()[0]


def seed_from(rng: np.random.Generator) -> int:
    """Return a seed for what takes one, drawn from a generator."""
    return int(rng.integers(2**31))


def trials(fixed: int, soak: int) -> int:
    """Return how often a random experiment is repeated: more often where the seed is not the fixed one."""
    return fixed if _source.seed == DEFAULT else soak
