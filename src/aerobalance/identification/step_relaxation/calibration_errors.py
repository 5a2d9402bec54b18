"""What the calibration of the balance leaves in matrices that are found from releases.

An error of the balance matrix changes the loads of all releases alike. What the fit makes of a change of its readings
is its last Gauss-Newton step, (J' W J)^-1 J' W dX, with the own parameters of every release free as they were in the
fit: no release is fitted anew. So the errors of the matrices are linear in those of the coefficients, the linear part
of an error E of the loads, A + E A - A E, and what is curved alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aerobalance.balance.matrix_errors import MatrixErrors, coefficient_covariance
from aerobalance.identification.coupled.least_squares import whitener_of
from aerobalance.identification.coupled.units import Units, physical_slopes
from aerobalance.identification.step_relaxation.fit import ReleaseFit
from aerobalance.identification.step_relaxation.model import reading_slopes
from aerobalance.identification.step_relaxation.record import ReleaseRecord
from aerobalance.recording.channel import Array


def covariance_of_calibration(
    fit: ReleaseFit,
    units: Units,
    records: Sequence[ReleaseRecord],
    errors: Sequence[MatrixErrors],
    *,
    components: tuple[str, ...],
) -> Array:
    """Covariance of A and D [SI], row by row, that a balance matrix leaves, shape (2 N^2, 2 N^2).

    The arguments are those of `coefficient_slopes`.
    """
    slopes = coefficient_slopes(fit, units, records, errors, components=components)
    found = slopes @ coefficient_covariance(errors[0].matrix) @ slopes.T
    return (found + found.T) / 2


def coefficient_slopes(
    fit: ReleaseFit,
    units: Units,
    records: Sequence[ReleaseRecord],
    errors: Sequence[MatrixErrors],
    *,
    components: tuple[str, ...],
) -> Array:
    """Change of A and D [SI], row by row, with each coefficient of the balance matrix that the loads are found by.

    Parameters
    ----------
    fit, units, records
        What was found, and from what.
    errors
        Where the one matrix was used, release by release.
    components
        Names of the loads of the fit.

    Returns
    -------
    slopes
        Shape (2 N^2, c t), in the order of `coefficient_covariance`.
    """
    parts = []
    for number, (record, error) in enumerate(zip(records, errors, strict=True)):
        changes = _changes(fit, number, record, error, sizes=units.sizes, components=components)
        own, factor = fit.segments[number].own, fit.linears[number].block
        # what the own parameters of the release take up is no change of the matrices
        taken = np.linalg.solve(factor[:own, :own].T, changes[:own])
        parts.append(changes[own:] - factor[:own, own:-1].T @ taken)
    total = np.sum(parts, axis=0)
    information = fit.information
    size = np.linalg.norm(information, axis=0)
    root = information / size
    step = np.linalg.solve(root, np.linalg.solve(root.T, total / size[:, None])) / size[:, None]
    return np.asarray(physical_slopes(fit.matrices, units) @ step)


def _changes(
    fit: ReleaseFit,
    number: int,
    record: ReleaseRecord,
    error: MatrixErrors,
    *,
    sizes: Array,
    components: tuple[str, ...],
) -> Array:
    """J' W dX of one release by the errors of the coefficients, shape (parameters, c t)."""
    segment, whitener = fit.segments[number], whitener_of(fit.noise)
    found = reading_slopes(segment, fit.motion, fit.own[number])
    rows = np.rint(record.time * record.rate).astype(np.intp)
    n, weight = sizes.size, whitener.T @ whitener / sizes
    wide = len(error.matrix.components) * len(error.matrix.terms)
    held: Array = np.zeros((n, wide))
    ringing: Array = np.zeros((found.columns.shape[1] * n, wide))
    for part in error.parts(rows, components):
        time = np.arange(part.rows.start, part.rows.stop)
        before, after = time < found.held.stop, time >= found.ringing.start
        gain = (weight @ part.gain).reshape(time.size, -1)
        held += (gain[before].T @ part.terms[before]).reshape(held.shape)
        columns = found.columns[time[after] - found.ringing.start]
        both = (columns[:, :, None] * gain[after][:, None, :]).reshape(len(columns), columns.shape[1] * gain.shape[1])
        ringing += (both.T @ part.terms[after]).reshape(ringing.shape)
    slopes = found.slopes.reshape(-1, found.slopes.shape[2])
    changes = slopes.T @ ringing
    if segment.kind != "free":
        changes[n : 2 * n] += held
    return changes
