"""What temperature does to the bridges of a balance, taken out of their outputs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.recording.channel import Array
from aerobalance.recording.recording import Recording


class AtReference(NamedTuple):
    """Gauge outputs as they would be at the temperature of the matrix.

    Attributes
    ----------
    outputs
        Shape (n, c) [mV/V]; NaN where the temperature is missing.
    variance
        Variance that the temperature effects give to each, shape (n, c) [(mV/V)^2], 0 where missing; None where they
        give none.
    """

    outputs: Array
    variance: Array | None


def at_reference_temperature(
    outputs: Array, recording: Recording, balance: BalanceMatrix, *, since_calibration: bool
) -> AtReference:
    """Take out what temperature does to zeros and sensitivities, where both it and its effects are known.

    Parameters
    ----------
    outputs
        Of the bridges, less their zeros, shape (n, c) [mV/V].
    recording
        The run, with its temperature [degC] where that was recorded.
    balance
        The balance matrix.
    since_calibration
        Whether the zeros are those of the calibration, read at the temperature of the matrix, and not of the run.
    """
    if not balance.temperature or "temperature" not in recording:
        return AtReference(outputs, None)
    temperature = recording.channel("temperature").values[:, None]
    effects = [balance.temperature[name] for name in balance.components]
    reference, zero, u_zero, gain, u_gain = np.array(
        [(one.reference, one.zero, one.u_zero, one.sensitivity, one.u_sensitivity) for one in effects]
    ).T
    change = temperature - reference
    # a zero of the run was read at the run's own temperature: only what changes within the run moves it
    mean = recording.extent.means.get("temperature", float(np.nanmean(temperature)))
    moved = change if since_calibration else temperature - mean
    found = np.asarray((outputs - zero * moved) / (1 + gain * change))
    if not (u_zero.any() or u_gain.any()):
        return AtReference(found, None)
    # to first order, the effects taken as independent of each other
    variance = ((u_zero * moved) ** 2 + (u_gain * change * found) ** 2) / (1 + gain * change) ** 2
    return AtReference(found, np.nan_to_num(variance))
