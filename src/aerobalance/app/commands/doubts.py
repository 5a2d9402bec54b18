"""Doubts as plain data."""

from __future__ import annotations

from aerobalance.app.commands.shared import Result
from aerobalance.app.options import as_options
from aerobalance.recording.doubts import Doubt


def doubt_result(doubt: Doubt) -> Result:
    """Plain data on a doubt, its advice in the words of the command line."""
    return {
        "kind": doubt.kind,
        "component": doubt.component,
        "effect": doubt.effect,
        "unit": doubt.unit,
        "text": as_options(doubt.text),
        "advice": as_options(doubt.advice),
    }
