r"""From the gauge outputs or balance loads of a run to the forces and moments applied, Eq. (17) of [Gorbushin2020]_.

With several components it is F = X + D X' + A X'' - W + M x1''. Where they are coupled, each is decoupled from the
others (`aerobalance.dynamics.decoupling`) and then worked out as one component is: same estimator, same steps, same
warnings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.calibration_nonlinearity import NonlinearErrors
from aerobalance.balance.loads import Loads, static_uncertainty
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.reduction import reduce_outputs
from aerobalance.balance.zeros import Zero
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import AnyDynamics, IndependentDynamics, dynamics_of
from aerobalance.estimation.component_force import Fitted, Method, by_smoother, estimated, noise_of_component
from aerobalance.estimation.correlated_noise import NoiseMatrix, SharedNoise, as_expected, shared_noise
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.decoupled_record import mass_rows
from aerobalance.estimation.display import html, plot, summary, to_dataframe, to_xarray
from aerobalance.estimation.record import ComponentRecord, IndependentRecord
from aerobalance.estimation.result import ComponentForce, with_balance
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY, is_gauge
from aerobalance.recording.errors import GAUGES_BECOME_LOADS, FitError, warn_quality
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import align_channels, interpolate_gaps

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

PASSES: Final = 2
"""Most times that gaps are filled anew by what the forces found make the balance read."""

SETTLED: Final = 5.0
"""Change of what fills a gap, over the noise of a reading, which no force would notice."""

SAME_WEIGHT: Final = 1e-3
"""Difference of two weights, over the largest, that attitudes which are averaged may make."""

ForceRecord = IndependentRecord | CoupledRecord
"""A recording with the dynamics of its components, made ready for the estimator."""


@dataclass(frozen=True, slots=True)
class ForceSettings:
    """How a force is worked out.

    Attributes
    ----------
    method
        ``"smoother"``: the optimal estimator. ``"paper"``: three-point central differences.
    bandwidth
        If given, the inverse limited to this band [Hz], zero phase, whichever the method.
    gravity, gravity_uncertainty
        Local acceleration of gravity and its standard uncertainty [m/s^2].
    hum
        What the smoother takes for hum and not for force: ``"mains"`` steady lines at 50 or 60 Hz and harmonics that
        stand out of the reading (with a warning that names them), ``"keep"`` none, or lines near given frequencies
        [Hz].
    """

    method: Method = "smoother"
    bandwidth: float | None = None
    gravity: float = STANDARD_GRAVITY
    gravity_uncertainty: float = 0.0
    hum: Hum = "mains"


@dataclass(frozen=True, slots=True, eq=False)
class Force(Mapping[str, ComponentForce]):
    """The forces and moments applied, by component, with what they were worked out from.

    ``force["NF"].values`` and ``force["NF"].uncertainty`` are the force and its standard uncertainty [N].

    Attributes
    ----------
    parts
        The force of each component.
    record
        The balance loads, with the dynamics and the motion of the ground that go with them.
    settings
        How the forces were worked out.
    loads
        The loads with their matrix, where they come from gauge outputs; None where loads were given.
    noises
        Spectra of the noise of the components' readings, where a record of noise was given.
    """

    parts: Mapping[str, ComponentForce]
    record: ForceRecord
    settings: ForceSettings = field(default_factory=ForceSettings)
    loads: Loads | None = None
    noises: Mapping[str, NoiseSpectrum] = field(default_factory=dict)

    def __getitem__(self, component: str) -> ComponentForce:
        return self.parts[component]

    def __iter__(self) -> Iterator[str]:
        return iter(self.parts)

    def __len__(self) -> int:
        return len(self.parts)

    def to_dataframe(self) -> pd.DataFrame:
        """Forces and their standard uncertainties, ``NF`` and ``u_NF`` [N, N*m], over the time [s]."""
        return to_dataframe(self, self.recording)

    def to_xarray(self) -> xr.Dataset:
        """Forces and their standard uncertainties, ``NF`` and ``u_NF``, along ``time`` [s], with their units."""
        return to_xarray(self, self.recording)

    def plot(self) -> Figure:
        """Figure of the forces with bands of 95 %, above the balance loads; one component below the other."""
        return plot(self, self.recording)

    def __repr__(self) -> str:
        return summary(self, self.recording)

    def _repr_html_(self) -> str:
        return html(self, self.recording)

    @property
    def only(self) -> ComponentForce:
        """The force of the one component there is.

        Raises
        ------
        ValueError
            There are several.
        """
        if len(self.parts) != 1:
            raise ValueError(f'there are several components, {", ".join(self.parts)}: name one, as in force["NF"]')
        return next(iter(self.parts.values()))

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the n components."""
        return tuple(self.parts)

    @property
    def recording(self) -> Recording:
        """The run with its balance loads: clock, motion and attitude."""
        return self.record.recording

    @property
    def dynamics(self) -> IndependentDynamics | CoupledDynamics:
        """The dynamics that the forces were worked out with."""
        return self.record.dynamics

    @property
    def filled(self) -> Array:
        """Readings of the components with their gaps filled by what the forces make the balance read, (samples, n)."""
        filled = interpolate_gaps(self.record.loads)
        if not self.record.has_gaps:
            return filled
        return self.record.filled_by({name: one.values for name, one in self.parts.items()}, filled=filled)


def estimate_force(
    run: Recording | Loads,
    dynamics: AnyDynamics,
    *,
    balance: BalanceMatrix | Calibration | None = None,
    zero: Zero | None = None,
    noise: Recording | Loads | Mapping[str, NoiseSpectrum] | None = None,
    method: Method = "smoother",
    bandwidth: float | None = None,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
    hum: Hum = "mains",
) -> Force:
    """Forces and moments applied [N, N*m], Eq. (17) of [Gorbushin2020]_, with a standard uncertainty of every sample.

    Parameters
    ----------
    run
        Balance loads, and ground acceleration and attitude where they are recorded; or with `balance` gauge outputs.
        Loads that were worked out from gauge outputs are given as `Loads`, which hold the matrix and its errors.
    dynamics
        Mass, stiffness and damping of one component or of several, or coupled dynamics, with their covariance.
    balance, zero
        Where gauge outputs are given: the balance matrix or its calibration, and the zero that they count from.
    noise
        A record of noise alone (wind off, balance at rest) with the sampling rate, gains and filters of the run, or
        spectra by component as `noise_spectra` finds them. Without one the noise is taken as white, but for what the
        run itself shows far above the natural frequency.
    method, bandwidth, gravity, gravity_uncertainty, hum
        See `ForceSettings`.

    Raises
    ------
    FitError
        The run has none of the components, lacks one that the others are coupled with, is too short, or has missing
        samples that the method cannot bridge; or the noise was recorded at another sampling rate.
    ValueError
        A setting is not allowed, or the loads count from the weight of the model and do not say what it is.
    """
    settings = ForceSettings(method, bandwidth, gravity, gravity_uncertainty, hum)
    model = dynamics_of(dynamics)

    def made_ready(given: Recording | Loads) -> Recording | Loads:
        if balance is None or isinstance(given, Loads):
            return given
        return reduce_outputs(given, balance, zero=zero, model=model, gravity=gravity)

    if balance is None and zero is not None:
        raise ValueError("a zero is of gauge outputs: give the balance matrix that makes loads of them as well")
    given = made_ready(run)
    if isinstance(given, Recording) and given.from_outputs:
        warn_quality(
            f"{given.name}: the loads were worked out from gauge outputs, and the errors of the balance matrix are "
            "not in the uncertainty: give the loads as reduce_outputs returns them, not their recording alone"
        )
    record = force_record(given, model, gravity=gravity, gravity_uncertainty=gravity_uncertainty)
    if isinstance(noise, Recording | Loads):
        noise = noise_spectra(made_ready(noise), record, gravity=gravity, gravity_uncertainty=gravity_uncertainty)
    noises = {} if noise is None else noise
    parts = _forces(record, settings, noises=noises)
    if isinstance(given, Loads):
        parts = _with_matrix(parts, given, model)
    return Force(parts, record, settings, given if isinstance(given, Loads) else None, noises)


def force_record(
    run: Recording | Loads,
    dynamics: AnyDynamics,
    *,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
) -> ForceRecord:
    """The balance loads [N, N*m] of a run with dynamics and the motion of the ground, ready for the estimator.

    Raises
    ------
    FitError
        The run has none of the components, lacks one that the others are coupled with, or is too short.
    ValueError
        The loads count from the weight of a model and do not say what it is.
    """
    model, noise = dynamics_of(dynamics), None
    if isinstance(run, Loads):
        run.check_ready()
        _check_mass(run, model)
        noise = _noise_of(run, model)
        run = run.recording
    if not any(name in run for name in model.components):
        gauges = any(is_gauge(name) for name in run.channels)
        raise FitError(
            f"{run.name} has none of the components of the dynamics, {', '.join(model.components)}; it has "
            f"{', '.join(run.channels) or 'no channels'}" + (f"; {GAUGES_BECOME_LOADS}" if gauges else "")
        )
    settings = {"gravity": gravity, "gravity_uncertainty": gravity_uncertainty}
    if isinstance(model, CoupledDynamics):
        return CoupledRecord.of(run, model, noise=noise, **settings)
    return IndependentRecord.of(run, model, **settings)


def _noise_of(loads: Loads, model: IndependentDynamics | CoupledDynamics) -> Array | None:
    """Covariance of the noise of a model's components, shape (n, n); None where the loads lack one or its noise."""
    if any(name not in loads.components for name in model.components):
        return None
    place = [loads.components.index(name) for name in model.components]
    found = loads.noise_covariance[np.ix_(place, place)]
    return found if np.diag(found).all() else None


def _check_mass(loads: Loads, model: IndependentDynamics | CoupledDynamics) -> None:
    """Refuse loads whose zero was read under the weight of another mass than the dynamics have."""
    put_back, gravity = loads.zero.weight, loads.zero.pull.acceleration
    size = float(np.linalg.norm(gravity))
    if not put_back.any() or size == 0:
        return
    aft, right, up = (float(gravity[COMPONENTS.index(name)]) for name in ("AF", "SF", "NF"))
    pitch, roll = np.array([np.arcsin(aft / size)]), np.array([np.arctan2(right, -up)])
    for name in model.components:
        own = float(model.weight(name, pitch=pitch, roll=roll, gravity=size)[0])
        there = float(put_back[COMPONENTS.index(name)])
        if abs(own - there) > SAME_WEIGHT * float(np.max(np.abs(put_back))):
            raise ValueError(
                f"{loads.recording.name}: the zero of these loads was taken to hold a weight of {there:.5g} along "
                f"{name}, and these dynamics weigh {own:.5g}; work the loads out with the same dynamics as their model"
            )


def noise_spectra(
    calm: Recording | Loads,
    run: ForceRecord,
    *,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
) -> dict[str, NoiseSpectrum]:
    """Spectra of the noise of the components' readings [N^2/Hz], from a record of noise alone: wind off, at rest.

    The noise of a decoupled component is what its balance makes of the noise of all channels that have a part in it.
    So the record of noise goes through the very balances that the run is decoupled with, which depend on the white
    noise of the run's channels, and the spectrum is learned from what they read.

    Parameters
    ----------
    calm
        The record of noise, with the sampling rate, gains and filters of the run. The load that a recorded motion of
        the ground has put on it is taken off.
    run
        The run that the spectra are for.
    gravity, gravity_uncertainty
        Local acceleration of gravity and its standard uncertainty [m/s^2].

    Raises
    ------
    FitError
        The record lacks a component, is too short, or shows no noise.
    """
    record = force_record(calm, run.dynamics, gravity=gravity, gravity_uncertainty=gravity_uncertainty)
    if isinstance(record, CoupledRecord) and isinstance(run, CoupledRecord):
        record = record.taken_with(record.dynamics, noise=run.noise)
    return {
        name: noise_of_component(component)
        for name, component in record.component_records(interpolate_gaps(record.loads)).items()
    }


def _with_matrix(
    parts: Mapping[str, ComponentForce], loads: Loads, dynamics: IndependentDynamics | CoupledDynamics
) -> dict[str, ComponentForce]:
    """Return the forces with the errors of the balance matrix in their uncertainty."""
    static = static_uncertainty(loads, forces={name: found.values for name, found in parts.items()})
    highest = max(found.bandwidth for found in parts.values())
    curvature = NonlinearErrors.of(loads, rate=loads.recording.rate, highest=highest)
    order = [dynamics.components.index(name) for name in parts]
    inverse = dynamics.inverse_response(curvature.resolved)[:, order][:, :, order]
    densities = curvature.in_force(inverse - np.eye(len(order)), list(parts))
    return {
        name: with_balance(
            found,
            np.hypot(static[name], curvature.offset(name)),
            curvature=curvature.as_noise(density, bandwidth=found.bandwidth),
        )
        for (name, found), density in zip(parts.items(), densities.T, strict=True)
    }


def _forces(
    record: ForceRecord, settings: ForceSettings, *, noises: Mapping[str, NoiseSpectrum]
) -> dict[str, ComponentForce]:
    """The forces of all components of a record."""
    if not by_smoother(method=settings.method, bandwidth=settings.bandwidth):
        inverse = partial(estimated, method=settings.method, bandwidth=settings.bandwidth, hum=settings.hum)
        return _with_gaps_filled(record, inverse, lambda one: (one.values, one.noise), noises=noises)[0]
    fitted = partial(Fitted.of, hum=settings.hum)
    fits, filled = _with_gaps_filled(
        record, fitted, lambda fit: (fit.smoothed.force, fit.signal.learned.noise), noises=noises
    )
    for name, shared in predicted_noise(fits, record, filled=filled).items():
        component = record.component_record(name, filled, shared=shared)
        if as_expected(component.reading(), fits[name].signal.learned):
            fits[name] = fitted(component)
    return {name: fit.estimate() for name, fit in fits.items()}


Answer = TypeVar("Answer")


def _with_gaps_filled(
    record: ForceRecord,
    work: Callable[[ComponentRecord], Answer],
    known: Callable[[Answer], tuple[Array, float]],
    *,
    noises: Mapping[str, NoiseSpectrum] | None,
) -> tuple[dict[str, Answer], Array]:
    """Return answers by component, and the readings with their gaps filled by what the forces found make them.

    Parameters
    ----------
    record
        The record.
    work
        Makes an answer of a decoupled component.
    known
        Force and noise of a reading, of an answer.
    noises
        Spectra of the noise of the decoupled components, where they are known.
    """
    filled = interpolate_gaps(record.loads)
    found = {name: work(component) for name, component in record.component_records(filled, noises=noises).items()}
    for _ in range(PASSES if record.has_gaps else 0):
        facts = {name: known(one) for name, one in found.items()}
        better = record.filled_by({name: force for name, (force, _) in facts.items()}, filled=filled)
        if (np.abs(better - filled) < SETTLED * np.array([noise for _, noise in facts.values()])).all():
            break
        filled = better
        found = {name: work(component) for name, component in record.component_records(filled, noises=noises).items()}
    return found, filled


def predicted_noise(fits: Mapping[str, Fitted], record: ForceRecord, *, filled: Array) -> dict[str, SharedNoise]:
    """Return the noise that other components predict, by component; only where the force is the better for it [N].

    Parameters
    ----------
    fits
        What each component's reading gives by itself.
    record, filled
        As in `filled_by`.
    """
    learned = [fit.signal.learned for fit in fits.values()]
    if isinstance(record, IndependentRecord) or not record.is_coupled:
        return {}
    if any(one.color is not None for one in learned):
        return {}
    mass = mass_rows(record.dynamics)
    spectra = NoiseMatrix.of(
        record.decoupled,
        learned,
        interval=record.interval,
        noise=record.noise,
        ground=mass @ record.platform.covariance @ mass.T,
    )
    residuals = np.column_stack([fit.smoothed.residuals for fit in fits.values()])
    present = np.column_stack([np.isfinite(record.loads[:, one.partners]).all(axis=1) for one in record.decoupled])
    shared = {}
    for place, channel in enumerate(record.channels):
        one = shared_noise(
            spectra,
            place,
            residuals=align_channels(residuals, record.channels, to=channel, interval=record.interval),
            present=present,
            readings=partial(record.reading, on_clock_of=place, filled=filled),
        )
        if one is not None:
            shared[channel.name] = one
    return shared
