"""The force where a record, or a part of it, begins or ends without readings: what acted there nobody read.

A gap between readings lets a step in it be seen by what follows; one at an end does not. What was learned of the force
goes on there as beside it, but a load that comes or goes is in nothing that was read.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance.estimation.decoupled_record import DecoupledRecord
from aerobalance.estimation.error_sources import Systematic
from aerobalance.estimation.force_smoother import SmootherResult
from aerobalance.estimation.record import ComponentRecord
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import SETTINGS, Doubt

UNREAD: Final = "load where nothing is read"
"""Name of what it contributes to the uncertainty."""

MATTERS: Final = 0.1
"""What it contributes over all else (both rms) from which it is in the uncertainty."""


def unread_ends(record: ComponentRecord, fit: SmootherResult) -> tuple[list[Systematic], list[Doubt]]:
    """Return the error of a force where nothing was read up to an end of the record, and the doubt that says so.

    It is as large as the force itself: that no load at all was there is as likely as that it went on. Within a period
    of the slowest mode from the last reading it grows up to that, as what the balance does then is seen still.

    Parameters
    ----------
    record
        The component with its record.
    fit
        Its force by the smoother.
    """
    name, (present,), interval = record.dynamics.component, np.nonzero(fit.reading.present), fit.reading.interval
    count, begin = fit.force.size, record.recording.start
    period = 1 / min(mode.natural_frequency for mode in fit.reading.dynamics.modes)
    ends = [slice(0, int(present[0])), slice(int(present[-1]) + 1, count)]
    long = [end for end in ends if (end.stop - end.start) * interval > period]
    if not long:
        return [], []
    read = float(np.sqrt(np.mean(fit.force[fit.reading.present] ** 2)))
    slopes = np.zeros((count, len(long)))
    for place, end in enumerate(long):
        away = np.arange(1, end.stop - end.start + 1) * interval / period
        away = away[::-1] if end.start == 0 else away
        slopes[end, place] = np.minimum(away, 1.0) * np.maximum(np.abs(fit.force[end]), read)
    size, rest = float(np.sqrt(np.sum(slopes**2) / count)), float(np.sqrt(np.mean(fit.variance)))
    if size < MATTERS * rest:
        return [], []
    times = [f"{begin + end.start * interval:.6g} s to {begin + end.stop * interval:.6g} s" for end in long]
    error = Systematic(UNREAD, name, tuple(f"load from {one}" for one in times), slopes, np.eye(len(long)), local=True)
    if size < SETTINGS.doubtful * rest:
        return [error], []
    what = "a load that it is coupled with has, or it has itself," if isinstance(record, DecoupledRecord) else "it has"
    text = (
        f"the force {name} from {' and from '.join(times)} is not known: {what} no readings there, up to an end "
        "of the record or of a part of it; it is taken for going on as beside that, with an uncertainty as large as "
        f"itself, {size:.2g} {si_unit(name)} rms in all"
    )
    advice = "use the force of the samples that were read, or give the record without the others"
    return [error], [Doubt("no readings", name, text, advice, None, si_unit(name))]
