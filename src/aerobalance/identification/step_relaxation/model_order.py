"""Number of modes in a set of releases: one for each component, and more where the model or the sting bends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtrc, gammaincinv

from aerobalance.dynamics.coupled import ModalForm
from aerobalance.identification.coupled.combinations import pairs
from aerobalance.identification.coupled.era import Guess, from_modes, quick_guess
from aerobalance.identification.coupled.free_response import FreeMotion
from aerobalance.identification.coupled.internal_coordinates import static_contributions
from aerobalance.identification.coupled.least_squares import whitener_of
from aerobalance.identification.coupled.units import Units
from aerobalance.identification.free_decay.waveform import HEAVIEST
from aerobalance.identification.step_relaxation.experiment_design import excitation
from aerobalance.identification.step_relaxation.fit import ReleaseFit
from aerobalance.identification.step_relaxation.record import ROUNDING, ReleaseRecord
from aerobalance.identification.step_relaxation.stages import (
    POOR,
    Start,
    decays_of,
    fit_decays,
    guess_of,
    margin_of,
    with_edges,
)
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

MOST: Final = 3
"""Largest number of modes beyond one for each component."""


@dataclass(frozen=True, slots=True)
class ModelOrderSettings:
    """Thresholds of the choice of the number of modes.

    Attributes
    ----------
    evidence
        Log-likelihood that a further mode must gain beyond what its parameters may gain by chance.
    lost
        Share of its gain in log-likelihood that a further mode may lose when the releases must begin at rest [1]: what
        oscillates before them as well is not a mode.
    beyond_structure
        Distance of a mode's static contribution from 0 to 1 beyond which it is no mode of a structure.
    least_decay
        Logarithm of the decay over the longest record below which a line is hum and no mode.
    split
        Distance of two poles, over the faster decay, below which two modes of one shape may be one that is not linear.
    alike
        Square of the cosine between shapes of modes from which they are one shape.
    before
        Power of a line before the releases, over that after them, from which it does not come from them.
    widths
        Widths of the peaks looked for in the residuals, in frequencies.
    independent
        Size of a combination of products of modes, over the largest, below which it is rounding.
    faint
        Power over that of white noise of the size of the residuals, below which it is rounding.
    chance
        Probability of a peak by chance, at one frequency, below which it is taken as real.
    top
        Share of half the sampling rate up to which peaks are looked for.
    """

    evidence: float = 25.0
    lost: float = 0.1
    beyond_structure: float = 0.5
    least_decay: float = 0.05
    split: float = 2.0
    alike: float = 0.95
    before: float = 0.5
    widths: tuple[int, ...] = (1, 3, 9, 27, 81)
    independent: float = 1e-6
    faint: float = 0.1
    chance: float = 1e-9
    top: float = 0.8


SETTINGS: Final = ModelOrderSettings()
"""The thresholds in use."""


IN_TWO: Final = "one mode more takes the place of one that is not linear"
"""Reason given where a further mode only replaces one that is not linear."""


@dataclass(frozen=True, slots=True, eq=False)
class ChosenFit:
    """The fit with as many modes as the releases show.

    Attributes
    ----------
    fit, units
        The fit.
    peak
        Frequency of an oscillation that the fitted modes do not explain [Hz], or None.
    why
        Reason against a further mode that the decays show, or None.
    """

    fit: ReleaseFit
    units: Units
    peak: float | None
    why: str | None = None


def fit_modes(records: Sequence[ReleaseRecord], *, sizes: Array, modes: int | Literal["auto"]) -> ChosenFit:
    """Return the fit with a number of modes, or with as many as the releases show.

    Raises
    ------
    FitError
        No first guess explains the decays, or the fit does not settle.
    """
    if modes != "auto":
        free, units = decays_with(modes - sizes.size, records, sizes=sizes)
        fit = with_edges(free, records, units)
        return ChosenFit(fit, units, missed(fit, units, records))
    free, units, gain = free_decays(records, sizes=sizes)
    if not free.internal:
        fit = with_edges(free, records, units)
        return ChosenFit(fit, units, missed(fit, units, records))
    try:
        fit = with_edges(free, records, units)
    except (FitError, np.linalg.LinAlgError) as problem:
        return _one_mode_each(records, sizes, IN_TWO if len(_twins(free)) else str(problem))
    against = _reason_against(fit)
    if against is not None:
        return _one_mode_each(records, sizes, against)
    if gain_over(free, fit) > SETTINGS.lost * gain:
        return _one_mode_each(records, sizes, "its motion does not begin at rest with the releases")
    return ChosenFit(fit, units, missed(fit, units, records))


def _one_mode_each(records: Sequence[ReleaseRecord], sizes: Array, why: str) -> ChosenFit:
    """The fit with one mode for each component, although the decays show more."""
    free, units = fit_decays(records, sizes=sizes, start=guess_of(records))
    fit = with_edges(free, records, units)
    return ChosenFit(fit, units, missed(fit, units, records), why)


def free_decays(records: Sequence[ReleaseRecord], *, sizes: Array) -> tuple[ReleaseFit, Units, float]:
    """Free decays with as many modes as they show clearly, and the log-likelihood that the last of them gained."""
    free, units, gain = _beginning(records, sizes=sizes)
    internal = free.internal
    while internal < MOST and peak_of(free, units, records) is not None:
        internal += 1
        if _not_worth_a_fit(internal, free, records):
            continue
        try:
            larger, others = decays_with(internal, records, sizes=sizes)
            gained = gain_over(larger, free)
            clear = gained > _by_chance(larger, internal, internal - free.internal) + SETTINGS.evidence
            if clear and internal - free.internal > 1:  # each for itself, not all together
                gained = gain_over(larger, _with_one_less(larger, others, records, sizes)[0])
                clear = gained > _by_chance(larger, internal, 1) + SETTINGS.evidence
        except (FitError, np.linalg.LinAlgError):  # modes that are not found are none
            continue
        if clear and _physical(larger, others, records[0].rate) and len(_twins(larger)) <= len(_twins(free)):
            free, units, gain = larger, others, gained
    return free, units, gain


def _not_worth_a_fit(internal: int, free: ReleaseFit, records: Sequence[ReleaseRecord]) -> bool:
    """Whether a quick fit that explains the decays shows that so many modes are not better, or not lightly damped.

    The full fit takes a hundred times as long, and nonlinear terms that a calibration has left make peaks in the
    residuals again and again, for which no mode is found.
    """
    decays, rate = decays_of(records, 0.0), records[0].rate
    fewer, quick = (
        quick_guess(decays, rate=rate, internal=count) if decays else None for count in (free.internal, internal)
    )
    if fewer is None or quick is None or quick.squares > POOR * sum(decay.size for decay in decays):
        return False
    return quick.squares >= fewer.squares or not _lightly_damped(_motion_of(quick, free.size), free.size + internal)


def _motion_of(guess: Guess, components: int) -> FreeMotion:
    return FreeMotion.of(guess.spring, guess.brake, components=components)


def _lightly_damped(motion: FreeMotion, count: int) -> bool:
    """Whether all of so many modes oscillate, damped as those of a structure are."""
    poles = motion.poles
    return pairs(motion)[1].size == count and bool((-poles.real < HEAVIEST * np.abs(poles)).all())


def decays_with(internal: int, records: Sequence[ReleaseRecord], *, sizes: Array) -> tuple[ReleaseFit, Units]:
    """Free decays with so many modes beside one for each component.

    A first guess may miss a mode that a guess with one more has, beside another that is none. Where it leads nowhere,
    the fit begins with that of one more, less the mode that rings least.
    """
    try:
        return fit_decays(records, sizes=sizes, start=guess_of(records, internal=internal))
    except (FitError, np.linalg.LinAlgError) as problem:
        try:
            larger, units = fit_decays(records, sizes=sizes, start=guess_of(records, internal=internal + 1))
            return _with_one_less(larger, units, records, sizes)
        except (FitError, np.linalg.LinAlgError):
            raise problem from None


def _beginning(records: Sequence[ReleaseRecord], *, sizes: Array) -> tuple[ReleaseFit, Units, float]:
    """Free decays with the fewest modes with which a quick fit reaches the noise; else with one for each component."""
    decays, rate = decays_of(records, 0.0), records[0].rate
    count, before = max(sum(decay.size for decay in decays), 1), np.inf
    for internal in range(MOST + 1) if decays else ():
        quick = quick_guess(decays, rate=rate, internal=internal)
        if quick is None or quick.squares > POOR * count:
            before = before if quick is None else quick.squares
            continue
        if internal == 0:
            break
        try:
            start = guess_of(records, internal=internal, guards=(0.0,))
            free, units = fit_decays(records, sizes=sizes, start=start)
        except (FitError, np.linalg.LinAlgError):
            continue
        try:
            gain = gain_over(free, _with_one_less(free, units, records, sizes)[0])
        except (FitError, np.linalg.LinAlgError):  # with less there is no fit, but a guess
            gain = count / 2 * float(np.log(before / quick.squares)) if np.isfinite(before) else 0.0
        if gain > _by_chance(free, free.internal, 1) + SETTINGS.evidence and _physical(free, units, rate):
            return free, units, gain
    free, units = fit_decays(records, sizes=sizes, start=guess_of(records))
    return free, units, 0.0


def _with_one_less(
    free: ReleaseFit, units: Units, records: Sequence[ReleaseRecord], sizes: Array
) -> tuple[ReleaseFit, Units]:
    """Free decays without the mode that rings least."""
    motion = free.motion
    up, _ = pairs(motion)
    still = np.flatnonzero(motion.poles.imag == 0)
    if still.size >= 2:  # what does not ring at all is the least of a structure's
        gone = still[np.argsort(motion.poles[still].real)[:2]]
    else:
        weakest = up[int(np.argmin(np.sum(excitation(free)[1] ** 2, axis=0)))]
        gone = np.array([weakest, int(np.argmin(np.abs(motion.poles - motion.poles[weakest].conj())))])
    left = np.delete(np.arange(motion.poles.size), gone)
    matrices = from_modes(motion.poles[left], motion.felt[:, left])
    if matrices is None:
        raise FitError("the other modes are not independent of each other")
    return fit_decays(records, sizes=sizes, start=Start(Guess(*units.bare(*matrices), squares=0.0), 0.0))


def _by_chance(fit: ReleaseFit, internal: int, more: int) -> float:
    """Log-likelihood that the parameters of the last modes more, of so many internal, may gain by chance."""
    size, fewer = fit.size + internal, internal - more
    count = 2 * (size**2 - internal**2) - 2 * ((size - more) ** 2 - fewer**2) + 2 * more * len(fit.segments)
    return count / 2 * float(np.log(max(fit.degrees_of_freedom, 2)))


def gain_over(larger: ReleaseFit, smaller: ReleaseFit) -> float:
    """Log-likelihood gained, on the readings after the edges that both use."""
    ours, theirs = [], []
    for one, other in zip(larger.linears, smaller.linears, strict=True):
        count = min(len(one.ringing), len(other.ringing))
        ours.append(one.ringing[len(one.ringing) - count :])
        theirs.append(other.ringing[len(other.ringing) - count :])
    floor = ROUNDING**2 * np.eye(larger.size)
    sizes = [
        float(np.linalg.slogdet(table.T @ table / len(table) + floor)[1])
        for table in (np.vstack(ours), np.vstack(theirs))
    ]
    return sum(len(part) for part in ours) / 2 * (sizes[1] - sizes[0])


def _physical(fit: ReleaseFit, units: Units, rate: float) -> bool:
    """Whether all modes oscillate, decay lightly damped and lie in the band."""
    poles, sizes = fit.motion.poles, pairs(fit.motion)[1]
    longest = max(float(segment.time[-1] - segment.edge[1]) for segment in fit.segments)
    return bool(
        _lightly_damped(fit.motion, fit.size + fit.internal)
        and (-poles.real * longest > SETTINGS.least_decay).all()
        and sizes.max() * units.rate / (2 * np.pi) < SETTINGS.top * rate / 2
    )


def _twins(fit: ReleaseFit) -> NDArray[np.intp]:
    """Pairs of modes near each other and of one shape, as one that is not linear splits into, shape (k, 2)."""
    motion = fit.motion
    up, _ = pairs(motion)
    poles, shapes = motion.poles[up], motion.felt[:, up] / np.linalg.norm(motion.felt[:, up], axis=0)
    near = np.abs(poles[:, None] - poles) < SETTINGS.split * np.maximum(-poles.real[:, None], -poles.real)
    alike = np.abs(shapes.conj().T @ shapes) ** 2 > SETTINGS.alike
    return np.argwhere(np.triu(near & alike, 1))


def _reason_against(fit: ReleaseFit) -> str | None:
    """Reason why the modal contributions to a steady load are not those of a structure, or None.

    Two modes of the balance may be near each other and of one shape: they carry 2 between them. Where a mode is not
    linear, the two into which it splits carry its 1.
    """
    motion, n = fit.motion, fit.size
    spring = fit.matrices.reshape(2, motion.size, motion.size)[0]
    contributions = static_contributions(
        ModalForm(motion.poles, motion.felt, motion.participation[:, motion.size :] @ spring[:, :n])
    )
    if not ((contributions > -SETTINGS.beyond_structure) & (contributions < 1 + SETTINGS.beyond_structure)).all():
        return "its share of the load is none of a structure"
    if (contributions[_twins(fit)].sum(axis=1) < 1 + SETTINGS.beyond_structure).any():
        return IN_TWO
    return None


def missed(fit: ReleaseFit, units: Units, records: Sequence[ReleaseRecord]) -> float | None:
    """Frequency of an oscillation that the fitted modes do not explain [Hz], or None.

    That of the narrow peak in the residuals, or rather of the mode that a motion with one more has and the fit lacks,
    where the decays show it clearly: the residuals are that mode less what the others take of it, and may have no peak
    that is narrow.
    """
    peak = peak_of(fit, units, records)
    decays = decays_of(records, 0.0)
    if not decays or fit.internal >= MOST:
        return peak
    quick = quick_guess(decays, rate=records[0].rate, internal=fit.internal + 1)
    count = sum(decay.size for decay in decays)
    noise = np.min([record.noise for record in records], axis=0) / units.sizes
    left = np.vstack([linear.ringing for linear in fit.linears]) / noise
    if quick is None:
        return peak
    gain = count / 2 * float(np.log(np.mean(left**2) * count / quick.squares))
    motion = _motion_of(quick, fit.size)
    none = not _lightly_damped(motion, fit.size + fit.internal + 1)
    if none or gain < _by_chance(fit, fit.internal + 1, 1) + SETTINGS.evidence:
        return peak
    theirs = np.log(pairs(motion)[1])
    ours = np.log(pairs(fit.motion)[1] * units.rate)
    rows, _ = linear_sum_assignment(np.abs(theirs[:, None] - ours))
    others = np.delete(theirs, rows)
    if others.size != 1 or _rings_before(fit, float(np.exp(others[0])) / units.rate, units, records):
        return peak
    return float(np.exp(others[0])) / (2 * np.pi)


def peak_of(fit: ReleaseFit, units: Units, records: Sequence[ReleaseRecord]) -> float | None:
    """Frequency of the clearest narrow peak in the residuals after the edges [Hz]; None where they are as noise.

    The power of white noise, summed over r records, n components and w frequencies, is half a chi2 of 2 r n w degrees
    of freedom; its level is the median around, so that smoothly colored noise makes no peak. What may be
    products of modes is in the level, but not in the peaks.
    """
    count = min(len(linear.ringing) for linear in fit.linears)
    if count < 8 * max(SETTINGS.widths):
        return None
    whitener = whitener_of(fit.noise + ROUNDING**2 * np.eye(fit.size))
    power, beyond = np.zeros((2, count // 2))
    interval = float(np.median(np.diff(fit.segments[0].time)))
    products = _products(fit, count=count, interval=interval)
    for linear in fit.linears:
        left = linear.ringing[:count] @ whitener.T
        power += _power(left)
        beyond += _power(left - products @ (products.T @ left))
    level = median_filter(power / count, size=max(count // 32, 2 * max(SETTINGS.widths) + 1), mode="reflect")
    number = 2 * len(fit.linears) * fit.size
    level = np.maximum(level * number / (2 * gammaincinv(number / 2, 0.5)), SETTINGS.faint * number / 2)
    sums = np.concatenate([[0.0], np.cumsum((beyond / count / level)[: int(SETTINGS.top * power.size)])])
    best, place = float(np.log(SETTINGS.chance)), None
    for width in SETTINGS.widths:
        with np.errstate(divide="ignore"):
            chances = np.log(chdtrc(number * width, number * (sums[width:] - sums[:-width])))
        least = int(np.argmin(chances))
        if chances[least] < best:
            best, place = float(chances[least]), least + width // 2
    if place is None:
        return None
    line = 2 * np.pi * (place + 1) / (count * interval)
    return None if _rings_before(fit, line, units, records) else line * units.rate / (2 * np.pi)


def _power(values: Array) -> Array:
    """Power of all columns together at all frequencies but zero, for n of them shape (n // 2,)."""
    return np.asarray(np.sum(np.abs(np.fft.rfft(values, axis=0)[1 : len(values) // 2 + 1]) ** 2, axis=1))


def _products(fit: ReleaseFit, *, count: int, interval: float) -> Array:
    """Orthonormal basis of what products of two modes and magnitudes of one can look like, shape (count, k).

    What a calibration has left of terms such as X^2 and |X| rings at sums and differences of the modes, zero among
    them, and dies away with both, or with one. It is no further mode.
    """
    poles = fit.motion.poles[fit.motion.poles.imag > 0]
    pairs_of = [(one, other) for place, one in enumerate(poles) for other in poles[place:]]
    rates = [one + part for one, other in pairs_of for part in (other, other.conj())]
    rates += [part for one in poles for part in (one.real + 0j, 2j * one.imag + one.real)]
    waves = np.exp(np.outer(interval * np.arange(count), rates))
    basis, sizes, _ = np.linalg.svd(np.column_stack([np.ones(count), waves.real, waves.imag]), full_matrices=False)
    return basis[:, sizes > SETTINGS.independent * sizes[0]]


def _rings_before(fit: ReleaseFit, line: float, units: Units, records: Sequence[ReleaseRecord]) -> bool:
    """Whether a line is present before the releases too, as hum is, in intervals of equal length before and after."""
    before, after = 0.0, 0.0
    for segment, linear, record in zip(fit.segments, fit.linears, records, strict=True):
        held = int(np.searchsorted(segment.time, -margin_of(record, units)))
        if held and segment.time[held - 1] - segment.time[0] > 2 * (2 * np.pi / line):
            time = segment.time[-len(linear.ringing) :]
            before += _power_of(line, segment.time[:held], record.values[:held] / units.sizes, fit.noise)
            after += _power_of(line, time[:held], linear.ringing[:held], fit.noise)
    return before > SETTINGS.before * after > 0


def _power_of(line: float, time: Array, values: Array, noise: Array) -> float:
    """Sum of squared amplitudes of a line over the noise, less its expectation under noise alone [1]."""
    waves = np.column_stack([np.cos(line * time), np.sin(line * time), np.ones(time.size)])
    sizes = np.linalg.lstsq(waves, values @ whitener_of(noise).T, rcond=None)[0][:2]
    return float(np.sum(sizes**2) - 4 * values.shape[1] / time.size)
