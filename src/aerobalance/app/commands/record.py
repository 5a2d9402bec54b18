"""The command record: a source, one record of it, and a line that shows how it goes."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from aerobalance.acquisition.recorder import Progress
from aerobalance.acquisition.session import Recorder, Session
from aerobalance.acquisition.setup import Setup, load_setup, setup_from
from aerobalance.acquisition.source_settings import SOURCES
from aerobalance.app.commands.shared import Account
from aerobalance.io.hdf5_closing import close_all_broken_off, closed_text
from aerobalance.io.held_file import recover_all
from aerobalance.io.safe_write import OUTPUTS
from aerobalance.recording.errors import FitError, warn_quality

_TICK = 0.1


@dataclass(frozen=True, slots=True)
class Wishes:
    """What the command line sets, over what the set-up says; None where it says nothing."""

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
    wishes: Wishes | None = None,
    replace: bool = False,
    show: Callable[[str], None] | None = None,
) -> Account:
    """Record a source until its end, the end of the set time, a limit, a full disk, Ctrl-C or SIGTERM.

    Parameters
    ----------
    out
        The file to write; it is readable from its first block on.
    setup
        Test set-up.
    wishes
        What replaces it in the set-up.
    replace
        Whether an old file of this name may be deleted.
    show
        Takes a line about how it goes, a few times a second.

    Raises
    ------
    FitError
        Nothing was recorded, or what ended the record was no wish of the operator's.
    ReadError, ValueError
        The set-up or the call is wrong.
    """
    if out.suffix.lower() not in (".h5", ".hdf5"):
        raise ValueError(f"cannot record to {out}: recordings are written as .h5; `aerobalance convert` makes others")
    chosen = wished(setup, wishes or Wishes())
    folder = Path() if setup is None else setup.parent
    for found in recover_all(out.parent):
        text = "its record was broken off by a kill after it had lost its name; what was written is in it"
        warn_quality(f"{found.name} is back: {text}")
    for name in close_all_broken_off(out.parent):  # those that are back as well
        warn_quality(closed_text(name))
    with _told(out) as told, Session(chosen, folder.resolve()) as session:
        recorder = session.record(out, replace=replace)
        recorder.ready()
        told.begun = True
        OUTPUTS.note(out, replaced=False)  # from its first block on
        session.start()
        progress = _follow(recorder, session, told, show or (lambda _: None))
    if progress.mishap and not progress.unkept:
        warn_quality(progress.mishap)
    return _account(progress, bool(told), [said.text for said in session.said if said.kind == "refused"])


def wished(setup: Path | None, wishes: Wishes) -> Setup:
    """Return the set-up with the wishes of the command line in it.

    Raises
    ------
    ReadError, ValueError
        The set-up is wrong, or a wish does not suit the source.
    """
    given: dict[str, Any] = {}
    if setup is not None:
        given = load_setup(setup).model_dump(exclude_none=True, exclude_unset=True)
    source = dict(given.get("source", {}))
    if wishes.source is not None and source.get("kind", wishes.source) != wishes.source:
        source = {}
    source["kind"] = wishes.source or source.get("kind", "simulated")
    if source["kind"] not in SOURCES:
        raise ValueError(f"--source must be one of {', '.join(SOURCES)}, not {source['kind']}")
    options = {"file": wishes.file and str(wishes.file.resolve()), "rig": wishes.rig, "speed": wishes.speed}
    for name, value in (options | {"seed": wishes.seed}).items():
        if value is None:
            continue
        if name not in SOURCES[source["kind"]].model_fields:
            raise ValueError(f"--{name} does not go with --source {source['kind']}")
        source[name] = value
    if source["kind"] == "replay" and "file" not in source:
        raise ValueError("--source replay needs --file RECORDING, or a set-up that names it")
    given["source"] = source
    if wishes.seconds is not None:
        given["record"] = given.get("record", {}) | {"seconds": wishes.seconds}
    return setup_from(given, setup or "command line")


class _StoppedError(BaseException):
    """A signal came before the record began. No `Exception`, as those are caught on the way."""


class _Told(list[str]):
    """What was said; before the record has begun, it ends the program at once."""

    begun = False


@contextmanager
def _told(out: Path) -> Iterator[_Told]:
    """Collect what the operator or the system says by signals, instead of being ended by it."""
    said = _Told()

    def note(number: int, _: FrameType | None) -> None:
        said.append("stopped by the operator" if number == signal.SIGINT else "told to end (SIGTERM)")
        if not said.begun:
            raise _StoppedError

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield said
    except _StoppedError:
        raise FitError(f"{said[0]} before the record began; {out.name} holds no sample") from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _follow(recorder: Recorder, session: Session, told: list[str], show: Callable[[str], None]) -> Progress:
    """Show the record until it is over."""
    shown = 0.0
    while not recorder.poll(_TICK).over:
        session.news()
        if told:
            return recorder.stop(told[0])
        if time.monotonic() - shown >= _TICK:
            shown = time.monotonic()
            show(line(recorder.progress))
    show(line(recorder.progress))
    return recorder.progress


def line(progress: Progress) -> str:
    """Say in one line how a record stands."""
    if progress.state == "waiting":
        return f"waiting for the trigger ({progress.reason}); disk left {progress.free / 1e9:.1f} GB"
    left = f"disk left {progress.free / 1e9:.1f} GB"
    mishap = f"; {progress.mishap}" if progress.mishap else ""
    return f"{progress.seconds:.1f} s, {progress.blocks} blocks, {gaps_text(progress)}; {left}{mishap}"


def gaps_text(progress: Progress) -> str:
    """Say what is missing of a record."""
    return f"{progress.gaps} gap(s), {progress.lost} samples lost" if progress.gaps else "no gaps"


def _account(progress: Progress, told: bool, refused: list[str]) -> Account:
    out = Path(progress.path)
    crashed = "gone without a word" in progress.reason or "failed" in progress.reason
    if crashed or progress.full or progress.unkept or not (progress.samples or told):
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
