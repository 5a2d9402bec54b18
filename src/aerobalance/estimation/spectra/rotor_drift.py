"""How the speed of a rotor drifts, by the phase of its harmonics."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from aerobalance.estimation.spectra.line_search import BY_CHANCE, EVIDENCE, LineSearch
from aerobalance.estimation.spectra.steady_tones import BAND, LEFT, WIDTH
from aerobalance.recording.channel import Array

DRIFTING: Final = 300.0
"""Power of a line over that of its surroundings from which on its phase tells how a rotation drifts: to 0.1 rad at any
instant, of which a polynomial leaves a third."""

REACHES: Final = (4, 8, 16, 31)
"""Ordinates either side over which a line that drifts may be spread: as few as show it, as others are beside it."""

DEGREES: Final = (1, 2, 3, 4, 5, 6)
"""Degrees of the polynomial that its phase may be; the first is another frequency."""


def drift_of(left: LineSearch) -> tuple[float, ...]:
    """How the strongest line drifts (`turned_time`); none where it is steady, or is no line that drifts.

    Turned back to its middle, its readings are a slow series whose phase is that of a rotation: a polynomial. Of a
    resonance that a broad load keeps up phase and size change by chance, which leaves more of it than is allowed.
    """
    whole = left.whole
    count = whole.size
    spectrum = rfft(whole * left.taper)
    power = np.abs(spectrum) ** 2
    place = int(np.argmax(np.where(left.may_be, power, 0.0)))
    half = min(BAND, count // 4, place)
    if half < WIDTH:
        return ()
    beside = left.surroundings(power, place)
    offset = np.fft.fftfreq(2 * half, 1 / (2 * half))
    ordinate = place + offset.astype(np.int64)
    if ordinate.max() >= spectrum.size or power[place] < DRIFTING * beside:
        return ()
    x = np.linspace(-1, 1, 2 * half, endpoint=False)
    taper = np.cos(0.5 * np.pi * x) ** 2
    for reach in REACHES:
        near = np.abs(offset) <= min(reach, half - 1)
        slow = np.fft.ifft(np.where(near, spectrum[ordinate], 0.0))
        by_chance = BY_CHANCE * np.count_nonzero(near) * beside
        largest = max(LEFT * float(power[ordinate[near]].sum()), by_chance)
        before = _left_of(slow, taper, np.zeros(x.size), x, near)
        found: tuple[float, ...] = ()
        phase = np.unwrap(np.angle(slow))
        for degree in DEGREES:
            fitted = np.polynomial.polynomial.polyfit(x, phase, degree, w=np.abs(slow))
            course = np.asarray(np.polynomial.polynomial.polyval(x, fitted), dtype=np.float64)
            after = _left_of(slow, taper, course, x, near)
            if before - after > EVIDENCE / 3 * beside:
                found, before = tuple(fitted[1:].tolist()), after
        if before >= largest:
            continue
        if found:
            # of n samples from -1 to 1 the phase grows by pi (n - 1) / n of them an ordinate
            rate = np.pi * place + found[0]
            return tuple(power * number / rate for power, number in enumerate(found[1:], start=2))
        return ()
    return ()


def _left_of(slow: NDArray[np.complex128], taper: Array, phase: Array, x: Array, near: NDArray[np.bool_]) -> float:
    """Power that a line of some phase, shape (m,) [rad], whose size grows along the record leaves of a slow series."""
    line = taper * np.exp(1j * phase)
    shapes = np.column_stack([line, line * x])
    sizes, *_ = np.linalg.lstsq(shapes, slow)
    return float(np.sum(np.abs(np.fft.fft(slow - shapes @ sizes)[near]) ** 2))
