"""Gauge outputs over excitation."""

import numpy as np
import pytest

from aerobalance.balance.bridge_outputs import gauge_outputs
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import is_gauge
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording

RATE = 1000.0


def recording(*, excitation=None, missing_excitation=False, **volts):
    """A recording of gauge outputs given in V (and of an excitation)."""
    channels = {name: Channel(name, np.asarray(values), "V", file_unit="V") for name, values in volts.items()}
    if not missing_excitation:
        channels["excitation"] = Channel("excitation", np.asarray(excitation), "V", file_unit="V")
    samples = next(iter(channels.values())).values.size
    stamps = np.arange(samples) / RATE
    return Recording("run", stamps, np.arange(samples), 0.0, RATE, channels)


def test_names_of_gauges():
    assert all(is_gauge(name) for name in ("rNF", "rAF", "rN1", "rAft_Pitch", "rAx", "rRoll", "rY1"))
    assert not any(is_gauge(name) for name in ("roll", "rate", "NF", "r", "rn1", "rN 1", "u_rN1", ""))


@pytest.mark.parametrize("name", ["rAF", "rN1", "rAft_Pitch"])
def test_a_gauge_is_in_millivolts_per_volt_or_volts(name):
    for unit in ("mV/V", "V"):
        assert Channel(name, np.zeros(3), unit).unit == unit
    with pytest.raises(ValueError, match="must be in mV/V or V inside, not N"):
        Channel(name, np.zeros(3), "N")
    with pytest.raises(ValueError, match="must be in V inside"):
        Channel("excitation", np.zeros(3), "mV/V")


def test_volts_over_a_constant_excitation():
    volts = np.array([0.01, -0.02, 0.005] * 20)
    given = recording(excitation=np.full(60, 8.0), rN1=volts)
    found = gauge_outputs(given)
    np.testing.assert_allclose(found.channel("rN1").values, volts / 8.0 * 1e3, rtol=1e-14)
    assert (found.channel("rN1").unit, found.channel("rN1").file_unit) == ("mV/V", "mV/V")
    assert found.channel("excitation") is given.channel("excitation")
    assert given.channel("rN1").unit == "V"


def test_outputs_in_millivolts_per_volt_stay_as_they_are():
    given = recording(excitation=np.full(9, 8.0), rAF=np.ones(9))
    ready = Channel("rN1", np.arange(9.0), "mV/V")
    channels = {**given.channels, "rN1": ready}
    mixed = Recording("run", given.stamps, given.rows, 0.0, RATE, channels)
    assert gauge_outputs(mixed).channel("rN1") is ready
    alone = Recording("run", given.stamps, given.rows, 0.0, RATE, {"rN1": ready})
    assert gauge_outputs(alone) is alone


def test_uncertainties_follow():
    volts = Channel("rAF", np.ones(40), "V", noise=2e-6, relative_uncertainty=3e-4, delay=1e-5, file_unit="V")
    supply = Channel("excitation", np.full(40, 5.0), "V", relative_uncertainty=4e-4)
    stamps = np.arange(40) / RATE
    given = Recording("run", stamps, np.arange(40), 0.0, RATE, {"rAF": volts, "excitation": supply})
    found = gauge_outputs(given).channel("rAF")
    assert found.noise == pytest.approx(2e-6 / 5 * 1e3)
    assert found.relative_uncertainty == pytest.approx(5e-4)  # 3-4-5
    assert found.delay == 1e-5


def scatter(values):
    """Noise of a signal that is a smooth course beside it, from second differences (variance 6 for white noise)."""
    return float(np.sqrt(np.mean(np.diff(values, 2) ** 2) / 6))


@pytest.mark.parametrize("drift", [0.0, 0.05])
def test_noise_of_the_excitation_reading_is_not_added(drift, rng):
    samples = 20_000
    phase = np.linspace(0, 1, samples)
    true = 10.0 + drift * np.sin(2 * np.pi * phase)
    ratio = 1.5e-3
    found = gauge_outputs(recording(excitation=true + rng.normal(size=samples) * 0.01, rN1=ratio * true)).channel(
        "rN1"
    )
    # Divided as read, the outputs would have a relative noise of 0.01 / 10. Blocks of 64 samples leave an eighth of
    # that, as slowly varying error; the course of the drift is 1 % a sine over the record, which blocks of 64 follow.
    assert scatter(found.values) < 1e-3 * ratio * 1e3 / 64
    np.testing.assert_allclose(found.values, 1e3 * ratio, rtol=6e-3 / 8)


def test_a_step_of_the_excitation_is_divided_out(rng):
    true = np.where(np.arange(4000) < 1717, 10.0, 9.0)
    found = gauge_outputs(recording(excitation=true + rng.normal(size=4000) * 1e-4, rAF=2e-3 * true))
    # What is left is at most the noise of one reading, 1e-5, within six standard deviations.
    np.testing.assert_allclose(found.channel("rAF").values, 2.0, rtol=6e-5)


@pytest.mark.parametrize("in_supply", [True, False])
def test_a_tone_is_divided_out_where_it_is_in_the_supply_only(in_supply, rng):
    samples, noise, size = 8192, 1e-3, 0.01
    tone = size * np.sin(2 * np.pi * 60 * np.arange(samples) / RATE)
    reading = 10.0 + tone + rng.normal(size=samples) * noise
    volts = 2e-3 * (10.0 + in_supply * tone)
    found = gauge_outputs(recording(excitation=reading, rN1=volts, rAF=volts)).channel("rN1").values
    # With the tone in the wrong place the outputs would be off by 2 * 0.01 / 10 / sqrt(2) rms. Left are the noise
    # of one reading, or the noise of block means; a fifth of the tone is twice the former.
    wrong = 2.0 * size / 10 / np.sqrt(2)
    assert np.std(found - 2.0) < wrong / 5


def test_a_single_outlier_of_the_supply_is_divided_out():
    true = np.full(3000, 10.0)
    true[1234] = 8.0
    found = gauge_outputs(recording(excitation=true, rAF=2e-3 * true))
    np.testing.assert_allclose(found.channel("rAF").values, 2.0, rtol=1e-12)


def test_missing_readings_of_a_steady_excitation_are_bridged(rng):
    reading = 10.0 + rng.normal(size=2000) * 1e-4
    reading[500:520] = np.nan
    found = gauge_outputs(recording(excitation=reading, rAF=np.full(2000, 0.02))).channel("rAF")
    np.testing.assert_allclose(found.values, 2.0, rtol=6e-5)


def test_an_excitation_that_fails_leaves_holes_and_is_told():
    reading = np.full(200, 10.0)
    reading[20:25] = 0.0
    reading[50] = -10.0
    reading[60] = 0.3
    with pytest.warns(DataQualityWarning, match=r"zero, negative or near zero \(up to 1 V\) in 7 of 200 samples"):
        found = gauge_outputs(recording(excitation=reading, rAF=np.full(200, 0.02))).channel("rAF")
    holes = [*range(20, 25), 50, 60]
    assert np.flatnonzero(found.missing).tolist() == holes
    np.testing.assert_allclose(np.delete(found.values, holes), 2.0, rtol=1e-12)


def test_no_excitation_to_divide_by():
    with pytest.raises(FitError, match=r"rN1, rAF in V, but there is no channel excitation \[V\].*channel map"):
        gauge_outputs(recording(missing_excitation=True, rN1=np.ones(9), rAF=np.ones(9)))
    for dead in (np.zeros(9), np.full(9, -10.0), np.full(9, np.nan)):
        with pytest.raises(FitError, match="nowhere above zero"):
            gauge_outputs(recording(excitation=dead, rAF=np.ones(9)))


@pytest.mark.parametrize("samples", [1, 2, 3, 10, 17])
def test_short_records(samples):
    found = gauge_outputs(recording(excitation=np.full(samples, 4.0), rAF=np.full(samples, 0.004)))
    np.testing.assert_allclose(found.channel("rAF").values, 1.0, rtol=1e-14)


def test_bridges_that_show_nothing_have_no_say_in_how_the_supply_is_smoothed(rng):
    """One that is dead, and one that fails after its first readings, beside one that has the tone of the supply."""
    samples = 8192
    tone = 0.01 * np.sin(2 * np.pi * 60 * np.arange(samples) / RATE)
    reading = 10.0 + tone + rng.normal(size=samples) * 1e-3
    failed = np.where(np.arange(samples) < 20, 2e-3 * (10.0 + tone), np.nan)
    volts = 2e-3 * (10.0 + tone)
    alone = gauge_outputs(recording(excitation=reading, rN1=volts)).channel("rN1")
    found = gauge_outputs(recording(excitation=reading, rN1=volts, rAF=np.zeros(samples), rS1=failed))
    np.testing.assert_array_equal(found.channel("rN1").values, alone.values)
    assert not found.channel("rAF").values.any()
    assert np.flatnonzero(found.channel("rS1").missing)[0] == 20


def test_a_supply_that_is_hardly_read_is_followed_where_it_is(rng):
    """Every fourth block of readings is there, so that no means of longer blocks have neighbours."""
    samples = 33 * 32  # it ends with a block that is read
    reading = 10.0 + rng.normal(size=samples) * 1e-4
    reading[np.arange(samples) // 32 % 4 > 0] = np.nan
    found = gauge_outputs(recording(excitation=reading, rAF=np.full(samples, 0.02))).channel("rAF").values
    # between readings the line through the means beside them: no more than the noise of a reading, six times that
    np.testing.assert_allclose(found, 2.0, rtol=6e-5)
