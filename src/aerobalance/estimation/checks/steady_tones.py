"""Steady tones that one channel or several have in common, as those of a rotor: narrower than any resonance."""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann

MOST: Final = 16
"""Peaks of the spectrum that are looked at at most."""

TURNS: Final = 4
"""Times that the frequency of one is found again."""

WIDTH: Final = 4
"""Half width of a peak in ordinates."""

SHARE: Final = 0.02
"""Power of a peak over that of all from which it is looked at."""

LEFT: Final = 0.05
"""Power that a sine leaves of a tone at most, over that of the peak."""


def without_tones(loads: Array, *, above: float = 0.0) -> Array:
    """Loads less their steady tones, as of a rotor, shape (samples, n).

    A tone is a peak of the spectrum of all channels of which a sine of one frequency leaves next to nothing; what
    rings in bursts, or dies down, is none.

    Parameters
    ----------
    loads
        The loads, shape (samples, n).
    above
        Frequency above which they are looked for, over the sampling rate.
    """
    count = len(loads)
    time, taper = np.arange(count) - 0.5 * (count - 1), hann(count)[:, None]
    left, size = loads - loads.mean(axis=0), np.maximum(loads.std(axis=0), 1e-300)
    searched = np.arange(count // 2 + 1) > max(above * count, WIDTH)
    for _ in range(MOST):
        power = np.sum(np.abs(np.fft.rfft(left / size * taper, axis=0)) ** 2, axis=1) * searched
        place = int(np.argmax(power))
        near = slice(max(place - WIDTH, 0), place + WIDTH + 1)
        if not power[near].sum() > SHARE * power.sum():
            break
        rate = 2 * np.pi * place / count
        for _ in range(TURNS):
            both = np.column_stack([np.cos(rate * time), np.sin(rate * time)])
            shapes = np.hstack([both, both * time[:, None] / count])
            a, b, growing_a, growing_b = np.linalg.lstsq(shapes * taper, left / size * taper)[0]
            # a cos + b sin of a little other frequency: its slope is time (b cos - a sin)
            shift = (growing_a @ b - growing_b @ a) / (a @ a + b @ b + 1e-300) / count
            rate += float(np.clip(shift, -np.pi / count, np.pi / count))
        both = np.column_stack([np.cos(rate * time), np.sin(rate * time)])
        rest = left - both @ np.linalg.lstsq(both * taper, left * taper)[0]
        after = np.sum(np.abs(np.fft.rfft(rest / size * taper, axis=0)) ** 2, axis=1)
        if after[near].sum() < LEFT * power[near].sum():
            left = rest
        else:
            searched[near] = False
    return np.asarray(left)
