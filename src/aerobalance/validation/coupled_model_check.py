"""What a record says against coupled dynamics: modes that they lack, or have at another frequency.

Taken apart, a component shows nothing of the modes of the balance, whoever excites them: the rows of D and A take them
out. A narrow peak that is left is a mode that the matrices do not have, or have elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.single import Mode
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.record import ForceEstimate
from aerobalance.estimation.steps import columns_of
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps
from aerobalance.recording.wording import frequency_text
from aerobalance.validation.local_modes import Averaged, missing_mode

LONGEST: Final = 1 << 17
"""Samples from the start that are looked at: more tell nothing new."""

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


def misfits_of_coupled(
    recording: Recording, dynamics: CoupledDynamics, estimates: Mapping[str, ForceEstimate]
) -> list[str]:
    """Say which modes a record has beside those of the dynamics.

    Parameters
    ----------
    recording
        The record.
    dynamics
        What is known of the balance.
    estimates
        The forces that were found, whose noise and steps are taken.

    Returns
    -------
    sentences
        One for every frequency.
    """
    groups: list[list[Peak]] = []
    for peak in sorted(_peaks(recording, dynamics, estimates), key=lambda peak: peak.frequency):
        if groups and peak.frequency < groups[-1][-1].frequency * (1 + SAME_MODE):
            groups[-1].append(peak)
        else:
            groups.append([peak])
    return [_sentence(group, dynamics.modes) for group in groups]


def _peaks(recording: Recording, dynamics: CoupledDynamics, estimates: Mapping[str, ForceEstimate]) -> list[Peak]:
    record = CoupledRecord.of(recording, dynamics)
    found = []
    for name, job in record.jobs(interpolate_gaps(record.loads)).items():
        reading = job.reading()
        estimate = estimates[name]
        values = reading.values
        if not reading.present.all() or float(np.ptp(values)) == 0:
            continue
        columns = columns_of(list(estimate.steps), reading)
        sizes, *_ = np.linalg.lstsq(columns, values, rcond=None)
        left = (values - columns @ sizes)[:LONGEST]
        seen = Averaged.of(left, interval=reading.interval, noise=estimate.noise)
        mode = None if seen is None else missing_mode(seen, job.dynamics)
        if mode is not None:
            found.append(Peak(name, mode.mode.natural_frequency, mode.u_frequency))
    return found


def _sentence(peaks: list[Peak], modes: tuple[Mode, ...]) -> str:
    best = min(peaks, key=lambda peak: peak.u_frequency)
    names = ", ".join(sorted({peak.component for peak in peaks}))
    where = f"{names} ring at {frequency_text(best.frequency, best.u_frequency)}"
    near = min(modes, key=lambda mode: abs(mode.natural_frequency / best.frequency - 1), default=None)
    if near is not None and abs(near.natural_frequency / best.frequency - 1) < SAME_MODE:
        return (
            f"{where}, and not as the mode at {near.natural_frequency:.4g} Hz does that the dynamics have: stiffness, "
            "mass or damping have changed since they were identified, or the flow adds its own; forces near that "
            "frequency are wrong"
        )
    return (
        f"{where}, which is no mode of the dynamics: a mode of the model or the sting that they lack, or a narrow "
        "band of the load itself; forces near that frequency are wrong if it is a mode"
    )
