"""From the blocks of a source to the blocks of a file: pre-trigger, trigger, limits, length. No clock, no file."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple, Protocol

import numpy as np

from aerobalance.acquisition.continuity import Continuity, Event, LostSamples
from aerobalance.acquisition.fouling import Contact, ContactFinder
from aerobalance.acquisition.guards import Action, ContactCircuit, Guard, LoadColumns
from aerobalance.acquisition.source import Block
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.recording.channel import Array

LATE: Final = 0.1
"""Time by which a record may begin after it was asked for without saying so [s]."""


class RecordBlock(NamedTuple):
    """Samples for one block of the file."""

    tick: int
    samples: Array


class RecordStart(NamedTuple):
    """The record begins: `tick` is where its time is zero."""

    tick: int
    text: str


class End(NamedTuple):
    """The record is complete."""

    tick: int
    reason: str


Output = RecordBlock | LostSamples | Event | RecordStart | End


class Trigger(Protocol):
    """Says at which sample a record begins."""

    def find(self, tick: int, values: Array) -> int | None:
        """Return the tick of the sample that begins the record, or None.

        Parameters
        ----------
        tick
            Tick of the first sample.
        values
            Values of the channels in their units, shape (n, c); blocks come in order, of any size.
        """

    @property
    def text(self) -> str:
        """What was waited for, in a few words."""


@dataclass(slots=True)
class AtOnce:
    """Begins with the first sample."""

    text: str = "at once"

    def find(self, tick: int, values: Array) -> int | None:
        """Return the first sample."""
        return tick if values.shape[0] else None


@dataclass(slots=True)
class AtTime:
    """Begins a number of samples after the first one."""

    samples: int
    _first: int | None = None

    @property
    def text(self) -> str:
        """What was waited for."""
        return f"time: {self.samples} samples after the start"

    def find(self, tick: int, values: Array) -> int | None:
        """Return the sample, or the first after it where a gap swallowed it."""
        if self._first is None:
            self._first = tick
        wanted = self._first + self.samples
        return max(wanted, tick) if tick + values.shape[0] > wanted else None


@dataclass(slots=True)
class OnCall:
    """Begins only when it is told to; see `Intake.call`."""

    text: str = "call"

    def find(self, tick: int, values: Array) -> int | None:
        """Return nothing."""
        del tick, values
        return None


@dataclass(slots=True)
class AtLevel:
    """Begins where a channel crosses a level."""

    column: int
    level: float
    rising: bool
    name: str
    _before: float = float("nan")

    @property
    def text(self) -> str:
        """What was waited for."""
        return f"level: {self.name} {'rose to' if self.rising else 'fell to'} {self.level:g}"

    def find(self, tick: int, values: Array) -> int | None:
        """Return the first sample at or past the level whose forerunner was not; missing readings are passed over."""
        read = values[:, self.column] if self.rising else -values[:, self.column]
        known = np.flatnonzero(~np.isnan(read))
        if not known.size:
            return None
        level = self.level if self.rising else -self.level
        past = read[known] >= level
        # NaN before the first reading: a channel that begins past the level has not crossed it.
        before = np.concatenate(([self._before < level], ~past[:-1]))
        self._before = float(read[known[-1]])
        crossed = np.flatnonzero(past & before)
        return tick + int(known[crossed[0]]) if crossed.size else None


@dataclass(frozen=True, slots=True)
class RecordPlan:
    """What is to be recorded.

    Attributes
    ----------
    channels
        The c columns.
    rate
        Sampling rate [Hz].
    rows
        Rows of a block of the file.
    trigger
        When the record begins.
    before
        Samples kept from before the trigger.
    length
        Samples from the trigger on; None for no end.
    limits
        What channels and loads must not leave.
    after_limit
        Samples that are still recorded once a limit has stopped it.
    circuit
        The channel that tells of contact; None where there is none.
    loads
        Loads made of gauge outputs, for limits and trigger; None where they are not needed.
    """

    channels: tuple[StoredChannel, ...]
    rate: float
    rows: int
    trigger: Trigger = field(default_factory=AtOnce)
    before: int = 0
    length: int | None = None
    limits: tuple[Guard, ...] = ()
    after_limit: int = 0
    circuit: ContactCircuit | None = None
    loads: LoadColumns | None = None


class Intake:
    """Takes the blocks of a source and gives what is to be written; the samples do not depend on how they came cut.

    Parameters
    ----------
    plan
        What is to be recorded.
    clocked
        Whether the source's clock is steady.
    asked
        When the record was asked for, on the steady clock [s]: it begins no earlier, but for what it keeps from before
        its trigger. None for at once.
    """

    def __init__(self, plan: RecordPlan, *, clocked: bool = True, asked: float | None = None) -> None:
        self.plan = plan
        self._asked = asked
        self._late = ""
        self.continuity = Continuity(plan.rate, clocked=clocked)
        self.started: int | None = None
        self.ended = False
        self._stop: tuple[int, str] | None = None
        self._held: deque[Block | LostSamples | Event] = deque()
        self._open: list[Array] = []
        self._open_tick = 0
        self._open_rows = 0
        self._outside = [False] * len(plan.limits)
        self._quiet = [0] * len(plan.limits)
        circuit = plan.circuit
        self._contact = circuit and ContactFinder(circuit.level, hold=circuit.hold, closed_above=circuit.closed_above)
        self._called: str | None = None

    def call(self, text: str) -> None:
        """Begin the record with the next sample, whatever the trigger waits for."""
        self._called = text

    def feed(self, block: Block) -> list[Output]:
        """Take one block; return what is to be written, in order."""
        if self.ended:
            return []
        watched = self.continuity.follow(block)
        found: list[Output] = [item for item in (watched.gap, *watched.events) if item is not None]
        if watched.block is None:
            return self._keep(found)
        block = watched.block
        values = self._values(block.samples) if self._values_needed else block.samples
        if self.started is None:
            tick = self._begins(block, values, self._early(block))
            if tick is None:
                return self._keep([*found, block])
            return self._begin([*found, block], tick, values)
        return self._write([*found, block], values)

    def flush(self) -> list[Output]:
        """Return the samples that wait for their block to fill."""
        if not self._open_rows:
            return []
        samples = self._open[0] if len(self._open) == 1 else np.concatenate(self._open)
        block = RecordBlock(self._open_tick, samples)
        self._open, self._open_rows = [], 0
        return [block]

    @property
    def _values_needed(self) -> bool:
        return bool(self.plan.limits or self.plan.circuit) or self.started is None

    def _values(self, samples: Array) -> Array:
        values = _values(self.plan.channels, samples)
        return values if self.plan.loads is None else self.plan.loads.extended(values)

    def _early(self, block: Block) -> int:
        """Rows of a block that were sampled before the record was asked for."""
        rows = len(block.samples)
        if self._asked is None:
            return 0
        if block.received < self._asked:
            return rows
        early = self.continuity.sampled_at(self._asked) - block.tick
        if early >= rows:
            return rows
        self._asked = None
        if -early > LATE * self.plan.rate:
            self._late = (
                f"; {-early / self.plan.rate:.2f} s after it was asked for, as there are no samples from before"
            )
        return max(early, 0)

    def _begins(self, block: Block, values: Array, early: int) -> int | None:
        if early == block.samples.shape[0]:
            return None
        if self._called is not None:
            return block.tick + early
        return self.plan.trigger.find(block.tick + early, values[early:])

    def _keep(self, found: Sequence[Output | Block]) -> list[Output]:
        """Hold what came before the trigger; where the record runs, pass it on."""
        if self.started is not None:
            return [item for item in found if not isinstance(item, Block)]
        for item in found:
            if isinstance(item, Block | LostSamples | Event):
                self._held.append(item)
        oldest = (self.continuity.expected or 0) - self.plan.before
        while self._held and _end(self._held[0]) <= oldest:
            self._held.popleft()
        return []

    def _begin(self, found: Sequence[Output | Block], tick: int, values: Array) -> list[Output]:
        plan = self.plan
        text = (self._called or plan.trigger.text) + self._late
        self.started = tick
        if plan.length is not None:
            self._stop = (tick + plan.length, f"complete: {plan.length} samples from the trigger on")
        first = tick - plan.before
        made: list[Output] = [RecordStart(tick, text)]
        for item in self._held:
            cut = _from(item, first)
            if isinstance(cut, Block):
                made += self._add(cut)
            elif cut is not None:
                made += [*self.flush(), cut]
        self._held.clear()
        current = [_from(item, first) if isinstance(item, Block | LostSamples | Event) else item for item in found]
        return made + self._write([item for item in current if item is not None], values)

    def _write(self, found: Sequence[Output | Block], values: Array) -> list[Output]:
        made: list[Output] = []
        for item in found:
            if isinstance(item, LostSamples):
                made += self._lost(item)
            elif isinstance(item, Block):
                own = values[values.shape[0] - item.samples.shape[0] :]
                made += [*self._noted(item, own), *self._add(item)]
            else:
                made.append(item)
            if self.ended:
                break
        return made

    def _lost(self, gap: LostSamples) -> list[Output]:
        """A gap, as far as it lies within the record."""
        made = self.flush()
        if self._stop is not None:
            if gap.tick >= self._stop[0]:
                return [*made, *self._finish()]
            gap = gap._replace(samples=min(gap.samples, self._stop[0] - gap.tick))
        return [*made, gap]

    def _noted(self, block: Block, values: Array) -> list[Event]:
        """What is found in a block, but for what its samples from beyond the end of the record tell."""
        found = [*self._limits(block, values), *self._contacts(block, values)]
        return [event for seen, event in found if self._stop is None or seen < self._stop[0]]

    def _limits(self, block: Block, values: Array) -> list[tuple[int, Event]]:
        """Samples outside of limits: the tick that tells so, and the event."""
        made: list[tuple[int, Event]] = []
        started = block.tick if self.started is None else self.started
        for number, limit in enumerate(self.plan.limits):
            outside, known = limit.outside(values)
            outside[: max(0, started - block.tick)] = False
            edges = np.flatnonzero(outside[known] & ~np.concatenate(([self._outside[number]], outside[known][:-1])))
            if known.any():
                self._outside[number] = bool(outside[known][-1])
            for place in np.flatnonzero(known)[edges]:
                tick = block.tick + int(place)
                # One note a second: a noisy channel at its limit would fill the file with them.
                if tick >= max(self._quiet[number], started):
                    self._quiet[number] = tick + max(1, round(self.plan.rate))
                    text = limit.text(values[place])
                    self._stop_after(tick, f"limit: {text}", limit.action)
                    made.append((tick, Event(tick, "limit", text)))
        return made

    def _contacts(self, block: Block, values: Array) -> list[tuple[int, Event]]:
        """Contacts that begin or are over: the tick that tells so, and the event."""
        circuit, finder = self.plan.circuit, self._contact
        if circuit is None or finder is None:
            return []
        read, first = values[:, circuit.column], block.tick
        if self.started is not None and self.started > first:
            read, first = read[self.started - first :], self.started
        made: list[tuple[int, Event]] = []
        for contact in finder.push(first, read):
            text, seen = contact_text(contact, circuit, self.plan.rate), contact.tick
            if contact.closed:
                self._stop_after(contact.tick, f"contact: {text}", circuit.action)
            else:
                seen += max(1, circuit.hold) - 1  # only then has the circuit stayed open for long enough
            made.append((seen, Event(contact.tick, "contact" if contact.closed else "contact over", text)))
        return made

    def _stop_after(self, tick: int, reason: str, action: Action) -> None:
        """End the record soon after a sample, where that is what was wished."""
        end = tick + 1 + self.plan.after_limit
        if action == "stop" and (self._stop is None or end < self._stop[0]):
            self._stop = (end, reason)

    def _add(self, block: Block) -> list[Output]:
        """Lay samples into blocks of the file."""
        samples, tick, rows = block.samples, block.tick, self.plan.rows
        over = False
        if self._stop is not None and block.end >= self._stop[0]:
            samples, over = samples[: max(0, self._stop[0] - tick)], True
        made: list[Output] = []
        if self._open_rows and self._open_tick + self._open_rows != tick:
            made += self.flush()
        while samples.shape[0]:
            if not self._open_rows:
                self._open_tick = tick
            part = samples[: rows - self._open_rows]
            self._open.append(part)
            self._open_rows += part.shape[0]
            samples, tick = samples[part.shape[0] :], tick + part.shape[0]
            if self._open_rows == rows:
                made += self.flush()
        return made + self._finish() if over else made

    def _finish(self) -> list[Output]:
        self.ended = True
        return [*self.flush(), *([] if self._stop is None else [End(*self._stop)])]


def _values(channels: Sequence[StoredChannel], samples: Array) -> Array:
    """Readings of all channels in their units, shape (n, c)."""
    if all((item.sign, item.scale, item.offset) == (1.0, 1.0, 0.0) for item in channels):
        return samples
    return np.column_stack([item.values(samples[:, i]) for i, item in enumerate(channels)])


def _end(item: Block | LostSamples | Event) -> int:
    """Tick after the last sample of an item."""
    if isinstance(item, Block):
        return item.end
    return item.tick + (item.samples if isinstance(item, LostSamples) else 1)


def _from(item: Block | LostSamples | Event, first: int) -> Block | LostSamples | Event | None:
    """The part of an item from a tick on."""
    if _end(item) <= first:
        return None
    cut = first - item.tick
    if cut <= 0 or isinstance(item, Event):
        return item
    if isinstance(item, LostSamples):
        return item._replace(tick=first, samples=item.samples - cut)
    return replace(item, tick=first, samples=item.samples[cut:])


def contact_text(contact: Contact, circuit: ContactCircuit, rate: float) -> str:
    """Return in one line what a contact means."""
    if contact.closed:
        return f"{circuit.name}: the model touches its support; the loads carry the force of the contact from here on"
    return f"{circuit.name}: the contact is over after {contact.samples / rate:.4g} s"


def channel_columns(channels: Sequence[StoredChannel]) -> Mapping[str, int]:
    """Column of each channel, by name."""
    return {channel.name: number for number, channel in enumerate(channels)}
