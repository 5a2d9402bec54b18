"""How a rig is read: noise, resolution, range, delay and anti-alias filter of every channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.recording.channel import QUANTITIES, Array, Channel
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.recording import Recording
from aerobalance.simulation.drives import Signal

ACCELEROMETER_RANGE: Final = 50 * STANDARD_GRAVITY
"""Range of the accelerometers of both rigs, section 2.1 of [Gorbushin2020]_ [m/s^2]."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """How one quantity is read.

    Attributes
    ----------
    noise
        Standard deviation of the white noise of one reading [unit of the quantity].
    resolution
        Step of the analogue-to-digital converter; 0 for none [unit].
    limit
        Largest reading of either sign; what is beyond is clipped [unit].
    delay
        Time by which the readings lag the clock; may have either sign [s].
    corner
        Corner of the Butterworth anti-alias filter [Hz]; 0 for none.
    order
        Order of that filter.
    """

    noise: float = 0.0
    resolution: float = 0.0
    limit: float = np.inf
    delay: float = 0.0
    corner: float = 0.0
    order: int = 4

    def __post_init__(self) -> None:
        for name in ("noise", "resolution", "corner"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} of a sensor must be zero or more, not {getattr(self, name)}")
        if not self.limit > 0 or not np.isfinite(self.delay) or self.order < 1:
            raise ValueError("a sensor needs a positive limit, a finite delay and a filter order of 1 or more")

    def read(self, signal: Signal, clock: Array, *, grid: Array, generator: np.random.Generator) -> Array:
        """Read a quantity at the times of the clock, shape (n,)."""
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow, and no live source needs it
        from scipy.signal import butter, sosfilt, sosfilt_zi  # noqa: PLC0415 - slow, and no live source needs it

        instants = clock - self.delay
        if self.corner:
            rate = 1 / (grid[1] - grid[0])
            sections = butter(self.order, self.corner, fs=rate, output="sos")
            values = signal(grid)
            filtered, _ = sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])
            exact = np.asarray(CubicSpline(grid, filtered)(instants))
        else:
            exact = signal(instants)
        readings = exact + self.noise * generator.standard_normal(clock.size)
        if self.resolution:
            readings = self.resolution * np.rint(readings / self.resolution)
        return np.clip(readings, -self.limit, self.limit)


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A simulated recording with the truth behind it.

    Attributes
    ----------
    recording
        What a file of the rig would hold, in SI units.
    applied
        Force applied to the live end at every sample, shape (n,) [N].
    load
        Balance load (elastic, static part included) at every sample, without noise and delay, shape (n,) [N].
    ground_acceleration
        Acceleration of the ground end at every sample, shape (n,) [m/s^2].
    pitch
        Pitch angle of the balance at every sample, shape (n,) [rad].
    drive
        Force of the shaker on the armature at every sample, shape (n,) [N]; zero where there is no shaker.
    release
        Instant at which the cable begins to let go [s]; NaN where nothing is released.
    """

    recording: Recording
    applied: Array
    load: Array
    ground_acceleration: Array
    pitch: Array
    drive: Array
    release: float


def accelerometer(deviation: float) -> Sensor:
    """Return an accelerometer of the rigs with the given noise [m/s^2]."""
    return Sensor(noise=deviation, limit=ACCELEROMETER_RANGE)


def integration_grid(clock: Array, rate: float, sensors: Mapping[str, Sensor], *, before: float) -> Array:
    """Integration grid that reaches past the clock at both ends by what delays need, and `before` [s] further back."""
    margin = max((abs(sensor.delay) for sensor in sensors.values()), default=0.0)
    first = -int(np.ceil((margin + before) * rate)) - 2
    last = int(np.ceil((clock[-1] + margin) * rate)) + 2
    return np.arange(first, last + 1) / rate


def read_channels(
    signals: Mapping[str, Signal],
    sensors: Mapping[str, Sensor],
    *,
    clock: Array,
    grid: Array,
    generator: np.random.Generator,
) -> dict[str, Channel]:
    """Read every quantity that has a sensor."""
    unknown = set(sensors) - set(signals)
    if unknown:
        raise ValueError(f"this rig has no {', '.join(sorted(unknown))}; it has {', '.join(signals)}")
    return {
        name: Channel(name, sensors[name].read(signal, clock, grid=grid, generator=generator), QUANTITIES[name])
        for name, signal in signals.items()
        if name in sensors
    }
