"""Test set-ups as the page uses them: of the rigs, of one record, and those that are replaced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from aerobalance.acquire.setup import Record, SetChannel, Setup, load_setup, setup_from, stored_channels
from aerobalance.acquire.source import SourceChannel
from aerobalance.io.units import conversion_for
from aerobalance.problems import ReadError

SHAKEN: Final = {"frequency": 100.0, "amplitude": 30.0}
"""Drive of the vibration rig when the page opens it [Hz, N]: its motion stands out of the accelerometer's noise."""


def rig_setup(rig: str) -> Setup:
    """Return the set-up of a simulated rig as the page opens it."""
    source: dict[str, Any] = {"kind": "simulated", "rig": rig}
    if rig == "vibration":
        source |= SHAKEN
    names = {"vibration": "vibration rig, 6F-540", "cable_cut": "cable cut, 6-EB-128-1", "six": "six components"}
    return setup_from({"name": f"simulated: {names.get(rig, rig)}", "source": source})


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
