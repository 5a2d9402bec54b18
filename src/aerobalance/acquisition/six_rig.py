"""The simulated rig whose six components are coupled, in closed form from block to block."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.simulation.published import CABLE_CUT

GROUND_NOISE: Final = (0.02, 0.1, 0.02, 0.1, 0.1, 0.02)
"""Standard deviation of a reading of each; assumed [m/s^2, rad/s^2]."""

SHAKEN: Final = ((17.0, 1.0), (23.0, 5.0), (13.0, 1.0), (29.0, 5.0), (31.0, 8.0), (41.0, 1.0))
"""Frequency [Hz] and amplitude of the sine in which the ground end moves along each, where it is shaken with 1 [m/s^2,
rad/s^2]."""

LARGEST_SHAKE: Final = 5.0
"""Largest factor of these."""

FREQUENCIES: Final = {"NF": 68.0, "PM": 91.0, "SF": 57.0, "YM": 83.0, "RM": 112.0}
"""Natural frequency that each component would have alone [Hz]; assumed, but for AF."""

DAMPING_RATIO: Final = 0.01
"""Damping ratio of all modes; assumed."""

COUPLED: Final = {("NF", "PM"): 0.25, ("SF", "YM"): -0.2, ("SF", "RM"): 0.1, ("PM", "AF"): 0.08, ("YM", "RM"): 0.05}
"""Stiffness by which two components are coupled, over the root of the product of their own; assumed."""


def six_dynamics() -> CoupledDynamics:
    """Return the dynamics of the rig: the model of the cable cut with assumed inertias on coupled springs."""
    printed = CABLE_CUT.dynamics
    mass = RigidMass(printed.mass, np.array([0.04, 0.0, 0.01]), np.diag([3.0, 24.0, 26.0]))
    alone = [printed.natural_frequency if name == "AF" else FREQUENCIES[name] for name in COMPONENTS]
    size = 2 * np.pi * np.array(alone) * np.sqrt(np.diag(mass.matrix))
    share = np.eye(6)
    for (one, other), value in COUPLED.items():
        i, j = COMPONENTS.index(one), COMPONENTS.index(other)
        share[i, j] = share[j, i] = value
    stiffness = np.outer(size, size) * share
    lower = np.linalg.cholesky(mass.matrix)
    inverse = np.linalg.inv(lower)
    squares, turned = np.linalg.eigh(inverse @ stiffness @ inverse.T)
    across = lower @ turned
    damping = across @ np.diag(2 * DAMPING_RATIO * np.sqrt(squares)) @ across.T
    return CoupledDynamics.of_rigid_mass(mass, stiffness=stiffness, damping=(damping + damping.T) / 2)


class SixMotion:
    """Balance loads under a steady load that may change on a straight line, on a ground end that moves in sines.

    Parameters
    ----------
    dynamics
        The coupled components, all six.
    load
        Load held before the start, shape (6,) [N, N*m].
    """

    def __init__(self, dynamics: CoupledDynamics, load: Array) -> None:
        poles, shapes, weights = dynamics.modal_form
        up = poles.imag > 0
        self._poles, self._shapes, self._weights = poles[up], shapes[:, up], weights[up]
        self._state: NDArray[np.complex128] = -(self._weights @ load) / self._poles
        mass = np.zeros((6, 6)) if dynamics.mass is None else dynamics.mass.matrix
        self._by_ground = self._weights @ mass
        self._omega = 2 * np.pi * np.array([frequency for frequency, _ in SHAKEN])
        self._size = np.array([amplitude for _, amplitude in SHAKEN])
        self._phase = np.zeros(6)

    def move(self, time: Array, *, load: Array, change: Array, shaken: float, more: float) -> tuple[Array, Array]:
        """Return balance loads and the ground's accelerations at `time`, both (n, 6), and move on to the last of it.

        Parameters
        ----------
        time
            Times from where the motion stands, shape (n,), increasing from 0 [s].
        load, change
            Load at time 0 [N, N*m] and its change [N/s, N*m/s], shape (6,).
        shaken, more
            Factor of the ground's motion at time 0, and its change [1/s].
        """
        turn = np.exp(1j * self._phase) * self._size
        waves = np.exp(1j * self._omega * time[:, None])
        ground = np.imag((shaken + more * time)[:, None] * waves * turn)
        # (P + D t) e^(rate t) drives a mode to e^(rate t) ((P + D t) / lag - D / lag^2), lag = rate - pole
        poles = self._poles[:, None]
        parts = [
            (
                0.0 * self._omega[:1],
                np.ones((time.size, 1)),
                self._weights @ load[:, None],
                self._weights @ change[:, None],
            )
        ]
        if shaken or more:
            for sign in (1, -1):
                size = -sign * self._by_ground * (turn if sign > 0 else np.conj(turn)) / 2j
                wave = waves if sign > 0 else np.conj(waves)
                parts.append((sign * self._omega, wave, shaken * size, more * size))
        modes = np.zeros((time.size, self._poles.size), dtype=np.complex128)
        start = np.zeros(self._poles.size, dtype=np.complex128)
        for omega, wave, steady, slope in parts:
            lag = 1j * omega - poles
            first, then = steady / lag - slope / lag**2, slope / lag
            modes += wave @ first.T + (time[:, None] * wave) @ then.T
            start += first.sum(axis=1)
        modes += np.exp(self._poles * time[:, None]) * (self._state - start)
        self._state = modes[-1]
        self._phase = np.mod(self._phase + self._omega * float(time[-1]), 2 * np.pi)
        return 2 * np.real(modes @ self._shapes.T), ground
