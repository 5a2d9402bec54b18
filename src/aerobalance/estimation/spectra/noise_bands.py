"""Noise with edges, of a record of noise alone: levels and powers of frequency between them, and a 1/f part.

The filters of converters cut off sharply below half the sampling rate, and converters that shape their noise let it
rise as a power of frequency up to such a cut. Humps follow neither. Levels are found by dynamic programming at a price
for each change, runs of them that rise or fall are weighed as one power of frequency, and the edges are then placed
among single ordinates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from aerobalance.estimation.spectra.banded_noise import (
    ENOUGH,
    FAINTEST,
    LEAKS,
    NUMBER_EVIDENCE,
    STEEPEST,
    TINY,
    BandedNoise,
    likeliest_power,
)
from aerobalance.estimation.spectra.level_costs import Costs, cheapest_columns
from aerobalance.estimation.spectra.noise_ordinates import FINENESS, Ordinates
from aerobalance.estimation.spectra.noise_spectrum import Band
from aerobalance.estimation.spectra.piecewise_psd import CHANGE_EVIDENCE, LEVELS_A_DECADE
from aerobalance.recording.channel import Array

FINE: Final = 0.003
"""Width of an average over its frequency where levels are looked for."""

NARROW: Final = 32
"""Ordinates that are a band at least: what is narrower is a line, or what the window leaks at an edge."""

SHARPEST: Final = 0.014
"""Width of a band over its frequency at least: a shaping filter widens both edges by half of it."""

RUN: Final = 3
"""Levels, one above the other, from which on a power of frequency is tried for them."""

LEAST_OF_A_RUN: Final = 0.02
"""Part of its strongest level that a run has anywhere, to begin with."""

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
    costs = Costs.of(ratio, seen.weight, np.zeros(ratio.size))
    return bool(np.ptp(cheapest_columns(costs.table(_levels(ratio, seen.weight)), CHANGE_EVIDENCE)))


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


def _slow_start(fine: Ordinates) -> Array:
    """A 1/f part as strong as the lowest ordinates show it, shape (m,) [N^2/Hz]."""
    low = slice(0, LOWEST)
    shape = fine.frequency**-BEGUN_WITH
    return np.asarray(CAREFUL * shape * np.average(fine.density[low] / shape[low], weights=fine.weight[low]))


def _parts(fine: Ordinates, slow: Array) -> list[_Part]:
    """Levels beside a 1/f part, which a filter may cut off with them."""
    levels = _levels(fine.density, fine.weight)
    costs, count = Costs.of(fine.density, fine.weight, fine.fixed), levels.size
    beside = [costs.beside(fine.fixed + slow), costs] if slow.any() else [costs]
    path = cheapest_columns(np.hstack([one.table(levels) for one in beside]), CHANGE_EVIDENCE)
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
    # least costs up to each part; and cost, first part and piece of the last piece there
    reached = [0.0]
    best: list[tuple[float, int, _Piece]] = []
    for last in range(1, len(parts) + 1):
        found = [(reached[last - 1] + costs[last - 1] + CHANGE_EVIDENCE, last - 1, _piece(parts[last - 1], fine))]
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
                found.append((reached[first] + cost + price, first, piece))
        best.append(min(found, key=lambda one: one[0]))
        reached.append(best[-1][0])
    pieces, place = [], len(parts)
    while place:
        _, place, piece = best[place - 1]
        pieces.append(piece)
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
