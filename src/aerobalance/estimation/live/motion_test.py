"""Does the non-metric end move? Where its accelerometers show but noise, that must not be added to the force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerobalance.motion.at_rest import AT_REST
from aerobalance.recording.channel import Array
from aerobalance.recording.noise import white_noise


@dataclass(frozen=True, slots=True)
class MotionTestSettings:
    """When the non-metric end is taken to move.

    Attributes
    ----------
    first
        Time that is looked at before it is said [s].
    again
        Time between further looks [s].
    calm
        Time without motion after which it counts as at rest again [s].
    most, least
        Samples that are looked at, at most and at least.
    scatter
        Part of the variance by which it may look larger than it is, times the root of the number of samples.
    """

    first: float = 0.25
    again: float = 1.0
    calm: float = 5.0
    most: int = 4096
    least: int = 64
    scatter: float = 8.0


class MotionTest:
    """Compares the variance of each accelerometer with that of its noise, at instants fixed by the number of samples.

    Parameters
    ----------
    noises
        Standard uncertainty of a sample of each of the c accelerometers [m/s^2]; None where it is to be estimated.
    interval
        Time between samples [s].
    settings
        When they count as moving.

    Attributes
    ----------
    moves
        Whether each shows motion, shape (c,).
    """

    def __init__(self, noises: Sequence[float | None], *, interval: float, settings: MotionTestSettings) -> None:
        self._noises, self._interval, self._settings = tuple(noises), interval, settings
        self._recent = np.empty((0, len(self._noises)))
        self._samples = 0
        self._moved = np.full(len(self._noises), -np.inf)
        self._next = max(round(settings.first / interval), 1)
        self.moves = np.zeros(len(self._noises), dtype=np.bool_)

    def room(self) -> int:
        """Return the samples that can be taken before the next look."""
        return self._next - self._samples

    def push(self, rows: Array) -> bool:
        """Take samples, shape (m, c), m at most `room`; return whether what moves has changed."""
        self._recent = np.concatenate((self._recent, rows))[-self._settings.most :]
        self._samples += rows.shape[0]
        return self._samples == self._next and self._look()

    def _look(self) -> bool:
        settings, time = self._settings, self._samples * self._interval
        self._next = self._samples + max(round(settings.again / self._interval), 1)
        known = self._recent[np.isfinite(self._recent).all(axis=1)]
        if known.shape[0] < settings.least:
            return False
        limit = AT_REST * (1 + settings.scatter / np.sqrt(known.shape[0]))
        noises = [
            white_noise(column) if noise is None else noise
            for noise, column in zip(self._noises, known.T, strict=True)
        ]
        # one reading all along is a dead sensor, and no motion
        beyond = (np.ptp(known, axis=0) > 0) & (np.var(known, axis=0) >= limit * np.square(noises))
        self._moved[beyond] = time
        before, self.moves = self.moves, beyond | (self.moves & (time - self._moved < settings.calm))
        return bool((before != self.moves).any())

    @property
    def noise(self) -> Array:
        """Standard uncertainty of a sample of each that moves, shape (c,); 0 for the others."""
        found = np.zeros(len(self._noises))
        for place in np.flatnonzero(self.moves):
            given = self._noises[place]
            found[place] = white_noise(self._recent[:, place]) if given is None else given
        return found
