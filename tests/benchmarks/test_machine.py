"""The machine on which all this was measured, by which rows that name seconds or cores are to be read."""

from __future__ import annotations

import pytest
from scipy.fft import irfft, rfft

from helpers.yardstick import spent

NOMINAL = 0.02, 0.03
"""Times that the machine is compared with [s]."""


def count() -> int:
    """A loop of a million turns, as which commands begin and small arrays are worked on."""
    total = 0
    for number in range(1_000_000):
        total += number
    return total


@pytest.mark.alone
def test_how_fast_the_machine_is(record, rng) -> None:
    values = rng.normal(size=1_000_000)
    transform, loop = NOMINAL
    ratio = transform / spent(lambda: irfft(rfft(values)), runs=10)
    record("20 ms over the time of a Fourier transform there and back of 1e6 samples", ratio, 0.0)
    record("30 ms over the time of a loop of Python of 1e6 turns", loop / spent(count, runs=10), 0.0)
