"""Single samples that are far from their neighbours: dropouts and spikes of a data acquisition.

A balance and its model pass nothing that is there for one sample only: a sudden force bends the reading, and a blow
gives it a kink, but neither puts one sample, or two or three, beside a smooth line through those before and after. So
each sample is compared with the cubic through the two samples on either side. What stands out of the local scatter by
far is taken for wild if a kink there does not explain it as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True)
class WildSampleSettings:
    """From which departure on a sample is wild.

    Attributes
    ----------
    departs
        Departure from the cubic through its neighbours over the local scatter of such departures. Of a million samples
        of Gaussian noise the largest is at 5.
    likelier
        Square of the local scatter by which a wild sample must explain the readings about it better than a kink, as a
        blow makes it, and a bend, as a sudden force does.
    longest
        Samples in a row that may be wild together.
    window
        Samples over which the scatter is judged.
    beside
        Samples on either side of one that is looked at, half of which depart as far where a mode rings that the
        samples follow in few steps a period.
    fewest
        Samples of a record from which on it is looked at.
    most
        Share of wild samples from which on the record is noisy, and none is wild.
    """

    departs: float = 9.0
    likelier: float = 30.0
    longest: int = 3
    window: int = 256
    beside: int = 24
    fewest: int = 64
    most: float = 0.02


SETTINGS: Final = WildSampleSettings()
"""Settings that are used."""

REACH: Final = 4
"""Samples on either side of a wild one that are looked at."""

SCATTER: Final = 1.4826
"""Standard deviation of Gaussian numbers over the median of their absolute values."""


def wild_samples(values: Array) -> NDArray[np.bool_]:
    """Return which readings are single samples far from their neighbours, shape (n,).

    Parameters
    ----------
    values
        Readings at even times, shape (n,); NaN where missing.
    """
    found = np.zeros(values.size, dtype=bool)
    if values.size < SETTINGS.fewest:
        return found
    departure = _departures(values)
    if not _some_stand_out(np.abs(departure)):
        return found
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    if not (steps > 0).any():
        return found
    # what has few steps scatters by one of them at least
    scatter = np.maximum(_scatter(departure), float(steps[steps > 0].min()))
    candidates = np.flatnonzero(np.abs(departure) > SETTINGS.departs * scatter)
    if not candidates.size or candidates.size > SETTINGS.most * values.size * (1 + 2 * REACH):
        return found
    # a mode of a quarter of the rate departs from any cubic, and dies away within a window after a step
    alone = np.abs(departure[candidates]) > SETTINGS.departs * _level_beside(departure, candidates)
    candidates = candidates[alone]
    for place in candidates[np.argsort(-np.abs(departure[candidates]))]:
        near = slice(max(place - REACH, 0), place + REACH + 1)
        if not found[near].any():
            found |= _wild_about(values, int(place), float(scatter[place]))
    return found if np.count_nonzero(found) <= SETTINGS.most * values.size else np.zeros_like(found)


def _departures(values: Array) -> Array:
    """Departure of each reading from the cubic through two on either side, 0 where one is missing, shape (n,)."""
    out = np.zeros(values.size)
    middle = out[2:-2]  # worked out in its place, as the readings are many
    np.add(values[1:-3], values[3:-1], out=middle)
    middle *= 4
    middle -= values[:-4] + values[4:]
    middle /= 6
    np.subtract(values[2:-2], middle, out=middle)
    finite = np.isfinite(out)
    return out if finite.all() else np.where(finite, out, 0.0)


def _windows(samples: int) -> NDArray[np.intp]:
    """First samples of the windows in which the scatter is judged, and the end of the last one."""
    return np.linspace(0, samples, max(samples // SETTINGS.window, 1) + 1).astype(np.intp)


def _some_stand_out(size: Array) -> bool:
    """Whether the departures of some window, of these sizes, may be wild; of most records none, which is soon known.

    Where more than half of a window exceed a part of its largest, so does its median: no median is needed.
    """
    edges = _windows(size.size)
    largest = np.maximum.reduceat(size, edges[:-1])
    part = largest / (SETTINGS.departs * SCATTER)
    exceed = np.add.reduceat(size > np.repeat(part, np.diff(edges)), edges[:-1], dtype=np.intp)
    return bool((2 * exceed <= np.diff(edges)).any())


def _scatter(departure: Array) -> Array:
    """Local standard deviation of departures, by the median of their absolute values in windows, shape (n,)."""
    size = np.abs(departure)
    edges = _windows(size.size)
    level = np.array([np.median(size[first:last]) for first, last in pairwise(edges)])
    # a shock of some samples is no reason to doubt a quiet window beside it: the larger of neighbours counts
    padded = np.concatenate([level[:1], level, level[-1:]])
    level = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    whole = float(np.median(size))
    return np.repeat(SCATTER * np.maximum(level, 0.1 * whole), np.diff(edges))


def _level_beside(departure: Array, places: NDArray[np.intp]) -> Array:
    """Standard deviation of the departures just before or just after places, whichever is larger, shape of places."""
    away = np.arange(REACH, REACH + SETTINGS.beside)  # beyond those that a wild sample at the place makes itself
    size = np.pad(np.abs(departure), REACH + SETTINGS.beside, mode="edge")
    middle = places[:, None] + REACH + SETTINGS.beside
    return np.asarray(SCATTER * np.maximum(*(np.median(size[middle + side * away], axis=1) for side in (-1, 1))))


def _wild_about(values: Array, place: int, scatter: float) -> NDArray[np.bool_]:
    """Which samples about a place are wild: one or few in a row, where a kink does not explain them as well."""
    found = np.zeros(values.size, dtype=bool)
    first, last = max(place - 2 * REACH, 0), min(place + 2 * REACH + 1, values.size)
    part = values[first:last]
    present = np.isfinite(part)
    if np.count_nonzero(present) < 2 * REACH:
        return found
    # noise of a reading: a departure has 1 + 2 (4/6)^2 + 2 (1/6)^2 of its variance
    noise = scatter / np.sqrt(1 + 34 / 36)
    time = np.arange(part.size) - float(place - first)
    smooth = np.vander(time / part.size, 6)

    def left(columns: Array) -> float:
        shown = np.column_stack([smooth, columns])[present]
        rest = part[present] - shown @ np.linalg.lstsq(shown, part[present])[0]
        return float(rest @ rest) / float(noise) ** 2

    def bent(shift: float) -> Array:
        since = np.maximum(time - shift, 0.0)
        return np.column_stack([since, since**2])

    kinks = [left(bent(shift)) for shift in np.arange(-2.0, 2.25, 0.25)]
    best, own = min(kinks), np.zeros(0, dtype=int)
    none = left(np.zeros((part.size, 0)))
    for length in range(1, SETTINGS.longest + 1):
        for begin in range(place - length, place + 2):  # beside two wild ones the departure is larger than at them
            samples = np.arange(begin, begin + length) - first
            if samples[0] < 0 or samples[-1] >= part.size:
                continue
            explained = left(np.eye(part.size)[:, samples])
            price = SETTINGS.likelier * length
            if explained + price < best and none - explained > SETTINGS.departs**2:
                best, own = explained + price - SETTINGS.likelier, samples
        if own.size:
            break
    found[own + first] = True
    return found
