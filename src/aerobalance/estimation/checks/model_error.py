"""The error of a force that was worked out with other dynamics than those which the balance has."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.error_sources import Noise
from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import Array
from aerobalance.recording.sensors import load_gain_left

LEFT_OPEN: Final = "dynamics that the record leaves open"
"""Name of what other dynamics may do to a force that the record neither shows nor rules out."""

TOLD: Final = 0.1
"""Error by dynamics that a record leaves open over the force (both rms), from which on they are doubted as well."""

BY_PROBABILITY: Final = "would be wrong, which counts in the uncertainty by that probability"
"""What other dynamics that a record leaves open do to forces near the frequencies that they tell."""

BINS: Final = 512
"""Frequencies at which the spectrum of an error is kept."""

LEAST_SEEN: Final = 0.2
"""Response of the balance over that which was taken for its, below which its inverse is not followed: the force is
five times what was found at most."""

LEAST_RINGING: Final = 0.1
"""Response of the balance from which on what a step has of a frequency counts for how it is found: to 3.3 times the
natural frequency."""

PERIODS: Final = 1.0
"""Periods of the balance either side over which the square of an error is averaged."""


def error_under(force: Array, *, own: ModalModel, other: ModalModel, interval: float) -> Array:
    """Return how far a force is off if the balance is another, F (1 - G0 / G1), shape (n,) [N].

    Parameters
    ----------
    force
        The force worked out, shape (n,) [N].
    own
        The dynamics that it was worked out with, G0.
    other
        The dynamics of the balance, G1.
    interval
        Time between samples [s].
    """
    frequency = np.fft.rfftfreq(2 * force.size, interval)
    here, there = own.response(frequency), other.response(frequency)
    # at a zero of the other response the reading shows no force: what is found there is no measure of what acts
    seen = np.maximum(np.abs(there), LEAST_SEEN * np.abs(here)) ** 2
    return _through(force, 1 - here * np.conj(there) / np.maximum(seen, 1e-300))


def error_behind(smooth: Array, sharp: Array, low_pass: AntiAlias, *, own: ModalModel, interval: float) -> Array:
    """Return what a force lacks that was read behind a filter which is not undone in full, F (1 / g - 1), (n,) [N].

    Parameters
    ----------
    smooth, sharp
        The force worked out, and its steps, shape (n,) each [N].
    low_pass
        The filter of the load.
    own
        The dynamics of the balance.
    interval
        Time between samples [s].
    """
    frequency = np.asarray(np.fft.rfftfreq(2 * smooth.size, interval), dtype=np.float64)
    lacking = 1 / np.maximum(load_gain_left(low_pass, frequency), LEAST_SEEN) - 1
    # a step is found by its ringing: what it has far beyond the natural frequency has no part in that
    shown = np.minimum(np.abs(own.response(frequency)), 1.0)
    return _through(smooth, lacking) + _through(sharp, lacking * np.where(shown > LEAST_RINGING, shown, 0.0))


def _through(force: Array, ratio: NDArray[np.float64] | NDArray[np.complex128]) -> Array:
    """A force with its spectrum, at the frequencies of twice its length, multiplied by a ratio."""
    count = force.size
    back = 0.5 + 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    closed = np.concatenate([force, force[0] + (force[-1] - force[0]) * back])  # without a jump where the ends meet
    return np.asarray(np.fft.irfft(np.fft.rfft(closed) * ratio, 2 * count)[:count])


def as_noise(error: Array, *, name: str, period: float, interval: float) -> Noise:
    """Return an error whose phase is not certain as a noise of its local size and its spectrum.

    Parameters
    ----------
    error
        What is expected of it, shape (n,) [N].
    name
        What it is from.
    period
        Period of the balance [s].
    interval
        Time between samples [s].
    """
    width = min(2 * round(PERIODS * period / interval) + 1, error.size)
    summed = np.concatenate([[0.0], np.cumsum(error**2)])
    first = np.clip(np.arange(error.size) - width // 2, 0, error.size - width)
    local = np.maximum(summed[first + width] - summed[first], 0.0) / width
    power = np.abs(np.fft.rfft(error)) ** 2
    edges = np.linspace(0, power.size, min(BINS, power.size) + 1).astype(int)
    density = np.add.reduceat(power, edges[:-1]) / np.diff(edges)
    mean = float(np.mean(density))
    return Noise(name, "dynamics", np.sqrt(local), density / mean if mean > 0 else np.ones(1))
