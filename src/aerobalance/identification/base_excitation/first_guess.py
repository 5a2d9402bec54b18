"""Where a fit of the response of a shaken balance begins: a search of frequency and damping of one mode."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.identification.base_excitation.frf_model import FIRST, TRANSIENTS, Parameters, Problem
from aerobalance.identification.base_excitation.spectra import Complex, Spectra
from aerobalance.recording.channel import Array

GROUPED: Final = 8
"""Neighbouring frequencies that are taken together in the search of a start."""


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Powers and cross power summed over a few neighbouring frequencies each, for the search of a start."""

    frequency: Array
    load: Array
    ground: Array
    cross: Complex
    load_noise: Array
    ground_noise: Array
    signal: Array

    @classmethod
    def of(cls, spectra: Spectra, load_noise: Array) -> _Sums:
        group = np.arange(spectra.frequency.size) // GROUPED
        size = np.bincount(group).astype(np.float64)

        def total(values: Array) -> Array:
            return np.asarray(np.bincount(group, weights=values), dtype=np.float64)

        cross = np.conj(spectra.ground) * spectra.load
        ground = total(np.abs(spectra.ground) ** 2)
        noise = total(spectra.ground_noise)
        return cls(
            frequency=total(spectra.frequency) / size,
            load=total(np.abs(spectra.load) ** 2),
            ground=ground,
            cross=total(cross.real) + 1j * total(cross.imag),
            load_noise=total(load_noise) / size,
            ground_noise=noise / size,
            signal=np.maximum(ground - noise, 1e-3 * ground),
        )

    def try_shape(self, shape: Complex, mass: float | None) -> tuple[float, float]:
        """Cost of the response mass * shape, and the mass, which is fitted where it is not given."""
        if mass is None:
            power = float(np.sum(np.abs(shape) ** 2 * self.signal / self.load_noise))
            mass = max(float(np.sum(np.real(np.conj(shape) * self.cross) / self.load_noise)) / power, 1e-12)
        h = mass * shape
        square = np.abs(h) ** 2
        cost = self.load - 2 * np.real(np.conj(h) * self.cross) + square * self.ground
        return float(np.sum(cost / (self.load_noise + square * self.ground_noise))), mass


def incoherent_noise(spectra: Spectra) -> Array:
    """Rough noise power of the load, shape (m,): the part that does not follow the ground motion, or the floor.

    It is taken over few neighbouring frequencies, so that the slopes of a sharp resonance count little.
    """
    group = np.arange(spectra.frequency.size) // GROUPED
    few = replace(spectra, block=group.astype(np.intp))
    count = few.block_sum(np.ones(spectra.frequency.size))
    incoherent = (1 - few.coherence) * few.block_sum(np.abs(spectra.load) ** 2) / np.maximum(count - 1, 1)
    return np.maximum(spectra.load_noise, incoherent[group])


def first_guess(problem: Problem, *, noise: Array) -> Parameters:
    """Search a grid of natural frequency and damping for the response of one mode, with this noise of the load."""
    sums = _Sums.of(problem.spectra, noise)
    f = sums.frequency
    delay = problem.delay or 0.0
    turn = np.exp(-2j * np.pi * f * delay)
    best = (np.inf, 1.0, 1.0, 0.0)
    # A sharp resonance falls between the points of a grid of all frequencies: another one lies around the peak.
    peak = f[np.argmax(np.abs(sums.cross) / sums.signal)]
    wide = np.geomspace(max(0.5 * f[0], 0.02 * f[-1]), 4 * f[-1], 240)
    for f0 in np.concatenate([wide, peak * np.linspace(0.98, 1.02, 33)]):
        for loss in (0.005, 0.02, 0.06, 0.15, 0.4, 1.0):
            r = f / f0
            cost, mass = sums.try_shape(-turn / (1 - r**2 + 1j * r * loss), problem.mass)
            if cost < best[0]:
                best = (cost, mass, float(f0), loss)
    reference = 2 * np.pi * best[2]
    values = np.zeros(FIRST + TRANSIENTS)
    values[:FIRST] = np.log(best[1]), np.log(reference), best[3], delay * reference
    return Parameters(values, reference)
