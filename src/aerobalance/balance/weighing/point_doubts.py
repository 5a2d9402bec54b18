"""What the points of a weighing say against it: one that does not go with the others, and loads that lag."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from aerobalance.balance.weighing.adjustment import ROUNDING, Adjustment, Readings, adjust
from aerobalance.balance.weighing.model import WeightModel
from aerobalance.recording.channel import Array
from aerobalance.recording.components import AXES, FORCE_AXES, si_unit
from aerobalance.recording.doubts import Doubt

CHANCE: Final = 1e-3
"""Probability with which sound points are doubted, each way."""

TINY: Final = 1e-6
"""Least scatter over the deviation of the residuals: less is rounding."""

FEWEST: Final = 2.0
"""Degrees of freedom that must be left beside what is tested."""

STILL: Final = 1e-3
"""Change of a force's share of gravity below which it stays as it was [g]."""

EACH_WAY: Final = 3
"""Points that must have been reached from either side to tell that loads lag."""


def doubts_of_points(model: WeightModel, readings: Readings, found: Adjustment) -> tuple[Doubt, ...]:
    """Return what is doubted of each component's points, with what it does to the mass [kg].

    Points are in the order in which they were read.
    """
    sigma = np.maximum(np.maximum(found.deviations, ROUNDING * readings.load_scales(model)), readings.size)
    sigma = np.broadcast_to(sigma, readings.loads.shape)
    rows = (model.jacobian(readings.directions, found.values)[:, :, found.kept] / sigma[:, :, None]).reshape(
        sigma.size, -1
    )
    norms = np.linalg.norm(rows, axis=0)
    inverse = np.linalg.pinv(rows / norms) / norms[:, None]
    left = (found.residuals / sigma).ravel()
    doubts = []
    count = len(model.components)
    for column, name in enumerate(model.components):
        mass = model.mass_of(name)
        place = model.names.index(mass)
        mine = np.arange(column, left.size, count)
        # nothing falls below what is known of the readings
        known = float(np.sqrt(np.mean((readings.size[:, column] / sigma[:, column]) ** 2)))
        fit = _Fit(rows, inverse, left, mine, float(found.freedom[column]) - 1, known)
        if fit.freedom < FEWEST:
            continue
        tests = [_Column(fit, _unit(left.size, int(at))) for at in mine]
        chances = [one.chance for one in tests]
        worst = int(np.argmin(chances))
        if chances[worst] < CHANCE / (mine.size * count):
            moved = found.values[place] - _mass(model, _without(readings, worst), found, place)
            doubts.append(_outlier(name, worst, tests[worst], moved, mass=mass, size=float(sigma[worst, column])))
            continue
        ways = _ways(readings, name)
        if min(np.count_nonzero(ways > 0), np.count_nonzero(ways < 0)) < EACH_WAY:
            continue
        shape = np.zeros(left.size)
        shape[mine] = ways / sigma[:, column]
        lag = _Column(fit, shape)
        if lag.chance < CHANCE / count:
            loads = readings.loads.copy()
            loads[:, column] -= lag.size * ways
            moved = found.values[place] - _mass(model, replace(readings, loads=loads), found, place)
            doubts.append(_hysteresis(name, lag, moved, mass=mass))
    return tuple(doubts)


@dataclass(frozen=True, slots=True)
class _Fit:
    """A fit with all readings in one row: slopes and their inverse, residuals, places and freedom of one component."""

    rows: Array
    inverse: Array
    left: Array
    mine: NDArray[np.intp]
    freedom: float
    known: float


class _Column:
    """One further term of a fit, of one component: its size, and how likely chance makes it."""

    def __init__(self, fit: _Fit, shape: Array) -> None:
        absorbed = fit.inverse @ shape
        own = shape - fit.rows @ absorbed
        square = float(own @ own)
        self.size, self.chance = 0.0, 1.0
        if square < 1e-9 * float(shape @ shape):
            return
        self.size = float(own @ fit.left) / square
        rest = (fit.left - self.size * own)[fit.mine]
        scatter = max(float(np.sqrt(rest @ rest / fit.freedom)), fit.known, TINY)
        self.chance = float(2 * stdtr(fit.freedom, -abs(self.size) * np.sqrt(square) / scatter))


def _without(readings: Readings, number: int) -> Readings:
    """The same without one point."""
    kept = np.arange(readings.loads.shape[0]) != number
    shared = None if readings.shared is None else readings.shared[kept][:, :, kept]
    return replace(
        readings,
        directions=readings.directions[kept],
        loads=readings.loads[kept],
        noise=readings.noise[kept],
        shared=shared,
    )


def _mass(model: WeightModel, readings: Readings, found: Adjustment, place: int) -> float:
    """Mass of other readings [kg], with what was left out held as before."""
    return float(adjust(model, readings, assumed=np.where(_fitted(found), 0.0, found.values)).values[place])


def _fitted(found: Adjustment) -> NDArray[np.bool_]:
    fitted = np.zeros(found.values.size, dtype=bool)
    fitted[found.kept] = True
    return fitted


def _unit(size: int, place: int) -> Array:
    shape = np.zeros(size)
    shape[place] = 1.0
    return shape


def _ways(readings: Readings, name: str) -> Array:
    """Whether each point was reached with a rising (1) or falling (-1) share of gravity, shape (n,); 0 of the first.

    Of a moment it is that of the force whose share changes most.
    """
    place = AXES.index(FORCE_AXES[name]) if name in FORCE_AXES else int(np.argmax(np.std(readings.directions, axis=0)))
    change = np.diff(readings.directions[:, place], prepend=readings.directions[0, place])
    ways = np.zeros(change.size)
    for number in range(1, change.size):
        ways[number] = np.sign(change[number]) if abs(change[number]) > STILL else ways[number - 1]
    return ways


def _words(mass: str) -> str:
    return mass.replace(".", " of ")


def _outlier(name: str, number: int, found: _Column, moved: float, *, mass: str, size: float) -> Doubt:
    unit = si_unit(name)
    text = (
        f"point {number + 1} does not go with the others in {name}: it is {found.size * size:+.3g} {unit} off what "
        f"they expect (chance makes as much once in {1 / max(found.chance, 1e-12):.1g} points); it moves the "
        f"{_words(mass)} by {moved:+.2g} kg and widens its uncertainty"
    )
    return Doubt("outlying point", name, text, "repeat the point, or leave it out", abs(moved), "kg")


def _hysteresis(name: str, found: _Column, moved: float, *, mass: str) -> Doubt:
    unit = si_unit(name)
    text = (
        f"{name} depends on the way the points were reached: {2 * abs(found.size):.3g} {unit} between a rising and a "
        "falling share of the weight, as hysteresis, friction or a cable that pulls make it; it moves the "
        f"{_words(mass)} by {moved:+.2g} kg and widens its uncertainty"
    )
    advice = "read every attitude from both sides, and look for what rubs or pulls"
    return Doubt("hysteresis", name, text, advice, abs(moved), "kg")
