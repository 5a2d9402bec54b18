"""One component's record as the estimator takes it, and the process that its force is taken for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.spectra.noise_spectrum import ColoredNoise, ShapedNoise
from aerobalance.estimation.spectra.periodogram import Spectrum
from aerobalance.estimation.statespace.kalman import StateSpace
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True, eq=False)
class SpectralPrior:
    """The process that the force is taken for, and the noise, that go with a record.

    Attributes
    ----------
    spectrum
        Spectrum of the force.
    shaping
        Shaping filter of that spectrum.
    noise
        Standard deviation of the white noise of a reading [N].
    color
        What the noise has beyond that; None if nothing.
    rising
        Whether the force may be stronger where the balance weakens it than elsewhere.
    even
        Whether the ends of the record were weighed as its middle.
    """

    spectrum: Spectrum
    shaping: ShapingFilter
    noise: float
    color: ColoredNoise | ShapedNoise | None = None
    rising: bool = False
    even: bool = False

    def noise_density(self, frequency: Array, *, interval: float) -> Array:
        """Two-sided density of the noise of a reading, its mean about evenly spaced frequencies [Hz], [N^2/Hz]."""
        white = np.full(frequency.shape, self.noise**2 * interval)
        if self.color is None:
            return white
        return white + self.color.density(frequency, width=float(frequency[1] - frequency[0]))


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One component's record as the estimator takes it.

    Attributes
    ----------
    values
        Balance load less the response to known inputs, shape (n,) [N]; NaN where missing.
    interval
        Time between samples [s].
    dynamics
        The balance.
    input_density
        Density of the white force noise that comes with the known inputs [N^2/Hz].
    noise
        Standard deviation of the white noise of a reading [N]; None when it is to be learned.
    hum
        Frequencies of steady lines that are no force [Hz].
    tones
        Frequencies of steady lines of the force [Hz].
    drift
        How these drift along the record, all alike (`aerobalance.estimation.spectra.lines.turned_time`).
    color
        What the noise has beyond that; None if nothing is known of it.
    rising
        Whether the force was seen to be stronger where the balance weakens it than elsewhere.
    decimated
        Samples of a faster clock that each reading was made of; 1 where none were.
    even
        Whether what is learned weighs the ends of the record as its middle (`evenly_weighted`).
    """

    values: Array
    interval: float
    dynamics: ModalModel
    input_density: float = 0.0
    noise: float | None = None
    hum: tuple[float, ...] = ()
    tones: tuple[float, ...] = ()
    drift: tuple[float, ...] = ()
    color: ColoredNoise | ShapedNoise | None = None
    rising: bool = False
    decimated: int = 1
    even: bool = False

    @property
    def present(self) -> NDArray[np.bool_]:
        """True where there is a reading, shape (n,)."""
        return np.isfinite(self.values)

    @property
    def filled(self) -> Array:
        """The readings with zero where one is missing, shape (n,) [N]."""
        return np.where(self.present, self.values, 0.0)

    @property
    def swing(self) -> float:
        """Largest departure from the mean [N]: no free oscillation under way at the start is larger."""
        return float(np.nanmax(np.abs(self.values - np.nanmean(self.values)))) + self.least_noise

    @property
    def least_noise(self) -> float:
        """Noise below which double precision cannot tell a reading from its prediction [N]."""
        return 1e-7 * float(np.nanmax(np.abs(self.values))) + 1e-60

    def system(self, learned: SpectralPrior) -> StateSpace:
        """The state space of this reading with what was learned."""
        return StateSpace.of_balance(
            self.dynamics,
            learned.shaping,
            interval=self.interval,
            noise=learned.noise,
            input_density=self.input_density,
            swing=self.swing,
            colors=() if learned.color is None else learned.color.shapings,
        )
