"""Reduction of all runs of a test; a later call reduces only the runs that are new or have changed."""

from __future__ import annotations

import hashlib
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
from aerobalance.app.campaign.quality import CampaignQuality, quality_of
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
        Name of the test.
    out
        Folder of the results, or its address.
    rows
        One row per run, in the order of the test.
    quality
        Scatter of the repeats, and flags on runs that drift, change or lie apart.
    done
        Names of the runs that this call reduced; the results of the others were there already.
    definition
        Definition of the test.
    seconds
        How long this call took [s].
    """

    name: str
    out: str
    rows: Sequence[Row]
    quality: CampaignQuality
    done: tuple[str, ...]
    definition: Definition
    seconds: float = 0.0

    @property
    def reduced(self) -> list[Row]:
        """Rows of the runs that could be reduced, by this call or an earlier one."""
        return [row for row in self.rows if row["status"] == REDUCED]

    @property
    def aside(self) -> dict[str, str]:
        """Runs that were set aside, each with its reason."""
        return {row["run_name"]: row["reason"] for row in self.rows if row["status"] == ASIDE}

    @property
    def table(self) -> pd.DataFrame:
        """One row per run, as in ``summary.parquet``."""
        import pandas as pd  # noqa: PLC0415 - takes a third of a second

        return pd.DataFrame(list(self.rows)).set_index("run_name")

    def history(self, run: str) -> xr.Dataset:
        """Loads and forces of a run over time, with their standard uncertainties [N, N*m]."""
        import xarray as xr  # noqa: PLC0415 - of an extra

        data: xr.Dataset = xr.open_zarr(Results(self.out).place(HISTORIES), group=run, consolidated=False)
        return data


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A test that is ready to be reduced: its runs are listed, each with its files.

    Attributes
    ----------
    name
        Name of the test.
    definition
        Definition of the test.
    runs
        Its runs with their files.
    """

    name: str
    definition: Definition
    runs: tuple[Run, ...]


def prepared(test: str | Path, *, dynamics: str | Path | None = None, balance: str | Path | None = None) -> Prepared:
    """Return the runs of a test file, or of a folder of recordings, each with its files.

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
        A folder is given without dynamics, or a test file with a balance.
    """
    place = str(test)
    if place.lower().endswith(".toml"):
        own = None if dynamics is None else _absolute(dynamics)
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
            place, _absolute(dynamics), balance=None if balance is None else _absolute(balance)
        )
        folder, name = place, name_of(place) or place
    runs = assigned(definition, folder)
    for one in dict.fromkeys(
        path for run in runs for path in (run.dynamics, run.balance, run.channel_map, run.noise_record) if path
    ):
        if not exists(one):
            raise ReadError(one, "", "there is no such file")
    return Prepared(name, definition, runs)


def _absolute(place: str | Path) -> str:
    """Return an absolute path, for workers in other folders; an address as it is."""
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
    """Return the results of all runs of a test, loads and forces [N, N*m] and coefficients [1], and write them.

    A run whose files, settings and program version are those of an earlier call is not reduced again. A run that
    cannot be reduced is set aside with its reason.

    Parameters
    ----------
    test, dynamics, balance
        As in `prepared`.
    out
        Folder of the results, or its address: ``summary.parquet`` with one row per run, ``histories.zarr`` with one
        group per run, ``campaign.json``. It is locked during this call; `Results` are taken as locked by the caller.
    engine
        Where the work is done; processes of this machine if left out.
    report
        Writes the page of a run; None for none.
    page
        Writes the page of all runs, where anything has changed or the page is missing; None for none.
    replace
        Whether the folder may hold other files already.
    ready
        Whether the files of a run are complete; a run that is not ready has no row.

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
    return Results(_absolute(out))


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
    """Return the results of all runs that are ready, and write them where they differ from what is there."""
    names = [run.name for run in found.runs]
    found = replaced(found, runs=tuple(run for run in found.runs if ready(run)))
    rows, done = _rows_of(found, results, engine, report)
    results.keep_only(names)
    campaign = Campaign(
        found.name,
        results.out,
        rows,
        quality_of(rows, found.definition.repeats),
        done,
        found.definition,
        time() - begun,
    )
    text = json_text(manifest(campaign))
    changed = bool(done) or text != results.manifest or not exists(results.place(SUMMARY))
    if changed:
        write_summary(campaign, results)
    if page is not None and (changed or not exists(results.place(PAGE))):
        page(campaign)
    if changed:  # last, as it tells which rows tables and page are of
        results.write_text(text, MANIFEST)
    return campaign


def _rows_of(
    found: Prepared, results: Results, engine: Engine, report: Report | None
) -> tuple[list[Row], tuple[str, ...]]:
    """Return one row per run, in the order of the test, and the names of the runs that had to be reduced for it."""
    works, rows = planned(found, results.out, with_reports=report is not None)
    stored = each_of(lambda work: results.known(work.run.name, work.key), works, of_store=is_address(results.out))
    rows |= {work.run.name: row for work, row in zip(works, stored, strict=True) if row is not None}
    todo = [work for work, row in zip(works, stored, strict=True) if row is None]
    # Strict, so that the engine's generator runs to its end, where it stops its workers.
    for _, (work, row) in zip(PROGRESS.each(todo, "run"), engine.rows(todo, report), strict=True):
        rows[work.run.name] = row
        OUTPUTS.note(Path(results.place("runs", f"{work.run.name}.json")), replaced=False)
    # A stored row may hold an earlier number of the run in the test.
    ordered = [{**rows[run.name], **head_of(run)} for run in found.runs]
    return ordered, tuple(work.run.name for work in todo)


def planned(found: Prepared, out: str, *, with_reports: bool) -> tuple[list[RunWork], dict[str, Row]]:
    """Return the work on each run, done already or not, and the rows of runs that are set aside for a missing file."""
    inputs = list(dict.fromkeys(place for run in found.runs for place in run.inputs))
    of_store = any(is_address(place) for place in inputs)
    fingerprints = dict(zip(inputs, each_of(_fingerprint_or_error, inputs, of_store=of_store), strict=True))
    works: list[RunWork] = []
    rows: dict[str, Row] = {}
    wanted = found.definition.output
    for run in found.runs:
        missing = [reason for place in run.inputs if isinstance(reason := fingerprints[place], ReadError)]
        if missing:
            rows[run.name] = set_aside(run, str(missing[0]))
            continue
        works.append(
            RunWork(
                run=run,
                settings=RunSettings.of(found.definition, run.axes),
                out=out,
                fingerprints={place: str(fingerprints[place]) for place in run.inputs},
                histories=wanted.histories,
                reports=wanted.reports if with_reports else "none",
            )
        )
    return works, rows


def _fingerprint_or_error(place: str) -> str | ReadError:
    """Return the fingerprint of a file, or why it cannot be read, so that one such file costs one run only."""
    try:
        return fingerprint(place)
    except ReadError as problem:
        return problem


def write_summary(campaign: Campaign, results: Results) -> None:
    """Write the tables of all runs: one row per run, and one row per group of repeats."""
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
    """Return the content of ``campaign.json``: what was reduced, with which settings, and what is flagged."""
    return {
        "kind": KIND,
        "finished": True,
        "schema": 1,
        "program": f"aerobalance {VERSION}",
        "name": campaign.name,
        "notes": campaign.definition.notes,
        "runs": len(campaign.rows),
        "names": [row["run_name"] for row in campaign.rows],
        "rows_sha256": hashlib.sha256(json_text({"rows": campaign.rows}).encode()).hexdigest(),
        "reduced": len(campaign.reduced),
        "set_aside": campaign.aside,
        "flags": [asdict(flag) for flag in campaign.quality.flags],
        "repeats": {name: asdict(one) for name, one in campaign.quality.pooled.items()},
        "settings": campaign.definition.model_dump(mode="json", by_alias=True, exclude_unset=True),
    }
