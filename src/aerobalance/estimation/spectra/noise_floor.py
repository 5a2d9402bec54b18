"""A floor of the reading's noise that is not flat, seen in the record itself where a force cannot well be.

Above its natural frequency the balance shows less and less of a force. So what is broad, about as faint as the noise
there, and as a force stronger than what lies below it in frequency, is more likely noise with a color. As a force it
would be enlarged by 1 / |G|. Both are compared: a force with the spectrum that was learned in white noise, and noise
with humps and no force; the force has to be clearly likelier.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.estimation.prior import Observation, SpectralPrior, fit_prior
from aerobalance.estimation.spectra.noise_record import Ordinates, cost_of, fitted, humps_of, model_of
from aerobalance.estimation.spectra.noise_spectrum import ColoredNoise
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import argument
from aerobalance.recording.fourier import hann

CERTAIN: Final = 5.0
"""Level in the reading over the noise from which on a broad band is force."""

WEAKENED: Final = 1.0
"""Square of the response below which a force and the color of a noise can be told apart."""

GRID: Final = 8193
"""Frequencies from zero to half the sampling rate at which spectra are compared."""

DECISIVE: Final = 10.0
"""Gain in log-likelihood that the force must bring over the humps: by itself, noise is likelier.

A band of force with an edge at its lower end falls in the reading as f^-4, which is much like a hump.
"""

MARGIN: Final = 40
"""Ordinates beside a strong band in which the window leaks noticeably."""

DEPARTURE: Final = 0.2
"""Logarithm of the ratio of powers from which on the noise of a run is not that of the record of noise."""

FEWEST_ORDINATES: Final = 64
"""Independent ordinates from which on a floor is looked at."""

SEEN: Final = 3.0
"""Gain in log-likelihood that a floor must bring over white noise alone before it is spoken of."""


BLOCKS: Final = 16
"""Parts of a record whose powers are compared."""

LASTING: Final = 0.5
"""Power beyond white noise of the middlemost part over the mean of all, below which it is there only for a while."""


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """What is broad, faint and far above the natural frequency.

    Attributes
    ----------
    first, last
        Where it is [Hz].
    in_reading, as_force
        Its root mean square in the reading, and as a force [N].
    color
        The noise that explains it about as well as a force does, or better; None if none does.
    """

    first: float
    last: float
    in_reading: float
    as_force: float
    color: ColoredNoise | None

    def doubt(self, component: str, *, unit: str) -> Doubt:
        """What it says against the force."""
        seen = (
            f"{component} shows {self.in_reading:.2g} {unit} rms between {self.first:.3g} and {self.last:.3g} Hz "
            "above the white noise of its readings"
        )
        if self.color is not None:
            what = (
                f"it is taken for noise of the electronics and not for a force of {self.as_force:.2g} {unit} rms: if "
                "it is force it is missing from the result"
            )
        else:
            what = (
                f"it is taken for a force of {self.as_force:.2g} {unit} rms, but is so faint that it may be noise of "
                "the electronics, and is then an error of the result"
            )
        advice = f"a record of noise alone ({argument('noise')}) decides"
        effect = self.as_force if self.color is None else 0.0
        return Doubt("colored noise", component, f"{seen}; {what}", advice, effect, unit)


def floor_of(reading: Observation, learned: SpectralPrior, *, left: Array) -> Floor | None:
    """Look for a color in the floor of a record.

    Parameters
    ----------
    reading
        The record; what has gaps is not looked at.
    learned
        What was learned from it with white noise.
    left
        The readings without steps and hum, shape (n,) [N].
    """
    spectrum, interval = learned.spectrum, reading.interval
    if reading.color is not None or spectrum.roll_off or spectrum.levels.size < 2 or not reading.present.all():
        return None
    white = learned.noise**2 * interval
    frequency: Array = np.linspace(0, 0.5 / interval, GRID)[1:]
    gain = np.abs(reading.dynamics.response(frequency)) ** 2
    shown = gain * spectrum.density(frequency)
    strong = frequency[(shown > CERTAIN * white) | (gain > WEAKENED)]
    edge = float(strong[-1]) if strong.size else 0.0
    # a tail that falls is a force's own; what rises again is doubtful
    rising = [
        place
        for place in range(1, spectrum.levels.size)
        if spectrum.levels[place] > spectrum.levels[place - 1] and spectrum.edges[place] > edge
    ]
    if not rising:
        return None
    step = float(frequency[1] - frequency[0])
    first = max(edge, float(spectrum.edges[rising[0] - 1]))
    beyond = frequency > first
    if _gain_expected(shown[beyond] / white) * reading.values.size / (2 * frequency.size) < SEEN:
        return None
    if not lasts(left, first=first, interval=interval, noise=learned.noise):
        return None
    last = float(spectrum.edges[np.flatnonzero(spectrum.levels)[-1]])
    in_reading, as_force = (
        float(np.sqrt(2 * step * np.sum(part[beyond]))) for part in (shown, spectrum.density(frequency))
    )
    start = edge + MARGIN / (reading.values.size * interval)
    color = _likelier_color(reading, learned, left=left, start=start)
    if color is None and reading.noise is not None:
        return None  # more white noise than was given for the channel, throughout or for a while, looks like that
    return Floor(first, last, in_reading, as_force, color)


def _gain_expected(ratio: Array) -> float:
    """Log-likelihood that ordinates with this power over the noise are expected to gain by it, summed over them.

    Every ordinate of noise of power 1 + r has the mean of r - log(1 + r).
    """
    return float(np.sum(ratio - np.log1p(ratio)))


def lasts(left: Array, *, first: float, interval: float, noise: float) -> bool:
    """Whether what is above a frequency [Hz] is there all the time, as the noise of electronics is.

    A burst is none, and is told where the innovations show it (`aerobalance.estimation.force`).
    """
    taper = hann(left.size)  # without it the ends of the record, which do not meet, ring in all of it
    transform = np.fft.rfft((left - left.mean()) * taper)
    frequency = np.fft.rfftfreq(left.size, interval)
    high = np.fft.irfft(np.where(frequency > first, transform, 0.0), left.size)
    inner = slice(1, -1)  # the taper leaves nothing of the first and the last part
    squares, weights = (np.array_split(part**2, BLOCKS)[inner] for part in (high, taper))
    power = np.array([one.sum() / weight.sum() for one, weight in zip(squares, weights, strict=True)])
    ordinates = np.count_nonzero(frequency > first)
    white = noise**2 * ordinates / frequency.size
    middle = float(np.median(power))
    # the variance of a part scatters by 1 / sqrt(its ordinates), the median of n such by 1.25 / sqrt(n) of that
    scatter = 1.25 * middle / np.sqrt(ordinates)
    return bool(middle - white > LASTING * (power.mean() - white) - 3 * scatter)


def departure_of(reading: Observation) -> float | None:
    """Power of a run's white noise over that of the noise that was given for it [1]; None where they agree.

    Where they do not, the noise of the run has to be learned from the run: if it were taken as given, what is beyond
    it would be taken for force.
    """
    if reading.noise is None:
        return None
    count = reading.values.size
    free = fit_prior(replace(reading, noise=None), columns=np.ones((count, 1)))
    ratio = (free.noise / reading.noise) ** 2
    chance = float(np.sqrt(2 / np.count_nonzero(reading.present)))
    return None if abs(np.log(ratio)) < max(DEPARTURE, 6 * chance) else ratio


def _likelier_color(reading: Observation, learned: SpectralPrior, *, left: Array, start: float) -> ColoredNoise | None:
    """Humps of the noise that explain what is above a frequency [Hz] about as well as a force; None if none do."""
    seen = Ordinates.of(
        left, reading.dynamics, interval=reading.interval, input_density=reading.input_density, taper=1.0
    ).above(start)
    if float(np.sum(seen.weight)) < FEWEST_ORDINATES:
        return None
    point = fitted(seen, slow=False)
    humps = humps_of(point)
    spectrum, white = learned.spectrum, learned.noise**2 * reading.interval
    force = seen.gain * spectrum.density(seen.frequency) + seen.fixed + white
    numbers = 2 * np.count_nonzero(spectrum.levels[spectrum.edges > start]) - 3 * len(humps)
    gained = cost_of(force, seen) - cost_of(model_of(point, seen), seen)
    if not humps or gained + 0.5 * numbers * np.log(np.sum(seen.weight)) < -DECISIVE:
        return None
    return ColoredNoise(np.zeros(0), np.zeros(0), humps, reading.interval)
