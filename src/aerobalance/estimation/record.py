"""What a force is worked out from: the record of each component with its dynamics and the motion of the ground."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.independent import IndependentDynamics
from aerobalance.dynamics.modal import ModalModel
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.correlated_noise import SharedNoise
from aerobalance.estimation.error_sources import Contribution, Systematic
from aerobalance.estimation.prior import Observation
from aerobalance.estimation.result import ComponentForce
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.motion.gaps import GAP
from aerobalance.motion.platform import SystematicParameter
from aerobalance.motion.single_axis import GroundMotion, load_from_ground
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY, acceleration_name
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import fractional_delay
from aerobalance.recording.sensors import corrected

FEWEST_SAMPLES: Final = 32
"""Fewest readings of a component that a force is worked out for."""


def check_length(recording: Recording, component: str, *, frequency: float) -> None:
    """Refuse a record that is shorter than one period of the balance.

    Parameters
    ----------
    recording
        The record, or a part of it.
    component
        Which component, in words.
    frequency
        Its natural frequency [Hz].

    Raises
    ------
    FitError
        It is, by a wrong clock or wrong dynamics.
    """
    whole = recording.whole_duration
    if whole * frequency < 1:
        raise FitError(
            f"{recording.name}: the record takes {whole:.3g} s ({recording.rate:.6g} samples a second), less than one "
            f"period of {component}, {1 / frequency:.3g} s ({frequency:.4g} Hz): check the unit of the time and the "
            "dynamics"
        )


PARAMETERS_NAME: Final = "mass, stiffness, damping, delay"
"""Name of what the dynamics contribute to the uncertainty."""

PROBE: Final = 0.1
"""Change of a parameter, in standard uncertainties, over which the estimator's slope is taken."""


RINGING: Final = 1e-3
"""Size of an error of the ground's motion over its largest, up to which a delay by parts of a sample has spread it."""


Through = Callable[[Array], Array]
"""What a method makes of readings, shape (n, c), when it takes them as it took the record's: forces, (n, c)."""


@dataclass(frozen=True, slots=True, eq=False)
class ComponentRecord(ABC):
    """One component of a recording, ready for the estimator: its load, the model that reads it, and what is known.

    Attributes
    ----------
    recording, dynamics
        The recording, and the model of how the load follows the force.
    noise
        Spectrum of the noise of the readings, where it is known.
    shared
        Noise that other components show and that has been taken off the readings; None where none was.
    motion_error
        Error of the force that the ground's motion puts on the moving mass, shape (n,) or () [N]: what a Monte Carlo
        draw adds.
    """

    recording: Recording
    dynamics: ModalModel
    noise: NoiseSpectrum | None = field(default=None, kw_only=True)
    shared: SharedNoise | None = field(default=None, kw_only=True)
    motion_error: Array = field(default_factory=lambda: np.zeros(()), kw_only=True)

    @property
    def load(self) -> Array:
        """Readings of the load, shape (n,) [N]."""
        return self.recording.channel(self.dynamics.component).values

    @property
    def interval(self) -> float:
        """Time between samples [s]."""
        return 1 / self.recording.rate

    @property
    @abstractmethod
    def input_noise(self) -> float:
        """White noise of the ground's motion as a force per sample [N]."""

    @property
    @abstractmethod
    def motion_source(self) -> str:
        """Channels that the noise of the ground's motion comes from."""

    @property
    @abstractmethod
    def assumptions(self) -> tuple[str, ...]:
        """What had to be taken as zero because the recording does not have it."""

    @property
    def from_ground(self) -> Array:
        """Load that the ground's motion has put on the readings and that is still in them, shape (n,) [N]."""
        return np.zeros(self.recording.samples)

    @property
    def motion_force(self) -> Array:
        """Force of the ground's motion on the moving mass at the load's instants, still in the readings, (n,) [N]."""
        return np.zeros(self.recording.samples) + self.motion_error

    def reading(self, *, hum: tuple[float, ...] = ()) -> Observation:
        """The record as the estimator takes it: the load that the ground's motion has put on it is taken off.

        Hum is named by its frequencies [Hz] and left in; readings that rest on a limit count as missing.
        """
        channel = self.recording.channel(self.dynamics.component)
        reading = Observation(
            values=np.where(channel.at_limit, np.nan, channel.values - self.from_ground),
            interval=self.interval,
            dynamics=self.dynamics,
            input_density=self.input_noise**2 * self.interval,
            noise=channel.noise,
            hum=hum,
        )
        if self.noise is not None:
            color = self.noise.colored_part(self.recording.whole_duration)
            return replace(reading, noise=self.noise.deviation, color=color)
        if self.shared is not None:
            return replace(reading, noise=self.shared.white, color=self.shared.color)
        return reading

    @abstractmethod
    def parameter_errors(
        self,
        values: Callable[[], Array],
        again: Callable[[ComponentRecord], Array],
        through: Through,
        *,
        few: bool = False,
    ) -> Systematic:
        """Return the error of the force from errors of the dynamics' parameters [N].

        Parameters
        ----------
        values
            Gives the force, shape (n,) [N].
        again
            Works out the force of another record in the same way, shape (n,).
        through
            What the method makes of a change of the readings.
        few
            Whether it is enough to know it by as few independent quantities as show in the readings.
        """

    @abstractmethod
    def felt_under(self, item: SystematicParameter) -> Array:
        """Load felt under a unit of an unknown of the ground's motion, shape (n,)."""

    @abstractmethod
    def as_force(self, item: SystematicParameter) -> Array:
        """Force that a unit of an unknown of the ground's motion is taken for by a direct inverse, shape (n,)."""

    @property
    @abstractmethod
    def unknowns(self) -> tuple[SystematicParameter, ...]:
        """What holds along the ground's motion and is not known exactly."""

    @property
    def hides_motion(self) -> NDArray[np.bool_]:
        """Where a channel of the ground's motion has a gap, shape (n,)."""
        found = np.zeros(self.recording.samples, dtype=bool)
        for item in self.unknowns:
            if item.name.startswith(GAP):
                size = np.abs(item.slope).reshape(found.size, -1).max(axis=1)
                found |= size > RINGING * size.max()
        return found

    @abstractmethod
    def reading_errors(self, values: Array, through: Through) -> list[Contribution]:
        """Return the errors of the force from gain and zero of the load's channel [N]."""

    def motion_errors(self, slope: Callable[[SystematicParameter], Array]) -> list[Contribution]:
        """What holds along the ground's motion and is not known, by what a unit of it does to the force, (n,)."""
        groups: dict[tuple[str, str, bool], list[SystematicParameter]] = {}
        for item in self.unknowns:  # a gap hides several numbers under one name
            groups.setdefault((item.name, item.source, item.local), []).append(item)
        return [
            Systematic(
                name,
                source,
                tuple(item.name for item in items),
                np.column_stack([slope(item) for item in items]),
                np.diag([item.uncertainty**2 for item in items]),
                local=local,
            )
            for (name, source, local), items in groups.items()
        ]

    def finish(self, values: Array, contributions: list[Contribution], **facts: object) -> ComponentForce:
        """Return the force; contributions of zero are left out, but for that of the dynamics."""
        found = [(part, part.deviation) for part in contributions]
        found = [(part, own) for part, own in found if own.any() or part.source == "dynamics"]
        variance = np.sum([own**2 for _, own in found], axis=0)
        return ComponentForce(
            component=self.dynamics.component,
            values=values,
            uncertainty=np.asarray(np.sqrt(variance)),
            assumptions=self.assumptions,
            budget={part.name: float(np.sqrt(np.mean(own**2))) for part, own in found},
            contributions=tuple(part for part, _ in found),
            **facts,  # type: ignore[arg-type]
        )


@dataclass(frozen=True, slots=True, eq=False)
class SingleRecord(ComponentRecord):
    """One component that is not coupled with others, with the ground's motion along it.

    Attributes
    ----------
    dynamics
        The balance.
    motion
        The ground's motion.
    """

    dynamics: Dynamics
    motion: GroundMotion

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


@dataclass(frozen=True, slots=True, eq=False)
class IndependentRecord:
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
        for name in known:
            count = int(np.count_nonzero(np.isfinite(recording.channel(name).values)))
            if count < FEWEST_SAMPLES:
                raise FitError(
                    f"{recording.name}: {count} readings of {name}; a force needs at least {FEWEST_SAMPLES}"
                )
            check_length(recording, name, frequency=known[name].natural_frequency)
        settings = {"gravity": gravity, "gravity_uncertainty": gravity_uncertainty}
        return cls(recording, known, {name: GroundMotion.of(recording, name, **settings) for name in known})

    @property
    def loads(self) -> Array:
        """Readings of the components, shape (samples, n) [N, N*m]; NaN where missing."""
        return np.column_stack([self.recording.channel(name).values for name in self.dynamics])

    @property
    def has_gaps(self) -> bool:
        """False: no force needs the readings of another component."""
        return False

    def filled_by(self, forces: Mapping[str, Array], *, filled: Array) -> Array:
        """The readings as they are filled: nothing is filled, as no force needs it."""
        return filled

    def component_records(
        self, filled: Array, *, noises: Mapping[str, NoiseSpectrum] | None = None
    ) -> dict[str, SingleRecord]:
        """The records of the components, by name; as `CoupledRecord.component_records`, but gaps stay gaps."""
        spectra = {} if noises is None else noises
        return {name: self.component_record(name, filled, noise=spectra.get(name)) for name in self.dynamics}

    def component_record(
        self,
        component: str,
        filled: Array | None = None,
        *,
        noise: NoiseSpectrum | None = None,
        shared: SharedNoise | None = None,
    ) -> SingleRecord:
        """One component made ready."""
        return SingleRecord(
            self.recording, self.dynamics[component], self.motions[component], noise=noise, shared=shared
        )
