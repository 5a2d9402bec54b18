"""Noise that a run has and its channel, or the record of noise, does not state."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from aerobalance.estimation.prior import Observation
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.spectra.noise_floor import departure_of
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt

TOLD: Final = 0.7
"""Logarithm of the ratio of powers from which on it is told that a channel states another noise than the run has: of
less a number rounded to one digit may be off."""


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
