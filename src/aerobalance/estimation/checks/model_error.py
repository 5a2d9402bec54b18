"""The error of a force that was worked out with other dynamics than those which the balance has."""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.error_sources import Noise
from aerobalance.recording.channel import Array

LEFT_OPEN: Final = "dynamics that the record leaves open"
"""Name of what other dynamics may do to a force that the record neither shows nor rules out."""

BINS: Final = 512
"""Frequencies at which the spectrum of an error is kept."""

LEAST_SEEN: Final = 0.2
"""Response of the balance over that which was taken for its, below which its inverse is not followed: the force is
five times what was found at most."""

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
    count = force.size
    back = 0.5 + 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    closed = np.concatenate([force, force[0] + (force[-1] - force[0]) * back])  # without a jump where the ends meet
    frequency = np.fft.rfftfreq(2 * count, interval)
    here, there = own.response(frequency), other.response(frequency)
    # at a zero of the other response the reading shows no force: what is found there is no measure of what acts
    seen = np.maximum(np.abs(there), LEAST_SEEN * np.abs(here)) ** 2
    ratio = 1 - here * np.conj(there) / np.maximum(seen, 1e-300)
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
