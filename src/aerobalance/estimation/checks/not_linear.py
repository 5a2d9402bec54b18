"""Friction, and damping that changes with the motion, by what they leave above the band of the load.

The readings tell the spring's deflection x and its speed v. A force such as -sign(v) has power where the load has
none, with a phase that the motion within the band decides. A Gaussian load, and noise of any color, are independent
there of what is within: the readings above the band regressed on what each such term leaves there, each frequency by
the power beside it, show none but by chance. A load that is not Gaussian may be coherent with a term: then it is so at
other lags as well, which have no part in the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.prior import Observation
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Doubt

TERMS: Final[Mapping[str, Callable[[Array, Array], Array]]] = {
    "friction": lambda x, v: np.sign(v),
    "damping that grows with the deflection": lambda x, v: np.abs(x) * v,
    "damping that grows with the speed": lambda x, v: np.abs(v) * v,
}
"""Forces against the motion that are looked for, of deflection and speed over their root mean squares."""

GAIN: Final = 8.0
"""Gain in log-likelihood that is no chance: four deviations with the right sign, in one of ten thousand sound records
by any of the three terms."""

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

FEWEST: Final = 200
"""Ordinates above the band that are needed at least."""

RIGHT_AWAY: Final = 1 / 6
"""Lag of the best match at most, in periods of the balance: a lag beyond it turns the sign of a term's phase."""


@dataclass(frozen=True, slots=True)
class NotLinear:
    """A force against the motion that the dynamics lack.

    Attributes
    ----------
    kind
        Which of `TERMS`.
    size, u
        Its size, where deflection and speed are at their root mean squares, and its standard uncertainty [N].
    edge
        Frequency that the band of the load ends at [Hz].
    """

    kind: str
    size: float
    u: float
    edge: float

    def force(self, felt: Array, dynamics: ModalModel, *, interval: float) -> Array:
        """Return the force that goes with an applied one, shape (n,) [N]."""
        frequency = np.asarray(np.fft.rfftfreq(felt.size, interval))
        moving = dynamics.response(frequency) * np.fft.rfft(felt - felt.mean())
        x, v = _motion(moving, frequency, edge=self.edge, count=felt.size)
        return float(np.hypot(self.size, self.u)) * TERMS[self.kind](x, v)

    def doubt(self, component: str, *, effect: float, unit: str) -> Doubt:
        """Return it in words."""
        text = (
            f"{component} shows {self.kind}, a force of {self.size:.3g} {unit} (u = {self.u:.2g} {unit}) where the "
            "motion has its rms: the dynamics are linear and lack it, so it is missing in the force"
        )
        advice = "look for what touches or rubs: cables, seals, a fouled gap; identify with releases of several sizes"
        return Doubt("not linear", component, text, advice, effect, unit)


def not_linear(reading: Observation, dynamics: Dynamics) -> NotLinear | None:
    """Return what a record shows of a force against the motion that is not linear; None where it shows none.

    Parameters
    ----------
    reading
        An unbroken record without steps.
    dynamics
        The balance.
    """
    values = reading.values - reading.values.mean()
    count, rate = values.size, 1 / reading.interval
    frequency = np.asarray(np.fft.rfftfreq(count, reading.interval))
    response, window = dynamics.response(frequency), _taper(count)
    seen = np.fft.rfft(window * values)
    power = np.abs(seen) ** 2
    last = _edge(power, response, frequency, rate=rate)
    if last is None:
        return None
    above = (np.arange(frequency.size) > last + 4) & (frequency < 0.45 * rate)
    if above.sum() < FEWEST:
        return None
    x, v = _motion(np.fft.rfft(values), frequency, edge=float(frequency[last]), count=count)
    beside = np.ones(2 * BESIDE + 1)
    total = np.convolve(np.where(above, power, 0.0), beside, "same")
    level = total / np.maximum(np.convolve(above.astype(np.float64), beside, "same"), 1.0)
    weight = np.where(above, 1 / np.maximum(level, 1e-300), 0.0)
    # a taper makes neighbouring ordinates alike: they tell so much less
    alike = float(np.mean(window**4) / np.mean(window**2) ** 2)
    period = 1 / (dynamics.natural_frequency * reading.interval)
    best: tuple[float, NotLinear] | None = None
    for kind, term in TERMS.items():
        shape = term(x, v)
        shown = response * np.fft.rfft(window * (shape - shape.mean()))
        match = np.fft.irfft(weight * shown.conj() * seen, count) * count / 2
        information = float(np.sum(weight * np.abs(shown) ** 2))
        gain = min(match[0] ** 2 / (information * alike), match[0] ** 2 / (2 * float(np.mean(match**2))))
        lag = int(np.argmax(np.abs(match)))
        near = min(lag, count - lag) <= max(RIGHT_AWAY * period, 1.0)
        if match[0] < 0 and near and gain > GAIN and (best is None or gain > best[0]):
            size = -match[0] / information
            best = gain, NotLinear(kind, size, size / np.sqrt(2 * gain), float(frequency[last]))
    return None if best is None else best[1]


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
