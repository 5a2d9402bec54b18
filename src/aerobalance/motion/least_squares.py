"""Six motions of the ground end from its sensors, by least squares weighted with their noise.

A rate of turn says much of slow turns and, differentiated, little of fast ones, as its noise grows with frequency;
accelerometers apart from each other say the reverse. So every rate is used up to the frequency where the
accelerometers know better, or, where they do not see its turn, up to where it stands out of its noise: the record is
split there into bands that add to the whole, and every band has a least-squares fit of its own. Without rates there is
one band.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import welch

from aerobalance.motion.sensors import GroundSensor, least_squares, observable_motions
from aerobalance.recording.channel import Array
from aerobalance.recording.sensors import filtered

STEEPNESS: Final = 16
"""Power of the frequency with which one band gives way to the next."""

STANDS_OUT: Final = 4.0
"""Power over that of its noise from which a rate of turn shows a turn: 16 degrees of freedom pass it once in 1e8."""

WHOLE: Final = 0.8
"""Share of half the sampling rate from which a band is taken to reach to its end."""

QUARTER: Final = 4.0
"""Part of a period of the lowest edge, one over this, whose readings give the level at an end."""

SLOPE: Final = 6.0
"""Slope of a rate of turn over its standard uncertainty from which it is a turn that speeds up: chance once in 1e9."""

DENSE: Final = 4097
"""Frequencies over which the noise of a band is summed."""


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A least-squares fit and the frequencies that it is for.

    Attributes
    ----------
    low, high
        Where it begins and ends [Hz]; infinite for no end.
    columns
        The motions that its sensors tell apart.
    used
        Its sensors, shape (m,).
    gains
        Matrix from readings to motions, shape (6, m).
    """

    low: float
    high: float
    columns: tuple[int, ...]
    used: NDArray[np.bool_]
    gains: Array

    def share(self, frequency: Array) -> Array:
        """Share of the record at these frequencies [Hz] that the band takes."""
        return _below(frequency, self.high) - _below(frequency, self.low)

    def transfer(self, frequency: Array) -> NDArray[np.complex128]:
        """The same as a transfer function without phase."""
        return self.share(frequency).astype(np.complex128)

    def slope(self, frequency: Array) -> NDArray[np.complex128]:
        """Transfer function to the derivative of that."""
        return self.share(frequency) * _derivative(frequency)


def _derivative(frequency: Array) -> NDArray[np.complex128]:
    return np.asarray(2j * np.pi * frequency)


def _below(frequency: Array, edge: float) -> Array:
    if not np.isfinite(edge):
        return np.ones_like(frequency)
    if edge <= 0:
        return np.zeros_like(frequency)
    return 1 / (1 + (frequency / edge) ** STEEPNESS)


@dataclass(frozen=True, slots=True, eq=False)
class GroundFit:
    """How readings become the six motions.

    Attributes
    ----------
    sensors
        The m sensors.
    rows
        What they read of the six motions, shape (m, 6).
    reach
        Frequency up to which each is used, shape (m,) [Hz].
    rate
        Sampling rate [Hz].
    bands
        The fits; one without rates of turn.
    """

    sensors: tuple[GroundSensor, ...]
    rows: Array
    reach: Array
    rate: float
    bands: tuple[Band, ...]

    @classmethod
    def of(cls, sensors: tuple[GroundSensor, ...], *, rate: float) -> GroundFit:
        """Fit of all motions that the sensors tell apart."""
        rows = np.array([sensor.row for sensor in sensors]).reshape(len(sensors), 6)
        reach = _reach(sensors, rows, rate)
        return cls(sensors, rows, reach, rate, _bands(sensors, rows, reach, rate))

    def only(self, columns: Iterable[int]) -> GroundFit:
        """The same fit with no other motions than these looked for."""
        rows = np.zeros_like(self.rows)
        rows[:, list(columns)] = self.rows[:, list(columns)]
        return replace(self, bands=_bands(self.sensors, rows, self.reach, self.rate))

    @property
    def columns(self) -> tuple[int, ...]:
        """Motions that are fitted in some band."""
        return tuple(sorted({column for band in self.bands for column in band.columns}))

    def readings(self, samples: int) -> Array:
        """What the sensors read, rates differentiated, shape (samples, m) [m/s^2, rad/s^2]."""
        found = np.zeros((samples, len(self.sensors)))
        for index, sensor in enumerate(self.sensors):
            rate = sensor.kind == "rate"
            found[:, index] = filtered(sensor.values, _derivative, rate=self.rate) if rate else sensor.values
        return found

    def motion(self, readings: Array) -> Array:
        """The six motions behind readings of shape (n, m), shape (n, 6)."""
        found = [part @ band.gains.T for band, part in self._parts(readings)]
        return found[0] if len(found) == 1 else np.sum(found, axis=0)

    def residual(self, readings: Array) -> Array:
        """What the motions leave of readings, in the bands where each sensor is used, shape (n, m)."""
        left = np.zeros_like(readings)
        for band, part in self._parts(readings):
            left += np.where(band.used, part - part @ band.gains.T @ self.rows.T, 0.0)
        return left

    @property
    def covariance(self) -> Array:
        """Covariance of the noise of one sample of the six motions, shape (6, 6)."""
        return self.spread([band.gains for band in self.bands], variance=self._variance, turns=self._turns)

    @property
    def residual_covariance(self) -> Array:
        """Covariance that noise gives the residuals, shape (m, m)."""
        eye = np.eye(len(self.sensors))
        maps = [np.where(band.used[:, None], eye - self.rows @ band.gains, 0.0) for band in self.bands]
        return self.spread(maps, variance=self._variance, turns=self._turns)

    def spread(self, maps: list[Array], *, variance: Array, turns: NDArray[np.bool_] | None = None) -> Array:
        """Covariance that white noise in k sources gives through maps of the bands, shape (p, p).

        Parameters
        ----------
        maps
            What each band makes of the sources, shape (p, k) each.
        variance
            Of the noise of the sources, shape (k,).
        turns
            Sources that are differentiated, shape (k,).
        """
        frequency = np.linspace(0, self.rate / 2, DENSE)
        differentiated = np.zeros(variance.size, dtype=bool) if turns is None else turns
        total = np.zeros((maps[0].shape[0],) * 2)
        for one, left in zip(self.bands, maps, strict=True):
            for other, right in zip(self.bands, maps, strict=True):
                shared = one.share(frequency) * other.share(frequency)
                grown = float(np.mean(shared * (2 * np.pi * frequency) ** 2))
                size = variance * np.where(differentiated, grown, float(np.mean(shared)))
                total += (left * size) @ right.T
        return total

    @property
    def _variance(self) -> Array:
        return np.array([sensor.noise**2 for sensor in self.sensors])

    @property
    def _turns(self) -> NDArray[np.bool_]:
        return np.array([sensor.kind == "rate" for sensor in self.sensors], dtype=bool)

    def _parts(self, readings: Array) -> list[tuple[Band, Array]]:
        if len(self.bands) == 1 and np.isinf(self.bands[0].high):
            return [(self.bands[0], readings)]
        moving = np.flatnonzero(readings.any(axis=0))
        lowest = min(band.high for band in self.bands)
        level_over = min(round(self.rate / (QUARTER * lowest)), readings.shape[0] // 2)
        # what has been differentiated is so noisy that it has no level at an end; its integral has
        turns = self._turns & np.isfinite(self.reach)
        series = readings.copy()
        series[:, turns] = cumulative_trapezoid(readings[:, turns], axis=0, initial=0) / self.rate
        parts = []
        for band in self.bands:
            part = np.zeros_like(readings)
            for column in moving:
                gain = band.slope if turns[column] else band.transfer
                part[:, column] = filtered(series[:, column], gain, rate=self.rate, level_over=level_over)
            parts.append((band, part))
        return parts


def _weights(sensors: tuple[GroundSensor, ...]) -> Array:
    """Noise by which sensors are weighted, shape (m,): their own, and never nothing."""
    sizes = [float(np.sqrt(np.mean(sensor.values**2))) or 1.0 for sensor in sensors]
    return np.array([max(sensor.noise, 1e-9 * size) for sensor, size in zip(sensors, sizes, strict=True)])


def _bands(sensors: tuple[GroundSensor, ...], rows: Array, reach: Array, rate: float) -> tuple[Band, ...]:
    """Split the frequencies where a rate of turn is used no further, and fit every band."""
    edges = [0.0, *sorted({float(edge) for edge in reach if 0 < edge < np.inf}), np.inf]
    turns = np.array([sensor.kind == "rate" for sensor in sensors])
    frequency = np.linspace(0, rate / 2, DENSE)
    bands = []
    for low, high in pairwise(edges):
        band = Band(low, high, (), reach >= high, np.zeros((6, len(sensors))))
        share = band.share(frequency) ** 2
        grown = np.where(turns, np.mean(share * (2 * np.pi * frequency) ** 2), np.mean(share))
        noise = _weights(sensors) * np.sqrt(grown)
        columns = observable_motions(rows[band.used], noise[band.used])
        bands.append(Band(low, high, columns, band.used, least_squares(rows, noise, columns, band.used)))
    return tuple(bands)


def _reach(sensors: tuple[GroundSensor, ...], rows: Array, rate: float) -> Array:
    """Frequency up to which every sensor is used, shape (m,) [Hz]; zero where a rate shows no turn."""
    reach = np.full(len(sensors), np.inf)
    turns = np.array([sensor.kind == "rate" for sensor in sensors], dtype=bool)
    if not turns.any():
        return reach
    noise = _weights(sensors)
    columns = observable_motions(rows[~turns], noise[~turns])
    gains = least_squares(rows, noise, columns, ~turns)
    known = np.sqrt(np.diag((gains * noise**2) @ gains.T))
    for index in np.flatnonzero(turns):
        turn = int(np.flatnonzero(rows[index])[0])
        edge = known[turn] / (2 * np.pi * noise[index]) if turn in columns else _highest(sensors[index], rate)
        reach[index] = edge if edge < WHOLE * rate / 2 else np.inf
    return reach


def _highest(sensor: GroundSensor, rate: float) -> float:
    """Highest frequency at which a rate of turn stands out of its noise [Hz]."""
    values = sensor.values
    length = int(min(values.size, max(64, values.size // 8)))
    frequency, density = welch(values, rate, nperseg=length, detrend="linear")  # type: ignore[call-overload]
    out = np.flatnonzero(density[1:] > STANDS_OUT * sensor.noise**2 / (rate / 2))
    if out.size:
        return float(frequency[1:][out[-1]] * 1.2)
    # a rate that rises steadily has no line in a spectrum that is freed of slopes
    place = np.linspace(-1, 1, values.size)
    rise = abs(float(place @ values)) / float(np.sqrt(place @ place))
    return float(frequency[1]) if rise > SLOPE * sensor.noise > 0 else 0.0
