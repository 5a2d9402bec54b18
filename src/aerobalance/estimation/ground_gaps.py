"""What a channel of the ground's motion has missed within a gap, by what the load shows of it.

The balance load under every error that a gap may hide (`aerobalance.motion.gaps`) is a known shape of a size that is
drawn from a normal distribution of variance 1. With the force as the process that was learned, the readings tell these
sizes by generalised least squares, and how well.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeGuard

import numpy as np

from aerobalance.estimation.force_smoother import SmootherResult, instant_columns
from aerobalance.estimation.independent_record import SingleRecord, moves_along_axis
from aerobalance.estimation.least_squares import whitened
from aerobalance.estimation.record import ComponentRecord
from aerobalance.motion.gaps import GAP
from aerobalance.motion.platform import SystematicParameter


def has_hidden_motion(record: ComponentRecord) -> TypeGuard[SingleRecord]:
    """Return whether something of the ground's motion is hidden in a gap that the load can tell."""
    return moves_along_axis(record) and any(_in_gap(item) for item in record.unknowns)


def with_hidden_motion(record: SingleRecord, fit: SmootherResult) -> SingleRecord:
    """Return a record with what its gaps hide of the ground's motion as the load shows it, and what is left unknown.

    Parameters
    ----------
    record
        The component with its record.
    fit
        Its force, from the readings of this record or from nearly those: its prior and its steps count.

    Raises
    ------
    FitError
        The readings cannot be whitened.
    """
    hidden = [item for item in record.unknowns if _in_gap(item)]
    felt = np.column_stack([record.felt_under(item) for item in hidden])
    reading = record.reading(hum=fit.reading.hum, tones=fit.reading.tones, drift=fit.reading.drift)
    known = instant_columns(fit.reading, fit.steps, heights=[step.height for step in fit.steps])[0]
    series = whitened(fit.filter, reading.filled, np.column_stack([known, felt]))
    values, shapes = series[:, 0], series[:, 1:]
    free = np.arange(shapes.shape[1]) < known.shape[1]
    scale = np.where(free, np.maximum(np.sqrt(np.einsum("np,np->p", shapes, shapes)), 1e-300), 1.0)
    information = (shapes / scale).T @ (shapes / scale) + np.diag(np.where(free, 1e-12, 1.0))
    covariance = np.linalg.inv(information)[~free][:, ~free]
    sizes = np.linalg.solve(information, (shapes / scale).T @ values)[~free]
    slopes = np.column_stack([item.slope for item in hidden])
    level, turned = np.linalg.eigh(covariance)
    left = slopes @ (turned * np.sqrt(np.maximum(level, 0.0)))
    unknowns = [item for item in record.unknowns if not _in_gap(item)]
    unknowns += [replace(item, slope=slope) for item, slope in zip(hidden, left.T, strict=True)]
    motion = replace(
        record.motion, specific_force=record.motion.specific_force + slopes @ sizes, unknowns=tuple(unknowns)
    )
    return replace(record, motion=motion)


def _in_gap(item: SystematicParameter) -> bool:
    return item.name.startswith(GAP)
