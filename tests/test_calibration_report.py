"""The report of a calibration: one page that needs nothing else, with what was found and nothing made up."""

import hashlib
import re
import time
from dataclasses import replace
from html import unescape
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.text import Text

from aerobalance import __version__
from aerobalance.app.reports import calibration_report
from aerobalance.app.reports.calibration_figures import (
    MARKERS,
    MOST_STYLES,
    _mark_outliers,
    _Panel,
    residual_panels,
    series_key,
    series_style,
)
from aerobalance.app.reports.calibration_report import _terms, write_calibration_report
from aerobalance.app.reports.page import PLACE_HOLDERS, decimals, empty_figure, fixed
from aerobalance.balance.calibration.fit import Calibration, calibrate
from aerobalance.balance.calibration.outliers import Outlier
from aerobalance.balance.calibration.quality import Quality, assess
from aerobalance.balance.matrix import TemperatureEffect
from aerobalance.recording.errors import ReadError
from aerobalance.simulation.calibration_stand import CalibrationStand, random_balance
from helpers.html_pages import Balanced
from seeds import new_seed

NAME = "<b>tricky & $x_2$ -- name</b>"
BROWSER_FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
CHROMIUM = Path("/usr/bin/chromium")


class Page:
    """A simulated calibration with one point spoilt, and its page."""

    def __init__(self, folder: Path) -> None:
        self.seed = new_seed()
        effects = (TemperatureEffect(20.0, 2e-4, 0.0, 1e-4, 0.0),) * 6
        stand = CalibrationStand(
            random_balance(self.seed, model="abs"), confirmation=0.1, temperature_swing=4.0,
            temperature_effects=effects,
        )  # fmt: skip
        schedule = stand.run(self.seed).schedule
        outputs = schedule.outputs.copy()
        self.spoilt = 20
        outputs[self.spoilt, 1] += 0.02  # near thirty standard deviations of the noise, 1.8 % of the output
        self.schedule = replace(schedule, name=NAME, outputs=outputs)
        self.calibration = calibrate(self.schedule, model="abs")
        self.quality = assess(self.calibration)
        self.source = folder / "schedule.csv"
        self.source.write_text("load\n")
        self.path = folder / "report.html"
        self.drawn: dict[str, tuple[str, ...]] = {}
        self.warnings = ["the zero of <N1> drifts"]
        self.text = self.write(self.path)

    def write(self, path: Path, **changes) -> str:
        given = {"calibration": self.calibration, "quality": self.quality, "warnings": self.warnings} | changes
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(calibration_report, "residual_panels", self.panels)
            write_calibration_report(
                path, given["calibration"], given["quality"], warnings=given["warnings"], source=self.source
            )
        return path.read_text(encoding="utf-8")

    def panels(self, calibration: Calibration, quality: Quality, against: str) -> tuple[str, ...]:
        """Draw a calibration once, which takes four seconds: pages with other words are read for their words."""
        if calibration is not self.calibration:
            return residual_panels(calibration, quality, against)
        if against not in self.drawn:
            self.drawn[against] = residual_panels(calibration, quality, against)
        return self.drawn[against]

    def row(self, heading: str, text: str | None = None) -> list[str]:
        """Cells of the first row whose heading begins so."""
        for row in re.findall(r"<tr[^>]*>(.*?)</tr>", text or self.text, flags=re.DOTALL):
            cells = [unescape(re.sub(r"<[^>]+>", "", cell)).strip() for cell in re.findall(r"<t[hd].*?</t[hd]>", row)]
            if cells and cells[0].startswith(heading):
                return cells[1:]
        raise AssertionError(f"no row {heading!r}, seed {self.seed}")


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Page:
    return Page(tmp_path_factory.mktemp("calibration"))


def as_number(text: str) -> float:
    return float(text.split(maxsplit=1)[0].replace("−", "-"))


def test_page_needs_nothing_from_outside(page):
    assert "http" not in page.text
    assert "//" not in re.sub(r"<style>.*?</style>", "", page.text, flags=re.DOTALL)
    assert "<script" not in page.text
    assert not re.search(r"\b(src|srcset)=", page.text)
    assert all(target.startswith("#") for target in re.findall(r'href="([^"]*)"', page.text))
    assert str(page.path.parent) not in page.text


def test_page_is_well_formed(page):
    checker = Balanced()
    checker.feed(page.text)
    assert checker.open == []
    assert len(checker.ids) == len(set(checker.ids))
    assert set(re.findall(r'href="#([^"]*)"', page.text)) <= set(checker.ids)
    assert set(re.findall(r"url\(#([^)]*)\)", page.text)) <= set(checker.ids)


def test_figures_say_what_they_show_in_the_colours_of_the_page(page):
    figures = re.findall(r'<svg role="img".*?</svg>', page.text, flags=re.DOTALL)
    assert len(figures) == 3 * 6 + 1  # against load, order and temperature for each component, and the directions
    declared = set(re.findall(r"(--\w+):", page.text))
    for figure in figures:
        label = ElementTree.fromstring(figure).get("aria-label")
        assert label
        assert set(re.findall(r"var\((--\w+)\)", figure)) <= declared
        assert not any(
            getattr(PLACE_HOLDERS, name) in figure for name in ("ink", "first", "second", "third", "fourth")
        )
    labels = re.findall(r'aria-label="(Residuals[^"]*)"', page.text)
    assert len(labels) == 18
    assert f"at point {page.schedule.points[page.spoilt]}" in labels[1], page.seed
    assert "outlier" in labels[1], page.seed


def test_statistics_are_those_of_the_calibration(page):
    fits = page.calibration.regressions
    # three decimals are written, so a number may differ by half of the last
    for heading, values in {
        "Residual, largest": 100 * page.quality.largest,
        "PRESS": [100 * fit.press for fit in fits],
        "Repeatability": 100 * page.quality.repeatability,
        "Confirmation points, rms": 100 * page.quality.confirmation,
    }.items():
        assert [as_number(cell) for cell in page.row(heading)] == pytest.approx(list(values), abs=5.1e-4), page.seed
    assert page.row("Outliers")[1] != "0", page.seed
    assert [int(cell) for cell in page.row("Terms in the model")] == [int(fit.included.sum()) for fit in fits]


def test_interactions_are_percent_of_output_at_capacity(page):
    linear = page.calibration.matrix.linear
    for i, name in enumerate(page.schedule.gauges):
        cells = [as_number(cell) for cell in page.row(f"r{name}")]
        expected = 100 * linear[i] / abs(linear[i, i])
        # two decimals, and none where a load meets its own bridge
        assert cells == pytest.approx(list(expected), abs=5.1e-3), page.seed
        assert cells[i] == 100


def test_outliers_are_listed_with_point_and_series(page):
    cells = page.row(page.schedule.points[page.spoilt])
    assert cells[:2] == [page.schedule.series_names[page.schedule.series[page.spoilt]], "N2"], page.seed
    # 20 uV/V were added; the noise of 0.7 uV/V is on it, and what the other points tell no better
    assert 14 < as_number(cells[4]) < 26, page.seed


def test_tares_stand_there_by_both_methods(page):
    first = page.row("intercept", page.text.replace('<th scope="row" rowspan="2">1</th>', ""))
    second = page.row("iteration")
    for k in range(6):
        assert as_number(first[k]) == pytest.approx(page.calibration.tares[0, k], abs=0.51, rel=0), page.seed
        assert as_number(second[k]) == pytest.approx(page.calibration.tares_by_iteration[0, k], abs=0.51, rel=0)


def test_warnings_stand_before_everything_else(page):
    assert page.text.index("the zero of &lt;N1&gt; drifts") < page.text.index('id="statistics"')
    assert "before use" in page.text
    assert "Fit for use" not in page.text


def test_a_good_calibration_is_fit_for_use(page, tmp_path):
    covered = np.full(6, 0.95)
    good = replace(page.quality, outliers=(), of_half_range=np.full(6, 1e-3), confirmation_covered=covered)
    text = page.write(tmp_path / "r.html", quality=good, warnings=[])
    assert "Fit for use" in text
    assert "before use" not in text
    for bad, said in (
        (replace(good, of_half_range=np.full(6, 4e-3)), "0.40 %"),
        (replace(good, confirmation_covered=np.full(6, 0.5)), "confirmation points than"),
    ):
        text = page.write(tmp_path / "r.html", quality=bad, warnings=[])
        assert "Fit for use" not in text
        assert said in text


def test_names_from_the_file_are_text_and_not_markup(page):
    assert NAME not in page.text
    assert "&lt;b&gt;tricky &amp; $x_2$ -- name&lt;/b&gt;" in page.text


def test_provenance_names_file_digest_and_version(page):
    assert hashlib.sha256(page.source.read_bytes()).hexdigest() in page.text
    assert page.source.name in page.text
    assert f"aerobalance {__version__}" in page.text


@pytest.fixture(scope="module")
def lacking(page, tmp_path_factory) -> tuple[Calibration, str]:
    """A calibration that knows little, and its page: no temperature, no natural zeros, one component at a time."""
    alone = page.schedule.series == 0
    keep = alone & page.schedule.fitted
    schedule = replace(
        page.schedule, loads=page.schedule.loads[keep], outputs=page.schedule.outputs[keep],
        series=page.schedule.series[keep], points=tuple(np.array(page.schedule.points)[keep]),
        confirmation=page.schedule.confirmation[keep], temperature=None, natural_zeros=np.zeros((0, 6)),
        assumptions=("units are SI",),
    )  # fmt: skip
    calibration = calibrate(schedule, model="27")
    path = tmp_path_factory.mktemp("lacking") / "r.html"
    return calibration, page.write(path, calibration=calibration, quality=assess(calibration))


def test_what_is_not_known_is_said(page, lacking):
    calibration, text = lacking
    assert "Against temperature" not in text
    assert "Not known: the file has no natural zeros" in text
    assert "units are SI" in text
    with pytest.raises(ValueError, match="no temperature"):
        residual_panels(calibration, page.quality, "temperature")


def test_terms_not_identified_are_named_with_the_reason(lacking):
    calibration, text = lacking
    count = len(calibration.unidentified)
    assert count >= 15  # the products of six components two by two
    for label in calibration.unidentified_labels:
        assert f"<code>{label}</code>" in text
    assert f"<b>{count}</b> because the loads never bring them out" in text


def test_a_page_is_written_whole_or_not_at_all(page, tmp_path):
    with pytest.raises(ValueError, match="no folder"):
        page.write(tmp_path / "missing" / "r.html")
    kept = tmp_path / "kept.html"
    kept.write_text("old")
    with pytest.raises(ReadError, match="gone"):
        write_calibration_report(kept, page.calibration, page.quality, warnings=[], source=tmp_path / "gone.csv")
    assert kept.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["kept.html"]


def test_inflation_is_marked_from_five_and_from_ten_on():
    row = {"term": "N1", "value": 1.0, "u": 0.012, "t": 83.3, "p": 1e-9, "percent_contribution": 100.0}
    rows = _terms([{**row, "vif": vif} for vif in (4.9, 5.0, 10.0, np.inf)])
    assert [item["mark"] for item in rows] == [0, 1, 2, 2]
    assert rows[0]["p"] == "< 0.0001"
    assert (rows[0]["value"], rows[0]["u"]) == ("1.000", "0.012")
    assert rows[3]["vif"] == "more than 1,000,000"


def test_every_series_has_a_style_of_its_own(page):
    styles = [series_style(number, MOST_STYLES) for number in range(MOST_STYLES)]
    assert len(set(styles)) == MOST_STYLES
    assert all(a.colour != b.colour and a.marker != b.marker for a, b in pairwise(styles))
    assert {style.marker for style in styles} == set(MARKERS)
    assert len(series_key(page.calibration)) == len(page.schedule.series_names)


def test_many_series_share_one_style(page):
    names = tuple(str(number) for number in range(MOST_STYLES + 1))
    many = replace(page.calibration, schedule=replace(page.schedule, series_names=names))
    assert series_key(many) == []
    assert series_style(0, MOST_STYLES + 1) == series_style(5, MOST_STYLES + 1)


def test_labels_of_outliers_do_not_cover_each_other(page):
    points = np.argsort(np.abs(page.schedule.loads[:, 0]))[:6]  # all at zero load
    outliers = tuple(Outlier(int(point), 0, 0.01, 9.0) for point in points)
    panel = _Panel(page.calibration, replace(page.quality, outliers=outliers), 0, "load")
    figure, (axes,) = empty_figure(PLACE_HOLDERS, (4.1, 2.7), rows=1)
    axes.plot(panel.x, panel.y, "o")
    _mark_outliers(axes, panel)
    figure.draw_without_rendering()
    assert axes.texts[0].get_text() == page.schedule.points[points[0]]
    assert len(axes.texts) >= 4, page.seed
    # the lettering as drawn, with a point of slack for what hangs below the line
    boxes = [Text.get_window_extent(text) for text in axes.texts]
    slack = figure.dpi / 72
    for k, box in enumerate(boxes):
        assert axes.get_window_extent().padded(slack).contains(box.x1, box.y1), page.seed
        for other in boxes[k + 1 :]:
            across = min(box.x1, other.x1) - max(box.x0, other.x0)
            up = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert across <= slack or up <= slack, (box, other, page.seed)


def test_numbers_are_written_for_people():
    assert [fixed(value, 2) for value in (1.005, -2.0, -0.001, None, np.nan)] == ["1.00", "−2.00", "0.00", "–", "–"]
    assert [decimals(u) for u in (0.012, 1.2, 34.0, 0.0, np.nan)] == [3, 1, 0, 3, 3]


@pytest.mark.browser
@pytest.mark.skipif(not CHROMIUM.exists(), reason="no Chromium on this machine")
def test_browser_shows_the_page_wide_and_narrow(page):
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=BROWSER_FLAGS)
        colours = set()
        for width, scheme in ((1100, "light"), (400, "dark")):
            view = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
            said, asked = [], []
            view.on("console", lambda message, said=said: said.append(message.text))
            view.on("pageerror", lambda error, said=said: said.append(str(error)))
            view.on("request", lambda request, asked=asked: asked.append(request.url))
            view.goto(page.path.as_uri())
            view.evaluate("document.querySelectorAll('details').forEach(item => item.open = true)")
            assert said == [], page.seed
            assert asked == [page.path.as_uri()], page.seed
            sizes = view.evaluate(
                "[...document.querySelectorAll('svg')].map(item => item.getBoundingClientRect())"
                ".map(box => Math.min(box.width, box.height))"
            )
            assert len(sizes) >= 19
            assert min(sizes) > 5
            panels = view.evaluate("[...document.querySelectorAll('.panels svg')].map(item => item.clientWidth)")
            assert min(panels) > 300, "lettering of 8 points in a panel of 295 points is not readable any smaller"
            assert view.evaluate("document.documentElement.scrollWidth") <= width
            beyond = view.evaluate(
                "[...document.querySelectorAll('main *')].filter(item => !item.closest('.wide > table, svg *')"
                " && item.getBoundingClientRect().right > innerWidth + 1).map(item => item.outerHTML.slice(0, 80))"
            )
            assert beyond == []
            colours.add(view.evaluate("getComputedStyle(document.body).backgroundColor"))
            view.close()
        assert len(colours) == 2  # light and dark
        view = browser.new_page()
        view.goto(page.path.as_uri())
        tables = "[...document.querySelectorAll('details table')].map(item => item.checkVisibility())"
        assert view.evaluate(tables) == [False] * 6
        view.emulate_media(media="print")  # nobody can open what is folded on paper
        assert view.evaluate(tables) == [True] * 6
        view.emulate_media(media="screen")
        view.focus("summary")
        view.keyboard.press("Enter")
        deadline = time.monotonic() + 60
        while not view.evaluate("document.querySelector('details').open") and time.monotonic() < deadline:
            view.wait_for_timeout(50)
        assert view.evaluate("document.querySelector('details').open")
        browser.close()
