"""Noise that rises at low frequency, as a run shows it: found, told from force, and counted where a force hides it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.spectra.noise_spectrum import ColoredNoise
from aerobalance.recording.doubts import Verdict
from faults.cases import Case, all_cases
from faults.scene import Record, Scene, band, soft
from faults.trials import scores, worked_out
from seeds import trials

CASES = {case.name: case for case in all_cases()}


def tried(case: Case, record: Record) -> tuple[Force, dict[str, float]]:
    """The force of a record and how far it is off."""
    force, said = worked_out(record, case.dynamics, case.settings)
    assert force is not None, said
    return force, scores(force.only.values, force.only.uncertainty, record.force)


def colored(force: Force) -> list[float | None]:
    """Effects of doubts about the color of the noise."""
    return [doubt.effect for doubt in force.doubts if doubt.kind == "colored noise"]


def test_it_is_taken_to_go_on_below_the_load_and_that_is_told():
    case = CASES["1/f from 20 Hz, 0-20 Hz"]
    found = [tried(case, case.record(seed)) for seed in range(trials(2, 20))]
    told = [(force, one, effect) for force, one in found for effect in colored(force)]
    assert len(told) >= 0.75 * len(found)  # it gains 8 to 31 in log-likelihood, and chance takes off some
    for force, one, effect in told:
        assert force.verdict is not Verdict.FIT
        assert force["AF"].learned is not None
        # where the record leaves it open, only the uncertainty counts it, by its probability
        (doubt,) = (one for one in force.doubts if one.kind == "colored noise")
        assert isinstance(force["AF"].learned.color, ColoredNoise) or "may rise" in doubt.text
        # without it the error is 0.31 N; its law goes on below 1 Hz, where that of these records ends, and its
        # density there is known to a factor of two
        of_it = (one["error"] ** 2 - 0.31**2) ** 0.5
        assert 0.5 < effect / of_it < 2
    error, u = (sum(one[key] ** 2 for _, one in found) ** 0.5 for key in ("error", "u"))
    assert 0.5 < error / u < 1.1


def test_it_is_no_force_where_there_is_none():
    case = CASES["1/f from 20 Hz, none"]
    for seed in range(trials(1, 20)):
        force, one = tried(case, case.record(seed))
        assert len(colored(force)) == 1
        assert np.ptp(force.only.values) == 0
        assert one["error"] < 2 * one["u"]
        # its mean over 2.5 s is what is left: u holds that, and what could be there unseen
        assert force.verdict is Verdict.FIT


@pytest.mark.soak(first=0)
@pytest.mark.parametrize(
    "force", [soft(1.0, 3.0, 2.0), band(1.0, 0.3, 100, fall=1.0), band(2.0, 0, 40)], ids=["1/f^2", "1/f", "band"]
)
def test_a_faint_force_is_not_taken_for_it(force):
    """A force that falls as slowly makes the balance ring, with 8000 times the power at its natural frequency."""
    case = replace(CASES["faint 2 N"], scene=Scene(force))
    for seed in range(trials(3, 20)):
        found, one = tried(case, case.record(seed))
        assert not colored(found)
        assert found["AF"].learned is not None
        assert not isinstance(found["AF"].learned.color, ColoredNoise)
        assert one["error"] < 1.5 * one["u"]


def test_what_is_assumed_of_it_is_what_it_does():
    """A load of 0-100 Hz hides a corner up to the natural frequency: the force changes with it by what is said."""
    case = CASES["0-100 Hz, 200 N"]
    record = case.record(0)
    plain, _ = tried(case, record)
    (assumed,) = [one for one in plain.assumed if one.kind == "colored noise"]
    corner = float(assumed.text.split("below ")[1].split(" Hz")[0])
    # 1/f noise, constant below a third of what the record resolves, with the density of the white part at its corner
    count, rng = record.force.size, np.random.default_rng(1)
    frequency = np.fft.rfftfreq(2 * count, 1 / record.rate)
    density = 2.0**2 / record.rate * corner / np.hypot(frequency, record.rate / count / 3)
    white = np.fft.rfft(rng.normal(size=2 * count))
    noise = np.fft.irfft(white * np.sqrt(density * record.rate), 2 * count)[:count]
    changed, _ = tried(case, record.with_column("AF", record.columns["AF"] + noise))
    change = changed.only.values - plain.only.values
    # one realisation of a few hundred ordinates, most of its power in the lowest; its mean is the zero of the channel
    assert float(np.std(change)) == pytest.approx(assumed.effect, rel=0.4)
