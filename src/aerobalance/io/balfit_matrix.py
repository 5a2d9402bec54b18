"""Matrices in the text layout of BALFIT: DATA_REDUCTION_MATRIX_IN_AMES_FORMAT.

D0 is the transpose of C1^-1, a row for every bridge; D2 is the transpose of C1^-1 C2, a row for every further term;
the loads are columns. The loads follow by the primary load iteration, F = C1^-1 dR - C1^-1 C2 H(F), with dR the
outputs less natural zero.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.terms import Term, by_label
from aerobalance.io.safe_write import replacing
from aerobalance.io.text_table import read_text
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, argument, warn_quality
from aerobalance.recording.units import conversion

FILE_TYPE: Final = "DATA_REDUCTION_MATRIX_IN_AMES_FORMAT"
MOMENT_UNIT: Final = "N*m"


def is_balfit_matrix(head: str) -> bool:
    """Return whether a text is a matrix in this layout."""
    return FILE_TYPE in head


def write_balfit_matrix(path: Path | str, matrix: BalanceMatrix, *, description: str = "") -> None:
    """Write a matrix of the iterative way; loads in N and N*m, outputs in microV/V.

    Raises
    ------
    ValueError
        The matrix goes the other way, or the file cannot be written.
    """
    if matrix.way != "iterative":
        raise ValueError(f"the layout is for the iterative way; calibrate with {argument('way', 'iterative')}")
    micro = 1e3
    inverse = np.linalg.inv(matrix.linear)
    D0 = (matrix.load_scale[:, None] * inverse / (matrix.output_scale * micro)).T
    rows = [(term, row) for term, row in zip(matrix.terms, matrix.coefficients, strict=True) if term.kind]
    scale = [_scale(term, matrix.load_scale) for term, _ in rows]
    D2 = [matrix.load_scale * (inverse @ row) / size for (_, row), size in zip(rows, scale, strict=True)]
    zero = np.zeros(len(matrix.gauges)) if matrix.natural_zero is None else matrix.natural_zero * micro
    outputs = np.sort(matrix.outputs(matrix.calibrated) * micro, axis=0)
    gauges = [f"r{name}" for name in matrix.gauges]
    dashes = "- " * (8 * len(gauges))
    lines = [
        _line("FILE_TYPE", [FILE_TYPE]),
        _line("BALANCE_NAME", [matrix.balance_type]),
        _line("DESCRIPTION", [description or "made by aerobalance"]),
        _line("PREPARED_BY", ["aerobalance"]),
        _line("REPORT_NO", ["none"]),
        _line("ITERATION_METHOD", ["Primary Load Iteration Method"]),
        _line("LOAD_NAME", list(matrix.components)),
        _line("LOAD_UNIT", [MOMENT_UNIT if moment else "N" for moment in matrix.moments]),
        _numbers("LOAD_MINIMUM", matrix.calibrated[0]),
        _numbers("LOAD_MAXIMUM", matrix.calibrated[1]),
        _numbers("LOAD_CAPACITY", matrix.load_scale),
        _line("GAGE_OUT_NAME", gauges),
        _line("GAGE_OUT_UNIT", ["microV/V"] * len(gauges)),
        _numbers("GAGE_OUT_MINIMUM", outputs[0]),
        _numbers("GAGE_OUT_MAXIMUM", outputs[-1]),
        _line("GAGE_SENSITIVITY", ["DEFINED"] * len(gauges)),
        _numbers("NATURAL_ZERO", zero),
        _numbers("INTERCEPT", np.zeros(len(gauges))),
        _line("D0[TRANSPOSE(C1INV)]", [dashes]),
        *(_numbers(name, row) for name, row in zip(gauges, D0, strict=True)),
        _line("D1[MATRIX_IS_NOT_USED]", [dashes]),
        *(_numbers(name, np.zeros(len(gauges))) for name in matrix.components),
        _line("D2[TRANSPOSE(C1INVC2)]", [dashes]),
        *(_numbers(term.label(matrix.components), row) for (term, _), row in zip(rows, D2, strict=True)),
    ]
    with replacing(path) as beside:
        beside.write_text("\r\n".join(lines) + "\r\n", encoding="ascii", errors="replace", newline="")


def _scale(term: Term, scale: Array) -> float:
    """Value of a term at capacity."""
    size = float(scale[term.first])
    if term.kind in (2, 3):
        return size**2
    if term.kind in (8, 9):
        return size**3
    return size if term.first == term.second else size * float(scale[term.second])


def _line(label: str, cells: list[str]) -> str:
    return f"{label:>23} " + " ".join(f"{cell:>24}" if len(cells) > 1 else cell for cell in cells)


def _numbers(label: str, values: Array) -> str:
    return _line(label, [f"{value: .16e}" for value in values])


def read_balfit_matrix(path: Path | str) -> BalanceMatrix:
    """Read a matrix; it carries no uncertainty, and says so.

    Raises
    ------
    ReadError
        A part is missing or is no number; the message says which line.

    Warns
    -----
    DataQualityWarning
        The layout has no uncertainties: those of the loads are without the matrix's.
    """
    file = Path(path)
    header, blocks = _parts(file, read_text(file).splitlines())
    names = _cells(file, header, "LOAD_NAME")
    c = len(names)
    _check_method(file, header, blocks, c)
    units = _cells(file, header, "LOAD_UNIT", c)
    gauges = _cells(file, header, "GAGE_OUT_NAME", c)
    moments = np.array([_is_moment(file, unit) for unit in units])
    load = np.array([conversion(u, expected="N*m" if m else "N").factor for u, m in zip(units, moments, strict=True)])
    output = np.array([_output_factor(file, unit) for unit in _cells(file, header, "GAGE_OUT_UNIT", c)])
    least, most, capacity, zero = (
        _values(file, header, key, c) for key in ("LOAD_MINIMUM", "LOAD_MAXIMUM", "LOAD_CAPACITY", "NATURAL_ZERO")
    )
    inverse = _block(file, blocks, "D0", c)[1].T * load[:, None] / output
    labels, D2 = _block(file, blocks, "D2", c)
    known = {label: term for label, term in by_label(tuple(names)).items() if term.kind}  # D0 has the linear ones
    for label in labels:
        if label not in known:
            raise ReadError(file, "D2", f"{label!r} is no term; examples: {', '.join(list(known)[:: c * 2][:4])}")
    capacity = capacity * load
    try:
        linear = np.linalg.inv(inverse)
    except np.linalg.LinAlgError:
        raise ReadError(file, "D0", "cannot be inverted: its rows depend on each other") from None
    output_scale = np.abs(np.diag(linear)) * capacity
    terms = [Term(0, i, i) for i in range(c)]
    rows = [linear[:, i] * capacity[i] / output_scale for i in range(c)]
    for label, row in zip(labels, D2, strict=True):
        term = known[label]
        terms.append(term)
        rows.append(linear @ (row * load * _scale(term, capacity) / _scale(term, load)) / output_scale)
    warn_quality(
        f"{file.name}: the layout carries no uncertainties; the uncertainty of the loads is without the matrix's own"
    )
    t = len(terms)
    try:
        return BalanceMatrix(
            components=tuple(names),
            gauges=tuple(name.removeprefix("r") for name in gauges),
            way="iterative",
            terms=tuple(terms),
            coefficients=np.array(rows),
            load_scale=capacity,
            output_scale=output_scale,
            covariance=np.zeros((c, t, t)),
            residual_deviation=np.zeros(c),
            residual_correlation=np.eye(c),
            degrees_of_freedom=np.zeros(c, dtype=np.intp),
            calibrated=np.array([least * load, most * load]),
            natural_zero=zero * output,
            moments=moments,
        )
    except ValueError as error:
        raise ReadError(file, "", str(error)) from None


def _check_method(
    path: Path,
    header: dict[str, tuple[int, list[str]]],
    blocks: dict[str, list[tuple[int, list[str]]]],
    count: int,
) -> None:
    """Refuse another iteration than the primary one of AIAA R-091, D2 alone, from outputs without an intercept."""
    if "ITERATION_METHOD" in header:
        number, words = header["ITERATION_METHOD"]
        if "primary" not in (word.casefold() for word in words):
            raise ReadError(path, f"line {number}", f"{' '.join(words)}: the primary load iteration method is read")
    if "INTERCEPT" in header and _values(path, header, "INTERCEPT", count).any():
        number = header["INTERCEPT"][0]
        raise ReadError(
            path, f"line {number}", "has intercepts; fit the matrix to outputs less the natural zeros, without them"
        )
    if _block(path, blocks, "D1", count)[1].any():
        raise ReadError(
            path, "D1", "is not zero: it belongs to the secondary load iteration method; use the primary one"
        )


def _parts(
    path: Path, lines: list[str]
) -> tuple[dict[str, tuple[int, list[str]]], dict[str, list[tuple[int, list[str]]]]]:
    """Header lines by key, and the rows of the blocks D0, D1, D2, each with its line number."""
    header: dict[str, tuple[int, list[str]]] = {}
    blocks: dict[str, list[tuple[int, list[str]]]] = {}
    block: list[tuple[int, list[str]]] | None = None
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words or words[0].startswith(";"):
            continue
        if words[0][:3] in ("D0[", "D1[", "D2["):
            block = blocks.setdefault(words[0][:2], [])
        elif block is not None:
            block.append((number, words))
        else:
            header[words[0]] = (number, words[1:])
    if FILE_TYPE not in header.get("FILE_TYPE", (0, []))[1]:
        raise ReadError(path, "", f"is no {FILE_TYPE}")
    return header, blocks


def _cells(path: Path, header: dict[str, tuple[int, list[str]]], key: str, count: int = 0) -> list[str]:
    if key not in header:
        raise ReadError(path, "", f"has no line {key}")
    number, cells = header[key]
    if not cells or (count and len(cells) != count):
        raise ReadError(path, f"line {number}", f"{key} has {len(cells)} entries; {count or 'one or more'} are needed")
    return cells


def _values(path: Path, header: dict[str, tuple[int, list[str]]], key: str, count: int) -> Array:
    cells = _cells(path, header, key, count)
    return _floats(path, header[key][0], cells)


def _floats(path: Path, number: int, cells: list[str]) -> Array:
    try:
        values = np.array([float(cell) for cell in cells])
    except ValueError:
        raise ReadError(path, f"line {number}", f"numbers are needed, not {' '.join(cells)[:60]!r}") from None
    if not np.isfinite(values).all():
        raise ReadError(path, f"line {number}", "finite numbers are needed")
    return values


def _block(
    path: Path, blocks: dict[str, list[tuple[int, list[str]]]], key: str, count: int
) -> tuple[list[str], Array]:
    """Labels and rows of a block."""
    rows = blocks.get(key, [])
    if key == "D0" and len(rows) != count:
        raise ReadError(path, key, f"has {len(rows)} rows; {count} are needed, one for every bridge")
    values = []
    for number, words in rows:
        if len(words) != count + 1:
            raise ReadError(path, f"line {number}", f"has {len(words) - 1} numbers; {count} are needed")
        values.append(_floats(path, number, words[1:]))
    return [words[0] for _, words in rows], np.array(values).reshape(-1, count)


def _is_moment(path: Path, unit: str) -> bool:
    for expected, moment in (("N", False), ("N*m", True)):
        try:
            conversion(unit, expected=expected)
        except ValueError:
            continue
        return moment
    raise ReadError(path, "LOAD_UNIT", f"[{unit}] is neither a force nor a moment; examples: lbs, N, in-lbs, N*m")


def _output_factor(path: Path, unit: str) -> float:
    try:
        return conversion(unit, expected="mV/V").factor
    except ValueError as error:
        raise ReadError(path, "GAGE_OUT_UNIT", str(error)) from None
