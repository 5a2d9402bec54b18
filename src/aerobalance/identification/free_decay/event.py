"""Where a ringing begins, before anything is fitted: the strongest line of a record and its sharpest onset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.recording.resampling import interpolate_gaps_linearly

Shape = Literal["release", "ramp", "free"]

CANDIDATES: Final = 3
"""Lines of the spectrum among which the ringing with the sharpest onset is taken."""

SIDELOBES: Final = 0.2
"""Distance, in the logarithm of frequency, within which a peak is taken for a sidelobe of a stronger one."""

APART: Final = 8
"""Distance of two peaks of the spectrum, at least [ordinates of a record padded to twice its length]."""


@dataclass(frozen=True, slots=True)
class Look:
    """Where to start: shape, frequency [Hz], decay rate [1/s], instant of release [s] and sampling rate [Hz]."""

    shape: Shape
    frequency: float
    decay: float
    start: float
    rate: float


def first_look(values: Array, *, rate: float, name: str) -> Look:
    """Find the strongest ringing of a record and the instant at which it begins.

    Raises
    ------
    FitError
        Nothing rings: no line stands out of the spectrum.
    """
    filled = interpolate_gaps_linearly(values)
    candidates = _peaks(filled, rate, name)
    looks = [_onset(filled, frequency, rate) for frequency in candidates]
    return max(looks, key=lambda pair: pair[1])[0]


def _peaks(values: Array, rate: float, name: str) -> list[float]:
    """The strongest lines of a record's increments, in which a step is no more than an impulse [Hz]."""
    change = np.diff(values)
    change = change - change.mean()
    spectrum = np.abs(np.fft.rfft(change, 2 * change.size)) ** 2
    frequency = np.fft.rfftfreq(2 * change.size, 1 / rate)
    lowest = int(np.searchsorted(frequency, 3 * rate / values.size))
    spectrum[: max(lowest, 2)] = 0.0
    # white noise grows with frequency in the increments: weigh it flat before comparing
    flat = spectrum / np.maximum(np.sin(np.pi * frequency / rate), 1e-6) ** 2
    flat[: max(lowest, 2)] = 0.0
    floor = float(np.median(flat[max(lowest, 2) :]))
    peaks = _maxima(flat, above=30 * max(floor, np.finfo(float).tiny))
    if peaks.size == 0:
        raise FitError(
            f"{name}: nothing rings: no line of the spectrum stands out of the noise; is the release in the record?"
        )
    chosen: list[float] = []
    for place in peaks[np.argsort(spectrum[peaks])[::-1]]:
        if all(abs(np.log(frequency[place] / other)) > SIDELOBES for other in chosen):
            chosen.append(float(frequency[place]))
        if len(chosen) == CANDIDATES:
            break
    return chosen


def _maxima(values: Array, *, above: float) -> NDArray[np.intp]:
    """Places of the local maxima above a level, ascending; of those closer than `APART` only the highest."""
    inner = values[1:-1]
    places = 1 + np.flatnonzero((inner > values[:-2]) & (inner >= values[2:]) & (inner > above))
    free = np.ones(values.size, dtype=bool)
    kept = []
    for place in places[np.argsort(values[places], kind="stable")[::-1]]:
        if free[place]:
            kept.append(place)
            free[max(place - APART + 1, 0) : place + APART] = False
    return np.sort(np.array(kept, dtype=np.intp))


def _moving_mean(values: NDArray[Any], width: int) -> NDArray[Any]:
    """Mean of each `width` values in a row, shape (n - width + 1,)."""
    sums = np.concatenate((values[:1] * 0, np.cumsum(values)))
    return np.asarray((sums[width:] - sums[:-width]) / width)


def _onset(values: Array, frequency: float, rate: float) -> tuple[Look, float]:
    """Where the ringing at a frequency begins, how it decays, and how much its envelope rises there."""
    width = max(round(2 * rate / frequency), 4)
    carrier = np.exp(-2j * np.pi * frequency * np.arange(values.size) / rate)
    centred = values - _moving_mean(np.pad(values, width, mode="edge"), 2 * width + 1)
    late = (width - 1) // 2
    envelope = 2 * np.abs(_moving_mean(np.pad(centred * carrier, (width - 1 - late, late)), width))
    mean = np.cumsum(np.concatenate(([0.0], envelope)))
    span = min(3 * width, values.size // 3)
    places = np.arange(span, values.size - span)
    rise = (mean[places + span] - 2 * mean[places] + mean[places - span]) / span
    place = int(places[np.argmax(rise)]) if places.size else 0
    head = float(envelope[:span].mean())
    released = bool(rise.size and rise.max() > head)
    first = place if released else 0
    tail = envelope[first + width :]
    floor = float(np.median(envelope[-max(width, envelope.size // 10) :]))
    above = np.flatnonzero(tail < max(3 * floor, 0.05 * float(np.max(tail[: width + 1], initial=0.0))))
    count = int(above[0]) if above.size else tail.size
    if count > 8 and tail.size > 8:
        slope = np.polyfit(np.arange(count) / rate, np.log(np.maximum(tail[:count], 1e-300)), 1)[0]
    else:
        slope = -0.05 * 2 * np.pi * frequency
    decay = float(np.clip(-slope, 1e-5 * frequency, 4 * frequency))
    strength = float(rise.max()) if released else head
    return Look("release" if released else "free", frequency, decay, first / rate, rate), strength
