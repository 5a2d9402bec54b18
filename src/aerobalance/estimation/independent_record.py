"""A recording of components that are not coupled, made ready for the estimator of one component."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.independent import IndependentDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.correlated_noise import SharedNoise
from aerobalance.estimation.error_sources import Contribution, Systematic
from aerobalance.estimation.record import (
    PARAMETERS_NAME,
    PROBE,
    BalanceRecord,
    ComponentRecord,
    Through,
    check_length,
    component_channels,
)
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.motion.platform import SystematicParameter
from aerobalance.motion.single_axis import GroundMotion, load_from_ground
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY, acceleration_name
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import fractional_delay
from aerobalance.recording.sensors import corrected


@dataclass(frozen=True, slots=True, eq=False)
class SingleRecord(ComponentRecord):
    """One component that is not coupled with others, with the ground's motion along it.

    Attributes
    ----------
    dynamics
        The balance.
    motion
        The ground's motion.
    place
        Row of the component among those of its record.
    """

    dynamics: Dynamics
    motion: GroundMotion
    place: int = field(default=0, kw_only=True)

    @classmethod
    def of(
        cls, recording: Recording, dynamics: Dynamics, motion: GroundMotion, *, noise: NoiseSpectrum | None = None
    ) -> SingleRecord:
        """Return the record of a recording as it was written: what its channels' filters have done is undone first."""
        return cls(corrected(recording), dynamics, motion, noise=noise)

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

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What had to be taken as zero because the recording does not have it."""
        return self.motion.assumptions

    @property
    def from_ground(self) -> Array:
        """Load that the ground's motion alone makes the balance feel, shape (n,) [N]."""
        delay = self.recording.channel(self.dynamics.component).delay
        return load_from_ground(self.motion, self.dynamics, rate=self.recording.rate, load_delay=delay)

    @property
    def motion_force(self) -> Array:
        """Force of the ground's motion on the moving mass at the load's sampling instants, shape (n,) [N]."""
        known = self.motion.force(self.dynamics.mass) + self.motion_error
        lag = self.dynamics.delay + self.recording.channel(self.dynamics.component).delay - self.motion.delay
        if not lag or not known.any():
            return known
        return fractional_delay(known, delay=lag, interval=self.interval)

    @property
    def rows(self) -> NDArray[np.intp]:
        """All parameters of its dynamics."""
        return np.arange(len(self.dynamics.parameters))

    def reading_of(self, felt: Array) -> Array:
        """The load felt along the component, shape (samples,) [N]."""
        return np.asarray(felt[:, self.place])

    @property
    def hides_motion(self) -> NDArray[np.bool_]:
        """Nowhere: what a gap hides is found by the load."""
        return np.zeros(self.recording.samples, dtype=bool)

    @property
    def motion_across(self) -> tuple[Array, str] | None:
        """What the accelerometer would read of a motion across its axis, if as much moves there as along it."""
        names = (acceleration_name("ground", self.dynamics.component), "ground_acceleration")
        channel = next((self.recording.channel(name) for name in names if name in self.recording), None)
        if channel is None or channel.cross_axis or not np.ptp(self.motion.specific_force) > 0:
            return None
        values = np.where(np.isfinite(channel.values), channel.values, np.nanmean(channel.values))
        return values - values.mean(), channel.name

    def with_motion(self, change: Array) -> SingleRecord:
        """The same record with so much added to the specific force of the ground, shape (n,) [m/s^2]."""
        motion = replace(self.motion, specific_force=self.motion.specific_force + change)
        return replace(self, motion=motion)

    def with_dynamics(self, other: Dynamics) -> SingleRecord:
        """The same record with other dynamics, whose mass has another weight in the zero that the load counts from."""
        shift = (other.mass - self.dynamics.mass) * self.motion.gravity_on_zero
        channel = self.recording.channel(self.dynamics.component)
        moved = replace(channel, values=channel.values + shift)
        recording = replace(self.recording, channels={**self.recording.channels, channel.name: moved})
        return replace(self, recording=recording, dynamics=other)

    def parameter_errors(
        self,
        values: Callable[[], Array],
        again: Callable[[ComponentRecord], Array],
        through: Through,
        *,
        few: bool = False,
    ) -> Systematic:
        """Return the error of the force from errors of the parameters [N]: each is changed, and the method run again.

        The slopes of Eq. (17) of [Gorbushin2020]_ would say too much where the smoother's prior has no force at a
        frequency, and too little where a wrong frequency makes a wrong step.
        """
        d = self.dynamics
        slopes = np.zeros((self.recording.samples, len(d.parameters)))
        deviations = np.sqrt(np.diag(d.covariance))
        known = values() if (deviations > 0).any() else np.zeros(0)
        for place, deviation in enumerate(deviations):
            if deviation > 0:
                changed = d.values
                changed[place] += PROBE * deviation
                moved = again(self.with_dynamics(d.with_parameters(changed)))
                slopes[:, place] = (moved - known) / (PROBE * deviation)
        return Systematic(PARAMETERS_NAME, "dynamics", d.parameters, slopes, d.covariance)

    def felt_under(self, item: SystematicParameter) -> Array:
        """Load felt under a unit of an unknown of the ground's motion, shape (n,)."""
        unit, delay = replace(self.motion, specific_force=item.slope), self.recording.channel(self.dynamics.component)
        return load_from_ground(unit, self.dynamics, rate=self.recording.rate, load_delay=delay.delay)

    def as_force(self, item: SystematicParameter) -> Array:
        """Force that a unit of an unknown of the ground's motion is taken for by a direct inverse, shape (n,)."""
        return self.dynamics.mass * item.slope

    @property
    def unknowns(self) -> tuple[SystematicParameter, ...]:
        """What holds along the ground's motion and is not known exactly."""
        return self.motion.unknowns

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


def moves_along_axis(record: ComponentRecord) -> TypeGuard[SingleRecord]:
    """Return whether the ground's motion is that along the component's own axis: its load tells it then."""
    return isinstance(record, SingleRecord)


@dataclass(frozen=True, slots=True, eq=False)
class IndependentRecord(BalanceRecord):
    """A recording of components that are not coupled.

    Attributes
    ----------
    recording
        The recording.
    dynamics
        Dynamics of the components that are in it.
    motions
        What the ground end does along each of them.
    """

    recording: Recording
    dynamics: IndependentDynamics
    motions: Mapping[str, GroundMotion]

    @classmethod
    def of(
        cls,
        recording: Recording,
        dynamics: IndependentDynamics,
        *,
        gravity: float = STANDARD_GRAVITY,
        gravity_uncertainty: float = 0.0,
    ) -> IndependentRecord:
        """Take those of the components that are in a recording as it was written.

        Raises
        ------
        FitError
            A component has too few readings, or the record is shorter than its period.
        """
        recording = corrected(recording)
        known = IndependentDynamics({name: part for name, part in dynamics.items() if name in recording})
        component_channels(recording, known)
        for name, part in known.items():
            check_length(recording, name, frequency=part.natural_frequency)
        settings = {"gravity": gravity, "gravity_uncertainty": gravity_uncertainty}
        return cls(recording, known, {name: GroundMotion.of(recording, name, **settings) for name in known})

    @property
    def from_ground(self) -> Array:
        """Loads felt under gravity and the ground's motion alone, on the clock, shape (samples, n) [N]."""
        parts = [(self.motions[name], part) for name, part in self.dynamics.items()]
        return np.column_stack([load_from_ground(*one, rate=self.recording.rate) for one in parts])

    @property
    def motion_covariance(self) -> Array:
        """Covariance of the white noise of the ground's motion as a load per sample, shape (n, n)."""
        return np.diag([(part.mass * self.motions[name].noise) ** 2 for name, part in self.dynamics.items()])

    @property
    def decoupled(self) -> tuple[DecoupledChannel, ...]:
        """Each component by its own reading."""
        none = np.zeros((len(self.dynamics), len(self.dynamics)))
        return tuple(self.dynamics.decoupled(name, noise=none) for name in self.dynamics)

    def is_uncertain(self, component: str) -> bool:
        """Whether the dynamics of a component are not known exactly."""
        return bool(self.dynamics[component].covariance.any())

    def filled_by(self, forces: Mapping[str, Array], *, filled: Array) -> Array:
        """The readings as they are filled: nothing is filled, as no force needs it."""
        return filled

    def taken_with(self, dynamics: IndependentDynamics, *, noise: Array | None = None) -> IndependentRecord:
        """The same record with other dynamics of some of its components; no force depends on the noise of others."""
        channels = dict(self.recording.channels)
        for name, part in dynamics.items():
            channels[name] = self.component_record(name).with_dynamics(part).recording.channel(name)
        return replace(self, recording=replace(self.recording, channels=channels), dynamics=dynamics)

    def component_record(
        self,
        component: str,
        filled: Array | None = None,
        *,
        noise: NoiseSpectrum | None = None,
        shared: SharedNoise | None = None,
    ) -> SingleRecord:
        """One component made ready, its gaps left as they are."""
        return SingleRecord(
            self.recording,
            self.dynamics[component],
            self.motions[component],
            noise=noise,
            shared=shared,
            place=self.dynamics.components.index(component),
        )
