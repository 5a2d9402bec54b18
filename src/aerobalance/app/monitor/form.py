"""The fields of the set-up's form: what they are called, their units, and what may be chosen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pydantic import BaseModel

from aerobalance.acquisition.feed import SourceInfo
from aerobalance.acquisition.safety import SetEnvelope, SetFouling, SetLimit, SetShunt, SetStation
from aerobalance.acquisition.setup import Files, Record, SetChannel, Setup, setup_text
from aerobalance.acquisition.source_settings import SOURCES
from aerobalance.recording.channel import QUANTITIES
from aerobalance.recording.components import COMPONENTS

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
    "source.balance": ("Balance of the rig", "", "rig six: its matrix, for gauge outputs in mV/V"),
    "source.circuit": ("Contact circuit", "", "between model and support"),
    "source.noise": ("Noise", "", "times the printed one"),
    "source.loop": ("Again and again", "", "begins anew at its end"),
    "source.file": ("Recording", "", "file below the project folder"),
    "source.map": ("Channel map", "", "for a recording of another program"),
    "source.address": ("Address", "", "of the openDAQ device, such as daq.nd://192.168.0.5"),
    "source.server": (
        "NI gRPC server",
        "",
        "host:port, such as 192.168.0.5:31763; empty for devices of this computer",
    ),
    "source.skew": ("Skew", "s", "from one channel to the next of a device with one converter for all"),
    "source.inputs": ("Inputs", "", "The analog inputs, in the order in which the device takes them."),
    "source.inputs.physical": ("Physical channel", "", "such as cDAQ1Mod1/ai0"),
    "source.inputs.measures": ("Measures", "", ""),
    "source.inputs.low": ("Range from", "", "in mV/V, V or m/s²"),
    "source.inputs.high": ("Range to", "", "in mV/V, V or m/s²"),
    "source.inputs.excitation": ("Excitation", "V", "of a bridge"),
    "source.inputs.excitation_source": ("Excitation from", "", "the device, or a supply of its own"),
    "source.inputs.bridge": ("Bridge", "", ""),
    "source.inputs.resistance": ("Bridge resistance", "ohm", ""),
    "source.inputs.sensitivity": ("Sensitivity", "mV/g", "of an accelerometer"),
    "source.inputs.current": ("Current", "A", "for an accelerometer"),
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
    "channels.delay": ("Delay", "s", "by which its readings are late; the force allows for it"),
    "channels.noise": ("Noise", "", "empty: estimated"),
    "channels.relative_uncertainty": ("Gain uncertainty", "", "relative"),
    "channels.zero_uncertainty": ("Zero uncertainty", "", "in the channel's unit"),
    "channels.place": ("Place", "m", "of a ground accelerometer, aft right up of the centre: 0.5 0 0.1"),
    "channels.place_uncertainty": ("Place uncertainty", "m", ""),
    "channels.axis": ("Axis", "", "of a ground accelerometer: aft, right or up, or its shares of these: 0 0.6 0.8"),
    "channels.coupling": ("Coupling", "", "of accelerations"),
    "channels.corner": ("Corner", "Hz", 'with coupling "ac"'),
    "channels.half_range": ("Half range", "", "percentages refer to it"),
    "limits.low": ("Low", "", "in the channel's unit"),
    "limits.high": ("High", "", "in the channel's unit"),
    "limits.action": ("Action", "", "stop ends the record"),
    "envelope.shape": ("Shape", "", "of limits, or else half ranges; stations: those below; balance: its capacities"),
    "envelope.action": ("Action", "", "stop ends the record"),
    "stations.limit": ("Limit", "N or N·m", "largest size of the sum"),
    **{f"stations.{name}": (name, "", "share of it in the sum") for name in COMPONENTS},
    "shunt.change": ("Change", "", "as at the calibration, in the channel's unit"),
    "shunt.resistance": ("Shunt resistor", "ohm", "instead of a change, for channels in mV/V"),
    "shunt.bridge": ("Bridge", "ohm", "each of its four arms"),
    "shunt.uncertainty": ("Uncertainty", "", "standard, over the change"),
    "shunt.tolerance": ("Tolerance", "", "over the change"),
    "fouling.channel": ("Contact channel", "", "of the circuit between model and support"),
    "fouling.level": ("Closed from", "", "in the channel's unit"),
    "fouling.closed": ("Closed", "", "on which side of it"),
    "fouling.hold": ("Hold", "s", "open so long before a contact is over"),
    "fouling.action": ("Action", "", "stop ends the record"),
    "fouling.tolerance": ("Return to zero", "", "tolerance, over half of the range"),
}
"""Label, unit and hint of the fields; the label of one that is not here is its key."""

HINTS: Final[Mapping[str, str]] = {
    "nidaqmx.rate": "the device takes the nearest that it has",
}
"""Hints that are others for one kind of source."""


def form_of(setup: Setup, info: SourceInfo | None) -> dict[str, Any]:
    """Describe the form and what is in it, as plain data.

    Parameters
    ----------
    setup
        The set-up that is edited.
    info
        What the source says of itself; None where there is none.
    """
    sources = {kind: _fields(model, "source", leave_out=("kind",), kind=kind) for kind, model in SOURCES.items()}
    return {
        "values": setup.model_dump(mode="json", exclude_none=True, exclude_unset=True)
        | {"source": setup.source.model_dump(mode="json", exclude_none=True, exclude_unset=True)}
        | {"kind": setup.source.kind},
        "text": setup_text(setup),
        "general": [_field("name", {}, "name", {}), _field("notes", {"long": True}, "notes", {})],
        "files": _fields(Files, "files"),
        "sources": sources,
        "record": _fields(Record, "record"),
        "envelope": _fields(SetEnvelope, "envelope"),
        "fouling": _fields(SetFouling, "fouling"),
        "tables": {
            "channels": _fields(SetChannel, "channels"),
            "limits": _fields(SetLimit, "limits"),
            "stations": _fields(SetStation, "stations"),
            "shunt": _fields(SetShunt, "shunt"),
        },
        "inputs": [] if info is None else [{"name": item.name, "unit": item.unit} for item in info.channels],
        "quantities": [{"name": name, "unit": unit} for name, unit in QUANTITIES.items()],
    }


def _fields(
    model: type[BaseModel], table: str, *, leave_out: tuple[str, ...] = (), kind: str = ""
) -> list[dict[str, Any]]:
    schema = model.model_json_schema()
    return [
        field | ({"hint": HINTS[name]} if (name := f"{kind}.{field['key']}") in HINTS else {})
        for field in _all(table, schema, schema.get("$defs", {}))
        if field["key"] not in leave_out
    ]


def _all(table: str, schema: Mapping[str, Any], named: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All fields of a table, and whether they are needed."""
    needed = schema.get("required", ())
    return [
        _field(f"{table}.{key}", value, key, named) | {"needed": key in needed}
        for key, value in schema["properties"].items()
    ]


def _field(path: str, schema: Mapping[str, Any], key: str, named: Mapping[str, Any]) -> dict[str, Any]:
    """One field: its key in the set-up, label, unit, hint, type and default.

    The type is ``number``, ``numbers`` (several), ``text``, ``choice``, ``data`` (anything else, as JSON), or
    ``table`` of tables by name, whose own fields are then in ``fields``.
    """
    label, unit, hint = LABELS.get(path, (key.replace("_", " ").capitalize(), "", ""))
    kinds = [schema, *schema.get("anyOf", ())]
    field: dict[str, Any] = {"path": path, "key": key, "label": label, "unit": unit, "hint": hint}
    inner = next((kind["additionalProperties"] for kind in kinds if "additionalProperties" in kind), None)
    if inner is not None:
        return field | {"type": "table", "fields": _all(path, named[inner["$ref"].rpartition("/")[2]], named)}
    types = {kind.get("type") for kind in kinds}
    choices = next((kind["enum"] for kind in kinds if "enum" in kind), [False, True] if "boolean" in types else None)
    parts = [part for kind in kinds for part in (*kind.get("prefixItems", ()), kind.get("items")) if part]
    several = bool(parts) and all(part.get("type") == "number" for part in parts)
    other = bool(types & {"array", "object"}) or any("$ref" in kind for kind in kinds)
    numeric = bool(types & {"number", "integer"})
    return field | {
        "type": "choice"
        if choices
        else "numbers"
        if several
        else "data"
        if other
        else "number"
        if numeric
        else "text",
        "long": bool(schema.get("long")),
        "choices": choices,
        "default": schema.get("default"),
    }
