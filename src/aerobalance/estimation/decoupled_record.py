"""The record of one of several coupled components, decoupled from the others and ready for the estimator.

What a unit of anything that is not known does to the readings of the coupled balance becomes here what it does to the
reading of the decoupled channel, and less the noise that the others show, where that is taken off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import MASS_PARAMETERS, CoupledDynamics, RigidMass
from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.estimation.error_sources import Contribution, Systematic
from aerobalance.estimation.record import ComponentRecord, Through
from aerobalance.motion.platform import PlatformMotion, SystematicParameter
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.linalg import covariance_root
from aerobalance.recording.resampling import FINE, upsample_compensated

FAINT: Final = 1e-3
"""Rms of an error in a reading over its noise that is nothing beside it."""

SMALL: Final = 1e-6
"""Relative change of the mass's parameters over which its slopes are taken; the matrix is a polynomial in them."""


@dataclass(slots=True, eq=False)
class MassErrors:
    """What coupled components feel of gravity and the ground's motion by an error of the moving mass.

    Attributes
    ----------
    coupled
        The components.
    platform
        What the ground end does.
    interval
        Time between samples [s].
    """

    coupled: CoupledDynamics
    platform: PlatformMotion
    interval: float
    _felt: list[Array] | None = None

    def felt(self) -> list[Array]:
        """Balance loads by a unit of each of `MASS_PARAMETERS`, shape (samples, n) each; worked out once."""
        if self._felt is None and self.coupled.mass is not None:
            own = [COMPONENTS.index(component) for component in self.coupled.components]
            # the loads count from a zero that was read under the weight: the mass is wrong there too
            acting = self.platform.specific_force + self.platform.gravity_on_zero
            self._felt = [
                load_felt(self.coupled, -acting @ part[own].T, interval=self.interval)
                for part in mass_slopes(self.coupled.mass)
            ]
        return self._felt or []


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DecoupledRecord(ComponentRecord):
    """One of several coupled components, decoupled from the others.

    `recording` holds what the equivalent model of this component alone would read under its force: what gravity and
    the ground's motion do has been taken off.

    Attributes
    ----------
    coupled
        The coupled components.
    decoupled
        How the component is decoupled from the others.
    loads
        Readings of all components without gaps, shape (samples, n).
    channels
        The channels that they come from.
    platform
        What the ground end does.
    others
        Those others whose noise is taken off its reading.
    of_mass
        What the balance feels of the ground's motion by an error of the mass, the same for all components.
    """

    coupled: CoupledDynamics
    decoupled: DecoupledChannel
    loads: Array
    channels: tuple[Channel, ...]
    platform: PlatformMotion
    others: tuple[DecoupledChannel, ...] = ()
    of_mass: MassErrors

    @property
    def input_noise(self) -> float:
        """White noise of the ground's motion as a force per sample [N]."""
        row = mass_rows(self.coupled)[self.decoupled.place]
        return float(np.sqrt(max(row @ self.platform.covariance @ row, 0.0)))

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What had to be taken as zero because the recording does not have it."""
        return self.platform.assumptions

    @property
    def motion_source(self) -> str:
        """Channels that the noise of the ground's motion comes from."""
        return "ground motion"

    @property
    def rows(self) -> NDArray[np.intp]:
        """Which of the parameters of the coupled dynamics have a part in the reading."""
        parts = [one.rows(self.coupled) for one in (self.decoupled, *self.others)]
        return np.unique(np.concatenate(parts))

    def parameter_errors(
        self, values: Array, again: Callable[[ComponentRecord], Array], through: Through
    ) -> Systematic:
        """What a wrong element of inertia, damping or mass does to the force."""
        rows = self.rows
        name, mass = "inertia, damping and mass", self.coupled.mass
        if not self.coupled.covariance.any() and (mass is None or not mass.covariance.any()):
            return Systematic(name, "dynamics", (), np.zeros((values.size, 0)), np.zeros((0, 0)))
        in_reading = self._parameter_slopes(rows)
        covariance = self.coupled.covariance[np.ix_(rows, rows)]
        root = covariance_root(self.coupled.covariance, reduced=False)[rows]
        names = [self.coupled.parameters[number] for number in rows]
        if self.shared is not None:
            # of all rows' parameters few directions show: the rest is neither worked out nor kept sample by sample
            turned = _directions(in_reading, root, least=FAINT * self.shared.before)
            in_reading, root = in_reading @ (root @ turned), turned.T
            names = [f"direction {number} of inertia and damping" for number in range(1, in_reading.shape[1] + 1)]
            covariance = np.eye(in_reading.shape[1])
        slopes = through(in_reading)
        root = np.pad(root, ((0, 0), (0, len(MASS_PARAMETERS))))
        if mass is not None and mass.covariance.any() and self.platform.specific_force.any():
            felt = [self._read(part) for part in self.of_mass.felt()]
            slopes = np.column_stack([slopes, -through(np.column_stack(felt))])
            zero = np.zeros((len(names), len(felt)))
            covariance = np.block([[covariance, zero], [zero.T, mass.covariance]])
            of_mass = covariance_root(mass.covariance, reduced=False)
            root = np.vstack([root, np.pad(of_mass, ((0, 0), (root.shape[1] - len(felt), 0)))])
            names += list(MASS_PARAMETERS)
        return Systematic(name, "dynamics", tuple(names), slopes, covariance, root)

    def _parameter_slopes(self, rows: NDArray[np.intp]) -> Array:
        """Change of the reading with each of these parameters, shape (samples, k)."""
        slopes = np.zeros((self.loads.shape[0], rows.size))
        own = np.searchsorted(rows, self.decoupled.rows(self.coupled))
        slopes[:, own] = self.decoupled.parameter_slopes(self.loads, interval=self.interval)
        for other in self.others:
            # what is wrong in the row of another is taken for noise that it shows
            theirs = np.searchsorted(rows, other.rows(self.coupled))
            series = other.parameter_slopes(self.loads, interval=self.interval)
            slopes[:, theirs] -= self._taken_off(series, other)
        return slopes

    def _taken_off(self, series: Array, other: DecoupledChannel) -> Array:
        return np.zeros_like(series) if self.shared is None else self.shared.slopes(series, other.place)

    def _read(self, felt: Array) -> Array:
        """Reading of the decoupled component under a part of the loads felt, shape (samples,) [N]."""
        own = self.decoupled.reading(felt, interval=self.interval)
        for other in self.others:
            own = own - self._taken_off(other.reading(felt, interval=self.interval)[:, None], other)[:, 0]
        return own

    def _felt(self, net: Array) -> Array:
        """Reading of the component under loads on the moving mass, shapes (samples,) and (samples, n) [N]."""
        return self._read(load_felt(self.coupled, net, interval=self.interval))

    def felt_under(self, item: SystematicParameter) -> Array:
        """Load felt under a unit of an unknown of the ground's motion, shape (samples,)."""
        return self._felt(-item.slope @ mass_rows(self.coupled).T)

    def as_force(self, item: SystematicParameter) -> Array:
        """Force that a unit of an unknown of the ground's motion is taken for by a direct inverse, (samples,)."""
        return np.asarray((item.slope @ mass_rows(self.coupled).T)[:, self.decoupled.place])

    @property
    def unknowns(self) -> tuple[SystematicParameter, ...]:
        """What holds along the ground's motion and is not known exactly."""
        return self.platform.unknowns

    def reading_errors(self, values: Array, through: Through) -> list[Contribution]:
        """Gain of every channel that has a part in the component, and the zero of its own."""
        parts: list[Contribution] = []
        for place, channel in enumerate(self.channels):
            if channel.relative_uncertainty > 0:
                alone = np.zeros_like(self.loads)
                alone[:, place] = self.loads[:, place]
                slope = through(self._read(alone)[:, None])
                name, variance = f"gain of {channel.name}", channel.relative_uncertainty**2
                parts.append(Systematic(name, channel.name, (name,), slope, np.array([[variance]])))
        own = self.channels[self.decoupled.place]
        if own.zero_uncertainty > 0:
            name, variance = f"zero of {own.name}", own.zero_uncertainty**2
            one = np.ones((values.size, 1))
            parts.append(Systematic(name, own.name, (name,), one, np.array([[variance]])))
        return parts


def _directions(slopes: Array, root: Array, *, least: float) -> Array:
    """Combinations (r, k) of independent quantities, slopes (n, p) times root (p, r), whose rms is above `least`."""
    power, turned = np.linalg.eigh(root.T @ (slopes.T @ slopes) @ root / slopes.shape[0])
    return np.asarray(turned[:, power > least**2])


def load_felt(dynamics: CoupledDynamics, net: Array, *, interval: float) -> Array:
    """Loads felt under loads on the moving mass that are band-limited, both (samples, n)."""
    if not net.any():
        return np.zeros_like(net)
    return dynamics.load_felt(upsample_compensated(net), interval=interval / FINE, every=FINE)


def mass_slopes(mass: RigidMass) -> list[Array]:
    """Derivatives of the mass matrix by mass, centre of gravity and the six elements of the inertia, (6, 6) each."""
    values = mass.values
    slopes = []
    for place in range(values.size):
        small = SMALL * max(abs(values[place]), 1e-3)
        more, less = values.copy(), values.copy()
        more[place] += small
        less[place] -= small
        slopes.append((RigidMass.of_values(more).matrix - RigidMass.of_values(less).matrix) / (2 * small))
    return slopes


def mass_rows(dynamics: CoupledDynamics) -> Array:
    """Rows of the mass matrix that belong to the components, shape (n, 6); nothing without a mass."""
    if dynamics.mass is None:
        return np.zeros((len(dynamics.components), len(COMPONENTS)))
    return dynamics.mass.matrix[[COMPONENTS.index(name) for name in dynamics.components]]
