"""Static loads [N, N*m] of a weighing, averaged from recordings at rest, with their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix_errors import MatrixErrors, covariance_at_points
from aerobalance.balance.steady_means import variance_of_mean
from aerobalance.balance.zeros import in_own_components
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording

PITCH_STEADY: Final = np.radians(0.02)
"""Change of the mean pitch from block to block that still counts as standing still [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadPoints:
    """Static loads [N, N*m] at given attitudes: n points, c components.

    Attributes
    ----------
    components
        Names of the components, in the order of the columns.
    pitch
        Pitch of every point, shape (n,) [rad].
    loads
        Readings, shape (n, c) [N, N*m].
    roll
        Roll of every point, shape (n,) [rad]; None where it was not recorded (then it counts as zero).
    noise
        Standard uncertainty of each reading by itself, shape (n, c) [N, N*m]; zero where it is not known.
    shared
        Covariance of errors that the points share, shape (n, c, n, c) [N^2, N^2*m, N^2*m^2]: those of the balance
        matrix, which go with the load and can pass for a mass, an offset or a tilt. None for none.

    Raises
    ------
    ValueError
        The shapes do not fit, a component is unknown or given twice, or a noise is negative.
    """

    components: tuple[str, ...]
    pitch: Array
    loads: Array
    roll: Array | None = None
    noise: Array | None = None
    shared: Array | None = None

    def __post_init__(self) -> None:
        unknown = [name for name in self.components if name not in COMPONENTS]
        if unknown or len(set(self.components)) < len(self.components) or not self.components:
            raise ValueError(f"components must be some of {', '.join(COMPONENTS)}, each once, not {self.components}")
        count = np.size(self.pitch)
        shapes = {"pitch": (count,), "loads": (count, len(self.components))}
        if self.roll is not None:
            shapes["roll"] = (count,)
        if self.noise is not None:
            shapes["noise"] = shapes["loads"]
        if self.shared is not None:
            shapes["shared"] = shapes["loads"] * 2
        for name, shape in shapes.items():
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.shape != shape:
                raise ValueError(f"{name} must have shape {shape}, not {values.shape}")
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if self.noise is not None and not (np.isfinite(self.noise) & (self.noise >= 0)).all():
            raise ValueError("noise must be zero or more and finite")


def points_from_recordings(recordings: Sequence[Recording], components: Sequence[str]) -> LoadPoints:
    """Return the mean loads [N, N*m] of recordings at rest, one point for every stretch of steady pitch and roll.

    Parameters
    ----------
    recordings
        Recordings with the components and ``pitch``, and ``roll`` in all or none of them.
    components
        Names of the loads to average.

    Returns
    -------
    LoadPoints
        Means of the stretches; the standard uncertainty of each comes from the means of twenty parts of it, so it
        holds for correlated noise (ringing, hum) too.

    Raises
    ------
    FitError
        A channel is missing, or pitch is nowhere steady.
    """
    names = tuple(components)
    with_roll = [recording for recording in recordings if "roll" in recording]
    if with_roll and len(with_roll) < len(recordings):
        lacking = next(recording.name for recording in recordings if "roll" not in recording)
        raise FitError(f"{lacking} has no channel roll, but {with_roll[0].name} has; give it in all or in none")
    parts = [_stretches(recording, names, with_roll=bool(with_roll)) for recording in recordings]
    size = len(names)
    table = np.concatenate([np.zeros((0, 2 + 2 * size)), *parts])
    rolls = table[:, 1] if with_roll else None
    return LoadPoints(names, table[:, 0], table[:, 2 : 2 + size], rolls, table[:, 2 + size :])


def with_matrix_errors(points: LoadPoints, felt: Sequence[Loads]) -> LoadPoints:
    """Return points with the covariance [N^2, N^2*m, N^2*m^2] of the errors that a balance matrix gives them together.

    Parameters
    ----------
    points
        Points of recordings of gauge outputs.
    felt
        Balance loads of these recordings, by one matrix.
    """
    first, matrix = felt[0], felt[0].balance
    columns = [first.components.index(name) for name in points.components]
    native, values = (np.concatenate(tables) for tables in ([f.native for f in felt], [f.values for f in felt]))
    values = np.where(np.isfinite(native).all(axis=1, keepdims=True), values, np.nan)[:, columns]
    scale = np.max(np.abs(points.loads), axis=0) + np.finfo(np.float64).tiny
    # a sample of about the load of the point tells the load in the balance's own components
    rows = [int(np.nanargmin(np.sum(((values - load) / scale) ** 2, axis=1))) for load in points.loads]
    zero = in_own_components(first.zero.weight, matrix)
    if first.zero.operating_point is not None:
        zero = zero + first.zero.operating_point
    errors = MatrixErrors(matrix, first.components, first.transform, native[rows])
    return replace(points, shared=covariance_at_points(errors, points.components, zero=zero))


def _stretches(recording: Recording, names: tuple[str, ...], *, with_roll: bool) -> Array:
    """Points of one recording: columns pitch, roll, the means, and their uncertainties."""
    loads = [recording.channel(name).values for name in names]
    pitch = recording.channel("pitch").values
    roll = _unwrapped(recording.channel("roll").values) if with_roll else np.zeros_like(pitch)
    rows = []
    for stretch in _plateaus(pitch, roll):
        known = [load[stretch][np.isfinite(load[stretch])] for load in loads]
        if min(values.size for values in known) >= 2:
            means = [float(values.mean()) for values in known]
            deviations = [float(np.sqrt(variance_of_mean(values[:, None])[0])) for values in known]
            rows.append([float(np.nanmean(pitch[stretch])), float(np.nanmean(roll[stretch])), *means, *deviations])
    if not rows:
        raise FitError(
            f"{recording.name}: pitch is nowhere steady with {', '.join(names)} recorded; hold it at each angle, for "
            "twenty samples and one part in forty of the recording at least"
        )
    return np.array(rows)


def _unwrapped(angle: Array) -> Array:
    """The angle without jumps of a turn, as a sensor that reads -180 to 180 degrees makes them at their ends."""
    known = np.isfinite(angle)
    whole = angle.copy()
    whole[known] = np.unwrap(angle[known])
    return whole


def _plateaus(pitch: Array, roll: Array) -> list[slice]:
    """Stretches in which pitch and roll stand still; the first and last block of a move are cut off."""
    samples = pitch.size
    length = max(samples // 200, 4)
    blocks = samples // length
    if blocks < 5:
        still = all(np.nanmax(x) - np.nanmin(x) < 5 * PITCH_STEADY for x in (pitch, roll) if np.isfinite(x).any())
        return [slice(0, samples)] if still and samples >= 2 else []
    steady = np.ones(blocks - 1, dtype=bool)
    for angle in (pitch, roll):
        if not np.isfinite(angle).any():
            return []
        filled = np.where(np.isfinite(angle), angle, np.interp(np.arange(samples), *_known(angle)))
        parts = filled[: blocks * length].reshape(blocks, length)
        noise = float(np.median(np.std(np.diff(parts, axis=1), axis=1))) / np.sqrt(length)
        steady &= np.abs(np.diff(parts.mean(axis=1))) < PITCH_STEADY + 5 * noise
    edges = np.flatnonzero(np.diff(np.concatenate(([0], steady.astype(np.int8), [0]))))
    stretches = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        # Steady steps first..last-1 join the blocks first..last; those beside a move may hold a part of it.
        begin, end = first + (first > 0), last - (last < blocks - 1)
        if end - begin >= 4:
            stretches.append(slice(begin * length, samples if end == blocks - 1 else (end + 1) * length))
    return stretches


def _known(values: Array) -> tuple[Array, Array]:
    index = np.flatnonzero(np.isfinite(values))
    return index.astype(np.float64), values[index]
