"""Maximum likelihood for the modes of a balance on a shaken base, with noise in both channels, by frequency."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import Mode
from aerobalance.identification.base_excitation.first_guess import first_guess, incoherent_noise
from aerobalance.identification.base_excitation.frf_model import (
    FIRST,
    FURTHER,
    TRANSIENTS,
    LikelihoodPoint,
    Parameters,
    Problem,
    Weights,
    point,
    response,
)
from aerobalance.identification.base_excitation.spectra import Complex
from aerobalance.identification.levenberg_marquardt import DampedStep, Settings, levenberg_marquardt
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

HIGHEST: Final = 50
"""Largest natural frequency that is tried, over the highest frequency used."""

LARGEST_LOSS: Final = 4.0
"""Largest loss b w0 / k that is tried: twice critical damping."""

SETTINGS: Final = Settings(
    most_steps=200,
    enough=1e-6,  # a thousandth of a standard deviation
    barely=1e-6,
    last=True,
    damping=1e-3,
    negligible=3e-12,
    lowest=1e-12,
)
"""How the fit is damped, and when it has settled."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The most likely parameters.

    Attributes
    ----------
    mass, angular_frequency, loss, delay
        M [kg; kg*m], w0 [rad/s], b w0 / k [1] and tau [s].
    further_modes
        The m modes beside the first; their shares are those of a load from the ground's motion.
    covariance
        Covariance of log M, log w0, loss and tau, then log w, loss and share of each further mode, shape
        (4 + 3 m, 4 + 3 m).
    sensitivity_to_mass
        Change of all these but the first per unit of log M when the mass is given, shape (3 + 3 m,).
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
    parameters, weights
        The parameters as fitted, and the weights they are the most likely ones for.
    """

    mass: float
    angular_frequency: float
    loss: float
    delay: float
    further_modes: tuple[Mode, ...]
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
    parameters: Parameters
    weights: Weights

    @property
    def adequate(self) -> bool:
        """Whether these modes leave nothing that follows the ground motion, beyond chance (5 sigma)."""
        return bool(self.correlation < self.blocks + 5 * np.sqrt(self.blocks))


def maximise(problem: Problem, *, name: str, start: Parameters | None = None) -> Estimate:
    """Find the most likely parameters, with weights that follow the residual spectrum where the noise is coloured.

    Parameters
    ----------
    problem
        What to fit.
    name
        Name of the record, for messages.
    start
        Where to begin, which fixes the number of modes; by default one mode, searched for on a grid.

    Raises
    ------
    FitError
        No minimum is found, or there are fewer frequencies than parameters.
    """
    spectra = problem.spectra
    if start is not None:
        start = start.holding(mass=problem.mass, delay=problem.delay)
    unknown = FIRST + TRANSIENTS if start is None else start.values.size
    if 2 * spectra.frequency.size < 4 * unknown:
        raise FitError(f"{name}: {spectra.frequency.size} frequencies with a response are too few; record for longer")
    estimate = _fit(problem, name=name, start=start)
    if problem.spectra.ground_noise_given or estimate.correlation < estimate.blocks + 2 * estimate.blocks**0.5:
        return estimate
    # The quietest part of the spectrum need not tell the noise where the ground moves (a differentiated speed, say).
    quiet = replace(problem.spectra, ground_noise=1e-6 * problem.spectra.ground_noise)
    other = _fit(replace(problem, spectra=quiet), name=name, start=start)
    return other if other.correlation < estimate.correlation - 10 else estimate


def gain_over(problem: Problem, larger: Estimate, *, smaller: Estimate, name: str) -> float:
    """Log-likelihood that a larger number of modes gains over a smaller one, with the weights of the larger."""
    parameters = descend(problem, smaller.parameters, weights=larger.weights, name=name)
    costs = [point(problem, each, weights=larger.weights).cost for each in (parameters, larger.parameters)]
    return costs[0] - costs[1]


def _fit(problem: Problem, *, name: str, start: Parameters | None) -> Estimate:
    """Find the most likely parameters for the noise of the ground acceleration as given."""
    if start is None:
        rough = incoherent_noise(problem.spectra)
        parameters = first_guess(problem, noise=rough)
        weights = Weights(rough, problem.spectra.ground_noise, np.ones(rough.size))
    else:
        parameters, weights = start, first_weights(problem, start)
    parameters = descend(problem, parameters, weights=weights, name=name)
    coloured = False
    for _ in range(3):
        weights, coloured = _weights(problem, parameters)
        parameters = descend(problem, parameters, weights=weights, name=name)
    return _estimate(problem, parameters, weights=weights, coloured=coloured, name=name)


def first_weights(problem: Problem, parameters: Parameters) -> Weights:
    """Weights by the part of the residual that does not follow the ground motion: what does is the model's."""
    spectra = problem.spectra
    unit = Weights(spectra.load_noise, spectra.ground_noise, np.ones(spectra.frequency.size))
    here = point(problem, parameters, weights=unit)
    count = spectra.block_sum(np.ones(spectra.frequency.size))
    cross = np.conj(spectra.ground) * here.residual
    square = spectra.block_sum(np.real(cross)) ** 2 + spectra.block_sum(np.imag(cross)) ** 2
    left = spectra.block_sum(np.abs(here.residual) ** 2)
    rest = (left - square / spectra.block_sum(np.abs(spectra.ground) ** 2)) / np.maximum(count - 1, 1)
    through = here.variance - spectra.load_noise
    return replace(unit, load=np.maximum(spectra.load_noise, rest[spectra.block] - through))


def rough_mode(problem: Problem, *, name: str) -> Parameters:
    """Fit one mode by plain least squares: the highest peak decides, and weak modes beside it do little harm."""
    spectra = problem.spectra
    noise = np.full(spectra.frequency.size, float(np.mean(np.abs(spectra.load) ** 2)))
    weights = Weights(noise, spectra.ground_noise, np.ones(noise.size))
    return descend(problem, first_guess(problem, noise=noise), weights=weights, name=name)


def _free(problem: Problem, parameters: Parameters) -> NDArray[np.intp]:
    """Numbers of the parameters that are to be found."""
    fixed = {0} if problem.mass is not None else set()
    fixed |= {3} if problem.delay is not None else set()
    return np.array([i for i in range(parameters.values.size) if i not in fixed], dtype=np.intp)


def descend(problem: Problem, parameters: Parameters, *, weights: Weights, name: str) -> Parameters:
    """Return the most likely parameters under given weights, by the Levenberg-Marquardt method.

    Raises
    ------
    FitError
        The fit does not settle.
    """
    top = float(problem.spectra.frequency[-1])
    highest = float(np.log(2 * np.pi * HIGHEST * top))

    def step(
        state: tuple[Parameters, LikelihoodPoint], damping: float
    ) -> DampedStep[tuple[Parameters, LikelihoodPoint]]:
        parameters, here = state
        slope = np.real(here.jacobian.conj().T @ (here.residual * np.sqrt(weights.weight / here.variance)))
        free = _movable(_free(problem, parameters), parameters, slope=slope, highest=highest)
        jacobian, score = here.jacobian[:, free], slope[free]
        curvature = np.real(jacobian.conj().T @ jacobian)
        scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
        scaled = curvature / np.outer(scale, scale)
        move = np.linalg.lstsq(scaled + damping * np.eye(free.size), score / scale, rcond=1e-14)[0]
        trial = _moved(parameters, free, move / scale, highest=highest)

        def take() -> tuple[tuple[Parameters, LikelihoodPoint], float]:
            found = point(problem, trial, weights=weights)
            return (trial, found), found.cost

        return DampedStep(float(np.max(move**2)), take)

    here = point(problem, parameters, weights=weights)
    (parameters, here), costs, settled = levenberg_marquardt((parameters, here), here.cost, step, SETTINGS)
    if settled or costs[100] - here.cost < 1:  # a valley as flat as this is for the covariance to tell
        return parameters
    if np.exp(parameters.values[1]) > 3 * np.pi * top:
        raise FitError(
            f"{name}: the record does not carry the stiffness (the fit runs away above the "
            f"{top:.4g} Hz that are excited); excite nearer to the natural frequency"
        )
    raise FitError(f"{name}: the fit of the response does not settle; restrict the band to where one mode answers")


def _movable(free: NDArray[np.intp], parameters: Parameters, *, slope: Array, highest: float) -> NDArray[np.intp]:
    """Leave out the parameters that rest on a bound and would fit better beyond it."""
    resting = []
    for place in parameters.frequencies:
        if parameters.values[place] == highest and slope[place] > 0:
            resting.append(place)  # so far above the band that the natural frequency no longer matters
        loss = parameters.values[place + 1]
        if (loss == 0 and slope[place + 1] < 0) or (loss == LARGEST_LOSS and slope[place + 1] > 0):
            resting.append(place + 1)
    return free[~np.isin(free, resting)]


def _moved(parameters: Parameters, free: NDArray[np.intp], step: Array, *, highest: float) -> Parameters:
    """Move by a step, short enough and within the bounds."""
    values = parameters.values.copy()
    values[free] += step
    values[0] = np.clip(values[0], parameters.values[0] - 3.0, parameters.values[0] + 3.0)  # a mass 20 times as large
    for place in parameters.frequencies:
        old = parameters.values[place]
        values[place] = min(np.clip(values[place], old - 0.5, old + 0.5), highest)
        values[place + 1] = np.clip(values[place + 1], 0.0, LARGEST_LOSS)
    return replace(parameters, values=values)


def _floor(problem: Problem, parameters: Parameters) -> Array:
    """Expected power of the residual from the noise floors of both channels."""
    spectra = problem.spectra
    answer = response(parameters, 2 * np.pi * spectra.frequency)
    return spectra.load_noise + np.abs(answer) ** 2 * spectra.ground_noise


def _weights(problem: Problem, parameters: Parameters) -> tuple[Weights, bool]:
    """Weigh every frequency by the noise there, taken from the residuals where they are not white at the floor.

    A frequency whose excitation is lost in noise carries more noise than information into an errors-in-both fit; the
    weight S / (S + V), with S the power of the ground motion nearby and V the variance of its estimate, is the best.
    """
    spectra = problem.spectra
    unit = Weights(spectra.load_noise, spectra.ground_noise, np.ones(spectra.frequency.size))
    here = point(problem, parameters, weights=unit)
    count = spectra.block_sum(np.ones(spectra.frequency.size))
    ratio = spectra.block_sum(np.abs(here.residual) ** 2 / here.variance) / count
    departure = float(np.sum(count * (ratio / ratio.mean() - 1) ** 2))
    coloured = departure > count.size + 5 * np.sqrt(2 * count.size) or abs(ratio.mean() - 1) > 0.1
    load, ground = spectra.load_noise, spectra.ground_noise
    if coloured:
        scale = ratio[spectra.block]
        through = here.variance - load
        load = scale * here.variance - through
        poor = load < 0.05 * scale * here.variance
        load = np.where(poor, scale * spectra.load_noise, load)
        ground = np.where(poor, scale * ground, ground)
    variance = load + (here.variance - spectra.load_noise) / spectra.ground_noise * ground
    blur = load * ground / variance
    power = _local_mean(np.abs(here.ground) ** 2) - blur
    power = np.maximum(power, 1e-3 * blur)
    return Weights(load, ground, power / (power + blur)), bool(coloured)


def _local_mean(power: Array) -> Array:
    """Mean over nine neighbouring frequencies."""
    padded = np.pad(power, 4, mode="reflect")
    return np.asarray(np.convolve(padded, np.full(9, 1 / 9), mode="valid"), dtype=np.float64)


def _estimate(problem: Problem, parameters: Parameters, *, weights: Weights, coloured: bool, name: str) -> Estimate:
    """Covariance and summary at the minimum."""
    spectra, values, physical = problem.spectra, parameters.values, parameters.physical
    floor = _floor(problem, parameters)
    here = point(problem, parameters, weights=weights)
    covariance, sensitivity = _covariance(problem, parameters, here=here, weights=weights, name=name)
    unit = np.ones(physical)
    unit[3] = 1 / parameters.reference
    return Estimate(
        mass=float(np.exp(values[0])),
        angular_frequency=float(np.exp(values[1])),
        loss=float(values[2]),
        delay=float(values[3] / parameters.reference),
        further_modes=tuple(
            Mode(float(np.exp(w)) / (2 * np.pi), float(loss) / 2, float(share))
            for w, loss, share in values[FIRST:physical].reshape(-1, FURTHER)
        ),
        covariance=covariance[:physical, :physical] * np.outer(unit, unit),
        sensitivity_to_mass=(sensitivity[:physical] * unit)[1:],
        residual=here.residual,
        load=here.load,
        floor=floor,
        chi2=float(2 * np.sum(np.abs(here.residual) ** 2 / floor)),
        degrees_of_freedom=2 * spectra.frequency.size - _free(problem, parameters).size,
        coloured=coloured,
        correlation=_correlation(problem, parameters, here=here, weights=weights),
        blocks=spectra.blocks,
        parameters=parameters,
        weights=weights,
    )


def _covariance(
    problem: Problem, parameters: Parameters, *, here: LikelihoodPoint, weights: Weights, name: str
) -> tuple[Array, Array]:
    """Covariance of all parameters, and their change with the log of a mass that is given."""
    spectra, jacobian = problem.spectra, here.jacobian
    free = _free(problem, parameters)
    curvature = np.real(jacobian.conj().T @ jacobian)
    # The weights have the residual level in every block, so what is left to scale is their own error.
    count = spectra.block_sum(np.ones(spectra.frequency.size))
    level = spectra.block_sum(np.abs(here.residual) ** 2 / here.variance) / count
    loud = (weights.weight * np.maximum(level, 1.0)[spectra.block])[:, None]
    meat = np.real((jacobian * loud).conj().T @ jacobian)[np.ix_(free, free)] / 2
    try:
        inverse = np.linalg.inv(curvature[np.ix_(free, free)])
    except np.linalg.LinAlgError as problem_found:
        raise FitError(f"{name}: the record does not fix the parameters; excite a wider band") from problem_found
    covariance = np.zeros((parameters.values.size,) * 2)
    covariance[np.ix_(free, free)] = inverse @ meat @ inverse
    sensitivity = np.zeros(parameters.values.size)
    if problem.mass is not None:
        sensitivity[free] = -inverse @ curvature[free, 0]
    return covariance, sensitivity


def _correlation(problem: Problem, parameters: Parameters, *, here: LikelihoodPoint, weights: Weights) -> float:
    """How far residual and measured ground motion correlate otherwise than by the noise they share.

    The noise of the ground acceleration makes E[U* (Y - H U)] = -H S_u; whether the noise assumed is there is seen
    from how well this holds, block by block.
    """
    spectra = problem.spectra
    answer = response(parameters, 2 * np.pi * spectra.frequency)
    product = np.conj(spectra.ground) * here.residual
    departure = product + answer * weights.ground
    power = spectra.block_sum(np.abs(product) ** 2)
    return float(np.sum((spectra.block_sum(departure) ** 2 + spectra.block_sum(departure.imag) ** 2) / power))
