"""How the speed of a rotor drifts, by the phase of its harmonics.

The strongest shows a drift that spreads it over some ordinates; less than that all show together, as the same number.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from aerobalance.estimation.spectra.line_search import BY_CHANCE, EVIDENCE, LineSearch
from aerobalance.estimation.spectra.steady_tones import BAND, LEFT, WIDTH
from aerobalance.estimation.spectra.windows import HANN_BANDWIDTH
from aerobalance.recording.channel import Array

DRIFTING: Final = 300.0
"""Power of a line over that of its surroundings from which on its phase tells how a rotation drifts: to 0.1 rad at any
instant, of which a polynomial leaves a third."""

REACHES: Final = (4, 8, 16, 31)
"""Ordinates either side over which a line that drifts may be spread: as few as show it, as others are beside it."""

DEGREES: Final = (1, 2, 3, 4, 5, 6)
"""Degrees of the polynomial that its phase may be; the first is another frequency."""

TOLD: Final = 8.0
"""Gain in log-likelihood from which on harmonics drift together: chance has it once in 20 000 records."""

ABOUT: Final = 8
"""Ordinates on either side of a harmonic in which a small drift shows: beyond, the window leaves 1e-5 of it."""


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


def drift_together(left: LineSearch, rates: Sequence[float]) -> tuple[float, ...]:
    """How tones drift that are all of one rotation (`turned_time`), to first order; none where chance may do as much.

    A drift d turns the phase of each by w d t^2 / T, with T the length of the record. What that leaves of the readings
    beside the tones as steady is regressed on it, each harmonic weighed by what is beside it. That its size and phase
    grow along the record, as with the balance's answer to another frequency, tells nothing.

    Parameters
    ----------
    left
        The readings less their tones.
    rates
        Those of the tones [rad/sample].
    """
    count = left.left.size
    spectrum = rfft(left.left * left.taper)
    power = np.abs(spectrum) ** 2
    score = information = 0.0
    for tone in left.tones:
        place = round(tone.rate * count / (2 * np.pi))
        half = min(BAND, count // 4, place, spectrum.size - 1 - place)
        if half <= WIDTH or min(abs(tone.rate - rate) for rate in rates) > np.pi / count:
            continue
        beside = left.surroundings(power, place)
        offset = np.fft.fftfreq(2 * half, 1 / (2 * half)).astype(np.int64)
        near = np.abs(offset) <= min(ABOUT, half - 1)
        # the readings about it, turned back to its ordinate, are a slow series of as many numbers
        sample = np.arange(2 * half) * (count / (2 * half))
        centred = sample - 0.5 * (count - 1)
        x = centred / (0.5 * (count - 1))
        away = tone.rate - 2 * np.pi * place / count
        line = np.sin(np.pi * sample / count) ** 2 * np.exp(1j * away * centred)
        phasor = complex(tone.sizes[0], -tone.sizes[1]) * np.exp(-1j * np.pi * place * (count - 1) / count)
        line *= 0.5 * phasor * count / (2 * half)
        steady = np.stack([np.ones_like(x), x])
        turning = 0.25j * tone.rate * (count - 1) * x**2
        shapes = np.fft.fft(line * np.concatenate([steady, 1j * steady, turning[None]]), axis=1)[:, near]
        seen = spectrum[place + offset][near]
        *known, drifting = np.concatenate([shapes.real, shapes.imag], axis=1)
        basis = np.column_stack(known)
        drifting = drifting - basis @ np.linalg.lstsq(basis, drifting)[0]
        score += float(drifting @ np.concatenate([seen.real, seen.imag])) / beside
        information += float(drifting @ drifting) / beside
    if information == 0 or score**2 < TOLD * HANN_BANDWIDTH * information:
        return ()
    return (score / information,)


def _left_of(slow: NDArray[np.complex128], taper: Array, phase: Array, x: Array, near: NDArray[np.bool_]) -> float:
    """Power that a line of some phase, shape (m,) [rad], whose size grows along the record leaves of a slow series."""
    line = taper * np.exp(1j * phase)
    shapes = np.column_stack([line, line * x])
    sizes, *_ = np.linalg.lstsq(shapes, slow)
    return float(np.sum(np.abs(np.fft.fft(slow - shapes @ sizes)[near]) ** 2))
