"""The combined load envelope: its shapes by definition, and the combined load diagram of a force balance."""

from __future__ import annotations

import numpy as np
import pytest

from aerobalance.acquisition.guards import capacity_stations
from aerobalance.balance.load_envelope import LoadEnvelope, Station
from aerobalance.balance.load_formats import between_forms
from aerobalance.recording.components import COMPONENTS
from aerobalance.simulation.calibration_stand import random_balance

LIMITS = {"NF": (-100.0, 200.0), "PM": (-10.0, 10.0), "AF": (-np.inf, 50.0)}
NAMES = ("AF", "SF", "NF", "PM")  # in an order of their own, with one that does not count


def by_definition(shape, load):
    """Utilisation of one load, component by component."""
    shares = []
    for name, (low, high) in LIMITS.items():
        value = load[NAMES.index(name)]
        shares.append(value / (high if value >= 0 else low))
    return {"box": max(shares), "rhombus": sum(shares), "ellipsoid": np.sqrt(np.square(shares).sum())}[shape]


@pytest.mark.parametrize("shape", ["box", "rhombus", "ellipsoid"])
def test_shapes_are_their_definitions(shape, rng) -> None:
    envelope = LoadEnvelope(shape, LIMITS)
    loads = rng.normal(size=(200, 4)) * (40, 1e6, 100, 8)
    share = envelope.utilisation(loads, NAMES)
    # a handful of roundings of 1.1e-16 each
    np.testing.assert_allclose(share, [by_definition(shape, load) for load in loads], rtol=1e-14)
    assert envelope.components == ("NF", "PM", "AF")
    assert envelope.utilisation(np.zeros((1, 4)), NAMES)[0] == 0
    # on the surface it is 1, whatever the direction
    np.testing.assert_allclose(envelope.utilisation(loads / share[:, None], NAMES), 1.0, rtol=1e-13)


@pytest.mark.parametrize("shape", ["box", "rhombus", "ellipsoid"])
def test_what_lies_between_allowed_loads_is_allowed(shape, rng) -> None:
    station = Station("N1", 60.0, {"NF": 0.5, "PM": 4.0})
    envelope = LoadEnvelope(shape, {**LIMITS, "AF": (-30.0, 50.0)}, (station,))
    loads = rng.normal(size=(400, 4))
    surface = loads / envelope.utilisation(loads, NAMES)[:, None]
    part = rng.uniform(size=(200, 1))
    between = part * surface[:200] + (1 - part) * surface[200:]
    assert envelope.utilisation(between, NAMES).max() <= 1 + 1e-12


def test_nearest_names_what_takes_it_up() -> None:
    loads = np.array([[0.0, 0.0, 10.0, 1.0], [10.0, 0.0, -50.0, 4.0]])
    found = LoadEnvelope("rhombus", LIMITS).at_worst(loads, NAMES)
    assert found.share == pytest.approx(0.5 + 0.4 + 0.2)
    assert found.parts == pytest.approx({"NF": 0.5, "PM": 0.4, "AF": 0.2})
    assert found.nearest == "NF + PM"
    box = LoadEnvelope("box", LIMITS).at_worst(loads, NAMES)
    assert (box.share, box.nearest) == (0.5, "NF")
    ellipsoid = LoadEnvelope("ellipsoid", LIMITS).at_worst(loads, NAMES)
    assert ellipsoid.share == pytest.approx(np.sqrt(0.45))
    assert sum(ellipsoid.parts.values()) == pytest.approx(ellipsoid.share)


def test_station_is_relieved_by_a_load_of_the_other_sign() -> None:
    # at the forward gauge, 0.1 m from the centre of two: N1 = NF / 2 + PM / 0.2
    forward = Station("N1", 100.0, {"NF": 0.5, "PM": 5.0})
    envelope = LoadEnvelope("box", {}, (forward, Station("N2", 100.0, {"NF": 0.5, "PM": -5.0})))
    found = envelope.at_worst(np.array([[-100.0, -14.0]]), ("NF", "PM"))
    assert found.share == pytest.approx(1.2)
    assert found.parts == pytest.approx({"NF": 0.5, "PM": 0.7})
    assert found.nearest == "N1: PM + NF"
    relieved = envelope.at_worst(np.array([[100.0, 14.0 - 26.0]]), ("NF", "PM"))
    assert relieved.parts == pytest.approx({"NF": 0.5, "PM": 0.6})  # the aft gauge it is then
    assert relieved.nearest.startswith("N2")


def test_two_gauges_bear_a_rhombus_of_force_and_moment(rng) -> None:
    # both gauges d from the centre with the same limit L: |NF| / 2 L + |PM| / 2 L d <= 1, by adding up N1 and N2
    d, limit = 0.2, 500.0
    shares = {"NF": 0.5, "PM": 0.5 / d}
    stations = (Station("N1", limit, shares), Station("N2", limit, shares | {"PM": -0.5 / d}))
    loads = rng.normal(size=(300, 2)) * (limit, limit * d)
    rhombus = LoadEnvelope("rhombus", {"NF": (-2 * limit, 2 * limit), "PM": (-2 * limit * d, 2 * limit * d)})
    polygon = LoadEnvelope("box", {}, stations)
    np.testing.assert_allclose(
        polygon.utilisation(loads, ("NF", "PM")),
        rhombus.utilisation(loads, ("NF", "PM")),
        rtol=1e-13,
    )


def test_capacities_of_a_force_balance_are_its_combined_load_diagram(rng, seed) -> None:
    balance = random_balance(seed % 2**32)
    stations = capacity_stations(balance)
    native = rng.normal(size=(100, 6)) * balance.load_scale
    direct = native @ between_forms(balance.components, "direct", balance.geometry).T
    share = LoadEnvelope("box", {}, stations).utilisation(direct, COMPONENTS)
    # there and back through a matrix whose condition is below 1e3 (metres beside newtons)
    np.testing.assert_allclose(share, np.abs(native / balance.load_scale).max(axis=1), rtol=1e-11)


def test_missing_readings_are_not_within() -> None:
    envelope = LoadEnvelope("rhombus", LIMITS)
    loads = np.array([[np.nan, 0.0, 1.0, 1.0], [1.0, np.nan, 20.0, 1.0]])
    share = envelope.utilisation(loads, NAMES)
    assert np.isnan(share[0]) and share[1] == pytest.approx(0.02 + 0.1 + 0.1)
    assert envelope.at_worst(loads[:1], NAMES) is None
    assert envelope.at_worst(loads, NAMES).share == share[1]


def test_wrong_envelopes() -> None:
    with pytest.raises(ValueError, match="round zero load: NF"):
        LoadEnvelope("box", {"NF": (10.0, 20.0)})
    with pytest.raises(ValueError, match="limits of one component"):
        LoadEnvelope("box", {"NF": (-np.inf, np.inf)})
    with pytest.raises(ValueError, match="shape must be"):
        LoadEnvelope("cube", LIMITS)
    with pytest.raises(ValueError, match="needs AF, which is not measured"):
        LoadEnvelope("box", LIMITS).utilisation(np.zeros((1, 2)), ("NF", "PM"))
    with pytest.raises(ValueError, match="limit of N1"):
        Station("N1", 0.0, {"NF": 1.0})
    with pytest.raises(ValueError, match="share of one component"):
        Station("N1", 1.0, {"NF": 0.0})


def test_what_has_no_limit_and_no_share_does_not_count(rng) -> None:
    """Not even where it is not measured."""
    loads = rng.normal(size=(50, 4)) * (40, 60, 100, 8)
    station, free = Station("N1", 60.0, {"NF": 0.5, "PM": 4.0}), Station("N1", 60.0, {"NF": 0.5, "PM": 4.0, "RM": 0.0})
    expected = LoadEnvelope("rhombus", LIMITS, (station,)).utilisation(loads, NAMES)
    found = LoadEnvelope("rhombus", {"YM": (-np.inf, np.inf), **LIMITS}, (free,))
    assert found.components == ("NF", "PM", "AF")
    np.testing.assert_array_equal(found.utilisation(loads, NAMES), expected)
