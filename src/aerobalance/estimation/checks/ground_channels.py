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

from aerobalance.estimation.error_sources import Contribution, Systematic
from aerobalance.estimation.force_smoother import SmootherResult, instant_columns
from aerobalance.estimation.prior import fit_prior, generalised_least_squares
from aerobalance.estimation.record import SingleRecord, Through
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.motion.platform import SystematicParameter
from aerobalance.motion.single_axis import GroundMotion
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import acceleration_name, si_unit
from aerobalance.recording.doubts import DOUBTED, Doubt
from aerobalance.recording.errors import FitError
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.resampling import fractional_delay, interpolate_gaps_linearly


@dataclass(frozen=True, slots=True)
class GroundChannelSettings:
    """Thresholds of the comparison of ground channels with the load.

    Attributes
    ----------
    sure
        Standard uncertainties that a delay or a gain has to be off: once in 16 000 by chance.
    beside
        Error of the force from a gain over that from a delay, and the other way, from which both are told: the one is
        else what the other does to second order.
    matters
        Error of the force from it over the uncertainty of the force (both rms) from which it is told.
    worth_a_look
        Chi-square of delay, gain and drift (three degrees of freedom) from which the force's spectrum is learned again
        without them: once in a hundred by chance.
    bands, stands_out
        Bands of a channel's spectrum, and its level over that of its noise from which a band is motion.
    probe
        Delay by which slopes are taken [samples], and change of the gain [1].
    """

    sure: float = 4.0
    beside: float = 0.5
    matters: float = 0.3
    worth_a_look: float = 11.3
    bands: int = 100
    stands_out: float = 4.0
    probe: float = 0.02


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
    names = (acceleration_name("ground", record.dynamics.component), "ground_acceleration", "pitch")
    for name in dict.fromkeys(names):
        if name not in record.recording:
            continue
        found = _compared(record, fit, through, record.recording.channel(name))
        if found is not None:
            uncertainty = float(np.sqrt(np.sum([np.mean(error.deviation**2) for error in errors])))
            yield from _doubts(record, found, uncertainty=uncertainty)


def _compared(record: SingleRecord, fit: SmootherResult, through: Through, channel: Channel) -> _Found | None:
    """What the load says of a channel; None where it does not show the motion."""
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
    delay, gain, drift = np.array([-1.0, 1.0, -1.0]) * sizes[-3:]
    u_delay, u_gain, u_drift = np.sqrt(np.diag(covariance)[-3:])
    moved = through(felt) * sizes[-3:]
    errors = np.column_stack([moved[:, 0], moved[:, 1], moved[:, 0] + moved[:, 2]])
    return _Found(
        channel.name,
        float(delay),
        float(u_delay),
        float(gain),
        float(u_gain),
        float(drift),
        float(u_drift),
        errors,
    )


def _above_noise(values: Array, *, noise: float) -> Array:
    """A channel at the frequencies where it stands out of its white noise, shape (n,)."""
    count = values.size
    mirrored = np.concatenate([values, values[::-1]])  # its ends meet
    lines = np.fft.rfft(mirrored)
    power = np.abs(lines) ** 2 / (2 * count)
    edges = np.unique(np.round(np.geomspace(1, power.size, SETTINGS.bands)).astype(int))
    level = np.add.reduceat(power, edges[:-1]) / np.diff(edges)
    kept = np.zeros(power.size)
    kept[edges[0] : edges[-1]] = np.repeat(level > SETTINGS.stands_out * noise**2, np.diff(edges))
    return np.asarray(np.fft.irfft(lines * kept, 2 * count)[:count])


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
    drifts = abs(found.drift) > SETTINGS.sure * found.u_drift
    by_delay = float(effects[2 if drifts else 0]) if late or drifts else 0.0
    by_gain = float(effects[1]) if abs(found.gain) > SETTINGS.sure * found.u_gain else 0.0
    least = max(SETTINGS.matters * uncertainty, SETTINGS.beside * max(by_delay, by_gain))
    if by_delay > least:
        word = "late" if found.delay > 0 else "early"
        text = (
            f"{name} is {1e3 * abs(found.delay):.3g} ms {word} (u = {1e3 * found.u_delay:.2g} ms) against what "
            f"{component} shows of it: a filter or a delay that is not declared, {cause}"
        )
        advice = f"declare the delay or the filter of {name} in the channel map"
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
