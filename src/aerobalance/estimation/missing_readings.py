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
from aerobalance.estimation.least_squares import take_out, whitened
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

AT_ONCE: Final = 1 << 12
"""Samples of all missing readings' answers that are made at once."""

TOGETHER: Final = 8
"""Combinations of them whose error is worked out at once."""

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
            impulses = _Impulses.of(fit.record, missing)
            if impulses is not None:
                known, own = impulses.told_by(fit, record.reading(place, on_clock_of=place, filled=filled))
                information += known
                told -= own
        size = np.sqrt(np.diag(information))
        power, turned = np.linalg.eigh(information / np.outer(size, size))
        power = np.maximum(power, np.finfo(float).eps * power[-1])
        spread = turned / np.sqrt(power) / size[:, None]
        lacking = np.zeros(missing.shape[::-1])
        lacking[missing.T] = spread @ (spread.T @ told)
        shown = np.linalg.svd(spread / np.sqrt(np.diag(record.noise))[np.nonzero(missing.T)[0], None])
        kept = shown[2][shown[1] > UNSEEN * shown[1][0]]
        return filled + lacking.T, cls(missing, spread @ kept.T)

    def error(self, fit: Fitted, *, few: bool = False) -> Systematic:
        """Error of a component's force from what is not known of them, with its fit; if `few`, by what shows of it."""
        impulses, pieces = _Impulses.of(fit.record, self.missing), [np.zeros((len(self.missing), 0))]
        if impulses is None:
            return _independent(pieces[0])
        estimator = fit.smoothed.estimator
        for first in range(0, self.root.shape[1], TOGETHER):
            series = impulses.combined(self.root[:, first : first + TOGETHER])
            series[~fit.signal.reading.present] = 0.0
            pieces.append(estimator.run(series))
            if few:  # of fifty, four show in a force
                pieces = [_independent(np.hstack(pieces)).few.slopes]
        return _independent(np.hstack(pieces))


def _independent(slopes: Array) -> Systematic:
    """The error by what independent numbers of variance 1 do to a force, shape (n, r) [N]."""
    names = tuple(f"combination {number}" for number in range(1, slopes.shape[1] + 1))
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

    width = int(min(max(2 / (dynamics.natural_frequency * interval), 1.0), moved.size))
    return Noise(MISSING, "load", maximum_filter1d(np.abs(moved), width), np.ones(1))


@dataclass(frozen=True, slots=True, eq=False)
class _Impulses:
    """Readings of a component under an impulse in the place of every missing reading.

    They are shifted from one of each channel: the ends of a record are farther from its middle than any of its modes
    rings. All together they may be as large as all else of a part, so that they are made as they are wanted.

    Attributes
    ----------
    answers
        Reading under an impulse of a channel in the middle, with as many zeros before and after it, shape (3 samples,)
        for every channel of which readings are missing.
    begins
        Which answer, and the place in it of the first sample, for every missing reading, channel by channel.
    samples
        Number of samples.
    """

    answers: list[Array]
    begins: list[tuple[int, int]]
    samples: int

    @classmethod
    def of(cls, record: ComponentRecord, missing: NDArray[np.bool_]) -> _Impulses | None:
        """Return them for missing readings, (samples, n); None where the component shows none of them."""
        count = len(missing)
        answers: list[Array] = []
        begins: list[tuple[int, int]] = []
        for channel in np.flatnonzero(missing.any(axis=0)):
            impulse = np.zeros(missing.shape)
            impulse[count // 2, channel] = 1.0
            middle = count + count // 2
            begins += [(len(answers), middle - int(place)) for place in np.flatnonzero(missing[:, channel])]
            answers.append(np.concatenate([np.zeros(count), record.reading_of(impulse), np.zeros(count)]))
        seen = any(answers[one][first : first + count].any() for one, first in begins)
        return cls(answers, begins, count) if seen else None

    def rows(self, begin: int, end: int) -> Array:
        """The samples from one to another (not included) of all, shape (m, end - begin)."""
        return np.stack([self.answers[one][first + begin : first + end] for one, first in self.begins])

    def told_by(self, fit: Fitted, values: Array) -> tuple[Array, Array]:
        """What a component's readings (samples,) tell of their sizes: information (m, m) and products (m,) [1]."""
        reading = fit.signal.reading
        known = columns_of(list(fit.signal.steps), reading)
        filter_ = KalmanFilter.of(reading.system(fit.signal.learned), np.ones(values.size, dtype=np.bool_))
        white, unknown = whitened(filter_, values, known), filter_.whiten(self.rows(0, values.size).T)
        free = np.linalg.qr(white[:, 1:])[0]
        take_out(free, white[:, :1])
        take_out(free, unknown)
        return unknown.T @ unknown, unknown.T @ white[:, 0]

    def combined(self, sizes: Array) -> Array:
        """Sums of them of some sizes (m, c), shape (samples, c)."""
        out = np.empty((sizes.shape[1], self.samples))
        for begin in range(0, self.samples, AT_ONCE):
            end = min(begin + AT_ONCE, self.samples)
            np.matmul(sizes.T, self.rows(begin, end), out=out[:, begin:end])
        return out.T
