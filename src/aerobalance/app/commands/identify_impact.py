"""Command that identifies dynamics from taps with an instrumented hammer, or from a shaker."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, cast

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
from aerobalance.app.commands.doubts import doubt_result
from aerobalance.app.commands.identify import CALIBRATION_DROPS_OUT, identified, number_of_modes
from aerobalance.app.commands.identify_coupled import weighed_mass, written_result
from aerobalance.app.commands.shared import (
    Result,
    check_out,
    collected_warnings,
    known_component,
    recording_of,
    table_text,
)
from aerobalance.app.commands.weighing import mass_file, parse_mass
from aerobalance.balance.weighing.result import Weighing
from aerobalance.identification.identify import identify
from aerobalance.identification.impact.tap_point import U_DIRECTION, U_PLACE, TapPoint, point_of
from aerobalance.identification.impact.tap_result import ImpactFit, ImpactIdentification, Taps
from aerobalance.io.artefacts import digest
from aerobalance.io.modal_uff import WrittenResponse, write_responses
from aerobalance.recording.components import AXIS_VECTORS, COMPONENTS, DIRECTIONS, MOMENTS
from aerobalance.recording.errors import FitError

WAYS: Final[Mapping[str, tuple[float, float, float]]] = {
    **AXIS_VECTORS,
    "forward": (-1.0, 0.0, 0.0),
    "left": (0.0, -1.0, 0.0),
    "down": (0.0, 0.0, -1.0),
}
"""Directions by name."""


def tap_points(
    at: Sequence[str],
    direction: Sequence[str],
    *,
    count: int,
    u_at: float | None,
    u_direction: float | None,
) -> list[TapPoint | None]:
    """Return where the taps of every recording were given, as the command line says it; None where it does not.

    Parameters
    ----------
    at, direction
        Texts such as ``0.1,0,0.05`` and ``0,0,-1`` or ``down``: none, one for all, or one for each recording.
    count
        Number of recordings.
    u_at, u_direction
        Standard uncertainties [m] and [deg]; None for the usual ones.

    Raises
    ------
    ValueError
        A text is no point or direction, or there are as many as neither one nor the recordings.
    """
    if not at and not direction:
        if u_at is not None or u_direction is not None:
            raise ValueError("--u-at and --u-direction go with --at and --direction")
        return [None] * count
    for name, texts in (("--at", at), ("--direction", direction)):
        if len(texts) not in (1, count):
            raise ValueError(
                f"{name} is given once for all recordings, or once for each of {count} in their order, not "
                f"{len(texts)} times; a point needs both --at and --direction"
            )
    u_turn = U_DIRECTION if u_direction is None else float(np.deg2rad(u_direction))
    u_place = U_PLACE if u_at is None else u_at
    places = [_numbers(text, "--at") for text in at]
    ways = [_way(text) for text in direction]
    places, ways = (part * count if len(part) == 1 else part for part in (places, ways))
    return [TapPoint(place, way, u_place, u_turn) for place, way in zip(places, ways, strict=True)]


def _numbers(text: str, option: str) -> tuple[float, float, float]:
    try:
        first, second, third = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(
            f"{option} must be three numbers aft, right and up, such as 0.1,0,-0.05"
            f"{' in m' if option == '--at' else ''}, not {text!r}"
        ) from None
    return first, second, third


def _way(text: str) -> tuple[float, float, float]:
    if text in WAYS:
        return WAYS[text]
    if "," not in text:
        raise ValueError(f"--direction must be {', '.join(WAYS)} or three numbers aft, right and up, not {text!r}")
    numbers = np.array(_numbers(text, "--direction"))
    size = float(np.linalg.norm(numbers))
    if not 0 < size < np.inf:
        raise ValueError(f"--direction must point somewhere, not {text!r}")
    first, second, third = (float(value) for value in numbers / size)
    return first, second, third


def identify_impact(
    paths: Sequence[Path],
    out: Path | None,
    *,
    component: str = "AF",
    mass: str | None = None,
    points: Sequence[TapPoint | None] = (),
    half_range: Mapping[str, float] | None = None,
    modes: str | None = None,
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
    responses: Path | None = None,
) -> Result:
    """Dynamics of one component, or of all six, from taps of measured force.

    Parameters
    ----------
    paths
        The recordings, each with taps at one point.
    out
        dynamics.json to write, or None.
    component
        The component, or all.
    mass
        Moving mass: a number [kg] or mass.json; None leaves the mass matrix of all components out.
    points
        Where the taps of every recording were given; None where its channel map says so.
    half_range
        Half of range by component [N, N*m]; None takes the largest change of load in the recordings.
    modes
        Number of modes, or auto; None takes one for one component and auto for all.
    files
        Balance matrix, zeros and tares, where the recordings hold gauge outputs; None where they hold loads.
    channel_map
        Channel map of the recordings.
    responses
        Universal file of the response functions to write, or None.
    """
    names = COMPONENTS if component == "all" else (component,)
    if component != "all":
        known_component(component)
    if component != "all" and mass is None:
        raise ValueError("Missing option '--mass': taps tell mass over stiffness only")
    wanted = None if modes is None else number_of_modes(modes)
    used = [channel_map, mass_file(mass), *(() if files is None else files.paths)]
    check_out(out, *paths, *used, responses, kind="dynamics")
    if responses is not None:
        check_out(responses, *paths, *used)
    weighed, weighing = weighed_mass(mass) if component == "all" else (parse_mass(mass or "", component), None)
    with collected_warnings() as collected:
        recordings = [recording_of(path, channel_map) for path in paths]
        loads = None
        if files is not None:
            loads = files.identification_loads(
                recordings, weighing, channel_map=channel_map, calibration_counts=component == "all"
            )
        found = identify(
            loads or recordings,
            components=names,
            mass=weighed,
            half_range=half_range,
            excitation="impact",
            modes=wanted,
            points=list(points) or None,
        )
    if responses is not None and not cast("ImpactFit | ImpactIdentification", found).taps.responses:
        raise FitError(
            f"{paths[0].name}: response functions are written of taps whose force can be used, and there is none"
        )
    if responses is not None:
        where = [point_of(one, two) for one, two in zip(recordings, points or [None] * len(recordings), strict=True)]
        _write(responses, cast("ImpactFit | ImpactIdentification", found).taps, where, names)
    inputs = [*paths, *(file for file in used if file is not None)]
    if isinstance(found, ImpactFit):
        way = "taps" if found.taps.taps else "a shaker"
        details = {"method": f"{way} of measured force, maximum likelihood", **_taps_details(found.taps, names)}
        if files is not None:
            details["calibration_of_balance"] = CALIBRATION_DROPS_OUT
        result = identified(
            paths[0], out, found.dynamics, details, mass=mass, modes=modes, collected=collected, used=inputs[1:]
        )
        result["summary"] = f"{found.verdict}\n\n{result['summary']}\n{_taps_table(found.taps)}\n"
    else:
        found = cast("ImpactIdentification", found)
        if files is not None:
            found = replace(found, dynamics=replace(found.dynamics, balance=digest(files.balance)))
        result = written_result(
            found,
            out,
            details=_coupled_details(found, weighing),
            summary=f"{found.verdict}\n\n{_summary(found, weighing)}",
            inputs=inputs,
            settings={"mass": mass, "half_range": half_range, "modes": modes or "auto"},
            doubted=collected,
        )
    return {"verdict": str(found.verdict), "doubts": [doubt_result(doubt) for doubt in found.doubts], **result}


def _write(path: Path, taps: Taps, where: Sequence[TapPoint | None], names: Sequence[str]) -> None:
    """Write the response functions."""
    places = list(dict.fromkeys(where))
    written = []
    for one in taps.responses:
        point = places[one.point]
        way = DIRECTIONS[COMPONENTS.index(names[0])] * (0 if names[0] in MOMENTS else 1)
        written.append(
            WrittenResponse(
                np.zeros(3) if point is None else np.array(point.place),
                way if point is None else np.array(point.direction),
                taps.points[one.point],
                one.frequency,
                one.response,
                one.coherence,
            )
        )
    write_responses(path, written, components=names)


def _taps_details(taps: Taps, names: Sequence[str]) -> Result:
    """What was found of the taps, as plain data."""
    return {
        "points": list(taps.points),
        "taps": [
            {
                "tap": tap.name,
                "instant": {"value": tap.instant, "unit": "s"},
                "point": tap.point,
                "peak": {"value": tap.peak, "unit": "N"},
                "impulse": {"value": tap.impulse, "unit": "N*s"},
                "contact": {"value": tap.duration, "unit": "s"},
                "bandwidth": {"value": tap.bandwidth, "unit": "Hz"},
                "used": tap.used,
                "shares": None if np.isnan(tap.shares).any() else tap.shares.tolist(),
            }
            for tap in taps.taps
        ],
        "force_gain": None if taps.gain is None else {"value": taps.gain[0], "u": taps.gain[1], "unit": "1"},
        "force_delay": None if taps.delay is None else {"value": taps.delay[0], "u": taps.delay[1], "unit": "s"},
        "force_high_pass": {"value": taps.corner, "unit": "Hz"},
        "coherence": [
            {
                "point": one.point,
                "taps": one.taps,
                "band": [float(one.frequency[0]), float(one.frequency[-1])],
                "mean": None
                if np.isnan(one.coherence).any()
                else dict(zip(names, np.mean(one.coherence, axis=0).tolist(), strict=True)),
            }
            for one in taps.responses
        ],
        "residual_standard_deviation": by_component(taps.residual_deviation, names),
        "reduced_chi2": dict(zip(names, taps.reduced_chi2.tolist(), strict=True)),
        "degrees_of_freedom": taps.degrees_of_freedom,
    }


def _taps_table(taps: Taps) -> str:
    """The taps in a table, and what they say of the force."""
    rows = [
        [
            tap.name,
            str(tap.point + 1) if tap.point >= 0 else "-",
            f"{tap.peak:.4g}",
            f"{1000 * tap.duration:.3g}",
            f"{tap.bandwidth:.4g}",
            tap.used,
        ]
        for tap in taps.taps
    ]
    heads = ["tap", "point", "peak [N]", "contact [ms]", "force to [Hz]", "used"]
    lines = [table_text("Taps", heads, rows)] if rows else ["a shaker, whose force acts all along"]
    lines += [f"point {number}: {name}" for number, name in enumerate(taps.points, start=1)]
    if taps.gain is not None and taps.delay is not None:
        lines.append(
            f"force as the balance shows it over its reading {taps.gain[0]:.5f} (u = {taps.gain[1]:.1g}), delay "
            f"{1e6 * taps.delay[0]:.3g} us (u = {1e6 * taps.delay[1]:.1g})"
        )
    return "\n".join(lines)


def _coupled_details(found: ImpactIdentification, weighing: Weighing | None) -> Result:
    details: Result = {
        "method": "taps of measured force, all components together, maximum likelihood",
        **common_details(found),
        **_taps_details(found.taps, found.dynamics.components),
    }
    if found.rigid is not None:
        details["tests"] = tests_details(rigid_tests(found.rigid, weighing))
    return details


def _summary(found: ImpactIdentification, weighing: Weighing | None) -> str:
    """Tables for people: modes, matrices, taps and what they leave."""
    parts = [
        modes_table(found),
        *matrices_text(found.dynamics, found.half_range),
        _taps_table(found.taps),
        error_table(found),
    ]
    return "\n\n".join([*parts, *rigid_text(found.rigid, weighing)]) + "\n"
