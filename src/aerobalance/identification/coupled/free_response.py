"""Free motion of coupled components in closed form, with its derivatives by the matrices behind it.

With X counted from its final rest, A X'' + D X' + X = 0 is X'' = -A^-1 (X + D X'). Its motion is a sum of
exponentials exp(p t), one for each of the 2 N poles, and its derivatives by the elements of A^-1 and A^-1 D hold only
exp(p t) and t exp(p t). So whatever a release or a change of the matrices does to the readings lies in the span of a
few columns of samples, and a fit works on coefficients of these columns instead of on samples.

Where the model or the sting bends, N coordinates move of which the n components are the first; only these are felt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array

Complex = NDArray[np.complex128]

CLOSE: Final = 1e-6
"""Relative distance of two poles below which they are taken as one where their difference would divide."""


@dataclass(frozen=True, slots=True, eq=False)
class ExponentialSums:
    """Functions of time a exp(p t) + b t exp(p t) + c, summed over the poles.

    Attributes
    ----------
    plain, late
        a and b by pole, component and function, shape (2 N, n, k).
    constant
        c by component and function, shape (n, k).
    """

    plain: Complex
    late: Complex
    constant: Array

    def weighted(self, by_plain: Complex, by_late: Complex) -> ExponentialSums:
        """Sum of the functions at earlier instants: by_plain = sum of exp(-p s), by_late = sum of -s exp(-p s)."""
        plain, late = by_plain[:, None, None], by_late[:, None, None]
        return ExponentialSums(self.plain * plain + self.late * late, self.late * plain, self.constant)

    def picked(self, which: slice) -> ExponentialSums:
        """Some of the functions."""
        return ExponentialSums(self.plain[:, :, which], self.late[:, :, which], self.constant[:, which])

    def scaled(self, factor: float) -> ExponentialSums:
        """The functions times a number."""
        return ExponentialSums(self.plain * factor, self.late * factor, self.constant * factor)

    def combined(self, weights: Array) -> ExponentialSums:
        """Combinations of the functions, by columns of weights."""
        return ExponentialSums(self.plain @ weights, self.late @ weights, self.constant @ weights)

    def __add__(self, other: ExponentialSums) -> ExponentialSums:
        """Sum of every function and its partner."""
        return ExponentialSums(self.plain + other.plain, self.late + other.late, self.constant + other.constant)

    @classmethod
    def joined(cls, parts: Sequence[ExponentialSums]) -> ExponentialSums:
        """All functions of several sets as one set."""
        return cls(
            np.concatenate([part.plain for part in parts], axis=2),
            np.concatenate([part.late for part in parts], axis=2),
            np.concatenate([part.constant for part in parts], axis=1),
        )


@dataclass(frozen=True, slots=True, eq=False)
class FreeMotion:
    """Poles and shapes of the free motion; loads and times are in any consistent units.

    Attributes
    ----------
    poles
        Poles p, shape (2 N,).
    shapes
        Coordinates in every mode, columns, the balance loads first, shape (N, 2 N).
    participation
        Modal participation: turns coordinates and rates at an instant into the size of every mode, shape (2 N, 2 N).
    components
        Number of components n.
    """

    poles: Complex
    shapes: Complex
    participation: Complex
    components: int

    @classmethod
    def of(cls, spring: Array, brake: Array, *, components: int | None = None) -> FreeMotion:
        """Motion of X'' = -spring X - brake X', with spring = A^-1 and brake = A^-1 D, both (N, N)."""
        poles, vectors = np.linalg.eig(generator_of(spring, brake))
        poles, vectors = poles.astype(np.complex128), vectors.astype(np.complex128)
        size = spring.shape[0]
        return cls(poles, vectors[:size], np.linalg.inv(vectors), size if components is None else components)

    @property
    def size(self) -> int:
        """Number of coordinates N."""
        return int(self.shapes.shape[0])

    @property
    def felt(self) -> Complex:
        """Balance loads in every mode, columns, shape (n, 2 N)."""
        return self.shapes[: self.components]

    def columns(self, time: Array) -> Array:
        """Columns that span every motion and its derivatives, at times of shape (m,): shape (m, 4 N + 1)."""
        up = self.poles.imag >= 0
        waves = np.exp(time[:, None] * self.poles[up])
        steep = time[:, None] * waves
        ones = np.ones((time.size, 1))
        return np.hstack([waves.real, waves.imag, steep.real, steep.imag, ones])

    def on_columns(self, functions: ExponentialSums) -> Array:
        """ExponentialSums of real functions on `columns`, shape (4 N + 1, n, k)."""
        up = self.poles.imag >= 0
        twice = np.where(self.poles[up].imag > 0, 2.0, 1.0)[:, None, None]
        alone = np.where(self.poles[up].imag > 0, 1.0, 0.0)[:, None, None]
        plain, late = twice * functions.plain[up], twice * functions.late[up]
        parts = [plain.real, -alone * plain.imag, late.real, -alone * late.imag, functions.constant[None]]
        return np.concatenate(parts)

    def sizes(self, loads: Array, rates: Array) -> Complex:
        """Size of every mode with these coordinates from rest and rates at time zero, shape (2 N,)."""
        return np.asarray(self.participation @ np.concatenate([loads, rates]))

    def motion(self, sizes: Complex) -> ExponentialSums:
        """The motion with modes of these sizes, one function."""
        plain = (self.felt * sizes).T[:, :, None]
        return ExponentialSums(plain, np.zeros_like(plain), np.zeros((self.components, 1)))

    def by_state(self) -> ExponentialSums:
        """Derivatives of the motion by coordinates and rates at time zero, 2 N functions."""
        plain = self.felt.T[:, :, None] * self.participation[:, None, :]
        return ExponentialSums(plain, np.zeros_like(plain), np.zeros((self.components, 2 * self.size)))

    def by_time(self, motion: ExponentialSums) -> ExponentialSums:
        """Derivative of a motion by the instant at which it began."""
        return ExponentialSums(-self.poles[:, None, None] * motion.plain, motion.late, motion.constant)

    def by_matrices(self, sizes: Complex) -> ExponentialSums:
        """Derivatives of the motion by the elements of spring and brake, row by row, 2 N^2 functions.

        The change dG of the generator moves mode l into mode k by W_k dG V_l (exp(p_k t) - exp(p_l t)) / (p_k - p_l),
        and by W_k dG V_k t exp(p_k t) into itself.
        """
        size, n, poles = self.size, self.components, self.poles
        difference = poles[:, None] - poles[None, :]
        close = np.abs(difference) < CLOSE * np.abs(poles).max()
        inverse = np.where(close, 0.0, 1 / np.where(close, 1.0, difference))
        into = -self.participation[:, size:]
        # from whom: coordinates of the modes for spring, their rates for brake
        carried = np.stack([self.shapes * sizes, self.shapes * (poles * sizes)])
        gained = self.felt.T[:, :, None] * into[:, None, :]  # mode k, component, row of the matrix
        arrived = np.einsum("kl,mjl->mkj", inverse, carried)
        left = np.einsum("kl,kci->lci", inverse, gained)
        plain = np.einsum("kci,mkj->kcmij", gained, arrived) - np.einsum("lci,mjl->lcmij", left, carried)
        together = np.einsum("kl,mjl->mkj", close.astype(np.float64), carried)
        late = np.einsum("kci,mkj->kcmij", gained, together) / 2
        received = np.einsum("kl,kci->lci", close.astype(np.float64), gained)
        late = late + np.einsum("lci,mjl->lcmij", received, carried) / 2
        shape = (2 * size, n, 2 * size * size)
        return ExponentialSums(plain.reshape(shape), late.reshape(shape), np.zeros((n, 2 * size * size)))


def generator_of(spring: Array, brake: Array) -> Array:
    """Matrix that gives the rates of coordinates and rates, shape (2 N, 2 N)."""
    size = spring.shape[0]
    whole = np.zeros((2 * size, 2 * size))
    whole[:size, size:] = np.eye(size)
    whole[size:, :size] = -spring
    whole[size:, size:] = -brake
    return whole
