"""Weighing: mass, centre of gravity and offsets from static readings over pitch and roll, Eq. (1)."""

from aerobalance.balance.weighing.fit import weigh_components
from aerobalance.balance.weighing.model import WeightModel
from aerobalance.balance.weighing.points import LoadPoints, StaticPoints, points_from_recordings
from aerobalance.balance.weighing.result import Agreement, Weighing
from aerobalance.balance.weighing.single import MovingMass, weigh

__all__ = [
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
