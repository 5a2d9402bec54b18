"""Recording: the steady clock behind a time column, gaps, missing samples and saturation."""

import re
import warnings

import numpy as np
import pytest

from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import Channel, CrossAxis
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.jitter import following
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps
from aerobalance.recording.sensors import corrected


def on(stamps, values=None):
    stamps = np.asarray(stamps)
    channel = Channel("AF", np.arange(stamps.size, dtype=float) if values is None else values, "N")
    return Recording.from_columns(stamps, {"AF": channel}, name="rec")


@pytest.mark.parametrize("rate", [1.0, 100.0, 1600.0, 25000.0, 3.0])
@pytest.mark.parametrize("start", [0.0, -12.3, 1.7e9])
def test_a_steady_clock_is_found(rate, start):
    count = 5000
    recording = on(start + np.arange(count) / rate)
    # Stamps are rounded to half an ulp of the start; the slope of 5000 of them is far better than one of them.
    rounding = np.spacing(abs(start) + count / rate)
    if rounding * rate > 0.1:
        pytest.skip("the stamps do not resolve the clock")
    assert recording.rate == pytest.approx(rate, rel=max(rounding * rate / count, 1e-12))
    assert recording.start == pytest.approx(start, abs=max(2 * rounding, 1e-12))
    assert recording.samples == count
    assert recording.gaps == []
    np.testing.assert_allclose(recording.time, recording.stamps, atol=max(2 * rounding, 1e-9))


@pytest.mark.parametrize("decimals", [6, 5, 4])
def test_rounded_stamps_give_the_true_rate(decimals):
    rate, count = 1600.0, 4000
    stamps = np.round(np.arange(count) / rate, decimals)
    recording = on(stamps)
    assert recording.samples == count
    # Rounding errors of half a digit at most, in a fit over 4000 rows: the slope errs by less than 6 of them / n.
    assert recording.rate == pytest.approx(rate, rel=6 * 0.5 * 10.0**-decimals * rate / count)


@pytest.mark.parametrize("decimals", [9, 4])
@pytest.mark.parametrize("lost", [[1], [2000], [3998], [10, 11, 12], [500, 2500, 2501], list(range(1000, 1900))])
def test_gaps_are_found_wherever_they_are_also_with_rounded_stamps(decimals, lost):
    rate, count = 1600.0, 4000
    kept = np.setdiff1d(np.arange(count), lost)
    with pytest.warns(DataQualityWarning, match=rf"{len(lost)} sample.s. are missing from the time column"):
        recording = on(np.round(kept / rate, decimals), kept.astype(float))
    np.testing.assert_array_equal(recording.rows, kept)
    np.testing.assert_array_equal(np.flatnonzero(recording.channel("AF").missing), lost)
    assert recording.rate == pytest.approx(rate, rel=1e-4)
    assert sum(length for _, length in recording.gaps) == pytest.approx(len(lost) / rate, rel=1e-3)


@pytest.mark.parametrize("count", [5, 8, 20, 101])
def test_one_lost_sample_is_found_in_short_recordings_too(count):
    for lost in range(1, count - 1):
        kept = np.setdiff1d(np.arange(count), lost)
        with pytest.warns(DataQualityWarning, match=r"1 sample.s. are missing"):
            recording = on(kept * 0.01)
        np.testing.assert_array_equal(recording.rows, kept)


def test_gaps_are_found_under_jitter(rng):
    kept = np.delete(np.arange(3000), [700, 701, 2222])
    stamps = kept * 0.01 + rng.uniform(-1.5e-3, 1.5e-3, kept.size)
    with pytest.warns(DataQualityWarning) as caught:
        recording = on(stamps)
    np.testing.assert_array_equal(recording.rows, kept)
    said = " ".join(str(item.message) for item in caught)
    assert "3 sample(s) are missing" in said
    assert "depart from a steady" in said


def test_jitter_alone_is_no_gap(rng):
    stamps = np.arange(5000) * 0.01 + rng.uniform(-4e-3, 4e-3, 5000)
    with pytest.warns(DataQualityWarning, match=r"depart from a steady .* by up to 0\.[34]"):
        recording = on(stamps)
    assert recording.samples == 5000
    # Uniform jitter of 4 ms: its standard deviation times sqrt(12) / n^1.5 is the slope's; eight of them.
    assert recording.rate == pytest.approx(100, rel=8 * 0.4 / np.sqrt(3) * np.sqrt(12) / 5000**1.5)


def test_little_jitter_is_not_worth_a_warning(rng):
    assert on(np.arange(5000) * 0.01 + rng.uniform(-5e-4, 5e-4, 5000)).samples == 5000


def test_equal_stamps_are_said():
    stamps = np.arange(2000) * 0.01
    stamps[700] = stamps[699]
    with pytest.warns(DataQualityWarning, match=r"1 time stamp\(s\) repeat the one before.*evenly spaced"):
        recording = on(stamps)
    assert recording.samples == 2000


def test_stamps_coarser_than_the_interval_are_said():
    stamps = np.round(np.arange(5000) / 1600, 2)
    with pytest.warns(DataQualityWarning, match=r"rounded to 0\.01 s, more than a sampling interval"):
        recording = on(stamps)
    assert recording.samples == 5000
    assert recording.rate == pytest.approx(1600, rel=6 * 0.005 * 1600 / 5000)


def swing(time):
    """A signal of two tones, at 0.04 and 0.15 of 100 Hz, about an offset."""
    return 50 + np.sin(2 * np.pi * 4.1 * time) + 0.5 * np.cos(2 * np.pi * 15.3 * time)


def check_said_error(recording, said, noise=0.0):
    """The samples are off by what was said, and what was said is below 2 % of the signal or near the truth."""
    values = recording.channel("AF").values
    off = (values - swing(recording.time))[np.isfinite(values)]
    error, gain = (float(part) for part in re.search(r"AF (\S+) N rms, noise times (\S+)", said).groups())
    stated = np.hypot(error, gain * noise)
    assert np.sqrt(np.mean(off**2)) < 1.2 * stated + 1e-4
    assert stated < max(1.3 * np.std(off), 0.02)


def test_a_clock_that_wanders_is_no_gap_and_is_put_on_a_steady_one():
    index = np.arange(10000)
    stamps = index * 0.01 + 0.03 * np.sin(2 * np.pi * index / 10000)
    with pytest.warns(DataQualityWarning, match="interpolated to a steady") as caught:
        recording = on(stamps, swing(stamps))
    assert recording.samples == pytest.approx(10000, abs=8)
    np.testing.assert_array_equal(recording.rows, np.arange(recording.samples))
    np.testing.assert_allclose(recording.stamps, recording.time, atol=1e-9)
    check_said_error(recording, str(caught[0].message))


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("sd", [0.05, 0.5, 0.2, 0.1, 0.3])
@pytest.mark.soak(first=4)
def test_samples_that_jitter_are_put_on_a_steady_clock(sd, noise, rng):
    late = rng.normal(0, sd, 5000) if sd < 0.3 else rng.uniform(-np.sqrt(3) * sd, np.sqrt(3) * sd, 5000)
    stamps = np.sort(np.arange(5000) + late) * 0.01
    given = Channel("AF", swing(stamps) + noise * rng.normal(size=5000), "N", noise=noise or None)
    with pytest.warns(DataQualityWarning) as caught:
        recording = Recording.from_columns(stamps, {"AF": given}, name="rec")
    said = " ".join(str(item.message) for item in caught)
    assert "the samples were not taken evenly" in said
    assert f"jitter {np.std(late):.1f}"[:9] in said or sd < 0.1
    check_said_error(recording, said, noise)
    if noise:
        error, gain = (float(part) for part in re.search(r"AF (\S+) N rms, noise times (\S+)", said).groups())
        assert recording.channel("AF").noise == pytest.approx(np.hypot(gain * noise, error), rel=0.05)
    # as they are, in their order, they would be off by the slope times the jitter
    assert np.std(given.values - swing(stamps[0] + np.arange(5000) * 0.01)) > 1.5 * noise


@pytest.mark.parametrize("sd", [0.05, 0.2, 0.4])
def test_samples_whose_stamps_alone_jitter_stay_as_they_are(sd, rng):
    stamps = np.sort(np.arange(5000) + rng.normal(0, sd, 5000)) * 0.01
    values = swing(np.arange(5000) * 0.01) + 0.01 * rng.normal(size=5000)
    with pytest.warns(DataQualityWarning, match="evenly spaced: the readings do not follow them"):
        recording = on(stamps, values)
    np.testing.assert_array_equal(recording.channel("AF").values, values)


def test_who_jitters_is_told_of_readings_of_any_size(rng):
    late = 0.2 * rng.standard_normal(2000)
    values = np.sin(0.3 * (np.arange(2000) + late))
    first = following([values], late)
    assert first.share == pytest.approx(1, abs=0.1)
    for scale in (2.0**300, 2.0**-300):
        assert following([scale * values], late) == first


def test_readings_that_do_not_tell_stay_as_they_are_and_it_is_said(rng):
    stamps = np.arange(5000) * 0.01 + rng.uniform(-3e-3, 3e-3, 5000)
    values = 0.003 * swing(stamps) + rng.normal(size=5000)  # noise far above what the jitter does
    with pytest.warns(DataQualityWarning, match="do not tell whether they were; if they were not.* N of AF"):
        recording = on(stamps, values)
    np.testing.assert_array_equal(recording.channel("AF").values, values)


def test_gaps_and_missing_samples_stay_missing_where_samples_jitter(rng):
    kept = np.setdiff1d(np.arange(5000), [*range(900, 960), 3000])
    stamps = kept * 0.01 + rng.uniform(-2e-3, 2e-3, kept.size)
    values = swing(stamps)
    values[2000:2005] = np.nan
    with pytest.warns(DataQualityWarning) as caught:
        recording = on(stamps, values)
    missing = np.isnan(recording.channel("AF").values)
    lost = np.flatnonzero(missing)
    for first, last in ((901, 958), (2061, 2063)):
        assert missing[first : last + 1].all()
    assert lost.size < 60 + 1 + 5 + 10
    check_said_error(recording, " ".join(str(item.message) for item in caught if "interpolated" in str(item.message)))


def test_saturated_readings_are_left_out_where_samples_jitter(rng):
    stamps = np.arange(5000) * 0.01 + rng.uniform(-2e-3, 2e-3, 5000)
    full = 20 * (swing(stamps) - 50)
    with pytest.warns(DataQualityWarning, match="saturated samples left out"):
        recording = on(stamps, np.minimum(full, 10.0))
    values, truth = recording.channel("AF").values, 20 * (swing(recording.time) - 50)
    known = np.isfinite(values)
    assert np.isnan(values[truth > 14]).mean() > 0.9
    # what is beside a clipped stretch is known less well, by the curvature over one interval
    assert np.std((values - truth)[known]) < 0.5


def test_a_rate_that_changes_is_refused_and_it_is_said_what_to_do():
    stamps = np.concatenate((np.arange(1000) * 0.001, 1 + np.arange(1000) * 0.0013))
    with pytest.raises(FitError, match=r"rec: the time column fits no steady clock.*cut the recording where the rate"):
        on(stamps, swing(stamps))


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        ([], r"0 row\(s\)"),
        ([1.0], r"1 row\(s\)"),
        ([0, 1, np.nan], "time of sample 3 is not a number"),
        ([0, 1, np.inf], "time of sample 3 is not a number"),
        ([3, 2, 1], "sample 2 is at 2 s, after 3 s"),
        ([0, 1, 2, 1.5, 3], r"sample 4 is at 1\.5 s, after 2 s"),
        ([1, 1, 1], "must increase"),
        ([0, 1, 1, 2, 1.5], r"sample 5 is at 1\.5 s, after 2 s"),
        ([0, 1, 1.1, 3.7, 3.9, 9], "no steady clock"),
        ([0, 1, 2, 3, 1e9], "jumps from 3 s to 1e.09 s at sample 5.*cut the recording"),
    ],
)
def test_time_columns_that_carry_no_clock(stamps, said):
    with pytest.raises(FitError, match=said):
        on(np.array(stamps, dtype=float))


def test_clock_finding_never_fails_otherwise(rng):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for trial in range(500):
            count = int(rng.integers(2, 40))
            stamps = np.sort(np.round(rng.choice([1e-4, 1, 1e9]) * rng.random(count), int(rng.integers(0, 8))))
            try:
                recording = on(stamps)
            except FitError:
                continue
            assert recording.rate > 0, trial
            assert (np.diff(recording.rows) > 0).all(), trial
            # Rows are where their stamps are, to a sampling interval and what the stamps are rounded to.
            coarse = np.min(np.diff(stamps)[np.diff(stamps) > 0]) * recording.rate
            off = np.abs(recording.time[recording.rows] - recording.stamps) * recording.rate
            assert off.max() <= max(1.0, coarse) + 1e-6, trial


def test_channels_have_a_reading_per_row():
    with pytest.raises(ValueError, match="channel AF has 3 readings for 2 time stamps"):
        Recording.from_columns(np.arange(2.0), {"AF": Channel("AF", np.zeros(3), "N")})


def test_channel_settings_survive_the_clock():
    given = Channel(
        "ground_acceleration",
        np.zeros(5),
        "m/s^2",
        noise=0.1,
        relative_uncertainty=0.01,
        delay=1e-6,
        coupling="ac",
        corner=0.5,
        file_unit="g",
    )
    found = Recording.from_columns(np.arange(5.0), {given.name: given}).channel(given.name)
    assert found.known() == given.known()
    assert (found.name, found.unit, found.file_unit) == (given.name, given.unit, given.file_unit)


def test_a_channel_is_fixed_but_the_callers_array_is_not():
    values = np.zeros(3)
    channel = Channel("AF", values, "N")
    with pytest.raises(ValueError, match="read-only"):
        channel.values[0] = 1
    values[0] = 2
    assert values[0] == 2


def test_wrong_channels():
    with pytest.raises(ValueError, match="AF must be in N inside, not kN"):
        Channel("AF", np.zeros(3), "kN")
    with pytest.raises(ValueError, match="shape"):
        Channel("AF", np.zeros((3, 1)), "N")
    with pytest.raises(ValueError, match="noise"):
        Channel("AF", np.zeros(3), "N", noise=-1)
    with pytest.raises(FitError, match="rec has no channel PM; it has AF"):
        on(np.arange(3.0)).channel("PM")


def saturated(values):
    return np.flatnonzero(Channel("AF", np.asarray(values, dtype=float), "N").saturated)


TIME = np.arange(4000) / 4000


@pytest.mark.parametrize("level", [0.3, 0.8, 0.95, 0.99])
@pytest.mark.parametrize("bits", [None, 12, 16])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_clipped_sine_is_found(level, bits, sign):
    full = sign * np.sin(2 * np.pi * 20.3 * TIME)
    values = np.clip(full, -level, level)
    if bits:
        values = np.clip(np.round(full * 2 ** (bits - 1)), -np.floor(level * 2 ** (bits - 1)), level * 2 ** (bits - 1))
        values = np.minimum(values, np.floor(level * 2 ** (bits - 1)))
    found = saturated(values)
    clipped = np.abs(full) > level * 1.001
    assert (np.abs(values[found]) == np.abs(values).max()).all()
    assert np.isin(np.flatnonzero(clipped), found).mean() > 0.9


def test_a_clipped_ringing_with_noise_is_found(rng):
    full = np.exp(-TIME * 3) * np.cos(2 * np.pi * 66.4 * TIME) + rng.normal(0, 0.01, TIME.size)
    found = saturated(np.minimum(full, 0.6))
    assert found.size > 50
    assert (full[found] >= 0.6).all()


def test_what_is_no_saturation(rng):
    sine = np.sin(2 * np.pi * 20.3 * TIME)
    square = np.where(np.sin(2 * np.pi * 5 * TIME) > 0, 1.0, 0.0)
    ringing = np.exp(-TIME * 3) * np.cos(2 * np.pi * 66.4 * TIME)
    cases = {
        "noise-free step": np.where(TIME < 0.5, 1020.0, 0.0),
        "square wave": square,
        "square wave beside fine detail": np.where(square > 0, 1.0, 0.1 * sine),
        "quantised sine": np.round(sine * 20),
        "finely quantised sine": np.round(sine * 2000),
        "slow quantised sine": np.round(np.sin(2 * np.pi * 2 * TIME) * 200),
        "quantised noise": np.round(rng.normal(0, 2, TIME.size)),
        "coarse noise": np.round(rng.normal(0, 0.6, TIME.size)),
        "ringing": ringing,
        "quantised ringing": np.round(ringing * 500) / 500,
        "constant": np.ones(4000),
        "zero": np.zeros(4000),
        "all missing": np.full(4000, np.nan),
        "two samples": [1.0, 2.0],
        "one level and missing": np.where(TIME < 0.5, 1.0, np.nan),
        "one level broken by missing samples": np.where(np.arange(4000) % 10 == 0, np.nan, 1.0),
        "infinite samples": np.where(np.arange(4000) % 10 == 0, np.inf, np.round(sine * 3)),
        "long plateaus": np.clip(20 * np.sin(2 * np.pi * 2 * TIME), -1, 1),
        "sine and hold beside missing": np.where(sine > 0.9, np.nan, sine),
    }
    for name, values in cases.items():
        assert saturated(values).size == 0, name


def test_rounded_stamps_tell_the_rate_by_their_turns():
    # in whole seconds, from 0.4 s on: the turns to 1 and 2 s are 2000 samples apart, and tell the rate to 0.04 %
    time = 0.4 + np.arange(4000) / 2000
    with pytest.raises(FitError, match=r"rounded to 1 s, and its 2 turn\(s\) tell the sampling rate to 0.035 % only"):
        Recording.from_columns(np.floor(time), {"AF": Channel("AF", time, "N")})
    with pytest.raises(FitError, match=r"its 1 turn\(s\) tell the sampling rate not at all"):
        Recording.from_columns(np.floor(time[:2000]), {"AF": Channel("AF", time[:2000], "N")})
    time = 0.4 + np.arange(40_000) / 2000
    with pytest.warns(DataQualityWarning, match=r"2000 Hz \(known to 0.0006 %\)"):  # 20 turns over 38 000 samples
        found = Recording.from_columns(np.floor(time), {"AF": Channel("AF", time, "N")})
    assert found.rate == pytest.approx(2000, rel=6e-6)


def test_a_stated_uncertainty_rests_on_no_limit():
    values = np.clip(np.sin(np.arange(400) / 5), -0.7, 0.7)
    assert Channel("AF", values, "N").saturated.any()
    assert not Channel("u_AF", values, "N").saturated.any()


def test_series_of_sep005_go_both_ways() -> None:
    stamps = 0.25 + np.arange(50) / 100
    given = [
        {"data": np.sin(stamps), "name": "AF", "unit_str": "kN", "fs": 100.0, "time": stamps},
        {"data": 0.1 * stamps, "name": "pitch", "unit_str": "deg", "fs": 100.0, "time": stamps},
    ]
    for one in given:
        one["start_timestamp"] = "2024-03-12T10:15:00.125"
    found = Recording.from_sep005(given)
    assert found.epoch == np.datetime64("2024-03-12T10:14:59.875", "ns")
    np.testing.assert_allclose(found.channel("AF").values, 1e3 * np.sin(stamps), rtol=1e-15)
    assert (found.rate, found.start) == pytest.approx((100.0, 0.25), rel=1e-12)
    for one, other in zip(found.to_sep005(), given, strict=True):
        np.testing.assert_allclose(one["data"], other["data"], rtol=1e-15)
        np.testing.assert_allclose(one["time"], stamps, rtol=1e-12)
        assert (one["name"], one["unit_str"]) == (other["name"], other["unit_str"])
        assert np.datetime64(one["start_timestamp"]) == np.datetime64(other["start_timestamp"])
    single = Recording.from_sep005({"data": np.arange(4.0), "name": "AF", "unit_str": "N", "fs": 10})
    np.testing.assert_allclose(single.time, [0, 0.1, 0.2, 0.3], atol=1e-15)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"unit_str": None}, "series 2 has no unit_str; SEP-005 asks for"),
        ({"fs": None}, "series 2 has no fs"),
        ({"fs": 50.0}, "AF and pitch have different clocks; make a recording of those of each clock"),
        ({"data": np.zeros(7)}, "AF and pitch have different clocks"),
        ({"name": "AF"}, "two of the series have one name"),
        ({"start_timestamp": "2025-01-01T00:00:00"}, "the series begin at different times"),
        ({"unit_str": "N"}, "an angle is expected"),
    ],
)
def test_series_of_sep005_that_do_not_fit_are_refused(change, words) -> None:
    first = {"data": np.arange(8.0), "name": "AF", "unit_str": "N", "fs": 100.0, "start_timestamp": "2024-03-12T10:15"}
    second = {**first, "name": "pitch", "unit_str": "deg"} | change
    with pytest.raises(ValueError, match=words):
        Recording.from_sep005([first, {key: value for key, value in second.items() if value is not None}])


def test_what_a_sensor_feels_across_its_axis_is_taken_off_in_a_gap_of_the_other():
    across = np.full(1000, 9.8)
    across[500] = np.nan
    channels = {
        "ground_acceleration": Channel(
            "ground_acceleration", np.full(1000, 0.49), "m/s^2", cross_axis=(CrossAxis("ground_acceleration_z", 0.05),)
        ),
        "ground_acceleration_z": Channel("ground_acceleration_z", across, "m/s^2"),
    }
    given = Recording.from_columns(np.arange(1000) / 1600, channels, name="run")
    assert corrected(given).channel("ground_acceleration").values == pytest.approx(np.zeros(1000), abs=1e-12)


def test_a_filter_slower_than_the_record_leaves_no_sample_beside_a_gap(rng):
    values = rng.normal(size=1000)
    values[500] = np.nan
    channel = Channel("AF", values, "N", filter=AntiAlias("bessel", 4, 1.0))
    found = corrected(Recording.from_columns(np.arange(1000) / 1600, {"AF": channel}, name="run")).channel("AF")
    assert np.count_nonzero(found.missing) >= 998


def test_a_gap_in_a_constant_load_is_filled_with_it():
    loads = np.full((500, 1), 3.0)
    loads[100:105] = np.nan
    assert (interpolate_gaps(loads) == 3.0).all()
    with pytest.raises(FitError, match="no reading is present"):
        interpolate_gaps(np.full((500, 1), np.nan))


def test_series_of_which_a_later_one_has_the_date_and_series_without_a_clock():
    first = {"data": np.arange(20.0), "name": "AF", "unit_str": "N", "fs": 100.0}
    second = {**first, "name": "NF", "start_timestamp": "2024-01-01T00:00:00"}
    for series in ([first, second], [second, first]):
        assert Recording.from_sep005(series).epoch == np.datetime64("2024-01-01")
    with pytest.raises(ValueError, match="fs"):
        Recording.from_sep005([{"data": np.arange(20.0), "name": "AF", "unit_str": "N", "time": None}])
    with pytest.raises(ValueError, match="has no sample"):
        Recording.from_sep005([{**first, "data": np.zeros(0)}])


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
def test_a_column_without_readings_stays_so_on_a_steady_clock(rng):
    time = np.sort(np.arange(3000) / 1000 + rng.normal(size=3000) * 2.5e-4)
    found = Recording.from_arrays(time, {"AF": np.sin(2 * np.pi * 60 * time), "NF": np.full(3000, np.nan)})
    assert found.channel("NF").missing.all()
    assert not found.channel("AF").missing.all()
