"""A balance matrix from either of its layouts: balance.json, or the text of BALFIT."""

from __future__ import annotations

from pathlib import Path

from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.io.balance_file import read_balance
from aerobalance.io.balfit_matrix import is_balfit_matrix, read_balfit_matrix
from aerobalance.io.opening import opened_file


def is_matrix(path: Path) -> bool:
    """Say whether a file holds a balance matrix, in balance.json or in the text layout of BALFIT."""
    head = _head(path)
    return is_balfit_matrix(head) or (head.lstrip("\ufeff \r\n").startswith("{") and '"balance"' in head)


def read_matrix(path: Path) -> BalanceMatrix:
    """Read a matrix from balance.json or from the text layout of BALFIT.

    Raises
    ------
    ReadError
        The file cannot be read as either.
    """
    return read_balfit_matrix(path) if is_balfit_matrix(_head(path)) else read_balance(path)


def _head(path: Path) -> str:
    with opened_file(path) as file:
        return file.read(4096).decode("latin-1").replace("\x00", "")
