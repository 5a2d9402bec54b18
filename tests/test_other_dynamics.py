"""A record that contradicts the dynamics: a missing mode is named, a changed spring or damper is told."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks import other_dynamics, resonance
from aerobalance.estimation.checks.asked_readings import without_steps
from aerobalance.estimation.checks.averaged_spectrum import INDEPENDENT, REACH, Averaged, smeared
from aerobalance.estimation.checks.evidence import Evidence
from aerobalance.estimation.checks.local_modes import _fit, _fixed, _most_likely, missing_mode, own_resonance
from aerobalance.estimation.checks.model_error import LEFT_OPEN, error_under
from aerobalance.estimation.checks.near_resonance import near_resonance
from aerobalance.estimation.checks.other_dynamics import OtherDynamics, if_changed, other_dynamics_in
from aerobalance.estimation.checks.spoken import SETTINGS as SPOKEN
from aerobalance.estimation.checks.spoken import Spoken
from aerobalance.estimation.checks.step_ringing import change_by_steps
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.force_record import force_record
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.prior import fit_prior
from aerobalance.estimation.steps import Step
from aerobalance.identification.free_decay.fit import identify_decay
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut, Sensor
from faults.cases import all_cases, missing_modes, sound, wandering, wrong_dynamics
from faults.scene import Scene, band, together
from faults.trials import recording_of, trial, worked_out
from helpers.accuracy import SHARP, smooth_run
from helpers.cable_cut import T128
from seeds import new_seed, trials

RATE = 1600.0
BARE = CableCut().dynamics


def released(truth: Dynamics, generator: np.random.Generator, *, noise: float = 2.0) -> Recording:
    return CableCut(dynamics=truth, sensors={"AF": Sensor(noise=noise)}).run(3.0, generator).recording


def identified(truth: Dynamics, generator: np.random.Generator) -> Dynamics:
    """One mode, from a release of the balance as it really is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return identify_decay(released(truth, generator), mass=BARE.mass).dynamics


@pytest.fixture(scope="module")
def known() -> Dynamics:
    """What one release says of the balance."""
    return identified(BARE, np.random.default_rng(new_seed()))


def looked_at(recording: Recording, dynamics: Dynamics) -> OtherDynamics:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        force = estimate_force(recording, dynamics)
    found = force.only
    record = force.record.component_record(dynamics.component)
    return other_dynamics_in(record, noise=found.noise, steps=found.steps, lines=found.hum, learned=found.learned)


def kinds_of(recording: Recording, dynamics: Dynamics) -> list[str]:
    """Kinds of what is doubted of a force."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return [doubt.kind for doubt in estimate_force(recording, dynamics).doubts]


def shaken(
    truth: Dynamics, generator: np.random.Generator, *, corner: float = 60.0, seconds: float = 8.0
) -> Recording:
    """Balance load under a force of 60 N rms that rolls off with the fourth power, and noise of 2 N."""
    n = round(2 * seconds * RATE)
    frequency = np.fft.rfftfreq(n, 1 / RATE)
    shape = 1 / (1 + (frequency / corner) ** 4)
    scale = np.sqrt(shape / np.sum(2 * shape) * 60**2 * n**2 / 2)
    phasors = scale * (generator.normal(size=scale.size) + 1j * generator.normal(size=scale.size))
    phasors[0] = 0
    load = np.fft.irfft(phasors * truth.response(frequency), n)[: n // 2]
    values = load + generator.normal(0, 2.0, load.size)
    return Recording.from_columns(np.arange(load.size) / RATE, {"AF": Channel("AF", values, "N")}, name="shaken")


def averaged(values: Array) -> Averaged:
    seen = Averaged.of(values, interval=1 / RATE, noise=2.0)
    assert seen is not None
    return seen


@pytest.mark.parametrize("share", [0.05, -0.05])
@pytest.mark.soak(first=1)
def test_a_missing_mode_is_named_after_a_release(share, rng):
    frequency = rng.uniform(140, 260)
    truth = BARE.with_modes(Mode(frequency, 0.008, share))
    dynamics = identified(truth, rng)
    found = looked_at(released(truth, rng), dynamics)
    assert found.missing is not None
    assert found.missing.natural_frequency == pytest.approx(frequency, rel=0.01)
    assert f"mode at {found.missing.natural_frequency:.4g} Hz" in found.doubts(dynamics)[0].doubt.text
    assert found.frequency is None
    complete = dynamics.with_modes(*truth.further_modes)
    assert looked_at(released(truth, rng), complete).missing is None


@pytest.mark.parametrize("share", [0.05, -0.05, 0.08])
@pytest.mark.soak(first=1)
def test_a_missing_mode_is_told_with_the_sign_of_its_share(share: float, rng) -> None:
    """A mode of the other sign is likeliest a percent away and several times as large, and was named in one of four.

    The logarithms of their likelihoods are 60 to 90 apart in 10 s, which tell the frequency of a mode of 0.8 % damping
    to sqrt(z / (2 pi f T)), 0.1 %, and its share, which goes with the distance of the dip beside it, to some percent.
    """
    count = trials(1, 4)
    for _ in range(count):
        mode = Mode(rng.uniform(240, 280), 0.008, share)
        setup = {"dynamics": BARE.with_modes(mode), "rate": RATE, "rms": 60.0, "noise": 2.0}
        run, _ = smooth_run(rng, SHARP["0-300 Hz"], seconds=10.0, **setup)
        found = other_dynamics_in(force_record(run, BARE).component_record("AF"), noise=2.0).missing
        assert found is not None
        assert found.natural_frequency == pytest.approx(mode.natural_frequency, rel=0.01)
        assert found.share == pytest.approx(share, rel=0.2)


def test_a_release_that_agrees_is_left_alone(known, rng):
    # five standard uncertainties: passed by chance once in a million
    assert looked_at(released(BARE, rng), known).doubts(known) == []


def test_a_changed_spring_or_damper_is_told(known, rng):
    stiffer = looked_at(released(replace(BARE, stiffness=1.002 * BARE.stiffness), rng), known)
    assert stiffer.frequency is not None
    change, u = stiffer.frequency
    assert abs(change - (np.sqrt(1.002) - 1)) < 5 * u
    assert u < 2e-4  # a thousandth is told
    damper = looked_at(released(replace(BARE, damping=1.1 * BARE.damping), rng), known)
    assert damper.frequency is None
    assert damper.damping is not None
    change, u = damper.damping
    assert abs(change - 0.1) < 5 * u  # u is 0.011 in the mean, and so is the scatter of twenty records
    assert u < 0.02
    (told,) = damper.doubts(known)
    assert told.doubt.kind == "damping ratio"
    assert "or the flow" in told.doubt.text


def test_a_missing_mode_is_named_under_a_broadband_load(rng):
    truth = BARE.with_modes(Mode(165.0, 0.008, 0.05))
    found = missing_mode(averaged(shaken(truth, rng).channel("AF").values), BARE)
    assert found is not None
    mode, u, u_share = found
    # the uncertainty is about 0.25 Hz: 1 % of 165 Hz is six times that
    assert mode.natural_frequency == pytest.approx(165.0, rel=0.01)
    assert 0.05 < u < 0.6
    assert 0.02 < mode.share < 0.12
    assert 0 < u_share < 0.5 * mode.share


@pytest.mark.soak(first=0)
def test_the_edge_of_a_load_beside_a_missing_mode_does_not_bend_it(rng):
    """The load ends at 300 Hz, within the band about the mode in which its spectrum is taken for a power of frequency.

    Seen without that edge, the share had its sign wrong and 200 of its uncertainties beside the truth. Of some 100
    records by this alone one shows none, which a force names all the same: more than two of 16 are once in 1800 soaks.
    """
    unseen = 0
    for _ in range(trials(4, 16)):
        mode = Mode(rng.uniform(240, 280), 0.008, rng.choice([-0.08, -0.05, 0.05, 0.08]))
        setting = {"dynamics": BARE.with_modes(mode), "rate": RATE, "rms": 60.0, "noise": 2.0, "seconds": 10.0}
        recording, _ = smooth_run(rng, SHARP["0-300 Hz"], **setting)
        found = missing_mode(averaged(recording.channel("AF").values), BARE)
        if found is None:
            unseen += 1
            assert kinds_of(recording, BARE) == ["missing mode"]
            continue
        # at five standard uncertainties once in a million
        assert abs(found.mode.natural_frequency - mode.natural_frequency) < 5 * found.u_frequency
        # what is certain of a share is its logarithm, unless the other sign is as likely
        relative = found.u_share / abs(found.mode.share)
        same = found.mode.share / mode.share
        assert abs(found.mode.share - mode.share) < 5 * found.u_share or abs(np.log(max(same, 1e-9))) < 5 * relative
        assert found.u_frequency < 0.01 * mode.natural_frequency
    assert unseen <= trials(0, 2)


def test_a_smooth_load_shows_no_mode_and_no_change(rng):
    seen = averaged(shaken(BARE, rng).channel("AF").values)
    assert missing_mode(seen, BARE) is None
    found = own_resonance(seen, BARE)
    assert found is not None
    change, covariance, evidence = found
    # asymptotic: six ordinates of seven averages lie within the resonance, so allow six standard deviations
    assert abs(change[0]) < 6 * np.sqrt(covariance[0, 0])
    # chi-square with two degrees of freedom passes this once in 3 million
    assert evidence < 30


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("load", ["0-200 Hz", "0-100 Hz"])
@pytest.mark.soak(first=0)
def test_a_large_mode_in_a_short_record_is_named_and_counted(seed, load):
    """A tenth of the load at 1.5 f0, with hardly enough evidence (1), and less high than the resonance's slope (2)."""
    (case,) = [case for case in missing_modes() if case.name == f"mode at 1.5 f0, 10 %, {load}, 2.5 s"]
    found = trial((case, seed))
    assert "missing mode" in found["kinds"]
    assert found["verdict"] != "fit for use"
    assert found["error"] < 3 * found["u"]  # what a promise of u leaves; without the mode it is 40 u


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("mode at 2.3 f0, -3 %, 0-200 Hz, 2.5 s", 4),  # its peak is seven times what is about it
        ("mode at 2.3 f0, -3 %, 0-200 Hz, 2.5 s", 12),  # the load beyond it is taken for noise with a color
        ("mode at 1.5 f0, 10 %, 0-100 Hz, 2.5 s", 6),  # its highest ordinate is half its width off
    ],
)
@pytest.mark.soak(first=0)
def test_a_mode_that_is_low_or_taken_for_noise_is_named_and_counted(name, seed):
    """Each was called fit for use with an error of 150 to 240 N, at an uncertainty of 0.8 to 25 N."""
    (case,) = [case for case in missing_modes() if case.name == name]
    found = trial((case, seed))
    assert "missing mode" in found["kinds"]
    assert found["verdict"] != "fit for use"
    assert found["error"] < 3 * found["u"]


@pytest.mark.soak(first=0)
def test_noise_with_a_color_is_no_other_natural_frequency():
    """It rises towards half the rate: as a force it would pass a balance that rings beyond, or not at all."""
    (case,) = [case for case in all_cases() if case.name == "50 f0, noise rising, 0-20 Hz"]
    found = trial((case, 0))
    assert found["verdict"] == "fit for use"
    assert "natural frequency" not in found["kinds"]


@pytest.mark.soak(first=0)
def test_steps_that_mend_each_other_are_no_load_of_many_steps():
    """One release, read with a fifth of its rate: five steps within 80 ms stand for it, and no line for its swing."""
    (case,) = [case for case in all_cases() if case.name == "rate 0.2 times the true one, step"]
    found = trial((case, 0))
    assert "natural frequency" in found["kinds"]
    assert found["error"] < 3 * found["u"]  # it was 98 u


@pytest.mark.parametrize(
    ("name", "seed"),
    [("f0 400 Hz, broad", 15), ("rate 0.2 times the true one, broad", 3), ("rate 0.2 times the true one, broad", 5)],
)
@pytest.mark.soak(first=0)
def test_a_load_that_keeps_a_resonance_up_is_no_free_oscillation(name, seed):
    """Taken out by least squares, one that is not there leaves 1, -77 and -186 of the gain of 36 to 43.

    A term whose size may be zero makes nothing less likely: dynamics gain at least what they do without it.
    """
    (case,) = [case for case in all_cases() if case.name == name]
    found = trial((case, seed))
    assert "natural frequency" in found["kinds"]
    assert found["error"] < 3 * found["u"]  # it was 1300 u and more, and fit for use


@pytest.mark.parametrize("seed", [3, 18])
@pytest.mark.soak(first=0)
def test_a_blow_whose_spectrum_has_a_hole_at_the_resonance_is_told_by_what_rings_on(seed):
    """A half sine of 20 ms has none of 75 Hz: read without a resonance the record gained 14, and 12 is asked."""
    (case,) = [case for case in all_cases() if case.name == "half sine of 20 ms, 1000 N"]
    found = trial((case, seed))
    assert "natural frequency" not in found["kinds"]
    assert found["error"] < 3 * found["u"]
    assert found["u"] < 3 * found["error"]  # it was 13 times


@pytest.mark.soak(first=0)
def test_a_narrow_band_in_a_long_record_is_no_mode():
    """Of 37 to 43 Hz: its edges left a mode of -21 % at 37.8 Hz where the spectrum is a power of frequency."""
    (case,) = [case for case in all_cases() if case.name == "narrow at 40 Hz, 10 s"]
    found = trial((case, 100))
    assert found["kinds"] == []
    assert found["error"] < 3 * found["u"]


@pytest.mark.soak(first=0)
def test_a_balance_that_may_not_ring_counts_by_its_probability():
    """With dynamics of 20 Hz in the place of 66 Hz this record gains 8.3 without a resonance, and 12 is asked."""
    (case,) = [case for case in all_cases() if case.name == "f0 20 Hz, slow"]
    found = [trial((case, seed)) for seed in (10, 17, 18)]
    left_open = [one for one in found if one["u"] > 1.0]
    assert len(left_open) == 1
    assert left_open[0]["kinds"] == ["natural frequency"]
    assert "may not ring" in left_open[0]["said"][0]
    assert left_open[0]["error"] < 3 * left_open[0]["u"]  # it was 90 u and more


@pytest.mark.soak(first=0)
def test_a_far_frequency_that_is_left_open_is_counted_and_told():
    """Read at half its rate this record gains 8.5 with 33.1 Hz and the known damping, and more with a broad peak.

    A broad one may be the load's, which left 900 N beside 1 N. With its probability of 0.22 it is half of the force.
    """
    (case,) = [case for case in all_cases() if case.name == "rate 0.5 times the true one, broad"]
    found = trial((case, 11))
    assert found["error"] < 3 * found["u"]
    assert found["kinds"] == ["natural frequency"]
    assert found["verdict"] != "fit for use"
    assert "may ring" in found["said"][0]
    assert "probability 0.22" in found["said"][0]


def test_a_mode_that_is_left_open_counts_by_its_probability(monkeypatch):
    """Its gain is 14: with 16 asked it may be there, and the force is no surer for that."""
    (case,) = [case for case in missing_modes() if case.name == "mode at 1.5 f0, 10 %, 0-200 Hz, 2.5 s"]
    monkeypatch.setattr(resonance, "SETTINGS", replace(resonance.SETTINGS, decisive=16.0))
    found = trial((case, 1))
    assert found["kinds"] == ["missing mode"]
    assert "may show" in found["said"][0]
    assert found["error"] < 3 * found["u"]


@pytest.mark.parametrize("edge", [40.0, 60.0, 90.0])  # 60 Hz is within the resonance, of which the edge cuts a part
def test_the_edge_of_a_load_is_no_mode(edge, rng):
    frequency = np.fft.rfftfreq(22_000, 1 / RATE)
    force = np.fft.rfft(rng.normal(0, 30.0, 22_000)) * (frequency < edge)
    load = np.fft.irfft(force * BARE.response(frequency)) + rng.normal(0, 2.0, 22_000)
    assert missing_mode(averaged(load), BARE) is None


@pytest.mark.soak(first=0)
def test_a_load_far_below_the_resonance_makes_no_ringing(rng):
    """What a record begins with is told by what is near the resonance: of the load itself it would be some 10 N."""
    for _ in range(trials(4, 20)):
        setting = {"dynamics": BARE, "rate": RATE, "rms": 500.0, "noise": 0.5, "seconds": 10.0}
        recording, force = smooth_run(rng, SHARP["0-30 Hz"], **setting)
        found = estimate_force(recording, BARE)
        assert found.doubts == ()
        error = found.only.values - force
        # 60 independent errors a second: 4 % of their rms over 10 s, five of these
        assert np.sqrt(np.mean(error**2) / np.mean(found.only.uncertainty**2)) < 1.2


@pytest.mark.parametrize("seed", [48, 0, 1])
@pytest.mark.soak(first=1)
def test_a_step_under_a_broadband_load_tells_no_other_frequency(seed):
    """A frequency that fits a little better with a third of the damping had an uncertainty seven times too small."""
    rng, noise = np.random.default_rng([1, seed]), (2.0, 10.0)[seed % 2]
    setting = {"dynamics": BARE, "rate": RATE, "rms": 60.0, "noise": noise, "seconds": 4.0}
    recording, _ = smooth_run(rng, SHARP["0-120 Hz"], **setting)
    load = recording.channel("AF").values
    instant = 2 + rng.uniform(0, 1) / RATE
    stepped = Channel("AF", load + 1020 * BARE.step_response(recording.time - instant), "N")
    found = estimate_force(Recording.from_columns(recording.time, {"AF": stepped}, name="step and load"), BARE)
    assert len(found.only.steps) == 1
    assert found.doubts == ()


@pytest.mark.parametrize("change", [0.94, 1.08])
@pytest.mark.soak(first=0)
def test_a_changed_spring_is_told_by_a_step_under_a_broadband_load(change, rng):
    truth = replace(BARE, stiffness=change * BARE.stiffness)
    recording, _ = smooth_run(rng, SHARP["0-30 Hz"], dynamics=truth, rate=RATE, rms=60.0, noise=2.0, seconds=4.0)
    load = recording.channel("AF").values + 1020 * truth.step_response(recording.time - 2.0)
    stepped = Recording.from_columns(recording.time, {"AF": Channel("AF", load, "N")}, name="step and load")
    with pytest.warns(DataQualityWarning, match="rings with another natural frequency"):
        found = estimate_force(stepped, BARE)
    assert found.doubts[0].kind == "natural frequency"


def test_a_changed_spring_is_told_under_a_broadband_load(rng):
    truth = replace(BARE, stiffness=1.08 * BARE.stiffness)
    found = own_resonance(averaged(shaken(truth, rng).channel("AF").values), BARE)
    assert found is not None
    change, covariance, evidence = found
    assert change[0] == pytest.approx(np.log(1.08) / 2, abs=6 * np.sqrt(covariance[0, 0]))
    assert change[0] > 5 * np.sqrt(covariance[0, 0])
    assert evidence > 30


def test_noise_alone_tells_nothing(rng):
    seen = averaged(rng.normal(0, 2.0, 8192))
    assert own_resonance(seen, BARE) is None
    assert missing_mode(seen, BARE) is None


def test_smearing_is_that_of_the_window(rng):
    seen = averaged(rng.normal(0, 2.0, 8192))
    band = seen.near(200.0)
    assert smeared(np.full(seen.fine(band).size, 3.0)) == pytest.approx(np.full(band.size, 3.0), rel=1e-12)
    size = 2 * (seen.frequency.size - 1)
    middle = band[band.size // 2]
    line = np.zeros(seen.fine(band).size)
    line[2 * (band.size // 2 + REACH)] = 1.0
    # the window's own spectrum about a line in the middle of the band, by the transform
    window = np.hanning(size + 1)[:-1]
    wave = np.exp(2j * np.pi * middle * np.arange(size) / size)
    power = np.abs(np.fft.fft(window * wave)[band]) ** 2
    assert smeared(line) == pytest.approx(power / power.sum() / 2, rel=1e-5, abs=1e-6)


def test_short_records_are_left_alone():
    assert Averaged.of(np.zeros(100), interval=1 / RATE, noise=1.0) is None


def kinks(time: Array) -> Array:
    """A force that rises and falls along straight lines [N]."""
    return 500 * np.clip((time - 0.7) / 0.3, 0, 1) - 300 * np.clip((time - 1.5) / 0.2, 0, 1)


@pytest.mark.parametrize("kind", ["kinks and turbulence", "steps", "noise", "kinks", "turbulence", "none"])
@pytest.mark.soak(first=3)
def test_no_kind_of_load_says_anything_against_the_right_dynamics(kind, rng):
    fine = np.arange(40 * 4800) / (40 * RATE)
    load = BARE.balance_load(kinks(fine), interval=1 / (40 * RATE))[::40]
    turbulence = shaken(BARE, rng, seconds=3.0).channel("AF").values
    instants, heights = np.arange(0.2, 3, 0.4), 300 * np.array([1, -2, 1.5, -1, 1, -1.2, 0.7])
    steps = np.sum([h * BARE.step_response(fine[::40] - t) for t, h in zip(instants, heights, strict=True)], axis=0)
    noise = rng.normal(0, 2.0, 4800)
    values = {
        "kinks": load + noise,
        "turbulence": turbulence,
        "kinks and turbulence": load + turbulence,
        "steps": steps + noise,
        "noise": noise,
        "none": np.zeros(4800),
    }[kind]
    run = Recording.from_columns(fine[::40], {"AF": Channel("AF", values, "N")}, name=kind)
    assert looked_at(run, BARE).doubts(BARE) == []


def narrow_noise(rng: np.random.Generator, time: Array, highest: float) -> Array:
    """Gaussian noise up to a frequency [Hz], of 1 rms."""
    frequency = np.fft.rfftfreq(time.size, float(time[1] - time[0]))
    phasors = (rng.normal(size=frequency.size) + 1j * rng.normal(size=frequency.size)) * (frequency < highest)
    values = np.fft.irfft(phasors, time.size)
    return np.asarray(values / values.std())


def read_finely(force: Array, rng: np.random.Generator, *, lead: float, fine: int = 8) -> Recording:
    """The reading of a force that is given on a finer clock from some seconds before on, with 2 N of noise."""
    load = BARE.balance_load(force, interval=1 / (fine * RATE))[round(lead * RATE) * fine :: fine]
    values = load + rng.normal(0, 2.0, load.size)
    return Recording.from_columns(np.arange(load.size) / RATE, {"AF": Channel("AF", values, "N")}, name="read")


@pytest.mark.parametrize("ends", [(0.905, 0.95), (0.995, 1.007), (1.05, 1.07)])
@pytest.mark.parametrize("buffet", [0.0, 20.0])
@pytest.mark.soak(first=2)
def test_a_tone_that_wanders_is_no_other_resonance(ends, buffet, rng):
    """The tone of a vortex, 10 N, whose frequency and size wander beside the natural frequency or about it.

    Alone it was taken for a resonance at its frequency, with an uncertainty 50 to 200 times the error; at the natural
    frequency, under a buffet, for a tenth of the damping.
    """
    fine, lead = 8, 4.0
    time = np.arange(round((lead + 5.0) * RATE) * fine) / (fine * RATE)
    frequency = BARE.natural_frequency * np.linspace(*ends, time.size) + 0.4 * narrow_noise(rng, time, 2.0)
    size = 10.0 * (1 + 0.2 * narrow_noise(rng, time, 1.5))
    tone = size * np.sin(2 * np.pi * np.cumsum(frequency) / (fine * RATE))
    run = read_finely(300.0 + tone + buffet * narrow_noise(rng, time, 25.0), rng, lead=lead)
    assert looked_at(run, BARE).doubts(BARE) == []


@pytest.mark.parametrize("name", ["67 Hz, 60 N", "72 Hz, 60 N, and 0-60 Hz, 20 N", "70 Hz, 20 N, and 0-120 Hz, 60 N"])
@pytest.mark.soak(first=1)
def test_a_strong_narrow_band_beside_the_resonance_is_no_other_resonance(name, seed):
    """It was one with ten times the damping, as what it leaks was nothing, or as it pulled at a broad load's edge.

    Ten of 250 records were not usable for that: of bands 0.5 to 4 Hz wide within 10 % of the natural frequency, most
    beside a broad load; then none of them was.
    """
    (case,) = (one for one in sound() if one.name == f"narrow at {name}")
    left_open = 0
    for place in range(trials(2, 10)):
        found = trial((case, seed + place))
        if any(" AF may " in text for text in found["said"]):
            left_open += 1
            continue
        assert not {"natural frequency", "damping ratio", "missing mode"} & set(found["kinds"])
    assert left_open <= trials(1, 2)  # of 34 one: of two both once in 1150, of ten more than two once in 350


@pytest.mark.parametrize("seed", [1, 0, 2])
@pytest.mark.soak(first=0)
def test_a_square_wave_is_no_balance_that_does_not_ring(seed):
    """Lines at all its harmonics, of which steps explain what is left; they were doubted in one of two records."""
    rng, fine, lead = np.random.default_rng(seed), 8, 4.0
    time = np.arange(round((lead + 2.5) * RATE) * fine) / (fine * RATE)
    force = 20.0 * np.sign(np.sin(2 * np.pi * 5.3 * (time + rng.uniform(0, 1))))
    assert looked_at(read_finely(force, rng, lead=lead), BARE).doubts(BARE) == []


@pytest.mark.parametrize("factor", [0.95, 1.03, 1.1])
@pytest.mark.soak(first=1)
def test_another_resonance_is_told_beside_narrow_loads(factor, rng):
    """A broad load shows a resonance beside its peak, and where it is missing: a narrow load of no shape explains it.

    It needs no tone to be near: the gain of the balance's own dynamics over ones that are off is asked beside a load
    within 6 % of the peak.
    """
    run = shaken(BARE, rng)
    other = BARE.retuned(frequency=factor, damping=1.0)
    values = run.channel("AF").values
    evidence = Evidence(values - values.mean(), 1 / RATE, 1e-6 * 4.0 / RATE, among=(BARE, other))
    band = BARE.natural_frequency * 0.94, BARE.natural_frequency * 1.06
    assert evidence.over_narrow_loads(BARE, other, [band], enough=-np.inf) > SPOKEN.band_decisive
    assert evidence.over_narrow_loads(other, BARE, [band], enough=-np.inf) < 0
    assert looked_at(run, other).frequency is not None


@pytest.mark.parametrize(
    ("name", "beside", "kind", "seed"),
    [
        ("mode at 1.5 f0, 10 %, 0-100 Hz, 10 s", [band(5.0, 60.4, 61.4), wandering(144.3, 146.3)], "missing mode", 22),
        ("f0 50 Hz, soft", [band(60.0, 68.9, 70.9), band(60.0, 135.6, 139.6)], "natural frequency", 45),
        ("mode at 1.5 f0, 10 %, step, 10 s", [band(5.0, 98.4, 99.4), band(60.0, 68.6, 69.6)], "missing mode", 90),
        ("mode at 2.3 f0, 3 %, step, 2.5 s", [band(20.0, 71.8, 73.8)], "missing mode", 56),
    ],
)
@pytest.mark.soak(first=0)
def test_other_dynamics_are_told_beside_narrow_loads_at_other_frequencies(name, beside, kind, seed):
    """Each was 29 to 143 u off, and fit for use or not named, or 3 u: what fits such a load best hid what is other.

    And where they expected less beside it, as their flanks did of a band a thousand times as strong, that was held
    against them.
    """
    (case,) = (one for one in (*missing_modes(), *wrong_dynamics()) if one.name == name)
    assert isinstance(case.scene, Scene)
    case = replace(case, scene=replace(case.scene, force=together(case.scene.force, *beside)))
    assert kind in trial((case, seed))["kinds"]


@pytest.mark.soak(first=0)
def test_a_mode_at_the_end_of_a_load_that_is_as_narrow_as_a_tone_is_named():
    """A short record does not tell its damping: the force was 270 u off, and fit for use."""
    (case,) = (one for one in missing_modes() if one.name == "mode at 1.5 f0, 10 %, 0-100 Hz, 2.5 s")
    assert "missing mode" in trial((case, 9))["kinds"]


def test_a_mode_just_below_the_edge_of_a_load_is_found():
    """Its share and the load's level are hardly told apart: the likeliest, by nothing, had 1.4 of a steady load."""
    rng = np.random.default_rng(46)
    mode = Mode(rng.uniform(240, 280), 0.008, -0.08)
    rng.choice(4)
    setting = {"dynamics": BARE.with_modes(mode), "rate": RATE, "rms": 60.0, "noise": 2.0, "seconds": 10.0}
    recording, _ = smooth_run(rng, SHARP["0-300 Hz"], **setting)
    found = missing_mode(averaged(recording.channel("AF").values), BARE)
    assert found is not None
    assert abs(found.mode.natural_frequency - mode.natural_frequency) < 5 * found.u_frequency
    assert found.u_share > abs(found.mode.share)  # which says so


@pytest.mark.soak(first=0)
def test_a_release_tells_the_frequency_whatever_comes_later(known, rng):
    stiffer = replace(BARE, stiffness=1.002 * BARE.stiffness)
    run = released(stiffer, rng)
    later = 40 * (run.time > run.time[-1] - 0.6) * np.sin(300 * run.time)
    disturbed = Recording.from_columns(
        run.time, {"AF": Channel("AF", run.channel("AF").values + later, "N")}, name="release, then shaken"
    )
    found = looked_at(disturbed, known)
    assert found.frequency is not None
    change, u = found.frequency
    assert change == pytest.approx(0.001, abs=5 * u)
    assert u < 2e-4  # it is told at five of these


def flat(truth: Dynamics, generator: np.random.Generator, *, seconds: float) -> Array:
    """Balance load under a force of one density to 100 Hz, 200 N rms, and noise of 2 N."""
    n = round(seconds * RATE)
    frequency = np.fft.rfftfreq(2 * n, 1 / RATE)
    phasors = (generator.normal(size=frequency.size) + 1j * generator.normal(size=frequency.size)) * (frequency < 100)
    phasors[0] = 0
    load = np.fft.irfft(phasors * truth.response(frequency), 2 * n)[:n]
    level = 200 / np.std(np.fft.irfft(phasors, 2 * n))
    return np.asarray(level * load + generator.normal(0, 2.0, n))


@pytest.mark.parametrize(("shift", "damped"), [(0.03, 1.0), (-0.05, 2.0), (0.0, 4.0)])
def test_the_resonance_of_a_reading_is_found_near_the_expected_one(shift, damped, rng):
    """The spectrum is a level times |G|^2, of which ordinates within the width of the resonance tell the place."""
    truth = BARE.retuned(frequency=1 + shift, damping=damped)
    seconds = 10.0
    values = flat(truth, rng, seconds=seconds)
    found = near_resonance(values - values.mean(), 1 / RATE, BARE)
    # Cramer-Rao for exponential ordinates under a resonance of width w: w / sqrt(2 pi w T), twice that for the damping
    width = truth.damping_ratio * truth.natural_frequency
    u = width / np.sqrt(2 * np.pi * width * seconds)
    grid = 0.25 * BARE.damping_ratio * BARE.natural_frequency
    assert abs(found.natural_frequency - truth.natural_frequency) < 4 * u + grid
    assert abs(np.log(found.damping_ratio / truth.damping_ratio)) < 4 * 2 * u / width + np.log(1.2)


@pytest.mark.soak(first=0)
def test_a_changed_spring_is_found_where_the_load_hides_its_ringing(rng):
    values = flat(BARE, rng, seconds=5.0)
    recording = Recording.from_columns(np.arange(values.size) / RATE, {"AF": Channel("AF", values, "N")})
    expected = BARE.retuned(frequency=0.975, damping=1.0)
    with pytest.warns(DataQualityWarning, match="another natural frequency"):
        force = estimate_force(recording, expected)
    (doubt,) = force.doubts
    assert doubt.kind == "natural frequency"
    assert force.verdict != "fit for use"
    right = estimate_force(recording, BARE).only
    z = (force.only.values - right.values) / force.only.uncertainty
    assert np.sqrt(np.mean(z**2)) < 2


def test_an_error_is_not_followed_into_frequencies_that_do_not_show():
    """At a zero of the other response the force may be anything; elsewhere it is F (1 - G0 / G1)."""
    other = BARE.with_modes(Mode(200.0, 0.008, -0.08))
    time = np.arange(32_000) / RATE
    within = slice(8000, 24_000)
    frequencies = np.linspace(5, 500, 1981)
    ratio = BARE.response(frequencies) / other.response(frequencies)

    def size(frequency: float) -> float:
        tone = np.sin(2 * np.pi * frequency * time)
        return float(np.sqrt(2 * np.mean(error_under(tone, own=BARE, other=other, interval=1 / RATE)[within] ** 2)))

    plain = frequencies[np.argmin(np.abs(np.abs(ratio) - 1.2))]
    expected = abs(1 - np.interp(plain, frequencies, ratio))
    # the tone has whole periods; what comes from how its ends are joined fades towards the middle
    assert size(plain) == pytest.approx(expected, abs=1e-5)
    hardly = frequencies[np.argmax(np.abs(ratio))]
    assert np.max(np.abs(ratio)) > 20
    assert size(hardly) < 1 + 5


def test_a_constant_force_has_no_error_of_the_dynamics():
    """At rest every balance shows the load it carries: whatever its mass and damping, the error of a constant is 0."""
    constant = np.full(8000, 10_000.0)
    for other in (BARE, BARE.retuned(frequency=1.005, damping=1.0), BARE.retuned(frequency=0.9, damping=2.0)):
        error = error_under(constant, own=BARE, other=other, interval=1 / RATE)
        np.testing.assert_allclose(error, 0.0, atol=1e-9 * 10_000.0)


@pytest.mark.parametrize("probability", [0.1, 0.001, 0.8])
@pytest.mark.soak(first=1)
def test_what_a_record_leaves_open_counts_by_its_probability(probability, monkeypatch, rng):
    """The variance of a force that is F with probability 1 - p and F + e with p, about F, is p e^2."""
    values = flat(BARE, rng, seconds=2.0)
    recording = Recording.from_columns(np.arange(values.size) / RATE, {"AF": Channel("AF", values, "N")})
    before = estimate_force(recording, BARE).only
    other = BARE.retuned(frequency=1.002, damping=1.0)
    spoken = Spoken("natural frequency", other, 10.0, probability=probability)
    monkeypatch.setattr(other_dynamics, "spoken_for", lambda *_, **__: spoken)
    after = estimate_force(recording, BARE)
    assert after.doubts == ()
    error = error_under(before.values, own=BARE, other=other, interval=1 / RATE)
    monkeypatch.setattr(other_dynamics, "spoken_for", lambda *_, **__: None)
    # one record in sixty leaves open as well whether the spring is linear
    besides = estimate_force(recording, BARE).only.budget.get(LEFT_OPEN, 0.0)
    expected = np.sqrt(probability * np.mean(error**2) + besides**2)
    assert after.only.budget[LEFT_OPEN] == pytest.approx(expected, rel=0.02)
    np.testing.assert_array_equal(after.only.values, before.values)


@pytest.mark.filterwarnings("ignore:.*the noise of AF may rise at low frequency")  # of one in 300
@pytest.mark.filterwarnings("ignore:.*AF may ring with another")  # what is left open
def test_the_right_resonance_is_left_alone_and_leaves_little_open(seed):
    forces = []
    for one in range(trials(2, 60)):
        values = flat(BARE, np.random.default_rng([seed, one]), seconds=2.5)
        recording = Recording.from_columns(np.arange(values.size) / RATE, {"AF": Channel("AF", values, "N")})
        forces.append(estimate_force(recording, BARE))
    # of 400 none was doubted, and of 3 much was left open: of 60 more than these come once in a thousand times
    sure = [[doubt for doubt in force.doubts if "may ring" not in doubt.text] for force in forces]
    assert sum(map(bool, sure)) <= 1
    assert sum(force.only.budget.get(LEFT_OPEN, 0.0) > 5.0 for force in forces) <= 4


def test_a_factor_that_is_hardly_told_is_no_change():
    """The covariance is that of the logarithm: five of its standard uncertainties, whichever way the factor goes."""
    assert if_changed(1.68, 0.70) is None  # 2.4 of them, although 5.4 times the damping is 6 times 0.70 more
    for factor in (5.4, 1 / 5.4):
        assert if_changed(np.log(factor), 0.99 * np.log(5.4) / 5) == pytest.approx(
            (factor - 1, factor * 0.99 * np.log(5.4) / 5)
        )
        assert if_changed(np.log(factor), 1.01 * np.log(5.4) / 5) is None


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.soak(first=1)
def test_a_changed_stiffness_is_told_without_another_damping(seed: int) -> None:
    (case,) = (one for one in all_cases() if one.name == "stiffness -5 %, broad, 2.5 s")
    force, _ = worked_out(case.record(seed), case.known(seed), case.settings)
    assert force is not None
    (doubt,) = (one for one in force.doubts if one.kind == "natural frequency")
    # the damping constant is that of the balance: Schwarz's price of a number is paid by chance once in 200
    assert "damping ratio" not in doubt.text


@pytest.mark.parametrize("factor", [1.049, 0.916, 1.09])
@pytest.mark.soak(first=0)
def test_a_step_in_a_broad_load_tells_a_resonance_that_is_near(factor: float) -> None:
    """Dynamics up to 9 % off explain the roll-off of the readings as the true ones do, and far better than none.

    The ringing after the step alone found a frequency between the two, with an error of twice the uncertainty.
    """
    case = next(one for one in all_cases() if one.name == "step")
    record = case.record(new_seed())
    force, said = worked_out(record, case.dynamics.retuned(frequency=factor, damping=1.0), case.settings)
    assert force is not None, said
    found = [doubt.text for doubt in force.doubts if doubt.kind == "natural frequency"]
    assert len(found) == 1, [str(one) for one in force.doubts]
    # a width of the resonance of 0.8 Hz, of which a step of 200 N in 60 N of load tells a fifth
    assert float(re.search(r"frequency, ([\d.]+) Hz", found[0])[1]) == pytest.approx(66.368, abs=0.16)
    error = np.sqrt(np.mean((force.only.values - record.force) ** 2))
    u = np.sqrt(np.mean(force.only.uncertainty**2))
    assert 0.7 < error / u < 1.3  # the error of wrong dynamics is known, but for how far that is known


@pytest.mark.parametrize("count", [1, 25])
def test_steps_soon_after_the_begin_are_not_taken_for_its_free_oscillation(count, rng):
    """Nineteen samples tell the one from the other, badly; what is left is the noise of 2 N and no more."""
    rate, noise = 1600.0, 2.0
    steps = [Step(0.0119 + 0.1 * place, 0.0, 400.0 * (-1) ** place) for place in range(count)]
    time = np.arange(4000) / rate
    load = sum(step.height * T128.step_response(time - step.instant) for step in steps)
    left = without_steps(Observation(load + rng.normal(0, noise, time.size), 1 / rate, T128), steps)
    # the root of a mean square of n scatters by 1 / sqrt(2 n)
    assert np.sqrt(np.mean(left**2)) == pytest.approx(noise, rel=5 / np.sqrt(2 * time.size))


@pytest.mark.parametrize("instant", [999.5, 998.99])
def test_a_step_that_has_not_begun_to_ring_tells_nothing(instant, rng):
    """No reading after it, or one that has hardly moved: either way no natural frequency is told."""
    reading = Observation(rng.normal(0, 2, 1000), 1 / RATE, T128)
    learned = fit_prior(reading, columns=np.ones((1000, 1)))
    change = change_by_steps(reading, [Step(instant / RATE, 0.0, 500.0)], learned)
    assert change.gain == 0
    assert not change.change.any()


def test_steps_that_tell_but_one_combination_of_both_changes_are_no_error():
    """Two that nearly cancel, half a sample apart at the end: the covariance of both changes has no inverse."""
    reading = Observation(np.random.default_rng(1).normal(0, 2, 1000), 1 / RATE, T128)
    learned = fit_prior(reading, columns=np.ones((1000, 1)))
    steps = [Step(998.5 / RATE, 0.0, 500.0), Step(999.0 / RATE, 0.0, -490.0)]
    change = change_by_steps(reading, steps, learned)
    assert np.isfinite(change.change).all()
    assert (np.linalg.eigvalsh(change.covariance) > 0).all()


ALIKE = (
    "stiffness +20 %, soft, 2.5 s",
    "mode at 1.5 f0, 10 %, soft, 2.5 s",
    "soft 30 Hz, 100 N",
    "f0 57 Hz, step, 0.6 s",
    "stiffness -5 %, soft, 2.5 s",
    "damping x3, soft, 2.5 s",
    "mode at 2.3 f0, 3 %, soft, 2.5 s",
    "mode at 2.3 f0, -3 %, step, 2.5 s",
    "step",
)


@pytest.mark.parametrize("name", ALIKE)
@pytest.mark.soak(first=1)
def test_dynamics_left_out_at_a_first_look_change_no_answer(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A record whose force rolls off says the same where every kind of spectrum is tried with all other dynamics."""
    case = next(one for one in all_cases() if one.name == name)
    seed = new_seed()
    quick = trial((case, seed))
    monkeypatch.setattr(Evidence, "may_gain", lambda *_: True)
    whole = trial((case, seed))
    assert quick["kinds"] == whole["kinds"]
    assert quick["said"] == whole["said"]
    assert quick["error"] == pytest.approx(whole["error"], rel=1e-6)
    assert quick["u"] == pytest.approx(whole["u"], rel=1e-6)


def test_no_model_is_likelier_than_one_that_expects_what_is_read(rng):
    """What a search is left out by: no resonance is twice as likely as its own readings, at any place."""
    seen = Averaged.of(rng.normal(size=8000), interval=1 / RATE, noise=0.5)
    assert seen is not None
    for centre in (30.0, 66.0, 300.0):
        band = seen.near(centre)
        plain = _fit(seen, band, _fixed(T128), start=np.zeros(0), scale=np.zeros(0))
        readings = seen.power[band]
        weight = seen.averages * INDEPENDENT
        assert _most_likely(seen, band) == pytest.approx(-2 * weight * np.sum(np.log(readings) + readings / readings))
        assert plain.twice_log_likelihood < _most_likely(seen, band)


@pytest.mark.parametrize("seed", [3, 7, 10])
@pytest.mark.soak(first=1)
def test_less_damping_that_a_short_record_does_not_resolve_is_counted_as_likely_as_a_tone(seed):
    """A third of the damping, broad load of 2.5 s: a resonance of one ordinate, which a tone there makes as well.

    Its error was 55 to 75 times the uncertainty, of a force that was called fit for use.
    """
    case = next(one for one in all_cases() if one.name == "damping x3, broad, 2.5 s")
    found = trial((case, seed))
    assert all("probability 0.5" in text for text in found["said"])  # told where it is a tenth of the force
    assert found["error"] < 3 * found["u"]


def test_a_tone_that_stands_alone_is_no_mode_of_more_than_half_a_steady_load() -> None:
    """A tone that wanders below the resonance for 10 s asked for a mode of 73 % in this record, and of 5 in 12."""
    (case,) = (one for one in all_cases() if one.name == "tone that wanders from 60 to 63 Hz, 10 s")
    assert estimate_force(recording_of(case.record(4)), case.known(4)).doubts == ()
