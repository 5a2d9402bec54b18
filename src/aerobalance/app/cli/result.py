"""What a command prints of its result: a short answer for people, all of it, or one JSON object."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import typer
from rich.console import Console

from aerobalance.app.cli import loading, streams
from aerobalance.app.cli.options import Json, Replace, Verbose

FOR_PEOPLE: Final = ("summary", "details")
"""Texts of a result: the short answer, and tables that go with all of it."""

FIRST: Final = "compiling the estimator for this machine, once: this takes a few seconds"
"""What is said where a command is the first that needs compiled loops."""

NOT_LISTED: Final = frozenset(
    {"covariance", "warnings", "residuals", "model", "budget", "spectrum", "monte_carlo", "map"}
)
"""Parts of a result that are for programs, or that a text for people holds already."""

_LISTED: Final = 4


class Manner(NamedTuple):
    """How a command answers, and whether it may put its result in the place of any file; a bundle of options.

    Attributes
    ----------
    as_json
        One JSON object instead of the short answer.
    verbose
        All of the result after the short answer.
    replace
        Whether what exists may be replaced even where it is no result of the same kind.
    """

    as_json: Json = False
    verbose: Verbose = False
    replace: Replace = False


def show(work: Callable[[], dict[str, Any]], manner: Manner, *, doing: str) -> None:
    """Do the work with a sign of life, and print its result.

    Where the result itself goes to standard output, the answer goes to standard error.
    """
    from aerobalance.io.safe_write import OUTPUTS
    from aerobalance.recording.first_use import FIRST_USE
    from aerobalance.recording.progress import telling

    loading.done()
    OUTPUTS.begin(replace=manner.replace)
    try:
        console = Console(stderr=True)
        FIRST_USE.told = lambda: console.print(FIRST, markup=False, highlight=False, soft_wrap=True)
        status = console.status(f"{doing} ...")
        with status, telling(lambda text: status.update(f"{doing}: {text}")):
            result = work()
    except Exception as problem:
        if OUTPUTS.wanted:
            problem.add_note(OUTPUTS.told())
        raise
    finally:
        FIRST_USE.told = None
        OUTPUTS.end()
    try:
        _answer(result, manner)
        sys.stdout.flush()
    except BrokenPipeError:  # whoever reads it has seen enough; the parser would take it for a failure
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _answer(result: dict[str, Any], manner: Manner) -> None:
    """Print the result; where the file itself goes to standard output, print it beside."""
    from aerobalance.app.options import as_options, result_as_options
    from aerobalance.io.safe_write import OUTPUTS

    result = dict(result)
    summary, details = (result.pop(key, "") for key in FOR_PEOPLE)
    written: dict[str, Any] = {}
    if OUTPUTS.written:
        written["outputs"] = [streams.plain(str(path)) for path in OUTPUTS.written]
        written["replaced"] = [str(path) for path in OUTPUTS.replaced]
    piped = streams.pass_on()
    if manner.as_json:
        from aerobalance.io.artefacts import json_text

        typer.echo(streams.plain(json_text(result_as_options(result) | written)), nl=False, err=piped)
        return
    parts = [as_options(summary).rstrip()]
    if manner.verbose:
        told = as_options(details() if callable(details) else details).rstrip()  # laid out where it is asked for
        parts += ["", *([told, ""] if told else []), text_of(result_as_options(result) | written), ""]
    parts += closing(result | written)
    typer.echo(streams.plain("\n".join(parts).strip("\n")), err=piped)


def closing(result: dict[str, Any]) -> list[str]:
    """Return the last lines of an answer: how many warnings there are, and where the files are."""
    lines = []
    count = len(result.get("warnings") or ())
    if count:
        lines.append(f"{count} warning{'s' if count > 1 else ''}, on standard error")
    outputs, replaced = result.get("outputs", ()), result.get("replaced", ())
    if len(outputs) > _LISTED:
        again = f", of which {len(replaced)} replaced" if replaced else ""
        lines.append(f"written: {len(outputs)} files in {Path(outputs[-1]).parent}{again}")
    else:
        lines += [f"{'replaced' if path in replaced else 'written'}: {path}" for path in outputs]
    return lines


def text_of(result: dict[str, Any]) -> str:
    """Lay a result out in two columns, nested keys joined by dots, one line each."""
    lines = _lines(result)
    width = max((len(key) for key, _ in lines), default=0)
    return "\n".join(f"{key:<{width}}  {text}".rstrip() for key, text in lines)


def _lines(item: Any, prefix: str = "") -> list[tuple[str, str]]:
    if isinstance(item, dict):
        if "value" in item:
            return [(prefix, _quantity(item))]
        lines = []
        for key, value in item.items():
            if key not in NOT_LISTED:
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
    u_text = f" (u = {item['u']:.2g})" if "u" in item else ""
    unit = item.get("unit", "")
    return f"{text}{u_text}{'' if unit in {'', '1'} else f' {unit}'}"


def _text(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value + 0.0:.7g}"  # no minus before a zero
    return str(value)
