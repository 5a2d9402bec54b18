"""WAV: channels by number, in fractions of full scale; no unit, no names."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from aerobalance.io.columns import Clock
from aerobalance.io.format_library import library_faults
from aerobalance.io.series import Holdings, Series
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError

NAME: Final = "WAV"
"""What to call the format in messages."""

_MOST_CHANNELS: Final = 1024
_WIDTHS: Final = (1, 2, 3, 4, 8)
_SIZE_ELSEWHERE: Final = 0xFFFFFFFF
"""Size of a chunk whose real size stands in a chunk of its own (RF64), or was not known when it was begun."""


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is WAV, from its first bytes."""
    del path
    return head[:4] in (b"RIFF", b"RIFX", b"RF64") and head[8:12] == b"WAVE"


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Holdings]:
    """Open a file to read its channels as series ``channel 1`` and so on.

    Whole numbers become fractions of full scale, as in any audio program: -1 to 1. Floating-point samples stay
    as they are.

    Raises
    ------
    ReadError
        The file is damaged or compressed.
    """
    from scipy.io import wavfile  # noqa: PLC0415 - a tenth of a second, and only these files need it

    with library_faults(path, NAME, "its header"):
        width = _checked(path)
        rate, data = wavfile.read(path, mmap=width != 3)  # of 3 bytes there is no array on the disk
        samples = data.shape[0]
        columns = 1 if data.ndim == 1 else data.shape[1]
        clock = Clock(0.0, 1 / rate)
        series = tuple(
            Series(
                f"channel {k + 1}",
                f"channel {k + 1}",
                "",
                samples,
                _reader(data, k),
                fill=_filling(data, k),
                clock=clock,
                block="samples",
            )
            for k in range(columns)
        )
    yield Holdings(series, parts=width != 3)


def _checked(path: Path) -> int:
    """Bytes of a sample; refuse a header that contradicts itself or the size of the file."""
    size = path.stat().st_size
    with path.open("rb") as file:
        order = ">" if file.read(4) == b"RIFX" else "<"
        found: tuple[int, ...] | None = None
        file.seek(12)
        while file.tell() + 8 <= size:
            place = file.tell()
            name, count = struct.unpack(f"{order}4sI", file.read(8))
            if name == b"fmt ":
                found = _format(path, place, file, order, count)
            if name == b"data":
                if found is None:
                    raise ReadError(path, f"byte {place}", "has samples before their format: it is damaged")
                there = size - place - 8
                if count > there and count != _SIZE_ELSEWHERE:
                    what = f"is cut off: {count} bytes of samples are stated, and {there} are there"
                    raise ReadError(path, f"byte {place}", what)
                return found[0]
            file.seek(place + 8 + count + count % 2)
    raise ReadError(path, "", "has no chunk of samples ('data'): it is cut off or damaged")


def _format(path: Path, place: int, file: BinaryIO, order: str, count: int) -> tuple[int]:
    """Bytes of a sample, from the chunk of the format."""
    where = f"byte {place}, the format"
    if count < 16:
        raise ReadError(path, where, f"has {count} bytes, and 16 are needed: it is damaged")
    code, channels, rate, _, frame, bits = struct.unpack(f"{order}HHIIHH", file.read(16))
    if code not in (1, 3, 0xFFFE):
        raise ReadError(path, where, f"is compressed (code {code}); write it as PCM or as floating point")
    if not 0 < channels <= _MOST_CHANNELS or not rate:
        raise ReadError(path, where, f"states {channels} channels at {rate} Hz: it is damaged")
    width = frame // channels
    if width not in _WIDTHS or frame % channels or not 8 * (width > 1) < bits <= 8 * width:
        raise ReadError(path, where, f"states frames of {frame} bytes for {channels} channels of {bits} bits")
    return (width,)


def _reader(data: Any, column: int) -> Any:
    """Read a part of a channel, in fractions of full scale."""
    fill = _filling(data, column)

    def read(begin: int, end: int) -> Any:
        found = np.empty(end - begin)
        fill(begin, found)
        return found

    return read


def _filling(data: Any, column: int) -> Any:
    """Read a part of a channel into an array, in fractions of full scale."""
    kind, middle = data.dtype.kind, 2.0 ** (8 * data.dtype.itemsize - 1)

    def fill(begin: int, into: Array) -> None:
        end = begin + into.size
        into[:] = data[begin:end] if data.ndim == 1 else data[begin:end, column]
        if kind == "u":
            into -= middle
        if kind != "f":
            into /= middle

    return fill
