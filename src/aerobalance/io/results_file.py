"""Files of forces and of loads, written as they are found: rows after rows, whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from aerobalance.balance.loads import Loads
from aerobalance.io import check_output, csv_file, writer_of, writing_of
from aerobalance.io.columns import Append
from aerobalance.io.recording_columns import channel_column, time_column
from aerobalance.recording.channel import Array
from aerobalance.recording.components import is_gauge, si_unit
from aerobalance.recording.recording import Recording
from aerobalance.recording.units import conversion


@contextmanager
def writing(path: Path | str, *, samples: int, epoch: np.datetime64 | None = None) -> Iterator[Append]:
    """Write the columns of a file, which takes its place when all rows are written.

    Parameters
    ----------
    path
        The file; its ending chooses the format.
    samples
        Rows that it will have, nearly.
    epoch
        Date and time at which the time is zero, kept where the format has a place for it; None where it is not known.

    Yields
    ------
    Append
        Takes the next rows of all columns, by header.

    Raises
    ------
    ValueError
        The ending stands for no format, or the file cannot be written.
    """
    file = check_output(path)
    with ExitStack() as stack:
        begun: list[Append] = []

        def append(columns: Mapping[str, Array]) -> None:
            if not begun:
                begin = writing_of(file)(file, list(columns), epoch=epoch, rows=samples)
                begun.append(stack.enter_context(begin))
            begun[0](columns)

        yield append


def rows_of(recording: Recording, own: slice) -> slice:
    """Rows of a recording that belong to some of its samples."""
    return slice(*(int(place) for place in np.searchsorted(recording.rows, (own.start, own.stop))))


def force_columns(
    path: Path, recording: Recording, own: slice, values: Mapping[str, Array], uncertainty: Mapping[str, Array]
) -> dict[str, Array]:
    """Return the rows of applied forces, beside the time column of their recording.

    Each component keeps its name and the unit it had in the recording's file, and is followed by its standard
    uncertainty: ``time [s],AF [N],u_AF [N]``.

    Parameters
    ----------
    path
        The file that they are for.
    recording
        The recording that the force was computed from.
    own
        Those of its samples that the rows are of.
    values, uncertainty
        Force and uncertainty by component, at these samples.

    Raises
    ------
    ValueError
        The force is not of these samples.
    """
    rows = rows_of(recording, own)
    columns = time_column(recording, rows)
    places = recording.rows[rows] - own.start
    for name, force in values.items():
        if force.size != own.stop - own.start:
            raise ValueError(f"the force has {force.size} samples, the recording {own.stop - own.start}")
        inside = si_unit(name)
        unit = (recording.channels[name].file_unit if name in recording else "") or inside
        change = conversion(unit, expected=inside)
        u = change.outside(uncertainty[name][places])
        columns |= _result(path, f"{name} [{unit}]", change.outside(force[places]), u, least=u)
    return columns


def load_columns(path: Path, recording: Recording, own: slice, felt: Loads) -> dict[str, Array]:
    """Return the rows of balance loads, beside the time column and the channels that were no gauge outputs.

    Each load is followed by its standard uncertainty: ``time [s],NF [N],u_NF [N]``; the recording's pitch,
    accelerations and other channels come after, so that the file can go on to `force`.

    Parameters
    ----------
    path
        The file that they are for.
    recording
        The recording that the loads were computed from.
    own
        Those of its samples that the rows are of.
    felt
        Loads on the recording's clock.
    """
    rows = rows_of(recording, own)
    columns, places = time_column(recording, rows), recording.rows[rows]
    uncertainty = felt.uncertainty
    for index, (name, unit) in enumerate(zip(felt.components, felt.units, strict=True)):
        values, u = felt.values[places, index], uncertainty[places, index]
        columns |= _result(path, f"{name} [{unit}]", values, u, least=np.append(u, felt.noise[index]))
    for channel in recording:
        if not is_gauge(channel.name) and channel.name != "excitation" and channel.name not in felt.components:
            columns |= channel_column(channel, recording, rows)
    return columns


def _result(path: Path, label: str, values: Array, u: Array, *, least: Array) -> dict[str, Array]:
    """Return a result and its standard uncertainty as columns: in a text with the digits that mean something."""
    digits = csv_file.digits_for(least) if writer_of(path) is csv_file else None
    kept = (values, u) if digits is None else (csv_file.rounded(values, digits), csv_file.rounded(u, digits))
    return {label: kept[0], f"u_{label}": kept[1]}
