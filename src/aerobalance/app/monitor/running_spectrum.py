"""The spectrum of the last moments of a stream, drawn up again and again."""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann

LENGTH: Final = 4096
"""Samples that one spectrum is made from."""


class RunningSpectrum:
    """Amplitude spectra of the last `LENGTH` samples of some channels.

    Parameters
    ----------
    columns
        Number of channels, c.
    interval
        Time between samples [s].
    """

    def __init__(self, columns: int, interval: float) -> None:
        self._held = np.empty((0, columns))
        window = hann(LENGTH)
        self._window = (2 * window / window.sum())[:, None]
        self.frequency = np.fft.rfftfreq(LENGTH, interval)[1:]

    def push(self, samples: Array) -> None:
        """Take samples, shape (n, c)."""
        self._held = np.concatenate((self._held, samples))[-LENGTH:]

    @property
    def ready(self) -> bool:
        """Whether there are samples enough."""
        return self._held.shape[0] == LENGTH

    def amplitudes(self) -> Array:
        """Amplitude of the sine at each frequency, shape (LENGTH / 2, c); missing samples are taken as the mean.

        The constant part and its leakage are taken out.
        """
        held = self._held
        known = np.isfinite(held)
        count = np.maximum(known.sum(axis=0), 1)
        mean = np.where(known, held, 0).sum(axis=0) / count
        centred = np.where(known, held - mean, 0.0)
        return np.asarray(np.abs(np.fft.rfft(centred * self._window, axis=0))[1:])
