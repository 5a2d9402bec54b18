"""The command force."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from aerobalance.balance import BalanceMatrix
from aerobalance.commands.loads import BalanceFiles, loads_account, reduced
from aerobalance.commands.shared import Account, check_out, doubts, recording_of
from aerobalance.components import COMPONENTS, STANDARD_GRAVITY, si_unit
from aerobalance.dynamics import Dynamics
from aerobalance.force import ForceEstimate, Method, reconstruct, with_balance
from aerobalance.io import (
    check_output,
    write_force,
)
from aerobalance.io.artefacts import (
    read_dynamics,
)
from aerobalance.loads import LoadsFelt, static_uncertainty, with_loads
from aerobalance.motion import gravity_share
from aerobalance.problems import DoubtWarning, FitError
from aerobalance.recording import Force, Recording


def force(
    path: Path,
    out: Path,
    *,
    dynamics: Path,
    method: Method = "smoother",
    bandwidth: float | None = None,
    gravity: float = STANDARD_GRAVITY,
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
) -> Account:
    """Force applied, with its uncertainty, from the loads felt or, with a balance, from its gauge outputs."""
    check_output(out)
    check_out(out, path, dynamics, channel_map, *(() if files is None else files.paths))
    known = read_dynamics(dynamics)
    with doubts() as collected:
        recording = recording_of(path, channel_map)
        reduction = None
        if files is not None:
            recording, reduction = _from_gauges(recording, files, known, gravity=gravity, channel_map=channel_map)
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
        if reduction is not None:
            forces = {name: estimate.values for name, estimate in estimates.items()}
            static = static_uncertainty(reduction.felt, reduction.matrix, forces=forces)
            estimates = {name: with_balance(estimate, static[name]) for name, estimate in estimates.items()}
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
        **({} if reduction is None else {"loads": loads_account(reduction.felt, reduction.matrix)}),
        "warnings": collected,
    }


class _Reduction(NamedTuple):
    felt: LoadsFelt
    matrix: BalanceMatrix


def _from_gauges(
    recording: Recording,
    files: BalanceFiles,
    known: Mapping[str, Dynamics],
    *,
    gravity: float,
    channel_map: Path | None,
) -> tuple[Recording, _Reduction]:
    """Put loads in the place of gauge outputs, with gravity counted once."""
    if files.mass is not None:
        raise ValueError("force takes the weight from the mass in the dynamics; --mass would take it off twice")
    felt, matrix = reduced(recording, files, channel_map=channel_map)
    ready = with_loads(recording, felt)
    if files.tare:
        return _without_gravity(ready), _Reduction(felt, matrix)
    if files.zero and not files.as_they_are:
        zeros = [recording_of(path, channel_map) for path in files.zero]
        ready = _with_weight_at_zero(ready, zeros, known, gravity=gravity)
    return ready, _Reduction(felt, matrix)


def _without_gravity(recording: Recording) -> Recording:
    """Drop the angles: the wind-off loads that were taken off have the weight in them."""
    for channel in recording:
        if channel.coupling == "dc":
            raise FitError(
                f"{recording.name}: {channel.name} is dc-coupled and reads gravity, which --tare has taken off too;"
                " give the zero with --zero and leave the weight to the dynamics"
            )
    channels = {name: channel for name, channel in recording.channels.items() if name not in ("pitch", "roll")}
    return replace(recording, channels=channels)


def _with_weight_at_zero(
    recording: Recording, zeros: Sequence[Recording], known: Mapping[str, Dynamics], *, gravity: float
) -> Recording:
    """Add the weight that the zero took off with it, as it was read with the model on."""
    channels = dict(recording.channels)
    for name, dynamics in known.items():
        if name not in channels:
            continue
        shares = []
        for zero in zeros:
            angles = {
                angle: zero.channel(angle).values if angle in zero else np.zeros(zero.samples)
                for angle in ("pitch", "roll")
            }
            shares.append(float(np.nanmean(gravity_share(name, pitch=angles["pitch"], roll=angles["roll"]))))
        weight = dynamics.mass * gravity * float(np.mean(shares))
        channels[name] = replace(channels[name], values=channels[name].values + weight)
    lacking = [zero.name for zero in zeros if "pitch" not in zero]
    if lacking and "pitch" in recording:
        warnings.warn(
            f"{lacking[0]} has no channel pitch; the zero is taken as read level, with the model on",
            DoubtWarning,
            stacklevel=3,
        )
    return replace(recording, channels=channels)


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
