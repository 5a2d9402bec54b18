"""Motion of a ground end that is at rest but for tones."""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance.recording.channel import Array

AT_REST: Final = 1.25
"""Variance of an acceleration over that of its own noise, below which the ground end is at rest."""

CHANCE: Final = 1e-6
"""Probability with which the noise of an accelerometer may pass for a tone."""


def tones(acceleration: Array) -> tuple[Array, float]:
    """Tones that stand out of the white noise of a record, and the share of the noise's rms that comes with them.

    Parameters
    ----------
    acceleration
        Readings, shape (n,); NaN where missing. A line across a gap would be a slow motion that is not there.
    """
    spectrum = np.fft.rfft(np.nan_to_num(acceleration - np.nanmean(acceleration)))
    power = np.abs(spectrum) ** 2
    # ordinates of white noise are exponentially distributed: this one is passed by the largest of n with p = CHANCE
    out = power > np.median(power) / np.log(2) * np.log(max(power.size, 1) / CHANCE)
    if not out.any():
        return np.zeros_like(acceleration), 0.0
    # a tone between two ordinates leaks into its neighbours; eight on either side hold 97 % of its amplitude
    kept = np.convolve(out, np.ones(17))[8:-8] > 0  # "same" is as long as the longer of the two
    return np.fft.irfft(np.where(kept, spectrum, 0), acceleration.size), float(np.sqrt(np.mean(kept)))
