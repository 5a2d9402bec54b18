"""The command force."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.loads import LoadSource, loads_result
from aerobalance.app.commands.shared import Result, check_out, collected_warnings
from aerobalance.app.commands.uncertainty import (
    Origins,
    budget_result,
    budget_rms,
    budget_text,
    force_text,
    monte_carlo_result,
    scalar_result,
)
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import IndependentDynamics, dynamics_of
from aerobalance.estimation.force import Force, ForceSettings, estimate_force
from aerobalance.estimation.result import ComponentForce
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.io import check_output, write_force
from aerobalance.io.artefacts import digest
from aerobalance.io.dynamics_file import read_any_dynamics
from aerobalance.io.kinds import PAGE, TABLE
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.errors import warn_quality
from aerobalance.uncertainty.monte_carlo import MonteCarlo, monte_carlo
from aerobalance.validation.model_check import contradictions

DEFAULT_SEED: Final = 1
"""Seed of Monte Carlo where none is given, so that the same inputs give the same result."""


class Check(NamedTuple):
    """A Monte Carlo check that is wanted.

    Attributes
    ----------
    draws
        Number of draws.
    seed
        Seed that they come from.
    """

    draws: int
    seed: int = DEFAULT_SEED


def force(
    path: Path,
    out: Path,
    *,
    dynamics: Path,
    settings: ForceSettings | None = None,
    noise_record: Path | None = None,
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
    check: Check | None = None,
    report: Path | None = None,
) -> Result:
    """Force applied, with its uncertainty, from balance loads or, with a balance, from gauge outputs."""
    check_output(out)
    known = dynamics_of(read_any_dynamics(dynamics))
    settings = ForceSettings() if settings is None else settings
    source = LoadSource(known, files, settings.gravity, channel_map)
    inputs = [path, dynamics, *source.paths, *([] if noise_record is None else [noise_record])]
    check_out(out, *inputs, kind=TABLE)
    check_out(report, *inputs, out, kind=PAGE)
    with collected_warnings() as collected:
        if files is not None:
            source = source._replace(known=_through(files.balance, known, dynamics=dynamics))
        calm = None if noise_record is None else source.read(noise_record)
        found = estimate_force(source.read(path), source.known, noise=calm, **asdict(settings))
        for text in contradictions(found):
            warn_quality(f"{found.recording.name}: {text}")
        checked = {} if check is None else monte_carlo(found, draws=check.draws, seed=check.seed)
        for name, trial in checked.items():
            for text in trial.doubts:
                warn_quality(f"{found.recording.name}: {name}: {text}")
    recording = found.recording
    write_force(out, recording, found)
    origins = Origins(recording, dynamics, None if files is None else files.balance)
    result: Result = {
        "written": out.name,
        "components": {name: _component_result(found, name, origins, checked.get(name)) for name in found},
        "components_without_dynamics": [name for name in COMPONENTS if name in recording and name not in found],
        **({} if found.loads is None else {"loads": loads_result(found.loads)}),
        "warnings": collected,
    }
    if report is not None:
        from aerobalance.app.reports.force_report import write_force_report  # noqa: PLC0415 - plotting is slow

        write_force_report(report, result, found, inputs=inputs)
        result["report"] = report.name
    result["file"] = path.name
    return {**result, "summary": force_text(result), "details": budget_text(result["components"])}


def _component_result(found: Force, name: str, origins: Origins, checked: MonteCarlo | None) -> Result:
    """Plain data on one component."""
    result = force_result(found[name], origins)
    if name in found.noises:
        result["noise_spectrum"] = noise_result(found.noises[name])
    if checked is not None:
        result["monte_carlo"] = monte_carlo_result(checked)
    return result


def _through(
    balance: Path, known: IndependentDynamics | CoupledDynamics, *, dynamics: Path
) -> IndependentDynamics | CoupledDynamics:
    """Dynamics for loads by a balance matrix: what another matrix left in them is not in these loads as well."""
    if not isinstance(known, CoupledDynamics) or not known.covariance_of_calibration.any():
        return known
    if known.balance == digest(balance):
        return known
    warn_quality(
        f"{dynamics.name} was found by another balance matrix than {balance.name}; what the calibration of that one "
        "left in the dynamics is added to the uncertainty"
    )
    return known.with_calibration


def noise_result(spectrum: NoiseSpectrum) -> Result:
    """Plain data on a spectrum of noise."""
    return {
        "text": str(spectrum),
        "white": {
            "value": spectrum.white,
            "u": spectrum.u_white * spectrum.white,
            "unit": "unit of the load squared per Hz, two-sided",
        },
        "corner": {"value": spectrum.corner, "unit": "Hz"},
        "exponent": {"value": spectrum.exponent, "u": float(np.sqrt(spectrum.covariance[1, 1]))},
        "humps": [
            {"frequency": hump.frequency, "relative_width": hump.width, "level": hump.level} for hump in spectrum.humps
        ],
        "lines_left_out": list(spectrum.left_out),
    }


def hum_of(text: str) -> Hum:
    """What is to be taken for hum, from the words of the command line."""
    if text in ("mains", "keep"):
        return "mains" if text == "mains" else "keep"
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--hum must be mains, keep or frequencies in Hz such as 50,100, not {text}") from None


def force_result(estimate: ComponentForce, origins: Origins) -> Result:
    """Plain data on one component's force; instants are on the recording's own clock."""
    start = origins.recording.start
    unit = si_unit(estimate.component)
    return {
        "unit": unit,
        "method": estimate.method,
        **scalar_result(estimate, origins.recording),
        "uncertainty_rms": float(np.sqrt(np.mean(estimate.uncertainty**2))),
        "uncertainty_budget_rms": budget_rms(estimate),
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
        "hum": [
            {"frequency": line.frequency, "u_frequency": line.u_frequency, "amplitude_in_reading": line.amplitude}
            for line in estimate.hum
        ],
        "assumptions": list(estimate.assumptions),
        **budget_result(estimate, origins),
    }
