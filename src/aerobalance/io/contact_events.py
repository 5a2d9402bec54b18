"""Contacts between model and support that a recording's file tells of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_LISTED: Final = 5


def contact_doubt(events: NDArray[np.void], *, rate: float, origin: int) -> str | None:
    """Say when model and support touched; None where they did not.

    Parameters
    ----------
    events
        Table of the events: tick, kind and more.
    rate
        Ticks a second.
    origin
        Tick at which time is zero.
    """
    spans: list[list[str]] = []
    for tick, kind in zip(events["tick"], events["kind"], strict=True):
        name = bytes(kind).rstrip(b"\0")
        if name == b"contact":
            spans.append([f"{(int(tick) - origin) / rate:.4g}", "the end"])
        elif name == b"contact over" and spans:
            spans[-1][1] = f"{(int(tick) - origin) / rate:.4g} s"
    if not spans:
        return None
    listed = ", ".join(f"{begin} s to {end}" for begin, end in spans[:_LISTED])
    more = f" and {len(spans) - _LISTED} more" if len(spans) > _LISTED else ""
    return f"model and support touched ({listed}{more}): the loads read then carry the force of the contact"
