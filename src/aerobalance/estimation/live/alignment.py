"""Channels that lag each other, brought onto one clock as their samples come in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import interpolation

SAME: Final = 9
"""Decimal places of a sampling interval beyond which a lag is rounding."""


class Aligner:
    """Readings of channels at the instants of one of them; what comes out does not depend on how they came cut.

    Lags of whole samples are taken out exactly. For the rest readings are interpolated band-limited, so that a missing
    one leaves `aerobalance.recording.resampling.REACH` samples on either side missing. What came before the first
    sample is as the first; loads that were read more than a sample before the first of another channel are missing.

    Parameters
    ----------
    late
        Samples by which the readings of each of the c channels come late; negative where they come early.
    loads
        How many of them, the first ones, are loads.

    Attributes
    ----------
    ahead
        Samples that a row waits for those after it.
    """

    def __init__(self, late: Sequence[float], *, loads: int = 0) -> None:
        self._taps = [_taps(round(float(one), SAME)) for one in late]
        self._straight = all(first == 0 and weights.size == 1 for weights, first in self._taps)
        self._behind = max([0, *(-first for _, first in self._taps)])
        self.ahead: int = max([0, *(first + weights.size - 1 for weights, first in self._taps)])
        early = -np.round(np.asarray(late, dtype=np.float64)[loads:], SAME)
        self._loads, self._unread = loads, int(np.ceil(early.max(initial=0.0) - 1))
        self._held: Array | None = None

    def push(self, rows: Array) -> Array:
        """Take samples, shape (n, c); return those that have become known, shape (m, c), the first at the first."""
        if self._straight or not rows.shape[0]:
            return rows
        if self._held is None:
            self._held = np.repeat(rows[:1], self._behind, axis=0)
        held = np.concatenate((self._held, rows))
        count = max(held.shape[0] - self._behind - self.ahead, 0)
        made = np.zeros((count, held.shape[1]))
        for column, (weights, first) in enumerate(self._taps):
            # one product a tap, so that the sum does not hang on how many samples come at once
            for place, weight in enumerate(weights, start=self._behind + first):
                made[:, column] += weight * held[place : place + count, column]
        self._held = held[count:]
        if self._unread > 0:
            made[: self._unread, : self._loads] = np.nan
            self._unread -= count
        return made


def _taps(late: float) -> tuple[Array, int]:
    """Weights of samples in the value so many samples later, and how far from it the first of them is."""
    if late == round(late):
        return np.ones(1), round(late)
    weights, first = interpolation(-late)
    used = np.flatnonzero(weights[0])
    return weights[0, used[0] : used[-1] + 1], first + int(used[0])
