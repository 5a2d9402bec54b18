"""Draws of the errors that noise leaves in a smoothed force, prior and steps given.

The error of the force from all readings that there ever were does not depend on those: far from both ends of a record
it is a stationary noise with a spectrum that is known. Near an end the smoother differs from that, by what it makes of
the readings there, so a record of a few memories stands for each end. The sizes of the known shapes follow from the
readings, which the error of their best estimate does not depend on. A record with gaps is drawn and smoothed as a
whole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.estimation.force_smoother import LinearSmoother
from aerobalance.estimation.statespace.kalman import FORCE, KalmanFilter
from aerobalance.estimation.statespace.model_draws import ModelDraws
from aerobalance.recording.channel import Array
from aerobalance.recording.linalg import covariance_root

SETTLED: Final = 1e-3
"""Part of the variance by which the error near an end may differ from that far from it, where it is taken for that."""

SHORT: Final = 0.25
"""Part of a record that both ends may take; where they take more, it is drawn as a whole."""


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """An end of a record.

    Attributes
    ----------
    model, filter
        What draws a short record with that end, and the force that all readings tell of it; and what smooths it.
    part, place
        Where the end lies in the short record, and in the whole.
    """

    model: ModelDraws
    filter: KalmanFilter
    part: slice
    place: slice

    def draw(self, generator: np.random.Generator, number: int) -> Array:
        """What the smoother of the record misses of what all readings tell, shape (number, length of the end) [N]."""
        told, readings = self.model.draw(generator, number)
        found = self.filter.smooth(readings.T, [FORCE])[:, :, 0].T
        return np.asarray((told - found)[:, self.part])


@dataclass(frozen=True, slots=True, eq=False)
class NoiseDraws:
    """What draws errors from noise.

    Attributes
    ----------
    estimator
        The smoother.
    model
        What draws forces and readings of the whole record.
    ends
        The ends where the error differs; None where the record is drawn as a whole.
    root
        Root of the covariance of the sizes of the known shapes, shape (p, any).
    """

    estimator: LinearSmoother
    model: ModelDraws
    ends: tuple[_End, ...] | None
    root: Array

    @classmethod
    def of(cls, estimator: LinearSmoother) -> NoiseDraws:
        """Return those of a smoother."""
        model = ModelDraws.of(estimator.system, estimator.filter.present)
        return cls(estimator, model, _ends(estimator, model), covariance_root(estimator.size_covariance))

    def draw(self, generator: np.random.Generator, number: int) -> tuple[Array, Array]:
        """Return so many errors, the known shapes known, shape (number, n) [N], and sizes of these, (p, number)."""
        if self.ends is None:
            forces, readings = self.model.draw(generator, number)
            found, sizes = self.estimator.apart(readings.T)
            forces -= found.T
            return forces, sizes
        errors = self.model.draw_untold(generator, number)
        for end in self.ends:
            errors[:, end.place] += end.draw(generator, number)
        return errors, self.root @ generator.normal(size=(self.root.shape[1], number))


def _ends(estimator: LinearSmoother, model: ModelDraws) -> tuple[_End, ...] | None:
    """Both ends of a record, as long as the error differs there; None where the record has gaps or is short."""
    present, count = estimator.filter.present, estimator.filter.present.size
    if not present.all():
        return None
    unsettled = np.flatnonzero(estimator.filter.smoothed_variance > (1 + SETTLED) * model.untold_variance)
    middle = count // 2
    first = int(np.max(unsettled[unsettled < middle], initial=-1)) + 1
    last = count - int(np.min(unsettled[unsettled >= middle], initial=count))
    if 2 * (first + last) > SHORT * count:
        return None
    begun = replace(estimator.system, initial=model.stationary)  # long after the start
    built = []
    for system, length, part, place in (
        (estimator.system, first, slice(0, first), slice(0, first)),
        (begun, last, slice(last, 2 * last), slice(count - last, count)),
    ):
        if length:
            here = np.ones(2 * length, dtype=bool)
            told = replace(ModelDraws.of(system, here), own=np.zeros(1))
            built.append(_End(told, KalmanFilter.of(system, here), part, place))
    return tuple(built)
