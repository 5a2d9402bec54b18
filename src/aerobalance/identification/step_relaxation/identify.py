"""Identification of coupled components from releases: cable cuts and hammer taps, balance readings only.

After a release F is constant, so that with X counted from its final rest X'' = -A^-1 (X + D X'): Eq. (8) of
[Gorbushin2020]_ for several components. All decays together give A and D, with no force sensor and no accelerometer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from aerobalance.balance.matrix_errors import MatrixErrors
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.coupled.combinations import (
    STILL,
    combination_of,
    combination_text,
    first_release_for,
)
from aerobalance.identification.coupled.conclusions import check_recordings, colour_of, residual_size, rigid_of
from aerobalance.identification.coupled.result import APPLIED, common_parts
from aerobalance.identification.coupled.units import Units, dynamics_of
from aerobalance.identification.free_decay.waveform import HEAVIEST
from aerobalance.identification.step_relaxation.calibration_errors import covariance_of_calibration
from aerobalance.identification.step_relaxation.experiment_design import advice, excitation, unmoved
from aerobalance.identification.step_relaxation.fit import ReleaseFit, reweighed
from aerobalance.identification.step_relaxation.model_order import MOST, ChosenFit, fit_modes
from aerobalance.identification.step_relaxation.record import ReleaseRecord, release_record
from aerobalance.identification.step_relaxation.release_result import (
    CoupledIdentification,
    ReleaseFound,
    release_warnings,
)
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording


def identify_releases(
    recordings: Sequence[Recording],
    *,
    components: Sequence[str] = COMPONENTS,
    mass: float | tuple[float, float] | None = None,
    half_range: Mapping[str, float] | None = None,
    release_share: float = 0.5,
    modes: int | Literal["auto"] = "auto",
    errors: Sequence[MatrixErrors] = (),
) -> CoupledIdentification:
    """Identify A and D of F = X + D X' + A X'', Eq. (17) of [Gorbushin2020]_ with matrices, from releases.

    Parameters
    ----------
    recordings
        One release in each, anywhere in it; readings before it tie the decay to the loads that were let go. All at
        the same sampling rate.
    components
        Coupled components, some of `COMPONENTS`.
    mass
        Weighed mass [kg], exact or with its standard uncertainty; with all six components it gives the mass matrix.
    half_range
        Half of range by component [N, N*m]; where not given, the largest change of load in the recordings.
    release_share
        Size of the further releases that are considered, over half of range.
    modes
        Number of modes: one for each component, or more where the model or the sting bends; ``"auto"`` takes those
        that the decays show clearly. Modes beyond one for each component need a release along every component.
    errors
        Where the balance matrix was used, for each recording: what its calibration leaves in A and D is then in
        `CoupledDynamics.covariance_of_calibration`, and in the modes, the mass and its tests.

    Raises
    ------
    ValueError
        There is no recording, or components, mass, half range, modes, errors or sampling rates do not fit.
    FitError
        The releases leave a combination of loads at rest, the decays show too few modes, or no fit settles.

    Notes
    -----
    The covariance is that of the maximum likelihood, to first order in the noise. Where an element of A or D is
    uncertain by some percent of the largest, single uncertainties and the predicted force error still hold, while the
    correlations of the elements are no longer exact.
    """
    names = tuple(name for name in COMPONENTS if name in components)
    _check_call(recordings, names, components, mass=mass, release_share=release_share, modes=modes)
    if errors and len(errors) != len(recordings):
        raise ValueError(f"errors must be given for each of {len(recordings)} recordings or for none")
    records = [release_record(recording, names) for recording in recordings]
    sizes = sizes_of(records, names, half_range)
    _check_moved(records, sizes, names)
    with PROGRESS.stage(0.0, 0.8, "modes"):
        chosen = fit_modes(records, sizes=sizes, modes=modes)
    fit, units = chosen.fit, chosen.units
    colour = _colour(fit)
    if (colour > 1).any():
        fit = reweighed(fit, fit.noise * np.sqrt(np.outer(colour, colour)))
    _check_seen(fit, names)
    dynamics = dynamics_of(fit.matrices, fit.information, units, names)
    if errors:
        left = covariance_of_calibration(fit, units, records, errors, components=names)
        dynamics = replace(dynamics, covariance_of_calibration=left)
    found = _result(
        fit,
        units,
        records,
        dynamics,
        colour=colour,
        mass=mass,
        given=half_range is not None,
        share=release_share,
    )
    found = replace(found, notes=(*_notes_on_modes(found, chosen), *found.notes))
    for note in found.notes:
        warn_quality(f"{_called(records)}: {note}")
    return found


def _check_call(
    recordings: Sequence[Recording],
    names: tuple[str, ...],
    components: Sequence[str],
    *,
    mass: float | tuple[float, float] | None,
    release_share: float,
    modes: int | Literal["auto"],
) -> None:
    check_recordings(recordings, names, components, of="a release")
    if mass is not None and names != COMPONENTS:
        raise ValueError(f"a mass matrix needs all of {', '.join(COMPONENTS)}; leave the mass out")
    if modes != "auto" and not len(names) <= modes <= len(names) + MOST:
        raise ValueError(f"modes must be auto or {len(names)} to {len(names) + MOST}, not {modes}")
    if not 0 < release_share <= 1:
        raise ValueError(f"release_share must be above 0 and at most 1, not {release_share:g}")


def sizes_of(
    records: Sequence[ReleaseRecord], names: tuple[str, ...], half_range: Mapping[str, float] | None
) -> Array:
    """Return half of range by component, or the largest change of load, shape (n,) [N, N*m]."""
    if half_range is None:
        return np.asarray(np.max([np.ptp(record.values, axis=0) for record in records], axis=0) + 0.0)
    missing = [name for name in names if not half_range.get(name, 0) > 0]
    if missing:
        raise ValueError(f"half_range must give a positive value for {', '.join(missing)}")
    return np.array([float(half_range[name]) for name in names])


def _check_moved(records: list[ReleaseRecord], sizes: Array, names: tuple[str, ...]) -> None:
    """Refuse releases that leave a combination of loads at rest."""
    still = [name for name, size in zip(names, sizes, strict=True) if not size > 0]
    if still:
        raise FitError(f"the readings of {', '.join(still)} never change; add a release along {still[0]}")
    combinations = unmoved(records, sizes)
    if len(combinations):
        first = first_release_for(combinations, names)
        if len(combinations) == len(names):
            raise FitError(f"{_called(records)}: nothing rings above the noise; are the releases in the recordings?")
        still_text = " nor ".join(combination_text(weights, names) for weights in combinations)
        raise FitError(
            f"{_called(records)}: no release moves {still_text} (loads over half of range) above the noise, so "
            f"{len(combinations)} of {len(names)} modes stay unknown; add a release along {first}"
        )


def _check_seen(fit: ReleaseFit, names: tuple[str, ...]) -> None:
    """Refuse releases that leave a mode in the noise."""
    poles = fit.motion.poles
    # what hardly rings for a period is a level that is held and let go in the noise, and no mode
    rings = (poles.real < 0) & (-poles.real < HEAVIEST * np.abs(poles))
    if not rings.all() or np.count_nonzero(poles.imag > 0) != len(names) + fit.internal:
        raise FitError(
            f"{_called(fit.segments)}: the decays do not show {len(names) + fit.internal} decaying modes above the "
            "noise; add releases along other components, or larger ones"
        )
    energy = np.sum(excitation(fit)[1] ** 2, axis=0)
    if energy.min() < STILL:
        mode = int(np.argmin(energy))
        weights = combination_of(fit.motion, mode)
        raise FitError(
            f"{_called(fit.segments)}: a mode is not excited above the noise, the one of the combination "
            f"{combination_text(weights, names)} (loads over half of range); add a release along "
            f"{first_release_for(weights[None], names)}"
        )


def _called(parts: Sequence[object]) -> str:
    return ", ".join(str(getattr(part, "name", part)) for part in parts)


def _colour(fit: ReleaseFit) -> Array:
    parts = [
        (linear.ringing, float(np.median(np.diff(segment.time))))
        for segment, linear in zip(fit.segments, fit.linears, strict=True)
    ]
    return colour_of(parts, fit.motion, fit.noise)


def _result(
    fit: ReleaseFit,
    units: Units,
    records: list[ReleaseRecord],
    dynamics: CoupledDynamics,
    *,
    colour: Array,
    mass: float | tuple[float, float] | None,
    given: bool,
    share: float,
) -> CoupledIdentification:
    duration = float(np.median([record.time[-1] - record.time[0] for record in records]))
    further = advice(
        fit,
        units,
        dynamics,
        step=share * units.sizes,
        applied=APPLIED * units.sizes,
        duration=duration,
        rate=records[0].rate,
    )
    rigid, notes = rigid_of(dynamics, mass)
    if rigid is not None:
        dynamics = replace(dynamics, mass=rigid.mass)
    deviation, reduced = residual_size(
        fit.residuals,
        degrees_of_freedom=fit.degrees_of_freedom,
        sizes=units.sizes,
        noises=[record.noise for record in records],
    )
    common = common_parts(
        dynamics,
        fit.motion,
        half_range=units.sizes,
        half_range_given=given,
        residual_deviation=deviation,
        reduced_chi2=reduced,
        colour=colour,
        degrees_of_freedom=fit.degrees_of_freedom,
    )
    found = CoupledIdentification(
        **common, notes=(), releases=_releases(fit, units, records), advice=further, rigid=rigid
    )
    return replace(found, notes=(*release_warnings(found), *notes))


def _notes_on_modes(found: CoupledIdentification, chosen: ChosenFit) -> list[str]:
    """What is doubtful about the number of modes."""
    if chosen.peak is None and chosen.why is None:
        return []
    where, other = "", ""
    if chosen.peak is not None:
        where = f" near {chosen.peak:.4g} Hz"
        near = min(abs(chosen.peak / mode.natural_frequency - 1) for mode in found.modes)
        other = " or damping is not linear, or the balance matrix" if near < 1 / 8 else ""
    reason = "" if chosen.why is None else f" ({chosen.why})"
    text = (
        f"the decays ring{where} as the {len(found.modes)} modes found do not, as where the model or the sting bends"
        f"{other}{reason}; the dynamics leave it out, and the force is wrong there by what it carries"
    )
    return [text]


def _releases(fit: ReleaseFit, units: Units, records: list[ReleaseRecord]) -> tuple[ReleaseFound, ...]:
    shares, visibility = excitation(fit)
    n, information = fit.size, fit.information
    size = np.linalg.norm(information, axis=0)
    found = []
    for number, (segment, own, linear, record) in enumerate(
        zip(fit.segments, fit.own, fit.linears, records, strict=True)
    ):
        zero = record.start + record.time[record.onset]
        if segment.kind == "free":
            instant, u, duration, step = segment.edge[1], 0.0, 0.0, np.full(n, np.nan)
        else:
            instant, step = float(own[2 * n]), (own[n : 2 * n] - own[:n]) * units.sizes
            duration = float(own[2 * n + 1]) if segment.kind == "ramp" else 0.0
            k = segment.own
            row = np.linalg.solve(linear.block[:k, :k].T, np.eye(k)[2 * n])
            through = np.linalg.solve((information / size).T, (row @ linear.block[:k, k:-1]) / size)
            u = float(np.sqrt(row @ row + through @ through))
        first, last = linear.held.shape[0], linear.ringing.shape[0]
        clock = record.start + record.time
        found.append(
            ReleaseFound(
                name=record.name,
                kind=segment.kind,
                instant=float(zero + instant / units.rate),
                u_instant=u / units.rate,
                duration=duration / units.rate,
                step=step,
                shares=shares[number],
                visibility=visibility[number],
                time=np.concatenate([clock[:first], clock[-last:]]),
                residuals=np.vstack([linear.held, linear.ringing]) * units.sizes,
            )
        )
    return tuple(found)
