"""Command that works out coupled dynamics from mass, inertia and stiffness, and compares them with identified ones."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.app.commands.coupled_tables import mass_text, matrices_text, tests_details, tests_text
from aerobalance.app.commands.shared import Result, check_out, collected_warnings, table_text
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.coupled.modes import ModeTable
from aerobalance.identification.from_stiffness import (
    ElementDifference,
    agreement,
    compare_coupled,
    coupled_from_stiffness,
)
from aerobalance.identification.rigid_body import Departure
from aerobalance.io.coupled_part import coupled_payload
from aerobalance.io.dynamics_file import read_coupled, write_dynamics
from aerobalance.io.stiffness_file import read_rigid_mass, read_stiffness
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import warn_quality

SHOWN: Final = 6
"""Elements that are shown, those that depart most."""

ONE: Final = np.ones(6)


def from_stiffness(
    table: Path,
    out: Path | None,
    *,
    mass: Path,
    ratios: str | None = None,
    compare: Path | None = None,
) -> Result:
    """A = M K^-1 and D from a rigid mass, a stiffness and damping ratios, beside dynamics identified.

    Parameters
    ----------
    table
        Stiffness matrix, as `read_stiffness` takes it.
    out
        dynamics.json to write, or None.
    mass
        Mass, centre of gravity and inertia, as `read_rigid_mass` takes them.
    ratios
        Damping ratio of all modes, or of each, by commas, with ``+-`` and its standard uncertainty where known; None
        takes those of `compare`.
    compare
        dynamics.json of releases or of shaking, or None.
    """
    check_out(out, table, mass, compare, kind="dynamics")
    with collected_warnings() as collected:
        stiffness, u_stiffness = read_stiffness(table)
        rigid = read_rigid_mass(mass)
        identified = None if compare is None else read_coupled(compare)
        values, u_values = _ratios(ratios, identified)
        found = coupled_from_stiffness(
            stiffness, rigid, damping_ratios=values, u_stiffness=u_stiffness, u_damping_ratios=u_values
        )
        differences = () if identified is None else compare_coupled(found, identified)
        test = None if identified is None else agreement(found, identified, damping=ratios is not None)
        if test is not None and not test.chance:
            worst = _worst(differences, damping=ratios is not None)[0]
            warn_quality(
                f"{compare}: the dynamics identified are not those of this mass and stiffness (chi2 {test.chi2:.3g} "
                f"for {test.degrees_of_freedom} degrees of freedom); {worst.name} departs most, by "
                f"{worst.ratio:+.1f} standard uncertainties"
            )
    details = {"method": "rigid mass on a measured stiffness", "damping_ratios": _ratio_details(values, u_values)}
    inputs = [file for file in (table, mass, compare) if file is not None]
    if out is not None:
        settings = {"ratios": ratios}
        write_dynamics(out, found, details=details, inputs=inputs, settings=settings, warnings=collected)
    result = {**coupled_payload(found), "fit": details, "warnings": collected}
    if identified is not None:
        result["comparison"] = _comparison(found, identified, differences, test)
    result["summary"] = _summary(found, identified, differences, test, damping=ratios is not None)
    return result


def _ratios(text: str | None, identified: CoupledDynamics | None) -> tuple[Array, Array]:
    """Damping ratios of the six modes and their standard uncertainties.

    Raises
    ------
    ValueError
        There are none, or the text is not one or six of them.
    """
    if text is None:
        if identified is None:
            raise ValueError(
                "damping does not follow from stiffness and mass: give --ratios, or --compare to take them"
            )
        table = ModeTable.of(identified, sizes=np.ones(len(identified.components)))
        return np.array([mode.damping_ratio for mode in table.modes])[:6], table.u_damping_ratio[:6]
    pairs = [re.fullmatch(r"\s*([^\s+]+?)\s*(?:(?:\+-|\u00b1)\s*(\S+))?\s*", part) for part in text.split(",")]
    try:
        found = [(float(pair[1]), float(pair[2] or 0)) for pair in pairs if pair is not None]
    except ValueError:
        found = []
    if len(found) != len(pairs) or len(found) not in (1, 6) or not all(0 < v < 1 and 0 <= u < 1 for v, u in found):
        raise ValueError(
            f"--ratios must be one or six numbers between 0 and 1, like 0.01 or 0.01+-0.002, not {text!r}"
        )
    values, u = np.array(found).T
    return values * ONE, u * ONE


def _ratio_details(values: Array, u: Array) -> list[Result]:
    return [{"value": float(v), "u": float(d), "unit": "1"} for v, d in zip(values, u, strict=True)]


def _worst(differences: tuple[ElementDifference, ...], *, damping: bool) -> list[ElementDifference]:
    """The elements that depart most first."""
    kept = [item for item in differences if damping or item.name.startswith("inertia")]
    return sorted(kept, key=lambda item: -abs(np.nan_to_num(item.ratio)))


def _comparison(
    found: CoupledDynamics,
    identified: CoupledDynamics,
    differences: tuple[ElementDifference, ...],
    test: Departure | None,
) -> Result:
    ours, theirs = (ModeTable.of(one, sizes=ONE) for one in (found, identified))
    return {
        "agreement": tests_details({"agreement": test}).get("agreement"),
        "elements": [
            {
                "name": item.name,
                "from_stiffness": item.first,
                "identified": item.second,
                "u_difference": item.u,
                "ratio": None if np.isnan(item.ratio) else item.ratio,
            }
            for item in differences
        ],
        "modes": [
            {
                "from_stiffness": {"value": first.natural_frequency, "u": float(u), "unit": "Hz"},
                "identified": {"value": second.natural_frequency, "u": float(v), "unit": "Hz"},
            }
            for first, u, second, v in zip(
                ours.modes, ours.u_natural_frequency, theirs.modes, theirs.u_natural_frequency, strict=True
            )
        ],
    }


def _summary(
    found: CoupledDynamics,
    identified: CoupledDynamics | None,
    differences: tuple[ElementDifference, ...],
    test: Departure | None,
    *,
    damping: bool,
) -> str:
    """Tables for people."""
    parts = [
        _modes_text(found, identified),
        *matrices_text(found, None),
    ]
    if found.mass is not None:
        parts.append(mass_text(found.mass))
    if identified is not None:
        if identified.mass is not None:
            parts.append(f"Identified: {mass_text(identified.mass)}")
        rows = [
            [item.name, f"{item.first:.5g}", f"{item.second:.5g}", f"{item.u:.2g}", f"{item.ratio:+.2f}"]
            for item in _worst(differences, damping=damping)[:SHOWN]
        ]
        heads = ["element", "from stiffness", "identified", "u of difference", "over u"]
        parts.append(table_text("Elements that depart most", heads, rows))
        word = "A and D as identified" if damping else "A as identified"
        parts.append("\n".join(tests_text({"agreement": test}, {"agreement": word})))
    return "\n\n".join(part for part in parts if part) + "\n"


def _modes_text(found: CoupledDynamics, identified: CoupledDynamics | None) -> str:
    ours = ModeTable.of(found, sizes=ONE)
    heads, rows = ["f0 [Hz]", "u", "damping [%]", "u"], []
    theirs = None if identified is None else ModeTable.of(identified, sizes=ONE)
    for place, mode in enumerate(ours.modes):
        row = [
            f"{mode.natural_frequency:.4f}",
            f"{ours.u_natural_frequency[place]:.2g}",
            f"{100 * mode.damping_ratio:.4f}",
            f"{100 * ours.u_damping_ratio[place]:.2g}",
        ]
        if theirs is not None:
            other = theirs.modes[place]
            u = float(np.hypot(ours.u_natural_frequency[place], theirs.u_natural_frequency[place]))
            apart = (other.natural_frequency - mode.natural_frequency) / u if u > 0 else np.nan
            row += [
                f"{other.natural_frequency:.4f}",
                f"{theirs.u_natural_frequency[place]:.2g}",
                f"{100 * other.damping_ratio:.4f}",
                f"{apart:+.2f}",
            ]
        rows.append(row)
    if theirs is not None:
        heads += ["identified [Hz]", "u", "damping [%]", "apart, over u"]
    return table_text("Modes", heads, rows)
