"""A campaign from its files to its results: only what is not done is done, and what is lost is done again."""

from __future__ import annotations

import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import fsspec
import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
import xarray as xr

import aerobalance as ab
from aerobalance.acquisition.processes import start_worker
from aerobalance.app.campaign import campaign as campaigns
from aerobalance.app.campaign import engine as engines
from aerobalance.app.campaign import work
from aerobalance.app.campaign.assignment import Run
from aerobalance.app.campaign.campaign import Campaign, Prepared, planned, prepared, reduce_runs
from aerobalance.app.campaign.definition import definition_from
from aerobalance.app.campaign.engine import Engine, _has_dashboard
from aerobalance.app.campaign.places import fingerprint
from aerobalance.app.campaign.reduction import RunSettings
from aerobalance.app.campaign.results import Results
from aerobalance.app.campaign.watching import FileWatch
from aerobalance.app.cli.program import main
from aerobalance.app.commands.campaign import watch
from aerobalance.estimation.force import estimate_force
from aerobalance.io import read, write_recording
from aerobalance.recording.errors import FitError, ReadError
from helpers.axial_runs import axial_folder, run_of, spring
from helpers.killed_worker import AT_WORK, ENDED, Held, Pages
from seeds import new_seed, running

# of a white load, which some records doubt
pytestmark = pytest.mark.filterwarnings("ignore:.*depart from what the model:UserWarning")
HERE = Engine(workers=0)
TEST = '[runs]\nfiles = "runs/*.h5"\n[[setups]]\ndynamics = "dynamics.json"\n[output]\nreports = "none"\n'


class Files(NamedTuple):
    """Three runs and what belongs to them, and their results."""

    runs: Path
    dynamics: Path
    test: Path
    out: Path

    @classmethod
    def below(cls, folder: Path) -> Files:
        return cls(folder / "runs", folder / "dynamics.json", folder / "test.toml", folder / "out")

    def again(self, **more: object) -> Campaign:
        return reduce_runs(self.runs, self.out, dynamics=self.dynamics, engine=HERE, **more)


@pytest.fixture(scope="module")
def once(tmp_path_factory) -> Path:
    """A campaign that is done, worked out once for all tests."""
    folder = tmp_path_factory.mktemp("campaign") / "once"
    with running("a campaign that is done"):
        axial_folder(folder, np.random.default_rng(new_seed()), count=3)
    Files.below(folder).test.write_text(TEST)
    Files.below(folder).again()
    return folder


@pytest.fixture(scope="module")
def paged(tmp_path_factory) -> Path:
    """Four runs, and below `serial` what one process makes of them, with pages; nobody writes to it."""
    folder = tmp_path_factory.mktemp("paged")
    runs, dynamics = axial_folder(folder, np.random.default_rng(new_seed()), count=4)
    reduce_runs(runs, folder / "serial", dynamics=dynamics, engine=HERE, report=Pages(folder / "serial.log"))
    return folder


@pytest.fixture
def files(once, tmp_path) -> Files:
    """A copy of it."""
    shutil.copytree(once, tmp_path / "copy")
    return Files.below(tmp_path / "copy")


def records(out: Path) -> dict[str, float]:
    """When the record of each run was written."""
    return {path.stem: path.stat().st_mtime_ns for path in (out / "runs").glob("*.json")}


def test_a_folder_becomes_a_table_and_histories_that_other_programs_read(files):
    (files.runs / "broken.h5").write_bytes(b"\x89HDF\r\n\x1a\nnothing more")
    (files.runs / "notes.txt").write_text("not a table at all\n")
    found = files.again()
    table = pq.read_table(files.out / "summary.parquet").to_pandas().set_index("run_name")
    assert list(table.index) == ["broken", "notes", "run_1", "run_2", "run_3"]
    assert list(table["status"]) == ["set aside"] * 2 + ["reduced"] * 3
    assert list(table["place"]) == [1, 2, 3, 4, 5]
    assert "damaged HDF5" in table["reason"]["broken"]
    assert set(found.aside) == {"broken", "notes"}
    direct = estimate_force(read(files.runs / "run_2.h5"), spring())
    assert table["balance_AF_N"]["run_2"] == pytest.approx(float(direct["AF"].values.mean()), rel=1e-12)
    data = xr.open_zarr(files.out / "histories.zarr", group="run_2", consolidated=False)
    np.testing.assert_array_equal(data["AF"].to_numpy(), direct["AF"].values)
    np.testing.assert_array_equal(data["u_AF"].to_numpy(), direct["AF"].uncertainty)
    np.testing.assert_array_equal(data["load_AF"].to_numpy(), read(files.runs / "run_2.h5").channel("AF").values)
    assert data["AF"].attrs["units"] == "N"
    with xr.open_datatree(files.out / "histories.zarr", engine="zarr", consolidated=False) as tree:
        assert sorted(tree) == ["run_1", "run_2", "run_3"]
    assert found.quality.repeats == ()  # nothing says that runs are at one angle
    assert found.table.loc["run_2", "balance_AF_N"] == table["balance_AF_N"]["run_2"]


def test_what_is_done_is_not_done_again_and_what_changed_is(files, rng):
    first = files.again()  # of the copy, whose files have other names
    table, before = (files.out / "summary.parquet").read_bytes(), records(files.out)
    again = files.again()
    assert again.rows == first.rows
    assert again.done == ()
    assert [row["run_name"] for row in again.reduced] == ["run_1", "run_2", "run_3"]
    assert (files.out / "summary.parquet").read_bytes() == table
    assert records(files.out) == before
    write_recording(files.runs / "run_2.h5", run_of(rng, mean=50.0))
    (files.runs / "run_3.h5").rename(files.runs / "run_4.h5")
    shutil.rmtree(files.out / "histories.zarr" / "run_1")
    changed = files.again()
    assert changed.done == ("run_1", "run_2", "run_4")  # lost, changed and new
    assert sorted(records(files.out)) == ["run_1", "run_2", "run_4"]
    histories = (files.out / "histories.zarr").iterdir()
    assert sorted(one.name for one in histories if one.is_dir()) == ["run_1", "run_2", "run_4"]


def test_a_run_keeps_no_history_and_no_page_that_are_not_of_its_row(files):
    def write(path: Path, *given: object) -> None:
        path.write_text("a page")

    def there() -> list[str]:
        places = [*(files.out / "histories.zarr").glob("run_*"), *(files.out / "reports").glob("run_*.html")]
        return sorted(one.name for one in places)

    for name in ("run_2.h5", "run_3.h5"):
        (files.runs / name).unlink()
    files.test.write_text(TEST.partition("[output]")[0])
    reduce_runs(files.test, files.out, engine=HERE, report=write)
    assert there() == ["run_1", "run_1.html"]
    files.test.write_text(TEST + "histories = false\n")
    reduce_runs(files.test, files.out, engine=HERE, report=write)
    assert there() == []
    files.again()
    assert there() == ["run_1"]
    (files.runs / "run_1.h5").write_bytes(b"\x89HDF\r\n\x1a\nnothing more")
    assert set(files.again().aside) == {"run_1"}
    assert there() == []


@pytest.mark.parametrize("while_writing", ["summary", "page"])
def test_tables_and_page_are_those_of_the_rows_after_a_call_that_was_killed(files, rng, monkeypatch, while_writing):
    def pages(found: Campaign) -> None:
        (files.out / "summary.html").write_text(f"{found.table['balance_AF_N']['run_2']}")

    def killed(*given: object) -> None:
        raise KeyboardInterrupt

    files.again(page=pages)
    write_recording(files.runs / "run_2.h5", run_of(rng, mean=50.0))
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        if while_writing == "summary":
            patch.setattr(campaigns, "write_summary", killed)
        files.again(page=killed)
    found = files.again(page=pages)
    assert found.done == ()
    mean = found.table["balance_AF_N"]["run_2"]
    assert mean == pytest.approx(50.0, abs=10.0)  # 20 N of 800 samples are 0.7 N in the mean
    assert pq.read_table(files.out / "summary.parquet")["balance_AF_N"].to_pylist()[1] == mean
    assert float((files.out / "summary.html").read_text()) == mean


def test_another_version_or_setting_is_worked_out_anew(files, monkeypatch):
    for name in ("run_2.h5", "run_3.h5"):
        (files.runs / name).unlink()

    def done(text: str) -> tuple[str, ...]:
        files.test.write_text(text)
        return reduce_runs(files.test, files.out, engine=HERE).done

    assert done(TEST) == ()  # the same, said by a test file
    assert done('notes = "x"\n' + TEST) == ()  # words change nothing
    assert done(TEST + "[force]\nbandwidth = 30.0\n") == ("run_1",)
    monkeypatch.setattr(work, "SCHEMA", work.SCHEMA + 1)
    assert done(TEST + "[force]\nbandwidth = 30.0\n") == ("run_1",)


def test_inputs_come_from_a_store_and_results_go_to_one(files, tmp_path):
    (files.runs / "run_3.h5").unlink()
    here = files.again()
    store = fsspec.filesystem("memory")
    for path in sorted(files.runs.iterdir()):
        store.pipe_file(f"/lab/runs/{path.name}", path.read_bytes())
    store.pipe_file("/lab/dynamics.json", files.dynamics.read_bytes())
    store.pipe_file("/lab/test.toml", TEST.encode())
    there = reduce_runs("memory://lab/test.toml", "memory://results", engine=HERE)
    differ = {"file", "dynamics_file"}
    for one, other in zip(here.rows, there.rows, strict=True):
        assert {k: v for k, v in one.items() if k not in differ} == {k: v for k, v in other.items() if k not in differ}
    assert reduce_runs("memory://lab/test.toml", "memory://results", engine=HERE).done == ()
    with store.open("/results/summary.parquet", "rb") as file:
        assert pq.read_table(file).num_rows == 2
    data = xr.open_zarr("memory://results/histories.zarr", group="run_1", consolidated=False)
    assert data["AF"].shape == (800,)
    assert reduce_runs(f"file://{files.runs}", files.out, dynamics=files.dynamics, engine=HERE).done == ()
    store.rm("/lab", recursive=True)
    store.rm("/results", recursive=True)


def test_the_library_of_a_store_is_named_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "adlfs", None)  # as if it were not installed
    with pytest.raises(ReadError, match=r"abfs://box/run\.h5: cannot be opened: .*: pip install adlfs$"):
        fingerprint("abfs://box/run.h5")


@pytest.mark.parametrize(
    ("before", "after", "same"),
    [
        ({"ETag": "a", "LastModified": 1}, {"ETag": "a", "LastModified": 2}, True),  # the same content, put anew
        ({"ETag": "a"}, {"ETag": "b"}, False),
        ({"Last-Modified": "Mon"}, {"Last-Modified": "Tue"}, False),
        ({}, {}, False),  # a store that says nothing: its file is read, and is another one
    ],
)
def test_a_file_of_a_store_is_told_by_what_the_store_says_of_it(monkeypatch, before, after, same):
    system = fsspec.filesystem("memory")
    found = []
    for about, content in ((before, b"1"), (after, b"2")):
        system.pipe_file("/told/run.h5", content)
        monkeypatch.setattr(type(system), "info", lambda self, path, about=about: {"size": 1, **about})
        found.append(fingerprint("memory://told/run.h5"))
    assert (found[0] == found[1]) is same
    monkeypatch.undo()
    system.rm("/told", recursive=True)


def test_wrong_calls_say_what_is_wrong(tmp_path, files, monkeypatch):
    runs, dynamics, out = files.runs, files.dynamics, tmp_path / "out"
    with pytest.raises(ValueError, match="is a folder: give `dynamics`"):
        reduce_runs(runs, out, engine=HERE)
    with pytest.raises(ReadError, match="neither a folder of recordings nor a test file"):
        reduce_runs(tmp_path / "none", out, engine=HERE)
    with pytest.raises(ReadError, match=r"none\.json: there is no such file"):
        reduce_runs(runs, out, dynamics=tmp_path / "none.json", engine=HERE)
    with pytest.raises(ReadError, match="cannot be opened: Protocol not known: nothing"):
        reduce_runs("nothing://runs/test.toml", out, engine=HERE)
    assert not out.exists()
    with pytest.raises(ValueError, match="exists and is no campaign's folder"):
        reduce_runs(runs, runs, dynamics=dynamics, engine=HERE)
    with pytest.raises(ValueError, match="is a file"):
        reduce_runs(runs, dynamics, dynamics=dynamics, engine=HERE)
    with pytest.raises(ValueError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        monkeypatch.setattr(engines, "ANSWER", 0.5)
        reduce_runs(runs, out, dynamics=dynamics, engine=Engine(scheduler="tcp://127.0.0.1:9"))
    monkeypatch.setattr(engines, "find_spec", lambda name: None)
    with pytest.raises(
        ValueError, match=r"distributed, which is not installed: pip install 'aerobalance\[campaign\]'"
    ):
        reduce_runs(runs, out, dynamics=dynamics, engine=Engine(workers=1))


def test_the_command_writes_pages_and_its_killed_call_is_gone_on_with(tmp_path, rng, capsys):
    runs, dynamics = axial_folder(tmp_path, rng, count=2)
    (runs / "run_0.h5").write_bytes(b"")
    out = tmp_path / "out"
    words = [str(word) for word in ("campaign", runs, "--dynamics", dynamics, "-o", out, "--workers", 0)]
    killed = start_worker(main, words)
    wait_for(out, 2, killed.is_alive)
    killed.kill()
    killed.join()
    before = records(out)
    assert list(before) == ["run_0", "run_1"] or list(before) == ["run_1", "run_0"]
    capsys.readouterr()
    assert main([*words, "--json"]) == 0
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert found["worked_out_now"] == 1
    assert {name: when for name, when in records(out).items() if name in before} == before  # nothing twice
    assert found["set_aside"] == {"run_0": "is empty; a header line and rows of numbers are needed"}
    assert "warning: set aside: run_0" in said.err
    assert not list(out.rglob("*.part"))
    page = (out / "summary.html").read_text(encoding="utf-8")
    assert "2 of 3 runs reduced" in page
    for number in (1, 2):
        assert f'href="reports/run_{number}.html"' in page
        assert "The force applied in run_" in (out / "reports" / f"run_{number}.html").read_text(encoding="utf-8")
    assert main(["campaign", str(runs), "-o", str(out)]) == 2
    said = capsys.readouterr()
    assert said.err.startswith("error: ")
    assert "--dynamics" in said.err


@contextmanager
def started(*words: str):
    """Run a command of Dask until the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        start_new_session=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


SCHEDULER = ("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--no-dashboard", "--no-show")
WORKER = ("distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard", "--death-timeout", "60")


@pytest.mark.soak(first=0)
def test_any_scheduler_does_the_same_and_may_lose_workers_and_be_started_anew(tmp_path, rng):
    runs, dynamics = axial_folder(tmp_path, rng, count=5, samples=1600)
    serial = reduce_runs(runs, tmp_path / "serial", dynamics=dynamics, engine=HERE)
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    words = ["campaign", runs, "--dynamics", dynamics, "-o", tmp_path / "out", "--scheduler", address, "--json"]
    with started(*SCHEDULER, "--port", str(port)) as scheduler, started(*WORKER, address) as worker:
        command = subprocess.Popen(
            [sys.executable, "-m", "aerobalance.app.cli", *map(str, words)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        wait_for(tmp_path / "out", 1, lambda: command.poll() is None)
        for child in psutil.Process(worker.pid).children(recursive=True):
            child.kill()  # the process that works; its nanny starts another
        wait_for(tmp_path / "out", 2, lambda: command.poll() is None)
        os.killpg(scheduler.pid, signal.SIGKILL)
        os.killpg(worker.pid, signal.SIGKILL)
        with started(*SCHEDULER, "--port", str(port)), started(*WORKER, address):
            out, err = command.communicate(timeout=120)
    assert command.returncode == 0, err
    assert json.loads(out)["reduced"] == 5, f"{out}\n{err}"
    assert f"the scheduler {address} is gone" in err
    assert "Traceback" not in err
    assert "dashboard" not in err  # there is none
    table = pq.read_table(tmp_path / "out" / "summary.parquet")
    without = [name for name in table.column_names if name != "report"]
    assert table.select(without).equals(pq.read_table(tmp_path / "serial" / "summary.parquet").select(without))
    assert len(serial.rows) == 5


def test_runs_join_the_results_as_they_come_in(files):
    shutil.rmtree(files.out)
    for name in ("run_2.h5", "run_3.h5"):
        (files.runs / name).rename(files.runs.parent / name)
    whole = (files.runs.parent / "run_2.h5").read_bytes()

    def come() -> None:
        wait_for(files.out, 1)
        (files.runs / "run_2.h5").write_bytes(whole[:4000])  # a recorder is not done yet
        time.sleep(1.0)
        (files.runs / "run_2.h5").write_bytes(whole)

    said: list[str] = []

    def say(text: str) -> None:
        said.append(text)
        if text.startswith("run_2: "):
            raise KeyboardInterrupt

    coming = threading.Thread(target=come)
    coming.start()
    with pytest.raises(KeyboardInterrupt):
        watch(str(files.test), str(files.out), every=0.2, seconds=120.0, say=say)
    coming.join()
    assert [text.partition(":")[0] for text in said] == ["run_1", "run_2"]
    assert not [text for text in said if "set aside" in text]
    page = (files.out / "summary.html").read_text(encoding="utf-8")
    assert "2 of 2 runs reduced" in page
    assert 'http-equiv="refresh"' in page
    found = watch(str(files.test), str(files.out), seconds=0.0, say=say)  # what is known is shown at once
    assert found["reduced"] == 2
    assert 'http-equiv="refresh"' not in (files.out / "summary.html").read_text(encoding="utf-8")


def test_a_file_that_is_replaced_in_a_store_is_seen_by_who_watches():
    store, looks = fsspec.filesystem("memory"), []
    test = Prepared(
        "test", definition_from({"runs": {"files": "x"}, "setups": [{}]}), (Run("a", 1, "memory://seen/a"),)
    )

    def reduced(ready):
        looks.append(ready(test.runs[0]))
        return SimpleNamespace(rows=[], done=())

    watching = FileWatch(lambda: test, reduced, print)
    for content in (b"1", b"1", b"2"):
        store.pipe_file("/seen/a", content)
        watching.look()
    assert looks == [True, True]  # the second is as the first
    store.rm("/seen", recursive=True)
    watching.look()
    assert len(looks) == 3  # a file that is gone is seen too


def test_who_watches_sees_what_is_corrected_in_test_file_and_table(files):
    files.test.write_text(TEST.replace('files = "runs/*.h5"', 'table = "runs.csv"'))
    table = files.test.parent / "runs.csv"
    looks = []

    def reduced(ready):
        looks.append([run.columns["alpha"] for run in prepared(files.test).runs if ready(run)])
        return SimpleNamespace(rows=[], done=())

    watching = FileWatch(lambda: prepared(files.test), reduced, print)
    for row in ("runs/run_1.h5,2", "runs/run_1.h5,2", "runs/run_1.h5,4"):
        table.write_text(f"file,alpha\n{row}\n")
        watching.look()
    assert len(looks) == 2  # the second is as the first
    files.test.write_text(files.test.read_text() + "[force]\nbandwidth = 30.0\n")
    watching.look()
    assert len(looks) == 3


def test_of_many_runs_the_first_are_shown_before_all_are_reduced():
    runs = tuple(Run(f"run_{number}", number, f"memory://many/{number}") for number in range(1, 21))
    test, shown = Prepared("test", definition_from({"runs": {"files": "x"}, "setups": [{}]}), runs), []

    def reduced(ready):
        rows = [{"run_name": run.name} for run in runs if ready(run)]
        shown.append(len(rows))
        return SimpleNamespace(rows=rows, done=())

    FileWatch(lambda: test, reduced, print).go(seconds=0)
    assert shown == [4, 12, 20]  # 4, 8 and the rest
    shown.clear()
    FileWatch(lambda: test, reduced, print, there={run.name for run in runs[:10]}).go(seconds=0)
    assert shown == [14, 20]


def wait_for(out: Path, count: int, alive: Callable[[], bool] = lambda: True) -> None:
    limit = time.monotonic() + 120
    while len(records(out)) < count:
        assert alive()
        assert time.monotonic() < limit
        time.sleep(0.02)


def free_port() -> int:
    import socket

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def same_results(out: Path, serial: Path) -> None:
    """Rows and histories of two folders are the same bit for bit."""
    assert pq.read_table(out / "summary.parquet").equals(pq.read_table(serial / "summary.parquet"))
    for name in records(serial):
        one, other = (xr.open_zarr(at / "histories.zarr", group=name, consolidated=False) for at in (out, serial))
        xr.testing.assert_identical(one, other)


def test_a_worker_killed_in_the_middle_costs_one_run_again(tmp_path, paged):
    runs, dynamics = paged / "runs", paged / "dynamics.json"
    log = tmp_path / "log"
    found = reduce_runs(
        runs, tmp_path / "out", dynamics=dynamics, engine=Engine(workers=1), report=Pages(log, fatal="run_2")
    )
    assert not found.aside
    same_results(tmp_path / "out", paged / "serial")
    assert sorted(log.read_text().split()) == ["run_1", "run_2", "run_2", "run_3", "run_4"]


def test_a_scheduler_that_ends_is_gone_on_with_by_the_next_call(tmp_path, paged, monkeypatch):
    """The scheduler ends while the second run is worked on; another one at its address is given the three others."""
    runs, dynamics = paged / "runs", paged / "dynamics.json"
    plain, held = Pages(tmp_path / "log"), Held(tmp_path / "log", records=tmp_path / "out" / "runs")
    port = free_port()
    AT_WORK.clear()
    ENDED.clear()
    monkeypatch.setattr(engines, "ANSWER", 1.0)

    @contextmanager
    def scheduler():
        import dask
        from distributed import LocalCluster

        with (
            dask.config.set({"distributed.comm.timeouts.connect": "1s"}),  # the client goes on trying as long
            LocalCluster(
                n_workers=1,
                threads_per_worker=1,
                processes=False,
                protocol="tcp://",
                host="127.0.0.1",
                scheduler_port=port,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            ) as cluster,
        ):
            yield cluster

    def ends(cluster) -> None:
        AT_WORK.wait(60)
        cluster.sync(cluster.scheduler.close)
        ENDED.set()

    engine = Engine(scheduler=f"tcp://127.0.0.1:{port}", patience=0.5)
    again = {"dynamics": dynamics, "engine": replace(engine, patience=30.0), "report": plain}
    with scheduler() as cluster:
        ending = threading.Thread(target=ends, args=(cluster,))
        ending.start()
        with pytest.raises(FitError, match="3 runs are not done"):
            reduce_runs(runs, tmp_path / "out", dynamics=dynamics, engine=engine, report=held)
        ending.join()
    (first,) = records(tmp_path / "out")
    with scheduler():
        found = reduce_runs(runs, tmp_path / "out", **again)
    assert set(found.done) == {"run_1", "run_2", "run_3", "run_4"} - {first}
    same_results(tmp_path / "out", paged / "serial")


@pytest.mark.long
def test_a_worker_that_is_killed_costs_its_task_only(tmp_path, rng):
    runs, dynamics = axial_folder(tmp_path, rng, count=6, samples=3200)
    killed: list[int] = []

    def kill_one() -> None:
        """Kill the process that works, which is a child of this one with threads of Dask."""
        for child in psutil.Process().children(recursive=True):
            with_spawn = any("spawn_main" in word for word in child.cmdline())
            if with_spawn and child.pid not in killed:
                killed.append(child.pid)
                child.kill()
                return

    engine = Engine(workers=2)
    out = tmp_path / "out"
    rows = {}
    with Results(str(out)).held():
        works, _ = planned(prepared(runs, dynamics=dynamics), str(out), with_reports=False)
        for task, row in engine.rows(works):
            rows[task.run.name] = row
            if len(rows) == 1:
                kill_one()
    assert killed
    assert {row["status"] for row in rows.values()} == {"reduced"}
    serial = reduce_runs(runs, tmp_path / "serial", dynamics=dynamics, engine=HERE)
    assert [rows[row["run_name"]]["balance_AF_N"] for row in serial.rows] == [r["balance_AF_N"] for r in serial.rows]


def test_the_public_name(files):
    found = ab.run_campaign(files.test, files.out, workers=0)
    assert (found.done, len(found.rows)) == ((), 3)
    assert (files.out / "summary.html").is_file()
    assert found.history("run_1")["AF"].sizes == {"time": 800}


def test_a_run_that_can_no_longer_be_assigned_is_worked_on_again(tmp_path):
    one = work.RunWork(
        Run("a", 1, "a.csv", dynamics="d.json"), RunSettings(), str(tmp_path), {"a.csv": "1", "d.json": "2"}
    )
    other = replace(one, run=replace(one.run, fault="there is no zero that agrees in polar"))
    assert one.key != other.key


def test_coefficients_that_lack_their_components_are_told_with_them(tmp_path, rng, capsys):
    """A balance of one component has no coefficient but CAF, and CD at an angle of zero."""
    _, dynamics = axial_folder(tmp_path, rng, count=2)
    test = tmp_path / "test.toml"
    test.write_text(
        f"[runs]\nfiles = 'runs/*.h5'\n[[setups]]\ndynamics = '{dynamics}'\n[angles]\n"
        "[reference]\narea = 0.1\nchord = 0.2\nspan = 0.5\n[pressure]\nvalue = 1000.0\n",
        encoding="utf-8",
    )
    assert main(["campaign", str(test), "-o", str(tmp_path / "out"), "--workers", "0", "--json"]) == 0
    answer = capsys.readouterr()
    (flag,) = [one for one in json.loads(answer.out)["flags"] if one["kind"] == "not measured"]
    assert flag["runs"] == ["run_1", "run_2"]
    assert flag["text"].startswith("coefficients of all runs are empty for want of components: CNF CL need NF; CPM")
    assert "not measured: coefficients of all runs are empty" in answer.err
    assert "CAF" not in flag["text"]
    assert "CD" not in flag["text"]
    rows = pq.read_table(tmp_path / "out" / "summary.parquet").to_pylist()
    assert all(row["CL"] is None and row["CD"] is not None and "CL: NF" in row["lacking"] for row in rows)
    assert "Coefficients without their components" in (tmp_path / "out" / "summary.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("status", "answer", "there"),
    [(200, b'{"Individual Workers": "/individual-workers"}', True), (200, b"{}", False), (404, b"none", False)],
)
def test_a_dashboard_is_told_where_there_is_one(status, answer, there):
    class Answers(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(status if self.path == "/individual-plots.json" else 404)
            self.end_headers()
            self.wfile.write(answer)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        link = f"http://127.0.0.1:{server.server_port}/status"
        assert _has_dashboard(link) == there
        server.shutdown()
        serving.join()
    assert not _has_dashboard(link)  # nobody answers
