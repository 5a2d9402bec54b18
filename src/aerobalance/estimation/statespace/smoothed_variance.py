"""Variance of the force given all readings of a record, its start and gaps included.

Far from all of these it is one number. Beside an end, N, the covariance of the adjoint state, is smaller; beside a
start the numbers c of the stretch are unsure. Both die away with the filter's memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from aerobalance.estimation.statespace.blocks import BLOCK, BlockForms, OutputForms
from aerobalance.estimation.statespace.gaps import Gap
from aerobalance.estimation.statespace.steady_state import SteadyState
from aerobalance.estimation.statespace.stretches import Planner, Stretch
from aerobalance.recording.channel import Array

FAINT: Final = 1e-3
"""Rms of an error, over the standard deviation of the force, that adds nothing to its variance."""

LONGEST: Final = 13
"""Power of two of the samples at most after which it is looked anew which states matter to a variance."""

FEW: Final = 4
"""So few states that it is looked more rarely."""


def smoothed_variance(forms: BlockForms, planner: Planner, stretches: Sequence[Stretch], *, row: Array) -> Array:
    """Return the variance of a row (d,) of the state given all observations, shape (n,)."""
    out, output = np.empty(stretches[-1].stop), forms.output(row)
    later = np.zeros((0, row.size))  # N = later' later is the covariance of the adjoint state, c known
    for one in reversed(stretches):
        count = one.stop - one.first
        ahead = later
        if count:
            out[one.first : one.stop] = _variance_with_c(forms, planner, count, later=later, row=row)
            later = planner.told_by(count, later)
        if one.memory:
            _, size, turned = np.linalg.svd(later @ one.start, full_matrices=True)
            spread = np.ones(one.start.shape[1])
            spread[: size.size] = 1 / np.sqrt(1 + size**2)
            unsure = one.start @ turned.T * spread
            more = _variance_of_c(forms, planner, one, columns=unsure, later=ahead, output=output, row=row)
            out[one.first : one.first + one.memory] += more
        if one.gap_length:
            gap = gap_before(one, forms.steady)
            across = gap.covariance_rows(row)
            less = gap.told_later(across, _without(later, one.start))
            out[one.gap : one.first] = across @ row - np.sum(less**2, axis=0)
            later = gap.before(_without(later, planner.growth(one.gap_length)))
    return np.maximum(out, 0.0)


def gap_before(one: Stretch, steady: SteadyState) -> Gap:
    """Return the gap before a stretch."""
    return Gap.of(steady.model, steady.covariance + one.before @ one.before.T, one.gap_length)


def _variance_with_c(forms: BlockForms, planner: Planner, count: int, *, later: Array, row: Array) -> Array:
    """Variance of a row of the state along a stretch, c known, shape (count,), given a root of N after it (any, d)."""
    column = forms.steady.covariance @ row
    reach = planner.memory(count, column[:, None])
    edges = np.zeros((1, -(-reach // BLOCK) + 1, column.size))
    edges[0, 0] = column
    forms.chain(edges)
    seen = np.cumsum((edges[0, :-1] @ forms.rows.T).ravel()[:reach] ** 2) / forms.steady.variance
    if later.size:
        forward = (later @ forms.powers[1:]).reshape(-1, column.size)
        ahead = (edges[0, :-1] @ forward.T).reshape(-1, later.shape[0])[:reach]
        seen = seen + np.sum(ahead**2, axis=1)
    out = np.full(count, row @ column - (seen[-1] if reach else 0.0))
    out[count - reach :] = row @ column - seen[::-1]
    return out


def _variance_of_c(
    forms: BlockForms, planner: Planner, one: Stretch, *, columns: Array, later: Array, output: OutputForms, row: Array
) -> Array:
    """Variance of a row of the state along a stretch that comes from c, given the roots of both, shape (memory,)."""
    variance, count = np.zeros(one.memory), one.stop - one.first
    column = forms.steady.covariance @ row
    ahead = planner.told_by(count, later)
    steady = row @ column - np.sum((ahead @ column) ** 2)
    # what a state makes of the estimate over 1, 2, 4, ... samples tells which columns matter
    rows = (row - (ahead @ column) @ ahead)[None]
    if one.end.size:  # it lasts to where few readings are to come
        told = np.sqrt(row @ column / forms.steady.variance) * forms.steady.model.h
        rows = np.vstack([rows, row, told])
    first, places = 0, BLOCK.bit_length() - 1
    matter = planner.roots_of_mean(rows, one.memory.bit_length())
    while first < one.memory:
        part = slice(first, min(first + (1 << places), one.memory))
        from_here = np.vstack(matter[min(places, len(matter) - 1) :]) @ columns
        _, size, turned = np.linalg.svd(from_here, full_matrices=False)
        columns = columns @ turned[size > FAINT * np.sqrt(max(float(steady), 0.0))].T
        if not columns.shape[1]:
            break
        ahead = planner.told_by(count - part.stop, later)
        states, shown = forms.released(columns.T, part.stop - first)
        columns = planner.after(part.stop - first, columns)
        last = -(columns.T @ ahead.T) @ ahead
        adjoint, out = forms.adjoint(-shown, last), np.empty_like(shown)
        output.write(out, None, states, -shown, adjoint, last=last)
        variance[part] = np.sum(out**2, axis=0)
        first, places = part.stop, min(places + 2, LONGEST + (3 if columns.shape[1] <= FEW else 0))
    return variance


def _without(later: Array, columns: Array) -> Array:
    """Root of what is told of a state (any, d), if the covariance has these columns (d, any) beside the steady one."""
    p, s, _ = np.linalg.svd(later @ columns, full_matrices=False)
    return np.asarray(later + (p * (1 / np.sqrt(1 + s**2) - 1)) @ (p.T @ later))
