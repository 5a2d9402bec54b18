"""All instants of a record at once as candidates of a step, and those of them that can be taken up together.

With the prior known, the gain in likelihood of a step at each sample follows from one correlation of the innovations
with the whitened response [deJong1998]_. The likeliest instant is taken, then the likeliest of what a step there
leaves, and so on, as long as none can be what the search to a sample has left of a larger one.

References
----------
.. [deJong1998] P. de Jong, J. Penzer, "Diagnosing shocks in time series", J. Amer. Statist. Assoc. 93 (1998) 796.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from aerobalance.estimation.observation import Observation
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.steps import Step, ringing_time
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import convolve
from aerobalance.recording.linalg import sums_of_products

APART: Final = 2.0
"""Periods of the natural frequency by which steps that are taken up together are apart at least."""

SHARE: Final = 0.1
"""Gain over that of a larger step whose response has not ended, below which a step waits until that one is known."""

SHORTEST: Final = 1 << 12
"""Samples of the response to a step that are looked at, at least."""

FORGOTTEN: Final = 1e-10
"""Change of that response over its largest one that is rounding."""

AROUND: Final = 1.0
"""Periods of the natural frequency within which a change of slope is looked for that looks like a step."""

ALIKE: Final = 1e-9
"""Singular value over the largest below which responses at neighbouring samples are one."""


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """What a step at each sample would bring, beside known shapes of free size.

    Attributes
    ----------
    reading
        The record.
    score
        Product of the whitened response to a step of 1 N with what the known shapes leave, shape (n,) [1/N].
    information
        Square of what the known shapes leave of that response, shape (n,) [1/N^2].
    response
        The whitened response itself.
    shown
        Product of each of them with the known shapes, whitened and made orthogonal, shape (n, p) [1/N].
    inverse
        What makes the sizes of the known shapes out of those of the orthogonal ones, shape (p, p).
    sizes
        Sizes of the known shapes, shape (p,).
    bends
        Instants of changes of slope that would have been taken for steps [s].
    """

    reading: Observation
    score: Array
    information: Array
    response: _Response
    shown: Array
    inverse: Array
    sizes: Array
    bends: list[float] = field(default_factory=list)

    @classmethod
    def of(cls, reading: Observation, filter_: KalmanFilter, columns: Array) -> Scan:
        """Look at a reading with known shapes (n, p)."""
        series = filter_.whiten(np.column_stack([reading.filled, columns]))
        basis, triangle = np.linalg.qr(series[:, 1:])
        scale = np.maximum(np.linalg.norm(triangle, axis=0), 1e-300)
        inverse = np.linalg.pinv(triangle / scale, rcond=ALIKE) / scale[:, None]
        told = sums_of_products(basis, series[:, 0])
        left = series[:, 0] - basis @ told
        response = _Response.of(reading, filter_.settled)
        products = response.against(np.column_stack([left, basis]))
        score, shown = products[:, 0], products[:, 1:]
        information = np.cumsum(response.whole(reading.values.size) ** 2)[::-1] - np.einsum("np,np->n", shown, shown)
        return cls(reading, score, information, response, shown, inverse, inverse @ told)

    def without(self, place: int) -> Scan:
        """Return the same with one of the known shapes taken for unknown; what it shows is no more looked up."""
        row = self.inverse[place]
        length = max(float(np.linalg.norm(row)), 1e-300)
        own = self.shown @ row / length
        score = self.score + self.sizes[place] / length * own
        return replace(self, score=score, information=self.information + own**2)

    def gain(self, score: Array) -> Array:
        """Gain in twice the log-likelihood at each sample that goes with a score, shape (n,) [1]."""
        known = self.information > 1e-6 * self.information.max()
        gain = np.where(known, score**2 / np.maximum(self.information, 1e-300), 0.0)
        gain[0] = 0.0  # before the first interval a step is the constant
        return gain

    @property
    def promise(self) -> float:
        """Gain of the likeliest step [1]."""
        return float(np.max(self.gain(self.score)))

    def likeliest_near(self, step: Step, *, periods: float) -> Step:
        """Return the likeliest step, to a sample, within some periods before the begin or after the end of another."""
        near = self._near(step, periods)
        place = near.start + int(np.argmax(self.gain(self.score)[near]))
        return Step(instant=(place - 1) * self.reading.interval, duration=0.0)

    def promise_near(self, step: Step, *, periods: float) -> float:
        """Gain of that step [1]."""
        return float(np.max(self.gain(self.score)[self._near(step, periods)]))

    def _near(self, step: Step, periods: float) -> slice:
        interval = self.reading.interval
        reach = periods / self.reading.dynamics.natural_frequency
        begin = int(np.clip((step.instant - reach) / interval + 1, 0, self.score.size - 1))
        end = int(np.clip((step.instant + step.duration + reach) / interval + 2, begin + 1, self.score.size))
        return slice(begin, end)

    def likeliest(self, *, threshold: float, most: int, known: Sequence[Step], fresh: int | None = None) -> list[Step]:
        """Return the likeliest further steps, to a sample, the likeliest of all first.

        Where a sudden change of slope explains more there is none: the prior takes that for a part of the force.

        Parameters
        ----------
        threshold
            Gain that each promises at least [1].
        most
            Number of them at most.
        known
            Steps among the known shapes, after the constant: beside them, and at the end of the record, only the
            first one may be.
        fresh
            From which of these on they may still be in a wrong place; None if none is.
        """
        interval, count = self.reading.interval, self.score.size
        apart = int(np.ceil(APART / (self.reading.dynamics.natural_frequency * interval)))
        reach = max(int(min(ringing_time(self.reading) / interval, count)), apart)
        score, least = self.score.copy(), np.full(count, float(threshold))
        taken = [int(np.clip(round(step.instant / interval), 0, count)) for step in known]
        waits: list[tuple[int, float]] = []
        if fresh is not None:
            of_steps = slice(1 + fresh, 1 + len(known))
            power = np.sum(self.inverse[of_steps] ** 2, axis=1)
            waits += zip(taken[fresh:], (self.sizes[of_steps] ** 2 / np.maximum(power, 1e-300)).tolist(), strict=True)
        found: list[Step] = []
        while len(found) < most:
            for at, gain in waits:
                near = slice(max(at - reach, 0), at + reach + 1)
                least[near] = np.maximum(least[near], SHARE * gain)
            if waits:
                for at in (*taken, count):
                    least[max(at - apart, 0) : at + apart + 1] = np.inf
            gains = self.gain(score)
            place = int(np.argmax(np.where(gains >= least, gains, 0.0)))
            if gains[place] < least[place]:
                break
            bend = self._bend(score, gains, place, least)
            if bend is not None:
                self.bends.append((bend - 1) * interval)
                least[max(bend - apart, 0) : bend + apart + 1] = np.inf
                score -= self._made_by_bend(score, bend)
                continue
            found.append(Step(instant=(place - 1) * interval, duration=0.0))
            if len(found) < most:
                taken, waits = [*taken, place], [(place, float(gains[place]))]
                score -= self._made_by(score, place)
        return found

    def _bend(self, score: Array, gains: Array, place: int, least: Array) -> int | None:
        """Return the place of a change of slope that explains more than the likeliest step; None where none does.

        Parameters
        ----------
        score, gains
            Score of the steps, and their gains, shape (n,).
        place
            The likeliest step.
        least
            Gain that each promises at least, shape (n,).
        """
        reach = int(np.ceil(AROUND / (self.reading.dynamics.natural_frequency * self.reading.interval)))
        of_bends = self.gain_of_bends(score)

        def beside(step: int) -> int | None:
            first = max(step - reach, 0)
            near = of_bends[first : step + reach + 1]
            likeliest = int(np.argmax(near))
            # what a change of slope far away leaves is largest at an end
            inside = 0 < likeliest < near.size - 1
            return first + likeliest if inside and near[likeliest] > gains[step] else None

        # one that explains more than any step may be what makes that step the likeliest
        largest = int(np.argmax(np.where(np.isfinite(least), of_bends, 0.0)))
        if of_bends[largest] > gains[place]:
            first = max(largest - reach, 0)
            own = first + int(np.argmax(gains[first : largest + reach + 1]))
            bend = beside(own) if gains[own] >= least[own] else None
            if bend is not None:
                return bend
        return beside(place)

    def gain_of_bends(self, score: Array) -> Array:
        """Gain in twice the log-likelihood of a change of slope at each sample with a score of steps, shape (n,) [1].

        The response to it is that to a step at each sample from there on: its score and its products are their sums.
        """
        squares = np.cumsum(np.cumsum(self.response.whole(score.size)) ** 2)[::-1]
        shown = _from_there(self.shown)
        information = squares - np.einsum("np,np->n", shown, shown)
        known = information > 1e-9 * squares
        return np.where(known, _from_there(score) ** 2 / np.maximum(information, 1e-300), 0.0)

    def _made_by_bend(self, score: Array, place: int) -> Array:
        """Return the part of a score that a change of slope at a sample makes, shape (n,)."""
        shape = np.zeros(score.size)
        shape[place:] = np.cumsum(self.response.whole(score.size - place))
        made = self.response.against(shape[:, None])[:, 0] - self.shown @ self.shown[place:].sum(axis=0)
        return np.asarray(made * (score[place:].sum() / made[place:].sum()))

    def _made_by(self, score: Array, place: int) -> Array:
        """Return the part of a score that steps at a sample and beside it make, and so one between, shape (n,)."""
        count = score.size
        places = np.clip(place + np.arange(-1, 2), 1, count - 2)
        made = self._products(int(places[1])) - self.shown @ self.shown[places].T
        return np.asarray(made @ np.linalg.lstsq(made[places], score[places], rcond=ALIKE)[0])

    def _products(self, place: int) -> Array:
        """Products of the responses to steps at three samples with those to steps at all, shape (n, 3) [1/N^2]."""
        count = self.score.size
        r = self.response.whole(count)
        column = np.zeros(count)
        column[place:] = r[: count - place]
        out = np.empty((count, 3))
        out[:, 1] = self.response.against(column[:, None])[:, 0]
        # of two steps that are both a sample later, the last sample shows no more
        last = r[::-1]
        out[1:, 2] = out[:-1, 1] - last[place] * last[:-1]
        out[0, 2] = r[: count - place - 1] @ r[place + 1 :]
        out[:-1, 0] = out[1:, 1] + last[place - 1] * last[:-1]
        out[-1, 0] = last[place - 1] * r[0]
        return out


def _from_there(series: Array) -> Array:
    """Sums of a series from each sample to the end, of its shape."""
    return np.asarray(np.cumsum(series[::-1], axis=0)[::-1])


@dataclass(frozen=True, slots=True, eq=False)
class _Response:
    """The whitened response to a step of 1 N at the first sample, which the filter's memory lets go to a constant.

    Attributes
    ----------
    first
        What it differs by from that constant, as long as it does, shape (m,) [1/N].
    last
        The constant [1/N].
    """

    first: Array
    last: float

    @classmethod
    def of(cls, reading: Observation, settled: KalmanFilter) -> _Response:
        """Whiten as many samples of the response as the memory of a settled filter is long."""
        length, count = SHORTEST, reading.values.size
        while True:
            length = min(length, count)
            late = reading.interval * (np.arange(length) + 1)
            found = settled.over(np.ones(length, dtype=np.bool_)).whiten(
                reading.dynamics.step_response(late)[:, None]
            )[:, 0]
            change = np.abs(found - found[-1])
            if length == count or np.max(change[-length // 4 :]) < FORGOTTEN * np.max(change):
                return cls(found - found[-1], float(found[-1]))
            length *= 4

    def whole(self, count: int) -> Array:
        """The response over so many samples, shape (count,) [1/N]."""
        whole = np.full(count, self.last)
        whole[: self.first.size] += self.first[:count]
        return whole

    def against(self, series: Array) -> Array:
        """Products of the responses to steps at each sample with several series, both of shape (n, c) [1/N]."""
        # the settled filter does not change with time: the response to a later step is the first one, shifted
        products = convolve(series, self.first[::-1, None])[self.first.size - 1 :]
        return np.asarray(products + self.last * np.cumsum(series[::-1], axis=0)[::-1])
