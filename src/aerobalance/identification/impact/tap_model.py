"""Readings about a tap as a function of the matrices, of the force and of what is the tap's own, with derivatives.

With X the balance loads, A X'' + D X' + X = g h(t): g are the loads of 1 N at the point and in the direction of the
tap, h is the force of the hammer. Where h is sampled fast enough to show its whole spectrum, what it leaves after the
contact is exactly the sum of the responses to its samples, each as a blow of h times the sampling interval: so the
readings after the contact are sums of exponentials, as those of a release are, and nothing is windowed.

The readings of the force are noisy as well (errors in variables), so the force at every sample of the contact is an
unknown beside its reading. Before and after the contact the hammer touches nothing and the force is zero, whatever its
channel reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from aerobalance.identification.coupled.free_response import Complex, ExponentialSums, FreeMotion
from aerobalance.identification.coupled.least_squares import compressed, weighted
from aerobalance.recording.channel import Array

COMMON = 2
"""Unknowns that all taps share beside the matrices: gain of the force and its delay behind the loads."""


@dataclass(frozen=True, slots=True, eq=False)
class Tap:
    """One tap in the units of the fit; times count from the end of the contact.

    Attributes
    ----------
    name
        What it is called in messages.
    point
        Which of the points and directions it was given at, a number from 0.
    time
        Times of the rows, shape (m,), increasing.
    values
        Balance loads, shape (m, n).
    before
        Number of rows before the contact; those in the contact are left out.
    instants
        Times of the samples of the force in the contact, shape (c,), zero or less.
    force
        Readings of the force there, times the sampling interval, shape (c,).
    force_noise
        Standard uncertainty of one of them.
    sampling
        Standard uncertainty of the whole force, over it, from the part of its spectrum above half the rate [1].
    linked
        Whether the force is used; otherwise the ringing after the contact is taken as a free decay from any state.
    internal
        Number of coordinates that no channel shows.
    """

    name: str
    point: int
    time: Array
    values: Array
    before: int
    instants: Array
    force: Array
    force_noise: float
    sampling: float
    linked: bool = True
    internal: int = 0

    @property
    def own(self) -> int:
        """Number of unknowns of the tap's own: loads at rest, coordinates and rates, force by sample, its whole."""
        n = int(self.values.shape[1])
        return 3 * n + 2 * self.internal + ((self.force.size + 1) if self.linked else 0)


@dataclass(frozen=True, slots=True, eq=False)
class Common:
    """What all taps share.

    Attributes
    ----------
    matrices
        A^-1 and A^-1 D row by row, shape (2 N^2,).
    gain, delay
        Gain of the force less 1, and the time by which it lags the loads, both over their standard uncertainties.
    u_gain, u_delay
        These, [1] and the unit of time of the fit.
    """

    matrices: Array
    gain: float
    delay: float
    u_gain: float
    u_delay: float

    def moved(self, step: Array) -> Common:
        """The same after a step of gain, delay and matrices, shape (2 + 2 N^2,)."""
        return Common(
            self.matrices + step[COMMON:], self.gain + step[0], self.delay + step[1], self.u_gain, self.u_delay
        )


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """Loads of 1 N at a point and in a direction, and what is not known of them.

    Attributes
    ----------
    name
        What it is called in messages.
    loads
        Shape (n,), in the units of the fit per newton.
    root
        Root of their covariance, shape (n, r): loads + root @ unit normal.
    """

    name: str
    loads: Array
    root: Array


@dataclass(frozen=True, slots=True, eq=False)
class TapLinear:
    """A tap near one set of parameters.

    Attributes
    ----------
    squares
        Sum of the squared weighted residuals, those of the force and of what is known of it included.
    rows
        Number of rows of loads used.
    block
        Triangular factor of [own, point, gain, delay, matrices, residual].
    before, after
        Residuals before and after the contact, not weighted, shapes (a, n) and (b, n).
    """

    squares: float
    rows: int
    block: Array
    before: Array
    after: Array


def _blow(motion: FreeMotion, loads: Array, spring: Array) -> tuple[ExponentialSums, Complex]:
    """Response to a force of unit impulse with these loads, and the sizes of its modes."""
    n = motion.components
    sizes = motion.sizes(np.zeros(motion.size), spring[:, :n] @ loads)
    return motion.motion(sizes), sizes


def _spread(instants: Array, force: Array, motion: FreeMotion) -> tuple[Complex, Complex]:
    """What turns functions of the time since a blow into those of the time since the contact: sums by pole."""
    growth = np.exp(-motion.poles[:, None] * instants).astype(np.complex128)
    return growth @ force.astype(np.complex128), growth @ (-instants * force).astype(np.complex128)


def force_of(tap: Tap, own: Array) -> Array:
    """The most likely force, times the sampling interval, shape (c,)."""
    start = own.size - tap.force.size - 1
    return np.asarray((tap.force + tap.force_noise * own[start:-1]) * (1 + tap.sampling * own[-1]))


def after_contact(tap: Tap, motion: FreeMotion, common: Common, *, own: Array, point: Point, off: Array) -> Complex:
    """Return the size of every mode at the end of the contact, shape (2 N,); arguments as `linearise_tap` has them."""
    n, size = motion.components, motion.size
    sizes = motion.sizes(own[n : n + size], own[n + size : n + 2 * size])
    if not tap.linked:
        return sizes
    begun = float(tap.time[0]) if tap.before else float(tap.instants[0])
    spring = common.matrices[: size**2].reshape(size, size)
    loads = (1 + common.gain * common.u_gain) * (point.loads + point.root @ off)
    _, blown = _blow(motion, loads, spring)
    spread = _spread(tap.instants - common.delay * common.u_delay, force_of(tap, own), motion)[0]
    return np.asarray(sizes * np.exp(-motion.poles * begun) + blown * spread)


def linearise_tap(
    tap: Tap,
    motion: FreeMotion,
    common: Common,
    *,
    own: Array,
    point: Point,
    off: Array,
    whitener: Array,
) -> TapLinear:
    """Residuals of the readings about a tap, and their triangular factor.

    Parameters
    ----------
    tap
        The tap.
    motion, common
        Free motion of the trial matrices, and these with gain and delay of the force.
    own
        The tap's own unknowns: loads at rest; coordinates and rates at the first row (after the contact where it is
        not linked); for a linked tap the errors of the force by sample over their noise, and that of the whole.
    point, off
        Where and how it was given, and how far off that is in units of its root, shape (r,).
    whitener
        What turns the noise of one row into independent unit noise, shape (n, n).
    """
    n = motion.components
    rest, state = own[:n], own[n : n + 2 * motion.size]
    sizes = motion.sizes(state[: motion.size], state[motion.size :])
    free = motion.motion(sizes)
    by_free = ExponentialSums.joined([motion.by_state(), motion.by_matrices(sizes)])
    if not tap.linked:
        return _free_tap(tap, motion, free, by_free, rest, point=point, whitener=whitener)
    begun = float(tap.time[0]) if tap.before else float(tap.instants[0])
    fallen = np.exp(-motion.poles * begun).astype(np.complex128)
    early = fallen, np.asarray(-begun * fallen, dtype=np.complex128)
    force = force_of(tap, own)
    instants = tap.instants - common.delay * common.u_delay
    spread = _spread(instants, force, motion)
    spring = common.matrices[: motion.size**2].reshape(motion.size, motion.size)
    gain = 1 + common.gain * common.u_gain
    loads = gain * (point.loads + point.root @ off)
    blow, blown = _blow(motion, loads, spring)
    parts = (slice(0, tap.before), slice(tap.before, None))
    models = (free, free.weighted(*early) + blow.weighted(*spread))
    starts = (begun, 0.0)
    slopes = (
        _filled(by_free, 2 * motion.size, tap.force.size + 1 + point.root.shape[1] + COMMON),
        _after_slopes(
            by_free.weighted(*early),
            blow,
            blown,
            motion=motion,
            tap=tap,
            instants=instants,
            force=force,
            spread=spread,
            point=point,
            common=common,
            loads=loads,
            spring=spring,
            whole=1 + tap.sampling * float(own[-1]),
        ),
    )
    left, rows = [], []
    for part, model, start, slope in zip(parts, models, starts, slopes, strict=True):
        residual, row = _rows(tap, part, motion, model, slope, start=start, rest=rest, whitener=whitener)
        left.append(residual)
        rows.append(row)
    errors = own[n + 2 * motion.size :]
    squares = sum(float(np.sum((part @ whitener.T) ** 2)) for part in left) + float(errors @ errors)
    known = np.zeros((errors.size, rows[0].shape[1]))
    known[:, n + 2 * motion.size : own.size] = np.eye(errors.size)
    known[:, -1] = -errors
    block = _triangle([*rows, known])
    return TapLinear(squares, left[0].shape[0] + left[1].shape[0], block, left[0], left[1])


def _free_tap(
    tap: Tap,
    motion: FreeMotion,
    free: ExponentialSums,
    by_free: ExponentialSums,
    rest: Array,
    *,
    point: Point,
    whitener: Array,
) -> TapLinear:
    """A tap of which only the ringing after the contact is used."""
    slope = _filled(by_free, 2 * motion.size, point.root.shape[1] + COMMON)
    part = slice(tap.before, None)
    left, rows = _rows(tap, part, motion, free, slope, start=0.0, rest=rest, whitener=whitener)
    squares = float(np.sum((left @ whitener.T) ** 2))
    return TapLinear(squares, left.shape[0], _triangle([rows]), np.zeros((0, rest.size)), left)


def _rows(
    tap: Tap,
    part: slice,
    motion: FreeMotion,
    model: ExponentialSums,
    slopes: ExponentialSums,
    *,
    start: float,
    rest: Array,
    whitener: Array,
) -> tuple[Array, Array]:
    """Residuals of some rows, and what they say of all unknowns: weighted rows of [own, point, common, residual]."""
    n = rest.size
    values = tap.values[part]
    columns = motion.columns(tap.time[part] - start)
    on = motion.on_columns(model)[:, :, 0]
    on[-1] += rest
    left = values - columns @ on
    factor, along = compressed(columns, left)
    table = motion.on_columns(slopes)
    resting = np.zeros((table.shape[0], n, n))
    resting[-1] = np.eye(n)
    moved = np.tensordot(factor, np.concatenate([resting, table], axis=2), axes=1)
    return left, weighted(whitener, np.concatenate([moved, along[:, :, None]], axis=2))


def _after_slopes(
    free: ExponentialSums,
    blow: ExponentialSums,
    blown: Complex,
    *,
    motion: FreeMotion,
    tap: Tap,
    instants: Array,
    force: Array,
    spread: tuple[Complex, Complex],
    point: Point,
    common: Common,
    loads: Array,
    spring: Array,
    whole: float,
) -> ExponentialSums:
    """Derivatives of the readings after the contact by state, force, point, gain, delay and matrices."""
    n, size = motion.components, motion.size
    state = free.picked(slice(2 * size))
    felt = blow.weighted(*spread)
    growth = np.exp(-motion.poles[:, None] * instants) * (tap.force_noise * whole)
    by_force = ExponentialSums(
        blow.plain[:, :, 0][:, :, None] * growth[:, None, :],
        np.zeros((2 * size, n, instants.size), dtype=np.complex128),
        np.zeros((n, instants.size)),
    )
    by_whole = felt.scaled(tap.sampling / whole)
    by_rates = motion.by_state().picked(slice(size, 2 * size)).weighted(*spread)
    gain = 1 + common.gain * common.u_gain
    by_point = by_rates.combined(gain * spring[:, :n] @ point.root)
    by_gain = felt.scaled(common.u_gain / gain)
    by_delay = motion.by_time(blow).weighted(*spread).scaled(-common.u_delay)
    by_matrices = motion.by_matrices(blown).weighted(*spread)
    direct = np.zeros((size, 2, size, size))  # X'' by the drive: spring times the loads
    for row in range(size):
        direct[row, 0, row, :n] = loads
    driven = by_rates.combined(direct.reshape(size, -1))
    matrices = free.picked(slice(2 * size, None)) + by_matrices + driven
    return ExponentialSums.joined([state, by_force, by_whole, by_point, by_gain, by_delay, matrices])


def _filled(functions: ExponentialSums, place: int, count: int) -> ExponentialSums:
    """Functions with some that are zero at a place among them."""
    poles, n, _ = functions.plain.shape
    nothing = np.zeros((poles, n, count), dtype=np.complex128)
    zero = ExponentialSums(nothing, nothing, np.zeros((n, count)))
    return ExponentialSums.joined([functions.picked(slice(place)), zero, functions.picked(slice(place, None))])


def _triangle(rows: list[Array]) -> Array:
    table = np.vstack(rows)
    if table.shape[0] < table.shape[1]:
        table = np.vstack([table, np.zeros((table.shape[1] - table.shape[0], table.shape[1]))])
    return np.array(qr(table, mode="r", check_finite=False)[0][: table.shape[1]], dtype=np.float64)
