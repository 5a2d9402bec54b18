"""Least squares of one output (or load) on the terms: coefficients, their uncertainty, and how much to trust them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from statsmodels.regression.linear_model import OLS
from statsmodels.stats.outliers_influence import OLSInfluence

from aerobalance.channel import Array
from aerobalance.problems import FitError

LEAST_FREEDOM: Final = 1
"""Fewest points beyond the number of unknowns."""


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """Ordinary least squares of one component, n points, p terms in the model, intercepts left out of what is kept.

    Attributes
    ----------
    included
        Which of the t candidate terms are in the model, shape (t,).
    coefficients, covariance
        Of all t terms, shape (t,) and (t, t); zero for those left out.
    t, p
        Student's statistic and its two-sided probability, shape (t,); NaN for those left out.
    vif
        Variance inflation factors, series intercepts taken out, shape (t,); NaN for those left out.
    intercepts, u_intercepts
        Of the series, shape (s,), and their standard uncertainties.
    residuals
        Shape (n,).
    deviation
        Standard deviation of the residuals, degrees of freedom counted.
    degrees_of_freedom
        Points less unknowns.
    press
        Root mean square of the residuals that each point would have, were it left out of the fit.
    r_squared
        Share of the variance that is explained.
    studentised
        Residuals over their standard deviation, each found without its own point, shape (n,).
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
    studentised: Array


def regress(values: Array, design: Array, intercepts: Array, *, included: NDArray[np.bool_]) -> Regression:
    """Fit one component.

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

    Raises
    ------
    FitError
        There are fewer points than unknowns.
    """
    X = np.hstack([design[:, included], intercepts])
    n, unknowns = X.shape
    if n < unknowns + LEAST_FREEDOM:
        raise FitError(
            f"{n} points for {unknowns} unknowns ({np.count_nonzero(included)} terms and {intercepts.shape[1]} series "
            "intercepts); add points, or choose a model with fewer terms"
        )
    fit = OLS(values, X).fit()
    influence = OLSInfluence(fit)
    kept = int(np.count_nonzero(included))
    spread = float(np.sum((values - values.mean()) ** 2))
    where = np.flatnonzero(included)
    covariance = np.zeros((included.size, included.size))
    covariance[np.ix_(where, where)] = fit.cov_params()[:kept, :kept]
    leave_one_out = 1 - np.minimum(influence.hat_matrix_diag, 1 - 1e-12)
    deviation = float(np.sqrt(fit.scale))
    with np.errstate(divide="ignore", invalid="ignore"):
        t, p = fit.tvalues[:kept], fit.pvalues[:kept]
        left = np.sqrt(np.maximum(fit.ssr - fit.resid**2 / leave_one_out, 0.0) / max(n - unknowns - 1, 1))
        studentised = np.nan_to_num(fit.resid / (left * np.sqrt(leave_one_out)))
    return Regression(
        included=included,
        coefficients=_spread(fit.params[:kept], included, 0.0),
        covariance=covariance,
        t=_spread(t, included, np.nan),
        p=_spread(p, included, np.nan),
        vif=_spread(inflation(design[:, included], intercepts), included, np.nan),
        intercepts=np.asarray(fit.params[kept:]),
        u_intercepts=np.asarray(fit.bse[kept:]),
        residuals=np.asarray(fit.resid),
        deviation=deviation,
        degrees_of_freedom=n - unknowns,
        press=float(np.sqrt(np.mean((fit.resid / leave_one_out) ** 2))),
        r_squared=1 - float(fit.ssr) / spread if spread > 0 else 0.0,
        studentised=studentised,
    )


def _spread(values: Array, included: NDArray[np.bool_], rest: float) -> Array:
    full = np.full(included.size, rest)
    full[included] = values
    return full


def without_intercepts(design: Array, intercepts: Array) -> Array:
    """Take what series intercepts can explain out of the columns of a design matrix, shape (n, t)."""
    if not intercepts.shape[1]:
        return design
    return np.asarray(design - intercepts @ np.linalg.lstsq(intercepts, design, rcond=None)[0])


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
