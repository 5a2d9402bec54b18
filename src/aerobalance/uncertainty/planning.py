"""Attainable uncertainty of the force, before the test: the Wiener bound at several bandwidths and sampling rates.

It follows from the dynamics, the noise of the sensors and the sampling rate (`aerobalance.uncertainty.wiener_bound`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.dynamics.independent import AnyDynamics, dynamics_of
from aerobalance.estimation.live.settings import LiveSettings
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.components import si_unit
from aerobalance.uncertainty.wiener_bound import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    PARAMETERS,
    Attainable,
    WienerBound,
)

OF_LOWEST: Final = (0.1, 0.2, 0.5, 0.8, 1.0)
"""Bandwidths of the table that are left to the program, as multiples of the lowest natural frequency."""

OF_HIGHEST: Final = (1.0, 1.25, 2.0, 4.0)
"""The same as multiples of the highest natural frequency."""

COMPARED_AT: Final = 1.25
"""Bandwidth at which sampling rates are compared, as a multiple of the highest natural frequency: all of that
resonance is inside."""

RATE_FACTORS: Final = (1, 2, 4, 8)
"""Sampling rates that are compared, as multiples of the planned one."""

REMEDIES: Final[Mapping[str, str]] = {
    ACCELERATION: "quieter accelerometers on the ground end, or a stiffer support",
    ANGULAR_ACCELERATION: "a quieter sensor of the ground end's rotation, or accelerometers farther apart",
    PARAMETERS: "weighing and identification with more, larger or longer releases",
}
"""What makes a contribution to the uncertainty smaller, by its name."""

QUIETER: Final = "a quieter amplifier, more excitation or a higher sampling rate"
"""What makes the contribution of the balance readings' noise smaller."""


@dataclass(frozen=True, slots=True, eq=False)
class ComponentPlan:
    """Attainable uncertainty of one component of the force.

    Attributes
    ----------
    component
        Name of the component.
    unit
        Unit of its force: N or N*m.
    natural_frequencies
        Natural frequencies of all modes of its dynamics [Hz]: of a single component its first mode first, else the
        lowest first.
    noise
        Standard uncertainty of one reading [N, N*m].
    force
        Root mean square of the force [N, N*m]; None where it is taken as strong against the noise.
    table
        Attainable uncertainty at each bandwidth.
    at_other_rates
        Attainable uncertainty up to just above the highest resonance, at 1, 2, 4 and 8 times the sampling rate, with
        the same noise per sample.
    live_lag
        Default lag of the live force behind the readings [s].
    """

    component: str
    unit: str
    natural_frequencies: tuple[float, ...]
    noise: float
    force: float | None
    table: tuple[Attainable, ...]
    at_other_rates: tuple[Attainable, ...]
    live_lag: float

    def __repr__(self) -> str:
        rows = [f"to {one.bandwidth:.4g} Hz: u = {one.total:.3g} {self.unit}" for one in self.table]
        return "\n  ".join([f"plan for {self.component}", *rows, self.advice])

    @property
    def advice(self) -> str:
        """One sentence on what limits the uncertainty up to just above resonance, and what helps against it."""
        row = self.at_other_rates[0]
        remedy = REMEDIES.get(row.limited_by, QUIETER)
        return f"{self.component} up to {row.bandwidth:.4g} Hz is limited by the {row.limited_by}: {remedy}"


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Attainable uncertainty of the force, by component.

    Attributes
    ----------
    rate
        Sampling rate [Hz].
    acceleration_noise
        Standard uncertainty of one reading of the ground end's acceleration along each axis [m/s^2].
    angular_acceleration_noise
        The same of its angular acceleration about each axis [rad/s^2].
    components
        Plan of each component.
    parameters_left_out
        Whether uncertainties of the dynamics are not counted, because their effect is in proportion to a force that is
        not given.
    """

    rate: float
    acceleration_noise: float
    angular_acceleration_noise: float
    components: Mapping[str, ComponentPlan]
    parameters_left_out: bool

    def __repr__(self) -> str:
        return "\n".join([f"at {self.rate:.6g} Hz", *(repr(one) for one in self.components.values())])

    def __getitem__(self, component: str) -> ComponentPlan:
        """Plan of one component."""
        return self.components[component]


@one_blas_thread()
def plan(
    dynamics: AnyDynamics,
    *,
    rate: float,
    noise: float | Mapping[str, float],
    acceleration_noise: float = 0.0,
    angular_acceleration_noise: float = 0.0,
    force: float | Mapping[str, float] | None = None,
    bandwidths: Sequence[float] = (),
) -> Plan:
    """Return the attainable standard uncertainty of the force, by bandwidth and sampling rate [N, N*m].

    Parameters
    ----------
    dynamics
        Dynamics of the balance with its model: one component, several that are not coupled, or coupled ones.
    rate
        Sampling rate [Hz].
    noise
        Standard uncertainty of one reading of the load [N, N*m], by component where there are several.
    acceleration_noise
        Standard uncertainty of one reading of the ground end's acceleration, along each axis [m/s^2].
    angular_acceleration_noise
        Standard uncertainty of one reading of its angular acceleration, about each axis [rad/s^2]; for coupled
        dynamics, which know the moving mass as a rigid body.
    force
        Root mean square of the force, spread evenly up to the bandwidth [N, N*m]; by component where there are
        several. If left out, the force is taken as strong against the noise, and the parameters of the dynamics as
        known exactly.
    bandwidths
        Highest frequencies of the force, one for each row of the table [Hz]; if left out, some below, between and
        above the natural frequencies.

    Raises
    ------
    ValueError
        An argument is out of range or not given for every component, or the noise of the ground end is given and the
        dynamics do not know the mass that it acts on.
    """
    _check_positive(rate, "rate")
    for name, value in (
        ("acceleration_noise", acceleration_noise),
        ("angular_acceleration_noise", angular_acceleration_noise),
    ):
        if not 0 <= value < np.inf:
            raise ValueError(f"{name} must be zero or more, not {value:g}")
    for bandwidth in bandwidths:
        if not 0 < bandwidth <= rate / 2:
            raise ValueError(
                f"bandwidth must lie between 0 and half the sampling rate ({rate / 2:g} Hz), not {bandwidth:g}"
            )
    model = dynamics_of(dynamics)
    noises = _by_component(noise, model.components, "noise")
    forces = None if force is None else _by_component(force, model.components, "force")
    found: dict[str, ComponentPlan] = {}
    for block in model.blocks:
        bound = WienerBound.of(
            block,
            noise=noises,
            acceleration_noise=acceleration_noise,
            angular_acceleration_noise=angular_acceleration_noise,
        )
        found |= _planned(bound, forces, rate=rate, bandwidths=bandwidths)
    uncertain = bool(model.covariance.any())
    return Plan(rate, acceleration_noise, angular_acceleration_noise, found, uncertain and force is None)


def _check_positive(value: float, name: str) -> None:
    if not 0 < value < np.inf:
        raise ValueError(f"{name} must be positive, not {value:g}")


def _by_component(given: float | Mapping[str, float], names: Sequence[str], what: str) -> dict[str, float]:
    """Return one positive number for every component; `what` names it in messages."""
    if not isinstance(given, Mapping):
        if len(names) > 1:
            raise ValueError(f"{what} must be given by component, for {', '.join(names)}, not as one number")
        given = dict.fromkeys(names, given)
    lacking = [name for name in names if name not in given]
    if lacking:
        raise ValueError(f"{what} of {', '.join(lacking)} is missing; it is given for {', '.join(given) or 'none'}")
    for name in names:
        _check_positive(given[name], f"{what} of {name}")
    return {name: float(given[name]) for name in names}


def _planned(
    bound: WienerBound, force: Mapping[str, float] | None, *, rate: float, bandwidths: Sequence[float]
) -> dict[str, ComponentPlan]:
    """Return the plans of the components of one block: one alone, or all that are coupled with each other."""
    dynamics = bound.dynamics
    modes = tuple(mode.natural_frequency for mode in dynamics.modes)
    chosen = tuple(bandwidths) or _usual_bandwidths(modes, rate)
    compared_at = min(COMPARED_AT * max(modes, default=np.inf), rate / 2)
    table = [bound.attainable(force, bandwidth=bandwidth, rate=rate) for bandwidth in chosen]
    at_other_rates = [bound.attainable(force, bandwidth=compared_at, rate=factor * rate) for factor in RATE_FACTORS]
    live, slowest_mode = LiveSettings(), min(modes, default=0.0)
    noise = np.diag([bound.noise[name] ** 2 for name in dynamics.components])
    channels = [dynamics.decoupled(name, noise=noise).dynamics for name in dynamics.components]
    return {
        name: ComponentPlan(
            component=name,
            unit=si_unit(name),
            natural_frequencies=modes,
            noise=bound.noise[name],
            force=None if force is None else force[name],
            table=tuple(rows[place] for rows in table),
            at_other_rates=tuple(rows[place] for rows in at_other_rates),
            live_lag=live.time_behind(channels[place].natural_frequency, slowest_mode=slowest_mode),
        )
        for place, name in enumerate(dynamics.components)
    }


def _usual_bandwidths(natural_frequencies: Sequence[float], rate: float) -> tuple[float, ...]:
    """Return bandwidths below, between and above natural frequencies, up to half the sampling rate [Hz]."""
    chosen: set[float] = set()
    if natural_frequencies:
        low, high = min(natural_frequencies), max(natural_frequencies)
        chosen = {*(part * low for part in OF_LOWEST), *(part * high for part in OF_HIGHEST)}
        if low < high:
            chosen.add(float(np.sqrt(low * high)))
    return (*sorted(bandwidth for bandwidth in chosen if bandwidth < rate / 2), rate / 2)
