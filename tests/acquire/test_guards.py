"""What a record is watched for: combined loads, gauge outputs and contact, at the same sample for any cut."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerobalance.acquisition.continuity import Event
from aerobalance.acquisition.guards import ContactCircuit, EnvelopeLimit, Limit, capacity_stations
from aerobalance.acquisition.intake import End, Intake, RecordBlock, RecordPlan
from aerobalance.acquisition.planned import plan_of, ranges_of
from aerobalance.acquisition.setup import parse_setup, setup_from, stored_channels
from aerobalance.acquisition.source import Block, SourceChannel
from aerobalance.balance.load_envelope import LoadEnvelope
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError, ReadError
from aerobalance.simulation.calibration_stand import random_balance

POUND = 4.4482216152605  # N, by the definition of the pound (0.45359237 kg) and standard gravity

cuts = st.lists(st.integers(1, 399), max_size=12)


def run(plan, samples, cuts=()):
    intake, out = Intake(plan, clocked=False), []
    for a, b in pairwise(sorted({0, len(samples), *cuts})):
        out += intake.feed(Block(a, samples[a:b], 0.0))
    return out + intake.flush()


def recorded(out):
    return sum(len(item.samples) for item in out if isinstance(item, RecordBlock))


def events(out):
    return [(item.tick, item.kind) for item in out if isinstance(item, Event)]


@settings(deadline=None, max_examples=60)
@given(cuts, st.integers(0, 30))
def test_combined_loads_stop_the_record_at_the_same_sample(cut, after) -> None:
    setup = parse_setup(
        """
        [channels.NF]
        unit = "lbf"
        half_range = 100.0
        [channels.AF]
        [limits.AF]
        high = 50.0
        low = -50.0
        [envelope]
        shape = "rhombus"
        action = "stop"
        """
    )
    channels = stored_channels(setup, [SourceChannel("NF", "lbf"), SourceChannel("AF", "N")])
    plan = plan_of(setup, channels, 100.0)
    plan = RecordPlan(channels, 100.0, 32, limits=plan.limits, after_limit=after)
    ramp = np.arange(400.0)
    # 0.2 lbf and 0.1 N a sample: 0.002 + 0.002 of the envelope; beyond it from sample 251 on, when each has half
    out = run(plan, np.column_stack((0.2 * ramp, 0.1 * ramp)), cut)
    assert recorded(out) == 251 + 1 + after
    assert events(out) == [(251, "limit"), (251 + 1 + after, "end")] or events(out) == [(251, "limit")]
    (end,) = [item for item in out if isinstance(item, End)]
    assert "combined loads take up 100.4 % of the load envelope" in end.reason
    assert ranges_of(setup, channels, None).envelope.limits["NF"][1] == pytest.approx(100 * POUND)


@settings(deadline=None, max_examples=100)
@given(cuts, st.lists(st.booleans(), min_size=40, max_size=40), st.sampled_from(["mark", "stop"]))
def test_contacts_are_noted_at_the_same_samples(cut, closed, action) -> None:
    channels = (StoredChannel(name="AF", unit="N"), StoredChannel(name="fouling", unit="V"))
    circuit = ContactCircuit(1, "fouling", "V", 2.5, True, 7, action)
    samples = np.column_stack((np.arange(400.0), np.repeat(closed, 10) * 5.0))
    out, whole = (run(RecordPlan(channels, 100.0, 32, circuit=circuit), samples, some) for some in (cut, ()))
    assert recorded(out) == recorded(whole)
    if any(closed) and action == "stop":
        assert recorded(out) == 10 * closed.index(True) + 1
    # runs of ten open samples end a contact, as seven are enough
    begins = [10 * k for k in range(40) if closed[k] and (k == 0 or not closed[k - 1])]
    ends = [10 * k for k in range(1, 40) if closed[k - 1] and not closed[k]]
    if action == "mark":
        assert [tick for tick, kind in events(out) if kind == "contact"] == begins
        assert [tick for tick, kind in events(out) if kind == "contact over"] == ends


@settings(deadline=None, max_examples=50)
@given(cuts, st.lists(st.booleans(), min_size=40, max_size=40), st.integers(1, 399))
def test_nothing_is_noted_from_beyond_the_end_of_the_record(cut, closed, length) -> None:
    channels = (StoredChannel(name="AF", unit="N"), StoredChannel(name="fouling", unit="V"))
    circuit = ContactCircuit(1, "fouling", "V", 2.5, True, 7)
    limit = Limit(0, -np.inf, 299.5, "mark", "AF", "N")
    samples = np.column_stack((np.arange(400.0), np.repeat(closed, 10) * 5.0))
    plan = RecordPlan(channels, 100.0, 32, limits=(limit,), circuit=circuit, length=length)
    out = run(plan, samples, cut)
    begins = [10 * k for k in range(40) if closed[k] and (k == 0 or not closed[k - 1])]
    ends = [10 * k for k in range(1, 40) if closed[k - 1] and not closed[k]]
    found = events(out)
    assert recorded(out) == length
    assert [tick for tick, kind in found if kind == "limit"] == [300] * (length > 300)
    assert [tick for tick, kind in found if kind == "contact"] == [tick for tick in begins if tick < length]
    # the seventh open sample ends a contact
    assert [tick for tick, kind in found if kind == "contact over"] == [tick for tick in ends if tick + 6 < length]


def test_loads_of_gauge_outputs_are_watched(rng, seed) -> None:
    balance = random_balance(seed)
    setup = setup_from(
        {
            "files": {"balance": "b.json"},
            "envelope": {"shape": "balance", "action": "stop"},
            "record": {"after_limit": 0.0},
        }
    )
    channels = tuple(StoredChannel(name=f"r{name}", unit="uV/V") for name in balance.gauges)
    plan = plan_of(setup, channels, 1000.0, balance=balance)
    direction = rng.normal(size=6)
    shares = np.linspace(0.05, 1.3, 400)
    native = shares[:, None] * (direction / np.abs(direction).max()) * balance.load_scale
    zero = np.zeros(6) if balance.natural_zero is None else balance.natural_zero
    out = run(plan, 1e3 * (balance.outputs(native) + zero))
    # the step of the shares is 0.0031, and the iteration for the loads ends far below that
    assert abs(recorded(out) - 1 - int(np.argmax(shares > 1))) <= 1
    assert "of the load envelope" in next(item for item in out if isinstance(item, End)).reason
    # the limit of one load, which is none of the channels
    setup = setup_from({"files": {"balance": "b.json"}, "limits": {"AF": {"high": 1.0, "action": "stop"}}})
    (limit,) = plan_of(setup, channels, 1000.0, balance=balance).limits
    assert (limit.column, limit.unit) == (6 + COMPONENTS.index("AF"), "N")


def test_gauge_that_was_zeroed_has_no_natural_zero(seed) -> None:
    balance = random_balance(seed)
    setup = setup_from({"files": {"balance": "b.json"}, "envelope": {"shape": "balance"}})
    channels = [StoredChannel(name=f"r{name}", unit="mV/V", offset=0.1 * k) for k, name in enumerate(balance.gauges)]
    loads = plan_of(setup, tuple(channels), 1000.0, balance=balance).loads
    natural = np.zeros(6) if balance.natural_zero is None else balance.natural_zero
    np.testing.assert_array_equal(loads.zeros, [natural[0], 0, 0, 0, 0, 0])
    with pytest.raises(FitError, match="the balance needs r"):
        plan_of(setup, tuple(channels[1:]), 1000.0, balance=balance)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("[stations.N1]\nlimit = 5.0\nNF = 1.0", "stations: they need envelope.shape"),
        ('[envelope]\nshape = "stations"', "needs tables"),
        ('[envelope]\nshape = "balance"', "needs files.balance"),
        ("[stations.N1]\nlimit = 5.0", "share of one component"),
        ("[shunt.rAF]", "change or resistance"),
        ("[shunt.rAF]\nchange = 1.0\nresistance = 5.0", "not both"),
        ('[fouling]\nchannel = "x"', "channel and level go together"),
        ('[channels.AF]\n[fouling]\nchannel = "x"\nlevel = 1.0', "fouling.channel: there is no x"),
        ("[channels.AF]\n[shunt.NF]\nchange = 1.0", "shunt.NF: there is no NF"),
    ],
)
def test_wrong_tables_say_what_and_where(text, where) -> None:
    with pytest.raises(ReadError, match=where):
        parse_setup(text)


def test_what_the_source_lacks_is_told() -> None:
    channels = (StoredChannel(name="AF", unit="N"),)
    with pytest.raises(FitError, match="load envelope: an envelope needs the limits"):
        plan_of(parse_setup('[envelope]\nshape = "box"\n[source]\nkind = "replay"\nfile = "a.csv"'), channels, 10.0)
    with pytest.raises(FitError, match="load envelope needs NF"):
        plan_of(parse_setup('[envelope]\nshape="stations"\n[stations.N1]\nlimit=1.0\nNF=1.0'), channels, 10.0)
    with pytest.raises(FitError, match="round zero load: AF"):
        plan_of(parse_setup('[envelope]\nshape="box"\n[limits.AF]\nlow=1.0\nhigh=2.0'), channels, 10.0)
    with pytest.raises(FitError, match="no channel contact"):
        plan_of(parse_setup('[fouling]\nchannel="contact"\nlevel=1.0'), channels, 10.0)


def test_envelope_is_found_by_column_and_unit() -> None:
    envelope = LoadEnvelope("box", {"NF": (-1.0, 1.0), "PM": (-1.0, 1.0)})
    limit = EnvelopeLimit(envelope, (2, 0), (1.0, 10.0), "mark")
    outside, known = limit.outside(np.array([[0.05, 99.0, 0.9], [0.2, 0.0, 0.0], [np.nan, 0.0, 0.0]]))
    assert outside.tolist() == [False, True, False] and known.tolist() == [True, True, False]
    assert limit.text(np.array([0.2, 0.0, 0.0])).endswith("most by PM")


def test_capacities_without_a_geometry_are_of_the_loads_themselves() -> None:
    balance = random_balance(1)
    stations = capacity_stations(balance)
    assert [item.name for item in stations] == list(balance.components)
    assert [item.limit for item in stations] == balance.load_scale.tolist()
