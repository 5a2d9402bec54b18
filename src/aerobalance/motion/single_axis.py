"""What the ground end does along one component: the load that its acceleration and gravity put on the moving mass."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.driven_modes import DrivenModes
from aerobalance.dynamics.single import Dynamics
from aerobalance.motion.platform import PlatformMotion, SystematicParameter, driven_column, unread_beside
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.recording import Recording


@dataclass(frozen=True, slots=True, eq=False)
class GroundMotion:
    """Specific force of the ground end along a component, x1'' less gravity, on the recording's clock.

    Attributes
    ----------
    specific_force
        x1'' - g sin(theta) for the axial force, shape (n,) [m/s^2].
    noise
        Standard uncertainty of one of its samples, white [m/s^2].
    delay
        Time by which its channel lags the clock [s].
    assumptions
        What had to be taken as zero because the recording does not have it.
    unknowns
        What holds along the record and is not known exactly: gain and zero of the accelerometer and of the angles,
        and gravity; the last two less what they do in the zero of the loads; slopes have shape (n,).
    gravity_on_zero
        Gravity at the zero of the recording's loads, along the component [m/s^2].
    delays
        Times by which its sensor, and the angles that move, lag the clock [s].
    """

    specific_force: Array
    noise: float = 0.0
    delay: float = 0.0
    assumptions: tuple[str, ...] = ()
    unknowns: tuple[SystematicParameter, ...] = ()
    gravity_on_zero: float = 0.0
    delays: tuple[float, ...] = ()

    @classmethod
    def of(
        cls,
        recording: Recording,
        component: str,
        *,
        gravity: float = STANDARD_GRAVITY,
        gravity_uncertainty: float = 0.0,
    ) -> GroundMotion:
        """Take the motion along a component from a recording: the part along it of `PlatformMotion`.

        Parameters
        ----------
        recording
            What was recorded.
        component
            The component that is driven. Its accelerometer is the one of its axis, or else ``ground_acceleration``.
        gravity, gravity_uncertainty
            Local acceleration of gravity and its standard uncertainty [m/s^2].

        Raises
        ------
        FitError
            The accelerometer has no reading.
        """
        settings = {"gravity": gravity, "gravity_uncertainty": gravity_uncertainty}
        whole, column = PlatformMotion.of(recording, along=component, **settings), driven_column(component)
        unknowns = [replace(item, slope=item.slope[:, column]) for item in whole.unknowns]
        return cls(
            specific_force=whole.specific_force[:, column],
            noise=float(np.sqrt(max(whole.covariance[column, column], 0.0))),
            delay=whole.delay,
            assumptions=whole.assumptions,
            unknowns=tuple(item for item in unknowns if item.slope.any()),
            gravity_on_zero=float(whole.gravity_on_zero[column]),
            delays=whole.delays,
        )

    def moved(self, changes: Array) -> GroundMotion:
        """The motion if the `unknowns` were off by so much, shape (number of unknowns,)."""
        change = sum((item.slope * by for item, by in zip(self.unknowns, changes, strict=True)), np.zeros(1))
        return replace(self, specific_force=self.specific_force + change)

    def force(self, mass: float) -> Array:
        """Force on the moving mass in the frame of the ground end, M g sin(theta) - M x1'', shape (n,) [N]."""
        return -mass * self.specific_force

    def unread_at(self, delay: float, *, interval: float) -> NDArray[np.bool_]:
        """As for `PlatformMotion`."""
        return unread_beside(self.specific_force, self.delays, delay=delay, interval=interval)


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
