"""Monte Carlo check of an uncertainty [JCGM101]_: the estimator run again with everything drawn that is not exact.

One draw takes the dynamics from their covariance and adds the change of the force that the estimator finds with them,
prior and steps as found (`parameter_errors`). It draws a force and readings from the estimator's own model and adds
the error that it makes on them [Durbin2002]_, and adds the errors of the ground's motion and of the balance matrix.
Numbers that hold along the record are drawn in sets that have exactly the mean and covariance they stand for, so few
draws suffice.

References
----------
.. [JCGM101] JCGM 101:2008, "Evaluation of measurement data - Supplement 1 - Propagation of distributions using a Monte
   Carlo method".
.. [Durbin2002] J. Durbin, S. J. Koopman, "A simple and efficient simulation smoother for state space time series
   analysis", Biometrika 89 (2002) 603.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import repeat
from typing import Final

import numpy as np

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.component_force import Method, estimated
from aerobalance.estimation.error_sources import Noise, Systematic
from aerobalance.estimation.force_smoother import (
    HIDDEN,
    SIZES_OF_STEPS,
    SIZES_OF_TONES,
    LinearSmoother,
    name_of_sizes,
)
from aerobalance.estimation.noise_draws import NoiseDraws
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.record import BalanceRecord, ComponentRecord
from aerobalance.estimation.result import ComponentForce, budget_of
from aerobalance.estimation.steps import Step, shape_of
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import kept_warnings, warn_quality
from aerobalance.recording.progress import PROGRESS
from aerobalance.uncertainty.budget import noise_power, scalars
from aerobalance.uncertainty.parameter_draws import ChangedRecord, parameter_errors
from aerobalance.uncertainty.sampling import UncertainDynamics, drawn_numbers


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


SCALARS: Final = ("mean", "rms_about_mean", "largest", "least", "largest_in_record", "least_in_record")
"""Numbers that sum up a force."""

PART: Final = 4096
"""Samples whose draws are sorted at a time."""

TOGETHER: Final = 2
"""Draws of noise that go through the smoother together."""

SIZES: Final = (SIZES_OF_STEPS, SIZES_OF_TONES, "which side of a step a sample is on")
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

    def __repr__(self) -> str:
        known = [one for one in self.scalars if np.isfinite(one.analytic)]
        rows = [f"{one.name}: u = {one.drawn:.3g} drawn, {one.analytic:.3g} to first order" for one in known]
        return "\n  ".join([f"{self.draws} draws, seed {self.seed}", *rows, *self.doubts])


@one_blas_thread()
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
    if force.worst is not None:
        part, said = force.worst()
        warn_quality(said)
        return monte_carlo(part, draws=draws, seed=seed)
    settings = force.settings
    with kept_warnings():  # said when the force was worked out
        record, filled = force.record, force.filled
        found = {}
        for name, estimate in PROGRESS.each(force.items(), "Monte Carlo of component"):
            component = record.component_record(name, filled, shared=estimate.shared)
            change = _change(record, component, filled)
            generator = np.random.Generator(np.random.SFC64(seed))  # the fastest for normal numbers
            trial = _Trial(component, estimate, change, draws, generator)
            found[name] = trial.run(seed, method=settings.method, bandwidth=settings.bandwidth)
    return found


def _change(record: BalanceRecord, given: ComponentRecord, filled: Array) -> ChangedRecord | None:
    """What makes the record of a component out of drawn dynamics; None where they are exact."""
    component, shared = given.dynamics.component, given.shared
    if not record.is_uncertain(component):
        return None

    def changed(other: BalanceDynamics) -> ComponentRecord:
        return record.taken_with(other).component_record(component, filled, shared=shared)

    return ChangedRecord(UncertainDynamics.of(record.dynamics.block_of(component), given.rows), changed)


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """An estimate, what it was worked out from, and where the draws come from."""

    record: ComponentRecord
    estimate: ComponentForce
    change: ChangedRecord | None
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
        tones, steps = tuple(line.frequency for line in self.estimate.tones), self.estimate.steps
        drift = self.estimate.tones[0].drift if tones else ()
        reading = self.record.reading(hum=hum, tones=tones, drift=drift)
        nominal = LinearSmoother.of(reading, learned=learned, steps=steps)
        found = nominal.run(reading.filled[:, None])[:, 0]

        def moved(record: ComponentRecord) -> Array:
            drawn = record.reading(hum=hum, tones=tones, drift=drift)
            estimator = LinearSmoother.of(drawn, learned=learned, steps=steps)
            return np.asarray(estimator.run(drawn.filled[:, None])[:, 0] - found)

        shifts = parameter_errors(self.change, moved, draws=self.draws, generator=self.generator)
        noises = self.noises(nominal)
        edges = any(step.duration <= 0 for step in steps)
        for shift, (noise, sizes), others in zip(shifts, noises, self.others(), strict=True):
            yield {
                **({} if shift is None else {self.parameters: shift}),
                " and ".join(NOISES): noise,
                name_of_sizes(reading, steps): nominal.size_errors @ sizes,
                **({SIZES[-1]: _changed_sides(reading, steps, sizes)} if edges else {}),
                **others,
            }

    def noises(self, estimator: LinearSmoother) -> Iterator[tuple[Array, Array]]:
        """Errors of a smoother on readings drawn from its model, shape (n,) [N], and sizes of its shapes, (p,)."""
        noise = NoiseDraws.of(estimator)
        for first in range(0, self.draws, TOGETHER):
            errors, sizes = noise.draw(self.generator, min(TOGETHER, self.draws - first))
            yield from zip(errors, sizes.T, strict=True)

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

        change = self.change
        drawn = repeat(self.record, self.draws) if change is None else change.records(self.generator, self.draws)
        for record, others in zip(drawn, self.others(), strict=True):
            normals = self.generator.normal(size=(2, first.size))
            quiet = run(record, zero, zero)
            yield {
                self.parameters: quiet - first,
                " and ".join(NOISES): run(record, noise * normals[0], record.input_noise * normals[1]) - quiet,
                **others,
            }

    def others(self) -> Iterator[Mapping[str, Array]]:
        """Errors that the force takes over as they are: a gain, a zero, an offset, and what is drawn as noise."""
        done = (self.parameters, *SIZES, *NOISES, HIDDEN)
        parts = [part for part in self.estimate.contributions if part.name not in done]
        held = [part for part in parts if isinstance(part, Systematic)]
        numbers = [drawn_numbers(self.generator, part.covariance, self.draws) for part in held]
        noises = [part for part in parts if isinstance(part, Noise)]
        for draw in range(self.draws):
            errors = [(part.name, part.slopes @ own[draw]) for part, own in zip(held, numbers, strict=True)]
            errors += [(part.name, part.draw(self.generator)) for part in noises]
            found: dict[str, Array] = {}
            for name, error in errors:  # two sensors of one kind have one name
                found[name] = found[name] + error if name in found else error
            yield found


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
    for draw, parts in zip(PROGRESS.each(range(draws), "draw"), errors, strict=True):
        whole[draw] = 0.0
        for name, error in parts.items():
            whole[draw] += error
            energies.setdefault(name, []).append(_mean_square(error))
    energies["all together"] = [_mean_square(error) for error in whole]
    squares = {name: own**2 for name, own in budget_of(estimate.contributions).items()}
    squares["all together"] = sum(squares.values())
    squares[" and ".join(NOISES)] = sum(squares.pop(name, 0.0) for name in (*NOISES, HIDDEN))
    rows = []
    for name, energy in energies.items():
        level = float(np.mean(energy))
        scatter = float(np.std(energy)) / (2 * level * np.sqrt(draws)) if level else 0.0
        rows.append(Compared(name, float(np.sqrt(level)), float(np.sqrt(squares.get(name, 0.0))), scatter))
    rows = [row for row in rows if row.drawn > 0 or row.analytic > 0]
    numbers = _scalars(estimate, whole)
    low, high = _percentiles(whole, SETTINGS.coverage)
    return MonteCarlo(
        draws=draws,
        seed=seed,
        deviation=np.sqrt(np.einsum("dn,dn->n", whole, whole) / draws),
        low=estimate.values + low,
        high=estimate.values + high,
        contributions=tuple(rows),
        scalars=numbers,
        doubts=tuple(_doubts(rows, numbers)),
    )


def _mean_square(error: Array) -> float:
    """Mean square of an error [N^2]."""
    return float(error @ error) / error.size


def _percentiles(errors: Array, percents: tuple[float, ...]) -> list[Array]:
    """Percentiles of every sample over draws of shape (draws, n), shape (n,) each: as `numpy.percentile`, but faster.

    Sorting what lies together takes a third of the time of a search along it.
    """
    draws, count = errors.shape
    places = [percent / 100 * (draws - 1) for percent in percents]
    found = np.empty((len(places), count))
    for first in range(0, count, PART):
        part = slice(first, min(first + PART, count))
        ranked = np.sort(np.ascontiguousarray(errors[:, part].T), axis=1)
        for row, place in zip(found, places, strict=True):
            below = min(int(place), draws - 2)
            row[part] = ranked[:, below] + (place - below) * (ranked[:, below + 1] - ranked[:, below])
    return list(found)


def _scalars(estimate: ComponentForce, errors: Array) -> tuple[Compared, ...]:
    """Spread of the numbers that sum up the force."""
    first = {item.name: item for item in scalars(estimate)}
    # a direct inverse holds noise already, and the draws add as much again
    double = 0.0 if estimate.learned is not None else 2 * noise_power(estimate)
    values = estimate.values
    most, least = int(np.argmax(values)), int(np.argmin(values))
    drawn: dict[str, Array] = {name: np.empty(len(errors)) for name in SCALARS}
    for draw, error in enumerate(errors):
        force = values + error
        mean = float(force.mean())
        numbers = (
            mean,
            np.sqrt(max(_mean_square(force - mean) - double, 0.0)),
            force[most],
            force[least],
            force.max(),
            force.min(),
        )
        for name, number in zip(SCALARS, numbers, strict=True):
            drawn[name][draw] = number
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
