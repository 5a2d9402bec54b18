"""What each command does: files in, files out, and a plain-data account of the result.

The command line prints the account; the demo calls the same functions. Nothing is written unless the whole result is
there.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.components import COMPONENTS, STANDARD_GRAVITY, si_unit
from aerobalance.dynamics import Dynamics
from aerobalance.force import ForceEstimate, Method, reconstruct
from aerobalance.identification.decay import DecayFit
from aerobalance.identification.decay import identify_decay as fit_decay
from aerobalance.identification.dwells import Dwell, find_dwells, harmonic_check
from aerobalance.identification.extrema import extrema_fit
from aerobalance.identification.frf import ResponseTable
from aerobalance.identification.frf import identify_frf as fit_frf
from aerobalance.identification.reference import Phase, reference_fit
from aerobalance.identification.rig import identify_rig as fit_rig
from aerobalance.io import check_output, read, write_force, write_recording
from aerobalance.io.artefacts import (
    dynamics_payload,
    mass_payload,
    read_dynamics,
    read_mass,
    write_dynamics,
    write_mass,
)
from aerobalance.io.channel_map import load_channel_map, template
from aerobalance.io.csv_file import column_names, read_table
from aerobalance.io.points import read_points
from aerobalance.io.safe_write import replacing
from aerobalance.noise import channel_noise
from aerobalance.problems import DoubtWarning, FitError
from aerobalance.recording import Force, Recording
from aerobalance.weighing import weigh as fit_mass

Account = dict[str, Any]

PHASES: Final[tuple[Phase, ...]] = ("relative", "absolute")
"""Readings of the phase in the paper's procedures: of the extension (right) and of the live end (the text's)."""


@contextmanager
def doubts() -> Iterator[list[str]]:
    """Collect what is doubted while a result is worked out, each text once; the doubts are passed on at the end."""
    collected: list[str] = []

    def collect(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        text = " ".join(str(message).split())
        if issubclass(category, DoubtWarning) and text not in collected:
            collected.append(text)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", DoubtWarning)
            warnings.showwarning = collect
            yield collected
    except np.linalg.LinAlgError as problem:  # a ValueError by class, but no wrong call
        raise FitError(
            f"the equations of the fit have no solution ({problem}): the data leave too much open; "
            "a longer record with fewer gaps would help"
        ) from problem
    except ArithmeticError as problem:
        raise FitError(
            f"the numbers leave the range that can be calculated with ({problem}); "
            "check the units and the values of the recording, the mass and the dynamics"
        ) from problem
    finally:
        for text in collected:
            warnings.warn(text, DoubtWarning, stacklevel=4)


def check_out(out: Path | None, *inputs: Path | None) -> None:
    """Make sure, before any work, that the output can be written and takes the place of no input.

    Raises
    ------
    ValueError
        The output is an input, no ordinary file, or in a folder that does not exist.
    """
    if out is None:
        return
    if out.is_dir():
        raise ValueError(f"{out} is a folder; the name of a file is needed")
    if out.exists() and not out.is_file():
        raise ValueError(f"{out} is no ordinary file and would be replaced by one; give another name")
    if not out.parent.is_dir():
        raise ValueError(f"cannot write {out}: there is no folder {out.parent}")
    for file in inputs:
        if file is not None and file.exists() and out.exists() and out.samefile(file):
            raise ValueError(f"{out} is an input and would be overwritten; give the output another name")


def recording_of(path: Path, channel_map: Path | None = None) -> Recording:
    """Read a recording, through a channel map where one is given."""
    return read(path, channel_map=None if channel_map is None else load_channel_map(channel_map))


def info(path: Path, *, channel_map: Path | None = None) -> Account:
    """Channels, units, rate, duration, gaps and saturation of a recording."""
    with doubts() as collected:
        recording = recording_of(path, channel_map)
    channels = {}
    for channel in recording:
        known = channel.values[~channel.missing]
        enough = known.size >= 8 and float(np.ptp(known)) > 0
        channels[channel.name] = {
            "unit": channel.file_unit or channel.unit,
            "si_unit": channel.unit,
            "least": float(known.min()) if known.size else None,
            "mean": float(known.mean()) if known.size else None,
            "largest": float(known.max()) if known.size else None,
            "noise": channel_noise(channel) if enough else None,
            "missing": int(channel.missing.sum()),
            "saturated": int(channel.saturated.sum()),
        }
    return {
        "file": path.name,
        "duration": recording.duration,
        "rate": recording.rate,
        "samples": recording.samples,
        "start": recording.start,
        "gaps": [{"start": start, "length": length} for start, length in recording.gaps],
        "channels": channels,
        "warnings": collected,
    }


def convert(path: Path, out: Path, *, channel_map: Path | None = None) -> Account:
    """Write a recording in another format, or a foreign file as a plain recording."""
    check_output(out)
    check_out(out, path, channel_map)
    with doubts() as collected:
        recording = recording_of(path, channel_map)
    write_recording(out, recording)
    return {
        "file": path.name,
        "written": out.name,
        "samples": recording.samples,
        "channels": list(recording.channels),
        "warnings": collected,
    }


def channel_map_for(path: Path, out: Path | None) -> Account:
    """Make a channel map to fill in for a foreign file."""
    check_out(out, path)
    text = template(path) + "\n"
    if out is not None:
        with replacing(out) as beside:
            beside.write_text(text, encoding="utf-8")
    return {"file": path.name, "columns": list(column_names(path)), "map": text}


def weigh(
    paths: Sequence[Path],
    out: Path | None,
    *,
    component: str = "AF",
    gravity: float = STANDARD_GRAVITY,
    channel_map: Path | None = None,
) -> Account:
    """Moving mass from static points or recordings at several pitch (and roll) angles."""
    _known(component)
    check_out(out, *paths, channel_map)
    chosen = None if channel_map is None else load_channel_map(channel_map)
    with doubts() as collected:
        points = read_points(paths, component, channel_map=chosen)
        mass = fit_mass(
            points.pitch, points.load, roll=points.roll, component=component, gravity=gravity, noise=points.noise
        )
    settings = {"component": component, "gravity": gravity}
    if out is not None:
        write_mass(out, {component: mass}, inputs=paths, settings=settings, warnings=collected)
    return {"component": component, **mass_payload(mass), "warnings": collected}


def parse_mass(text: str | None, component: str) -> tuple[float, float] | None:
    """Mass and its standard uncertainty from the command line: a number (exact) or the name of mass.json."""
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        masses = read_mass(Path(text))
        if component not in masses:
            raise ValueError(f"{text} holds no mass of {component}; it has {', '.join(masses)}") from None
        return masses[component].mass, masses[component].u
    if not 0 < value < np.inf:
        raise ValueError(f"--mass must be a positive number or a mass.json, not {text}")
    return value, 0.0


def identify_decay(
    path: Path,
    out: Path | None,
    *,
    component: str = "AF",
    mass: str,
    channel_map: Path | None = None,
) -> Account:
    """Stiffness and damping from a free decay."""
    _known(component)
    check_out(out, path, channel_map, _file(mass))
    weighed = parse_mass(mass, component)
    if weighed is None:
        raise ValueError("--mass is needed: a free decay tells stiffness and damping only in proportion to the mass")
    with doubts() as collected:
        recording = recording_of(path, channel_map)
        fit = fit_decay(recording, component=component, mass=weighed)
    details = {"method": "free decay, least squares on the waveform", **_decay_details(recording, fit)}
    return _identified(path, out, fit.dynamics, details, mass=mass, collected=collected, channel_map=channel_map)


def _decay_details(recording: Recording, fit: DecayFit) -> Account:
    details: Account = {
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
        "residual_standard_deviation": {"value": fit.residual_deviation, "unit": si_unit(fit.dynamics.component)},
        "degrees_of_freedom": fit.degrees_of_freedom,
    }
    try:
        reference = extrema_fit(recording, fit)
    except FitError as problem:
        details["reference"] = {"method": "extrema (7), (20)", "failed": str(problem)}
    else:
        details["reference"] = {
            "method": "extrema (7), (20)",
            "frequency": {"value": reference.frequency, "unit": "Hz"},
            "stiffness": {"value": reference.stiffness, "unit": "N/m"},
            "damping": {"value": reference.damping, "unit": "N*s/m"},
        }
    return details


def identify_rig(
    path: Path,
    out: Path | None,
    *,
    component: str = "AF",
    mass: str | None = None,
    channel_map: Path | None = None,
) -> Account:
    """Stiffness, damping and delay (and mass where it is not given) from a shaken ground end."""
    _known(component)
    check_out(out, path, channel_map, _file(mass))
    weighed = parse_mass(mass, component)
    with doubts() as collected:
        recording = recording_of(path, channel_map)
        fit = fit_rig(recording, component=component, mass=weighed)
        by_dwells = _dwell_details(recording, fit.dynamics)
    details: Account = {
        "method": "shaken ground end, maximum likelihood of the complex response",
        "mass_identified": fit.mass_identified,
        "band": {"value": list(fit.band), "unit": "Hz"},
        "chi2": fit.chi2,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "coloured_residuals": fit.coloured,
        **by_dwells,
    }
    if fit.live is not None:
        details["live_accelerometer"] = {
            "gain": {"value": fit.live.gain, "u": fit.live.u_gain, "unit": "1"},
            "delay": {"value": fit.live.delay, "u": fit.live.u_delay, "unit": "s"},
        }
    return _identified(path, out, fit.dynamics, details, mass=mass, collected=collected, channel_map=channel_map)


def _dwell_details(recording: Recording, dynamics: Dynamics) -> Account:
    """The paper's procedures and the harmonic check, where the record is made of dwells."""
    try:
        dwells: tuple[Dwell, ...] = find_dwells(recording, component=dynamics.component)
        fits = {
            phase: reference_fit(dwells, mass=dynamics.mass, phase=phase)
            for phase in PHASES
            if phase == "relative" or "live_acceleration" in recording
        }
    except FitError as problem:
        return {"dwells": [], "reference": {"method": "(13)-(16)", "failed": str(problem)}}
    checks = harmonic_check(recording, dwells, dynamics=dynamics)
    unsteady = [f"{check.frequency:.4g}" for check in checks if not check.steady]
    if unsteady:
        warnings.warn(
            f"the dwells at {', '.join(unsteady)} Hz are not steady: (12) to (16) do not hold there; the fit of the "
            "whole response takes the unsteadiness into account",
            DoubtWarning,
            stacklevel=3,
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
                "stiffness": {"value": fit.stiffness, "unit": "N/m"},
                "damping": {"value": fit.damping, "u": fit.u_damping, "unit": "N*s/m"},
            }
            for name, fit in fits.items()
        },
    }


def identify_frf(path: Path, out: Path | None, *, component: str = "AF", mass: str) -> Account:
    """Stiffness and damping from a published frequency response AF/F."""
    _known(component)
    check_out(out, path, _file(mass))
    weighed = parse_mass(mass, component)
    if weighed is None:
        raise ValueError(
            "--mass is needed: a response AF/F tells stiffness and damping only in proportion to the mass"
        )
    columns = ("frequency", "amplitude", "u_amplitude", "phase", "u_phase")
    table = read_table(path, required=columns)
    frequency, amplitude, u_amplitude, phase, u_phase = (table.values(name) for name in columns)
    response = ResponseTable(frequency, amplitude, u_amplitude, phase, u_phase, str(path))
    with doubts() as collected:
        fit = fit_frf(response, component=component, mass=weighed)
    details = {
        "method": "published frequency response, weighted least squares",
        "points": int(response.frequency.size),
        "chi2": fit.chi2,
        "degrees_of_freedom": fit.degrees_of_freedom,
    }
    return _identified(path, out, fit.dynamics, details, mass=mass, collected=collected, channel_map=None)


def _identified(
    path: Path,
    out: Path | None,
    dynamics: Dynamics,
    details: Account,
    *,
    mass: str | None,
    collected: list[str],
    channel_map: Path | None,
) -> Account:
    """Write dynamics.json and give the same as an account."""
    name = dynamics.component
    inputs = [path, *(file for file in (channel_map, _file(mass)) if file is not None)]
    settings = {"component": name, "mass": mass if _file(mass) is None else Path(str(mass)).name}
    if out is not None:
        write_dynamics(
            out, {name: dynamics}, details={name: details}, inputs=inputs, settings=settings, warnings=collected
        )
    return {"components": {name: dynamics_payload(dynamics, details=details)}, "warnings": collected}


def _file(mass: str | None) -> Path | None:
    return Path(mass) if mass is not None and Path(mass).is_file() else None


def force(
    path: Path,
    out: Path,
    *,
    dynamics: Path,
    method: Method = "smoother",
    bandwidth: float | None = None,
    gravity: float = STANDARD_GRAVITY,
    channel_map: Path | None = None,
) -> Account:
    """Force applied, with its uncertainty, from the loads felt."""
    check_output(out)
    check_out(out, path, dynamics, channel_map)
    known = read_dynamics(dynamics)
    with doubts() as collected:
        recording = recording_of(path, channel_map)
        names = [name for name in known if name in recording]
        if not names:
            raise FitError(
                f"{path} has none of the components of {dynamics} ({', '.join(known)}); "
                f"it has {', '.join(recording.channels) or 'no channels'}"
            )
        estimates = {
            name: reconstruct(recording, known[name], method=method, bandwidth=bandwidth, gravity=gravity)
            for name in names
        }
    parts = list(estimates.values())
    write_force(
        out,
        recording,
        Force(
            components=tuple(names),
            values=np.column_stack([part.values for part in parts]),
            uncertainty=np.column_stack([part.uncertainty for part in parts]),
            rate=recording.rate,
        ),
    )
    left_out = [name for name in COMPONENTS if name in recording and name not in names]
    return {
        "written": out.name,
        "components": {name: force_account(estimate, recording.start) for name, estimate in estimates.items()},
        "components_without_dynamics": left_out,
        "warnings": collected,
    }


def force_account(estimate: ForceEstimate, start: float) -> Account:
    """Plain data on one component's force; instants of steps are on the clock that starts at `start` [s]."""
    unit = si_unit(estimate.component)
    return {
        "unit": unit,
        "method": estimate.method,
        "mean": float(estimate.values.mean()),
        "rms_about_mean": float(estimate.values.std()),
        "largest": float(estimate.values.max()),
        "least": float(estimate.values.min()),
        "uncertainty_rms": float(np.sqrt(np.mean(estimate.uncertainty**2))),
        "uncertainty_budget_rms": estimate.budget,
        "noise_of_reading": estimate.noise,
        "bandwidth": {"value": estimate.bandwidth, "unit": "Hz"},
        "noise_gain": estimate.noise_gain,
        "steps": [
            {
                "instant": start + step.instant,
                "u_instant": step.instant_uncertainty,
                "duration": step.duration,
                "height": step.height,
                "u_height": step.height_uncertainty,
            }
            for step in estimate.steps
        ],
        "assumptions": list(estimate.assumptions),
    }


def _known(component: str) -> None:
    if component not in COMPONENTS:
        raise ValueError(f"--component must be one of {', '.join(COMPONENTS)}, not {component}")
