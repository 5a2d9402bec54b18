"""One source and the records made of it, as the program that starts them sees them."""

from __future__ import annotations

import contextlib
import os
import secrets
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from aerobalance.acquisition.feed import Address, Feed, Order, SourceInfo, SourceMessage, run_source
from aerobalance.acquisition.planned import plan_of
from aerobalance.acquisition.processes import pipe, start_worker
from aerobalance.acquisition.recorder import RecorderCommand, RecordJob, RecordProgress, free_space, run_recorder
from aerobalance.acquisition.scratch import make_folder, remove
from aerobalance.acquisition.setup import Setup, setup_text, stored_channels
from aerobalance.io.hdf5_closing import close_broken_off
from aerobalance.io.hdf5_layout import Provenance
from aerobalance.io.locked_file import recover_all, refuse_locked
from aerobalance.recording.errors import FitError, argument

_STARTING: Final = 60.0
_ENDING: Final = 1.5
_CLOSING: Final = 10.0
_KILLED: Final = 0.2


class Recorder:
    """A record that runs in a process of its own.

    Parameters
    ----------
    job
        What to record, and where.
    address
        Where the source is.
    """

    def __init__(self, job: RecordJob, address: Address) -> None:
        self._control, other = pipe()
        self.process = start_worker(run_recorder, job, address, other)
        other.close()
        self.progress = RecordProgress("starting", "the recorder is starting", job.path)
        self.heard = False

    def poll(self, timeout: float = 0.0) -> RecordProgress:
        """Return how the record stands, after waiting for news up to `timeout` [s]."""
        try:
            while not self.progress.over and self._control.poll(timeout):
                self.progress, timeout = self._control.recv(), 0.0
                self.heard = True
        except (EOFError, OSError):
            self._gone()
        return self.progress

    def ready(self, timeout: float = _STARTING) -> RecordProgress:
        """Wait until the recorder takes samples.

        Raises
        ------
        ValueError
            It cannot record; the message says why.
        """
        if not self._control.poll(timeout):
            raise ValueError(f"the recorder did not start within {timeout:g} s")
        progress = self.poll()
        if progress.state == "failed":
            raise ValueError(progress.reason)
        return progress

    def tell(self, tell: RecorderCommand) -> None:
        """Call the trigger, write a note, or stop the record."""
        with contextlib.suppress(OSError):
            self._control.send(tell)

    def stop(self, reason: str = "stopped", *, timeout: float = _CLOSING, hurry: bool = False) -> RecordProgress:
        """End the record and wait until its file is closed; for one that is just starting, up to a minute longer."""
        self.tell(RecorderCommand("stop", reason, time.monotonic()))
        limit = time.monotonic() + timeout + (0.0 if self.poll().over or self.heard or hurry else _STARTING)
        while not self.progress.over and time.monotonic() < limit:
            self.poll(0.1)
        self.process.join(max(0.1, limit - time.monotonic()))
        if self.process.is_alive():
            self.process.kill()
            self.process.join(_KILLED)
            self._gone()
        return self.progress

    def _gone(self) -> None:
        if not self.progress.over:
            last = self.progress
            self.process.join(1.0)  # its lock on the file goes with it
            with contextlib.suppress(OSError):  # so that other HDF5 programs can open it
                close_broken_off(last.path)
            reason = "the recorder is gone without a word (killed, or crashed); all acknowledged blocks are kept"
            names = RecordProgress.__slots__
            kept = {name: getattr(last, name) for name in names if name not in ("state", "reason")}
            back = recover_all(Path(last.path).parent)  # a file that had lost its name as well
            if back and not Path(last.path).exists():
                kept["path"], reason = str(back[0]), f"{reason}; its file is {back[0].name} now"
            self.progress = RecordProgress(state="ended", reason=reason, **kept)


class Session:
    """Runs the source of a set-up in a process of its own.

    Parameters
    ----------
    setup
        The test set-up.
    folder
        Where its files are looked for.

    Raises
    ------
    FitError, ReadError, ValueError
        The source cannot be used as set up.
    """

    def __init__(self, setup: Setup, folder: Path) -> None:
        self.setup = setup
        self._files = folder
        self._folder = make_folder()
        self.address = Address(str(self._folder / "source"), secrets.token_bytes(32))
        self._control: Connection[Any, Any]
        self._control, other = pipe()
        self.process = start_worker(run_source, setup_text(setup), str(folder), self.address, other)
        other.close()
        self.said: list[SourceMessage] = []
        self._alive = True
        try:
            late = FitError(f"the source did not start within {_STARTING:g} s")
            answer: SourceInfo | Exception = self._control.recv() if self._control.poll(_STARTING) else late
        except EOFError:
            answer = FitError("the process of the source ended while it was starting")
        except BaseException:
            self.close()
            raise
        if isinstance(answer, Exception):
            self.close()
            raise answer
        self.info = answer

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Let the samples flow."""
        self._order(Order("start"))

    def control(self, name: str, value: float) -> None:
        """Set a control of the source; the answer comes with `news`."""
        self._order(Order("control", name, value))

    def news(self, timeout: float = 0.0) -> list[SourceMessage]:
        """Return what the source's process has said since, after waiting up to `timeout` [s]."""
        found: list[SourceMessage] = []
        try:
            while self._alive and self._control.poll(timeout):
                found.append(self._control.recv())
                timeout = 0.0
        except (EOFError, OSError):
            self._alive = False
            if not any(said.kind == "ended" for said in (*self.said, *found)):
                found.append(
                    SourceMessage("ended", "the process of the source is gone without a word (killed, or crashed)")
                )
        self.said += found
        return found

    def view(self) -> Feed:
        """Connect a viewer: it gets blocks as they come, and may be slow."""
        return Feed(self.address, viewer=True)

    def record(
        self, path: Path, *, replace: bool = False, setup: Setup | None = None, asked: float | None = None
    ) -> Recorder:
        """Start a recorder; it takes samples once `Recorder.ready` has returned, or from when it was asked for.

        Parameters
        ----------
        path
            The file to write.
        replace
            Whether an old file of this name may be deleted.
        setup
            Settings of this record; those of the session where left out.
        asked
            When the record was asked for, on the steady clock [s]; what was sampled since is in it.

        Raises
        ------
        FitError
            The trigger or a limit is on a channel that is not there.
        ReadError
            The balance matrix cannot be read.
        ValueError
            The file is there already, is being written, or the disk has no room for the record.
        """
        setup = setup or self.setup
        channels = stored_channels(setup, self.info.channels)
        matrix = None
        if setup.files.balance is not None:
            # Compiled loops come with it: only what has a balance waits for them.
            from aerobalance.io.balance_file import read_matrix  # noqa: PLC0415

            matrix = read_matrix(self._files / setup.files.balance)
        plan = plan_of(setup, channels, self.info.rate, balance=matrix)
        _check_name(path, replace=replace)
        keep_free = round(setup.record.keep_free * 1e6)
        # without an end, a second is the least that is worth beginning
        samples = (plan.length or max(2 * plan.rows, round(plan.rate))) + plan.before
        wanted = samples * len(channels) * 8 + keep_free
        free = free_space(path.parent)
        if free is not None and wanted > free:
            raise ValueError(
                f"the record needs {wanted / 1e6:.0f} MB ({keep_free / 1e6:.0f} MB kept free included), but "
                f"{path.parent} has {free / 1e6:.0f} MB left; record for less time, or elsewhere"
            )
        if replace:
            refuse_locked(path)
            path.unlink(missing_ok=True)
        provenance = Provenance(self.info.description, setup_text(setup), setup.name)
        return Recorder(RecordJob(str(path), plan, self.info.clocked, provenance, keep_free, asked), self.address)

    def close(self, *, timeout: float = _ENDING) -> None:
        """End the source's process and remove its socket."""
        self._order(Order("stop"))
        self.process.join(timeout)
        if self.process.is_alive():
            self.process.kill()
            self.process.join(_KILLED)
        self._alive = False
        self._control.close()
        remove(self._folder)

    def _order(self, order: Order) -> None:
        with contextlib.suppress(OSError):
            self._control.send(order)


def _check_name(path: Path, *, replace: bool) -> None:
    """Refuse a file that cannot be recorded to."""
    try:
        if path.is_dir() or not path.parent.is_dir():
            raise ValueError(f"cannot write {path}: it is a folder, or there is no folder {path.parent}")
        taken = os.path.lexists(path)  # a link that leads nowhere as well
    except OSError as problem:
        raise ValueError(f"cannot write {str(path)[:200]}: {problem.strerror or problem}") from None
    if taken and not replace:
        raise ValueError(
            f"{path} is there already; a recording is never overwritten unless told to ({argument('replace', True)})"
        )
