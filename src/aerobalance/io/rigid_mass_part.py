"""Mass, centre of gravity and inertia of a rigid mass as files have them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.io.artefacts import Covariance, Loose, PositiveValue, Value, check_unit, checked_covariance
from aerobalance.recording.components import AXES

_INERTIA: Final = {"aa": (0, 0), "rr": (1, 1), "uu": (2, 2), "ar": (0, 1), "au": (0, 2), "ru": (1, 2)}
"""Moments of inertia by axes: aft, right, up."""


class _Centre(Loose):
    aft: Value
    right: Value
    up: Value


class _Inertia(Loose):
    aa: PositiveValue
    rr: PositiveValue
    uu: PositiveValue
    ar: Value = Value(value=0.0)
    au: Value = Value(value=0.0)
    ru: Value = Value(value=0.0)


class RigidMassPart(Loose):
    """Mass, centre of gravity and inertia of a rigid mass in a file."""

    mass: PositiveValue
    centre: _Centre
    inertia: _Inertia
    covariance: Covariance | None = None


def rigid_mass_payload(mass: RigidMass) -> dict[str, object]:
    """Return a rigid mass as plain data: mass [kg], centre [m], inertia [kg*m^2], and their covariance."""
    values = mass.values.tolist()
    deviations = np.sqrt(np.diag(mass.covariance))
    units = ("kg", *("m",) * 3, *("kg*m^2",) * 6)
    entries = [
        {"value": value, "u": u, "unit": unit} for value, u, unit in zip(values, deviations, units, strict=True)
    ]
    payload: dict[str, object] = {
        "mass": entries[0],
        "centre": dict(zip(AXES, entries[1:4], strict=True)),
        "inertia": dict(zip(_INERTIA, entries[4:], strict=True)),
    }
    if mass.covariance.any():
        payload["covariance"] = {"parameters": list(_mass_names()), "matrix": mass.covariance}
    return payload


def _mass_names() -> tuple[str, ...]:
    return ("mass", *(f"centre.{axis}" for axis in AXES), *(f"inertia.{axes}" for axes in _INERTIA))


def rigid_mass_from(path: Path, given: RigidMassPart) -> RigidMass:
    """Return the rigid mass of a file.

    Raises
    ------
    ReadError
        A unit is not the one inside, or the covariance contradicts the uncertainties.
    """
    entries: dict[str, Value] = {"mass": given.mass}
    entries |= {f"centre.{axis}": getattr(given.centre, axis) for axis in AXES}
    entries |= {f"inertia.{axes}": getattr(given.inertia, axes) for axes in _INERTIA}
    for name, entry in entries.items():
        unit = "kg" if name == "mass" else "m" if name.startswith("centre") else "kg*m^2"
        check_unit(path, f"mass.{name}.unit", entry, unit)
    deviations = {name: entry.u for name, entry in entries.items()}
    inertia = np.zeros((3, 3))
    for axes, (i, j) in _INERTIA.items():
        inertia[i, j] = inertia[j, i] = entries[f"inertia.{axes}"].value
    return RigidMass(
        given.mass.value,
        np.array([entries[f"centre.{axis}"].value for axis in AXES]),
        inertia,
        checked_covariance(path, "mass.covariance", given.covariance, deviations),
    )
