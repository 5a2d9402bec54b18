"""Coupled components taken apart while the readings come in: what `dynamics.decoupling` does, chunk by chunk.

What a lone balance reads is a weighted sum of the readings and of what they are behind its modes, value and rate.
Loads on the moving mass, from gravity and the ground's motion, are taken off as the lone balance's own response.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.decoupling import LoneComponent
from aerobalance.dynamics.driven_modes import DrivenModes
from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import REACH, hold_over_gaps

MARGIN: Final = REACH
"""Samples on either side of a gap whose lone readings count as missing: the interpolation there reaches into it."""


class LiveApart:
    """The readings of the lone balances of all components, from sample to sample.

    Parameters
    ----------
    lones
        The components' own balances, n of them in the order of the readings' columns.
    interval
        Time between samples [s].
    delay
        Time by which the readings lag the loads on the moving mass [s].

    Attributes
    ----------
    ahead
        Samples after a sample that its lone readings are made from.
    """

    def __init__(self, lones: Sequence[LoneComponent], *, interval: float, delay: float = 0.0) -> None:
        n = len(lones)
        parts = [lone.fractions for lone in lones]
        self._direct = np.array([part.direct for part in parts])
        self._partners = np.array([lone.partners for lone in lones])
        self._crowd = np.array([not lone.alone for lone in lones])
        # one row for every mode of every lone balance
        self._owner = np.repeat(np.arange(n), [len(part.modes) for part in parts])
        self._by_value = np.vstack([part.by_value for part in parts])
        self._by_rate = np.vstack([part.by_rate for part in parts])
        modes = [mode for part in parts for mode in part.modes]
        self._shares = np.array([[mode.share, mode.rate_share] for mode in modes])
        self._modes = DrivenModes(modes, interval=interval, delays=(0.0, delay))
        self.ahead = max(self._modes.ahead, MARGIN)
        self._start: tuple[Array, Array] | None = None
        self._early = [np.zeros((0, n)), np.zeros((0, n))]
        self._held = np.zeros(n)
        self._direct_part = self._driven = np.zeros((0, n))
        self._missing = np.zeros((0, n), dtype=np.bool_)

    def push(self, loads: Array, net: Array | None) -> Array:
        """Take readings; return the lone readings that have become known by them.

        Parameters
        ----------
        loads
            Loads felt, shape (m, n), NaN where missing.
        net
            Loads on the moving mass that are not to be found, shape (m, n), or None for none.

        Returns
        -------
        readings
            Shape (m', n), NaN within `MARGIN` samples of a gap of a component that has a part in them.
        """
        net = np.zeros(loads.shape) if net is None else net
        if self._start is None:
            loads = self._early[0] = np.concatenate([self._early[0], loads])
            net = self._early[1] = np.concatenate([self._early[1], net])
            if not np.isfinite(loads).any(axis=0).all():
                return np.zeros((0, loads.shape[1]))
            self._begin(loads, net)
        if loads.shape[0]:
            self._take(loads, net)
        return self._ready()

    def finish(self) -> Array:
        """The lone readings that wait for what comes after: the record goes on turned about its last sample."""
        if self._start is None:
            return np.full(self._early[0].shape, np.nan)
        self._add(self._modes.finish())
        self._missing = np.concatenate([self._missing, np.zeros((self.ahead, self._held.size), dtype=np.bool_)])
        return self._ready()

    def _begin(self, loads: Array, net: Array) -> None:
        """Take what is first as held before, and nothing as missing."""
        self._held = np.array([column[np.isfinite(column)][0] for column in loads.T])
        self._start = self._held, net[0].copy()
        self._missing = np.zeros((MARGIN, self._held.size), dtype=np.bool_)

    def _take(self, loads: Array, net: Array) -> None:
        start, net_start = self._start or (self._held, self._held)
        missing, filled = ~np.isfinite(loads), hold_over_gaps(loads, self._held)
        self._held = filled[-1]
        change = filled - start
        driving = np.zeros((filled.shape[0], 4, self._owner.size))
        direct = np.zeros(filled.shape)
        # one product a column, so that the sum does not hang on how many samples come at once
        for column in range(filled.shape[1]):
            one = change[:, column, None]
            driving[:, 0] += one * self._by_value[:, column]
            driving[:, 1] += one * self._by_rate[:, column]
            direct += one * self._direct[:, column]
        driving[:, 2:] = (net_start - net)[:, None, self._owner] * self._shares.T
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
        count = max(min(self._driven.shape[0], self._missing.shape[0] - 2 * MARGIN), 0)
        found = self._direct_part[:count] + self._driven[:count]
        found[self._spoilt(count)] = np.nan
        self._driven, self._direct_part = self._driven[count:], self._direct_part[count:]
        self._missing = self._missing[count:]
        return np.asarray(found)

    def _spoilt(self, count: int) -> NDArray[np.bool_]:
        """Where a lone reading is missing: a lone component's own sample, or one of those around it."""
        around = np.zeros((count, self._held.size), dtype=np.bool_)
        if self._missing.any():
            for shift in range(2 * MARGIN + 1):
                wide = self._crowd if shift != MARGIN else np.ones_like(self._crowd)
                around |= self._missing[shift : shift + count] & wide
        return around
