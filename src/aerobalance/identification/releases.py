"""Identification of coupled components from releases: cable cuts and hammer taps, balance readings only.

After a release F is constant, so that with X counted from its final rest X'' = -A^-1 (X + D X'): Eq. (8) of
[Gorbushin2020]_ for several components. All decays together give A and D, with no force sensor and no accelerometer.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from aerobalance.channel import Array
from aerobalance.components import COMPONENTS
from aerobalance.coupled import CoupledDynamics
from aerobalance.identification.coupled_identification import (
    APPLIED,
    CoupledIdentification,
    ReleaseFound,
    doubts_about,
)
from aerobalance.identification.force_error import error_of, highest_of, motion_power
from aerobalance.identification.mass_matrix import RigidMassFit, rigid_mass_of
from aerobalance.identification.release_advice import (
    STILL,
    advice,
    combination_of,
    combination_text,
    excitation,
    first_release_for,
    pairs,
    physical_covariance,
    unmoved,
)
from aerobalance.identification.release_fit import ReleaseFit, settle
from aerobalance.identification.release_record import ReleaseRecord, release_record
from aerobalance.identification.release_stages import Units, fit_releases
from aerobalance.problems import DoubtWarning, FitError
from aerobalance.recording import Recording


def identify_releases(
    recordings: Sequence[Recording],
    *,
    components: Sequence[str] = COMPONENTS,
    mass: float | tuple[float, float] | None = None,
    half_range: Mapping[str, float] | None = None,
    release_share: float = 0.5,
) -> CoupledIdentification:
    """Identify A and D of F = X + D X' + A X'', Eq. (17) of [Gorbushin2020]_ with matrices, from releases.

    Parameters
    ----------
    recordings
        One release in each, anywhere in it; readings before it tie the decay to the loads that were let go. All at
        the same sampling rate.
    components
        Components that ring together, some of `COMPONENTS`.
    mass
        Weighed mass [kg], exact or with its standard uncertainty; with all six components it gives the mass matrix.
    half_range
        Half of range by component [N, N*m]; where not given, the largest change of load in the recordings.
    release_share
        Size of the further releases that are considered, over half of range.

    Raises
    ------
    ValueError
        There is no recording, or components, mass, half range or sampling rates do not fit.
    FitError
        The releases leave a combination of loads at rest, the decays show too few modes, or no fit settles.

    Notes
    -----
    The covariance is that of the maximum likelihood, to first order in the noise. Where an element of A or D is
    uncertain by some percent of the largest, single uncertainties and the predicted force error still hold, while the
    correlations of the elements are no longer exact.
    """
    names = tuple(name for name in COMPONENTS if name in components)
    _check_call(recordings, names, components, mass=mass, release_share=release_share)
    records = [release_record(recording, names) for recording in recordings]
    sizes = _sizes(records, names, half_range)
    _check_moved(records, sizes, names)
    fit, units = fit_releases(records, sizes=sizes)
    colour = _colour(fit)
    if (colour > 1).any():
        fit = settle(fit.pieces, fit.matrices, fit.own, noise=fit.noise * np.sqrt(np.outer(colour, colour)))
    _check_seen(fit, names)
    return _result(
        fit, units, records, names, colour=colour, mass=mass, given=half_range is not None, share=release_share
    )


def _check_call(
    recordings: Sequence[Recording],
    names: tuple[str, ...],
    components: Sequence[str],
    *,
    mass: float | tuple[float, float] | None,
    release_share: float,
) -> None:
    if not recordings:
        raise ValueError("at least one recording of a release is needed")
    if not names or len(names) != len(components):
        raise ValueError(f"components must be some of {', '.join(COMPONENTS)}, each once, not {', '.join(components)}")
    rates = [recording.rate for recording in recordings]
    if max(rates) > 1.001 * min(rates):
        raise ValueError(f"the recordings must have one sampling rate, not {min(rates):g} to {max(rates):g} Hz")
    if mass is not None and names != COMPONENTS:
        raise ValueError(f"a mass matrix needs all of {', '.join(COMPONENTS)}; leave the mass out")
    if not 0 < release_share <= 1:
        raise ValueError(f"release_share must be above 0 and at most 1, not {release_share:g}")


def _sizes(records: list[ReleaseRecord], names: tuple[str, ...], half_range: Mapping[str, float] | None) -> Array:
    """Half of range by component, or the largest change of load."""
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
    if not (poles.real < 0).all() or np.count_nonzero(poles.imag > 0) != len(names):
        raise FitError(
            f"{_called(fit.pieces)}: the decays do not show {len(names)} decaying modes above the noise; add releases "
            "along other components, or larger ones"
        )
    energy = np.sum(excitation(fit)[1] ** 2, axis=0)
    if energy.min() < STILL:
        mode = int(np.argmin(energy))
        weights = combination_of(fit.motion, mode)
        raise FitError(
            f"{_called(fit.pieces)}: a mode is not excited above the noise, the one of the combination "
            f"{combination_text(weights, names)} (loads over half of range); add a release along "
            f"{first_release_for(weights[None], names)}"
        )


def _called(parts: Sequence[object]) -> str:
    return ", ".join(str(getattr(part, "name", part)) for part in parts)


def _colour(fit: ReleaseFit) -> Array:
    """Power of the residuals within an eighth of the modes' frequencies over that of white noise, shape (n,)."""
    n = fit.size
    _, rates = pairs(fit.motion)
    near, whole, ordinates = np.zeros(n), np.zeros(n), 0
    for piece, linear in zip(fit.pieces, fit.linears, strict=True):
        left = linear.ringing
        interval = float(np.median(np.diff(piece.time)))
        power = np.abs(np.fft.rfft(left, axis=0)[1:]) ** 2
        rate = 2 * np.pi * np.arange(1, power.shape[0] + 1) / (left.shape[0] * interval)
        band = (np.abs(rate[:, None] / rates - 1) < 1 / 8).any(axis=1)
        near += power[band].sum(axis=0)
        whole += power.mean(axis=0) * np.count_nonzero(band)
        ordinates += int(np.count_nonzero(band))
    if ordinates < 12 or (whole == 0).any() or (np.sqrt(np.diag(fit.noise)) < 1e-9).any():
        return np.ones(n)
    level = near / whole
    return np.where(level > 1 + 4 / np.sqrt(ordinates), level, 1.0)


def _result(
    fit: ReleaseFit,
    units: Units,
    records: list[ReleaseRecord],
    names: tuple[str, ...],
    *,
    colour: Array,
    mass: float | tuple[float, float] | None,
    given: bool,
    share: float,
) -> CoupledIdentification:
    dynamics = _dynamics(fit, units, names)
    applied = APPLIED * units.sizes
    error = error_of(dynamics.covariance, motion_power(dynamics, sizes=applied))
    duration = float(np.median([record.time[-1] - record.time[0] for record in records]))
    further = advice(
        fit,
        units,
        dynamics,
        step=share * units.sizes,
        applied=applied,
        duration=duration,
        rate=records[0].rate,
    )
    rigid, notes = _rigid(dynamics, mass)
    if rigid is not None:
        dynamics = replace(dynamics, mass=rigid.mass)
    deviation, reduced = _residual_size(fit, units, records)
    up, _ = pairs(fit.motion)
    shapes = fit.motion.shapes[:, up].T
    shapes = shapes / shapes[np.arange(len(up)), np.argmax(np.abs(shapes), axis=1)][:, None]
    u_frequency, u_ratio = _u_modes(fit, units)
    found = CoupledIdentification(
        dynamics=dynamics,
        modes=dynamics.modes,
        u_natural_frequency=u_frequency,
        u_damping_ratio=u_ratio,
        mode_shapes=shapes,
        combinations=np.array([combination_of(fit.motion, mode) for mode in range(len(up))]),
        releases=_releases(fit, units, records),
        half_range=units.sizes,
        half_range_given=given,
        residual_deviation=deviation,
        reduced_chi2=reduced,
        colour=colour,
        degrees_of_freedom=fit.degrees_of_freedom,
        applied=applied,
        band=(0.0, highest_of(dynamics)),
        force_error=error,
        advice=further,
        rigid=rigid,
        notes=(),
    )
    found = replace(found, notes=(*doubts_about(found), *notes))
    for note in found.notes:
        warnings.warn(f"{_called(records)}: {note}", DoubtWarning, stacklevel=3)
    return found


def _dynamics(fit: ReleaseFit, units: Units, names: tuple[str, ...]) -> CoupledDynamics:
    n = fit.size
    spring, brake = fit.matrices.reshape(2, n, n)
    A = np.linalg.inv(spring)
    ratio = units.sizes[:, None] / units.sizes[None, :]
    covariance = physical_covariance(fit.information, fit.matrices, units)
    return CoupledDynamics(names, A * ratio / units.rate**2, A @ brake * ratio / units.rate, covariance)


def _rigid(
    dynamics: CoupledDynamics, mass: float | tuple[float, float] | None
) -> tuple[RigidMassFit | None, list[str]]:
    """The rigid mass, where a weighed mass is given, and what is doubtful about it."""
    if mass is None:
        return None, []
    value, uncertainty = mass if isinstance(mass, tuple) else (mass, 0.0)
    try:
        rigid = rigid_mass_of(dynamics, value, u_mass=uncertainty)
    except FitError as problem:
        return None, [f"no mass matrix: {problem}; gravity and ground motion cannot be taken out of the loads"]
    notes = []
    if rigid.rigidity is not None and not rigid.rigidity.chance:
        notes.append(
            f"the inertia matrix is not that of a rigid mass on a symmetric stiffness (chi2 {rigid.rigidity.chi2:.3g} "
            "for 6 degrees of freedom); the mass matrix found from it is only nearly right"
        )
    if rigid.reciprocity is not None and not rigid.reciprocity.chance:
        notes.append(
            f"the damping is not symmetric (chi2 {rigid.reciprocity.chi2:.3g} for 15 degrees of freedom), as it is "
            "not in a flow or with friction; the constrained dynamics do not hold"
        )
    return rigid, notes


def _residual_size(fit: ReleaseFit, units: Units, records: list[ReleaseRecord]) -> tuple[Array, Array]:
    """Standard deviation of the residuals [N, N*m], and their variance over that of the noise given or judged."""
    squares = sum(np.sum(linear.ringing**2, axis=0) + np.sum(linear.held**2, axis=0) for linear in fit.linears)
    deviation = np.sqrt(squares * fit.size / max(fit.degrees_of_freedom, 1)) * units.sizes
    noise = np.sqrt(np.mean([record.noise**2 for record in records], axis=0))
    return deviation, (deviation / noise) ** 2


def _u_modes(fit: ReleaseFit, units: Units) -> tuple[Array, Array]:
    """Standard uncertainty of the modes' frequencies [Hz] and damping ratios."""
    motion, n = fit.motion, fit.size
    up, _ = pairs(motion)
    size = np.linalg.norm(fit.information, axis=0)
    frequency, ratio = [], []
    for place in up:
        pole = motion.poles[place]
        gain = np.outer(-motion.shares[place, n:], motion.shapes[:, place]).ravel()
        slope = np.concatenate([gain, gain * pole])  # of the pole by spring and brake
        rate = abs(pole)
        by_rate = np.real(np.conj(pole) * slope) / rate
        by_ratio = -slope.real / rate + pole.real / rate**2 * by_rate
        rows = np.linalg.solve((fit.information / size).T, (np.array([by_rate, by_ratio]) / size).T)
        u = np.linalg.norm(rows, axis=0)
        frequency.append(u[0] * units.rate / (2 * np.pi))
        ratio.append(u[1])
    return np.array(frequency), np.array(ratio)


def _releases(fit: ReleaseFit, units: Units, records: list[ReleaseRecord]) -> tuple[ReleaseFound, ...]:
    shares, visibility = excitation(fit)
    n, information = fit.size, fit.information
    size = np.linalg.norm(information, axis=0)
    found = []
    for number, (piece, own, linear, record) in enumerate(zip(fit.pieces, fit.own, fit.linears, records, strict=True)):
        zero = record.start + record.time[record.onset]
        if piece.kind == "free":
            instant, u, duration, step = piece.edge[1], 0.0, 0.0, np.full(n, np.nan)
        else:
            instant, step = float(own[2 * n]), (own[n : 2 * n] - own[:n]) * units.sizes
            duration = float(own[-1]) if piece.kind == "ramp" else 0.0
            k = piece.own
            row = np.linalg.solve(linear.block[:k, :k].T, np.eye(k)[2 * n])
            through = np.linalg.solve((information / size).T, (row @ linear.block[:k, k:-1]) / size)
            u = float(np.sqrt(row @ row + through @ through))
        first, last = linear.held.shape[0], linear.ringing.shape[0]
        clock = record.start + record.time
        found.append(
            ReleaseFound(
                name=record.name,
                kind=piece.kind,
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
