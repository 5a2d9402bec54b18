"""The checks before a run: shunt, and return to zero with the contact circuit; steps, results and notes."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Literal

import numpy as np

from aerobalance.acquisition.pretest_checks import Change, Checked, check_return, check_shunt, mean_change
from aerobalance.acquisition.setup import stored_channels
from aerobalance.app.monitor.live_source import LiveSource
from aerobalance.app.monitor.log import Log
from aerobalance.app.monitor.messages import Means, TakeMeans
from aerobalance.app.monitor.records import Records
from aerobalance.recording.components import COMPONENTS, is_gauge, si_unit
from aerobalance.recording.errors import FitError, ReadError
from aerobalance.recording.units import conversion_for

Kind = Literal["shunt", "return"]

SETTLED: Final = 0.3
"""Time from the switching of a shunt, or the press of a button, until readings count [s]."""

PATIENCE: Final = 30.0
"""Time that the means of the readings are waited for [s]."""

LEAST: Final = 4
"""Spans that a mean needs."""

_NAMES: Final[Mapping[Kind, str]] = {"shunt": "shunt check", "return": "return to zero"}
_NEXT: Final[Mapping[Kind, str]] = {
    "shunt": "Switch the shunt on, wait until the readings stand, then press again.",
    "return": "Push the model by hand and let it go. When it is at rest, press again.",
}
_MARKS: Final = {"passed": "passed", "failed": "FAILED", "undecided": "not decided, the readings are too noisy"}


class Checks:
    """The check that is under way, and what the checks of this source have found.

    Parameters
    ----------
    source
        What is checked.
    records
        Where results are noted.
    log
        What the operator is told.
    """

    def __init__(self, source: LiveSource, records: Records, log: Log) -> None:
        self._source, self._records, self._log = source, records, log
        self._answers: queue.SimpleQueue[Means] = queue.SimpleQueue()
        self._switchings: queue.SimpleQueue[float] = queue.SimpleQueue()
        self._before: tuple[Kind, int, dict[str, tuple[float, ...]]] | None = None
        self._contacts = 0
        self.busy = False
        self.shown: dict[str, Any] = {}

    def forget(self) -> None:
        """Begin anew: another source has been opened."""
        self._before, self.shown = None, {}

    def heard(self, means: Means) -> None:
        """Take the means that were asked for."""
        self._answers.put(means)

    def done(self, text: str) -> None:
        """Take note of what the source has done."""
        if text.startswith("shunt "):
            self._switchings.put(time.monotonic())

    def watch(self, remarks: Sequence[tuple[int, str, str]]) -> None:
        """Count the contacts between model and support."""
        self._contacts += sum(kind == "contact" for _, kind, _ in remarks)

    def press(self, kind: Kind) -> None:
        """Begin the next step of a check: the readings before, or those after; both where the source can switch.

        Raises
        ------
        ValueError
            It cannot be done now; the message says why.
        """
        session = self._source.running()
        if self.busy:
            raise ValueError("a check is under way already")
        if kind == "shunt" and not self._source.setup.shunt:
            raise ValueError("the set-up does not say what the shunt should change: fill in its table Shunt")
        switches = kind == "shunt" and "shunt" in session.info.controls
        self._show(kind, "the readings are taken", busy=True)
        threading.Thread(
            target=self._run, args=(kind, self._switched if switches else self._by_hand), daemon=True
        ).start()

    def give_up(self) -> None:
        """Leave a check that waits for its second step."""
        self._before, self.shown = None, {}
        self._log.changed()

    def _run(self, kind: Kind, steps: Callable[[Kind], None]) -> None:
        try:
            steps(kind)
        except (FitError, ReadError, ValueError) as problem:
            self._before = None
            self._show(kind, f"ended early: {problem}")
            self._log.say(f"{_NAMES[kind]}: {problem}", kind="error")

    def _by_hand(self, kind: Kind) -> None:
        number = self._source.state.number
        if self._before is None or self._before[:2] != (kind, number):
            self._contacts = 0
            self._before = (kind, number, self._means())
            self._show(kind, _NEXT[kind], waiting=True)
        else:
            before, self._before = self._before[2], None
            self._judge(kind, before, self._means())

    def _switched(self, kind: Kind) -> None:
        """Check by a source that switches its shunt itself."""
        while not self._switchings.empty():
            self._switchings.get_nowait()
        before = self._means()
        self._source.control("shunt", 1.0)
        try:
            after = self._means(self._switched_at())
        finally:
            self._source.control("shunt", 0.0)
        self._judge(kind, before, after)

    def _switched_at(self) -> float:
        """Wait until the source has switched the shunt; return when that was, on the steady clock [s]."""
        try:
            return self._switchings.get(timeout=PATIENCE)
        except queue.Empty:
            raise ValueError("the source does not switch its shunt") from None

    def _means(self, since: float | None = None) -> dict[str, tuple[float, ...]]:
        """Means over a second of readings that came after something; else from now on. A slow page lags behind."""
        since = SETTLED + (time.monotonic() if since is None else since)
        limit = time.monotonic() + PATIENCE
        while time.monotonic() < limit:
            self._source.engine.order(TakeMeans())
            with contextlib.suppress(queue.Empty):
                found = self._answers.get(timeout=1.0)
                if found.since >= since and min(map(len, found.spans.values()), default=0) >= LEAST:
                    return dict(found.spans)
            time.sleep(0.1)
        raise ValueError("there are no readings to check; wait until the charts run")

    def _judge(
        self, kind: Kind, before: Mapping[str, tuple[float, ...]], after: Mapping[str, tuple[float, ...]]
    ) -> None:
        changes = {
            name: mean_change(np.array(before[name]), np.array(after[name]))
            for name in before
            if np.isfinite(before[name]).sum() > 1 and np.isfinite(after.get(name, ())).sum() > 1
        }
        rows = self._shunts(changes) if kind == "shunt" else self._returns(changes)
        if not rows:
            raise ValueError("none of the channels read now can be checked; see Shunt and half ranges in the set-up")
        worst = next((one for one in ("failed", "undecided") if any(row["verdict"] == one for row in rows)), "passed")
        text = f"{_NAMES[kind]} {_MARKS[worst]}"
        if kind == "return" and self._source.setup.fouling.channel is not None:
            touched = f"closed {self._contacts} time(s)" if self._contacts else "did not close"
            text += f"; the contact circuit {touched} meanwhile"
        self._records.note(text)
        for row in rows:
            note = f"{_NAMES[kind]} {row['verdict']}: {_words(row)}"
            self._records.opening_notes.append(note)
            self._records.note(note, shown=False)
        # shown after it is noted: who stops the record as soon as the result is there has the notes in it
        self._show(kind, text, rows=rows, verdict=worst)
        bad = [_words(row) for row in rows if row["verdict"] != "passed"]
        self._log.say("; ".join([text, *bad]), kind="error" if bad else "done")

    def _shunts(self, changes: Mapping[str, Change]) -> list[dict[str, Any]]:
        setup, rows = self._source.setup, []
        units = {item.name: item.unit for item in stored_channels(setup, self._source.running().info.channels)}
        for name, shunt in setup.shunt.items():
            unit = units.get(name, si_unit(name) if name in COMPONENTS else "")
            if name not in changes:
                rows.append(_unread(name, unit))
                continue
            conversion = conversion_for(name, unit)
            if shunt.output is not None and conversion.unit != "mV/V":
                raise ValueError(f"shunt.{name}: a resistance makes a change in mV/V, but the channel is in {unit}")
            # of a scale: a change has no offset
            expected = shunt.output if shunt.change is None else shunt.change * conversion.factor
            checked = check_shunt(
                name,
                changes[name],
                expected=expected or 0.0,
                relative_uncertainty=shunt.uncertainty,
                tolerance=shunt.tolerance,
            )
            rows.append(_row(checked, conversion.unit))
        return rows

    def _returns(self, changes: Mapping[str, Change]) -> list[dict[str, Any]]:
        watching, rows = self._source.watching, []
        if watching is None:
            return []
        tolerance = self._source.setup.fouling.tolerance
        for name in watching.names:
            half_range = watching.half_ranges.get(name)
            if half_range is None or not (name in COMPONENTS or is_gauge(name)):
                continue
            unit, change = "mV/V" if is_gauge(name) else si_unit(name), changes.get(name)
            if change is None:
                rows.append(_unread(name, unit))
            else:
                rows.append(_row(check_return(name, change, half_range=half_range, tolerance=tolerance), unit))
        return rows

    def _show(self, kind: Kind, text: str, *, busy: bool = False, **more: Any) -> None:
        self.busy = busy
        self.shown = {"kind": kind, "text": text, "busy": busy, "waiting": False, "rows": [], **more}
        self._log.changed()


def _row(checked: Checked, unit: str) -> dict[str, Any]:
    return {
        "channel": checked.channel,
        "unit": unit,
        "change": checked.change,
        "expected": checked.expected,
        "tolerance": checked.tolerance,
        "expanded": checked.expanded,
        "verdict": checked.verdict,
    }


def _unread(channel: str, unit: str) -> dict[str, Any]:
    """Row of a channel without readings, which does not pass: a dead bridge is what a check is for."""
    nothing = dict.fromkeys(("change", "expected", "tolerance", "expanded"))
    return {"channel": channel, "unit": unit, **nothing, "verdict": "failed"}


def _between(middle: float, half: float) -> str:
    return f"{middle - half:.5g} to {middle + half:.5g}"


def _words(row: Mapping[str, Any]) -> str:
    if row["change"] is None:
        return f"{row['channel']} has no readings"
    return (
        f"{row['channel']} changed by {row['change']:.5g} {row['unit']} "
        f"({_between(row['change'], row['expanded'])} with 95 %), "
        f"allowed is {_between(row['expected'], row['tolerance'])}"
    )
