"""Balance loads of gauge outputs, as dynamics are identified from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aerobalance.balance.calibration.fit import Calibration, matrix_of
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.reduction import OutputReduction
from aerobalance.balance.weighing.result import Weighing
from aerobalance.balance.weight_on_zero import NotWeighed
from aerobalance.balance.zeros import Zero
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.recording import Recording


def identification_loads(
    recordings: Sequence[Recording],
    balance: BalanceMatrix | Calibration,
    *,
    zero: Zero | None = None,
    tare: Sequence[Recording] = (),
    weighing: Weighing | None = None,
    calibration_counts: bool = True,
) -> list[Loads]:
    """Balance loads [N, N*m] of recordings of gauge outputs that dynamics are to be identified from.

    What hangs on the balance does not change the ringing. But bridges that are curved ring as where they are, so the
    weight in a zero that was read with the model on is put back, as far as a weighing or natural zeros tell it.

    Parameters
    ----------
    recordings
        Gauge outputs.
    balance
        The balance matrix, or its calibration.
    zero
        What the outputs count from.
    tare
        Wind-off recordings whose loads are taken off.
    weighing
        What hangs on the balance; None where it is not known.
    calibration_counts
        Whether what the calibration leaves is to be counted, for which the matrix must hold it.
    """
    matrix = matrix_of(balance)
    gravity = STANDARD_GRAVITY if weighing is None else weighing.gravity
    model = NotWeighed() if weighing is None else weighing
    reduction = OutputReduction(matrix, zero=zero, model=model, tare=tare, gravity=gravity)
    found = [reduction.loads(one) for one in recordings]
    if calibration_counts and not matrix.covariance.any():
        warn_quality(
            "the balance matrix holds no covariance of its coefficients; what its calibration leaves in the dynamics "
            "is not known"
        )
    return found


def with_sensitivity_error(loads: Loads, component: str) -> Recording:
    """The recording of balance loads, with what the calibration leaves of a sensitivity as uncertainty of its gain."""
    channel, place = loads.recording.channel(component), loads.components.index(component)
    size = float(np.ptp(channel.values)) / 2
    alone = np.asarray(np.linalg.inv(loads.transform)[:, place] * size, dtype=np.float64)
    covariance = loads.balance.load_covariance(alone[None, :], residual=False)[0]
    own = loads.transform[place]
    relative = float(np.sqrt(max(own @ covariance @ own, 0.0))) / size if size > 0 else 0.0
    known = replace(channel, relative_uncertainty=float(np.hypot(channel.relative_uncertainty, relative)))
    return replace(loads.recording, channels={**loads.recording.channels, component: known})
