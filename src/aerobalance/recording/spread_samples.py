"""Some samples of many, spread over a record, from which what all of them have is found soon."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray


@lru_cache(maxsize=16)
def spread_samples(samples: int, most: int) -> NDArray[np.intp]:
    """Places of some samples of a record, in their order, shape (min(samples, most),).

    One is anywhere in each of as many equal stretches, the same at every call. Of every n-th sample a load that goes
    with the clock, as that of a rotor may, would be seen at few of its phases: of one with a period of n at one alone.

    Parameters
    ----------
    samples
        Samples of the record.
    most
        How many are taken at most.
    """
    places = np.arange(min(samples, most))
    if samples > most:
        within = np.random.default_rng(0).random(most)
        places = ((places + within) * (samples / most)).astype(np.intp)
    places.flags.writeable = False  # all callers have the same one
    return places
