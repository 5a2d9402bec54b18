"""Identification of stiffness and damping from a free decay: least squares on the waveform.

The record is a load that is held, released, and rings down, Eq. (6) of [Gorbushin2020]_. Release instant and duration,
height, offset, drift, hum and further modes are found, not assumed; the part of the record that the model explains is
the window that is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.free_decay.amplitude_dependence import (
    AmplitudeDependence,
    amplitude_dependence,
    bent_where_plain,
)
from aerobalance.identification.free_decay.event import first_look
from aerobalance.identification.free_decay.residual_lines import residual_line
from aerobalance.identification.free_decay.waveform import (
    EVIDENCE,
    HEAVIEST,
    Ring,
    fit_ring,
    freed,
    ring_up_to,
)
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import FitError, argument, warn_quality
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording
from aerobalance.recording.wording import NOT_TOLD, damping_text


@dataclass(frozen=True, slots=True)
class DecaySettings:
    """Thresholds of the fit of a free decay.

    Attributes
    ----------
    fewest_periods
        Periods of ringing that a decay must show above the noise.
    most_change
        Change of frequency or damping with the amplitude, over their mean, beyond which neither falls in proportion.
    doubtful_damping
        Relative standard uncertainty of the damping above which it is called hardly identifiable.
    block_probability
        Probability under the noise below which a block of residuals shows that something else happened.
    most_lines
        Lines of hum and further modes that are taken up at most.
    """

    fewest_periods: float = 2.0
    most_change: float = 2.0
    doubtful_damping: float = 0.1
    block_probability: float = 1e-6
    most_lines: int = 6


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
        Load held before the release less the load after [N].
    window
        First and last instant used, on the recording's clock [s].
    hum
        Frequency [Hz] and amplitude [N] of every steady line found.
    further_modes
        Frequency [Hz], damping ratio [1] and amplitude over the height [1] of every further decaying line found,
        whether it is part of the dynamics or not.
    amplitude_dependence
        Test of damping and frequency for a dependence on the amplitude; None where the ringing cannot tell.
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
    amplitude_dependence: AmplitudeDependence | None
    residual_deviation: float
    degrees_of_freedom: int
    residual_time: Array
    residuals: Array
    notes: tuple[str, ...]


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
    if modes != "auto" and not 1 <= modes <= SETTINGS.most_lines + 1:
        raise ValueError(f"modes must be auto or a number from 1 to {SETTINGS.most_lines + 1}, not {modes}")
    value, uncertainty = mass if isinstance(mass, tuple) else (mass, 0.0)
    if not (0 < value < np.inf and uncertainty >= 0):
        raise ValueError(f"mass must be positive, its uncertainty zero or more: {value}, {uncertainty}")
    channel = recording.channel(component)
    present = _usable(channel, recording.name)
    time = np.arange(recording.samples) / recording.rate
    look = first_look(channel.values, rate=recording.rate, name=f"{recording.name}, {component}")
    ring = fit_ring(time[present], channel.values[present], look)
    first, bent = bent_where_plain(ring)
    ring = freed(_widened(_shortened(_complete(_shortened(first))), first))
    dependence, ring = amplitude_dependence(ring, bent=bent if ring is first and not ring.bent else None)
    _check(ring, recording.name, component)
    kept = _kept_modes(ring, modes, f"{recording.name}, {component}")
    dynamics = _dynamics(ring, component, value, uncertainty, kept=kept)
    notes = [*_notes(ring, dynamics, recording, kept=kept), *_amplitude_notes(dependence, component)]
    for note in notes:
        warn_quality(f"{recording.name}: {note}")
    return _result(ring, dynamics, recording, dependence, notes)


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


def _complete(ring: Ring) -> Ring:
    """Take up the lines that the residuals still show, one at a time."""
    for _ in range(SETTINGS.most_lines):
        line = residual_line(ring)
        if line is None:
            break
        larger = fit_ring(ring.time, ring.values, ring, lines=(*ring.lines, line))
        width = 5 * larger.decay / (2 * np.pi)
        odd = any(fitted.decay > 0 and abs(fitted.frequency - larger.frequency) < width for fitted in larger.lines)
        odd |= any(not 0 <= fitted.decay < HEAVIEST * 2 * np.pi * fitted.frequency for fitted in larger.lines)
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
    unlikely = np.asarray(chdtrc(sizes, squares / float(np.median(squares / sizes)))) < SETTINGS.block_probability
    edges = np.concatenate(([0], np.cumsum(sizes)))
    home = min(int(np.searchsorted(edges, np.searchsorted(ring.time, ring.start), side="right")) - 1, count - 1)
    last = edges[home + 1 + _first_event(unlikely[home + 1 :])]
    first = edges[home - _first_event(unlikely[:home][::-1])]
    if first == 0 and last == ring.time.size:
        return ring
    part = slice(int(first), int(last))
    # lines found with the cut parts may be theirs: look for lines afresh
    return _complete(fit_ring(ring.time[part], ring.values[part], ring))


def _widened(ring: Ring, whole: Ring) -> Ring:
    """The fit over more of the record, where the lines found since explain what had been cut off."""
    if ring.time.size == whole.time.size or not ring.lines:
        return ring
    wider = _shortened(fit_ring(whole.time, whole.values, ring, lines=ring.lines))
    return wider if wider.time.size > ring.time.size and len(wider.lines) == len(ring.lines) else ring


def _first_event(unlikely: NDArray[np.bool_]) -> int:
    """Place of the first unlikely block behind two that are not, or the number of blocks."""
    for place in range(2, unlikely.size):
        if unlikely[place] and not unlikely[place - 2 : place].any():
            return place
    return unlikely.size


def _check(ring: Ring, name: str, component: str) -> None:
    """Refuse a ring that carries no dynamics."""
    periods = ring_up_to(ring) * ring.frequency
    if periods < SETTINGS.fewest_periods:
        raise FitError(
            f"{name}: {component} rings for {periods:.1f} periods above the noise; at least "
            f"{SETTINGS.fewest_periods:g} are needed: record a larger release, or sample for longer"
        )
    u_decay = float(np.sqrt(ring.covariance[0, 0]))
    if not ring.decay > 2 * u_decay:
        raise FitError(
            f"{name}: the ringing of {component} does not clearly decay ({ring.decay:.3g} 1/s, u = {u_decay:.2g}): "
            "record it for longer, or it is driven and not released"
        )


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
        return _possible_modes(ring, decaying)
    if len(decaying) < modes - 1:
        raise FitError(
            f"{name}: {modes} modes are asked for, and the record shows {1 + len(decaying)} above its noise; a larger "
            "release, or one at another place, may show the others"
        )
    if _possible_modes(ring, decaying[: modes - 1]) != decaying[: modes - 1]:
        raise FitError(
            f"{name}: {modes} modes are asked for, but the ringing of one is so strong against the others that its "
            "share would be more than the whole load; ask for fewer modes, or release at another place"
        )
    return decaying[: modes - 1]


def _possible_modes(ring: Ring, places: list[int]) -> list[int]:
    """Those of some places in `Ring.lines` whose share of a load is less than the whole."""
    decaying = [place for place, line in enumerate(ring.lines) if line.decay > 0]
    heights = ring.modes()[0][:, 2]
    kept = list(places)
    while kept:
        own = heights[[1 + decaying.index(place) for place in kept]]
        if np.abs(own).max() < abs(heights[0] + own.sum()):
            break
        kept.pop(int(np.argmax(np.abs(own))))
    return kept


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


def _notes(ring: Ring, dynamics: Dynamics, recording: Recording, *, kept: list[int]) -> list[str]:
    notes = []
    for place, (line, size) in enumerate(zip(ring.lines, ring.line_sizes(), strict=True)):
        if line.decay > 0 and place not in kept:
            notes.append(
                f"a further mode at {line.frequency:.4g} Hz, {_beside_the_first(size, ring)}, rings "
                "in the record; it is fitted beside the first one but is not part of the dynamics, so forces near "
                f"that frequency will be wrong ({_way_to_take_it_up(ring, place)})"
            )
    u = dynamics.uncertainty("damping")
    if u > SETTINGS.doubtful_damping * dynamics.damping:
        critical = 2 * dynamics.mass * 2 * np.pi * dynamics.natural_frequency
        notes.append(
            f"the damping is hardly identifiable ({damping_text(dynamics.damping, u, critical=critical)}); forces at "
            "the natural frequency carry that much"
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


def _beside_the_first(size: float, ring: Ring) -> str:
    """Return how strongly a further mode rings beside the first."""
    part = size / ring.amplitude if ring.amplitude else np.inf
    return f"{100 * part:.2g} % of the first" if part <= 1 else "as strong as the first or stronger"


def _way_to_take_it_up(ring: Ring, place: int) -> str:
    """Return which record or option makes a further mode part of the dynamics."""
    if ring.shape == "free":
        return f"a record of a clean release from rest tells its share of a load, with {argument('modes', 'auto')}"
    if place in _possible_modes(ring, [place]):
        return f"{argument('modes', 'auto')} takes it up"
    return f"its share of a load {NOT_TOLD}: release at another place, or record for longer"


def _amplitude_notes(dependence: AmplitudeDependence | None, component: str) -> list[str]:
    notes = []
    if dependence is not None and dependence.damping_depends:
        notes.append(
            f"the damping of {component} depends on the amplitude: "
            f"{_change(dependence.damping, dependence.u_damping)} from the smallest to the largest, as friction does; "
            "the damping found is a mean, and forces at the natural frequency are wrong by as much elsewhere"
        )
    if dependence is not None and dependence.frequency_depends:
        notes.append(
            f"the frequency of {component} depends on the amplitude: "
            f"{_change(dependence.frequency, dependence.u_frequency)} from the smallest to the largest: the spring is "
            "not linear; the stiffness found is a mean"
        )
    return notes


def _change(part: float, u: float) -> str:
    """Return a relative change in words; more than twice of what changes is more than a linear change can be."""
    return f"{100 * part:+.2g} % (u = {100 * u:.1g} %)" if abs(part) <= SETTINGS.most_change else "by more than itself"


def _result(
    ring: Ring,
    dynamics: Dynamics,
    recording: Recording,
    dependence: AmplitudeDependence | None,
    notes: list[str],
) -> DecayFit:
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
        amplitude_dependence=dependence,
        residual_deviation=float(np.sqrt(ring.variance)),
        degrees_of_freedom=ring.degrees_of_freedom,
        residual_time=recording.start + ring.time,
        residuals=ring.residuals,
        notes=tuple(notes),
    )
