"""Blocks: packed and unpacked, and put in their places where the count of a device began anew."""

import threading
import time
from multiprocessing import Pipe
from types import SimpleNamespace

import numpy as np
import pytest

from aerobalance.acquisition import feed
from aerobalance.acquisition.continuity import Continuity
from aerobalance.acquisition.feed import Address, Feed, _Outlet, _SourceServer
from aerobalance.acquisition.source import Block, SourceChannel


def block_at(tick, received, *, rows=10, remark="", anew=False):
    return Block(tick, np.full((rows, 2), float(tick)), received, remark, anew)


def test_a_block_is_unpacked_as_it_was_packed() -> None:
    for given in (block_at(2**52, 1.5, remark="überlaufen", anew=True), block_at(-3, 0.0, rows=0)):
        found = Block.from_bytes(given.to_bytes())
        assert (found.tick, found.received, found.remark, found.anew) == (
            given.tick,
            given.received,
            given.remark,
            given.anew,
        )
        assert np.array_equal(found.samples, given.samples)


def test_a_count_that_began_anew_is_no_gap_by_its_ticks() -> None:
    # at 100 Hz: ten samples received at 10 s, the next ten at 12 s, so that 190 are missing between
    for tick in (0, 5, 12, 10_000):
        continuity = Continuity(100.0)
        assert continuity.follow(block_at(0, 10.0)).gap is None
        found = continuity.follow(block_at(tick, 12.0, remark="begun anew", anew=True))
        assert (found.gap.tick, found.gap.samples, found.gap.kind) == (10, 190, "restart")
        assert "computer's clock" in found.gap.text
        assert found.block.tick == 200
        # and from there on the ticks count again
        later = continuity.follow(block_at(tick + 15, 12.15))
        assert (later.gap.tick, later.gap.samples, later.gap.kind) == (210, 5, "gap")


def test_the_first_block_of_a_record_may_be_the_first_of_a_new_count() -> None:
    found = Continuity(100.0).follow(block_at(70, 12.0, anew=True))
    assert found.gap is None
    assert found.block.tick == 70


def test_a_receiver_that_missed_the_new_count_is_told_later(monkeypatch) -> None:
    receiving, sending = Pipe(duplex=False)
    outlet = _Outlet(sending, viewer=True)
    monkeypatch.setattr(outlet.sender, "offer", lambda message, *, wait: False)
    outlet.give(block_at(0, 1.0, anew=True), patient=False)
    outlet.give(block_at(10, 1.1), patient=False)
    monkeypatch.undo()
    outlet.give(block_at(20, 1.2), patient=False)
    outlet.give(block_at(30, 1.3), patient=False)
    told, after = (Block.from_bytes(receiving.recv_bytes()[1:]) for _ in range(2))
    outlet.sender.finish(1.0)
    assert (told.tick, told.anew) == (20, True)
    assert "2 block(s) lost" in told.remark
    assert (after.tick, after.anew) == (30, False)


@pytest.fixture
def server(tmp_path):
    channels = (SourceChannel("AF", "N"), SourceChannel("NF", "N"))
    source = SimpleNamespace(channels=channels, rate=100.0, clocked=True, patient=True, description="", controls=())
    made = _SourceServer(source, Address(str(tmp_path / "socket"), b"key"))
    yield made
    made.finish("over", hurry=True)


def test_a_block_larger_than_what_is_kept_of_the_last_seconds_is_given(server, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(feed, "RECENT_BYTES", 100)
    with_recent = Feed(Address(str(tmp_path / "socket"), b"key"), viewer=False, recent=True)
    while not server.outlets:
        time.sleep(0.001)
    for tick in (0, 10):
        server.give(block_at(tick, 1.0), print)
        assert with_recent.take().tick == tick
    with_recent.close()


def test_a_receiver_that_comes_while_another_goes_is_not_forgotten(server) -> None:
    """It comes at the very moment at which the receivers without the one that is gone are listed."""
    given: list[int] = []
    new = SimpleNamespace(
        give=lambda block, *, patient: given.append(block.tick), sender=SimpleNamespace(broken=False)
    )
    arrival = threading.Thread(target=server._add, args=(new,), kwargs={"recent": False})

    class Listed(list):
        def __iter__(self):
            if arrival.ident is None:
                arrival.start()
                arrival.join(0.2)
            return super().__iter__()

    def give(block, *, patient):
        server.outlets = Listed(server.outlets)

    server.outlets = [SimpleNamespace(viewer=True, give=give, sender=SimpleNamespace(broken=True))]
    server.give(block_at(0, 1.0), lambda _: None)
    arrival.join()
    server.give(block_at(10, 1.1), lambda _: None)
    server.outlets = []
    assert given == [10]
