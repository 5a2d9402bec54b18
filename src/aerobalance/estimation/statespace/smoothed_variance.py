r"""Variance of a row of the state, such as the force, given all readings of a record: of the fixed-interval smoother.

Far from the start, the end and all gaps it is one number, var = r P r' - r P N P r': P is the steady covariance of the
predicted state, r the row, and N the covariance of the adjoint state, by which the readings from a sample on lower the
variance [deJong1989]_. Before an end or a gap fewer readings are to come, and N is smaller. After a start or a gap the
state has the part L c besides, with a few unknown numbers c of variance 1 [deJong1991]_ (see `stretches`), and what is
still unknown of c adds to the variance. Both differences die away with the filter's memory, so only the samples within
that memory are worked out one by one.

All covariances here are kept as square roots: `root` stands for N = root' root, shape (any, d).

References
----------
.. [deJong1989] P. de Jong, "Smoothing and interpolation with the state-space model", J. Amer. Statist. Assoc. 84
   (1989) 1085.
.. [deJong1991] P. de Jong, "The diffuse Kalman filter", Ann. Statist. 19 (1991) 1073.
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

NEGLIGIBLE: Final = 1e-3
"""Rms of an error over the standard deviation of the row below which it is left out: 1e-6 of the variance [1]."""

LOG2_LONGEST_PART: Final = 13
"""Logarithm to base 2 of the samples after which, at the latest, columns that matter no more are dropped (8192)."""

FEW_COLUMNS: Final = 4
"""Columns up to which the parts are eight times as long: so few cost less than to look which of them matter."""


def smoothed_variance(forms: BlockForms, planner: Planner, stretches: Sequence[Stretch], *, row: Array) -> Array:
    """Return the variance of a row (d,) of the state at each sample given all readings, in its unit squared, (n,).

    Parameters
    ----------
    forms, planner
        The steady filter, block by block and over stretches.
    stretches
        The stretches of the record, in order.
    row
        Which combination of the states is wanted, shape (d,).
    """
    out, output = np.empty(stretches[-1].stop), forms.output(row)
    root = np.zeros((0, row.size))  # nothing comes after the record
    for one in reversed(stretches):
        count = one.stop - one.first
        root_after = root
        if count:
            out[one.first : one.stop] = _variance_given_c(forms, planner, count, root_after=root_after, row=row)
            root = planner.told_by(count, root_after)
        if one.memory:
            # given all readings from here on, c has the covariance (1 + L' N L)^-1
            _, size, turned = np.linalg.svd(root @ one.start, full_matrices=True)
            spread = np.ones(one.start.shape[1])
            spread[: size.size] = 1 / np.sqrt(1 + size**2)
            unknown = one.start @ turned.T * spread
            more = _variance_from_c(
                forms, planner, one, columns=unknown, root_after=root_after, output=output, row=row
            )
            out[one.first : one.first + one.memory] += more
        if one.gap_length:
            gap = gap_before(one, forms.steady)
            across = gap.covariance_rows(row)
            reduction = gap.told_later(across, _root_for_wider_state(root, one.start))
            out[one.gap : one.first] = across @ row - np.sum(reduction**2, axis=0)
            root = gap.before(_root_for_wider_state(root, planner.growth(one.gap_length)))
    return np.maximum(out, 0.0)


def gap_before(one: Stretch, steady: SteadyState) -> Gap:
    """Return the gap before a stretch, with the covariance that the readings before it leave."""
    return Gap.of(steady.model, steady.covariance + one.before @ one.before.T, one.gap_length)


def _variance_given_c(forms: BlockForms, planner: Planner, count: int, *, root_after: Array, row: Array) -> Array:
    """Variance of a row of the state along a stretch if c were known, by the root of N after it, shape (count,)."""
    column = forms.steady.covariance @ row
    reach = planner.memory(count, column[:, None])
    edges = np.zeros((1, -(-reach // BLOCK) + 1, column.size))
    edges[0, 0] = column
    forms.chain(edges)
    # r P N P r' by the number of readings to come: each adds (h F^i P r')^2 / S
    reduction = np.cumsum((edges[0, :-1] @ forms.rows.T).ravel()[:reach] ** 2) / forms.steady.variance
    if root_after.size:
        forward = (root_after @ forms.powers[1:]).reshape(-1, column.size)
        beyond = (edges[0, :-1] @ forward.T).reshape(-1, root_after.shape[0])[:reach]
        reduction = reduction + np.sum(beyond**2, axis=1)
    out = np.full(count, row @ column - (reduction[-1] if reach else 0.0))
    out[count - reach :] = row @ column - reduction[::-1]
    return out


def _variance_from_c(
    forms: BlockForms,
    planner: Planner,
    one: Stretch,
    *,
    columns: Array,
    root_after: Array,
    output: OutputForms,
    row: Array,
) -> Array:
    """Variance that what is unknown of c adds along a stretch, shape (memory,).

    Each column of the state's error at the first reading is followed along the stretch as the smoother takes it on,
    and the squares of what it does to the row are summed. From part to part, those that matter no more are dropped.

    Parameters
    ----------
    forms, planner, output, row
        As in `smoothed_variance`.
    one
        The stretch.
    columns
        Root of the covariance of L c given all readings, shape (d, r).
    root_after
        Root of N after the stretch.
    """
    variance, count = np.zeros(one.memory), one.stop - one.first
    column = forms.steady.covariance @ row
    root = planner.told_by(count, root_after)
    steady = row @ column - np.sum((root @ column) ** 2)
    # an error x of the state comes to the smoothed row as (r - r P N) x; its rms over the next 1, 2, 4, ... samples
    # tells which columns matter
    rows = (row - (root @ column) @ root)[None]
    if one.end.size:  # the error lasts to the end, where few readings are to come and N is smaller
        by_one_reading = np.sqrt(row @ column / forms.steady.variance) * forms.steady.model.h
        rows = np.vstack([rows, row, by_one_reading])
    first, places = 0, BLOCK.bit_length() - 1
    rms_roots = planner.roots_of_mean(rows, one.memory.bit_length())
    while first < one.memory:
        part = slice(first, min(first + (1 << places), one.memory))
        effect = np.vstack(rms_roots[min(places, len(rms_roots) - 1) :]) @ columns
        _, size, turned = np.linalg.svd(effect, full_matrices=False)
        columns = columns @ turned[size > NEGLIGIBLE * np.sqrt(max(float(steady), 0.0))].T
        if not columns.shape[1]:
            break
        root = planner.told_by(count - part.stop, root_after)
        states, shown = forms.released(columns.T, part.stop - first)
        columns = planner.after(part.stop - first, columns)
        last = -(columns.T @ root.T) @ root
        adjoint, out = forms.adjoint(-shown, last), np.empty_like(shown)
        output.write(out, None, states, adjoint, last=last)
        variance[part] = np.sum(out**2, axis=0)
        longest = LOG2_LONGEST_PART + (3 if columns.shape[1] <= FEW_COLUMNS else 0)
        first, places = part.stop, min(places + 2, longest)
    return variance


def _root_for_wider_state(root: Array, columns: Array) -> Array:
    """Root (any, d) of N for a state of covariance P + C C' instead of P, with columns C (d, any).

    By Woodbury's identity that is N - N C (1 + C' N C)^-1 C' N, here with root C = p s q' by singular values.
    """
    p, s, _ = np.linalg.svd(root @ columns, full_matrices=False)
    return np.asarray(root + (p * (1 / np.sqrt(1 + s**2) - 1)) @ (p.T @ root))
