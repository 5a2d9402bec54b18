"""Modes that a record has and the coupled dynamics have not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.estimation.force import estimate_force
from aerobalance.recording.recording import Recording
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.six_balance import random_balance
from aerobalance.simulation.six_signals import Band, broadband
from seeds import new_seed

BAND = Band(0, 900)


def _record() -> tuple[Recording, CoupledDynamics, np.random.Generator, int]:
    entropy = new_seed()
    generator = np.random.default_rng(entropy)
    balance = random_balance(generator)
    load = broadband(generator, BAND, rms=0.02 * balance.half_range, period=4.0)
    simulation = SixComponentRig(balance, applied=load, output="loads").run(2.0, generator)
    return simulation.recording, balance.dynamics, generator, entropy


def test_the_right_dynamics_are_not_doubted() -> None:
    recording, dynamics, _, entropy = _record()
    found = estimate_force(recording, dynamics, bandwidth=BAND.high)
    assert found.doubts == (), f"seed {entropy}"


@pytest.mark.filterwarnings("ignore:.* which is no mode of the dynamics")
def test_a_mode_beyond_the_six_is_named() -> None:
    """A bending mode at 760 Hz rings in NF and PM with a tenth of the balance load."""
    recording, dynamics, generator, entropy = _record()
    mode = Mode(760.0, 0.01)
    first, second = (np.exp(pole / recording.rate) for pole in mode.poles)
    ringing = lfilter(
        [1.0], np.real([1.0, -(first + second), first * second]), generator.normal(size=recording.samples)
    )
    channels = dict(recording.channels)
    for name in ("NF", "PM"):
        channel = recording.channel(name)
        size = 0.1 * float(np.std(channel.values)) / float(np.std(ringing))
        channels[name] = replace(channel, values=channel.values + size * ringing)
    bent = replace(recording, channels=channels)
    found = estimate_force(bent, dynamics, bandwidth=BAND.high)
    told = [doubt.text for doubt in found.doubts if doubt.kind == "missing mode"]
    frequencies = [float(text.split(" ring at ")[1].split(" Hz")[0]) for text in told]
    # within 1 % is what is promised of a mode that is left out
    assert any(abs(frequency / 760 - 1) < 0.01 for frequency in frequencies), f"{told}, seed {entropy}"
