"""Clocks compared by what counts or marks time in both recordings: a counter, the edges of a trigger."""

from __future__ import annotations

import numpy as np

from aerobalance.recording.channel import Array
from aerobalance.recording.clock_pair import Alignment, ClockLine, Pair, fitted_line
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps_linearly


def by_ticks(pair: Pair) -> Alignment:
    """Compare clocks by a counter that both recorded."""
    lines, points = [], 0
    for recording, channel in ((pair.base, pair.one), (pair.other, pair.two)):
        there = ~channel.missing
        ticks, times = channel.values[there], recording.time[there]
        if ticks.size < 3 or (np.diff(ticks) < 0).any() or ticks[-1] == ticks[0]:
            raise FitError(f"{recording.name}: {pair.by} is no counter: it must never go back, and must count on")
        middle = float(times.mean())
        far = times - middle
        slope, level = float(far @ (ticks - ticks.mean()) / (far @ far)), float(ticks.mean())
        left = ticks - level - slope * far
        scatter = float(np.sqrt(left @ left / ticks.size))
        # of a whole number it is not known where within a count it was read, and that may be so in all samples
        within = 1 / np.sqrt(12) if (ticks == np.rint(ticks)).all() else 0.0
        u_level = float(np.hypot(scatter / np.sqrt(ticks.size), within))
        lines.append((middle, level, slope, u_level, max(scatter, within) / float(np.sqrt(far @ far))))
        points += ticks.size
    (m1, l1, s1, u1, d1), (m2, l2, s2, u2, d2) = lines
    line = ClockLine(
        m2, m1 + (l2 - l1) / s1, s2 / s1, float(np.hypot(u1, u2)) / s1, float(np.hypot(d1 / s1, d2 / s2)) * s2 / s1
    )
    return pair.found("tick", line, points)


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
