"""Regression of one output (or load) on the terms: coefficients, their covariance, and diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

LEAST_FREEDOM: Final = 1
"""Fewest points beyond the number of unknowns."""

FULL_LEVERAGE: Final = 1e-9
"""Distance of a leverage from one within which a point alone tells an unknown."""

HIGHEST_INFLATION: Final = 10.0
"""Variance inflation factor above which terms are near copies of each other (AIAA R-091 warns from 5)."""

SMALLEST_SIZE: Final = 1e-15
"""Singular value over the largest one from which on a direction of the unknowns is told by the readings."""

MOST_INFLATION: Final = 1e6
"""Variance inflation factor from which only that it is larger is said."""

OUTLYING_SIGNIFICANCE: Final = 0.05 / 6
"""Probability, over all points of a component, below which a deleted residual is too large for chance (Bonferroni).

Of a sound calibration of six components one in twenty has such a point.
"""

MOST_OUTLYING: Final = 0.05
"""Largest share of the points that are looked for as outlying: more of them are no single mistakes."""

ROUNDED: Final = 1e-9
"""Residual over the largest value up to which it may be rounding, where the others fit to the last digit."""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """Terms of each component and the ridge penalty on their coefficients: c components, t terms.

    Attributes
    ----------
    included
        Shape (c, t).
    penalty
        Variance of a reading over that expected of a coefficient, shape (c, t); zero for least squares.
    """

    included: NDArray[np.bool_]
    penalty: Array

    @classmethod
    def everything(cls, components: int, terms: int) -> Choice:
        """All terms, by least squares."""
        return cls(np.ones((components, terms), dtype=bool), np.zeros((components, terms)))

    def solve(self, design: Array, others: Sequence[Array], values: Array) -> tuple[Array, Array]:
        """Coefficients of all components, shape (t, c), zero for terms left out, and of other columns, shape (s, c).

        Components with the same terms, penalties and other columns are solved together.

        Parameters
        ----------
        design
            Shape (n, t).
        others
            Other columns of every component, each of shape (n, s).
        values
            Shape (n, c).
        """
        alike: dict[tuple[bytes, ...], list[int]] = {}
        for index, (*choice, other) in enumerate(zip(self.included, self.penalty, others, strict=True)):
            alike.setdefault((*(one.tobytes() for one in choice), other.tobytes()), []).append(index)
        found = np.zeros((design.shape[1], values.shape[1]))
        rest = np.zeros((others[0].shape[1], values.shape[1]))
        for those in alike.values():
            mask, penalty = self.included[those[0]], self.penalty[those[0]]
            X, y = _drawn_to_zero(np.hstack([design[:, mask], others[those[0]]]), values[:, those], penalty[mask])
            solved = scipy.linalg.lstsq(X, y, lapack_driver="gelsy")[0]
            kept = int(np.count_nonzero(mask))
            found[np.ix_(mask, those)], rest[:, those] = solved[:kept], solved[kept:]
        return found, rest


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """Regression of one component, n points, p terms in the model; intercepts are not kept.

    Attributes
    ----------
    included
        Which of the t candidate terms are in the model, shape (t,).
    coefficients, covariance
        Of all t terms, shape (t,) and (t, t). A term left out for want of significance has the coefficient zero and
        yet an uncertainty, and what it may be worth is part of that of the others.
    t, p
        Student's statistic and its two-sided probability, shape (t,); NaN for those left out.
    vif
        Variance inflation factors, series intercepts taken out, shape (t,); NaN for those left out.
    intercepts, u_intercepts
        Of the series, shape (s,), and their standard uncertainties.
    residuals
        Shape (n,).
    deviation
        Standard deviation of the residuals about all candidate terms, degrees of freedom counted.
    degrees_of_freedom
        Points less unknowns; a coefficient drawn to zero counts as the part of one that the readings determine.
    press
        Root mean square of the residuals that each point would have, were it left out of the fit; NaN where no point
        can be left out.
    r_squared
        Share of the variance that is explained.
    deleted
        Residuals that the points have where they and all outlying ones are left out of the fit, shape (n,); those of
        a point that alone tells an unknown are zero.
    studentised
        The same over their standard deviation, which is found without them too, shape (n,); infinite where the other
        points fit to the last digit.
    outlying
        True for the points whose deleted residual is too large for chance, shape (n,). They are in the fit.
    deviation_without, coefficients_without
        Standard deviation of the residuals, and coefficients, shape (t,), of a fit without the outlying points.
    """

    included: NDArray[np.bool_]
    coefficients: Array
    covariance: Array
    t: Array
    p: Array
    vif: Array
    intercepts: Array
    u_intercepts: Array
    residuals: Array
    deviation: float
    degrees_of_freedom: int
    press: float
    r_squared: float
    deleted: Array
    studentised: Array
    outlying: NDArray[np.bool_]
    deviation_without: float
    coefficients_without: Array


@dataclass(frozen=True, slots=True, eq=False)
class _LeastSquares:
    """Least squares of n readings and m that draw coefficients to zero, for k unknowns.

    Attributes
    ----------
    found
        Unknowns, shape (k,).
    rest
        Residuals, those of the readings first, shape (n + m,).
    inverse
        Pseudo-inverse of the design, those readings in columns, shape (k, n + m).
    leverage
        Part of each reading in its own fitted value, shape (n,).
    basis
        Orthonormal columns that span what is fitted, shape (n + m, at most k).
    freedom
        Readings and those that draw to zero, less unknowns that they tell.
    """

    found: Array
    rest: Array
    inverse: Array
    leverage: Array
    basis: Array
    freedom: int


def regress(
    values: Array, design: Array, intercepts: Array, *, included: NDArray[np.bool_], penalty: Array
) -> Regression:
    """Return the regression of one component on its terms.

    Parameters
    ----------
    values
        Readings, shape (n,).
    design
        Values of all t candidate terms, shape (n, t).
    intercepts
        One column for each series, one in its points, shape (n, s).
    included
        Which terms to use, shape (t,).
    penalty
        What draws the coefficients to zero, shape (t,); zero for least squares. Terms that could be left out have one.

    Raises
    ------
    FitError
        There are fewer points than unknowns.
    """
    n, unknowns = values.size, int(np.count_nonzero(included)) + intercepts.shape[1]
    if n < unknowns + LEAST_FREEDOM:
        raise FitError(
            f"{n} points for {unknowns} unknowns ({np.count_nonzero(included)} terms and {intercepts.shape[1]} series "
            "intercepts); add points, or choose a model with fewer terms"
        )
    fit = _fit(values, design[:, included], intercepts, penalty[included])
    # leaving a term out does not make it known: scatter and uncertainty are those with all terms
    whole = fit if included.all() else _fit(values, design, intercepts, penalty)
    freedom = n - float(np.sum(whole.leverage))
    deviation = float(np.sqrt(np.sum(whole.rest[:n] ** 2) / freedom))
    found = _spread(fit.found, np.concatenate([included, np.ones(intercepts.shape[1], dtype=bool)]), 0.0)
    covariance = whole.inverse @ whole.inverse.T * deviation**2 + np.outer(found - whole.found, found - whole.found)
    u = np.sqrt(np.diag(covariance))
    rest = fit.rest[:n]
    squares = float(rest @ rest)
    without = _left_out(fit, float(np.max(np.abs(values), initial=0.0)))
    spread = float(np.sum((values - values.mean()) ** 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (found / u)[: included.size]
    return Regression(
        included=included,
        coefficients=found[: included.size],
        covariance=covariance[: included.size, : included.size],
        t=np.where(included, t, np.nan),
        p=np.where(included, 2 * stdtr(freedom, -np.abs(t)), np.nan),
        vif=_spread(inflation(design[:, included], intercepts), included, np.nan),
        intercepts=found[included.size :],
        u_intercepts=u[included.size :],
        residuals=rest,
        deviation=deviation,
        degrees_of_freedom=round(freedom),
        press=_press(fit),
        r_squared=1 - squares / spread if spread > 0 else 0.0,
        deleted=without.deleted,
        studentised=without.studentised,
        outlying=without.out,
        deviation_without=without.deviation,
        coefficients_without=_spread(without.found[: np.count_nonzero(included)], included, 0.0),
    )


def _press(fit: _LeastSquares) -> float:
    """Root mean square of the residuals of points left out one by one; NaN where each alone tells an unknown."""
    rest, leverage = fit.rest[: fit.leverage.size], fit.leverage
    told = leverage < 1 - FULL_LEVERAGE
    return float(np.sqrt(np.mean((rest[told] / (1 - leverage[told])) ** 2))) if told.any() else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class _Deleted:
    """What a fit of n points says of points left out of it.

    Attributes
    ----------
    out
        True for the points that are left out together, shape (n,).
    deleted, studentised
        Residuals of the points where they and those are left out, and the same over their deviation, shape (n,).
    deviation, found
        Standard deviation of the residuals, and the unknowns, of the fit without those.
    """

    out: NDArray[np.bool_]
    deleted: Array
    studentised: Array
    deviation: float
    found: Array


def _left_out(fit: _LeastSquares, largest: float) -> _Deleted:
    """Leave out the points whose deleted residuals are too large for chance, and tell those of all points.

    The point with the largest of them is left out for good, then the largest of the others, until chance explains the
    rest: a point that is far off hides another, and makes sound ones look wrong. Where more points than
    `MOST_OUTLYING` would go, only those count that stand out from them by a factor of two. `largest` is the largest
    value fitted, which tells rounding.
    """
    count = fit.leverage.size
    most = max(int(MOST_OUTLYING * count), 1)
    limit = -stdtrit(max(fit.freedom - 1, 1), OUTLYING_SIGNIFICANCE / 2 / count)
    out: list[int] = []
    sizes: list[float] = []
    while True:
        found = _without(fit, out)
        left = np.where(np.abs(found.deleted) > ROUNDED * largest, np.abs(found.studentised), 0.0)
        left[out] = 0.0
        worst = int(np.argmax(left))
        if left[worst] <= limit or fit.freedom - len(out) <= LEAST_FREEDOM:
            break
        if len(out) == most:
            crowd = 2 * float(left[worst])
            found = _without(fit, out[: next((i for i, size in enumerate(sizes) if size <= crowd), most)])
            break
        out.append(worst)
        sizes.append(float(left[worst]))
    sound = found.out & (np.abs(found.studentised) <= limit)  # another wrong point had made them look wrong
    return _without(fit, np.flatnonzero(found.out & ~sound).tolist()) if sound.any() else found


def _without(fit: _LeastSquares, out: Sequence[int]) -> _Deleted:
    """Tell what a fit says of its points without those `out`.

    By the inverse of a part of the residual-forming matrix, so that nothing is fitted anew. What draws coefficients to
    zero are readings as well: counted with the others, what the rest leaves is never negative. A point that alone
    tells an unknown (leverage one) fits whatever it reads, and shows nothing of itself.
    """
    count = fit.leverage.size
    residuals, leverage = np.array(fit.rest[:count]), np.array(fit.leverage)
    squares = float(fit.rest @ fit.rest)
    deleted, variance, found = np.zeros(count), np.ones(count), fit.found
    chosen = np.asarray(out, dtype=np.intp)
    freedom = fit.freedom - chosen.size
    if chosen.size:
        H = fit.basis[:count] @ fit.basis[chosen].T
        inverse = np.linalg.inv(np.eye(chosen.size) - H[chosen])
        own = inverse @ residuals[chosen]
        squares = max(squares - float(residuals[chosen] @ own), 0.0)
        found = found - fit.inverse[:, chosen] @ own
        residuals = residuals + H @ own
        leverage = leverage + np.sum((H @ inverse) * H, axis=1)
        deleted[chosen] = own
        variance[chosen] = np.diag(inverse) * squares / max(freedom, 1)
    told = leverage < 1 - FULL_LEVERAGE
    told[chosen] = False
    deleted[told] = residuals[told] / (1 - leverage[told])
    left = np.maximum(squares - residuals[told] * deleted[told], 0.0)
    variance[told] = left / max(freedom - 1, 1) / (1 - leverage[told])
    exact = np.where(deleted == 0, 0.0, np.copysign(np.inf, deleted))
    studentised = np.divide(deleted, np.sqrt(variance), out=exact, where=variance > 0)
    deviation = float(np.sqrt(squares / max(freedom, 1)))
    return _Deleted(np.isin(np.arange(count), chosen), deleted, studentised, deviation, found)


def _fit(values: Array, design: Array, intercepts: Array, penalty: Array) -> _LeastSquares:
    """Solve least squares by the pseudo-inverse: columns that are copies of each other share what they explain."""
    X, y = _drawn_to_zero(np.hstack([design, intercepts]), values, penalty)
    left, sizes, right = np.linalg.svd(X, full_matrices=False)
    largest = sizes.max(initial=0.0)
    told = sizes > SMALLEST_SIZE * largest
    inverse = right.T @ (np.divide(1.0, sizes, out=np.zeros_like(sizes), where=told)[:, None] * left.T)
    found = inverse @ y
    return _LeastSquares(
        found=found,
        rest=y - X @ found,
        inverse=inverse,
        leverage=(X * inverse.T).sum(axis=1)[: values.size],
        basis=left[:, told],
        freedom=y.size - int(np.count_nonzero(sizes > np.finfo(float).eps * max(X.shape) * largest)),
    )


def _drawn_to_zero(X: Array, y: Array, penalty: Array) -> tuple[Array, Array]:
    """Append readings of zero of the first coefficients, weighted as the penalty says."""
    rows = np.flatnonzero(penalty)
    added = np.zeros((rows.size, X.shape[1]))
    added[np.arange(rows.size), rows] = np.sqrt(penalty[rows])
    return np.vstack([X, added]), np.concatenate([y, np.zeros((rows.size, *y.shape[1:]))])


def _spread(values: Array, included: NDArray[np.bool_], rest: float) -> Array:
    full = np.full(included.size, rest)
    full[included] = values
    return full


def residual_deviation(residuals: Array, fits: Sequence[Regression]) -> Array:
    """Return the standard deviation of residuals, shape (n, c), each by its fit's degrees of freedom, shape (c,)."""
    freedom = np.array([max(fit.degrees_of_freedom, LEAST_FREEDOM) for fit in fits])
    return np.asarray(np.sqrt(np.sum(residuals**2, axis=0) / freedom))


def without_intercepts(design: Array, intercepts: Array) -> Array:
    """Take what series intercepts can explain out of the columns of a design matrix, shape (n, t)."""
    if not intercepts.shape[1]:
        return design
    return np.asarray(design - intercepts @ np.linalg.lstsq(intercepts, design, rcond=None)[0])


def inflation_text(factor: float) -> str:
    """Return a variance inflation factor for people: beyond a million it is a matter of rounding."""
    return f"{factor:.3g}" if factor < MOST_INFLATION else f"more than {MOST_INFLATION:,.0f}"


def inflation(design: Array, intercepts: Array) -> Array:
    """Variance inflation factors of the columns of a design matrix, shape (t,), series intercepts taken out.

    They are the diagonal of the inverse of the correlation matrix.
    """
    own = without_intercepts(design, intercepts)
    size = np.linalg.norm(own, axis=0)
    unit = own / np.where(size > 0, size, 1.0)
    R = np.linalg.qr(unit, mode="r")
    try:
        inverse = np.linalg.inv(R)
    except np.linalg.LinAlgError:
        return np.full(size.size, np.inf)
    return np.asarray(np.sum(inverse**2, axis=1))
