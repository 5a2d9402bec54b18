"""Whether a load responds to the ground's motion as its dynamics say, or as others: it is shaken by a known force.

The ground's motion puts a force on the moving mass that is known, and its load is taken off the readings with the
expected dynamics. Where the balance has another resonance, a part of it is left there, which no force of the flow
explains that does not go with the motion. Read with the dynamics of the balance, less is left: whatever the spectra of
force and noise are, their levels in narrow bands are what is left there, and their likelihood is greatest with these
dynamics. So the two numbers of a resonance are found as on a shaken rig.

A channel of the motion that has another gain or is late leaves something as well, in other proportions along
frequency: the one that explains more is named.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.optimize import minimize

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.asked_readings import longest_stretch, unbroken
from aerobalance.estimation.checks.coherence import WORTH_A_LOOK, excess_of_coherence
from aerobalance.estimation.independent_record import SingleRecord
from aerobalance.estimation.spectra.lines import Line
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann


@dataclass(frozen=True, slots=True)
class DrivenResponseSettings:
    """How the response to the ground's motion is asked.

    Attributes
    ----------
    reach
        Lowest and highest frequency that is looked at, over the natural frequency [1].
    band
        Fewest ordinates of a band, and its width over that of the resonance between its half-power points.
    independent
        Numbers that the ordinates of a Hann window are worth, each: 18 of 35 (Harris, Proc. IEEE 66 (1978) 51: the
        correlation of neighbours by it, 2/3 and 1/6 in amplitude).
    decisive
        Gain in log-likelihood from which other dynamics are said to be those of the balance, without the band that
        gains most: chance has it once in 3 million for two numbers, and once in 50 000 records where one of them may
        have any of sixty values.
    over_channel
        The same over a channel's gain and delay, which are two numbers as well: 3000 to 1.
    frequencies, most_damping
        Largest logarithms of the natural frequency and the damping ratio over the expected ones.
    damping
        Damping ratios over the expected one from which it is begun.
    tone
        Power of an ordinate of the motion over the median about it from which it is a tone: a force may have the same.
    decayed
        Time constants of the ringing after a step that are left out.
    periods
        Periods of the balance in the shortest stretch.
    """

    reach: tuple[float, float] = (0.3, 3.0)
    band: tuple[int, float] = (8, 0.5)
    independent: float = 18 / 35
    decisive: float = 15.0
    over_channel: float = 8.0
    frequencies: float = 0.3
    most_damping: float = 3.5
    damping: tuple[float, ...] = (0.3, 1.0, 3.0)
    tone: float = 50.0
    decayed: float = 3.0
    periods: float = 30.0


SETTINGS: Final = DrivenResponseSettings()
"""Settings that are used."""

ROUNDING: Final = 1e-9
"""What is left of a load over it, up to which it is rounding."""

ABOUT: Final = 32
"""Ordinates on either side whose median a tone stands out of."""


class DrivenResponse(NamedTuple):
    """The resonance with which a load responds to the ground's motion.

    Attributes
    ----------
    change
        Logarithms of its natural frequency and its damping ratio over the expected ones, shape (2,) [1].
    u
        Their standard uncertainties, shape (2,) [1].
    """

    change: Array
    u: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Bands:
    """Ordinates of a series in bands: which, shape (k,), and first of each band among them, shape (b,)."""

    window: Array
    ordinates: NDArray[np.intp]
    firsts: NDArray[np.intp]

    @property
    def counts(self) -> Array:
        """Numbers that each band is worth, shape (b,)."""
        return SETTINGS.independent * np.diff(np.append(self.firsts, self.ordinates.size))

    def lines(self, values: Array) -> NDArray[np.complex128]:
        """Ordinates of a series (n,), its mean taken off, shape (k,)."""
        spectrum = np.asarray(rfft((values - values.mean()) * self.window), dtype=np.complex128)
        return spectrum[self.ordinates]

    def sums(self, values: NDArray[np.complex128] | Array) -> NDArray[np.complex128] | Array:
        """Sums over each band of something at the ordinates, shape (..., b)."""
        return np.add.reduceat(values, self.firsts, axis=-1)

    def costs(self, lines: NDArray[np.complex128]) -> Array:
        """Negative log-likelihood of each band with the level that is likeliest, shape (..., b)."""
        power = self.sums(lines.real**2 + lines.imag**2)
        return np.asarray(self.counts * np.log(np.maximum(power.real, 1e-300)))


@dataclass(frozen=True, slots=True, eq=False)
class _Driven:
    """A stretch of a load with what the ground's motion makes of it.

    Attributes
    ----------
    record
        The record.
    part
        Which of its samples.
    left, whole, felt
        Readings without and with all of the motion's load, and that load by the expected dynamics, shape (n,) [N].
    bands
        Bands in which they are compared.
    """

    record: SingleRecord
    part: slice
    left: Array
    whole: Array
    felt: Array
    bands: _Bands

    @property
    def frequency(self) -> Array:
        """Frequencies of the ordinates, shape (k,) [Hz]."""
        return self.bands.ordinates / (self.left.size * self.record.interval)

    def costs(self, change: Array) -> Array:
        """Negative log-likelihood of each band with another resonance, shape (b,)."""
        frequency, damping = np.exp(change).tolist()
        other = self.record.with_dynamics(self.record.dynamics.retuned(frequency=frequency, damping=damping))
        return self.bands.costs(self.bands.lines(self.whole - other.from_ground[self.part]))

    def likeliest(self) -> tuple[Array, Array]:
        """The likeliest change of the resonance, shape (2,), and each band's gain in log-likelihood by it, (b,)."""
        width = 0.3 * self.record.dynamics.damping_ratio
        most = np.array([SETTINGS.frequencies, SETTINGS.most_damping])
        change, _ = _least(lambda one: float(self.costs(one).sum()), self._nearly(), np.array([width, 0.3]), most=most)
        return change, self.bands.costs(self.bands.lines(self.left)) - self.costs(change)

    def by_channel(self) -> float:
        """Negative log-likelihood where a channel has the likeliest gain and delay."""
        load, felt, natural = self.bands.lines(self.whole), self.bands.lines(self.felt), self.record.dynamics
        turns = self.frequency / natural.natural_frequency

        def cost(change: Array) -> float:
            moved = (1 + change[0]) * np.exp(-2j * np.pi * turns * change[1])
            return float(self.bands.costs(load - moved * felt).sum())

        most = np.array([10.0, 1.0])
        return min(_least(cost, np.array([size, 0.0]), np.array([0.1, 0.02]), most=most)[1] for size in (0.0, -2.0))

    def uncertainty(self, change: Array) -> Array:
        """Standard uncertainties of a likeliest change by the curvature of its likelihood, shape (2,) [1]."""
        steps = np.array([0.1 * self.record.dynamics.damping_ratio, 0.1])
        cost = float(self.costs(change).sum())
        bends = [
            sum(float(self.costs(change + side * step).sum()) for side in (-1, 1)) - 2 * cost
            for step in np.diag(steps)
        ]
        return np.asarray(steps / np.sqrt(np.maximum(bends, 1e-12)))

    def _nearly(self) -> Array:
        """A change of the resonance that leaves nearly least, shape (2,).

        The response to the motion is that of a steady state: what the window makes of a ringing is left out.
        """
        own, load, felt = self.record.dynamics, self.bands.lines(self.whole), self.bands.lines(self.felt)
        most, step = SETTINGS.frequencies, max(0.5 * own.damping_ratio, 1e-3)
        here, best, found = own.response(self.frequency), np.inf, np.zeros(2)
        for damping in SETTINGS.damping:
            for change in np.arange(-most, most + step, step):
                other = own.retuned(frequency=float(np.exp(change)), damping=damping)
                cost = float(self.bands.costs(load - other.response(self.frequency) / here * felt).sum())
                if cost < best:
                    best, found = cost, np.array([change, np.log(damping)])
        return found


def driven_response(
    record: SingleRecord, *, used: SingleRecord, steps: Sequence[Step] = (), lines: Sequence[Line] = ()
) -> DrivenResponse | None:
    """Return the resonance with which a load responds to the ground's motion; None where it is the expected one.

    So it is as well where the record does not tell, or where gain and delay of a channel explain as much.

    Parameters
    ----------
    record
        The component with its record and dynamics.
    used
        The record whose force was worked out: its motion may have been brought to what the load shows of it.
    steps, lines
        Sudden changes of the force, and lines of its readings, that were found in the record.
    """
    driven = _driven(record, used, steps, lines)
    if driven is None or not _goes_with(driven.bands, driven.left, driven.felt):
        return None
    change, gained = driven.likeliest()
    inside = np.abs(change) < 0.99 * np.array([SETTINGS.frequencies, SETTINGS.most_damping])
    if float(gained.sum() - gained.max()) < SETTINGS.decisive or not inside.all():
        return None
    if driven.by_channel() - float(driven.costs(change).sum()) < SETTINGS.over_channel:
        return None
    return DrivenResponse(change, driven.uncertainty(change))


def speaks_against(
    other: Dynamics,
    record: SingleRecord,
    *,
    used: SingleRecord,
    steps: Sequence[Step] = (),
    lines: Sequence[Line] = (),
) -> bool:
    """Whether the response to the ground's motion speaks clearly for the expected dynamics and against others.

    Parameters
    ----------
    other
        The others, which the force of the flow seems to show: a gust that is not found may look like a ringing.
    record, used, steps, lines
        As in `driven_response`.
    """
    driven = _driven(record, used, steps, lines)
    if driven is None:
        return False
    own = record.dynamics
    change = np.log(
        [other.natural_frequency / own.natural_frequency, max(other.damping_ratio, 1e-12) / own.damping_ratio]
    )
    lost = driven.costs(change) - driven.bands.costs(driven.bands.lines(driven.left))
    return float(lost.sum() - lost.max()) > SETTINGS.decisive


def _driven(record: SingleRecord, used: SingleRecord, steps: Sequence[Step], lines: Sequence[Line]) -> _Driven | None:
    """The longest stretch without a gap or a step, once a ringing from its begin has decayed; None without one."""
    felt = record.from_ground
    seen = unbroken(used, (), lines) if np.ptp(felt) > 0 and record.dynamics.damping_ratio > 0 else None
    if seen is None:
        return None
    left, own = seen[0].values, record.dynamics
    first = longest_stretch(used).start
    whole = left + used.from_ground[first : first + left.size]
    decay = SETTINGS.decayed / (own.damping_ratio * own.angular_frequency * record.interval) if steps else 0.0
    places = [round(step.instant / record.interval) - first for step in steps]
    edges = [0, *sorted(place for place in places if 0 < place < left.size), left.size]
    ends = [(begin + (int(decay) if begin else 0), end) for begin, end in pairwise(edges)]
    begin, end = max(ends, key=lambda one: one[1] - one[0])
    if end - begin < SETTINGS.periods / (own.natural_frequency * record.interval):
        return None
    if np.ptp(left[begin:end]) <= ROUNDING * np.ptp(felt):
        return None  # nothing is left
    part = slice(first + begin, first + end)
    bands = _bands_of(felt[part], own, record.interval)
    return None if bands is None else _Driven(record, part, left[begin:end], whole[begin:end], felt[part], bands)


def _bands_of(felt: Array, own: Dynamics, interval: float) -> _Bands | None:
    """Bands about the natural frequency, without tones of the motion; None where the record is too short for them."""
    count = felt.size
    resolution = 1 / (count * interval)
    lowest, highest = (one * own.natural_frequency / resolution for one in SETTINGS.reach)
    first, last = max(int(lowest), 3), min(int(highest), int(0.45 * count))
    fewest, width = SETTINGS.band
    each = max(fewest, int(width * 2 * own.damping_ratio * own.natural_frequency / resolution))
    ordinates = np.arange(first, last + 1)
    if ordinates.size < 4 * each:
        return None
    window = hann(count)
    power = np.abs(np.asarray(rfft((felt - felt.mean()) * window))) ** 2 / np.maximum(
        np.abs(own.response(np.arange(count // 2 + 1) * resolution)) ** 2, 1e-300
    )
    about = np.lib.stride_tricks.sliding_window_view(np.pad(power, ABOUT, mode="reflect"), 2 * ABOUT + 1)
    stands_out = power[ordinates] > SETTINGS.tone * np.median(about[ordinates], axis=-1)
    plain = np.convolve(stands_out, np.ones(5), mode="same") == 0
    ordinates = ordinates[plain]
    if ordinates.size < 4 * each:
        return None
    return _Bands(window, ordinates, np.arange(0, ordinates.size - each + 1, each))


def _goes_with(bands: _Bands, left: Array, felt: Array) -> bool:
    """Whether what is left of a load (n,) goes with what the ground's motion makes of it, more than by chance."""
    excess = excess_of_coherence(bands.lines(left), bands.lines(felt), bands.firsts, bands.counts)
    return excess > WORTH_A_LOOK


def _least(cost: Callable[[Array], float], start: Array, steps: Array, *, most: Array) -> tuple[Array, float]:
    """Where a cost of two numbers of limited size is least near a start, shape (2,), and the cost there."""
    simplex = start + np.array([[0.0, 0.0], [steps[0], 0.0], [0.0, steps[1]]])
    found = minimize(
        cost,
        start,
        method="Nelder-Mead",
        bounds=[(-one, one) for one in most.tolist()],
        options={"initial_simplex": np.clip(simplex, -most, most), "maxfev": 80, "xatol": 1e-5, "fatol": 0.05},
    )
    return np.asarray(found.x), float(found.fun)
