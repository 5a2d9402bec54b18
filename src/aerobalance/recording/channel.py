"""Channels by name: the quantities that the program understands, and what is known about their sensors."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.components import AXIS_VECTORS, COMPONENTS, ENDINGS, MOMENTS, is_gauge, si_unit

Array = NDArray[np.float64]

Coupling = Literal["kinematic", "dc", "ac"]

QUANTITIES: Final[Mapping[str, str]] = {
    **{name: si_unit(name) for name in COMPONENTS},
    **{f"r{name}": "mV/V" for name in COMPONENTS},
    **{f"{end}_acceleration{axis}": "m/s^2" for end in ("ground", "live") for axis in ENDINGS.values()},
    **{f"ground_turn_{name}": "rad/s^2" for name in MOMENTS},
    **{f"ground_turn_rate_{name}": "rad/s" for name in MOMENTS},
    "pitch": "rad",
    "roll": "rad",
    "impact_force": "N",
    "excitation": "V",
    "temperature": "degC",
}
"""The channel names that the program understands, and the unit that each has inside.

Beside the gauge outputs listed, ``r`` and any component as the balance names it is one (rN1, rAft_Pitch): in mV/V, or
in V until `aerobalance.balance.bridge_outputs.gauge_outputs` has divided it by the excitation. ``ground_turn_PM`` and
its like are angular accelerations of the ground end, positive as the moment of that name turns: nose up, nose right,
right side down; ``ground_turn_rate_PM`` and its like are their integrals. ``ground_acceleration_`` with any other
ending is an accelerometer on the ground end whose channel says where it sits and which way it looks.
``impact_force`` is the measured force of a hammer or shaker on the model, whose channel may say where and which way.
"""

AXES_BY_NAME: Final[Mapping[str, tuple[float, float, float]]] = {
    f"ground_acceleration{ending}": AXIS_VECTORS[axis] for axis, ending in ENDINGS.items()
}
"""Axes of the accelerometers whose names tell them."""

_GROUND_ACCELERATION: Final = re.compile(r"ground_acceleration(_\w+)?")


def is_ground_acceleration(name: str) -> bool:
    """Return whether a channel name is that of an accelerometer on the ground end."""
    return _GROUND_ACCELERATION.fullmatch(name) is not None


IMPACT_FORCE: Final = "impact_force"
"""Name of the channel of a measured force on the model, of a hammer or a shaker."""


def is_mounted(name: str) -> bool:
    """Return whether a channel of this name has a place and an axis: an accelerometer there, or a measured force."""
    return is_ground_acceleration(name) or name == IMPACT_FORCE


def unit_inside(name: str) -> str | None:
    """Unit that a channel of this name has inside; None where any will do (see `is_gauge` for gauges)."""
    return "m/s^2" if is_ground_acceleration(name) else QUANTITIES.get(name)


SYMMETRIC: Final = 1e-3
"""Difference of the sizes of two limits over the range between them up to which they are one."""


@dataclass(frozen=True, slots=True)
class CrossAxis:
    """What an accelerometer reads of an acceleration across its axis.

    Attributes
    ----------
    channel
        Name of the channel of that acceleration.
    sensitivity
        Reading over that acceleration [1].
    uncertainty
        Its standard uncertainty [1].
    """

    channel: str
    sensitivity: float
    uncertainty: float = 0.0

    def __post_init__(self) -> None:
        if not abs(self.sensitivity) < 1 or not 0 <= self.uncertainty < 1:
            raise ValueError(
                f"the sensitivity to {self.channel} must lie between -1 and 1 and its uncertainty between 0 and 1, "
                f"not {self.sensitivity:g} and {self.uncertainty:g}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSpec:
    """What is known of a sensor: of its readings, and of what it does to the quantity.

    Everything that describes how a quantity was measured extends this, so that a new fact has one place.

    Attributes
    ----------
    noise
        Standard uncertainty of one reading [unit of the readings]; None when it is to be estimated from the record.
    relative_uncertainty
        Standard uncertainty of the gain, relative [1].
    zero_uncertainty
        Standard uncertainty of the zero [unit of the readings].
    delay
        Time by which the readings lag the clock [s].
    coupling
        What an accelerometer reads: ``"kinematic"`` the acceleration of its place, ``"dc"`` specific force
        (x'' - g sin(pitch)), ``"ac"`` the acceleration above a high-pass corner.
    corner
        High-pass corner of an ac-coupled sensor [Hz]; 0 for the others.
    filter
        Analog low-pass before the sampling, still in the readings; None where there is none.
    cross_axis
        What an accelerometer reads of other accelerations, still in the readings.
    place
        Where an accelerometer on the ground end sits, or a measured force acts, from the balance's centre aft, right
        and up [m]; None where it is not given.
    axis
        Unit vector along which it reads positive: its shares aft, right and up; None where its name tells it. Of a
        measured force, the direction in which it pushes the model.
    place_uncertainty
        Standard uncertainty of every coordinate of `place` [m].
    """

    noise: float | None = None
    relative_uncertainty: float = 0.0
    zero_uncertainty: float = 0.0
    delay: float = 0.0
    coupling: Coupling = "kinematic"
    corner: float = 0.0
    filter: AntiAlias | None = None
    cross_axis: tuple[CrossAxis, ...] = ()
    place: tuple[float, float, float] | None = None
    axis: tuple[float, float, float] | None = None
    place_uncertainty: float = 0.0

    def known(self, *, factor: float = 1.0) -> dict[str, Any]:
        """Return all of this by name, for readings in another unit.

        Parameters
        ----------
        factor
            Size of a reading's number in that unit over its number in this one, positive.
        """
        found = {name: getattr(self, name) for name in SENSOR_FIELDS}
        found["noise"] = None if self.noise is None else self.noise * factor
        return found | {"zero_uncertainty": self.zero_uncertainty * factor}


SENSOR_FIELDS: Final = tuple(field.name for field in fields(SensorSpec))
"""Names of what is known of a sensor."""


@dataclass(frozen=True, slots=True, eq=False)
class Channel(SensorSpec):
    """One measured quantity over time, and what is known of its sensor.

    Attributes
    ----------
    name
        One of `QUANTITIES`, or any other name for a quantity the program only passes on.
    values
        Readings on the recording's clock, shape (n,), in `unit`; NaN where a sample is missing.
    unit
        Unit of `values`.
    file_unit
        Unit in the channel's file, in which results are written again; an empty string where there is no file.
    """

    name: str
    values: Array
    unit: str
    file_unit: str = field(default="", kw_only=True)

    def __repr__(self) -> str:
        return f"{self.name} [{self.unit}]: {self.values.size} readings, {np.count_nonzero(self.missing)} missing"

    def __post_init__(self) -> None:
        expected = ("mV/V", "V") if is_gauge(self.name) else (unit_inside(self.name) or self.unit,)
        if self.unit not in expected:
            raise ValueError(f"channel {self.name} must be in {' or '.join(expected)} inside, not {self.unit}")
        if self.values.ndim != 1:
            raise ValueError(f"channel {self.name} must have shape (n,), not {self.values.shape}")
        if self.noise is not None and not self.noise >= 0:
            raise ValueError(f"channel {self.name}: noise must be zero or more, not {self.noise}")
        if not self.zero_uncertainty >= 0:
            raise ValueError(
                f"channel {self.name}: zero_uncertainty must be zero or more, not {self.zero_uncertainty}"
            )
        self._check_mounting()
        fixed = self.values.view()
        fixed.setflags(write=False)  # on a view, so that the caller's own array stays as it was
        object.__setattr__(self, "values", fixed)

    def _check_mounting(self) -> None:
        """Refuse a place or an axis that no accelerometer on the ground end, and no measured force, can have."""
        if (self.place, self.axis, self.place_uncertainty) == (None, None, 0.0):
            return
        if not is_mounted(self.name):
            raise ValueError(
                f"channel {self.name}: place and axis are for ground_acceleration and its like, and for {IMPACT_FORCE}"
            )
        if self.place is not None and (len(self.place) != 3 or not np.isfinite(self.place).all()):
            raise ValueError(f"channel {self.name}: place must be three numbers [m], aft, right, up, not {self.place}")
        if not 0 <= self.place_uncertainty < np.inf:
            raise ValueError(
                f"channel {self.name}: place_uncertainty must be zero or more, not {self.place_uncertainty}"
            )
        if self.axis is not None and (len(self.axis) != 3 or not abs(np.linalg.norm(self.axis) - 1) < 1e-3):
            raise ValueError(f"channel {self.name}: axis must be a vector aft, right, up of length 1, not {self.axis}")

    @property
    def missing(self) -> NDArray[np.bool_]:
        """True where a sample is missing, shape (n,)."""
        return ~np.isfinite(self.values)

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """True where the reading rests on a limit that it met more than once at speed, shape (n,).

        A plateau is no saturation: a run of equal readings at the highest or lowest value counts where the
        readings on both sides of it, continued, would have gone well past the limit, and where that happens at
        least twice, on either side together where the limits lie symmetrically about zero. A single clipped peak
        cannot be told from a plateau and is not found. A stated uncertainty (``u_AF``) is no reading, and rests on no
        limit.
        """
        if self.name.startswith("u_") and self.name[2:] in COMPONENTS:
            return np.zeros(self.values.shape, dtype=bool)
        nothing = np.zeros(self.values.shape, dtype=bool)
        if not (self.values[1:] == self.values[:-1]).any():  # no run of equal readings, wherever it were
            return nothing
        sides = [_clipped(self.values, sign) for sign in (1.0, -1.0)]
        events = [count for _, count in sides]
        if not any(events):  # as in most records: whether the ends are symmetric need not be looked at
            return nothing
        if self._has_symmetric_ends:
            events = [sum(events)] * 2
        upper, lower = (flags if count >= 2 else nothing for (flags, _), count in zip(sides, events, strict=True))
        return upper | lower

    @property
    def _has_symmetric_ends(self) -> bool:
        """Whether the highest and the lowest reading are one number with two signs, as the ends of a range are."""
        finite = self.values[np.isfinite(self.values)]
        if not finite.size:
            return False
        highest, lowest = float(finite.max()), float(finite.min())
        return abs(highest + lowest) <= SYMMETRIC * (highest - lowest)

    @property
    def at_limit(self) -> NDArray[np.bool_]:
        """True where the reading is at a limit that it rests on somewhere in the record, shape (n,).

        Once a limit is known, a single reading there is as little worth as a run of them.
        """
        rests = self.saturated
        if not rests.any():
            return rests
        limits = np.unique(self.values[rests])
        if self._has_symmetric_ends:  # the other end of the range, though no run rests on it
            limits = np.array([np.nanmin(self.values), np.nanmax(self.values)])
        return np.isin(self.values, limits)


def _clipped(values: Array, sign: float) -> tuple[NDArray[np.bool_], int]:
    """Runs of equal readings at the highest (sign 1) or lowest (-1) value that would have gone past it, and how many.

    One such run alone may be a plateau.
    """
    flags = np.zeros(values.shape, dtype=bool)
    if not values.size:
        return flags, 0
    known, finite = values, None
    end = values.max() if sign > 0 else values.min()
    if not np.isfinite(end):  # something is missing
        finite = np.isfinite(values)
        if not finite.any():
            return flags, 0
        known = values[finite]
        end = known.max() if sign > 0 else known.min()
    at = np.flatnonzero(values == end)
    if not (np.diff(at) == 1).any():  # as in most records: no run
        return flags, 0
    finite = np.isfinite(values) if finite is None else finite
    signal = np.where(finite, sign * values, np.nan)
    limit = np.max(signal[finite])
    spread = limit - np.min(signal[finite])
    edges = np.diff(np.concatenate(([0], (signal == limit).astype(np.int8), [0])))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    inside = (last > first) & (first > 1) & (last < values.size - 2)
    first, last = first[inside], last[inside]
    levels = np.unique(values[finite]) if first.size else values[:1]
    if levels.size < 2:
        return flags, 0
    resolution = float(np.min(np.diff(levels)))
    inner = (signal[first - 1] + signal[last + 1]) / 2
    outer = (signal[first - 2] + signal[last + 2]) / 2
    half = (last - first + 2) / 2
    # A parabola through the two readings on either side, at the middle of the run.
    overshoot = inner + (inner - outer) * half**2 / (2 * half + 1) - limit
    # A quantised peak rests on its top level by itself; a ramp to a long plateau would have overshot the whole range.
    moving = (overshoot > (2 + half) * resolution) & (overshoot > 1e-3 * spread) & (overshoot < spread)
    for start, stop in zip(first, last, strict=True):
        flags[start : stop + 1] = True
    return flags, int(np.count_nonzero(moving))
