"""The processes behind the page, as the server sees them."""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import send_handle
from typing import TYPE_CHECKING, Any, Final

from aerobalance.acquisition.processes import load_beforehand, pipe, start_worker
from aerobalance.app.monitor.jobs import Task, TaskOutcome
from aerobalance.app.monitor.messages import Answer, Learner, LearnerWanted, Trouble

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    Pipe = Connection[Any, Any]


_ENDED: Final = "it was ended before it was done"

# the compiler is loaded by the first loop that is called, which would be in each of them
load_beforehand("numba", *(f"aerobalance.app.monitor.{name}" for name in ("engine", "learner", "jobs")))


def _engine(control: Pipe) -> None:
    from aerobalance.app.monitor.engine import run_engine  # noqa: PLC0415 - the server needs none of it

    run_engine(control)


def _learner(pipe: Pipe) -> None:
    from aerobalance.app.monitor.learner import run_learner  # noqa: PLC0415 - the server needs none of it

    run_learner(pipe)


def _jobs(pipe: Pipe) -> None:
    from aerobalance.app.monitor.jobs import run_jobs  # noqa: PLC0415 - the server needs none of it

    run_jobs(pipe)


class EngineProcesses:
    """The engine and its learner; whichever is gone is started again.

    Parameters
    ----------
    heard
        Takes the engine's answers, in a thread of their own.
    """

    def __init__(self, heard: Callable[[Answer], None]) -> None:
        self._heard = heard
        self._closed = False
        self._last: Any = None
        self._sending = threading.Lock()
        self.learner: BaseProcess | None = None
        self._start()

    def _start(self) -> None:
        self._control, other = pipe()
        self.process = start_worker(_engine, other)
        other.close()
        threading.Thread(target=self._listen, args=(self._control,), daemon=True).start()

    def _listen(self, control: Pipe) -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                answer = control.recv()
                if isinstance(answer, LearnerWanted):
                    self._teach(answer)
                else:
                    self._heard(answer)
        if not self._closed:
            self._heard(Trouble(-1, "the process behind the charts is gone (killed, or crashed); it is started again"))
            if self.learner is not None:
                self.learner.kill()
            self._start()
            if self._last is not None:
                self.order(self._last)

    def _teach(self, wanted: LearnerWanted) -> None:
        """Start a learner, and hand one end of the pipe to it over to the engine."""
        if wanted.gone:
            text = "the process that learns what the force is taken for is gone (killed, or crashed)"
            self._heard(Trouble(-1, f"{text}; it is started again, and the force goes on meanwhile"))
        lessons, taught = pipe()
        self.learner = start_worker(_learner, taught)
        taught.close()
        with self._sending, contextlib.suppress(OSError):
            self._control.send(Learner())
            send_handle(self._control, lessons.fileno(), self.process.pid)
        lessons.close()

    def order(self, order: object) -> None:
        """Tell the engine what to do."""
        with self._sending, contextlib.suppress(OSError):
            self._control.send(order)

    def remember(self, order: object) -> None:
        """Keep an order for an engine that is started again."""
        self._last = order

    @property
    def processes(self) -> tuple[BaseProcess, ...]:
        """The engine and the learner."""
        return (self.process,) if self.learner is None else (self.process, self.learner)

    def close(self) -> None:
        """End the processes; they keep nothing that could be lost."""
        self._closed = True
        for process in self.processes:
            process.kill()


class Jobs:
    """Tasks in a process of its own, which is started when there is one.

    Parameters
    ----------
    heard
        Takes a word on a task that has begun or ended, in a thread of its own.
    """

    def __init__(self, heard: Callable[[Task, TaskOutcome | None], None]) -> None:
        self._heard = heard
        self._numbers = itertools.count(1)
        self._waiting: deque[Task] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self.process: BaseProcess | None = None
        self._pipe: Pipe | None = None
        threading.Thread(target=self._run, daemon=True).start()

    def add(self, verb: str, recordings: Sequence[str], settings: Mapping[str, str]) -> Task:
        """Add a task.

        Raises
        ------
        ValueError
            Too many wait already.
        """
        with self._changed:
            if len(self._waiting) >= 8:
                raise ValueError("eight tasks wait already; let them end first")
            task = Task(next(self._numbers), verb, tuple(recordings), settings)
            self._waiting.append(task)
            self._changed.notify_all()
        return task

    def cancel(self) -> None:
        """End what is under way, and give up what waits."""
        with self._changed:
            given_up = [*self._waiting]
            self._waiting.clear()
        for task in given_up:
            self._heard(task, TaskOutcome(task.number, False, _ENDED))
        if self.process is not None:
            self.process.kill()

    def _run(self) -> None:
        while not self._closed:
            with self._changed:
                while not self._waiting and not self._closed:
                    self._changed.wait(1.0)
                if self._closed:
                    return
                task = self._waiting.popleft()
            self._heard(task, None)
            self._heard(task, self._do(task))

    def _do(self, task: Task) -> TaskOutcome:
        try:
            pipe = self._ready()
            pipe.send(task)
            outcome: TaskOutcome = pipe.recv()
        except (EOFError, OSError):
            self.process = None
            return TaskOutcome(task.number, False, _ENDED)
        return outcome

    def _ready(self) -> Pipe:
        if self._pipe is None or self.process is None or not self.process.is_alive():
            self._pipe, other = pipe()
            self.process = start_worker(_jobs, other)
            other.close()
        return self._pipe

    def close(self) -> None:
        """End the process."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self.process is not None:
            self.process.kill()
