"""Test set-ups as the page uses them: of the rigs, of one record, and those that are replaced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from aerobalance.acquisition.setup import Record, SetChannel, Setup, load_setup, setup_from, stored_channels
from aerobalance.acquisition.source import SourceChannel
from aerobalance.acquisition.source_settings import CLOSED, HALF_RANGES, LARGEST_SHARE, SHUNT_SHARE, RigName, Simulated
from aerobalance.app.monitor.folder import Folder
from aerobalance.recording.errors import ReadError
from aerobalance.recording.units import conversion_for

SHAKEN: Final = {"frequency": 100.0, "amplitude": 30.0}
"""Drive of the vibration rig when the page opens it [Hz, N]: its motion stands out of the accelerometer's noise."""


def rig_setup(rig: RigName) -> Setup:
    """Return the set-up of a simulated rig as the page opens it."""
    source: dict[str, Any] = {"kind": "simulated", "rig": rig}
    if rig == "vibration":
        source |= SHAKEN
    source["circuit"] = "fouling"
    names = {"vibration": "vibration rig, 6F-540", "cable_cut": "cable cut, 6-EB-128-1", "six": "six components"}
    half_ranges = HALF_RANGES[rig]
    given: dict[str, Any] = {"name": f"simulated: {names[rig]}", "source": source}
    given["shunt"] = {name: {"change": SHUNT_SHARE * half} for name, half in half_ranges.items()}
    given["fouling"] = {"channel": "fouling", "level": CLOSED / 2}
    if rig == "six":
        given["limits"] = {
            name: {"low": -LARGEST_SHARE * half, "high": LARGEST_SHARE * half} for name, half in half_ranges.items()
        }
        given["envelope"] = {"shape": "ellipsoid"}
    return setup_from(given)


def setup_of_record(
    setup: Setup,
    given: Sequence[SourceChannel],
    *,
    zeros: Mapping[str, float],
    notes: str = "",
    seconds: float | None = None,
) -> Setup:
    """Return the set-up of one record: with its notes, its length, and the zeros as offsets of the channels.

    Parameters
    ----------
    setup
        The set-up of the test.
    given
        The channels of the source.
    zeros
        What is taken off each channel, SI.
    notes
        What the operator wrote.
    seconds
        Length of the record [s]; None for that of the set-up.
    """
    if notes:
        setup = setup.model_copy(update={"notes": f"{setup.notes}\n{notes}".strip()})
    if seconds is not None:
        record = Record.model_validate(setup.record.model_dump(exclude_unset=True) | {"seconds": seconds})
        setup = setup.model_copy(update={"record": record})
    if not zeros:
        return setup
    channels: dict[str, SetChannel] = {}
    for item in stored_channels(setup, given):
        channel = setup.channels.get(item.name) or SetChannel(input=item.input)
        zero = zeros.get(item.name, 0.0)
        if zero:
            own = float(conversion_for(item.name, item.unit).outside(zero))
            channel = channel.model_copy(update={"offset": channel.offset - channel.sign * own})
        channels[item.name] = channel
    return setup.model_copy(update={"channels": channels})


def check_files(setup: Setup, folder: Folder) -> None:
    """Refuse files outside the project folder.

    Raises
    ------
    ReadError
        One is; the message names its key.
    """
    wanted = {f"files.{key}": value for key, value in setup.files.model_dump(exclude_none=True).items()}
    source = setup.source.model_dump(exclude_none=True)
    wanted |= {f"source.{key}": source[key] for key in ("file", "map", "balance") if key in source}
    for key, value in wanted.items():
        try:
            folder.check(Path(value))
        except ValueError as problem:
            raise ReadError("set-up", key, str(problem)) from None


def first_controls(setup: Setup) -> dict[str, float]:
    """Return how the controls of the source stand when it begins."""
    source = setup.source
    if isinstance(source, Simulated) and source.rig == "vibration":
        return {"frequency": source.frequency, "amplitude": source.amplitude}
    if isinstance(source, Simulated) and source.rig == "six":
        return {"shake": 0.0}
    return {}


def check_set_up(path: Path) -> None:
    """Refuse to replace a file that is no set-up.

    Raises
    ------
    ValueError
        It is none.
    """
    try:
        load_setup(path)
    except ReadError:
        raise ValueError(f"{path.name} is there already and is no test set-up; give another name") from None
