"""Identification from a shaken rig: accuracy, honest uncertainties, doubtful records, a real one."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, filtfilt
from scipy.stats import chi2

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.force import estimate_force
from aerobalance.identification.base_excitation.frf_model import Parameters, response
from aerobalance.identification.base_excitation.rig import identify_rig
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut, RandomDrive, Sensor, SteppedSine, Sweep, VibrationRig
from aerobalance.simulation.drives import band_noise
from aerobalance.simulation.published import CABLE_CUT, VIBRATION_RIG
from seeds import trials

TRUE = VIBRATION_RIG.dynamics
MASS = VIBRATION_RIG.mass
LARGE = CABLE_CUT.dynamics
DELAY = 3e-6
STEPS = (*np.arange(500.0, 600.0, 20.0), *np.arange(600.0, 800.0, 10.0), *np.arange(800.0, 900.0, 20.0))
DRIVES = {
    "stepped": SteppedSine(STEPS, settle=0.02, hold=0.08),
    "swept": Sweep(500.0, 900.0, 3.0),
    "random": RandomDrive(400.0, 1000.0, 3.0),
}
TREADMILL = Path(__file__).parents[1].parent / "shared" / "data" / "treadmill"


def shake(drive, generator, *, load=0.05, acceleration=0.05, delay=DELAY, live=False):
    sensors = {"AF": Sensor(noise=load, delay=delay), "ground_acceleration": Sensor(noise=acceleration)}
    if live:
        sensors["live_acceleration"] = Sensor(noise=acceleration)
    return VibrationRig(sensors=sensors).run(drive, generator)


def said(recording, **settings) -> tuple[object, list[str]]:
    """Fit, and what was warned about."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fit = identify_rig(recording, **settings)
    assert all(issubclass(warning.category, DataQualityWarning) for warning in caught)
    return fit, [str(warning.message) for warning in caught]


def with_channel(recording: Recording, name: str, **changes) -> Recording:
    channels = dict(recording.channels) | {name: replace(recording.channel(name), **changes)}
    return replace(recording, channels=channels)


def least_deviation(simulation, *, load, acceleration, mass_known=True) -> np.ndarray:
    """Cramer-Rao bound of f0 and b, relative, and of the delay [s]: true motion, true noise, ground motion unknown."""
    ground = simulation.ground_acceleration
    spectrum = np.fft.rfft(ground) / np.sqrt(ground.size)
    w = 2 * np.pi * np.fft.rfftfreq(ground.size, 1 / simulation.recording.rate)
    r, loss = w / TRUE.angular_frequency, 2 * TRUE.damping_ratio
    denominator = 1 - r**2 + 1j * r * loss
    response = -TRUE.mass / denominator
    slopes = np.column_stack(
        [
            response,
            -response * (2 * r**2 - 1j * r * loss) / denominator,
            -response * 1j * r / denominator,
            -1e-3j * w * response,
        ]
    )  # by log M, log w0, loss, delay [ms]
    slopes *= (spectrum / np.sqrt(load**2 + np.abs(response) ** 2 * acceleration**2))[:, None]
    slopes = slopes[:, 1:] if mass_known else slopes
    bound = np.linalg.inv(2 * np.real(slopes.conj().T @ slopes))
    turn = np.array([[1, 0, 0], [1, 1 / loss, 0], [0, 0, 1e-3]])
    if not mass_known:
        turn = np.column_stack([[0, 1, 0], turn])
    return np.sqrt(np.diag(turn @ bound @ turn.T))


def found(fit) -> tuple[np.ndarray, np.ndarray]:
    """Errors of f0 and b, relative, and of the delay, and their standard uncertainties."""
    d = fit.dynamics
    f0 = TRUE.natural_frequency
    errors = [d.natural_frequency / f0 - 1, d.damping / TRUE.damping - 1, d.delay - DELAY]
    uncertainties = [
        d.uncertainty("natural_frequency") / f0,
        d.uncertainty("damping") / TRUE.damping,
        d.uncertainty("delay"),
    ]
    return np.array(errors), np.array(uncertainties)


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("mass", [MASS, None])
def test_rig_is_identified(drive: str, mass: float | None, rng):
    fit = identify_rig(shake(DRIVES[drive], rng).recording, mass=mass)
    errors, uncertainties = found(fit)
    assert abs(errors[0]) < 3e-4
    assert abs(errors[1]) < 5e-3
    # Five standard deviations: less than one chance in 1e6 for each.
    assert np.all(np.abs(errors) < 5 * uncertainties)
    assert fit.mass_identified == (mass is None)
    assert abs(fit.dynamics.mass - MASS) <= 5 * fit.dynamics.uncertainty("mass")


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.soak(first=1)
def test_accelerometers_of_the_paper_leave_what_the_bound_says(drive: str, rng):
    simulation = shake(DRIVES[drive], rng, load=0.32, acceleration=5.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # poor coherence, said or not depending on the draw
        fit = identify_rig(simulation.recording, mass=MASS)
    errors, uncertainties = found(fit)
    assert np.all(np.abs(errors) < 5 * uncertainties)
    # The uncertainty stated contains the noise of the spectra it is computed from: a few percent.
    ratio = uncertainties / least_deviation(simulation, load=0.32, acceleration=5.0)
    assert np.all((ratio > 0.9) & (ratio < 1.1))
    # 2500 degrees of freedom and more scatter by 3 %, the noise floors by a few percent.
    assert 0.83 < fit.chi2 / fit.degrees_of_freedom < 1.17


@pytest.mark.parametrize("noise", [(0.32, 5.0), (0.05, 0.05)])
@pytest.mark.soak(first=1)
def test_scatter_reaches_the_bound_and_is_stated(noise: tuple[float, float], rng):
    draws = trials(10, 40)
    drive = Sweep(550.0, 850.0, 1.0)
    errors, uncertainties = np.empty((2, draws, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for i in range(draws):
            simulation = shake(drive, rng, load=noise[0], acceleration=noise[1])
            errors[i], uncertainties[i] = found(identify_rig(simulation.recording, mass=MASS))
    bound = least_deviation(simulation, load=noise[0], acceleration=noise[1])
    # Mean squares of n normal numbers follow chi2 / n; six of them are tested, each at 1e-5 on either side.
    low, high = np.sqrt(chi2.ppf([1e-5, 1 - 1e-5], draws) / draws)
    scores = np.sqrt(np.mean((errors / uncertainties) ** 2, axis=0))
    assert np.all((scores > 0.95 * low) & (scores < 1.05 * high)), scores
    assert np.all(np.sqrt(np.mean(errors**2, axis=0)) < 1.1 * high * bound)


def test_uncertain_mass_flows_into_stiffness_and_damping(rng):
    recording = shake(DRIVES["swept"], rng, load=0.32, acceleration=5.0).recording
    u = 0.0005
    exact, uncertain = (said(recording, mass=mass)[0].dynamics for mass in (MASS, (MASS, u)))
    lighter, heavier = (said(recording, mass=MASS + sign * u)[0].dynamics for sign in (-1, 1))
    assert uncertain.mass == MASS
    assert uncertain.uncertainty("mass") == pytest.approx(u)
    for name in ("stiffness", "damping"):
        shift = (getattr(heavier, name) - getattr(lighter, name)) / 2
        expected = np.hypot(exact.uncertainty(name), shift)
        assert uncertain.uncertainty(name) == pytest.approx(expected, rel=0.02)


def test_mass_more_uncertain_than_the_record_scales_stiffness_and_damping(rng):
    fit, _ = said(shake(DRIVES["swept"], rng).recording, mass=(MASS, 0.01 * MASS))
    d = fit.dynamics
    # The shape fixes w0 and b w0 / k to 1e-4 and better; k = M w0^2 and b = M w0 (b w0 / k) then go with the mass.
    assert d.uncertainty("stiffness") == pytest.approx(0.01 * d.stiffness, rel=0.01)
    assert d.uncertainty("damping") == pytest.approx(0.01 * d.damping, rel=0.01)
    assert d.uncertainty("natural_frequency") < 1e-4 * d.natural_frequency
    assert abs(d.damping / TRUE.damping - 1) < 5e-3


def test_accelerometer_gain_that_is_off_does_not_bend_the_shape(rng):
    recording = shake(DRIVES["swept"], rng).recording
    ground = 1.05 * recording.channel("ground_acceleration").values
    fit, texts = said(with_channel(recording, "ground_acceleration", values=ground), mass=MASS)
    assert any("implies a moving mass of 0.647" in text for text in texts), texts
    errors, uncertainties = found(fit)
    assert np.all(np.abs(errors) < 5 * uncertainties)


def test_gain_uncertainty_of_the_accelerometer_counts(rng):
    recording = shake(DRIVES["swept"], rng).recording
    doubtful = with_channel(recording, "ground_acceleration", relative_uncertainty=0.01)
    fit = identify_rig(doubtful).dynamics
    assert fit.uncertainty("mass") == pytest.approx(0.01 * fit.mass, rel=0.01)


def test_an_ac_coupled_accelerometer_is_taken_for_what_it_reads(rng):
    """Through a high-pass of 50 Hz, j f / (j f + 50 Hz), the motion leads by 4 degrees at the resonance."""
    recording = shake(Sweep(500.0, 900.0, 0.6), rng).recording
    values = recording.channel("ground_acceleration").values
    frequency = np.fft.rfftfreq(values.size, 1 / recording.rate)
    passed = np.fft.irfft(np.fft.rfft(values) * 1j * frequency / (1j * frequency + 50.0), values.size)
    fit = identify_rig(
        with_channel(recording, "ground_acceleration", values=passed, coupling="ac", corner=50.0), mass=MASS
    )
    errors, uncertainties = found(fit)
    assert np.all(np.abs(errors) < 5 * uncertainties)


def test_a_weighed_mass_on_one_mode_needs_no_other(rng):
    fit, texts = said(shake(Sweep(500.0, 900.0, 0.6), rng).recording, mass=MASS, modes="auto")
    assert fit.dynamics.further_modes == ()
    assert not any("further mode" in text for text in texts)
    errors, uncertainties = found(fit)
    assert np.all(np.abs(errors) < 5 * uncertainties)


def test_delay_known_from_the_channel_settings_is_removed(rng):
    recording = shake(DRIVES["stepped"], rng).recording
    settled = with_channel(recording, "AF", delay=DELAY)
    left = identify_rig(settled, mass=MASS).dynamics
    assert abs(left.delay) < 5 * left.uncertainty("delay")
    given = identify_rig(settled, mass=MASS, delay=0.0).dynamics
    assert given.delay == 0.0
    assert given.uncertainty("delay") == 0.0
    assert given.uncertainty("damping") < left.uncertainty("damping")


def along(recording: Recording, component: str) -> Recording:
    """The record as that of another force: load and accelerometers with its names."""
    ending = {"AF": "", "SF": "_y", "NF": "_z"}[component]
    names = {"AF": component} | {f"{end}_acceleration": f"{end}_acceleration{ending}" for end in ("ground", "live")}
    channels = {names.get(name, name): channel for name, channel in recording.channels.items()}
    return replace(recording, channels={name: replace(one, name=name) for name, one in channels.items()})


@pytest.mark.parametrize("component", ["NF", "SF"])
@pytest.mark.soak(first=1)
def test_the_accelerometer_of_its_axis_drives_a_force(component: str, rng):
    """A table that shakes a little along as well: with that accelerometer the mass would be 20 times as large."""
    shaken = shake(DRIVES["random"], rng, live=True).recording
    aft = shaken.channel("ground_acceleration")
    aft = replace(aft, values=0.05 * aft.values, relative_uncertainty=0.1)
    turned = along(shaken, component)
    turned = replace(turned, channels={**turned.channels, "ground_acceleration": aft})
    fit, texts = said(turned, component=component)
    assert texts == []
    assert fit.live is not None
    # the uncertain gain of the accelerometer along does not count; five standard deviations
    assert abs(fit.dynamics.mass - MASS) < 5 * fit.dynamics.uncertainty("mass") < 0.01 * MASS
    assert fit.dynamics.damping == pytest.approx(identify_rig(shaken).dynamics.damping, rel=1e-9)


@pytest.mark.parametrize(
    ("component", "coupling"), [("AF", "kinematic"), ("AF", "dc"), ("NF", "dc"), ("SF", "kinematic")]
)
@pytest.mark.soak(first=2)
def test_pitching_ground_end(component: str, coupling: str, rng):
    # A balance that pitches while it is shaken feels x1'' less gravity along it; a dc accelerometer reads just that.
    simulation = shake(DRIVES["random"], rng, delay=0.0)
    slow = 0.1 * np.sin(2 * np.pi * 1.5 * np.arange(simulation.pitch.size) / 25e3)
    pitch, roll = 0.3 + slow, 0.2 - 0.5 * slow
    weights = {"AF": np.sin(pitch), "SF": np.cos(pitch) * np.sin(roll), "NF": -np.cos(pitch) * np.cos(roll)}
    gravity = STANDARD_GRAVITY * weights[component]
    recording = with_channel(simulation.recording, "pitch", values=pitch)
    recording = replace(recording, channels={**recording.channels, "roll": Channel("roll", roll, "rad")})
    # slow, so the load follows it as at rest
    recording = with_channel(recording, "AF", values=recording.channel("AF").values + TRUE.mass * gravity)
    ground = recording.channel("ground_acceleration").values
    if coupling == "dc":
        ground = ground - gravity
    recording = with_channel(recording, "ground_acceleration", values=ground, coupling=coupling)
    fit = identify_rig(along(recording, component), component=component, mass=MASS, delay=0.0)
    error = fit.dynamics.natural_frequency - TRUE.natural_frequency
    assert abs(error) < 5 * fit.dynamics.uncertainty("natural_frequency")


def test_live_accelerometer_agrees_or_is_called_off(rng):
    recording = shake(DRIVES["swept"], rng, live=True).recording
    check = identify_rig(recording, mass=MASS).live
    assert abs(check.gain - 1) < 5 * check.u_gain + 1e-3
    wrong = with_channel(recording, "live_acceleration", values=1.1 * recording.channel("live_acceleration").values)
    assert any("live accelerometer reads 1.1" in text for text in said(wrong, mass=MASS)[1])


@pytest.mark.soak(first=0)
def test_a_mode_above_does_not_bend_the_one_sought(rng):
    simulation = shake(RandomDrive(100.0, 3000.0, 1.0, rms=30.0), rng, load=0.32, acceleration=0.5, delay=0.0)
    spectrum = np.fft.rfft(simulation.ground_acceleration)
    ratio = np.fft.rfftfreq(simulation.load.size, 1 / 25e3) / 2500
    extra = np.fft.irfft(-0.005 * ratio**2 / (1 - ratio**2 + 0.02j * ratio) * spectrum, simulation.load.size)
    recording = with_channel(simulation.recording, "AF", values=simulation.recording.channel("AF").values + extra)
    fit, _ = said(recording, mass=MASS)
    assert TRUE.natural_frequency < fit.band[1] < 2500
    # What the second mode adds at the first is 0.005 (652 / 2500)^2 kg of 5.1 kg, 7e-5.
    error = fit.dynamics.natural_frequency / TRUE.natural_frequency - 1
    u = fit.dynamics.uncertainty("natural_frequency") / TRUE.natural_frequency
    assert abs(error) < 7e-5 + 5 * u
    wide, texts = said(recording, mass=MASS, band=(100.0, 3000.0))
    assert any("one mode does not describe" in text for text in texts), texts
    assert any("a further mode at" in text for text in texts), texts
    assert wide.left_out.natural_frequency == pytest.approx(2500.0, rel=0.01)


def test_far_below_resonance_is_refused_or_called_extrapolated(rng):
    recording = shake(RandomDrive(5.0, 20.0, 4.0), rng, load=0.32, acceleration=0.5).recording
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        # The load departs by (20 / 652)^2 = 1e-3 from that of a rigid balance; sixty lines of 1 % noise do not tell.
        try:
            fit = identify_rig(recording, mass=MASS, band=(5.0, 20.0))
        except FitError as refused:
            assert "does not carry the stiffness" in str(refused)
        else:
            f0, u = (fit.dynamics.natural_frequency, fit.dynamics.uncertainty("natural_frequency"))
            assert abs(f0 - TRUE.natural_frequency) < 5 * u
    with pytest.raises(FitError, match="does not carry the stiffness"), warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        quiet = shake(RandomDrive(2.0, 8.0, 6.0), rng, load=0.32, acceleration=0.5).recording
        identify_rig(quiet, mass=MASS, band=(2.0, 8.0))
    recording = shake(RandomDrive(100.0, 500.0, 3.0), rng).recording
    _, texts = said(recording, mass=MASS, band=(100.0, 500.0))
    assert any("no excitation reaches the natural frequency" in text for text in texts)


def test_missing_and_saturated_samples_are_called_out(rng):
    recording = shake(DRIVES["swept"], rng).recording
    values = recording.channel("AF").values.copy()
    values[1000] = np.nan
    values[60000:60050] = np.nan
    fit, texts = said(with_channel(recording, "AF", values=values), mass=MASS)
    assert any("51 missing sample(s); 60000 of 75000" in text for text in texts)
    assert abs(fit.dynamics.damping / TRUE.damping - 1) < 5e-3
    ground = np.clip(recording.channel("ground_acceleration").values, -9.0, 9.0)
    _, texts = said(with_channel(recording, "ground_acceleration", values=ground), mass=MASS)
    assert any("saturated" in text for text in texts)


def test_records_that_cannot_carry_a_result_are_refused(rng):
    recording = shake(DRIVES["swept"], rng).recording
    still = with_channel(recording, "ground_acceleration", values=np.zeros(recording.samples))
    with pytest.raises(FitError, match="ground_acceleration does not change"):
        identify_rig(still, mass=MASS)
    noise = with_channel(recording, "ground_acceleration", values=rng.standard_normal(recording.samples))
    with pytest.raises(FitError, match="does not answer the ground acceleration"):
        identify_rig(noise, mass=MASS)
    with pytest.raises(FitError, match="no channel PM"):
        identify_rig(recording, component="PM", mass=MASS)
    short = Recording.from_columns(
        np.arange(100) / 25e3,
        {
            name: replace(recording.channel(name), values=recording.channel(name).values[:100])
            for name in ("AF", "ground_acceleration")
        },
    )
    with pytest.raises(FitError, match="at least 256"):
        identify_rig(short, mass=MASS)
    brief = shake(Sweep(500.0, 900.0, 0.1), rng).recording  # lines lie 10 Hz apart
    with pytest.raises(FitError, match=r": [67] frequencies .* 620 to 680 Hz; 32 are needed"):
        identify_rig(brief, mass=MASS, band=(620.0, 680.0))


def test_wrong_calls(rng):
    recording = shake(Sweep(500.0, 900.0, 0.2), rng).recording
    with pytest.raises(ValueError, match="mass must be positive"):
        identify_rig(recording, mass=-1.0)
    with pytest.raises(ValueError, match="rising order"):
        identify_rig(recording, mass=MASS, band=(10.0, 5.0))


def several(generator, *further, drive=None, seconds=10.0, noise=(10.0, 0.1), applied=None) -> Recording:
    """Record of the balance of the cable cut, shaken, with these further modes."""
    drive = drive or band_noise(generator, low=5.0, high=400.0, rms=1.0, period=4 * seconds)
    sensors = {"AF": Sensor(noise=noise[0]), "ground_acceleration": Sensor(noise=noise[1])}
    rig = CableCut(
        dynamics=LARGE.with_modes(*further),
        cable_force=0.0,
        ground_acceleration=drive,
        applied=applied,
        sensors=sensors,
    )
    return rig.run(seconds, generator).recording


def some_mode(generator, frequency: float) -> Mode:
    """A mode within 15 % of a frequency, with a share of 3 to 8 % of either sign."""
    share = generator.choice([-1, 1]) * generator.uniform(0.03, 0.08)
    return Mode(frequency * generator.uniform(0.85, 1.15), generator.uniform(0.006, 0.012), share)


def normalised_errors(found: Dynamics, truth: Dynamics) -> tuple[np.ndarray, float]:
    """Errors of the parameters over their standard uncertainties, and chi2 of all; the delay is left out of both."""
    order = np.argsort([mode.natural_frequency for mode in found.further_modes])
    places = [0, 1, 2, *(4 + 3 * number + i for number in order for i in range(3))]
    expected = [0, 1, 2, *range(4, truth.values.size)]
    errors = found.values[places] - truth.values[expected]
    covariance = found.covariance[np.ix_(places, places)]
    free = np.diag(covariance) > 0
    errors, covariance = errors[free], covariance[np.ix_(free, free)]
    return errors / np.sqrt(np.diag(covariance)), float(errors @ np.linalg.solve(covariance, errors))


@pytest.mark.parametrize("mass", [LARGE.mass, None])
@pytest.mark.parametrize("modes", ["auto", 2])
@pytest.mark.soak(first=1)
def test_second_mode_is_found_within_its_uncertainty(mass: float | None, modes: str | int, rng):
    second = some_mode(rng, 165.0)
    sweep = Sweep(10.0, 400.0, 10.0, amplitude=1.0).signal(rng)
    for drive in (None, sweep):
        fit, texts = said(several(rng, second, drive=drive), mass=mass, modes=modes)
        assert not any("further mode" in text for text in texts), texts
        (mode,) = fit.dynamics.further_modes
        assert mode.natural_frequency == pytest.approx(second.natural_frequency, rel=0.01)
        scores, total = normalised_errors(fit.dynamics, LARGE.with_modes(second))
        # A normal number is beyond 6 once in 5e8. The uncertainties themselves scatter by some percent.
        assert np.all(np.abs(scores) < 6), scores
        assert total < 1.5 * chi2.isf(1e-6, scores.size), total


def test_as_many_modes_as_are_asked_for_are_found_in_a_short_record(rng):
    second = Mode(165.0, 0.008, 0.07)
    fit, _ = said(several(rng, second, seconds=2.0), modes=2)
    scores, _ = normalised_errors(fit.dynamics, LARGE.with_modes(second))
    assert np.all(np.abs(scores) < 6), scores


def test_three_modes_are_found(rng):
    further = some_mode(rng, 160.0), some_mode(rng, 280.0)
    fit, _ = said(several(rng, *further), modes="auto")
    assert len(fit.dynamics.further_modes) == 2, fit.notes
    scores, total = normalised_errors(fit.dynamics, LARGE.with_modes(*further))
    assert np.all(np.abs(scores) < 6), scores
    assert total < 1.5 * chi2.isf(1e-6, scores.size), total


@pytest.mark.slow
@pytest.mark.soak(first=0)
def test_scatter_of_the_second_mode_is_stated(rng):
    draws, second = trials(6, 30), Mode(165.0, 0.008, -0.05)
    scores, totals = [], []
    for _ in range(draws):
        score, total = normalised_errors(
            said(several(rng, second, seconds=6.0), modes=2)[0].dynamics, LARGE.with_modes(second)
        )
        scores.append(score)
        totals.append(total)
    # Mean squares of n normal numbers follow chi2 / n; six of them are tested, each at 1e-6 on either side.
    low, high = chi2.ppf([1e-6, 1 - 1e-6], draws) / draws
    squares = np.mean(np.square(scores), axis=0)
    assert np.all((squares > 0.8 * low) & (squares < 1.25 * high)), squares
    assert np.sum(totals) < 1.25 * chi2.isf(1e-6, draws * len(scores[0]))


@pytest.mark.parametrize("noise", [(10.0, 0.1), (2.0, 0.02)])
@pytest.mark.soak(first=1)
def test_one_mode_is_enough_where_there_is_one(noise, rng):
    for drive in (None, Sweep(10.0, 300.0, 10.0, amplitude=1.0).signal(rng)):
        fit, _ = said(several(rng, drive=drive, noise=noise), modes="auto")
        assert fit.dynamics.further_modes == (), fit.dynamics.further_modes


def test_modes_asked_for_have_to_be_there(rng):
    sweep = Sweep(10.0, 400.0, 10.0, amplitude=1.0).signal(rng)
    with pytest.raises(FitError, match="3 modes are asked for, and the record shows 2"):
        said(several(rng, Mode(165.0, 0.008, 0.07), drive=sweep), modes=3)
    for modes in (0, 6):
        with pytest.raises(ValueError, match="modes must be auto or a number from 1 to 5"):
            identify_rig(several(rng, seconds=1.0), modes=modes)


@pytest.mark.soak(first=0)
def test_mode_that_is_left_out_is_named(rng):
    second = some_mode(rng, 165.0)
    fit, texts = said(several(rng, second), mass=LARGE.mass)
    assert fit.dynamics.further_modes == ()
    assert fit.left_out is not None
    assert fit.left_out.natural_frequency == pytest.approx(second.natural_frequency, rel=0.01)
    assert any("further mode at" in text and "`modes='auto'` looks for it" in text for text in texts), texts


def test_modes_respond_alike_whichever_leads(rng):
    values = np.concatenate([[np.log(5.0), np.log(400.0), 0.02, 0.1], [np.log(900.0), 0.01, 0.3], rng.normal(size=6)])
    one = Parameters(np.array(values), 400.0)
    other = one.led_by(1)
    w = np.linspace(50.0, 1500.0, 200)
    assert response(other, w) == pytest.approx(response(one, w), rel=1e-12)
    assert other.shares == pytest.approx([0.3, 0.7])
    assert np.exp(other.values[1]) == pytest.approx(900.0)


def test_strongest_mode_leads(rng):
    # Most of the load goes through the second mode, whatever the search meets first.
    fit, _ = said(several(rng, Mode(165.0, 0.004, 0.7)), modes="auto", delay=0.0)
    assert fit.dynamics.delay == 0.0
    assert fit.dynamics.natural_frequency == pytest.approx(165.0, rel=1e-3)
    (other,) = fit.dynamics.further_modes
    assert other.natural_frequency == pytest.approx(LARGE.natural_frequency, rel=1e-3)
    assert other.share == pytest.approx(0.3, abs=6 * fit.dynamics.uncertainty("share_2"))


@pytest.mark.soak(first=0)
def test_uncertain_gain_leaves_the_shares_alone(rng):
    recording = several(rng, Mode(165.0, 0.008, 0.05))
    doubtful = with_channel(recording, "ground_acceleration", relative_uncertainty=0.02)
    for mass in (None, LARGE.mass):
        exact, loose = (said(each, mass=mass, modes=2)[0].dynamics for each in (recording, doubtful))
        for name in ("natural_frequency", "natural_frequency_2", "damping_ratio_2"):
            assert loose.uncertainty(name) < 1.5 * exact.uncertainty(name) + 1e-12, name
        # A share is a part of the whole response, whose scale the gain moves alike.
        assert loose.uncertainty("share_2") < 0.1 * 0.05
    free = said(doubtful, modes=2)[0].dynamics
    assert free.uncertainty("mass") == pytest.approx(0.02 * free.mass, rel=0.02)


@pytest.mark.soak(first=0)
def test_force_on_a_shaken_balance_with_two_modes_has_the_error_of_the_noise(rng):
    truth = LARGE.with_modes(some_mode(rng, 165.0))
    found = said(several(rng, *truth.further_modes), mass=LARGE.mass, modes="auto")[0].dynamics
    applied = band_noise(rng, low=1.0, high=250.0, rms=100.0, period=40.0)
    record = several(rng, *truth.further_modes, seconds=4.0, noise=(2.0, 0.02), applied=applied)
    right = applied(record.time)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        errors = [
            (estimate_force(record, dynamics=dynamics).only.values - right)[320:-320]
            for dynamics in (truth, found, found.with_modes())
        ]
    best, identified, without = (float(np.sqrt(np.mean(error**2))) for error in errors)
    # The parameters are known to 1e-3 and better of a load of some 180 N: less than 1 N beside some 5 N of noise.
    assert identified < 1.1 * best, (best, identified)
    assert without > 1.5 * best, (best, without)


def treadmill(name: str) -> Recording:
    file = TREADMILL / name
    if not file.exists():
        pytest.skip("the treadmill recordings are not in ../shared/data")
    stamps, moment, speed = np.loadtxt(file, skiprows=1).T
    interval = np.polyfit(np.arange(stamps.size), stamps, 1)[0]
    channels = {
        "PM": Channel("PM", moment, "N*m"),
        "ground_acceleration": Channel("ground_acceleration", -np.gradient(speed, interval), "m/s^2"),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # the time stamps jitter
        return Recording.from_columns(stamps, channels, name=name)


@pytest.mark.parametrize(("name", "most"), [("RandomSlowSpeed1.txt", 1.23), ("RandomFastSpeed1.txt", 1.60)])
@pytest.mark.soak(first=1)
def test_moment_of_a_treadmill_that_is_shaken(name: str, most: float):
    # A static gain leaves 1.27 and 1.70 N m; gain, natural frequency, damping and delay 1.20 and 1.49.
    recording = treadmill(name)
    fit, texts = said(recording, component="PM")
    assert any("damping is hardly identifiable" in text for text in texts)
    dynamics = fit.dynamics
    moment = recording.channel("PM").values
    ground = recording.channel("ground_acceleration").values
    # The low-pass is linear, so it may come first; then nothing rings at the ends of the record.
    low_pass = butter(2, 6 / (recording.rate / 2))
    curve = CubicSpline(recording.time, filtfilt(*low_pass, moment))
    later = recording.time + dynamics.delay
    felt, first, second = (curve(later, order) for order in range(3))
    left = felt + (dynamics.damping * first + dynamics.mass * second) / dynamics.stiffness
    left += dynamics.mass * filtfilt(*low_pass, ground)
    assert np.std(left) <= most
