"""The response of a shaken balance with one mode or several, and its likelihood with noise in both channels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.identification.base_excitation.spectra import Complex, Spectra
from aerobalance.recording.channel import Array

FIRST: Final = 4
"""Parameters that one mode has: log mass, log angular frequency, loss b w0 / k = 2 zeta, delay in units of 1 / w0."""

FURTHER: Final = 3
"""Parameters that every further mode adds: log angular frequency, loss 2 zeta, and share of a steady load."""

TRANSIENTS: Final = 4
"""Terms for motion that is going on at the ends of the record: drift, position, velocity, and one for sampling."""

FURTHER_TRANSIENTS: Final = 2
"""Such terms that every further mode adds: its position and velocity."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The spectra to fit and what is known beforehand.

    Attributes
    ----------
    spectra
        Spectra at the frequencies to use.
    mass
        Moving mass [kg; kg*m], or None.
    delay
        Delay of the load [s], or None.
    """

    spectra: Spectra
    mass: float | None
    delay: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """What is fitted, as one vector with a scale of frequency.

    Attributes
    ----------
    values
        The `FIRST` parameters, `FURTHER` for each of the m further modes, then the transients, shape (8 + 5 m,).
    reference
        Angular frequency that makes delay and transients of order one [rad/s].
    """

    values: Array
    reference: float

    @property
    def further(self) -> int:
        """Number m of further modes."""
        return (self.values.size - FIRST - TRANSIENTS) // (FURTHER + FURTHER_TRANSIENTS)

    @property
    def physical(self) -> int:
        """Number of parameters before the transients, 4 + 3 m."""
        return FIRST + FURTHER * self.further

    @property
    def frequencies(self) -> list[int]:
        """Places of the log angular frequencies, the first mode first; each loss is next to its frequency."""
        return [1, *range(FIRST, self.physical, FURTHER)]

    @property
    def shares(self) -> Array:
        """Share of every mode, shape (1 + m,); the first has what the further ones leave."""
        further = self.values[FIRST + 2 : self.physical : FURTHER]
        return np.concatenate(([1 - np.sum(further)], further))

    def with_mode(self, frequency: float, *, loss: float, share: float) -> Parameters:
        """The same and one further mode of this angular frequency [rad/s]."""
        here = self.physical
        mode = (np.log(frequency), loss, share)
        grown = [*self.values[:here], *mode, *self.values[here:], *np.zeros(FURTHER_TRANSIENTS)]
        return Parameters(np.array(grown), self.reference)

    def holding(self, *, mass: float | None, delay: float | None) -> Parameters:
        """The same with mass and delay [s] as given, where they are."""
        values = self.values.copy()
        if mass is not None:
            values[0] = np.log(mass)
        if delay is not None:
            values[3] = delay * self.reference
        return Parameters(values, self.reference)

    def led_by(self, number: int) -> Parameters:
        """The same modes with that further one, counted from 1, in the place of the first; transients at zero."""
        values = self.values.copy()
        place = FIRST + FURTHER * (number - 1)
        values[1:3], values[place : place + 2] = self.values[place : place + 2], self.values[1:3]
        values[place + 2] = self.shares[0]
        values[self.physical :] = 0.0
        return Parameters(values, self.reference)


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Noise power of load and ground acceleration, and the weight of every frequency, shape (m,) each."""

    load: Array
    ground: Array
    weight: Array


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodPoint:
    """The likelihood at one set of parameters.

    Attributes
    ----------
    cost
        Sum of the weighted squares of the residual over its variance: the log-likelihood is its negative.
    residual
        Y - H U - T, shape (m,).
    variance
        Expected power of the residual, shape (m,).
    ground
        Most likely ground motion, shape (m,).
    load
        Most likely noise-free load, transients included, shape (m,).
    jacobian
        Derivatives of the weighted model by the parameters, shape (m, p).
    """

    cost: float
    residual: Complex
    variance: Array
    ground: Complex
    load: Complex
    jacobian: Complex


def response(parameters: Parameters, w: Array) -> Complex:
    """Response H = AF/x1'' of the loads to the ground acceleration at angular frequencies [kg; kg*m]."""
    return _pushed(parameters, w) * shape(parameters, mode_responses(parameters, w))


def mode_responses(parameters: Parameters, w: Array) -> list[Complex]:
    """Response 1/D of every mode, D = 1 - r^2 + i r loss, r = w/w0, at angular frequencies."""
    places = zip(np.exp(parameters.values[parameters.frequencies]), parameters.frequencies, strict=True)
    return [1 / (1 - (w / w0) ** 2 + 1j * (w / w0) * parameters.values[place + 1]) for w0, place in places]


def shape(parameters: Parameters, rings: list[Complex]) -> Complex:
    """Response of all modes, 1 at rest."""
    return np.asarray(sum(share * ring for share, ring in zip(parameters.shares, rings, strict=True)))


def _pushed(parameters: Parameters, w: Array) -> Complex:
    """Force of inertia per ground acceleration, as the delayed readings show it [kg; kg*m]."""
    values = parameters.values
    return np.asarray(-np.exp(values[0]) * _turn(parameters, w))


def _turn(parameters: Parameters, w: Array) -> Complex:
    """What the delay does to the readings."""
    return np.asarray(np.exp(-1j * w * parameters.values[3] / parameters.reference))


def point(problem: Problem, parameters: Parameters, *, weights: Weights) -> LikelihoodPoint:
    """Evaluate likelihood and Jacobian.

    The Jacobian holds the most likely ground motion in place of the measured one: with it J^H r is the exact slope
    of the likelihood, in which the ground motion at every frequency has been eliminated.
    """
    spectra, values = problem.spectra, parameters.values
    w = 2 * np.pi * spectra.frequency
    rings = mode_responses(parameters, w)
    pushed = _pushed(parameters, w)
    basis = _transients(parameters, w, rings)
    amplitudes = values[parameters.physical :]
    transient = basis @ amplitudes
    answer = pushed * shape(parameters, rings)
    residual = spectra.load - answer * spectra.ground - transient
    variance = weights.load + np.abs(answer) ** 2 * weights.ground
    ground = spectra.ground + weights.ground * np.conj(answer) * residual / variance
    jacobian = np.empty((w.size, values.size), dtype=np.complex128)
    for number, (place, share, ring) in enumerate(zip(parameters.frequencies, parameters.shares, rings, strict=True)):
        r = w / np.exp(values[place])
        own = _own_transients(number)
        part = (share * pushed * ground * ring + basis[:, own] @ amplitudes[own]) * ring
        jacobian[:, place] = -part * (2 * r**2 - 1j * r * values[place + 1])
        jacobian[:, place + 1] = -part * 1j * r
        if number:
            jacobian[:, place + 2] = pushed * ground * (ring - rings[0])
    driven = answer * ground
    jacobian[:, 0] = driven
    jacobian[:, 3] = -1j * w / parameters.reference * (driven + transient - basis[:, 0] * amplitudes[0])
    jacobian[:, parameters.physical :] = basis
    jacobian *= np.sqrt(weights.weight / variance)[:, None]
    cost = float(np.sum(weights.weight * np.abs(residual) ** 2 / variance))
    return LikelihoodPoint(cost, residual, variance, ground, driven + transient, jacobian)


def _transients(parameters: Parameters, w: Array, rings: list[Complex]) -> Complex:
    """Basis of the motion that is going on at the ends of the record, shape (m, 4 + 2 modes)."""
    s = 1j * w / parameters.reference
    turn = _turn(parameters, w)
    columns = [1 / s]
    for number, ring in enumerate(rings):
        columns += [turn * ring, s * turn * ring]
        if number == 0:
            columns.append(s**2 * turn * ring)
    return np.column_stack(columns)


def _own_transients(number: int) -> slice:
    """Places of the transients of a mode, counted from 0, among all of them."""
    if number == 0:
        return slice(1, TRANSIENTS)
    start = TRANSIENTS + FURTHER_TRANSIENTS * (number - 1)
    return slice(start, start + FURTHER_TRANSIENTS)
