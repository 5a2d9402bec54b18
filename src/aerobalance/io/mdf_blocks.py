"""The blocks of an MDF 4 file, checked before the library follows them: it may crash or never end on damaged ones.

ASAM MDF 4.1: every block begins with its kind (``##HD``), its length and the places of the blocks that it refers to.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from aerobalance.io.opening import opened_file
from aerobalance.recording.errors import ReadError

_HEAD: Final = 24
_FIRST: Final = 64
_MOST_BLOCKS: Final = 2_000_000
_MOST_LINKS: Final = 1_000_000
_UNPACKED: Final = 1100
"""Most bytes that a packed byte may stand for: deflate makes 1032 of one at best."""

_TREE: Final = {b"##DG": (0, 1), b"##CG": (0, 1), b"##CN": (0, 1), b"##FH": (0,), b"##AT": (0,), b"##CH": (0, 1)}
"""Links of a block, counted from 0, by which lists and trees are made: none may lead back to where it comes from."""

_ALL_LINKS: Final = (b"##CC", b"##DL", b"##HL", b"##LD", b"##SI", b"##DZ", b"##HD")
_DATA: Final = (b"##DT", b"##DV", b"##SD", b"##RD", b"##RV", b"##RI", b"##DI")


class _Block(NamedTuple):
    """Kind, length and links of a block."""

    kind: bytes
    length: int
    links: tuple[int, ...]


def check_blocks(path: Path) -> None:
    """Refuse an MDF file whose blocks lie outside the file, lead round in circles, or claim more than they hold.

    Raises
    ------
    ReadError
        With the place of the block, and what is wrong with it.
    """
    with opened_file(path) as file:
        start = file.read(_FIRST)
        if start.startswith(b"UnFinMF"):
            raise ReadError(
                path, "its first bytes", "say that it was never finished; finish it with the program that recorded it"
            )
        version = int.from_bytes(start[28:30], "little") if len(start) == _FIRST else 0
        if not 400 <= version < 500:
            raise ReadError(
                path, "byte 28", f"is MDF of version {version / 100:.2f}; versions 4.00 and later are read: save it so"
            )
        _FileCheck(path, file, path.stat().st_size).all()


@dataclass(slots=True)
class _FileCheck:
    """The check of one file."""

    path: Path
    file: BinaryIO
    size: int
    blocks: dict[int, _Block] = field(default_factory=dict)

    def all(self) -> None:
        """Look at every block that is referred to, once."""
        waiting = [_FIRST]
        while waiting:
            place = waiting.pop()
            if place in self.blocks:
                continue
            block = self._block(place)
            self.blocks[place] = block
            if len(self.blocks) > _MOST_BLOCKS:
                raise ReadError(self.path, f"byte {place}", f"has more than {_MOST_BLOCKS} blocks")
            waiting += [link for link in block.links if link]
        if self.blocks[_FIRST].kind != b"##HD":
            raise ReadError(self.path, f"byte {_FIRST}", "is no header (##HD): the file is damaged")
        self._no_circles()
        for place, block in self.blocks.items():
            if block.kind == b"##DG":
                self._data_group(place, block)
            elif block.kind == b"##CC":
                self._conversion(place, block)
            elif block.kind == b"##DZ":
                self._unpacked(place)

    def _fail(self, place: int, what: str) -> ReadError:
        return ReadError(self.path, f"byte {place}", f"{what}: the file is damaged or cut off")

    def _bytes(self, place: int, count: int) -> bytes:
        self.file.seek(place)
        found = self.file.read(count)
        if len(found) < count:
            raise self._fail(place, f"needs {count} bytes, of which {len(found)} are there")
        return found

    def _block(self, place: int) -> _Block:
        if not 0 < place <= self.size - _HEAD:
            raise self._fail(place, f"is said to hold a block, in a file of {self.size} bytes")
        kind, _, length, count = struct.unpack("<4s4sQQ", self._bytes(place, _HEAD))
        if not kind.startswith(b"##"):
            raise self._fail(place, f"holds {kind!r}, where a block must begin")
        if not _HEAD <= length <= self.size - place or count > min(_MOST_LINKS, (length - _HEAD) // 8):
            raise self._fail(place, f"claims a block of {length} bytes and {count} links")
        links = struct.unpack(f"<{count}Q", self._bytes(place + _HEAD, 8 * count))
        return _Block(kind, length, links)

    def _down(self, block: _Block) -> list[int]:
        places = range(len(block.links)) if block.kind in _ALL_LINKS else _TREE.get(block.kind, ())
        return [block.links[i] for i in places if i < len(block.links) and block.links[i]]

    def _no_circles(self) -> None:
        """Refuse lists and trees that lead back to a block on the way to them."""
        done: set[int] = set()
        for first in self.blocks:
            way: list[tuple[int, list[int]]] = [] if first in done else [(first, self._down(self.blocks[first]))]
            on_way = {first} if way else set()
            while way:
                place, rest = way[-1]
                if not rest:
                    way.pop()
                    on_way.discard(place)
                    done.add(place)
                    continue
                after = rest.pop()
                if after in on_way:
                    raise self._fail(place, f"leads back to the block at byte {after}")
                if after not in done:
                    on_way.add(after)
                    way.append((after, self._down(self.blocks[after])))

    def _body(self, place: int, block: _Block, count: int) -> bytes:
        """First bytes of a block after its links."""
        begin = _HEAD + 8 * len(block.links)
        if block.length < begin + count:
            raise self._fail(place, f"is a block {block.kind.decode()} of {block.length} bytes, too short")
        return self._bytes(place + begin, count)

    def _kind(self, place: int, *kinds: bytes) -> _Block | None:
        if not place:
            return None
        block = self.blocks[place]
        if block.kind not in kinds:
            allowed = " or ".join(kind.decode() for kind in kinds)
            raise self._fail(place, f"holds a block {block.kind!r}, where {allowed} belongs")
        return block

    def _data_group(self, place: int, block: _Block) -> None:
        """Check that the records of a group fit into its data, and the channels into the records."""
        record_id = self._body(place, block, 1)[0]
        if record_id not in (0, 1, 2, 4, 8) or len(block.links) < 4:
            raise self._fail(place, f"has record numbers of {record_id} bytes")
        held = self._held(block.links[2], 0) if block.links[2] else 0
        needed, at = 0, block.links[1]
        while at:
            group = self._kind(at, b"##CG")
            assert group is not None
            if len(group.links) < 6:
                raise self._fail(at, "is a channel group without its links")
            _, cycles, flags, _, _, data, invalid = struct.unpack("<QQHH4sII", self._body(at, group, 32))
            variable = bool(flags & 1)  # each record is as long as it says itself
            needed += 0 if variable else cycles * (data + invalid + record_id)
            if data > self.size or invalid > self.size or (cycles and not data + invalid):
                raise self._fail(at, f"claims {cycles} records of {data} + {invalid} bytes")
            self._channels(group.links[1], data, variable)
            at = group.links[0]
        if needed > held:
            raise self._fail(place, f"claims records of {needed} bytes, and has {held}")

    def _channels(self, at: int, data: int, variable: bool) -> None:
        """Check that the channels of a group lie within its records."""
        while at:
            channel = self._kind(at, b"##CN", b"##CA")
            assert channel is not None
            if channel.kind == b"##CA":
                return
            if len(channel.links) < 8:
                raise self._fail(at, "is a channel without its links")
            kind, sync, kind_of_data, bit, byte, bits, _, _ = struct.unpack("<BBBBIIII", self._body(at, channel, 20))
            virtual = kind in (3, 6)
            end = byte + (bit + bits + 7) // 8
            if kind > 6 or sync > 4 or kind_of_data > 16 or bit > 7 or bits > 8 * max(self.size, 1):
                raise self._fail(at, "is a channel of an impossible kind")
            if kind_of_data < 6 and not virtual and not 0 < bits <= 64:
                raise self._fail(at, f"is a channel of numbers of {bits} bits")
            if not variable and not virtual and end > data:
                raise self._fail(at, f"is a channel that ends at byte {end} of records of {data}")
            self._channels(channel.links[1], data, variable)
            at = channel.links[0]

    def _held(self, place: int, depth: int) -> int:
        """Bytes of records that a block of data, or a list of such, holds when unpacked."""
        total = 0
        while place:
            block = self.blocks[place]
            if block.kind in _DATA:
                return total + block.length - _HEAD
            if block.kind == b"##DZ":
                return total + self._unpacked(place)
            if block.kind not in (b"##DL", b"##HL", b"##LD") or not block.links or depth > 4:
                raise self._fail(place, f"holds a block {block.kind!r}, where records belong")
            if block.kind == b"##HL":
                place = block.links[0]
                continue
            total += sum(self._held(link, depth + 1) for link in block.links[1:] if link)
            place = block.links[0]
        return total

    def _unpacked(self, place: int) -> int:
        """Bytes of a packed block when it is unpacked."""
        block = self.blocks[place]
        _, way, _, _, unpacked, packed = struct.unpack("<2sBBIQQ", self._body(place, block, 24))
        if way > 1 or packed > block.length or unpacked > _UNPACKED * max(packed, 1):
            raise self._fail(place, f"claims {unpacked} bytes packed into {packed}")
        return int(unpacked)

    def _conversion(self, place: int, block: _Block) -> None:
        """Check that a conversion has as many references and numbers as it says."""
        if len(block.links) < 4:
            raise self._fail(place, "is a conversion without its links")
        kind, _, _, references, numbers = struct.unpack("<BBHHH", self._body(place, block, 8))
        begin = _HEAD + 8 * len(block.links) + 24
        if kind > 11 or references > len(block.links) - 4 or begin + 8 * numbers > block.length:
            raise self._fail(place, f"is a conversion of kind {kind} with {references} references, {numbers} numbers")
