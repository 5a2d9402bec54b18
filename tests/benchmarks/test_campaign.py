"""Campaigns: two processes over one, a second call over the first."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from aerobalance.app.campaign.campaign import planned, prepared, reduce_runs
from aerobalance.app.campaign.engine import Engine
from aerobalance.app.campaign.results import Results
from helpers.axial_runs import axial_folder

pytestmark = [pytest.mark.alone, pytest.mark.filterwarnings("ignore:.*depart from what the model:UserWarning")]
RUNS = 24


def at_work(folder: Path, dynamics: Path, out: Path, workers: int) -> float:
    """Time per run from the first that is done to the last [s]: what processes take to start is left out."""
    results = Results(str(out))
    with results.held():
        works, _ = planned(prepared(folder, dynamics=dynamics), results.out, with_reports=False)
        ends = [time.monotonic() for _ in Engine(workers=workers).rows(works)]
    return (ends[-1] - ends[workers - 1]) / (len(ends) - workers)


def test_two_workers_and_a_second_call(tmp_path, record, rng) -> None:
    folder, dynamics = axial_folder(tmp_path, rng, count=RUNS, samples=16_000)
    one, two = (at_work(folder, dynamics, tmp_path / f"out_{n}", n) for n in (1, 2))
    record("runs per second by two workers over those by one", one / two, 1.8)
    begin = time.process_time()
    reduce_runs(folder, tmp_path / "out", dynamics=dynamics, engine=Engine(workers=0))
    first = time.process_time() - begin
    begin = time.process_time()
    again = reduce_runs(folder, tmp_path / "out", dynamics=dynamics, engine=Engine(workers=0))
    second = time.process_time() - begin
    assert again.done == ()
    record("a twentieth of the first call over the second, which does no work", first / 20 / second, 1.0)
    assert second < first / 20
