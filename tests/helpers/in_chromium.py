"""The page of the program, opened in Chromium."""

import contextlib
import signal
import subprocess
import sys
import time
from pathlib import Path

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
PROGRAM = """
from pathlib import Path
from aerobalance.app.monitor.command import Reach, monitor
monitor(folder=Path({folder!r}), reach=Reach(port=0), browser=False, say=lambda text: print(text, flush=True))
"""


LOADED = (
    "() => document.readyState === 'complete' || new Promise((done) => addEventListener('load', () => done(true)))"
)
"""Waits in a page until all of it is there."""


class Operator:
    """A page of the program, in a browser."""

    def __init__(self, browser, base, **how) -> None:
        self.view = browser.new_page(**({"viewport": {"width": 1440, "height": 1000}} | how))
        self.said, self.asked, self.base = [], [], base
        self.view.set_default_timeout(120_000)  # as long as the machine of a test may be busy with others
        self.view.on("console", lambda message: self.said.append(message.text))
        self.view.on("pageerror", lambda error: self.said.append(str(error)))
        self.view.on("request", lambda request: self.asked.append(request.url))
        self.view.goto(base)

    def until(self, expression, timeout=120.0):
        """Wait for something to hold; the page's policy keeps Playwright's own way of waiting out."""
        limit = time.monotonic() + timeout
        while time.monotonic() < limit:
            found = self.view.evaluate(expression)
            if found:
                return found
            time.sleep(0.1)
        messages = self.view.inner_text("#messages")
        raise AssertionError(f"not within {timeout} s: {expression}; messages: {messages}; console: {self.said}")

    def number(self, expression):
        return self.view.evaluate(f"window.aerobalance.{expression}")

    def report(self, text):
        """Wait for a report whose name ends so, and return its words."""
        self.until(f"document.getElementById('result-title').textContent.includes({text!r})", 300.0)
        frame = self.view.frame_locator("#report")
        # on a busy machine the words above are there before those below
        frame.locator("h1").evaluate(LOADED)
        return frame.locator("main").inner_text()

    def rig(self, name):
        """Choose a simulated rig, and wait until its readings are shown."""
        begun = self.view.evaluate("fetch('/api/state').then((a) => a.json()).then((s) => s.source.number)")
        self.view.select_option("#rig", name)
        self.until(f"fetch('/api/state').then((a) => a.json()).then((s) => s.source.number > {begun})")
        self.until("window.aerobalance.source === 'running' && window.aerobalance.load !== null")

    def open_setup(self):
        self.view.click("#open-setup")
        self.view.wait_for_selector("#setup[open]")

    def use_setup(self):
        """Take the set-up of the form, which has no fault."""
        self.view.click("#setup-apply")
        self.until("!document.getElementById('setup').open")

    def setup_text(self):
        return self.view.evaluate("fetch('/api/setup').then((answer) => answer.json()).then((form) => form.text)")


def in_sight(view, selector):
    """Whether the middle of an element is where a press would meet it."""
    return view.evaluate(
        """(selector) => { const item = document.querySelector(selector), box = item.getBoundingClientRect();
          const at = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
          return at !== null && (item === at || item.contains(at)); }""",
        selector,
    )


@contextlib.contextmanager
def page_in_chromium(folder, servers=None):
    """The page's program with a folder, and a browser: the browser, the address, and when the program was called.

    The process of the program is put into the list of servers, where one is given.
    """
    from playwright.sync_api import sync_playwright

    begin = time.monotonic()
    code = PROGRAM.format(folder=str(folder))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        if servers is not None:
            servers.append(process)
        try:
            base = process.stdout.readline().split()[4].rstrip(";")
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
                yield browser, base, begin
                if process.poll() is None:
                    process.send_signal(signal.SIGTERM)
                assert process.wait(60) == 0  # with the browser's viewers connected
                browser.close()
        finally:
            process.kill()
