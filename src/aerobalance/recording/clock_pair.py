"""How two clocks go by each other, and what two recordings of one event have in common to tell it by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording

Way = Literal["auto", "tick", "trigger", "correlation", "start"]
"""How two clocks are compared."""

WAYS: Final = get_args(Way)

LARGEST_DRIFT: Final = 1e-3
"""Difference of two clocks that no quartz has, by far [1]."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """How the clock of one recording goes by that of another.

    A time s of its own is ``s + offset + drift * (s - start)`` on the other clock.

    Attributes
    ----------
    name
        The recording.
    way
        How it was found.
    by
        The channel that it was found by; an empty string for dates.
    offset, u_offset
        At its first sample, and standard uncertainty [s]; NaN where that is not known.
    drift, u_drift
        Rate of the offset's change, and standard uncertainty [1]; NaN where it cannot be known, and the drift is then
        taken as 0.
    start
        Its first sample on its own clock [s].
    points
        Edges, counts or samples that it was found from.
    """

    name: str
    way: Way
    by: str
    offset: float
    u_offset: float
    drift: float
    u_drift: float
    start: float
    points: int

    def onto(self, times: Array) -> Array:
        """Times of its own on the other clock [s]."""
        return times + self.offset + self.drift * (times - self.start)

    def back(self, times: Array) -> Array:
        """Times of the other clock on its own [s]."""
        begin = self.start + self.offset
        return self.start + (times - begin) / (1 + self.drift)

    def told(self) -> str:
        """What was found, in a sentence."""
        by = f" of {self.by}" if self.by else " (dates of the files)"
        u = (
            f", u = {self.u_offset:.2g} s"
            if np.isfinite(self.u_offset)
            else ", as good as the clocks of the computers"
        )
        drift = (
            f"its clock is {'slow' if self.drift > 0 else 'fast'} by {1e6 * abs(self.drift):.3f} ppm, "
            f"u = {1e6 * self.u_drift:.2g} ppm"
            if np.isfinite(self.u_drift)
            else "a drift of its clock cannot be seen and is taken as none"
        )
        return f"{self.name} is aligned by {self.way}{by}: offset {self.offset:.9g} s{u}; {drift}"


@dataclass(frozen=True, slots=True)
class Pair:
    """Two recordings, and the channel that both have."""

    base: Recording
    other: Recording
    by: str
    one: Channel
    two: Channel

    @property
    def lag(self) -> float:
        """What the channels' own delays add to the offset [s]."""
        return self.two.delay - self.one.delay

    def found(self, way: Way, line: ClockLine, points: int) -> Alignment:
        """The alignment by a straight line of base times over other times."""
        if not abs(line.slope - 1) < LARGEST_DRIFT:
            raise FitError(
                f"by {way} of {self.by}, the clock of {self.base.name} runs {line.slope:.6g} times as fast as that "
                f"of {self.other.name}, which no two clocks differ by: {self.by} is not the same in both"
            )
        start = self.other.start
        return Alignment(
            self.other.name,
            way,
            self.by,
            line.at(start) - start + self.lag,
            line.u_at(start),
            line.slope - 1,
            line.u_slope,
            start,
            points,
        )


@dataclass(frozen=True, slots=True)
class ClockLine:
    """A straight line through points, about their middle."""

    middle: float
    level: float
    slope: float
    u_level: float
    u_slope: float

    def at(self, place: float) -> float:
        """Return its value at a place."""
        return self.level + self.slope * (place - self.middle)

    def u_at(self, place: float) -> float:
        """Return the standard uncertainty of that."""
        far = 0.0 if np.isnan(self.u_slope) else self.u_slope * (place - self.middle)
        return float(np.hypot(self.u_level, far))


def fitted_line(x: Array, y: Array, *, least: float) -> ClockLine:
    """Fit a line; `least` is the standard deviation of a point that there is at least."""
    middle = float(x.mean())
    if x.size < 2:
        return ClockLine(middle, float(y[0]), 1.0, least, float("nan"))
    far = x - middle
    level, slope = float(y.mean()), float(far @ (y - x) / (far @ far)) + 1.0
    left = y - level - slope * far
    scatter = max(least, float(np.sqrt(left @ left / max(x.size - 2, 1))))
    return ClockLine(middle, level, slope, scatter / np.sqrt(x.size), scatter / float(np.sqrt(far @ far)))
