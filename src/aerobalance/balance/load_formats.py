"""Forms in which the six loads of a balance are given: direct-read, force balance, moment balance (AIAA R-091)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.recording.errors import argument

BalanceType = Literal["force", "moment", "direct", "unknown"]
Form = Literal["direct", "force", "moment"]


@dataclass(frozen=True, slots=True)
class Geometry:
    """Distances of the gauges of a force or moment balance from its centre, all positive [m].

    Attributes
    ----------
    forward_normal, aft_normal
        Of the gauges N1, N2 (or PM1, PM2).
    forward_side, aft_side
        Of the gauges S1, S2 (or YM1, YM2).
    """

    forward_normal: float
    aft_normal: float
    forward_side: float
    aft_side: float

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"{name} must be positive and finite, not {getattr(self, name)}")

    @property
    def normal(self) -> tuple[float, float]:
        """Distances of the forward and the aft gauge of the pitch plane [m]."""
        return self.forward_normal, self.aft_normal

    @property
    def side(self) -> tuple[float, float]:
        """Distances of the forward and the aft gauge of the yaw plane [m]."""
        return self.forward_side, self.aft_side


ROLES: Final[Mapping[str, str]] = {
    **dict.fromkeys(("n1", "fn", "fwdnormal", "normal1"), "forward normal"),
    **dict.fromkeys(("n2", "an", "aftnormal", "normal2"), "aft normal"),
    **dict.fromkeys(("s1", "y1", "fs", "fwdside", "side1"), "forward side"),
    **dict.fromkeys(("s2", "y2", "as", "aftside", "side2"), "aft side"),
    **dict.fromkeys(("pm1", "fwdpitch", "forwardpitch", "pitch1"), "forward pitch"),
    **dict.fromkeys(("pm2", "aftpitch", "pitch2"), "aft pitch"),
    **dict.fromkeys(("ym1", "fwdyaw", "forwardyaw", "yaw1"), "forward yaw"),
    **dict.fromkeys(("ym2", "aftyaw", "yaw2"), "aft yaw"),
    **dict.fromkeys(("rm", "mx", "roll", "rollingmoment"), "RM"),
    **dict.fromkeys(("af", "ax", "axial", "axialforce"), "AF"),
    **{name.lower(): name for name in ("NF", "PM", "SF", "YM")},
}
"""What the usual names of loads stand for, written without spaces and signs."""


def role_of(name: str) -> str | None:
    """Return the standard role of a load by its name (a value of `ROLES`); None where it is not known."""
    return ROLES.get("".join(sign for sign in name.lower() if sign.isalnum()))


def to_direct(components: tuple[str, ...], geometry: Geometry | None) -> Array | None:
    """Matrix that turns the loads of a balance into NF PM SF YM RM AF about its centre; None where unknown.

    Parameters
    ----------
    components
        Names of the six loads (`ROLES`). A force balance has N1 N2 S1 S2 RM AF: NF = N1 + N2, PM = x1 N1 - x2 N2 with
        gauge 1 forward, SF and YM likewise. A moment balance has PM1 PM2 YM1 YM2 RM AF, the bending moments at the
        forward (1) and the aft (2) gauge: PM1 = PM - x1 NF, PM2 = PM + x2 NF, YM1 = YM - x1 SF, YM2 = YM + x2 SF.
        A direct-read balance has NF PM SF YM RM AF.
    geometry
        Distances of the gauges; not needed for direct-read.
    """
    roles = [role_of(name) for name in components]
    native = np.zeros((6, len(components)))  # of the direct loads, in rows, by those of the balance
    planes = ((0, "normal", "pitch"), (2, "side", "yaw"))
    for column, role in enumerate(roles):
        if role in COMPONENTS:
            native[COMPONENTS.index(role), column] = 1
    for row, force, moment in planes:
        if geometry is None or native[row].any():
            continue
        x1, x2 = geometry.normal if row == 0 else geometry.side
        if {f"forward {force}", f"aft {force}"} <= set(roles):
            pair, part = force, np.array([[1.0, 1.0], [x1, -x2]])
        elif {f"forward {moment}", f"aft {moment}"} <= set(roles):
            pair, part = moment, np.linalg.inv(np.array([[-x1, 1.0], [x2, 1.0]]))
        else:
            continue
        native[row : row + 2, roles.index(f"forward {pair}")] = part[:, 0]
        native[row : row + 2, roles.index(f"aft {pair}")] = part[:, 1]
    complete = len(components) == 6 and np.linalg.matrix_rank(native) == 6
    return native if complete else None


FORMS: Final[Mapping[str, tuple[str, ...]]] = {
    "direct": COMPONENTS,
    "force": ("N1", "N2", "S1", "S2", "RM", "AF"),
    "moment": ("PM1", "PM2", "YM1", "YM2", "RM", "AF"),
}
"""The forms that six loads are given in (AIAA R-091): direct-read, force balance, moment balance."""

FORM_MOMENTS: Final[Mapping[str, tuple[bool, ...]]] = {
    "direct": tuple(name in MOMENTS for name in COMPONENTS),
    "force": (False, False, False, False, True, False),
    "moment": (True, True, True, True, True, False),
}


def between_forms(components: tuple[str, ...], form: Form, geometry: Geometry | None) -> Array:
    """Matrix that turns the loads of a balance into another form; raises ValueError where that is not possible."""
    roles, wanted = ([role_of(name) for name in names] for names in (components, FORMS[form]))
    if None not in roles and sorted(map(str, roles)) == sorted(map(str, wanted)):
        return np.array([[float(role == own) for own in roles] for role in wanted])  # it is of that form already
    T = to_direct(components, geometry)
    back = to_direct(FORMS[form], geometry)
    if T is None or back is None:
        raise ValueError(
            f"{', '.join(components)} cannot become {', '.join(FORMS[form])} without the distances of the gauges; "
            f"calibrate with {argument('Schedule.geometry')}"
        )
    return np.asarray(np.linalg.solve(back, T))
