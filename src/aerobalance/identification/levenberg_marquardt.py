"""The Levenberg-Marquardt method: Gauss-Newton steps, damped more where they miss and less where they hit.

The fits of this package differ in what they fit, in how a step is solved and when it is small; the steps are taken
here (Levenberg 1944, Marquardt 1963).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, TypeVar

from aerobalance.recording.progress import PROGRESS

State = TypeVar("State")

FACTOR: Final = 10.0
"""Factor of the damping parameter from step to step."""

LARGEST_DAMPING: Final = 1e12
"""Damping parameter beyond which no step is left."""


class DampedStep(NamedTuple, Generic[State]):
    """A damped step, not yet taken.

    Attributes
    ----------
    size
        Drop of the cost that it promises, or the square of its largest move in standard deviations [variances].
    take
        Where it leads and the cost there; infinite where it leads out of what is allowed.
    """

    size: float
    take: Callable[[], tuple[State, float]]


@dataclass(frozen=True, slots=True)
class Settings:
    """When a fit has settled, and how it is damped.

    Attributes
    ----------
    most_steps
        Steps after which the fit is given up.
    enough, enough_of_cost
        Size of a step at which the fit has settled, in variances and as a share of the cost.
    barely, barely_of_cost
        The same for a step that did not lower the cost.
    last
        Whether the step that is small enough is taken too, where it lowers the cost.
    damping
        Damping parameter of the first step.
    raised
        Damping parameter that a step that missed leads to at least.
    negligible, lowest
        Damping parameter down to which a step that hit lowers it, and the one below.
    valley, flat
        Steps over which a fit that gains less than `flat` has settled; 0 steps where it is not to.
    """

    most_steps: int
    enough: float
    enough_of_cost: float = 0.0
    barely: float = 0.0
    barely_of_cost: float = 0.0
    last: bool = False
    damping: float = 0.0
    raised: float = 0.0
    negligible: float = 1e-6
    lowest: float = 0.0
    valley: int = 0
    flat: float = 1.0


class Outcome(NamedTuple, Generic[State]):
    """Where a fit ended.

    Attributes
    ----------
    state
        The parameters, as the fit keeps them.
    costs
        Cost before every step.
    settled
        Whether it settled before the steps were used up.
    """

    state: State
    costs: list[float]
    settled: bool


def levenberg_marquardt(
    state: State, cost: float, step: Callable[[State, float], DampedStep[State]], settings: Settings
) -> Outcome[State]:
    """Return the parameters at a minimum of a sum of squares.

    Parameters
    ----------
    state, cost
        Where to begin, and the sum of squares there [variances].
    step
        Makes a step from a state with a damping parameter [1]; 0 is the Gauss-Newton step.
    settings
        When the fit has settled.
    """
    damping, costs = settings.damping, list[float]()
    for number in range(settings.most_steps):
        PROGRESS.note(f"step {number + 1} of a fit")
        costs.append(cost)
        if settings.valley and len(costs) > settings.valley and costs[-settings.valley] - cost < settings.flat:
            return Outcome(state, costs, settled=True)
        proposed = step(state, damping)
        small = proposed.size < max(settings.enough, settings.enough_of_cost * cost)
        if small and not settings.last:
            return Outcome(state, costs, settled=True)
        trial, found = proposed.take()
        if found < cost:
            state, cost = trial, found
            damping = damping / FACTOR if damping > settings.negligible else settings.lowest
            if small:
                return Outcome(state, costs, settled=True)
        elif proposed.size < max(settings.barely, settings.barely_of_cost * cost) or damping > LARGEST_DAMPING:
            return Outcome(state, costs, settled=True)
        else:
            damping = max(FACTOR * damping, settings.raised)
    return Outcome(state, [*costs, cost], settled=False)
