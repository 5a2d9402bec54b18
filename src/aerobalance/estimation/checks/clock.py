"""Whether the times of a record can be right, by the natural frequencies of the balance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from aerobalance.estimation.spectra.windows import INSIDE, density_of, length_of
from aerobalance.recording.errors import FitError, argument
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps

OTHER_UNITS: Final = {"ms": 1e3, "us": 1e6}
"""Units of time that are taken for seconds, and how many of them make one."""

SAME_FREQUENCY: Final = 0.02
"""Relative difference up to which a peak is taken for a mode of the dynamics, if its width and the record's resolution
are no more."""

WIDTH: Final = 2.5
"""The same in damping ratios of the mode: as a load is stronger at one frequency than at the next, the largest
ordinate was up to 2.1 of them off in 40 records."""

WIDEST: Final = 0.2
"""The same at most: what is beside a peak begins there."""

SURROUNDINGS: Final = 0.5
"""Share of half the rate below which there are readings on both sides of a peak."""

FEWEST_PERIODS: Final = 20
"""Periods of a mode in a record from which its peak stands out from what is beside it."""

RESOLVED: Final = 1.5
"""Distance of a mode from the next ordinate and its neighbour at most, in ordinates."""

PEAK: Final = 30.0
"""Power of a peak over the median of what is beside it: noise reaches it in an ordinate with 0.5^30 = 1e-9."""


def check_clock(
    recording: Recording, component: str, *, channels: Sequence[str], modes: Sequence[tuple[float, float]]
) -> None:
    """Refuse a record shorter than one period of the balance, or whose times are in another unit than they say.

    Parameters
    ----------
    recording
        The record, or a part of it.
    component
        Which component is the slowest, in words.
    channels
        Channels of the balance loads.
    modes
        Natural frequency [Hz] and damping ratio [1] of each mode of the dynamics.

    Raises
    ------
    FitError
        It is, by a wrong clock or wrong dynamics; or the natural frequencies are above half the rate and the loads
        ring at a thousandth or a millionth of one of them.
    """
    whole, frequency = recording.whole_duration, min(frequency for frequency, _ in modes)
    if whole * frequency < 1:
        raise FitError(
            f"{recording.name}: the record takes {whole:.3g} s ({recording.rate:.6g} samples a second), less than one "
            f"period of {component}, {1 / frequency:.3g} s ({frequency:.4g} Hz): check the unit of the time and the "
            "dynamics"
        )
    if frequency <= recording.rate / 2:
        return
    for unit, factor in OTHER_UNITS.items():
        for name in channels:
            for own, ratio in modes:
                if _rings_at(recording, name, own / factor, width=WIDTH * ratio):
                    raise FitError(
                        f"{recording.name}: {name} rings at {own / factor:.4g} Hz by a clock of {recording.rate:.6g} "
                        f"samples a second. That is 1/{factor:.0f} of a natural frequency of the dynamics, "
                        f"{own:.4g} Hz, and this is above half the rate: the times are in {unit} and are taken for s. "
                        f'Write their unit [{unit}] in the header, or put time_unit = "{unit}" under [file] of a '
                        f"channel map ({argument('channel_map')}), which `aerobalance map FILE` makes; or give "
                        "the right sampling rate"
                    )


def _rings_at(recording: Recording, name: str, frequency: float, *, width: float) -> bool:
    """Whether a load has a peak at a frequency [Hz], or so far from it, that chance does not make."""
    interval = 1 / recording.rate
    if not FEWEST_PERIODS / recording.whole_duration < frequency < SURROUNDINGS * recording.rate / 2:
        return False
    values = interpolate_gaps(recording.channel(name).values[:, None])[:, 0]
    density = density_of(values - values.mean(), interval)
    place = np.fft.rfftfreq(length_of(values.size), interval)[INSIDE] / frequency
    near = min(max(SAME_FREQUENCY, width, RESOLVED / (recording.whole_duration * frequency)), WIDEST)
    peak = density[np.abs(place - 1) < near]
    beside = density[((place > 0.5) & (place < 0.8)) | ((place > 1.25) & (place < 2.0))]
    if not (peak.size and beside.size and peak.max() > PEAK * np.median(beside)):
        return False
    # one of the harmonics of what is repeated, as steps of the attitude are, is not the largest about it
    return bool(peak.max() == density[(place > 1 / 3.5) & (place < 3.5)].max())
