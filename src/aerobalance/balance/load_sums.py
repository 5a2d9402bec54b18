"""What is said of the loads of many samples, from numbers of pieces of them that add up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.load_checks import (
    beyond_range,
    crowd_text,
    doubt_texts,
    excess_of,
    is_next_to_nothing,
    iteration_texts,
    lost_texts,
    range_texts,
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
from aerobalance.recording.errors import OfLoads
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
    found
        Those with loads.
    squares
        Sums of the squares of the outputs as they were read, where all are there, shape (c,) [(mV/V)^2].
    resting
        Readings that repeat the one before, or rest on a limit, shape (c,).
    beyond
        Samples outside the calibrated range, by the balance's own components.
    excess
        How far they lie outside at most, over that range, shape (c,); negative where they do not.
    """

    balance: BalanceMatrix
    samples: int
    whole: int
    found: int
    squares: Array
    resting: NDArray[np.int64]
    beyond: Counter[str]
    excess: Array

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
        table, native = table[there], felt.native[there]
        whole, found = whole_rows(table), whole_rows(native)
        known = table if whole.all() else table[whole]
        beyond, excess = Counter[str](), np.full(len(balance.components), -np.inf)
        if felt.beyond:
            native = native if found.all() else native[found]
            beyond += Counter(beyond_range(balance, native))
        if beyond:
            excess = excess_of(balance, native)
        return cls(
            balance=balance,
            samples=len(table),
            whole=int(np.count_nonzero(whole)),
            found=int(np.count_nonzero(found)),
            squares=np.einsum("ij,ij->j", known, known),
            resting=resting,
            beyond=beyond,
            excess=excess,
        )

    @classmethod
    def joined(cls, sums: Sequence[LoadSums]) -> LoadSums:
        """Numbers of all samples of some pieces."""
        return cls(
            balance=sums[0].balance,
            samples=sum(one.samples for one in sums),
            whole=sum(one.whole for one in sums),
            found=sum(one.found for one in sums),
            squares=np.sum([one.squares for one in sums], axis=0),
            resting=np.sum([one.resting for one in sums], axis=0),
            beyond=sum((one.beyond for one in sums), Counter[str]()),
            excess=np.max([one.excess for one in sums], axis=0),
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

    def said(self, run: str, felt: Loads) -> Iterator[OfLoads]:
        """What there is to say of the loads of a run, as `loads_of_outputs` says it of samples that it is given."""
        yield from lost_texts(run, self.whole - self.found, samples=self.samples)
        yield from range_texts(run, self.balance, self.beyond, samples=self.found, excess=self.excess)
        yield from iteration_texts(run, felt.contraction)
        yield from doubt_texts(run, felt.doubts)
