"""A window over a record, and the transforms of what is under it.

The equation of motion holds at every instant, so it holds under a window w over the record too. With s = i omega and
the transforms of w X, w' X and w'' X, those of w X' and w X'' are

    s (w X) - (w' X)   and   s^2 (w X) - 2 s (w' X) + (w'' X),

without any term for the motion that is going on at the ends, where the window is zero. What the window costs is the
readings near the ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft, rfftfreq

from aerobalance.identification.coupled.free_response import Complex
from aerobalance.recording.channel import Array

TAPER: Final = 0.05
"""Share of the record over which the window rises, and again over which it falls."""

LEAST_TAPER: Final = 0.1
"""Time over which it rises and falls at least [s], unless that is more than a quarter of the record."""

LOWEST: Final = 4.0
"""Lowest frequency used, over that whose period is the taper: below, a constant reading shows."""

TOP: Final = 0.8
"""Share of half the sampling rate up to which frequencies are used."""


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """A window and its first two derivatives by time.

    Attributes
    ----------
    values
        Window and derivatives, of a size that leaves white noise its variance as power, shape (n,) each.
    frequency
        Frequencies of the transforms of the whole record [Hz].
    used
        Which of them are used.
    share
        What the window leaves of the information in a steady record, between 0 and 1.
    """

    values: tuple[Array, Array, Array]
    frequency: Array
    used: NDArray[np.bool_]
    share: float

    @classmethod
    def of(cls, samples: int, rate: float) -> Window:
        """Window that rises and falls as the integral of the fourth power of half a sine."""
        duration = samples / rate
        taper = min(max(TAPER * duration, LEAST_TAPER), duration / 4)
        angle = np.pi * np.clip(np.minimum(np.arange(samples), np.arange(samples)[::-1]) / rate / taper, 0.0, 1.0)
        side = np.where(np.arange(samples) < samples / 2, 1.0, -1.0) * np.pi / taper
        rise = (angle - 2 / 3 * np.sin(2 * angle) + np.sin(4 * angle) / 12) / np.pi
        slope = 8 / 3 * np.sin(angle) ** 4 / np.pi * side
        bend = 32 / 3 * np.sin(angle) ** 3 * np.cos(angle) / np.pi * side**2
        frequency = rfftfreq(samples, 1 / rate)
        used = (frequency >= LOWEST / taper) & (frequency <= TOP * rate / 2)
        square, fourth = float(np.sum(rise**2)), float(np.sum(rise**4))
        size = np.sqrt(square)
        return cls((rise / size, slope / size, bend / size), frequency, used, square**2 / (samples * fourth))

    def transform(self, values: Array, order: int = 0) -> Complex:
        """Transform of a derivative of the window times columns (n, k), at the frequencies used."""
        table = rfft(values * self.values[order][:, None], axis=0)[self.used]
        return np.asarray(table, dtype=np.complex128)

    def only(self, chosen: NDArray[np.bool_]) -> Window:
        """The same with some of the frequencies used."""
        used = self.used.copy()
        used[used] = chosen
        return replace(self, used=used)

    @property
    def rates(self) -> Complex:
        """What turns a transform into that of a derivative: s at the frequencies used, shape (m, 1) [1/s]."""
        return np.asarray(2j * np.pi * self.frequency[self.used][:, None])

    def derivatives(self, values: Array) -> tuple[Complex, Complex, Complex]:
        """Transforms of columns (n, k) and of their first and second derivatives, under the window."""
        s, (plain, first, second) = self.rates, (self.transform(values, order) for order in range(3))
        return plain, s * plain - first, s**2 * plain - 2 * s * first + second
