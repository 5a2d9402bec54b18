"""Checks of a load schedule: signs, wiring, slopes and zeros, with the component and the evidence for each fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance import _term_kernels as kernels
from aerobalance.balance.calibration.outliers import Outlier, find_outliers, outliers_text, outlying_points
from aerobalance.balance.calibration.regression import Regression, regress, residual_deviation
from aerobalance.balance.calibration.selection import identifiable
from aerobalance.balance.schedule import Schedule
from aerobalance.balance.terms import codes, terms_of
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError, argument, warn_quality


@dataclass(frozen=True, slots=True)
class CheckSettings:
    """Thresholds of the checks of a calibration.

    Attributes
    ----------
    loaded
        Least span of a load, over capacity, for its component to count as loaded.
    series_loaded
        Least span of a load in a series, over capacity, for the series to tell the sensitivity.
    dead
        Output at capacity, over the median of all bridges, below which a bridge is taken as dead.
    own_answer
        Sensitivity to the own load, over that to any load, below which its sign tells nothing.
    slope_doubt
        Relative departure of one series' sensitivity from the median that is doubted.
    slope_fault
        The same that is refused.
    slope_far
        The same from which the median says nothing of the series, and no percentage of it is given.
    beyond
        Largest load over capacity from which units are asked about; balances are loaded up to their capacity.
    hardly
        The same below which they are.
    outputs
        Least and largest output at capacity that bridges may well have [mV/V]: metal gauges give 0.3 to 4, those of
        semiconductor ten times that.
    doubtful
        Standard deviation of the residuals, over capacity, that is doubted.
    unfit
        The same that is refused.
    points_per_unknown
        Fewest points for each unknown, for one point to be held against the others before the terms are chosen.
    few_of_series
        Share of the loaded points of a series up to which they are wrong one by one; from there on it is the series.
    drift
        Change of a zero within a series, over capacity, that is doubted.
    drift_in_noise
        Range of zero readings, over the standard deviation of one, that noise does not reach. Noise itself does not
        reach 8; a fit with nearly as many terms as points leaves neighbours closer than their noise.
    """

    loaded: float = 0.01
    series_loaded: float = 0.1
    dead: float = 0.02
    own_answer: float = 0.3
    slope_doubt: float = 0.05
    slope_fault: float = 0.3
    slope_far: float = 10.0
    beyond: float = 1.5
    hardly: float = 0.25
    outputs: tuple[float, float] = (0.03, 40.0)
    doubtful: float = 0.005
    unfit: float = 0.05
    points_per_unknown: float = 2.0
    few_of_series: float = 0.5
    drift: float = 0.005
    drift_in_noise: float = 10.0


SETTINGS: Final = CheckSettings()
"""Thresholds that are used."""


FACTORS: Final = {
    4.4482: "lbf and N",
    9.80665: "kgf and N",
    1000.0: "a unit and a thousand of it",
    1.35582: "ft-lbf and N*m",
    8.8507: "in-lbf and N*m",
    12.0: "ft-lbf and in-lbf",
}
"""Factors between units that are mistaken for each other, and the units."""


def check_schedule(schedule: Schedule) -> tuple[Outlier, ...]:
    """Return wrong points by a fit of few terms, and refuse a schedule that cannot give a matrix, before it is fitted.

    Raises
    ------
    FitError
        A component is never loaded, a bridge is dead or answers to another load, or a series contradicts the others;
        the message names the component and the evidence.

    Warns
    -----
    DataQualityWarning
        A series' sensitivity departs from the others, or loads or outputs are of a size that a wrong unit makes.
    """
    used = schedule.fitted
    if np.count_nonzero(used) < schedule.loads.shape[1] + 2:
        raise FitError(
            f"{schedule.name}: {np.count_nonzero(used)} points; a matrix of {schedule.loads.shape[1]} components "
            f"needs at least {schedule.loads.shape[1] + 2}"
        )
    points = _Points(schedule.loads[used] / schedule.capacities, schedule.outputs[used], schedule.series[used])
    loads, outputs = points.loads, points.outputs
    for index, name in enumerate(schedule.components):
        if np.ptp(loads[:, index]) < SETTINGS.loaded:
            raise FitError(
                f"{schedule.name}: {name} is never loaded (its loads span {100 * np.ptp(loads[:, index]):.2g} % of "
                f"capacity), so nothing tells its sensitivity; add series with {name} in both directions"
            )
        if np.ptp(outputs[:, index]) == 0:
            raise FitError(
                f"{schedule.name}: the bridge of {name} is dead: it reads {outputs[0, index]:.6g} mV/V at all "
                f"{outputs.shape[0]} points"
            )
    # a series is judged by what its points agree on: one wrong point of it is named by itself after the fit
    outlying, outliers = _outlying(schedule, points)
    points = points.only(~outlying)
    sensitivity = _sensitivity(points)
    _check_units(schedule, np.abs(loads).max(axis=0), np.max(np.abs(sensitivity), axis=1))
    slopes = [_slopes(points, index) for index in range(loads.shape[1])]
    _check_signs(schedule, slopes, np.max(np.abs(sensitivity), axis=1))
    _check_wiring(schedule, sensitivity)
    _check_slopes(schedule, slopes)
    return outliers


def _check_units(schedule: Schedule, reach: Array, answers: Array) -> None:
    """Ask about units where loads are far from capacity, or outputs from those of strain gauges.

    `reach` is the largest load over capacity, `answers` the output at capacity [mV/V], each by component.
    """
    for name, part in zip(schedule.components, reach.tolist(), strict=True):
        if SETTINGS.hardly <= part <= SETTINGS.beyond:
            continue
        too_large = part > SETTINGS.beyond
        units = [
            f"{words} ({factor:.4g})"
            for factor, words in FACTORS.items()
            if SETTINGS.hardly <= (part / factor if too_large else part * factor) <= 1.0 + SETTINGS.loaded
        ]
        reason = f"; between {' or '.join(units)} lies such a factor" if units else ""
        only = "" if too_large else "If so, the matrix holds up to there only. "
        warn_quality(
            f"{schedule.name}: the loads of {name} reach {part:.3g} times its capacity{reason}: are loads and "
            f"capacity in the units that the file says? {only}"
            "A wrong unit makes all loads of a run wrong by the same factor"
        )
    low, high = SETTINGS.outputs
    odd = [(name, size) for name, size in zip(schedule.components, answers.tolist(), strict=True) if size > 0]
    odd = [(name, size) for name, size in odd if not low <= size <= high]
    if odd and len(odd) > len(schedule.components) / 2:
        told = ", ".join(f"{name} {size:.3g}" for name, size in odd)
        warn_quality(
            f"{schedule.name}: the bridges give at capacity [mV/V]: {told}; strain gauges give 0.3 to 4: are the "
            "outputs in the unit that the file says, and is the capacity? The matrix carries the error into no load "
            "as long as runs have the same unit, but into every uncertainty in mV/V"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Points that are compared: loads over capacity (n, c), outputs (n, c) [mV/V], number of their series (n,)."""

    loads: Array
    outputs: Array
    series: NDArray[np.intp]

    def only(self, used: NDArray[np.bool_]) -> _Points:
        return _Points(self.loads[used], self.outputs[used], self.series[used])


def _outlying(schedule: Schedule, points: _Points) -> tuple[NDArray[np.bool_], tuple[Outlier, ...]]:
    """Points that contradict the others in any bridge, shape (n,), but none of a series that does so as a whole.

    By the terms of Eq. (2) where there are `SETTINGS.points_per_unknown` points for each, else by the linear ones.
    """
    outlying = np.zeros(len(points.series), dtype=np.bool_)
    numbers = np.unique(points.series)
    intercepts = (points.series[:, None] == numbers).astype(float)
    scale = np.max(np.abs(_sensitivity(points)), axis=1)
    for model in ("quadratic", "linear"):
        offered = terms_of(model, points.loads.shape[1])
        design = np.asarray(kernels.design(*codes(offered), np.ascontiguousarray(points.loads)))
        terms, _ = identifiable(design, intercepts, offered)
        if len(points.series) >= SETTINGS.points_per_unknown * (len(terms) + numbers.size) and (scale > 0).all():
            break
    else:
        return outlying, ()
    design = design[:, [offered.index(term) for term in terms]]
    free, included = np.zeros(len(terms)), np.ones(len(terms), dtype=np.bool_)
    fits = [
        regress(values, design, intercepts, included=included, penalty=free) for values in (points.outputs / scale).T
    ]
    for index, fit in enumerate(fits):
        found = outlying_points([fit], scale[index : index + 1])
        loaded = np.abs(points.loads[:, index]) > SETTINGS.series_loaded
        for number in numbers:
            inside = points.series == number
            if np.count_nonzero(found & inside) > SETTINGS.few_of_series * np.count_nonzero(loaded & inside):
                found &= ~inside
        outlying |= found
    wrong = {int(point) for point in np.flatnonzero(schedule.fitted)[outlying]}
    named = find_outliers(schedule, terms, fits, scale, "iterative")
    return outlying, tuple(item for item in named if item.point in wrong)


def _sensitivity(points: _Points) -> Array:
    """Outputs at capacity [mV/V], bridges in rows, loads in columns, shape (c, c)."""
    x, y = _centred(points.loads, points.series), _centred(points.outputs, points.series)
    return np.asarray(np.linalg.lstsq(x, y, rcond=None)[0].T)


def _centred(values: Array, series: NDArray[np.intp]) -> Array:
    centred = np.array(values)
    for number in np.unique(series):
        centred[series == number] -= values[series == number].mean(axis=0)
    return centred


def _slopes(points: _Points, index: int) -> dict[int, tuple[float, float]]:
    """Output at capacity of a component's own bridge in each series that loads it, and how well it is told."""
    loads, outputs, series = points.loads, points.outputs, points.series
    found = {}
    for number in np.unique(series):
        inside = series == number
        if np.count_nonzero(inside) < 3 or np.ptp(loads[inside, index]) < SETTINGS.series_loaded:
            continue
        x = loads[inside] - loads[inside].mean(axis=0)
        y = outputs[inside, index] - outputs[inside, index].mean()
        others = np.delete(x, index, axis=1)
        others = others[:, np.ptp(others, axis=0) >= SETTINGS.series_loaded]
        if others.shape[1]:
            own = x[:, index] - others @ np.linalg.lstsq(others, x[:, index], rcond=None)[0]
            y = y - others @ np.linalg.lstsq(others, y, rcond=None)[0]
        else:
            own = x[:, index]
        weight = float(own @ own)
        if weight > SETTINGS.series_loaded**2:
            slope = float(own @ y) / weight
            rest = y - slope * own
            found[int(number)] = (slope, float(np.sqrt(rest @ rest / max(y.size - 2, 1) / weight)))
    return found


def _check_signs(schedule: Schedule, slopes: list[dict[int, tuple[float, float]]], answers: Array) -> None:
    """Refuse a series in which a bridge answers with the other sign; `answers` are the strongest to any load."""
    for name, found, answer in zip(schedule.components, slopes, answers, strict=True):
        clear = {number: slope for number, (slope, u) in found.items() if abs(slope) > 5 * u}
        if len(clear) < 2:
            continue
        middle = float(np.median(np.abs(list(clear.values()))))
        if middle < SETTINGS.own_answer * answer:  # it answers to another load: the wires are crossed
            continue
        strong = {number: slope for number, slope in clear.items() if abs(slope) > 0.3 * middle}
        sign = np.sign(sum(np.sign(slope) for slope in strong.values())) or np.sign(next(iter(strong.values())))
        wrong = [number for number, slope in strong.items() if np.sign(slope) != sign]
        if wrong:
            names = ", ".join(repr(schedule.series_names[number]) for number in wrong)
            right = next(number for number, slope in strong.items() if np.sign(slope) == sign)
            raise FitError(
                f"{schedule.name}: wrong sign of {name} in series {names}: its bridge gives "
                f"{strong[wrong[0]]:+.4g} mV/V at capacity there, but {strong[right]:+.4g} mV/V in series "
                f"{schedule.series_names[right]!r}; correct the sign of the loads or of the outputs"
            )


def _check_wiring(schedule: Schedule, sensitivity: Array) -> None:
    """Refuse bridges that are dead, or that answer more to another load than to their own."""
    own = np.abs(np.diag(sensitivity))
    strongest = np.argmax(np.abs(sensitivity), axis=1)
    # a dead bridge's noise goes with one load or another: that is no crossed wire
    answers = np.max(np.abs(sensitivity), axis=1)
    _check_alive(schedule, answers)
    for index, name in enumerate(schedule.components):
        other = int(strongest[index])
        if other != index and abs(sensitivity[index, other]) > 2 * own[index]:
            back = " and the other way round" if strongest[other] == index else ""
            raise FitError(
                f"{schedule.name}: crossed wires: the bridge of {name} gives {sensitivity[index, other]:+.4g} mV/V at "
                f"the capacity of {schedule.components[other]}, but {sensitivity[index, index]:+.4g} mV/V at that of "
                f"{name}{back}; put the columns of the bridges in the order of the loads"
            )
    _check_alive(schedule, own)


def _check_alive(schedule: Schedule, answers: Array) -> None:
    for name, answer in zip(schedule.components, answers, strict=True):
        if answer < SETTINGS.dead * np.median(answers):
            raise FitError(
                f"{schedule.name}: the bridge of {name} is dead: {answer:.3g} mV/V at capacity, while the others "
                f"give about {np.median(answers):.3g} mV/V"
            )


def _check_slopes(schedule: Schedule, slopes: list[dict[int, tuple[float, float]]]) -> None:
    """Warn of a series whose sensitivity is not that of the others."""
    for name, found in zip(schedule.components, slopes, strict=True):
        if len(found) < 2:
            continue
        middle = float(np.median([slope for slope, _ in found.values()]))
        for number, (slope, u) in found.items():
            departure = slope / middle - 1 if middle else np.inf
            if abs(departure) < SETTINGS.slope_doubt or abs(slope - middle) < 5 * u:
                continue
            from_middle = f"{100 * departure:+.3g} %" if abs(departure) < SETTINGS.slope_far else "far"
            text = (
                f"{schedule.name}: the bridge of {name} gives {slope:.4g} mV/V at capacity in series "
                f"{schedule.series_names[number]!r}, {from_middle} from the {middle:.4g} mV/V of the "
                "median series"
            )
            if abs(departure) > SETTINGS.slope_fault:
                raise FitError(
                    f"{text}; check the loads, units and arms of that series, or leave it out with "
                    f"{argument('Schedule.without', [schedule.series_names[number]])}"
                )
            warn_quality(f"{text}; the matrix averages over both")


def _check_zeros(schedule: Schedule, residuals: Array) -> None:
    """Warn of bridges whose zero readings drift within a series by more than their noise."""
    used = schedule.fitted
    series = schedule.series[used]
    unloaded = schedule.unloaded[used]
    for index, name in enumerate(schedule.components):
        column = residuals[:, index]
        # neighbours differ by noise alone; the median is not moved by the few that a drift or a step lies between
        noise = float(np.median(np.abs(np.diff(column)))) / 0.954
        worst, where = 0.0, 0
        for number in np.unique(series):
            zeros = column[(series == number) & unloaded]
            if zeros.size > 1 and np.ptp(zeros) > worst:
                worst, where = float(np.ptp(zeros)), int(number)
        if worst > max(SETTINGS.drift, SETTINGS.drift_in_noise * noise):
            warn_quality(
                f"{schedule.name}: the zero of {name} drifts by {100 * worst:.2g} % of capacity within "
                f"series {schedule.series_names[where]!r}; the drift goes into the residuals"
            )


def check_residuals(
    schedule: Schedule, residuals: Array, regressions: Sequence[Regression], outliers: Sequence[Outlier]
) -> None:
    """Refuse a fitted matrix, or warn of it, by its residuals over capacity, shape (n, c).

    Raises
    ------
    FitError
        The standard deviation of a component's residuals is above `SETTINGS.unfit` of capacity.

    Warns
    -----
    DataQualityWarning
        It is above `SETTINGS.doubtful`, or a zero drifts.
    """
    _check_zeros(schedule, residuals)
    size = residual_deviation(residuals, regressions)
    bad = np.flatnonzero(size > SETTINGS.unfit).tolist()
    if bad:
        wrong = [item for item in outliers if item.component in bad]
        if all(regressions[i].deviation_without < SETTINGS.unfit for i in bad):
            raise FitError(f"{schedule.name}: {outliers_text(schedule, wrong)}")
        texts = [f"{schedule.components[i]} {100 * size[i]:.3g} %{_blame(schedule, residuals[:, i])}" for i in bad]
        raise FitError(
            f"{schedule.name}: unfit for a matrix: the readings do not follow the loads. Standard deviation of the "
            f"residuals in percent of capacity: {', '.join(texts)}. Look for drifting or loose bridges, and repeat "
            f"these series, or leave out what is known to be wrong ({argument('Schedule.without')})"
        )
    for i in np.flatnonzero(size > SETTINGS.doubtful).tolist():
        if regressions[i].deviation_without < SETTINGS.doubtful:
            continue  # single points make it, which are named
        warn_quality(
            f"{schedule.name}: the residuals of {schedule.components[i]} have a standard deviation of "
            f"{100 * size[i]:.2g} % of capacity{_blame(schedule, residuals[:, i])}; balances reach 0.05 to 0.3 %. "
            "Loads from this matrix are no better"
        )


def _blame(schedule: Schedule, residuals: Array) -> str:
    """Return the name of the series that the residuals of one component come from."""
    series = schedule.series[schedule.fitted]
    sums = {number: float(np.sum(residuals[series == number] ** 2)) for number in np.unique(series)}
    total = sum(sums.values())
    worst = max(sums, key=lambda number: sums[number])
    if total == 0 or len(sums) == 1:
        return ""
    return f" ({100 * sums[worst] / total:.0f} % of it in series {schedule.series_names[worst]!r})"
