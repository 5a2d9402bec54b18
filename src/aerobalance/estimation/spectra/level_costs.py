"""What levels of a density cost at the averages of a periodogram, and the cheapest way from one level to the next."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.spectra._kernels import cheapest
from aerobalance.recording.channel import Array

Singles = NDArray[np.float32]

AT_ONCE: Final = 256
"""Averages whose costs are worked out at once: so few are worked on near the processor."""

SMALL: Final = 1e-30
"""Least background relative to the reading, and over one the largest density: what is beyond is as unlikely."""


TINY: Final = 1e-300
"""Least density that others are relative to: of a reading and a background that are both nothing [N^2/Hz]."""


class Costs(NamedTuple):
    """What a density of the load costs at each average, up to a constant that is the same for all densities.

    In single precision, relative to the larger of reading and background: a likely density is about one then, and its
    cost exact to some 1e-5, where a change of level costs 10.

    Attributes
    ----------
    size
        Density that those of the load and the background are relative to, shape (m,) [N^2/Hz].
    background, density
        Density of what is no force, and of the reading, relative to that, shape (m, 1) [1].
    weight
        Number of independent ordinates, shape (m, 1).
    """

    size: Array
    background: Singles
    density: Singles
    weight: Singles

    @classmethod
    def of(cls, density: Array, weight: Array, background: Array) -> Costs:
        """Take densities of a reading and of what is no force, [N^2/Hz], and the ordinates of averages, (m,) each."""
        size = np.maximum(np.maximum(density, background), TINY)
        return cls(size, _single(np.maximum(background / size, SMALL)), _single(density / size), _single(weight))

    def beside(self, background: Array) -> Costs:
        """The same, up to the same constant, beside another density of what is no force, shape (m,) [N^2/Hz]."""
        return self._replace(background=_single(np.maximum(background / self.size, SMALL)))

    def table(self, levels: Array, *, gain: Array | None = None, where: NDArray[np.bool_] | None = None) -> Singles:
        """What rising levels, (l,) [N^2/Hz], cost; shape (m, l).

        Parameters
        ----------
        levels
            The levels.
        gain
            By which the reading shows them, shape (m,) [1]; None for one.
        where
            Averages of which it is asked, shape (m,), others being infinite; None for all.
        """
        count = self.size.size
        where = np.full(count, True) if where is None else where
        cost = np.empty((count, levels.size), dtype=np.float32)
        cost[~where] = np.inf
        self.write(cost, np.ones(count) if gain is None else gain, levels, where)
        return cost

    def write(self, cost: Singles, gain: Array, levels: Array, where: NDArray[np.bool_]) -> None:
        """Write what levels cost at some averages into such a table; its further columns are of none."""
        rows, most = np.flatnonzero(where), float(levels[-1]) or 1.0
        gains, levels = _single(np.minimum(gain * (most / self.size), 1 / SMALL)), (levels / most).astype(np.float32)
        room = np.empty((2, AT_ONCE, levels.size), dtype=np.float32)
        for first in range(0, rows.size, AT_ONCE):
            some = rows[first : first + AT_ONCE]
            model, found = room[:, : some.size]
            np.multiply(gains[some], levels, out=model)
            model += self.background[some]
            np.log(model, out=found)
            found += np.divide(self.density[some], model, out=model)
            found *= self.weight[some]
            cost[some, : levels.size] = found
            cost[some, levels.size :] = np.inf


def cheapest_columns(cost: Singles, change: float) -> NDArray[np.int64]:
    """Column for each row of a table of costs, (m, l), so that all together with the price of a change are least."""
    rows, columns = cost.shape
    path, best = np.empty(rows, dtype=np.int64), np.zeros(rows + 1, dtype=np.int64)
    moved = np.empty(cost.shape, dtype=np.bool_)
    cheapest(np.ascontiguousarray(cost), change, np.zeros(columns), moved, best, path)
    return path


def _single(values: Array) -> Singles:
    """Values of averages, shape (m,), as a column in single precision."""
    return values[:, None].astype(np.float32)
