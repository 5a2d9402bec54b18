"""The columns of the readings that a live force uses, and the noise of those of the components."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.estimation.live.platform import LiveChannel, LivePlatform
from aerobalance.motion.sensors import sensor_kind
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import driving_channel, si_unit
from aerobalance.recording.noise import noise_covariance
from aerobalance.recording.resampling import hold_over_gaps

QUIET: Final = 0.01
"""Noise that a channel has at least, over the median of all."""

STILL: Final = 1e-8
"""Noise over the largest reading, below which a channel does not move at all."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Where the channels are that are used: loads first, then sensors of the non-metric end, then angles.

    Attributes
    ----------
    all_names, names
        Names of all columns, and of those that are used, c of them.
    places
        Where the latter are among the former.
    late
        Time by which each of them lags the first load [s], shape (c,).
    limits
        Loads at which the channels of the n components saturate, shape (n,) [N, N*m].
    platform
        How the m sensors' readings become motion.
    specific
        Which of them read specific force, shape (m,).
    watched, noises
        Columns, among those used, of the others, and standard uncertainty of a sample of each; None to estimate it.
    pitch, roll
        Columns of the angles; None where not read.
    """

    all_names: tuple[str, ...]
    names: tuple[str, ...]
    places: list[int]
    late: list[float]
    limits: Array
    platform: LivePlatform
    specific: Array
    watched: list[int]
    noises: list[float | None]
    pitch: int | None
    roll: int | None

    def readings(self, block: ArrayLike | Mapping[str, ArrayLike]) -> Array:
        """Return the columns of a block that are used, shape (m, c).

        Parameters
        ----------
        block
            Columns by name, shape (m,) each, or shape (m, all of them) in their order; (m,) for a single one.

        Raises
        ------
        ValueError
            A column is lacking, or they are not equally long.
        """
        if isinstance(block, Mapping):
            lacking = [name for name in self.names if name not in block]
            if lacking or len(block) < len(self.all_names):
                raise ValueError(
                    f"a block lacks {', '.join(lacking) or 'columns'}; every block must have the same columns as the "
                    f"first: {', '.join(self.all_names)}"
                )
            parts = [np.asarray(block[name], dtype=np.float64) for name in self.names]
            if any(part.shape != parts[0].shape or part.ndim != 1 for part in parts):
                shapes = ", ".join(f"{name} {part.shape}" for name, part in zip(self.names, parts, strict=True))
                raise ValueError(f"the columns of a block must have equally many samples, shape (m,), not {shapes}")
            return np.column_stack(parts)
        table = np.asarray(block, dtype=np.float64)
        table = table[:, None] if table.ndim == 1 else table
        if table.ndim != 2 or table.shape[1] != len(self.all_names):
            raise ValueError(
                f"a block must have a column for each of {', '.join(self.all_names)}: shape "
                f"(m, {len(self.all_names)}), not {np.shape(block)}"
            )
        return np.ascontiguousarray(table[:, self.places])

    @classmethod
    def of(
        cls,
        dynamics: BalanceDynamics,
        channels: Sequence[LiveChannel],
    ) -> Columns:
        """Find the columns.

        Raises
        ------
        ValueError
            There is no channel of a component, a channel stands there twice, or the non-metric end moves and the mass
            is not known.
        """
        components = dynamics.components
        all_names = tuple(channel.name for channel in channels)
        twice = [name for name in dict.fromkeys(all_names) if all_names.count(name) > 1]
        if twice:
            raise ValueError(f"{', '.join(twice)} stands twice among {', '.join(all_names)}: give each channel once")
        lacking = [name for name in components if name not in all_names]
        if lacking:
            raise ValueError(
                f"there is no {', '.join(lacking)} among {', '.join(all_names)}; the force of each component needs "
                f"the readings of all: {', '.join(components)}"
            )
        by_name = {channel.name: channel for channel in channels}
        sensors = [one for one in channels if sensor_kind(one.name) is not None]
        along = int(np.count_nonzero(dynamics.moved_by)) == 1  # of one alone, by what it is moved by
        if along:
            one = by_name.get(driving_channel("ground", components[0], by_name))
            sensors = [] if one is None else [one]
        platform = LivePlatform.along(components[0], sensors[0]) if along and sensors else LivePlatform.of(sensors)
        angles = [name for name in ("pitch", "roll") if name in by_name and "pitch" in by_name]
        if (sensors or angles) and not dynamics.moved_by.any():
            out = ", ".join([*(one.name for one in sensors), *angles])
            raise ValueError(
                "the ground end moves or pitches, but the dynamics hold no mass: give mass, centre of gravity and "
                f"inertia when they are identified, or leave out {out}"
            )
        n = len(components)
        names = (*components, *(one.name for one in sensors), *angles)
        own = by_name[components[0]].delay
        return cls(
            all_names=all_names,
            names=names,
            places=[all_names.index(name) for name in names],
            late=[by_name[name].delay - own for name in names],
            limits=np.array([by_name[name].limit for name in components]),
            platform=platform,
            specific=np.array([one.specific for one in sensors], dtype=np.bool_),
            watched=[n + place for place, one in enumerate(sensors) if not one.specific],
            noises=[one.noise for one in sensors if not one.specific],
            pitch=names.index("pitch") if "pitch" in angles else None,
            roll=names.index("roll") if "roll" in angles else None,
        )

    def beside_specific(self, watched: Array, *, others: float = 0.0) -> Array:
        """A value of every watched sensor put beside another one for those of specific force, shape (m,)."""
        whole = np.full(self.specific.size, others)
        whole[np.logical_not(self.specific)] = watched
        return whole


def judged_noise(components: Sequence[str], loads: Array) -> Array:
    """Return the covariance of the noise of readings of shape (m, n), shape (n, n) [N^2, N^2*m, N^2*m^2]."""
    first = np.array([column[np.isfinite(column)][:1].sum() for column in loads.T])
    filled = hold_over_gaps(loads, first)
    channels = [Channel(name, column, si_unit(name)) for name, column in zip(components, filled.T, strict=True)]
    found = noise_covariance(channels, filled)
    deviation = np.sqrt(np.diag(found))
    # a channel that stands still must not seem to be known beyond all others
    alive = deviation[deviation > STILL * np.max(np.abs(filled), axis=0)]
    least = QUIET * float(np.median(alive)) if alive.size else 1.0
    return np.asarray(found + np.diag(np.where(deviation < least, least**2, 0.0)))
