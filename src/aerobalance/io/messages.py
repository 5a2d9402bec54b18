"""What a validation finds wrong, in one short sentence."""

from __future__ import annotations

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
        return where, "is not known" + (f"; allowed: {', '.join(allowed)}" if allowed else "")
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
    for key in keys:
        fields = getattr(current, "model_fields", None)
        if fields is None:
            return []
        if key not in fields:
            return []
        annotation = fields[key].annotation
        current = next((a for a in getattr(annotation, "__args__", ()) if hasattr(a, "model_fields")), annotation)
        if getattr(annotation, "__origin__", None) is dict:
            return list(current.model_fields)
    return list(getattr(current, "model_fields", ()))
