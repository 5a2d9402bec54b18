r"""Shaping filter: white noise into a process of a given spectrum, with few states.

A spectrum is factored into a transfer function that is stable and of minimum phase (from its cepstrum), and the
factor is cut to the states that matter (balanced truncation, from the singular values of its Hankel matrix). Both are
done on the unit circle that frequency is bent on to, f = f_w tan(theta / 2), and bent back exactly; so the result is a
system in continuous time, of a spectrum that is right at all frequencies, and its order does not depend on the
sampling rate.

References
----------
.. [Glover1984] K. Glover, "All optimal Hankel-norm approximations of linear multivariable systems and their
   L-infinity error bounds", Int. J. Control 39 (1984) 1115.
.. [Golub1996] G. H. Golub, C. F. Van Loan, "Matrix Computations", 3rd ed., Johns Hopkins (1996), ch. 9.
.. [Kung1978] S. Kung, "A new identification and model reduction algorithm via singular value decomposition",
   Proc. 12th Asilomar Conf. Circuits, Systems and Computers (1978) 705.
.. [Oppenheim1989] A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", Prentice-Hall (1989), ch. 12.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft
from scipy.linalg import eigh_tridiagonal, solve_continuous_lyapunov

from aerobalance.recording.channel import Array

STATES: Final = 32
"""Most states; a band with edges as sharp as `EDGE` needs 16 to 32, the stronger over the noise the more."""

EDGE: Final = 0.007
"""Width in angle that a sharp edge is given, outward, so that few states can follow it [rad]; 0.7 % in frequency."""

CIRCLE: Final = 1 << 14
"""Points on the unit circle."""

MEMORY: Final = 4096
"""Samples of the past over the bent clock that the states are to reproduce at most: half of the impulse response."""

SHORTEST: Final = 128
"""Samples of it at least."""

NEGLIGIBLE: Final = 1e-8
"""Singular value over the largest below which a state is left out."""

CUT: Final = 0.05
"""Error over the tolerance that cutting the impulse response may make."""

SETTLED: Final = 0.01
"""Size over the tolerance of what one more step of the iteration would bring, at which it ends."""

BEYOND: Final = 16
"""Steps of the iteration at most, beyond the most states."""


@dataclass(frozen=True, slots=True, eq=False)
class ShapingFilter:
    """A linear system x' = A x + B w that makes a process F = x[0] out of white noise w of density 1.

    Attributes
    ----------
    drift
        A, shape (r, r) [1/s].
    drive
        B, shape (r,).
    """

    drift: Array
    drive: Array

    @classmethod
    def silent(cls) -> ShapingFilter:
        """The process that is zero."""
        return cls(np.array([[-1.0]]), np.zeros(1))

    @classmethod
    def of_spectrum(cls, density: Callable[[Array], Array], *, centre: float, tolerance: float = 0.0) -> ShapingFilter:
        """Approximate a spectrum.

        Parameters
        ----------
        density
            Two-sided power spectral density at frequencies [Hz] from 0 up; positive, falling to nothing.
        centre
            Frequency f_w at which the resolution is best [Hz]: where the spectrum's sharpest edge is.
        tolerance
            Error of the square root of the density that fewer states may make [N/sqrt(Hz)].
        """
        response = _minimum_phase(_widened(np.log(density(_bent_frequencies(centre)))))
        A, B, C = _balanced(response, tolerance)
        # z = (1 + s) / (1 - s), s in units of the centre's angular frequency
        back = np.linalg.inv(np.eye(A.shape[0]) + A)
        unit = 2 * np.pi * centre
        drift, drive, row = unit * back @ (A - np.eye(A.shape[0])), np.sqrt(2 * unit) * back @ B, C @ back
        row = row * np.sqrt(2 * unit)
        # turned so that the process is the first state, and all states are in its unit
        size = float(np.linalg.norm(row))
        mirror = row / size
        mirror = mirror + np.copysign(1.0, mirror[0]) * np.eye(row.size)[0]
        turn = np.eye(row.size) - 2 * np.outer(mirror, mirror) / (mirror @ mirror)
        sign = -np.copysign(1.0, row[0])
        return cls(turn @ drift @ turn, sign * size * (turn @ drive))

    @property
    def order(self) -> int:
        """Number of states."""
        return self.drive.size

    @property
    def covariance(self) -> Array:
        """Stationary covariance of the states, shape (r, r)."""
        P = solve_continuous_lyapunov(self.drift, -np.outer(self.drive, self.drive))
        return np.asarray((P + P.T) / 2)

    def spectrum(self, frequency: Array) -> Array:
        """Two-sided power spectral density of the process at frequencies [Hz], [N^2/Hz]."""
        if not self.drive.any():
            return np.zeros(np.shape(frequency))
        poles, residues = _partial_fractions(self)
        transfer = np.sum(residues / (2j * np.pi * np.asarray(frequency)[..., None] - poles), axis=-1)
        return np.asarray(np.abs(transfer) ** 2)


@lru_cache(maxsize=32)  # what was learned of a record's components is asked for at many frequencies
def _partial_fractions(shaping: ShapingFilter) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Poles [rad/s] and residues of a shaping filter, shape (r,) each."""
    poles, modes = np.linalg.eig(shaping.drift)
    residues = modes[0] * np.linalg.solve(modes, shaping.drive.astype(np.complex128))
    return poles.astype(np.complex128), residues


def _bent_frequencies(centre: float) -> Array:
    """Frequencies of the upper half of the circle [Hz], shape (CIRCLE / 2 + 1,)."""
    angle = np.linspace(0, np.pi, CIRCLE // 2 + 1)
    angle[-1] -= 1e-9
    return np.asarray(centre * np.tan(angle / 2))


def _widened(level: Array) -> Array:
    """Logarithm of a spectrum with its edges moved outward and made `EDGE` wide."""
    reach = max(1, round(EDGE / np.pi * (CIRCLE // 2)))
    whole = np.concatenate([level, level[-2:0:-1]])
    span = 1  # the largest of so many neighbours, doubled: 30 ms less to load than a filter of images
    while 2 * span <= 2 * reach + 1:
        whole, span = np.maximum(whole, np.roll(whole, span)), 2 * span
    whole = np.roll(np.maximum(whole, np.roll(whole, 2 * reach + 1 - span)), -reach)
    weights = np.hanning(2 * reach + 3)[1:-1]
    kernel = np.roll(np.pad(weights / weights.sum(), (0, CIRCLE - weights.size)), -reach)
    return np.asarray(irfft(rfft(whole) * rfft(kernel)))


def _minimum_phase(level: Array) -> Array:
    """Impulse response of the minimum-phase factor of a spectrum, from its cepstrum [Oppenheim1989]_."""
    cepstrum = irfft(level[: CIRCLE // 2 + 1]) / 2
    cepstrum[1 : CIRCLE // 2] *= 2
    cepstrum[CIRCLE // 2 + 1 :] = 0
    return np.asarray(irfft(np.exp(rfft(cepstrum))))


def _balanced(response: Array, tolerance: float) -> tuple[Array, Array, Array]:
    """Balanced realisation A, B, C of an impulse response [Kung1978]_; what passes at once is left out.

    The Hankel matrix is symmetric; its leading eigenvectors come from Lanczos' iteration, its products by convolution
    [Golub1996]_.
    """
    basis, diagonal, beside = _krylov(response, tolerance)
    values, vectors = eigh_tridiagonal(diagonal, beside)
    order = np.argsort(-np.abs(values))
    values, vectors = values[order], vectors[:, order]
    singular, sign = np.abs(values), np.sign(values)
    # the error is at most twice the sum of the singular values left out [Glover1984]_
    bound = 2 * np.cumsum(singular[::-1])[::-1]
    kept = int(np.count_nonzero((bound > tolerance) & (singular > NEGLIGIBLE * singular[0])))
    kept = min(max(kept, 1), STATES)
    # the basis begins with the first sample, so that the first row of the singular vectors is that of `vectors`; each
    # of them has a free sign, which is chosen so that rounding does not
    vectors, sign, root = vectors[:, :kept], sign[:kept], np.sqrt(singular[:kept])
    vectors = vectors * np.copysign(1.0, vectors[0])
    A = (vectors.T @ (basis[:, :-1] @ basis[:, 1:].T) @ vectors) / root[:, None] * root
    return A, root * sign * vectors[0], vectors[0] * root


def _krylov(response: Array, tolerance: float) -> tuple[Array, Array, Array]:
    """Lanczos' iteration on the Hankel matrix of an impulse response, from the first sample on.

    Returns
    -------
    basis, diagonal, beside
        Orthonormal rows (k, m), and the matrix in their terms: its diagonal (k,) and what is beside it (k - 1,).
    """
    limit = max(tolerance, NEGLIGIBLE * float(np.sum(np.abs(response))))
    after = np.cumsum(np.abs(response[::-1]))[::-1]
    memory = SHORTEST
    while memory < MEMORY and after[2 * memory] > CUT * limit:
        memory *= 2
    # a Hankel matrix of 2 m - 1 samples is part of a circulant of size 2 m; NumPy's transforms write where told
    spectrum = np.fft.rfft(np.append(response[1 : 2 * memory], 0.0))
    most = STATES + BEYOND
    basis = np.zeros((most, memory))
    basis[0, 0] = 1.0
    diagonal, beside = np.zeros(most), np.zeros(most)
    padded, lines, product = np.zeros(2 * memory), np.empty_like(spectrum), np.empty(2 * memory)
    row = product[memory - 1 : 2 * memory - 1]
    for last in range(most):
        own = basis[last]
        padded[:memory] = own[::-1]
        np.fft.rfft(padded, out=lines)
        lines *= spectrum
        np.fft.irfft(lines, out=product)
        diagonal[last] = own @ row
        row -= diagonal[last] * own
        if last:
            row -= beside[last - 1] * basis[last - 1]
        # rounding brings the older rows back
        known = basis[: last + 1]
        row -= (known @ row) @ known
        beside[last] = np.sqrt(row @ row)
        if last + 1 == most or np.max(beside[max(last - 1, 0) : last + 1]) < SETTLED * limit:
            break
        np.divide(row, beside[last], out=basis[last + 1])
    return basis[: last + 1], diagonal[: last + 1], beside[:last]
