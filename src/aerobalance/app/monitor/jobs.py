"""What is done with recordings on request (info, identify, force), in a process of its own, one after the other."""

from __future__ import annotations

import contextlib
import os
import signal
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from aerobalance.app.monitor.orphan import end_with_starter
from aerobalance.app.options import as_options
from aerobalance.recording.errors import DataQualityWarning, FitError, ReadError

if TYPE_CHECKING:
    Pipe = Connection[Any, Any]

_NICE: Final = 5


@dataclass(frozen=True, slots=True)
class Task:
    """Something to do.

    Attributes
    ----------
    number
        What to call it.
    verb
        ``info``, ``decay``, ``rig``, ``force`` or ``together``, which identifies all coupled components.
    recordings
        The recordings; all but ``together`` take one.
    settings
        What else is to be said: ``component``, ``mass``, ``dynamics``, ``balance``.
    """

    number: int
    verb: str
    recordings: tuple[str, ...]
    settings: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class TaskOutcome:
    """What came of it.

    Attributes
    ----------
    number
        Of which task.
    done
        Whether there is a result.
    text
        Why there is none.
    account
        The result as plain data.
    report
        Name of its page, an empty string for none.
    files
        Names of the files that were written.
    """

    number: int
    done: bool
    text: str = ""
    account: Mapping[str, Any] | None = None
    report: str = ""
    files: tuple[str, ...] = ()


def run_jobs(pipe: Pipe) -> None:
    """Do tasks as they come: the body of a process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_starter()
    if hasattr(os, "nice"):
        os.nice(_NICE)
    with contextlib.suppress(EOFError, OSError):
        while True:
            task: Task = pipe.recv()
            pipe.send(outcome_of(task))


def outcome_of(task: Task) -> TaskOutcome:
    """Do a task; what goes wrong is said, not raised."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)  # they are in the account
            return _VERBS[task.verb](task)
    except (FitError, ReadError, ValueError) as problem:
        return TaskOutcome(task.number, False, as_options(str(problem)))
    except KeyError:
        return TaskOutcome(task.number, False, f"{task.verb[:40]!r} is none of {', '.join(_VERBS)}")
    except Exception as problem:  # noqa: BLE001 - the page must hear of it, whatever it is
        return TaskOutcome(task.number, False, f"the program failed: {type(problem).__name__}: {problem}")


def _info(task: Task) -> TaskOutcome:
    from aerobalance.app.commands.recordings import info  # noqa: PLC0415 - each verb loads what it needs

    return TaskOutcome(task.number, True, account=info(Path(task.recordings[0])))


def _identify(task: Task) -> TaskOutcome:
    from aerobalance.app.commands.identify import identify_decay, identify_rig  # noqa: PLC0415
    from aerobalance.app.monitor.identified import write_identified  # noqa: PLC0415

    path = Path(task.recordings[0])
    component = task.settings.get("component", "AF")
    mass = task.settings.get("mass", "")
    out = path.with_name(f"{path.stem}-dynamics.json")
    report = path.with_name(f"{path.stem}-identified.html")
    if task.verb == "decay":
        account = identify_decay(path, out, component=component, mass=mass)
    else:
        account = identify_rig(path, out, component=component, mass=mass or None)
    write_identified(report, account, path, component=component, kind=task.verb)
    return TaskOutcome(task.number, True, account=account, report=report.name, files=(out.name,))


def _together(task: Task) -> TaskOutcome:
    from aerobalance.app.commands.identify_coupled import identify_decays  # noqa: PLC0415

    paths = [Path(name) for name in task.recordings]
    out = paths[0].with_name(f"{paths[0].stem}-dynamics.json")
    account = identify_decays(paths, out, mass=task.settings.get("mass"))
    return TaskOutcome(task.number, True, account=account, files=(out.name,))


def _force(task: Task) -> TaskOutcome:
    from aerobalance.app.commands.balance_files import BalanceFiles  # noqa: PLC0415
    from aerobalance.app.commands.force import force  # noqa: PLC0415
    from aerobalance.io.hdf5_contents import contents  # noqa: PLC0415

    path = Path(task.recordings[0])
    out = path.with_name(f"{path.stem}-force.csv")
    report = path.with_name(f"{path.stem}-force.html")
    files = None
    if "balance" in task.settings:
        # where the record has its zero in it, its outputs are taken as they are; else those of the calibration hold
        zeroed = any(channel.offset for channel in contents(path).channels)
        files = BalanceFiles.of(Path(task.settings["balance"]), zero=[Path("none")] if zeroed else None)
    account = force(path, out, dynamics=Path(task.settings["dynamics"]), files=files, report=report)
    return TaskOutcome(task.number, True, account=account, report=report.name, files=(out.name,))


_VERBS: Final[Mapping[str, Callable[[Task], TaskOutcome]]] = {
    "info": _info,
    "decay": _identify,
    "rig": _identify,
    "force": _force,
    "together": _together,
}
