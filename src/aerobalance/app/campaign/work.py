"""The work of one run, wherever it is done: read its files, reduce it, write its results, and give back its row."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic, Literal, TypeVar

import numpy as np

from aerobalance.app.campaign.assignment import Run
from aerobalance.app.campaign.places import fetched
from aerobalance.app.campaign.reduction import ReducedRun, RunSettings, reduce_run
from aerobalance.app.campaign.results import Results
from aerobalance.app.campaign.rows import Row, row_of, set_aside
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.zeros import Zero
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.io import load_channel_map, read
from aerobalance.io.artefacts import json_text
from aerobalance.io.balance_file import read_matrix
from aerobalance.io.dynamics_file import read_any_dynamics, through_balance
from aerobalance.recording.components import si_unit
from aerobalance.recording.errors import DataQualityWarning, FitError, ReadError, kept_warnings, warn_quality
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected
from aerobalance.recording.side_by_side import one_after_the_other
from aerobalance.recording.version import VERSION

if TYPE_CHECKING:
    import xarray as xr

SCHEMA: Final = 2
"""Version of what a run's results are: another one is worked out anew."""

KEPT: Final = 16
"""Matrices, dynamics and zeros that a process keeps for its next runs."""

Report = Callable[[Path, "RunWork", ReducedRun, list[str]], None]
"""Writes the page of a run at a path."""


@dataclass(frozen=True, slots=True)
class RunWork:
    """What is to be done for a run.

    Attributes
    ----------
    run
        The run with its files.
    settings
        How it is reduced.
    out
        The folder of results.
    fingerprints
        What each of its files was like when the work was planned.
    histories
        Whether time histories are written.
    reports
        Of which runs pages are written.
    version
        Version of the program that planned it.
    """

    run: Run
    settings: RunSettings
    out: str
    fingerprints: Mapping[str, str]
    histories: bool = True
    reports: Literal["all", "doubtful", "none"] = "none"
    version: str = VERSION

    @property
    def key(self) -> str:
        """Digest of all that the result hangs on: contents of files, settings and version."""
        run, prints = self.run, self.fingerprints
        single = ("file", "dynamics", "balance", "channel_map", "noise_record")
        files = {name: prints.get(getattr(run, name) or "", "") for name in single}
        several = {name: [prints[one] for one in getattr(run, name)] for name in ("zeros", "zeros_after", "tares")}
        whole = {
            "schema": SCHEMA,
            "version": self.version,
            "files": files | several,
            "names": [Path(one).name for one in run.inputs],
            "columns": dict(run.columns),
            "model_on": run.model_on,
            "fault": run.fault,
            "settings": repr(self.settings),
            "output": [self.histories, self.reports],
        }
        return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


def work_on(work: RunWork, report: Report | None = None) -> Row:
    """Reduce a run, write its results, and return its row; a run that cannot be reduced has a row with the reason.

    Parameters
    ----------
    work
        What is to be done.
    report
        Writes the page of the run; None for none.

    Raises
    ------
    ValueError
        Results cannot be written, or another version of the program planned the work.
    """
    if work.version != VERSION:
        raise ValueError(
            f"the work was planned by version {work.version}, and a worker has {VERSION}: install the same on both"
        )
    results, run = Results(work.out), work.run
    found: ReducedRun | None = None
    passing = False
    with _listened() as said, one_after_the_other():
        try:
            found = _reduced(work)
            row = row_of(run, found, said())
        except (FitError, ReadError, ValueError, np.linalg.LinAlgError, ArithmeticError) as problem:
            row = set_aside(run, " ".join(str(problem).split()), said())
        except (OSError, MemoryError) as problem:  # may be otherwise the next time
            row, passing = set_aside(run, _told(problem)), True
        except Exception as problem:  # noqa: BLE001 - one run must not stop the others
            row, passing = set_aside(run, f"a fault of the program, please report it ({_told(problem)})"), True
    results.forget(run.name)
    outputs = []
    if found is not None and work.histories:
        outputs.append(results.write_history(run.name, history_of(found)))
    doubtful = found is not None and (row["verdict"] != "fit for use" or bool(row["warnings"]))
    if (
        found is not None
        and report is not None
        and (work.reports == "all" or (work.reports == "doubtful" and doubtful))
    ):
        with results.writing("reports", f"{run.name}.html") as beside:
            report(beside, work, found, row["warnings"])
        outputs.append(f"reports/{run.name}.html")
    row["report"] = outputs[-1] if outputs and outputs[-1].startswith("reports/") else ""
    row = dict(json.loads(json_text(row)))  # as it is read again
    if not passing:
        results.record(run.name, work.key, row, outputs)
    return row


@contextmanager
def _listened() -> Iterator[Callable[[], list[str]]]:
    """Collect what is warned of; what is given lists it, each text once."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", DataQualityWarning)
        yield lambda: list(
            dict.fromkeys(
                " ".join(str(one.message).split()) for one in caught if issubclass(one.category, DataQualityWarning)
            )
        )


def _told(problem: BaseException) -> str:
    return " ".join(f"{type(problem).__name__}: {problem}".split())


def _reduced(work: RunWork) -> ReducedRun:
    """Read the files of a run and reduce it."""
    run, prints = work.run, work.fingerprints
    if run.fault:
        raise FitError(run.fault)

    def marked(place: str) -> tuple[str, str]:
        return place, prints[place]

    chart = ("", "") if run.channel_map is None else marked(run.channel_map)
    if run.dynamics is None:
        raise FitError("no dynamics are given")
    known = _dynamics(*marked(run.dynamics))
    balance = None
    if run.balance is not None:
        balance = _matrix(*marked(run.balance))
        with fetched(run.balance) as matrix, fetched(run.dynamics) as path:
            known = through_balance(matrix, known, dynamics=path)
    zero = None
    if run.zeros and balance is not None:
        before, after = (
            tuple(_calm(*marked(one), *chart) for one in places) for places in (run.zeros, run.zeros_after)
        )
        zero = Zero(before, model_on=run.model_on, after=after)
    noise = None if run.noise_record is None else _calm(*marked(run.noise_record), *chart)
    return reduce_run(
        recording_at(run.file, run.channel_map),
        known,
        balance=balance,
        zero=zero,
        tare=[_calm(*marked(one), *chart) for one in run.tares],
        noise=noise,
        columns=run.columns,
        settings=work.settings,
    )


def recording_at(place: str, channel_map: str | None) -> Recording:
    """Read a recording, what its sensors do undone; as the command force does."""
    with fetched(place) as path:
        if channel_map is None:
            return corrected(read(path))
        with fetched(channel_map) as chart:
            return corrected(read(path, channel_map=load_channel_map(chart)))


Known = TypeVar("Known")


class _Shared(Generic[Known]):
    """Reads files that many runs share once a process, and says of each run what is to be said of them.

    Which run of a process comes first then makes no difference.
    """

    def __init__(self, read_one: Callable[[str, str], Known]) -> None:
        self.read_one = read_one
        self.found: OrderedDict[tuple[str, ...], tuple[Known, list[str]]] = OrderedDict()

    def __call__(self, place: str, fingerprint: str, chart: str = "", chart_fingerprint: str = "") -> Known:
        key = place, fingerprint, chart, chart_fingerprint
        if key not in self.found:
            with kept_warnings() as said:
                self.found[key] = self.read_one(place, chart), said
            while len(self.found) > KEPT:
                self.found.popitem(last=False)
        self.found.move_to_end(key)
        known, said = self.found[key]
        for text in said:
            warn_quality(text)
        return known


def _read_dynamics(place: str, _: str) -> BalanceDynamics:
    with fetched(place) as path:
        return read_any_dynamics(path)


def _read_matrix(place: str, _: str) -> BalanceMatrix:
    with fetched(place) as path:
        return read_matrix(path)


_dynamics: Final = _Shared(_read_dynamics)
_matrix: Final = _Shared(_read_matrix)
_calm: Final = _Shared(lambda place, chart: recording_at(place, chart or None))


def history_of(found: ReducedRun) -> xr.Dataset:
    """Forces and loads of a run with their standard uncertainties along the time, with units."""
    force = found.force
    data = force.to_xarray()
    recording, loads = force.recording, force.loads
    known: dict[str, Any] = {}
    u = None if loads is None else loads.uncertainty
    for name in force.components:
        about = {"units": si_unit(name), "long_name": f"balance load, {name}"}
        known[f"load_{name}"] = ("time", recording.channel(name).values, about)
        if loads is not None and u is not None:
            about = {"units": si_unit(name), "long_name": f"standard uncertainty of the balance load, {name}"}
            known[f"u_load_{name}"] = ("time", u[:, loads.components.index(name)], about)
    return data.assign(known)
