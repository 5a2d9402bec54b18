"""Tare of a run: the mean loads of wind-off recordings at the attitude of the run, to be subtracted from its loads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.load_formats import Form
from aerobalance.balance.loads import Tare
from aerobalance.balance.loads_of_outputs import loads_of_outputs
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.steady_means import correlation_of_means, mean_of_records, variance_of_mean
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
) -> Tare:
    """Return the tare of a run [N, N*m], shape (n, c), or (1, c) where it is constant.

    The mean loads of the wind-off recordings are interpolated linearly over pitch; recordings at the same pitch count
    as one, with the mean of their means. Recordings at one pitch only, or without a pitch channel, give a constant
    tare.

    The uncertainty of each mean comes from batch means, as that of a zero does, since a model at rest sways and its
    readings are not white. Between two pitch angles the standard uncertainty is interpolated as well, as if both
    means erred alike: independent errors would average, so this is an upper bound. Components err together as their
    batch means go together.

    Parameters
    ----------
    recording
        The run, n samples; its pitch says where the tare is wanted.
    wind_off
        Recordings of gauge outputs with the same model and without wind.
    balance
        The matrix, for c components.
    zero
        Gauge zeros; those of the calibration where left out.
    form
        Form of the loads; direct-read, where that is possible, if left out.

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
        return Tare(
            found.values[None, :], np.sqrt(found.variance)[None, :], correlation_of_means(known), from_zero=True
        )
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
    groups = _at_one_pitch(angles)
    merged = [mean_of_records(means[rows], variances[rows]) for rows in groups]
    values, deviations = np.array([one.values for one in merged]), np.sqrt([one.variance for one in merged])
    of_groups = np.array([correlation_of_means([known[row] for row in rows]) for rows in groups])
    if len(groups) == 1:
        return Tare(values, deviations, of_groups[0], from_zero=True)
    knots = [float(angles[rows].mean()) for rows in groups]
    columns = [
        np.column_stack([np.interp(pitch, knots, column) for column in table.T]) for table in (values, deviations)
    ]
    there = pitch[np.isfinite(pitch)]
    shares = [float(np.mean(np.interp(there, knots, one))) for one in np.eye(len(knots))]
    return Tare(columns[0], columns[1], np.tensordot(shares, of_groups, axes=1), from_zero=True)


def _at_one_pitch(angles: Array) -> list[NDArray[np.intp]]:
    """Indices of the recordings [1] in groups of equal pitch [rad], the group with the least pitch first.

    Equal means within `SHARED_PITCH` of the least of the group, by which a model at rest may move: a straight line
    between two such recordings would have a slope made of nothing but the scatter of their means.
    """
    order = np.argsort(angles, kind="stable")
    groups: list[list[int]] = []
    for place in order.tolist():
        if groups and angles[place] - angles[groups[-1][0]] <= SHARED_PITCH:
            groups[-1].append(place)
        else:
            groups.append([place])
    return [np.array(group, dtype=np.intp) for group in groups]
