"""The record of one of several coupled components, decoupled from the others and ready for the estimator.

What a unit of anything that is not known does to the readings of the coupled balance becomes here what it does to the
reading of the decoupled channel, and less the noise that the others show, where that is taken off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.rigid_body import MASS_PARAMETERS, mass_slopes
from aerobalance.estimation.error_sources import Contribution, Systematic
from aerobalance.estimation.record import ComponentRecord, Through
from aerobalance.motion.platform import PlatformMotion, SystematicParameter
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, IS_FORCE
from aerobalance.recording.linalg import covariance_root, sums_of_products
from aerobalance.recording.resampling import FINE, fractional_delay, upsample_compensated

FAINT: Final = 1e-3
"""Rms of an error in a reading over its noise that is nothing beside it."""

AT_ONCE: Final = 4
"""Directions of the parameters that are taken through the estimator together."""

UNSEEN: Final = 1e-4
"""The same over the rms of all errors of a reading: an error that holds along a record shows in its mean."""


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
    """

    coupled: CoupledDynamics
    decoupled: DecoupledChannel
    loads: Array
    channels: tuple[Channel, ...]
    platform: PlatformMotion
    others: tuple[DecoupledChannel, ...] = ()

    @property
    def input_noise(self) -> float:
        """White noise of the ground's motion as a force per sample [N]."""
        row = self.coupled.mass_rows[self.decoupled.place]
        return float(np.sqrt(max(row @ self.platform.white_covariance @ row, 0.0)))

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
        parts = [one.rows for one in (self.decoupled, *self.others)]
        return np.unique(np.concatenate(parts))

    def parameter_errors(
        self,
        values: Callable[[], Array],
        again: Callable[[ComponentRecord], Array],
        through: Through,
        *,
        few: bool = False,
    ) -> Systematic:
        """What a wrong element of inertia, damping or mass does to the force."""
        name, uncertain = "inertia, damping and mass", self._uncertain
        if uncertain is None:
            return Systematic(name, "dynamics", (), np.zeros((len(self.loads), 0)), np.zeros((0, 0)))
        of_mass = uncertain.of_mass.size > 0
        own = self._effects(self.decoupled, of_mass=of_mass)
        if self.shared is None and not few:
            names = [*(self.coupled.parameters[number] for number in self.rows), *(MASS_PARAMETERS if of_mass else ())]
            quantities = uncertain.within(self.decoupled.rows)
            slopes = through(own) @ self._by_parameters(self.decoupled, of_mass=of_mass)
            return Systematic(name, "dynamics", tuple(names), slopes, quantities @ quantities.T, quantities)
        # of all parameters few directions show: the rest is neither worked out nor kept sample by sample
        parts, numbers = [own], self._numbers(self.decoupled, uncertain)
        least = 0.0 if self.shared is None else FAINT * self.shared.before
        for other in self.others:
            # what is wrong in the row of another is taken for noise that it shows
            theirs, of_theirs = self._effects(other, of_mass=of_mass), self._numbers(other, uncertain)
            kept = _directions([theirs], of_theirs, least=least / len(self.others))
            parts.append(-self._taken_off(theirs @ (of_theirs @ kept), other))
            numbers = np.vstack([numbers, kept.T])
            del theirs  # of a long record as large as all that is kept of them
        kept = _directions(parts, numbers, least=least)
        names = [f"direction {number} of inertia, damping and mass" for number in range(1, kept.shape[1] + 1)]
        sums, slopes = numbers @ kept, np.empty((len(names), len(self.loads)))
        ends = np.cumsum([part.shape[1] for part in parts])
        for first in range(0, len(names), AT_ONCE):
            few_of_them = sums[:, first : first + AT_ONCE]
            series = np.zeros((len(self.loads), few_of_them.shape[1]))
            for part, end in zip(parts, ends, strict=True):
                series += part @ few_of_them[end - part.shape[1] : end]
            slopes[first : first + AT_ONCE] = through(series).T
        return Systematic(name, "dynamics", tuple(names), slopes.T, np.eye(len(names)), kept.T.copy())

    @property
    def _uncertain(self) -> _Uncertain | None:
        """What the parameters are not known by; None if they are."""
        mass, of_mass = self.coupled.mass, np.zeros((0, 0))
        if mass is not None and mass.covariance.any() and self.platform.specific_force.any():
            of_mass = covariance_root(mass.covariance, reduced=False)
        if not of_mass.size and not self.coupled.covariance.any():
            return None
        return _Uncertain(covariance_root(self.coupled.covariance, reduced=False), of_mass)

    def _effects(self, one: DecoupledChannel, *, of_mass: bool) -> Array:
        """What changes the reading of a decoupled component, shape (samples, k) [N, N*m per unit of each].

        That is a unit of each of its parameters and, where the mass is not known, of each acceleration under a mass of
        one: forces of the ground's motion on its own component are all that it shows.
        """
        slopes = one.parameter_slopes(self.loads, interval=self.interval)
        if not of_mass:
            return slopes
        # the loads count from a zero that was read under the weight: the mass is wrong there too
        acting = self.platform.specific_force + self.platform.gravity_on_zero
        return np.vstack([slopes.T, one.response_to(acting, interval=self.interval).T]).T

    def _by_parameters(self, one: DecoupledChannel, *, of_mass: bool) -> Array:
        """Those of `_effects` by a unit of each of its parameters and those of the mass, shape (k, p)."""
        own = np.eye(one.rows.size)
        return block_diag(own, self._acting_by_mass(one)) if of_mass else own

    def _numbers(self, one: DecoupledChannel, uncertain: _Uncertain) -> Array:
        """Those of `_effects` by each of the independent numbers that nothing is known of, shape (k, r)."""
        quantities = uncertain.within(one.rows)
        return np.asarray(self._by_parameters(one, of_mass=uncertain.of_mass.size > 0) @ quantities)

    def _acting_by_mass(self, one: DecoupledChannel) -> Array:
        """By how much each acceleration acts on a component for a unit of each of `MASS_PARAMETERS`, shape (6, p)."""
        mass = self.coupled.mass
        if mass is None:
            raise AssertionError
        row = COMPONENTS.index(one.component)
        return np.column_stack([-part[row] for part in mass_slopes(mass)])

    def _taken_off(self, series: Array, other: DecoupledChannel) -> Array:
        return np.zeros_like(series) if self.shared is None else self.shared.slopes(series, other.place)

    @property
    def motion_across(self) -> tuple[Array, str] | None:
        """What the accelerometers would read of motions across their axes, if as much moves there as along them."""
        moving = self.platform.acceleration * IS_FORCE
        slope = moving - moving.mean(axis=0)
        return (slope, "the ground's accelerometers") if slope.any() else None

    def reading_of(self, felt: Array) -> Array:
        """Reading of the decoupled component under a part of the balance loads, shape (samples,) [N]."""
        own = self.decoupled.reading(felt, interval=self.interval)
        for other in self.others:
            own = own - self._taken_off(other.reading(felt, interval=self.interval)[:, None], other)[:, 0]
        return own

    def felt_under(self, item: SystematicParameter) -> Array:
        """Balance load under a unit of an unknown of the ground's motion, shape (samples,)."""
        rows = self.coupled.mass_rows
        channels = (self.decoupled, *self.others)
        net = [item.slope @ -rows[one.place][:, None] for one in channels]  # on the component itself
        if not any(part.any() for part in net):
            return np.zeros(len(item.slope))
        own, *theirs = (one.response_to(part, interval=self.interval) for one, part in zip(channels, net, strict=True))
        for other, part in zip(self.others, theirs, strict=True):
            own = own - self._taken_off(part, other)
        lag = self.channels[self.decoupled.place].delay - self.platform.delay
        return np.asarray(fractional_delay(own[:, 0], delay=lag, interval=self.interval))

    def as_force(self, item: SystematicParameter) -> Array:
        """Force that a unit of an unknown of the ground's motion is taken for by a direct inverse, (samples,)."""
        return np.asarray(item.slope @ self.coupled.mass_rows[self.decoupled.place])

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
                slope = through(self.reading_of(alone)[:, None])
                name, variance = f"gain of {channel.name}", channel.relative_uncertainty**2
                parts.append(Systematic(name, channel.name, (name,), slope, np.array([[variance]])))
        own = self.channels[self.decoupled.place]
        if own.zero_uncertainty > 0:
            name, variance = f"zero of {own.name}", own.zero_uncertainty**2
            one = np.ones((values.size, 1))
            parts.append(Systematic(name, own.name, (name,), one, np.array([[variance]])))
        return parts


@dataclass(frozen=True, slots=True, eq=False)
class _Uncertain:
    """What the parameters of coupled dynamics are made of: independent numbers of variance 1.

    Attributes
    ----------
    of_matrices
        Root of the covariance of inertia and damping, shape (p, p).
    of_mass
        Root of that of the mass, shape (q, q); nothing where it makes no difference.
    """

    of_matrices: Array
    of_mass: Array

    def within(self, rows: NDArray[np.intp]) -> Array:
        """Some of the parameters of the matrices, and those of the mass, by the numbers of both, (k, r).

        There are as many numbers of the mass where it makes no difference, so that all parts of a record agree.
        """
        return block_diag(self.of_matrices[rows], self.of_mass)


def _directions(series: Sequence[Array], numbers: Array, *, least: float) -> Array:
    """Combinations (r, k) of independent numbers of variance 1 whose effects are independent and show.

    Parameters
    ----------
    series
        What changes a reading, some of them each, shape (n, any), p in all.
    numbers
        By how much, for a unit of each of independent numbers, shape (p, r).
    least
        Rms that is nothing, beside `UNSEEN` of that of all together.
    """
    products = np.block([[sums_of_products(one, other) for other in series] for one in series])
    level, vectors = np.linalg.eigh(products / len(series[0]))
    root = vectors * np.sqrt(np.maximum(level, 0.0))
    _, size, turned = np.linalg.svd(root.T @ numbers, full_matrices=False)
    power = size**2
    return np.asarray(turned.T[:, power > max(least**2, UNSEEN**2 * max(float(power.sum()), 0.0))])


def balance_load(dynamics: CoupledDynamics, net: Array, *, interval: float) -> Array:
    """Balance loads under loads on the moving mass that are band-limited, both (samples, n)."""
    if not net.any():
        return np.zeros_like(net)
    return dynamics.balance_load(upsample_compensated(net), interval=interval / FINE, every=FINE)
