"""The force that was really applied, from the readings of a wind-tunnel strain-gauge balance.

In the order of a test: `calibrate` a load schedule to a balance matrix, `weigh` the model, `identify` the dynamics,
`plan` the test, `estimate_force` of a run with the uncertainty of every sample, its `budget` and `monte_carlo` check.
`LiveForce` does it as the readings come, and `run_campaign` for all runs of a test.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from aerobalance.recording.version import VERSION

if TYPE_CHECKING:
    from aerobalance.app.commands.campaign import run_campaign
    from aerobalance.balance.calibration.fit import calibrate
    from aerobalance.balance.reduction import reduce_outputs
    from aerobalance.balance.weighing.from_outputs import weigh
    from aerobalance.balance.zeros import Zero
    from aerobalance.dynamics.single import Dynamics
    from aerobalance.estimation.force import estimate_force
    from aerobalance.estimation.live.live_force import LiveForce
    from aerobalance.identification.identify import identify
    from aerobalance.identification.impact.tap_point import TapPoint
    from aerobalance.io.any_result import write
    from aerobalance.io.anything import read
    from aerobalance.io.schedule import read_schedule
    from aerobalance.recording.recording import Recording
    from aerobalance.uncertainty.budget import budget
    from aerobalance.uncertainty.monte_carlo import monte_carlo
    from aerobalance.uncertainty.planning import plan
    from aerobalance.validation.compare import compare

__version__ = VERSION

_PLACES: Final = {
    "Recording": "aerobalance.recording.recording",
    "read": "aerobalance.io.anything",
    "write": "aerobalance.io.any_result",
    "read_schedule": "aerobalance.io.schedule",
    "calibrate": "aerobalance.balance.calibration.fit",
    "weigh": "aerobalance.balance.weighing.from_outputs",
    "Zero": "aerobalance.balance.zeros",
    "reduce_outputs": "aerobalance.balance.reduction",
    "Dynamics": "aerobalance.dynamics.single",
    "identify": "aerobalance.identification.identify",
    "TapPoint": "aerobalance.identification.impact.tap_point",
    "plan": "aerobalance.uncertainty.planning",
    "estimate_force": "aerobalance.estimation.force",
    "budget": "aerobalance.uncertainty.budget",
    "monte_carlo": "aerobalance.uncertainty.monte_carlo",
    "compare": "aerobalance.validation.compare",
    "LiveForce": "aerobalance.estimation.live.live_force",
    "run_campaign": "aerobalance.app.commands.campaign",
}
"""Public names in the order of a test, and where they are: they are imported when they are first used."""

__all__ = [
    "Dynamics",
    "LiveForce",
    "Recording",
    "TapPoint",
    "Zero",
    "budget",
    "calibrate",
    "compare",
    "estimate_force",
    "identify",
    "monte_carlo",
    "plan",
    "read",
    "read_schedule",
    "reduce_outputs",
    "run_campaign",
    "weigh",
    "write",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'aerobalance' has no attribute {name!r}; it has {', '.join(_PLACES)}")
    found = getattr(import_module(_PLACES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return [*_PLACES, "__version__"]
