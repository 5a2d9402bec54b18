"""Warnings about the parts of a record, told once for all of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from aerobalance.recording.errors import OfSamples, kept_warnings, warn_quality
from aerobalance.recording.parts import LongRecord, Part
from aerobalance.recording.wording import without_numbers


@dataclass(slots=True)
class PartWarnings:
    """Collects what is said of the parts of a record, and says it with the part where parts differ.

    Attributes
    ----------
    record
        The record.
    """

    record: LongRecord[Any]
    _said: dict[str, list[tuple[Part, str]]] = field(default_factory=dict)

    @contextmanager
    def of(self, part: Part) -> Iterator[None]:
        """Collect the warnings about a part; those about a whole record are passed on at once."""
        if part.count == 1:
            yield
            return
        with kept_warnings() as said:
            yield
        for text in said:
            self.add(part, text)

    def add(self, part: Part, text: str) -> None:
        """Note what is to be said of a part."""
        same = self._said.setdefault(without_numbers(text), [])
        if (part, text) not in same:
            same.append((part, text))

    def tell(self) -> None:
        """Say it all: once what is said of all parts in the same words, the rest with a part that it is of.

        That is the part with the most of it where that is known, and else the first.
        """
        for text in self.sentences():
            warn_quality(text)

    def sentences(self) -> Iterator[str]:
        """What there is to say."""
        prefix = f"{self.record.name}: "
        for said in self._said.values():
            part, text = max(said, key=lambda one: one[1].size if isinstance(one[1], OfSamples) else 0.0)
            parts = {one.number for one, _ in said}
            if part.count == 1 or (len(parts) == part.count and len({words for _, words in said}) == 1):
                yield text
                continue
            others = len(parts) - 1
            like = f" (and the like in {others} further part{'s' if others > 1 else ''})" if others else ""
            yield f"{prefix}{part.told(self.record)}: {text.removeprefix(prefix)}{like}"
