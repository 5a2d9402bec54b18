"""Identification from taps with an instrumented hammer, of one component or of several coupled ones.

With the static calibration of the balance, X + D X' + A X'' = g h(t): the ringing after a tap tells A and D as that
after a release does, Eq. (8) of [Gorbushin2020]_ with matrices; the measured force tells how it began, and is held
against the balance's own calibration. It does not tell the mass: neither load nor force holds a displacement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from aerobalance.balance.matrix_errors import MatrixErrors
from aerobalance.identification.coupled.combinations import (
    STILL,
    combination_text,
    first_release_for,
)
from aerobalance.identification.coupled.conclusions import check_recordings, colour_of, rigid_of
from aerobalance.identification.coupled.modes import ModeTable
from aerobalance.identification.coupled.result import colour_warnings, common_parts, force_error_warnings
from aerobalance.identification.coupled.units import Units, dynamics_of
from aerobalance.identification.impact.shaker import identify_shaker, is_shaken
from aerobalance.identification.impact.tap_account import account_of, excitation_of_taps
from aerobalance.identification.impact.tap_doubts import (
    damping_hardly_told,
    judged_points,
    left_out,
    missing_mode,
    scatter_of,
    taps_that_differ,
    unequal_taps,
)
from aerobalance.identification.impact.tap_fit import TapFit, settle_taps
from aerobalance.identification.impact.tap_model import Point
from aerobalance.identification.impact.tap_point import U_GAIN, TapPoint, fit_point, point_of
from aerobalance.identification.impact.tap_record import SETTINGS, TapRecord, tap_record
from aerobalance.identification.impact.tap_result import ALL, ImpactFit, ImpactIdentification, Taps
from aerobalance.identification.impact.tap_stages import (
    PlacedTap,
    anywhere,
    free_taps,
    linked_taps,
    loads_found,
    tap_apart,
)
from aerobalance.identification.one_component import one_component
from aerobalance.identification.step_relaxation.calibration_errors import covariance_of_calibration
from aerobalance.identification.step_relaxation.experiment_design import unmoved
from aerobalance.identification.step_relaxation.fit import ReleaseFit
from aerobalance.identification.step_relaxation.identify import sizes_of
from aerobalance.recording.channel import IMPACT_FORCE, Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import WHERE_TAPPED, FitError, warn_quality
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What the fit of taps found, whatever the number of components."""

    fit: TapFit
    units: Units
    taps: Taps
    colour: Array
    decays: ReleaseFit


def identify_taps(
    recordings: Sequence[Recording],
    *,
    components: Sequence[str] = COMPONENTS,
    mass: float | tuple[float, float] | None = None,
    half_range: Mapping[str, float] | None = None,
    modes: int | Literal["auto"] = "auto",
    points: Sequence[TapPoint | None] = (),
    errors: Sequence[MatrixErrors] = (),
) -> ImpactFit | ImpactIdentification:
    """Identify F = X + D X' + A X'', Eq. (17) of [Gorbushin2020]_ with matrices, from taps of measured force.

    Parameters
    ----------
    recordings
        One or more taps in each, all at one point and in one direction, with the channel ``impact_force``. All at the
        same sampling rate. For one component, one recording of a shaker on the model serves as well.
    components
        Components, some of `COMPONENTS`; several are taken as coupled.
    mass
        Weighed mass [kg; kg*m for a moment], exact or with its standard uncertainty. One component needs it; all six
        get their mass matrix from it.
    half_range
        Half of range by component [N, N*m]; where not given, the largest change of load in the recordings.
    modes
        Number of modes; ``"auto"`` takes those that the ringing shows clearly.
    points
        Where the taps of every recording were given; None for one whose channel says it. One component may do without:
        the taps are then taken to be along it.
    errors
        Where the balance matrix was used, for each recording: what its calibration leaves in A and D of coupled
        components is then in `CoupledDynamics.covariance_of_calibration`.

    Raises
    ------
    ValueError
        There is no recording, or components, mass, half range, points or sampling rates do not fit.
    FitError
        The taps leave a combination of loads at rest, the ringing shows too few modes, or no fit settles.

    Notes
    -----
    The likelihood is that of the readings before and after each contact and of the force's readings in it, all noisy.
    No window is used: what is cut off at the end of a record is left to the model, and adds no damping.
    """
    names = tuple(name for name in COMPONENTS if name in components)
    _check_call(recordings, names, components, mass=mass, points=points)
    given = list(points) or [None] * len(recordings)
    where = [point_of(recording, point) for recording, point in zip(recordings, given, strict=True)]
    _check_points(recordings, where, names)
    if any(is_shaken(recording) for recording in recordings):
        return _shaken(recordings, where, names, mass, modes)
    records = [tap_record(recording, names) for recording in recordings]
    places = list(dict.fromkeys(where))
    taps = [
        PlacedTap(record, tap, places.index(point))
        for record, point in zip(records, where, strict=True)
        for tap in record.taps
        if tap.fault != "double hit"
    ]
    component = names[0] if len(names) == 1 else ALL
    _check_left(taps, records)
    decays = [tap.decay for tap in taps]
    sizes = sizes_of(decays, names, half_range)
    _check_moved(taps, sizes, names)
    found = _fitted(taps, records, places, recordings, sizes=sizes, modes=modes, names=names, component=component)
    if len(names) == 1:
        return _single(found, names[0], mass)
    left = _of_calibration(found, taps, records, errors, names) if errors else None
    return _coupled(found, names, mass, given=half_range is not None, left=left)


def _of_calibration(
    found: _Found,
    taps: Sequence[PlacedTap],
    records: Sequence[TapRecord],
    errors: Sequence[MatrixErrors],
    names: tuple[str, ...],
) -> Array | None:
    """What the calibration leaves in A and D, as in the ringing alone: an error E of the loads makes A + E A - A E."""
    if found.fit.internal:
        warn_quality(
            "what the calibration of the balance leaves is not worked out where the model or the sting bends; the "
            "uncertainties lack it"
        )
        return None
    of = [errors[next(place for place, one in enumerate(records) if one is tap.record)] for tap in taps]
    return covariance_of_calibration(found.decays, found.units, [tap.decay for tap in taps], of, components=names)


def _shaken(
    recordings: Sequence[Recording],
    where: Sequence[TapPoint | None],
    names: tuple[str, ...],
    mass: float | tuple[float, float] | None,
    modes: int | Literal["auto"],
) -> ImpactFit:
    """One component, from a shaker."""
    if len(names) > 1:
        raise FitError(
            f"{recordings[0].name}: the force acts all along, as that of a shaker; several components are identified "
            "from taps, or from a shaken ground end (identify rig)"
        )
    if len(recordings) > 1 or mass is None:
        raise ValueError(f"a shaker is fitted in one recording at a time, not in {len(recordings)}")
    return identify_shaker(recordings[0], component=names[0], mass=mass, modes=modes, point=where[0])


def _check_call(
    recordings: Sequence[Recording],
    names: tuple[str, ...],
    components: Sequence[str],
    *,
    mass: float | tuple[float, float] | None,
    points: Sequence[TapPoint | None],
) -> None:
    check_recordings(recordings, names, components, of="taps")
    if points and len(points) != len(recordings):
        raise ValueError(f"a point is needed for each of {len(recordings)} recordings, not {len(points)}")
    if len(names) == 1 and mass is None:
        raise ValueError(
            "mass is needed: taps tell stiffness and damping only in proportion to the mass, as neither the load nor "
            "the force tells a displacement"
        )
    if len(names) > 1 and mass is not None and names != COMPONENTS:
        raise ValueError(f"a mass matrix needs all of {', '.join(COMPONENTS)}; leave the mass out")
    if isinstance(mass, tuple) and not (0 < mass[0] < np.inf and mass[1] >= 0):
        raise ValueError(f"mass must be positive, its uncertainty zero or more: {mass[0]}, {mass[1]}")


def _check_points(recordings: Sequence[Recording], where: Sequence[TapPoint | None], names: tuple[str, ...]) -> None:
    """Refuse taps of which it is not known where they were given, where that matters."""
    lacking = [recording.name for recording, point in zip(recordings, where, strict=True) if point is None]
    if lacking and len(names) > 1:
        raise ValueError(
            f"{', '.join(lacking)}: where was the model tapped, and which way? {WHERE_TAPPED}, aft, "
            f"right and up from the balance's centre, or place and axis of {IMPACT_FORCE} in the channel map"
        )


def _check_left(taps: Sequence[PlacedTap], records: Sequence[TapRecord]) -> None:
    if taps:
        return
    called, count = ", ".join(record.name for record in records), sum(len(record.taps) for record in records)
    if not count:
        raise FitError(
            f"{called}: no tap is followed by {SETTINGS.fewest_after} usable readings of the loads; record for longer "
            "after a tap, and wait longer before the next"
        )
    raise FitError(
        f"{called}: in all {count} taps the hammer touched twice, so none is left; tap again, with the hammer hanging "
        "loosely"
    )


def _check_moved(taps: Sequence[PlacedTap], sizes: Array, names: tuple[str, ...]) -> None:
    """Refuse taps that leave a combination of loads at rest."""
    still = [
        name
        for column, name in enumerate(names)
        if all(np.ptp(tap.record.values[tap.found.after, column]) == 0 for tap in taps)
    ]
    if still:
        raise FitError(f"the readings of {', '.join(still)} never change after the taps; is the balance connected?")
    combinations = unmoved([tap.decay for tap in taps], sizes)
    if not len(combinations):
        return
    called = ", ".join(dict.fromkeys(tap.record.name for tap in taps))
    if len(combinations) == len(names):
        raise FitError(f"{called}: the loads do not ring after the taps; is the balance connected?")
    texts = " nor ".join(combination_text(weights, names) for weights in combinations)
    raise FitError(
        f"{called}: no tap moves {texts} (loads over half of range) above the noise, so {len(combinations)} of "
        f"{len(names)} modes stay unknown; add taps that load {first_release_for(combinations, names)}"
    )


def _fitted(
    taps: Sequence[PlacedTap],
    records: Sequence[TapRecord],
    places: Sequence[TapPoint | None],
    recordings: Sequence[Recording],
    *,
    sizes: Array,
    modes: int | Literal["auto"],
    names: tuple[str, ...],
    component: str,
) -> _Found:
    """Fit the ringing, then the force, and judge what the one says of the other."""
    with PROGRESS.stage(0.0, 0.6, "ringing"):
        free, units, ringing = free_taps(taps, sizes=sizes, modes=modes)
    _check_seen(free, taps, names)
    doubts = [*left_out(records, component), *missing_mode(ringing.peak, component)]
    stated = [fit_point(place, names, sizes) for place in places]
    u_gain = max(recording.channel(IMPACT_FORCE).relative_uncertainty or U_GAIN for recording in recordings)
    fit = free
    linked, scale = any(tap.found.fault is None for tap in taps), 1.0
    if free.internal and not linked:
        raise FitError("a mode of the model or sting needs taps of measured force, and that of none can be used")
    if linked:
        with PROGRESS.stage(0.6, 0.4, "force"):
            loose, leave = _without_those_apart(free, taps, units, anywhere(stated))
            judged = judged_points(
                stated, loads_found(loose), u_gain=u_gain, component=component, sizes=sizes, names=names
            )
            fit = linked_taps(free, taps, units, judged.points, u_gain=judged.u_gain, leave=leave)
        scale = judged.scale
        doubts += [*taps_that_differ(taps, leave, component), *judged.doubts]
    fit, colour, more = _with_lack_of_fit(fit, units, names, component)
    if more:  # the same, said better
        doubts = [one for one in doubts if one.kind != "missing mode"]
    doubts += more
    return _Found(
        fit,
        units,
        account_of(fit, units, taps, records, places, doubts=doubts, component=component, scale=scale),
        colour,
        ringing.decays,
    )


def _without_those_apart(
    free: TapFit, taps: Sequence[PlacedTap], units: Units, points: Sequence[Point]
) -> tuple[TapFit, list[bool]]:
    """The fit without taps whose force does not go with their ringing, the worst first, and which these are.

    Of two at a point that differ none is known to be right, so that both are left out; where none is left, the fit is
    that with all.
    """
    good = [number for number, tap in enumerate(taps) if tap.found.fault is None]
    leave = [False] * len(taps)
    first = found = linked_taps(free, taps, units, points, u_gain=0.0, leave=leave)
    while (worst := tap_apart(found)) is not None:
        leave[worst] = True
        here = [number for number in good if taps[number].point == taps[worst].point]
        if sum(not leave[number] for number in here) < 2:
            for number in here:
                leave[number] = True
        if all(leave[number] for number in good):
            return first, leave
        found = linked_taps(free, taps, units, points, u_gain=0.0, leave=leave)
    return found, leave


def _check_seen(fit: TapFit, taps: Sequence[PlacedTap], names: tuple[str, ...]) -> None:
    """Refuse taps that leave a mode in the noise."""
    count = len(names) + fit.internal
    poles = fit.motion.poles
    energy = np.sum(excitation_of_taps(fit)[1] ** 2, axis=0)
    if (poles.real >= 0).any() or np.count_nonzero(poles.imag > 0) != count or energy.min() < STILL:
        called = ", ".join(dict.fromkeys(tap.record.name for tap in taps))
        raise FitError(
            f"{called}: the ringing after the taps does not show {count} decaying modes above the noise; tap at other "
            "points and along other directions, with a harder tip where fast modes are missing, or more strongly"
        )


def _with_lack_of_fit(
    fit: TapFit, units: Units, names: tuple[str, ...], component: str
) -> tuple[TapFit, Array, list[Doubt]]:
    """The fit with uncertainties that contain what departs from it, the color of the residuals, and the doubts."""
    parts = [
        (linear.after, float(np.median(np.diff(tap.time)))) for tap, linear in zip(fit.taps, fit.linears, strict=True)
    ]
    colour = colour_of(parts, fit.motion, fit.noise)
    scatter = scatter_of(fit)
    doubts = []
    larger = colour
    if scatter is not None:
        table = ModeTable.of(dynamics_of(fit.common.matrices, fit.information, units, names), sizes=units.sizes)
        mode = table.modes[scatter.mode]
        known = float(table.u_damping_ratio[scatter.mode]) / mode.damping_ratio
        factor = max(scatter.chi2 / scatter.degrees_of_freedom, (scatter.damping / 2 / known) ** 2)
        doubts.append(unequal_taps(scatter, mode.natural_frequency, component))
        larger = np.maximum(colour, factor)
    if (larger > 1).any():
        noise = fit.noise * np.sqrt(np.outer(larger, larger))
        try:
            fit = settle_taps(fit.taps, fit.points, fit.common, fit.own, noise=noise, off=fit.off)
        except FitError:  # the valley of what is left out
            fit = replace(fit, noise=noise)
    return fit, colour, doubts


def _single(found: _Found, component: str, mass: float | tuple[float, float] | None) -> ImpactFit:
    """Mass, stiffness and damping of one component."""
    value, u_mass = mass if isinstance(mass, tuple) else (mass or 0.0, 0.0)
    coupled = dynamics_of(found.fit.common.matrices, found.fit.information, found.units, (component,))
    dynamics = one_component(coupled, value, u_mass)
    doubts = list(found.taps.doubts)
    doubts += damping_hardly_told(dynamics, "the ringing", "tap more strongly, or record for longer")
    notes = [*map(str, doubts)]
    for note in notes:
        warn_quality(note)
    return ImpactFit(dynamics, replace(found.taps, doubts=tuple(doubts)), tuple(notes))


def _coupled(
    found: _Found, names: tuple[str, ...], mass: float | tuple[float, float] | None, *, given: bool, left: Array | None
) -> ImpactIdentification:
    """A and D of several components, and what they leave."""
    fit, units = found.fit, found.units
    dynamics = dynamics_of(fit.common.matrices, fit.information, units, names)
    if left is not None:
        dynamics = replace(dynamics, covariance_of_calibration=left)
    rigid, notes = rigid_of(dynamics, mass)
    if rigid is not None:
        dynamics = replace(dynamics, mass=rigid.mass)
    common = common_parts(
        dynamics,
        fit.motion,
        half_range=units.sizes,
        half_range_given=given,
        residual_deviation=found.taps.residual_deviation,
        reduced_chi2=found.taps.reduced_chi2,
        colour=found.colour,
        degrees_of_freedom=fit.degrees_of_freedom,
    )
    result = ImpactIdentification(**common, notes=(), taps=found.taps, rigid=rigid)
    said = force_error_warnings(
        result,
        left_by="taps",
        energy=np.sum(excitation_of_taps(fit)[1] ** 2, axis=0),
        remedy="four times as many taps",
        after=float(np.max(result.force_error / units.sizes)) / 2,
    )
    told = [*map(str, found.taps.doubts), *said, *colour_warnings(result), *notes]
    for note in told:
        warn_quality(note)
    return replace(result, notes=tuple(told))
