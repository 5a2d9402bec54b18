"""Result of a weighing, and the loads [N, N*m] that the weight gives at other attitudes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.balance.weighing.model import WeightModel
from aerobalance.recording.channel import Array
from aerobalance.recording.components import AXES, FORCE_AXES, STANDARD_GRAVITY
from aerobalance.recording.doubts import Doubt, Size, Verdict, verdict_of
from aerobalance.recording.gravity import Attitudes, weight_direction
from aerobalance.recording.wording import with_u

LEAST_PROBABILITY: Final = 0.001
"""Probability of a disagreement by chance below which components are taken to differ."""

BLOCK: Final = 10_000
"""Attitudes for which uncertainties are worked out at once, so that recordings of any length fit in memory."""


def _mean_direction(attitudes: Attitudes) -> Array:
    """Mean direction of the weight over attitudes, shape (1, 3): loads are linear in it."""
    return np.asarray(np.nanmean(weight_direction(*attitudes), axis=0, keepdims=True))


@dataclass(frozen=True, slots=True)
class Agreement:
    """Test whether what was found by each component is the same for all.

    Attributes
    ----------
    chi2
        Sum of squared differences, weighted with their covariance.
    degrees_of_freedom
        Number of independent differences.
    p_value
        Probability of a chi2 as large by chance, from Fisher's distribution, because the noise comes from the
        residuals.
    """

    chi2: float
    degrees_of_freedom: int
    p_value: float

    @property
    def agree(self) -> bool:
        """Whether the differences can be chance (a probability of 0.001 or more)."""
        return self.p_value >= LEAST_PROBABILITY


@dataclass(frozen=True, slots=True, eq=False)
class MovingMass:
    """Moving mass of one force component [kg], with the offset of its reading [N] and the lean of its axis [rad].

    Attributes
    ----------
    component
        Force component that was read.
    mass, u
        Mass M and its standard uncertainty [kg].
    offset, u_offset
        Reading without weight and its standard uncertainty [N].
    misalignment, u_misalignment
        Angles by which the measuring axis leans toward the other axes (``"aft"``, ``"right"``, ``"up"``), and their
        standard uncertainties [rad]; without those that the attitudes cannot show.
    parameters, covariance
        Names of the fitted parameters and their covariance, shape (p, p), in the units above.
    residuals
        Reading less fit at every point, shape (n,) [N].
    degrees_of_freedom
        Number of points less the parameters that they went into; the uncertainties are not widened for few of them
        (multiply by the factor of Student's distribution for an interval).
    gravity
        Acceleration of gravity used [m/s^2].
    """

    component: str
    mass: float
    u: float
    offset: float
    u_offset: float
    misalignment: Mapping[str, float]
    u_misalignment: Mapping[str, float]
    parameters: tuple[str, ...]
    covariance: Array
    residuals: Array
    degrees_of_freedom: int
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        if self.component not in FORCE_AXES:
            raise ValueError(f"component must be one of {', '.join(FORCE_AXES)}, not {self.component!r}")
        for name in ("mass", "gravity"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive and finite, not {getattr(self, name)}")
        if not 0 <= self.u < np.inf:
            raise ValueError(f"u must be zero or more and finite, not {self.u}")


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """Mass [kg], centre of gravity [m], offsets [N, N*m] and misalignment [rad] of a weighing: one force or more.

    Mappings hold what was identified only; `unidentified` names the rest.

    Attributes
    ----------
    model
        Model behind `loads`: components in the order of columns; forces share one mass, and moments one centre of
        gravity, unless they disagree.
    masses
        Moving mass of every force component, found from that component (its live end and what it carries).
    mass, u_mass
        Mass common to all forces and its standard uncertainty [kg]; where the masses disagree the uncertainty is
        widened by their scatter.
    centre_of_gravity, u_centre_of_gravity
        Coordinates ``"aft"``, ``"right"``, ``"up"`` from the centre of the balance, common to all moments, and their
        standard uncertainties [m]; widened alike.
    offsets, u_offsets
        Readings without weight, by component, and their standard uncertainties [N, N*m].
    misalignment, u_misalignment
        Angles ``"pitch"`` (nose up), ``"roll"`` (right side down) and ``"yaw"`` (nose right) by which the balance is
        turned against the inclinometer, and their standard uncertainties [rad].
    mass_agreement, centre_agreement
        Whether the forces' masses, and the moments' centres of gravity, agree; None with fewer than two to compare.
    parameters, values, covariance
        Fitted parameters of `model`, k of them: names, values and covariance, shape (k, k); masses [kg], static
        moments [kg*m], offsets [N, N*m], misalignment [rad]. The covariance, and every uncertainty here, is that of
        the noise, and of what the parameters left out may have put into the others.
    left_out, assumed, absorbed
        Natural scale of every parameter that was left out (q of them), the value that it is taken to have (zero, or
        what the other components have in common), and the change of the fitted parameters by a unit of each, shape
        (k, q), in the units of `values`: what `loads` and `uncertainty` reckon with.
    residuals
        Readings less fit, shape (n, c) [N, N*m].
    deviations
        Standard deviation of the residuals by component [N, N*m].
    degrees_of_freedom
        Number of readings less number of parameters; the uncertainties are not widened for few of them.
    unidentified
        What the readings cannot tell, and what would help.
    doubts
        What the points say against the result; effects are of the mass [kg], of a force's own where the masses
        disagree.
    """

    model: WeightModel
    masses: Mapping[str, MovingMass]
    mass: float
    u_mass: float
    centre_of_gravity: Mapping[str, float]
    u_centre_of_gravity: Mapping[str, float]
    offsets: Mapping[str, float]
    u_offsets: Mapping[str, float]
    misalignment: Mapping[str, float]
    u_misalignment: Mapping[str, float]
    mass_agreement: Agreement | None
    centre_agreement: Agreement | None
    parameters: tuple[str, ...]
    values: Array
    covariance: Array
    left_out: Mapping[str, float]
    assumed: Mapping[str, float]
    absorbed: Array
    residuals: Array
    deviations: Mapping[str, float]
    degrees_of_freedom: int
    unidentified: Mapping[str, str]
    doubts: tuple[Doubt, ...] = ()

    def __post_init__(self) -> None:
        if set(self.assumed) != set(self.left_out):
            raise ValueError(f"assumed must have a value for each of {', '.join(self.left_out)}")
        if sorted((*self.parameters, *self.left_out)) != sorted(self.model.names):
            raise ValueError(
                f"parameters and left_out must together be {', '.join(self.model.names)}, each once, not "
                f"{', '.join((*self.parameters, *self.left_out))}"
            )
        count, out = len(self.parameters), len(self.left_out)
        shapes = {"values": (count,), "covariance": (count, count), "absorbed": (count, out)}
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values.shape != shape or not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite and of shape {shape}, not {values.shape}")
        if not 0 < self.mass < np.inf or not 0 <= self.u_mass < np.inf:
            raise ValueError(f"mass must be positive and finite, not {self.mass} (u {self.u_mass})")
        if not all(0 <= scale < np.inf for scale in self.left_out.values()):
            raise ValueError("the scales of what was left out must be zero or more and finite")

    def __repr__(self) -> str:
        rows = [f"mass {with_u(self.mass, self.u_mass, 'kg')}"]
        rows += [
            f"centre of gravity {axis} {with_u(value, self.u_centre_of_gravity[axis], 'm')}"
            for axis, value in self.centre_of_gravity.items()
        ]
        rows += [f"not told: {name}; {why}" for name, why in self.unidentified.items()]
        return "\n  ".join([f"weighing of {', '.join(self.components)}, {self.verdict}", *rows])

    @property
    def verdict(self) -> Verdict:
        """Whether the mass may be used, by what is doubted."""
        return verdict_of(self.doubts, {name: self._mass_behind(name) for name in self.components})

    def _mass_behind(self, component: str) -> Size:
        """The mass that the doubts of a component are about."""
        own = self.masses.get(self.model.mass_of(component).removeprefix("mass."))
        value, u = (self.mass, self.u_mass) if own is None else (own.mass, own.u)
        return Size(u, value, value)

    @property
    def components(self) -> tuple[str, ...]:
        """Components, in the order of columns."""
        return self.model.components

    @property
    def gravity(self) -> float:
        """Acceleration of gravity used [m/s^2]."""
        return self.model.gravity

    def loads(self, *, pitch: ArrayLike, roll: ArrayLike = 0.0, offsets: bool = True) -> Array:
        """Return the loads [N, N*m] of the weight at rest: the tare of a later run.

        Parameters
        ----------
        pitch, roll
            Attitudes, shape (n,) or single [rad], as the inclinometer gives them.
        offsets
            Whether to add the readings without weight; leave them out for a run that has zeros of its own.

        Returns
        -------
        numpy.ndarray
            Shape (n, c) [N, N*m].
        """
        values = self._all_values()
        if not offsets:
            values[self._offsets()] = 0.0
        return self.model.loads(np.atleast_2d(weight_direction(pitch, roll)), values)

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight along a component [N, N*m], shape (n,); gravity is that of the weighing, whatever is said."""
        return np.asarray(self.loads(pitch=pitch, roll=roll, offsets=False)[:, self.components.index(name)])

    def uncertainty(
        self, *, pitch: ArrayLike, roll: ArrayLike = 0.0, offsets: bool = True, since: Sequence[Attitudes] = ()
    ) -> Array:
        """Standard uncertainty of `loads`, from the covariance and from what was left out.

        A parameter that was left out counts as assumed give or take its natural scale, less what the others took over
        of it at the attitudes that were weighed: little at attitudes like those, its whole size elsewhere. Noise of
        the later run is not included.

        Parameters
        ----------
        pitch, roll, offsets
            As in `loads`.
        since
            Attitudes in the zeros of the later run, where those were read with the weight on: the run's loads count
            from the mean of them, and what is wrong with the weight cancels as far as the attitudes are alike.

        Returns
        -------
        numpy.ndarray
            Shape (n, c) [N, N*m].
        """
        found = [self._covariances(one) for one in self._jacobians(pitch, roll, offsets=offsets, since=since)]
        return np.asarray(np.sqrt(np.concatenate([np.diagonal(one, axis1=1, axis2=2) for one in found])))

    def correlation(
        self, *, pitch: ArrayLike, roll: ArrayLike = 0.0, offsets: bool = True, since: Sequence[Attitudes] = ()
    ) -> Array:
        """Correlation of the errors of `loads` between components, over all attitudes together, shape (c, c) [1].

        It is their mean covariance over the mean product of their standard uncertainties: forces share a mass, and
        moments a centre of gravity. Attitudes that are not known are left out.

        Parameters
        ----------
        pitch, roll, offsets, since
            As in `uncertainty`.
        """
        count = len(self.components)
        covariance, product = np.zeros((count, count)), np.zeros((count, count))
        for jacobian in self._jacobians(pitch, roll, offsets=offsets, since=since):
            here = self._covariances(jacobian[np.isfinite(jacobian).all(axis=(1, 2))])
            u = np.sqrt(np.diagonal(here, axis1=1, axis2=2))
            covariance += here.sum(axis=0)
            product += u.T @ u
        found = covariance / np.where(product > 0, product, 1.0)
        np.fill_diagonal(found, 1.0)
        return np.asarray(found)

    def _jacobians(
        self, pitch: ArrayLike, roll: ArrayLike, *, offsets: bool, since: Sequence[Attitudes]
    ) -> Iterator[Array]:
        """Derivatives of the loads by all parameters, block by block of attitudes, shape (n, c, p)."""
        values = self._all_values()
        directions = np.atleast_2d(weight_direction(pitch, roll))
        before = [self.model.jacobian(_mean_direction(attitudes), values) for attitudes in since]
        on_zero = np.mean(before, axis=0) if before else 0.0
        for first in range(0, directions.shape[0], BLOCK):
            jacobian = self.model.jacobian(directions[first : first + BLOCK], values) - on_zero
            if not offsets:
                jacobian[:, :, self._offsets()] = 0.0
            yield jacobian

    def _covariances(self, jacobian: Array) -> Array:
        """Covariance of loads with these derivatives by all parameters, (n, c, p), between components, (n, c, c)."""
        fitted = jacobian[:, :, self._places(self.parameters)]
        scales = np.array(list(self.left_out.values()))
        noise = self.covariance - (self.absorbed * scales**2) @ self.absorbed.T
        missed = (jacobian[:, :, self._places(tuple(self.left_out))] - fitted @ self.absorbed) * scales
        by_noise = fitted @ noise @ fitted.transpose(0, 2, 1)
        own = np.arange(by_noise.shape[1])
        # Rounding can take a variance of nothing below zero.
        by_noise[:, own, own] = np.maximum(by_noise[:, own, own], 0.0)
        return np.asarray(by_noise + missed @ missed.transpose(0, 2, 1))

    def _all_values(self) -> Array:
        given = {**self.assumed, **dict(zip(self.parameters, self.values, strict=True))}
        return np.array([given[name] for name in self.model.names], dtype=np.float64)

    def _places(self, names: tuple[str, ...]) -> list[int]:
        every = self.model.names
        return [every.index(name) for name in names]

    def _offsets(self) -> list[int]:
        return [place for place, name in enumerate(self.model.names) if name.startswith("offset")]


def centre_of(adjusted: Mapping[str, float], covariance: Array) -> tuple[dict[str, float], dict[str, float]]:
    """Centre of gravity and its standard uncertainties from common mass and static moments.

    Parameters
    ----------
    adjusted
        Fitted parameters of a model with one mass and one centre of gravity.
    covariance
        Their covariance, shape (k, k).

    Returns
    -------
    coordinates, uncertainties
        By axis [m].
    """
    names = list(adjusted)
    mass, place = adjusted["mass"], names.index("mass")
    coordinates, uncertainties = {}, {}
    for axis in AXES:
        name = f"moment.{axis}"
        if name in adjusted:
            coordinates[axis] = adjusted[name] / mass
            slope = np.zeros(len(names))
            slope[names.index(name)], slope[place] = 1 / mass, -coordinates[axis] / mass
            uncertainties[axis] = float(np.sqrt(slope @ covariance @ slope))
    return coordinates, uncertainties
