"""The paper's own procedure on a free decay: damping from the extrema, stiffness from their spacing.

It stands beside the waveform fit as a reference. Noise rectifies in the extrema, which makes the damping low.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.dynamics.single import extremum_ratio, stiffness_from_damped_frequency
from aerobalance.identification.free_decay.fit import DecayFit
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording

CLEAR: Final = 5.0
"""Extrema are used while they stand this many times above the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class ExtremaFit:
    """Stiffness and damping from the extrema of a free decay.

    Attributes
    ----------
    frequency
        Frequency of free oscillation [Hz].
    stiffness
        By (20) from that frequency [N/m; N for a moment].
    damping
        By (7) from the logarithms of the extrema [N*s/m; N*s for a moment].
    instants, extrema
        The extrema used, on the recording's clock, shape (m,) [s] and [N; N*m].
    fitted
        What (7) gives for them [N; N*m].
    """

    frequency: float
    stiffness: float
    damping: float
    instants: Array
    extrema: Array
    fitted: Array


def extrema_fit(recording: Recording, fit: DecayFit) -> ExtremaFit:
    """Work the paper's procedure on the window of a waveform fit.

    Raises
    ------
    FitError
        Fewer than four extrema stand clear of the noise.
    """
    dynamics = fit.dynamics
    load = recording.channel(dynamics.component).values
    begin = fit.release[0] + fit.release_duration if fit.release else fit.window[0]
    inside = (recording.time > begin) & (recording.time <= fit.window[1]) & np.isfinite(load)
    time, values = recording.time[inside], load[inside]
    values = values - values[values.size // 2 :].mean()
    half = 0.5 / fit.damped_frequency
    if fit.release is None:
        begin = _extremum_before(time, values, begin, decay=fit.decay_rate, w=2 * np.pi * fit.damped_frequency)
    # windows between zero crossings: extrema lie on multiples of half a period after a release from rest
    numbers = np.floor((time - begin) / half + 0.5).astype(int)
    level = CLEAR * fit.residual_deviation
    places = []
    for number in np.unique(numbers[numbers > 0]):
        block = np.flatnonzero(numbers == number)
        place = int(block[np.argmax(np.abs(values[block]))])
        if abs(values[place]) < level:
            break
        if 0 < place < values.size - 1:
            places.append((number, *_vertex(time[place - 1 : place + 2], values[place - 1 : place + 2])))
    if len(places) < 4:
        raise FitError(f"{recording.name}: {len(places)} extrema stand clear of the noise; (7) needs at least four")
    number, instant, extremum = np.array(places).T
    spacing = np.polyfit(number, instant, 1)[0]
    slope, start = np.polyfit(number, np.log(np.abs(extremum)), 1)
    damping = -2 * dynamics.mass * slope / spacing
    frequency = 0.5 / spacing
    ratio = extremum_ratio(damping, dynamics.mass, 2 * spacing, number)
    return ExtremaFit(
        frequency=float(frequency),
        stiffness=stiffness_from_damped_frequency(float(frequency), dynamics.mass, float(damping)),
        damping=float(damping),
        instants=instant,
        extrema=extremum,
        fitted=np.sign(extremum) * np.exp(start) * ratio,
    )


def _extremum_before(time: Array, values: Array, begin: float, *, decay: float, w: float) -> float:
    """Last extremum, at or before an instant, of a ringing of any phase [s].

    It is a part of exp(-decay t) cos(w t + phase), whose slope is nothing where w t + phase = -atan(decay / w).
    """
    since = time - begin
    fall = np.exp(-decay * since)
    cosine, sine = np.linalg.lstsq(np.column_stack([fall * np.cos(w * since), -fall * np.sin(w * since)]), values)[0]
    phase = np.arctan2(sine, cosine) + np.arctan(decay / w)
    return begin - float(phase % np.pi) / w


def _vertex(time: Array, values: Array) -> tuple[float, float]:
    """Vertex of the parabola through three samples."""
    left, middle, right = values
    curve = left - 2 * middle + right
    shift = 0.5 * (left - right) / curve if curve else 0.0
    return float(time[1] + shift * (time[1] - time[0])), float(middle - 0.25 * (left - right) * shift)
