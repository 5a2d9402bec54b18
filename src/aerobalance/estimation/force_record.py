"""The loads of a run or of a part of one, ready for the estimator: with dynamics and the motion of the ground."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from aerobalance.balance.loads import Loads
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import AnyDynamics, IndependentDynamics, dynamics_of
from aerobalance.estimation.checks.impossible_channels import impossible_channels
from aerobalance.estimation.checks.outliers import without_wild_samples
from aerobalance.estimation.component_force import noise_of_component
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.forces import ForceRecord, ForceSettings
from aerobalance.estimation.independent_record import IndependentRecord
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.estimation.working_record import WorkingPart, unfiltered_part
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY, loads_hint
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps

SAME_WEIGHT: Final = 1e-3
"""Difference of two weights, over the largest, that attitudes which are averaged may make."""


class ReadyRecord(NamedTuple):
    """The readings of a run or of a part of one, ready for the estimator.

    Attributes
    ----------
    given
        The readings, filters of their channels undone and wild samples left out.
    record
        The same with dynamics and the motion of the ground.
    seen
        Doubts about their channels and samples.
    """

    given: Recording | Loads
    record: ForceRecord
    seen: tuple[Doubt, ...]

    @classmethod
    def of(cls, read: WorkingPart, model: BalanceDynamics, settings: ForceSettings) -> ReadyRecord:
        """Return readings made ready.

        Raises
        ------
        FitError, ValueError
            As in `force_record`.
        """
        given, wanted = read.given, read.own
        if isinstance(given, Recording) and given.from_outputs:
            warn_quality(
                f"{given.name}: the loads were worked out from gauge outputs, and the errors of the balance matrix "
                "are not in the uncertainty: give the loads as reduce_outputs returns them, not their recording alone"
            )
        seen = impossible_channels(read.wanted, model)
        if not settings.keep_outliers:
            given, wild = without_wild_samples(given, model.components, own=wanted)
            seen += wild
        if wanted is not None:
            given = unfiltered_part(given, wanted)
        return cls(given, force_record(given, model, **settings.earth), seen + read.doubts)


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
        raise FitError(
            f"{run.name} has none of the components of the dynamics, {', '.join(model.components)}; it has "
            f"{', '.join(run.channels) or 'no channels'}{loads_hint(run.channels)}"
        )
    settings = {"gravity": gravity, "gravity_uncertainty": gravity_uncertainty}
    if isinstance(model, CoupledDynamics):
        return CoupledRecord.of(run, model, noise=noise, **settings)
    if isinstance(model, IndependentDynamics):
        return IndependentRecord.of(run, model, **settings)
    raise AssertionError


def _noise_of(loads: Loads, model: BalanceDynamics) -> Array | None:
    """Covariance of the noise of a model's components, shape (n, n); None where the loads lack one or its noise."""
    if any(name not in loads.components for name in model.components):
        return None
    place = [loads.components.index(name) for name in model.components]
    found = loads.noise_covariance[np.ix_(place, place)]
    return found if np.diag(found).all() else None


def _check_mass(loads: Loads, model: BalanceDynamics) -> None:
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
    records = record.with_noise(run.noise).component_records(interpolate_gaps(record.loads))
    lacking = [name for name in run.dynamics.components if name not in records]
    if lacking:
        raise FitError(
            f"{record.recording.name}: has no {', '.join(lacking)}, and the noise of each component worked out "
            "is needed; record it too, or work out the others by themselves"
        )
    return {name: noise_of_component(component) for name, component in records.items()}
