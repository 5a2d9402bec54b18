"""Big numbers: means that do not run across a step."""

from __future__ import annotations

import numpy as np
import pytest

from aerobalance.app.monitor.steady import newest_steady
from aerobalance.app.monitor.view import Panel, View
from aerobalance.dynamics.independent import dynamics_of
from aerobalance.simulation.published import CABLE_CUT
from helpers.running_page import source_of

SEED = 20261


def noise(count, *, seed=SEED):
    return np.random.default_rng(seed).standard_normal(count)


@pytest.mark.parametrize("at", [4, 20, 160, 300, 316])
def test_the_mean_is_of_what_follows_a_step(at) -> None:
    values = noise(320) + np.where(np.arange(320) < at, -1020.0, 0.0)
    steady = newest_steady(values)
    assert steady.samples == 320 - at
    assert steady.mean == values[at:].mean()
    # 1 N of noise: the mean of four samples is known to 0.5 N
    assert steady.step == pytest.approx(1020.0, abs=3)


def test_samples_on_the_way_are_of_neither_level() -> None:
    """A step through a filter: 12 samples on the way, which would be 19 N in the mean of the newest part."""
    way = np.concatenate([np.full(150, -1020.0), np.linspace(-1020.0, 0.0, 14)[1:-1], np.zeros(158)])
    steady = newest_steady(way + noise(320))
    # the last of them stand out by too little to be told: 1.5 N of 1020 N
    assert abs(steady.mean) < 3 and steady.samples >= 150
    assert steady.step == pytest.approx(1020.0, abs=60)


@pytest.mark.parametrize(
    "values",
    [
        noise(320),
        100 * np.sin(np.arange(320) / 8) + noise(320),
        100 * np.sin(np.arange(320) / 100) + noise(320),
        np.linspace(-500, 500, 320) + noise(320),
        np.concatenate([16 * noise(12), 0.05 * noise(308)]),
        np.full(320, 7.0),
        np.array([0.0, 0.0, 0.0, 500.0, 500.0]),
    ],
    ids=["noise", "oscillation", "slow oscillation", "ramp", "noise that ends", "constant", "too few"],
)
def test_what_is_no_step_is_averaged_whole(values) -> None:
    assert newest_steady(values) == (values.mean(), values.size, 0.0)


def test_a_step_within_the_uncertainty_is_none() -> None:
    values = np.repeat([0.0, 50.0], 100)
    assert newest_steady(values).step == 50.0
    assert newest_steady(values, uncertainty=10.0).step == 0.0


def test_the_force_shown_after_a_cut_is_none_that_never_was() -> None:
    """The force goes from -1020 N to 0 in a sample: no number shown is between the two."""
    source = source_of("cable_cut", seed=SEED, cut_at=1.07, noise=0.1)
    channels = tuple(source.channels)
    from aerobalance.acquisition.setup import setup_from, stored_channels

    stored = stored_channels(setup_from({}), channels)
    view = View(Panel(stored, source.rate, True, dynamics_of(CABLE_CUT.dynamics), {}, {}))
    shown, steps = [], []
    while source._tick < 2 * source.rate:
        view.feed(source.read(1.0))
        for estimate in view.take().estimates.values():
            shown.append(estimate.force)
            steps.append(estimate.step)
            assert estimate.least <= estimate.force <= estimate.largest
    assert min(abs(force + 1020) for force in shown) < 20
    assert all(abs(force) < 60 or abs(force + 1020) < 60 for force in shown), shown
    assert [round(step, -2) for step in steps if step] == [1000.0]
