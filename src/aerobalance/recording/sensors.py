"""What a sensor does to its quantity is undone: anti-alias filter, high-pass corner, cross-axis sensitivity.

A filter is undone by its transfer function, phase and magnitude. Noise that enters after the filter is magnified by as
much as the signal, and beyond the corner there is little else: so the magnitude is made up for in full only where the
filter leaves enough of it, and where it leaves less than the square of that not at all; the phase is right everywhere.
Enough is a half for a motion. A load is divided by the balance's response afterwards, so that noise raised beyond
resonance would pass for force (doubled around 250 Hz it made 7 N of 0.5 N on a balance of 66 Hz): there it is 0.9.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import Array, Channel, unit_inside
from aerobalance.recording.errors import FitError, check_recording
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import fractional_delay, interpolate_gaps_linearly

LEAST_GAIN: Final = 0.5
"""Gain down to which a motion's magnitude is undone in full; from its square on it is left as it is."""

LEAST_LOAD_GAIN: Final = 0.9
"""The same for loads and gauge outputs."""

Transfer = Callable[[Array], NDArray[np.complex128]]


def corrected(recording: Recording) -> Recording:
    """Undo the filters and the cross-axis sensitivities that the channels of a recording state.

    What is returned states no filter and no sensitivity any more, so that nothing is undone twice; the uncertainty of
    a sensitivity stays with its channel. Missing samples stay missing, and so do those next to them that the filter
    has mixed with them.

    Parameters
    ----------
    recording
        Readings, as the channels say they were taken.

    Raises
    ------
    FitError
        A channel is sensitive to another one that is not recorded, or has no reading.
    """
    check_recording(recording)
    channels = {name: _unfiltered(channel, recording) for name, channel in recording.channels.items()}
    straight = {name: _straightened(channel, channels, recording) for name, channel in channels.items()}
    if all(straight[name] is channel for name, channel in recording.channels.items()):
        return recording
    declared = recording.declared | {name for name, one in recording.channels.items() if one.filter is not None}
    undone = {name: one.filter for name, one in recording.channels.items() if one.filter and not _is_motion(name)}
    return replace(recording, channels=straight, declared=declared, low_passed={**recording.low_passed, **undone})


def _unfiltered(channel: Channel, recording: Recording) -> Channel:
    if channel.filter is None:
        return channel
    known, rate = ~channel.missing, recording.rate
    if not known.any():
        if not recording.extent.is_whole:  # it lies in a gap
            return replace(channel, filter=None)
        raise FitError(f"channel {channel.name} has no reading, so its filter cannot be undone")
    filled = interpolate_gaps_linearly(channel.values)
    least = LEAST_GAIN if _is_motion(channel.name) else LEAST_LOAD_GAIN
    values = divided(filled, channel.filter.response, rate=rate, least=least)
    # within a period of the corner the filter's memory has faded to a few percent
    near = min(int(np.ceil(rate / channel.filter.corner)), (known.size - 1) // 2)
    if not known.all():
        values[np.convolve(~known, np.ones(2 * near + 1), "same") > 0.5] = np.nan
    return replace(channel, values=values, filter=None)


def _is_motion(name: str) -> bool:
    return unit_inside(name) in ("m/s^2", "rad/s^2", "rad/s", "rad")


def _straightened(channel: Channel, channels: dict[str, Channel], recording: Recording) -> Channel:
    """Take off what a sensor reads of accelerations across its axis."""
    felt = [part for part in channel.cross_axis if part.sensitivity]
    lacking = [part.channel for part in channel.cross_axis if part.channel not in channels]
    if lacking:
        raise FitError(
            f"{recording.name}: {channel.name} is sensitive to {', '.join(lacking)}, which is not recorded; "
            "record it, or give the sensitivity no entry"
        )
    if not felt:
        return channel
    values = channel.values.copy()
    for part in felt:
        other = channels[part.channel]
        lag = channel.delay - other.delay
        if not np.isfinite(other.values).any():
            continue
        across = interpolate_gaps_linearly(other.values)
        if lag:
            across = fractional_delay(across, delay=lag, interval=1 / recording.rate)
        values -= part.sensitivity * across
    left = tuple(replace(part, sensitivity=0.0) for part in channel.cross_axis)
    return replace(channel, values=values, cross_axis=left)


def divided(values: Array, transfer: Transfer, *, rate: float, least: float = LEAST_GAIN) -> Array:
    """Divide a record by a transfer function: its phase everywhere, its magnitude where that is `least` or more.

    The record is continued at its ends by odd reflection, which fades to one level.

    Parameters
    ----------
    values
        Readings without gaps, shape (n,).
    transfer
        Reading over signal at frequencies [Hz], real at zero.
    rate
        Sampling rate [Hz].
    least
        Gain down to which the magnitude is undone.
    """

    def undone(spectrum: NDArray[np.complex128], frequency: Array) -> NDArray[np.complex128]:
        response = transfer(frequency)
        size = np.abs(response)
        turn = np.divide(np.conj(response), size, out=np.ones_like(response), where=size > 0)
        return spectrum * turn * _raised(size, least)

    return _changed(values, undone, rate)


def _raised(size: Array, least: float) -> Array:
    """Factor by which a gain of some size is made up for."""
    return np.maximum(np.minimum(1 / np.maximum(size, least), size / least**2), 1.0)


def load_gain_left(low_pass: AntiAlias, frequency: Array) -> Array:
    """Gain that a load has at frequencies [Hz] after its filter has been undone, 1 where in full."""
    size = np.abs(low_pass.response(frequency))
    return np.asarray(size * _raised(size, LEAST_LOAD_GAIN))


def late_samples(low_pass: AntiAlias, rate: float) -> int:
    """Samples at the end of a load whose filter has been undone that hang on readings which come after the record.

    The response of a low-pass to a short blow lies about its delay, and has come after twice that.
    """
    slow = low_pass.corner / 100
    late = -float(np.angle(low_pass.response(slow))) / (2 * np.pi * slow)
    return int(np.ceil(2 * late * rate))


def undone_with(recording: Recording) -> int:
    """Samples on either side of one that its filters are undone with; 0 where no channel states a filter.

    A piece of a record whose filters are undone is off by what lies beyond its ends as far as that, so it is read
    wider by as many and cut afterwards. What is left then is that the factor which makes up for the magnitude has
    kinks beside the corner, for which the response falls with the square of time alone: less than a ten-thousandth of
    changes that are slow beside the corner, and some thousandths of what a signal has there.
    """
    decays = [one.filter.decay for one in recording if one.filter is not None]
    # The phase of H is undone by conj(H) / |H| = sqrt(H(-s) / H(s)) at s = i w: all of its branch points lie at the
    # poles of H and at their mirror images, so its response falls as exp(-a |t|) before and after the blow, a the
    # distance of the nearest one from the imaginary axis. It has fallen to the rounding e of numbers at ln(1 / e) / a.
    memory = -float(np.log(np.finfo(np.float64).eps)) / min(decays) if decays else 0.0
    return int(np.ceil(memory * recording.rate))


def filtered(values: Array, gain: Transfer, *, rate: float, level_over: int = 1) -> Array:
    """Multiply the spectrum of a record by a gain, the record continued at its ends as in `divided`.

    Parameters
    ----------
    values
        Readings without gaps, shape (n,).
    gain
        Factor at frequencies [Hz], real at zero.
    rate
        Sampling rate [Hz].
    level_over
        Samples at either end through which a straight line gives the level that the record is reflected at. For a low
        pass of noisy readings: the noise of one sample would else be a step of twice its size at the end.
    """
    return _changed(values, lambda spectrum, frequency: np.asarray(spectrum * gain(frequency)), rate, level_over)


def _changed(
    values: Array,
    change: Callable[[NDArray[np.complex128], Array], NDArray[np.complex128]],
    rate: float,
    level_over: int = 1,
) -> Array:
    """Change the spectrum of a record that is continued at its ends."""
    reach = _reach(values.size)
    padded = np.pad(values, reach, mode="reflect", reflect_type="odd")
    if level_over > 2:
        padded[:reach] += 2 * (_level(values[:level_over]) - values[0])
        padded[-reach:] += 2 * (_level(values[: -level_over - 1 : -1]) - values[-1])
    # a jump from the end round to the start would ring along the whole record, as the phase is cut at half the rate
    fade = np.ones(padded.size)
    outer = max(reach // 2, 1)
    fade[:outer] = (1 - np.cos(np.pi * np.arange(outer) / outer)) / 2
    fade[-outer:] = fade[:outer][::-1]
    middle = (values[0] + values[-1]) / 2
    padded = middle + fade * (padded - middle)
    frequency = np.asarray(np.fft.rfftfreq(padded.size, 1 / rate), dtype=np.float64)
    spectrum = change(np.fft.rfft(padded), frequency)
    return np.fft.irfft(spectrum, padded.size)[reach : reach + values.size]


def _reach(count: int) -> int:
    """Samples that a record of so many is continued by at either end: a quarter, or some more for a fast transform."""
    least = min(count - 1, max(256, count // 4))
    whole = next_fast_len(count + 2 * least, real=True)
    while (whole - count) % 2:
        whole = next_fast_len(whole + 1, real=True)
    reach = (whole - count) // 2
    return reach if reach < count else least


def _level(values: Array) -> float:
    """Level at the first of some samples, by a straight line through all."""
    place = np.arange(values.size)
    return float(np.polynomial.polynomial.polyfit(place, values, 1)[0])


def high_pass(corner: float) -> Transfer:
    """Transfer function of an ac-coupled sensor with this corner [Hz]."""

    def response(frequency: Array) -> NDArray[np.complex128]:
        return np.asarray(1j * frequency / (1j * frequency + corner), dtype=np.complex128)

    return response


def angles_of(recording: Recording, *, delay: float) -> tuple[Array, Array]:
    """Pitch and roll as if they were read with a delay [s], gaps bridged by straight lines, (n,) each [rad]."""
    angles = []
    for name in ("pitch", "roll"):
        if name not in recording:
            angles.append(np.zeros(recording.samples))
            continue
        one = recording.channel(name)
        values = interpolate_gaps_linearly(one.values)
        angles.append(fractional_delay(values, delay=delay - one.delay, interval=1 / recording.rate))
    return angles[0], angles[1]
