"""The process behind the page: it takes the blocks of a source, computes the live forces, and sends what is shown.

It talks to three others: the server, which gives orders and gets every answer (`messages`); the process of the source,
which sends blocks; and a learner, a process that fits spectral priors and noise in the background, so that the charts
do not wait for it.
"""

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
from aerobalance.estimation.live.live_force import LiveForce
from aerobalance.estimation.live.settings import LiveSettings
from aerobalance.recording.errors import FitError, ReadError
from aerobalance.simulation.published import CABLE_CUT

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    Pipe = Connection[Any, Any]

PERIOD: Final = 0.035
"""Time from one update to the next [s]."""

_TICK: Final = 0.25
"""Longest wait for an order or a block [s]."""

_AT_ONCE: Final = 128
"""Blocks that are taken at most before an update is sent."""

_RETRY: Final = 5.0
"""Time between two requests for a learner [s]."""


class _Engine:
    """Follows one source after the other.

    Parameters
    ----------
    control
        Pipe to the server.
    """

    def __init__(self, control: Pipe) -> None:
        self._control = control
        self._learner: Pipe | None = None
        self._learner_requested = -math.inf  # when, on the steady clock [s]
        self._learner_lost = False
        self._feed: Feed | None = None
        self._view: View | None = None
        self._number = 0
        self._pending: tuple[int, str] | None = None  # source and force that the learner works on
        self._updated = 0.0  # when the last blocks were taken, on the steady clock [s]

    def run(self) -> None:
        """Work until the server is gone (`EOFError`): obey orders at once, and take blocks once every `PERIOD`.

        Until the period is over the connection to the source is not among the pipes waited for, so that many small
        blocks are taken together.
        """
        while True:
            pipes = [pipe for pipe in (self._control, self._learner) if pipe is not None]
            if self._feed is None:
                ready = wait(pipes, _TICK)
            else:
                left = self._updated + PERIOD - time.monotonic()
                ready = wait(pipes, left) if left > 0 else wait([*pipes, self._feed.connection], _TICK)
            if self._control in ready:
                self._obey(self._control.recv())
            if self._learner is not None and self._learner in ready:
                self._adopt(self._learner)
            if self._feed is not None and self._feed.connection in ready:
                self._updated = time.monotonic()
                self._follow(self._feed)

    def _obey(self, order: object) -> None:
        """Do what the server orders; an order about a source is passed over where none is followed."""
        if isinstance(order, FollowSource):
            self._watch(order)
        elif isinstance(order, Learner):
            self._learner, self._pending = type(self._control)(recv_handle(self._control)), None
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
        """Leave the source that is followed and follow another; tell the server what is watched, or why it is not."""
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
        """Close the connection to the source, if there is one."""
        if self._feed is not None:
            self._feed.close()
        self._feed = self._view = None

    def _follow(self, feed: Feed) -> None:
        """Take the blocks that have come, work them in, and send an update; leave a source that has ended."""
        blocks: list[Block] = []
        ended = ""
        while len(blocks) < _AT_ONCE:
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
        self._send_update()
        self._give_to_learn()
        if ended:
            self._leave()
            self._control.send(Trouble(self._number, f"the source ended: {ended}"))

    def _send_update(self) -> None:
        """Send what is new since the last update, if there is anything."""
        if self._view is None:
            return
        update = self._view.take()
        if update.raw:
            self._control.send(News(self._number, update, dict(self._view.saturated)))
            if self._learner is None:  # not before: the first seconds belong to the charts
                self._request_learner()

    def _request_learner(self) -> None:
        """Ask the server for a learner; for another one not too soon, as what ended the first may end it too."""
        if time.monotonic() - self._learner_requested > _RETRY:
            self._learner_requested = time.monotonic()
            self._control.send(LearnerWanted(self._learner_lost))

    def _leave_learner(self) -> None:
        """Close the pipe to a learner that is gone, and ask for another.

        The force goes on with the spectra that it has; what the learner was asked is asked again when it is due.
        """
        if self._learner is not None:
            self._learner.close()
        self._learner, self._pending, self._learner_lost = None, None, True
        self._request_learner()

    def _give_to_learn(self) -> None:
        """Send the learner the first record that is due, one at a time."""
        if self._pending is not None or self._view is None or self._learner is None:
            return
        for name, live in self._view.lines.items():
            snapshot = live.due()
            if snapshot is not None:
                self._pending = (self._number, name)
                try:
                    self._learner.send((self._pending, snapshot))
                except OSError:
                    self._leave_learner()
                return

    def _adopt(self, learner: Pipe) -> None:
        """Take what the learner has found into the force that it is for, unless another source is followed by now."""
        try:
            (number, name), learning = learner.recv()
        except (EOFError, OSError):
            self._leave_learner()
            return
        self._pending = None
        if learning is not None and number == self._number and self._view is not None:
            with contextlib.suppress(ValueError):  # a force that has just begun anew has nothing to apply it to
                self._view.lines[name].adopt(learning)


def joined(blocks: Sequence[Block]) -> list[Block]:
    """Return the blocks with those merged that follow each other without a gap: one large block is computed faster.

    A block with a remark begins a new one, as its remark belongs to its first tick.
    """
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
    """Load the compiled loops before there is a source; on the first run of all they are compiled, which takes long.

    Without this the first seconds of a source would be shown late.
    """
    live = LiveForce(CABLE_CUT.dynamics, rate=CABLE_CUT.rate.value, settings=LiveSettings(learn_inside=False))
    noise = np.random.default_rng(0).standard_normal(600)
    live.push({"AF": noise, "ground_acceleration": noise, "pitch": np.zeros(600)})


def run_engine(control: Pipe) -> None:
    """Follow sources as the server orders, until the server is gone: the body of a process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which ends this process
    end_with_starter()
    warm_up()
    with contextlib.suppress(EOFError, OSError):
        _Engine(control).run()
