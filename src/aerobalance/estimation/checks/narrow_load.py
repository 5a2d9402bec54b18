"""What looks like a mode that has moved: a narrow band of one load, noise with a color, one load in several forces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Final

import numpy as np
from scipy.optimize import minimize

from aerobalance.estimation.checks.channel_rows import Rows
from aerobalance.estimation.checks.ringing import RingingSpectra
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True)
class NarrowLoadSettings:
    """Narrow bands of one load that are tried.

    Attributes
    ----------
    places
        Logarithms of its frequency over the mode's.
    sizes
        Its widths, and its densities over the flat one beside it.
    orders
        Orders by which it falls.
    tries, fine
        How often it is looked at closer, and the logarithm of frequency of a step of that.
    ends
        Ends of the logarithms of width and density.
    """

    places: tuple[float, ...] = tuple(0.01 * place for place in range(-9, 10))
    sizes: tuple[tuple[float, float], ...] = ((0.015, 30.0), (0.04, 10.0), (0.01, 300.0))
    orders: tuple[int, ...] = (1, 4)
    tries: int = 50
    fine: float = 0.01
    ends: tuple[float, float] = (-10.0, 20.0)


SETTINGS: Final = NarrowLoadSettings()
"""Settings that are used."""


def gain_over_loads(about: RingingSpectra, rows: Rows, frequency: float, *, least: float) -> float:
    """Gain in log-likelihood of rows whose mode has moved, over loads that look like one near a frequency [Hz].

    That are a narrow band of one load, noise with a color, and one load in several forces, as a gust or a release.
    From a gain over the first below `least` on the others are not asked.
    """
    loaded = _with_a_narrow_load(about, frequency)
    gain = float(np.sum(about.evidence_apart(rows) - loaded.evidence_apart(about.own)))
    if gain < least:
        return gain
    colored = about.evidence_with_color(rows) - loaded.evidence_with_color(about.own)
    together = about.evidence_together(rows) - about.evidence_together(about.own)
    return min(gain, float(np.sum(colored)), float(np.sum(together)))


def _with_a_narrow_load(about: RingingSpectra, frequency: float) -> RingingSpectra:
    """The same with a narrow band of one load near a frequency [Hz], where it is likeliest by place, width and size.

    It swings as a resonance does, or has edges: the density falls as a Butterworth filter's, of some order.
    """
    volume, away = about.determinant(about.own), np.log(about.frequency / frequency)

    def loaded(point: Array, component: int, order: int) -> RingingSpectra:
        shift, width, size = point[0], *np.exp(np.clip(point[1:], *SETTINGS.ends))
        gains = about.gain.copy()
        gains[component] *= 1 + size / (1 + np.minimum(np.abs(2 * (away - shift) / width), 1e6) ** (2 * order))
        return replace(about, gain=gains)

    def lost(point: Array, component: int, order: int) -> float:
        return -float(np.sum(loaded(point, component, order).evidence_apart(about.own, determinant=volume)))

    tried = [np.array([at, *np.log(load)]) for at in SETTINGS.places for load in SETTINGS.sizes]
    simplex = np.vstack([np.zeros(3), np.diag([SETTINGS.fine, 1.0, 1.0])])
    least, best = -float(np.sum(about.evidence_apart(about.own, determinant=volume))), about
    for component, order in product(range(len(about.noise)), SETTINGS.orders):
        losses = [lost(point, component, order) for point in tried]
        start = tried[int(np.argmin(losses))]
        found = minimize(
            partial(lost, component=component, order=order),
            start,
            method="Nelder-Mead",
            options={"maxfev": SETTINGS.tries, "initial_simplex": start + simplex},
        )
        if float(found.fun) < least:
            least, best = float(found.fun), loaded(found.x, component, order)
    return best
