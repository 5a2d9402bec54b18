"""The analog low-pass before a sampled channel, by its order and corner: its exact phase and magnitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

Kind = Literal["butterworth", "bessel"]

HIGHEST_ORDER: Final = 24
"""Highest order of a filter; the poles of a Bessel filter are lost in rounding beyond it."""


@dataclass(frozen=True, slots=True)
class AntiAlias:
    """An analog low-pass filter of gain 1 at rest.

    Attributes
    ----------
    kind
        ``"butterworth"`` or ``"bessel"``.
    order
        Number of its poles.
    corner
        Frequency at which it is 3 dB low [Hz], for both kinds.
    """

    kind: Kind
    order: int
    corner: float

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise ValueError(f"a filter must be of the kind butterworth or bessel, not {self.kind!r}")
        if not 1 <= self.order <= HIGHEST_ORDER:
            raise ValueError(f"the order of a filter must lie between 1 and {HIGHEST_ORDER}, not {self.order}")
        if not 0 < self.corner < np.inf:
            raise ValueError(f"the corner of a filter must be above 0 Hz, not {self.corner:g}")

    def response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Reading over signal at frequencies [Hz]; its phase is negative, the reading is late."""
        # poles over the corner: of an order of 24 their product in rad/s would leave the range of numbers
        poles, gain = self._poles_and_gain()
        s = 1j * np.asarray(frequency, dtype=np.float64) / self.corner
        return np.asarray(gain / np.prod([s - pole for pole in poles], axis=0), dtype=np.complex128)

    @property
    def decay(self) -> float:
        """Rate at which the slowest part of its response to a blow decays, that of its slowest pole [1/s]."""
        poles, _ = self._poles_and_gain()
        return float(2 * np.pi * self.corner * np.min(-poles.real))

    def _poles_and_gain(self) -> tuple[NDArray[np.complex128], float]:
        """Poles over the angular frequency of the corner, shape (order,) [1], and the gain that goes with them."""
        from scipy.signal import bessel, butter  # noqa: PLC0415 - takes a second, and few recordings state a filter

        if self.kind == "butterworth":
            _, poles, gain = butter(self.order, 1.0, analog=True, output="zpk")
        else:
            _, poles, gain = bessel(self.order, 1.0, analog=True, output="zpk", norm="mag")
        return np.asarray(poles, dtype=np.complex128), float(gain)

    def __str__(self) -> str:
        return f"{self.kind} low-pass of order {self.order} at {self.corner:g} Hz"
