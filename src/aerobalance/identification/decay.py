"""Identification of stiffness and damping from a free decay: least squares on the waveform.

The record is a load that is held, released, and rings down, Eq. (6) of [Gorbushin2020]_. Release instant and duration,
height, offset, drift, hum and further modes are found, not assumed; the part of the record that the model explains is
the window that is used.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from aerobalance.dynamics import Dynamics
from aerobalance.identification.onset import first_look
from aerobalance.identification.ring import (
    EVIDENCE,
    HEAVIEST,
    Ring,
    fit_ring,
    freed,
    leftover_line,
    ring_up_to,
)
from aerobalance.noise import channel_noise
from aerobalance.problems import DoubtWarning, FitError
from aerobalance.recording import Array, Channel, Recording

FEWEST_PERIODS: Final = 2.0
"""Periods of ringing that a decay must show above the noise."""

DOUBTFUL_DAMPING: Final = 0.1
"""Relative standard uncertainty of the damping above which it is called hardly identifiable."""

BLOCK_PROBABILITY: Final = 1e-6
"""Probability under the noise below which a block of residuals shows that something else happened."""

MOST_LINES: Final = 6
"""Lines of hum and further modes that are taken up at most."""


@dataclass(frozen=True, slots=True, eq=False)
class DecayFit:
    """What a free decay tells about one component.

    Attributes
    ----------
    dynamics
        Mass (as given), stiffness and damping with their covariance.
    damped_frequency, damped_frequency_uncertainty
        Frequency of the ringing [Hz].
    decay_rate, decay_rate_uncertainty
        Decay rate b / 2M [1/s].
    release
        Instant of the release on the recording's clock [s], and its standard uncertainty; None where the record does
        not hold it or the ring is not that of a clean release.
    release_duration
        Time over which the load was released [s].
    height
        Load held before the release less the load after [N].
    window
        First and last instant used, on the recording's clock [s].
    hum
        Frequency [Hz] and amplitude [N] of every steady line found.
    further_modes
        Frequency [Hz], damping ratio [1] and share of the height [1] of every further decaying line found.
    residual_deviation
        Standard deviation of the residuals [N].
    degrees_of_freedom
        Samples used less parameters.
    residual_time, residuals
        Residuals on the recording's clock, shape (m,) [s] and [N].
    notes
        What a reader of the result should know, each a sentence.
    """

    dynamics: Dynamics
    damped_frequency: float
    damped_frequency_uncertainty: float
    decay_rate: float
    decay_rate_uncertainty: float
    release: tuple[float, float] | None
    release_duration: float
    height: float
    window: tuple[float, float]
    hum: tuple[tuple[float, float], ...]
    further_modes: tuple[tuple[float, float, float], ...]
    residual_deviation: float
    degrees_of_freedom: int
    residual_time: Array
    residuals: Array
    notes: tuple[str, ...]


def identify_decay(recording: Recording, *, component: str = "AF", mass: float | tuple[float, float]) -> DecayFit:
    """Identify the dynamics of one component from a free decay, Eq. (6) of [Gorbushin2020]_.

    Parameters
    ----------
    recording
        Recording of the load; samples before the release, where there are some, tie its height to the ringing.
    component
        The load channel.
    mass
        Moving mass [kg; kg*m for a moment], exact, or with its standard uncertainty.

    Raises
    ------
    FitError
        No ringing stands out of the noise, or it is too short.
    """
    value, uncertainty = mass if isinstance(mass, tuple) else (mass, 0.0)
    if not (0 < value < np.inf and uncertainty >= 0):
        raise ValueError(f"mass must be positive, its uncertainty zero or more: {value}, {uncertainty}")
    channel = recording.channel(component)
    present = _usable(channel, recording.name)
    time = np.arange(recording.samples) / recording.rate
    look = first_look(channel.values, rate=recording.rate, name=f"{recording.name}, {component}")
    ring = fit_ring(time[present], channel.values[present], look)
    ring = freed(_shortened(_complete(_shortened(ring))))
    _check(ring, recording.name, component)
    dynamics = _dynamics(ring, component, value, uncertainty)
    notes = _notes(ring, dynamics, recording)
    for note in notes:
        warnings.warn(f"{recording.name}: {note}", DoubtWarning, stacklevel=2)
    return _result(ring, dynamics, recording, notes)


def _usable(channel: Channel, name: str) -> NDArray[np.bool_]:
    """True where a reading can be used; says so where some cannot."""
    present = np.isfinite(channel.values)
    saturated = channel.saturated
    if saturated.any():
        warnings.warn(
            f"{name}: {int(saturated.sum())} readings of {channel.name} rest on a limit; they are left out of the fit",
            DoubtWarning,
            stacklevel=3,
        )
    usable = present & ~saturated
    if np.count_nonzero(usable) < 16:
        raise FitError(
            f"{name}: {np.count_nonzero(usable)} usable readings of {channel.name}; a decay needs many more"
        )
    return usable


def _complete(ring: Ring) -> Ring:
    """Take up the lines that the residuals still show, one at a time."""
    for _ in range(MOST_LINES):
        line = leftover_line(ring)
        if line is None:
            break
        larger = fit_ring(ring.time, ring.values, ring, lines=(*ring.lines, line))
        odd = any(not 0 <= fitted.decay < HEAVIEST * 2 * np.pi * fitted.frequency for fitted in larger.lines)
        if odd or larger.squares > ring.squares - EVIDENCE * ring.variance:
            break
        ring = larger
    return ring


def _shortened(ring: Ring) -> Ring:
    """Cut the record where something else happens before or after the ringing.

    Blocks of residuals that do not fit count only behind two that do: a misfit that begins at the release itself is
    the model's, and its lines are looked for instead.
    """
    length = max(64, round(3 * ring.rate / ring.frequency))
    count = ring.time.size // length
    if count < 6 or ring.variance < (1e-9 * ring.amplitude) ** 2:
        return ring
    blocks = np.array_split(ring.residuals, count)
    sizes = np.array([block.size for block in blocks])
    squares = np.array([block @ block for block in blocks])
    strange = np.asarray(chi2.sf(squares / float(np.median(squares / sizes)), sizes)) < BLOCK_PROBABILITY
    edges = np.concatenate(([0], np.cumsum(sizes)))
    home = min(int(np.searchsorted(edges, np.searchsorted(ring.time, ring.start), side="right")) - 1, count - 1)
    last = edges[home + 1 + _first_event(strange[home + 1 :])]
    first = edges[home - _first_event(strange[:home][::-1])]
    if first == 0 and last == ring.time.size:
        return ring
    part = slice(int(first), int(last))
    # lines found with the cut parts may be theirs: look for lines afresh
    return _complete(fit_ring(ring.time[part], ring.values[part], ring))


def _first_event(strange: NDArray[np.bool_]) -> int:
    """Place of the first strange block behind two that are not, or the number of blocks."""
    for place in range(2, strange.size):
        if strange[place] and not strange[place - 2 : place].any():
            return place
    return strange.size


def _check(ring: Ring, name: str, component: str) -> None:
    """Refuse a ring that carries no dynamics."""
    periods = ring_up_to(ring) * ring.frequency
    if periods < FEWEST_PERIODS:
        raise FitError(
            f"{name}: {component} rings for {periods:.1f} periods above the noise; at least {FEWEST_PERIODS:g} are "
            "needed: record a larger release, or sample for longer"
        )
    doubt = float(np.sqrt(ring.covariance[0, 0]))
    if not ring.decay > 2 * doubt:
        raise FitError(
            f"{name}: the ringing of {component} does not clearly decay ({ring.decay:.3g} 1/s, u = {doubt:.2g}): "
            "record it for longer, or it is driven and not released"
        )


def _dynamics(ring: Ring, component: str, mass: float, uncertainty: float) -> Dynamics:
    """Mass, stiffness and damping, Eqs. (6) and (19) of [Gorbushin2020]_, from decay rate and damped frequency."""
    a, wd = ring.decay, 2 * np.pi * ring.frequency
    square = wd**2 + a**2
    slopes = np.array(  # of mass, stiffness, damping by mass, decay rate, damped angular frequency
        [[1.0, 0.0, 0.0], [square, 2 * mass * a, 2 * mass * wd], [2 * a, 2 * mass, 0.0]]
    )
    inner = np.zeros((3, 3))
    inner[0, 0] = uncertainty**2
    inner[1:, 1:] = ring.covariance[:2, :2]
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = slopes @ inner @ slopes.T
    return Dynamics(component, mass, mass * square, 2 * mass * a, covariance=(covariance + covariance.T) / 2)


def _notes(ring: Ring, dynamics: Dynamics, recording: Recording) -> list[str]:
    notes = []
    for line, size in zip(ring.lines, ring.line_sizes(), strict=True):
        if line.decay > 0:
            notes.append(
                f"a further mode at {line.frequency:.4g} Hz, {100 * size / ring.amplitude:.2g} % of the first, rings "
                "in the record; it is fitted beside the first one but is not part of the dynamics, so forces near "
                "that frequency will be wrong"
            )
    doubt = dynamics.uncertainty("damping") / dynamics.damping
    if doubt > DOUBTFUL_DAMPING:
        notes.append(
            f"the damping is hardly identifiable (u = {100 * doubt:.0f} %); forces at the natural frequency "
            "carry that much"
        )
    if ring.colour > 2:
        notes.append(
            f"the residuals near {ring.frequency:.4g} Hz are {ring.colour:.1f} times as strong as white noise; the "
            "uncertainties are enlarged accordingly"
        )
    if ring.shape == "free" and ring.start > 0:
        notes.append(
            "the ringing is not that of a clean release from rest; its amplitude and phase are fitted freely, from "
            f"{recording.start + ring.start:.6g} s on"
        )
    if "ground_acceleration" in recording:
        ground = recording.channel("ground_acceleration")
        after = ground.values[int(np.ceil(ring.start * recording.rate)) :]
        after = after[np.isfinite(after)]
        moving = np.sqrt(max(float(np.var(after)) - 1.25 * channel_noise(ground) ** 2, 0.0)) if after.size else 0.0
        if dynamics.mass * moving > 0.02 * abs(ring.amplitude):
            notes.append(
                f"the ground end moves after the release ({moving:.2g} m/s^2 rms, a load of "
                f"{dynamics.mass * moving:.3g} N); the fit takes it at rest, so stiffness and damping are those of "
                "balance and support together"
            )
    return notes


def _result(ring: Ring, dynamics: Dynamics, recording: Recording, notes: list[str]) -> DecayFit:
    u = np.sqrt(np.diag(ring.covariance))
    hum, modes = [], []
    for line, size in zip(ring.lines, ring.line_sizes(), strict=True):
        if line.decay > 0:
            rate = float(np.hypot(line.decay, 2 * np.pi * line.frequency))
            modes.append((line.frequency, line.decay / rate, size / (abs(ring.height) or np.inf)))
        else:
            hum.append((line.frequency, size))
    return DecayFit(
        dynamics=dynamics,
        damped_frequency=ring.frequency,
        damped_frequency_uncertainty=float(u[1]) / (2 * np.pi),
        decay_rate=ring.decay,
        decay_rate_uncertainty=float(u[0]),
        release=None if ring.shape == "free" else (recording.start + ring.start, float(u[2])),
        release_duration=ring.duration,
        height=ring.height,
        window=(recording.start + float(ring.time[0]), recording.start + float(ring.time[-1])),
        hum=tuple(hum),
        further_modes=tuple(modes),
        residual_deviation=float(np.sqrt(ring.variance)),
        degrees_of_freedom=ring.degrees_of_freedom,
        residual_time=recording.start + ring.time,
        residuals=ring.residuals,
        notes=tuple(notes),
    )
