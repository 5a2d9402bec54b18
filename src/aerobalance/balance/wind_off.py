"""Loads of wind-off recordings at the attitude of a run, to take off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.load_formats import Form
from aerobalance.balance.loads import loads_of_outputs
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.steady_means import mean_of_records, variance_of_mean
from aerobalance.balance.weight_on_zero import SHARED_PITCH
from aerobalance.balance.zeros import GaugeZero
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording


def wind_off_loads(
    recording: Recording,
    wind_off: Sequence[Recording],
    balance: BalanceMatrix,
    *,
    zero: GaugeZero | None = None,
    form: Form | None = None,
) -> tuple[Array, Array]:
    """Loads of wind-off recordings, at the attitude of a run: values and standard uncertainty, shape (n, c).

    The uncertainty is that of a mean, by batch means, as that of a zero.

    The mean loads of the wind-off recordings are joined by straight lines over pitch; those at one pitch give their
    mean. Recordings at one pitch only, or without pitch, give one constant tare.

    Raises
    ------
    FitError
        The run goes beyond the pitch angles of the wind-off recordings, or one of them has no samples.
    """
    results = [loads_of_outputs(item, balance, zero=zero, form=form) for item in wind_off]
    known = [result.values[np.isfinite(result.values).all(axis=1)] for result in results]
    for item, table in zip(wind_off, known, strict=True):
        if len(table) < 2:
            raise FitError(f"{item.name}: fewer than two samples have all loads; record more for a tare")
    means = np.array([table.mean(axis=0) for table in known])
    variances = np.array([variance_of_mean(table) for table in known])
    if not all("pitch" in item for item in (recording, *wind_off)):
        found = mean_of_records(means, variances)
        return found.values[None, :], np.sqrt(found.variance)[None, :]
    angles = np.array([float(np.nanmean(item.channel("pitch").values)) for item in wind_off])
    pitch = recording.channel("pitch").values
    least, most = (float(np.degrees(limit)) for limit in (np.nanmin(pitch), np.nanmax(pitch)))
    first, last = float(np.degrees(angles.min())), float(np.degrees(angles.max()))
    slack = float(np.degrees(SHARED_PITCH))
    if least < first - slack or most > last + slack:
        raise FitError(
            f"{recording.name}: pitch goes from {least:.4g} to {most:.4g} deg, but the wind-off recordings cover "
            f"{first:.4g} to {last:.4g} deg; add "
            "wind-off recordings, or weigh the model and give its mass.json instead"
        )
    alike = _at_one_pitch(angles)
    merged = [mean_of_records(means[rows], variances[rows]) for rows in alike]
    values, us = np.array([one.values for one in merged]), np.sqrt([one.variance for one in merged])
    if len(alike) == 1:
        return values, us
    knots = [float(angles[rows].mean()) for rows in alike]
    columns = [np.column_stack([np.interp(pitch, knots, column) for column in table.T]) for table in (values, us)]
    return columns[0], columns[1]


def _at_one_pitch(angles: Array) -> list[NDArray[np.intp]]:
    """Places of the angles that are the same but for what a model at rest moves, from the least angle to the largest.

    Between two of them a line through their loads would have the slope of their scatter.
    """
    order = np.argsort(angles, kind="stable")
    groups: list[list[int]] = []
    for place in order.tolist():
        if groups and angles[place] - angles[groups[-1][0]] <= SHARED_PITCH:
            groups[-1].append(place)
        else:
            groups.append([place])
    return [np.array(group, dtype=np.intp) for group in groups]
