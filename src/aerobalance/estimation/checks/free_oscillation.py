"""Evidence of dynamics beside a free oscillation, from the begin of a record or after a blow in it.

A free oscillation decays: it has no spectrum of a steady motion, and tells of a resonance by its course.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Protocol

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.evidence import SETTINGS as EVIDENCE
from aerobalance.estimation.checks.evidence import Evidence
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array

AFTER: Final = 2.0
"""Periods after the largest reading from which on what follows is looked at."""

FEWEST: Final = 256
"""Samples that it needs."""


class BesideSteps(Protocol):
    """What readings are without some steps and the free oscillation from their begin."""

    def __call__(self, dynamics: Dynamics, steps: Sequence[Step], /, *, first: int = 0) -> Array:
        """Return what is left of them with some dynamics, shape (n,) [N]; of those from a sample on, without steps."""
        ...


def evidence_beside(evidence: Evidence, left: Array, dynamics: Dynamics, steps: Sequence[Step]) -> float:
    """Return the evidence of dynamics and steps together, by what these leave; Schwarz's price of the steps is paid.

    Parameters
    ----------
    evidence
        The evidence in the readings.
    left
        What the steps leave of them, shape (n,) [N].
    dynamics, steps
        The dynamics, and the steps.
    """
    left = left[: EVIDENCE.samples]
    numbers = sum(3 if step.duration > 0 else 2 for step in steps)
    price = 0.5 * numbers * float(np.log(left.size / 2))
    return replace(evidence, values=left - left.mean(), _known={}, _density=None).of(dynamics) - price


def gain_beside(
    evidence: Evidence,
    dynamics: Dynamics,
    other: Dynamics,
    beside_steps: BesideSteps,
) -> float:
    """Return the gain of other dynamics in log-likelihood, each with a free oscillation from the begin of the record.

    Where that makes none likelier it is left out. It tells of a resonance by its course alone: decaying, it has no
    spectrum of a steady one, and under the window it looks hardly damped. Of a resonance that a load keeps up, it is
    least squares' alone: its sizes are not those that make the readings likeliest, and may make them less likely than
    none. Then it speaks for neither.

    Parameters
    ----------
    evidence
        The evidence in the readings.
    dynamics, other
        The dynamics that are expected, and the others.
    beside_steps
        What the readings are without the free oscillation.
    """
    price = float(np.log(evidence.values.size / 2))  # Schwarz's price of its two sizes
    own, others = (
        max(evidence.of(one), evidence_beside(evidence, beside_steps(one, ()), one, ()) - price)
        for one in (dynamics, other)
    )
    return others - own


def gain_after_a_blow(evidence: Evidence, dynamics: Dynamics, none: Dynamics, beside_steps: BesideSteps) -> float:
    """Return by how much what comes after the largest reading speaks for a free oscillation, in log-likelihood.

    A single blow has a spectrum with holes, of which one beside the natural frequency hides the resonance; what rings
    on after it is told by its course. Where a load keeps a balance of other dynamics in motion that says the same of
    them after its largest reading as before. Of too few samples it says nothing.

    Parameters
    ----------
    evidence
        The evidence in the readings.
    dynamics, none
        The dynamics that ring, and ones that do not.
    beside_steps
        What the readings are without the free oscillation.
    """
    later = round(AFTER / (dynamics.natural_frequency * evidence.interval))
    first = int(np.argmax(np.abs(evidence.values))) + later
    if evidence.values.size - first < FEWEST:
        return -np.inf
    gains = []
    for one in (dynamics, none):
        left = beside_steps(one, (), first=first)[: evidence.values.size - first]
        part = replace(evidence, values=left - left.mean(), _known={}, _density=None, _edges=None)
        gains.append(part.of(one))
    return gains[0] - gains[1]
