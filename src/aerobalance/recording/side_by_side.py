"""Work on several things side by side, with the results and warnings of work on one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final, TypeVar, cast

from aerobalance.recording.errors import kept_warnings, warn_quality
from aerobalance.recording.progress import PROGRESS

WORKERS: Final = 2
"""Threads. Most of the work is in arrays, where Python's interpreter does not stand in the way of another thread; more
than two would wait for it, and each takes room for what it works on."""

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

    def done(one: Given) -> tuple[Result, list[str]]:
        with kept_warnings() as said, one_after_the_other():  # all threads are at work
            return work(one), said

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
