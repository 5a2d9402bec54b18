"""The command force."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.known import Check, Coupled, Known, Settings, read_known
from aerobalance.app.commands.loads import Reduction, Source, loads_account
from aerobalance.app.commands.shared import Account, check_out, doubts
from aerobalance.app.commands.uncertainty import (
    Origins,
    budget_account,
    budget_rms,
    budget_text,
    force_text,
    monte_carlo_account,
    scalar_account,
)
from aerobalance.balance.calibration_nonlinearity import CurvatureErrors
from aerobalance.balance.loads import static_uncertainty
from aerobalance.estimation.force import Method
from aerobalance.estimation.record import ForceEstimate, with_balance
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.io import check_output, write_force
from aerobalance.io.artefacts import digest
from aerobalance.io.kinds import PAGE, TABLE
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY, is_gauge, si_unit
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.recording import GAUGES_BECOME_LOADS, Force, Recording
from aerobalance.uncertainty.monte_carlo import MonteCarlo


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
    known = read_known(dynamics)
    settings = Settings(method, bandwidth, gravity, gravity_uncertainty, hum)
    source = Source(known, files, gravity, channel_map)
    inputs = [path, dynamics, *source.paths, *([] if noise_record is None else [noise_record])]
    check_out(out, *inputs, kind=TABLE)
    check_out(report, *inputs, out, kind=PAGE)
    with doubts() as collected:
        if files is not None:
            source = source._replace(known=_through(files.balance, known, dynamics=dynamics))
        found = _found(path, source, settings, noise_record=noise_record, check=check)
    recording, estimates, reduction = found.recording, found.estimates, found.reduction
    write_force(out, recording, _force_of(estimates, recording))
    origins = Origins(recording, dynamics, None if files is None else files.balance)
    account: Account = {
        "written": out.name,
        "components": {name: found.account(name, origins) for name in estimates},
        "components_without_dynamics": [name for name in COMPONENTS if name in recording and name not in estimates],
        **({} if reduction is None else {"loads": loads_account(reduction.felt, reduction.matrix)}),
        "warnings": collected,
    }
    if report is not None:
        from aerobalance.app.reports.force_report import write_force_report  # noqa: PLC0415 - plotting is slow

        write_force_report(report, account, estimates, recording=recording, inputs=inputs)
        account["report"] = report.name
    account["file"] = path.name
    return {**account, "summary": force_text(account), "details": budget_text(account["components"])}


def _through(balance: Path, known: Known, *, dynamics: Path) -> Known:
    """Dynamics for loads by a balance matrix: what another matrix left in them is not in these loads as well."""
    if not isinstance(known, Coupled) or not known.dynamics.covariance_of_calibration.any():
        return known
    if known.dynamics.balance == digest(balance):
        return known
    warn_quality(
        f"{dynamics.name} was found by another balance matrix than {balance.name}; what the calibration of that one "
        "left in the dynamics is added to the uncertainty"
    )
    return Coupled(known.dynamics.with_calibration)


class _Found(NamedTuple):
    """The forces of a recording, and what else was found on the way, by component."""

    recording: Recording
    reduction: Reduction | None
    estimates: dict[str, ForceEstimate]
    noises: dict[str, NoiseSpectrum]
    checked: dict[str, MonteCarlo]

    def account(self, name: str, origins: Origins) -> Account:
        """Plain data on one component."""
        account = force_account(self.estimates[name], origins)
        if name in self.noises:
            account["noise_spectrum"] = noise_account(self.noises[name])
        if name in self.checked:
            account["monte_carlo"] = monte_carlo_account(self.checked[name])
        return account


def _found(
    path: Path, source: Source, settings: Settings, *, noise_record: Path | None, check: Check | None
) -> _Found:
    """Work out the forces; what is doubtful is warned of."""
    known = source.known
    recording, reduction = source.recording(path)
    if not known.names_in(recording):
        gauges = any(is_gauge(name) for name in recording.channels)
        raise FitError(
            f"{path} has none of the components of the dynamics, {', '.join(known.components)}; it has "
            f"{', '.join(recording.channels) or 'no channels'}" + (f"; {GAUGES_BECOME_LOADS}" if gauges else "")
        )
    noises = {}
    if noise_record is not None:
        noises = known.noises(source.recording(noise_record)[0], settings, run=recording)
    estimates = known.forces(recording, settings, noises=noises)
    if reduction is not None:
        estimates = _with_matrix(estimates, reduction, known, rate=recording.rate)
    texts = known.doubts(recording, estimates)
    checked = {} if check is None else known.checked(recording, estimates, settings, check=check)
    texts += [f"{name}: {text}" for name, result in checked.items() for text in result.doubts]
    for text in texts:
        warn_quality(f"{recording.name}: {text}")
    return _Found(recording, reduction, estimates, noises, checked)


def _with_matrix(
    estimates: Mapping[str, ForceEstimate], reduction: Reduction, known: Known, *, rate: float
) -> dict[str, ForceEstimate]:
    """Add what is not known of the balance matrix to the uncertainty."""
    felt, matrix = reduction.felt, reduction.matrix
    static = static_uncertainty(felt, matrix, forces={name: found.values for name, found in estimates.items()})
    highest = max(found.bandwidth for found in estimates.values())
    curvature = CurvatureErrors.of(felt, matrix, rate=rate, highest=highest)
    names = list(estimates)
    densities = curvature.in_force(known.ringing(names, curvature.resolved), names)
    return {
        name: with_balance(
            found,
            np.hypot(static[name], curvature.offset(name)),
            curvature=curvature.as_noise(density, bandwidth=found.bandwidth),
        )
        for (name, found), density in zip(estimates.items(), densities.T, strict=True)
    }


def _force_of(estimates: Mapping[str, ForceEstimate], recording: Recording) -> Force:
    parts = list(estimates.values())
    return Force(
        components=tuple(estimates),
        values=np.column_stack([part.values for part in parts]),
        uncertainty=np.column_stack([part.uncertainty for part in parts]),
        rate=recording.rate,
    )


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
        **budget_account(estimate, origins),
    }
