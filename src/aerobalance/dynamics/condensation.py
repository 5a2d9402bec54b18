r"""Dynamic condensation: internal coordinates taken out of the equations of coupled components, by polynomials in s.

With the coordinates split into the components X and the internal ones Y, P = 1 + D s + A s^2 has the blocks P_XX,
P_XY, P_YX and P_YY, and a load G that acts on the internal coordinates gives

    q F = (q P_XX - P_XY adj(P_YY) P_YX) X + P_XY adj(P_YY) G,   q Y = adj(P_YY) (G - P_YX X),   q = det P_YY.

A polynomial is had from its values on a circle, which is as exact as they are; where a component has no part in
another, it has none either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from aerobalance.dynamics.modal import Mode
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True, eq=False)
class Condensed:
    """Equations of the components without the internal coordinates; powers of s rise along the last axis.

    Attributes
    ----------
    forces
        q F by the balance loads, shape (n, n, 2 e + 3).
    internal
        q Y by the balance loads, shape (e, n, 2 e + 1).
    carried
        What q F takes of a load on an internal coordinate, shape (n, e, 2 e + 1).
    common
        q, shape (2 e + 1,); its roots are the motions in which no component shows anything.
    """

    forces: Array
    internal: Array
    carried: Array
    common: Array

    @classmethod
    def of(
        cls,
        equation: Callable[[NDArray[np.complex128]], NDArray[np.complex128]],
        *,
        components: int,
        poles: NDArray[np.complex128],
    ) -> Condensed:
        """Return the equations with the internal coordinates condensed.

        Parameters
        ----------
        equation
            Gives 1 + D s + A s^2 of all N coordinates at s of shape (m,) [rad/s], shape (m, N, N).
        components
            Their number n: rows and columns of internal coordinates stand behind theirs.
        poles
            Poles of the free motion, shape (2 N,) [rad/s].
        """
        n, e = components, poles.size // 2 - components
        radius = float(np.exp(np.mean(np.log(np.abs(poles)))))
        whole = equation(radius * np.exp(2j * np.pi * np.arange(2 * e + 3) / (2 * e + 3)))
        seen, by_hidden, of_seen, inner = (
            whole[:, :n, :n],
            whole[:, :n, n:],
            whole[:, n:, :n],
            whole[:, n:, n:],
        )
        common = np.linalg.det(inner)[:, None, None]
        adjugate = common * np.linalg.inv(inner)
        return cls(
            _coefficients(common * seen - by_hidden @ adjugate @ of_seen, radius),
            _coefficients(-adjugate @ of_seen, radius)[..., : 2 * e + 1],
            _coefficients(by_hidden @ adjugate, radius)[..., : 2 * e + 1],
            _coefficients(common, radius)[0, 0, : 2 * e + 1],
        )

    @property
    def still(self) -> NDArray[np.complex128]:
        """Roots of q: the motions in which no component shows anything, shape (2 e,) [rad/s]."""
        return np.asarray(polynomial.polyroots(self.common), dtype=np.complex128)


def _coefficients(values: NDArray[np.complex128], radius: float) -> Array:
    """Coefficients of real polynomials from values at even points of a circle, along the first axis."""
    count = values.shape[0]
    found = np.fft.fft(values, axis=0).real / count
    return np.asarray(np.moveaxis(found, 0, -1) * radius ** -np.arange(float(count)))


def spectral_factor(spectrum: Array) -> tuple[Mode, ...]:
    """Modes (1 + d s + a s^2) whose product has a given size on the imaginary axis, and decays.

    Parameters
    ----------
    spectrum
        Coefficients of s^0, s^2, s^4, ... of the square of the size, over the first of them, shape (2 m + 1,).

    Raises
    ------
    ValueError
        The size is zero somewhere on the axis.
    """
    unit = float(np.abs(spectrum[-1]) ** (-1 / (2 * (spectrum.size - 1))))
    squares = np.roots((spectrum * unit ** (2 * np.arange(float(spectrum.size))))[::-1])
    roots = np.asarray(-np.sqrt(squares.astype(np.complex128)) * unit, dtype=np.complex128)
    return modes_of(roots)


def modes_of(roots: NDArray[np.complex128]) -> tuple[Mode, ...]:
    """Modes with these roots [rad/s], which come in conjugate pairs or as an even number of real ones; slowest first.

    Raises
    ------
    ValueError
        A root does not decay, or an odd number of them is real.
    """
    if not (roots.real < 0).all():
        raise ValueError("a mode of the readings' noise does not decay")
    up = roots[roots.imag > 0]
    real = np.sort(roots[roots.imag == 0].real)[::-1]
    if 2 * up.size + real.size != roots.size or real.size % 2:
        raise ValueError("roots must come in pairs")
    pairs = [*zip(up, up.conj(), strict=True), *zip(real[::2], real[1::2], strict=True)]
    modes = [_mode(complex(one), complex(other)) for one, other in pairs]
    return tuple(sorted(modes, key=lambda mode: mode.natural_frequency))


def _mode(one: complex, other: complex) -> Mode:
    rate = float(np.sqrt((one * other).real))
    return Mode(rate / (2 * np.pi), float(-(one + other).real / (2 * rate)))


def partial_fractions(polynomials: Array, modes: Sequence[Mode]) -> tuple[Array, Array, Array]:
    """Partial fractions of polynomials over the product of modes 1 + d s + a s^2.

    Parameters
    ----------
    polynomials
        Coefficients, rising powers along the last axis, shape (..., 2 m + 1).
    modes
        The m modes, all different.

    Returns
    -------
    direct, shares, rate_shares
        Polynomial over product = direct + sum of (share + rate_share s) / (1 + d s + a s^2), shapes (...), (..., m)
        and (..., m) [1, 1, s] times the unit of the polynomials.
    """
    unit, columns = _columns(tuple(modes))
    count = len(columns)
    scaled: Array = np.zeros((*polynomials.shape[:-1], count))
    scaled[..., : polynomials.shape[-1]] = polynomials * unit ** -np.arange(float(polynomials.shape[-1]))
    found: Array = np.asarray(np.linalg.solve(columns, scaled.reshape(-1, count).T).T).reshape(scaled.shape)
    return found[..., 0], found[..., 1::2], found[..., 2::2] * unit


@lru_cache(maxsize=64)  # of the same modes many fractions are asked for
def _columns(modes: tuple[Mode, ...]) -> tuple[float, Array]:
    """A unit of time for which powers of s are alike [s], and polynomials of all fractions' parts, (2 m + 1,) each."""
    unit = float(np.exp(-np.mean([np.log(mode.angular_frequency) for mode in modes]))) if modes else 1.0
    factors = [np.array([1.0, 2 * mode.damping_ratio, 1.0]) for mode in modes]
    for factor, mode in zip(factors, modes, strict=True):
        factor[1:] *= (unit * mode.angular_frequency) ** -np.arange(1.0, 3.0)
    columns = [_product(factors, without=None)]
    for place in range(len(modes)):
        rest = _product(factors, without=place)
        columns += [np.append(rest, [0.0, 0.0]), np.concatenate([[0.0], rest, [0.0]])]
    return unit, np.column_stack(columns)


def _product(factors: Sequence[Array], *, without: int | None) -> Array:
    whole = np.ones(1)
    for place, factor in enumerate(factors):
        if place != without:
            whole = np.convolve(whole, factor)
    return whole
