"""Whether sensors that see the same motion of the ground end agree, and which one does not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.motion.least_squares import GroundFit
from aerobalance.motion.sensors import Kind
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import warn_quality


@dataclass(frozen=True, slots=True)
class ConsistencySettings:
    """Thresholds of the comparison of sensors with each other.

    Attributes
    ----------
    sure
        Standard deviations from which a difference is no chance: once in 1e9 for white noise.
    gain_doubted
        Error of a gain that is worth a warning [1].
    spread_doubted
        Variance of what sensors disagree by, over what their noise explains, that is worth a warning.
    alike
        Correlation of what noise leaves of two sensors, from which it cannot be told which of them is wrong.
    blocks
        Parts of the record from whose means the spread of a mean is judged.
    """

    sure: float = 6.0
    gain_doubted: float = 0.02
    spread_doubted: float = 1.5
    alike: float = 0.98
    blocks: int = 16


SETTINGS: Final = ConsistencySettings()
"""Thresholds that are used."""

_UNITS: Final[dict[Kind, str]] = {"acceleration": "m/s^2", "turn": "rad/s^2", "rate": "rad/s^2 in its slope"}
"""Unit of what is compared of a sensor: a rate of turn is differentiated."""


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """A number that holds along the record and is not known exactly, and what it changes.

    Attributes
    ----------
    name, source
        What it is, and the channel that it belongs to.
    uncertainty
        Its standard uncertainty.
    columns
        Change of the readings with it by sensor, shape (n,) each.
    pull
        Change of the motion with it beside the sensors', shape (n, 6); None for none.
    """

    name: str
    source: str
    uncertainty: float
    columns: dict[int, Array]
    pull: Array | None = None

    def readings(self, like: Array) -> Array:
        """Change of all readings, shape (n, m)."""
        whole = np.zeros_like(like)
        for index, values in self.columns.items():
            whole[:, index] = values
        return whole


def check_agreement(name: str, fit: GroundFit, readings: Array, motion: Array, effects: list[Effect]) -> None:
    """Warn of a sensor that differs from what the others say by more than noise and stated uncertainties.

    Parameters
    ----------
    name
        The recording.
    fit
        How readings become motion.
    readings
        What is fitted, shape (n, m).
    motion
        The motion found, shape (n, 6).
    effects
        What is not known exactly.
    """
    noise = np.array([sensor.noise**2 for sensor in fit.sensors])
    covariance = fit.residual_covariance
    checked = np.diag(covariance) > 1e-9 * np.maximum(noise, 1e-300)
    if not checked.any():
        return
    # a rate is differentiated across the record's ends, where it is continued by guess
    margin = readings.shape[0] // 20 if any(sensor.kind == "rate" for sensor in fit.sensors) else 0
    inner = slice(margin, readings.shape[0] - margin)
    left = fit.residual(readings)[inner]
    allowed = np.zeros(checked.size)
    for effect in effects:
        change = fit.residual(effect.readings(readings))[inner]
        allowed += np.mean(change**2, axis=0) * effect.uncertainty**2
    found = _Faults(fit, left, motion[inner] @ fit.rows.T, covariance, allowed)
    for scores, words in (found.spread, found.gain, found.offset):
        worst = int(np.argmax(np.where(checked, scores, 0.0)))
        if checked[worst] and scores[worst] > 0:
            warn_quality(f"{name}: {found.sentence(worst, words[worst])}")
            return


@dataclass(frozen=True, slots=True, eq=False)
class _Faults:
    """Faults of every sensor: how far its residual is beyond noise, zero where that is no fault, with words for it.

    Of the residuals over their own noise that of the faulty sensor is the largest, if only one is faulty.
    """

    fit: GroundFit
    left: Array
    expected: Array
    covariance: Array
    allowed: Array

    @property
    def floor(self) -> Array:
        """Variance that noise gives each residual, and not nothing, shape (m,)."""
        return np.maximum(np.diag(self.covariance), 1e-300)

    @property
    def redundancy(self) -> Array:
        """Part of a sensor's own error that its residual shows, shape (m,)."""
        shown = np.zeros(self.floor.size)
        for index in range(shown.size):
            band = next((one for one in self.fit.bands if one.used[index]), None)
            if band is not None:
                shown[index] = 1 - float(self.fit.rows[index] @ band.gains[:, index])
        return np.maximum(shown, 1e-12)

    @property
    def spread(self) -> tuple[Array, list[str]]:
        """Mean square of the residual about its mean."""
        power = np.var(self.left, axis=0)
        limit = (
            SETTINGS.spread_doubted + SETTINGS.sure * np.sqrt(2 / self.left.shape[0])
        ) * self.floor + SETTINGS.sure**2 * self.allowed
        deviation = np.sqrt(power / self.floor)
        return np.where(power > limit, deviation, 0.0), [self._difference(index) for index in range(power.size)]

    @property
    def gain(self) -> tuple[Array, list[str]]:
        """Part of the residual that follows the motion; least squares make noise give none."""
        power = np.maximum(np.mean(self.expected**2, axis=0), 1e-300)
        slope = np.mean(self.left * self.expected, axis=0) / power
        chance = SETTINGS.sure * np.sqrt((self.floor / self.left.shape[0] + self.allowed) / power)
        gains = slope / self.redundancy
        doubtful = (np.abs(slope) > chance) & (np.abs(gains) > SETTINGS.gain_doubted)
        return np.where(doubtful, np.abs(slope) * np.sqrt(power / self.floor), 0.0), [_in_percent(g) for g in gains]

    @property
    def offset(self) -> tuple[Array, list[str]]:
        """Mean of the residual."""
        samples = self.left.shape[0]
        mean = self.left.mean(axis=0)
        blocks = np.array([part.mean(axis=0) for part in np.array_split(self.left, min(SETTINGS.blocks, samples))])
        scatter = np.maximum(self.floor / samples, np.var(blocks, axis=0) / SETTINGS.blocks)
        doubtful = np.abs(mean) > SETTINGS.sure * np.sqrt(scatter + self.allowed)
        units = [_UNITS[sensor.kind] for sensor in self.fit.sensors]
        words = [
            f"{abs(b):.3g} {unit} {'more' if b > 0 else 'less'}"
            for b, unit in zip(mean / self.redundancy, units, strict=True)
        ]
        scores = np.where(doubtful, np.abs(mean) / np.sqrt(self.floor), 0.0)
        return scores, [f"reads {by} than the others say, all along" for by in words]

    def _difference(self, index: int) -> str:
        """Words for what a sensor does: a wrong gain where that explains it, with what the others make it read."""
        own = self.left[:, index] / self.redundancy[index]
        others = self.expected[:, index] + self.left[:, index] - own
        power = float(np.mean(others**2))
        gain = float(np.mean(own * others)) / max(power, 1e-300)
        if np.var(own - gain * others) < 0.1 * np.var(own):
            return _in_percent(gain)
        size = float(np.sqrt(np.var(self.left[:, index]) / self.floor[index]))
        return f"differs from what the others say by {size:.3g} times what noise explains"

    def sentence(self, worst: int, words: str) -> str:
        """What is wrong, with whom, and what it does."""
        names = [sensor.channel.name for sensor in self.fit.sensors]
        likeness = np.abs(self.covariance[worst]) / np.sqrt(self.floor * self.floor[worst])
        alike = [names[index] for index in np.flatnonzero(likeness > SETTINGS.alike) if index != worst]
        if not alike:
            return (
                f"{names[worst]} {words}; the motion of the ground and the force are wrong by a part of that: check "
                "its gain, sign, place, axis and delay, or leave it out"
            )
        return (
            f"{', '.join([names[worst], *alike])} do not agree with each other, and there is no further sensor to say "
            f"which is wrong ({names[worst]} {words}, or another does); the motion of the ground and the force are "
            "wrong by a part of that"
        )


def _in_percent(gain: float) -> str:
    return f"reads {abs(gain):.1%} {'more' if gain > 0 else 'less'} than the others say"
