"""Loads of coupled components, apart from what the ground's motion has put on them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.spectra.steady_tones import without_tones
from aerobalance.recording.channel import Array


class SplitLoads(NamedTuple):
    """Loads without gaps, apart from what the ground's motion has put on them, at the instants of the first channel.

    Attributes
    ----------
    left
        The loads less that, shape (samples, n).
    felt
        What it has put on them by the dynamics of the record, shape (samples, n).
    """

    left: Array
    felt: Array

    @classmethod
    def of(cls, record: CoupledRecord, filled: Array) -> SplitLoads:
        """Those of a record whose readings have their gaps filled, shape (samples, n)."""
        return cls(record.without_ground(filled, on_clock_of=0), record.felt_of_ground(on_clock_of=0))

    def part(self, within: slice) -> SplitLoads:
        """Some samples of them."""
        return SplitLoads(self.left[within], self.felt[within])

    @property
    def shaken(self) -> bool:
        """Whether the ground moves."""
        return bool(np.ptp(self.felt, axis=0).any())

    def without_tones(self, *, above: float) -> SplitLoads:
        """The same without steady tones above a frequency over the sampling rate."""
        return SplitLoads(
            without_tones(self.left, above=above), without_tones(self.felt, above=above) if self.shaken else self.felt
        )
