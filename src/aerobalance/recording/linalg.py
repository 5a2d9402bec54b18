"""Linear algebra of covariances."""

from __future__ import annotations

import numpy as np

from aerobalance.recording.channel import Array


def root_of(covariance: Array) -> Array:
    """A root of a covariance, shape (p, rank): worked out from the correlations, as the units lie decades apart."""
    deviation = np.sqrt(np.diag(covariance))
    unit = np.where(deviation > 0, deviation, 1.0)
    level, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    kept = level > 1e-14 * max(float(level.max(initial=0.0)), 0.0)
    return np.asarray(unit[:, None] * vectors[:, kept] * np.sqrt(level[kept]))
