"""A recording of coupled components, made ready for the estimator of one component.

The load that ground motion and gravity put on the moving mass is taken off, and every component is decoupled from the
others (`aerobalance.dynamics.decoupling`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.checks.clock import check_clock
from aerobalance.estimation.correlated_noise import SharedNoise
from aerobalance.estimation.decoupled_record import DecoupledRecord, balance_load
from aerobalance.estimation.least_squares import root_of_covariance
from aerobalance.estimation.record import BalanceRecord, component_channels
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.motion.platform import PlatformMotion
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.errors import FitError, argument, warn_quality
from aerobalance.recording.noise import noise_covariance
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import align_channels, fractional_delay, interpolate_gaps
from aerobalance.recording.sensors import corrected

AT_ONCE: Final = 1 << 12
"""Samples at which free motions of all modes are made at once."""


@dataclass(frozen=True, slots=True, eq=False)
class CoupledRecord(BalanceRecord):
    """A recording with coupled dynamics and the ground's motion that go with it.

    Attributes
    ----------
    recording
        The recording.
    dynamics
        The coupled components.
    platform
        What the ground end does.
    channels
        The components' channels.
    loads
        Their readings, shape (samples, n); NaN where missing or at a limit.
    noise
        Covariance of the noise of a reading, shape (n, n) [N^2, N^2*m, N^2*m^2].
    from_ground
        Balance loads under gravity and the ground's motion alone, on the clock, shape (samples, n); less what other
        dynamics' mass would have put on the zero that the loads count from, where that was read under the weight.
    on_zero
        Weight in the loads that was taken out of their zero, shape (n,) [N, N*m].
    decoupled
        How each component is decoupled from the others.
    """

    recording: Recording
    dynamics: CoupledDynamics
    platform: PlatformMotion
    channels: tuple[Channel, ...] = field()  # else the property would be its default
    loads: Array = field()
    noise: Array = field()
    from_ground: Array = field()
    on_zero: Array = field()
    decoupled: tuple[DecoupledChannel, ...] = field()
    _readings: dict[object, Array] = field(init=False, default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        recording: Recording,
        dynamics: CoupledDynamics,
        *,
        gravity: float = STANDARD_GRAVITY,
        gravity_uncertainty: float = 0.0,
        noise: Array | None = None,
    ) -> CoupledRecord:
        """Take a recording as it was written.

        Parameters
        ----------
        recording, dynamics
            The recording, and the coupled components.
        gravity, gravity_uncertainty
            Local acceleration of gravity and its standard uncertainty [m/s^2].
        noise
            Covariance of the noise of a reading, shape (n, n); judged from the readings where it is not known.

        Raises
        ------
        FitError
            A component that the others ring with is not in the recording, or has too few readings; or the record
            is shorter than a period, or its times are in another unit than they say; or the ground end moves and
            the dynamics hold no mass.
        """
        recording = corrected(recording)
        channels = _channels(recording, dynamics)
        modes = [(mode.natural_frequency, mode.damping_ratio) for mode in dynamics.modes]
        check_clock(recording, "the slowest mode", channels=dynamics.components, modes=modes)
        platform = PlatformMotion.of(recording, gravity=gravity, gravity_uncertainty=gravity_uncertainty)
        interval = 1 / recording.rate
        lost = [one.at_limit | platform.unread_at(one.delay, interval=interval) for one in channels]
        loads = np.where(np.column_stack(lost), np.nan, np.column_stack([channel.values for channel in channels]))
        noise = noise_covariance(channels, interpolate_gaps(loads)) if noise is None else noise
        nothing, on_zero = np.zeros_like(loads), _weight_on_zero(platform, dynamics)
        made = cls(recording, dynamics, platform, channels, loads, noise, nothing, on_zero, ())
        return made.taken_with(dynamics)

    def taken_with(self, dynamics: CoupledDynamics, *, noise: Array | None = None) -> CoupledRecord:
        """The same record with other dynamics of its components, or with another covariance of their noise."""
        noise = self.noise if noise is None else noise
        from_ground = balance_load(dynamics, net_load(self.platform, dynamics), interval=self.interval)
        shift = self.on_zero - _weight_on_zero(self.platform, dynamics)
        return replace(
            self,
            dynamics=dynamics,
            noise=noise,
            from_ground=fractional_delay(from_ground, delay=-self.platform.delay, interval=self.interval) + shift,
            decoupled=tuple(dynamics.decoupled(name, noise=noise) for name in dynamics.components),
        )

    @property
    def motion_covariance(self) -> Array:
        """Covariance of the white noise of the ground's motion as a load per sample, shape (n, n)."""
        mass = self.dynamics.mass_rows
        return np.asarray(mass @ self.platform.white_covariance @ mass.T)

    def is_uncertain(self, component: str) -> bool:
        """Whether the matrices are not known exactly, or the mass while there is motion or weight."""
        mass = self.dynamics.mass
        acting = mass is not None and mass.covariance.any() and self.platform.specific_force.any()
        return bool(acting or self.dynamics.covariance.any())

    def component_record(
        self,
        component: str,
        filled: Array | None = None,
        *,
        noise: NoiseSpectrum | None = None,
        shared: SharedNoise | None = None,
    ) -> DecoupledRecord:
        """One decoupled component; its arguments are those of `component_records`, and noise to be taken off."""
        filled = interpolate_gaps(self.loads) if filled is None else filled
        decoupled = self.decoupled[self.dynamics.components.index(component)]
        channel = self.channels[decoupled.place]
        own = align_channels(filled, self.channels, to=channel, interval=self.interval)
        reading = self.reading(decoupled.place, on_clock_of=decoupled.place, filled=filled)
        others = () if shared is None else shared.others
        if shared is not None:
            theirs = [
                self.reading(other, on_clock_of=decoupled.place, filled=filled, model=model)
                for other, model in zip(others, shared.models, strict=True)
            ]
            reading = reading - shared.of(np.column_stack(theirs))
        values = reading
        if not np.isfinite(self.loads).all():
            values = np.where(np.isfinite(self.loads[:, decoupled.partners]).all(axis=1), reading, np.nan)
        apart = Channel(name=channel.name, values=values, unit=channel.unit, noise=channel.noise)
        return DecoupledRecord(
            recording=replace(self.recording, channels={channel.name: apart}),
            dynamics=decoupled.dynamics,
            coupled=self.dynamics,
            decoupled=decoupled,
            loads=own,
            channels=self.channels,
            platform=self.platform,
            noise=noise,
            shared=shared,
            others=tuple(self.decoupled[place] for place in others),
        )

    def reading(self, place: int, *, on_clock_of: int, filled: Array, model: ModalModel | None = None) -> Array:
        """As for every record, and kept until the readings are filled otherwise."""
        changed = model is not None and model is not self.decoupled[place].dynamics
        # every component asks for the readings of the others again
        if not changed and self._readings.get("filled") is not filled:
            self._readings.clear()
            self._readings["filled"] = filled
        key = (place, self.channels[on_clock_of].delay)
        known = None if changed else self._readings.get(key)
        if known is not None:
            return known
        found = BalanceRecord.reading(self, place, on_clock_of=on_clock_of, filled=filled, model=model)
        if not changed:
            self._readings[key] = found
        return found

    def filled_by(self, forces: Mapping[str, Array], *, filled: Array) -> Array:
        """Readings with their gaps filled by what forces make the balance read, shape (samples, n).

        Parameters
        ----------
        forces
            The forces of all components, shape (samples,) each.
        filled
            The readings with what the gaps were filled with before, shape (samples, n).
        """
        present = np.isfinite(self.loads)
        # forces and readings are at the instants of their channels, the balance has one clock
        force = self._late([forces[name] for name in self.dynamics.components], sign=-1)
        felt = self._late((balance_load(self.dynamics, force, interval=self.interval) + self.from_ground).T, sign=1)
        left = _free_motion(self.dynamics, filled - felt, present, interval=self.interval)
        return np.where(present, self.loads, felt + left)

    def _late(self, columns: Iterable[Array], *, sign: int) -> Array:
        """Series of the components delayed as their channels are, or (sign -1) as they were before, (samples, n)."""
        late = zip(columns, self.channels, strict=True)
        return np.column_stack(
            [fractional_delay(one, delay=sign * channel.delay, interval=self.interval) for one, channel in late]
        )


def net_load(platform: PlatformMotion, dynamics: CoupledDynamics) -> Array:
    """Loads that ground motion and gravity put on the moving mass, W - M x1'', shape (samples, n).

    Raises
    ------
    FitError
        There is motion, and the mass is not known.
    """
    if not platform.specific_force.any():
        return np.zeros((platform.specific_force.shape[0], len(dynamics.components)))
    if dynamics.mass is None and not np.ptp(platform.specific_force, axis=0).any():
        warn_quality("the dynamics hold no mass: the weight at the steady attitude of the record stays in the forces")
        return np.zeros((platform.specific_force.shape[0], len(dynamics.components)))
    if dynamics.mass is None:
        raise FitError(
            "the ground end moves or pitches, but the dynamics hold no mass; their warnings say why, where a weighing "
            "was given when they were identified. Give mass, centre of gravity and inertia then "
            f"({argument('mass')})"
        )
    return platform.force(dynamics.mass)[:, [COMPONENTS.index(name) for name in dynamics.components]]


def _weight_on_zero(platform: PlatformMotion, dynamics: CoupledDynamics) -> Array:
    """Weight of the mass while the zero of the loads was read, shape (n,); zero where it was not taken out of it."""
    if dynamics.mass is None:
        return np.zeros(len(dynamics.components))
    own = [COMPONENTS.index(name) for name in dynamics.components]
    return np.asarray((platform.gravity_on_zero @ dynamics.mass.matrix.T)[own])


def _channels(recording: Recording, dynamics: CoupledDynamics) -> tuple[Channel, ...]:
    lacking = [name for name in dynamics.components if name not in recording]
    if lacking:
        raise FitError(
            f"{recording.name} has no {', '.join(lacking)}; the components are coupled, so the force of each needs "
            f"the readings of all: {', '.join(dynamics.components)}"
        )
    return component_channels(recording, dynamics.components)


def _free_motion(dynamics: CoupledDynamics, left: Array, present: NDArray[np.bool_], *, interval: float) -> Array:
    """Free motion of the balance that explains best what is left of the readings, shape (samples, n)."""
    poles, shapes, _ = dynamics.modal_form
    up = poles.imag >= 0
    size = np.maximum(left.std(axis=0), 1e-60)
    swinging = np.concatenate([shapes.T[up] / size, 1j * shapes.T[up] / size])
    pieces = [slice(first, first + AT_ONCE) for first in range(0, len(left), AT_ONCE)]

    def basis(piece: slice) -> Array:
        """Real and imaginary parts of all motions, (m, n, 2 modes): of all samples they take as much as all else."""
        time = np.arange(*piece.indices(len(left))) * interval
        swing = np.tile(np.exp(poles[up, None] * time), (2, 1))
        return np.asarray(np.einsum("mt,mn->tnm", swing, swinging).real)

    products, found = np.zeros((len(swinging), len(swinging))), np.zeros(len(swinging))
    for piece in pieces:
        shown = basis(piece)[present[piece]]
        products += shown.T @ shown
    root = root_of_covariance(products)
    for _ in range(2):  # solved again for what they leave
        told = np.zeros(len(swinging))
        for piece in pieces:
            shown = basis(piece)[present[piece]]
            told += shown.T @ ((left[piece] / size)[present[piece]] - shown @ found)
        found = found + root @ (root.T @ told)
    return np.concatenate([basis(piece) @ found * size for piece in pieces])
