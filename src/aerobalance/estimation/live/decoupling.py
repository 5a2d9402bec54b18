"""Coupled components decoupled block by block: the readings of one balance of a single component for each.

What such a balance reads is a weighted sum of the readings and of what they are behind its modes, value and rate
(`aerobalance.dynamics.decoupling`, with the same `DrivenModes`: a stream drained is a whole record). Loads on the
moving mass, from gravity and motion of the non-metric end, are taken off as that balance's own response. A component
that is coupled with no other keeps its readings as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.driven_modes import DrivenModes
from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import REACH, hold_over_gaps

MARGIN: Final = REACH
"""Samples on either side of a gap whose decoupled readings count as missing: the interpolation reaches into it."""


class Decoupler:
    """Readings of the decoupled channels, from sample to sample.

    Parameters
    ----------
    channels
        The n channels in the order of the readings' columns.
    interval
        Time between samples [s].
    moves
        Whether there are loads on the moving mass to be taken off.
    delay
        Time by which the readings lag those loads [s].

    Attributes
    ----------
    ahead
        Samples after a sample that its decoupled readings are made from.
    """

    def __init__(
        self, channels: Sequence[DecoupledChannel], *, interval: float, moves: bool, delay: float = 0.0
    ) -> None:
        n = len(channels)
        self._partners = np.array([channel.partners for channel in channels])
        self._crowd = np.array([not channel.alone for channel in channels])
        self._mixed, self._moves = bool(self._crowd.any()), moves
        self._margin = MARGIN if self._mixed else 0
        fractions = [channel.fractions for channel in channels]
        self._direct = np.array([one.direct for one in fractions])
        # one row for every mode of every channel
        self._owner = np.repeat(np.arange(n), [len(one.modes) for one in fractions])
        self._by_value = np.vstack([one.by_value for one in fractions])
        self._by_rate = np.vstack([one.by_rate for one in fractions])
        modes = [mode for one in fractions for mode in one.modes]
        self._contributions = np.array([[mode.share, mode.rate_share] for mode in modes])
        delays = [0.0] * self._mixed + [delay] * moves
        self._modes = DrivenModes(modes, interval=interval, delays=delays) if delays else None
        self.ahead = 0 if self._modes is None else max(self._modes.ahead, self._margin)
        self._start: tuple[Array, Array] | None = None
        self._early = [np.zeros((0, n)), np.zeros((0, n))]
        self._held = np.zeros(n)
        self._direct_part = self._driven = np.zeros((0, n))
        self._missing = np.zeros((0, n), dtype=np.bool_)

    def push(self, loads: Array, net: Array) -> Array:
        """Return the decoupled readings that have become known by more readings.

        Parameters
        ----------
        loads
            Balance loads, shape (m, n), NaN where missing.
        net
            Loads on the moving mass that are not to be found, shape (m, n).

        Returns
        -------
        readings
            Shape (m', n), NaN where missing, and within `MARGIN` samples of a gap of a component that has a part in
            them.
        """
        if self._modes is None:
            return loads
        if self._start is None:
            loads = self._early[0] = np.concatenate([self._early[0], loads])
            net = self._early[1] = np.concatenate([self._early[1], net])
            if not loads.size or (self._mixed and not np.isfinite(loads).any(axis=0).all()):
                return np.zeros((0, loads.shape[1]))
            self._begin(loads, net)
        if loads.shape[0]:
            self._take(loads, net)
        return self._ready()

    def finish(self) -> Array:
        """Return the decoupled readings that wait for what comes after the last, shape (m', n)."""
        if self._modes is None or self._start is None:
            return np.full(self._early[0].shape, np.nan)
        self._add(self._modes.finish())
        self._missing = np.concatenate([self._missing, np.zeros((self.ahead, self._held.size), dtype=np.bool_)])
        return self._ready()

    def _begin(self, loads: Array, net: Array) -> None:
        """Take what is first as held before, and nothing as missing."""
        first = [column[np.isfinite(column)][:1] for column in loads.T]
        self._held = np.array([float(one[0]) if one.size else 0.0 for one in first])
        self._start = self._held, net[0].copy()
        self._missing = np.zeros((self._margin, self._held.size), dtype=np.bool_)

    def _take(self, loads: Array, net: Array) -> None:
        if self._modes is None or self._start is None:
            raise AssertionError
        start, net_start = self._start
        missing, filled = ~np.isfinite(loads), hold_over_gaps(loads, self._held)
        self._held = filled[-1]
        change = filled - start
        driving = np.zeros((filled.shape[0], self._modes.kinds, self._owner.size))
        direct = np.zeros(filled.shape)
        # one product a column, so that the sum does not hang on how many samples come at once
        for column in range(filled.shape[1]):
            one = change[:, column, None]
            direct += one * self._direct[:, column]
            if self._mixed:
                driving[:, 0] += one * self._by_value[:, column]
                driving[:, 1] += one * self._by_rate[:, column]
        if self._moves:
            driving[:, -2:] = (net_start - net)[:, None, self._owner] * self._contributions.T
        self._add(self._modes.push(driving))
        self._direct_part = np.concatenate([self._direct_part, direct + (start - net_start)])
        lost = np.where(self._crowd, (missing @ self._partners.T.astype(np.float64)) > 0, missing)
        self._missing = np.concatenate([self._missing, lost])

    def _add(self, responses: Array) -> None:
        """Put by responses of the modes, shape (k, modes)."""
        driven = np.zeros((responses.shape[0], self._held.size))
        for place, owner in enumerate(self._owner):
            driven[:, owner] += responses[:, place]
        self._driven = np.concatenate([self._driven, driven])

    def _ready(self) -> Array:
        count = max(min(self._driven.shape[0], self._missing.shape[0] - 2 * self._margin), 0)
        found = self._direct_part[:count] + self._driven[:count]
        found[self._spoilt(count)] = np.nan
        self._driven, self._direct_part = self._driven[count:], self._direct_part[count:]
        self._missing = self._missing[count:]
        return np.asarray(found)

    def _spoilt(self, count: int) -> NDArray[np.bool_]:
        """Where a decoupled reading is missing: the own sample of a component by itself, or one of those around it."""
        around = np.zeros((count, self._held.size), dtype=np.bool_)
        if self._missing.any():
            for shift in range(2 * self._margin + 1):
                wide = self._crowd if shift != self._margin else np.ones_like(self._crowd)
                around |= self._missing[shift : shift + count] & wide
        return around
