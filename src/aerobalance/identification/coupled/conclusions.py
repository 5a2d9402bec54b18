"""What is asked of recordings, and what follows from fitted matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.coupled.combinations import (
    pairs,
)
from aerobalance.identification.coupled.free_response import Complex, FreeMotion
from aerobalance.identification.coupled.internal_coordinates import quasi_static
from aerobalance.identification.coupled.least_squares import whitener_of
from aerobalance.identification.rigid_body import RigidMassFit, rigid_mass_of
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording


def check_recordings(
    recordings: Sequence[Recording], names: tuple[str, ...], components: Sequence[str], *, of: str
) -> None:
    """Refuse no recordings, components that are not known or named twice, and several sampling rates."""
    if not recordings:
        raise ValueError(f"at least one recording of {of} is needed")
    if not names or len(names) != len(components):
        raise ValueError(f"components must be some of {', '.join(COMPONENTS)}, each once, not {', '.join(components)}")
    rates = [recording.rate for recording in recordings]
    if max(rates) > 1.001 * min(rates):
        raise ValueError(f"the recordings must have one sampling rate, not {min(rates):g} to {max(rates):g} Hz")


def excitation_of(parts: Sequence[tuple[Complex, Array]], motion: FreeMotion, noise: Array) -> tuple[Array, Array]:
    """How strongly the records excite the modes.

    Parameters
    ----------
    parts
        For every record the size of every mode where its free motion begins, shape (2 N,), and the times since then of
        the readings used.
    motion
        The motion fitted.
    noise
        Covariance of the noise of a row, shape (n, n).

    Returns
    -------
    shares
        Amplitude of each mode at the beginning over the sum of all, in loads over their sizes; shape (records, modes).
    visibility
        Root of the energy of each mode over the noise of one reading, shape (records, modes).
    """
    whitener, (up, _) = whitener_of(noise), pairs(motion)
    amplitude, energy = [], []
    for sizes, since in parts:
        waves = 2 * motion.felt[:, up] * sizes[up]
        amplitude.append(np.linalg.norm(waves, axis=0))
        # the mean over a cycle: half the square of the amplitude
        fall = np.sum(np.exp(2 * since[:, None] * motion.poles[up].real), axis=0)
        energy.append(np.linalg.norm(whitener @ waves, axis=0) ** 2 / 2 * fall)
    table = np.array(amplitude)
    return table / table.sum(axis=1, keepdims=True), np.sqrt(np.array(energy))


def residual_size(
    residuals: Array, *, degrees_of_freedom: int, sizes: Array, noises: Sequence[Array]
) -> tuple[Array, Array]:
    """Standard deviation of the residuals, shape (n,) [N, N*m], and their variance over that of the noise.

    Parameters
    ----------
    residuals
        Readings less fit, over the sizes, shape (m, n).
    degrees_of_freedom
        Readings used less parameters.
    sizes
        Unit of the residuals, shape (n,) [N, N*m].
    noises
        Noise of every record as given or judged, shape (n,) each [N, N*m].
    """
    squares = np.sum(residuals**2, axis=0)
    deviation = np.sqrt(squares * sizes.size / max(degrees_of_freedom, 1)) * sizes
    noise = np.sqrt(np.mean([one**2 for one in noises], axis=0))
    return deviation, (deviation / noise) ** 2


def colour_of(parts: Sequence[tuple[Array, float]], motion: FreeMotion, noise: Array) -> Array:
    """Power of the residuals within an eighth of the modes' frequencies over that of white noise, shape (n,).

    Parameters
    ----------
    parts
        Residuals while the balance rings, shape (m, n), and the time between their rows.
    motion
        The motion fitted.
    noise
        Covariance of the noise of a row, shape (n, n).
    """
    n = motion.components
    _, rates = pairs(motion)
    near, whole, ordinates = np.zeros(n), np.zeros(n), 0
    for left, interval in parts:
        power = np.abs(np.fft.rfft(left, axis=0)[1:]) ** 2
        rate = 2 * np.pi * np.arange(1, power.shape[0] + 1) / (left.shape[0] * interval)
        band = (np.abs(rate[:, None] / rates - 1) < 1 / 8).any(axis=1)
        near += power[band].sum(axis=0)
        whole += power.mean(axis=0) * np.count_nonzero(band)
        ordinates += int(np.count_nonzero(band))
    if ordinates < 12 or (whole == 0).any() or (np.sqrt(np.diag(noise)) < 1e-9).any():
        return np.ones(n)
    level = near / whole
    return np.where(level > 1 + 4 / np.sqrt(ordinates), level, 1.0)


def rigid_of(
    dynamics: CoupledDynamics, mass: float | tuple[float, float] | None
) -> tuple[RigidMassFit | None, list[str]]:
    """Return the rigid mass, where a weighed mass is given, and what is doubtful about it."""
    if mass is None:
        return None, []
    value, uncertainty = mass if isinstance(mass, tuple) else (mass, 0.0)
    try:
        rigid = rigid_mass_of(quasi_static(dynamics), value, u_mass=uncertainty)
    except (FitError, ValueError) as problem:
        return None, [f"no mass matrix: {problem}; gravity and ground motion cannot be taken out of the loads"]
    if dynamics.internal:
        return replace(rigid, reciprocity=None), _note_on_bending(rigid)
    notes = []
    if rigid.rigidity is not None and not rigid.rigidity.chance:
        notes.append(
            f"the inertia matrix is not that of a rigid mass on a symmetric stiffness (chi2 {rigid.rigidity.chi2:.3g} "
            "for 6 degrees of freedom); the mass matrix found from it is only nearly right"
        )
    if rigid.reciprocity is not None and not rigid.reciprocity.chance:
        notes.append(
            f"the damping is not symmetric (chi2 {rigid.reciprocity.chi2:.3g} for 15 degrees of freedom), as it is "
            "not in a flow or with friction; the constrained dynamics do not hold"
        )
    return rigid, notes


def _note_on_bending(rigid: RigidMassFit) -> list[str]:
    """What is doubtful about a mass matrix from slow motion, below modes of the model or sting."""
    if rigid.rigidity is None or rigid.rigidity.chance:
        return []
    text = (
        "the mass matrix is taken from slow motion, below the modes of the model or sting, and is not that of a rigid "
        f"mass on a symmetric stiffness (chi2 {rigid.rigidity.chi2:.3g} for 6 degrees of freedom), as where the model "
        "bends under the load; the mass matrix found from it is only nearly right"
    )
    return [text]
