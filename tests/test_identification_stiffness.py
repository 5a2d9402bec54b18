"""Coupled dynamics from mass, inertia and stiffness: the files, the uncertainty, and the comparison."""

import json

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.app.commands.identify_stiffness import from_stiffness
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.identification.coupled.modes import ModeTable
from aerobalance.identification.from_stiffness import agreement, coupled_from_stiffness
from aerobalance.io.dynamics_file import read_coupled, write_dynamics
from aerobalance.io.stiffness_file import read_rigid_mass, read_stiffness
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import DataQualityWarning, ReadError

MASS = """
mass = {value = 20.0, u = 0.01, unit = "kg"}

[centre]
aft = {value = 0.04, u = 1e-4}
right = -0.02
up = {value = 0.03, u = 1e-4}

[inertia]
aa = {value = 0.9, u = 0.002}
rr = {value = 0.8, u = 0.002}
uu = {value = 0.3, u = 0.002}
ar = 0.03
"""
RATIOS = "0.01+-0.0002"


def rigid():
    return RigidMass(20.0, np.array([0.04, -0.02, 0.03]), np.array([[0.9, 0.03, 0], [0.03, 0.8, 0], [0, 0, 0.3]]))


def stiffness():
    size = np.sqrt(np.diag(rigid().matrix)) * 2 * np.pi * np.array([130.0, 300.0, 80.0, 180.0, 240.0, 400.0])
    mixing = np.random.default_rng(5).uniform(-0.05, 0.05, (6, 6))
    return (np.eye(6) + np.triu(mixing, 1) + np.triu(mixing, 1).T) * np.outer(size, size)


def u_stiffness():
    size = np.sqrt(np.diag(stiffness()))
    return 1e-3 * np.outer(size, size)


def written(folder, *, separator=","):
    """Mass and stiffness with 0.1 % of uncertainty, as files."""
    mass, table = folder / "mass.toml", folder / "K.csv"
    mass.write_text(MASS)
    rows = [separator.join(["", *COMPONENTS])]
    for word, matrix in (("", stiffness()), ("u ", u_stiffness())):
        for name, row in zip(COMPONENTS, matrix, strict=True):
            cells = [repr(float(value)).replace(".", "," if separator == ";" else ".") for value in row]
            rows.append(separator.join([word + name, *cells]))
    table.write_text("# load over displacement [N/m, N, N*m]\n" + "\n".join(rows) + "\n")
    return mass, table


@pytest.mark.parametrize("separator", [",", ";"])
def test_a_stiffness_table_reads_back(tmp_path, separator):
    _, table = written(tmp_path, separator=separator)
    found, u = read_stiffness(table)
    np.testing.assert_allclose(found, stiffness(), rtol=1e-15)
    # the mean of two elements that are measured apart has 1/sqrt(2) of the uncertainty of one
    expected = u_stiffness() * np.where(np.eye(6) > 0, 1, np.sqrt(0.5))
    np.testing.assert_allclose(u, expected, rtol=1e-12)


def test_a_stiffness_in_json_may_be_in_any_order(tmp_path):
    order = [5, 0, 1, 2, 3, 4]
    names = [COMPONENTS[place] for place in order]
    table = {"rows": names, "columns": names, "matrix": stiffness()[np.ix_(order, order)].tolist()}
    file = tmp_path / "K.json"
    file.write_text(json.dumps({"stiffness": table}))
    found, u = read_stiffness(file)
    np.testing.assert_array_equal(found, stiffness())
    assert not u.any()


def test_what_is_no_stiffness_is_refused(tmp_path):
    file = tmp_path / "K.csv"

    def refused(text, match):
        file.write_text(text)
        with pytest.raises(ReadError, match=match):
            read_stiffness(file)

    refused("", "is empty")
    refused(",NF,PM\nNF,1,2\nPM,1,2\n", "must be NF, PM, SF, YM, RM, AF")
    head = "," + ",".join(COMPONENTS) + "\n"
    refused(head + "NF,1,2,x,4,5,6\n", "line 2.*no number")
    refused(head + "NF,1,2,3\n", "line 2.*6 finite numbers")
    negative = [",".join([name, *map(str, -row)]) for name, row in zip(COMPONENTS, np.eye(6), strict=True)]
    refused(head + "\n".join(negative), "is not positive")
    with pytest.raises(ReadError, match="there is no such file"):
        read_stiffness(tmp_path / "none.csv")
    crooked = stiffness()
    crooked[0, 1] *= 2
    rows = [",".join([name, *map(repr, row.tolist())]) for name, row in zip(COMPONENTS, crooked, strict=True)]
    file.write_text(head + "\n".join(rows))
    with pytest.warns(DataQualityWarning, match="not symmetric: (NF/PM|PM/NF)"):
        read_stiffness(file)


def test_a_mass_reads_from_toml_json_and_dynamics(tmp_path):
    mass, _ = written(tmp_path)
    found = read_rigid_mass(mass)
    np.testing.assert_allclose(found.values, rigid().values, rtol=1e-15)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance))[:4], [0.01, 1e-4, 0, 1e-4])
    dynamics = tmp_path / "dynamics.json"
    made = coupled_from_stiffness(stiffness(), found, damping_ratios=0.01)
    write_dynamics(dynamics, made)
    np.testing.assert_allclose(read_rigid_mass(dynamics).values, rigid().values, rtol=1e-12)
    file = tmp_path / "mass.json"
    file.write_text(json.dumps({"mass": {"value": 3.0}, "components": {}}))
    with pytest.raises(ReadError, match="a weighing tells mass and centre of gravity only"):
        read_rigid_mass(file)
    file.write_text(json.dumps({"mass": -1, "centre": {"aft": 0, "right": 0, "up": 0}, "inertia": {}}))
    with pytest.raises(ReadError, match="mass"):
        read_rigid_mass(file)


def test_the_modes_have_the_uncertainty_of_differences(rng):
    """Their derivatives by A and D against differences of the poles."""
    made = coupled_from_stiffness(stiffness(), rigid(), damping_ratios=[0.01, 0.02, 0.004, 0.03, 0.01, 0.015])
    values = np.concatenate([made.inertia.ravel(), made.damping.ravel()])
    place = int(rng.integers(72))
    step = 1e-6 * abs(values).reshape(2, 36).mean(axis=1)[place // 36]
    covariance = np.zeros((72, 72))
    covariance[place, place] = step**2
    table = ModeTable.of(CoupledDynamics(COMPONENTS, made.inertia, made.damping, covariance), sizes=np.ones(6))

    def modes(sign):
        moved = values.copy()
        moved[place] += sign * step
        parts = CoupledDynamics(COMPONENTS, *moved.reshape(2, 6, 6)).modes
        return np.array([[mode.natural_frequency, mode.damping_ratio] for mode in parts]).T

    more, less = modes(1), modes(-1)
    expected = np.abs(more - less) / 2
    found = np.array([table.u_natural_frequency, table.u_damping_ratio])
    # rounding of the differences: 1e-13 of a frequency or a ratio of one
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-11 * max(1, more[0].max()))


def test_stiffness_and_identified_dynamics_agree_within_their_uncertainty(rng):
    """Dynamics drawn with the covariance of both: the test of agreement is a chi2."""
    mass = rigid()
    made = coupled_from_stiffness(
        stiffness(), mass, damping_ratios=0.01, u_stiffness=u_stiffness(), u_damping_ratios=2e-4
    )
    values = np.concatenate([made.inertia.ravel(), made.damping.ravel()])
    u = 1e-3 * np.abs(values)
    drawn = rng.multivariate_normal(values, made.covariance, method="eigh") + u * rng.normal(size=72)
    other = CoupledDynamics(COMPONENTS, *drawn.reshape(2, 6, 6), np.diag(u**2))
    test = agreement(made, other, damping=True)
    assert test.degrees_of_freedom == 72
    assert 1e-5 < test.p_value < 1 - 1e-5
    assert agreement(made, other, damping=False).degrees_of_freedom == 36


def test_the_command_compares_and_names_what_departs(tmp_path, capsys):
    mass, table = written(tmp_path)
    identified, out = tmp_path / "identified.json", tmp_path / "dynamics.json"
    truth = coupled_from_stiffness(stiffness(), rigid(), damping_ratios=0.01)
    values = np.concatenate([truth.inertia.ravel(), truth.damping.ravel()])
    covariance = np.diag((1e-4 * np.abs(values)) ** 2)
    write_dynamics(identified, CoupledDynamics(COMPONENTS, truth.inertia, truth.damping, covariance))
    command = ["identify", "stiffness", str(table), "--mass", str(mass)]
    assert main([*command, "--ratios", RATIOS, "--compare", str(identified), "-o", str(out)]) == 0
    said = capsys.readouterr()
    assert "A and D as identified: holds" in said.out
    assert "Elements that depart most" in said.out
    # as they are, in N and N*m; not over half of range, which this command does not know
    title = "A (inertia), loads in N and N*m, elements in 1e-6 s^2, with m or 1/m between a force and a moment"
    (after,) = said.out.split(title)[1:]
    row = next(line for line in after.splitlines() if line.split()[:1] == ["NF"] and "PM" not in line)
    assert [float(value) for value in row.split()[1:]] == pytest.approx(1e6 * truth.inertia[0], rel=1e-4)
    assert not said.err
    assert read_coupled(out).mass.mass == 20.0
    assert main([*command, "--compare", str(identified), "--json"]) == 0  # the ratios of the other
    account = json.loads(capsys.readouterr().out)
    assert account["comparison"]["agreement"]["degrees_of_freedom"] == 36
    assert account["fit"]["damping_ratios"][0]["value"] == pytest.approx(0.01, rel=1e-6)
    ours = [mode["from_stiffness"]["value"] for mode in account["comparison"]["modes"]]
    assert ours == pytest.approx([mode.natural_frequency for mode in truth.modes], rel=1e-9)

    heavier = truth.inertia.copy()
    heavier[0, 0] *= 1.05
    write_dynamics(identified, CoupledDynamics(COMPONENTS, heavier, truth.damping, covariance))
    with pytest.warns(DataQualityWarning, match="inertia NF/NF departs most"):
        from_stiffness(table, None, mass=mass, ratios=RATIOS, compare=identified)


def test_a_wrong_call_is_said(tmp_path):
    mass, table = written(tmp_path)
    with pytest.raises(ValueError, match="give --ratios, or --compare"):
        from_stiffness(table, None, mass=mass)
    for ratios in ("2", "0.01,0.02", "x", "0.01+-"):
        with pytest.raises(ValueError, match="one or six numbers between 0 and 1"):
            from_stiffness(table, None, mass=mass, ratios=ratios)
