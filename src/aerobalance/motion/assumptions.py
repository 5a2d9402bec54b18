"""What is taken as zero, or as constant, of the ground's motion and of gravity, in words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from aerobalance.motion.gaps import FEWEST
from aerobalance.motion.least_squares import GroundFit
from aerobalance.motion.rotation import Turning
from aerobalance.motion.sensors import motion_name, unseen
from aerobalance.recording.components import AXES, MOMENT_ROWS, driving_axis
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.gravity import weight_direction
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording

CLEARLY: Final = 6.0
"""Mean of a rate of turn over its standard uncertainty by noise from which it is not zero: chance once in 5e8."""

ROLLS: Final = 1e-3
"""Rms change of the weight by the roll, over the weight, from which it is warned that it is not taken off [1]."""

ROLLS_IN_NOISE: Final = 3.0
"""The same over what the noise of the roll makes of it [1]."""

TOLD: Final = 0.01
"""Part of an accelerometer's noise from which the size of w x (w x r) in it is told."""

_STEADY: Final = (
    "; its mean of {mean:.3g} rad/s is taken as its zero, from which it cannot tell a steady turn. Such a turn pulls "
    "steadily, {pull:.2g} m/s^2 for each metre from its axis, and that stays in the mean of the force: if the ground "
    "end turns, take the mean of loads that count from a zero or a wind-off recording of the same turn"
)
"""What is said of a rate of turn that does not change and is not zero."""


def taken_as_zero(first: GroundFit, found: Turning) -> Iterator[str]:
    """What is taken as zero or approximately because of what the sensors of six motions do not see."""
    names = [sensor.channel.name for sensor in first.sensors]
    if not names:
        yield "no ground acceleration is recorded; the ground end is taken to be at rest"
        return
    for index, sensor in enumerate(first.sensors):
        if sensor.kind == "rate" and first.reach[index] == 0:
            mean = float(np.mean(sensor.values))
            off_zero = abs(mean) > CLEARLY * sensor.noise / np.sqrt(sensor.values.size)
            said = f"{names[index]} shows {'no change' if off_zero else 'nothing'} beyond its noise and is not used"
            yield said + (_STEADY.format(mean=mean, pull=mean**2) if off_zero else "")
    used = np.any([band.used for band in first.bands], axis=0)
    yield from unseen(first.rows[used], first.columns)
    for band in first.bands[1:]:
        lost = [motion_name(column) for column in first.columns if column not in band.columns]
        if lost:
            yield f"the ground's {', '.join(lost)} is taken as zero above {band.low:.3g} Hz, where no sensor shows it"
    turns = any(turn in first.columns for turn in MOMENT_ROWS)
    bare = [s.channel.name for s in first.sensors if s.kind == "acceleration" and s.channel.place is None]
    if turns and bare:
        yield f"{', '.join(bare)}: no place is given, so the balance's centre is taken for it"
    yield from found.assumptions
    sizes = np.sqrt(np.mean(found.felt**2, axis=0))
    large = any(size > TOLD * sensor.noise and size > 0 for size, sensor in zip(sizes, first.sensors, strict=True))
    if large and found.removed:
        most = float(np.max(np.abs(found.felt)))
        yield (
            f"w x (w x r) of the accelerometers' places, up to {most:.3g} m/s^2, is taken off "
            "with the rate of turn as recorded, or else integrated less a straight line, which lacks a steady turn"
        )


def check_roll(recording: Recording, *, along: str | None, gravity: float) -> None:
    """Warn of the weight that a roll swings, and that is not taken off without the pitch.

    Parameters
    ----------
    recording
        The recording.
    along
        The one component whose motion is wanted; None for all.
    gravity
        Local acceleration of gravity [m/s^2].
    """
    if "pitch" in recording or "roll" not in recording:
        return
    roll = recording.channel("roll")
    if np.count_nonzero(~roll.missing) < FEWEST:
        return
    change = np.nanstd(weight_direction(0.0, roll.values), axis=0)
    size = float(np.max(change) if along is None else change[AXES.index(driving_axis(along))])
    if size > ROLLS and size > ROLLS_IN_NOISE * channel_noise(roll):
        warn_quality(
            f"{recording.name}: roll is recorded and pitch is not, so the weight is taken as constant; at level pitch "
            f"the roll changes it by {size * gravity:.2g} m/s^2 of the mass (rms), which stays in the force. Record "
            "pitch as well"
        )
