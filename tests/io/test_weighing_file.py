"""mass.json of a weighing with several components, and the command that writes it."""

import json

import numpy as np
import pytest

from aerobalance.app.commands.weighing import weigh as weigh_files
from aerobalance.balance.weighing import LoadPoints, Weighing, WeightModel, weigh, weigh_components
from aerobalance.io.mass_file import read_mass, write_mass
from aerobalance.io.weighing_file import read_weighing, write_weighing
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
    given = weigh_components(readings(rolls))
    assert bool(given.left_out) == (rolls == (0,))
    write_weighing(tmp_path / "mass.json", given, warnings=["w"])
    same(read_weighing(tmp_path / "mass.json"), given)
    for name, mass in read_mass(tmp_path / "mass.json").items():
        assert (mass.mass, mass.u) == (given.masses[name].mass, given.masses[name].u)
        np.testing.assert_array_equal(mass.covariance, given.masses[name].covariance)


def test_round_trip_where_components_differ(tmp_path):
    with pytest.warns(DataQualityWarning, match="different masses"):
        given = weigh_components(readings(AF=5.5))
    write_weighing(tmp_path / "mass.json", given)
    same(read_weighing(tmp_path / "mass.json"), given)


def test_structure_of_the_file(tmp_path):
    given = weigh_components(readings())
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
        (["model"], None, "holds masses of single components"),
    ],
)
def test_broken_files_are_refused_with_the_key(tmp_path, keys, value, said):
    path = tmp_path / "mass.json"
    write_weighing(path, weigh_components(readings()))
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
    write_weighing(path, weigh_components(readings((0,))))
    contents = json.loads(path.read_text())
    contents["model"]["left_out"] = {}
    contents["model"]["absorbed"] = [[] for _ in contents["model"]["parameters"]]
    path.write_text(json.dumps(contents))
    with pytest.raises(ReadError, match="model: parameters and left_out must together be"):
        read_weighing(path)


def test_the_mass_of_one_component_does_not_correct_later_runs(tmp_path):
    points = readings((0,))
    write_mass(tmp_path / "mass.json", {"AF": weigh(points.pitch, points.loads[:, 5])})
    with pytest.raises(ReadError, match="weigh with all loads to correct later runs"):
        read_weighing(tmp_path / "mass.json")


def test_the_command_takes_all_loads_or_one(tmp_path):
    points = readings()
    path, out = table(tmp_path / "points.csv", points), tmp_path / "mass.json"
    account = weigh_files([path], out)
    assert account["common_mass"]["value"] == pytest.approx(weigh_components(points).mass, rel=1e-9)
    assert set(account["components"]) == {"NF", "SF", "AF"}
    assert read_weighing(out).components == COMPONENTS
    assert json.loads(out.read_text())["provenance"]["settings"]["components"] == list(COMPONENTS)
    account = weigh_files([path], out, component="AF")
    alone = weigh(points.pitch, points.loads[:, 5], roll=points.roll)
    assert account["component"] == "AF"
    assert account["mass"]["value"] == pytest.approx(alone.mass, rel=1e-9)
    assert list(read_mass(out)) == ["AF"]


def test_the_command_with_one_load_only_is_as_with_that_component(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text(
        "pitch [deg],AF [N]\n" + "".join(f"{p},{10 * np.sin(np.radians(p)) + p % 3:.6f}\n" for p in range(9))
    )
    first, second = tmp_path / "a.json", tmp_path / "b.json"
    assert weigh_files([path], first) == weigh_files([path], second, component="AF")
    texts = [[line for line in file.read_text().splitlines() if "created" not in line] for file in (first, second)]
    assert texts[0] == texts[1]


def test_the_command_without_a_force(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("pitch [deg],PM [N*m]\n0,1\n10,2\n20,3\n")
    with pytest.raises(ValueError, match="AF, SF, NF"):
        weigh_files([path], None)
    path.write_text("pitch [deg],time [deg]\n0,1\n")
    with pytest.raises((FitError, ReadError)):
        weigh_files([path], None)
    assert list(tmp_path.iterdir()) == [path]
