"""dynamics.json and mass.json: what is written reads back; what is broken or unphysical is refused."""

import copy
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import PARAMETERS, Dynamics
from aerobalance.io.artefacts import digest, write_json
from aerobalance.io.dynamics_file import read_dynamics, write_dynamics
from aerobalance.io.mass_file import read_masses
from aerobalance.recording.errors import ReadError

# The vibration-rig balance as printed in [Gorbushin2020]_.
PRINTED = {"mass": 0.68, "stiffness": 11.43e6, "damping": 371.98}


# printf 'time [s],AF [N]\n0,1\n1,2\n' | sha256sum
SHA256 = "ef293ed0de57a6f4c463d425043e4eb566f80704df1763d9cf36760d3c6bf8ac"


def covariance(scale=1.0):
    factor = np.array([[1e-4, 0, 0, 0], [1e3, 1e3, 0, 0], [0.1, 0.2, 1, 0], [0, 1e-9, 1e-8, 1e-7]]) * scale
    return factor @ factor.T


def written(tmp_path, **settings_):
    source = tmp_path / "run.csv"
    source.write_text("time [s],AF [N]\n0,1\n1,2\n")
    path = tmp_path / "dynamics.json"
    axial = Dynamics("AF", **PRINTED, delay=1e-6, covariance=covariance())
    pitching = Dynamics("PM", 2.0, 3e5, 4.0)
    write_dynamics(
        path,
        {"AF": axial, "PM": pitching},
        details={"AF": {"rms": 0.5, "bad": float("nan"), "list": np.array([1.0, np.inf]), "count": np.int64(3)}},
        inputs=[source],
        settings={"component": "AF", "mass": None, "file": source},
        warnings=["one doubt"],
        **settings_,
    )
    return path, axial


def test_dynamics_round_trip(tmp_path):
    path, axial = written(tmp_path)
    found = read_dynamics(path)
    assert list(found) == ["AF", "PM"]
    for name in PARAMETERS:
        assert getattr(found["AF"], name) == getattr(axial, name)
    np.testing.assert_array_equal(found["AF"].covariance, axial.covariance)
    assert not found["PM"].covariance.any()


def test_dynamics_have_the_structure_that_was_promised(tmp_path):
    path, axial = written(tmp_path)
    contents = json.loads(path.read_text())
    assert (contents["kind"], contents["schema"], contents["warnings"]) == ("dynamics", 1, ["one doubt"])
    entry = contents["components"]["AF"]
    units = {"mass": "kg", "stiffness": "N/m", "damping": "N*s/m", "natural_frequency": "Hz", "delay": "s"}
    for name, unit in units.items():
        assert entry[name] == {"value": getattr(axial, name), "u": axial.uncertainty(name), "unit": unit}
    assert entry["damping_ratio"]["value"] == axial.damping_ratio
    assert entry["covariance"]["parameters"] == list(PARAMETERS)
    assert entry["fit"] == {"rms": 0.5, "bad": None, "list": [1.0, None], "count": 3}
    other = contents["components"]["PM"]
    assert "delay" not in other
    assert "fit" not in other
    # the load of a moment is M w, and M has the lever of the moment: M w^2 is in kg m / s^2
    assert other["mass"] == {"value": 2.0, "u": 0.0, "unit": "kg*m"}
    assert other["stiffness"] == {"value": 3e5, "u": 0.0, "unit": "N"}
    assert other["damping"] == {"value": 4.0, "u": 0.0, "unit": "N*s"}
    provenance = contents["provenance"]
    assert provenance["program"].startswith("aerobalance ")
    assert provenance["inputs"] == [{"name": "run.csv", "sha256": SHA256}]
    assert provenance["settings"] == {"component": "AF", "mass": None, "file": "run.csv"}
    assert provenance["created"].endswith("+00:00")


def test_moments_of_earlier_files_are_read_with_the_units_of_forces(tmp_path):
    path, _ = written(tmp_path)
    expected = read_dynamics(path)["PM"]
    contents = json.loads(path.read_text())
    moment = contents["components"]["PM"]
    moment["stiffness"]["unit"], moment["damping"]["unit"] = "N/m", "N*s/m"
    path.write_text(json.dumps(contents))
    found = read_dynamics(path)["PM"]
    assert [getattr(found, name) for name in PARAMETERS] == [getattr(expected, name) for name in PARAMETERS]
    moment["stiffness"]["unit"] = "N*m"
    path.write_text(json.dumps(contents))
    with pytest.raises(ReadError, match=r"components\.PM\.stiffness\.unit.*allowed: 'N'"):
        read_dynamics(path)


def modal():
    modes = (Mode(165.0, 0.008, -0.05), Mode(310.0, 0.015, 0.03))
    return Dynamics(
        "AF", 177.87, 3.093e7, 828.21, covariance=np.diag(np.arange(1.0, 11.0)) * 1e-8, further_modes=modes
    )


def test_modes_round_trip(tmp_path):
    path = tmp_path / "dynamics.json"
    write_dynamics(path, {"AF": modal()})
    found = read_dynamics(path)["AF"]
    assert found.further_modes == modal().further_modes
    np.testing.assert_array_equal(found.covariance, modal().covariance)
    modes = json.loads(path.read_text())["components"]["AF"]["modes"]
    assert [mode["natural_frequency"] for mode in modes] == [modal().natural_frequency, 165.0, 310.0]
    assert sum(mode["share"] for mode in modes) == pytest.approx(1, abs=1e-15)
    assert modes[1]["u_share"] == pytest.approx(np.sqrt(7e-8))
    assert modes[2]["u_damping_ratio"] == pytest.approx(np.sqrt(9e-8))


@pytest.mark.parametrize(
    ("keys", "value", "said"),
    [
        (["modes", 1, "share"], 0.2, ["components.AF.modes", "add to 1.25"]),
        (["modes", 0, "natural_frequency"], 70.0, ["modes[0].natural_frequency", "70", "66.3"]),
        (["modes", 1, "damping_ratio"], -0.1, ["modes.1.damping_ratio", "greater than or equal to 0"]),
        (["modes", 1, "u_share"], 9.0, ["covariance.matrix", "share_2.u"]),
    ],
)
def test_broken_modes_are_refused_with_the_key(tmp_path, keys, value, said):
    path = tmp_path / "dynamics.json"
    write_dynamics(path, {"AF": modal()})
    path.write_text(json.dumps(changed(json.loads(path.read_text()), [*AF, *keys], value)))
    with pytest.raises(ReadError) as caught:
        read_dynamics(path)
    for words in ["dynamics.json", *said]:
        assert words in str(caught.value)


def test_the_same_inputs_give_the_same_bytes_but_for_the_time(tmp_path):
    texts = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        path, _ = written(tmp_path / folder)
        texts.append([line for line in path.read_text().splitlines() if '"created"' not in line])
    assert texts[0] == texts[1]
    assert str(tmp_path) not in "".join(texts[0])


def test_dynamics_written_by_hand(tmp_path):
    path = tmp_path / "hand.json"
    entry = {name: {"value": value} for name, value in PRINTED.items()}
    path.write_text(json.dumps({"components": {"AF": entry}}))
    found = read_dynamics(path)["AF"]
    assert (found.mass, found.stiffness, found.damping, found.delay) == (0.68, 11.43e6, 371.98, 0)
    assert not found.covariance.any()
    entry["stiffness"]["u"] = 100
    path.write_text(json.dumps({"kind": "dynamics", "schema": 1, "components": {"AF": entry}}))
    assert read_dynamics(path)["AF"].uncertainty("stiffness") == pytest.approx(100)


def changed(contents, keys, value):
    """Put a value at a place; DELETE takes the place away."""
    contents = copy.deepcopy(contents)
    place = contents
    for key in keys[:-1]:
        place = place[key]
    if value is DELETE:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    return contents


DELETE = object()
AF = ["components", "AF"]
BROKEN = [
    (["kind"], "mass", ["kind", "'mass'", "'dynamics'"]),
    (["kind"], 3, ["kind"]),
    (["schema"], 2, ["schema", "reads schema 1"]),
    (["schema"], True, ["schema"]),
    (["components"], {}, ["components", "at least 1"]),
    (["components"], DELETE, ["components", "is missing"]),
    (["components"], [], ["components"]),
    ([*AF], 3, ["components.AF", "3"]),
    ([*AF, "mass"], DELETE, ["components.AF.mass", "is missing"]),
    ([*AF, "mass", "value"], DELETE, ["components.AF.mass.value", "is missing"]),
    ([*AF, "mass", "value"], -1.0, ["components.AF.mass.value", "greater than 0", "-1.0"]),
    ([*AF, "mass", "value"], 0.0, ["components.AF.mass.value", "greater than 0"]),
    ([*AF, "mass", "value"], "0.68", ["components.AF.mass.value", "number", "'0.68'"]),
    ([*AF, "mass", "value"], None, ["components.AF.mass.value", "number", "None"]),
    ([*AF, "mass", "value"], True, ["components.AF.mass.value", "number"]),
    ([*AF, "mass", "value"], float("nan"), ["NaN", "finite"]),
    ([*AF, "stiffness", "value"], float("inf"), ["Infinity", "finite"]),
    ([*AF, "stiffness", "value"], 1e999, ["Infinity", "finite"]),
    ([*AF, "stiffness", "value"], -5.0, ["components.AF.stiffness.value", "greater than 0"]),
    ([*AF, "damping", "value"], -5.0, ["components.AF.damping.value", "greater than or equal to 0"]),
    ([*AF, "damping", "u"], -5.0, ["components.AF.damping.u", "greater than or equal to 0"]),
    ([*AF, "mass", "unit"], "lb", ["components.AF.mass.unit", "'lb'", "'kg'"]),
    ([*AF, "mass", "u"], 0.5, ["covariance.matrix", "mass.u", "agree"]),
    ([*AF, "covariance", "parameters"], ["mass"] * 4, ["covariance.parameters", "each once"]),
    ([*AF, "covariance", "parameters"], ["colour"] * 4, ["covariance.parameters", "mass, stiffness"]),
    ([*AF, "covariance", "matrix"], [[1.0]], ["covariance.matrix", "4 rows of 4"]),
    ([*AF, "covariance", "matrix", 0, 1], 1.0, ["covariance.matrix", "not symmetric"]),
    ([*AF, "covariance", "matrix", 0, 0], -1.0, ["covariance.matrix", "negative variance"]),
    ([*AF, "covariance", "matrix", 0, 0], "x", ["covariance.matrix.0.0", "number"]),
]


@pytest.mark.parametrize(("keys", "value", "said"), BROKEN)
def test_broken_dynamics_are_refused_with_the_key(tmp_path, keys, value, said):
    path, _ = written(tmp_path)
    path.write_text(json.dumps(changed(json.loads(path.read_text()), keys, value)))
    with pytest.raises(ReadError) as caught:
        read_dynamics(path)
    for words in ["dynamics.json", *said]:
        assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_covariance_with_a_negative_direction_is_refused(tmp_path):
    path, _ = written(tmp_path)
    contents = json.loads(path.read_text())
    matrix = np.diag(np.diag(covariance()))
    matrix[0, 1] = matrix[1, 0] = 1.5 * np.sqrt(matrix[0, 0] * matrix[1, 1])
    contents["components"]["AF"]["covariance"]["matrix"] = matrix.tolist()
    path.write_text(json.dumps(contents))
    with pytest.raises(ReadError, match="a combination of parameters has a negative variance"):
        read_dynamics(path)


def test_unknown_component_is_refused(tmp_path):
    path = tmp_path / "d.json"
    path.write_text(json.dumps({"components": {"XX": {name: {"value": v} for name, v in PRINTED.items()}}}))
    with pytest.raises(ReadError, match=r"components\.XX: is no component; allowed: NF, PM"):
        read_dynamics(path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"{", "line 1, column 2.*broken or cut off"),
        (b"[1, 2]", "holds an array"),
        (b"3", "holds a number"),
        (b"\xff\xfe\x00", "no JSON text"),
        (b"[" * 100000, "nested too deeply"),
        (b"time [s],AF [N]\n", "line 1, column 1.*JSON"),
    ],
)
def test_files_that_are_no_such_json(tmp_path, content, said):
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    for reader in (read_dynamics, read_masses):
        with pytest.raises(ReadError, match=said):
            reader(path)


def test_every_truncation_is_refused(tmp_path):
    path, _ = written(tmp_path)
    whole = path.read_bytes().rstrip()
    for length in range(0, len(whole), 37):
        path.write_bytes(whole[:length])
        with pytest.raises(ReadError, match=r"dynamics\.json"):
            read_dynamics(path)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(ReadError, match="no such file"):
        read_dynamics(tmp_path / "none.json")
    with pytest.raises(ReadError, match="is a folder; a file is needed"):
        read_masses(tmp_path)
    with pytest.raises(ReadError, match=r"no such file|cannot be read"):
        write_dynamics(tmp_path / "d.json", {}, inputs=[tmp_path / "none.csv"])
    assert list(tmp_path.iterdir()) == []


def test_mass_by_hand_and_broken(tmp_path):
    path = tmp_path / "mass.json"
    path.write_text('{"components": {"AF": {"mass": {"value": 177.87, "u": 0.1}}}}')
    found = read_masses(path)["AF"]
    assert (found.mass, found.u) == (177.87, 0.1)
    path.write_text('{"components": {"AF": {"mass": {"value": -1}}}}')
    with pytest.raises(ReadError, match=r"components\.AF\.mass\.value: .*greater than 0, not -1"):
        read_masses(path)
    path.write_text('{"components": {"PM": {"mass": {"value": 1}}}}')
    with pytest.raises(ReadError, match=r"components\.PM: .*allowed: AF, SF, NF"):
        read_masses(path)
    dynamics, _ = written(tmp_path)
    with pytest.raises(ReadError, match=r"kind: is 'dynamics', but a file of kind 'mass'"):
        read_masses(dynamics)


positive = st.floats(1e-6, 1e12)


@settings(max_examples=50, deadline=None)
@given(
    values=st.tuples(positive, positive, st.floats(0, 1e9), st.floats(-1, 1)),
    scale=st.just(0.0) | st.floats(1e-100, 1e3),
)
def test_any_dynamics_round_trip(tmp_path_factory, values, scale):
    path = tmp_path_factory.mktemp("any") / "dynamics.json"
    given_ = Dynamics("AF", *values, covariance(scale))
    write_dynamics(path, {"AF": given_})
    found = read_dynamics(path)["AF"]
    assert [getattr(found, name) for name in PARAMETERS] == list(values)
    np.testing.assert_array_equal(found.covariance, given_.covariance)


def test_json_takes_plain_data_only(tmp_path):
    with pytest.raises(ValueError, match="cannot write a set as JSON"):
        write_json(tmp_path / "x.json", {"a": {1}})
    assert list(tmp_path.iterdir()) == []
    write_json(tmp_path / "x.json", {"a": float("inf"), "b": np.float64(1.5), "µ": True})
    assert json.loads((tmp_path / "x.json").read_text(encoding="utf-8")) == {"a": None, "b": 1.5, "µ": True}


def test_the_digest_of_a_folder_is_that_of_its_files(tmp_path) -> None:
    for name in ("one", "two"):
        (tmp_path / name / "c").mkdir(parents=True)
        (tmp_path / name / "zarr.json").write_text("{}")
        (tmp_path / name / "c" / "0").write_bytes(b"12345678")
    assert digest(tmp_path / "one") == digest(tmp_path / "two")
    (tmp_path / "two" / "c" / "0").write_bytes(b"12345679")
    assert digest(tmp_path / "one") != digest(tmp_path / "two")
