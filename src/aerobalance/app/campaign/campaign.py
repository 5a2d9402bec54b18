"""A whole test at once: `reduce_runs` reduces all of its runs, and does only what is not done yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from dataclasses import replace as replaced
from pathlib import Path
from time import time
from typing import TYPE_CHECKING, Any

from aerobalance.app.campaign.assignment import Run, assigned, definition_of_folder
from aerobalance.app.campaign.definition import Definition, load_definition
from aerobalance.app.campaign.engine import Engine
from aerobalance.app.campaign.places import each_of, exists, fetched, fingerprint, folder_of, is_address, name_of
from aerobalance.app.campaign.quality import Quality, quality_of
from aerobalance.app.campaign.reduction import RunSettings
from aerobalance.app.campaign.results import HISTORIES, KIND, MANIFEST, PAGE, SUMMARY, Results, import_needed
from aerobalance.app.campaign.rows import ASIDE, REDUCED, Row, head_of, set_aside
from aerobalance.app.campaign.work import Report, RunWork
from aerobalance.io.artefacts import json_text
from aerobalance.io.safe_write import OUTPUTS
from aerobalance.recording.errors import ReadError, argument
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.version import VERSION

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """The results of a test.

    Attributes
    ----------
    name
        What the test is called.
    out
        The folder of results.
    rows
        One row a run, in the order of the test.
    quality
        What the runs say together.
    done
        Names of the runs that this call worked out; the others were known.
    definition
        What the test is.
    seconds
        How long this call took [s].
    """

    name: str
    out: str
    rows: Sequence[Row]
    quality: Quality
    done: tuple[str, ...]
    definition: Definition
    seconds: float = 0.0

    @property
    def reduced(self) -> list[Row]:
        """Rows of the runs that were reduced."""
        return [row for row in self.rows if row["status"] == REDUCED]

    @property
    def aside(self) -> dict[str, str]:
        """Runs that were set aside, each with its reason."""
        return {row["run_name"]: row["reason"] for row in self.rows if row["status"] == ASIDE}

    @property
    def table(self) -> pd.DataFrame:
        """One row a run, as in ``summary.parquet``."""
        import pandas as pd  # noqa: PLC0415 - takes a third of a second

        return pd.DataFrame(list(self.rows)).set_index("run_name")

    def history(self, run: str) -> xr.Dataset:
        """Loads and forces of a run with their standard uncertainties along the time [N, N*m]."""
        import xarray as xr  # noqa: PLC0415 - of an extra

        data: xr.Dataset = xr.open_zarr(Results(self.out).place(HISTORIES), group=run, consolidated=False)
        return data


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A test whose files are found.

    Attributes
    ----------
    name
        What the test is called.
    definition
        What it is.
    runs
        Its runs with their files.
    """

    name: str
    definition: Definition
    runs: tuple[Run, ...]


def prepared(test: str | Path, *, dynamics: str | Path | None = None, balance: str | Path | None = None) -> Prepared:
    """Find the runs of a test file, or of a folder of recordings.

    Parameters
    ----------
    test
        The test file (TOML), or a folder.
    dynamics
        dynamics.json of runs for which a test file names none; needed with a folder.
    balance
        balance.json of a folder of gauge outputs.

    Raises
    ------
    ReadError
        The test file, a table or a file that all runs need cannot be used.
    ValueError
        A folder is given without dynamics.
    """
    place = str(test)
    if place.lower().endswith(".toml"):
        own = None if dynamics is None else _whole(dynamics)
        if balance is not None:
            raise ValueError("a balance goes with a folder; a test file names it under [[setups]]")
        with fetched(place) as path:
            definition = load_definition(path, dynamics=own)
        folder = folder_of(place)
        name = definition.name or Path(name_of(place)).stem
    else:
        if not is_address(place) and not Path(place).is_dir():
            raise ReadError(place, "", "is neither a folder of recordings nor a test file (.toml)")
        if dynamics is None:
            raise ValueError(f"{place} is a folder: give {argument('dynamics')} of its recordings too")
        definition = definition_of_folder(
            place, _whole(dynamics), balance=None if balance is None else _whole(balance)
        )
        folder, name = place, name_of(place) or place
    runs = assigned(definition, folder)
    for one in dict.fromkeys(
        path for run in runs for path in (run.dynamics, run.balance, run.channel_map, run.noise_record) if path
    ):
        if not exists(one):
            raise ReadError(one, "", "there is no such file")
    return Prepared(name, definition, runs)


def _whole(place: str | Path) -> str:
    """A place that holds from anywhere."""
    text = str(place)
    return text if is_address(text) else str(Path(text).resolve())


def reduce_runs(
    test: str | Path,
    out: str | Path | Results,
    *,
    dynamics: str | Path | None = None,
    balance: str | Path | None = None,
    engine: Engine | None = None,
    report: Report | None = None,
    page: Callable[[Campaign], None] | None = None,
    replace: bool = False,
    ready: Callable[[Run], bool] = lambda run: True,
) -> Campaign:
    """Reduce all runs of a test to loads and forces [N, N*m], coefficients [1] and what sums them up.

    A run whose files, settings and program are those of an earlier call is not worked out again. A run that cannot be
    reduced is set aside with its reason.

    Parameters
    ----------
    test, dynamics, balance
        As in `prepared`.
    out
        Folder of the results, or an address: ``summary.parquet`` with one row a run, ``histories.zarr`` with a group a
        run, ``campaign.json``. Results that the caller holds already, or else they are held for this call.
    engine
        Where the work is done; processes of this machine if left out.
    report
        Writes the page of a run; None for none.
    page
        Writes the page of all runs, where anything is otherwise than before; None for none.
    replace
        Whether the folder may hold other files already.
    ready
        Whether a run can be reduced already; the others are left out.

    Raises
    ------
    ReadError
        As `prepared`.
    FitError, ValueError
        As `Engine.rows`; or the folder cannot be written to, or another call works in it.
    """
    import_needed()
    begun = time()
    found = prepared(test, dynamics=dynamics, balance=balance)
    engine = Engine() if engine is None else engine
    if isinstance(out, Results):
        return _reduced(found, out, engine, report=report, page=page, ready=ready, begun=begun)
    results = results_at(out)
    with results.held(replace=replace):
        return _reduced(found, results, engine, report=report, page=page, ready=ready, begun=begun)


def results_at(out: str | Path) -> Results:
    """Return the folder of results at a path or an address."""
    return Results(_whole(out))


def _reduced(
    found: Prepared,
    results: Results,
    engine: Engine,
    *,
    report: Report | None,
    page: Callable[[Campaign], None] | None,
    ready: Callable[[Run], bool],
    begun: float,
) -> Campaign:
    """Reduce what is not done, and write what all runs are together."""
    names = [run.name for run in found.runs]
    found = replaced(found, runs=tuple(run for run in found.runs if ready(run)))
    works, rows = planned(found, results.out, with_reports=report is not None)
    todo = []
    found_there = each_of(lambda work: results.known(work.run.name, work.key), works, of_store=is_address(results.out))
    for work, known in zip(works, found_there, strict=True):
        if known is None:
            todo.append(work)
        else:
            rows[work.run.name] = known
    coming = engine.rows(todo, report)
    for _, (work, row) in zip(PROGRESS.each(todo, "run"), coming, strict=True):  # which lets the engine end its own
        rows[work.run.name] = row
        OUTPUTS.note(Path(results.place("runs", f"{work.run.name}.json")), replaced=False)
    ordered = [{**rows[run.name], **head_of(run)} for run in found.runs]  # its place may have changed
    results.keep_only(names)
    campaign = Campaign(
        found.name,
        results.out,
        ordered,
        quality_of(ordered, found.definition.repeats),
        tuple(work.run.name for work in todo),
        found.definition,
        time() - begun,
    )
    text = json_text(manifest(campaign))
    if todo or text != results.manifest or not exists(results.place(SUMMARY)):
        write_summary(campaign, results)
        results.write_text(text, MANIFEST)
    elif page is None or exists(results.place(PAGE)):
        return campaign
    if page is not None:
        page(campaign)
    return campaign


def planned(found: Prepared, out: str, *, with_reports: bool) -> tuple[list[RunWork], dict[str, Row]]:
    """Return what is to be done for each run, and rows of those of which a file is missing."""
    inputs = list(dict.fromkeys(place for run in found.runs for place in run.inputs))
    of_store = any(is_address(place) for place in inputs)
    prints = dict(zip(inputs, each_of(_print_or_reason, inputs, of_store=of_store), strict=True))
    works: list[RunWork] = []
    rows: dict[str, Row] = {}
    wanted = found.definition.output
    for run in found.runs:
        missing = [reason for place in run.inputs if isinstance(reason := prints[place], ReadError)]
        if missing:
            rows[run.name] = set_aside(run, str(missing[0]))
            continue
        works.append(
            RunWork(
                run=run,
                settings=RunSettings.of(found.definition, run.axes),
                out=out,
                fingerprints={place: str(prints[place]) for place in run.inputs},
                histories=wanted.histories,
                reports=wanted.reports if with_reports else "none",
            )
        )
    return works, rows


def _print_or_reason(place: str) -> str | ReadError:
    """What changes when a file changes, or why it cannot be had."""
    try:
        return fingerprint(place)
    except ReadError as problem:
        return problem


def write_summary(campaign: Campaign, results: Results) -> None:
    """Write what the runs are together: one row a run, their repeats, and what is said of them."""
    results.write_table(campaign.rows, SUMMARY)
    repeats = [
        {
            "quantity": one.quantity,
            **one.condition,
            "runs": list(one.runs),
            "mean": one.scatter.mean,
            "deviation": one.scatter.deviation,
            "expected": one.scatter.expected,
            "chi_square": one.scatter.chi_square,
            "degrees_of_freedom": one.scatter.freedom,
        }
        for one in campaign.quality.repeats
    ]
    results.write_table(repeats, "repeats.parquet")


def manifest(campaign: Campaign) -> Mapping[str, Any]:
    """Return what a program needs to know of a campaign, as plain data."""
    return {
        "kind": KIND,
        "finished": True,
        "schema": 1,
        "program": f"aerobalance {VERSION}",
        "name": campaign.name,
        "notes": campaign.definition.notes,
        "runs": len(campaign.rows),
        "names": [row["run_name"] for row in campaign.rows],
        "reduced": len(campaign.reduced),
        "set_aside": campaign.aside,
        "flags": [asdict(flag) for flag in campaign.quality.flags],
        "repeats": {name: asdict(one) for name, one in campaign.quality.pooled.items()},
        "settings": campaign.definition.model_dump(mode="json", by_alias=True, exclude_unset=True),
    }
