"""Identification of one component from a table of its frequency response AF/F, as sine calibrations publish it.

The model is exp(-i w tau) / (1 - r^2 + i r d) with r = w / w0. It is fitted by weighted least squares to amplitude and
phase in the parameters log w0, loss factor d = b w0 / k and delay tau [s], in this order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc

from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.wording import damping_text

DOUBTFUL_DAMPING: Final = 0.1
"""Relative standard uncertainty of the damping above which it is called hardly identifiable [1]."""

LEAST_PROBABILITY: Final = 0.01
"""Probability of a chi2 as large or larger [1], below which model or stated uncertainties are doubted."""


@dataclass(frozen=True, slots=True, eq=False)
class ResponseTable:
    """Frequency response AF/F, balance load over force, at n frequencies, with standard uncertainties.

    Attributes
    ----------
    frequency
        Frequencies, shape (n,) [Hz].
    amplitude, u_amplitude
        Modulus of the response and its standard uncertainty, shape (n,) each [1].
    phase, u_phase
        Phase of the response, lag negative, and its standard uncertainty, shape (n,) each [rad].
    name
        What to call the table in messages.
    """

    frequency: Array
    amplitude: Array
    u_amplitude: Array
    phase: Array
    u_phase: Array
    name: str = "response table"

    def __post_init__(self) -> None:
        columns = ("frequency", "amplitude", "u_amplitude", "phase", "u_phase")
        shape = self.frequency.shape
        for column in columns:
            values = getattr(self, column)
            if values.ndim != 1 or values.shape != shape:
                raise ValueError(f"{column} must have shape {shape} like frequency, not {values.shape}")
            if not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values))[0]) + 1
                raise ValueError(f"{column} of point {row} is not a finite number")
            if column != "phase" and not (values > 0).all():
                row = int(np.flatnonzero(values <= 0)[0]) + 1
                raise ValueError(f"{column} of point {row} must be positive, not {values[row - 1]:g}")


@dataclass(frozen=True, slots=True, eq=False)
class FrfFit:
    """Dynamics of one component fitted to a response table, with residuals and a chi2 test.

    Attributes
    ----------
    dynamics
        Mass, stiffness, damping and delay with their covariance.
    delay_found
        Whether Bayes' information criterion asks for a delay; otherwise the delay is zero.
    chi2, degrees_of_freedom
        Sum of squared residuals over their stated uncertainties, and its expected value [1].
    probability
        Probability of a chi2 as large or larger if model and stated uncertainties hold [1].
    scale
        Factor by which the covariance was enlarged because chi2 is too large; 1 where it is not [1].
    amplitude_residual, phase_residual
        Table less fit, shape (n,) [1] and [rad].
    notes
        Warnings about the result, each a sentence.
    """

    dynamics: Dynamics
    delay_found: bool
    chi2: float
    degrees_of_freedom: int
    probability: float
    scale: float
    amplitude_residual: Array
    phase_residual: Array
    notes: tuple[str, ...]


def identify_frf(table: ResponseTable, *, component: str = "AF", mass: float | tuple[float, float]) -> FrfFit:
    """Return the dynamics fitted to a response table: natural frequency, damping and, on evidence, a delay.

    Parameters
    ----------
    table
        The response AF/F.
    component
        Which component it belongs to.
    mass
        Moving mass [kg; kg*m for a moment], exact, or with its standard uncertainty. It must be given, as the response
        fixes the ratios k/M and b/M only.

    Returns
    -------
    fit
        Dynamics with their covariance, residuals and the chi2 test.

    Raises
    ------
    FitError
        There are too few points, or they lie too far below the natural frequency to carry the stiffness.
    ValueError
        The mass or its uncertainty is out of range.
    """
    value, uncertainty = mass if isinstance(mass, tuple) else (mass, 0.0)
    if not 0 < value < np.inf or not 0 <= uncertainty < np.inf:
        raise ValueError(f"mass must be positive with an uncertainty of zero or more, not {value} and {uncertainty}")
    points, different = table.frequency.size, np.unique(table.frequency).size
    if different < 2:
        raise FitError(
            f"{table.name}: {points} point(s) at {different} frequency are too few for natural frequency and damping; "
            "give points at three different frequencies"
        )
    start = _starting_values(table)
    parameters, chi2 = _fit(table, np.array([*start, 0.0]), free=[0, 1])
    free = [0, 1]
    delayed, chi2_delayed = _fit(table, parameters, free=[0, 1, 2])
    # Bayes' information criterion; where the points scatter more than stated, chi2 counts in units of the scatter
    if chi2 - chi2_delayed > np.log(2 * points) * max(1.0, chi2_delayed / (2 * points - 3)):
        parameters, chi2, free = delayed, chi2_delayed, [0, 1, 2]
    degrees_of_freedom = 2 * points - len(free)
    probability = float(chdtrc(degrees_of_freedom, chi2))
    scale = chi2 / degrees_of_freedom if probability < LEAST_PROBABILITY else 1.0
    dynamics = _dynamics(table, parameters, free=free, component=component, mass=(value, uncertainty), scale=scale)
    notes = _notes(table, dynamics, chi2=chi2, degrees_of_freedom=degrees_of_freedom, probability=probability)
    for note in notes:
        warn_quality(f"{table.name}: {note}")
    model, _ = _model(table.frequency, parameters)
    return FrfFit(
        dynamics=dynamics,
        delay_found=2 in free,
        chi2=chi2,
        degrees_of_freedom=degrees_of_freedom,
        probability=probability,
        scale=scale,
        amplitude_residual=table.amplitude - np.abs(model),
        phase_residual=_wrapped(table.phase - np.angle(model)),
        notes=tuple(notes),
    )


def _wrapped(phase: Array) -> Array:
    """A phase brought to (-pi, pi] [rad]."""
    return np.asarray(np.angle(np.exp(1j * phase)))


def _model(frequency: Array, parameters: Array) -> tuple[Array, Array]:
    """Response, shape (n,) [1], and derivatives of its logarithm by the parameters, shape (n, 3), complex both."""
    w = 2 * np.pi * frequency
    r = w / np.exp(parameters[0])
    denominator = 1 - r**2 + 1j * r * parameters[1]
    response = np.exp(-1j * w * parameters[2]) / denominator
    slopes = [-(2 * r**2 - 1j * r * parameters[1]) / denominator, -1j * r / denominator, -1j * w]
    return response, np.column_stack(slopes)


def _weighted(table: ResponseTable, parameters: Array) -> tuple[Array, Array]:
    """Amplitude and phase residuals over their uncertainties, shape (2n,) [1], and their Jacobian, shape (2n, 3)."""
    response, slopes = _model(table.frequency, parameters)
    modulus = np.abs(response)
    residual = np.concatenate(
        [
            (modulus - table.amplitude) / table.u_amplitude,
            _wrapped(np.angle(response) - table.phase) / table.u_phase,
        ]
    )
    jacobian = np.vstack(
        [
            (modulus / table.u_amplitude)[:, None] * slopes.real,
            slopes.imag / table.u_phase[:, None],
        ]
    )
    return residual, jacobian


def _starting_values(table: ResponseTable) -> tuple[float, float]:
    """Logarithm of w0 [rad/s] and loss factor [1] of the best fit on a grid."""
    natural = np.geomspace(0.3 * table.frequency.min(), 30 * table.frequency.max(), 400)[:, None, None]
    loss = np.array([0.001, 0.01, 0.05, 0.2, 0.8])[:, None]
    r = table.frequency / natural
    response = 1 / (1 - r**2 + 1j * r * loss)
    amplitude = (np.abs(response) - table.amplitude) / table.u_amplitude
    phase = _wrapped(np.angle(response) - table.phase) / table.u_phase
    # Far from the fit one point beside a sharp peak must not decide: large residuals count less.
    cost = np.sum(np.log1p(amplitude**2) + np.log1p(phase**2), axis=-1)
    row, column = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return float(np.log(2 * np.pi * natural[row, 0, 0])), float(loss[column, 0])


def _fit(table: ResponseTable, start: Array, *, free: list[int]) -> tuple[Array, float]:
    """Parameters, shape (3,), and chi2 [1] of a weighted least-squares fit; `free` are the places of those fitted."""
    highest_w = float(2 * np.pi * table.frequency.max())
    unit = np.array([1.0, 1.0, 1 / highest_w])  # a delay of one unit turns the last point by a radian

    def full(x: Array) -> Array:
        parameters = start.copy()
        parameters[free] = x * unit[free]
        return parameters

    def residual(x: Array) -> Array:
        return _weighted(table, full(x))[0]

    def jacobian(x: Array) -> Array:
        return np.asarray(_weighted(table, full(x))[1][:, free] * unit[free])

    # Far beyond the points the natural frequency has no effect; `_dynamics` refuses it there.
    lowest = np.array([start[0] - 5, 0.0, -np.inf])[free]
    highest = np.array([np.log(100 * highest_w), np.inf, np.inf])[free]
    result = least_squares(
        residual,
        np.maximum(start[free] / unit[free], lowest + 1e-9),  # strictly inside the bounds, as the method asks
        jac=jacobian,
        bounds=(lowest, highest),
        x_scale="jac",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    return full(result.x), float(2 * result.cost)  # the cost is half of the sum of squares


def _dynamics(
    table: ResponseTable,
    parameters: Array,
    *,
    free: list[int],
    component: str,
    mass: tuple[float, float],
    scale: float,
) -> Dynamics:
    """Mass, stiffness, damping and delay with their covariance, from the fitted parameters and the mass.

    Raises
    ------
    FitError
        The points do not carry the stiffness: log w0 is uncertain by over 0.1, or w0 beyond 20 times the last point.
    """
    value, uncertainty = mass
    # first of log mass, log w0, loss factor and delay; log mass is not correlated with what is fitted
    _, jacobian = _weighted(table, parameters)
    covariance = np.zeros((4, 4))
    covariance[0, 0] = (uncertainty / value) ** 2
    fitted = [i + 1 for i in free]
    normal = jacobian[:, free].T @ jacobian[:, free]
    size = np.sqrt(np.diag(normal))
    covariance[np.ix_(fitted, fitted)] = scale * np.linalg.pinv(normal / np.outer(size, size)) / np.outer(size, size)
    w0, loss = float(np.exp(parameters[0])), float(parameters[1])
    highest = float(table.frequency.max())
    if np.sqrt(covariance[1, 1]) > 0.1 or w0 / (2 * np.pi) > 20 * highest:
        raise FitError(
            f"{table.name}: all points lie so far below the natural frequency that they do not carry the stiffness "
            f"(highest {highest:.4g} Hz); measure nearer to resonance"
        )
    stiffness, damping = value * w0**2, value * w0 * loss
    # derivatives of mass, stiffness, damping and delay by those
    change = np.array(
        [
            [value, 0.0, 0.0, 0.0],
            [stiffness, 2 * stiffness, 0.0, 0.0],
            [damping, damping, value * w0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    return Dynamics(
        component=component,
        mass=value,
        stiffness=stiffness,
        damping=damping,
        delay=float(parameters[2]),
        covariance=change @ covariance @ change.T,
    )


def _damping(dynamics: Dynamics) -> str:
    """Damping with its uncertainty, in words."""
    critical = 2 * dynamics.mass * 2 * np.pi * dynamics.natural_frequency
    return damping_text(dynamics.damping, dynamics.uncertainty("damping"), critical=critical)


def _notes(
    table: ResponseTable, dynamics: Dynamics, *, chi2: float, degrees_of_freedom: int, probability: float
) -> list[str]:
    """Sentences about what is doubtful in the result."""
    notes = []
    if probability < LEAST_PROBABILITY:
        notes.append(
            f"the points scatter more than their uncertainties let expect (chi2 {chi2:.3g} for {degrees_of_freedom} "
            f"degrees of freedom); one mode does not describe them or the uncertainties are too small, and the "
            f"covariance is enlarged {chi2 / degrees_of_freedom:.3g} times"
        )
    u = dynamics.uncertainty("damping")
    if u > DOUBTFUL_DAMPING * dynamics.damping:
        notes.append(
            f"the damping is hardly identifiable here ({_damping(dynamics)}); forces near the "
            "natural frequency inherit this uncertainty, slow forces do not"
        )
    if table.frequency.max() < dynamics.natural_frequency:
        notes.append(
            f"no point reaches the natural frequency {dynamics.natural_frequency:.4g} Hz (highest: "
            f"{table.frequency.max():.4g} Hz); stiffness and damping are extrapolated"
        )
    return notes
