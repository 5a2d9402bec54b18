"""What server and engine say to each other. Nothing here takes long to load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.acquisition.feed import Address
from aerobalance.app.monitor.minmax_strips import Bins
from aerobalance.balance.load_envelope import Utilisation

LINES: Final = 512
"""Lines of a spectrum that are shown."""


class ShownReading(NamedTuple):
    """A channel over the time of `NUMBERS`; `state` is ``ok``, ``high`` or ``over``, and ``none`` without a reading.

    `percent` is that of half of the range. `limit` is the share of the nearer limit; infinite beyond one at zero or on
    the other side of it, and None where there is none.

    `mean` is that of the last `seconds`, which are fewer where a `step` came before them; `least` and `largest` are
    those of all the time.
    """

    mean: float
    least: float
    largest: float
    percent: float | None
    limit: float | None
    state: str
    seconds: float = 0.0
    step: float = 0.0


class ShownForce(NamedTuple):
    """A force over the time of `NUMBERS`; the mean as in `ShownReading`, and the standard uncertainty of a sample."""

    force: float
    uncertainty: float
    least: float
    largest: float
    seconds: float
    step: float


@dataclass(slots=True)
class Update:
    """What is new.

    Attributes
    ----------
    tick
        Tick after the last sample.
    received
        When that sample came, on the steady clock [s].
    raw
        Bins of the channels.
    forces
        Bins of force and uncertainty, by component.
    readings
        Numbers by channel; empty where they are not due.
    estimates
        Forces by component; empty where they are not due.
    health
        State of health by component, as plain data.
    spectra
        Largest frequency [Hz], and amplitudes of load and force, shape (LINES, 2), by component.
    remarks
        What was found about the stream (gaps, restarts, drift), with its tick.
    lost
        Samples lost on the way to the page, so far.
    envelope
        What the combined loads take up of their envelope, at the worst; None where not due, or none is set up.
    touching
        Whether the contact circuit says that the model touches its support; None without one.
    """

    tick: int
    received: float
    raw: list[Bins] = field(default_factory=list)
    forces: dict[str, list[Bins]] = field(default_factory=dict)
    readings: dict[str, ShownReading] = field(default_factory=dict)
    estimates: dict[str, ShownForce] = field(default_factory=dict)
    health: dict[str, dict[str, object]] = field(default_factory=dict)
    spectra: dict[str, tuple[float, NDArray[np.float32]]] = field(default_factory=dict)
    remarks: list[tuple[int, str, str]] = field(default_factory=list)
    lost: int = 0
    envelope: Utilisation | None = None
    touching: bool | None = None


@dataclass(frozen=True, slots=True)
class FollowSource:
    """Order: follow this source."""

    number: int
    address: Address
    setup: str
    folder: str
    zeros: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class SetZeros:
    """Order: take off these zeros."""

    zeros: Mapping[str, float]


class TakeZeros:
    """Order: tell which zeros the last second asks for."""


class TakeMeans:
    """Order: tell the means of the channels over the last second, span by span."""


class Learner:
    """Order: the handle of a pipe to a learner follows."""


@dataclass(frozen=True, slots=True)
class LearnerWanted:
    """Answer: there is something to learn, and nobody who does; `gone` where there was somebody before."""

    gone: bool


@dataclass(frozen=True, slots=True)
class Watching:
    """Answer: a source is followed; what its channels are, and the components whose force is worked out."""

    number: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    rate: float
    width: int
    components: tuple[str, ...]
    half_ranges: Mapping[str, float]
    limits: Mapping[str, tuple[float, float]]
    masses: Mapping[str, float]
    frequencies: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class News:
    """Answer: something new to show; `number` is that of the source."""

    number: int
    update: Update
    saturated: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Zeros:
    """Answer: the zeros that were asked for."""

    zeros: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Means:
    """Answer: the means that were asked for, of each channel over spans that follow each other, SI.

    `since` is when their first samples came, on the steady clock [s].
    """

    spans: Mapping[str, tuple[float, ...]]
    since: float


@dataclass(frozen=True, slots=True)
class Trouble:
    """Answer: something went wrong or ended."""

    number: int
    text: str


Answer = Watching | News | Zeros | Means | Trouble
