"""What taps tell about a balance, and what is doubtful about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.coupled.result import CoupledResult
from aerobalance.identification.impact.response import PointResponse
from aerobalance.identification.rigid_body import RigidMassFit
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Doubt, Size, Verdict, verdict_of

ALL = "all"
"""Component of a doubt about coupled components together."""


@dataclass(frozen=True, slots=True, eq=False)
class TapFound:
    """What was found of one tap.

    Attributes
    ----------
    name
        The recording and the instant.
    instant
        Instant of the largest force on the recording's clock [s].
    point
        Number of its point, from 0.
    peak, impulse
        Largest force [N], and its integral over time [N*s], as the channel reads them.
    duration
        Time of the contact, margins included [s].
    bandwidth
        Frequency at which the spectrum of the force is down by 20 dB [Hz]; faster modes are hardly excited.
    used
        ``"force and ringing"``, ``"ringing"`` or ``"nothing"``.
    shares
        Amplitude of every mode after the contact over the sum of all, shape (modes,); NaN where it is not used.
    """

    name: str
    instant: float
    point: int
    peak: float
    impulse: float
    duration: float
    bandwidth: float
    used: str
    shares: Array


@dataclass(frozen=True, slots=True, eq=False)
class Taps:
    """What was found of all taps, beside the dynamics.

    Attributes
    ----------
    taps
        All of them, those left out too.
    points
        Where they were given, in words.
    gain
        Force as the static calibration of the balance has it over the reading of its channel, and its standard
        uncertainty [1]; None where no force was used.
    delay
        Time by which the force lags the loads beyond the delays that the channels state, and its standard uncertainty
        [s]; None where no force was used.
    corner
        Corner of the high-pass that was undone in the force's channel [Hz]; zero for none.
    responses
        Response functions by point, with their coherence.
    residual_deviation
        Standard deviation of the residuals, shape (n,) [N, N*m].
    reduced_chi2
        Their variance over that of the noise as given or judged, shape (n,).
    degrees_of_freedom
        Readings used less parameters.
    doubts
        What the recordings say against the result; effects are of the damping, over it [1].
    """

    taps: tuple[TapFound, ...]
    points: tuple[str, ...]
    gain: tuple[float, float] | None
    delay: tuple[float, float] | None
    corner: float
    responses: tuple[PointResponse, ...]
    residual_deviation: Array
    reduced_chi2: Array
    degrees_of_freedom: int
    doubts: tuple[Doubt, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ImpactFit:
    """What taps tell about one component.

    Attributes
    ----------
    dynamics
        Mass (as given), stiffness and damping with their covariance.
    taps
        What was found of the taps.
    notes
        What a reader of the result should know, each a sentence.
    """

    dynamics: Dynamics
    taps: Taps
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"taps, {self.verdict}; {self.dynamics!r}"

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What the recordings say against the result."""
        return self.taps.doubts

    @property
    def verdict(self) -> Verdict:
        """Whether the dynamics may be used, by what is doubted."""
        damping = self.dynamics.damping
        relative = self.dynamics.uncertainty("damping") / damping if damping else np.inf
        return verdict_of(self.doubts, {self.dynamics.component: Size(relative, 1.0, 1.0)})


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ImpactIdentification(CoupledResult):
    """What taps tell about coupled components.

    Attributes
    ----------
    taps
        What was found of the taps.
    rigid
        The rigid mass behind A, and its tests; None where no mass was given or none was found.
    """

    taps: Taps
    rigid: RigidMassFit | None

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What the recordings say against the result."""
        return self.taps.doubts

    @property
    def verdict(self) -> Verdict:
        """Whether the dynamics may be used, by what is doubted."""
        ratios = np.array([mode.damping_ratio for mode in self.modes])
        relative = float(np.max(self.u_damping_ratio / ratios))
        return verdict_of(self.doubts, {ALL: Size(relative, 1.0, 1.0)})
