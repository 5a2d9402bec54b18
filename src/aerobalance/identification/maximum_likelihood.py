"""Maximum likelihood for one mode on a shaken base, with noise in both channels, in the frequency domain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.identification.spectra import Complex, Spectra
from aerobalance.problems import FitError
from aerobalance.recording import Array

PHYSICAL: Final = 4
"""Physical parameters: log mass, log angular frequency, loss b w0 / k = 2 zeta, and delay in units of 1 / w0."""

HIGHEST: Final = 50
"""Largest natural frequency that is tried, over the highest frequency used."""

LARGEST_LOSS: Final = 4.0
"""Largest loss b w0 / k that is tried: twice critical damping."""

TRANSIENTS: Final = 4
"""Terms for motion that is going on at the ends of the record: drift, position, velocity, and one for sampling."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The spectra to fit and what is known beforehand.

    Attributes
    ----------
    spectra
        Spectra at the frequencies to use.
    mass
        Moving mass [kg; kg*m], or None.
    delay
        Delay of the load [s], or None.
    """

    spectra: Spectra
    mass: float | None
    delay: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The most likely parameters.

    Attributes
    ----------
    mass, angular_frequency, loss, delay
        M [kg; kg*m], w0 [rad/s], b w0 / k [1] and tau [s].
    covariance
        Covariance of log M, log w0, loss and tau, shape (4, 4).
    sensitivity_to_mass
        Change of log w0, loss and tau per unit of log M when the mass is given, shape (3,).
    residual
        Y - H U - T, shape (m,).
    load
        Most likely noise-free load (its transients included), shape (m,).
    floor
        Expected power of the residual from the noise floors, shape (m,).
    chi2, degrees_of_freedom
        Against the noise floors.
    coloured
        Whether the residual spectrum set the weights.
    correlation
        Correlation of residual and ground motion that the noise assumed does not explain, summed over the blocks;
        about 1 each where the model describes the response.
    blocks
        Number of blocks.
    """

    mass: float
    angular_frequency: float
    loss: float
    delay: float
    covariance: Array
    sensitivity_to_mass: Array
    residual: Complex
    load: Complex
    floor: Array
    chi2: float
    degrees_of_freedom: int
    coloured: bool
    correlation: float
    blocks: int

    @property
    def adequate(self) -> bool:
        """Whether the response of one mode leaves nothing that follows the ground motion, beyond chance (5 sigma)."""
        return bool(self.correlation < self.blocks + 5 * np.sqrt(self.blocks))


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """The likelihood at one set of parameters."""

    cost: float
    residual: Complex
    variance: Array
    ground: Complex
    load: Complex
    jacobian: Complex


@dataclass(frozen=True, slots=True, eq=False)
class _Weights:
    """Noise power of both channels and the weight of every frequency."""

    load: Array
    ground: Array
    weight: Array


def maximise(problem: Problem, *, name: str) -> Estimate:
    """Find the most likely parameters, with weights that follow the residual spectrum where the noise is coloured.

    Raises
    ------
    FitError
        No minimum is found, or there are fewer frequencies than parameters.
    """
    spectra = problem.spectra
    if 2 * spectra.frequency.size < 4 * (PHYSICAL + TRANSIENTS):
        raise FitError(f"{name}: {spectra.frequency.size} frequencies with a response are too few; record for longer")
    estimate = _fit(problem, name=name)
    if problem.spectra.ground_noise_given or estimate.correlation < estimate.blocks + 2 * estimate.blocks**0.5:
        return estimate
    # The quietest part of the spectrum need not tell the noise where the ground moves (a differentiated speed, say).
    quiet = replace(problem.spectra, ground_noise=1e-6 * problem.spectra.ground_noise)
    other = _fit(replace(problem, spectra=quiet), name=name)
    return other if other.correlation < estimate.correlation - 10 else estimate


def _fit(problem: Problem, *, name: str) -> Estimate:
    """Find the most likely parameters for the noise of the ground acceleration as given."""
    reference, parameters, rough = _start(problem)
    weights = _Weights(rough, problem.spectra.ground_noise, np.ones(rough.size))
    parameters = _descend(problem, parameters, weights=weights, reference=reference, name=name)
    coloured = False
    for _ in range(3):
        weights, coloured = _weights(problem, parameters, reference=reference)
        parameters = _descend(problem, parameters, weights=weights, reference=reference, name=name)
    return _estimate(problem, parameters, weights=weights, reference=reference, coloured=coloured, name=name)


def _free(problem: Problem) -> NDArray[np.intp]:
    """Numbers of the parameters that are to be found."""
    fixed = {0} if problem.mass is not None else set()
    fixed |= {3} if problem.delay is not None else set()
    return np.array([i for i in range(PHYSICAL + TRANSIENTS) if i not in fixed], dtype=np.intp)


def _response(parameters: Array, w: Array, reference: float) -> tuple[Complex, Complex, Complex, Complex]:
    """Response H, denominator D, its derivative by log w0, and the transient basis, shape (m, TRANSIENTS)."""
    r = w / np.exp(parameters[1])
    denominator = 1 - r**2 + 1j * r * parameters[2]
    slope = 2 * r**2 - 1j * r * parameters[2]
    turn = np.exp(-1j * w * parameters[3] / reference)
    response = -np.exp(parameters[0]) * turn / denominator
    s = 1j * w / reference
    basis = np.column_stack([1 / s, turn / denominator, s * turn / denominator, s**2 * turn / denominator])
    return response, denominator, slope, basis


def _point(problem: Problem, parameters: Array, *, weights: _Weights, reference: float) -> _Point:
    """Evaluate likelihood and Jacobian.

    The Jacobian holds the most likely ground motion in place of the measured one: with it J^H r is the exact slope
    of the likelihood, in which the ground motion at every frequency has been eliminated.
    """
    spectra = problem.spectra
    w = 2 * np.pi * spectra.frequency
    response, denominator, slope, basis = _response(parameters, w, reference)
    transient = basis @ parameters[PHYSICAL:]
    residual = spectra.load - response * spectra.ground - transient
    variance = weights.load + np.abs(response) ** 2 * weights.ground
    ground = spectra.ground + weights.ground * np.conj(response) * residual / variance
    driven = response * ground
    resonant = driven + transient - basis[:, 0] * parameters[PHYSICAL]
    jacobian = np.empty((w.size, PHYSICAL + TRANSIENTS), dtype=np.complex128)
    jacobian[:, 0] = driven
    jacobian[:, 1] = -resonant * slope / denominator
    jacobian[:, 2] = -resonant * 1j * w / np.exp(parameters[1]) / denominator
    jacobian[:, 3] = -1j * w / reference * resonant
    jacobian[:, PHYSICAL:] = basis
    jacobian *= np.sqrt(weights.weight / variance)[:, None]
    cost = float(np.sum(weights.weight * np.abs(residual) ** 2 / variance))
    return _Point(cost, residual, variance, ground, driven + transient, jacobian)


def _descend(problem: Problem, parameters: Array, *, weights: _Weights, reference: float, name: str) -> Array:
    """Minimise by damped Gauss-Newton steps."""
    caution = 1e-3
    highest = float(np.log(2 * np.pi * HIGHEST * problem.spectra.frequency[-1]))
    point = _point(problem, parameters, weights=weights, reference=reference)
    costs = []
    for _ in range(200):
        costs.append(point.cost)
        slope = np.real(point.jacobian.conj().T @ (point.residual * np.sqrt(weights.weight / point.variance)))
        free = _free(problem)
        if parameters[2] == 0 and slope[2] < 0:
            free = free[free != 2]  # the damping rests on zero, and less would fit better
        if parameters[2] == LARGEST_LOSS and slope[2] > 0:
            free = free[free != 2]
        if parameters[1] == highest and slope[1] > 0:
            free = free[free != 1]  # so far above the band that the natural frequency no longer matters
        jacobian, score = point.jacobian[:, free], slope[free]
        curvature = np.real(jacobian.conj().T @ jacobian)
        scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
        scaled = curvature / np.outer(scale, scale)
        step = np.linalg.lstsq(scaled + caution * np.eye(free.size), score / scale, rcond=1e-14)[0]
        trial = parameters.copy()
        trial[free] += step / scale
        trial[1] = min(np.clip(trial[1], parameters[1] - 0.5, parameters[1] + 0.5), highest)
        trial[2] = np.clip(trial[2], 0.0, LARGEST_LOSS)
        candidate = _point(problem, trial, weights=weights, reference=reference)
        gain = point.cost - candidate.cost
        if gain >= 0:
            parameters, point, caution = trial, candidate, max(caution / 10, 1e-12)
            if np.max(np.abs(step)) < 1e-3:  # in standard deviations
                return parameters
        elif np.max(np.abs(step)) < 1e-3 or caution > 1e12:
            return parameters
        else:
            caution *= 10
    if costs[100] - point.cost < 1:  # a valley as flat as this is for the covariance to tell
        return parameters
    if np.exp(parameters[1]) > 3 * np.pi * problem.spectra.frequency[-1]:
        raise FitError(
            f"{name}: the record does not carry the stiffness (the fit runs away above the "
            f"{problem.spectra.frequency[-1]:.4g} Hz that are excited); excite nearer to the natural frequency"
        )
    raise FitError(f"{name}: the fit of the response does not settle; restrict the band to where one mode answers")


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Powers and cross power summed over eight neighbouring frequencies each, for the search of a start."""

    frequency: Array
    load: Array
    ground: Array
    cross: Complex
    load_noise: Array
    ground_noise: Array
    signal: Array

    @classmethod
    def of(cls, spectra: Spectra, load_noise: Array) -> _Sums:
        group = np.arange(spectra.frequency.size) // 8
        size = np.bincount(group).astype(np.float64)

        def total(values: Array) -> Array:
            return np.asarray(np.bincount(group, weights=values), dtype=np.float64)

        cross = np.conj(spectra.ground) * spectra.load
        ground = total(np.abs(spectra.ground) ** 2)
        noise = total(spectra.ground_noise)
        return cls(
            frequency=total(spectra.frequency) / size,
            load=total(np.abs(spectra.load) ** 2),
            ground=ground,
            cross=total(cross.real) + 1j * total(cross.imag),
            load_noise=total(load_noise) / size,
            ground_noise=noise / size,
            signal=np.maximum(ground - noise, 1e-3 * ground),
        )

    def try_shape(self, shape: Complex, mass: float | None) -> tuple[float, float]:
        """Cost of the response mass * shape, and the mass, which is fitted where it is not given."""
        if mass is None:
            power = float(np.sum(np.abs(shape) ** 2 * self.signal / self.load_noise))
            mass = max(float(np.sum(np.real(np.conj(shape) * self.cross) / self.load_noise)) / power, 1e-12)
        h = mass * shape
        square = np.abs(h) ** 2
        cost = self.load - 2 * np.real(np.conj(h) * self.cross) + square * self.ground
        return float(np.sum(cost / (self.load_noise + square * self.ground_noise))), mass


def _start(problem: Problem) -> tuple[float, Array, Array]:
    """Search a grid of natural frequency and damping.

    Returns the frequency scale, the parameters, and a rough noise power of the load from the incoherent part.
    """
    spectra = problem.spectra
    incoherent = (1 - spectra.coherence) * spectra.block_sum(np.abs(spectra.load) ** 2)
    incoherent /= spectra.block_sum(np.ones(spectra.frequency.size))
    rough = np.maximum(spectra.load_noise, incoherent[spectra.block])
    sums = _Sums.of(spectra, rough)
    f = sums.frequency
    delay = problem.delay or 0.0
    turn = np.exp(-2j * np.pi * f * delay)
    best = (np.inf, 1.0, 1.0, 0.0)
    for f0 in np.geomspace(max(0.5 * f[0], 0.02 * f[-1]), 4 * f[-1], 240):
        for loss in (0.005, 0.02, 0.06, 0.15, 0.4, 1.0):
            r = f / f0
            cost, mass = sums.try_shape(-turn / (1 - r**2 + 1j * r * loss), problem.mass)
            if cost < best[0]:
                best = (cost, mass, float(f0), loss)
    reference = 2 * np.pi * best[2]
    parameters = np.zeros(PHYSICAL + TRANSIENTS)
    parameters[:PHYSICAL] = np.log(best[1]), np.log(reference), best[3], delay * reference
    return reference, parameters, rough


def _floor(problem: Problem, parameters: Array, *, reference: float) -> Array:
    """Expected power of the residual from the noise floors of both channels."""
    spectra = problem.spectra
    response = _response(parameters, 2 * np.pi * spectra.frequency, reference)[0]
    return spectra.load_noise + np.abs(response) ** 2 * spectra.ground_noise


def _weights(problem: Problem, parameters: Array, *, reference: float) -> tuple[_Weights, bool]:
    """Weigh every frequency by the noise there, taken from the residuals where they are not white at the floor.

    A frequency whose excitation is lost in noise carries more noise than information into an errors-in-both fit; the
    weight S / (S + V), with S the power of the ground motion nearby and V the variance of its estimate, is the best.
    """
    spectra = problem.spectra
    unit = _Weights(spectra.load_noise, spectra.ground_noise, np.ones(spectra.frequency.size))
    point = _point(problem, parameters, weights=unit, reference=reference)
    count = spectra.block_sum(np.ones(spectra.frequency.size))
    ratio = spectra.block_sum(np.abs(point.residual) ** 2 / point.variance) / count
    departure = float(np.sum(count * (ratio / ratio.mean() - 1) ** 2))
    coloured = departure > count.size + 5 * np.sqrt(2 * count.size) or abs(ratio.mean() - 1) > 0.1
    load, ground = spectra.load_noise, spectra.ground_noise
    if coloured:
        scale = ratio[spectra.block]
        through = point.variance - load
        load = scale * point.variance - through
        poor = load < 0.05 * scale * point.variance
        load = np.where(poor, scale * spectra.load_noise, load)
        ground = np.where(poor, scale * ground, ground)
    variance = load + (point.variance - spectra.load_noise) / spectra.ground_noise * ground
    blur = load * ground / variance
    power = _local_mean(np.abs(point.ground) ** 2) - blur
    power = np.maximum(power, 1e-3 * blur)
    return _Weights(load, ground, power / (power + blur)), bool(coloured)


def _local_mean(power: Array) -> Array:
    """Mean over nine neighbouring frequencies."""
    padded = np.pad(power, 4, mode="reflect")
    return np.asarray(np.convolve(padded, np.full(9, 1 / 9), mode="valid"), dtype=np.float64)


def _estimate(
    problem: Problem,
    parameters: Array,
    *,
    weights: _Weights,
    reference: float,
    coloured: bool,
    name: str,
) -> Estimate:
    """Covariance and summary at the minimum."""
    spectra = problem.spectra
    floor = _floor(problem, parameters, reference=reference)
    point = _point(problem, parameters, weights=weights, reference=reference)
    free = _free(problem)
    jacobian = point.jacobian
    curvature = np.real(jacobian.conj().T @ jacobian)
    # The weights have the residual level in every block, so what is left to scale is their own error.
    count = spectra.block_sum(np.ones(spectra.frequency.size))
    level = spectra.block_sum(np.abs(point.residual) ** 2 / point.variance) / count
    loud = (weights.weight * np.maximum(level, 1.0)[spectra.block])[:, None]
    meat = np.real((jacobian * loud).conj().T @ jacobian)[np.ix_(free, free)] / 2
    try:
        inverse = np.linalg.inv(curvature[np.ix_(free, free)])
    except np.linalg.LinAlgError as problem_found:
        raise FitError(f"{name}: the record does not fix the parameters; excite a wider band") from problem_found
    covariance = np.zeros((PHYSICAL + TRANSIENTS,) * 2)
    covariance[np.ix_(free, free)] = inverse @ meat @ inverse
    sensitivity = np.zeros(PHYSICAL - 1)
    if problem.mass is not None:
        shift = np.zeros(PHYSICAL + TRANSIENTS)
        shift[free] = -inverse @ curvature[free, 0]
        sensitivity = shift[1:PHYSICAL] * np.array([1.0, 1.0, 1 / reference])
    unit = np.diag([1.0, 1.0, 1.0, 1 / reference])
    return Estimate(
        mass=float(np.exp(parameters[0])),
        angular_frequency=float(np.exp(parameters[1])),
        loss=float(parameters[2]),
        delay=float(parameters[3] / reference),
        covariance=unit @ covariance[:PHYSICAL, :PHYSICAL] @ unit,
        sensitivity_to_mass=sensitivity,
        residual=point.residual,
        load=point.load,
        floor=floor,
        chi2=float(2 * np.sum(np.abs(point.residual) ** 2 / floor)),
        degrees_of_freedom=2 * spectra.frequency.size - free.size,
        coloured=coloured,
        correlation=_correlation(problem, parameters, point=point, weights=weights, reference=reference),
        blocks=spectra.blocks,
    )


def _correlation(problem: Problem, parameters: Array, *, point: _Point, weights: _Weights, reference: float) -> float:
    """How far residual and measured ground motion correlate otherwise than by the noise they share.

    The noise of the ground acceleration makes E[U* (Y - H U)] = -H S_u; whether the noise assumed is there is seen
    from how well this holds, block by block.
    """
    spectra = problem.spectra
    response = _response(parameters, 2 * np.pi * spectra.frequency, reference)[0]
    product = np.conj(spectra.ground) * point.residual
    departure = product + response * weights.ground
    power = spectra.block_sum(np.abs(product) ** 2)
    return float(np.sum((spectra.block_sum(departure) ** 2 + spectra.block_sum(departure.imag) ** 2) / power))
