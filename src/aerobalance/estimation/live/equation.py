"""The equation of motion of the balance with its model, as the live force takes it, for one component or several.

Eq. (17) of [Gorbushin2020]_ with matrices, F = X + D X' + A X'' - W + M x1'': X balance loads, F applied forces, W
weight, x1'' acceleration of the non-metric end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS


@dataclass(frozen=True, slots=True, eq=False)
class Equation:
    """Coefficients of the equation of motion of n components.

    Attributes
    ----------
    components
        The components, in the order of rows and columns.
    damping, inertia
        D [s] and A [s^2], shape (n, n).
    mass
        Load by a unit of each acceleration of the non-metric end, shape (n, 6); zero where the mass is not known.
    covariance
        Covariance of a row of A, D and `mass`, one below the other, for each component: shape (n, 2n + 6, 2n + 6).
    delay
        Time by which the loads lag the acceleration beside the delays of the channels [s].
    turning
        The moving mass, whose turning loads it too; None where there is no such term.
    """

    components: tuple[str, ...]
    damping: Array
    inertia: Array
    mass: Array
    covariance: Array
    delay: float = 0.0
    turning: RigidMass | None = None

    @classmethod
    def of(cls, dynamics: BalanceDynamics) -> Equation:
        """Return the equation of components whose forces are estimated together."""
        damping, inertia = dynamics.quadratic
        return cls(
            components=dynamics.components,
            damping=damping,
            inertia=inertia,
            mass=dynamics.mass_rows,
            covariance=dynamics.row_covariance,
            delay=float(dynamics.delays[0]),
            turning=dynamics.mass,
        )

    def net_load(self, specific_force: Array, turn_rate: Array | None) -> Array:
        """Return the loads on the moving mass by gravity and motion, W - M x1'', shape (m, n) [N, N*m].

        Parameters
        ----------
        specific_force
            Acceleration of the non-metric end less gravity, shape (m, 6) [m/s^2, rad/s^2].
        turn_rate
            Its rate of turn in the signs of PM, YM and RM, shape (m, 3) [rad/s]; None where none is measured.
        """
        net = -specific_force @ self.mass.T
        if turn_rate is not None and self.turning is not None:
            rows = [COMPONENTS.index(name) for name in self.components]
            net = net - self.turning.turning_load(np.nan_to_num(turn_rate))[:, rows]
        return np.asarray(net)

    def variance(self, force: Array, loads: Array, rates: Array, net: Array, specific_force: Array) -> Array:
        """Return the variance of the forces by the coefficients, shape (m, n) [N^2, N^2*m^2].

        Parameters
        ----------
        force, loads, rates, net
            F, X (NaN where missing), X' and W - M x1'', shape (m, n).
        specific_force
            Acceleration of the non-metric end less gravity, shape (m, 6).
        """
        if not self.covariance.any():
            return np.zeros(force.shape)
        left = force + net - np.where(np.isfinite(loads), loads, force + net) - rates @ self.damping.T
        J = np.hstack([np.linalg.solve(self.inertia, left.T).T, rates, specific_force])
        variance = np.einsum("mi,nij,mj->mn", J, self.covariance, J, optimize=True)
        return np.asarray(np.maximum(variance, 0.0))
