"""Fresh random numbers for every run of a test, and the seed that brings them back where it fails."""

import numpy as np


def fresh() -> tuple[np.random.Generator, int]:
    """A generator and its seed, for the message of an assertion."""
    seed = np.random.SeedSequence().entropy
    return np.random.default_rng(seed), seed


def generator() -> np.random.Generator:
    """A generator whose seed is printed, which pytest shows where a test fails."""
    drawn, seed = fresh()
    print(f"seed {seed}")  # noqa: T201
    return drawn


def seed_from(rng: np.random.Generator) -> int:
    """A seed for what takes one, drawn from a generator."""
    return int(rng.integers(2**31))
