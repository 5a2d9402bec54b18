"""Change of the sensitivities between two calibrations of one balance, with its significance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtr

from aerobalance.balance.load_formats import role_of
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

SIGNIFICANCE: Final = 0.01
"""Probability below which a change is taken as real."""


@dataclass(frozen=True, slots=True)
class SensitivityDrift:
    """Change of one bridge's sensitivity between two calibrations.

    Attributes
    ----------
    component
        Name in the first calibration.
    before, after
        Output at small loads by load [mV/V/N, mV/V/(N*m)].
    relative
        Change over the first value.
    u
        Standard uncertainty of `relative`, from the coefficients of both calibrations.
    p
        Probability of so large a change by chance.
    significant
        Whether p is below `SIGNIFICANCE`.
    """

    component: str
    before: float
    after: float
    relative: float
    u: float
    p: float
    significant: bool


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Differences between two calibrations of one balance, c components.

    Attributes
    ----------
    sensitivities
        Change of every bridge's own sensitivity.
    interactions
        Change of the linear interactions, outputs in rows, loads in columns, over the first one's output at capacity,
        shape (c, c); the diagonal is the change of the sensitivities.
    u_interactions
        Their standard uncertainties, shape (c, c).
    load_difference
        Difference of the loads that both give for the same outputs: largest over the corners of the range that both
        calibrated one load at a time, over capacity, shape (c,).
    zero_change
        Change of the natural zeros, shape (c,) [mV/V]; None where one has none.
    """

    sensitivities: tuple[SensitivityDrift, ...]
    interactions: Array
    u_interactions: Array
    load_difference: Array
    zero_change: Array | None


def compare_calibrations(before: BalanceMatrix, after: BalanceMatrix) -> Drift:
    """Return the differences between two calibrations of one balance.

    Raises
    ------
    FitError
        They are not of one balance: components differ.
    """
    order = _matched(before, after)
    S1, u1 = _linear_sensitivity(before)
    S2, u2 = (table[np.ix_(order, order)] for table in _linear_sensitivity(after))
    own = np.diag(S1)
    # outputs at the capacities of the first calibration, so that two files with other capacities compare
    change = (S2 - S1) * before.load_scale / (np.abs(own) * before.load_scale)[:, None]
    u = np.hypot(u1, u2) * before.load_scale / (np.abs(own) * before.load_scale)[:, None]
    sensitivities = []
    for index, name in enumerate(before.components):
        relative = float(S2[index, index] / S1[index, index] - 1)
        spread = float(np.hypot(u1[index, index] / S1[index, index], u2[index, index] / S2[index, index]))
        p = float(2 * ndtr(-abs(relative) / spread)) if spread > 0 else float(relative == 0)
        sensitivities.append(
            SensitivityDrift(
                name, float(S1[index, index]), float(S2[index, index]), relative, spread, p, p < SIGNIFICANCE
            )
        )
    zero = None
    if before.natural_zero is not None and after.natural_zero is not None:
        zero = after.natural_zero[order] - before.natural_zero
    return Drift(tuple(sensitivities), change, u, _load_difference(before, after, order), zero)


def _matched(before: BalanceMatrix, after: BalanceMatrix) -> list[int]:
    """Positions in the second balance of the components of the first."""
    keys = [[role_of(name) or name for name in matrix.components] for matrix in (before, after)]
    if sorted(keys[0]) != sorted(keys[1]):
        raise FitError(
            f"the two are not calibrations of one balance: {', '.join(before.components)} and "
            f"{', '.join(after.components)}"
        )
    return [keys[1].index(key) for key in keys[0]]


def _linear_sensitivity(matrix: BalanceMatrix) -> tuple[Array, Array]:
    """Outputs by loads at zero load, and their standard uncertainties, shape (c, c) [mV/V/N]."""
    c = len(matrix.components)
    value = matrix.linear
    variance: Array = np.zeros((c, c))
    for row, term in enumerate(matrix.terms):
        if term.kind == 0:
            variance[:, term.first] = matrix.covariance[:, row, row]
    if matrix.way == "non-iterative":
        inverse = np.linalg.inv(value)
        # dS = -S dC S, with independent rows of C
        variance = np.einsum("ij,jk,kl->il", inverse**2, variance, inverse**2)
        value = np.asarray(inverse, dtype=np.float64)
    scale = matrix.output_scale[:, None] / matrix.load_scale
    return value * scale, np.sqrt(variance) * scale


def _load_difference(before: BalanceMatrix, after: BalanceMatrix, order: list[int]) -> Array:
    """Largest difference of the loads from both matrices, one load at a time, over capacity, shape (c,)."""
    c = len(order)
    least = np.maximum(before.calibrated[0], after.calibrated[0][order])
    most = np.minimum(before.calibrated[1], after.calibrated[1][order])
    corners = np.vstack([np.diag(least), np.diag(most)])
    outputs = before.outputs(corners)
    back = np.empty_like(outputs)
    back[:, order] = outputs
    loads = after.loads(back).loads[:, order]
    return np.asarray(np.max(np.abs(loads - corners).reshape(2 * c, c), axis=0) / before.load_scale)
