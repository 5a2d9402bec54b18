"""What a set of releases tells, what it leaves open, and which release would help most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.coupled.free_response import Complex, FreeMotion
from aerobalance.identification.coupled.internal_coordinates import coordinates_of
from aerobalance.identification.force_error import error_of, force_weights
from aerobalance.identification.step_relaxation.fit import ReleaseFit, whitener_of
from aerobalance.identification.step_relaxation.model import Segment, linearise, of_matrices, state_at_the_edge
from aerobalance.identification.step_relaxation.record import ReleaseRecord
from aerobalance.identification.step_relaxation.stages import Units
from aerobalance.recording.channel import Array

STILL: Final = 100.0
"""Energy of a motion over the noise of one reading below which it is not seen."""


@dataclass(frozen=True, slots=True, eq=False)
class ReleaseAdvice:
    """What one further release along each component would bring.

    Attributes
    ----------
    components
        Components along which a release is considered.
    sizes
        Load let go in each, shape (n,) [N, N*m].
    errors
        Predicted force error by release and component, shape (n, n) [N, N*m].
    best
        Component of the release that brings the largest relative error down most.
    """

    components: tuple[str, ...]
    sizes: Array
    errors: Array
    best: str


def combination_text(weights: Array, components: tuple[str, ...]) -> str:
    """A combination of loads in words, largest weight 1, small ones left out."""
    weights = weights / weights[np.argmax(np.abs(weights))]
    kept = [number for number in np.argsort(-np.abs(weights)) if abs(weights[number]) >= 0.1]
    first, *others = kept
    text = str(components[first])
    for number in others:
        text += f" {'+' if weights[number] > 0 else '-'} {abs(weights[number]):.2f} {components[number]}"
    return text


def unmoved(records: Sequence[ReleaseRecord], sizes: Array) -> Array:
    """Combinations of loads that no release moves, rows, in loads over their sizes, shape (k, n).

    A motion shows in the product of neighbouring readings, to which white noise of whatever size adds nothing.
    """
    noise = np.min([record.noise for record in records], axis=0)
    power, neighbours, count = np.zeros((noise.size, noise.size)), np.zeros((noise.size, noise.size)), 0
    for record in records:
        values = record.values[record.onset :] / noise
        values = values - values.mean(axis=0)
        power += values.T @ values
        neighbours += values[1:].T @ values[:-1]
        count += values.shape[0]
    energy, directions = np.linalg.eigh(power)
    together = np.abs(np.einsum("ik,ij,jk->k", directions, neighbours, directions))
    still = (together < STILL + 6 * np.sqrt(count)) & (energy < 2 * count + STILL)
    return plainest(directions[:, still].T * sizes / noise)


def plainest(combinations: Array) -> Array:
    """The same space of combinations, each with a component of its own, shape (k, n)."""
    rows = combinations / np.linalg.norm(combinations, axis=1, keepdims=True)
    for number in range(len(rows)):
        place = np.unravel_index(np.argmax(np.abs(rows[number:])), rows[number:].shape)
        rows[[number, number + place[0]]] = rows[[number + place[0], number]]
        rows[number] /= rows[number, place[1]]
        others = np.arange(len(rows)) != number
        rows[others] -= np.outer(rows[others, place[1]], rows[number])
    return np.asarray(rows)


def first_release_for(combinations: Array, components: tuple[str, ...]) -> str:
    """The component along which a release moves these combinations most."""
    return components[int(np.argmax(np.sum(combinations**2, axis=0)))]


def combination_of(motion: FreeMotion, mode: int) -> Array:
    """Combination of loads that sets off one mode and no other, shape (n,); `mode` counts the pairs of poles.

    With internal coordinates there is none: then that with which the mode takes the largest part of what is set off.
    """
    up, _ = pairs(motion)
    if motion.size > motion.components:
        return _strongest(
            motion.participation[up, : motion.components] * np.linalg.norm(motion.felt[:, up], axis=0)[:, None], mode
        )
    others = np.delete(motion.shapes[:, up], mode, axis=1)
    if others.shape[1] == 0:
        return np.ones(1)
    left = np.linalg.svd(np.hstack([others.real, others.imag]))[0]
    return left[:, -1]


def _strongest(amplitudes: Complex, mode: int) -> Array:
    """Combination of loads for which one mode's amplitude is largest over the root sum of squares of all."""
    one = np.real(np.outer(amplitudes[mode].conj(), amplitudes[mode]))
    every = np.real(amplitudes.conj().T @ amplitudes)
    return np.asarray(eigh(one, every)[1][:, -1])


def pairs(motion: FreeMotion) -> tuple[NDArray[np.intp], Array]:
    """Places of the oscillating poles, one of each pair, the slowest first, and their sizes."""
    up = np.flatnonzero(motion.poles.imag > 0)
    order = np.argsort(np.abs(motion.poles[up]))
    return up[order], np.abs(motion.poles[up[order]])


def excitation(fit: ReleaseFit) -> tuple[Array, Array]:
    """How strongly every release sets off every mode.

    Returns
    -------
    shares
        Amplitude of each mode at the beginning of the decay over the sum of all, in loads over their sizes; shape
        (releases, modes).
    visibility
        Root of the energy of each mode over the noise of one reading, shape (releases, modes).
    """
    motion, whitener, n = fit.motion, whitener_of(fit.noise), fit.size
    up, _ = pairs(motion)
    amplitude, energy = [], []
    for segment, own, linear in zip(fit.segments, fit.own, fit.linears, strict=True):
        sizes = motion.sizes(*state_at_the_edge(segment, own))
        begin = segment.edge[1] if segment.kind == "free" else float(own[2 * n])
        waves = 2 * motion.felt[:, up] * sizes[up]
        amplitude.append(np.linalg.norm(waves, axis=0))
        time = segment.time[-linear.ringing.shape[0] :] - begin
        # the mean over a cycle: half the square of the amplitude
        fall = np.sum(np.exp(2 * time[:, None] * motion.poles[up].real), axis=0)
        energy.append(np.linalg.norm(whitener @ waves, axis=0) ** 2 / 2 * fall)
    table = np.array(amplitude)
    return table / table.sum(axis=1, keepdims=True), np.sqrt(np.array(energy))


def physical_covariance(information: Array, matrices: Array, units: Units) -> Array:
    """Covariance of A and D [SI], row by row, from information on A^-1 and A^-1 D."""
    slopes = physical_slopes(matrices, units)
    size = np.linalg.norm(information, axis=0)
    root = np.linalg.solve((information / size).T, (slopes / size).T)  # triangular: covariance is root' root
    return root.T @ root


def physical_slopes(matrices: Array, units: Units) -> Array:
    """Derivatives of A and D [SI], row by row, by A^-1 and A^-1 D in the units of the fit, shape (2 N^2, 2 N^2)."""
    n = coordinates_of(matrices)
    spring, brake = matrices.reshape(2, n, n)
    A = np.linalg.inv(spring)
    D = A @ brake
    slopes = np.zeros((2 * n * n, 2 * n * n))
    slopes[: n * n, : n * n] = -np.kron(A, A.T)
    slopes[n * n :, : n * n] = -np.kron(A, D.T)
    slopes[n * n :, n * n :] = np.kron(A, np.eye(n))
    ratio = units.ratio(n).ravel()
    return np.asarray(slopes * np.concatenate([ratio / units.rate**2, ratio / units.rate])[:, None])


def advice(
    fit: ReleaseFit,
    units: Units,
    dynamics: CoupledDynamics,
    *,
    step: Array,
    applied: Array,
    duration: float,
    rate: float,
) -> ReleaseAdvice:
    """Predict the force error with one release more, along each component in turn.

    Parameters
    ----------
    fit, units, dynamics
        What was found.
    step
        Load let go along each component, shape (n,) [N, N*m].
    applied
        Rms of the load for which the force error is predicted, shape (n,) [N, N*m].
    duration, rate
        Length [s] and sampling rate [Hz] of the further record.
    """
    n, components = fit.size, dynamics.components
    weights = force_weights(dynamics, sizes=applied)
    held = min(0.05, duration / 10)
    time = (np.arange(round(duration * rate)) / rate - held) * units.rate
    whitener, motion = whitener_of(fit.noise), fit.motion
    errors = []
    for number in range(n):
        own = np.zeros(2 * n + 1)
        own[n + number] = step[number] / units.sizes[number]
        segment = Segment("", time, np.zeros((time.size, n)), "release", (0.0, 0.0), fit.internal)
        block = linearise(segment, motion, own, whitener=whitener).block
        rows = np.vstack([fit.information, of_matrices(block, segment.own)[:, :-1]])
        information = np.asarray(np.linalg.qr(rows, mode="r"))
        errors.append(error_of(physical_covariance(information, fit.matrices, units), weights))
    table = np.array(errors)
    best = int(np.argmin(np.max(table / units.sizes, axis=1)))
    return ReleaseAdvice(components, step, table, components[best])
