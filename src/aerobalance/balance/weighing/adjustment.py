"""Weighted least squares of the weight model, with the parameters that the attitudes can identify."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from aerobalance.balance.weighing.model import WeightModel
from aerobalance.recording.channel import Array
from aerobalance.recording.components import MOMENTS
from aerobalance.recording.errors import FitError

LARGEST_UNCERTAINTY: Final = 0.2
"""Predicted standard uncertainty, relative to the natural scale, up to which a parameter is identified."""

ANGLE_RESOLUTION: Final = np.radians(0.02)
"""Uncertainty of an angle that is reckoned with when deciding what the attitudes can show [rad]."""

DENSITY: Final = 2700.0
"""Density of aluminium [kg/m^3]; the side of a cube of the mass is the natural scale of the centre of gravity."""

MISALIGNMENT_SCALE: Final = np.radians(1.0)
"""Natural scale of a misalignment [rad]."""

ROUNDING: Final = 1e-13
"""Least scatter reckoned with, relative to the weight (or the weight on the natural lever)."""

ROUNDS: Final = 40
"""Most repetitions of choosing, fitting and weighting."""

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Static loads [N, N*m] with their attitudes and errors, ready for the fit.

    Attributes
    ----------
    directions
        Shares of gravity, shape (n, 3) [g].
    loads, noise
        Readings and their known standard uncertainties, shape (n, c).
    mass
        Scale of the mass [kg].
    shared
        Covariance of the errors that readings share, shape (n, c, n, c); None for none.
    """

    directions: Array
    loads: Array
    noise: Array
    mass: float
    shared: Array | None = None

    @property
    def size(self) -> Array:
        """Known uncertainty of the readings as the fit weighs them, shape (n, c) [N, N*m].

        An error that n readings share counts like noise of sqrt(n) times its size: so large is what it may change.
        """
        if self.shared is None:
            return self.noise
        n, c = self.loads.shape
        variance = np.einsum("nn->n", self.shared.reshape(n * c, n * c)).reshape(n, c)
        return np.asarray(np.hypot(self.noise, np.sqrt(n * np.maximum(variance.mean(axis=0), 0.0))))

    @property
    def length(self) -> float:
        """Natural scale of the centre of gravity: the side of an aluminium cube of the mass [m]."""
        return float(np.cbrt(self.mass / DENSITY))

    def load_scales(self, model: WeightModel) -> Array:
        """Weight, or weight on the natural lever, of every component, shape (c,) [N, N*m]."""
        weight = self.mass * model.gravity
        return np.array([weight * (self.length if name in MOMENTS else 1.0) for name in model.components])


@dataclass(frozen=True, slots=True, eq=False)
class Adjustment:
    """Parameters of the weight model with covariance and residuals, by one fit.

    Attributes
    ----------
    model
        The model.
    values
        All its parameters, shape (p,); as assumed where left out.
    kept, left_out
        Indices of the parameters that were fitted (k of them) and of those left out (q).
    covariance
        Of the fitted ones, shape (k, k): noise, and what parameters left out may have put into them.
    residuals
        Readings less fit, shape (n, c).
    sigma
        Noise of each reading, shape (n, c), about any linear function of gravity's shares, or as given if larger:
        what the parameters were chosen by.
    deviations, freedom
        Residual standard deviation and degrees of freedom of every component, shape (c,).
    scales
        Natural scales of the parameters left out, shape (q,).
    absorbed
        Change of the fitted parameters by a unit of each one left out, shape (k, q).
    """

    model: WeightModel
    values: Array
    kept: Indices
    left_out: Indices
    covariance: Array
    residuals: Array
    sigma: Array
    deviations: Array
    freedom: Array
    scales: Array
    absorbed: Array

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        names = self.model.names
        return tuple(names[index] for index in self.kept)


def natural_scales(model: WeightModel, readings: Readings) -> Array:
    """Size that each parameter may well have, shape (p,); infinite for offsets, which are always fitted."""
    sizes = {
        "mass": readings.mass,
        "moment": readings.mass * readings.length,
        "offset": np.inf,
        "misalignment": MISALIGNMENT_SCALE,
    }
    return np.array([sizes[name.split(".", maxsplit=1)[0]] for name in model.names])


def predicted_uncertainties(jacobian: Array) -> Array:
    """Standard uncertainties from a whitened Jacobian, shape (m, k); huge where columns are not independent."""
    norms = np.sqrt(np.sum(jacobian**2, axis=0))
    result = np.full(norms.size, np.inf)
    there = np.flatnonzero(norms > 0)
    if there.size:
        # Padded, so that fewer rows than columns show as columns that are not independent.
        scaled = np.vstack([jacobian[:, there] / norms[there], np.zeros((there.size, there.size))])
        _, singular, rotation = np.linalg.svd(scaled, full_matrices=False)
        floor = np.finfo(np.float64).eps * singular[0]
        spread: Array = (rotation / np.maximum(singular, floor)[:, None]) ** 2
        result[there] = np.sqrt(spread.sum(axis=0)) / norms[there]
    return result


def identified(model: WeightModel, jacobian: Array, scales: Array) -> Indices:
    """Return the indices of the parameters that can be identified beside one another.

    A parameter is identified where its standard uncertainty, predicted from the information matrix, is at most a
    fifth of its natural scale: of the mass for masses, an aluminium cube of that mass for the centre of gravity, one
    degree for misalignment. As long as one is not, the least needed of the doubtful ones goes: angles before static
    moments before masses, and the most uncertain first. Those that turn out to fit beside the rest come back.

    Parameters
    ----------
    model
        Its parameters are chosen from.
    jacobian
        Whitened with the noise and the resolution of the angles, shape (m, p).
    scales
        From `natural_scales`.

    Returns
    -------
    Indices
        Of the chosen ones, in order.
    """
    if jacobian.shape[0] > jacobian.shape[1]:
        jacobian = np.linalg.qr(jacobian)[1]  # the same information in fewer rows
    order = [["misalignment", "moment", "mass", "offset"].index(name.split(".")[0]) for name in model.names]

    def ratios(chosen: list[int]) -> Array:
        result: Array = predicted_uncertainties(jacobian[:, chosen]) / scales[chosen]
        return np.where(np.isinf(scales[chosen]), 0.0, result)

    kept = list(range(len(order)))
    dropped: list[int] = []
    while (ratio := ratios(kept)).max() > LARGEST_UNCERTAINTY:
        doubtful = [place for place in range(len(kept)) if ratio[place] > LARGEST_UNCERTAINTY]
        worst = min(doubtful, key=lambda place: (order[kept[place]], -ratio[place]))
        dropped.append(kept.pop(worst))
    for index in sorted(dropped, key=lambda index: -order[index]):
        if ratios([*kept, index]).max() <= LARGEST_UNCERTAINTY:
            kept.append(index)
    return np.array(sorted(kept), dtype=np.intp)


def planning_noise(model: WeightModel, readings: Readings, sigma: Array) -> Array:
    """Noise with the resolution of the angles added, shape of sigma: what counts when parameters are chosen."""
    resolution: Array = np.hypot(sigma, ANGLE_RESOLUTION * readings.load_scales(model))
    return resolution


def planning_jacobian(model: WeightModel, readings: Readings, *, values: Array, sigma: Array) -> Array:
    """Whitened Jacobian that parameters are chosen by, shape (n, c, p).

    It is that of a balance in line with the inclinometer: a parameter that shows only because a small misalignment
    was fitted besides is not identified.
    """
    straight = values.copy()
    straight[-3:] = 0.0
    return model.jacobian(readings.directions, straight) / planning_noise(model, readings, sigma)[:, :, None]


def adjust(model: WeightModel, readings: Readings, *, assumed: Array | None = None) -> Adjustment:
    """Return the fit by weighted least squares.

    Every component is weighted by its own scatter, or by the known uncertainty of its readings where that is larger.

    Parameters
    ----------
    model, readings
        What is fitted to what.
    assumed
        Values of parameters that are left out, shape (p,); zero if not given.

    Raises
    ------
    FitError
        Nothing tells the noise of a component.
    """
    scales = natural_scales(model, readings)
    # The choice rests on noise that does not depend on the choice: what is left out must not hide in its residuals.
    sigma = free = _free_sigma(model, readings)
    held = np.zeros(scales.size) if assumed is None else assumed
    values = held
    kept: Indices = np.arange(scales.size)
    for turn in range(ROUNDS):
        white = planning_jacobian(model, readings, values=values, sigma=free).reshape(-1, scales.size)
        chosen = identified(model, white, scales)
        # Choosing and weighting could chase each other; after a few turns parameters may only go.
        before, kept = kept, chosen if turn < 5 else np.intersect1d(kept, chosen)
        values = _solve(model, readings, kept=kept, sigma=sigma, held=held)
        deviations, _ = _scatter(model, readings, kept=kept, values=values, sigma=sigma)
        floor = ROUNDING * readings.load_scales(model)
        used, sigma = sigma, np.maximum(np.maximum(deviations, floor), readings.size)
        settled = np.abs(sigma - used) <= 1e-4 * sigma + 10 * floor
        if np.array_equal(before, kept) and settled.all():
            break
    return _outcome(model, readings, kept=kept, values=values, sigma=sigma, free=free)


def _free_sigma(model: WeightModel, readings: Readings) -> Array:
    """Noise of each component about any linear function of gravity's shares: independent of the model."""
    count = readings.directions.shape[0]
    design = np.column_stack([np.ones(count), readings.directions])
    solution, _, rank, _ = np.linalg.lstsq(design, readings.loads, rcond=1e-9)
    residuals = readings.loads - design @ solution
    scales = readings.load_scales(model)
    scatter = np.sqrt(np.sum(residuals**2, axis=0) / (count - rank)) if count > rank else 1e-3 * scales
    return np.maximum(np.maximum(scatter, ROUNDING * scales), readings.size)


def _solve(model: WeightModel, readings: Readings, *, kept: Indices, sigma: Array, held: Array) -> Array:
    """Least squares over the chosen parameters; the others are held."""

    def full(part: Array) -> Array:
        values = held.copy()
        values[kept] = part
        return values

    def white(part: Array) -> Array:
        rest: Array = (model.loads(readings.directions, full(part)) - readings.loads) / sigma
        return rest.ravel()

    def slope(part: Array) -> Array:
        rows: Array = model.jacobian(readings.directions, full(part))[:, :, kept] / sigma[:, :, None]
        return rows.reshape(-1, kept.size)

    # Without misalignment the loads are linear in the parameters: one step gives the start.
    origin = np.zeros(kept.size)
    linear = np.array([not model.names[index].startswith("misalignment") for index in kept])
    matrix = slope(origin)[:, linear]
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms == 0] = 1.0
    origin[linear] = np.linalg.lstsq(matrix / norms, -white(origin), rcond=None)[0] / norms
    if linear.all():
        return full(origin)
    found = least_squares(white, origin, jac=slope, x_scale="jac", method="trf", ftol=1e-15, xtol=1e-15, gtol=1e-15)
    return full(np.asarray(found.x, dtype=np.float64))


def _scatter(
    model: WeightModel, readings: Readings, *, kept: Indices, values: Array, sigma: Array
) -> tuple[Array, Array]:
    """Residual standard deviation of each component, and its degrees of freedom: points less the leverage it used."""
    residuals = readings.loads - model.loads(readings.directions, values)
    jacobian = model.jacobian(readings.directions, values)[:, :, kept] / sigma[:, :, None]
    rows = jacobian.reshape(-1, kept.size)
    orthogonal = np.linalg.qr(rows / np.linalg.norm(rows, axis=0))[0]
    leverage = np.sum(orthogonal**2, axis=1).reshape(residuals.shape).sum(axis=0)
    freedom = residuals.shape[0] - leverage
    free = freedom > 0.5
    for column, name in enumerate(model.components):
        if not free[column] and not readings.noise[:, column].all():
            raise FitError(
                f"{residuals.shape[0]} points are fitted exactly by {name} and leave nothing to tell its noise; "
                f"add points at further pitch and roll angles, or give the uncertainty u_{name} of each reading"
            )
    square = np.sum(residuals**2, axis=0)
    return np.sqrt(np.divide(square, freedom, out=np.zeros_like(square), where=free)), freedom


def _outcome(
    model: WeightModel, readings: Readings, *, kept: Indices, values: Array, sigma: Array, free: Array
) -> Adjustment:
    """Put the result together, with its covariance."""
    deviations, freedom = _scatter(model, readings, kept=kept, values=values, sigma=sigma)
    jacobian = model.jacobian(readings.directions, values) / sigma[:, :, None]
    rows = jacobian.reshape(-1, values.size)
    norms = np.linalg.norm(rows[:, kept], axis=0)
    inverse = np.linalg.pinv(rows[:, kept] / norms) / norms[:, None]
    left_out: Indices = np.setdiff1d(np.arange(values.size), kept)
    scales = natural_scales(model, readings)[left_out]
    absorbed = inverse @ rows[:, left_out]
    spread = inverse @ inverse.T
    if readings.shared is not None:
        white = _noise_beside(readings, rows[:, kept] @ inverse, sigma=sigma, deviations=deviations, freedom=freedom)
        slopes = inverse / sigma.ravel()
        whole = readings.shared.reshape(sigma.size, sigma.size)
        spread = (slopes * white.ravel() ** 2) @ slopes.T + slopes @ whole @ slopes.T
    return Adjustment(
        model=model,
        values=values,
        kept=kept,
        left_out=left_out,
        covariance=spread + (absorbed * scales**2) @ absorbed.T,
        residuals=readings.loads - model.loads(readings.directions, values),
        sigma=free,
        deviations=deviations,
        freedom=freedom,
        scales=scales,
        absorbed=absorbed,
    )


def _noise_beside(readings: Readings, fitted: Array, *, sigma: Array, deviations: Array, freedom: Array) -> Array:
    """Standard uncertainty of readings by noise [N, N*m], shape (n, c): their scatter less what shared errors give.

    Parameters
    ----------
    readings
        With their shared errors.
    fitted
        Whitened fit of whitened readings, shape (n c, n c).
    sigma
        What whitened them, shape (n, c).
    deviations, freedom
        Residual standard deviation and degrees of freedom of every component, shape (c,).
    """
    left = np.eye(sigma.size) - fitted
    shared = np.asarray(readings.shared).reshape(fitted.shape) / np.outer(sigma, sigma)
    in_residuals = np.einsum("ij,jk,ik->i", left, shared, left, optimize=True).reshape(sigma.shape) * sigma**2
    square = np.divide(in_residuals.sum(axis=0), freedom, out=np.zeros_like(freedom), where=freedom > 0)
    return np.asarray(np.maximum(np.sqrt(np.maximum(deviations**2 - square, 0.0)), readings.noise))
