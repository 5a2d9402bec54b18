"""Balances whose model or sting bends: a passive structure of more degrees of freedom than components.

The live end moves by q against the sting's end, and e modes of model or sting by eta:

    [ M   P ] [q  ]''   [ C  0 ] [q  ]'   [ K  0 ] [q  ]   [  1  ]
    [ P^T m ] [eta]   + [ 0  c ] [eta]  + [ 0  k ] [eta] = [ G^T ] F,      X = K q.

A model that bends is moved by the live end through P, and by the load through the place G where it acts; a sting that
bends along the columns of S carries the whole model, with P = M S, G = S and m = S^T M S and the sting's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, null_space

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.simulation.six_balance import CoupledBalance


@dataclass(frozen=True, slots=True, eq=False)
class Bending:
    """Modes of the model or the sting behind a balance.

    Attributes
    ----------
    coupling
        P, what an acceleration of the modes asks of the live end, shape (6, e).
    driven
        G, how a load drives the modes, shape (6, e).
    mass, damping, stiffness
        m, c and k, shape (e, e).
    """

    coupling: Array
    driven: Array
    mass: Array
    damping: Array
    stiffness: Array

    @classmethod
    def random(
        cls, balance: CoupledBalance, generator: np.random.Generator, *, frequency: float, part: float
    ) -> Bending:
        """A mode of the model or of the sting.

        Parameters
        ----------
        balance
            What it belongs to.
        generator
            Source of randomness.
        frequency
            Frequency of the mode while the balance is held [Hz], or while the model is off for a sting.
        part
            Size of its coupling, from 0 to below 1; the square is the part of the moving mass that moves with it.
        """
        lower = np.linalg.cholesky(balance.mass.matrix)
        direction = generator.normal(size=(6, 1))
        direction *= part / np.linalg.norm(direction)
        # the sting moves the whole model; loads on a model act between its root and where it bends most
        reach = 1.0 if generator.random() < 0.5 else generator.uniform(0, 1.5)
        driven = reach * np.linalg.solve(lower.T, direction)
        ratio, rate = float(np.exp(generator.uniform(np.log(0.004), np.log(0.03)))), 2 * np.pi * frequency
        unit = np.eye(1)
        return cls(lower @ direction, driven, unit, 2 * ratio * rate * unit, rate**2 * unit)

    def beside(self, other: Bending) -> Bending:
        """Both, of parts that do not touch."""
        return Bending(
            np.hstack([self.coupling, other.coupling]),
            np.hstack([self.driven, other.driven]),
            block_diag(self.mass, other.mass),
            block_diag(self.damping, other.damping),
            block_diag(self.stiffness, other.stiffness),
        )


def bending_dynamics(balance: CoupledBalance, bending: Bending) -> CoupledDynamics:
    """Dynamics of the balance loads, with an internal coordinate for each mode of bending.

    Hidden are such loads in springs that no load applied at rest makes, L q with L K^-1 B = 0; then
    [X; Y] + D [X; Y]' + A [X; Y]'' = [F; 0] with A = T K^-1 M T^-1 and D likewise, [X; Y] = T q.
    """
    e = len(bending.mass)
    nothing = np.zeros((6, e))
    M = np.block([[balance.mass.matrix, bending.coupling], [bending.coupling.T, bending.mass]])
    C = np.block([[balance.damping, nothing], [nothing.T, bending.damping]])
    K = np.block([[balance.stiffness, nothing], [nothing.T, bending.stiffness]])
    at_rest = np.linalg.solve(K, np.vstack([np.eye(6), bending.driven.T]))
    size = np.sqrt(np.diag(K))
    unseen = null_space((at_rest * size[:, None]).T).T * size * float(np.mean(balance.half_range) / size.mean())
    turn = np.vstack([np.hstack([balance.stiffness, nothing]), unseen])
    back = np.linalg.inv(turn)
    flexible = turn @ np.linalg.inv(K)
    return CoupledDynamics(COMPONENTS, flexible @ M @ back, flexible @ C @ back, mass=balance.mass)
