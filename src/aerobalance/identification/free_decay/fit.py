"""Identification of stiffness and damping from a free decay: least squares on the waveform.

The record is a load that is held, released, and rings down, Eq. (6) of [Gorbushin2020]_. Release instant and duration,
height, offset, drift, hum and further modes are found, not assumed; the part of the record that the model explains is
the window that is used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.free_decay.amplitude_dependence import AmplitudeDependence
from aerobalance.identification.free_decay.decay_doubts import doubts_of, notes_of, possible_modes
from aerobalance.identification.free_decay.event import first_look
from aerobalance.identification.free_decay.law import AmplitudeLaw
from aerobalance.identification.free_decay.ring_fit import fit_ring
from aerobalance.identification.free_decay.waveform import Ring, ring_up_to
from aerobalance.identification.free_decay.window import MOST_LINES, Account, account, decays
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.doubts import Doubt, Size, Verdict, verdict_of
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.recording import Recording


@dataclass(frozen=True, slots=True)
class DecaySettings:
    """Thresholds of the fit of a free decay.

    Attributes
    ----------
    fewest_periods
        Periods of ringing that a decay must show above the noise.
    """

    fewest_periods: float = 2.0


SETTINGS: Final = DecaySettings()
"""Thresholds that are used."""


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
        Load held before the release less the load after [N; N*m].
    window
        First and last instant used, on the recording's clock [s].
    hum
        Frequency [Hz] and amplitude [N; N*m] of every steady line found.
    further_modes
        Frequency [Hz], damping ratio [1] and amplitude over the height [1] of every further decaying line found,
        whether it is part of the dynamics or not.
    amplitude_dependence
        Test of damping and frequency for a dependence on the amplitude; None where the ringing cannot tell.
    amplitude_law
        Damping and frequency at the first amplitude and at the least, where they depend on it; then `dynamics` has
        their mean, and their spread in its covariance.
    force_density
        Two-sided density near the natural frequency of a force that acts all along [N^2/Hz; (N*m)^2/Hz]; None
        where none shows.
    residual_deviation
        Standard deviation of the residuals [N; N*m]; where a force acts of those that it does not explain.
    degrees_of_freedom
        Samples used less parameters.
    residual_time, residuals
        Residuals on the recording's clock, shape (m,) [s] and [N; N*m].
    notes
        What a reader of the result should know, each a sentence.
    doubts
        What the record says against the result; effects are of the damping, over it [1].
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
    amplitude_dependence: AmplitudeDependence | None
    amplitude_law: AmplitudeLaw | None
    force_density: float | None
    residual_deviation: float
    degrees_of_freedom: int
    residual_time: Array
    residuals: Array
    notes: tuple[str, ...]
    doubts: tuple[Doubt, ...]

    def __repr__(self) -> str:
        return f"free decay, {self.verdict}; {self.dynamics!r}"

    @property
    def verdict(self) -> Verdict:
        """Whether the dynamics may be used, by what is doubted."""
        relative = self.dynamics.uncertainty("damping") / self.dynamics.damping
        return verdict_of(self.doubts, {self.dynamics.component: Size(relative, 1.0, 1.0)})


def identify_decay(
    recording: Recording,
    *,
    component: str = "AF",
    mass: float | tuple[float, float],
    modes: int | Literal["auto"] = 1,
) -> DecayFit:
    """Identify the dynamics of one component from a free decay, Eq. (6) of [Gorbushin2020]_.

    Parameters
    ----------
    recording
        Recording of the load; samples before the release, where there are some, tie its height to the ringing.
    component
        The load channel.
    mass
        Moving mass [kg; kg*m for a moment], exact, or with its standard uncertainty.
    modes
        How many modes the dynamics have; ``"auto"``: as many as the record gives evidence of.

    Raises
    ------
    FitError
        No ringing stands out of the noise, or it is too short; or there are fewer modes than asked for, or further
        modes without a clean release, which alone tells their shares.
    """
    if modes != "auto" and not 1 <= modes <= MOST_LINES + 1:
        raise ValueError(f"modes must be auto or a number from 1 to {MOST_LINES + 1}, not {modes}")
    value, uncertainty = mass if isinstance(mass, tuple) else (mass, 0.0)
    if not (0 < value < np.inf and uncertainty >= 0):
        raise ValueError(f"mass must be positive, its uncertainty zero or more: {value}, {uncertainty}")
    channel = recording.channel(component)
    present = _usable(channel, recording.name)
    time = np.arange(recording.samples) / recording.rate
    look = first_look(channel.values, rate=recording.rate, name=f"{recording.name}, {component}")
    ring = fit_ring(time[present], channel.values[present], look)
    found = account(ring, time[present], channel.values[present], onset=look.start)
    ring = found.ring
    _check(ring, recording.name, component)
    kept = _kept_modes(ring, modes, f"{recording.name}, {component}")
    largest = float(np.abs(channel.values[np.isfinite(channel.values)]).max())
    dynamics = replace(_dynamics(ring, component, value, uncertainty, kept=kept), identified_load=largest)
    doubts = doubts_of(found, dynamics, recording, kept=kept)
    notes = [*map(str, doubts), *notes_of(found, recording)]
    for note in notes:
        warn_quality(f"{recording.name}: {note}")
    return _result(found, dynamics, recording, doubts, notes)


def _usable(channel: Channel, name: str) -> NDArray[np.bool_]:
    """True where a reading can be used; says so where some cannot."""
    present = np.isfinite(channel.values)
    saturated = channel.saturated
    if saturated.any():
        warn_quality(
            f"{name}: {int(saturated.sum())} readings of {channel.name} rest on a limit; they are left out of the fit"
        )
    usable = present & ~saturated
    if np.count_nonzero(usable) < 16:
        raise FitError(
            f"{name}: {np.count_nonzero(usable)} usable readings of {channel.name}; a decay needs many more"
        )
    return usable


def _check(ring: Ring, name: str, component: str) -> None:
    """Refuse a ring that carries no dynamics."""
    periods = ring_up_to(ring) * max(ring.frequency, 0.0)  # what is no oscillation is fitted with none
    if periods < SETTINGS.fewest_periods:
        raise FitError(
            f"{name}: {component} rings for {periods:.1f} periods above the noise; at least "
            f"{SETTINGS.fewest_periods:g} are needed: record a larger release, or sample for longer"
        )
    if not decays(ring):
        u_decay = float(np.sqrt(ring.covariance[0, 0]))
        raise FitError(
            f"{name}: the ringing of {component} does not clearly decay ({ring.decay:.3g} 1/s, u = {u_decay:.2g}; "
            f"from {ring.start:.6g} s to {ring.time[-1]:.6g} s of the record{_beside(ring)}): record it for longer, "
            "or it is driven and not released"
        )


def _beside(ring: Ring) -> str:
    """Return what is fitted beside a ringing."""
    lines = ", ".join(f"{line.frequency:.4g}" for line in ring.lines)
    driven = ""
    if ring.force is not None:
        driven = ", beside a force that acts all along, as wind does" if ring.force.acts else ", beside loud noise"
    return driven + (f", beside lines at {lines} Hz" if lines else "")


def _kept_modes(ring: Ring, modes: int | Literal["auto"], name: str) -> list[int]:
    """Places in `Ring.lines` of the further modes that belong to the dynamics, the strongest first."""
    decaying = [place for place, line in enumerate(ring.lines) if line.decay > 0]
    if modes == 1:
        return []
    if decaying and ring.shape == "free":
        raise FitError(
            f"{name}: {len(decaying)} further mode(s), but the ringing is not that of a clean release from rest, "
            "which alone tells what share of a load each mode carries: cut a cable, or ask for one mode"
        )
    sizes = ring.line_sizes()
    decaying.sort(key=lambda place: -sizes[place])
    if modes == "auto":
        return possible_modes(ring, decaying)
    if len(decaying) < modes - 1:
        raise FitError(
            f"{name}: {modes} modes are asked for, and the record shows {1 + len(decaying)} above its noise; a larger "
            "release, or one at another place, may show the others"
        )
    if possible_modes(ring, decaying[: modes - 1]) != decaying[: modes - 1]:
        raise FitError(
            f"{name}: {modes} modes are asked for, but the ringing of one is so strong against the others that its "
            "share would be more than the whole load; ask for fewer modes, or release at another place"
        )
    return decaying[: modes - 1]


def _dynamics(ring: Ring, component: str, mass: float, uncertainty: float, *, kept: list[int]) -> Dynamics:
    """Mass, stiffness and damping, Eqs. (6) and (19) of [Gorbushin2020]_, and modes, with their covariance."""
    waves, slopes = ring.modes()
    decaying = [place for place, line in enumerate(ring.lines) if line.decay > 0]
    rows = [0, *(1 + decaying.index(place) for place in kept)]
    waves, slopes = waves[rows], slopes[rows]
    shares, share_slopes = _shares(waves[:, 2], slopes[:, 2])
    square = np.sum(waves[:, :2] ** 2, axis=1)
    w = np.sqrt(square)
    # what moves the covariance of the waveform's parameters, and the mass, into that of the dynamics
    by_wave = [np.zeros(ring.covariance.shape[0]) for _ in range(4 + 3 * len(kept))]
    by_wave[1] = 2 * mass * (waves[0, 0] * slopes[0, 0] + waves[0, 1] * slopes[0, 1])
    by_wave[2] = 2 * mass * slopes[0, 0]
    further = []
    for number in range(1, len(waves)):
        decay, wd = waves[number, :2]
        w_slope = (decay * slopes[number, 0] + wd * slopes[number, 1]) / w[number]
        further.append(Mode(w[number] / (2 * np.pi), decay / w[number], shares[number]))
        place = 1 + 3 * number
        by_wave[place] = w_slope / (2 * np.pi)
        by_wave[place + 1] = slopes[number, 0] / w[number] - decay / square[number] * w_slope
        by_wave[place + 2] = share_slopes[number]
    J = np.array(by_wave)
    covariance = J @ ring.covariance @ J.T
    by_mass = np.zeros(len(by_wave))
    by_mass[:3] = 1.0, square[0], 2 * waves[0, 0]
    covariance += uncertainty**2 * np.outer(by_mass, by_mass)
    return Dynamics(
        component,
        mass,
        mass * float(square[0]),
        2 * mass * float(waves[0, 0]),
        covariance=(covariance + covariance.T) / 2,
        further_modes=tuple(further),
    )


def _shares(heights: Array, slopes: Array) -> tuple[Array, Array]:
    """Each height over their sum, shape (m,), and its derivatives (m, p)."""
    total = float(heights.sum())
    shares = heights / total
    return shares, (slopes - shares[:, None] * slopes.sum(axis=0)) / total


def _result(
    found: Account,
    dynamics: Dynamics,
    recording: Recording,
    doubts: list[Doubt],
    notes: list[str],
) -> DecayFit:
    ring = found.ring
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
        amplitude_dependence=found.dependence,
        amplitude_law=found.law,
        force_density=ring.force.density if ring.force is not None and ring.force.acts else None,
        residual_deviation=float(np.sqrt(ring.variance)),
        degrees_of_freedom=ring.degrees_of_freedom,
        residual_time=recording.start + ring.time,
        residuals=ring.residuals,
        notes=tuple(notes),
        doubts=tuple(doubts),
    )
