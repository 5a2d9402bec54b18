"""What a channel map and a test set-up both say of a channel."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from aerobalance.io.measure import LARGEST
from aerobalance.recording.channel import (
    AXES_BY_NAME,
    IMPACT_FORCE,
    SENSOR_FIELDS,
    Coupling,
    SensorSpec,
    is_mounted,
    unit_inside,
)
from aerobalance.recording.components import AXIS_VECTORS

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
NotBelow = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]


class Strict(BaseModel):
    """A table in which nothing is unknown, and numbers are numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class ChannelSettings(Strict):
    """How readings become a channel's values, and what is known of its sensor.

    A value is ``sign * (scale * reading + offset)`` in `unit`. An accelerometer on the ground end has a `place` from
    the balance's centre [m] and an `axis`, both aft, right and up; text of three numbers is taken for either. So has
    a measured force on the model.
    """

    unit: str | None = None
    scale: Number = 1.0
    offset: Number = 0.0
    sign: Literal[1, -1] = 1
    delay: Number = 0.0
    noise: NotBelow | None = None
    relative_uncertainty: NotBelow = 0.0
    zero_uncertainty: NotBelow = 0.0
    coupling: Coupling = "kinematic"
    corner: NotBelow = 0.0
    place: tuple[Number, Number, Number] | None = None
    place_uncertainty: NotBelow = 0.0
    axis: tuple[Number, Number, Number] | None = None

    @field_validator("scale")
    @classmethod
    def _not_zero(cls, given: float) -> float:
        if given == 0:
            raise ValueError("must not be zero: every reading would become the same number; leave the channel out")
        return given

    @field_validator("place", "axis", mode="before")
    @classmethod
    def _three_numbers(cls, given: object, info: ValidationInfo) -> object:
        """Take a list or text for three numbers, and the name of a direction for an axis."""
        axis = info.field_name == "axis"
        if axis and isinstance(given, str) and given in AXIS_VECTORS:
            return AXIS_VECTORS[given]
        numbers = _numbers(given)
        if numbers is None and axis and isinstance(given, str):
            raise ValueError(f"must be one of {', '.join(AXIS_VECTORS)}, or [aft, right, up] of length 1")
        if numbers is None:
            raise ValueError("must be three numbers [aft, right, up]" + ("" if axis else " in m"))
        if axis and abs(float(np.linalg.norm(numbers)) - 1) > 1e-3:
            raise ValueError("must be of length 1, the shares of the direction aft, right and up")
        return numbers

    def sensor(self) -> SensorSpec:
        """Return what these settings say of the sensor, in their unit."""
        return SensorSpec(
            **{name: getattr(self, name) for name in SENSOR_FIELDS if name in ChannelSettings.model_fields}
        )

    def fault(self, name: str) -> tuple[str, str] | None:
        """Return what a channel of this name cannot have: the key, or an empty string for several, and the reason."""
        if (self.corner > 0) != (self.coupling == "ac"):
            return "corner", 'corner [Hz] goes with coupling = "ac" (then above 0 Hz) and with no other'
        if self.coupling != "kinematic" and unit_inside(name) != "m/s^2":
            return "", "coupling is for accelerations, such as ground_acceleration"
        if not is_mounted(name):
            bare = (self.place, self.axis, self.place_uncertainty) == (None, None, 0.0)
            allowed = f"accelerometers on the ground end, ground_acceleration*, and for {IMPACT_FORCE}"
            return None if bare else ("", f"place and axis are for {allowed}")
        if self.axis is None and name not in AXES_BY_NAME and name != IMPACT_FORCE:
            known = ", ".join(AXIS_VECTORS)
            return "axis", f"is needed: the name says no direction; {known} or [aft, right, up]"
        if self.place is None and self.place_uncertainty:
            return "place_uncertainty", "goes with a place"
        return None


def _numbers(given: object) -> tuple[float, ...] | None:
    """Three numbers of a list or of text with commas; None where it is neither."""
    parts = given.split(",") if isinstance(given, str) else given
    if not isinstance(parts, list | tuple) or len(parts) != 3 or any(isinstance(part, bool) for part in parts):
        return None
    if not isinstance(given, str) and not all(isinstance(part, int | float) for part in parts):
        return None
    try:
        return tuple(float(part) for part in parts)
    except (ValueError, OverflowError):
        return None
