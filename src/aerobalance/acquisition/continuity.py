"""Gaps, repeats, restarts and drift of a source's clock, told from the ticks of its blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from aerobalance.acquisition.source import Block

DRIFT_WATCHED: Final = 20.0
"""Time over which the least delay of arrival is taken, before and after [s]."""

DRIFT_NOTED: Final = 0.05
"""Change of the least delay that is noted [s]; arrivals of buffered devices vary by less."""


class LostSamples(NamedTuple):
    """Samples that are missing.

    Attributes
    ----------
    tick
        Number of the first one.
    samples
        How many.
    kind
        ``gap``, ``remark`` (the source gave a reason) or ``restart`` (the count of the device went back).
    text
        What is known of the reason.
    """

    tick: int
    samples: int
    kind: str
    text: str


class Event(NamedTuple):
    """Something that happened at a tick."""

    tick: int
    kind: str
    text: str


class Watched(NamedTuple):
    """A block with its place in the record, and what was found about it."""

    block: Block | None
    gap: LostSamples | None
    events: tuple[Event, ...]


@dataclass(slots=True)
class Continuity:
    """Follows the ticks of a source.

    Parameters
    ----------
    rate
        Sampling rate [Hz].
    clocked
        Whether the source's clock is steady, so that drift means something.
    """

    rate: float
    clocked: bool = True
    expected: int | None = None
    shift: int = 0
    last: float = 0.0
    _least: float = float("inf")  # least delay of arrival of this window of time, and of that before it [s]
    _before: float = float("inf")
    _until: float = -float("inf")  # when this window ends, on the steady clock [s]
    _first: float | None = None
    _early: float = float("inf")
    _late: float = float("inf")
    _window: float = 0.0
    _noted: float = 0.0

    def tick_at(self, at: float | None) -> int:
        """Tick of the sample of a time on the steady clock [s], as far as there is one yet; of the next for None."""
        if self.expected is None:
            return 0
        return self.expected if at is None else min(max(0, self.sampled_at(at)), self.expected)

    def sampled_at(self, at: float) -> int:
        """Tick of the sample of a time on the steady clock [s], whether it has come or not, once a block has.

        By the least delay of arrival of the last `DRIFT_WATCHED`: a computer that is busy takes blocks late, never
        early. Where samples come by no clock, by the last block alone.
        """
        delay = min(self._least, self._before) if self.clocked else self.last - (self.expected or 0) / self.rate
        return round((at - delay) * self.rate)

    def follow(self, block: Block) -> Watched:
        """Put a block in its place: samples that came before are taken off, missing ones are counted."""
        tick = block.tick + self.shift
        rows = block.samples.shape[0]
        if rows == 0:
            return Watched(None, None, ())
        if self.expected is None:
            self.expected, block = tick, replace(block, anew=False)
        events: list[Event] = []
        gap = None
        if block.anew or tick + rows <= self.expected:
            gap, tick = self._restarted(block, tick, self.expected)
        elif tick < self.expected:
            repeated = self.expected - tick
            events.append(Event(self.expected, "repeat", f"{repeated} sample(s) came twice; the first are kept"))
            block = replace(block, samples=block.samples[repeated:])
            tick = self.expected
        elif tick > self.expected:
            missing = tick - self.expected
            kind = "remark" if block.remark else "gap"
            gap = LostSamples(self.expected, missing, kind, block.remark or "the tick of the source jumped")
        if block.remark and gap is None:
            events.append(Event(tick, "source", block.remark))
        block = replace(block, tick=tick)
        self.expected, self.last = block.end, block.received
        if gap is not None and gap.kind == "restart":
            self._before = self._least = float("inf")
        self._follow_delay(block)
        if gap is not None:
            self._first, self._early, self._late, self._noted = None, float("inf"), float("inf"), 0.0
        if self.clocked:
            events += self._drift(block)
        return Watched(block, gap, tuple(events))

    def _restarted(self, block: Block, tick: int, expected: int) -> tuple[LostSamples | None, int]:
        """Continue the count of a device that began anew: only the computer's clock tells how long it was away."""
        rows = block.samples.shape[0]
        away = round((block.received - self.last) * self.rate) - rows
        missing = max(away, 0)
        place = expected + missing
        self.shift += place - tick
        text = f"{block.remark or 'the count of the source went back'}; length from the computer's clock"
        return LostSamples(expected, missing, "restart", text), place

    def _follow_delay(self, block: Block) -> None:
        """Take the delay of a block's arrival into the least one of its window of time."""
        if block.received > self._until:
            self._until = block.received + DRIFT_WATCHED / 2
            self._before, self._least = self._least, float("inf")
        self._least = min(self._least, block.received - block.end / self.rate)

    def _drift(self, block: Block) -> list[Event]:
        """Compare the least delays of arrival of two windows of time: delays vary, the least ones hardly do."""
        delay = block.received - block.end / self.rate
        if self._first is None:
            self._first = self._window = block.received
        since = block.received - self._first
        if since <= DRIFT_WATCHED:
            self._early = min(self._early, delay)
            self._window = block.received
            return []
        self._late = min(self._late, delay)
        if block.received - self._window < DRIFT_WATCHED:
            return []
        change, self._late, self._window = self._late - self._early, float("inf"), block.received
        if abs(change - self._noted) < DRIFT_NOTED:
            return []
        self._noted = change
        text = (
            f"the clock of the source is {abs(change):.3f} s {'behind' if change > 0 else 'ahead of'} the computer's "
            f"after {since:.0f} s ({-change / since * 1e6:+.0f} ppm); times in the record are the source's"
        )
        return [Event(block.end, "drift", text)]
