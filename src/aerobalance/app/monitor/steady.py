"""The newest steady part of some samples: a mean across a step is of a value that never was."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from aerobalance.recording.channel import Array

FEWEST: Final = 20
"""Samples in which a step can be told from scatter."""

CLEAR: Final = 5.0
"""Height that a step has at least, over the standard deviation of the samples about it, either side."""

CERTAIN: Final = 6.0
"""Height that a step has at least, over the standard uncertainty of a sample."""

LEVEL: Final = 3.0
"""Height that a step has at least, over the standard deviation of the samples before it and of those after it."""

_SHORTEST: Final = 4
_DEEPEST: Final = 4


class Steady(NamedTuple):
    """The newest steady part: its mean, its number of samples, and the step before it (zero where there is none)."""

    mean: float
    samples: int
    step: float


def newest_steady(values: Array, *, uncertainty: float = 0.0) -> Steady:
    """Return the mean over what follows the last step of some samples, and the height of the step.

    Parameters
    ----------
    values
        Samples, shape (n,), n at least 1, all known.
    uncertainty
        Standard uncertainty of a sample.
    """
    part, step = values, 0.0
    before = float(values.mean())
    for _ in range(_DEEPEST):  # the samples on the way from one level to the other are a level of their own
        split = _split(part, uncertainty)
        if split is None:
            break
        if not step:
            before = float(part[:split].mean())
        part = part[split:]
        step = float(part.mean()) - before
    return Steady(float(part.mean()), part.size, step)


def _split(values: Array, uncertainty: float) -> int | None:
    """Where a step divides samples best (least squares); None where there is no clear one."""
    count = values.size
    if count < FEWEST:
        return None
    centred = values - values.mean()
    sums = np.cumsum(centred)[:-1]
    first = np.arange(1, count)
    explained = sums**2 * (count / (first * (count - first)))
    inner = explained[_SHORTEST - 1 : count - _SHORTEST]
    split = int(np.argmax(inner)) + _SHORTEST
    height = abs(float(sums[split - 1])) * count / (split * (count - split))
    scatter = np.sqrt(max(0.0, float(centred @ centred) - float(inner.max())) / count)
    level = max(float(values[:split].std()), float(values[split:].std()))
    return split if height > max(CLEAR * float(scatter), LEVEL * level, CERTAIN * uncertainty) else None
