"""A spectrum of segments: constant levels between edges, as many as the reading's periodogram gives evidence for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.spectra.periodogram import FEWEST_ORDINATES, FINENESS, Periodogram, Spectrum, leaked
from aerobalance.recording.channel import Array

CHANGE_EVIDENCE: Final = 10.0
"""Logarithm of the likelihood that a change of level must bring: 10 is safe, at 7 noise is taken for force."""

WORTH: Final = 4.0
"""Logarithm of the likelihood that a segment must bring over no force in it."""

FAINTEST: Final = 1e-2
"""Lowest level that is looked for: over the noise, where the balance shows the force best."""

LEVELS_A_DECADE: Final = 20
"""Levels that are tried in a factor of ten."""

BROAD: Final = 0.1
"""Share of the band in which the balance strengthens the force that a level must fill to count as no line."""

LEAK: Final = 40
"""Ordinates on either side of an edge between which the window leaks noticeably."""


def fit_segments(periodogram: Periodogram, noise: float, _start: Spectrum) -> Spectrum:
    """The segments of constant level that are most likely at the price of a change, by dynamic programming.

    Where the balance weakens the force, no level is allowed above those elsewhere (lines apart): there the reading's
    color, hum and other modes would be taken for a force, and enlarged by 1 / |G|.
    """
    gain, background = periodogram.gain, periodogram.background(noise)
    levels, cost = _costs(periodogram, background)
    strong = gain >= 1
    if strong.any():
        below = levels[_cheapest(cost[strong])]
        order = np.argsort(-below)
        share = np.cumsum(periodogram.weight[strong][order]) / np.sum(periodogram.weight[strong])
        highest = below[order][np.searchsorted(share, BROAD)]
        cost[np.ix_(~strong, levels > highest)] = np.inf
    path = _cheapest(cost)
    first = np.concatenate([[0], np.flatnonzero(np.diff(path)) + 1])
    last = np.append(first[1:], gain.size)
    found = [
        _level(periodogram, slice(a, b), background, float(levels[path[a]])) for a, b in zip(first, last, strict=True)
    ]
    kept = np.append(np.diff(found) != 0, True)
    edges = (periodogram.frequency[last - 1] + periodogram.frequency[np.minimum(last, gain.size - 1)]) / 2
    edges[-1] = 0.5 / periodogram.interval
    rough = Spectrum(edges[kept], np.array(found)[kept])
    rough = pruned(rough, lambda spectrum: periodogram.log_likelihood(periodogram.load(spectrum), noise), worth=WORTH)
    return _sharpened(rough, periodogram, noise)


def pruned(spectrum: Spectrum, likelihood: Callable[[Spectrum], float], *, worth: float) -> Spectrum:
    """The spectrum without segments that what the window leaks from others, or the noise, explains as well."""
    here = likelihood(spectrum)
    for place in reversed(range(spectrum.levels.size)):
        levels = spectrum.levels.copy()
        levels[place] = 0.0
        kept = np.append(np.diff(levels) != 0, True)
        shorter = Spectrum(spectrum.edges[kept], levels[kept])
        without = likelihood(shorter)
        if here - without < worth:
            spectrum, here = shorter, without
    return spectrum


def _costs(periodogram: Periodogram, background: Array) -> tuple[Array, Array]:
    """Levels that are tried, none first, shape (l,), and for each average what each costs, shape (m, l)."""
    gain, density, weight = periodogram.gain, periodogram.density, periodogram.weight
    least = FAINTEST * float(np.min(background / gain))
    most = max(float(np.max(density / gain)), 10 * least)
    levels = np.geomspace(least, most, int(LEVELS_A_DECADE * np.log10(most / least)) + 2)
    levels = np.concatenate([[0.0], levels])
    model = gain[:, None] * levels + background[:, None]
    return levels, weight[:, None] * (np.log(model) + density[:, None] / model)


def _cheapest(cost: Array) -> NDArray[np.int64]:
    """Column for each row of a table of costs, so that all together with `CHANGE_EVIDENCE` a change are least."""
    came = np.empty(cost.shape, dtype=np.int64)
    total = cost[0]
    stay = np.arange(cost.shape[1])
    for row in range(1, cost.shape[0]):
        best = int(np.argmin(total))
        change = total[best] + CHANGE_EVIDENCE
        came[row] = np.where(total <= change, stay, best)
        total = np.minimum(total, change) + cost[row]
    path = np.empty(cost.shape[0], dtype=np.int64)
    path[-1] = np.argmin(total)
    for row in range(cost.shape[0] - 1, 0, -1):
        path[row - 1] = came[row, path[row]]
    return path


def _sharpened(spectrum: Spectrum, periodogram: Periodogram, noise: float) -> Spectrum:
    """The edges placed again among single ordinates, with what the window leaks across them."""
    frequency, density, gain = periodogram.ordinates
    color = np.zeros(frequency.size) if periodogram.color is None else periodogram.color
    step = frequency[1] - frequency[0]
    edges = spectrum.edges.copy()
    widths = np.diff(np.append(0.0, spectrum.edges)) / step
    for place in range(edges.size - 1):
        if min(widths[place : place + 2]) < LEAK:
            continue  # a line: its edges are not seen one by one
        middle = float((edges[place] - frequency[0]) / step)
        width = max(FEWEST_ORDINATES, int(FINENESS * middle))
        part = slice(max(round(middle) - 2 * width - LEAK, 0), round(middle) + 2 * width + LEAK)
        index = np.arange(frequency.size)[part]
        tried = np.arange(middle - width - LEAK // 2, middle + width, 0.25)
        tried = tried[tried > 0]
        share = leaked(index - tried[:, None])
        below, above = spectrum.levels[place : place + 2]
        model = gain[part] * (below + (above - below) * share + periodogram.input_density) + noise + color[part]
        cost = np.sum(np.log(model) + density[part] / model, axis=1)
        edges[place] = frequency[0] + step * tried[np.argmin(cost)]
    return replace(spectrum, edges=edges)


def _level(periodogram: Periodogram, part: slice, background: Array, start: float) -> float:
    """Most likely level of one segment, by Fisher scoring from a level of the grid; 0 if it is not worth it."""
    gain, density, weight = periodogram.gain[part], periodogram.density[part], periodogram.weight[part]
    noise, level, reach = background[part], start, 10 ** (1 / LEVELS_A_DECADE)
    for _ in range(5 if start else 0):
        model = gain * level + noise
        slope = weight @ (gain * (density - model) / model**2)
        step = float(slope / (weight @ (gain / model) ** 2))
        level = float(np.clip(level + step, start / reach, start * reach))
    model = gain * level + noise
    worth = weight @ (np.log(noise / model) + density * (1 / noise - 1 / model))
    return level if worth >= WORTH else 0.0
