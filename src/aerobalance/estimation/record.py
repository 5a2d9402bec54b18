"""What a force is worked out from, and what comes out: every sample with its uncertainty and where that is from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.correlated_noise import SharedNoise
from aerobalance.estimation.error_sources import Contribution, Noise, Systematic, total_deviation
from aerobalance.estimation.prior import Learned, Reading
from aerobalance.estimation.spectra.line_noise import Line
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.estimation.steps import Step
from aerobalance.motion.single_axis import GroundMotion, Unknown, load_from_ground
from aerobalance.recording.channel import Array
from aerobalance.recording.components import acceleration_name
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected

FEWEST_SAMPLES: Final = 32
"""Fewest readings of a component that a force is worked out for."""

PARAMETERS_NAME: Final = "mass, stiffness, damping, delay"
"""Name of what the dynamics contribute to the uncertainty."""

PROBE: Final = 0.1
"""Change of a parameter, in standard uncertainties, over which the estimator's slope is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceEstimate:
    """The force applied along one component, and how it was found.

    Attributes
    ----------
    component
        Which component.
    values
        Applied force, shape (n,) [N].
    uncertainty
        Standard uncertainty of every sample, shape (n,) [N].
    method
        Words for the method and its settings.
    noise
        Standard uncertainty of a reading of the load [N].
    bandwidth
        Frequency up to which the force is resolved [Hz].
    noise_gain
        Noise of the force over noise of the reading [1].
    steps
        Sudden changes of the force that were found.
    hum
        Steady lines of the reading that were taken for hum and not for force.
    assumptions
        What was taken as zero because the recording does not have it.
    budget
        Root mean square of each contribution to the uncertainty [N].
    contributions
        The contributions themselves.
    learned
        Prior of the force and noise that the smoother took; None for the other methods.
    shared
        Noise that other components show and that was taken off the readings; None where none was.
    """

    component: str
    values: Array
    uncertainty: Array
    method: str
    noise: float
    bandwidth: float
    noise_gain: float
    steps: tuple[Step, ...] = ()
    hum: tuple[Line, ...] = ()
    assumptions: tuple[str, ...] = ()
    budget: dict[str, float] = field(default_factory=dict)
    contributions: tuple[Contribution, ...] = ()
    learned: Learned | None = None
    shared: SharedNoise | None = None


def with_balance(
    estimate: ForceEstimate, static: Array, *, curvature: tuple[float, Array] = (0.0, np.ones(1))
) -> ForceEstimate:
    """Add the uncertainty of the balance matrix, its zeros and tares to an estimate.

    The error of a matrix is a function of the load: to first order a gain and an offset. Both go through Eq. (17) of
    [Gorbushin2020]_ unchanged, as it is linear, so the error of the force is that of a static load of its size. What
    is curved in it comes on top where the load changes (`aerobalance.balance.calibration_nonlinearity`).

    Parameters
    ----------
    estimate
        The force from loads that were taken as exact but for their noise.
    static
        Standard uncertainty of a static load of the force's size, shape (n,) [N]; NaN counts as the largest.
    curvature
        Standard uncertainty from the matrix's curvature under loads that change [N], and the spectrum of that error
        as `aerobalance.estimation.error_sources.Noise` takes it.
    """
    known = np.isfinite(static)
    filled = np.where(known, static, np.max(static[known], initial=0.0))
    parts: list[Contribution] = [_gain_and_offset(estimate.values, filled)]
    deviation, spectrum = curvature
    if deviation > 0:
        level = np.full(filled.size, deviation)
        parts.append(Noise("curvature of the balance matrix, ringing", "balance", level, spectrum))
    return replace(
        estimate,
        uncertainty=np.sqrt(estimate.uncertainty**2 + filled**2 + deviation**2),
        budget={
            **estimate.budget,
            parts[0].name: float(np.sqrt(np.mean(filled**2))),
            **{part.name: deviation for part in parts[1:]},
        },
        contributions=(*estimate.contributions, *parts),
    )


def _gain_and_offset(values: Array, static: Array) -> Systematic:
    """The error of a matrix as a gain and an offset: its variance is then a parabola over the force."""
    size = float(np.max(np.abs(values), initial=0.0)) or 1.0
    share = values / size
    terms = np.column_stack([np.ones(share.size), 2 * share, share**2])
    offset, both, gain = np.linalg.lstsq(terms, static**2, rcond=1e-9)[0]
    level, vectors = np.linalg.eigh([[offset, both], [both, gain]])
    covariance = (vectors * np.maximum(level, 0.0)) @ vectors.T
    slopes = np.column_stack([np.ones(share.size), share])
    found = float(np.mean(np.sum((slopes @ covariance) * slopes, axis=1)))
    covariance *= float(np.mean(static**2)) / found if found > 0 else 0.0
    names = ("offset", f"gain, at {size:.4g}")
    return Systematic("balance matrix, zeros and tares", "balance", names, slopes, covariance)


Through = Callable[[Array], Array]
"""What a method makes of readings, shape (n, c), when it takes them as it took the record's: forces, (n, c)."""


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """One component of a recording with the balance and the ground's motion that go with it.

    Attributes
    ----------
    recording, dynamics, motion
        The recording, the balance and the ground's motion.
    noise
        Spectrum of the noise of the readings, where it is known.
    shared
        Noise that other components show and that has been taken off the readings; None where none was.
    """

    recording: Recording
    dynamics: Dynamics
    motion: GroundMotion
    noise: NoiseSpectrum | None = field(default=None, kw_only=True)
    shared: SharedNoise | None = field(default=None, kw_only=True)

    @classmethod
    def of(
        cls, recording: Recording, dynamics: Dynamics, motion: GroundMotion, *, noise: NoiseSpectrum | None = None
    ) -> Job:
        """Take a recording as it was written: what its channels' filters have done is undone first."""
        return cls(corrected(recording), dynamics, motion, noise=noise)

    @property
    def load(self) -> Array:
        """Readings of the load, shape (n,) [N]."""
        return self.recording.channel(self.dynamics.component).values

    @property
    def interval(self) -> float:
        """Time between samples [s]."""
        return 1 / self.recording.rate

    @property
    def input_noise(self) -> float:
        """White noise of the ground's motion as a force per sample [N]."""
        return self.dynamics.mass * self.motion.noise

    @property
    def motion_source(self) -> str:
        """Channels that the noise of the ground's motion comes from."""
        given = (acceleration_name("ground", self.dynamics.component), "pitch")
        names = [name for name in given if name in self.recording]
        return " and ".join(names) or "ground_acceleration"

    def reading(self, *, hum: tuple[float, ...] = ()) -> Reading:
        """The record as the estimator takes it: the load that the ground's motion has put on it is taken off.

        Hum is named by its frequencies [Hz] and left in; readings that rest on a limit count as missing.
        """
        channel, d = self.recording.channel(self.dynamics.component), self.dynamics
        from_ground = load_from_ground(self.motion, d, rate=self.recording.rate, load_delay=channel.delay)
        reading = Reading(
            values=np.where(channel.at_limit, np.nan, channel.values - from_ground),
            interval=self.interval,
            dynamics=d,
            input_density=self.input_noise**2 * self.interval,
            noise=channel.noise,
            hum=hum,
        )
        if self.noise is not None:
            color = self.noise.states(channel.values.size * self.interval)
            return replace(reading, noise=self.noise.deviation, color=color)
        if self.shared is not None:
            return replace(reading, noise=self.shared.white, color=self.shared.color)
        return reading

    def with_dynamics(self, other: Dynamics) -> Job:
        """The same record with other dynamics, whose mass has another weight in the zero that the load counts from."""
        shift = (other.mass - self.dynamics.mass) * self.motion.pull_on_zero
        channel = self.recording.channel(self.dynamics.component)
        moved = replace(channel, values=channel.values + shift)
        recording = replace(self.recording, channels={**self.recording.channels, channel.name: moved})
        return replace(self, recording=recording, dynamics=other)

    def parameter_errors(self, values: Array, again: Callable[[Job], Array], through: Through) -> Systematic:
        """What the parameters of the dynamics do to the force: the method is run again with each of them changed.

        The slopes of Eq. (17) of [Gorbushin2020]_ would say too much where the smoother's prior has no force at a
        frequency, and too little where a wrong frequency makes a wrong step.
        """
        d = self.dynamics
        slopes = np.zeros((values.size, len(d.parameters)))
        for place, deviation in enumerate(np.sqrt(np.diag(d.covariance))):
            if deviation > 0:
                changed = d.values
                changed[place] += PROBE * deviation
                moved = again(self.with_dynamics(d.with_parameters(changed)))
                slopes[:, place] = (moved - values) / (PROBE * deviation)
        return Systematic(PARAMETERS_NAME, "dynamics", d.parameters, slopes, d.covariance)

    def felt_under(self, item: Unknown) -> Array:
        """Load felt under a unit of an unknown of the ground's motion, shape (n,)."""
        unit, delay = replace(self.motion, specific_force=item.slope), self.recording.channel(self.dynamics.component)
        return load_from_ground(unit, self.dynamics, rate=self.recording.rate, load_delay=delay.delay)

    def as_force(self, item: Unknown) -> Array:
        """Force that a unit of an unknown of the ground's motion is taken for by a direct inverse, shape (n,)."""
        return self.dynamics.mass * item.slope

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """What holds along the ground's motion and is not known exactly."""
        return self.motion.unknowns

    def motion_errors(self, slope: Callable[[Unknown], Array]) -> list[Contribution]:
        """What holds along the ground's motion and is not known, by what a unit of it does to the force, (n,)."""
        return [
            Systematic(item.name, item.source, (item.name,), slope(item)[:, None], np.array([[item.uncertainty**2]]))
            for item in self.unknowns
        ]

    def reading_errors(self, values: Array, through: Through) -> list[Contribution]:
        """Gain and zero of the load's channel: a gain acts on all that the readings say of the net force."""
        channel = self.recording.channel(self.dynamics.component)
        net = values + self.motion.force(self.dynamics.mass)
        unknown = (
            ("gain of the readings", net, channel.relative_uncertainty),
            ("zero of the readings", np.ones(values.size), channel.zero_uncertainty),
        )
        return [
            Systematic(name, channel.name, (name,), slope[:, None], np.array([[u**2]]))
            for name, slope, u in unknown
            if u > 0
        ]

    def finish(self, values: Array, contributions: list[Contribution], **facts: object) -> ForceEstimate:
        """Put the answer together; a contribution that is nothing is left out, but for those that are always there."""
        parts = tuple(part for part in contributions if part.deviation.any() or part.source == "dynamics")
        return ForceEstimate(
            component=self.dynamics.component,
            values=values,
            uncertainty=total_deviation(parts),
            assumptions=self.motion.assumptions,
            budget={part.name: float(np.sqrt(np.mean(part.deviation**2))) for part in parts},
            contributions=parts,
            **facts,  # type: ignore[arg-type]
        )
