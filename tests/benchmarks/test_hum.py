"""Mains hum costs the force nothing: the error with it over the error without it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.spectra.line_noise import hum_lines
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from helpers.accuracy import RUNS, SHARP, SOFT, T128, inner, rms_of, smooth_run

RATE = 1600.0
NOISE = 2.0


def hum_of(time: Array, rng: np.random.Generator, *, frequency: float, size: float) -> Array:
    """A line with its third and fifth harmonic."""
    phases = rng.uniform(0, 2 * np.pi, 3)
    return np.asarray(
        sum(
            size / number * np.sin(2 * np.pi * frequency * number * time + phase)
            for number, phase in zip((1, 3, 5), phases, strict=True)
        )
    )


def with_more(run: Recording, more: Array) -> Recording:
    return Recording.from_columns(run.time, {"AF": Channel("AF", run.channel("AF").values + more, "N")}, name="hum")


@pytest.mark.parametrize("mains", [50.02, 59.97])
@pytest.mark.parametrize("kind", ["0-30 Hz", "step"])
def test_force_beside_hum(kind: str, mains: float, record, rng) -> None:
    clean, hummed = [], []
    for k in range(RUNS):
        instant = 2 + rng.uniform(0, 1) / RATE
        if kind == "step":
            time = np.arange(6400) / RATE
            force = 1020.0 * (time >= instant)
            load = 1020 * T128.step_response(time - instant) + rng.normal(0, NOISE, time.size)
            run = Recording.from_columns(time, {"AF": Channel("AF", load, "N")}, name="step")
        else:
            run, force = smooth_run(rng, SHARP[kind], dynamics=T128, rate=RATE, rms=500.0, noise=NOISE, seconds=6.0)
        lines = hum_of(run.time, rng, frequency=mains, size=(2.0, 12.0, 50.0)[k % 3])
        away = np.abs(run.time - instant) > (0.001 if kind == "step" else 0)
        clean.append(inner((estimate_force(run, T128).only.values - force) * away))
        with pytest.warns(DataQualityWarning, match="mains hum"):
            estimate = estimate_force(with_more(run, lines), T128).only
        hummed.append(inner((estimate.values - force) * away))
    ratio = rms_of(clean) / rms_of(hummed)
    record(f"error without over error with hum of 2 to 50 N at {mains:g} Hz, {kind}", ratio, round(1 / 1.1, 4))
    assert ratio > 1 / 1.1


def test_no_hum_in_smooth_records(record, rng) -> None:
    shapes = list((SHARP | SOFT).values())
    false = 0
    for k in range(100):
        run, _ = smooth_run(
            rng, shapes[k % len(shapes)], dynamics=T128, rate=RATE, rms=500.0, noise=NOISE, seconds=2.0 + k % 5
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            false += len(hum_lines(run.channel("AF").values, 1 / RATE))
    record("1 over 1 and false lines of hum, 100 smooth records of 2 to 6 s", 1 / (1 + false), 1.0)
    assert false == 0
