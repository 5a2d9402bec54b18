"""Calls that cannot be meant, and what is said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import aerobalance as ab
from aerobalance.balance.schedule import Schedule
from aerobalance.balance.terms import Term
from aerobalance.balance.weighing import WeightModel, fit_weight
from aerobalance.balance.weighing.points import LoadPoints
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import dynamics_of
from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.identification.base_excitation.paper_procedure import reference_fit
from aerobalance.identification.base_excitation.shaking import identify_shaking
from aerobalance.identification.coupled.conclusions import rigid_of
from aerobalance.identification.from_modes import dynamics_of_modes, one_of_pole
from aerobalance.identification.from_stiffness import agreement, compare_coupled, coupled_from_stiffness
from aerobalance.identification.impact.tap_point import TapPoint
from aerobalance.identification.impact.taps import identify_taps
from aerobalance.identification.rigid_body import adjusted, rigid_mass_of
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.simulation.calibration_stand import CalibrationStand, random_balance
from helpers.bending_releases import truth as bending
from helpers.rigid_balance import balance, truth

MASS, STIFFNESS, _ = balance()
COUPLED = truth()
SINGLE = ab.Dynamics("AF", mass=100.0, stiffness=1e7, damping=500.0)
LOADS = ab.Recording.from_arrays(np.arange(100) / 1000, {"AF": np.sin(np.arange(100.0))})
SIX = ab.Recording.from_arrays(np.arange(100) / 1000, {name: np.sin(np.arange(100.0)) for name in COMPONENTS})


def refused(call, message, kind=ValueError):
    with pytest.raises(kind, match=message):
        call()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"mass": 0.0}, "mass must be positive"),
        ({"centre": np.zeros(2)}, r"centre must have shape \(3,\)"),
        ({"inertia": np.full((3, 3), np.nan)}, "inertia must have shape"),
        ({"inertia": MASS.inertia + np.triu(np.ones((3, 3)), 1)}, "symmetric"),
    ],
)
def test_a_mass_that_no_body_has(changed, message):
    given = {"mass": MASS.mass, "centre": MASS.centre, "inertia": MASS.inertia} | changed
    refused(lambda: RigidMass(**given), message)


@pytest.fixture(scope="module")
def schedule() -> Schedule:
    return CalibrationStand(random_balance(1)).run(np.random.default_rng(1)).schedule


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda one: {"loads": one.loads[:-1]}, "loads must have shape"),
        (lambda one: {"gauges": one.gauges[:-1]}, "gauges must be 6 different names"),
        (
            lambda one: {"components": (*one.components[:-1], one.components[0])},
            "components must be 6 different names",
        ),
        (lambda one: {"temperature": np.zeros(3)}, "temperature must have shape"),
        (
            lambda one: {"temperature": np.where(np.arange(len(one.points)) == 3, np.nan, 20.0)},
            "temperature must be finite, which that of .* is not; leave out the points",
        ),
        (lambda one: {"points": one.points[:-1]}, "points must be .* names, not"),
        (lambda one: {"series": one.series - 1}, "series must number series_names from 0"),
        (lambda one: {"capacities": -one.capacities}, "capacities must be positive"),
        (lambda one: {"outputs": one.outputs * np.nan}, "outputs must be finite"),
    ],
)
def test_a_schedule_whose_parts_do_not_go_together(schedule, changed, message):
    refused(lambda: replace(schedule, **changed(schedule)), message)


def test_a_term_of_a_load_that_the_matrix_has_not():
    matrix = random_balance(1)
    refused(lambda: replace(matrix, terms=(*matrix.terms[:-1], Term(0, 6, 6))), "is no term of 6 variables")


@pytest.mark.parametrize("components", [("AF", "AF"), ("AF", "Fx")])
def test_weight_along_components_that_are_none(components):
    refused(lambda: WeightModel(components), "components must be some of")


def test_a_weighing_that_contradicts_itself(rng):
    pitch = np.radians(np.arange(-10.0, 11, 2))
    found = fit_weight(
        LoadPoints(
            ("AF",),
            pitch,
            (50.0 * np.sin(pitch) + rng.normal(0, 0.01, pitch.size))[:, None],
            np.zeros_like(pitch),
            None,
        )
    )
    (mass,) = found.masses.values()
    refused(lambda: replace(mass, component="PM"), "component must be one of")
    refused(lambda: replace(mass, mass=0.0), "mass must be positive")
    refused(lambda: replace(mass, u=-1.0), "u must be zero or more")
    refused(lambda: replace(found, u_mass=-1.0), "mass must be positive and finite")
    refused(lambda: replace(found, values=found.values * np.nan), "values must be finite")
    refused(lambda: replace(found, assumed={"lean": 0.0}), "assumed must have a value for each")
    assert found.left_out
    refused(lambda: replace(found, left_out=dict.fromkeys(found.left_out, -1.0)), "scales of what was left out")


def test_zeros_after_a_run_that_has_none_before_it():
    refused(lambda: ab.Zero((), model_on=True, after=LOADS), "the drift is what changes between")


def test_a_zero_without_the_matrix_that_makes_loads_of_it():
    zero = ab.Zero(LOADS, model_on=True)
    for call in (ab.estimate_force, ab.identify):
        given = {"dynamics": SINGLE} if call is ab.estimate_force else {"mass": 1.0}
        refused(lambda call=call, given=given: call(LOADS, zero=zero, **given), "a zero is of gauge outputs")


def test_dynamics_that_cannot_be_put_together():
    double = ab.Dynamics("AF", mass=100.0, stiffness=1e7, damping=500.0, further_modes=(Mode(200.0, 0.1, 0.01),))
    refused(lambda: CoupledDynamics.of_components([double]), "further modes of their own")
    refused(lambda: dynamics_of({"NF": SINGLE}), "dynamics of AF are given under the name NF")
    refused(lambda: dynamics_of([SINGLE, SINGLE]), "given twice of AF")


def test_the_only_force_of_several():
    load = {"AF": np.sin(np.arange(400.0)), "NF": np.cos(np.arange(400.0))}
    run = ab.Recording.from_arrays(np.arange(400) / 1000, load)
    force = ab.estimate_force(run, [SINGLE, replace(SINGLE, component="NF")], bandwidth=100.0)
    refused(lambda: force.only, "there are several components, AF, NF|there are several components, NF, AF")


def test_stiffness_and_damping_that_make_no_dynamics():
    refused(lambda: coupled_from_stiffness(-STIFFNESS, MASS, damping_ratios=0.01), "symmetric, positive matrix")
    refused(lambda: coupled_from_stiffness(STIFFNESS, MASS, damping_ratios=1.0), "between 0 and 1")


def test_dynamics_that_cannot_be_compared():
    parts = [replace(SINGLE, component=name) for name in ("NF", "AF")]
    refused(lambda: compare_coupled(COUPLED, CoupledDynamics.of_components(parts)), "different components: .*; NF|AF")
    refused(
        lambda: compare_coupled(bending(), CoupledDynamics.of_components(parts)),
        "one of the dynamics has modes beyond the components",
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"place": (0.0, 0.0)}, "place must be three finite numbers"),
        ({"direction": (1.0, 1.0, 0.0)}, "of length 1"),
        ({"u_place": -0.1}, "u_place .* zero or more"),
    ],
)
def test_a_place_to_tap_that_is_none(given, message):
    refused(lambda: TapPoint(**({"place": (0.0, 0.0, 0.0), "direction": (1.0, 0.0, 0.0)} | given)), message)


def test_taps_of_which_too_little_is_said():
    refused(lambda: identify_taps([LOADS], components=("AF",), mass=None), "mass is needed")
    refused(lambda: identify_taps([LOADS], components=("AF",), mass=(0.0, 0.1)), "mass must be positive")
    refused(lambda: identify_taps([SIX], components=("NF", "AF"), mass=1.0), "a mass matrix needs all of")
    refused(lambda: identify_taps([LOADS], components=("AF",), mass=1.0, points=[None, None]), "a point is needed")


def test_a_weighing_that_has_not_the_mass_that_is_needed():
    pitch = np.radians(np.arange(-10.0, 11, 2))
    weighed = fit_weight(
        LoadPoints(("AF",), pitch, 50.0 * np.sin(pitch)[:, None] + 1e-3 * np.cos(40 * pitch)[:, None], 0 * pitch, None)
    )
    normal = ab.Recording.from_arrays(np.arange(100) / 1000, {"NF": np.sin(np.arange(100.0))})
    refused(lambda: ab.identify(normal, mass=weighed), "the weighing has no mass of NF; it has AF")
    loads = {"NF": np.cos(np.arange(100.0)), "AF": np.sin(np.arange(100.0))}
    pair = ab.Recording.from_arrays(np.arange(100) / 1000, loads)
    refused(lambda: ab.identify(pair, mass=weighed), "a mass matrix needs all of")


@pytest.mark.parametrize(
    ("given", "settings", "message"),
    [
        (LOADS, {"excitation": "hammer"}, "excitation must be release, base or impact"),
        (LOADS, {"points": TapPoint((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))}, "points are those of taps"),
        ([], {}, "at least one recording"),
        ([LOADS, LOADS], {"mass": 1.0}, "from one recording at a time, not from 2"),
        (LOADS, {}, "mass is needed"),
        (SIX, {"excitation": "base", "modes": 6}, "modes cannot be given"),
        (SIX, {"excitation": "base", "components": ("NF", "AF")}, "a shaken balance needs all of"),
    ],
)
def test_an_identification_that_cannot_be_meant(given, settings, message):
    refused(lambda: ab.identify(given, **settings), message)


def test_a_recording_without_loads():
    pitch = ab.Recording.from_arrays(np.arange(10) / 100, {"pitch": np.zeros(10)})
    refused(lambda: ab.identify(pitch, mass=1.0), "has no balance load; it has pitch", FitError)


def test_a_shaken_balance_of_which_impossible_things_are_said():
    refused(lambda: identify_shaking([]), "at least one recording")
    refused(lambda: identify_shaking([SIX], mass=-1.0), "mass must be positive")
    refused(lambda: identify_shaking([SIX], band=(50.0, 5.0)), "rising order")
    refused(lambda: reference_fit((), mass=0.0), "mass must be positive")
    refused(lambda: reference_fit((), mass=1.0, phase="both"), "phase must be relative or absolute")
    refused(lambda: reference_fit((), mass=1.0), "too few for a line", FitError)


def test_a_mass_matrix_behind_dynamics_that_have_none():
    refused(lambda: rigid_mass_of(COUPLED, mass=0.0), "mass must be positive")
    few = CoupledDynamics.of_components([replace(SINGLE, component=name) for name in ("NF", "AF")])
    refused(lambda: rigid_mass_of(few, mass=1.0), "a rigid mass needs all of")
    turned = replace(COUPLED, inertia=COUPLED.inertia.T.copy(), damping=COUPLED.damping.T.copy(), mass=None)
    refused(lambda: rigid_mass_of(turned, mass=20.0), "mass matrix behind the dynamics is not positive", FitError)
    alone = CoupledDynamics.of_components([replace(SINGLE, component=name) for name in COMPONENTS])
    refused(
        lambda: rigid_mass_of(alone, mass=20.0),
        "cannot be found: .* hardly coupled.*late against each other",
        FitError,
    )
    assert rigid_of(alone, 20.0)[0] is None  # the dynamics stand without it
    assert "no mass matrix" in rigid_of(alone, 20.0)[1][0]


SHAPES = np.eye(6) + 0j
POLES = np.array([-1 + 100j * (k + 1) for k in range(6)])


@pytest.mark.parametrize(
    ("poles", "shapes", "message"),
    [
        (POLES[:5], SHAPES, "6 components need 6 modes"),
        (POLES, np.where(np.arange(6) == 2, np.nan, SHAPES), "the shapes hold no SF"),
        (-POLES.conj(), SHAPES, "a mode does not decay"),
        (POLES, np.ones((6, 6)) + 0j, "not independent of each other"),
        (POLES, np.diag([0, 1, 1, 1, 1, 1]) + 0j, "a mode has a shape of zeros"),
    ],
)
def test_modes_that_make_no_dynamics(poles, shapes, message):
    refused(lambda: dynamics_of_modes(poles, shapes), message, FitError)


def test_dynamics_without_a_mass_know_of_no_weight():
    pitch = np.linspace(-0.2, 0.2, 5)
    assert not replace(COUPLED, mass=None).weight("NF", pitch=pitch, roll=0 * pitch, gravity=9.81).any()
    assert COUPLED.weight("NF", pitch=pitch, roll=0 * pitch, gravity=9.81) == pytest.approx(
        MASS.weight(pitch, 0 * pitch, gravity=9.81)[:, COMPONENTS.index("NF")]
    )


def test_modes_of_dynamics_make_these_dynamics():
    form = COUPLED.modal_form
    up = form.poles.imag > 0
    with pytest.warns(DataQualityWarning, match="no uncertainty is known"):
        found, rigid = dynamics_of_modes(form.poles[up], form.shapes[:, up].T)
    assert rigid is None
    # the inverse of shapes of loads that differ by some hundred, squared, over rounding
    assert found.inertia == pytest.approx(COUPLED.inertia, rel=1e-8, abs=1e-10 * np.abs(COUPLED.inertia).max())
    assert found.damping == pytest.approx(COUPLED.damping, rel=1e-6, abs=1e-8 * np.abs(COUPLED.damping).max())
    assert agreement(COUPLED, found, damping=True) is None  # of two exact ones there is no test


def test_modes_of_components_that_are_not_coupled_tell_no_mass():
    with (
        pytest.warns(DataQualityWarning, match="no uncertainty is known"),
        pytest.warns(DataQualityWarning, match="no mass matrix"),
    ):
        dynamics, rigid = dynamics_of_modes(POLES, SHAPES, mass=20.0)
    assert rigid is None
    # of one component w0^2 is |pole|^2, and its inertia 1 / w0^2
    assert np.diag(dynamics.inertia) == pytest.approx(np.abs(POLES) ** -2.0)


def test_equations_that_nothing_meets_have_no_adjustment():
    """x^2 + 1 is never zero: Gauss and Helmert's steps go on for ever."""
    found = adjusted(
        np.array([1.0]),
        np.eye(1),
        lambda values, unknowns: (values**2 + 1, 2 * values[None], np.zeros((1, 0))),
        start=np.zeros(0),
    )
    assert found is None
    met = adjusted(
        np.array([1.5]),
        np.eye(1),
        lambda values, unknowns: (values**2 - 1, 2 * values[None], np.zeros((1, 0))),
        start=np.zeros(0),
    )
    assert met is not None
    assert met.values == pytest.approx([1.0])


def test_a_pole_that_does_not_decay():
    refused(lambda: one_of_pole(1 + 100j, "AF", mass=1.0), "does not decay", FitError)


def test_a_result_in_the_place_of_its_file(tmp_path):
    with pytest.raises(TypeError, match=r"path of the file comes first, write\(path, result\); it is no Recording"):
        ab.write(ab.Recording.from_arrays(np.arange(8) / 10, {"AF": np.zeros(8)}, name="run"), tmp_path / "run.h5")
