"""The sensors on the ground end: what each reads of its motion in six degrees of freedom.

An accelerometer at r that looks along e reads e . (a + alpha x r + w x (w x r)), less e . g where it is dc-coupled.
Rows and columns of motion are in the order and signs of the components: NF is the acceleration of the balance's centre
up, PM the turn nose up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from aerobalance.motion.gaps import filled
from aerobalance.recording.channel import AXES_BY_NAME, Array, Channel, is_ground_acceleration
from aerobalance.recording.components import (
    AXIS_VECTORS,
    COMPONENTS,
    DIRECTIONS,
    FORCE_AXES,
    IS_FORCE,
    MOMENTS,
    driving_axis,
    driving_channel,
)
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import divided, filtered, high_pass

Kind = Literal["acceleration", "turn", "rate"]

INDEPENDENT: Final = 1e-6
"""Share of a motion's readings that no other motion can make, from which the two are told apart."""

ORDER: Final = tuple(COMPONENTS.index(name) for name in (*FORCE_AXES, *MOMENTS))
"""Where sensors cannot tell two motions apart, the one that comes later is taken as zero: turns, mostly."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundSensor:
    """One sensor of the ground end's motion.

    Attributes
    ----------
    channel
        What it read, and how it was taken.
    kind
        What it is: ``"acceleration"``, ``"turn"`` (angular acceleration) or ``"rate"`` (its integral).
    axis, place
        Direction and place along aft, right, up, shapes (3,) [1, m]; zero for turns.
    values
        Readings on the common clock without gaps, shape (n,) [m/s^2, rad/s^2, rad/s].
    noise
        Standard uncertainty of one reading, white [m/s^2, rad/s^2, rad/s].
    gaps
        Errors of independent size 1 that fill its gaps, shape (n, k) [m/s^2, rad/s^2, rad/s].
    """

    channel: Channel
    kind: Kind
    axis: Array
    place: Array
    values: Array
    noise: float
    gaps: Array

    @property
    def row(self) -> Array:
        """What it reads of the six motions, shape (6,)."""
        return row_of(self.channel.name, self.axis, self.place)

    @property
    def reads_gravity(self) -> bool:
        """Whether it reads specific force."""
        return self.kind == "acceleration" and self.channel.coupling == "dc"


def ground_channels(recording: Recording) -> tuple[Channel, ...]:
    """Channels of the sensors of the ground end's motion in a recording.

    Raises
    ------
    FitError
        A channel has no reading.
    """
    found = tuple(channel for name, channel in recording.channels.items() if sensor_kind(name) is not None)
    for channel in found:
        _check_read(channel, recording)
    return found


def ground_sensors(recording: Recording) -> tuple[GroundSensor, ...]:
    """Sensors of the ground end's motion in a recording, on the clock of the first of them.

    Parameters
    ----------
    recording
        Readings with filters and cross-axis sensitivities undone.

    Raises
    ------
    FitError
        An accelerometer has no axis, or a channel no reading.
    """
    found: list[GroundSensor] = []
    for channel in ground_channels(recording):
        kind = sensor_kind(channel.name)
        if kind is None:
            raise AssertionError
        axis, place = np.zeros(3), np.zeros(3)
        if kind == "acceleration":
            axis, place = _mounting(channel, recording)
        delay = found[0].channel.delay if found else channel.delay
        values, gaps = on_clock_with_gaps(recording, channel, delay)
        found.append(GroundSensor(channel, kind, axis, place, values, channel_noise(channel), gaps))
    return tuple(found)


def driving_sensors(recording: Recording, component: str) -> tuple[GroundSensor, ...]:
    """The accelerometer that sees what drives a component taken alone: of its axis, or else ``ground_acceleration``.

    It is taken to look along the component, at the balance's centre. Nothing where none is recorded.

    Raises
    ------
    FitError
        The channel has no reading.
    """
    name = driving_channel("ground", component, recording)
    if name not in recording:
        return ()
    channel = recording.channel(name)
    _check_read(channel, recording)
    axis = np.array(AXIS_VECTORS[driving_axis(component)], dtype=np.float64)
    values, gaps = on_clock_with_gaps(recording, channel, channel.delay)
    return (GroundSensor(channel, "acceleration", axis, np.zeros(3), values, channel_noise(channel), gaps),)


def _check_read(channel: Channel, recording: Recording) -> None:
    if channel.missing.all():
        raise FitError(f"{recording.name}: {channel.name} has no reading; leave the channel out, or record it again")


def row_of(name: str, axis: Array, place: Array) -> Array:
    """What a channel reads of the six motions, shape (6,); axis and place are those of an accelerometer."""
    if sensor_kind(name) != "acceleration":
        return np.array([float(component == name.rpartition("_")[2]) for component in COMPONENTS])
    return np.where(IS_FORCE > 0, DIRECTIONS @ axis, np.cross(DIRECTIONS, place) @ axis)


def sensor_kind(name: str) -> Kind | None:
    """What a channel of this name reads of the ground's motion; None if nothing."""
    if is_ground_acceleration(name):
        return "acceleration"
    stem, _, ending = name.rpartition("_")
    kinds: dict[str, Kind] = {"ground_turn": "turn", "ground_turn_rate": "rate"}
    return kinds.get(stem) if ending in MOMENTS else None


def _mounting(channel: Channel, recording: Recording) -> tuple[Array, Array]:
    """Axis and place of an accelerometer; one without a place is taken at the balance's centre."""
    axis = AXES_BY_NAME.get(channel.name) if channel.axis is None else channel.axis
    if axis is None:
        raise FitError(
            f"{recording.name}: {channel.name} has no axis, so nobody knows which way it reads; give its axis and "
            'place in a channel map, for example axis = "up", place = [0.5, 0.0, 0.1]'
        )
    vector = np.array(axis, dtype=np.float64)
    return vector / np.linalg.norm(vector), np.array(channel.place or (0.0, 0.0, 0.0), dtype=np.float64)


def on_clock_with_gaps(recording: Recording, channel: Channel, delay: float) -> tuple[Array, Array]:
    """Readings without gaps or high-pass, (n,), and errors within the gaps, (n, k), as if both had this delay [s]."""
    values, gaps = filled(channel)
    if channel.coupling == "ac":
        warn_quality(
            f"{channel.name} is ac-coupled: ground motion below its corner of {channel.corner:g} Hz is not in the "
            "channel and stays in the force"
        )
    placed = [on_clock(column, channel, rate=recording.rate, delay=delay) for column in gaps.T]
    return on_clock(values, channel, rate=recording.rate, delay=delay), np.column_stack(placed) if placed else gaps


def on_clock(series: Array, channel: Channel, *, rate: float, delay: float) -> Array:
    """What a channel has of a series less its high-pass, as if it had another delay, shape (n,) in its unit.

    Parameters
    ----------
    series
        Readings of the channel, or a change of them, without gaps, shape (n,).
    channel
        The channel.
    rate
        Sampling rate [Hz].
    delay
        The other delay [s].
    """
    if channel.coupling == "ac":
        series = divided(series, high_pass(channel.corner), rate=rate)
    late = channel.delay - delay
    return filtered(series, lambda f: np.exp(2j * np.pi * f * late), rate=rate) if late else series


def observable_motions(rows: Array, noise: Array) -> tuple[int, ...]:
    """Motions that sensors can tell apart, greedily in `ORDER`.

    Parameters
    ----------
    rows
        What the sensors read of the six motions, shape (m, 6).
    noise
        Their noise, shape (m,).

    Returns
    -------
    columns
        Indices into the components.
    """
    weighted = rows / noise[:, None]
    taken: list[int] = []
    basis: list[Array] = []
    for column in ORDER:
        vector = weighted[:, column]
        size = float(np.linalg.norm(vector))
        rest = vector.copy()
        for _ in range(2):  # the second time takes off what rounding has left
            for direction in basis:
                rest -= (direction @ rest) * direction
        if size > 0 and np.linalg.norm(rest) > INDEPENDENT * size:
            taken.append(column)
            basis.append(rest / np.linalg.norm(rest))
    return tuple(sorted(taken))


def unseen(rows: Array, columns: tuple[int, ...]) -> list[str]:
    """Return which motions the sensors do not see, or cannot tell from others, and that they are taken as zero.

    Parameters
    ----------
    rows
        What the sensors read of the six motions, shape (m, 6).
    columns
        The motions that they tell apart.
    """
    blind, mixed = [], []
    for index in (place for place in ORDER if place not in columns):
        size = float(np.linalg.norm(rows[:, index], ord=np.inf)) if rows.size else 0.0
        if size < INDEPENDENT:
            blind.append(motion_name(index))
            continue
        share = np.linalg.lstsq(rows[:, list(columns)], rows[:, index])[0]
        others = [motion_name(column) for column, part in zip(columns, share, strict=True) if abs(part) > INDEPENDENT]
        mixed.append(
            f"the ground's {motion_name(index)} cannot be told from its {' and '.join(others)} by these sensors and "
            "is taken as zero"
        )
    if blind:
        mixed.insert(0, f"the ground's {', '.join(blind)} is seen by no sensor and taken as zero")
    return mixed


def motion_name(index: int) -> str:
    """Words for one of the six motions."""
    words = {
        "NF": "acceleration up (NF)",
        "SF": "acceleration to the right (SF)",
        "AF": "acceleration aft (AF)",
        "PM": "turn in pitch (PM)",
        "YM": "turn in yaw (YM)",
        "RM": "turn in roll (RM)",
    }
    return words[COMPONENTS[index]]


def least_squares(rows: Array, noise: Array, columns: tuple[int, ...], used: NDArray[np.bool_]) -> Array:
    """Matrix from readings to the six motions by weighted least squares, shape (6, m).

    Parameters
    ----------
    rows
        What the sensors read of the six motions, shape (m, 6).
    noise
        Their noise, shape (m,).
    columns
        Motions that are looked for; the others are zero.
    used
        Sensors that are used, shape (m,).
    """
    gains = np.zeros((6, rows.shape[0]))
    if not columns or not used.any():
        return gains
    sensors, motions = np.flatnonzero(used), np.array(columns)
    weighted = rows[np.ix_(sensors, motions)] / noise[sensors, None]
    scale = np.linalg.norm(weighted, axis=0)
    inverse = np.linalg.pinv(weighted / scale, rcond=1e-12) / scale[:, None]
    gains[np.ix_(motions, sensors)] = inverse / noise[sensors]
    return gains
