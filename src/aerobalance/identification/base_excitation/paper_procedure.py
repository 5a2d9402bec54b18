"""The paper's own procedures on a vibration rig, kept as reference methods: one line for f0, one for b.

Phases are those of the extension (of AF) against the ground acceleration, as the derivation of Eqs. (13) to (16) has
them. The paper's text takes the phase between the two accelerometers instead, that of the absolute motion of the live
end: it differs by atan(b w / k). `phase="absolute"` does so, to document the difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from aerobalance.identification.base_excitation.sine_dwell import Dwell, amplitudes
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

Phase = Literal["relative", "absolute"]


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceFit:
    """What the paper's procedures give.

    Attributes
    ----------
    frequency
        Frequencies of the dwells [Hz], shape (n,).
    natural_frequencies, dampings
        f0 [Hz] by Eq. (13) and b [N*s/m] by Eq. (14) from each dwell alone, shape (n,); NaN where they have none.
    line_15, line_16
        Abscissa and ordinate of the lines of Eqs. (15) and (16), shape (n, 2) each.
    natural_frequency, u_natural_frequency
        f0 from the slope of Eq. (15) and its standard uncertainty from the scatter about the line [Hz].
    stiffness
        k = M (2 pi f0)^2 [N/m].
    damping, u_damping
        b from the slope of Eq. (16) and its standard uncertainty from the scatter about the line [N*s/m].
    """

    frequency: Array
    natural_frequencies: Array
    dampings: Array
    line_15: Array
    line_16: Array
    natural_frequency: float
    u_natural_frequency: float
    stiffness: float
    damping: float
    u_damping: float


def reference_fit(dwells: tuple[Dwell, ...], *, mass: float, phase: Phase = "relative") -> ReferenceFit:
    """Find f0 and b as the paper does: the slopes of Eqs. (15) and (16) of [Gorbushin2020]_.

    Parameters
    ----------
    dwells
        Dwells of a stepped-sine record.
    mass
        Moving mass M [kg].
    phase
        ``"relative"`` for the phase of AF against the ground acceleration (right), ``"absolute"`` for that of the
        live accelerometer against the ground's (as the text has it).

    Returns
    -------
    ReferenceFit

    Raises
    ------
    FitError
        There are fewer than two dwells, the live accelerometer is missing, or a slope is negative.
    """
    if phase not in ("relative", "absolute"):
        raise ValueError(f"phase must be relative or absolute, not {phase!r}")
    if not mass > 0:
        raise ValueError(f"mass must be positive, not {mass}")
    if len(dwells) < 2:
        raise FitError(f"{len(dwells)} dwell(s) are too few for a line; hold at least two frequencies")
    frequency, load, ground, live = amplitudes(dwells)
    if phase == "absolute" and not np.isfinite(live).all():
        raise FitError("the phase between the accelerometers needs a live accelerometer in the recording")
    # x1 and x1'' are in opposite phase: the lag behind x1 is that of -AF behind x1''.
    lag = -np.angle(-load / ground) if phase == "relative" else -np.angle(live / ground)
    felt, pushed = np.abs(load), mass * np.abs(ground)
    w = 2 * np.pi * frequency
    line_15 = np.column_stack([1 - pushed * np.cos(lag) / felt, frequency**2])
    slope, u_slope = _slope(line_15, "Eq. (15)")
    f0 = float(np.sqrt(slope))
    w0 = 2 * np.pi * f0
    line_16 = np.column_stack([(w * felt / (mass * w0**2)) ** 2, pushed**2 - (1 - (w / w0) ** 2) ** 2 * felt**2])
    square, u_square = _slope(line_16, "Eq. (16)")
    damping = float(np.sqrt(square))
    alone, dampings = _each(w, felt, pushed, lag, mass=mass)
    return ReferenceFit(
        frequency=frequency,
        natural_frequencies=alone,
        dampings=dampings,
        line_15=line_15,
        line_16=line_16,
        natural_frequency=f0,
        u_natural_frequency=u_slope / (2 * f0),
        stiffness=mass * w0**2,
        damping=damping,
        u_damping=u_square / (2 * damping),
    )


def _each(w: Array, felt: Array, pushed: Array, lag: Array, *, mass: float) -> tuple[Array, Array]:
    """Find f0 by Eq. (13) [Hz] and b by Eq. (14) of [Gorbushin2020]_ [N*s/m] from every dwell alone."""
    rest = felt - pushed * np.cos(lag)
    with np.errstate(divide="ignore", invalid="ignore"):
        alone = np.where(rest > 0, w / (2 * np.pi) * np.sqrt(felt / rest), np.nan)
        dampings = np.where(rest > 0, w * mass * pushed * np.sin(lag) / rest, np.nan)
    return alone, dampings


def _slope(line: Array, equation: str) -> tuple[float, float]:
    """Slope of the least-squares line through the origin, and its standard uncertainty from the scatter."""
    x, y = line.T
    slope = float(x @ y / (x @ x))
    if not slope > 0:
        raise FitError(
            f"the line of {equation} has the slope {slope:.3g}, which must be positive; the dwells lie too far from "
            "the natural frequency, or the phases are wrong (sign of a channel, delay)"
        )
    scatter = float(np.sum((y - slope * x) ** 2)) / (x.size - 1)
    return slope, float(np.sqrt(scatter / (x @ x)))
