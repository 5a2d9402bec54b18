"""Draws of what errors of the dynamics do to a force.

Working out the force anew for every draw of the parameters takes most of a Monte Carlo check. The change of the force
is smooth in them, so it is a polynomial of second degree for almost every record: it is found from a few points, tried
on some of the draws themselves, and only where it fails there every draw is worked out on its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations, repeat
from typing import Final

import numpy as np

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.estimation.record import ComponentRecord
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.uncertainty.sampling import UncertainDynamics, standard_normals

POINT: Final = np.sqrt(3.0)
"""Places of the points in standard deviations: those of a Gauss-Hermite rule of third order."""

FEWER: Final = 4
"""Draws for each point that the polynomial needs at least; with less, draws are worked out one by one."""

TRIED: Final = 6
"""Draws that the polynomial is tried on: the farthest from the middle and others."""

CLOSE: Final = 0.02
"""Rms of what the polynomial misses on them, over that of the change: a fifth of what first order may be wrong by."""


@dataclass(frozen=True, slots=True, eq=False)
class ChangedRecord:
    """What the record of a component is with other dynamics.

    Attributes
    ----------
    dynamics
        The dynamics, by standard normal numbers.
    record
        Makes the record with dynamics.
    """

    dynamics: UncertainDynamics
    record: Callable[[BalanceDynamics], ComponentRecord]

    def at(self, numbers: Array) -> ComponentRecord:
        """Return the record at standard normal numbers, shape (count,)."""
        return self.record(self.dynamics.at(numbers))

    def records(self, generator: np.random.Generator, draws: int) -> Iterator[ComponentRecord]:
        """Return the record with one draw of the dynamics after the other.

        Raises
        ------
        FitError
            A draw is not physical; before the first is given.
        """
        drawn = [self.dynamics.at(numbers) for numbers in standard_normals(generator, self.dynamics.count, draws)]
        return (self.record(other) for other in drawn)


def parameter_errors(
    change: ChangedRecord | None,
    moved: Callable[[ComponentRecord], Array],
    *,
    draws: int,
    generator: np.random.Generator,
) -> Iterator[Array | None]:
    """Return the change of a force by one draw of the dynamics after the other, shape (n,) [N]; None without one.

    Parameters
    ----------
    change
        The record with drawn dynamics; None where they are exact.
    moved
        Change of the force with a record.
    draws
        How many.
    generator
        Source of randomness.

    Raises
    ------
    FitError
        A draw is not physical.
    """
    if change is None:
        return repeat(None, draws)
    normals = standard_normals(generator, change.dynamics.count, draws)
    drawn = [change.dynamics.at(numbers) for numbers in normals]
    worked: dict[int, Array] = {}
    pairs = list(combinations(range(change.dynamics.count), 2))
    points = 2 * change.dynamics.count + len(pairs)
    if points * FEWER > draws:
        pairs, points = [], 2 * change.dynamics.count
    if points * FEWER <= draws:
        order = np.argsort(-np.sum(normals**2, axis=1))
        tried = order[np.linspace(0, draws - 1, TRIED).astype(int)]
        worked = {int(place): moved(change.record(drawn[place])) for place in tried}
        shapes = _polynomial(change, moved, pairs)
        if shapes is not None:
            sizes = _sizes(normals, pairs)
            missed = [worked[place] - sizes[place] @ shapes for place in worked]
            size = sum(float(one @ one) for one in worked.values())
            if sum(float(one @ one) for one in missed) <= CLOSE**2 * size:
                return (worked[draw] if draw in worked else sizes[draw] @ shapes for draw in range(draws))
    return (worked[draw] if draw in worked else moved(change.record(drawn[draw])) for draw in range(draws))


def _polynomial(
    change: ChangedRecord, moved: Callable[[ComponentRecord], Array], pairs: list[tuple[int, int]]
) -> Array | None:
    """What each of `_sizes` changes the force by, shape (q, n) [N]; None where a point is not physical."""
    axes = POINT * np.eye(change.dynamics.count)
    try:
        up, down = (np.array([moved(change.at(sign * axis)) for axis in axes]) for sign in (1, -1))
        slopes, bends = (up - down) / (2 * POINT), (up + down) / (2 * POINT**2)
        both = [(moved(change.at(axes[i] + axes[j])) - up[i] - up[j]) / POINT**2 for i, j in pairs]
    except FitError:
        return None
    return np.vstack([slopes, bends, *both])


def _sizes(normals: Array, pairs: list[tuple[int, int]]) -> Array:
    """The numbers, their squares and the products of pairs of them, shape (draws, q)."""
    products = [normals[:, i] * normals[:, j] for i, j in pairs]
    return np.column_stack([normals, normals**2, *products])
