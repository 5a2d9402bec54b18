"""Numbers of the simulated rigs that the set-up needs as well. Nothing here takes long to load."""

from __future__ import annotations

from typing import Final, Literal

from aerobalance.recording.components import COMPONENTS

RigName = Literal["vibration", "cable_cut", "six"]

HALF_RANGES: Final[dict[RigName, dict[str, float]]] = {
    "vibration": {"AF": 100.0},
    "cable_cut": {"AF": 2000.0},
    "six": dict.fromkeys(COMPONENTS, 2000.0),
}
"""Half of the range of each component [N, N*m]: AF as printed, the others assumed."""

SHUNT_SHARE: Final = 0.4
"""What the shunt of the simulated bridges changes their loads by, over half of the range."""

TOUCH_SHARE: Final = 0.05
"""Force between model and support while they touch, over half of the range."""

CLOSED: Final = 5.0
"""Voltage of the contact circuit where it is closed [V]."""

LARGEST_SHARE: Final = 2.0
"""Largest load of each component alone, over half of the range, of the rig with six; assumed."""
