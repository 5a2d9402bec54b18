"""Weighing: mass, centre of gravity and offsets from static readings over pitch and roll, Eq. (1)."""

from aerobalance.balance.weighing.fit import against_scales, fit_weight
from aerobalance.balance.weighing.model import WeightModel
from aerobalance.balance.weighing.points import LoadPoints, points_from_recordings, with_matrix_errors
from aerobalance.balance.weighing.result import Agreement, MovingMass, Weighing

__all__ = [
    "Agreement",
    "LoadPoints",
    "MovingMass",
    "Weighing",
    "WeightModel",
    "against_scales",
    "fit_weight",
    "points_from_recordings",
    "with_matrix_errors",
]
