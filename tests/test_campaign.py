"""A campaign from its files to its results: only what is not done is done, and what is lost is done again."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import fsspec
import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
import xarray as xr

import aerobalance as ab
from aerobalance.app.campaign import engine as engines
from aerobalance.app.campaign.campaign import reduce_runs
from aerobalance.app.campaign.engine import Engine
from aerobalance.estimation.force import estimate_force
from aerobalance.io import read, write_recording
from aerobalance.recording.errors import ReadError
from helpers.axial_runs import axial_folder, run_of, spring

# of a white load, which some records doubt
pytestmark = pytest.mark.filterwarnings("ignore:.*depart from what the model:UserWarning")
HERE = Engine(workers=0)


def cli(*words: object, **more):
    return subprocess.run(
        [sys.executable, "-m", "aerobalance.app.cli", *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        **more,
    )


def records(out: Path) -> dict[str, float]:
    """When the record of each run was written."""
    return {path.stem: path.stat().st_mtime_ns for path in (out / "runs").glob("*.json")}


def test_a_folder_becomes_a_table_and_histories_that_other_programs_read(tmp_path, rng):
    runs, dynamics = axial_folder(tmp_path, rng, count=3)
    (runs / "broken.h5").write_bytes(b"\x89HDF\r\n\x1a\nnothing more")
    (runs / "notes.txt").write_text("not a table at all\n")
    found = reduce_runs(runs, tmp_path / "out", dynamics=dynamics, engine=HERE)
    table = pq.read_table(tmp_path / "out" / "summary.parquet").to_pandas().set_index("run_name")
    assert list(table.index) == ["broken", "notes", "run_1", "run_2", "run_3"]
    assert list(table["status"]) == ["set aside"] * 2 + ["reduced"] * 3
    assert "damaged HDF5" in table["reason"]["broken"]
    assert set(found.aside) == {"broken", "notes"}
    direct = estimate_force(read(runs / "run_2.h5"), spring())
    assert table["balance_AF_N"]["run_2"] == pytest.approx(float(direct["AF"].values.mean()), rel=1e-12)
    data = xr.open_zarr(tmp_path / "out" / "histories.zarr", group="run_2", consolidated=False)
    np.testing.assert_array_equal(data["AF"].to_numpy(), direct["AF"].values)
    np.testing.assert_array_equal(data["u_AF"].to_numpy(), direct["AF"].uncertainty)
    np.testing.assert_array_equal(data["load_AF"].to_numpy(), read(runs / "run_2.h5").channel("AF").values)
    assert data["AF"].attrs["units"] == "N"
    with xr.open_datatree(tmp_path / "out" / "histories.zarr", engine="zarr", consolidated=False) as tree:
        assert sorted(tree) == ["run_1", "run_2", "run_3"]
    assert found.quality.repeats == ()  # nothing says that runs are at one angle
    assert found.table.loc["run_2", "balance_AF_N"] == table["balance_AF_N"]["run_2"]


def test_what_is_done_is_not_done_again_and_what_changed_is(tmp_path, rng):
    runs, dynamics = axial_folder(tmp_path, rng, count=3)
    out = tmp_path / "out"
    first = reduce_runs(runs, out, dynamics=dynamics, engine=HERE)
    table, before = (out / "summary.parquet").read_bytes(), records(out)
    again = reduce_runs(runs, out, dynamics=dynamics, engine=HERE)
    assert again.done == ()
    assert again.rows == first.rows
    assert (out / "summary.parquet").read_bytes() == table
    assert records(out) == before
    write_recording(runs / "run_2.h5", run_of(rng, mean=50.0))
    shutil.copy(runs / "run_1.h5", runs / "run_4.h5")
    (runs / "run_3.h5").unlink()
    shutil.rmtree(out / "histories.zarr" / "run_1")
    changed = reduce_runs(runs, out, dynamics=dynamics, engine=HERE)
    assert changed.done == ("run_1", "run_2", "run_4")  # lost, changed and new
    assert sorted(records(out)) == ["run_1", "run_2", "run_4"]
    assert sorted(one.name for one in (out / "histories.zarr").iterdir() if one.is_dir()) == [
        "run_1",
        "run_2",
        "run_4",
    ]


def test_another_version_or_setting_is_worked_out_anew(tmp_path, rng, monkeypatch):
    axial_folder(tmp_path, rng, count=1)
    test = tmp_path / "test.toml"
    test.write_text('[runs]\nfiles = "runs/*.h5"\n[[setups]]\ndynamics = "dynamics.json"\n')
    reduce_runs(test, tmp_path / "out", engine=HERE)
    test.write_text('notes = "x"\n' + test.read_text())
    assert reduce_runs(test, tmp_path / "out", engine=HERE).done == ()  # words change nothing
    test.write_text(test.read_text() + "[force]\nbandwidth = 30.0\n")
    assert reduce_runs(test, tmp_path / "out", engine=HERE).done == ("run_1",)
    from aerobalance.app.campaign import work

    monkeypatch.setattr(work, "SCHEMA", work.SCHEMA + 1)
    assert reduce_runs(test, tmp_path / "out", engine=HERE).done == ("run_1",)


def test_inputs_come_from_a_store_and_results_go_to_one(tmp_path, rng):
    runs, dynamics = axial_folder(tmp_path, rng, count=2)
    store = fsspec.filesystem("memory")
    for path in sorted(runs.iterdir()):
        store.pipe_file(f"/lab/runs/{path.name}", path.read_bytes())
    store.pipe_file("/lab/dynamics.json", dynamics.read_bytes())
    text = '[runs]\nfiles = "runs/*.h5"\n[[setups]]\ndynamics = "dynamics.json"\n'
    store.pipe_file("/lab/test.toml", text.encode())
    here = reduce_runs(runs, tmp_path / "out", dynamics=dynamics, engine=HERE)
    there = reduce_runs("memory://lab/test.toml", "memory://results", engine=HERE)
    differ = {"file", "dynamics_file"}
    for one, other in zip(here.rows, there.rows, strict=True):
        assert {k: v for k, v in one.items() if k not in differ} == {k: v for k, v in other.items() if k not in differ}
    assert reduce_runs("memory://lab/test.toml", "memory://results", engine=HERE).done == ()
    with store.open("/results/summary.parquet", "rb") as file:
        assert pq.read_table(file).num_rows == 2
    data = xr.open_zarr("memory://results/histories.zarr", group="run_1", consolidated=False)
    assert data["AF"].shape == (800,)
    local = reduce_runs(f"file://{runs}", tmp_path / "out2", dynamics=dynamics, engine=HERE)
    assert local.rows[0]["balance_AF_N"] == here.rows[0]["balance_AF_N"]
    store.rm("/lab", recursive=True)
    store.rm("/results", recursive=True)


def test_wrong_calls_say_what_is_wrong(tmp_path, rng, monkeypatch):
    runs, dynamics = axial_folder(tmp_path, rng, count=1)
    with pytest.raises(ValueError, match="is a folder: give `dynamics`"):
        reduce_runs(runs, tmp_path / "out", engine=HERE)
    with pytest.raises(ReadError, match="neither a folder of recordings nor a test file"):
        reduce_runs(tmp_path / "none", tmp_path / "out", engine=HERE)
    with pytest.raises(ReadError, match=r"none\.json: there is no such file"):
        reduce_runs(runs, tmp_path / "out", dynamics=tmp_path / "none.json", engine=HERE)
    with pytest.raises(ReadError, match="cannot be opened: Protocol not known: nothing"):
        reduce_runs("nothing://runs/test.toml", tmp_path / "out", engine=HERE)
    with pytest.raises(ValueError, match="exists and is no campaign's folder"):
        reduce_runs(runs, runs, dynamics=dynamics, engine=HERE)
    with pytest.raises(ValueError, match="is a file"):
        reduce_runs(runs, dynamics, dynamics=dynamics, engine=HERE)
    with pytest.raises(ValueError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        monkeypatch.setattr(engines, "ANSWER", 0.5)
        reduce_runs(runs, tmp_path / "out", dynamics=dynamics, engine=Engine(scheduler="tcp://127.0.0.1:9"))
    monkeypatch.setattr(engines, "find_spec", lambda name: None)
    with pytest.raises(
        ValueError, match=r"distributed, which is not installed: pip install 'aerobalance\[campaign\]'"
    ):
        reduce_runs(runs, tmp_path / "out", dynamics=dynamics, engine=Engine(workers=1))


def test_the_command_writes_pages_and_its_killed_call_is_gone_on_with(tmp_path, rng):
    runs, dynamics = axial_folder(tmp_path, rng, count=3)
    (runs / "run_0.h5").write_bytes(b"")
    out = tmp_path / "out"
    words = ["campaign", runs, "--dynamics", dynamics, "-o", out, "--workers", 0]
    killed = subprocess.Popen(
        [sys.executable, "-m", "aerobalance.app.cli", *map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    limit = time.monotonic() + 60
    while len(records(out)) < 2:
        assert killed.poll() is None
        assert time.monotonic() < limit
        time.sleep(0.02)
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    before = records(out)
    assert 2 <= len(before) < 4
    done = cli(*words, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["worked_out_now"] == 4 - len(before)
    assert {name: when for name, when in records(out).items() if name in before} == before  # nothing twice
    assert found["set_aside"] == {"run_0": "is empty; a header line and rows of numbers are needed"}
    assert "warning: set aside: run_0" in done.stderr
    assert not list(out.rglob("*.part"))
    page = (out / "summary.html").read_text(encoding="utf-8")
    assert "3 of 4 runs reduced" in page
    for number in range(1, 4):
        assert f'href="reports/run_{number}.html"' in page
        assert "The force applied in run_" in (out / "reports" / f"run_{number}.html").read_text(encoding="utf-8")
    wrong = cli("campaign", runs, "-o", out)
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("error: ")
    assert "--dynamics" in wrong.stderr


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
        wait_for(tmp_path / "out", 1, command)
        for child in psutil.Process(worker.pid).children(recursive=True):
            child.kill()  # the process that works; its nanny starts another
        wait_for(tmp_path / "out", 2, command)
        os.killpg(scheduler.pid, signal.SIGKILL)
        os.killpg(worker.pid, signal.SIGKILL)
        with started(*SCHEDULER, "--port", str(port)), started(*WORKER, address):
            out, err = command.communicate(timeout=120)
    assert command.returncode == 0, err
    assert json.loads(out)["reduced"] == 5
    table = pq.read_table(tmp_path / "out" / "summary.parquet")
    without = [name for name in table.column_names if name != "report"]
    assert table.select(without).equals(pq.read_table(tmp_path / "serial" / "summary.parquet").select(without))
    assert len(serial.rows) == 5


@pytest.fixture
def interruptible():
    """Ctrl-C reaches what is started: a shell that runs tests in the background has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_runs_join_the_results_as_they_come_in(tmp_path, rng):
    runs, dynamics = axial_folder(tmp_path, rng, count=2)
    out = tmp_path / "out"
    (runs / "run_2.h5").rename(tmp_path / "later.h5")
    words = ["watch", runs, "--dynamics", dynamics, "-o", out, "--every", 0.2, "--json"]
    with subprocess.Popen(
        [sys.executable, "-m", "aerobalance.app.cli", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        wait_for(out, 1, process)
        whole = (tmp_path / "later.h5").read_bytes()
        (runs / "run_2.h5").write_bytes(whole[:4000])  # a recorder is not done yet
        time.sleep(1.0)
        (runs / "run_2.h5").write_bytes(whole)
        wait_for(out, 2, process)
        limit = time.monotonic() + 60
        while "2 of 2 runs reduced" not in (out / "summary.html").read_text(encoding="utf-8"):
            assert process.poll() is None
            assert time.monotonic() < limit
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        try:
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert 'http-equiv="refresh"' in (out / "summary.html").read_text(encoding="utf-8")
    assert "run_2: " in said
    assert "set aside" not in said


def wait_for(out: Path, count: int, process: subprocess.Popen) -> None:
    limit = time.monotonic() + 120
    while len(records(out)) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < limit
        time.sleep(0.02)


def free_port() -> int:
    import socket

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


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
    from aerobalance.app.campaign.campaign import planned, prepared
    from aerobalance.app.campaign.results import Results

    Results(str(out)).begin()
    works, _ = planned(prepared(runs, dynamics=dynamics), str(out), with_reports=False)
    for work, row in engine.rows(works):
        rows[work.run.name] = row
        if len(rows) == 1:
            kill_one()
    assert killed
    assert {row["status"] for row in rows.values()} == {"reduced"}
    serial = reduce_runs(runs, tmp_path / "serial", dynamics=dynamics, engine=HERE)
    assert [rows[row["run_name"]]["balance_AF_N"] for row in serial.rows] == [r["balance_AF_N"] for r in serial.rows]


def test_the_public_name(tmp_path, rng):
    runs, dynamics = axial_folder(tmp_path, rng, count=1)
    found = ab.run_campaign(runs, tmp_path / "out", dynamics=dynamics, workers=0)
    assert (tmp_path / "out" / "summary.html").is_file()
    assert found.history("run_1")["AF"].sizes == {"time": 800}
