"""What a force is worked out from: the record of each component with its dynamics and the motion of the ground."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.correlated_noise import SharedNoise
from aerobalance.estimation.error_sources import Contribution, Systematic
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.result import ComponentForce, budget_of
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.motion.gaps import GAP
from aerobalance.motion.platform import SystematicParameter
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import FitError
from aerobalance.recording.noise import noise_covariance
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import align_channels, fractional_delay, interpolate_gaps
from aerobalance.recording.sensors import late_samples
from aerobalance.recording.side_by_side import side_by_side

FEWEST_SAMPLES: Final = 32
"""Fewest readings of a component that a force is worked out for."""


def component_channels(recording: Recording, components: Iterable[str]) -> tuple[Channel, ...]:
    """Return the channels of components.

    Raises
    ------
    FitError
        One has too few readings.
    """
    channels = tuple(recording.channel(name) for name in components)
    for channel in channels:
        count = int(np.count_nonzero(np.isfinite(channel.values)))
        if count < FEWEST_SAMPLES:
            raise FitError(
                f"{recording.name}: {count} readings of {channel.name}; a force needs at least {FEWEST_SAMPLES}"
            )
    return channels


PARAMETERS_NAME: Final = "mass, stiffness, damping, delay"
"""Name of what the dynamics contribute to the uncertainty."""

PROBE: Final = 0.1
"""Change of a parameter, in standard uncertainties, over which the estimator's slope is taken."""


AT_ONCE: Final = 4
"""Unknowns of the ground's motion whose effect is worked out together, as each takes room."""

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
    def before_ground(self) -> NDArray[np.bool_]:
        """Where the load was read before or after the sensors of a ground that moves, for its delay, shape (n,)."""
        return np.zeros(self.recording.samples, dtype=bool)

    @property
    def motion_force(self) -> Array:
        """Force of the ground's motion on the moving mass at the load's instants, still in the readings, (n,) [N]."""
        return np.zeros(self.recording.samples) + self.motion_error

    def reading(
        self, *, hum: tuple[float, ...] = (), tones: tuple[float, ...] = (), drift: tuple[float, ...] = ()
    ) -> Observation:
        """The record as the estimator takes it: the load that the ground's motion has put on it is taken off.

        Hum and tones of the load are named by their frequencies [Hz], with how the tones drift, and left in; readings
        that rest on a limit count as missing, and so do those of instants at which the ground's motion was not read.
        """
        channel = self.recording.channel(self.dynamics.component)
        lost = channel.at_limit | self.before_ground
        low_pass = self.recording.low_passed.get(channel.name)
        if low_pass is not None and self.recording.extent.end >= 1:
            late = late_samples(low_pass, self.recording.rate)
            lost[max(lost.size - late, 0) :] = True  # the inverse of the filter asks for readings beyond the end
        reading = Observation(
            values=np.where(lost, np.nan, channel.values - self.from_ground),
            interval=self.interval,
            dynamics=self.dynamics,
            input_density=self.input_noise**2 * self.interval,
            noise=channel.noise,
            hum=hum,
            tones=tones,
            drift=drift,
            decimated=self.recording.decimated,
        )
        if self.noise is not None:
            color = self.noise.colored_part(self.recording.whole_duration)
            return replace(reading, noise=self.noise.deviation, color=color)
        if self.shared is not None:
            return replace(reading, noise=self.shared.white, color=self.shared.color)
        return reading

    @property
    @abstractmethod
    def rows(self) -> NDArray[np.intp]:
        """Which of the parameters of the dynamics have a part in the reading."""

    @abstractmethod
    def reading_of(self, felt: Array) -> Array:
        """Return the reading under a part of the balance loads, shapes (samples,) and (samples, n) [N, N*m]."""

    @property
    @abstractmethod
    def motion_across(self) -> tuple[Array, str] | None:
        """What accelerometers read across their axes if as much moves there, a slope as of `unknowns`, and their name.

        None where nothing moves or where what is across is taken into account.
        """

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
        """Balance load under a unit of an unknown of the ground's motion, shape (n,)."""

    @abstractmethod
    def as_force(self, item: SystematicParameter) -> Array:
        """Force that a unit of an unknown of the ground's motion is taken for by a direct inverse, shape (n,)."""

    @property
    @abstractmethod
    def unknowns(self) -> tuple[SystematicParameter, ...]:
        """What holds along the ground's motion and is not known exactly."""

    @property
    def hides_motion(self) -> NDArray[np.bool_]:
        """Where a gap hides motion of the ground that is not looked for in the load, shape (n,)."""
        found = np.zeros(self.recording.samples, dtype=bool)
        for item in self.unknowns:
            if item.name.startswith(GAP):
                size = np.abs(item.slope).reshape(found.size, -1).max(axis=1)
                found |= size > RINGING * size.max()
        return found

    @abstractmethod
    def reading_errors(self, values: Array, through: Through) -> list[Contribution]:
        """Return the errors of the force from gain and zero of the load's channel [N]."""

    def motion_errors(self, slopes: Callable[[Sequence[SystematicParameter]], Array]) -> list[Contribution]:
        """What holds along the ground's motion and is not known, by what a unit of each does to the force, (n, k)."""
        groups: dict[tuple[str, str, bool], list[SystematicParameter]] = {}
        for item in self.unknowns:  # a gap hides several numbers under one name
            groups.setdefault((item.name, item.source, item.local), []).append(item)
        return [
            Systematic(
                name,
                source,
                tuple(item.name for item in items),
                np.column_stack([slopes(items[i : i + AT_ONCE]) for i in range(0, len(items), AT_ONCE)]),
                np.diag([item.uncertainty**2 for item in items]),
                local=local,
            )
            for (name, source, local), items in groups.items()
        ]

    @property
    def _read_late(self) -> tuple[str, ...]:
        """By how much the force is earlier than the time beside it, in words; nothing where the load has no delay."""
        name = self.dynamics.component
        delay = self.recording.channel(name).delay
        if not delay:
            return ()
        by = f"{1e3 * abs(delay):.4g} ms {'before' if delay > 0 else 'after'} the time beside it"
        return (f"the force of {name} is that of the instants at which it was read, by its delay {by}",)

    def finish(self, values: Array, contributions: list[Contribution], **facts: object) -> ComponentForce:
        """Return the force; contributions of zero are left out, but for that of the dynamics."""
        found = [(part, part.deviation) for part in contributions]
        found = [(part, own) for part, own in found if own.any() or part.source == "dynamics"]
        variance = np.sum([own**2 for _, own in found], axis=0)
        return ComponentForce(
            component=self.dynamics.component,
            values=values,
            uncertainty=np.asarray(np.sqrt(variance)),
            assumptions=(*self.assumptions, *self._read_late),
            budget=budget_of([part for part, _ in found]),
            contributions=tuple(part for part, _ in found),
            **facts,  # type: ignore[arg-type]
        )


class BalanceRecord(ABC):
    """A recording with the dynamics of n components, made ready for the estimator of one component.

    Attributes
    ----------
    recording
        The recording.
    dynamics
        The dynamics of the components that are worked out.
    """

    __slots__ = ()
    recording: Recording
    dynamics: BalanceDynamics

    @property
    def interval(self) -> float:
        """Time between samples [s]."""
        return 1 / self.recording.rate

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The components' channels."""
        return tuple(self.recording.channel(name) for name in self.dynamics.components)

    @property
    def loads(self) -> Array:
        """Readings of the components, shape (samples, n) [N, N*m]; NaN where missing."""
        return np.column_stack([channel.values for channel in self.channels])

    @property
    def noise(self) -> Array:
        """Covariance of the noise of a reading, shape (n, n) [N^2, N^2*m, N^2*m^2]."""
        return noise_covariance(self.channels, interpolate_gaps(self.loads))

    @property
    @abstractmethod
    def from_ground(self) -> Array:
        """Balance loads under gravity and the ground's motion alone, on the clock, shape (samples, n) [N, N*m]."""

    @property
    @abstractmethod
    def motion_covariance(self) -> Array:
        """Covariance of the white noise of the ground's motion as a load per sample, shape (n, n)."""

    @property
    @abstractmethod
    def decoupled(self) -> tuple[DecoupledChannel, ...]:
        """How each component is decoupled from the others."""

    @property
    def is_coupled(self) -> bool:
        """Whether the force of some component needs the readings of another."""
        return not all(one.alone for one in self.decoupled)

    @property
    def has_gaps(self) -> bool:
        """True where readings are missing that the force of another component needs."""
        return self.is_coupled and not np.isfinite(self.loads).all()

    @abstractmethod
    def is_uncertain(self, component: str) -> bool:
        """Return whether a component's force depends on parameters of the dynamics that are not known exactly."""

    @abstractmethod
    def filled_by(self, forces: Mapping[str, Array], *, filled: Array) -> Array:
        """Return readings with their gaps filled by what forces make the balance read, shape (samples, n).

        Parameters
        ----------
        forces
            The forces of all components, shape (samples,) each.
        filled
            The readings with what the gaps were filled with before, shape (samples, n).
        """

    @abstractmethod
    def taken_with(self, dynamics: Any, *, noise: Array | None = None) -> BalanceRecord:
        """Return the same record with other dynamics of its kind, or another covariance of the readings' noise."""

    def with_noise(self, noise: Array) -> BalanceRecord:
        """Return the same record with another covariance of the noise of a reading, shape (n, n)."""
        return self.taken_with(self.dynamics, noise=noise)

    def reading(self, place: int, *, on_clock_of: int, filled: Array, model: ModalModel | None = None) -> Array:
        """Return the reading of a decoupled component at the instants of a component's channel, (samples,) [N, N*m].

        Parameters
        ----------
        place, on_clock_of
            Rows of the two.
        filled
            The readings without gaps, as in `component_records`; the load from the ground's motion is taken off.
        model
            Another model in the place of the component's own.
        """
        decoupled = self.decoupled[place] if model is None else replace(self.decoupled[place], dynamics=model)
        return decoupled.reading(self.without_ground(filled, on_clock_of=on_clock_of), interval=self.interval)

    def without_ground(self, filled: Array, *, on_clock_of: int) -> Array:
        """Return all readings at the instants of a component's channel less the ground's load, (samples, n) [N, N*m].

        Parameters
        ----------
        filled
            The readings without gaps, as in `component_records`.
        on_clock_of
            Row of the component.
        """
        own = align_channels(filled, self.channels, to=self.channels[on_clock_of], interval=self.interval)
        return own - self.felt_of_ground(on_clock_of=on_clock_of)

    def felt_of_ground(self, *, on_clock_of: int) -> Array:
        """Return what the ground's motion puts on the loads at the instants of a component's channel, (samples, n).

        Parameters
        ----------
        on_clock_of
            Row of the component.
        """
        delay = self.channels[on_clock_of].delay
        return fractional_delay(self.from_ground, delay=delay, interval=self.interval)

    @abstractmethod
    def component_record(
        self,
        component: str,
        filled: Array | None = None,
        *,
        noise: NoiseSpectrum | None = None,
        shared: SharedNoise | None = None,
    ) -> ComponentRecord:
        """Return one component made ready; as in `component_records`, and with shared noise to be taken off."""

    def component_records(
        self, filled: Array, *, noises: Mapping[str, NoiseSpectrum] | None = None
    ) -> dict[str, ComponentRecord]:
        """Return the components made ready, by name.

        Parameters
        ----------
        filled
            The readings with something in the place of those that are missing, shape (samples, n). A component's
            reading stays missing where one that has a part in it is.
        noises
            Spectra of the noise of the components' readings, where they are known.
        """
        spectra = {} if noises is None else noises
        names = self.dynamics.components
        made = side_by_side(lambda name: self.component_record(name, filled, noise=spectra.get(name)), names)
        return dict(zip(names, made, strict=True))
