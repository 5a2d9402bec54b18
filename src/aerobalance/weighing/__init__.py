"""Weighing: mass, centre of gravity and offsets from static readings over pitch and roll, Eq. (1)."""

from aerobalance.weighing.model import ANGLES, AXES, DIRECTIONS, WeightModel
from aerobalance.weighing.points import LoadPoints, StaticPoints, points_from_recordings
from aerobalance.weighing.result import Agreement, Weighing
from aerobalance.weighing.single import MovingMass, weigh
from aerobalance.weighing.together import weigh_components

__all__ = [
    "ANGLES",
    "AXES",
    "DIRECTIONS",
    "Agreement",
    "LoadPoints",
    "MovingMass",
    "StaticPoints",
    "Weighing",
    "WeightModel",
    "points_from_recordings",
    "weigh",
    "weigh_components",
]
