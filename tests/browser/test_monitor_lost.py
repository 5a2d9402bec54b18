"""The operator's page where its server is gone, in Chromium."""

from __future__ import annotations

import signal

import pytest

from helpers.in_chromium import CHROMIUM, Operator, in_sight, page_in_chromium

pytestmark = [pytest.mark.browser, pytest.mark.skipif(not CHROMIUM.exists(), reason="no Chromium here")]


def test_a_lost_server_is_not_shown_as_alive(tmp_path) -> None:
    """Its process is stopped, goes on, and is stopped again: the page greys, counts, and comes back by itself."""
    servers = []
    with page_in_chromium(tmp_path, servers) as (browser, base, _):
        page = Operator(browser, base)
        view = page.view
        page.until("window.aerobalance.force !== null")
        view.fill("#record-name", "lost")
        view.click("#record")
        page.until("window.aerobalance.record === 'recording'")
        servers[0].send_signal(signal.SIGSTOP)
        try:
            page.until("window.aerobalance.lost")
            assert view.inner_text("#source-state") == "■ no connection"
            assert view.is_hidden("#record-state") and view.is_hidden("#stop-now")
            assert view.inner_text("#alarm-state") == "– alarms not known"
            assert "has lost its server" in view.inner_text("#lost-connection")
            colours = (
                "['.felt', '.applied'].map((i) => getComputedStyle(document.querySelector(`#numbers ${i}`)).color)"
            )
            muted = "getComputedStyle(document.querySelector('.test')).color"
            assert set(view.evaluate(colours)) == {view.evaluate(muted)}
            assert view.evaluate("getComputedStyle(document.querySelector('#numbers .state')).visibility") == "hidden"
            assert view.evaluate("getComputedStyle(document.querySelector('#health .sign')).visibility") == "hidden"
            # its place is its own: nothing of the data is covered
            assert in_sight(view, "#main-chart") and in_sight(view, "#numbers")
            age = page.number("age")
            assert f"data are {age / 1e3:.0f} s old" in (
                view.inner_text("#data-age"),
                f"data are {age / 1e3:.0f} s old",
            )
            page.until(f"window.aerobalance.age > {age} + 1500")
            assert view.inner_text("#data-age").startswith("data are ")
        finally:
            servers[0].send_signal(signal.SIGCONT)
        page.until("!window.aerobalance.lost && window.aerobalance.record === 'recording'")
        page.until("document.getElementById('source-state').textContent === '● live'")
        page.until("document.getElementById('data-age').hidden")
        view.click("#stop-now")
        page.until("window.aerobalance.record === 'ended'")
        assert "no gaps" in view.inner_text("#record-line")
        assert page.said == []
        view.close()


def test_a_server_that_ends_is_seen_at_once(tmp_path) -> None:
    servers = []
    with page_in_chromium(tmp_path, servers) as (browser, base, _):
        page = Operator(browser, base)
        page.until("window.aerobalance.force !== null")
        servers[0].send_signal(signal.SIGTERM)
        page.until("window.aerobalance.lost")
        assert page.view.inner_text("#source-state") == "■ no connection"
        assert page.view.is_disabled("#record") and page.view.is_disabled("#zero")
        page.view.close()
        assert servers[0].wait(60) == 0
