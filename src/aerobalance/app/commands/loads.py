"""The command loads, and the loads that force and compare begin with where gauge outputs were recorded."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from aerobalance.app.commands.answers import rounded, short
from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.shared import Result, check_out, collected_warnings, recording_of, table_text
from aerobalance.balance.inversion import TOLERANCE
from aerobalance.balance.load_formats import Form
from aerobalance.balance.loads import Loads
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import IndependentDynamics
from aerobalance.io import check_output, write_loads
from aerobalance.io.balance_file import read_matrix, write_balance
from aerobalance.io.balfit_matrix import write_balfit_matrix
from aerobalance.io.kinds import TABLE
from aerobalance.recording.recording import Recording


def convert_matrix(path: Path, out: Path) -> Result:
    """Write a matrix in the other layout: balance.json as BALFIT's text, or that as balance.json."""
    check_out(out, path, kind="balance" if out.suffix.lower() == ".json" else "")
    with collected_warnings() as collected:
        matrix = read_matrix(path)
    if out.suffix.lower() == ".json":
        write_balance(out, matrix, found={}, inputs=[path], warnings=collected)
    else:
        write_balfit_matrix(out, matrix, description=f"from {path.name}")
    names = list(matrix.components)
    said = f"{path.name}: balance matrix of {', '.join(names)}\n"
    return {"file": path.name, "written": out.name, "components": names, "warnings": collected, "summary": said}


class LoadSource(NamedTuple):
    """How a file becomes balance loads.

    Attributes
    ----------
    known
        The dynamics, whose mass carries the weight.
    files
        The balance with its zeros and tares; None where recordings hold loads already.
    gravity
        Local acceleration of gravity [m/s^2].
    channel_map
        Channel map of foreign files.
    """

    known: IndependentDynamics | CoupledDynamics
    files: BalanceFiles | None
    gravity: float
    channel_map: Path | None

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files that take part beside the recordings."""
        balance = () if self.files is None else self.files.paths
        return balance if self.channel_map is None else (*balance, self.channel_map)

    def read(self, path: Path) -> Recording | Loads:
        """Read a recording; gauge outputs become balance loads."""
        recording = recording_of(path, self.channel_map)
        if self.files is None:
            return recording
        return self.files.loads(recording, model=self.known, gravity=self.gravity, channel_map=self.channel_map)


def loads(
    path: Path, out: Path, *, files: BalanceFiles, form: Form | None = None, channel_map: Path | None = None
) -> Result:
    """Balance loads, from the gauge outputs of a recording."""
    check_output(out)
    check_out(out, path, channel_map, *files.paths, kind=TABLE)
    with collected_warnings() as collected:
        recording = recording_of(path, channel_map)
        felt = files.loads(recording, form=form, channel_map=channel_map)
    write_loads(out, recording, felt)
    result: Result = {"file": path.name, "written": out.name, **loads_result(felt), "warnings": collected}
    return {**result, "summary": summary(result)}


def summary(result: Result) -> str:
    """Short answer for people: the loads, and what there is to say of zero, range and missing samples."""
    rows = []
    for name, found in result["components"].items():
        u = found["u_calibration_rms"]
        means = (rounded(found[key], u)[0] for key in ("mean", "least", "largest", "rms_about_mean"))
        rows.append((f"{name} [{found['unit']}]", *means, rounded(u, u)[1], short(found["noise_of_reading"], 2)))
    title = f"{result['file']}: balance loads; u is the standard uncertainty by the calibration"
    lines = [table_text(title, ("", "mean", "least", "largest", "rms about mean", "u", "noise"), rows)]
    lines.append(f"zero: {result['zero']['from']}")
    if result["missing"]:
        lines.append(f"{result['missing']} samples are missing")
    beyond = ", ".join(f"{name} {count}" for name, count in result["beyond_calibrated_range"].items() if count)
    if beyond:
        lines.append(f"samples beyond the calibrated range: {beyond}")
    return "\n".join(lines) + "\n"


def loads_result(felt: Loads) -> Result:
    """Plain data on balance loads."""
    return {
        "components": {
            name: {
                "unit": felt.units[i],
                "mean": float(np.nanmean(felt.values[:, i])),
                "least": float(np.nanmin(felt.values[:, i])),
                "largest": float(np.nanmax(felt.values[:, i])),
                "rms_about_mean": float(np.nanstd(felt.values[:, i])),
                "noise_of_reading": float(felt.noise[i]),
                "u_calibration_rms": float(np.sqrt(np.nanmean(felt.calibration[:, i] ** 2))),
            }
            for i, name in enumerate(felt.components)
        },
        "zero": {
            "from": felt.zero.source,
            "outputs": dict(zip(felt.balance.gauges, felt.zero.values.tolist(), strict=True)),
            "drift": dict(zip(felt.balance.gauges, felt.zero.drift.tolist(), strict=True)),
            "unit": "mV/V",
        },
        "missing": int(np.count_nonzero(~np.isfinite(felt.values).all(axis=1))),
        "beyond_calibrated_range": dict(felt.beyond),
        "iteration": {"tolerance_of_capacity": TOLERANCE, "contraction": felt.contraction},
    }
