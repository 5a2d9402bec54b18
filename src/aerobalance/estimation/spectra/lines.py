"""Steady lines of a reading, as a sine and a cosine each, also of a frequency that drifts along the record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array

Response: TypeAlias = Callable[[Array], NDArray[np.complex128]]
"""What a balance makes of a force at frequencies [Hz]."""


@dataclass(frozen=True, slots=True)
class Line:
    """One steady line of a reading.

    Attributes
    ----------
    frequency
        Its frequency [Hz].
    sine, cosine
        Amplitudes of its sine and its cosine in the reading, with phase zero at the middle of the record [N].
    u_frequency
        Standard uncertainty of the frequency [Hz].
    evidence
        By how much the line raises twice the log-likelihood over that of its surroundings alone [1].
    drift
        How its frequency drifts along the record (`turned_time`).
    """

    frequency: float
    sine: float
    cosine: float
    u_frequency: float
    evidence: float
    drift: tuple[float, ...] = ()

    @property
    def amplitude(self) -> float:
        """Its amplitude in the reading [N]."""
        return float(np.hypot(self.sine, self.cosine))

    def read_by(self, response: Response) -> Line:
        """The same line of a force as a balance of that response reads it."""
        phasor = complex(self.cosine, -self.sine) * complex(response(np.array([self.frequency]))[0])
        return replace(self, sine=-phasor.imag, cosine=phasor.real)


def turned_time(drift: Sequence[float], *, count: int, interval: float) -> tuple[Array, Array]:
    """Return the time in which a frequency that drifts is steady, zero at the middle [s], and how fast it runs [1].

    At x, from -1 at the begin of the record to 1 at its end, the frequency is 1 + d1 x + d2 x^2 + ... times its own.
    The phase of all harmonics of one rotation goes with that time.

    Parameters
    ----------
    drift
        The numbers d1, d2, ... [1].
    count
        Number of samples n.
    interval
        Time between samples [s].
    """
    time = np.asarray((np.arange(count) - (count - 1) / 2) * interval, dtype=np.float64)
    half = 0.5 * (count - 1) * interval
    place = time / half if half > 0 else time
    turned, rate = time.copy(), np.ones(count)
    for power, number in enumerate(drift, start=1):
        rate += number * place**power
        turned += half * number * place ** (power + 1) / (power + 1)
    return turned, rate


def columns_of_lines(
    frequencies: Sequence[float],
    *,
    count: int,
    interval: float,
    drift: Sequence[float] = (),
    response: Response | None = None,
) -> Array:
    """Return sine and cosine of each line, of phase zero at the middle of the record, shape (n, 2 lines) [1].

    Parameters
    ----------
    frequencies
        Of the lines [Hz].
    count
        Number of samples n.
    interval
        Time between samples [s].
    drift
        How the frequencies drift along the record (`turned_time`).
    response
        What the balance makes of a force at frequencies [Hz]: where these drift, the reading of a steady force changes
        with it. None where the reading itself is steady.
    """
    columns = [np.zeros((count, 0))]
    if not len(frequencies):  # as of most records
        return columns[0]
    turned, rate = turned_time(drift, count=count, interval=interval)
    for frequency in frequencies:
        angle = 2 * np.pi * frequency * turned
        sine, cosine = np.sin(angle), np.cos(angle)
        if drift and response is not None:
            both = (cosine + 1j * sine) * response(frequency * rate) / response(np.array([frequency]))
            sine, cosine = both.imag, both.real
        columns.append(np.column_stack([sine, cosine]))
    return np.column_stack(columns)


def reading_of_lines(lines: Sequence[Line], *, count: int, interval: float, response: Response | None = None) -> Array:
    """Return the part of a reading that lines make up, shape (n,) [N]: `count` samples, `interval` apart [s].

    `response` is that of the balance where frequencies drift (`columns_of_lines`).
    """
    found = np.zeros(count)
    for line in lines:
        both = columns_of_lines([line.frequency], count=count, interval=interval, drift=line.drift, response=response)
        found += both @ np.array([line.sine, line.cosine])
    return found
