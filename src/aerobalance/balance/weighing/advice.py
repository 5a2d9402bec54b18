"""Parameters that the attitudes of a weighing do not identify, and the further attitudes that would."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.weighing.adjustment import (
    Adjustment,
    Readings,
    identified,
    natural_scales,
    planning_jacobian,
    planning_noise,
)
from aerobalance.balance.weighing.model import WeightModel
from aerobalance.recording.channel import Array
from aerobalance.recording.gravity import weight_direction

PROPOSALS: Final = (
    ("roll 90 deg", (0.0,), (90.0,)),
    ("roll 180 deg", (0.0,), (180.0,)),
    ("pitch -15 and 15 deg", (-15.0, 15.0), (0.0, 0.0)),
    ("roll 90 and 270 deg", (0.0, 0.0), (90.0, 270.0)),
    ("roll 90, 180 and 270 deg", (0.0, 0.0, 0.0), (90.0, 180.0, 270.0)),
    (
        "pitch -15, 0 and 15 deg at roll 0, 90, 180 and 270 deg each",
        (-15.0, 0.0, 15.0) * 4,
        (0.0,) * 3 + (90.0,) * 3 + (180.0,) * 3 + (270.0,) * 3,
    ),
)
"""Further attitudes to propose, the least effort first: text, pitch and roll [deg]."""


MARGIN: Final = 2.0
"""Noise is taken this much larger when attitudes are proposed, so that they do not just suffice."""


def what_would_help(model: WeightModel, readings: Readings, *, values: Array, sigma: Array, name: str) -> str:
    """Return advice on the attitudes that would identify a parameter, by the information that they bring.

    Parameters
    ----------
    model, readings
        Model and what was read.
    values, sigma
        Parameters, shape (p,), and noise, shape (n, c), that the information is predicted with.
    name
        The parameter.
    """
    index = model.names.index(name)
    typical = np.sqrt(np.mean(planning_noise(model, readings, sigma) ** 2, axis=0))
    there = planning_jacobian(model, readings, values=values, sigma=sigma)
    straight = np.where([entry.startswith("misalignment") for entry in model.names], 0.0, values)
    scales = natural_scales(model, readings)
    for text, pitch, roll in PROPOSALS:
        directions = weight_direction(np.radians(pitch), np.radians(roll))
        further = model.jacobian(directions, straight) / typical[:, None]
        rows = np.concatenate([there, further]).reshape(-1, scales.size)
        if index in identified(model, rows / MARGIN, scales):
            return f"add readings at {text}"
    others = [component for component in ("NF", "PM", "SF", "YM", "RM", "AF") if component not in model.components]
    further_components = f", or reading {', '.join(others)} too" if others else ""
    return (
        f"less noise{further_components} would help; further attitudes alone would not (the components read do not "
        "show it well enough)"
    )


def unidentified(
    readings: Readings, *, chosen: Adjustment, common: Adjustment, separate: Adjustment
) -> dict[str, str]:
    """Return advice by parameter that the readings, or one component by itself, do not identify.

    Parameters
    ----------
    readings
        What was fitted.
    chosen
        Fit that the misalignment is taken from.
    common
        Fit with one mass and one centre of gravity.
    separate
        Fit with a mass for every force and a centre of gravity for every moment.
    """
    found: dict[str, str] = {}
    for adjustment in (chosen, common, separate):
        model = adjustment.model
        for index in adjustment.left_out[_shows(adjustment)]:
            name = model.names[index]
            title = name.replace("moment", "centre_of_gravity")
            if title not in found and (adjustment is chosen or not name.startswith("misalignment")):
                found[title] = what_would_help(
                    model, readings, values=adjustment.values, sigma=adjustment.sigma, name=name
                )
    return found


def _shows(adjustment: Adjustment) -> NDArray[np.bool_]:
    """Which of the parameters left out change any load at any attitude: AF does not feel a turn about its own axis."""
    straight = adjustment.values.copy()
    straight[-3:] = 0.0
    slopes = adjustment.model.jacobian(np.eye(3), straight)  # with the weight along each axis
    return np.asarray(slopes[:, :, adjustment.left_out].any(axis=(0, 1)))
