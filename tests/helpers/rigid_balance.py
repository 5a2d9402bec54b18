"""A rigid model off the balance's centre on coupled springs, with which identification is tested."""

import numpy as np
from scipy.linalg import eigh

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS

HALF_RANGE = np.array([2000.0, 150.0, 800.0, 80.0, 60.0, 500.0])
RANGES = dict(zip(COMPONENTS, HALF_RANGE.tolist(), strict=True))


def balance() -> tuple[RigidMass, Array, Array]:
    """The mass, its stiffness and its damping; modes from 76 to 406 Hz."""
    inertia = np.array([[0.9, 0.03, -0.02], [0.03, 0.8, 0.05], [-0.02, 0.05, 0.15]])
    mass = RigidMass(20.0, np.array([0.04, -0.02, 0.03]), inertia)
    size = np.sqrt(np.diag(mass.matrix)) * 2 * np.pi * np.array([130.0, 300.0, 80.0, 180.0, 240.0, 400.0])
    mixing = np.random.default_rng(5).uniform(-0.05, 0.05, (6, 6))
    stiffness = (np.eye(6) + np.triu(mixing, 1) + np.triu(mixing, 1).T) * np.outer(size, size)
    squares, shapes = eigh(stiffness, mass.matrix)
    ratios = np.array([0.004, 0.01, 0.02, 0.006, 0.03, 0.015])
    M = mass.matrix
    return mass, stiffness, M @ shapes @ np.diag(2 * ratios * np.sqrt(squares)) @ shapes.T @ M


def truth() -> CoupledDynamics:
    """Dynamics of this balance."""
    mass, stiffness, damping = balance()
    return CoupledDynamics.of_rigid_mass(mass, stiffness=stiffness, damping=damping)
