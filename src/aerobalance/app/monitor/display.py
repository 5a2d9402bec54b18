"""What the viewers are shown: charts, numbers and spectra as they stand, and the frames made of them.

Everything here belongs to the server's event loop. A viewer that takes its time gets all that it missed in one frame,
as bins of least and largest values, so that no peak is lost on it; what it missed is kept once for all viewers.
"""

from __future__ import annotations

import asyncio
import math
import struct
import time
from collections import deque
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.app.monitor.messages import LINES, News, Watching
from aerobalance.app.monitor.minmax_strips import Bins, Strip

KEPT: Final = (4_000, 10_000, 6_000)
"""Bins kept of each level: 1, 10 and 100 times the shortest bin, which is about 1 ms long."""

ROWS: Final = 120
"""Spectra kept for the waterfall."""

MARKS: Final = 100
"""Events kept for the charts."""

_DATA: Final = struct.Struct("<BBBBIIIddd")
_GROUP: Final = struct.Struct("<BBHId")
_SPECTRA: Final = struct.Struct("<BBHIIfI")


class DisplayState:
    """What is shown of one source after the other."""

    def __init__(self) -> None:
        self.watching: Watching | None = None
        self.changed = asyncio.Condition()
        self.data_version = 0
        self.numbers: dict[str, Any] = {}
        self.numbers_version = 0
        self.marks: deque[dict[str, Any]] = deque(maxlen=MARKS)
        self._offset = time.time() - time.monotonic()
        self._clear()

    def _clear(self) -> None:
        self.strips: list[Strip] = []
        self.spectra: dict[str, deque[NDArray[np.float32]]] = {}
        self.spectra_counts: dict[str, int] = {}
        self.largest_frequency: dict[str, float] = {}
        self.tick = 0
        self.newest = 0.0
        self.numbers = {}

    def begin(self, watching: Watching) -> None:
        """Show another source."""
        self.watching = watching
        self._clear()
        self.marks.clear()
        self.strips = [Strip(len(watching.names), KEPT), *(Strip(2, KEPT) for _ in watching.components)]

    def take(self, news: News) -> None:
        """Take what the engine has found."""
        watching = self.watching
        if watching is None or news.number != watching.number:
            return
        update = news.update
        self.tick = update.tick
        # clocks of a computer drift apart by little in the time of a test; the one that runs steadily is the source's
        self._offset = time.time() - time.monotonic()
        self.newest = update.received + self._offset
        for bins in update.raw:
            self.strips[0].extend(bins)
        for place, name in enumerate(watching.components):
            for bins in update.forces.get(name, ()):
                self.strips[place + 1].extend(bins)
        for name, (frequency, lines) in update.spectra.items():
            self.largest_frequency[name] = frequency
            self.spectra.setdefault(name, deque(maxlen=ROWS)).append(lines)
            self.spectra_counts[name] = self.spectra_counts.get(name, 0) + 1
        for tick, kind, text in update.remarks:
            self.mark(text, kind=kind, tick=tick)
        if update.readings:
            self._draw_up(news)
        self.data_version += 1

    def _draw_up(self, news: News) -> None:
        update = news.update
        self.numbers = {
            "readings": {name: reading._asdict() for name, reading in update.readings.items()},
            "estimates": {name: estimate._asdict() for name, estimate in update.estimates.items()},
            "health": update.health,
            "saturated": dict(news.saturated),
            "lost": update.lost,
            "envelope": None if update.envelope is None else update.envelope._asdict(),
            "touching": update.touching,
        }
        self.numbers_version += 1

    def mark(self, text: str, *, kind: str = "mark", tick: int | None = None) -> None:
        """Put an event on the charts."""
        self.marks.append({"tick": self.tick if tick is None else tick, "kind": kind, "text": text})

    async def tell(self) -> None:
        """Wake the viewers."""
        async with self.changed:
            self.changed.notify_all()

    def data_frame(self, sequence: int, level: int, cursors: list[int]) -> bytes | None:
        """Make a frame of all bins from the cursors on, and move the cursors; None where there are none.

        Parameters
        ----------
        sequence
            Number of the frame.
        level
            Which bins.
        cursors
            Number of the first bin wanted of each strip.
        """
        watching = self.watching
        if watching is None:
            return None
        parts = []
        oldest = self.newest
        for place, strip in enumerate(self.strips):
            bins = strip.since(level, cursors[place])
            count = bins.least.shape[0]
            if not count:
                continue
            parts.append(_group(place, bins))
            cursors[place] = bins.first + count
            if place == 0:
                ticks = count * watching.width * 10**level
                oldest = self.newest - ticks / watching.rate
        if not parts:
            return None
        head = _DATA.pack(
            1, level, len(parts), 0, sequence, watching.number, 0, self.newest * 1e3, oldest * 1e3, float(self.tick)
        )
        return b"".join([head, *parts])

    def spectra_frame(self, sequence: int, name: str, seen: int) -> tuple[bytes | None, int]:
        """Make a frame of the spectra of a component that a viewer has not `seen`; and how many there are by now."""
        count = self.spectra_counts.get(name, 0)
        watching = self.watching
        if watching is None or name not in watching.components or count <= seen:
            return None, seen
        rows = list(self.spectra[name])[-(count - seen) :]
        head = _SPECTRA.pack(
            2, watching.components.index(name), len(rows), sequence, watching.number,
            self.largest_frequency[name], LINES,
        )  # fmt: skip
        return b"".join([head, *(row.astype("<f4").tobytes() for row in rows)]), count


def _group(place: int, bins: Bins) -> bytes:
    count, columns = bins.least.shape
    pairs = np.stack((bins.least, bins.largest), axis=-1).astype("<f4")
    return _GROUP.pack(place, columns, 0, count, float(bins.first)) + pairs.tobytes()


def plain(value: Any) -> Any:
    """Make data fit for JSON: what is no number becomes null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
