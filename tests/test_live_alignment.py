"""Channels that lag each other: brought onto one clock, whatever the lag, and however the samples come cut."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerobalance.estimation.live.alignment import Aligner
from aerobalance.recording.resampling import REACH, SHARPNESS


def pushed(aligner, rows, cuts):
    parts = np.split(rows, sorted({min(cut, rows.shape[0]) for cut in cuts}))
    return np.concatenate([aligner.push(part) for part in parts])


def test_a_lag_of_any_part_of_a_sample_is_taken_out(rng) -> None:
    late = np.array([0.0, *rng.uniform(-30, 30, 4)])
    k = np.arange(600.0)
    # the main lobe of a Kaiser window of parameter b that reaches over r samples is sqrt(b^2 + pi^2) / r wide: so far
    # below the Nyquist frequency, from 0.605 of it on, the interpolation falls off
    highest = np.pi - np.sqrt(SHARPNESS**2 + np.pi**2) / REACH
    turn = rng.uniform(0.01 * np.pi, highest)
    rows = np.sin(turn * (k[:, None] - late))
    made = Aligner(late).push(rows)
    expected = np.sin(turn * k[: made.shape[0]])
    inside = slice(31 + REACH, None)
    # below it a filter of this window errs by A dB, with b = 0.1102 (A - 8.7) [Kaiser1974]; by that from either side
    # of the band, and again as its weights are made to add up to 1
    error = 10 ** (-(SHARPNESS / 0.1102 + 8.7) / 20)
    assert np.abs(made[inside] - expected[inside, None]).max() < 4 * error
    assert made[:, 0] == pytest.approx(rows[: made.shape[0], 0], abs=0)


def test_whole_samples_are_taken_out_exactly(rng) -> None:
    rows = rng.normal(size=(50, 3))
    rows[20, 1] = np.nan
    aligner = Aligner([0.0, 3.0, -4.0])
    made = aligner.push(rows)
    assert aligner.ahead == 3
    assert made.shape == (47, 3)
    assert np.array_equal(made[:, 0], rows[:47, 0])
    assert np.array_equal(made[:, 1], rows[3:, 1], equal_nan=True)
    assert np.array_equal(made[4:, 2], rows[:43, 2])
    assert (made[:4, 2] == rows[0, 2]).all()


def test_nothing_waits_where_nothing_is_late() -> None:
    aligner = Aligner([0.0, 1e-15])
    rows = np.ones((5, 2))
    assert aligner.ahead == 0
    assert aligner.push(rows) is rows


@settings(deadline=None, max_examples=60)
@given(st.lists(st.floats(-20, 20), min_size=1, max_size=3), st.lists(st.integers(0, 120), max_size=8))
def test_chunks_make_no_difference(late, cuts) -> None:
    rows = np.random.default_rng(1).normal(size=(120, len(late)))
    rows[60, 0] = np.nan
    whole = Aligner(late, loads=1).push(rows)
    assert pushed(Aligner(late, loads=1), rows, cuts).tobytes() == whole.tobytes()


@pytest.mark.parametrize(("late", "missing"), [(-4.0, 3), (-4.5, 4), (-1.0, 0), (3.0, 0)])
def test_loads_are_missing_while_another_channel_is_more_than_a_sample_before_its_first(late, missing, rng) -> None:
    made = Aligner([0.0, late], loads=1).push(rng.normal(size=(60, 2)))
    assert np.flatnonzero(np.isnan(made[:, 0])).tolist() == list(range(missing))
    assert np.isfinite(made[:, 1]).all()
