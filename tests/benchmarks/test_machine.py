"""The machine on which all this was measured, by which rows that name seconds or cores are to be read."""

from __future__ import annotations

import time

import pytest
from scipy.fft import irfft, rfft

NOMINAL = 0.02
"""Time that the machine is compared with [s]."""


@pytest.mark.alone
def test_how_fast_the_machine_is(record, rng) -> None:
    values, found = rng.normal(size=1_000_000), []
    for _ in range(10):
        begin = time.process_time()
        irfft(rfft(values))
        found.append(time.process_time() - begin)
    record("20 ms over the time of a Fourier transform there and back of 1e6 samples", NOMINAL / min(found), 0.0)
