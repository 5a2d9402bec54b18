"""A spectrum of segments: constant levels between edges, as many as the reading's periodogram gives evidence for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.spectra.level_costs import Costs, Singles, cheapest_columns
from aerobalance.estimation.spectra.periodogram import FEWEST_ORDINATES, FINENESS, Periodogram, Spectrum
from aerobalance.estimation.spectra.windows import leaked
from aerobalance.recording.channel import Array

CHANGE_EVIDENCE: Final = 10.0
"""Logarithm of the likelihood that a change of level must bring: 10 is safe, at 7 noise is taken for force."""

WORTH: Final = 4.0
"""Logarithm of the likelihood that a segment must bring over no force in it."""

FAINTEST: Final = 1e-2
"""Lowest level that is looked for: over the noise, where the balance shows the force best."""

LEVELS_A_DECADE: Final = 20
"""Levels that are tried in a factor of ten."""

LINES: Final = 0.1
"""Share of the band in which the balance strengthens the force that a level must fill to count as no line."""

WIDE: Final = 0.3
"""Width over its lowest frequency from which on a force far above resonance is no mode that the dynamics lack."""

BROAD: Final = 16.0
"""Independent ordinates from which on a segment of noise is no line, and not what the window leaks at an edge."""

WEAKENED: Final = 1.0
"""Square of the response below which a force and the color of a noise can be told apart."""

LEAK: Final = 40
"""Ordinates on either side of an edge between which the window leaks noticeably."""

FAR: Final = 128
"""Most ordinates on either side of an edge that are looked at for what leaks: enough for a force 1e11 times as strong
as the noise, as it is in a record without any."""

LEAKS: Final = 1e-4
"""Density that leaks over that of the noise from which on an ordinate is looked at for it."""

TAILS: Final = 4
"""Last segments from whose lower edges on a tail is tried."""

TAIL_POWERS: Final = (4.0, 5.0, 6.0, 8.0)
"""Powers of frequency as which a tail may fall: 4 after kinks, more near the band that it ends; 2 is that of steps,
which are looked for one by one and would be hidden by it."""

TAIL_BESIDE: Final = 10
"""Ordinates from which on a segment is no line."""

TAIL_STEPS: Final = 8
"""Steps of Fisher scoring of its level at most."""

TAIL_ENOUGH: Final = 0.01
"""Relative change of the level at which they end: a twentieth of its standard uncertainty or less."""

_LEAKED: Final = leaked(-np.arange(FAR, dtype=np.float64))
"""Share of the window's power beyond an edge so many ordinates away, falling."""

SAME: Final = 1e-9
"""Distance of two edges, in ordinates, over which the window leaks the same."""


def fit_segments(periodogram: Periodogram, noise: float, *, rising: bool = False) -> Spectrum:
    """The segments of constant level that are most likely at the price of a change, by dynamic programming.

    Where the balance weakens the force, no level is allowed above those elsewhere (lines apart), unless that was seen
    to be force before: hum, other modes and shocks would be taken for a force there, and enlarged by 1 / |G|.

    Parameters
    ----------
    periodogram
        Of the reading.
    noise
        Density of its noise [N^2/Hz].
    rising
        Whether the force may be stronger where the balance weakens it.
    """
    gain, background = periodogram.gain, periodogram.background(noise)
    weakened = np.zeros(gain.size, dtype=np.bool_) if rising else gain < WEAKENED
    levels = _levels(periodogram, background)
    if not weakened.all():  # above what all readings show of a force no level is likelier
        shown = float(np.max((periodogram.density / gain)[~weakened]))
        levels = levels[: int(np.searchsorted(levels, shown)) + 2]
    costs = Costs.of(periodogram.density, periodogram.weight, background)
    cost = costs.table(levels, gain=gain, where=~weakened)
    if weakened.any():
        allowed = int(np.count_nonzero(levels <= _highest(periodogram, levels, cost[~weakened])))
        costs.write(cost, gain, levels[:allowed], weakened)
    path = cheapest_columns(cost, CHANGE_EVIDENCE)
    first = np.concatenate([[0], np.flatnonzero(np.diff(path)) + 1])
    last = np.append(first[1:], gain.size)
    found = [
        _level(periodogram, slice(a, b), background, float(levels[path[a]])) for a, b in zip(first, last, strict=True)
    ]
    kept = np.append(np.diff(found) != 0, True)
    edges = (periodogram.frequency[last - 1] + periodogram.frequency[np.minimum(last, gain.size - 1)]) / 2
    edges[-1] = 0.5 / periodogram.interval
    rough = Spectrum(edges[kept], np.array(found)[kept])
    rough = pruned(rough, periodogram, lambda load: periodogram.log_likelihood(load, noise), worth=WORTH)
    return sharpened(rough, periodogram, noise)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseLevels:
    """What the readings show where the balance weakens a force.

    Attributes
    ----------
    density
        Density of the noise of each average, shape (m,) [N^2/Hz].
    seen
        Where it is seen and not hidden by a force, shape (m,).
    rising
        Lowest frequency of a force that is stronger than any where the balance does not weaken it [Hz]; infinite for
        none.
    """

    density: Array
    seen: NDArray[np.bool_]
    rising: float = np.inf


def fit_noise_levels(periodogram: Periodogram, noise: float) -> NoiseLevels:
    """Density of the noise of each average if segments of force and segments of noise are alike [N^2/Hz].

    Above the natural frequency a segment is either a force of constant level, which the reading shows as |G|^2, or a
    noise of constant level: whichever needs fewer changes of level. Where the force hides the noise it is as above.

    Parameters
    ----------
    periodogram
        Of the reading.
    noise
        Density of the noise beside a force [N^2/Hz].
    """
    weight, density, fixed = periodogram.weight, periodogram.density, periodogram.background(0.0)
    weakened = periodogram.gain < WEAKENED
    found = np.full(weight.size, noise)
    if not weakened.any():
        return NoiseLevels(found, weakened)
    background = periodogram.background(noise)
    levels = _levels(periodogram, background)
    costs = Costs.of(density, weight, background)
    cost = costs.table(levels, gain=periodogram.gain)
    least = max(float(density[weakened].min()), 1e-6 * noise)
    most = max(float(density[weakened].max()), 2 * least)
    count = int(LEVELS_A_DECADE * np.log10(most / least)) + 2
    alone = costs.beside(fixed).table(np.geomspace(least, most, count), where=weakened)
    force = cost.shape[1]
    table = np.hstack([cost, alone])
    while True:
        path = cheapest_columns(table, CHANGE_EVIDENCE)
        first = np.concatenate([[0], np.flatnonzero(np.diff(path)) + 1])
        parts = [slice(a, b) for a, b in zip(first, np.append(first[1:], path.size), strict=True)]
        means = [float(np.average(density[part] - fixed[part], weights=weight[part])) for part in parts]
        noises = np.array([path[part.start] >= force for part in parts])
        level = np.where(noises, means, 0.0)
        beside = np.maximum(np.maximum.accumulate(level), np.maximum.accumulate(level[::-1])[::-1])
        hidden = [
            part
            for part, mean, other in zip(parts, means, beside, strict=True)
            if 0 < path[part.start] < force and weakened[part.start] and mean < other
        ]
        if not hidden:
            break
        # fainter than the noise elsewhere: more likely the noise that falls there, as behind the filter of a converter
        for part in hidden:
            table[part, 1:force] = np.inf
    seen = np.zeros(path.size, dtype=np.bool_)
    around = np.concatenate([[np.inf], means, [np.inf]])
    fainter = around[1:-1] < np.minimum(
        around[:-2], around[2:]
    )  # than both beside it: no line, and nothing that leaks
    for part, mean, noisy, low in zip(parts, means, noises, fainter, strict=True):
        if noisy and (low or float(np.sum(weight[part])) >= BROAD):
            found[part], seen[part] = max(mean, 0.0), True
    # a force hides the noise: it is taken for what it is above that, or else below
    shown = periodogram.gain * np.append(levels, np.zeros(count))[path]
    quiet = (path < force) & (shown < noise)
    if quiet.any():
        found[quiet] = max(float(np.average((density - fixed - shown)[quiet], weights=weight[quiet])), noise / 2)
    seen |= quiet
    known = np.flatnonzero(seen)
    if known.size:
        after = np.minimum(np.searchsorted(known, np.arange(path.size)), known.size - 1)
        found = found[known[after]]
    strong = np.append(levels, np.zeros(count))[path] > _highest(periodogram, levels, cost[~weakened])
    rising = weakened & strong & (shown > noise)
    above = float(periodogram.frequency[rising][0]) if rising.any() else np.inf
    wide = periodogram.step * float(np.sum(periodogram.count[rising]))
    return NoiseLevels(found, seen, above if wide > WIDE * above else np.inf)


def _highest(periodogram: Periodogram, levels: Array, cost: Singles) -> float:
    """Highest level of the force, lines apart, where the balance does not weaken it [N^2/Hz], by the costs there."""
    strong = periodogram.gain >= WEAKENED
    if not strong.any():
        return np.inf
    weight, below = periodogram.weight[strong], levels[cheapest_columns(cost, CHANGE_EVIDENCE)]
    order = np.argsort(-below)
    share = np.cumsum(weight[order]) / np.sum(weight)
    return float(below[order][np.searchsorted(share, LINES)])


def with_tail(spectrum: Spectrum, periodogram: Periodogram, noise: float) -> Spectrum:
    """The spectrum, its last segments one that falls as a power of frequency where that has more evidence.

    So falls a force with kinks, far beyond the frequency from which on noise hides it. A constant level there is the
    one of the frequencies at which it is seen, and at those above many times that of the force.
    None is tried where the ends of a record are weighed as its middle: what leaks of a sweep that ends there falls
    like a tail.

    Parameters
    ----------
    spectrum
        The segments.
    periodogram
        Of the reading.
    noise
        Density of its noise [N^2/Hz].
    """
    if periodogram.even:
        return spectrum
    price = 0.5 * float(np.log(np.sum(periodogram.weight)))
    width = np.diff(spectrum.edges, prepend=0.0)
    best = spectrum
    most = periodogram.log_likelihood(periodogram.load(spectrum), noise) - price * spectrum.parameters
    if spectrum.levels.size and not spectrum.levels[-1]:
        most += WORTH  # a tail is a force where none is seen
    for last in np.flatnonzero(spectrum.levels)[-TAILS:]:
        # it falls from what is there, unless that is a line: what a transient leaves beside one is no force
        if last == 0 or not spectrum.levels[last - 1] or width[last - 1] < TAIL_BESIDE * periodogram.step:
            continue
        found, likelihood = _fallen(spectrum, int(last), periodogram, noise)
        here = likelihood - price * found.parameters
        if here > most:
            best, most = found, here
    return best


def _fallen(spectrum: Spectrum, last: int, periodogram: Periodogram, noise: float) -> tuple[Spectrum, float]:
    """The spectrum with the likeliest tail from a segment on, no higher than what is before it; its log-likelihood."""
    edges, below = np.append(spectrum.edges[:last], 0.5 / periodogram.interval), spectrum.levels[:last]
    without = periodogram.load(Spectrum(edges, np.append(below, 0.0)))
    flat = periodogram.load(Spectrum(edges, np.append(below, 1.0))) - without
    fixed, density, weight = without + periodogram.background(noise), periodogram.density, periodogram.weight
    # all powers at once, shape (p, m)
    powers = np.array(TAIL_POWERS)
    shape = flat * np.exp(-np.outer(powers, np.log(np.maximum(periodogram.frequency / edges[-2], 1.0))))
    level = np.full(powers.size, min(float(spectrum.levels[last]), float(below[-1])))
    for _ in range(TAIL_STEPS):
        inverse = 1 / (shape * level[:, None] + fixed)
        shown = shape * inverse
        step = (shown * (density * inverse - 1)) @ weight / (shown**2 @ weight)
        moved = np.clip(np.clip(level + step, level / 4, 4 * level), 0.0, below[-1])
        if np.max(np.abs(moved / level - 1)) < TAIL_ENOUGH:
            break
        level = moved
    model = shape * level[:, None] + fixed
    likelihood = -(np.log(model) + density / model) @ weight
    chosen = int(np.argmax(likelihood))
    found = Spectrum(edges, np.append(below, level[chosen]), tail=float(powers[chosen]))
    return found, float(likelihood[chosen])


def pruned(
    spectrum: Spectrum, periodogram: Periodogram, likelihood: Callable[[Array], float], *, worth: float
) -> Spectrum:
    """The spectrum without segments that what the window leaks from others, or the noise, explains as well.

    Parameters
    ----------
    spectrum, periodogram
        The segments, and the reading.
    likelihood
        Logarithm of the likelihood of a density of the load, shape (m,) [N^2/Hz].
    worth
        What a segment must bring of it.
    """
    levels = spectrum.levels.copy()
    above = [periodogram.gain, *(periodogram.gain_above(float(edge)) for edge in spectrum.edges[:-1])]
    felt = [
        level * np.maximum(here - beyond, 0.0)
        for level, here, beyond in zip(levels, above, [*above[1:], np.zeros(periodogram.gain.size)], strict=True)
    ]
    load = np.sum(felt, axis=0)
    here = likelihood(load)
    for place in reversed(np.flatnonzero(levels)):
        # what is left of a difference is no density below zero
        fewer = np.maximum(load - felt[place], 0.0)
        without = likelihood(fewer)
        if here - without < worth:
            levels[place], load, here = 0.0, fewer, without
    kept = np.append(np.diff(levels) != 0, True)
    return Spectrum(spectrum.edges[kept], levels[kept])


def _levels(periodogram: Periodogram, background: Array) -> Array:
    """Levels that are tried, none first, shape (l,)."""
    least = FAINTEST * float(np.min(background / periodogram.gain))
    most = max(float(np.max(periodogram.density / periodogram.gain)), 10 * least)
    levels = np.geomspace(least, most, int(LEVELS_A_DECADE * np.log10(most / least)) + 2)
    return np.concatenate([[0.0], levels])


def sharpened(spectrum: Spectrum, periodogram: Periodogram, noise: float) -> Spectrum:
    """The edges placed again among single ordinates, with what the window leaks across them."""
    first, step = float(periodogram.ordinates[0, 0]), periodogram.step
    places = (np.append(0.0, spectrum.edges) - first) / step
    for below in range(1, places.size - 1):
        left, middle, right = places[below - 1 : below + 2]
        if min(middle - left, right - middle) < LEAK:
            continue  # a line: its edges are not seen one by one
        width = max(FEWEST_ORDINATES, int(FINENESS * middle))
        reach = 2 * width + LEAK
        # not beyond the segments on either side: what is in the next ones would pull at this edge
        part = slice(max(round(middle) - reach, round(left), 0), min(round(middle) + reach, round(right)))
        cost = _EdgeCost.of(periodogram, spectrum.levels[below - 1 : below + 1], noise, part=part)
        tried = np.arange(middle - width - LEAK // 2, middle + width, 1.0)
        near = cost.best(tried[(tried > max(left, 0.0)) & (tried < right)])
        places[below] = cost.best(near + np.arange(-1.0, 1.25, 0.25))
    edges = np.append(first + step * places[1:-1], spectrum.edges[-1])
    return replace(spectrum, edges=edges)


@dataclass(frozen=True, slots=True, eq=False)
class _EdgeCost:
    """Less the log-likelihood of single ordinates about an edge between two levels.

    Attributes
    ----------
    start
        First ordinate that counts.
    density, gain, background
        Density of the reading, gain, and density of what is no force, of those from it on, shape (n,).
    weight
        One for each of them that counts, zero for others, shape (n,).
    levels
        Densities of the force below the edge and above it.
    below, above
        Costs of the ordinates before each one if they lie below the edge, and above it, shape (n + 1,).
    """

    start: int
    density: Array
    gain: Array
    background: Array
    weight: Array
    levels: Array
    below: Array
    above: Array

    @classmethod
    def of(cls, periodogram: Periodogram, levels: Array, noise: float, *, part: slice) -> _EdgeCost:
        """Take a part of the ordinates."""
        _, density, gain = periodogram.ordinates
        density, gain = density[part], gain[part]
        background = gain * periodogram.input_density + noise
        if periodogram.color is not None:
            background = background + periodogram.color[part]
        weight = np.ones(density.size) if periodogram.counted is None else periodogram.counted[part]
        models = gain * levels[:, None] + background
        below, above = np.cumsum(weight * (np.log(models) + density / models), axis=1)
        return cls(part.start, density, gain, background, weight, levels, np.append(0.0, below), np.append(0.0, above))

    @property
    def reach(self) -> int:
        """Ordinates on either side of the edge within which the force that leaks is no less than a trace of noise."""
        most = abs(float(self.levels[1] - self.levels[0])) * float(np.max(self.gain / self.background))
        return min(int(np.count_nonzero(_LEAKED * most > LEAKS)) + 1, FAR)

    def best(self, tried: Array) -> float:
        """The edge of least cost among some that are tried, in ordinates from the first."""
        reach = self.reach
        count, below, about = self.density.size, np.floor(tried), np.arange(1 - reach, reach + 1)
        near = below.astype(np.int64)[:, None] - self.start + about
        inside = (near >= 0) & (near < count)
        near = np.minimum(np.maximum(near, 0), count - 1)
        above = tried - below
        if float(above.max() - above.min()) < SAME:  # they are whole ordinates apart
            above = above[:1]
        share = leaked(about - above[:, None])
        force = self.levels[0] + (self.levels[1] - self.levels[0]) * share
        model = self.gain[near] * force + self.background[near]
        cost = np.sum(np.where(inside, self.weight[near], 0.0) * (np.log(model) + self.density[near] / model), axis=1)
        first, last = near[:, 0], near[:, -1] + 1
        cost += self.below[first] + self.above[-1] - self.above[last]
        return float(tried[np.argmin(cost)])


def _level(periodogram: Periodogram, part: slice, background: Array, start: float) -> float:
    """Most likely level of one segment, by Fisher scoring from a level of the grid; 0 if it is not worth it."""
    gain, density, weight = periodogram.gain[part], periodogram.density[part], periodogram.weight[part]
    noise, level, reach = background[part], start, 10 ** (1 / LEVELS_A_DECADE)
    for _ in range(5 if start else 0):
        model = gain * level + noise
        slope = weight @ (gain * (density - model) / model**2)
        step = float(slope / (weight @ (gain / model) ** 2))
        level = min(max(level + step, start / reach), start * reach)
    model = gain * level + noise
    worth = weight @ (np.log(noise / model) + density * (1 / noise - 1 / model))
    return level if worth >= WORTH else 0.0
