"""Linear regression of a force on measured quantities: static and dynamic derivatives, a polar, the mean of a window.

It is ordinary least squares. The covariance of the coefficients has two parts: the uncertainty of the force, which is
propagated sample by sample, and the scatter of what no regressor explains (buffeting), taken as stationary noise of
any spectrum. That spectrum is estimated from the residual with sine tapers [Riedel1995]_ and corrected for what the
fit has taken out of it at each frequency.

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

from aerobalance.estimation.result import ComponentForce
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

TAPERS: Final = 12
"""Fewest tapers that a spectrum is averaged over: its relative standard uncertainty is then 1 / sqrt(12), or 29 %."""

COLLINEAR: Final = 1e-10
"""Norm of what the regressors before it leave of a regressor, over its own, below which it depends on them [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceRegression:
    """Coefficients of a force on p regressors, with their covariance.

    Attributes
    ----------
    names
        The p regressors.
    values
        Their coefficients, shape (p,) [N or N*m over the unit of the regressor].
    measured
        Covariance from the uncertainty of the force, shape (p, p). It alone counts for what the force was in this
        window, such as its mean there.
    scatter
        Covariance from the parts of the force that no regressor explains and that would differ in another run, shape
        (p, p).
    degrees_of_freedom
        Of the standard uncertainties, shape (p,), by Welch and Satterthwaite: `measured` counts as known exactly,
        `scatter` is estimated from the record.
    residual
        What the regressors do not explain in the window, shape (n,) [N, N*m].
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
        """Standard uncertainty of the coefficients of the force as it was in this window, shape (p,)."""
        return np.sqrt(np.diag(self.measured))

    def of(self, name: str) -> tuple[float, float]:
        """Return the coefficient of a regressor and its standard uncertainty.

        Raises
        ------
        ValueError
            There is no such regressor.
        """
        if name not in self.names:
            raise ValueError(f"no regressor {name}; there are {', '.join(self.names)}")
        place = self.names.index(name)
        return float(self.values[place]), float(self.uncertainty[place])


def regress(
    estimate: ComponentForce, regressors: Mapping[str, ArrayLike], *, span: slice = slice(None)
) -> ForceRegression:
    """Return the coefficients of a force on regressors, by least squares [N or N*m over the unit of the regressor].

    Parameters
    ----------
    estimate
        The force.
    regressors
        By name, the values at every sample of the force, shape (n,), or one value for all of them; a coefficient is in
        the unit of the force over that of its regressor. A constant must be among them if the force has one. They are
        taken as known exactly.
    span
        The window of samples to use, a slice without a step; all of them if left out.

    Raises
    ------
    ValueError
        A regressor has another shape or is not finite, or the span has a step.
    FitError
        The regressors are linearly dependent in the window, or too many for its samples.
    """
    first, stop, step = span.indices(estimate.values.size)
    if step != 1 or not regressors:
        raise ValueError(
            f"regress needs at least one regressor and a span of consecutive samples, not {len(regressors)} and {span}"
        )
    span_ = slice(first, stop)
    columns = np.column_stack([_column(name, values, estimate, span_) for name, values in regressors.items()])
    force, tapers = estimate.values[first:stop], max(TAPERS, 2 * columns.shape[1])
    if not np.isfinite(force).all():
        raise FitError(
            f"{np.count_nonzero(~np.isfinite(force))} samples of {estimate.component} have no force in this span; "
            "choose one without them"
        )
    if force.size < 4 * tapers:
        raise FitError(
            f"{force.size} samples of {estimate.component} are too few for {columns.shape[1]} regressors; use a span "
            f"of at least {4 * tapers}"
        )
    basis, weights = _least_squares(columns, tuple(regressors))
    values = weights @ force
    residual = force - columns @ values
    scatter, freedom = _scatter(weights, residual, basis=basis, tapers=tapers)
    over_record = np.zeros((weights.shape[0], estimate.values.size))
    over_record[:, first:stop] = weights
    none = np.zeros_like(scatter)
    measured = sum((part.covariance_of(over_record) for part in estimate.contributions), none)
    share = np.diag(scatter) / np.maximum(np.diag(measured + scatter), np.finfo(float).tiny)
    return ForceRegression(
        names=tuple(regressors),
        values=values,
        measured=measured,
        scatter=scatter,
        degrees_of_freedom=freedom / np.maximum(share, 1e-9) ** 2,  # Welch-Satterthwaite
        residual=residual,
    )


def _noise_covariance(weights: Array, density: Array) -> Array:
    """Return the covariance of weighted sums of a noise, shape (p, p).

    Its density is given at n + 1 frequencies from 0 to half the sampling rate, and is 1 for white noise of variance 1.
    """
    count = 2 * weights.shape[1]
    lines = np.fft.rfft(weights, count, axis=1)
    power = density / count
    power[1:-1] *= 2
    return np.asarray(np.real((lines * power) @ lines.conj().T))


def _column(name: str, values: ArrayLike, estimate: ComponentForce, span: slice) -> Array:
    """Return one regressor at every sample of a span, shape (m,)."""
    column = np.asarray(values, dtype=np.float64)
    if column.shape not in ((), estimate.values.shape):
        raise ValueError(f"regressor {name} must have shape {estimate.values.shape}, not {column.shape}")
    own = np.broadcast_to(column, estimate.values.shape)[span]
    if not np.isfinite(own).all():
        raise ValueError(f"regressor {name} is not finite everywhere; choose a span without such samples")
    return own


def _least_squares(columns: Array, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Return an orthonormal basis of the regressors, shape (n, p), and the weights of the coefficients, (p, n)."""
    size = np.linalg.norm(columns, axis=0)
    basis, triangle = np.linalg.qr(columns / np.where(size > 0, size, 1.0))
    independent = np.abs(np.diag(triangle))
    if independent.min() < COLLINEAR:
        worst = names[int(np.argmin(independent))]
        raise FitError(
            f"regressor {worst} is zero or a linear combination of those before it in this span, so its coefficient "
            "cannot be determined; leave it out or use a span where it varies on its own"
        )
    return basis, np.linalg.solve(triangle, basis.T) / size[:, None]


def _scatter(weights: Array, residual: Array, *, basis: Array, tapers: int) -> tuple[Array, Array]:
    """Return the covariance of the coefficients from the residual, and the degrees of freedom of each.

    The residual is noise of the spectrum that it shows. Where it is level over the band of the tapers, the fit leaves
    of its power at a frequency the part 1 less that of the tapered basis there; the sum over the tapers is divided by
    what it leaves. The tapers are orthonormal, so p regressors take p of them at most, half of all.
    """
    samples = residual.size
    place = np.arange(1, samples + 1) * np.pi / (samples + 1)
    power, remaining = np.zeros((2, samples + 1))
    for order in range(1, tapers + 1):
        taper = np.sqrt(2 / (samples + 1)) * np.sin(order * place)
        power += np.abs(np.fft.rfft(residual * taper, 2 * samples)) ** 2
        of_basis = np.abs(np.fft.rfft(basis * taper[:, None], 2 * samples, axis=0)) ** 2
        remaining += 1 - of_basis.sum(axis=1)
    density = power / remaining
    # near 0 and half the rate every taper's value is real, or a pair of frequencies holds the same information
    lines = np.arange(samples + 1)
    edge = np.minimum(lines, samples - lines) < tapers
    freedom = np.maximum(np.where(edge, remaining, 2 * remaining), 1.0)
    share = np.abs(np.fft.rfft(weights, 2 * samples, axis=1)) ** 2 * density
    total = share.sum(axis=1)
    loss = np.where(total > 0, (share / freedom).sum(axis=1) / np.where(total > 0, total, 1.0), 1.0)
    return _noise_covariance(weights, density), np.asarray(1 / loss)
