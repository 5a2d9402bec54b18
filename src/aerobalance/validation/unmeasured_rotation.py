"""Turning of the ground end that only its angles show: what its angular acceleration would do to the forces.

Pitch and roll are used for the weight. They are not differentiated: their noise would grow with the square of the
frequency. So where no sensor shows the angular acceleration, inertia times it is taken for force. Here the angles are
differentiated over windows long enough to rise above their noise, which tells at least how much that is.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.result import ComponentForce
from aerobalance.motion.least_squares import GroundFit
from aerobalance.motion.sensors import ground_sensors
from aerobalance.motion.single_axis import without_gaps
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS, si_unit
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected

HALF_WINDOW: Final = 4
"""Samples on either side of the one at which a parabola gives the second derivative."""

PASSED: Final = 0.108
"""Frequency at which such a second derivative is half of the true one, over the sampling rate."""

FEWEST: Final = 64
"""Samples of a halved record below which it is not halved again."""

CLEAR: Final = 2.0
"""Mean square of a second derivative over that of its noise, and its rms over that of a count, that show turning."""

SPREAD: Final = 5.0
"""Standard deviations by which it has to pass that as well."""

MATTERS: Final = 0.5
"""Rms of the load over the uncertainty of the force from which it is told: the latter is then a tenth too small."""

BLOCKS: Final = 16
"""Parts of a record from which it is told how much of the load is in the force."""

HELD: Final = 0.25
"""Share of the load in the force below which the angle shows no turning, or the estimator has left it out."""

_OFFSETS: Final[Array] = np.arange(-HALF_WINDOW, HALF_WINDOW + 1.0)
_PARABOLA: Final[Array] = _OFFSETS**2 - np.mean(_OFFSETS**2)
_BEND: Final[Array] = 2 * _PARABOLA / np.sum(_PARABOLA * _OFFSETS**2)
"""Weights of the second derivative of a parabola through a window, times the square of the interval."""


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """Second derivative of an angle over one length of window.

    Attributes
    ----------
    values
        Shape (m,) [rad/s^2].
    factor
        Samples of the record in one of its own.
    signal
        Share of its mean square that is not noise of the angle [1].
    frequency
        Frequency up to which it shows turning [Hz].
    """

    values: Array
    factor: int
    signal: float
    frequency: float

    def averaged(self, series: Array) -> Array:
        """A series of the record's clock, shape (n, ...), on the clock of the second derivative, (m, ...)."""
        count = series.shape[0] // self.factor
        means = series[: count * self.factor].reshape(count, self.factor, *series.shape[1:]).mean(axis=1)
        return np.asarray(means[HALF_WINDOW : HALF_WINDOW + self.values.shape[0]])


def turning_by_angles(
    recording: Recording, dynamics: CoupledDynamics, estimates: Mapping[str, ComponentForce]
) -> list[str]:
    """Say which forces hold a load of angular acceleration that only pitch or roll shows.

    Parameters
    ----------
    recording
        The record.
    dynamics
        The balance with its mass.
    estimates
        The forces that were found, with their uncertainty.

    Returns
    -------
    sentences
        One for each angle; none where it does not matter.
    """
    if dynamics.mass is None:
        return []
    recording = corrected(recording)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # said when the force was worked out
        seen = GroundFit.of(ground_sensors(recording), rate=recording.rate).columns
    roll = without_gaps(recording.channel("roll")) if "roll" in recording else np.zeros(recording.samples)
    nothing = np.zeros_like(roll)
    found = []
    for angle, turns in (("pitch", (np.cos(roll), -np.sin(roll), nothing)), ("roll", (nothing, nothing, nothing + 1))):
        unseen = np.zeros((recording.samples, len(COMPONENTS)))
        for name, turn in zip(MOMENTS, turns, strict=True):
            if COMPONENTS.index(name) not in seen:
                unseen[:, COMPONENTS.index(name)] = turn
        bend = _bend(recording, angle) if angle in recording and unseen.any() else None
        if bend is not None:
            loads = bend.averaged(unseen @ dynamics.mass.matrix.T) * bend.values[:, None]
            parts = list(_told(bend, loads, estimates))
            found += [_sentence(angle, bend, parts)] if parts else []
    return found


def _bend(recording: Recording, angle: str) -> Bend | None:
    """The second derivative of an angle over the window that shows most of it; None where none stands out of noise."""
    channel = recording.channel(angle)
    values, noise, factor = without_gaps(channel), channel_noise(channel), 1
    resolution = _resolution(values)
    best: Bend | None = None
    most = 0.0
    while values.size >= FEWEST:
        scale = (recording.rate / factor) ** 2
        bend = np.convolve(values, _BEND, "valid") * scale
        size = float(np.mean(bend**2))
        white = float(np.sum(_BEND**2)) * (noise * scale) ** 2 / factor
        # a reading is off by half a count at most, all of them the worst way
        coarse = (0.5 * resolution * scale * float(np.sum(np.abs(_BEND)))) ** 2
        chance = 1 + SPREAD * np.sqrt(2 * _BEND.size / bend.size)
        if size > max(CLEAR * white * chance, CLEAR**2 * coarse) and size - white > most:
            most = size - white
            best = Bend(bend, factor, 1 - white / size, PASSED * recording.rate / factor)
        count = values.size // 2
        values, factor = values[: 2 * count].reshape(count, 2).mean(axis=1), 2 * factor
    return best


def _resolution(values: Array) -> float:
    """Rms of the steps of readings that stand still in between: counts of an encoder, or values that are held."""
    steps = np.diff(values)
    steps = steps[steps != 0]
    return 0.0 if 2 * steps.size > values.size or not steps.size else float(np.sqrt(np.mean(steps**2)))


class Load(NamedTuple):
    """What turning does to one component.

    Attributes
    ----------
    text
        Its size and what it is of the uncertainty, in words.
    clear
        Whether the force shows it: else the angle may have shown noise of its sensor.
    """

    text: str
    clear: bool


def _told(bend: Bend, loads: Array, estimates: Mapping[str, ComponentForce]) -> Iterator[Load]:
    """Components whose force may hold so much of the loads, shape (m, 6), that its uncertainty is too small."""
    for name, estimate in estimates.items():
        load = loads[:, COMPONENTS.index(name)]
        size = float(np.sqrt(bend.signal * np.mean(load**2)))
        u = float(np.sqrt(np.mean(estimate.uncertainty**2)))
        if not size > MATTERS * u:
            continue
        share, doubt = _share(bend, load, bend.averaged(estimate.values))
        if share + 4 * doubt > HELD:
            times = f" ({float(f'{size / u:.2g}'):g} times its uncertainty)" if u > 0 else ""
            yield Load(f"{size:.2g} {si_unit(name)} rms in {name}{times}", share - 4 * doubt > HELD)


def _share(bend: Bend, load: Array, force: Array) -> tuple[float, float]:
    """Share of a load in the force, as a size, and its standard uncertainty.

    It is 1 for a load that was not taken off, and 0 where the estimator took it for hum or the sensor of the angle is
    at fault. A true force may go with the angle, as the moment of the flow does, so that other values tell little.
    """
    line = np.vander(np.linspace(-1, 1, load.size), 2)
    both = np.column_stack([load, force])
    alone, held = (both - line @ np.linalg.lstsq(line, both)[0]).T
    part = float(alone @ held) / float(alone @ alone)
    rest = [float(block.sum()) for block in np.array_split(alone * (held - part * alone), BLOCKS)]
    doubt = float(np.std(rest, ddof=1)) * np.sqrt(BLOCKS) / float(alone @ alone)
    return abs(part) / bend.signal, doubt / bend.signal


def _sentence(angle: str, bend: Bend, loads: list[Load]) -> str:
    turn = "PM" if angle == "pitch" else "RM"
    noise = "" if any(load.clear for load in loads) else f", unless it is noise of {angle} that a filter has coloured"
    return (
        f"{angle} shows turning{noise}, and no sensor its angular acceleration: inertia times that is at least "
        f"{', '.join(load.text for load in loads)}, and stands in the forces but not in their uncertainty, as {angle} "
        f"serves for the weight only; above {bend.frequency:.3g} Hz more may hide in the noise or the resolution of "
        f"{angle}. Record ground_turn_{turn}, ground_turn_rate_{turn} or accelerometers at two places"
    )
