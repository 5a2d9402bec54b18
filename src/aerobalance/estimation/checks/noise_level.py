"""Noise that a run has and its channel, or the record of noise, does not state."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from aerobalance.estimation.prior import BESIDE_A_GAP, Observation, evidence_of_prior, fit_prior
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.spectra.noise_floor import lasts
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
    ratio = departure_of(reading, stated=stated) if record.shared is None else None
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
    chance = float(np.sqrt(2 / np.count_nonzero(reading.present)))
    if abs(np.log(ratio)) < max(DEPARTURE, 6 * chance):
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
