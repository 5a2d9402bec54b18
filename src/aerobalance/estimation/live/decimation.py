"""Decimation of a stream, block by block: a filter that leaves white noise white, then every n-th sample."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from aerobalance.recording.channel import Array
from aerobalance.recording.decimation import decimation_filter

SPAN: Final = 8
"""New samples on either side that the filter reaches over: a third of what a record that is complete can take, as the
force waits for them."""


class Decimator:
    """Takes every n-th sample of a filtered stream; what comes out does not depend on how it came cut.

    Parameters
    ----------
    columns
        Number of channels, c.
    factor
        How many samples become one.
    """

    def __init__(self, columns: int, factor: int) -> None:
        if factor < 1:
            raise ValueError(f"one sample of {factor} cannot be taken; the factor is at least 1")
        self.factor = factor
        self._taps = decimation_filter(factor, SPAN) if factor > 1 else np.ones(1)
        self._half = self._taps.size // 2
        self._held = np.empty((0, columns))

    def push(self, samples: Array) -> Array:
        """Take samples, shape (n, c); return those that have become due, shape (m, c).

        The first is at sample `SPAN` times the factor of the stream, each further one a factor later.
        """
        if self.factor == 1:
            return samples
        held = np.concatenate((self._held, samples))
        count = max(0, (held.shape[0] - self._taps.size) // self.factor + 1)
        if not count:
            self._held = held
            return np.empty((0, held.shape[1]))
        windows = sliding_window_view(held, self._taps.size, axis=0)[:: self.factor][:count]
        made = windows @ self._taps
        self._held = held[count * self.factor :]
        return np.ascontiguousarray(made)

    @property
    def first(self) -> int:
        """Sample of the stream at which the first output is."""
        return self._half
