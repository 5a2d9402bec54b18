"""The rate of turn of the ground end, and w x (w x r) in the readings of accelerometers away from its centre.

A rate that is not recorded is integrated from the angular acceleration, less the straight line that the sensors' zeros
make of it. What is read of w x (w x r) then depends on the motion found, and the motion on it: a few rounds settle
both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.motion.least_squares import GroundFit, integral
from aerobalance.recording.channel import Array
from aerobalance.recording.components import DIRECTIONS, MOMENT_ROWS, MOMENTS
from aerobalance.recording.fourier import convolve, hann
from aerobalance.recording.linalg import sums_of_products


@dataclass(frozen=True, slots=True)
class TurningSettings:
    """Thresholds of the rate of turn that is integrated.

    Attributes
    ----------
    rounds
        Times that rate of turn and acceleration are worked out from each other; each adds an order of w^2 r.
    settled
        Part of w x (w x r) by which the last of these times may still change it.
    integrated
        Standard uncertainty of w x (w x r) where w is integrated, relative [1]: its line holds motion.
    walk
        Rms of the integral of white noise less its line, over noise sqrt(n) / rate: 1 / sqrt(15).
    walk_of_angle
        The same of the second integral, over noise n^1.5 / rate^2, where either is less its line.
    walk_of_swings, walk_of_swung_angle
        The same of both integrals less their mean under a Hann window of n samples,
        sqrt(2 integral (1 - W)^2 (2 pi x)^-2k dx), k = 1 and 2, W = sinc(x) / (1 - x^2).
    shortest
        Samples of the shortest such window.
    mostly_noise
        Share of the integral's rms from which such a walk makes it worthless.
    little_noise
        The same of an angle that counts as one: along a whole record few slow swings make the walk, which is twice as
        large by chance in one of 50, three times in one of 2500 and four times in fewer than one of 20 000.
    """

    rounds: int = 5
    settled: float = 0.03
    integrated: float = 0.1
    walk: float = 0.26
    walk_of_angle: float = 0.03
    walk_of_swings: float = 0.213
    walk_of_swung_angle: float = 0.0263
    shortest: int = 16
    mostly_noise: float = 0.5
    little_noise: float = 0.25


SETTINGS: Final = TurningSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """The rate of turn and what goes with it.

    Attributes
    ----------
    motion
        The six motions, w x (w x r) taken off, shape (n, 6) [m/s^2, rad/s^2].
    rate
        Rate of turn in the signs of PM, YM and RM, shape (n, 3) [rad/s].
    felt
        What the sensors read of w x (w x r) by this rate, shape (n, m) [m/s^2].
    removed
        Whether it has been taken off.
    uncertainty
        Its standard uncertainty, relative [1].
    assumptions
        Rates that are left out, and the like.
    """

    motion: Array
    rate: Array
    felt: Array
    removed: bool
    uncertainty: float
    assumptions: tuple[str, ...]

    @classmethod
    def of(cls, fit: GroundFit, readings: Array, known: Array) -> Turning:
        """Work out the motion and its rate of turn.

        Parameters
        ----------
        fit
            How readings become motion.
        readings
            Kinematic readings, shape (n, m).
        known
            Motions that are known beforehand, shape (n, 6).
        """
        start = motion = fit.motion(readings - known @ fit.rows.T) + known if fit.sensors else known
        felt, rate = np.zeros_like(readings), np.broadcast_to(0.0, (known.shape[0], 3))
        if not start[:, MOMENT_ROWS].any():
            return cls(start, rate, felt, True, 0.0, ())
        readings = readings - known @ fit.rows.T
        walk = SETTINGS.walk * np.sqrt(np.diag(fit.covariance)[list(MOMENT_ROWS)] * known.shape[0]) / fit.rate
        settled, noise = False, np.zeros(3)
        for _ in range(SETTINGS.rounds):
            rate, noise = _rate(fit, motion, walk)
            before, felt = felt, centripetal(fit, rate)
            motion = fit.motion(readings - felt) + known
            settled = bool((_rms(felt - before) <= SETTINGS.settled * _rms(felt)).all())
        if not settled:
            said = (
                f"w x (w x r), up to {float(np.abs(felt).max()):.3g} m/s^2 in the accelerometers, is left in their "
                "readings: their places tell turns too badly to work it out"
            )
            return cls(start, np.zeros_like(rate), felt, False, 1.0, (said,))
        lost = ", ".join(name for name, part in zip(MOMENTS, noise, strict=True) if part > SETTINGS.mostly_noise)
        told = (f"the rate of turn of {lost} is lost in the noise of its integral and taken as zero",) if lost else ()
        share = float(np.max(np.where(noise > SETTINGS.mostly_noise, 0.0, noise)))
        integrated = not set(np.flatnonzero(rate.any(axis=0))) <= _recorded(fit)
        return cls(
            motion, rate, felt, True, float(np.hypot(SETTINGS.integrated, 2 * share)) if integrated else 0.0, told
        )


def turned_by(fit: GroundFit, rate: Array) -> Array:
    """Angles that a rate of turn (n, 3) adds up to, shape (n, 3) [rad]; 0 where these are noise.

    They are less their lines. Along a record the sum of noise comes to be larger than they are: then they are less
    their mean over as long a time as leaves little of it, and faster swings are what is left.
    """
    count, recorded = len(rate), _recorded(fit)
    angles = np.zeros_like(rate)
    for place, turn in enumerate(MOMENT_ROWS):
        if not rate[:, place].any():
            continue
        angle = _integrated(rate[:, place], fit.rate)
        if place in recorded:
            noise = min(s.noise for s in fit.sensors if s.kind == "rate" and np.argmax(np.abs(s.row)) == turn)
            whole, swung, power, by = SETTINGS.walk, SETTINGS.walk_of_swings, 0.5, noise / fit.rate
        else:
            noise = float(np.sqrt(max(fit.covariance[turn, turn], 0.0)))
            whole, swung, power = SETTINGS.walk_of_angle, SETTINGS.walk_of_swung_angle, 1.5
            by = noise / fit.rate**2
        window, found, walk = count, angle, whole * by * count**power
        while walk > SETTINGS.little_noise * float(_rms(found)) and window >= 2 * SETTINGS.shortest:
            window //= 2
            found, walk = _swings(angle, window), swung * by * window**power
        if walk <= SETTINGS.little_noise * float(_rms(found)):
            angles[:, place] = found
    return angles


def _swings(values: Array, window: int) -> Array:
    """A series less its mean under a Hann window of so many samples, shape (n,); beyond its ends it goes on odd."""
    half = window // 2
    before = 2 * values[0] - values[half:0:-1]
    after = 2 * values[-1] - values[-2 : -2 - half : -1]
    weights = hann(2 * half + 2)[1:]
    slow = convolve(np.concatenate([before, values, after])[:, None], (weights / weights.sum())[:, None])[:, 0]
    return np.asarray(values - slow[2 * half : 2 * half + values.size])


def _recorded(fit: GroundFit) -> set[int]:
    return {MOMENT_ROWS.index(int(np.argmax(sensor.row))) for sensor in fit.sensors if sensor.kind == "rate"}


def _rate(fit: GroundFit, motion: Array, walk: Array) -> tuple[Array, Array]:
    """Rate of turn, shape (n, 3), as read or else integrated, and the share of noise in what is integrated."""
    found, noise = np.zeros((motion.shape[0], 3)), np.zeros(3)
    for place, turn in enumerate(MOMENT_ROWS):
        read = [s for s, row in zip(fit.sensors, fit.rows, strict=True) if s.kind == "rate" and row[turn]]
        if read:
            weights = np.array([1 / max(sensor.noise, 1e-12) ** 2 for sensor in read])
            found[:, place] = np.average([sensor.values for sensor in read], axis=0, weights=weights)
        elif motion[:, turn].any():
            rate = _integrated(motion[:, turn], fit.rate)
            noise[place] = walk[place] / max(float(_rms(rate)), 1e-300)
            found[:, place] = rate if noise[place] <= SETTINGS.mostly_noise else 0.0
    return found, noise


def _integrated(values: Array, rate: float) -> Array:
    """Integral less its straight line, fitted under a Hann window, which keeps slow swings out of it, shape (n,)."""
    whole = integral(values, rate=rate)
    place = np.linspace(-1, 1, values.size)
    weight = hann(values.size + 1)[1:]
    # the window is symmetric and the place is not: mean and slope are apart
    mean, slope = weight @ whole / weight.sum(), weight * place @ whole / (weight @ place**2)
    return np.asarray(whole - mean - slope * place)


def centripetal(fit: GroundFit, rate: Array) -> Array:
    """What the sensors read of w x (w x r), shape (n, m) [m/s^2]."""
    w = rate @ DIRECTIONS[list(MOMENT_ROWS)]
    square = w[:, 0] ** 2 + w[:, 1] ** 2 + w[:, 2] ** 2
    return np.column_stack([(w @ s.place) * (w @ s.axis) - square * float(s.place @ s.axis) for s in fit.sensors])


def _rms(values: Array) -> Array:
    """Rms of a series (n,), or of each column of a table (n, m): by a product, which does not go along short rows."""
    squares = sums_of_products(values, values)
    return np.asarray(np.sqrt((np.diag(squares) if values.ndim > 1 else squares) / len(values)))
