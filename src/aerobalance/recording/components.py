"""The six components of a balance, and the one table of its axes and signs, from which all others follow.

Order is the direct-read order of AIAA R-091. Axes are aft, right, up, a right-handed triple. AF, force and
acceleration along the balance are positive aft; NF is positive up, SF to the right, pitch nose up.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.errors import GAUGES_BECOME_LOADS, NAMES_BY_MAP

COMPONENTS: Final = ("NF", "PM", "SF", "YM", "RM", "AF")
"""Normal force, pitching moment, side force, yawing moment, rolling moment, axial force."""

MOMENTS: Final = ("PM", "YM", "RM")
"""The components that are moments [N*m]; the others are forces [N]."""

AXES: Final = ("aft", "right", "up")
"""The balance's axes, in the order of all vectors."""

VECTORS: Final = {
    "NF": (0, 0, 1),
    "SF": (0, 1, 0),
    "AF": (1, 0, 0),
    "PM": (0, 1, 0),
    "YM": (0, 0, -1),
    "RM": (-1, 0, 0),
}
"""Direction of every component along aft, right, up: of the force, or of the right-handed turn of the moment."""

ANGLES: Final[Mapping[str, str]] = {"pitch": "PM", "roll": "RM", "yaw": "YM"}
"""Angles of the balance, and the moment that turns it by each: nose up, right side down, nose right."""

ENDINGS: Final[Mapping[str, str]] = {"aft": "", "right": "_y", "up": "_z"}
"""Ending of the name of an acceleration's channel, by axis."""

AXIS_VECTORS: Final[Mapping[str, tuple[float, float, float]]] = {
    "aft": (1.0, 0.0, 0.0),
    "right": (0.0, 1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
}
"""Unit vectors of the axes, in their own coordinates."""

FORCE_AXES: Final[Mapping[str, str]] = {
    name: axis for axis in AXES for name in COMPONENTS if name not in MOMENTS and VECTORS[name] == AXIS_VECTORS[axis]
}
"""The axis along which each force is positive, in the order of the axes."""

FORCE_ROWS: Final = tuple(COMPONENTS.index(name) for name in FORCE_AXES)
"""Places of the forces among the components, in the order of the axes."""

MOMENT_ROWS: Final = tuple(COMPONENTS.index(name) for name in MOMENTS)
"""Places of the moments among the components."""

IS_FORCE: Final[NDArray[np.float64]] = np.array([float(name not in MOMENTS) for name in COMPONENTS])
"""1 for the forces, 0 for the moments, shape (6,)."""

DIRECTIONS: Final[NDArray[np.float64]] = np.array([VECTORS[name] for name in COMPONENTS], dtype=np.float64)
"""Directions of the components along aft, right, up, shape (6, 3)."""

FROM_VECTORS: Final[NDArray[np.float64]] = np.hstack(
    [DIRECTIONS * IS_FORCE[:, None], DIRECTIONS * (1 - IS_FORCE)[:, None]]
)
"""Matrix from force and moment along aft, right, up to the components, shape (6, 6); orthogonal."""

STANDARD_GRAVITY: Final = 9.80665
"""Standard acceleration of gravity [m/s^2] (3rd CGPM, 1901); used where no local value is given."""


_GAUGE: Final = re.compile(r"r[A-Z]\w*")


def is_gauge(name: str) -> bool:
    """Return whether a channel name is that of a gauge output: ``r`` and the component's name at the balance (rN1)."""
    return _GAUGE.fullmatch(name) is not None


def loads_hint(names: Iterable[str]) -> str:
    """Return what gives the loads that are not among the names of channels, to end a message with; may be empty."""
    there = list(names)
    if any(is_gauge(name) for name in there):
        return f"; {GAUGES_BECOME_LOADS}"
    return "" if any(name in COMPONENTS for name in there) else f"; {NAMES_BY_MAP}"


def si_unit(component: str) -> str:
    """Return the SI unit of a load component: ``"N"`` for forces, ``"N*m"`` for moments."""
    return "N*m" if component in MOMENTS else "N"


def mass_unit(component: str) -> str:
    """Return the unit of the moving mass that turns axial ground acceleration into this component.

    For a moment on one axis of motion the mass carries its lever: kg*m.
    """
    return "kg*m" if component in MOMENTS else "kg"


def dynamics_units(component: str) -> dict[str, str]:
    """Return the units of the parameters of dynamics; a moment's mass has its lever, and with it what goes with it."""
    moment = component in MOMENTS
    return {
        "mass": mass_unit(component),
        "stiffness": "N" if moment else "N/m",
        "damping": "N*s" if moment else "N*s/m",
        "natural_frequency": "Hz",
        "damping_ratio": "1",
        "delay": "s",
    }


def density_unit(component: str) -> str:
    """Return the unit of a spectral density of a load component."""
    unit = si_unit(component)
    return f"({unit})^2/Hz" if "*" in unit else f"{unit}^2/Hz"


def driving_axis(component: str) -> str:
    """Return the axis along which the ground drives a component taken alone: a force's own, aft for moments."""
    return FORCE_AXES.get(component, "aft")


def acceleration_name(end: str, component: str) -> str:
    """Return the channel of the acceleration, of the ``"ground"`` or the ``"live"`` end, that drives a component."""
    return f"{end}_acceleration{ENDINGS[driving_axis(component)]}"


def driving_channel(end: str, component: str, recorded: Container[str]) -> str:
    """Return the recorded acceleration of an end that drives a component: of its axis, or else of that without a name.

    Where neither is recorded it is that of its axis.
    """
    own, plain = acceleration_name(end, component), f"{end}_acceleration"
    return plain if own not in recorded and plain in recorded else own


def other_end(ground: str) -> str:
    """Return the channel of the live end's acceleration along the same axis as an acceleration of the ground end."""
    return f"live{ground.removeprefix('ground')}"
