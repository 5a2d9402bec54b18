"""When a source without a device of its own gives its samples: at its rate, at a multiple of it, or at once."""

from __future__ import annotations

import math
import time


class Pacing:
    """Counts the samples that are due.

    Parameters
    ----------
    rate
        Sampling rate [Hz].
    speed
        Seconds of the source in a second of the clock; infinite for as fast as possible.

    Raises
    ------
    ValueError
        The speed is not above zero.
    """

    def __init__(self, rate: float, speed: float) -> None:
        if not speed > 0:
            raise ValueError(f"speed must be above zero, not {speed:g}")
        self.rate, self.speed = rate, speed
        self._began = 0.0

    def start(self) -> None:
        """Count from now on."""
        self._began = time.monotonic()

    def wait(self, done: int, rows: int, timeout: float) -> bool:
        """Wait until `rows` samples beyond the first `done` are due, `timeout` [s] at most; say whether they are."""
        if math.isinf(self.speed):
            return True
        due = self._began + (done + rows) / (self.rate * self.speed)
        left = due - time.monotonic()
        if left <= 0:
            return True
        time.sleep(min(left, timeout))
        return left <= timeout
