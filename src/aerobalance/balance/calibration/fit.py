"""Least-squares fit of a balance matrix to a load schedule, Eq. (2) of [Gorbushin2020]_, both ways of AIAA R-091.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.calibration.checks import check_residuals, check_schedule
from aerobalance.balance.calibration.normalised_points import NormalisedPoints
from aerobalance.balance.calibration.outliers import (
    MOST_NAMED,
    find_outliers,
    outlier_text,
    outliers_text,
    outlying_points,
)
from aerobalance.balance.calibration.regression import Choice, Regression, without_intercepts
from aerobalance.balance.calibration.selection import Unidentified, identifiable, select
from aerobalance.balance.calibration.shrinkage import Design, shrink
from aerobalance.balance.matrix import BalanceMatrix, Way
from aerobalance.balance.schedule import Schedule
from aerobalance.balance.terms import Model, Term, terms_of
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError, not_as_given


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Result of a calibration: the balance matrix with residuals and tares; n points, c components, s series.

    Attributes
    ----------
    schedule
        What was loaded and read.
    model, way
        Which terms were offered, and which way the matrix goes.
    matrix
        The result.
    regressions
        Fit of every component, in the order of the components.
    tares, u_tares
        Loads of the fixtures found in every series by intercepts, and their standard uncertainties, shape (s, c)
        [N, N*m]; NaN in series without points in the fit. Zero, with NaN uncertainty, without natural zeros.
    tares_by_iteration
        The same by the iteration of AIAA R-091, as a check, shape (s, c) [N, N*m]; None without natural zeros.
    residuals
        Load computed less load applied (tares included), all points, shape (n, c) [N, N*m].
    unidentified
        Terms of AIAA R-091 that the schedule cannot tell, in the model or not; they are not in the matrix.
    condition
        Condition number of the design, columns of norm one [1].
    """

    schedule: Schedule
    model: Model
    way: Way
    matrix: BalanceMatrix
    regressions: tuple[Regression, ...]
    tares: Array
    u_tares: Array
    tares_by_iteration: Array | None
    residuals: Array
    unidentified: tuple[Unidentified, ...]
    condition: float

    def __repr__(self) -> str:
        fitted = self.residuals[self.schedule.fitted] / self.schedule.capacities
        rows = [
            f"{name}: residuals {100 * deviation:.2g} % of capacity rms, {100 * largest:.2g} % at most"
            for name, deviation, largest in zip(
                self.schedule.components,
                np.sqrt(np.mean(fitted**2, axis=0)),
                np.max(np.abs(fitted), axis=0),
                strict=True,
            )
        ]
        outliers = find_outliers(
            self.schedule, self.matrix.terms, self.regressions, self.matrix.output_scale, self.way
        )
        rows += [f"outlier: {outlier_text(self.schedule, item)}" for item in outliers[:MOST_NAMED]]
        if len(outliers) > MOST_NAMED:
            rows.append(f"and {len(outliers) - MOST_NAMED} outliers more: assess(calibration).outliers")
        what = f"calibration of {self.schedule.name}: model {self.model}, {self.way}, {len(fitted)} points"
        return "\n  ".join([what, *rows])

    @property
    def unidentified_labels(self) -> tuple[str, ...]:
        """Names of the terms that the schedule cannot tell."""
        return tuple(item.term.label(self.matrix.variables) for item in self.unidentified)


@one_blas_thread()
def calibrate(
    schedule: Schedule,
    *,
    model: Model = "auto",
    way: Way = "iterative",
    reading_noise: float | Mapping[str, float] = 0.0,
) -> Calibration:
    """Return the balance matrix of a load schedule, with residuals and tares [N, N*m].

    Parameters
    ----------
    schedule
        Loads and outputs; points marked for confirmation take no part.
    model
        ``"linear"``; ``"quadratic"`` or ``"27"``, the terms of Eq. (2); ``"abs"``, linear with absolute values;
        ``"96"``, all of AIAA R-091; ``"auto"``, those of the 96 that are significant,
        each kind drawn to zero as far as the readings do not support it (`shrink`).
    way
        ``"iterative"``: outputs fitted on loads. ``"non-iterative"``: loads fitted on outputs.
    reading_noise
        Standard deviation of one reading of the schedule [mV/V], where known, one for all bridges or by bridge. The
        scatter of the residuals then counts for the loads of a recording only as far as it goes beyond that; 0 counts
        it all, and so does a bridge that is not named.

    Raises
    ------
    FitError
        The schedule cannot give a matrix; the message names component and evidence.
    ValueError
        `reading_noise` is negative, or names a bridge that the schedule does not have.

    Warns
    -----
    DataQualityWarning
        The matrix can be used, but something in the schedule makes it worse than it looks.
    """
    if not hasattr(schedule, "fitted"):
        raise not_as_given("a load schedule is", schedule, "`read_schedule` reads one from a file")
    outliers = check_schedule(schedule)
    noise = _noise_of(reading_noise, schedule.gauges)
    terms = terms_of(model, len(schedule.components))
    data = NormalisedPoints.of(schedule, way)
    terms, unknown = identifiable(data.design(terms, data.loads), data.intercepts, terms)
    unknown += _beyond_model(data, terms, unknown)
    if way == "non-iterative":  # small interactions must not pass for products of loads that were never combined
        terms, more = identifiable(data.design(terms, data.outputs), data.intercepts, terms)
        unknown += more
    choice = Choice.everything(len(schedule.components), len(terms))
    try:
        tares, regressions = data.fit(terms, choice)
    except FitError as error:
        if outliers:
            raise FitError(f"{schedule.name}: {outliers_text(schedule, outliers)}") from error
        raise
    if model == "auto":
        choice = _chosen(data, terms, tares, ~outlying_points(regressions, data.output_scale))
        tares, regressions = data.fit(terms, choice)
    matrix = replace(data.matrix(terms, regressions, tares), reading_noise=noise)
    residuals = data.residuals(matrix, regressions, tares)
    fitted = residuals[schedule.fitted] / schedule.capacities
    outliers = find_outliers(schedule, terms, regressions, data.output_scale, way)
    check_residuals(schedule, fitted, regressions, outliers)
    by_iteration = data.tares_by_iteration(terms, choice, regressions) if data.absolute else None
    return Calibration(
        schedule=schedule,
        model=model,
        way=way,
        matrix=matrix,
        regressions=regressions,
        tares=tares * schedule.capacities,
        u_tares=data.tare_uncertainty(matrix, regressions) * schedule.capacities,
        tares_by_iteration=None if by_iteration is None else by_iteration * schedule.capacities,
        residuals=residuals,
        unidentified=unknown,
        condition=data.condition(terms, tares),
    )


def matrix_of(balance: BalanceMatrix | Calibration) -> BalanceMatrix:
    """Return the balance matrix itself, of a calibration or as it is."""
    return balance.matrix if isinstance(balance, Calibration) else balance


def _noise_of(given: float | Mapping[str, float], gauges: Sequence[str]) -> float | Array:
    """Noise of a reading, one number or by bridge, shape (c,) [mV/V]; a bridge is its name, or r and its name."""
    if not isinstance(given, Mapping):
        return given
    names = {f"r{gauge}": place for place, gauge in enumerate(gauges)}
    for place, gauge in enumerate(gauges):
        names.setdefault(gauge, place)
    noise = np.zeros(len(gauges))
    for name, value in given.items():
        if name not in names:
            raise ValueError(
                f"reading_noise is given for {name}, which is no bridge of the schedule; it has "
                + ", ".join(f"r{gauge}" for gauge in gauges)
            )
        noise[names[name]] = value
    return noise


def _beyond_model(
    data: NormalisedPoints, terms: tuple[Term, ...], unknown: tuple[Unidentified, ...]
) -> tuple[Unidentified, ...]:
    """Further terms, of the 96 of AIAA R-091, that the schedule cannot tell, whether or not the model offers them."""
    known = {*terms, *(item.term for item in unknown)}
    everything = terms_of("96", data.loads.shape[1])
    others = identifiable(data.design(everything, data.loads), data.intercepts, everything)[1]
    return tuple(item for item in others if item.term not in known)


def _chosen(data: NormalisedPoints, terms: tuple[Term, ...], tares: Array, used: NDArray[np.bool_]) -> Choice:
    """Significant terms of every component, and the shrinkage of their coefficients, by the points used, shape (n,).

    Points that contradict the others have no say: terms that nothing else asks for would be chosen to fit them, and
    sound points beside them would look wrong.
    """
    design = data.design(terms, data.variables(tares))[used]
    kinds = np.array([term.kind for term in terms])
    points = []
    for i, values in enumerate(data.targets.T):
        nuisance = data.nuisance(i)[used]
        own = without_intercepts(np.column_stack([design, values[used]]), nuisance)
        points.append(Design(own[:, :-1], own[:, -1], len(own) - nuisance.shape[1]))
    coefficients = shrink(points, kinds)
    return Choice(select(coefficients, kinds), coefficients.penalty)
