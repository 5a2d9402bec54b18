"""What the ground end does: the load that its acceleration and the pull of gravity put on the moving mass."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from aerobalance.dynamics.driven_modes import DrivenModes
from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import (
    AXES,
    FORCE_ROWS,
    STANDARD_GRAVITY,
    acceleration_name,
    driving_axis,
)
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.gravity import Gravity
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps_linearly
from aerobalance.recording.sensors import corrected, divided, high_pass

AT_REST: Final = 1.25
"""Variance of an acceleration over that of its own noise, below which the ground end is at rest."""

CHANCE: Final = 1e-6
"""Probability with which the noise of an accelerometer may pass for a tone."""


@dataclass(frozen=True, slots=True, eq=False)
class SystematicParameter:
    """A number behind the ground's motion that holds along the record and is not known exactly.

    Attributes
    ----------
    name
        What it is.
    source
        Channel, or setting, that it comes from.
    slope
        Change of the specific force with it, of its shape [m/s^2 per its unit; rad/s^2 in turns].
    uncertainty
        Its standard uncertainty.
    """

    name: str
    source: str
    slope: Array
    uncertainty: float


@dataclass(frozen=True, slots=True, eq=False)
class GroundMotion:
    """Specific force of the ground end along a component, x1'' less gravity, on the recording's clock.

    Attributes
    ----------
    specific_force
        x1'' - g sin(theta) for the axial force, shape (n,) [m/s^2].
    noise
        Standard uncertainty of one of its samples, white [m/s^2].
    acceleration
        The part that is measured acceleration, shape (n,) [m/s^2]; its gain may be wrong.
    relative_uncertainty
        Standard uncertainty of that gain, relative [1].
    delay
        Time by which its channel lags the clock [s].
    assumptions
        What had to be taken as zero because the recording does not have it.
    unknowns
        What holds along the record and is not known exactly: gain and zero of the accelerometer and of the angles,
        and gravity; the last two less what they do in the zero of the loads.
    gravity_on_zero
        Gravity at the zero of the recording's loads, along the component [m/s^2].
    """

    specific_force: Array
    noise: float
    acceleration: Array
    relative_uncertainty: float
    delay: float
    assumptions: tuple[str, ...]
    unknowns: tuple[SystematicParameter, ...] = ()
    gravity_on_zero: float = 0.0

    @classmethod
    def of(
        cls,
        recording: Recording,
        component: str,
        *,
        gravity: float = STANDARD_GRAVITY,
        gravity_uncertainty: float = 0.0,
    ) -> GroundMotion:
        """Take the ground's motion from a recording's acceleration, pitch and roll channels.

        Parameters
        ----------
        recording
            What was recorded.
        component
            The component that is driven.
        gravity, gravity_uncertainty
            Local acceleration of gravity and its standard uncertainty [m/s^2].
        """
        recording = corrected(recording)
        name = acceleration_name("ground", component)
        if name not in recording and "ground_acceleration" in recording:
            name = "ground_acceleration"
        acceleration = np.zeros(recording.samples)
        noise = relative = delay = 0.0
        coupling = "kinematic"
        assumptions = []
        unknowns: list[SystematicParameter] = []
        if name in recording:
            channel = recording.channel(name)
            acceleration = without_gaps(channel)
            noise, relative, delay = channel_noise(channel), channel.relative_uncertainty, channel.delay
            coupling = channel.coupling
            if coupling == "kinematic" and float(np.nanvar(channel.values)) < AT_REST * noise**2:
                # adding a sensor's noise to the force would only spoil it; tones that stand out of it are motion
                acceleration, share = tones(np.where(channel.missing, np.nan, channel.values))
                noise *= share
                rest = "only its tones are taken" if share else "the ground end is taken to be at rest"
                assumptions.append(f"{name} shows {'little' if share else 'nothing'} beyond its noise; {rest}")
            if coupling == "ac":
                acceleration = divided(acceleration, high_pass(channel.corner), rate=recording.rate)
            one = np.ones(recording.samples)
            unknowns += [
                SystematicParameter("accelerometer gain", name, acceleration, relative),
                SystematicParameter("accelerometer zero", name, one, channel.zero_uncertainty),
                *_across(recording, channel),
            ]
            if coupling == "ac":
                warn_quality(
                    f"{name} is ac-coupled: ground motion below its corner of {channel.corner:g} Hz is not in the "
                    "channel and stays in the force"
                )
        else:
            assumptions.append(f"{name} is not recorded and taken as zero")
        along = _GravityAlong(np.zeros(recording.samples), 0.0, {})
        if coupling != "dc":
            along = _gravity(recording, component, gravity, assumptions)
        unknowns += _of_gravity(recording, component, along, gravity=gravity, gravity_uncertainty=gravity_uncertainty)
        return cls(
            specific_force=acceleration - along.acceleration,
            noise=float(np.hypot(noise, along.noise)),
            acceleration=acceleration,
            relative_uncertainty=relative,
            delay=delay,
            assumptions=tuple(assumptions),
            unknowns=tuple(item for item in unknowns if item.uncertainty > 0 and item.slope.any()),
            gravity_on_zero=float(recording.gravity_on_zero.acceleration[_column(component)]),
        )

    def moved(self, changes: Array) -> GroundMotion:
        """The motion if the `unknowns` were off by so much, shape (number of unknowns,)."""
        change = sum((item.slope * by for item, by in zip(self.unknowns, changes, strict=True)), np.zeros(1))
        return replace(self, specific_force=self.specific_force + change)

    def force(self, mass: float) -> Array:
        """Force on the moving mass in the frame of the ground end, M g sin(theta) - M x1'', shape (n,) [N]."""
        return -mass * self.specific_force


def tones(acceleration: Array) -> tuple[Array, float]:
    """Tones that stand out of the white noise of a record, and the share of the noise's rms that comes with them.

    Parameters
    ----------
    acceleration
        Readings, shape (n,); NaN where missing. A line across a gap would be a slow motion that is not there.
    """
    spectrum = np.fft.rfft(np.nan_to_num(acceleration - np.nanmean(acceleration)))
    power = np.abs(spectrum) ** 2
    # ordinates of white noise are exponentially distributed: this one is passed by the largest of n with p = CHANCE
    out = power > np.median(power) / np.log(2) * np.log(max(power.size, 1) / CHANCE)
    if not out.any():
        return np.zeros_like(acceleration), 0.0
    # a tone between two ordinates leaks into its neighbours; eight on either side hold 97 % of its amplitude
    kept = np.convolve(out, np.ones(17), "same") > 0
    return np.fft.irfft(np.where(kept, spectrum, 0), acceleration.size), float(np.sqrt(np.mean(kept)))


class _GravityAlong(NamedTuple):
    """Gravity along a component, shape (n,), its white noise, and its change with zero and gain of the angles."""

    acceleration: Array
    noise: float
    changes: dict[str, Array]


def _gravity(recording: Recording, component: str, gravity: float, assumptions: list[str]) -> _GravityAlong:
    nothing = np.zeros(recording.samples)
    if "pitch" not in recording:
        assumptions.append("pitch is not recorded and taken as zero")
        return _GravityAlong(nothing, 0.0, {})
    channels = {name: recording.channel(name) for name in ("pitch", "roll") if name in recording}
    angles = {name: without_gaps(channel) for name, channel in channels.items()}
    pitch, roll = angles["pitch"], angles.get("roll", nothing)
    noise = gravity * channel_noise(channels["pitch"])
    if component != "SF":
        noise *= float(np.mean(np.abs(np.sin(pitch) if component == "NF" else np.cos(pitch))))
    pull, column = Gravity.of(pitch, roll, gravity=gravity), _column(component)
    changes = {f"{name} zero": pull.slopes[name][:, column] for name in channels}
    changes |= {f"{name} gain": pull.slopes[name][:, column] * angles[name] for name in channels}
    return _GravityAlong(pull.acceleration[:, column], noise, changes)


def _of_gravity(
    recording: Recording, component: str, along: _GravityAlong, *, gravity: float, gravity_uncertainty: float
) -> Iterator[SystematicParameter]:
    """What is not known of the angles and of gravity: what it does in the run, less that in the zero of the loads."""
    nothing, zero, column = np.zeros(recording.samples), recording.gravity_on_zero, _column(component)
    for name in ("pitch", "roll"):
        if name not in recording:
            continue
        channel = recording.channel(name)
        for word, uncertainty in (("zero", channel.zero_uncertainty), ("gain", channel.relative_uncertainty)):
            what = f"{name} {word}"
            slope = zero.slope(what)[column] - along.changes.get(what, nothing)
            yield SystematicParameter(what, name, slope, uncertainty)
    slope = (zero.acceleration[column] - along.acceleration) / gravity
    yield SystematicParameter("gravity", "gravity", slope, gravity_uncertainty)


def _column(component: str) -> int:
    """Column of the pull that drives a component."""
    return FORCE_ROWS[AXES.index(driving_axis(component))]


def _across(recording: Recording, channel: Channel) -> list[SystematicParameter]:
    """Cross-axis sensitivities of an accelerometer, whose values have been taken off."""
    return [
        SystematicParameter(
            f"cross-axis sensitivity to {part.channel}",
            channel.name,
            -np.nan_to_num(recording.channel(part.channel).values),
            part.uncertainty,
        )
        for part in channel.cross_axis
        if part.uncertainty > 0
    ]


def without_gaps(channel: Channel) -> Array:
    """Return the values of a channel with straight lines across gaps, shape (n,) [its unit], and warn of them."""
    missing = channel.missing
    if not missing.any():
        return channel.values
    warn_quality(
        f"{channel.name}: {int(missing.sum())} missing sample(s) are filled by straight lines; the ground motion "
        "within them stays in the force"
    )
    return interpolate_gaps_linearly(channel.values)


def load_from_ground(motion: GroundMotion, dynamics: Dynamics, *, rate: float, load_delay: float = 0.0) -> Array:
    """Load that the ground's motion alone makes the balance feel, at the load's sampling instants, shape (n,) [N].

    Between samples the motion is band-limited (`aerobalance.dynamics.driven_modes`); the delay between the channels
    need not be whole samples.

    Parameters
    ----------
    motion
        What the ground end does.
    dynamics
        The balance; its delay is the lag of the load behind the acceleration.
    rate
        Sampling rate [Hz].
    load_delay
        Time by which the load channel lags the clock [s].
    """
    net = motion.force(dynamics.mass)
    if not net.any():
        return np.zeros_like(net)
    shares = np.array([[mode.share, mode.rate_share] for mode in dynamics.modes]).T
    lag = dynamics.delay + load_delay - motion.delay
    modes = DrivenModes(dynamics.modes, interval=1 / rate, delays=(lag,))
    return np.asarray(net[0] + modes.whole((net - net[0])[:, None, None] * shares).sum(axis=1))
