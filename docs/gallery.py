"""How the scripts of examples/ are run for their pages."""

from __future__ import annotations

import warnings
from typing import Any

from aerobalance.recording.errors import DataQualityWarning


def doubts_are_errors(_configuration: dict[str, Any], _script: str) -> None:
    """Have a script fail, and with it the build, that is warned of its data: its page would not explain that."""
    warnings.simplefilter("error", DataQualityWarning)
