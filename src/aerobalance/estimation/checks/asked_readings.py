"""The readings of a component that are asked for other dynamics: one stretch, without its lines, steps and tones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from aerobalance.dynamics.modal import Mode
from aerobalance.estimation.least_squares import least_squares
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.record import FEWEST_SAMPLES, ComponentRecord
from aerobalance.estimation.spectra.lines import Line, reading_of_lines
from aerobalance.estimation.spectra.steady_tones import without_tones
from aerobalance.estimation.step_window import free_motions
from aerobalance.estimation.steps import Step, columns_of
from aerobalance.recording.channel import Array

LONGEST: Final = 1 << 17
"""Samples from the start that are looked at, so that the check of a long record takes no longer."""

PERIODS: Final = 12.0
"""Periods in the window through which a free oscillation is seen: four terms of Harris (Proc. IEEE 66 (1978) 51), of
which a load more than a third of the natural frequency away passes 92 dB down."""

DECAYED: Final = 5.0
"""Time constants up to which it is."""


def unbroken(
    record: ComponentRecord, steps: Sequence[Step], lines: Sequence[Line], *, longest: int = LONGEST
) -> tuple[Observation, list[Step]] | None:
    """The longest stretch of a reading without a gap, lines taken out, and the steps within.

    None where it has fewer than `FEWEST_SAMPLES` or does not change; of one that is too long the begin.
    """
    reading = record.reading()
    response = reading.dynamics.response
    known = reading_of_lines(tuple(lines), count=reading.values.size, interval=reading.interval, response=response)
    whole = longest_stretch(record)
    first, last = whole.start, min(whole.stop, whole.start + longest)
    values = (reading.values - known)[first:last]
    if values.size < FEWEST_SAMPLES or float(np.ptp(values)) == 0:
        return None
    begin, end = first * reading.interval, last * reading.interval
    within = [replace(step, instant=step.instant - begin) for step in steps if begin <= step.instant < end]
    return replace(reading, values=values), within


def longest_stretch(record: ComponentRecord) -> slice:
    """The longest stretch of a reading without a gap; none of its samples where it has no readings."""
    told = record.reading().present & ~record.hides_motion  # what is hidden and not found swings as well
    edges = np.flatnonzero(np.diff(np.concatenate(([False], told, [False])).astype(np.int8)))
    stretches = edges.reshape(-1, 2)
    if not len(stretches):
        return slice(0, 0)
    first, last = stretches[np.argmax(stretches[:, 1] - stretches[:, 0])]
    return slice(int(first), int(last))


def without_steps(reading: Observation, steps: Sequence[Step]) -> Array:
    """Reading less the mean, the steps and the free oscillation from its begin that explain it best, shape (n,)."""
    values, columns = reading.values, columns_of(list(steps), reading)
    time = np.arange(values.size, dtype=np.float64) * reading.interval
    motions = np.column_stack([part for mode in reading.dynamics.modes for part in free_motions(mode, time)])
    # by what is near the natural frequencies alone: of a load elsewhere least squares would make a ringing
    every = np.column_stack([motions, columns, values])
    near = np.concatenate([_near(every, mode, reading.interval) for mode in reading.dynamics.modes])
    left = _less(values, columns)
    if len(near) >= every.shape[1]:  # else a record of a few periods, in which nothing has decayed
        sizes, *_ = np.linalg.lstsq(near[:, :-1], near[:, -1], rcond=None)
        ringing = _less(values - motions @ sizes[: motions.shape[1]], columns)
        # what a step near the begin excites looks like it, and is told from it badly
        left = min(left, ringing, key=lambda one: float(one @ one))
    return left


def _less(values: Array, columns: Array) -> Array:
    """Values less what columns explain of them best, shape (n,)."""
    return np.asarray(values - columns @ least_squares(values, columns)[0])


def _near(columns: Array, mode: Mode, interval: float) -> Array:
    """What columns, shape (n, k), have near the natural frequency of a mode while it decays, shape (m, k)."""
    count = round(PERIODS / (mode.natural_frequency * interval))
    if not 4 <= count <= len(columns):
        return np.zeros((0, columns.shape[1]))
    decay = mode.damping_ratio * 2 * np.pi * mode.natural_frequency * interval
    last = len(columns) - count + 1 if decay == 0 else min(len(columns) - count, int(DECAYED / decay)) + 1
    place = 2 * np.pi * np.outer((np.arange(count) + 0.5) / count, np.arange(4))
    window = np.cos(place) @ np.array([0.35875, -0.48829, 0.14128, -0.01168])
    turn = np.exp(-2j * np.pi * mode.natural_frequency * interval * np.arange(count))
    windows = np.lib.stride_tricks.sliding_window_view(columns, count, axis=0)[: last : max(count // 4, 1)]
    seen = windows @ (window * turn)
    return np.concatenate([seen.real, seen.imag])


def without_steady_tones(values: Array) -> Array:
    """One component's readings less their steady tones, shape (n,)."""
    return np.asarray(without_tones(values[:, None])[:, 0])
