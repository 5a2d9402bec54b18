r"""Response of modes to sampled series, block by block or for a whole record at once: the same samples either way.

A mode 1 / (1 + d s + a s^2) is driven by u + s v. Between samples u and v are interpolated band-limited to a clock
`FINE` times as fast, and straight there (`aerobalance.recording.resampling.upsample_compensated`); the response at
the samples is then exactly

    y_k = tr y_(k-1) - det y_(k-2) + sum over t of g_t u_(k+t) + h_t v_(k+t),

with trace and determinant of the transition of the mode's state over a sampling interval: with the weights g and h
known, no fine clock is left.

The sum reaches beyond both ends of a record. There the series go on turned about their end sample (odd reflection):
held in place of that, they would have a kink, which rings in what follows. Another past is a free oscillation of the
modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.linalg import expm

from aerobalance.dynamics._kernels import driven
from aerobalance.dynamics.modal import Mode
from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import FINE, interpolation


class DrivenModes:
    """Responses of modes, block by block.

    Parameters
    ----------
    modes
        The m modes; their shares are not used.
    interval
        Time between samples [s].
    delays
        Times by which the responses to series lag them [s].

    Attributes
    ----------
    kinds
        Series that drive every mode: u and v of every delay.
    ahead
        Samples after a sample that the responses at it wait for.
    """

    def __init__(self, modes: Sequence[Mode], *, interval: float, delays: Sequence[float] = (0.0,)) -> None:
        made = [[_taps(mode, interval=interval, delay=delay) for delay in delays] for mode in modes]
        self._poles = [parts[0][0] for parts in made]
        spans = [(first, first + taps.shape[0]) for parts in made for _, first, taps in parts]
        self._first = min(0, *(first for first, _ in spans))
        last = max(1, *(stop for _, stop in spans))
        self.kinds = 2 * len(delays)
        self._weights = np.zeros((last - self._first, self.kinds, len(modes)))
        for place, parts in enumerate(made):
            for number, (_, first, taps) in enumerate(parts):
                begin = first - self._first
                self._weights[begin : begin + taps.shape[0], 2 * number : 2 * number + 2, place] = taps
        self.ahead: int = last - 1
        self._state = np.zeros((len(modes), 2))
        self._driving = np.zeros((0, self.kinds, len(modes)))
        self._begun = False

    def push(self, driving: Array) -> Array:
        """Return the responses that have become known by more of u and v, shape (k', m).

        Parameters
        ----------
        driving
            u and v of every delay, shape (k, `kinds`, m), less their first sample.
        """
        self._driving = np.concatenate([self._driving, driving])
        if not self._begun and self._driving.shape[0] > -self._first:
            self._begin()
        if not self._begun:
            return np.zeros((0, self._weights.shape[2]))
        return self._respond()

    def finish(self) -> Array:
        """Return the responses that wait for what comes after the last sample, shape (k', m)."""
        if not self._driving.shape[0]:
            return np.zeros((0, self._weights.shape[2]))
        if not self._begun:
            self._begin()
        end = np.arange(self._driving.shape[0] - 2, self._driving.shape[0] - 2 - self.ahead, -1)
        after = 2 * self._driving[-1:] - self._driving[np.maximum(end, 0)]
        self._driving = np.concatenate([self._driving, after])
        return self._respond()

    def whole(self, driving: Array) -> Array:
        """Return the responses to all of u and v, both of shape (k, ...), as `push` and `finish` give them."""
        return np.concatenate([self.push(driving), self.finish()])

    def _begin(self) -> None:
        """Put what came before the first sample in front."""
        mirrored = np.minimum(np.arange(-self._first, 0, -1), self._driving.shape[0] - 1)
        self._driving = np.concatenate([2 * self._driving[:1] - self._driving[mirrored], self._driving])
        self._begun = True

    def _respond(self) -> Array:
        count = max(self._driving.shape[0] + self._first - self.ahead, 0)
        push = np.zeros((count, self._weights.shape[2]))
        if not count:
            return push
        for place, pole in enumerate(self._poles):
            series = np.ascontiguousarray(self._driving[:, :, place].T)
            found = np.empty(count)
            driven(pole, np.ascontiguousarray(self._weights[:, :, place]), series, self._state[place], found)
            push[:, place] = found
        self._driving = self._driving[count:]
        return push


def responses(mode: Mode, series: Array, *, by_value: float, by_rate: float, interval: float) -> Array:
    """Sums of the responses of a mode to several series and of their rates, as `values_and_rates` gives them, (c, n).

    Parameters
    ----------
    mode, series, interval
        As in `values_and_rates`.
    by_value, by_rate
        Weights of the responses [1] and of their rates [s].
    """
    pole, first, taps = _taps(mode, interval=interval, delay=0.0)
    whole = _beyond_ends((series - series[0]).T, before=-first, after=first + taps.shape[0] - 1)
    both, found = np.ascontiguousarray(taps @ np.array([[by_value], [by_rate]])), np.empty(series.shape[::-1])
    for one, out in zip(whole, found, strict=True):
        driven(pole, both, one[None], np.zeros(2), out)
    found += by_value * series[:1].T
    return found


def values_and_rates(mode: Mode, series: Array, *, interval: float) -> tuple[Array, Array]:
    """Responses of a mode to several series, and their rates, as `DrivenModes` gives them, shape (c, n) each.

    Parameters
    ----------
    mode
        The mode; its shares are not used.
    series
        What drives it, shape (n, c): each column alone, from rest under its first sample.
    interval
        Time between samples [s].
    """
    pole, first, taps = _taps(mode, interval=interval, delay=0.0)
    start = series[:1].T
    whole = _beyond_ends((series - series[0]).T, before=-first, after=first + taps.shape[0] - 1)
    found = np.empty((2, *series.shape[::-1]))
    for column, one in enumerate(whole):
        for kind in range(2):
            driven(pole, np.ascontiguousarray(taps[:, [kind]]), one[None], np.zeros(2), found[kind, column])
    found[0] += start
    return found[0], found[1]


def _beyond_ends(series: Array, *, before: int, after: int) -> Array:
    """Series (c, n) that go on so many samples beyond their ends, turned about their end samples."""
    last = series.shape[1] - 1
    early = 2 * series[:, :1] - series[:, np.minimum(np.arange(before, 0, -1), last)]
    late = 2 * series[:, -1:] - series[:, np.maximum(last - np.arange(1, after + 1), 0)]
    return np.ascontiguousarray(np.concatenate([early, series, late], axis=1))


@lru_cache(maxsize=64)  # every component of a record asks for its modes several times
def _taps(mode: Mode, *, interval: float, delay: float) -> tuple[Array, int, Array]:
    """Recursion of a mode whose response is late, the first sample that drives it, and the weights of u and v.

    Returns
    -------
    pole, first, taps
        Shapes (3,), scalar, and (t, 2).
    """
    a, d = mode.angular_frequency**-2, 2 * mode.damping_ratio / mode.angular_frequency
    # states y and one that makes y' of it: a y'' + d y' + y = u + v'
    generator = np.array([[-d / a, 1.0], [-1.0 / a, 0.0]])
    gain = np.array([[0.0, 1.0 / a], [1.0 / a, 0.0]])
    transition, hold, ramp = _fine_step(generator, gain, interval / FINE)
    whole = np.linalg.matrix_power(transition, FINE)
    series, first = _between(delay / interval)
    drive = np.zeros((series.shape[1], 2, 2))
    for step in range(FINE):
        onward = np.linalg.matrix_power(transition, FINE - 1 - step)
        early, late = onward @ (hold - ramp), onward @ ramp
        for kind in range(2):
            drive[:, :, kind] += np.outer(series[step], early[:, kind])
            drive[:, :, kind] += np.outer(series[step + 1], late[:, kind])
    trace, determinant = float(np.trace(whole)), float(np.linalg.det(whole))
    across = (whole - trace * np.eye(2))[0]
    taps = np.zeros((series.shape[1] + 1, 2))
    taps[1:] = drive[:, 0]
    taps[:-1] += np.einsum("tsk,s->tk", drive, across)
    return np.array([1.0, -trace, determinant]), first - 1, taps


def _fine_step(generator: Array, gain: Array, step: float) -> tuple[Array, Array, Array]:
    """Transition of a state over a step, and its response to inputs held, and to ones that rise by 1, exactly."""
    size = generator.shape[0]
    block = np.zeros((3 * size, 3 * size))
    block[:size, :size], block[:size, size : 2 * size] = generator * step, gain * step
    block[size : 2 * size, 2 * size :] = np.eye(size)
    whole = expm(block)
    return whole[:size, :size], whole[:size, size : 2 * size], whole[:size, 2 * size :]


def _between(shift: float) -> tuple[Array, int]:
    """Weights of samples in a series on the fine clock over the interval up to a sample, shape (FINE + 1, t).

    As `aerobalance.recording.resampling.upsample_compensated` makes it: a twelfth of the second difference is taken
    off, so that straight lines between its points do no harm. The first weight is that of the sample of the number
    returned beside them.
    """
    weights, first = interpolation(shift)
    count = weights.shape[1]
    # point p of the fine clock is at sample p // FINE and its phase; two intervals before the sample to one after it
    dense = np.zeros((4 * FINE, count + 3))
    for point in range(4 * FINE):
        sample, phase = divmod(point, FINE)
        dense[point, sample : sample + count] += weights[phase]
    begin = FINE  # the point one interval before the sample
    points = np.arange(begin, begin + FINE + 1)
    bent = dense[points] - (dense[points + 1] - 2 * dense[points] + dense[points - 1]) / 12
    used = np.flatnonzero(np.abs(bent).max(axis=0) > 0)
    return bent[:, used[0] : used[-1] + 1], first - 2 + int(used[0])
