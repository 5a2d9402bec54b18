"""Monte Carlo check of an uncertainty [JCGM101]_: the estimator run again with everything drawn that is not exact.

One draw takes the dynamics from their covariance, runs the estimator again on the same readings with the prior and the
steps as found, draws a force and readings from that very model and adds the error that the estimator makes on them
[Durbin2002]_, and adds the errors of the ground's motion and of the balance matrix. Numbers that hold along the record
are drawn in sets that have exactly the mean and covariance they stand for, so few draws suffice.

References
----------
.. [JCGM101] JCGM 101:2008, "Evaluation of measurement data - Supplement 1 - Propagation of distributions using a Monte
   Carlo method".
.. [Durbin2002] J. Durbin, S. J. Koopman, "A simple and efficient simulation smoother for state space time series
   analysis", Biometrika 89 (2002) 603.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import repeat
from typing import Final

import numpy as np

from aerobalance.estimation.component_force import Method, estimated
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.decoupled_record import DecoupledRecord
from aerobalance.estimation.error_sources import Noise, Systematic
from aerobalance.estimation.force import Force, ForceRecord
from aerobalance.estimation.force_smoother import LinearSmoother
from aerobalance.estimation.prior import Observation, SpectralPrior
from aerobalance.estimation.record import ComponentRecord, SingleRecord
from aerobalance.estimation.result import ComponentForce
from aerobalance.estimation.steps import Step, shape_of
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.uncertainty.budget import noise_power, scalars
from aerobalance.uncertainty.sampling import drawn_coupled, drawn_dynamics, drawn_numbers


@dataclass(frozen=True, slots=True)
class MonteCarloSettings:
    """Thresholds of the comparison of Monte Carlo with first order.

    Attributes
    ----------
    coverage
        Percentiles between which 95 % of the draws lie.
    allowed
        Difference between Monte Carlo and first order that is no reason for a warning, relative.
    sure
        Standard deviations of Monte Carlo's own scatter that such a difference must exceed beyond that.
    fewest_draws
        Draws without which a standard deviation says nothing.
    slight
        Rms of a contribution over that of all below which its difference is no reason for a warning.
    """

    coverage: tuple[float, float] = (2.5, 97.5)
    allowed: float = 0.1
    sure: float = 3.0
    fewest_draws: int = 10
    slight: float = 0.05


SETTINGS: Final = MonteCarloSettings()
"""Thresholds that are used."""


SIZES: Final = ("size and instant of steps", "which side of a step a sample is on")
NOISES: Final = ("noise of the readings", "noise of the ground motion")


@dataclass(frozen=True, slots=True)
class Compared:
    """One contribution, or one number that sums up the force, by Monte Carlo and to first order.

    Attributes
    ----------
    name
        What is compared.
    drawn, analytic
        Standard uncertainty by Monte Carlo and to first order [N]; for contributions the rms over the record.
    scatter
        Standard uncertainty of the ratio of both from the number of draws [1].
    interval
        Interval that holds 95 % of the draws [N]; empty for contributions.
    """

    name: str
    drawn: float
    analytic: float
    scatter: float
    interval: tuple[float, ...] = ()

    @property
    def ratio(self) -> float:
        """Monte Carlo over first order; 1 where both are zero."""
        if self.analytic > 0:
            return self.drawn / self.analytic
        return 1.0 if self.drawn == 0 else float("inf")

    @property
    def agrees(self) -> bool:
        """Whether the two agree within `SETTINGS.allowed`, Monte Carlo's own scatter apart."""
        return abs(self.ratio - 1) <= SETTINGS.allowed + SETTINGS.sure * self.scatter


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarlo:
    """What Monte Carlo says of an estimate.

    Attributes
    ----------
    draws, seed
        Number of draws, and the seed that they came from.
    deviation
        Standard uncertainty of every sample, shape (n,) [N].
    low, high
        Interval that holds 95 % of the draws of every sample, shape (n,) [N].
    contributions
        Rms over the record of each contribution; the last is all of them together.
    scalars
        Mean, rms about it, force at the instants of its largest and least value, and the extremes of the record.
    doubts
        What differs by more than it should.
    """

    draws: int
    seed: int
    deviation: Array
    low: Array
    high: Array
    contributions: tuple[Compared, ...]
    scalars: tuple[Compared, ...]
    doubts: tuple[str, ...] = field(default=())


def monte_carlo(force: Force, *, draws: int = 200, seed: int = 1) -> dict[str, MonteCarlo]:
    """Check of the uncertainty of a force [N], by component, by drawing everything that it depends on.

    Where the components are coupled, every draw decouples the record anew with the matrices drawn.

    Parameters
    ----------
    force
        The force, which holds what it was worked out from, and how.
    draws
        Number of draws, at least `SETTINGS.fewest_draws`.
    seed
        Seed of the draws; every component has draws of its own.

    Raises
    ------
    FitError
        The parameters are so uncertain that a draw of them is not physical.
    ValueError
        There are too few draws.
    """
    if draws < SETTINGS.fewest_draws:
        raise ValueError(f"draws must be at least {SETTINGS.fewest_draws}, not {draws}")
    settings = force.settings
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # said when the force was worked out
        record, filled = force.record, force.filled
        found = {}
        for name, estimate in force.items():
            component = record.component_record(name, filled, shared=estimate.shared)
            changed = partial(_changed, record, component, filled, draws)
            trial = _Trial(component, estimate, changed, draws, np.random.default_rng(seed))
            found[name] = trial.run(seed, method=settings.method, bandwidth=settings.bandwidth)
    return found


def _changed(
    record: ForceRecord, given: ComponentRecord, filled: Array, draws: int, generator: np.random.Generator
) -> Iterator[ComponentRecord]:
    """The record of a component with one draw of the dynamics after the other."""
    if isinstance(given, SingleRecord) and given.dynamics.covariance.any():
        return (given.with_dynamics(other) for other in drawn_dynamics(generator, given.dynamics, draws))
    if not isinstance(record, CoupledRecord) or not isinstance(given, DecoupledRecord):
        return repeat(given, draws)
    matrices = record.dynamics.covariance.any()
    mass = record.dynamics.mass is not None and record.dynamics.mass.covariance.any()
    if not (matrices or (mass and record.platform.specific_force.any())):
        return repeat(given, draws)
    drawn = drawn_coupled(generator, record.dynamics, given.rows, draws)
    component, shared = given.dynamics.component, given.shared
    return (record.taken_with(other).component_record(component, filled, shared=shared) for other in drawn)


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """An estimate, what it was worked out from, and where the draws come from."""

    record: ComponentRecord
    estimate: ComponentForce
    changed: Callable[[np.random.Generator], Iterator[ComponentRecord]]
    draws: int
    generator: np.random.Generator

    def run(self, seed: int, *, method: Method, bandwidth: float | None) -> MonteCarlo:
        """All draws, summed up."""
        learned = self.estimate.learned
        errors = self.by_inverse(method, bandwidth) if learned is None else self.by_smoother(learned)
        return _summed_up(self.estimate, errors, draws=self.draws, seed=seed)

    @property
    def parameters(self) -> str:
        """Name of what the dynamics contribute."""
        return next(part.name for part in self.estimate.contributions if part.source == "dynamics")

    def by_smoother(self, learned: SpectralPrior) -> Iterator[Mapping[str, Array]]:
        """Errors of the smoother's force by contribution, one draw after the other."""
        hum = tuple(line.frequency for line in self.estimate.hum)
        reading = self.record.reading(hum=hum)
        steps = self.estimate.steps
        nominal = LinearSmoother.of(reading, learned=learned, steps=steps)
        found = nominal.run(reading.filled[:, None])[:, 0]
        for record, others in zip(self.changed(self.generator), self.others(), strict=True):
            exact = record is self.record
            estimator, drawn = nominal, reading
            if not exact:
                drawn = record.reading(hum=hum)
                estimator = LinearSmoother.of(drawn, learned=learned, steps=steps)
            truth, simulated = estimator.simulate(self.generator)
            series = np.column_stack([drawn.filled, simulated, simulated])
            sizes = estimator.sizes(series)
            smooth = estimator.smooth(series - (estimator.columns @ sizes) * [1, 0, 1])
            moved = smooth[:, 0] + estimator.forms @ sizes[:, 0] - found
            yield {
                self.parameters: np.zeros_like(found) if exact else moved,
                " and ".join(NOISES): truth - smooth[:, 1],
                SIZES[0]: smooth[:, 1] - smooth[:, 2] - estimator.forms @ sizes[:, 1],
                SIZES[1]: _changed_sides(reading, steps, sizes[:, 1]),
                **others,
            }

    def by_inverse(self, method: Method, bandwidth: float | None) -> Iterator[Mapping[str, Array]]:
        """Errors of a direct inverse by contribution, one draw after the other: the readings get more noise."""
        noise, first = self.estimate.noise, self.estimate.values
        zero = np.zeros(first.size)

        def run(record: ComponentRecord, more: Array, shaking: Array) -> Array:
            load = record.recording.channel(record.dynamics.component)
            channel = replace(load, values=load.values + more, noise=noise)
            noisy = replace(record.recording, channels={**record.recording.channels, load.name: channel})
            again = replace(record, recording=noisy, motion_error=-shaking)
            return estimated(again, method=method, bandwidth=bandwidth, hum="mains").values

        for record, others in zip(self.changed(self.generator), self.others(), strict=True):
            normals = self.generator.normal(size=(2, first.size))
            quiet = run(record, zero, zero)
            yield {
                self.parameters: quiet - first,
                " and ".join(NOISES): run(record, noise * normals[0], record.input_noise * normals[1]) - quiet,
                **others,
            }

    def others(self) -> Iterator[Mapping[str, Array]]:
        """Errors that the force takes over as they are: a gain, a zero, an offset, and what is drawn as noise."""
        done = (self.parameters, *SIZES, *NOISES)
        parts = [part for part in self.estimate.contributions if part.name not in done]
        held = {part.name: part for part in parts if isinstance(part, Systematic)}
        numbers = {name: drawn_numbers(self.generator, part.covariance, self.draws) for name, part in held.items()}
        noises = [part for part in parts if isinstance(part, Noise)]
        for draw in range(self.draws):
            yield {
                **{name: part.slopes @ numbers[name][draw] for name, part in held.items()},
                **{part.name: part.draw(self.generator) for part in noises},
            }


def _changed_sides(reading: Observation, steps: tuple[Step, ...], sizes: Array) -> Array:
    """Error of a pure step on samples between its true instant and the one found, shape (n,) [N]."""
    error = np.zeros(reading.values.size)
    for step, shift in zip(steps, sizes[1 + len(steps) : 1 + 2 * len(steps)], strict=True):
        if step.duration <= 0:
            moved = replace(step, instant=step.instant + float(shift))
            error += step.height * (shape_of(moved, reading) - shape_of(step, reading))
    return error


def _summed_up(
    estimate: ComponentForce, errors: Iterator[Mapping[str, Array]], *, draws: int, seed: int
) -> MonteCarlo:
    """Standard uncertainties and intervals from the draws, beside those to first order."""
    whole = np.empty((draws, estimate.values.size))
    energies: dict[str, list[float]] = {}
    for draw, parts in enumerate(errors):
        whole[draw] = sum(parts.values())
        for name, error in parts.items():
            energies.setdefault(name, []).append(float(np.mean(error**2)))
    energies["all together"] = [float(np.mean(error**2)) for error in whole]
    squares = {part.name: float(np.mean(part.deviation**2)) for part in estimate.contributions}
    squares["all together"] = sum(squares.values())
    squares[" and ".join(NOISES)] = sum(squares.get(name, 0.0) for name in NOISES)
    rows = []
    for name, energy in energies.items():
        level = float(np.mean(energy))
        scatter = float(np.std(energy)) / (2 * level * np.sqrt(draws)) if level else 0.0
        rows.append(Compared(name, float(np.sqrt(level)), float(np.sqrt(squares.get(name, 0.0))), scatter))
    rows = [row for row in rows if row.drawn > 0 or row.analytic > 0]
    numbers = _scalars(estimate, whole)
    low, high = np.percentile(whole, SETTINGS.coverage, axis=0)
    return MonteCarlo(
        draws=draws,
        seed=seed,
        deviation=np.sqrt(np.mean(whole**2, axis=0)),
        low=estimate.values + low,
        high=estimate.values + high,
        contributions=tuple(rows),
        scalars=numbers,
        doubts=tuple(_doubts(rows, numbers)),
    )


def _scalars(estimate: ComponentForce, errors: Array) -> tuple[Compared, ...]:
    """Spread of the numbers that sum up the force."""
    first = {item.name: item for item in scalars(estimate)}
    force = estimate.values + errors
    # a direct inverse holds noise already, and the draws add as much again
    double = 0.0 if estimate.learned is not None else 2 * noise_power(estimate)
    values = estimate.values
    drawn = {
        "mean": force.mean(axis=1),
        "rms_about_mean": np.sqrt(np.maximum(force.var(axis=1) - double, 0.0)),
        "largest": force[:, np.argmax(values)],
        "least": force[:, np.argmin(values)],
        "largest_in_record": force.max(axis=1),
        "least_in_record": force.min(axis=1),
    }
    rows = []
    for name, sample in drawn.items():
        low, high = (float(end) for end in np.percentile(sample, SETTINGS.coverage))
        analytic = first[name].u if name in first else float("nan")
        scatter = 1 / np.sqrt(2 * (sample.size - 1))
        rows.append(Compared(name, float(sample.std(ddof=1)), analytic, float(scatter), (low, high)))
    return tuple(rows)


def _doubts(rows: list[Compared], numbers: tuple[Compared, ...]) -> Iterator[str]:
    """Return what differs by more than it should."""
    whole = rows[-1].analytic
    for row in (*rows, *numbers):
        slight = max(row.drawn, row.analytic) < SETTINGS.slight * whole and row in rows
        if np.isfinite(row.analytic) and not row.agrees and not slight:
            what = f"the uncertainty of {row.name}" if row in numbers else f"{row.name}"
            yield (
                f"{what}: Monte Carlo gives {row.drawn:.3g} where the first order gives {row.analytic:.3g} "
                f"({row.ratio:.3g} times, of which {SETTINGS.sure:g} x {row.scatter:.2g} may be the number of draws); "
                "the uncertainty is not linear there, so take the larger one"
            )
