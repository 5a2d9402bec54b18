"""A test that is watched from the page: its runs are reduced as they come in, by what the command watch does."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import threading
from collections import deque
from collections.abc import Mapping
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from aerobalance.acquisition.processes import pipe, start_worker
from aerobalance.app.monitor.folder import Folder
from aerobalance.app.monitor.log import Log
from aerobalance.app.monitor.orphan import end_with_starter
from aerobalance.app.options import as_options
from aerobalance.io.toml_file import read_toml
from aerobalance.recording.errors import DataQualityWarning, FitError, ReadError

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from aerobalance.app.campaign.campaign import Campaign, Prepared

    Pipe = Connection[Any, Any]

SAID: Final = 20
"""Words on runs that are kept."""

LARGEST: Final = 1_000_000
"""Largest test file that is listed [bytes]."""

PAGES: Final = re.compile(r"summary\.html|reports/[^/\\]+\.html")
"""Pages of a campaign that are served."""

_NICE: Final = 5


def _watch(talk: Pipe, test: str, out: str) -> None:
    """Watch a test until killed: the body of a process."""
    import warnings  # noqa: PLC0415 - this and what follows is for the process alone

    from aerobalance.app.campaign.places import is_address  # noqa: PLC0415
    from aerobalance.app.commands.campaign import watch  # noqa: PLC0415

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_starter()
    if hasattr(os, "nice"):
        os.nice(_NICE)

    def tell(what: Mapping[str, Any]) -> None:
        with contextlib.suppress(OSError):
            talk.send(dict(what))

    def heard(campaign: Campaign) -> None:
        flags = [flag.kind for flag in campaign.quality.flags]
        tell(
            {
                "name": campaign.name,
                "runs": len(campaign.rows),
                "reduced": len(campaign.reduced),
                "aside": len(campaign.aside),
                "flags": {kind: flags.count(kind) for kind in dict.fromkeys(flags)},
            }
        )

    folder = Folder(Path(test).parent)

    def check(found: Prepared) -> None:
        for place in {place for run in found.runs for place in run.inputs}:
            if is_address(place):
                raise ValueError(f"{place} is not below the project folder {folder.path.name}")
            folder.check(Path(place))

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)  # they are on the pages
            watch(test, out, say=lambda text: tell({"said": text}), heard=heard, check=check)
    except (FitError, ReadError, ValueError) as problem:
        tell({"problem": as_options(str(problem))})
    except Exception as problem:  # noqa: BLE001 - the page must hear of it, whatever it is
        tell({"problem": f"the program failed: {type(problem).__name__}: {problem}"})


class CampaignWatch:
    """The test of a project folder that is watched, and what has come of it.

    Parameters
    ----------
    folder
        Where test files are, and results are written.
    log
        What the operator is told.
    """

    def __init__(self, folder: Folder, log: Log) -> None:
        self._folder, self._log = folder, log
        self._lock = threading.Lock()
        self._said: deque[str] = deque(maxlen=SAID)
        self._shown: dict[str, Any] = {"state": "none", "version": 0}
        self._out: Path | None = None
        self.process: BaseProcess | None = None

    @property
    def shown(self) -> dict[str, Any]:
        """How it stands, as plain data: state, test, counts of runs, flags by kind, and what was said last."""
        with self._lock:
            return {**self._shown, "said": list(self._said)}

    def tests(self) -> list[str]:
        """Names of the test files of the folder."""
        found = []
        for path in sorted(self._folder.path.glob("*.toml")):
            with contextlib.suppress(OSError, ReadError, ValueError):
                if self._folder.file(path.name).stat().st_size <= LARGEST and "runs" in read_toml(path, what=""):
                    found.append(path.name)
        return found

    def begin(self, test: str) -> None:
        """Watch a test; its results are in a folder beside it, ``NAME-results``.

        Raises
        ------
        ValueError
            There is no such test file, or one is watched already.
        """
        path = self._folder.file(test)
        if path.suffix != ".toml" or not path.is_file():
            raise ValueError(f"there is no test file {test[:80]!r} in the project folder")
        out = self._folder.file(f"{path.stem}-results")
        with self._lock:
            if self._shown["state"] == "running":
                raise ValueError(f"{self._shown['test']} is being watched; end that first")
            version = self._shown["version"] + 1
            self._out = out
            self._said.clear()
            self._shown = {"state": "running", "test": path.name, "out": out.name, "version": version}
            ours, theirs = pipe()
            self.process = process = start_worker(_watch, theirs, str(path), str(out))
        theirs.close()
        threading.Thread(target=self._listen, args=(ours, process), daemon=True).start()
        self._log.changed()

    def end(self) -> None:
        """End watching; what is done is kept."""
        with self._lock:
            if self._shown["state"] != "running":
                raise ValueError("no test is watched")
            self._shown["state"] = "ended"
        self.close()
        self._log.changed()

    def page(self, name: str) -> Path:
        """Return a page of the results.

        Raises
        ------
        ValueError
            There is none of that name.
        """
        with self._lock:
            out = self._out
        if out is None or PAGES.fullmatch(name) is None:
            raise ValueError("there is no such page")
        path = self._folder.named(out / name)
        if not path.is_file():
            raise ValueError("there is no such page")
        return path

    def close(self) -> None:
        """End the process; what it was working on is done again the next time."""
        if self.process is not None:
            self.process.kill()

    def _listen(self, talk: Pipe, process: BaseProcess) -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                self._hear(talk.recv(), process)
        with self._lock:
            lost = process is self.process and self._shown["state"] == "running"
            if lost:
                self._shown |= {"state": "failed", "problem": "the process that watches is gone (killed, or crashed)"}
        if lost:
            self._log.say(f"{self._shown['test']}: {self._shown['problem']}; begin again", kind="error")

    def _hear(self, news: dict[str, Any], process: BaseProcess) -> None:
        with self._lock:
            if process is not self.process or self._shown["state"] != "running":
                return
            if "said" in news:
                self._said.append(news["said"])
            elif "problem" in news:
                self._shown |= {"state": "failed", **news}
            else:
                self._shown |= {**news, "version": self._shown["version"] + 1}
            test = self._shown["test"]
        if "problem" in news:
            self._log.say(f"{test}: {news['problem']}", kind="error")
        self._log.changed()
