"""What a validation finds wrong, in one short sentence."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any

from pydantic import BaseModel, ValidationError


def first_fault(error: ValidationError, model: type[BaseModel]) -> tuple[str, str]:
    """Return the key and the sentence for the first fault of a validation.

    Parameters
    ----------
    error
        What the validation raised.
    model
        The model that was validated; its fields are the keys allowed.
    """
    fault = error.errors(include_url=False)[0]
    kind, given = fault["type"], fault.get("input")
    keys = [str(part) for part in fault["loc"] if not _is_branch(part)]
    where = ".".join(keys)
    if kind == "missing":
        return where, "is missing"
    if kind == "extra_forbidden":
        allowed = _fields(model, keys[:-1])
        near = get_close_matches(keys[-1], allowed, 1)
        meant = f"; did you mean {near[0]}?" if near else ""
        return where, "is not known" + meant + (f"; allowed: {', '.join(allowed)}" if allowed else "")
    said = fault["msg"].removeprefix("Value error, ")
    said = (
        said.partition(", unable to parse")[0]
        .replace("Input should be", "must be")
        .replace("a valid ", "a ")
        .replace("dictionary", "table")
    )
    return where, f"{said}, not {_shown(given)}"


def _is_branch(part: object) -> bool:
    """Whether a part of a place names a branch of a union and no key."""
    return isinstance(part, str) and (
        part in ("str", "int", "float") or part.startswith(("constrained-", "function-"))
    )


def _shown(given: Any) -> str:
    text = repr(given)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _fields(model: type[BaseModel], keys: list[str]) -> list[str]:
    """Names that are allowed at a place of a model."""
    current: Any = model
    named = False
    for key in keys:
        if named or key.isdecimal():  # the name of an entry or its number, and no key of the model
            named = False
            continue
        fields = {field.alias or name: field for name, field in getattr(current, "model_fields", {}).items()}
        if key not in fields:
            return []
        annotation = fields[key].annotation
        inner = getattr(annotation, "__args__", ())
        current = next((part for part in inner if hasattr(part, "model_fields")), annotation)
        named = getattr(annotation, "__origin__", None) is dict
    return [field.alias or name for name, field in getattr(current, "model_fields", {}).items()]
