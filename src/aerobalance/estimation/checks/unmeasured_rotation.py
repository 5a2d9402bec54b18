"""Check for rotation of the non-metric ("ground") end that only pitch and roll show, and its load in the forces.

Pitch and roll are used for the weight. They are not differentiated: their noise would grow with the square of the
frequency. So where no sensor measures the angular acceleration, its inertial load (inertia times it) is taken for
force. Here the angles are differentiated twice over windows long enough for the result to stand out of their noise;
that gives a lower bound of the load.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.result import ComponentForce
from aerobalance.motion.gaps import predicted
from aerobalance.motion.least_squares import GroundFit
from aerobalance.motion.sensors import ground_sensors
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS, si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import kept_warnings
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected


@dataclass(frozen=True, slots=True)
class RotationSettings:
    """Thresholds of the search for rotation that only angles show.

    Attributes
    ----------
    half_window
        Samples on either side of the one at which a fitted parabola gives the second derivative.
    passed
        Frequency at which such a second derivative is half of the true one, over the sampling rate [1].
    fewest
        Samples that a decimated record must have to be used.
    clear
        Mean square of a second derivative over that of its noise, and its rms over the largest error by the resolution
        of the angle, above which it shows rotation.
    spread
        Standard deviations of the mean square of pure noise by which it has to exceed that of the noise as well.
    matters
        Rms of the load over the uncertainty of the force above which it is reported: the latter is then a tenth too
        low.
    blocks
        Parts of a record from whose scatter the uncertainty of the share of the load in the force is found.
    held
        Share of the load in the force below which the angle shows no rotation, or the estimator has left the load out.
    """

    half_window: int = 4
    passed: float = 0.108
    fewest: int = 64
    clear: float = 2.0
    spread: float = 5.0
    matters: float = 0.5
    blocks: int = 16
    held: float = 0.25


SETTINGS: Final = RotationSettings()
"""Thresholds that are used."""


_OFFSETS: Final[Array] = np.arange(-SETTINGS.half_window, SETTINGS.half_window + 1.0)
_PARABOLA: Final[Array] = _OFFSETS**2 - np.mean(_OFFSETS**2)
_WEIGHTS: Final[Array] = 2 * _PARABOLA / np.sum(_PARABOLA * _OFFSETS**2)
"""Weights by which the samples of a window give the second derivative of the parabola fitted to them by least squares,
times the square of the interval, shape (2 `SETTINGS.half_window` + 1,) [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class SecondDerivative:
    """Second derivative of an angle, from parabolas fitted over windows of one length.

    Attributes
    ----------
    values
        Second derivative, shape (m,) [rad/s^2].
    factor
        Samples of the record that are averaged into one before the fit.
    signal
        Share of its mean square that is not noise of the angle [1].
    frequency
        Frequency up to which it shows rotation [Hz].
    """

    values: Array
    factor: int
    signal: float
    frequency: float

    def averaged(self, series: Array) -> Array:
        """Return a series at the record's samples, shape (n, ...), averaged to those of `values`, shape (m, ...)."""
        count = series.shape[0] // self.factor
        means = series[: count * self.factor].reshape(count, self.factor, *series.shape[1:]).mean(axis=1)
        return np.asarray(means[SETTINGS.half_window : SETTINGS.half_window + self.values.shape[0]])


def turning_by_angles(
    recording: Recording, dynamics: CoupledDynamics, estimates: Mapping[str, ComponentForce]
) -> list[Doubt]:
    """Return doubts of forces that hold the inertial load of a rotation that only pitch or roll shows.

    Parameters
    ----------
    recording
        The record.
    dynamics
        The balance with its mass matrix; without one, or without an angle, nothing can be said.
    estimates
        Estimated forces with their uncertainty, by component.

    Returns
    -------
    doubts
        One for each angle whose rotation matters, of the component that it matters most for; empty where none does.
    """
    if dynamics.mass is None or not {"pitch", "roll"} & set(recording.channels):
        return []
    recording = corrected(recording)
    with kept_warnings():  # they were given when the force was estimated
        measured = GroundFit.of(ground_sensors(recording), rate=recording.rate).columns
    roll = predicted(recording.channel("roll"))[0] if "roll" in recording else np.zeros(recording.samples)
    zero = np.zeros_like(roll)
    # axis of each angle, along PM, YM and RM: pitch turns about the level lateral axis, roll about the balance
    axes = {"pitch": (np.cos(roll), -np.sin(roll), zero), "roll": (zero, zero, zero + 1)}
    found = []
    for angle, axis in axes.items():
        unmeasured = np.zeros((recording.samples, len(COMPONENTS)))
        for name, part in zip(MOMENTS, axis, strict=True):
            if COMPONENTS.index(name) not in measured:
                unmeasured[:, COMPONENTS.index(name)] = part
        second = _second_derivative(recording, angle) if angle in recording and unmeasured.any() else None
        if second is not None:
            loads = second.averaged(unmeasured @ dynamics.mass.matrix.T) * second.values[:, None]
            affected = list(_affected(second, loads, estimates))
            found += [_doubt(angle, second, affected)] if affected else []
    return found


def _second_derivative(recording: Recording, angle: str) -> SecondDerivative | None:
    """Second derivative of an angle over the window that shows most rotation; None where none shows any.

    The window is made longer by decimation: the record is halved, by means of two samples, as long as it has
    `SETTINGS.fewest`.
    """
    channel = recording.channel(angle)
    values, noise, factor = predicted(channel)[0], channel_noise(channel), 1
    resolution = _resolution(values)
    best: SecondDerivative | None = None
    most = 0.0
    while values.size >= SETTINGS.fewest:
        scale = (recording.rate / factor) ** 2
        second = np.convolve(values, _WEIGHTS, "valid") * scale
        size = float(np.mean(second**2))
        white = float(np.sum(_WEIGHTS**2)) * (noise * scale) ** 2 / factor
        # a reading is off by half a count at most, all of them the worst way
        coarse = (0.5 * resolution * scale * float(np.sum(np.abs(_WEIGHTS)))) ** 2
        # windows overlap, so that about one value in a window's length is independent
        chance = 1 + SETTINGS.spread * np.sqrt(2 * _WEIGHTS.size / second.size)
        if size > max(SETTINGS.clear * white * chance, SETTINGS.clear**2 * coarse) and size - white > most:
            most = size - white
            best = SecondDerivative(second, factor, 1 - white / size, SETTINGS.passed * recording.rate / factor)
        count = values.size // 2
        values, factor = values[: 2 * count].reshape(count, 2).mean(axis=1), 2 * factor
    return best


def _resolution(values: Array) -> float:
    """Resolution of readings [rad]: rms of their steps where most do not change (encoder, held values); else 0."""
    steps = np.diff(values)
    steps = steps[steps != 0]
    return 0.0 if 2 * steps.size > values.size or not steps.size else float(np.sqrt(np.mean(steps**2)))


class AffectedForce(NamedTuple):
    """One component whose force holds the inertial load of the rotation.

    Attributes
    ----------
    component, size
        Which component, and the root mean square of the load [N, N*m].
    times
        The same over the uncertainty of the force [1].
    text
        Rms of the load, and its ratio to the uncertainty of the force, in words.
    clear
        Whether the force shows the load for certain: else the angle may have shown coloured noise of its sensor.
    """

    component: str
    size: float
    times: float
    text: str
    clear: bool


def _affected(
    second: SecondDerivative, loads: Array, estimates: Mapping[str, ComponentForce]
) -> Iterator[AffectedForce]:
    """Components whose force may hold so much of the loads, shape (m, 6) [N, N*m], that its uncertainty is too low."""
    for name, estimate in estimates.items():
        load = loads[:, COMPONENTS.index(name)]
        size = float(np.sqrt(second.signal * np.mean(load**2)))
        u = float(np.sqrt(np.mean(estimate.uncertainty**2)))
        if not size > SETTINGS.matters * u:
            continue
        share, u_share = _share_in_force(second, load, second.averaged(estimate.values))
        # left out only where the share is surely below, called clear only where it is surely above
        if share + 4 * u_share > SETTINGS.held:
            times = f" ({float(f'{size / u:.2g}'):g} times its uncertainty)" if u > 0 else ""
            yield AffectedForce(
                name,
                size,
                size / u if u > 0 else np.inf,
                f"{size:.2g} {si_unit(name)} rms in {name}{times}",
                share - 4 * u_share > SETTINGS.held,
            )


def _share_in_force(second: SecondDerivative, load: Array, force: Array) -> tuple[float, float]:
    """Absolute share of a load in the force, both of shape (m,) [N, N*m], and its standard uncertainty [1].

    It is the slope of a regression of the force on the load, both freed of a straight line, and corrected for the
    noise of the angle, which makes a slope too small. It is 1 for a load that was not taken off, and 0 where the
    estimator took it for hum or the sensor of the angle is at fault. A true force may go with the angle, as the moment
    of the flow does, so that other values tell little.
    """
    line = np.vander(np.linspace(-1, 1, load.size), 2)
    both = np.column_stack([load, force])
    x, y = (both - line @ np.linalg.lstsq(line, both)[0]).T
    slope = float(x @ y) / float(x @ x)
    # residuals are correlated from sample to sample; their sums over long blocks are hardly
    sums = [float(block.sum()) for block in np.array_split(x * (y - slope * x), SETTINGS.blocks)]
    u = float(np.std(sums, ddof=1)) * np.sqrt(SETTINGS.blocks) / float(x @ x)
    return abs(slope) / second.signal, u / second.signal


def _doubt(angle: str, second: SecondDerivative, affected: list[AffectedForce]) -> Doubt:
    """Doubt of the rotation that one angle shows, with what to record."""
    turn = "PM" if angle == "pitch" else "RM"
    noise = "" if any(one.clear for one in affected) else f", unless it is noise of {angle} that a filter has coloured"
    most = max(affected, key=lambda one: one.times)
    text = (
        f"{angle} shows turning{noise}, and no sensor its angular acceleration: inertia times that is at least "
        f"{', '.join(one.text for one in affected)}, and stands in the forces but not in their uncertainty, as "
        f"{angle} serves for the weight only; above {second.frequency:.3g} Hz more may hide in the noise or the "
        f"resolution of {angle}"
    )
    advice = f"record ground_turn_{turn}, ground_turn_rate_{turn} or accelerometers at two places"
    return Doubt("turning", most.component, text, advice, most.size, si_unit(most.component))
