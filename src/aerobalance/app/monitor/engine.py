"""The process that follows the source and works out what is shown."""

from __future__ import annotations

import contextlib
import math
import signal
import time
from collections.abc import Sequence
from dataclasses import replace
from multiprocessing.connection import wait
from multiprocessing.reduction import recv_handle
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from aerobalance.acquisition.feed import Feed
from aerobalance.acquisition.setup import parse_setup
from aerobalance.acquisition.source import Block
from aerobalance.app.monitor.messages import (
    FollowSource,
    Learner,
    LearnerWanted,
    Means,
    News,
    SetZeros,
    TakeMeans,
    TakeZeros,
    Trouble,
    Watching,
    Zeros,
)
from aerobalance.app.monitor.orphan import end_with_starter
from aerobalance.app.monitor.panels import panel_of
from aerobalance.app.monitor.view import View
from aerobalance.estimation.live.live_force import LiveForce, LiveSettings
from aerobalance.recording.errors import FitError, ReadError
from aerobalance.simulation.published import CABLE_CUT

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    Pipe = Connection[Any, Any]

PERIOD: Final = 0.035
"""Time from one update to the next [s]."""

_TICK: Final = 0.25
_AT_ONCE: Final = 128
_AGAIN: Final = 5.0


class _Engine:
    """Follows one source after the other."""

    def __init__(self, control: Pipe) -> None:
        self._control = control
        self._learner: Pipe | None = None
        self._wanted = -math.inf
        self._lost = False
        self._feed: Feed | None = None
        self._view: View | None = None
        self._number = 0
        self._asked: tuple[int, str] | None = None
        self._turn = 0.0

    def run(self) -> None:
        """Work until the server is gone: at each turn, take all that has come since the last one."""
        while True:
            pipes = [pipe for pipe in (self._control, self._learner) if pipe is not None]
            if self._feed is None:
                ready = wait(pipes, _TICK)
            else:
                left = self._turn + PERIOD - time.monotonic()
                ready = wait(pipes, left) if left > 0 else wait([*pipes, self._feed.connection], _TICK)
            if self._control in ready:
                self._obey(self._control.recv())
            if self._learner is not None and self._learner in ready:
                self._adopt(self._learner)
            if self._feed is not None and self._feed.connection in ready:
                self._turn = time.monotonic()
                self._follow(self._feed)

    def _obey(self, order: object) -> None:
        if isinstance(order, FollowSource):
            self._watch(order)
        elif isinstance(order, Learner):
            self._learner, self._asked = type(self._control)(recv_handle(self._control)), None
        elif isinstance(order, SetZeros) and self._view is not None:
            self._view.set_zeros(order.zeros)
        elif isinstance(order, TakeMeans) and self._view is not None:
            spans = zip(self._view.panel.names, map(tuple, self._view.means.T.tolist()), strict=True)
            self._control.send(Means(dict(spans), self._view.means_since))
        elif isinstance(order, TakeZeros) and self._view is not None:
            try:
                self._control.send(Zeros(self._view.zeros()))
            except ValueError as problem:
                self._control.send(Trouble(self._number, str(problem)))

    def _watch(self, order: FollowSource) -> None:
        self._leave()
        self._number = order.number
        try:
            self._feed = Feed(order.address, viewer=True)
            setup = parse_setup(order.setup)
            panel = panel_of(setup, self._feed.info, Path(order.folder), order.zeros)
            self._view = View(panel)
        except (FitError, ReadError, ValueError, OSError, EOFError) as problem:
            self._leave()
            self._control.send(Trouble(order.number, f"the source cannot be watched: {problem or 'it is gone'}"))
            return
        self._control.send(
            Watching(
                number=order.number,
                names=panel.names,
                units=panel.units,
                rate=panel.rate,
                width=self._view.width,
                components=panel.components,
                half_ranges=dict(panel.half_ranges),
                limits=dict(panel.limits),
                masses=panel.masses,
                frequencies=panel.frequencies,
            )
        )

    def _leave(self) -> None:
        if self._feed is not None:
            self._feed.close()
        self._feed = self._view = None

    def _follow(self, feed: Feed) -> None:
        blocks: list[Block] = []
        ended = ""
        while len(blocks) < _AT_ONCE and not ended:
            try:
                got = feed.take()
            except (EOFError, OSError):
                got = "the process of the source is gone without a word (killed, or crashed)"
            if isinstance(got, str):
                ended = got
                break
            blocks.append(got)
            if not feed.connection.poll():
                break
        if self._view is not None:
            for block in joined(blocks):
                self._view.feed(block)
        self._send()
        self._ask()
        if ended:
            self._leave()
            self._control.send(Trouble(self._number, f"the source ended: {ended}"))

    def _send(self) -> None:
        if self._view is None:
            return
        update = self._view.take()
        if update.raw:
            self._control.send(News(self._number, update, dict(self._view.saturated)))
            if self._learner is None:  # not before: the first seconds belong to the charts
                self._want()

    def _want(self) -> None:
        """Ask for a learner; for another one not too soon, as what ended the first may end it too."""
        if time.monotonic() - self._wanted > _AGAIN:
            self._wanted = time.monotonic()
            self._control.send(LearnerWanted(self._lost))

    def _leave_learner(self) -> None:
        """The learner is gone: the force goes on as it is, and what it was asked is asked again when it is due."""
        if self._learner is not None:
            self._learner.close()
        self._learner, self._asked, self._lost = None, None, True
        self._want()

    def _ask(self) -> None:
        """Have something learned, one thing at a time."""
        if self._asked is not None or self._view is None or self._learner is None:
            return
        for name, live in self._view.lines.items():
            snapshot = live.due()
            if snapshot is not None:
                self._asked = (self._number, name)
                try:
                    self._learner.send((self._asked, snapshot))
                except OSError:
                    self._leave_learner()
                return

    def _adopt(self, learner: Pipe) -> None:
        try:
            (number, name), learning = learner.recv()
        except (EOFError, OSError):
            self._leave_learner()
            return
        self._asked = None
        if learning is not None and number == self._number and self._view is not None:
            with contextlib.suppress(ValueError):
                self._view.lines[name].adopt(learning)


def joined(blocks: Sequence[Block]) -> list[Block]:
    """Make one block of those that follow each other without a gap or a remark: one is sooner done than many."""
    made: list[list[Block]] = []
    for block in blocks:
        if made and block.tick == made[-1][-1].end and not block.remark:
            made[-1].append(block)
        else:
            made.append([block])
    return [
        parts[0]
        if len(parts) == 1
        else replace(parts[0], samples=np.concatenate([part.samples for part in parts]), received=parts[-1].received)
        for parts in made
    ]


def warm_up() -> None:
    """Load the compiled loops before there is something to follow; the first time, they are compiled."""
    live = LiveForce(CABLE_CUT.dynamics, rate=CABLE_CUT.rate.value, settings=LiveSettings(learn_inside=False))
    noise = np.random.default_rng(0).standard_normal(600)
    live.push({"AF": noise, "ground_acceleration": noise, "pitch": np.zeros(600)})


def run_engine(control: Pipe) -> None:
    """Follow sources as told: the body of a process. It ends with the server."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_starter()
    warm_up()
    with contextlib.suppress(EOFError, OSError):
        _Engine(control).run()
