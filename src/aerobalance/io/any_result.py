"""Any result, written as the file that `aerobalance.io.anything` reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Final

from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.calibration.quality import assess
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.weighing.result import Weighing
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import AnyDynamics, IndependentDynamics, dynamics_of
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.io import write_recording
from aerobalance.io.balance_file import calibration_payload, write_balance
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.io.mass_file import write_weighing
from aerobalance.io.results_file import force_columns, load_columns, writing
from aerobalance.recording.recording import Recording

ARTEFACT: Final = ".json"
"""Ending of files of matrices, weighings and dynamics."""

Artefact = Calibration | BalanceMatrix | Weighing | AnyDynamics
"""What is written as JSON."""

Result = Recording | Loads | Force | Artefact
"""What has a file."""


def write(path: Path | str, result: Result, *, inputs: Sequence[Path | str] = ()) -> Path:
    """Write a result as the file that the command which finds it writes, and return its path.

    A file that exists is replaced.

    Parameters
    ----------
    path
        The file. Calibrations, matrices, weighings and dynamics are JSON; of recordings, loads and forces the ending
        chooses the format.
    result
        What to write. Loads and forces stand beside the time, each followed by its standard uncertainty.
    inputs
        Files that it was found from; JSON keeps their names and SHA-256.

    Raises
    ------
    TypeError
        The path is not one.
    ValueError
        The result is none of these, the ending is not one of its formats, or the file cannot be written.
    """
    if not isinstance(path, str | PathLike):
        raise TypeError(f"the path of the file comes first, write(path, result); it is no {type(path).__name__}")
    file = Path(path)
    if isinstance(result, Recording):
        write_recording(file, result)
    elif isinstance(result, Loads | Force):
        _write_table(file, result)
    else:
        _write_artefact(file, result, [Path(one) for one in inputs])
    return file


def _write_table(file: Path, result: Loads | Force) -> None:
    recording = result.recording
    every = slice(0, recording.samples)
    with writing(file, samples=recording.samples, epoch=recording.epoch) as append:
        if isinstance(result, Loads):
            append(load_columns(file, recording, every, result))
            return
        values = {name: part.values for name, part in result.items()}
        append(
            force_columns(file, recording, every, values, {name: part.uncertainty for name, part in result.items()})
        )


def _write_artefact(file: Path, result: Artefact, inputs: list[Path]) -> None:
    if file.suffix.lower() != ARTEFACT:
        raise ValueError(f"{file}: calibrations, matrices, weighings and dynamics are written as {ARTEFACT}")
    if isinstance(result, Calibration):
        found = calibration_payload(result, assess(result))
        write_balance(file, result.matrix, found=found, inputs=inputs)
    elif isinstance(result, BalanceMatrix):
        write_balance(file, result, found={}, inputs=inputs)
    elif isinstance(result, Weighing):
        write_weighing(file, result, inputs=inputs)
    else:
        write_dynamics(file, _dynamics(result), inputs=inputs)


def _dynamics(result: AnyDynamics) -> CoupledDynamics | IndependentDynamics:
    """Dynamics of n components.

    Raises
    ------
    ValueError
        The result is nothing that has a file.
    """
    if isinstance(result, Dynamics | Mapping | Sequence | BalanceDynamics) or hasattr(result, "dynamics"):
        found = dynamics_of(result)
        if isinstance(found, CoupledDynamics | IndependentDynamics):
            return found
    raise ValueError(
        f"{type(result).__name__} has no file; Recording, Loads, Force, Calibration, BalanceMatrix, Weighing and "
        "dynamics have"
    )
