"""Time that others are compared with, taken beside what is timed: a machine that others use changes by the minute."""

from __future__ import annotations

import time

import numpy as np
from scipy.fft import irfft, rfft

from aerobalance.recording.channel import Array


class Yardstick:
    """Processor time of a Fourier transform there and back, for each sample: the median of all that were timed.

    Parameters
    ----------
    values
        What is transformed, shape (n,).
    """

    def __init__(self, values: Array) -> None:
        self.values = values
        self.found: list[float] = []
        irfft(rfft(values))

    def beside(self, times: int = 5) -> None:
        """Time some more, before, between and after what is compared."""
        for _ in range(times):
            begin = time.process_time()
            irfft(rfft(self.values))
            self.found.append(time.process_time() - begin)

    @property
    def transform(self) -> float:
        """The median [s]."""
        return float(np.median(self.found)) / self.values.size
