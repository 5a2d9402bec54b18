"""The demo: both experiments through files and the public commands, and a report that stands by itself."""

import hashlib
import json
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.app.demos.comparison import split_deviation
from aerobalance.app.demos.demo import step_data
from aerobalance.app.reports.demo_report import step_figure
from aerobalance.app.reports.page import PLACE_HOLDERS, number, significant, with_uncertainty
from helpers.html_pages import Balanced


class Demo:
    """One run of the demo and its page."""

    def __init__(self, folder: Path, account: dict) -> None:
        self.folder, self.account = folder, account
        self.seed = self.account["seed"]
        self.page = Path(self.account["report"]).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def demo(demo_run) -> Demo:
    return Demo(*demo_run)


def test_every_printed_number_agrees(demo):
    # A number is given 3 of its standard uncertainties. Each of the ten that have one can miss with a probability of
    # 0.3 %, and on top of that they meet a range with a width, so at most one of them may miss here.
    missed = [row["name"] for row in demo.account["agreements"] if not row["agrees"]]
    assert len(demo.account["agreements"]) == 17
    assert len(missed) <= 1, (missed, demo.seed)


def test_what_is_computed_is_what_the_rig_was_built_with(demo):
    # Five of the uncertainties that the artefacts state; the rigs are built with the printed numbers.
    truth = {"rig_steady": (0.68, 11.43e6, 371.98), "cut_10N": (177.87, 3.093e7, 828.21)}
    for tag, values in truth.items():
        found = json.loads((demo.folder / f"dynamics_{tag}.json").read_text())["components"]["AF"]
        for name, value in zip(("mass", "stiffness", "damping"), values, strict=True):
            assert abs(found[name]["value"] - value) < 5 * found[name]["u"], (tag, name, demo.seed)


def test_deviations_are_below_the_papers(demo):
    deviations = demo.account["deviations"]
    assert deviations["harmonic, steady"]["largest"] <= 0.1, demo.seed
    for noise in ("10", "2"):
        row = deviations[f"step, {noise} N noise, smoother"]
        # What the issue of the estimator's quality asks for at 2 N: 0.2 %, 1 % and 0.02 %; five times that at 10 N.
        factor = float(noise) / 2
        assert row["rms_percent_of_half_range"] <= 0.2 * factor, demo.seed
        assert row["largest_percent_of_half_range"] <= 1.0 * factor, demo.seed
        assert row["mean_percent_of_step"] * 1020 / 2000 <= 0.02 * factor, demo.seed


def test_central_differences_are_as_noisy_as_calculated(demo):
    # Noise gain of (18) with three-point differences: weights (c - s, 1 - 2 c, c + s), c = M/k h^2, s = b/k 2h.
    h, M, k, b = 1 / 1600, 177.87, 3.093e7, 828.21
    c, s = M / (k * h**2), b / (2 * k * h)
    gain = np.sqrt((1 - 2 * c) ** 2 + (c + s) ** 2 + (c - s) ** 2)
    rms = demo.account["deviations"]["step, 2 N noise, central differences"]["rms_percent_of_half_range"] * 20
    # 6300 samples, correlated over three: the scatter of their rms is below 2 %, five of which are allowed.
    assert rms == pytest.approx(2 * gain, rel=0.1), demo.seed


def test_page_needs_nothing_from_outside(demo):
    assert "http" not in demo.page
    assert "//" not in re.sub(r"<style>.*?</style>", "", demo.page, flags=re.DOTALL)
    assert "<script" not in demo.page
    assert not re.search(r"\b(src|srcset)=", demo.page)
    assert all(target.startswith("#") for target in re.findall(r'href="([^"]*)"', demo.page))


def test_page_is_well_formed(demo):
    checker = Balanced()
    checker.feed(demo.page)
    assert checker.open == []
    assert len(checker.ids) == len(set(checker.ids))
    assert set(re.findall(r'href="#([^"]*)"', demo.page)) <= set(checker.ids)
    assert set(re.findall(r"url\(#([^)]*)\)", demo.page)) <= set(checker.ids)


def test_figures_take_the_colours_of_the_page(demo):
    figures = re.findall(r"<svg.*?</svg>", demo.page, flags=re.DOTALL)
    assert len(figures) == 5
    declared = set(re.findall(r"(--\w+):", demo.page))
    for figure in figures:
        ElementTree.fromstring(figure)
        assert set(re.findall(r"var\((--\w+)\)", figure)) <= declared
        assert not any(getattr(PLACE_HOLDERS, name) in figure for name in ("ink", "muted", "grid", "first", "second"))
        colours = set(re.findall(r"#[0-9a-f]{6}\b", figure))
        assert not colours, colours


def test_page_shows_figures_tables_seed_and_digests(demo):
    for text in ("Figure 3 remade", "Figure 4 remade", "Figure 5 remade", "Figure 6 remade", "Non-steadiness"):
        assert text in demo.page
    assert str(demo.seed) in demo.page
    for name in ("rig_steady.csv", "cut_10N.csv", "weighing_cut.csv"):
        assert hashlib.sha256((demo.folder / name).read_bytes()).hexdigest() in demo.page


def test_step_picture_fits_a_readme(demo, tmp_path):
    path = tmp_path / "step.png"
    step_figure(path, step_data(demo.folder, "10N", release=1.0003))
    head = path.read_bytes()
    width, height = (int.from_bytes(head[place : place + 4], "big") for place in (16, 20))
    assert (width, height) == (1400, 700)
    assert len(head) < 150_000


def test_figures_leave_pyplot_alone(demo, tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)  # a library of another test may load it
    step_figure(tmp_path / "step.png", step_data(demo.folder, "10N", release=1.0003))
    assert "matplotlib.pyplot" not in sys.modules, demo.seed


def test_a_folder_that_cannot_be_made_is_a_wrong_call(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "deeper"):
        assert main(["demo", "--out", str(out)]) == 2
        assert "cannot make the folder" in capsys.readouterr().err


def test_a_deviation_is_split_without_remainder():
    dwell = {"measured": 9.0, "calculated": 8.0, "unsteadiness": 0.2, "model": 0.8, "accelerometer_noise": 0.3}
    rig = {"fit": {"dwells": [{"frequency": 652.4, "steady": False, **dwell}]}}
    split = split_deviation(rig, 652.5)
    assert split["noise"] == pytest.approx(0.6)  # two standard deviations of the noise, and the model has the rest
    assert split["unsteadiness"] + split["noise"] + split["model"] == pytest.approx(split["deviation"])


def test_numbers_are_written_for_people():
    assert number(-1.5) == "−1.5"
    assert number(None) == "–"
    assert number(1.25e-7, 3) == "1.25·10<sup>-7</sup>".replace("-", "−")
    assert with_uncertainty(371.6865, 0.2149) == "371.69 <span class=u>± 0.21</span>"
    assert with_uncertainty(1234.5, 56.0) == "1234 <span class=u>± 56</span>"
    assert [significant(value, 2) for value in (353.2, 0.0998, -2.0, 0)] == ["350", "0.10", "−2.0", "0"]
