"""From recordings of taps to the fit of all: free decays first, then the force that set them off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.special import chdtrc

from aerobalance.identification.coupled.era import fit_state
from aerobalance.identification.coupled.free_response import generator_of
from aerobalance.identification.coupled.internal_coordinates import renewed
from aerobalance.identification.coupled.least_squares import motion_of, noise_of_residuals, whitener_of
from aerobalance.identification.coupled.units import Units
from aerobalance.identification.impact.tap_fit import TapFit, linears_of, of_common, settle_taps
from aerobalance.identification.impact.tap_model import Common, Point, Tap
from aerobalance.identification.impact.tap_record import FoundTap, TapRecord
from aerobalance.identification.step_relaxation.fit import ReleaseFit
from aerobalance.identification.step_relaxation.model_order import decays_with, free_decays, missed
from aerobalance.identification.step_relaxation.record import ROUNDING, ReleaseRecord
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

ANYWHERE: Final = 30.0
"""Uncertainty of the loads of 1 N, over the largest as stated, with which they count as not known."""

U_DELAY: Final = 20.0
"""Standard uncertainty of the delay of the force behind the loads before the taps tell it, in sampling intervals."""

BY_CHANCE: Final = 1e-5
"""Probability of a departure by chance below which it is believed."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedTap:
    """A tap with the record it is in and the number of its point."""

    record: TapRecord
    found: FoundTap
    point: int

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return f"{self.record.name} at {self.record.instant(self.found):.4g} s"

    @property
    def decay(self) -> ReleaseRecord:
        """The readings after it as a record of a free decay."""
        record, after = self.record, self.found.after
        return ReleaseRecord(
            self.name, after / record.rate, record.values[after], record.start, record.rate, record.noise, 0
        )

    def tap(self, units: Units, *, internal: int) -> Tap:
        """The same in the units of the fit; the force is used where nothing is wrong with it."""
        record, found = self.record, self.found
        first, last = found.contact
        rows = np.concatenate([found.before, found.after])
        interval = units.rate / record.rate
        based = min(1024, found.before.size)  # readings that the force counts from, as `_base` takes them
        noise = record.force_noise * np.sqrt(1 + found.force.size / max(based, 1))
        return Tap(
            name=self.name,
            point=self.point,
            time=(rows - last) * interval,
            values=record.values[rows] / units.sizes,
            before=found.before.size,
            instants=np.asarray(
                (np.arange(first - last, 1) - record.delay * record.rate) * interval, dtype=np.float64
            ),
            force=found.force * interval,
            force_noise=float(noise * interval),
            sampling=sampling_error(found.force),
            linked=found.fault is None,
            internal=internal,
        )


def sampling_error(force: Array) -> float:
    """What sampling may leave in the whole of a force, over it [1].

    Sums over the even and the odd samples differ by the spectrum at half the rate, over that at zero. A blow that
    begins and ends with a corner has a spectrum that falls with the square of the frequency: at the rate a quarter.
    """
    whole = float(force.sum())
    apart = abs(float(force[::2].sum() - force[1::2].sum()))
    return min(max(apart / (4 * abs(whole)) if whole else 1.0, 1e-6), 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Ringing:
    """The ringing as a fit of free decays, and the frequency of what it leaves [Hz]; None for nothing."""

    decays: ReleaseFit
    peak: float | None


def free_taps(
    taps: Sequence[PlacedTap], *, sizes: Array, modes: int | Literal["auto"]
) -> tuple[TapFit, Units, Ringing]:
    """Fit the matrices to the ringing after all taps, whatever set it off.

    Returns
    -------
    fit, units
        The fit and its units.
    ringing
        The same as a fit of free decays, and what it leaves.

    Raises
    ------
    FitError
        The ringing does not show so many modes, or the fit does not settle.
    """
    records = [tap.decay for tap in taps]
    if modes == "auto":
        free, units, _ = free_decays(records, sizes=sizes)
    else:
        free, units = decays_with(modes - sizes.size, records, sizes=sizes)
    made = [replace(tap.tap(units, internal=free.internal), linked=False) for tap in taps]
    motion, matrices = free.motion, free.matrices
    points = (Point("", np.zeros(sizes.size), np.zeros((sizes.size, 0))),)
    made = [replace(tap, point=0) for tap in made]
    own = [fit_state(motion, tap.time[tap.before :], tap.values[tap.before :])[0] for tap in made]
    common = Common(matrices, 0.0, 0.0, 0.0, 0.0)
    linears = linears_of(made, points, common, own, [np.zeros(0)], whitener=whitener_of(free.noise))
    fit = TapFit(tuple(made), points, common, tuple(own), (np.zeros(0),), free.noise, linears)
    return fit, units, Ringing(free, missed(free, units, records))


def linked_taps(
    free: TapFit,
    taps: Sequence[PlacedTap],
    units: Units,
    points: Sequence[Point],
    *,
    u_gain: float,
    leave: Sequence[bool],
) -> TapFit:
    """Fit the matrices to ringing and force together.

    Parameters
    ----------
    free
        The ringing alone.
    taps, units
        The taps.
    points
        Where they were given.
    u_gain
        Standard uncertainty of the gain of the force.
    leave
        For every tap, whether its force is left out.

    Raises
    ------
    FitError
        The fit does not settle.
    """
    made = [tap.tap(units, internal=free.internal) for tap in taps]
    made = [replace(tap, linked=tap.linked and not out) for tap, out in zip(made, leave, strict=True)]
    matrices, own = free.common.matrices, list(free.own)
    n = free.size
    if free.internal:
        matrices, turn = _begun_by_blows(free, made)
        own = [np.concatenate([mine[:n], turn @ mine[n:]]) for mine in own]
    start = [
        np.concatenate([mine[:n], np.zeros(mine.size - n + tap.force.size + 1)]) if tap.linked else mine
        for tap, mine in zip(made, own, strict=True)
    ]
    u_delay = U_DELAY * units.rate / taps[0].record.rate
    common = Common(matrices, 0.0, 0.0, u_gain, u_delay)
    fit = settle_taps(made, points, common, start, noise=free.noise)
    noise = noise_of_residuals(fit.residuals, degrees_of_freedom=fit.degrees_of_freedom, least=np.full(n, ROUNDING))
    return settle_taps(made, points, fit.common, fit.own, noise=noise, off=fit.off)


def _begun_by_blows(free: TapFit, taps: Sequence[Tap]) -> tuple[Array, Array]:
    """Matrices with internal coordinates that are at rest at zero under a load held, so that blows drive them by it.

    A blow leaves the state that the generator makes of a load held, so that the held states follow from those found.
    """
    n, size = free.size, free.size + free.internal
    spring, brake = free.common.matrices.reshape(2, size, size)
    states = np.array([mine[n:] for mine, tap in zip(free.own, taps, strict=True) if tap.linked]).T
    held = np.linalg.solve(generator_of(spring, brake), states) if states.size else states
    apart = np.linalg.svd(held / np.linalg.norm(held, axis=0), compute_uv=False) if states.size else np.zeros(0)
    if np.count_nonzero(apart > 1e-3) < n:
        raise FitError(
            f"a mode of the model or sting needs taps of measured force along every component, {n} that are no "
            f"combinations of each other; there are {np.count_nonzero(apart > 1e-3)}"
        )
    return renewed(free.common.matrices, n, let_go=held)


def anywhere(points: Sequence[Point]) -> list[Point]:
    """The same points with loads that are not known."""
    return [
        Point(point.name, point.loads, ANYWHERE * float(np.abs(point.loads).max()) * np.eye(point.loads.size))
        for point in points
    ]


@dataclass(frozen=True, slots=True, eq=False)
class LoadsFound:
    """Loads of 1 N as the taps at a point show them, over the sizes, and their covariance; None where none tells."""

    loads: Array
    covariance: Array


def loads_found(fit: TapFit) -> list[LoadsFound | None]:
    """Return the loads of 1 N at every point, as a fit with loads that are not known has found them."""
    _, kept = of_common(fit.blocks(0.0), fit.taps, fit.points, fit.off, fit.common)
    root = np.linalg.pinv(fit.shared)
    spread = root @ root.T
    found: list[LoadsFound | None] = []
    for place, (point, mine, factor) in enumerate(zip(fit.points, fit.off, kept, strict=True)):
        if not any(tap.linked and tap.point == place for tap in fit.taps):
            found.append(None)
            continue
        r = point.root.shape[1]
        inverse = np.linalg.inv(factor[:r, :r])
        along = factor[:r, r:-1]
        covariance = inverse @ (np.eye(r) + along @ spread @ along.T) @ inverse.T
        found.append(LoadsFound(point.loads + point.root @ mine, point.root @ covariance @ point.root.T))
    return found


def departure(difference: Array, covariance: Array) -> float:
    """Probability by chance of a difference at least as unlikely as this."""
    floor = 1e-12 * float(np.trace(covariance)) * np.eye(difference.size)
    return float(chdtrc(difference.size, float(difference @ np.linalg.solve(covariance + floor, difference))))


def tap_apart(fit: TapFit) -> int | None:
    """Return the tap whose force goes least with the ringing that it left, by its number; None where all do.

    A tap that is off pulls what all share towards itself, the more the stronger it is: so the excess of each counts
    over the part that the others at its point have in the loads found there.
    """
    motion, whitener = motion_of(fit.common.matrices, fit.size), whitener_of(fit.noise)
    linked = [number for number, tap in enumerate(fit.taps) if tap.linked]
    strengths = {number: float(fit.taps[number].force.sum()) ** 2 for number in linked}
    worst, most = None, 0.0
    for number in linked:
        tap, linear = fit.taps[number], fit.linears[number]
        alone = replace(tap, linked=False)
        state = fit_state(motion, tap.time[tap.before :], tap.values[tap.before :])[0]
        free = linears_of([alone], fit.points, fit.common, [state], fit.off, whitener=whitener)[0]
        k = alone.own
        left = free.squares - float(np.sum(free.block[:k, -1] ** 2))
        before = float(np.sum((linear.before @ whitener.T) ** 2))
        excess = linear.squares - before - left
        others = sum(strengths[other] for other in linked if other != number and fit.taps[other].point == tap.point)
        size = excess * (1 + strengths[number] / others) if others else excess
        # the ringing has as many sizes as states; that of the whole blow and the errors of the force are in `squares`
        if size > most and chdtrc(2 * motion.size, excess) < BY_CHANCE:
            worst, most = number, size
    return worst
