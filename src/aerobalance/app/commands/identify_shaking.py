"""Command that identifies coupled components from a shaken ground end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import numpy as np

from aerobalance.app.commands.coupled_tables import (
    by_component,
    centre_test,
    common_details,
    error_table,
    mass_text,
    matrices_text,
    modes_table,
    tests_details,
    tests_text,
)
from aerobalance.app.commands.identify_coupled import weighed_mass, written_result
from aerobalance.app.commands.shared import Result, check_out, collected_warnings, recording_of, table_text
from aerobalance.app.commands.weighing import mass_file
from aerobalance.balance.weighing.result import Weighing
from aerobalance.identification.base_excitation.shaking_result import ShakingIdentification
from aerobalance.identification.identify import identify
from aerobalance.identification.rigid_body import Departure
from aerobalance.motion.sensors import motion_name
from aerobalance.recording.components import COMPONENTS, MOMENTS


def identify_shaken(
    paths: Sequence[Path],
    out: Path | None,
    *,
    mass: str | None = None,
    half_range: Mapping[str, float] | None = None,
    channel_map: Path | None = None,
) -> Result:
    """A, D and the mass of coupled components, from recordings with a shaken ground end.

    Parameters
    ----------
    paths
        The recordings.
    out
        dynamics.json to write, or None.
    mass
        Weighed mass: a number [kg] or mass.json; None takes it from the shaking alone.
    half_range
        Half of range by component [N, N*m]; None takes the largest change of load in the recordings.
    channel_map
        Channel map of the recordings.
    """
    check_out(out, *paths, channel_map, mass_file(mass), kind="dynamics")
    weighed, weighing = weighed_mass(mass)
    with collected_warnings() as collected:
        recordings = [recording_of(path, channel_map) for path in paths]
        fit = identify(recordings, components=COMPONENTS, excitation="base", mass=weighed, half_range=half_range)
        found = cast("ShakingIdentification", fit)
    return written_result(
        found,
        out,
        details=_details(found, weighing),
        summary=_summary(found, weighing),
        inputs=[*paths, channel_map, mass_file(mass)],
        settings={"mass": mass, "half_range": half_range},
        doubted=collected,
    )


def motion_unit(component: str) -> str:
    """Unit of the ground's motion that goes with a component."""
    return "rad/s^2" if component in MOMENTS else "m/s^2"


def _details(found: ShakingIdentification, weighing: Weighing | None) -> Result:
    """How the fit went, as plain data."""
    names = found.dynamics.components
    return {
        "method": "shaken ground end, all components together, maximum likelihood with noise in loads and motion",
        **common_details(found),
        "shakes": [
            {
                "recording": shake.name,
                "duration": {"value": shake.duration, "unit": "s"},
                "band": {"value": list(shake.band), "unit": "Hz"},
                "motion": {
                    name: {"rms": float(rms), "unit": motion_unit(name), "seen": name in shake.seen}
                    for name, rms in zip(names, shake.motion_rms, strict=True)
                },
                "visibility": shake.visibility.tolist(),
                "share_under_the_window": shake.share,
            }
            for shake in found.shakes
        ],
        "delay": {"value": found.delay[0], "u": found.delay[1], "unit": "s"},
        "mass_from_symmetry": found.rigid.from_symmetry,
        "further_shake": {
            "motion": found.advice.best,
            "duration": {"value": found.advice.duration, "unit": "s"},
            "rms": {
                name: {"value": float(size), "unit": motion_unit(name)}
                for name, size in zip(names, found.advice.sizes, strict=True)
            },
            "force_error": {
                name: by_component(errors, names) for name, errors in zip(names, found.advice.errors, strict=True)
            },
        },
        "tests": tests_details(_tests(found, weighing)),
    }


def _tests(found: ShakingIdentification, weighing: Weighing | None) -> dict[str, Departure | None]:
    rigid = found.rigid
    return {
        "rigidity": rigid.rigidity,
        "symmetry": rigid.symmetry,
        "reciprocity": rigid.reciprocity,
        "mass": rigid.weighed,
        "centre_of_gravity": centre_test(rigid.mass, weighing),
    }


_WORDS = {
    "rigidity": "loads under the ground's motion as of a rigid mass",
    "symmetry": "symmetric stiffness",
    "reciprocity": "symmetric damping",
    "mass": "mass as weighed",
    "centre_of_gravity": "centre of gravity as weighed",
}


def _summary(found: ShakingIdentification, weighing: Weighing | None) -> str:
    """Tables for people: modes, matrices, records, what they leave, and what would help."""
    place = COMPONENTS.index(found.advice.best)
    lines = [] if found.rigid.mass is None else [mass_text(found.rigid.mass)]
    lines += tests_text(_tests(found, weighing), _WORDS)
    lines.append(f"loads behind the ground's motion: {1e6 * found.delay[0]:.3g} us (u = {1e6 * found.delay[1]:.2g})")
    help_text = (
        f"One shake more would help most in the ground's {motion_name(place)} ({found.advice.sizes[place]:.3g} "
        f"{motion_unit(found.advice.best)} rms over {found.advice.duration:.3g} s)."
    )
    parts = [
        modes_table(found),
        *matrices_text(found.dynamics, found.half_range),
        _shakes_table(found),
        error_table(found),
        help_text,
        "\n".join(lines),
    ]
    return "\n\n".join(parts) + "\n"


def _shakes_table(found: ShakingIdentification) -> str:
    heads = ["record", "band [Hz]", *(f"{name} [{motion_unit(name)}]" for name in COMPONENTS), "weakest mode"]
    rows = [
        [
            shake.name,
            f"{shake.band[0]:.3g}-{shake.band[1]:.4g}",
            *(
                f"{rms:.3g}" if name in shake.seen else "-"
                for name, rms in zip(COMPONENTS, shake.motion_rms, strict=True)
            ),
            f"{found.modes[int(np.argmin(shake.visibility))].natural_frequency:.4g} Hz",
        ]
        for shake in found.shakes
    ]
    return table_text("Records, and the rms of the ground's motion in each", heads, rows)
