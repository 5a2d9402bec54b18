"""How everything stands, as plain data for the page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from aerobalance.acquisition.source_settings import Simulated

if TYPE_CHECKING:
    from aerobalance.app.monitor.station import Station


def state_of(station: Station) -> dict[str, Any]:
    """Draw up the state of a station."""
    return {
        "source": _source(station),
        "record": _record(station),
        "zeros": dict(station.zeros),
        "alarms": station.alarms.shown,
        "messages": list(station.messages),
        "tasks": [
            {key: value for key, value in task.items() if key != "account"} for task in station.tasks.listed.values()
        ],
        "recordings_version": station.listed_version,
        "setup": {
            "name": station.setup.name,
            "file": None if station.setup_file is None else station.setup_file.name,
            "dynamics": station.setup.files.dynamics,
            "seconds": station.setup.record.seconds,
        },
        "sweep": station.sweep,
        "check": station.checks.shown,
        "folder": station.folder.path.name,
    }


def _source(station: Station) -> dict[str, Any]:
    source, session = station.source, station.session
    found: dict[str, Any] = {"state": source.state, "text": source.text, "number": source.number}
    if session is not None:
        found["controls"] = {name: station.controls.get(name) for name in session.hello.controls}
    if isinstance(station.setup.source, Simulated):
        found["rig"] = station.setup.source.rig
    return found


def _record(station: Station) -> dict[str, Any]:
    progress = station.progress
    if progress is None:
        return {"state": "none"}
    names = (
        "state",
        "reason",
        "blocks",
        "samples",
        "seconds",
        "gaps",
        "lost",
        "events",
        "touched",
        "free",
        "full",
        "mishap",
        "unkept",
    )
    return {name: getattr(progress, name) for name in names} | {"file": Path(progress.path).name}
