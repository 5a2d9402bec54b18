"""Objects by their full names."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def at(path: str) -> Any:
    """Find an object by its full name."""
    parts = path.split(".")
    for count in range(len(parts) - 1, 0, -1):
        try:
            found = import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for name in parts[count:]:
            found = getattr(found, name)
        return found
    raise AssertionError(path)
