"""What is known of samples until the forces of all components at them are final."""

from __future__ import annotations

import numpy as np

from aerobalance.estimation.live.component_smoother import FinalSamples
from aerobalance.estimation.live.equation import Equation
from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import hold_over_gaps


class Pending:
    """Samples that wait for their forces.

    Parameters
    ----------
    equation
        The equation of motion.
    interval
        Time between samples [s].

    Attributes
    ----------
    released
        Samples given out.
    """

    def __init__(self, equation: Equation, *, interval: float) -> None:
        self._equation, self._interval = equation, interval
        n = len(equation.components)
        self._rows = np.zeros((0, 2 * n + 6))
        self._found = [np.zeros((0, 2)) for _ in equation.components]
        self._held = np.zeros(n)
        self.released = 0

    def push(self, loads: Array, net: Array, specific_force: Array) -> None:
        """Take loads (NaN where missing) and loads on the moving mass, (m, n), and specific force, (m, 6)."""
        self._rows = np.concatenate([self._rows, np.hstack([loads, net, specific_force])])

    def take(self, place: int, final: FinalSamples) -> None:
        """Take samples of one component that are final."""
        new = np.column_stack([final.force, final.variance])
        self._found[place] = np.concatenate([self._found[place], new])

    def release(self) -> tuple[int, Array, Array, Array]:
        """Return the samples whose forces are all final: number of the first, forces, variances, loads (m, n).

        The variances hold what the coefficients of the equation add.
        """
        first, count = self.released, min(found.shape[0] for found in self._found)
        rows, rates = self._next(count)
        n = len(self._found)
        force, variance = (np.column_stack([found[:count, which] for found in self._found]) for which in (0, 1))
        loads, net, specific_force = rows[:, :n], rows[:, n : 2 * n], rows[:, 2 * n :]
        variance = variance + self._equation.variance(force, loads, rates, net, specific_force)
        self._found = [found[count:] for found in self._found]
        self.released += count
        return first, force, variance, loads

    def _next(self, count: int) -> tuple[Array, Array]:
        """The next samples, and the rates of their loads by central differences."""
        start, n = min(self.released, 1), len(self._found)
        seen = self._rows[: start + count + 1, :n]
        rates = np.zeros((count, n))
        if count:
            filled = hold_over_gaps(seen, self._held)
            if seen.shape[0] > 1:
                rates = np.gradient(filled, self._interval, axis=0)[start : start + count]
            self._held = filled[start + count - 1]
        rows = self._rows[start : start + count]
        if count:
            self._rows = self._rows[start + count - 1 :]
        return rows, rates
