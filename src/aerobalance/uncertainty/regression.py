"""A force as a sum of what moves with it: static and dynamic derivatives, a polar, the mean of a stretch.

Ordinary least squares on the force, with the uncertainty of the force carried through sample by sample, and with what
the regressors leave over (buffeting) taken as noise of whatever spectrum it shows. Its spectrum is judged with sine
tapers [Riedel1995]_ around each frequency; what the fit has taken away there is given back.

References
----------
.. [Riedel1995] K. S. Riedel, A. Sidorenko, "Minimum bias multiple taper spectral estimation", IEEE Trans. Signal
   Process. 43 (1995) 188.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.estimation.error_sources import Contribution, Systematic
from aerobalance.estimation.result import ComponentForce
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

TAPERS: Final = 12
"""Fewest tapers that a spectrum is averaged over: it is then known to 1 / sqrt(12), or 29 %, on its own."""

ALIKE: Final = 1e-10
"""Part of a regressor that the others do not explain, below which they are taken to explain it all [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """A force as a sum of regressors, each with its coefficient.

    Attributes
    ----------
    names
        The p regressors.
    values
        Their coefficients, shape (p,) [N over the unit of the regressor].
    measured
        Covariance because the force is uncertain, shape (p, p). It alone counts for what the force was in this
        stretch, such as its mean there.
    scatter
        Covariance because the force has parts that no regressor explains and that would be others in another run,
        shape (p, p).
    degrees_of_freedom
        Of the standard uncertainties, shape (p,): `measured` counts as known exactly, `scatter` is judged from the
        record.
    residual
        What the regressors do not explain, over the stretch, shape (n,) [N].
    """

    names: tuple[str, ...]
    values: Array
    measured: Array
    scatter: Array
    degrees_of_freedom: Array
    residual: Array

    @property
    def covariance(self) -> Array:
        """Covariance of the coefficients, shape (p, p)."""
        return self.measured + self.scatter

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainty of the coefficients, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def measured_uncertainty(self) -> Array:
        """Standard uncertainty of the coefficients of the force as it was in this stretch, shape (p,)."""
        return np.sqrt(np.diag(self.measured))

    def of(self, name: str) -> tuple[float, float]:
        """Coefficient of a regressor and its standard uncertainty.

        Raises
        ------
        ValueError
            There is no such regressor.
        """
        if name not in self.names:
            raise ValueError(f"no regressor {name}; there are {', '.join(self.names)}")
        place = self.names.index(name)
        return float(self.values[place]), float(self.uncertainty[place])


def regress(estimate: ComponentForce, regressors: Mapping[str, ArrayLike], *, span: slice = slice(None)) -> Regression:
    """Write a force as a sum of regressors by least squares.

    Parameters
    ----------
    estimate
        The force.
    regressors
        What it goes with, by name: values at every sample of the force, shape (n,), or one for all of them. A constant
        must be among them if the force has one. They are taken as known exactly.
    span
        The samples to use, a slice without a step; all of them if left out.

    Raises
    ------
    ValueError
        A regressor has another shape or is not finite, or the span has a step.
    FitError
        The regressors are alike, or too many for the samples.
    """
    first, stop, step = span.indices(estimate.values.size)
    if step != 1 or not regressors:
        raise ValueError("regress needs a regressor, and a span of neighbouring samples")
    columns = np.column_stack([_column(name, values, estimate)[first:stop] for name, values in regressors.items()])
    force, tapers = estimate.values[first:stop], max(TAPERS, 2 * columns.shape[1])
    if force.size < 4 * tapers:
        raise FitError(
            f"{force.size} samples of {estimate.component} are too few for {columns.shape[1]} regressors; take a span "
            f"of at least {4 * tapers}"
        )
    basis, weights = _solved(columns, tuple(regressors))
    values = weights @ force
    residual = force - columns @ values
    scatter, freedom = _scatter(weights, residual, basis=basis, tapers=tapers)
    whole = np.zeros((weights.shape[0], estimate.values.size))
    whole[:, first:stop] = weights
    none = np.zeros_like(scatter)
    measured = sum((covariance_of(part, whole) for part in estimate.contributions), none)
    share = np.diag(scatter) / np.maximum(np.diag(measured + scatter), np.finfo(float).tiny)
    return Regression(
        names=tuple(regressors),
        values=values,
        measured=measured,
        scatter=scatter,
        degrees_of_freedom=freedom / np.maximum(share, 1e-9) ** 2,  # Welch-Satterthwaite
        residual=residual,
    )


def covariance_of(part: Contribution, weights: Array) -> Array:
    """Covariance that a contribution gives to weighted sums of the samples, shape (p, p).

    Parameters
    ----------
    part
        One contribution to the uncertainty of a force.
    weights
        Of the p sums, shape (p, n).
    """
    if isinstance(part, Systematic):
        gradient = weights @ part.slopes
        return np.asarray(gradient @ part.covariance @ gradient.T)
    count = 2 * weights.shape[1]  # as in the variance of one sum: the record's end does not touch its beginning
    return _under(weights * part.deviation, part.relative_density(count // 2 + 1))


def _under(weights: Array, density: Array) -> Array:
    """Covariance of sums of a noise, shape (p, p), by its density at m = n + 1 frequencies, 1 for a white one of 1."""
    count = 2 * weights.shape[1]
    lines = np.fft.rfft(weights, count, axis=1)
    power = density / count
    power[1:-1] *= 2
    return np.asarray(np.real((lines * power) @ lines.conj().T))


def _column(name: str, values: ArrayLike, estimate: ComponentForce) -> Array:
    """One regressor, checked."""
    column = np.asarray(values, dtype=np.float64)
    if column.shape not in ((), estimate.values.shape):
        raise ValueError(f"regressor {name} must have shape {estimate.values.shape}, not {column.shape}")
    if not np.isfinite(column).all():
        raise ValueError(f"regressor {name} is not finite everywhere; leave such samples out by a span")
    return np.broadcast_to(column, estimate.values.shape)


def _solved(columns: Array, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Orthonormal basis of the regressors, shape (n, p), and the weights that give the coefficients, (p, n)."""
    size = np.linalg.norm(columns, axis=0)
    basis, triangle = np.linalg.qr(columns / np.where(size > 0, size, 1.0))
    alone = np.abs(np.diag(triangle))
    if alone.min() < ALIKE:
        worst = names[int(np.argmin(alone))]
        raise FitError(
            f"regressor {worst} is zero, or a sum of those before it, in this span, so its coefficient cannot be "
            "told; leave it out or take a span where it moves on its own"
        )
    return basis, np.linalg.solve(triangle, basis.T) / size[:, None]


def _scatter(weights: Array, residual: Array, *, basis: Array, tapers: int) -> tuple[Array, Array]:
    """Covariance that the residual, as noise of its spectrum, gives to the sums, and the degrees of freedom of each.

    Where the residual's own spectrum is level over the tapers' band, the expected power that the fit has left of it is
    1 less what the tapered basis holds at that frequency; the sum over the tapers is divided by what is left. The
    tapers are orthonormal, so p regressors hold p of them at most, half of all.
    """
    samples = residual.size
    place = np.arange(1, samples + 1) * np.pi / (samples + 1)
    power, left = np.zeros((2, samples + 1))
    for order in range(1, tapers + 1):
        taper = np.sqrt(2 / (samples + 1)) * np.sin(order * place)
        power += np.abs(np.fft.rfft(residual * taper, 2 * samples)) ** 2
        held = np.abs(np.fft.rfft(basis * taper[:, None], 2 * samples, axis=0)) ** 2
        left += 1 - held.sum(axis=1)
    density = power / left
    # near zero (and half the rate) every taper's value is real, or a pair of frequencies tells the same
    lines = np.arange(samples + 1)
    edge = np.minimum(lines, samples - lines) < tapers
    freedom = np.maximum(np.where(edge, left, 2 * left), 1.0)
    share = np.abs(np.fft.rfft(weights, 2 * samples, axis=1)) ** 2 * density
    total = share.sum(axis=1)
    loss = np.where(total > 0, (share / freedom).sum(axis=1) / np.where(total > 0, total, 1.0), 1.0)
    return _under(weights, density), np.asarray(1 / loss)
