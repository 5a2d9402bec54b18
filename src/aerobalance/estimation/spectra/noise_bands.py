"""Noise with edges, of a record of noise alone: levels and powers of frequency between them, and a 1/f part.

The filters of converters cut off sharply below half the sampling rate, and converters that shape their noise let it
rise as a power of frequency up to such a cut. Humps follow neither. Levels are found by dynamic programming at a price
for each change, runs of them that rise or fall are weighed as one power of frequency, and the edges are then placed
among single ordinates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.spectra._kernels import cheapest
from aerobalance.estimation.spectra.noise_ordinates import FINENESS, Ordinates
from aerobalance.estimation.spectra.noise_spectrum import EXPONENTS, Band
from aerobalance.estimation.spectra.piecewise_psd import CHANGE_EVIDENCE, LEVELS_A_DECADE
from aerobalance.recording.channel import Array

NUMBER_EVIDENCE: Final = CHANGE_EVIDENCE / 2
"""Gain in log-likelihood that each number must bring: a change has two, its level and its edge."""

STEEPEST: Final = 12.0
"""Largest exponent: converters of the fifth order shape the density of their noise as the tenth power of frequency."""

FINE: Final = 0.003
"""Width of an average over its frequency where levels are looked for."""

LEAKS: Final = 12
"""Ordinates on either side of an edge that tell no level: the window leaks less than 1e-5 of a band so far."""

NARROW: Final = 32
"""Ordinates that are a band at least: what is narrower is a line, or what the window leaks at an edge."""

SHARPEST: Final = 0.014
"""Width of a band over its frequency at least: a shaping filter widens both edges by half of it."""

RUN: Final = 3
"""Levels, one above the other, from which on a power of frequency is tried for them."""

STEPS: Final = 12
"""Steps of scoring at most, by which its level and exponent are found."""

ENOUGH: Final = 1e-3
"""Change of both in a step at which they end; gain expected of a step of all numbers at which these end."""

LEAST_OF_A_RUN: Final = 0.02
"""Part of its strongest level that a run has anywhere, to begin with."""

MOST_STEPS: Final = 60
"""Steps of scoring at most, by which all numbers are found."""

FIRST_DAMPING: Final = 1e-3
"""Damping of the first of them, over the information; a tenth of it after a step that gains, else ten times it."""

MOST_DAMPING: Final = 1e6
"""Damping from which on no step gains anything."""

TINY: Final = 1e-9
"""Information that is added: of a part that is hidden the record tells nothing; and least exponent of a power."""

LONGEST: Final = 1.5
"""Change of a logarithm in one step at most."""

ENOUGH_FOR_A_LEVEL: Final = 2.0
"""Independent ordinates of an average from which on it may be the faintest level that is tried."""

LOWEST: Final = 12
"""Ordinates at the lowest frequencies that show how strong a 1/f part may be."""

BEGUN_WITH: Final = 1.0
"""Its exponent to begin with."""

CAREFUL: Final = 0.7
"""Its strength to begin with, over what these show: levels make up for what it lacks, and not for too much of it."""

TURNS: Final = 3
"""Times at most that levels and a 1/f part are found in turn."""

FAINTEST: Final = 1e-12
"""Least density of any part over the largest that the record shows."""

FAR: Final = float(-np.log(FAINTEST))
"""Its logarithm: a number of a part is at most so far from that of the largest, or a quarter of it above."""


def cost_of(model: Array, seen: Ordinates) -> float:
    """Less the logarithm of Whittle's likelihood."""
    return float(seen.weight @ (np.log(model) + seen.density / model))


@dataclass(frozen=True, slots=True, eq=False)
class BandedNoise:
    """White noise, parts between edges, and a 1/f part: a point of the likelihood.

    Attributes
    ----------
    numbers
        Logarithms of the white density and of the 1/f part at 1 Hz [N^2/Hz], the latter minus infinity for none, its
        exponent, and for each band the logarithm of its level at the upper edge and its exponent, shape (3 + 2 b,).
    edges
        Lower and upper edges of the bands [Hz], shape (b, 2).
    sloped
        Which bands are a power of frequency, shape (b,).
    slow_end
        Frequency from which on there is nothing of the 1/f part [Hz].
    """

    numbers: Array
    edges: Array
    sloped: NDArray[np.bool_]
    slow_end: float

    @property
    def slow(self) -> bool:
        """Whether there is a 1/f part."""
        return bool(np.isfinite(self.numbers[1]))

    @property
    def bands(self) -> tuple[Band, ...]:
        """The bands."""
        pairs = self.numbers[3:].reshape(-1, 2)
        return tuple(
            Band(float(first), float(last), float(np.exp(level)), float(exponent))
            for (first, last), (level, exponent) in zip(self.edges, pairs, strict=True)
        )

    def price(self, highest: float) -> float:
        """Price of its numbers beside the white density, up to the highest frequency, in log-likelihood [1]."""
        inner = np.unique(self.edges[(self.edges > 0) & (self.edges < highest)])
        numbers = inner.size + self.sloped.size + np.count_nonzero(self.sloped) + 2 * self.slow
        return float(NUMBER_EVIDENCE * numbers)

    def parts(self, seen: Ordinates) -> Array:
        """Densities of the white part, the 1/f part and the bands in the averages, shape (2 + b, m) [N^2/Hz]."""
        f = seen.frequency
        slow = np.where(f < self.slow_end, np.exp(self.numbers[1] - self.numbers[2] * np.log(f)), 0.0)
        return np.stack([np.full(f.size, np.exp(self.numbers[0])), slow, *(band.density(f) for band in self.bands)])

    def model(self, seen: Ordinates) -> Array:
        """Density of the reading in the averages, shape (m,) [N^2/Hz]."""
        return np.asarray(seen.fixed + self.parts(seen).sum(axis=0))

    def slopes(self, seen: Ordinates, parts: Array) -> Array:
        """Derivatives of its density with its numbers, shape (3 + 2 b, m)."""
        slopes = np.empty((self.numbers.size, seen.frequency.size))
        slopes[:2], slopes[3::2] = parts[:2], parts[2:]
        slopes[2] = -parts[1] * np.log(seen.frequency)
        ratio = np.log(seen.frequency / self.edges[:, 1:])
        slopes[4::2] = parts[2:] * ratio
        return slopes

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which of its numbers are free."""
        free = np.ones(self.numbers.size, dtype=np.bool_)
        free[1:3] = self.slow
        free[4::2] = self.sloped
        return free

    def apart(self, seen: Ordinates) -> list[tuple[float, float]]:
        """Frequencies about its edges that tell no level [Hz]."""
        reach = LEAKS * seen.step
        return [(edge - reach, edge + reach) for edge in np.unique(self.edges) if 0 < edge < 0.5 / seen.interval]

    def lowered(self, seen: Ordinates) -> tuple[BandedNoise, float]:
        """The likeliest with these edges, and less the logarithm of its likelihood."""
        free = self.free
        largest = float(np.log(seen.density.max()))
        of_level, of_slow = (largest - FAR, largest + FAR / 4), (largest - FAR, largest + FAR)
        limits = np.array([of_level, of_slow, EXPONENTS, *[of_level, (-STEEPEST, STEEPEST)] * len(self.edges)])
        limits[4::2, 0] *= self.edges[:, 0] > 0  # from zero on it rises: what falls there has no end
        limits = limits[free]

        here = replace(self, numbers=self.numbers.copy())
        here.numbers[free] = np.clip(self.numbers[free], *limits.T)
        parts = here.parts(seen)
        cost, damping = cost_of(seen.fixed + parts.sum(axis=0), seen), FIRST_DAMPING
        for _ in range(MOST_STEPS):
            model = seen.fixed + parts.sum(axis=0)
            slopes = (here.slopes(seen, parts) / model)[free]
            slope = slopes @ (seen.weight * (seen.density / model - 1))
            information = (slopes * seen.weight) @ slopes.T
            information += np.diag(damping * np.diag(information) + TINY)
            step = np.linalg.solve(information, slope)
            step *= min(1.0, LONGEST / float(np.max(np.abs(step))))
            if slope @ step < ENOUGH or damping > MOST_DAMPING:
                break
            trial = replace(here, numbers=here.numbers.copy())
            trial.numbers[free] = np.clip(here.numbers[free] + step, *limits.T)
            found = trial.parts(seen)
            now = cost_of(seen.fixed + found.sum(axis=0), seen)
            if now < cost:
                here, parts, cost, damping = trial, found, now, damping / 10
            else:
                damping *= 10
        return here, cost

    def covariance(self, seen: Ordinates) -> Array:
        """Covariance of its numbers, from Fisher's information; zero for those that are not free."""
        free, parts = self.free, self.parts(seen)
        slopes = (self.slopes(seen, parts) / (seen.fixed + parts.sum(axis=0)))[free]
        covariance = np.zeros((self.numbers.size, self.numbers.size))
        covariance[np.ix_(free, free)] = np.linalg.pinv((slopes * seen.weight) @ slopes.T, hermitian=True)
        return covariance


class _Piece(NamedTuple):
    """Part of a spectrum between two edges: base + rise (f / last)^exponent."""

    first: float
    last: float
    base: float
    rise: float = 0.0
    exponent: float = 0.0

    def density(self, frequency: Array) -> Array:
        """Density at frequencies [Hz], of their shape [N^2/Hz]."""
        if not self.rise:
            return np.full(frequency.shape, self.base)
        return self.base + self.rise * (frequency / self.last) ** self.exponent


class _Part(NamedTuple):
    """Averages of one level."""

    averages: slice
    level: float
    slow: bool


def departs(seen: Ordinates, model: Array) -> bool:
    """Whether the ratio of a record to what is taken for its spectrum, shape (m,), changes its level anywhere."""
    ratio = seen.density / model
    levels = _levels(ratio, seen.weight)
    table = seen.weight[:, None] * (np.log(levels) + ratio[:, None] / levels)
    return bool(np.ptp(_path(table)))


def banded(seen: Ordinates) -> tuple[BandedNoise, Ordinates] | None:
    """The likeliest noise with edges, and the averages that tell its levels; None where there are no edges.

    Parameters
    ----------
    seen
        The record, with its single ordinates.
    """
    fine = seen.averaged(fineness=FINE)
    turns = [_turn(fine, np.zeros(fine.frequency.size)), _turn(fine, _slow_start(fine))]
    for _ in range(TURNS):
        # with the 1/f part that is likeliest beside them other levels may be
        again = _turn(fine, replace(turns[-1].noise, slow_end=np.inf).parts(fine)[1])
        settled = again.cost > turns[-1].cost - ENOUGH
        turns.append(again)
        if settled:
            break
    best = min(turns, key=lambda turn: turn.cost)
    parts, slow, end = best.parts, best.slow, best.noise.slow_end
    if len(parts) < 2:
        return None
    rough = _with_powers(parts, fine, slow)
    pieces = _sharpened(rough.copy(), seen, fine, slow, end=end)
    end = next((fixed.first for one, fixed in zip(rough, pieces, strict=True) if one.first == end), end)
    noise = _noise_of(pieces, fine, slow, end=end)
    clear = seen.averaged(fineness=FINENESS, apart=noise.apart(seen))
    noise, cost = noise.lowered(clear)
    while True:
        simpler = [(one.lowered(clear), price) for one, price in _simpler(noise, clear)]
        better = [found for found, price in simpler if found[1] - cost < price]
        if not better:
            break
        noise, cost = min(better, key=lambda pair: pair[1])
    if not noise.edges.size:
        return None
    return noise, clear


class _Turn(NamedTuple):
    """Levels found beside a 1/f part, the likeliest noise with these edges, and its cost."""

    cost: float
    noise: BandedNoise
    parts: list[_Part]
    slow: Array


def _turn(fine: Ordinates, slow: Array) -> _Turn:
    """Levels beside a 1/f part, shape (m,) [N^2/Hz]."""
    parts = _cleaned(_parts(fine, slow), fine, slow)
    end = _end_of_slow(parts, fine, slow)
    noise, cost = _noise_of([_piece(part, fine) for part in parts], fine, slow, end=end).lowered(fine)
    return _Turn(cost + noise.price(0.5 / fine.interval), noise, parts, slow)


def _levels(density: Array, weight: Array) -> Array:
    """Levels that are tried, shape (l,)."""
    # one ordinate alone may be as good as nothing
    least = float(np.min(density[weight >= min(ENOUGH_FOR_A_LEVEL, 0.5 * float(weight.max()))]))
    most = float(density.max())
    least = max(least, FAINTEST * most)
    return np.geomspace(least, most, int(LEVELS_A_DECADE * np.log10(most / least)) + 2)


def _path(table: Array) -> NDArray[np.int64]:
    """Column for each row of a table of costs, so that all together with `CHANGE_EVIDENCE` a change are least."""
    rows, columns = table.shape
    path, best = np.empty(rows, dtype=np.int64), np.zeros(rows + 1, dtype=np.int64)
    moved = np.empty(table.shape, dtype=np.bool_)
    cheapest(np.ascontiguousarray(table), CHANGE_EVIDENCE, np.zeros(columns), moved, best, path)
    return path


def _slow_start(fine: Ordinates) -> Array:
    """A 1/f part as strong as the lowest ordinates show it, shape (m,) [N^2/Hz]."""
    low = slice(0, LOWEST)
    shape = fine.frequency**-BEGUN_WITH
    return np.asarray(CAREFUL * shape * np.average(fine.density[low] / shape[low], weights=fine.weight[low]))


def _parts(fine: Ordinates, slow: Array) -> list[_Part]:
    """Levels beside a 1/f part, which a filter may cut off with them."""
    levels = _levels(fine.density, fine.weight)
    model = fine.fixed[:, None] + levels
    count, weight, density = levels.size, fine.weight[:, None], fine.density[:, None]
    tables = [model + slow[:, None], model] if slow.any() else [model]
    path = _path(np.hstack([weight * (np.log(one) + density / one) for one in tables]))
    first = np.concatenate([[0], np.flatnonzero(np.diff(path)) + 1])
    return [
        _part(slice(int(a), int(b)), fine, slow, with_slow=bool(path[a] < count))
        for a, b in zip(first, np.append(first[1:], path.size), strict=True)
    ]


def _part(averages: slice, fine: Ordinates, slow: Array, *, with_slow: bool) -> _Part:
    """Averages with the level that they have."""
    known = fine.fixed[averages] + (slow[averages] if with_slow else 0.0)
    level = float(np.average(fine.density[averages] - known, weights=fine.weight[averages]))
    return _Part(averages, max(level, FAINTEST * float(fine.density.max())), with_slow)


def _cleaned(parts: list[_Part], fine: Ordinates, slow: Array) -> list[_Part]:
    """The same without parts that are too narrow, each made one with that beside it which is more alike."""
    f, step = fine.frequency, fine.step
    while len(parts) > 1:
        edges = np.array([0.0, *(0.5 * (f[part.averages.start - 1] + f[part.averages.start]) for part in parts[1:])])
        edges = np.append(edges, f[-1] + step)
        width = np.diff(edges) / np.maximum(NARROW * step, SHARPEST * edges[1:])
        place = int(np.argmin(width))
        if width[place] >= 1:
            break
        beside = [other for other in (place - 1, place + 1) if 0 <= other < len(parts)]
        near = min(beside, key=lambda other: abs(np.log(parts[other].level / parts[place].level)))
        low, high = sorted((place, near))
        whole = slice(parts[low].averages.start, parts[high].averages.stop)
        wider = _part(whole, fine, slow, with_slow=parts[near].slow)
        kept = wider._replace(level=parts[near].level)  # it has more of them
        parts = [*parts[:low], kept, *parts[high + 1 :]]
    return parts


def _piece(part: _Part, fine: Ordinates) -> _Piece:
    """The piece of averages of one level."""
    f, (first, last) = fine.frequency, (part.averages.start, part.averages.stop)
    below = 0.5 * (f[first - 1] + f[first]) if first else 0.0
    above = 0.5 * (f[last - 1] + f[last]) if last < f.size else 0.5 / fine.interval
    return _Piece(float(below), float(above), part.level)


def _with_powers(parts: list[_Part], fine: Ordinates, slow: Array) -> list[_Piece]:
    """Levels, and powers of frequency where one for a run of levels has more evidence."""
    white = min(part.level for part in parts)
    levels = np.array([part.level for part in parts])
    costs = [_cost(_piece(part, fine), part.averages, fine, slow if part.slow else 0 * slow) for part in parts]
    # likeliest pieces up to each part: cost, the part before, and the last piece
    best: list[tuple[float, int, _Piece | None]] = [(0.0, 0, None)]
    for last in range(1, len(parts) + 1):
        found = [(best[last - 1][0] + costs[last - 1] + CHANGE_EVIDENCE, last - 1, _piece(parts[last - 1], fine))]
        for first in range(last - RUN, -1, -1):
            run = levels[first:last]
            if not (np.all(np.diff(run) > 0) or np.all(np.diff(run) < 0)):
                break
            bases = {white, levels[first - 1]} if first else {white}
            for base in bases:
                if base > run.min():
                    continue
                piece, cost = _power(parts[first:last], float(base), fine, slow)
                if not first and piece.exponent < 0:
                    continue  # what rises towards zero is a 1/f part
                price = CHANGE_EVIDENCE + NUMBER_EVIDENCE
                found.append((best[first][0] + cost + price, first, piece))
        best.append(min(found, key=lambda one: one[0]))
    pieces, place = [], len(parts)
    while place:
        _, before, last_piece = best[place]
        assert last_piece is not None  # only the beginning has none
        pieces.append(last_piece)
        place = before
    return pieces[::-1]


def _cost(piece: _Piece, averages: slice, fine: Ordinates, slow: Array) -> float:
    """Less the logarithm of the likelihood of some averages."""
    model = fine.fixed[averages] + slow[averages] + piece.density(fine.frequency[averages])
    return float(fine.weight[averages] @ (np.log(model) + fine.density[averages] / model))


def _power(run: list[_Part], base: float, fine: Ordinates, slow: Array) -> tuple[_Piece, float]:
    """The likeliest power of frequency above a base for a run of levels, by scoring, and its cost."""
    averages = slice(run[0].averages.start, run[-1].averages.stop)
    slow = slow if run[0].slow else 0 * slow
    first, last = _piece(run[0], fine).first, _piece(run[-1], fine).last
    f, weight, density = (one[averages] for one in (fine.frequency, fine.weight, fine.density))
    known = fine.fixed[averages] + slow[averages] + base
    ratio = np.log(f / last)
    top = max(part.level for part in run) - base
    ends = [max(part.level - base, LEAST_OF_A_RUN * top) for part in (run[0], run[-1])]
    numbers = np.array([np.log(ends[1]), np.log(ends[1] / ends[0]) / max(np.log(f[-1] / f[0]), 1e-3)])
    numbers[1] = np.clip(numbers[1], -STEEPEST, STEEPEST)
    numbers = likeliest_power(numbers, np.ones_like(ratio), ratio, known=known, density=density, weight=weight)
    piece = _Piece(first, last, base, float(np.exp(numbers[0])), float(numbers[1]))
    return piece, _cost(piece, averages, fine, slow)


def likeliest_power(start: Array, shown: Array, ratio: Array, *, known: Array, density: Array, weight: Array) -> Array:
    """Return the logarithm of a level and the exponent of a power of frequency that is likeliest, by scoring, (2,).

    Parameters
    ----------
    start
        Both to begin with.
    shown
        Share of it that each average shows, shape (m,) [1].
    ratio
        Logarithm of the frequency over that of the level, shape (m,).
    known
        Density of what else there is, shape (m,) [N^2/Hz].
    density, weight
        Density of the reading, and independent ordinates, of each average, shape (m,).
    """
    numbers, shapes = start.copy(), np.stack([np.ones_like(ratio), ratio])
    for _ in range(STEPS):
        rise = shown * np.exp(numbers @ shapes)
        model = rise + known
        slopes = shapes * (rise / model)
        information = (slopes * weight) @ slopes.T + TINY * np.eye(2)
        step = np.clip(np.linalg.solve(information, (slopes * weight) @ (density / model - 1)), -1.0, 1.0)
        numbers[1] = np.clip(numbers[1] + step[1], -STEEPEST, STEEPEST)
        numbers[0] += step[0]
        if np.max(np.abs(step)) < ENOUGH:
            break
    return numbers


def _sharpened(pieces: list[_Piece], seen: Ordinates, fine: Ordinates, slow: Array, *, end: float) -> list[_Piece]:
    """The pieces with their edges placed among single ordinates."""
    assert seen.single is not None
    index, density, gain = seen.single
    fixed = gain * (seen.fixed[0] / seen.gain[0])
    for place in range(1, len(pieces)):
        below, above = pieces[place - 1 : place + 1]
        edge = below.last / seen.step
        reach = 2 * FINE * edge + LEAKS + NARROW  # the averages about it, and what was too narrow
        low = max(edge - reach, 0.5 * (below.first + below.last) / seen.step)
        high = min(edge + reach, 0.5 * (above.first + above.last) / seen.step)
        part = slice(*np.searchsorted(index, [low, high]))
        f = index[part] * seen.step
        if f.size < 2:
            continue
        beside = np.interp(f, fine.frequency, slow)
        models = [fixed[part] + piece.density(f) + (beside if piece.first < end else 0.0) for piece in (below, above)]
        costs = [np.cumsum(np.log(model) + density[part] / model) for model in models]
        # below the edge the first, above it the second
        cost = np.append(0.0, costs[0]) + costs[1][-1] - np.append(0.0, costs[1])
        chosen = int(np.argmin(cost))
        if 0 < chosen < f.size:
            edge = 0.5 * (f[chosen - 1] + f[chosen])
            pieces[place - 1] = _moved(below, last=float(edge))
            pieces[place] = above._replace(first=float(edge))
    return pieces


def _moved(piece: _Piece, *, last: float) -> _Piece:
    """The same with another upper edge."""
    return piece._replace(last=last, rise=piece.rise * (last / piece.last) ** piece.exponent)


def _noise_of(pieces: list[_Piece], fine: Ordinates, slow: Array, *, end: float) -> BandedNoise:
    """The noise of pieces and a 1/f part up to its end, as a point to begin with."""
    white = min(piece.base for piece in pieces)
    found: list[Band] = []
    for piece in pieces:
        base = piece.base - white
        if base > 0 and found and piece.rise and found[-1].level == base and found[-1].last == piece.first:
            found[-1] = replace(found[-1], last=piece.last)  # it goes on below what rises
        elif base > 0:
            found.append(Band(piece.first, piece.last, base))
        if piece.rise:
            found.append(
                Band(piece.first, piece.last, piece.rise, piece.exponent or TINY)
            )  # a power of 0 is one as well
    numbers = [np.log(white), -np.inf, 1.0]
    if slow.any():
        low = slow[:2]
        exponent = float(np.log(low[0] / low[1]) / np.log(fine.frequency[1] / fine.frequency[0]))
        numbers[1:] = float(np.log(low[0]) + exponent * np.log(fine.frequency[0])), exponent
    for band in found:
        numbers += [np.log(band.level), band.exponent]
    edges = np.array([(band.first, band.last) for band in found]).reshape(-1, 2)
    return BandedNoise(np.array(numbers), edges, np.array([band.exponent != 0 for band in found], dtype=bool), end)


def _end_of_slow(parts: list[_Part], fine: Ordinates, slow: Array) -> float:
    """Frequency from which on a filter leaves nothing of the 1/f part [Hz]; infinite where it goes on."""
    place = len(parts)
    while place and not parts[place - 1].slow:
        place -= 1
    # a filter leaves less there than it would be, and cuts off a level that is stronger than it as well
    for before, after in zip(parts[max(place, 1) - 1 :], parts[max(place, 1) :], strict=False):
        if before.level > slow[after.averages.start] > after.level:
            return _piece(after, fine).first
    return np.inf


def _simpler(noise: BandedNoise, seen: Ordinates) -> Iterator[tuple[BandedNoise, float]]:
    """The same without bands so faint that they may be none, or with two of nearly one level as one; their prices."""
    levels = noise.numbers[3::2]
    spread = np.sqrt(np.diag(noise.covariance(seen)))[3::2]
    constant = ~noise.sloped
    for place in np.flatnonzero(constant & ~(spread < 1 / np.sqrt(2 * NUMBER_EVIDENCE))):
        yield _without(noise, int(place)), NUMBER_EVIDENCE
    beside = constant[:-1] & constant[1:] & (noise.edges[:-1, 1] == noise.edges[1:, 0])
    if beside.any():
        nearest = int(np.argmin(np.where(beside, np.abs(np.diff(levels)), np.inf)))
        edges = noise.edges.copy()
        edges[nearest, 1] = edges[nearest + 1, 1]
        yield _without(replace(noise, edges=edges), nearest + 1), CHANGE_EVIDENCE


def _without(noise: BandedNoise, place: int) -> BandedNoise:
    """The same without one of its bands."""
    numbers = np.delete(noise.numbers, [3 + 2 * place, 4 + 2 * place])
    return replace(
        noise,
        numbers=numbers,
        edges=np.delete(noise.edges, place, axis=0),
        sloped=np.delete(noise.sloped, place),
    )
