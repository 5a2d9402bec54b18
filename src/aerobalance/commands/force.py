"""The command force."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

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
from aerobalance.dynamics import Dynamics
from aerobalance.estimate import ForceEstimate, with_balance
from aerobalance.force import Method, reconstruct, without_hum
from aerobalance.hum import Hum
from aerobalance.io import (
    check_output,
    write_force,
)
from aerobalance.io.dynamics_file import read_dynamics
from aerobalance.loads import static_uncertainty
from aerobalance.misfit import misfit_of
from aerobalance.monte_carlo import MonteCarlo, monte_carlo
from aerobalance.motion import GroundMotion
from aerobalance.problems import DoubtWarning, FitError
from aerobalance.recording import Force, Recording

DEFAULT_SEED = 1
"""Seed of Monte Carlo where none is given, so that the same inputs give the same result."""


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
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
    check: Check | None = None,
    report: Path | None = None,
) -> Account:
    """Force applied, with its uncertainty, from the loads felt or, with a balance, from its gauge outputs."""
    check_output(out)
    inputs = [item for item in (path, dynamics, channel_map, *(() if files is None else files.paths)) if item]
    check_out(out, *inputs)
    check_out(report, *inputs, out)
    known = read_dynamics(dynamics)
    with doubts() as collected:
        recording = recording_of(path, channel_map)
        reduction = None
        if files is not None:
            recording, reduction = from_gauges(recording, files, known, gravity=gravity, channel_map=channel_map)
        names = [name for name in known if name in recording]
        if not names:
            raise FitError(
                f"{path} has none of the components of {dynamics} ({', '.join(known)}); "
                f"it has {', '.join(recording.channels) or 'no channels'}"
            )
        estimates = {
            name: reconstruct(
                recording,
                known[name],
                method=method,
                bandwidth=bandwidth,
                gravity=gravity,
                gravity_uncertainty=gravity_uncertainty,
                hum=hum,
            )
            for name in names
        }
        if reduction is not None:
            forces = {name: estimate.values for name, estimate in estimates.items()}
            static = static_uncertainty(reduction.felt, reduction.matrix, forces=forces)
            estimates = {name: with_balance(estimate, static[name]) for name, estimate in estimates.items()}
        for name, estimate in estimates.items():
            quiet = without_hum(recording, estimate)
            misfit = misfit_of(quiet, known[name], noise=estimate.noise, steps=estimate.steps)
            for text in misfit.sentences(known[name]):
                warnings.warn(f"{recording.name}: {text}", DoubtWarning, stacklevel=2)
        checked = {}
        if check is not None:
            settings = Settings(method, bandwidth, gravity, gravity_uncertainty)
            checked = {
                name: _checked(recording, known[name], estimate, check=check, settings=settings)
                for name, estimate in estimates.items()
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
    origins = Origins(recording, dynamics, None if files is None else files.balance)
    components = {name: force_account(estimate, origins) for name, estimate in estimates.items()}
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


def hum_of(text: str) -> Hum:
    """What is to be taken for hum, from the words of the command line."""
    if text in ("mains", "keep"):
        return "mains" if text == "mains" else "keep"
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--hum must be mains, keep or frequencies in Hz such as 50,100, not {text}") from None


class Settings(NamedTuple):
    """How the force is worked out.

    Attributes
    ----------
    method, bandwidth
        As `aerobalance.force.reconstruct` takes them.
    gravity, gravity_uncertainty
        Local acceleration of gravity and its standard uncertainty [m/s^2].
    """

    method: Method
    bandwidth: float | None
    gravity: float
    gravity_uncertainty: float


def _checked(
    recording: Recording, dynamics: Dynamics, estimate: ForceEstimate, *, check: Check, settings: Settings
) -> MonteCarlo:
    """Check one component's uncertainty by Monte Carlo, and warn where it differs."""
    found = monte_carlo(
        recording,
        dynamics,
        estimate,
        motion=GroundMotion.of(
            recording,
            estimate.component,
            gravity=settings.gravity,
            gravity_uncertainty=settings.gravity_uncertainty,
        ),
        draws=check.draws,
        seed=check.seed,
        method=settings.method,
        bandwidth=settings.bandwidth,
    )
    for text in found.doubts:
        warnings.warn(f"{recording.name}: {estimate.component}: {text}", DoubtWarning, stacklevel=2)
    return found


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
