"""The steady filter and its adjoint, a block of samples at a time.

Within a block, innovations and smoothed states are fixed linear forms of the readings, of the state before the block
and of the adjoint state after it. So a whole record is a few products of matrices, and only the states at the edges of
the blocks follow one from another. Nothing is diagonalised: the eigenvectors of a closed loop may be as good as
parallel.

References
----------
.. [deJong1989] P. de Jong, "Smoothing and interpolation with the state-space model", J. Amer. Statist. Assoc. 84
   (1989) 1085.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from aerobalance.estimation.statespace import _kernels
from aerobalance.estimation.statespace.steady_state import SteadyState
from aerobalance.recording.channel import Array

BLOCK: Final = 64
"""Samples of a block: as many operations within the blocks as from edge to edge, for some thirty states."""


WIDTH: Final = 16
"""Numbers that the compiler takes together."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockForms:
    """What turns a stretch of readings without gaps into innovations and smoothed states.

    Series have shape (c, m). States at the edges have shape (c, m // BLOCK + 1, d): those before each whole block, and
    before what is left at the end.

    Attributes
    ----------
    steady
        The filter.
    powers
        Powers 0 to BLOCK of its closed loop, shape (BLOCK + 1, d, d).
    rows
        h F^i: what a state makes of the prediction i samples later, shape (BLOCK, d).
    own
        Innovations of a block by its readings, shape (BLOCK, BLOCK).
    entries
        State after a block by its readings, shape (BLOCK, d).
    over, back
        What a block makes of the state before it, and its transpose, by their columns, as `_kernels.chain` takes them.
    told, told_of_state
        Adjoint state before a block by its readings, shape (BLOCK, d), and less that by the state before it, (d, d).
    """

    steady: SteadyState
    powers: Array
    rows: Array
    own: Array
    entries: Array
    over: Array
    back: Array
    told: Array
    told_of_state: Array
    _outputs: dict[bytes, OutputForms] = field(init=False, default_factory=dict, repr=False)

    @classmethod
    def of(cls, steady: SteadyState) -> BlockForms:
        """Return the forms of a steady filter."""
        observation, powers = steady.model.h, powers_of(steady.closed_loop, BLOCK)
        rows = observation @ powers[:BLOCK]
        entries = powers[:BLOCK] @ steady.entry
        own = np.eye(BLOCK) - _toeplitz_below(entries @ observation)
        whole = powers[BLOCK]
        # in one order of elements, for which the loop is compiled
        room = np.zeros((2, len(whole), len(whole) + -len(whole) % WIDTH))
        room[0, :, : len(whole)], room[1, :, : len(whole)] = whole.T, whole
        over, back = room
        shown = rows / steady.variance
        entries = np.ascontiguousarray(entries[::-1])
        return cls(steady, powers, rows, own, entries, over, back, own.T @ shown, rows.T @ shown)

    def chain(self, states: Array, *, forward: bool = True) -> None:
        """Add to each state at the edges, shape (c, any, d), what becomes of the one before it; or back in time."""
        _kernels.chain(self.over if forward else self.back, states, forward)

    def states(self, series: Array, first: Array) -> tuple[Array, Array]:
        """Return predicted states at the edges and after the last sample (c, d), from first ones of shape (c, d)."""
        whole, left = _divided(series)
        states = np.empty((series.shape[0], whole.shape[1] + 1, first.shape[1]))
        states[:, 0] = first
        np.matmul(whole, self.entries, out=states[:, 1:])
        self.chain(states)
        count = left.shape[1]
        return states, states[:, -1] @ self.powers[count].T + left @ self.entries[BLOCK - count :]

    def innovations(self, series: Array, states: Array) -> Array:
        """Return readings less their predictions, shape (c, m)."""
        out = np.empty_like(series)
        (whole, left), (of_whole, of_left) = _divided(series), _divided(out)
        count = left.shape[1]
        np.matmul(whole, self.own.T, out=of_whole)
        of_whole -= states[:, :-1] @ self.rows.T
        of_left[:] = left @ self.own[:count, :count].T - states[:, -1] @ self.rows[:count].T
        return out

    def released(self, first: Array, count: int) -> tuple[Array, Array]:
        """Return states at the edges, and what readings show of them (c, count), if nothing follows first ones."""
        edges = np.zeros((first.shape[0], count // BLOCK + 1, first.shape[1]))
        edges[:, 0] = first
        self.chain(edges)
        shown = (edges @ self.rows.T).reshape(first.shape[0], -1)
        return edges, shown[:, :count]

    def adjoint(self, innovations: Array, last: Array) -> Array:
        """Return adjoint states at the edges, given those after the last sample (c, d) [deJong1989]_."""
        whole, left = _divided(innovations)
        count, S = left.shape[1], self.steady.variance
        states = np.empty((innovations.shape[0], whole.shape[1] + 1, last.shape[1]))
        np.matmul(whole, self.rows / S, out=states[:, :-1])
        states[:, -1] = last @ self.powers[count] + left @ self.rows[:count] / S
        self.chain(states, forward=False)
        return states

    def adjoint_of(self, series: Array, states: Array, last: Array) -> Array:
        """Return the same from readings and predicted states at the edges, without the innovations between them."""
        whole, left = _divided(series)
        count, after = left.shape[1], np.empty_like(states)
        np.matmul(whole, self.told, out=after[:, :-1])
        after[:, :-1] -= states[:, :-1] @ self.told_of_state
        shown = self.innovations(left, states[:, -1:]) @ self.rows[:count]
        after[:, -1] = last @ self.powers[count] + shown / self.steady.variance
        self.chain(after, forward=False)
        return after

    def weighed(self, weights: Array) -> tuple[Array, Array]:
        """Return what sums of innovations of some weights, shape (p, m), are of the readings and states at the edges.

        Returns
        -------
        by_series, by_states
            Weights of the readings, shape (p, m), and of the states, which count less, shape (p, m // BLOCK + 1, d).
        """
        by_series = np.empty_like(weights)
        (whole, left), (of_whole, of_left) = _divided(weights), _divided(by_series)
        count = left.shape[1]
        np.matmul(whole, self.own, out=of_whole)
        of_left[:] = left @ self.own[:count, :count]
        by_states = np.empty((weights.shape[0], whole.shape[1] + 1, self.rows.shape[1]))
        np.matmul(whole, self.rows, out=by_states[:, :-1])
        by_states[:, -1] = left @ self.rows[:count]
        return by_series, by_states

    def output(self, row: Array) -> OutputForms:
        """Return what makes a row (d,) of the state, given all readings; it is kept for the next series."""
        known = self._outputs.get(row.tobytes())
        if known is not None:
            return known
        column = self.steady.covariance @ row
        along = row @ self.powers[:BLOCK]
        innovations = _toeplitz_from(self.rows @ column / self.steady.variance).T
        series = _toeplitz_below(along @ self.steady.entry)
        made = OutputForms(
            along - innovations @ self.rows,
            np.ascontiguousarray((self.powers[1:] @ column)[::-1]),
            innovations @ self.own + series,
            OfInnovations(along, series, innovations, self.own, self.rows),
        )
        self._outputs[row.tobytes()] = made
        return made


class OfInnovations(NamedTuple):
    """A row of the state at the samples of a block, by the innovations too: for what is left at the end of a stretch.

    Attributes
    ----------
    states
        By the state before the block, shape (BLOCK, d).
    series, innovations
        By the readings of the block and their innovations, shape (BLOCK, BLOCK).
    own, rows
        Innovations by the readings and less those by the state, as of `BlockForms`.
    """

    states: Array
    series: Array
    innovations: Array
    own: Array
    rows: Array


@dataclass(frozen=True, slots=True, eq=False)
class OutputForms:
    """A row of the state at the samples of a block, given all readings.

    Attributes
    ----------
    states, adjoint
        By the state before the block and the adjoint state after it, shape (BLOCK, d).
    series
        By the readings of the block, shape (BLOCK, BLOCK).
    at_end
        The same where a block is not whole: innovations that would follow have no part in it.
    """

    states: Array
    adjoint: Array
    series: Array
    at_end: OfInnovations

    def write(self, out: Array, series: Array | None, states: Array, adjoint: Array, *, last: Array) -> None:
        """Write the row along a stretch, shape (c, m).

        Parameters
        ----------
        out
            Where it is written.
        series
            Readings, shape (c, m); None if they are zero.
        states, adjoint
            What `BlockForms` makes of them.
        last
            Adjoint states after the last sample, shape (c, d).
        """
        of_whole, of_left = _divided(out)
        np.matmul(states[:, :-1], self.states.T, out=of_whole)
        of_whole += adjoint[:, 1:] @ self.adjoint.T
        if series is None:
            left = np.zeros_like(of_left)
        else:
            whole, left = _divided(series)
            of_whole += whole @ self.series.T
        count, end = left.shape[1], self.at_end
        if count:
            innovations = left @ end.own[:count, :count].T - states[:, -1] @ end.rows[:count].T
            of_left[:] = innovations @ end.innovations[:count, :count].T + left @ end.series[:count, :count].T
            of_left += states[:, -1] @ end.states[:count].T + last @ self.adjoint[BLOCK - count :].T


def powers_of(matrix: Array, highest: int) -> Array:
    """Return the powers 0 to the highest one of a matrix (d, d), shape (highest + 1, d, d)."""
    powers = np.empty((highest + 1, *matrix.shape))
    powers[0] = np.eye(matrix.shape[0])
    done = 1
    while done <= highest:
        count = min(done, highest + 1 - done)
        following = powers[done - 1] @ matrix
        np.matmul(powers[:count], following, out=powers[done : done + count])
        done += count
    return powers


def _divided(series: Array) -> tuple[Array, Array]:
    """Return views on the whole blocks (c, blocks, BLOCK) and on what is left at the end (c, less than BLOCK)."""
    cut = series.shape[1] - series.shape[1] % BLOCK
    return series[:, :cut].reshape(series.shape[0], -1, BLOCK), series[:, cut:]


def _toeplitz_from(response: Array) -> Array:
    """Return the lower triangular matrix that convolves with a response from the same sample on."""
    size = response.size
    back = np.arange(size)[:, None] - np.arange(size)
    return np.where(back >= 0, response[np.abs(back)], 0.0)


def _toeplitz_below(response: Array) -> Array:
    """Return the lower triangular matrix that convolves with a response from the next sample on."""
    return _toeplitz_from(np.concatenate([[0.0], response[:-1]]))
