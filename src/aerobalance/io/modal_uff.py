"""Universal files of modal programs: response functions out (data sets 15, 58, 164), poles and shapes in (55).

The balance is node 1, whose directions are those of the loads: AF along x (aft), SF along y (right), NF along z (up),
RM, PM and YM about these axes, with the signs that make them positive. Points that are tapped are nodes from 2 on. A
direction that is along no axis is written as 0 and named in the text of its function. Frequencies are to be such that
six digits tell them, which is what the header has room for.

Modes are read here and not by a library: those cannot read complex shapes of six directions a node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.opening import opened_file
from aerobalance.io.safe_write import replacing
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, DIRECTIONS, MOMENTS
from aerobalance.recording.errors import ReadError

LARGEST: Final = 64_000_000
"""Size of a universal file of modes beyond which it is not read [bytes]."""

SUFFIXES: Final = (".uff", ".unv")
"""Endings of universal files."""


def load_direction(component: str) -> int:
    """Return the direction of a load in universal files: 1 to 3 along x, y, z, 4 to 6 about them, with its sign."""
    vector = DIRECTIONS[COMPONENTS.index(component)]
    axis = int(np.argmax(np.abs(vector)))
    return int(np.sign(vector[axis])) * (axis + 1 + (3 if component in MOMENTS else 0))


@dataclass(frozen=True, slots=True, eq=False)
class WrittenResponse:
    """Response functions at one point, as they are written.

    Attributes
    ----------
    place, direction
        Point from the balance's centre aft, right and up [m], and unit vector of the force, shape (3,) each.
    name
        What it is called.
    frequency
        Evenly spaced, shape (m,) [Hz].
    response
        Loads over force, shape (m, n) [1, m].
    coherence
        Shape (m, n) [1]; NaN where there is none.
    """

    place: Array
    direction: Array
    name: str
    frequency: Array
    response: NDArray[np.complex128]
    coherence: Array


def write_responses(path: Path, found: Sequence[WrittenResponse], *, components: Sequence[str]) -> None:
    """Write response functions, and their coherence, for modal programs: data sets 58 of complex numbers as text.

    Parameters
    ----------
    path
        The file.
    found
        Response functions by point.
    components
        Loads of the columns.
    """
    parts = [UNITS, _nodes(found)]
    for node, one in enumerate(found, start=2):
        for column, component in enumerate(components):
            parts.append(_function(one, node, component, one.response[:, column]))
            if np.isfinite(one.coherence[:, column]).all():
                parts.append(_function(one, node, component, one.coherence[:, column]))
    with replacing(path) as beside:
        beside.write_text("".join(parts), encoding="ascii", newline="\n")


UNITS: Final = (
    "    -1\n   164\n         1SI                           2\n"
    f"{1.0:25.17E}{1.0:25.17E}{1.0:25.17E}\n{273.15:25.17E}\n    -1\n"
).replace("E", "D")
"""Data set 164: metres, newtons and kelvins."""


def _nodes(found: Sequence[WrittenResponse]) -> str:
    """Data set 15: the balance's centre, and the points."""
    places = [np.zeros(3), *(one.place for one in found)]
    lines = [
        f"{node:10d}{0:10d}{0:10d}{1:10d}" + "".join(f"{value:13.5E}" for value in place)
        for node, place in enumerate(places, start=1)
    ]
    return "\n".join(["    -1", "    15", *lines, "    -1", ""])


def _function(one: WrittenResponse, node: int, component: str, data: NDArray[Any]) -> str:
    """Data set 58: of kind 4, a response function, where the numbers are complex, and 6, a coherence, where not."""
    response = np.iscomplexobj(data)
    axis = int(np.argmax(np.abs(one.direction)))
    along = abs(float(one.direction[axis])) > 1 - 1e-6
    pushed = int(np.sign(one.direction[axis])) * (axis + 1) if along else 0
    moment = component in MOMENTS
    unit = "Nm" if moment else "N"
    ids = (
        f"{component} over force" if response else f"coherence of {component} and force",
        f"tapped at {one.name}",
        "NONE",
        f"{component} [{unit}], force [N]; written by aerobalance",
        "NONE",
    )
    step, start = one.frequency[1] - one.frequency[0], one.frequency[0]
    kinds = ((9 if moment else 13), int(moment), 1, unit) if response else (1, 0, 0, "NONE")
    below = (13, 0, 1, "N") if response else (0, 0, 0, "NONE")
    degrees = f"{4 if response else 6:5d}{0:10d}{0:5d}{0:10d}"
    lines = [
        "    -1",
        "    58",
        *(f"{text:<80}"[:80] for text in ids),
        f"{degrees} {'NONE':<10}{1:10d}{load_direction(component):4d} {'NONE':<10}{node:10d}{pushed:4d}",
        f"{6 if response else 4:10d}{data.size:10d}{1:10d}{start:13.5E}{step:13.5E}{0.0:13.5E}",
        f"{18:10d}{0:5d}{0:5d}{0:5d} {'Frequency':<20} {'Hz':<20}",
        *(
            f"{kind:10d}{length:5d}{force:5d}{0:5d} {'NONE':<20} {name:<20}"
            for kind, length, force, name in (kinds, below, (0, 0, 0, "NONE"))
        ),
    ]
    numbers = np.column_stack([data.real, data.imag]).ravel() if response else np.asarray(data, dtype=np.float64)
    lines += [
        "".join(f"{value:20.11E}" for value in numbers[first : first + 4]) for first in range(0, numbers.size, 4)
    ]
    return "\n".join([*lines, "    -1", ""])


@dataclass(frozen=True, slots=True, eq=False)
class ReadModes:
    """Modes of a universal file.

    Attributes
    ----------
    poles
        With positive imaginary part, shape (m,) [rad/s].
    shapes
        Balance loads at node 1 in every mode, rows, in the order of `COMPONENTS`; NaN where the file has no such
        direction, shape (m, 6).
    """

    poles: NDArray[np.complex128]
    shapes: NDArray[np.complex128]


def read_modes(path: Path) -> ReadModes:
    """Read poles and shapes that a modal program found, data sets 55 of a universal file.

    Taken are real and complex modes (analysis types 2, 3 and 7), shapes of three or six directions a node, at node 1.

    Raises
    ------
    ReadError
        The file has no such data set, or one that does not fit its own header.
    """
    with opened_file(path) as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise ReadError(path, "", f"is larger than {LARGEST // 10**6} MB, which no file of modes is")
    lines = content.decode("ascii", errors="replace").splitlines()
    marks = [number for number, line in enumerate(lines) if line.strip() == "-1"]
    poles, shapes = [], []
    kinds = []
    for begin, end in zip(marks[::2], marks[1::2], strict=False):
        kind = lines[begin + 1].strip() if begin + 1 < end else ""
        kinds.append(kind)
        if kind == "55":
            pole, shape = _mode(path, lines, begin + 2, end)
            poles.append(pole)
            shapes.append(shape)
    if not poles:
        has = f"it has {', '.join(sorted(set(kinds)))}" if kinds else "it is no universal file"
        raise ReadError(path, "", f"has no modes (data sets 55); {has}")
    order = np.argsort(np.abs(poles))
    return ReadModes(np.array(poles)[order], np.array(shapes)[order])


def _mode(path: Path, lines: Sequence[str], begin: int, end: int) -> tuple[complex, NDArray[np.complex128]]:
    """Pole and shape of one data set 55."""
    where = f"line {begin + 1}"
    try:
        _, analysis, _, _, kind, per_node = _integers(lines[begin + 5], 6)
        numbers = _reals(lines[begin + 7])
        if analysis == 2:
            rate, ratio = 2 * np.pi * numbers[0], numbers[2]
            pole = rate * complex(-ratio, np.sqrt(max(1 - ratio**2, 0.0)))
        elif analysis in (3, 7):
            pole = complex(numbers[0], abs(numbers[1]))
        else:
            raise ReadError(path, where, f"is a data set 55 of analysis type {analysis}; modes are of type 2, 3 or 7")
        if kind not in (2, 5) or per_node not in (3, 6):
            raise ReadError(
                path,
                where,
                f"has {per_node} values a node of data type {kind}; 3 or 6, real (2) or complex (5), are read",
            )
        shape = _shape(lines, begin + 8, end, complex_values=kind == 5, per_node=per_node)
        turned = analysis != 2 and numbers[1] < 0
    except (ValueError, IndexError):
        raise ReadError(path, where, "is no data set 55 that can be read: header or shape are cut off") from None
    if shape is None:
        raise ReadError(path, where, "holds no node 1, which is the balance in the files that are written here")
    if not (pole.imag > 0 and np.isfinite(pole)):
        raise ReadError(path, where, f"has a pole of {pole:.4g} 1/s, which does not oscillate")
    return pole, shape.conj() if turned else shape


def _integers(line: str, count: int) -> list[int]:
    return [int(part) for part in line.split()[:count]]


def _reals(line: str) -> list[float]:
    text = line.rstrip()
    if len(text) % 13:
        raise ValueError("a number is cut off")
    return [float(text[place : place + 13].replace("D", "E")) for place in range(0, len(text), 13)]


def _shape(
    lines: Sequence[str], begin: int, end: int, *, complex_values: bool, per_node: int
) -> NDArray[np.complex128] | None:
    """Loads of node 1 in the order of `COMPONENTS`, NaN where there is no such direction; None without the node."""
    wanted = per_node * (2 if complex_values else 1)
    place = begin
    while place < end:
        node = int(lines[place].split()[0])
        values: list[float] = []
        place += 1
        while len(values) < wanted:
            if place >= end:
                raise ValueError("the shape is cut off")
            values += _reals(lines[place])
            place += 1
        if node == 1:
            table = np.array(values[:wanted])
            found = table[::2] + 1j * table[1::2] if complex_values else table.astype(np.complex128)
            full = np.full(6, np.nan, dtype=np.complex128)
            full[:per_node] = found
            directions = [load_direction(name) for name in COMPONENTS]
            return np.array([np.sign(one) * full[abs(one) - 1] for one in directions])
    return None
