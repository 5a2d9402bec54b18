"""From the blocks of a source to the blocks of a file, for any cut, gap, trigger and limit."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerobalance.acquisition.continuity import Continuity, Event, LostSamples
from aerobalance.acquisition.guards import Limit
from aerobalance.acquisition.intake import (
    AtLevel,
    AtOnce,
    AtTime,
    End,
    Intake,
    OnCall,
    RecordBlock,
    RecordPlan,
    RecordStart,
)
from aerobalance.acquisition.source import Block
from aerobalance.io.hdf5_layout import StoredChannel

CHANNELS = (StoredChannel("AF", "N"), StoredChannel("NF", "N", sign=-1.0, scale=2.0, offset=1.0))


def truth(ticks):
    """Readings that say which tick they belong to."""
    return np.column_stack([ticks, np.asarray(ticks) * 3.0 % 101])


def blocks(cuts, total, gaps=()):
    """The ticks from 0 to total without those in gaps, cut at the given places."""
    present = np.ones(total, dtype=bool)
    for first, last in gaps:
        present[first:last] = False
    ticks = np.flatnonzero(present)
    edges = sorted({0, ticks.size, *(cut % (ticks.size + 1) for cut in cuts)})
    for a, b in pairwise(edges):
        part = ticks[a:b]
        for run in np.split(part, np.flatnonzero(np.diff(part) > 1) + 1):
            yield Block(int(run[0]), truth(run), float(run[-1]))


def run(plan, given_blocks):
    intake = Intake(plan, clocked=False)
    out = [item for block in given_blocks for item in intake.feed(block)]
    return out + intake.flush()


def pieces(out):
    found = [item for item in out if isinstance(item, RecordBlock)]
    ticks = np.concatenate([np.arange(p.tick, p.tick + len(p.samples)) for p in found] or [np.empty(0)])
    samples = np.concatenate([p.samples for p in found] or [np.empty((0, 2))])
    return ticks, samples


cuts = st.lists(st.integers(0, 10_000), max_size=40)
gap_lists = st.lists(st.tuples(st.integers(0, 480), st.integers(1, 60)), max_size=3).map(
    lambda found: [(a, min(a + n, 499)) for a, n in found]
)


@settings(deadline=None, max_examples=200)
@given(cuts, gap_lists, st.tuples(st.integers(1, 70), st.integers(0, 400), st.integers(0, 90), st.integers(1, 300)))
def test_any_cut_and_any_trigger_time_give_the_same_samples(cut, gaps, sizes):
    rows, wait, before, length = sizes
    total = 500
    plan = RecordPlan(CHANNELS, 100.0, rows, trigger=AtTime(wait), before=before, length=length)
    out = run(plan, blocks(cut, total, gaps))
    present = np.ones(total, dtype=bool)
    for a, b in gaps:
        present[a:b] = False
    there = np.flatnonzero(present)
    # by hand: the trigger is the first sample there is at or after `wait` samples from the first
    after = there[there >= there[0] + wait]
    starts = [item.tick for item in out if isinstance(item, RecordStart)]
    if not after.size:
        assert starts == []
        return
    assert starts == [after[0]]
    wanted = there[(there >= after[0] - before) & (there < after[0] + length)]
    ticks, samples = pieces(out)
    assert np.array_equal(ticks, wanted)
    assert np.array_equal(samples, truth(wanted))
    assert all(0 < len(item.samples) <= rows for item in out if isinstance(item, RecordBlock))
    # the gaps noted are exactly the ticks that are missing between samples of the record
    noted = sorted(
        tick for gap in out if isinstance(gap, LostSamples) for tick in range(gap.tick, gap.tick + gap.samples)
    )
    inner = [tick for tick in range(int(wanted[0]), int(wanted[-1])) if not present[tick]]
    assert [tick for tick in noted if wanted[0] <= tick <= wanted[-1]] == inner
    assert all(first <= tick < after[0] + length for tick in noted for first in [after[0] - before])


@settings(deadline=None, max_examples=100)
@given(cuts, st.integers(1, 498), st.booleans())
def test_level_is_met_at_the_same_sample_for_any_cut(cut, level, falling):
    sign = -1.0 if falling else 1.0
    channels = (StoredChannel("AF", "N", sign=sign), CHANNELS[1])
    plan = RecordPlan(channels, 100.0, 32, trigger=AtLevel(0, sign * (level - 0.5), not falling, "AF"), before=3)
    out = run(plan, blocks(cut, 500))
    assert [item.tick for item in out if isinstance(item, RecordStart)] == [level]
    assert pieces(out)[0][0] == max(0, level - 3)


def test_a_channel_that_begins_past_the_level_has_not_crossed_it() -> None:
    trigger = AtLevel(0, 1.0, True, "AF")
    assert trigger.find(0, np.array([[5.0], [4.0]])) is None
    assert trigger.find(2, np.array([[np.nan], [0.5], [np.nan], [1.0]])) == 5


@settings(deadline=None, max_examples=100)
@given(cuts, st.integers(1, 400), st.integers(0, 50))
def test_limit_stops_at_the_same_sample_for_any_cut(cut, high, after):
    limit = Limit(0, -np.inf, high - 0.5, "stop", "AF")
    out = run(RecordPlan(CHANNELS, 100.0, 32, limits=(limit,), after_limit=after), blocks(cut, 500))
    assert np.array_equal(pieces(out)[0], np.arange(high + 1 + after))
    ends = [item for item in out if isinstance(item, End)]
    assert len(ends) == 1
    assert ends[0].reason.startswith("limit: AF reads")


def test_limit_is_in_the_unit_of_the_channel_and_noted_once_a_second() -> None:
    # NF = -(2 r + 1) leaves -50 when r is above 24.5; r = 3 tick mod 101 does so again and again
    limit = Limit(1, -50.0, np.inf, "mark", "NF", "N")
    out = run(RecordPlan(CHANNELS, 100.0, 32, limits=(limit,)), blocks([], 500))
    marks = [item for item in out if isinstance(item, Event)]
    assert [item.kind for item in marks] == ["limit"] * len(marks)
    assert marks[0].tick == 9  # 3 * 9 = 27 is the first multiple of 3 above 24.5
    assert "NF reads -55 N" in marks[0].text
    assert 4 <= len(marks) <= 5  # five seconds
    assert all(b.tick - a.tick >= 100 for a, b in pairwise(marks))
    assert pieces(out)[0].size == 500


def test_call_begins_with_the_next_block_and_keeps_what_was_before() -> None:
    intake = Intake(RecordPlan(CHANNELS, 100.0, 50, trigger=OnCall(), before=120), clocked=False)
    given_blocks = list(blocks(range(0, 500, 10), 500))
    for block in given_blocks[:30]:
        assert intake.feed(block) == []
    intake.call("button")
    out = [item for block in given_blocks[30:] for item in intake.feed(block)] + intake.flush()
    assert out[0] == RecordStart(300, "button")
    assert np.array_equal(pieces(out)[0], np.arange(180, 500))


def test_gap_before_the_trigger_is_in_the_record() -> None:
    intake = Intake(RecordPlan(CHANNELS, 100.0, 50, trigger=OnCall(), before=120), clocked=False)
    for block in blocks([], 300, [(200, 230)]):
        intake.feed(block)
    intake.call("")
    out = intake.feed(Block(300, truth(np.arange(300, 310)), 0.0)) + intake.flush()
    assert [item for item in out if isinstance(item, LostSamples)] == [
        LostSamples(200, 30, "gap", "the tick of the source jumped")
    ]
    assert np.array_equal(pieces(out)[0], np.r_[180:200, 230:310])


def test_repeated_samples_are_taken_once() -> None:
    watch = Continuity(100.0, clocked=False)
    watch.follow(Block(0, truth(np.arange(10)), 0.0))
    found = watch.follow(Block(6, truth(np.arange(6, 20)), 0.1))
    assert found.gap is None
    assert found.block is not None
    assert found.block.tick == 10
    assert np.array_equal(found.block.samples, truth(np.arange(10, 20)))
    assert found.events[0].kind == "repeat"
    assert found.events[0].text.startswith("4 sample(s)")


def test_gap_carries_the_reason_that_the_source_gave() -> None:
    watch = Continuity(100.0, clocked=False)
    watch.follow(Block(0, truth(np.arange(10)), 0.0))
    found = watch.follow(Block(35, truth(np.arange(5)), 0.4, remark="connected again"))
    assert found.gap == LostSamples(10, 25, "remark", "connected again")


def test_restarted_count_goes_on_by_the_clock_of_the_computer() -> None:
    watch = Continuity(100.0, clocked=False)
    watch.follow(Block(5000, truth(np.arange(10)), 7.0))
    # 3 s later ten samples have arrived, so that 290 sampling intervals have none
    found = watch.follow(Block(0, truth(np.arange(10)), 10.0, remark="server restarted"))
    assert found.gap is not None
    assert found.gap[:3] == (5010, 290, "restart")
    assert "server restarted; length from the computer's clock" in found.gap.text
    assert found.block is not None
    assert found.block.tick == 5300
    following = watch.follow(Block(10, truth(np.arange(10)), 10.1))
    assert following.gap is None
    assert following.block is not None
    assert following.block.tick == 5310


def drifting(rng, ppm, seconds):
    rate, watch = 1000.0, Continuity(1000.0)
    events = []
    for number in range(int(seconds * 10)):
        # true time of the source's sample, and an arrival up to 40 ms later
        received = (number + 1) * 0.1 * (1 + ppm * 1e-6) + rng.uniform(0, 0.04)
        events += watch.follow(Block(number * 100, np.zeros((100, 1)), received)).events
    assert rate == watch.rate
    return events


def test_drift_of_the_clock_is_noted_and_a_steady_clock_is_not(rng) -> None:
    assert drifting(rng, 0.0, 300) == []
    # 1000 ppm are 0.05 s, the change that is noted, in 50 s
    events = drifting(rng, 1000.0, 300)
    assert events
    assert all(event.kind == "drift" and "behind" in event.text and "ppm" in event.text for event in events)
    assert all("ahead of" in event.text for event in drifting(rng, -1000.0, 300))


def test_block_goes_through_bytes_unchanged() -> None:
    rng = np.random.default_rng(1)
    block = Block(2**40 + 3, rng.normal(size=(7, 3)), 12.5, remark="réseau")
    back = Block.from_bytes(block.to_bytes())
    assert (back.tick, back.received, back.remark) == (block.tick, block.received, block.remark)
    assert back.samples.tobytes() == block.samples.tobytes()


def test_plan_without_settings_takes_everything() -> None:
    out = run(RecordPlan(CHANNELS, 100.0, 64, trigger=AtOnce()), blocks([3, 70, 71], 200))
    assert np.array_equal(pieces(out)[0], np.arange(200))
    assert [len(item.samples) for item in out if isinstance(item, RecordBlock)] == [64, 64, 64, 8]


@pytest.mark.parametrize(("before", "first"), [(0, 150), (120, 30), (1000, 0)])
def test_a_record_begins_where_it_was_asked_for(before, first) -> None:
    """Blocks of 40 samples at 1 kHz, each received when its last sample was taken: 0.15 s is tick 150."""
    intake = Intake(RecordPlan(CHANNELS, 1000.0, 64, before=before), asked=0.15)
    made = []
    for tick in range(0, 400, 40):
        made += intake.feed(Block(tick, truth(np.arange(tick, tick + 40)), (tick + 40) / 1000))
    pieces = [item for item in [*made, *intake.flush()] if isinstance(item, RecordBlock)]
    assert [item for item in made if isinstance(item, RecordStart)] == [RecordStart(150, "at once")]
    assert pieces[0].tick == first
    assert np.concatenate([piece.samples for piece in pieces])[:, 0].tolist() == list(range(first, 400))


@pytest.mark.parametrize("clocked", [True, False])
def test_blocks_that_came_late_do_not_move_the_beginning(clocked, rng) -> None:
    """All blocks but one of 200 come 0.01 s to 0.3 s late; where no clock gives them, the block itself is believed."""
    intake = Intake(RecordPlan(CHANNELS, 1000.0, 64), clocked=clocked, asked=3.0)
    late = np.concatenate([np.linspace(0.3, 0.0, 31), rng.uniform(0.01, 0.3, 169)])
    received = np.maximum.accumulate(np.arange(1, 201) * 0.04 + late)
    made = []
    for tick, at in zip(range(0, 8000, 40), received, strict=True):
        made += intake.feed(Block(tick, truth(np.arange(tick, tick + 40)), at))
    begun = next(item for item in made if isinstance(item, RecordStart))
    of_block = next(k for k, at in enumerate(received) if at >= 3.0)
    by_block = 3000 - round((received[of_block] - (of_block + 1) * 0.04) * 1000)
    assert begun.tick == (3000 if clocked else max(by_block, 40 * of_block))


@pytest.mark.parametrize("clocked", [True, False])
@pytest.mark.parametrize("at", [None, 5.0])
def test_a_mark_before_the_first_block_is_at_the_first_sample(clocked, at) -> None:
    assert Continuity(1000.0, clocked=clocked).tick_at(at) == 0


def test_a_record_says_that_it_begins_after_it_was_asked_for() -> None:
    intake = Intake(RecordPlan(CHANNELS, 1000.0, 64), asked=0.15)
    made = intake.feed(Block(400, truth(np.arange(400, 440)), 0.44))
    text = "at once; 0.25 s after it was asked for, as there are no samples from before"
    assert made[0] == RecordStart(400, text)


def test_a_level_counts_from_where_the_record_was_asked_for() -> None:
    intake = Intake(RecordPlan(CHANNELS, 1000.0, 64, trigger=AtLevel(0, 100.0, True, "AF")), asked=0.15)
    made = []
    for tick in range(0, 400, 40):
        samples = truth(np.arange(tick, tick + 40)) % 130  # rises past 100 at ticks 100, 230 and 360
        made += intake.feed(Block(tick, samples, (tick + 40) / 1000))
    assert next(item for item in made if isinstance(item, RecordStart)).tick == 230
