"""What no calibration can do better than."""

from __future__ import annotations

import numpy as np

from aerobalance.balance import _term_kernels as kernels
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.terms import codes
from aerobalance.recording.channel import Array
from aerobalance.simulation.calibration_stand import CAPACITIES, SimulatedCalibration


def tare_bound(balance: BalanceMatrix, run: SimulatedCalibration, *, noise: float) -> Array:
    """Covariance that no unbiased estimate can be below (Cramer-Rao), of tares over capacity, in order (s, c).

    From the full Jacobian of all readings by all coefficients, all tares and the natural zeros; `noise` is that of a
    reading [mV/V].
    """
    schedule = run.schedule
    x = np.ascontiguousarray((schedule.loads + run.tares[schedule.series]) / CAPACITIES)
    H = kernels.design(*codes(balance.terms), x)
    J = kernels.jacobians(*codes(balance.terms), balance.coefficients, x)
    (n, p), c, s = H.shape, 6, len(schedule.series_names)
    A = np.zeros((c * (n + 1), c * (p + s + 1)))
    for i in range(c):
        rows = slice(i * n, (i + 1) * n)
        A[rows, i * p : (i + 1) * p] = H
        for m in range(c):
            A[np.arange(n) + i * n, c * p + schedule.series * c + m] = J[:, i, m]
        A[rows, c * (p + s) + i] = 1
        A[c * n + i, c * (p + s) + i] = np.sqrt(len(schedule.natural_zeros))
    A *= np.concatenate([np.repeat(balance.output_scale, n), balance.output_scale])[:, None] / noise
    covariance = np.linalg.inv(A.T @ A)
    return covariance[c * p : c * (p + s), c * p : c * (p + s)]
