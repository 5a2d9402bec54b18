"""Quality of a calibration: direction, hysteresis, repeatability, outliers and confirmation points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.calibration.outliers import Outlier, find_outliers
from aerobalance.balance.calibration.regression import residual_deviation, without_intercepts
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True)
class QualitySettings:
    """Thresholds of the statistics of a calibration.

    Attributes
    ----------
    bidirectional
        Relative difference of the sensitivities to + and - loads from which a bridge is bidirectional (AIAA R-091).
    bidirectional_significance
        Probability of such a difference by chance below which it is real.
    curved
        Where a square leaves less than this share of the residual variance that an absolute value leaves, the bridge
        is curved and not bidirectional: more than the hysteresis of real balances makes of it (0.9 to 0.95).
    curved_significance
        Twice the logarithm of the likelihood ratio of the two that this takes besides: 20 to 1.
    same_load
        Difference of loads, over capacity, within which points are repeats.
    """

    bidirectional: float = 0.005
    bidirectional_significance: float = 0.001
    curved: float = 0.8
    curved_significance: float = 6.0
    same_load: float = 1e-4


SETTINGS: Final = QualitySettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True)
class Direction:
    """Whether a bridge has another sensitivity for negative loads.

    Attributes
    ----------
    bidirectional
        The verdict: the difference is above `SETTINGS.bidirectional`, and significant.
    difference
        Sensitivity to positive less that to negative loads, over their mean.
    p
        Probability of so large a difference by chance.
    known
        False where the loads go in one direction only.
    interval
        Half width of the interval of the difference that holds it with 95 % confidence; NaN where not known.
    """

    bidirectional: bool
    difference: float
    p: float
    known: bool
    interval: float = np.nan


@dataclass(frozen=True, slots=True, eq=False)
class Quality:
    """Statistics of a calibration by component, all of shape (c,) unless said, in parts of capacity.

    Attributes
    ----------
    deviation, largest
        Standard deviation (degrees of freedom counted) and largest magnitude of the residuals of the fitted points.
    of_half_range
        Standard deviation over half the calibrated range instead.
    hysteresis
        Largest difference between the residuals at one load, going up and going down; NaN where no series goes both
        ways.
    repeatability
        Standard deviation of repeated points; NaN without repeats.
    directions
        Verdict on every bridge.
    outliers
        All of them, strongest first.
    confirmation
        Root mean square error of the confirmation points; None without any.
    confirmation_covered
        Share of the confirmation points within two standard uncertainties; None without any.
    """

    deviation: Array
    largest: Array
    of_half_range: Array
    hysteresis: Array
    repeatability: Array
    directions: tuple[Direction, ...]
    outliers: tuple[Outlier, ...]
    confirmation: Array | None
    confirmation_covered: Array | None


def assess(calibration: Calibration) -> Quality:
    """Return the statistics of a calibration, in parts of capacity."""
    schedule, matrix = calibration.schedule, calibration.matrix
    used = schedule.fitted
    residuals = calibration.residuals / schedule.capacities
    fitted = residuals[used]
    deviation = residual_deviation(fitted, calibration.regressions)
    half = np.ptp(matrix.calibrated, axis=0) / 2 / schedule.capacities
    confirmation = covered = None
    if schedule.confirmation.any():
        held = residuals[~used]
        loads = schedule.loads[~used] + np.nan_to_num(calibration.tares)[schedule.series[~used]]
        variance = np.diagonal(matrix.load_covariance(loads, reading=True), axis1=1, axis2=2)
        confirmation = np.sqrt(np.mean(held**2, axis=0))
        covered = np.mean(np.abs(held) * schedule.capacities <= 2 * np.sqrt(variance), axis=0)
    return Quality(
        deviation=deviation,
        largest=np.max(np.abs(fitted), axis=0),
        of_half_range=deviation / half,
        hysteresis=_hysteresis(calibration, fitted),
        repeatability=_repeatability(calibration, fitted),
        directions=tuple(_direction(calibration, index) for index in range(len(schedule.components))),
        outliers=find_outliers(schedule, matrix.terms, calibration.regressions, matrix.output_scale, matrix.way),
        confirmation=confirmation,
        confirmation_covered=covered,
    )


def _direction(calibration: Calibration, index: int) -> Direction:
    """Compare slopes for both signs: the |F| term beside the linear terms, series intercepts free."""
    schedule = calibration.schedule
    used = schedule.fitted
    loads = schedule.loads[used] / schedule.capacities
    if calibration.tares_by_iteration is not None:
        loads = loads + (np.nan_to_num(calibration.tares) / schedule.capacities)[schedule.series[used]]
    intercepts = np.eye(len(schedule.series_names))[schedule.series[used]]
    intercepts = intercepts[:, intercepts.any(axis=0)]
    own = loads[:, index]
    if min(own.max(), -own.min()) < 0.1 * np.max(np.abs(own)):
        return Direction(False, 0.0, 1.0, False)
    others = _other_terms(calibration, index, loads)
    X = without_intercepts(np.column_stack([np.abs(own), own * own, loads, others]), intercepts)
    y = without_intercepts(schedule.outputs[used][:, index : index + 1], intercepts)[:, 0]
    rest = X[:, 2:]
    by_direction, u, sum_direction = _one_term(X[:, 0], rest, y, intercepts.shape[1])
    _, _, sum_square = _one_term(X[:, 1], rest, y, intercepts.shape[1])
    slope = np.linalg.lstsq(X[:, [0, *range(2, X.shape[1])]], y, rcond=None)[0][1 + index]
    freedom = max(y.size - rest.shape[1] - 1 - intercepts.shape[1], 1)
    p = float(2 * stdtr(freedom, -abs(by_direction) / u)) if u > 0 else 0.0
    difference = float(2 * by_direction / slope)
    curved = sum_square < sum_direction * min(SETTINGS.curved, np.exp(-SETTINGS.curved_significance / freedom))
    real = abs(difference) > SETTINGS.bidirectional and p < SETTINGS.bidirectional_significance and not curved
    interval = float(-stdtrit(freedom, 0.025) * 2 * u / abs(slope))
    return Direction(bool(real), difference, p, True, interval)


def _other_terms(calibration: Calibration, index: int, loads: Array) -> Array:
    """Terms of the matrix with other loads than the bridge's own, which must not be taken for its direction."""
    matrix = calibration.matrix
    columns = [
        loads[:, term.first] * loads[:, term.second]
        for term, row in zip(matrix.terms, matrix.coefficients, strict=True)
        if matrix.way == "iterative" and term.kind == 4 and row[index]
    ]
    return np.column_stack(columns) if columns else np.zeros((loads.shape[0], 0))


def _one_term(column: Array, rest: Array, y: Array, intercepts: int) -> tuple[float, float, float]:
    """Coefficient of one column beside others, its standard uncertainty, and the sum of squares that is left."""
    own = column - rest @ np.linalg.lstsq(rest, column, rcond=None)[0]
    left = y - rest @ np.linalg.lstsq(rest, y, rcond=None)[0]
    weight = float(own @ own)
    if weight <= 0:
        return 0.0, 0.0, float(left @ left)
    coefficient = float(own @ left) / weight
    remains = left - coefficient * own
    total = float(remains @ remains)
    freedom = max(y.size - rest.shape[1] - 1 - intercepts, 1)
    return coefficient, float(np.sqrt(total / freedom / weight)), total


def _groups(calibration: Calibration) -> NDArray[np.intp]:
    """Number of the group of repeats (same series, same loads) of every fitted point, shape (n,)."""
    schedule = calibration.schedule
    used = schedule.fitted
    key = np.column_stack(
        [schedule.series[used], np.rint(schedule.loads[used] / schedule.capacities / SETTINGS.same_load)]
    )
    return np.asarray(np.unique(key, axis=0, return_inverse=True)[1].reshape(-1))


def _repeatability(calibration: Calibration, residuals: Array) -> Array:
    """Pooled standard deviation of the residuals within groups of repeats, shape (c,)."""
    groups = _groups(calibration)
    counts = np.bincount(groups)
    freedom = int(np.sum(counts - 1))
    if not freedom:
        return np.full(residuals.shape[1], np.nan)
    means = np.array([np.bincount(groups, column) for column in residuals.T]).T / counts[:, None]
    return np.asarray(np.sqrt(np.sum((residuals - means[groups]) ** 2, axis=0) / freedom))


def _hysteresis(calibration: Calibration, residuals: Array) -> Array:
    """Largest difference of residuals at one load between going up and going down, in a component's own series."""
    schedule = calibration.schedule
    used = schedule.fitted
    loads, series = schedule.loads[used] / schedule.capacities, schedule.series[used]
    groups = _groups(calibration)
    result = np.full(loads.shape[1], np.nan)
    for index in range(loads.shape[1]):
        for number in np.unique(series):
            rows = np.flatnonzero(series == number)
            own = np.abs(loads[rows, index])
            if np.ptp(loads[rows, index]) < 0.1 or own.size < 3:
                continue
            rising = _rising(own)
            for group in np.unique(groups[rows]):
                same = groups[rows] == group
                up, down = residuals[rows[same & rising], index], residuals[rows[same & ~rising], index]
                if up.size and down.size and own[same].max() > SETTINGS.same_load:
                    result[index] = np.fmax(result[index], abs(up.mean() - down.mean()))
    return result


def _rising(loads: Array) -> NDArray[np.bool_]:
    """Whether each load was come to from a smaller one, shape (n,): the first was, a repeat as the one before it."""
    step = np.diff(loads, prepend=-1.0)
    turns = np.abs(step) > SETTINGS.same_load
    last = np.maximum.accumulate(np.where(turns, np.arange(loads.size), 0))
    return np.asarray(step[last] > 0)
