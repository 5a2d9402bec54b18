"""The fields of the set-up's form: what they are called, their units, and what may be chosen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pydantic import BaseModel

from aerobalance.acquire.feed import Hello
from aerobalance.acquire.setup import SOURCES, Files, Record, SetChannel, SetLimit, Setup, setup_text
from aerobalance.channel import QUANTITIES

LABELS: Final[Mapping[str, tuple[str, str, str]]] = {
    "name": ("Name of the test", "", ""),
    "notes": ("Notes", "", ""),
    "files.balance": ("Balance matrix", "", "balance.json, for gauge outputs"),
    "files.dynamics": ("Dynamics", "", "dynamics.json from identify; the live force needs it"),
    "files.mass": ("Moving mass", "", "mass.json from weigh"),
    "source.rig": ("Rig", "", ""),
    "source.rate": ("Sampling rate", "Hz", "empty for that of the printed experiment"),
    "source.seed": ("Seed of the noise", "", "empty for a fresh one"),
    "source.speed": ("Speed", "", "seconds of the source in a second of the clock"),
    "source.block": ("Block", "s", ""),
    "source.frequency": ("Drive frequency", "Hz", "vibration rig"),
    "source.amplitude": ("Drive amplitude", "N", "vibration rig"),
    "source.cable_force": ("Cable force", "N", "empty for the printed one"),
    "source.cut_at": ("Cable cut at", "s", "empty for on call"),
    "source.noise": ("Noise", "", "times the printed one"),
    "source.file": ("Recording", "", "file below the project folder"),
    "source.map": ("Channel map", "", ""),
    "record.seconds": ("Length", "s", "empty for no end"),
    "record.block": ("Block on the disk", "s", "written and acknowledged at once"),
    "record.pre_trigger": ("Before the trigger", "s", ""),
    "record.trigger": ("Trigger", "", ""),
    "record.delay": ("Delay", "s", 'with trigger "time"'),
    "record.channel": ("Trigger channel", "", 'with trigger "level"'),
    "record.level": ("Trigger level", "", "in the channel's unit"),
    "record.edge": ("Edge", "", ""),
    "record.after_limit": ("After a limit", "s", "still recorded once a limit has stopped it"),
    "record.keep_free": ("Keep free", "MB", "on the disk"),
    "channels.input": ("Input", "", "name at the source"),
    "channels.unit": ("Unit", "", ""),
    "channels.sign": ("Sign", "", ""),
    "channels.scale": ("Scale", "", ""),
    "channels.offset": ("Offset", "", ""),
    "channels.delay": ("Delay", "s", ""),
    "channels.noise": ("Noise", "", "empty: estimated"),
    "channels.relative_uncertainty": ("Gain uncertainty", "", "relative"),
    "channels.coupling": ("Coupling", "", "of accelerations"),
    "channels.corner": ("Corner", "Hz", 'with coupling "ac"'),
    "channels.half_range": ("Half range", "", "percentages refer to it"),
    "limits.low": ("Low", "", ""),
    "limits.high": ("High", "", ""),
    "limits.action": ("Action", "", ""),
}
"""Label, unit and hint of the fields; a field that is not here is shown under its own key."""


def form_of(setup: Setup, hello: Hello | None) -> dict[str, Any]:
    """Describe the form and what is in it, as plain data.

    Parameters
    ----------
    setup
        The set-up that is edited.
    hello
        What the source says of itself; None where there is none.
    """
    sources = {kind: _fields(model, "source", leave_out=("kind",)) for kind, model in SOURCES.items()}
    return {
        "values": setup.model_dump(mode="json", exclude_none=True, exclude_unset=True)
        | {"source": setup.source.model_dump(mode="json", exclude_none=True, exclude_unset=True)}
        | {"kind": setup.source.kind},
        "text": setup_text(setup),
        "general": [_field("name", {"type": "string"}, ""), _field("notes", {"type": "string", "long": True}, "")],
        "files": _fields(Files, "files"),
        "sources": sources,
        "record": _fields(Record, "record"),
        "channel": _fields(SetChannel, "channels"),
        "limit": _fields(SetLimit, "limits"),
        "inputs": [] if hello is None else [{"name": item.name, "unit": item.unit} for item in hello.channels],
        "quantities": [{"name": name, "unit": unit} for name, unit in QUANTITIES.items()],
    }


def _fields(model: type[BaseModel], table: str, *, leave_out: tuple[str, ...] = ()) -> list[dict[str, Any]]:
    properties = model.model_json_schema()["properties"]
    return [_field(f"{table}.{key}", value, key) for key, value in properties.items() if key not in leave_out]


def _field(path: str, schema: Mapping[str, Any], key: str) -> dict[str, Any]:
    """One field: its key in the set-up, label, unit, hint, type (``number``, ``text`` or ``choice``) and default."""
    label, unit, hint = LABELS.get(path, (path, "", ""))
    kinds = [schema, *schema.get("anyOf", ())]
    choices = next((kind["enum"] for kind in kinds if "enum" in kind), None)
    numeric = any(kind.get("type") in ("number", "integer") for kind in kinds)
    return {
        "path": path,
        "key": key or path,
        "label": label,
        "unit": unit,
        "hint": hint,
        "type": "choice" if choices else "number" if numeric else "text",
        "whole": any(kind.get("type") == "integer" for kind in kinds),
        "long": bool(schema.get("long")),
        "choices": choices,
        "default": schema.get("default"),
        "needed": "default" not in schema and bool(key),
    }
