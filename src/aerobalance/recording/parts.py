"""Parts of a record that is longer than is worked on at once: fixed numbers of samples, which overlap.

Where a part begins and ends follows from the length of the record alone and never from how it is read, so that the
same record gives the same numbers however it comes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

NO_TIME: Final = 0.5
"""Sampling intervals from zero below which a time is told as zero: a slower clock begins so much after its record."""

Samples_co = TypeVar("Samples_co", covariant=True)
"""What a part of a record is: a recording, or balance loads."""


class LateMeans(Mapping[str, float]):
    """Means of channels over a whole record, by name, which are worked out when they are asked for, once.

    Parameters
    ----------
    names
        The channels.
    mean_of
        Gives the mean of one.
    """

    def __init__(self, names: Iterable[str], mean_of: Callable[[str], float]) -> None:
        self._names, self._mean_of = tuple(names), mean_of
        self._found: dict[str, float] = {}

    def __getitem__(self, name: str) -> float:
        if name not in self._names:
            raise KeyError(name)
        if name not in self._found:
            self._found[name] = self._mean_of(name)
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@dataclass(frozen=True, slots=True)
class Extent:
    """Which part of a whole record a recording is, and what only the whole tells.

    Attributes
    ----------
    begin, end
        Places of the first and the last sample in the whole record, from 0 to 1 [1].
    means
        Means of channels over the whole record, by name.
    """

    begin: float = 0.0
    end: float = 1.0
    means: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_whole(self) -> bool:
        """Whether it is the whole record."""
        return self.begin <= 0 and self.end >= 1


@dataclass(frozen=True, slots=True)
class Part:
    """Samples of a record that are worked on at once.

    Attributes
    ----------
    number, count
        Which part it is, counted from 1, of how many.
    begin, end
        First sample that is worked on, and the one after the last.
    first, stop
        First sample that the part answers for, and the one after the last: those of all parts make up the record.
    margin
        Samples on either side of `first` and `stop`, within the record, that are worked on beside them.
    """

    number: int
    count: int
    begin: int
    end: int
    first: int
    stop: int
    margin: int

    def told(self, record: LongRecord[Any]) -> str:
        """Where it is in a record, in words."""
        times = (record.start + sample / record.rate for sample in (self.first, self.stop))
        begin, end = (0.0 if abs(time) * record.rate <= NO_TIME else time for time in times)
        return f"in part {self.number} of {self.count}, from {begin:.4g} s to {end:.4g} s"


class LongRecord(Protocol[Samples_co]):
    """A record whose samples can be had part by part: a recording in memory, or a file."""

    @property
    def name(self) -> str:
        """What it is called in messages."""

    @property
    def samples(self) -> int:
        """Number of samples of its steady clock."""

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""

    @property
    def start(self) -> float:
        """Time of the first sample [s]."""

    @property
    def epoch(self) -> np.datetime64 | None:
        """Date and time at which the time is zero; None where that is not known."""

    def part(self, begin: int, end: int) -> Samples_co:
        """Samples from one to another (not included)."""


def mean_over(samples: int, read: Callable[[int, int], NDArray[np.float64]], *, at_once: int) -> float:
    """Return the mean of readings of which so many are had at once; 0 where all are missing.

    Parameters
    ----------
    samples
        How many there are.
    read
        Gives those from one to another (not included), shape (m,); NaN where one is missing.
    at_once
        Most that are asked for at once.
    """
    total, count = 0.0, 0
    for begin in range(0, samples, at_once):
        values = read(begin, min(begin + at_once, samples))
        total, count = total + float(np.nansum(values)), count + int(np.isfinite(values).sum())
    return total / max(count, 1)


def parts_of(samples: int, *, length: int, margin: int) -> tuple[Part, ...]:
    """Return the parts of a record, each of `length` samples; a record up to that length is one part.

    Neighbours overlap by twice the margin and meet in the middle of that. The last part has what is left, but at least
    half the length of the others, for which it begins earlier.

    Parameters
    ----------
    samples
        Samples of the record.
    length
        Samples of a part.
    margin
        Samples on either side of a joint that both parts have, less than a quarter of the length.

    Raises
    ------
    ValueError
        The margin leaves nothing of a part.
    """
    if samples <= length:
        return (Part(1, 1, 0, samples, 0, samples, 0),)
    own = length - 2 * margin
    if own < 2 * margin:
        raise ValueError(f"a margin of {margin} samples is too much for parts of {length}")
    count = 1 + -(-(samples - length) // own)
    left = samples - (count - 1) * own
    last = min(length, next_fast_len(max(left, -(-length // 2)), real=True))  # Fourier transforms of it are fast
    joints = [0, *(place * own + margin for place in range(1, count)), samples]
    return tuple(
        Part(
            place + 1,
            count,
            place * own if place + 1 < count else samples - last,
            min(place * own + length, samples),
            joints[place],
            joints[place + 1],
            margin,
        )
        for place in range(count)
    )
