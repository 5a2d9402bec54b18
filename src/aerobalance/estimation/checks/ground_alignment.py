"""Channels of the ground's motion, brought to the delay and the gain that the load shows, on request."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.estimation.checks.ground_channels import measured
from aerobalance.estimation.checks.ground_witnesses import SETTINGS, Witness, Witnesses
from aerobalance.estimation.force_smoother import SmootherResult
from aerobalance.estimation.independent_record import SingleRecord
from aerobalance.motion.platform import SystematicParameter
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.resampling import fractional_delay, interpolate_gaps_linearly

ALIGNED: Final = "alignment of "
"""How the name of what is not known of an alignment begins, before the channel."""


@dataclass(frozen=True, slots=True)
class ChannelAlignment:
    """How a channel was brought to what the load shows.

    Attributes
    ----------
    channel
        The channel.
    delay, u_delay
        Time by which it was late and its standard uncertainty [s].
    gain, u_gain
        What its gain was changed by, relative, and its standard uncertainty [1].
    """

    channel: str
    delay: float
    u_delay: float
    gain: float
    u_gain: float

    def after(self, earlier: ChannelAlignment) -> ChannelAlignment:
        """Both, one after the other."""
        gain = (1 + earlier.gain) * (1 + self.gain) - 1
        return replace(self, delay=earlier.delay + self.delay, gain=gain)

    @property
    def settled(self) -> bool:
        """Whether it is less than what is not known of it."""
        share = SETTINGS.settled
        return abs(self.delay) < share * self.u_delay and abs(self.gain) < share * self.u_gain

    def doubt(self, component: str) -> Doubt:
        """What is to be said of it; the force is mended."""
        late = "late" if self.delay > 0 else "early"
        text = (
            f"{self.channel} was {1e3 * abs(self.delay):.3g} ms {late} (u = {1e3 * self.u_delay:.2g} ms) against what "
            f"{component} shows of it, and {component} shows {1 + self.gain:.4g} times (u = {self.u_gain:.2g}) what "
            "it reads: both are taken into account, as asked"
        )
        kind = f"{'attitude' if self.channel == 'pitch' else 'ground'} delay"
        return Doubt(kind, component, text, f"declare the delay of {self.channel}", 0.0, si_unit(component))

    @property
    def clear(self) -> bool:
        """Whether it is more than chance."""
        return abs(self.delay) > SETTINGS.sure * self.u_delay or abs(self.gain) > SETTINGS.sure * self.u_gain


def alone(record: SingleRecord, fit: SmootherResult) -> Witnesses:
    """Return a component that is not coupled with others, as the one that is asked.

    Parameters
    ----------
    record
        The component with its record.
    fit
        Its force.
    """
    return Witnesses(record.recording, (Witness(record, fit),), record.dynamics.component)


def with_channel_aligned(
    record: SingleRecord, fit: SmootherResult, name: str
) -> tuple[SingleRecord, ChannelAlignment] | None:
    """Return the record with one channel at the delay and of the gain that the load shows, and what these are.

    To first order in both, from where the channel is: to be repeated until nothing changes.

    Parameters
    ----------
    record
        The component with its record.
    fit
        Its force.
    name
        The channel.
    """
    channel, asked = record.recording.channel(name), alone(record, fit)
    told = measured(asked, name)
    if told is None:
        return None
    shapes, found = told
    delay, gain = -float(found.sizes[0]), float(found.sizes[1])
    delay = float(np.clip(delay, -SETTINGS.most * record.interval, SETTINGS.most * record.interval))
    plain = interpolate_gaps_linearly(channel.values)
    swing = fractional_delay(plain - plain.mean(), delay=-delay, interval=record.interval)
    values = plain.mean() + (1 + gain) * swing
    change = asked.change(name, values - plain)
    moved = replace(channel, values=np.where(channel.missing, np.nan, values))
    recording = replace(record.recording, channels={**record.recording.channels, name: moved})
    level, turned = np.linalg.eigh(found.covariance[:2, :2])
    left = np.column_stack(shapes.slopes[:2]) @ (turned * np.sqrt(np.maximum(level, 0.0)))
    unknowns = [
        *(item for item in record.motion.unknowns if item.name != f"{ALIGNED}{name}"),
        *(SystematicParameter(f"{ALIGNED}{name}", name, slope, 1.0, local=True) for slope in left.T),
    ]
    motion = replace(record.motion, specific_force=record.motion.specific_force + change, unknowns=tuple(unknowns))
    u_delay, u_gain = found.u[:2].tolist()
    return replace(record, recording=recording, motion=motion), ChannelAlignment(name, delay, u_delay, gain, u_gain)
