"""The response to the ground's motion, which is a known force, tells other dynamics than those expected."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.checks.driven_response import driven_response, speaks_against
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.force_record import force_record
from aerobalance.estimation.independent_record import SingleRecord
from aerobalance.recording.channel import Channel
from aerobalance.recording.doubts import Verdict
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from seeds import trials

MASS, NATURAL, RATIO, RATE, SECONDS = 12.8, 45.0, 0.01, 2000.0, 4.0
NOISE, OF_SENSOR = 0.5, 0.02


def known(frequency: float = 1.0, damping: float = 1.0) -> Dynamics:
    """Dynamics whose natural frequency and damping ratio are these times the balance's."""
    angular = 2 * np.pi * NATURAL * frequency
    return Dynamics("AF", mass=MASS, stiffness=MASS * angular**2, damping=2 * RATIO * damping * MASS * angular)


def band(rng: np.random.Generator, first: float, last: float, rms: float) -> np.ndarray:
    """Periodic noise between two frequencies, of twice the length of a record."""
    count = round(2 * SECONDS * RATE)
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    lines = rng.normal(size=frequency.size) + 1j * rng.normal(size=frequency.size)
    values = np.fft.irfft(np.where((frequency >= first) & (frequency <= last), lines, 0), count)
    return rms * values / values.std()


def shaken(
    rng: np.random.Generator, *, force: np.ndarray, rms: float = 0.3, gain: float = 1.0, late: float = 0.0
) -> Recording:
    """The record of a force of twice its length, periodic, on a ground that shakes from 2 to 60 Hz [m/s^2]."""
    ground = band(rng, 2.0, 60.0, rms)
    frequency = np.fft.rfftfreq(force.size, 1 / RATE)
    turns = np.exp(-2j * np.pi * frequency * late)
    seen = np.fft.irfft(np.fft.rfft(ground) * turns, force.size) * gain
    felt = np.fft.irfft(np.fft.rfft(force - MASS * ground) * known().response(frequency), force.size)
    half = force.size // 2
    channels = {
        "AF": Channel("AF", felt[:half] + rng.normal(0, NOISE, half), "N"),
        "ground_acceleration": Channel("ground_acceleration", seen[:half] + rng.normal(0, OF_SENSOR, half), "m/s^2"),
        "pitch": Channel("pitch", np.zeros(half), "rad", noise=1e-4),
    }
    return Recording.from_columns(np.arange(half) / RATE, channels)


def steady(rng: np.random.Generator) -> np.ndarray:
    """A slow force, whose own spectrum tells nothing of the resonance."""
    return 30 + band(rng, 0.2, 8.0, 10.0)


def asked(recording: Recording, dynamics: Dynamics) -> SingleRecord:
    record = force_record(recording, dynamics).component_record("AF")
    assert isinstance(record, SingleRecord)
    return record


def estimated(recording: Recording, dynamics: Dynamics, **settings) -> Force:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return estimate_force(recording, dynamics, **settings)


@pytest.mark.parametrize(
    ("frequency", "damping", "align"),
    [(1.1, 1.0, False), (1.0, 2.0, False), (0.9, 1.0, True), (1.02, 1.0, False), (0.95, 0.5, True), (1.0, 2.0, True)],
)
@pytest.mark.soak(first=3)
def test_other_dynamics_are_named_and_counted(frequency, damping, align, rng) -> None:
    """Taken off by other dynamics, the ground's load is in the force: 20 to 130 of its uncertainties."""
    force = steady(rng)
    recording, dynamics = shaken(rng, force=force), known(frequency, damping)
    found = estimated(recording, dynamics, align=align)
    kinds = {doubt.kind for doubt in found.doubts if doubt.effect != 0}  # an alignment that was asked for stays said
    assert kinds == {"natural frequency" if frequency != 1 else "damping ratio"}
    (text,) = [doubt.text for doubt in found.doubts if doubt.kind in kinds]
    assert "as its response to the ground's motion shows" in text
    part = found["AF"]
    error = part.values - force[: part.values.size]
    # what is counted is the error itself, known but for its sign: less what the smoother does not pass of it
    assert np.std(error) == pytest.approx(np.sqrt(np.mean(part.uncertainty**2)), rel=0.15)


def test_the_numbers_are_as_sure_as_they_state(rng) -> None:
    """Natural frequency and damping ratio of some records, over their standard uncertainties."""
    scores = []
    for _ in range(trials(4, 20)):
        record = asked(shaken(rng, force=steady(rng)), known(1.05, 1.5))
        found = driven_response(record, used=record)
        assert found is not None
        scores.append((found.change + np.log([1.05, 1.5])) / found.u)
    # of eight numbers the rms is below 1.8 but once in a thousand times (chi-squared); it is 0.7 in the mean of 60
    # records, as the ordinates of a window are worth more than the least that is counted
    assert 0.2 < np.sqrt(np.mean(np.square(scores))) < 1.8


@pytest.mark.parametrize(("gain", "late"), [(1.0, 0.0), (1.3, 0.0), (-1.0, 0.0), (1.0, 1e-3)])
def test_the_dynamics_are_not_taken_for_a_channel(gain, late, rng) -> None:
    recording = shaken(rng, force=steady(rng), gain=gain, late=late)
    record = asked(recording, known())
    assert driven_response(record, used=record) is None
    found = estimated(recording, known())
    assert not {doubt.kind for doubt in found.doubts} & {"natural frequency", "damping ratio"}
    assert (found.verdict == Verdict.FIT) == (gain == 1 and late == 0)


def test_a_tone_of_the_ground_tells_nothing(rng) -> None:
    """A rotor shakes the ground and the model: the force has the same tone, which other dynamics would explain."""
    recording = shaken(rng, force=steady(rng), rms=1e-3)
    time = np.arange(recording.samples) / RATE
    tone = np.sin(2 * np.pi * 43.0 * time)
    channels = dict(recording.channels)
    for name, size in (("ground_acceleration", 0.3), ("AF", 60.0)):
        channels[name] = replace(channels[name], values=channels[name].values + size * tone)
    record = asked(replace(recording, channels=channels), known())
    assert driven_response(record, used=record) is None


def test_a_ground_at_rest_is_not_asked(rng) -> None:
    recording = shaken(rng, force=steady(rng), rms=1e-9)
    still = replace(recording, channels={"AF": recording.channel("AF"), "pitch": recording.channel("pitch")})
    record = asked(still, known(1.1))
    assert driven_response(record, used=record) is None


def test_the_ringing_after_a_step_is_left_out(rng) -> None:
    """Of 100 N it is a hundred times what the ground makes the balance ring."""
    force = steady(rng) + 100.0 * (np.arange(round(2 * SECONDS * RATE)) >= RATE)
    found = estimated(shaken(rng, force=force, rms=0.5), known(1.1))
    (doubt,) = [doubt for doubt in found.doubts if doubt.kind == "natural frequency"]
    assert "as its response to the ground's motion shows" in doubt.text


@pytest.mark.parametrize("frequency", [0.9, 1.2, 0.8, 1.12])
@pytest.mark.soak(first=2)
def test_a_broad_load_tells_a_frequency_far_from_the_expected_one(frequency, rng) -> None:
    """Ground at rest: the error was 30 to 110 of its uncertainties, as the expected resonance explains a part too."""
    force = band(rng, 0.2, 100.0, 30.0)
    recording = shaken(rng, force=force, rms=1e-9)
    still = replace(recording, channels={"AF": recording.channel("AF")})
    found = estimated(still, known(frequency))
    assert any(doubt.kind == "natural frequency" for doubt in found.doubts)
    error = found["AF"].values - force[: still.samples]
    assert np.std(error) == pytest.approx(np.sqrt(np.mean(found["AF"].uncertainty ** 2)), rel=0.25)


def test_the_motion_speaks_against_what_a_load_seems_to_show(rng) -> None:
    """Other dynamics than the balance's explain the motion's load worse, and its own never do."""
    recording = shaken(rng, force=steady(rng))
    record, wrong = asked(recording, known()), asked(recording, known(1.05))
    for other in (known(1.02), known(damping=2.0), known(0.9)):
        assert speaks_against(other, record, used=record)
    assert not speaks_against(known(), record, used=record)
    assert not speaks_against(known(), wrong, used=wrong)


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_a_pure_tone_without_noise_is_asked_nothing(noise, rng) -> None:
    """What its window makes of it goes with the motion at all frequencies: no search may run away with it."""
    time = np.arange(3200) / 1600
    ground = 3 * np.cos(2 * np.pi * 20 * time)
    channels = {
        "AF": Channel("AF", 1.0 + noise * rng.normal(size=time.size), "N", noise=noise),
        "ground_acceleration": Channel("ground_acceleration", ground, "m/s^2", noise=noise),
    }
    record = asked(Recording.from_columns(time, channels), known())
    assert driven_response(record, used=record) is None
