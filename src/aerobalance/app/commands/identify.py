"""Commands that identify dynamics: from a decay, a shaken rig or a published response."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal, cast

import numpy as np

from aerobalance.app.commands.answers import quantities, quantity_table, rounded, short
from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.doubts import doubt_result
from aerobalance.app.commands.shared import Result, check_out, collected_warnings, known_component, recording_of
from aerobalance.app.commands.weighing import mass_file, parse_mass
from aerobalance.balance.weighing.result import Weighing
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.base_excitation.frf_table import ResponseTable
from aerobalance.identification.base_excitation.frf_table import identify_frf as fit_frf
from aerobalance.identification.base_excitation.paper_procedure import Phase, reference_fit
from aerobalance.identification.base_excitation.rig import RigFit
from aerobalance.identification.base_excitation.sine_dwell import Dwell, find_dwells, harmonic_check
from aerobalance.identification.free_decay.fit import DecayFit
from aerobalance.identification.free_decay.log_decrement import extrema_fit
from aerobalance.identification.identify import identify
from aerobalance.io import (
    read_table,
)
from aerobalance.io.dynamics_file import dynamics_payload, write_dynamics
from aerobalance.io.mass_file import read_weighing
from aerobalance.recording.components import density_unit, dynamics_units, si_unit
from aerobalance.recording.errors import FitError, ReadError, warn_quality
from aerobalance.recording.recording import Recording

PHASES: Final[tuple[Phase, ...]] = ("relative", "absolute")
"""Readings of the phase in the paper's procedures: of the extension (right) and of the live end (the text's)."""


CALIBRATION_DROPS_OUT: Final = (
    "an error of the sensitivity makes the load too large all along the decay, so natural frequency and damping ratio "
    "do not depend on it; stiffness and damping have that of the mass alone"
)
"""What a calibration leaves in one component from a release: nothing but by the mass."""


def identify_decay(
    path: Path,
    out: Path | None,
    *,
    component: str = "AF",
    mass: str,
    modes: str = "1",
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
) -> Result:
    """Stiffness and damping, and further modes, from a free decay of a load, or of gauge outputs with a balance."""
    known_component(component)
    used = [] if files is None else list(files.paths)
    check_out(out, path, channel_map, mass_file(mass), *used, kind="dynamics")
    weighed = parse_mass(mass, component)
    wanted = number_of_modes(modes)
    with collected_warnings() as collected:
        recording, loads = recording_of(path, channel_map), None
        if files is not None:
            (loads,) = files.identification_loads(
                [recording], _weighing(mass), channel_map=channel_map, calibration_counts=False
            )
            recording = loads.recording
        fit = cast("DecayFit", identify(loads or recording, components=[component], mass=weighed, modes=wanted))
    details = {"method": "free decay, least squares on the waveform", **_decay_details(recording, fit)}
    if files is not None:
        details["calibration_of_balance"] = CALIBRATION_DROPS_OUT
    used += [] if channel_map is None else [channel_map]
    result = identified(path, out, fit.dynamics, details, mass=mass, modes=modes, collected=collected, used=used)
    result["summary"] = f"{fit.verdict}\n\n{result['summary']}"
    return {"verdict": str(fit.verdict), "doubts": [doubt_result(doubt) for doubt in fit.doubts], **result}


def _weighing(mass: str | None) -> Weighing | None:
    """Weighing of a mass.json; None where the mass is a number, or the file holds masses alone."""
    file = mass_file(mass)
    if file is None:
        return None
    try:
        return read_weighing(file)
    except ReadError:
        return None


def number_of_modes(given: str) -> int | Literal["auto"]:
    """Read --modes.

    Raises
    ------
    ValueError
        It is neither auto nor a number of modes.
    """
    if given == "auto":
        return "auto"
    if not given.isdecimal() or int(given) < 1:
        raise ValueError(f"--modes must be auto or a number from 1 up, not {given!r}")
    return int(given)


def _decay_details(recording: Recording, fit: DecayFit) -> Result:
    density = density_unit(fit.dynamics.component)
    details: Result = {
        "damped_frequency": {"value": fit.damped_frequency, "u": fit.damped_frequency_uncertainty, "unit": "Hz"},
        "release": None if fit.release is None else {"value": fit.release[0], "u": fit.release[1], "unit": "s"},
        "release_duration": {"value": fit.release_duration, "unit": "s"},
        "height": {"value": fit.height, "unit": si_unit(fit.dynamics.component)},
        "window": {"value": list(fit.window), "unit": "s"},
        "hum": [{"frequency": frequency, "amplitude": size} for frequency, size in fit.hum],
        "further_modes": [
            {"natural_frequency": frequency, "damping_ratio": ratio, "share": share}
            for frequency, ratio, share in fit.further_modes
        ],
        "amplitude_dependence": _amplitude_details(fit),
        "amplitude_law": _law_details(fit),
        "force_density": None if fit.force_density is None else {"value": fit.force_density, "unit": density},
        "residual_standard_deviation": {"value": fit.residual_deviation, "unit": si_unit(fit.dynamics.component)},
        "degrees_of_freedom": fit.degrees_of_freedom,
    }
    if fit.dynamics.further_modes:
        details["shares_of_the_modes"] = "of a load at the place where the cable pulled"
    try:
        reference = extrema_fit(recording, fit)
    except FitError as problem:
        details["reference"] = {"method": "extrema (7), (20)", "failed": str(problem)}
    else:
        units = dynamics_units(fit.dynamics.component)
        details["reference"] = {
            "method": "extrema (7), (20)",
            "frequency": {"value": reference.frequency, "unit": "Hz"},
            "stiffness": {"value": reference.stiffness, "unit": units["stiffness"]},
            "damping": {"value": reference.damping, "unit": units["damping"]},
        }
    return details


def _amplitude_details(fit: DecayFit) -> Result | None:
    """Change of damping and frequency from the smallest to the largest amplitude, relative."""
    found = fit.amplitude_dependence
    if found is None:
        return None
    return {
        "damping": {"value": found.damping, "u": found.u_damping, "unit": "1", "significant": found.damping_depends},
        "frequency": {
            "value": found.frequency,
            "u": found.u_frequency,
            "unit": "1",
            "significant": found.frequency_depends,
        },
    }


def _law_details(fit: DecayFit) -> Result | None:
    """Damping ratio and frequency at the first amplitude and at the least, and how they change between."""
    law = fit.amplitude_law
    if law is None:
        return None
    return {
        "amplitude": {"value": law.amplitude.tolist(), "unit": si_unit(fit.dynamics.component)},
        "damping_ratio": {"value": law.damping_ratio.tolist(), "u": law.u_damping_ratio.tolist(), "unit": "1"},
        "frequency": {"value": law.frequency.tolist(), "u": law.u_frequency.tolist(), "unit": "Hz"},
        "power_of_amplitude": {"damping": law.powers.damping, "frequency": law.powers.frequency},
    }


def identify_rig(
    path: Path,
    out: Path | None,
    *,
    component: str = "AF",
    mass: str | None = None,
    modes: str = "1",
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
) -> Result:
    """Stiffness, damping, delay and further modes (and mass where it is not given) from a shaken ground end."""
    known_component(component)
    used = [] if files is None else list(files.paths)
    check_out(out, path, channel_map, mass_file(mass), *used, kind="dynamics")
    weighed = parse_mass(mass, component)
    wanted = number_of_modes(modes)
    with collected_warnings() as collected:
        recording, loads = recording_of(path, channel_map), None
        if files is not None:
            (loads,) = files.identification_loads([recording], _weighing(mass), channel_map=channel_map)
            recording = loads.recording
        found = identify(loads or recording, components=[component], excitation="base", mass=weighed, modes=wanted)
        fit = cast("RigFit", found)
        by_dwells = _dwell_details(recording, fit.dynamics)
    details: Result = {
        "method": "shaken ground end, maximum likelihood of the complex response",
        "mass_identified": fit.mass_identified,
        "band": {"value": list(fit.band), "unit": "Hz"},
        "chi2": fit.chi2,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "coloured_residuals": fit.coloured,
        **by_dwells,
    }
    if fit.dynamics.further_modes:
        details["shares_of_the_modes"] = "of a load from the ground's motion"
    if fit.left_out is not None:
        details["left_out"] = {
            "natural_frequency": fit.left_out.natural_frequency,
            "damping_ratio": fit.left_out.damping_ratio,
            "share": fit.left_out.share,
        }
    if fit.live is not None:
        details["live_accelerometer"] = {
            "gain": {"value": fit.live.gain, "u": fit.live.u_gain, "unit": "1"},
            "delay": {"value": fit.live.delay, "u": fit.live.u_delay, "unit": "s"},
        }
    used += [] if channel_map is None else [channel_map]
    return identified(path, out, fit.dynamics, details, mass=mass, modes=modes, collected=collected, used=used)


def _dwell_details(recording: Recording, dynamics: Dynamics) -> Result:
    """The paper's procedures and the harmonic check, where the record is made of dwells."""
    try:
        dwells: tuple[Dwell, ...] = find_dwells(recording, component=dynamics.component)
        fits = {
            phase: reference_fit(dwells, mass=dynamics.mass, phase=phase)
            for phase in PHASES
            if phase == "relative" or all(np.isfinite(dwell.live) for dwell in dwells)
        }
    except FitError as problem:
        return {"dwells": [], "reference": {"method": "(13)-(16)", "failed": str(problem)}}
    units = dynamics_units(dynamics.component)
    checks = harmonic_check(recording, dwells, dynamics=dynamics)
    unsteady = [f"{check.frequency:.4g}" for check in checks if not check.steady]
    if unsteady:
        warn_quality(
            f"the dwells at {', '.join(unsteady)} Hz are not steady: (12) to (16) do not hold there; the fit of the "
            "whole response takes the unsteadiness into account"
        )
    return {
        "dwells": [
            {
                "frequency": check.frequency,
                "measured": check.measured,
                "calculated": check.calculated,
                "steady": check.steady,
                "unsteadiness": check.unsteadiness,
                "accelerometer_noise": check.accelerometer_noise,
                "model": check.model,
            }
            for check in checks
        ],
        "reference": {
            name: {
                "method": f"(13)-(16), phase of the {name} motion",
                "natural_frequency": {"value": fit.natural_frequency, "u": fit.u_natural_frequency, "unit": "Hz"},
                "stiffness": {"value": fit.stiffness, "unit": units["stiffness"]},
                "damping": {"value": fit.damping, "u": fit.u_damping, "unit": units["damping"]},
            }
            for name, fit in fits.items()
        },
    }


def identify_frf(path: Path, out: Path | None, *, component: str = "AF", mass: str) -> Result:
    """Stiffness and damping from a published frequency response AF/F."""
    known_component(component)
    check_out(out, path, mass_file(mass), kind="dynamics")
    weighed = parse_mass(mass, component)
    if weighed is None:
        raise ValueError(
            "--mass is needed: a response AF/F tells stiffness and damping only in proportion to the mass"
        )
    columns = ("frequency", "amplitude", "u_amplitude", "phase", "u_phase")
    table = read_table(path, required=columns)
    frequency, amplitude, u_amplitude, phase, u_phase = (table.values(name) for name in columns)
    response = ResponseTable(frequency, amplitude, u_amplitude, phase, u_phase, str(path))
    with collected_warnings() as collected:
        fit = fit_frf(response, component=component, mass=weighed)
    details = {
        "method": "published frequency response, weighted least squares",
        "points": int(response.frequency.size),
        "chi2": fit.chi2,
        "degrees_of_freedom": fit.degrees_of_freedom,
    }
    return identified(path, out, fit.dynamics, details, mass=mass, collected=collected)


def identified(
    path: Path,
    out: Path | None,
    dynamics: Dynamics,
    details: Result,
    *,
    mass: str | None,
    modes: str | None = None,
    collected: list[str],
    used: Sequence[Path] = (),
) -> Result:
    """Write dynamics.json and return the same as plain data."""
    name = dynamics.component
    inputs = [path, *(file for file in (mass_file(mass),) if file is not None), *used]
    settings = {"component": name, "mass": mass if mass_file(mass) is None else Path(str(mass)).name}
    if modes is not None:
        settings["modes"] = modes
    if out is not None:
        write_dynamics(
            out, {name: dynamics}, details={name: details}, inputs=inputs, settings=settings, warnings=collected
        )
    result: Result = {"components": {name: dynamics_payload(dynamics, details=details)}, "warnings": collected}
    return {**result, "summary": summary(path, name, result["components"][name])}


_PARAMETERS: Final = ("mass", "natural_frequency", "damping_ratio", "stiffness", "damping", "delay")


def summary(path: Path, component: str, found: Result) -> str:
    """Short answer for people: the parameters with their uncertainties, further modes and how well they fit."""
    fit = found["fit"]
    rows = quantities(found, {key: key.replace("_", " ") for key in _PARAMETERS if key in found})
    rows += quantities(fit, {"release": "release at", "height": "height of the release"})
    rows += quantities(fit, {"residual_standard_deviation": "residual, standard deviation"})
    lines = [quantity_table(f"{path.name}: {component}, {fit['method']}", rows)]
    for number, mode in enumerate(found.get("modes", [])[1:], 2):
        frequency, u = rounded(mode["natural_frequency"], mode["u_natural_frequency"])
        ratio, u_ratio = rounded(mode["damping_ratio"], mode["u_damping_ratio"])
        lines.append(
            f"mode {number}: {frequency} Hz (u = {u}), damping ratio {ratio} (u = {u_ratio}), share "
            f"{short(mode['share'], 3)}"
        )
    if "chi2" in fit:
        lines.append(f"chi2 {short(fit['chi2'], 4)} for {fit['degrees_of_freedom']} degrees of freedom")
    return "\n".join(lines) + "\n"
