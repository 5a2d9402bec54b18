"""From the loads felt to the forces and moments applied, where the components ring together.

Eq. (17) of [Gorbushin2020]_ with matrices, F = X + D X' + A X'' - W + M x1''. Every component is taken apart from the
others (`aerobalance.decoupling`) and then worked out as one component is: same estimator, same steps, same warnings.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.channel import Array
from aerobalance.components import STANDARD_GRAVITY
from aerobalance.coupled import CoupledDynamics
from aerobalance.coupled_record import CoupledRecord, bridged, load_felt
from aerobalance.estimate import ForceEstimate
from aerobalance.force import Method, estimated, noise_of_job
from aerobalance.hum import Hum
from aerobalance.noise_spectrum import NoiseSpectrum
from aerobalance.recording import Recording

PASSES: Final = 2
"""Most times that gaps are filled anew by what the forces found make the balance read."""

SETTLED: Final = 5.0
"""Change of what fills a gap, over the noise of a reading, which no force would notice."""


def reconstruct_coupled(
    recording: Recording,
    dynamics: CoupledDynamics,
    *,
    method: Method = "smoother",
    bandwidth: float | None = None,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
    hum: Hum = "mains",
    noise: Mapping[str, NoiseSpectrum] | None = None,
) -> dict[str, ForceEstimate]:
    """Work out the forces and moments applied; the settings are those of `aerobalance.force.reconstruct`.

    Parameters
    ----------
    recording
        Loads felt of all components, and the ground's motion and attitude where they are recorded.
    dynamics
        Inertia and damping of the components, with their covariance, and the moving mass.
    noise
        Spectra of the noise of the components taken apart, as `noise_of_coupled` finds them for this recording.

    Returns
    -------
    estimates
        By component, in the order of the dynamics.

    Raises
    ------
    FitError
        A component that the others ring with is not in the recording, or the recording is too short.
    """
    record = CoupledRecord.of(recording, dynamics, gravity=gravity, gravity_uncertainty=gravity_uncertainty)
    filled = bridged(record.loads)

    def worked_out(filled: Array) -> dict[str, ForceEstimate]:
        jobs = record.jobs(filled, noises=noise)
        return {name: estimated(job, method=method, bandwidth=bandwidth, hum=hum) for name, job in jobs.items()}

    found = worked_out(filled)
    for _ in range(PASSES if record.rings_together and not np.isfinite(record.loads).all() else 0):
        better = filled_by(found, record, filled=filled)
        noises = np.array([estimate.noise for estimate in found.values()])
        if (np.abs(better - filled) < SETTLED * noises).all():
            break
        filled = better
        found = worked_out(filled)
    return found


def noise_of_coupled(
    calm: Recording,
    dynamics: CoupledDynamics,
    *,
    run: Recording,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
) -> dict[str, NoiseSpectrum]:
    """Spectra of the noise of the components taken apart, from a record of noise alone: wind off, balance at rest.

    What a component taken apart has of noise is what its balance makes of the noise of all channels that have a part
    in it. So the record of noise goes through the very balances that the run is taken apart with, which depend on the
    white noise of the run's channels, and the spectrum is learned from what they read.

    Parameters
    ----------
    calm
        The record of noise, with the sampling rate, gains and filters of the run.
    dynamics
        The coupled components.
    run
        The recording that the spectra are for.
    gravity, gravity_uncertainty
        Local acceleration of gravity and its standard uncertainty [m/s^2].

    Raises
    ------
    FitError
        A recording lacks a component or is too short, or the record of noise shows none.
    """
    settings = {"gravity": gravity, "gravity_uncertainty": gravity_uncertainty}
    noise = CoupledRecord.of(run, dynamics, **settings).noise
    record = CoupledRecord.of(calm, dynamics, **settings).taken_with(dynamics, noise=noise)
    return {name: noise_of_job(job) for name, job in record.jobs(bridged(record.loads)).items()}


def filled_by(found: Mapping[str, ForceEstimate], record: CoupledRecord, *, filled: Array) -> Array:
    """Readings with their gaps filled by what forces make the balance read, shape (samples, n).

    Parameters
    ----------
    found
        The forces of all components.
    record
        The record.
    filled
        The readings with what the gaps were filled with before, shape (samples, n).
    """
    present = np.isfinite(record.loads)
    force = np.column_stack([found[name].values for name in record.dynamics.components])
    felt = load_felt(record.dynamics, force, interval=record.interval) + record.from_ground
    left = _free_motion(record.dynamics, filled - felt, present, interval=record.interval)
    return np.where(present, record.loads, felt + left)


def _free_motion(dynamics: CoupledDynamics, left: Array, present: NDArray[np.bool_], *, interval: float) -> Array:
    """Free motion of the balance that explains best what is left of the readings, shape (samples, n)."""
    poles, shapes, _ = dynamics.modal_form
    up = poles.imag >= 0
    time = np.arange(left.shape[0]) * interval
    columns = []
    for pole, shape in zip(poles[up], shapes.T[up], strict=True):
        swing = np.exp(pole * time)[:, None] * shape
        columns += [swing.real, swing.imag]
    size = np.maximum(left.std(axis=0), 1e-60)
    basis = np.stack([column / size for column in columns], axis=-1)
    found, *_ = np.linalg.lstsq(basis[present], (left / size)[present], rcond=1e-10)
    return np.asarray(basis @ found * size)
