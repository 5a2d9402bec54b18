"""Readings of components that their filters have made white, and how much of known shapes is in all of them at once.

Of several components the coherence of what the filters leave is taken in bands: noise that they have in common is
told from forces that they have not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from aerobalance.estimation.checks.ground_witnesses import (
    SETTINGS,
    SHAPES,
    ChannelShapes,
    Witnesses,
    length_of,
    ramp_of,
)
from aerobalance.estimation.least_squares import DEPENDENT, whitened
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.recording.channel import Array
from aerobalance.recording.linalg import sums_of_products
from aerobalance.recording.side_by_side import side_by_side


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """Sizes of shapes by generalised least squares.

    Attributes
    ----------
    sizes, covariance
        How much of each there is, shape (p,), and its covariance, shape (p, p): of a channel less the delay [s], the
        gain [1], less the change of the delay [s].
    explained
        Squares of the white readings that they explain [1].
    """

    sizes: Array
    covariance: Array
    explained: float

    @classmethod
    def of(cls, gram: Array, moment: Array, *, expected: Array | None = None) -> Solved:
        """Solve normal equations; of shapes that depend on each other only what they tell together has a size.

        Parameters
        ----------
        gram, moment
            The equations.
        expected
            Standard deviations of the sizes before the readings are looked at, shape (p,); None where any will do.
        """
        if expected is not None:
            gram = gram + np.diag(expected**-2.0)
        scale = np.sqrt(np.diag(gram))
        scale[scale == 0] = 1.0
        information, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
        kept = information > DEPENDENT**2 * information[-1]
        spread = vectors[:, kept] / np.sqrt(information[kept]) / scale[:, None]
        sizes = spread @ (spread.T @ moment)
        return cls(sizes, spread @ spread.T, float(moment @ sizes))

    def of_channel(self, place: int) -> Solved:
        """Those of one channel, of which this is the place among them."""
        own = slice(SHAPES * place, SHAPES * (place + 1))
        return replace(self, sizes=self.sizes[own], covariance=self.covariance[own, own])

    @property
    def u(self) -> Array:
        """Standard uncertainty of each, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

    def clear(self, sure: float) -> bool:
        """Whether one of them is more standard uncertainties than chance makes."""
        return bool((np.abs(self.sizes) > sure * self.u).any())


Lines = NDArray[np.complex128]
"""Spectral lines of white series of all components, shape (m, c) or (m, c, p) [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class White:
    """Readings of components that filters have made white, constants, steps and hum taken out.

    Attributes
    ----------
    filters
        The filter of each.
    bases
        Orthonormal shapes that are taken out, shape (n, p) each.
    unseen
        Samples of each at either end that count for nothing.
    shown
        Lines of what is left of the readings, shape (m, c) [1].
    weights
        Inverse of the coherence of that in each of b bands of these frequencies, shape (b, c, c) [1]: components have
        the noise of readings in common, which is little where there is a force.
    edges
        First line of each band, and at the end the number of lines, shape (b + 1,).
    """

    filters: tuple[KalmanFilter, ...]
    bases: tuple[Array, ...]
    unseen: tuple[int, ...]
    shown: Lines
    weights: Lines
    edges: tuple[int, ...]

    @classmethod
    def of(cls, asked: Witnesses, filters: Sequence[KalmanFilter], *, without: Sequence[ChannelShapes] = ()) -> White:
        """Take the readings; the shapes of some channels count for nothing in what they have in common."""
        unseen = tuple(asked.unseen(one) for one in asked.components)

        def made_white(place: int) -> tuple[Array, Array]:
            """What is taken out of the reading of one component, and what is left of it."""
            one = asked.all[place]
            series = _inside(whitened(filters[place], one.fit.reading.filled, one.known), unseen[place])
            basis = _orthonormal(series[:, 1:])
            return basis, _less(series[:, 0], basis)

        bases, shown = zip(*side_by_side(made_white, range(len(unseen))), strict=True)
        lines = lines_of(np.column_stack(shown))
        weights = np.eye(len(shown), dtype=np.complex128)[None]
        plain = cls(tuple(filters), tuple(bases), unseen, lines, weights, (0, len(lines)))
        if len(shown) == 1:
            return plain
        if without:
            columns = [plain.columns(one.felt, moves=one.moves) for one in without]
            together = np.concatenate(columns, axis=-1)
            lines = lines - np.einsum("mcp,cp->mc", together, plain.each(together))
        weights, edges = _weights(lines, samples=shown[0].size)
        return replace(plain, weights=weights, edges=edges)

    def columns(self, felt: Sequence[Array], *, moves: NDArray[np.bool_]) -> Lines:
        """Lines of balance loads by each component, shape (n, p) each, in its white readings, shape (m, c, p).

        They are zero where nothing moves, and what is asked of them is asked of the other lines alone.
        """
        found = np.stack([lines_of(self.placed(own, place)) for place, own in enumerate(felt)], axis=1)
        found[~moves] = 0.0
        return found

    def with_drift(self, felt: Sequence[Array], *, moves: NDArray[np.bool_]) -> Lines:
        """The same with the first shape growing along the record: white readings remember but a part of it."""
        count, shapes = felt[0].shape
        ramp, rows = ramp_of(count), np.empty((shapes + 1, count))
        found = np.zeros((length_of(count) // 2 + 1, len(felt), shapes + 1), dtype=np.complex128)
        for place, own in enumerate(felt):
            if not own.any():
                continue  # the channel does not move along it
            rows[:-1] = self.placed(own, place).T
            np.multiply(ramp, rows[0], out=rows[-1])
            found[:, place] = lines_of(rows.T)
        found[~moves] = 0.0
        return found

    def placed(self, felt: Array, place: int) -> Array:
        """Loads of one component in its white readings, shape (n, p) [1 per unit]."""
        if not felt.any():
            return felt
        return _less(_inside(self.filters[place].whiten(felt), self.unseen[place]), self.bases[place])

    def solved(self, columns: Lines, shown: Lines | None = None, *, expected: Array | None = None) -> Solved:
        """Sizes of shapes in the readings, or in others, that are expected to be of some size."""
        shown, shapes = self.shown if shown is None else shown, columns.shape[-1]
        both = np.zeros((shapes, shapes + 1))
        for own, weight in self.bands(columns):  # of all lines at once the products would be as large as the shapes
            some = columns[own]
            whole = np.concatenate([some, shown[own, :, None]], axis=-1)
            both += _sum(np.matmul(weight, some), whole)  # weights are Hermitian
        return Solved.of(both[:, :-1], both[:, -1], expected=expected)

    def each(self, columns: Lines) -> Array:
        """Sizes of shapes in the readings of each component by itself, shape (c, p)."""
        own = (columns[:, [place]] for place in range(columns.shape[1]))
        shown = (self.shown[:, [place], None] for place in range(columns.shape[1]))
        return np.stack([Solved.of(_sum(x, x), _sum(x, y)[:, 0]).sizes for x, y in zip(own, shown, strict=True)])

    def squares(self, shown: Lines) -> float:
        """Sum of the squares of readings, shape (m, c), less what they have in common."""
        return float(_sum(shown[..., None], self.weighted(shown, shown)[..., None])[0, 0])

    def weighted(self, shown: Lines, motion: Lines) -> Lines:
        """Readings times their weights, shape (m, c), in bands where there is some motion, shape (m, c); else zero."""
        found = np.zeros_like(shown)
        for own, weight in self.bands(motion):
            np.matmul(shown[own], weight.T, out=found[own])
        return found

    def bands(self, motion: Lines) -> Iterator[tuple[slice, Lines]]:
        """The lines of each band where there is some motion, shape (m, ...), and their weights, shape (c, c)."""
        for ends, weight in zip(pairwise(self.edges), self.weights, strict=True):
            if motion[slice(*ends)].any():  # a channel moves at few of them
                yield slice(*ends), weight


def _inside(series: Array, ends: int) -> Array:
    """White series, zero for so many samples at either end, of their shape."""
    if ends:
        series[:ends] = series[-ends:] = 0.0
    return series


def lines_of(series: Array) -> Lines:
    """Return the lines of white series, shapes (n, p) and (m, p) [1]."""
    length = length_of(series.shape[0])
    # along rows, as memory has what a filter returns
    found: Lines = np.asarray(rfft(np.ascontiguousarray(series.T), length), dtype=np.complex128)
    found *= np.sqrt(2.0 / length)
    found[:, [0, -1]] *= np.sqrt(0.5)  # all others stand for the frequency below zero as well
    return np.ascontiguousarray(found.T)


def _sum(ones: Lines, others: Lines) -> Array:
    """Products of series summed over all components and samples, shapes (m, c, p) and (m, c, q)."""
    flat = ones.reshape(-1, ones.shape[-1])
    found = np.dot(flat.conj().T, others.reshape(len(flat), *others.shape[2:]))  # as `sums_of_products`
    return np.asarray(np.real(found), dtype=np.float64)


def _weights(lines: Lines, *, samples: int) -> tuple[Lines, tuple[int, ...]]:
    """Inverse of the coherence of white series of so many samples in bands, shape (b, c, c), and the bands' edges."""
    count, size = lines.shape
    edges = [0]
    while edges[-1] < count:
        wide = max(SETTINGS.coherent, edges[-1] // SETTINGS.part)
        edges.append(count if edges[-1] + 2 * wide > count else edges[-1] + wide)
    weights = np.empty((len(edges) - 1, size, size), dtype=np.complex128)
    for place, (first, last) in enumerate(pairwise(edges)):
        own = lines[first:last]
        whole = np.dot(own.T, own.conj())
        scale = np.maximum(np.sqrt(np.real(np.diag(whole))), 1e-300)
        level, turned = np.linalg.eigh(whole / np.outer(scale, scale))
        # of so many independent lines the inverse is too large by this part; that of one series is one
        bias = 1 - (size - 1) * length_of(samples) / ((last - first) * samples)
        weights[place] = bias * (turned / np.maximum(level, SETTINGS.least)) @ turned.conj().T
    return weights, tuple(edges)


def _orthonormal(columns: Array) -> Array:
    """Columns that span the same, shape (n, up to p)."""
    scale = np.sqrt(np.einsum("np,np->p", columns, columns))
    scale[scale == 0] = 1.0
    information, vectors = np.linalg.eigh(sums_of_products(columns, columns) / np.outer(scale, scale))
    kept = information > DEPENDENT**2 * information[-1]
    return np.asarray((vectors[:, kept] / np.sqrt(information[kept]) / scale[:, None]).T @ columns.T).T


def _less(series: Array, basis: Array) -> Array:
    """Series less what a basis explains of them, of their shape; twice, as the basis is orthonormal to rounding.

    Along rows, as memory has what a filter returns.
    """
    rows = series.T
    for _ in range(2):
        rows = rows - sums_of_products(rows.T, basis) @ basis.T
    return rows.T
