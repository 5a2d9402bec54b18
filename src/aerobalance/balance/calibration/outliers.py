"""Outliers of a calibration: points that contradict the others, the loads that their readings belong to, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.calibration.regression import Regression
from aerobalance.balance.matrix import Way
from aerobalance.balance.schedule import Schedule
from aerobalance.balance.terms import Term, linear_part
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import argument


@dataclass(frozen=True, slots=True)
class OutlierSettings:
    """Thresholds of the outliers of a calibration.

    Attributes
    ----------
    residual
        Deleted residual of a point that AIAA R-091 looks into [mV/V].
    most_deviations
        Standard deviations from which only that an outlier has more of them is said: no chance reaches there.
    alone
        Change of the other loads, over that of one load, up to which that load alone is wrong: interactions that are
        not linear make about a hundredth of it.
    none
        Load over the one that is read, up to which the schedule has none.
    powers
        Powers of ten by which a decimal point may be wrong.
    exact
        Relative difference up to which a load is what a mistake makes of another.
    seen
        Standard deviations up to which a reading departs by chance, and by half of what an interaction would make it.
    missed
        Twice the log-likelihood of the other readings without the interactions over that with them, from which on the
        load was there and only one bridge was read wrongly: 9000 to 1, a schedule having hundreds of points.
    """

    residual: float = 2.5e-3
    most_deviations: float = 100.0
    alone: float = 0.05
    none: float = 1e-4
    powers: int = 3
    exact: float = 0.05
    seen: float = 6.0
    missed: float = 18.2


SETTINGS: Final = OutlierSettings()
"""Thresholds that are used."""

MOST_NAMED: Final = 5
"""Most outliers that one message has."""


@dataclass(frozen=True, slots=True)
class Outlier:
    """Calibration point that contradicts the others.

    Attributes
    ----------
    point
        Its position in the schedule, from 0.
    component
        Position of the component whose bridge shows it.
    residual
        Deleted residual: output less what the other points tell of it [mV/V].
    studentised
        The same over its standard deviation as the other points tell it; infinite where they fit to the last digit.
    label
        Words that name the point, as `Schedule.without` takes them.
    load
        The component's load in the schedule [N, N*m].
    load_read
        The load that the readings are those of, by the other points [N, N*m].
    cause
        The mistake that explains it, in words; empty where none of those that are known does.
    """

    point: int
    component: int
    residual: float
    studentised: float
    label: str = ""
    load: float = np.nan
    load_read: float = np.nan
    cause: str = ""

    @property
    def deviations(self) -> float | None:
        """`studentised` where it means something; None from `SETTINGS.most_deviations` on, where no chance reaches."""
        return self.studentised if abs(self.studentised) < SETTINGS.most_deviations else None

    @property
    def size(self) -> str:
        """How many standard deviations, in words: a number that means something, or a bound."""
        found = self.deviations
        return f"more than {SETTINGS.most_deviations:g}" if found is None else f"{abs(found):.2g}"


def outlying_points(regressions: Sequence[Regression], scale: Array) -> NDArray[np.bool_]:
    """Return which points contradict the others in any component, shape (n,); `scale` of outputs, (c,) [mV/V]."""
    return np.asarray(np.any([_far(fit, size) for fit, size in zip(regressions, scale, strict=True)], axis=0))


def _far(fit: Regression, scale: float) -> NDArray[np.bool_]:
    """Which points contradict the others in one component, by more than chance and than is looked into, shape (n,)."""
    return np.asarray(fit.outlying & (np.abs(fit.deleted) * scale > SETTINGS.residual))


def find_outliers(
    schedule: Schedule, terms: tuple[Term, ...], regressions: Sequence[Regression], scale: Array, way: Way
) -> tuple[Outlier, ...]:
    """Return the outliers of a calibration, strongest first.

    Parameters
    ----------
    schedule
        What was fitted: n points of c components.
    terms
        The t terms.
    regressions
        Those of the components on the terms, which have the residuals.
    scale
        Output that the regressions have as one, shape (c,) [mV/V].
    way
        Whether outputs were fitted on loads (iterative) or loads on outputs.
    """
    points = np.flatnonzero(schedule.fitted)
    departures = np.column_stack([fit.deleted for fit in regressions])
    deviation = np.array([fit.deviation_without for fit in regressions])
    # by how much the load that is read is more than that of the schedule, over capacity; not by the matrix itself,
    # which the outliers have a part in
    iterative = way == "iterative"
    linear = linear_part(terms, np.column_stack([fit.coefficients_without for fit in regressions]))
    more = np.linalg.solve(linear, departures.T).T if iterative else -departures
    found = []
    for index, fit in enumerate(regressions):
        output = fit.deleted * scale[index]
        for row in np.flatnonzero(_far(fit, scale[index])):
            point = int(points[row])
            read = schedule.loads[point] + more[row] * schedule.capacities
            bridge = _one_bridge(linear, departures[row], deviation) if iterative else None
            if bridge is not None:
                cause = f"the reading of r{schedule.gauges[bridge]} is wrong, as the other bridges show nothing of it"
            else:
                cause = _cause(schedule, point, index, read)
            found.append(
                Outlier(
                    point,
                    index,
                    float(output[row]),
                    float(fit.studentised[row]),
                    schedule.label(point),
                    float(schedule.loads[point, index]),
                    float(read[index]),
                    cause,
                )
            )
    return _exchanged(schedule, tuple(sorted(found, key=lambda item: -abs(item.studentised))))


def _one_bridge(linear: Array, departure: Array, deviation: Array) -> int | None:
    """The bridge that departs alone, where a wrong load would have shown in others by its interactions; else None."""
    own = int(np.argmax(np.abs(departure)))
    if linear[own, own] == 0:
        return None
    others = np.arange(departure.size) != own
    least = np.maximum(deviation[others], 1e-12 * abs(departure[own]))  # of a fit to the last digit it is 0
    expected = linear[others, own] * departure[own] / linear[own, own] / least
    found = departure[others] / least
    nothing = np.abs(found) < np.maximum(np.abs(expected) / 2, SETTINGS.seen)
    missed = float(np.sum(expected**2 - 2 * expected * found))  # of all of them: each may show little
    return own if missed > SETTINGS.missed and np.all(nothing) else None


def _cause(schedule: Schedule, point: int, index: int, read: Array) -> str:
    """The mistake that turns the loads that are read into those of the schedule; empty where none is known."""
    loads, capacities = schedule.loads[point], schedule.capacities
    change = np.abs(read - loads) / capacities
    worst = int(np.argmax(change))
    alone = np.all(np.delete(change, worst) < SETTINGS.alone * change[worst])
    name = schedule.components[worst]
    if not alone:
        second = int(np.argsort(change)[-2])
        crossed = np.array(loads)
        crossed[[worst, second]] = loads[[second, worst]]
        # what is read is as exact as its own bridge tells it, whatever the capacity of the other
        exchanged = np.all(np.abs(read - crossed) / capacities < SETTINGS.exact * change[worst])
        return f"the loads of {name} and {schedule.components[second]} are exchanged" if exchanged else ""
    if abs(loads[worst]) < SETTINGS.none * abs(read[worst]):
        return f"a load of {name} was on the balance that the schedule does not have"
    return _factor(float(read[worst] / loads[worst]), name) or ("" if worst == index else f"the load of {name}")


def _factor(ratio: float, name: str) -> str:
    """The mistake that makes the load read this many times that of the schedule; empty where none is known."""
    if abs(ratio + 1) < SETTINGS.exact:
        return f"the sign of {name}"
    if abs(ratio) < SETTINGS.exact:
        return f"the load of {name} was not on the balance"
    power = round(np.log10(abs(ratio)))
    if 0 < abs(power) <= SETTINGS.powers and abs(abs(ratio) / 10.0**power - 1) < SETTINGS.exact:
        return f"the decimal point of {name}" + (" and its sign" if ratio < 0 else "")
    return ""


def _exchanged(schedule: Schedule, found: tuple[Outlier, ...]) -> tuple[Outlier, ...]:
    """Say of outliers of one component, each with the load that the other reads, that their lines are exchanged."""
    partner: dict[int, Outlier] = {}  # by place in the list, each in one pair
    for place, item in enumerate(found):
        near = SETTINGS.exact * abs(item.load_read - item.load)
        for later in range(place + 1, len(found)):
            one = found[later]
            if (
                not {place, later} & partner.keys()
                and one.component == item.component
                and one.point != item.point
                and abs(one.load - item.load_read) < near
                and abs(one.load_read - item.load) < near
            ):
                partner[place], partner[later] = one, item
    return tuple(
        replace(item, cause=f"exchanged with {partner[place].label!r}") if place in partner else item
        for place, item in enumerate(found)
    )


def outlier_text(schedule: Schedule, item: Outlier) -> str:
    """Return an outlier in words: component, point, load of the schedule and load read, deviations, cause."""
    unit = "N*m" if schedule.moments[item.component] else "N"
    name = schedule.components[item.component]
    cause = f"; probably {item.cause}" if item.cause else ""
    return (
        f"{name} at point {item.label!r} ({item.load:.6g} {unit}, but the readings are those of {item.load_read:.6g} "
        f"{unit}: {1e3 * item.residual:+.3g} uV/V, {item.size} standard deviations{cause})"
    )


def outliers_text(schedule: Schedule, found: Sequence[Outlier]) -> str:
    """Return outliers in a sentence or two: which, and what to do."""
    labels = list(dict.fromkeys(item.label for item in found))
    told = [outlier_text(schedule, item) for item in found[:MOST_NAMED]] + ["..."] * (len(found) > MOST_NAMED)
    return (
        f"{f'{len(labels)} points do' if len(labels) > 1 else '1 point does'} not go with the others: "
        f"{'; '.join(told)}. Correct the file, or leave out what is wrong: {argument('Schedule.without', labels)}"
    )
