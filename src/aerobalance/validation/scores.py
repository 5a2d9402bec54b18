"""How far an estimate of the force is from the truth: over a record, on its plateaus, at its edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import fractional_delay

END_SHARE: Final = 0.05
"""Share of a record that is left out of the scores at each end."""

STAMPS_AGREE: Final = 0.01
"""Largest distance of the time stamps of record and truth, over a sample."""

EDGE_TIME: Final = 0.02
"""Half width of an edge [s], or two periods of the natural frequency where that is more."""

SUDDEN: Final = 5.0
"""Change within a tenth of a natural period, over what nine in ten stay below, from which on it is a jump."""

SUDDEN_SHARE: Final = 0.05
"""Least change of a jump over the span of the truth."""


@dataclass(frozen=True, slots=True)
class Score:
    """Deviation of an estimate from the truth [unit of the force].

    Attributes
    ----------
    rms
        Root mean square.
    plateau, edge
        Root mean square away from the jumps of the truth, and near them; NaN where the truth has none.
    mean
        Mean deviation.
    largest
        Largest deviation of either sign.
    """

    rms: float
    plateau: float
    edge: float
    mean: float
    largest: float


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What was really applied, and where it counts.

    Attributes
    ----------
    values
        Force applied, shape (n,) [N].
    scored
        True where deviations count: the record less its ends, shape (n,).
    near_jump
        True near a jump of the truth, shape (n,).
    jumps
        Samples at which the truth jumps.
    """

    values: Array
    scored: NDArray[np.bool_]
    near_jump: NDArray[np.bool_]
    jumps: tuple[int, ...]

    @classmethod
    def of(cls, values: Array, *, rate: float, natural_frequency: float) -> Truth:
        """Find the jumps of a truth and what is scored of it.

        Parameters
        ----------
        values
            Force applied, shape (n,) [N].
        rate
            Sampling rate [Hz].
        natural_frequency
            Natural frequency of the balance [Hz].
        """
        ends = int(END_SHARE * values.size)
        scored = np.zeros(values.size, dtype=bool)
        scored[ends : values.size - ends] = True
        jumps = find_jumps(values, width=max(1, round(0.1 * rate / natural_frequency)))
        reach = max(EDGE_TIME, 2 / natural_frequency) * rate
        near = np.zeros(values.size, dtype=bool)
        for jump in jumps:
            near[max(0, int(np.ceil(jump - reach))) : int(jump + reach) + 1] = True
        return cls(values, scored, near, jumps)

    @property
    def half_span(self) -> float:
        """Half of the distance from the least to the largest force [N]."""
        return float(np.ptp(self.values)) / 2

    def score(self, estimate: Array) -> Score:
        """Judge an estimate, shape (n,)."""
        error = estimate - self.values
        edge = self.scored & self.near_jump
        split = bool(edge.any())
        plateau = self.scored & ~self.near_jump
        return Score(
            rms=_rms(error[self.scored]),
            plateau=_rms(error[plateau]) if split else float("nan"),
            edge=_rms(error[edge]) if split else float("nan"),
            mean=float(np.mean(error[self.scored])),
            largest=float(np.max(np.abs(error[self.scored]))),
        )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def find_jumps(values: Array, *, width: int) -> tuple[int, ...]:
    """Find the samples at which a truth changes within `width` samples as it does nowhere else."""
    change = np.abs(values[width:] - values[:-width])
    span = float(np.ptp(values))
    if not change.size or span == 0:
        return ()
    sudden = (change > SUDDEN * np.quantile(change, 0.9)) & (change > SUDDEN_SHARE * span)
    return tuple(int(index) + (width + 1) // 2 for index in np.flatnonzero(sudden))


def truth_on_clock(recording: Recording, truth: Recording, component: str) -> Array:
    """Values of the truth at the instants at which a recording's load was read, shape (n,) [N].

    Where the channel of the load states a delay, these are so much earlier than the time beside a sample: so is the
    force that the estimators give.

    Parameters
    ----------
    recording
        What is judged.
    truth
        Force applied, on the same clock; it may begin earlier and end later.
    component
        Which component.

    Raises
    ------
    FitError
        The truth has no such channel, missing samples, another rate, stamps between the record's, or ends early.
    """
    if component not in truth:
        raise FitError(f"{truth.name} has no channel {component}; it has {', '.join(truth.channels) or 'none'}")
    position = (recording.time - truth.start) * truth.rate
    drift = (recording.samples - 1) * (truth.rate / recording.rate - 1)
    if abs(drift) > STAMPS_AGREE:
        raise FitError(
            f"{truth.name} is sampled at {truth.rate:.8g} Hz and {recording.name} at {recording.rate:.8g} Hz; "
            "the truth must be on the record's clock"
        )
    off = float(np.max(np.abs(position - np.rint(position))))
    if off > STAMPS_AGREE:
        raise FitError(
            f"{truth.name} begins at {truth.start:.9g} s and {recording.name} at {recording.start:.9g} s: the stamps "
            f"lie {off:.2g} of a sample apart ({STAMPS_AGREE:g} is allowed); give the truth at the record's own stamps"
        )
    if position[0] < -STAMPS_AGREE or position[-1] > truth.samples - 1 + STAMPS_AGREE:
        raise FitError(
            f"{truth.name} covers {truth.time[0]:.6g} to {truth.time[-1]:.6g} s, not all of {recording.name}, "
            f"{recording.time[0]:.6g} to {recording.time[-1]:.6g} s"
        )
    values = truth.channel(component).values
    index = np.arange(truth.samples, dtype=np.float64)
    found = np.interp(position, index, values)
    missing = int(np.count_nonzero(~np.isfinite(found)))
    if missing:
        raise FitError(f"{truth.name}: {missing} sample(s) of {component} are missing; the truth must be whole")
    return fractional_delay(found, delay=recording.channel(component).delay, interval=1 / recording.rate)
