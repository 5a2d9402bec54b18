"""Sudden forces in gaps of the readings: nobody knows when they came, and the uncertainty says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import aerobalance as ab
from aerobalance.estimation.gap_levels import CHANGED
from aerobalance.recording.components import COMPONENTS
from faults.scene import Clock, band
from faults.six import SIX, SixScene, balance, recording_of
from helpers.cable_cut import T128
from seeds import trials

RATE, SAMPLES, HEIGHT = 1600.0, 8000, 400.0


def run_with_gap(
    rng: np.random.Generator, gap: int, *, height: float, samples: int = SAMPLES
) -> tuple[np.ndarray, ab.Recording, slice]:
    """A force of 20 N rms to 60 Hz with a step at any time in a gap, the readings, and where the gap is."""
    time, frequency = np.arange(samples) / RATE, np.fft.rfftfreq(samples, 1 / RATE)
    force = np.fft.irfft(np.fft.rfft(rng.normal(size=samples)) * ((frequency > 0) & (frequency < 60)), samples)
    force *= 20.0 / force.std()
    load = np.fft.irfft(np.fft.rfft(force) * T128.response(frequency), samples)
    first = int(rng.integers(0.3 * samples, 0.6 * samples))
    instant = (first + rng.uniform(1, gap - 1)) / RATE
    load += height * T128.step_response(time - instant) + 2.0 * rng.normal(size=samples)
    load[first : first + gap] = np.nan
    return force + height * (time >= instant), ab.Recording.from_arrays(time, {"AF": load}), slice(first, first + gap)


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # the gap is told
@pytest.mark.parametrize(("gap", "samples"), [(400, 2400), (40, SAMPLES), (400, SAMPLES)])
@pytest.mark.soak(first=1)
def test_a_step_at_any_time_in_a_gap_is_covered(gap: int, samples: int, rng) -> None:
    """Of 25 ms, one and a half periods, and of 250 ms, after which nothing rings any more; also in 1.5 s."""
    squares, count = [], trials(2, 60)
    for _ in range(count):
        truth, run, there = run_with_gap(rng, gap, height=HEIGHT, samples=samples)
        found = ab.estimate_force(run, T128).only
        assert CHANGED in found.budget
        z = (found.values - truth) / found.uncertainty
        squares.append(float(np.mean(z[there] ** 2)))
        for step in found.steps:
            if there.start <= step.instant * RATE <= there.stop + 6:  # a quarter of a period
                assert step.instant_uncertainty > 0.9 * gap / RATE / np.sqrt(12)
        outside = np.concatenate([z[: there.start - 20], z[there.stop + 20 :]])
        assert np.sqrt(np.mean(outside**2)) < 1.3
    # of errors of one sign over a share of the gap the mean square is between 0 and 3, its deviation below 1
    assert 0.3 < np.mean(squares) < 1 + 4 / np.sqrt(count)


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
@pytest.mark.soak(first=0)
def test_gaps_without_a_step_are_as_uncertain_as_before(rng) -> None:
    """A change of five scatters is one in 2e6: none by chance; nor is a gap looked at that hides no instant."""
    for _ in range(trials(2, 40)):
        for gap in (5, 40, 400):
            _, run, _ = run_with_gap(rng, gap, height=0.0)
            assert CHANGED not in ab.estimate_force(run, T128).only.budget
    _, run, _ = run_with_gap(rng, 5, height=HEIGHT)  # a fifth of a period
    assert CHANGED not in ab.estimate_force(run, T128).only.budget


@pytest.mark.soak(first=0)
@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
def test_coupled_components_have_it_where_any_of_them_lacks_its_reading(rng) -> None:
    """A sudden force along NF while PM is not read for 30 ms: NF is as uncertain there, and the others are calm."""
    clock = replace(SIX, samples=8000)
    first, stop = 3000, 3240
    instant = (first + rng.uniform(40, 200)) / clock.rate

    def stepped(clock: Clock, rng: np.random.Generator) -> np.ndarray:
        back = 0.5 + 0.5 * np.cos(np.pi * np.clip((clock.time - clock.end - 0.1) / 1.5, 0, 1))
        return 0.3 * (clock.time > instant) * back + band(0.005, 0, 100.0)(clock, rng)

    forces = [stepped, *[band(0.005, 0, 100.0)] * 5]
    record = SixScene(forces=forces, clock=clock).record(rng)
    values = np.column_stack(list(record.columns.values()))
    values[first:stop, COMPONENTS.index("PM")] = np.nan
    force = ab.estimate_force(recording_of(values, clock.rate), balance())
    assert CHANGED in force["NF"].budget
    assert not any(CHANGED in force[name].budget for name in COMPONENTS if name != "NF")
