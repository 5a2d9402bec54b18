"""The two experiments of [Gorbushin2020]_ simulated, and one of six components: masses, springs, sensors, noise.

The equations of motion are integrated exactly for inputs that are cubics between the points of a fine grid; releases
are added in closed form at any instant, and the state is evaluated at the very instants at which each sensor samples.
No solution formula of the paper is used here.
"""

from aerobalance.simulation.cable_cut import CableCut
from aerobalance.simulation.drives import Drive, RandomDrive, Signal, SteppedSine, Sweep, Unsteadiness, band_noise
from aerobalance.simulation.sensors import ACCELEROMETER_RANGE, Sensor, Simulation
from aerobalance.simulation.six_components import (
    CoupledBalance,
    Release,
    SixComponentRig,
    SixSimulation,
    random_balance,
)
from aerobalance.simulation.six_signals import (
    Band,
    BaseMotion,
    SixSignal,
    broadband,
    driven_motion,
    oscillation,
    random_motion,
    sampled,
    tap,
    together,
)
from aerobalance.simulation.vibration import ARMATURE_MASS, VibrationRig

__all__ = [
    "ACCELEROMETER_RANGE",
    "ARMATURE_MASS",
    "Band",
    "BaseMotion",
    "CableCut",
    "CoupledBalance",
    "Drive",
    "RandomDrive",
    "Release",
    "Sensor",
    "Signal",
    "Simulation",
    "SixComponentRig",
    "SixSignal",
    "SixSimulation",
    "SteppedSine",
    "Sweep",
    "Unsteadiness",
    "VibrationRig",
    "band_noise",
    "broadband",
    "driven_motion",
    "oscillation",
    "random_balance",
    "random_motion",
    "sampled",
    "tap",
    "together",
]
