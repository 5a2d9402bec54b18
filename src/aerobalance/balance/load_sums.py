"""What is said of the loads of many samples, from numbers of pieces of them that add up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.load_checks import (
    crowd_text,
    is_next_to_nothing,
    rest_text,
    share_of_largest,
    size_text,
    stuck_outputs,
)
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.zeros import gauge_table
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Doubt, of_pieces
from aerobalance.recording.linalg import whole_rows
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected
from aerobalance.recording.wording import without_numbers


@dataclass(frozen=True, slots=True, eq=False)
class LoadSums:
    """Numbers of samples whose gauge outputs became loads: c bridges and components of the balance's own.

    Attributes
    ----------
    balance
        The matrix.
    samples
        Number of samples.
    whole
        Those with all gauge outputs.
    squares
        Sums of the squares of the outputs as they were read, where all are there, shape (c,) [(mV/V)^2].
    resting
        Readings that repeat the one before, or rest on a limit, shape (c,).
    """

    balance: BalanceMatrix
    samples: int
    whole: int
    squares: Array
    resting: NDArray[np.int64]

    @classmethod
    def of(cls, outputs: Recording, felt: Loads, there: slice) -> LoadSums:
        """Numbers of some samples of a piece.

        Parameters
        ----------
        outputs
            The piece with its gauge outputs.
        felt
            Its loads.
        there
            Which of its samples count.
        """
        balance = felt.balance
        outputs = corrected(outputs)
        table, channels = gauge_table(outputs, balance)
        resting = np.zeros(len(balance.gauges), dtype=np.int64)
        if felt.doubts:  # the loads have them of bridges with few alone
            read = [outputs.channel(one.name) for one in channels]  # before they were divided by the excitation
            rests = stuck_outputs(read, balance) | np.column_stack([one.at_limit for one in read])
            resting += np.count_nonzero(rests[there], axis=0)
        else:
            for few in (felt.stuck, felt.clipped):
                resting += 0 if few is None else np.count_nonzero(few[there], axis=0)
        table = table[there]
        whole = whole_rows(table)
        known = table if whole.all() else table[whole]
        return cls(
            balance=balance,
            samples=len(table),
            whole=int(np.count_nonzero(whole)),
            squares=np.einsum("ij,ij->j", known, known),
            resting=resting,
        )

    @classmethod
    def joined(cls, sums: Sequence[LoadSums]) -> LoadSums:
        """Numbers of all samples of some pieces."""
        return cls(
            balance=sums[0].balance,
            samples=sum(one.samples for one in sums),
            whole=sum(one.whole for one in sums),
            squares=np.sum([one.squares for one in sums], axis=0),
            resting=np.sum([one.resting for one in sums], axis=0),
        )

    def doubts(self, of: Sequence[Doubt]) -> tuple[Doubt, ...]:
        """Return the doubts about pieces as doubts about all samples.

        Shares and counts are those of all samples. What a piece says of the size of its outputs holds only where those
        of all are as small: the wind may have been off in that piece.
        """
        share = share_of_largest(self.squares / max(self.whole, 1), self.balance)
        texts = [size_text(share)]
        for gauge, count in zip(self.balance.gauges, self.resting.tolist(), strict=True):
            texts += [rest_text(gauge, count / self.samples), crowd_text(gauge, count)]
        own = {without_numbers(text): text for text in texts}
        return tuple(
            replace(one, text=own.get(without_numbers(one.text), one.text))
            for one in of_pieces(of)
            if one.kind != "units" or is_next_to_nothing(share)
        )
