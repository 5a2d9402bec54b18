"""The taps in a recording: when the hammer touches, what its channel leaves of the force, and which are no good."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from aerobalance.identification.step_relaxation.record import FEWEST, ROUNDING
from aerobalance.recording.channel import IMPACT_FORCE, Array, Channel
from aerobalance.recording.errors import A_RELEASE, FitError, argument, warn_quality
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording

FORCE: Final = IMPACT_FORCE
"""Name of the channel of the hammer's force."""

Fault = Literal["double hit", "clipped", "gap", "no pretrigger"]


@dataclass(frozen=True, slots=True)
class TapSettings:
    """Thresholds of the search for taps.

    Attributes
    ----------
    loud, share
        Force over the noise, and over the largest in the recording, from which the hammer touches.
    skirt, skirt_share
        The same for the beginning and the end of a contact, the share over the peak of the contact.
    margin
        Samples beside a contact that are taken as of it.
    double
        Time within which a second contact is one of the same blow [s].
    before
        Time before a contact whose readings tell how the balance still moves [s], and share of the gap between taps.
    droop
        Deviations by which a high-pass must show to be undone.
    flat
        Equal readings at the peak from which it is clipped.
    fewest_after
        Readings after a contact that a tap must have.
    """

    loud: float = 8.0
    share: float = 0.01
    skirt: float = 3.0
    skirt_share: float = 0.0005
    margin: int = 2
    double: float = 0.15
    before: tuple[float, float] = (0.25, 0.25)
    droop: float = 8.0
    flat: int = 3
    fewest_after: int = 64


SETTINGS: Final = TapSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundTap:
    """One tap as it was found.

    Attributes
    ----------
    contact
        First and last sample of the contact, from the beginning of the recording.
    before, after
        Samples whose loads are used: shape (a,) and (b,).
    force
        Force by sample of the contact, the rest of its channel taken off, shape (c,) [N].
    fault
        What is wrong with it; None for a good one. A double hit is left out, of the others the ringing is used.
    """

    contact: tuple[int, int]
    before: NDArray[np.intp]
    after: NDArray[np.intp]
    force: Array
    fault: Fault | None

    @property
    def peak(self) -> float:
        """Largest force [N], with its sign."""
        return float(self.force[np.argmax(np.abs(self.force))])


@dataclass(frozen=True, slots=True, eq=False)
class TapRecord:
    """The taps of one recording.

    Attributes
    ----------
    name
        What it is called in messages.
    start, rate
        Time of the first sample on the recording's clock [s], and sampling rate [Hz].
    values
        Balance loads, NaN where missing or at a limit, shape (m, n) [N, N*m].
    noise
        Standard deviation of one reading of each load, shape (n,) [N, N*m].
    force_noise
        Standard deviation of one reading of the force [N].
    taps
        What was found.
    corner, u_corner
        Corner of the high-pass that the force's channel shows [Hz]; zero where none is, and its standard uncertainty.
    delay
        What is left of the delay of the force behind the loads that the channels state, once the force is advanced by
        whole samples [s].
    """

    name: str
    start: float
    rate: float
    values: Array
    noise: Array
    force_noise: float
    taps: tuple[FoundTap, ...]
    corner: float
    u_corner: float
    delay: float

    def instant(self, tap: FoundTap) -> float:
        """Instant of the largest force on the recording's clock [s]."""
        return self.start + (tap.contact[0] + int(np.argmax(np.abs(tap.force)))) / self.rate


def tap_record(recording: Recording, components: tuple[str, ...]) -> TapRecord:
    """Take loads and force of a recording, and find the taps in it.

    Raises
    ------
    FitError
        A channel is missing, nothing was tapped, or too few readings can be used.
    """
    if FORCE not in recording:
        raise FitError(
            f"{recording.name} has no {FORCE}, the measured force of the hammer in N; it has "
            f"{', '.join(recording.channels)}. A channel map names the column it is in "
            f"({argument('channel_map')}); a release has no measured force: {A_RELEASE}"
        )
    channels = [recording.channel(name) for name in components]
    values = np.column_stack([_usable(channel, recording.name) for channel in channels])
    judged = np.array([channel_noise(channel) for channel in channels])
    largest = float(np.nanmax(np.nanmax(values, axis=0) - np.nanmin(values, axis=0)))
    noise = np.maximum(judged, ROUNDING * max(largest, np.finfo(float).tiny))
    force, delay = _advanced(recording.channel(FORCE), channels, recording.rate)
    readings, scatter = _levelled(force)
    found = _contacts(readings, scatter, recording.rate)
    if not found:
        raise FitError(
            f"{recording.name}: {FORCE} never stands out of its noise"
            f"{f' ({scatter:.2g} N)' if scatter > np.finfo(float).tiny else ''}; was the hammer connected?"
        )
    corner, u_corner = _corner(readings, found, recording.rate, scatter)
    if corner > SETTINGS.droop * u_corner:
        readings = readings - corner * _integral(readings, _between(readings, found, scatter)[1], recording.rate)
        readings = _rebased(readings, found, scatter)
        found = _contacts(readings, scatter, recording.rate)
    else:
        corner = 0.0
    usable = np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)
    taps = _taps(readings, found, usable, recording.rate, scatter=scatter, raw=force.values)
    return TapRecord(
        recording.name, recording.start, recording.rate, values, noise, scatter, taps, corner, u_corner, delay
    )


def _usable(channel: Channel, name: str) -> Array:
    """Readings that can be used, NaN elsewhere; says so where some cannot."""
    limited = channel.saturated
    if limited.any():
        warn_quality(f"{name}: {int(limited.sum())} readings of {channel.name} rest on a limit; they are left out")
    if np.count_nonzero(np.isfinite(channel.values) & ~limited) < FEWEST:
        raise FitError(f"{name}: fewer than {FEWEST} usable readings of {channel.name}; a tap needs many more")
    return np.where(limited, np.nan, channel.values)


def _advanced(force: Channel, loads: list[Channel], rate: float) -> tuple[Channel, float]:
    """The force advanced by whole samples against the loads, as their stated delays have it, and the rest [s].

    Contacts are looked for in it, so that loads count as before or after a contact by when the hammer touched.
    """
    delay = force.delay - float(np.mean([channel.delay for channel in loads]))
    count = round(delay * rate)
    if not count:
        return force, delay
    values = np.full(force.values.size, np.nan)
    source = slice(max(count, 0), values.size + min(count, 0))
    values[source.start - count : source.stop - count] = force.values[source]
    return replace(force, values=values), delay - count / rate


def _levelled(force: Channel) -> tuple[Array, float]:
    """Readings of the force less what they rest at, and their noise."""
    values = force.values
    known = values[np.isfinite(values)]
    if known.size < FEWEST:
        raise FitError(f"{force.name} has {known.size} readings; a tap needs many more")
    level = float(np.median(known))
    scatter = float(np.median(np.abs(known - level))) / 0.6745
    scatter = force.noise if force.noise is not None else max(scatter, ROUNDING * float(np.ptp(known)))
    return values - level, float(max(scatter, np.finfo(float).tiny))


def _contacts(readings: Array, scatter: float, rate: float) -> list[list[tuple[int, int]]]:
    """Contacts of every blow, first and last sample each: more than one where the hammer bounced."""
    size = np.abs(np.nan_to_num(readings))
    touched = size > max(SETTINGS.loud * scatter, SETTINGS.share * float(size.max()))
    edges = np.diff(np.concatenate(([0], touched.astype(np.int8), [0])))
    contacts: list[tuple[int, int]] = []
    for rise, fall in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1, strict=True):
        first, last = int(rise), int(fall)
        level = max(SETTINGS.skirt * scatter, SETTINGS.skirt_share * float(size[first : last + 1].max()))
        while first > 0 and size[first - 1] > level:
            first -= 1
        while last < size.size - 1 and size[last + 1] > level:
            last += 1
        begin, end = max(first - SETTINGS.margin, 0), min(last + SETTINGS.margin, size.size - 1)
        if contacts and begin <= contacts[-1][1] + 1:
            contacts[-1] = (contacts[-1][0], max(end, contacts[-1][1]))
        elif last > first:
            contacts.append((begin, end))
    blows: list[list[tuple[int, int]]] = []
    for contact in contacts:
        if blows and contact[0] - blows[-1][-1][1] < SETTINGS.double * rate:
            blows[-1].append(contact)
        else:
            blows.append([contact])
    return blows


def _corner(readings: Array, blows: list[list[tuple[int, int]]], rate: float, scatter: float) -> tuple[float, float]:
    """Corner of a high-pass that the readings between the taps show [Hz], and its standard uncertainty.

    A first-order high-pass of the corner c takes 2 pi c times the integral of what it puts out off the force. Between
    the taps the force is zero, so the readings there tell c.
    """
    free, wild = _between(readings, blows, scatter)
    known, integral = np.nan_to_num(readings), _integral(readings, wild, rate)
    time = np.arange(readings.size) / readings.size
    table = np.column_stack([integral, np.ones(time.size), time])[free]
    table[:, 0] -= table[:, 0].mean()
    coefficients, _, rank, _ = np.linalg.lstsq(table, known[free], rcond=None)
    if rank < table.shape[1]:
        return 0.0, np.inf
    u = scatter * float(np.sqrt(np.linalg.inv(table.T @ table)[0, 0]))
    return float(coefficients[0]), u


def _integral(readings: Array, wild: NDArray[np.bool_], rate: float) -> Array:
    """What a high-pass with a corner of 1 Hz takes off a force, by its readings but for those that are none of it."""
    return np.asarray(-2 * np.pi * np.cumsum(np.where(wild, 0.0, np.nan_to_num(readings))) / rate)


def _between(
    readings: Array, blows: list[list[tuple[int, int]]], scatter: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which readings are before the taps and between them, and which stand out alone there, shape (n,) each.

    A single reading that is none of the force would pass for the slow changes that a high-pass puts out.
    """
    free = np.isfinite(readings)
    for blow in blows:
        free[blow[0][0] : blow[-1][1] + 1] = False
    steps = np.diff(np.nan_to_num(readings), prepend=0.0, append=0.0)
    out, back = steps[:-1], -steps[1:]
    wild = free & (out * back > 0) & (np.minimum(np.abs(out), np.abs(back)) > SETTINGS.loud * scatter)
    return free & ~wild, wild


def _rebased(readings: Array, blows: list[list[tuple[int, int]]], scatter: float) -> Array:
    """Readings less a straight line through those before the taps and between them."""
    free, _ = _between(readings, blows, scatter)
    time = np.arange(readings.size, dtype=np.float64)
    line = np.polyfit(time[free], readings[free], 1)
    return readings - np.polyval(line, time)


def _taps(
    readings: Array,
    blows: list[list[tuple[int, int]]],
    usable: NDArray[np.bool_],
    rate: float,
    *,
    scatter: float,
    raw: Array,
) -> tuple[FoundTap, ...]:
    found = []
    for number, blow in enumerate(blows):
        first, last = blow[0][0], blow[-1][1]
        earlier = blows[number - 1][-1][1] + 1 if number else 0
        later = blows[number + 1][0][0] if number + 1 < len(blows) else usable.size
        seconds, share = SETTINGS.before
        before = max(earlier, first - round(seconds * rate))
        if number:
            before = max(before, first - round(share * (first - earlier)))
        if number + 1 < len(blows):
            later -= min(round(seconds * rate), round(share * (later - last)))
        rows = np.flatnonzero(usable)
        early = rows[(rows >= before) & (rows < first)]
        after = rows[(rows > last) & (rows < later)]
        force = readings[first : last + 1]
        base = _base(readings, first, earlier)
        fault: Fault | None = None
        if not np.isfinite(force).all():
            fault = "gap"
        elif len(blow) > 1:
            fault = "double hit"
        elif _clipped(raw[first : last + 1], scatter):
            fault = "clipped"
        elif early.size < 8:
            fault = "no pretrigger"
        if after.size >= SETTINGS.fewest_after:
            found.append(FoundTap((first, last), early, after, np.nan_to_num(force) - base, fault))
    return tuple(found)


def _base(readings: Array, first: int, earlier: int) -> float:
    """What the channel rests at just before a contact."""
    rest = readings[max(earlier, first - 1024) : first]
    rest = rest[np.isfinite(rest)]
    return float(rest.mean()) if rest.size >= 16 else 0.0


def _clipped(force: Array, scatter: float) -> bool:
    """Whether the readings rest on a limit at the peak of a contact."""
    size = np.abs(force)
    top = float(size.max())
    flat = np.flatnonzero(size == top)
    if flat.size < SETTINGS.flat or flat[-1] - flat[0] != flat.size - 1:
        return False
    first, last = int(flat[0]), int(flat[-1])
    if first < 2 or last > size.size - 3:
        return False
    inner, outer = (size[first - 1] + size[last + 1]) / 2, (size[first - 2] + size[last + 2]) / 2
    half = (last - first + 2) / 2
    overshoot = inner + (inner - outer) * half**2 / (2 * half + 1) - top
    steps = np.diff(np.unique(size))
    return bool(overshoot > 2 * max(scatter, float(steps.min()) if steps.size else 0.0))
