"""Plain CSV: text columns with a header ``name [unit]`` per column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.channel import Array
from aerobalance.io.columns import Heading, RawColumns, split_label
from aerobalance.io.safe_write import replacing
from aerobalance.io.table import Table, table_from
from aerobalance.io.text_table import Layout, guess_encoding, read_labels, read_text_columns

NAME: Final = "CSV text"
"""What to call the format in messages."""

SUFFIXES: Final = {".csv": ",", ".txt": "\t", ".tsv": "\t"}
"""File name endings that are written in this format, and the separator of each."""


def can_read(head: bytes, path: Path) -> bool:
    """Say whether a file is text, from its first bytes; its name does not matter."""
    del path
    return guess_encoding(head) is not None


def read_columns(path: Path, layout: Layout | None = None, *, wanted: Sequence[str | int] | None = None) -> RawColumns:
    """Read the columns of a text file as they are; see `aerobalance.io.text_table.read_text_columns`."""
    return read_text_columns(path, layout, wanted=wanted)


def headings(path: Path) -> tuple[Heading, ...]:
    """Read what the header says of the columns.

    Raises
    ------
    ReadError
        The file is no text, or has no header.
    """
    return tuple(Heading(label, *split_label(label), i + 1) for i, label in enumerate(read_labels(path)))


def read_table(path: Path | str, *, required: Sequence[str] = (), missing_allowed: bool = False) -> Table:
    """Read a plain CSV table: any columns ``name [unit]``, no time needed.

    Parameters
    ----------
    path
        The file.
    required
        Names of columns that must be there.
    missing_allowed
        Whether cells may be empty (NaN then).

    Returns
    -------
    Table
        Columns of n cells each in SI units; angles in rad, gauge outputs in mV/V.

    Raises
    ------
    ReadError
        The file is no such table; the message says where and what is allowed.
    """
    raw = read_text_columns(Path(path))
    return table_from(raw, required=required, missing_allowed=missing_allowed)


def digits_for(least: Array) -> int | None:
    """Give the decimals at which rounding is below 1/2000 of what a result is not known to; None for all of them.

    Parameters
    ----------
    least
        Standard uncertainties, or noise, of which the smallest counts.
    """
    known = least[np.isfinite(least) & (least > 0)]
    if not known.size:
        return None
    return max(0, int(np.ceil(-np.log10(1e-3 * float(known.min())))))


def rounded(values: Array, digits: int) -> Array:
    """Round to so many decimals, without a minus before zeros; what is too large to have them stays as it is."""
    with np.errstate(over="ignore", invalid="ignore"):
        kept = np.round(values, digits) + 0.0
    return np.where(np.isfinite(kept), kept, values) if digits < 300 else values


def write_columns(path: Path, columns: Mapping[str, Array], described: object = None) -> None:
    """Write columns under their headers; missing samples become empty cells, numbers read back exactly.

    Parameters
    ----------
    path
        The file; its ending chooses the separator.
    columns
        Values, shape (n,) each, by header.
    described
        What is known of the columns, for which a text file has no place.
    """
    del described
    import pandas as pd  # noqa: PLC0415 - half a second, and only files need it

    finite = {name: np.where(np.isfinite(values), values, np.nan) for name, values in columns.items()}
    with replacing(path) as beside:
        pd.DataFrame(finite).to_csv(
            beside, index=False, sep=SUFFIXES[path.suffix.lower()], lineterminator="\n", encoding="utf-8"
        )
