"""Samples of TDMS channels read part by part: no more of the file than a part needs, however the file is laid out.

What the reader's library reads at once is a chunk, which LabVIEW makes as long as it pleases: a file that was
defragmented is a single one. So samples that lie in the file as plain numbers are taken from their places there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.columns import PIECE

if TYPE_CHECKING:
    from nptdms import TdmsChannel, TdmsFile

_INTERLEAVED: Final = 1 << 5
"""Mark of a segment in which the samples of all channels take turns."""

_BIG_ENDIAN: Final = 1 << 6


@dataclass(frozen=True, slots=True)
class _Chunks:
    """Samples of one channel in one segment: chunks of as many each, all laid out alike.

    Attributes
    ----------
    rows
        Samples in a chunk.
    count
        Number of chunks.
    place
        Where the first sample stands in the file.
    length
        Bytes from one chunk to the next.
    stride
        Bytes from one sample to the next.
    kind
        What a sample is.
    """

    rows: int
    count: int
    place: int
    length: int
    stride: int
    kind: np.dtype[Any]


def part_reader(file: TdmsFile, channel: TdmsChannel, stream: BinaryIO) -> Callable[[int, int], Any] | None:
    """Return what reads the samples of a channel from one to another, scaled; None where parts cost as much as all.

    Parameters
    ----------
    file, channel
        The open file, and one of its channels.
    stream
        The file.
    """
    try:
        segments = [(one, one.get_segment_object(channel.path)) for one in file._reader._segments]
        held = [(segment, given) for segment, given in segments if given is not None and given.has_data]
        chunks = [_chunks(segment, given) for segment, given in held]
        longest = max((given.number_values for _, given in held), default=0)
    except (AttributeError, TypeError):  # another version of the library, which keeps this elsewhere
        return None
    plain = [one for one in chunks if one is not None and one.rows and one.count]
    alike = len({one.kind.newbyteorder("=") for one in plain}) == 1
    if None not in chunks and alike and sum(one.rows * one.count for one in plain) == len(channel):
        return _from_places(channel, plain, stream)
    if longest <= PIECE:
        return lambda begin, end: channel.read_data(begin, end - begin)
    return None


def _chunks(segment: Any, given: Any) -> _Chunks | None:
    """Where the samples of a channel stand in a segment; None where they are no plain numbers of equal chunks."""
    objects = [one for one in segment.ordered_objects if one.has_data]
    kinds = [getattr(one.data_type, "nptype", None) for one in objects]
    # a float64 is equal to None, numpy says
    if (
        any(kind is None for kind in kinds)
        or given.scaler_data_types
        or segment.final_chunk_lengths_override is not None
    ):
        return None
    sizes = [kind.itemsize for kind in kinds if kind is not None]
    rows, at = int(given.number_values), next(i for i, one in enumerate(objects) if one is given)
    kind = np.dtype(kinds[at]).newbyteorder(">" if segment.toc_mask & _BIG_ENDIAN else "<")
    length = sum(int(one.number_values) * size for one, size in zip(objects, sizes, strict=True))
    if segment.toc_mask & _INTERLEAVED:
        if any(one.number_values != rows for one in objects):
            return None
        before, stride = sum(sizes[:at]), sum(sizes)
    else:
        pairs = zip(objects[:at], sizes, strict=False)
        before, stride = sum(int(one.number_values) * size for one, size in pairs), sizes[at]
    return _Chunks(rows, int(segment.num_chunks), int(segment.data_position) + before, length, stride, kind)


def _from_places(channel: TdmsChannel, chunks: list[_Chunks], stream: BinaryIO) -> Callable[[int, int], Any]:
    from nptdms.base_segment import RawChannelDataChunk  # noqa: PLC0415 - with the library, which is loaded late

    edges = np.cumsum([0, *(one.rows * one.count for one in chunks)])
    spans = list(zip(chunks, pairwise(edges.tolist()), strict=True))

    def read(begin: int, end: int) -> Any:
        first, last = np.searchsorted(edges, begin, side="right") - 1, np.searchsorted(edges, end, side="left")
        raw = np.empty(end - begin, chunks[0].kind)
        for one, (start, stop) in spans[first:last]:
            a, b = max(begin, start), min(end, stop)
            _fill(raw[a - begin : b - begin], one, stream, a - start)
        return channel._scale_data(RawChannelDataChunk.channel_data(raw))

    return read


def _fill(raw: NDArray[Any], one: _Chunks, stream: BinaryIO, begin: int) -> None:
    """Take samples of a segment from one on: of short chunks several at once, of long ones a piece at a time."""
    filled, at_once = 0, max(1, PIECE // one.rows)
    while filled < raw.size:
        chunk, skipped = divmod(begin + filled, one.rows)
        count = min(at_once, one.count - chunk)
        if count == 1:
            here = skipped
            shape = (1, min(one.rows - skipped, PIECE, raw.size - filled))
            skipped = 0
        else:
            here = 0
            shape = (min(count, -(-(skipped + raw.size - filled) // one.rows)), one.rows)
        size = (shape[0] - 1) * one.length + (shape[1] - 1) * one.stride + one.kind.itemsize
        stream.seek(one.place + chunk * one.length + here * one.stride)
        table: NDArray[Any] = np.ndarray(shape, one.kind, stream.read(size), 0, (one.length, one.stride))
        found = table.reshape(-1)[skipped : skipped + raw.size - filled]
        raw[filled : filled + found.size] = found
        filled += found.size
