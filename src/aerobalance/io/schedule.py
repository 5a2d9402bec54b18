"""Load schedules of calibrations: one format a module, recognised by content."""

from __future__ import annotations

from pathlib import Path

from aerobalance.balance.schedule import Schedule
from aerobalance.io import balfit_file, schedule_table, vol_file
from aerobalance.io.balfit_file import write_balfit_schedule
from aerobalance.io.channel_map import ChannelMap, load_channel_map
from aerobalance.io.load_columns import Capacities
from aerobalance.io.sheet_cells import is_workbook
from aerobalance.io.text_table import read_text
from aerobalance.recording.errors import ReadError

__all__ = ["Capacities", "read_schedule", "write_balfit_schedule"]


def read_schedule(
    path: Path | str, *, capacities: Capacities | None = None, channel_map: ChannelMap | Path | str | None = None
) -> Schedule:
    """Read the load schedule of a calibration: a ``.vol`` file, a BALFIT file, a text table or an .xlsx workbook.

    The format is recognised by what the file holds, not by its name.

    Parameters
    ----------
    path
        The file.
    capacities
        Largest allowed load by component, value and unit, such as ``{"N1": (100.0, "lbf")}``; goes before what the
        file says.
    channel_map
        Which column of a table or workbook is what, or the channel map (TOML) that says it; None for a file whose
        header says it.

    Returns
    -------
    Schedule
        Loads in N and N*m, outputs in mV/V; `Schedule.assumptions` says what had to be taken for granted.

    Raises
    ------
    ReadError
        The file is no load schedule; the message says where and what is allowed.
    ValueError
        `capacities` does not fit the file's loads.

    Warns
    -----
    DataQualityWarning
        The file is cut off, or what it says contradicts itself.
    """
    file = Path(path)
    if isinstance(channel_map, str | Path):
        channel_map = load_channel_map(Path(channel_map))
    if channel_map is not None or is_workbook(file):
        return schedule_table.read_table_schedule(file, capacities=capacities, channel_map=channel_map)
    text = read_text(file)
    if vol_file.can_read(text):
        return vol_file.read_vol(file, text, capacities=capacities)
    if balfit_file.can_read(text):
        return balfit_file.read_balfit(file, text, capacities=capacities)
    try:
        return schedule_table.read_table_schedule(file, capacities=capacities)
    except ReadError as error:
        if error.where != "header":
            raise
        others = f"{vol_file.NAME} and {balfit_file.NAME}"
        what = f"{error.what}. It is read as a {schedule_table.NAME}; recognised by their first lines: {others}"
        raise ReadError(file, error.where, what) from None
