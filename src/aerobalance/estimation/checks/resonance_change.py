"""What a record says of stiffness and damping: how far the resonances have moved from those of the dynamics.

The likelihood of the readings is compared for frequencies and damping ratios a little beside the known ones; its slope
and its curvature (in a short record its mean and its width) give the change and its standard uncertainty, run by run,
long before one record alone would be enough for a doubt (`aerobalance.estimation.checks`). With the mass unchanged,
stiffness goes with the square of the frequency, and damping with frequency times damping ratio.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.checks.evidence import SETTINGS as EVIDENCE
from aerobalance.estimation.checks.evidence import Evidence
from aerobalance.estimation.checks.moved_dynamics import Moved
from aerobalance.estimation.checks.ringing import RingingSpectra
from aerobalance.estimation.checks.split_loads import SplitLoads
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.result import ComponentForce
from aerobalance.recording.channel import Array

STEPS: Final = (0.5, 0.4)
"""Steps of the logarithms: of the frequency in units of the damping ratio, and of the damping ratio."""

TRIED: Final = (-2.0, -1.0, 0.0, 1.0, 2.0)
"""Changes of the frequency that are looked at first, in the same unit: the likelihood has a peak as wide as that."""

ROUNDS: Final = 2
"""Newton steps at most: the second where the first went farther than a step."""

MOST: Final = (4.0, 1.5)
"""Changes beyond which nothing is said, in the same units: a resonance that moved by more is a doubt of its own."""

CURVED: Final = 0.15
"""Standard uncertainty of the frequency, in the same unit, up to which it is that of the curvature: in shorter records
the likelihood is no parabola, and its curvature at the peak changes threefold from one to the next."""

NODES: Final = (9, 7)
"""Values of either logarithm that the likelihood is then averaged over."""

LEAST_APART: Final = (0.5, 0.35)
"""Distance of these values at least, in the same units; it is a standard uncertainty where that is more."""

FINE: Final = 0.6
"""Standard deviation over that distance from which the grid is fine enough: sum and integral are within 2 %."""

LEAST_TOLD: Final = (2.0, 1.5)
"""Standard uncertainties from which a record is said to tell nothing, in the same units."""

LEAST_NOISE: Final = 1e-3
"""Least noise of a reading over that stated."""


@dataclass(frozen=True, slots=True)
class ResonanceChange:
    """How far a resonance has moved from that of the dynamics.

    Attributes
    ----------
    name
        The component, or ``mode 1`` ... of coupled ones, by rising frequency.
    natural_frequency
        That of the dynamics [Hz].
    frequency, u_frequency
        Logarithm of the natural frequency over that, its relative change where it is small, whose mean over many runs
        is not biased, and its standard uncertainty [1]; None where the record does not tell.
    damping_ratio, u_damping_ratio
        The same of the damping ratio.
    """

    name: str
    natural_frequency: float
    frequency: float | None = None
    u_frequency: float | None = None
    damping_ratio: float | None = None
    u_damping_ratio: float | None = None

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """Relative change of the stiffness at the same mass and its standard uncertainty [1]."""
        if self.frequency is None or self.u_frequency is None:
            return None
        return 2 * self.frequency, 2 * self.u_frequency

    @property
    def damping(self) -> tuple[float, float] | None:
        """Relative change of the damping at the same mass and its standard uncertainty [1]."""
        if self.frequency is None or self.damping_ratio is None:
            return None
        return self.frequency + self.damping_ratio, float(
            np.hypot(self.u_frequency or 0.0, self.u_damping_ratio or 0.0)
        )


def resonance_changes(force: Force) -> tuple[ResonanceChange, ...]:
    """How far each resonance has moved from that of the dynamics, as logarithms [1] with standard uncertainties.

    Parameters
    ----------
    force
        Of a record that was worked out at once, by the smoother.
    """
    record = force.record
    if isinstance(record, CoupledRecord):
        return _coupled(force, record)
    records = record.component_records(force.filled)
    return tuple(_single(records[name], part) for name, part in force.items() if part.learned is not None)


def _single(record: ComponentRecord, part: ComponentForce) -> ResonanceChange:
    dynamics, interval, values = record.dynamics, record.interval, record.reading().filled
    still = ResonanceChange(dynamics.component, dynamics.natural_frequency)
    learned = part.learned
    if learned is None or dynamics.damping_ratio <= 0 or 2 * dynamics.natural_frequency * interval >= 1:
        return still
    values = values[: EVIDENCE.samples]
    white = None if learned.color is None else learned.noise**2 * interval

    def moved(change: Array) -> ModalModel:
        return dynamics.retuned(frequency=float(np.exp(change[0])), damping=float(np.exp(change[1])))

    evidence = Evidence(
        values - values.mean(),
        interval,
        (LEAST_NOISE * part.noise) ** 2 * interval,
        white,
        learned.color,
        learned.rising,
        tuple(moved(np.array([place * dynamics.damping_ratio, 0.0])) for place in TRIED),
    )

    def likelihood(change: Array) -> float:
        return evidence.nearly(moved(change), dynamics)

    return _told(still, dynamics.damping_ratio, likelihood)


def _coupled(force: Force, record: CoupledRecord) -> tuple[ResonanceChange, ...]:
    dynamics = record.dynamics
    modes = dynamics.modes
    still = tuple(ResonanceChange(f"mode {number}", mode.natural_frequency) for number, mode in enumerate(modes, 1))
    filled = force.filled
    if not dynamics.has_one_mode_each or not np.ptp(filled, axis=0).all():
        return still
    ringing = RingingSpectra.of(record, SplitLoads.of(record, filled), force.parts)
    if ringing is None:
        return still
    own = Moved.none(dynamics)
    found = []
    for place, one in enumerate(still):

        def likelihood(change: Array, place: int = place) -> float:
            return ringing.joint_evidence(own.by(place, change).rows)

        found.append(_told(one, modes[place].damping_ratio, likelihood))
    return tuple(found)


def _told(still: ResonanceChange, ratio: float, likelihood: Callable[[Array], float]) -> ResonanceChange:
    """Change and uncertainty by Newton's method on nine points about the likeliest of a few frequencies."""
    unit = np.array([ratio, 1.0])
    step = unit * STEPS
    try:
        tried = [likelihood(np.array([place * ratio, 0.0])) for place in TRIED]
        point = np.array([TRIED[int(np.argmax(tried))] * ratio, 0.0])
        for _ in range(ROUNDS):
            slope, bend = _stencil(likelihood, point, step)
            if not np.isfinite(bend).all() or np.linalg.eigvalsh(bend / np.outer(1 / unit, 1 / unit))[0] <= 0:
                return still
            covariance = np.linalg.inv(bend)
            moved = covariance @ slope
            point = point + np.clip(moved, -2 * step, 2 * step)
            if (np.abs(moved) < step).all():
                break
        u = np.sqrt(np.diag(covariance))
        if u[0] > CURVED * unit[0]:
            apart = np.maximum(u, unit * LEAST_APART)
            for _ in range(ROUNDS):
                point, u = _mean_and_deviation(likelihood, point, apart)
                if (u > FINE * apart).all():
                    break
                apart = np.maximum(u, FINE * apart)
    except (ValueError, np.linalg.LinAlgError, ArithmeticError):  # no dynamics are there
        return still
    if (np.abs(point) > unit * MOST).any() or (u > unit * LEAST_TOLD).any():
        return still
    return ResonanceChange(
        still.name,
        still.natural_frequency,
        float(point[0]),
        float(u[0]),
        float(point[1]),
        float(u[1]),
    )


def _mean_and_deviation(likelihood: Callable[[Array], float], centre: Array, apart: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of either logarithm, weighted by the likelihood on a grid, shapes (2,) and (2,)."""
    first, second = (np.arange(count) - count // 2 for count in NODES)
    table = np.array([[likelihood(centre + apart * (i, j)) for j in second] for i in first])
    weight = np.exp(table - table.max())
    weight /= weight.sum()
    found = []
    for places, share in ((first, weight.sum(axis=1)), (second, weight.sum(axis=0))):
        mean = float(places @ share)
        found.append((mean, float(np.sqrt((places - mean) ** 2 @ share))))
    mean, deviation = np.array(found).T
    return centre + apart * mean, apart * deviation


def _stencil(likelihood: Callable[[Array], float], point: Array, step: Array) -> tuple[Array, Array]:
    """Slope of a log-likelihood and the negative of its second derivatives, shapes (2,) and (2, 2)."""
    table = np.array([[likelihood(point + step * (i, j)) for j in (-1, 0, 1)] for i in (-1, 0, 1)])
    slope = np.array([table[2, 1] - table[0, 1], table[1, 2] - table[1, 0]]) / (2 * step)
    own = np.array([table[2, 1] + table[0, 1], table[1, 2] + table[1, 0]]) - 2 * table[1, 1]
    mixed = (table[2, 2] - table[2, 0] - table[0, 2] + table[0, 0]) / 4
    bend = -np.array([[own[0], mixed], [mixed, own[1]]]) / np.outer(step, step)
    return slope, bend
