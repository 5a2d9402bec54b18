"""What can go wrong, said so that the reader can act on it."""

from __future__ import annotations

from pathlib import Path


class FitError(Exception):
    """The data cannot carry the result; the message says which data and what would help."""


class ReadError(Exception):
    """A file cannot be used.

    Parameters
    ----------
    path
        The file.
    where
        The place in the file (line, column, key), or an empty string for the file as a whole.
    what
        What was found there and what is allowed.
    """

    def __init__(self, path: Path | str, where: str, what: str) -> None:
        self.path = Path(path)
        self.where = where
        self.what = what
        place = f"{self.path}: {where}" if where else f"{self.path}"
        super().__init__(f"{place}: {what}")


class DoubtWarning(UserWarning):
    """Data that can be used but not trusted fully; the message says what it does to the result."""
