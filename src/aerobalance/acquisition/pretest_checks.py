"""Checks of a balance and its channels before a run: shunt calibration, and whether the loads return to zero.

Both compare the mean readings before and after something was done. A shunt resistor across one arm of a bridge makes
a known change of its output, through cables, amplifier and converter alike; a model that was pushed by hand and let go
must read as before, unless it touches its support or something in the balance gives. Readings of a model that hangs
free are no white noise, it sways; so the standard uncertainty of a mean comes from the means of a few spans of the
readings, each much longer than that [Flegal2010]_, by Student's t for their number.

Judged is with the uncertainty: passed and failed each need it to lie on one side of the tolerance whole (JCGM 106);
else the readings do not tell, and a longer mean would.

.. [Flegal2010] J. M. Flegal, G. L. Jones, Batch means and spectral variance estimators in Markov chain Monte Carlo,
   Annals of Statistics 38 (2010) 1034, https://doi.org/10.1214/09-AOS735
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from aerobalance.recording.channel import Array

Verdict = Literal["passed", "failed", "undecided"]

COVERAGE: Final = 0.95
"""Probability that the expanded uncertainty stands for."""

SHUNT_TOLERANCE: Final = 0.005
"""Largest departure of a shunt's change from the one expected, over it, where none is given."""

RETURN_TOLERANCE: Final = 0.001
"""Largest departure from zero after a release, over half of the range, where none is given."""


class Change(NamedTuple):
    """A change of a mean reading: `value`, and its expanded uncertainty (95 %), in the unit of the readings."""

    value: float
    expanded: float


@dataclass(frozen=True, slots=True)
class Checked:
    """How a channel has done in a check; all in the channel's unit.

    Attributes
    ----------
    channel
        Its name.
    change
        What its mean reading changed by.
    expected
        What it should have changed by.
    tolerance
        Largest departure from that.
    expanded
        Expanded uncertainty of the departure (95 %), that of `expected` included.
    """

    channel: str
    change: float
    expected: float
    tolerance: float
    expanded: float

    @property
    def departure(self) -> float:
        """Change less the one expected."""
        return self.change - self.expected

    @property
    def verdict(self) -> Verdict:
        """``passed``, ``failed``, or ``undecided`` where the readings are too noisy to tell."""
        size = abs(self.departure)
        if size + self.expanded <= self.tolerance:
            return "passed"
        return "failed" if size - self.expanded > self.tolerance else "undecided"


def shunt_output(bridge_resistance: float, *, shunt_resistance: float) -> float:
    """Change of a bridge's output by a resistor across one of its four equal arms [mV/V].

    With arms R and a shunt S, that arm becomes R S / (R + S), and the output changes by R / (4 S + 2 R) of the
    excitation, exactly: 0.25 R / S and a little less.

    Parameters
    ----------
    bridge_resistance
        R [ohm].
    shunt_resistance
        S [ohm].

    Raises
    ------
    ValueError
        One is not above zero.
    """
    for name, value in (("bridge_resistance", bridge_resistance), ("shunt_resistance", shunt_resistance)):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be above zero, not {value:g} ohm")
    return 1e3 * bridge_resistance / (4 * shunt_resistance + 2 * bridge_resistance)


def mean_change(before: Array, after: Array) -> Change:
    """Change of a mean reading, from means over spans of equal length.

    Parameters
    ----------
    before, after
        Means over spans that follow each other, shape (m,) each, two at least that are known.

    Raises
    ------
    ValueError
        There are fewer.
    """
    sides = [np.asarray(side, dtype=np.float64) for side in (before, after)]
    sides = [side[np.isfinite(side)] for side in sides]
    if min(side.size for side in sides) < 2:
        raise ValueError("a mean change needs the means of two spans at least, before and after")
    from scipy.special import stdtrit  # noqa: PLC0415 - the tolerances here are wanted where nothing is checked

    # the spread of the spans is taken for the same before and after: more degrees of freedom
    freedom = sum(side.size - 1 for side in sides)
    spread = sum(float(((side - side.mean()) ** 2).sum()) for side in sides) / freedom
    standard = math.sqrt(spread * sum(1 / side.size for side in sides))
    factor = float(stdtrit(freedom, (1 + COVERAGE) / 2))
    return Change(float(sides[1].mean() - sides[0].mean()), factor * standard)


def check_shunt(
    channel: str,
    change: Change,
    *,
    expected: float,
    relative_uncertainty: float = 0.0,
    tolerance: float = SHUNT_TOLERANCE,
) -> Checked:
    """Compare the change that a shunt made with the one expected.

    Parameters
    ----------
    channel
        Name of the channel.
    change
        See `mean_change`.
    expected
        Change at the calibration of the balance, or that of the resistor (`shunt_output`), in the same unit.
    relative_uncertainty
        Standard uncertainty of `expected` over it.
    tolerance
        Largest departure over `expected`.

    Raises
    ------
    ValueError
        Nothing is expected.
    """
    if not (math.isfinite(expected) and expected):
        raise ValueError(f"the change of {channel} that the shunt should make must be given, and not be zero")
    # 1.96: the normal factor of 95 %
    own = 1.96 * relative_uncertainty * abs(expected)
    return Checked(channel, change.value, expected, tolerance * abs(expected), math.hypot(change.expanded, own))


def check_return(channel: str, change: Change, *, half_range: float, tolerance: float = RETURN_TOLERANCE) -> Checked:
    """Return whether a load has returned to what it was before the model was pushed and let go.

    Contact with the support, a cable across the balance or a loose joint hold it off by friction.

    Parameters
    ----------
    channel
        Name of the load.
    change
        See `mean_change`.
    half_range
        Half of the range of the load, in the same unit.
    tolerance
        Largest departure from zero over `half_range`.

    Raises
    ------
    ValueError
        The range is not above zero.
    """
    if not (math.isfinite(half_range) and half_range > 0):
        raise ValueError(f"half of the range of {channel} must be above zero, not {half_range:g}")
    return Checked(channel, change.value, 0.0, tolerance * half_range, change.expanded)
