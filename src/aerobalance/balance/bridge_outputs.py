"""Gauge outputs over excitation: bridges that were recorded in volts, made mV/V."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import is_gauge
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.recording import Recording

NEAR_ZERO: Final = 0.1
"""Part of its median below which an excitation counts as switched off."""

_FEWEST_BLOCKS: Final = 8
_OUTLYING: Final = 6.0
_SURE: Final = 5.0


def gauge_outputs(recording: Recording) -> Recording:
    """Return a recording with all gauge outputs in mV/V, those in V divided by the excitation.

    Outputs in V are divided, sample by sample, by the channel ``excitation`` [V]; outputs in mV/V stay as they are.

    The reading of the excitation has noise of its own, which must not be added to the outputs. So its block means
    are divided by, joined by straight lines, in blocks as long as the excitation allows: the length is doubled for as
    long as the second differences of the block means are no larger (within five standard errors) than white noise of
    the size seen from sample to sample would make them, up to an eighth of the record. A constant or slowly drifting
    excitation is thus smoothed over many samples, and the error that the smoothing makes is below the noise that is
    left. Where short blocks move more than that and long ones do not, there is a tone, either in the supply (then it
    is in the outputs too) or in its reading alone (then it is not): the short blocks and the long ones are both tried,
    and those are taken that leave the outputs quieter. A step or a quick change is divided out as it was read.
    Samples that depart from the smoothed course by more than six times their scatter about it are taken as read too.
    Where the excitation is missing, the smoothed course bridges it.

    Parameters
    ----------
    recording
        With gauge outputs (``rAF``, ``rN1``) in mV/V or V.

    Returns
    -------
    Recording
        The same channels; gauge outputs in mV/V, whose `relative_uncertainty` includes that of the excitation.

    Raises
    ------
    FitError
        A gauge output is in V and there is no excitation, or none that is above zero.

    Warns
    -----
    DataQualityWarning
        The excitation is zero, negative or near zero in some samples; the outputs are missing (NaN) there.
    """
    in_volts = [channel.name for channel in recording if is_gauge(channel.name) and channel.unit == "V"]
    if not in_volts:
        return recording
    if "excitation" not in recording:
        raise FitError(
            f"{recording.name}: {', '.join(in_volts)} in V, but there is no channel excitation [V] to divide by; "
            "record it, or give the nominal one in the channel map (excitation = 10.0 under each of these channels)"
        )
    excitation = recording.channel("excitation")
    usable = _usable(recording.name, excitation.values)
    volts = [recording.channel(name).values for name in in_volts]
    divisor = _divisor(np.where(usable, excitation.values, np.nan), volts)
    divisor[~usable & ~excitation.missing] = np.nan
    placed = dict(recording.channels)
    for name in in_volts:
        placed[name] = _over(recording.channel(name), excitation, divisor)
    return replace(recording, channels=placed)


def _over(channel: Channel, excitation: Channel, divisor: Array) -> Channel:
    """Divide a gauge output [V] by the excitation; the result is in mV/V."""
    relative = float(np.hypot(channel.relative_uncertainty, excitation.relative_uncertainty))
    usual = float(np.nanmedian(divisor))
    return replace(
        channel,
        values=channel.values / divisor * 1e3,
        unit="mV/V",
        noise=None if channel.noise is None else channel.noise / usual * 1e3,
        relative_uncertainty=relative,
        file_unit="mV/V",
    )


def _usable(name: str, values: Array) -> NDArray[np.bool_]:
    """Flag the samples with an excitation that can be divided by, shape (n,)."""
    known = np.isfinite(values)
    positive = values[known & (values > 0)]
    if positive.size == 0:
        raise FitError(
            f"{name}: the excitation is nowhere above zero; check that it was on, and its sign (sign = -1 in a "
            "channel map turns it)"
        )
    least = NEAR_ZERO * float(np.median(positive))
    usable: NDArray[np.bool_] = known & (values > least)
    off = int(np.count_nonzero(known & ~usable))
    if off:
        warn_quality(
            f"{name}: the excitation is zero, negative or near zero (up to {least:.3g} V) in {off} of {values.size} "
            "samples; the gauge outputs are missing there"
        )
    return usable


def _divisor(values: Array, volts: Sequence[Array]) -> Array:
    """Choose what to divide by: the excitation smoothed as `gauge_outputs` says, shape (n,) [V]."""
    short, long = _block_lengths(values)
    quick = _smoothed(values, short)
    if long == short:
        return quick
    slow = _smoothed(values, long)
    return min((slow, quick), key=lambda divisor: _loudness(volts, divisor, long))


def _loudness(volts: Sequence[Array], divisor: Array, length: int) -> float:
    """Mean logarithm of the scatter of the outputs about their own block means."""
    scatter = []
    for given in volts:
        output = given / divisor
        variance = float(np.nanmean((output - _course(output, length)) ** 2))
        if variance > 0:
            scatter.append(np.log(variance))
    return float(np.mean(scatter)) if scatter else 0.0


def _smoothed(values: Array, length: int) -> Array:
    """Smooth by block means; samples that stand out stay as read."""
    if length == 1:
        return values.copy()
    course = _course(values, length)
    departure = values - course
    scatter = float(np.sqrt(np.nanmean(departure**2)))
    outlying = np.abs(departure) > _OUTLYING * max(scatter, _rounding(values))
    if outlying.any():
        course = _course(np.where(outlying, np.nan, values), length)
        course[outlying] = values[outlying]
    return course


def _block_lengths(values: Array) -> tuple[int, int]:
    """Find how long blocks may be for white noise to explain their means.

    Returns
    -------
    tuple
        The length up to which all lengths pass, and the longest that passes.
    """
    single = _second_differences(values)
    if single.size < _FEWEST_BLOCKS:
        return 1, 1
    variance = float(np.mean(single**2)) / 6  # of a second difference of white noise: 1 + 4 + 1
    short = long = 1
    unbroken = True
    length = 2
    while values.size // length >= _FEWEST_BLOCKS:
        differences = _second_differences(_block_means(values, length))
        if differences.size < _FEWEST_BLOCKS - 2:
            break
        # Second differences of white noise correlate by -4/6 and 1/6, so their mean square scatters by 3.89 / n.
        limit = 1 + _SURE * np.sqrt(3.89 / differences.size)
        if float(np.mean(differences**2)) <= limit * 6 * variance / length + _rounding(values) ** 2:
            long = length
            short = length if unbroken else short
        else:
            unbroken = False
        length *= 2
    return short, long


def _rounding(values: Array) -> float:
    """Size of what the arithmetic rounds off, which is no movement [V]."""
    return 8 * float(np.finfo(float).eps) * float(np.nanmax(np.abs(values)))


def _second_differences(values: Array) -> Array:
    found = np.diff(values, 2)
    return found[np.isfinite(found)]


def _block_means(values: Array, length: int) -> Array:
    """Mean of the known samples of every whole block; NaN for a block without."""
    blocks = values[: values.size // length * length].reshape(-1, length)
    known = np.isfinite(blocks)
    count = known.sum(axis=1)
    total = np.where(known, blocks, 0.0).sum(axis=1)
    means = np.full(count.shape, np.nan)
    np.divide(total, count, out=means, where=count > 0)
    return means


def _course(values: Array, length: int) -> Array:
    """Join the block means by straight lines, the first and last of which go on to the ends."""
    means = _block_means(values, length)
    centres = (np.arange(means.size) + 0.5) * length - 0.5
    known = np.isfinite(means)
    means, centres = means[known], centres[known]
    index = np.arange(values.size, dtype=np.float64)
    if means.size < 2:
        return np.full(values.shape, means[0] if means.size else np.nan)
    course = np.interp(index, centres, means)
    for ends, (a, b) in ((index < centres[0], (0, 1)), (index > centres[-1], (-1, -2))):
        slope = (means[b] - means[a]) / (centres[b] - centres[a])
        course[ends] = means[a] + slope * (index[ends] - centres[a])
    return course
