"""Gaps across which a force changes by more than it does elsewhere: when in the gap it did is not known.

What a balance rings after a sudden force tells the instant of that force but for whole periods, so that a step that is
found beside a gap, or in it, may have come at any time in it; where the ringing has died away before there are
readings again, no step is found, and the force between is drawn from the one level to the other. At a share p of the
gap the force is the level before with the probability 1 - p and the level after with the probability p. What is found
lies at a share s of the change between them, and its mean square error is p (1 - s)^2 + (1 - p) s^2 times its square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.error_sources import Noise
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import gaps_in
from aerobalance.recording.wild_samples import SCATTER

CHANGED: Final = "change of the force in a gap"
"""Name of what it contributes to the uncertainty."""


@dataclass(frozen=True, slots=True)
class GapLevelSettings:
    """Which gaps are looked at, and which change is larger than usual.

    Attributes
    ----------
    shortest
        Shortest gap that may hide the instant of a step [periods of the natural frequency].
    larger
        Change of the force across a gap over the scatter of changes across as much time elsewhere in the record.
    fewest
        Such changes that find room side by side in a record from which on their scatter is told by them; in a shorter
        one it is that of two values of the force, which is no less.
    """

    shortest: float = 0.25
    larger: float = 5.0
    fewest: int = 8


SETTINGS: Final = GapLevelSettings()
"""The settings in use."""


def changed_in_gaps(
    force: Array, steps: Sequence[Step], missing: NDArray[np.bool_], dynamics: ModalModel, *, interval: float
) -> tuple[tuple[Noise, ...], tuple[Step, ...]]:
    """Return errors of a force where it changes in gaps [N], none or one, and its steps with what that says of them.

    Parameters
    ----------
    force
        The force found, shape (n,) [N].
    steps
        Its steps.
    missing
        Where a reading is missing, shape (n,).
    dynamics
        The component's model.
    interval
        Time between samples [s].
    """
    period = max(round(1 / (dynamics.natural_frequency * interval)), 1)
    gaps = [gap for gap in gaps_in(missing) if gap[1] - gap[0] >= SETTINGS.shortest * period]
    if not gaps:
        return (), tuple(steps)
    time = np.arange(force.size) * interval
    smooth = force - sum((one.height * (time >= one.instant) for one in steps), np.zeros(force.size))
    deviation, known = np.zeros(force.size), list(steps)
    longest = 0
    for first, last in gaps:
        # a step that is found just behind a gap may have been in it
        within = [one for one in steps if first <= one.instant / interval <= last + SETTINGS.shortest * period]
        stop = max([last, *(int(one.instant / interval) + 1 for one in within)])
        across = stop - first
        before, after = force[max(first - period, 0) : first], force[stop : stop + period]
        if not (before.size and after.size):
            continue
        usual = _usual_change(smooth, slice(first, stop), period)
        change = float(after.mean() - before.mean())
        if abs(change) <= SETTINGS.larger * usual:
            continue
        place = (np.arange(across) + 0.5) / across
        share = np.clip((force[first:stop] - before.mean()) / change, 0.0, 1.0)
        deviation[first:stop] = abs(change) * np.sqrt(place * (1 - share) ** 2 + (1 - place) * share**2)
        longest = max(longest, across)
        anywhere = across * interval / np.sqrt(12)
        known = [
            replace(one, instant_uncertainty=float(np.hypot(one.instant_uncertainty, anywhere)))
            if one in within
            else one
            for one in known
        ]
    if not longest:
        return (), tuple(steps)
    spectrum = np.zeros(longest)  # one error all along the gap: up to half a period in its length
    spectrum[0] = longest
    return (Noise(CHANGED, dynamics.component, deviation, spectrum),), tuple(known)


def _usual_change(smooth: Array, gap: slice, period: int) -> float:
    """Scatter of the changes of a force from its mean in a period to that in another, a gap's length later [N]."""
    across = gap.stop - gap.start
    if smooth.size < SETTINGS.fewest * (across + 2 * period):
        sides = smooth[: gap.start], smooth[gap.stop :]
        departures = np.concatenate([side - np.median(side) for side in sides if side.size])
        return float(np.sqrt(2) * SCATTER * np.median(np.abs(departures)))
    summed = np.concatenate([[0.0], np.cumsum(smooth)])
    means = (summed[period:] - summed[:-period]) / period
    return float(SCATTER * np.median(np.abs(means[across + period :] - means[: -(across + period)])))
