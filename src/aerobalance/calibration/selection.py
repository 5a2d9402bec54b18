"""Which terms of a model a load schedule can identify, and which of those the data call for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.calibration.regression import inflation, without_intercepts
from aerobalance.channel import Array
from aerobalance.terms import Term

OWN_SHARE_NEEDED: Final = 0.05
"""Least norm of a term's own part over all points, in terms of one point at capacity.

Below it the term's contribution at capacity would be uncertain by more than twenty times the scatter of one reading.
"""

HIGHEST_INFLATION: Final = 10.0
"""Variance inflation factor above which terms are near copies of each other (AIAA R-091 warns from 5)."""

WORTH_KEEPING: Final = 0.98
"""Sum of squares of the left-out residuals (PRESS), over that of a leaner model, below which more terms are kept."""

_ROUNDING: Final = 1e-24
"""PRESS, over capacity squared, that is nothing but rounding."""


@dataclass(frozen=True, slots=True)
class Unidentified:
    """A term that the schedule cannot tell.

    Attributes
    ----------
    term
        Which.
    like
        The term that it cannot be told from; None where the loads never bring it out.
    """

    term: Term
    like: Term | None


def identifiable(
    design: Array, intercepts: Array, terms: tuple[Term, ...]
) -> tuple[tuple[Term, ...], tuple[Unidentified, ...]]:
    """Find the terms that the loads bring out, each apart from those before it.

    Parameters
    ----------
    design
        Values of the terms at every point, for loads over capacity, shape (n, t).
    intercepts
        Series columns, shape (n, s).
    terms
        The t terms, simple kinds first: of two that look alike, the later one is left out.

    Returns
    -------
    known
        The terms that can be identified.
    unknown
        The others.
    """
    columns = without_intercepts(design, intercepts)
    basis = np.zeros((design.shape[0], 0))
    accepted: list[int] = []
    unknown: list[Unidentified] = []
    for index, term in enumerate(terms):
        rest = columns[:, index] - basis @ (basis.T @ columns[:, index])
        rest -= basis @ (basis.T @ rest)  # twice is enough for orthogonality
        size = float(np.linalg.norm(rest))
        if size > OWN_SHARE_NEEDED:
            accepted.append(index)
            basis = np.column_stack([basis, rest / size])
            continue
        whole = float(np.linalg.norm(columns[:, index]))
        like = None
        if whole > OWN_SHARE_NEEDED:
            alike = np.abs(columns[:, accepted].T @ columns[:, index]) / np.linalg.norm(columns[:, accepted], axis=0)
            like = terms[accepted[int(np.argmax(alike))]]
        unknown.append(Unidentified(term, like))
    return tuple(terms[index] for index in accepted), tuple(unknown)


def select(values: Array, design: Array, intercepts: Array, *, terms: tuple[Term, ...]) -> NDArray[np.bool_]:
    """Choose the terms of one component by significance, with hierarchy, from all that can be identified.

    Backward elimination: the least significant term goes, one after the other, and each model on the way is judged by
    PRESS, how well it foretells points left out of the fit. The leanest model within `WORTH_KEEPING` of the best is
    taken. This is done twice, the first time after near copies (variance inflation factor above `HIGHEST_INFLATION`)
    have gone; copies are kept only where that pays. A fixed level of significance would drop many small terms that
    together are worth more than the noise. Linear terms stay, as all others build on them.

    Returns
    -------
    numpy.ndarray
        True for the terms chosen, shape (t,).
    """
    own = without_intercepts(design, intercepts)
    target = without_intercepts(values[:, None], intercepts)[:, 0]
    problem = (own, target, values.size - intercepts.shape[1])
    leverage = np.sum(np.linalg.qr(intercepts)[0] ** 2, axis=1)
    everything = np.ones(len(terms), dtype=bool)
    lean, rich = (
        _leanest(problem, leverage, start, terms)
        for start in (_without_copies(problem, everything, terms), everything)
    )
    return rich[0] if rich[1] < WORTH_KEEPING * lean[1] else lean[0]


def _leanest(
    problem: tuple[Array, Array, int], leverage: Array, start: NDArray[np.bool_], terms: tuple[Term, ...]
) -> tuple[NDArray[np.bool_], float]:
    """Take the least significant term out again and again; return the leanest good model and its PRESS."""
    own, target, freedom = problem
    linear = np.array([term.kind == 0 for term in terms])
    chosen = start.copy()
    path: list[tuple[NDArray[np.bool_], float]] = []
    while True:
        where = np.flatnonzero(chosen)
        Q, R = np.linalg.qr(own[:, where])
        rest = target - Q @ (Q.T @ target)
        left_out = rest / np.maximum(1 - leverage - np.sum(Q**2, axis=1), 1e-9)
        path.append((chosen.copy(), float(left_out @ left_out)))
        removable = np.flatnonzero(~linear[where])
        if not removable.size:
            break
        t = _student(Q, R, target, freedom - where.size)
        chosen[where[removable[np.argmin(t[removable])]]] = False
    best = min(press for _, press in path)
    return next(step for step in reversed(path) if step[1] <= best / WORTH_KEEPING or step[1] <= _ROUNDING)


def _without_copies(
    problem: tuple[Array, Array, int], chosen: NDArray[np.bool_], terms: tuple[Term, ...]
) -> NDArray[np.bool_]:
    """Take out the terms that are near copies of others, the least significant first."""
    own, target, freedom = problem
    chosen = chosen.copy()
    linear = np.array([term.kind == 0 for term in terms])
    none = np.zeros((own.shape[0], 0))
    while True:
        where = np.flatnonzero(chosen)
        t = _student(*np.linalg.qr(own[:, where]), target, freedom - where.size)
        copies = np.flatnonzero(~linear[where] & (inflation(own[:, where], none) > HIGHEST_INFLATION))
        if not copies.size:
            return chosen
        chosen[where[copies[np.argmin(t[copies])]]] = False


def _student(Q: Array, R: Array, target: Array, freedom: int) -> Array:
    """Magnitude of Student's statistic of every coefficient of a least-squares fit."""
    inverse = np.linalg.inv(R)
    projected = Q.T @ target
    variance = max(float(target @ target - projected @ projected) / max(freedom, 1), np.finfo(float).tiny)
    return np.asarray(np.abs(inverse @ projected) / np.sqrt(np.sum(inverse**2, axis=1) * variance))
