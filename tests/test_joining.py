"""Recordings of one event with clocks of their own, against offsets and drifts that are known."""

import json
from dataclasses import replace

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.io import read, write_recording
from aerobalance.recording.alignment import align
from aerobalance.recording.channel import Channel
from aerobalance.recording.clock_marks import edges
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.joining import join
from aerobalance.recording.recording import Recording

OFFSET, DRIFT = 0.3217654321, 37e-6
"""A time s of the second clock is s + OFFSET + DRIFT (s - its start) on the first."""

SECONDS = 12.0


class Signal:
    """Sum of sines of random frequencies up to a limit: known at any time."""

    def __init__(self, rng, highest, count=60):
        self.w = 2 * np.pi * rng.uniform(0.5, highest, count)
        self.phase = rng.uniform(0, 2 * np.pi, count)
        self.size = rng.normal(size=count) / np.sqrt(count)

    def __call__(self, time):
        return np.sin(np.multiply.outer(time, self.w) + self.phase) @ self.size


def pulses(time, width=2e-4):
    """A trigger: pulses at uneven times, each edge a ramp shorter than a sample."""
    found = np.zeros(time.size)
    for begin in PULSES:
        found += np.clip((time - begin) / width + 0.5, 0, 1) * (time < begin + 0.05)
    return found


PULSES = 0.9 + np.array([0.0, 1.13, 2.9, 3.77, 6.2, 8.41, 9.03])


def pair(rng, *, fast=5000.0, slow=1600.0, noise=0.0, drift=DRIFT, offset=OFFSET):
    """Two recordings of one event: loads on the fast clock, angles on the slow one, and what they have in common."""
    load, pitch, common = Signal(rng, 1200.0), Signal(rng, 300.0), Signal(rng, 300.0)
    t = np.arange(round(SECONDS * fast)) / fast
    s = 0.05 + np.arange(round((SECONDS - 1) * slow)) / slow
    true = s + offset + drift * (s - s[0])

    def noisy(values):
        return values + noise * rng.normal(size=values.size)

    one = {
        "AF": Channel("AF", load(t), "N"),
        "live_acceleration": Channel("live_acceleration", noisy(common(t)), "m/s^2"),
        "trigger": Channel("trigger", pulses(t), "V"),
        "tick": Channel("tick", np.floor(1e6 * t), "1"),
    }
    two = {
        "pitch": Channel("pitch", 0.01 * pitch(true), "rad"),
        "live_acceleration": Channel("live_acceleration", noisy(0.7 * common(true) + 0.2), "m/s^2"),
        "trigger": Channel("trigger", 5 * pulses(true), "V"),
        "tick": Channel("tick", np.floor(1e6 * true), "1"),
    }
    first = Recording.from_columns(t, one, name="loads")
    return first, Recording.from_columns(s, two, name="angles"), pitch


@pytest.mark.parametrize("way", ["tick", "trigger", "correlation"])
def test_offset_and_drift_are_found_within_their_uncertainty(rng, way) -> None:
    first, second, _ = pair(rng, noise=0.05)
    found = align(first, second, way=way)
    # an edge may be anywhere in its sample. A count of 1 us is known to 0.29 of it in either file; the first counts
    # 200 from sample to sample, so that a drift of 1.5 counts over its length is not seen: 1.5e-6 / 12 / sqrt(3),
    # by which the offset is off as well, six seconds from the middle
    assert found.u_offset < {"tick": 6e-7, "trigger": 2e-4, "correlation": 2e-5}[way]
    assert found.u_drift < {"tick": 7.5e-8, "trigger": 3e-5, "correlation": 3e-6}[way]
    assert abs(found.offset - OFFSET) < 5 * found.u_offset
    assert abs(found.drift - DRIFT) < 5 * found.u_drift
    # a second of its own is a longer one of the other where it is slow
    assert f"its clock is {'slow' if DRIFT > 0 else 'fast'} by {1e6 * abs(found.drift):.3f} ppm" in found.told()


@pytest.mark.parametrize(
    ("counts", "last", "sharp"),
    [
        (1000.0, 1.0, False),  # as many counts as samples: rounding follows the drift and tilts the line as a whole
        (1500.0, 1.0, False),
        (10_000.0, 10.0, False),  # the last digit of the counter is always the same
        (1.0, 0.001, False),  # a time in s, rounded to ms
        (10.0, 1.0, False),
        (1234.567, 1.0, True),  # samples fall anywhere within a count: 1 / sqrt(12) of it, independent of each other
    ],
)
def test_the_drift_by_a_coarse_counter_lies_within_its_uncertainty(rng, counts, last, sharp) -> None:
    """Counters of two clocks, each rounded down, against drift and offset that are known; ten seconds at 1 kHz."""
    own, z, told = np.arange(10_000) / 1000, [], []
    for _ in range(60):
        drifts, begins = rng.uniform(-5e-5, 5e-5, 2), rng.uniform(5, 15, 2)
        records = [
            Recording.from_columns(
                own, {"tick": Channel("tick", last * np.floor(counts / last * (begin + own * (1 + drift))), "1")}
            )
            for drift, begin in zip(drifts, begins, strict=True)
        ]
        found = align(*records, way="tick")
        drift = (1 + drifts[1]) / (1 + drifts[0]) - 1
        offset = (begins[1] - begins[0]) / (1 + drifts[0])
        z.append([(found.drift - drift) / found.u_drift, (found.offset - offset) / found.u_offset])
        told.append(found.u_drift)
    # what is off has bounds of some 1.7 of its uncertainties; of 60 a mean square is known to sqrt(2 / 60)
    assert np.abs(z).max() < 3
    assert np.sqrt(np.mean(np.square(z), axis=0)).max() < 1 + 3 * np.sqrt(1 / 120)
    if sharp:  # 10 000 readings over 10 s, in either record: no more than twice that is stated
        assert np.median(told) < 2 * np.sqrt(2) * np.sqrt(1 / 12) / counts / 10 / np.sqrt(10_000 / 12)


@pytest.mark.soak(first=0)
def test_the_scatter_of_correlation_is_what_is_stated(rng) -> None:
    z = []
    for _ in range(4):
        first, second, _ = pair(rng, noise=0.3, slow=800.0)
        found = align(first, second, way="correlation")
        z += [(found.offset - OFFSET) / found.u_offset, (found.drift - DRIFT) / found.u_drift]
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.9  # chi-square of 8: five standard deviations about 1


def test_the_slower_recording_is_resampled_once_onto_the_faster(rng) -> None:
    first, second, pitch = pair(rng)
    with pytest.warns(DataQualityWarning, match="samples are left out, as the other recordings do not cover"):
        joined = join([second, first])
    assert joined.base == "loads"
    assert joined.alignments[0].way == "tick"
    recording = joined.recording
    assert recording.rate == pytest.approx(5000.0)
    assert set(recording.channels) == {
        "AF",
        "live_acceleration",
        "trigger",
        "tick",
        "pitch",
        "live_acceleration_1",
        "trigger_1",
    }
    begin = round((recording.start - first.start) * 5000)
    np.testing.assert_array_equal(
        recording.channel("AF").values, first.channel("AF").values[begin : begin + recording.samples]
    )
    # 300 of 1600 Hz: below 0.3 of the rate, where the filter is exact to 3e-6; the clock is known to u
    inner = slice(100, -100)
    error = recording.channel("pitch").values[inner] - 0.01 * pitch(recording.time)[inner]
    slope = 0.01 * np.sqrt(np.sum((pitch.size * pitch.w) ** 2) / 2)
    assert np.sqrt(np.mean(error**2)) < 0.01 * 3e-6 + slope * 4 * joined.alignments[0].u_offset


def test_without_drift_and_with_one_rate_samples_stay_beside_each_other(rng) -> None:
    first, second, pitch = pair(rng, fast=1600.0, drift=0.0)
    with pytest.warns(DataQualityWarning, match="left out"):
        joined = join([first, second], way="correlation", by="live_acceleration")
    assert abs(joined.alignments[0].drift) < 1e-9
    inner = slice(100, -100)
    error = joined.recording.channel("pitch").values[inner] - 0.01 * pitch(joined.recording.time)[inner]
    assert np.abs(error).max() < 1e-6


def test_delays_of_the_channels_count(rng) -> None:
    first, second, _ = pair(rng)
    late = replace(first.channel("live_acceleration"), delay=0.002)  # what reads at t was at t - 0.002
    channels = dict(first.channels) | {"live_acceleration": late}
    found = align(replace(first, channels=channels), second, way="correlation")
    assert found.offset == pytest.approx(OFFSET - 0.002, abs=2e-6)


def test_what_is_missing_stays_missing(rng) -> None:
    first, second, _ = pair(rng)
    values = second.channel("pitch").values.copy()
    values[5000:5003] = np.nan
    second = replace(second, channels=dict(second.channels) | {"pitch": Channel("pitch", values, "rad")})
    with pytest.warns(DataQualityWarning, match="left out"):
        joined = join([first, second], way="tick")
    gone = np.flatnonzero(joined.recording.channel("pitch").missing)
    middle = (5001 / 1600 + 0.05 + OFFSET + DRIFT * 5001 / 1600 - joined.recording.start) * 5000
    assert abs(gone.mean() - middle) < 2
    assert 3 * 5000 / 1600 <= gone.size <= 6 * 5000 / 1600


def test_edges_that_are_missing_at_an_end_are_matched_by_their_distances(rng) -> None:
    first, second, _ = pair(rng)
    cut = second.part(int(2.5 * 1600), second.samples)
    assert edges(cut, "trigger").size < edges(first, "trigger").size
    found = align(first, cut, way="trigger")
    assert found.offset == pytest.approx(OFFSET + DRIFT * 2.5, abs=5 * found.u_offset)


def test_dates_are_taken_when_asked_for_and_said_to_be_as_good_as_they_are(rng) -> None:
    first, second, _ = pair(rng)
    with pytest.raises(FitError, match="loads does not say at which date and time"):
        align(first, second, way="start")
    dated = replace(first, epoch=np.datetime64("2024-03-12T10:15:00.000", "ns"))
    later = replace(second, epoch=np.datetime64("2024-03-12T10:15:00.250", "ns"))
    found = align(dated, later, way="start")
    assert found.offset == pytest.approx(0.25, abs=1e-12)
    assert "a drift of its clock cannot be seen" in found.told()


def test_what_cannot_be_aligned_is_refused_with_the_reason(rng) -> None:
    first, second, _ = pair(rng)
    bare = replace(second, channels={"pitch": second.channel("pitch")})
    with pytest.raises(FitError, match="have no channel in common"):
        join([first, bare])
    other = Channel("live_acceleration", Signal(rng, 300.0)(second.time), "m/s^2")
    with pytest.raises(FitError, match="are not alike"):
        align(first, replace(second, channels={"live_acceleration": other}))
    tone = {one.name: Channel("AF", np.sin(200 * one.time), "N") for one in (first, second)}
    periodic = [replace(one, channels={"AF": tone[one.name]}) for one in (first, second)]
    with pytest.raises(FitError, match="AF repeats itself"):
        align(*periodic, way="correlation")
    with pytest.raises(FitError, match="tick is no counter"):
        back = Channel("tick", -second.channel("tick").values, "1")
        align(first, replace(second, channels={"tick": back}))
    with pytest.raises(ValueError, match="align must be one of auto, tick"):
        align(first, second, way="by eye")


def test_convert_takes_several_files(tmp_path, capsys, monkeypatch, rng) -> None:
    monkeypatch.chdir(tmp_path)
    first, second, _ = pair(rng)
    write_recording("loads.h5", first)
    write_recording("angles.csv", second)
    given = ["convert", "loads.h5", "angles.csv", "-o", "run.h5"]
    assert main([*given, "--align", "trigger", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    (one,) = said["alignments"]
    assert (one["file"], one["onto"], one["way"], one["by"]) == ("angles.csv", "loads.h5", "trigger", "trigger")
    assert one["offset"] == pytest.approx(OFFSET, abs=5 * one["u_offset"])
    assert "pitch" in read("run.h5").channels
    assert main([*given, "--replace"]) == 0
    assert "angles.csv is aligned by tick of tick" in capsys.readouterr().out
    assert main(["convert", "loads.h5", "-o", "other.h5", "--align", "tick"]) == 2
    assert "--align" in capsys.readouterr().err
    assert main([*given, "--align", "guess"]) == 2


def test_a_joined_channel_takes_no_name_that_is_there():
    time, other = np.arange(2000) / 1000, np.arange(1600) / 800

    def trigger(at):
        return Channel("trigger", (at * 1000 % 700 > 350) * 5.0, "V")

    def level(name, value, count):
        return Channel(name, np.full(count, value), "m/s^2")

    names = ("ground_acceleration", "ground_acceleration_2")
    base = {name: level(name, value, time.size) for name, value in zip(names, (1.0, 22.0), strict=True)}
    first = Recording.from_columns(time, {"trigger": trigger(time), **base}, name="base")
    second = {"trigger": trigger(other), names[0]: level(names[0], 7.0, other.size)}
    with pytest.warns(DataQualityWarning):
        joined = join([first, Recording.from_columns(other, second, name="other")]).recording
    found = {name: float(np.nanmean(channel.values)) for name, channel in joined.channels.items() if name != "trigger"}
    assert found == {names[0]: 1.0, names[1]: 22.0, "ground_acceleration_3": 7.0}


@pytest.mark.soak(first=0)
@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
def test_a_slow_signal_of_which_a_part_is_common_is_not_put_where_it_looks_alike(rng):
    scores = []
    for _ in range(4):
        walk = np.cumsum(rng.normal(size=60_000))
        walk = (walk - np.linspace(walk[0], walk[-1], walk.size)) / walk.std()
        parts = (walk[10_000:40_000], walk[:30_000])  # the second began 10 s before
        base, other = (
            Recording.from_columns(
                np.arange(part.size) / 1000,
                {"AF": Channel("AF", part + 0.01 * rng.normal(size=part.size), "N")},
                name=name,
            )
            for name, part in zip(("base", "other"), parts, strict=True)
        )
        (found,) = join([base, other], way="correlation", by="AF").alignments
        scores.append((found.offset + 10) / found.u_offset)
    assert np.abs(scores).max() < 6


def test_a_base_far_shorter_than_the_other_is_told_or_aligned(rng):
    signal = rng.normal(size=30_000)
    base = Recording.from_columns(np.arange(2000) / 1000, {"AF": Channel("AF", signal[5000:7000], "N")}, name="short")
    other = Recording.from_columns(np.arange(30_000) / 999, {"AF": Channel("AF", signal, "N")}, name="long")
    with pytest.raises(FitError):
        join([base, other], way="correlation", by="AF")
