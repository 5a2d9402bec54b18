"""Rows of polynomials in s that turn the balance loads of all channels into forces, and the loads' powers of s."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.condensation import partial_fractions
from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.driven_modes import values_and_rates
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """What turns the balance loads into the forces: polynomials in s over a common one, shape (n, n, p).

    Attributes
    ----------
    forces
        Row i has what component i takes of every channel; powers of s rise along the last axis.
    exchanged
        What a force that is known by other means than the channels counts with in each component where channels have
        another sign or order, shape (n, n); None where they have not.
    """

    forces: Array
    exchanged: Array | None = None

    @property
    def order(self) -> Array:
        """The same, and where they have not, each force in its own component."""
        return np.eye(len(self.forces)) if self.exchanged is None else self.exchanged

    def at(self, frequency: Array) -> NDArray[np.complex128]:
        """Their values at frequencies of shape (m,) [Hz], shape (m, n, n)."""
        w = 2 * np.pi * frequency[:, None]
        # even powers of s are real, odd ones imaginary: real products alone
        powers = np.vander(-(w[:, 0] ** 2), (self.forces.shape[-1] + 1) // 2, increasing=True)
        odd = powers[:, : self.forces.shape[-1] // 2] * w
        flat = self.forces.reshape(-1, self.forces.shape[-1])
        found = np.empty((frequency.size, *self.forces.shape[:2]), complex)
        found.real = (powers @ flat[:, ::2].T).reshape(found.shape)
        found.imag = (odd @ flat[:, 1::2].T).reshape(found.shape)
        return found

    def determinant(self, frequency: Array) -> Array:
        """Logarithm of their squared determinant at frequencies of shape (m,) [Hz], shape (m,).

        With P_0 + P_1 s + ... for the rows, det(1 + P_0^-1 P_1 s + ...) = prod(1 - s / s_i): 1 / s_i are the
        eigenvalues of the companion matrix, in the first row of which are -P_0^-1 P_k.
        """
        scale = 2 * np.pi * float(frequency[-1])
        along = 2 * np.pi * frequency / scale
        first, *others = np.moveaxis(self.forces, -1, 0)
        size = len(first)
        companion = np.eye(len(others) * size, k=-size)
        for place, power in enumerate(others):
            companion[:size, place * size : (place + 1) * size] = -np.linalg.solve(first, power * scale ** (place + 1))
        product, square = np.full(frequency.size, np.linalg.det(first) ** 2), along**2
        for one in np.linalg.eigvals(companion):
            if one.imag > 0:  # |1 - s / s_i|^2 of a pair
                factor = 1 - float(abs(one)) ** 2 * square
                factor *= factor
                factor += (4 * one.real**2) * square
                product *= factor
            elif not one.imag:
                product *= 1 + one.real**2 * square
        return np.asarray(np.log(product))

    def with_signs(self, signs: Array) -> Rows:
        """The same for channels of other signs, shape (n,)."""
        return Rows(self.forces * np.outer(signs, signs)[..., None], np.diag(signs) @ self.order)

    def reordered(self, order: NDArray[np.intp]) -> Rows:
        """The same for channels that hold what others should."""
        back = np.argsort(order)
        return Rows(self.forces[np.ix_(back, back)], self.order[back])


@lru_cache(maxsize=256)  # the same rows are asked at the same frequencies in all parts of a record
def mean_determinant(rows: Rows, step: float, first: int, last: int, *, fine: int) -> Array:
    """Mean about ordinates of the logarithm of the squared determinant of rows, shape (m,); not to be written to.

    Parameters
    ----------
    rows
        The rows.
    step
        Distance of two ordinates [Hz].
    first, last
        The first of the m ordinates and the one after the last, as multiples of it.
    fine
        Points of each over which it is averaged.
    """
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    places = step * (np.arange(first, last)[:, None] + offsets).ravel()
    found = np.asarray(rows.determinant(places).reshape(-1, fine).mean(axis=1))
    found.setflags(write=False)
    return found


def powers_of(one: DecoupledChannel, loads: Array, *, interval: float) -> Array:
    """All powers of s over the modes of a decoupled component, driven by every channel, shape (p, n, samples)."""
    count = one.row.shape[1]
    direct, by_value, by_rate = partial_fractions(np.eye(count), one.dynamics.modes)
    found = direct[:, None, None] * np.ascontiguousarray(loads.T)
    for place, mode in enumerate(one.dynamics.modes):
        value, rate = values_and_rates(mode, loads, interval=interval)
        found += by_value[:, place, None, None] * value + by_rate[:, place, None, None] * rate
    return np.asarray(found)


def product_of_modes(one: DecoupledChannel, frequency: Array) -> NDArray[np.complex128]:
    """Product of the modes' denominators of a decoupled component at frequencies [Hz], of their shape [1]."""
    s, whole = 2j * np.pi * frequency, np.ones(frequency.size, dtype=np.complex128)
    for mode in one.dynamics.modes:
        w = mode.angular_frequency
        whole = whole * (1 + 2 * mode.damping_ratio * s / w + (s / w) ** 2)
    return whole
