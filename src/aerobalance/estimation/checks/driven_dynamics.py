"""What the response to the ground's motion says of the dynamics of one component: for others, or against others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.driven_response import driven_response, speaks_against
from aerobalance.estimation.checks.other_dynamics import OtherDynamics, if_changed
from aerobalance.estimation.checks.spoken import MOVED
from aerobalance.estimation.independent_record import SingleRecord
from aerobalance.estimation.spectra.lines import Line
from aerobalance.estimation.steps import Step


def driven_dynamics(
    record: SingleRecord, *, used: SingleRecord, steps: Sequence[Step], lines: Sequence[Line]
) -> OtherDynamics | None:
    """What the response to the ground's motion says against the dynamics; None where it says nothing.

    Parameters
    ----------
    record, used, steps, lines
        As in `driven_response`.
    """
    found = driven_response(record, used=used, steps=steps, lines=lines)
    if found is None:
        return None
    dynamics = record.dynamics
    known = [
        dynamics.uncertainty(name) / (getattr(dynamics, name) or 1.0)
        for name in ("natural_frequency", "damping_ratio")
    ]
    frequency, damping = (
        if_changed(float(change), float(u)) for change, u in zip(found.change, np.hypot(found.u, known), strict=True)
    )
    if frequency is None and damping is None:
        return None
    return OtherDynamics(
        dynamics.component,
        frequency=frequency,
        damping=damping,
        during=", as its response to the ground's motion shows",
    )


def without_contradicted(
    found: OtherDynamics, record: SingleRecord, *, used: SingleRecord, steps: Sequence[Step], lines: Sequence[Line]
) -> OtherDynamics:
    """The same without another resonance that the response to the ground's motion speaks against.

    Parameters
    ----------
    found
        What the record says against the dynamics; of a part of it, or of none, the motion is no witness.
    record, used, steps, lines
        As in `driven_response`.
    """
    against = partial(speaks_against, record=record, used=used, steps=steps, lines=lines)
    if found.changed and not found.silent and found.within is None:
        (*_, told) = found.doubts(record.dynamics)
        if isinstance(told.other, Dynamics) and against(told.other):
            found = replace(found, frequency=None, damping=None)
    if found.possible is not None and found.possible.kind in MOVED and against(found.possible.dynamics):
        found = replace(found, possible=None)
    return found
