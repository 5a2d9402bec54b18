"""Loads of the page and of the live force, of gauge outputs that are brought to one instant first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aerobalance.acquisition.guards import LoadColumns, felt
from aerobalance.estimation.live.alignment import Aligner
from aerobalance.recording.channel import Array


class AlignedLoads:
    """Rows of all channels, as they are read, with loads made of gauge outputs that were read at one instant.

    Parameters
    ----------
    gauges
        The gauge outputs among the columns.
    loads
        First column of the loads that are made of them.
    late
        Samples by which each column comes later than the gauge outputs do on average, shape (c,). It is taken out of
        the gauge outputs that loads are made of, here, and of sensors and loads by the live force.
    """

    def __init__(self, gauges: LoadColumns, *, loads: int, late: Sequence[float]) -> None:
        self._gauges, self._loads = gauges, slice(loads, len(late))
        self._late = [*(0.0 for _ in late), *(late[place] for place in gauges.columns)]
        self.forget()

    def forget(self) -> None:
        """Begin anew with the next rows."""
        self._aligner, self._first, self._end = Aligner(self._late), 0, -1

    def push(self, tick: int, values: Array, *, offsets: Array) -> tuple[int, Array]:
        """Take rows (m, c) from a tick on, less offsets (c,); return those that are known, and their first tick.

        A tick that does not follow the last one begins anew.
        """
        if tick != self._end:
            self.forget()
            self._first = tick
        self._end = tick + len(values)
        # the outputs themselves stay as they are read: interpolated, none would rest on its limit
        given = np.column_stack((values, values[:, self._gauges.columns]))
        made = self._aligner.push(given)
        first, self._first = self._first, self._first + len(made)
        rows, outputs = np.split(made, [values.shape[1]], axis=1)
        if made is not given:
            with np.errstate(over="ignore", invalid="ignore"):  # of numbers that count as missing
                rows[:, self._loads] = felt(self._gauges.balance, outputs) - offsets[self._loads]
        return first, rows
