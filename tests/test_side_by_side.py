"""Work on several things at once: results, warnings and faults as of one after the other."""

from __future__ import annotations

import threading
import warnings

import pytest

from aerobalance.recording.errors import DataQualityWarning, warn_quality
from aerobalance.recording.side_by_side import WORKERS, Ahead, both, one_after_the_other, side_by_side

pytestmark = pytest.mark.threads


def test_results_and_warnings_are_in_order_whichever_is_done_first() -> None:
    later = threading.Event()

    def work(number: int) -> int:
        if number == 0:
            assert later.wait(30)  # the first is not done before the second has warned
        warn_quality(f"number {number}")
        later.set()
        return 10 * number

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = side_by_side(work, range(5))
    assert found == [0, 10, 20, 30, 40]
    assert [str(one.message) for one in caught] == [f"number {number}" for number in range(5)]
    assert {one.category for one in caught} == {DataQualityWarning}
    assert {one.filename for one in caught} == {__file__}
    assert WORKERS > 1


def test_one_thing_is_done_here() -> None:
    assert side_by_side(lambda _: threading.current_thread(), [0]) == [threading.current_thread()]
    assert side_by_side(lambda one: one, []) == []


def test_the_first_fault_is_raised() -> None:
    def work(number: int) -> int:
        if number:
            raise ValueError(f"number {number}")
        return number

    with pytest.raises(ValueError, match="number 1"):
        side_by_side(work, range(4))


def test_two_pieces_of_work_give_what_each_gives() -> None:
    assert both(lambda: "one", lambda: 2) == ("one", 2)


def test_of_several_processes_each_has_one_thread() -> None:
    with one_after_the_other():
        assert side_by_side(lambda _: threading.current_thread(), range(3)) == [threading.current_thread()] * 3
    assert threading.current_thread() not in side_by_side(lambda _: threading.current_thread(), range(3))


def test_work_begun_ahead_gives_and_warns_of_the_same_when_it_is_wanted() -> None:
    done: dict[int, threading.Thread] = {}

    def work(number: int) -> int:
        done[number] = threading.current_thread()
        warn_quality(f"number {number}")
        if number == 3:
            raise ValueError("number 3")
        return 10 * number

    with warnings.catch_warnings(record=True) as caught, Ahead(work, range(4)) as ahead:
        warnings.simplefilter("always")
        found = []
        for place in range(3):
            found.append(ahead.result(place))
            assert [str(one.message) for one in caught] == [f"number {number}" for number in range(place + 1)]
            ahead.begin(place + 1)
        with pytest.raises(ValueError, match="number 3"):
            ahead.result(3)
        ahead.begin(4)  # there is none
    assert found == [0, 10, 20]
    assert done[0] is threading.current_thread()
    assert threading.current_thread() not in (done[1], done[2], done[3])


def test_what_was_begun_ahead_and_is_not_wanted_is_left() -> None:
    with Ahead(lambda number: 10 * number, range(4)) as ahead:
        ahead.begin(1)
        assert ahead.result(2) == 20
        assert ahead.result(1) == 10


def test_nothing_is_begun_ahead_where_others_have_the_processors() -> None:
    with one_after_the_other(), Ahead(lambda _: threading.current_thread(), range(3)) as ahead:
        ahead.begin(1)
        assert ahead.result(1) is threading.current_thread()
