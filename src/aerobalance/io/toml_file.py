"""TOML files, which may be anybody's."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any, Final

from aerobalance.io.opening import opened_file
from aerobalance.recording.errors import ReadError

LARGEST: Final = 1_000_000
"""Bytes that a TOML file may have: no map, no set-up and no mass comes near."""

_PART: Final = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""
_LONG_KEY: Final = re.compile(rf"(?<![\w-]){_PART}(?:\.[ \t]*+{_PART}){{50}}")


def read_toml(path: Path, *, what: str) -> dict[str, Any]:
    """Read a TOML file that may hold anything.

    Parameters
    ----------
    path
        The file.
    what
        What it should be, for the message: ``a channel map``, say.

    Raises
    ------
    ReadError
        The file is missing, too large, or no TOML.
    """
    with opened_file(path) as stream:
        head = stream.read(LARGEST + 1)
    if len(head) > LARGEST:
        raise ReadError(path, "", f"is larger than {LARGEST / 1e6:g} MB, which {what} is not")
    try:
        text = head.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ReadError(path, "", f"is no TOML: {error}") from None
    return toml_in(text, path)


def toml_in(text: str, path: Path | str) -> dict[str, Any]:
    """Read TOML from a text of at most `LARGEST` letters; `path` is what messages call it.

    Raises
    ------
    ReadError
        It is no TOML, or would take the parser more than its length is worth.
    """
    long = _LONG_KEY.search(text)
    if long is not None:
        line = text.count("\n", 0, long.start()) + 1
        raise ReadError(path, f"line {line}", "has a key of more than 50 parts joined by dots; no key here has")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ReadError(path, "", "is nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise ReadError(path, "", f"is no TOML: {' '.join(str(error).split())[:200]}") from None
    except ValueError:  # the interpreter converts no whole number of more than 4300 digits
        raise ReadError(path, "", "holds a number of thousands of digits") from None


def quoted(text: str) -> str:
    """Write a TOML string, for a line of a file that keeps its comments: tomli-w writes none."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
