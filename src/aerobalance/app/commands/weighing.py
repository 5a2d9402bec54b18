"""The command weigh, and masses from the command line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.app.commands.answers import quantities, quantity_table, short
from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.doubts import doubt_result
from aerobalance.app.commands.shared import Result, check_out, collected_warnings, known_component, recording_of
from aerobalance.balance.weighing.from_outputs import weigh as weigh_recordings
from aerobalance.io import load_channel_map
from aerobalance.io.mass_file import read_masses, weighing_payload, write_weighing
from aerobalance.io.points import read_points
from aerobalance.recording.components import STANDARD_GRAVITY, mass_unit
from aerobalance.recording.units import conversion

_AMOUNT: Final = re.compile(
    r"(?P<number>[-+]?[\d.,]+(?:e[-+]?\d+)?|[-+]?(?:nan|inf))\s*(?P<unit>[^\d\s.,][^.,]*)?", re.IGNORECASE
)
"""A number with a decimal point or comma, and a unit where there is one."""


def weigh(
    paths: Sequence[Path],
    out: Path | None,
    *,
    component: str | None = None,
    gravity: float = STANDARD_GRAVITY,
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
    scales: str | None = None,
) -> Result:
    """Return mass, offsets and tilt, and with moments the centre of gravity, from points or recordings at rest.

    Takes all loads that the files have, unless one component is named. With a balance, the recordings are of gauge
    outputs. A mass on scales is what the result is held against.
    """
    on_scales = None if scales is None else mass_number(scales, option="--scales")
    if scales is not None and on_scales is None:
        raise ValueError(f"--scales must be a mass like 42.1, '42.1 kg' or '93 lb', not {scales}")
    if component is not None:
        known_component(component)
    check_out(out, *paths, channel_map, *(() if files is None else files.paths), kind="mass")
    chosen = None if channel_map is None else load_channel_map(channel_map)
    names = None if component is None else (component,)
    with collected_warnings() as collected:
        if files is None:
            weighing = weigh_recordings(
                read_points(paths, names, channel_map=chosen), gravity=gravity, scales=on_scales
            )
        else:
            if files.zero_after or files.tare or files.mass is not None:
                raise ValueError("weighing takes --zero alone: tares and closing zeros would take off what is weighed")
            recordings = [recording_of(path, channel_map) for path in paths]
            zero = files.zeros(channel_map)
            weighing = weigh_recordings(
                recordings, files.matrix(), zero=zero, gravity=gravity, components=names, scales=on_scales
            )
    if out is not None:
        inputs = [*paths, *(() if files is None else files.paths)]
        settings: Result = {"components": weighing.components, "gravity": gravity}
        if on_scales is not None:
            settings["scales"] = on_scales
        write_weighing(out, weighing, inputs=inputs, settings=settings, warnings=collected)
    result: Result = weighing_payload(weighing)
    text = summary(paths, result)
    if on_scales is not None:
        text += f"{weighing.mass / on_scales:.4g} times the {on_scales:.6g} kg on scales\n"
    if len(weighing.components) == 1:  # what is found of one force stands at the top as well
        (single,) = weighing.components
        result = {**result, "component": single, **result["components"][single]}
    doubted = {"verdict": str(weighing.verdict), "doubts": [doubt_result(doubt) for doubt in weighing.doubts]}
    return {**doubted, **result, "warnings": collected, "summary": f"{weighing.verdict}\n\n{text}"}


def summary(paths: Sequence[Path], result: Result) -> str:
    """Return a short answer for people: mass, centre of gravity, offsets and tilts with their uncertainties."""
    rows = quantities(result, {"common_mass": "mass"})
    if len(result["components"]) > 1:
        masses = {name: entry["mass"] for name, entry in result["components"].items()}
        rows += quantities(masses, {name: f"mass by {name}" for name in masses})
    for key, word in (("centre_of_gravity", "centre of gravity"), ("offsets", "offset"), ("misalignment", "tilt")):
        rows += quantities(result[key], {name: f"{word} {name}" for name in result[key]})
    lines = [quantity_table(f"{_of(paths)}: weighing", rows)]
    for key, agreement in result["agreement"].items():
        if agreement is not None:
            lines.append(
                f"{key.replace('_', ' ')} by the components: {'agree' if agreement['agree'] else 'do NOT agree'} "
                f"(p = {short(agreement['p_value'], 2)})"
            )
    lines += [f"not found: {name}: {reason}" for name, reason in result["unidentified"].items()]
    return "\n".join(lines) + "\n"


def _of(paths: Sequence[Path]) -> str:
    return paths[0].name if len(paths) == 1 else f"{len(paths)} files"


def parse_mass(text: str | None, component: str) -> tuple[float, float] | None:
    """Mass and its standard uncertainty from the command line: a number (exact) or the name of mass.json."""
    if text is None:
        return None
    value = mass_number(text, unit=mass_unit(component))
    if value is not None:
        return value, 0.0
    masses = read_masses(Path(text))
    if component not in masses:
        raise ValueError(f"{text} holds no mass of {component}; it has {', '.join(masses)}")
    return masses[component].mass, masses[component].u


def mass_number(text: str, *, unit: str = "kg", option: str = "--mass") -> float | None:
    """Mass in `unit` from the command line, with a unit of its own or without: ``42.1``, ``42,1 kg``, ``93 lb``.

    None where the text is the name of a file.

    Raises
    ------
    ValueError
        It is a number but not positive, can be read in two ways, or has a unit of something else.
    """
    match = _AMOUNT.fullmatch(text.strip())
    if match is None or text.lower().endswith(".json") or Path(text).is_file():
        return None
    number = match["number"]
    if re.fullmatch(r"[-+]?\d{1,3}(,\d{3})+", number):
        raise ValueError(
            f"{option} {text} can be read in two ways; write thousands without a comma, decimals with a point"
        )
    factor = 1.0
    if match["unit"]:
        try:
            factor = conversion(match["unit"].strip("[]"), expected=unit).factor
        except ValueError as error:
            raise ValueError(f"{option} {text}: {error}") from None
    try:
        value = float(number.replace(",", ".")) * factor
    except ValueError:
        value = float("nan")
    if not 0 < value < np.inf:
        raise ValueError(
            f"{option} must be a positive number{' or a mass.json' if option == '--mass' else ''}, not {text}; "
            "a number is like 42.1, '42.1 kg' or '93 lb'"
        )
    return value


def mass_file(mass: str | None) -> Path | None:
    """Return the file that a mass was given as; None where it is a number."""
    return Path(mass) if mass is not None and Path(mass).is_file() else None
