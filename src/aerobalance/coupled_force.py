"""From the loads felt to the forces and moments applied, where the components ring together.

Eq. (17) of [Gorbushin2020]_ with matrices, F = X + D X' + A X'' - W + M x1''. Every component is taken apart from the
others (`aerobalance.decoupling`) and then worked out as one component is: same estimator, same steps, same warnings.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.channel import Array
from aerobalance.components import STANDARD_GRAVITY
from aerobalance.coupled import CoupledDynamics
from aerobalance.coupled_record import CoupledRecord, bridged, load_felt
from aerobalance.estimate import ForceEstimate
from aerobalance.force import Method, estimated
from aerobalance.hum import Hum
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
) -> dict[str, ForceEstimate]:
    """Work out the forces and moments applied; the settings are those of `aerobalance.force.reconstruct`.

    Parameters
    ----------
    recording
        Loads felt of all components, and the ground's motion and attitude where they are recorded.
    dynamics
        Inertia and damping of the components, with their covariance, and the moving mass.

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
    filled, present = bridged(record.loads), np.isfinite(record.loads)

    def worked_out(filled: Array) -> dict[str, ForceEstimate]:
        jobs = record.jobs(filled)
        return {name: estimated(job, method=method, bandwidth=bandwidth, hum=hum) for name, job in jobs.items()}

    found = worked_out(filled)
    for _ in range(PASSES if record.rings_together and not present.all() else 0):
        force = np.column_stack([estimate.values for estimate in found.values()])
        felt = load_felt(dynamics, force, interval=record.interval) + record.from_ground
        left = _free_motion(dynamics, filled - felt, present, interval=record.interval)
        better = np.where(present, record.loads, felt + left)
        noise = np.array([estimate.noise for estimate in found.values()])
        if (np.abs(better - filled) < SETTLED * noise).all():
            break
        filled = better
        found = worked_out(filled)
    return found


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
