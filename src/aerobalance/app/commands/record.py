"""The command `record`: start a source, record it into one file, and show the progress in a line."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from aerobalance.acquisition.recorder import RecordProgress
from aerobalance.acquisition.session import Recorder, Session
from aerobalance.acquisition.setup import Setup, load_setup, setup_from
from aerobalance.acquisition.source_settings import SOURCES
from aerobalance.app.commands.shared import Result
from aerobalance.io.hdf5_closing import close_all_broken_off, closed_text
from aerobalance.io.locked_file import recover_all
from aerobalance.io.safe_write import OUTPUTS
from aerobalance.recording.errors import FitError, warn_quality

_TICK = 0.1
"""Longest wait for news of the recorder, and time between two lines of progress [s]."""


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """Settings of the command line, which take the place of those in the set-up; None where none is given.

    Attributes
    ----------
    source
        Kind of the source, one of `SOURCES`.
    file
        Recording that is replayed.
    rig
        Rig that is simulated.
    seconds
        Length of the record [s].
    speed
        Speed over that of real time [1].
    seed
        Seed of the random numbers of a simulation.
    """

    source: str | None = None
    file: Path | None = None
    rig: str | None = None
    seconds: float | None = None
    speed: float | None = None
    seed: int | None = None


def record(
    out: Path,
    *,
    setup: Path | None = None,
    options: RecordOptions | None = None,
    replace: bool = False,
    show: Callable[[str], None] | None = None,
) -> Result:
    """Record a source until it ends, its time is over, a limit, a full disk, Ctrl-C or SIGTERM; return a summary.

    Parameters
    ----------
    out
        The file to write; it is readable from its first block on.
    setup
        File of the test set-up; its folder is where the set-up's own paths begin.
    options
        Settings that take the place of those in the set-up.
    replace
        Whether an old file of this name may be deleted.
    show
        Takes a line of progress, a few times a second.

    Returns
    -------
    result
        File, reason of the end, duration [s], numbers of blocks, samples, gaps and events, and a text in `summary`.

    Raises
    ------
    FitError
        Nothing was recorded, or a fault ended the record (a crash, a full disk), and not the operator or the set-up.
    ReadError, ValueError
        The set-up or the call is wrong.
    """
    if out.suffix.lower() not in (".h5", ".hdf5"):
        raise ValueError(f"cannot record to {out}: recordings are written as .h5; `aerobalance convert` makes others")
    chosen = chosen_setup(setup, options or RecordOptions())
    folder = Path() if setup is None else setup.parent
    for found in recover_all(out.parent):
        text = "its record was broken off by a kill after it had lost its name; what was written is in it"
        warn_quality(f"{found.name} is back: {text}")
    for name in close_all_broken_off(out.parent):  # after the recovery, so that recovered files are closed too
        warn_quality(closed_text(name))
    with _catching_signals(out) as signals, Session(chosen, folder.resolve()) as session:
        recorder = session.record(out, replace=replace)
        recorder.ready()
        signals.begun = True  # from here on a signal ends the record, and its file is closed
        OUTPUTS.note(out, replaced=False)  # from its first block on
        session.start()
        progress = _follow(recorder, session, signals, show or (lambda _: None))
    if progress.mishap and not progress.unkept:
        warn_quality(progress.mishap)
    return _record_result(progress, bool(signals), [said.text for said in session.said if said.kind == "refused"])


def chosen_setup(setup: Path | None, options: RecordOptions) -> Setup:
    """Return the set-up with the settings of the command line in it.

    Raises
    ------
    ReadError, ValueError
        The set-up is wrong, or a setting does not suit the source.
    """
    given: dict[str, Any] = {}
    if setup is not None:
        given = load_setup(setup).model_dump(exclude_none=True, exclude_unset=True)
    source = dict(given.get("source", {}))
    if options.source is not None and source.get("kind", options.source) != options.source:
        source = {}  # settings of another kind of source would not fit
    source["kind"] = options.source or source.get("kind", "simulated")
    if source["kind"] not in SOURCES:
        raise ValueError(f"--source must be one of {', '.join(SOURCES)}, not {source['kind']}")
    extra = {"file": options.file and str(options.file.absolute()), "rig": options.rig, "speed": options.speed}
    for name, value in (extra | {"seed": options.seed}).items():
        if value is None:
            continue
        if name not in SOURCES[source["kind"]].model_fields:
            raise ValueError(f"--{name} does not go with --source {source['kind']}")
        source[name] = value
    if source["kind"] == "replay" and "file" not in source:
        raise ValueError("--source replay needs --file RECORDING, or a set-up that names it")
    given["source"] = source
    if options.seconds is not None:
        given["record"] = given.get("record", {}) | {"seconds": options.seconds}
    return setup_from(given, setup or "command line")


class _StoppedError(BaseException):
    """A signal came before the record began. No `Exception`, as those are caught on the way up."""


class _Signals(list[str]):
    """Signals received, in words; one that comes before the record has `begun` ends the program at once."""

    begun = False


@contextmanager
def _catching_signals(out: Path) -> Iterator[_Signals]:
    """Collect SIGINT and SIGTERM in place of being ended by them, so that the file can be closed."""
    received = _Signals()

    def note(number: int, _: FrameType | None) -> None:
        received.append("stopped by the operator" if number == signal.SIGINT else "told to end (SIGTERM)")
        if not received.begun:
            raise _StoppedError

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    except _StoppedError:
        raise FitError(f"{received[0]} before the record began; {out.name} holds no sample") from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _follow(recorder: Recorder, session: Session, signals: list[str], show: Callable[[str], None]) -> RecordProgress:
    """Show the progress of a record until it is over or a signal comes; return how it ended."""
    shown = 0.0
    while not recorder.poll(_TICK).over:
        session.news()  # reads what the source says, which is kept in `session.said`
        if signals:
            return recorder.stop(signals[0])
        if time.monotonic() - shown >= _TICK:
            shown = time.monotonic()
            show(line(recorder.progress))
    show(line(recorder.progress))
    return recorder.progress


def line(progress: RecordProgress) -> str:
    """Return one line of text about the progress of a record."""
    if progress.state == "waiting":
        return f"waiting for the trigger ({progress.reason}); disk left {progress.free / 1e9:.1f} GB"
    left = f"disk left {progress.free / 1e9:.1f} GB"
    mishap = f"; {progress.mishap}" if progress.mishap else ""
    return f"{progress.seconds:.1f} s, {progress.blocks} blocks, {gaps_text(progress)}; {left}{mishap}"


def gaps_text(progress: RecordProgress) -> str:
    """Return how much of a record is missing, in words."""
    return f"{progress.gaps} gap(s), {progress.lost} samples lost" if progress.gaps else "no gaps"


def _record_result(progress: RecordProgress, stopped: bool, refused: list[str]) -> Result:
    """Summary of a record that has ended; `stopped` by a signal it may be empty.

    Raises
    ------
    FitError
        A fault ended the record, or nothing was recorded.
    """
    out = Path(progress.path)
    # a record that no signal, set time or limit ended tells so in its reason only
    crashed = "gone without a word" in progress.reason or "failed" in progress.reason
    if crashed or progress.full or progress.unkept or not (progress.samples or stopped):
        kept = f"{progress.blocks} block(s), {progress.samples} samples of each channel are in {out.name}"
        raise FitError(f"the record ended early: {progress.reason}; {kept}")
    return {
        "file": out.name,
        "reason": progress.reason,
        "duration": progress.seconds,
        "blocks": progress.blocks,
        "samples": progress.samples,
        "gaps": progress.gaps,
        "lost": progress.lost,
        "events": progress.events,
        "warnings": [*refused, *([progress.mishap] if progress.mishap else [])],
        "summary": f"{out}: {progress.seconds:.6g} s, {progress.samples} samples of each channel in "
        f"{progress.blocks} blocks, {gaps_text(progress)}; {progress.reason}\n",
    }
