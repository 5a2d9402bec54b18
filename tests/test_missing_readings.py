"""Gaps in one channel of six coupled components, under loads through all resonances."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from aerobalance.estimation import missing_readings
from aerobalance.estimation.component_force import Fitted
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.force_record import force_record
from aerobalance.estimation.missing_readings import MissingReadings
from aerobalance.estimation.statespace import kalman
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.resampling import fractional_delay, interpolate_gaps
from faults.six import HALF_RANGE, SIX, SixScene, balance, recording_of
from seeds import trials


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # the gaps are told
@pytest.mark.parametrize(("channel", "milliseconds"), [("PM", 1), ("AF", 2), ("PM", 4)])
@pytest.mark.soak(first=0)
def test_gaps_under_broad_loads_are_covered(channel: str, milliseconds: int, rng) -> None:
    inside, after, errors = [], [], []
    records, clock = trials(1, 4), replace(SIX, samples=2700)
    for _ in range(records):
        record = SixScene(clock=clock).record(rng)
        values = np.column_stack(list(record.columns.values()))
        missing = np.zeros(clock.samples, dtype=bool)
        behind = np.zeros(clock.samples, dtype=bool)
        for number in range(2):
            first = int(rng.integers(300 + 1200 * number, 1100 + 1200 * number))
            stop = first + 8 * milliseconds
            missing[first:stop], behind[stop : stop + 200] = True, True
        values[missing, COMPONENTS.index(channel)] = np.nan
        force = estimate_force(recording_of(values, SIX.rate), balance())
        found, u = (
            np.column_stack([getattr(one, name) for one in force.values()]) for name in ("values", "uncertainty")
        )
        z = (found - record.force) / u
        inside.append(z[missing])
        after.append(z[behind])
        errors.append(((found - record.force) / HALF_RANGE)[missing])
    # a gap of 1 to 4 ms holds one to three values of a band of 347 Hz, in six components: 12 of them a record
    assert np.sqrt(np.mean(np.square(inside))) < 1 + 4 / np.sqrt(2 * 12 * records)
    assert np.sqrt(np.mean(np.square(after))) == pytest.approx(1, abs=0.25)
    # once in 50 000 for the largest of some thousand
    assert np.max(np.abs(inside)) < 6
    # by a straight line through the forces of the others it was 0.3 % of half range
    assert np.sqrt(np.mean(np.square(errors))) < 1e-3


@pytest.mark.soak(first=0)
@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
def test_what_is_not_known_of_missing_readings_is_in_the_budget(rng) -> None:
    record = SixScene().record(rng)
    values = np.column_stack(list(record.columns.values()))
    values[2000:2030, COMPONENTS.index("SF")] = np.nan
    force = estimate_force(recording_of(values, SIX.rate), balance())
    name = "missing readings of coupled components"
    for one in force.values():
        (part,) = [part for part in one.contributions if part.name == name]
        assert part.deviation[2000:2400].max() > 10 * part.deviation[:1000].max()
        assert one.budget[name] > 0


@pytest.mark.parametrize("late", [0.1, 0.0])
@pytest.mark.soak(first=0)
def test_what_fills_a_long_gap_is_in_the_uncertainty(late: float, rng, monkeypatch) -> None:
    """Readings that are not found one by one: too many, or of channels on different clocks."""
    monkeypatch.setattr(missing_readings, "MOST", 0)
    scores = []
    for _ in range(trials(1, 2)):
        record = SixScene(clock=replace(SIX, samples=2500)).record(rng)
        given = recording_of(np.column_stack(list(record.columns.values())), SIX.rate)
        delays = {name: late * place / SIX.rate for place, name in enumerate(COMPONENTS)}
        channels, truth = {}, []
        for place, (name, channel) in enumerate(given.channels.items()):
            lag = {"delay": delays[name], "interval": 1 / SIX.rate}
            values = fractional_delay(channel.values, **lag).copy()
            if name == "RM":
                values[1400:1440] = np.nan
            channels[name] = replace(channel, values=values, delay=delays[name])
            truth.append(fractional_delay(record.force[:, place], **lag))
        force = estimate_force(replace(given, channels=channels), balance())
        near = slice(1390, 1450)
        z = [
            (force[name].values - own)[near] / force[name].uncertainty[near]
            for name, own in zip(force, truth, strict=True)
        ]
        scores.append(np.sqrt(np.mean(np.square(z), axis=1)))
    # Some 60 readings of a band of 347 Hz have as many independent values as twice that and their time, five: the mean
    # of as many squares, the largest of all components, is by chance beyond this once in a million, 2.8. Without what
    # fills the gap the score was 12 and 15.
    independent = 2 * 347 * (near.stop - near.start) / SIX.rate
    assert np.max(scores) < np.sqrt(chi2.isf(1e-6 / np.size(scores), independent) / independent)


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
def test_many_missing_readings_of_a_long_record_take_little_memory(rng) -> None:
    """A number for every missing reading and sample: as it is made and as it is whitened, and no more at once."""
    given = SixScene(clock=replace(SIX, samples=20_000)).record(rng)
    values = np.column_stack(list(given.columns.values()))
    values[9000:9080, COMPONENTS.index("SF")] = np.nan
    record = force_record(recording_of(values, SIX.rate), balance())
    filled = interpolate_gaps(record.loads)
    fits = {name: Fitted.without_steps(one) for name, one in record.component_records(filled).items()}
    numbers, some = 8 * 80 * len(values), 8 * kalman.AT_ONCE
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        _, missing = MissingReadings.of(record, fits, filled=filled)
        found = tracemalloc.get_traced_memory()[1] - before
        tracemalloc.reset_peak()
        few = missing.error(fits["SF"], few=True)
        told = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
    every = missing.error(fits["SF"])
    # of some series states, innovations and what they are made of, and readings of all components, are far fewer
    assert found < 2 * numbers + 8 * some
    assert told < 12 * some
    assert few.slopes.shape[1] < every.slopes.shape[1] // 2
    # at each of the ten times that eight more are looked at, what is left out is less than 1e-3 of all; squares add
    atol = np.sqrt(10) * 1e-3 * np.linalg.norm(every.deviation)
    np.testing.assert_allclose(few.deviation, every.deviation, rtol=0, atol=atol)
