"""Whether damping and frequency of a ringing load depend on its amplitude: friction, a loose joint, a bent spring."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.identification.free_decay.ring_fit import fit_ring
from aerobalance.identification.free_decay.waveform import Ring
from aerobalance.recording.channel import Array

SIGNIFICANT: Final = 5.0
"""Standard uncertainties from which a dependence is more than chance."""

PLAIN: Final = 0.05
"""Share of the squared residuals that a bent waveform takes away where bending is what is wrong with a fit."""

FALLEN: Final = 0.5
"""Amplitude at the end of the ringing over that at its start above which nothing can be told."""


@dataclass(frozen=True, slots=True)
class AmplitudeDependence:
    """Change of decay rate and frequency from the smallest to the largest amplitude of a ringing load, relative.

    Attributes
    ----------
    damping, u_damping
        Decay rate at the full amplitude less that at none, over the one fitted, and its standard uncertainty [1].
    frequency, u_frequency
        The same of the frequency [1].
    """

    damping: float
    u_damping: float
    frequency: float
    u_frequency: float

    @property
    def damping_depends(self) -> bool:
        """True when the damping depends on the amplitude by more than chance."""
        return abs(self.damping) > SIGNIFICANT * self.u_damping

    @property
    def frequency_depends(self) -> bool:
        """True when the frequency depends on the amplitude by more than chance."""
        return abs(self.frequency) > SIGNIFICANT * self.u_frequency


def bent_fit(ring: Ring) -> Ring:
    """The same ring with a decay rate and a frequency that may change with the envelope."""
    return _again(ring, bent=True)


def amplitude_dependence(ring: Ring, *, bent: Ring | None = None) -> tuple[AmplitudeDependence | None, Ring]:
    """Test a fitted ringing for a decay rate and a frequency that change in proportion to the envelope.

    Parameters
    ----------
    ring
        The fit.
    bent
        The same with a decay rate and a frequency that may change, where that is fitted already.

    Returns
    -------
    dependence
        None where the residuals are rounding, or the ringing does not fall enough to tell.
    ring
        The fit itself, bent where one of the two is significant and it has no law yet, and else not.
    """
    falls = ring.decay * (float(ring.time[-1]) - ring.start)  # logarithm of how much; one of noise alone may rise
    straight = _again(ring, bent=False) if ring.bent else ring
    if ring.variance < (1e-9 * ring.amplitude) ** 2 or -falls > np.log(FALLEN):
        return None, straight
    if bent is None:
        bent = ring if ring.bent else _again(ring, bent=True)
    change, u = _change(bent)
    found = AmplitudeDependence(float(change[0]), float(u[0]), float(change[1]), float(u[1]))
    if ring.law is not None:
        return found, ring
    return found, bent if found.damping_depends or found.frequency_depends else straight


def _change(bent: Ring) -> tuple[Array, Array]:
    """Relative change of decay rate and frequency, shape (2,), and their standard uncertainties.

    What bends a ringing of any phase stands to the ringing as one complex number to another.
    """
    if bent.shape != "free":
        return bent.sizes[-2:] / bent.height, np.sqrt(np.diag(bent.covariance)[-2:]) / abs(bent.height)
    swing, ratio = (
        complex(bent.sizes[2], -bent.sizes[3]),
        float(bent.vector[1]) / max(bent.decay, 1e-6 * float(bent.vector[1])),
    )
    turn = np.array([[-1.0, 1j * ratio]]) / swing  # of both sizes, into - damping + i ratio frequency
    both = np.vstack([-turn.real, turn.imag / ratio])
    return both @ bent.sizes[-2:], np.sqrt(np.diag(both @ bent.covariance[-2:, -2:] @ both.T))


def _again(ring: Ring, *, bent: bool) -> Ring:
    """Fit the same ringing again, bent or not."""
    straight = ring if ring.law is None else replace(ring, law=None, vector=ring.vector[:-2])
    return fit_ring(ring.time, ring.values, straight, lines=ring.lines, bent=bent)
