r"""A release in a record whose dynamics are known: found, and fitted as a free decay once more.

Most records are no release, and a search for lines in what a free decay leaves of them takes minutes. So it is first
looked, without any search, whether a release can explain a record at all. Of n samples of a sum of r decaying waves a
Hankel matrix has rank 2 r, and no matrix of that rank is nearer to the one of the readings than its own largest
singular vectors are [Eckart1936]_: what these leave is the least that any fit leaves.

References
----------
.. [Eckart1936] C. Eckart, G. Young, "The approximation of one matrix by another of lower rank", Psychometrika 1 (1936)
   211.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from aerobalance.estimation.record import SingleRecord
from aerobalance.identification.free_decay.event import Look, first_look
from aerobalance.identification.free_decay.fit import SETTINGS as DECAY
from aerobalance.identification.free_decay.fit import DecayFit, identify_decay
from aerobalance.identification.free_decay.waveform import fit_ring
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording


@dataclass(frozen=True, slots=True)
class ReleaseSettings:
    """Thresholds of the search for a release.

    Attributes
    ----------
    explained
        Residuals of a release over the noise of the readings up to which it is explained.
    near
        Periods either side of a release over which it is looked whether it is one.
    margin
        Periods either side of its first estimate in which a release may really be, and last.
    released
        Share of a record's variance that a release of one mode leaves over at most.
    fewest
        Samples of a part at least of which it is looked what waves leave.
    most
        Means of samples, one after the other, by which a longer part is taken.
    """

    explained: float = 1.2
    near: float = 40.0
    margin: float = 4.0
    released: float = 0.1
    fewest: int = 64
    most: int = 512


SETTINGS: Final = ReleaseSettings()
"""Thresholds that are used."""


def release_in(record: SingleRecord, values: Array, *, noise: float) -> DecayFit | None:
    """Return the readings as a free decay, where that explains them down to their noise, else None.

    Parameters
    ----------
    record
        The component with its record and dynamics.
    values
        Readings without a gap, shape (n,) [N].
    noise
        Standard uncertainty of a reading [N].
    """
    recording, name = record.recording, record.dynamics.component
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        try:
            look = first_look(values, rate=recording.rate, name=recording.name)
            if look.shape != "release":
                return None
            part = _part_explained(values, look, noise=noise)
            if part is None:
                return None
            values = values[part]
            channel = replace(recording.channel(name), values=values)
            time = np.arange(values.size) / recording.rate
            alone = Recording.from_columns(time, {name: channel}, name=recording.name)
            fit = identify_decay(alone, component=name, mass=record.dynamics.mass, modes="auto")
        except FitError:
            return None
    return fit if fit.release is not None and fit.residual_deviation < SETTINGS.explained * noise else None


def _part_explained(values: Array, look: Look, *, noise: float) -> slice | None:
    """The longest part of a record about a release that a release may explain; None where it is none."""
    time, reach = np.arange(values.size) / look.rate - look.start, SETTINGS.near / look.frequency
    near = np.abs(time) < reach
    if not _may_be_a_release(values[near], time[near], look, noise=noise):
        return None
    ring = fit_ring(time[near] + look.start, values[near], look)
    if ring.variance > SETTINGS.released * float(np.var(values[near])):
        return None
    while not near.all():
        reach *= 2
        wider = np.abs(time) < reach
        if not _may_be_a_release(values[wider], time[wider], look, noise=noise):
            break
        near = wider
    inside = np.flatnonzero(near)
    return slice(int(inside[0]), int(inside[-1]) + 1)


def _may_be_a_release(values: Array, time: Array, look: Look, *, noise: float) -> bool:
    """Whether a release of as many modes and lines as are looked for may explain readings down to their noise.

    Before it there are a level, a drift and lines; after it the ringing as well, which may bend.
    """
    margin = SETTINGS.margin / look.frequency
    sides: tuple[tuple[NDArray[np.bool_], int], ...] = (
        (time < -margin, 1 + DECAY.most_lines),
        (time > margin, 3 + DECAY.most_lines),
    )
    left = [least_left(values[side], waves=waves) for side, waves in sides]
    return sum(left) < (SETTINGS.explained * noise) ** 2 * values.size


def least_left(values: Array, *, waves: int) -> float:
    """Return a sum of squares [N^2] that no sum of so many decaying waves leaves less of readings than.

    Parameters
    ----------
    values
        Readings, shape (n,) [N].
    waves
        Number of waves; a level with a drift counts as one.
    """
    if values.size < max(SETTINGS.fewest, 4 * waves + 4):
        return 0.0
    # means of samples have no more squares, times the number of samples in each, than the samples
    width = -(-values.size // SETTINGS.most)
    means = values[: values.size - values.size % width].reshape(-1, width).mean(axis=1)
    means = means - means.mean()
    rows = sliding_window_view(means, means.size // 2)
    singular = np.linalg.svd(rows, compute_uv=False)
    # no sample stands in more places of the matrix than it has rows or columns
    return float(width * np.sum(singular[2 * waves :] ** 2) / min(rows.shape))
