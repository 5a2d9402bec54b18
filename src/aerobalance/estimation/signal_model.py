"""What a record is made of: hum, steps and tones of the force, and the spectral prior of the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.resonance import gain_in_white_noise
from aerobalance.estimation.force_smoother import instant_columns
from aerobalance.estimation.least_squares import generalised_least_squares, least_squares, log_likelihood
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import bridged, ends_differ, evenly_weighted, fit_prior
from aerobalance.estimation.spectra.line_noise import Hum, hum_lines, load_harmonics
from aerobalance.estimation.spectra.lines import Line
from aerobalance.estimation.spectra.load_tones import LoadTones, load_tones
from aerobalance.estimation.spectra.noise_floor import Floor, with_floor
from aerobalance.estimation.spectra.slow_noise import SlowNoise, slow_noise_of
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.step_search import StepSearch
from aerobalance.estimation.steps import Step, columns_of
from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import interpolate_gaps_linearly

LARGEST_HUM: Final = 0.1
"""Amplitude of a line over half the span of the readings above which it is no hum but what was recorded."""

SAME_LINE: Final = 0.02
"""Change of a line's frequency in ordinates for which the steps are not looked for again."""

COMPARED: Final = 257
"""Frequencies at which two noises are compared."""

SAME_NOISE: Final = 0.3
"""Logarithm of the ratio of two densities of noise up to which the steps are not looked for again."""

WHOLE: Final = 0.98
"""Share of a record that is read, from which on tones are looked for, straight lines in its gaps."""

CLEAR: Final = 30.0
"""Amplitude of a tone over its standard uncertainty from which on it is given a frequency of its own."""

MOST_TUNED: Final = 0.1
"""Change of a tone's frequency beside all else at most [ordinates]."""


@dataclass(frozen=True, slots=True, eq=False)
class SignalModel:
    """What a record is made of.

    Attributes
    ----------
    reading
        The record, its hum named.
    steps
        The steps of the force.
    learned
        The prior of what else the force does, and the noise.
    hum
        Lines that are taken for hum.
    large
        Lines at frequencies of the mains that are too large a part of the record to be taken for hum.
    floor
        What may be a color of the noise, far above the natural frequency; None if there is nothing.
    slow
        Noise that may rise at low frequency; None if there is nothing.
    ended
        The search for steps, where it ended before all were found; else None.
    of_load
        Lines at frequencies of the mains that are harmonics of a load that repeats.
    bends
        Instants of sudden changes of the force's slope [s].
    hidden
        Force of harmonics of a load that noise may hide, rms [N].
    """

    reading: Observation
    steps: list[Step]
    learned: SpectralPrior
    hum: tuple[Line, ...]
    large: tuple[Line, ...]
    floor: Floor | None = None
    slow: SlowNoise | None = None
    ended: StepSearch | None = None
    of_load: tuple[Line, ...] = ()
    bends: tuple[float, ...] = ()
    hidden: float = 0.0


class _MainsLines(NamedTuple):
    """Lines of the mains: those of hum, those that are too large for it, and harmonics of a load that repeats."""

    hum: tuple[Line, ...]
    large: tuple[Line, ...] = ()
    of_load: tuple[Line, ...] = ()


def fit_signal_model(reading: Observation, *, hum: Hum, resolution: float | None = None) -> SignalModel:
    """Find hum, steps and prior of a record.

    Steps ring over a wide band and hide weak lines and the color of the noise, so both are looked for again when the
    steps are known.

    Parameters
    ----------
    reading
        The record.
    hum
        What is to be taken for hum.
    resolution
        Step of its converter [N], where it is the reading of one channel: its noise may then rise at low frequency.
        None where it is decoupled from other components, as what is left of these may rise as well.
    """
    mains = _hum_of(reading, reading.values, hum)
    fitted = partial(_fitted, mains=mains, hum=hum, resolution=resolution)
    tones, present = LoadTones(), np.flatnonzero(reading.present)
    within = slice(int(present[0]), int(present[-1]) + 1) if present.size else slice(0, 0)
    if present.size >= WHOLE * (within.stop - within.start) > 0:
        lines, shown = tuple(line.frequency for line in mains.hum), interpolate_gaps_linearly(reading.values[within])
        whole = shown.size == reading.values.size
        tones = load_tones(shown, reading.interval, reading.dynamics, hum=lines, may_drift=whole)
    if not tones.frequencies:
        return fitted(reading)
    named = replace(reading, tones=tones.frequencies, drift=tones.drift)
    tonal = _tuned(replace(fitted(named), hidden=tones.hidden))
    if not tonal.steps:
        return tonal
    # a square wave shows some tones as well, and the steps that it is made of are likelier
    plain = fitted(reading)
    return max(tonal, plain, key=_evidence)


def _tuned(signal: SignalModel) -> SignalModel:
    """The same with the tones at the frequencies that the readings want beside all else.

    A line that grows along the record is one at another frequency to first order: (T / 2) dw of cosine and sine.
    """
    reading, number = signal.reading, len(signal.reading.tones)
    columns, _ = instant_columns(reading, signal.steps, heights=[step.height for step in signal.steps])
    filter_ = KalmanFilter.of(reading.system(signal.learned), reading.present)
    sizes, covariance, _ = generalised_least_squares(filter_, reading.filled, columns)
    sine, cosine, growing_sine, growing_cosine = sizes[sizes.size - 4 * number :].reshape(-1, 4).T
    noise = np.diag(covariance)[sizes.size - 4 * number :].reshape(-1, 4)[:, :2].sum(axis=1)
    half = 0.5 * (reading.values.size - 1) * reading.interval
    power = np.maximum(sine**2 + cosine**2, 1e-300)
    # that of a faint one is told better by the other harmonics
    turned = (sine * growing_cosine - cosine * growing_sine) / power * (power > CLEAR**2 * noise)
    most = MOST_TUNED / (reading.values.size * reading.interval)
    moved = np.array(reading.tones) + np.clip(turned / (2 * np.pi * half), -most, most)
    reading = replace(reading, tones=tuple(moved.tolist()))
    learned = fit_prior(reading, columns=columns_of(signal.steps, reading), before=signal.learned)
    return replace(signal, reading=reading, learned=learned)


def _evidence(signal: SignalModel) -> float:
    """Logarithm of the likelihood of a record, less Schwarz's price of its steps, tones and spectrum."""
    reading = signal.reading
    filter_ = KalmanFilter.of(reading.system(signal.learned), reading.present)
    numbers = sum(3 if step.duration > 0 else 2 for step in signal.steps) + 3 * len(reading.tones)
    price = 0.5 * (numbers + signal.learned.spectrum.parameters) * float(np.log(reading.values.size))
    return log_likelihood(reading, filter_, columns=columns_of(signal.steps, reading)) - price


def _fitted(reading: Observation, mains: _MainsLines, *, hum: Hum, resolution: float | None) -> SignalModel:
    """Steps and prior of a record whose lines of the mains and tones are named."""
    named, floor = _looked_above(replace(reading, hum=tuple(line.frequency for line in mains.hum)), [])
    named, begin = evenly_weighted(named, columns=columns_of([], named))
    search = StepSearch(named, begin)
    steps, learned = search.run()
    if steps and named.even:  # a step beside an end is no reason for it
        heights = np.array([0.0, *(step.height for step in steps)])
        left = named.filled - columns_of(steps, named)[:, : heights.size] @ heights
        if not ends_differ(left, named.interval):
            named = replace(named, even=False)
            search = StepSearch(named)
            steps, learned = search.run()
    if steps:
        if hum != "keep":
            heights = np.array([0.0, *(step.height for step in steps)])
            known = columns_of(steps, reading)[:, : heights.size]
            mains = _hum_of(reading, reading.values - known @ heights, hum)
        again, floor = _looked_above(replace(reading, hum=tuple(line.frequency for line in mains.hum)), steps)
        again = replace(again, even=named.even)
        if _differ(named, again):
            named, search = again, StepSearch(again)
            steps, learned = search.run()
        else:
            named = replace(named, hum=again.hum)
    slow = None
    if resolution is not None:
        left = bridged(named, learned, columns=columns_of(steps, named))
        slow = slow_noise_of(named, learned, left=left, resolution=resolution)
    if slow is not None and slow.likely:
        named = slow.taken_by(named)
        search = StepSearch(named)
        steps, learned = search.run()
    ended = search if search.said else None
    return SignalModel(
        named, steps, learned, mains.hum, mains.large, floor, slow, ended, mains.of_load, tuple(search.bends)
    )


def _looked_above(reading: Observation, steps: Sequence[Step]) -> tuple[Observation, Floor | None]:
    """The reading with the color of its noise as the record shows it, unless that is known, and what was seen."""
    columns = columns_of(list(steps), reading)
    others = np.delete(columns, np.arange(1, 1 + len(steps)), axis=1)
    left = reading.filled - columns[:, 1 : 1 + len(steps)] @ np.array([step.height for step in steps])
    sizes, *_ = least_squares(np.where(reading.present, left, 0.0), others * reading.present[:, None])

    def other_dynamics(values: Array) -> float:
        dynamics = reading.dynamics
        if not isinstance(dynamics, Dynamics):
            return 0.0  # of components that are coupled all dynamics are asked at once, and not one mode
        return gain_in_white_noise(values, dynamics, interval=reading.interval, least_noise=reading.least_noise)

    return with_floor(reading, left=left - others @ sizes, other_dynamics=other_dynamics)


def _differ(one: Observation, other: Observation) -> bool:
    """Whether two readings differ in hum or noise so that the steps are looked for again with the other."""
    resolved = 1 / (one.values.size * one.interval)
    if len(one.hum) != len(other.hum) or not np.allclose(one.hum, other.hum, rtol=0, atol=SAME_LINE * resolved):
        return True
    if one.rising != other.rising:
        return True
    if one.noise is None or other.noise is None or one.color is None or other.color is None:
        return one.color is not other.color
    frequency = np.linspace(0, 0.5 / one.interval, COMPARED)
    ratio = (other.color.density(frequency) + other.noise**2 * one.interval) / (
        one.color.density(frequency) + one.noise**2 * one.interval
    )
    return bool(np.max(np.abs(np.log(ratio))) > SAME_NOISE)


def _hum_of(reading: Observation, values: Array, hum: Hum) -> _MainsLines:
    """Lines of hum, and lines of the mains that are none: a drive at 50 or 60 Hz is what is recorded."""
    lines = hum_lines(values, reading.interval, hum=hum)
    if hum != "mains" or not lines:
        return _MainsLines(lines)
    of_load = load_harmonics(values, reading.interval, lines, reading.dynamics.response)
    lines = tuple(line for line in lines if line not in of_load)
    largest = LARGEST_HUM * float(np.nanmax(reading.values) - np.nanmin(reading.values)) / 2
    if any(line.amplitude > largest for line in lines):
        return _MainsLines((), lines, of_load)
    return _MainsLines(lines, (), of_load)
