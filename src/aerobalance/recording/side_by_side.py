"""Work on several things side by side, with the results and warnings of work on one after the other."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final, Generic, TypeVar, cast

from aerobalance.recording.errors import kept_warnings, warn_quality
from aerobalance.recording.progress import PROGRESS

WORKERS: Final = 2
"""Threads. Most of the work is in arrays, where Python's interpreter does not stand in the way of another thread; more
than two would wait for it, and each takes room for what it works on."""

HANDED_OVER: Final = 5e-4
"""Time after which a thread that works in Python lets another go on that waits for the interpreter [s]."""

_alone: ContextVar[bool] = ContextVar("alone", default=False)

First = TypeVar("First")
Second = TypeVar("Second")
Given = TypeVar("Given")
Result = TypeVar("Result")


@contextmanager
def one_after_the_other() -> Iterator[None]:
    """Let this thread work on one thing after the other: two would hand Python's interpreter over all the time.

    So it is of arrays that are soon worked on, and where other processes have the other processors.
    """
    token = _alone.set(True)
    try:
        yield
    finally:
        _alone.reset(token)


@contextmanager
def handing_over_soon() -> Iterator[None]:
    """Let threads that work side by side wait less for Python's interpreter, while many of them do for long.

    Whoever works in arrays lets go of it for each, and would wait up to 5 ms to have it back: sixty seconds of six
    components take three per cent longer by the clock so.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, HANDED_OVER))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def side_by_side(work: Callable[[Given], Result], given: Iterable[Given], *, what: str = "") -> list[Result]:
    """Return what the work makes of each of them, in their order.

    What is warned of is said afterwards in that order as well, so neither hangs on which is done first. Of faults the
    first one's is raised.

    Parameters
    ----------
    work
        What is to be done; it must not change what another works on.
    given
        What it is done to.
    what
        What each of them is, where it is worth telling how many are done.
    """
    done = _kept(work)
    every = list(given)
    if len(every) < WORKERS or _alone.get():
        return [work(one) for one in (PROGRESS.each(every, what) if what else every)]
    with ThreadPoolExecutor(WORKERS) as pool:
        waiting = [pool.submit(done, one) for one in every]
        try:
            found = [one.result() for one in (PROGRESS.each(waiting, what) if what else waiting)]
        finally:
            for one in waiting:
                one.cancel()
    for _, said in found:
        for text in said:
            warn_quality(text)
    return [result for result, _ in found]


def both(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """Return what two pieces of work give, done side by side."""
    results: dict[int, First | Second] = {}

    def work(number: int) -> None:
        results[number] = second() if number else first()

    side_by_side(work, range(2))
    return cast("First", results[0]), cast("Second", results[1])


def _kept(work: Callable[[Given], Result]) -> Callable[[Given], tuple[Result, list[str]]]:
    """The work for a thread of its own, with what is warned of as a result too."""

    def done(one: Given) -> tuple[Result, list[str]]:
        with kept_warnings() as said, one_after_the_other():  # all threads are at work
            return work(one), said

    return done


class Ahead(Generic[Given, Result]):
    """Work on things that are wanted one after the other, where the next may be begun before it is wanted.

    Parameters
    ----------
    work
        What is to be done; as in `side_by_side`.
    given
        What it is done to.
    """

    def __init__(self, work: Callable[[Given], Result], given: Sequence[Given]) -> None:
        self._work, self._given = work, given
        self._pool: ThreadPoolExecutor | None = None
        self._begun: tuple[int, Future[tuple[Result, list[str]]]] | None = None

    def __enter__(self) -> Ahead[Given, Result]:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def begin(self, place: int) -> bool:
        """Begin with the thing of that place in another thread; return whether it has begun.

        Nothing is done where there is none, or where one thread works alone.
        """
        if place >= len(self._given) or _alone.get():
            return False
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1)
        self._begun = place, self._pool.submit(_kept(self._work), self._given[place])
        return True

    def result(self, place: int) -> Result:
        """What the work makes of the thing of that place, begun or not; what it warned of is said now."""
        begun, self._begun = self._begun, None
        if begun is None or begun[0] != place:
            return self._work(self._given[place])
        result, said = begun[1].result()
        for text in said:
            warn_quality(text)
        return result
