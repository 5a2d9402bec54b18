"""The command force."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from aerobalance.commands.known import Check, Settings, read_known
from aerobalance.commands.loads import BalanceFiles, from_gauges, loads_account
from aerobalance.commands.shared import Account, check_out, doubts, recording_of
from aerobalance.commands.uncertainty import (
    Origins,
    budget_account,
    monte_carlo_account,
    scalar_account,
    uncertainty_text,
)
from aerobalance.components import COMPONENTS, STANDARD_GRAVITY, si_unit
from aerobalance.estimate import ForceEstimate, with_balance
from aerobalance.force import Method
from aerobalance.hum import Hum
from aerobalance.io import (
    check_output,
    write_force,
)
from aerobalance.loads import static_uncertainty
from aerobalance.noise_spectrum import NoiseSpectrum
from aerobalance.problems import DoubtWarning, FitError
from aerobalance.recording import Force


def force(
    path: Path,
    out: Path,
    *,
    dynamics: Path,
    method: Method = "smoother",
    bandwidth: float | None = None,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
    hum: Hum = "mains",
    noise_record: Path | None = None,
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
    check: Check | None = None,
    report: Path | None = None,
) -> Account:
    """Force applied, with its uncertainty, from the loads felt or, with a balance, from its gauge outputs."""
    check_output(out)
    given = (path, dynamics, noise_record, channel_map, *(() if files is None else files.paths))
    inputs = [item for item in given if item]
    check_out(out, *inputs)
    check_out(report, *inputs, out)
    known = read_known(dynamics)
    settings = Settings(method, bandwidth, gravity, gravity_uncertainty, hum)
    with doubts() as collected:
        recording = recording_of(path, channel_map)
        reduction = None
        if files is not None:
            recording, reduction = from_gauges(recording, files, known, gravity=gravity, channel_map=channel_map)
        names = known.names_in(recording)
        if not names:
            raise FitError(
                f"{path} has none of the components of {dynamics}; it has "
                f"{', '.join(recording.channels) or 'no channels'}"
            )
        noises: dict[str, NoiseSpectrum] = {}
        if noise_record is not None:
            calm = recording_of(noise_record, channel_map)
            if files is not None:
                calm, _ = from_gauges(calm, files, known, gravity=gravity, channel_map=channel_map)
            noises = known.noises(calm, settings, run=recording)
        estimates = known.forces(recording, settings, noises=noises)
        if reduction is not None:
            forces = {name: estimate.values for name, estimate in estimates.items()}
            static = static_uncertainty(reduction.felt, reduction.matrix, forces=forces)
            estimates = {name: with_balance(estimate, static[name]) for name, estimate in estimates.items()}
        for text in known.doubts(recording, estimates):
            warnings.warn(f"{recording.name}: {text}", DoubtWarning, stacklevel=2)
        checked = {} if check is None else known.checked(recording, estimates, settings, check=check)
        for name, result in checked.items():
            for text in result.doubts:
                warnings.warn(f"{recording.name}: {name}: {text}", DoubtWarning, stacklevel=2)
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
    origins = Origins(recording, dynamics, None if files is None else files.balance)
    components = {name: force_account(estimate, origins) for name, estimate in estimates.items()}
    for name, spectrum in noises.items():
        components[name]["noise_spectrum"] = noise_account(spectrum)
    for name, result in checked.items():
        components[name]["monte_carlo"] = monte_carlo_account(result)
    account: Account = {
        "written": out.name,
        "components": components,
        "components_without_dynamics": left_out,
        **({} if reduction is None else {"loads": loads_account(reduction.felt, reduction.matrix)}),
        "warnings": collected,
    }
    if report is not None:
        from aerobalance.force_report import write_force_report  # noqa: PLC0415 - plotting is slow

        write_force_report(report, account, estimates, recording=recording, inputs=inputs)
        account["report"] = report.name
    return {**account, "summary": uncertainty_text(components)}


def noise_account(spectrum: NoiseSpectrum) -> Account:
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


def force_account(estimate: ForceEstimate, origins: Origins) -> Account:
    """Plain data on one component's force; instants are on the recording's own clock."""
    start = origins.recording.start
    unit = si_unit(estimate.component)
    return {
        "unit": unit,
        "method": estimate.method,
        **scalar_account(estimate, origins.recording),
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
        "hum": [
            {"frequency": line.frequency, "u_frequency": line.u_frequency, "amplitude_in_reading": line.amplitude}
            for line in estimate.hum
        ],
        "assumptions": list(estimate.assumptions),
        **budget_account(estimate, origins),
    }
