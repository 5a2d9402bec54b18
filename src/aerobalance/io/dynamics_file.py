"""dynamics.json: the dynamics of components each for itself, or of components that are dynamically coupled.

``components`` holds mass, stiffness and damping by component; of coupled ones it lists the names, and the matrices
``inertia`` and ``damping`` stand beside it with named rows and columns.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Unpack

from pydantic import Field

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import IndependentDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import MODE_PARAMETERS, PARAMETERS, Dynamics
from aerobalance.io.artefacts import (
    IN_EVERY_FILE,
    Covariance,
    Finite,
    Loose,
    NotNegative,
    NotNegativeValue,
    Origin,
    PositiveValue,
    Value,
    check_unit,
    checked_covariance,
    digest,
    entries_of,
    load,
    write_artefact,
)
from aerobalance.io.coupled_part import (
    FORMER,
    FREQUENCY_AGREEMENT,
    CoupledFile,
    ListedMode,
    check_mode,
    coupled_from,
    coupled_payload,
)
from aerobalance.io.opening import opened_file
from aerobalance.recording.components import COMPONENTS, dynamics_units, si_unit
from aerobalance.recording.errors import ReadError, warn_quality

Kind = Literal["axial", "coupled"]

SHARE_AGREEMENT: Final = 1e-6
"""Departure from 1 of the sum of the shares of the modes that rounding in a file may make."""


class _Mode(ListedMode):
    damping_ratio: NotNegative
    share: Finite
    u_share: NotNegative = 0.0


class _ComponentDynamics(Loose):
    for_people = frozenset({"damping_ratio", "fit"})

    mass: PositiveValue
    stiffness: PositiveValue
    damping: NotNegativeValue
    delay: Value = Value(value=0.0)
    natural_frequency: PositiveValue | None = None
    modes: list[_Mode] = Field(default_factory=list)
    covariance: Covariance | None = None
    identified_load: NotNegativeValue | None = None


class _SeparateFile(Loose):
    for_people = IN_EVERY_FILE

    kind: Literal["dynamics"] = "dynamics"
    schema_: Annotated[Literal[1], Field(alias="schema")] = 1
    components: Annotated[dict[str, _ComponentDynamics], Field(min_length=1)]


_FORMER_UNITS: Final = {"stiffness": "N/m", "damping": "N*s/m"}
"""What earlier files say of moments too, whose numbers are the same."""


def dynamics_payload(dynamics: Dynamics, *, details: Mapping[str, object] | None = None) -> dict[str, object]:
    """Return the entry of one component in dynamics.json, as plain data.

    Parameters
    ----------
    dynamics
        Dynamics of the component.
    details
        How the fit went; written under ``fit``.
    """
    entry: dict[str, object] = {}
    for name, unit in dynamics_units(dynamics.component).items():
        value, u = float(getattr(dynamics, name)), dynamics.uncertainty(name)
        if name != "delay" or value or u:
            entry[name] = {"value": value, "u": u, "unit": unit}
    if dynamics.further_modes:
        entry["modes"] = [_mode_payload(dynamics, number) for number in range(1, 1 + len(dynamics.modes))]
    entry["covariance"] = {"parameters": list(dynamics.parameters), "matrix": dynamics.covariance.tolist()}
    if dynamics.identified_load:
        unit = si_unit(dynamics.component)
        entry["identified_load"] = {"value": dynamics.identified_load, "unit": unit}
    if details:
        entry["fit"] = dict(details)
    return entry


def _mode_payload(dynamics: Dynamics, number: int) -> dict[str, object]:
    """One mode: its numbers, each with its standard uncertainty; its share is that of a steady load."""
    mode, suffix = dynamics.modes[number - 1], "" if number == 1 else f"_{number}"
    entry: dict[str, object] = {}
    for name in MODE_PARAMETERS:
        entry[name] = float(getattr(mode, name))
        entry[f"u_{name}"] = dynamics.uncertainty(name + suffix)
    return {**entry, "units": {"natural_frequency": "Hz", "damping_ratio": "1", "share": "1"}}


def write_dynamics(
    path: Path | str,
    dynamics: Mapping[str, Dynamics] | CoupledDynamics,
    *,
    details: Mapping[str, Any] | None = None,
    **origin: Unpack[Origin],
) -> None:
    """Write dynamics.json.

    Parameters
    ----------
    path
        The file.
    dynamics
        Dynamics by component, or coupled.
    details
        How the fit went: of each component by its name, or of all coupled ones.
    origin
        What it was computed from.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    given = dict(details or {})
    if isinstance(dynamics, CoupledDynamics):
        contents = {**coupled_payload(dynamics), **({"fit": given} if given else {})}
    else:
        contents = {
            "components": {name: dynamics_payload(one, details=given.get(name)) for name, one in dynamics.items()}
        }
    write_artefact(path, "dynamics", contents, **origin)


def read_dynamics(path: Path | str) -> dict[str, Dynamics]:
    """Read dynamics.json, as written by `write_dynamics` or by hand.

    By hand ``components.AF.{mass,stiffness,damping}.value`` is enough; ``u`` is 0 where left out.

    Raises
    ------
    ReadError
        The file is no such JSON, or its numbers are not physical; the message names the key and what is allowed.
    """
    file = Path(path)
    if dynamics_kind(file) == "coupled":
        raise ReadError(file, "components", "are coupled, but components each for itself are needed")
    contents = load(file, "dynamics", _SeparateFile)
    result = {}
    for name, key, entry in entries_of(file, contents.components, COMPONENTS):
        units = dynamics_units(name)
        given = {parameter: getattr(entry, parameter) for parameter in PARAMETERS}
        for parameter, value in given.items():
            if value.unit != _FORMER_UNITS.get(parameter):
                check_unit(file, f"{key}.{parameter}.unit", value, units[parameter])
        deviations = {parameter: value.u for parameter, value in given.items()}
        for number, mode in enumerate(entry.modes[1:], start=2):
            deviations |= {f"{item}_{number}": getattr(mode, f"u_{item}") for item in MODE_PARAMETERS}
        covariance = checked_covariance(file, f"{key}.covariance", entry.covariance, deviations)
        largest = entry.identified_load
        if largest is not None:
            check_unit(file, f"{key}.identified_load.unit", largest, si_unit(name))
        try:
            result[name] = Dynamics(
                component=name,
                mass=entry.mass.value,
                stiffness=entry.stiffness.value,
                damping=entry.damping.value,
                delay=entry.delay.value,
                covariance=covariance,
                identified_load=0.0 if largest is None else largest.value,
                further_modes=tuple(
                    Mode(mode.natural_frequency, mode.damping_ratio, mode.share) for mode in entry.modes[1:]
                ),
            )
        except ValueError as error:
            raise ReadError(file, key, str(error)) from None
        _check_frequency(file, key, entry, result[name])
        _check_modes(file, key, entry.modes, result[name])
    return result


def _check_modes(path: Path, key: str, modes: Sequence[_Mode], dynamics: Dynamics) -> None:
    """Refuse modes whose first is not that of mass and stiffness, or whose shares do not add to 1."""
    if not modes:
        return
    first, own = modes[0], dynamics.modes[0]
    words = "mass, stiffness and damping give", "the first mode is theirs"
    check_mode(path, f"{key}.modes[0]", first, own, words=words)
    if abs(first.share - own.share) > SHARE_AGREEMENT:
        raise ReadError(
            path, f"{key}.modes", f"have shares that add to {sum(mode.share for mode in modes):g}; they must add to 1"
        )


def _check_frequency(path: Path, key: str, entry: _ComponentDynamics, dynamics: Dynamics) -> None:
    """Refuse a natural frequency that contradicts mass and stiffness: one of the three was altered by mistake."""
    given = entry.natural_frequency
    if given is not None and abs(given.value / dynamics.natural_frequency - 1) > FREQUENCY_AGREEMENT:
        raise ReadError(
            path,
            f"{key}.natural_frequency.value",
            f"is {given.value:g} Hz, but mass and stiffness give {dynamics.natural_frequency:g} Hz; "
            "correct the one that is wrong, or leave natural_frequency out",
        )


def read_coupled(path: Path | str) -> CoupledDynamics:
    """Read dynamics.json of coupled components, as written by `write_dynamics` or by hand.

    By hand ``components``, ``inertia.matrix`` and ``damping.matrix`` are enough; where there are internal coordinates,
    ``inertia.rows`` names them behind the components: hidden 1, hidden 2 and so on.

    Raises
    ------
    ReadError
        The file is no such JSON, or its numbers are not physical; the message names the key and what is allowed.
    """
    file = Path(path)
    if dynamics_kind(file) == "axial":
        raise ReadError(
            file,
            "components",
            "holds components each for itself, but coupled dynamics are needed: components that were "
            "identified together, with the matrices inertia and damping",
        )
    contents = load(file, "dynamics", CoupledFile, former=FORMER)
    return coupled_from(file, contents)


def dynamics_kind(path: Path | str) -> Kind | None:
    """Return whether a dynamics.json holds components each for itself (``"axial"``) or coupled ones; None if neither.

    Coupled ones are a list, and have matrices.
    """
    try:
        with opened_file(Path(path)) as file:
            given = json.loads(file.read().decode("utf-8-sig"))
    except (ReadError, ValueError, RecursionError):
        return None
    if not isinstance(given, dict) or given.get("kind", "dynamics") not in ("dynamics", FORMER):
        return None
    if given.get("kind") == FORMER or "inertia" in given or isinstance(given.get("components"), list):
        return "coupled"
    return "axial" if "kind" in given or isinstance(given.get("components"), dict) else None


def read_any_dynamics(path: Path | str) -> BalanceDynamics:
    """Return the dynamics of a dynamics.json: of components each for itself, or coupled ones.

    Raises
    ------
    ReadError
        As `read_dynamics` and `read_coupled`.
    """
    return read_coupled(path) if dynamics_kind(path) == "coupled" else IndependentDynamics(read_dynamics(path))


def through_balance(balance: Path, known: BalanceDynamics, *, dynamics: Path) -> BalanceDynamics:
    """Return dynamics for loads by a balance matrix: what another matrix left in them is not in these loads as well.

    Parameters
    ----------
    balance
        File of the matrix.
    known
        The dynamics.
    dynamics
        File of the dynamics, for the message.
    """
    if known.calibration is None or known.calibration == digest(balance):
        return known
    warn_quality(
        f"{dynamics.name} was found by another balance matrix than {balance.name}; what the calibration of that one "
        "left in the dynamics is added to the uncertainty"
    )
    return known.with_calibration
