"""Static points for weighing, from tables of points and from recordings alike."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from aerobalance.io import column_names, read, read_table
from aerobalance.io.channel_map import ChannelMap
from aerobalance.problems import ReadError
from aerobalance.weighing import StaticPoints, points_from_recordings


def read_points(paths: Sequence[Path | str], component: str, *, channel_map: ChannelMap | None = None) -> StaticPoints:
    """Read static points of one component from files.

    A file with a column ``time`` (or any file, with a channel map) is a recording and gives one point for every
    stretch of steady pitch; any other is a table of points ``pitch [deg],AF [N]`` with, where known, ``roll [deg]``
    and ``u_AF [N]``.

    Parameters
    ----------
    paths
        The files.
    component
        Which component to take.
    channel_map
        What the columns of foreign files are.

    Returns
    -------
    StaticPoints
        All points, in the order of the files; the noise is zero where a table does not give it.

    Raises
    ------
    ReadError
        A file is neither, or has roll where another has not.
    FitError
        A recording has no pitch or no such component, or nowhere stands still.
    ValueError
        No files are given.
    """
    if not paths:
        raise ValueError("no files to take points from; give at least one")
    parts = [_points(Path(path), component, channel_map) for path in paths]
    with_roll = [part.roll is not None for part in parts]
    if any(with_roll) and not all(with_roll):
        lacking, having = (Path(paths[with_roll.index(state)]) for state in (False, True))
        raise ReadError(lacking, "", f"has no roll, but {having.name} has; give it in all files or in none")
    rolls = [part.roll for part in parts if part.roll is not None]
    return StaticPoints(
        np.concatenate([part.pitch for part in parts]),
        np.concatenate([part.load for part in parts]),
        np.concatenate(rolls) if rolls else None,
        np.concatenate([part.noise for part in parts]),
    )


def _points(path: Path, component: str, channel_map: ChannelMap | None) -> StaticPoints:
    if channel_map is not None or _is_recording(path):
        return points_from_recordings([read(path, channel_map=channel_map)], component)
    table = read_table(path, required=("pitch", component))
    uncertainty = f"u_{component}"
    noise = table.values(uncertainty) if uncertainty in table else np.zeros(table.values("pitch").size)
    if (noise < 0).any():
        line = table.lines[int(np.flatnonzero(noise < 0)[0])]
        raise ReadError(
            path, f"line {line}, {table.column(uncertainty).place}", "is negative; zero or more is allowed"
        )
    return StaticPoints(
        table.values("pitch"), table.values(component), table.values("roll") if "roll" in table else None, noise
    )


def _is_recording(path: Path) -> bool:
    """Whether a file has a time column; a format that is no text is a recording."""
    try:
        return "time" in column_names(path)
    except ReadError:
        return True
