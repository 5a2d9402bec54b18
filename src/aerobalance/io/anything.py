"""Any file of a test, read as what it holds: a recording, a balance matrix, a weighing, or dynamics."""

from __future__ import annotations

from pathlib import Path

from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.weighing.result import Weighing
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.io import load_channel_map
from aerobalance.io import read as read_recording
from aerobalance.io.balance_file import is_matrix, read_matrix
from aerobalance.io.channel_map import ChannelMap
from aerobalance.io.dynamics_file import read_any_dynamics
from aerobalance.io.kinds import kind_of
from aerobalance.io.mass_file import read_weighing
from aerobalance.recording.errors import ReadError
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected


def read(
    path: Path | str, *, channel_map: ChannelMap | Path | str | None = None
) -> Recording | BalanceMatrix | Weighing | BalanceDynamics:
    """Recording, balance matrix, weighing or dynamics of a file, told by its content.

    Parameters
    ----------
    path
        A recording of any format that is known, the matrix of ``calibrate`` or BALFIT, the mass.json of ``weigh``, or
        the dynamics.json of ``identify``. A load schedule is read by `read_schedule`.
    channel_map
        Channel map of a recording whose headers do not say what is what, or its file (TOML).

    Returns
    -------
    object
        A recording is in SI units (gauge outputs in mV/V), and what its sensors do to the readings is undone.

    Raises
    ------
    ReadError
        The file cannot be used; the message says where and what is allowed.
    """
    file = Path(path)
    if not file.exists():
        raise ReadError(file, "", "there is no such file")
    kind = kind_of(file)
    if channel_map is None:
        if kind == "mass":
            return read_weighing(file)
        if kind == "dynamics":
            return read_any_dynamics(file)
        if kind == "balance" or is_matrix(file):
            return read_matrix(file)
    if isinstance(channel_map, Path | str):
        channel_map = load_channel_map(Path(channel_map))
    return corrected(read_recording(file, channel_map=channel_map))
