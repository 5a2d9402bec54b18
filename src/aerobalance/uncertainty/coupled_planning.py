r"""Before the test of components that ring together: what their noise, mass and sampling rate allow.

With r = F/X the matrix of the inverse response and R the noise of the channels, the noise of the forces that Eq. (17)
of [Gorbushin2020]_ with matrices gives is P = r R r* + M R_a M^T, R_a that of the ground's motion. Forces with the
spectra S, known to stay below a bandwidth, can be had with the error S (S + P)^-1 P from all channels together, the
Wiener bound; where they are strong against the noise that is P. The estimator takes the components apart, each with
S_ii P_ii / (S_ii + P_ii), which the bound falls below only where P hangs together and is not small.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.decoupling import LoneComponent
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.uncertainty.planning import GRID, Attainable, attainable

NEAR: Final = 201
"""Frequencies about each mode, closest where its response is largest."""

GROUND: Final = ("ground accelerometers", "ground turning")
"""What senses the ground's motion."""

PARAMETERS: Final = "inertia, damping"
"""What the dynamics contribute."""


@dataclass(frozen=True, slots=True)
class Sensors:
    """Standard uncertainty of one sample of everything that is measured.

    Attributes
    ----------
    noise
        Of the reading of each component [N, N*m]; above zero.
    acceleration
        Of the ground's acceleration along each axis [m/s^2].
    turning
        Of its angular acceleration about each axis [rad/s^2].
    """

    noise: Mapping[str, float]
    acceleration: float = 0.0
    turning: float = 0.0

    def __post_init__(self) -> None:
        if not all(0 < value < np.inf for value in self.noise.values()):
            raise ValueError("noise must be positive")
        if not (0 <= self.acceleration < np.inf and 0 <= self.turning < np.inf):
            raise ValueError("acceleration and turning must be zero or more")


@dataclass(frozen=True, slots=True)
class CoupledAttainable:
    """Standard uncertainty of one sample of a component's force, limited to a bandwidth.

    Attributes
    ----------
    component
        Which component.
    bandwidth
        Highest frequency of the forces [Hz].
    sensors
        By sensor: the reading of each component, and what senses the ground's motion [N, N*m].
    parameters
        From inertia and damping as they are known, for forces of the given size [N, N*m].
    apart
        What is reached with the component taken apart from the others, sensors and parameters [N, N*m].
    noise_gain
        Noise of the force over noise of the component's own reading, without regard to the force's size [1].
    """

    component: str
    bandwidth: float
    sensors: Mapping[str, float]
    parameters: float
    apart: float
    noise_gain: float

    @property
    def total(self) -> float:
        """All together [N, N*m]."""
        return float(np.linalg.norm([*self.sensors.values(), self.parameters]))

    @property
    def limited_by(self) -> str:
        """The largest contribution."""
        parts = {**self.sensors, PARAMETERS: self.parameters}
        return max(parts, key=lambda name: parts[name])


def attainable_coupled(
    dynamics: CoupledDynamics,
    sensors: Sensors,
    *,
    bandwidth: float,
    rate: float,
    force: Mapping[str, float] | None = None,
) -> tuple[CoupledAttainable, ...]:
    """Work out the uncertainty that can be reached, for every component.

    Parameters
    ----------
    dynamics
        The coupled components with their mass.
    sensors
        Noise of one sample.
    bandwidth
        Highest frequency of the forces [Hz]; above zero, at most half of `rate`.
    rate
        Sampling rate [Hz].
    force
        Root mean square of each force, taken as equally strong up to `bandwidth` [N, N*m]; all strong against the
        noise, and without a share of the parameters, where left out.

    Raises
    ------
    ValueError
        An argument is out of range, a component is missing, or the ground's motion is measured and there is no mass.
    """
    if not 0 < bandwidth <= rate / 2:
        raise ValueError(
            f"bandwidth must lie between 0 and half the sampling rate ({rate / 2:g} Hz), not {bandwidth:g}"
        )
    names = dynamics.components
    for what, given in (("noise", sensors.noise), ("force", force)):
        lacking = [] if given is None else [name for name in names if name not in given]
        if lacking:
            raise ValueError(f"{what} of {', '.join(lacking)} is missing: the components ring together")
    if force is not None and not all(0 < value < np.inf for value in force.values()):
        raise ValueError("force must be positive")
    frequency = _grid(dynamics, bandwidth)
    noises = _noises(dynamics, sensors, frequency, rate=rate)
    size = None if force is None else np.array([force[name] for name in names])
    parts = _shared_out(noises, None if size is None else np.diag(size**2 / bandwidth), frequency)
    rows = []
    for place, name in enumerate(names):
        own = float(sensors.noise[name])
        lone = LoneComponent.of(dynamics, name, noise=np.diag([sensors.noise[other] ** 2 for other in names]))
        parameters = 0.0 if size is None else _of_parameters(dynamics, lone, size, frequency=frequency)
        alone = _alone(dynamics, lone, sensors, bandwidth=bandwidth, rate=rate, force=(force or {}).get(name))
        rows.append(
            CoupledAttainable(
                name,
                bandwidth,
                {sensor: float(part[place]) for sensor, part in parts.items()},
                parameters,
                float(np.hypot(alone.total, parameters)),
                float(np.sqrt(np.trapezoid(_of_readings(noises, names)[:, place], frequency))) / own,
            )
        )
    return tuple(rows)


def _shared_out(
    noises: Mapping[str, NDArray[np.complex128]], spectra: Array | None, frequency: Array
) -> dict[str, Array]:
    """Standard uncertainty of each force by sensor, shape (n,) each; forces that are strong have no spectra.

    What the estimate shrinks is an error too, and is shared out as what comes through of the noise.
    """
    whole = np.sum(list(noises.values()), axis=0)
    weights = np.broadcast_to(np.eye(whole.shape[1]), whole.shape)
    if spectra is not None:
        weights = spectra @ np.linalg.inv(spectra + whole)
    error = np.real(np.einsum("mij,mji->mi", weights, whole))
    passed = {
        name: np.real(np.einsum("mij,mjk,mik->mi", weights, part, weights.conj(), optimize=True))
        for name, part in noises.items()
    }
    scale = error / np.maximum(np.sum(list(passed.values()), axis=0), 1e-300)
    return {name: np.sqrt(np.trapezoid(part * scale, frequency, axis=0)) for name, part in passed.items()}


def _of_readings(noises: Mapping[str, NDArray[np.complex128]], names: tuple[str, ...]) -> Array:
    """Density of the noise of each force from the readings alone, shape (m, n)."""
    whole = np.sum([noises[f"{name} reading"] for name in names], axis=0)
    return np.real(np.diagonal(whole, axis1=1, axis2=2))


def _grid(dynamics: CoupledDynamics, bandwidth: float) -> Array:
    """Frequencies up to a bandwidth, dense about the modes [Hz]."""
    spread = np.tan(np.linspace(-1.55, 1.55, NEAR))
    near = [mode.natural_frequency * (1 + mode.damping_ratio * spread) for mode in dynamics.modes]
    every = np.concatenate([np.linspace(0, bandwidth, GRID), *near])
    return np.unique(every[(every >= 0) & (every <= bandwidth)])


def _noises(
    dynamics: CoupledDynamics, sensors: Sensors, frequency: Array, *, rate: float
) -> dict[str, NDArray[np.complex128]]:
    """One-sided density of the noise of the forces by sensor, shape (m, n, n) each."""
    inverse = dynamics.inverse_response(frequency)
    found = {}
    for place, name in enumerate(dynamics.components):
        column = inverse[:, :, place] * sensors.noise[name] * np.sqrt(2 / rate)
        found[f"{name} reading"] = column[:, :, None] * column[:, None, :].conj()
    of_ground = _of_ground(dynamics, sensors)
    for name, part in zip(GROUND, of_ground, strict=True):
        if part.any():
            found[name] = np.broadcast_to(part * 2 / rate, inverse.shape).astype(np.complex128)
    return found


def _of_ground(dynamics: CoupledDynamics, sensors: Sensors) -> tuple[Array, Array]:
    """Covariance of the forces from one sample of the ground's acceleration and of its turning, (n, n) each."""
    n = len(dynamics.components)
    if not (sensors.acceleration or sensors.turning):
        return np.zeros((n, n)), np.zeros((n, n))
    if dynamics.mass is None:
        raise ValueError("the noise of the ground's motion acts through the mass, which the dynamics do not hold")
    rows = dynamics.mass.matrix[[COMPONENTS.index(name) for name in dynamics.components]]
    turns = np.array([name in MOMENTS for name in COMPONENTS])
    straight, turning = rows[:, ~turns] * sensors.acceleration, rows[:, turns] * sensors.turning
    return straight @ straight.T, turning @ turning.T


def _alone(
    dynamics: CoupledDynamics,
    lone: LoneComponent,
    sensors: Sensors,
    *,
    bandwidth: float,
    rate: float,
    force: float | None,
) -> Attainable:
    """What the component's own balance allows, which gives its force with the same noise."""
    straight, turning = _of_ground(dynamics, sensors)
    of_ground = float((straight + turning)[lone.place, lone.place])
    return attainable(
        lone.dynamics,
        bandwidth=bandwidth,
        rate=rate,
        noise=sensors.noise[lone.component],
        acceleration_noise=float(np.sqrt(of_ground)) / lone.dynamics.mass,
        force=force,
    )


def _of_parameters(dynamics: CoupledDynamics, lone: LoneComponent, size: Array, *, frequency: Array) -> float:
    """Standard uncertainty of a force from the elements of inertia and damping, for forces of such sizes."""
    rows = lone.rows(dynamics)
    covariance = dynamics.covariance[np.ix_(rows, rows)]
    if not covariance.any():
        return 0.0
    n, s = len(dynamics.components), 2j * np.pi * frequency
    whole = dynamics.equation(s)
    coordinates = np.linalg.inv(whole)[:, :, :n] * size / np.sqrt(frequency[-1])
    # an error of a hidden equation comes to the force as the hidden coordinates do
    carried = np.zeros((frequency.size, 1 + dynamics.hidden), dtype=np.complex128)
    carried[:, 0] = 1.0
    if dynamics.hidden:
        inside = whole[:, n:, n:].transpose(0, 2, 1)
        carried[:, 1:] = -np.linalg.solve(inside, whole[:, lone.place, n:, None])[..., 0]
    slopes = np.concatenate(
        [(power[:, None, None] * carried[:, :, None])[..., None] * coordinates[:, None] for power in (s**2, s)],
        axis=1,
    ).reshape(frequency.size, rows.size, n)
    variance = np.real(np.einsum("mpk,pq,mqk->m", slopes, covariance, slopes.conj(), optimize=True))
    return float(np.sqrt(max(float(np.trapezoid(variance, frequency)), 0.0)))


def usual_bandwidths_of_coupled(dynamics: CoupledDynamics, rate: float) -> tuple[float, ...]:
    """Bandwidths below, between and above the modes, up to half the sampling rate [Hz]."""
    modes = [mode.natural_frequency for mode in dynamics.modes]
    low, high = min(modes), max(modes)
    chosen = (0.2 * low, 0.5 * low, low, float(np.sqrt(low * high)), high, 1.25 * high, 2 * high)
    return (*sorted({frequency for frequency in chosen if frequency < rate / 2}), rate / 2)
