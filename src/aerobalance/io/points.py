"""Static points for weighing, from tables of points and from recordings alike."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from aerobalance.balance.weighing import LoadPoints, points_from_recordings
from aerobalance.io import read, read_table, states_times
from aerobalance.io.channel_map import ChannelMap
from aerobalance.io.table import Table
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, loads_hint
from aerobalance.recording.errors import FitError, ReadError

Names = tuple[str, ...]


def read_points(
    paths: Sequence[Path | str], components: Sequence[str] | None = None, *, channel_map: ChannelMap | None = None
) -> LoadPoints:
    """Return static loads [N, N*m] and their attitudes [rad] from files.

    A file with a column ``time`` (or any file, with a channel map) is a recording and gives one point for every
    stretch of steady pitch and roll; any other is a table of points ``pitch [deg],AF [N]`` with, where known,
    ``roll [deg]`` and ``u_AF [N]``.

    Parameters
    ----------
    paths
        The files.
    components
        Which loads to take; all that the files have if left out.
    channel_map
        What the columns of foreign files are.

    Returns
    -------
    LoadPoints
        All points, in the order of the files; the noise is zero where a table does not give it.

    Raises
    ------
    ReadError
        A file is neither, or has roll or a load where another has not.
    FitError
        A recording has no pitch or no such component, or nowhere stands still.
    ValueError
        No files are given.
    """
    if not paths:
        raise ValueError("no files to take points from; give at least one")
    names = None if components is None else tuple(components)
    files = [Path(path) for path in paths]
    parts = [_points(file, names, channel_map) for file in files]
    _check_alike(files, parts)
    rolls = [part.roll for part in parts if part.roll is not None]
    return LoadPoints(
        parts[0].components,
        np.concatenate([part.pitch for part in parts]),
        np.concatenate([part.loads for part in parts]),
        np.concatenate(rolls) if rolls else None,
        np.concatenate([_noise(part) for part in parts]),
    )


def _noise(points: LoadPoints) -> Array:
    return np.zeros_like(points.loads) if points.noise is None else points.noise


def _check_alike(files: Sequence[Path], parts: Sequence[LoadPoints]) -> None:
    """Refuse files of which some lack roll or a load that others have."""
    with_roll = [part.roll is not None for part in parts]
    if any(with_roll) and not all(with_roll):
        lacking, having = (files[with_roll.index(state)] for state in (False, True))
        raise ReadError(lacking, "", f"has no roll, but {having.name} has; give it in all files or in none")
    for component in COMPONENTS:
        there = [component in part.components for part in parts]
        if any(there) and not all(there):
            lacking, having = (files[there.index(state)] for state in (False, True))
            raise ReadError(
                lacking,
                "",
                f"has no {component}, but {having.name} has; give it in all files or in none, or name the one "
                "component to weigh with",
            )


def _points(path: Path, names: Names | None, channel_map: ChannelMap | None) -> LoadPoints:
    if channel_map is not None or _is_recording(path):
        recording = read(path, channel_map=channel_map)
        return points_from_recordings([recording], _loads_of(path, recording.channels) if names is None else names)
    table = read_table(path, required=("pitch", *(names or ())))
    return _from_table(table, _loads_of(path, table.columns) if names is None else names)


def _loads_of(path: Path, there: Iterable[str]) -> Names:
    """Return the loads among the names of columns."""
    given = list(there)
    names = tuple(component for component in COMPONENTS if component in given)
    if not names:
        raise FitError(
            f"{path.name}: has none of the loads {', '.join(COMPONENTS)}; it has {', '.join(given)}{loads_hint(given)}"
        )
    return names


def _from_table(table: Table, names: Names) -> LoadPoints:
    noise = np.zeros((table.values("pitch").size, len(names)))
    for column, name in enumerate(names):
        uncertainty = f"u_{name}"
        if uncertainty in table:
            noise[:, column] = table.values(uncertainty)
            negative = np.flatnonzero(noise[:, column] < 0)
            if negative.size:
                where = f"line {table.lines[int(negative[0])]}, {table.column(uncertainty).place}"
                raise ReadError(table.path, where, "is negative; zero or more is allowed")
    return LoadPoints(
        names,
        table.values("pitch"),
        np.column_stack([table.values(name) for name in names]),
        table.values("roll") if "roll" in table else None,
        noise,
    )


def _is_recording(path: Path) -> bool:
    """Whether a file has a time column; a format that is no text is a recording."""
    try:
        return states_times(path)
    except ReadError:
        return True
