"""Friction, and damping or stiffness that changes with the motion, by what they leave above the band of the load.

The readings tell the spring's deflection x and its speed v. A force such as -sign(v) has power where the load has
none, with a phase that the motion within the band decides. A Gaussian load, and noise of any color, are independent
there of what is within: the readings above the band regressed on what each such term leaves there, each frequency by
the power beside it, show none but by chance. Of a spring that bends more, or less, than in proportion to its load r
the inertia of the deflection that is too much is missing: of r = G F + (1 - G) c(r) the second part. A load that is
not Gaussian may be coherent with a term: then it is so at other lags as well, which have no part in the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from aerobalance.dynamics.modal import ModalModel
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.observation import Observation
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Doubt

Term = Callable[[Array, Array], Array]

OF_DAMPING: Final[Mapping[str, Term]] = {
    "friction": lambda x, v: np.sign(v),
    "damping that grows with the deflection": lambda x, v: np.abs(x) * v,
    "damping that grows with the speed": lambda x, v: np.abs(v) * v,
}
"""Forces against the motion that are looked for, of deflection and speed over their root mean squares."""

OF_SPRING: Final[Mapping[str, Term]] = {
    "stiffness that changes with the deflection": lambda x, v: x**3,
    "stiffness that differs by the side": lambda x, v: x**2,
}
"""Forces of a spring with the load that bends it, of either sign."""

TERMS: Final[Mapping[str, Term]] = {**OF_DAMPING, **OF_SPRING}
"""All that is looked for."""

GAIN: Final = 8.0
"""Gain in log-likelihood that is no chance: four deviations with the right sign, in one of ten thousand sound records
by any of the terms of damping."""

GAIN_OF_SPRING: Final = 10.0
"""The same of the terms of a spring, which have either sign."""

OPEN: Final = 4.0
"""Gain below these from which on what is not linear is left open."""

AS_LIKELY: Final = 2.5
"""Gain below these at which it is as likely as not."""

STEEPNESS: Final = 0.8
"""Change of the logit of its probability with the gain."""

SHARE: Final = 0.99
"""Part of the force's power that the band of the load has: what is left above it is weighed as noise."""

STANDS_OUT: Final = 10.0
"""Power of an ordinate over that of the noise, from which on it may be the load's: noise is so once in e^10."""

BESIDE: Final = 15
"""Ordinates either side whose power weighs one: thirty tell it to a fifth."""

TAPERED: Final = 0.1
"""Part of the record at each end that is tapered, so that the load does not leak out of its band."""

QUIET: Final = 0.35
"""Frequency over the sampling rate above which the readings are taken for noise."""

HIGHEST: Final = 0.2
"""Frequency over the sampling rate up to which the band of the load is looked for."""

BELOW_HARMONICS: Final = 1.6
"""Frequency over the natural one up to which a motion is no harmonic of the resonance."""

LAG_TOLD: Final = 3.0
"""Gain of the best match over that at no lag, from which on it is another lag: of a term that acts at once twice the
gain is chi-square with one degree of freedom, and is more in 1.4 % of records."""

FEWEST: Final = 200
"""Ordinates above the band that are needed at least."""

PARTS: Final = 4
"""Parts of a record that are each to show it where something in the record is not explained."""

RIGHT_AWAY: Final = 1 / 6
"""Lag of the best match at most, in periods of the balance: a lag beyond it turns the sign of a term's phase."""

RIGHT_AWAY_OF_SPRING: Final = 1 / 2
"""The same of the terms of a spring: harmonics of the resonance are nearly as alike some of their periods away."""


@dataclass(frozen=True, slots=True)
class NotLinear:
    """A force that goes with the motion and that the dynamics lack.

    Attributes
    ----------
    kind
        Which of `TERMS`.
    size, u
        Its size, where deflection and speed are at their root mean squares, and its standard uncertainty [N]; of a
        spring the load by which it bends too little.
    edge
        Frequency up to which the motion is taken for linear [Hz].
    band
        Frequency that the band of the load ends at, harmonics of the resonance that look like a load included [Hz].
    probability
        How probable it is [1]; 1 where it is found, and less where the record leaves it open.
    """

    kind: str
    size: float
    u: float
    edge: float
    band: float
    probability: float = 1.0

    @property
    def of_spring(self) -> bool:
        """Whether the spring is what is not linear."""
        return self.kind in OF_SPRING

    def force(self, felt: Array, dynamics: ModalModel, *, interval: float) -> Array:
        """Return the force that goes with an applied one, shape (n,) [N]."""
        frequency = np.asarray(np.fft.rfftfreq(felt.size, interval))
        response = dynamics.response(frequency)
        moving = response * np.fft.rfft(felt - felt.mean())
        x, v = _motion(moving, frequency, edge=self.edge, count=felt.size)
        found = float(np.hypot(self.size, self.u)) * TERMS[self.kind](x, v)
        if not self.of_spring:
            return found
        missing = np.where(frequency <= self.band, (1 / response - 1) * np.fft.rfft(found - found.mean()), 0.0)
        return np.asarray(np.fft.irfft(missing, felt.size))

    def doubt(self, component: str, *, effect: float, unit: str) -> Doubt:
        """Return it in words."""
        size = f"{abs(self.size):.3g} {unit} (u = {self.u:.2g} {unit})"
        if self.of_spring:
            text = (
                f"{component} shows {self.kind}: where the load has its rms, the spring bends as under {size} "
                f"{'less' if self.size > 0 else 'more'} than in proportion; the dynamics are linear, so the inertia "
                "of that is missing in the force"
            )
            advice = "look for what touches or is loose: stops, seals, a joint; keep to loads at which it is linear"
            return Doubt("not linear", component, text, advice, effect, unit)
        text = (
            f"{component} shows {self.kind}, a force of {size} where the motion has its rms: the dynamics are linear "
            "and lack it, so it is missing in the force"
        )
        advice = "look for what touches or rubs: cables, seals, a fouled gap; identify with releases of several sizes"
        return Doubt("not linear", component, text, advice, effect, unit)


def not_linear(reading: Observation, dynamics: Dynamics, *, left: Array | None = None) -> NotLinear | None:
    """Return what a record shows, or leaves open, of a force that is not linear in the motion; None where nothing.

    Parameters
    ----------
    reading
        An unbroken record.
    dynamics
        The balance.
    left
        What is left of it without its steps, shape (n,) [N]; None where it has none. A step has power at all
        frequencies, in phase with what it does within the band of the load: with one a spring alone is looked at.
    """
    values = reading.values - reading.values.mean()
    count, rate = values.size, 1 / reading.interval
    frequency = np.asarray(np.fft.rfftfreq(count, reading.interval))
    seen = np.fft.rfft(_taper(count) * (values if left is None else left))
    last = _edge(np.abs(seen) ** 2, dynamics.response(frequency), frequency, rate=rate)
    if last is None:
        return None
    best: tuple[float, NotLinear] | None = None
    for terms, place in _terms(dynamics, frequency, last, of_spring_alone=left is not None):
        found = _best_of(terms, seen, values, dynamics, frequency=frequency, last=place, band=last)
        if found is not None and (best is None or found[0] > best[0]):
            best = found
    return None if best is None else best[1]


def all_along(reading: Observation, dynamics: Dynamics, shown: NotLinear, *, left: Array | None = None) -> bool:
    """Whether every part of a record by itself shows the same that is not linear, with the same sign.

    What a shock leaves goes with the motion of one part.

    Parameters
    ----------
    reading, dynamics, left
        As for `not_linear`.
    shown
        What all of it shows.
    """
    edges = np.linspace(0, reading.values.size, PARTS + 1).astype(int)
    for part in (slice(first, last) for first, last in pairwise(edges)):
        values = replace(reading, values=reading.values[part])
        found = not_linear(values, dynamics, left=None if left is None else left[part])
        if found is None or found.kind != shown.kind or found.size * shown.size <= 0:
            return False
    return True


def friction_of(size: float, u: float, dynamics: Dynamics) -> NotLinear | None:
    """Return a friction found by other means, or None where it is chance.

    Parameters
    ----------
    size, u
        Friction and its standard uncertainty [N].
    dynamics
        The balance.
    """
    gain = 0.5 * (size / u) ** 2
    if size <= 0 or gain <= GAIN - OPEN:
        return None
    edge = BELOW_HARMONICS * dynamics.natural_frequency
    return NotLinear("friction", size, u, edge, edge, _probability(gain, GAIN))


def _probability(gain: float, needed: float) -> float:
    """How probable it is by a gain in log-likelihood [1]; 1 from what is needed on."""
    return 1.0 if gain > needed else float(expit(STEEPNESS * (gain - needed + AS_LIKELY)))


def _terms(
    dynamics: Dynamics, frequency: Array, last: int, *, of_spring_alone: bool
) -> Iterator[tuple[Mapping[str, Term], int]]:
    """Terms of damping and of a spring, and the last ordinate of the motion that they are looked for in.

    What a spring that is not linear leaves at harmonics of the resonance may stand out as a load does.
    """
    if not of_spring_alone:
        yield OF_DAMPING, last
    below = int(np.searchsorted(frequency, BELOW_HARMONICS * dynamics.natural_frequency))
    yield OF_SPRING, min(last, below)


def _best_of(
    terms: Mapping[str, Term],
    seen: NDArray[np.complex128],
    values: Array,
    dynamics: Dynamics,
    *,
    frequency: Array,
    last: int,
    band: int,
) -> tuple[float, NotLinear] | None:
    """Gain of the likeliest of some terms, and what it says; None where none is likely enough to be left open."""
    count = values.size
    rate = float(frequency[1]) * count
    above = (np.arange(frequency.size) > last + 4) & (frequency < 0.45 * rate)
    if above.sum() < FEWEST:
        return None
    power, response, window = np.abs(seen) ** 2, dynamics.response(frequency), _taper(count)
    x, v = _motion(np.fft.rfft(values), frequency, edge=float(frequency[last]), count=count)
    beside = np.ones(2 * BESIDE + 1)
    total = np.convolve(np.where(above, power, 0.0), beside, "same")
    level = total / np.maximum(np.convolve(above.astype(np.float64), beside, "same"), 1.0)
    weight = np.where(above, 1 / np.maximum(level, 1e-300), 0.0)
    # a taper makes neighbouring ordinates alike: they tell so much less
    alike = float(np.mean(window**4) / np.mean(window**2) ** 2)
    period = rate / dynamics.natural_frequency
    best: tuple[float, NotLinear] | None = None
    for kind, term in terms.items():
        shape, of_spring = term(x, v), kind in OF_SPRING
        shown = (response - 1 if of_spring else response) * np.fft.rfft(window * (shape - shape.mean()))
        match = np.fft.irfft(weight * shown.conj() * seen, count) * count / 2
        information = float(np.sum(weight * np.abs(shown) ** 2))
        told = min(1 / (information * alike), 1 / (2 * float(np.mean(match**2))))
        gain = match[0] ** 2 * told
        lag = int(np.argmax(np.abs(match)))
        later = match[lag] ** 2 * told - gain > LAG_TOLD
        away = RIGHT_AWAY_OF_SPRING if of_spring else RIGHT_AWAY
        needed = GAIN_OF_SPRING if of_spring else GAIN
        if (later and min(lag, count - lag) > max(away * period, 1.0)) or not (of_spring or match[0] < 0):
            continue
        if gain > needed - OPEN and (best is None or gain > best[0]):
            size = -match[0] / information
            likely = _probability(gain, needed)
            best = (
                gain,
                NotLinear(
                    kind, size, abs(size) / np.sqrt(2 * gain), float(frequency[last]), float(frequency[band]), likely
                ),
            )
    return best


def _edge(power: Array, response: NDArray[np.complex128], frequency: Array, *, rate: float) -> int | None:
    """Ordinate that the band of the load ends at; None where no load stands out of the noise."""
    quiet = frequency > QUIET * rate
    if not quiet.any():
        return None
    floor = float(np.median(power[quiet])) / np.log(2)  # of chi-square with two degrees of freedom
    load = (power > STANDS_OUT * floor) & (frequency < HIGHEST * rate)
    if not load.any():
        return None
    share = np.cumsum(np.where(load, (power - floor) / np.abs(response) ** 2, 0.0))
    return int(np.searchsorted(share, SHARE * share[-1]))


def _motion(reading: NDArray[np.complex128], frequency: Array, *, edge: float, count: int) -> tuple[Array, Array]:
    """Deflection and speed below a frequency, each over its root mean square, from the spectrum of a reading."""
    within = np.where(frequency <= edge, reading, 0.0)
    x, v = np.fft.irfft(within, count), np.fft.irfft(2j * np.pi * frequency * within, count)
    return x / max(float(np.std(x)), 1e-300), v / max(float(np.std(v)), 1e-300)


def _taper(count: int) -> Array:
    """Window that rises and falls as a cosine over the ends, shape (count,)."""
    place = (np.arange(count) + 0.5) / count
    ends = np.minimum(np.minimum(place, 1 - place) / TAPERED, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * ends))
