"""Normalised calibration points: loads over capacity, outputs over the output at capacity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance import _term_kernels as kernels
from aerobalance.balance.calibration.regression import Choice, Regression, regress
from aerobalance.balance.inversion import inverted
from aerobalance.balance.matrix import BalanceMatrix, TemperatureEffect, Way
from aerobalance.balance.schedule import Schedule
from aerobalance.balance.terms import Term, codes, linear_part
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError


@dataclass(frozen=True, slots=True)
class TareSettings:
    """Tolerances of the search for tares, and when temperature is fitted.

    Attributes
    ----------
    tare_rounds
        Most rounds in the search for the tares.
    tare_tolerance
        Last change of a tare, over capacity, at which the search ends.
    iteration_tolerance
        The same in the iteration of AIAA R-091.
    iteration_memory
        Rounds of that iteration from which the next step is put together.
    temperature_span
        Span of temperature from which its effects are fitted [K].
    """

    tare_rounds: int = 300
    tare_tolerance: float = 1e-12
    iteration_tolerance: float = 1e-9
    iteration_memory: int = 20
    temperature_span: float = 2.0


SETTINGS: Final = TareSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class NormalisedPoints:
    """Normalised points that take part in the fit: n points, c components, s series with points.

    Attributes
    ----------
    schedule, way
        What is fitted, and which way.
    loads, outputs
        Loads over capacity, outputs less zero over `output_scale`, shape (n, c).
    all_outputs
        The same of all points, confirmation points among them.
    output_scale
        Rough output at capacity, shape (c,) [mV/V].
    zero
        Natural zero, shape (c,) [mV/V]; zero where there is none.
    intercepts
        One column for each series, shape (n, s).
    warmth
        Temperature less its mean, shape (n,) [K]; None where it is not known or does not vary.
    """

    schedule: Schedule
    way: Way
    loads: Array
    outputs: Array
    all_outputs: Array
    output_scale: Array
    zero: Array
    intercepts: Array
    warmth: Array | None

    @classmethod
    def of(cls, schedule: Schedule, way: Way) -> NormalisedPoints:
        """Return the normalised points of a schedule that take part in the fit."""
        if way not in ("iterative", "non-iterative"):
            raise ValueError(f"way must be iterative or non-iterative, not {way!r}")
        used = schedule.fitted
        zero = schedule.natural_zeros.mean(axis=0) if len(schedule.natural_zeros) else np.zeros(len(schedule.gauges))
        intercepts = np.eye(len(schedule.series_names))[schedule.series[used]]
        loads = schedule.loads[used] / schedule.capacities
        raw = schedule.outputs - zero
        rough = np.linalg.lstsq(np.hstack([loads, intercepts]), raw[used], rcond=None)[0]
        scale = np.abs(np.diag(rough[: loads.shape[1]]))
        if not len(schedule.natural_zeros):
            raw = raw - _series_zeros(schedule, rough[loads.shape[1] :])[schedule.series]
        warmth = None
        if schedule.temperature is not None and np.ptp(schedule.temperature[used]) > SETTINGS.temperature_span:
            warmth = schedule.temperature[used] - schedule.temperature[used].mean()
        return cls(
            schedule,
            way,
            loads,
            raw[used] / scale,
            raw / scale,
            scale,
            zero,
            intercepts[:, intercepts.any(axis=0)],
            warmth,
        )

    @property
    def absolute(self) -> bool:
        """Whether natural zeros make the loads of the fixtures known."""
        return len(self.schedule.natural_zeros) > 0

    @property
    def series_used(self) -> NDArray[np.intp]:
        """Numbers of the series that take part, one for each column of the intercepts."""
        return np.unique(self.schedule.series[self.schedule.fitted])

    def per_point(self, tares: Array) -> Array:
        """Tare of every point, shape (n, c), from those of the series, shape (s, c)."""
        return np.asarray(np.nan_to_num(tares)[self.schedule.series[self.schedule.fitted]])

    def variables(self, tares: Array) -> Array:
        """Variables of the terms, shape (n, c): loads, or outputs in the non-iterative way."""
        return self.loads + self.per_point(tares) if self.way == "iterative" else self.outputs

    @property
    def targets(self) -> Array:
        """Values that the terms are fitted to beside the series intercepts, shape (n, c)."""
        return self.outputs if self.way == "iterative" else self.loads

    def design(self, terms: tuple[Term, ...], x: Array) -> Array:
        """Values of the terms, shape (n, t)."""
        return np.asarray(kernels.design(*codes(terms), np.ascontiguousarray(x)))

    def nuisance(self, index: int) -> Array:
        """Intercepts of the series and, where temperature varied, its effect on zero and sensitivity."""
        columns = [self.intercepts]
        if self.warmth is not None:
            columns.append(self.warmth[:, None] * np.column_stack([np.ones(len(self.loads)), self.loads[:, index]]))
        return np.hstack(columns)

    def fit(self, terms: tuple[Term, ...], choice: Choice) -> tuple[Array, tuple[Regression, ...]]:
        """Return the tares over capacity, shape (s, c), and the fits of all components, with tares as intercepts.

        A series that has no points in the fit has no tares: NaN.
        """
        c = self.loads.shape[1]
        tares = np.zeros((len(self.schedule.series_names), c))
        if not self.absolute:
            return tares, self._regress(terms, choice, tares)
        tares[np.setdiff1d(np.arange(len(tares)), self.series_used)] = np.nan
        if self.way == "non-iterative":
            regressions = self._regress(terms, choice, tares)
            tares[self.series_used] = -np.column_stack(
                [fit.intercepts[: self.intercepts.shape[1]] for fit in regressions]
            )
            return tares, regressions
        for _ in range(SETTINGS.tare_rounds):
            C, left = self._coefficients(terms, choice, tares)
            # where only differences within a series are fitted, what is left of the outputs is a load of the fixture
            change = np.linalg.solve(linear_part(terms, C), left.T).T
            tares[self.series_used] += change
            if np.max(np.abs(change)) < SETTINGS.tare_tolerance:
                return tares, self._regress(terms, choice, tares)
        raise FitError(
            f"{self.schedule.name}: the tares do not settle (last change {100 * np.max(np.abs(change)):.2g} % of "
            "capacity); choose a model with fewer terms, or check the natural zeros"
        )

    def _coefficients(self, terms: tuple[Term, ...], choice: Choice, tares: Array) -> tuple[Array, Array]:
        """Coefficients (t, c) and series intercepts (s, c) alone, without the statistics that `regress` adds."""
        design, targets = self.design(terms, self.variables(tares)), self.targets
        C, left = choice.solve(design, [self.nuisance(i) for i in range(targets.shape[1])], targets)
        return C, left[: self.intercepts.shape[1]]

    def _regress(self, terms: tuple[Term, ...], choice: Choice, tares: Array) -> tuple[Regression, ...]:
        design = self.design(terms, self.variables(tares))
        return tuple(
            regress(values, design, self.nuisance(i), included=choice.included[i], penalty=choice.penalty[i])
            for i, values in enumerate(self.targets.T)
        )

    def tares_by_iteration(
        self, terms: tuple[Term, ...], choice: Choice, regressions: tuple[Regression, ...]
    ) -> Array:
        """Tares by the iteration of AIAA R-091, over capacity, shape (s, c).

        The matrix is fitted without intercepts; the mean difference of computed and applied load is the next tare. As
        each round takes off a small part of the error only, steps are put together (Anderson's acceleration).
        """
        used = self.series_used
        outputs = self.outputs - self._warm(terms, regressions)[self.schedule.fitted]
        tares = np.full((len(self.schedule.series_names), self.loads.shape[1]), np.nan)
        now: Array = np.zeros((used.size, self.loads.shape[1]))
        if self.way == "iterative":  # from nothing it need not settle where the fixtures are heavy
            C, left = self._coefficients(terms, choice, np.zeros_like(tares))
            now = np.asarray(np.linalg.solve(linear_part(terms, C), left.T).T, dtype=np.float64)
        places: list[Array] = []
        steps: list[Array] = []
        for _ in range(SETTINGS.tare_rounds):
            tares[used] = now
            step = self._tare_step(terms, choice, outputs, tares)
            if not np.isfinite(step).all():
                break
            if np.max(np.abs(step)) < SETTINGS.iteration_tolerance:
                return tares
            places, steps = (
                [*places[-SETTINGS.iteration_memory :], now.ravel()],
                [*steps[-SETTINGS.iteration_memory :], step.ravel()],
            )
            following = now.ravel() + step.ravel()
            if len(steps) > 1:
                by_step, by_place = np.diff(steps, axis=0).T, np.diff(places, axis=0).T
                following -= (by_place + by_step) @ np.linalg.lstsq(by_step, steps[-1], rcond=None)[0]
            now = following.reshape(now.shape)
        return tares

    def _tare_step(self, terms: tuple[Term, ...], choice: Choice, outputs: Array, tares: Array) -> Array:
        """Mean difference of computed and applied load in every series, over capacity, shape (s, c)."""
        series = self.schedule.series[self.schedule.fitted]
        total = self.loads + self.per_point(tares)
        x, y = (total, outputs) if self.way == "iterative" else (outputs, total)
        design = self.design(terms, x)
        C, _ = choice.solve(design, [np.zeros((len(design), 0))] * y.shape[1], y)
        if self.way == "non-iterative":
            computed = design @ C
        else:
            computed = _solve(terms, C, outputs)
            # far from the tares the first matrices may not lead back to every load: one linear step stands in
            near = total + np.linalg.solve(linear_part(terms, C), (outputs - design @ C).T).T
            computed = np.where(np.isfinite(computed).all(axis=1, keepdims=True), computed, near)
        return np.array([(computed - total)[series == number].mean(axis=0) for number in self.series_used])

    def matrix(self, terms: tuple[Term, ...], regressions: tuple[Regression, ...], tares: Array) -> BalanceMatrix:
        """Return the balance matrix made of the fits of all components."""
        schedule = self.schedule
        total = (self.loads + self.per_point(tares)) * schedule.capacities
        rest = np.column_stack([fit.residuals for fit in regressions])
        return BalanceMatrix(
            components=schedule.components,
            gauges=schedule.gauges,
            way=self.way,
            terms=terms,
            coefficients=np.column_stack([fit.coefficients for fit in regressions]),
            load_scale=schedule.capacities,
            output_scale=self.output_scale,
            covariance=np.array([fit.covariance for fit in regressions]),
            residual_deviation=np.array([fit.deviation for fit in regressions]),
            residual_correlation=_correlation(rest),
            degrees_of_freedom=np.array([fit.degrees_of_freedom for fit in regressions]),
            calibrated=np.array([total.min(axis=0), total.max(axis=0)]),
            natural_zero=self.zero if self.absolute else None,
            moments=schedule.moments,
            balance_type=schedule.balance_type,
            geometry=schedule.geometry,
            temperature=self._temperature(terms, regressions),
        )

    def _temperature(
        self, terms: tuple[Term, ...], regressions: tuple[Regression, ...]
    ) -> dict[str, TemperatureEffect]:
        if self.warmth is None or self.schedule.temperature is None:
            return {}
        reference = float(self.schedule.temperature[self.schedule.fitted].mean())
        first = self.intercepts.shape[1]
        effects = np.array([fit.intercepts[first : first + 2] for fit in regressions])
        u = np.array([fit.u_intercepts[first : first + 2] for fit in regressions])
        if self.way == "non-iterative":
            # a bridge that reads too high gives too much of every load that it takes part in, which the terms take off
            inverse = np.linalg.inv(linear_part(terms, np.column_stack([fit.coefficients for fit in regressions])))
            effects = np.column_stack([-inverse @ effects[:, 0], -effects[:, 1]])
            u[:, 0] = np.sqrt(inverse**2 @ u[:, 0] ** 2)
        return {
            name: TemperatureEffect(
                reference,
                float(effects[i, 0] * self.output_scale[i]),
                float(u[i, 0] * self.output_scale[i]),
                float(effects[i, 1]),
                float(u[i, 1]),
            )
            for i, name in enumerate(self.schedule.components)
        }

    def residuals(self, matrix: BalanceMatrix, regressions: tuple[Regression, ...], tares: Array) -> Array:
        """Load computed less load applied at all points, confirmation points among them, shape (n, c) [N, N*m]."""
        schedule = self.schedule
        left = np.full((len(schedule.series_names), len(schedule.components)), np.nan)
        left[self.series_used] = np.column_stack([fit.intercepts[: self.intercepts.shape[1]] for fit in regressions])
        offset, tare = left[schedule.series], np.nan_to_num(tares)[schedule.series]
        # a series of confirmation points alone has no tare from the fit: its own mean stands for it
        outputs = self.all_outputs - self._warm(matrix.terms, regressions)
        if self.way == "iterative":
            computed = _solve(matrix.terms, matrix.coefficients, outputs - np.nan_to_num(offset))
            residual = computed - schedule.loads / schedule.capacities - tare
        else:
            computed = self.design(matrix.terms, outputs) @ matrix.coefficients
            residual = computed - schedule.loads / schedule.capacities + np.nan_to_num(offset)
        for number in set(schedule.series) - set(self.series_used):
            inside = schedule.series == number
            residual[inside] -= residual[inside].mean(axis=0)
        return np.asarray(residual * schedule.capacities)

    def _warm(self, terms: tuple[Term, ...], regressions: tuple[Regression, ...]) -> Array:
        """Part of the outputs that comes from temperature, at all points, shape (n, c)."""
        effects = self._temperature(terms, regressions)
        if not effects or self.schedule.temperature is None:
            return np.zeros_like(self.all_outputs)
        loads = self.schedule.loads / self.schedule.capacities
        zero = np.array([effect.zero for effect in effects.values()]) / self.output_scale
        gain = np.array([effect.sensitivity for effect in effects.values()])
        change = self.schedule.temperature - next(iter(effects.values())).reference
        return np.asarray(change[:, None] * (zero + gain * loads))

    def tare_uncertainty(self, matrix: BalanceMatrix, regressions: tuple[Regression, ...]) -> Array:
        """Standard uncertainty of the tares, over capacity, shape (s, c); NaN where they are not known."""
        u = np.full((len(self.schedule.series_names), len(self.schedule.components)), np.nan)
        if not self.absolute:
            return u
        found = np.column_stack([fit.u_intercepts[: self.intercepts.shape[1]] for fit in regressions])
        # the natural zero is a mean of few readings, and every tare counts from it
        zero = matrix.residual_deviation / np.sqrt(len(self.schedule.natural_zeros))
        found = np.hypot(found, zero)
        if self.way == "iterative":
            found = np.sqrt(found**2 @ (np.linalg.inv(matrix.linear) ** 2).T)
        u[self.series_used] = found
        return u

    def condition(self, terms: tuple[Term, ...], tares: Array) -> float:
        """Condition number of the design, columns scaled to one."""
        design = self.design(terms, self.variables(tares))
        return float(np.linalg.cond(design / np.linalg.norm(design, axis=0)))


def _series_zeros(schedule: Schedule, rough: Array) -> Array:
    """Zeros of every series where there are no natural ones, shape (s, c): readings without load, else a rough fit."""
    zeros = np.array(rough)
    for number in range(len(zeros)):
        inside = schedule.unloaded & (schedule.series == number)
        if inside.any():
            zeros[number] = schedule.outputs[inside].mean(axis=0)
    return zeros


def _solve(terms: tuple[Term, ...], C: Array, outputs: Array) -> Array:
    """Loads over capacity that give these outputs over the output at capacity, shape (n, c)."""
    return inverted(codes(terms), C, linear_part(terms, C), outputs)[0]


def _correlation(residuals: Array) -> Array:
    size = np.sqrt(np.sum(residuals**2, axis=0))
    unit = residuals / np.where(size > 0, size, 1.0)
    correlation = unit.T @ unit
    np.fill_diagonal(correlation, 1.0)
    return np.asarray(correlation)
