"""What can go wrong, said so that the reader can act on it."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator, Sequence, ValuesView
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Final, Self, cast

_PASSED_BY: Final = (str(Path(__file__).parents[1]) + os.sep, contextlib.__file__)
"""Files that a warning is not the place of: those of the package, and what stands between two of them."""

GAUGES_BECOME_LOADS: Final = "gauge outputs become loads by a balance matrix: reduce them first"
"""What to do with gauge outputs where loads are needed."""


NAMES_BY_MAP: Final = (
    "a channel map gives the columns of another program these names: `aerobalance map FILE -o map.toml` writes one to "
    "complete, and `channel_map` takes it"
)
"""What to do where no channel has a name that is known."""

A_RELEASE: Final = "identify it as one, with `excitation='release'`"
"""What to do with a recording of a free decay."""

WHERE_TAPPED: Final = "Give a point and a direction for each recording in `points`"
"""What to do where it is not known where a model was tapped."""

WITH_A_MATRIX: Final = "give the balance matrix as `balance`"
"""What gauge outputs need."""


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
        name = str(path) if "://" in str(path) else str(self.path)  # a path would make one slash of two
        place = f"{name}: {where}" if where else name
        super().__init__(f"{place}: {what}")
        self._given = (path, where, what)

    def __reduce__(self) -> tuple[type[ReadError], tuple[Path | str, str, str]]:
        """Make it anew from what it was made of, in another process: an exception is made of its message otherwise."""
        return type(self), self._given


def argument(name: str, value: Any = None) -> str:
    """Return an argument as messages name it, such as ``modes='auto'`` in backquotes.

    The command line puts the option in its place that stands for the argument there, so a message reads well in both.

    Parameters
    ----------
    name
        The argument; with a dot a method or an attribute, such as ``Schedule.without``.
    value
        What to give; None leaves it open.
    """
    if value is None:
        return f"`{name}`"
    text = repr(value).replace("Ellipsis", "...")
    return f"`{name}({text})`" if "." in name else f"`{name}={text}`"


def not_as_given(wanted: str, given: object, instead: str) -> ValueError:
    """Return the error of an argument of another kind, such as the name of a file in place of what it holds."""
    name = "the name of a file" if isinstance(given, str | os.PathLike) else f"a {type(given).__name__}"
    return ValueError(f"{wanted} needed, not {name}: {instead}")


def check_recording(given: object) -> None:
    """Refuse what is no recording where one is needed.

    Raises
    ------
    ValueError
        It is the name of a file, a table, or something else.
    """
    if not hasattr(given, "samples"):
        raise not_as_given(
            "a recording is",
            given,
            "`read` reads one from a file, and `Recording.from_arrays`, `Recording.from_dataframe` or "
            "`Recording.from_xarray` makes one",
        )


def one_or_more(given: Any) -> list[Any]:
    """Return recordings that are given one or several at a time; ValueError where one of them is none."""
    several = isinstance(given, Sequence | Iterator | ValuesView) and not isinstance(given, str)
    found = list(given) if several else [given]
    for one in found:
        check_recording(one)
    return found


class DataQualityWarning(UserWarning):
    """Data that can be used but not trusted fully; the message says what it does to the result."""


class OfSamples(str):
    """What is said of some samples of a record in numbers; who puts these together says it of all of them.

    Attributes
    ----------
    size
        How much there is of it, such as a share of the samples: of the parts of a record that with the most is told.
    """

    __slots__ = ("size",)
    size: float

    def __new__(cls, text: str, size: float = 0.0) -> Self:
        """Make it of its text, and say how much there is of it."""
        made = super().__new__(cls, text)
        made.size = size
        return made


class OfMissing(OfSamples):
    """What is said of missing readings of some samples."""

    __slots__ = ()

    @classmethod
    def readings(cls, name: str, channels: str, count: int, samples: int) -> OfMissing:
        """Say how many readings of channels of a record are missing in rows that are there, or in none."""
        return cls(
            f"{name}: {count} of {samples} samples of {channels} are missing (empty or NaN); the model bridges them, "
            "and the uncertainty is larger there",
            count / max(samples, 1),
        )


class OfLoads(OfSamples):
    """What is said of the balance loads of some samples."""

    __slots__ = ()


_kept: ContextVar[list[str] | None] = ContextVar("kept", default=None)


@contextmanager
def kept_warnings() -> Iterator[list[str]]:
    """Collect what `warn_quality` is given, in this thread alone, to be said later.

    `warnings.catch_warnings` takes what all threads say.
    """
    said: list[str] = []
    token = _kept.set(said)
    try:
        yield said
    finally:
        _kept.reset(token)


def warn_quality(text: str) -> None:
    """Issue a `DataQualityWarning` at the line outside the package that called it."""
    kept = _kept.get()
    if kept is not None:
        kept.append(text)
        return
    level = 2
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PASSED_BY):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, DataQualityWarning, stacklevel=level)


_libraries_quiet: ContextVar[bool] = ContextVar("libraries_quiet", default=False)


class _OfQuietLibraries:
    """Stands for the pattern of the text in a filter of warnings: fits what is said where libraries are quiet."""

    def match(self, text: str) -> bool:
        """Return whether a warning is one of those."""
        del text
        return _libraries_quiet.get()


_QUIET: Final = ("ignore", _OfQuietLibraries(), Warning, None, 0)
"""A filter that stays among those of the process: it ignores nothing but within `quiet_libraries`."""


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Ignore all warnings, as libraries give them of what does not matter here, in this thread alone.

    `warnings.catch_warnings` puts back the filters of all threads: where it is left in another order than entered, as
    by threads side by side, or beside a compiler that uses it, those of one stay for the rest of the process.
    """
    filters = cast("list[object]", warnings.filters)
    if not filters or filters[0] is not _QUIET:
        filters.insert(0, _QUIET)
        for place in range(len(filters) - 1, 0, -1):  # one is enough, however often others come before it
            if filters[place : place + 1] == [_QUIET]:
                del filters[place]
    token = _libraries_quiet.set(True)
    try:
        yield
    finally:
        _libraries_quiet.reset(token)
