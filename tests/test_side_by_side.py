"""Work on several things at once: results, warnings and faults as of one after the other."""

from __future__ import annotations

import threading
import warnings

import pytest

from aerobalance.recording.errors import DataQualityWarning, warn_quality
from aerobalance.recording.side_by_side import WORKERS, both, one_after_the_other, side_by_side

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
