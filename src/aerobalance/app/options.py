"""The command line's words for what the library names: options in place of arguments."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from typing import Any, Final

from aerobalance.recording.errors import A_RELEASE, GAUGES_BECOME_LOADS, WHERE_TAPPED, WITH_A_MATRIX

OPTIONS: Final[Mapping[str, str]] = {
    "Schedule.geometry": "--distances",
    "Schedule.without": "--leave-out",
    "Zero.after": "--zero-after",
    "Zero.recordings": "--zero",
    "bandwidth": "--bandwidth",
    "channel_map": "--map",
    "components": "--component",
    "dynamics": "--dynamics",
    "form": "--form",
    "hum": "--hum",
    "keep_outliers": "--keep-outliers",
    "align": "--align",
    "mass": "--mass",
    "model": "--model",
    "model_on": "--model-on-zero",
    "modes": "--modes",
    "noise": "--noise-record",
    "reading_noise": "--reading-noise",
    "replace": "--replace",
    "scales": "--scales",
    "step": "--step",
    "tare": "--tare",
    "way": "--way",
    "zero": "--zero",
}
"""Option by argument, as `aerobalance.recording.errors.argument` names it."""

PHRASES: Final[Mapping[str, str]] = {
    GAUGES_BECOME_LOADS: "gauge outputs become loads by a balance matrix: weigh, identify decay and rig, force and "
    "compare take --balance, and for other commands aerobalance loads --balance writes a recording of the loads",
    A_RELEASE: "identify decay takes it",
    WHERE_TAPPED: "Give the point and the direction (--at 0.1,0,0.05 --direction 0,0,-1)",
    WITH_A_MATRIX: "give --balance balance.json",
    "a weighing of all loads as `tare`": "the mass.json of a weighing of all loads (weigh without --component) with "
    "--mass",
    "a weighing as `tare`": "--mass",
    "`model_on` says which": "--model-on-zero on or off says which",
}
"""Phrases for which the command line has others than an option, or commands to name."""

_ARGUMENT: Final = re.compile(r"`([\w.]+)(?:=(.+?)|\((.+?)\))?`")


def as_options(text: str) -> str:
    """Return a message of the library with the options of the command line in place of arguments."""
    for phrase, ours in PHRASES.items():
        text = text.replace(phrase, ours)
    return _ARGUMENT.sub(_option, text)


def result_as_options(result: Any) -> Any:
    """Return a result with all of its texts as `as_options` gives them."""
    if isinstance(result, str):
        return as_options(result)
    if isinstance(result, dict):
        return {key: result_as_options(value) for key, value in result.items()}
    if isinstance(result, list | tuple):
        return [result_as_options(value) for value in result]
    return result


def _option(found: re.Match[str]) -> str:
    name, *values = found.groups()
    given = next((value for value in values if value is not None), "True")
    try:
        return " ".join([OPTIONS[name], *_words(ast.literal_eval(given))])
    except (KeyError, ValueError, SyntaxError):  # no argument, or none that an option stands for
        return found[0]


def _words(value: Any) -> list[str]:
    """Give a value as the words that follow an option."""
    if isinstance(value, bool):
        return [] if value else ["off"]
    if isinstance(value, dict):
        return [f"{key}={'VALUE' if one is ... else one}" for key, one in value.items()]
    if isinstance(value, list):
        return [f'"{one}"' for one in value]
    return [str(value)]
