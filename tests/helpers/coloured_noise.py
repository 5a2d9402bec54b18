"""Noise of a given spectrum, and the balance that it is read from."""

import numpy as np

RATE = 1600.0
WHITE = 4.0 / RATE


def noise_of(generator: np.random.Generator, density, *, n: int = 16_000, longer: int = 8) -> np.ndarray:
    """Readings of a noise of a two-sided density [N^2/Hz], cut from a record several times as long."""
    frequency = np.fft.rfftfreq(longer * n, 1 / RATE)
    level = np.zeros(frequency.size)
    level[1:] = density(frequency[1:])
    phasors = generator.normal(size=frequency.size) + 1j * generator.normal(size=frequency.size)
    return np.fft.irfft(phasors * np.sqrt(level * longer * n * RATE / 2), longer * n)[:n]
