"""Tables and plain data of coupled components, however they were identified."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from aerobalance.app.commands.shared import Result, table_text
from aerobalance.balance.weighing.result import Weighing
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.identification.coupled.combinations import combination_text
from aerobalance.identification.coupled.internal_coordinates import slow_matrices
from aerobalance.identification.coupled.result import CoupledResult
from aerobalance.identification.rigid_body import Departure, RigidMassFit, centre_agreement
from aerobalance.recording.channel import Array
from aerobalance.recording.components import AXES, si_unit


def common_details(found: CoupledResult) -> Result:
    """What every identification of coupled components tells, as plain data."""
    names = found.dynamics.components
    return {
        "half_range": by_component(found.half_range, names),
        "half_range_given": found.half_range_given,
        "modes": [
            {
                "natural_frequency": {"value": mode.natural_frequency, "u": float(u), "unit": "Hz"},
                "damping_ratio": {"value": mode.damping_ratio, "u": float(u_ratio), "unit": "1"},
                "shape_real": shape.real.tolist(),
                "shape_imaginary": shape.imag.tolist(),
                "set_off_by": combination_text(weights, names),
                "static_share": float(found.static_contributions[place]),
                "of_model_or_sting": place in found.further,
            }
            for place, (mode, u, u_ratio, shape, weights) in enumerate(
                zip(
                    found.modes,
                    found.u_natural_frequency,
                    found.u_damping_ratio,
                    found.mode_shapes,
                    found.combinations,
                    strict=True,
                )
            )
        ],
        "residual_standard_deviation": by_component(found.residual_deviation, names),
        "reduced_chi2": dict(zip(names, found.reduced_chi2.tolist(), strict=True)),
        "colour": dict(zip(names, found.colour.tolist(), strict=True)),
        "degrees_of_freedom": found.degrees_of_freedom,
        "force_error": {
            "load": by_component(found.applied, names),
            "band": {"value": list(found.band), "unit": "Hz"},
            "rms": by_component(found.force_error, names),
        },
    }


RIGID_TESTS: Final = {
    "rigidity": "rigid mass on a symmetric stiffness",
    "reciprocity": "symmetric damping",
    "centre_of_gravity": "centre of gravity as weighed",
}
"""Tests of the rigid mass behind A, in words."""


def rigid_tests(rigid: RigidMassFit | None, weighing: Weighing | None) -> dict[str, Departure | None]:
    """Tests of the rigid mass, by the names of `RIGID_TESTS`; none where no mass was found."""
    if rigid is None:
        return {}
    return {
        "rigidity": rigid.rigidity,
        "reciprocity": rigid.reciprocity,
        "centre_of_gravity": centre_test(rigid.mass, weighing),
    }


def tests_details(tests: Mapping[str, Departure | None]) -> Result:
    """The tests that could be made, as plain data."""
    return {
        name: {
            "chi2": test.chi2,
            "degrees_of_freedom": test.degrees_of_freedom,
            "p_value": test.p_value,
            "holds": test.chance,
        }
        for name, test in tests.items()
        if test is not None
    }


def rigid_text(rigid: RigidMassFit | None, weighing: Weighing | None) -> list[str]:
    """The rigid mass and its tests in words, one part; none where no mass was found."""
    if rigid is None:
        return []
    return ["\n".join([mass_text(rigid.mass), *tests_text(rigid_tests(rigid, weighing), RIGID_TESTS)])]


def by_component(values: Array, names: Sequence[str]) -> Result:
    """Loads with their units, by component."""
    return {name: {"value": float(value), "unit": si_unit(name)} for name, value in zip(names, values, strict=True)}


def modes_table(found: CoupledResult) -> str:
    """Modes with their uncertainties and shapes."""
    rows = [
        [
            f"{mode.natural_frequency:.4f}",
            f"{u:.2g}",
            f"{100 * mode.damping_ratio:.4f}",
            f"{100 * u_ratio:.2g}",
            *(f"{part:+.2f}" for part in np.abs(shape) * np.where(shape.real < 0, -1, 1)),
            combination_text(weights, found.dynamics.components),
        ]
        for mode, u, u_ratio, shape, weights in zip(
            found.modes,
            found.u_natural_frequency,
            found.u_damping_ratio,
            found.mode_shapes,
            found.combinations,
            strict=True,
        )
    ]
    heads = ["f0 [Hz]", "u", "damping [%]", "u", *found.dynamics.components, "set off by"]
    return table_text("Modes; shapes and loads over half of range", heads, rows)


def matrices_text(dynamics: CoupledDynamics, half_range: Array | None) -> list[str]:
    """A and D with their uncertainties, a table each; loads over half of range, or in N and N*m where that is None."""
    return [_matrix_table(dynamics, kind, half_range) for kind in ("inertia", "damping")]


def _matrix_table(dynamics: CoupledDynamics, kind: str, half_range: Array | None) -> str:
    """One matrix with its uncertainties; with loads over half of range all elements have one unit."""
    names, n = dynamics.components, len(dynamics.components)
    ratio = np.ones((n, n)) if half_range is None else half_range[None, :] / half_range[:, None]
    inertia, damping, covariance = slow_matrices(dynamics)
    u = np.sqrt(np.diag(covariance)).reshape(2, n, n)[0 if kind == "inertia" else 1] * ratio
    values = (inertia if kind == "inertia" else damping) * ratio
    scale, unit = (1e6, "1e-6 s^2") if kind == "inertia" else (1e6, "1e-6 s")
    rows = []
    for i, name in enumerate(names):
        rows.append([name, *(f"{scale * value:.5g}" for value in values[i])])
        rows.append(["  u", *(f"{scale * value:.2g}" for value in u[i])])
    letter = "A" if kind == "inertia" else "D"
    slow = " of slow motion" if dynamics.internal else ""
    loads = "loads in N and N*m, " if half_range is None else "loads over half of range "
    words = f"elements in {unit}, with m or 1/m between a force and a moment" if half_range is None else f"[{unit}]"
    return table_text(f"{letter} ({kind}){slow}, {loads}{words}", ["", *names], rows)


def error_table(found: CoupledResult) -> str:
    """Force error that the identification leaves."""
    rows = [
        [f"{name} [{si_unit(name)}]", f"{load:.4g}", f"{error:.2g}", f"{100 * error / size:.2g}", f"{chi2:.3f}"]
        for name, load, error, size, chi2 in zip(
            found.dynamics.components,
            found.applied,
            found.force_error,
            found.half_range,
            found.reduced_chi2,
            strict=True,
        )
    ]
    title = f"Force error from the identification alone, under a load white to {found.band[1]:.4g} Hz"
    return table_text(title, ["component", "load rms", "error rms", "% of half range", "reduced chi2"], rows)


def centre_test(mass: RigidMass | None, weighing: Weighing | None) -> Departure | None:
    """Compare the centre of gravity with the one that weighing found; None where one of them is not known."""
    if mass is None or weighing is None or set(weighing.centre_of_gravity) != set(AXES):
        return None
    centre = np.array([weighing.centre_of_gravity[axis] for axis in AXES])
    u = np.array([weighing.u_centre_of_gravity[axis] for axis in AXES])
    return centre_agreement(mass, centre, covariance=np.diag(u**2))


def mass_text(mass: RigidMass) -> str:
    """A rigid mass in words."""
    u = np.sqrt(np.diag(mass.covariance))
    centre = ", ".join(
        f"{axis} {1000 * value:.3f} mm (u = {1000 * u_text:.2g})"
        for axis, value, u_text in zip(AXES, mass.centre, u[1:4], strict=True)
    )
    return f"Rigid mass {mass.mass:.6g} kg, centre of gravity {centre}"


def tests_text(tests: Mapping[str, Departure | None], words: Mapping[str, str]) -> list[str]:
    """Lines that say which tests hold; `words` say what each is."""
    return [
        f"{words[name]}: {'holds' if test.chance else 'does not hold'} (chi2 {test.chi2:.3g} for "
        f"{test.degrees_of_freedom} degrees of freedom)"
        for name, test in tests.items()
        if test is not None
    ]
