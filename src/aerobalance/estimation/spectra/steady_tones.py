"""Steady tones that one channel or several have in common, as those of a rotor: narrower than any resonance."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann

MOST: Final = 16
"""Peaks of the spectrum that are looked at at most."""

TURNS: Final = 4
"""Times that the frequency of one is found again."""

WIDTH: Final = 4
"""Half width of a peak in ordinates."""

BAND: Final = 32
"""Half width in ordinates of the band about a peak in which a sine is fitted: further off the window shows less than
1e-5 of it."""

SHARE: Final = 0.02
"""Power of a peak over that of all from which it is looked at."""

LEFT: Final = 0.05
"""Power that a sine leaves of a tone at most, over that of the peak."""

LOBE: Final = 2
"""Ordinates on either side of a peak within which a sine shows: beyond, up to `WIDTH`, are 5e-4 of its power."""

BROAD: Final = 0.07
"""Power beyond those over that of the peak from which no sine leaves so little: (0.07^0.5 - 0.022)^2 is 0.059."""


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
    spectrum = rfft(left / size * taper, axis=0)
    for _ in range(MOST):
        power = np.sum(np.abs(spectrum) ** 2, axis=1) * searched
        place = int(np.argmax(power))
        near = slice(max(place - WIDTH, 0), place + WIDTH + 1)
        own = float(power[near].sum())
        if not own > SHARE * power.sum():
            break
        if power[place - WIDTH : place - LOBE].sum() + power[place + LOBE + 1 : place + WIDTH + 1].sum() > BROAD * own:
            searched[near] = False
            continue
        rate, after = nearest_sine(spectrum, place, count)
        if after < LEFT * own:
            both = np.column_stack([np.cos(rate * time), np.sin(rate * time)])
            shown = both * taper
            left = left - both @ np.linalg.lstsq(shown.T @ shown, shown.T @ (left * taper))[0]
            spectrum = rfft(left / size * taper, axis=0)
        else:
            searched[near] = False
    return np.asarray(left)


def nearest_sine(spectrum: NDArray[np.complex128], place: int, count: int) -> tuple[float, float]:
    """Return the frequency of the sine nearest to a peak [rad/sample], and the power that it leaves of that.

    The ordinates about the peak, turned back into a slow complex series, have all that a sine shows: some sixty
    numbers in the place of the record.

    Parameters
    ----------
    spectrum
        Fourier transform of series under a Hann window, shape (count // 2 + 1, n).
    place
        Ordinate of the peak.
    count
        Samples of the series.
    """
    half = min(BAND, count // 4)
    offset = np.fft.fftfreq(2 * half, 1 / (2 * half))
    ordinate = (place + offset.astype(np.int64)) % count
    mirrored = ordinate > count // 2
    seen = spectrum[np.where(mirrored, count - ordinate, ordinate)]
    slow = np.fft.ifft(np.where(mirrored[:, None], seen.conj(), seen), axis=0)
    sample = np.arange(2 * half) * (count / (2 * half))
    taper, centred = np.sin(np.pi * sample / count) ** 2, sample - 0.5 * (count - 1)
    rate = 2 * np.pi * place / count
    for _ in range(TURNS):
        sine = taper * np.exp(1j * (rate - 2 * np.pi * place / count) * centred)
        size, growth = np.linalg.lstsq(np.column_stack([sine, sine * centred / count]), slow)[0]
        # c exp(iwt) of a little other frequency: its slope is i t c exp(iwt)
        shift = np.sum(np.imag(growth * size.conj())) / (np.sum(np.abs(size) ** 2) + 1e-300) / count
        rate += float(np.clip(shift, -np.pi / count, np.pi / count))
    sine = taper * np.exp(1j * (rate - 2 * np.pi * place / count) * centred)
    rest = np.fft.fft(slow - np.outer(sine, sine.conj() @ slow) / (sine @ sine.conj()), axis=0)
    return rate, float(np.sum(np.abs(rest[np.abs(offset) <= WIDTH]) ** 2))
