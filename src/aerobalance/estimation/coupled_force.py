"""From the loads felt to the forces and moments applied, where the components ring together.

Eq. (17) of [Gorbushin2020]_ with matrices, F = X + D X' + A X'' - W + M x1''. Every component is taken apart from the
others (`aerobalance.dynamics.decoupling`) and then worked out as one component is: same estimator, same steps, same
warnings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.correlated_noise import NoiseMatrix, SharedNoise, as_expected, shared_noise
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.decoupled_record import LoneJob, load_felt, mass_rows
from aerobalance.estimation.force import Fitted, Method, by_smoother, estimated, noise_of_job
from aerobalance.estimation.record import ForceEstimate
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import align_channels, interpolate_gaps

PASSES: Final = 2
"""Most times that gaps are filled anew by what the forces found make the balance read."""

SETTLED: Final = 5.0
"""Change of what fills a gap, over the noise of a reading, which no force would notice."""


def reconstruct_coupled(
    recording: Recording,
    dynamics: CoupledDynamics,
    *,
    method: Method = "smoother",
    bandwidth: float | None = None,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
    hum: Hum = "mains",
    noise: Mapping[str, NoiseSpectrum] | None = None,
) -> dict[str, ForceEstimate]:
    """Work out the forces and moments applied; the settings are those of `aerobalance.estimation.force.reconstruct`.

    Parameters
    ----------
    recording
        Loads felt of all components, and the ground's motion and attitude where they are recorded.
    dynamics
        Inertia and damping of the components, with their covariance, and the moving mass.
    noise
        Spectra of the noise of the components taken apart, as `noise_of_coupled` finds them for this recording.

    Returns
    -------
    estimates
        By component, in the order of the dynamics.

    Raises
    ------
    FitError
        A component that the others ring with is not in the recording, or the recording is too short.
    """
    record = CoupledRecord.of(recording, dynamics, gravity=gravity, gravity_uncertainty=gravity_uncertainty)
    if not by_smoother(method=method, bandwidth=bandwidth):
        inverse = partial(estimated, method=method, bandwidth=bandwidth, hum=hum)
        return _with_gaps_filled(record, inverse, lambda one: (one.values, one.noise), noises=noise)[0]
    fitted = partial(Fitted.of, hum=hum)
    fits, filled = _with_gaps_filled(
        record, fitted, lambda fit: (fit.smoothed.force, fit.apart.learned.noise), noises=noise
    )
    for name, shared in noise_shared(fits, record, filled=filled).items():
        job = record.job(name, filled, shared=shared)
        if as_expected(job.reading(), fits[name].apart.learned):
            fits[name] = fitted(job)
    return {name: fit.estimate() for name, fit in fits.items()}


Answer = TypeVar("Answer")


def _with_gaps_filled(
    record: CoupledRecord,
    work: Callable[[LoneJob], Answer],
    known: Callable[[Answer], tuple[Array, float]],
    *,
    noises: Mapping[str, NoiseSpectrum] | None,
) -> tuple[dict[str, Answer], Array]:
    """Answers by component, and the readings with what the forces found put into their gaps.

    Parameters
    ----------
    record
        The record.
    work
        Makes an answer of a component taken apart.
    known
        Force and noise of a reading, of an answer.
    noises
        Spectra of the noise of the components taken apart, where they are known.
    """
    filled = interpolate_gaps(record.loads)
    found = {name: work(job) for name, job in record.jobs(filled, noises=noises).items()}
    for _ in range(PASSES if record.has_gaps else 0):
        facts = {name: known(one) for name, one in found.items()}
        better = filled_by({name: force for name, (force, _) in facts.items()}, record, filled=filled)
        if (np.abs(better - filled) < SETTLED * np.array([noise for _, noise in facts.values()])).all():
            break
        filled = better
        found = {name: work(job) for name, job in record.jobs(filled, noises=noises).items()}
    return found, filled


def noise_shared(fits: Mapping[str, Fitted], record: CoupledRecord, *, filled: Array) -> dict[str, SharedNoise]:
    """Noise of components that others show, by component; only of those whose force is the better for it.

    Parameters
    ----------
    fits
        What each component's reading gives by itself.
    record, filled
        As in `filled_by`.
    """
    learned = [fit.apart.learned for fit in fits.values()]
    if not record.rings_together or any(one.color is not None for one in learned):
        return {}
    mass = mass_rows(record.dynamics)
    spectra = NoiseMatrix.of(
        record.lones,
        learned,
        interval=record.interval,
        noise=record.noise,
        ground=mass @ record.platform.covariance @ mass.T,
    )
    residuals = np.column_stack([fit.smoothed.residuals for fit in fits.values()])
    present = np.column_stack([np.isfinite(record.loads[:, lone.partners]).all(axis=1) for lone in record.lones])
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


def noise_of_coupled(
    calm: Recording,
    dynamics: CoupledDynamics,
    *,
    run: Recording,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
) -> dict[str, NoiseSpectrum]:
    """Spectra of the noise of the components taken apart, from a record of noise alone: wind off, balance at rest.

    What a component taken apart has of noise is what its balance makes of the noise of all channels that have a part
    in it. So the record of noise goes through the very balances that the run is taken apart with, which depend on the
    white noise of the run's channels, and the spectrum is learned from what they read.

    Parameters
    ----------
    calm
        The record of noise, with the sampling rate, gains and filters of the run.
    dynamics
        The coupled components.
    run
        The recording that the spectra are for.
    gravity, gravity_uncertainty
        Local acceleration of gravity and its standard uncertainty [m/s^2].

    Raises
    ------
    FitError
        A recording lacks a component or is too short, or the record of noise shows none.
    """
    settings = {"gravity": gravity, "gravity_uncertainty": gravity_uncertainty}
    noise = CoupledRecord.of(run, dynamics, **settings).noise
    record = CoupledRecord.of(calm, dynamics, **settings).taken_with(dynamics, noise=noise)
    return {name: noise_of_job(job) for name, job in record.jobs(interpolate_gaps(record.loads)).items()}


def filled_by(forces: Mapping[str, Array], record: CoupledRecord, *, filled: Array) -> Array:
    """Readings with their gaps filled by what forces make the balance read, shape (samples, n).

    Parameters
    ----------
    forces
        The forces of all components, shape (samples,) each.
    record
        The record.
    filled
        The readings with what the gaps were filled with before, shape (samples, n).
    """
    present = np.isfinite(record.loads)
    force = np.column_stack([forces[name] for name in record.dynamics.components])
    felt = load_felt(record.dynamics, force, interval=record.interval) + record.from_ground
    left = _free_motion(record.dynamics, filled - felt, present, interval=record.interval)
    return np.where(present, record.loads, felt + left)


def _free_motion(dynamics: CoupledDynamics, left: Array, present: NDArray[np.bool_], *, interval: float) -> Array:
    """Free motion of the balance that explains best what is left of the readings, shape (samples, n)."""
    poles, shapes, _ = dynamics.modal_form
    up = poles.imag >= 0
    time = np.arange(left.shape[0]) * interval
    columns = []
    for pole, shape in zip(poles[up], shapes.T[up], strict=True):
        swing = np.exp(pole * time)[:, None] * shape
        columns += [swing.real, swing.imag]
    size = np.maximum(left.std(axis=0), 1e-60)
    basis = np.stack([column / size for column in columns], axis=-1)
    found, *_ = np.linalg.lstsq(basis[present], (left / size)[present], rcond=1e-10)
    return np.asarray(basis @ found * size)
