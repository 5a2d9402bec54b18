"""mass.json of a weighing with several components, and the command that writes it."""

import json

import numpy as np
import pytest

from aerobalance.app.commands.weighing import weigh as weigh_files
from aerobalance.balance.weighing import LoadPoints, Weighing, WeightModel, fit_weight
from aerobalance.io.mass_file import read_masses, read_weighing, write_weighing
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import DataQualityWarning, FitError, ReadError
from aerobalance.recording.gravity import weight_direction

LATER = {"pitch": np.radians([-20.0, 0, 30]), "roll": np.radians([0.0, 90, 200])}


def readings(rolls=(0, 90, 180, 270), seed=3, **masses):
    """Points of a 5 kg model with its centre at (-0.04, 0.003, 0.02) m, offsets of 1, 0.3 deg misaligned."""
    pitch, roll = (angle.ravel() for angle in np.meshgrid(np.radians([-10, -5, 0, 5, 10]), np.radians(rolls)))
    model = WeightModel(COMPONENTS, own_masses=True)
    values = np.ones(len(model.names))
    for index, name in enumerate(model.names):
        kind, _, rest = name.partition(".")
        lever = {"aft": -0.2, "right": 0.015, "up": 0.1}
        sizes = {"mass": masses.get(rest, 5.0), "moment": lever.get(rest), "misalignment": np.radians(0.3)}
        values[index] = sizes.get(kind, 1.0)
    noise = np.random.default_rng(seed).normal(size=(pitch.size, 6)) * [0.05, 0.005, 0.05, 0.005, 0.005, 0.02]
    return LoadPoints(COMPONENTS, pitch, model.loads(weight_direction(pitch, roll), values) + noise, roll)


def table(path, points):
    units = ["N*m" if name in {"PM", "YM", "RM"} else "N" for name in COMPONENTS]
    header = ",".join(["pitch [deg]", "roll [deg]", *(f"{n} [{u}]" for n, u in zip(COMPONENTS, units, strict=True))])
    rows = np.column_stack([np.degrees(points.pitch), np.degrees(points.roll), points.loads])
    path.write_text(header + "\n" + "\n".join(",".join(repr(x) for x in row) for row in rows.tolist()) + "\n")
    return path


def same(found, given):
    for name in Weighing.__dataclass_fields__:
        if name == "masses":
            assert {key: mass.mass for key, mass in found.masses.items()} == {
                key: mass.mass for key, mass in given.masses.items()
            }
        elif isinstance(getattr(given, name), np.ndarray):
            np.testing.assert_array_equal(getattr(found, name), getattr(given, name), err_msg=name)
        else:
            assert getattr(found, name) == getattr(given, name), name
    np.testing.assert_array_equal(found.loads(**LATER), given.loads(**LATER))
    np.testing.assert_array_equal(found.uncertainty(**LATER), given.uncertainty(**LATER))


@pytest.mark.parametrize("rolls", [(0, 90, 180, 270), (0,)])
def test_round_trip(tmp_path, rolls):
    given = fit_weight(readings(rolls))
    assert bool(given.left_out) == (rolls == (0,))
    write_weighing(tmp_path / "mass.json", given, warnings=["w"])
    same(read_weighing(tmp_path / "mass.json"), given)
    for name, mass in read_masses(tmp_path / "mass.json").items():
        assert (mass.mass, mass.u) == (given.masses[name].mass, given.masses[name].u)
        np.testing.assert_array_equal(mass.covariance, given.masses[name].covariance)


def test_round_trip_where_components_differ(tmp_path):
    with pytest.warns(DataQualityWarning, match="different masses"):
        given = fit_weight(readings(AF=5.5))
    write_weighing(tmp_path / "mass.json", given)
    same(read_weighing(tmp_path / "mass.json"), given)


def test_structure_of_the_file(tmp_path):
    given = fit_weight(readings())
    write_weighing(tmp_path / "mass.json", given)
    contents = json.loads((tmp_path / "mass.json").read_text())
    assert (contents["kind"], contents["schema"]) == ("mass", 1)
    assert contents["components"]["AF"]["mass"] == {
        "value": given.masses["AF"].mass,
        "u": given.masses["AF"].u,
        "unit": "kg",
    }
    assert contents["common_mass"] == {"value": given.mass, "u": given.u_mass, "unit": "kg"}
    assert contents["centre_of_gravity"]["aft"]["unit"] == "m"
    assert contents["offsets"]["PM"]["unit"] == "N*m"
    assert contents["misalignment"]["pitch"]["unit"] == "rad"
    assert contents["agreement"]["mass"]["degrees_of_freedom"] == 2
    assert contents["agreement"]["centre_of_gravity"]["agree"] is True
    assert contents["unidentified"] == {}


@pytest.mark.parametrize(
    ("keys", "value", "said"),
    [
        (["common_mass", "value"], -1.0, "common_mass.value"),
        (["centre_of_gravity", "aft", "unit"], "mm", "centre_of_gravity.aft.unit.*'mm'"),
        (["model", "parameters", "mass", "unit"], "lb", "model.parameters.mass.unit"),
        (["model", "parameters", "colour"], {"value": 1.0}, "model.parameters.colour: is no parameter"),
        (["model", "parameters", "offset.XX"], {"value": 1.0}, "model.parameters.offset.XX: is no parameter"),
        (["model", "components"], ["AF", "XX"], "is no parameter of this model|components must be"),
        (["model", "covariance", 0, 0], -1.0, "model.covariance.matrix|model.covariance"),
        (["model", "absorbed"], [[1.0]], "model.absorbed: must have 13 rows of 0 numbers"),
        (["model", "residuals"], [[1.0]], "model.residuals: must have rows of 6 numbers"),
        (["model", "gravity", "value"], 0.0, "model.gravity.value"),
        (["agreement", "mass", "p_value"], 2.0, "agreement.mass.p_value"),
        (["model"], None, "holds masses alone"),
    ],
)
def test_broken_files_are_refused_with_the_key(tmp_path, keys, value, said):
    path = tmp_path / "mass.json"
    write_weighing(path, fit_weight(readings()))
    contents = json.loads(path.read_text())
    place = contents
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    path.write_text(json.dumps(contents))
    with pytest.raises(ReadError, match=said):
        read_weighing(path)


def test_a_parameter_too_few_is_refused(tmp_path):
    path = tmp_path / "mass.json"
    write_weighing(path, fit_weight(readings((0,))))
    contents = json.loads(path.read_text())
    contents["model"]["left_out"] = {}
    contents["model"]["absorbed"] = [[] for _ in contents["model"]["parameters"]]
    path.write_text(json.dumps(contents))
    with pytest.raises(ReadError, match="model: parameters and left_out must together be"):
        read_weighing(path)


def test_a_weighing_by_one_force_corrects_later_runs_along_it(tmp_path):
    points = readings((0,))
    alone = LoadPoints(("AF",), points.pitch, points.loads[:, 5:])
    given = fit_weight(alone)
    write_weighing(tmp_path / "mass.json", given)
    same(read_weighing(tmp_path / "mass.json"), given)
    # less the weight, the readings that were weighed are their offset and noise
    off = alone.loads - given.loads(pitch=alone.pitch, offsets=False)
    assert np.std(off) < 0.05


OF_ONE_FORCE = """{"kind": "mass", "schema": 1,
 "components": {"AF": {
  "mass": {"value": 5.10282159443212, "u": 0.002436281371944448, "unit": "kg"},
  "offset": {"value": 0.004707029347980299, "u": 0.0033874486509247845, "unit": "N"},
  "misalignment": {"right": {"value": 0.00294347115420734, "u": 9.671908368101515e-05, "unit": "rad"}},
  "covariance": {"parameters": ["mass", "offset", "right"], "matrix": [
   [5.935466923283523e-06, 3.262540757334255e-22, -3.4237676846276517e-09],
   [3.262540757334255e-22, 1.1474808362652141e-05, -1.1081749041195093e-23],
   [-3.4237676846276517e-09, -1.1081749041195093e-23, 9.354581148095211e-09]]},
  "residuals": [0.009999999999992681, -0.020000000000000843, 0.010000000000005116],
  "degrees_of_freedom": 8,
  "gravity": {"value": 9.80665, "u": 0.0, "unit": "m/s^2"}}},
 "warnings": [],
 "provenance": {"program": "aerobalance 0.1.0", "created": "2026-11-23T00:36:44+00:00", "inputs": [],
  "settings": {"component": "AF", "gravity": 9.80665}}}"""
"""As the program wrote a weighing by one force before it had the model of all."""

OF_TWO_FORCES = """{"kind": "mass", "schema": 1,
 "components": {
  "NF": {
   "mass": {"value": 5.03146023583794, "u": 0.16441178228910203, "unit": "kg"},
   "offset": {"value": -0.6382304782198567, "u": 1.5960406437441514, "unit": "N"},
   "misalignment": {},
   "covariance": {"parameters": ["mass", "offset"],
    "matrix": [[0.02703123415547908, 0.2624010192687632], [0.2624010192687632, 2.547345736483245]]},
   "residuals": [-7.1e-15, -7.1e-15, -7.1e-15], "degrees_of_freedom": 1,
   "gravity": {"value": 9.80665, "u": 0.0, "unit": "m/s^2"}},
  "AF": {
   "mass": {"value": 5.09858106488964, "u": 0.01017114209840545, "unit": "kg"},
   "offset": {"value": 3.14e-16, "u": 0.8639418912537289, "unit": "N"},
   "misalignment": {},
   "covariance": {"parameters": ["mass", "offset"],
    "matrix": [[0.00010345213158595563, 5.46e-18], [5.46e-18, 0.7463955914630699]]},
   "residuals": [0.01, -0.02, 0.01], "degrees_of_freedom": 1,
   "gravity": {"value": 9.80665, "u": 0.0, "unit": "m/s^2"}}},
 "common_mass": {"value": 5.098325969937366, "u": 0.010135745756138324, "unit": "kg"},
 "centre_of_gravity": {},
 "offsets": {"NF": {"value": 0.010857043308936656, "u": 0.09906624641210911, "unit": "N"},
  "AF": {"value": -2.63e-16, "u": 0.8638983119041507, "unit": "N"}},
 "misalignment": {},
 "agreement": {"mass": {"chi2": 0.166, "degrees_of_freedom": 1, "p_value": 0.7536734679123448, "agree": true},
  "centre_of_gravity": null},
 "residual_standard_deviation": {"NF": {"value": 0.005757032864561025, "unit": "N"},
  "AF": {"value": 0.024456170823444784, "unit": "N"}},
 "unidentified": {"misalignment.pitch": "add readings at roll 90 deg"},
 "model": {"components": ["NF", "AF"], "own_masses": false, "own_centres": false,
  "gravity": {"value": 9.80665, "u": 0.0, "unit": "m/s^2"},
  "parameters": {"mass": {"value": 5.098325969937366, "u": 0.010135745756138324, "unit": "kg"},
   "offset.NF": {"value": 0.010857043308936656, "u": 0.09906624641210911, "unit": "N"},
   "offset.AF": {"value": -2.63e-16, "u": 0.8638983119041507, "unit": "N"}},
  "covariance": [[0.00010273334203307602, 0.000997266107322796, 8.1e-17],
   [0.000997266107322796, 0.00981412117818472, 6.3e-16], [8.1e-17, 6.3e-16, 0.7463202933108412]],
  "left_out": {"misalignment.pitch": {"value": 0.0, "u": 0.017453292519943295, "unit": "rad"},
   "misalignment.roll": {"value": 0.0, "u": 0.017453292519943295, "unit": "rad"},
   "misalignment.yaw": {"value": 0.0, "u": 0.017453292519943295, "unit": "rad"}},
  "absorbed": [[5.4e-15, 0.0, 0.0], [4.2e-14, 0.0, 0.0], [49.491115477049156, 0.0, 0.0]],
  "degrees_of_freedom": 3,
  "residuals": [[-0.003, 0.01], [0.007, -0.02], [-0.003, 0.01]]},
 "warnings": [],
 "provenance": {"program": "aerobalance 0.1.0", "created": "2026-11-23T00:36:44+00:00", "inputs": [],
  "settings": {"components": ["NF", "AF"]}}}"""
"""As the program has written weighings by several components from the first version on."""


def test_files_of_earlier_versions_are_read(tmp_path):
    path = tmp_path / "mass.json"
    path.write_text(OF_ONE_FORCE)
    mass = read_masses(path)["AF"]
    assert (mass.mass, mass.u, mass.offset) == (5.10282159443212, 0.002436281371944448, 0.004707029347980299)
    assert (mass.misalignment, mass.degrees_of_freedom) == ({"right": 0.00294347115420734}, 8)
    assert mass.covariance[0, 2] == -3.4237676846276517e-09
    with pytest.raises(ReadError, match=r"model: is missing: .*masses alone; weigh again, with all loads"):
        read_weighing(path)
    path.write_text(OF_TWO_FORCES)
    assert {name: found.u for name, found in read_masses(path).items()} == {
        "NF": 0.16441178228910203,
        "AF": 0.01017114209840545,
    }
    weighing = read_weighing(path)
    assert (weighing.components, weighing.mass) == (("NF", "AF"), 5.098325969937366)
    weight = weighing.mass * weighing.gravity
    np.testing.assert_allclose(
        weighing.loads(pitch=0.2, offsets=False), [[-weight * np.cos(0.2), weight * np.sin(0.2)]]
    )
    # at the attitudes of the weighing the tilt went into the offset, and the loads are known to the noise
    assert (weighing.uncertainty(pitch=0.0)[0] < 0.1).all()


def test_the_command_takes_all_loads_or_one(tmp_path):
    points = readings()
    path, out = table(tmp_path / "points.csv", points), tmp_path / "mass.json"
    account = weigh_files([path], out)
    assert account["common_mass"]["value"] == pytest.approx(fit_weight(points).mass, rel=1e-9)
    assert set(account["components"]) == {"NF", "SF", "AF"}
    assert read_weighing(out).components == COMPONENTS
    assert json.loads(out.read_text())["provenance"]["settings"]["components"] == list(COMPONENTS)
    account = weigh_files([path], out, component="AF")
    alone = fit_weight(LoadPoints(("AF",), points.pitch, points.loads[:, 5:], points.roll))
    assert account["component"] == "AF"
    assert account["mass"] == account["components"]["AF"]["mass"]
    assert account["mass"]["value"] == pytest.approx(alone.mass, rel=1e-9)
    assert list(read_masses(out)) == ["AF"]


def test_the_command_with_one_load_only_is_as_with_that_component(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text(
        "pitch [deg],AF [N]\n" + "".join(f"{p},{10 * np.sin(np.radians(p)) + 0.1 * (p % 3):.6f}\n" for p in range(9))
    )
    first, second = tmp_path / "a.json", tmp_path / "b.json"
    assert weigh_files([path], first) == weigh_files([path], second, component="AF")
    texts = [[line for line in file.read_text().splitlines() if "created" not in line] for file in (first, second)]
    assert texts[0] == texts[1]


def test_the_command_without_a_force(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("pitch [deg],PM [N*m]\n0,1\n10,2\n20,3\n")
    with pytest.raises(ValueError, match="AF, SF or NF"):
        weigh_files([path], None)
    path.write_text("pitch [deg],time [deg]\n0,1\n")
    with pytest.raises((FitError, ReadError)):
        weigh_files([path], None)
    assert list(tmp_path.iterdir()) == [path]
