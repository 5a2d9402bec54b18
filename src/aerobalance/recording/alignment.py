"""Clocks of several recordings of one event, brought together: by a counter, a trigger, a common signal, or dates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import FitError
from aerobalance.recording.fourier import convolve
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps_linearly, upsample

Way = Literal["auto", "tick", "trigger", "correlation", "start"]
"""How two clocks are compared."""

WAYS: Final = get_args(Way)

SEGMENTS: Final = 9
"""Parts of a record that are compared one by one, so that a drift does not smear what they have in common."""

COARSE: Final = 1 << 18
"""Samples of a record in which the lag is looked for first."""

FITTED: Final = 1 << 17
"""Samples that offset and drift are fitted to."""

LEAST_CORRELATION: Final = 0.5
"""Correlation of the common signal in both files from which on they are taken to be of one event."""

RIVAL: Final = 0.95
"""Height of a second peak of the correlation, over that of the first, from which on the lag is not certain."""

LARGEST_DRIFT: Final = 1e-3
"""Difference of two clocks that no quartz has, by far [1]."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """How the clock of one recording goes by that of another.

    A time s of its own is ``s + offset + drift * (s - start)`` on the other clock.

    Attributes
    ----------
    name
        The recording.
    way
        How it was found.
    by
        The channel that it was found by; an empty string for dates.
    offset, u_offset
        At its first sample, and standard uncertainty [s]; NaN where that is not known.
    drift, u_drift
        Rate of the offset's change, and standard uncertainty [1]; NaN where it cannot be known, and the drift is then
        taken as 0.
    start
        Its first sample on its own clock [s].
    points
        Edges, counts or samples that it was found from.
    """

    name: str
    way: Way
    by: str
    offset: float
    u_offset: float
    drift: float
    u_drift: float
    start: float
    points: int

    def onto(self, times: Array) -> Array:
        """Times of its own on the other clock [s]."""
        return times + self.offset + self.drift * (times - self.start)

    def back(self, times: Array) -> Array:
        """Times of the other clock on its own [s]."""
        begin = self.start + self.offset
        return self.start + (times - begin) / (1 + self.drift)

    def told(self) -> str:
        """What was found, in a sentence."""
        by = f" of {self.by}" if self.by else " (dates of the files)"
        u = (
            f", u = {self.u_offset:.2g} s"
            if np.isfinite(self.u_offset)
            else ", as good as the clocks of the computers"
        )
        drift = (
            f"its clock runs {1e6 * self.drift:+.3f} ppm, u = {1e6 * self.u_drift:.2g} ppm"
            if np.isfinite(self.u_drift)
            else "a drift of its clock cannot be seen and is taken as none"
        )
        return f"{self.name} is aligned by {self.way}{by}: offset {self.offset:.9g} s{u}; {drift}"


def align(base: Recording, other: Recording, *, way: Way = "auto", by: str | None = None) -> Alignment:
    """Offset [s] and drift [1] of the clock of one recording by that of another.

    Parameters
    ----------
    base
        The recording whose clock counts.
    other
        The one to be aligned.
    way
        ``"tick"``: both have a channel that counts the same clock. ``"trigger"``: both have a channel with the same
        rising edges. ``"correlation"``: both have a channel of the same quantity. ``"start"``: by the date and time
        of both. ``"auto"``: the first of tick, trigger and correlation that both have a channel for.
    by
        The channel; where left out ``tick``, ``trigger``, or the first channel that both have.

    Raises
    ------
    FitError
        The recordings have nothing in common by which this could be told, or it is not certain.
    ValueError
        There is no such way.
    """
    if way not in WAYS:
        raise ValueError(f"align must be one of {', '.join(WAYS)}, not {way}")
    chosen = _way(base, other, by) if way == "auto" else way
    if chosen == "start":
        return _by_dates(base, other)
    name = by or (chosen if chosen != "correlation" else _common(base, other))
    ways: Mapping[str, Callable[[_Pair], Alignment]] = {
        "tick": _by_ticks,
        "trigger": _by_edges,
        "correlation": _by_correlation,
    }
    return ways[chosen](_Pair(base, other, name, base.channel(name), other.channel(name)))


def _way(base: Recording, other: Recording, by: str | None) -> Way:
    if by is not None:
        return "tick" if by == "tick" else "trigger" if by == "trigger" else "correlation"
    for way in ("tick", "trigger"):
        if way in base and way in other:
            return "tick" if way == "tick" else "trigger"
    return "correlation"


def _common(base: Recording, other: Recording) -> str:
    """First channel that two recordings both have, one that changes."""
    names = [one.name for one in base if one.name in other]
    moving = [
        name for name in names if np.nanstd(base.channel(name).values) > 0 < np.nanstd(other.channel(name).values)
    ]
    if not moving:
        raise FitError(
            f"{base.name} and {other.name} have no channel in common (tick, trigger, or a quantity that both "
            "recorded): name one alike in both by channel maps, or take the dates of the files (start), which are as "
            "good as the clocks of the computers"
        )
    return moving[0]


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two recordings, and the channel that both have."""

    base: Recording
    other: Recording
    by: str
    one: Channel
    two: Channel

    @property
    def lag(self) -> float:
        """What the channels' own delays add to the offset [s]."""
        return self.two.delay - self.one.delay

    def found(self, way: Way, line: _Line, points: int) -> Alignment:
        """The alignment by a straight line of base times over other times."""
        if not abs(line.slope - 1) < LARGEST_DRIFT:
            raise FitError(
                f"by {way} of {self.by}, the clock of {self.other.name} runs {line.slope:.6g} times as fast as that "
                f"of {self.base.name}, which no two clocks differ by: {self.by} is not the same in both"
            )
        start = self.other.start
        return Alignment(
            self.other.name,
            way,
            self.by,
            line.at(start) - start + self.lag,
            line.u_at(start),
            line.slope - 1,
            line.u_slope,
            start,
            points,
        )


@dataclass(frozen=True, slots=True)
class _Line:
    """A straight line through points, about their middle."""

    middle: float
    level: float
    slope: float
    u_level: float
    u_slope: float

    def at(self, place: float) -> float:
        return self.level + self.slope * (place - self.middle)

    def u_at(self, place: float) -> float:
        far = 0.0 if np.isnan(self.u_slope) else self.u_slope * (place - self.middle)
        return float(np.hypot(self.u_level, far))


def _line(x: Array, y: Array, *, least: float) -> _Line:
    """Fit a line; `least` is the standard deviation of a point that there is at least."""
    middle = float(x.mean())
    if x.size < 2:
        return _Line(middle, float(y[0]), 1.0, least, float("nan"))
    far = x - middle
    level, slope = float(y.mean()), float(far @ (y - x) / (far @ far)) + 1.0
    left = y - level - slope * far
    scatter = max(least, float(np.sqrt(left @ left / max(x.size - 2, 1))))
    return _Line(middle, level, slope, scatter / np.sqrt(x.size), scatter / float(np.sqrt(far @ far)))


def _by_dates(base: Recording, other: Recording) -> Alignment:
    if base.epoch is None or other.epoch is None:
        lacking = base if base.epoch is None else other
        raise FitError(f"{lacking.name} does not say at which date and time it was taken; align by a channel instead")
    apart: np.timedelta64 = other.epoch - base.epoch
    offset = float(apart / np.timedelta64(1, "ns")) * 1e-9
    return Alignment(other.name, "start", "", offset, float("nan"), 0.0, float("nan"), other.start, 2)


def _by_ticks(pair: _Pair) -> Alignment:
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
    line = _Line(
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


def _by_edges(pair: _Pair) -> Alignment:
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
    line = _line(x, y, least=least)
    left = np.abs(y - line.level - line.slope * (x - line.middle)).max()
    if left > 10 * least:
        raise FitError(
            f"the edges of {pair.by} in {pair.base.name} and {pair.other.name} do not go together: after offset and "
            f"drift they are up to {left:.3g} s apart; one may be missing in one of the files"
        )
    return pair.found("trigger", line, count)


def _matching(pair: _Pair, one: Array, two: Array, least: float) -> int:
    """Edge of the first list that the first of the second is, where one has more; negative the other way round."""
    few, many = sorted((one, two), key=len)
    errors = []
    for k in range(many.size - few.size + 1):
        gaps = np.diff(many[k : k + few.size]) - np.diff(few)
        errors.append(float(np.sqrt(np.mean(gaps**2))) if gaps.size else 0.0)
    best, rival = np.argsort(errors, kind="stable")[:2]
    if errors[best] > 10 * least or errors[rival] < 4 * max(errors[best], least):
        raise FitError(
            f"{pair.by} has {one.size} edge(s) in {pair.base.name} and {two.size} in {pair.other.name}, and their "
            "distances do not tell which belong together; cut the files to the same edges, or align by correlation"
        )
    return int(best) if one.size > two.size else -int(best)


def _by_correlation(pair: _Pair) -> Alignment:
    """Compare clocks by a signal that both recorded: lags of segments first, then least squares over all samples."""
    rough = _lags(pair)
    line = _refined(pair, rough)
    return pair.found("correlation", *line)


def _lags(pair: _Pair) -> _Line:
    """Offset and drift from the lags of segments of the other recording, by cross-correlation."""
    rate = min(pair.base.rate, pair.other.rate, COARSE / max(pair.base.duration, pair.other.duration))
    one = _thinned(pair.base, pair.one, rate)
    two = _thinned(pair.other, pair.two, rate)
    length = max(two.size // SEGMENTS, min(two.size, 64))
    size = next_fast_len(one.size + length)
    spectrum = rfft(one, size)
    energy = np.concatenate([[0.0], np.cumsum(one**2)])
    found = []
    for begin in range(0, two.size - length + 1, max(length, 1)):
        part = two[begin : begin + length]
        if not part.any():
            continue
        cross = irfft(spectrum * np.conj(rfft(part, size)), size)[: max(one.size - length + 1, 1)]
        inside = energy[length : length + cross.size] - energy[: cross.size]
        like = cross / np.sqrt(np.maximum(inside, 1e-3 * inside.max()) * (part @ part))
        peak = int(np.argmax(like))
        found.append((begin, peak, float(like[peak]), _rival(like, peak)))
    good = [one for one in found if one[2] > LEAST_CORRELATION]
    if not good:
        best = max((one[2] for one in found), default=0.0)
        raise FitError(
            f"{pair.by} in {pair.base.name} and in {pair.other.name} are not alike (correlation {best:.2f} at best; "
            f"{LEAST_CORRELATION} is needed): is it the same event, and the same quantity?"
        )
    if all(one[3] > RIVAL for one in good):
        raise FitError(
            f"{pair.by} repeats itself: several offsets between {pair.base.name} and {pair.other.name} fit as well; "
            "align by a trigger, or by a channel that does not repeat"
        )
    sure = [one for one in good if one[3] <= RIVAL]
    x = np.array([pair.other.start + (begin + length / 2) / rate for begin, *_ in sure])
    y = np.array([pair.base.start + (peak + length / 2) / rate for _, peak, *_ in sure])
    lags = y - x
    near = np.abs(lags - np.median(lags)) < 3 / rate + LARGEST_DRIFT * pair.other.duration
    x, y = x[near], y[near]
    line = _line(x, y, least=1 / rate)
    if x.size < 3 or abs(line.slope - 1) > LARGEST_DRIFT:
        return _Line(float(x.mean()), float(y.mean()), 1.0, 1 / rate, float("nan"))
    return line


def _rival(like: Array, peak: int) -> float:
    """Height of the highest peak apart from the one that was found, over that."""
    below = np.flatnonzero(like < 0.5 * like[peak])
    right = below[below > peak]
    left = below[below < peak]
    rest = np.concatenate([like[: left[-1]] if left.size else like[:0], like[right[0] :] if right.size else like[:0]])
    return float(rest.max() / like[peak]) if rest.size else 0.0


def _thinned(recording: Recording, channel: Channel, rate: float) -> Array:
    """A channel without its mean at a lower rate: straight lines through means over the longer interval."""
    values = interpolate_gaps_linearly(channel.values)
    width = max(1, int(recording.rate / rate))
    sums = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    places = np.arange(int(recording.duration * rate) + 1) * (recording.rate / rate)
    begin = np.clip(places - (width - 1) / 2, 0, values.size - width)
    mean = (
        np.interp(begin + width, np.arange(sums.size), sums) - np.interp(begin, np.arange(sums.size), sums)
    ) / width
    return np.asarray(mean - mean.mean())


def _refined(pair: _Pair, line: _Line) -> tuple[_Line, int]:
    """Offset and drift by least squares: what the slower recording read is the faster one's signal at these instants.

    Gain and level of one sensor against the other are fitted too. Residuals are taken as white.
    """
    swapped = pair.other.rate > pair.base.rate
    fast, slow = (pair.other, pair.base) if swapped else (pair.base, pair.other)
    quick, late = (pair.two, pair.one) if swapped else (pair.one, pair.two)
    source = band_limited(interpolate_gaps_linearly(quick.values), fast.rate, slow.rate)
    times = slow.time
    known = ~late.missing
    middle, level, slope = (
        (line.level, line.middle, 1 / line.slope) if swapped else (line.middle, line.level, line.slope)
    )
    step = max(1, times.size // FITTED)
    chosen = _spread(times.size, step) & known
    answer = None
    for _ in range(20):
        places = (level + slope * (times - middle) - fast.start) * fast.rate
        used = chosen & (places > 12) & (places < source.size - 13)
        if np.count_nonzero(used) < 16:
            raise FitError(
                f"{pair.base.name} and {pair.other.name} have too little time in common to be compared by {pair.by}"
            )
        value, change = at_places(source, places[used])
        far = times[used] - middle
        design = np.column_stack([value, np.ones_like(value), change * fast.rate, change * fast.rate * far])
        scales = np.linalg.norm(design, axis=0)
        scales[scales == 0] = 1.0
        answer, *_ = np.linalg.lstsq(design / scales, late.values[used], rcond=None)
        answer = answer / scales
        gain = answer[0]
        if not abs(gain) > 0:
            break
        moves = answer[2:] / gain
        # half a sample at a time where the start was rough
        reach = 0.5 / slow.rate
        factor = min(1.0, reach / max(abs(moves[0]) + abs(moves[1]) * float(np.abs(far).max()), 1e-300))
        level, slope = level + factor * moves[0], slope + factor * moves[1]
        if factor == 1.0 and abs(moves[0]) < 1e-9 / slow.rate:
            break
    assert answer is not None  # the loop ran
    left = late.values[used] - design @ answer
    spread = late.values[used] - late.values[used].mean()
    share = 1 - float(left @ left) / max(float(spread @ spread), 1e-300)
    if not share > LEAST_CORRELATION**2:
        raise FitError(
            f"{pair.by} in {pair.base.name} and in {pair.other.name} are not alike: aligned as well as can be, one "
            f"explains {100 * max(share, 0):.0f} % of the other"
        )
    covariance = np.linalg.inv((design / scales).T @ (design / scales)) * float(left @ left) / max(left.size - 4, 1)
    deviations = np.sqrt(np.diag(covariance)) / scales / abs(gain)
    if swapped:  # the line goes from the slower to the faster: turn it round
        return _Line(level, middle, 1 / slope, float(deviations[2]), float(deviations[3])), left.size
    return _Line(middle, level, slope, float(deviations[2]), float(deviations[3])), left.size


def _spread(samples: int, step: int) -> NDArray[np.bool_]:
    """Which samples are used where all would be too many: runs of them, evenly spread, shape (n,)."""
    found: NDArray[np.bool_] = (np.arange(samples) // 256) % step == 0
    return found


def band_limited(values: Array, rate: float, other: float) -> Array:
    """A series without what another rate cannot hold: low-pass at 0.4 of it, 1e-5 from its half on, no delay."""
    if other >= rate:
        return values
    half = int(np.ceil(3.6 * rate / (0.1 * other)))
    place = np.arange(-half, half + 1)
    taps = np.sinc(2 * 0.45 * other / rate * place) * np.kaiser(place.size, 10.0)
    taps /= taps.sum()
    level = values.mean()
    whole = convolve((values - level)[:, None], taps[:, None])[:, 0]
    return np.asarray(whole[half : half + values.size] + level)


def at_places(values: Array, places: Array) -> tuple[Array, Array]:
    """A band-limited series and its slope at any places between its samples [samples], shape (m,) each."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - takes 30 ms, and few commands need it

    fine = upsample(values)
    spline = CubicSpline(np.arange(fine.size) / (fine.size / values.size), fine)
    return spline(places), spline(places, 1)


__all__ = ["WAYS", "Alignment", "Way", "align", "at_places", "band_limited", "edges"]
