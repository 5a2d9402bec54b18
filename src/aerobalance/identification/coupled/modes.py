"""Modes of coupled dynamics with what the uncertainty of A and D, that from the calibration too, leaves in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.identification.coupled.free_response import Complex
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True, eq=False)
class ModeTable:
    """Oscillations of coupled dynamics, the slowest first.

    Attributes
    ----------
    modes
        Their frequencies and damping ratios.
    u_natural_frequency, u_damping_ratio
        Standard uncertainties, shape (modes,) [Hz] and [1].
    shapes
        Balance loads over half of range, rows, the largest of a row 1; shape (modes, n).
    covariance
        Covariance of the frequencies, then of the damping ratios, shape (2 modes, 2 modes).
    """

    modes: tuple[Mode, ...]
    u_natural_frequency: Array
    u_damping_ratio: Array
    shapes: Complex
    covariance: Array

    @classmethod
    def of(cls, dynamics: CoupledDynamics, *, sizes: Array) -> ModeTable:
        """Modes of dynamics; `sizes` are the half ranges of the components, shape (n,)."""
        n = len(dynamics.components)
        shapes = []
        for pole in dynamics.poles[dynamics.poles.imag > 0]:
            whole = np.eye(len(dynamics.inertia)) + dynamics.damping * pole + dynamics.inertia * pole**2
            seen = np.linalg.svd(whole)[2][-1].conj()[:n] / sizes
            shapes.append(seen / seen[np.argmax(np.abs(seen))])
        covariance = dynamics.mode_covariance
        u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return cls(dynamics.modes, u[: len(shapes)], u[len(shapes) :], np.array(shapes), covariance)
