"""Stepped-sine records: dwells found, amplitudes fitted, deviations split; the paper's own lines."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import irfft, rfft, rfftfreq

from aerobalance.identification.base_excitation.paper_procedure import reference_fit
from aerobalance.identification.base_excitation.sine_dwell import amplitudes, find_dwells, harmonic_check
from aerobalance.recording.channel import AntiAlias
from aerobalance.recording.errors import FitError
from aerobalance.simulation import Sensor, SteppedSine, Sweep, Unsteadiness, VibrationRig
from aerobalance.simulation.published import VIBRATION_RIG

TRUE = VIBRATION_RIG.dynamics
STEPS = (*np.arange(20.0, 600.0, 40.0), *np.arange(600.0, 651.0, 10.0), 652.5, *np.arange(660.0, 751.0, 10.0), 752.0,
         *np.arange(760.0, 1000.0, 20.0))  # fmt: skip


def shake(drive, generator, *, load=0.05, acceleration=0.05):
    sensors = {"AF": Sensor(noise=load)}
    sensors |= {name: Sensor(noise=acceleration) for name in ("ground_acceleration", "live_acceleration")}
    return VibrationRig(sensors=sensors).run(drive, generator).recording


@pytest.mark.parametrize("hold", [0.4, 0.9])
@pytest.mark.soak(first=1)
def test_dwells_are_found_and_fitted(hold: float, rng):
    steps = STEPS[::2]
    dwells = find_dwells(shake(SteppedSine(steps, settle=0.1, hold=hold), rng))
    frequency, load, ground, live = amplitudes(dwells)
    assert len(dwells) == len(steps)
    assert np.all(np.abs(frequency - steps) < 5 * np.array([d.u_frequency for d in dwells]))
    assert all(dwell.steady for dwell in dwells)
    # Newton for the chain (momentum): m1 x1'' + M x2'' is the 10 N drive.
    force = np.abs(2.07 * ground + TRUE.mass * live)
    u = np.hypot(2.07, TRUE.mass) * np.array([d.u_ground for d in dwells])
    assert np.all(np.abs(force - 10) < 5 * u + 1e-3)
    assert np.all(np.abs(np.abs(load) - TRUE.amplitude(frequency, np.abs(ground))) < 0.1)


def test_harmonic_deviation_of_steady_dwells_is_a_tenth_of_a_newton_at_most(rng):
    recording = shake(SteppedSine(STEPS, settle=0.05, hold=0.35), rng)
    dwells = find_dwells(recording)
    checks = harmonic_check(recording, dwells, dynamics=TRUE)
    assert {652.5, 752.0} <= {round(check.frequency, 1) for check in checks}
    assert max(abs(check.deviation) for check in checks) <= 0.1
    for check in checks:
        assert check.deviation == pytest.approx(check.unsteadiness + check.model, abs=1e-12)
        noise = np.hypot(check.accelerometer_noise, check.balance_noise)
        # The deviation is noise and nothing else: five standard deviations, and a settling error of 1e-4 of 16 N.
        assert abs(check.deviation) < 5 * noise + 2e-3


def test_accelerometer_noise_explains_the_deviation_of_steady_dwells(rng):
    recording = shake(SteppedSine(STEPS[5:], settle=0.05, hold=0.25), rng, load=0.32, acceleration=5.0)
    checks = harmonic_check(recording, find_dwells(recording), dynamics=TRUE)
    scores = np.array([c.deviation / np.hypot(c.accelerometer_noise, c.balance_noise) for c in checks])
    # Mean square of 40 normal numbers within chi2 / n at 1e-6: 0.22 to 2.4.
    assert 0.22 < np.mean(scores**2) < 2.4


def test_dwells_of_a_force_are_those_of_the_accelerometer_of_its_axis(rng):
    recording = shake(SteppedSine((600.0, 640.0, 680.0), settle=0.05, hold=0.25), rng)
    names = {"AF": "NF"} | {f"{end}_acceleration": f"{end}_acceleration_z" for end in ("ground", "live")}
    turned = {names.get(name, name): channel for name, channel in recording.channels.items()}
    aft = {"ground_acceleration": recording.channel("ground_acceleration")}
    aft["ground_acceleration"] = replace(aft["ground_acceleration"], values=rng.normal(size=recording.samples))
    channels = {name: replace(channel, name=name) for name, channel in turned.items()} | aft
    turned_record = replace(recording, channels=channels)
    dwells = find_dwells(turned_record, component="NF")
    assert dwells == find_dwells(recording)
    dynamics = replace(TRUE, component="NF")
    assert harmonic_check(turned_record, dwells, dynamics=dynamics) == harmonic_check(recording, dwells, dynamics=TRUE)


def test_unsteady_dwells_are_flagged_and_their_deviation_is_split(rng):
    steps = (
        *np.arange(540.0, 640.0, 20.0),
        652.5,
        *np.arange(680.0, 730.0, 20.0),
        752.0,
        *np.arange(780.0, 880.0, 20.0),
    )
    drive = SteppedSine(steps, settle=0.0, hold=0.3, unsteadiness=Unsteadiness())
    recording = shake(drive, rng)
    checks = harmonic_check(recording, find_dwells(recording), dynamics=TRUE)
    flagged = [check.frequency for check in checks if not check.steady]
    for frequency in (652.5, 752.0):
        assert any(abs(f - frequency) < 5 for f in flagged)
    worst = max(checks, key=lambda check: abs(check.deviation))
    assert not worst.steady
    # With quiet sensors nothing but non-steadiness is left to explain it.
    assert abs(worst.model) < 0.2 * abs(worst.deviation) + 5 * np.hypot(worst.accelerometer_noise, 0.01)


def test_lines_of_the_paper_find_the_true_values(rng):
    dwells = find_dwells(shake(SteppedSine(STEPS[5:], settle=0.05, hold=0.25), rng))
    fit = reference_fit(dwells, mass=TRUE.mass)
    assert fit.natural_frequency == pytest.approx(TRUE.natural_frequency, rel=3e-4)
    assert fit.damping == pytest.approx(TRUE.damping, rel=5e-3)
    assert fit.stiffness == pytest.approx(TRUE.mass * (2 * np.pi * fit.natural_frequency) ** 2)
    near = (fit.frequency > 600) & (fit.frequency < 700)
    # Dwell by dwell, near resonance, noise of 0.05 m/s^2 is 0.1 % of the amplitude and less.
    assert np.allclose(fit.natural_frequencies[near], TRUE.natural_frequency, rtol=2e-3)
    assert np.allclose(fit.dampings[near], TRUE.damping, rtol=2e-2)


def test_phase_between_the_accelerometers_is_the_wrong_one(rng):
    dwells = find_dwells(shake(SteppedSine(STEPS[5:], settle=0.05, hold=0.25), rng))
    wrong = reference_fit(dwells, mass=TRUE.mass, phase="absolute")
    # METHOD: 659.8 Hz; which frequencies are held moves it between 659.4 and 660.3 Hz (closed forms, no noise).
    assert 659.0 < wrong.natural_frequency < 660.7
    assert wrong.damping > 1.03 * TRUE.damping


def test_no_dwells_in_a_record_without(rng):
    recording = shake(Sweep(100.0, 1000.0, 1.0), rng)
    with pytest.raises(FitError, match="no frequency is held"):
        find_dwells(recording)
    with pytest.raises(FitError, match="too few for a line"):
        reference_fit((), mass=1.0)
    with pytest.raises(ValueError, match="relative or absolute"):
        reference_fit((), mass=1.0, phase="both")


def test_dwells_that_do_not_go_with_the_mass_or_lack_a_channel(rng):
    """With a mass M' the abscissa of Eq. (15) is 1 - M'/M (1 - (f/f0)^2): far below f0 negative for one too large."""
    recording = shake(SteppedSine((200.0, 240.0, 280.0), settle=0.05, hold=0.35), rng)
    with pytest.raises(FitError, match=r"the line of Eq. \(15\) has the slope -.* must be positive"):
        reference_fit(find_dwells(recording), mass=3 * TRUE.mass)
    with pytest.raises(ValueError, match="mass must be positive"):
        reference_fit(find_dwells(recording), mass=0.0)
    bare = {name: channel for name, channel in recording.channels.items() if name != "live_acceleration"}
    with pytest.raises(FitError, match="needs a live accelerometer"):
        reference_fit(find_dwells(replace(recording, channels=bare)), mass=TRUE.mass, phase="absolute")


def test_delays_and_ac_coupling_that_channels_state_are_undone(rng):
    """A load that is read 1 ms late, and says so, gave four times the damping."""
    drive = SteppedSine((560.0, 600.0, 640.0, 680.0, 720.0), settle=0.05, hold=0.25)
    recording = shake(drive, rng)
    late = {"AF": 20, "ground_acceleration": 3, "live_acceleration": 7}
    channels = dict(recording.channels)
    for name, count in late.items():
        channel = channels[name]
        channels[name] = replace(channel, values=np.roll(channel.values, count), delay=count / recording.rate)
    delayed = replace(recording, channels=channels)
    before, after = find_dwells(recording), find_dwells(delayed)
    for own, other in zip(amplitudes(before), amplitudes(after), strict=True):
        # samples at the ends of the dwells are others, and so is their noise
        u = max(dwell.u_ground + dwell.u_load + dwell.u_live for dwell in before)
        assert np.abs(other - own) == pytest.approx(0, abs=8 * u + 1e-3 * np.abs(own).max())
    found, true = (reference_fit(dwells, mass=TRUE.mass) for dwells in (after, before))
    assert found.damping == pytest.approx(true.damping, rel=0.02)
    assert found.natural_frequency == pytest.approx(true.natural_frequency, rel=1e-3)
    # a corner at 600 Hz: a sine passes with the factor i f / (i f + corner)
    ground = recording.channel("ground_acceleration")
    coupled = {**recording.channels, "ground_acceleration": replace(ground, coupling="ac", corner=600.0)}
    ac = find_dwells(replace(recording, channels=coupled))
    frequency, _, measured, _ = amplitudes(before)
    assert amplitudes(ac)[2] == pytest.approx(measured * (1j * frequency + 600) / (1j * frequency))


def test_filters_that_the_channels_state_are_undone_in_the_dwells(rng):
    """A load behind a low-pass that turned it by 40 degrees at 650 Hz gave no damping at all."""
    drive = SteppedSine((560.0, 600.0, 640.0, 680.0, 720.0), settle=0.05, hold=0.25)
    recording = shake(drive, rng, load=0.0, acceleration=0.0)
    filters = {
        "AF": AntiAlias("butterworth", 4, 2500.0),
        "ground_acceleration": AntiAlias("bessel", 4, 3000.0),
        "live_acceleration": AntiAlias("butterworth", 2, 4000.0),
    }
    channels = dict(recording.channels)
    for name, low_pass in filters.items():
        channel = channels[name]
        size = 2 * channel.values.size  # the impulse response is over long before the record begins anew
        spectrum = rfft(channel.values, size) * low_pass.response(rfftfreq(size, 1 / recording.rate))
        channels[name] = replace(channel, values=irfft(spectrum, size)[: channel.values.size], filter=low_pass)
    filtered = replace(recording, channels=channels)
    before, after = find_dwells(recording), find_dwells(filtered)
    for own, other in zip(amplitudes(before), amplitudes(after), strict=True):
        # what is left is how the record is continued beyond its end, within the memory of a filter: a few samples
        # (1 / 2 pi 2500 Hz is 1.6 of them) of the 5600 of the last dwell
        assert np.abs(other - own) == pytest.approx(0, abs=1e-3 * np.abs(own).max())
    found, true = (reference_fit(dwells, mass=TRUE.mass) for dwells in (after, before))
    assert found.damping == pytest.approx(true.damping, rel=1e-3)
    assert found.natural_frequency == pytest.approx(true.natural_frequency, rel=1e-3)
    own, other = (harmonic_check(one, d, dynamics=TRUE) for one, d in ((recording, before), (filtered, after)))
    for one, two in zip(own, other, strict=True):
        assert (two.unsteadiness, two.model) == pytest.approx((one.unsteadiness, one.model), abs=1e-3 * one.measured)
