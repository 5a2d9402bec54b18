"""Identification of coupled components from base shaking: a ground end that is shaken while no force acts.

With F = 0, X + D X' + A X'' = W(pitch, roll) - M x1'': Eq. (8) of [Gorbushin2020]_ for several components. The balance
loads and the ground end's motion in six degrees of freedom give A, D and the mass matrix, from any number of records
of any kind: broadband, swept or stepped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.base_excitation.shaking_fit import (
    DELAY,
    ShakeParameters,
    chunks,
    evaluate,
    first_guess,
    settle,
    with_noise,
)
from aerobalance.identification.base_excitation.shaking_mass import (
    Joint,
    mass_behind,
    rigidity_test,
    rows_with_free_mass,
)
from aerobalance.identification.base_excitation.shaking_record import ShakeRecord, shake_record
from aerobalance.identification.base_excitation.shaking_result import (
    ShakeFound,
    ShakingIdentification,
    shake_advice,
    shaking_warnings,
    visibility,
)
from aerobalance.identification.coupled.combinations import (
    STILL,
    combination_of,
    combination_text,
    first_release_for,
    plainest,
)
from aerobalance.identification.coupled.free_response import FreeMotion
from aerobalance.identification.coupled.result import APPLIED, common_parts
from aerobalance.identification.rigid_body import LEVER
from aerobalance.identification.step_relaxation.record import ROUNDING
from aerobalance.motion.sensors import motion_name
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording

NOISE_ROUNDS: Final = 2
"""Times that the noise of the loads is taken from what the fit leaves."""

SHIFTED: Final = 1e-7
"""Delay from which the loads are moved by it and the fit is made again [s]: the window does not move with them."""

_UNKNOWN_MASS: Final = np.where([name in MOMENTS for name in COMPONENTS], LEVER**2, 1.0)
"""Diagonal of a mass matrix that stands for one that is not known, where only its proportions count."""


def identify_shaking(
    recordings: Sequence[Recording],
    *,
    mass: float | tuple[float, float] | None = None,
    half_range: Mapping[str, float] | None = None,
    band: tuple[float, float] | None = None,
) -> ShakingIdentification:
    """Identify A, D and the mass of F = X + D X' + A X'' - W + M x1'' from a shaken ground end.

    Parameters
    ----------
    recordings
        Loads of all components and the motion of the ground end, in any sensors that `PlatformMotion` knows; no force
        but gravity and what keeps the model shaking.
    mass
        Weighed mass [kg], exact or with its standard uncertainty; None to take it from the records.
    half_range
        Half of range by component [N, N*m]; where not given, the largest change of load in the recordings.
    band
        Lowest and highest frequency to use [Hz]; by default all that stand out of the noise.

    Raises
    ------
    ValueError
        There is no recording, or mass, half range or band do not fit.
    FitError
        The ground end does not move, the records leave a combination of loads or a mode at rest, or no fit settles.

    Notes
    -----
    Noise of the loads and of the ground's sensors is taken as white, the latter as given or judged from the channels;
    its part in the loads is what the sensors of turns make of it mostly. The delay of the loads is fitted, as it would
    pass for damping.
    """
    weighed = _check_call(recordings, mass, band)
    records = [shake_record(recording, band=band) for recording in recordings]
    sizes = _sizes(records, half_range)
    _check_moved(records, sizes)
    delay, fit = 0.0, _fitted(records, sizes)
    if abs(fit.values[DELAY]) > SHIFTED:
        delay = float(fit.values[DELAY])
        records = [shake_record(recording, delay=delay, band=band) for recording in recordings]
        fit = _fitted(records, sizes)
    _check_seen(records, fit, sizes)
    colour = _colour(records, fit)
    if (colour > 1).any():
        fit = settle(records, replace(fit, noise=fit.noise * np.sqrt(np.outer(colour, colour))))
    found = _result(records, fit, sizes, colour=colour, weighed=weighed, given=half_range is not None, delay=delay)
    for note in found.notes:
        warn_quality(f"{_called(records)}: {note}")
    return found


def _check_call(
    recordings: Sequence[Recording], mass: float | tuple[float, float] | None, band: tuple[float, float] | None
) -> tuple[float, float] | None:
    """Refuse a wrong call; the mass with its uncertainty."""
    if not recordings:
        raise ValueError("at least one recording of a shaken balance is needed")
    if band is not None and not 0 <= band[0] < band[1]:
        raise ValueError(f"band must be two frequencies in rising order, not {band}")
    if mass is None:
        return None
    value, u = mass if isinstance(mass, tuple) else (mass, 0.0)
    if not (0 < value < np.inf and 0 <= u < np.inf):
        raise ValueError(f"mass must be positive with an uncertainty of zero or more, not {value} and {u}")
    return value, u


def _sizes(records: Sequence[ShakeRecord], half_range: Mapping[str, float] | None) -> Array:
    """Half of range by component, or the largest change of load."""
    if half_range is None:
        return np.asarray(np.max([record.reach for record in records], axis=0))
    missing = [name for name in COMPONENTS if not half_range.get(name, 0) > 0]
    if missing:
        raise ValueError(f"half_range must give a positive value for {', '.join(missing)}")
    return np.array([float(half_range[name]) for name in COMPONENTS])


def _called(records: Sequence[ShakeRecord]) -> str:
    return ", ".join(record.name for record in records)


def _check_moved(records: Sequence[ShakeRecord], sizes: Array) -> None:
    """Refuse records that leave a combination of loads at rest."""
    noise = np.min([record.noise for record in records], axis=0)
    power, count = np.zeros((6, 6)), 0
    for record in records:
        loads = record.loads / noise
        power += 2 * np.real(loads.T @ loads.conj())
        count += 2 * record.frequency.size
    energy, directions = np.linalg.eigh(power)
    still = energy < count + STILL + 6 * np.sqrt(2 * count)
    if still.any():
        combinations = plainest(directions[:, still].T * sizes / noise)
        text = " nor ".join(combination_text(weights, COMPONENTS) for weights in combinations)
        best = COMPONENTS.index(first_release_for(combinations, COMPONENTS))
        raise FitError(
            f"{_called(records)}: no shake moves {text} (loads over half of range) above the noise, so "
            f"{len(combinations)} of 6 modes stay unknown; add a shake in the ground's {motion_name(best)}, or a "
            "harder one"
        )


def _fitted(records: Sequence[ShakeRecord], sizes: Array) -> ShakeParameters:
    """Parameters and noise of maximum likelihood."""
    fit = settle(records, first_guess(records, sizes=sizes))
    for _ in PROGRESS.each(range(NOISE_ROUNDS), "fit"):
        fit = settle(records, with_noise(records, fit, least=ROUNDING * sizes))
    return fit


def _check_seen(records: Sequence[ShakeRecord], fit: ShakeParameters, sizes: Array) -> None:
    """Refuse records that leave a mode in the noise."""
    try:
        dynamics = CoupledDynamics(COMPONENTS, fit.inertia, fit.damping)
        modes = len(dynamics.modes)
    except (ValueError, np.linalg.LinAlgError):
        modes = 0
    if modes != len(COMPONENTS):
        raise FitError(
            f"{_called(records)}: the shaken records do not show 6 decaying modes above the noise; shake harder, for "
            "longer, up to higher frequencies, or along other motions of the ground end"
        )
    energy = np.sum([visibility(record, fit, dynamics) ** 2 for record in records], axis=0)
    if energy.min() < STILL:
        mode = int(np.argmin(energy))
        weights = combination_of(_motion(dynamics, sizes), mode)
        best = COMPONENTS.index(first_release_for(weights[None], COMPONENTS))
        raise FitError(
            f"{_called(records)}: a mode is not excited above the noise, the one of the combination "
            f"{combination_text(weights, COMPONENTS)} (loads over half of range); add a shake in the ground's "
            f"{motion_name(best)}"
        )


def _motion(dynamics: CoupledDynamics, sizes: Array) -> FreeMotion:
    """Free motion of the dynamics, loads over their sizes."""
    ratio = sizes[None, :] / sizes[:, None]
    spring = np.asarray(np.linalg.inv(dynamics.inertia * ratio), dtype=np.float64)
    return FreeMotion.of(spring, spring @ (dynamics.damping * ratio))


def _colour(records: Sequence[ShakeRecord], fit: ShakeParameters) -> Array:
    """Power of what is left near the modes over what noise lets expect, 1 where it passes for noise, shape (6,)."""
    rates = np.array([m.natural_frequency for m in CoupledDynamics(COMPONENTS, fit.inertia, fit.damping).modes])
    power, expected, count = np.zeros(6), np.zeros(6), 0
    for record in records:
        for part in chunks(record):
            here = evaluate(part, fit)
            close = (np.abs(part.frequency[:, None] / rates - 1) < 1 / 8).any(axis=1)
            power += np.sum(np.abs(here.load_noise[close]) ** 2, axis=0)
            expected += np.sum(np.diag(fit.noise) - np.real(np.einsum("mii->mi", here.spread[close])), axis=0)
            count += int(np.count_nonzero(close))
    if count < 12 or (np.sqrt(np.diag(fit.noise)) < 1e-9).any() or not (expected > 0).all():
        return np.ones(6)
    level = power / expected
    return np.where(level > 1 + 4 / np.sqrt(count), level, 1.0)


def _result(
    records: Sequence[ShakeRecord],
    fit: ShakeParameters,
    sizes: Array,
    *,
    colour: Array,
    weighed: tuple[float, float] | None,
    given: bool,
    delay: float,
) -> ShakingIdentification:
    rows, count = rows_with_free_mass(records, fit), fit.values.size
    about = weighed[0] if weighed is not None else abs(float(fit.numbers[0])) or 1.0
    joint, rigid = mass_behind(Joint.of(fit, rows, about=about), mass=weighed, rigidity=rigidity_test(rows, count))
    dynamics = joint.dynamics(rigid.mass)
    heavy = np.diag(_UNKNOWN_MASS) if rigid.mass is None else rigid.mass.matrix
    noise = np.sqrt(np.mean([record.noise**2 for record in records], axis=0))
    deviation = np.sqrt(np.diag(fit.noise) / colour)
    common = common_parts(
        dynamics,
        _motion(dynamics, sizes),
        half_range=sizes,
        half_range_given=given,
        residual_deviation=deviation,
        reduced_chi2=(deviation / noise) ** 2,
        colour=colour,
        degrees_of_freedom=12 * sum(record.frequency.size for record in records) - fit.values.size,
    )
    found = ShakingIdentification(
        **common,
        notes=(),
        shakes=tuple(_shake(record, fit, dynamics) for record in records),
        advice=shake_advice(joint, fit, records, mass=heavy, applied=APPLIED * sizes, sizes=sizes),
        rigid=rigid,
        delay=(delay + float(fit.values[DELAY]), joint.u_delay),
    )
    return replace(found, notes=tuple(shaking_warnings(found)))


def _shake(record: ShakeRecord, fit: ShakeParameters, dynamics: CoupledDynamics) -> ShakeFound:
    return ShakeFound(
        name=record.name,
        duration=record.duration,
        band=(float(record.frequency[0]), float(record.frequency[-1])),
        motion_rms=record.motion_rms,
        seen=tuple(COMPONENTS[place] for place in record.columns),
        visibility=visibility(record, fit, dynamics),
        share=record.share,
    )
