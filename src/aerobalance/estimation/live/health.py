"""What the live force says of itself: final samples, its state of health, and what it takes the force for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv, gammaincinv

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.live.filter import strange_square
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.spectra.periodogram import Spectrum
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.estimation.step_search import find_steps
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.noise import white_noise

STRETCH: Final = 256
"""Samples after which the state of health is drawn up."""

TONES: Final = 16
"""Times over that the residuals are looked at at the natural frequency, each as long as a free oscillation rings."""

RINGING: Final = 8.0
"""How long it rings, over the time in which it decays to 1/e."""

CHANCE: Final = 1e-5
"""Probability with which chance passes a limit of that."""

WIDE_BAND: Final = 1.5
"""Band of the force that is taken while none is learned, over the natural frequency."""

WIDE_EXPONENT: Final = 16.0
"""Power of frequency with which it falls off beyond."""

WIDE_LEVEL: Final = 30.0
"""Standard deviation of that force at least, over the noise of a reading."""

SHORTEST: Final = 32
"""Least lag in samples, and fewest readings of a stretch that tell anything."""

Process = Literal["start-up", "learned", "fallback"]


@dataclass(frozen=True, slots=True)
class Health:
    """How far the live force can be trusted.

    Attributes
    ----------
    process
        What the force is taken for: ``"start-up"``, a wide band, as nothing is learned yet; ``"learned"``;
        ``"fallback"``, the wide band again, as the readings departed from what was learned.
    learned_from
        First sample and sample after the last of the readings that it was learned from; None if it was given or
        nothing was.
    samples, missing, saturated
        Readings since the stream began, how many of them were missing, and how many reached the limit of the channel.
    mean_square
        Mean square of the normalised residuals over the last `STRETCH` samples, 1 if the model is right.
    resonance
        The same for the part of the residuals at the natural frequency, over a longer time: outside the limits
        stiffness, mass or damping are not as they were identified.
    noise
        Standard uncertainty of a reading that is reckoned with [N].
    noise_now
        The one that the last residuals speak for [N].
    """

    process: Process
    learned_from: tuple[int, int] | None
    samples: int
    missing: int
    saturated: int
    mean_square: float
    resonance: float
    noise: float
    noise_now: float

    @property
    def learning_due(self) -> bool:
        """Whether the process should be learned (again)."""
        return self.process != "learned"

    @property
    def mean_square_limit(self) -> float:
        """What chance does not reach."""
        return strange_square(STRETCH) / STRETCH

    @property
    def resonance_limits(self) -> tuple[float, float]:
        """What chance does not go below and above."""
        return float(gammaincinv(TONES, CHANCE)) / TONES, float(gammainccinv(TONES, CHANCE)) / TONES

    @property
    def explained(self) -> bool:
        """Whether the readings are what balance and process lead one to expect."""
        return self.mean_square <= self.mean_square_limit

    @property
    def drifted(self) -> bool:
        """Whether the residuals ring too much or too little: the dynamics are not as they were identified."""
        low, high = self.resonance_limits
        return not low <= self.resonance <= high

    def doubts(self, component: str, *, uncertainty: float, still: bool = False) -> tuple[Doubt, ...]:
        """Return what the last readings say against the live force of a component.

        Parameters
        ----------
        component
            Which component.
        uncertainty
            Standard uncertainty of its force [N, N*m].
        still
            Whether its readings have not changed of late.
        """
        found, unit = [], si_unit(component)
        if still:
            text, advice = f"{component} repeats one reading", "look at the cable and the converter of the channel"
            found.append(Doubt("stuck channel", component, text, advice, None, unit))
        if self.drifted and self.process == "learned":
            # the error has at least the size that the residuals have too much
            effect = _beyond(self.resonance) * uncertainty if self.resonance > 1 else None
            size = "more" if self.resonance > 1 else "less"
            text = f"{component} rings {size} than its dynamics: stiffness, mass or damping are others"
            found.append(Doubt("natural frequency", component, text, "identify the dynamics again", effect, unit))
        elif not self.explained or self.process == "fallback":
            text = f"{component} departs from what its dynamics and what was learned of the load expect"
            found.append(Doubt("unexplained", component, text, "", _beyond(self.mean_square) * uncertainty, unit))
        return tuple(found)


def _beyond(square: float) -> float:
    """Rms of what is beyond residuals of size 1, where their mean square is this [1]."""
    return float(np.sqrt(max(square - 1.0, 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class LiveEstimate:
    """Samples of one component that have become final.

    Attributes
    ----------
    first, step
        Number of the first of them, counted from the first reading pushed, and readings from one to the next.
    interval
        Time between readings [s].
    force, uncertainty
        Applied force and its standard uncertainty, shape (m,) [N, N*m].
    load
        Balance load of the same samples, decimated as the force is, shape (m,) [N, N*m]; NaN where missing.
    """

    first: int
    step: int
    interval: float
    force: Array
    uncertainty: Array
    load: Array

    def __repr__(self) -> str:
        last = f"; the last {self.force[-1]:.6g} (u = {self.uncertainty[-1]:.2g})" if self.force.size else ""
        return f"{self.force.size} final samples from reading {self.first} on{last}"

    @property
    def time(self) -> Array:
        """Instants since the first reading pushed, shape (m,) [s]."""
        return np.asarray(self.first + self.step * np.arange(self.force.size), dtype=np.float64) * self.interval


@dataclass(frozen=True, slots=True, eq=False)
class Learning:
    """What was learned, and from which samples.

    Attributes
    ----------
    learned
        The process.
    steps
        Steps that were found on the way, their instants since the first reading pushed.
    first, stop
        First sample and sample after the last.
    component, generation
        Of which component, and of which of the streams that a `LiveForce` has begun.
    """

    learned: SpectralPrior
    steps: tuple[Step, ...]
    first: int
    stop: int
    component: str = ""
    generation: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """The last readings, to learn from in another thread or process.

    Attributes
    ----------
    reading
        Loads less the response to the ground's motion.
    first
        Number of the first of them.
    generation
        Which of the streams that a `LiveForce` has begun they are of.
    """

    reading: Observation
    first: int
    generation: int = 0

    def learn(self) -> Learning:
        """Find the process that these readings speak for, steps set aside.

        Raises
        ------
        FitError
            The readings cannot carry it.
        """
        steps, learned = find_steps(self.reading)
        begin = self.first * self.reading.interval
        moved = tuple(replace(step, instant=step.instant + begin) for step in steps)
        return Learning(
            learned,
            moved,
            self.first,
            self.first + self.reading.values.size,
            component=self.reading.dynamics.component,
            generation=self.generation,
        )


class Watch:
    """Keeps an eye on the residuals, stretch by stretch.

    Parameters
    ----------
    dynamics
        The balance.
    interval
        Time between samples [s].

    Attributes
    ----------
    mean_square
        Mean square of the normalised residuals over the last stretch.
    """

    def __init__(self, dynamics: ModalModel, *, interval: float) -> None:
        self._turn = dynamics.angular_frequency * interval
        self._long = RINGING / (dynamics.decay_rate * interval) if dynamics.decay_rate > 0 else np.inf
        self.mean_square = 1.0
        self._tones = [1.0] * TONES
        self._tone, self._count = 0j, 0

    @property
    def resonance(self) -> float:
        """Mean power of the residuals at the natural frequency, 1 if the model is right."""
        return float(np.mean(self._tones))

    def look(self, residual: Array, present: NDArray[np.bool_], *, stop: int) -> None:
        """Take the residuals of a stretch, 0 where a reading is missing, and the number of the sample after it."""
        count = int(np.count_nonzero(present))
        if count >= SHORTEST:
            self.mean_square = float(np.sum(residual**2)) / count
        turns = np.exp(-1j * self._turn * np.arange(stop - residual.size, stop))
        self._tone += complex(turns @ residual)
        self._count += count
        if self._count >= self._long:
            self._tones = [*self._tones[1:], abs(self._tone) ** 2 / self._count]
            self._tone, self._count = 0j, 0


def wide_process(reading: Observation, *, frequency: float) -> SpectralPrior:
    """A process that excludes no force in a band around a natural frequency [Hz], from a few readings."""
    present = reading.values[reading.present]
    # few readings may make the noise look smaller than it is
    judged = white_noise(present) * (1 + 4 / np.sqrt(present.size))
    noise = judged if reading.noise is None else reading.noise
    noise = max(noise, reading.least_noise)
    edge = min(WIDE_BAND * frequency, 0.4 / reading.interval)
    rms = max(2 * float(np.std(present)), WIDE_LEVEL * noise)
    level = rms**2 / (2 * edge)
    unit = _wide_shape()
    shaping = ShapingFilter(edge * unit.drift, edge * float(np.sqrt(level)) * unit.drive)
    return SpectralPrior(_wide_spectrum(edge, level), shaping, noise)


def _wide_spectrum(edge: float, level: float) -> Spectrum:
    return Spectrum(np.array([np.inf]), np.array([level]), (edge, WIDE_EXPONENT, 1.0))


@cache
def _wide_shape() -> ShapingFilter:
    """The process of a wide band to 1 Hz, of density 1: any other is this one on another clock."""
    spectrum = _wide_spectrum(1.0, 1.0)

    def density(frequency: Array) -> Array:
        # the faint floor keeps the logarithm of the density within bounds
        return np.asarray(spectrum.density(frequency) + 1e-12 / (1 + frequency**4))

    return ShapingFilter.of_spectrum(density, centre=1.0)
