"""The line that the residuals of a fitted waveform still show: hum, or a mode that the fit lacks."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from aerobalance.identification.free_decay.waveform import DecayLine, Ring, projected
from aerobalance.recording.channel import Array

WIDTH: Final = 0.2
"""Width of the bands in which the level of a spectrum is taken, over their frequency."""

NARROWEST: Final = 32
"""Their least width [ordinates]."""

FALSE_ALARM: Final = 1e-6
"""Probability that white noise shows a line somewhere in the spectrum of the residuals."""

SHORTEST: Final = 64
"""Readings in the shortest part of a record that is looked at: a mode of some percent of damping dies in as many."""


def smooth_level(power: Array) -> Array:
    """Level of a spectrum without its lines, shape (k,): medians over bands a part of their frequency wide.

    Noise that grows toward low frequencies, or a broad hump, has a level of its own and no lines.
    """
    steps = np.maximum(WIDTH * np.arange(power.size), NARROWEST)
    edges, place = [1], 1
    while place < power.size:
        place = min(place + int(steps[place]), power.size)
        edges.append(place)
    if len(edges) > 2 and edges[-1] - edges[-2] < NARROWEST:
        edges.pop(-2)
    pairs = list(pairwise(edges))
    height = [np.log(np.median(power[first:last]) / np.log(2) + 1e-300) for first, last in pairs]
    middle = [0.5 * (first + last) for first, last in pairs]
    return np.asarray(np.exp(np.interp(np.arange(power.size), middle, height)))


def residual_line(ring: Ring) -> DecayLine | None:
    """The strongest line that the residuals still show, steady or decaying from the release; None if all is noise."""
    if ring.variance < (1e-9 * ring.amplitude) ** 2:
        return None
    centre = _strongest_line(ring)
    if centre is None:
        return None
    left, since = ring.residuals, np.maximum(ring.time - ring.start, 0.0)
    begun = ring.time >= ring.start
    best: tuple[float, DecayLine] | None = None
    for decay in (0.0, *(2 * np.pi * centre * np.geomspace(0.002, 0.1, 8))):
        for shift in np.linspace(-1, 1, 9) * max(1 / (ring.time[-1] - ring.time[0]), 0.2 * decay):
            w = 2 * np.pi * (centre + shift)
            fall = np.exp(-decay * since) * (begun if decay > 0 else 1.0)
            phase = w * (since if decay > 0 else ring.time - ring.time[0])
            remaining = projected(np.column_stack([fall * np.cos(phase), fall * np.sin(phase)]), left)[1]
            squares = float(remaining @ remaining)
            if best is None or squares < best[0]:
                best = squares, DecayLine(centre + shift, decay)
    return best[1] if best else None


def _strongest_line(ring: Ring) -> float | None:
    """Frequency of the most significant peak of the residual spectrum [Hz], over the record and shortly after release.

    A mode that dies quickly stands out only of a short stretch, hum only of a long one.
    """
    first = int(np.searchsorted(ring.time, ring.start))
    after = ring.time.size - first
    counts = (max(after // part, SHORTEST) for part in (4, 16, 64))
    stretches = [slice(0, ring.time.size), *(slice(first, first + count) for count in counts)]
    best: tuple[float, float] | None = None
    for stretch in stretches:
        left = ring.residuals[stretch]
        if left.size < SHORTEST:
            continue
        duration = left.size / ring.rate
        power = np.abs(np.fft.rfft(left - left.mean(), 2 * left.size)) ** 2
        frequency = np.fft.rfftfreq(2 * left.size, 1 / ring.rate)
        level = np.maximum(smooth_level(power), left.size * ring.variance)
        power[: int(np.searchsorted(frequency, 4 / duration))] = 0.0
        width = max(5 * ring.decay / (2 * np.pi), 4 / duration)
        power[np.abs(frequency - ring.frequency) < width] = 0.0  # what is left there is the first mode's own residual
        power /= level
        place = int(np.argmax(power))
        significance = power[place] + np.log(FALSE_ALARM / left.size)
        if significance > 0 and (best is None or significance > best[0]):
            best = float(significance), float(frequency[place])
    return best[1] if best else None
