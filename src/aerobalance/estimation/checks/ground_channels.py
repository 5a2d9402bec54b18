"""Whether the channels of the ground's motion are late, early, or read too much, by what the load shows of the motion.

The ground's motion and the weight at a changing attitude are taken off the readings of the load. Where a channel was
late or had another gain, a part of it is left: the load felt under its rate of change, or under itself. Both are
known shapes, and the force is a process that was learned; generalised least squares finds how much of each is in the
readings, and whether the delay grows along the record, as it does where two clocks are not one. A force that goes with
the motion, as that of the flow on a model that swings does, looks the same, which is said.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.fft import next_fast_len

from aerobalance.estimation.error_sources import Contribution, Systematic
from aerobalance.estimation.force_smoother import SmootherResult, instant_columns
from aerobalance.estimation.independent_record import SingleRecord
from aerobalance.estimation.prior import fit_prior, generalised_least_squares, whitened
from aerobalance.estimation.record import Through
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.motion.platform import SystematicParameter
from aerobalance.motion.single_axis import GroundMotion
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import acceleration_name, si_unit
from aerobalance.recording.doubts import DOUBTED, Doubt
from aerobalance.recording.errors import FitError, argument
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.resampling import fractional_delay, interpolate_gaps_linearly


@dataclass(frozen=True, slots=True)
class GroundChannelSettings:
    """Thresholds of the comparison of ground channels with the load.

    Attributes
    ----------
    sure
        Standard uncertainties that a delay or a gain has to be off: once in 2000 by chance.
    beside
        Error of the force from a gain over that from a delay, and the other way, from which both are told: the one is
        else what the other does to second order.
    clock
        Change of a delay along the record over the delay, from which it is told: a delay makes less to second order.
    matters
        Error of the force from it over the uncertainty of the force (both rms) from which it is told.
    worth_a_look
        Chi-square of delay, gain and drift (three degrees of freedom) from which the force's spectrum is learned again
        without them: once in a hundred by chance.
    bands, stands_out
        Bands of a channel's spectrum, and its level over that of its noise from which a band is motion: where the
        force has no power, a shape is compared with the noise of the load alone, and its own noise counts against it.
    probe
        Delay by which slopes are taken [samples], and change of the gain [1].
    most
        Delay that an alignment takes off at once [samples].
    settled
        What is left of delay and gain over their standard uncertainties, from which on an alignment is at its end.
    rounds
        Most times that delay and gain are looked for.
    reach
        Largest delay that is tried, over the length of the record.
    apart, beyond_slopes
        Part of a period of the motion (its rms frequency), and so many of them from which on slopes do not tell a
        delay any more.
    promising, decisive
        Gain in log-likelihood of a delay of these from which on the force's spectrum is learned again without it, and
        that it must have then.
    """

    sure: float = 3.5
    beside: float = 0.5
    clock: float = 0.2
    matters: float = 0.3
    worth_a_look: float = 11.3
    bands: int = 100
    stands_out: float = 30.0
    probe: float = 0.02
    most: float = 64.0
    settled: float = 0.1
    rounds: int = 5
    reach: float = 0.125
    apart: float = 0.05
    beyond_slopes: float = 2.0
    promising: float = 3.0
    decisive: float = 12.0


SETTINGS: Final = GroundChannelSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What the load says of a channel.

    Attributes
    ----------
    channel
        The channel.
    delay, u_delay
        Time by which it is late and its standard uncertainty [s].
    gain, u_gain
        What its gain has to be changed by, relative, and its standard uncertainty [1].
    drift, u_drift
        Change of the delay along the record and its standard uncertainty [s].
    errors
        Error of the force from the delay, from the gain, and from the delay with its drift, shape (n, 3) [N].
    """

    channel: str
    delay: float
    u_delay: float
    gain: float
    u_gain: float
    drift: float
    u_drift: float
    errors: Array


ALIGNED: Final = "alignment of "
"""How the name of what is not known of an alignment begins, before the channel."""


@dataclass(frozen=True, slots=True)
class Alignment:
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

    def after(self, earlier: Alignment) -> Alignment:
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


def ground_doubts(
    record: SingleRecord, fit: SmootherResult, through: Through, *, errors: Sequence[Contribution]
) -> Iterator[tuple[Doubt, Systematic]]:
    """Yield doubts of the channels of the ground's motion, each with the error that the force has from it.

    Parameters
    ----------
    record
        The component with its record.
    fit
        Its force by the smoother.
    through
        What the smoother makes of readings.
    errors
        What its uncertainty consists of so far.
    """
    for name in driving_channels(record):
        found = _compared(record, fit, through, record.recording.channel(name))
        if found is not None:
            uncertainty = float(np.sqrt(np.sum([np.mean(error.deviation**2) for error in errors])))
            yield from _doubts(record, found, uncertainty=uncertainty)


def driving_channels(record: SingleRecord) -> tuple[str, ...]:
    """Return the channels of the ground's motion and attitude that a component's force is worked out with."""
    names = (acceleration_name("ground", record.dynamics.component), "ground_acceleration")
    accelerometer = next(((name,) for name in names if name in record.recording), ())
    return (*accelerometer, "pitch") if "pitch" in record.recording else accelerometer


def _compared(record: SingleRecord, fit: SmootherResult, through: Through, channel: Channel) -> _Found | None:
    """What the load says of a channel, and what that does to the force; None where it does not show the motion."""
    measured = _measured(record, fit, channel)
    if measured is None:
        return None
    far = _far(record, fit, channel.name, measured, through)
    if far is not None:
        return far
    sizes, u = measured.sizes, np.sqrt(np.diag(measured.covariance))
    moved = through(measured.felt) * sizes
    errors = np.column_stack([moved[:, 0], moved[:, 1], moved[:, 0] + moved[:, 2]])
    delay, gain, drift = (np.array([-1.0, 1.0, -1.0]) * sizes).tolist()
    return _Found(channel.name, delay, float(u[0]), gain, float(u[1]), drift, float(u[2]), errors)


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """What readings of the load have of a channel's rate, of itself, and of its rate growing along the record.

    Attributes
    ----------
    sizes, covariance
        How much of each, shape (3,), and its covariance, shape (3, 3): less the delay [s], the gain [1], less the
        change of the delay [s].
    slopes
        The specific force that a unit of each makes, shape (n, 3).
    felt
        The load felt under it, shape (n, 3) [N].
    """

    sizes: Array
    covariance: Array
    slopes: Array
    felt: Array


def _far(record: SingleRecord, fit: SmootherResult, name: str, measured: _Measured, through: Through) -> _Found | None:
    """What the load says of a channel that is later than slopes tell; None where it is not.

    What the channel should have read is what it read, moved in time and of another size: of many delays that one is
    taken which leaves least of the reading.
    """
    h, reading = record.interval, fit.reading
    motion = measured.slopes[:, 1]
    pace = float(np.std(np.diff(motion))) / (2 * np.pi * h * float(np.std(motion)))
    apart = SETTINGS.apart / pace

    def felt(delay: float) -> Array:
        moved = fractional_delay(motion, delay=-delay, interval=h)
        return np.asarray(record.felt_under(SystematicParameter("", "", moved, 0.0)))

    # what is white stays so when it is moved: one pass of the filter tells all delays
    known = instant_columns(reading, fit.steps, heights=[step.height for step in fit.steps])[0]
    white = whitened(fit.filter, reading.filled + felt(0.0), np.column_stack([known, felt(0.0)]))
    basis, _ = np.linalg.qr(white[:, 1:-1])
    shown, expected = (white[:, place] - basis @ (basis.T @ white[:, place]) for place in (0, -1))
    most = int(SETTINGS.reach * motion.size)
    length = next_fast_len(2 * motion.size, real=True)
    both = np.fft.irfft(np.fft.rfft(expected, length) * np.conj(np.fft.rfft(shown, length)), length)
    told = np.concatenate([both[-most:], both[: most + 1]]) ** 2 / float(expected @ expected)
    best = h * float(np.argmax(told) - most)
    gained = float(np.max(told) - told[most]) / 2
    if abs(best) <= SETTINGS.beyond_slopes * apart or gained < SETTINGS.promising:
        return None
    size = SETTINGS.probe * h
    slope = (felt(best + size) - felt(best - size)) / (2 * size)
    shapes = np.column_stack([known, felt(best), slope])
    learned = fit_prior(reading, columns=np.column_stack([shapes, felt(0.0)]), before=fit.learned)
    filter_ = KalmanFilter.of(reading.system(learned), reading.present)
    sizes, covariance, left = generalised_least_squares(filter_, reading.filled + felt(0.0), shapes)
    as_it_is = generalised_least_squares(filter_, reading.filled, known)[2]
    gain, moved = sizes[-2:]
    if gain <= 0 or as_it_is - left < 2 * SETTINGS.decisive:
        return None  # of the other sign, slopes tell it
    delay = best + float(np.clip(moved / gain, -apart, apart))
    u_gain, u_moved = np.sqrt(np.diag(covariance)[-2:])
    errors = -through(np.column_stack([felt(delay) - felt(0.0), (gain - 1) * felt(delay)]))
    columns = np.column_stack([errors, errors[:, 0]])
    return _Found(name, delay, float(u_moved / gain), float(gain - 1), float(u_gain), 0.0, 1.0, columns)


def _measured(record: SingleRecord, fit: SmootherResult, channel: Channel) -> _Measured | None:
    """Delay, gain and drift of a channel by what the load shows; None where it does not show the motion."""
    values = interpolate_gaps_linearly(channel.values)
    if not np.isfinite(values).all() or float(np.ptp(values)) == 0:
        return None
    # noise of the channel is no motion: taken along, it would make every gain and delay too small
    motion = _above_noise(values - values.mean(), noise=channel_noise(channel))
    late = values + fractional_delay(motion, delay=SETTINGS.probe * record.interval, interval=record.interval) - motion
    larger = values + SETTINGS.probe * motion
    try:
        slopes = [
            _moved(record, channel, changed) / size
            for changed, size in ((late, SETTINGS.probe * record.interval), (larger, SETTINGS.probe))
        ]
    except FitError:
        return None
    if not all(slope.any() for slope in slopes):
        return None
    count = record.recording.samples
    slopes.append(slopes[0] * (np.arange(count) / max(count - 1, 1) - 0.5))
    # what is left in the readings where the channel is so late or reads so much less
    felt = np.column_stack([record.felt_under(SystematicParameter("", "", slope, 0.0)) for slope in slopes])
    reading, heights = fit.reading, [step.height for step in fit.steps]
    known = instant_columns(reading, fit.steps, heights=heights)[0]
    shapes = np.column_stack([known, felt])
    sizes, covariance, _ = generalised_least_squares(fit.filter, reading.filled, shapes)
    own = slice(-felt.shape[1], None)
    if float(sizes[own] @ np.linalg.pinv(covariance[own, own]) @ sizes[own]) > SETTINGS.worth_a_look:
        # what was learned took what is left of the motion for force: with it taken out the force is less
        learned = fit_prior(reading, columns=shapes, before=fit.learned)
        filter_ = KalmanFilter.of(reading.system(learned), reading.present)
        sizes, covariance, _ = generalised_least_squares(filter_, reading.filled, shapes)
    return _Measured(sizes[own], covariance[own, own], np.column_stack(slopes), felt)


def _above_noise(values: Array, *, noise: float) -> Array:
    """A channel at the frequencies where it stands out of its white noise, shape (n,)."""
    count = values.size
    line = np.linspace(values[0], values[-1], count)
    # reflected at points, its rate goes on at the ends: what a bend there does, the load would have to show as well
    reflected = np.concatenate([values - line, (line - values)[::-1]])
    lines = np.fft.rfft(reflected)
    power = np.abs(lines) ** 2 / (2 * count)
    edges = np.unique(np.round(np.geomspace(1, power.size, SETTINGS.bands)).astype(int))
    level = np.add.reduceat(power, edges[:-1]) / np.diff(edges)
    kept = np.zeros(power.size)
    kept[edges[0] : edges[-1]] = np.repeat(level > SETTINGS.stands_out * noise**2, np.diff(edges))
    return np.asarray(line + np.fft.irfft(lines * kept, 2 * count)[:count])


def _moved(record: SingleRecord, channel: Channel, values: Array) -> Array:
    """Change of the ground's specific force when a channel reads other values, shape (n,) [m/s^2]."""
    recording, component = record.recording, record.dynamics.component
    plain = replace(channel, values=interpolate_gaps_linearly(channel.values), noise=0.0)
    channels = dict(recording.channels)
    specific = []
    for one in (plain, replace(plain, values=values)):
        other = replace(recording, channels={**channels, channel.name: one})
        specific.append(GroundMotion.of(other, component).specific_force)
    return np.asarray(specific[1] - specific[0])


def _doubts(record: SingleRecord, found: _Found, *, uncertainty: float) -> Iterator[tuple[Doubt, Systematic]]:
    component = record.dynamics.component
    unit, name = si_unit(component), found.channel
    kind = "attitude" if name == "pitch" else "ground"
    cause = f"or a force that goes with {name}, as that of the flow may"
    effects = np.sqrt(np.mean(found.errors**2, axis=0))
    late = abs(found.delay) > SETTINGS.sure * found.u_delay
    drifts = abs(found.drift) > max(SETTINGS.sure * found.u_drift, SETTINGS.clock * abs(found.delay))
    by_delay = float(effects[2 if drifts else 0]) if late or drifts else 0.0
    by_gain = float(effects[1]) if abs(found.gain) > SETTINGS.sure * found.u_gain else 0.0
    least = max(SETTINGS.matters * uncertainty, SETTINGS.beside * max(by_delay, by_gain))
    if by_delay > least:
        word = "late" if found.delay > 0 else "early"
        text = (
            f"{name} is {1e3 * abs(found.delay):.3g} ms {word} (u = {1e3 * found.u_delay:.2g} ms) against what "
            f"{component} shows of it: a filter or a delay that is not declared, {cause}"
        )
        taken_off = f"{argument('align')} takes off what the load shows"
        advice = f"declare the delay or the filter of {name} in the channel map; {taken_off}"
        if drifts:
            text = (
                f"the delay of {name} against what {component} shows of it changes by {1e3 * found.drift:.3g} ms "
                f"along the record (u = {1e3 * found.u_drift:.2g} ms): their clocks are not one, {cause}"
            )
            advice = f"record {name} by the clock of the balance"
        what = "clock" if drifts and kind == "ground" else "delay"
        yield _with_error(f"{kind} {what}", component, (text, advice), found, place=2 if drifts else 0, unit=unit)
    if by_gain > least:
        text = (
            f"{component} shows {1 + found.gain:.4g} times (u = {found.u_gain:.2g}) what {name} reads: another gain, "
            f"unit or sign of {name} or another mass than that of the dynamics, {cause}"
        )
        advice = f"check sensitivity, unit and sign of {name}, and the mass"
        yield _with_error(f"{kind} gain", component, (text, advice), found, place=1, unit=unit)


def _with_error(
    kind: str, component: str, words: tuple[str, str], found: _Found, *, place: int, unit: str
) -> tuple[Doubt, Systematic]:
    error = found.errors[:, place]
    effect = float(np.sqrt(np.mean(error**2)))
    doubt = Doubt(kind, component, *words, effect, unit)
    name = f"{DOUBTED}{kind}"
    return doubt, Systematic(name, found.channel, (name,), error[:, None], np.eye(1), local=True)


def with_channel_aligned(
    record: SingleRecord, fit: SmootherResult, name: str
) -> tuple[SingleRecord, Alignment] | None:
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
    channel = record.recording.channel(name)
    measured = _measured(record, fit, channel)
    if measured is None:
        return None
    delay, gain = -float(measured.sizes[0]), float(measured.sizes[1])
    delay = float(np.clip(delay, -SETTINGS.most * record.interval, SETTINGS.most * record.interval))
    values = interpolate_gaps_linearly(channel.values)
    swing = fractional_delay(values - values.mean(), delay=-delay, interval=record.interval)
    values = values.mean() + (1 + gain) * swing
    change = _moved(record, channel, values)
    moved = replace(channel, values=np.where(channel.missing, np.nan, values))
    recording = replace(record.recording, channels={**record.recording.channels, name: moved})
    level, turned = np.linalg.eigh(measured.covariance[:2, :2])
    left = measured.slopes[:, :2] @ (turned * np.sqrt(np.maximum(level, 0.0)))
    unknowns = [
        *(item for item in record.motion.unknowns if item.name != f"{ALIGNED}{name}"),
        *(SystematicParameter(f"{ALIGNED}{name}", name, slope, 1.0, local=True) for slope in left.T),
    ]
    motion = replace(record.motion, specific_force=record.motion.specific_force + change, unknowns=tuple(unknowns))
    u_delay, u_gain = np.sqrt(np.diag(measured.covariance)[:2]).tolist()
    return replace(record, recording=recording, motion=motion), Alignment(name, delay, u_delay, gain, u_gain)
