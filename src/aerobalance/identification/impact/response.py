"""Response functions of taps: balance loads over force, without a window, and their coherence.

A record that is cut off while the balance still rings leaks, and a window that fades it out adds damping. Here the
record goes on by the motion that was fitted, whose transform is known in closed form, so that nothing is cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, ifft, next_fast_len

from aerobalance.identification.coupled.units import Units
from aerobalance.identification.impact.tap_fit import TapFit
from aerobalance.identification.impact.tap_model import Tap, force_of
from aerobalance.recording.channel import Array

LINES: Final = 2000
"""Frequencies of a response function, at most."""

HIGHEST: Final = 0.9
"""Share of half the sampling rate up to which they go."""

LOWEST: Final = 0.1
"""Spectrum of the force over that at zero, down to which a response is worked out."""


@dataclass(frozen=True, slots=True, eq=False)
class PointResponse:
    """Response functions at one point.

    Attributes
    ----------
    point
        Its number, from 0.
    taps
        Number of taps averaged.
    frequency
        Shape (m,) [Hz].
    response
        Balance loads over force, shape (m, n) [1, m].
    coherence
        Share of the loads' power that the force explains, shape (m, n) [1]; NaN for one tap.
    """

    point: int
    taps: int
    frequency: Array
    response: NDArray[np.complex128]
    coherence: Array


def responses_of(fit: TapFit, units: Units) -> tuple[PointResponse, ...]:
    """Return the response functions at every point, averaged over its taps (H1: noise in the loads averages out).

    Parameters
    ----------
    fit
        The fit, for the loads at rest, the motion before a tap and that after the end of its record.
    units
        Its units.
    """
    found = []
    for place in range(len(fit.points)):
        used = [number for number, tap in enumerate(fit.taps) if tap.linked and tap.point == place]
        if not used:
            continue
        frequency = _frequencies(fit, used, units.rate)
        spectra = [_spectra(fit, number, 2 * np.pi * frequency / units.rate) for number in used]
        force = np.array([one for one, _ in spectra])
        loads = np.array([other for _, other in spectra])
        cross = np.einsum("tf,tfn->fn", force.conj(), loads)
        power = np.sum(np.abs(force) ** 2, axis=0)
        response = cross / power[:, None]
        coherence = np.abs(cross) ** 2 / (power[:, None] * np.sum(np.abs(loads) ** 2, axis=0))
        if len(used) == 1:
            coherence = np.full(coherence.shape, np.nan)
        found.append(
            PointResponse(
                place,
                len(used),
                frequency,
                response * units.sizes,
                np.minimum(coherence, 1.0),
            )
        )
    return tuple(found)


def _frequencies(fit: TapFit, used: Sequence[int], rate: float) -> Array:
    """Frequencies at which the force has a spectrum, evenly spaced, by steps of few digits [Hz].

    Universal files have room for six digits of the step.
    """
    longest = max(float(fit.taps[number].time[-1]) for number in used) / rate
    highest = HIGHEST * rate / (2 * _interval(fit.taps[used[0]]))
    rough = np.linspace(0.0, highest, LINES)
    level = np.min([np.abs(_transform(fit, number, 2 * np.pi * rough / rate)) for number in used], axis=0)
    low = np.flatnonzero(level < LOWEST * level[0])
    end = float(rough[low[0]]) if low.size else highest
    step = float(f"{max(1 / longest, end / LINES):.2e}")
    return np.asarray(step * np.arange(1, max(int(end / step), 2) + 1), dtype=np.float64)


def _interval(tap: Tap) -> float:
    return float(np.median(np.diff(tap.time)))


def _transform(fit: TapFit, number: int, frequency: Array) -> NDArray[np.complex128]:
    """Fourier transform of the measured force of a tap."""
    tap = fit.taps[number]
    instants = np.asarray(tap.instants - fit.common.delay * fit.common.u_delay, dtype=np.float64)
    return np.asarray(np.exp(-1j * frequency[:, None] * instants) @ tap.force.astype(np.complex128))


def _spectra(fit: TapFit, number: int, frequency: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Transforms of the force of a tap and of the loads that it makes be felt.

    The latter is that of the motion fitted and of what the readings depart from it: what is not read, in the contact
    and after the end of the record, is what the motion says.
    """
    tap, left = fit.taps[number], fit.linears[number].after
    interval = _interval(tap)
    place = np.rint(tap.time[tap.before :] / interval).astype(np.intp)  # time counts from a sample
    whole = np.zeros((int(place[-1]) + 1, fit.size))
    whole[place] = left
    departure = interval * _at_multiples(whole, float(frequency[0]) * interval, frequency.size)
    return _transform(fit, number, frequency), departure + _blow_transform(fit, number, frequency)


def _at_multiples(values: Array, step: float, count: int) -> NDArray[np.complex128]:
    """Sums of values[n] exp(-i k step n) for k from 1 to `count`, shape (count, columns) [Bluestein1970]_.

    References
    ----------
    .. [Bluestein1970] L. I. Bluestein, "A linear filtering approach to the computation of discrete Fourier transform",
       IEEE Trans. Audio Electroacoust. 18 (1970) 451.
    """
    rows = values.shape[0]
    n, k = np.arange(rows, dtype=np.float64), np.arange(1, count + 1, dtype=np.float64)
    length = next_fast_len(rows + count + 1)
    chirped = np.exp(-0.5j * step * n**2)[:, None] * values
    filter_of = np.zeros(length, dtype=np.complex128)
    filter_of[: count + 1] = np.exp(0.5j * step * np.arange(count + 1.0) ** 2)
    # of two rows at least: fewer readings after a tap are not used
    filter_of[-rows + 1 :] = np.exp(0.5j * step * np.arange(rows - 1.0, 0.0, -1.0) ** 2)
    found = ifft(fft(chirped, length, axis=0) * fft(filter_of)[:, None], axis=0)[1 : count + 1]
    return np.asarray(np.exp(-0.5j * step * k**2)[:, None] * found)


def _parts(fit: TapFit, number: int) -> tuple[NDArray[np.complex128], Array, Array]:
    """Sizes of the modes after a unit blow, the force times the sampling interval, and its instants."""
    tap, motion = fit.taps[number], fit.motion
    spring = fit.common.matrices[: motion.size**2].reshape(motion.size, motion.size)
    point = fit.points[tap.point]
    loads = (1 + fit.common.gain * fit.common.u_gain) * (point.loads + point.root @ fit.off[tap.point])
    sizes = motion.sizes(np.zeros(motion.size), spring[:, : fit.size] @ loads)
    return sizes, force_of(tap, fit.own[number]), tap.instants - fit.common.delay * fit.common.u_delay


def _blow_transform(fit: TapFit, number: int, frequency: Array) -> NDArray[np.complex128]:
    """Transform of the balance loads under the force of a tap, by the fit."""
    sizes, force, instants = _parts(fit, number)
    motion = fit.motion
    drive = np.exp(-1j * frequency[:, None] * instants) @ force.astype(np.complex128)
    response = (1 / (1j * frequency[:, None] - motion.poles) * sizes) @ motion.felt.T
    return np.asarray(drive[:, None] * response)
