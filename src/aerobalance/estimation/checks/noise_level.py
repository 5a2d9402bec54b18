"""Noise that a run has and its channel, or the record of noise, does not state."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from scipy.special import gammaincinv

from aerobalance.estimation.observation import Observation
from aerobalance.estimation.prior import BESIDE_A_GAP, evidence_of_prior, fit_prior, periodogram_of
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.spectra.noise_floor import lasts
from aerobalance.estimation.spectra.piecewise_psd import WEAKENED
from aerobalance.estimation.spectra.windows import share_seen
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.resampling import interpolate_gaps_linearly

TOLD: Final = 0.7
"""Logarithm of the ratio of powers from which on it is told that a channel states another noise than the run has: of
less a number rounded to one digit may be off."""

STATED_EVIDENCE: Final = 25.0
"""Gain in log-likelihood of the innovations for which the level of a run's noise is that of the run, where its channel
states another: a force that reaches half the sampling rate looks like noise by its level alone."""

NO_NOISE: Final = 1e-6
"""Noise over the largest reading below which they are computed: what is stated of their noise then holds."""

FAST: Final = 0.375
"""Frequency over the sampling rate from which on it is looked whether noise above what was stated lasts all along."""

COMPARED: Final = 1024
"""Frequencies at which the white part of a noise is compared with its color."""

DEPARTURE: Final = 0.2
"""Logarithm of the ratio of powers above which the noise of a run differs from that of the record of noise."""


def with_noise_level(record: ComponentRecord) -> tuple[Observation, tuple[Doubt, ...]]:
    """Return the reading, with the noise that was given unless its white part is not the run's, and what is told.

    Parameters
    ----------
    record
        The component made ready.
    """
    reading, stated = record.reading(), record.noise is None
    if stated and record.recording.from_outputs:
        return reading, ()  # nobody has stated it: it is what calibration and zero leave of the gauge outputs
    if record.shared is not None:
        return reading, ()
    louder = None if stated else _louder(reading)
    if louder is not None:
        name, told = record.dynamics.component, f"{louder.ratio:.2g}"
        text = (
            f"the noise of {name} has {told} times the power that it has in the record of noise, all of it alike, as "
            "another gain or unit would make it; its level is judged from the run"
        )
        return louder.reading, (Doubt("noise level", name, text, effect=None, unit=si_unit(name)),)
    ratio = departure_of(reading, stated=stated)
    if ratio is None:
        return reading, ()
    judged = replace(reading, noise=None)
    if stated and abs(np.log(ratio)) < TOLD:
        return judged, ()
    name = record.dynamics.component
    unit, text = si_unit(name), f"the white noise of {name} has {ratio:.2g} times the power that "
    if stated:
        text += (
            f"its channel states ({reading.noise:.3g} {unit} a reading), as another gain or unit, or a force of a "
            "very wide band, would make it; it is judged from the run"
        )
    else:
        text += (
            "it has in the record of noise, as another gain, filter or cabling, or a force of a very wide band, would "
            "make it; it is judged from the run, and what the noise has beyond white is taken as recorded"
        )
    return judged, (Doubt("noise level", name, text, effect=0.0 if stated else None, unit=unit),)


class _Louder(NamedTuple):
    """A reading all of whose noise is stronger or weaker than recorded, and by which ratio of powers."""

    reading: Observation
    ratio: float


def _louder(reading: Observation) -> _Louder | None:
    """The reading with all of its noise by one ratio from that recorded; None where that is not clearly likelier.

    Another gain changes all of the noise: what a band has beyond the record of noise would be taken for force, and of
    the white part beside it alone a run may tell little.
    """
    if reading.color is None or reading.noise is None:
        return None
    left = interpolate_gaps_linearly(reading.values, beside=BESIDE_A_GAP)
    share = share_seen(reading.present)
    periodogram = periodogram_of(reading, left - left.mean(), share=share)
    weakened = periodogram.gain < WEAKENED
    if not weakened.any():
        return None
    density = share * reading.noise**2 * reading.interval
    # a force is in few of these frequencies, or the noise is likelier as recorded
    weight = periodogram.weight[weakened]
    ratios = (periodogram.density / periodogram.background(density))[weakened] * weight / gammaincinv(weight, 0.5)
    ratio = float(np.median(ratios))
    if not abs(np.log(ratio)) > DEPARTURE:
        return None
    constant = np.ones((reading.values.size, 1))
    other = replace(reading, noise=float(np.sqrt(ratio)) * reading.noise, color=reading.color.scaled(ratio))
    free = replace(reading, noise=None)
    alike, recorded, apart = (
        evidence_of_prior(one, fit_prior(one, columns=constant), columns=constant) for one in (other, reading, free)
    )
    # that the white part alone is another, and a force the rest, takes more numbers, whose price is paid
    return _Louder(other, ratio) if alike > max(recorded + STATED_EVIDENCE, apart) else None


def departure_of(reading: Observation, *, stated: bool = False) -> float | None:
    """Power of a run's white noise over that of the noise that was given for it [1]; None where they agree.

    Where they do not, the noise of the run has to be learned from the run: if it were taken as given, what is beyond
    it would be taken for force.

    Parameters
    ----------
    reading
        The run, with the noise that was given.
    stated
        Whether that is a number, and not from a record of noise: the run must then be clearly likelier without it.
    """
    if reading.noise is None:
        return None
    constant = np.ones((reading.values.size, 1))
    own = replace(reading, noise=None)
    free = fit_prior(own, columns=constant)
    ratio = (free.noise / max(reading.noise, reading.least_noise)) ** 2
    # beside a color that is nowhere faint a run tells little of the white part, and it does not matter
    share, seen = _share_of_white(reading, reading.noise), _share_of_white(reading, max(reading.noise, free.noise))
    chance = float(seen.max() * np.sqrt(2 / (np.count_nonzero(reading.present) * np.mean(seen**2))))
    if abs(np.log1p(float(share.max()) * (ratio - 1))) < max(DEPARTURE, 6 * chance):
        return None
    if stated:
        if free.noise < NO_NOISE * float(np.nanmax(np.abs(reading.values))):
            return None
        left = interpolate_gaps_linearly(reading.values, beside=BESIDE_A_GAP)
        first = FAST / reading.interval
        if ratio > 1 and not lasts(left, first=first, interval=reading.interval, noise=reading.noise):
            return None
        held = fit_prior(reading, columns=constant)
        gain = evidence_of_prior(own, free, columns=constant) - evidence_of_prior(reading, held, columns=constant)
        if gain < STATED_EVIDENCE:
            return None
    return ratio


def _share_of_white(reading: Observation, noise: float) -> Array:
    """Share of a white part in the noise, over all frequencies [1], shape (COMPARED,)."""
    if reading.color is None:
        return np.ones(COMPARED)
    frequency = np.linspace(0, 0.5 / reading.interval, COMPARED + 1)[1:]
    white = max(noise, reading.least_noise) ** 2 * reading.interval
    return np.asarray(white / (white + reading.color.density(frequency, width=float(frequency[0]))))
