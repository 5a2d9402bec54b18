"""The command campaign, and watch: many runs of a test, one row each, and a page of what they show together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

from aerobalance.app.campaign.assignment import Run
from aerobalance.app.campaign.campaign import Campaign, Prepared, prepared, reduce_runs, results_at
from aerobalance.app.campaign.engine import Engine
from aerobalance.app.campaign.places import is_address, name_of
from aerobalance.app.campaign.reduction import ReducedRun
from aerobalance.app.campaign.results import HISTORIES, PAGE, SUMMARY, Results
from aerobalance.app.campaign.watching import EVERY, FileWatch
from aerobalance.app.campaign.work import RunWork
from aerobalance.app.commands.answers import short
from aerobalance.app.commands.doubts import doubt_result
from aerobalance.app.commands.force import force_result
from aerobalance.app.commands.shared import Result, collected_warnings, table_text
from aerobalance.app.commands.uncertainty import Origins
from aerobalance.app.options import as_options
from aerobalance.app.reports.force_curves import ForceCurves
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.error_sources import undivided
from aerobalance.estimation.force_collector import SummaryOfParts
from aerobalance.estimation.force_parts import ForcePart
from aerobalance.estimation.result import ForceSummary
from aerobalance.io.safe_write import OUTPUTS
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.parts import parts_of

MOST_SAID: Final = 12
"""Flags that are told on standard error; the page has all."""


def campaign(
    test: str,
    out: str,
    *,
    dynamics: str | None = None,
    balance: str | None = None,
    engine: Engine | None = None,
    replace: bool = False,
) -> Result:
    """Reduce all runs of a test that are not done yet, and write what they show."""
    there = Path(out).exists()
    with collected_warnings() as collected:
        found = reduce_runs(
            test,
            out,
            dynamics=dynamics,
            balance=balance,
            engine=engine,
            report=write_run_report,
            page=write_page_of,
            replace=replace,
        )
        flags = found.quality.flags
        for flag in flags[:MOST_SAID]:
            warn_quality(f"{flag.kind}: {flag.text}")
        if len(flags) > MOST_SAID:
            warn_quality(f"and {len(flags) - MOST_SAID} more, in {PAGE}")
    _note_folder(out, replaced=there)
    return account(found, collected)


def _note_folder(out: str, *, replaced: bool) -> None:
    """Let the answer name the folder, and not each of its files."""
    OUTPUTS.written.clear()
    OUTPUTS.replaced.clear()
    if not is_address(out):
        OUTPUTS.note(Path(out), replaced=replaced)


def account(found: Campaign, collected: Sequence[str]) -> Result:
    """Plain data on a campaign."""
    flags = found.quality.flags
    result: Result = {
        "test": found.name,
        "out": found.out,
        "runs": len(found.rows),
        "reduced": len(found.reduced),
        "worked_out_now": len(found.done),
        "set_aside": found.aside,
        "verdicts": _counts([str(row["verdict"]) for row in found.reduced]),
        "repeats": {
            name: {"chi_square_per_degree_of_freedom": one.chi_square, "degrees_of_freedom": one.freedom}
            for name, one in found.quality.pooled.items()
        },
        "flags": [asdict(flag) for flag in flags],
        "summary_table": SUMMARY,
        "histories": HISTORIES,
        "page": PAGE,
        "warnings": list(collected),
    }
    return {**result, "summary": summary(result)}


@one_blas_thread()
def run_campaign(
    test: str | Path,
    out: str | Path,
    *,
    dynamics: str | Path | None = None,
    balance: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    replace: bool = False,
) -> Campaign:
    """All runs of a test reduced to loads and forces [N, N*m], coefficients [1] and one row each, with pages.

    A run whose files, settings and program are those of an earlier call is not worked out again; one that cannot be
    reduced is set aside with its reason.

    Parameters
    ----------
    test
        A test file (TOML), or a folder of recordings, for which `dynamics` is needed; paths or addresses.
    out
        Folder of the results: ``summary.parquet``, ``summary.html``, ``histories.zarr``, ``reports``.
    dynamics
        dynamics.json of runs for which a test file names none.
    balance
        balance.json of a folder of gauge outputs.
    scheduler
        Address of a Dask scheduler; processes of this machine if left out.
    workers
        How many of these; 0 for this process alone, None for one per processor where there are more than eight runs.
    replace
        Whether the folder may hold other files already.

    Raises
    ------
    ReadError
        The test file, a table or a file that all runs need cannot be used.
    FitError
        The scheduler is gone for longer than it is waited for.
    ValueError
        A call is wrong, a library is not installed, no scheduler answers, or the results cannot be written.
    """
    return reduce_runs(
        test,
        out,
        dynamics=dynamics,
        balance=balance,
        engine=Engine(scheduler=scheduler, workers=workers),
        report=write_run_report,
        page=write_page_of,
        replace=replace,
    )


def watch(
    test: str,
    out: str,
    *,
    dynamics: str | None = None,
    balance: str | None = None,
    workers: int = 0,
    every: float = EVERY,
    seconds: float | None = None,
    say: Callable[[str], None],
    heard: Callable[[Campaign], None] | None = None,
    check: Callable[[Prepared], None] = lambda found: None,
) -> Result:
    """Reduce the runs of a test as their files come in, for so long [s] or until interrupted.

    What has come of it is told in words. Who hears of it as a whole shows its page anew; else that loads itself again.
    What is found is checked before it is read.
    """
    results = results_at(out)
    shown = False

    def show(found: Campaign) -> None:
        nonlocal shown
        write_page_of(found, refresh=max(1, round(every)) if heard is None else 0)
        shown = True

    def reduce(ready: Callable[[Run], bool]) -> Campaign:
        found = reduce_runs(
            test,
            results,
            dynamics=dynamics,
            balance=balance,
            engine=Engine(workers=workers),
            report=write_run_report,
            page=show,
            ready=ready,
        )
        if not shown:  # that of an earlier call does not load itself again
            show(found)
        if heard is not None:
            heard(found)
        return found

    def prepare() -> Prepared:
        found = prepared(test, dynamics=dynamics, balance=balance)
        check(found)
        return found

    with results.held():
        found = FileWatch(prepare, reduce, say, every, results.recorded()).go(seconds)
        if found is None:
            return {"test": test, "out": out, "runs": 0, "summary": f"no run came into {test}\n"}
        write_page_of(found)
    _note_folder(out, replaced=False)
    return account(found, [])


def _counts(words: list[str]) -> dict[str, int]:
    return {word: words.count(word) for word in dict.fromkeys(words)}


def summary(result: Result) -> str:
    """Short answer for people: how many runs, what is to be said of them, and whether repeats scatter as stated."""
    done = result["worked_out_now"]
    lines = [
        f"{result['test']}: {result['reduced']} of {result['runs']} runs reduced"
        + (f", {done} of them now" if done != result["runs"] else "")
    ]
    lines += [f"{count} {word}" for word, count in result["verdicts"].items()]
    if result["set_aside"]:
        lines.append(f"set aside: {', '.join(result['set_aside'])}")
    if result["repeats"]:
        rows = [
            (name, short(one["chi_square_per_degree_of_freedom"], 3), f"{one['degrees_of_freedom']:.3g}")
            for name, one in result["repeats"].items()
        ]
        heads = ("", "chi-square per degree of freedom", "degrees of freedom")
        lines.append(table_text("repeat runs against their stated uncertainty", heads, rows))
    lines.append(f"{result['page']}, {result['summary_table']} and {result['histories']} are in the folder")
    return "\n".join(lines) + "\n"


def write_page_of(found: Campaign, *, refresh: int = 0) -> None:
    """Write the page of a campaign into its folder."""
    from aerobalance.app.reports.campaign_report import write_campaign_report  # noqa: PLC0415 - plotting is slow

    with Results(found.out).writing(PAGE) as beside:
        write_campaign_report(beside, found, refresh=refresh)


def write_run_report(path: Path, work: RunWork, found: ReducedRun, said: list[str]) -> None:
    """Write the page of a run, as the command force does."""
    from aerobalance.app.reports.force_report import write_force_report  # noqa: PLC0415 - plotting is slow

    force, run = found.force, work.run
    parts = parts_of_whole(force)
    summaries, curves = _summed_up(parts, force)
    origins = Origins(force.recording, Path(name_of(run.dynamics or "")), Path(name_of(run.balance or "")))
    result: Result = {
        "verdict": str(force.verdict),
        "doubts": [doubt_result(doubt) for doubt in force.doubts],
        "assumed": [asdict(assumed) for assumed in force.assumed],
        "components": {name: force_result(summaries[name], origins) for name in summaries},
        "warnings": [as_options(text) for text in said],
    }
    inputs = [Path(place) for place in run.inputs if not is_address(place)]
    write_force_report(
        path, result, summaries, curves, recording=force.recording, dynamics=force.dynamics, inputs=inputs
    )


def parts_of_whole(force: Force) -> ForcePart:
    """All samples of a force as the one part of its record."""
    first = next(iter(force.values()))
    samples = first.values.size
    (part,) = parts_of(samples, length=samples, margin=0)
    whole = {name: one for name, one in force.items() if one.summary is None}
    return ForcePart(
        part=part,
        first=0,
        values={name: one.values for name, one in force.items()},
        uncertainty={name: one.uncertainty for name, one in force.items()},
        contributions={name: tuple(undivided(one.contributions)) for name, one in whole.items()},
        steps={name: one.steps for name, one in force.items()},
        force=force,
        doubts=force.doubts,
    )


def _summed_up(part: ForcePart, force: Force) -> tuple[dict[str, ForceSummary], dict[str, ForceCurves]]:
    """What sums up the forces of a run, and what their figures show."""
    summaries, curves = {}, {}
    for name, one in force.items():
        curves[name] = ForceCurves(one.values.size, force.recording.start)
        curves[name].add(part, name)
        if one.summary is not None:
            summaries[name] = one.summary
            continue
        sums = SummaryOfParts(name, one.values.size)
        sums.add(part)
        summaries[name] = sums.summary
    return summaries, curves
