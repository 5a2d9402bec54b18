"""Runs of equal readings of a channel that is finely resolved: it was stuck, or its cable was lost."""

from __future__ import annotations

from math import comb, lgamma, log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array
from aerobalance.recording.noise import MOST_VALUES, step_of

MOST_EQUAL: Final = 0.05
"""Probability that a reading equals the one before, above which runs say nothing: the channel is coarsely resolved, or
held between the readings of a slower one."""

LEAST_EQUAL: Final = 1e-3
"""The same that is assumed at least; with it six equal readings in a thousand are stuck."""

FINEST_EQUAL: Final = 1e-6
"""The same that is assumed at least where noise and resolution of the readings tell it: four equal readings in a
thousand are then stuck, as a recorder repeats the last one for a packet that is lost."""

ROUNDING: Final = 1e-9
"""Difference of two readings over the largest one that is no step, but the rounding of what was worked out of them."""

LOST: Final = 1.5
"""Step into a run over the largest step elsewhere, from which on its first reading is no reading either."""

FEWEST_CHANGES: Final = 8
"""Changes in a record from which on they tell that probability; a channel with fewer was stuck beside them."""

CHANCE: Final = 1e-9
"""Probability that as many runs as long come about by chance anywhere in the record."""

ORDER: Final = 12
"""Order of the differences that show noise: of what is smooth over so many samples they leave next to nothing."""

NO_NOISE: Final = 1e-8
"""Noise over the range of the readings below which they are computed, and none is stuck: a tenth of what the steps of
a converter of 24 bits leave in readings that use a tenth of its range."""

RESTS: Final = 0.32
"""Noise over the step of the readings, the rounding to it (0.29) included, below which a steady load leaves them at
rest: beside rounding that is noise of 0.14 of a step, which crosses half a step once in four thousand readings."""

FEWEST_DIFFERENCES: Final = 50
"""Differences that tell the noise, at least."""

MOST_DIFFERENCES: Final = 1 << 16
"""The same at most."""


def is_dead(values: Array) -> bool:
    """Return whether a channel has one reading all along.

    Parameters
    ----------
    values
        Readings, shape (n,); NaN where missing.
    """
    present = values[np.isfinite(values)]
    return present.size > 1 and bool((present == present[0]).all())


def stuck_samples(values: Array) -> NDArray[np.bool_]:
    """Return which readings repeat the one before them in a run that is no chance, shape (n,).

    The first reading of a run may be sound and is kept, unless it lies farther from the one before than the signal
    ever moves, or several runs are of one value, as where lost packets read zero. None is told of a channel that never
    changes (`is_dead`), or whose readings rest now and then by their nature: of an encoder, held between those of a
    slower converter, or without noise, computed or below the step of the converter, which rest until the load changes.

    Parameters
    ----------
    values
        Readings, shape (n,); NaN where missing.
    """
    found = np.zeros(values.size, dtype=bool)
    step = np.diff(values)
    same = step == 0
    if not same.any():  # as of most channels that are finely resolved
        return found
    changes = int(np.count_nonzero(np.isfinite(step) & ~same))
    if not changes:
        return found
    edges = np.diff(np.concatenate(([0], same.astype(np.int8), [0])))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not first.size:
        return found
    # a run begins after a change with the probability that the next reading is equal, however long it lasts then
    share = first.size / changes if changes >= FEWEST_CHANGES else 0.0
    if share > MOST_EQUAL:
        return found
    lengths = last - first + 1
    # a text with so many digits has coarser steps where readings are large: pairs that are equal tell of them
    pairs = np.count_nonzero(lengths == 2) / max(changes, FEWEST_CHANGES)
    chance = min(max(share, LEAST_EQUAL), max(_equal_by_resolution(values), FINEST_EQUAL, pairs))
    shortest = _no_chance(lengths, values.size, chance)
    for start, stop in zip(first, last, strict=True):
        if stop - start + 1 >= shortest:
            found[start + 1 : stop + 1] = True
    if found.any() and _has_no_noise(values):
        found[:] = False
    runs = np.flatnonzero(found[1:] & ~found[:-1])  # the first reading of each run
    _, which, often = np.unique(values[runs], return_inverse=True, return_counts=True)
    same_again = runs[often[which] > 1]
    runs = runs[runs > 0]
    if runs.size:
        usual = np.abs(step)
        usual[runs - 1] = 0.0
        usual[found[:-1]] = 0.0  # within a run, and out of it
        found[runs[np.abs(step[runs - 1]) > LOST * np.nanmax(usual)]] = True
    found[same_again] = True
    return found


def _no_chance(lengths: NDArray[np.intp], samples: int, chance: float) -> float:
    """Least number of equal readings that as many runs have as never come about by chance; infinite where none.

    Of readings each of which equals the one before with the probability p, runs of m begin n p^(m - 1) times, and k of
    them, where fewer than one is expected, come about with a probability of at most (n p^(m - 1))^k / k!. Pairs are
    left alone: how often they are chance is told by themselves.
    """
    for least in range(3, int(lengths.max()) + 1):
        count = int(np.count_nonzero(lengths >= least))
        expected = log(samples) + (least - 1) * log(chance)
        if expected < 0 and count * expected - lgamma(count + 1) < log(CHANCE):
            return least
    return np.inf


def _equal_by_resolution(values: Array) -> float:
    """Probability that a reading equals the one before by their noise and what lies between two that differ.

    That is at least the step of a converter, and of readings that have none what so many of them leave between them.
    """
    noise = _noise_of(values)[0]
    some = np.unique(values[np.isfinite(values)])
    apart = np.diff(some)
    apart = apart[apart > ROUNDING * np.max(np.abs(some))]
    return float(apart.min()) / (2 * np.sqrt(np.pi) * noise) if apart.size and noise > 0 else 1.0


def _noise_of(values: Array) -> tuple[float, NDArray[np.intp]]:
    """Noise of the readings by their differences, 0 where these are too few, and where they change."""
    differences = np.diff(values, n=ORDER)
    changed = np.flatnonzero(differences)[:MOST_DIFFERENCES]
    differences = differences[changed]
    differences = differences[np.isfinite(differences)]
    if differences.size < FEWEST_DIFFERENCES:
        return 0.0, changed
    return float(np.median(np.abs(differences))) / np.sqrt(comb(2 * ORDER, ORDER)), changed


def _has_no_noise(values: Array) -> bool:
    """Whether the readings have no noise, but for rounding to their steps."""
    noise, changed = _noise_of(values)
    if not noise:
        return False
    step = step_of(values[changed[:MOST_VALUES]])
    return bool(noise < max(NO_NOISE * float(np.nanmax(values) - np.nanmin(values)), RESTS * step))
