"""The forces along all components of a record that has been made ready, worked out at once.

Where components are coupled, gaps are filled by what the forces make the balance read, and noise that others show is
taken off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Generic, NamedTuple, TypeVar

import numpy as np

from aerobalance.balance.calibration_nonlinearity import NonlinearErrors
from aerobalance.balance.loads import Loads, static_uncertainty
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.estimation.checks.ground_alignment import alone
from aerobalance.estimation.checks.ground_channels import NO_FINDINGS, GroundFindings, ground_findings
from aerobalance.estimation.checks.ground_witnesses import Witness, Witnesses
from aerobalance.estimation.component_force import Fitted, Method, by_smoother, estimated
from aerobalance.estimation.correlated_noise import (
    FREQUENCIES,
    WORTHWHILE,
    NoiseMatrix,
    SharedNoise,
    as_expected,
    shared_noise,
)
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.gap_levels import changed_in_gaps
from aerobalance.estimation.independent_record import IndependentRecord, moves_along_axis
from aerobalance.estimation.missing_readings import MissingReadings, filled_error
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.result import ComponentForce, with_balance, with_errors, with_few
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.resampling import align_channels, interpolate_gaps
from aerobalance.recording.side_by_side import both, side_by_side

PASSES: Final = 2
"""Most times that gaps are filled anew by what the forces found make the balance read."""

SETTLED: Final = 5.0
"""Change of what fills a gap, over the noise of a reading, which no force would notice."""


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
    keep_outliers
        Whether single samples that are far from their neighbours are taken as they are, and not for missing.
    align
        Whether accelerometer and inclinometer are brought to the delay and the gain that the load shows of the motion,
        whose uncertainties then count; of components that are not coupled, by the smoother. A force that goes with the
        motion is then taken for a fault of the channel.
    """

    method: Method = "smoother"
    bandwidth: float | None = None
    gravity: float = STANDARD_GRAVITY
    gravity_uncertainty: float = 0.0
    hum: Hum = "mains"
    keep_outliers: bool = False
    align: bool = False

    @property
    def earth(self) -> dict[str, float]:
        """The acceleration of gravity and its uncertainty, by name."""
        return {"gravity": self.gravity, "gravity_uncertainty": self.gravity_uncertainty}


def with_matrix(
    parts: Mapping[str, ComponentForce], loads: Loads, dynamics: BalanceDynamics
) -> dict[str, ComponentForce]:
    """Return the forces with the errors of the balance matrix in their uncertainty."""
    highest = max(found.bandwidth for found in parts.values())
    work = (
        partial(static_uncertainty, loads, forces={name: found.values for name, found in parts.items()}),
        partial(NonlinearErrors.of, loads, rate=loads.recording.rate, highest=highest),
    )
    static, curvature = both(*work)
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


def forces_of(
    record: ForceRecord,
    settings: ForceSettings,
    *,
    noises: Mapping[str, NoiseSpectrum],
    few: bool,
) -> dict[str, ComponentForce]:
    """The forces of all components of a record; if `few`, what holds along it is as few numbers as show."""
    if not by_smoother(method=settings.method, bandwidth=settings.bandwidth):
        inverse = partial(estimated, method=settings.method, bandwidth=settings.bandwidth, hum=settings.hum)
        found = _with_gaps_filled(record, inverse, lambda one: (one.values, one.noise), noises=noises).answers
        return {name: with_few(one) if few else one for name, one in found.items()}
    fitted = partial(Fitted.of, hum=settings.hum, align=settings.align)
    missing: MissingReadings | None = None
    moved: Mapping[str, Array] = {}
    with PROGRESS.stage(0.0, 0.5, "spectrum and steps"):
        if record.has_gaps and MissingReadings.are_few(record):
            fits, filled, missing = _with_gaps_found(record, fitted, noises=noises)
        else:
            fits, filled, moved = _with_gaps_filled(
                record, fitted, lambda fit: (fit.smoothed.force, fit.signal.learned.noise), noises=noises
            )

    def anew(name: str) -> Fitted:
        component = record.component_record(name, filled, shared=better[name])
        return fitted(component) if as_expected(component.reading(), fits[name].signal.learned) else fits[name]

    # before noise is taken off that others show: what is left of the motion is in the others as well
    with PROGRESS.stage(0.5, 0.55, "ground channels"):
        ground = _ground_findings(fits, record)

    with PROGRESS.stage(0.55, 0.85, "noise that is shared"):
        better = predicted_noise(fits, record, filled=filled)
        fits |= dict(zip(better, side_by_side(anew, better, what="component"), strict=True))

    def estimated_with(name: str) -> ComponentForce:
        fit = fits.pop(name)
        found = fit.estimate(few=few, ground=ground.pop(name, NO_FINDINGS))
        lost = ~fit.signal.reading.present
        if record.has_gaps:
            lost |= ~np.isfinite(record.loads).all(axis=1)
        # when a sudden force came in a gap is not known
        errors, steps = changed_in_gaps(found.values, found.steps, lost, fit.record.dynamics, interval=record.interval)
        if errors:
            found = replace(with_errors(found, *errors), steps=steps)
        if missing is not None:
            found = with_errors(found, missing.error(fit, few=few))
        if name in moved:
            found = with_errors(found, filled_error(fit.record.dynamics, moved[name], interval=record.interval))
        return with_few(found) if few else found

    with PROGRESS.stage(0.85, 1.0, "uncertainty"):
        names = list(fits)
        return dict(zip(names, side_by_side(estimated_with, names, what="component"), strict=True))


def _ground_findings(fits: Mapping[str, Fitted], record: ForceRecord) -> dict[str, GroundFindings]:
    """What the loads say of the channels of the ground's motion, by component; coupled ones are asked at once."""
    asked = [alone(fit.record, fit.smoothed) for fit in fits.values() if moves_along_axis(fit.record)]
    if isinstance(record, CoupledRecord) and record.dynamics.mass is not None:
        every = tuple(Witness(fit.record, fit.smoothed) for fit in fits.values())
        asked = [Witnesses(record.recording, every, None)]
    found: dict[str, GroundFindings] = {}
    for one in side_by_side(ground_findings, asked):
        found |= one
    return found


Answer = TypeVar("Answer")


def _worked(work: Callable[[ComponentRecord], Answer], records: Mapping[str, ComponentRecord]) -> dict[str, Answer]:
    return dict(zip(records, side_by_side(work, records.values(), what="component"), strict=True))


class Filled(NamedTuple, Generic[Answer]):
    """Answers by component of readings whose gaps are filled, the readings, and how far the forces moved, (n,) [N]."""

    answers: dict[str, Answer]
    readings: Array
    moved: dict[str, Array]


def _with_gaps_filled(
    record: ForceRecord,
    work: Callable[[ComponentRecord], Answer],
    known: Callable[[Answer], tuple[Array, float]],
    *,
    noises: Mapping[str, NoiseSpectrum] | None,
) -> Filled[Answer]:
    """Return answers by component, of readings with their gaps filled by what the forces found make them.

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
    found = _worked(work, record.component_records(filled, noises=noises))
    first = {name: known(one)[0] for name, one in found.items()} if record.has_gaps else {}
    for _ in range(PASSES if record.has_gaps else 0):
        facts = {name: known(one) for name, one in found.items()}
        better = record.filled_by({name: force for name, (force, _) in facts.items()}, filled=filled)
        if _settled(better - filled, [noise for _, noise in facts.values()]):
            break
        filled = better
        found = _worked(work, record.component_records(filled, noises=noises))
    moved = {name: known(found[name])[0] - force for name, force in first.items()}
    return Filled(found, filled, moved)


def _with_gaps_found(
    record: ForceRecord, fitted: Callable[[ComponentRecord], Fitted], *, noises: Mapping[str, NoiseSpectrum] | None
) -> tuple[dict[str, Fitted], Array, MissingReadings]:
    """Return fits by component, and the readings with few that are missing in their places, and how well known.

    The first priors are learned with what ringing a gap leaves, so they are learned, and the readings found, again
    where those of the second priors are others.
    """
    filled = interpolate_gaps(record.loads)
    # what a gap leaves rings, and is no step to be looked for
    first = _worked(Fitted.without_steps, record.component_records(filled, noises=noises))
    filled, missing = MissingReadings.of(record, first, filled=filled)
    found = _worked(fitted, record.component_records(filled, noises=noises))
    for _ in range(PASSES - 1):
        better, missing = MissingReadings.of(record, found, filled=filled)
        if _settled(better - filled, [one.signal.learned.noise for one in found.values()]):
            break
        filled = better
        found = _worked(fitted, record.component_records(filled, noises=noises))
    return found, filled, missing


def _settled(change: Array, noise: Sequence[float]) -> bool:
    """Return whether no force would notice a change of what fills the gaps, the noise of a reading being so large."""
    return bool((np.abs(change) < SETTLED * np.array(noise)).all())


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
    if not record.is_coupled:
        return {}
    if any(one.color is not None for one in learned):
        return {}
    spectra_at = partial(
        NoiseMatrix.of,
        record.decoupled,
        learned,
        interval=record.interval,
        noise=record.noise,
        ground=record.motion_covariance,
    )
    # by frequencies as far apart as on the record's own clock; with fewer of the others no error is less
    roughly = spectra_at(steps=FREQUENCIES // record.recording.decimated)
    places = [place for place in range(len(learned)) if roughly.is_worthwhile(place, WORTHWHILE / 2)]
    if not places:
        return {}
    spectra = spectra_at() if record.recording.decimated > 1 else roughly
    residuals = np.column_stack([fit.smoothed.residuals for fit in fits.values()])
    present = np.column_stack([np.isfinite(record.loads[:, one.partners]).all(axis=1) for one in record.decoupled])

    def taken_from(place: int) -> SharedNoise | None:
        return shared_noise(
            spectra,
            place,
            residuals=align_channels(residuals, record.channels, to=record.channels[place], interval=record.interval),
            present=present,
            readings=partial(record.reading, on_clock_of=place, filled=filled),
        )

    found = side_by_side(taken_from, places)
    return {record.channels[place].name: one for place, one in zip(places, found, strict=True) if one is not None}
