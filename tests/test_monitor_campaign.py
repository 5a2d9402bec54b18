"""The test that the operator's page watches, without the page: what is refused, lost and served."""

from __future__ import annotations

import time

import pytest

from aerobalance.app.monitor.campaigns import CampaignWatch
from aerobalance.app.monitor.folder import Folder
from aerobalance.app.monitor.log import Log
from helpers.axial_runs import axial_folder

TEST = '[runs]\nfiles = "{}"\n[[setups]]\ndynamics = "dynamics.json"\n'


@pytest.fixture
def watch(tmp_path):
    """What watches a folder with two test files and a set-up."""
    for name, runs in (("test", "runs/*.h5"), ("afar", "elsewhere/*.h5")):
        (tmp_path / f"{name}.toml").write_text(TEST.format(runs))
    (tmp_path / "setup.toml").write_text("[source]\n")
    (tmp_path / "broken.toml").write_text("[runs\n")
    found = CampaignWatch(Folder(tmp_path), Log(lambda: None, lambda text, kind: None))
    yield found
    found.close()


def until(holds, seconds=60.0):
    limit = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < limit
        time.sleep(0.02)


def test_only_test_files_of_the_folder_are_watched_one_at_a_time(watch, tmp_path):
    assert watch.tests() == ["afar.toml", "test.toml"]
    for name in ("none.toml", "../test.toml", "dynamics.json"):
        with pytest.raises(ValueError, match=r"no test file|is no name"):
            watch.begin(name)
    with pytest.raises(ValueError, match="no test is watched"):
        watch.end()
    watch.begin("test.toml")
    with pytest.raises(ValueError, match=r"test\.toml is being watched; end that first"):
        watch.begin("afar.toml")
    watch.end()
    until(lambda: not watch.process.is_alive())
    assert watch.shown["state"] == "ended"


def test_a_process_that_is_lost_is_told_and_can_be_begun_anew(watch, tmp_path, rng):
    axial_folder(tmp_path, rng, count=1)
    watch.begin("test.toml")
    watch.process.kill()
    until(lambda: watch.shown["state"] == "failed")
    assert "is gone (killed, or crashed)" in watch.shown["problem"]
    watch.begin("test.toml")
    assert watch.shown["state"] == "running"


def test_only_pages_of_the_results_are_served(watch, tmp_path):
    with pytest.raises(ValueError, match="no such page"):
        watch.page("summary.html")  # nothing is watched
    watch.begin("test.toml")
    out = tmp_path / "test-results"
    (out / "reports").mkdir(parents=True, exist_ok=True)
    (tmp_path / "secret.html").write_text("secret")
    for name in ("summary.html", "reports/run_1.html", "campaign.json"):
        (out / name).write_text("x")
    (out / "reports" / "link.html").symlink_to(tmp_path.parent)
    assert watch.page("summary.html") == out / "summary.html"
    assert watch.page("reports/run_1.html") == out / "reports" / "run_1.html"
    for name in (
        "campaign.json",
        "../secret.html",
        "reports/../../secret.html",
        "reports/none.html",
        "reports/link.html",
    ):
        with pytest.raises(ValueError, match=r"no such page|is not below"):
            watch.page(name)


@pytest.mark.parametrize("elsewhere", ["/etc/hostname", "file:///etc/hostname"])
def test_a_test_that_reads_elsewhere_is_refused(watch, tmp_path, elsewhere):
    (tmp_path / "afar.toml").write_text(TEST.format("runs/*.h5").replace("dynamics.json", elsewhere))
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "a.h5").write_bytes(b"")
    watch.begin("afar.toml")
    until(lambda: watch.shown["state"] == "failed")
    assert watch.shown["problem"].startswith(f"{elsewhere} is not below the project folder")
    assert not list((tmp_path / "afar-results").rglob("a.json"))
