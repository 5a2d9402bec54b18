"""Command that identifies coupled components, from several releases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.coupled_tables import (
    by_component,
    common_details,
    error_table,
    matrices_text,
    modes_table,
    rigid_tests,
    rigid_text,
    tests_details,
)
from aerobalance.app.commands.identify import number_of_modes
from aerobalance.app.commands.shared import Result, amounts, check_out, collected_warnings, recording_of, table_text
from aerobalance.app.commands.weighing import mass_file, mass_number
from aerobalance.balance.weighing.result import Weighing
from aerobalance.identification.coupled.result import CoupledResult
from aerobalance.identification.identify import identify
from aerobalance.identification.step_relaxation.release_result import CoupledIdentification
from aerobalance.io.artefacts import digest
from aerobalance.io.coupled_part import coupled_payload
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.io.mass_file import read_masses, read_weighing
from aerobalance.recording.components import COMPONENTS, MOMENTS, si_unit
from aerobalance.recording.errors import ReadError


def identify_decays(
    paths: Sequence[Path],
    out: Path | None,
    *,
    mass: str | None = None,
    components: Sequence[str] = COMPONENTS,
    half_range: Mapping[str, float] | None = None,
    modes: str = "auto",
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
) -> Result:
    """A and D of coupled components, from a release in every recording.

    Parameters
    ----------
    paths
        The recordings.
    out
        dynamics.json to write, or None.
    mass
        Weighed mass: a number [kg] or mass.json; None leaves the mass matrix out.
    components
        Coupled components.
    half_range
        Half of range by component [N, N*m]; None takes the largest change of load in the recordings.
    modes
        Number of modes, one for each component or more; auto takes those that the decays show.
    files
        Balance matrix, zeros and tares, where the recordings hold gauge outputs; None where they hold loads.
    channel_map
        Channel map of the recordings.
    """
    wanted = number_of_modes(modes)
    used = [channel_map, mass_file(mass), *(() if files is None else files.paths)]
    check_out(out, *paths, *used, kind="dynamics")
    weighed, weighing = weighed_mass(mass)
    with collected_warnings() as collected:
        recordings = [recording_of(path, channel_map) for path in paths]
        loads = None
        if files is not None:
            loads = files.identification_loads(recordings, weighing, channel_map=channel_map)
        fit = identify(loads or recordings, components=components, mass=weighed, half_range=half_range, modes=wanted)
        found = cast("CoupledIdentification", fit)
    if files is not None:
        found = replace(found, dynamics=replace(found.dynamics, balance=digest(files.balance)))
    return written_result(
        found,
        out,
        details=_details(found, weighing),
        summary=summary(found, weighing),
        inputs=[*paths, *used],
        settings={"mass": mass, "half_range": half_range, "modes": modes},
        doubted=collected,
    )


def written_result(
    found: CoupledResult,
    out: Path | None,
    *,
    details: Result,
    summary: str,
    inputs: Sequence[Path | None],
    settings: Mapping[str, Any],
    doubted: Sequence[str],
) -> Result:
    """Write dynamics.json where it is wanted, and tell what was found.

    Parameters
    ----------
    found
        What was found.
    out
        dynamics.json to write, or None.
    details, summary
        How the fit went, as plain data and as tables for people.
    inputs
        Files that were read; None where one was not given.
    settings
        Options of the command, the mass as it was given.
    doubted
        What was doubted on the way.
    """
    if out is not None:
        mass, half_range = settings["mass"], settings["half_range"]
        kept = {
            "components": list(found.dynamics.components),
            **settings,
            "mass": mass if mass_file(mass) is None else Path(mass).name,
            "half_range": None if half_range is None else dict(half_range),
        }
        files = [file for file in inputs if file is not None]
        write_dynamics(out, found.dynamics, details=details, inputs=files, settings=kept, warnings=doubted)
    return {**coupled_payload(found.dynamics), "fit": details, "summary": summary, "warnings": doubted}


def half_ranges(texts: Sequence[str]) -> dict[str, float] | None:
    """Half range by component from the command line: ``NF=2000`` each; None for none.

    Raises
    ------
    ValueError
        A text is no component with a positive number, or a component is missing.
    """
    found = amounts(texts, "--half-range")
    if not isinstance(found, dict):
        if found is not None:
            raise ValueError(f"--half-range must be given by component, such as NF=2000, not {found:g} for all")
        return None
    lacking = [name for name in COMPONENTS if name not in found]
    if lacking:
        raise ValueError(f"--half-range is given for {', '.join(found)}; {', '.join(lacking)} are needed too")
    return found


def weighed_mass(mass: str | None) -> tuple[tuple[float, float] | None, Weighing | None]:
    """Mass with its uncertainty, and the weighing that it comes from where there is one.

    Raises
    ------
    ValueError
        It is neither a positive number nor a file that holds the mass of a force component.
    """
    if mass is None:
        return None, None
    value = mass_number(mass)
    if value is not None:
        return (value, 0.0), None
    try:
        weighing = read_weighing(Path(mass))
    except ReadError:
        masses = {name: found for name, found in read_masses(Path(mass)).items() if name not in MOMENTS}
        if not masses:
            raise ValueError(f"{mass} holds no mass of a force component") from None
        found = min(masses.values(), key=lambda one: one.u)
        return (found.mass, found.u), None
    return (weighing.mass, weighing.u_mass), weighing


def _details(found: CoupledIdentification, weighing: Weighing | None) -> Result:
    """How the fit went, as plain data."""
    names = found.dynamics.components
    details: Result = {
        "method": "free decays of all components together, maximum likelihood",
        **common_details(found),
        "releases": [
            {
                "recording": release.name,
                "kind": release.kind,
                "instant": {"value": release.instant, "u": release.u_instant, "unit": "s"},
                "duration": {"value": release.duration, "unit": "s"},
                "step": None if np.isnan(release.step).any() else by_component(release.step, names),
                "shares": release.shares.tolist(),
            }
            for release in found.releases
        ],
        "further_release": {
            "component": found.advice.best,
            "size": by_component(found.advice.sizes, names),
            "force_error": {
                name: by_component(errors, names) for name, errors in zip(names, found.advice.errors, strict=True)
            },
        },
    }
    if found.rigid is not None:
        details["tests"] = tests_details(rigid_tests(found.rigid, weighing))
    return details


def summary(found: CoupledIdentification, weighing: Weighing | None = None) -> str:
    """Tables for people: modes, matrices, releases, what they leave, and what would help."""
    names = found.dynamics.components
    parts = [
        modes_table(found) + _further_text(found),
        *matrices_text(found.dynamics, found.half_range),
        _releases_table(found),
        error_table(found),
    ]
    best = names.index(found.advice.best)
    parts.append(
        f"One release more would help most along {found.advice.best} "
        f"({found.advice.sizes[best]:.3g} {si_unit(found.advice.best)})."
    )
    if found.dynamics.covariance_of_calibration.any():
        parts.append(
            "The uncertainties contain what the calibration of the balance leaves. The force error does not: force "
            "counts the\nbalance matrix on its own."
        )
    return "\n\n".join([*parts, *rigid_text(found.rigid, weighing)]) + "\n"


def _further_text(found: CoupledIdentification) -> str:
    """Which modes are of the model or sting, and where they show."""
    names = found.dynamics.components
    lines = [
        f"\n{found.modes[place].natural_frequency:.4g} Hz: mode of the model or sting, "
        f"{100 * found.static_contributions[place]:.2g} % of the balance loads at rest, most in "
        + ", ".join(names[number] for number in np.argsort(-np.abs(found.mode_shapes[place]))[:2])
        for place in found.further
    ]
    if lines:
        lines.append("\nA and D have rows and columns of internal coordinates for it, which dynamics.json holds.")
    return "".join(lines)


def _releases_table(found: CoupledIdentification) -> str:
    heads = ["release", "kind", "instant [s]", *(f"{mode.natural_frequency:.4g} Hz" for mode in found.modes)]
    rows = [
        [release.name, release.kind, f"{release.instant:.6f}", *(f"{100 * share:.2g} %" for share in release.shares)]
        for release in found.releases
    ]
    return table_text("Releases, and the share with which each sets off every mode", heads, rows)
