"""Input of the force estimator for components that are not coupled: readings, dynamics, motion of the ground end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.independent import IndependentDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.clock import check_clock
from aerobalance.estimation.correlated_noise import SharedNoise
from aerobalance.estimation.error_sources import Contribution, Systematic
from aerobalance.estimation.record import (
    PARAMETERS_NAME,
    PROBE,
    BalanceRecord,
    ComponentRecord,
    Through,
    component_channels,
)
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.motion.platform import SystematicParameter
from aerobalance.motion.single_axis import GroundMotion, load_from_ground
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY, driving_channel
from aerobalance.recording.linalg import root_by_first
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import fractional_delay
from aerobalance.recording.sensors import corrected


@dataclass(frozen=True, slots=True, eq=False)
class SingleRecord(ComponentRecord):
    """Readings of one component that is not coupled with others, with the motion of the ground end along it.

    Attributes
    ----------
    dynamics
        Dynamics of the component.
    motion
        Motion of the ground end along the component.
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
        """Return the record of a recording as it was written, corrected for the filters of its channels."""
        return cls(corrected(recording), dynamics, motion, noise=noise)

    @property
    def input_noise(self) -> float:
        """Standard deviation of the white noise of the ground's motion, as a force on the moving mass [N]."""
        return self.dynamics.mass * self.motion.noise

    @property
    def motion_source(self) -> str:
        """Channels that the noise of the ground's motion comes from."""
        given = (driving_channel("ground", self.dynamics.component, self.recording), "pitch")
        names = [name for name in given if name in self.recording]
        return " and ".join(names) or "ground_acceleration"

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Quantities that are taken as zero because the recording does not contain them, in words."""
        return self.motion.assumptions

    @property
    def from_ground(self) -> Array:
        """Balance load due to the ground's motion alone, at the instants of the load's channel, shape (n,) [N]."""
        delay = self.recording.channel(self.dynamics.component).delay
        return load_from_ground(self.motion, self.dynamics, rate=self.recording.rate, load_delay=delay)

    @property
    def before_ground(self) -> NDArray[np.bool_]:
        """Where the load was read before or after the sensors of a ground that moves, for its delay, shape (n,)."""
        return self.motion.unread_at(self._load_delay, interval=self.interval)

    @property
    def motion_force(self) -> Array:
        """Force of the ground's motion on the moving mass at the load's sampling instants, shape (n,) [N]."""
        force = self.motion.force(self.dynamics.mass) + self.motion_error
        lag = self._load_delay - self.motion.delay
        if not lag or not force.any():
            return force
        return fractional_delay(force, delay=lag, interval=self.interval)

    @property
    def _load_delay(self) -> float:
        """Time by which the load lags the clock, that of the balance included [s]."""
        return self.dynamics.delay + self.recording.channel(self.dynamics.component).delay

    @property
    def rows(self) -> NDArray[np.intp]:
        """Indices of the parameters that act on the reading: all of its dynamics."""
        return np.arange(len(self.dynamics.parameters))

    def reading_of(self, felt: Array) -> Array:
        """The balance load along the component, shape (samples,) [N]."""
        return np.asarray(felt[:, self.place])

    @property
    def hides_motion(self) -> NDArray[np.bool_]:
        """False everywhere: ground motion in a gap is estimated from the load, shape (n,)."""
        return np.zeros(self.recording.samples, dtype=bool)

    @property
    def motion_across(self) -> tuple[Array, str] | None:
        """Error per unit of cross-axis sensitivity, shape (n,) [m/s^2], and the name of the accelerometer's channel.

        The motion across the axis is taken as large as that along it. None where there is no accelerometer, where its
        cross-axis sensitivity is stated, or where nothing moves.
        """
        name = driving_channel("ground", self.dynamics.component, self.recording)
        channel = self.recording.channel(name) if name in self.recording else None
        if channel is None or channel.cross_axis or not np.ptp(self.motion.specific_force) > 0:
            return None
        values = np.where(np.isfinite(channel.values), channel.values, np.nanmean(channel.values))
        return values - values.mean(), channel.name

    def with_motion(self, change: Array) -> SingleRecord:
        """The record with `change` added to the specific force of the ground, shape (n,) [m/s^2]."""
        motion = replace(self.motion, specific_force=self.motion.specific_force + change)
        return replace(self, motion=motion)

    def with_dynamics(self, other: Dynamics) -> SingleRecord:
        """The record with other dynamics; the weight that the zero of its readings contains changes with the mass."""
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
        """Return the error of the force from errors of the parameters [N], by finite differences of the estimator.

        The derivatives of Eq. (17) of [Gorbushin2020]_ itself would be too large at frequencies where the smoother's
        prior has no force, and too small where an error of the natural frequency leads to an error of a step.
        """
        d = self.dynamics
        slopes = np.zeros((self.recording.samples, len(d.parameters)))
        deviations = np.sqrt(np.diag(d.covariance))
        unchanged = values() if (deviations > 0).any() else np.zeros(0)
        for place, deviation in enumerate(deviations):
            if deviation > 0:
                changed = d.values
                changed[place] += PROBE * deviation
                moved = again(self.with_dynamics(d.with_parameters(changed)))
                slopes[:, place] = (moved - unchanged) / (PROBE * deviation)
        # the mass first: components that carry one weighed mass share its error
        root = root_by_first(d.covariance)
        return Systematic(PARAMETERS_NAME, "dynamics", d.parameters, slopes, d.covariance, root)

    def felt_under(self, item: SystematicParameter) -> Array:
        """Balance load per unit of an uncertain parameter of the ground's motion, shape (n,)."""
        unit = replace(self.motion, specific_force=item.slope)
        delay = self.recording.channel(self.dynamics.component).delay
        return load_from_ground(unit, self.dynamics, rate=self.recording.rate, load_delay=delay)

    def as_force(self, item: SystematicParameter) -> Array:
        """Error of the force by the direct inverse per unit of an uncertain parameter of the motion, shape (n,)."""
        return self.dynamics.mass * item.slope

    @property
    def unknowns(self) -> tuple[SystematicParameter, ...]:
        """Systematic parameters of the ground's motion that are not known exactly."""
        return self.motion.unknowns

    def reading_errors(self, values: Array, through: Through) -> list[Contribution]:
        """Errors of the force from gain and zero of the load's channel [N].

        A gain error is proportional to the net force: the applied one and that of the ground's motion.
        """
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
    """Return whether the ground's motion is described along the component's own axis only.

    Then motion that a gap hides can be estimated from the load.
    """
    return isinstance(record, SingleRecord)


@dataclass(frozen=True, slots=True, eq=False)
class IndependentRecord(BalanceRecord):
    """A recording of components that are not coupled, with their dynamics and the motion of the ground end.

    Attributes
    ----------
    recording
        The recording.
    dynamics
        Dynamics of the components that the recording contains.
    motions
        Motion of the ground end along each of these components.
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
        """Return the record of those components with dynamics that a recording contains, as it was written.

        Raises
        ------
        FitError
            A component has too few readings, or the record is shorter than its period, or its times are in
            another unit than they say.
        """
        recording = corrected(recording)
        known = IndependentDynamics({name: part for name, part in dynamics.items() if name in recording})
        component_channels(recording, known)
        for name, part in known.items():
            check_clock(recording, name, channels=(name,), modes=[(part.natural_frequency, part.damping_ratio)])
        settings = {"gravity": gravity, "gravity_uncertainty": gravity_uncertainty}
        return cls(recording, known, {name: GroundMotion.of(recording, name, **settings) for name in known})

    @property
    def from_ground(self) -> Array:
        """Balance loads due to gravity and the ground's motion alone, on the common clock, shape (samples, n) [N]."""
        parts = [(self.motions[name], part) for name, part in self.dynamics.items()]
        return np.column_stack([load_from_ground(*one, rate=self.recording.rate) for one in parts])

    @property
    def motion_covariance(self) -> Array:
        """Covariance of the white noise of the ground's motion, as a load, shape (n, n) [N^2]."""
        return np.diag([(part.mass * self.motions[name].noise) ** 2 for name, part in self.dynamics.items()])

    @property
    def decoupled(self) -> tuple[DecoupledChannel, ...]:
        """Decoupled channels: each component by its own reading."""
        none = np.zeros((len(self.dynamics), len(self.dynamics)))
        return tuple(self.dynamics.decoupled(name, noise=none) for name in self.dynamics)

    def is_uncertain(self, component: str) -> bool:
        """Whether the dynamics of a component are not known exactly."""
        return bool(self.dynamics[component].covariance.any())

    def filled_by(self, forces: Mapping[str, Array], *, filled: Array) -> Array:
        """Return `filled` unchanged: no force needs the readings of another component in a gap."""
        return filled

    def taken_with(self, dynamics: IndependentDynamics, *, noise: Array | None = None) -> IndependentRecord:
        """The record with other dynamics; those of components that are no longer needed may be left out.

        `noise` has no effect, as no force depends on the noise of other components.
        """
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
        """The record of one component. Its gaps stay: `filled` is of use for coupled components only."""
        return SingleRecord(
            self.recording,
            self.dynamics[component],
            self.motions[component],
            noise=noise,
            shared=shared,
            place=self.dynamics.components.index(component),
        )
