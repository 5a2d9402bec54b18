"""Calibrations that no matrix should come of, and those that are doubted: named by component and evidence."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from aerobalance.balance.calibration.fit import calibrate
from aerobalance.balance.schedule import Schedule
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.simulation.calibration_stand import CAPACITIES, CalibrationStand, random_balance
from seeds import trials

NOISE = 0.7e-3
Maker = Callable[[np.random.Generator], Schedule]


def stand(rng: np.random.Generator) -> Schedule:
    """Single loads and pairs of them, six components, with tares and natural zeros."""
    return CalibrationStand(random_balance(int(rng.integers(2**31)))).run(int(rng.integers(2**31))).schedule


def single(rng: np.random.Generator) -> Schedule:
    """One load at a time, a series for each component and sign, as .vol files have it."""
    balance = random_balance(int(rng.integers(2**31)))
    steps = np.array([0, 0.2, 0.4, 0.6, 0.8, 1, 0.5, 0])
    names, rows = [], []
    for k, name in enumerate(balance.components):
        for sign, text in ((1, "pos"), (-1, "neg")):
            names.append(f"{name} {text}")
            rows.append(np.outer(sign * steps, np.eye(6)[k]))
    loads = np.vstack(rows) * CAPACITIES
    n = len(loads)
    return Schedule(
        name="test.vol",
        components=balance.components,
        gauges=balance.components,
        loads=loads,
        outputs=balance.outputs(loads) + 0.02 + rng.normal(0, NOISE, loads.shape),
        series=np.repeat(np.arange(12), steps.size),
        series_names=tuple(names),
        points=tuple(str(k) for k in range(n)),
        capacities=CAPACITIES,
        moments=balance.moments,
        load_units=("N",) * 6,
        natural_zeros=np.zeros((0, 6)),
        confirmation=np.zeros(n, dtype=bool),
    )


both = pytest.mark.parametrize("make", [stand, single])
component = pytest.mark.parametrize("index", [0, 3, 4, 5])


def refused(schedule: Schedule, *, match: str) -> None:
    """The fit ends with an error; doubts that come first are not the matter here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        with pytest.raises(FitError, match=match):
            calibrate(schedule, model="linear")


def problem(schedule: Schedule, *, model: str = "linear") -> str:
    """What is said of a schedule, by error and warnings together."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            calibrate(schedule, model=model)
        except FitError as error:
            return "\n".join([str(error), *(str(item.message) for item in caught)])
    return "\n".join(str(item.message) for item in caught)


@both
@component
def test_dead_bridge_that_reads_one_number(make: Maker, index: int, rng) -> None:
    schedule = make(rng)
    outputs = schedule.outputs.copy()
    outputs[:, index] = 0.1
    name = schedule.components[index]
    refused(replace(schedule, outputs=outputs), match=rf"the bridge of {name} is dead: it reads 0\.1 mV/V at all")


@both
@component
def test_dead_bridge_that_reads_noise(make: Maker, index: int, rng) -> None:
    schedule = make(rng)
    outputs = schedule.outputs.copy()
    outputs[:, index] = 0.1 + rng.normal(0, NOISE, len(outputs))
    refused(replace(schedule, outputs=outputs), match=f"the bridge of {schedule.components[index]} is dead")


@both
@pytest.mark.parametrize(("index", "other"), [(0, 1), (2, 5), (3, 4)])
def test_crossed_wires(make: Maker, index: int, other: int, rng) -> None:
    schedule = make(rng)
    outputs = schedule.outputs.copy()
    outputs[:, [index, other]] = outputs[:, [other, index]]
    first, second = schedule.components[index], schedule.components[other]
    refused(
        replace(schedule, outputs=outputs),
        match=f"crossed wires: the bridge of {first} .* capacity of {second}, .* the other way round",
    )


def test_wires_crossed_in_a_ring(rng) -> None:
    schedule = stand(rng)
    refused(
        replace(schedule, outputs=schedule.outputs[:, [1, 2, 0, 3, 4, 5]]), match="crossed wires: the bridge of N1"
    )


@both
@component
def test_wrong_sign_in_one_series(make: Maker, index: int, rng) -> None:
    schedule = make(rng)
    loads = schedule.loads.copy()
    # the series that loads this component most
    span = [np.ptp(loads[schedule.series == k, index]) for k in range(len(schedule.series_names))]
    number = int(np.argmax(span))
    loads[schedule.series == number, index] *= -1
    text = problem(replace(schedule, loads=loads))
    assert f"wrong sign of {schedule.components[index]} in series " in text
    assert repr(schedule.series_names[number]) in text


@both
@component
def test_component_that_is_never_loaded(make: Maker, index: int, rng) -> None:
    schedule = make(rng)
    loads = schedule.loads.copy()
    loads[:, index] = 0
    refused(replace(schedule, loads=loads), match=f"{schedule.components[index]} is never loaded")


@both
@component
@pytest.mark.parametrize("factor", [4.448, 1 / 4.448])
def test_series_in_other_units(make: Maker, index: int, factor: float, rng) -> None:
    schedule = make(rng)
    loads = schedule.loads.copy()
    span = [np.ptp(loads[schedule.series == k, index]) for k in range(len(schedule.series_names))]
    number = int(np.argmax(span))
    loads[schedule.series == number, index] *= factor
    text = problem(replace(schedule, loads=loads))
    assert f"the bridge of {schedule.components[index]} gives" in text
    assert f"series {schedule.series_names[number]!r}" in text
    assert "check the loads, units and arms" in text


@both
@component
def test_drifting_bridge_is_refused(make: Maker, index: int, rng) -> None:
    schedule = make(rng)
    outputs = schedule.outputs.copy()
    # to and fro by three times the output at capacity within the longest series
    number = int(np.argmax(np.bincount(schedule.series)))
    inside = schedule.series == number
    outputs[inside, index] += 3 * np.sin(np.linspace(0, 5, np.count_nonzero(inside)))
    text = problem(replace(schedule, outputs=outputs))
    name = schedule.components[index]
    assert f"the zero of {name} drifts" in text or f"{name} " in text.split("unfit for a matrix")[-1]


@both
@component
@pytest.mark.soak(first=4)
def test_slowly_drifting_zero_is_doubted(make: Maker, index: int, rng) -> None:
    schedule = make(rng)
    outputs = schedule.outputs.copy()
    number = int(np.flatnonzero(np.bincount(schedule.series) > 7)[-1])
    inside = schedule.series == number
    outputs[inside, index] += np.linspace(0, 0.03, np.count_nonzero(inside))  # 2 to 3.5 % of the output at capacity
    text = problem(replace(schedule, outputs=outputs), model="96")
    assert f"the zero of {schedule.components[index]} drifts by" in text
    assert f"within series {schedule.series_names[number]!r}" in text


@both
@component
def test_noisy_bridge_is_doubted(make: Maker, index: int, rng) -> None:
    schedule = make(rng)
    outputs = schedule.outputs.copy()
    loaded = (np.abs(schedule.loads) > 0.1 * CAPACITIES).any(axis=1)
    outputs[loaded, index] += rng.normal(0, 0.03, np.count_nonzero(loaded))
    text = problem(replace(schedule, outputs=outputs))
    assert f"the residuals of {schedule.components[index]} have a standard deviation" in text


@both
def test_sensitivity_of_one_series_is_doubted(make: Maker, rng) -> None:
    schedule = make(rng)
    outputs = schedule.outputs.copy()
    inside = schedule.series == 0
    outputs[inside, 0] *= 1.15
    text = problem(replace(schedule, outputs=outputs))
    assert "the bridge of N1 gives" in text
    assert "the matrix averages over both" in text


@both
@component
def test_bridge_that_dies_half_way(make: Maker, index: int, rng) -> None:
    schedule = make(rng)
    outputs = schedule.outputs.copy()
    span = [np.ptp(schedule.loads[schedule.series == k, index]) for k in range(len(schedule.series_names))]
    number = int(np.flatnonzero(np.array(span) > CAPACITIES[index] / 2)[-1])
    outputs[schedule.series >= number, index] = 0.02
    assert f"the bridge of {schedule.components[index]} " in problem(replace(schedule, outputs=outputs))


def test_few_points_are_refused(rng) -> None:
    schedule = single(rng)
    held = np.ones(len(schedule.points), dtype=bool)
    held[:6] = False
    refused(replace(schedule, confirmation=held), match="6 points; a matrix of 6 components needs at least 8")


@both
def test_healthy_schedules_raise_nothing(make: Maker, rng) -> None:
    for _ in range(trials(5, 10)):
        assert problem(make(rng), model="96") == ""


def warned(schedule: Schedule) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with suppress(FitError):  # of some no matrix comes besides
            calibrate(schedule)
    return [str(one.message) for one in caught if issubclass(one.category, DataQualityWarning)]


@pytest.mark.parametrize(("factor", "named"), [(4.4482, "lbf and N"), (9.80665, "kgf and N"), (1e3, "a thousand")])
@pytest.mark.parametrize("up", [True, False])
def test_a_wrong_unit_of_all_loads_is_asked_about(factor, named, up, rng):
    sound = single(rng)
    assert not [text for text in warned(sound) if "units" in text]
    wrong = replace(sound, loads=sound.loads * (factor if up else 1 / factor))
    if not up and factor > 100:  # loads of a thousandth of capacity are none
        refused(wrong, match="is never loaded")
        return
    asked = [text for text in warned(wrong) if "are loads and capacity in the units" in text]
    assert len(asked) == 6  # each component
    assert all(named in text for text in asked)


@pytest.mark.parametrize("factor", [1e3, 1e-3])
def test_a_wrong_unit_of_the_outputs_is_asked_about(factor, rng):
    sound = single(rng)
    wrong = replace(sound, outputs=sound.outputs * factor)
    assert [text for text in warned(wrong) if "are the outputs in the unit" in text]
    assert not [text for text in warned(sound) if "are the outputs in the unit" in text]
