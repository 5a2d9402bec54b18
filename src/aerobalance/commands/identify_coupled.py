"""Command that identifies components that ring together, from several releases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from aerobalance.channel import Array
from aerobalance.commands.shared import Account, check_out, doubts, recording_of, table_text
from aerobalance.commands.weighing import mass_file
from aerobalance.components import COMPONENTS, MOMENTS, si_unit
from aerobalance.identification.coupled_identification import CoupledIdentification
from aerobalance.identification.mass_matrix import Departure, centre_agreement
from aerobalance.identification.release_advice import combination_text
from aerobalance.identification.releases import identify_releases
from aerobalance.io.coupled_file import coupled_payload, write_coupled
from aerobalance.io.mass_file import read_mass
from aerobalance.io.weighing_file import read_weighing
from aerobalance.problems import ReadError
from aerobalance.weighing.result import Weighing


def identify_decays(
    paths: Sequence[Path],
    out: Path | None,
    *,
    mass: str | None = None,
    components: Sequence[str] = COMPONENTS,
    half_range: Mapping[str, float] | None = None,
    channel_map: Path | None = None,
) -> Account:
    """A and D of components that ring together, from a release in every recording.

    Parameters
    ----------
    paths
        The recordings.
    out
        dynamics.json to write, or None.
    mass
        Weighed mass: a number [kg] or mass.json; None leaves the mass matrix out.
    components
        Components that ring together.
    half_range
        Half of range by component [N, N*m]; None takes the largest change of load in the recordings.
    channel_map
        Channel map of the recordings.
    """
    check_out(out, *paths, channel_map, mass_file(mass))
    weighed, weighing = _weighed(mass)
    with doubts() as collected:
        recordings = [recording_of(path, channel_map) for path in paths]
        found = identify_releases(recordings, components=components, mass=weighed, half_range=half_range)
    details = _details(found, weighing)
    if out is not None:
        inputs = [*paths, *(file for file in (channel_map, mass_file(mass)) if file is not None)]
        settings = {
            "components": list(found.dynamics.components),
            "mass": mass if mass_file(mass) is None else Path(str(mass)).name,
            "half_range": None if half_range is None else dict(half_range),
        }
        write_coupled(out, found.dynamics, details=details, inputs=inputs, settings=settings, warnings=collected)
    return {
        **coupled_payload(found.dynamics),
        "fit": details,
        "summary": summary(found, weighing),
        "warnings": collected,
    }


def half_ranges(texts: Sequence[str]) -> dict[str, float] | None:
    """Half range by component from the command line: ``NF=2000`` each; None for none.

    Raises
    ------
    ValueError
        A text is no component with a positive number, or a component is missing.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if name not in COMPONENTS or not 0 < value < np.inf:
            raise ValueError(
                f"--half-range must be like NF=2000, a component of {', '.join(COMPONENTS)}, not {text!r}"
            )
        found[name] = value
    lacking = [name for name in COMPONENTS if name not in found]
    if found and lacking:
        raise ValueError(f"--half-range is given for {', '.join(found)}; {', '.join(lacking)} are needed too")
    return found or None


def _weighed(mass: str | None) -> tuple[tuple[float, float] | None, Weighing | None]:
    """Mass with its uncertainty, and the weighing that it comes from where there is one.

    Raises
    ------
    ValueError
        It is neither a positive number nor a file that holds the mass of a force component.
    """
    if mass is None:
        return None, None
    try:
        value = float(mass)
    except ValueError:
        try:
            weighing = read_weighing(Path(mass))
        except ReadError:
            masses = {name: found for name, found in read_mass(Path(mass)).items() if name not in MOMENTS}
            if not masses:
                raise ValueError(f"{mass} holds no mass of a force component") from None
            found = min(masses.values(), key=lambda one: one.u)
            return (found.mass, found.u), None
        return (weighing.mass, weighing.u_mass), weighing
    if not 0 < value < np.inf:
        raise ValueError(f"--mass must be a positive number or a mass.json, not {mass}")
    return (value, 0.0), None


def _details(found: CoupledIdentification, weighing: Weighing | None) -> Account:
    """How the fit went, as plain data."""
    names = found.dynamics.components
    details: Account = {
        "method": "free decays of all components together, maximum likelihood",
        "half_range": _by_component(found.half_range, names),
        "half_range_given": found.half_range_given,
        "modes": [
            {
                "natural_frequency": {"value": mode.natural_frequency, "u": float(u), "unit": "Hz"},
                "damping_ratio": {"value": mode.damping_ratio, "u": float(u_ratio), "unit": "1"},
                "shape_real": shape.real.tolist(),
                "shape_imaginary": shape.imag.tolist(),
                "set_off_by": combination_text(weights, names),
            }
            for mode, u, u_ratio, shape, weights in zip(
                found.modes,
                found.u_natural_frequency,
                found.u_damping_ratio,
                found.mode_shapes,
                found.combinations,
                strict=True,
            )
        ],
        "releases": [
            {
                "recording": release.name,
                "kind": release.kind,
                "instant": {"value": release.instant, "u": release.u_instant, "unit": "s"},
                "duration": {"value": release.duration, "unit": "s"},
                "step": None if np.isnan(release.step).any() else _by_component(release.step, names),
                "shares": release.shares.tolist(),
            }
            for release in found.releases
        ],
        "residual_standard_deviation": _by_component(found.residual_deviation, names),
        "reduced_chi2": dict(zip(names, found.reduced_chi2.tolist(), strict=True)),
        "colour": dict(zip(names, found.colour.tolist(), strict=True)),
        "degrees_of_freedom": found.degrees_of_freedom,
        "force_error": {
            "load": _by_component(found.applied, names),
            "band": {"value": list(found.band), "unit": "Hz"},
            "rms": _by_component(found.force_error, names),
        },
        "further_release": {
            "component": found.advice.best,
            "size": _by_component(found.advice.sizes, names),
            "force_error": {
                name: _by_component(errors, names) for name, errors in zip(names, found.advice.errors, strict=True)
            },
        },
    }
    if found.rigid is not None:
        tests = {"rigidity": found.rigid.rigidity, "reciprocity": found.rigid.reciprocity}
        if weighing is not None and set(weighing.centre_of_gravity) == {"aft", "right", "up"}:
            tests["centre_of_gravity"] = _centre_test(found, weighing)
        details["tests"] = {name: _test(test) for name, test in tests.items() if test is not None}
    return details


def _centre_test(found: CoupledIdentification, weighing: Weighing) -> Departure | None:
    """Compare the centre of gravity with the one that weighing found."""
    if found.rigid is None:
        return None
    axes = ("aft", "right", "up")
    centre = np.array([weighing.centre_of_gravity[axis] for axis in axes])
    u = np.array([weighing.u_centre_of_gravity[axis] for axis in axes])
    return centre_agreement(found.rigid.mass, centre, covariance=np.diag(u**2))


def _test(test: Departure) -> Account:
    return {
        "chi2": test.chi2,
        "degrees_of_freedom": test.degrees_of_freedom,
        "p_value": test.p_value,
        "holds": test.chance,
    }


def _by_component(values: Array, names: Sequence[str]) -> Account:
    return {name: {"value": float(value), "unit": si_unit(name)} for name, value in zip(names, values, strict=True)}


def summary(found: CoupledIdentification, weighing: Weighing | None = None) -> str:
    """Tables for people: modes, matrices, releases, what they leave, and what would help."""
    names = found.dynamics.components
    parts = [
        _modes_table(found),
        _matrix_table(found, "inertia"),
        _matrix_table(found, "damping"),
        _releases_table(found),
        _error_table(found),
    ]
    best = names.index(found.advice.best)
    parts.append(
        f"One release more would help most along {found.advice.best} "
        f"({found.advice.sizes[best]:.3g} {si_unit(found.advice.best)})."
    )
    if found.rigid is not None:
        parts.append(_mass_text(found, weighing))
    return "\n\n".join(parts) + "\n"


def _modes_table(found: CoupledIdentification) -> str:
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


def _matrix_table(found: CoupledIdentification, kind: str) -> str:
    """One matrix with its uncertainties; loads over half of range, so that all elements have one unit."""
    dynamics = found.dynamics
    names, n = dynamics.components, len(dynamics.components)
    ratio = found.half_range[None, :] / found.half_range[:, None]
    first = 0 if kind == "inertia" else n * n
    u = np.sqrt(np.diag(dynamics.covariance))[first : first + n * n].reshape(n, n) * ratio
    values = (dynamics.inertia if kind == "inertia" else dynamics.damping) * ratio
    scale, unit = (1e6, "1e-6 s^2") if kind == "inertia" else (1e6, "1e-6 s")
    rows = []
    for i, name in enumerate(names):
        rows.append([name, *(f"{scale * value:.5g}" for value in values[i])])
        rows.append(["  u", *(f"{scale * value:.2g}" for value in u[i])])
    letter = "A" if kind == "inertia" else "D"
    return table_text(f"{letter} ({kind}), loads over half of range [{unit}]", ["", *names], rows)


def _releases_table(found: CoupledIdentification) -> str:
    heads = ["release", "kind", "instant [s]", *(f"{mode.natural_frequency:.4g} Hz" for mode in found.modes)]
    rows = [
        [release.name, release.kind, f"{release.instant:.6f}", *(f"{100 * share:.2g} %" for share in release.shares)]
        for release in found.releases
    ]
    return table_text("Releases, and the share with which each sets off every mode", heads, rows)


def _error_table(found: CoupledIdentification) -> str:
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


def _mass_text(found: CoupledIdentification, weighing: Weighing | None) -> str:
    """The rigid mass and its tests in words."""
    if found.rigid is None:
        return ""
    mass = found.rigid.mass
    u = np.sqrt(np.diag(mass.covariance))
    centre = ", ".join(
        f"{axis} {1000 * value:.3f} mm (u = {1000 * doubt:.2g})"
        for axis, value, doubt in zip(("aft", "right", "up"), mass.centre, u[1:4], strict=True)
    )
    lines = [f"Rigid mass {mass.mass:.6g} kg, centre of gravity {centre}"]
    tests = [
        ("rigid mass on a symmetric stiffness", found.rigid.rigidity),
        ("symmetric damping", found.rigid.reciprocity),
    ]
    if weighing is not None and set(weighing.centre_of_gravity) == {"aft", "right", "up"}:
        tests.append(("centre of gravity as weighed", _centre_test(found, weighing)))
    for name, test in tests:
        if test is not None:
            verdict = "holds" if test.chance else "does not hold"
            lines.append(f"{name}: {verdict} (chi2 {test.chi2:.3g} for {test.degrees_of_freedom} degrees of freedom)")
    return "\n".join(lines)
