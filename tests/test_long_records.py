"""Records that are worked on in parts: the same answer as in one piece, however they are read."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.fft import next_fast_len
from scipy.linalg import solve_continuous_are

from aerobalance.dynamics.independent import dynamics_of
from aerobalance.estimation.checks.outliers import without_wild_samples
from aerobalance.estimation.force import ForceWork, estimate_force
from aerobalance.estimation.force_collector import SummaryOfParts
from aerobalance.estimation.force_parts import JOINTS, Division
from aerobalance.estimation.force_smoother import SmootherResult
from aerobalance.estimation.forces import ForceSettings
from aerobalance.estimation.independent_record import IndependentRecord
from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import Channel
from aerobalance.recording.doubts import Doubt, of_all_parts
from aerobalance.recording.errors import DataQualityWarning, FitError, OfLoads, OfMissing
from aerobalance.recording.part_warnings import PartWarnings
from aerobalance.recording.parts import Part, parts_of
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected
from aerobalance.uncertainty.budget import component_budget, scalars, spectrum
from aerobalance.uncertainty.mean_loads import mean_loads
from aerobalance.uncertainty.monte_carlo import monte_carlo
from aerobalance.uncertainty.regression import regress
from helpers.cable_cut import T128

RATE, NOISE = 1600.0, 2.0
SHORT = Division(readings=1 << 13, margin=(1 << 10, 1 / 8))
"""Parts of up to 8192 samples: the T-128's slowest mode, of 0.3 s at 1600 Hz, has margins of 1024 samples, which is
two decay times."""

UNSURE = replace(T128, covariance=np.diag((np.array([2e-4, 2e-4, 5e-2, 0]) * T128.values) ** 2))


HIGHEST = 40.0
"""Highest frequency of the force, or where it is weaker by a half [Hz]."""


def run(
    generator: np.random.Generator, *, count=14_000, steps=(), soft=False, missing=slice(0, 0), **known
) -> Recording:
    """Balance load under a force of 20 N rms with steps of 30 N, up and down in turn, and its noise."""
    time, frequency = np.arange(count) / RATE, np.fft.rfftfreq(count, 1 / RATE)
    shape = (1 + (frequency / HIGHEST) ** 4) ** -0.5 if soft else (frequency > 0) & (frequency < HIGHEST)
    force = np.fft.irfft(np.fft.rfft(generator.normal(size=count)) * shape)
    force *= 20.0 / force.std()
    load = np.fft.irfft(np.fft.rfft(force) * T128.response(frequency)) + 50.0
    for place, sample in enumerate(steps):
        load += 30.0 * (-1) ** place * T128.step_response(time - sample / RATE, duration=0.0)
    load += NOISE * generator.normal(size=count)
    load[missing] = np.nan
    return Recording.from_columns(time, {"AF": Channel("AF", load, "N", **known)}, name="long run")


def silent(samples: int) -> Recording:
    """A record of so many samples."""
    return Recording.from_columns(np.arange(samples) / RATE, {"AF": Channel("AF", np.zeros(samples), "N")})


def parts_by_samples(count: int) -> tuple[Part, ...]:
    """The parts of a record of so many samples."""
    return SHORT.parts(silent(count), dynamics_of(T128))


def divided(record, dynamics=T128, division=SHORT, **settings):
    return ForceWork(record, dynamics_of(dynamics), division=division, **settings)


def rms(values) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


# --- where parts are


@pytest.mark.parametrize("samples", [1000, 1001, 1801, 2600, 2601, 9999])
def test_parts_make_up_the_record_and_overlap(samples):
    parts = parts_of(samples, length=1000, margin=100)
    assert parts[0].first == parts[0].begin == 0
    assert parts[-1].stop == parts[-1].end == samples
    for part in parts:
        assert part.count == len(parts)
        assert part.end - part.begin == 1000 or part is parts[-1]
    # what is left of the record but at least half a part, and up to the next number without large factors
    least = max(samples - 800 * (len(parts) - 1), 500)
    assert least <= parts[-1].end - parts[-1].begin <= next_fast_len(least, real=True)
    for one, other in pairwise(parts):
        joint = one.stop
        assert joint == other.first
        assert one.end >= joint + 100
        assert other.begin <= joint - 100
        assert joint == 100 + 800 * one.number  # whatever the record's length


@pytest.mark.parametrize("samples", [8193, 12_289, 40_961, 122_880, 245_761])
def test_parts_of_a_record_are_as_long_as_each_other(samples):
    """A last part that had what is left, and half a part at least, cost up to half a part for nothing."""
    dynamics = dynamics_of(T128)
    parts = Division(readings=8192, margin=(512, 1 / 8)).parts(silent(samples), dynamics)
    lengths = [part.end - part.begin for part in parts]
    margin = parts[0].margin
    even = -(-(samples + 2 * margin * (len(parts) - 1)) // len(parts))
    assert max(lengths) <= min(8192, next_fast_len(even, real=True))
    assert len(parts) == 1 + -(-(samples - 8192) // (8192 - 2 * margin))  # no more than full parts would be
    # n parts of a length L that is rounded up from `even`: the last lacks what all are longer by, n (L - even), and
    # the rounding of `even`, which is less than n
    assert set(lengths[:-1]) == {max(lengths)}
    assert lengths[-1] >= max(lengths) - len(parts) * (max(lengths) - even + 1)


def test_margins_are_as_short_as_the_smoother_forgets():
    """Of a complex amplitude x' = -a x + w read with white noise the filter's own rate is a sqrt(1 + S / R)."""
    dynamics = dynamics_of(T128)
    (mode,) = dynamics.modes
    a = mode.angular_frequency * mode.damping_ratio
    record = silent(1 << 16)
    division = Division(readings=1 << 15, margin=(1, 1 / 8))

    def margin(*shown: float) -> int:
        return division.parts(record, dynamics, shown=shown)[0].margin

    assert margin() == margin(0.0) == min(int(4 * RATE / a), 1 << 12)
    for ratio in (1e4, 1e6):
        q, r = ratio * a**2, 1.0  # S = q / a^2 at the natural frequency
        (((gain,),),) = (solve_continuous_are(np.array([[-a]]), np.eye(1), np.array([[q]]), np.array([[r]])) / r,)
        assert margin(ratio) == int(4 * RATE / (a + gain))


def test_a_short_record_is_one_part():
    (part,) = parts_of(1000, length=1000, margin=100)
    assert (part.begin, part.first, part.stop, part.end, part.count) == (0, 0, 1000, 1000, 1)


def test_a_margin_that_leaves_nothing_is_refused():
    with pytest.raises(ValueError, match="too much"):
        parts_of(2000, length=1000, margin=300)


def test_a_part_of_a_recording_knows_its_clock_and_place():
    stamps = np.delete(np.arange(100), [30, 31, 59]) / 10.0 + 5.0
    with pytest.warns(DataQualityWarning, match="missing"):
        whole = Recording.from_columns(stamps, {"AF": Channel("AF", stamps * 2, "N")})
    part = whole.part(25, 60)
    assert part.samples == 35
    assert part.start == pytest.approx(7.5)
    assert part.extent.begin == 25 / 99
    assert part.extent.end == 59 / 99
    np.testing.assert_array_equal(part.channel("AF").values, whole.channel("AF").values[25:60])
    np.testing.assert_allclose(part.time[part.rows], part.stamps, rtol=1e-12)
    assert part.rows[-1] == 33  # the last sample is missing


def test_parts_know_the_mean_temperature_of_the_record():
    values = np.linspace(20.0, 30.0, 100)
    values[3] = np.nan
    channels = {"temperature": Channel("temperature", values, "degC")}
    whole = Recording.from_columns(np.arange(100) / 10.0, channels)
    for begin, end in ((0, 10), (50, 60)):
        assert whole.part(begin, end).extent.means["temperature"] == pytest.approx(np.nanmean(values))
    assert whole.part(0, 50).part(0, 10).extent.means["temperature"] == pytest.approx(np.nanmean(values))


# --- the same answer


def test_parts_give_what_the_whole_gives(rng):
    _, second, third, *_ = parts_by_samples(22_000)
    record = run(rng, count=22_000, steps=(second.first + 0.3, third.first - 0.4))  # each within a sample of a joint
    whole = estimate_force(record, T128).only
    found = divided(record).force().only
    assert [step.instant for step in found.steps] == pytest.approx(
        [step.instant for step in whole.steps], abs=0.1 / RATE
    )
    assert [step.height for step in found.steps] == pytest.approx(
        [step.height for step in whole.steps], abs=0.5 * whole.steps[0].height_uncertainty
    )
    # each part has learned its prior from a third of the record. An error of a tenth of u beside u is half a percent
    # of it, far below what the coverage shows
    apart = (found.values - whole.values) / whole.uncertainty
    assert rms(apart) < 0.1
    for part in SHORT.parts(record, dynamics_of(T128))[1:]:
        assert rms(apart[part.first - 512 : part.first + 512]) < 0.15
    assert rms(found.uncertainty) == pytest.approx(rms(whole.uncertainty), rel=0.05)


def test_a_slow_filter_is_undone_across_the_joints_of_parts(rng, monkeypatch):
    """Undone on each part alone, half a margin beside its ends, it left the weight 0.5 N off where they meet."""
    record = run(rng)
    low_pass = AntiAlias("bessel", 4, 1.0)
    pitch = 0.03 + 0.02 * np.sin(2 * np.pi * 4 * np.arange(record.samples) / record.samples + 0.3)  # 0.46 Hz
    response = low_pass.response(np.fft.rfftfreq(pitch.size, 1 / RATE))
    read = np.fft.irfft(np.fft.rfft(pitch) * response, pitch.size)
    tilt = Channel("pitch", read, "rad", filter=low_pass)
    work = divided(replace(record, channels={**record.channels, "pitch": tilt}))
    assert work.working.every == 1
    taken = []

    class EnoughError(Exception):
        """What the force would be worked out from is known."""

    def stop(given, *_, **_settings):
        taken.append(given)
        raise EnoughError

    monkeypatch.setattr("aerobalance.estimation.force_record.force_record", stop)
    first, second = work.division.parts(record, dynamics_of(T128))
    for part in (first, second):
        with pytest.raises(EnoughError):
            work.force_of(part)
        found = corrected(taken[-1]).channel("pitch").values
        assert found.size == part.end - part.begin
        apart = 9.8 * T128.mass * np.abs(found - pitch[part.begin : part.end])
        near = slice(first.stop - part.begin - part.margin // 2, first.stop - part.begin + part.margin // 2)
        assert apart[near].max() < 0.05  # N


def test_a_part_tells_of_its_own_readings_alone(rng):
    """Those beside it, which its filters are undone with, are another part's to tell of; they are left out as well."""
    record = run(rng, count=3000)
    load = record.channel("AF").values.copy()
    load[1000] += 900.0
    record = replace(record, channels={"AF": replace(record.channel("AF"), values=load)})
    for own, told in ((None, 1), (slice(500, 2000), 1), (slice(1200, 2500), 0)):
        clean, doubts = without_wild_samples(record, ["AF"], own=own)
        assert np.isnan(clean.channel("AF").values[1000])
        assert len(doubts) == told
        assert all("at 0.625 s" in str(doubt) for doubt in doubts)


@pytest.mark.parametrize("soft", [True, False])
def test_with_the_same_prior_little_is_left_of_the_ends_of_a_part(rng, soft):
    """A smooth spectrum forgets exponentially; one that ends at a frequency B like sin(2 pi B t) / t.

    Of the square of that 1 / (2 pi^2 2 B t) lies beyond a time t, and the noise that the smoother lets through and the
    force that it holds back are both cut off there, on one side of a joint.
    """
    record = run(rng, soft=soft)
    reading = IndependentRecord.of(record, dynamics_of(T128)).component_record("AF").reading()
    learned = estimate_force(record, T128).only.learned
    whole = SmootherResult.of(reading, learned=learned, steps=())
    u = float(np.median(np.sqrt(whole.variance)))
    for part in SHORT.parts(record, dynamics_of(T128)):
        own = replace(reading, values=reading.values[part.begin : part.end])
        found = SmootherResult.of(own, learned=learned, steps=())
        # what free motion there may be when a record begins is judged from the record itself
        first = part.first - part.margin // 2 if part.number > 1 else part.margin // 2
        last = part.stop if part.number < part.count else part.stop - part.margin
        apart = found.force[first - part.begin : last - part.begin] - whole.force[first:last]
        if soft:
            assert np.max(np.abs(apart)) < 0.01 * u
        else:
            beyond = np.sqrt(2 / (2 * np.pi**2 * 2 * HIGHEST * part.margin / 2 / RATE))
            assert rms(apart[: part.margin]) < 3 * beyond * u
            assert rms(apart) < beyond * u


@pytest.mark.soak(first=1)
@pytest.mark.parametrize(
    ("settings", "rounding"), [(ForceSettings("paper"), 0.0), (ForceSettings(bandwidth=60.0), 1e-9)]
)
def test_direct_inverses_of_parts_are_that_of_the_whole(rng, settings, rounding):
    """They know nothing of the record but the samples around, and give in parts what they give in one piece."""
    record = run(rng)
    whole = estimate_force(record, UNSURE, method=settings.method, bandwidth=settings.bandwidth).only
    found = divided(record, UNSURE, settings=settings).force().only
    np.testing.assert_allclose(found.values, whole.values, rtol=0, atol=rounding * rms(whole.uncertainty))
    # each part judges the noise of its readings by itself
    assert rms(found.uncertainty) == pytest.approx(rms(whole.uncertainty), rel=0.05)
    name = "mass, stiffness, damping, delay"
    assert found.budget[name] == pytest.approx(whole.budget[name], rel=1e-6)


@pytest.mark.soak(first=0)
def test_steps_and_numbers_hardly_depend_on_where_the_record_ends(rng):
    """Parts are others then, with priors of their own: an error of a tenth of u is half a percent of it."""
    record = run(rng, count=18_000, steps=(7168.3,))
    long, short = (divided(one).force().only for one in (record, record.part(0, 16_000)))
    assert rms(((long.values[:16_000] - short.values) / short.uncertainty)[:15_000]) < 0.15
    assert rms(long.uncertainty[:15_000]) == pytest.approx(rms(short.uncertainty[:15_000]), rel=0.05)
    (one,), (other,) = long.steps, short.steps
    assert one.instant == pytest.approx(other.instant, abs=0.3 * other.instant_uncertainty)
    assert one.height == pytest.approx(other.height, abs=0.3 * other.height_uncertainty)


@pytest.mark.soak(first=0)
def test_budget_of_parts_is_that_of_the_whole(rng):
    record = run(rng, count=22_000, relative_uncertainty=0.002, zero_uncertainty=0.3)
    whole, found = (work.only for work in (estimate_force(record, UNSURE), divided(record, UNSURE).force()))
    for one, other in zip(scalars(whole), scalars(found), strict=True):
        assert one.value == pytest.approx(other.value, abs=0.2 * one.u), one.name
        assert one.u == pytest.approx(other.u, rel=0.05), one.name
        for name in ("zero of the readings", "gain of the readings", "mass, stiffness, damping, delay"):
            # what is wrong throughout does not average out over the parts
            assert one.parts[name] == pytest.approx(other.parts[name], rel=0.05, abs=0.01 * one.u), (one.name, name)
    known = {row.name: row for row in component_budget(found)}
    for row in component_budget(whole):
        if "leaves open" in row.name:
            continue  # what a record leaves open its parts may show, or the other way
        assert known[row.name].rms == pytest.approx(row.rms, rel=0.05, abs=0.01 * rms(whole.uncertainty)), row.name
    assert known[JOINTS].rms < 0.1 * rms(whole.uncertainty)
    one, other = (spectrum(estimate, rate=RATE) for estimate in (whole, found))
    low = one.frequency < 35
    # segments that lie otherwise weigh the samples otherwise: the power of 35 Hz in 14 s is known to 1 / sqrt(35 * 14)
    np.testing.assert_allclose(one.density[low].sum(), other.density[low].sum(), rtol=0.2)
    assert found.uncertainty == pytest.approx(
        np.sqrt(sum(part.deviation**2 for part in found.contributions)), rel=0.05
    )


def test_regression_on_a_divided_force_has_the_uncertainty_of_the_whole(rng):
    record = run(rng, zero_uncertainty=0.3)
    whole, found = (work.only for work in (estimate_force(record, T128), divided(record).force()))
    one, other = (regress(estimate, {"mean": 1.0}) for estimate in (whole, found))
    assert np.sqrt(one.measured[0, 0]) == pytest.approx(0.3, rel=0.01)
    assert other.measured[0, 0] == pytest.approx(one.measured[0, 0], rel=0.01)


@pytest.mark.soak(first=0)
def test_monte_carlo_of_a_divided_force_is_of_its_worst_part(rng):
    force = divided(run(rng)).force()
    with pytest.warns(
        DataQualityWarning, match=r"Monte Carlo is of the part with the largest uncertainty, part \d+ of"
    ):
        checked = monte_carlo(force, draws=50)["AF"]
    part, _ = force.worst()
    assert checked.deviation.size == part.recording.samples < force.recording.samples
    whole = next(item for item in checked.contributions if item.name == "all together")
    assert whole.agrees


# --- gaps, silence, constants


@pytest.mark.filterwarnings("ignore:.*may rise at low frequency")  # one record in some leaves that open
def test_a_gap_over_a_joint_is_bridged(rng):
    joint = parts_by_samples(14_000)[1].first
    gap = slice(joint - 168, joint + 132)
    record = run(rng, missing=gap)
    whole, found = estimate_force(record, T128).only, divided(record).force().only
    apart = (found.values - whole.values) / whole.uncertainty
    assert rms(apart[gap]) < 0.2
    assert rms(found.uncertainty[gap]) == pytest.approx(rms(whole.uncertainty[gap]), rel=0.1)


@pytest.mark.filterwarnings("ignore:.*no readings there, up to an end of the record or of a part:UserWarning")
def test_a_part_without_readings_has_no_force_and_says_so(rng):
    record = run(rng, count=30_000)
    whole = estimate_force(record, T128).only
    load = record.channel("AF").values.copy()
    _, silent, other, *_ = parts_by_samples(30_000)
    begin, end = silent.begin - 144, other.end + 520
    load[begin:end] = np.nan
    record = replace(record, channels={"AF": Channel("AF", load, "N")})
    with pytest.warns(DataQualityWarning, match=f"{silent.told(record)}: there are not 32 readings"):
        found = divided(record).force().only
    unknown = np.isnan(found.values)
    assert unknown[silent.first + silent.margin : silent.stop].all()
    assert not unknown[:begin].any()
    assert not unknown[end:].any()
    apart = (found.values - whole.values) / whole.uncertainty
    assert rms(apart[: begin - 1000]) < 0.2
    assert rms(apart[end + 1000 :]) < 0.2
    assert scalars(found)[0].value == pytest.approx(found.values[~unknown].mean())


def test_a_record_without_readings_is_refused(rng):
    record = run(rng, missing=slice(0, 14_000))
    with pytest.raises(FitError, match="no part of the record has 32 readings"):
        list(divided(record).parts())


@pytest.mark.parametrize("value", [0.0, 12.5])
def test_a_constant_record_stays_constant(value):
    load = np.full(14_000, value)
    record = Recording.from_columns(np.arange(load.size) / RATE, {"AF": Channel("AF", load, "N")}, name="still")
    with pytest.warns(DataQualityWarning, match="the channel is dead"):
        found = divided(record).force().only
    np.testing.assert_allclose(found.values, value, atol=1e-6 * (1 + value))
    assert not found.steps


def test_hum_of_all_parts_is_one_line(rng):
    record, time = run(rng), np.arange(14_000) / RATE
    load = record.channel("AF")
    humming = replace(load, values=load.values + 20.0 * np.sin(2 * np.pi * 150 * time + 1))
    settings = ForceSettings(hum=(150.0,))
    (line,) = divided(replace(record, channels={"AF": humming}), settings=settings).force().only.hum
    # 2 N of noise in 7000 readings leave 2 sqrt(2 / 7000) = 0.03 N of an amplitude, and sqrt(6) / (pi T) of 0.03 / 20
    # of a frequency over T = 4.4 s
    assert line.amplitude == pytest.approx(20.0, abs=0.2)
    assert line.frequency == pytest.approx(150.0, abs=2e-3)


def test_tones_of_all_parts_are_one_line(rng):
    """What is kept of the parts has each tone of the force once, with its size in the force."""
    record, time = run(rng), np.arange(14_000) / RATE
    load, frequency = record.channel("AF"), 8.1
    driven = replace(load, values=load.values + 40.0 * np.sin(2 * np.pi * frequency * time + 1))
    (line,) = divided(replace(record, channels={"AF": driven})).force().only.tones
    # the load has 20^2 / 40 N^2/Hz there as well: in the T = 5 s of a part s = sqrt(2 * 10 / T) = 2 N of an amplitude
    # and sqrt(6) / (pi T) of s / 40 N of a frequency, 0.008 Hz
    assert line.frequency == pytest.approx(frequency, abs=5 * 0.008)
    assert line.amplitude == pytest.approx(40.0 / abs(T128.response(frequency)), abs=5 * 2.0)


def test_parts_that_contradict_each_other_are_told(rng):
    """Where the second part's readings jump by a slow drift of the amplifier, each part takes another level."""
    record = run(rng)
    changed = {}

    class Restless:
        """A source that reads otherwise the second time: the two parts have seen different samples."""

        name, samples, rate, start = record.name, record.samples, record.rate, record.start

        def part(self, begin, end):
            one = record.part(begin, end)
            channel = one.channel("AF")
            changed[begin] = channel.values + (40.0 if begin else 0.0)
            return replace(one, channels={"AF": replace(channel, values=changed[begin])})

    with pytest.warns(DataQualityWarning, match=r"by this part and the one before differ by 40 N rms"):
        parts = list(divided(Restless()).parts())
    joint = parts_by_samples(record.samples)[1].first - parts[1].first
    # half way between the two the standard deviation of one or the other is half their difference
    assert parts[1].uncertainty["AF"][joint] == pytest.approx(20.0, rel=0.05)


@pytest.mark.filterwarnings("ignore:.*may rise at low frequency:UserWarning")  # noise that some records leave open
@pytest.mark.soak(first=0)
def test_dynamics_that_one_part_shows_to_be_others_count_in_those_after_it(rng):
    """A step rings with another frequency in the first part; later a slow force does not show it, and is as wrong.

    Its error is known: the difference to what the right dynamics give.
    """
    record = run(rng, count=30_000, steps=[3000])
    wrong = T128.retuned(frequency=1.05, damping=1.0)
    with pytest.warns(DataQualityWarning, match="natural frequency"):
        parts = list(divided(record, wrong).parts())
    right = divided(record).force().only.values
    last = parts[-1]
    assert not last.doubts
    own = slice(last.first, last.first + last.values["AF"].size)
    error, u = last.values["AF"] - right[own], last.uncertainty["AF"]
    # the part of its force that an error goes with may be twice or half of what it is in the first part
    assert 0.4 < rms(error) / rms(u) < 2.0
    assert any(one.name == "doubt: natural frequency" for one in last.contributions["AF"])
    squares = sum(one.deviation**2 for one in last.contributions["AF"])
    # beside the joint the error of the part before has its share, of the same size but for what each sees of it
    assert np.mean(np.abs(u / np.sqrt(squares) - 1) < 0.05) > 0.9
    assert u == pytest.approx(np.sqrt(squares), rel=0.2)


# --- words


def test_what_is_said_of_all_parts_is_said_once():
    record = Recording.from_columns(np.arange(3000) / 10, {"AF": Channel("AF", np.zeros(3000), "N")}, name="run")
    parts = parts_of(3000, length=1000, margin=100)
    told = PartWarnings(record)
    for part in parts:
        told.add(part, "run: pitch is not recorded")
        told.add(part, f"run: hum of {part.number}.5e-3 N")
    told.add(parts[1], "run: there is a gap")
    assert list(told.sentences()) == [
        "run: pitch is not recorded",
        "run: in part 1 of 4, from 0 s to 90 s: hum of 1.5e-3 N (and the like in 3 further parts)",
        "run: in part 2 of 4, from 90 s to 170 s: there is a gap",
    ]


def test_the_part_with_most_of_it_is_told():
    record = Recording.from_columns(np.arange(3000) / 10, {"AF": Channel("AF", np.zeros(3000), "N")}, name="run")
    told = PartWarnings(record)
    for part, count in zip(parts_of(3000, length=1000, margin=100), (3, 50, 7, 12), strict=True):
        told.add(part, OfMissing.readings("run", "AF", count, 1000))
        told.add(part, OfLoads(f"run: N1 leaves the range by {count} %", count / 100))
        told.add(part, OfLoads("run: N2 leaves the range by 5 %", 0.05))
    missing, first, second = told.sentences()
    assert missing.startswith("run: in part 2 of 4, from 90 s to 170 s: 50 of 1000 samples of AF are missing")
    assert first.endswith("to 170 s: N1 leaves the range by 50 % (and the like in 3 further parts)")
    assert second == "run: N2 leaves the range by 5 %"  # of another bridge, whose name has another digit


def test_a_summary_of_no_force_is_refused():
    with pytest.raises(ValueError, match="no part of the record has a force of AF"):
        _ = SummaryOfParts("AF", 11_000, 1).summary


@pytest.mark.soak(first=0)
def test_the_mean_of_a_divided_force_is_as_uncertain_as_that_of_the_whole(rng):
    record = run(rng, count=40_000, relative_uncertainty=0.01, zero_uncertainty=1.0)
    parts, whole = mean_loads(divided(record, UNSURE).force()), mean_loads(estimate_force(record, UNSURE))
    # gain, zero and dynamics are one error all along; the parts have learned other priors, which changes no mean
    assert parts.errors.common[0, 0] == pytest.approx(whole.errors.common[0, 0], rel=1e-3)


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # one of many leaves noise open
@pytest.mark.soak(first=0)
def test_numbers_of_a_force_with_a_silent_part_are_those_of_the_rest(rng):
    record = run(rng, count=40_000)
    values = record.channel("AF").values.copy()
    values[10_000:30_000] = np.nan
    gone = replace(record, channels={"AF": Channel("AF", values, "N")})
    with pytest.warns(DataQualityWarning, match="there is no force"):
        force = divided(gone).force()
    assert np.isnan(force["AF"].values).any()
    for text in (repr(force["AF"]), str(force)):
        assert "nan" not in text
    with pytest.raises(FitError, match="have no force in this span"):
        regress(force["AF"], {"mean": 1.0})


@pytest.mark.parametrize(("some", "told"), [(2, False), (3, True)])
def test_what_a_few_of_many_parts_leave_open_is_chance(some, told) -> None:
    """Of 58 sound parts three or more leave something open once in a hundred records, each by 0.7 %."""
    one = Doubt("natural frequency", "AF", "may ring elsewhere", effect=1.0, probability=0.9)
    parts = [(one, f"in part {number} of 58") for number in range(some)]
    assert bool(of_all_parts(parts, parts=58)) is told
    assert of_all_parts(parts, parts=4)
    sure = Doubt("natural frequency", "AF", "rings elsewhere", effect=1.0)
    assert of_all_parts([(sure, "in part 3 of 58")], parts=58)
