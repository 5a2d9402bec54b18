"""Taps on balances whose dynamics are known."""

import warnings
from dataclasses import replace

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.identify import identify
from aerobalance.identification.impact.tap_point import TapPoint
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from aerobalance.simulation.hammer import Blow, Hammer, Tapping
from aerobalance.simulation.six_balance import CoupledBalance

MASS, FREQUENCY, RATIO = 177.87, 66.4, 0.01
STIFFNESS = MASS * (2 * np.pi * FREQUENCY) ** 2
DAMPING = 2 * RATIO * MASS * 2 * np.pi * FREQUENCY
ONE = CoupledDynamics.of_components([Dynamics("AF", MASS, STIFFNESS, DAMPING)])
"""T-128 of [Gorbushin2020]_, damped by a percent."""

POINTS = (
    TapPoint((-0.25, 0.0, 0.02), (0.0, 0.0, -1.0)),
    TapPoint((0.1, 0.0, 0.03), (0.0, 0.0, -1.0)),
    TapPoint((-0.25, 0.04, 0.0), (0.0, -1.0, 0.0)),
    TapPoint((0.1, 0.04, 0.0), (0.0, -1.0, 0.0)),
    TapPoint((0.0, 0.06, 0.0), (0.0, 0.0, -1.0)),
    TapPoint((-0.3, 0.0, 0.0), (1.0, 0.0, 0.0)),
)
"""Points of a model of the size of `random_balance`'s, as stated."""


def one_tapped(rng: np.random.Generator, *, blows: int = 4, **settings) -> Recording:
    """AF of T-128 with 2 N of noise, tapped by 1500 to 3000 N for 4 ms, at 5 kHz, a tap every 1.5 s."""
    made = tuple(
        Blow(0.3 + 1.5 * number + rng.uniform(0, 0.1), rng.uniform(1500, 3000), 0.004) for number in range(blows)
    )
    extra = settings.pop("extra", lambda made: ())
    given = {
        "dynamics": ONE,
        "loads": np.array([1.0]),
        "blows": (*made, *extra(made)),
        "hammer": Hammer(noise=1.0),
        "noise": np.array([2.0]),
        "rest": np.array([50.0]),
        "rate": 5000.0,
    } | settings
    return Tapping(**given).record(1.5 * blows + 0.3, rng)


def quietly(recordings, **settings):
    """Identify from taps without a word."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return identify(recordings, excitation="impact", **settings)


def departures(found, truth: CoupledDynamics) -> tuple[np.ndarray, float]:
    """Errors of A and D over their uncertainties, shape (2 n^2,), and their chi-square a degree of freedom."""
    own = found.dynamics
    error = np.concatenate([(own.inertia - truth.inertia).ravel(), (own.damping - truth.damping).ravel()])
    u = np.sqrt(np.diag(own.covariance))
    return error / u, float(error @ np.linalg.solve(own.covariance, error)) / error.size


def really(point: TapPoint, rng: np.random.Generator) -> TapPoint:
    """Where a tap that is stated to be at a point is given: off by what the point's uncertainties allow."""
    way = np.array(point.direction) + point.u_direction * rng.standard_normal(3)
    place = np.array(point.place) + point.u_place * rng.standard_normal(3)
    return TapPoint(tuple(place), tuple(way / np.linalg.norm(way)))


def six_tapped(
    balance: CoupledBalance,
    rng: np.random.Generator,
    *,
    taps: int = 2,
    seconds: float = 0.4,
    given: dict[int, TapPoint] | None = None,
    hammer: Hammer | None = None,
) -> list[Recording]:
    """Loads of a balance tapped at `POINTS`, at 10 kHz, by a hammer of 1 % and 0.3 N; half of half range is felt."""
    hammer = hammer or Hammer(noise=0.3, gain=1 + 0.01 * rng.standard_normal())
    found = []
    for number, stated in enumerate(POINTS):
        point = really((given or {}).get(number, stated), rng)
        one = Tapping(
            balance.dynamics,
            point.loads,
            (Blow(0.1, 1.0, 0.0015),),
            hammer=hammer,
            noise=balance.noise * balance.half_range,
            rate=10_000.0,
        )
        peak = 0.5 / float(np.max(np.abs(one.felt(2000)) / balance.half_range))
        blows = tuple(Blow(0.1 + seconds * k, peak * rng.uniform(0.7, 1.0), 0.0015) for k in range(taps))
        found.append(replace(one, blows=blows).record(seconds * taps + 0.1, rng, name=f"point {number + 1}"))
    return found


def ranges(balance: CoupledBalance) -> dict[str, float]:
    """Half range of a balance by component."""
    return dict(zip(COMPONENTS, balance.half_range, strict=True))
