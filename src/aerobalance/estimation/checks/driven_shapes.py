"""Modes of coupled components that have moved, one at a time, by their response to the ground's motion.

The motion puts a known force on the moving mass, and the balance answers in its modes. Where one is elsewhere, what
the expected modes leave of the motion goes with it: no load of the flow does, so that a narrow band of the load needs
no thought here. A channel of the motion with another gain leaves something as well, which no mode takes away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.checks.moved_dynamics import Moved
from aerobalance.estimation.checks.moved_modes import OtherShapes, closer, evidence_of
from aerobalance.estimation.checks.ringing import RingingSpectra
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.motion.changes import MotionChanges
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import kept_warnings
from aerobalance.recording.resampling import interpolate_gaps_linearly


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
        and one of six modes that begin at twenty places once in 200 at most.
    decisive
        Gain from which moved modes are believed.
    over_channel
        Gain over that of the likeliest gain and delay of one channel from which they are: 3000 to 1.
    rounds
        Rounds by which gain and delay of a channel are found.
    """

    shifts: tuple[float, ...] = (0.005, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.12, 0.2)
    dampings: tuple[float, ...] = (0.4, 2.5)
    least: float = 10.0
    decisive: float = 15.0
    over_channel: float = 8.0
    rounds: int = 8


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
    if not dynamics.has_one_mode_each or not ringing.shows_motion(ringing.own):
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
    return OtherShapes.of_moved(found, gained)


def beats_channels(ringing: RingingSpectra, record: CoupledRecord, other: OtherShapes, *, within: slice) -> bool:
    """Return whether moved modes explain clearly more than another gain and a delay of any channel of the motion.

    Parameters
    ----------
    ringing
        The spectra of the record.
    record, within
        The record, and which of its samples they are of.
    other
        The moved modes.
    """
    if record.dynamics.mass is None:
        return True
    own = ringing.own
    found = float(np.sum(ringing.evidence(other.rows)))
    with kept_warnings():  # they were given when the force was estimated
        changes = MotionChanges.of(record.recording)
    for name in changes.channels:
        values = interpolate_gaps_linearly(record.recording.channel(name).values)
        if not np.isfinite(values).all() or not np.ptp(values):
            continue
        felt = -changes.specific_force(name, values - values.mean()) @ record.dynamics.mass_rows.T
        lines = ringing.lines_of(felt[within], interval=record.interval)
        by_channel = float(np.sum(_with_channel(ringing, lines).evidence(own)))
        if found - by_channel < SETTINGS.over_channel:
            return False
    return True


def _with_channel(ringing: RingingSpectra, lines: NDArray[np.complex128]) -> RingingSpectra:
    """The same with the likeliest gain and delay of a channel whose forces have lines of shape (n, m).

    Least squares, weighted by the levels in bands of what is left: with these the likelihood rises in every round.
    """
    shapes = np.stack([lines, 2j * np.pi * ringing.frequency * lines])
    widths = np.diff(np.append(ringing.bands, ringing.frequency.size))
    forces, sizes = ringing.readings(ringing.own), np.zeros(2)
    for _ in range(SETTINGS.rounds):
        left = forces - np.tensordot(sizes, shapes, axes=1)
        level = np.add.reduceat(np.abs(left) ** 2 / ringing.gain, ringing.bands, axis=1) / widths
        weight = ringing.shown / (ringing.gain * np.repeat(np.maximum(level, 1e-300), widths, axis=1))
        products = np.einsum("aim,bim,im->ab", shapes.conj(), shapes, weight, optimize=True).real
        moments = np.einsum("aim,im,im->a", shapes.conj(), forces, weight, optimize=True).real
        sizes = np.linalg.lstsq(products, moments)[0]
    return ringing.with_motion(np.asarray(np.tensordot(sizes, shapes, axes=1), dtype=np.complex128))
