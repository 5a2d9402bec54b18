r"""Wiener bound: the smallest uncertainty of forces from noisy readings through the dynamics.

Let r = F/X be the inverse of the frequency response (1/G for one component, Eq. (17) of [Gorbushin2020]_), sigma the
noise of the readings and h the sampling interval. White noise of the readings and of the motion of the ground end then
gives the forces the one-sided noise density

    P(f) = 2 h (r diag(sigma^2) r* + M diag(sigma_a^2) M^T),

with M the mass matrix. The best linear estimate of forces that have the densities S up to a bandwidth B, and none
above, has the error density S (S + P)^-1 P. That is the Wiener bound; it is P where the forces are strong against the
noise. A decoupled channel reaches S_ii P_ii / (S_ii + P_ii), the same where a component stands alone.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS

PANELS: Final = 64
"""Equal parts of the band that spectra are integrated over; about the poles they are divided further."""

NODES: Final = 16
"""Nodes of the Gauss-Legendre rule in each part. With parts about as long as the distance to the next pole it is exact
to 4e-12 (measured on four balances), where 4097 equal steps left 8 % out at a resonance narrower than a step."""

ACCELERATION: Final = "acceleration of the ground end"
ANGULAR_ACCELERATION: Final = "angular acceleration of the ground end"
PARAMETERS: Final = "parameters of the dynamics"


@dataclass(frozen=True, slots=True)
class Attainable:
    """Standard uncertainty of one sample of a force that stays below a bandwidth.

    Attributes
    ----------
    component
        Which component.
    bandwidth
        Highest frequency of the force [Hz].
    rate
        Sampling rate [Hz].
    readings
        From the noise of the reading of each component [N, N*m]. What the Wiener bound shrinks of a weak force is
        shared out between all sensors in proportion to what comes through of their noise.
    acceleration
        From the noise of the ground end's acceleration [N, N*m].
    angular_acceleration
        From the noise of the ground end's angular acceleration [N, N*m].
    parameters
        From the uncertainty of the dynamics, for forces of the given size; zero where none is given [N, N*m].
    decoupled
        What the component's decoupled channel reaches, all together [N, N*m].
    noise_gain
        Noise of the force over noise of the component's own reading, whatever the size of the force [1].
    """

    component: str
    bandwidth: float
    rate: float
    readings: Mapping[str, float]
    acceleration: float
    angular_acceleration: float
    parameters: float
    decoupled: float
    noise_gain: float

    @property
    def contributions(self) -> Mapping[str, float]:
        """Standard uncertainty by cause [N, N*m]."""
        return {
            **{f"{name} reading": u for name, u in self.readings.items()},
            ACCELERATION: self.acceleration,
            ANGULAR_ACCELERATION: self.angular_acceleration,
            PARAMETERS: self.parameters,
        }

    @property
    def total(self) -> float:
        """Standard uncertainty by all causes together [N, N*m]."""
        return float(np.linalg.norm(list(self.contributions.values())))

    @property
    def limited_by(self) -> str:
        """The cause of the largest contribution."""
        parts = self.contributions
        return max(parts, key=lambda name: parts[name])


@dataclass(frozen=True, slots=True, eq=False)
class WienerBound:
    """Dynamics of n components whose forces are estimated together, with the noise of all that is measured.

    Attributes
    ----------
    dynamics
        The dynamics.
    noise
        Standard uncertainty of one reading of each component [N, N*m].
    ground_end
        Forces by one standard uncertainty of the ground end's motion, by its cause, shape (n, k) each [N, N*m].
    """

    dynamics: BalanceDynamics
    noise: Mapping[str, float]
    ground_end: Mapping[str, Array]

    @classmethod
    def of(
        cls,
        dynamics: BalanceDynamics,
        *,
        noise: Mapping[str, float],
        acceleration_noise: float = 0.0,
        angular_acceleration_noise: float = 0.0,
    ) -> WienerBound:
        """Return the bound for components whose forces are estimated together; the arguments are those of `plan`.

        Raises
        ------
        ValueError
            The ground end's motion has noise and the dynamics do not know the mass that it acts on.
        """
        motion = {ACCELERATION: acceleration_noise, ANGULAR_ACCELERATION: angular_acceleration_noise}
        ground_end = {cause: _mass_rows(dynamics, cause) * size for cause, size in motion.items() if size}
        return cls(dynamics, noise, ground_end)

    def _densities(self, frequency: Array, *, rate: float) -> dict[str, NDArray[np.complex128]]:
        """Return the one-sided density of the noise of the forces by its cause, shape (m, n, n) each."""
        inverse = self.dynamics.inverse_response(frequency)
        found = {}
        for place, name in enumerate(self.dynamics.components):
            column = inverse[:, :, place] * self.noise[name] * np.sqrt(2 / rate)
            found[name] = column[:, :, None] * column[:, None, :].conj()
        for cause, rows in self.ground_end.items():
            found[cause] = np.broadcast_to(rows @ rows.T * 2 / rate, inverse.shape).astype(np.complex128)
        return found

    def attainable(self, force: Mapping[str, float] | None, *, bandwidth: float, rate: float) -> list[Attainable]:
        """Return the attainable standard uncertainty of each component's force [N, N*m].

        Parameters
        ----------
        force
            Root mean square of each force, spread evenly up to the bandwidth [N, N*m]; None where all are strong
            against the noise, and the parameters of the dynamics are taken as known.
        bandwidth
            Highest frequency of the forces [Hz].
        rate
            Sampling rate [Hz].
        """
        names = self.dynamics.components
        poles = np.concatenate([self.dynamics.poles, self.dynamics.zeros])
        frequency, weights = _quadrature(bandwidth, poles)
        densities = self._densities(frequency, rate=rate)
        of_readings = np.sum([_diagonal(densities[name]) for name in names], axis=0)
        parameters, by_cause = np.zeros(len(names)), {cause: _diagonal(part) for cause, part in densities.items()}
        alone = np.sum(list(by_cause.values()), axis=0)
        if force is not None:
            size = np.array([force[name] for name in names]) / np.sqrt(bandwidth)
            parameters = weights @ _parameter_density(self.dynamics, frequency, size)
            by_cause = _shared_out(densities, np.diag(size**2))
            alone = size**2 * alone / (size**2 + alone)
        shares = {cause: np.sqrt(weights @ part) for cause, part in by_cause.items()}
        decoupled = np.sqrt(weights @ alone + parameters)
        gains = np.sqrt(weights @ of_readings)
        nothing = np.zeros(len(names))
        return [
            Attainable(
                component=name,
                bandwidth=bandwidth,
                rate=rate,
                readings={other: float(shares[other][place]) for other in names},
                acceleration=float(shares.get(ACCELERATION, nothing)[place]),
                angular_acceleration=float(shares.get(ANGULAR_ACCELERATION, nothing)[place]),
                parameters=float(np.sqrt(parameters[place])),
                decoupled=float(decoupled[place]),
                noise_gain=float(gains[place]) / self.noise[name],
            )
            for place, name in enumerate(names)
        ]


def _mass_rows(dynamics: BalanceDynamics, cause: str) -> Array:
    """Return the forces by the ground end's acceleration, or by its angular acceleration, shape (n, 3)."""
    if not dynamics.moved_by.any():
        raise ValueError("noise of the ground end's motion acts through the mass, which the dynamics do not hold")
    rotation = cause == ANGULAR_ACCELERATION
    columns = np.array([(name in MOMENTS) == rotation for name in COMPONENTS])
    if rotation and not dynamics.moved_by[columns].any():
        raise ValueError(
            f"angular_acceleration_noise needs coupled dynamics: those of {', '.join(dynamics.components)} know the "
            "mass along one axis only"
        )
    return dynamics.mass_rows[:, columns]


def _parameter_density(dynamics: BalanceDynamics, frequency: Array, size: Array) -> Array:
    """Return the variance by the parameters of forces of the density size^2, shape (m, n)."""
    density = np.zeros((frequency.size, len(dynamics.components)))
    for place, (slopes, covariance) in enumerate(dynamics.force_slopes(frequency)):
        if covariance.any():
            own = slopes * size
            variance = np.einsum("mpk,pq,mqk->m", own, covariance, own.conj(), optimize=True)
            density[:, place] = np.maximum(np.real(variance), 0.0)
    return density


def _quadrature(bandwidth: float, poles: NDArray[np.complex128]) -> tuple[Array, Array]:
    """Return frequencies between 0 and a bandwidth, and the weights that integrate over it, shape (m,) each [Hz]."""
    widest = bandwidth / PANELS
    ends = [np.linspace(0, bandwidth, PANELS + 1)]
    for pole in poles:
        centre, width = abs(pole.imag) / (2 * np.pi), max(abs(pole.real) / (2 * np.pi), 1e-9 * bandwidth)
        away = width * 2.0 ** np.arange(np.ceil(np.log2(max(widest / width, 1.0))) + 1)
        ends.append(np.concatenate([[centre], centre - away, centre + away]))
    edges = np.unique(np.clip(np.concatenate(ends), 0, bandwidth))
    node, weight = np.polynomial.legendre.leggauss(NODES)
    half, middle = np.diff(edges)[:, None] / 2, (edges[1:] + edges[:-1])[:, None] / 2
    return (middle + half * node).ravel(), (half * weight).ravel()


def _diagonal(density: NDArray[np.complex128]) -> Array:
    return np.real(np.diagonal(density, axis1=1, axis2=2))


def _shared_out(densities: Mapping[str, NDArray[np.complex128]], force: Array) -> dict[str, Array]:
    """Return the error density of each force by its cause, shape (m, n) each, for forces of densities (n, n)."""
    whole = np.sum(list(densities.values()), axis=0)
    weights = force @ np.linalg.inv(force + whole)
    passed = {cause: _diagonal(weights @ part @ weights.conj().swapaxes(1, 2)) for cause, part in densities.items()}
    scale = _diagonal(weights @ whole) / np.maximum(np.sum(list(passed.values()), axis=0), 1e-300)
    return {cause: part * scale for cause, part in passed.items()}
