"""The state along a gap of the readings, where its covariance grows from sample to sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.estimation.statespace._kernels import Model
from aerobalance.estimation.statespace.blocks import powers_of
from aerobalance.recording.channel import Array

MOST: Final = 64
"""Samples that are worked out together."""


@dataclass(frozen=True, slots=True, eq=False)
class Gap:
    """Some missing readings in a row.

    Attributes
    ----------
    samples
        Their number g.
    powers
        Powers of the state transition, shape (at most MOST + 1, d, d).
    grown
        Covariance that the process noise makes of nothing over as many samples, of the same shape.
    covariance
        Covariance of the state at the first of them, given all readings before, shape (d, d).
    """

    samples: int
    powers: Array
    grown: Array
    covariance: Array

    @classmethod
    def of(cls, model: Model, covariance: Array, samples: int) -> Gap:
        """Return the gap after readings that leave a state this covariance (d, d)."""
        powers = powers_of(model.A, min(samples, MOST))
        grown = np.zeros_like(powers)
        for k in range(1, powers.shape[0]):
            grown[k] = model.A @ grown[k - 1] @ model.A.T + model.Q
        return cls(samples, powers, grown, covariance)

    @property
    def _parts(self) -> list[slice]:
        most = self.powers.shape[0] - 1
        return [slice(first, min(first + most, self.samples)) for first in range(0, self.samples, most)]

    def mean(self, row: Array, first: Array) -> Array:
        """Return what a row of the state is at each sample, from states at the first one (c, d), shape (c, g)."""
        out = np.empty((first.shape[0], self.samples))
        for part in self._parts:
            out[:, part] = first @ (row @ self.powers[: part.stop - part.start]).T
            first = first @ self.powers[-1].T
        return out

    def covariance_rows(self, row: Array) -> Array:
        """Return the covariance of a row (d,) of the state with the whole state at each sample, shape (g, d)."""
        rows = np.empty((self.samples, self.covariance.shape[0]))
        covariance = self.covariance
        for part in self._parts:
            powers, grown = self.powers[: part.stop - part.start], self.grown[: part.stop - part.start]
            across = (row @ powers) @ covariance
            rows[part] = np.squeeze(powers @ across[:, :, None], 2) + row @ grown
            covariance = self.powers[-1] @ covariance @ self.powers[-1].T + self.grown[-1]
        return rows

    def told_later(self, rows: Array, later: Array) -> Array:
        """Return what forms (q, d) of the state after the gap are for states (g, d) along it, shape (q, g)."""
        out = np.empty((later.shape[0], self.samples))
        for part in reversed(self._parts):
            powers = self.powers[1 : part.stop - part.start + 1][::-1]
            out[:, part] = later @ np.squeeze(powers @ rows[part, :, None], 2).T
            later = later @ powers[0]
        return out

    def before(self, later: Array) -> Array:
        """Return forms (q, d) of the state after the gap as those of the state at its first sample."""
        return np.asarray(later @ np.linalg.matrix_power(self.powers[1], self.samples))
