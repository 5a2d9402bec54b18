"""What all commands share: the summary of a result, its warnings, and where it may be written."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from aerobalance.app.options import as_options
from aerobalance.io import (
    load_channel_map,
    read,
)
from aerobalance.io.kinds import EMPTY, kind_of
from aerobalance.io.locked_file import refuse_locked
from aerobalance.io.long_record import open_record
from aerobalance.io.safe_write import OUTPUTS, reason_of
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import DataQualityWarning, FitError, warn_quality
from aerobalance.recording.parts import LongRecord
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected

Result = dict[str, Any]
"""A result as plain data."""


@contextmanager
def collected_warnings(without: Callable[[str], bool] = lambda text: False) -> Iterator[list[str]]:
    """Collect the warnings about a result while it is worked out; at the end, list each text once and pass it on.

    Parameters
    ----------
    without
        Whether a text need not be said, because another says the same; asked at the end.
    """
    texts: list[str] = []
    caught: list[warnings.WarningMessage] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", DataQualityWarning)
            yield texts
    except np.linalg.LinAlgError as problem:  # a ValueError by class, but no wrong call
        raise FitError(
            f"the equations of the fit have no solution ({problem}): the data leave too much open; "
            "a longer record with fewer gaps would help"
        ) from problem
    except ArithmeticError as problem:
        raise FitError(
            f"the numbers leave the range that can be calculated with ({problem}); "
            "check the units and the values of the recording, the mass and the dynamics"
        ) from problem
    finally:
        said = [one.message for one in caught if issubclass(one.category, DataQualityWarning)]
        said_once = dict.fromkeys(as_options(" ".join(str(message).split())) for message in said)
        texts += [text for text in said_once if not without(text)]
        for text in texts:
            warn_quality(text)


def check_out(out: Path | None, *inputs: Path | None, kind: str = "") -> None:
    """Make sure, before any work, that the output can be written, and takes the place of nothing but such a result.

    Parameters
    ----------
    out
        The file to write; None for none.
    inputs
        What is read; None where one is not given.
    kind
        What is written, as `aerobalance.io.kinds.kind_of` tells it; an empty string for what it cannot tell, which
        takes the place of the same content only.

    Raises
    ------
    ValueError
        The output is an input, no ordinary file, being recorded, something else than `kind` that exists, or in a
        folder that does not exist.
    """
    if out is None:
        return
    try:
        _check_place(out, [file for file in inputs if file is not None])
    except OSError as error:
        raise ValueError(f"cannot use {error.filename or out}: {reason_of(error)}") from None
    refuse_locked(out)
    if OUTPUTS.active:
        OUTPUTS.wanted.append(out)
    if not OUTPUTS.replace and out.exists():
        _check_kind(out, kind)


def _check_place(out: Path, inputs: Sequence[Path]) -> None:
    if out.is_dir():
        raise ValueError(f"{out} is a folder; the name of a file is needed")
    if out.exists() and not out.is_file():
        raise ValueError(f"{out} is no ordinary file and would be replaced by one; give another name")
    if not out.parent.is_dir():
        raise ValueError(f"cannot write {out}: there is no folder {out.parent}")
    for file in inputs:
        if out == file or (file.exists() and out.exists() and out.samefile(file)):
            raise ValueError(f"{out} is an input and would be overwritten; give the output another name")


def _check_kind(out: Path, kind: str) -> None:
    """Refuse to replace what is no result of the kind that is written."""
    there = kind_of(out)
    if there in (EMPTY, kind) and there:
        return
    if not kind:
        OUTPUTS.unmarked.add(out)
        return
    raise ValueError(
        f"{out} exists and is {f'a {there}' if there else 'something else'}, not a {kind} of this program; give "
        "another name, or --replace"
    )


def recording_of(path: Path, channel_map: Path | None = None) -> Recording:
    """Read a recording, through a channel map where one is given; what its sensors do to the readings is undone."""
    return corrected(raw_recording(path, channel_map))


def opened(path: Path, channel_map: Path | None = None) -> AbstractContextManager[LongRecord[Recording]]:
    """Open a recording to read it part by part, its readings as they were taken."""
    return open_record(path, channel_map=None if channel_map is None else load_channel_map(channel_map))


def raw_recording(path: Path, channel_map: Path | None = None) -> Recording:
    """Read a recording with its readings as they were taken."""
    return read(path, channel_map=None if channel_map is None else load_channel_map(channel_map))


def known_component(component: str) -> None:
    """Refuse a name that is no component."""
    if component not in COMPONENTS:
        raise ValueError(f"--component must be one of {', '.join(COMPONENTS)}, not {component}")


def amounts(texts: Sequence[str], option: str) -> float | dict[str, float] | None:
    """What an option of the command line says: one positive number, numbers by component (``NF=2000``), or nothing.

    Raises
    ------
    ValueError
        A text is neither, or there is more than one number without a component.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if not 0 < value < np.inf or (name and name not in COMPONENTS):
            raise ValueError(
                f"{option} must be positive, one number or by component such as NF=2000 "
                f"({', '.join(COMPONENTS)}), not {text}"
            )
        found[name] = value
    if "" in found and len(texts) > 1:
        raise ValueError(f"{option} is one number, or numbers by component such as NF=2000, not both")
    return found.get("", found or None)


def table_text(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out a table for people: the first column to the left, the others to the right."""
    table = Table(box=None)
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row)
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(table)
    return "\n".join([title, *(line.rstrip() for line in console.export_text().rstrip().split("\n"))])


def seed_for(out: Path, seed: int | None) -> int:
    """Make the folder of a simulation's results, and give its seed: a fresh one where none is given.

    Raises
    ------
    ValueError
        The folder cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"cannot make the folder {out}: {error.strerror or error}") from None
    if seed is None:  # short enough to be typed in again
        return int(np.random.SeedSequence().generate_state(1)[0])
    return seed
