"""Spectral lines of stretches of a record, by which is told what an error that is not seen would do to the force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from aerobalance.estimation.force_smoother import SmootherResult
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann

STRETCHES: Final = 16
"""Stretches of a record at most."""

LONGEST: Final = 4096
"""Samples of each at most."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """Some stretches of a record, spread evenly, under a Hann window.

    Attributes
    ----------
    means
        Mean of each of the k stretches, of which series of c in them, shape (k, c) or (k,).
    lines
        Lines of the rest, shape (k, c, m) or (k, m).
    size
        Samples of each.
    """

    means: Array
    lines: NDArray[np.complex128]
    size: int

    @classmethod
    def of(cls, series: Array) -> Stretches:
        """Take the stretches of series, shape (n, c), or of one, shape (n,)."""
        size = cls.size_in(len(series))
        first = np.unique(np.linspace(0, len(series) - size, STRETCHES).astype(np.intp))
        stretches = np.empty((first.size, *series.shape[1:], size))
        for begin, stretch in zip(first, stretches, strict=True):  # along rows, as they are worked on
            stretch[:] = series[begin : begin + size].T
        means = stretches.mean(axis=-1)
        stretches -= means[..., None]
        stretches *= hann(size)
        return cls(means, np.asarray(rfft(stretches), dtype=np.complex128), size)

    @staticmethod
    def size_in(count: int) -> int:
        """Samples of a stretch of a record of so many samples."""
        return min(LONGEST, count)

    def frequency(self, interval: float) -> Array:
        """Frequencies of the lines [Hz], shape (m,)."""
        return np.asarray(np.fft.rfftfreq(self.size, interval), dtype=np.float64)

    def power_of(self, lines: NDArray[np.complex128]) -> float:
        """Mean square of a series of which the stretches have these lines, shape (k, m), beside their means."""
        flat = np.ascontiguousarray(lines).view(np.float64).ravel()
        return 2 * float(flat @ flat) / (len(lines) * self.size * float(np.sum(hann(self.size) ** 2)))


def passed_by(fit: SmootherResult, frequency: Array) -> Array:
    """Return what the smoother lets through of a force, S G^2 / (S G^2 + N), at frequencies [Hz] of shape (m,) [1]."""
    shown = fit.learned.spectrum.density(frequency) * np.abs(fit.reading.dynamics.response(frequency)) ** 2
    return np.asarray(shown / (shown + fit.learned.noise_density(frequency, interval=fit.reading.interval)))
