"""The zero of a run as loads of the balance: how it moves from zero to zero along a test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aerobalance.balance.loads import Loads


@dataclass(frozen=True, slots=True)
class ZeroLevel:
    """The zero of a run as a load along one component: how it changes from zero to zero is what counts.

    Attributes
    ----------
    component
        Which.
    value, u
        What the outputs of the zero would be as a load, and its standard uncertainty [N, N*m].
    drift
        Change from the zero before the run to that after it [N, N*m].
    """

    component: str
    value: float
    u: float
    drift: float


def zero_levels(loads: Loads) -> tuple[ZeroLevel, ...]:
    """Return the zero that loads count from as a load along each component, by the matrix at no load [N, N*m].

    Parameters
    ----------
    loads
        Of gauge outputs.
    """
    zero, matrix = loads.zero, loads.balance
    slope = loads.transform @ matrix.sensitivity(np.zeros((1, len(matrix.components))))[0]
    rows = zip(
        loads.components, slope @ zero.values, np.hypot.reduce(slope * zero.u, axis=1), slope @ zero.drift, strict=True
    )
    return tuple(ZeroLevel(name, float(value), float(u), float(drift)) for name, value, u, drift in rows)
