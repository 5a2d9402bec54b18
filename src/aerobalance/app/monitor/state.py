"""How everything stands, as plain data for the page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from aerobalance.acquisition.source_settings import Simulated
from aerobalance.app.monitor.live_source import LiveSource
from aerobalance.app.monitor.records import Records
from aerobalance.app.monitor.session import MonitorSession


def state_of(session: MonitorSession) -> dict[str, Any]:
    """Draw up the state of a session."""
    source, log, setup = session.source, session.log, session.source.setup
    return {
        "source": _source(source),
        "record": _record(session.records),
        "zeros": dict(source.zeros),
        "alarms": session.alarms.shown,
        "messages": list(log.messages),
        "tasks": [
            {key: value for key, value in task.items() if key != "account"} for task in session.tasks.listed.values()
        ],
        "campaign": session.campaign.shown,
        "recordings_version": log.listed_version,
        "setup": {
            "name": setup.name,
            "file": None if session.setup_file is None else session.setup_file.name,
            "dynamics": setup.files.dynamics,
            "seconds": setup.record.seconds,
        },
        "sweep": None if session.sweep is None else session.sweep.shown,
        "check": session.checks.shown,
        "folder": session.folder.path.name,
    }


def _source(source: LiveSource) -> dict[str, Any]:
    stands, session, settings = source.state, source.session, source.setup.source
    found: dict[str, Any] = {"state": stands.state, "text": stands.text, "number": stands.number}
    if session is not None:
        found["controls"] = {name: source.controls.get(name) for name in session.info.controls}
    if isinstance(settings, Simulated):
        found["rig"] = settings.rig
    return found


def _record(records: Records) -> dict[str, Any]:
    progress = records.progress
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
