"""Command that takes dynamics from poles and shapes that another program has found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from aerobalance.app.commands.identify import identified
from aerobalance.app.commands.identify_coupled import weighed_mass
from aerobalance.app.commands.shared import (
    Result,
    check_out,
    collected_warnings,
    known_component,
    table_text,
)
from aerobalance.app.commands.weighing import mass_file, parse_mass
from aerobalance.identification.from_modes import dynamics_of_modes, one_of_pole
from aerobalance.io.coupled_part import coupled_payload
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.io.modal_uff import ReadModes, read_modes
from aerobalance.recording.components import COMPONENTS


def identify_modes(
    path: Path,
    out: Path | None,
    *,
    component: str = "AF",
    mass: str | None = None,
    take: Sequence[int] = (),
) -> Result:
    """Dynamics from the poles and shapes that a modal program found.

    Parameters
    ----------
    path
        Universal file with datasets 55.
    out
        dynamics.json to write, or None.
    component
        The component, or all.
    mass
        Moving mass: a number [kg] or mass.json; None leaves the mass matrix of all components out.
    take
        Numbers of the modes that are taken, the slowest 1; all where left out.
    """
    check_out(out, path, mass_file(mass), kind="dynamics")
    if component != "all":
        known_component(component)
        if mass is None:
            raise ValueError("Missing option '--mass': a pole tells mass over stiffness only")
    modes = _taken(read_modes(path), take)
    listed = ", ".join(f"{abs(pole) / (2 * np.pi):.4g}" for pole in modes.poles)
    with collected_warnings() as collected:
        if component != "all":
            if modes.poles.size != 1:
                raise ValueError(
                    f"one component has one mode here; {path} has {modes.poles.size} ({listed} Hz): choose one with "
                    "--mode 1 (the slowest) and so on"
                )
            weighed = parse_mass(mass or "", component)
            single = one_of_pole(complex(modes.poles[0]), component, mass=weighed or 0.0)
            details = {"method": "pole of a modal program"}
            return identified(path, out, single, details, mass=mass, collected=collected)
        weighed, _ = weighed_mass(mass)
        dynamics, rigid = dynamics_of_modes(modes.poles, modes.shapes, mass=weighed)
    if rigid is not None:
        dynamics = replace(dynamics, mass=rigid.mass)
    details = {"method": "poles and shapes of a modal program"}
    if out is not None:
        inputs = [path, *(file for file in (mass_file(mass),) if file is not None)]
        settings = {"mass": mass if mass_file(mass) is None else Path(str(mass)).name, "components": list(COMPONENTS)}
        write_dynamics(out, dynamics, details=details, inputs=inputs, settings=settings, warnings=collected)
    rows = [[f"{mode.natural_frequency:.4f}", f"{100 * mode.damping_ratio:.4f}"] for mode in dynamics.modes]
    text = table_text(f"{path.name}: six components of its modes", ["f0 [Hz]", "damping [%]"], rows)
    return {**coupled_payload(dynamics), "fit": details, "summary": text + "\n", "warnings": collected}


def _taken(modes: ReadModes, take: Sequence[int]) -> ReadModes:
    """The modes that are wanted."""
    if not take:
        return modes
    wrong = [number for number in take if not 1 <= number <= modes.poles.size]
    if wrong or len(set(take)) < len(take):
        raise ValueError(f"--mode must be numbers from 1 to {modes.poles.size}, each once, not {list(take)}")
    places = [number - 1 for number in take]
    return ReadModes(modes.poles[places], modes.shapes[places])
