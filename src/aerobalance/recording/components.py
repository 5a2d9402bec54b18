"""The six components of a balance: their order, their units and what they measure.

Order is the direct-read order of AIAA R-091. Signs: AF, force and acceleration along the balance axis are
positive aft; NF is positive up, SF positive to the right, pitch is positive nose up.
"""

from __future__ import annotations

import re
from typing import Final

COMPONENTS: Final = ("NF", "PM", "SF", "YM", "RM", "AF")
"""Normal force, pitching moment, side force, yawing moment, rolling moment, axial force."""

MOMENTS: Final = ("PM", "YM", "RM")
"""The components that are moments [N*m]; the others are forces [N]."""

VECTORS: Final = {
    "NF": (0, 0, 1),
    "SF": (0, 1, 0),
    "AF": (1, 0, 0),
    "PM": (0, 1, 0),
    "YM": (0, 0, -1),
    "RM": (-1, 0, 0),
}
"""Direction of every component along aft, right, up: of the force, or of the right-handed turn of the moment."""

STANDARD_GRAVITY: Final = 9.80665
"""Standard acceleration of gravity [m/s^2] (3rd CGPM, 1901); used where no local value is given."""


_GAUGE: Final = re.compile(r"r[A-Z]\w*")


def is_gauge(name: str) -> bool:
    """Say whether a channel name is that of a gauge output: ``r`` and the component as the balance names it (rN1)."""
    return _GAUGE.fullmatch(name) is not None


def si_unit(component: str) -> str:
    """Return the SI unit of a load component: ``"N"`` for forces, ``"N*m"`` for moments."""
    return "N*m" if component in MOMENTS else "N"


def mass_unit(component: str) -> str:
    """Return the unit of the moving mass that turns axial ground acceleration into this component.

    For a moment on one axis of motion the mass carries its lever: kg*m.
    """
    return "kg*m" if component in MOMENTS else "kg"
