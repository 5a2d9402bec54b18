"""One oscillator, integrated exactly for inputs that are cubics between the points of a fine grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import Mode
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True, eq=False)
class Input:
    """An input that is a cubic between the points of a grid, with slopes from its neighbours."""

    grid: Array
    values: Array
    coefficients: tuple[Array, Array, Array, Array]

    @classmethod
    def through(cls, values: Array, grid: Array) -> Input:
        """Lay cubics through values at the points of the grid."""
        h = float(grid[1] - grid[0])
        padded = np.pad(values, 2, mode="edge")
        slope = (8 * (padded[3:-1] - padded[1:-3]) - (padded[4:] - padded[:-4])) / (12 * h)
        rise = np.diff(values) / h
        second = (3 * rise - 2 * slope[:-1] - slope[1:]) / h
        third = (slope[:-1] + slope[1:] - 2 * rise) / h**2
        return cls(grid, values, (values[:-1], slope[:-1], second, third))

    @property
    def interval(self) -> float:
        """Distance of the points of the grid [s]."""
        return float(self.grid[1] - self.grid[0])

    def place(self, time: Array) -> tuple[NDArray[np.intp], Array]:
        """Cell of the grid that each time lies in, and the time since its first point."""
        position = (time - self.grid[0]) / self.interval
        cell = np.clip(np.floor(position + 1e-9).astype(np.intp), 0, self.grid.size - 2)
        return cell, time - self.grid[cell]

    def at(self, time: Array) -> Array:
        """Value at any times within the grid."""
        cell, rest = self.place(time)
        value = np.zeros(time.shape)
        for coefficient in reversed(self.coefficients):
            value = value * rest + coefficient[cell]
        return value


@dataclass(frozen=True, slots=True)
class Oscillator:
    """y'' + (c/m) y' + (s/m) y = p(t), underdamped, as one complex mode: y = Im(z) / wd with z' = pole z + p."""

    mass: float
    stiffness: float
    damping: float

    def __post_init__(self) -> None:
        if not self.damping < 2 * np.sqrt(self.stiffness * self.mass):
            raise ValueError("the rig is damped critically or more; the simulation needs a damping ratio below 1")

    @classmethod
    def of(cls, mode: Mode) -> Oscillator:
        """A mode as an oscillator of mass 1."""
        w = mode.angular_frequency
        return cls(1.0, w**2, 2 * mode.damping_ratio * w)

    @property
    def pole(self) -> complex:
        """Pole of the mode with a positive imaginary part [1/s]."""
        decay = self.damping / (2 * self.mass)
        return complex(-decay, float(np.sqrt(self.stiffness / self.mass - decay**2)))

    def integrals(self, time: Array | float) -> list[NDArray[np.complex128]]:
        """State at `time` >= 0 after rest, under drives 1, t, t^2 and t^3 that begin at 0; shape of `time` each."""
        t = np.asarray(time, dtype=np.float64)
        states = [np.asarray(np.expm1(self.pole * t) / self.pole, dtype=np.complex128)]
        for power in (1, 2, 3):
            states.append((power * states[-1] - t**power) / self.pole)
        return states

    def state(self, drive: Input) -> NDArray[np.complex128]:
        """State z at the points of the grid, from equilibrium under the first value of the drive."""
        from scipy.signal import lfilter  # noqa: PLC0415 - slow, and no live source needs it

        pushes = sum(
            integral * coefficient
            for integral, coefficient in zip(self._cell(drive.interval), drive.coefficients, strict=True)
        )
        start = -drive.values[0] / self.pole
        keep = np.exp(self.pole * drive.interval)
        z, _ = lfilter(np.array([1.0 + 0j]), np.array([1.0, -keep]), np.asarray(pushes), zi=np.array([keep * start]))
        return np.concatenate(([start], z))

    def _cell(self, interval: float) -> list[complex]:
        """Integrals over one cell of the grid, by their series: the recursion of `integrals` cancels there."""
        terms = []
        for power in range(4):
            term = complex(interval ** (power + 1) / (power + 1))
            total = term
            for order in range(1, 30):
                term = term * self.pole * interval / (power + 1 + order)
                total += term
            terms.append(total)
        return terms

    def between(self, state: NDArray[np.complex128], drive: Input, *, time: Array) -> NDArray[np.complex128]:
        """State z at any times within the grid."""
        cell, rest = drive.place(time)
        z = np.exp(self.pole * rest) * state[cell]
        for power, coefficient in enumerate(drive.coefficients):
            term = rest ** (power + 1) / (power + 1) + 0j
            total = term.copy()
            for order in range(1, 12):
                term = term * self.pole * rest / (power + 1 + order)
                total += term
                if np.max(np.abs(term)) < 1e-16 * np.max(np.abs(total), initial=0.0) or not term.any():
                    break
            z += coefficient[cell] * total
        return np.asarray(z)

    def fall(self, time: Array, *, instant: float, duration: float) -> NDArray[np.complex128]:
        """State z for a drive that is 1 until `instant` and falls to 0 on a straight line within `duration`."""
        after = self.integrals(np.maximum(time - instant, 0.0))
        if duration:
            over = self.integrals(np.maximum(time - instant - duration, 0.0))
            return -1 / self.pole - (after[1] - over[1]) / duration
        return -1 / self.pole - after[0]

    def motion(self, z: NDArray[np.complex128]) -> tuple[Array, Array]:
        """Displacement y and velocity y'."""
        wd = self.pole.imag
        return z.imag / wd, (self.pole * z).imag / wd
