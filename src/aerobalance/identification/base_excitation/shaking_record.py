"""A record of a shaken balance as the terms of X + D X' + A X'' + M x1'' = 0, frequency by frequency."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.rigid_body import NUMBERS, inertial_loads, turning_basis
from aerobalance.identification.base_excitation.shaking_ground import EXACT, GroundReadings
from aerobalance.identification.base_excitation.shaking_window import Window
from aerobalance.identification.base_excitation.spectra import longest_whole
from aerobalance.identification.coupled.free_response import Complex
from aerobalance.motion.platform import PlatformMotion
from aerobalance.motion.sensors import ground_channels
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError
from aerobalance.recording.fourier import without_line
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import fractional_delay, interpolate_gaps
from aerobalance.recording.sensors import corrected

BLOCK: Final = 32
"""Frequencies that are taken or left together."""

STANDS_OUT: Final = 3.0
"""Power of a block over that of the noise from which it tells something: 32 powers pass it once in 1e13."""

FEWEST: Final = 256
"""Frequencies that a record must have to be of use."""


@dataclass(frozen=True, slots=True, eq=False)
class ShakeRecord:
    """The terms of the equation at the frequencies used, as amplitudes: white noise has its variance as power.

    Attributes
    ----------
    name
        What the record is called in messages.
    frequency
        Shape (m,) [Hz].
    loads, rates, seconds
        Transforms of the balance loads, and of their first and second derivatives, shape (m, 6).
    motion
        Transform of the ground's specific force, shape (m, 6) [m/s^2, rad/s^2].
    taken
        Loads that the motion takes for a unit of each parameter of a rigid mass (`unit_masses`), shape (m, 6, 10).
    motion_noise
        Covariance of the noise of `motion`, shape (m, 6, 6).
    slopes
        Change of `motion` by what is not known exactly of the sensors, by name and source, shape (m, 6) each.
    unknown
        Standard uncertainties of these.
    noise
        Standard deviation of one reading of the loads, given or judged, shape (6,) [N, N*m].
    share
        What the window leaves of the information, between 0 and 1.
    samples, duration
        How many of them, and the length of the record [s].
    reach
        Largest change of the loads, shape (6,) [N, N*m].
    columns
        Motions that the sensors show, places among the components; the others are taken as none.
    """

    name: str
    frequency: Array
    loads: Complex
    rates: Complex
    seconds: Complex
    motion: Complex
    taken: Complex
    motion_noise: Array
    slopes: dict[tuple[str, str], Complex]
    unknown: dict[tuple[str, str], float]
    noise: Array
    share: float
    samples: int
    duration: float
    reach: Array
    columns: tuple[int, ...]

    @property
    def motion_rms(self) -> Array:
        """Rms of the ground's motion at the frequencies used, noise taken off, shape (6,) [m/s^2, rad/s^2]."""
        noise = np.einsum("mjj->mj", self.motion_noise)
        power = np.sum(np.abs(self.motion) ** 2 - noise, axis=0)
        return np.asarray(np.sqrt(2 * np.maximum(power, 0.0) / self.samples))

    def keep(self, chosen: NDArray[np.bool_] | slice) -> ShakeRecord:
        """The frequencies that are chosen."""
        return replace(
            self,
            frequency=self.frequency[chosen],
            loads=self.loads[chosen],
            rates=self.rates[chosen],
            seconds=self.seconds[chosen],
            motion=self.motion[chosen],
            taken=self.taken[chosen],
            motion_noise=self.motion_noise[chosen],
            slopes={key: slope[chosen] for key, slope in self.slopes.items()},
        )


def shake_record(recording: Recording, *, delay: float = 0.0, band: tuple[float, float] | None = None) -> ShakeRecord:
    """Take loads and ground motion of a recording to the frequency domain.

    Parameters
    ----------
    recording
        Balance loads, and the ground's motion in any sensors that `PlatformMotion` knows.
    delay
        Time by which the loads lag the ground's motion, beyond the delays that the channels carry [s].
    band
        Lowest and highest frequency to use [Hz]; by default all that stand out of the noise.

    Raises
    ------
    FitError
        A channel is missing, the ground end does not move, or too little of the record can be used.
    """
    recording = _whole(corrected(recording))
    platform = PlatformMotion.of(recording)
    if not platform.acceleration.any():
        raise FitError(
            f"{recording.name}: the ground end does not move: {'; '.join(platform.assumptions)}; shake it and record "
            "its acceleration, or identify from releases"
        )
    channels = [recording.channel(name) for name in COMPONENTS]
    loads = interpolate_gaps(np.column_stack([np.where(c.at_limit, np.nan, c.values) for c in channels]))
    delays = [platform.delay - delay - channel.delay for channel in channels]
    moved = [
        fractional_delay(column, delay=by, interval=1 / recording.rate)
        for column, by in zip(loads.T, delays, strict=True)
    ]
    felt = without_line(np.array(moved)).T
    rms = np.sqrt(np.mean(felt**2, axis=0))
    judged = np.array([channel_noise(channel) for channel in channels])
    noise = np.maximum(judged, EXACT * max(float(rms.max()), np.finfo(float).tiny))
    window = Window.of(recording.samples, recording.rate)
    ground = GroundReadings.of(recording, platform)
    motion, disturbed = ground.specific_force(window)
    compared = [(window.transform(felt), noise**2), (motion, np.einsum("mjj->mj", disturbed))]
    chosen = _excited(window, compared, band=band, name=recording.name)
    window = window.only(chosen)
    motion = motion[chosen]
    plain, first, second = window.derivatives(felt)
    unknowns = _unknowns(platform, window)
    return ShakeRecord(
        name=recording.name,
        frequency=window.frequency[window.used],
        loads=plain,
        rates=first,
        seconds=second,
        motion=motion,
        taken=inertial_loads(motion) + _turning(platform, window),
        motion_noise=disturbed[chosen],
        slopes={key: slope for key, (slope, _) in unknowns.items()},
        unknown={key: u for key, (_, u) in unknowns.items()},
        noise=noise,
        share=window.share,
        samples=recording.samples,
        duration=recording.samples / recording.rate,
        reach=np.ptp(felt, axis=0),
        columns=ground.columns,
    )


def _turning(platform: PlatformMotion, window: Window) -> Complex:
    """Loads that keep a unit of every number of the mass turning, shape (m, 6, 10)."""
    found = np.zeros((np.count_nonzero(window.used), 6, NUMBERS), dtype=np.complex128)
    if platform.turn_rate.any():
        turning = turning_basis(platform.turn_rate)
        for number in np.flatnonzero(turning.any(axis=(0, 1))):
            found[:, :, number] = window.transform(turning[:, :, number])
    return found


def _unknowns(platform: PlatformMotion, window: Window) -> dict[tuple[str, str], tuple[Complex, float]]:
    """Change of the motion by what is not known exactly of the sensors, with its standard uncertainty."""
    found: dict[tuple[str, str], tuple[Complex, float]] = {}
    for item in platform.unknowns:
        slope = window.transform(without_line(item.slope.T).T)
        if np.abs(slope).max() > EXACT * float(np.abs(item.slope).max()):  # a zero is no motion
            found[item.name, item.source] = slope, item.uncertainty
    return found


def _whole(recording: Recording) -> Recording:
    """The longest stretch in which all loads and sensors of the ground have readings, but for single gaps.

    Raises
    ------
    FitError
        A load is not in the recording, does not change, or the stretch is too short.
    """
    lacking = [name for name in COMPONENTS if name not in recording]
    if lacking:
        raise FitError(
            f"{recording.name} has no {', '.join(lacking)}; coupled components are identified from the "
            f"loads of all: {', '.join(COMPONENTS)}"
        )
    loads = [recording.channel(name) for name in COMPONENTS]
    ground = ground_channels(recording)
    if not ground:
        raise FitError(
            f"{recording.name}: no motion of the ground end is recorded (ground_acceleration and its like); record "
            "it, or identify from releases (identify decay)"
        )
    part = longest_whole(recording, [*loads, *(recording.channel(channel.name) for channel in ground)])
    still = [channel.name for channel in loads if not np.nanstd(channel.values[part]) > 0]
    if still:
        raise FitError(f"{recording.name}: the readings of {', '.join(still)} never change; is it connected?")
    if part == slice(0, recording.samples):
        return recording
    kept = {name: replace(channel, values=channel.values[part]) for name, channel in recording.channels.items()}
    count = part.stop - part.start
    stamps = recording.start + np.arange(part.start, part.stop) / recording.rate
    return replace(
        recording,
        stamps=stamps,
        rows=np.arange(count, dtype=np.intp),
        start=float(stamps[0]),
        channels=kept,
    )


def _excited(
    window: Window, parts: list[tuple[Complex, Array]], *, band: tuple[float, float] | None, name: str
) -> NDArray[np.bool_]:
    """The frequencies whose blocks stand out of the noise in some load or motion.

    Parameters
    ----------
    window
        Says which frequencies there are.
    parts
        Transforms and the variance of their noise.
    band, name
        Lowest and highest frequency wanted [Hz], and what the record is called.

    Raises
    ------
    FitError
        There are too few.
    """
    frequency = window.frequency[window.used]
    block = np.arange(frequency.size) // BLOCK
    count = np.bincount(block)
    out = np.zeros(count.size, dtype=bool)
    for transformed, variance in parts:
        power = np.abs(transformed) ** 2
        floor = np.maximum(variance, EXACT * power.max(axis=0)) + np.finfo(float).tiny
        level = [np.bincount(block, weights=column) / count for column in (power / floor).T]
        out |= (np.array(level) > STANDS_OUT).any(axis=0)
    chosen = out[block]
    if band is not None:
        chosen &= (frequency >= band[0]) & (frequency <= band[1])
    if np.count_nonzero(chosen) < FEWEST:
        raise FitError(
            f"{name}: loads and ground motion stand out of their noise at {np.count_nonzero(chosen)} frequencies of "
            f"the record{'' if band is None else ' in the band'}; at least {FEWEST} are needed: shake harder, over a "
            "wider band, or for longer"
        )
    return chosen
