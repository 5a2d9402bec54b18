"""The sampling clock on which the forces of a long record are estimated: slower than its own where nothing is lost.

A balance that rings at 300 Hz is recorded at 25 kHz, for the sake of its steps and of the filters. Above some multiple
of the highest natural frequency the readings then hold nothing but noise and tell nothing of a force. White noise
stays white on the slower clock (`aerobalance.recording.decimation`), the load in the band does not change, and the
response to a step is filtered as the readings are, so that prior, likelihood and uncertainty are the same. The cost of
an estimate is proportional to the number of samples, and is smaller by the ratio of the clocks.

All of the record is examined first: where the load has frequencies above that band, or its gaps are very many, the
record keeps its clock. A record that is one part and has few gaps keeps it too (`aerobalance.estimation.force`). Gaps
are where samples are missing, wild, stuck or clipped: short ones are filled before they are decimated
(`aerobalance.recording.short_gaps`), and long ones are gaps of the slower clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.balance.loads import Loads
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.estimation.record_look import SETTINGS as LOOK
from aerobalance.estimation.record_look import Look, Piece
from aerobalance.estimation.working_record import AT_ONCE, DecimatedRecord, Given, MadeReady
from aerobalance.recording.components import is_gauge
from aerobalance.recording.decimation import ROLL_OFF, Decimation
from aerobalance.recording.errors import FitError, kept_warnings
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.parts import LongRecord
from aerobalance.recording.sensors import undone_with
from aerobalance.recording.side_by_side import side_by_side


@dataclass(frozen=True, slots=True)
class WorkingClockSettings:
    """When the forces of a record are estimated on a slower clock, and on which.

    Attributes
    ----------
    periods
        Least pass band of the decimation filter over the highest natural frequency [1].
    beyond
        Least pass band over the highest frequency at which the load is above the noise [1].
    factors
        Factors by which the clock may be slower, largest first; four at least, or little is gained.
    further_for_gaps
        Further ones of a record with many gaps, whose own smoother needs far more for each than for a sample.
    """

    periods: float = 2.1
    beyond: float = 1.5
    factors: tuple[int, ...] = (16, 15, 14, 12, 10, 9, 8, 7, 6, 5, 4)
    further_for_gaps: tuple[int, ...] = (3, 2)


SETTINGS: Final = WorkingClockSettings()
"""The settings in use."""


def slower_clock(
    record: LongRecord[Given], dynamics: BalanceDynamics, made_ready: MadeReady, *, gaps: bool = False
) -> DecimatedRecord | None:
    """Return a record on the slowest clock that keeps all of its load; None where that is its own clock.

    Parameters
    ----------
    record
        The record.
    dynamics
        Dynamics of the balance.
    made_ready
        Converts samples that are gauge outputs to balance loads.
    gaps
        Whether the record has many gaps.
    """
    highest = max(mode.natural_frequency for mode in dynamics.modes)
    factors = SETTINGS.factors + (SETTINGS.further_for_gaps if gaps else ())
    fitting = [one for one in factors if _band(record.rate, one) >= SETTINGS.periods * highest]
    if not fitting:
        return None
    modes = tuple(mode.natural_frequency for mode in dynamics.modes)
    look = Look(record.rate, above=_band(record.rate, fitting[0]), modes=modes, factor=fitting[0])
    try:
        with kept_warnings():  # given when the forces are estimated
            begins, length = _pieces(record.samples)
            first = record.part(0, length)
            noise = _noise_of_gauges(first)
            beside = undone_with(first.recording if isinstance(first, Loads) else first)
            del first

            def looked(begin: int) -> Piece:
                given = made_ready(_with_noise(record.part(begin, begin + length), noise))
                return look.at(given, dynamics.components)

            look.add(side_by_side(looked, begins, what="look"))
    except FitError:
        return None  # raised again, with its reason, when the forces are estimated
    for factor in fitting:
        band = _band(record.rate, factor)
        if band >= SETTINGS.beyond * look.highest and look.gaps_allow(factor) and look.ends_allow(band):
            return DecimatedRecord(
                record, made_ready, Decimation(factor, record.samples), dynamics.components, look.shown, beside
            )
    return None


def _band(rate: float, factor: int) -> float:
    """Pass band of the decimation by a factor: its filter has a gain of 1 up to there [Hz]."""
    return (1 - ROLL_OFF) * rate / (2 * factor)


def _noise_of_gauges(given: Given) -> dict[str, float]:
    """Noise of one reading of each gauge output, judged from the first piece for the look at all of them."""
    if isinstance(given, Loads):
        return {}
    gauges = [channel for channel in given if is_gauge(channel.name) and np.isfinite(channel.values).all()]
    return {channel.name: noise for channel in gauges if (noise := channel_noise(channel)) > 0}


def _with_noise(given: Given, noise: Mapping[str, float]) -> Given:
    """The readings with the noise of their gauge outputs, which is not judged from them again."""
    if isinstance(given, Loads) or not noise:
        return given
    known = {name: replace(one, noise=noise.get(name, one.noise)) for name, one in given.channels.items()}
    return replace(given, channels=known)


def _pieces(samples: int) -> tuple[list[int], int]:
    """First samples of the pieces in which a record is examined, and their length; they overlap by a segment."""
    length = min(AT_ONCE, samples)
    begins = [*range(0, samples - length + 1, max(length - LOOK.segment, 1) if samples > length else 1)]
    if begins[-1] + length < samples:
        begins.append(samples - length)
    return begins, length
