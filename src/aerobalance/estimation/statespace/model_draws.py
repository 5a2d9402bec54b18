"""Draws of a force and of readings of it from the very model that the smoother takes for true.

Both are stationary, so their Fourier coefficients are independent: their spectra follow from the covariances, exactly,
and a draw is two random numbers a sample and two transforms [Dietrich1997]_, however many states there are. The free
oscillation under way at the start is added.

References
----------
.. [Dietrich1997] C. R. Dietrich, G. N. Newsam, "Fast and exact simulation of stationary Gaussian processes through
   circulant embedding of the covariance matrix", SIAM J. Sci. Comput. 18 (1997) 1088.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from aerobalance.estimation.statespace import _kernels
from aerobalance.estimation.statespace.blocks import BLOCK, WIDTH, powers_of
from aerobalance.estimation.statespace.kalman import FORCE, StateSpace
from aerobalance.recording.channel import Array

FORGOTTEN: Final = 1e-3
"""Correlation between the end of a draw and its start that is let stand."""

NO_SWING: Final = 1e-9
"""Variance at the start over that of the stationary state, less one, which is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelDraws:
    """What draws forces, without constant and steps, and readings of them.

    Attributes
    ----------
    present
        False where a reading is missing, shape (n,).
    length
        Samples after which a draw repeats itself.
    reading, shared, own
        Weights of Fourier coefficients: of the reading, of the force by the same random numbers, and of the force by
        others, shape (length // 2 + 1,) [N].
    swings
        Reading of the free oscillations at the start, each of one standard deviation, shape (any, n) [N].
    stationary
        Covariance of a state long after the start, shape (d, d).
    """

    present: NDArray[np.bool_]
    length: int
    reading: Array
    shared: NDArray[np.complex128]
    own: Array
    swings: Array
    stationary: Array

    @classmethod
    def of(cls, system: StateSpace, present: NDArray[np.bool_]) -> ModelDraws:
        """Return those of a state space."""
        count, size = present.size, system.transition.shape[0]
        P, reach = _stationary(system, most=count)
        rows = np.vstack([system.observation, np.eye(size)[FORCE]])
        length = next_fast_len(count + reach, real=True)
        # of a draw that repeats itself, each lag has what belongs to those of whole lengths more
        wrapped = np.linalg.solve(np.eye(size) - np.linalg.matrix_power(system.transition, length), P)
        G = rfft(_released(system, wrapped @ rows.T, rows, length), axis=2)
        at_once = rows @ P @ rows.T
        felt = np.maximum(2 * G[0, 0].real - at_once[0, 0], 0.0)
        reading = np.sqrt(felt + system.noise_variance)
        shared = np.divide(
            G[1, 0] + G[0, 1].conj() - at_once[1, 0], reading, out=np.zeros_like(G[0, 0]), where=reading > 0
        )
        own = np.sqrt(np.maximum(2 * G[1, 1].real - at_once[1, 1] - np.abs(shared) ** 2, 0.0))
        weight = np.full(felt.size, np.sqrt(length / 2))
        weight[0] *= np.sqrt(2)  # real ones
        weight[-1] *= np.sqrt(2) if length % 2 == 0 else 1.0
        more = np.diag(system.initial) - np.diag(P)
        swinging = np.flatnonzero(more > NO_SWING * np.diag(P))
        columns = np.eye(size)[:, swinging] * np.sqrt(more[swinging])
        return cls(
            present,
            length,
            weight * reading,
            weight * shared,
            weight * own,
            _released(system, columns, rows[:1], count)[0],
            P,
        )

    @property
    def untold_variance(self) -> float:
        """Variance of the force that all readings together, before and after the record too, leave open [N^2]."""
        power = 4 * self.own**2  # real and imaginary part, and those of the negative frequency
        power[0] /= 4
        power[-1] /= 4 if self.length % 2 == 0 else 1
        return float(np.sum(power)) / self.length**2

    def draw_untold(self, generator: np.random.Generator, number: int) -> Array:
        """Return so many draws of the force less what all readings tell of it, shape (number, n) [N]."""
        coefficients = generator.normal(size=(number, 2 * self.own.size)).view(np.complex128)
        coefficients *= self.own
        return np.asarray(irfft(coefficients, self.length, axis=1, overwrite_x=True)[:, : self.present.size])

    def draw(self, generator: np.random.Generator, number: int) -> tuple[Array, Array]:
        """Return so many forces, and the readings of them, 0 where one is missing, shape (number, n) each [N]."""
        count, half = self.present.size, self.reading.size
        first, second = generator.normal(size=(2, number, 2 * half)).view(np.complex128)
        second *= self.own
        second += self.shared * first
        first *= self.reading
        readings, forces = (irfft(each, self.length, axis=1, overwrite_x=True)[:, :count] for each in (first, second))
        readings += generator.normal(size=(number, len(self.swings))) @ self.swings
        readings[:, ~self.present] = 0.0
        return forces, readings


def _stationary(system: StateSpace, *, most: int) -> tuple[Array, int]:
    """Covariance of a state long after the start, (d, d), and the samples after which it is forgotten, or the most."""
    A, P, reach = system.transition, system.process_noise, most
    rows = np.vstack([system.observation, np.eye(len(A))[FORCE]])
    samples = 1
    while samples < 1 << 60:
        more = A @ P @ A.T
        P, A, samples = P + more, A @ A, 2 * samples
        seen = np.abs(rows @ A @ P @ rows.T)
        alike = np.sqrt(np.diag(rows @ P @ rows.T))
        if (seen <= FORGOTTEN * np.outer(alike, alike)).all():
            reach = min(reach, samples)
        if not (np.diag(more) > np.finfo(float).eps * np.diag(P)).any():
            break
    return (P + P.T) / 2, reach


def _released(system: StateSpace, states: Array, rows: Array, count: int) -> Array:
    """Rows (r, d) of what becomes of states (d, s) if nothing drives them, shape (r, s, count)."""
    powers = powers_of(system.transition, BLOCK)
    edges = np.zeros((states.shape[1], -(-count // BLOCK), len(states)))
    edges[:, 0] = states.T
    padded = np.pad(powers[BLOCK].T, ((0, 0), (0, -len(states) % WIDTH)))
    _kernels.chain(np.ascontiguousarray(padded), edges, True)
    along = (rows @ powers[:BLOCK]).transpose(1, 0, 2)  # (r, BLOCK, d)
    whole = edges @ along[:, None].transpose(0, 1, 3, 2)  # (r, s, blocks, BLOCK)
    return np.ascontiguousarray(whole.reshape(*whole.shape[:2], edges.shape[1] * BLOCK)[:, :, :count])
