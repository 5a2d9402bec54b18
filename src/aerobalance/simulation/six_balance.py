"""A balance with a rigid model whose six components are coupled, and random ones of a sensible size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.terms import terms_of
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS, STANDARD_GRAVITY
from aerobalance.simulation.calibration_stand import SIZES

FREQUENCIES: Final = (60.0, 600.0)
"""Natural frequencies that random balances have [Hz]."""

DAMPING_RATIOS: Final = (0.003, 0.07)
"""Damping ratios that random balances have [1]."""

_KINDS: Final = (0, 1, 2, 4)


@dataclass(frozen=True, slots=True, eq=False)
class CoupledBalance:
    """A balance with its model.

    Attributes
    ----------
    half_range
        Half range of every component, shape (6,) [N, N*m].
    stiffness
        K, balance loads over displacement and turn of the live end at the balance's centre, shape (6, 6), symmetric.
    damping
        C, shape (6, 6), symmetric.
    mass
        Live end and model.
    matrix
        What the gauges give; its components must be such that `BalanceMatrix.direct` is known.
    noise
        Standard deviation of one reading, over half range; for gauge outputs, over the output at half range.
    acceleration_noise, turn_noise, rate_noise
        Standard deviation of one reading of the ground's acceleration [m/s^2], angular acceleration [rad/s^2] and rate
        of turn [rad/s].
    """

    half_range: Array
    stiffness: Array
    damping: Array
    mass: RigidMass
    matrix: BalanceMatrix
    noise: float = 1e-4
    acceleration_noise: float = 0.02
    turn_noise: float = 0.1
    rate_noise: float = 0.002

    def __post_init__(self) -> None:
        if self.half_range.shape != (6,) or not (self.half_range > 0).all():
            raise ValueError("half_range must be six positive loads")
        for name in ("stiffness", "damping"):
            value = getattr(self, name)
            if value.shape != (6, 6) or not np.allclose(value, value.T, rtol=1e-9, atol=0):
                raise ValueError(f"{name} must have shape (6, 6) and be symmetric")
            if np.linalg.eigvalsh(_scaled(value))[0] <= 0:
                raise ValueError(f"{name} must be positive definite")
        self._from_native()

    @property
    def dynamics(self) -> CoupledDynamics:
        """The dynamics, known exactly."""
        return CoupledDynamics.of_rigid_mass(self.mass, stiffness=self.stiffness, damping=self.damping)

    def without_noise(self) -> CoupledBalance:
        """The same balance with perfect readings."""
        return replace(self, noise=0.0, acceleration_noise=0.0, turn_noise=0.0, rate_noise=0.0)

    def outputs(self, loads: Array) -> Array:
        """Gauge outputs, natural zero included, at loads in the order of `COMPONENTS`, both of shape (n, 6) [mV/V]."""
        zero = 0.0 if self.matrix.natural_zero is None else self.matrix.natural_zero
        return self.matrix.outputs(loads @ np.linalg.inv(self._from_native()).T) + zero

    def _from_native(self) -> Array:
        """Matrix from the balance's own components to those of `COMPONENTS`."""
        direct = self.matrix.direct
        if direct is None:
            raise ValueError(f"{', '.join(self.matrix.components)} cannot become {', '.join(COMPONENTS)}")
        return direct


def _scaled(matrix: Array) -> Array:
    """Give a symmetric matrix a diagonal of 1."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    return np.asarray(matrix / np.outer(size, size))


def random_balance(generator: np.random.Generator) -> CoupledBalance:
    """Draw a balance with a model: modes within 60-600 Hz, damped by 0.3-7 %, gauges with interactions.

    Half ranges are 500-5000 N and 20-300 N*m, the weight is 5-30 % of the least half range of the forces, and the
    model is an ellipsoid's worth of mass, some centimetres off the balance's centre.

    Parameters
    ----------
    generator
        Source of randomness.
    """
    half_range = _random_half_range(generator)
    mass = _random_mass(generator, half_range)
    while True:
        stiffness = _random_stiffness(generator, mass)
        damping = _random_damping(generator, mass, stiffness)
        if damping is None:
            continue
        modes = CoupledDynamics.of_rigid_mass(mass, stiffness=stiffness, damping=damping).modes
        if len(modes) == 6 and all(
            FREQUENCIES[0] <= mode.natural_frequency <= FREQUENCIES[1]
            and DAMPING_RATIOS[0] <= mode.damping_ratio <= DAMPING_RATIOS[1]
            for mode in modes
        ):
            return CoupledBalance(half_range, stiffness, damping, mass, _random_matrix(generator, half_range))


def _random_half_range(generator: np.random.Generator) -> Array:
    normal = generator.uniform(1000, 5000)
    side = generator.uniform(500, normal)
    axial = generator.uniform(500, 2000)
    moments = np.array([normal, side, normal]) * generator.uniform([0.03, 0.03, 0.01], [0.06, 0.06, 0.04])
    pitching, yawing, rolling = np.clip(moments, 20.0, 300.0)
    return np.array([normal, pitching, side, yawing, rolling, axial])


def _random_mass(generator: np.random.Generator, half_range: Array) -> RigidMass:
    forces = half_range[[COMPONENTS.index(name) for name in ("NF", "SF", "AF")]]
    weight = generator.uniform(0.05, 0.3) * float(forces.min())
    reach = min(0.1, 0.5 * float(half_range[COMPONENTS.index("PM")]) / weight)
    centre = generator.uniform(-1, 1, 3) * (reach, 0.1 * reach, 0.3 * reach)
    radii = generator.uniform([0.1, 0.04, 0.02], [0.3, 0.2, 0.06])
    tilt = np.linalg.qr(np.eye(3) + generator.normal(0, 0.05, (3, 3)))[0]
    spread = tilt @ np.diag(radii**2) @ tilt.T
    inertia = weight / STANDARD_GRAVITY * (np.trace(spread) * np.eye(3) - spread)
    return RigidMass(weight / STANDARD_GRAVITY, np.asarray(centre), (inertia + inertia.T) / 2)


def _random_stiffness(generator: np.random.Generator, mass: RigidMass) -> Array:
    """Springs that would give each component a frequency of its own, and couple them, force and moment most."""
    coupling = np.triu(generator.normal(0, 0.04, (6, 6)), 1)
    for force, moment in (("NF", "PM"), ("SF", "YM")):
        coupling[COMPONENTS.index(force), COMPONENTS.index(moment)] = generator.uniform(-0.3, 0.3)
    own = 2 * np.pi * np.exp(generator.uniform(np.log(70), np.log(560), 6))
    size = np.sqrt(np.diag(mass.matrix)) * own
    return np.outer(size, size) * (np.eye(6) + coupling + coupling.T)


def _random_damping(generator: np.random.Generator, mass: RigidMass, stiffness: Array) -> Array | None:
    """Dampers that couple the modes a little; None where they would feed a motion."""
    lower = np.linalg.cholesky(mass.matrix)
    inverse = np.linalg.inv(lower)
    squares, turned = np.linalg.eigh(inverse @ stiffness @ inverse.T)
    if squares[0] <= 0:
        return None
    least, largest = np.log(DAMPING_RATIOS)
    ratios = np.exp(generator.uniform(float(least), float(largest), 6))
    size = np.sqrt(2 * ratios * np.sqrt(squares))
    coupling = np.triu(generator.normal(0, 0.1, (6, 6)), 1)
    modal = np.outer(size, size) * (np.eye(6) + coupling + coupling.T)
    if np.linalg.eigvalsh(_scaled(modal))[0] <= 0:
        return None
    damping = lower @ turned @ modal @ turned.T @ lower.T
    return np.asarray((damping + damping.T) / 2)


def _random_matrix(generator: np.random.Generator, half_range: Array) -> BalanceMatrix:
    """A direct-read balance with linear, quadratic and |F| interactions of the size that real ones have."""
    terms = tuple(term for term in terms_of("96", 6) if term.kind in _KINDS)
    coefficients = np.array([generator.normal(0, SIZES[term.kind], 6) for term in terms])
    for row, term in enumerate(terms):
        if term.kind == 0:
            coefficients[row, term.first] = 1.0
    return BalanceMatrix(
        components=COMPONENTS,
        gauges=COMPONENTS,
        way="iterative",
        terms=terms,
        coefficients=coefficients,
        load_scale=half_range,
        output_scale=generator.uniform(0.9, 1.3, 6),
        covariance=np.zeros((6, len(terms), len(terms))),
        residual_deviation=np.zeros(6),
        residual_correlation=np.eye(6),
        degrees_of_freedom=np.zeros(6, dtype=np.intp),
        calibrated=np.array([-half_range, half_range]),
        natural_zero=generator.normal(0, 0.03, 6),
        moments=np.array([name in MOMENTS for name in COMPONENTS]),
        balance_type="direct",
    )
