"""What a command prints of its result: text for people, or one JSON object."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import typer
from rich.console import Console


def show(work: Callable[[], dict[str, Any]], as_json: bool, *, doing: str, plain: str | None = None) -> None:
    """Do the work with a sign of life, and print its account."""
    with Console(stderr=True).status(f"{doing} ..."):
        account = work()
    if as_json:
        from aerobalance.io.artefacts import json_text

        account.pop("summary", None)  # a table for people
        typer.echo(json_text(account), nl=False)
    elif plain is not None:
        typer.echo(account[plain], nl=False)
    else:
        typer.echo(text_of(account))


def text_of(account: dict[str, Any]) -> str:
    """Lay an account out in two columns, nested keys joined by dots, one line each."""
    lines = _lines(account)
    width = max((len(key) for key, _ in lines), default=0)
    return "\n".join(f"{key:<{width}}  {text}" for key, text in lines)


def _lines(item: Any, prefix: str = "") -> list[tuple[str, str]]:
    if isinstance(item, dict):
        if "value" in item:
            return [(prefix, _quantity(item))]
        lines = []
        for key, value in item.items():
            if key not in {"covariance", "warnings", "residuals", "model", "budget", "spectrum", "monte_carlo"}:
                lines += _lines(value, f"{prefix}.{key}" if prefix else str(key))
        return lines
    if isinstance(item, list) and item and isinstance(item[0], dict):
        return [line for number, part in enumerate(item, 1) for line in _lines(part, f"{prefix}.{number}")]
    if isinstance(item, list):
        return [(prefix, ", ".join(_text(part) for part in item) or "none")]
    return [(prefix, _text(item))]


def _quantity(item: dict[str, Any]) -> str:
    value = item["value"]
    text = " to ".join(_text(part) for part in value) if isinstance(value, list) else _text(value)
    doubt = f" (u = {item['u']:.2g})" if "u" in item else ""
    unit = item.get("unit", "")
    return f"{text}{doubt}{'' if unit in {'', '1'} else f' {unit}'}"


def _text(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:.7g}"
    return str(value)
