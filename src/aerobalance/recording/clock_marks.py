"""Clocks compared by what counts or marks time in both recordings: a counter, the edges of a trigger."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from aerobalance.recording.channel import Array
from aerobalance.recording.clock_pair import Alignment, ClockLine, Pair, fitted_line
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps_linearly

_DIGITS: Final = 10
"""Digits behind the decimal point up to which a reading counts as rounded."""

_LARGEST: Final = 2.0**52
_ROUNDING: Final = 1e-3
"""Of the last digit, up to which a reading may differ from a rounded one."""

_HARMONICS: Final = 10_000
"""Harmonics of the error of rounding that are looked at one by one."""


def by_ticks(pair: Pair) -> Alignment:
    """Compare clocks by a counter that both recorded."""
    lines, points = [], 0
    for recording, channel in ((pair.base, pair.one), (pair.other, pair.two)):
        there = ~channel.missing
        ticks, times = channel.values[there], recording.time[there]
        if ticks.size < 3 or (np.diff(ticks) < 0).any() or ticks[-1] == ticks[0]:
            raise FitError(f"{recording.name}: {pair.by} is no counter: it must never go back, and must count on")
        lines.append(_counted(np.flatnonzero(there), times, ticks))
        points += ticks.size
    one, two = lines
    line = ClockLine(
        two.middle,
        one.middle + (two.level - one.level) / one.slope,
        two.slope / one.slope,
        float(np.hypot(one.u_level, two.u_level)) / one.slope,
        float(np.hypot(one.u_slope / one.slope, two.u_slope / two.slope)) * two.slope / one.slope,
    )
    return pair.found("tick", line, points)


def _counted(places: NDArray[np.intp], times: Array, ticks: Array) -> ClockLine:
    """Fit a line to the readings of a counter, of which it is not known where within a count each was taken.

    Parameters
    ----------
    places
        Samples of the steady clock that were read, shape (m,).
    times
        Their times [s], shape (m,).
    ticks
        The readings, shape (m,) [counts].
    """
    middle = float(times.mean())
    far = times - middle
    slope, level = float(far @ (ticks - ticks.mean()) / (far @ far)), float(ticks.mean())
    left = ticks - level - slope * far
    count = _one_count(ticks)
    within = count / float(np.sqrt(12))
    # where within a count it was read may be the same in all samples
    u_level = float(np.hypot(np.sqrt(left @ left) / ticks.size, within))
    random = float(max(np.sqrt(left @ left / ticks.size), within) / np.sqrt(far @ far))
    interval = float(times[-1] - times[0]) / float(places[-1] - places[0])
    rounded = _slope_of_rounding(places - places[0], far, slope * interval / count) * count if count else 0.0
    return ClockLine(middle, level, slope, u_level, float(np.hypot(random, rounded)))


def _one_count(ticks: Array) -> float:
    """Return the largest step that all readings of a counter are multiples of apart; 0 where they are not rounded."""
    for digits in range(_DIGITS):
        scaled = ticks * 10.0**digits
        if not np.abs(scaled).max() < _LARGEST:
            break
        whole = np.rint(scaled)
        if (np.abs(scaled - whole) < _ROUNDING).all():
            return float(np.gcd.reduce(np.diff(whole).astype(np.int64))) / 10.0**digits
    return 0.0


def _slope_of_rounding(places: NDArray[np.intp], far: Array, step: float) -> float:
    """Standard uncertainty of a fitted slope by the rounding of the readings, over one count [1/s].

    From sample to sample the rounding error goes through a count as often as the counter does, so it is a sawtooth:
    its harmonic k has the amplitude 1 / (pi k) and runs at k times the counts of a sample, of which only what is
    beyond the nearest whole number shows. A slow one tilts the line as a whole, however many samples there are. Where
    within a count the first sample was read is not known: uniformly distributed, so that the harmonics add up by their
    squares.

    Parameters
    ----------
    places
        Samples that were read, counted from the first, shape (m,).
    far
        Their times from the middle [s], shape (m,).
    step
        Counts from sample to sample.
    """
    span = int(places[-1]) + 1
    length = next_fast_len(4 * span, real=True)
    weights = np.zeros(span)
    weights[places] = far
    tilt = np.abs(np.fft.rfft(weights, length)) / float(far @ far)
    tilt = np.maximum.accumulate(tilt[::-1])[::-1]  # by a wave as slow as this, or faster
    harmonics = np.arange(1, min(span, _HARMONICS) + 1)
    sizes = (1 / (np.pi * harmonics)) ** 2 / 2
    beyond = np.abs(harmonics * step - np.rint(harmonics * step))  # from 0 to a half
    off = 1.5 / span  # of the step, by errors of half a count that add up as badly as they can
    found = np.inf
    while True:
        slowest = np.maximum(beyond - off * harmonics, 0)
        tilts = tilt[np.minimum((slowest * length).astype(np.intp), tilt.size - 1)]
        last, found = found, float(np.sqrt(sizes @ tilts**2 + tilt[0] ** 2 * _rest(harmonics.size)))
        if not found < 0.9 * last:
            return min(found, last)
        off = min(off, 3 * found * float(far[-1] - far[0]) / max(span - 1, 1))


def _rest(harmonics: int) -> float:
    """Mean square of a sawtooth of one count without its first harmonics: what 1 / (2 pi^2 k^2) adds up to beyond."""
    return 1 / (2 * np.pi**2 * harmonics)


def edges(recording: Recording, name: str) -> Array:
    """Times at which a channel rises through the middle of its range [s], after having been below a quarter of it."""
    values = interpolate_gaps_linearly(recording.channel(name).values)
    low, high = np.quantile(values, (0.0, 1.0))
    if not high > low:
        raise FitError(f"{recording.name}: {name} never changes: there is no edge in it")
    level, armed = (low + high) / 2, low + (high - low) / 4
    up = np.flatnonzero((values[1:] >= level) & (values[:-1] < level))
    below = np.flatnonzero(values < armed)
    last = np.searchsorted(below, up, side="right") - 1
    kept = [k for k in range(up.size) if last[k] >= 0 and (k == 0 or below[last[k]] > up[k - 1])]
    up = up[kept]
    part = (level - values[up]) / (values[up + 1] - values[up])
    return np.asarray(recording.start + (up + part) / recording.rate)


def by_edges(pair: Pair) -> Alignment:
    """Compare clocks by the edges of a trigger that both recorded."""
    one, two = edges(pair.base, pair.by), edges(pair.other, pair.by)
    if not one.size or not two.size:
        lacking = pair.base if not one.size else pair.other
        raise FitError(f"{lacking.name}: {pair.by} has no rising edge")
    # an edge that is steeper than a sampling interval is somewhere in it
    least = float(np.hypot(1 / pair.base.rate, 1 / pair.other.rate)) / np.sqrt(12)
    shift = _matching(pair, one, two, least) if one.size != two.size else 0
    first = max(0, shift), max(0, -shift)
    count = min(one.size - first[0], two.size - first[1])
    x, y = two[first[1] : first[1] + count], one[first[0] : first[0] + count]
    line = fitted_line(x, y, least=least)
    left = np.abs(y - line.level - line.slope * (x - line.middle)).max()
    if left > 10 * least:
        raise FitError(
            f"the edges of {pair.by} in {pair.base.name} and {pair.other.name} do not go together: after offset and "
            f"drift they are up to {left:.3g} s apart; one may be missing in one of the files"
        )
    return pair.found("trigger", line, count)


def _matching(pair: Pair, one: Array, two: Array, least: float) -> int:
    """Edge of the first list that the first of the second is, where one has more; negative the other way round."""
    few, many = sorted((one, two), key=len)
    errors = []
    for k in range(many.size - few.size + 1):
        gaps = np.diff(many[k : k + few.size]) - np.diff(few)
        errors.append(float(np.sqrt(np.mean(gaps**2))) if gaps.size else 0.0)
    best, second = np.argsort(errors, kind="stable")[:2]
    if errors[best] > 10 * least or errors[second] < 4 * max(errors[best], least):
        raise FitError(
            f"{pair.by} has {one.size} edge(s) in {pair.base.name} and {two.size} in {pair.other.name}, and their "
            "distances do not tell which belong together; cut the files to the same edges, or align by correlation"
        )
    return int(best) if one.size > two.size else -int(best)
