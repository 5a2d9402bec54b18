"""Channels of a moving ground end in six degrees of freedom go through the files, in their own units or others."""

import numpy as np
import pytest

from aerobalance.io import read, write_recording
from aerobalance.simulation import SixComponentRig, oscillation, random_balance
from aerobalance.simulation.six_components import GROUND_CHANNELS


@pytest.mark.parametrize("suffix", [".csv", ".h5"])
def test_recordings_of_six_components_read_back(tmp_path, suffix):
    generator = np.random.default_rng(8)
    rig = SixComponentRig(random_balance(generator), base=oscillation("YM", amplitude=0.02, frequency=30.0, lever=0.5))
    recording = rig.run(0.01, generator).recording
    path = tmp_path / f"run{suffix}"
    write_recording(path, recording)
    found = read(path)
    assert set(found.channels) == set(recording.channels)
    for name in (*GROUND_CHANNELS, "rNF", "rPM"):
        np.testing.assert_allclose(found.channel(name).values, recording.channel(name).values, rtol=1e-14)
        assert found.channel(name).unit == recording.channel(name).unit


def test_angular_acceleration_in_degrees(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time [s],ground_turn_RM [deg/s^2]\n0,180\n0.1,90\n")
    np.testing.assert_allclose(read(path).channel("ground_turn_RM").values, [np.pi, np.pi / 2], rtol=1e-15)
