"""How live forces are worked out, and how each of their decoupled channels is smoothed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.estimation.live.health import SHORTEST
from aerobalance.estimation.live.motion_test import MotionTestSettings
from aerobalance.estimation.observation import SpectralPrior

LAG_PERIODS: Final = 5.0
"""Periods of the natural frequency that the force lags the readings, unless said otherwise."""

SLOWEST: Final = 0.5
"""Natural frequency of a decoupled channel that its lag is taken from at least, over that of the slowest mode."""

FEWEST_TO_LEARN: Final = 64
"""Readings that are learned from at least."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SmootherSettings:
    """How one decoupled channel is smoothed.

    Attributes
    ----------
    interval
        Time between samples [s].
    lag
        Samples after a sample that its force is made from.
    settling
        Readings after which their noise is known well enough to tell what is strange, and the strength of the wide
        band is judged anew.
    learned
        Spectral prior of the force and noise of a reading, the noise white; None to begin with a wide band.
    input_noise
        Density of the noise that the motion taken off has brought into the force, white [N^2/Hz, two-sided].
    free_after_gap
        Whether a free oscillation that nothing explains may have begun wherever readings are missing.
    highest
        Natural frequency up to which, and somewhat beyond, the force is taken to reach while nothing is learned [Hz].
    learn_inside
        Whether the prior is learned within `ComponentSmoother.push`; else `ComponentSmoother.due` says when.
    first_learning, last_learning
        Readings after which it is learned first, and again when there are twice as many, until there are so many.
    learned_from
        Readings that it is learned from at most.
    """

    interval: float
    lag: int
    settling: int
    learned: SpectralPrior | None = None
    input_noise: float = 0.0
    free_after_gap: bool = False
    highest: float
    learn_inside: bool = True
    first_learning: int
    last_learning: int
    learned_from: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveSettings:
    """How live forces are worked out.

    Attributes
    ----------
    lag
        Time after which the force at a sample is final, decimation and alignment apart [s]; None for `lag_periods`.
    lag_periods
        Periods of the slowest natural frequency that make the lag [1].
    samples_a_period
        Samples in a period of the highest natural frequency that the force is worked out from at least: from faster
        readings as many are made one as that allows [1]. ``inf`` to keep them all.
    learn_inside
        Whether the spectral prior is learned within `LiveForce.push`, which then takes up to seconds; else
        `LiveForce.due` says when it is time to.
    first_learning, last_learning
        Time after a start at which it is learned; again at twice, four times ... that time, until the latter [s].
    learned_from
        Samples, after decimation, that it is learned from at most.
    motion
        When the non-metric end is taken to move.
    """

    lag: float | None = None
    lag_periods: float = LAG_PERIODS
    samples_a_period: float = 16.0
    learn_inside: bool = True
    first_learning: float = 2.0
    last_learning: float = 10.0
    learned_from: int = 12_000
    motion: MotionTestSettings = field(default_factory=MotionTestSettings)

    def time_behind(self, natural_frequency: float, *, slowest_mode: float) -> float:
        """Return the time that the force of a decoupled channel lags its readings [s].

        Parameters
        ----------
        natural_frequency
            That of the channel [Hz].
        slowest_mode
            Lowest natural frequency of all its modes; 0 where there are none [Hz].
        """
        if self.lag is not None:
            return self.lag
        return self.lag_periods / max(natural_frequency, SLOWEST * slowest_mode)

    def of_channel(
        self,
        channel: DecoupledChannel,
        *,
        interval: float,
        ahead: int,
        modes: Sequence[float],
        learned: SpectralPrior | None,
        input_noise: float,
    ) -> SmootherSettings:
        """Return how a decoupled channel is smoothed.

        Parameters
        ----------
        channel
            The channel.
        interval
            Time between samples [s].
        ahead
            Samples that the channel itself lags the readings.
        modes
            Natural frequencies of the balance [Hz].
        learned
            Spectral prior of the channel's force; None to begin with a wide band.
        input_noise
            Density of the noise that the motion taken off has brought into the force [N^2/Hz, two-sided].
        """
        frequency = channel.dynamics.natural_frequency
        behind = self.time_behind(frequency, slowest_mode=min(modes, default=0.0))
        lag = round(behind / interval) - ahead
        return SmootherSettings(
            interval=interval,
            lag=max(lag, SHORTEST) if self.lag is None and not channel.alone else lag,
            settling=2 * (lag if not channel.alone else lag + ahead),
            learned=learned,
            input_noise=input_noise,
            free_after_gap=not channel.alone,
            highest=max(modes, default=frequency),
            learn_inside=self.learn_inside,
            first_learning=max(round(self.first_learning / interval), FEWEST_TO_LEARN),
            last_learning=round(self.last_learning / interval),
            learned_from=self.learned_from,
        )
