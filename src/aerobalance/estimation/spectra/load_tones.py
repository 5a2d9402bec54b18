r"""Steady tones of a load: a shaker, a rotor and its harmonics, as lines of known frequency and unknown size.

A load that repeats exactly has a spectrum of lines, which no spectrum of a few states follows, and in which nothing
but a line has power. As sine and cosine each is found to the size that the noise leaves, sigma sqrt(2 / n) over |G|.
Where the balance weakens a force, what looks like a line may as well be of the electronics: there only those count
that are harmonics of lines seen where it does not.

A rotor's speed drifts. Its harmonics are then steady in the time that its rotation tells, which the phase of the
strongest of them does; the readings are looked at in that time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import zip_longest
from math import log, log1p
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.spectra.line_noise import MAINS
from aerobalance.estimation.spectra.line_search import TURNS, LineSearch
from aerobalance.estimation.spectra.lines import turned_time
from aerobalance.estimation.spectra.rotor_drift import drift_of, drift_together
from aerobalance.estimation.spectra.steady_tones import WIDTH
from aerobalance.recording.channel import Array

EVIDENCE_OF_HARMONIC: Final = (12.0, 20.0)
"""The same of a harmonic, whose frequency is known, next to one that is seen and beyond one that is not: exp(-12 / 3)
and exp(-20 / 3) by chance, which costs as much as noise leaves of a size."""

ENDED: Final = 3
"""Harmonics one after the other that are not seen, from which on there are no more."""

MOST: Final = 40
"""Tones at most: a load that has more is no sum of a few, as a square wave."""

MOST_NUMBERS: Final = 1 << 21
"""Samples times tones at most."""

LOWEST: Final = 6.0
"""Periods in the record from which on a tone is one."""

HIGHEST: Final = 0.4
"""Frequency over the sampling rate up to which tones are looked for."""

BESIDE_A_MODE: Final = (4.0, 3.0)
"""Distance from a natural frequency, in half widths of the resonance and in ordinates, within which a line may be a
free oscillation."""

WEAKENED: Final = 1.0
"""Square of the response below which a line counts as a harmonic alone."""

GOES_ON: Final = 5.0
"""Odds that the harmonics go on, before those that are not seen are looked at: as those of a load with kinks, whose
next one is as faint as noise. A rotor's that would be far above it are at their end."""

JUMPS: Final = 1.5
"""Power of frequency by which harmonics of a load with jumps fall at most: by 1, and those of one with kinks by 2."""

PARTS: Final = 12
"""Highest harmonic that the strongest tone is taken for, and most harmonics of a load without a jump where the highest
of all is seen."""

NEAR_MAINS: Final = 0.01
"""Distance from 50 or 60 Hz and their harmonics, over these, within which a line may be hum that drifts: there only
harmonics of a load of two tones or more count."""

SAME: Final = (0.2, 0.5)
"""Distance of a tone from a harmonic, in ordinates, up to which it is that: of a strong one, and of a faint one."""

FAINT: Final = 0.1
"""Amplitude in the reading over the largest, up to which a tone is faint."""

NO_STRONGER: Final = 2.0
"""Force at a harmonic over the largest of those below it, at most."""

SEVERAL: Final = 2
"""Tones from which on they are harmonics of a rotation, which all drift alike."""


class LoadTones(NamedTuple):
    """Steady tones of a load.

    Attributes
    ----------
    frequencies
        Of those that are seen, in rising order [Hz].
    hidden
        Force of further harmonics that noise may hide, rms [N].
    drift
        How they drift along the record (`aerobalance.estimation.spectra.lines.turned_time`).
    """

    frequencies: tuple[float, ...] = ()
    hidden: float = 0.0
    drift: tuple[float, ...] = ()


def load_tones(
    values: Array, interval: float, dynamics: ModalModel, *, hum: Sequence[float] = (), may_drift: bool = False
) -> LoadTones:
    """Return the frequencies of the steady tones of a load [Hz]; none where it has more than a few.

    Parameters
    ----------
    values
        Readings without gaps, shape (n,) [N].
    interval
        Time between samples [s].
    dynamics
        The balance.
    hum
        Frequencies of lines that are taken for hum [Hz].
    may_drift
        Whether they are looked for as those of a rotation whose speed drifts as well.
    """

    def drift_in(tones: LoadTones, left: LineSearch) -> tuple[float, ...]:
        # of one line alone the spectrum of the force shows all; a rotation has several
        rates = [2 * np.pi * frequency * interval for frequency in tones.frequencies]
        return drift_of(left) or (drift_together(left, rates) if len(rates) >= SEVERAL else ())

    steady, left = _tones_in(values, interval, dynamics, hum=hum)
    more = drift_in(steady, left) if may_drift else ()
    if not more:
        return steady
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - takes 30 ms, and few records need it

    drift: tuple[float, ...] = ()
    drifting, beside, readings = steady, left, CubicSpline(left.time, values)
    # in the time of the rotation a line that was spread is narrow, and tells what is left of the drift
    for _ in range(TURNS):
        drift = tuple(one + other for one, other in zip_longest(drift, more, fillvalue=0.0))
        turned, _rate = turned_time(drift, count=values.size, interval=1.0)
        drifting, beside = _tones_in(readings(np.interp(left.time, turned, left.time)), interval, dynamics, hum=hum)
        more = drift_in(drifting, beside)
        if not more:
            break
    if len(drifting.frequencies) < SEVERAL or beside.power > left.power:
        return steady
    return drifting._replace(drift=drift)


def near_mains(frequency: Array, *, ordinate: float) -> NDArray[np.bool_]:
    """Whether lines at some frequencies may be hum that drifts, of their shape.

    Parameters
    ----------
    frequency
        The frequencies [Hz].
    ordinate
        What the record resolves [Hz].
    """
    near = np.zeros(np.shape(frequency), dtype=np.bool_)
    for mains in MAINS:
        harmonic = mains * np.maximum(np.rint(frequency / mains), 1)
        near |= np.abs(frequency - harmonic) <= np.maximum(NEAR_MAINS * harmonic, WIDTH * ordinate)
    return near


def _tones_in(
    values: Array, interval: float, dynamics: ModalModel, *, hum: Sequence[float]
) -> tuple[LoadTones, LineSearch]:
    """The tones that are steady in some readings, shape (n,), and what they leave; the rest as of `load_tones`."""
    count, ordinate = values.size, 1 / (values.size * interval)
    most, highest = min(MOST, MOST_NUMBERS // count), HIGHEST / interval

    def may_be(frequency: Array, *, of_mains: bool = False) -> NDArray[np.bool_]:
        allowed = (frequency > LOWEST * ordinate) & (frequency < highest)
        for one in hum:
            allowed &= np.abs(frequency - one) > WIDTH * ordinate
        for mode in dynamics.modes:
            width = max(BESIDE_A_MODE[0] * mode.damping_ratio * mode.natural_frequency, BESIDE_A_MODE[1] * ordinate)
            allowed &= np.abs(frequency - mode.natural_frequency) > width
        return np.asarray(allowed if of_mains else allowed & ~near_mains(frequency, ordinate=ordinate))

    every = np.asarray(np.arange(count // 2 + 1) * ordinate, dtype=np.float64)
    left = LineSearch.of(values - values.mean(), may_be(every), np.abs(dynamics.response(every)) ** 2)
    while len(left.tones) <= most and left.take_next():
        pass
    if not left.tones or len(left.tones) > most:
        return LoadTones(), left
    left.refine()
    found = np.array([tone.rate for tone in left.tones]) / (2 * np.pi * interval)
    gain = np.abs(dynamics.response(found))
    forces = np.array([tone.amplitude for tone in left.tones]) / gain
    clear = gain**2 >= WEAKENED
    known, strength = found[clear], forces[clear]
    fundamental = _fundamental(known, strength, shown=strength * gain[clear], ordinate=ordinate)
    if fundamental is None:
        return LoadTones(tuple(sorted(known.tolist()))), left

    def shown(at: float) -> tuple[float, float]:
        """Force at a harmonic [N], and its evidence [1]."""
        among = np.flatnonzero(np.abs(found - at) < ordinate)
        if among.size:
            return float(forces[among[0]]), np.inf
        amplitude, evidence = left.at(2 * np.pi * at * interval)
        return amplitude / float(np.abs(dynamics.response(np.array([at])))[0]), evidence

    # a load that is the same upwards and downwards has odd harmonics alone
    odd = known.size > 1 and bool((np.rint(known / fundamental) % 2 == 1).all())
    apart = 2 if odd else 1
    harmonics = np.asarray(fundamental * np.arange(1, int(highest / fundamental) + 1, apart), dtype=np.float64)
    harmonics = harmonics[may_be(harmonics, of_mains=known.size > 1)]
    series = _series(harmonics, shown, apart=apart * fundamental, most=NO_STRONGER * float(strength.max()))
    return (series if len(series.frequencies) <= most else LoadTones()), left


def _series(
    harmonics: Array, shown: Callable[[float], tuple[float, float]], *, apart: float, most: float
) -> LoadTones:
    """The harmonics of a load that are seen, up to where they end.

    Parameters
    ----------
    harmonics
        Frequencies at which they may be, shape (m,) [Hz].
    shown
        Gives the force at one [N] and its evidence [1].
    apart
        Distance of neighbours [Hz].
    most
        Largest force that is taken for one of them [N].
    """
    taken, forces = list[float](), list[float]()
    hidden, expected, missed, odds = 0.0, 0.0, 0, log(GOES_ON)
    for at in harmonics.tolist():
        force, evidence = shown(at)
        if evidence > EVIDENCE_OF_HARMONIC[missed > 0] and 0 < force <= most:
            taken.append(at)
            forces.append(force)
            missed, odds = 0, log(GOES_ON)
        elif taken:
            missed += 1
            falls = forces[-1] * (taken[-1] / at) ** 2  # as those of a load with kinks
            if np.isfinite(evidence):  # a line that is too strong for a harmonic hides whether there is one
                # power over that of noise, which has an exponential distribution: of noise alone, and of what falls so
                power = evidence / 3
                ratio = power * falls**2 / max(force**2, 1e-300)
                odds += power * ratio / (1 + ratio) - log1p(ratio)
            expected += falls**2 / 2
            hidden += float(expit(odds)) * min(force, falls) ** 2 / 2
            if missed == ENDED:
                # all beyond, the sum of n^-4, as far as the ones that are looked at may be there
                hidden += hidden / expected * falls**2 / 2 * at / (3 * apart)
                break
    middle = len(taken) // 2  # noise makes no difference yet
    if len(taken) > PARTS and (missed == 0 or forces[middle] > forces[0] * (taken[0] / taken[middle]) ** JUMPS):
        return LoadTones()  # a load that jumps has harmonics beyond all frequencies
    return LoadTones(tuple(taken), float(np.sqrt(hidden)))


def _fundamental(tones: Array, strength: Array, *, shown: Array, ordinate: float) -> float | None:
    """The largest frequency of which all tones are multiples [Hz]; None where there is none.

    Parameters
    ----------
    tones
        Frequencies, shape (m,) [Hz].
    strength, shown
        Their forces, of which the strongest is one of the lowest harmonics, and amplitudes in the reading, (m,) [N].
    ordinate
        What the record resolves [Hz].
    """
    if not tones.size:
        return None
    leader = float(tones[np.argmax(strength)])
    for number in range(1, PARTS + 1):
        numbers = np.rint(tones * number / leader)
        if leader / number < LOWEST * ordinate:
            return None
        if (numbers < 1).any():
            continue
        # the strongest and the highest tell it best
        weight = (numbers * shown) ** 2
        refined = float(np.sum(weight * tones / numbers) / np.sum(weight))
        reach = np.where(shown > FAINT * shown.max(), *SAME) * ordinate
        if np.all(np.abs(tones - numbers * refined) < reach):
            return refined
    return None
