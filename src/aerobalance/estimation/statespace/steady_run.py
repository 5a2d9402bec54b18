"""What the steady filter leaves of several series along a stretch, and sums of what the smoother shows of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from aerobalance.estimation.statespace.stretches import Stretch
from aerobalance.recording.channel import Array
from aerobalance.recording.linalg import sums_of_products


@dataclass(frozen=True, slots=True, eq=False)
class SteadyRun:
    """The steady filter along a stretch of several series.

    Attributes
    ----------
    stretch
        The stretch.
    before, first
        States expected at the first sample of its gap and at its first reading, shape (c, d).
    series
        The readings, shape (c, m).
    states
        Predicted states at the edges of blocks, shape (c, m // BLOCK + 1, d).
    innovations
        What the readings differ from their prediction by, shape (c, m); of those in the memory of the stretch alone
        where no others are needed.
    numbers
        The numbers c of the stretch, as far as they are told, shape (c, r); states and innovations go with them.
    """

    stretch: Stretch
    before: Array
    series: Array
    first: Array
    states: Array
    innovations: Array
    numbers: Array


class Weighed(NamedTuple):
    """What makes p sums of what the smoother shows along a stretch.

    Attributes
    ----------
    by_series, by_states
        Weights of the readings, shape (p, m), and of the states at the edges, which count less, shape
        (p, m // BLOCK + 1, d).
    by_numbers
        Weights of the numbers c, shape (p, r).
    """

    by_series: Array
    by_states: Array
    by_numbers: Array

    def sums(self, run: SteadyRun) -> Array:
        """The sums of several series, shape (p, c)."""
        states = run.states.reshape(run.states.shape[0], -1)
        found = sums_of_products(self.by_series.T, run.series.T) + self.by_numbers @ run.numbers.T
        return found - sums_of_products(self.by_states.reshape(len(found), -1).T, states.T)
