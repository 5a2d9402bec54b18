r"""The Kalman filter long after its start, when gain and covariance stand still.

The covariance solves the discrete algebraic Riccati equation. It is found by doubling: the filter over 2 m samples
follows from that over m, so a memory of a million samples takes twenty turns [Anderson1979]_. All covariances are kept
as square roots [Yaghoobi2025]_, since readings without noise would cost a plain covariance all its digits.

References
----------
.. [Anderson1979] B. D. O. Anderson, J. B. Moore, "Optimal Filtering", Prentice-Hall (1979), ch. 6.7.
.. [Yaghoobi2025] F. Yaghoobi, A. Corenflos, S. Hassan, S. Sarkka, "Parallel square-root statistical linear regression
   for inference in nonlinear state space models", SIAM J. Sci. Comput. 47 (2025) B454, Sec. 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from scipy.linalg.lapack import dgeqrf

from aerobalance.estimation.statespace._kernels import Model
from aerobalance.recording.channel import Array

DOUBLINGS: Final = 40
"""Most doublings: a memory of 1e12 samples."""

STILL: Final = 1e-9
"""Change of a correlation in a doubling after which it stands still; the error squares with each doubling."""

MOST: Final = 2000
"""Most samples over which the covariance is then followed until it stands still: one, but for rounding."""

LOOKED_AT: Final = 8
"""Samples after which it is looked at whether it does, from the first on: that takes as long as to follow it."""

UNSTABLE: Final = 10.0
"""Size of a power of the closed loop, over the number of states, that only a filter without a steady state reaches."""

LEAST: Final = 1e-9
"""Error of a prediction, over the size of its state, below which it is none."""

LEVEL: Final = 1e-14
"""Eigenvalue of the correlation of such errors that is rounding."""

ROUNDING: Final = (0.0, 1e-17, 1e-16, 1e-15, 1e-14, 1e-13, 1e-12, 1e-11, 1e-10)
"""Process noise over the variance of the states that is tried, one after the other, where rounding hides the true one.

A force that is far smoother than the noise is small is known to more digits than a double has."""


@dataclass(frozen=True, slots=True, eq=False)
class SteadyState:
    """The filter whose gain does not change: x[k+1] = F x[k] + b y[k], with innovations y[k] - h x[k].

    Its states are those of the model in other coordinates, in which the error of a prediction has covariance 1 (or
    less, where there is none). So no power of F is large, and rounding stays small beside that error.

    Attributes
    ----------
    basis
        T: the states of the model are T x, shape (d, d).
    model
        The state space in these coordinates.
    initial
        Covariance of the first state, shape (d, d).
    covariance
        P of the predicted state, shape (d, d).
    variance
        S of the innovations.
    closed_loop
        F = A (1 - K h), shape (d, d).
    entry
        b = A K, by which a reading enters the next state, shape (d,).
    """

    basis: Array
    model: Model
    initial: Array
    covariance: Array
    variance: float
    closed_loop: Array
    entry: Array

    @classmethod
    def of(cls, model: Model, initial: Array) -> SteadyState:
        """Return the steady filter of a model with a stable transition.

        Parameters
        ----------
        model
            The state space.
        initial
            Covariance of the first state, shape (d, d): it tells the size of the states.
        """
        unit = np.sqrt(np.maximum(np.diag(initial), 0.0))
        unit = np.where(unit > 0, unit, np.min(unit[unit > 0], initial=1.0))
        for rounding in ROUNDING:
            root = unit[:, None] * _covariance_root(model, unit, rounding=rounding)
            first = root @ root.T
            for steps in (MOST, 0):
                steady = cls._with(model, initial, _followed(first, model, steps=steps), unit)
                if steady._forgets:
                    return steady
        return steady

    @classmethod
    def _with(cls, model: Model, initial: Array, P: Array, unit: Array) -> SteadyState:
        size = np.sqrt(np.maximum(np.diag(P), 0.0) + (LEAST * unit) ** 2)
        level, vectors = np.linalg.eigh((P + np.diag((LEAST * unit) ** 2)) / np.outer(size, size))
        root = np.sqrt(np.maximum(level, LEVEL))
        basis, back = size[:, None] * vectors * root, (vectors / root).T / size
        A, h = back @ model.A @ basis, model.h @ basis
        Q, initial, P = (_symmetric(back @ part @ back.T) for part in (model.Q, initial, P))
        turned = Model(A, np.ascontiguousarray(A.T), Q, h, model.R)
        Ph = P @ h
        S = float(h @ Ph) + model.R
        entry = A @ (Ph / S)
        return cls(basis, turned, initial, P, S, A - np.outer(entry, h), entry)

    @property
    def _forgets(self) -> bool:
        """Whether what was long ago does not grow; a filter spoilt by rounding would run away in a long record."""
        power = self.closed_loop
        for _ in range(DOUBLINGS):
            power = power @ power
            size = np.linalg.norm(power)
            if not size < UNSTABLE * power.shape[0]:
                return False
            if size < STILL:
                break
        return True


def _symmetric(matrix: Array) -> Array:
    return np.asarray((matrix + matrix.T) / 2)


def root_of(covariance: Array) -> Array:
    """Return B with B B^T = covariance, shape (d, d); rounding that makes a variance negative is left out."""
    unit = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(unit > 0, unit, 1.0)
    level, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(level, 0.0)))


def joined(*roots: Array) -> Array:
    """Return B with B B^T the sum of B_i B_i^T, shape (d, at most d), for roots of shape (d, any)."""
    together = np.hstack(roots)
    size = together.shape[0]
    if together.shape[1] <= size:
        return together
    factors = dgeqrf(together.T, overwrite_a=True)[0]
    return np.asarray((factors[:size] * _upper(size)).T)


@cache
def _upper(size: int) -> Array:
    """Ones in the upper triangle of a square."""
    return np.triu(np.ones((size, size)))


def _covariance_root(model: Model, unit: Array, *, rounding: float) -> Array:
    """Root of the steady covariance, states in a unit each, shape (d, d).

    The filter over m samples is described by three matrices: A, by which the first state acts on the last one; U U',
    the covariance of the last state, the first one known; and Z Z', what the readings tell of the first state. Two
    such filters, one after the other, give that over 2 m: (U' Z) = p s q' says what one knows of the other.
    """
    A = model.A * unit / unit[:, None]
    U = root_of(model.Q / np.outer(unit, unit))
    if rounding:
        U = joined(U, np.sqrt(rounding) * np.eye(unit.size))
    Z = (model.h * unit / np.sqrt(model.R))[:, None]
    P = U @ U.T
    for _ in range(DOUBLINGS):
        p, s, q = np.linalg.svd(U.T @ Z, full_matrices=False)
        less = 1 / np.sqrt(1 + s**2)
        reach, seen = A @ U, A.T @ Z
        A = A @ A - (reach @ (p * (s * less))) @ (seen @ (q.T * less)).T
        U = joined(reach + (reach @ p) * (less - 1) @ p.T, U)
        Z = joined(seen + (seen @ q.T) * (less - 1) @ q, Z)
        before, P = P, U @ U.T
        size = np.sqrt(np.outer(np.diag(P), np.diag(P))) + 1e-300
        change = np.max(np.abs(P - before) / size)
        if not change > STILL:
            break
    return U


def _followed(P: Array, model: Model, *, steps: int) -> Array:
    """Follow a covariance (d, d) of the predicted state until it stands still, or over so many samples."""
    for step in range(steps):
        Ph = P @ model.h
        S = model.R + model.h @ Ph
        K = Ph / S
        updated = P - np.outer(K, Ph)
        updated += np.outer(model.R * K - updated @ model.h, K)  # the Joseph form, positive however small R is
        following = _symmetric(model.A @ updated @ model.A.T) + model.Q
        before, P = P, following
        if step % LOOKED_AT:
            continue
        size = np.sqrt(np.diag(P))
        change = np.abs(P - before) / (np.outer(size, size) + 1e-300)
        shown = np.abs(P @ model.h - Ph) / (np.sqrt(model.h @ P @ model.h) * size + 1e-300)
        if max(float(change.max()), float(shown.max())) < STILL:
            break
    return P
