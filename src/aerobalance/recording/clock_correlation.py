"""Clocks compared by a signal that both recordings have: lags of segments, then least squares over all samples."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.clock_pair import LARGEST_DRIFT, Alignment, ClockLine, Pair, fitted_line
from aerobalance.recording.errors import FitError
from aerobalance.recording.fourier import convolve
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import at_places, interpolate_gaps_linearly

SEGMENTS: Final = 9
"""Parts of a record that are compared one by one, so that a drift does not smear what they have in common."""

COARSE: Final = 1 << 18
"""Samples of a record in which the lag is looked for first."""

FITTED: Final = 1 << 17
"""Samples that offset and drift are fitted to."""

LEAST_CORRELATION: Final = 0.5
"""Correlation of the common signal in both files from which on they are taken to be of one event."""

PULLED: Final = 0.25
"""Standard uncertainty of the offset in samples where the slope that both read is but noise: uniform over a sample."""

SECOND_PEAK: Final = 0.95
"""Height of a second peak of the correlation, over that of the first, from which on the lag is not certain."""


def by_correlation(pair: Pair) -> Alignment:
    """Compare clocks by a signal that both recorded: lags of segments first, then least squares over all samples."""
    rough = _lags(pair)
    line = _refined(pair, rough)
    return pair.found("correlation", *line)


def _lags(pair: Pair) -> ClockLine:
    """Offset and drift from the lags of segments of the other recording, by cross-correlation."""
    rate = min(pair.base.rate, pair.other.rate, COARSE / max(pair.base.duration, pair.other.duration))
    one = _thinned(pair.base, pair.one, rate)
    two = _thinned(pair.other, pair.two, rate)
    length = min(max(two.size // SEGMENTS, min(two.size, 64)), one.size)
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
        found.append((begin, peak, float(like[peak]), _second_peak(like, peak)))
    good = [one for one in found if one[2] > LEAST_CORRELATION]
    if not good:
        best = max((one[2] for one in found), default=0.0)
        raise FitError(
            f"{pair.by} in {pair.base.name} and in {pair.other.name} are not alike (correlation {best:.2f} at best; "
            f"{LEAST_CORRELATION} is needed): is it the same event, and the same quantity?"
        )
    if all(one[3] > SECOND_PEAK for one in good):
        raise FitError(
            f"{pair.by} repeats itself: several offsets between {pair.base.name} and {pair.other.name} fit as well; "
            "align by a trigger, or by a channel that does not repeat"
        )
    sure = [one for one in good if one[3] <= SECOND_PEAK]
    x = np.array([pair.other.start + (begin + length / 2) / rate for begin, *_ in sure])
    y = np.array([pair.base.start + (peak + length / 2) / rate for _, peak, *_ in sure])
    lags = y - x
    # parts of a slow signal beyond the common time are like others by chance: all that they have in common decides,
    # unless a drift smears that
    shift = pair.other.start - pair.base.start
    best, likeness = _likeliest(one, two, least=min(length, two.size))
    lag = best / rate - shift if likeness > LEAST_CORRELATION else float(np.median(lags))
    near = np.abs(lags - lag) < 3 / rate + LARGEST_DRIFT * pair.other.duration
    if not near.any():
        middle = pair.other.start + pair.other.duration / 2
        return ClockLine(middle, middle + lag, 1.0, 1 / rate, float("nan"))
    x, y = x[near], y[near]
    line = fitted_line(x, y, least=1 / rate)
    if x.size < 3 or abs(line.slope - 1) > LARGEST_DRIFT:
        return ClockLine(float(x.mean()), float(y.mean()), 1.0, 1 / rate, float("nan"))
    return line


def _likeliest(one: Array, two: Array, *, least: int) -> tuple[int, float]:
    """Samples by which a signal begins after another where all that they have in common is most alike, and how much.

    Parameters
    ----------
    one, two
        The signals, shape (n,) and (m,).
    least
        Samples that they must have in common.
    """
    size = next_fast_len(one.size + two.size)
    cross = irfft(rfft(one, size) * np.conj(rfft(two, size)), size)
    lags = np.arange(least - two.size, one.size - least + 1)
    first, last = np.maximum(lags, 0), np.minimum(one.size, two.size + lags)

    def sums(values: Array, begin: NDArray[np.intp], end: NDArray[np.intp]) -> Array:
        whole = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(whole[end] - whole[begin])

    count = last - first
    means = [sums(one, first, last) / count, sums(two, first - lags, last - lags) / count]
    squares = [sums(one**2, first, last), sums(two**2, first - lags, last - lags)]
    spread = [np.maximum(s - count * m**2, 1e-6 * s.max()) for s, m in zip(squares, means, strict=True)]
    like = (cross[lags] - count * means[0] * means[1]) / np.sqrt(spread[0] * spread[1])
    best = int(np.argmax(like))
    return int(lags[best]), float(like[best])


def _second_peak(like: Array, peak: int) -> float:
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


def _refined(pair: Pair, line: ClockLine) -> tuple[ClockLine, int]:
    """Offset and drift by least squares: what the slower recording read is the faster one's signal at these instants.

    Gain and level of one sensor against the other are fitted too. Residuals that hang together count as fewer.
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
    for _ in range(200):
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
    # noise of the faster recording makes its slope steeper than that of the signal, which the slower one shares
    own = interpolate_gaps_linearly(late.values)
    both = np.flatnonzero(used)
    inside = (both > 12) & (both < own.size - 13)
    slower = at_places(own, both[inside].astype(np.float64))[1]
    common = float(slower @ change[inside]) / gain / max(float(change[inside] @ change[inside]), 1e-300)
    common = min(max(common, 1e-3), 1.0)
    deviations = np.sqrt(np.diag(covariance) * _together(left)) / scales / abs(gain) / common
    # and it is smallest between samples, so that such noise pulls the instants there
    deviations[2] = np.hypot(deviations[2], PULLED * (1 - common) ** 2 / slow.rate)
    if swapped:  # the line goes from the slower to the faster: turn it round
        return ClockLine(level, middle, 1 / slope, float(deviations[2]), float(deviations[3])), left.size
    return ClockLine(middle, level, slope, float(deviations[2]), float(deviations[3])), left.size


def _together(left: Array) -> float:
    """How many residuals count as one: the sum of their correlations up to the first that is none [1]."""
    size = next_fast_len(2 * left.size)
    power = np.abs(rfft(left, size)) ** 2
    correlation = irfft(power, size)[: left.size]
    if not correlation[0] > 0:
        return 1.0
    correlation = correlation / correlation[0]
    end = int(np.argmax(correlation <= 0)) if (correlation <= 0).any() else left.size
    return max(1.0, 1 + 2 * float(correlation[1:end].sum()))


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
