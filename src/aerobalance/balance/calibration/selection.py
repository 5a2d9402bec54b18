"""Term selection: terms that a load schedule can identify, and those of them that are significant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.calibration.regression import without_intercepts
from aerobalance.balance.calibration.shrinkage import Coefficients
from aerobalance.balance.terms import Term
from aerobalance.recording.channel import Array

OWN_SHARE_NEEDED: Final = 0.05
"""Least norm of a term's own part over all points, in terms of one point at capacity.

Below it the term's contribution at capacity would be uncertain by more than twenty times the scatter of one reading.
"""

WORTH_LEAVING: Final = 0.05
"""What leaving terms out may add to the squared error of the coefficients, over what it is expected to be.

Both in units of the covariance, in which it is expected to be the number of terms.
"""


@dataclass(frozen=True, slots=True)
class Unidentified:
    """Term that the schedule cannot identify, with those that it cannot be told from.

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
    """Return the terms that the loads identify, each beside those before it, and those that they do not.

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


def select(coefficients: Coefficients, kinds: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return the significant terms of every component, of those that can be identified.

    Backward elimination: the least significant term goes, one after the other, and what it stood for goes to those
    that are left, as far as they can take it up (the mean on the condition that it is zero). This ends before the
    coefficients left out are, together, more than `WORTH_LEAVING` significant. Linear terms stay, as all others build
    on them.

    Parameters
    ----------
    coefficients
        Of all terms.
    kinds
        Kind of every term, shape (t,); 0 is linear.

    Returns
    -------
    numpy.ndarray
        True for the terms chosen, shape (c, t).
    """
    return np.array(
        [_leanest(b, C, kinds > 0) for b, C in zip(coefficients.mean, coefficients.covariance, strict=True)]
    )


def _leanest(mean: Array, covariance: Array, curved: NDArray[np.bool_]) -> NDArray[np.bool_]:
    b, C = mean.copy(), covariance.copy()
    chosen = np.ones(b.size, dtype=bool)
    allowed = WORTH_LEAVING * b.size
    while True:
        removable = np.flatnonzero(chosen & curved)
        if not removable.size:
            return chosen
        squares = b[removable] ** 2 / np.diag(C)[removable]
        least = removable[np.argmin(squares)]
        allowed -= float(squares.min())
        if allowed < 0:
            return chosen
        chosen[least] = False
        column = C[:, least] / C[least, least]
        b -= column * b[least]
        C -= np.outer(column, C[least])
