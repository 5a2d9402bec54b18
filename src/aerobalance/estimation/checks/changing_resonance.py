"""Whether the resonance of a balance changes along a record: what its stretches say, each by itself.

Where a balance changes on the way, as when a screw comes loose or it warms up, its old dynamics explain one part of
the record and its new ones the other, and the record as a whole speaks for neither. A stretch of many periods speaks
for those that it has.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from scipy.special import chdtri, fdtrc

from aerobalance.dynamics.modal import ModalModel
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.near_resonance import resonance_gain, resonances_apart
from aerobalance.estimation.checks.spoken import Spoken
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import HANN_ORDINATES, hann


@dataclass(frozen=True, slots=True)
class ChangingSettings:
    """Which stretches are looked at.

    Attributes
    ----------
    most
        Stretches at most, an even number.
    periods, samples
        Periods of the balance and samples that a stretch has at least: of fewer its spectrum tells too little.
    apart
        Probability that stretches of one resonance look by chance as if each had its own, from which on they are
        looked at one by one. Of 40 records that change by 0.7 or 1 % halfway each that was named had at most 0.15.
    moved
        The same for a stretch by itself and the dynamics that are expected, from which on it is looked at: a gain of
        6.9. Of 80 stretches that were found to have others, with a gain of 10 or more in all, none had less than 10.1.
    band, ordinates
        Width of a band of the spectrum over its frequency, and ordinates that it has at least.
    about
        Bands on either side of one whose median is the level about it.
    chance
        Probability that a band of one stretch is by chance as far above the same of all others, its surroundings
        apart, from which on the stretches are looked at one by one; there are some thousand bands.
    decayed, least_damping
        Decay times of a free oscillation after which nothing is left of it, and damping ratio that it has at least.
    left
        Part of a stretch that must be left between its steps.
    least_gain
        Gain in log-likelihood of other dynamics in a stretch from which on the record leaves them open: chance brings
        it to one of a thousand, and there are up to six.
    """

    most: int = 4
    periods: float = 300.0
    samples: int = 4096
    apart: float = 0.2
    moved: float = 0.001
    band: float = 0.01
    ordinates: int = 8
    about: int = 12
    chance: float = 1e-7
    decayed: float = 5.0
    least_damping: float = 1e-3
    left: float = 0.5
    least_gain: float = 10.0


SETTINGS: Final = ChangingSettings()
"""Settings that are used."""


class Changed(NamedTuple):
    """The dynamics that a part of a record speaks for, and where.

    Attributes
    ----------
    spoken
        The dynamics.
    first, last
        First sample of the stretches that speak for them, and the one after the last.
    each
        Samples of a stretch.
    """

    spoken: Spoken
    first: int
    last: int
    each: int


def changes_along(
    values: Array,
    dynamics: Dynamics,
    ask: Callable[[Array], Spoken | None],
    *,
    interval: float,
    steps: Sequence[Step] = (),
) -> Changed | None:
    """Return the other dynamics that some of a record speaks for most clearly, and where; None where nothing does.

    Parameters
    ----------
    values
        Readings without gaps, hum and other tones, shape (n,) [N].
    dynamics
        The dynamics that they are read with.
    ask
        Gives what some of them speak for (`spoken_for`).
    interval
        Time between samples [s].
    steps
        Steps that were found in the readings: of a stretch what lies longest between two is looked at, once the
        ringing of the first has decayed.
    """
    count = stretches_of(values.size, interval, dynamics)
    if not count:
        return None
    edges = np.linspace(0, values.size, count + 1).astype(int)
    least = int(np.diff(edges).min() * SETTINGS.left)

    def calm(ends: tuple[int, int]) -> Array | None:
        part = values[calm_stretch(*ends, steps=steps, interval=interval, dynamics=dynamics)]
        return part - part.mean() if part.size >= least else None

    stretches = list(pairwise(edges.tolist()))
    parts = [part for part in map(calm, stretches) if part is not None]
    differ = _differ(parts)
    if not differ and resonances_apart(parts, interval, dynamics) < _by_chance(SETTINGS.apart, 2 * len(parts) - 2):
        return None
    found = []
    # what is faint in each stretch may be clear in two
    for ends in sorted({*stretches, *pairwise(edges[:: count // 2].tolist())}):
        part = calm(ends)
        if part is None or not (differ or resonance_gain(part, interval, dynamics) > _by_chance(SETTINGS.moved, 2)):
            continue
        spoken = ask(part)
        if spoken is None or spoken.probability == 0:
            continue
        if spoken.kind != "no resonance" and spoken.gain >= SETTINGS.least_gain:
            found.append(Changed(spoken, *ends, int(edges[1])))
    if not found:
        return None
    clear = [one for one in found if one.spoken.probability == 1]
    clearest = max(clear or found, key=lambda one: one.spoken.gain)
    same = [one for one in clear or [clearest] if one.spoken.kind == clearest.spoken.kind]
    return clearest._replace(first=min(one.first for one in same), last=max(one.last for one in same))


def stretches_of(samples: int, interval: float, dynamics: Dynamics) -> int:
    """Return in how many stretches a record of so many samples is looked at; 0 where it is too short for two."""
    periods = samples * interval * dynamics.natural_frequency
    count = min(SETTINGS.most, int(periods / SETTINGS.periods), samples // SETTINGS.samples)
    return count - count % 2


def calm_stretch(first: int, last: int, *, steps: Sequence[Step], interval: float, dynamics: ModalModel) -> slice:
    """Return the longest stretch without a step, between two samples, that begins where the one before has decayed.

    Parameters
    ----------
    first, last
        The samples, the second excluded.
    steps
        The steps.
    interval
        Time between samples [s].
    dynamics
        What decays.
    """
    least = SETTINGS.least_damping * dynamics.angular_frequency
    decay = SETTINGS.decayed / max(dynamics.decay_rate, least)
    inside = sorted((step.instant, step.instant + step.duration + decay) for step in steps)
    begins = [first, *(max(int(end / interval), first) for _, end in inside if end > first * interval)]
    free = [
        (begin, min([last, *(int(at / interval) for at, _ in inside if at / interval >= begin)]))
        for begin in begins
        if not any(at / interval < begin < end / interval - 1 for at, end in inside)
    ]
    begin, end = max(free, key=lambda pair: pair[1] - pair[0], default=(first, first))
    return slice(begin, max(begin, end))


def _differ(parts: Sequence[Array]) -> bool:
    """Whether a narrow band of the spectrum of one stretch stands out of the same of the others."""
    if len(parts) < 2:
        return False
    count = min(part.size for part in parts)
    power = np.array([np.abs(np.fft.rfft(part[:count] * hann(count))) ** 2 for part in parts])
    edges = [SETTINGS.ordinates]
    while edges[-1] < power.shape[1]:
        edges.append(edges[-1] + max(SETTINGS.ordinates, int(SETTINGS.band * edges[-1])))
    if len(edges) < 2 * SETTINGS.about:
        return False
    level = np.add.reduceat(power, edges[:-1], axis=1) / np.diff(edges)
    others = (level.sum(axis=0) - level) / (len(parts) - 1)
    apart = np.log(np.maximum(level, 1e-300) / np.maximum(others, 1e-300))
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(apart, ((0, 0), (SETTINGS.about, SETTINGS.about)), mode="edge"), 2 * SETTINGS.about + 1, axis=1
    )
    apart -= np.median(windows, axis=2)
    # A ratio of two sums of exponentials has Fisher's distribution. Where the spectrum is uneven within a band, as
    # where a load ends, it has that of as many equal ones as have the same sum and the same sum of squares; means of
    # m exponentials have squares 1 + 1/m times as large.
    rest = (power.sum(axis=0) - power) / (len(parts) - 1)
    sums, squares = (np.add.reduceat(of, edges[:-1], axis=1) for of in (rest, rest**2))
    equal = (1 + 1 / (len(parts) - 1)) * sums**2 / np.maximum(squares, 1e-300)
    freedom = 2 * HANN_ORDINATES * np.clip(equal, 1.0, np.diff(edges))
    chance = fdtrc(freedom, (len(parts) - 1) * freedom, np.exp(apart))
    return bool((chance[:, :-1] < SETTINGS.chance).any())


def _by_chance(probability: float, freedom: int) -> float:
    """Gain in log-likelihood that as many parameters more bring by chance with a probability (Wilks)."""
    return float(chdtri(freedom, probability)) / 2 if freedom else np.inf
