"""What the record itself says of the force before it is known: the prior's spectrum and the noise of the reading.

Maximum likelihood of the innovations. The start comes from the periodogram (Whittle's likelihood), which is quick but
blind to the ends of the record; the choice among orders is made by the likelihood of the innovations alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from aerobalance.dynamics import Dynamics
from aerobalance.problems import FitError
from aerobalance.recording import Array
from aerobalance.smoother import Filter, ForcePrior, StateSpace

ORDERS: Final = (1, 2, 4, 8, 16)
"""Orders of the force's prior that are tried."""

LEARNING_SAMPLES: Final = 1 << 15
"""Samples that the likelihood of the innovations is summed over at most, in blocks spread over the record."""

BLOCKS: Final = 8
"""Number of those blocks where a record is longer."""

NULL_EVIDENCE: Final = 6.0
"""Gain in log-likelihood that a fluctuating force must bring over none at all: two parameters, searched widely."""

MOST_ADDED: Final = 2
"""Blocks that may be added because the others do not explain them."""

UNEXPLAINED: Final = 1.5
"""Mean square of whitened innovations over a block above which the block is not explained; its scatter is 0.02."""

HANN_BANDWIDTH: Final = 1.94
"""Ordinates of a Hann periodogram that are as good as one independent ordinate."""


@dataclass(frozen=True, slots=True)
class Learned:
    """A prior and the noise that go with a record.

    Attributes
    ----------
    prior
        Spectrum of the force.
    noise
        Standard uncertainty of a reading [N].
    log_likelihood
        Logarithm of the likelihood of the innovations, up to a constant of the record [1].
    """

    prior: ForcePrior
    noise: float
    log_likelihood: float


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """One component's record as the estimator takes it.

    Attributes
    ----------
    values
        Load felt less the response to known inputs, shape (n,) [N]; NaN where missing.
    interval
        Time between samples [s].
    dynamics
        The balance.
    input_density
        Density of the white force noise that comes with the known inputs [N^2/Hz].
    noise
        Standard uncertainty of a reading [N]; None when it is to be learned.
    also
        First samples of further blocks that a long record is learned from, because something happens in them.
    """

    values: Array
    interval: float
    dynamics: Dynamics
    input_density: float = 0.0
    noise: float | None = None
    also: tuple[int, ...] = ()

    @property
    def present(self) -> NDArray[np.bool_]:
        """True where there is a reading, shape (n,)."""
        return np.isfinite(self.values)

    @property
    def filled(self) -> Array:
        """The readings with zero where one is missing, shape (n,) [N]."""
        return np.where(self.present, self.values, 0.0)

    @property
    def swing(self) -> float:
        """Largest departure from the mean [N]: no free oscillation under way at the start is larger."""
        return float(np.nanmax(np.abs(self.values - np.nanmean(self.values)))) + self.least_noise

    @property
    def least_noise(self) -> float:
        """Noise below which double precision cannot tell a reading from its prediction [N]."""
        return 1e-7 * float(np.nanmax(np.abs(self.values))) + 1e-100

    def system(self, prior: ForcePrior, noise: float) -> StateSpace:
        """The state space of this reading under a prior."""
        return StateSpace.of_balance(
            self.dynamics,
            prior,
            interval=self.interval,
            noise=noise,
            input_density=self.input_density,
            swing=self.swing,
        )


def learn(reading: Reading, *, columns: Array) -> Learned:
    """Find the prior and the noise that make the readings most likely.

    A long record is learned from blocks; a part of it that the answer does not explain is added to them, so that
    nothing that happens between the blocks goes unseen.

    Parameters
    ----------
    reading
        The record.
    columns
        Known shapes whose sizes are free, shape (n, p): the constant, and the response to every step found so far.
    """
    learned = _learn(reading, columns=columns)
    for _ in range(MOST_ADDED):
        place = _unexplained(reading, learned, columns=columns)
        if place is None:
            break
        reading = replace(reading, also=(*reading.also, place))
        learned = _learn(reading, columns=columns)
    return learned


def guess(reading: Reading, *, columns: Array) -> Learned:
    """A quick answer from the periodogram alone."""
    none, *starts = _whittle(reading, columns=columns)
    best = max(starts, key=lambda candidate: candidate.log_likelihood)
    return best if best.log_likelihood >= none.log_likelihood + NULL_EVIDENCE else none


def _unexplained(reading: Reading, learned: Learned, *, columns: Array) -> int | None:
    """First sample of the block of a long record whose innovations are the most too large; None if none are."""
    samples = reading.values.size
    if samples <= LEARNING_SAMPLES:
        return None
    white = whitened_residual(reading, learned, columns=columns)
    length = LEARNING_SAMPLES // BLOCKS
    edges = np.arange(0, samples - length // 2, length // 2)
    excess = np.array([float(np.mean(white[k : k + length] ** 2)) for k in edges])
    place = int(min(edges[np.argmax(excess)], samples - length))
    return None if excess.max() < UNEXPLAINED or place in reading.also else place


def whitened_residual(reading: Reading, learned: Learned, *, columns: Array) -> Array:
    """Innovations of a whole record over their standard deviation, the sizes of the columns at their best, (n,)."""
    filter_ = Filter.of(reading.system(learned.prior, learned.noise), reading.present)
    sizes, *_ = generalised_least_squares(filter_, reading.filled, columns)
    return filter_.whiten((reading.filled - columns @ sizes)[:, None])[:, 0]


def _learn(reading: Reading, *, columns: Array) -> Learned:
    """The answer from the blocks at hand."""
    none, *starts = _whittle(reading, columns=columns)
    place = int(np.argmax([candidate.log_likelihood for candidate in starts]))
    if starts[place].log_likelihood < none.log_likelihood + NULL_EVIDENCE:
        return _refine(reading, columns=columns, start=none)
    refined = {place: _refine(reading, columns=columns, start=starts[place])}
    best = place
    while True:  # climb from the order that the periodogram prefers to its better neighbours
        for near in (best - 1, best + 1):
            if 0 <= near < len(starts) and near not in refined:
                refined[near] = _refine(reading, columns=columns, start=starts[near])
        following = max(refined, key=lambda key: refined[key].log_likelihood)
        if following == best:
            return refined[best]
        best = following


def generalised_least_squares(filter_: Filter, readings: Array, columns: Array) -> tuple[Array, Array, float]:
    """Sizes of known shapes in a record: values (p,), covariance (p, p) and the sum of squares left over [1]."""
    series = filter_.whiten(np.column_stack([readings, columns]))
    white, shapes = series[:, 0], series[:, 1:]
    scale = np.sqrt(np.sum(shapes**2, axis=0))
    scale[scale == 0] = 1.0  # a shape that no reading shows: its size stays zero
    if not np.isfinite(series).all():
        raise FitError("the readings cannot be told from their model: they do not change, or their scale is absurd")
    solution, _, rank, singular = np.linalg.lstsq(shapes / scale, white, rcond=1e-10)
    _, _, rows = np.linalg.svd(shapes / scale, full_matrices=False)
    kept = slice(0, int(rank))
    spread = rows[kept].T / singular[kept]
    covariance = spread @ spread.T / np.outer(scale, scale)
    residual = white - shapes @ (solution / scale)
    return solution / scale, covariance, float(residual @ residual)


def log_likelihood(reading: Reading, prior: ForcePrior, noise: float, *, columns: Array, whole: bool = False) -> float:
    """Logarithm of the likelihood of the innovations, the sizes of the columns at their best.

    It is summed over the blocks that are learned from, or over the whole record.
    """
    total = 0.0
    system = reading.system(prior, noise)
    filter_: Filter | None = None
    for block in [slice(0, reading.values.size)] if whole else learning_blocks(reading):
        present = reading.present[block]
        if filter_ is None or not np.array_equal(filter_.present, present):
            filter_ = Filter.of(system, present)
        used = columns[block]
        used = used[:, np.ptp(used, axis=0) + np.abs(used[0]) > 0]
        *_, squares = generalised_least_squares(filter_, reading.filled[block], used)
        total -= 0.5 * (filter_.log_determinant + squares)
    return total


def learning_blocks(reading: Reading) -> list[slice]:
    """The parts of a record that are learned from: all of it, or blocks spread evenly and those added to them."""
    samples = reading.values.size
    if samples <= LEARNING_SAMPLES:
        return [slice(0, samples)]
    length = LEARNING_SAMPLES // BLOCKS
    first = [*np.linspace(0, samples - length, BLOCKS).astype(int).tolist(), *reading.also]
    return [slice(k, k + length) for k in sorted(set(first))]


def _refine(reading: Reading, *, columns: Array, start: Learned) -> Learned:
    """Maximise the likelihood of the innovations from a start, over density, cutoff and (if not given) noise."""
    lowest_cutoff, highest_cutoff = _cutoff_limits(reading, start.prior.order)
    fixed = reading.noise is not None

    def unpack(point: Array) -> tuple[ForcePrior, float]:
        density, cutoff = np.exp(np.clip(point[:2], -600, 600))
        noise = start.noise if fixed else max(float(np.exp(point[2])), reading.least_noise)
        cutoff = float(np.clip(cutoff, lowest_cutoff, highest_cutoff))
        return ForcePrior(order=start.prior.order, cutoff=cutoff, density=float(density)), noise

    def cost(point: Array) -> float:
        return -log_likelihood(reading, *unpack(point), columns=columns)

    origin = np.log([max(start.prior.density, 1e-250), start.prior.cutoff, start.noise])[: 2 if fixed else 3]
    if start.prior.density == 0:
        return _refine_noise(reading, columns=columns, start=start)
    simplex = np.vstack([origin, origin + np.diag([0.2, 0.1, 0.05][: origin.size])])
    options = {"initial_simplex": simplex, "xatol": 5e-3, "fatol": 0.02, "maxiter": 120}
    found = minimize(cost, origin, method="Nelder-Mead", options=options)  # type: ignore[call-overload]
    prior, noise = unpack(found.x)
    return Learned(prior, noise, -float(found.fun))


def _refine_noise(reading: Reading, *, columns: Array, start: Learned) -> Learned:
    """The likelihood of the innovations where the force does not fluctuate: only the noise is free."""

    def cost(logarithm: float) -> float:
        return -log_likelihood(reading, start.prior, float(np.exp(logarithm)), columns=columns)

    if reading.noise is not None:
        return Learned(start.prior, start.noise, -cost(float(np.log(start.noise))))
    middle = float(np.log(start.noise))
    found = minimize_scalar(cost, bounds=(middle - 0.5, middle + 0.5), options={"xatol": 1e-3})
    return Learned(start.prior, float(np.exp(found.x)), -float(found.fun))


def _cutoff_limits(reading: Reading, order: int) -> tuple[float, float]:
    """Lowest and highest cutoff that a record can speak of [Hz]: a sharp edge takes time to be seen."""
    duration = reading.interval * reading.values.size
    highest = 0.45 / reading.interval
    return min((0.1 if order == 1 else order) / duration, highest), highest


def _whittle(reading: Reading, *, columns: Array) -> list[Learned]:
    """No fluctuating force, then for each order the most likely prior, by the periodogram."""
    frequency, ordinates, weight = _periodogram(reading, columns)
    transfer = np.abs(reading.dynamics.response(frequency)) ** 2
    logarithm = np.log(frequency)
    interval = reading.interval
    upper = ordinates[int(0.8 * ordinates.size) :]
    floor = max(float(np.median(upper)) / np.log(2) / interval, reading.least_noise**2)
    fixed = None if reading.noise is None else max(reading.noise, reading.least_noise) ** 2

    def cost(point: Array, order: int) -> float:
        density, _, variance = np.exp(np.clip(point, -600, 600))
        prior = density / (1 + np.exp(np.minimum(2 * order * (logarithm - point[1]), 460.0)))
        model = transfer * (prior + reading.input_density) + (fixed or variance) * interval
        return float(weight @ (np.log(model) + ordinates / model))

    bracket = (float(np.log(floor)), float(np.log(1.1 * floor)))
    level = minimize_scalar(lambda log: cost(np.array([-600.0, 0.0, log]), 1), bracket=bracket)
    noise = float(np.sqrt(np.exp(level.x) if fixed is None else fixed))
    nothing = ForcePrior(order=1, cutoff=0.25 / interval, density=0.0)
    starts = [Learned(nothing, max(noise, reading.least_noise), -float(level.fun))]
    for order in ORDERS:
        lowest, highest = _cutoff_limits(reading, order)
        grid = []
        for cutoff in np.geomspace(lowest, highest, 16):
            inside = frequency <= max(cutoff, frequency[2])
            density = float(np.median(ordinates[inside] / transfer[inside])) / np.log(2)
            point = np.log([max(density, 1e-250), cutoff, floor])
            grid.append((cost(point, order), point))
        origin = min(grid, key=lambda item: item[0])[1]
        found = minimize(cost, origin, args=(order,), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-2})
        density, cutoff, variance = np.exp(np.clip(found.x, -600, 600))
        prior = ForcePrior(order=order, cutoff=float(np.clip(cutoff, lowest, highest)), density=float(density))
        noise = float(np.sqrt(variance if fixed is None else fixed))
        starts.append(Learned(prior, max(noise, reading.least_noise), -float(found.fun)))
    return starts


def _periodogram(reading: Reading, columns: Array) -> tuple[Array, Array, Array]:
    """Hann periodogram of a record without its columns: frequency, two-sided density, weight of each ordinate.

    A long record is averaged over segments, which makes each ordinate worth more instead of making more of them.
    """
    present = reading.present
    sizes, *_ = np.linalg.lstsq(columns[present], reading.values[present], rcond=None)
    values = np.where(present, reading.values - columns @ sizes, 0.0)
    length = min(values.size, LEARNING_SAMPLES // 2)
    segments = [values[k : k + length] for k in range(0, values.size - length + 1, length // 2)]
    window = np.hanning(length + 2)[1:-1]
    density = np.zeros(length // 2 + 1)
    for segment in segments:
        density += np.abs(np.fft.rfft(segment * window)) ** 2
    density *= reading.interval / (np.sum(window**2) * len(segments))
    frequency = np.arange(length // 2 + 1) / (length * reading.interval)
    weight: Array = np.full(frequency.size, values.size / length / HANN_BANDWIDTH)
    return frequency[2:-1], density[2:-1], weight[2:-1]
