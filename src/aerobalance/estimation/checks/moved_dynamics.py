"""Coupled dynamics some of whose modes have moved, in shapes as they were."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.checks.channel_rows import Rows
from aerobalance.recording.channel import Array

BROAD: Final = 0.1
"""Damping ratio from which on a mode that was not known with half as much no longer rings: what is likelier with it is
a spectrum of the load and no motion of the balance."""

NARROW: Final = 0.1
"""Factor of the damping ratio below which a mode is a tone of the load."""


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """Modes of coupled dynamics, some of them moved.

    Attributes
    ----------
    dynamics
        The dynamics.
    changes
        Logarithms of the factors of natural frequency and damping ratio of every mode, shape (modes, 2).
    """

    dynamics: CoupledDynamics
    changes: Array

    @classmethod
    def none(cls, dynamics: CoupledDynamics) -> Moved:
        """All where they are."""
        return cls(dynamics, np.zeros((len(dynamics.modes), 2)))

    def by(self, place: int | slice, change: Array) -> Moved:
        """The same with one mode, or all, moved further, by shape (2,)."""
        changes = self.changes.copy()
        changes[place] += change
        return replace(self, changes=changes)

    @property
    def ringing(self) -> NDArray[np.bool_]:
        """Whether each mode rings as a balance may, and was not found without resonance or damping, shape (modes,)."""
        before = np.array([mode.damping_ratio for mode in self.dynamics.modes])
        now = before * np.exp(self.changes[:, 1])
        return np.asarray((now > NARROW * before) & (now < np.maximum(BROAD, 2 * before)))

    @property
    def moved(self) -> CoupledDynamics:
        """Dynamics whose modes are those, in shapes as they were."""
        poles, shapes = _oscillations(self.dynamics)
        size = len(shapes)
        frequency = np.abs(poles) * np.exp(self.changes[:, 0])
        ratio = np.minimum(-poles.real / np.abs(poles) * np.exp(self.changes[:, 1]), 0.99)
        found = frequency * (-ratio + 1j * np.sqrt(1 - ratio**2))
        both, found = np.hstack([shapes, shapes.conj()]), np.concatenate([found, found.conj()])
        # x'' = -A^-1 (x + D x') for every mode
        forward = np.real((both * found**2) @ np.linalg.inv(np.vstack([both, both * found])))
        inertia = -np.linalg.inv(forward[:, :size])
        return replace(self.dynamics, inertia=inertia, damping=-inertia @ forward[:, size:])

    @property
    def rows(self) -> Rows:
        """Their rows."""
        return _rows_of(self.dynamics, self.changes.tobytes())


@lru_cache(maxsize=256)  # the same changes are tried of all parts of a record
def _rows_of(dynamics: CoupledDynamics, changes: bytes) -> Rows:
    """Rows of dynamics whose modes have moved."""
    moved = Moved(dynamics, np.frombuffer(changes).reshape(-1, 2)).moved
    return Rows(np.stack([np.eye(len(moved.inertia)), moved.damping, moved.inertia], axis=-1))


@lru_cache(maxsize=4)  # a hundred changes are tried of the same dynamics
def _oscillations(dynamics: CoupledDynamics) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Poles of the modes, by size, one of each pair, shape (modes,) [rad/s], and their shapes, (n, modes)."""
    poles, shapes, _ = dynamics.modal_form
    up = np.flatnonzero(poles.imag > 0)
    up = up[np.argsort(np.abs(poles[up]))]
    return poles[up], shapes[:, up]
