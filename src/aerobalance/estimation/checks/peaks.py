"""Narrow peaks that coupled dynamics do not explain, and what is said of them.

Decoupled, a component shows nothing of the modes of the balance, whichever load excites them: the rows of D and A take
them out. A narrow peak that is left is a mode that the matrices do not have, or have elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from aerobalance.dynamics.modal import Mode
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.wording import frequency_text

SAME_MODE: Final = 0.03
"""Relative difference of frequency up to which a peak is taken for a mode that has moved, or is wrongly damped."""


@dataclass(frozen=True, slots=True)
class Peak:
    """A narrow peak that the dynamics do not explain.

    Attributes
    ----------
    component
        Component in which it was seen.
    frequency, u_frequency
        Its frequency and standard uncertainty [Hz].
    """

    component: str
    frequency: float
    u_frequency: float


def peak_doubts(peaks: Iterable[Peak], modes: tuple[Mode, ...]) -> list[Doubt]:
    """Doubts of the dynamics: one for every frequency at which components show a peak.

    Parameters
    ----------
    peaks
        The peaks of all components.
    modes
        The modes of the dynamics.
    """
    groups: list[list[Peak]] = []
    for peak in sorted(peaks, key=lambda peak: peak.frequency):
        if groups and peak.frequency < groups[-1][-1].frequency * (1 + SAME_MODE):
            groups[-1].append(peak)
        else:
            groups.append([peak])
    return [_doubt(group, modes) for group in groups]


def _doubt(peaks: list[Peak], modes: tuple[Mode, ...]) -> Doubt:
    best = min(peaks, key=lambda peak: peak.u_frequency)
    names = ", ".join(sorted({peak.component for peak in peaks}))
    where = f"{names} ring at {frequency_text(best.frequency, best.u_frequency)}"
    near = min(modes, key=lambda mode: abs(mode.natural_frequency / best.frequency - 1), default=None)
    if near is not None and abs(near.natural_frequency / best.frequency - 1) < SAME_MODE:
        kind = "natural frequency"
        text = (
            f"{where}, and not as the mode at {near.natural_frequency:.4g} Hz does that the dynamics have: stiffness, "
            "mass or damping have changed since they were identified, the flow adds its own, or a channel is late "
            "against the others or read by another matrix; forces near that frequency are wrong"
        )
        advice = "compare delays and matrix with those of the identification, or identify the dynamics again"
    else:
        kind = "missing mode"
        text = (
            f"{where}, which is no mode of the dynamics: a mode of the model or the sting that they lack, or a narrow "
            "band of the load itself; forces near that frequency are wrong if it is a mode"
        )
        advice = "identify the dynamics again"
    return Doubt(kind, best.component, text, advice, unit=si_unit(best.component))
