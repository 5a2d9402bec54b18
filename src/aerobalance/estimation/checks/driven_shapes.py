"""Modes of coupled components that have moved, one at a time, by their response to the ground's motion.

The motion puts a known force on the moving mass, and the balance answers in its modes. Where one is elsewhere, what
the expected modes leave of the motion goes with it: no load of the flow does, so that a narrow band of the load needs
no thought here. A channel of the motion with another gain leaves something as well, which no mode takes away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.checks.moved_dynamics import Moved
from aerobalance.estimation.checks.moved_modes import SETTINGS as MOVED
from aerobalance.estimation.checks.moved_modes import OtherShapes, closer, evidence_of
from aerobalance.estimation.checks.ringing import RingingSpectra
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True)
class DrivenShapeSettings:
    """What is tried, and from which evidence on it is believed.

    Attributes
    ----------
    shifts
        Changes of the logarithm of a mode's frequency that are tried, up and down.
    dampings
        Factors of its damping ratio that are tried.
    least
        Gain in log-likelihood that the move of each mode must bring: its two numbers have it by chance once in 20 000,
        of six modes.
    decisive
        Gain from which moved modes are believed.
    """

    shifts: tuple[float, ...] = (0.005, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.12, 0.2)
    dampings: tuple[float, ...] = (0.4, 2.5)
    least: float = 10.0
    decisive: float = 15.0


SETTINGS: Final = DrivenShapeSettings()
"""Settings that are used."""


def moved_by_motion(ringing: RingingSpectra, dynamics: CoupledDynamics) -> OtherShapes | None:
    """Return the modes that have moved, where with them nothing is left of the ground's motion; or None.

    Parameters
    ----------
    ringing
        The spectra of the record.
    dynamics
        The dynamics that it was read with.
    """
    if dynamics.internal or len(dynamics.modes) != len(dynamics.components) or not ringing.shows_motion(ringing.own):
        return None
    found, gained, modes = Moved.none(dynamics), 0.0, set(range(len(dynamics.modes)))
    tried = [(sign * size, 0.0) for size in SETTINGS.shifts for sign in (-1, 1)]
    tried += [(0.0, float(np.log(factor))) for factor in SETTINGS.dampings]

    def evidence(moved: Moved) -> Array:
        return evidence_of(ringing, moved)

    while modes and ringing.shows_motion(found.rows):
        known = float(np.sum(evidence(found)))
        # below a mode and above it the motion tells of it as well: all bands are asked
        others = [(place, found.by(place, np.array(change))) for place in sorted(modes) for change in tried]
        gains = [float(np.sum(evidence(one))) - known for _, one in others]
        if max(gains) < SETTINGS.least:
            return None
        place, first = others[int(np.argmax(gains))]
        found = closer(evidence, found, place, first)
        gained += float(np.sum(evidence(found))) - known
        modes.remove(place)
    if gained < SETTINGS.decisive or ringing.shows_motion(found.rows) or not found.ringing.all():
        return None
    frequency, damping = np.max(np.abs(found.changes), axis=0)
    kind = "natural frequency" if frequency > MOVED.told or damping < MOVED.told_damping else "damping ratio"
    return OtherShapes(kind, (), found.rows, gained, found)
