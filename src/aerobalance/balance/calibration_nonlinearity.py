"""Errors of the loads by the nonlinear part of what a calibration leaves uncertain, as a spectrum.

The error of a balance matrix is a function of the loads. Its linear part stretches and rotates the loads, and the
dynamics are identified from loads that are stretched and rotated as well, so that Eq. (17) of [Gorbushin2020]_ turns
it into the error of a static load. The nonlinear part does not cancel so: under loads that change it is an error with
a spectrum of its own, as wide as that of the loads and wider, which the inverse response amplifies as it does
the loads themselves; and its mean differs from the error at the mean load, as a rectified signal's does.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from aerobalance.balance import _term_kernels as kernels
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.terms import codes
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann
from aerobalance.recording.spread_samples import spread_samples

SEGMENT: Final = 1 << 13
"""Samples at most that a spectrum is taken from at once."""

SEGMENTS: Final = 16
"""Segments at most, spread over the record."""

FITTED: Final = 1 << 13
"""Samples at most that the linear part of the terms is fitted to."""


@dataclass(frozen=True, slots=True, eq=False)
class NonlinearErrors:
    """Spectrum of the errors that the nonlinear part of a matrix's uncertainty leaves in the balance loads.

    Attributes
    ----------
    components
        Names of the c loads.
    frequency
        Frequencies from 0 to half the sampling rate, evenly spaced, shape (m,) [Hz].
    density
        Two-sided cross-spectral density of the errors at the first k of them, shape (k, c, c) [N^2/Hz ...].
    rectified
        Covariance of the mean errors less the errors at the mean loads, shape (c, c) [N^2 ...].
    rate
        Sampling rate [Hz].
    """

    components: tuple[str, ...]
    frequency: Array
    density: Array
    rectified: Array
    rate: float

    @classmethod
    def of(cls, felt: Loads, *, rate: float, highest: float) -> NonlinearErrors:
        """Return the spectrum for the loads of a recording, from the covariance of the matrix.

        Parameters
        ----------
        felt
            The loads, which hold the matrix that they were worked out with.
        rate
            Sampling rate [Hz].
        highest
            Highest frequency that the density is given at [Hz].
        """
        matrix = felt.balance
        native = felt.native[np.isfinite(felt.native).all(axis=1)]
        size = min(SEGMENT // felt.recording.decimated, native.shape[0])
        frequency = np.fft.rfftfreq(size, 1 / rate)
        kept = int(np.searchsorted(frequency, highest, side="right"))
        power = np.zeros((kept, len(matrix.components)))
        count = 0
        for part in _nonlinear_parts(native, matrix, size=size):
            transform = rfft(part, axis=0)[:kept]
            halves = transform.real.copy(), transform.imag.copy()  # two real products for a complex one
            for bridge, covariance in enumerate(matrix.covariance):
                power[:, bridge] += sum(np.einsum("ft,ft->f", half @ covariance, half) for half in halves)
            count += 1
        shift = _rectified(native, matrix)
        held = np.array([shift @ covariance @ shift for covariance in matrix.covariance])
        T = felt.transform @ _to_loads(matrix, np.median(native, axis=0))

        def of_loads(variance: Array) -> Array:
            # the coefficients of all bridges come from the same points, and are correlated as their readings are
            deviation = np.sqrt(np.maximum(variance, 0.0))
            bridges = deviation[..., :, None] * matrix.residual_correlation * deviation[..., None, :]
            return np.asarray(T @ bridges @ T.T, dtype=np.float64)

        return cls(
            components=felt.components,
            frequency=np.asarray(frequency, dtype=np.float64),
            density=of_loads(power / (count * rate)),
            rectified=of_loads(held),
            rate=rate,
        )

    @property
    def resolved(self) -> Array:
        """Frequencies that the density is given at, shape (k,) [Hz]."""
        return self.frequency[: self.density.shape[0]]

    def offset(self, component: str) -> float:
        """Return the standard uncertainty of a force from the mean error less that at the mean load [N, N*m]."""
        place = self.components.index(component)
        return float(np.sqrt(max(self.rectified[place, place], 0.0)))

    def in_force(self, inverse: NDArray[np.complex128], components: list[str]) -> Array:
        """Return the two-sided density of the error of each force beyond that of a static load, (k, n) [N^2/Hz ...].

        Parameters
        ----------
        inverse
            Force over balance load at the frequencies `resolved`, less 1: D s + A s^2, shape (k, n, n).
        components
            Names of these n components.
        """
        places = [self.components.index(name) for name in components]
        own = self.density[:, places][:, :, places]
        return np.real(np.einsum("mij,mjk,mik->mi", inverse, own, inverse.conj()))

    def as_noise(self, density: Array, *, bandwidth: float) -> tuple[float, Array]:
        """Return the standard deviation of an error of this density below a bandwidth, and its spectrum of mean 1."""
        whole = np.zeros(self.frequency.size)
        whole[: density.size] = np.where(self.resolved <= bandwidth, density, 0.0)
        mean = float(np.mean(whole))
        if not mean > 0:
            return 0.0, np.ones(1)
        return float(np.sqrt(mean * self.rate)), whole / mean


def _variables(native: Array, matrix: BalanceMatrix) -> Array:
    """Return the normalised variables of the terms at these loads, shape (n, c)."""
    return native / matrix.load_scale if matrix.way == "iterative" else matrix.outputs(native) / matrix.output_scale


def _rectified(native: Array, matrix: BalanceMatrix) -> Array:
    """Return the mean of the terms less the terms at the mean load, shape (t,)."""
    x = _variables(native[spread_samples(len(native), FITTED)], matrix)
    mean = np.ascontiguousarray(x.mean(axis=0)[None, :])
    terms = codes(matrix.terms)
    found = kernels.design(*terms, np.ascontiguousarray(x)).mean(axis=0) - kernels.design(*terms, mean)[0]
    return np.asarray(found)


def _nonlinear_parts(native: Array, matrix: BalanceMatrix, *, size: int) -> Iterator[Array]:
    """Yield the terms of the matrix less their linear parts, windowed, of segments of the loads, shape (size, t)."""
    x = _variables(native, matrix)
    some = np.ascontiguousarray(x[spread_samples(len(x), FITTED)])
    shapes = _with_one(some)
    rounding = float(np.finfo(np.float64).eps) * len(shapes)
    slopes = np.linalg.pinv(shapes, rcond=rounding) @ kernels.design(*codes(matrix.terms), some)
    window = hann(size)
    window = window / np.sqrt(np.sum(window**2))
    count = min(SEGMENTS, max(2 * (len(x) // size) - 1, 1))
    for start in np.linspace(0, len(x) - size, count).astype(int):
        part = np.ascontiguousarray(x[start : start + size])
        yield (kernels.design(*codes(matrix.terms), part) - _with_one(part) @ slopes) * window[:, None]


def _with_one(x: Array) -> Array:
    return np.column_stack([np.ones(x.shape[0]), x])


def _to_loads(matrix: BalanceMatrix, at: Array) -> Array:
    """Return the error of the loads by the normalised error of each bridge, shape (c, c) [N, N*m]."""
    if matrix.way == "non-iterative":
        return np.diag(matrix.load_scale)
    return np.asarray(matrix.sensitivity(at[None, :])[0] * matrix.output_scale)
