"""What is known of a sensor as one text, for formats whose attributes are texts."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any, Final

from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import CrossAxis, SensorSpec

KEY: Final = "sensor"
"""Attribute of a column that has the text."""

_LONGEST: Final = 4096


def sensor_text(spec: SensorSpec) -> str:
    """Return what is known of a sensor as JSON; an empty string where nothing is known beside its readings."""
    usual = SensorSpec().known()
    given = {name: value for name, value in spec.known().items() if value != usual[name]}
    if spec.filter is not None:
        given["filter"] = asdict(spec.filter)
    if spec.cross_axis:
        given["cross_axis"] = [asdict(part) for part in spec.cross_axis]
    return json.dumps(given, sort_keys=True) if given else ""


def sensor_of(text: Any) -> SensorSpec:
    """Return what a text says of a sensor; nothing where it is not of this program, or damaged."""
    if not isinstance(text, str) or not text.startswith("{") or len(text) > _LONGEST:
        return SensorSpec()
    try:
        given: dict[str, Any] = json.loads(text)
        if "filter" in given:
            given["filter"] = AntiAlias(**given["filter"])
        given["cross_axis"] = tuple(CrossAxis(**part) for part in given.get("cross_axis", ()))
        for key in ("place", "axis"):
            if key in given:
                given[key] = tuple(float(part) for part in given[key])
        return SensorSpec(**given)
    except (ValueError, TypeError, KeyError, RecursionError):
        return SensorSpec()
