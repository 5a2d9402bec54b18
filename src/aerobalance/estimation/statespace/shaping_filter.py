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
.. [Kung1978] S. Kung, "A new identification and model reduction algorithm via singular value decomposition",
   Proc. 12th Asilomar Conf. Circuits, Systems and Computers (1978) 705.
.. [Oppenheim1989] A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", Prentice-Hall (1989), ch. 12.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import solve_continuous_lyapunov
from scipy.ndimage import maximum_filter1d

from aerobalance.recording.channel import Array

STATES: Final = 32
"""Most states; a band with edges as sharp as `EDGE` needs 16 to 32, the stronger over the noise the more."""

EDGE: Final = 0.007
"""Width in angle that a sharp edge is given, outward, so that few states can follow it [rad]; 0.7 % in frequency."""

CIRCLE: Final = 1 << 14
"""Points on the unit circle."""

MEMORY: Final = 4096
"""Samples of the impulse response over the bent clock that the states are to reproduce."""

NEGLIGIBLE: Final = 1e-8
"""Singular value over the largest below which a state is left out."""


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
        poles, modes = np.linalg.eig(self.drift)
        residues = modes[0] * np.linalg.solve(modes, self.drive.astype(np.complex128))
        transfer = np.sum(residues / (2j * np.pi * np.asarray(frequency)[..., None] - poles), axis=-1)
        return np.asarray(np.abs(transfer) ** 2)


def _bent_frequencies(centre: float) -> Array:
    """Frequencies of the upper half of the circle [Hz], shape (CIRCLE / 2 + 1,)."""
    angle = np.linspace(0, np.pi, CIRCLE // 2 + 1)
    angle[-1] -= 1e-9
    return np.asarray(centre * np.tan(angle / 2))


def _widened(level: Array) -> Array:
    """Logarithm of a spectrum with its edges moved outward and made `EDGE` wide."""
    reach = max(1, round(EDGE / np.pi * (CIRCLE // 2)))
    whole = np.concatenate([level, level[-2:0:-1]])
    whole = maximum_filter1d(whole, 2 * reach + 1, mode="wrap")
    weights = np.hanning(2 * reach + 3)[1:-1]
    kernel = np.roll(np.pad(weights / weights.sum(), (0, CIRCLE - weights.size)), -reach)
    return np.fft.irfft(np.fft.rfft(whole) * np.fft.rfft(kernel), CIRCLE)


def _minimum_phase(level: Array) -> Array:
    """Impulse response of the minimum-phase factor of a spectrum, from its cepstrum [Oppenheim1989]_."""
    cepstrum = np.fft.ifft(level).real / 2
    cepstrum[1 : CIRCLE // 2] *= 2
    cepstrum[CIRCLE // 2 + 1 :] = 0
    return np.asarray(np.fft.ifft(np.exp(np.fft.fft(cepstrum))).real)


def _balanced(response: Array, tolerance: float) -> tuple[Array, Array, Array]:
    """Balanced realisation A, B, C of an impulse response [Kung1978]_; what passes at once is left out.

    The leading singular vectors of the Hankel matrix are found by subspace iteration, its products by convolution.
    """
    spectrum = np.fft.rfft(response[1 : 2 * MEMORY], 4 * MEMORY)[:, None]

    def hankel(columns: Array) -> Array:
        product = np.fft.irfft(spectrum * np.fft.rfft(columns[::-1], 4 * MEMORY, axis=0), axis=0)
        return np.asarray(product[MEMORY - 1 : 2 * MEMORY - 1])

    basis = np.random.default_rng(0).normal(size=(MEMORY, STATES + 8))  # any start will do; always the same
    for _ in range(3):
        basis = np.linalg.qr(hankel(basis))[0]  # the matrix is symmetric
    left, singular, right = np.linalg.svd(hankel(basis).T, full_matrices=False)
    # the error is at most twice the sum of the singular values left out [Glover1984]_
    bound = 2 * np.cumsum(singular[::-1])[::-1]
    kept = int(np.count_nonzero((bound > tolerance) & (singular > NEGLIGIBLE * singular[0])))
    kept = min(max(kept, 1), STATES)
    root = np.sqrt(singular[:kept])
    left = basis @ left[:, :kept]
    A = (left[:-1].T @ left[1:]) / root[:, None] * root
    return A, root * right[:kept, 0], left[0] * root
