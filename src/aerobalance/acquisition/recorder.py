"""The recorder: a process of its own that writes one record and acknowledges each block when it is on the disk."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import time
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from aerobalance.acquisition.continuity import Event, LostSamples
from aerobalance.acquisition.feed import Address, Feed, Sender
from aerobalance.acquisition.intake import AtOnce, End, Intake, Output, RecordBlock, RecordPlan, RecordStart
from aerobalance.acquisition.source import Block
from aerobalance.io.hdf5_layout import BlockWriter, DiskFullError, Provenance, plain_reason
from aerobalance.io.locked_file import FileFault, LockedFile

PATIENCE: Final = 1.0
"""Time after which samples are written although their block is not full, where none follow [s]."""

LOOKED: Final = 0.25
"""Time between looks at whether the file is still in its place [s]."""

_TICK: Final = 0.1
_AT_ONCE: Final = 64
_CATCHING_UP: Final = 0.5
_UNHEARD: Final = 65536

State = Literal["starting", "waiting", "recording", "ended", "failed"]


class RecorderCommand(NamedTuple):
    """What the recorder is to do: ``call`` (trigger), ``note`` or ``stop``; with a text.

    `at` is when it was said, on the steady clock [s]; None for when it is heard.
    """

    do: Literal["call", "note", "stop"]
    text: str = ""
    at: float | None = None


@dataclass(frozen=True, slots=True)
class RecordProgress:
    """How a record stands. Every block that is counted here is on the disk.

    Attributes
    ----------
    state
        ``starting``, ``waiting`` for the trigger, ``recording``, ``ended``, or ``failed`` (nothing could be recorded).
    reason
        Why it ended, or what it waits for.
    path
        The file; not as at the beginning where it was deleted, moved or replaced meanwhile.
    blocks
        Blocks acknowledged.
    samples
        Samples in them, of each channel.
    seconds
        Length of the record by its clock, gaps included [s].
    gaps
        Number of gaps.
    lost
        Samples of each channel that are missing in them.
    events
        Number of events.
    touched
        Number of contacts between model and support.
    free
        Space left on the disk when the system last told it [bytes].
    full
        Whether a full disk ended the record.
    mishap
        What other programs did to the file, and where the record is now; an empty string for nothing.
    unkept
        Whether that ended the record.
    """

    state: State
    reason: str
    path: str
    blocks: int = 0
    samples: int = 0
    seconds: float = 0.0
    gaps: int = 0
    lost: int = 0
    events: int = 0
    touched: int = 0
    free: int = 0
    full: bool = False
    mishap: str = ""
    unkept: bool = False

    @property
    def over(self) -> bool:
        """Whether there is no more to come."""
        return self.state in ("ended", "failed")


@dataclass(frozen=True, slots=True)
class RecordJob:
    """One record.

    Attributes
    ----------
    path
        The file, which must not exist.
    plan
        What is recorded.
    clocked
        Whether the source's clock is steady.
    provenance
        Where the samples come from.
    keep_free
        Space that is left free on the disk [bytes].
    asked
        When the record was asked for, on the steady clock [s]; None for once the recorder is there.
    """

    path: str
    plan: RecordPlan
    clocked: bool
    provenance: Provenance
    keep_free: int
    asked: float | None = None


class RecordWriter:
    """Writes what an intake gives, and keeps count.

    Parameters
    ----------
    job
        What to record, and where.
    """

    def __init__(self, job: RecordJob) -> None:
        self.job = job
        self.intake = Intake(job.plan, clocked=job.clocked, asked=job.asked)
        plan = job.plan
        self.writer = BlockWriter(
            Path(job.path), plan.channels, rate=plan.rate, rows=plan.rows, provenance=job.provenance
        )
        self.held = LockedFile(Path(job.path))
        state: State = "starting" if isinstance(plan.trigger, AtOnce) else "waiting"
        self.progress = RecordProgress(state, plan.trigger.text, job.path)
        self._see_free()
        self._block_bytes = plan.rows * len(plan.channels) * 8
        self._origin = 0
        self._end: str | None = None
        self._gone = False

    def feed(self, block: Block) -> bool:
        """Take a block; say whether something was acknowledged or noted."""
        return self._write(self.intake.feed(block))

    def flush(self) -> bool:
        """Write samples that wait for their block to fill."""
        return self._write(self.intake.flush())

    def note(self, kind: str, text: str, *, at: float | None = None) -> None:
        """Write down an event at the present tick, or at that of a time on the steady clock [s]; not after the end."""
        if self.progress.over:
            return
        self._write([Event(self.intake.continuity.tick_at(at), kind, text)])

    def end(self, reason: str) -> None:
        """Write the rest and close the file."""
        self.look()
        if self.progress.over:
            return
        try:
            self._write(self.intake.flush())
            if self.progress.over:
                return
            self.writer.finish(reason)
        except DiskFullError as problem:
            self._full(str(problem))
            return
        self._set(state="ended", reason=reason)
        self.held.release()

    def look(self) -> bool:
        """See whether the file is still in its place, and go on where it is now; say whether anything has happened."""
        mishap = None if self.progress.over or self._gone else self.held.look()
        if mishap is None:
            return False
        if mishap.path is None:
            self._lost(mishap)
            return True
        text = mishap.text
        if mishap.path.name not in text:
            text += f"; the record is in {mishap.path.name}, with all samples"
        before = self.progress.mishap
        self._set(path=str(mishap.path), mishap=f"{before}; {text}" if before else text)
        self.note("file", text)
        return True

    def _lost(self, mishap: FileFault) -> None:
        """End a record whose file has no name any more: what is still open is copied to a new file."""
        self._gone = self.intake.ended = True
        reason = f"{mishap.text}; the record was ended"
        if mishap.damaged:
            reason += ", and what the file holds is damaged"
            self._set(state="ended", reason=reason, mishap=reason, unkept=True, blocks=0, samples=0)
            return
        try:
            self._write(self.intake.flush())
            with contextlib.suppress(DiskFullError):
                self.writer.finish(reason)
            copy = self.held.copy()
            reason += f", and what it holds was copied to {copy.name}"
            self._set(path=str(copy))
        except OSError as problem:
            reason += f"; it could not be copied ({problem.strerror or problem}) and is lost"
            self._set(blocks=0, samples=0)
        self._set(state="ended", reason=reason, mishap=reason, unkept=True)

    def _write(self, outputs: list[Output]) -> bool:
        try:
            for output in outputs:
                self._put(output)
                if self.progress.over:
                    break
        except DiskFullError as problem:
            self._full(str(problem))
        return bool(outputs)

    def _put(self, output: Output) -> None:
        if isinstance(output, RecordBlock):
            self._block(output)
        elif isinstance(output, LostSamples):
            self.writer.gap(output.tick, output.samples, kind=output.kind, text=output.text)
            self._set(gaps=self.progress.gaps + 1, lost=self.progress.lost + output.samples)
        elif isinstance(output, Event):
            self._event(output)
        elif isinstance(output, RecordStart):
            self.writer.origin(output.tick)
            self._origin = output.tick
            self._event(Event(output.tick, "start", output.text))
            self._set(state="recording", reason="")
        elif isinstance(output, End):
            self._event(Event(output.tick, "end", output.reason))
            self.end(output.reason)

    def _event(self, event: Event) -> None:
        self.writer.event(event.tick, kind=event.kind, text=event.text)
        done = self.progress
        self._set(events=done.events + 1, touched=done.touched + (event.kind == "contact"))

    def _block(self, block: RecordBlock) -> None:
        self.look()
        if self.progress.over:
            return
        free = self._see_free()
        if free is not None and free < self.job.keep_free + 2 * self._block_bytes:
            self._set(full=True)
            self.end_without_rest(
                f"disk full: {free / 1e6:.1f} MB left, of which {self.job.keep_free / 1e6:.1f} MB are kept free; "
                "all blocks before are kept"
            )
            return
        number = self.writer.append(block.tick, block.samples)
        done = block.tick + block.samples.shape[0]
        self._set(
            blocks=number + 1,
            samples=self.writer.samples,
            seconds=(done - self._origin) / self.job.plan.rate,
        )

    def end_without_rest(self, reason: str) -> None:
        """Close the file without the samples that wait."""
        self.intake.flush()
        self.intake.ended = True
        self.end(reason)

    def _full(self, text: str) -> None:
        """Nothing more can be written: say so in the file, in place, and be done."""
        reason = f"disk full: {text}; all blocks before are kept"
        with contextlib.suppress(OSError):
            self.writer.abandon(reason)
        self._see_free()
        self._set(state="ended", reason=reason, full=True)
        if not self._gone:  # else what the file holds is still to be copied
            self.held.release()

    def _see_free(self) -> int | None:
        """Note and return the space left on the disk [bytes]; None where the system does not tell it."""
        free = free_space(Path(self.progress.path).parent)
        if free is not None:
            self._set(free=free)
        return free

    def _set(self, **changes: Any) -> None:
        self.progress = replace(self.progress, **changes)


def free_space(folder: Path) -> int | None:
    """Return the space left on the disk of a folder [bytes]; None where the system does not tell it.

    That is no full disk: a disk that is full refuses what is written itself.
    """
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def run_recorder(job: RecordJob, address: Address, control: Connection[Any, Any]) -> None:
    """Write one record: the body of a process. It ends with the record, on SIGTERM, or with whoever started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the starter decides what it means
    told: list[str] = []
    signal.signal(signal.SIGTERM, lambda *_: told.append("the recorder was told to end"))
    try:
        feed = Feed(address, viewer=False, recent=job.asked is not None)
        take = RecordWriter(job)
    except (OSError, EOFError, RuntimeError) as problem:
        text = "the source is gone" if isinstance(problem, EOFError) else plain_reason(problem)
        with contextlib.suppress(OSError):  # who started it may be gone as well
            control.send(RecordProgress("failed", f"cannot record to {job.path}: {text}", job.path))
        return
    teller = Sender(control, _UNHEARD)
    _tell(teller, take.progress)
    _record(take, feed, (control, teller), told)
    teller.finish(0.5, last=bytes(ForkingPickler.dumps(take.progress)))
    # The library would try again to write what a full disk refused, and fail in ways that cannot be caught.
    os._exit(0)


def _record(take: RecordWriter, feed: Feed, starter: tuple[Connection[Any, Any], Sender], told: list[str]) -> None:
    """Serve the source and the starter until the record is over."""
    control, teller = starter
    last = looked = time.monotonic()
    while not take.progress.over:
        ready = wait([feed.connection, control], _TICK)
        if told:
            take.end(told[0])
            return
        if control in ready and not _obey(take, feed, control):
            return
        changed = False
        if time.monotonic() - looked > LOOKED:
            looked = time.monotonic()
            changed = take.look()
            if take.progress.over:
                return
        if feed.connection in ready:
            last = time.monotonic()
            changed |= _drain(take, feed)
        elif time.monotonic() - last > PATIENCE:
            changed |= take.flush()
        if changed and not take.progress.over:
            _tell(teller, take.progress)


def _drain(take: RecordWriter, feed: Feed) -> bool:
    """Take what the source has sent, up to a number of blocks; say whether something was acknowledged."""
    changed = False
    for _ in range(_AT_ONCE):
        try:
            got = feed.take()
        except (EOFError, OSError):
            take.end("the process of the source is gone without a word (killed, or crashed)")
            return True
        if isinstance(got, str):
            take.end(f"the source ended: {got}")
            return True
        changed |= take.feed(got)
        if take.progress.over or not feed.connection.poll():
            break
    return changed


def _catch_up(take: RecordWriter, feed: Feed, at: float) -> None:
    """Take what was sampled up to a time on the steady clock [s] and is still on its way."""
    limit = time.monotonic() + _CATCHING_UP
    while not take.progress.over and take.intake.continuity.last < at and time.monotonic() < limit:
        if not feed.connection.poll(_TICK):
            return
        _drain(take, feed)


def _obey(take: RecordWriter, feed: Feed, control: Connection[Any, Any]) -> bool:
    """Do what the starter says; return False when the record is over by that."""
    try:
        tell: RecorderCommand = control.recv()
    except (EOFError, OSError):
        take.end("the program that started the record is gone")
        return False
    if tell.at is not None:
        _catch_up(take, feed, tell.at)
    if tell.do == "stop":
        take.end(tell.text or "stopped")
        return False
    if tell.do == "call":
        take.intake.call(tell.text or "call")
    else:
        take.note("note", tell.text, at=tell.at)
    return True


def _tell(teller: Sender, progress: RecordProgress) -> None:
    """Send how the record stands; where the starter does not listen, the next one will say it all."""
    teller.offer(bytes(ForkingPickler.dumps(progress)), wait=False)
