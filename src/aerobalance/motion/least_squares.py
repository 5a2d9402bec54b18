"""Six motions of the non-metric ("ground") end from its sensors, by least squares weighted with their noise.

A rate of turn, differentiated, gives the angular acceleration well where it is slow and badly where it is fast, as the
noise grows with the frequency; accelerometers some distance apart do the reverse. So each rate is used up to the
frequency where its noise is that of the accelerometers, or, where these do not measure its rotation, up to where it
stands out of its noise. There the record is split into frequency bands that add to the whole, and each band has a
least-squares fit of its own. Without rates of turn there is one band.

The six motions are in the order and signs of the components NF PM SF YM RM AF: acceleration of the balance's centre
for a force, angular acceleration for a moment [m/s^2, rad/s^2].
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.motion.sensors import GroundSensor, least_squares, observable_motions
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import averaged_spectrum
from aerobalance.recording.sensors import filtered


@dataclass(frozen=True, slots=True)
class MotionFitSettings:
    """Sizes and thresholds of the fit of the ground motion in bands.

    Attributes
    ----------
    steepness
        Power of the frequency with which the share of a band falls above its edge [1].
    stands_out
        Power over that of its noise from which a rate of turn shows rotation [1]: chance once in 1e8, of 16 degrees of
        freedom.
    whole
        Part of half the sampling rate from which on an edge is left out: the band then has no upper end [1].
    quarter
        Period of the lowest edge over the time whose readings give the level at either end of the record [1].
    slope
        Slope of a rate of turn over its standard uncertainty from which it is taken as real [1]: chance once in 1e9.
    dense
        Frequencies from 0 to half the sampling rate over which the noise of a band is averaged.
    """

    steepness: int = 16
    stands_out: float = 4.0
    whole: float = 0.8
    quarter: float = 4.0
    slope: float = 6.0
    dense: int = 4097


SETTINGS: Final = MotionFitSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionBand:
    """A frequency band, and the least-squares fit of the motions in it.

    Attributes
    ----------
    low, high
        Edges [Hz]; `high` is infinite for no upper end.
    columns
        Motions that its sensors tell apart, as places among the components.
    used
        Whether each sensor is used, shape (m,).
    gains
        Matrix from readings to motions, shape (6, m); zero for sensors not used and motions not told apart.
    """

    low: float
    high: float
    columns: tuple[int, ...]
    used: NDArray[np.bool_]
    gains: Array

    def share(self, frequency: Array) -> Array:
        """Share of the record that the band takes at frequencies [Hz], of their shape [1]; all bands add to 1."""
        return _below(frequency, self.high) - _below(frequency, self.low)

    def transfer(self, frequency: Array) -> NDArray[np.complex128]:
        """`share` as a transfer function without phase, of the shape of the frequencies [1]."""
        return self.share(frequency).astype(np.complex128)

    def derivative(self, frequency: Array) -> NDArray[np.complex128]:
        """Transfer function to the derivative of the part in the band, of the shape of the frequencies [rad/s]."""
        return self.share(frequency) * _derivative(frequency)


def _derivative(frequency: Array) -> NDArray[np.complex128]:
    """Transfer function of a derivative, i w, at frequencies [Hz], of their shape [rad/s]."""
    return np.asarray(2j * np.pi * frequency)


def _below(frequency: Array, edge: float) -> Array:
    """Share of all that is below an edge [Hz], at frequencies [Hz], of their shape [1]: 1/2 at the edge."""
    if not np.isfinite(edge):
        return np.ones_like(frequency)
    if edge <= 0:
        return np.zeros_like(frequency)
    return 1 / (1 + (frequency / edge) ** SETTINGS.steepness)


@dataclass(frozen=True, slots=True, eq=False)
class GroundFit:
    """The bands and their fits: how the readings of m sensors become the six motions.

    Attributes
    ----------
    sensors
        The m sensors.
    rows
        What they read of a unit of each of the six motions, shape (m, 6).
    reach
        Frequency up to which each is used, shape (m,) [Hz]; infinite for no limit, zero for not at all.
    rate
        Sampling rate [Hz].
    bands
        The bands, from low to high; one where there are no rates of turn.
    """

    sensors: tuple[GroundSensor, ...]
    rows: Array
    reach: Array
    rate: float
    bands: tuple[MotionBand, ...]

    @classmethod
    def of(cls, sensors: tuple[GroundSensor, ...], *, rate: float) -> GroundFit:
        """Return the fit of all motions that the sensors tell apart; `rate` is the sampling rate [Hz]."""
        rows = np.array([sensor.row for sensor in sensors]).reshape(len(sensors), 6)
        reach = _reach(sensors, rows, rate)
        return cls(sensors, rows, reach, rate, _bands(sensors, rows, reach, rate))

    def only(self, columns: Iterable[int]) -> GroundFit:
        """Return the fit of these motions only, places among the components; the others are taken as zero."""
        rows = np.zeros_like(self.rows)
        rows[:, list(columns)] = self.rows[:, list(columns)]
        return replace(self, bands=_bands(self.sensors, rows, self.reach, self.rate))

    @property
    def columns(self) -> tuple[int, ...]:
        """Motions that are fitted in some band, as places among the components, ascending."""
        return tuple(sorted({column for band in self.bands for column in band.columns}))

    def readings(self, samples: int) -> Array:
        """Readings of the sensors, rates of turn differentiated, shape (samples, m) [m/s^2, rad/s^2]."""
        found = np.zeros((samples, len(self.sensors)))
        for index, sensor in enumerate(self.sensors):
            if sensor.kind == "rate":
                found[:, index] = filtered(sensor.values, _derivative, rate=self.rate)
            else:
                found[:, index] = sensor.values
        return found

    def motion(self, readings: Array) -> Array:
        """The six motions, shape (n, 6) [m/s^2, rad/s^2], from `readings` of shape (n, m)."""
        if not self.sensors:
            return np.broadcast_to(0.0, (readings.shape[0], 6))
        found = [part @ band.gains.T for band, part in self._parts(readings)]
        return found[0] if len(found) == 1 else np.sum(found, axis=0)

    def residual(self, readings: Array) -> Array:
        """Readings less what the fitted motions make of them, in the bands where each sensor is used, shape (n, m)."""
        residual = np.zeros_like(readings)
        for band, part in self._parts(readings):
            residual += np.where(band.used, part - part @ band.gains.T @ self.rows.T, 0.0)
        return residual

    @property
    def covariance(self) -> Array:
        """Covariance of the noise of one sample of the six motions, shape (6, 6)."""
        maps = [band.gains for band in self.bands]
        return self.spread(maps, variance=self._variance, differentiated=self._is_rate)

    @property
    def white_covariance(self) -> Array:
        """Covariance of the noise of one sample of the six motions where it is taken for white, shape (6, 6).

        Noise of a rate that is differentiated grows with frequency up to where the rate is used: as strong a noise at
        all frequencies would be spread too thin. White noise has the density that the motion's has where its power is.
        """
        maps = [band.gains for band in self.bands]
        lines = self._lines(maps, variance=self._variance, differentiated=self._is_rate)
        density = np.diagonal(lines, axis1=1, axis2=2)
        power = np.mean(density, axis=0)
        spread = np.mean(density**2, axis=0) / np.where(power > 0, power, 1.0) ** 2
        scale = np.sqrt(np.where(power > 0, spread, 1.0))
        return np.asarray(np.mean(lines, axis=0) * np.outer(scale, scale))

    @property
    def residual_covariance(self) -> Array:
        """Covariance that noise gives the residuals of one sample, shape (m, m)."""
        eye = np.eye(len(self.sensors))
        maps = [np.where(band.used[:, None], eye - self.rows @ band.gains, 0.0) for band in self.bands]
        return self.spread(maps, variance=self._variance, differentiated=self._is_rate)

    def spread(self, maps: list[Array], *, variance: Array, differentiated: NDArray[np.bool_] | None = None) -> Array:
        """Covariance of one sample of p quantities that are linear in k sources of white noise, shape (p, p).

        Parameters
        ----------
        maps
            Matrix of each band from the sources to the quantities, shape (p, k) each.
        variance
            Variance of a sample of each source, shape (k,).
        differentiated
            Whether each source is differentiated, as rates of turn are, shape (k,); None for none.
        """
        if differentiated is None:
            differentiated = np.zeros(variance.size, dtype=bool)
        return np.asarray(np.mean(self._lines(maps, variance=variance, differentiated=differentiated), axis=0))

    def _lines(self, maps: list[Array], *, variance: Array, differentiated: NDArray[np.bool_]) -> Array:
        """The same of a white noise as strong as it is at each of some frequencies up to half the rate, (l, p, p)."""
        alike = len(self.bands) == 1 and np.isinf(self.bands[0].high) and not differentiated.any()  # all of them
        frequency = np.linspace(0, self.rate / 2, 1 if alike else SETTINGS.dense)
        grown = np.where(differentiated[:, None], (2 * np.pi * frequency) ** 2, 1.0) * variance[:, None]
        # neighbouring bands overlap, so that the noise of a source in them is correlated
        shares = [one[:, :, None] * band.share(frequency) for band, one in zip(self.bands, maps, strict=True)]
        through = np.sum(shares, axis=0)
        return np.asarray(np.einsum("isl,sl,jsl->lij", through, grown, through, optimize=True))

    @property
    def _variance(self) -> Array:
        """Variance of the noise of one reading of each sensor, rates not yet differentiated, shape (m,)."""
        return np.array([sensor.noise**2 for sensor in self.sensors])

    @property
    def _is_rate(self) -> NDArray[np.bool_]:
        """Whether each sensor measures a rate of turn, shape (m,)."""
        return _is_rate(self.sensors)

    def _parts(self, readings: Array) -> list[tuple[MotionBand, Array]]:
        """Each band with the part of the readings, shape (n, m), that is in it."""
        if len(self.bands) == 1 and np.isinf(self.bands[0].high):
            return [(self.bands[0], readings)]
        moving = np.flatnonzero(readings.any(axis=0))
        lowest = min(band.high for band in self.bands)
        level_over = min(round(self.rate / (SETTINGS.quarter * lowest)), readings.shape[0] // 2)
        # the filter needs a level at either end of the record: a differentiated rate is too noisy to have one, so that
        # it is integrated again, and differentiated together with the filtering
        integrated = self._is_rate & np.isfinite(self.reach)
        series = readings.copy()
        series[:, integrated] = integral(readings[:, integrated], rate=self.rate)
        parts = []
        for band in self.bands:
            part = np.zeros_like(readings)
            for column in moving:
                gain = band.derivative if integrated[column] else band.transfer
                part[:, column] = filtered(series[:, column], gain, rate=self.rate, level_over=level_over)
            parts.append((band, part))
        return parts


def integral(values: Array, *, rate: float) -> Array:
    """Integral over time by the trapezoidal rule, 0 at the first sample, of the values' shape (n, ...) [unit s].

    ``scipy.integrate`` has it too, and takes a tenth of a second to load.
    """
    whole = np.zeros_like(values)
    np.cumsum((values[1:] + values[:-1]) / (2 * rate), axis=0, out=whole[1:])
    return whole


def _is_rate(sensors: tuple[GroundSensor, ...]) -> NDArray[np.bool_]:
    """Whether each sensor measures a rate of turn, shape (m,)."""
    return np.array([sensor.kind == "rate" for sensor in sensors], dtype=bool)


def _noise_of(sensors: tuple[GroundSensor, ...]) -> Array:
    """Noise of each sensor, shape (m,) [m/s^2, rad/s^2, rad/s], at least 1e-9 of its rms: weights stay finite."""
    sizes = [float(np.sqrt(np.mean(sensor.values**2))) or 1.0 for sensor in sensors]
    return np.array([max(sensor.noise, 1e-9 * size) for sensor, size in zip(sensors, sizes, strict=True)])


def _bands(sensors: tuple[GroundSensor, ...], rows: Array, reach: Array, rate: float) -> tuple[MotionBand, ...]:
    """Bands between the frequencies up to which rates of turn are used, each with its fit."""
    edges = [0.0, *sorted({float(edge) for edge in reach if 0 < edge < np.inf}), np.inf]
    differentiated = _is_rate(sensors)
    frequency = np.linspace(0, rate / 2, SETTINGS.dense)
    bands = []
    for low, high in pairwise(edges):
        band = MotionBand(low, high, (), reach >= high, np.zeros((6, len(sensors))))
        share = band.share(frequency) ** 2
        grown = np.where(differentiated, np.mean(share * (2 * np.pi * frequency) ** 2), np.mean(share))
        noise = _noise_of(sensors) * np.sqrt(grown)
        columns = observable_motions(rows[band.used], noise[band.used])
        bands.append(MotionBand(low, high, columns, band.used, least_squares(rows, noise, columns, band.used)))
    return tuple(bands)


def _reach(sensors: tuple[GroundSensor, ...], rows: Array, rate: float) -> Array:
    """Frequency up to which each sensor is used, shape (m,) [Hz]: zero for a rate that shows no rotation."""
    reach = np.full(len(sensors), np.inf)
    is_rate = _is_rate(sensors)
    if not is_rate.any():
        return reach
    noise = _noise_of(sensors)
    columns = observable_motions(rows[~is_rate], noise[~is_rate])
    gains = least_squares(rows, noise, columns, ~is_rate)
    without_rates = np.sqrt(np.diag((gains * noise**2) @ gains.T))
    for index in np.flatnonzero(is_rate):
        motion = int(np.flatnonzero(rows[index])[0])
        # where the noise of the rate, times w, is that of the angular acceleration from the other sensors
        edge = without_rates[motion] / (2 * np.pi * noise[index])
        if motion not in columns:
            edge = _highest(sensors[index], rate)
        reach[index] = edge if edge < SETTINGS.whole * rate / 2 else np.inf
    return reach


def _highest(sensor: GroundSensor, rate: float) -> float:
    """Highest frequency at which a rate of turn stands out of its noise [Hz]; zero where it does not."""
    values = sensor.values
    length = int(min(values.size, max(64, values.size // 8)))
    frequency, density = averaged_spectrum(values, rate=rate, length=length, less="line")
    above = np.flatnonzero(np.real(density[1:]) > SETTINGS.stands_out * sensor.noise**2 / (rate / 2))
    if above.size:
        return float(frequency[1:][above[-1]] * 1.2)
    # a rate that rises steadily does not show in a spectrum that is freed of slopes
    line = np.linspace(-1, 1, values.size)
    rise = abs(float(line @ values)) / float(np.sqrt(line @ line))
    return float(frequency[1]) if rise > SETTINGS.slope * sensor.noise > 0 else 0.0
