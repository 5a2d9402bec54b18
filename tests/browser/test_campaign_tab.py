"""The page's tab of a campaign, in Chromium: runs are reduced as they come in, and join the results that it shows."""

from __future__ import annotations

import pytest

from helpers.axial_runs import axial_folder
from helpers.in_chromium import CHROMIUM, Operator, page_in_chromium

pytestmark = [pytest.mark.browser, pytest.mark.skipif(not CHROMIUM.exists(), reason="no Chromium here")]
TEST = """
name = "wing A"
[runs]
files = "runs/*.h5"
[[setups]]
dynamics = "dynamics.json"
[output]
reports = "none"
"""


def test_runs_join_the_tab_as_they_come_in(tmp_path, rng) -> None:
    runs, _ = axial_folder(tmp_path, rng, count=2)
    (runs / "run_2.h5").rename(tmp_path / "later.h5")
    (tmp_path / "test.toml").write_text(TEST)
    (tmp_path / "setup.toml").write_text('[source]\nkind = "simulated"\nrig = "cable_cut"\n')  # no test
    (tmp_path / "test_2.toml").write_text(TEST.replace("dynamics.json", "/etc/hostname"))  # outside the folder
    with page_in_chromium(tmp_path) as (browser, base, _):
        operator = Operator(browser, base)
        view, line = operator.view, "document.getElementById('campaign-line').textContent"
        view.click("#tab-campaign")
        operator.until("document.getElementById('campaign-test').options.length > 0")
        assert view.locator("#campaign-test option").all_inner_texts() == ["test.toml", "test_2.toml"]
        assert view.is_hidden("#live-view")
        view.select_option("#campaign-test", "test_2.toml")
        view.click("#campaign-begin")
        operator.until(f"{line}.startsWith('▲ test_2.toml: /etc/hostname is not below the project folder')")
        view.select_option("#campaign-test", "test.toml")
        view.click("#campaign-begin")
        operator.until(f"{line} === 'wing A: watched; 1 of 1 runs reduced'")
        shown = view.frame_locator("#campaign-page")
        shown.get_by_text("1 of 1 runs reduced").wait_for()
        assert shown.locator("svg[aria-label*='angle of attack']").count() == 1
        (tmp_path / "later.h5").rename(runs / "run_2.h5")
        operator.until(f"{line} === 'wing A: watched; 2 of 2 runs reduced'")
        shown.get_by_text("2 of 2 runs reduced").wait_for()
        assert view.inner_text("#tab-campaign") == "Campaign 2/2"
        assert view.locator("#campaign-said li").first.inner_text().startswith("run_1: ")
        view.click("#campaign-end")
        operator.until(f"{line} === 'wing A: no longer watched; 2 of 2 runs reduced'")
        for name in ("..%2Ftest.toml", "runs/run_1.json", "campaign.json", "reports/..%2F..%2Fnone.html"):
            assert view.evaluate(f"fetch('/campaign/{name}').then((answer) => answer.status)") == 404
        view.click("#tab-live")
        operator.until("document.getElementById('main-chart').getBoundingClientRect().width > 300")
        assert [text for text in operator.said if "404" not in text] == []
