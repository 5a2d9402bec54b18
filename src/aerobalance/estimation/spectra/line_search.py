"""The steady lines of readings, taken out one after the other: each stands out of what is beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from aerobalance.estimation.spectra.steady_tones import LEFT, WIDTH, nearest_sine
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann

EVIDENCE: Final = 60.0
"""Least evidence of a tone that is looked for at any frequency [1]: noise alone exceeds it at an ordinate with the
probability exp(-60 / 3) = 2e-9."""

TURNS: Final = 3
"""Times that all frequencies are found again beside the other tones."""

BLOCK: Final = 32
"""Ordinates over which the level is looked at first."""

BESIDE: Final = (3, 27)
"""From how many ordinates off a tone to how many its surroundings are looked at, the last not included."""

BY_CHANCE: Final = 3.0
"""Power that is left about a tone over that of its surroundings, up to which nothing is left."""


@dataclass(slots=True, eq=False)
class Tone:
    """A tone: its frequency [rad/sample], and its cosine and sine from the middle of the record, shape (2,) [N]."""

    rate: float
    sizes: Array

    @property
    def amplitude(self) -> float:
        """Its amplitude [N]."""
        return float(np.hypot(*self.sizes))


@dataclass(slots=True, eq=False)
class LineSearch:
    """Lines that are taken out of readings one after the other, and what they leave.

    Attributes
    ----------
    whole, left
        Readings, and the same less the tones, shape (n,) [N].
    may_be
        Ordinates at which a tone may be at all, shape (n // 2 + 1,).
    searched
        Ordinates at which a tone may be, shape (n // 2 + 1,).
    gain
        Square of the balance's response at all of them, of that shape [1].
    taper
        Window under which they are looked at, shape (n,).
    time
        Samples from the middle of the record, shape (n,).
    tones
        The tones that were found.
    """

    whole: Array
    left: Array
    may_be: NDArray[np.bool_]
    searched: NDArray[np.bool_]
    gain: Array
    taper: Array
    time: Array
    tones: list[Tone]

    @property
    def power(self) -> float:
        """What is left, squared [N^2]."""
        return float(self.left @ self.left)

    @classmethod
    def of(cls, values: Array, searched: NDArray[np.bool_], gain: Array) -> LineSearch:
        """Readings as they are, shape (n,), with the ordinates that are searched and the balance's gain there."""
        count = values.size
        time = np.asarray(np.arange(count) - 0.5 * (count - 1), dtype=np.float64)
        return cls(values, values, searched.copy(), searched, gain, hann(count), time, [])

    def take_next(self) -> bool:
        """Take out the tone that stands out most of its surroundings; whether there was one."""
        count = self.left.size
        spectrum = rfft(self.left * self.taper)
        power = np.abs(spectrum) ** 2
        whole = power.size // BLOCK
        if not whole:
            return False
        level = np.median(power[: whole * BLOCK].reshape(whole, BLOCK), axis=1) / np.log(2)
        around = np.append(np.repeat(level, BLOCK), np.full(power.size - whole * BLOCK, level[-1]))
        over = np.where(self.searched, power / np.maximum(around, 1e-300), 0.0)
        while True:
            place = int(np.argmax(over))
            if over[place] < EVIDENCE / 3:
                return False
            near = slice(max(place - WIDTH, 0), place + WIDTH + 1)
            beside = self.surroundings(power, place)
            if power[place] >= EVIDENCE / 3 * beside:
                rate, after = nearest_sine(spectrum[:, None], place, count)
                if after < max(LEFT * power[near].sum(), BY_CHANCE * (2 * WIDTH + 1) * beside):
                    break
            over[near] = 0.0
            self.searched[near] = False
        self._take(rate)
        self.searched[near] = False
        return True

    def surroundings(self, power: Array, place: int) -> float:
        """Mean power beside a place: that of the stronger side, by its median, as other tones may stand there.

        Beside a resonance it is what a force there would make of it, where that is more.
        """
        first, last = BESIDE
        levels = []
        for side in (slice(max(place - last + 1, 1), max(place - first + 1, 1)), slice(place + first, place + last)):
            if power[side].size:
                of_force = power[side] / self.gain[side] * self.gain[place]
                levels += [float(np.median(one)) / float(np.log(2)) for one in (power[side], of_force)]
        return max(levels)

    def _take(self, rate: float) -> None:
        both = np.column_stack([np.cos(rate * self.time), np.sin(rate * self.time)])
        shown = both * self.taper[:, None]
        sizes = np.linalg.solve(shown.T @ shown, shown.T @ (self.left * self.taper))
        self.left = np.asarray(self.left - both @ sizes, dtype=np.float64)
        self.tones.append(Tone(rate, np.asarray(sizes, dtype=np.float64)))

    def refine(self) -> None:
        """Find each frequency again beside the other tones."""
        count = self.left.size
        for _ in range(TURNS):
            for tone in [self.tones.pop(0) for _ in range(len(self.tones))]:
                angle = tone.rate * self.time
                self.left = self.left + tone.sizes[0] * np.cos(angle) + tone.sizes[1] * np.sin(angle)
                place = round(tone.rate * count / (2 * np.pi))
                self._take(nearest_sine(rfft(self.left * self.taper)[:, None], place, count)[0])

    def at(self, rate: float) -> tuple[float, float]:
        """Amplitude [N] and evidence [1] of a further tone at a frequency [rad/sample]."""
        count = self.left.size
        transform = abs(np.sum(self.left * self.taper * np.exp(-1j * rate * self.time)))
        power = np.abs(rfft(self.left * self.taper)) ** 2
        beside = self.surroundings(power, round(rate * count / (2 * np.pi)))
        return float(2 * transform / np.sum(self.taper)), float(3 * transform**2 / max(beside, 1e-300))
