"""What a set of releases tells, what it leaves open, and which release would help most."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.coupled.combinations import STILL, plainest
from aerobalance.identification.coupled.conclusions import excitation_of
from aerobalance.identification.coupled.least_squares import of_matrices, whitener_of
from aerobalance.identification.coupled.units import Units, physical_covariance
from aerobalance.identification.force_error import error_of, force_weights
from aerobalance.identification.step_relaxation.fit import ReleaseFit
from aerobalance.identification.step_relaxation.model import Segment, linearise, state_at_the_edge
from aerobalance.identification.step_relaxation.record import ReleaseRecord
from aerobalance.identification.step_relaxation.release_result import ReleaseAdvice
from aerobalance.recording.channel import Array


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


def excitation(fit: ReleaseFit) -> tuple[Array, Array]:
    """How strongly every release excites every mode, as `excitation_of` has it, (releases, modes) each."""
    motion, n, parts = fit.motion, fit.size, []
    for segment, own, linear in zip(fit.segments, fit.own, fit.linears, strict=True):
        begin = segment.edge[1] if segment.kind == "free" else float(own[2 * n])
        since = segment.time[-linear.ringing.shape[0] :] - begin
        parts.append((motion.sizes(*state_at_the_edge(segment, own)), since))
    return excitation_of(parts, motion, fit.noise)


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
