"""What is not known of the curvature of a balance matrix, in a force that changes fast.

The error of a matrix is a function of the loads felt. As far as it is linear it stretches and turns the loads, and the
dynamics are identified from loads that are stretched and turned as well, so that Eq. (17) of [Gorbushin2020]_ makes
the error of a static load of it. The rest is curved: under loads that change it is an error with a spectrum of its
own, as wide as that of the loads and wider, to which D e' + A e'' belong as to the loads themselves, and its mean is
not that of the mean load.

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
from scipy.signal.windows import hann

from aerobalance.balance import _term_kernels as kernels
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.terms import codes
from aerobalance.recording.channel import Array

SEGMENT: Final = 1 << 13
"""Samples at most that a spectrum is taken from at once."""

SEGMENTS: Final = 16
"""Segments at most, spread over the record."""

FITTED: Final = 20_000
"""Samples at most by which the linear part of the terms is found."""


@dataclass(frozen=True, slots=True, eq=False)
class CurvatureErrors:
    """Spectrum of the errors that the curvature of a matrix leaves in loads felt.

    Attributes
    ----------
    components
        Names of the c loads.
    frequency
        Frequencies from 0 to half the sampling rate, evenly spaced, shape (m,) [Hz].
    density
        Two-sided cross spectral densities of the loads' errors at the first k of them, shape (k, c, c) [N^2/Hz ...].
    rectified
        Covariance of the mean errors, less those at the mean loads, shape (c, c) [N^2 ...].
    rate
        Sampling rate [Hz].
    """

    components: tuple[str, ...]
    frequency: Array
    density: Array
    rectified: Array
    rate: float

    @classmethod
    def of(cls, felt: Loads, *, rate: float, highest: float) -> CurvatureErrors:
        """Work it out from the covariance of the matrix and the loads of a recording, shape (n, c).

        Parameters
        ----------
        felt
            The loads, which hold the matrix that they were worked out with.
        rate
            Sampling rate [Hz].
        highest
            Frequency above which nothing is wanted [Hz].
        """
        matrix = felt.balance
        native = felt.native[np.isfinite(felt.native).all(axis=1)]
        size = min(SEGMENT, native.shape[0])
        frequency = np.fft.rfftfreq(size, 1 / rate)
        kept = int(np.searchsorted(frequency, highest, side="right"))
        power = np.zeros((kept, len(matrix.components)))
        count = 0
        for part in _curved_parts(native, matrix, size=size):
            transform = np.fft.rfft(part, axis=0)[:kept]
            for bridge, covariance in enumerate(matrix.covariance):
                power[:, bridge] += np.real(np.sum((transform @ covariance) * transform.conj(), axis=1))
            count += 1
        shift = _rectified(native, matrix)
        held = np.array([shift @ covariance @ shift for covariance in matrix.covariance])
        T = felt.transform @ _to_loads(matrix, np.median(native, axis=0))

        def of_loads(variance: Array) -> Array:
            # the coefficients of all bridges come from the same points, and go together as their readings do
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
        """Standard uncertainty of a force from the mean of the errors, beyond that at the mean load [N, N*m]."""
        place = self.components.index(component)
        return float(np.sqrt(max(self.rectified[place, place], 0.0)))

    def in_force(self, ringing: NDArray[np.complex128], components: list[str]) -> Array:
        """Two-sided densities of what a force gets beyond the error of a static load, shape (k, n) [N^2/Hz ...].

        Parameters
        ----------
        ringing
            Force over load felt at the frequencies `resolved`, less 1: D s + A s^2, shape (k, n, n).
        components
            Names of these n components.
        """
        places = [self.components.index(name) for name in components]
        own = self.density[:, places][:, :, places]
        return np.real(np.einsum("mij,mjk,mik->mi", ringing, own, ringing.conj()))

    def as_noise(self, density: Array, *, bandwidth: float) -> tuple[float, Array]:
        """Standard deviation of an error with such a density, and its spectrum with mean 1, cut off at a bandwidth."""
        whole = np.zeros(self.frequency.size)
        whole[: density.size] = np.where(self.resolved <= bandwidth, density, 0.0)
        mean = float(np.mean(whole))
        if not mean > 0:
            return 0.0, np.ones(1)
        return float(np.sqrt(mean * self.rate)), whole / mean


def _variables(native: Array, matrix: BalanceMatrix) -> Array:
    """What the terms are made of at these loads, shape (n, c)."""
    return native / matrix.load_scale if matrix.way == "iterative" else matrix.outputs(native) / matrix.output_scale


def _rectified(native: Array, matrix: BalanceMatrix) -> Array:
    """Mean of the terms less what they are at the mean, shape (t,)."""
    x = _variables(native[:: max(len(native) // FITTED, 1)], matrix)
    mean = np.ascontiguousarray(x.mean(axis=0)[None, :])
    terms = codes(matrix.terms)
    found = kernels.design(*terms, np.ascontiguousarray(x)).mean(axis=0) - kernels.design(*terms, mean)[0]
    return np.asarray(found)


def _curved_parts(native: Array, matrix: BalanceMatrix, *, size: int) -> Iterator[Array]:
    """Terms of the matrix less their linear parts, windowed, of some segments of the loads, shape (size, t)."""
    x = _variables(native, matrix)
    some = np.ascontiguousarray(x[:: max(len(x) // FITTED, 1)])
    slopes = np.linalg.lstsq(_with_one(some), kernels.design(*codes(matrix.terms), some), rcond=None)[0]
    window = hann(size, sym=False)
    window /= np.sqrt(np.sum(window**2))
    count = min(SEGMENTS, max(2 * (len(x) // size) - 1, 1))
    for start in np.linspace(0, len(x) - size, count).astype(int):
        part = np.ascontiguousarray(x[start : start + size])
        yield (kernels.design(*codes(matrix.terms), part) - _with_one(part) @ slopes) * window[:, None]


def _with_one(x: Array) -> Array:
    return np.column_stack([np.ones(x.shape[0]), x])


def _to_loads(matrix: BalanceMatrix, at: Array) -> Array:
    """Error of loads by the error of each column of the matrix, scaled, shape (c, c) [N, N*m]."""
    if matrix.way == "non-iterative":
        return np.diag(matrix.load_scale)
    return np.asarray(matrix.sensitivity(at[None, :])[0] * matrix.output_scale)
