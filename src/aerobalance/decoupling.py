r"""Coupled components taken apart: six readings of which each is that of a balance with one component.

Row i of F = X + D X' + A X'' gives F_i with noise of the spectrum N_i = r R r*, r_j = delta_ij + D_ij s + A_ij s^2,
and R the covariance of the channels' noise. It is a polynomial of second degree in the square of the frequency, so it
has a stable factor, N_i = R_ii |1 + d s + a s^2|^2: the noise with which a balance of one component, of mass over
stiffness a and damping over stiffness d, would give F_i.
What that balance would read,

    z_i = (X_i + sum_j (D_ij s + A_ij s^2) X_j) / (1 + d s + a s^2) = G_i F_i + white noise of variance R_ii,

is found from the readings without any derivative of them, and contains nothing of the other components' forces. All
that is done with one component is done with z_i; where row i of D and A has no other components, z_i is X_i.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import resample_poly

from aerobalance.channel import Array
from aerobalance.coupled import CoupledDynamics
from aerobalance.dynamics import Dynamics, Mode

FINE: Final = 4
"""Steps into which a sampling interval is divided where readings drive a balance between samples."""

EDGE: Final = 12
"""Samples at either end of a record that the window of the band-limited interpolation reaches beyond."""


@dataclass(frozen=True, slots=True, eq=False)
class LoneComponent:
    """The balance of one component that gives its force with the same noise as the coupled one.

    Attributes
    ----------
    place
        Row of the component.
    component
        Its name.
    damping, inertia
        Row of D [s] and of A [s^2], in units of the component over those of the columns, shape (n,).
    own_damping, own_inertia
        d [s] and a [s^2].
    """

    place: int
    component: str
    damping: Array
    inertia: Array
    own_damping: float
    own_inertia: float

    @classmethod
    def of(cls, dynamics: CoupledDynamics, component: str, *, noise: Array) -> LoneComponent:
        """Find it for a component.

        Parameters
        ----------
        dynamics
            The coupled components.
        component
            Which of them.
        noise
            Covariance of the noise of a reading, shape (n, n) [N^2, N^2*m, N^2*m^2]; the ratios are what matters.
        """
        place = dynamics.components.index(component)
        D, A = dynamics.damping[place], dynamics.inertia[place]
        lone = cls(place, component, D, A, float(D[place]), float(A[place]))
        if lone.alone:
            return lone
        own = noise[place, place]
        a = float(np.sqrt(A @ noise @ A / own))
        d = float(np.sqrt(max(2 * (a - A @ noise[place] / own) + D @ noise @ D / own, 0.0)))
        return replace(lone, own_damping=d, own_inertia=a)

    @property
    def partners(self) -> NDArray[np.bool_]:
        """True for the component itself and for those that have a part in its reading, shape (n,)."""
        own = np.arange(self.damping.size) == self.place
        return np.asarray(own | (self.damping != 0) | (self.inertia != 0))

    @property
    def alone(self) -> bool:
        """True where no other component has a part in its reading."""
        return int(np.count_nonzero(self.partners)) == 1

    @property
    def dynamics(self) -> Dynamics:
        """The balance of one component, its stiffness taken as 1."""
        return Dynamics(self.component, mass=self.own_inertia, stiffness=1.0, damping=self.own_damping)

    @property
    def _mode(self) -> Mode:
        return self.dynamics.modes[0]

    def reading(self, loads: Array, *, interval: float) -> Array:
        """What that balance reads when the coupled one reads these loads, shape (samples,).

        Before its first sample every load is taken as held; another past of it is a free oscillation of z.

        Parameters
        ----------
        loads
            Shape (samples, n), without gaps.
        interval
            Time between samples [s].
        """
        if self.alone:
            return loads[:, self.place].copy()
        own = np.zeros(self.damping.size)
        own[self.place] = 1.0
        direct = self.inertia / self.own_inertia
        by_rate = self.damping - direct * self.own_damping
        return self._driven(loads, direct=direct, by_rate=by_rate, by_value=own - direct, interval=interval)

    def parameter_slopes(self, loads: Array, *, interval: float) -> Array:
        """Change of `reading` with each element of the row of A, then of D, shape (samples, 2 n)."""
        n = self.damping.size
        zero, one = np.zeros(n), np.eye(n)
        slopes = []
        for load in one:
            direct = load / self.own_inertia
            slopes.append((direct, -direct * self.own_damping, -direct))
        slopes += [(zero, load, zero) for load in one]
        columns = [
            self._driven(loads, direct=direct, by_rate=by_rate, by_value=by_value, interval=interval)
            for direct, by_rate, by_value in slopes
        ]
        return np.column_stack(columns)

    def _driven(self, loads: Array, *, direct: Array, by_rate: Array, by_value: Array, interval: float) -> Array:
        """Weighted sum of loads and of what they are behind 1 / (1 + d s + a s^2), value and rate."""
        fine, step = finer(loads @ np.column_stack([by_value, by_rate])), interval / FINE
        value = self._mode.driven(fine[:, 0], interval=step)[0] if by_value.any() else np.zeros(fine.shape[0])
        rate = self._mode.driven(fine[:, 1], interval=step)[1] if by_rate.any() else np.zeros(fine.shape[0])
        return np.asarray(loads @ direct + (value + rate)[::FINE])


def finer(series: Array) -> Array:
    """Series (samples, c) on a clock `FINE` times as fast, band-limited, such that straight lines do it no harm.

    Straight lines between samples lose (w h)^2 / 12 of a sine of angular frequency w; a twelfth of the second
    difference, taken off beforehand, gives it back, and what is lost is (w h)^4 / 240.
    """
    first = series[:1]
    fine = np.asarray(first + resample_poly(series - first, FINE, 1, axis=0, window=("kaiser", 8.0), padtype="line"))
    # near the ends the window reaches beyond the record: a spline through the samples there knows better
    count = series.shape[0]
    near, part = min(EDGE, count), min(4 * EDGE, count)
    clock = np.arange(part)
    fine[: FINE * near] = CubicSpline(clock, series[:part])(np.arange(FINE * near) / FINE)
    late = np.arange(FINE * (count - near), FINE * count) / FINE - (count - part)
    fine[FINE * (count - near) :] = CubicSpline(clock, series[count - part :])(np.minimum(late, part - 1))
    bend = np.diff(fine[: FINE * (count - 1) + 1], 2, axis=0) / 12
    fine[: FINE * (count - 1) + 1] -= np.concatenate([bend[:1], bend, bend[-1:]])
    return fine
