"""Time that others are compared with, taken beside what is timed: a machine that others use changes by the minute."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable

import numpy as np
from scipy.fft import irfft, rfft

from aerobalance.recording.channel import Array
from aerobalance.recording.errors import DataQualityWarning


def spent(work: Callable[[], object], *, runs: int = 1, first: bool = True) -> float:
    """Least processor time of some runs [s]; what they warn of is no matter.

    Parameters
    ----------
    work
        What is timed.
    runs
        How many of them are timed.
    first
        Whether the first run is: it may compile, and fill what is kept.
    """
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for _ in range(runs if first else runs + 1):
            begin = time.process_time()
            work()
            found.append(time.process_time() - begin)
    return min(found if first else found[1:])


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
