"""Standard input and standard output in the place of files: ``-``."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import typer

DASH = Path("-")


@dataclass(slots=True)
class _Streams:
    """What stands for the streams: a file of its own folder each."""

    folder: Path | None = None
    given: Path | None = None
    wanted: Path | None = None

    def file(self, name: str) -> Path:
        if self.folder is None:
            self.folder = Path(tempfile.mkdtemp(prefix="aerobalance-pipe-"))
        return self.folder / name


_STREAMS = _Streams()


def given(context: typer.Context, path: Path | None) -> Path | None:
    """Return a file to read; for ``-`` one that holds what comes on standard input.

    Raises
    ------
    ValueError
        Standard input was given before.
    """
    if path != DASH or context.resilient_parsing:
        return path
    if _STREAMS.given is not None:
        raise ValueError("standard input (-) can be one of the inputs only; give the others as files")
    _STREAMS.given = _STREAMS.file("standard-input")
    with _STREAMS.given.open("wb") as file:
        shutil.copyfileobj(sys.stdin.buffer, file)
    return _STREAMS.given


def given_all(context: typer.Context, paths: list[Path] | None) -> list[Path] | None:
    """Return files to read, one of which may be standard input."""
    return None if paths is None else [file for path in paths if (file := given(context, path)) is not None]


def wanted(suffix: str) -> Callable[[typer.Context, Path | None], Path | None]:
    """Return the file to write; for ``-`` one of this ending, which is passed on to standard output."""

    def chosen(context: typer.Context, path: Path | None) -> Path | None:
        if path != DASH or context.resilient_parsing:
            return path
        _STREAMS.wanted = _STREAMS.file(f"standard-output{suffix}")
        return _STREAMS.wanted

    return chosen


def pass_on() -> bool:
    """Pass on what was written for standard output; say whether there was anything."""
    if _STREAMS.wanted is None or not _STREAMS.wanted.exists():
        return False
    with _STREAMS.wanted.open("rb") as file:
        shutil.copyfileobj(file, sys.stdout.buffer)
    sys.stdout.flush()
    return True


def plain(text: str) -> str:
    """Call the streams by their names in a text."""
    if _STREAMS.folder is None:
        return text
    for path, name in ((_STREAMS.given, "standard input"), (_STREAMS.wanted, "standard output")):
        if path is not None:
            text = text.replace(str(path), name).replace(path.name, name)
    return text


def clean_up() -> None:
    """Take the files away."""
    if _STREAMS.folder is not None:
        shutil.rmtree(_STREAMS.folder, ignore_errors=True)
    _STREAMS.folder = _STREAMS.given = _STREAMS.wanted = None
