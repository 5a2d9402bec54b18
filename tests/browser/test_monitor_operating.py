"""The operator's page in use, in Chromium: the record button, alarms, and looking into the charts."""

from __future__ import annotations

import time

import pytest

from aerobalance.io.hdf5_contents import contents
from helpers.in_chromium import CHROMIUM, Operator, in_sight, page_in_chromium

pytestmark = [pytest.mark.browser, pytest.mark.skipif(not CHROMIUM.exists(), reason="no Chromium here")]


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    folder = tmp_path_factory.mktemp("project")
    with page_in_chromium(folder) as (browser, base, _):
        yield browser, base, folder


@pytest.fixture
def operator(opened):
    browser, base, _ = opened
    page = Operator(browser, base)
    page.until("window.aerobalance.force !== null && !window.aerobalance.lost")
    yield page
    page.view.close()


def test_the_record_button_answers_at_once(opened, operator) -> None:
    view = operator.view
    view.fill("#record-name", "Prüfling µ")
    shown = view.evaluate(
        """() => { const text = (id) => document.getElementById(id).textContent;
          document.getElementById("record").click();
          const since = performance.now(), seen = () => ({
            after: performance.now() - since, button: text("record"), pill: text("record-state"),
            line: text("record-line"), record: document.getElementById("record").disabled,
            stops: ["stop", "stop-now"].map((id) => !document.getElementById(id).disabled) });
          return new Promise((resolve) => requestAnimationFrame(() => resolve(seen()))); }"""
    )
    print(f"answered after {shown['after']:.0f} ms")  # noqa: T201 - of the next picture, on a computer that may be busy
    assert shown["button"] == "Starting…" and shown["record"] and shown["stops"] == [True, True]
    assert shown["pill"] == "● REC starting"
    assert shown["line"] == "Prüfling µ.h5: starting; what is sampled since the press is in it"
    pressed = operator.number("pressed")
    operator.until("window.aerobalance.record === 'recording'")
    # which sample was taken when: of a second's frames the one that came with the least delay, as none comes early
    tick, ms = view.evaluate(
        """() => new Promise((resolve) => { const socket = new WebSocket(`ws://${location.host}/live`), came = [];
          socket.binaryType = "arraybuffer";
          socket.onmessage = ({ data }) => { if (typeof data === "string") return;
            const bytes = new DataView(data);
            if (bytes.getUint8(0) !== 1) return;
            came.push([bytes.getFloat64(32, true), bytes.getFloat64(16, true)]); };
          setTimeout(() => { socket.close();
            const early = ([tick, ms]) => tick - 1.6 * ms;
            resolve(came.reduce((best, at) => (early(at) > early(best) ? at : best))); }, 1000); })"""
    )
    view.click("#stop-now")
    operator.until("window.aerobalance.record === 'ended'")
    first = int(contents(opened[2] / "Prüfling µ.h5").blocks["tick"][0])
    expected = tick - (ms - pressed) / 1e3 * 1600
    print(f"first sample {(first - expected) / 1.6:.1f} ms after the press")  # noqa: T201
    assert abs(first - expected) <= 0.1 * 1600
    assert operator.said == []


@pytest.mark.parametrize("text", ["abc", "nan", "-1", "0", "1e99", "Infinity", "1,2,3"])
@pytest.mark.soak(first=2)
def test_a_length_that_is_none_is_not_sent(operator, text) -> None:
    view = operator.view
    asked = len(operator.asked)
    view.fill("#record-name", "endless")
    view.fill("#record-seconds", text)
    view.press("#record-seconds", "Enter")
    assert f"“{text}” is no length: give a number of seconds above zero" in view.inner_text("#length-error")
    assert view.get_attribute("#record-seconds", "aria-invalid") == "true"
    assert view.evaluate("document.activeElement.id") == "record-seconds"
    assert not any("/api/record" in url and not url.endswith("recordings") for url in operator.asked[asked:])
    view.fill("#record-seconds", "2,5")
    assert view.is_hidden("#length-error")


def test_alarms_are_kept_until_they_are_acknowledged(operator) -> None:
    view = operator.view
    # not known while what is shown is old, as it may be beside other tests
    operator.until("document.getElementById('alarm-state').textContent === '✓ no alarm'")
    view.click("#control-touch")
    operator.until("document.getElementById('alarm-state').textContent === '■ the model touches its support'")
    assert view.inner_text("#alarm-said") == "Alarm: contact"
    view.click("#control-release")
    operator.until("document.getElementById('alarm-state').textContent.endsWith('touches its support, now over')")
    view.reload()
    operator.until("document.getElementById('alarm-state').textContent.endsWith('touches its support, now over')")
    view.click("#alarm-state")
    assert "not yet" in view.inner_text("#alarm-list")
    assert not view.is_checked("#alarm-sound")
    view.click("#acknowledge")
    operator.until("document.getElementById('alarm-state').textContent === '✓ no alarm'")
    assert view.is_hidden("#acknowledge")
    assert "not yet" not in view.inner_text("#alarm-list") and "contact" in view.inner_text("#alarm-list")
    assert operator.said == []


def test_a_load_near_the_only_limit_is_shown_as_such(operator) -> None:
    view = operator.view
    given = {"source": {"kind": "simulated", "rig": "cable_cut", "noise": 0.0}, "limits": {"AF": {"low": -1100.0}}}
    view.evaluate(
        """(setup) => fetch("/api/setup", { method: "POST", headers: { "content-type": "application/json" },
          body: JSON.stringify({ setup }) })""",
        given,
    )
    # the cable pulls by 1020 N, which is 51 % of half of the range, 2000 N
    operator.until("document.getElementById('alarm-state').textContent === '▲ AF at 93 % of its limit'")
    words = "92.7 % of its limit, 51.0 % of half range"
    operator.until(f"document.getElementById('numbers').innerText.includes('{words}')")
    meter = view.get_by_role("meter", name="Balance load of AF over its limit")
    assert meter.is_visible() and meter.get_attribute("aria-valuenow") == "93"
    operator.rig("cable_cut")
    assert operator.said == []


@pytest.mark.parametrize("size", [(390, 844), (1440, 900), (820, 1000)])
@pytest.mark.soak(first=1)
def test_stop_record_and_alarm_are_always_in_sight(opened, size) -> None:
    browser, base, _ = opened
    page = Operator(browser, base, viewport={"width": size[0], "height": size[1]})
    view = page.view
    page.until("window.aerobalance.load !== null")
    view.fill("#record-name", f"sight-{size[0]}")
    view.click("#record")
    page.until("window.aerobalance.record === 'recording'")
    view.click("#control-touch")
    page.until("window.aerobalance.alarms.length > 0")
    for part in (0, 0.5, 1):
        view.evaluate(f"scrollTo({{top: {part} * document.body.scrollHeight, behavior: 'instant'}})")
        for item in ("#record-state", "#stop-now", "#alarm-state", "#acknowledge", "#source-state"):
            assert in_sight(view, item), (part, item)
        assert view.evaluate("document.documentElement.scrollWidth <= innerWidth")
    view.click("#stop-now")
    view.click("#acknowledge")
    view.click("#control-release")
    page.until("window.aerobalance.record === 'ended' && window.aerobalance.alarms.length === 0")
    assert page.said == []
    view.close()


def test_six_components_are_all_in_sight_with_record_and_stop(opened) -> None:
    browser, base, _ = opened
    page = Operator(browser, base, viewport={"width": 1440, "height": 900})
    page.rig("six")
    page.until("document.querySelectorAll('#numbers .row-card').length === 6")
    page.until("[...document.querySelectorAll('#numbers .row-card .felt')].every((i) => /[0-9]/.test(i.textContent))")
    # what earlier tests have left to be dismissed takes room above
    page.view.evaluate("document.querySelectorAll('#messages button').forEach((item) => item.click())")
    page.view.evaluate("scrollTo({ top: 0, behavior: 'instant' })")
    bottoms = page.view.evaluate(
        """() => ["#numbers .row-card:last-child", "#record", "#stop"].map((selector) =>
          document.querySelector(selector).getBoundingClientRect().bottom)"""
    )
    assert max(bottoms) <= 900
    page.rig("cable_cut")
    assert page.said == []
    page.view.close()


def test_what_was_before_is_looked_into(operator) -> None:
    view = operator.view
    operator.until("window.aerobalance.updates > 0")
    time.sleep(4.0)
    box = view.locator("#main-chart").bounding_box()
    at = lambda part: (box["x"] + 62 + part * (box["width"] - 70), box["y"] + 100)  # noqa: E731
    view.mouse.move(*at(0.5))
    operator.until("window.aerobalance.cursor?.felt")
    assert operator.number("cursor.back") == pytest.approx(5.0, abs=0.1)
    assert "balance load −10" in view.inner_text("#cursor-line")
    # a drag shows that part of the window, and holds it
    view.mouse.down()
    view.mouse.move(*at(0.7), steps=4)
    view.mouse.up()
    assert view.inner_text("#pause") == "Go on"
    first = view.inner_text("#look-line")
    assert first.startswith("Paused at ")
    view.mouse.move(*at(0.5))
    operator.until("window.aerobalance.cursor?.felt")
    held = operator.number("cursor")
    assert held["back"] == pytest.approx(4.0, abs=0.1)
    time.sleep(1.5)
    view.mouse.move(*at(0.5))
    assert operator.number("cursor") == held  # what comes later does not move it
    view.click("#earlier")
    assert view.inner_text("#look-line") != first
    view.click("#wider")
    view.mouse.move(*at(0.5))
    view.mouse.wheel(0, 300)  # scrolls the page
    view.keyboard.down("Control")
    view.mouse.wheel(0, -300)
    view.keyboard.up("Control")
    view.click("#pause")
    assert view.inner_text("#pause") == "Pause" and view.is_hidden("#look-line")
    assert operator.said == []


def test_the_chart_is_looked_into_by_keyboard(operator) -> None:
    view = operator.view
    time.sleep(2.0)
    view.focus("#main-chart")
    for key in ("ArrowLeft", "ArrowLeft", "Shift+ArrowLeft"):
        view.keyboard.press(key)
    # keys are drawn with the next frame: one, one and ten hundredths of the window of 10 s
    operator.until("window.aerobalance.cursor?.felt && Math.abs(window.aerobalance.cursor.back - 1.2) < 0.05")
    view.keyboard.press("+")
    assert view.inner_text("#pause") == "Go on"
    view.keyboard.press("PageUp")
    view.keyboard.press("Home")
    view.keyboard.press("End")
    assert view.inner_text("#pause") == "Pause"
    view.keyboard.press("Escape")
    operator.until("window.aerobalance.cursor === null")
    assert operator.said == []


def test_pause_says_when_it_was_pressed(operator) -> None:
    view = operator.view
    view.mouse.move(0, 0)  # not over a chart, which would have it drawn
    time.sleep(1.0)
    view.click("#pause")
    operator.until("document.getElementById('look-line').innerText.startsWith('Paused at ')")
    assert view.is_visible("#look-line")
    view.click("#pause")
    operator.until("document.getElementById('look-line').hidden")
    assert operator.said == []


def test_the_scale_comes_back_after_a_cut_and_can_be_locked(operator) -> None:
    view = operator.view
    view.select_option("#window", "2")
    view.click("#control-hang")
    operator.until("Math.abs(window.aerobalance.load.mean + 1020) < 50")
    view.click("#control-cut")
    operator.until("window.aerobalance.scale.high > 500")
    operator.until("window.aerobalance.scale.high < 200 && window.aerobalance.scale.low > -200")
    view.click("#lock")
    locked = operator.number("scale")
    view.click("#control-hang")
    operator.until("Math.abs(window.aerobalance.load.mean + 1020) < 50")
    assert operator.number("scale") == locked
    view.click("#lock")
    operator.until("window.aerobalance.scale.low < -1000")
    assert operator.said == []
