"""Missing readings of coupled components, found from what the others say of them.

A reading that is missing in one channel is missing in all components that the channel has a part in, and what is put
in its place rings on in them. So what it lacks is an unknown: a column in every component, the answer to an impulse of
its channel. Together they are found by generalised least squares from all components, each with the prior of its force
and its known shapes free; what is left of them is an error of all forces.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.component_force import Fitted
from aerobalance.estimation.error_sources import Noise, Systematic
from aerobalance.estimation.least_squares import whitened
from aerobalance.estimation.record import BalanceRecord, ComponentRecord
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.steps import columns_of
from aerobalance.recording.channel import Array

MISSING: Final = "missing readings of coupled components"
"""Name of what they contribute to the uncertainty."""

MOST: Final = 256
"""Missing readings at most that are found so."""

MOST_NUMBERS: Final = 4_000_000
"""Samples of columns at most, those of one component."""

UNSEEN: Final = 1e-4
"""Deviation of a combination of them, over the largest, below which it is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class MissingReadings:
    """What is found in the place of missing readings, and how well.

    Attributes
    ----------
    missing
        True where a reading is missing, shape (samples, n).
    root
        Combinations of independent numbers of variance 1 that their errors are, channel by channel, shape (m, r).
    """

    missing: NDArray[np.bool_]
    root: Array

    @staticmethod
    def are_few(record: BalanceRecord) -> bool:
        """Whether there are so few missing readings that they can be found, on one clock of all channels."""
        count = int(np.count_nonzero(~np.isfinite(record.loads)))
        few = 0 < count <= MOST and count * len(record.loads) <= MOST_NUMBERS
        return few and len({channel.delay for channel in record.channels}) == 1

    @classmethod
    def of(cls, record: BalanceRecord, fits: Mapping[str, Fitted], *, filled: Array) -> tuple[Array, MissingReadings]:
        """Return the readings with their gaps filled, shape (samples, n), and how well.

        Parameters
        ----------
        record
            The record.
        fits
            What each component's reading gives by itself.
        filled
            The readings with something in the place of those that are missing, shape (samples, n).
        """
        missing = ~np.isfinite(record.loads)
        count = int(np.count_nonzero(missing))
        information, told = np.zeros((count, count)), np.zeros(count)
        for place, fit in enumerate(fits.values()):
            reading = fit.signal.reading
            columns = _columns(fit.record, missing)
            if columns is None:
                continue
            known = columns_of(list(fit.signal.steps), reading)
            values = record.reading(place, on_clock_of=place, filled=filled)
            filter_ = KalmanFilter.of(reading.system(fit.signal.learned), np.ones(values.size, dtype=np.bool_))
            white = whitened(filter_, values, np.column_stack([known, columns]))
            free = np.linalg.qr(white[:, 1 : 1 + known.shape[1]])[0]
            white -= free @ (free.T @ white)
            unknown = white[:, 1 + known.shape[1] :]
            information += unknown.T @ unknown
            told -= unknown.T @ white[:, 0]
        size = np.sqrt(np.diag(information))
        power, turned = np.linalg.eigh(information / np.outer(size, size))
        power = np.maximum(power, np.finfo(float).eps * power[-1])
        spread = turned / np.sqrt(power) / size[:, None]
        lacking = np.zeros(missing.shape[::-1])
        lacking[missing.T] = spread @ (spread.T @ told)
        shown = np.linalg.svd(spread / np.sqrt(np.diag(record.noise))[np.nonzero(missing.T)[0], None])
        kept = shown[2][shown[1] > UNSEEN * shown[1][0]]
        return filled + lacking.T, cls(missing, spread @ kept.T)

    def error(self, fit: Fitted) -> Systematic:
        """Error of a component's force from what is not known of them, with its fit."""
        columns = _columns(fit.record, self.missing)
        if columns is None:
            return Systematic(MISSING, "load", (), np.zeros((len(self.missing), 0)), np.zeros((0, 0)), local=True)
        series = np.where(fit.signal.reading.present[:, None], columns @ self.root, 0.0)
        names = tuple(f"combination {number}" for number in range(1, self.root.shape[1] + 1))
        slopes = fit.smoothed.estimator.run(series)
        return Systematic(MISSING, "load", names, slopes, np.eye(len(names)), local=True)


def filled_error(dynamics: ModalModel, moved: Array, *, interval: float) -> Noise:
    """Return the error of a force from readings of coupled components that are filled and not found one by one.

    The forces fill them better from pass to pass. What they have moved by since the first pass, in which the readings
    themselves predicted them, is no less than what may still be wrong: the error in and about a gap of 40 samples of
    six components was 0.2 to 1.4 times the uncertainty with it (of 60 once 2.3), and up to 16 times that without.

    Parameters
    ----------
    dynamics
        The component's model: as long as it rings once, before a gap and behind it, the error is about as large.
    moved
        Change of the force, shape (n,) [N].
    interval
        Time between samples [s].
    """
    from scipy.ndimage import maximum_filter1d  # noqa: PLC0415 - takes 30 ms, and few records need it

    width = max(int(2 / (dynamics.natural_frequency * interval)), 1)
    return Noise(MISSING, "load", maximum_filter1d(np.abs(moved), width), np.ones(1))


def _columns(record: ComponentRecord, missing: NDArray[np.bool_]) -> Array | None:
    """Reading of a component under an impulse in the place of every missing reading, shape (samples, m).

    They are shifted from one: the ends of a record are farther from its middle than any of its modes rings.
    """
    count, found = len(missing), []
    for channel in range(missing.shape[1]):
        if not missing[:, channel].any():
            continue
        impulse = np.zeros(missing.shape)
        impulse[count // 2, channel] = 1.0
        answer = np.concatenate([np.zeros(count), record.reading_of(impulse), np.zeros(count)])
        for place in np.flatnonzero(missing[:, channel]):
            first = count + count // 2 - int(place)
            found.append(answer[first : first + count])
    columns = np.stack(found, axis=1)
    return columns if columns.any() else None
