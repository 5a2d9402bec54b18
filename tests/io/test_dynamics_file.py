"""dynamics.json of coupled components: what is written reads back exactly; what is broken or unphysical is refused."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.dynamics.single import Dynamics
from aerobalance.io.coupled_part import matrix_units
from aerobalance.io.dynamics_file import (
    dynamics_kind,
    read_any_dynamics,
    read_coupled,
    read_dynamics,
    write_dynamics,
)
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import ReadError
from aerobalance.simulation import random_balance

# printf 'time [s],AF [N]\n0,1\n1,2\n' | sha256sum
SHA256 = "ef293ed0de57a6f4c463d425043e4eb566f80704df1763d9cf36760d3c6bf8ac"


def full(seed):
    """Six components with a covariance of everything."""
    generator = np.random.default_rng(seed)
    known = random_balance(generator).dynamics
    size = 1e-4 * np.abs(np.concatenate([known.inertia.ravel(), known.damping.ravel()]))
    factor = size[:, None] * generator.normal(0, 1, (72, 72))
    weighed = 1e-3 * generator.normal(0, 1, (10, 10))
    mass = RigidMass(known.mass.mass, known.mass.centre, known.mass.inertia, symmetric(weighed @ weighed.T))
    return replace(known, covariance=symmetric(factor @ factor.T), mass=mass)


def symmetric(matrix):
    return (matrix + matrix.T) / 2


def written(tmp_path, dynamics, **settings):
    path = tmp_path / "dynamics.json"
    write_dynamics(path, dynamics, **settings)
    return path


def test_round_trip_is_exact(tmp_path, seed):
    given = full(seed)
    found = read_coupled(written(tmp_path, given))
    assert found.components == given.components
    for name in ("inertia", "damping", "covariance"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name))
    for name in ("mass", "centre", "inertia", "covariance"):
        np.testing.assert_array_equal(getattr(found.mass, name), getattr(given.mass, name))


def test_what_is_not_known_stays_so(tmp_path):
    parts = [Dynamics("NF", 20.0, 2e7, 400.0), Dynamics("AF", 18.0, 3e7, 900.0)]
    given = CoupledDynamics.of_components(parts)
    path = written(tmp_path, given)
    found = read_coupled(path)
    assert found.components == ("NF", "AF")
    assert found.mass is None
    assert not found.covariance.any()
    assert [mode["u_natural_frequency"] for mode in json.loads(path.read_text())["modes"]] == [0.0, 0.0]
    assert not {"mass", "covariance", "fit"} & set(json.loads(path.read_text()))


def test_structure_names_rows_units_and_provenance(tmp_path):
    source = tmp_path / "run.csv"
    source.write_text("time [s],AF [N]\n0,1\n1,2\n")
    given = full(3)
    path = written(
        tmp_path, given, details={"rms": 0.5}, inputs=[source], settings={"component": "all"}, warnings=["one doubt"]
    )
    contents = json.loads(path.read_text())
    assert contents["kind"] == "dynamics"
    assert contents["schema"] == 1
    assert contents["components"] == list(COMPONENTS)
    for kind in ("inertia", "damping"):
        assert contents[kind]["rows"] == contents[kind]["columns"] == list(COMPONENTS)
        np.testing.assert_array_equal(contents[kind]["matrix"], getattr(given, kind))
    deviations = np.sqrt(np.diag(given.covariance))
    np.testing.assert_array_equal(np.ravel(contents["damping"]["u"]), deviations[36:])
    # F = A X'': newtons from the second derivative of newton-metres need s^2/m
    assert contents["inertia"]["units"][0][:2] == ["s^2", "s^2/m"]
    assert contents["inertia"]["units"][1][:2] == ["m*s^2", "s^2"]
    assert contents["damping"]["units"][1][:2] == ["m*s", "s"]
    assert contents["covariance"]["parameters"] == list(given.parameters)
    assert [mode["natural_frequency"] for mode in contents["modes"]] == [m.natural_frequency for m in given.modes]
    u = [[mode[f"u_{name}"] for mode in contents["modes"]] for name in ("natural_frequency", "damping_ratio")]
    np.testing.assert_allclose(np.ravel(u) ** 2, np.diag(given.mode_covariance), rtol=1e-12)
    assert contents["mass"]["mass"]["unit"] == "kg"
    assert contents["mass"]["centre"]["aft"]["value"] == given.mass.centre[0]
    assert contents["mass"]["inertia"]["au"] == {
        "value": given.mass.inertia[0, 2],
        "u": float(np.sqrt(given.mass.covariance[8, 8])),
        "unit": "kg*m^2",
    }
    assert contents["fit"] == {"rms": 0.5}
    assert contents["warnings"] == ["one doubt"]
    assert contents["provenance"]["inputs"] == [{"name": "run.csv", "sha256": SHA256}]
    assert contents["provenance"]["settings"] == {"component": "all"}


def test_same_inputs_give_the_same_bytes(tmp_path):
    texts = []
    for _ in range(2):
        contents = json.loads(written(tmp_path, full(4)).read_text())
        contents["provenance"].pop("created")
        texts.append(json.dumps(contents))
    assert texts[0] == texts[1]


def test_a_file_by_hand_needs_the_matrices_only(tmp_path):
    path = tmp_path / "dynamics.json"
    path.write_text(
        json.dumps(
            {
                "components": ["NF", "PM"],
                "inertia": {"matrix": [[1e-6, 1e-7], [1e-8, 2e-6]], "u": [[1e-9, 0], [0, 0]]},
                "damping": {"matrix": [[1e-5, 0], [0, 1e-5]]},
            }
        )
    )
    found = read_any_dynamics(path)
    assert isinstance(found, CoupledDynamics)
    assert found.inertia[0, 1] == 1e-7
    assert found.covariance[0, 0] == pytest.approx(1e-18)
    assert np.count_nonzero(found.covariance) == 1


def test_each_kind_is_told_from_the_other(tmp_path):
    coupled = written(tmp_path, full(5))
    axial = tmp_path / "axial.json"
    write_dynamics(axial, {"AF": Dynamics("AF", 0.68, 11.43e6, 371.98)})
    assert dynamics_kind(coupled) == "coupled"
    assert dynamics_kind(axial) == "axial"
    assert isinstance(read_any_dynamics(coupled), CoupledDynamics)
    assert list(read_any_dynamics(axial)) == ["AF"]
    with pytest.raises(ReadError, match="holds components each for itself, but coupled dynamics are needed"):
        read_coupled(axial)
    with pytest.raises(ReadError, match="components: are coupled, but components each for itself are needed"):
        read_dynamics(coupled)


OF_COUPLED = """{"kind": "coupled dynamics", "schema": 1, "components": ["NF", "AF"],
 "inertia": {"rows": ["NF", "AF"], "columns": ["NF", "AF"], "units": [["s^2", "s^2"], ["s^2", "s^2"]],
  "matrix": [[1e-06, 1e-07], [2e-07, 2e-06]], "u": [[1e-09, 0.0], [0.0, 0.0]]},
 "damping": {"rows": ["NF", "AF"], "columns": ["NF", "AF"], "units": [["s", "s"], ["s", "s"]],
  "matrix": [[1e-05, 0.0], [0.0, 3e-05]], "u": [[0.0, 0.0], [0.0, 1e-09]]},
 "modes": [
  {"natural_frequency": 111.99209253237684, "u_natural_frequency": 0.028, "damping_ratio": 0.010422209977047125,
   "u_damping_ratio": 3.04e-06, "units": {"natural_frequency": "Hz", "damping_ratio": "1"}},
  {"natural_frequency": 160.73864715269775, "u_natural_frequency": 0.08, "damping_ratio": 0.005240351468210848,
   "u_damping_ratio": 3.5e-06, "units": {"natural_frequency": "Hz", "damping_ratio": "1"}}],
 "covariance": {"parameters": ["inertia NF/NF", "damping AF/AF"], "matrix": [[1e-18, 2e-19], [2e-19, 1e-18]]},
 "fit": {"rms": 0.5}, "warnings": [],
 "provenance": {"program": "aerobalance 0.1.0", "created": "2026-11-23T01:47:06+00:00", "inputs": [],
  "settings": {}}}"""
"""As the program wrote coupled dynamics when they were a kind of file of their own."""

OF_ONE = """{"kind": "dynamics", "schema": 1, "components": {"AF": {
  "mass": {"value": 177.87, "u": 0.01, "unit": "kg"}, "stiffness": {"value": 30930000.0, "u": 100000.0, "unit": "N/m"},
  "damping": {"value": 828.21, "u": 1.0, "unit": "N*s/m"},
  "natural_frequency": {"value": 66.36800133535905, "u": 0.10730364498326093, "unit": "Hz"},
  "damping_ratio": {"value": 0.005583019719114845, "u": 1.1265955993060955e-05, "unit": "1"},
  "delay": {"value": 1e-05, "u": 1e-07, "unit": "s"},
  "covariance": {"parameters": ["mass", "stiffness", "damping", "delay"],
   "matrix": [[0.0001, 0.0, 0.0, 0.0], [0.0, 1e10, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1e-14]]},
  "fit": {"method": "x"}}},
 "warnings": [],
 "provenance": {"program": "aerobalance 0.1.0", "created": "2026-11-23T01:47:06+00:00", "inputs": [],
  "settings": {}}}"""
"""As the program has written one component from the first version on."""


def test_files_of_earlier_versions_are_read(tmp_path):
    path = tmp_path / "dynamics.json"
    path.write_text(OF_COUPLED)
    found = read_any_dynamics(path)
    assert isinstance(found, CoupledDynamics)
    np.testing.assert_array_equal(found.inertia, [[1e-06, 1e-07], [2e-07, 2e-06]])
    np.testing.assert_array_equal(found.damping, [[1e-05, 0.0], [0.0, 3e-05]])
    assert found.covariance[0, 7] == 2e-19
    assert [mode.natural_frequency for mode in found.modes] == pytest.approx([111.99209253, 160.73864715], rel=1e-9)
    path.write_text(OF_ONE)
    (one,) = read_any_dynamics(path).values()
    assert (one.component, one.mass, one.stiffness, one.damping, one.delay) == ("AF", 177.87, 3.093e7, 828.21, 1e-5)
    assert one.uncertainty("delay") == 1e-7


@pytest.mark.parametrize("text", ["", "[]", "{", '{"kind": "mass"}', '{"kind": 3}', "\x00", None])
def test_files_of_no_kind(tmp_path, text):
    path = tmp_path / "bad.json"
    if text is not None:
        path.write_text(text)
    assert dynamics_kind(path) is None
    for read in (read_coupled, read_any_dynamics):
        with pytest.raises(ReadError, match=r"bad\.json"):
            read(path)


def swapped(contents, *keys):
    for key in keys[:-1]:
        contents = contents[key]
    return contents, keys[-1]


@pytest.mark.parametrize(
    ("keys", "value", "where", "said"),
    [
        (("schema",), 2, "schema", "reads schema 1"),
        (("components",), ["PM", "NF"], "components", "in this order and each once"),
        (("components",), ["XX"], "components", "must be some of NF"),
        (("components",), [], "components", "at least 1"),
        (("inertia",), None, "inertia", "must be"),
        (("inertia", "rows"), ["PM", "NF"], "inertia.rows", "are PM, NF, but must be NF, PM"),
        (("damping", "columns"), ["NF"], "damping.columns", "are NF, but"),
        (("inertia", "units", 0), ["s^2", "s^2"], "inertia.units", "SI units"),
        (("inertia", "matrix", 0), [1e-6], "inertia.matrix", "2 rows of 2 numbers"),
        (("inertia", "u", 0), [1e-6], "inertia.u", "2 rows of 2 numbers"),
        (("inertia", "u", 0, 0), -1e-9, "inertia.u", "greater than or equal to 0"),
        (("inertia", "u", 0, 0), 1e-7, "covariance.matrix", "they must agree"),
        (("damping", "matrix", 0, 0), "a", "damping.matrix", "must be a number"),
        (("damping", "matrix"), [[-1e-4, 0], [0, -1e-4]], "", "grows or never ends"),
        (("inertia", "matrix"), [[1e-6, 1e-6], [1e-6, 1e-6]], "inertia.matrix", "cannot be inverted"),
        (("covariance", "parameters", 0), "mass", "covariance.parameters", "must name some of inertia NF/NF"),
        (("covariance", "matrix", 0, 0), -1.0, "covariance.matrix", "negative variance"),
        (("modes", 0, "natural_frequency"), 10.0, "modes[0].natural_frequency", "the matrices give"),
        (("modes", 0, "u_natural_frequency"), -1.0, "modes.0.u_natural_frequency", "greater than or equal to 0"),
        (("modes", 1, "damping_ratio"), 0.5, "modes[1].damping_ratio", "the matrices give"),
        (("modes",), [{"natural_frequency": 1.0, "damping_ratio": 0.1}], "modes", "are 1, but the matrices have 2"),
        (("mass", "mass", "unit"), "lb", "mass.mass.unit", "allowed: 'kg'"),
        (("mass", "mass", "value"), -1.0, "mass.mass.value", "greater than 0"),
        (("mass", "centre", "aft", "unit"), "mm", "mass.centre.aft.unit", "allowed: 'm'"),
        (("mass", "inertia", "aa", "value"), 0.0, "mass.inertia.aa.value", "greater than 0"),
        (("mass", "centre"), {}, "mass.centre.aft", "is missing"),
    ],
)
def test_bad_files_name_the_place(tmp_path, keys, value, where, said):
    given = CoupledDynamics(
        ("NF", "PM"),
        np.array([[1e-6, 1e-7], [1e-8, 2e-6]]),
        np.array([[1e-5, 0.0], [0.0, 1e-5]]),
        np.diag([1e-18] * 8),
        RigidMass(2.0, np.zeros(3), np.eye(3), 1e-4 * np.eye(10)),
    )
    path = written(tmp_path, given)
    contents = copy.deepcopy(json.loads(path.read_text()))
    place, key = swapped(contents, *keys)
    place[key] = value
    path.write_text(json.dumps(contents))
    with pytest.raises(ReadError) as caught:
        read_coupled(path)
    assert caught.value.where.startswith(where)
    assert said in caught.value.what
    assert str(path) in str(caught.value)


def test_units_of_rows_over_columns():
    assert matrix_units(("NF", "PM"), "damping") == [["s", "s/m"], ["m*s", "s"]]


def test_a_failed_write_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="no folder"):
        write_dynamics(tmp_path / "none" / "dynamics.json", full(6))
    assert list(tmp_path.iterdir()) == []


def with_calibration(seed):
    """The same with what a calibration left."""
    given = full(seed)
    factor = 3 * np.sqrt(np.diag(given.covariance))[:, None] * np.random.default_rng(seed).normal(0, 1, (72, 20))
    return replace(given, covariance_of_calibration=symmetric(factor @ factor.T), balance=SHA256)


def test_what_the_calibration_left_reads_back_exactly(tmp_path, seed):
    given = with_calibration(seed)
    path = written(tmp_path, given)
    found = read_coupled(path)
    for name in ("covariance", "covariance_of_calibration", "balance"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name))
    stated = json.loads(path.read_text())
    u = np.sqrt(np.diag(given.covariance + given.covariance_of_calibration))
    np.testing.assert_array_equal(np.ravel(stated["inertia"]["u"]), u[:36])
    # what the readings leave may be nothing
    exact = replace(given, covariance=np.zeros((72, 72)))
    assert not read_coupled(written(tmp_path, exact)).covariance.any()


def test_a_file_that_does_not_know_the_calibration_has_none(tmp_path):
    found = read_coupled(written(tmp_path, full(6)))
    assert not found.covariance_of_calibration.any()
    assert found.balance == ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda contents: contents.pop("covariance"), "is needed beside calibration"),
        (lambda contents: contents["calibration"].pop("covariance"), "calibration.covariance"),
        (lambda contents: contents["calibration"].update(balance="mine"), "calibration.balance"),
        (lambda contents: contents["inertia"]["u"][2].__setitem__(1, 1.0), "they must agree"),
        (
            lambda contents: contents["calibration"]["covariance"]["parameters"].__setitem__(0, "x"),
            "must name some of",
        ),
        (lambda contents: contents["calibration"]["covariance"]["matrix"].pop(), "must have 72 rows"),
        (
            lambda contents: contents["calibration"]["covariance"]["matrix"][3].__setitem__(3, -1.0),
            "negative variance",
        ),
        (lambda contents: contents["calibration"]["covariance"]["matrix"][3].__setitem__(4, 1e9), "not symmetric"),
    ],
)
def test_a_broken_calibration_is_refused(tmp_path, change, words):
    path = written(tmp_path, with_calibration(7))
    contents = json.loads(path.read_text())
    change(contents)
    path.write_text(json.dumps(contents))
    with pytest.raises(ReadError, match=words):
        read_coupled(path)


def test_a_covariance_of_some_parameters_leaves_the_others_their_uncertainty(tmp_path):
    given = {"mass": (100.0, 1.0), "stiffness": (1e7, 1e5), "damping": (500.0, 50.0)}
    part = {name: {"value": value, "u": u} for name, (value, u) in given.items()}
    part["covariance"] = {"parameters": ["mass"], "matrix": [[1.0]]}
    path = tmp_path / "dynamics.json"
    path.write_text(json.dumps({"components": {"AF": part}}))
    found = read_dynamics(path)["AF"]
    assert [found.uncertainty(name) for name in given] == pytest.approx([u for _, u in given.values()])
